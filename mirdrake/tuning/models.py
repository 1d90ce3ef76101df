"""Models of a plant: transfer functions with dead time, and the simple models of the tuning rules.

Every model has ``response(frequencies)``, its frequency response. Margins and loop shaping need nothing else, so that a
measured :class:`~mirdrake.tuning.frequency_response.FrequencyResponse` can be used as well. Units: [u] of the control,
[y] of the measurement, seconds, rad/s. The dead time is exact, not replaced by a Padé approximation.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mirdrake.core.checks import check_number
from mirdrake.core.errors import ConfigError

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]


class Plant(Protocol):
    """Model with a frequency response."""

    def response(self, frequencies: ArrayLike) -> Complexes:
        """Return the frequency response G(jω) [y/u] at `frequencies` [rad/s], of the same shape."""
        ...


@dataclass(frozen=True, slots=True)
class TransferFunction:
    """Transfer function ``numerator(s) / denominator(s) · exp(-delay s)``, proper, with one input and one output.

    Attributes:
        numerator: coefficients, highest power first; leading zeros are removed.
        denominator: coefficients, highest power first, made monic.
        delay: dead time [s].

    Raises:
        ConfigError: coefficients that are not finite, a zero polynomial, more zeros than poles, or a negative delay.
    """

    numerator: tuple[float, ...]
    denominator: tuple[float, ...]
    delay: float = 0.0

    def __post_init__(self) -> None:
        numerator = _polynomial("numerator", self.numerator)
        denominator = _polynomial("denominator", self.denominator)
        # An improper plant has no state-space form and cannot be simulated.
        if len(numerator) > len(denominator):
            raise ConfigError(
                f"TransferFunction: order {len(numerator) - 1} over order {len(denominator) - 1} is not proper; "
                "add a filter"
            )
        lead = denominator[0]
        # Monic denominators, so that leading coefficients can be compared; frozen dataclass, hence object.__setattr__.
        object.__setattr__(self, "numerator", tuple(c / lead for c in numerator))
        object.__setattr__(self, "denominator", tuple(c / lead for c in denominator))
        object.__setattr__(self, "delay", check_number("TransferFunction", "delay", self.delay, unit="s", at_least=0.0))

    def __mul__(self, other: "TransferFunction") -> "TransferFunction":
        return TransferFunction(
            tuple(np.polymul(self.numerator, other.numerator).tolist()),
            tuple(np.polymul(self.denominator, other.denominator).tolist()),
            self.delay + other.delay,
        )

    @property
    def poles(self) -> Complexes:
        """Roots of the denominator [1/s]."""
        return np.asarray(np.roots(self.denominator), dtype=complex)

    @property
    def zeros(self) -> Complexes:
        """Roots of the numerator [1/s]."""
        return np.asarray(np.roots(self.numerator), dtype=complex)

    @property
    def static_gain(self) -> float:
        """Gain at frequency zero [y/u]; infinite with integral action."""
        below = self.denominator[-1]
        return math.inf if below == 0.0 else self.numerator[-1] / below

    def response(self, frequencies: ArrayLike) -> Complexes:
        """Return the frequency response at `frequencies` [rad/s]; see :class:`Plant`."""
        s = 1j * np.asarray(frequencies, dtype=float)
        value = np.polyval(self.numerator, s) / np.polyval(self.denominator, s) * np.exp(-self.delay * s)
        return np.asarray(value, dtype=complex)

    @classmethod
    def from_control(cls, system: Any, *, delay: float = 0.0) -> "TransferFunction":
        """Return a continuous linear system of python-control (TransferFunction or StateSpace) as a transfer function.

        Args:
            system: one input, one output, continuous time.
            delay: dead time to add [s], which python-control does not support.

        Raises:
            ConfigError: not such a system.
            MissingDependencyError: python-control is not installed.
        """
        from mirdrake.tuning.control_library import polynomials_of

        return cls(*polynomials_of(system), delay=delay)

    def to_control(self) -> Any:
        """Return the rational part as a ``control.TransferFunction``.

        Raises:
            ConfigError: there is a dead time, which python-control does not support.
            MissingDependencyError: python-control is not installed.
        """
        from mirdrake.tuning.control_library import control_library

        if self.delay:
            raise ConfigError(
                f"python-control does not support dead time, the model has {self.delay:g} s; use a Padé approximation"
            )
        return control_library().tf(list(self.numerator), list(self.denominator))


@dataclass(frozen=True, slots=True)
class FirstOrder:
    """First order with dead time, ``gain exp(-delay s) / (1 + time_constant s)``.

    Attributes:
        gain: static gain [y/u], not zero.
        time_constant: T [s], positive.
        delay: dead time L [s].
    """

    gain: float
    time_constant: float
    delay: float

    def __post_init__(self) -> None:
        _check(self, gain=self.gain, delay=self.delay, lags=(self.time_constant,))

    def transfer_function(self) -> TransferFunction:
        """Return the model as a transfer function."""
        return TransferFunction((self.gain,), (self.time_constant, 1.0), self.delay)

    def response(self, frequencies: ArrayLike) -> Complexes:
        """Return the frequency response at `frequencies` [rad/s]; see :class:`Plant`."""
        return self.transfer_function().response(frequencies)


@dataclass(frozen=True, slots=True)
class Integrator:
    """Integrator with dead time, ``gain exp(-delay s) / s``.

    Attributes:
        gain: velocity gain [y/(u s)], not zero.
        delay: dead time [s].
    """

    gain: float
    delay: float

    def __post_init__(self) -> None:
        _check(self, gain=self.gain, delay=self.delay, lags=())

    def transfer_function(self) -> TransferFunction:
        """Return the model as a transfer function."""
        return TransferFunction((self.gain,), (1.0, 0.0), self.delay)

    def response(self, frequencies: ArrayLike) -> Complexes:
        """Return the frequency response at `frequencies` [rad/s]; see :class:`Plant`."""
        return self.transfer_function().response(frequencies)


def lags(*time_constants: float, gain: float = 1.0, delay: float = 0.0) -> TransferFunction:
    """Return ``gain exp(-delay s) / Π (1 + T s)``, a chain of lags.

    Args:
        time_constants: the T [s].
        gain: static gain [y/u].
        delay: dead time [s].
    """
    denominator = np.array([1.0])
    for time_constant in time_constants:
        denominator = np.polymul(denominator, [time_constant, 1.0])
    return TransferFunction((gain,), tuple(denominator.tolist()), delay)


def frequency_range(plant: TransferFunction) -> tuple[float, float]:
    """Return the range of frequencies [rad/s] from three decades below to three above the corners of a plant."""
    corners = [abs(root) for root in (*plant.poles, *plant.zeros) if abs(root) > 1e-12]
    if plant.delay:
        corners.append(1.0 / plant.delay)
    if not corners:
        corners = [max(abs(plant.numerator[0]), 1e-6) ** (1.0 / max(len(plant.denominator) - 1, 1))]
    return min(corners) * 1e-3, max(corners) * 1e3


def _check(model: object, *, gain: float, delay: float, lags: tuple[float, ...]) -> None:
    owner = type(model).__name__
    if check_number(owner, "gain", gain) == 0.0:
        raise ConfigError(f"{owner}: gain must not be zero")
    check_number(owner, "delay", delay, unit="s", at_least=0.0)
    for lag in lags:
        check_number(owner, "time constant", lag, unit="s", above=0.0)


def _polynomial(name: str, coefficients: Sequence[float]) -> tuple[float, ...]:
    numbers = [check_number("TransferFunction", name, c) for c in coefficients]
    while numbers and numbers[0] == 0.0:
        numbers.pop(0)
    if not numbers:
        raise ConfigError(f"TransferFunction: the {name} is zero; at least one coefficient must not be")
    return tuple(numbers)
