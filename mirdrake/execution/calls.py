"""Many calls through an executor, of which each may be lost without affecting the others."""

import os
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Executor, Future, wait
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from mirdrake.core.errors import ConfigError, RunError, one_line
from mirdrake.execution.workers import InProcess, WorkerLostError, Workers

AHEAD = 256
"""Number of calls that are submitted to a user's executor before earlier ones have returned."""

WAIT = 0.5
"""Longest uninterrupted wait for a result [s], so that Ctrl-C is noticed on every system."""


@dataclass(frozen=True)
class Lost:
    """A call without a result.

    Attributes:
        reason: one line: the exception, or how its process ended.
        seconds: wall time since the call began, if its process was lost [s].
    """

    reason: str
    seconds: float = 0.0


@contextmanager
def open_executor(
    executor: Executor | None, workers: int | None, *, calls: int, limit: float | Callable[..., float]
) -> Iterator[tuple[Executor, int]]:
    """Yield an executor, and the number of calls to submit ahead; our own worker processes end with the block.

    Args:
        executor: the user's executor; it is not shut down.
        workers: number of processes if no executor is given; 0: this process; None: as many as cores.
        calls: number of calls that will be made; no more processes than that are started.
        limit: wall time that a call may take in worker processes [s]; or a function of its arguments that returns it.

    Raises:
        ConfigError: a negative number of workers.
    """
    if workers is not None and workers < 0:
        raise ConfigError(f"workers: {workers} is not allowed; it must be at least 0")
    # No more processes than calls, as each takes time to start.
    count = min(os.cpu_count() or 1 if workers is None else workers, calls)
    if executor is not None:
        yield executor, AHEAD
    elif count == 0:
        yield InProcess(), 1
    else:
        own = Workers(count, limit=limit)
        try:
            # Two calls per process keep it busy while the main process handles a result.
            yield own, 2 * count
        finally:
            own.shutdown(cancel_futures=True)


def call_all(
    executor: Executor,
    function: Callable[..., Any],
    arguments: Iterable[tuple[Any, ...]],
    *,
    ahead: int,
) -> Generator[tuple[int, Any], None, None]:
    """Call a function with each of the arguments; yield position and result, or :class:`Lost`, as they finish.

    Args:
        executor: makes the calls.
        function: must be picklable, as must its arguments, unless the executor stays in this process.
        arguments: consumed one by one, as far ahead as needed.
        ahead: number of calls that are submitted at a time.

    Raises:
        RunError: the executor has failed, or worker processes cannot start.
    """
    rest = enumerate(arguments)
    waiting: dict[Future[Any], int] = {}
    try:
        while True:
            # Only a window of calls is submitted: a study may have a million, and the arguments are made on demand.
            while len(waiting) < ahead and (entry := next(rest, None)) is not None:
                waiting[executor.submit(function, *entry[1])] = entry[0]
            if not waiting:
                return
            # With a timeout: on some systems, a wait without one cannot be interrupted by Ctrl-C.
            done, _ = wait(waiting, timeout=WAIT, return_when=FIRST_COMPLETED)
            for future in done:
                yield waiting.pop(future), _result(future)
    finally:
        # The generator was closed early; calls that have not begun need not be made.
        for future in waiting:
            future.cancel()


def _result(future: Future[Any]) -> Any:
    """Return the result of a call, or why there is none."""
    try:
        return future.result()
    except (BrokenExecutor, CancelledError) as error:
        raise RunError(f"the executor has failed ({one_line(error)}); resume with another one") from None
    except RunError:  # its processes cannot start
        raise
    except WorkerLostError as error:
        return Lost(str(error), error.seconds)
    except Exception as error:
        return Lost(one_line(error))
