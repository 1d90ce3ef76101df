"""Brake torque of single wheels against a yaw rate that is not that of the single track.

The reference is the steady state of the linear single track, with the lateral acceleration that the road can give::

    r_ref = v δ / (L + K v²),    |r_ref| <= a_max / v

Turning more than that (oversteer), the outer front wheel is braked; turning less (understeer), the inner rear one: both
moments turn the car towards the reference. Measured are speed, yaw rate and steering angle.
"""

from mirdrake.plant.powertrain.brakes import Four
from mirdrake.vehicles.powertrain_spec import Stability


def reference_yaw_rate(options: Stability, *, speed: float, steering: float, wheelbase: float) -> float:
    """Yaw rate [rad/s] that belongs to a speed [m/s] and a bicycle steering angle [rad]."""
    rate = speed * steering / (wheelbase + options.understeer * speed * speed)
    most = options.max_acceleration / speed
    return min(max(rate, -most), most)


def stability_torques(options: Stability, *, speed: float, steering: float, yaw_rate: float, wheelbase: float) -> Four:
    """Brake torques [N m] that are added, front left, front right, rear left, rear right."""
    if speed < options.min_speed:
        return 0.0, 0.0, 0.0, 0.0
    wanted = reference_yaw_rate(options, speed=speed, steering=steering, wheelbase=wheelbase)
    error = yaw_rate - wanted
    torque = min(max(abs(error) - options.dead_band, 0.0) * options.gain, options.max_torque)
    left, right = (0.0, torque) if error > 0.0 else (torque, 0.0)  # a braked right wheel turns the car to the right
    if error * wanted > 0.0 or (wanted == 0.0 and torque > 0.0):
        return left, right, 0.0, 0.0  # too much: the outer front wheel
    return 0.0, 0.0, left, right  # too little, or the wrong way: the inner rear wheel
