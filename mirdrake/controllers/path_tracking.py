"""Path tracking: steering and speed that keep the rear axle centre on a track.

Kinematics in the frame of the centre line (arc length s, offset e to the left, course error theta, curvature kappa)::

    e' = z,   z = (1 - kappa e) tan(theta),   z' = u,
    tan(delta)/L = cos(theta)/(1 - kappa e) (kappa + cos(theta)^2/(1 - kappa e) (u + kappa z tan(theta)))

where ' is d/ds (C. Samson, Control of chained systems, IEEE Trans. Automatic Control 40(1), 1995; the term with kappa'
is left out: kappa is constant but for jumps). Choosing u as below makes the offset from the drivable line e_r(s) (see
:mod:`.drivable_line`) obey a linear equation with distance, not time, as the independent variable, exactly and at any
speed::

    u = (kappa_r - kappa) - (2 zeta/d) (z - e_r') - (e - e_r)/d^2

kappa_r is the curvature of the drivable line, which leads each corner as the steering rate demands. So the feed-forward
needs no feedback to follow the line, and on constant curvature the error of the kinematic bicycle goes to zero.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from pydantic import Field
from pydrake.systems.framework import BasicVector, Context, DiscreteValues

from mirdrake.controllers.ackermann import Ackermann, SteeringGeometry
from mirdrake.controllers.behaviours.outline import ShapedVehicle
from mirdrake.controllers.drivable_line import (
    CentreLine,
    DrivingLimits,
    Track,
    make_centre_line,
    make_drivable_line,
)
from mirdrake.controllers.driver import DrivenWorld, Driver, track_to_follow
from mirdrake.controllers.path_law import Motion, PathNumbers, Place, TrackerNumbers, project, tracker_step
from mirdrake.core.checks import check_number
from mirdrake.core.errors import ConfigError, DivergedError
from mirdrake.core.leaf_system import LeafSystem
from mirdrake.core.maths import wrap_angle
from mirdrake.core.signals import declare_state_output, declare_vector_input
from mirdrake.core.vectors import COMMAND, PATH_ERROR, STATE, Command
from mirdrake.core.yaml_io import Acceleration, Duration, Length, Period, Speed

_SPEED_GRID = 0.25  # lines are planned for multiples of this speed [m/s]


@dataclass(frozen=True, slots=True)
class PathGains:
    """Settings of the tracker that may change while it runs: the numeric parameters of :class:`PathTracker`.

    Attributes:
        speed: set-point [m/s].
        convergence_distance: smallest distance d over which an offset decays [m].
        convergence_time: the same as a time: d is at least speed times this [s].
        damping: damping ratio zeta of the return to the line [1].
        preview_time: delay until the steering acts, of sampling and actuators together [s]; the law works on the pose
            that the vehicle will have by then, at its present speed and yaw rate.
        understeer_gradient: extra steering angle per lateral acceleration [rad s²/m] (Rajamani, section 3.3); 0:
            neutral.

    Raises:
        ConfigError: out of range.
    """

    speed: float
    convergence_distance: float = 1.5
    convergence_time: float = 0.6
    damping: float = 1.0
    preview_time: float = 0.06
    understeer_gradient: float = 0.0

    def __post_init__(self) -> None:
        total = self.speed + self.convergence_distance + self.convergence_time + self.damping + self.preview_time
        lowest = min(self.speed, self.convergence_time, self.preview_time)
        if lowest >= 0.0 < min(self.convergence_distance, self.damping) and math.isfinite(
            total + self.understeer_gradient
        ):
            return  # the quick way: gains are read from the Context at every update
        # Checked one by one only now, for a message that names the gain.
        owner = "PathGains"
        check_number(owner, "speed", self.speed, unit="m/s", at_least=0.0)
        check_number(owner, "convergence_distance", self.convergence_distance, unit="m", above=0.0)
        check_number(owner, "convergence_time", self.convergence_time, unit="s", at_least=0.0)
        check_number(owner, "damping", self.damping, above=0.0)
        check_number(owner, "preview_time", self.preview_time, unit="s", at_least=0.0)
        check_number(owner, "understeer_gradient", self.understeer_gradient, unit="rad s^2/m")


class PathTables:
    """Centre line as plain lists, for fast access.

    Args:
        centre: the sampled track.
    """

    __slots__ = ("closed", "length", "numbers", "rows")

    def __init__(self, centre: CentreLine):
        self.length, self.closed = centre.length, centre.closed
        columns = (centre.x, centre.y, centre.yaw, centre.curvature)
        # There is one curvature less than points: the last point ends the last interval.
        points = min(len(column) for column in columns)
        self.rows: list[list[float]] = np.column_stack([column[:points] for column in columns]).tolist()
        self.numbers = PathNumbers(centre.length, centre.spacing, centre.closed, len(centre.curvature) - 1)

    def project(self, x: float, y: float, *, near: float) -> Place | None:
        """Return the nearest point of the centre line, by Newton's method from a nearby one.

        Args:
            x: position [m].
            y: position [m].
            near: arc length to start from [m].

        Returns:
            The place, or None when the search does not settle within 20 steps.
        """
        settled, place = project(self.numbers, self.rows, x, y, near)
        return place if settled else None


class PathState(NamedTuple):
    """Memory of the tracker between two steps.

    Attributes:
        progress: arc length of the last place [m].
        laps: distance covered over the length of the track [1].
        speed: last speed command [m/s].
        started: 0 before the first step, then 1.
        slip: filtered side slip of the rear axle [rad].
    """

    progress: float = 0.0
    laps: float = 0.0
    speed: float = 0.0
    started: float = 0.0
    slip: float = 0.0


class PathTracker(LeafSystem):
    """A driver that follows a track.

    Input ports:
        state (12) [m, rad, m/s, rad/s]: pose and velocity of the vehicle frame, see
            :data:`~mirdrake.core.vectors.STATE`.

    Output ports:
        command (3) [m/s, rad, s]: speed, steering, stamp.
        path_error (4) [m, rad, m, 1]: lateral, heading, progress, laps of the rear axle centre against the centre line.

    Both outputs are states, held between the updates: the update at time t reads the input at t and shows right
    after t; initialisation shows the first values, so they are right from t = 0.

    Parameters of the Context: the six numbers of :class:`PathGains`. Change them with :meth:`set_gains`, also while
    running. The line is planned for the set-point rounded up to 0.25 m/s, when first needed (about 10 ms for 150 m),
    and remembered.

    State: discrete, group 0 the command, group 1 the path error, group 2 whether it has started, and the filtered side
    slip [rad].

    Args:
        track: the track to follow.
        geometry: lengths and steering limits of the vehicle.
        gains: default gains of a new Context.
        period: time between updates [s].
        limits: accelerations and tolerance.

    Raises:
        ConfigError: the period is not positive, or the track turns tighter than the vehicle can.
        DivergedError: (while running) the vehicle state is not finite.
    """

    def __init__(
        self,
        track: Track,
        geometry: SteeringGeometry,
        *,
        gains: PathGains,
        period: float = 0.02,
        limits: DrivingLimits | None = None,
    ):
        super().__init__()
        self.law = Ackermann(geometry)
        self.track = track
        self.limits = limits or DrivingLimits()
        self.period = check_number("PathTracker", "period", period, unit="s", above=0.0)
        centre = make_centre_line(track)
        # The compiled step interpolates in tables of the centre line.
        self.path = PathTables(centre)
        self.line_for = _planner(centre, self.law, self.limits)
        # Plan once now, so that a track that is too tight is an error before the run.
        self.line_for(gains.speed)
        self.numbers = TrackerNumbers(
            self.law.wheelbase, self.law.limit, self.law.rate, self.limits.lateral, self.limits.acceleration,
            self.limits.deceleration, self.period,
        )  # fmt: skip
        self.state = declare_vector_input(self, "state", STATE)
        # Gains are parameters of the Context, so that tuning changes them without another diagram.
        self._gains = self.DeclareNumericParameter(BasicVector(_to_vector(gains)))
        self._command = self.DeclareDiscreteState(3)
        self._error = self.DeclareDiscreteState(4)
        self._past = self.DeclareDiscreteState(2)
        self.command = declare_state_output(self, "command", COMMAND, self._command)
        self.path_error = declare_state_output(self, "path_error", PATH_ERROR, self._error)
        self.DeclareInitializationDiscreteUpdateEvent(self._initialize)
        self.DeclarePeriodicDiscreteUpdateEvent(period_sec=self.period, offset_sec=0.0, update=self._update)

    def set_gains(self, context: Context, gains: PathGains) -> None:
        """Write gains and speed set-point into a Context of this system."""
        context.get_mutable_numeric_parameter(self._gains).SetFromVector(_to_vector(gains))

    def get_gains(self, context: Context) -> PathGains:
        """Return gains and speed set-point of a Context of this system."""
        return PathGains(*context.get_numeric_parameter(self._gains).value().tolist())

    def _read(self, context: Context) -> PathState:
        _, _, progress, laps = context.get_discrete_state(self._error).value().tolist()
        speed, _, _ = context.get_discrete_state(self._command).value().tolist()
        started, slip = context.get_discrete_state(self._past).value().tolist()
        return PathState(progress, laps, speed, started, slip)

    def _find(self, x: float, y: float, state: PathState) -> Place:
        """Return the projection of a point: near the last one, else anywhere on the track."""
        if not math.isfinite(x + y):
            raise DivergedError(f"path tracking: the vehicle is at ({x}, {y}); the simulation has become unstable")
        place = self.path.project(x, y, near=state.progress) if state.started else None
        if place is None:
            s, lateral = (float(value) for value in self.track.project(x, y))
            place = self.path.project(x, y, near=s)
            if place is None:  # at the centre of a curve every point is as near
                _, _, yaw = (float(value) for value in self.track.pose(s))
                place = Place(s, lateral, yaw, 0.0)
        return place

    def _step(self, context: Context, values: DiscreteValues) -> None:
        x, y, _, _, _, yaw, vx, vy, _, _, _, wz = self.state.Eval(context).tolist()
        state, gains, time = self._read(context), self.get_gains(context), context.get_time()
        line, length = self.line_for(gains.speed), self.path.length
        # The search starts from the last place, because a path may cross itself.
        place = self._find(x, y, state)
        speed, steering, slip = tracker_step(
            self.path.numbers,
            self.path.rows,
            line,
            gains,
            self.numbers,
            place,
            Motion(x, y, yaw, vx, vy, wz),
            state.speed,
            state.slip,
            bool(state.started),
        )
        speed = self._limited(context, values, speed, vx, gains, state)
        covered = 0.0
        if state.started:
            covered = place.s - state.progress
            # Shortest way around a closed track, also across its start.
            covered = math.remainder(covered, length) if self.path.closed else covered
        values.set_value(self._command, Command(speed, steering, time))
        error = [place.lateral, wrap_angle(yaw - place.yaw), place.s, state.laps + covered / length]
        values.set_value(self._error, error)
        values.set_value(self._past, [state.started, slip])

    def _limited(
        self,
        context: Context,  # noqa: ARG002
        values: DiscreteValues,  # noqa: ARG002
        speed: float,
        vx: float,  # noqa: ARG002
        gains: PathGains,  # noqa: ARG002
        state: PathState,  # noqa: ARG002
    ) -> float:
        """Return the speed to command [m/s]; a driver that regards traffic makes it smaller than that on a free road.

        Args:
            context: Context of this system.
            values: next discrete state.
            speed: speed on a free road [m/s].
            vx: present speed of the vehicle [m/s].
            gains: gains and speed set-point.
            state: state at the last step.
        """
        return speed

    def _initialize(self, context: Context, values: DiscreteValues) -> None:
        """Output the first values; the first update, at the same time, is the first step that counts."""
        if not self._read(context).started:
            self._step(context, values)

    def _update(self, context: Context, values: DiscreteValues) -> None:
        self._step(context, values)
        values.get_mutable_value(self._past)[0] = 1.0


def _planner(centre: CentreLine, law: Ackermann, limits: DrivingLimits) -> Callable[[float], list[list[float]]]:
    """Return a function from speed set-point to the table of the line, that caches its plans."""
    known: dict[int, list[list[float]]] = {}

    def line_for(speed: float) -> list[list[float]]:
        # Plans are shared on a grid of speeds; the set-point itself limits the command.
        # Rounded up, as a line that can be driven at a speed can also be driven below it.
        key = max(1, math.ceil(speed / _SPEED_GRID - 1e-9))
        line = known.get(key)
        if line is None:
            planned = make_drivable_line(
                centre,
                speed=key * _SPEED_GRID,
                wheelbase=law.wheelbase,
                steering_limit=law.limit,
                steering_rate=law.rate,
                limits=limits,
            )
            columns = (planned.offset, planned.slope, planned.curvature, planned.speed)
            line = known[key] = np.column_stack(columns).tolist()
        return line

    return line_for


def _to_vector(gains: PathGains) -> list[float]:
    return [
        gains.speed,
        gains.convergence_distance,
        gains.convergence_time,
        gains.damping,
        gains.preview_time,
        gains.understeer_gradient,
    ]


class PathTrackingSpec(Driver):
    """Follow a track of the world."""

    kind: Literal["path_tracking"] = Field(description="follow a track [-]")
    track: str = Field("main", description="name of a track of the world [-]")
    speed: Speed = Field(
        5.0, gt=0.0, le=100.0, description="set-point of the speed [m/s]; corners may be driven slower"
    )
    lateral_acceleration: Acceleration = Field(5.0, gt=0.0, description="largest lateral acceleration [m/s²]")
    acceleration: Acceleration = Field(1.5, gt=0.0, description="largest acceleration [m/s²]")
    deceleration: Acceleration = Field(2.0, gt=0.0, description="largest deceleration [m/s²]")
    tolerance: Length = Field(
        0.1, gt=0.0, description="largest planned offset from the centre line [m]; the car slows down where it needs to"
    )
    convergence_distance: Length = Field(1.5, gt=0.0, description="least distance over which an offset decays [m]")
    convergence_time: Duration = Field(0.6, ge=0.0, description="least time over which an offset decays [s]")
    damping: float = Field(1.0, gt=0.0, description="damping ratio of the return to the line [1]")
    preview_time: Duration = Field(0.06, ge=0.0, le=1.0, description="delay until the steering acts [s]")
    understeer_gradient: float = Field(
        0.0, ge=-0.1, le=0.1, description="extra steering angle per lateral acceleration [rad s²/m]"
    )
    period: Period = Field(0.02, gt=0.0, le=0.2, description="time between updates [s]")

    def gains(self) -> PathGains:
        """Return the settings that may change while the tracker runs."""
        return PathGains(
            self.speed,
            self.convergence_distance,
            self.convergence_time,
            self.damping,
            self.preview_time,
            self.understeer_gradient,
        )

    def limits(self) -> DrivingLimits:
        """Return the limits of the accelerations and of the planned offset."""
        return DrivingLimits(self.lateral_acceleration, self.acceleration, self.deceleration, self.tolerance)

    def make_system(
        self, vehicle: ShapedVehicle, world: DrivenWorld, *, where: str = "", folder: Path | None = None
    ) -> PathTracker:
        """Return the driver as a system with the ports of :class:`PathTracker`, and those that its kind adds.

        Raises:
            ConfigError: the world has no such track, or it is too tight for the vehicle.
        """
        del folder
        try:
            return self.make_tracker(track_to_follow(world, self.track), vehicle.geometry)
        except ConfigError as error:
            raise error.under(self.place("track", where)) from None

    def make_tracker(self, track: Track, geometry: SteeringGeometry) -> PathTracker:
        """Return the tracker of a track for a vehicle; other kinds of drivers return a derived class of it."""
        return PathTracker(track, geometry, gains=self.gains(), period=self.period, limits=self.limits())
