"""Manual input (keys, game pad, sliders) as a command of speed and steering angle of the single-track model.

Keys and triggers change the commanded speed step by step; a slider sets it. Without input the vehicle coasts. After
braking to standstill it reverses only when the brake is released and pressed again.

Steering by keys and stick is limited to a lateral acceleration a at the speed v: δ = atan(a L / v²), from the curvature
tan(δ)/L of the single-track model.
"""

from dataclasses import dataclass
from math import atan, copysign
from typing import NamedTuple

LATERAL = 7.0
"""Largest lateral acceleration that keys and stick can command [m/s²]."""

LEAD = 3.0
"""Largest difference between commanded and measured speed [m/s], so that a vehicle at a wall can soon reverse."""

STANDING = 0.2
"""Speed below which a vehicle is at standstill [m/s]."""


@dataclass(frozen=True)
class ManualInput:
    """Input of a driver.

    Attributes:
        throttle: 0 to 1.
        brake: 0 to 1.
        steer: -1 (right) to 1 (left).
        stop: emergency stop.
        speed: speed of the slider [m/s]; None if keys or a game pad are used.
        steering: steering angle of the slider [rad]; None if keys or a game pad are used.
        analog: whether the steering comes from a stick, which needs no smoothing.
    """

    throttle: float = 0.0
    brake: float = 0.0
    steer: float = 0.0
    stop: bool = False
    speed: float | None = None
    steering: float | None = None
    analog: bool = False


@dataclass(frozen=True)
class ManualLimits:
    """Limits of manual driving.

    Attributes:
        forward: highest speed [m/s].
        backward: highest speed in reverse [m/s].
        acceleration: acceleration with the throttle pressed [m/s²].
        braking: braking with the brake pressed [m/s²].
        coasting: deceleration without input [m/s²].
        steering: largest angle [rad].
        wheelbase: [m].
        turning_time: time of a key press from the middle to the largest angle [s].
    """

    forward: float
    backward: float
    acceleration: float
    braking: float
    steering: float
    wheelbase: float
    coasting: float = 0.7
    turning_time: float = 0.55


class ManualCommand(NamedTuple):
    """Command of a driver.

    Attributes:
        speed: [m/s].
        steering: angle [rad].
        waits: whether the vehicle has braked to standstill and the brake is still pressed.
    """

    speed: float = 0.0
    steering: float = 0.0
    waits: bool = False


def command_step(
    state: ManualCommand, manual: ManualInput, *, measured: float, period: float, limits: ManualLimits
) -> ManualCommand:
    """Return the next command.

    Args:
        state: last command.
        manual: input of the driver.
        measured: speed of the vehicle [m/s].
        period: time since the last step [s].
        limits: limits of the vehicle.
    """
    # Reversing needs a new press of the brake after standstill.
    waits = state.waits and manual.brake > 0.0
    speed = state.speed
    if manual.stop:
        speed = 0.0
    elif manual.speed is not None:
        target = min(max(manual.speed, -limits.backward), limits.forward)
        speed = _towards(speed, target, _rate(speed, target, limits) * period)
    else:
        pull = manual.throttle - manual.brake
        if pull == 0.0:
            speed = _towards(speed, 0.0, limits.coasting * period)
        elif speed * pull < 0.0 or (pull < 0.0 and measured > STANDING):  # against the motion
            speed = _towards(speed, 0.0, limits.braking * abs(pull) * period)
            waits = pull < 0.0
        elif not waits:
            end = limits.forward if pull > 0.0 else -limits.backward
            speed = _towards(speed, end, limits.acceleration * abs(pull) * period)
    # The set-point stays near the measured speed; 0 is exact, so that the vehicle is at rest.
    speed = min(max(speed, measured - LEAD), measured + LEAD) if speed != 0.0 else 0.0
    return ManualCommand(speed, _steer(state.steering, manual, measured, period, limits), waits)


def stop_step(state: ManualCommand, *, period: float, limits: ManualLimits) -> ManualCommand:
    """Return the next command without a driver: brake to standstill, hold the steering angle."""
    return ManualCommand(_towards(state.speed, 0.0, limits.braking * period), state.steering, waits=False)


def steering_at(speed: float, limits: ManualLimits) -> float:
    """Return the largest angle [rad] that keys and stick can command at a speed [m/s]."""
    if speed == 0.0:
        return limits.steering
    # From a = v² tan(δ) / L.
    return min(limits.steering, atan(LATERAL * limits.wheelbase / speed**2))


def _steer(last: float, manual: ManualInput, speed: float, period: float, limits: ManualLimits) -> float:
    rate = limits.steering / limits.turning_time
    if manual.steering is not None:
        target = min(max(manual.steering, -limits.steering), limits.steering)
        return _towards(last, target, 2.0 * rate * period)
    max_angle = steering_at(speed, limits)
    target = manual.steer * max_angle
    # A stick is already smooth; the rate only limits jumps.
    if manual.analog:
        return _towards(last, target, 4.0 * rate * period)
    back = target * last <= 0.0 and last != 0.0  # released, or turned to the other side
    near = max(max_angle / limits.steering, 0.15)  # slower where the limit is small
    return _towards(last, target, (2.0 if back else 1.0) * near * rate * period)


def _rate(speed: float, target: float, limits: ManualLimits) -> float:
    """Return the limit of the acceleration towards another speed [m/s²]."""
    faster = abs(target) > abs(speed) and speed * target >= 0.0
    return limits.acceleration if faster else limits.braking


def _towards(value: float, end: float, max_change: float) -> float:
    """Return a value moved towards another one, by at most `max_change`."""
    gap = end - value
    return end if abs(gap) <= max_change else value + copysign(max_change, gap)
