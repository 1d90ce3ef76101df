"""``mirdrake drive``: drive a vehicle by hand, in a browser."""

import argparse
import math
from pathlib import Path
from typing import Any

from mirdrake.cli.verb import add_set, kind_of
from mirdrake.core.errors import ConfigError
from mirdrake.core.yaml_io import shown

HELP = "drive a vehicle by hand in real time, in a browser"
MORE = """\
Open the address in a browser: arrow keys or W A S D drive, space stops, a game pad and sliders do as well. Views follow
the vehicle, overlays show what acts on it and what its lidars see, gains can be changed while driving. The button
"Record" writes a run folder. When the page is closed or hidden the vehicle brakes to a stand. Ctrl-C ends the drive.

examples:
  mirdrake drive bolt                           on the test track
  mirdrake drive mkz parking_lot --open         opens the browser, too
  mirdrake drive bolt@handling test_track --contact hydroelastic
  mirdrake drive catvehicle neighbourhood --sensors none"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The verb's arguments."""
    parser.add_argument("vehicle", help="name or path of a vehicle, with @ and a variant behind it if you like")
    parser.add_argument("world", nargs="?", default="test_track", help="name or path of a world (default: test_track)")
    parser.add_argument("--start", metavar="NAME", help="a start of the world (default: its first)")
    parser.add_argument("--contact", choices=("point", "hydroelastic"), default="point", help="(default: point)")
    parser.add_argument(
        "--sensors", metavar="NAMES", help="sensors in use, commas between, or none (default: lidars, laser scanners)"
    )
    add_set(parser)
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder for recordings (default: runs)")
    parser.add_argument("--port", type=int, help="of localhost (default: the first free one from 8765 on)")
    parser.add_argument("--open", action="store_true", help="open the page in the browser")
    parser.add_argument("--pages", action=argparse.BooleanOptionalAction, default=True,
                        help="write recording.html and report.html of what was recorded, at the end")  # fmt: skip
    parser.add_argument("--duration", type=float, metavar="S", help="end by itself after so long")


def run(options: argparse.Namespace) -> int:
    """Drive."""
    from mirdrake.viewer.cockpit import OpenCockpit

    for option in ("duration", "port"):
        value = getattr(options, option)
        if value is not None and not (math.isfinite(value) and value >= (1e-3 if option == "duration" else 0)):
            raise ConfigError(f"--{option} {value:g}: a positive number is expected")
    spec = _spec(options)
    stem = f"drive_{Path(options.vehicle).name.replace('@', '_')}"
    cockpit = OpenCockpit(spec, port=options.port, say=lambda text: print(text, flush=True),
                          folder=lambda: _folder(stem, options.out))  # fmt: skip
    print(f"Cockpit: {cockpit.url}  (Ctrl-C ends)", flush=True)
    if options.open:
        import webbrowser

        webbrowser.open(cockpit.url)
    with cockpit:
        cockpit.run(duration=options.duration or math.inf)
    for done in cockpit.drive.runs:
        if options.pages and not done.signals.empty:
            _write_pages(done)
        print(f"recorded: {shown(done.folder)}" if done.folder else "", flush=True)
    return 0


def _spec(options: argparse.Namespace) -> Any:
    """The diagram of the drive."""
    from mirdrake.vehicles import load_vehicle
    from mirdrake.viewer.cockpit import drive_spec

    for kind, name in (("models", options.vehicle), ("worlds", options.world)):
        if kind_of(name) != kind:
            wanted = {"models": "a vehicle", "worlds": "a world"}[kind]
            raise ConfigError(f"'{name}' is no name of {wanted}; usage: mirdrake drive VEHICLE [WORLD]")
    mounts = load_vehicle(options.vehicle).sensors.mounts
    if options.sensors is None:
        sensors = [name for name, mount in mounts.items() if mount.kind in {"lidar", "laser_scanner"}]
    else:
        sensors = [name.strip() for name in options.sensors.split(",") if name.strip() not in {"", "none"}]
    entry: dict[str, Any] = {"model": options.vehicle}
    if options.start is not None:
        entry["start"] = options.start
    data = {
        "name": "drive",
        "world": options.world,
        "vehicles": {"ego": entry},
        "sensors": {"ego": sensors} if sensors else {},
        "plant": {"contact": options.contact},
    }
    return drive_spec(data, overrides=options.set)


def _folder(stem: str, base: Path | None) -> Path:
    """A new folder for a recording."""
    from mirdrake.runs.simulation import default_folder

    folder = default_folder(stem)
    return folder if base is None else base / folder.name


def _write_pages(run: Any) -> None:
    """The pages of a recorded run, which open offline."""
    from mirdrake.report import write_report
    from mirdrake.viewer import write_recording

    print(f"writing recording.html and report.html of {shown(run.folder)}", flush=True)
    write_recording(run, frames_per_second=run.spec["record"]["frames"])
    write_report(run, diagram_svg=None)
