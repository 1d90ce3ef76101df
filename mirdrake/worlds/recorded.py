"""Recorded motion of actors: the samples of a file, as rows of the world's data."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mirdrake.core.errors import ConfigError
from mirdrake.core.yaml_io import where
from mirdrake.worlds.networks.lane import Lane, lane_along
from mirdrake.worlds.pieces import Array

if TYPE_CHECKING:
    from mirdrake.worlds.actors_spec import ActorSpec

_TIMES = ("time", "t", "t_s", "time_s")
_APART = 0.05  # [m] least distance of the points of a path
_STUB = 1.0  # [m] path of an actor that does not move


def read_recording(spec: "ActorSpec", folder: Path) -> None:
    """Read the file of a recorded actor into its specification, unless that has the rows already.

    Raises:
        ConfigError: the file cannot be read, or a column does not exist, is not a number, or does not rise.
    """
    recorded = spec.recorded
    if recorded is None or recorded.rows:
        return
    # Readers of tables take half a second to load, which worlds without recordings do not wait for.
    from mirdrake.readers.formats import read_table

    place = where(spec, "recorded")
    table = read_table(folder / recorded.file)
    before = f"{recorded.of}." if recorded.of is not None else ""
    time = next((name for name in _TIMES if name in table.columns), "time")
    found = []
    for key, unit in (("x", "m"), ("y", "m"), ("yaw", "rad")):
        name = f"{before}{key}"
        found.append(table.numbers(name if name in table.columns else f"{name}_{unit}", place))
    rows = np.column_stack((table.numbers(time, place), *found))
    rows = rows[np.isfinite(rows).all(axis=1)]
    if len(rows) < 2 or (np.diff(rows[:, 0]) <= 0.0).any():
        raise ConfigError(f"{table.name}: '{time}' must rise, and have two samples or more", where=place)
    rows[:, 0] -= recorded.begin
    rows[:, 3] = np.unwrap(rows[:, 3])
    recorded.rows = [(t, x, y, yaw) for t, x, y, yaw in rows.tolist()]


def recorded_rows(spec: "ActorSpec", rear_axle: float) -> Array:
    """Return time, x, y, yaw of frame A and the distance along its path (k, 5) [s, m, m, rad, m].

    Args:
        spec: a recorded actor, its file read.
        rear_axle: distance of A behind the middle of the prop [m].
    """
    assert spec.recorded is not None
    rows = np.array(spec.recorded.rows, dtype=float)
    if spec.recorded.point == "middle":
        rows[:, 1] -= rear_axle * np.cos(rows[:, 3])
        rows[:, 2] -= rear_axle * np.sin(rows[:, 3])
    return np.column_stack((rows, np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(rows[:, 1:3], axis=0).T))))))


def recorded_start(rows: Array) -> tuple[float, float, float]:
    """Return x [m], y [m] and yaw [rad] of frame A at t = 0; a recording that begins later has its first pose there.

    Args:
        rows: see :func:`recorded_rows`.
    """
    x, y, yaw = (float(np.interp(0.0, rows[:, 0], rows[:, column])) for column in (1, 2, 3))
    return x, y, yaw


def recorded_path(name: str, rows: Array, width: float) -> Lane:
    """Return the path of a recorded actor as a lane, for maps and for other actors that meet it.

    Args:
        name: id of the lane.
        rows: see :func:`recorded_rows`.
        width: width of the actor [m].
    """
    kept = [rows[0, 1:3]]
    for point in rows[1:, 1:3]:
        if np.hypot(*(point - kept[-1])) >= _APART:
            kept.append(point)
    if len(kept) < 2:
        yaw = rows[0, 3]
        kept.append(kept[0] + _STUB * np.array([np.cos(yaw), np.sin(yaw)]))
    return lane_along(name, np.array(kept), width=width)
