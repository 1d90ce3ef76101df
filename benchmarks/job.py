"""The numbers of job W1, which mirdrake and its peers share."""

from math import tan

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SPEED, STEERING, WHEELBASE = 5.0, 0.2, 2.6
"""The circle: speed of the rear axle's centre [m/s], bicycle steering angle [rad], wheelbase [m]."""

DURATION, STEADY = 35.0, 10.0
"""The whole job, and its end over which the figures are taken [s]."""

SETTLING, PARKED = 2.0, 10.0
"""Standing still before and while creep is measured [s]."""


def circle_figures(vx: Array, wz: Array) -> dict[str, float]:
    """Return the accuracy in the steady circle.

    Args:
        vx: speed of the rear axle's centre along the car [m/s] (n).
        wz: yaw rate [rad/s] (n).

    Returns:
        yaw rate against v tan(δ)/L with the speed that the car had, its standard deviation, and the speed against
        that set-point, all in %.
    """
    speed, rate = float(np.mean(vx)), float(np.mean(wz))
    kinematic = speed * tan(STEERING) / WHEELBASE * (1.0 if rate > 0.0 else -1.0)
    return {
        "yaw_error_percent": 100.0 * (rate / kinematic - 1.0),
        "yaw_ripple_percent": 100.0 * float(np.std(wz)) / abs(kinematic),
        "speed_error_percent": 100.0 * (speed / SPEED - 1.0),
    }
