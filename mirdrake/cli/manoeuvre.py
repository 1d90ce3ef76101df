"""``mirdrake manoeuvre``: standard manoeuvres with a vehicle, and a handling report."""

import argparse
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mirdrake.core.errors import ConfigError
from mirdrake.core.yaml_io import shown

if TYPE_CHECKING:
    from mirdrake.vehicles import Vehicle

HELP = "drive standard manoeuvres with a vehicle and write a handling report"
MORE = """\
NAME is one manoeuvre, several with commas between them, or all. The folder holds handling.html, results.json,
metrics.csv, and the run of every simulation. A manoeuvre for which the vehicle has not the speed, the steering or the
pedals is "not possible", and says why. Exit codes: 0 done, 1 a manoeuvre failed its criterion or diverged, 2 bad input.

examples:
  mirdrake manoeuvre --list                                             all of them, with standard and settings
  mirdrake manoeuvre step_steer,braking bolt
  mirdrake manoeuvre all mkz --out runs/mkz_handling
  mirdrake manoeuvre steady_state_circle bolt --set steady_state_circle.radius=40 --set plant.contact=point
  mirdrake manoeuvre all bolt --model single_track                      the reduced model, behind the same drivers"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The verb's arguments."""
    parser.add_argument("name", nargs="?", metavar="NAME", help="manoeuvres, with commas, or all")
    parser.add_argument("vehicle", nargs="?", metavar="VEHICLE", help="name or path of a vehicle; bolt@x is a variant")
    parser.add_argument(
        "--as-is",
        action="store_true",
        help="drive the vehicle as named; else, if it has contact friction only, its variant 'handling'",
    )
    parser.add_argument("--list", action="store_true", help="show the manoeuvres, their standards and settings")
    parser.add_argument(
        "--model", choices=("full", "single_track"), default="full", help="the plant, or the reduced model"
    )
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="a setting, for example step_steer.speed='80 km/h', friction=0.5 or plant.time_step=0.002; again",
    )
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder (default: runs/<vehicle>-handling-<UTC time>)")
    parser.add_argument("--quiet", action="store_true", help="print nothing but errors")


def run(options: argparse.Namespace) -> int:
    """Drive them."""
    from mirdrake.manoeuvres.registry import find_names, read_settings

    settings = read_settings(options.set)
    if options.list:
        _list(options.name or "all", settings)
        return 0
    if options.name is None or options.vehicle is None:
        raise ConfigError("say which manoeuvre and which vehicle: mirdrake manoeuvre braking bolt; --list shows them")
    names = find_names(options.name)

    from mirdrake.core.errors import RunError
    from mirdrake.manoeuvres.facts import find_facts
    from mirdrake.manoeuvres.registry import run_manoeuvre
    from mirdrake.manoeuvres.results import HandlingResults, describe, write_results
    from mirdrake.manoeuvres.rig import Rig
    from mirdrake.runs.simulation import default_folder
    from mirdrake.vehicles import load_vehicle
    from mirdrake.vehicles.vehicle import VARIANT_MARK

    vehicle = load_vehicle(options.vehicle)
    if not options.as_is and _has_better(vehicle):
        options.vehicle += f"{VARIANT_MARK}handling"
        vehicle = load_vehicle(options.vehicle)
        if not options.quiet:
            print(f"driving {vehicle.name}, which has tyres with slip; --as-is drives it on contact friction alone")
    facts = find_facts(vehicle)
    folder = options.out or default_folder(f"{vehicle.name.replace('@', '-')}-handling")
    if folder.exists() and any(folder.iterdir()):
        raise RunError(f"{folder}: is not empty; choose another folder with --out")
    line = _ProgressLine(not options.quiet and sys.stderr.isatty())
    rig = Rig(
        options.vehicle,
        vehicle,
        facts,
        kind=options.model,
        plant=settings.plant.model_dump(exclude_unset=True),
        friction=settings.friction,
        seed=settings.seed,
        folder=folder,
        tell=line.tell,
    )
    outcomes = []
    began = time.monotonic()
    interrupted = False
    for number, name in enumerate(names, start=1):
        line.head = f"{number}/{len(names)} {name}"
        try:
            outcome = run_manoeuvre(name, rig, getattr(settings, name))
        except KeyboardInterrupt:
            interrupted = True
            break
        outcomes.append(outcome)
        line.clear()
        if not options.quiet:
            print("\n".join(describe(outcome)), flush=True)
    line.clear()
    if outcomes:
        results = HandlingResults(facts, options.model, _plant(settings, rig.contact), rig.friction, outcomes, folder)
        folder.mkdir(parents=True, exist_ok=True)
        write_results(results)
        from mirdrake.report.handling import write_handling  # Matplotlib takes half a second

        write_handling(results)
        if not options.quiet:
            print(f"{len(outcomes)} manoeuvre{'s' * (len(outcomes) != 1)} in {time.monotonic() - began:.1f} s")
            print(f"  {shown(folder)}/")
            for file, text in (("handling.html", "report"), ("results.json", "figures"), ("metrics.csv", "as a table")):
                print(f"    {file:16} {text}")
    if interrupted:
        print("interrupted; what was done is kept", file=sys.stderr)
        return 130
    return results.exit_code


def _has_better(vehicle: "Vehicle") -> bool:
    """Whether a vehicle that was named without a variant corners on rails, and has a variant that does not."""
    from mirdrake.vehicles.vehicle import VARIANT_MARK, variants

    plain = VARIANT_MARK not in vehicle.name and not vehicle.spec.tyres.has_law
    return plain and "handling" in variants(vehicle.folder)


def _plant(settings: Any, contact: str) -> dict[str, Any]:
    """Settings of the plant as they were used."""
    return {**settings.plant.model_dump(), "contact": contact}


def _list(text: str, settings: object) -> None:
    """Print the manoeuvres with their settings."""
    from mirdrake.manoeuvres.registry import MANOEUVRES, find_names
    from mirdrake.manoeuvres.results import status_told, value_told

    for name in find_names(text):
        spec = getattr(settings, name)
        print(f"{name}: {MANOEUVRES[name].title} ({MANOEUVRES[name].standard})")
        print(f"  {(MANOEUVRES[name].__doc__ or '').splitlines()[0]}")
        for used in spec.used():
            print(f"    {used.name:16} {value_told(used):32} {used.meaning} [{status_told(used)}]")


class _ProgressLine:
    """One line on a terminal that says what is being driven."""

    def __init__(self, shown: bool) -> None:
        self.head = ""
        self._shown, self._count = shown, 0

    def tell(self, label: str) -> None:
        """A run begins."""
        if self._shown:
            self._count += 1
            print(f"\r\033[K{self.head}: run {self._count}, {label}", end="", file=sys.stderr, flush=True)

    def clear(self) -> None:
        """The line is no longer needed."""
        self._count = 0
        if self._shown:
            print("\r\033[K", end="", file=sys.stderr, flush=True)
