"""Set-points of drivers against the speed limits of the control units."""

from collections.abc import Mapping

from mirdrake.assembly.diagram_spec import DiagramSpec
from mirdrake.controllers.schedule import ScheduleSpec
from mirdrake.core.yaml_io import where
from mirdrake.vehicles.vehicle import Vehicle


def limited_speeds(spec: DiagramSpec, vehicles: Mapping[str, Vehicle]) -> list[str]:
    """Return a line for each driver with a set-point of the speed that the control unit of its vehicle limits.

    The keys of a user's class have meanings of their own and are not compared.
    """
    lines = []
    for name, driver in spec.control.items():
        limit = vehicles[name].control.speed.max_speed if name in vehicles else None
        if limit is None or ":" in driver.kind:
            continue
        if isinstance(driver, ScheduleSpec):
            # A file of recorded commands is read by the run only.
            speeds = [(abs(values.speed), where(driver, "rows", row)) for row, values in enumerate(driver.rows or ())]
        else:
            speeds = [(abs(getattr(driver, "speed", None) or 0.0), where(driver, "speed"))]
        given, place = max(speeds, default=(0.0, ""))
        if given > limit:
            lines.append(
                f"{place}: the set-point is {given:g} m/s; the control unit of {name} limits it to {limit:g} m/s "
                "(speed.max_speed in control.yaml)"
            )
    return lines
