"""Controllers: PID, Ackermann steering, velocity command, speed loop, path tracking and scheduled drivers.

Each law is a small function or object on plain floats, ``law(state, inputs, settings) -> (state, outputs)``; each
system is a LeafSystem around one law, usable alone in any Drake diagram. All state and all gains live in the Context.
"""

from mirdrake.controllers.ackermann import Ackermann, AckermannSteering, AxleGeometry, SteeringGeometry
from mirdrake.controllers.command import CommandLimits, CommandState, command_step
from mirdrake.controllers.control_blocks import (
    AccelerationLimit,
    DeadMan,
    Measurements,
    SpeedPid,
    SteeringActuator,
    SteeringRateLimit,
    WheelSpeeds,
)
from mirdrake.controllers.control_diagram import ControlDiagram, expand_control
from mirdrake.controllers.cruise import cruise_step, wheel_speed_setpoints
from mirdrake.controllers.drivable_line import DrivingLimits, make_centre_line, make_drivable_line, make_speed_profile
from mirdrake.controllers.drivers import DriverSpec
from mirdrake.controllers.joint_blocks import ActuatorHold, PedalLoop, SteeringLoop, WheelLoops
from mirdrake.controllers.path_tracking import PathGains, PathTracker, PathTrackingSpec
from mirdrake.controllers.pid import DiscretePid
from mirdrake.controllers.schedule import CommandSchedule, ConstantCommand, ConstantSpec, Schedule, ScheduleSpec
from mirdrake.controllers.vehicle_control import VehicleControl
from mirdrake.core.pid import PidGains, PidLimits, PidState, pid_step

__all__ = [
    "AccelerationLimit",
    "Ackermann",
    "AckermannSteering",
    "ActuatorHold",
    "AxleGeometry",
    "CommandLimits",
    "CommandSchedule",
    "CommandState",
    "ConstantCommand",
    "ConstantSpec",
    "ControlDiagram",
    "DeadMan",
    "DiscretePid",
    "DriverSpec",
    "DrivingLimits",
    "Measurements",
    "PathGains",
    "PathTracker",
    "PathTrackingSpec",
    "PedalLoop",
    "PidGains",
    "PidLimits",
    "PidState",
    "Schedule",
    "ScheduleSpec",
    "SpeedPid",
    "SteeringActuator",
    "SteeringGeometry",
    "SteeringLoop",
    "SteeringRateLimit",
    "VehicleControl",
    "WheelLoops",
    "WheelSpeeds",
    "command_step",
    "cruise_step",
    "expand_control",
    "make_centre_line",
    "make_drivable_line",
    "make_speed_profile",
    "pid_step",
    "wheel_speed_setpoints",
]
