"""Controllers: PID, Ackermann steering, velocity command, speed loop, path tracking and scheduled drivers.

Each law is a small function or object on plain floats, ``law(state, inputs, settings) -> (state, outputs)``; each
system is a LeafSystem around one law, usable alone in any Drake diagram. All state and all gains live in the Context.
"""

from mirdrake.controllers.ackermann import Ackermann, AckermannSteering, AxleGeometry, SteeringGeometry
from mirdrake.controllers.command import CommandLimits, CommandState, VelocityCommand, command_step
from mirdrake.controllers.cruise import SpeedControl, cruise_step, wheel_speed_setpoints
from mirdrake.controllers.drivable_line import DrivingLimits, make_centre_line, make_drivable_line, make_speed_profile
from mirdrake.controllers.drivers import DriverSpec
from mirdrake.controllers.path_tracking import PathGains, PathTracker, PathTrackingSpec
from mirdrake.controllers.pid import DiscretePid
from mirdrake.controllers.schedule import CommandSchedule, ConstantCommand, ConstantSpec, Schedule, ScheduleSpec
from mirdrake.controllers.vehicle_control import VehicleControl
from mirdrake.core.pid import PidGains, PidLimits, PidState, pid_step

__all__ = [
    "Ackermann",
    "AckermannSteering",
    "AxleGeometry",
    "CommandLimits",
    "CommandSchedule",
    "CommandState",
    "ConstantCommand",
    "ConstantSpec",
    "DiscretePid",
    "DriverSpec",
    "DrivingLimits",
    "PathGains",
    "PathTracker",
    "PathTrackingSpec",
    "PidGains",
    "PidLimits",
    "PidState",
    "Schedule",
    "ScheduleSpec",
    "SpeedControl",
    "SteeringGeometry",
    "VehicleControl",
    "VelocityCommand",
    "command_step",
    "cruise_step",
    "make_centre_line",
    "make_drivable_line",
    "make_speed_profile",
    "pid_step",
    "wheel_speed_setpoints",
]
