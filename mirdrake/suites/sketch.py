"""What a report draws of a case: the world from above, the driven line, the margins; small, as JSON.

::

    roads, patches, goals   areas as lists of rings [[x, y], …] in W [m]
    props                   outlines of the props [[x, y], …]
    line                    [[x, y], …] of the vehicle's origin
    findings                per requirement: times [s], margins, worst time [s], and the outline of the vehicle then
"""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from mirdrake.core.files import write_file
from mirdrake.requirements import Finding, Observation
from mirdrake.requirements.observation import Array
from mirdrake.worlds import World

_POINTS = 240  # of a line or curve
_FINE = 0.03  # [m] what may be lost of an outline


def make_sketch(path: Path, world: World, seen: Observation | None = None, findings: Sequence[Finding] = ()) -> None:
    """Write the sketch of a case.

    Args:
        path: file to write; its folder is made.
        world: the world.
        seen: what happened; None if it was not run.
        findings: what the requirements said of it.
    """
    data: dict[str, Any] = {
        "roads": [ring for track in world.roads().values() for ring in _rings(track.area)],
        "patches": [ring for patch in world.patches for ring in _rings(patch.area)],
        "goals": [ring for goal in world.goals.values() for ring in _rings(goal.area)],
        "props": [ring[0] for prop in world.props if (ring := _rings(prop.footprint))],
        "line": [],
        "start": [],
        "end": [],
        "findings": [],
    }
    if seen is not None:
        x, y = seen.signals["x"], seen.signals["y"]
        good = np.isfinite(x) & np.isfinite(y)
        line = shapely.linestrings(x[good], y[good]) if good.sum() > 1 else None
        way = shapely.get_coordinates(shapely.simplify(line, _FINE)) if line is not None else np.empty((0, 2))
        data |= {
            "line": np.round(way, 2).tolist(),
            "start": _outline(seen, 0),
            "end": _outline(seen, int(np.flatnonzero(good)[-1])) if good.any() else [],
            "findings": [_curve(seen, finding) for finding in findings],
        }
    path.parent.mkdir(parents=True, exist_ok=True)
    write_file(path, json.dumps(data, separators=(",", ":"), allow_nan=False))


def _rings(area: Any) -> list[Any]:
    """Rings of an area, its holes after its outline [m]."""
    if area is None:
        return []
    parts = shapely.get_parts(shapely.simplify(area, _FINE))
    lines = [ring for part in parts for ring in shapely.get_rings(part)]
    return [np.round(shapely.get_coordinates(ring), 2).tolist() for ring in lines]


def _outline(seen: Observation, row: int) -> list[list[float]]:
    corners = seen.corners[row]
    return np.round(corners, 2).tolist() if np.isfinite(corners).all() else []


def _curve(seen: Observation, finding: Finding) -> dict[str, Any]:
    times, margins = _thin(finding.times, finding.margins)
    row = int(np.abs(seen.times - finding.worst_time).argmin())
    return {
        "times": np.round(times, 3).tolist(),
        "margins": [float(f"{value:.4g}") if np.isfinite(value) else None for value in margins],
        "worst_time": round(finding.worst_time, 3),
        "outline": _outline(seen, row),
    }


def _thin(times: Array, values: Array) -> tuple[Array, Array]:
    """At most so many points: of each stretch the lowest and the highest."""
    size = -(-len(times) // (_POINTS // 2))
    if size <= 2:
        return times, values
    known = np.where(np.isfinite(values), values, 0.0)
    parts = [np.arange(begin, min(begin + size, len(times))) for begin in range(0, len(times), size)]
    kept = [row for part in parts for row in (part[known[part].argmin()], part[known[part].argmax()])]
    rows = np.unique([0, *kept, len(times) - 1])
    return times[rows], values[rows]
