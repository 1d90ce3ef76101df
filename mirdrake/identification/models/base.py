"""Interface between models and estimators: states, derivatives and sensor outputs for many parameter sets at once."""

import math
from abc import ABC, abstractmethod
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.yaml_io import Schema, Source
from mirdrake.identification.data import DataSet
from mirdrake.identification.models.filters import smooth_between
from mirdrake.identification.parameters import Parameter, Setting
from mirdrake.vehicles import Vehicle

Array = NDArray[np.float64]
Values = Mapping[str, Any]
"""Parameters by name: floats, or arrays (columns, 1)."""

SPEED = ("vx", "speed")
"""Channels of the speed; the first one that all logs have is used."""


class ModelOptions(Schema):
    """Options of a model; each model class declares its own subclass."""


@dataclass(frozen=True)
class ModelSpec:
    """Kind of a model and its options, not yet checked.

    Attributes:
        kind: key in :data:`mirdrake.identification.models.registry.MODELS`.
        options: fields of the model's :attr:`Model.Options`.
        source: file and lines of the options, for error messages; None if they are not from a file.
    """

    kind: str
    options: Mapping[str, Any] = field(default_factory=dict)
    source: Source | None = field(default=None, compare=False)


@dataclass(frozen=True)
class Segment:
    """Uninterrupted part of a log, resampled to a constant step.

    Attributes:
        log: name of the log.
        part: "train" or "validation".
        start: time of the first sample [s].
        step: sample time [s].
        inputs: channels that drive the model, by name (n each), without gaps.
        outputs: channels that the model is compared with (n each), NaN for missing values.
        before: inputs before the first sample, of a piece cut from a longer segment (m each); may be empty.
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
        """Times of the samples (n) [s]."""
        return np.asarray(self.start + self.step * np.arange(self.size), dtype=np.float64)

    @property
    def names(self) -> frozenset[str]:
        """Names of all channels."""
        return frozenset((*self.inputs, *self.outputs))

    def channels(self, name: str) -> Array:
        """Return the samples of an input or output (n)."""
        return self.inputs[name] if name in self.inputs else self.outputs[name]

    def at(self, name: str, times: Array, delay: float = 0.0, *, smooth: bool = False) -> Array:
        """Interpolate an input channel.

        Args:
            name: channel.
            times: relative to the first sample (any) [s].
            delay: delay to apply to the channel [s].
            smooth: cubic interpolation, see :func:`smooth_between`; otherwise linear.
        """
        early = self.before.get(name, np.empty(0))
        known = np.concatenate((early, self.inputs[name]))
        if smooth:
            return smooth_between(known, (times - delay) / self.step + len(early))
        return np.interp(times - delay, self.step * (np.arange(len(known)) - len(early)), known)

    def with_history(self, times: Array) -> tuple[Array, int]:
        """Extend evenly spaced times backwards as far as inputs are known; return them and the number added.

        A lag is not at rest where a piece begins, so its response is computed from further back.
        """
        known = max((len(values) for values in self.before.values()), default=0)
        step = float(times[1] - times[0])
        added = int(known * self.step / step + 1e-6)
        return np.concatenate((times[0] + step * np.arange(-added, 0), times)), added


OMITTED_FRACTION = 0.3
"""Fraction of one standard deviation at which an omitted effect is evaluated: large enough for the model to show it."""

SMALL_FRACTION = 0.01
"""Fraction of one standard deviation at which a derivative by an assumed value is evaluated."""


@dataclass(frozen=True)
class Assumption:
    """Assumption of a fit and its uncertainty.

    Attributes:
        description: noun phrase that completes "depends on …".
        remedy: what would make the assumption unnecessary.
        changes: parameters by name, a fraction of one standard deviation off [their units].
        fraction: that fraction [1]: small, as estimates are linearised in it, but with a visible effect in the model.
        options: model options that add an omitted effect.
        is_omitted: whether it is an effect that may be absent, for which the log is evidence; otherwise it is
            an assumed value, which is certainly off.
        max_size: bound on its size, in standard deviations [1].
    """

    description: str
    remedy: str
    changes: Mapping[str, float] = field(default_factory=dict)
    fraction: float = 1.0
    options: Mapping[str, Any] = field(default_factory=dict)
    is_omitted: bool = False
    max_size: float = math.inf


class AssumptionEffect(NamedTuple):
    """Contribution of an assumption to the uncertainty.

    Attributes:
        assumption: the assumption.
        shift: standard deviation that it adds to each of the scaled free parameters, with its sign (p).
        size: expected size of the assumption's error, in its standard deviations [1].
    """

    assumption: Assumption
    shift: Array
    size: float = 1.0


class Addition(NamedTuple):
    """Effect that the structure search may add to a model.

    Attributes:
        description: noun phrase for the notes of a fit.
        settings: parameters that become free.
        options: model options.
        starts: factors on parameters of further initial values, as the cost may have several minima.
        is_nonlinear: whether the gradient without the effect does not show that it is needed.
    """

    description: str
    settings: Mapping[str, Setting] = MappingProxyType({})
    options: Mapping[str, Any] = MappingProxyType({})
    starts: tuple[Mapping[str, float], ...] = ()
    is_nonlinear: bool = False


class Model(ABC):
    """States, outputs and parameters of a model, whatever computes its runs.

    A new model is a subclass of :class:`~mirdrake.identification.models.equations.EquationModel` or
    :class:`~mirdrake.identification.models.simulated.SimulatedModel` in a file of its own, and one line in the
    registry. Everything that differs between models is an attribute or a method here.

    Args of the constructor: the channels that all logs have, known parameter values by name, the wheelbase of the data
    set [m] or None, and the checked :attr:`Options`.

    Attributes:
        kind: key in the registry.
        Options: schema of the options.
        data_parameters: parameters that a data file can give for a fit without a study.
        uses_steering_guess: whether slow turns give the first guess of steering ratio and offset.
        title: kind and options in words.
        parameters: all parameters.
        states: names of the states.
        state_scales: size of a large change of each state, in its unit.
        inputs: channels that drive the equations.
        exact_inputs: those of them that are not measured while driving, as the height of a known road: their fast part
            is not noise.
        outputs: channels that are compared.
        max_step: longest step of the integration [s].
        sample_time: sample time up to which logs are averaged [s].
        difference_step: change of a scaled parameter for a numerical derivative.
        tolerance: relative change of the unknowns at which a fit ends.
    """

    kind: ClassVar[str]
    Options: ClassVar[type[ModelOptions]] = ModelOptions
    data_parameters: ClassVar[tuple[str, ...]] = ()
    uses_steering_guess: ClassVar[bool] = False
    title: str
    parameters: tuple[Parameter, ...]
    states: tuple[str, ...]
    state_scales: tuple[float, ...]
    inputs: tuple[str, ...]
    exact_inputs: tuple[str, ...] = ()
    outputs: tuple[str, ...]
    max_step: float = 0.0101
    sample_time: float = 0.004
    difference_step: float = 1e-5
    tolerance: float = 1e-7

    @abstractmethod
    def __init__(self, channels: set[str], known: Mapping[str, float], wheelbase: float | None, options: Any) -> None:
        """Choose inputs and outputs from the channels and make the parameters."""

    @classmethod
    def is_default_for(cls, channels: set[str]) -> bool:
        """Whether a data file with these channels is fitted with this model when no study is given."""
        del channels
        return False

    @classmethod
    def vehicle_values(cls, vehicle: Vehicle, options: Any, *, measured: bool) -> dict[str, float]:
        """Return the parameters that the files of a vehicle give, by name.

        Args:
            vehicle: a loaded vehicle.
            options: checked options of the model.
            measured: whether the road wheel angle is recorded, rather than its set-point.
        """
        from mirdrake.identification.models.vehicle_values import common_values

        del options
        return common_values(vehicle, measured=measured)

    @classmethod
    def additions(cls, data: DataSet, options: Any, settings: Mapping[str, Setting]) -> Iterator[Addition]:
        """Yield the effects that the study leaves open, in the order in which they are tried."""
        del data, options, settings
        yield from ()

    @abstractmethod
    def initial_states(self, p: Mapping[str, float], drive: Segment, rows: NDArray[np.intp]) -> Array:
        """Return guesses of the states at samples of a segment (states, rows), from the measurements."""

    def input_memory(self, p: Mapping[str, float]) -> dict[str, tuple[float, float]]:
        """Return dead time and lag of the inputs that have one, by channel [s]."""
        del p
        return {}

    def derived_quantities(self, p: Mapping[str, float]) -> dict[str, tuple[float, str]]:
        """Return physically meaningful combinations of parameters: value and unit by name."""
        del p
        return {}

    def plausible_range(self, name: str, p: Mapping[str, float]) -> tuple[float, float]:
        """Return the range of values in which a parameter makes physical sense."""
        del name, p
        return -np.inf, np.inf

    def assumptions(self, p: Mapping[str, float], assumed: frozenset[str]) -> tuple[Assumption, ...]:
        """Return the assumptions of the model.

        Args:
            p: parameters.
            assumed: names of the parameters that are fixed to a default.
        """
        del p, assumed
        return ()

    def complete(self, p: Mapping[str, float]) -> dict[str, float]:
        """Return parameters with those that follow from others; the same again for its own result."""
        return dict(p)

    def complement(self, name: str) -> str | None:
        """Return the parameter whose sum with this one is known, so that an error of one is that of the other."""
        del name
        return None

    def suggest_experiment(self, names: frozenset[str], drives: Sequence[Segment] = ()) -> str:
        """Return, in the imperative, which drive would identify these parameters; empty if the logs lack nothing.

        Args:
            names: parameters.
            drives: segments of the logs that they were fitted to.
        """
        del names, drives
        return "drive with more and faster changes of the inputs"

    def candidate_manoeuvres(self, p: Mapping[str, float], speed: float) -> dict[str, dict[str, Array]]:
        """Return standard manoeuvres for the experiment design: channels in steps of 0.01 s, by name of the manoeuvre.

        Args:
            p: parameters.
            speed: highest speed that may be driven [m/s].
        """
        del p, speed
        return {}

    def offset_scale(self, channel: str) -> float:
        """Return the expected size of a sensor's offset [unit of the channel]; 0 if it has none."""
        return OFFSETS.get(channel, 0.0)


OFFSETS = {
    "yaw_rate": 0.005, "lateral_acceleration": 0.15, "longitudinal_acceleration": 0.15, "vy": 0.05, "sideslip": 0.01,
    "roll": 0.01, "roll_rate": 0.005,
}  # fmt: skip
"""Usual offsets of inertial sensors [rad/s, m/s², m/s, rad]: standard deviation of the offsets that are estimated."""


def find_channel(channels: set[str], names: Collection[str], what: str, kind: str) -> str:
    """Return the first of several channels that every log has.

    Raises:
        ConfigError: none is there.
    """
    for name in names:
        if name in channels:
            return name
    raise ConfigError(
        f"{kind}: needs {what}, channel {' or '.join(names)}, in every log; the logs share "
        f"{', '.join(sorted(channels)) or 'nothing'}; map the column in 'channels'",
        path=("model",),
    )


def select_outputs(channels: set[str], possible: list[str], requested: list[str] | None, kind: str) -> tuple[str, ...]:
    """Return the channels to compare.

    Raises:
        ConfigError: a requested output is missing or unknown, or the logs have no output of the model.
    """
    for name in requested or []:
        if name not in possible:
            hint = did_you_mean(name, possible)
            raise ConfigError(f"{kind} has no output '{name}'; {hint}", path=("model", "outputs"))
        if name not in channels:
            raise ConfigError(f"no log has '{name}'; map its column in 'channels'", path=("model", "outputs"))
    outputs = tuple(name for name in possible if name in channels and (requested is None or name in requested))
    if not outputs:
        raise ConfigError(
            f"{kind}: needs at least one of {', '.join(possible)} to compare with; map its column", path=("model",)
        )
    return outputs
