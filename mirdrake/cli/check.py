"""``mirdrake check``: reports faults of files with their lines, without a simulation."""

import argparse
import sys
from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path

from mirdrake.cli.common import add_set, add_trust, kind_of, skipped_lines
from mirdrake.core.errors import MirdrakeError
from mirdrake.core.paths import find

MORE = """\
Every fault is one line with file and line number. All files of a vehicle are checked: YAML, xacro, URDF, meshes and
variants. If they have no faults, a simulation checks whether the vehicle stays at rest for a second. bolt@published
checks only that variant. User modules (kind: "module:Class") are executed only with --trust. Without it they and
their connections are not checked.
Exit codes: 0 sound, 1 the files are sound but a vehicle does not stay at rest, 2 a file has a fault.

examples:
  mirdrake check bolt test_track my_diagram.yaml
  mirdrake check models/my_car"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    parser.add_argument("names", nargs="+", metavar="NAME", help="names or paths")
    add_set(parser)
    add_trust(parser)


def run(options: argparse.Namespace) -> int:
    """Check each name and print the faults."""
    code = 0
    for name in options.names:
        faults, failures, remarks = _check_name(name, options.set, trust=options.trust)
        for line in (*faults, *failures):
            print(f"error: {line}", file=sys.stderr)
        if not faults and not failures:
            print(f"{name}: sound")
            for line in remarks:
                print(f"  {line}")
        code = max(code, 2 if faults else 1 if failures else 0)
    return code


def _check_name(
    name: str, overrides: Sequence[str], *, trust: bool
) -> tuple[Sequence[str], Sequence[str], Sequence[str]]:
    """Check a name; return the faults, the failures of a vehicle at rest, and remarks."""
    from mirdrake.assembly.diagram import assemble, load_diagram
    from mirdrake.assembly.diagram_spec import without_user_systems
    from mirdrake.assembly.parts.steps import discrete_plant
    from mirdrake.assembly.speed_limits import limited_speeds
    from mirdrake.core.user_modules import without_user_code
    from mirdrake.runs.logs import load_run
    from mirdrake.schemas import check_file
    from mirdrake.world_checks import check_world

    # Code of users is run by a check only with --trust, since a check of a foreign file should be safe.
    skipped: list[str] = []
    try:
        kind = "models" if _holds_vehicle(Path(name)) else kind_of(name)
        if kind == "models":
            from mirdrake.cli.checking import check_vehicle

            findings = check_vehicle(name)
            return [str(fault) for fault in findings.faults], findings.failures, findings.remarks
        if kind == "worlds":
            return [str(fault) for fault in check_world(name, overrides=overrides)], (), ()
        if kind in {"studies", "files"}:
            with nullcontext(skipped) if trust else without_user_code() as skipped:
                check_file(find("studies", name) if kind == "studies" else Path(name), overrides=overrides)
            return (), (), skipped_lines(skipped, "check", "checked")
        spec = load_diagram(str(Path(name) / "spec.yaml") if kind == "runs" else name, overrides=overrides)
        if not trust:
            spec, skipped = without_user_systems(spec)
        # A run is checked with the world and the vehicles that it had; overrides may name others.
        of_run = kind == "runs" and not overrides
        with nullcontext() if trust else without_user_code():
            assembly = assemble(spec, scene=load_run(name).scene() if of_run else None)
        unread = [] if skipped else [f"output '{port}' is not read" for port in assembly.unread]
        idle = [
            f"camera '{name}' takes no pictures: they are neither recorded (record.cameras: true) nor connected"
            for name in ([] if skipped else assembly.idle_cameras)
        ]
        remarks = [*limited_speeds(spec, assembly.scene.vehicles), *discrete_plant(spec, assembly.scene)]
        return (), (), [*unread, *idle, *remarks, *skipped_lines(skipped, "check", "checked")]
    except MirdrakeError as error:
        return [str(fault) for fault in error.faults], (), ()


def _holds_vehicle(path: Path) -> bool:
    """Return whether a path is a vehicle folder, complete or not, or one of its files."""
    from mirdrake.vehicles.vehicle import FILES

    folder = path.parent if path.name in FILES else path
    return any((folder / name).is_file() for name in FILES) and path.exists()
