"""``mirdrake manoeuvre``: standard manoeuvres with a vehicle, and a handling report."""

import argparse
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

from mirdrake.cli.common import add_quiet, add_set, new_folder, print_files
from mirdrake.core.errors import ConfigError
from mirdrake.core.progress import Progress
from mirdrake.core.wording import plural

if TYPE_CHECKING:
    from mirdrake.vehicles import Vehicle

MORE = """\
NAME is one manoeuvre, several separated by commas, or all. The folder holds handling.html, results.json, metrics.csv,
and the run of every simulation. If the tyres of a vehicle have no slip and it has a variant 'handling', this variant
is driven: bolt means bolt@handling. A manoeuvre beyond the vehicle's speed, steering or pedals is reported as "not
possible" with the reason. Exit codes: 0 done, 1 a manoeuvre failed its criterion or diverged, 2 bad input.

examples:
  mirdrake manoeuvre --list                                             all of them, with standard and settings
  mirdrake manoeuvre step_steer,braking bolt
  mirdrake manoeuvre all mkz --out runs/mkz_handling
  mirdrake manoeuvre steady_state_circle bolt --set steady_state_circle.radius=40 --set plant.contact=point
  mirdrake manoeuvre all bolt --model single_track                      the single-track model with the same drivers"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    parser.add_argument("name", nargs="?", metavar="NAME", help="manoeuvres, separated by commas, or all")
    parser.add_argument("vehicle", nargs="?", metavar="VEHICLE", help="name or path of a vehicle; bolt@x is a variant")
    parser.add_argument(
        "--as-is",
        action="store_true",
        help="drive the vehicle as named, not its variant 'handling'",
    )
    parser.add_argument("--list", action="store_true", help="show the manoeuvres, their standards and settings")
    parser.add_argument(
        "--model", choices=("full", "single_track"), default="full", help="the full plant or the single-track model"
    )
    add_set(parser, "step_steer.speed='80 km/h', friction=0.5, plant.time_step=0.002 or single_track.mass=1700")
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder (default: runs/<vehicle>-handling-<UTC time>)")
    add_quiet(parser)


def run(options: argparse.Namespace) -> int:
    """Drive the manoeuvres and write the report; 1 if one failed or diverged, 130 if interrupted."""
    from mirdrake.manoeuvres.registry import find_names, read_settings

    # Lists and errors of the command line need no vehicle, so that they come before the imports below.
    settings = read_settings(options.set)
    if options.list:
        _list(options.name or "all", settings)
        return 0
    if options.name is None or options.vehicle is None:
        raise ConfigError("give a manoeuvre and a vehicle: mirdrake manoeuvre braking bolt; --list shows the names")
    names = find_names(options.name)

    from mirdrake.manoeuvres.facts import find_facts
    from mirdrake.manoeuvres.registry import run_manoeuvre
    from mirdrake.manoeuvres.results import HandlingResults, describe, write_results
    from mirdrake.manoeuvres.rig import Rig
    from mirdrake.vehicles import load_vehicle
    from mirdrake.vehicles.vehicle import VARIANT_MARK

    # Handling is a matter of tyre slip, which contact friction alone does not have.
    vehicle = load_vehicle(options.vehicle)
    if not options.as_is and _has_handling_variant(vehicle):
        options.vehicle += f"{VARIANT_MARK}handling"
        vehicle = load_vehicle(options.vehicle)
        if not options.quiet:
            print(f"driving {vehicle.name}, which has tyre slip; --as-is drives the vehicle with contact friction")

    facts = find_facts(vehicle)
    folder = new_folder(options.out, f"{vehicle.name.replace('@', '-')}-handling")
    outcomes = []
    began = time.monotonic()
    interrupted = False
    with Progress(vehicle.name, quiet=options.quiet) as progress:
        rig = Rig(
            options.vehicle,
            vehicle,
            facts,
            kind=options.model,
            plant=settings.plant.model_dump(exclude_unset=True),
            friction=settings.friction,
            seed=settings.seed,
            changes=settings.single_track,
            gains=settings.flat_gains(),
            folder=folder,
            report=lambda label: progress.update(text=label),
        )
        # One manoeuvre that fails does not stop the others; its outcome states why.
        for number, name in enumerate(names, start=1):
            progress.update(title=f"{number}/{len(names)} {name}")
            try:
                outcome = run_manoeuvre(name, rig, getattr(settings, name))
            except KeyboardInterrupt:
                interrupted = True
                break
            outcomes.append(outcome)
            if not options.quiet:
                progress.write_out("\n".join(describe(outcome)))

    # The report is written also after an interruption, so that finished manoeuvres are not lost.
    if outcomes:
        # The contact that was used, which may differ from the setting on uneven ground.
        plant = {**settings.plant.model_dump(), "contact": rig.contact}
        results = HandlingResults(facts, options.model, plant, rig.friction, outcomes, folder)
        folder.mkdir(parents=True, exist_ok=True)
        write_results(results)
        from mirdrake.report.handling import write_handling  # Matplotlib takes half a second

        write_handling(results)
        if not options.quiet:
            print(f"{plural(len(outcomes), 'manoeuvre')} in {time.monotonic() - began:.1f} s")
            files = (("handling.html", "report"), ("results.json", "figures"), ("metrics.csv", "figures as a table"))
            print_files(folder, files, indent="  ")
    if interrupted:
        print("interrupted; what was done is kept", file=sys.stderr)
        return 130
    return results.exit_code


def _has_handling_variant(vehicle: "Vehicle") -> bool:
    """Return whether a vehicle that was named without a variant has no tyre slip, but a variant that has."""
    from mirdrake.vehicles.vehicle import VARIANT_MARK, variants

    plain = VARIANT_MARK not in vehicle.name and not vehicle.spec.tyres.has_slip
    return plain and "handling" in variants(vehicle.folder)


def _list(text: str, settings: object) -> None:
    """Print the manoeuvres with their settings."""
    from mirdrake.manoeuvres.registry import MANOEUVRES, find_names
    from mirdrake.manoeuvres.results import format_setting, format_status

    for name in find_names(text):
        spec = getattr(settings, name)
        print(f"{name}: {MANOEUVRES[name].title} ({MANOEUVRES[name].standard})")
        print(f"  {(MANOEUVRES[name].__doc__ or '').splitlines()[0]}")
        for used in spec.used():
            print(f"    {used.name:16} {format_setting(used):32} {used.meaning} [{format_status(used)}]")
