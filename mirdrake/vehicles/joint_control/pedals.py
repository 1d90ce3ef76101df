"""Speed control with throttle and brake pedal.

With the direction of the gear as positive, the slope a of the set-point v_s, the speed v, the mass m including the
rotating parts, and the resistance R(v) of tyres and air::

    F = m (a + kp (v_s - v) + ki ∫ (v_s - v) dt) + R(v)

is the force demanded at the wheels. The law of the powertrain gives the force with the throttle closed and open (of a
gearbox: in the usual gear of the speed). A force between the two becomes a throttle position, a force below them a
brake pressure, through the inverted pedal maps. The integral part compensates a grade.

When the set-point is zero and the vehicle is slower than `hold_speed`, the brake is pressed so that it holds the
vehicle on the grade `hold_grade`. The gear changes below that speed only; above it the vehicle is braked until the
set-point has passed zero.
"""

import math
from collections.abc import Callable, MutableSequence, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, Literal, NamedTuple

from pydantic import Field, model_validator

from mirdrake.core.constants import GRAVITY
from mirdrake.core.interpolation import Rows, invert_map
from mirdrake.core.pid import PidGains, PidNumbers, PidState, pid_step, read_pid, write_pid
from mirdrake.core.yaml_io import Speed
from mirdrake.vehicles.joint_control.base import DriveTrain, JointControl, PedalPositions
from mirdrake.vehicles.joint_control.gain_schedule import GainSchedule

if TYPE_CHECKING:
    from mirdrake.vehicles.spec import VehicleSpec

AIR_DENSITY = 1.2  # [kg/m³]
TRACKING_TIME = 0.5
"""Time constant of the anti-windup [s]."""


class PedalState(NamedTuple):
    """Memory of the law.

    Attributes:
        gear: 1 drive, -1 reverse.
        loop: state of the PI controller.
    """

    gear: float = 1.0
    loop: PidState = PidState()


class PedalControl(JointControl):
    """The speed is held by throttle and brake pedal; needs tyres of kind brush or magic_formula.

    kp, ki and max_correction of `speed` are not used.
    """

    gains: ClassVar[dict[str, str]] = {"kp": "1/s", "ki": "1/s²"}
    uses_pedals: ClassVar[bool] = True

    kind: Literal["pedals"]
    kp: float = Field(default=1.5, ge=0, description="[1/s] acceleration over speed error")
    ki: float = Field(default=0.5, ge=0, description="[1/s²] integral gain")
    hold_speed: Speed = Field(
        default=0.3, gt=0, description="[m/s] speed below which a command of zero speed applies the hold brake"
    )
    hold_grade: float = Field(default=0.3, ge=0, description="[-] grade on which the hold brake holds, as weight share")
    schedule: GainSchedule | None = Field(default=None, description="gains over speed, in place of those above; no kd")

    @model_validator(mode="after")
    def _no_kd(self) -> "PedalControl":
        if self.schedule is not None and self.schedule.kd is not None:
            raise ValueError("schedule: pedals have no kd; leave it out")
        return self

    def gain_schedule(self) -> GainSchedule | None:
        """Return the gains over speed."""
        return self.schedule

    def make_pedal_controller(self, drive_train: DriveTrain, spec: "VehicleSpec", period: float) -> "PedalLaw":
        """Return the law for one vehicle."""
        return PedalLaw(self, drive_train, spec, period)


class PedalNumbers(NamedTuple):
    """Numbers of the law for one vehicle.

    Attributes:
        period: time between updates [s].
        inertia: mass with the rotating parts [kg].
        rolling: rolling resistance [N].
        drag: air resistance over v² [N s²/m²].
        max_brake: largest torque of the four brakes [N m].
        hold_speed: speed below which the brake holds the vehicle [m/s].
        hold: position of the brake pedal that holds it [1].
        radius: radius of the driven wheels [m].
        throttle_map: rows of pedal position [1] and share of the drive torque [1].
        brake_map: rows of pedal position [1] and torque of the four brakes [N m].
    """

    period: float
    inertia: float
    rolling: float
    drag: float
    max_brake: float
    hold_speed: float
    hold: float
    radius: float
    throttle_map: Rows
    brake_map: Rows


class ForceLimits(NamedTuple):
    """Limits of the force at the wheels [N] and of its rate [N/s], as :func:`pid_step` uses them."""

    minimum: float
    maximum: float
    rate: float


_EMPTY = PidState()

ThrottleLimits = Callable[[Any, float, float, float], tuple[float, float]]
"""(powertrain, gear, spin rate [rad/s], 0) -> drive torque with the throttle closed and open [N m]."""


class PedalLaw:
    """Pedals for a set-point of the speed, for one vehicle.

    Attributes:
        pedal_numbers: numbers of the law.

    Args:
        options: wheel_speed of control.yaml.
        drive_train: powertrain and pedal maps.
        spec: vehicle.yaml.
        period: time between updates [s].
    """

    def __init__(self, options: PedalControl, drive_train: DriveTrain, spec: "VehicleSpec", period: float) -> None:
        self._drive_train = drive_train
        mass, maps, max_brake = drive_train.mass, drive_train.maps, spec.brakes.max_torque
        # Torque on a grade of `hold_grade`, as far as the brakes have it.
        hold = min(options.hold_grade * mass * GRAVITY * drive_train.radius, max_brake)
        self.pedal_numbers = PedalNumbers(
            period=period,
            inertia=mass + drive_train.rotating,
            rolling=spec.tyres.rolling_resistance * mass * GRAVITY,
            drag=0.5 * AIR_DENSITY * spec.aerodynamics.drag_area,
            max_brake=max_brake,
            hold_speed=options.hold_speed,
            hold=invert_map(maps.brake, hold),
            radius=drive_train.radius,
            throttle_map=maps.throttle,
            brake_map=maps.brake,
        )

    def rest(self) -> list[float]:
        """Return the memory at the start, as numbers."""
        return _flat(PedalState())

    def numbers(self, gains: Sequence[float]) -> PidNumbers:
        """Return the gains of the loop [N s/m, N/m] for kp and ki per mass [1/s, 1/s²]."""
        # The gains are per mass, so that they suit every vehicle.
        kp, ki = gains
        inertia = self.pedal_numbers.inertia
        return PidGains(kp * inertia, ki * inertia, tracking_time=TRACKING_TIME).numbers()

    def step(
        self, memory: Sequence[float], setpoint: float, slope: float, speed: float, *, gains: PidNumbers
    ) -> tuple[list[float], PedalPositions]:
        """Advance by one period; arguments as in :class:`~mirdrake.vehicles.joint_control.base.PedalController`."""
        after = list(memory)
        pedals = pedal_step(_limits, self.pedal_numbers, self._drive_train, after, 0, setpoint, slope, speed, gains)
        return after, pedals

    def advance(
        self, state: PedalState, setpoint: float, slope: float, speed: float, *, gains: PidNumbers
    ) -> tuple[PedalState, PedalPositions]:
        """Advance by one period, with the memory as a :class:`PedalState`."""
        memory, pedals = self.step(_flat(state), setpoint, slope, speed, gains=gains)
        return PedalState(memory[0], PidState(*memory[1:])), pedals


def pedal_step(
    limits: ThrottleLimits,
    numbers: PedalNumbers,
    powertrain: Any,
    memory: MutableSequence[float],
    at: int,
    setpoint: float,
    slope: float,
    speed: float,
    gains: PidNumbers,
) -> PedalPositions:
    """Advance the law by one period, and return the pedals; equations in the head of the module.

    Args:
        limits: torque with the throttle closed and open.
        numbers: numbers of the law.
        powertrain: first argument of `limits`.
        memory: gear and state of the PI controller, changed.
        at: their start in a longer memory.
        setpoint: set-point of the speed [m/s].
        slope: its derivative [m/s²].
        speed: measured speed [m/s].
        gains: gains of the PI controller.
    """
    gear, radius = memory[at], numbers.radius

    # At standstill the brake holds the vehicle, or the gear changes.
    standing = abs(speed) < numbers.hold_speed
    if setpoint == 0.0 and standing:
        write_pid(memory, at + 1, _EMPTY)
        return PedalPositions(0.0, numbers.hold, gear)
    # A set-point in the other direction changes the gear only at standstill; the integral starts anew.
    if setpoint * gear < 0.0 and standing:
        gear = -gear
        write_pid(memory, at + 1, _EMPTY)
    memory[at] = gear

    # Force at the wheels, limited to what engine and brakes can give.

    # Speeds and forces are taken along the gear, so that reverse needs no other signs.
    closed, opened = limits(powertrain, gear, speed / radius, 0.0)
    along = gear * speed
    resistance = numbers.drag * along * abs(along) + (numbers.rolling if along > 0.0 else 0.0)
    loop, force = pid_step(
        read_pid(memory, at + 1),
        gear * setpoint,
        along,
        gains,
        numbers.period,
        ForceLimits((min(closed, opened) - numbers.max_brake) / radius, max(closed, opened) / radius, math.inf),
        numbers.inertia * gear * slope + resistance,
    )
    write_pid(memory, at + 1, loop)

    # The brake gives what the closed throttle does not.
    torque = force * radius
    # Drag or creep of the closed throttle acts in any case.
    if torque < closed:
        return PedalPositions(0.0, invert_map(numbers.brake_map, closed - torque), gear)
    share = (torque - closed) / (opened - closed) if opened > closed else 0.0
    return PedalPositions(invert_map(numbers.throttle_map, share), 0.0, gear)


def _limits(drive_train: DriveTrain, gear: float, rate: float, _: float) -> tuple[float, float]:
    return drive_train.limits(gear, rate)


def _flat(state: PedalState) -> list[float]:
    return [state.gear, *state.loop]


PEDAL_PARTS = (pedal_step, pid_step, read_pid, write_pid, invert_map)
"""Functions that can be compiled."""
