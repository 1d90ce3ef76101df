"""Follow a track in traffic: keep the distance to the object ahead by the intelligent driver model, obey lights."""

import math
from collections.abc import Sequence
from typing import Any, Final, Literal

from pydantic import Field
from pydrake.systems.framework import Context, DiscreteValues

from mirdrake.actors.behaviours.idm import Idm, idm
from mirdrake.actors.road_ahead import LINES, ROAD_AHEAD
from mirdrake.controllers.ackermann import SteeringGeometry
from mirdrake.controllers.behaviours.laws import brake_speed, stopping_distance
from mirdrake.controllers.drivable_line import Track
from mirdrake.controllers.driver import Reaction
from mirdrake.controllers.path_tracking import PathGains, PathState, PathTracker, PathTrackingSpec
from mirdrake.core.signals import declare_vector_input
from mirdrake.core.yaml_io import Acceleration, Duration, Length
from mirdrake.worlds.lights import AMBER, GREEN

LEAD: Final = 1.5
"""Largest excess of the commanded over the present speed [m/s], so that a slow vehicle does not accumulate it."""

LAG: Final = 8.0
"""Largest deficit [m/s]; full braking needs several m/s."""

_SAME = 1.0  # [m] within which a line is where it was expected after the motion of a period


def stop_line(
    lines: Sequence[tuple[float, float, float]],
    speed: float,
    *,
    stops: float,
    goes: float,
    deceleration: float,
    reaction: float,
) -> tuple[float, float, float]:
    """Return the distance to the nearest line at which a driver stops [m], and its decisions about amber lights.

    The driver stops at every red light and closed line. At amber it goes on only if a comfortable stop is too late and
    the line is reached before red. At v that needs a stop with v/(2 (T - 2 t)), for an amber of the duration T and the
    reaction time t, at most. A decision to stop is kept until green. One to go on is kept, also when the light becomes
    red, as long as a comfortable stop is too late.

    Args:
        lines: distance [m], state, and the time that is left of it [s] of the next lines, nearest first.
        speed: v [m/s].
        stops: distance to the amber light at which it has decided to stop [m]; infinite: none.
        goes: distance to the farthest light that it has decided to pass [m]; minus infinity: none.
        deceleration: of a comfortable stop [m/s^2].
        reaction: t [s].

    Returns:
        The distance [m], infinite without a line at which it stops, and the new `stops` and `goes`.
    """
    needed = stopping_distance(speed, deceleration=deceleration, reaction=reaction)
    passed = goes
    for line, light, left in lines:
        if light == GREEN:  # no further lines
            break
        stays = light == AMBER and abs(line - stops) < _SAME
        was_passed = line < goes + _SAME and left < math.inf
        # The reaction time is left as a margin, as the speed does not stay the same to the line.
        is_reached = light == AMBER and line < speed * (left - reaction)
        if stays or line >= needed or not (was_passed or is_reached):
            return line, line if light == AMBER else math.inf, passed
        passed = max(passed, line)
    return math.inf, math.inf, passed


class TrafficDriver(PathTracker):
    """A driver that follows a track behind others, stops at red lights, and obeys the right of way of junctions.

    Ports as in :class:`PathTracker`, and:

    Input ports:
        road_ahead (11) [m, m/s, m, -, s, m, -, s, m, -, s]: see :class:`mirdrake.actors.road_ahead.RoadAhead`.

    The acceleration of the intelligent driver model is added up to a speed set-point. The nearest line at which the
    driver stops limits it: see :func:`stop_line`.

    Args:
        spec: its settings.
        options: arguments of :class:`PathTracker`.
    """

    def __init__(self, spec: "TrafficDriverSpec", *options: Any, **more: Any) -> None:
        super().__init__(*options, **more)
        self._spec, self._numbers = spec, (0.0, *spec.idm().numbers())
        self.road_ahead = declare_vector_input(self, "road_ahead", ROAD_AHEAD)
        # Distance to the amber light at which it stops, and to the farthest light that it passes [m].
        self._decisions = self.DeclareDiscreteState([math.inf, -math.inf])

    def _limited(
        self, context: Context, values: DiscreteValues, speed: float, vx: float, gains: PathGains, state: PathState
    ) -> float:
        gap, other, *lines = self.road_ahead.Eval(context).tolist()
        spec = self._spec
        last = state.speed if state.started else vx
        a = idm(self._numbers, max(vx, 0.0), gains.speed, gap, other)  # type: ignore[arg-type]
        a = max(-spec.braking_limit, min(a, self.limits.acceleration))
        # The command integrates the acceleration of the model, but stays near the measured speed.
        commanded = max(vx - LAG, min(last + a * self.period, vx + LEAD))
        result = max(0.0, min(speed, commanded))
        if not spec.obeys_lights:
            return result

        # Both lines have come nearer by the motion of a period.
        stops, goes = context.get_discrete_state(self._decisions).value() - vx * self.period
        reaction, deceleration = spec.reaction, self.limits.deceleration
        line, stops, goes = stop_line(
            [(lines[3 * k], lines[3 * k + 1], lines[3 * k + 2]) for k in range(LINES)],
            max(vx, 0.0), stops=stops, goes=goes, deceleration=deceleration, reaction=reaction,
        )  # fmt: skip
        values.set_value(self._decisions, [stops, goes])
        rest = max(line - spec.line_distance, 0.0)
        return min(result, brake_speed(rest, deceleration=deceleration, reaction=reaction))


class TrafficDriverSpec(PathTrackingSpec):
    """Follow a track behind others, stop at red lights, and obey the right of way of junctions."""

    kind: Literal["traffic"] = Field(description="follow a track in traffic [-]")  # type: ignore[assignment]
    headway: Duration = Field(default=1.5, ge=0.0, le=10.0, description="time headway [s]")
    standstill: Length = Field(default=2.0, gt=0.0, le=50.0, description="gap at standstill [m]")
    braking_limit: Acceleration = Field(default=8.0, gt=0.0, le=20.0, description="largest deceleration [m/s^2]")
    obeys_lights: bool = Field(
        default=True, description="stop at red lights, yield lines and junctions without the right of way [-]"
    )
    line_distance: Length = Field(default=1.0, ge=0.0, le=20.0, description="distance of a stop before the line [m]")
    reaction: Reaction = 0.3

    def idm(self) -> Idm:
        """Return the parameters of the intelligent driver model."""
        return Idm(
            kind="idm",
            acceleration=self.acceleration,
            deceleration=self.deceleration,
            headway=self.headway,
            standstill=self.standstill,
            braking_limit=self.braking_limit,
        )

    def make_tracker(self, track: Track, geometry: SteeringGeometry) -> PathTracker:
        """Return the tracker, which also has the input ``road_ahead``."""
        return TrafficDriver(self, track, geometry, gains=self.gains(), period=self.period, limits=self.limits())
