"""From what hands do to a command: keys, game pad and sliders as speed and bicycle steering angle.

Keys and pedals of a game pad change the wanted speed step by step; a slider is the wanted speed. Let go, the vehicle
rolls out. Braked to a stand, it waits until the brake is let go and pressed again, and then reverses.

The steering of keys and stick is limited to what a fast vehicle can follow: the angle whose bicycle curvature tan(δ)/L
gives the lateral acceleration a at the speed v, δ = atan(a L / v²).
"""

from dataclasses import dataclass
from math import atan, copysign
from typing import NamedTuple

LATERAL = 7.0
"""Lateral acceleration that keys and stick ask for at most [m/s²]."""

LEAD = 3.0
"""The wanted speed is never further ahead of the measured one [m/s]: who drives against a wall is soon free again."""

STANDING = 0.2
"""Speed below which a vehicle stands [m/s]."""


@dataclass(frozen=True)
class Hands:
    """What hands do.

    Attributes:
        throttle: 0 to 1.
        brake: 0 to 1.
        steer: -1 (right) to 1 (left).
        stop: the brake is stamped on.
        speed: wanted speed of a slider [m/s]; None: no slider was moved, keys or a pad count.
        steering: wanted bicycle angle of a slider [rad]; None likewise.
        analog: the steering comes from a stick, which needs no smoothing.
    """

    throttle: float = 0.0
    brake: float = 0.0
    steer: float = 0.0
    stop: bool = False
    speed: float | None = None
    steering: float | None = None
    analog: bool = False


@dataclass(frozen=True)
class HandLimits:
    """How a vehicle is driven by hand.

    Attributes:
        forward: highest speed [m/s].
        backward: highest speed in reverse [m/s].
        acceleration: with the throttle pressed [m/s²].
        braking: with the brake pressed [m/s²].
        coasting: deceleration with both let go [m/s²].
        steering: largest bicycle angle [rad].
        wheelbase: [m]
        turning_time: from the middle to the full angle with a key [s].
    """

    forward: float
    backward: float
    acceleration: float
    braking: float
    steering: float
    wheelbase: float
    coasting: float = 0.7
    turning_time: float = 0.55


class HandState(NamedTuple):
    """What is commanded.

    Attributes:
        speed: wanted [m/s].
        steering: wanted bicycle angle [rad].
        waits: braked to a stand, and the brake not let go since.
    """

    speed: float = 0.0
    steering: float = 0.0
    waits: bool = False


def hand_step(state: HandState, hands: Hands, *, measured: float, period: float, limits: HandLimits) -> HandState:
    """The command a moment later.

    Args:
        state: what the last step returned.
        hands: what they do now.
        measured: speed that the vehicle has [m/s].
        period: time since the last step [s].
        limits: of the vehicle.
    """
    waits = state.waits and hands.brake > 0.0
    speed = state.speed
    if hands.stop:
        speed = 0.0
    elif hands.speed is not None:
        wanted = min(max(hands.speed, -limits.backward), limits.forward)
        speed = _towards(speed, wanted, _rate(speed, wanted, limits) * period)
    else:
        pull = hands.throttle - hands.brake
        if pull == 0.0:
            speed = _towards(speed, 0.0, limits.coasting * period)
        elif speed * pull < 0.0 or (pull < 0.0 and measured > STANDING):  # against the motion
            speed = _towards(speed, 0.0, limits.braking * abs(pull) * period)
            waits = pull < 0.0
        elif not waits:
            end = limits.forward if pull > 0.0 else -limits.backward
            speed = _towards(speed, end, limits.acceleration * abs(pull) * period)
    speed = min(max(speed, measured - LEAD), measured + LEAD) if speed != 0.0 else 0.0
    return HandState(speed, _steer(state.steering, hands, measured, period, limits), waits)


def stop_step(state: HandState, *, period: float, limits: HandLimits) -> HandState:
    """The command a moment later when nobody drives: brake to a stand, the wheel held."""
    return HandState(_towards(state.speed, 0.0, limits.braking * period), state.steering, waits=False)


def steering_at(speed: float, limits: HandLimits) -> float:
    """The largest bicycle angle [rad] that keys and stick ask for at a speed [m/s]."""
    if speed == 0.0:
        return limits.steering
    return min(limits.steering, atan(LATERAL * limits.wheelbase / speed**2))


def _steer(last: float, hands: Hands, speed: float, period: float, limits: HandLimits) -> float:
    rate = limits.steering / limits.turning_time
    if hands.steering is not None:
        wanted = min(max(hands.steering, -limits.steering), limits.steering)
        return _towards(last, wanted, 2.0 * rate * period)
    most = steering_at(speed, limits)
    wanted = hands.steer * most
    if hands.analog:
        return _towards(last, wanted, 4.0 * rate * period)
    back = wanted * last <= 0.0 and last != 0.0  # let go, or turned to the other side
    near = max(most / limits.steering, 0.15)  # finer where little is allowed
    return _towards(last, wanted, (2.0 if back else 1.0) * near * rate * period)


def _rate(speed: float, wanted: float, limits: HandLimits) -> float:
    """How fast the speed may change towards another one [m/s²]."""
    faster = abs(wanted) > abs(speed) and speed * wanted >= 0.0
    return limits.acceleration if faster else limits.braking


def _towards(value: float, end: float, most: float) -> float:
    """A value moved towards another one, by no more than `most`."""
    gap = end - value
    return end if abs(gap) <= most else value + copysign(most, gap)
