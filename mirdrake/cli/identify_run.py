"""``mirdrake identify STUDY.yaml``: data check, fits, table, report."""

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from mirdrake.core.errors import RunError
from mirdrake.core.paths import find
from mirdrake.core.yaml_io import read_tree, shown

if TYPE_CHECKING:
    from mirdrake.identification.findings import DataReport

HELP = "run an identification study; 'run' may be left out"
MORE = """\
A data file without a study is fitted with the model that its channels allow; the assumptions are printed first.
The folder holds report.html, fit.json, traces.parquet, profiles.parquet and data_check.csv.
Exit codes: 0 done, 1 a parameter is not identifiable or contradicts its given value, 2 bad input.

examples:
  mirdrake identify study.yaml
  mirdrake identify drives.yaml
  mirdrake identify study.yaml --set estimator.profile=true --out runs/study"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The verb's arguments."""
    parser.add_argument(
        "study", metavar="STUDY.yaml", help="study (mirdrake: identification/1), or a data file (data/1)"
    )
    parser.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", help="override a key of the study (repeatable)"
    )
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder (default: runs/<study>-<UTC time>)")
    parser.add_argument("--quiet", action="store_true", help="print nothing but errors")


def run(options: argparse.Namespace) -> int:
    """Run the study, save its folder and print the result."""
    from mirdrake.identification.default_study import default_study
    from mirdrake.identification.identify import identify
    from mirdrake.identification.study import load_identification
    from mirdrake.runs.simulation import default_folder

    path = find("studies", options.study)
    tree, _ = read_tree(path)
    bare = isinstance(tree, dict) and str(tree.get("mirdrake", "")).startswith("data/")
    spec = (default_study if bare else load_identification)(path, overrides=options.set)
    folder = options.out or default_folder(spec.name)
    if folder.exists() and any(folder.iterdir()):
        raise RunError(f"{folder}: is not empty; choose another folder with --out")
    talks = not options.quiet and sys.stderr.isatty()

    def show(text: str) -> None:
        if talks:
            print(f"\r\033[K{spec.name}: {text}", end="", file=sys.stderr, flush=True)

    try:
        result = identify(spec, path.parent, progress=show)
    finally:
        if talks:
            print("\r\033[K", end="", file=sys.stderr, flush=True)
    folder.mkdir(parents=True, exist_ok=True)
    result.save(folder)
    from mirdrake.report.identification import write_identification  # Matplotlib takes half a second

    write_identification(result, folder)
    if not options.quiet:
        if bare:
            print(f"{spec.name}: {spec.about}\n")
        for line in _odd(result.check):
            print(line)
        print(result.fit.table())
        print(f"\n{shown(folder)}/ in {result.seconds:.1f} s")
        for file, text in (("report.html", "report"), ("fit.json", "parameters"), ("traces.parquet", "curves")):
            print(f"  {file:16} {text}")
    doubtful = {"not identifiable", "contradicts the given value"}
    return 1 if any(one.verdict in doubtful for one in result.fit.parameters) else 0


def _odd(check: "DataReport") -> list[str]:
    """Return the findings of the data check: remaining faults, then repairs, then remarks."""
    groups: dict[str, list[str]] = {"faults that are left": [], "repaired": [], "remarks": []}
    for one in check.findings:
        if one.severity == "info":
            continue
        group = "repaired" if one.repair else "faults that are left" if one.severity == "fault" else "remarks"
        text = f"  {one.log}: {one.channel or 'all channels'}: {one.text}"
        groups[group].append(text + (f" -> {one.repair}" if one.repair else ""))
    lines = []
    for title, texts in groups.items():
        lines += [f"Data check, {title}:", *texts, ""] if texts else []
    return lines
