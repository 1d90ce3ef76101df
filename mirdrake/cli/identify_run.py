"""``mirdrake identify STUDY.yaml``: data check, fits, table, report."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from mirdrake.cli.common import add_quiet, add_set, new_folder, print_files
from mirdrake.core.paths import find
from mirdrake.core.progress import Progress
from mirdrake.core.yaml_io import read_tree

if TYPE_CHECKING:
    from mirdrake.identification.findings import DataReport

MORE = """\
A data file without a study is fitted with the model that its channels allow; the assumptions are printed first.
The folder holds report.html, fit.json, traces.parquet, profiles.parquet and data_check.csv.
Exit codes: 0 done, 1 a parameter is not identifiable or contradicts its given value, 2 bad input.

examples:
  mirdrake identify study.yaml
  mirdrake identify drives.yaml
  mirdrake identify study.yaml --set estimator.profile=true --out runs/study"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    parser.add_argument(
        "study", metavar="STUDY.yaml", help="study (mirdrake: identification/1), or a data file (data/1)"
    )
    add_set(parser, "model.tyres=fiala")
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder (default: runs/<study>-<UTC time>)")
    add_quiet(parser)


def run(options: argparse.Namespace) -> int:
    """Run the study, save its folder and print the result."""
    from mirdrake.identification.default_study import default_study
    from mirdrake.identification.identify import identify
    from mirdrake.identification.study import load_identification

    path = find("studies", options.study)
    tree, _ = read_tree(path)
    # A data file alone is fitted by the default study.
    bare = isinstance(tree, dict) and str(tree.get("mirdrake", "")).startswith("data/")
    spec = (default_study if bare else load_identification)(path, overrides=options.set)
    folder = new_folder(options.out, spec.name)
    with Progress(spec.name, quiet=options.quiet) as progress:
        result = identify(spec, path.parent, progress=lambda text: progress.update(text=text))
    folder.mkdir(parents=True, exist_ok=True)
    result.save(folder)
    from mirdrake.report.identification import write_identification  # Matplotlib takes half a second

    write_identification(result, folder)
    if not options.quiet:
        if bare:
            print(f"{spec.name}: {spec.about}\n")
        for line in _finding_lines(result.check):
            print(line)
        print(result.fit.table())
        print()
        files = (("report.html", "report"), ("fit.json", "parameters"), ("traces.parquet", "curves"))
        print_files(folder, files, note=f" in {result.seconds:.1f} s")
    # Exit code 1 lets scripts reject a result that needs to be looked at.
    doubtful = {"not identifiable", "contradicts the given value"}
    return 1 if any(parameter.verdict in doubtful for parameter in result.fit.parameters) else 0


def _finding_lines(check: "DataReport") -> list[str]:
    """Return the findings of the data check in lines: unrepaired faults, then repairs, then warnings."""
    groups: dict[str, list[str]] = {"unrepaired faults": [], "repaired": [], "warnings": []}
    for finding in check.findings:
        if finding.severity == "info":
            continue
        group = "repaired" if finding.repair else "unrepaired faults" if finding.severity == "fault" else "warnings"
        text = f"  {finding.log}: {finding.channel or 'all channels'}: {finding.text}"
        groups[group].append(text + (f" -> {finding.repair}" if finding.repair else ""))
    lines = []
    for title, texts in groups.items():
        lines += [f"Data check, {title}:", *texts, ""] if texts else []
    return lines
