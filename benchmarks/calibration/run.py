"""Run the calibration of the identification, one row per case, and print its table.

::

    python -m benchmarks.calibration.run --cases 0:60 --out runs/calibration.jsonl      # continues where it stopped
    python -m benchmarks.calibration.run --out runs/calibration.jsonl --table           # only the table
"""

import argparse
import json
import tempfile
import time
import warnings
from pathlib import Path
from typing import TypedDict

import numpy as np

from benchmarks.calibration.baseline import fit_baseline
from benchmarks.calibration.cases import Case, draw_case
from benchmarks.calibration.record import record, with_ratio
from benchmarks.calibration.table import make_table
from mirdrake.core.errors import ConfigError, RunError
from mirdrake.identification.findings import DataReport
from mirdrake.identification.fit import Fit, FittedParameter
from mirdrake.identification.identify import identify
from mirdrake.identification.study import load_identification
from mirdrake.identification.validation import noise_limit_nrmse, nrmse

REPAIRED_BY = {
    "late": {"delay"}, "held": {"held_values"}, "glitches": {"glitches"}, "dropped": {"gaps", "timestamps"},
    "repeated": {"timestamps"}, "gap": {"gaps", "timestamps"}, "dummy": {"first_rows", "timestamps"},
}  # fmt: skip
"""Checks that may repair each fault."""

REJECTED = {"sign", "degrees"}
"""Faults for which a data set must be rejected."""

SMALL_DELAY = 0.01
"""Delay between channels that no verdict depends on [s]."""


class ParameterRow(TypedDict):
    """Estimate of a parameter beside its truth [SI]."""

    name: str
    verdict: str
    truth: float
    value: float
    low: float | None
    high: float | None
    noise: float | None


class Row(TypedDict):
    """Result of a case."""

    seed: int
    kind: str
    fault: str
    knowledge: str
    manoeuvres: list[str]
    status: str
    message: str
    seconds: float
    parameters: list[ParameterRow]
    false_repairs: list[str]
    false_delays: list[str]
    missed: bool
    limited: bool
    excluded: list[str]
    found: list[str]
    held_out: float | None
    noise_limit: float | None
    prediction_sigma: float | None
    baseline: float | None
    notes: list[str]


def true_values(case: Case, fit: Fit) -> dict[str, float]:
    """Return the true values of the parameters that have one, per kilogram if no mass is known."""
    v, s = case.vehicle, case.sensors
    size = 1.0 if "mass" in case.known else 1.0 / v.mass
    values = {
        "yaw_inertia": size * v.yaw_inertia, "steering_ratio": v.ratio, "wheelbase": v.wheelbase,
        "steering_delay": v.delay, "steering_lag": v.lag,
        "cornering_stiffness_front": size * v.stiffness_front, "cornering_stiffness_rear": size * v.stiffness_rear,
        "accelerometer_ahead": s.accelerometer, "velocity_ahead": s.velocity, "relaxation": v.relaxation,
    }  # fmt: skip
    if v.kind == "multi_body":
        for name in ("cornering_stiffness_front", "cornering_stiffness_rear", "accelerometer_ahead", "velocity_ahead",
                     "relaxation"):  # fmt: skip
            del values[name]
    if v.kind in {"magic", "two_track"}:
        values |= {"friction_front": v.friction, "friction_rear": v.friction}
    # A late yaw rate looks like a delay of the steering; delays of channels are counted by themselves.
    if case.late:
        del values["steering_delay"]
    free = {parameter.name for parameter in fit.parameters if parameter.kind != "fixed"}
    return {name: value for name, value in values.items() if name in free}


def _row(parameter: FittedParameter, truth: float) -> ParameterRow:
    return {"name": parameter.name, "verdict": parameter.verdict, "truth": truth, "value": parameter.value,
            "low": parameter.low, "high": parameter.high, "noise": parameter.sigma_noise}  # fmt: skip


def false_delays(case: Case, check: DataReport) -> tuple[list[str], bool]:
    """Return channels that were shifted away from their true timing, and whether a true delay is left."""
    shifts: dict[str, float] = {}
    for finding in check.findings:
        if finding.check == "delay" and finding.done is not None:
            shifts |= {
                key: float(value) for key, value in finding.done.figures.items() if key not in {"shifts", "together"}
            }
    names = (*case.sensors.channels, case.sensors.steering)
    left = {name: case.late.get(name, 0.0) - shifts.get(name, 0.0) for name in names}
    reference = left["yaw_rate"]
    limit = max(SMALL_DELAY, 0.5 * case.sensors.step)
    moved = [name for name in names if shifts.get(name, 0.0) != shifts.get("yaw_rate", 0.0)]
    if shifts.get("yaw_rate"):
        moved.append("yaw_rate")
    wrong = [name for name in moved if abs(left[name] - reference) > limit]
    if "yaw_rate" in moved and abs(left["yaw_rate"] - left[case.sensors.steering]) > limit and not case.late:
        wrong.append("yaw_rate")
    others = [name for name in case.sensors.channels if name in case.late or "yaw_rate" in case.late]
    missed = any(abs(left[name] - reference) > max(0.02, case.sensors.step) for name in others)
    return wrong, missed


def excluded_delays(case: Case, check: DataReport) -> list[str]:
    """Return the channels without a found delay whose stated interval does not contain their true delay."""
    away = {name: case.late.get(name, 0.0) - case.late.get("yaw_rate", 0.0) for name in case.sensors.channels}
    excluded = set()
    for finding in check.findings:
        if finding.check == "delay_limit":
            low, high = (float(finding.what.figures[end]) for end in ("low", "high"))
            if not low - SMALL_DELAY <= away[finding.channels[0]] <= high + SMALL_DELAY:
                excluded.add(finding.channels[0])
    return sorted(excluded)


def held_out_fit(fit: Fit) -> tuple[float | None, float | None]:
    """Return the NRMSE fit of the yaw rate of the validation log and what its noise allows [%].

    A log that the data check has cut at a gap counts as one, as for the baseline.
    """
    names = [channel.log for channel in fit.channels if channel.part == "validation" and channel.channel == "yaw_rate"]
    traces = [fit.traces[name] for name in names if name in fit.traces]
    if not traces:
        return None, None
    measured, model = (np.concatenate([trace[name] for trace in traces]) for name in ("yaw_rate", "yaw_rate_model"))
    # A model that diverges has no samples; it counts as the worst.
    reached = nrmse(measured, model) if np.isfinite(model).any() else -100.0
    return reached, max(noise_limit_nrmse(measured), reached)


def run_case(seed: int) -> Row:
    """Return the row of a case."""
    case = with_ratio(draw_case(seed))
    row: Row = {
        "seed": seed, "kind": case.vehicle.kind, "fault": case.fault, "knowledge": case.knowledge,
        "manoeuvres": list(case.manoeuvres), "status": "fitted", "message": "", "seconds": 0.0, "parameters": [],
        "false_repairs": [], "false_delays": [], "missed": False, "limited": False, "excluded": [],
        "found": [], "held_out": None, "noise_limit": None, "prediction_sigma": None,
        "baseline": None, "notes": [],
    }  # fmt: skip
    with tempfile.TemporaryDirectory() as directory:
        folder = Path(directory)
        try:
            study = record(case, folder)
        except ValueError as error:
            row["status"], row["message"] = "not driven", str(error)
            return row
        begun = time.process_time()
        try:
            result = identify(load_identification(study), folder)
        except (ConfigError, RunError) as error:
            row["status"], row["message"] = "rejected", str(error)
            row["missed"] = False
            row["seconds"] = time.process_time() - begun
            return row
        row["seconds"] = time.process_time() - begun
        files = sorted(folder.glob("log_*.parquet"))
        try:
            # The baseline knows what the study knows.
            wheelbase = None if case.knowledge == "nothing" else case.vehicle.wheelbase
            row["baseline"] = fit_baseline(files[:-1], files[-1], case.sensors.steering, wheelbase)
        except (ValueError, np.linalg.LinAlgError) as error:
            row["message"] = f"baseline: {error}"
    truth = true_values(case, result.fit)
    row["parameters"] = [
        _row(parameter, truth[parameter.name]) for parameter in result.fit.parameters if parameter.name in truth
    ]
    row["false_delays"], missed_delay = false_delays(case, result.check)
    row["limited"] = any(finding.check == "delay_limit" for finding in result.check.findings)
    row["excluded"] = excluded_delays(case, result.check)
    repaired = [finding for finding in result.check.findings if finding.done is not None and finding.check != "delay"]
    row["false_repairs"] = sorted(
        {
            f"{finding.check} {finding.channel}"
            for finding in repaired
            if finding.check not in REPAIRED_BY.get(case.fault, set())
        }
    )
    row["found"] = sorted(
        {
            f"{finding.severity} {finding.check} {finding.channel}"
            for finding in result.check.findings
            if finding.severity != "info"
        }
    )
    row["missed"] = missed_delay or case.fault in REJECTED
    if case.fault == "vy_sign":
        row["missed"] = not any(
            "vy" in finding.channels and finding.severity == "fault" for finding in result.check.findings
        )
    row["held_out"], row["noise_limit"] = held_out_fit(result.fit)
    sizes = [entry.prediction_sigma_percent for entry in result.fit.channels
             if entry.part == "validation" and entry.channel == "yaw_rate"]  # fmt: skip
    row["prediction_sigma"] = max((size for size in sizes if size is not None), default=None)
    row["notes"] = list(result.fit.notes)
    return row


def main() -> None:
    """Run cases and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", default="0:60", help="first:end of the seeds")
    parser.add_argument("--out", type=Path, required=True, help="file of rows (JSON lines)")
    parser.add_argument("--table", action="store_true", help="only print the table of the rows in the file")
    options = parser.parse_args()
    options.out.parent.mkdir(parents=True, exist_ok=True)
    rows: list[Row] = []
    if options.out.exists():
        rows = [json.loads(line) for line in options.out.read_text().splitlines()]
    first, end = (int(text) for text in options.cases.split(":"))
    selected = range(first, end)
    done = {row["seed"] for row in rows}
    for seed in () if options.table else [seed for seed in selected if seed not in done]:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            row = run_case(seed)
        with options.out.open("a") as file:
            file.write(json.dumps(row) + "\n")
        rows.append(row)
        print(f"{seed}: {row['kind']}, {row['fault']}: {row['status']}, {row['seconds']:.0f} s", flush=True)
    print(make_table([row for row in rows if row["seed"] in selected]))


if __name__ == "__main__":
    main()
