"""Every benchmark runs, and its JSON has the figures that its README explains; their values are not checked."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from mirdrake.sensors.cameras import rendering

RUN = Path(__file__).resolve().parent.parent / "benchmarks" / "run.py"


def _run(job: str) -> dict[str, Any]:
    command = [sys.executable, "-W", "error", str(RUN), "--job", job, "--smoke"]
    done = subprocess.run(command, capture_output=True, text=True, env=os.environ | {"OPENBLAS_NUM_THREADS": "1"})
    assert done.returncode == 0, done.stderr
    document: dict[str, Any] = json.loads(done.stdout)
    assert {"cpu", "cores", "python", "packages"} <= set(document["machine"])
    assert set(document["jobs"]) == {job}
    for name, target in document["targets"].items():
        assert name.endswith("note") or {"value", "must", "must_met", "aim", "aim_met"} <= set(target)
    return document


@pytest.mark.slow
def test_the_drive_gives_speed_accuracy_and_overhead_for_both_contacts() -> None:
    document = _run("w1")
    drives = document["jobs"]["w1"]["drives"]
    assert {drive["contact"] for drive in drives} == {"point", "hydroelastic"}
    expected = {"rtf", "rtf_cpu", "cpu_us_per_step", "steps_per_s", "overhead", "bare"}
    expected |= {"yaw_error_percent", "yaw_ripple_percent", "speed_error_percent", "mirror_difference_percent"}
    for drive in drives:
        assert expected <= set(drive)
        assert len(drive["faces_per_wheel"]) == (4 if drive["contact"] == "hydroelastic" else 0)
    assert {"w1_hydroelastic_rtf", "w1_point_rtf", "overhead_point"} <= set(document["targets"])


@pytest.mark.parametrize(
    ("job", "keys"),
    [
        pytest.param(
            "w2",
            {"color_and_depth", "depth", "collect", "peers"},
            marks=[
                pytest.mark.slow,
                pytest.mark.skipif(rendering._egl_fault() is not None, reason="cameras cannot be drawn here"),
            ],
        ),
        ("w3", {"360x1", "16x900"}),
        pytest.param("w4", {"mirdrake_tyre_10_ms_spawn", "mirdrake_tyre_10_ms_fork"}, marks=pytest.mark.slow),
        ("w5", {"wall_ms_per_simulated_s", "cpu_ms_per_simulated_s", "best_error"}),
        pytest.param("tyres", {"drives", "rough_road", "single_track"}, marks=pytest.mark.slow),
        pytest.param("memory", {"growth_repeated_runs_mb", "growth_long_drive_mb"}, marks=pytest.mark.slow),
        pytest.param("startup", {"import_mirdrake_s", "first_step_s"}, marks=pytest.mark.slow),
    ],
)
def test_the_other_jobs_give_their_figures(job: str, keys: set[str]) -> None:
    document = _run(job)
    assert keys <= set(document["jobs"][job])
    assert document["targets"]
