"""Many manoeuvres at once: each is driven as alone, and the runs that they wait for are simulated as one batch."""

import threading
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Generic, TypeVar

from mirdrake.core.errors import ConfigError
from mirdrake.manoeuvres.base import ManoeuvreSpec, Outcome
from mirdrake.manoeuvres.reduced import ReducedLog, ReducedParameters, ReducedRun, simulate
from mirdrake.manoeuvres.registry import run_manoeuvre
from mirdrake.manoeuvres.rig import Rig

T = TypeVar("T")

Simulate = Callable[[ReducedRun], ReducedLog]

_STACK = 1 << 20
"""Stack of a thread [B]; the default of 8 MB is more than hundreds of them need."""


class _Cancelled(BaseException):
    """Ends the thread of a drive whose run will not be simulated."""


class _Drive(threading.Thread, Generic[T]):
    """A function in a thread that stops whenever it waits for a run: a coroutine, which the function need not know.

    Attributes:
        request: run that it waits for; None before the start and after the end.
        result: its result, or the exception that it raised; None before the end.

    Args:
        function: takes a function that simulates a run.
    """

    def __init__(self, function: Callable[[Simulate], T]) -> None:
        super().__init__(daemon=True)
        self.request: ReducedRun | None = None
        self.result: T | Exception | None = None
        self._function = function
        self._reply: ReducedLog | BaseException | None = None
        # Of the two semaphores exactly one is free at any time: either the thread runs or its caller.
        self._go, self._stopped = threading.Semaphore(0), threading.Semaphore(0)
        self.start()

    def run(self) -> None:
        """Run the function; called by the thread."""
        self._go.acquire()
        try:
            self.result = self._function(self._simulate)
        except _Cancelled:
            pass
        except Exception as error:
            self.result = error
        finally:
            self.request = None
            self._stopped.release()

    def _simulate(self, run: ReducedRun) -> ReducedLog:
        self.request = run
        self._stopped.release()
        self._go.acquire()
        reply = self._reply
        assert reply is not None
        if isinstance(reply, BaseException):
            raise reply
        return reply

    def resume(self, reply: ReducedLog | BaseException | None) -> None:
        """Let the function run until it waits for the next run, or ends.

        Args:
            reply: log of the run that it waits for, or an exception that is raised there; None at the start.
        """
        self._reply = reply
        self._go.release()
        self._stopped.acquire()


def drive_together(functions: Sequence[Callable[[Simulate], T]], known: ReducedParameters) -> list[T | Exception]:
    """Call functions that simulate runs; those that wait are simulated as one batch.

    Args:
        functions: each takes a function that simulates a run of the single-track model.
        known: parameters that are kept.

    Returns:
        The result of each function, or the exception that it raised.
    """
    before = threading.stack_size(_STACK)
    try:
        drives = [_Drive(function) for function in functions]
    finally:
        threading.stack_size(before)
    try:
        for drive in drives:
            drive.resume(None)
        while waiting := [drive for drive in drives if drive.request is not None]:
            runs = [drive.request for drive in waiting if drive.request is not None]
            for drive, reply in zip(waiting, _simulate_all(runs, known), strict=True):
                drive.resume(reply)
    except BaseException:
        for drive in drives:
            if drive.is_alive():
                drive.resume(_Cancelled())
        raise
    results = []
    for drive in drives:
        assert drive.result is not None
        results.append(drive.result)
    return results


def _simulate_all(runs: Sequence[ReducedRun], known: ReducedParameters) -> Sequence[ReducedLog | Exception]:
    """Return the logs of runs; a run with a fault does not stop the others."""
    try:
        return simulate(runs, known)
    except ConfigError as error:
        if len(runs) == 1:
            return [error]
        # The fault is in one of them: each alone.
        return [result for run in runs for result in _simulate_all([run], known)]


def run_manoeuvres(name: str, rigs: Sequence[Rig], specs: Sequence[ManoeuvreSpec]) -> list[Outcome | Exception]:
    """Drive one manoeuvre with many cars of the single-track model; each outcome is that of the car alone.

    Args:
        name: name of the manoeuvre.
        rigs: vehicle and conditions of each car; all have the same vehicle.
        specs: settings of each car.

    Returns:
        The outcome of each car, or the exception that its manoeuvre raised.
    """

    def drive(rig: Rig, spec: ManoeuvreSpec) -> Callable[[Simulate], Outcome]:
        return lambda simulate_run: run_manoeuvre(name, replace(rig, simulate=simulate_run, records=[]), spec)

    return drive_together([drive(rig, spec) for rig, spec in zip(rigs, specs, strict=True)], ReducedParameters())
