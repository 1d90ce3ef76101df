"""Replay of a recording: the pose at each time is that of the recording, without regard to others."""

from typing import Any, Final

from mirdrake.core.compiled import Records
from mirdrake.worlds.pieces import Array

LAW: Final = 4

FIRST: Final = 1
LAST: Final = 2
"""Numbers: first row of the recording of an actor, and one behind its last row."""


def replay_all(members: Records, numbers: Array, rows: Array, time: float, dt: float, after: Records) -> None:
    """Write the states of all recorded actors after a time step.

    Args:
        members: :class:`mirdrake.actors.step.Member` (n).
        numbers: parameters of the actors (n, 12).
        rows: time, x, y, yaw and the distance along the path of all recordings (k, 5) [s, m, m, rad, m].
        time: time at the begin of the step [s].
        dt: time step [s].
        after: next states; written.
    """
    for i in range(len(members)):
        if members[i].law == LAW:
            replay(rows, int(numbers[i, FIRST]), int(numbers[i, LAST]), time + dt, dt, after[i])


def replay(rows: Array, first: int, last: int, time: float, dt: float, row: Any) -> None:
    """Write the state at a time: linear between the samples; it is at rest before the first and after the last one."""
    low, high = first, last - 1
    row.a = -row.v / dt
    if rows[low, 0] <= time < rows[high, 0]:
        # Bisection: rows[low] is the last sample that is not later than the time.
        while high - low > 1:
            middle = (low + high) // 2
            if rows[middle, 0] <= time:
                low = middle
            else:
                high = middle
        step = rows[high, 0] - rows[low, 0]
        u = (time - rows[low, 0]) / step
        row.x = (1.0 - u) * rows[low, 1] + u * rows[high, 1]
        row.y = (1.0 - u) * rows[low, 2] + u * rows[high, 2]
        row.yaw = (1.0 - u) * rows[low, 3] + u * rows[high, 3]
        row.s = (1.0 - u) * rows[low, 4] + u * rows[high, 4]
        row.vx, row.vy = (rows[high, 1] - rows[low, 1]) / step, (rows[high, 2] - rows[low, 2]) / step
        row.wz = (rows[high, 3] - rows[low, 3]) / step
        v = (rows[high, 4] - rows[low, 4]) / step
        row.a = (v - row.v) / dt
        row.v = v
        return
    at = low if time < rows[low, 0] else high
    row.x, row.y, row.yaw, row.s = rows[at, 1], rows[at, 2], rows[at, 3], rows[at, 4]
    row.vx, row.vy, row.wz, row.v = 0.0, 0.0, 0.0, 0.0


PARTS = (replay_all, replay)
"""Compiled functions of this module."""
