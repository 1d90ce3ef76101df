"""Radar: range, azimuth and range rate of the nearest objects."""

from typing import Any, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, model_validator
from pydrake.multibody.tree import Frame
from pydrake.systems.framework import Context

from mirdrake.core.signals import Signal, Signals
from mirdrake.core.yaml_io import Angle, Length, Speed
from mirdrake.sensors.noise import sample_noise, substream
from mirdrake.sensors.ranging.beams import field
from mirdrake.sensors.ranging.caster import Caster
from mirdrake.sensors.ranging.faces import Array, Ints
from mirdrake.sensors.ranging.motion import BodyState
from mirdrake.sensors.ranging.mount import Ranging, check_rays
from mirdrake.sensors.ranging.world import GROUND, RayWorld
from mirdrake.sensors.sampling import SampledSensor
from mirdrake.vehicles.mount import FieldOfView

NOTHING = (np.inf, 0.0, 0.0)
"""Range, azimuth and range rate in place of a missing target."""


def radar_signals(targets: int) -> Signals:
    """Return names and units of the output of a radar."""
    return tuple(
        Signal(f"{name}{index}", unit, meaning)
        for index in range(targets)
        for name, unit, meaning in (
            ("range", "m", "inf: no target"),
            ("azimuth", "rad", "positive to the left"),
            ("range_rate", "m/s", "positive when it moves away"),
        )
    )


class Radar(SampledSensor):
    """Targets within a field of view, the nearest first.

    Each object that rays meet is one target: a vehicle with all its parts, a prop, or another geometry. Its returns are
    those in the range cell of the nearest one. The range is that of the nearest return; azimuth and range rate are
    means over the cell. Objects are separated by their identity, not by their distance. The ground gives no returns
    unless the mount has `ground: true`, and its clutter hides no object. Strength of returns, ambiguity of range and
    range rate, and multipath are not modelled.

    Input ports:
        body_poses: the plant's output.
        body_spatial_velocities: the plant's output.
    Output ports:
        sample (3 targets) [m, rad, m/s]: :func:`radar_signals`.
        stamp (1) [s]: when the sample was taken.

    Args:
        world: surfaces that give returns.
        frame: frame of the radar; fixed to a body.
        mount: field of view, limits, rate and noise.
        stream: stream from :func:`mirdrake.sensors.noise.noise_stream`.
        hidden: bodies that give no returns.
    """

    record = None

    def __init__(
        self, world: RayWorld, frame: Frame, mount: "RadarMount", *, stream: int = 0, hidden: tuple[int, ...] = ()
    ) -> None:
        super().__init__(radar_signals(mount.targets), mount, stream=stream, initial=NOTHING * mount.targets)
        self.mount = mount
        beams = field(mount.horizontal_fov, mount.vertical_fov, mount.columns, mount.rows)
        self.caster = Caster(self, world, frame, mount, beams, stream=stream, hidden=hidden, ground=mount.ground)

    def measure(self, context: Context) -> Array:
        """Return the present targets with noise (3 targets)."""
        states = self.caster.states(context)
        hits = self.caster.look(context, states)
        distance, hit_object, body = (values.ravel() for values in (hits.distance, hits.object_index, hits.body))
        targets: list[Array] = []
        # -1 (nothing hit) is below GROUND.
        for number in np.unique(hit_object[hit_object >= GROUND]).tolist():
            rays = np.flatnonzero(hit_object == number)
            nearest = distance[rays].min()
            # An object with a return inside the near limit is not reported, not even by its farther parts.
            if nearest >= self.mount.near:
                rays = rays[distance[rays] <= nearest + self.mount.range_cell]
                directions = self.caster.beams.directions[0, rays]
                # The field of view is less than half a turn, so that the mean of azimuths does not wrap.
                azimuth = np.arctan2(directions[:, 1], directions[:, 0]).mean()
                rate = self._range_rates(states, directions, distance[rays], body[rays]).mean()
                targets.append(np.array([nearest, azimuth, rate]))
        # The nearest first; more than the radar can report are dropped.
        targets = sorted(targets, key=lambda target: float(target[0]))[: self.mount.targets]
        sample = np.array([*targets, *([NOTHING] * (self.mount.targets - len(targets)))], dtype=float)
        return self._reading(sample, round(context.get_time() * self.rate)).ravel()

    def _range_rates(self, states: dict[int, BodyState], directions: Array, distance: Array, body: Ints) -> Array:
        """Return the range rates of the hits of rays (n) [m/s]."""
        own, X_BS = states[self.caster.carrier], self.caster.X_BS
        arm = own.R @ X_BS.translation()
        start, directions_W = own.p + arm, directions @ (own.R @ X_BS.rotation().matrix()).T
        ends = start + distance[:, None] * directions_W
        velocity = np.zeros_like(ends)
        # Body 0 is the world, which does not move; its range rate is that of the radar alone.
        for index in np.unique(body[body > 0]).tolist():
            state, rays = states[index], body == index
            # Velocity of the point of the body that the ray hit, which includes its rotation.
            velocity[rays] = state.v + np.cross(state.w, ends[rays] - state.p)
        # Range rate: relative velocity along the ray, positive when the target moves away.
        rates: Array = np.einsum("ij,ij->i", velocity - own.v - np.cross(own.w, arm), directions_W)
        return rates

    def _reading(self, targets: Array, index: int) -> Array:
        """Return targets with noise (n, 3); lost ones are moved to the end."""
        # Which targets exist is decided before noise and loss, so that the random numbers do not shift.
        mount, valid = self.mount, np.isfinite(targets[:, 0])
        targets[:, 0] = self.caster.reading(targets[:, 0], index)
        generator = sample_noise(substream(self._stream, "targets"), index)
        deviations = np.array([mount.azimuth_noise, mount.range_rate_noise])
        targets[valid, 1:] += (deviations * generator.standard_normal((len(targets), 2)))[valid]
        targets[~np.isfinite(targets[:, 0])] = NOTHING
        # Stable: targets at equal range keep their order; lost ones have an infinite range and are last.
        ordered: Array = targets[np.argsort(targets[:, 0], kind="stable")]
        return ordered


class RadarMount(Ranging):
    """Radar: range, azimuth and range rate of the nearest objects."""

    system: ClassVar[Any] = Radar
    kind: Literal["radar"]
    horizontal_fov: Angle = Field(gt=0, lt=3.14, description="[rad] full angle")
    vertical_fov: Angle = Field(gt=0, lt=3.14, description="[rad] full angle")
    columns: int = Field(default=120, gt=0, le=100_000, description="rays across the field of view")
    rows: int = Field(default=10, gt=0, le=1024, description="rays from the bottom to the top of the field of view")
    targets: int = Field(default=16, gt=0, le=256, description="largest number of reported targets, the nearest first")
    range_cell: Length = Field(
        default=0.5, gt=0, description="[m] returns within this distance of the first one are one target"
    )
    azimuth_noise: Angle = Field(default=0.0, ge=0, description="[rad] standard deviation of the azimuth")
    range_rate_noise: Speed = Field(default=0.0, ge=0, description="[m/s] standard deviation of the range rate")
    ground: bool = Field(default=False, description="[-] whether the ground is a target")

    @model_validator(mode="after")
    def _few_rays(self) -> Self:
        check_rays(self.columns, self.rows)
        return self

    def field_of_view(self) -> FieldOfView:
        """Return the region between the outermost rays."""
        side, up = 0.5 * self.horizontal_fov, 0.5 * self.vertical_fov
        return FieldOfView((-side, side), (-up, up), (self.near, self.far))
