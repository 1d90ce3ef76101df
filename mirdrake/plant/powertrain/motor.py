"""Torque of an electric motor behind one gear, as a motor and as a generator; all at the wheels.

Speeds and torques are counted along the gear: positive ahead in drive, backwards in reverse. The motor gives the least
of its largest torque, its power over its speed, and its map; from the top speed on, motor or governor, nothing: over
the last :data:`FADE` of it the torque goes down to zero. As a generator it is limited by torque and power of its own
and fades at walking pace, where it would otherwise have to know when the car stands. The gear takes its part of the
power in both directions.
"""

from dataclasses import dataclass
from math import inf

from mirdrake.plant.powertrain.maps import Rows, read_map
from mirdrake.vehicles.powertrain_spec import ElectricPowertrain, Regeneration, SimplePowertrain

FADE = 0.01
"""Part of the top speed over which the torque goes to zero [1]."""


@dataclass(frozen=True, slots=True)
class Motor:
    """A motor and its gear.

    Attributes:
        torque: largest at the motor [N m].
        power: largest at the motor [W].
        gear: motor speed over wheel speed [1].
        top: motor speed at which drive torque ends [rad/s].
        efficiency: of the gear [1].
        rows: motor speed [rad/s] and largest torque [N m]; empty: none.
        regeneration: as a generator, or None.
        fade_rate: wheel speed below which regeneration fades [rad/s].
    """

    torque: float
    power: float
    gear: float = 1.0
    top: float = inf
    efficiency: float = 1.0
    rows: Rows = ()
    regeneration: Regeneration | None = None
    fade_rate: float = 1.0


def make_motor(spec: SimplePowertrain | ElectricPowertrain, *, radius: float) -> Motor:
    """The motor of a vehicle.

    Args:
        spec: of vehicle.yaml.
        radius: of the driven wheels when rolling [m].
    """
    if isinstance(spec, SimplePowertrain):
        return Motor(spec.max_torque, spec.max_power)
    governed = inf if spec.governed_speed is None else spec.governed_speed / radius * spec.gear
    fade = spec.regeneration.fade_speed if spec.regeneration is not None else 1.0
    return Motor(
        torque=spec.max_torque / spec.gear,
        power=spec.max_power,
        gear=spec.gear,
        top=min(spec.max_speed, governed),
        efficiency=spec.efficiency,
        rows=tuple(spec.torque_map),
        regeneration=spec.regeneration,
        fade_rate=fade / radius,
    )


def full_torque(motor: Motor, speed: float) -> float:
    """Largest torque of the motor itself [N m] at its speed along the gear [rad/s]."""
    size = abs(speed)
    torque = min(motor.torque, motor.power / size) if size > 0.0 else motor.torque
    if motor.rows:
        torque = min(torque, read_map(motor.rows, size))
    if motor.top < inf:
        torque *= min(max((motor.top - speed) / (FADE * motor.top), 0.0), 1.0)
    return torque


def generator_torque(motor: Motor, speed: float) -> float:
    """Largest braking torque of the motor itself [N m], positive, at its speed along the gear [rad/s]; ahead only."""
    if motor.regeneration is None or speed <= 0.0:
        return 0.0
    torque = min(motor.regeneration.max_torque, motor.regeneration.max_power / speed)
    return torque * min(speed / (motor.gear * motor.fade_rate), 1.0)


def wheel_limits(motor: Motor, rate: float) -> tuple[float, float]:
    """Torque of all driven wheels together [N m] with the throttle closed and open.

    Args:
        motor: the motor.
        rate: mean spin rate of the driven wheels, along the gear [rad/s].
    """
    speed = rate * motor.gear
    coast = motor.regeneration.coast_share if motor.regeneration is not None else 0.0
    closed = -coast * generator_torque(motor, speed) * motor.gear / motor.efficiency
    return closed, full_torque(motor, speed) * motor.gear * motor.efficiency


def wheel_regeneration(motor: Motor, rate: float) -> float:
    """Largest braking torque of the motor at all driven wheels together [N m], positive."""
    return generator_torque(motor, rate * motor.gear) * motor.gear / motor.efficiency
