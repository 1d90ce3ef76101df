"""Job W4: a sweep of many independent short runs on all cores, set-up included, by a study of mirdrake.studies."""

import json
import multiprocessing
import os
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

RUNS, DURATION = 32, 10.0
"""Number of runs, and simulated time of each [s]."""

PLANTS = (("tyre", 0.005), ("tyre", 0.010), ("tyre", 0.020), ("point", 0.005), ("point", 0.020))
"""Contact settings and plant steps [s]."""

GAINS = (0.3, 0.7)
"""Range of the speed loop's gain over the runs."""

_worker: dict[str, Any] = {}


def run_w4(*, runs: int = RUNS, duration: float = DURATION, repeat: int = 3) -> dict[str, Any]:
    """Return the wall time per simulated second of the sweep, of mirdrake and of MuJoCo.

    Every run has its own gain of the speed loop. `spawn`: the first study of a process; its workers start, import and
    build. `fork`: the second one; the workers fork from a server that has imported everything, and build. `plain_pool`:
    the same runs of the same diagram by hand in a pool of fresh processes, without a study. `cpu`: processor time of
    runs one after the other in one process.

    Args:
        runs: number of runs.
        duration: simulated time of each [s].
        repeat: how often; the best is given, since other load can only add to it.
    """
    from mirdrake.assembly.diagram_spec import load_diagram

    gains = [float(gain) for gain in _gains(runs)]
    results: dict[str, Any] = {}
    for contact, step in PLANTS:
        plant = f"{contact}_{round(1e3 * step)}_ms"
        study = _study(contact, step, runs, duration)
        repetitions = [_measure(study) for _ in range(repeat)]
        for name in ("spawn", "fork"):
            results[f"mirdrake_{plant}_{name}"] = _row(
                [repetition[name] for repetition in repetitions], runs, duration, repetitions[0]["speeds"]
            )
        results[f"cpu_{plant}"] = {
            key: min(repetition["cpu"][key] for repetition in repetitions)
            for key in ("set_up_s", "s_per_run", "ms_per_simulated_s")
        }
    data = load_diagram("w1", overrides=[f"plant.contact={contact}", f"plant.time_step={step}"]).model_dump(mode="json")
    results[f"plain_pool_{plant}"] = _sweep(
        _start_mirdrake, (data,), _run_mirdrake, gains, duration=duration, repeat=repeat
    )
    try:
        import mujoco  # noqa: F401
    except ImportError:
        return results
    results["mujoco_pool"] = _sweep(_start_mujoco, (), _run_mujoco, gains, duration=duration, repeat=repeat)
    return results


def final_speed(run: Any) -> float:
    """Metric of the study: the speed at the end [m/s]."""
    return float(run["ego.vx"].iloc[-1])


def _gains(runs: int) -> list[float]:
    return [GAINS[0] + (GAINS[1] - GAINS[0]) * i / max(runs - 1, 1) for i in range(runs)]


def _study(contact: str, step: float, runs: int, duration: float) -> dict[str, Any]:
    return {
        "diagram": "w1",
        "overrides": {"plant.contact": contact, "plant.time_step": step},
        "parameters": {"ego.speed.kp": {"values": _gains(runs)}},
        "metrics": ["benchmarks.w4:final_speed"],
        "duration": duration,
    }


def _measure(study: Mapping[str, Any]) -> dict[str, Any]:
    """Return a study in a process of its own, twice, and a few of its runs in that process alone."""
    root = Path(__file__).resolve().parents[1]
    path = os.pathsep.join([str(root), *filter(None, [os.environ.get("PYTHONPATH")])])
    command = [sys.executable, "-m", "benchmarks.w4", json.dumps(study)]
    done = subprocess.run(command, env=os.environ | {"PYTHONPATH": path}, check=True, stdout=subprocess.PIPE, text=True)
    result: dict[str, Any] = json.loads(done.stdout)
    return result


def _time_study(study: Mapping[str, Any]) -> dict[str, Any]:
    """Return the result of :func:`_measure`; it includes imports of the workers, but not of this process."""
    from mirdrake.studies import run_study

    results: dict[str, Any] = {}
    for name in ("spawn", "fork"):
        began = time.perf_counter()
        result = run_study(study)
        results[name] = time.perf_counter() - began
        assert result.counts["ok"] == result.runs
        results["speeds"] = result.table["benchmarks.w4:final_speed"].tolist()
    few = dict(study) | {"parameters": {"ego.speed.kp": {"values": study["parameters"]["ego.speed.kp"]["values"][:6]}}}
    times = [time.process_time()]
    run_study(few, workers=0, progress=lambda *_: times.append(time.process_time()))
    each = sorted(b - a for a, b in pairwise(times[1:]))
    run = each[len(each) // 2] if each else times[1] - times[0]
    results["cpu"] = {"set_up_s": times[1] - times[0] - run, "s_per_run": run}
    results["cpu"]["ms_per_simulated_s"] = 1e3 * run / study["duration"]
    return results


def _row(walls: Sequence[float], runs: int, duration: float, speeds: Sequence[float]) -> dict[str, float | int]:
    return {
        "wall_ms_per_simulated_s": 1e3 * min(walls) / (runs * duration),
        "wall_s": min(walls),
        "workers": os.cpu_count() or 1,
        "runs": runs,
        "slowest_final_speed": min(speeds),
        "fastest_final_speed": max(speeds),
    }


def _sweep(
    start: Callable[..., None],
    arguments: tuple[Any, ...],
    run: Callable[[tuple[float, float]], float],
    gains: Sequence[float],
    *,
    duration: float,
    repeat: int,
) -> dict[str, float | int]:
    """Return the sweep in a pool of fresh processes: ms of wall time per simulated second, best of several."""
    workers = os.cpu_count() or 1
    walls = []
    jobs = [(gain, duration) for gain in gains]
    for _ in range(repeat):
        began = time.perf_counter()
        with multiprocessing.get_context("spawn").Pool(workers, start, arguments) as pool:
            speeds = list(pool.imap_unordered(run, jobs))
        walls.append(time.perf_counter() - began)
    return _row(walls, len(gains), duration, speeds)


def _start_mirdrake(data: Mapping[str, Any]) -> None:
    """Build the diagram of this process, once."""
    from mirdrake.assembly.diagram import assemble
    from mirdrake.runs.simulation import Simulation

    _worker["simulation"] = Simulation(assemble(data))


def _run_mirdrake(job: tuple[float, float]) -> float:
    """One run with a gain of the speed loop; the final speed [m/s]."""
    gain, duration = job
    simulation = _worker["simulation"]
    control = simulation.assembly.diagram.GetSubsystemByName("ego.control")

    def change(context: Any) -> None:
        gains = control.GetMyMutableContextFromRoot(context).get_mutable_numeric_parameter(0)
        gains.SetAtIndex(0, gain)

    return float(simulation.run(duration=duration, change=change)["ego.vx"].iloc[-1])


def _start_mujoco() -> None:
    """Build the model of this process, once."""
    from benchmarks.peers import MujocoCar

    _worker["car"] = MujocoCar(wheels="cylinder")


def _run_mujoco(job: tuple[float, float]) -> float:
    """One run with a gain of the speed loop; the final speed [m/s]."""
    from benchmarks.peers import Driver

    gain, duration = job
    return float(_worker["car"].run(duration, Driver(kp=gain))[-1, 4])


if __name__ == "__main__":
    print(json.dumps(_time_study(json.loads(sys.argv[1]))))
