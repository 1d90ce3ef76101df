"""Path trackers of the cars of a batch."""

import math
from collections.abc import Mapping
from dataclasses import fields
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from mirdrake.batched.arrays import Floats, Integers
from mirdrake.batched.control_kernel import COMMAND, OWN, PATH, STARTED
from mirdrake.controllers.ackermann import SteeringGeometry
from mirdrake.controllers.drivable_line import DrivingLimits, Track
from mirdrake.controllers.path_law import (
    PATH_PARTS,
    Motion,
    PathNumbers,
    Place,
    TrackerNumbers,
    nearest_point,
    project,
    tracker_step,
)
from mirdrake.controllers.path_tracking import PathGains, PathTracker
from mirdrake.core.compiled import records
from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.maths import wrap_angle
from mirdrake.single_track.dynamics import State

_PROGRESS = PATH + 2
"""Index of the arc length on the centre line in the memory of a driver; the laps follow."""


class Trackers(NamedTuple):
    """Path trackers of all cars.

    Attributes:
        paths: one record of the numbers of the centre line.
        table: centre line.
        lines: drivable lines (lines, points, 4), see :mod:`mirdrake.controllers.path_law`.
        which: index of the line of each car (n).
        trackers: one record of the numbers of the path tracker.
        gains: gains of the path tracker, a record per car.
    """

    paths: Any
    table: Floats
    lines: Floats
    which: Integers
    trackers: Any
    gains: Any


def track(trackers: Trackers, i: int, x: State, rear_length: float, time: float, memory: Any) -> None:
    """Advance the path tracker of a car by a step, as :class:`mirdrake.controllers.path_tracking.PathTracker`.

    Args:
        trackers: trackers of all cars.
        i: index of the car.
        x: its states.
        rear_length: from the centre of mass to the rear axle [m].
        time: present time [s].
        memory: memory of the driver, updated.
    """
    path, table = trackers.paths[0], trackers.table
    # Newton's projection from the last place is cheap; the search over all points is for the start and for lost cars.
    started = memory[STARTED] != 0.0
    settled, place = False, Place(memory[_PROGRESS], 0.0, 0.0, 0.0)
    if started:
        settled, place = project(path, table, x.x, x.y, memory[_PROGRESS])
    if not settled:
        _, place = project(path, table, x.x, x.y, nearest_point(path, table, x.x, x.y))
    motion = Motion(x.x, x.y, wrap_angle(x.yaw), x.vx, x.vy - rear_length * x.yaw_rate, x.yaw_rate)
    speed, steering, memory[OWN] = tracker_step(
        path, table, trackers.lines[trackers.which[i]], trackers.gains[i], trackers.trackers[0], place, motion,
        memory[COMMAND], memory[OWN], started,
    )  # fmt: skip
    # The arc length of a closed track jumps at the start line: the shorter way round is the distance covered.
    covered = place.s - memory[_PROGRESS] if started else 0.0
    if path.closed:
        covered -= path.length * math.floor(covered / path.length + 0.5)
    memory[COMMAND], memory[COMMAND + 1], memory[COMMAND + 2] = speed, steering, time
    memory[PATH], memory[PATH + 1], memory[_PROGRESS] = place.lateral, wrap_angle(motion.yaw - place.yaw), place.s
    memory[_PROGRESS + 1], memory[STARTED] = memory[_PROGRESS + 1] + covered / path.length, 1.0


class PathDriver:
    """Path tracker of each car, as :class:`mirdrake.controllers.path_tracking.PathTracker`, on one track.

    Args:
        track: the track to follow.
        geometry: lengths and steering limits that the trackers calculate with, of a vehicle.
        gains: gains of all cars.
        columns: values (n) of gains that differ between the cars, by name.
        period: time between steps [s]; a multiple of the control period.
        limits: accelerations and tolerance.

    Raises:
        ConfigError: an unknown gain, one out of range, or a track that turns tighter than the vehicle can.
    """

    def __init__(
        self,
        track: Track,
        geometry: SteeringGeometry,
        gains: PathGains,
        *,
        columns: Mapping[str, ArrayLike] | None = None,
        period: float = 0.02,
        limits: DrivingLimits | None = None,
    ) -> None:
        # The tracker of one car checks the track against the vehicle, and its numbers serve all cars.
        self._tracker = PathTracker(track, geometry, gains=gains, period=period, limits=limits)
        self.gains, self.period = gains, period
        self._columns = {name: np.asarray(values, dtype=float) for name, values in (columns or {}).items()}
        known = [field.name for field in fields(PathGains)]
        for name in self._columns:
            if name not in known:
                raise ConfigError(f"path driver: no gain '{name}'; {did_you_mean(name, known)}")

    def numbers(self, count: int) -> Trackers:
        """Return the path trackers of `count` cars as compiled loops take them.

        Raises:
            ConfigError: a gain has another number of values or is out of range.
        """
        names = [field.name for field in fields(PathGains)]
        for name, values in self._columns.items():
            if values.shape not in ((), (count,)):
                raise ConfigError(
                    f"path driver: '{name}' has the shape {values.shape}; give a number, or one per car, ({count},)"
                )
        # One row of gains for each car, also where a gain is common to all.
        columns = [np.broadcast_to(self._columns.get(name, getattr(self.gains, name)), (count,)) for name in names]
        gains = [PathGains(*row) for row in np.column_stack(columns).tolist()]

        # Cars share the line of their set-point.
        lines: dict[int, int] = {}
        rows: list[list[list[float]]] = []
        which = []
        for row in gains:
            line = self._tracker.line_for(row.speed)
            if id(line) not in lines:
                lines[id(line)] = len(rows)
                rows.append(line)
            which.append(lines[id(line)])
        path = self._tracker.path
        return Trackers(
            records(PathNumbers, [path.numbers]),
            np.array(path.rows),
            np.array(rows),
            np.array(which),
            records(TrackerNumbers, [self._tracker.numbers]),
            records(PathGains, gains),
        )


TRACKER_PARTS: tuple[Any, ...] = (*PATH_PARTS, track)
"""Functions that the trackers need besides those of the loop."""
