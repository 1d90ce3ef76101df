"""Torques of the four wheels from the pedals, in one discrete step.

The step evaluates, in this order: actuators of the pedals, pedal maps, gearbox, motor or engine, regenerative braking,
friction brakes, stability control, antilock valves, traction control. The last three act after the actuator of the
brake, and have no lag of their own.
"""

from collections.abc import Sequence
from typing import NamedTuple

from mirdrake.plant.powertrain.actuator import ActuatorLaw
from mirdrake.plant.powertrain.antilock import BRAKING, DRIVING, SlipState, hold_slip
from mirdrake.plant.powertrain.brakes import Four, drive_shares, driven_rate, split_brakes, split_drive
from mirdrake.plant.powertrain.engine import Engine, GearState
from mirdrake.plant.powertrain.maps import PedalMaps, read_map
from mirdrake.plant.powertrain.motor import make_motor, wheel_limits, wheel_regeneration
from mirdrake.plant.powertrain.stability import stability_torques
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
    status: list[float]


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
        engine: combustion engine; None with an electric motor.

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
        self._period, self._wheelbase = period, wheelbase
        self.radii, self._inertias = tuple(radii), tuple(inertias)
        self.mass = mass
        # Wheels accelerate with the vehicle: I / R² is added to its mass.
        turning = sum(inertia / radius**2 for inertia, radius in zip(inertias, radii, strict=False))
        self.rotating = turning if rotating is None else rotating
        self._brakes, self._traction = spec.brakes, spec.powertrain.traction
        self.shares = drive_shares(spec.drive, spec.powertrain.front_share)
        self.radius = self.shares.front * radii[0] + self.shares.rear * radii[2]
        self.maps = PedalMaps(spec.pedals, brake_torque=spec.brakes.max_torque)
        self._throttle = ActuatorLaw(spec.actuators.throttle, period=period)
        self._brake = ActuatorLaw(spec.actuators.brake, period=period)
        self.engine: Engine | None = None
        if isinstance(spec.powertrain, EnginePowertrain):
            self.engine = Engine(spec.powertrain, mass * self.radius**2)
        else:
            self._motor = make_motor(spec.powertrain, radius=self.radius)
        # Sections of the memory: throttle, brake, gearbox, slip of four braked, then of four driven wheels.
        first = self._throttle.size
        self._parts = (slice(0, first), slice(first, first + self._brake.size))
        self._gear = slice(first + self._brake.size, first + self._brake.size + _GEAR)
        self._slips = [slice(self._gear.stop + row * _SLIP, self._gear.stop + (row + 1) * _SLIP) for row in range(8)]
        self.size = self._slips[-1].stop

    def rest(self, speed: float = 0.0) -> list[float]:
        """Return the memory at the start, with both pedals released, at a speed [m/s]."""
        gear = self.engine.usual_gear(speed / self.radius) if self.engine is not None else 1.0
        return [*self._throttle.rest(0.0), *self._brake.rest(0.0), *GearState(gear), *list(SlipState()) * 8]

    def limits(self, gear: float, rate: float, *, engaged: float | None = None) -> tuple[float, float]:
        """Return the torque of all driven wheels along the gear [N m] with the throttle closed and open.

        Args:
            gear: 1 drive, -1 reverse; 0 neutral.
            rate: mean spin rate of the driven wheels, ahead [rad/s].
            engaged: forward gear of the gearbox; by default the lowest one that does not shift up.
        """
        if gear == 0.0:
            return 0.0, 0.0
        along = gear * rate
        if self.engine is None:
            return wheel_limits(self._motor, along)
        number = -1.0 if gear < 0.0 else engaged or self.engine.usual_gear(along)
        point = self.engine.point(number, along)
        return point.closed, point.opened

    def step(self, memory: list[float], pedals: Sequence[float], measured: Measured) -> tuple[list[float], Torques]:
        """Advance by one step.

        Args:
            memory: memory from the last step, or from :meth:`rest`.
            pedals: throttle [1], brake [1], gear (1 drive, 0 neutral, -1 reverse).
            measured: motion of the vehicle.

        Returns:
            The memory for the next step, and the torques until then.
        """
        # Pedals behind their actuators and maps.
        memory = list(memory)
        throttle_part, brake_part = self._parts
        # The gear comes as a float signal: round to -1, 0, 1.
        gear = float((pedals[2] > 0.5) - (pedals[2] < -0.5))
        asked = (min(max(pedals[0], 0.0), 1.0), min(max(pedals[1], 0.0), 1.0))
        memory[throttle_part], throttle = self._throttle.step(memory[throttle_part], asked[0])
        memory[brake_part], brake = self._brake.step(memory[brake_part], asked[1])
        opening, demand = read_map(self.maps.throttle, throttle), read_map(self.maps.brake, brake)

        # Gearbox, and torque of motor or engine.
        rate = driven_rate(measured.rates, self.shares)
        shown = gear
        if self.engine is not None:
            state = self.engine.shift(GearState(*memory[self._gear]), rate, opening, period=self._period)
            memory[self._gear] = state
            # Neutral and reverse are shown as demanded, drive as the engaged gear.
            shown = state.gear if gear > 0.0 else gear
            closed, opened = self.limits(gear, rate, engaged=state.gear)
            # No torque flows while the gearbox shifts.
            if state.shifting > 0.0 and gear > 0.0:
                closed = opened = 0.0
        else:
            closed, opened = self.limits(gear, rate)
        # Torque is linear in the opening, from drag or creep to full load.
        torque = closed + opening * (opened - closed)

        # Brakes; the motor does not regenerate while antilock acts.
        generator = 0.0
        slipping = any(memory[part.start] > 0.0 for part in self._slips[:4])
        if self.engine is None and gear != 0.0 and demand > 0.0 and not slipping:
            # Releasing the throttle already regenerates: only the rest is left for the brake pedal.
            generator = max(wheel_regeneration(self._motor, gear * rate) + min(torque, 0.0), 0.0)
        motor_brake, brakes = split_brakes(demand, self._brakes.front_share, generator=generator, shares=self.shares)
        torque -= motor_brake
        acting = 0
        if self._inertias and self._brakes.esc is not None:
            extra = stability_torques(
                self._brakes.esc,
                speed=measured.speed,
                steering=measured.steering,
                yaw_rate=measured.yaw_rate,
                wheelbase=self._wheelbase,
            )
            acting += sum(more > 0.0 for more in extra)
            brakes = tuple(own + more for own, more in zip(brakes, extra, strict=True))  # type: ignore[assignment]

        # Antilock of each wheel, and traction control of all driven wheels together.
        travel = 1.0 if measured.speed >= 0.0 else -1.0
        if self._inertias and self._brakes.abs is not None:
            held = [self._hold(memory, i, brakes[i], travel, measured, BRAKING) for i in range(4)]
            acting += sum(now < then for now, then in zip(held, brakes, strict=True))
            brakes = (held[0], held[1], held[2], held[3])
        drive = split_drive(gear * torque, self.shares)
        if self._inertias and self._traction is not None and torque > 0.0:
            # One motor drives all of them: the wheel that slips most limits the torque of all.
            part = min(
                self._hold(memory, i, abs(drive[i]), gear, measured, DRIVING) / abs(drive[i])
                for i in range(4)
                if drive[i] != 0.0
            )
            acting += part < 1.0
            torque *= part
            drive = split_drive(gear * torque, self.shares)
        speed, motor_torque = self._at_motor(gear, rate, torque, opening, memory)
        status = [throttle, brake, shown, speed, motor_torque, gear * torque * rate, gear * torque, sum(brakes)]
        return memory, Torques(drive, brakes, [*status, float(acting)])

    def _hold(
        self, memory: list[float], wheel: int, wanted: float, along: float, measured: Measured, direction: float
    ) -> float:
        """Return the torque of a wheel with slip control; the memory is changed."""
        options = self._brakes.abs if direction == BRAKING else self._traction
        assert options is not None
        # Braked and driven slip have memories of their own, as a wheel may be in both controls in turn.
        row = self._slips[wheel + (4 if direction == DRIVING else 0)]
        memory[row], torque = hold_slip(
            SlipState(*memory[row]),
            wanted,
            direction=direction,
            # The law knows one direction of travel, so rate and speed are taken along it.
            rate=along * measured.rates[wheel],
            speed=along * measured.speeds[wheel],
            options=options,
            radius=self.radii[wheel],
            inertia=self._inertias[wheel],
            period=self._period,
        )
        return torque

    def _at_motor(
        self, gear: float, rate: float, torque: float, opening: float, memory: list[float]
    ) -> tuple[float, float]:
        """Return speed [rad/s] and torque [N m] of motor or engine, for the log."""
        if self.engine is None:
            motor = self._motor
            # Losses act against the flow of power: a regenerating motor gets less than the wheels give.
            losses = motor.efficiency if torque < 0.0 else 1.0 / motor.efficiency
            return rate * motor.gear, gear * torque * losses / motor.gear
        spec = self.engine.spec
        if gear == 0.0:
            return spec.idle, 0.0
        number = -1.0 if gear < 0.0 else memory[self._gear][0]
        point = self.engine.point(number, gear * rate)
        behind = gear * rate * self.engine.ratio(number)
        waiting = spec.idle + opening * (spec.converter.stall_speed - spec.idle)
        return max(behind, waiting), opening * point.full - (1.0 - opening) * spec.drag_torque * (behind > spec.idle)
