"""Job W4: a sweep of many independent short runs on all cores, set-up included."""

import multiprocessing
import os
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

RUNS, DURATION = 32, 10.0
"""Number of runs, and simulated time of each [s]."""

STEPS = (0.005, 0.010, 0.020)
"""Plant steps [s]; point contact."""

_worker: dict[str, Any] = {}


def run_w4(*, runs: int = RUNS, duration: float = DURATION, repeat: int = 3) -> dict[str, Any]:
    """Wall time per simulated second of the sweep, of mirdrake and of MuJoCo.

    Every run has its own gain of the speed loop. Workers are fresh processes (spawn): starting them, importing and
    building count. Forked workers inherit the imports of this process, and still build.

    Args:
        runs: number of runs.
        duration: simulated time of each [s].
        repeat: how often; the best is given, since other load can only add to it.
    """
    import mirdrake.simulation  # noqa: F401  (forked workers inherit it; not in the peers' workers)
    from mirdrake.diagram_spec import load_diagram

    gains = [0.3 + 0.4 * i / max(runs - 1, 1) for i in range(runs)]
    results = {}
    for step in STEPS:
        data = load_diagram("w1", overrides=["plant.contact=point", f"plant.time_step={step}"]).model_dump(mode="json")
        for method in ("spawn", "fork"):
            results[f"mirdrake_{round(1e3 * step)}_ms_{method}"] = _sweep(
                _start_mirdrake, (data,), _run_mirdrake, gains, duration=duration, repeat=repeat, method=method
            )
    try:
        import mujoco  # noqa: F401
    except ImportError:
        return results
    results["mujoco_pool"] = _sweep(_start_mujoco, (), _run_mujoco, gains, duration=duration, repeat=repeat)
    return results


def _sweep(
    start: Callable[..., None],
    arguments: tuple[Any, ...],
    run: Callable[[tuple[float, float]], float],
    gains: Sequence[float],
    *,
    duration: float,
    repeat: int,
    method: str = "spawn",
) -> dict[str, float | int]:
    """The sweep in a pool of fresh processes: ms of wall time per simulated second, best of several."""
    workers = os.cpu_count() or 1
    walls = []
    jobs = [(gain, duration) for gain in gains]
    for _ in range(repeat):
        began = time.perf_counter()
        with multiprocessing.get_context(method).Pool(workers, start, arguments) as pool:
            speeds = list(pool.imap_unordered(run, jobs))
        walls.append(time.perf_counter() - began)
    simulated = len(gains) * duration
    return {
        "wall_ms_per_simulated_s": 1e3 * min(walls) / simulated,
        "wall_s": min(walls),
        "workers": workers,
        "runs": len(gains),
        "slowest_final_speed": min(speeds),
        "fastest_final_speed": max(speeds),
    }


def _start_mirdrake(data: Mapping[str, Any]) -> None:
    """Build the diagram of this process, once."""
    from mirdrake.diagram import assemble
    from mirdrake.simulation import Simulation

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
