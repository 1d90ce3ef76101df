"""``mirdrake import``: files of other simulators into mirdrake's own."""

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from mirdrake.cli.common import parse_pairs, positive_time
from mirdrake.core.json_io import Json
from mirdrake.core.wording import plural
from mirdrake.core.yaml_io import display_path, shortest_name

if TYPE_CHECKING:
    from mirdrake.importing.vehicles import ImportPlan, ImportResult

MORE = """\
Finds the packages around the file, recognises wheels, steering and drive from the kinematics, converts meshes and
corrects impossible values. The README.md of the new folder lists what was changed, and why.

examples:
  mirdrake import vehicle my_car_description/urdf/my_car.urdf.xacro
  mirdrake import vehicle my_car_description/urdf/my_car.urdf.xacro --dry-run
  mirdrake import vehicle buggy/model.sdf --name buggy --drive rear
  mirdrake import vehicle car.xacro --package car_meshes=../car_meshes --argument camera=false"""


PORTRAIT_TIME = 120.0
"""Time after which drawing a picture of the vehicle is given up [s]."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    parser.add_argument("what", choices=["vehicle"], help="what the file describes")
    parser.add_argument("file", type=Path, help=".urdf, .xacro, .sdf, or the folder of a package or model")
    parser.add_argument("--name", help="name of the vehicle (default: that of the model)")
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder of the new vehicle (default: models)")
    parser.add_argument("--package", action="append", default=[], metavar="NAME=DIR", help="folder of a ROS package")
    parser.add_argument(
        "--argument",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="a xacro argument; relative paths are relative to the working directory",
    )
    parser.add_argument("--drive", choices=["front", "rear", "all"], help="driven axle, if the files do not state it")
    parser.add_argument(
        "--dry-run", action="store_true", help="only report what would be changed or rejected; writes nothing"
    )
    parser.add_argument(
        "--convex-time",
        type=positive_time,
        default=60.0,
        metavar="S",
        help="time limit of convex decomposition [s]; the remaining collision meshes become convex hulls (default: 60)",
    )
    parser.add_argument("--force", action="store_true", help="replace a folder of that name")


def run(options: argparse.Namespace) -> int:
    """Import the vehicle, or print the plan; ask for missing xacro arguments in a terminal."""
    from mirdrake.importing.vehicles import import_vehicle, plan_import
    from mirdrake.vehicles.xacro_render import MissingArgumentsError

    packages = {name: Path(value) for name, value in parse_pairs("--package", options.package).items()}
    arguments = parse_pairs("--argument", options.argument)
    # Progress lines only in a terminal: logs of build servers stay short.
    progress = (lambda text: print(f"  {text} ...", file=sys.stderr)) if sys.stderr.isatty() else None
    # Arguments without default are asked for one after another, as each may lead to further ones.
    while True:
        try:
            given: Json = {
                "name": options.name,
                "folder": options.out,
                "packages": packages,
                "arguments": arguments,
                "drive": options.drive,
                "force": options.force,
                "progress": progress,
            }
            # Both calls take the same arguments, so that a dry run shows what an import would do.
            if options.dry_run:
                _print_plan(plan_import(options.file, **given))
            else:
                _print_result(
                    import_vehicle(options.file, **given, convex_time=options.convex_time, finish=_add_portrait)
                )
        except MissingArgumentsError as error:
            if not sys.stdin.isatty():
                raise
            for name, location in error.arguments.items():
                arguments[name] = input(f"{location}: value of the xacro argument {name}: ")
        else:
            return 0


def _add_portrait(folder: Path) -> None:
    """Show a picture of the vehicle in its README.md; a note if it cannot be drawn."""
    from mirdrake.importing.vehicles.check import run_module

    code, words = run_module("mirdrake.viewer.portrait", folder, seconds=PORTRAIT_TIME)
    if code != 0:
        reason = words or ("the renderer crashed" if code is not None else f"not drawn within {PORTRAIT_TIME:g} s")
        print(f"note: README.md has no picture of the vehicle: {reason}", file=sys.stderr)


def _radii(radii: tuple[float, float]) -> str:
    front, rear = (f"{radius:.3f}" for radius in radii)
    return f"wheel radius {front} m" if front == rear else f"wheel radii {front} and {rear} m"


def _print_result(result: "ImportResult") -> None:
    from mirdrake.importing.changes import Code, count_changes

    for warning in result.warnings:
        print(f"warning: {warning}")
    geometry, name = result.vehicle.geometry, shortest_name("models", result.folder)
    print(f"{display_path(result.folder)}/")
    print(
        f"  wheelbase {geometry.wheelbase:.3f} m, track {geometry.front_track:.3f} and {geometry.rear_track:.3f} m, "
        f"{_radii((geometry.front_wheel_radius, geometry.rear_wheel_radius))}, {result.vehicle.spec.drive} drive"
    )
    print(f"  {count_changes(result.changes)}; all changes are listed in {display_path(result.folder / 'README.md')}")
    for assumption in result.assumptions:
        print(f"  please check: {assumption}")
    # The README has all changes; only those that change what the vehicle does are printed.
    for change in result.changes:
        if change.code in (Code.SENSOR, Code.SUSPENSION, Code.UNUSUAL):
            print(f"  {change.sentence}")
    print(f"next: mirdrake view {name}; mirdrake inspect {name}")


def _print_plan(plan: "ImportPlan") -> None:
    from mirdrake.importing.changes import count_changes

    layout = plan.car.layout
    if plan.obstacle:
        print(f"warning: {plan.obstacle}")
    for warning in plan.car.warnings:
        print(f"warning: {warning}")
    print(f"{display_path(plan.folder)}/ would be written")
    print(
        f"  wheelbase {layout.wheelbase:.3f} m, track {layout.tracks[0]:.3f} and {layout.tracks[1]:.3f} m, "
        f"{_radii(layout.radii)}, {plan.car.drive} drive, {plural(len(plan.car.mounts), 'sensor')}"
    )
    print(f"  {count_changes(plan.changes)}; meshes are only converted and checked by the import itself")
    for change in plan.changes:
        location = f"{change.place}: " if change.place else ""
        print(f"  {location}{change.sentence}")
