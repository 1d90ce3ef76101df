"""Slip control of a wheel by its brake (antilock) or by the motor (traction control).

Inputs are the spin rate ω of the wheel and the speed v of its centre along its plane. A real car estimates v from its
four wheels and its acceleration; here it is exact. With σ = -1 for braking and +1 for driving, R the rolling
radius, v0 = max(v, lowest speed), J the inertia about the axle, and u >= 0 the applied torque::

    slip s = σ (ω R - v) / v0          J dω/dt = σ u + o

where o is all other torque, mainly of the road. It follows from the last period: o = J Δω / h - σ u_last. With
ds/dt = -gain (s - target), the torque with which a slip error decays at the rate `gain` is::

    u = σ J (dv/dt) / R - J gain (s - target) v0 / R - σ o

and the wheel gets the smaller one of this and the driver's demand. The tyre law need not be known. The reaction of the
road is delayed by half a period and by the relaxation of the tyre, so the gain cannot be much above 20 1/s.
"""

from typing import NamedTuple

from mirdrake.vehicles.powertrain_spec import Antilock, Traction

BRAKING, DRIVING = -1.0, 1.0


class SlipControl(NamedTuple):
    """Slip control as plain numbers: the fields of :class:`Antilock` and :class:`Traction`, if there is one."""

    present: bool
    target_slip: float = 0.1
    gain: float = 0.0
    min_speed: float = 0.0


def make_slip_control(options: Antilock | Traction | None) -> SlipControl:
    """Return the numbers of a slip control."""
    if options is None:
        return SlipControl(present=False)
    return SlipControl(True, options.target_slip, options.gain, options.min_speed)


class SlipState(NamedTuple):
    """Memory of the slip control of a wheel.

    Attributes:
        active: 1 while the control intervenes, else 0.
        torque: last torque u [N m].
        rate: last spin rate [rad/s].
        speed: last speed of the wheel's centre [m/s].
        started: 0 before the first step.
    """

    active: float = 0.0
    torque: float = 0.0
    rate: float = 0.0
    speed: float = 0.0
    started: float = 0.0


def hold_slip(
    state: SlipState,
    demand: float,
    direction: float,
    rate: float,
    speed: float,
    options: SlipControl | Antilock | Traction,
    radius: float,
    inertia: float,
    period: float,
) -> tuple[SlipState, float]:
    """Return the torque of one wheel for the next period; equations in the head of the module.

    Args:
        state: result of the last step.
        demand: demanded torque [N m], not negative.
        direction: :data:`BRAKING` or :data:`DRIVING`.
        rate: spin rate of the wheel, positive in the direction of travel [rad/s].
        speed: speed of its centre along its plane in that direction [m/s].
        options: target, gain, lowest speed.
        radius: radius of the rolling wheel [m].
        inertia: inertia about the axle, with the rotor of the motor [kg m²].
        period: [s]

    Returns:
        The state, and the torque [N m], never more than `demand`.
    """
    slip = direction * (rate * radius - speed) / max(speed, options.min_speed)
    too_slow = direction == BRAKING and speed < options.min_speed
    # A first step has no earlier rate to compare with; below the lowest speed the brake may lock the wheel.
    if state.started == 0.0 or too_slow or demand <= 0.0:
        return SlipState(0.0, demand, rate, speed, 1.0), demand
    # o, the torque of all other sources, and u, with which the slip error decays; see the head of the module.
    others = inertia * (rate - state.rate) / period - direction * state.torque
    pull = inertia * (speed - state.speed) / (period * radius)
    reach = inertia * options.gain * max(speed, options.min_speed) / radius
    limit = max(direction * (pull - others) - reach * (slip - options.target_slip), 0.0)
    # Hysteresis: control starts at half of the target slip and ends when the demand is below its limit.
    active = limit < demand and (state.active > 0.0 or slip > 0.5 * options.target_slip)
    torque = limit if active else demand
    return SlipState(1.0 if active else 0.0, torque, rate, speed, 1.0), torque
