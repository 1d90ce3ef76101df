"""Write the logs of ``studies/identify_two_track.yaml``: a car with effects that the fitted model lacks.

::

    python -m benchmarks.calibration.showcase studies/data/two_track

The truth has two tracks, load transfer, load-dependent Magic Formula tyres, relaxation and roll
(:mod:`benchmarks.calibration.truth`); the sensors have noise and a bias, the steering a dead time.
"""

import sys
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.ndimage import gaussian_filter1d

from benchmarks.calibration.truth import GRAVITY, STEP, Array, Vehicle, drive

CAR = Vehicle(
    "two_track", 1540.0, 1.25, 1.55, 2600.0, 98e3, 132e3, 0.95, relaxation=0.45, ratio=15.2, delay=0.04, height=0.52,
    track=1.55, roll_gain=0.005, load_exponent=0.9, drive_front=1.0,
)  # fmt: skip

SPAN, SAMPLE = 36.0, 0.02


def commands() -> dict[str, tuple[Array, Array]]:
    """Return speed [m/s] and hand wheel angle [rad] of each log."""
    time = np.arange(0.0, SPAN, STEP)
    random = np.random.default_rng(7)
    begin = np.clip(time - 1.0, 0.0, 1.0)
    sweep = np.sin(2.0 * np.pi * (0.15 * time + 0.5 * (2.2 / SPAN) * time**2))
    levels = random.uniform(-1.0, 1.0, int(SPAN / 3.0) + 1)[(time / 3.0).astype(int)]
    mixed = gaussian_filter1d(random.normal(size=len(time)), 0.2 / STEP)
    return {
        "sweep": (22.0 + 1.0 * np.sin(0.3 * time), 0.35 * begin * sweep),
        "steps": (9.0 + 6.0 * time / SPAN, 1.1 * begin * gaussian_filter1d(levels, 0.08 / STEP)),
        "random": (17.0 + 2.0 * np.sin(0.25 * time), 0.30 * begin * mixed / np.std(mixed)),
    }


def main(folder: Path) -> None:
    """Write a CSV file for each log."""
    folder.mkdir(parents=True, exist_ok=True)
    random = np.random.default_rng(11)
    for name, (speed, command) in commands().items():
        motion = drive(CAR, speed, command)
        time = np.arange(0.2, SPAN - 0.2, SAMPLE)
        side = motion.rate(motion.lateral) + motion.speed * motion.yaw_rate + GRAVITY * np.sin(motion.roll)
        true = {
            "speed [m/s]": (motion.speed, 0.03, 0.0),
            "yaw rate [deg/s]": (np.rad2deg(motion.yaw_rate), 0.12, 0.2),
            "lateral acceleration [m/s^2]": (side, 0.06, 0.05),
            "hand wheel [deg]": (np.rad2deg(motion.command), 0.2, 0.0),
        }  # fmt: skip
        columns = {"t [s]": time - time[0]}
        for column, (values, noise, bias) in true.items():
            columns[column] = np.interp(time, motion.time, values) + random.normal(0.0, noise, len(time)) + bias
        pd.DataFrame(columns).round(4).to_csv(folder / f"{name}.csv", index=False)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
