"""``mirdrake check``: every fault with file and line, without running."""

import argparse
import sys
from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path

from mirdrake.cli.verb import add_set, add_trust, kind_of, not_executed
from mirdrake.core.errors import MirdrakeError
from mirdrake.core.paths import find

HELP = "check diagrams, vehicles, worlds, studies and all other files of ours without running them"
MORE = """\
Every fault is one line with file and line number. Of a vehicle, all files are checked: YAML, xacro, URDF, meshes,
variants; if they are sound, whether it stands still for a second. bolt@published checks that variant alone.
A module of your own (kind: "module:Class") is executed with --trust only; without, it is left out with its connections.
Exit codes: 0 sound, 1 the files are sound but a vehicle does not stand still, 2 a file has a fault.

examples:
  mirdrake check bolt test_track my_diagram.yaml
  mirdrake check models/my_car"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The verb's arguments."""
    parser.add_argument("names", nargs="+", metavar="NAME", help="names or paths")
    add_set(parser)
    add_trust(parser)


def run(options: argparse.Namespace) -> int:
    """Check each."""
    code = 0
    for name in options.names:
        faults, failures, remarks = _check_one(name, options.set, trust=options.trust)
        for line in (*faults, *failures):
            print(f"error: {line}", file=sys.stderr)
        if not faults and not failures:
            print(f"{name}: sound")
            for line in remarks:
                print(f"  {line}")
        code = max(code, 2 if faults else 1 if failures else 0)
    return code


def _check_one(
    name: str, overrides: Sequence[str], *, trust: bool
) -> tuple[Sequence[str], Sequence[str], Sequence[str]]:
    """Check one thing; returns faults, what a vehicle fails to do, and remarks that are neither."""
    from mirdrake.assembly.diagram import assemble, load_diagram
    from mirdrake.assembly.diagram_spec import without_user_systems
    from mirdrake.core.user_modules import without_own_code
    from mirdrake.schemas import check_file
    from mirdrake.world_checks import check_world

    skipped: list[str] = []
    try:
        kind = "models" if _holds_vehicle(Path(name)) else kind_of(name)
        if kind == "models":
            from mirdrake.cli.checking import check_vehicle

            found = check_vehicle(name)
            return found.faults, found.failures, found.remarks
        if kind == "worlds":
            return [fault.text for fault in check_world(name, overrides=overrides)], (), ()
        if kind in {"studies", "files"}:
            with nullcontext(skipped) if trust else without_own_code() as skipped:
                check_file(find("studies", name) if kind == "studies" else Path(name), overrides=overrides)
            return (), (), not_executed(skipped)
        spec = load_diagram(str(Path(name) / "spec.yaml") if kind == "runs" else name, overrides=overrides)
        if not trust:
            spec, skipped = without_user_systems(spec)
        with nullcontext() if trust else without_own_code():
            assembly = assemble(spec)
        unread = [] if skipped else [f"output '{port}' is not read" for port in assembly.unread]
        return (), (), [*unread, *not_executed(skipped)]
    except MirdrakeError as error:
        return str(error).splitlines(), (), ()


def _holds_vehicle(path: Path) -> bool:
    """Whether a path leads to a vehicle folder, if only to a part of one, or to one of its files."""
    from mirdrake.vehicles.vehicle import FILES

    folder = path.parent if path.name in FILES else path
    return any((folder / name).is_file() for name in FILES) and path.exists()
