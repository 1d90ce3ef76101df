"""Schemas of the YAML files of a vehicle folder: vehicle.yaml, control.yaml, variants; for sensors.yaml see mounts.py.

They contain what a URDF cannot express: the role of each joint, powertrain and brakes, controller gains.
Dimensions and masses are not repeated here; they are measured on the kinematics (:mod:`mirdrake.vehicles.geometry`).
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field

from mirdrake.core.errors import did_you_mean
from mirdrake.core.json_io import Json
from mirdrake.core.yaml_io import Acceleration, Angle, AngularRate, Duration, Frequency, Length, Schema, Speed
from mirdrake.tyres import TyreSpec
from mirdrake.vehicles.chassis_spec import Aerodynamics, Suspension, SuspensionJoints, WheelJoints
from mirdrake.vehicles.joint_control import JointControl, ServoGains, SteeringControl, WheelSpeedControl
from mirdrake.vehicles.powertrain_spec import Actuators, Brakes, Pedals, Powertrain, SteeringActuator

Drive = Literal["front", "rear", "all"]
WHEELS = ("front_left", "front_right", "rear_left", "rear_right")


# --- vehicle.yaml ------------------------------------------------------------------------------------------------


def _constant(value: Any) -> Any:
    """Return a single number as a table with one row."""
    return value if isinstance(value, list | tuple) else [(0.0, value)]


def _ascending(rows: list[tuple[float, float]]) -> list[tuple[float, float]]:
    if not rows or any(late[0] <= early[0] for early, late in pairwise(rows)):
        raise ValueError("needs rows (speed, ratio) with ascending speed")
    return rows


class SteeringJoints(Schema):
    """Revolute joints that steer the front wheels."""

    left: str
    right: str

    def names(self) -> tuple[str, str]:
        """Return the joint names, left first."""
        return (self.left, self.right)


class Joints(Schema):
    """Roles of the joints of the URDF."""

    wheels: WheelJoints
    steering: SteeringJoints
    suspension: SuspensionJoints | None = Field(default=None, description="null: rigid axles")


class RearSteering(Schema):
    """Steering of the rear wheels by an actuator, in a ratio to the angle of the front wheels."""

    ratio: Annotated[
        list[tuple[Annotated[Speed, Field(ge=0)], Annotated[float, Field(ge=-1, le=1)]]],
        BeforeValidator(_constant, json_schema_input_type=float | list[tuple[float | str, float]]),
        AfterValidator(_ascending),
    ] = Field(
        description="[-] angle of the rear wheels over that of the front wheels, positive in the same direction: a "
        "number, or a table over the speed [m/s]; linear between its rows"
    )
    limit: Angle = Field(default=0.1, gt=0, lt=0.8, description="[rad] largest bicycle angle of the rear axle")
    actuator: SteeringActuator = Field(default_factory=SteeringActuator, description="its dynamics")


class Steering(Schema):
    """Steering geometry: from one steering command to two wheel angles."""

    law: Literal["ackermann", "unior", "unior_printed"] = Field(
        default="ackermann", description="ackermann: exact geometry; unior, unior_printed: linkage of the Unior"
    )
    factor: float = Field(
        default=0.5, gt=0, description="[-] angle of the directly steered wheel over the input; unior laws only"
    )
    limit: Angle | None = Field(
        default=None, gt=0, lt=1.5, description="[rad] steering limit of the inner wheel; null: limit of the joints"
    )
    rate: AngularRate | None = Field(
        default=None, gt=0, description="[rad/s] steering rate limit at the road wheel; null: limit of the joints"
    )
    ratio: float = Field(default=1.0, gt=0, description="[-] steering ratio: hand-wheel angle over road-wheel angle")
    rear: RearSteering | None = Field(default=None, description="null: the rear wheels are not steered")


class VehicleSpec(Schema):
    """vehicle.yaml."""

    name: str = Field(min_length=1, description="make and model, used in titles")
    grade: Literal["A", "B", "C"] = Field(
        description="quality of the data. A: measured on the vehicle; B: published figures, the rest assumed; C: "
        "mostly assumed"
    )
    licence: str = Field(min_length=1, description="licence of the model")
    base_link: str = Field(default="base_link", description="link on the road below the centre of the rear axle")
    joints: Joints
    drive: Drive = Field(description="driven axle; also passed to xacro as the argument `drive`")
    steering: Steering
    tyres: TyreSpec
    powertrain: Powertrain
    brakes: Brakes
    aerodynamics: Aerodynamics
    suspension: Suspension | None = Field(
        default=None, description="springs and dampers of the joints under joints.suspension"
    )
    pedals: Pedals = Field(default_factory=Pedals)
    actuators: Actuators = Field(default_factory=Actuators)
    sources: dict[str, str] = Field(
        default_factory=dict, description="dotted path of a number in this file -> its source, or why it is assumed"
    )

    def driven_wheels(self) -> tuple[str, ...]:
        """Return the names of the driven wheels, in the order of :data:`WHEELS`."""
        return {"front": WHEELS[:2], "rear": WHEELS[2:], "all": WHEELS}[self.drive]

    def numbers_without_source(self) -> list[str]:
        """Return the dotted paths of the numbers in this file without an entry in `sources`."""
        return [path for path in _number_paths(self) if path not in self.sources]

    def sources_without_number(self) -> list[str]:
        """Return a message for each entry of `sources` that does not match a number in this file."""
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
    """Outer speed loop: a PI controller that corrects the set-point of the wheel speed."""

    kp: float = Field(default=0.5, ge=0, description="[-] proportional gain: correction over speed error")
    ki: float = Field(default=0.5, ge=0, description="[1/s] integral gain")
    max_correction: Speed = Field(
        default=2.0, ge=0, description="[m/s] limit of the correction and of its integral part"
    )
    max_speed: Speed | None = Field(
        default=None, gt=0, description="[m/s] largest speed set-point, forward and in reverse; null: no limit"
    )
    max_acceleration: Acceleration = Field(
        default=3.0, gt=0, description="[m/s²] largest slope of the speed set-point when accelerating"
    )
    max_deceleration: Acceleration = Field(
        default=5.0, gt=0, description="[m/s²] largest slope of the speed set-point when decelerating"
    )


class AssumedGeometry(Schema):
    """Dimensions that the controllers assume; null: those of the model."""

    wheelbase: Length | None = Field(default=None, gt=0, description="[m] assumed wheelbase")
    track: Length | None = Field(
        default=None, gt=0, description="[m] assumed track of both axles, and distance of the steering axes"
    )
    wheel_radius: Length | None = Field(default=None, gt=0, description="[m] assumed rolling radius of all wheels")


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


ControlBlockName = Literal[
    "dead_man",
    "acceleration_limit",
    "steering_rate_limit",
    "steering_actuator",
    "ackermann",
    "speed_pid",
    "wheel_loops",
    "left_steering_loop",
    "right_steering_loop",
]
"""Blocks of the control unit that `disable` may name."""

STEERING_LOOPS: tuple[ControlBlockName, ControlBlockName] = ("left_steering_loop", "right_steering_loop")
JOINT_LOOPS: tuple[ControlBlockName, ...] = ("wheel_loops", *STEERING_LOOPS)
"""Blocks that Drake's servos belong to."""


class ControlSpec(Schema):
    """control.yaml."""

    rate: Frequency = Field(default=50.0, gt=0, le=10_000, description="[Hz] sampling rate of all controllers")
    dead_man: Duration = Field(
        default=0.2, gt=0, description="[s] watchdog timeout: without a command for this time, zero speed is commanded"
    )
    assumed: AssumedGeometry = Field(default_factory=AssumedGeometry)
    speed: SpeedControl = Field(default_factory=SpeedControl)
    wheel_speed: Annotated[WheelSpeedControl, Field(discriminator="kind")]
    steering: Annotated[SteeringControl, Field(discriminator="kind")]
    disable: list[ControlBlockName] = Field(
        default_factory=list, description="blocks that are left out; a diagram connects what they gave [-]"
    )

    def disabled_blocks(self) -> list[str]:
        """Return the blocks of the control unit that are left out: `disable`, and joint loops of kind external."""
        steering = dict.fromkeys(STEERING_LOOPS, self.steering)
        joints: dict[ControlBlockName, JointControl] = {"wheel_loops": self.wheel_speed, **steering}
        return [*self.disable, *(name for name, loop in joints.items() if loop.is_external)]

    def wheel_servo(self) -> ServoGains | None:
        """Return the gains of Drake's servos of the wheels; None: they have none."""
        return None if "wheel_loops" in self.disable else self.wheel_speed.servo_gains()

    def steering_servos(self) -> list[ServoGains | None]:
        """Return the gains of Drake's servo of the left and right steering joint; None: the joint has none."""
        return [None if name in self.disable else self.steering.servo_gains() for name in STEERING_LOOPS]

    def gains(self) -> list["RuntimeGain"]:
        """Return the gains that may change while a simulation runs, in the order of the control unit's parameters.

        Two sorts of gains are not part of it: those of Drake's servos, which are fixed once the plant is built, and
        those that follow a schedule over speed. Pedals replace the speed loop.
        """
        # With pedals there is no speed loop in the control unit.
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
                # Scheduled gains follow the table, so that they cannot be changed on their own.
                if name not in scheduled:
                    result.append(RuntimeGain(f"{section}.{name}", unit, getattr(loop, name), group, index))
        return result


# --- variants/<name>.yaml ----------------------------------------------------------------------------------------


class VariantSpec(Schema):
    """variants/<name>.yaml: the differences from the files of the folder."""

    description: str = Field(min_length=1, description="one line")
    base: str | None = Field(default=None, description="variant of the same folder, whose differences come first")
    arguments: dict[str, str] = Field(default_factory=dict, description="arguments of the xacro files")
    vehicle: Json = Field(default_factory=dict, description="merged over vehicle.yaml")
    control: Json = Field(default_factory=dict, description="merged over control.yaml")
    sensors: Json = Field(default_factory=dict, description="merged over sensors.yaml")
