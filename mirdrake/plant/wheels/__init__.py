"""Wheels on the road: tyre forces, rolling resistance and friction of the ground, beside Drake's contact."""

from mirdrake.plant.wheels.ground_tyres import GroundReadings, GroundTyres
from mirdrake.plant.wheels.road_friction import RoadFriction
from mirdrake.plant.wheels.rolling_resistance import LOAD_PERIOD, RollingResistance, RollingWheel, make_rolling_wheels
from mirdrake.plant.wheels.tyre_forces import WheelTyres, make_wheel_tyres

__all__ = [
    "LOAD_PERIOD",
    "GroundReadings",
    "GroundTyres",
    "RoadFriction",
    "RollingResistance",
    "RollingWheel",
    "WheelTyres",
    "make_rolling_wheels",
    "make_wheel_tyres",
]
