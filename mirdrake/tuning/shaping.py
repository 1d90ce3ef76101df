"""Robust loop shaping on a frequency response: largest integral gain under a bound on Ms, or a phase margin.

A bound on Ms keeps the Nyquist curve outside of a circle with centre -1 and radius r = 1/Ms. With kp and kd fixed, ``|1
+ L(jω)|² >= r²`` is a quadratic inequality in ki at every ω, so that the largest ki is a minimum over ω; kp and kd are
then searched. The integral of the error after a step of the load is 1/ki. Sources: K. J. Åström, H. Panagopoulos and T.
Hägglund, Design of PI controllers based on non-convex optimization, Automatica 34 (1998) 585 (MIGO); H. Panagopoulos,
K. J. Åström and T. Hägglund, Design of PID controllers based on constrained optimisation, IEE Proc. 149 (2002) 32.

For PID the unconstrained optimum has badly damped zeros. The condition ki kd <= ratio kp² prevents that: the ratio 1/4
gives real zeros of the controller (Ti >= 4 Td). The papers use conditions on the curvature instead, so that their PID
gains differ. The plant must have a positive gain and no pole in the right half plane.
"""

import math
from dataclasses import dataclass

import numpy as np
import scipy  # its parts are imported when they are first used

from mirdrake.core.checks import check_number
from mirdrake.core.errors import ConfigError
from mirdrake.core.pid import PidGains
from mirdrake.tuning.gains import FILTER_RATIO
from mirdrake.tuning.margins import frequency_grid, loop_range, rational_model
from mirdrake.tuning.models import Complexes, Floats, Plant
from mirdrake.tuning.stability import is_stable


@dataclass(frozen=True, slots=True)
class _Bounds:
    """The plant on a grid, and the circle around -1 that the loop must not enter.

    Attributes:
        frequencies: ω [rad/s], shape (n,).
        plant: G(jω) [y/u], shape (n,).
        radius: of the circle, 1/Ms.
    """

    frequencies: Floats
    plant: Complexes
    radius: float

    def largest(self, base: Complexes, direction: Complexes) -> Floats:
        """Return the largest x >= 0 for which base + t direction is outside of the circle for all t in [0, x], all ω.

        Args:
            base: shape (..., n); if it is inside of the circle, x is -inf.
            direction: shape (n,) or (..., n).
        """
        # |base + 1 + x direction|² = radius² is a quadratic in x with half coefficient Re(base + 1, direction).
        from_centre = base + 1.0
        outside = np.abs(from_centre) ** 2 - self.radius**2
        half = (from_centre * direction.conj()).real
        root = half**2 - np.abs(direction) ** 2 * outside
        # The ray meets the circle only if it points towards it and the discriminant is positive.
        meets = (half < 0.0) & (root > 0.0)
        # First root as c / (-b + sqrt(b² - a c)): without cancellation and without division by |direction|².
        below = np.where(meets, np.sqrt(np.maximum(root, 0.0)) - half, 1.0)
        first = np.where(meets, outside / below, math.inf)
        return np.asarray(np.where(outside < -1e-9, -math.inf, first).min(axis=-1))


def maximize_integral_gain(
    plant: Plant,
    *,
    max_sensitivity: float = 1.4,
    derivative: bool = False,
    zero_ratio: float = 0.25,
    filter_ratio: float = FILTER_RATIO,
    frequencies: tuple[float, float] | None = None,
) -> PidGains:
    """Return the PI or PID controller with the largest integral gain that keeps Ms below a bound.

    Args:
        plant: model or measured frequency response, with a positive gain and no pole in the right half plane.
        max_sensitivity: bound on Ms [1], above 1; 1.2 to 2 is usual.
        derivative: PID instead of PI.
        zero_ratio: bound on ki kd / kp² [1].
        filter_ratio: Td / Tf [1] of the derivative filter.
        frequencies: lowest and highest frequency [rad/s]; by default from the plant.

    Raises:
        ConfigError: a bound out of range, an unstable plant, or no controller of this form meets the bounds.
    """
    # |S| <= Ms means that L stays outside of a circle about -1 with the radius 1 / Ms.
    radius = 1.0 / check_number("loop shaping", "max_sensitivity", max_sensitivity, above=1.0)
    _reject_unstable(plant)
    low, high = loop_range(plant) if frequencies is None else frequencies
    w, _ = frequency_grid(plant.response, low, high)
    # frequency_grid refines for L = G only; the search needs a dense grid for all gains.
    w = np.union1d(w, np.geomspace(low, high, max(round(200.0 * math.log10(high / low)), 200)))
    value = plant.response(w)
    bounds = _Bounds(w, value, radius)
    if not derivative:
        kp, ki = _best_pi(bounds, np.zeros_like(value))
        return _checked(plant, PidGains(kp, _found(ki, "PI")))

    # The filter depends on the derivative time: iterate.
    filter_time, gains = 0.0, (0.0, 0.0, 0.0)
    for _ in range(6):
        gains = _best_pid(bounds, filter_time, zero_ratio)
        # Tf = Td / filter_ratio with Td = kd / kp; the floor avoids 0/0 for a controller without proportional part.
        new = (
            gains[2]
            / max(gains[0], 1e-300)
            / check_number("PID", "filter_ratio", filter_ratio, above=0.0, infinite=True)
        )
        if abs(new - filter_time) <= 1e-3 * new:
            break
        filter_time = new
    kp, ki, kd = gains
    return _checked(plant, PidGains(kp, _found(ki, "PID"), kd, filter_time=filter_time))


def design_for_phase_margin(
    plant: Plant,
    crossover: float,
    *,
    phase_margin: float = math.pi / 3.0,
    derivative: bool = False,
    filter_ratio: float = FILTER_RATIO,
) -> PidGains:
    """Return the PI or PID controller with a given crossover and phase margin: L(j crossover) = -exp(j phase_margin).

    For PID Ti = 4 Td. Source: Åström and Hägglund, Advanced PID Control (2006), section 6.3 (moving a point).

    Args:
        plant: model or measured frequency response.
        crossover: gain crossover, the bandwidth [rad/s].
        phase_margin: [rad].
        derivative: PID instead of PI.
        filter_ratio: Td / Tf [1] of the derivative filter.

    Raises:
        ConfigError: the controller cannot provide the required phase.
    """
    check_number("design", "crossover", crossover, unit="rad/s", above=0.0)
    check_number("design", "phase_margin", phase_margin, unit="rad", above=0.0, at_most=0.5 * math.pi)
    check_number("design", "filter_ratio", filter_ratio, above=0.0, infinite=True)

    # C(jω) must have the angle `needed` and the magnitude 1 / |G| at the crossover.
    value = complex(plant.response(np.array([crossover]))[0])
    needed = float(np.angle(-np.exp(1j * phase_margin) / value))
    size = 1.0 / abs(value)

    def shape(x: float) -> complex:
        """Return C / kp with Td ω = x and Ti = 4 Td."""
        return 1.0 - 0.25j / x + 1j * x / (1.0 + 1j * x / filter_ratio)

    # PI: phase between -90° (integrator) and 0° (proportional): kp = |C| cos φ, ki = -ω |C| sin φ.
    if not derivative:
        if not -0.5 * math.pi < needed < 0.0:
            raise _out_of_reach(needed, "PI", -0.5 * math.pi, 0.0)
        return PidGains(size * math.cos(needed), -crossover * size * math.sin(needed))

    # The phase rises with Td ω up to a maximum, beyond which the filter reduces it: search below that.
    trial = np.geomspace(1e-4, 1e3, 2000)
    angles = np.array([np.angle(shape(x)) for x in trial])
    top = int(np.argmax(angles))
    if not angles[0] < needed < angles[top]:
        raise _out_of_reach(needed, "PID", float(angles[0]), float(angles[top]))
    x = scipy.optimize.brentq(lambda x: float(np.angle(shape(x))) - needed, trial[0], trial[top])
    kp, derivative_time = size / abs(shape(x)), x / crossover
    return PidGains(kp, kp / (4.0 * derivative_time), kp * derivative_time, filter_time=derivative_time / filter_ratio)


def _best_pi(bounds: _Bounds, base: Complexes, least: float = 0.0) -> tuple[float, float]:
    """Return kp and ki with the largest ki in addition to a loop `base`, with kp of at least `least`."""
    if abs(np.angle(-bounds.plant[0])) < 0.25 * math.pi and not base.any():
        return 0.0, -math.inf  # two integrators, or a negative gain: no PI controller is stable
    top = float(bounds.largest(base, bounds.plant))
    # An unbounded kp: no constraint is active, which the caller reports.
    if top == math.inf:
        return 0.0, math.inf
    if not 0.0 < top < math.inf or top <= least:
        return 0.0, -math.inf
    # L = (kp + ki / s) G: ki moves the loop along G / s.
    integral = bounds.plant / (1j * bounds.frequencies)

    def largest(kp: Floats) -> Floats:
        return bounds.largest(base + np.multiply.outer(kp, bounds.plant), integral)

    # A grid first, as there may be several maxima, then a refinement around the best point.
    trial = np.linspace(least, top * (1.0 - 1e-9), 41)
    values = largest(trial)
    k = int(np.argmax(values))
    a, b = trial[max(k - 1, 0)], trial[min(k + 1, len(trial) - 1)]
    optimum = scipy.optimize.minimize_scalar(lambda kp: -float(largest(np.array(kp))), bounds=(a, b), method="bounded")
    return max((float(trial[k]), float(values[k])), (float(optimum.x), -float(optimum.fun)), key=lambda pair: pair[1])


def _best_pid(bounds: _Bounds, filter_time: float, zero_ratio: float) -> tuple[float, float, float]:
    """Return kp, ki and kd with the largest ki under ki kd <= zero_ratio kp²."""
    # L = (kp + ki / s + kd s / (1 + Tf s)) G: three directions, searched one inside the other.
    check_number("PID", "zero_ratio", zero_ratio, above=0.0, infinite=True)
    s = 1j * bounds.frequencies
    slope = bounds.plant * s / (1.0 + filter_time * s)
    integral = bounds.plant / s
    kp0, ki0 = _best_pi(bounds, np.zeros_like(slope))
    top = float(bounds.largest(np.zeros_like(slope), slope))
    _found(top, "PID")

    def largest(kp: float, kd: float) -> float:
        """Return the largest ki for kp and kd; -inf if there is none."""
        if not 0.0 <= kd < top or kp < 0.0:
            return -math.inf
        base = kd * slope
        if not kp < float(bounds.largest(base, bounds.plant)):
            return -math.inf
        ki = float(bounds.largest(base + kp * bounds.plant, integral))
        # ki kd <= zero_ratio kp² keeps the zeros of the controller damped; 1/4 makes them real.
        return min(ki, zero_ratio * kp**2 / kd) if kd > 0.0 else ki

    # PI is the fallback: with kd = 0.
    best = (ki0, kp0, 0.0)
    # Logarithmic steps from nearly PI up to the bound of a pure derivative.
    for kd in top * np.geomspace(1e-4, 0.999, 25):
        kp_top = float(bounds.largest(kd * slope, bounds.plant))
        if not 0.0 < kp_top < math.inf:
            continue
        # The ends of the range are on the circle and have no ki left.
        trial = np.linspace(0.0, kp_top, 31)[1:-1]
        values = bounds.largest(kd * slope + np.multiply.outer(trial, bounds.plant), integral)
        values = np.minimum(values, zero_ratio * trial**2 / kd)
        k = int(np.argmax(values))
        best = max(best, (float(values[k]), float(trial[k]), float(kd)))
    if not best[0] > 0.0:
        return best[1], best[0], best[2]
    # Nelder-Mead on logarithms: the maximum is on the intersection of constraints, where gradients do not exist.
    if best[2] > 0.0:
        polished = scipy.optimize.minimize(
            lambda x: -max(largest(math.exp(x[0]), math.exp(x[1])), -1e300) / best[0],
            np.log([best[1], best[2]]),
            method="Nelder-Mead",
            options={
                "xatol": 1e-5,
                "fatol": 1e-7,
                "maxiter": 300,
                "initial_simplex": _simplex(np.log([best[1], best[2]])),
            },
        )
        kp, kd = np.exp(polished.x)
        # Only an improvement counts.
        best = max(best, (largest(float(kp), float(kd)), float(kp), float(kd)))
    return best[1], best[0], best[2]


def _simplex(start: Floats) -> Floats:
    return np.asarray(start + np.array([[0.0, 0.0], [0.05, 0.0], [0.0, 0.05]]), dtype=float)


def _reject_unstable(plant: Plant) -> None:
    model = rational_model(plant)
    if model is not None and any(pole.real > 1e-9 * max(abs(pole), 1e-300) for pole in model.poles if abs(pole) > 1e-9):
        raise ConfigError("loop shaping: the plant has a pole in the right half plane; stabilise it first")


def _checked(plant: Plant, gains: PidGains) -> PidGains:
    model = rational_model(plant)
    if model is not None and not is_stable(model, gains):
        raise ConfigError("loop shaping: no stable loop was found; use PID, or check the sign of the gain of the plant")
    return gains


def _found(ki: float, kind: str) -> float:
    if ki == math.inf:
        raise ConfigError("loop shaping: the gain is not bounded; add the lag or dead time of actuator and sensor")
    if not ki > 0.0:
        raise ConfigError(
            f"loop shaping: no {kind} controller with integral action meets the bounds; relax them, use PID, "
            "or check the sign of the gain of the plant"
        )
    return ki


def _out_of_reach(needed: float, kind: str, low: float, high: float) -> ConfigError:
    shown = f"{math.degrees(needed):.0f}°, {kind} provides {math.degrees(low):.0f}° to {math.degrees(high):.0f}°"
    return ConfigError(f"design: the required phase of the controller is {shown}; choose another crossover or margin")
