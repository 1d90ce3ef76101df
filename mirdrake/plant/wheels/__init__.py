"""Wheels on the road: tyre forces, rolling resistance and friction of the ground, beside Drake's contact."""

from mirdrake.plant.wheels.ground_tyres import GroundTyres
from mirdrake.plant.wheels.road_friction import RoadFriction
from mirdrake.plant.wheels.tyre_forces import TyreSystem, WheelTyres
from mirdrake.plant.wheels.wheel_readings import WheelReadings

__all__ = ["GroundTyres", "RoadFriction", "TyreSystem", "WheelReadings", "WheelTyres"]
