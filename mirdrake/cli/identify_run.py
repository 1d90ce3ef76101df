"""``mirdrake identify STUDY.yaml``: data check, fits, table, report."""

import argparse
import sys
from pathlib import Path

from mirdrake.errors import RunError
from mirdrake.paths import find
from mirdrake.yaml_io import shown

HELP = "do an identification study; 'run' may be left out"
MORE = """\
The folder holds report.html, fit.json, traces.parquet, profiles.parquet and data_check.csv.
Exit codes: 0 done, 1 a parameter is not identifiable or contradicts its given value, 2 bad input.

examples:
  mirdrake identify study.yaml
  mirdrake identify study.yaml --set estimator.profile=true --out runs/study"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The verb's arguments."""
    parser.add_argument("study", metavar="STUDY.yaml", help="file of format mirdrake: identification/1")
    parser.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", help="override a key of the study; may be again"
    )
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder (default: runs/<study>-<UTC time>)")
    parser.add_argument("--quiet", action="store_true", help="print nothing but errors")


def run(options: argparse.Namespace) -> int:
    """Do the study."""
    from mirdrake.identification.identify import identify
    from mirdrake.identification.study import load_identification
    from mirdrake.simulation import default_folder

    path = find("studies", options.study)
    spec = load_identification(path, overrides=options.set)
    folder = options.out or default_folder(spec.name)
    if folder.exists() and any(folder.iterdir()):
        raise RunError(f"{folder}: is not empty; choose another folder with --out")
    talks = not options.quiet and sys.stderr.isatty()

    def tell(text: str) -> None:
        if talks:
            print(f"\r\033[K{spec.name}: {text}", end="", file=sys.stderr, flush=True)

    try:
        result = identify(spec, path.parent, tell=tell)
    finally:
        if talks:
            print("\r\033[K", end="", file=sys.stderr, flush=True)
    folder.mkdir(parents=True, exist_ok=True)
    result.save(folder)
    from mirdrake.report.identification import write_identification  # Matplotlib takes half a second

    write_identification(result, folder)
    if not options.quiet:
        odd = [one for one in result.check.findings if one.severity != "info"]
        for one in odd:
            print(
                f"{one.log}: {one.channel or 'all channels'}: {one.text}" + (f" -> {one.repair}" if one.repair else "")
            )
        if odd:
            print()
        print(result.fit.table())
        print(f"\n{shown(folder)}/ in {result.seconds:.1f} s")
        for file, text in (("report.html", "report"), ("fit.json", "parameters"), ("traces.parquet", "curves")):
            print(f"  {file:16} {text}")
    doubtful = {"not identifiable", "contradicts the given value"}
    return 1 if any(one.verdict in doubtful for one in result.fit.parameters) else 0
