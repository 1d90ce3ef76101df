"""Schemas of vehicle.yaml about what drives, brakes and steers: powertrain, brakes, pedals, actuators.

Their laws are in :mod:`mirdrake.plant.powertrain`. They act on a vehicle whose control.yaml has a wheel_speed of kind
pedals; servos and PID controllers of the wheels know the torque limits only.
"""

from collections.abc import Mapping
from itertools import pairwise
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Discriminator, Field, Tag, field_validator, model_validator

from mirdrake.core.yaml_io import AngularRate, Duration, Power, Schema, Speed, Torque

Duty = Annotated[float, Field(ge=0, le=1)]
Ratio = Annotated[float, Field(gt=0)]


def _ascending(rows: list[tuple[float, float]], *, second: bool) -> list[tuple[float, float]]:
    if any(late[0] <= early[0] or (second and late[1] < early[1]) for early, late in pairwise(rows)):
        raise ValueError("the rows should ascend")
    return rows


def _block(value: Any) -> Any:
    """An option block: false is none, true is one with its defaults."""
    return {True: {}, False: None}[value] if isinstance(value, bool) else value


# --- powertrain --------------------------------------------------------------------------------------------------


class Traction(Schema):
    """Takes drive torque back before the driven wheels spin: the antilock law with the sign turned round."""

    target_slip: float = Field(default=0.1, gt=0, lt=1, description="[-] slip that is held")
    gain: float = Field(default=15.0, gt=0, description="[1/s] how fast a slip error goes, if the estimate is right")
    min_speed: Speed = Field(default=2.0, gt=0, description="[m/s] below it slip is reckoned with this speed")


class _AnyPowertrain(Schema):
    """What the motor can give, at the wheels."""

    max_torque: Torque = Field(gt=0, description="[N m] sum over the driven wheels, without losses")
    max_power: Power = Field(gt=0, description="[W] sum over the driven wheels, without losses")
    front_share: float = Field(
        default=0.5, ge=0, le=1, description="[-] part of the torque on the front axle; only with drive: all"
    )
    traction: Annotated[Traction | None, BeforeValidator(_block)] = Field(
        default=None, description="traction control; false: none"
    )


class SimplePowertrain(_AnyPowertrain):
    """A torque limit and a power limit, forwards and backwards, without losses."""

    kind: Literal["simple"] = "simple"
    gears: list[Ratio] = Field(
        default_factory=list, description="[-] ratios of the gearbox, first gear first. Data only"
    )
    final_drive: float | None = Field(default=None, gt=0, description="[-] ratio behind the gearbox. Data only")


class Regeneration(Schema):
    """The motor as a generator: it takes its part of the driven axles' brake torque, the friction brakes the rest."""

    max_torque: Torque = Field(gt=0, description="[N m] at the motor")
    max_power: Power = Field(gt=0, description="[W] at the motor")
    fade_speed: Speed = Field(default=2.0, gt=0, description="[m/s] below it the torque goes to zero with the speed")
    coast_share: float = Field(default=0.0, ge=0, le=1, description="[-] part of it with both pedals released")


class ElectricPowertrain(_AnyPowertrain):
    """An electric motor with one gear: max_torque and max_power are the motor's, seen from the wheels."""

    kind: Literal["electric"]
    gear: float = Field(gt=0, description="[-] motor speed over wheel speed")
    max_speed: AngularRate = Field(gt=0, description="[rad/s] of the motor")
    torque_map: list[tuple[Annotated[AngularRate, Field(ge=0)], Annotated[Torque, Field(ge=0)]]] = Field(
        default_factory=list, description="[rad/s], [N m] motor speed and largest torque; empty: torque and power alone"
    )
    efficiency: float = Field(default=1.0, gt=0, le=1, description="[-] of the gear")
    rotor_inertia: float = Field(default=0.0, ge=0, description="[kg m²] of what turns with the motor's speed")
    governed_speed: Speed | None = Field(default=None, gt=0, description="[m/s] where drive torque ends; empty: never")
    regeneration: Regeneration | None = None

    @field_validator("torque_map")
    @classmethod
    def _rows(cls, rows: list[tuple[float, float]]) -> list[tuple[float, float]]:
        return _ascending(rows, second=False)


class Converter(Schema):
    """Torque converter, quasi-static: see :mod:`mirdrake.plant.powertrain.engine`."""

    stall_speed: AngularRate = Field(gt=0, description="[rad/s] of the engine at full throttle, wheels held")
    stall_ratio: float = Field(default=2.0, ge=1, description="[-] torque behind over torque before it, wheels held")
    coupling: float = Field(default=0.9, gt=0, le=1, description="[-] speed ratio from which the torques are equal")
    creep_torque: Torque = Field(default=0.0, ge=0, description="[N m] behind it when idling, wheels held")


class EnginePowertrain(_AnyPowertrain):
    """A combustion engine with an automatic gearbox.

    max_torque and max_power are limits of the engine besides its curve, seen from the wheels in first gear; the torque
    converter goes beyond them.
    """

    kind: Literal["engine"]
    torque_curve: list[tuple[Annotated[AngularRate, Field(ge=0)], Annotated[Torque, Field(ge=0)]]] = Field(
        min_length=2, description="[rad/s], [N m] engine speed and torque at full throttle; no torque above the last"
    )
    drag_torque: Torque = Field(default=0.0, ge=0, description="[N m] of the engine with closed throttle")
    idle: AngularRate = Field(gt=0, description="[rad/s]")
    gears: list[Ratio] = Field(min_length=1, description="[-] ratios of the gearbox, first gear first")
    reverse: float | None = Field(default=None, gt=0, description="[-] ratio of the reverse gear; empty: as the first")
    final_drive: float = Field(gt=0, description="[-] ratio behind the gearbox")
    shift_up: tuple[AngularRate, AngularRate] = Field(
        description="[rad/s] speed behind the converter above which it shifts up: throttle closed, throttle open"
    )
    shift_down: tuple[AngularRate, AngularRate] = Field(description="[rad/s] the same for shifting down, below it")
    shift_time: Duration = Field(default=0.0, ge=0, le=5, description="[s] without torque in a shift")
    efficiency: float = Field(default=1.0, gt=0, le=1, description="[-] of gearbox and final drive")
    inertia: float = Field(default=0.0, ge=0, description="[kg m²] of what turns with the engine's speed")
    converter: Converter

    @field_validator("torque_curve")
    @classmethod
    def _rows(cls, rows: list[tuple[float, float]]) -> list[tuple[float, float]]:
        return _ascending(rows, second=False)

    @field_validator("gears")
    @classmethod
    def _descending(cls, gears: list[float]) -> list[float]:
        if any(late >= early for early, late in pairwise(gears)):
            raise ValueError("each gear should have a smaller ratio than the one before")
        return gears

    @model_validator(mode="after")
    def _no_hunting(self) -> "EnginePowertrain":
        for up, down in zip(self.shift_up, self.shift_down, strict=True):
            for gear, (low, high) in enumerate(pairwise(self.gears), start=1):
                if up * high / low <= down:
                    raise ValueError(
                        f"gear {gear} would shift up at {up:.0f} rad/s and gear {gear + 1} down again at {down:.0f}; "
                        "raise shift_up or lower shift_down"
                    )
        if self.idle >= self.torque_curve[-1][0]:
            raise ValueError("the engine idles above the end of its torque_curve")
        return self


def _kind(value: Any) -> Any:
    return value.get("kind", "simple") if isinstance(value, Mapping) else getattr(value, "kind", "simple")


Powertrain = Annotated[
    Annotated[SimplePowertrain, Tag("simple")]
    | Annotated[ElectricPowertrain, Tag("electric")]
    | Annotated[EnginePowertrain, Tag("engine")],
    Discriminator(_kind),
]
"""powertrain of vehicle.yaml, told apart by its kind; without one it is simple."""


# --- brakes ------------------------------------------------------------------------------------------------------


class Antilock(Schema):
    """Holds the slip of a braked wheel: see :mod:`mirdrake.plant.powertrain.antilock`."""

    target_slip: float = Field(default=0.1, gt=0, lt=1, description="[-] slip that is held")
    gain: float = Field(default=15.0, gt=0, description="[1/s] how fast a slip error goes, if the estimate is right")
    min_speed: Speed = Field(default=2.0, gt=0, description="[m/s] below it wheels may lock")


class Stability(Schema):
    """Brakes single wheels when the yaw rate leaves that of the single track, see plant/powertrain/stability.py."""

    gain: float = Field(default=2e4, gt=0, description="[N m s/rad] brake torque of one wheel over yaw-rate error")
    dead_band: AngularRate = Field(default=0.05, ge=0, description="[rad/s] yaw-rate error that is let pass")
    understeer: float = Field(default=0.003, ge=0, description="[rad s²/m] understeer gradient of the reference")
    max_acceleration: float = Field(default=8.0, gt=0, description="[m/s²] lateral acceleration the reference goes to")
    max_torque: Torque = Field(default=1500.0, gt=0, description="[N m] of one wheel")
    min_speed: Speed = Field(default=5.0, gt=0, description="[m/s] below it nothing is done")


class Brakes(Schema):
    """What the brakes can give."""

    max_torque: Torque = Field(ge=0, description="[N m] sum over the four wheels")
    front_share: float = Field(ge=0, le=1, description="[-] part of it that acts on the front axle")
    abs: Annotated[Antilock | None, BeforeValidator(_block)] = Field(
        default=None, description="antilock brakes; false: none"
    )
    esc: Annotated[Stability | None, BeforeValidator(_block)] = Field(
        default=None, description="stability control; false: none"
    )


class Pedals(Schema):
    """What a pedal position means; straight lines without."""

    throttle: list[tuple[Duty, Duty]] = Field(
        default_factory=list,
        description="[-], [-] pedal position and part of the drive torque that there is at this speed, ascending",
    )
    brake: list[tuple[Duty, Annotated[Torque, Field(ge=0)]]] = Field(
        default_factory=list,
        description="[-], [N m] pedal position and braking torque of the four wheels, ascending; from the last row to "
        "brakes.max_torque at 1 it is a straight line",
    )

    @field_validator("throttle", "brake")
    @classmethod
    def _rows(cls, rows: list[tuple[float, float]]) -> list[tuple[float, float]]:
        return _ascending(rows, second=True)


class Actuator(Schema):
    """Between what is asked and what acts: a pure delay, then a lag of first order with a limited rate."""

    delay: Duration = Field(default=0.0, ge=0, le=5, description="[s] a multiple of the period of who sends")
    time_constant: Duration = Field(default=0.0, ge=0, le=10, description="[s]")
    rate: float | None = Field(default=None, gt=0, description="[1/s], steering [rad/s]; empty: no limit")


class SteeringActuator(Actuator):
    """The same for the bicycle steering angle; the joints' servos come behind it."""

    rate: AngularRate | None = Field(default=None, gt=0, description="[rad/s] at the road wheel; empty: no limit")


class Actuators(Schema):
    """What stands between set-points and pedals or steering; nothing by default."""

    throttle: Actuator = Field(default_factory=Actuator)
    brake: Actuator = Field(default_factory=Actuator)
    steering: SteeringActuator = Field(default_factory=SteeringActuator)


def rotor_inertia(powertrain: Any, *, drive: str, front: bool) -> float:
    """What the motor adds to the inertia of a wheel about its axle [kg m²]; nothing if its wheel is not driven.

    Exact as long as the driven wheels turn alike: their mean speed, which is the motor's over the gear, is taken for
    the speed of each. An engine's inertia is part of its law instead, as it changes with the gear.

    Args:
        powertrain: of vehicle.yaml.
        drive: driven axle: front, rear or all.
        front: whether the wheel is a front wheel.
    """
    if not isinstance(powertrain, ElectricPowertrain):
        return 0.0
    share = {"front": 1.0, "rear": 0.0}.get(drive, powertrain.front_share)
    return 0.5 * (share if front else 1.0 - share) * powertrain.rotor_inertia * powertrain.gear**2
