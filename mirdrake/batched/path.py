"""Path trackers of the cars of a batch."""

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from mirdrake.batched.arrays import Floats
from mirdrake.controllers.ackermann import SteeringGeometry
from mirdrake.controllers.drivable_line import DrivingLimits, Track
from mirdrake.controllers.path_law import PathNumbers, TrackerNumbers
from mirdrake.controllers.path_tracking import PathGains, PathTracker
from mirdrake.core.compiled import records
from mirdrake.core.errors import ConfigError, did_you_mean


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

    def numbers(self, count: int, control_period: float) -> tuple[Any, ...]:
        """Return the path trackers of `count` cars as compiled loops take them.

        Raises:
            ConfigError: a gain has another number of values or is out of range, or the period does not fit.
        """
        # The tracker runs at control instants, as the unit reads its command there.
        every = round(self.period / control_period)
        if every < 1 or abs(every * control_period - self.period) > 1e-9:
            raise ConfigError(
                f"path driver: a period of {self.period:g} s is not a multiple of the control period, "
                f"{control_period:g} s"
            )
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
        return (
            records(PathNumbers, [path.numbers]),
            np.array(path.rows),
            np.array(rows),
            np.array(which),
            records(TrackerNumbers, [self._tracker.numbers]),
            records(PathGains, gains),
            every,
        )


_NOTHING: Floats = np.empty((0, 4))
NO_PATH: tuple[Any, ...] = (
    records(PathNumbers, [PathNumbers(1.0, 1.0, False, 0)]),
    _NOTHING,
    _NOTHING[None],
    np.zeros(1, dtype=np.int64),
    records(TrackerNumbers, [TrackerNumbers(*[1.0] * 7)]),
    records(PathGains, [PathGains(0.0)]),
    1,
)
"""Numbers for cars that follow commands."""
