"""Rewards, termination conditions and starts: built-in ones by name, and user functions as ``module:name``.

::

    def fast_and_centred(moment: Moment) -> float:
        return moment["ego.vx"] * moment.period - 0.1 * abs(moment["ego.lateral_error"])

    def too_far_out(moment: Moment) -> bool:
        return abs(moment["ego.lateral_error"]) > 1.0

    def anywhere(assembly: Assembly, rng: numpy.random.Generator) -> dict[str, Start]:
        return {"ego": Start(rng.uniform(-5.0, 5.0), 0.0, 0.0)}
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import cos, pi
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from pydrake.systems.framework import Context

from mirdrake.assembly.diagram import Assembly
from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.user_modules import load_user_function
from mirdrake.gym.readings import Readings
from mirdrake.worlds import Start

TIPPED = pi / 4
"""Roll or pitch from which a vehicle counts as rolled over [rad]."""


@dataclass(frozen=True)
class Moment:
    """State at the end of a step, the argument of rewards and termination conditions.

    Attributes:
        time: simulated time [s].
        period: period of a step [s].
        action: commands of this step by name, in SI units.
        vehicle: name of the controlled vehicle.
        readings: signals of the diagram.
        context: Context of the whole diagram; it must not be changed.
    """

    time: float
    period: float
    action: Mapping[str, float]
    vehicle: str
    readings: Readings
    context: Context

    def __getitem__(self, name: str) -> float:
        """Return a signal by name, observed or not."""
        reading = self.readings.known.get(name) or self.readings.find(name)[0]
        return reading.read(self.context)

    def of_vehicle(self, name: str) -> float:
        """Return a signal of the controlled vehicle."""
        return self[f"{self.vehicle}.{name}"]


Reward = Callable[[Moment], float]
End = Callable[[Moment], bool]
Starts = Callable[[Assembly, np.random.Generator], dict[str, Start]]


def progress(moment: Moment) -> float:
    """Return the progress along the track in this step [m]; without a track, the distance travelled forward."""
    speed = moment.of_vehicle("vx")
    # Along the track, not along the vehicle: turning away from the line gains nothing, and driving back costs.
    if f"{moment.vehicle}.heading_error" in moment.readings.known:
        speed *= cos(moment.of_vehicle("heading_error"))
    return speed * moment.period


def centred_progress(moment: Moment) -> float:
    """Return the progress, reduced with the distance from the centre line to zero at 2 m and beyond [m]."""
    return progress(moment) * max(0.0, 1.0 - abs(moment.of_vehicle("lateral_error")) / 2.0)


def off_road(moment: Moment) -> bool:
    """Return whether two or more wheels are off the road."""
    return moment.of_vehicle("wheels_on_road") < 3.0


def collision(moment: Moment) -> bool:
    """Return whether a vehicle has a contact other than its tyres on the road."""
    return moment["other_contacts"] > 0.0


def rollover(moment: Moment) -> bool:
    """Return whether the vehicle is tilted by more than 45 degrees."""
    return max(abs(moment.of_vehicle("roll")), abs(moment.of_vehicle("pitch"))) > TIPPED


def anywhere_on_track(assembly: Assembly, rng: np.random.Generator) -> dict[str, Start]:
    """Start every vehicle at a random station of its track, aligned with it, at its own start speed."""
    starts = {}
    for name, start in assembly.starts.items():
        # All random numbers come from the environment's generator, so that the seed of reset determines the starts.
        track_name = assembly.tracks[name]
        if track_name is None:
            raise ConfigError(f"start 'anywhere_on_track': {name} has no track in world '{assembly.parts.world.name}'")
        track = assembly.parts.world.tracks[track_name]
        x, y, yaw = track.pose_at(float(rng.uniform(0.0, track.length)))
        starts[name] = Start(float(x), float(y), float(yaw), start.speed)
    return starts


REWARDS: dict[str, Reward] = {"progress": progress, "centred_progress": centred_progress}
ENDS: dict[str, End] = {"off_road": off_road, "collision": collision, "rollover": rollover}
STARTS: dict[str, Starts] = {"anywhere_on_track": anywhere_on_track}

FunctionT = TypeVar("FunctionT", bound=Callable[..., Any])


def find_function(
    given: str | FunctionT, offered: Mapping[str, FunctionT], *, what: str, folder: Path | None
) -> FunctionT:
    """Return a function from itself, its built-in name, or ``module:name``.

    Args:
        given: function, name or ``module:name`` of the user.
        offered: built-in functions by name.
        what: purpose of the function, for errors.
        folder: folder in which the module is searched, besides the import path and the working directory.

    Raises:
        ConfigError: the function is unknown.
    """
    if not isinstance(given, str):
        if not callable(given):
            raise ConfigError(
                f"{given!r} is not a function; give a function, a built-in name, or module:name", where=what
            )
        return given
    if ":" not in given:
        if given not in offered:
            raise ConfigError(f"unknown {what} '{given}'; {did_you_mean(given, offered)}, or give module:name")
        return offered[given]
    try:
        return load_user_function(given, folder=folder)  # type: ignore[return-value]
    except ConfigError as error:
        raise ConfigError(f"{what} '{given}': {error}") from None
