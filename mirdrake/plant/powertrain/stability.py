"""Stability control: brakes single wheels to bring the yaw rate to that of the single track.

The reference is the steady state of the linear single track, limited by a lateral acceleration::

    r_ref = v δ / (L + K v²),    |r_ref| <= a_max / v

At a higher yaw rate (oversteer) the outer front wheel is braked, at a lower one (understeer) the inner rear wheel.
Both moments reduce the error. Inputs are speed, yaw rate and steering angle.
"""

from typing import NamedTuple

from mirdrake.plant.powertrain.brakes import Four
from mirdrake.vehicles.powertrain_spec import Stability


class StabilityControl(NamedTuple):
    """Stability control as plain numbers: the fields of :class:`Stability`, if there is one."""

    present: bool
    gain: float = 0.0
    dead_band: float = 0.0
    understeer: float = 0.0
    max_acceleration: float = 0.0
    max_torque: float = 0.0
    min_speed: float = 0.0


def make_stability_control(options: Stability | None) -> StabilityControl:
    """Return the numbers of a stability control."""
    if options is None:
        return StabilityControl(present=False)
    return StabilityControl(True, *(float(getattr(options, name)) for name in StabilityControl._fields[1:]))


def reference_yaw_rate(options: StabilityControl | Stability, speed: float, steering: float, wheelbase: float) -> float:
    """Return the reference yaw rate [rad/s] at a speed [m/s] and a bicycle steering angle [rad]."""
    rate = speed * steering / (wheelbase + options.understeer * speed * speed)
    limit = options.max_acceleration / speed
    return min(max(rate, -limit), limit)


def stability_torques(
    options: StabilityControl | Stability, speed: float, steering: float, yaw_rate: float, wheelbase: float
) -> Four:
    """Return the additional brake torques [N m], front left, front right, rear left, rear right."""
    if speed < options.min_speed:
        return 0.0, 0.0, 0.0, 0.0
    reference = reference_yaw_rate(options, speed, steering, wheelbase)
    error = yaw_rate - reference
    torque = min(max(abs(error) - options.dead_band, 0.0) * options.gain, options.max_torque)
    left, right = (0.0, torque) if error > 0.0 else (torque, 0.0)  # a braked right wheel turns the car to the right
    if error * reference > 0.0 or (reference == 0.0 and torque > 0.0):
        return left, right, 0.0, 0.0  # oversteer: the outer front wheel
    return 0.0, 0.0, left, right  # understeer, or the wrong direction: the inner rear wheel
