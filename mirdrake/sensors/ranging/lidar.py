"""Lidars with several planes, such as those of Velodyne."""

from dataclasses import dataclass
from typing import Any, ClassVar, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator
from pydrake.common.value import AbstractValue
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Frame
from pydrake.systems.framework import Context, State

from mirdrake.core.yaml_io import Angle
from mirdrake.sensors.ranging.beams import grid, turning
from mirdrake.sensors.ranging.caster import Caster
from mirdrake.sensors.ranging.faces import Array
from mirdrake.sensors.ranging.motion import rotations
from mirdrake.sensors.ranging.mount import Turning, ascending, check_rays, within_turn
from mirdrake.sensors.ranging.world import RayWorld
from mirdrake.sensors.sampling import SampledValue
from mirdrake.vehicles.mount import FieldOfView


@dataclass(frozen=True)
class LidarScan:
    """One revolution of a lidar.

    Attributes:
        time: when it was complete [s]; -inf before the first one.
        ranges: distance along each beam (rows, columns) [m], inf: no return. Rows from the lowest to the highest as
            of the mount, columns in the order in which they leave.
        beam_times: when the columns left (columns) [s].
        azimuths: azimuths of the columns, positive to the left (columns) [rad].
        elevations: elevations of the rows, positive upwards (rows) [rad].
        pose: true pose X_WS of the sensor at `time` as a matrix (3, 4), which a real lidar does not measure.
        twist: its true angular velocity [rad/s] and velocity [m/s] at `time`, in the world (6).
    """

    time: float
    ranges: NDArray[np.float32]
    beam_times: Array
    azimuths: Array
    elevations: Array
    pose: Array
    twist: Array

    def points(self) -> Array:
        """Return the hits of the beams, each in the frame of the sensor at the time of the beam (n, 3) [m].

        As those of a real sensor, they are not corrected for the motion of the vehicle. Beams without return are left
        out.
        """
        # Columns leave one after the other, so that beams are made by columns; ranges are stored by rows.
        places = grid(self.azimuths, self.elevations).transpose(1, 0, 2) * self.ranges[:, :, None]
        hits: Array = places[np.isfinite(self.ranges)]
        return hits

    def points_in_world(self) -> Array:
        """Return the hits of the beams in the world (n, 3) [m], by the sensor's pose at the time of each column.

        The true pose and twist are used; the twist is assumed to be constant during a revolution of the sensor.
        """
        if not np.isfinite(self.time):
            return np.empty((0, 3))
        # Time of each column before the end of the turn, negative.
        ago = self.beam_times - self.time
        R = rotations(ago[:, None] * self.twist[:3]) @ self.pose[:, :3]
        places = grid(self.azimuths, self.elevations) * self.ranges.T[:, :, None]
        with np.errstate(invalid="ignore"):  # inf of beams without return
            places = np.einsum("cij,crj->cri", R, places)
        # On a circle the mean direction of the path is that at half of the angle turned.
        chord = rotations(0.5 * ago[:, None] * self.twist[:3]) @ self.twist[3:]
        places += (self.pose[:, 3] + ago[:, None] * chord)[:, None]
        hits: Array = places.transpose(1, 0, 2)[np.isfinite(self.ranges)]
        return hits


class Lidar(SampledValue):
    """Lidar: a cloud of distances, by planes and columns.

    A turn is complete at the time of the sample, when the last column leaves. The columns before it are cast from the
    pose that the sensor had when they left, to the poses that other bodies had at that time.

    Input ports:
        body_poses: the plant's output.
        body_spatial_velocities: the plant's output.
    Output ports:
        cloud: the last :class:`LidarScan`.
        stamp (1) [s]: when it was complete.

    Args:
        world: surfaces that give returns.
        frame: frame of the lidar; fixed to a body.
        mount: planes, columns, limits, rate and noise.
        stream: stream from :func:`mirdrake.sensors.noise.noise_stream`.
        hidden: bodies that give no returns.

    Attributes:
        azimuths: azimuths of the columns, positive to the left (columns) [rad].
        elevations: elevations of the rows, positive upwards (rows) [rad].
        empty: output before the first turn is complete.
        record: recording of samples.
        has_cloud_overlay: whether a live view draws the output ``cloud``.
    """

    record = "array"
    has_cloud_overlay = True

    def __init__(
        self, world: RayWorld, frame: Frame, mount: "LidarMount", *, stream: int = 0, hidden: tuple[int, ...] = ()
    ) -> None:
        self.mount = mount
        self.azimuths = np.linspace(mount.horizontal_start, mount.horizontal_end, mount.columns)
        self.elevations = np.linspace(mount.vertical_start, mount.vertical_end, mount.rows)
        beams = turning(self.azimuths, self.elevations, rate=mount.rate, rolling=mount.rolling)
        nothing = np.full((mount.rows, mount.columns), np.inf, dtype=np.float32)
        never, nowhere = np.full(mount.columns, -np.inf), np.eye(3, 4)
        self.empty = LidarScan(-np.inf, nothing, never, self.azimuths, self.elevations, nowhere, np.zeros(6))
        super().__init__("cloud", AbstractValue.Make(self.empty), mount, stream=stream)
        self.cloud = self.value
        self.caster = Caster(self, world, frame, mount, beams, stream=stream, hidden=hidden)

    def look(self, context: Context) -> LidarScan:
        """Return the revolution that is complete now, with noise.

        Args:
            context: context of this system.
        """
        # The states are evaluated once, for the beams and for the pose in the scan.
        time, states = context.get_time(), self.caster.states(context)
        ranges = self.caster.reading(self.caster.look(context, states).distance, round(time * self.rate))
        own, X_BS = states[self.caster.carrier], self.caster.X_BS
        arm = own.R @ X_BS.translation()
        return LidarScan(
            time,
            np.ascontiguousarray(ranges.T, dtype=np.float32),
            time + self.caster.beams.times,
            self.azimuths,
            self.elevations,
            np.column_stack((own.R @ X_BS.rotation().matrix(), own.p + arm)),
            # Velocity of the sensor: v_S = v_B + w x p_BS, in the world.
            np.concatenate((own.w, own.v + np.cross(own.w, arm))),
        )

    def points_seen(self, context: Context, plant: MultibodyPlant) -> tuple[float, Array]:
        """Return the time of the last scan [s] and its points in the world (n, 3) [m]; context of the diagram."""
        del plant  # a scan contains its pose
        scan: LidarScan = self.cloud.Eval(self.GetMyContextFromRoot(context))
        return scan.time, scan.points_in_world()

    def take(self, context: Context, index: int, sample: AbstractValue) -> None:
        """Write the revolution that is complete now."""
        del index  # it follows from the time
        sample.set_value(self.look(context))

    def _update(self, context: Context, state: State) -> None:
        super()._update(context, state)
        # Stored after the sample was taken: the next turn begins where this one ended.
        self.caster.keep(context, state.get_mutable_discrete_state())


class LidarMount(Turning):
    """Rotating laser scanner with several planes."""

    system: ClassVar[Any] = Lidar
    kind: Literal["lidar"]
    columns: int = Field(gt=0, le=100_000, description="beams per plane and revolution")
    rows: int = Field(gt=0, le=1024, description="number of planes")
    horizontal_start: Angle = Field(
        ge=-6.3, le=6.3, description="[rad] azimuth of the first column, positive to the left"
    )
    horizontal_end: Angle = Field(ge=-6.3, le=6.3, description="[rad] azimuth of the last column")
    vertical_start: Angle = Field(ge=-1.6, le=1.6, description="[rad] elevation of the first plane, positive upwards")
    vertical_end: Angle = Field(ge=-1.6, le=1.6, description="[rad] elevation of the last plane")

    @model_validator(mode="after")
    def _one_turn(self) -> Self:
        self.horizontal_end = within_turn(self.horizontal_start, self.horizontal_end)
        check_rays(self.columns, self.rows)
        return self

    def field_of_view(self) -> FieldOfView:
        """Return the region between the outermost planes and columns."""
        across = ascending(self.horizontal_start, self.horizontal_end)
        return FieldOfView(across, ascending(self.vertical_start, self.vertical_end), (self.near, self.far))
