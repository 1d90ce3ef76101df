"""Relay feedback: ultimate gain and period of a loop from a limit cycle.

First, a relay with hysteresis replaces the controller (K. J. Åström and T. Hägglund, Automatica 20 (1984) 645). The
describing function of its limit cycle of amplitude a, with modulus N = 4 d / (π sqrt(a² - ε²)), gives the classic
estimate, whose error is up to a quarter if the cycle is not sinusoidal. In a second stage, a saturated gain slightly
above the ultimate gain replaces the relay (C.-C. Yu, Autotuning of PID Controllers, 2nd ed., chapter 3). Its cycle is
almost sinusoidal, and the first Fourier coefficients of control and measurement in both cycles are two exact points of
the frequency response. The ultimate point is where the phase, interpolated or extrapolated, is -180°.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import numpy as np

from mirdrake.core.checks import check_number
from mirdrake.core.errors import RunError
from mirdrake.tuning.fourier import fitted_line
from mirdrake.tuning.gains import hold_response
from mirdrake.tuning.models import Floats
from mirdrake.tuning.process_models import Process


@dataclass(frozen=True, slots=True)
class RelayResult:
    """Result of a relay experiment.

    Attributes:
        ultimate_gain: Ku [u/y].
        ultimate_period: Tu [s].
        describing_gain: estimate of Ku from the relay's describing function alone [u/y].
        relay_period: period of the relay's limit cycle [s].
        amplitude: half the peak-to-peak value of the measurement under the relay [y].
        points: (frequency [rad/s], frequency response [y/u]) of each limit cycle, the relay's first.
        duration: of the experiment [s].
    """

    ultimate_gain: float
    ultimate_period: float
    describing_gain: float
    relay_period: float
    amplitude: float
    points: tuple[tuple[float, complex], ...]
    duration: float


@dataclass(frozen=True, slots=True)
class _Cycle:
    frequency: float
    response: complex
    amplitude: float


def run_relay_test(
    process: Process,
    *,
    period: float,
    amplitude: float,
    hysteresis: float = 0.0,
    reference: float = 0.0,
    measurement: float = 0.0,
    control: float = 0.0,
    duration: float,
    tolerance: float = 0.01,
    refine: bool = True,
) -> RelayResult:
    """Find the ultimate point of a loop by relay feedback.

    Args:
        process: the process, see :mod:`mirdrake.tuning.process_models`; its gain is positive.
        period: its period [s]; a hundredth of the limit cycle is sufficient.
        amplitude: output of the relay d, with both signs [u].
        hysteresis: ε [y]; larger than the noise of the measurement.
        reference: set-point [y].
        measurement: initial measurement [y].
        control: centre of the relay [u], the control that holds `reference` at rest.
        duration: longest time for either stage [s].
        tolerance: largest relative change of period and amplitude of a settled cycle [1].
        refine: whether the second stage is made.

    Raises:
        ConfigError: a setting is out of range.
        RunError: no limit cycle, or it does not settle.
    """
    # Ten periods at least: a cycle with fewer samples has no amplitude.
    check_number("relay test", "period", period, unit="s", above=0.0)
    check_number("relay test", "amplitude", amplitude, above=0.0)
    check_number("relay test", "hysteresis", hysteresis, at_least=0.0)
    check_number("relay test", "duration", duration, unit="s", above=10.0 * period)
    runner = _Runner(
        process,
        period=period,
        amplitude=amplitude,
        hysteresis=hysteresis,
        reference=reference,
        control=control,
        measurement=measurement,
        tolerance=tolerance,
    )
    level = amplitude

    # Relay with hysteresis: it keeps its level while the error is within ±ε.
    def relay(error: float) -> float:
        nonlocal level
        up = error > hysteresis or (error > -hysteresis and level > 0.0)
        level = amplitude if up else -amplitude
        return level

    first = runner.cycle(relay, duration)
    cycles = [first]

    # Describing function of the relay with hysteresis: N(A) = 4 d / (π sqrt(A² - ε²)), Ku = N (Åström and Hägglund).
    below = math.sqrt(max(first.amplitude**2 - hysteresis**2, 1e-24))
    describing = 4.0 * amplitude / (math.pi * below)
    # A saturation cycles nearer to the ultimate point than the relay, whose harmonics bias it.
    if refine:
        cycles.append(_saturated(runner, first, amplitude, duration))
    gain, frequency = _ultimate([(cycle.frequency, cycle.response) for cycle in cycles])
    return RelayResult(
        gain,
        2.0 * math.pi / frequency,
        describing,
        2.0 * math.pi / first.frequency,
        first.amplitude,
        tuple((cycle.frequency, cycle.response) for cycle in cycles),
        runner.steps * period,
    )


class _DecayError(RunError):
    """The oscillation decays: the gain is below the ultimate gain."""


def _saturated(runner: "_Runner", first: "_Cycle", amplitude: float, duration: float) -> "_Cycle":
    """Return the limit cycle of the smallest saturated gain that has one."""
    # A little above the ultimate gain of the relay; raised until the oscillation does not decay.
    slope = 1.3 / abs(first.response)
    # Two periods of the relay's limit cycle.
    patience = 4.0 * math.pi / first.frequency
    for _ in range(8):
        try:
            return runner.cycle(partial(_clipped, slope, amplitude), duration, patience)
        except _DecayError:
            slope *= 1.4
    raise RunError("relay test: no gain gives a sustained oscillation; reduce the hysteresis")


def _clipped(slope: float, amplitude: float, error: float) -> float:
    return min(max(slope * error, -amplitude), amplitude)


@dataclass(slots=True)
class _Runner:
    """Runs a process under static feedback until it cycles; attributes as the arguments of ``run_relay_test``."""

    process: Process
    period: float
    amplitude: float
    hysteresis: float
    reference: float
    control: float
    measurement: float
    tolerance: float
    steps: int = 0

    def cycle(self, feedback: Callable[[float], float], duration: float, patience: float = math.inf) -> _Cycle:
        """Run until three cycles agree and return the cycle.

        Args:
            feedback: control [u] for an error [y].
            duration: longest time [s].
            patience: longest time without a control at the limits of the relay [s].

        Raises:
            _DecayError: the oscillation decays.
            RunError: no steady cycle within the duration.
        """
        errors: list[float] = []
        controls: list[float] = []
        ups: list[float] = []  # in samples, where the error rises through the hysteresis
        armed, reached = False, 0
        for k in range(round(duration / self.period)):
            error = self.reference - self.measurement
            # Also true for NaN.
            if not abs(error) < 1e12:
                raise RunError("relay test: the measurement grows without bound; a relay cannot stabilise this loop")
            errors.append(error)
            controls.append(feedback(error))
            self.measurement = self.process(self.control + controls[-1])
            self.steps += 1
            # A decaying oscillation no longer reaches the limits of the saturation.
            if abs(controls[-1]) >= self.amplitude:
                reached = k
            elif (k - reached) * self.period > patience:
                raise _DecayError("relay test: the oscillation decays")
            # Armed below -ε: noise that crosses +ε twice is one switch. Interpolated to a fraction of a sample.
            if armed and error > self.hysteresis:
                armed = False
                ups.append(k - (error - self.hysteresis) / (error - errors[-2]))
                settled = self._settled(np.array(errors), np.array(controls), ups)
                if settled is not None:
                    return settled
            armed = armed or error < -self.hysteresis
        if len(ups) < 3:
            raise RunError(
                "relay test: no limit cycle; increase the amplitude or the duration, reduce the hysteresis, and set "
                "control to the value that holds the reference"
            )
        raise RunError("relay test: the limit cycle has not settled; increase the duration or the tolerance")

    def _settled(self, errors: Floats, controls: Floats, ups: list[float]) -> _Cycle | None:
        """Return the cycle if the last three agree in period and amplitude, else None."""
        # The first cycles are a transient: five rises leave three full cycles after it.
        if len(ups) < 5:
            return None
        marks = [round(mark) for mark in ups[-4:]]
        spans = np.diff(ups[-4:])
        swings = np.array([np.ptp(errors[a:b]) for a, b in pairwise(marks)])
        # A sampled relay cannot agree better than to a period.
        slack = self.tolerance + 1.0 / float(spans.mean())
        if np.ptp(spans) > slack * spans.mean() or np.ptp(swings) > self.tolerance * swings.mean():
            return None
        frequency = 2.0 * math.pi / (float(spans.mean()) * self.period)
        window = slice(marks[0], marks[-1])

        # G(jω) from the fundamentals of control and measurement; the hold makes it that of the continuous plant.
        control = fitted_line(controls[window], self.period, frequency) * complex(hold_response(frequency, self.period))
        # The error is reference minus measurement, hence the sign.
        response = -fitted_line(errors[window], self.period, frequency) / control
        return _Cycle(frequency, response, 0.5 * float(swings.mean()))


def _ultimate(points: list[tuple[float, complex]]) -> tuple[float, float]:
    """Return Ku and ωu, where the phase through one or two points of the frequency response is -180°."""
    frequency, response = points[-1]
    lag = float(np.angle(-response))  # phase above -180°
    # Too near to each other for a slope, or a single point: take that point for the ultimate one.
    if len(points) == 1 or abs(math.log(points[0][0] / frequency)) < 1e-3:
        return 1.0 / abs(response), frequency
    other, value = points[0]
    # Phase over frequency as a straight line, magnitude as a power of the frequency (slope in log-log).
    slope = (float(np.angle(-value)) - lag) / (other - frequency)
    steep = (math.log(abs(value)) - math.log(abs(response))) / math.log(other / frequency)
    # The phase must fall with the frequency, else the line is meaningless.
    if slope >= 0.0:
        return 1.0 / abs(response), frequency
    # No extrapolation further than 20 to 25 %.
    ultimate = min(max(frequency - lag / slope, 0.8 * frequency), 1.25 * frequency)
    return math.exp(-math.log(abs(response)) - steep * math.log(ultimate / frequency)), ultimate
