"""Settings of a filter bank; the same keys in Python, in diagram files and in files of the command."""

from typing import NamedTuple

from pydantic import Field, field_validator

from mirdrake.core.errors import did_you_mean
from mirdrake.core.yaml_io import Duration, Length, Period, Schema
from mirdrake.single_track.dynamics import Inputs
from mirdrake.single_track.parameters import PARAMETERS

SENSORS = {
    "steering": ("rad", 0.001),
    "vx": ("m/s", 0.1),
    "vy": ("m/s", 0.1),
    "yaw_rate": ("rad/s", 0.005),
    "roll": ("rad", 0.005),
    "roll_rate": ("rad/s", 0.01),
    "sideslip": ("rad", 0.01),
    "longitudinal_acceleration": ("m/s²", 0.2),
    "lateral_acceleration": ("m/s²", 0.2),
}
"""Quantities that a sensor may measure, in the order of the constants of the kernel: unit, usual noise."""

GROUPS = {
    "stiffness": ("front_stiffness", "rear_stiffness"),
    "friction": ("front_friction", "rear_friction"),
    "relaxation": ("front_relaxation", "rear_relaxation"),
    "inertia": ("mass", "yaw_inertia"),
}
"""Parameters that have one factor."""

OFFSETS = {f"{name}_offset": name for name in Inputs._fields[1:3]}
"""Offsets of the forces."""

ACCELERATIONS = ("longitudinal_disturbance", "lateral_disturbance", "yaw_disturbance")
"""Accelerations that the model does not explain."""


class Prior(NamedTuple):
    """Density of the noise of a state [unit/√s] and standard deviation of its initial value [unit]."""

    density: float
    start: float


STATES = {
    "steering": Prior(0.0, 0.05),
    "steering_rate": Prior(0.0, 0.2),
    "vx": Prior(0.02, 1.0),
    "vy": Prior(0.02, 0.3),
    "yaw_rate": Prior(0.005, 0.1),
    "front_slip": Prior(0.001, 0.01),
    "rear_slip": Prior(0.001, 0.01),
    "roll": Prior(0.001, 0.02),
    "roll_rate": Prior(0.01, 0.05),
}
"""States of a filter: those of the model without the pose."""


class SensorSpec(Schema):
    """A sensor of a filter."""

    noise: float | None = Field(
        default=None,
        gt=0.0,
        description="standard deviation of its noise; a usual one if left out [unit of the sensor]",
    )
    ahead: Length = Field(default=0.0, description="position ahead of the centre of mass [m]")
    bias: float = Field(
        default=0.0, ge=0.0, description="standard deviation of a bias to estimate; 0: no bias [unit of the sensor]"
    )


class SlowSpec(Schema):
    """A parameter or offset to estimate, which changes slowly (random walk)."""

    sigma: float = Field(
        gt=0.0,
        description="standard deviation at the start: of a positive parameter over its value; of others absolute [-]",
    )
    drift: float | None = Field(
        default=None,
        ge=0.0,
        description="standard deviation of its change in one second, and least one if it is adapted; by default 6 % of "
        "sigma [as sigma]",
    )


class DisturbanceSpec(Schema):
    """An acceleration that the model does not explain (first-order Gauss-Markov process)."""

    sigma: float = Field(ge=0.0, description="standard deviation; 0: none [m/s² or rad/s²]")
    time: Duration | None = Field(
        default=None, gt=0.0, description="correlation time; by default 0.5 s for a car, less for small ones [s]"
    )


class HypothesisSpec(Schema):
    """What one filter of the bank assumes; keys left out are those of the bank."""

    name: str | None = Field(default=None, description="name in results; by default its settings [-]")
    tyres: str | None = Field(default=None, description="linear, or a kind of tyres as brush, magic_formula [-]")
    relaxation: bool | None = Field(default=None, description="whether the slip of each axle is a state [-]")
    roll: bool | None = Field(default=None, description="whether roll angle and roll rate are states [-]")
    parameters: dict[str, float] = Field(
        default_factory=dict, description="parameters of the single-track model that differ from the vehicle [SI]"
    )
    noise: float = Field(default=1.0, gt=0.0, description="factor on the noise of all sensors [1]")
    disturbance: float = Field(default=1.0, gt=0.0, description="factor on the accelerations that the model lacks [1]")
    weight: float = Field(default=1.0, gt=0.0, description="weight before any measurement, relative to the others [-]")


class FilterSpec(Schema):
    """A bank of filters that estimate states and slowly varying parameters of a car from its measurements."""

    tyres: str = Field(default="brush", description="linear, or a kind of tyres as brush, magic_formula [-]")
    relaxation: bool = Field(default=True, description="whether the slip of each axle is a state [-]")
    roll: bool = Field(default=False, description="whether roll angle and roll rate are states [-]")
    parameters: dict[str, float] = Field(
        default_factory=dict, description="parameters of the single-track model that differ from the vehicle [SI]"
    )
    hypotheses: list[HypothesisSpec] = Field(
        default_factory=lambda: [HypothesisSpec()], min_length=1, description="what each filter assumes [-]"
    )
    sensors: dict[str, SensorSpec] = Field(
        default_factory=lambda: {name: SensorSpec() for name in ("steering", "vx", "yaw_rate", "lateral_acceleration")},
        min_length=1,
        description="measured quantities; a number is the noise [-]",
    )
    steering_acceleration: float | None = Field(
        default=None, gt=0.0, description="density of the angular acceleration of the steering [rad/s² per √Hz]"
    )
    estimate: dict[str, SlowSpec] = Field(
        default_factory=dict,
        description="parameters and offsets to estimate; a number is sigma [-]",
    )
    longitudinal_disturbance: DisturbanceSpec = Field(
        default_factory=lambda: DisturbanceSpec(sigma=1.0),
        description="longitudinal acceleration beside that of the known forces [m/s²]",
    )
    lateral_disturbance: DisturbanceSpec = Field(
        default_factory=lambda: DisturbanceSpec(sigma=0.2), description="lateral acceleration [m/s²]"
    )
    yaw_disturbance: DisturbanceSpec | None = Field(
        default=None, description="yaw acceleration; by default the lateral one over half the wheelbase [rad/s²]"
    )
    period: Period = Field(default=0.02, gt=0.0, description="time between two samples [s]")
    step: Period = Field(default=0.005, gt=0.0, description="largest step of the integration [s]")
    adaptation_time: Duration = Field(
        default=20.0, ge=0.0, description="time constant of the adaptation of the noise; 0: none [s]"
    )
    consistency_time: Duration = Field(default=5.0, gt=0.0, description="time over which innovations are judged [s]")
    switching_time: Duration | None = Field(
        default=None, gt=0.0, description="mean time between changes of the true hypothesis; never if left out [s]"
    )

    # A number is the noise of a sensor; a list has sensors with their usual noise.
    @field_validator("sensors", mode="before", json_schema_input_type=dict[str, SensorSpec | float] | list[str])
    @classmethod
    def _noise_alone(cls, given: object) -> object:
        if isinstance(given, dict):
            return {
                name: {"noise": value} if isinstance(value, float | int) else value for name, value in given.items()
            }
        return {name: {} for name in given} if isinstance(given, list | tuple) else given

    @field_validator("estimate", mode="before", json_schema_input_type=dict[str, SlowSpec | float])
    @classmethod
    def _sigma_alone(cls, given: object) -> object:
        if isinstance(given, dict):
            return {
                name: {"sigma": value} if isinstance(value, float | int) else value for name, value in given.items()
            }
        return given

    @field_validator("sensors")
    @classmethod
    def _known_sensors(cls, given: dict[str, SensorSpec]) -> dict[str, SensorSpec]:
        for name in given:
            if name not in SENSORS:
                raise ValueError(f"no sensor measures '{name}'; {did_you_mean(name, SENSORS)}")
        return given

    @field_validator("estimate")
    @classmethod
    def _known_parameters(cls, given: dict[str, SlowSpec]) -> dict[str, SlowSpec]:
        allowed = [*PARAMETERS, *GROUPS, *OFFSETS]
        for name in given:
            if name not in allowed:
                raise ValueError(f"no parameter '{name}'; {did_you_mean(name, allowed)}")
        # A parameter in two of them would have two factors.
        used = [part for name in given for part in GROUPS.get(name, (name,))]
        twice = sorted({part for part in used if used.count(part) > 1})
        if twice:
            raise ValueError(f"'{twice[0]}' is estimated twice, alone and with a group; leave out one of them")
        return given
