"""Plain baseline: linear single track, output error with SciPy. No data check, no structure, no intervals."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.optimize import least_squares

Array = NDArray[np.float64]


ASSUMED = 2.7
"""Wheelbase from which a fit starts if none is given [m], as in the study."""


def simulate(p: Array, log: pd.DataFrame, steering: str) -> Array:
    """Return the yaw rate of a linear single track (Rajamani, section 2.3), by the trapezoidal rule.

    Args:
        p: logarithms of cornering stiffness over mass, front and rear, of yaw inertia over mass, and of the steering
            ratio; offset of the steering [rad]; its delay [s]; logarithm of the wheelbase, in the middle of which the
            centre of mass is [m].
        log: recorded log.
        steering: name of the steering channel.
    """
    front, rear, inertia, ratio = np.exp(p[:4])
    a = 0.5 * np.exp(p[6])
    t, v = log["time"].to_numpy(), np.maximum(log["vx"].to_numpy(), 0.1)
    angle = np.interp(t - p[5], t, log[steering].to_numpy()) / ratio + p[4]
    step, x, states = float(np.median(np.diff(t))), np.zeros(2), np.empty(len(t))
    a11, a12 = -(front + rear) / v, -(front - rear) * a / v - v
    a21, a22 = -(front - rear) * a / (inertia * v), -(front + rear) * a**2 / (inertia * v)
    h = 0.5 * step
    det = (1.0 - h * a11) * (1.0 - h * a22) - h**2 * a12 * a21
    push = np.stack((front * angle, a * front / inertia * angle))
    for i in range(len(t)):
        # (I - h A) x' = (I + h A) x + 2 h B u
        first = x[0] + h * (a11[i] * x[0] + a12[i] * x[1]) + step * push[0, i]
        second = x[1] + h * (a21[i] * x[0] + a22[i] * x[1]) + step * push[1, i]
        x = np.array((((1.0 - h * a22[i]) * first + h * a12[i] * second) / det[i],
                      (h * a21[i] * first + (1.0 - h * a11[i]) * second) / det[i]))  # fmt: skip
        states[i] = x[1]
    return states


def fit_baseline(train: Sequence[Path], validation: Path, steering: str, wheelbase: float | None) -> float:
    """Return the NRMSE fit of the yaw rate of the validation log [%]; without a wheelbase it is fitted as well."""
    logs = [pd.read_parquet(path).dropna() for path in train]
    # The gain of the steering by a regression, the rest from what is usual.
    v, c, r = (np.concatenate([log[name].to_numpy() for log in logs]) for name in ("vx", steering, "yaw_rate"))
    gain = float(np.linalg.lstsq(np.column_stack((v * c, v)), r, rcond=None)[0][0])
    length = wheelbase or ASSUMED
    start = np.array([*np.log([50.0, 60.0, 0.25 * length**2, 1.0 / max(gain * length, 1e-3)]), 0.0, 0.02])
    known = np.log([wheelbase]) if wheelbase else np.zeros(0)
    if not wheelbase:
        start = np.append(start, np.log(length))

    def residuals(p: Array) -> Array:
        p = np.append(p, known)
        parts = [np.nan_to_num(simulate(p, log, steering) - log["yaw_rate"], nan=1e3) for log in logs]
        return np.asarray(np.clip(np.concatenate(parts), -1e3, 1e3))

    scale = float(np.std(r))
    sizes = [1, 1, 1, 1, 0.02, 0.05, 1][: len(start)]
    estimate = least_squares(residuals, start, loss="soft_l1", f_scale=0.1 * scale, x_scale=sizes, max_nfev=40)
    validation_log = pd.read_parquet(validation).dropna()
    best = np.append(estimate.x, known)
    measured, shown = validation_log["yaw_rate"].to_numpy(), simulate(best, validation_log, steering)
    away = measured - shown
    return float(100.0 * (1.0 - np.linalg.norm(away - np.median(away)) / np.linalg.norm(measured - measured.mean())))
