"""Drivers of a platoon: adaptive cruise control (ACC) and its cooperative form (CACC) with a constant time gap.

With the spacing error e = gap - r - h v, speed v, acceleration a and time gap h::

    ACC:   a_wanted = kp e + kd (v_lead - v)
    CACC:  h u' = -u + kp e + kd e' + a_lead(t - theta),   a_wanted = u,   e' = v_lead - v - h a

a_lead is the acceleration of the vehicle ahead, received theta seconds later (after J. Ploeg et al., Design and
experimental evaluation of cooperative adaptive cruise control, ITSC 2011). A message that is lost is replaced by the
one before it.
With a short time gap both amplify disturbances of speed from vehicle to vehicle; the message allows a shorter one.
"""

from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field
from pydrake.systems.framework import Context, DiscreteValues

from mirdrake.actors.road_ahead import ROAD_AHEAD
from mirdrake.controllers.ackermann import SteeringGeometry
from mirdrake.controllers.behaviours.outline import ShapedVehicle
from mirdrake.controllers.drivable_line import Track
from mirdrake.controllers.driver import DrivenWorld
from mirdrake.controllers.path_tracking import PathGains, PathState, PathTracker, PathTrackingSpec
from mirdrake.controllers.traffic_driver import LAG, LEAD
from mirdrake.core.checks import whole_periods
from mirdrake.core.errors import ConfigError
from mirdrake.core.signals import declare_vector_input
from mirdrake.core.yaml_io import Acceleration, Duration, Length


def acc(gap: float, lead: float, speed: float, *, kp: float, kd: float, time_gap: float, standstill: float) -> float:
    """Return the acceleration of the ACC [m/s²].

    Args:
        gap: distance to the vehicle ahead [m].
        lead: its speed [m/s].
        speed: own speed [m/s].
        kp: gain of the spacing error [1/s²].
        kd: gain of the speed difference [1/s].
        time_gap: h [s].
        standstill: r [m].
    """
    return kp * (gap - standstill - time_gap * speed) + kd * (lead - speed)


def cacc_step(
    u: float, gap: float, lead: float, speed: float, acceleration: float, received: float, dt: float,
    *, kp: float, kd: float, time_gap: float, standstill: float,
) -> float:  # fmt: skip
    """Return the acceleration of the CACC after a time step [m/s²]; its filter is exact for constant inputs.

    Args:
        u: its acceleration at the begin of the step [m/s²].
        gap: distance to the vehicle ahead [m].
        lead: its speed [m/s].
        speed: own speed [m/s].
        acceleration: own acceleration [m/s²].
        received: acceleration of the vehicle ahead by the last message [m/s²].
        dt: time step [s].
        kp: gain of the spacing error [1/s²].
        kd: gain of its derivative [1/s].
        time_gap: h [s].
        standstill: r [m].
    """
    error = gap - standstill - time_gap * speed
    rate = lead - speed - time_gap * acceleration
    wish = kp * error + kd * rate + received
    return wish + (u - wish) * float(np.exp(-dt / time_gap))


class PlatoonDriver(PathTracker):
    """A driver that follows a track at a constant time gap behind the vehicle ahead.

    Ports as in :class:`PathTracker`, and:

    Input ports:
        road_ahead (11) [m, m/s, m, -, s, m, -, s, m, -, s]: see :class:`mirdrake.actors.road_ahead.RoadAhead`.

    Args:
        spec: its settings.
        options: arguments of :class:`PathTracker`.
    """

    def __init__(self, spec: "AccSpec", *options: Any, **more: Any) -> None:
        super().__init__(*options, **more)
        self._spec = spec
        self.road_ahead = declare_vector_input(self, "road_ahead", ROAD_AHEAD)
        # One message is the newest, the others are on their way for the delay.
        messages = 1 + ((whole_periods(spec.delay, self.period) or 0) if isinstance(spec, CaccSpec) else 0)
        # u, speed of the vehicle ahead and own speed one step before, number of the step, messages on their way
        self._memory = self.DeclareDiscreteState(np.concatenate(([0.0, np.nan, np.nan, 0.0], np.zeros(messages))))

    def _limited(
        self, context: Context, values: DiscreteValues, speed: float, vx: float, gains: PathGains, state: PathState
    ) -> float:
        del gains  # the set-point of the speed has been regarded already
        gap, lead = self.road_ahead.Eval(context)[:2].tolist()
        spec = self._spec
        memory = context.get_discrete_state(self._memory).value().copy()
        # Free road: NaN marks that there is no earlier speed to differentiate.
        if gap > spec.range:
            values.set_value(self._memory, np.concatenate(([0.0, np.nan, np.nan, memory[3] + 1.0], 0.0 * memory[4:])))
            return speed
        law = {"kp": spec.kp, "kd": spec.kd, "time_gap": spec.time_gap, "standstill": spec.standstill}
        if isinstance(spec, CaccSpec):
            known = np.isfinite(memory[1])
            message = (lead - memory[1]) / self.period if known else 0.0
            own = (vx - memory[2]) / self.period if known else 0.0
            # The receiver keeps the last message.
            if spec.is_lost(int(memory[3])):
                message = memory[4]
            queue = np.concatenate(([message], memory[4:-1]))
            u = cacc_step(memory[0], gap, lead, vx, own, queue[-1], self.period, **law)
            memory[4:] = queue
        else:
            u = acc(gap, lead, vx, **law)
        u = max(-spec.braking_limit, min(u, self.limits.acceleration))
        values.set_value(self._memory, np.concatenate(([u, lead, vx, memory[3] + 1.0], memory[4:])))
        # The command integrates u, but stays near the measured speed: an integral away from it would wind up.
        last = state.speed if state.started else vx
        return max(0.0, min(speed, max(vx - LAG, min(last + u * self.period, vx + LEAD))))


class AccSpec(PathTrackingSpec):
    """Follow a track at a constant time gap behind the vehicle ahead: adaptive cruise control."""

    kind: Literal["acc"] = Field(description="adaptive cruise control [-]")  # type: ignore[assignment]
    kp: float = Field(default=0.2, gt=0.0, le=10.0, description="gain of the spacing error [1/s²]")
    kd: float = Field(default=0.7, ge=0.0, le=10.0, description="gain of the speed difference [1/s]")
    time_gap: Duration = Field(default=1.2, gt=0.0, le=10.0, description="time gap to the vehicle ahead [s]")
    standstill: Length = Field(default=2.0, ge=0.0, le=50.0, description="gap at standstill [m]")
    range: Length = Field(default=150.0, gt=0.0, le=1000.0, description="largest distance to the vehicle ahead [m]")
    braking_limit: Acceleration = Field(default=6.0, gt=0.0, le=20.0, description="largest deceleration [m/s²]")

    def make_tracker(self, track: Track, geometry: SteeringGeometry) -> PathTracker:
        """Return the tracker, which also has the input ``road_ahead``."""
        return PlatoonDriver(self, track, geometry, gains=self.gains(), period=self.period, limits=self.limits())


class CaccSpec(AccSpec):
    """Follow the vehicle ahead with its messages: cooperative adaptive cruise control."""

    kind: Literal["cacc"] = Field(description="cooperative adaptive cruise control [-]")  # type: ignore[assignment]
    time_gap: Duration = Field(default=0.9, gt=0.0, le=10.0, description="time gap to the vehicle ahead [s]")
    delay: Duration = Field(default=0.1, ge=0.0, le=2.0, description="delay of messages [s]; a multiple of the period")
    loss: float = Field(default=0.0, ge=0.0, lt=1.0, description="probability that a message is lost [-]")
    seed: int = Field(default=0, ge=0, description="seed of the lost messages [-]")

    def make_system(
        self, vehicle: ShapedVehicle, world: DrivenWorld, *, where: str = "", folder: Path | None = None
    ) -> PathTracker:
        """Return the driver as a system; see the base class.

        Raises:
            ConfigError: also if the delay is not a multiple of the period.
        """
        if whole_periods(self.delay, self.period) is None:
            place = self.place("delay", where)
            raise ConfigError(f"{self.delay:g} s is not a multiple of the period, {self.period:g} s", where=place)
        return super().make_system(vehicle, world, where=where, folder=folder)

    def is_lost(self, number: int) -> bool:
        """Return whether a message is lost, by its number: the same in every run."""
        return bool(self.loss > 0.0 and np.random.default_rng((self.seed, number)).random() < self.loss)
