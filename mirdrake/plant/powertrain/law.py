"""Torques of the four wheels from the pedals, in one discrete step.

The step evaluates, in this order: actuators of the pedals, pedal maps, gearbox, motor or engine, regenerative braking,
friction brakes, stability control, antilock valves, traction control. The last three act after the actuator of the
brake, and have no lag of their own.
"""

from collections.abc import MutableSequence, Sequence
from typing import NamedTuple

from mirdrake.core.interpolation import TABLE_PARTS, Rows, read_map
from mirdrake.plant.powertrain.actuator import ActuatorLaw, ActuatorNumbers, actuator_step, follow
from mirdrake.plant.powertrain.antilock import (
    BRAKING,
    DRIVING,
    SlipControl,
    SlipState,
    hold_slip,
    make_slip_control,
)
from mirdrake.plant.powertrain.brakes import (
    BRAKE_PARTS,
    AxleShares,
    Four,
    drive_shares,
    driven_rate,
    split_brakes,
    split_drive,
)
from mirdrake.plant.powertrain.engine import (
    ENGINE_PARTS,
    Engine,
    GearState,
    engine_point,
    gear_ratio,
    make_engine,
    shift,
    usual_gear,
)
from mirdrake.plant.powertrain.maps import PedalMaps
from mirdrake.plant.powertrain.motor import MOTOR_PARTS, Motor, make_motor, wheel_limits, wheel_regeneration
from mirdrake.plant.powertrain.stability import (
    StabilityControl,
    make_stability_control,
    reference_yaw_rate,
    stability_torques,
)
from mirdrake.vehicles.powertrain_spec import EnginePowertrain
from mirdrake.vehicles.spec import VehicleSpec

_GEAR, _SLIP = len(GearState._fields), len(SlipState._fields)


class Measured(NamedTuple):
    """Measured motion of the vehicle.

    Attributes:
        rates: spin rates of the wheels, positive ahead [rad/s].
        speeds: speeds of the wheel centres along their planes, positive ahead [m/s].
        speed: speed of the rear axle's centre, ahead [m/s].
        yaw_rate: [rad/s]
        steering: bicycle angle [rad].
    """

    rates: Four
    speeds: Four
    speed: float = 0.0
    yaw_rate: float = 0.0
    steering: float = 0.0


class Torques(NamedTuple):
    """Torques of the wheels.

    Attributes:
        drive: drive torque on the wheels, positive ahead [N m].
        brake: largest torques of the brakes, not negative [N m].
        status: status in the order of :data:`mirdrake.plant.powertrain.system.STATUS`.
    """

    drive: Four
    brake: Four
    status: tuple[float, float, float, float, float, float, float, float, float]


class PowertrainNumbers(NamedTuple):
    """Powertrain, brakes and pedals as plain numbers and tables.

    Attributes:
        period: time between steps [s].
        has_engine: whether a combustion engine drives; otherwise it is the motor.
        motor: the motor; not used with an engine.
        engine: the engine; not used with a motor.
        shares: shares of the axles in the drive torque.
        brake_share: share of the front axle in the brake torque [1].
        throttle_map: rows of pedal position [1] and share of the drive torque [1].
        brake_map: rows of pedal position [1] and torque of the four brakes [N m].
        throttle: lag of the throttle's actuator.
        throttle_size: length of its memory.
        brake: lag of the brake's actuator.
        brake_size: length of its memory.
        motor_first: whether the motor provides as much of the whole brake torque as it can.
    """

    period: float
    has_engine: bool
    motor: Motor
    engine: Engine
    shares: AxleShares
    brake_share: float
    throttle_map: Rows
    brake_map: Rows
    throttle: ActuatorNumbers
    throttle_size: int
    brake: ActuatorNumbers
    brake_size: int
    motor_first: bool = False


class Assistance(NamedTuple):
    """Antilock, stability and traction control of a vehicle as plain numbers.

    Attributes:
        antilock: antilock brakes.
        stability: stability control.
        traction: traction control.
        radii: rolling radii of the wheels [m].
        inertias: inertias of the wheels about their axles, with rotors [kg m²].
        wheelbase: [m]
    """

    antilock: SlipControl
    stability: StabilityControl
    traction: SlipControl
    radii: Four
    inertias: Four
    wheelbase: float


class PedalTorques(NamedTuple):
    """Torques for the positions of the pedals, before stability, antilock and traction control.

    Attributes:
        throttle: position behind the actuator [1].
        brake: position behind the actuator [1].
        opening: opening of the throttle [1].
        gear: number of the gear, 0 neutral, -1 reverse.
        torque: torque of all driven wheels along the gear [N m].
        brakes: torques of the wheels' brakes [N m].
    """

    throttle: float
    brake: float
    opening: float
    gear: float
    torque: float
    brakes: Four


def throttle_limits(numbers: PowertrainNumbers, gear: float, rate: float, engaged: float) -> tuple[float, float]:
    """Return the torque of all driven wheels along the gear [N m] with the throttle closed and open.

    Args:
        numbers: the powertrain.
        gear: 1 drive, -1 reverse; 0 neutral.
        rate: mean spin rate of the driven wheels, ahead [rad/s].
        engaged: forward gear of the gearbox; 0: the lowest one that does not shift up.
    """
    if gear == 0.0:
        return 0.0, 0.0
    along = gear * rate
    if not numbers.has_engine:
        return wheel_limits(numbers.motor, along)
    number = engaged
    if gear < 0.0:
        number = -1.0
    elif engaged == 0.0:
        number = usual_gear(numbers.engine, along)
    point = engine_point(numbers.engine, number, along)
    return point.closed, point.opened


def pedal_torques(
    numbers: PowertrainNumbers,
    memory: MutableSequence[float],
    at: int,
    throttle: float,
    brake: float,
    gear: float,
    rate: float,
    slipping: bool,
) -> PedalTorques:
    """Advance actuators of the pedals, gearbox, motor or engine, and brakes by one step.

    Args:
        numbers: the powertrain.
        memory: memory of the throttle's actuator, the brake's actuator and the gearbox; changed.
        at: its start in a longer memory.
        throttle: pedal position [1].
        brake: pedal position [1].
        gear: 1 drive, 0 neutral, -1 reverse; rounded.
        rate: mean spin rate of the driven wheels, ahead [rad/s].
        slipping: whether antilock acts, so that the motor does not regenerate.
    """
    # Pedals behind their actuators and maps.
    gear = float((gear > 0.5) - (gear < -0.5))
    behind = at + numbers.throttle_size
    throttle = actuator_step(memory, at, numbers.throttle_size, min(max(throttle, 0.0), 1.0), numbers.throttle)
    brake = actuator_step(memory, behind, numbers.brake_size, min(max(brake, 0.0), 1.0), numbers.brake)
    opening, demand = read_map(numbers.throttle_map, throttle), read_map(numbers.brake_map, brake)

    # Gearbox, and torque of motor or engine.
    shown = gear
    if numbers.has_engine:
        box = behind + numbers.brake_size
        state = shift(numbers.engine, GearState(memory[box], memory[box + 1]), rate, opening, numbers.period)
        memory[box], memory[box + 1] = state.gear, state.shifting
        # Neutral and reverse are shown as demanded, drive as the engaged gear.
        if gear > 0.0:
            shown = state.gear
        closed, opened = throttle_limits(numbers, gear, rate, state.gear)
        # No torque flows while the gearbox shifts.
        if state.shifting > 0.0 and gear > 0.0:
            closed, opened = 0.0, 0.0
    else:
        closed, opened = throttle_limits(numbers, gear, rate, 0.0)
    # Torque is linear in the opening, from drag or creep to full load.
    torque = closed + opening * (opened - closed)

    # Brakes; the motor does not regenerate while antilock acts.
    generator = 0.0
    if not numbers.has_engine and gear != 0.0 and demand > 0.0 and not slipping:
        # Releasing the throttle already regenerates: only the rest is left for the brake pedal.
        generator = max(wheel_regeneration(numbers.motor, gear * rate) + min(torque, 0.0), 0.0)
    motor_brake, brakes = split_brakes(demand, numbers.brake_share, generator, numbers.shares, numbers.motor_first)
    return PedalTorques(throttle, brake, opening, shown, torque - motor_brake, brakes)


NO_MOTOR = Motor(0.0, 0.0)
NO_ENGINE = Engine((1.0,), 1.0, ((0.0, 0.0),), *(0.0,) * 3, 0.0, (0.0, 0.0), (0.0, 0.0), *(1.0,) * 8)
"""The one that a vehicle does not have."""


class PowertrainLaw:
    """Powertrain, brakes and pedals of one vehicle; the caller keeps the memory, a list of `size` numbers.

    Attributes:
        size: length of the memory.
        mass: mass of the vehicle [kg].
        rotating: mass equivalent of the wheels' inertia [kg].
        radii: rolling radii of the wheels [m].
        radius: rolling radius of the driven wheels [m].
        shares: shares of the axles in the drive torque.
        maps: maps of the pedals.
        numbers: the powertrain as plain numbers.
        assistance: antilock, stability and traction control as plain numbers.

    Args:
        spec: vehicle.yaml.
        radii: rolling radii of the wheels [m].
        mass: mass of the vehicle [kg].
        wheelbase: [m]
        inertias: inertias of the wheels about their axles, with rotors [kg m²]; without them, antilock, stability and
            traction control are off.
        rotating: mass equivalent of the rotating parts [kg]; by default from the inertias.
        period: time between steps [s].

    Raises:
        ConfigError: a delay of the actuators is not a multiple of the period.
    """

    def __init__(
        self,
        spec: VehicleSpec,
        *,
        radii: Sequence[float],
        mass: float,
        wheelbase: float,
        inertias: Sequence[float] = (),
        rotating: float | None = None,
        period: float,
    ) -> None:
        self.radii = tuple(radii)
        self.mass = mass
        # Wheels accelerate with the vehicle: I / R² is added to its mass.
        turning = sum(inertia / radius**2 for inertia, radius in zip(inertias, radii, strict=False))
        self.rotating = turning if rotating is None else rotating
        self.shares = drive_shares(spec.drive, spec.powertrain.front_share)
        self.radius = self.shares.front * radii[0] + self.shares.rear * radii[2]
        self.maps = PedalMaps(spec.pedals, brake_torque=spec.brakes.max_torque)
        self._throttle = ActuatorLaw(spec.actuators.throttle, period=period)
        self._brake = ActuatorLaw(spec.actuators.brake, period=period)
        motor, engine = NO_MOTOR, NO_ENGINE
        if isinstance(spec.powertrain, EnginePowertrain):
            engine = make_engine(spec.powertrain, wheel_inertia=mass * self.radius**2)
        else:
            motor = make_motor(spec.powertrain, radius=self.radius)
        regeneration = getattr(spec.powertrain, "regeneration", None)
        self.numbers = PowertrainNumbers(
            period=period,
            has_engine=engine is not NO_ENGINE,
            motor=motor,
            engine=engine,
            shares=self.shares,
            brake_share=spec.brakes.front_share,
            throttle_map=self.maps.throttle,
            brake_map=self.maps.brake,
            throttle=self._throttle.numbers,
            throttle_size=self._throttle.size,
            brake=self._brake.numbers,
            brake_size=self._brake.size,
            motor_first=regeneration is not None and regeneration.distribution == "motor_first",
        )
        known = len(inertias) > 0
        self.assistance = Assistance(
            make_slip_control(spec.brakes.abs if known else None),
            make_stability_control(spec.brakes.esc if known else None),
            make_slip_control(spec.powertrain.traction if known else None),
            (radii[0], radii[1], radii[2], radii[3]),
            (inertias[0], inertias[1], inertias[2], inertias[3]) if known else (0.0, 0.0, 0.0, 0.0),
            wheelbase,
        )
        # Sections of the memory: throttle, brake, gearbox, slip of four braked, then of four driven wheels.
        self.size = self._throttle.size + self._brake.size + _GEAR + 8 * _SLIP

    def rest(self, speed: float = 0.0) -> list[float]:
        """Return the memory at the start, with both pedals released, at a speed [m/s]."""
        gear = usual_gear(self.numbers.engine, speed / self.radius) if self.numbers.has_engine else 1.0
        return [*self._throttle.rest(0.0), *self._brake.rest(0.0), *GearState(gear), *list(SlipState()) * 8]

    def limits(self, gear: float, rate: float) -> tuple[float, float]:
        """Return the torque of all driven wheels along the gear [N m] with the throttle closed and open.

        A gearbox is in its lowest gear that does not shift up.

        Args:
            gear: 1 drive, -1 reverse; 0 neutral.
            rate: mean spin rate of the driven wheels, ahead [rad/s].
        """
        return throttle_limits(self.numbers, gear, rate, 0.0)

    def step(self, memory: list[float], pedals: Sequence[float], measured: Measured) -> tuple[list[float], Torques]:
        """Advance by one step.

        Args:
            memory: memory from the last step, or from :meth:`rest`.
            pedals: throttle [1], brake [1], gear (1 drive, 0 neutral, -1 reverse).
            measured: motion of the vehicle.

        Returns:
            The memory for the next step, and the torques until then.
        """
        memory = list(memory)
        throttle, brake, gear = pedals
        return memory, powertrain_step(self.numbers, self.assistance, memory, throttle, brake, gear, measured)


def powertrain_step(
    numbers: PowertrainNumbers,
    assistance: Assistance,
    memory: MutableSequence[float],
    throttle: float,
    brake: float,
    gear: float,
    measured: Measured,
) -> Torques:
    """Advance by one step, and return the torques until the next one.

    Args:
        numbers: the powertrain.
        assistance: antilock, stability and traction control.
        memory: memory of :class:`PowertrainLaw`, changed.
        throttle: pedal position [1].
        brake: pedal position [1].
        gear: 1 drive, 0 neutral, -1 reverse.
        measured: motion of the vehicle.
    """
    box = numbers.throttle_size + numbers.brake_size
    slips = box + _GEAR
    slipping = False
    for i in range(4):
        slipping = slipping or memory[slips + _SLIP * i] > 0.0
    rate = driven_rate(measured.rates, numbers.shares)
    found = pedal_torques(numbers, memory, 0, throttle, brake, gear, rate, slipping)
    along = min(max(found.gear, -1.0), 1.0)
    torque, brakes, acting = found.torque, found.brakes, 0.0

    # Stability control.
    if assistance.stability.present:
        extra = stability_torques(
            assistance.stability, measured.speed, measured.steering, measured.yaw_rate, assistance.wheelbase
        )
        brakes = (brakes[0] + extra[0], brakes[1] + extra[1], brakes[2] + extra[2], brakes[3] + extra[3])
        for i in range(4):
            acting += 1.0 if extra[i] > 0.0 else 0.0

    # Antilock of each wheel, and traction control of all driven wheels together.
    travel = 1.0 if measured.speed >= 0.0 else -1.0
    if assistance.antilock.present:
        held = (
            _hold(numbers, assistance, memory, slips, 0, brakes[0], travel, measured, BRAKING),
            _hold(numbers, assistance, memory, slips, 1, brakes[1], travel, measured, BRAKING),
            _hold(numbers, assistance, memory, slips, 2, brakes[2], travel, measured, BRAKING),
            _hold(numbers, assistance, memory, slips, 3, brakes[3], travel, measured, BRAKING),
        )
        for i in range(4):
            acting += 1.0 if held[i] < brakes[i] else 0.0
        brakes = held
    drive = split_drive(along * torque, numbers.shares)
    if assistance.traction.present and torque > 0.0:
        # One motor drives all of them: the wheel that slips most limits the torque of all.
        part, driven = 1.0, slips + 4 * _SLIP
        for i in range(4):
            if drive[i] != 0.0:
                demand = abs(drive[i])
                held_torque = _hold(numbers, assistance, memory, driven, i, demand, along, measured, DRIVING)
                part = min(part, held_torque / demand)
        acting += 1.0 if part < 1.0 else 0.0
        torque *= part
        drive = split_drive(along * torque, numbers.shares)
    speed, motor_torque = _at_motor(numbers, along, rate, torque, found.opening, memory[box])
    status = (
        found.throttle,
        found.brake,
        found.gear,
        speed,
        motor_torque,
        along * torque * rate,
        along * torque,
        brakes[0] + brakes[1] + brakes[2] + brakes[3],
        acting,
    )
    return Torques(drive, brakes, status)


def _hold(
    numbers: PowertrainNumbers,
    assistance: Assistance,
    memory: MutableSequence[float],
    first: int,
    wheel: int,
    demand: float,
    along: float,
    measured: Measured,
    direction: float,
) -> float:
    """Return the torque of a wheel with slip control; its memory, in the section from `first`, is changed."""
    # The law knows one direction of travel, so rate and speed are taken along it.
    rate, speed = along * measured.rates[wheel], along * measured.speeds[wheel]
    at = first + _SLIP * wheel
    state, torque = hold_slip(
        SlipState(memory[at], memory[at + 1], memory[at + 2], memory[at + 3], memory[at + 4]),
        demand,
        direction,
        rate,
        speed,
        assistance.antilock if direction == BRAKING else assistance.traction,
        assistance.radii[wheel],
        assistance.inertias[wheel],
        numbers.period,
    )
    memory[at], memory[at + 1], memory[at + 2] = state.active, state.torque, state.rate
    memory[at + 3], memory[at + 4] = state.speed, state.started
    return torque


def _at_motor(
    numbers: PowertrainNumbers, gear: float, rate: float, torque: float, opening: float, engaged: float
) -> tuple[float, float]:
    """Return speed [rad/s] and torque [N m] of motor or engine, for the log; `engaged` is the forward gear."""
    if not numbers.has_engine:
        motor = numbers.motor
        # Losses act against the flow of power: a regenerating motor gets less than the wheels give.
        losses = motor.efficiency if torque < 0.0 else 1.0 / motor.efficiency
        return rate * motor.gear, gear * torque * losses / motor.gear
    engine = numbers.engine
    if gear == 0.0:
        return engine.idle, 0.0
    number = -1.0 if gear < 0.0 else engaged
    point = engine_point(engine, number, gear * rate)
    behind = gear * rate * gear_ratio(engine, number)
    waiting = engine.idle + opening * (engine.stall_speed - engine.idle)
    dragging = 1.0 if behind > engine.idle else 0.0
    return max(behind, waiting), opening * point.full - (1.0 - opening) * engine.drag_torque * dragging


POWERTRAIN_PARTS = (
    *TABLE_PARTS, *MOTOR_PARTS, *ENGINE_PARTS, *BRAKE_PARTS, actuator_step, follow, throttle_limits, pedal_torques,
)  # fmt: skip
"""Functions that can be compiled."""

STEP_PARTS = (*POWERTRAIN_PARTS, powertrain_step, _hold, _at_motor, hold_slip, stability_torques, reference_yaw_rate)
"""Functions that are compiled for :func:`powertrain_step`."""
