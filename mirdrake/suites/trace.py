"""The trace of a case: what its report draws of the drive, thinned; a small JSON file.

The run folder of a case that passed is removed, its trace is kept. The world is not part of it.
"""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt
import shapely

from mirdrake.core.curves import thin
from mirdrake.core.files import write_file
from mirdrake.core.json_io import parse_json
from mirdrake.requirements import Finding, Observation

_POINTS = 240  # of a curve
_TOLERANCE = 0.03  # [m] of the simplified path

Points = list[list[float]]
"""Points [x, y] in W [m]."""


@dataclass(frozen=True)
class MarginCurve:
    """Margin of one requirement over time.

    Attributes:
        times: stamps [s].
        margins: margins in the unit of the requirement; None where a margin is not finite.
        worst_time: time of the smallest margin [s].
        outline: outline of the vehicle at that time.
        others: outlines of other vehicles and actors at that time, by name.
    """

    times: list[float]
    margins: list[float | None]
    worst_time: float
    outline: Points
    others: dict[str, Points] = field(default_factory=dict)


@dataclass(frozen=True)
class Trace:
    """The drive of one case.

    Attributes:
        line: path of the vehicle's origin.
        start: outline of the vehicle at the start; `end` likewise.
        curves: one per requirement, in their order; none if the case could not be judged.
        times: stamps of the speeds [s].
        speeds: speed of the vehicle [m/s]; None where it is not finite.
    """

    line: Points
    start: Points
    end: Points
    curves: list[MarginCurve]
    times: list[float] = field(default_factory=list)
    speeds: list[float | None] = field(default_factory=list)


def make_trace(seen: Observation, findings: Sequence[Finding] = ()) -> Trace:
    """Return the trace of a run.

    Args:
        seen: the run.
        findings: findings of its requirements.
    """
    x, y = seen.signals["x"], seen.signals["y"]
    # A run that diverged ends with values that are not finite.
    finite = np.isfinite(x) & np.isfinite(y)
    line = np.empty((0, 2))
    if finite.sum() > 1:
        # Simplified and rounded: the traces of all cases are in one page.
        line = shapely.get_coordinates(shapely.simplify(shapely.linestrings(x[finite], y[finite]), _TOLERANCE))
    times, speeds = thin(seen.times, seen.signals["speed"], _POINTS // 2)
    return Trace(
        line=np.round(line, 2).tolist(),
        start=_outline(seen, 0),
        end=_outline(seen, int(np.flatnonzero(finite)[-1])) if finite.any() else [],
        curves=[_curve(seen, finding) for finding in findings],
        times=np.round(times, 3).tolist(),
        speeds=_values(speeds),
    )


def write_trace(path: Path, trace: Trace) -> None:
    """Write a trace; its folder is made.

    Raises:
        RunError: the file cannot be written.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    write_file(path, json.dumps(asdict(trace), separators=(",", ":"), allow_nan=False))


def read_trace(path: Path) -> Trace | None:
    """Return the trace of a file; None if there is none, or it is damaged."""
    try:
        data = parse_json(path.read_text(encoding="utf-8"))
        return Trace(**(data | {"curves": [MarginCurve(**curve) for curve in data["curves"]]}))
    except (OSError, ValueError, TypeError, LookupError):
        return None


def _outline(seen: Observation, row: int) -> Points:
    corners = seen.corners[row]
    return np.round(corners, 2).tolist() if np.isfinite(corners).all() else []


def _values(values: npt.NDArray[np.float64]) -> list[float | None]:
    """Return the values of a curve for JSON, with four digits."""
    return [float(f"{value:.4g}") if np.isfinite(value) else None for value in values]


def _curve(seen: Observation, finding: Finding) -> MarginCurve:
    times, margins = thin(finding.times, finding.margins, _POINTS // 2)
    row = int(np.abs(seen.times - finding.worst_time).argmin())
    return MarginCurve(
        times=np.round(times, 3).tolist(),
        margins=_values(margins),
        worst_time=round(finding.worst_time, 3),
        outline=_outline(seen, row),
        others={
            mover.name: np.round(mover.outline_at(row), 2).tolist()
            for mover in seen.movers
            if np.isfinite(mover.poses[row]).all()
        },
    )
