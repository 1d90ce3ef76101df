"""Checks of a world before a simulation: overlaps, support of props, starts, goals, paths, tests."""

from mirdrake.world_checks.check import Examination, check_world, examine
from mirdrake.world_checks.faults import Fault
from mirdrake.world_checks.paths import VehiclePath

__all__ = ["Examination", "Fault", "VehiclePath", "check_world", "examine"]
