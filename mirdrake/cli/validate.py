"""``mirdrake validate``: a vehicle simulated against published figures of the real one."""

import argparse
import sys
from pathlib import Path

from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.yaml_io import parse_yaml, shown

HELP = "compare a vehicle with published figures of the real one, and write a validation report"
MORE = """\
The figures, their conditions, sources and how sure they are stand in published_figures.yaml of the vehicle. What they
need is driven under their conditions.
Figures are shown by role: predicted, calibrated (fitted to) or input.
The folder holds validation.html, results.json, figures.csv and the runs.
Exit codes: 0 every figure is within the tolerance, 1 one is not or could not be simulated, 2 bad input.

examples:
  mirdrake validate bolt
  mirdrake validate bolt --list                                    what is published, without driving
  mirdrake validate bolt --only braking_distance,lateral_limit
  mirdrake validate mkz --set tolerance=10 --out runs/mkz_validation
  mirdrake validate bolt --set plant.contact=hydroelastic --set plant.time_step=0.0025"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The verb's arguments."""
    parser.add_argument("vehicle", metavar="VEHICLE", help="name or path of a vehicle; bolt@x is a variant")
    parser.add_argument("--list", action="store_true", help="show the published figures and their sources")
    parser.add_argument("--only", default="", metavar="QUANTITY", help="quantities, with commas")
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="a setting: tolerance=5 (in %%), friction=0.9, plant.time_step=0.002; again",
    )
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help="folder (default: runs/<vehicle>-validation-<UTC time>)"
    )
    parser.add_argument("--quiet", action="store_true", help="print nothing but errors")


def run(options: argparse.Namespace) -> int:
    """Drive and compare."""
    from mirdrake.manoeuvres.published import load_published
    from mirdrake.manoeuvres.validation import ValidationSettings, driven_name, published_told
    from mirdrake.vehicles import load_vehicle

    settings = parse_yaml("", ValidationSettings, name="validate", overrides=options.set)
    vehicle = load_vehicle(options.vehicle)
    published = load_published(vehicle)
    only = _quantities(options.only, [one.quantity for one in published.figures])
    if options.list:
        for one in published.figures:
            if not only or one.quantity in only:
                print(f"{one.text}: {published_told(one)} ({one.role}; {one.status}; {one.source})")
        if published.none_because:
            print(published.none_because)
        return 0

    from mirdrake.core.errors import RunError
    from mirdrake.manoeuvres.validation import describe_validation, validate_vehicle, write_validation_results
    from mirdrake.runs.simulation import default_folder

    name = driven_name(options.vehicle, published)
    vehicle = load_vehicle(name)
    folder = options.out or default_folder(f"{vehicle.name.replace('@', '-')}-validation")
    if folder.exists() and any(folder.iterdir()):
        raise RunError(f"{folder}: is not empty; choose another folder with --out")
    talks = not options.quiet and sys.stderr.isatty()

    def tell(label: str) -> None:
        if talks:
            print(f"\r\033[K{vehicle.name}: {label}", end="", file=sys.stderr, flush=True)

    results = validate_vehicle(name, vehicle, published, settings, folder=folder, only=only, tell=tell)
    if talks:
        print("\r\033[K", end="", file=sys.stderr, flush=True)
    folder.mkdir(parents=True, exist_ok=True)
    write_validation_results(results)
    from mirdrake.report.validation import write_validation  # Matplotlib takes half a second

    write_validation(results)
    if not options.quiet:
        print("\n".join(describe_validation(results)))
        print(f"{shown(folder)}/ in {results.wall:.1f} s")
        for file, text in (("validation.html", "report"), ("results.json", "figures"), ("figures.csv", "as a table")):
            print(f"  {file:16} {text}")
    return results.exit_code


def _quantities(text: str, known: list[str]) -> list[str]:
    """Quantities from ``"braking_distance,top_speed"``.

    Raises:
        ConfigError: the vehicle has no figure of one of them.
    """
    names = [name.strip() for name in text.split(",") if name.strip()]
    for name in names:
        if name not in known:
            raise ConfigError(f"--only: nothing is published as '{name}'; {did_you_mean(name, sorted(set(known)))}")
    return names
