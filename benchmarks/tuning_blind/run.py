"""Tunes the blind set and judges it: ``python -m benchmarks.tuning_blind.run --vehicles 40 --out runs/tuning_blind``.

Each case is a line of ``cases.jsonl`` in the folder; a second call continues. ``table.md`` has the summary.
"""

import argparse
import json
import math
import shutil
import sys
import time
from pathlib import Path
from typing import Any

from benchmarks.tuning_blind.cases import LOOPS, Case, draw_case, write_case
from benchmarks.tuning_blind.table import mean_ratio, ratios, table_of
from mirdrake.core.errors import ConfigError, MirdrakeError
from mirdrake.tuning.apply import plan_apply
from mirdrake.tuning.loops.base import Conditions
from mirdrake.tuning.loops.evaluate import LoopEvaluator
from mirdrake.tuning.loops.registry import make_loop_spec
from mirdrake.tuning.result import TuningResult
from mirdrake.tuning.spec import make_tuning
from mirdrake.tuning.tune import tune

COURSES: dict[str, dict[str, tuple[dict[str, float], Conditions]]] = {
    "speed": {
        "faster, steeper": ({"speed": 1.6, "step": 3.0, "slope": 1.2}, Conditions()),
        "braking": ({"speed": 1.2, "step": -2.5, "slope": 1.0}, Conditions()),
        "slow, small": ({"speed": 0.4, "step": 0.5, "slope": 0.3}, Conditions()),
        "uphill": ({"speed": 0.8, "step": 1.0, "slope": 0.6}, Conditions(grade=math.radians(2.0))),
        "heavy, slippery": ({"speed": 1.0, "step": 2.0, "slope": 0.6}, Conditions(mass=1.15, friction=0.5)),
    },
    "steering": {
        "small": ({"speed": 1.0, "step": 0.04}, Conditions()),
        "large": ({"speed": 0.7, "step": 0.25}, Conditions()),
        "right, faster": ({"speed": 2.0, "step": -0.1}, Conditions()),
        "heavy, slippery": ({"speed": 1.0, "step": 0.1}, Conditions(mass=1.15, friction=0.5)),
    },
}
"""Courses that no study has seen: speeds and steps relative to the default ones of the loop (steering: [rad])."""

DURATION = 12.0
"""Of a course [s]."""

MOST_MISSED = 6
"""Rejected candidates that are driven at most, if a study keeps the present control."""


def main() -> int:
    """Tune and judge the cases that are missing, and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--vehicles", type=int, default=40, metavar="N", help="number of vehicles")
    parser.add_argument("--first", type=int, default=0, metavar="I", help="number of the first vehicle")
    parser.add_argument("--seed", type=int, default=0, help="of the set")
    parser.add_argument("--loops", nargs="+", choices=LOOPS, default=LOOPS, help="loops to tune")
    parser.add_argument("--workers", type=int, default=0, help="processes of a study; 0: none")
    parser.add_argument("--out", type=Path, default=Path("runs/tuning_blind"), metavar="DIR", help="folder")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    file = options.out / "cases.jsonl"
    done = {(row["seed"], row["number"], row["loop"]) for row in read_rows(file)}
    for number in range(options.first, options.first + options.vehicles):
        case = draw_case(number, options.seed)
        for loop in options.loops:
            if (case.seed, case.number, loop) in done:
                continue
            row = run_case(case, loop, options.out, options.workers)
            with file.open("a", encoding="utf-8") as stream:
                stream.write(json.dumps(row) + "\n")
            print(f"{case.vehicle} {loop}: {row['verdict']}", file=sys.stderr, flush=True)
    text = table_of(read_rows(file))
    (options.out / "table.md").write_text(text, encoding="utf-8")
    print(text)
    return 0


def read_rows(file: Path) -> list[dict[str, Any]]:
    """Return the rows of a file of cases; none without the file."""
    if not file.is_file():
        return []
    return [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines()]


def run_case(case: Case, loop: str, out: Path, workers: int) -> dict[str, Any]:
    """Tune a loop of a case and return its row: the case, the verdict, and the IAE on every course."""
    folder = out / f"{case.vehicle}_{loop}"
    shutil.rmtree(folder, ignore_errors=True)
    _, _, variant = case.vehicle.partition("@")
    vehicle = write_case(case, folder / "models")
    name = f"{vehicle}@{variant}" if variant else str(vehicle)
    study = {"vehicle": name, "loop": loop, "test": {"delay": case.delay}}
    row = {**case.row(), "loop": loop}
    wall, processor = time.monotonic(), time.process_time()
    try:
        result = tune(study, out=folder / "study", workers=workers)
    except MirdrakeError as error:
        return {**row, "verdict": "failed", "reason": str(error).splitlines()[0]}
    row |= {"wall_s": round(time.monotonic() - wall, 1), "cpu_s": round(time.process_time() - processor, 1)}
    tuned = applied(result, vehicle, name, None)
    rule = applied(result, vehicle, name, result.best_rule, force=True) if result.best_rule else None
    iae = {"present": drive(case, loop, name)}
    iae |= {"tuned": drive(case, loop, tuned)} if tuned else {}
    iae |= {"rule": drive(case, loop, rule)} if rule else {}
    unmet = [criterion.name for criterion in result.acceptance if not criterion.met]
    if not tuned:
        row["missed"] = find_missed(case, loop, result, vehicle, name, iae["present"])
    return {
        **row,
        "verdict": "tuned" if tuned else "kept",
        "best": result.best,
        "best_rule": result.best_rule,
        "unmet": unmet,
        "iae": iae,
    }


def find_missed(
    case: Case, loop: str, result: TuningResult, vehicle: Path, name: str, present: dict[str, float | None]
) -> dict[str, Any] | None:
    """Return the best rejected candidate that is better than the present control on the courses; None without one.

    The cheapest :data:`MOST_MISSED` stable candidates of a study that kept the present control are driven. A candidate
    is better if it is stable on all courses and its mean ratio to the present IAE is below 1.
    """
    tries = [
        candidate
        for candidate in result.candidates
        if candidate.kind != "baseline" and candidate.status == "ok" and candidate.cost is not None
    ]
    better: list[dict[str, Any]] = []
    for candidate in sorted(tries, key=lambda one: one.cost or math.inf)[:MOST_MISSED]:
        copy = applied(result, vehicle, name, candidate.name, force=True)
        iae = drive(case, loop, copy) if copy else {}
        found = ratios({"iae": {"tuned": iae, "present": present}}, "present")
        if found and mean_ratio(found) < 1.0:
            checks = sorted({rejection.check for rejection in candidate.rejections})
            figures = sorted({rejection.figure for rejection in candidate.rejections if rejection.figure})
            better.append(
                {"name": candidate.name, "ratio": mean_ratio(found), "feasible": candidate.feasible, "checks": checks}
                | {"figures": figures}
            )
    return min(better, key=lambda one: float(one["ratio"]), default=None)


def applied(
    result: TuningResult, vehicle: Path, name: str, candidate: str | None, *, force: bool = False
) -> str | None:
    """Apply a candidate to a copy of a vehicle and return the name of the copy; None if it is rejected."""
    copy = vehicle.parents[1] / ("tuned" if candidate is None else "rule") / vehicle.name
    shutil.rmtree(copy, ignore_errors=True)
    shutil.copytree(vehicle, copy)
    target = name.replace(str(vehicle), str(copy))
    try:
        plan_apply(result, candidate=candidate, vehicle=target, force=force).write()
    except ConfigError:
        return None
    return target


def drive(case: Case, loop: str, vehicle: str) -> dict[str, float | None]:
    """Return the IAE of a vehicle with its own control.yaml on each course; None if it is not stable."""
    usual = make_loop_spec(make_tuning({"vehicle": vehicle, "loop": loop})).course
    values = {}
    for name, (course, conditions) in COURSES[loop].items():
        test = {
            **course,
            "speed": course["speed"] * usual.speed,
            "delay": case.delay,
            "duration": DURATION,
            "load": 0.0,
        }
        if loop == "speed":
            test["step"] = course["step"] * usual.step / 2.0
        spec = make_loop_spec(make_tuning({"vehicle": vehicle, "loop": loop, "test": test}))
        result = LoopEvaluator(spec)({}, conditions)
        values[name] = result.figures["iae"] if result.status == "ok" else None
    return values


if __name__ == "__main__":
    sys.exit(main())
