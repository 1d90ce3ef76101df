"""Ackermann geometry: bicycle steering angle to wheel angles and wheel speeds, and back.

A front-steered car whose wheels all roll without side slip turns about one point on the line of the rear axle. With the
origin at the rear axle centre, x forward, y left, that point is (0, R), R = L / tan(delta), for the bicycle angle delta
of an ideal wheel at the front axle centre (L, 0). Written with t = tan(delta), nothing divides by zero at delta = 0
(R. Rajamani, Vehicle Dynamics and Control, 2nd ed., section 2.2; signs: positive to the left)::

    kingpin of the left wheel at (L, Tk/2)     tan(left)  = t / (1 - t Tk/(2 L))
    kingpin of the right wheel at (L, -Tk/2)   tan(right) = t / (1 + t Tk/(2 L))

so that cot(outer) - cot(inner) = Tk/L. The normal of a steered wheel runs through its kingpin and the turning centre.
The wheel centre lies on that normal, the scrub radius c = (Tf - Tk)/2 further out than the kingpin, so its distance
from the turning centre is that of the kingpin, less c for the inner and plus c for the outer wheel. Speed of each wheel
centre over that of the rear axle centre::

    front left   sqrt((1 - t Tk/(2 L))^2 + t^2) - c t/L         rear left   1 - t Tr/(2 L)
    front right  sqrt((1 + t Tk/(2 L))^2 + t^2) + c t/L         rear right  1 + t Tr/(2 L)
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, NamedTuple, Protocol

from pydrake.systems.framework import BasicVector, Context, DiscreteValues

from mirdrake.core.checks import check_number
from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.leaf_system import LeafSystem
from mirdrake.core.signals import declare_state_output, declare_vector_input, declare_vector_output, signals
from mirdrake.core.vectors import SIDES, SPEED_RATIOS

Linkage = Literal["ackermann", "unior", "unior_printed"]
LINKAGES = ("ackermann", "unior", "unior_printed")


class SteeringGeometry(Protocol):
    """The properties of a vehicle that the steering laws use; lengths [m], angles [rad]."""

    @property
    def wheelbase(self) -> float: ...  # noqa: D102
    @property
    def front_track(self) -> float: ...  # noqa: D102
    @property
    def rear_track(self) -> float: ...  # noqa: D102
    @property
    def kingpin_track(self) -> float: ...  # noqa: D102
    @property
    def steering_limit(self) -> float: ...  # noqa: D102
    @property
    def steering_rate(self) -> float | None: ...  # noqa: D102


@dataclass(frozen=True, slots=True)
class AxleGeometry:
    """Steering geometry of given numbers.

    Attributes:
        wheelbase: distance of the axles [m].
        front_track: distance of the front wheel centres, straight ahead [m].
        rear_track: distance of the rear wheel centres [m].
        kingpin_track: distance of the steering axes [m].
        steering_limit: largest angle of the inner wheel [rad].
        steering_rate: largest rate of the bicycle angle [rad/s], None: no limit.
    """

    wheelbase: float
    front_track: float
    rear_track: float
    kingpin_track: float
    steering_limit: float
    steering_rate: float | None = None


class SteeringNumbers(NamedTuple):
    """A steering law as plain numbers; lengths over the wheelbase.

    Attributes:
        kingpin: half of the kingpin track [1].
        rear: half of the rear track [1].
        scrub: scrub radius [1].
        limit: largest bicycle angle, or input of the robot [rad].
        rate: its largest rate [rad/s]; inf: no limit.
        factor: angle of the directly set wheel over the input, of the linkages of the Unior [1].
        printed: whether their equation is taken as it was printed.
    """

    kingpin: float
    rear: float
    scrub: float
    limit: float
    rate: float
    factor: float = 1.0
    printed: bool = False


WheelAngles = tuple[float, float]
WheelRatios = tuple[float, float, float, float]
SteeringLaw = Callable[[SteeringNumbers, float], tuple[WheelAngles, WheelRatios]]
"""Angles of the wheels and ratios of their speeds for a bicycle angle, or for the input of the robot."""


def approach(numbers: SteeringNumbers, steering: float, target: float, period: float) -> float:
    """:meth:`Ackermann.approach` of a law's numbers."""
    # The rate limits first, so that an angle beyond the limit comes back at once.
    step = numbers.rate * period
    return min(max(min(max(target, steering - step), steering + step), -numbers.limit), numbers.limit)


def wheel_angles(numbers: SteeringNumbers, steering: float) -> WheelAngles:
    """:meth:`Ackermann.wheel_angles` of a law's numbers."""
    tangent = math.tan(steering)
    # tan δ = 1 / R for unit wheelbase; the turning centre is R ∓ half of the kingpin track from the kingpins.
    shift = tangent * numbers.kingpin
    return math.atan2(tangent, 1.0 - shift), math.atan2(tangent, 1.0 + shift)


def wheel_speed_ratios(numbers: SteeringNumbers, steering: float) -> WheelRatios:
    """:meth:`Ackermann.wheel_speed_ratios` of a law's numbers."""
    tangent = math.tan(steering)
    shift, scrub, rear = tangent * numbers.kingpin, tangent * numbers.scrub, tangent * numbers.rear
    # Distances from the turning centre over R. The wheel is offset from its kingpin along the axle by the scrub radius.
    left, right = 1.0 - shift, 1.0 + shift
    square = tangent * tangent
    return (
        math.sqrt(left * left + square) - scrub,
        math.sqrt(right * right + square) + scrub,
        1.0 - rear,
        1.0 + rear,
    )


def bicycle_angle(numbers: SteeringNumbers, left: float, right: float) -> float:
    """:meth:`Ackermann.bicycle_angle` of a law's numbers."""
    tan_left, tan_right = math.tan(left), math.tan(right)
    # The inverse of wheel_angles for each wheel; the mean where the two disagree.
    from_left = tan_left / (1.0 + tan_left * numbers.kingpin)
    from_right = tan_right / (1.0 - tan_right * numbers.kingpin)
    return math.atan(0.5 * (from_left + from_right))


def unior_angles(numbers: SteeringNumbers, steering: float) -> WheelAngles:
    """:meth:`Ackermann.unior_wheel_angles` of a law's numbers."""
    direct = numbers.factor * steering
    tangent = math.tan(direct)
    ratio = 2.0 * numbers.kingpin
    # cot(other) = cot(direct) -+ T/L; in both cases the other wheel turns more.
    other = math.copysign(math.atan2(abs(tangent), 1.0 - abs(tangent) * ratio), tangent)
    # As printed, the wheel set directly is the inner one with angles positive to the left.
    if (steering > 0.0) == numbers.printed:
        return direct, other
    return other, direct


def ackermann_wheels(numbers: SteeringNumbers, steering: float) -> tuple[WheelAngles, WheelRatios]:
    """Return the angles of the wheels and the ratios of their speeds for a bicycle angle."""
    return wheel_angles(numbers, steering), wheel_speed_ratios(numbers, steering)


def unior_wheels(numbers: SteeringNumbers, steering: float) -> tuple[WheelAngles, WheelRatios]:
    """Return the angles of the wheels and the ratios of their speeds for an input of the Unior's linkages."""
    angles = unior_angles(numbers, steering)
    return angles, wheel_speed_ratios(numbers, bicycle_angle(numbers, angles[0], angles[1]))


class Ackermann:
    """The steering law of one vehicle on plain floats; equations in the head of the module.

    Args:
        geometry: lengths and limits of the vehicle.

    Attributes:
        wheelbase: distance of the axles L [m].
        numbers: the law as plain numbers.
        wheels: (numbers, bicycle angle) -> angles of the wheels and ratios of their speeds.

    Raises:
        ConfigError: a length is not positive, or the limit is not an angle between 0 and pi/2.
    """

    __slots__ = ("numbers", "wheelbase")

    wheels = staticmethod(ackermann_wheels)

    def __init__(self, geometry: SteeringGeometry):
        owner = "steering geometry"
        self.wheelbase = check_number(owner, "wheelbase", geometry.wheelbase, unit="m", above=0.0)
        front_track = check_number(owner, "front_track", geometry.front_track, unit="m", at_least=0.0)
        rear_track = check_number(owner, "rear_track", geometry.rear_track, unit="m", at_least=0.0)
        kingpin_track = check_number(owner, "kingpin_track", geometry.kingpin_track, unit="m", at_least=0.0)
        inner = check_number(owner, "steering_limit", geometry.steering_limit, unit="rad", above=0.0)
        if inner >= math.pi / 2.0:
            raise ConfigError(
                f"steering_limit must be below pi/2 rad, got {inner:g} rad; is it in degrees?", where=owner
            )
        rate = geometry.steering_rate
        if rate is not None:
            check_number(owner, "steering_rate", rate, unit="rad/s", above=0.0, infinite=True)
        # Lengths over the wheelbase: the laws need no other scale.
        kingpin = 0.5 * kingpin_track / self.wheelbase
        # vehicles.md 2.1: z_max = atan(L / (L / tan(inner) + T/2))
        tangent = math.tan(inner)
        self.numbers = SteeringNumbers(
            kingpin=kingpin,
            rear=0.5 * rear_track / self.wheelbase,
            scrub=0.5 * (front_track - kingpin_track) / self.wheelbase,
            limit=math.atan(tangent / (1.0 + tangent * kingpin)),
            rate=math.inf if rate is None else float(rate),
        )

    @property
    def limit(self) -> float:
        """Bicycle angle at which the inner wheel is at its limit [rad]."""
        return self.numbers.limit

    @property
    def rate(self) -> float:
        """Largest rate of the bicycle angle [rad/s]; inf: no limit."""
        return self.numbers.rate

    def clip(self, steering: float) -> float:
        """Return the bicycle angle [rad], limited so that the inner wheel stays within its limit."""
        return min(max(steering, -self.limit), self.limit)

    def approach(self, steering: float, target: float, *, period: float) -> float:
        """Return the bicycle angle one period after `steering` on the way to `target` [rad], within limit and rate.

        Args:
            steering: present angle [rad].
            target: angle to go to [rad].
            period: time that passes [s].
        """
        return approach(self.numbers, steering, target, period)

    def wheel_angles(self, steering: float) -> tuple[float, float]:
        """Return left and right wheel angle [rad] for a bicycle angle in (-pi/2, pi/2); not limited."""
        return wheel_angles(self.numbers, steering)

    def wheel_speed_ratios(self, steering: float) -> tuple[float, float, float, float]:
        """Return the speed of the four wheel centres along their wheels over that of the rear axle centre [1].

        Divided by the wheel radius and times the speed they are the spin rates of free rolling at constant steering
        angle. While the angle changes, the front wheels also roll about their kingpins: scrub radius times rate, not
        included here.

        Args:
            steering: bicycle angle [rad].

        Returns:
            front left, front right, rear left, rear right.
        """
        return wheel_speed_ratios(self.numbers, steering)

    def curvature(self, steering: float) -> float:
        """Return the curvature of the path of the rear axle centre [1/m] for a bicycle angle [rad]."""
        return math.tan(steering) / self.wheelbase

    def steering(self, curvature: float) -> float:
        """Return the bicycle angle [rad] for a curvature of the path of the rear axle centre [1/m]."""
        return math.atan(self.wheelbase * curvature)

    def bicycle_angle(self, left: float, right: float) -> float:
        """Return the bicycle angle [rad] of two wheel angles, the inverse of :meth:`wheel_angles`.

        Each wheel alone determines a turning centre. If the two differ, the mean of their curvatures is used.

        Args:
            left: angle of the left wheel [rad].
            right: angle of the right wheel [rad].
        """
        return bicycle_angle(self.numbers, left, right)

    # --- the linkage of the Avrora Unior ---------------------------------------------------------------------------

    def unior_wheel_angles(self, steering: float, *, factor: float = 0.5, printed: bool = False) -> tuple[float, float]:
        """Return left and right wheel angle [rad] by the steering equation published for the Avrora Unior.

        One wheel is set directly, the other follows ("Avrora Unior Car-like Robot in Gazebo Environment")::

            steering > 0:  left  = factor steering,  right = arccot(cot(left)  - T/L)
            steering < 0:  right = factor steering,  left  = arccot(cot(right) + T/L)

        Reading notes (vehicles.md section 6): the printed 2B/l1 must be kingpin track over wheelbase T/L. The printed
        signs give Ackermann steering only when a positive angle turns right, so that the wheel set directly is the
        outer one. With positive to the left, as everywhere here, the printed equation turns the outer wheel more than
        the inner (anti-Ackermann).

        Args:
            steering: steering input of the robot [rad], positive to the left.
            factor: angle of the directly set wheel over the input, c in the paper.
            printed: False: the outer wheel is set directly, cot(outer) - cot(inner) = T/L. True: literally as printed.
        """
        return unior_angles(self.numbers._replace(factor=factor, printed=printed), steering)

    def unior_input(self, steering: float, *, factor: float = 0.5) -> float:
        """Return the input [rad] of :meth:`unior_wheel_angles` (outer wheel direct) equivalent to a bicycle angle.

        Args:
            steering: bicycle angle [rad].
            factor: angle of the directly set wheel over the input.
        """
        tangent = math.tan(steering)
        return math.atan2(tangent, 1.0 + abs(tangent) * self.numbers.kingpin) / factor


class UniorLinkage(Ackermann):
    """Steering law of the Avrora Unior; see :meth:`Ackermann.unior_wheel_angles`.

    Its input is that of the robot in place of the bicycle angle; ``limit`` and ``rate`` belong to this input.

    Args:
        geometry: lengths and limits of the vehicle.
        factor: angle of the directly set wheel over the input.
        printed: as printed, or with the outer wheel set directly.
    """

    __slots__ = ()

    wheels = staticmethod(unior_wheels)

    def __init__(self, geometry: SteeringGeometry, *, factor: float = 0.5, printed: bool = False):
        super().__init__(geometry)
        factor = check_number("steering geometry", "factor", factor, above=0.0)
        limit, rate = self.unior_input(self.limit, factor=factor), self.rate / factor
        self.numbers = self.numbers._replace(limit=limit, rate=rate, factor=factor, printed=printed)

    def wheel_angles(self, steering: float) -> tuple[float, float]:
        """Return left and right wheel angle [rad] for an input [rad]; not limited."""
        return unior_angles(self.numbers, steering)

    def wheel_speed_ratios(self, steering: float) -> tuple[float, float, float, float]:
        """Return the ratios for an input [rad], from the bicycle angle of the two wheel angles; see the base class."""
        return unior_wheels(self.numbers, steering)[1]

    def bicycle_angle(self, left: float, right: float) -> float:
        """Return the input [rad] of two wheel angles: the directly set wheel turns less."""
        return min(left, right, key=abs) / self.numbers.factor


def make_steering_law(geometry: SteeringGeometry, linkage: str = "ackermann", *, factor: float = 0.5) -> Ackermann:
    """Return the steering law of a linkage.

    Args:
        geometry: lengths and limits of the vehicle.
        linkage: one of :data:`LINKAGES`.
        factor: input factor of the unior linkages.

    Raises:
        ConfigError: no such linkage, or a factor, length or limit that makes no sense.
    """
    if linkage not in LINKAGES:
        raise ConfigError(f"AckermannSteering: unknown linkage '{linkage}'; {did_you_mean(linkage, LINKAGES)}")
    if linkage == "ackermann":
        return Ackermann(geometry)
    return UniorLinkage(geometry, factor=factor, printed=linkage == "unior_printed")


class AckermannSteering(LeafSystem):
    """Bicycle steering angle to the angles of the two front wheels.

    Input ports:
        steering (1) [rad]: bicycle angle; input of the robot for the unior linkages.

    Output ports:
        left (1), right (1) [rad]: angles of the front wheels.
        speed_ratios (4) [1]: speeds of the wheel centres over that of the rear axle's centre.
        steering_angle (1) [rad]: the bicycle angle (or input) after the limits; only with a `period`.

    Without `period` the system has no state: the angle is limited, not its rate, and the output is computed whenever
    it is asked for. With `period` the angle is also limited in rate, starting from the angle in the Context (0), and
    angles are states, held between the updates.

    Args:
        geometry: lengths and limits of the vehicle, or its steering law.
        period: time between updates [s], or None.
        linkage: "ackermann", or one of the readings of :meth:`Ackermann.unior_wheel_angles`: "unior" (outer wheel
            direct), "unior_printed".
        factor: input factor of the unior linkages.

    Raises:
        ConfigError: lengths, limits or period make no sense, or the linkage is unknown.
    """

    def __init__(
        self,
        geometry: SteeringGeometry | Ackermann,
        *,
        period: float | None = None,
        linkage: Linkage = "ackermann",
        factor: float = 0.5,
    ):
        super().__init__()
        # A law that exists already is shared, so that the blocks of a control unit use the same one.
        given = geometry if isinstance(geometry, Ackermann) else None
        self.law = given or make_steering_law(geometry, linkage, factor=factor)  # type: ignore[arg-type]
        self.period = period
        self.steering = declare_vector_input(self, "steering", signals(("steering", "rad")))
        # Without a period the outputs follow the input at once; with one, rate and limit need a state.
        if period is None:
            needs = {self.steering.ticket()}
            self.left = declare_vector_output(
                self, "left", signals(("left", "rad")), self._calc_left, prerequisites=needs
            )
            self.right = declare_vector_output(
                self, "right", signals(("right", "rad")), self._calc_right, prerequisites=needs
            )
            self.speed_ratios = declare_vector_output(
                self, "speed_ratios", SPEED_RATIOS, self._calc_ratios, prerequisites=needs
            )
            return
        check_number("AckermannSteering", "period", period, unit="s", above=0.0)
        # Angle at the rate limit and both wheel angles; all outputs show the state after the update.
        self._angle = self.DeclareDiscreteState(1)
        self._wheels = [self.DeclareDiscreteState(1) for _ in SIDES]
        self.left, self.right = (
            declare_state_output(self, side, signals((side, "rad")), state)
            for side, state in zip(SIDES, self._wheels, strict=True)
        )
        self.steering_angle = declare_state_output(
            self, "steering_angle", signals(("steering_angle", "rad")), self._angle
        )
        self.speed_ratios = declare_vector_output(
            self, "speed_ratios", SPEED_RATIOS, self._calc_ratios, prerequisites={self.xd_ticket()}
        )
        self.DeclareInitializationDiscreteUpdateEvent(self._initialize)
        self.DeclarePeriodicDiscreteUpdateEvent(period_sec=period, offset_sec=0.0, update=self._update)

    def set_steering(self, context: Context, steering: float) -> None:
        """Write the bicycle angle [rad] from which a system with a period starts into its Context."""
        context.SetDiscreteState(self._angle, [self.law.clip(steering)])
        for state, angle in zip(self._wheels, self.law.wheel_angles(self.law.clip(steering)), strict=True):
            context.SetDiscreteState(state, [angle])

    def _calc_left(self, context: Context, output: BasicVector) -> None:
        output[0] = self.law.wheel_angles(self.law.clip(self.steering.Eval(context).item()))[0]

    def _calc_right(self, context: Context, output: BasicVector) -> None:
        output[0] = self.law.wheel_angles(self.law.clip(self.steering.Eval(context).item()))[1]

    def _calc_ratios(self, context: Context, output: BasicVector) -> None:
        if self.period is None:
            angle = self.law.clip(self.steering.Eval(context).item())
        else:
            angle = context.get_discrete_state(self._angle).value().item()
        output.SetFromVector(self.law.wheel_speed_ratios(angle))

    def _initialize(self, context: Context, values: DiscreteValues) -> None:
        angle = context.get_discrete_state(self._angle).value().item()
        self._hold(values, angle)

    def _update(self, context: Context, values: DiscreteValues) -> None:
        angle = context.get_discrete_state(self._angle).value().item()
        angle = self.law.approach(angle, self.steering.Eval(context).item(), period=self.period or 0.0)
        values.set_value(self._angle, [angle])
        self._hold(values, angle)

    def _hold(self, values: DiscreteValues, steering: float) -> None:
        for state, angle in zip(self._wheels, self.law.wheel_angles(steering), strict=True):
            values.set_value(state, [angle])
