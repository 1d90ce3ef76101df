"""Job W5: a sweep of gains of the Bolt's speed loop with delay, by a batch of the single-track model on all cores."""

import multiprocessing
import os
import time
from statistics import median
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

CANDIDATES, DURATION = 1000, 10.0
"""Number of gain sets, and simulated time of each [s]."""

DELAY, STEP = 0.1, 0.005
"""Delay of the actuators [s]; step of the integration [s]."""

GAINS = ((0.1, 0.1), (2.0, 2.0))
"""Smallest and largest kp [1] and ki [1/s] of the speed loop."""

SPEEDS = (5.0, 8.0)
"""Speed at the start, and set-point [m/s]."""


def run_w5(*, candidates: int = CANDIDATES, duration: float = DURATION, repeat: int = 3) -> dict[str, Any]:
    """Return the wall and processor time per simulated second of the sweep, of mirdrake and of MuJoCo.

    The batch has brush tyres, relaxation and actuators behind the vehicle's control unit. Its figure is the integral of
    the absolute speed error of each candidate. The vehicle is loaded and the machine code is there before the clock
    starts; the parameters of the cars and units are prepared while it runs. MuJoCo drives its own car with a PI loop
    without delay, in a pool of fresh processes, as in W4.

    Args:
        candidates: number of gain sets.
        duration: simulated time of each [s].
        repeat: number of repetitions; the median of each time is given.
    """
    from mirdrake.single_track import estimate_parameters
    from mirdrake.vehicles import load_vehicle

    vehicle = load_vehicle("bolt")
    parameters, gains = estimate_parameters(vehicle), sobol_gains(candidates)
    threads = os.cpu_count() or 1
    sweep_batch(vehicle, parameters, gains[:2], duration=0.1, threads=1)  # loads the machine code
    rows: dict[int, list[tuple[float, float]]] = {1: [], threads: []}
    for count, times in rows.items():
        for _ in range(repeat):
            wall, processor = time.perf_counter(), time.process_time()
            errors = sweep_batch(vehicle, parameters, gains, duration=duration, threads=count)
            times.append((time.perf_counter() - wall, time.process_time() - processor))
    simulated = candidates * duration
    walls = {count: median(wall for wall, _ in times) for count, times in rows.items()}
    result: dict[str, Any] = {
        "candidates": candidates,
        "threads": threads,
        "wall_ms_per_simulated_s": 1e3 * walls[threads] / simulated,
        "cpu_ms_per_simulated_s": 1e3 * median(processor for _, processor in rows[1]) / simulated,
        "wall_ratio_of_threads": walls[1] / walls[threads],
        "best_error": float(errors.min()),
        "worst_error": float(errors.max()),
    }
    try:
        import mujoco  # noqa: F401
    except ImportError:
        return result
    from benchmarks.w4 import _start_mujoco

    jobs = [(float(kp), duration) for kp in gains[:, 0]]
    pool_walls = []
    for _ in range(repeat):
        began = time.perf_counter()
        with multiprocessing.get_context("spawn").Pool(threads, _start_mujoco) as pool:
            list(pool.imap_unordered(_run_mujoco, jobs, chunksize=8))
        pool_walls.append(time.perf_counter() - began)
    return result | {"mujoco_pool": {"wall_ms_per_simulated_s": 1e3 * min(pool_walls) / simulated}}


def sobol_gains(count: int) -> NDArray[np.float64]:
    """Return gains kp [1] and ki [1/s] (n, 2) of a Sobol sequence."""
    sampler = qmc.Sobol(2, seed=0)
    return np.asarray(qmc.scale(sampler.random_base2(max(count - 1, 1).bit_length())[:count], *GAINS))


def sweep_batch(
    vehicle: Any, parameters: Any, gains: NDArray[np.float64], *, duration: float, threads: int
) -> NDArray[np.float64]:
    """Return the integral of the absolute speed error [m] of each pair of gains."""
    import mirdrake as mir
    from mirdrake.batched import BatchControl
    from mirdrake.single_track.dynamics import Variant

    variant = Variant("brush", relaxation=True, actuators=True)
    cars = mir.batch(parameters, variant, count=len(gains), step=STEP, threads=threads).reset(vx=SPEEDS[0])
    control = BatchControl(cars, vehicle, gains={"speed.kp": gains[:, 0], "speed.ki": gains[:, 1]}, delay=DELAY)
    commands = np.tile([SPEEDS[1], 0.0], (round(duration / control.period), 1))
    run = control.run(commands, outputs=["vx", "speed_setpoint"])
    return np.asarray(np.abs(run["speed_setpoint"] - run["vx"]).sum(axis=1) * control.period)


def _run_mujoco(job: tuple[float, float]) -> float:
    """Return the final speed [m/s] of a run of MuJoCo's car with a gain of the speed loop."""
    from benchmarks.w4 import _run_mujoco as run

    return run(job)
