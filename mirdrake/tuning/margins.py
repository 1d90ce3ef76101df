"""Stability margins of a loop: gain, phase and delay margins, Ms, Mt and the disk margin.

They are computed from the frequency response of the open loop L, with its exact dead time: on a grid that is refined
where the curve turns, then in finer grids around roots and peaks. For loops without dead time they equal those of
python-control, which does not support dead time. Definitions: K. J. Åström and R. M. Murray, Feedback Systems, 2nd ed.,
sections 10.3 and 12.1; disk margin: P. Seiler, A. Packard and P. Gahinet, An introduction to disk margins, IEEE Control
Systems Magazine 40 (2020) 78, with skew 0. Margins have no meaning for an unstable loop; check
:func:`mirdrake.tuning.stability.is_stable` first.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mirdrake.core.checks import check_number
from mirdrake.core.errors import ConfigError
from mirdrake.core.pid import PidGains
from mirdrake.tuning.frequency_response import FrequencyResponse
from mirdrake.tuning.gains import controller_response
from mirdrake.tuning.models import Complexes, FirstOrder, Floats, Integrator, Plant, TransferFunction, frequency_range

LoopResponse = Callable[[Floats], Complexes]

_MAX_POINTS = 10_000


@dataclass(frozen=True, slots=True)
class Margins:
    """Margins of a loop; inf or 0 without a limit, nan for a frequency that does not exist.

    Attributes:
        gain_margin: factor on the gain, nearest to 1 in logarithm, that causes sustained oscillation [1].
        gain_increase: smallest such factor above 1 [1]; inf without one.
        gain_decrease: largest such factor below 1 [1]; 0 without one.
        phase_margin: phase lag of the smallest modulus that causes it [rad]; negative if phase lead is required.
        delay_margin: additional dead time that causes it [s].
        phase_crossover: frequency of `gain_margin` [rad/s].
        gain_crossover: frequency of `phase_margin` [rad/s].
        max_sensitivity: Ms, largest |1/(1+L)| [1].
        max_complementary: Mt, largest |L/(1+L)| [1].
        sensitivity_peak: frequency of Ms [rad/s].
        disk_margin: α, smallest 2 |1+L|/|1-L| [1]; 2 allows any gain and 90°.
        disk_gain: the gain may change by a factor between 1/disk_gain and disk_gain, together with the phase [1].
        disk_phase: allowed change of the phase [rad].
    """

    gain_margin: float
    gain_increase: float
    gain_decrease: float
    phase_margin: float
    delay_margin: float
    phase_crossover: float
    gain_crossover: float
    max_sensitivity: float
    max_complementary: float
    sensitivity_peak: float
    disk_margin: float
    disk_gain: float
    disk_phase: float


@dataclass(frozen=True, slots=True)
class UltimatePoint:
    """Ultimate point of a plant: gain Ku [u/y] and period Tu [s] of sustained oscillation under P control."""

    gain: float
    period: float


def loop_response(plant: Plant, gains: PidGains, *, period: float | None = None) -> LoopResponse:
    """Return the open loop ``C(jω) G(jω)`` as a function of ω [rad/s]; `period` as in ``controller_response``."""
    return lambda w: plant.response(w) * controller_response(gains, w, period=period)


def loop_range(plant: Plant, gains: PidGains | None = None, *, period: float | None = None) -> tuple[float, float]:
    """Return the range of frequencies [rad/s] in which the gain of a loop falls from large to small.

    Args:
        plant: the plant; a measured one has its own range.
        gains: gains of the controller; None: a gain of 1.
        period: period of the controller [s]; the range ends at π/period.
    """
    if isinstance(plant, FrequencyResponse):
        low, high = float(plant.frequencies[0]), float(plant.frequencies[-1])
        return low, min(high, math.pi / period) if period else high
    model = rational_model(plant)
    if model is None:
        raise ConfigError(
            f"the range of frequencies of a {type(plant).__name__} is not known; give the lowest and the highest"
        )
    low, high = frequency_range(model)
    # Corner frequencies of the controller: the range must contain them with room on both sides.
    gains = PidGains(1.0) if gains is None else gains
    corners = [abs(gains.ki / gains.kp)] if gains.ki and gains.kp else []
    corners += [1.0 / gains.filter_time] if gains.filter_time else []
    corners += [abs(gains.kp / gains.kd)] if gains.kp and gains.kd else []
    low, high = min([low, *(c * 1e-3 for c in corners)]), max([high, *(c * 1e1 for c in corners)])

    def size(w: float) -> float:
        return float(np.abs(plant.response(np.array([w])) * controller_response(gains, np.array([w])))[0])

    # Upwards until the loop gain is small, so that no crossing of the unit circle is missed.
    for _ in range(8):
        if size(high) < 0.05:
            break
        high *= 10.0
    # Downwards as long as an integrator lets the gain grow.
    for _ in range(8):
        if not 0.05 < size(low) < 20.0 or not (gains.ki or model.denominator[-1] == 0.0):
            break
        low *= 0.1
    return low, min(high, 0.999 * math.pi / period) if period else high


def find_margins(
    plant: Plant,
    gains: PidGains,
    *,
    period: float | None = None,
    frequencies: tuple[float, float] | None = None,
) -> Margins:
    """Return the margins of a plant under PID control.

    Args:
        plant: model or measured frequency response.
        gains: gains of the controller.
        period: period of the controller [s], None: continuous.
        frequencies: lowest and highest frequency [rad/s]; by default from :func:`loop_range`.
    """
    low, high = loop_range(plant, gains, period=period) if frequencies is None else frequencies
    return margins_of(loop_response(plant, gains, period=period), low, high)


def margins_of(response: LoopResponse, low: float, high: float) -> Margins:
    """Return the margins of an open loop.

    Args:
        response: L(jω) for an array of ω [rad/s].
        low: lowest frequency [rad/s].
        high: highest frequency [rad/s].

    Raises:
        ConfigError: the range is empty, or the response is not finite in it.
    """
    w, value = frequency_grid(response, low, high)

    # Crossings of the negative real axis, and of the unit circle.
    # Sign changes of the imaginary part on the left half: candidates for crossings of the negative real axis.
    turns = np.flatnonzero(
        (np.sign(value.imag[1:]) != np.sign(value.imag[:-1])) & (value.real[1:] + value.real[:-1] < 0.0)
    )
    phase_crossings = _roots(lambda x: np.asarray(response(x).imag), w[turns], w[turns + 1])
    # The root may also be a jump through the right half; only real crossings have a gain margin.
    factors = [
        (1.0 / abs(at), float(x))
        for at, x in zip(response(phase_crossings), phase_crossings, strict=True)
        if at.real < 0.0
    ]
    size = np.abs(value) - 1.0
    turns = np.flatnonzero(np.sign(size[1:]) != np.sign(size[:-1]))
    gain_crossings = _roots(lambda x: np.abs(response(x)) - 1.0, w[turns], w[turns + 1])

    # Angle of -L: phase above -180°, in (-π, π].
    phases = list(zip(np.angle(-response(gain_crossings)).tolist(), gain_crossings.tolist(), strict=True))
    # The nearest margin counts, to both sides: for conditionally stable loops also a decrease of the gain.
    gain, phase_crossover = min(factors, key=lambda pair: abs(math.log(pair[0])), default=(math.inf, math.nan))
    phase, gain_crossover = min(phases, key=lambda pair: abs(pair[0]), default=(math.inf, math.nan))

    # Peaks of the sensitivities.
    # Ms = max |1 / (1 + L)|, Mt = max |L / (1 + L)|, disk margin = 1 / max |S - T| / 2, refined between grid points.
    (ms, mt, inverse), (peak, _, _) = _peaks(response, w, value)
    disk = 1.0 / float(inverse)
    return Margins(
        gain_margin=gain,
        gain_increase=min((f for f, _ in factors if f >= 1.0), default=math.inf),
        gain_decrease=max((f for f, _ in factors if f < 1.0), default=0.0),
        phase_margin=phase,
        # Dead time turns the phase back by ω L: an angle below zero has to turn on by a whole turn.
        delay_margin=min((angle % (2.0 * math.pi) / x for angle, x in phases), default=math.inf),
        phase_crossover=phase_crossover,
        gain_crossover=gain_crossover,
        max_sensitivity=float(ms),
        max_complementary=float(mt),
        sensitivity_peak=float(peak),
        disk_margin=float(disk),
        # Symmetric disk margin: gains between (2 - α) / (2 + α) and its inverse, phases to 2 atan(α / 2).
        disk_gain=(2.0 + disk) / (2.0 - disk) if disk < 2.0 else math.inf,
        disk_phase=2.0 * math.atan(0.5 * disk),
    )


def ultimate_point(plant: Plant, *, frequencies: tuple[float, float] | None = None) -> UltimatePoint | None:
    """Return the exact ultimate point of a plant; None if its phase does not cross -180°.

    Args:
        plant: model or measured frequency response.
        frequencies: lowest and highest frequency [rad/s]; by default from :func:`loop_range`.
    """
    low, high = loop_range(plant) if frequencies is None else frequencies
    w, value = frequency_grid(plant.response, low, high)
    for k in range(len(w) - 1):
        a, b = value[k], value[k + 1]
        if a.imag < 0.0 <= b.imag and a.real + b.real < 0.0:
            x = _roots(lambda x: np.asarray(plant.response(x).imag), w[k : k + 1], w[k + 1 : k + 2])
            return UltimatePoint(1.0 / abs(complex(plant.response(x)[0])), 2.0 * math.pi / float(x[0]))
    return None


def frequency_grid(response: LoopResponse, low: float, high: float) -> tuple[Floats, Complexes]:
    """Return frequencies [rad/s] and response, dense enough to resolve the Nyquist curve near -1.

    Starting with 40 points per decade, an interval is halved while its chord is longer than a fifth of its distance to
    -1 and the response is larger than 0.01.

    Raises:
        ConfigError: the range is empty, or the response is not finite in it.
    """
    check_number("frequencies", "low", low, unit="rad/s", above=0.0)
    check_number("frequencies", "high", high, unit="rad/s", above=low)
    # Logarithmic grid: 40 points per decade, refined only near -1.
    w = np.geomspace(low, high, max(round(40.0 * math.log10(high / low)), 40))
    value = response(w)
    for _ in range(12):
        if not np.isfinite(value).all():
            raise ConfigError(f"the open loop has a pole on the imaginary axis between {low:.4g} and {high:.4g} rad/s")
        chord = np.abs(np.diff(value))
        near = np.abs(1.0 + value)
        small = np.maximum(np.abs(value[1:]), np.abs(value[:-1])) < 0.01
        # Small responses are far from -1 whatever their phase, as those of a dead time at high frequencies.
        split = np.flatnonzero((chord > 0.2 * np.minimum(near[1:], near[:-1])) & ~small)
        if not len(split) or len(w) > _MAX_POINTS:
            break

        # Geometric mean, the middle on the logarithmic axis.
        new = np.sqrt(w[split] * w[split + 1])
        w = np.insert(w, split + 1, new)
        value = np.insert(value, split + 1, response(new))
    return w, value


def rational_model(plant: Plant) -> TransferFunction | None:
    """Return a model as a transfer function; None for a measured frequency response."""
    if isinstance(plant, FirstOrder | Integrator):
        return plant.transfer_function()
    return plant if isinstance(plant, TransferFunction) else None


def _roots(function: Callable[[Floats], Floats], a: Floats, b: Floats) -> Floats:
    """Return a root in each interval, all at once: the part of an interval in which the sign changes, then a chord."""
    if not len(a):
        return a
    share = np.linspace(0.0, 1.0, 9)
    # 40 points per decade are 6 % apart; five rounds leave 2e-6, and the chord an error of about the square.
    for _ in range(5):
        x = a[:, None] + (b - a)[:, None] * share
        values = function(x.ravel()).reshape(x.shape)
        changes = np.sign(values[:, 1:]) != np.sign(values[:, :-1])
        # Rounding can hide the sign change: then the last part.
        k = np.where(changes.any(axis=1), np.argmax(changes, axis=1), len(share) - 2)
        rows = np.arange(len(a))
        a, b, start, end = x[rows, k], x[rows, k + 1], values[rows, k], values[rows, k + 1]
    with np.errstate(divide="ignore", invalid="ignore"):
        part = np.clip(start / (start - end), 0.0, 1.0)
    return a + (b - a) * np.where(np.isfinite(part), part, 0.5)


def _peaks(response: LoopResponse, w: Floats, value: Complexes) -> tuple[Floats, Floats]:
    """Return the largest |S|, |T| and |S - T| / 2 and their frequencies, refined between neighbours on the grid."""

    def sizes(loop: Complexes) -> Floats:
        return np.array([np.ones(loop.shape), np.abs(loop), 0.5 * np.abs(1.0 - loop)]) / np.abs(1.0 + loop)

    rows = np.arange(3)
    on_grid = sizes(value)
    k = np.argmax(on_grid, axis=1)
    best, place = on_grid[rows, k], w[k]
    a, b = w[np.maximum(k - 1, 0)], w[np.minimum(k + 1, len(w) - 1)]
    # Each round leaves a quarter of the interval; near a peak the value changes with the square of the distance.
    for _ in range(8):
        x = a[:, None] + (b - a)[:, None] * np.linspace(0.0, 1.0, 9)
        values = sizes(response(x.ravel()).reshape(x.shape))[rows, rows]
        k = np.argmax(values, axis=1)
        better = values[rows, k] > best
        best, place = np.where(better, values[rows, k], best), np.where(better, x[rows, k], place)
        a, b = x[rows, np.maximum(k - 1, 0)], x[rows, np.minimum(k + 1, 8)]
    return best, place
