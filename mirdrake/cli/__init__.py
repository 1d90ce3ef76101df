"""The command ``mirdrake``: thin verbs around the Python functions.

A verb is a module with ``HELP``, ``MORE``, ``add_arguments(parser)`` and ``run(options)``, and a line in
:data:`VERBS`. Its module is imported only when the verb is used.
"""

import argparse
import logging
import os
import sys
from collections.abc import Sequence
from importlib import import_module

from mirdrake.core.errors import MirdrakeError
from mirdrake.core.paths import installed_version

VERBS = {
    "run": "run",
    "drive": "drive",
    "list": "listing",
    "manoeuvre": "manoeuvre",
    "validate": "validate",
    "view": "view",
    "check": "check",
    "draw": "draw",
    "replay": "replay",
    "export": "export",
    "identify": "identify",
    "import": "importing",
    "inspect": "inspect",
    "new": "new",
    "schema": "schema",
    "study": "study",
    "world": "world",
    "tune": "tune",
}
"""Module of each verb in this package."""

_TEXT = """\
Model, simulate, identify and tune car-like vehicles with Drake.

  mirdrake list                         what there is: vehicles, worlds, diagrams, studies; list all for more
  mirdrake run bolt_test_track          a Chevrolet Bolt drives a lap; results go to runs/
  mirdrake run bolt_test_track --set control.ego.speed=8 --set plant.contact=point
  mirdrake drive bolt                   drive by hand in a browser: keys, game pad, gains while driving; record
  mirdrake view bolt                    look at a vehicle, with a slider for every joint
  mirdrake inspect bolt                 its mass, axle loads, turning circle, inertia, joints, and what looks wrong
  mirdrake check my_diagram.yaml        every fault with file and line, without running
  mirdrake draw bolt_test_track         the block diagram as SVG
  mirdrake replay runs/drive            watch a run again, with what its cameras saw beside it
  mirdrake export runs/drive --to mcap  for Foxglove; csv and video as well
  mirdrake manoeuvre braking bolt       standard manoeuvres, and a handling report; --list shows them
  mirdrake validate bolt                simulated against published figures of the real car, side by side
  mirdrake tune studies/bolt_speed.yaml find gains for a loop, with margins and Monte Carlo; tune apply writes them
  mirdrake identify study.yaml          parameters from recorded drives; identify check LOG looks at a log first
  mirdrake study study.yaml             many variations of a diagram over all cores, resumable
  mirdrake world test parking_lot       run the tests of a world in parallel; pass or fail

Names are looked up in the folders models/, worlds/, diagrams/ and studies/ of MIRDRAKE_PATH, of the working
directory and of mirdrake itself; a path works as well.
Exit codes: 0 done, 1 a check failed or a run diverged, 2 bad input.
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Args:
        arguments: without the program's name; those of the process if left out.

    Returns:
        0 done, 1 a run diverged or a check failed, 2 bad input, 130 interrupted before there was anything to keep.
    """
    logging.getLogger("matplotlib.font_manager").setLevel(logging.ERROR)  # its first use tells of a font cache
    try:
        options = _parser().parse_args(arguments)
        code: int = options.verb.run(options)
        sys.stdout.flush()  # here, where a reader that has gone is no error
    except MirdrakeError as error:
        for line in str(error).splitlines():
            print(f"error: {line}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130
    except BrokenPipeError:  # the reader of a pipe has gone
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:
        place = f"{error.filename}: " if error.filename else ""
        print(f"error: {place}{error.strerror or error}", file=sys.stderr)
        return 2
    return code


def _parser() -> argparse.ArgumentParser:
    raw = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser("mirdrake", description=_TEXT, formatter_class=raw)
    parser.add_argument("--version", action="version", version=_version())
    verbs = parser.add_subparsers(title="verbs", metavar="VERB", required=True)
    for name, module in VERBS.items():
        verb = import_module(f"mirdrake.cli.{module}")
        text = f"{verb.HELP}\n\n{verb.MORE}".strip()
        child = verbs.add_parser(name, help=verb.HELP, description=text, formatter_class=raw)
        child.set_defaults(verb=verb)
        verb.add_arguments(child)
    return parser


def _version() -> str:
    number = installed_version("mirdrake")
    return f"mirdrake {number}" if number else "mirdrake, version unknown: its sources are used, not installed"
