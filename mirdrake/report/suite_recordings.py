"""Recordings of the cases of a suite that did not pass."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from mirdrake.core.errors import MirdrakeError, first_line
from mirdrake.runs.incidents import OF_ACTORS
from mirdrake.runs.logs import Run, load_run
from mirdrake.suites import Suite
from mirdrake.viewer import write_recording

_MOST = 20  # recordings of a suite; each has about 4 MB

RECORDING = "recording.html"

_POSE = ("x", "y", "z", "roll", "pitch", "yaw")


def write_recordings(suite: Suite) -> list[tuple[str, str]]:
    """Write recording.html into the run folders of a suite, for the :data:`_MOST` worst cases.

    Args:
        suite: suite with a folder.

    Returns:
        failures: name of the case, and the reason in one line.
    """
    assert suite.folder is not None
    faults = []
    for result in [result for _, result in suite.ranked() if result.folder is not None][:_MOST]:
        folder = suite.folder / str(result.folder)
        if not (folder / RECORDING).is_file():
            # The verdicts are valid without recordings, so that a fault of one must not end the report.
            try:
                _record(folder)
            except (MirdrakeError, RuntimeError, ValueError, KeyError, OSError) as error:
                faults.append((result.name, first_line(error)))
    return faults


def _record(folder: Path) -> None:
    """Record a run up to the first pose that is not finite; a run with one sample or none has no recording."""
    run = load_run(folder)
    known = until_lost(run)
    if len(known.signals) > 1:
        write_recording(known, frames_per_second=float(run.spec["record"]["frames"]))


def until_lost(run: Run) -> Run:
    """Return the samples of a run before the first one with a pose that is not finite."""
    table = pd.concat([run.signals, run.actors.add_prefix(OF_ACTORS)], axis=1) if len(run.actors) else run.signals
    names = [f"{vehicle}.{key}" for vehicle in run.spec["vehicles"] for key in _POSE]
    lost = ~np.isfinite(table[[name for name in names if name in table]].to_numpy()).all(axis=1)
    return replace(run, table=table.iloc[: int(np.argmax(lost))] if lost.any() else table)
