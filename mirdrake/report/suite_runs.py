"""Pages of the runs of a suite that were kept: those of cases that did not pass, or that were chosen by name."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from mirdrake.core.errors import MirdrakeError, first_line
from mirdrake.report.run_report import write_report
from mirdrake.runs.incidents import OF_ACTORS
from mirdrake.runs.logs import SUMMARY, Run, load_run, reads_run
from mirdrake.suites import Suite
from mirdrake.viewer import write_recording

_MOST = 20  # runs of a suite with pages; a recording has about 4 MB

RECORDING = "recording.html"
REPORT = "report.html"

_POSE = ("x", "y", "z", "roll", "pitch", "yaw")


def write_run_pages(suite: Suite) -> list[tuple[str, str]]:
    """Write recording.html and report.html into the run folders of a suite, for the :data:`_MOST` worst cases.

    Args:
        suite: suite with a folder.

    Returns:
        failures: name of the case, and the page with the reason in one line.
    """
    assert suite.folder is not None
    faults = []
    for result in [result for _, result in suite.ranked() if result.folder is not None][:_MOST]:
        folder = suite.folder / str(result.folder)
        for page, write in ((RECORDING, _record), (REPORT, _report)):
            if (folder / page).is_file():
                continue
            # The verdicts are valid without pages, so that a fault of one must not end the suite.
            try:
                write(folder)
            except (MirdrakeError, RuntimeError, ValueError, KeyError, OSError) as error:
                faults.append((result.name, f"{page}: {first_line(error)}"))
    return faults


def _record(folder: Path) -> None:
    """Record a run up to the first pose that is not finite; a run with one sample or none has no recording."""
    run = load_run(folder)
    known = until_lost(run)
    if len(known.signals) > 1:
        write_recording(known, frames_per_second=float(run.spec["record"]["frames"]))


def _report(folder: Path) -> None:
    """Write the report of a run; one that ended before its summary has none."""
    if (folder / SUMMARY).is_file():
        reads_run(write_report)(load_run(folder))


def until_lost(run: Run) -> Run:
    """Return the samples of a run before the first one with a pose that is not finite."""
    table = pd.concat([run.signals, run.actors.add_prefix(OF_ACTORS)], axis=1) if len(run.actors) else run.signals
    names = [f"{vehicle}.{key}" for vehicle in run.spec["vehicles"] for key in _POSE]
    lost = ~np.isfinite(table[[name for name in names if name in table]].to_numpy()).all(axis=1)
    return replace(run, table=table.iloc[: int(np.argmax(lost))] if lost.any() else table)
