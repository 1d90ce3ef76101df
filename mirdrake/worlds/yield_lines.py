"""Yield lines: vehicles wait at them until those with priority are far enough in time from a place of conflict.

Those of a world are given; those of a junction follow from the right of way of its network.

::

    yield_lines:
      - {lines: [main@62], to: ring@79, gap: 3 s}
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated

from pydantic import Field

from mirdrake.core.yaml_io import Duration, Schema, where
from mirdrake.worlds.lights import stations_of
from mirdrake.worlds.networks import Network
from mirdrake.worlds.networks.lane import Lane
from mirdrake.worlds.tracks import Track

_START = 1.0  # [m/s²] acceleration of the intelligent driver model from standstill
_LENGTH = 5.0  # [m] of a car that must have left the conflict
_GAPS = (3.0, 8.0)  # [s] range of critical gaps
_OCCUPIED = 1.0  # [s] before the conflict, in which a vehicle within the junction occupies it


class YieldLineSpec(Schema):
    """Lines at which vehicles yield to those on a track or a lane."""

    lines: Annotated[list[str], Field(min_length=1, max_length=100)] = Field(
        description="lines where to wait: main@58 for all lanes of a track in its direction, main.-1@58 for one [-]"
    )
    to: str = Field(description="place of conflict on the track or lane with priority: ring@79 [-]")
    gap: Annotated[Duration, Field(gt=0.0, le=60.0)] = Field(
        default=3.0, description="time until a vehicle with priority arrives there that is enough to go [s]"
    )


@dataclass(frozen=True)
class YieldLine:
    """Lines at which vehicles yield to others."""

    lines: tuple[tuple[str, float], ...]
    """lane, and station on it [m]"""
    conflicts: tuple[tuple[str, float, float], ...]
    """places of conflict on the lanes with priority: lane, begin and end of the place on it [m]"""
    gap: float
    """critical gap [s]"""
    approaches: bool = True
    """vehicles on the lanes before that with priority count as well"""


def make_yield_lines(
    specs: Sequence[YieldLineSpec], tracks: Mapping[str, Track], lanes: Mapping[str, Lane]
) -> tuple[YieldLine, ...]:
    """Return the yield lines of a world.

    Raises:
        ConfigError: a line or a place of conflict is on no lane.
    """
    return tuple(
        YieldLine(
            tuple(
                line
                for index, text in enumerate(spec.lines)
                for line in stations_of(text, where(spec, "lines", index), tracks, lanes)
            ),
            tuple((lane, s, s) for lane, s in stations_of(spec.to, where(spec, "to"), tracks, lanes)),
            spec.gap,
        )
        for spec in specs
    )


def right_of_way_lines(network: Network) -> tuple[YieldLine, ...]:
    """Return yield lines at the entries of junctions, by the right of way of a network.

    A vehicle waits for those that have priority, also before the junction, for the time in which it passes the conflict
    from standstill; and for all others that occupy a place of conflict: where nobody has priority, the first drives.
    """
    rows: list[YieldLine] = []
    for conflict in network.conflicts:
        if conflict.kind != "split":
            for lane in conflict.lanes:
                rows += _lines_of(
                    network, lane, conflict.other(lane), conflict.span(lane), conflict.span(conflict.other(lane))
                )
    return tuple(rows)


def _lines_of(
    network: Network, lane: str, other: str, own: tuple[float, float], theirs: tuple[float, float]
) -> Iterator[YieldLine]:
    """Yield the line at which vehicles on a lane of a junction wait for those on another one, if there is one."""
    if network.lanes[lane].junction is None:
        return
    entry, before = _entry(network, lane)
    # Vehicles from one approach follow each other.
    if set(network.lanes[entry].predecessors) & set(network.lanes[_entry(network, other)[0]].predecessors):
        return
    if (other, lane) in network.priorities:
        # From standstill with constant acceleration: s = a t² / 2.
        time = math.sqrt(2.0 * (before + own[1] + _LENGTH) / _START)
        yield YieldLine(((entry, 0.0),), ((other, *theirs),), min(max(time, _GAPS[0]), _GAPS[1]))
    else:
        yield YieldLine(((entry, 0.0),), ((other, *theirs),), _OCCUPIED, approaches=False)


def _entry(network: Network, lane: str) -> tuple[str, float]:
    """Return the first lane of a junction on the way to one of its lanes, and the distance between their begins [m]."""
    before, junction = 0.0, network.lanes[lane].junction
    while len(ways := network.lanes[lane].predecessors) == 1 and network.lanes[ways[0]].junction == junction:
        lane = ways[0]
        before += network.lanes[lane].length
    return lane, before
