"""Checks of a world before a simulation: overlaps, support of props, starts, goals, paths, tests.

A name loads its module when it is first used: the world editor needs the overlaps only, not vehicles and controllers.
"""

from typing import TYPE_CHECKING

from mirdrake.core.deferred import defer

if TYPE_CHECKING:
    from mirdrake.world_checks.check import Examination as Examination
    from mirdrake.world_checks.check import check_world as check_world
    from mirdrake.world_checks.check import examine as examine
    from mirdrake.world_checks.faults import Fault as Fault
    from mirdrake.world_checks.paths import VehiclePath as VehiclePath

__all__ = ["Examination", "Fault", "VehiclePath", "check_world", "examine"]

__getattr__ = defer(
    __name__,
    {"Examination": "check", "Fault": "faults", "VehiclePath": "paths", "check_world": "check", "examine": "check"},
)
