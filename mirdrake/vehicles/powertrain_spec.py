"""Schemas of vehicle.yaml for powertrain, brakes, pedals and actuators.

Their laws are in :mod:`mirdrake.plant.powertrain`. They act in vehicles with `wheel_speed: {kind: pedals}` in
control.yaml; servos and PID controllers of the wheels use the torque limits only.
"""

from itertools import pairwise
from math import inf
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, field_validator, model_validator

from mirdrake.core.kinds import SelectedByKind
from mirdrake.core.yaml_io import AngularRate, Duration, Power, Schema, Speed, Torque
from mirdrake.vehicles.differential_spec import Differentials, OpenDifferential

Duty = Annotated[float, Field(ge=0, le=1)]
Ratio = Annotated[float, Field(gt=0)]


def _ascending(rows: list[tuple[float, float]], *, second: bool) -> list[tuple[float, float]]:
    if any(late[0] <= early[0] or (second and late[1] < early[1]) for early, late in pairwise(rows)):
        raise ValueError("the rows must be in ascending order")
    return rows


def _block(value: Any) -> Any:
    """Return an optional section: false is None, true is the section with its defaults."""
    return {True: {}, False: None}[value] if isinstance(value, bool) else value


# --- powertrain --------------------------------------------------------------------------------------------------


class Traction(Schema):
    """Traction control: reduces the drive torque of spinning wheels, with the law of the antilock brakes."""

    target_slip: float = Field(default=0.1, gt=0, lt=1, description="[-] target slip")
    gain: float = Field(default=15.0, gt=0, description="[1/s] decay rate of a slip error, for an exact wheel model")
    min_speed: Speed = Field(default=2.0, gt=0, description="[m/s] lower bound of the speed in the slip calculation")


class AnyPowertrain(Schema):
    """Limits of motor or engine at the wheels, for every kind."""

    kind: str

    max_torque: Torque = Field(gt=0, description="[N m] largest torque, sum over the driven wheels, without losses")
    max_power: Power = Field(gt=0, description="[W] largest power, sum over the driven wheels, without losses")
    front_share: float = Field(
        default=0.5, ge=0, le=1, description="[-] share of the torque on the front axle; only with drive: all"
    )
    traction: Annotated[Traction | None, BeforeValidator(_block)] = Field(
        default=None, description="traction control; false: off"
    )
    differential: Differentials = Field(
        default_factory=Differentials, description="differentials of the driven axles; open by default"
    )

    @property
    def coupled(self) -> bool:
        """Whether a differential is not open."""
        axles = (self.differential.front, self.differential.rear)
        return any(not isinstance(axle, OpenDifferential) for axle in axles)

    def top_speeds(self, radius: float) -> tuple[float, float]:
        """Return the top speeds of motor and governor, ahead and backwards [m/s]; infinite without limits.

        Args:
            radius: radius of the driven wheels [m].
        """
        _ = radius
        return inf, inf

    def wheel_inertia(self, *, drive: str, front: bool) -> float:
        """Return the inertia of the motor about the axle of a wheel [kg m²]; zero if the wheel is not driven.

        The inertia of an engine is part of its torque instead, as it changes with the gear.

        Args:
            drive: driven axle: front, rear or all.
            front: whether the wheel is a front wheel.
        """
        _ = drive, front
        return 0.0


class SimplePowertrain(AnyPowertrain):
    """A torque limit and a power limit, forwards and backwards, without losses."""

    kind: Literal["simple"] = "simple"
    gears: list[Ratio] = Field(
        default_factory=list, description="[-] gear ratios, first gear first. For information only"
    )
    final_drive: float | None = Field(default=None, gt=0, description="[-] final drive ratio. For information only")


class Regeneration(Schema):
    """Regenerative braking: the motor provides brake torque of the driven axles, the friction brakes the rest."""

    max_torque: Torque = Field(gt=0, description="[N m] largest regenerative torque of the motor")
    max_power: Power = Field(gt=0, description="[W] largest regenerative power of the motor")
    fade_speed: Speed = Field(
        default=2.0, gt=0, description="[m/s] speed below which the torque decreases to zero with the speed"
    )
    distribution: Literal["axle", "motor_first"] = Field(
        default="axle",
        description="axle: the motor provides at most the share of its axle; motor_first: as much of the whole brake "
        "torque as it can (blended brakes)",
    )
    coast_share: float = Field(
        default=0.0, ge=0, le=1, description="[-] share of the regenerative torque with both pedals released"
    )


class MotorLosses(Schema):
    """Losses of motor and inverter, beside those of the gear."""

    copper: float = Field(default=0.0, ge=0, description="[W/(N m)²] losses over the square of the motor torque")
    iron: float = Field(default=0.0, ge=0, description="[W s/rad] losses over the motor speed")
    windage: float = Field(default=0.0, ge=0, description="[W s³/rad³] losses over the cube of the motor speed")
    constant: Power = Field(default=0.0, ge=0, description="[W] losses at standstill")


class Battery(Schema):
    """Battery: open-circuit voltage over the state of charge, and a resistance."""

    capacity: float = Field(gt=0, description="[A h] charge from empty to full")
    open_circuit_voltage: list[tuple[Duty, Annotated[float, Field(gt=0)]]] = Field(
        min_length=1, description="[-], [V] state of charge and open-circuit voltage"
    )
    resistance: float = Field(default=0.0, ge=0, description="[ohm] internal resistance")
    auxiliary_power: Power = Field(default=0.0, ge=0, description="[W] power of all other consumers")
    initial_charge: float = Field(default=0.9, ge=0, le=1, description="[-] state of charge at the start")
    charging_efficiency: float = Field(
        default=1.0, gt=0, le=1, description="[-] energy of the cells over that from the grid"
    )

    @field_validator("open_circuit_voltage")
    @classmethod
    def _rows(cls, rows: list[tuple[float, float]]) -> list[tuple[float, float]]:
        return _ascending(rows, second=True)


class ElectricPowertrain(AnyPowertrain):
    """Electric motor with one gear; max_torque and max_power of the motor are referred to the wheels."""

    kind: Literal["electric"]
    gear: float = Field(gt=0, description="[-] gear ratio: motor speed over wheel speed")
    max_speed: AngularRate = Field(gt=0, description="[rad/s] largest motor speed")
    torque_map: list[tuple[Annotated[AngularRate, Field(ge=0)], Annotated[Torque, Field(ge=0)]]] = Field(
        default_factory=list,
        description="[rad/s], [N m] motor speed and largest torque; empty: max_torque and max_power only",
    )
    efficiency: float = Field(default=1.0, gt=0, le=1, description="[-] efficiency of the gear")
    rotor_inertia: float = Field(default=0.0, ge=0, description="[kg m²] inertia at the motor speed")
    governed_speed: Speed | None = Field(default=None, gt=0, description="[m/s] speed limiter; null: none")
    regeneration: Regeneration | None = Field(default=None, description="regenerative braking; null: none")
    losses: MotorLosses = Field(
        default_factory=MotorLosses, description="losses of motor and inverter, for the battery"
    )
    battery: Battery | None = Field(default=None, description="battery; null: the energy is not computed")

    @field_validator("torque_map")
    @classmethod
    def _rows(cls, rows: list[tuple[float, float]]) -> list[tuple[float, float]]:
        return _ascending(rows, second=False)

    def top_speeds(self, radius: float) -> tuple[float, float]:
        """Return the top speeds of motor and governor; see the base class."""
        motor = self.max_speed / self.gear * radius
        return min(motor, self.governed_speed or inf), motor

    def wheel_inertia(self, *, drive: str, front: bool) -> float:
        """Return the part of the rotor's inertia that acts about the axle of a wheel [kg m²]; see the base class.

        The division between the wheels is exact while the driven wheels have the same speed.
        """
        share = {"front": 1.0, "rear": 0.0}.get(drive, self.front_share)
        return 0.5 * (share if front else 1.0 - share) * self.rotor_inertia * self.gear**2


class Converter(Schema):
    """Torque converter without dynamics; the equations are in :mod:`mirdrake.plant.powertrain.engine`."""

    stall_speed: AngularRate = Field(
        gt=0, description="[rad/s] stall speed: engine speed at full throttle, wheels locked"
    )
    stall_ratio: float = Field(
        default=2.0, ge=1, description="[-] stall torque ratio: output over input torque, wheels locked"
    )
    coupling: float = Field(
        default=0.9, gt=0, le=1, description="[-] coupling point: speed ratio from which both torques are equal"
    )
    creep_torque: Torque = Field(default=0.0, ge=0, description="[N m] output torque at idle, wheels locked")


class EnginePowertrain(AnyPowertrain):
    """Combustion engine with torque converter and automatic gearbox.

    max_torque and max_power limit the engine in addition to its torque curve, referred to the wheels in first gear. The
    torque multiplication of the converter is not limited by them.
    """

    kind: Literal["engine"]
    torque_curve: list[tuple[Annotated[AngularRate, Field(ge=0)], Annotated[Torque, Field(ge=0)]]] = Field(
        min_length=2, description="[rad/s], [N m] engine speed and torque at full throttle; zero above the last row"
    )
    drag_torque: Torque = Field(default=0.0, ge=0, description="[N m] drag torque of the engine with closed throttle")
    idle: AngularRate = Field(gt=0, description="[rad/s] idle speed of the engine")
    gears: list[Ratio] = Field(min_length=1, description="[-] gear ratios, first gear first")
    reverse: float | None = Field(
        default=None, gt=0, description="[-] ratio of the reverse gear; null: that of the first gear"
    )
    final_drive: float = Field(gt=0, description="[-] final drive ratio")
    shift_up: tuple[AngularRate, AngularRate] = Field(
        description="[rad/s] upshift above this gearbox input speed: with closed throttle, with full throttle"
    )
    shift_down: tuple[AngularRate, AngularRate] = Field(
        description="[rad/s] downshift below this gearbox input speed: with closed, with full throttle"
    )
    shift_time: Duration = Field(default=0.0, ge=0, le=5, description="[s] torque interruption during a shift")
    efficiency: float = Field(default=1.0, gt=0, le=1, description="[-] efficiency of gearbox and final drive")
    inertia: float = Field(default=0.0, ge=0, description="[kg m²] inertia at the engine speed")
    converter: Converter = Field(description="torque converter")

    @field_validator("torque_curve")
    @classmethod
    def _rows(cls, rows: list[tuple[float, float]]) -> list[tuple[float, float]]:
        return _ascending(rows, second=False)

    @field_validator("gears")
    @classmethod
    def _descending(cls, gears: list[float]) -> list[float]:
        if any(late >= early for early, late in pairwise(gears)):
            raise ValueError("each gear must have a smaller ratio than the previous one")
        return gears

    @model_validator(mode="after")
    def _no_hunting(self) -> "EnginePowertrain":
        for up, down in zip(self.shift_up, self.shift_down, strict=True):
            for gear, (low, high) in enumerate(pairwise(self.gears), start=1):
                # After the shift the gearbox input turns slower by the ratio of the gears.
                if up * high / low <= down:
                    raise ValueError(
                        f"gear {gear} would shift up at {up:.0f} rad/s and gear {gear + 1} down again at {down:.0f}; "
                        "raise shift_up or lower shift_down"
                    )
        if self.idle >= self.torque_curve[-1][0]:
            raise ValueError("idle is above the last speed of torque_curve")
        return self

    def top_speeds(self, radius: float) -> tuple[float, float]:
        """Return the top speeds at the end of the torque curve; see the base class."""
        engine = self.torque_curve[-1][0] * radius / self.final_drive
        return engine / self.gears[-1], engine / (self.reverse or self.gears[0])


POWERTRAINS: dict[str, type[AnyPowertrain]] = {
    "simple": SimplePowertrain,
    "electric": ElectricPowertrain,
    "engine": EnginePowertrain,
}
"""Classes by ``powertrain.kind`` of vehicle.yaml."""

Powertrain = Annotated[AnyPowertrain, SelectedByKind(POWERTRAINS, default="simple")]
"""Powertrain of a vehicle; the default kind is simple."""


# --- brakes ------------------------------------------------------------------------------------------------------


class Antilock(Schema):
    """Antilock brakes: limit the slip of a braked wheel, see :mod:`mirdrake.plant.powertrain.antilock`."""

    target_slip: float = Field(default=0.1, gt=0, lt=1, description="[-] target slip")
    gain: float = Field(default=15.0, gt=0, description="[1/s] decay rate of a slip error, for an exact wheel model")
    min_speed: Speed = Field(default=2.0, gt=0, description="[m/s] inactive below this speed")


class Stability(Schema):
    """Stability control: brakes single wheels when the yaw rate differs from that of the single-track model."""

    gain: float = Field(default=2e4, gt=0, description="[N m s/rad] brake torque of one wheel over yaw-rate error")
    dead_band: AngularRate = Field(default=0.05, ge=0, description="[rad/s] yaw-rate error without intervention")
    understeer: float = Field(default=0.003, ge=0, description="[rad s²/m] understeer gradient of the reference model")
    max_acceleration: float = Field(
        default=8.0, gt=0, description="[m/s²] limit of the lateral acceleration of the reference model"
    )
    max_torque: Torque = Field(default=1500.0, gt=0, description="[N m] largest brake torque of one wheel")
    min_speed: Speed = Field(default=5.0, gt=0, description="[m/s] inactive below this speed")


class Brakes(Schema):
    """Service brakes."""

    max_torque: Torque = Field(ge=0, description="[N m] largest brake torque, sum over the four wheels")
    front_share: float = Field(ge=0, le=1, description="[-] share of the brake torque on the front axle")
    abs: Annotated[Antilock | None, BeforeValidator(_block)] = Field(
        default=None, description="antilock brakes; false: off"
    )
    esc: Annotated[Stability | None, BeforeValidator(_block)] = Field(
        default=None, description="stability control; false: off"
    )


class Pedals(Schema):
    """Pedal maps; linear if empty."""

    throttle: list[tuple[Duty, Duty]] = Field(
        default_factory=list,
        description="[-], [-] pedal position and share of the drive torque available at the current speed, ascending",
    )
    brake: list[tuple[Duty, Annotated[Torque, Field(ge=0)]]] = Field(
        default_factory=list,
        description="[-], [N m] pedal position and brake torque of the four wheels, ascending; linear from the "
        "last row to "
        "brakes.max_torque at 1",
    )

    @field_validator("throttle", "brake")
    @classmethod
    def _rows(cls, rows: list[tuple[float, float]]) -> list[tuple[float, float]]:
        return _ascending(rows, second=True)


class Actuator(Schema):
    """Actuator dynamics: a pure delay, then a first-order lag with a rate limit."""

    delay: Duration = Field(
        default=0.0, ge=0, le=5, description="[s] delay; a multiple of the period of the commanding system"
    )
    time_constant: Duration = Field(default=0.0, ge=0, le=10, description="[s] time constant of the lag")
    rate: float | None = Field(default=None, gt=0, description="[1/s] rate limit; null: none")


class SteeringActuator(Actuator):
    """Actuator dynamics of the bicycle steering angle, before the servos of the joints."""

    rate: AngularRate | None = Field(default=None, gt=0, description="[rad/s] rate limit at the road wheel; null: none")


class Actuators(Schema):
    """Actuator dynamics between set-points and pedals or steering; ideal by default."""

    throttle: Actuator = Field(default_factory=Actuator)
    brake: Actuator = Field(default_factory=Actuator)
    steering: SteeringActuator = Field(default_factory=SteeringActuator)
