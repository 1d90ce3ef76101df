"""``mirdrake validate``: a vehicle simulated against published figures of the real one."""

import argparse
from pathlib import Path

from mirdrake.cli.common import add_quiet, add_set, new_folder, parse_names, print_files
from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.progress import Progress
from mirdrake.core.yaml_io import parse_yaml

MORE = """\
The file published_figures.yaml of the vehicle lists the figures with their conditions, sources and reliability. The
command simulates the manoeuvres under these conditions and shows the figures by role:
  predicted   no parameter of the vehicle was set by the figure
  calibrated  parameters were fitted to the figure
  input       the figure follows from a value in the files of the vehicle
The folder holds validation.html, results.json, figures.csv and the runs.
Exit codes: 0 every figure is within the tolerance, 1 one is not or could not be simulated, 2 bad input.

examples:
  mirdrake validate bolt
  mirdrake validate bolt --list                                    the published figures, without driving
  mirdrake validate bolt --only braking_distance,lateral_limit
  mirdrake validate mkz --set tolerance=10 --out runs/mkz_validation
  mirdrake validate bolt --set plant.contact=hydroelastic --set plant.time_step=0.0025"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    parser.add_argument("vehicle", metavar="VEHICLE", help="name or path of a vehicle; bolt@x is a variant")
    parser.add_argument("--list", action="store_true", help="show the published figures and their sources")
    parser.add_argument("--only", default="", metavar="QUANTITY", help="quantities, separated by commas")
    add_set(parser, "tolerance=5 (in %%), friction=0.9 or plant.time_step=0.002")
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help="folder (default: runs/<vehicle>-validation-<UTC time>)"
    )
    add_quiet(parser)


def run(options: argparse.Namespace) -> int:
    """Drive the manoeuvres and compare their figures with the published ones."""
    from mirdrake.manoeuvres.published import load_published
    from mirdrake.manoeuvres.validation import ValidationSettings, driven_name, format_published
    from mirdrake.vehicles import load_vehicle

    settings = parse_yaml("", ValidationSettings, name="validate", overrides=options.set)
    vehicle = load_vehicle(options.vehicle)
    published = load_published(vehicle)

    # The list needs no plant, so that it is printed before the modules of the manoeuvres are imported.
    only = _quantities(options.only, [figure.quantity for figure in published.figures])
    if options.list:
        for figure in published.figures:
            if not only or figure.quantity in only:
                print(f"{figure.text}: {format_published(figure)} ({figure.role}; {figure.status}; {figure.source})")
        if published.none_because:
            print(published.none_because)
        return 0

    from mirdrake.manoeuvres.validation import describe_validation, validate_vehicle, write_validation_results

    # The published figures may name the variant of the vehicle that they were measured with.
    name = driven_name(options.vehicle, published)
    vehicle = load_vehicle(name)
    folder = new_folder(options.out, f"{vehicle.name.replace('@', '-')}-validation")
    with Progress(vehicle.name, quiet=options.quiet) as progress:
        results = validate_vehicle(
            name,
            vehicle,
            published,
            settings,
            folder=folder,
            only=only,
            report=lambda label: progress.update(text=label),
        )
    folder.mkdir(parents=True, exist_ok=True)
    write_validation_results(results)
    from mirdrake.report.validation import write_validation  # Matplotlib takes half a second

    write_validation(results)
    if not options.quiet:
        print("\n".join(describe_validation(results)))
        files = (("validation.html", "report"), ("results.json", "figures"), ("figures.csv", "figures as a table"))
        print_files(folder, files, note=f" in {results.wall:.1f} s")
    return results.exit_code


def _quantities(text: str, known: list[str]) -> list[str]:
    """Return the quantities of a text such as ``"braking_distance,top_speed"``.

    Raises:
        ConfigError: the vehicle has no published figure of one of them.
    """
    names = parse_names(text)
    for name in names:
        if name not in known:
            raise ConfigError(f"--only: nothing is published as '{name}'; {did_you_mean(name, sorted(set(known)))}")
    return names
