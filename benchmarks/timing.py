"""Common parts of all jobs: stopwatch, statistics, description of the machine."""

import os
import platform
import time
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

ROOT = Path(__file__).resolve().parent
"""Where the models, worlds and diagrams of the jobs are."""


class Times(NamedTuple):
    """Wall and processor time of this process in a call [s]; on a busy machine only the second is meaningful."""

    wall: float
    cpu: float


def timed(call: Callable[[], object]) -> Times:
    """Return the wall and processor time [s] of a call."""
    wall, cpu = time.perf_counter(), time.process_time()
    call()
    return Times(time.perf_counter() - wall, time.process_time() - cpu)


def rates(times: Sequence[Times], *, duration: float, step: float) -> dict[str, float]:
    """Return figures of speed, medians over repetitions.

    Args:
        times: what each repetition took [s].
        duration: simulated time [s].
        step: of the plant [s].
    """
    wall, cpu = median(t.wall for t in times), median(t.cpu for t in times)
    return {
        "rtf": duration / wall,
        "rtf_cpu": duration / cpu,
        "wall_s": wall,
        "cpu_s": cpu,
        "us_per_step": 1e6 * wall * step / duration,
        "cpu_us_per_step": 1e6 * cpu * step / duration,
        "steps_per_s": duration / step / wall,
    }


def machine() -> dict[str, Any]:
    """Processor, cores, load and versions."""
    model = platform.processor() or platform.machine()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.is_file():
        lines = [line for line in cpuinfo.read_text().splitlines() if line.startswith("model name")]
        model = lines[0].partition(":")[2].strip() if lines else model
    return {
        "cpu": model,
        "cores": os.cpu_count(),
        "load_1_min": round(os.getloadavg()[0], 2),
        "python": platform.python_version(),
        "packages": {name: installed(name) for name in ("drake", "mirdrake", "mujoco", "pybullet")},
        "openblas_threads": os.environ.get("OPENBLAS_NUM_THREADS"),
    }


def installed(package: str) -> str | None:
    """Return the version of a package, None if it is not there."""
    try:
        return version(package) if find_spec(package) is not None or package == "drake" else None
    except PackageNotFoundError:
        return None


def resident_mb() -> float:
    """Return the memory of this process that is in RAM [MB]."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def tidy(value: Any) -> Any:
    """Round the floats of a value to five significant digits, the resolution of a benchmark."""
    if isinstance(value, Mapping):
        return {key: tidy(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [tidy(entry) for entry in value]
    return float(f"{value:.5g}") if isinstance(value, float) else value
