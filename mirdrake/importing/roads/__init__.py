"""Import of road maps, recorded tracks and traffic scenarios into world files.

::

    .xodr                 OpenDRIVE        ── opendrive.py ──────┐
    .xml <commonRoad>     CommonRoad       ── commonroad.py ─────┤
    .xosc                 OpenSCENARIO 1.x ── openscenario.py ───┼──► RoadWorld ──► <name>.yaml, <name>.md, <name>/
    .gpx, .csv lat, lon   GPS tracks       ── gps_tracks.py ─────┘

A format is a function in a module of its own and a row of :data:`FORMATS`.
"""

from collections.abc import Callable, Mapping
from pathlib import Path

from mirdrake.core.errors import ConfigError
from mirdrake.core.files import staging
from mirdrake.core.yaml_io import display_path
from mirdrake.importing.changes import Change
from mirdrake.importing.places import Places, without_folder
from mirdrake.importing.roads.commonroad import read_commonroad_world
from mirdrake.importing.roads.gps_tracks import read_gps_world
from mirdrake.importing.roads.opendrive import read_opendrive_world
from mirdrake.importing.roads.openscenario import read_scenario_world
from mirdrake.importing.roads.road_world import RoadWorld
from mirdrake.importing.target import check_target, load_imported, plain_name
from mirdrake.importing.worlds import WorldImport
from mirdrake.importing.worlds.text import report_text
from mirdrake.vehicles.scaffold import check_name
from mirdrake.world_checks import check_world

__all__ = ["FORMATS", "import_road_world", "is_road_file"]

FORMATS: Mapping[str, Callable[[Path, str], RoadWorld]] = {
    ".xodr": read_opendrive_world,
    ".xml": read_commonroad_world,
    ".xosc": read_scenario_world,
    ".gpx": read_gps_world,
    ".csv": read_gps_world,
}
"""Readers by the suffix of the file; each takes the file and the name of the new world."""

_MADE = {"map.xodr", "map.xml", "track.csv", "recorded"}  # files and folders that these readers make


def is_road_file(path: Path) -> bool:
    """Return whether the suffix of a file is that of a road map, a track or a scenario."""
    return path.suffix.lower() in FORMATS


def import_road_world(
    path: Path | str, *, name: str | None = None, folder: Path | str | None = None, force: bool = False
) -> WorldImport:
    """Make a world file from a road map, a recorded track or a scenario.

    Writes ``<name>.yaml``, the report ``<name>.md``, and ``<name>/`` with the map and recorded data: all or nothing.

    Args:
        path: the file; its suffix selects the format.
        name: name of the world; that of the file if left out.
        folder: folder of the result; ``worlds`` in the working directory if left out.
        force: replace a world of that name.

    Raises:
        ConfigError: the file has faults, or name or place are not allowed.
        ModelError: the world that results cannot be loaded.
    """
    source = Path(path)
    if not source.is_file():
        raise ConfigError("no such file", where=display_path(source))
    if name is not None:
        check_name(name)
    name = name or plain_name(source.stem)
    # Name and target are checked before the map is read, which may take long.
    target = Path(folder or "worlds")
    replaced = check_target(target, name, force=force, made=_MADE)
    made = FORMATS[source.suffix.lower()](source, name)
    places = Places(source)
    with staging(target) as stage:
        result = _write(made, name, stage.path, places, source)
        stage.publish(replaced)
    return WorldImport(target / f"{name}.yaml", *result)


def _write(
    made: RoadWorld, name: str, building: Path, places: Places, source: Path
) -> tuple[str, tuple[Change, ...], tuple[str, ...], int]:
    """Write a world and its report; return its text, changes, checks and number of entries."""
    for file, content in made.files.items():
        path = building / name / file
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    world_file = building / f"{name}.yaml"
    text = f"# Imported from {places.file(source)}; {name}.md lists what was changed or left out.\n{made.text}"
    world_file.write_text(text, encoding="utf-8")

    # Faults of the imported world are for the user to check: the import itself succeeded.
    faults = check_world(load_imported(world_file, source), vehicle=None, first_steps=False)
    checks = (*made.checks, *(f"world check: {without_folder(fault.text, building)}" for fault in faults))
    changes = tuple(dict.fromkeys(map(places.change, made.changes)))
    report = report_text(name, files=made.sources, entries=[], changes=changes, places=places, checks=checks)
    (building / f"{name}.md").write_text(report, encoding="utf-8")
    return text, changes, checks, made.entries
