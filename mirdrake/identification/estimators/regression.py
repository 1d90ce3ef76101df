"""Regressions with linear parameters and intervals for autocorrelated residuals.

- coast_down: d|v|/dt over windows = -(A + B |v| + C v²) / m, with released pedals and straight driving.
- understeer: steering channel = ratio (L r / v + K ay) + bias, in quasi-steady turns.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d

from mirdrake.core.constants import GRAVITY
from mirdrake.core.errors import ConfigError
from mirdrake.identification.alignment import smooth
from mirdrake.identification.data import DataSet, Log
from mirdrake.identification.estimators.covariance import Stretch, score_covariance
from mirdrake.identification.excitation import STRAIGHT
from mirdrake.identification.fit import Fit, FittedParameter
from mirdrake.identification.models.base import SPEED, Array, find_channel
from mirdrake.identification.models.steer import STEERING
from mirdrake.identification.relations import make_grid

_LEAST_ROWS = 20


@dataclass(frozen=True)
class Regression:
    """Result of y = X b + e.

    Attributes:
        values: b (p).
        covariance: covariance of b (p, p), allowing for autocorrelated e.
        residual: e (n).
        condition: condition number of the scaled XᵀX.
    """

    values: Array
    covariance: Array
    residual: Array
    condition: float


def regress(y: Array, X: Array, groups: Sequence[slice] | None = None, *, robust: bool = True) -> Regression:
    """Solve a least-squares regression, with Huber's weights if robust.

    Args:
        y: dependent variable (n).
        X: regressors (n, p).
        groups: stretches of consecutive rows.
        robust: whether large residuals count less.

    Raises:
        ConfigError: too few rows, or linearly dependent columns.
    """
    n, p = X.shape
    if n < max(3 * p, _LEAST_ROWS):
        raise ConfigError(f"regression: {n} rows for {p} parameters; record longer")
    # Columns are scaled to unit length, so that rank and condition do not depend on units.
    size = np.linalg.norm(X, axis=0)
    if np.any(size == 0.0) or np.linalg.matrix_rank(X / np.maximum(size, 1e-300), tol=1e-9) < p:
        raise ConfigError("regression: the columns are not independent; vary speed and steering")
    weights = np.ones(n)
    values = np.zeros(p)
    # Iteratively reweighted least squares; 1.4826 · median is the standard deviation of normal residuals.
    for _ in range(30 if robust else 1):
        root = np.sqrt(weights)
        new = np.linalg.lstsq(X * root[:, None] / size, y * root, rcond=None)[0] / size
        rest = y - X @ new
        sigma = 1.4826 * float(np.median(np.abs(rest))) or 1.0
        weights = 1.0 / np.maximum(np.abs(rest) / (2.5 * sigma), 1.0)
        done = np.allclose(new, values, rtol=1e-10, atol=0.0)
        values = new
        if done:
            break
    if not robust:
        weights = np.ones(n)
    rest = y - X @ values
    # The covariance allows for autocorrelated residuals.
    inside = (X * weights[:, None]).T @ X
    inverse = np.linalg.inv(inside / np.outer(size, size)) / np.outer(size, size)
    # Sandwich covariance: rows of a log are neighbours in time, so their residuals are not independent.
    pulls, there = (weights * rest)[:, None], np.ones((n, 1), dtype=bool)
    stretches = [Stretch(X[rows, None], pulls[rows], there[rows]) for rows in groups or [slice(0, n)]]
    covariance = inverse @ score_covariance(stretches)[0] @ inverse * n / (n - p)
    own = np.sqrt(np.diag(inside))
    values_ = np.linalg.eigvalsh(inside / np.outer(own, own))
    return Regression(values, covariance, rest, float(values_[-1] / max(values_[0], 1e-300)))


def coast_down(data: DataSet, *, mass: float | None = None, linear: bool = False, window: float = 1.0) -> Fit:
    """Estimate the road load F = A + B v + C v² over the mass from coasting.

    Args:
        data: training logs; pedals and yaw rate, if recorded, mark where the vehicle coasts straight ahead.
        mass: mass with the equivalent mass of rotating parts [kg]; None: everything per kilogram.
        linear: whether there is a term B v.
        window: length over which the deceleration is taken [s].

    Raises:
        ConfigError: not enough coasting.
    """
    # Each log is a stretch of its own for the autocorrelation.
    rows, groups, row = [], [], 0
    for log in data.train:
        part = _coasting(log, window)
        rows.append(part)
        groups.append(slice(row, row + len(part)))
        row += len(part)
    table = np.concatenate(rows) if rows else np.zeros((0, 3))
    if len(table) < _LEAST_ROWS:
        raise ConfigError(
            f"data: {len(table)} s of coasting; record a coast-down without pedals, {_LEAST_ROWS} s at least"
        )
    change, speed, square = table.T
    # Without a mass, forces are per kilogram.
    factor = mass or 1.0
    unit = "N" if mass else "N/kg"
    columns = [np.ones(len(speed)), speed, square] if linear else [np.ones(len(speed)), square]
    regression = regress(-change * factor, np.column_stack(columns), groups)
    names = (
        [("A", unit), ("B", f"{unit} s/m"), ("C", f"{unit} s^2/m^2")]
        if linear
        else [("A", unit), ("C", f"{unit} s^2/m^2")]
    )
    text = f"over {window:g} s windows from {speed.min():.3g} to {speed.max():.3g} m/s"
    return _fit(data, "coast-down, F = A + B v + C v²", f"regression {text}", names, regression)


def _coasting(log: Log, window: float) -> Array:
    """Return rows of the change of the speed's magnitude [m/s²], its mean and mean square; see :func:`coast_down`."""
    name = find_channel(set(log.channels), SPEED, "the speed", "coast_down")
    grid = make_grid(log)
    # The road load opposes the motion in both directions.
    v = np.abs(grid.channels[name])
    free = v > 1.0
    for pedal in ("throttle", "brake"):
        if pedal in grid.channels:
            free &= grid.channels[pedal] < 0.01
    # In turns the tyres' side forces also slow the car, which would count as drag.
    if "yaw_rate" in grid.channels:
        free &= np.abs(smooth(grid, "yaw_rate") * v) < STRAIGHT
    # Slope of the speed by regression over each window: differences of neighbouring samples are mostly noise.
    many = max(round(window / grid.step), 4)
    samples = []
    x = (np.arange(many) - 0.5 * (many - 1)) * grid.step
    for first in range(0, len(v) - many + 1, many):
        if free[first : first + many].all():
            part = v[first : first + many]
            samples.append((float(x @ part) / float(x @ x), float(part.mean()), float(np.mean(part**2))))
    return np.array(samples).reshape(-1, 3)


def understeer(data: DataSet, *, wheelbase: float | None = None, highest: float = 4.0) -> Fit:
    """Estimate ratio and bias of the steering and the understeer gradient from quasi-steady turns.

    Args:
        data: training logs.
        wheelbase: front to rear axle [m]; None: that of the data set, or 1 m, so that the ratio is per metre of
        wheelbase.
        highest: largest lateral acceleration of the rows used [m/s²].

    Raises:
        ConfigError: a channel is missing, or too few turns.
    """
    length = wheelbase or data.wheelbase or 1.0
    ys, xs, groups, row = [], [], [], 0
    for log in data.train:
        steer = find_channel(set(log.channels), STEERING, "the steering", "understeer")
        forward = find_channel(set(log.channels), SPEED, "the speed", "understeer")
        rate = find_channel(set(log.channels), ("yaw_rate",), "the yaw rate", "understeer")
        grid = make_grid(log)
        # All channels get the same smoothing, so that it causes no delay between them.
        width = 0.3 / grid.step
        v, r, angle = (gaussian_filter1d(grid.channels[name], width) for name in (forward, rate, steer))
        slow = gaussian_filter1d(np.abs(np.gradient(angle, grid.step)), width)
        # Quasi-steady rows: the fifth with the fastest steering is left out, where yaw lags the steering.
        good = (v > 3.0) & (np.abs(v * r) < highest) & (slow <= max(float(np.percentile(slow, 80.0)), 1e-9))
        # Smoothed neighbours carry the same information.
        many = max(round(0.2 / grid.step), 1)
        rows = np.flatnonzero(good)[::many]
        ys.append(angle[rows])
        xs.append(np.column_stack((length * r[rows] / v[rows], v[rows] * r[rows], np.ones(len(rows)))))
        groups.append(slice(row, row + len(rows)))
        row += len(rows)
    regression = regress(np.concatenate(ys), np.concatenate(xs), groups)
    ratio = regression.values[0]
    # K = b1 / b0 and the bias at the wheels = b2 / b0 follow by the delta method.
    turn = np.array(
        [
            [1.0, 0.0, 0.0],
            [-regression.values[1] / ratio**2, 1.0 / ratio, 0.0],
            [-regression.values[2] / ratio**2, 0.0, 1.0 / ratio],
        ]
    )
    values = np.array([ratio, regression.values[1] / ratio, regression.values[2] / ratio])
    regression = Regression(values, turn @ regression.covariance @ turn.T, regression.residual, regression.condition)
    names = [("steering_ratio", "1"), ("understeer_gradient", "rad s^2/m"), ("steering_bias", "rad")]
    return _fit(
        data, "steady turns, δ = ratio (L r / v + K ay + bias)", "regression of quasi-steady samples", names, regression
    )


def _fit(data: DataSet, model: str, how: str, names: Sequence[tuple[str, str]], regression: Regression) -> Fit:
    sigmas, residual = np.sqrt(np.diag(regression.covariance)), regression.residual
    correlation = regression.covariance / np.outer(sigmas, sigmas)
    parameters = []
    for i, (name, unit) in enumerate(names):
        value, sigma = float(regression.values[i]), float(sigmas[i])
        # Bias and gradient may be zero, so their deviation is compared with a usual size instead.
        size = abs(value) if name not in {"steering_bias", "understeer_gradient"} else 0.01
        span = sigma / max(size, 1e-300)
        verdict = "identified" if span < 0.06 else "weakly identified" if span < 0.15 else "not identifiable"
        parameters.append(
            FittedParameter(name, unit, value, sigma, value - 1.96 * sigma, value + 1.96 * sigma,
                            verdict=verdict, explanation=f"known to ± {1.96 * sigma:.2g} {unit}")  # type: ignore[arg-type]
        )  # fmt: skip
    return Fit(
        "regression", model, how, tuple(parameters), correlation, regression.condition, data_sha256=data.digest,
        notes=(f"{len(residual)} rows, rms of the residual {float(np.sqrt(np.mean(residual**2))):.3g}",),
    )  # fmt: skip


def road_load_coefficients(
    fit: Fit, mass: float, *, gravity: float = GRAVITY, density: float = 1.2
) -> Mapping[str, float]:
    """Return rolling resistance [1] and drag area [m²] of a coast-down for a mass.

    Args:
        fit: result of :func:`coast_down`, with or without a mass.
        mass: mass of the vehicle [kg].
        gravity: [m/s²].
        density: of the air [kg/m³].
    """
    # A fit without a mass has forces per kilogram.
    scale = mass if fit["A"].unit == "N/kg" else 1.0
    a, c = scale * fit["A"].value, scale * fit["C"].value
    return {"rolling_resistance": a / (mass * gravity), "drag_area": 2.0 * c / density}
