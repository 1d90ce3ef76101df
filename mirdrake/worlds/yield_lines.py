"""Yield lines: vehicles wait at them until those with priority are far enough in time from a place of conflict.

They are for tracks that meet; junctions of a network have a right of way, see :mod:`mirdrake.worlds.networks.ways`.

::

    yield_lines:
      - {lines: [main@62], to: ring@79, gap: 3 s}
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated

from pydantic import Field

from mirdrake.core.yaml_io import Duration, Schema, where
from mirdrake.worlds.lights import stations_of
from mirdrake.worlds.networks.lane import Lane
from mirdrake.worlds.tracks import Track


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
