"""Powertrain: motors, engines, gears, brakes, pedals and their actuators."""

from mirdrake.plant.powertrain.actuator import ActuatorLaw
from mirdrake.plant.powertrain.battery import BatteryPack
from mirdrake.plant.powertrain.differential import DifferentialCoupling
from mirdrake.plant.powertrain.law import Measured, PowertrainLaw, Torques
from mirdrake.plant.powertrain.system import PEDALS, STATUS, WHEEL_TORQUE, Powertrain

__all__ = [
    "PEDALS",
    "STATUS",
    "WHEEL_TORQUE",
    "ActuatorLaw",
    "BatteryPack",
    "DifferentialCoupling",
    "Measured",
    "Powertrain",
    "PowertrainLaw",
    "Torques",
]
