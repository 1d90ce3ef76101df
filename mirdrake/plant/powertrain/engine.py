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

from dataclasses import dataclass
from typing import NamedTuple

from mirdrake.plant.powertrain.maps import read_map
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


@dataclass(frozen=True, slots=True)
class Engine:
    """Engine with converter and gearbox.

    Attributes:
        spec: spec of vehicle.yaml.
        wheel_inertia: mass of the vehicle times squared radius of the driven wheels [kg m²].
    """

    spec: EnginePowertrain
    wheel_inertia: float

    def ratio(self, gear: float) -> float:
        """Return engine speed over wheel speed of a forward gear, or of reverse for -1."""
        spec = self.spec
        inner = (spec.reverse or spec.gears[0]) if gear < 0 else spec.gears[int(gear) - 1]
        return inner * spec.final_drive

    def shift(self, state: GearState, rate: float, throttle: float, *, period: float) -> GearState:
        """Return the gear after a step.

        Args:
            state: gear before the step.
            rate: mean spin rate of the driven wheels, ahead [rad/s].
            throttle: opening [1].
            period: length of the step [s].
        """
        gear, shifting = state
        # A gearbox that shifts does not decide again.
        if shifting > 0.0:
            return GearState(gear, max(shifting - period, 0.0))
        speed = rate * self.ratio(gear)
        # Speeds of shifting rise with the throttle, from closed to open.
        up, down = (
            closed + throttle * (opened - closed) for closed, opened in (self.spec.shift_up, self.spec.shift_down)
        )
        if speed > up and gear < len(self.spec.gears):
            return GearState(gear + 1.0, self.spec.shift_time)
        if speed < down and gear > 1.0:
            return GearState(gear - 1.0, self.spec.shift_time)
        return state

    def usual_gear(self, rate: float) -> float:
        """Return the lowest gear that does not shift up at a spin rate of the driven wheels [rad/s]."""
        limit = 0.5 * sum(self.spec.shift_up)
        for gear in range(1, len(self.spec.gears)):
            if rate * self.ratio(gear) < limit:
                return float(gear)
        return float(len(self.spec.gears))

    def point(self, gear: float, rate: float) -> EnginePoint:
        """Return the operating point in a gear.

        Args:
            gear: forward gear from 1, or -1.
            rate: mean spin rate of the driven wheels, along the gear [rad/s].
        """
        spec, converter, ratio = self.spec, self.spec.converter, self.ratio(gear)
        # The converter lets the engine run at its stall speed while the turbine is slower.
        behind = max(rate * ratio, 0.0)
        speed = max(behind, converter.stall_speed)
        full = read_map(spec.torque_curve, speed) if speed <= spec.torque_curve[-1][0] else 0.0
        full = min(full, spec.max_torque / self.ratio(1.0), spec.max_power / speed)
        slip = behind / speed
        # Torque gain of the converter: from the stall ratio at standstill, linearly, to 1 at coupling.
        gain = max(converter.stall_ratio - (converter.stall_ratio - 1.0) * slip / converter.coupling, 1.0)
        if behind < spec.idle:
            closed = converter.creep_torque * (1.0 - behind / spec.idle)
        else:
            closed = -spec.drag_torque * min((behind - spec.idle) / spec.idle, 1.0)
        # Share of the torque that reaches the wheels while the engine accelerates its own inertia as well.
        reach = self.wheel_inertia / (self.wheel_inertia + spec.inertia * ratio * ratio)
        losses = spec.efficiency if closed > 0.0 else 1.0 / spec.efficiency
        return EnginePoint(speed, full, closed * ratio * losses, full * gain * ratio * spec.efficiency * reach)
