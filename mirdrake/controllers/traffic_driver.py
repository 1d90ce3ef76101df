"""Follow a track in traffic: keep the distance to the object ahead by the intelligent driver model, obey lights."""

import math
from typing import Any, Final, Literal

from pydantic import Field
from pydrake.systems.framework import Context, DiscreteValues

from mirdrake.actors.behaviours.idm import Idm, idm
from mirdrake.actors.road_ahead import ROAD_AHEAD
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

_NEXT = 1.0  # [m] by which the distance of a line does not grow, as a vehicle hardly moves backwards
_UNDECIDED, _STOPS, _GOES = 0.0, 1.0, 2.0


class TrafficDriver(PathTracker):
    """A driver that follows a track behind others, stops at red lights, and obeys the right of way of junctions.

    Ports as in :class:`PathTracker`, and:

    Input ports:
        road_ahead (5) [m, m/s, m, -, s]: see :class:`mirdrake.actors.road_ahead.RoadAhead`.

    The acceleration of the intelligent driver model is added up to a speed set-point. At amber it goes on only if a
    comfortable stop is too late and the line is reached before red; the decision is kept until green or the next line.
    At v that needs a stop with v/(2 (T - 2 t)), for an amber of the duration T and the reaction time t, at most.

    Args:
        spec: its settings.
        options: arguments of :class:`PathTracker`.
    """

    def __init__(self, spec: "TrafficDriverSpec", *options: Any, **more: Any) -> None:
        super().__init__(*options, **more)
        self._spec, self._numbers = spec, (0.0, *spec.idm().numbers())
        self.road_ahead = declare_vector_input(self, "road_ahead", ROAD_AHEAD)
        # The decision, and the distance of the line that it is about [m].
        self._decision = self.DeclareDiscreteState([_UNDECIDED, math.inf])

    def _limited(
        self, context: Context, values: DiscreteValues, speed: float, vx: float, gains: PathGains, state: PathState
    ) -> float:
        gap, other, line, light, left = self.road_ahead.Eval(context).tolist()
        spec = self._spec
        last = state.speed if state.started else vx
        a = idm(self._numbers, max(vx, 0.0), gains.speed, gap, other)  # type: ignore[arg-type]
        a = max(-spec.braking_limit, min(a, self.limits.acceleration))
        # The command integrates the acceleration of the model, but stays near the measured speed.
        commanded = max(vx - LAG, min(last + a * self.period, vx + LEAD))
        result = max(0.0, min(speed, commanded))
        if not spec.obeys_lights:
            return result

        decision, known = context.get_discrete_state(self._decision).value().tolist()
        # A line that is farther away than the last one is the next line: that one has been passed.
        if light == GREEN or line > known + _NEXT:
            decision = _UNDECIDED
        elif decision == _UNDECIDED:
            needed = stopping_distance(vx, deceleration=self.limits.deceleration, reaction=spec.reaction)
            # The reaction time is left as a margin, as the speed does not stay the same to the line.
            goes = light == AMBER and line < min(needed, vx * (left - spec.reaction))
            decision = _GOES if goes else _STOPS
        values.set_value(self._decision, [decision, line])
        if decision == _STOPS:
            rest = max(line - spec.line_distance, 0.0)
            result = min(result, brake_speed(rest, deceleration=self.limits.deceleration, reaction=spec.reaction))
        return result


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
