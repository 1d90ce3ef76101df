"""Parameters of a model that is to be fitted: what a model has, and what a study makes of them."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mirdrake.core.errors import ConfigError, did_you_mean

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Parameter:
    """A parameter that a model has.

    Attributes:
        name: in studies and results.
        unit: SI.
        meaning: what it is, in words.
        guess: where a fit starts, or the value if it is not free.
        low: no estimate may be below.
        high: no estimate may be above.
        free: whether it is estimated if nothing is said.
        scale: what counts as a large change of it; 0: its own size, and it is positive: its logarithm is estimated.
        source: where the guess is from, if it is more than a guess.
        usual: how far from the guess vehicles are, as standard deviation of the logarithm, or over the scale: a weak
            prior that keeps a fit in range where a log says nothing; 0: none.
    """

    name: str
    unit: str
    meaning: str
    guess: float
    low: float
    high: float
    free: bool = False
    scale: float = 0.0
    source: str = ""
    usual: float = 0.0


@dataclass(frozen=True)
class Setting:
    """What a study says of a parameter; everything may be left out.

    Attributes:
        fixed: value, not to be estimated.
        guess: where the fit starts.
        low: lower bound.
        high: upper bound.
        prior: mean and standard deviation of what is known of it.
        free: True: estimate it although the model would not; False: keep the guess.
        given: value of the vehicle file or data sheet, to be compared with.
        source: where these are from.
        sigma: standard deviation of a value that is not estimated.
    """

    fixed: float | None = None
    guess: float | None = None
    low: float | None = None
    high: float | None = None
    prior: tuple[float, float] | None = None
    free: bool | None = None
    given: float | None = None
    source: str = ""
    sigma: float | None = None


@dataclass(frozen=True)
class FitParameter:
    """A parameter of a study.

    Attributes:
        info: what the model has, with the study's guess and bounds.
        kind: "fixed", "free" or "prior".
        prior: mean and standard deviation.
        given: to be compared with.
        source: of the fixed value, the prior or the given value.
        sigma: standard deviation of the fixed value.
    """

    info: Parameter
    kind: Literal["fixed", "free", "prior"]
    prior: tuple[float, float] | None = None
    given: float | None = None
    source: str = ""
    sigma: float | None = None

    @property
    def is_assumed(self) -> bool:
        """Whether it is fixed to a value that nobody gave."""
        return self.kind == "fixed" and self.source.startswith(("assumed", "half of"))

    @property
    def logarithmic(self) -> bool:
        """Whether the logarithm is what is estimated."""
        return self.info.scale == 0.0

    def to_scaled(self, value: float) -> float:
        """From the value to what is estimated: of the order of one, zero at the guess."""
        info = self.info
        if self.logarithmic:
            return math.log(value / info.guess) if value > 0.0 else -math.inf
        return (value - info.guess) / info.scale

    def to_value(self, scaled: float) -> float:
        """Back."""
        info = self.info
        return info.guess * math.exp(scaled) if self.logarithmic else info.guess + info.scale * scaled

    def slope(self, value: float) -> float:
        """Change of the value by what is estimated [unit]."""
        return value if self.logarithmic else self.info.scale


def resolve_parameters(known: Sequence[Parameter], settings: Mapping[str, Setting]) -> tuple[FitParameter, ...]:
    """Parameters of a study, in the order of the model.

    Args:
        known: parameters of the model.
        settings: by name; those left out are as the model has them.

    Raises:
        ConfigError: there is no such parameter, or the choice contradicts itself or the model; one line per fault.
    """
    names = [info.name for info in known]
    faults = [f"parameters.{name}: unknown; {did_you_mean(name, names)}" for name in settings if name not in names]
    found = []
    for info in known:
        try:
            found.append(_choose(info, settings.get(info.name, Setting())))
        except ConfigError as error:
            faults.append(str(error))
    if faults:
        raise ConfigError("\n".join(faults))
    return tuple(found)


def _choose(info: Parameter, choice: Setting) -> FitParameter:
    place = f"parameters.{info.name}"
    values = {"fixed": choice.fixed, "guess": choice.guess, "low": choice.low, "high": choice.high}
    values |= {"given": choice.given, "sigma": choice.sigma}
    values |= {} if choice.prior is None else {"prior mean": choice.prior[0], "prior sigma": choice.prior[1]}
    for name, value in values.items():
        if value is not None and not math.isfinite(value):
            raise ConfigError(f"{place}: {name} must be a finite number, got {value}")
    positive = info.scale == 0.0
    if choice.sigma is not None and choice.sigma <= 0.0:
        raise ConfigError(f"{place}: sigma must be positive, got {choice.sigma:g} {info.unit}")
    if choice.fixed is not None:
        if choice.guess is not None or choice.prior is not None or choice.free:
            raise ConfigError(f"{place}: is fixed, so it cannot have a guess, a prior or be free; leave out one")
        if positive and choice.fixed <= 0.0:
            raise ConfigError(f"{place}: must be positive, got {choice.fixed:g} {info.unit}")
        info = replace(info, guess=choice.fixed)
        return FitParameter(
            info, "fixed", given=choice.given, source=choice.source or "fixed in the study", sigma=choice.sigma
        )
    low = info.low if choice.low is None else choice.low
    high = info.high if choice.high is None else choice.high
    if low >= high:
        raise ConfigError(f"{place}: low {low:g} {info.unit} is not below high {high:g} {info.unit}; give low < high")
    if positive and high <= 0.0:
        raise ConfigError(f"{place}: must be positive, but high is {high:g} {info.unit}")
    if positive:
        low = max(low, 1e-12 * high)
    prior = choice.prior
    if prior is not None and prior[1] <= 0.0:
        raise ConfigError(f"{place}: prior sigma must be positive, got {prior[1]:g} {info.unit}")
    if prior is not None and not low <= prior[0] <= high:
        raise ConfigError(f"{place}: prior mean {prior[0]:g} {info.unit} lies outside of {low:g} to {high:g}")
    guess = choice.guess
    if guess is not None and not low <= guess <= high:
        raise ConfigError(f"{place}: guess {guess:g} {info.unit} lies outside of {low:g} to {high:g} {info.unit}")
    if guess is None:
        guess = prior[0] if prior is not None else choice.given if choice.given is not None else info.guess
        guess = _inside(guess, low, high, positive=positive)
    if positive and guess <= 0.0:
        raise ConfigError(f"{place}: must be positive, got a guess of {guess:g} {info.unit}")
    asked = choice.low is not None or choice.high is not None or choice.guess is not None
    free = choice.free if choice.free is not None else info.free or asked or prior is not None
    info = replace(info, guess=guess, low=low, high=high)
    if free and choice.sigma is not None:
        raise ConfigError(f"{place}: sigma is that of a fixed value, and this one is estimated; give a prior")
    if not free:
        source = choice.source or info.source or ("given" if choice.given is not None else "assumed")
        return FitParameter(info, "fixed", given=choice.given, source=source, sigma=choice.sigma)
    kind: Literal["free", "prior"] = "free" if prior is None else "prior"
    return FitParameter(info, kind, prior, choice.given, choice.source or info.source)


def _inside(guess: float, low: float, high: float, *, positive: bool) -> float:
    if low <= guess <= high:
        return guess
    if not math.isfinite(low) or not math.isfinite(high):
        return min(max(guess, low), high)
    return math.sqrt(low * high) if positive and low > 1e-9 * high else 0.5 * (low + high)
