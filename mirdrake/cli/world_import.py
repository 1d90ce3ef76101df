"""``mirdrake world import``: worlds of Gazebo as world files."""

import argparse
import sys
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

from mirdrake.core.errors import ConfigError
from mirdrake.core.yaml_io import shown

if TYPE_CHECKING:
    from mirdrake.importing.worlds import WorldImport

HELP = "make a world file from a .world or .sdf file of Gazebo"
MORE = """\
Models are looked for in the folders around the file, on Gazebo's search paths (such as GZ_SIM_RESOURCE_PATH) and in the
local cache of Fuel. Well-known ones that are not there, such as cones, barriers and cars, become props of mirdrake.
Roads become tracks and patches of the ground, with a start on them. NAME.md beside the new world lists what was changed
or left out, why, and what `mirdrake world check` finds in it.

examples:
  mirdrake world import old.world
  mirdrake world import parking.sdf --name lot --package my_models=../my_models
  mirdrake world import city.world --strict"""

_MOST_LINES = 30


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The verb's arguments."""
    parser.add_argument("file", type=Path, help=".world or .sdf with a <world>")
    parser.add_argument("--name", help="of the new world (default: that of the source)")
    parser.add_argument("--folder", type=Path, metavar="DIR", help="where it goes (default: worlds)")
    parser.add_argument("--package", action="append", default=[], metavar="NAME=DIR", help="where a model lies")
    parser.add_argument("--strict", action="store_true", help="refuse if something that could be touched is lost")
    parser.add_argument("--force", action="store_true", help="replace a world of that name")


def run(options: argparse.Namespace) -> int:
    """Import."""
    from mirdrake.importing.worlds import import_world

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
    """``NAME=DIR`` texts as a mapping."""
    packages = {}
    for text in texts:
        name, mark, folder = text.partition("=")
        if not mark or not name:
            raise ConfigError(f"--package {text}: expected NAME=DIR")
        if not Path(folder).is_dir():
            raise ConfigError(f"--package {text}: no such folder; give that of the model or package")
        packages[name] = Path(folder)
    return packages


def _print_result(result: "WorldImport") -> None:
    print(shown(result.path))
    print(f"  {result.entries} entries")
    for line in result.checks:
        print(f"  check: {line}")
    rows = Counter((change.what, change.became, change.why) for change in result.changes)
    for (what, became, why), count in list(rows.items())[:_MOST_LINES]:
        times = f" ({count} times)" if count > 1 else ""
        print(f"  {' '.join(what.split())}{times}: {became}: {' '.join(why.split())}")
    if len(rows) > _MOST_LINES:
        print(f"  … {len(rows) - _MOST_LINES} more")
    kinds = Counter("left out" if change.became == "left out" else "changed" for change in result.changes)
    counted = ", ".join(f"{count} {kind}" for kind, count in sorted(kinds.items())) or "nothing changed"
    print(f"  {counted}; every one is in {shown(result.path.with_suffix('.md'))}")
    print(f"next: mirdrake world show {shown(result.path)}")
