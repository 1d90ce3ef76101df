"""Cases of a suite in worker processes; no case depends on those before it."""

import math
import pickle
import random
import shutil
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path

import numpy as np

from mirdrake.assembly.diagram import assemble
from mirdrake.assembly.diagram_spec import DiagramSpec, make_spec
from mirdrake.assembly.scene import load_vehicle_of, make_scene
from mirdrake.core.digest import digest_data
from mirdrake.core.errors import MirdrakeError, RunError, WorldError
from mirdrake.execution.calls import Lost, call_all, open_executor
from mirdrake.requirements import Finding, Observation, observe, parse_requirement
from mirdrake.runs.logs import Run, load_run
from mirdrake.runs.simulation import Simulation
from mirdrake.suites.cases import VEHICLE, Case, Judgement, Result, Verdict
from mirdrake.suites.trace import make_trace, write_trace
from mirdrake.vehicles import Vehicle
from mirdrake.worlds import World

CASES, TRACES = "cases", "traces"
"""Folders of a suite: run folders of cases that did not pass, and the traces of all drives for the report."""


def time_limit(case: Case) -> float:
    """Return the wall time that a case may take unless another limit is given [s]."""
    return 60.0 + 10.0 * case.duration


RunCases = Callable[[Sequence[Case]], Iterator[tuple[int, Result]]]
"""Runs cases, and yields the index and the result of each as soon as it is finished."""


@contextmanager
def open_case_workers(
    workers: int, *, cases: int, folder: Path | None = None, timeout: float | None = None, keep_all: bool = False
) -> Iterator[RunCases]:
    """Yield a function that runs cases in worker processes, which end with the block.

    A case that hangs or ends its process has the verdict error; a new process continues with the next case. Results do
    not depend on which process runs which case.

    Args:
        workers: number of processes.
        cases: number of cases that will be run; no more processes than that are started.
        folder: folder of a suite, for the run folders of cases that did not pass; None writes nothing.
        timeout: wall time that a case may take [s]; :func:`time_limit` if omitted.
        keep_all: also keep the run folders of cases that passed.
    """

    def limit(case: Case, *_: object) -> float:
        return timeout if timeout is not None else time_limit(case)

    with open_executor(None, max(1, workers), calls=cases, limit=limit) as (executor, ahead):

        def run_cases(batch: Sequence[Case]) -> Iterator[tuple[int, Result]]:
            arguments = ((case, folder, keep_all) for case in batch)
            for index, result in call_all(executor, run_in_worker, arguments, ahead=ahead):
                yield index, _lost(batch[index], result, folder) if isinstance(result, Lost) else result

        yield run_cases


def _lost(case: Case, lost: Lost, folder: Path | None) -> Result:
    """Return the result of a case whose process hung or ended."""
    wall = round(lost.seconds, 3)
    return Result(case.name, "error", lost.reason, wall=wall, folder=run_folder(case, folder), digest=case.digest())


def run_in_worker(case: Case, folder: Path | None, keep_all: bool) -> Result:
    """Run a case such that it leaves no modules of its user behind for the next one."""
    # A behaviour's module may be named as one of another world; Python would otherwise return the cached one.
    before = set(sys.modules)
    result = run_case(case, folder=folder, keep_all=keep_all)
    _forget(before, Path(case.diagram.get("folder") or "."))
    return result


def _forget(before: set[str], folder: Path) -> None:
    """Unload a user's modules, so that the next case does not depend on the cases before it."""
    for name in set(sys.modules) - before:
        file = getattr(sys.modules[name], "__file__", None)
        # Only modules beside the world file: those of the library and of site-packages are the same for all cases.
        own = file is not None and Path(file).is_relative_to(folder) and "site-packages" not in file
        if own and name.split(".")[0] != "mirdrake":
            del sys.modules[name]


def run_case(case: Case, *, folder: Path | None = None, keep_all: bool = False) -> Result:
    """Simulate and judge one case; an error is a result, too.

    The run is written while it is in progress, so that it can be inspected even if it crashes the process.

    Args:
        case: the case.
        folder: folder of the suite; the run folder below it is kept unless the case passed. None writes nothing.
        keep_all: also keep the run folder of a case that passed.
    """
    # The global generators too: a behaviour that uses them must not depend on the cases that ran before.
    began = time.perf_counter()
    random.seed(0)
    np.random.seed(0)
    case_folder = folder / CASES / case.slug if folder is not None else None
    try:
        if case_folder is not None:
            shutil.rmtree(case_folder, ignore_errors=True)  # of a suite that was killed
        result = _judge(case, folder, case_folder)
    # Invalid worlds have their own verdict: a random world may fail its rules without a fault of the vehicle.
    except WorldError as error:
        result = Result(case.name, "invalid", _line(str(error)))
    except MirdrakeError as error:
        # The result names the folder of the case already.
        text = error.text if error.where == str(case_folder) else str(error)
        result = Result(case.name, "error", _line(text))
    except BaseException as error:  # also SystemExit, and a KeyboardInterrupt that a behaviour raises
        result = Result(case.name, "error", f"{type(error).__name__}: {_line(str(error))}".removesuffix(": "))
    # Only runs worth looking at are kept; a suite may have thousands of cases that pass.
    if case_folder is not None and result.verdict == "pass" and not keep_all:
        shutil.rmtree(case_folder, ignore_errors=True)
    wall = round(time.perf_counter() - began, 3)
    return replace(result, wall=wall, digest=case.digest(), folder=run_folder(case, folder))


def run_folder(case: Case, folder: Path | None) -> str | None:
    """Return the run folder of a case, below that of its suite; None if there is none."""
    if folder is None or not (folder / CASES / case.slug).is_dir():
        return None
    return f"{CASES}/{case.slug}"


def _judge(case: Case, folder: Path | None, place: Path | None) -> Result:
    # Requirements first: a faulty text is cheaper to find before the simulation.
    requirements = [parse_requirement(text, where=location) for text, location in case.expect]
    trace = folder / TRACES / f"{case.slug}.json" if folder is not None else None
    spec = make_spec(case.diagram)
    assembly = assemble(spec, scene=make_scene(spec, _vehicles_of(case, spec)))
    world, vehicles = assembly.parts.world, {name: part.vehicle for name, part in assembly.parts.vehicles.items()}
    vehicle = vehicles[VEHICLE]

    # A world with unplaced props or violated rules is found before the simulation, which is the expensive part.
    faults = [*world.unplaced_props, *(world.rules.broken(world.props) if world.rules is not None else ())]
    if faults:
        more = f" (and {len(faults) - 1} more)" if len(faults) > 1 else ""
        return Result(case.name, "invalid", f"{faults[0]}{more}")
    try:
        run = Simulation(assembly).run(duration=case.duration, folder=place)
    except RunError:
        if trace is not None and place is not None:
            with suppress(MirdrakeError):  # the part of the drive before the error
                write_trace(trace, make_trace(observe(load_run(place), world, VEHICLE, vehicle, others=vehicles)))
        raise
    simulated = round(float(run.signals.index[-1]) if len(run.signals) else 0.0, 6)
    findings: list[Finding] = []
    seen: Observation | None = None
    # A diverged run cannot be judged: margins of its signals mean nothing.
    fault = f"the run {run.stop}" if run.diverged else ""
    # Even then the run is observed, as far as possible, because the report shows its trace.
    try:
        wanted = {name for requirement in requirements for name in requirement.signals}
        seen = observe(run, world, VEHICLE, vehicle, goal=case.goal, others=vehicles, wanted=wanted)
        findings = [] if fault else [requirement.judge(seen) for requirement in requirements]
    except RunError as error:
        fault = fault or _line(str(error))
    if not fault:
        findings += _findings_of_others(case, run, world, vehicles)
    broken = [finding for finding in findings if not finding.passed]
    text = fault or "; ".join(_failure_text(finding) for finding in broken)
    verdict: Verdict = "error" if fault else "fail" if broken else "pass"
    if trace is not None and seen is not None:
        write_trace(trace, make_trace(seen, findings))
    return Result(case.name, verdict, text, tuple(map(_judgement, findings)), simulated)


_loaded: dict[str, bytes] = {}
"""The vehicles that this process has loaded last, as copies that no run can change; see :func:`_vehicles_of`."""


def _vehicles_of(case: Case, spec: DiagramSpec) -> dict[str, Vehicle]:
    """Return the vehicles of a case by name; those of all variations of a test are the same and are loaded once.

    Args:
        case: the case.
        spec: its diagram.
    """
    if not case.content:  # whether its files have changed is not known
        return {name: load_vehicle_of(spec, name) for name in spec.vehicles}
    key = digest_data([case.content, case.diagram["vehicles"], case.diagram.get("systems")])
    if key not in _loaded:
        _loaded.clear()
        _loaded[key] = pickle.dumps({name: load_vehicle_of(spec, name) for name in spec.vehicles})
    vehicles: dict[str, Vehicle] = pickle.loads(_loaded[key])
    return vehicles


def _findings_of_others(case: Case, run: Run, world: World, vehicles: Mapping[str, Vehicle]) -> Iterator[Finding]:
    """Yield the findings of the requirements on the other vehicles; their texts begin with the vehicle's name."""
    for other in case.others:
        requirements = [parse_requirement(text, where=location) for text, location in other.expect]
        wanted = {name for requirement in requirements for name in requirement.signals}
        own = vehicles[other.vehicle]
        seen = observe(run, world, other.vehicle, own, goal=other.goal, others=vehicles, wanted=wanted)
        for requirement in requirements:
            finding = requirement.judge(seen)
            yield finding._replace(text=f"{other.vehicle}: {finding.text}")


def _failure_text(finding: Finding) -> str:
    return f"{finding.text}: margin {finding.margin:.3g} {finding.unit}".rstrip() + f" at {finding.worst_time:.2f} s"


def _judgement(finding: Finding) -> Judgement:
    # JSON has no infinity.
    bounded = math.isfinite(finding.margin)
    return Judgement(
        text=finding.text,
        passed=finding.passed,
        margin=finding.margin if bounded else None,
        unit=finding.unit,
        share=finding.margin / finding.scale if bounded else None,
        worst_time=round(finding.worst_time, 6),
        decided_by=finding.decided_by,
    )


def _line(text: str) -> str:
    # Reasons are one line in tables and in the results file.
    lines = text.strip().splitlines()
    return lines[0] + (f" (and {len(lines) - 1} more)" if len(lines) > 1 else "") if lines else ""
