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

from collections.abc import Sequence
from typing import TYPE_CHECKING, ClassVar, Literal, NamedTuple

from pydantic import Field, model_validator

from mirdrake.core.constants import GRAVITY
from mirdrake.core.pid import PidGains, PidLimits, PidNumbers, PidState, pid_step
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
    """The speed is held by throttle and brake pedal: mirdrake/vehicles/joint_control/pedals.py.

    Only with tyres that take torques, brush or magic_formula; kp, ki and max_correction of `speed` are not used.
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


class PedalLaw:
    """Pedals for a set-point of the speed, for one vehicle.

    Args:
        options: wheel_speed of control.yaml.
        drive_train: powertrain and pedal maps.
        spec: vehicle.yaml.
        period: time between updates [s].
    """

    def __init__(self, options: PedalControl, drive_train: DriveTrain, spec: "VehicleSpec", period: float) -> None:
        self._options, self._drive_train, self._period = options, drive_train, period
        mass = drive_train.mass
        self._inertia = mass + drive_train.rotating
        self._rolling = spec.tyres.rolling_resistance * mass * GRAVITY
        self._drag = 0.5 * AIR_DENSITY * spec.aerodynamics.drag_area
        self._max_brake = spec.brakes.max_torque
        # Torque on a grade of `hold_grade`, as far as the brakes have it.
        hold = min(options.hold_grade * mass * GRAVITY * drive_train.radius, self._max_brake)
        self._hold = drive_train.maps.brake_position(hold)

    def rest(self) -> list[float]:
        """Return the memory at the start, as numbers."""
        return _flat(PedalState())

    def numbers(self, gains: Sequence[float]) -> PidNumbers:
        """Return the gains of the loop [N s/m, N/m] for kp and ki per mass [1/s, 1/s²]."""
        # The gains are per mass, so that they suit every vehicle.
        kp, ki = gains
        return PidGains(kp * self._inertia, ki * self._inertia, tracking_time=TRACKING_TIME).numbers()

    def step(
        self, memory: Sequence[float], setpoint: float, slope: float, speed: float, *, gains: PidNumbers
    ) -> tuple[list[float], PedalPositions]:
        """Advance by one period; arguments as in :class:`~mirdrake.vehicles.joint_control.base.PedalController`."""
        state, pedals = self.advance(PedalState(memory[0], PidState(*memory[1:])), setpoint, slope, speed, gains=gains)
        return _flat(state), pedals

    def advance(
        self, state: PedalState, setpoint: float, slope: float, speed: float, *, gains: PidNumbers
    ) -> tuple[PedalState, PedalPositions]:
        """Advance by one period, with the memory as a :class:`PedalState`."""
        gear, loop = state
        train, radius = self._drive_train, self._drive_train.radius

        # At standstill the brake holds the vehicle, or the gear changes.
        standing = abs(speed) < self._options.hold_speed
        if setpoint == 0.0 and standing:
            return PedalState(gear), PedalPositions(0.0, self._hold, gear)
        # A set-point in the other direction changes the gear only at standstill; the integral starts anew.
        if setpoint * gear < 0.0 and standing:
            gear, loop = -gear, PidState()

        # Force at the wheels, limited to what engine and brakes can give.

        # Speeds and forces are taken along the gear, so that reverse needs no other signs.
        closed, opened = train.limits(gear, speed / radius)
        along = gear * speed
        resistance = self._drag * along * abs(along) + (self._rolling if along > 0.0 else 0.0)
        loop, force = pid_step(
            loop,
            gear * setpoint,
            along,
            gains=gains,
            period=self._period,
            limits=PidLimits((min(closed, opened) - self._max_brake) / radius, max(closed, opened) / radius),
            feedforward=self._inertia * gear * slope + resistance,
        )

        # The brake gives what the closed throttle does not.
        torque, state = force * radius, PedalState(gear, loop)
        # Drag or creep of the closed throttle acts in any case.
        if torque < closed:
            return state, PedalPositions(0.0, train.maps.brake_position(closed - torque), gear)
        share = (torque - closed) / (opened - closed) if opened > closed else 0.0
        return state, PedalPositions(train.maps.throttle_position(share), 0.0, gear)


def _flat(state: PedalState) -> list[float]:
    return [state.gear, *state.loop]
