"""Drivers of manoeuvres, for any diagram: ``control: {ego: {kind: "mirdrake.manoeuvres.drivers:PathDriver", ...}}``.

=====================  ===============================================================
class                  steers
=====================  ===============================================================
OpenLoopDriver         by a :mod:`profile <mirdrake.manoeuvres.profiles>` over time
PathDriver             along a :mod:`line <mirdrake.manoeuvres.courses>`
=====================  ===============================================================

With `speeds` they output a speed command, with `pedals` the positions of the pedals.

The steering law of PathDriver: feedforward of the curvature ahead, and feedback of the lateral error of a point ahead
of the rear axle (K. Kritayakirana and J. C. Gerdes, Autonomous vehicle control at the limits of handling, Int. J.
Vehicle Autonomous Systems 10(4), 2012). Its gains give the lateral error a natural frequency and a damping ratio::

    δ = (L + K v²) κ(s + v τ) - k (e + ℓ sin(ψ - ψ_line)),   k = ω² (L + K v²) / v²,   ℓ = 2 ζ v / ω

The course ψ of the point is predicted by τ; course and prediction contain the yaw rate. A slow car yaws as soon as its
wheels are steered, so its yaw rate error acts on the steering without delay; the share of this feedback is limited.
"""

import math
from collections.abc import Mapping, MutableSequence, Sequence
from itertools import pairwise
from typing import ClassVar, NamedTuple

from pydrake.systems.framework import Context, DiscreteValues

from mirdrake.controllers.behaviours.outline import ShapedVehicle
from mirdrake.core.checks import check_number
from mirdrake.core.constants import GRAVITY
from mirdrake.core.errors import ConfigError
from mirdrake.core.leaf_system import LeafSystem
from mirdrake.core.maths import wrap_angle
from mirdrake.core.signals import declare_state_output, declare_vector_input, signals
from mirdrake.core.vectors import COMMAND, STATE
from mirdrake.core.wording import plural
from mirdrake.manoeuvres.base import Array
from mirdrake.manoeuvres.courses import line_at, make_line, project_line
from mirdrake.manoeuvres.profiles import make_profile

PEDALS = signals(
    ("throttle", "", "0 to 1"),
    ("brake", "", "0 to 1"),
    ("gear", "", "1 drive, 0 neutral, -1 reverse"),
)
THROTTLE = 0.5
"""Throttle over the speed error while a speed is held [s/m]."""

_LEAST_FEEDBACK, _FEEDBACK_SLOPE = 0.3, 0.25
"""Largest feedback of the yaw rate error at standstill, and its increase with v / sqrt(g L) [1]."""

_LEAST_SPEED = 0.5
"""Least speed of the steering law [m/s]; it divides by the speed."""


LINE_MEMORY = (-1.0, -math.inf, 0.0)
"""Memory of a driver on a line at the start: index of the last sample (-1: none), last time [s], integral [rad]."""


class LineNumbers(NamedTuple):
    """Settings of a driver on a line; see :class:`PathDriver`.

    Attributes:
        wheelbase: of the vehicle [m].
        limit: largest steering angle [rad].
        ahead: distance of the point that follows the line ahead of the rear axle [m].
        understeer: understeer gradient [rad s²/m].
        frequency: natural frequency of the lateral error [rad/s].
        damping: its damping ratio [1].
        preview: delay until the steering acts [s].
        integral: integral gain over the gain of the lateral error [1/s].
        course: weight of the course against the heading [1].
        hands: False holds the wheel straight.
    """

    wheelbase: float
    limit: float
    ahead: float
    understeer: float
    frequency: float
    damping: float
    preview: float
    integral: float
    course: float
    hands: bool


class Rows(NamedTuple):
    """Numbers over time, interpolated linearly between rows and constant before the first and after the last."""

    rows: tuple[tuple[float, ...], ...]

    def at(self, time: float) -> tuple[float, ...]:
        """Return the columns after the first at a time [s], interpolated and constant beyond the ends."""
        before = self.rows[0]
        for row in self.rows:
            if row[0] > time:
                if row is before:
                    return row[1:]
                part = (time - before[0]) / (row[0] - before[0])
                return tuple(a + part * (b - a) for a, b in zip(before[1:], row[1:], strict=True))
            before = row
        return before[1:]


def make_rows(rows: Sequence[Sequence[float]], count: int, owner: str) -> Rows:
    """Return rows that each have a time and `count` numbers.

    Raises:
        ConfigError: the rows are empty, a row has another length, or a time decreases.
    """
    checked = [tuple(float(value) for value in row) for row in rows]
    if not checked or any(len(row) != count + 1 for row in checked):
        raise ConfigError(f"each row must have a time and {plural(count, 'number')}", where=owner)
    if any(later[0] < earlier[0] for earlier, later in pairwise(checked)):
        raise ConfigError("the times must not decrease", where=owner)
    return Rows(tuple(checked))


class _Driver(LeafSystem):
    """Base class of both drivers: a command every period, and pedal positions if they are given.

    Input ports:
        state (12) [m, rad, m/s, rad/s]: see :data:`~mirdrake.core.vectors.STATE`.
    Output ports:
        command (3) [m/s, rad, s]: speed, bicycle angle, stamp.
        pedals (3) [1, 1, 1]: throttle, brake, gear; only with `pedals`.

    The outputs are discrete states, updated every period.

    Args:
        speeds: rows of time [s] and speed command [m/s]; None commands the present speed, which is close to coasting.
        pedals: rows of time [s], throttle, brake and gear; None declares no such port.
        held: speed [m/s] that the throttle holds up to an x of the world [m], before `pedals` apply.
        period: time between updates [s].

    Raises:
        ConfigError: an argument is out of range.
    """

    sampled_with: ClassVar[str] = "period"

    def __init__(
        self,
        *,
        speeds: Sequence[Sequence[float]] | None,
        pedals: Sequence[Sequence[float]] | None,
        held: Sequence[float] | None = None,
        period: float,
    ) -> None:
        super().__init__()
        owner = type(self).__name__
        self.speeds = make_rows(speeds, 1, f"{owner}: speeds") if speeds is not None else None
        self.pedal_rows = make_rows(pedals, 3, f"{owner}: pedals") if pedals is not None else None
        self.held = make_rows([held], 1, f"{owner}: held").rows[0] if held is not None else None
        self.period = check_number(owner, "period", period, unit="s", above=0.0)
        # Updates at t = 0 and every period: outputs are discrete states, which breaks the loop from state to command.
        self.state = declare_vector_input(self, "state", STATE)
        self._command = self.DeclareDiscreteState(3)
        self.command = declare_state_output(self, "command", COMMAND, self._command)
        # The port of the pedals exists only with pedals: the diagram then bypasses the speed control.
        if self.pedal_rows is not None:
            self._pedals = self.DeclareDiscreteState(3)
            self.pedals = declare_state_output(self, "pedals", PEDALS, self._pedals)
        self.DeclareInitializationDiscreteUpdateEvent(self._update)
        self.DeclarePeriodicDiscreteUpdateEvent(period_sec=self.period, offset_sec=0.0, update=self._update)

    def _steer(self, time: float, state: list[float]) -> float:
        """Return the bicycle angle [rad] at a time [s]; each driver defines it."""
        raise NotImplementedError

    def _update(self, context: Context, values: DiscreteValues) -> None:
        time, state = context.get_time(), self.state.Eval(context).tolist()
        # Without a speed command the present speed is commanded, so that speed control adds no force.
        speed = self.speeds.at(time)[0] if self.speeds is not None else state[6]
        values.set_value(self._command, [speed, self._steer(time, state), time])
        if self.pedal_rows is None:
            return
        if self.held is not None and state[0] < self.held[1]:
            # Up to the x at which it is released the throttle holds the speed; later the rows of the pedals apply.
            throttle = min(max(THROTTLE * (self.held[0] - state[6]), 0.0), 1.0)
            values.set_value(self._pedals, [throttle, 0.0, 1.0])
        else:
            values.set_value(self._pedals, list(self.pedal_rows.at(time)))


class OpenLoopDriver(_Driver):
    """Driver that steers by a profile over time.

    Args:
        profile: profile of the steering, see :mod:`mirdrake.manoeuvres.profiles`.
        speeds: rows of time [s] and speed command [m/s]; by default the present speed.
        pedals: rows of time [s], throttle, brake and gear.
        period: time between updates [s].
    """

    def __init__(
        self,
        profile: Mapping[str, object],
        *,
        speeds: Sequence[Sequence[float]] | None = None,
        pedals: Sequence[Sequence[float]] | None = None,
        period: float = 0.01,
    ) -> None:
        self.profile = make_profile(profile)
        super().__init__(speeds=speeds, pedals=pedals, period=period)

    def _steer(self, time: float, state: list[float]) -> float:  # noqa: ARG002
        return self.profile(time)


class PathDriver(_Driver):
    """Driver that follows a line by the steering law of this module.

    It remembers its station on the line, so that a line may cross itself; a time before the last one resets it.

    Attributes:
        line: the line.
        numbers: settings as plain numbers.

    Args:
        line: see :mod:`mirdrake.manoeuvres.courses`.
        vehicle: vehicle that is driven; offered by the diagram.
        speeds: rows of time [s] and speed command [m/s]; by default the present speed.
        pedals: rows of time [s], throttle, brake and gear.
        held: speed [m/s] that the throttle holds up to an x of the world [m], before `pedals` apply.
        ahead: distance of the point that follows the line ahead of the rear axle [m].
        understeer: understeer gradient at the road wheels, for the feedforward [rad s²/m].
        frequency: natural frequency of the lateral error [rad/s].
        damping: its damping ratio [1].
        preview: delay until the steering acts [s].
        integral: integral gain over the gain of the lateral error [1/s].
        course: direction that is aligned with the line: 1 for that of the velocity, 0 for that of the body; the latter
            is a driver who corrects the heading of a car that yaws on its own [1].
        hands: False holds the wheel straight.
        period: time between updates [s].
    """

    def __init__(
        self,
        line: Mapping[str, object],
        vehicle: ShapedVehicle,
        *,
        speeds: Sequence[Sequence[float]] | None = None,
        pedals: Sequence[Sequence[float]] | None = None,
        held: Sequence[float] | None = None,
        ahead: float = 0.0,
        understeer: float = 0.0,
        frequency: float = 3.0,
        damping: float = 1.0,
        preview: float = 0.1,
        integral: float = 0.0,
        course: float = 1.0,
        hands: bool = True,
        period: float = 0.01,
    ) -> None:
        self.line = make_line(line)
        self.numbers = LineNumbers(
            wheelbase=vehicle.geometry.wheelbase,
            limit=vehicle.geometry.steering_limit,
            ahead=ahead,
            understeer=max(understeer, 0.0),
            frequency=check_number("PathDriver", "frequency", frequency, unit="rad/s", above=0.0),
            damping=damping,
            preview=preview,
            integral=integral,
            course=course,
            hands=hands,
        )
        self._memory = list(LINE_MEMORY)
        super().__init__(speeds=speeds, pedals=pedals, held=held, period=period)

    def _steer(self, time: float, state: list[float]) -> float:
        if not self.numbers.hands:
            return 0.0
        x, y, yaw, vx, vy, rate = state[0], state[1], state[5], state[6], state[7], state[11]
        return steer_along(self.numbers, self.line.table, self._memory, 0, time, x, y, yaw, vx, vy, rate)


def steer_along(
    numbers: LineNumbers,
    line: Array,
    memory: MutableSequence[float],
    at: int,
    time: float,
    x: float,
    y: float,
    yaw: float,
    vx: float,
    vy: float,
    rate: float,
) -> float:
    """Return the bicycle angle [rad] of a driver on a line; the law in the head of the module.

    Args:
        numbers: settings of the driver.
        line: table of the line.
        memory: :data:`LINE_MEMORY`, changed.
        at: its start in a longer memory.
        time: present time [s].
        x: position of the rear axle's centre [m].
        y: the same [m].
        yaw: heading [rad].
        vx: velocity ahead [m/s].
        vy: velocity to the left [m/s].
        rate: yaw rate [rad/s].
    """
    # Time that goes back means a new run with the same driver: forget the station and the integral.
    elapsed = time - memory[at + 1]
    if elapsed < 0.0:
        memory[at], memory[at + 2] = -1.0, 0.0
    memory[at + 1] = time

    # Lateral error of the point ahead, and the line there and where the steering will act.
    ahead, preview, wheelbase = numbers.ahead, numbers.preview, numbers.wheelbase
    index, s, offset = project_line(line, x + ahead * math.cos(yaw), y + ahead * math.sin(yaw), int(memory[at]))
    memory[at] = float(index)
    speed = max(math.hypot(vx, vy), _LEAST_SPEED)
    heading, curvature = line_at(line, s)
    # Curvature where the vehicle will be when the steering acts: the preview compensates its delay.
    curvature_ahead = line_at(line, s + speed * preview)[1]

    # The yaw rate error acts on the steering without delay: its share is limited, or a slow car would oscillate.
    # L + K v² is steering per curvature: v / (L + K v²) is the steady yaw-rate gain of the single-track model.
    reach = wheelbase + numbers.understeer * speed**2
    # ω of at most v / L keeps the lever ℓ = 2 ζ v / ω at 2 ζ L or more at low speed.
    omega = min(numbers.frequency, speed / wheelbase)
    max_feedback = _LEAST_FEEDBACK + _FEEDBACK_SLOPE * speed / math.sqrt(GRAVITY * wheelbase)
    # The limit bounds the loop gain of the yaw rate, which the steering changes directly: 2 ζ ω (ahead / v + τ).
    share = min(1.0, max_feedback / (2.0 * numbers.damping * omega * (abs(ahead) / speed + preview)))
    turning = (rate - speed * curvature) * share
    # Velocity of the point across the vehicle, with the yaw rate of the line and the share of the error.
    sideways = vy + ahead * (speed * curvature + turning)  # of the point that follows the line
    # Between heading (course = 0) and direction of motion (course = 1) of the point.
    direction = yaw + numbers.course * math.atan2(sideways, max(vx, _LEAST_SPEED))
    # The wrapped angle is in [-π, π]: lines of several laps have headings beyond that. The prediction looks ahead by τ.
    error = wrap_angle(direction - heading) + turning * preview

    # Feedforward and feedback; a long pause, as between two runs, does not count for the integral.
    gain, lever = omega**2 * reach / speed**2, 2.0 * numbers.damping * speed / omega
    limit = numbers.limit
    if 0.0 < elapsed < 1.0:
        # The integral removes the steady error of the feedforward; it is clamped at the steering limit against windup.
        memory[at + 2] = min(max(memory[at + 2] + numbers.integral * gain * offset * elapsed, -limit), limit)
    # Signs of ISO 8855: an offset to the left needs steering to the right.
    angle = math.atan(reach * curvature_ahead) - gain * (offset + lever * math.sin(error)) - memory[at + 2]
    return min(max(angle, -limit), limit)


STEERING_PARTS = (steer_along, project_line, line_at)
"""Functions that can be compiled."""
