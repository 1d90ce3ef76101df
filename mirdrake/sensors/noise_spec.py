"""Error models of sensors as in data sheets: white noise, bias, bias instability, random walk.

A plain number is the standard deviation of the white noise of a sample; a mapping sets the other terms:

::

    gyro_noise: {density: 0.005 deg/s/√Hz, bias: 0.2 deg/s, instability: 8 deg/h, correlation: 100 s}

In the Allan deviation (IEEE Std 952-1997, annex C) `density` N is the line N/√τ, `instability` B a plateau with its
maximum B at 1.89 x correlation, and `walk` K the line K √(τ/3). None of them depends on the sampling rate.
"""

import re
from collections.abc import Mapping
from math import pi, sqrt
from typing import Any, ClassVar, Self

from pydantic import Field, field_validator, model_validator

from mirdrake.core.constants import GRAVITY
from mirdrake.core.yaml_io import Duration, Schema

_NUMBER = re.compile(r"\s*([-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?)\s*(.*?)\s*", re.DOTALL)
_DEGREE, _G, _HOUR = pi / 180.0, GRAVITY, 3600.0
Units = Mapping[str, float]


def _to_si(value: Any, units: Units) -> Any:
    """Return a number or a text such as ``"8 deg/h"`` in the SI unit of a table, other values unchanged."""
    if isinstance(value, bool):
        raise ValueError(f"a number in {next(iter(units))} is expected, not {str(value).lower()}")
    match = _NUMBER.fullmatch(value) if isinstance(value, str) else None
    if match is None:
        return value
    # Spellings of the same unit, and both code points of the micro sign, are accepted.
    unit = re.sub(r"sqrt\((\w+)\)", r"√\1", match[2]).replace("^2", "²").replace("μ", "µ").replace("ug", "µg")
    if unit and unit not in units:
        raise ValueError(f"unit '{match[2][:20]}' does not fit; allowed: {', '.join(units)}")
    return float(match[1]) * units.get(unit, 1.0)


class NoiseSpec(Schema):
    """Error model of a measured quantity, applied to each axis. u is the unit of the quantity."""

    VALUE: ClassVar[Units] = {"1": 1.0}
    DENSITY: ClassVar[Units] = {"1/√Hz": 1.0}
    WALK: ClassVar[Units] = {"1/√s": 1.0}

    white: float = Field(default=0.0, ge=0, description="[u] standard deviation of white noise, per sample")
    density: float | None = Field(
        default=None, ge=0, description="[u/√Hz] density of the white noise, instead of `white`"
    )
    bias: float = Field(default=0.0, ge=0, description="[u] standard deviation of a constant bias, drawn once per run")
    instability: float = Field(default=0.0, ge=0, description="[u] bias instability: plateau of the Allan deviation")
    correlation: Duration = Field(default=100.0, gt=0, description="[s] correlation time of the bias instability")
    walk: float = Field(
        default=0.0, ge=0, description="[u/√s] random walk: after time t its standard deviation is √t x walk"
    )

    @model_validator(mode="before")
    @classmethod
    def _plain_number(cls, value: Any) -> Any:
        return {"white": value} if isinstance(value, int | float | str) else value

    @field_validator("white", "bias", "instability", mode="before")
    @classmethod
    def _value(cls, value: Any) -> Any:
        return _to_si(value, cls.VALUE)

    @field_validator("density", mode="before")
    @classmethod
    def _density(cls, value: Any) -> Any:
        return _to_si(value, cls.DENSITY)

    @field_validator("walk", mode="before")
    @classmethod
    def _walk(cls, value: Any) -> Any:
        return _to_si(value, cls.WALK)

    @model_validator(mode="after")
    def _one_white(self) -> Self:
        if self.white and self.density is not None:
            raise ValueError("white and density are both given; give one of them")
        return self

    def sample_deviation(self, rate: float) -> float:
        """Return the standard deviation of the white noise of one sample [u] at a rate [Hz]."""
        # Convention of the Allan deviation, N/√τ: samples at a rate f have the standard deviation N √f.
        return self.white if self.density is None else self.density * sqrt(rate)


class LengthNoise(NoiseSpec):
    """Error model of a position [m]."""

    VALUE: ClassVar[Units] = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
    DENSITY: ClassVar[Units] = {"m/√Hz": 1.0, "mm/√Hz": 1e-3}
    WALK: ClassVar[Units] = {"m/√s": 1.0, "mm/√s": 1e-3}


class SpeedNoise(NoiseSpec):
    """Error model of a velocity [m/s]."""

    VALUE: ClassVar[Units] = {"m/s": 1.0, "cm/s": 1e-2, "km/h": 1.0 / 3.6}
    DENSITY: ClassVar[Units] = {"m/s/√Hz": 1.0}
    WALK: ClassVar[Units] = {"m/s/√s": 1.0}


class AngleNoise(NoiseSpec):
    """Error model of an angle [rad]."""

    VALUE: ClassVar[Units] = {"rad": 1.0, "deg": _DEGREE, "°": _DEGREE}
    DENSITY: ClassVar[Units] = {"rad/√Hz": 1.0, "deg/√Hz": _DEGREE}
    WALK: ClassVar[Units] = {"rad/√s": 1.0, "deg/√s": _DEGREE, "deg/√h": _DEGREE / sqrt(_HOUR)}


class RateNoise(NoiseSpec):
    """Error model of an angular rate [rad/s]; an angle random walk in deg/√h is a density."""

    VALUE: ClassVar[Units] = {"rad/s": 1.0, "deg/s": _DEGREE, "deg/h": _DEGREE / _HOUR}
    DENSITY: ClassVar[Units] = {
        "rad/s/√Hz": 1.0, "deg/s/√Hz": _DEGREE, "deg/h/√Hz": _DEGREE / _HOUR, "deg/√h": _DEGREE / sqrt(_HOUR),
    }  # fmt: skip
    WALK: ClassVar[Units] = {"rad/s/√s": 1.0, "deg/s/√s": _DEGREE, "deg/h/√h": _DEGREE / _HOUR / sqrt(_HOUR)}


class AccelerationNoise(NoiseSpec):
    """Error model of an acceleration [m/s²]; a velocity random walk in m/s/√h is a density."""

    VALUE: ClassVar[Units] = {"m/s²": 1.0, "g": _G, "mg": 1e-3 * _G, "µg": 1e-6 * _G}
    DENSITY: ClassVar[Units] = {"m/s²/√Hz": 1.0, "mg/√Hz": 1e-3 * _G, "µg/√Hz": 1e-6 * _G, "m/s/√h": 1.0 / sqrt(_HOUR)}
    WALK: ClassVar[Units] = {"m/s²/√s": 1.0, "m/s²/√h": 1.0 / sqrt(_HOUR), "µg/√s": 1e-6 * _G}
