"""``mirdrake learn clone``: teach a network to drive like an expert."""

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from mirdrake.cli.common import add_quiet, add_set, terminated_like_interrupted
from mirdrake.core.paths import find
from mirdrake.core.progress import Progress

if TYPE_CHECKING:
    from mirdrake.learning.result import CloneResult

MORE = """\
STUDY.yaml names a diagram, whose driver is the expert, and a camera (mirdrake: learning/1). The expert drives with
injected errors and is recorded; a PilotNet is trained on the pictures and written as pilot.onnx; it then drives by
itself. `rounds` repeats this with its own drives, labelled by the expert (DAgger). The folder has learning.json, the
networks, all runs and the report learning.html. Ctrl-C keeps finished work; the same command continues.
Needs mirdrake[learning]. Exit codes: 0 the network has driven all laps without an intervention, 1 it has not, 2 invalid
input, 130 stopped.

examples:
  mirdrake learn clone clone_bolt --out runs/clone
  mirdrake learn clone studies/clone_bolt.yaml --set rounds=2 --set drive.laps=1
  mirdrake learn clone clone_bolt --set overrides.control.ego.speed=8 --set latency=100ms"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    parser.add_argument("study", metavar="STUDY.yaml", help="a learning file (mirdrake: learning/1)")
    add_set(parser, "train.epochs=20")
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder (default: runs/learn-<study>, continued)")
    add_quiet(parser)


def run(options: argparse.Namespace) -> int:
    """Teach the network; 0: it drives, 1: it does not, 130: stopped."""
    path = find("studies", options.study)
    from mirdrake.learning.spec import load_learning

    spec = load_learning(path, overrides=options.set)
    from mirdrake.learning.clone import clone

    folder = options.out or Path("runs") / f"learn-{spec.name}"
    with Progress(spec.name, total=100.0, unit="%", quiet=options.quiet) as progress, terminated_like_interrupted():

        def show(step: str, share: float) -> None:
            progress.update(100.0 * share, text=step)

        # Every finished step is in the journal: the same command continues after an interruption.
        try:
            result = clone(spec, out=folder, progress=show, warn=lambda text: progress.write(f"note: {text}"))
        except KeyboardInterrupt:
            progress.close()
            print(f"{folder}: stopped; run it again to continue", file=sys.stderr)
            return 130
    from mirdrake.report.learning import write_learning_report  # importing Matplotlib takes half a second

    write_learning_report(result)
    if not options.quiet:
        _print_result(result)
    return 0 if result.is_driven else 1


def _print_result(result: "CloneResult") -> None:
    """Print the drives of each round."""
    from mirdrake.report.learning import headline

    print(f"{result.name}: {headline(result)}")
    print(f"  {result.delay_sentence}")
    for result_of_round in result.rounds:
        # Training without validation pictures has no error.
        error = result_of_round.validation_error[-1] if result_of_round.validation_error else float("nan")
        print(
            f"  round {result_of_round.number}: {result_of_round.pictures} pictures, validation error {error:.4f} rad"
        )
        for world, drive in result_of_round.drives.items():
            figures = drive.figures
            print(
                f"    {world}: {figures.laps:.2f} laps, autonomy {100.0 * figures.autonomy:.1f} %, lateral error "
                f"{figures.rms:.3f} m RMS, largest {figures.largest:.2f} m, wheels off road {figures.off_road:.1f} s"
            )
    print(f"  {result.processor_s / 60.0:.1f} min of processor time")
    print(f"  {result.folder}")
