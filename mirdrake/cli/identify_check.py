"""``mirdrake identify check``: data check of recorded drives, before any fit."""

import argparse
from pathlib import Path

from mirdrake.cli.common import add_quiet, parse_names, positive_length
from mirdrake.core.errors import ConfigError
from mirdrake.core.wording import plural
from mirdrake.core.yaml_io import display_path, load_yaml, read_tree

MORE = """\
WHAT is a data file (mirdrake: data/1), an identification study, or a log itself: CSV, Parquet, MAT, a bag, MCAP, a run
folder. Columns of a log are found by their names (vx, yaw_rate, ...) or mapped with --map.
Exit codes: 0 no fault is left, 1 an unrepaired fault would make a fit wrong, 2 bad input.

examples:
  mirdrake identify check drives.yaml --report check.html
  mirdrake identify check lap.csv --time t_s:s --map vx=v_kmh:km/h --map yaw_rate=gyro_z:deg/s
  mirdrake identify check lap.csv --step 0.01 --map vx=v:m/s --repairs timestamps,glitches"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    parser.add_argument("what", metavar="WHAT", help="data file, study, or log")
    parser.add_argument(
        "--map", action="append", default=[], metavar="CHANNEL=COLUMN[:UNIT]", help="map a column of a log (repeatable)"
    )
    parser.add_argument("--time", metavar="COLUMN[:UNIT]", help="time column of a log (default: time)")
    parser.add_argument("--step", metavar="STEP", help="sample time of a log without a time column, e.g. '10 ms'")
    parser.add_argument(
        "--wheelbase",
        type=positive_length,
        metavar="METRES",
        help="front to rear axle [m], or with a unit, to check the steering",
    )
    parser.add_argument("--repairs", metavar="NAMES", help="repairs to make, comma-separated, or none")
    parser.add_argument("--report", type=Path, metavar="FILE.html", help="write a page with a picture of each channel")
    add_quiet(parser)


def run(options: argparse.Namespace) -> int:
    """Check the data, print the findings and write the page."""
    from mirdrake.identification.check import check_data
    from mirdrake.identification.data import DataSet, load_data, make_data
    from mirdrake.identification.mapping import map_log
    from mirdrake.identification.study import StudySpec, embedded_data

    path = Path(options.what)
    # A study names its data file or contains it.
    is_yaml = path.suffix in {".yaml", ".yml"} and not path.is_dir()
    given = [name for name in ("map", "time", "step", "wheelbase") if getattr(options, name)]
    if is_yaml and given:
        raise ConfigError(f"--{given[0]}: {display_path(path)} has its own mapping; write it there")
    if is_yaml:
        tree, _ = read_tree(path)
        is_study = isinstance(tree, dict) and str(tree.get("mirdrake", "")).startswith("identification/")
        data: DataSet
        # Only the data of a study are checked, not its model.
        if is_study:
            study = load_yaml(path, StudySpec)
            data = (
                load_data(path.parent / study.data)
                if isinstance(study.data, str)
                else make_data(embedded_data(study), path.parent)
            )
        else:
            data = load_data(path)
    else:
        data = make_data(map_log(path, options.map, options.time, options.step, options.wheelbase), path.parent)
    repairs = None if options.repairs is None else parse_names(options.repairs)
    report = check_data(data, repairs=repairs)
    # Reports need Matplotlib, which most checks do without.
    if options.report is not None:
        from mirdrake.report.identification import write_data_check  # Matplotlib takes half a second

        write_data_check(options.report, path.name, data, report)
    if not options.quiet:
        print(report.table())
        print(f"{plural(len(report.repairs), 'repair')}; {report.headline}")
        if options.report is not None:
            print(f"  {display_path(options.report)}")
    return 1 if report.unrepaired_faults else 0
