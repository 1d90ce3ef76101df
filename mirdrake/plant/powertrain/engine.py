"""Torque of a combustion engine behind a torque converter and an automatic gearbox; all at the wheels.

The converter is quasi-static. With ωt the speed behind it (wheel speed x ratios) and ωe that of the engine::

    ωe = max(ωt, stall_speed)
    torque ratio = stall_ratio - (stall_ratio - 1) (ωt / ωe) / coupling, at least 1

At full throttle the engine runs at its stall speed until the wheels reach it, and the converter multiplies its torque.
Partial throttle interpolates between closed and full throttle: T = closed + throttle (full - closed). With the throttle
closed the engine drags, or creeps while it idles. The inertia J of the engine reduces the torque by the share
m r² / (m r² + J i²), which neglects slip of the tyres; as an inertia of the wheels it would change with every gear.
(T. Gillespie, Fundamentals of Vehicle Dynamics, chapter 2, for the quasi-static converter and the mass factor.)

The gearbox shifts up and down by the speed behind the converter. Both limits rise linearly with the throttle. The
torque is zero during a shift.
"""

from typing import NamedTuple

from mirdrake.core.interpolation import Rows, read_map
from mirdrake.vehicles.powertrain_spec import EnginePowertrain


class GearState(NamedTuple):
    """Memory of the gearbox.

    Attributes:
        gear: number of the forward gear, from 1.
        shifting: remaining time of a shift [s].
    """

    gear: float = 1.0
    shifting: float = 0.0


class EnginePoint(NamedTuple):
    """Operating point of the engine.

    Attributes:
        speed: speed of the engine at full throttle [rad/s].
        full: torque of the engine at full throttle [N m].
        closed: torque of all driven wheels together with the throttle closed [N m].
        opened: the same with the throttle open [N m].
    """

    speed: float
    full: float
    closed: float
    opened: float


class Engine(NamedTuple):
    """Engine with converter and gearbox.

    Attributes:
        ratios: engine speed over wheel speed of the forward gears, at least one [1].
        reverse: the same of the reverse gear [1].
        curve: engine speed [rad/s] and torque at full throttle [N m].
        torque: largest torque of the engine [N m].
        power: its largest power [W].
        idle: idle speed [rad/s].
        drag_torque: drag torque with closed throttle [N m].
        shift_up: speed behind the converter above which the gearbox shifts up, throttle closed and open [rad/s].
        shift_down: the same for shifting down [rad/s].
        shift_time: time of a shift [s].
        efficiency: efficiency of gearbox and final drive [1].
        inertia: inertia of the engine [kg m²].
        stall_speed: stall speed of the converter [rad/s].
        stall_ratio: its torque ratio at stall [1].
        coupling: speed ratio from which both torques are equal [1].
        creep_torque: output torque of the converter at idle, wheels locked [N m].
        wheel_inertia: mass of the vehicle times squared radius of the driven wheels [kg m²].
    """

    ratios: tuple[float, ...]
    reverse: float
    curve: Rows
    torque: float
    power: float
    idle: float
    drag_torque: float
    shift_up: tuple[float, float]
    shift_down: tuple[float, float]
    shift_time: float
    efficiency: float
    inertia: float
    stall_speed: float
    stall_ratio: float
    coupling: float
    creep_torque: float
    wheel_inertia: float


def make_engine(spec: EnginePowertrain, *, wheel_inertia: float) -> Engine:
    """Return the engine of a vehicle.

    Args:
        spec: spec of vehicle.yaml.
        wheel_inertia: mass of the vehicle times squared radius of the driven wheels [kg m²].
    """
    ratios = tuple(gear * spec.final_drive for gear in spec.gears)
    converter = spec.converter
    return Engine(
        ratios=ratios,
        reverse=(spec.reverse or spec.gears[0]) * spec.final_drive,
        curve=tuple(spec.torque_curve),
        torque=spec.max_torque / ratios[0],
        power=spec.max_power,
        idle=spec.idle,
        drag_torque=spec.drag_torque,
        shift_up=spec.shift_up,
        shift_down=spec.shift_down,
        shift_time=spec.shift_time,
        efficiency=spec.efficiency,
        inertia=spec.inertia,
        stall_speed=converter.stall_speed,
        stall_ratio=converter.stall_ratio,
        coupling=converter.coupling,
        creep_torque=converter.creep_torque,
        wheel_inertia=wheel_inertia,
    )


def gear_ratio(engine: Engine, gear: float) -> float:
    """Return engine speed over wheel speed of a forward gear, or of reverse for -1."""
    return engine.reverse if gear < 0.0 else engine.ratios[int(gear) - 1]


def shift(engine: Engine, state: GearState, rate: float, throttle: float, period: float) -> GearState:
    """Return the gear after a step.

    Args:
        engine: the engine.
        state: gear before the step.
        rate: mean spin rate of the driven wheels, ahead [rad/s].
        throttle: opening [1].
        period: length of the step [s].
    """
    gear, shifting = state.gear, state.shifting
    # A gearbox that shifts does not decide again.
    if shifting > 0.0:
        return GearState(gear, max(shifting - period, 0.0))
    speed = rate * gear_ratio(engine, gear)
    # Speeds of shifting rise with the throttle, from closed to open.
    up = engine.shift_up[0] + throttle * (engine.shift_up[1] - engine.shift_up[0])
    down = engine.shift_down[0] + throttle * (engine.shift_down[1] - engine.shift_down[0])
    if speed > up and gear < len(engine.ratios):
        return GearState(gear + 1.0, engine.shift_time)
    if speed < down and gear > 1.0:
        return GearState(gear - 1.0, engine.shift_time)
    return GearState(gear, shifting)


def usual_gear(engine: Engine, rate: float) -> float:
    """Return the lowest gear that does not shift up at a spin rate of the driven wheels [rad/s]."""
    limit = 0.5 * (engine.shift_up[0] + engine.shift_up[1])
    for gear in range(1, len(engine.ratios)):
        if rate * engine.ratios[gear - 1] < limit:
            return float(gear)
    return float(len(engine.ratios))


def engine_point(engine: Engine, gear: float, rate: float) -> EnginePoint:
    """Return the operating point in a gear.

    Args:
        engine: the engine.
        gear: forward gear from 1, or -1.
        rate: mean spin rate of the driven wheels, along the gear [rad/s].
    """
    ratio = gear_ratio(engine, gear)
    # The converter lets the engine run at its stall speed while the turbine is slower.
    behind = max(rate * ratio, 0.0)
    speed = max(behind, engine.stall_speed)
    full = read_map(engine.curve, speed) if speed <= engine.curve[len(engine.curve) - 1][0] else 0.0
    full = min(full, engine.torque, engine.power / speed)
    slip = behind / speed
    # Torque gain of the converter: from the stall ratio at standstill, linearly, to 1 at coupling.
    gain = max(engine.stall_ratio - (engine.stall_ratio - 1.0) * slip / engine.coupling, 1.0)
    if behind < engine.idle:
        closed = engine.creep_torque * (1.0 - behind / engine.idle)
    else:
        closed = -engine.drag_torque * min((behind - engine.idle) / engine.idle, 1.0)
    # Share of the torque that reaches the wheels while the engine accelerates its own inertia as well.
    reach = engine.wheel_inertia / (engine.wheel_inertia + engine.inertia * ratio * ratio)
    losses = engine.efficiency if closed > 0.0 else 1.0 / engine.efficiency
    return EnginePoint(speed, full, closed * ratio * losses, full * gain * ratio * engine.efficiency * reach)


ENGINE_PARTS = (gear_ratio, shift, usual_gear, engine_point)
"""Functions that can be compiled."""
