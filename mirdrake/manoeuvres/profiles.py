"""Steering over time, as pure functions: what an open-loop driver does with the wheel.

Angles are those of the bicycle wheel [rad], positive to the left; all are zero before ``start``.
"""

import math
import random
from collections.abc import Callable, Mapping
from typing import Any

from mirdrake.core.errors import ConfigError, did_you_mean

Profile = Callable[[float], float]

EASE = 0.5
"""Time in which random steering rises, and dies away [s]."""


def step(*, amplitude: float, start: float = 0.0, rise: float = 0.0) -> Profile:
    """A step, reached along a straight line in `rise` [s]."""
    return lambda t: amplitude * min(max((t - start) / rise if rise > 0.0 else float(t >= start), 0.0), 1.0)


def ramp(*, rate: float, limit: float, start: float = 0.0) -> Profile:
    """A steady `rate` [rad/s] up to an angle [rad], which is then held; both have the sign of the turn."""

    def angle(t: float) -> float:
        return math.copysign(min(abs(rate) * max(t - start, 0.0), abs(limit)), rate)

    return angle


def sine(*, amplitude: float, frequency: float, start: float = 0.0, periods: float = 1.0) -> Profile:
    """Some periods of a sine [Hz]."""

    def angle(t: float) -> float:
        since = t - start
        return amplitude * math.sin(2.0 * math.pi * frequency * since) if 0.0 <= since < periods / frequency else 0.0

    return angle


def sine_with_dwell(*, amplitude: float, frequency: float, dwell: float, start: float = 0.0) -> Profile:
    """One period of a sine that dwells at its second peak."""
    peak, period = 0.75 / frequency, 1.0 / frequency

    def angle(t: float) -> float:
        since = t - start
        if since < 0.0 or since >= period + dwell:
            return 0.0
        phase = since if since < peak else max(peak, since - dwell)
        return amplitude * math.sin(2.0 * math.pi * frequency * phase)

    return angle


def sweep(*, amplitude: float, first: float, last: float, length: float, start: float = 0.0) -> Profile:
    """A sine whose frequency rises steadily from `first` to `last` [Hz] within `length` [s]."""

    def angle(t: float) -> float:
        since = t - start
        if not 0.0 <= since < length:
            return 0.0
        return amplitude * math.sin(2.0 * math.pi * (first + 0.5 * (last - first) * since / length) * since)

    return angle


def random_steer(
    *, amplitude: float, first: float, last: float, length: float, start: float = 0.0, seed: int = 0, lines: int = 60
) -> Profile:
    """Sines from `first` to `last` [Hz] with phases by chance, whose common effective value is amplitude / √2.

    It rises from zero and goes back to it within :data:`EASE`, for no steering can jump.
    """
    chance = random.Random(seed)
    waves = [
        (2.0 * math.pi * (first + (last - first) * (number + chance.random()) / lines), chance.uniform(0.0, math.tau))
        for number in range(lines)
    ]
    height = amplitude / math.sqrt(lines)

    def angle(t: float) -> float:
        since = t - start
        if not 0.0 <= since < length:
            return 0.0
        share = min(1.0, since / EASE, (length - since) / EASE)
        return height * share * math.fsum(math.sin(rate * since + phase) for rate, phase in waves)

    return angle


PROFILES: dict[str, Callable[..., Profile]] = {
    "step": step,
    "ramp": ramp,
    "sine": sine,
    "sine_with_dwell": sine_with_dwell,
    "sweep": sweep,
    "random": random_steer,
}


def make_profile(data: Mapping[str, Any]) -> Profile:
    """A profile from ``{kind: step, amplitude: 0.02, ...}``.

    Raises:
        ConfigError: no such kind, or it does not take these numbers.
    """
    settings = dict(data)
    kind = settings.pop("kind", None)
    if kind not in PROFILES:
        raise ConfigError(f"profile: unknown kind {kind!r}; {did_you_mean(str(kind), PROFILES)}")
    try:
        return PROFILES[kind](**settings)
    except TypeError as error:
        raise ConfigError(f"profile {kind}: {str(error).split(') ', 1)[-1]}") from None
