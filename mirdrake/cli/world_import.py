"""``mirdrake world import``: worlds of Gazebo, road maps, scenarios and GPS tracks as world files."""

import argparse
import sys
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

from mirdrake.cli.common import parse_pairs
from mirdrake.core.errors import ConfigError
from mirdrake.core.yaml_io import display_path

if TYPE_CHECKING:
    from mirdrake.importing.worlds import WorldImport

MORE = """\
The suffix selects the format: .world and .sdf are worlds of Gazebo, .xodr OpenDRIVE maps, .xml CommonRoad scenarios,
.xosc OpenSCENARIO 1.x, .gpx and .csv (lat, lon) recorded tracks. Maps become the network of the world.
Models are searched for in the folders around the file, on Gazebo's search paths (such as GZ_SIM_RESOURCE_PATH) and in
the local cache of Fuel. Well-known models that are missing, such as cones, barriers and cars, become props of mirdrake.
Roads become tracks and patches of the ground, with a start on them. NAME.md beside the new world lists what was changed
or left out, the reasons, and the findings of `mirdrake world check`.

examples:
  mirdrake world import old.world
  mirdrake world import parking.sdf --name lot --package my_models=../my_models
  mirdrake world import city.world --strict
  mirdrake world import town.xodr
  mirdrake world import cut_in.xosc --name cut_in
  mirdrake world import lap.gpx"""

_MOST_LINES = 30


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    parser.add_argument("file", type=Path, help=".world or .sdf with a <world>, .xodr, .xml, .xosc, .gpx or .csv")
    parser.add_argument("--name", help="name of the new world (default: that of the source)")
    parser.add_argument("--folder", type=Path, metavar="DIR", help="folder of the new world (default: worlds)")
    parser.add_argument("--package", action="append", default=[], metavar="NAME=DIR", help="folder of a model")
    parser.add_argument("--strict", action="store_true", help="reject losses of collision geometry")
    parser.add_argument("--force", action="store_true", help="replace a world of that name")


def run(options: argparse.Namespace) -> int:
    """Import the world and print the result."""
    from mirdrake.importing.roads import import_road_world, is_road_file
    from mirdrake.importing.worlds import import_world

    # Road files (OpenDRIVE, CommonRoad, OpenSCENARIO, GPX) have no models to convert.
    if is_road_file(options.file):
        made = import_road_world(options.file, name=options.name, folder=options.folder, force=options.force)
        _print_result(made)
        return 0
    progress = (lambda text: print(f"  {text} ...", file=sys.stderr)) if sys.stderr.isatty() else None
    result = import_world(
        options.file,
        name=options.name,
        folder=options.folder,
        packages=_packages(options.package),
        strict=options.strict,
        force=options.force,
        progress=progress,
    )
    _print_result(result)
    return 0


def _packages(texts: list[str]) -> dict[str, Path]:
    packages = {name: Path(folder) for name, folder in parse_pairs("--package", texts).items()}
    for name, folder in packages.items():
        if not folder.is_dir():
            raise ConfigError(f"--package {name}={folder}: no such folder; give that of the model or package")
    return packages


def _print_result(result: "WorldImport") -> None:
    from mirdrake.importing.changes import count_changes

    print(display_path(result.path))
    print(f"  {result.entries} entries")
    for line in result.checks:
        print(f"  check: {line}")
    # A world repeats models, and each repeats its changes: equal lines are counted.
    rows = Counter((change.part, change.new_text, change.reason) for change in result.changes)
    for (part, new, reason), count in list(rows.items())[:_MOST_LINES]:
        times = f" ({count} times)" if count > 1 else ""
        print(f"  {' '.join(part.split())}{times}: {new}: {' '.join(reason.split())}")
    if len(rows) > _MOST_LINES:
        print(f"  … {len(rows) - _MOST_LINES} more")
    counted = count_changes(result.changes)
    print(f"  {counted}; all changes are listed in {display_path(result.path.with_suffix('.md'))}")
    print(f"next: mirdrake world show {display_path(result.path)}")
