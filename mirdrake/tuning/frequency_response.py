"""Frequency response of a plant from an experiment in closed loop.

An excitation e is added to the control of the closed loop; in steady state, Fourier coefficients of u and y over whole
periods give G = Y / U. Since u is measured after the controller, feedback causes no bias; averaging U and Y over the
periods before the division keeps the bias from noise small (R. Pintelon and J. Schoukens, System Identification: A
Frequency Domain Approach, 2nd ed., section 2.6). Multisine phases: M. R. Schroeder, IEEE Trans. Inf. Theory 16 (1970)
85.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy  # its parts are imported when they are first used
from numpy.typing import ArrayLike, NDArray

from mirdrake.core.checks import check_number
from mirdrake.core.errors import ConfigError, RunError
from mirdrake.tuning.fourier import fourier_line
from mirdrake.tuning.gains import hold_response
from mirdrake.tuning.models import Complexes, Floats

Measurements = Callable[[float], tuple[float, ...]]
"""A loop: adds an excitation, returns the control and the measurements."""


@dataclass(frozen=True, slots=True)
class FrequencyResponse:
    """Frequency response at some frequencies; between them, logarithm and phase are interpolated over log ω.

    Attributes:
        frequencies: ω [rad/s], increasing, shape (n,), n >= 2.
        values: G(jω) [y/u], not zero, shape (n,). The phase of neighbours must differ by less than π.
        deviation: standard deviation of `values` [y/u], shape (n,), or None.

    Raises:
        ConfigError: shapes, order or values are not valid.
    """

    frequencies: Floats
    values: Complexes
    deviation: Floats | None = None

    def __post_init__(self) -> None:
        w, g = self.frequencies, self.values
        if w.ndim != 1 or len(w) < 2 or w.shape != g.shape or not (w > 0.0).all() or not (np.diff(w) > 0.0).all():
            raise ConfigError(
                "FrequencyResponse: frequencies must be positive and increasing, two at least, one value each"
            )
        if not np.isfinite(g).all() or not np.abs(g).all():
            raise ConfigError("FrequencyResponse: every value must be finite and not zero")

    def response(self, frequencies: ArrayLike) -> Complexes:
        """Return G(jω) at `frequencies` [rad/s].

        Raises:
            ConfigError: a frequency outside of the measured range.
        """
        wanted = np.asarray(frequencies, dtype=float)
        low, high = self.frequencies[0], self.frequencies[-1]
        # The tolerance allows for the rounding of a multisine's frequencies.
        if wanted.size and (wanted.min() < low * (1.0 - 1e-9) or wanted.max() > high * (1.0 + 1e-9)):
            raise ConfigError(
                f"frequencies from {wanted.min():.4g} to {wanted.max():.4g} rad/s are outside of the measured range, "
                f"{low:.4g} to {high:.4g} rad/s"
            )
        # Interpolate log magnitude and unwrapped phase over log frequency, where responses are nearly straight; PCHIP
        # does not overshoot.
        log_frequency = np.log(np.clip(wanted, low, high))
        size = scipy.interpolate.PchipInterpolator(np.log(self.frequencies), np.log(np.abs(self.values)))(log_frequency)
        phase = scipy.interpolate.PchipInterpolator(np.log(self.frequencies), np.unwrap(np.angle(self.values)))(
            log_frequency
        )
        return np.asarray(np.exp(size + 1j * phase), dtype=complex)


def measure_frequency_response(
    loop: Measurements,
    *,
    period: float,
    frequencies: Sequence[float] | Floats,
    amplitude: float,
    cycles: int = 4,
    settle: int = 2,
) -> tuple[FrequencyResponse, ...]:
    """Excite a closed loop and estimate the frequency responses from the control to its measurements.

    Args:
        loop: adds an excitation [u] to the control for one period and returns the control and one or several
            measurements, see :mod:`mirdrake.tuning.process_models`.
        period: period of the loop [s].
        frequencies: requested frequencies [rad/s], below π/period; moved to the nearest multiple of the lowest.
        amplitude: root of the sum of the squared amplitudes of the multisine [u].
        cycles: number of cycles of the lowest frequency to average [1].
        settle: cycles before them [1].

    Returns:
        G of the plant for each measurement, without the hold of the control over a period.

    Raises:
        ConfigError: a setting is out of range.
        RunError: numbers that are not finite, or a control without a trace of the excitation.
    """
    check_number("frequency response", "period", period, unit="s", above=0.0)
    check_number("frequency response", "amplitude", amplitude, above=0.0)
    if cycles < 1 or settle < 0:
        raise ConfigError(f"frequency response: cycles >= 1 and settle >= 0 are needed, got {cycles} and {settle}")
    wanted = np.unique(np.asarray(frequencies, dtype=float))
    if len(wanted) < 2 or not wanted[0] > 0.0 or not wanted[-1] < np.pi / period:
        raise ConfigError(
            f"frequency response: two frequencies or more between 0 and {np.pi / period:.4g} rad/s are needed"
        )

    # Every line is a whole multiple of the lowest one, so that a period of the multisine has no leakage.
    samples = round(2.0 * np.pi / (wanted[0] * period))
    base = 2.0 * np.pi / (samples * period)
    lines = np.unique(np.round(wanted / base)).astype(int)
    # Lines at or above the Nyquist frequency cannot be sampled.
    lines = lines[2 * lines < samples]
    measured, values, deviations = _measure(loop, period, samples, lines, amplitude, cycles, settle)
    return tuple(FrequencyResponse(measured, *rows) for rows in zip(values, deviations, strict=True))


def _measure(
    loop: Measurements,
    period: float,
    samples: int,
    lines: NDArray[np.int64],
    amplitude: float,
    cycles: int,
    settle: int,
) -> tuple[Floats, Complexes, Floats]:
    """Return frequencies, and rows of G and its deviation for each measurement.

    The frequencies are the multiples `lines` of the one with a cycle of `samples` periods.
    """
    base = 2.0 * np.pi / (samples * period)
    angle = np.arange(samples) * period * base
    count = len(lines)

    # Schroeder phases: the sum of the sines has a low crest factor, so that the amplitude is used well.
    phases = -np.pi * np.arange(count) * np.arange(1, count + 1) / count
    sines = np.cos(np.outer(lines, angle) + phases[:, None])
    excitation = amplitude / np.sqrt(count) * sines.sum(axis=0)
    # The first periods are the transient and are dropped.
    rows = np.array([loop(float(e)) for _ in range(settle + cycles) for e in excitation])[settle * samples :]
    if not np.isfinite(rows).all():
        raise RunError("frequency response: the loop diverges; use a smaller amplitude, or gains that stabilise it")
    shaped = rows.reshape(cycles, samples, -1)
    frequencies: Floats = lines.astype(float) * base

    # One spectrum per cycle of control and measurement: their scatter gives the deviation.
    spectra = np.array(
        [[[fourier_line(column, period, w) for w in frequencies] for column in cycle.T] for cycle in shaped]
    )
    control, *measurements = spectra.mean(axis=0)
    # Division by nearly nothing would give noise as a plant.
    if not (np.abs(control) > 1e-9 * amplitude / np.sqrt(count)).all():
        raise RunError("frequency response: the excitation is not visible in the control; is the control saturated?")

    # G = Y / U of the averaged spectra; the loop is closed, so averaging the ratios would be biased.
    plants = np.array(measurements) / control
    # Part of the measurement that the plant does not explain; its standard error decreases with the cycles.
    spread = spectra[:, 1:] - plants * spectra[:, :1]
    deviation = np.sqrt((np.abs(spread) ** 2).sum(axis=0) / max(cycles * (cycles - 1), 1)) / np.abs(control)
    # The experiment sees the plant behind the zero-order hold; the hold is removed to get the plant alone.
    hold = hold_response(frequencies, period)
    return frequencies, plants / hold, deviation / np.abs(hold)
