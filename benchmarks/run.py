"""Benchmarks: the jobs of the README beside this file; prints one JSON document."""

import argparse
import json
import os
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent
JOBS = ("w1", "w2", "w3", "w4", "w5", "candidates", "tyres", "memory", "startup")

GAZEBO_RTF, GAZEBO_BESIDE = 16.2, 140.0
"""W1 in Gazebo classic, and MuJoCo with cylinder wheels on that same machine: RTF of both."""


def main() -> int:
    """Run the jobs asked for; 0 if every "must" that was measured is met, 1 if not."""
    options = _parser().parse_args()
    prepare()
    document = measure(options)
    text = json.dumps(document, indent=2)
    if options.out is not None:
        options.out.write_text(text + "\n", encoding="utf-8")
    print(text)
    missed = [name for name, target in document["targets"].items() if target["must_met"] is False]
    for name in missed:
        print(f"missed: {name}: {document['targets'][name]}", file=sys.stderr)
    return 1 if missed and options.strict else 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--job", choices=[*JOBS, "all"], default="all")
    size = parser.add_mutually_exclusive_group()
    size.add_argument("--quick", action="store_true", help="fewer steps and repetitions: about two minutes")
    size.add_argument("--full", action="store_true", help="1000 runs and an hour of simulated driving for the memory")
    size.add_argument("--smoke", action="store_true", help="tiny durations; only shows that every job runs")
    parser.add_argument("--repeat", type=int, metavar="N", help="repetitions; medians are given (default 5, quick 3)")
    parser.add_argument("--out", type=Path, metavar="FILE", help="write the JSON there, too")
    parser.add_argument("--strict", action="store_true", help="exit with 1 if a target that must be met is missed")
    return parser


def prepare() -> None:
    """One thread for linear algebra; our models, worlds and diagrams are found, also in child processes."""
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    before = os.environ.get("MIRDRAKE_PATH")
    os.environ["MIRDRAKE_PATH"] = os.pathsep.join([str(ROOT), *([before] if before else [])])
    root = str(ROOT.parent)
    sys.path[:] = [root, *(path for path in sys.path if path != str(ROOT))]
    os.environ["PYTHONPATH"] = os.pathsep.join([root, *filter(None, [os.environ.get("PYTHONPATH")])])


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Return the document: machine, jobs, targets."""
    from benchmarks.timing import machine, tidy

    jobs: dict[str, Any] = {}
    selected = JOBS if options.job == "all" else (options.job,)
    stdout = os.dup(1)
    os.dup2(2, 1)  # PyBullet greets on standard output, which is for the JSON
    try:
        for job in selected:
            jobs[job] = _measure_job(job, options)
    finally:
        sys.stdout.flush()
        os.dup2(stdout, 1)
        os.close(stdout)
    size = next((name for name in ("quick", "full", "smoke") if getattr(options, name)), "default")
    document: dict[str, Any] = tidy({"machine": machine() | {"size": size}, "jobs": jobs, "targets": targets(jobs)})
    return document


def _measure_job(job: str, options: argparse.Namespace) -> dict[str, Any]:
    repeat = options.repeat or (1 if options.smoke else 3 if options.quick else 5)
    if job == "w1":
        from benchmarks import job as numbers
        from benchmarks import peers, w1

        duration, parked = (7.0, 0.5) if options.smoke else (numbers.DURATION, numbers.PARKED)
        steps: dict[str, Any] = dict(w1.STEPS)
        if options.quick:
            steps = dict.fromkeys(w1.STEPS, (0.005, 0.02))
        elif options.smoke:
            steps = dict.fromkeys(w1.STEPS, (0.005,))
        result = w1.run_w1(duration=duration, parked=parked, repeat=repeat, steps=steps)
        return result | {"peers": peers.run_peers(duration=duration, parked=parked, repeat=repeat)}
    if job == "w2":
        from benchmarks import peers_pictures, w2

        short = options.quick or options.smoke
        duration, collected = (0.2, 0.4) if options.smoke else (w2.DURATION, 10.0 if short else 60.0)
        frames = peers_pictures.run_in_turn(duration=duration, repeat=repeat)
        return frames | {"collect": w2.collect(duration=collected, repeat=min(repeat, 3))}
    if job == "w3":
        from benchmarks import w3

        return w3.run_w3(scans=3 if options.smoke else 200)
    if job == "w4":
        from benchmarks import w4

        if options.smoke:
            return w4.run_w4(runs=2, duration=0.5, repeat=1)
        return w4.run_w4(repeat=1 if options.quick else min(repeat, 3))
    if job == "w5":
        from benchmarks import w5

        if options.smoke:
            return w5.run_w5(candidates=4, duration=0.5, repeat=1)
        return w5.run_w5(repeat=repeat)
    if job == "candidates":
        from benchmarks import candidates

        if options.smoke:
            return candidates.run_candidates(count=2, duration=1.0, repeat=1)
        return candidates.run_candidates(repeat=1 if options.quick else min(repeat, 3))
    if job == "tyres":
        from benchmarks import job as numbers
        from benchmarks import tyres

        return tyres.run_tyres(duration=2.0 if options.smoke else numbers.DURATION, repeat=repeat)
    from benchmarks import housekeeping

    if job == "memory":
        runs, seconds = (1000, 3600.0) if options.full else (5, 2.0) if options.smoke else (200, 300.0)
        return housekeeping.run_memory(runs=runs, run_duration=0.5 if options.smoke else 2.0, hour=seconds)
    return housekeeping.run_startup(repeat=1 if options.smoke else 5)


MUJOCO_POOL = 4.8
"""Job W4 by MuJoCo in a process pool where the targets were set [ms per simulated second]."""

W5_MUJOCO = 3.3
"""Job W5 by MuJoCo in a process pool on a quiet machine with 2 cores [ms of wall time per simulated second]."""

W2_MS = {"mujoco": 26.0, "pybullet": 20.6}
"""Job W2: what a frame took the peers where its targets were set [ms]."""

W3_MS = {"360x1": (0.2, 0.086), "16x900": (1.9, 1.9)}
"""Job W3: what a scan may take, and what it took MuJoCo where that was set [ms]."""

DEFAULT_STEP_MS = 5.0
"""Plant step of a diagram file that does not name one [ms]; there the overhead is judged."""


# --- targets -----------------------------------------------------------------------------------------------------


def targets(jobs: dict[str, Any]) -> dict[str, Any]:
    """Return required and desired targets beside the measured values."""
    targets_: dict[str, Any] = {}
    if "w1" in jobs:
        targets_ |= _w1_targets(jobs["w1"])
    if "w2" in jobs:
        w2 = jobs["w2"]
        ms = w2["color_and_depth"]["ms_per_frame"]
        scales = {name: ms / (W2_MS[name] * peer["ours_over_it"]) for name, peer in w2["peers"].items()}
        scale = min(scales.values(), default=1.0)
        targets_["w2_ms_per_frame"] = _at_most(ms, must=18.0 * scale, aim=12.0 * scale)
        if scales:
            text = ", ".join(f"{value:.2f} as {name} to {W2_MS[name]:g} ms" for name, value in scales.items())
            targets_["w2_note"] = _note(f"18 and 12 ms scaled by the smallest of: {text}")
        targets_["w2_frames_missing"] = _at_most(w2["color_and_depth"]["missing"], must=0.0)
        targets_["w2_collect_rtf"] = _at_least(w2["collect"]["rtf"], must=1.5, aim=2.0)
        targets_["w2_collect_pictures_missing"] = _at_most(w2["collect"]["missing"], must=0.0)
    if "w3" in jobs:
        targets_ |= _w3_targets(jobs["w3"])
    if "w4" in jobs:
        mujoco = jobs["w4"].get("mujoco_pool")
        scale = mujoco["wall_ms_per_simulated_s"] / MUJOCO_POOL if mujoco else 1.0
        for method in ("spawn", "fork"):
            values = [row["wall_ms_per_simulated_s"] for key, row in jobs["w4"].items() if key.endswith(method)]
            targets_[f"w4_ms_per_simulated_s_{method}"] = _at_most(min(values), must=12.0 * scale, aim=5.0 * scale)
        if mujoco:
            targets_["w4_note"] = _note(f"12 and 5 ms scaled by {scale:.2f}, as MuJoCo to {MUJOCO_POOL}")
    if "w5" in jobs:
        targets_ |= _w5_targets(jobs["w5"])
    if "candidates" in jobs:
        if jobs["candidates"]["candidates"] == 200:
            targets_["candidates_wall_s"] = _at_most(jobs["candidates"]["wall_s"], must=30.0)
        targets_["candidates_step_iae_percent"] = _at_most(jobs["candidates"]["step"]["iae_change_percent"], must=2.0)
    if "tyres" in jobs:
        for contact, kinds in jobs["tyres"]["drives"].items():
            for kind in ("brush", "magic_formula"):
                targets_[f"tyres_{contact}_{kind}_over_coulomb"] = _at_most(kinds[kind]["over_coulomb"], must=2.0)
        targets_["rough_road_rtf"] = _at_least(jobs["tyres"]["rough_road"]["rtf_cpu"], must=30.0)
        targets_["single_track_rtf"] = _at_least(jobs["tyres"]["single_track"]["model"]["rtf_cpu"], must=300.0)
    if "memory" in jobs:
        memory = jobs["memory"]
        targets_["memory_growth_repeated_mb"] = _at_most(memory["growth_repeated_runs_mb"], must=50.0)
        targets_["memory_growth_long_drive_mb"] = _at_most(memory["growth_long_drive_mb"], must=50.0)
    if "startup" in jobs:
        startup = jobs["startup"]
        targets_["import_mirdrake_s"] = _at_most(startup["import_mirdrake_s"], must=0.3)
        targets_["first_step_s"] = _at_most(max(startup["first_step_s"].values()), must=3.0)
    return targets_


def _w5_targets(w5: dict[str, Any]) -> dict[str, Any]:
    mujoco = w5.get("mujoco_pool")
    must = 0.1 * (mujoco["wall_ms_per_simulated_s"] if mujoco else W5_MUJOCO)
    targets_ = {"w5_ms_per_simulated_s": _at_most(w5["wall_ms_per_simulated_s"], must=must)}
    if w5["threads"] == 2 and w5["candidates"] >= 1000:  # valid on a machine without other work
        targets_["w5_wall_ratio_of_threads"] = _at_least(w5["wall_ratio_of_threads"], must=1.6)
    if not mujoco:
        targets_["w5_note"] = _note(
            f"a tenth of {W5_MUJOCO:g} ms, what MuJoCo took on a quiet machine; it is not installed"
        )
    return targets_


def _w3_targets(w3: dict[str, Any]) -> dict[str, Any]:
    targets_: dict[str, Any] = {}
    for size, (must, mujoco_there) in W3_MS.items():
        scan, mujoco = w3[size], w3[size].get("mujoco")
        scale = mujoco["ms_per_scan"] / mujoco_there if mujoco else 1.0
        targets_[f"w3_{size}_ms_per_scan"] = _at_most(scan["ms_per_scan"], must=must * scale)
        targets_[f"w3_{size}_worst_error_mm"] = _at_most(scan["worst_error_mm"], must=1.0)
        targets_[f"w3_{size}_rays_that_differ"] = _at_most(scan["rays_that_differ"], must=0.0)
        if mujoco:
            targets_[f"w3_{size}_note"] = _note(f"{must:g} ms scaled by {scale:.2f}, as MuJoCo to {mujoco_there:g} ms")
    return targets_


def _w1_targets(w1: dict[str, Any]) -> dict[str, Any]:
    targets_: dict[str, Any] = {}
    cylinder = w1["peers"].get("mujoco_cylinder")
    gazebo = GAZEBO_RTF * (cylinder["rtf_cpu"] / GAZEBO_BESIDE if cylinder else 1.0)
    proportion = ", in proportion to MuJoCo" if cylinder else ""
    targets_["w1_note"] = _note(f"Gazebo does not run here; its RTF is taken as {gazebo:.1f}{proportion}")
    for contact, must, aim in (
        ("hydroelastic", gazebo, 2.0 * gazebo),
        ("point", 4.0 * gazebo, cylinder["rtf_cpu"] if cylinder else 140.0),
        ("tyre", 90.0, cylinder["rtf_cpu"] if cylinder else 140.0),  # at the default step
    ):
        sound = [d for d in w1["drives"] if d["contact"] == contact and _accurate(d)]
        if contact == "tyre":
            sound = [d for d in sound if d["step_ms"] == DEFAULT_STEP_MS]
        best = max(sound, key=lambda drive: drive["rtf_cpu"], default=None)
        targets_[f"w1_{contact}_rtf"] = _at_least(best["rtf_cpu"] if best else 0.0, must=must, aim=aim)
        if best:
            targets_[f"w1_{contact}_rtf"] |= {key: best[key] for key in ("step_ms", "approximation")}
        drives = [d for d in w1["drives"] if d["contact"] == contact]
        worst = max(abs(d["speed_error_percent"]) for d in drives)
        targets_[f"w1_{contact}_speed_error_percent"] = _at_most(worst, must=0.5)
        worst = max(d["yaw_ripple_percent"] for d in drives)
        targets_[f"w1_{contact}_ripple_percent"] = _at_most(worst, must=0.5)
        limit = 1.35 if contact == "hydroelastic" else 1.6
        usual = [d for d in drives if d["step_ms"] == DEFAULT_STEP_MS]
        if usual:  # at longer steps the same control shares fewer plant steps: see the rows of w1
            targets_[f"overhead_{contact}"] = _at_most(usual[0]["overhead"], must=limit, aim=1.15)
    for case in w1["parked"]:
        name = f"creep_mm_{case['contact']}_{case['world']}{'_braked' if case['brakes'] else ''}"
        targets_[name] = _at_most(case["creep_mm"], must=0.05)
    return targets_


def _note(text: str) -> dict[str, Any]:
    return {"must_met": None, "text": text}


def _accurate(drive: dict[str, Any]) -> bool:
    return bool(
        abs(drive["speed_error_percent"]) <= 0.5
        and abs(drive["yaw_error_percent"]) <= 1.0
        and drive["yaw_ripple_percent"] <= 0.5
    )


def _at_most(value: float, *, must: float, aim: float | None = None) -> dict[str, Any]:
    return {
        "value": value,
        "at_most": True,
        "must": must,
        "must_met": bool(value <= must),
        "aim": aim,
        "aim_met": None if aim is None else bool(value <= aim),
    }


def _at_least(value: float, *, must: float, aim: float | None = None) -> dict[str, Any]:
    return {
        "value": value,
        "at_most": False,
        "must": must,
        "must_met": bool(value >= must),
        "aim": aim,
        "aim_met": None if aim is None else bool(value >= aim),
    }


if __name__ == "__main__":
    sys.exit(main())
