"""Laser scanners with one plane, such as those of SICK and Hokuyo."""

from typing import Any, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, model_validator
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Frame
from pydrake.systems.framework import Context, DiscreteValues

from mirdrake.core.signals import Signal
from mirdrake.core.yaml_io import Angle
from mirdrake.sensors.ranging.beams import turning
from mirdrake.sensors.ranging.caster import Caster
from mirdrake.sensors.ranging.faces import Array
from mirdrake.sensors.ranging.mount import Turning, ascending, within_turn
from mirdrake.sensors.ranging.world import RayWorld
from mirdrake.sensors.sampling import SampledSensor
from mirdrake.vehicles.mount import FieldOfView


class LaserScanner(SampledSensor):
    """Laser scanner: distances along beams in the plane z = 0 of its frame.

    A scan is complete at the time of the sample, when the last beam leaves. The mirror makes one turn in a period; the
    beams before the last one are cast from the pose that the sensor had when they left, see :attr:`times`.

    Input ports:
        body_poses: the plant's output.
        body_spatial_velocities: the plant's output.
    Output ports:
        sample (beams) [m]: distance along each beam, inf: no return, nearer than the near limit or beyond the far one.
        stamp (1) [s]: when the sample was taken.

    Args:
        world: surfaces that give returns.
        frame: frame of the scanner; fixed to a body.
        mount: beams, limits, rate and noise.
        stream: stream from :func:`mirdrake.sensors.noise.noise_stream`.
        hidden: bodies that give no returns.

    Attributes:
        angles: angles of the beams, positive to the left (beams) [rad].
        times: times of the beams after the stamp, 0 or negative (beams) [s].
        record: recording of samples.
    """

    record = "array"

    def __init__(
        self,
        world: RayWorld,
        frame: Frame,
        mount: "LaserScannerMount",
        *,
        stream: int = 0,
        hidden: tuple[int, ...] = (),
    ) -> None:
        super().__init__(
            tuple(Signal(f"beam{index}", "m") for index in range(mount.beams)),
            mount,
            stream=stream,
            initial=np.full(mount.beams, np.inf).tolist(),
        )
        self.mount, self._frame = mount, frame.index()
        self.angles = np.linspace(mount.start_angle, mount.end_angle, mount.beams)
        beams = turning(self.angles, [0.0], rate=mount.rate, rolling=mount.rolling)
        self.times = beams.times
        self.caster = Caster(self, world, frame, mount, beams, stream=stream, hidden=hidden)

    def measure(self, context: Context) -> Array:
        """Return the scan that is complete now [m] (beams), with noise."""
        distance = self.caster.look(context).distance[:, 0]
        return self.caster.reading(distance, round(context.get_time() * self.rate))

    def points_seen(self, context: Context, plant: MultibodyPlant) -> tuple[float, Array]:
        """Return the present time [s] and the points of the last scan (n, 3) [m] in the world, at the present pose.

        Args:
            context: context of the diagram.
            plant: the plant.
        """
        ranges = np.asarray(self.GetOutputPort("sample").Eval(self.GetMyContextFromRoot(context)))
        hit = np.isfinite(ranges) & (ranges > 0.0)
        in_plane = ranges[hit, None] * np.column_stack((np.cos(self.angles[hit]), np.sin(self.angles[hit])))
        X_WS = plant.get_frame(self._frame).CalcPoseInWorld(plant.GetMyContextFromRoot(context))
        points: Array = in_plane @ X_WS.rotation().matrix()[:, :2].T + X_WS.translation()
        return context.get_time(), points

    def keep(self, context: Context, state: DiscreteValues) -> None:
        """Store the present poses for the next scan."""
        self.caster.keep(context, state)


class LaserScannerMount(Turning):
    """Rotating laser scanner with one plane."""

    system: ClassVar[Any] = LaserScanner
    kind: Literal["laser_scanner"]
    beams: int = Field(gt=0, le=100_000, description="beams per scan")
    start_angle: Angle = Field(ge=-6.3, le=6.3, description="[rad] azimuth of the first beam, positive to the left")
    end_angle: Angle = Field(ge=-6.3, le=6.3, description="[rad] azimuth of the last beam")

    @model_validator(mode="after")
    def _one_turn(self) -> Self:
        self.end_angle = within_turn(self.start_angle, self.end_angle)
        return self

    def field_of_view(self) -> FieldOfView:
        """Return the fan of beams."""
        return FieldOfView(ascending(self.start_angle, self.end_angle), (0.0, 0.0), (self.near, self.far))
