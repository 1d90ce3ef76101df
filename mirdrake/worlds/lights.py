"""Traffic lights: a fixed cycle of phases, and the stop lines that it controls.

::

    signals:
      crossing: {controls: [main@58], programme: {green: 20 s, amber: 3 s, red: 25 s}, offset: 0 .. 48 s}

The lights of a road network have the names of its signals; their stop lines are those of the network.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, field_validator

from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.yaml_io import Duration, Schema, to_si, where
from mirdrake.worlds.networks import Network
from mirdrake.worlds.networks.lane import Lane
from mirdrake.worlds.pieces import Array
from mirdrake.worlds.track_lanes import station_on
from mirdrake.worlds.tracks import Track

RED, AMBER, GREEN = 0, 1, 2
"""States of a light."""


class Programme(Schema):
    """Fixed cycle of a traffic light: green, amber, red."""

    green: Duration = Field(default=20.0, gt=0.0, le=3600.0, description="duration of green [s]")
    amber: Duration = Field(default=3.0, ge=0.0, le=60.0, description="duration of amber [s]")
    red: Duration = Field(default=25.0, ge=0.0, le=3600.0, description="duration of red [s]")


class LightSpec(Schema):
    """A traffic light with its stop lines."""

    controls: Annotated[list[str], Field(max_length=100)] = Field(
        default_factory=list,
        description="stop lines: main@58 for all lanes of a track in its direction at s = 58 m, main.-1@58 for one "
        "lane; default: those of the network's signal of this name [-]",
    )
    programme: Programme = Field(default_factory=Programme, description="durations of its phases [-]")
    offset: Annotated[Duration, Field(ge=0.0, le=1e5)] = Field(
        default=0.0, description="time of the cycle at the start of the run; 0: green begins [s]"
    )

    @field_validator("controls", mode="before")
    @classmethod
    def _list(cls, value: Any) -> Any:
        return [value] if isinstance(value, str) else value


@dataclass(frozen=True)
class Light:
    """A traffic light."""

    name: str
    green: float
    """duration of green [s]"""
    amber: float
    """[s]"""
    red: float
    """[s]"""
    offset: float
    """time of the cycle at the start [s]"""
    lines: tuple[tuple[str, float], ...]
    """stop lines: lane, and station on it [m]"""

    def state(self, time: ArrayLike) -> Array:
        """Return :data:`RED`, :data:`AMBER` or :data:`GREEN` at times since the start [s], any shape."""
        phase = np.mod(np.asarray(time, dtype=float) + self.offset, self.green + self.amber + self.red)
        return np.where(phase < self.green, GREEN, np.where(phase < self.green + self.amber, AMBER, RED)).astype(float)

    def phase(self, time: float) -> tuple[float, float]:
        """Return the state at a time since the start [s], and for how long it lasts from then on [s]."""
        rest = (time + self.offset) % (self.green + self.amber + self.red)
        for state, duration in ((GREEN, self.green), (AMBER, self.amber)):
            if rest < duration:
                return float(state), duration - rest
            rest -= duration
        return float(RED), self.red - rest


def make_lights(
    specs: Mapping[str, LightSpec], tracks: Mapping[str, Track], lanes: Mapping[str, Lane], network: Network | None
) -> dict[str, Light]:
    """Return the traffic lights of a world by name.

    Raises:
        ConfigError: a stop line is on no lane, or a light has none.
    """
    lights: dict[str, Light] = {}
    for name, spec in specs.items():
        lines = [
            line
            for index, text in enumerate(spec.controls)
            for line in stations_of(text, where(spec, "controls", index), tracks, lanes)
        ]
        # Without stated lines, those of the network that name this signal.
        if not spec.controls and network is not None:
            lines = [(line.lane, line.s) for line in network.stop_lines if line.signal == name]
        if not lines:
            known = [] if network is None else [line.signal for line in network.stop_lines if line.signal]
            hint = f"; {did_you_mean(name, known)}" if known else ""
            raise ConfigError(f"'{name}' controls no stop line; give controls: [TRACK@S]{hint}", where=where(spec))
        programme = spec.programme
        lights[name] = Light(name, programme.green, programme.amber, programme.red, spec.offset, tuple(lines))
    return lights


def stations_of(
    text: str, place: str, tracks: Mapping[str, Track], lanes: Mapping[str, Lane]
) -> list[tuple[str, float]]:
    """Return the lanes and stations of a text ``track@s`` or ``track.lane@s``.

    Args:
        text: the text.
        place: ``file:line: path`` for errors.
        tracks: tracks by name.
        lanes: lanes by id.

    Raises:
        ConfigError: there is no such track or lane, or s is beyond its end.
    """
    road, separator, given = text.rpartition("@")
    try:
        s = float(to_si(given, "m"))
    except (TypeError, ValueError):
        raise ConfigError(f"'{text}' is not a place on a track; write for example main@58", where=place) from None
    # A track controls all of its lanes in its own direction.
    chosen = [lanes[road]] if road in lanes else [
        lane for lane in lanes.values() if lane.road == road and road in tracks and lane.direction > 0
    ]  # fmt: skip
    if not separator or not chosen:
        raise ConfigError(f"there is no track or lane '{road}'; {did_you_mean(road, [*tracks, *lanes])}", where=place)
    track = tracks.get(chosen[0].road)
    if track is not None and not 0.0 <= s <= track.length:
        raise ConfigError(f"s = {s:g} m; the track is {track.length:g} m long", where=place)
    return [(lane.id, station_on(lane, s) if lane.road in tracks else s) for lane in chosen]
