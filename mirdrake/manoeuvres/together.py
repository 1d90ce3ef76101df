"""Many manoeuvres at once: each is driven as alone, and the runs that they wait for are simulated as one batch."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Generic, TypeVar

from greenlet import greenlet

from mirdrake.core.errors import ConfigError
from mirdrake.manoeuvres.base import ManoeuvreSpec, Outcome
from mirdrake.manoeuvres.reduced import ReducedLog, ReducedParameters, ReducedRun, simulate
from mirdrake.manoeuvres.registry import run_manoeuvre
from mirdrake.manoeuvres.rig import Rig

T = TypeVar("T")

Simulate = Callable[[ReducedRun], ReducedLog]


class _Drive(Generic[T]):
    """A function that stops whenever it waits for a run: a coroutine, which the function need not know.

    Attributes:
        request: run that it waits for; None before the start and after the end.
        result: its result, or the exception that it raised; None before the end.

    Args:
        function: takes a function that simulates a run.
    """

    def __init__(self, function: Callable[[Simulate], T]) -> None:
        self.request: ReducedRun | None = None
        self.result: T | Exception | None = None
        self._function = function
        # Not a thread: a thread that waits for another one is woken late on a processor whose cores are all busy.
        self._greenlet = greenlet(self._run)

    def resume(self, reply: ReducedLog | Exception | None) -> None:
        """Let the function run until it waits for the next run, or ends.

        Args:
            reply: log of the run that it waits for, or an exception that is raised there; None at the start.
        """
        if isinstance(reply, Exception):
            self._greenlet.throw(reply)
        else:
            self._greenlet.switch(reply)

    def _run(self, _: None) -> None:
        try:
            self.result = self._function(self._simulate)
        except Exception as error:
            self.result = error
        self.request = None

    def _simulate(self, run: ReducedRun) -> ReducedLog:
        self.request = run
        parent = self._greenlet.parent
        assert parent is not None
        reply: ReducedLog = parent.switch()
        return reply


def drive_together(functions: Sequence[Callable[[Simulate], T]], known: ReducedParameters) -> list[T | Exception]:
    """Call functions that simulate runs; those that wait are simulated as one batch.

    Args:
        functions: each takes a function that simulates a run of the single-track model.
        known: parameters that are kept.

    Returns:
        The result of each function, or the exception that it raised.
    """
    drives = [_Drive(function) for function in functions]
    for drive in drives:
        drive.resume(None)
    while waiting := [drive for drive in drives if drive.request is not None]:
        runs = [drive.request for drive in waiting if drive.request is not None]
        for drive, reply in zip(waiting, _simulate_all(runs, known), strict=True):
            drive.resume(reply)
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
