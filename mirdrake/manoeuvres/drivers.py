"""Drivers of manoeuvres, for any diagram: ``control: {ego: {kind: "mirdrake.manoeuvres.drivers:PathDriver", ...}}``.

One steers by a :mod:`profile <mirdrake.manoeuvres.profiles>` over time or along a :mod:`line
<mirdrake.manoeuvres.courses>`, and either wants a speed or presses the pedals:

=====================  ===================  ==================
class                  steers               speed
=====================  ===================  ==================
OpenLoopDriver         by a profile         wanted
OpenLoopPedalDriver    by a profile         pedals
PathDriver             along a line         wanted
PathPedalDriver        along a line         pedals
=====================  ===================  ==================

The law of the lines: steering ahead of time for the curvature to come, and feedback of the offset at a point ahead
(K. Kritayakirana and J. C. Gerdes, Autonomous vehicle control at the limits of handling, Int. J. Vehicle Autonomous
Systems 10(4), 2012), with gains that give the offset a natural frequency and a damping::

    δ = (L + K v²) κ(s + v τ) - k (e + ℓ sin(ψ - ψ_line)),   k = ω² (L + K v²) / v²,   ℓ = 2 ζ v / ω

The course ψ of the point is predicted by τ, and both take the yaw rate. A slow car turns as soon as its wheels do:
what the yaw rate differs from that of the line comes back through the steering at once, so that its share is limited.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

from pydrake.systems.framework import Context, DiscreteValues

from mirdrake.controllers.behaviours.outline import ShapedVehicle
from mirdrake.core.checks import check_number
from mirdrake.core.constants import GRAVITY
from mirdrake.core.errors import ConfigError
from mirdrake.core.leaf_system import LeafSystem
from mirdrake.core.signals import declare_state_output, declare_vector_input, signals
from mirdrake.core.vectors import COMMAND, STATE
from mirdrake.manoeuvres.courses import make_line
from mirdrake.manoeuvres.profiles import make_profile

PEDALS = signals(
    ("throttle", "", "0 to 1"),
    ("brake", "", "0 to 1"),
    ("gear", "", "1 drive, 0 neutral, -1 reverse"),
)
_THROTTLE = 0.5
"""Throttle over the speed that is missing, while one is held [s/m]."""

_AT_ONCE = (0.3, 0.25)
"""Largest feedback of the yaw rate on itself at a crawl, and its increase with v / sqrt(g L) [1]."""

_SLOWEST = 0.5
"""Speed below which the law of the lines takes the car for this fast [m/s]."""

Steer = Callable[[float, list[float]], float]
"""Time [s] and state (12) to a bicycle angle [rad]."""


class Rows(NamedTuple):
    """Numbers over time with straight lines between the rows; before the first and after the last they stay."""

    rows: tuple[tuple[float, ...], ...]

    def at(self, time: float) -> tuple[float, ...]:
        """The numbers at a time [s], without the time."""
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
    """Rows of a time and `count` numbers.

    Raises:
        ConfigError: none, another count, or times that do not rise.
    """
    read = [tuple(float(value) for value in row) for row in rows]
    if not read or any(len(row) != count + 1 for row in read):
        raise ConfigError(f"{owner}: rows of a time and {count} number{'s' * (count > 1)} are expected")
    if any(late[0] < early[0] for early, late in pairwise(read)):
        raise ConfigError(f"{owner}: the times must rise")
    return Rows(tuple(read))


class _Driver(LeafSystem):
    """What all of them share: a command every period, and pedals if there are rows of them.

    Input ports:
        state (12) [m, rad, m/s, rad/s]: see :data:`~mirdrake.core.vectors.STATE`.
    Output ports:
        command (3) [m/s, rad, s]: speed, bicycle angle, stamp.
        pedals (3) [1, 1, 1]: throttle, brake, gear; only of the pedal drivers.

    The outputs are discrete states, updated every period.

    Args:
        steer: the law of the steering.
        speeds: rows of time [s] and wanted speed [m/s]; None: always the present speed.
        pedals: rows of time [s], throttle, brake and gear; None: no such port.
        held: speed [m/s] that the throttle holds up to an x of the world [m], whatever `pedals` says.
        period: time between updates [s].

    Raises:
        ConfigError: an argument makes no sense.
    """

    def __init__(
        self,
        steer: Steer,
        *,
        speeds: Sequence[Sequence[float]] | None,
        pedals: Sequence[Sequence[float]] | None,
        period: float,
        held: Sequence[float] | None = None,
    ) -> None:
        super().__init__()
        owner = type(self).__name__
        self._steer = steer
        self._speeds = make_rows(speeds, 1, f"{owner}: speeds") if speeds is not None else None
        self._pedal_rows = make_rows(pedals, 3, f"{owner}: pedals") if pedals is not None else None
        self._held = make_rows([held], 1, f"{owner}: held").rows[0] if held is not None else None
        self.period = check_number(owner, "period", period, unit="s", above=0.0)
        self.state = declare_vector_input(self, "state", STATE)
        self._command = self.DeclareDiscreteState(3)
        self.command = declare_state_output(self, "command", COMMAND, self._command)
        if self._pedal_rows is not None:
            self._pedals = self.DeclareDiscreteState(3)
            self.pedals = declare_state_output(self, "pedals", PEDALS, self._pedals)
        self.DeclareInitializationDiscreteUpdateEvent(self._update)
        self.DeclarePeriodicDiscreteUpdateEvent(period_sec=self.period, offset_sec=0.0, update=self._update)

    def _update(self, context: Context, values: DiscreteValues) -> None:
        time, state = context.get_time(), self.state.Eval(context).tolist()
        speed = self._speeds.at(time)[0] if self._speeds is not None else state[6]
        values.set_value(self._command, [speed, self._steer(time, state), time])
        if self._held is not None and state[0] < self._held[1]:
            throttle = min(max(_THROTTLE * (self._held[0] - state[6]), 0.0), 1.0)
            values.set_value(self._pedals, [throttle, 0.0, 1.0])
        elif self._pedal_rows is not None:
            values.set_value(self._pedals, list(self._pedal_rows.at(time)))


class OpenLoopDriver(_Driver):
    """Steers by a profile, and wants a speed.

    Args:
        profile: of the steering, see :mod:`mirdrake.manoeuvres.profiles`.
        speeds: rows of time [s] and wanted speed [m/s]; left out: the present speed, which is as near to coasting as
            a speed command comes.
        period: time between updates [s].
    """

    def __init__(
        self, profile: Mapping[str, Any], *, speeds: Sequence[Sequence[float]] | None = None, period: float = 0.01
    ) -> None:
        angle = make_profile(profile)
        super().__init__(lambda time, state: angle(time), speeds=speeds, pedals=None, period=period)  # noqa: ARG005


class OpenLoopPedalDriver(_Driver):
    """Steers by a profile, and presses the pedals.

    Args:
        profile: of the steering.
        pedals: rows of time [s], throttle, brake and gear; left out: neutral.
        period: time between updates [s].
    """

    def __init__(
        self, profile: Mapping[str, Any], *, pedals: Sequence[Sequence[float]] | None = None, period: float = 0.01
    ) -> None:
        angle = make_profile(profile)
        super().__init__(
            lambda time, state: angle(time),  # noqa: ARG005
            speeds=None,
            pedals=pedals or [(0.0, 0.0, 0.0, 0.0)],
            period=period,
        )


class PathDriver(_Driver):
    """Follows a line, and wants a speed.

    Args:
        line: see :mod:`mirdrake.manoeuvres.courses`.
        vehicle: what is driven; offered by the diagram.
        speeds: rows of time [s] and wanted speed [m/s]; left out: the present speed.
        ahead: which point follows the line: its distance before the rear axle [m].
        understeer: gradient at the road wheels that is steered ahead of time [rad s²/m].
        frequency: natural frequency of the offset [rad/s].
        damping: its damping ratio [1].
        preview: delay until the steering acts [s].
        integral: share of the feedback of a lasting offset that is added every second [1/s].
        course: which direction is that of the line: 1 of the velocity, 0 of the body, as of a driver who looks where
            the bonnet points and catches a car that turns away under him [1].
        hands: False holds the wheel straight, whatever happens.
        period: time between updates [s].
    """

    def __init__(
        self,
        line: Mapping[str, Any],
        vehicle: ShapedVehicle,
        *,
        speeds: Sequence[Sequence[float]] | None = None,
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
        law = line_law(
            line,
            vehicle,
            ahead=ahead,
            understeer=understeer,
            frequency=frequency,
            damping=damping,
            preview=preview,
            integral=integral,
            course=course,
        )
        super().__init__(law if hands else _straight_ahead, speeds=speeds, pedals=None, period=period)


class PathPedalDriver(_Driver):
    """Follows a line, and presses the pedals; arguments as those of :class:`PathDriver`, `pedals` and `held`.

    Args:
        line: see :class:`PathDriver`, as all but pedals.
        vehicle: see there.
        pedals: rows of time [s], throttle, brake and gear; left out: neutral.
        held: speed [m/s], and x of the world [m] up to which the throttle holds it; then the pedals are pressed.
        ahead: see there.
        understeer: see there.
        frequency: see there.
        damping: see there.
        preview: see there.
        integral: see there.
        course: see there.
        hands: see there.
        period: see there.
    """

    def __init__(
        self,
        line: Mapping[str, Any],
        vehicle: ShapedVehicle,
        *,
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
        law = line_law(
            line,
            vehicle,
            ahead=ahead,
            understeer=understeer,
            frequency=frequency,
            damping=damping,
            preview=preview,
            integral=integral,
            course=course,
        )
        rows = pedals or [(0.0, 0.0, 0.0, 0.0)]
        steer = law if hands else _straight_ahead
        super().__init__(steer, speeds=None, pedals=rows, held=held, period=period)


def _straight_ahead(time: float, state: list[float]) -> float:  # noqa: ARG001
    return 0.0


def line_law(
    data: Mapping[str, Any],
    vehicle: ShapedVehicle,
    *,
    ahead: float,
    understeer: float,
    frequency: float,
    damping: float,
    preview: float,
    integral: float = 0.0,
    course: float = 1.0,
) -> Steer:
    """The law of the module's text for a line; see :class:`PathDriver` for the arguments.

    It remembers where on the line it was, so that a line may cross itself: one law serves one run.
    """
    line, wheelbase = make_line(data), vehicle.geometry.wheelbase
    limit = vehicle.geometry.steering_limit
    check_number("PathDriver", "frequency", frequency, unit="rad/s", above=0.0)
    memory: dict[str, Any] = {"index": None, "time": -math.inf, "sum": 0.0}

    def steer(time: float, state: list[float]) -> float:
        x, y, yaw, vx, vy, rate = state[0], state[1], state[5], state[6], state[7], state[11]
        passed = time - memory["time"]
        if passed < 0.0:
            memory["index"], memory["sum"] = None, 0.0
        memory["time"] = time
        cos, sin = math.cos(yaw), math.sin(yaw)
        index, s, offset = line.project(x + ahead * cos, y + ahead * sin, near=memory["index"])
        memory["index"] = index
        speed = max(math.hypot(vx, vy), _SLOWEST)
        heading, here = line.at(s)
        _, coming = line.at(s + speed * preview)
        reach = wheelbase + max(understeer, 0.0) * speed**2
        omega = min(frequency, speed / wheelbase)
        most = _AT_ONCE[0] + _AT_ONCE[1] * speed / math.sqrt(GRAVITY * wheelbase)
        turning = (rate - speed * here) * min(1.0, most / (2.0 * damping * omega * (abs(ahead) / speed + preview)))
        sideways = vy + ahead * (speed * here + turning)  # of the point that follows the line
        direction = yaw + course * math.atan2(sideways, max(vx, _SLOWEST))
        error = math.remainder(direction - heading, 2.0 * math.pi) + turning * preview
        gain, lever = omega**2 * reach / speed**2, 2.0 * damping * speed / omega
        if 0.0 < passed < 1.0:
            memory["sum"] = min(max(memory["sum"] + integral * gain * offset * passed, -limit), limit)
        angle = math.atan(reach * coming) - gain * (offset + lever * math.sin(error)) - memory["sum"]
        return float(min(max(angle, -limit), limit))

    return steer
