"""Blocks of a diagram file: those of mirdrake by kind, and user classes.

A new block of ours is one schema with a ``make`` method here and one entry in :data:`BLOCKS`.
"""

from collections.abc import Callable, Mapping
from math import inf
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field
from pydrake.systems.framework import System
from pydrake.systems.primitives import (
    Adder,
    ConstantVectorSource,
    DiscreteTimeDelay,
    FirstOrderLowPassFilter,
    Gain,
    Saturation,
    Sine,
    ZeroOrderHold,
)

from mirdrake.controllers import DiscretePid, PidGains, PidLimits
from mirdrake.core.checks import whole_periods
from mirdrake.core.errors import ConfigError, MissingDependencyError, did_you_mean
from mirdrake.core.user_systems import construct, make_user_system, user_defaults
from mirdrake.core.yaml_io import Duration, Period, Schema, Source, validate
from mirdrake.estimation.system import FilterBlock
from mirdrake.networks import NetworkBlock


class ConstantBlock(Schema):
    """A constant vector; the output is called y."""

    value: list[float] = Field([0.0], min_length=1, description="the elements [-]")

    def make(self) -> System:
        """Return the system."""
        return ConstantVectorSource(self.value)


class SineBlock(Schema):
    """amplitude · sin(2π frequency t + phase). Outputs y0, and its two derivatives y1, y2."""

    amplitude: float = Field(1.0, description="amplitude [-]")
    frequency: float = Field(gt=0.0, description="frequency [Hz]")
    phase: float = Field(0.0, description="phase at the start [rad]")

    def make(self) -> System:
        """Return the system."""
        # Drake takes the angular frequency.
        return Sine(amplitude=self.amplitude, frequency=2.0 * np.pi * self.frequency, phase=self.phase, size=1)


class GainBlock(Schema):
    """y = gain · u."""

    gain: float = Field(description="factor of each element [-]")
    size: int = Field(1, ge=1, description="number of elements of a port [-]")

    def make(self) -> System:
        """Return the system."""
        return Gain(self.gain, self.size)


class AdderBlock(Schema):
    """sum = u0 + u1 + …; the output is called sum."""

    inputs: int = Field(2, ge=2, description="number of input ports [-]")
    size: int = Field(1, ge=1, description="number of elements of a port [-]")

    def make(self) -> System:
        """Return the system."""
        return Adder(self.inputs, self.size)


class SaturationBlock(Schema):
    """y = u within limits."""

    minimum: float = Field(description="lower limit of each element [-]")
    maximum: float = Field(description="upper limit of each element [-]")
    size: int = Field(1, ge=1, description="number of elements of a port [-]")

    def make(self) -> System:
        """Return the system."""
        if not self.minimum <= self.maximum:
            raise ConfigError(f"saturation: minimum {self.minimum} is above maximum {self.maximum}")
        return Saturation(min_value=[self.minimum] * self.size, max_value=[self.maximum] * self.size)


class LowPassBlock(Schema):
    """First-order low-pass y = u / (1 + time_constant s), with a continuous state."""

    time_constant: Duration = Field(gt=0.0, description="time constant [s]")
    size: int = Field(1, ge=1, description="number of elements of a port [-]")

    def make(self) -> System:
        """Return the system."""
        return FirstOrderLowPassFilter(time_constant=self.time_constant, size=self.size)


class DelayBlock(Schema):
    """The input, sampled every `period` and delayed by `delay`."""

    delay: Duration = Field(gt=0.0, description="delay, a multiple of the period [s]")
    period: Period = Field(0.02, gt=0.0, description="sample time [s]")
    size: int = Field(1, ge=1, description="number of elements of a port [-]")

    def make(self) -> System:
        """Return the system."""
        steps = whole_periods(self.delay, self.period)
        # A delay of zero steps would be an algebraic connection.
        if not steps:
            raise ConfigError(f"delay: {self.delay:g} s is not a multiple of the period, {self.period:g} s")
        return DiscreteTimeDelay(self.period, steps, self.size)


class HoldBlock(Schema):
    """The input, sampled every `period` and held."""

    period: Period = Field(gt=0.0, description="sample time [s]")
    size: int = Field(1, ge=1, description="number of elements of a port [-]")

    def make(self) -> System:
        """Return the system."""
        return ZeroOrderHold(self.period, self.size)


class PidBlock(Schema):
    """A discrete PID controller with the ports of :class:`mirdrake.DiscretePid`."""

    kp: float = Field(description="proportional gain; u, y: units of output and measurement [u/y]")
    ki: float = Field(0.0, description="integral gain [u/(y s)]")
    kd: float = Field(0.0, description="derivative gain [u s/y]")
    filter_time: Duration = Field(
        0.0, ge=0.0, description="time constant of the low-pass of the derivative; 0: none [s]"
    )
    period: Period = Field(0.02, gt=0.0, description="sample time [s]")
    minimum: float | None = Field(None, description="lower limit of the output [-]")
    maximum: float | None = Field(None, description="upper limit of the output [-]")
    rate: float | None = Field(None, gt=0.0, description="largest change of the output per second [-]")

    def make(self) -> System:
        """Return the system."""
        limits = PidLimits(
            minimum=-inf if self.minimum is None else self.minimum,
            maximum=inf if self.maximum is None else self.maximum,
            rate=inf if self.rate is None else self.rate,
        )
        gains = PidGains(self.kp, self.ki, self.kd, filter_time=self.filter_time)
        return DiscretePid(gains, period=self.period, limits=limits)


BLOCKS: dict[str, type[Schema]] = {
    "adder": AdderBlock,
    "constant": ConstantBlock,
    "delay": DelayBlock,
    "filter_bank": FilterBlock,
    "gain": GainBlock,
    "hold": HoldBlock,
    "low_pass": LowPassBlock,
    "network": NetworkBlock,
    "pid": PidBlock,
    "saturation": SaturationBlock,
    "sine": SineBlock,
}


def make_block(
    kind: str,
    parameters: Mapping[str, Any],
    *,
    source: Source,
    folder: Path | None = None,
    factory: Callable[[], System] | None = None,
) -> System:
    """Return the system of a kind.

    Args:
        kind: a name in :data:`BLOCKS`, or ``module:Class`` of the user's.
        parameters: its parameters.
        source: where they were written, for error messages.
        folder: where a user's module may lie, besides the import path and the working directory.
        factory: makes the system of a class or object in Python; the kind is only its name.

    Raises:
        ConfigError: unknown kind, module, class or parameter, or the class rejects its parameters.
    """
    where = source.where("kind")
    # Objects in Python come first: their kind is a label, not a name to look up.
    if factory is not None:
        return construct(factory, kind, where=where)
    if ":" in kind:
        return make_user_system(kind, parameters, where=where, folder=folder, locate=lambda name: source.where(name))
    if kind not in BLOCKS:
        words = did_you_mean(kind, BLOCKS)
        raise ConfigError(f"unknown kind '{kind}'; {words}, or a class of your own as module:Class", where=where)
    spec = validate(dict(parameters), BLOCKS[kind], source)
    try:
        system: System = spec.make()  # type: ignore[attr-defined]
    except (ConfigError, MissingDependencyError) as error:
        raise type(error)(f"{source.where()}: {error}") from None
    return system


def all_parameters(
    kind: str, given: Mapping[str, Any], *, source: Source, folder: Path | str | None = None
) -> dict[str, object]:
    """Return the parameters of a block, in SI units, with the defaults of those that are not given.

    Args:
        kind: as for :func:`make_block`.
        given: its parameters.
        source: where they were written, for error messages.
        folder: where a user's module may lie.

    Raises:
        ConfigError: no such module or class, or a parameter that a kind of ours rejects.
    """
    if kind in BLOCKS:
        return dict(validate(dict(given), BLOCKS[kind], source))
    return user_defaults(kind, folder=folder) | dict(given)
