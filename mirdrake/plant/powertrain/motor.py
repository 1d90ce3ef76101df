"""Torque of an electric motor behind one gear, as a motor and as a generator; all at the wheels.

Speeds and torques are positive in the direction of the gear: ahead in drive, backwards in reverse. The torque is the
smallest of the largest torque, the power over the speed, and the map. It decreases to zero over the last :data:`FADE`
of the top speed of motor or governor. As a generator the motor has its own limits of torque and power, and fades at
walking pace, so that it does not pull the vehicle backwards at standstill. The gear has losses in both directions.
"""

from math import inf
from typing import NamedTuple

from mirdrake.core.interpolation import Rows, read_map
from mirdrake.vehicles.powertrain_spec import AnyPowertrain, ElectricPowertrain, SimplePowertrain

FADE = 0.01
"""Share of the top speed over which the torque decreases to zero [1]."""


class Motor(NamedTuple):
    """Motor with its gear.

    Attributes:
        torque: largest at the motor [N m].
        power: largest at the motor [W].
        gear: motor speed over wheel speed [1].
        top: motor speed at which drive torque ends [rad/s].
        efficiency: efficiency of the gear [1].
        rows: motor speed [rad/s] and largest torque [N m]; empty: none.
        generator_torque: largest of the motor as a generator [N m]; 0: it does not regenerate.
        generator_power: the same of the power [W].
        coast_share: share of the generator's torque with both pedals released [1].
        fade_rate: wheel speed below which regeneration fades [rad/s].
    """

    torque: float
    power: float
    gear: float = 1.0
    top: float = inf
    efficiency: float = 1.0
    rows: Rows = ()
    generator_torque: float = 0.0
    generator_power: float = 0.0
    coast_share: float = 0.0
    fade_rate: float = 1.0


def make_motor(spec: AnyPowertrain, *, radius: float) -> Motor:
    """Return the motor of a vehicle.

    Args:
        spec: spec of vehicle.yaml.
        radius: radius of the driven wheels when rolling [m].
    """
    if isinstance(spec, SimplePowertrain):
        return Motor(spec.max_torque, spec.max_power)
    assert isinstance(spec, ElectricPowertrain)  # an engine has its own law
    # Speeds of the vehicle become speeds of the motor with wheel radius and gear.
    governed = inf if spec.governed_speed is None else spec.governed_speed / radius * spec.gear
    generator = spec.regeneration
    return Motor(
        torque=spec.max_torque / spec.gear,
        power=spec.max_power,
        gear=spec.gear,
        top=min(spec.max_speed, governed),
        efficiency=spec.efficiency,
        rows=tuple(spec.torque_map),
        generator_torque=0.0 if generator is None else generator.max_torque,
        generator_power=0.0 if generator is None else generator.max_power,
        coast_share=0.0 if generator is None else generator.coast_share,
        fade_rate=(1.0 if generator is None else generator.fade_speed) / radius,
    )


def full_torque(motor: Motor, speed: float) -> float:
    """Return the largest torque of the motor itself [N m] at its speed along the gear [rad/s]."""
    size = abs(speed)
    # Constant torque, then constant power, at most the map.
    torque = min(motor.torque, motor.power / size) if size > 0.0 else motor.torque
    if len(motor.rows) > 0:
        torque = min(torque, read_map(motor.rows, size))
    # The torque fades before the top speed, so that it is not switched off in one step.
    if motor.top < inf:
        torque *= min(max((motor.top - speed) / (FADE * motor.top), 0.0), 1.0)
    return torque


def generator_torque(motor: Motor, speed: float) -> float:
    """Return the largest braking torque of the motor itself [N m], positive, at its speed along the gear [rad/s]."""
    if motor.generator_torque == 0.0 or speed <= 0.0:
        return 0.0
    torque = min(motor.generator_torque, motor.generator_power / speed)
    # Regeneration fades out before standstill, where a constant braking torque would switch on and off.
    return torque * min(speed / (motor.gear * motor.fade_rate), 1.0)


def wheel_limits(motor: Motor, rate: float) -> tuple[float, float]:
    """Return the torque of all driven wheels together [N m] with the throttle closed and open.

    Args:
        motor: the motor.
        rate: mean spin rate of the driven wheels, along the gear [rad/s].
    """
    speed = rate * motor.gear
    # Braking power flows from the wheels to the motor: losses of the gear increase the torque at the wheels.
    closed = -motor.coast_share * generator_torque(motor, speed) * motor.gear / motor.efficiency
    return closed, full_torque(motor, speed) * motor.gear * motor.efficiency


def wheel_regeneration(motor: Motor, rate: float) -> float:
    """Return the largest braking torque of the motor at all driven wheels together [N m], positive."""
    return generator_torque(motor, rate * motor.gear) * motor.gear / motor.efficiency


MOTOR_PARTS = (full_torque, generator_torque, wheel_limits, wheel_regeneration)
"""Functions that can be compiled."""
