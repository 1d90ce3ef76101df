"""Parameters of a model, what a study sets for them, and the parameters of the resulting fit."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Literal

from mirdrake.core.errors import ConfigError, did_you_mean


@dataclass(frozen=True)
class Parameter:
    """Parameter of a model.

    Attributes:
        name: key in studies and results.
        unit: SI unit.
        meaning: description.
        guess: initial value of a fit, or the value if the parameter is not free.
        low: lower bound of an estimate.
        high: upper bound of an estimate.
        free: whether it is estimated by default; the study may override this.
        scale: size of a large change; 0 for a positive parameter, whose logarithm is estimated.
        source: source of the guess, if it is more than a guess.
        usual: usual distance from the guess, as standard deviation of the logarithm or of value over scale: a weak
            prior that keeps a fit in range where a log carries no information; 0 for none.
        unlikely: value that is two usual distances below the guess at most, for a prior with unequal halves (split
            normal distribution: K. F. Wallis, Statistical Science 29, 2014); None for a symmetric one.
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
    unlikely: float | None = None

    def usual_at(self, scaled: float) -> float:
        """Return the usual distance on the side of a scaled value."""
        if scaled >= 0.0 or self.unlikely is None or self.unlikely >= self.guess:
            return self.usual
        return min(self.usual, 0.5 * (self.guess - self.unlikely) / self.scale)

    @property
    def is_positive(self) -> bool:
        """Whether the parameter is positive, so that its logarithm is estimated."""
        return self.scale == 0.0


@dataclass(frozen=True)
class Setting:
    """Setting of a parameter by a study; every field may be left out.

    Attributes:
        fixed: value of a parameter that is not estimated.
        guess: initial value of the fit.
        low: lower bound.
        high: upper bound.
        prior: mean and standard deviation of the prior knowledge.
        free: True to estimate a parameter that the model would fix, False to keep the guess.
        given: value of the vehicle file or data sheet, to compare with.
        source: source of these values.
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

    @property
    def value(self) -> float | None:
        """The value known before a fit, if there is one."""
        numbers = (self.fixed, self.guess, self.given, self.prior[0] if self.prior else None)
        return next((number for number in numbers if number is not None), None)


@dataclass(frozen=True)
class FitParameter:
    """Parameter of a fit.

    Attributes:
        info: parameter of the model, with the guess and bounds of the study.
        kind: "fixed", "free" or "prior".
        prior: mean and standard deviation.
        given: value to compare with.
        source: source of the fixed value, the prior or the given value.
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
        """Whether it is fixed to a default value."""
        return self.kind == "fixed" and self.source.startswith(("assumed", "half of"))

    @property
    def logarithmic(self) -> bool:
        """Whether the logarithm is estimated."""
        return self.info.is_positive

    def to_scaled(self, value: float) -> float:
        """Return the scaled value, which is of the order of one and zero at the guess."""
        info = self.info
        if self.logarithmic:
            return math.log(value / info.guess) if value > 0.0 else -math.inf
        return (value - info.guess) / info.scale

    def to_value(self, scaled: float) -> float:
        """Inverse of :meth:`to_scaled`."""
        info = self.info
        return info.guess * math.exp(scaled) if self.logarithmic else info.guess + info.scale * scaled

    def slope(self, value: float) -> float:
        """Return the derivative of the value by the scaled value [unit]."""
        return value if self.logarithmic else self.info.scale


def known_values(settings: Mapping[str, Setting]) -> dict[str, float]:
    """Return the parameter values known before a fit, by name."""
    return {name: setting.value for name, setting in settings.items() if setting.value is not None}


def resolve_parameters(known: Sequence[Parameter], settings: Mapping[str, Setting]) -> tuple[FitParameter, ...]:
    """Return the parameters of a fit, in the order of the model.

    Args:
        known: parameters of the model.
        settings: settings by name; the others are as in the model.

    Raises:
        ConfigError: unknown parameter, or a setting contradicts itself or the model; all faults together.
    """
    names = [info.name for info in known]
    faults = [
        ConfigError(f"unknown; {did_you_mean(name, names)}", path=("parameters", name))
        for name in settings
        if name not in names
    ]
    resolved = []
    for info in known:
        # Faults are collected, so that one attempt reports all of them.
        setting = settings.get(info.name, Setting())
        problem = _problem(info, setting)
        if problem:
            faults.append(ConfigError(problem, path=("parameters", info.name)))
        else:
            resolved.append(_resolve(info, setting))
    if faults:
        raise ConfigError(faults=faults)
    return tuple(resolved)


def _problem(info: Parameter, setting: Setting) -> str:
    """Return what is wrong with a setting; empty if nothing is."""
    unit, positive = info.unit, info.is_positive
    for item in fields(setting):
        value = getattr(setting, item.name)
        for number in value if isinstance(value, tuple) else (value,):
            if isinstance(number, float) and not math.isfinite(number):
                return f"{item.name} must be a finite number, got {number}"
    if setting.sigma is not None and setting.sigma <= 0.0:
        return f"sigma must be positive, got {setting.sigma:g} {unit}"
    if setting.fixed is not None:
        # Zero may be meant for a fixed value, but a positive parameter is estimated as a logarithm.
        others = [name for name in ("guess", "low", "high", "prior", "free") if getattr(setting, name) is not None]
        if others:
            return f"is fixed, and has {', '.join(others)} as well; leave out one or the other"
        return f"must be positive, got {setting.fixed:g} {unit}" if positive and setting.fixed <= 0.0 else ""
    low, high = _bounds(info, setting)
    if low >= high:
        return f"low {low:g} {unit} is not below high {high:g} {unit}; give low < high"
    if positive and high <= 0.0:
        return f"must be positive, but high is {high:g} {unit}"
    return _problem_of_guess(info, setting)


def _problem_of_guess(info: Parameter, setting: Setting) -> str:
    """Return what is wrong with guess and prior of a parameter that is not fixed."""
    unit, (low, high) = info.unit, _bounds(info, setting)
    if setting.prior is not None:
        mean, sigma = setting.prior
        if sigma <= 0.0:
            return f"prior sigma must be positive, got {sigma:g} {unit}"
        if not low <= mean <= high:
            return f"prior mean {mean:g} {unit} lies outside of {low:g} to {high:g}"
    if setting.guess is not None and not low <= setting.guess <= high:
        return f"guess {setting.guess:g} {unit} lies outside of {low:g} to {high:g} {unit}"
    guess = _guess(info, setting)
    # Positive parameters are estimated as logarithms.
    if info.is_positive and guess <= 0.0:
        return f"must be positive, got a guess of {guess:g} {unit}"
    if setting.sigma is not None and _is_free(info, setting):
        return "sigma is that of a fixed value, and this one is estimated; give a prior"
    return ""


def _resolve(info: Parameter, setting: Setting) -> FitParameter:
    """Return the parameter of a fit for a setting without faults."""
    given = setting.given
    if setting.fixed is not None:
        source = setting.source or "fixed in the study"
        return FitParameter(replace(info, guess=setting.fixed), "fixed", None, given, source, setting.sigma)
    low, high = _bounds(info, setting)
    changed = replace(info, guess=_guess(info, setting), low=low, high=high)
    if not _is_free(info, setting):
        source = setting.source or info.source or ("given" if given is not None else "assumed")
        return FitParameter(changed, "fixed", None, given, source, setting.sigma)
    kind: Literal["free", "prior"] = "free" if setting.prior is None else "prior"
    return FitParameter(changed, kind, setting.prior, given, setting.source or info.source)


def _bounds(info: Parameter, setting: Setting) -> tuple[float, float]:
    low = info.low if setting.low is None else setting.low
    high = info.high if setting.high is None else setting.high
    # A logarithm needs a positive lower bound.
    return (max(low, 1e-12 * high) if info.is_positive and low < high else low), high


def _guess(info: Parameter, setting: Setting) -> float:
    """Return the guess of the study, or the prior mean, given value or model's guess, moved within the bounds."""
    if setting.guess is not None:
        return setting.guess
    guess = setting.prior[0] if setting.prior is not None else info.guess if setting.given is None else setting.given
    low, high = _bounds(info, setting)
    if low <= guess <= high:
        return guess
    if not math.isfinite(low) or not math.isfinite(high):
        return min(max(guess, low), high)
    # Middle of the scaled range: the geometric mean for a logarithm, unless the lower bound is only the technical one.
    return math.sqrt(low * high) if info.is_positive and low > 1e-9 * high else 0.5 * (low + high)


def _is_free(info: Parameter, setting: Setting) -> bool:
    """Whether a parameter is estimated: bounds, a guess or a prior ask for it."""
    is_set = any(value is not None for value in (setting.low, setting.high, setting.guess, setting.prior))
    return setting.free if setting.free is not None else info.free or is_set
