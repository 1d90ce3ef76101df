"""What drives and brakes: motors, engines, gears, brakes, pedals and their actuators."""

from mirdrake.powertrain.actuator import ActuatorLaw
from mirdrake.powertrain.law import Measured, PowertrainLaw, Torques
from mirdrake.powertrain.system import PEDALS, STATUS, WHEEL_TORQUE, Powertrain

__all__ = ["PEDALS", "STATUS", "WHEEL_TORQUE", "ActuatorLaw", "Measured", "Powertrain", "PowertrainLaw", "Torques"]
