"""``mirdrake new``: write a new vehicle folder."""

import argparse
import sys
import textwrap
from pathlib import Path
from typing import get_args

from mirdrake.core.errors import ConfigError
from mirdrake.core.json_io import Json
from mirdrake.core.yaml_io import display_path, shortest_name
from mirdrake.vehicles.questions import (
    BODIES,
    QUANTITIES,
    SENSORS,
    TYRES,
    USUAL_SENSORS,
    ask,
    missing_keys,
    parse_sensors,
    parse_tyre,
)
from mirdrake.vehicles.spec import Drive

MORE = """\
Dimensions that are not given are estimated; README.md in the folder states for every number whether it was given.
Numbers are SI or have a unit: "102.4 in", "3200 lb", "35 deg". In a terminal the command asks for what is missing. It
also writes a diagram file that drives the vehicle.

example:
  mirdrake new vehicle my_car --wheelbase 2.6 --track 1.5 --mass 1450 --tyre 205/55R16 --drive front
  mirdrake new vehicle rover --wheelbase 0.6 --track 0.5 --mass 60 --wheel-radius 0.12 --sensors lidar,camera,imu"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    parser.add_argument("what", choices=["vehicle"], help="what to write")
    parser.add_argument("name", metavar="NAME", help="name of the folder: letters, digits, _")
    # Options, questions and checks come from one table of quantities.
    for quantity in QUANTITIES.values():
        metavar = "SHARE" if quantity.unit == "-" else quantity.unit.upper()
        parser.add_argument(_option(quantity.key), metavar=metavar, help=f"{quantity.text} [{quantity.unit}]")
    for key, axle in zip(TYRES, ("", " of the front axle", " of the rear axle"), strict=True):
        words = f"such as 215/50R17, instead of wheel radius and width{axle}"
        parser.add_argument(_option(key), metavar="SIZE", help=words)
    parser.add_argument("--drive", choices=get_args(Drive), help="driven axle (default: rear)")
    parser.add_argument(
        "--body", choices=BODIES, help="shape of the body, which sets length and height (default: by mass)"
    )
    parser.add_argument(
        "--sensors", metavar="LIST", help=f"of {', '.join(SENSORS)}, or none (default: {USUAL_SENSORS})"
    )
    parser.add_argument("--title", metavar="TEXT", help="make and model, for titles")
    parser.add_argument(
        "--folder", type=Path, default=Path("models"), metavar="DIR", help="folder of the new vehicle (default: models)"
    )
    parser.add_argument(
        "--diagram", action=argparse.BooleanOptionalAction, default=True, help="write a diagram file (default)"
    )
    parser.add_argument("--force", action="store_true", help="replace a vehicle of that name")


def run(options: argparse.Namespace) -> int:
    """Write the vehicle."""
    from mirdrake.vehicles.scaffold import check_name, plan_vehicle, vehicle_place, write_diagram, write_vehicle

    name: str = options.name
    check_name(name)
    vehicle_place(name, folder=options.folder, force=options.force)  # before the user answers questions
    given = _given(options)
    # Questions are asked in a terminal only: a script gets an error that names the options.
    missing = missing_keys(given)
    if missing and sys.stdin.isatty():
        _print_line(f"A new vehicle, {name}. Numbers are SI or have a unit; Enter accepts the value in brackets.")
        given = ask(given, print_line=_print_line)
    elif missing:
        raise ConfigError(f"missing: {', '.join(map(_option, missing))}")
    plan = plan_vehicle(**given)
    vehicle = write_vehicle(name, plan, title=options.title, folder=options.folder, force=options.force)
    diagram = None
    if options.diagram:
        # The diagram is beside the models folder, as in the shipped library.
        beside = vehicle.resolve().parent
        folder = beside.parent / "diagrams" if beside.name == "models" else Path("diagrams")
        diagram, written = write_diagram(vehicle, folder=folder, force=options.force)

    _print_line(f"{display_path(vehicle)}/")
    estimated = plan.estimated()
    _print_line(_listed("given", [key for key in plan.listed() if key not in estimated]))
    # A list of all estimates would hide those that an option can replace.
    replaceable = [_option(key) for key in plan.listed() if key in estimated and key in QUANTITIES]
    count = sum(key in estimated for key in plan.listed())
    _print_line(f"  estimated: {count} values; README.md lists them with their sources")
    if replaceable:
        _print_line(_listed("not given", replaceable))
    if diagram is not None:
        _print_line(f"{display_path(diagram)}{'' if written else '  (exists already, unchanged)'}")
    _print_line("next:")
    if diagram is not None:
        _print_line(f"  mirdrake run {shortest_name('diagrams', diagram)}")
    _print_line(f"  mirdrake view {shortest_name('models', vehicle)}")
    return 0


def _given(options: argparse.Namespace) -> Json:
    """Return the given options, by argument of :func:`mirdrake.vehicles.scaffold.plan_vehicle`."""
    keys = [*QUANTITIES, *TYRES, "drive", "body", "sensors"]
    given = {key: value for key in keys if (value := getattr(options, key)) is not None}
    for key in TYRES:
        if key in given:
            parse_tyre(given[key], where=_option(key))
    parse_sensors(given.get("sensors", ""))
    return given


def _listed(title: str, keys: list[str]) -> str:
    words = ", ".join(key.replace("_", " ") for key in keys)
    return textwrap.fill(
        f"{title + ':':10} {words}",
        width=100,
        initial_indent="  ",
        subsequent_indent=" " * 13,
        break_on_hyphens=False,
    )


def _option(key: str) -> str:
    return f"--{key.replace('_', '-')}"


def _print_line(text: str) -> None:
    sys.stdout.write(f"{text}\n")
