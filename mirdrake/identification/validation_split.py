"""Selection of validation data where no log is marked for validation."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mirdrake.identification.alignment import smooth
from mirdrake.identification.data import DataSet, Log
from mirdrake.identification.relations import make_grid
from mirdrake.readers.time_columns import MIN_ROWS

STRIDE = 3
"""Logs are ordered by lateral jerk; the second is used for validation, and every n-th after it."""


def split_validation(data: DataSet, part: float) -> DataSet:
    """Return a data set with some training logs for validation, the last of them cut in two.

    The log with the highest lateral jerk may be the only one that determines yaw inertia and delays, so it is used for
    validation last. Logs without turns are used from the last to the first.

    Args:
        data: logs; those for validation stay for validation.
        part: share of the time of all training logs [1].
    """
    left = part * sum(_span(log) for log in data.train)
    training, validation = {id(log): log for log in data.train}, []
    for log in _in_order(data.train):
        # Whole logs are taken as long as they fit into the share; the last one is cut.
        rows = int(np.searchsorted(log.time, log.time[-1] - left, side="right"))
        left = max(left - _span(log), 0.0)
        if rows >= len(log.time) - MIN_ROWS:
            break
        if rows < MIN_ROWS:
            del training[id(log)]
            validation.append(replace(log, use="validation"))
        else:
            training[id(log)] = _rows(log, slice(0, rows), log.name, "train")
            validation.append(_rows(log, slice(rows, None), f"{log.name}, end", "validation"))
    return replace(data, logs=(*training.values(), *data.validation, *validation))


def _in_order(logs: Sequence[Log]) -> list[Log]:
    """Return logs in the order in which they are used for validation."""
    jerks = [lateral_jerk(log) for log in logs]
    if not any(jerks):
        return list(reversed(logs))
    ranked = [logs[i] for i in np.argsort(np.negative(jerks), kind="stable")]
    # From the second on, every third log: both parts get lively and calm drives, and the liveliest stays for training.
    return [log for first in (1, 2, 0) for log in ranked[first::STRIDE]]


def lateral_jerk(log: Log) -> float:
    """Return the lateral jerk that a log exceeds in 1 % of its time [m/s³]; 0 if unknown."""
    grid = make_grid(log)
    forward = "vx" if "vx" in grid.channels else "speed"
    if "yaw_rate" in grid.channels and forward in grid.channels:
        side = smooth(grid, forward) * smooth(grid, "yaw_rate")
    elif "lateral_acceleration" in grid.channels:
        side = smooth(grid, "lateral_acceleration")
    else:
        return 0.0
    return float(np.percentile(np.abs(grid.rate(side)), 99.0))


def _span(log: Log) -> float:
    return float(log.time[-1] - log.time[0])


def _rows(log: Log, rows: slice, name: str, use: str) -> Log:
    return Log(name, use, log.time[rows], {key: values[rows] for key, values in log.channels.items()}, log.notes)
