"""Sensors: what a vehicle knows of itself and of its surroundings."""

from mirdrake.sensors.ground_truth import GroundTruth

__all__ = ["GroundTruth"]
