"""``mirdrake identify filter``: states and slowly varying parameters of a vehicle along a log."""

import argparse
from pathlib import Path

from mirdrake.cli.common import add_quiet
from mirdrake.core.errors import ConfigError
from mirdrake.core.files import write_file
from mirdrake.core.yaml_io import display_path, load_yaml, parse_yaml

MORE = """\
DATA is a data file (mirdrake: data/1). The filters begin with the parameters of VEHICLE. SETTINGS.yaml has the keys of
a block of the kind filter_bank (docs/estimation.md): sensors, estimate, hypotheses, ...; without it, stiffness and
friction are estimated from all channels that a sensor of a filter measures.
Exit codes: 0 done, 1 at the end the measurements do not fit the model: do not trust the intervals, 2 bad input.

examples:
  mirdrake identify filter drives.yaml bolt
  mirdrake identify filter drives.yaml bolt@handling --set 'estimate={friction: 0.2}' --out estimates.csv"""

DEFAULT_ESTIMATE = {"front_stiffness": 0.2, "rear_stiffness": 0.2, "friction": 0.1}
"""Slow quantities that are estimated without settings."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    parser.add_argument("data", type=Path, metavar="DATA", help="data file")
    parser.add_argument("vehicle", metavar="VEHICLE", help="name or path of a vehicle")
    parser.add_argument("--settings", type=Path, metavar="SETTINGS.yaml", help="settings of the filters")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="change a setting (repeatable)")
    parser.add_argument("--log", metavar="NAME", help="log of the data file; the first one if left out")
    parser.add_argument("--out", type=Path, metavar="FILE.csv", help="write the estimates over time")
    add_quiet(parser)


def run(options: argparse.Namespace) -> int:
    """Run the filters, print the last estimates and write all of them."""
    from mirdrake.core.errors import did_you_mean
    from mirdrake.estimation import FilterSpec
    from mirdrake.identification.check import check_data
    from mirdrake.identification.data import load_data
    from mirdrake.identification.filter_log import filter_log, log_sensors
    from mirdrake.single_track import estimate_parameters
    from mirdrake.vehicles import load_vehicle

    data = check_data(load_data(options.data)).data
    names = [log.name for log in data.logs]
    if options.log is not None and options.log not in names:
        raise ConfigError(f"--log: no log '{options.log}'; {did_you_mean(options.log, names)}")
    log = data.logs[0 if options.log is None else names.index(options.log)]
    if options.settings is not None:
        spec = load_yaml(options.settings, FilterSpec, overrides=options.set)
    else:
        spec = parse_yaml("", FilterSpec, name="--set", overrides=options.set)
        given: dict[str, object] = {}
        # Roll needs its own states, which the default filter does not have.
        if "sensors" not in spec.model_fields_set:
            given["sensors"] = [name for name in log_sensors(log) if not name.startswith("roll") or spec.roll]
        if "estimate" not in spec.model_fields_set:
            given["estimate"] = DEFAULT_ESTIMATE
        spec = FilterSpec.model_validate(spec.model_dump() | given)
    vehicle = load_vehicle(options.vehicle)
    found = filter_log(log, estimate_parameters(vehicle, roll=spec.roll), spec, ratio=vehicle.spec.steering.ratio)
    best = int(found.weights[:, -1].argmax())
    if options.out is not None:
        write_file(options.out, found.table(best).to_csv().encode())
    consistent = bool(found.consistent[best, -1])
    if not options.quiet:
        print(f"{log.name}: {len(found.time)} samples, {found.filters[best]}, weight {found.weights[best, -1]:.2f}")
        for signal in found.signals:
            low, high = (end[best, -1] for end in found.interval(signal.name))
            print(f"  {signal.name:24} {found[signal.name][best, -1]:12.5g} {signal.unit:6} {low:.5g} to {high:.5g}")
        share = 100.0 * found.consistent[best].mean()
        text = "" if consistent else "; at the end the intervals are not valid: the model or its noise is wrong"
        print(f"innovations agree with model and noise in {share:.0f} % of the time{text}")
        if options.out is not None:
            print(f"  {display_path(options.out)}")
    return 0 if consistent else 1
