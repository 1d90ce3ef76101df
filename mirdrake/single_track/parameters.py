"""Parameters of the single-track model, by name and as the vector of a Context."""

from dataclasses import dataclass, fields

import numpy as np
import numpy.typing as npt

from mirdrake.core.checks import check_number
from mirdrake.core.constants import GRAVITY
from mirdrake.core.errors import ConfigError


@dataclass(frozen=True, kw_only=True)
class SingleTrackParameters:
    """Parameters of the single-track model, in the order of the numeric parameter of its Context.

    Attributes:
        mass: mass of the vehicle [kg].
        yaw_inertia: about the vertical through the centre of mass [kg m²].
        front_length: distance from the centre of mass to the front axle, a [m].
        rear_length: distance from the centre of mass to the rear axle, b [m].
        com_height: height of the centre of mass over the road [m].
        rotating_mass: mass equivalent of the inertia of wheels and rotors [kg].
        front_stiffness: cornering stiffness of the front axle, both tyres [N/rad].
        rear_stiffness: the same at the rear [N/rad].
        front_friction: friction of the front tyres on the road [1]; like the next one not for linear tyres.
        rear_friction: the same at the rear [1].
        front_relaxation: relaxation length of the front tyres [m].
        rear_relaxation: the same at the rear [m].
        rolling_resistance: rolling resistance over load [1].
        drag: drag over speed squared, half the density of air times the drag area [N s²/m²].
        front_drive: share of the drive force on the front axle [1].
        front_brake: share of the brake force on the front axle [1].
        max_force: limit of the drive force in both directions [N].
        servo_gain: drive force per speed error of the wheel servos [N s/m]; only with actuators.
        steering_lag: time constant of the steering servo [s]; only with actuators.
        gravity_x: gravity along x of the world [m/s²]; a slope tilts it.
        gravity_y: the same along y [m/s²].
        gravity_z: the same along z, negative [m/s²].
        blend_start: speed v1 up to which the model is kinematic [m/s].
        blend_end: speed v2 from which on it is fully dynamic [m/s].
        roll_mass: rolling mass [kg]; this and the following only with roll.
        roll_height: height of its centre over the roll axis [m].
        roll_inertia: about a longitudinal axis through that centre [kg m²].
        roll_stiffness: roll stiffness of springs, bars and tyres together [N m/rad]; more than roll_mass g roll_height.
        roll_damping: roll damping of the dampers [N m s/rad].
        front_roll_slip: equivalent slip of the front axle over the roll angle [1]: camber, roll steer.
        rear_roll_slip: the same at the rear [1].
        front_shape: shape factor C of the Magic Formula of the front tyres [1]; only with magic_formula tyres, like the
            next three.
        rear_shape: the same at the rear [1].
        front_curvature: curvature factor E of the front tyres [1], at most 1.
        rear_curvature: the same at the rear [1].
        wind_x: velocity of the air along x of the world [m/s].
        wind_y: component along y [m/s].
        overturning_arm: overturning moment of the tyres over their lateral force [m]; only with roll.

    Raises:
        ConfigError: not a finite number, or out of range.
    """

    mass: float
    yaw_inertia: float
    front_length: float
    rear_length: float
    com_height: float = 0.0
    rotating_mass: float = 0.0
    front_stiffness: float
    rear_stiffness: float
    front_friction: float = 1.0
    rear_friction: float = 1.0
    front_relaxation: float = 0.5
    rear_relaxation: float = 0.5
    rolling_resistance: float = 0.0
    drag: float = 0.0
    front_drive: float = 1.0
    front_brake: float = 0.6
    max_force: float = 1e6
    servo_gain: float = 0.0
    steering_lag: float = 0.02
    gravity_x: float = 0.0
    gravity_y: float = 0.0
    gravity_z: float = -GRAVITY
    blend_start: float = 1.0
    blend_end: float = 3.0
    roll_mass: float = 0.0
    roll_height: float = 0.0
    roll_inertia: float = 500.0
    roll_stiffness: float = 1e5
    roll_damping: float = 0.0
    front_roll_slip: float = 0.0
    rear_roll_slip: float = 0.0
    front_shape: float = 1.3
    rear_shape: float = 1.3
    front_curvature: float = 0.0
    rear_curvature: float = 0.0
    wind_x: float = 0.0
    wind_y: float = 0.0
    overturning_arm: float = 0.0

    def __post_init__(self) -> None:
        owner = "SingleTrackParameters"
        # Keep the ranges equal to those of are_allowed, which checks whole tables without exceptions.
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name in POSITIVE:
                check_number(owner, field.name, value, above=0.0)
            elif field.name in _SHARES:
                check_number(owner, field.name, value, at_least=0.0, at_most=1.0)
            elif field.name in _AT_MOST_ONE:
                check_number(owner, field.name, value, at_most=1.0)
            else:
                check_number(owner, field.name, value, at_least=0.0 if field.name in _NOT_NEGATIVE else -np.inf)
        if self.blend_end <= self.blend_start:
            raise ConfigError(
                f"blend_end must be above blend_start, {self.blend_start:g} m/s, got {self.blend_end:g} m/s",
                where=owner,
            )
        if self.gravity_z >= 0.0:
            raise ConfigError(f"gravity_z must be negative, got {self.gravity_z:g} m/s²; z is up", where=owner)
        # Static stability of roll: the springs must outweigh gravity on the rolled body.
        tipping = -self.roll_mass * self.gravity_z * self.roll_height
        if self.roll_stiffness <= tipping:
            raise ConfigError(
                f"roll_stiffness must be above roll_mass g roll_height, {tipping:g} N m/rad, or the vehicle "
                f"rolls over; got {self.roll_stiffness:g} N m/rad",
                where=owner,
            )

    @property
    def wheelbase(self) -> float:
        """Wheelbase [m]."""
        return self.front_length + self.rear_length

    def values(self) -> list[float]:
        """Return the values in the order of the Context's parameter."""
        return [float(getattr(self, name)) for name in PARAMETERS]


PARAMETERS = tuple(field.name for field in fields(SingleTrackParameters))
"""Names of the parameters in the order of the Context's numeric parameter 0."""

POSITIVE = {
    "mass", "yaw_inertia", "front_length", "rear_length", "front_stiffness", "rear_stiffness", "front_friction",
    "rear_friction", "front_relaxation", "rear_relaxation", "max_force", "steering_lag", "blend_start", "blend_end",
    "roll_inertia", "roll_stiffness", "front_shape", "rear_shape",
}  # fmt: skip
_SHARES = {"front_drive", "front_brake"}
_AT_MOST_ONE = {"front_curvature", "rear_curvature"}
_NOT_NEGATIVE = {
    "com_height", "rotating_mass", "rolling_resistance", "drag", "servo_gain", "roll_mass", "roll_damping",
}  # fmt: skip


def are_allowed(table: npt.NDArray[np.float64]) -> npt.NDArray[np.bool_]:
    """Return whether each row (n, parameters) has values that :class:`SingleTrackParameters` allows (n)."""
    columns = dict(zip(PARAMETERS, table.T, strict=True))
    # The same ranges as in the constructor; NaN fails every comparison, and infinity is excluded here.
    allowed = np.isfinite(table).all(axis=1)
    for name, values in columns.items():
        if name in POSITIVE:
            allowed &= values > 0.0
        elif name in _SHARES or name in _NOT_NEGATIVE:
            allowed &= values >= 0.0
        if name in _SHARES or name in _AT_MOST_ONE:
            allowed &= values <= 1.0
    allowed &= columns["blend_end"] > columns["blend_start"]
    allowed &= columns["gravity_z"] < 0.0
    allowed &= columns["roll_stiffness"] > -columns["roll_mass"] * columns["gravity_z"] * columns["roll_height"]
    return np.asarray(allowed)
