"""What the estimators ask of a model: states, rates, and what sensors would show, for many parameter sets at once."""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.signal import lfilter

from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.identification.parameters import Parameter

Array = NDArray[np.float64]
Values = Mapping[str, Any]
"""Parameters by name: floats, or arrays (columns, 1)."""


@dataclass(frozen=True)
class ModelSpec:
    """Which model is fitted.

    Attributes:
        kind: name in :data:`mirdrake.identification.models.registry.MODELS`.
        options: of this kind.
    """

    kind: str
    options: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Segment:
    """A stretch of a log on even steps.

    Attributes:
        log: name of the log.
        part: "train" or "validation".
        start: time of the first sample [s].
        step: from sample to sample [s].
        inputs: channels that drive the model, by name (n each), without gaps.
        outputs: channels that the model is compared with (n each), NaN where there is no value.
        before: inputs ahead of the first sample, of a piece that was cut out of a longer drive (m each); may be empty.
    """

    log: str
    part: str
    start: float
    step: float
    inputs: Mapping[str, Array]
    outputs: Mapping[str, Array]
    before: Mapping[str, Array] = field(default_factory=dict)

    @property
    def size(self) -> int:
        """Number of samples."""
        return len(next(iter((*self.inputs.values(), *self.outputs.values()))))

    @property
    def time(self) -> Array:
        """Of the samples (n) [s]."""
        return np.asarray(self.start + self.step * np.arange(self.size), dtype=np.float64)

    @property
    def names(self) -> frozenset[str]:
        """Its channels."""
        return frozenset((*self.inputs, *self.outputs))

    def channels(self, name: str) -> Array:
        """Samples of an input or output (n)."""
        return self.inputs[name] if name in self.inputs else self.outputs[name]

    def at(self, name: str, times: Array, delay: float = 0.0, *, smooth: bool = False) -> Array:
        """An input channel between its samples.

        Args:
            name: of the channel.
            times: from the first sample on (any) [s].
            delay: of the channel [s].
            smooth: cubic between the samples, see :func:`smooth_between`; else straight lines.
        """
        early = self.before.get(name, np.empty(0))
        known = np.concatenate((early, self.inputs[name]))
        if smooth:
            return smooth_between(known, (times - delay) / self.step + len(early))
        return np.interp(times - delay, self.step * (np.arange(len(known)) - len(early)), known)

    def with_history(self, times: Array) -> tuple[Array, int]:
        """Even times and those before them for which inputs are known, and how many these are.

        What has a lag is not at rest where a piece begins: its answer is worked out from further back.
        """
        known = max((len(values) for values in self.before.values()), default=0)
        step = float(times[1] - times[0])
        many = int(known * self.step / step + 1e-6)
        return np.concatenate((times[0] + step * np.arange(-many, 0), times)), many


PART = 0.3
"""Which part of an effect that is left out is tried, see :class:`Assumption`: enough that the model shows it [1]."""

SMALL = 0.01
"""Part of a standard deviation that is small enough for a derivative [1]."""


@dataclass(frozen=True)
class Assumption:
    """What a fit takes for granted, and how far off it may be.

    Attributes:
        words: what it is, behind "depends on".
        remedy: what would settle it.
        changes: parameters by name where they are a part of a standard deviation off [their units].
        part: which part: small, since estimates move by its first order, but such that the model can show it [1].
        options: of the model, where what is in assumption is left out of it.
        is_omitted: it may as well be nothing, and the log is asked; else it is an assumption that is surely off.
        most: standard deviations that it cannot go beyond, whatever a log seems to say [1].
    """

    words: str
    remedy: str
    changes: Mapping[str, float] = field(default_factory=dict)
    part: float = 1.0
    options: Mapping[str, Any] = field(default_factory=dict)
    is_omitted: bool = False
    most: float = math.inf


class AssumptionEffect(NamedTuple):
    """What a assumption does.

    Attributes:
        assumption: which.
        shift: standard deviation that it adds to each of the scaled free parameters, with its sign (p).
        size: how many of its own standard deviations that takes [1].
    """

    assumption: Assumption
    shift: Array
    size: float = 1.0


class Model(ABC):
    """Equations ẋ = f(x, u, p), y = h(x, u, p).

    Attributes:
        kind: name.
        title: kind and options in words.
        parameters: all of them.
        states: names of the states.
        state_scales: what counts as a large change of each state, in its unit.
        inputs: channels that it needs.
        outputs: channels that it is compared with.
        fine: longest step of the integration [s].
    """

    kind: str
    title: str
    parameters: tuple[Parameter, ...]
    states: tuple[str, ...]
    state_scales: tuple[float, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    max_step: float = 0.0101
    difference_step: float = 1e-5
    """Change of a scaled parameter for a derivative."""
    tolerance: float = 1e-7
    """Relative change of the unknowns that ends a fit."""
    input_parameters: frozenset[str] = frozenset()
    """Parameters that change :meth:`drive`."""

    @abstractmethod
    def input_signals(self, p: Mapping[str, float], drive: Segment, times: Array) -> Array:
        """Inputs of the equations (inputs, times).

        Args:
            p: parameters.
            drive: recorded channels.
            times: from the first sample of the drive on, even steps [s].
        """

    @abstractmethod
    def rates(self, x: Array, u: Array, p: Values) -> Array:
        """Time derivatives of the states.

        Args:
            x: states (states, columns, shots).
            u: inputs (inputs, columns, shots).
            p: parameters (columns, 1) each.
        """

    @abstractmethod
    def observe(self, x: Array, u: Array, p: Values) -> Array:
        """What the sensors of :attr:`outputs` show (outputs, …); arguments as of :meth:`rates`, or with more axes."""

    @abstractmethod
    def initial_states(self, p: Mapping[str, float], drive: Segment, rows: NDArray[np.intp]) -> Array:
        """Guesses of the state at samples of a drive (states, rows), from what was measured."""

    def derived_quantities(self, p: Mapping[str, float]) -> dict[str, tuple[float, str]]:
        """Combinations of parameters with a meaning of their own: value and unit by name."""
        del p
        return {}

    def plausible_range(self, name: str, p: Mapping[str, float]) -> tuple[float, float]:
        """Between which values a parameter makes sense."""
        del name, p
        return -np.inf, np.inf

    def assumptions(self, p: Mapping[str, float], assumed: frozenset[str]) -> tuple[Assumption, ...]:
        """What it takes for granted.

        Args:
            p: parameters.
            assumed: those that are fixed to what nobody gave.
        """
        del p, assumed
        return ()

    def suggest_experiment(self, names: frozenset[str]) -> str:
        """Which drive would tell these parameters apart."""
        del names
        return "drive with more and faster changes of the inputs"

    def offset_scale(self, channel: str) -> float:
        """How large the offset of a sensor is expected to be [unit of the channel]; 0: has none."""
        return OFFSETS.get(channel, 0.0)


OFFSETS = {
    "yaw_rate": 0.005, "lateral_acceleration": 0.15, "longitudinal_acceleration": 0.15, "vy": 0.05, "sideslip": 0.01,
    "roll": 0.01, "roll_rate": 0.005,
}  # fmt: skip
"""What inertial units are usually off by [rad/s, m/s², m/s, rad]: standard deviation of the offsets that are fitted."""


def smooth_between(values: Array, places: Array) -> Array:
    """Samples between their places by cubic convolution (R. G. Keys, IEEE Trans. ASSP 29, 1981).

    Straight lines round off what turns between two samples: they are a filter whose answer has the variance h²/6, for
    samples h apart. A lag τ has τ², so that a fit makes it shorter by h²/(12 τ) and the delay longer by as much: 0.17
    ms for 50 ms at 100 Hz. This has no such variance. A value that is held stays held.

    Args:
        values: samples (n).
        places: in samples from the first one (any); beyond the ends the last value counts.
    """
    last = len(values) - 1
    places = np.clip(places, 0.0, float(last))
    at = np.minimum(places.astype(np.intp), max(last - 1, 0))
    part = places - at
    one, two = values[at], values[np.minimum(at + 1, last)]
    before, behind = values[np.maximum(at - 1, 0)], values[np.minimum(at + 2, last)]
    cubic = 3.0 * (one - two) + behind - before
    square = 2.0 * before - 5.0 * one + 4.0 * two - behind
    found = one + 0.5 * part * (two - before + part * (square + part * cubic))
    return np.where(one == two, one, found)


def first_order(values: Array, step: float, lag: float) -> Array:
    """The answer of a first-order lag to straight lines between samples, at rest in the first sample; exact.

    Args:
        values: samples (n).
        step: [s].
        lag: time constant [s]; 0: none.
    """
    if lag <= 1e-6 * step:
        return values
    decay = float(np.exp(-step / lag))
    # Of a ramp within the step: u0 gets the weight w0, u1 the weight w1.
    rise = (lag / step) * (1.0 - decay)
    ahead, behind = 1.0 - rise, rise - decay
    return np.asarray(lfilter([ahead, behind], [1.0, -decay], values, zi=[rise * values[0]])[0])


def second_order(values: Array, step: float, frequency: float, damping: float) -> Array:
    """The answer of ÿ = ω² (u - y) - 2 ζ ω ẏ to samples joined by straight lines, at rest in the first one.

    Args:
        values: samples (n).
        step: [s].
        frequency: ω [rad/s].
        damping: ζ [1].
    """
    # State y, ẏ, u and the slope of u: exact for straight lines.
    block = np.zeros((4, 4))
    block[0, 1] = 1.0
    block[1] = [-(frequency**2), -2.0 * damping * frequency, frequency**2, 0.0]
    block[2, 3] = 1.0
    full = expm(block * step)
    a, b0, b1 = full[:2, :2], full[:2, 2] - full[:2, 3] / step, full[:2, 3] / step
    # y[k+1] = a y[k] + b0 u[k] + b1 u[k+1] as a transfer function of second order.
    trace, det = float(np.trace(a)), float(np.linalg.det(a))
    adj = np.array([[a[1, 1], -a[0, 1]], [-a[1, 0], a[0, 0]]])
    numerator = [b1[0], b0[0] - (adj @ b1)[0], -(adj @ b0)[0]]
    denominator = [1.0, -trace, det]
    return np.asarray(lfilter(numerator, denominator, values - values[0]) + values[0])


def channel_of(offered: set[str], names: tuple[str, ...], what: str, kind: str) -> str:
    """The first channel of a list that every log has.

    Raises:
        ConfigError: there is none.
    """
    for name in names:
        if name in offered:
            return name
    raise ConfigError(
        f"model {kind}: needs {what}, channel {' or '.join(names)}, in every log; the logs share "
        f"{', '.join(sorted(offered)) or 'nothing'}; map the column in 'channels'"
    )


def pick_outputs(offered: set[str], possible: list[str], asked: list[str] | None, kind: str) -> tuple[str, ...]:
    """The channels to compare.

    Raises:
        ConfigError: one that was asked for is missing or unknown, or there is none at all.
    """
    for name in asked or []:
        if name not in possible:
            raise ConfigError(f"model.outputs: {kind} has no output '{name}'; {did_you_mean(name, possible)}")
        if name not in offered:
            raise ConfigError(f"model.outputs: no log has '{name}'; map its column in 'channels'")
    found = tuple(name for name in possible if name in offered and (asked is None or name in asked))
    if not found:
        raise ConfigError(f"model {kind}: needs at least one of {', '.join(possible)} to compare with; map its column")
    return found
