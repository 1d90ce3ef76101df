"""The YAML files of a vehicle folder: vehicle.yaml, control.yaml and variants; sensors.yaml is in mounts.py.

They hold what a URDF has no words for: which joint is which wheel, what drives and brakes, gains.
Dimensions and masses are not repeated here; they are measured on the kinematics (:mod:`mirdrake.vehicles.geometry`).
"""

from collections.abc import Iterator
from itertools import pairwise
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from mirdrake.core.errors import did_you_mean
from mirdrake.core.yaml_io import Acceleration, Angle, AngularRate, Duration, Frequency, Length, Schema, Speed, Torque
from mirdrake.tyres import TyreSpec
from mirdrake.vehicles.chassis_spec import Aerodynamics, Suspension, SuspensionJoints
from mirdrake.vehicles.powertrain_spec import Actuators, Brakes, Pedals, Powertrain

Drive = Literal["front", "rear", "all"]
WHEELS = ("front_left", "front_right", "rear_left", "rear_right")


# --- vehicle.yaml ------------------------------------------------------------------------------------------------


class WheelJoints(Schema):
    """The continuous joints of the four wheels, by place."""

    front_left: str
    front_right: str
    rear_left: str
    rear_right: str

    def names(self) -> tuple[str, str, str, str]:
        """Joint names in the order of :data:`WHEELS`."""
        return (self.front_left, self.front_right, self.rear_left, self.rear_right)


class SteeringJoints(Schema):
    """The revolute joints that turn the front wheels."""

    left: str
    right: str

    def names(self) -> tuple[str, str]:
        """Joint names, left first."""
        return (self.left, self.right)


class Joints(Schema):
    """Which joint of the URDF has which role."""

    wheels: WheelJoints
    steering: SteeringJoints
    suspension: SuspensionJoints | None = Field(default=None, description="empty: the wheels do not move up and down")


class Steering(Schema):
    """How one steering command becomes two wheel angles."""

    law: Literal["ackermann", "unior", "unior_printed"] = Field(
        default="ackermann", description="exact geometry, or a linkage: see mirdrake/controllers/ackermann.py"
    )
    factor: float = Field(
        default=0.5, gt=0, description="[-] angle of the directly set wheel over the input; unior laws only"
    )
    limit: Angle | None = Field(
        default=None, gt=0, lt=1.5, description="[rad] limit of the inner wheel; empty: the joints' own limit"
    )
    rate: AngularRate | None = Field(
        default=None, gt=0, description="[rad/s] limit at the road wheel; empty: the joints' own limit"
    )
    ratio: float = Field(default=1.0, gt=0, description="[-] hand-wheel angle to road-wheel angle")


class VehicleSpec(Schema):
    """vehicle.yaml."""

    name: str = Field(min_length=1, description="make and model, for titles")
    grade: Literal["A", "B", "C"] = Field(
        description="A: measured on the car; B: published figures, the rest assumed; C: mostly assumed"
    )
    licence: str = Field(min_length=1)
    base_link: str = "base_link"
    joints: Joints
    drive: Drive = Field(description="driven axle; the argument `drive` of the xacro follows it")
    steering: Steering
    tyres: TyreSpec
    powertrain: Powertrain
    brakes: Brakes
    aerodynamics: Aerodynamics
    suspension: Suspension | None = Field(default=None, description="springs of the joints named as suspension")
    pedals: Pedals = Field(default_factory=Pedals)
    actuators: Actuators = Field(default_factory=Actuators)
    sources: dict[str, str] = Field(
        default_factory=dict,
        description="dotted path of a number in this file -> where it is from, or why it is assumed",
    )

    def driven_wheels(self) -> tuple[str, ...]:
        """Names of the driven wheels, in the order of :data:`WHEELS`."""
        return {"front": WHEELS[:2], "rear": WHEELS[2:], "all": WHEELS}[self.drive]

    def numbers_without_source(self) -> list[str]:
        """Dotted paths of the numbers in this file that `sources` does not explain."""
        return [path for path in _number_paths(self) if path not in self.sources]

    def sources_without_number(self) -> list[str]:
        """What is wrong with entries of `sources` that explain nothing: one text each."""
        paths = list(_number_paths(self))
        return [f"'{path}'; {did_you_mean(path, paths)}" for path in self.sources if path not in paths]


def _number_paths(spec: Schema, prefix: str = "") -> Iterator[str]:
    for name in type(spec).model_fields:
        value = getattr(spec, name)
        if isinstance(value, Schema):
            yield from _number_paths(value, f"{prefix}{name}.")
        elif isinstance(value, int | float) and not isinstance(value, bool) and name in spec.model_fields_set:
            yield f"{prefix}{name}"


# --- control.yaml ------------------------------------------------------------------------------------------------


class SpeedControl(Schema):
    """Loop around the vehicle's speed: a PI controller that trims the set-point of the wheels' speed."""

    kp: float = Field(default=0.5, ge=0, description="[-] extra set-point per speed error")
    ki: float = Field(default=0.5, ge=0, description="[1/s]")
    max_correction: Speed = Field(default=2.0, ge=0, description="[m/s] limit of the trim, and of its integral")
    max_acceleration: Acceleration = Field(default=3.0, gt=0, description="[m/s²] slope of the set-point, faster")
    max_deceleration: Acceleration = Field(default=5.0, gt=0, description="[m/s²] slope of the set-point, slower")


class Beliefs(Schema):
    """Dimensions that the controllers calculate with in place of the model's own; empty: the model's."""

    wheelbase: Length | None = Field(default=None, gt=0, description="[m]")
    track: Length | None = Field(default=None, gt=0, description="[m] of both axles, and between the steering axes")
    wheel_radius: Length | None = Field(default=None, gt=0, description="[m] of all wheels, when rolling")


class VelocityServo(Schema):
    """Torque = gain x (wanted - measured wheel speed), solved implicitly by Drake.

    With an open differential, wanted and measured speed are the means of an axle's two wheels, so that both wheels get
    the same torque and the drive makes no yaw moment.
    """

    kind: Literal["servo"]
    gain: float = Field(gt=0, description="[N m s/rad] per wheel")
    differential: Literal["none", "open"] = Field(
        default="none", description="none: a motor and a set-point per wheel; open: one drive per axle, equal torques"
    )


class PositionServo(Schema):
    """Torque = stiffness x angle error - damping x rate error, solved implicitly by Drake."""

    kind: Literal["servo"]
    stiffness: float = Field(gt=0, description="[N m/rad] per steered wheel")
    damping: float = Field(ge=0, description="[N m s/rad] per steered wheel")


class GainSchedule(Schema):
    """Gains over the measured speed of the car, forward or backward: straight lines between the speeds, held beyond."""

    speeds: list[Annotated[Speed, Field(ge=0)]] = Field(min_length=2, description="[m/s] rising")
    kp: list[Annotated[float, Field(ge=0)]] | None = Field(default=None, description="[-] as kp of the loop")
    ki: list[Annotated[float, Field(ge=0)]] | None = Field(default=None, description="[-] as ki of the loop")
    kd: list[Annotated[float, Field(ge=0)]] | None = Field(default=None, description="[-] as kd of the loop")

    @model_validator(mode="after")
    def _fits(self) -> "GainSchedule":
        if any(not low < high for low, high in pairwise(self.speeds)):
            raise ValueError(f"speeds: must rise, got {', '.join(f'{speed:g}' for speed in self.speeds)}")
        rows = self.rows()
        if not rows:
            raise ValueError("no gain is given; write for example kp: [300, 400], one for each speed")
        for name, values in rows.items():
            if len(values) != len(self.speeds):
                raise ValueError(f"{name}: {len(self.speeds)} values are needed, one for each speed, not {len(values)}")
        return self

    def rows(self) -> dict[str, tuple[float, ...]]:
        """Values of each gain that is scheduled, by name."""
        given = {"kp": self.kp, "ki": self.ki, "kd": self.kd}
        return {name: tuple(values) for name, values in given.items() if values is not None}


class Pid(Schema):
    """Torque from a discrete PID controller; the unit of the error is rad (steering) or rad/s (wheel speed)."""

    kind: Literal["pid"]
    kp: float = Field(ge=0, description="[N m per unit]")
    ki: float = Field(default=0.0, ge=0, description="[N m per unit and s]")
    kd: float = Field(default=0.0, ge=0, description="[N m s per unit]")
    filter: Duration = Field(default=0.0, ge=0, description="[s] time constant of the derivative's low-pass")
    max_torque: Torque | None = Field(default=None, gt=0, description="[N m] limit; empty: the joint's own limit")
    max_integral: Torque | None = Field(default=None, ge=0, description="[N m] limit of the integral part alone")
    schedule: GainSchedule | None = Field(default=None, description="gains over speed, in place of those above")


class PedalControl(Schema):
    """The speed is held by throttle and brake pedal: mirdrake/controllers/pedal_control.py.

    Only with tyres that take torques, brush or magic_formula; kp, ki and max_correction of `speed` are not used.
    """

    kind: Literal["pedals"]
    kp: float = Field(default=1.5, ge=0, description="[1/s] acceleration over speed error")
    ki: float = Field(default=0.5, ge=0, description="[1/s²]")
    hold_speed: Speed = Field(default=0.3, gt=0, description="[m/s] below it a standing command presses the hold brake")
    hold_grade: float = Field(default=0.3, ge=0, description="[-] grade on which the hold brake holds, as weight share")
    schedule: GainSchedule | None = Field(default=None, description="gains over speed, in place of those above; no kd")

    @model_validator(mode="after")
    def _no_kd(self) -> "PedalControl":
        if self.schedule is not None and self.schedule.kd is not None:
            raise ValueError("schedule: pedals have no kd; leave it out")
        return self


class ControlSpec(Schema):
    """control.yaml."""

    rate: Frequency = Field(default=50.0, gt=0, le=10_000, description="[Hz] of every controller")
    dead_man: Duration = Field(default=0.2, gt=0, description="[s] without a command until zero speed is commanded")
    believes: Beliefs = Field(default_factory=Beliefs)
    speed: SpeedControl = Field(default_factory=SpeedControl)
    wheel_speed: Annotated[VelocityServo | Pid | PedalControl, Field(discriminator="kind")]
    steering: Annotated[PositionServo | Pid, Field(discriminator="kind")]

    def scheduled_gains(self) -> frozenset[str]:
        """Dotted paths of the gains that follow a schedule over speed."""
        loops = {"wheel_speed": self.wheel_speed, "steering": self.steering}
        return frozenset(
            f"{name}.{gain}"
            for name, loop in loops.items()
            if loop.kind != "servo" and loop.schedule is not None
            for gain in loop.schedule.rows()
        )


# --- variants/<name>.yaml ----------------------------------------------------------------------------------------


class VariantSpec(Schema):
    """variants/<name>.yaml: what is different from the folder's own files."""

    description: str = Field(min_length=1, description="one line")
    arguments: dict[str, str] = Field(default_factory=dict, description="of the xacro files")
    vehicle: dict[str, Any] = Field(default_factory=dict, description="laid over vehicle.yaml")
    control: dict[str, Any] = Field(default_factory=dict, description="laid over control.yaml")
    sensors: dict[str, Any] = Field(default_factory=dict, description="laid over sensors.yaml")
