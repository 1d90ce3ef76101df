"""``mirdrake drive``: drive a vehicle by hand, in a browser."""

import argparse
import math
from pathlib import Path
from typing import Any, get_args

from mirdrake.cli.common import add_set, kind_of, parse_names, positive_time, whole_number
from mirdrake.core.contacts import STUDY_CONTACT, ContactModel
from mirdrake.core.errors import ConfigError
from mirdrake.core.json_io import Json
from mirdrake.core.yaml_io import display_path

MORE = """\
Open the address in a browser. Arrow keys or W A S D, a game pad or sliders drive the vehicle; space stops it. The views
follow the vehicle, overlays show the forces on it and the points of its lidars, and gains can be changed while driving.
The button "Record" writes a run folder. The vehicle brakes to a stop when the page is closed or hidden. Ctrl-C ends.

examples:
  mirdrake drive bolt                           on the test track
  mirdrake drive mkz parking_lot --open         in the parking lot; opens the browser
  mirdrake drive bolt@handling test_track --contact hydroelastic
  mirdrake drive catvehicle neighbourhood --sensors none
  mirdrake drive bolt --plot 'ego.control.speed_pid.*'   with a plot of inner signals"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    parser.add_argument("vehicle", help="name or path of a vehicle; bolt@handling is a variant")
    parser.add_argument("world", nargs="?", default="test_track", help="name or path of a world (default: test_track)")
    parser.add_argument("--start", metavar="NAME", help="a start of the world (default: its first)")
    parser.add_argument(
        "--contact",
        choices=get_args(ContactModel),
        default=STUDY_CONTACT,
        help="contact of the wheels (default: %(default)s)",
    )
    parser.add_argument(
        "--sensors",
        metavar="NAMES",
        help="sensors in use, separated by commas, or none (default: lidars, laser scanners)",
    )
    parser.add_argument(
        "--plot",
        metavar="PATTERNS",
        help="inner signals that the page can plot, separated by commas, such as 'ego.control.*_pid.*'",
    )
    add_set(parser)
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder for recordings (default: runs)")
    parser.add_argument(
        "--port",
        type=whole_number(0, 65535),
        metavar="N",
        help="port on localhost (default: the first free one from 8765 on)",
    )
    parser.add_argument("--open", action="store_true", help="open the page in the browser")
    parser.add_argument("--pages", action=argparse.BooleanOptionalAction, default=True,
                        help="write recording.html and report.html of each recorded run at the end")  # fmt: skip
    parser.add_argument(
        "--duration", type=positive_time, metavar="S", help="end after this time [s], or with a unit (1 min)"
    )


def run(options: argparse.Namespace) -> int:
    """Serve the cockpit until Ctrl-C, then write the pages of the recorded runs."""
    from mirdrake.viewer.cockpit import OpenCockpit

    spec = _spec(options)
    stem = f"drive_{Path(options.vehicle).name.replace('@', '_')}"
    cockpit = OpenCockpit(spec, port=options.port, print_line=lambda text: print(text, flush=True),
                          folder=lambda: _folder(stem, options.out))  # fmt: skip
    print(f"Cockpit: {cockpit.url}  (Ctrl-C ends)", flush=True)
    if options.open:
        import webbrowser

        webbrowser.open(cockpit.url)
    # The page runs until Ctrl-C, with which the cockpit closes its log.
    with cockpit:
        cockpit.run(duration=options.duration or math.inf)
    # Pages take seconds each, so that they are written at the end.
    for recorded in cockpit.drive.runs:
        if options.pages and not recorded.signals.empty:
            _write_pages(recorded)
        print(f"recorded: {display_path(recorded.folder)}" if recorded.folder else "", flush=True)
    return 0


def _spec(options: argparse.Namespace) -> Any:
    """Return the spec of the diagram to drive."""
    from mirdrake.vehicles import load_vehicle
    from mirdrake.viewer.cockpit import drive_spec

    # The order of the arguments is a frequent mistake, so that the kinds are checked.
    for kind, name in (("models", options.vehicle), ("worlds", options.world)):
        if kind_of(name) != kind:
            expected = {"models": "a vehicle", "worlds": "a world"}[kind]
            raise ConfigError(f"'{name}' is not {expected}; usage: mirdrake drive VEHICLE [WORLD]")
    mounts = load_vehicle(options.vehicle).sensors.mounts
    # Cameras cost more time than a frame of the cockpit has: only ranging sensors are on by default.
    if options.sensors is None:
        sensors = [name for name, mount in mounts.items() if mount.kind in {"lidar", "laser_scanner"}]
    else:
        sensors = parse_names(options.sensors)
    entry: Json = {"model": options.vehicle}
    if options.start is not None:
        entry["start"] = options.start
    data = {
        "name": "drive",
        "world": options.world,
        "vehicles": {"ego": entry},
        "sensors": {"ego": sensors} if sensors else {},
        "plant": {"contact": options.contact},
        "record": {"signals": parse_names(options.plot)} if options.plot else {},
    }
    return drive_spec(data, overrides=options.set)


def _folder(stem: str, base: Path | None) -> Path:
    """Return a new folder for a recording."""
    from mirdrake.runs.simulation import default_folder

    folder = default_folder(stem)
    return folder if base is None else base / folder.name


def _write_pages(run: Any) -> None:
    """Write the pages of a recorded run, which open offline."""
    from mirdrake.report import write_report
    from mirdrake.viewer import write_recording

    print(f"writing recording.html and report.html of {display_path(run.folder)}", flush=True)
    write_recording(run, frames_per_second=run.spec["record"]["frames"])
    write_report(run, diagram_svg=None)
