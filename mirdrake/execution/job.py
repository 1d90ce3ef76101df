"""A run of a study as a pure function of its job, which any process may call."""

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
from mirdrake.core.compiled import compilation_time
from mirdrake.core.drake_errors import is_divergence
from mirdrake.core.errors import ConfigError, RunError, did_you_mean, one_line
from mirdrake.core.json_io import Json
from mirdrake.core.user_modules import load_user_function
from mirdrake.execution.parameters import ContextParameter, find_context_parameters
from mirdrake.runs.simulation import Simulation
from mirdrake.runs.stop import StopReason

Status = Literal["ok", "unstable", "failed"]

KEPT = 4
"""Number of built diagrams that a thread keeps."""


@dataclass(frozen=True)
class Job:
    """The description of a run; plain data, so that it can be sent to another process or computer.

    Attributes:
        index: number of the run in its study.
        diagram: data of the diagram, with this run's values at their paths.
        parameters: values of context parameters by name.
        metrics: names of the metrics, as in the study file.
        duration: simulated time [s].
        folder: folder of the modules of user metrics.
        limit: wall time that the run may take [s].
    """

    index: int
    diagram: Json
    parameters: dict[str, float]
    metrics: tuple[str, ...]
    duration: float
    folder: str | None = None
    limit: float = math.inf


@dataclass(frozen=True)
class Outcome:
    """The outcome of a run.

    Attributes:
        index: number of the run.
        status: ok; unstable: the simulation diverged; failed: it could not be run or measured.
        reason: one line; empty if ok.
        simulated: simulated time [s].
        metrics: values of the metrics; empty unless ok.
        verdict: of a manoeuvre.
    """

    index: int
    status: Status
    reason: str = ""
    simulated: float = math.nan
    metrics: tuple[float, ...] = ()
    verdict: str = ""


@dataclass
class _Built:
    simulation: Simulation
    parameters: dict[str, ContextParameter]


class _Cache(threading.local):
    """Diagrams that this thread has built; a Simulation can run once at a time only."""

    def __init__(self) -> None:
        self.built: OrderedDict[str, _Built] = OrderedDict()


_cache = _Cache()


def run_job(job: Job) -> Outcome:
    """Run a job; an error is an outcome, too.

    The diagram is built only if this thread has not built it before. Each run starts from a new Context and from the
    same global random state.

    Raises:
        KeyboardInterrupt: Ctrl-C in this process.
    """
    # Equal diagrams share one built simulation; the key is a text because plain data are not hashable.
    key = json.dumps(job.diagram, sort_keys=True)
    try:
        # Metrics of the user may use global random numbers; the result must not depend on the order of the runs.
        with _seeded_global_random(), np.errstate(all="ignore"):
            return _run(job, _built(job, key))
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # a user's block or metric may raise anything, SystemExit as well
        _cache.built.pop(key, None)  # after an error its state is unknown
        line = one_line(error)
        unstable = isinstance(error, RunError) and is_divergence(line)
        return Outcome(job.index, "unstable" if unstable else "failed", line)


def _run(job: Job, built: _Built) -> Outcome:
    # Several metrics may be entries of one function's mapping.
    names = dict.fromkeys(function_of(name)[0] for name in job.metrics)
    functions = {name: load_user_function(name, folder=job.folder) for name in names if name}
    # Wall time, not simulated time: a stiff diagram may need minutes for a second. Compilations happen only once.
    began, late = time.monotonic() - compilation_time(), False

    def change(context: Context) -> None:
        for name, value in job.parameters.items():
            built.parameters[name].apply(built.simulation.assembly, context, value)

    def exceeds_limit(_: Context) -> bool:
        nonlocal late
        late = late or time.monotonic() - compilation_time() - began > job.limit
        return late

    run = built.simulation.run(
        duration=job.duration, change=change, until=exceeds_limit if math.isfinite(job.limit) else None
    )
    simulated = float(run.summary["simulated_s"])
    # Ctrl-C ends the whole study, not only this run.
    if run.stop.reason is StopReason.INTERRUPTED:
        raise KeyboardInterrupt
    # Before divergence: a run that was stopped by the limit is not unstable.
    if late:
        return Outcome(job.index, "failed", f"no end after {job.limit:g} s of wall time")
    if run.diverged:
        return Outcome(job.index, "unstable", str(run.stop), simulated)

    # A function is called once, whatever number of metrics take their values from it.
    results: Json = {}
    for name, function in functions.items():
        try:
            results[name] = function(run)
        except KeyboardInterrupt:
            raise
        except BaseException as error:
            return Outcome(job.index, "failed", f"metric {name}: {one_line(error)}", simulated)
    try:
        values = tuple(_measure(name, run.summary, results) for name in job.metrics)
    except ConfigError as error:
        return Outcome(job.index, "failed", str(error), simulated)
    return Outcome(job.index, "ok", "", simulated, values)


def _measure(name: str, summary: Mapping[str, Any], results: Mapping[str, Any]) -> float:
    """Return the value of a metric; NaN if the run does not have it.

    Args:
        name: name of the metric.
        summary: summary of the run.
        results: return values of the user's functions, by their names.
    """
    function, key = function_of(name)
    value = results[function] if function else figure(summary, name)
    if key:
        if not (isinstance(value, Mapping) and key in value):
            hint = did_you_mean(key, value) if isinstance(value, Mapping) else "it does not return a mapping"
            raise ConfigError(f"metric {name}: {function} does not return '{key}'; {hint}")
        value = value[key]
    try:
        return math.nan if value is None else float(value)
    except (TypeError, ValueError):
        raise ConfigError(f"metric {name}: must be a number, not {type(value).__name__}") from None


def figure(summary: Mapping[str, Any], name: str) -> Any:
    """Return a figure of a summary by name: ``simulated_s``, or ``ego.distance_m``."""
    vehicle, _, key = name.partition(".")
    return summary["vehicles"][vehicle][key] if key else summary[name]


def function_of(name: str) -> tuple[str, str]:
    """Return ``module:function`` of a metric and the key into its return value; empty for other metrics."""
    module, colon, rest = name.partition(":")
    function, _, key = rest.partition(".")
    return (f"{module}:{function}", key) if colon else ("", "")


def _built(job: Job, key: str) -> _Built:
    """Return the simulation of a job's diagram, which is built unless this thread has it."""
    built = _cache.built.pop(key, None)
    if built is None:
        # Least recently used first: popped and inserted again at each use.
        while len(_cache.built) >= KEPT:
            _cache.built.popitem(last=False)
        assembly = assemble(make_spec(job.diagram))
        vehicles = {name: part.vehicle for name, part in assembly.parts.vehicles.items()}
        built = _Built(Simulation(assembly), find_context_parameters(vehicles, assembly.parts.world))
    # A study may vary the model of a vehicle, and with it the parameters of the diagram.
    missing = [name for name in job.parameters if name not in built.parameters]
    if missing:
        hint = did_you_mean(missing[0], built.parameters)
        raise ConfigError(f"this run's diagram has no parameter '{missing[0]}'; {hint}")
    # Kept only after success, so that a diagram with faults is built again.
    _cache.built[key] = built
    return built


@contextmanager
def _seeded_global_random() -> Iterator[None]:
    """Seed the global random number generators for the block, and restore their states after it."""
    before, numpy_before = random.getstate(), np.random.get_state()
    random.seed(0)
    np.random.seed(0)
    try:
        yield
    finally:
        random.setstate(before)
        np.random.set_state(numpy_before)
