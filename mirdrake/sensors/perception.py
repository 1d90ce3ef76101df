"""Processing of range scans: the distance to the nearest object ahead, and overlays of lidar clouds in Meshcat."""

from collections.abc import Mapping
from math import inf, isfinite, nan

import numpy as np
from numpy.typing import ArrayLike
from pydrake.common.value import AbstractValue
from pydrake.geometry import Meshcat, Rgba
from pydrake.math import RigidTransform
from pydrake.perception import BaseField, Fields, PointCloud
from pydrake.systems.framework import Context, DiagramBuilder, DiscreteValues, EventStatus

from mirdrake.core.errors import ConfigError
from mirdrake.core.leaf_system import LeafSystem
from mirdrake.core.signals import Signal, declare_state_output, declare_vector_input, signals
from mirdrake.sensors.ranging.laser_scanner import LaserScanner
from mirdrake.sensors.ranging.lidar import Lidar, LidarScan
from mirdrake.sensors.sampling import STAMP

SECTOR = 0.1
"""Half the sector that a distance estimator looks at [rad]."""

NEAREST = signals(
    ("distance", "m", "of the nearest return; inf: none"),
    ("angle", "rad", "of that return, positive to the left; 0 without one"),
    ("relative_speed", "m/s", "at which it moves away, negative when it comes nearer; 0 until it is known"),
)
"""Output of a distance estimator."""


def nearest_return(
    ranges: ArrayLike, angles: ArrayLike, *, low: float = -SECTOR, high: float = SECTOR
) -> tuple[float, float]:
    """Return distance [m] and angle [rad] of the nearest return in a sector; inf and 0 if there is none.

    Args:
        ranges: ranges along the beams, inf: no return (n) [m].
        angles: angles of the beams, positive to the left (n) [rad].
        low: lower end of the sector [rad]; both ends are included.
        high: upper end of the sector [rad].
    """
    distance, angle = np.asarray(ranges, dtype=float), np.asarray(angles, dtype=float)
    seen = np.flatnonzero((angle >= low) & (angle <= high) & np.isfinite(distance))
    if not seen.size:
        return inf, 0.0
    # argmin within the sector, then back to the index over all beams.
    best = seen[np.argmin(distance[seen])]
    return float(distance[best]), float(angle[best])


class DistanceEstimator(LeafSystem):
    """Nearest return of a laser scanner in a sector, and its rate of change.

    It reads its inputs at a rate and evaluates each scan once, when its stamp changes. The relative speed is the change
    of distance from one scan to the next over the time between them, optionally with a first-order filter. A change
    that needs more than `max_speed` means that another object came into view: the speed starts from 0 again.

    Input ports:
        ranges (beams) [m]: the ``sample`` of a :class:`mirdrake.sensors.LaserScanner`.
        stamp (1) [s]: its ``stamp``.
    Output ports:
        nearest (3) [m, rad, m/s]: :data:`NEAREST`.

    Args:
        beams: beams of the scanner.
        start_angle: angle of the first beam [rad].
        end_angle: angle of the last beam [rad].
        low: lower end of the sector [rad], positive to the left.
        high: upper end of the sector [rad].
        rate: updates per second [Hz].
        filter_time: time constant of the speed's filter [s]; 0: none.
        max_speed: largest plausible change of distance [m/s].

    Raises:
        ConfigError: a number out of range, or a sector without beams.
    """

    def __init__(
        self,
        *,
        beams: int,
        start_angle: float,
        end_angle: float,
        low: float = -SECTOR,
        high: float = SECTOR,
        rate: float = 100.0,
        filter_time: float = 0.0,
        max_speed: float = 100.0,
    ) -> None:
        super().__init__()
        # A setting that is out of range would give silent nonsense in every step.
        for name, value, minimum in (("beams", beams, 1), ("filter_time", filter_time, 0.0)):
            if not (isfinite(value) and value >= minimum):
                raise ConfigError(f"distance estimator: {name} is {value}; it should be at least {minimum:g}")
        for name, value in (("rate", rate), ("max_speed", max_speed)):
            if not (isfinite(value) and value > 0.0):
                raise ConfigError(f"distance estimator: {name} is {value}; it should be above 0")
        self.angles = np.linspace(start_angle, end_angle, beams)
        if not ((self.angles >= low) & (self.angles <= high)).any():
            raise ConfigError(
                f"distance estimator: no beam from {start_angle:g} to {end_angle:g} rad lies between low ({low:g}) "
                f"and high ({high:g}) rad; widen the sector"
            )
        self._low, self._high = low, high
        self._filter_time, self._max_speed = filter_time, max_speed
        contents = [Signal(f"beam{index}", "m") for index in range(beams)]
        self.ranges = declare_vector_input(self, "ranges", contents)
        self.stamp = declare_vector_input(self, "stamp", STAMP)
        self._held = self.DeclareDiscreteState([inf, 0.0, 0.0])
        self._seen = self.DeclareDiscreteState([-inf])  # stamp of the scan that was taken last
        self.nearest = declare_state_output(self, "nearest", NEAREST, self._held)
        self.DeclarePeriodicDiscreteUpdateEvent(1.0 / rate, 0.0, self._look)

    @classmethod
    def of(cls, scanner: LaserScanner, *, low: float = -SECTOR, high: float = SECTOR) -> "DistanceEstimator":
        """Return an estimator for a scanner; its two input ports are not connected."""
        mount = scanner.mount
        return cls(beams=mount.beams, start_angle=mount.start_angle, end_angle=mount.end_angle, low=low, high=high)

    def _look(self, context: Context, state: DiscreteValues) -> None:
        stamp = float(self.stamp.Eval(context)[0])
        before = float(context.get_discrete_state(self._seen).get_value()[0])
        if stamp == before:
            return
        distance, angle = nearest_return(self.ranges.Eval(context), self.angles, low=self._low, high=self._high)
        last, _, speed = context.get_discrete_state(self._held).get_value().tolist()
        # NaN for an unknown speed fails every comparison below, so that the speed starts from 0.
        change = (distance - last) / (stamp - before) if isfinite(before) and isfinite(last + distance) else nan
        if abs(change) <= self._max_speed:
            # Exact discretisation of a first-order filter for the time between two scans, which varies with dropout.
            share = 1.0 if not self._filter_time else 1.0 - np.exp(-(stamp - before) / self._filter_time)
            speed += share * (change - speed)
        else:
            speed = 0.0
        state.get_mutable_vector(self._held).SetFromVector([distance, angle, speed])
        state.get_mutable_vector(self._seen).SetFromVector([stamp])


class CloudOverlay(LeafSystem):
    """Overlay of the returns of a lidar in Meshcat, at their places in the world.

    Input ports:
        cloud: the output of a :class:`mirdrake.sensors.Lidar`.

    Args:
        meshcat: Meshcat instance in which to draw.
        path: path in Meshcat.
        scan: a scan of the lidar, for the type of the port.
        rate: drawings per second [Hz].
    """

    def __init__(self, meshcat: Meshcat, path: str, *, scan: LidarScan, rate: float = 10.0) -> None:
        super().__init__()
        self._meshcat: Meshcat | None = meshcat
        self._path = path
        self.cloud = self.DeclareAbstractInputPort("cloud", AbstractValue.Make(scan))
        self.DeclarePeriodicPublishEvent(1.0 / rate, 0.0, self._draw)

    def _draw(self, context: Context) -> EventStatus:
        if self._meshcat is None:
            return EventStatus.DidNothing()
        points = self.cloud.Eval(context).points_in_world()
        try:
            show_points(self._meshcat, self._path, points)
        except RuntimeError:  # Meshcat has ended; the simulation continues
            self._meshcat = None
        return EventStatus.Succeeded()


def show_points(
    meshcat: Meshcat, path: str, points: ArrayLike, *, point_size: float = 0.05, height: float = 3.0
) -> None:
    """Draw points in Meshcat, coloured by height from blue on the ground to red.

    Args:
        meshcat: Meshcat instance in which to draw.
        path: path in Meshcat; its present contents are replaced.
        points: points in the world (n, 3) [m].
        point_size: size of a point [m].
        height: height of the last colour [m].
    """
    places = np.asarray(points, dtype=float).reshape(-1, 3)
    cloud = PointCloud(len(places), Fields(BaseField.kXYZs | BaseField.kRGBs))
    if len(places):
        cloud.mutable_xyzs()[:] = places.T
        share = np.clip(places[:, 2] / height, 0.0, 1.0)
        # Blue on the ground, green at half the height, red at the top.
        colours = np.array([255.0 * share, 255.0 * (1.0 - np.abs(2.0 * share - 1.0)), 255.0 * (1.0 - share)])
        cloud.mutable_rgbs()[:] = colours.astype(np.uint8)
    meshcat.SetObject(path, cloud, point_size, Rgba(1.0, 1.0, 1.0))  # which the points' own are multiplied with
    meshcat.SetTransform(path, RigidTransform())


def add_cloud_overlays(builder: DiagramBuilder, meshcat: Meshcat, lidars: Mapping[str, Lidar]) -> None:
    """Draw the clouds of lidars in Meshcat, under ``clouds/<name>``.

    Args:
        builder: builder of the diagram that the lidars are in.
        meshcat: Meshcat instance in which to draw.
        lidars: lidars by name, for example ``ego.roof_lidar``.
    """
    for name, lidar in lidars.items():
        overlay = CloudOverlay(meshcat, f"clouds/{name.replace('.', '/')}", scan=lidar.empty, rate=lidar.rate)
        builder.AddNamedSystem(f"overlay/{name}", overlay)
        builder.Connect(lidar.cloud, overlay.cloud)
