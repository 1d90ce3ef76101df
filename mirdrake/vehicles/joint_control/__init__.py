"""Kinds of joint control: what drives the wheels, and what turns the steering joints.

A new kind is one subclass of :class:`~mirdrake.vehicles.joint_control.base.JointControl` in a file of this folder, and
its name in :data:`WheelSpeedControl` or :data:`SteeringControl`. These two unions are the only lists of the kinds.
"""

from typing import get_args

from mirdrake.vehicles.joint_control.base import JointControl, PedalController, PedalPositions, ServoGains
from mirdrake.vehicles.joint_control.external import External
from mirdrake.vehicles.joint_control.gain_schedule import GainSchedule, GainTable
from mirdrake.vehicles.joint_control.pedals import PedalControl
from mirdrake.vehicles.joint_control.pid import SteeringPid, WheelPid
from mirdrake.vehicles.joint_control.servo import PositionServo, VelocityServo

__all__ = [
    "JOINT_CONTROLS",
    "External",
    "GainSchedule",
    "GainTable",
    "JointControl",
    "PedalControl",
    "PedalController",
    "PedalPositions",
    "PositionServo",
    "ServoGains",
    "SteeringControl",
    "SteeringPid",
    "VelocityServo",
    "WheelPid",
    "WheelSpeedControl",
]

WheelSpeedControl = (
    VelocityServo
    | WheelPid
    | PedalControl
    | External
)  # fmt: skip
"""Kinds of ``wheel_speed`` in control.yaml."""

SteeringControl = (
    PositionServo
    | SteeringPid
    | External
)  # fmt: skip
"""Kinds of ``steering`` in control.yaml."""

JOINT_CONTROLS: dict[str, dict[str, type[JointControl]]] = {
    section: {get_args(member.model_fields["kind"].annotation)[0]: member for member in get_args(union)}
    for section, union in (("wheel_speed", WheelSpeedControl), ("steering", SteeringControl))
}
"""Class of each kind, by section of control.yaml and by its name there."""
