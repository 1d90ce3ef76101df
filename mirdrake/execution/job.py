"""One run of a study: a pure function of its job, in whatever process."""

import json
import math
import random
import threading
import time
from collections import OrderedDict
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from pydrake.systems.framework import Context

from mirdrake.assembly.diagram import assemble
from mirdrake.assembly.diagram_spec import make_spec
from mirdrake.core.drake_errors import is_divergence
from mirdrake.core.errors import ConfigError, MirdrakeError, RunError, did_you_mean
from mirdrake.core.user_modules import load_own_function
from mirdrake.execution.parameters import Knob, find_knobs
from mirdrake.runs.simulation import Simulation

Status = Literal["ok", "unstable", "failed"]

KEPT = 4
"""Built diagrams that a process keeps."""


@dataclass(frozen=True)
class Job:
    """What to run; plain data, so that it can be sent to another process or computer.

    Attributes:
        index: number of the run in its study.
        diagram: data of the diagram, with this run's values at their paths.
        knobs: values of knobs, by name.
        metrics: what to measure, as in the study file.
        duration: simulated time [s].
        folder: where modules of metrics may lie.
        limit: wall time it may take [s].
    """

    index: int
    diagram: dict[str, Any]
    knobs: dict[str, float]
    metrics: tuple[str, ...]
    duration: float
    folder: str | None = None
    limit: float = math.inf


@dataclass(frozen=True)
class Outcome:
    """What became of a run.

    Attributes:
        index: number of the run.
        status: ok; unstable: it diverged; failed: it could not be run or measured.
        reason: one line; empty if ok.
        simulated: simulated time [s].
        metrics: a number each; empty unless ok.
    """

    index: int
    status: Status
    reason: str = ""
    simulated: float = math.nan
    metrics: tuple[float, ...] = ()


@dataclass
class _Built:
    simulation: Simulation
    knobs: dict[str, Knob]


class _Here(threading.local):
    """What this thread has built: a Simulation runs once at a time."""

    def __init__(self) -> None:
        self.built: OrderedDict[str, _Built] = OrderedDict()


_here = _Here()


def run_job(job: Job) -> Outcome:
    """Run a job; whatever happens is its outcome.

    The diagram is built only if this thread has not built it before; each run starts from a new Context, and from the
    same random numbers.

    Raises:
        KeyboardInterrupt: Ctrl-C in this process.
    """
    key = json.dumps(job.diagram, sort_keys=True)
    try:
        with _same_chances(), np.errstate(all="ignore"):
            return _run(job, _built(job, key))
    except MirdrakeError as error:
        _here.built.pop(key, None)  # what raised may be in any state
        line = str(error).splitlines()[0]
        unstable = isinstance(error, RunError) and is_divergence(line)
        return Outcome(job.index, "unstable" if unstable else "failed", line)
    except (Exception, SystemExit) as error:
        _here.built.pop(key, None)
        return Outcome(job.index, "failed", one_line(error))


def one_line(error: BaseException) -> str:
    """An exception in one line."""
    lines = str(error).strip().splitlines()
    return f"{type(error).__name__}: {lines[0]}" if lines else type(error).__name__


def _run(job: Job, built: _Built) -> Outcome:
    wanted = dict.fromkeys(function_of(name)[0] for name in job.metrics)
    functions = {name: load_own_function(name, folder=job.folder) for name in wanted if name}
    began, late = time.monotonic(), False

    def change(context: Context) -> None:
        for name, value in job.knobs.items():
            built.knobs[name].turn(built.simulation.assembly, context, value)

    def too_late(_: Context) -> bool:
        nonlocal late
        late = late or time.monotonic() - began > job.limit
        return late

    run = built.simulation.run(
        duration=job.duration, change=change, until=too_late if math.isfinite(job.limit) else None
    )
    reason, simulated = str(run.summary["stop_reason"]), float(run.summary["simulated_s"])
    if reason == "interrupted":
        raise KeyboardInterrupt
    if late:
        return Outcome(job.index, "failed", f"no end after {job.limit:g} s of wall time")
    if reason.startswith("diverged"):
        return Outcome(job.index, "unstable", reason, simulated)
    given: dict[str, Any] = {}
    for name, function in functions.items():
        try:
            given[name] = function(run)
        except (Exception, SystemExit) as error:
            return Outcome(job.index, "failed", f"metric {name}: {one_line(error)}", simulated)
    try:
        values = tuple(_measured(name, run.summary, given) for name in job.metrics)
    except ConfigError as error:
        return Outcome(job.index, "failed", str(error), simulated)
    return Outcome(job.index, "ok", "", simulated, values)


def _measured(name: str, summary: Mapping[str, Any], given: Mapping[str, Any]) -> float:
    """A metric as a number; one that the run cannot give is NaN."""
    function, key = function_of(name)
    value = given[function] if function else figure(summary, name)
    if key:
        if not (isinstance(value, Mapping) and key in value):
            known = did_you_mean(key, value) if isinstance(value, Mapping) else "it gives no mapping"
            raise ConfigError(f"metric {name}: {function} gives no '{key}'; {known}")
        value = value[key]
    try:
        return math.nan if value is None else float(value)
    except (TypeError, ValueError):
        raise ConfigError(f"metric {name}: a number is needed, not {type(value).__name__}") from None


def figure(summary: Mapping[str, Any], name: str) -> Any:
    """A figure of a summary by name: ``simulated_s``, or ``ego.distance_m``."""
    vehicle, _, key = name.partition(".")
    return summary["vehicles"][vehicle][key] if key else summary[name]


def function_of(name: str) -> tuple[str, str]:
    """``module:function`` of a metric and the key that it takes of what the function gives; two empty texts if none."""
    module, colon, rest = name.partition(":")
    function, _, key = rest.partition(".")
    return (f"{module}:{function}", key) if colon else ("", "")


def _built(job: Job, key: str) -> _Built:
    """The simulation of a job's diagram, built unless it is there already."""
    built = _here.built.pop(key, None)
    if built is None:
        while len(_here.built) >= KEPT:
            _here.built.popitem(last=False)
        assembly = assemble(make_spec(job.diagram))
        vehicles = {name: part.vehicle for name, part in assembly.parts.vehicles.items()}
        built = _Built(Simulation(assembly), find_knobs(vehicles, assembly.parts.world))
    missing = [name for name in job.knobs if name not in built.knobs]
    if missing:
        raise ConfigError(f"no knob '{missing[0]}' in this run's diagram; {did_you_mean(missing[0], built.knobs)}")
    _here.built[key] = built
    return built


@contextmanager
def _same_chances() -> Iterator[None]:
    """Inside, the global random numbers start from the same state; outside they are as before."""
    before, numpy_before = random.getstate(), np.random.get_state()
    random.seed(0)
    np.random.seed(0)
    try:
        yield
    finally:
        random.setstate(before)
        np.random.set_state(numpy_before)
