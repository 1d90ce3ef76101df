"""Follow a track in traffic: keep the distance to the object ahead by the intelligent driver model, obey lights."""

import math
from collections.abc import Sequence
from typing import Any, Final, Literal, NamedTuple

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


class Braking(NamedTuple):
    """How a driver stops at a line."""

    deceleration: float
    """of a comfortable stop [m/s²]"""
    limit: float
    """largest deceleration [m/s²]"""
    reaction: float
    """[s]"""
    distance: float
    """of a stop before the line [m]"""


def stop_line(
    lines: Sequence[tuple[float, float, float]], speed: float, braking: Braking, *, stops: float, goes: float
) -> tuple[float, float, float]:
    """Return the distance to the nearest line at which a driver stops [m], and its decisions about amber lights.

    The driver stops at every red light and closed line. At amber it goes on only if a comfortable stop is too late and
    the line is reached before red, also if it brakes for a line behind that; the reaction time t is left as a margin.
    At v without such a line, another stop needs v/(2 (T - 2 t)) at most, for an amber of the duration T.
    A decision to stop is kept until green. One to go on is kept while half of the margin is enough, and at red if the
    vehicle cannot stop any more.

    Args:
        lines: distance [m], state, and the time that is left of it [s] of the next lines, nearest first.
        speed: v [m/s].
        braking: how it stops.
        stops: distance to the amber light at which it has decided to stop [m]; infinite: none.
        goes: distance to the farthest light that it has decided to pass [m]; minus infinity: none.

    Returns:
        The distance [m], infinite without a line at which it stops, and the new `stops` and `goes`.
    """
    needed = stopping_distance(speed, deceleration=braking.deceleration, reaction=braking.reaction)
    least = stopping_distance(speed, deceleration=braking.limit, reaction=0.0)
    stop, state = math.inf, float(GREEN)
    passed: list[float] = []
    # From the farthest line to the nearest one, as a stop behind a line makes its passage later.
    for line, light, left in reversed(lines):
        was_passed = line < goes + _SAME
        if light == AMBER:
            margin = (0.5 if was_passed else 1.0) * braking.reaction
            goes_on = line < needed and arrival_time(line, speed, stop, braking) < left - margin
            goes_on &= abs(line - stops) >= _SAME
        else:
            # At red, only if it was to be passed at amber; a closed line never changes by time.
            goes_on = light == GREEN or (was_passed and line < least and left < math.inf)
        if goes_on:
            passed.append(line)
        else:
            stop, state = line, light
    passed = [line for line in passed if line < min(stop, needed)]
    return stop, stop if state == AMBER else math.inf, max(passed, default=-math.inf)


def arrival_time(line: float, speed: float, stop: float, braking: Braking) -> float:
    """Return the time until a driver reaches a line if it stops at another one behind it [s]; -inf: it has passed it.

    The speed is v up to the braking profile of :func:`mirdrake.controllers.behaviours.laws.brake_speed`, with the
    deceleration a and the reaction time t. On the profile, the gap g to the stop fulfils g = v t + v²/(2 a), so that
    dg = (t + v/a) dv, and the time from v1 to v2 is the integral of dg/v::

        (v1 - v2)/a + t ln(v1/v2)

    Args:
        line: distance to the line [m].
        speed: v [m/s].
        stop: distance to the line of the stop [m]; infinite: none.
        braking: how it stops.
    """
    if line <= 0.0:
        return -math.inf
    if speed <= 0.0:
        return math.inf
    a, reaction, gap = braking.deceleration, braking.reaction, stop - braking.distance
    steady = gap - stopping_distance(speed, deceleration=a, reaction=reaction)  # distance before the profile
    if line <= steady:
        return line / speed
    last = brake_speed(gap - line, deceleration=a, reaction=reaction)
    if last <= 0.0:
        return math.inf
    # Above the profile already, the speed is that of the profile from now on.
    first = min(speed, brake_speed(gap, deceleration=a, reaction=reaction))
    return max(steady, 0.0) / speed + (first - last) / a + reaction * math.log(first / last)


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
        braking = Braking(self.limits.deceleration, spec.braking_limit, spec.reaction, spec.line_distance)
        rows = [(lines[3 * k], lines[3 * k + 1], lines[3 * k + 2]) for k in range(LINES)]
        line, stops, goes = stop_line(rows, max(vx, 0.0), braking, stops=stops, goes=goes)
        values.set_value(self._decisions, [stops, goes])
        rest = max(line - spec.line_distance, 0.0)
        return min(result, brake_speed(rest, deceleration=braking.deceleration, reaction=spec.reaction))


class TrafficDriverSpec(PathTrackingSpec):
    """Follow a track behind others, stop at red lights, and obey the right of way of junctions."""

    kind: Literal["traffic"] = Field(description="follow a track in traffic [-]")  # type: ignore[assignment]
    headway: Duration = Field(default=1.5, ge=0.0, le=10.0, description="time headway [s]")
    standstill: Length = Field(default=2.0, gt=0.0, le=50.0, description="gap at standstill [m]")
    braking_limit: Acceleration = Field(default=8.0, gt=0.0, le=20.0, description="largest deceleration [m/s²]")
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
