"""Processor time in seconds of a reference machine, comparable between slow and busy machines."""

import time
from collections.abc import Callable

_ADDITIONS = 1_000_000
# What the yardstick takes on the machine on which limits of tests were set, idle [s].
_REFERENCE = 0.05


def reference_seconds(
    job: Callable[[], object], *, times: int = 3, clock: Callable[[], float] = time.process_time
) -> float:
    """Return the least time of `times` runs of `job` [s], as the reference machine would have taken it.

    Each run is compared with a yardstick of plain Python right before and right after it: a machine that is slower
    at this moment, by its make or by what else runs on it, is slower at both. A faster machine is not slowed down.
    """
    return min(_one(job, clock) for _ in range(times))


def is_within(taken: float, limit: float) -> bool:
    """Return whether a job that has just taken this processor time keeps to a limit of the reference machine [s].

    The machine is measured only if the job took longer than that.
    """
    return taken < limit or taken / max(1.0, _yardstick(time.process_time) / _REFERENCE) < limit


def _one(job: Callable[[], object], clock: Callable[[], float]) -> float:
    before = _yardstick(clock)
    begun = clock()
    job()
    taken = clock() - begun
    return taken / max(1.0, 0.5 * (before + _yardstick(clock)) / _REFERENCE)


def _yardstick(clock: Callable[[], float]) -> float:
    begun, total = clock(), 0
    for number in range(_ADDITIONS):
        total += number
    return clock() - begun
