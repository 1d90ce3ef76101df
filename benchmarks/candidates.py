"""Job candidates: evaluation of many gains of a loop on the plant, on all cores, start of the processes included."""

import json
import os
import resource
import subprocess
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

from benchmarks.timing import ROOT
from mirdrake.execution.worker_server import LOOP, start_server

COUNT, DURATION = 200, 10.0
"""Number of candidates, and simulated time of each [s]."""

GAINS = {"kp": (100.0, 600.0), "ki": (10.0, 300.0), "kd": (0.0, 30.0)}
"""Ranges of the Bolt's speed loop."""


def run_candidates(*, count: int = COUNT, duration: float = DURATION, repeat: int = 3) -> dict[str, Any]:
    """Gains of the Bolt's speed loop, spread by a Sobol sequence, on the plant with point contact.

    Every repetition is a process of its own, whose workers start, import and build. The best is given, since other
    load can only add. `step` puts the figures of one candidate beside those at half the step of the plant.

    Args:
        count: number of candidates.
        duration: simulated time of each [s].
        repeat: how often.
    """
    repetitions = [_fresh("search", count, duration) for _ in range(repeat)]
    assert all(
        repetition["status"] == repetitions[0]["status"] and repetition["sum_iae"] == repetitions[0]["sum_iae"]
        for repetition in repetitions
    )
    best = dict(min(repetitions, key=lambda repetition: float(repetition["wall_s"])))
    return best | {"alone": _fresh("alone", min(count, 12), duration), "step": _fresh("step", 1, duration)}


def _fresh(what: str, count: int, duration: float) -> dict[str, Any]:
    """Return the result of a function of this module in a fresh process."""
    command = [sys.executable, "-c", "import benchmarks.candidates as job; job.main()", what, str(count), str(duration)]
    began = time.perf_counter()
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True, cwd=ROOT.parent)
    wall = time.perf_counter() - began
    result: dict[str, Any] = json.loads(done.stdout)
    if what == "search":
        result |= {"wall_s": wall, "runs_per_s": count / wall}
    return result


@dataclass(frozen=True)
class Timed:
    """Tries gains, with the processor time that it took among the figures; the first of a process builds."""

    evaluate: Any

    def __call__(self, gains: Mapping[str, float], *conditions: Any) -> Any:
        """Test gains."""
        began = time.process_time()
        evaluation = self.evaluate(gains, *conditions)
        return replace(evaluation, figures={**evaluation.figures, "cpu_s": time.process_time() - began})


def _evaluator(duration: float, **plant: Any) -> Any:
    from mirdrake.tuning.loops.evaluate import LoopEvaluator
    from mirdrake.tuning.loops.registry import make_loop_spec
    from mirdrake.tuning.spec import make_tuning

    test = {"duration": duration, "step_time": min(0.5, 0.2 * duration)}
    tuning = {"vehicle": "bolt", "loop": "speed", "test": test, "plant": plant}
    return LoopEvaluator(make_loop_spec(make_tuning(tuning)))


def search(count: int, duration: float) -> dict[str, Any]:
    """Evaluate all candidates on all cores; return the processor time of the candidates and of this process."""
    start_server(LOOP)  # as `mirdrake tune` does; then the rest is imported
    from mirdrake.studies.spec import ParameterSpec
    from mirdrake.tuning.search import search as find

    space = {name: ParameterSpec(low=low, high=high) for name, (low, high) in GAINS.items()}
    evaluate: Any = Timed(_evaluator(duration))
    began = time.perf_counter()
    trials = find(evaluate, space, method="sobol", trials=count, cost={"iae": 1.0}, workers=None).table
    searching = time.perf_counter() - began
    return {
        "workers": os.cpu_count() or 1,
        "candidates": count,
        "status": trials["status"].value_counts().to_dict(),
        "sum_iae": float(trials["iae"].sum()),
        "search_s": searching,
        "candidates_cpu_s": float(trials["cpu_s"].sum()),
        "median_cpu_s": float(trials["cpu_s"].median()),
        "parent_cpu_s": time.process_time(),
    }


def alone(count: int, duration: float) -> dict[str, Any]:
    """Processor time in one process [s]: until it can begin, for the first candidate, and for each further one."""
    evaluate = _evaluator(duration)
    times, sizes = [time.process_time()], []
    for k in range(count):
        share = k / max(count - 1, 1)
        evaluate({name: low + share * (high - low) for name, (low, high) in GAINS.items()})
        times.append(time.process_time())
        sizes.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3)
    each = sorted(b - a for a, b in pairwise(times[1:])) or [times[1] - times[0]]
    return {
        "import_cpu_s": times[0],
        "first_cpu_s": times[1] - times[0],
        "each_cpu_s": each[len(each) // 2],
        "least_cpu_s": each[0],
        "peak_mb": sizes[-1],
    }


def step(_: int, duration: float) -> dict[str, Any]:
    """Figures of a candidate in the middle of the ranges, with the step that the loop takes, and with half of it."""
    gains = {name: 0.5 * (low + high) for name, (low, high) in GAINS.items()}
    usual = _evaluator(duration)
    whole = float(usual.spec.diagram["plant"]["time_step"])
    both = [usual(gains).figures, _evaluator(duration, time_step=0.5 * whole)(gains).figures]
    names = ("iae", "rise_time", "overshoot_percent", "peak_effort", "total_variation")
    change = 100.0 * abs(both[0]["iae"] / both[1]["iae"] - 1.0)
    return {"step_s": whole, "iae_change_percent": change} | {name: [result[name] for result in both] for name in names}


def main() -> None:
    """Run a process of the job: task, number of candidates, duration of each [s]."""
    call = {"search": search, "alone": alone, "step": step}[sys.argv[1]]
    print(json.dumps(call(int(sys.argv[2]), float(sys.argv[3]))))
