"""The command ``mirdrake``: thin verbs around the Python functions.

A new verb is a module of this package (see :class:`mirdrake.cli.verbs.Verb`) and a line in :data:`VERBS`.
"""

import argparse
import gc
import logging
import os
import sys
from collections.abc import Sequence
from contextlib import nullcontext

from mirdrake.cli.verbs import Verb, VerbParser, add_verbs
from mirdrake.core.errors import MirdrakeError
from mirdrake.core.paths import installed_version
from mirdrake.core.progress import still_working

_WORLD = """\
examples:
  mirdrake world check parking_lot            report faults with their lines
  mirdrake world build parking_lot -o out     write lock file (all random values resolved), SDF world and plan
  mirdrake world show parking_lot             show the world in Meshcat, overlaps in red
  mirdrake world edit yard.yaml               edit the world in the browser
  mirdrake world test parking_lot barrels     run all tests with all variations
  mirdrake world import old.world             convert a world of Gazebo; also .xodr, .xml, .xosc, .gpx"""

_IDENTIFY = """\
`mirdrake identify run --help` lists the options of a study: --set, --out and others.

examples:
  mirdrake identify new lap.csv                     write a data file for a log, with guesses as comments
  mirdrake identify check drives.yaml               check the logs before any fit
  mirdrake identify study.yaml                      check the logs, fit, write a report
  mirdrake identify study.yaml --set model.tyres=fiala --out runs/fiala
  mirdrake identify filter drives.yaml bolt         estimate states and parameters along a log
  mirdrake identify apply runs/study bolt           write the result and its source into vehicle.yaml"""

_TUNE = """\
`mirdrake tune run --help` lists the options of a study: --set, --workers, --out and others.

examples:
  mirdrake tune studies/bolt_speed.yaml --out runs/bolt_speed
  mirdrake tune apply runs/bolt_speed --dry-run"""

_LEARN = """\
examples:
  mirdrake learn clone clone_bolt --out runs/clone
  mirdrake learn clone studies/clone_bolt.yaml --set rounds=2"""

VERBS = {
    "run": Verb("simulate a diagram and write a run folder", "run"),
    "drive": Verb("drive a vehicle by hand in real time, in a browser", "drive"),
    "list": Verb("list vehicles, worlds, diagrams, studies, props, sensors, drivers and blocks", "listing"),
    "manoeuvre": Verb("drive standard manoeuvres with a vehicle and write a handling report", "manoeuvre"),
    "validate": Verb("compare a vehicle with published figures of the real one", "validate"),
    "view": Verb("show a vehicle, a world, a diagram or a run in Meshcat", "view"),
    "check": Verb("report faults of files with their lines, without a simulation", "check"),
    "draw": Verb("draw a diagram's blocks and connections as SVG", "draw"),
    "ports": Verb("list the ports of a diagram with their elements and units", "ports"),
    "replay": Verb("replay a run in Meshcat with the pictures of its cameras", "replay"),
    "export": Verb("write a run as MCAP (Foxglove), CSV or video", "export"),
    "identify": Verb(
        "estimate the parameters of a vehicle from recorded drives",
        more=_IDENTIFY,
        default="run",
        verbs={
            "run": Verb("run an identification study; 'run' may be left out", "identify_run"),
            "check": Verb("check recorded drives: clock, glitches, delays, units, excitation", "identify_check"),
            "new": Verb("write a data file for a log, with guesses of its channels, units and signs", "identify_new"),
            "filter": Verb("estimate states and slowly varying parameters along a log", "identify_filter"),
            "apply": Verb("write the parameters of a fit into vehicle.yaml", "identify_apply"),
        },
    ),
    "completion": Verb("print a script that completes commands, names and ports in the shell", "completion"),
    "import": Verb("make a vehicle folder from the URDF, xacro or SDF of a ROS or Gazebo package", "importing"),
    "inspect": Verb("print mass, axle loads, dimensions, inertia, joints and sensors of a vehicle", "inspect"),
    "learn": Verb(
        "train networks that drive",
        more=_LEARN,
        verbs={
            "clone": Verb("teach a network to drive from an expert: pictures, training, drive, report", "learn_clone")
        },
    ),
    "new": Verb("write a new vehicle folder from a few dimensions", "new"),
    "schema": Verb("print the JSON Schema of a kind of YAML file, with which editors complete and check", "schema"),
    "study": Verb("run a study: many variations of one diagram, on all cores or on a cluster", "study"),
    "world": Verb(
        "check, build, show, edit, test, search or import worlds",
        more=_WORLD,
        verbs={
            "check": Verb("report faults of worlds with their lines", "world_check"),
            "build": Verb("write a world's lock file, its SDF world for Gazebo and Drake, and its plan", "world_build"),
            "show": Verb("show a world in Meshcat, overlaps in red", "world_show"),
            "edit": Verb("edit a world in the browser", "world_edit"),
            "test": Verb("run the tests of worlds with all their variations", "world_test"),
            "search": Verb("search for parameter values with which a test fails", "world_search"),
            "import": Verb(
                "make a world file from a world of Gazebo, a map, a scenario or a recorded track", "world_import"
            ),
        },
    ),
    "tune": Verb(
        "tune the gains of a control loop",
        more=_TUNE,
        default="run",
        verbs={
            "run": Verb("run a tuning study; 'run' may be left out", "tune"),
            "apply": Verb("write the gains of a tuning result into control.yaml", "tune_apply"),
        },
    ),
}
"""All commands, in the order of ``mirdrake --help``."""

_STEADY = {"export", "importing", "world_import", "world_build", "check"}
"""Modules of verbs that may take long without a number for how far they are."""

_TEXT = """\
Model, simulate, identify and tune car-like vehicles with Drake.

  mirdrake list                          list vehicles, worlds, diagrams and studies; list all shows more
  mirdrake run bolt_test_track           simulate a lap of a Chevrolet Bolt; results go to runs/
  mirdrake run bolt_test_track --set control.ego.speed=8 --set plant.contact=point
  mirdrake drive bolt                    drive by hand in a browser: keys, game pad, gains, recording
  mirdrake view bolt                     show a vehicle in 3D, with a slider for every joint
  mirdrake inspect bolt                  print mass, axle loads, turning circle, joints and implausible values
  mirdrake check my_diagram.yaml         report faults of a file with their lines, without a simulation
  mirdrake draw bolt_test_track          draw the block diagram as SVG
  mirdrake ports bolt_test_track         list the ports of a diagram with their units
  mirdrake replay runs/drive             replay a run, with the pictures of its cameras
  mirdrake export runs/drive --to mcap   convert a run for Foxglove; or to csv or video
  mirdrake manoeuvre braking bolt        drive standard manoeuvres, write a handling report; --list shows all
  mirdrake validate bolt                 compare simulated with published figures of the real car
  mirdrake tune studies/bolt_speed.yaml  tune a control loop; tune apply writes the gains
  mirdrake identify study.yaml           estimate parameters from recorded drives; identify check LOG checks a log
  mirdrake learn clone clone_bolt        teach a network to drive from the pictures of a camera
  mirdrake study study.yaml              simulate many variations of a diagram on all cores
  mirdrake world test parking_lot        run the tests of a world in parallel

Names are looked up in the folders models/, worlds/, diagrams/ and studies/ of MIRDRAKE_PATH, of the working
directory and of mirdrake itself; a path works as well.
Exit codes: 0 done, 1 a check failed or a run diverged, 2 bad input.
"""


GARBAGE = 10_000
"""Number of new objects after which the program looks for garbage. Its imports make a million objects that stay; with
Python's 700, looking at them again and again takes a fifth of the time of a start."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Args:
        arguments: without the program's name; those of the process if left out.

    Returns:
        0 done, 1 a run diverged or a check failed, 2 bad input, 130 interrupted with nothing to keep.
    """
    if arguments is None:  # as a program of its own
        gc.set_threshold(GARBAGE, *gc.get_threshold()[1:])
    logging.getLogger("matplotlib.font_manager").setLevel(logging.ERROR)  # it announces its cache at the first use
    try:
        parser = _parser()
        if not (sys.argv[1:] if arguments is None else arguments):
            parser.print_help(sys.stderr)
            return 2
        options = parser.parse_args(arguments)
        # These verbs have no progress of their own where output is redirected.
        name = options.execute.__module__.rpartition(".")[2]
        with still_working(name.replace("_", " ")) if name in _STEADY else nullcontext():
            code: int = options.execute(options)
        sys.stdout.flush()  # here, where a closed pipe is handled
    except MirdrakeError as error:
        # Users see one line for each error: a traceback is a fault of mirdrake.
        for line in str(error).splitlines():
            print(f"error: {line}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130
    except BrokenPipeError:  # the reader of a pipe has ended
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:
        # A second message about the closed pipe at exit is avoided by a sink in place of stdout.
        prefix = f"{error.filename}: " if error.filename else ""
        print(f"error: {prefix}{error.strerror or error}", file=sys.stderr)
        return 2
    return code


def _parser() -> argparse.ArgumentParser:
    parser = VerbParser("mirdrake", description=_TEXT)
    parser.add_argument("--version", action=_PrintVersion, nargs=0, help="show program's version number and exit")
    add_verbs(parser, VERBS)
    return parser


class _PrintVersion(argparse.Action):
    """Prints the version, which takes a while to look up, and ends the program."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        print(_version())
        parser.exit()


def _version() -> str:
    number = installed_version("mirdrake")
    return f"mirdrake {number}" if number else "mirdrake, unknown version: its sources are used without an installation"
