"""Checks of a world before anything runs: overlaps, standing, starts, goals, ways, tests."""

from mirdrake.world_checks.check import Examination, check_world, examine
from mirdrake.world_checks.faults import Fault
from mirdrake.world_checks.ways import Way

__all__ = ["Examination", "Fault", "Way", "check_world", "examine"]
