"""The YAML files of a vehicle folder: vehicle.yaml, control.yaml and variants; sensors.yaml is in mounts.py.

They hold what a URDF has no words for: which joint is which wheel, what drives and brakes, gains.
Dimensions and masses are not repeated here; they are measured on the kinematics (:mod:`mirdrake.vehicles.geometry`).
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from pydantic import Field

from mirdrake.core.errors import did_you_mean
from mirdrake.core.yaml_io import Acceleration, Angle, AngularRate, Duration, Frequency, Length, Schema, Speed
from mirdrake.tyres import TyreSpec
from mirdrake.vehicles.chassis_spec import Aerodynamics, Suspension, SuspensionJoints
from mirdrake.vehicles.joint_control import JointControl, SteeringControl, WheelSpeedControl
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


@dataclass(frozen=True)
class RuntimeGain:
    """A gain that may change while a simulation runs.

    Attributes:
        path: dotted path in control.yaml.
        unit: unit of the gain.
        value: value in control.yaml.
        group: number of the numeric parameter of :class:`~mirdrake.controllers.VehicleControl` that holds it.
        index: element of that parameter.
    """

    path: str
    unit: str
    value: float
    group: int
    index: int


class ControlSpec(Schema):
    """control.yaml."""

    rate: Frequency = Field(default=50.0, gt=0, le=10_000, description="[Hz] of every controller")
    dead_man: Duration = Field(default=0.2, gt=0, description="[s] without a command until zero speed is commanded")
    believes: Beliefs = Field(default_factory=Beliefs)
    speed: SpeedControl = Field(default_factory=SpeedControl)
    wheel_speed: Annotated[WheelSpeedControl, Field(discriminator="kind")]
    steering: Annotated[SteeringControl, Field(discriminator="kind")]

    def gains(self) -> list["RuntimeGain"]:
        """Return the gains that may change while a simulation runs, in the order of the control unit's parameters.

        Two sorts of gains are not part of it: those of Drake's servos, which are fixed once the plant is built, and
        those that follow a schedule over speed. Pedals replace the speed loop.
        """
        speed = () if self.wheel_speed.uses_pedals else (("kp", "1"), ("ki", "1/s"))
        result = [
            RuntimeGain(f"speed.{name}", unit, getattr(self.speed, name), 0, ("kp", "ki").index(name))
            for name, unit in speed
        ]
        loops: dict[str, JointControl] = {"wheel_speed": self.wheel_speed, "steering": self.steering}
        for group, (section, loop) in enumerate(loops.items(), start=1):
            schedule = loop.gain_schedule()
            scheduled = {} if schedule is None else schedule.rows()
            for index, (name, unit) in enumerate(loop.gains.items()):
                if name not in scheduled:
                    result.append(RuntimeGain(f"{section}.{name}", unit, getattr(loop, name), group, index))
        return result


# --- variants/<name>.yaml ----------------------------------------------------------------------------------------


class VariantSpec(Schema):
    """variants/<name>.yaml: what is different from the folder's own files."""

    description: str = Field(min_length=1, description="one line")
    arguments: dict[str, str] = Field(default_factory=dict, description="of the xacro files")
    vehicle: dict[str, Any] = Field(default_factory=dict, description="laid over vehicle.yaml")
    control: dict[str, Any] = Field(default_factory=dict, description="laid over control.yaml")
    sensors: dict[str, Any] = Field(default_factory=dict, description="laid over sensors.yaml")
