"""Speed loop of a vehicle: wheel-speed set-points, trimmed until the vehicle reaches its set-point.

The feed-forward is free rolling, speed over wheel radius times the Ackermann ratio of each wheel; a PI controller adds
a speed trim, which takes up slip and tyre deflection.
"""

from collections.abc import Sequence

from mirdrake.core.pid import PidGains, PidLimits, PidNumbers, PidState, pid_step

WheelRates = tuple[float, float, float, float]

CRUISE_GAINS = PidGains(kp=0.5, ki=0.5)
"""Trim per speed error: kp [1], ki [1/s]. Half the error at once, the rest in about three seconds."""

CRUISE_LIMITS = PidLimits(minimum=-1.0, maximum=1.0)
"""The trim is limited to 1 m/s."""

_EMPTY = PidState()


def wheel_speed_setpoints(speed: float, ratios: WheelRates, radii: WheelRates) -> WheelRates:
    """Return the spin rates of free rolling [rad/s].

    Args:
        speed: speed of the rear axle centre [m/s].
        ratios: speeds of the wheel centres over that speed, from :meth:`Ackermann.wheel_speed_ratios`.
        radii: rolling radius of each wheel [m].
    """
    front_left, front_right, rear_left, rear_right = ratios
    return (
        speed * front_left / radii[0],
        speed * front_right / radii[1],
        speed * rear_left / radii[2],
        speed * rear_right / radii[3],
    )


def cruise_step(
    state: Sequence[float],
    reference: float,
    measurement: float,
    period: float,
    gains: PidGains | PidNumbers = CRUISE_GAINS,
    limits: PidLimits = CRUISE_LIMITS,
) -> tuple[PidState, float]:
    """Advance the speed loop by one period.

    When the set-point is exactly zero there is no trim and the integral is reset, so that the wheels stop and
    stay stopped.

    Args:
        state: what the last step returned, or its numbers; ``PidState()`` at first.
        reference: set-point of the speed [m/s].
        measurement: speed of the rear axle centre [m/s].
        period: time since the last step [s].
        gains: gains from speed error to speed trim.
        limits: limits of the trim [m/s].

    Returns:
        The state for the next step, and the trimmed speed [m/s] for :func:`wheel_speed_setpoints`.
    """
    # An integral left from the drive would move a vehicle that has to stand.
    if reference == 0.0:
        return _EMPTY, 0.0
    after, trim = pid_step(state, reference, measurement, gains, period, limits)
    return after, reference + trim
