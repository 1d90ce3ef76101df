"""A speed held with the pedals: what a driver's foot does, as a law.

Counted along the gear, with the slope a of the set-point v_s, the speed v, the mass m with what turns along, and the
resistance R(v) of tyres and air::

    F = m (a + kp (v_s - v) + ki ∫ (v_s - v) dt) + R(v)

is the force wanted at the wheels. What the powertrain gives with the throttle closed and open is known from its own
law (of a gearbox only the usual gear of a speed); a force between the two is a throttle position, a force below is
brake pressure, through the pedal maps read backwards. A grade is left to the integral.

When the set-point is zero and the car is slower than `hold_speed`, the brake is pressed with what holds it on the grade
`hold_grade`. The gear is changed below that speed only; before, the car is braked, as the set-point goes through zero.
"""

from collections.abc import Sequence
from typing import NamedTuple

from mirdrake.controllers.pid import PidGains, PidLimits, PidNumbers, PidState, pid_step
from mirdrake.core.constants import GRAVITY
from mirdrake.plant.powertrain.law import PowertrainLaw
from mirdrake.plant.powertrain.maps import invert_map
from mirdrake.vehicles.spec import PedalControl, VehicleSpec

AIR_DENSITY = 1.2  # [kg/m³]
TRACKING_TIME = 0.5
"""Time constant of the anti-windup [s]."""


class PedalState(NamedTuple):
    """Memory of the law.

    Attributes:
        gear: 1 or -1.
        loop: of the PI controller.
    """

    gear: float = 1.0
    loop: PidState = PidState()

    def flat(self) -> list[float]:
        """As numbers."""
        return [self.gear, *self.loop]

    @classmethod
    def read(cls, numbers: Sequence[float]) -> "PedalState":
        """From :meth:`flat`."""
        return cls(numbers[0], PidState(*numbers[1:]))


class PedalPositions(NamedTuple):
    """Throttle and brake [1], and the gear: 1 drive, -1 reverse."""

    throttle: float
    brake: float
    gear: float


class PedalLaw:
    """Speed set-point to pedals for one vehicle.

    Args:
        options: of control.yaml.
        powertrain: what the vehicle can do, and what its pedals mean.
        spec: vehicle.yaml.
        period: [s]
    """

    def __init__(self, options: PedalControl, powertrain: PowertrainLaw, spec: VehicleSpec, period: float) -> None:
        self._options, self._powertrain, self._period = options, powertrain, period
        mass = powertrain.mass
        self._inertia = mass + powertrain.rotating
        self._rolling = spec.tyres.rolling_resistance * mass * GRAVITY
        self._drag = 0.5 * AIR_DENSITY * spec.aerodynamics.drag_area
        self._most = spec.brakes.max_torque
        hold = min(options.hold_grade * mass * GRAVITY * powertrain.radius, self._most)
        self._hold = invert_map(powertrain.maps.brake, hold)

    def gains(self, kp: float, ki: float) -> PidGains:
        """Gains of the loop [N s/m, N/m] from those per mass [1/s, 1/s²]."""
        return PidGains(kp * self._inertia, ki * self._inertia, tracking_time=TRACKING_TIME)

    def step(
        self, state: PedalState, wanted: float, slope: float, speed: float, *, gains: PidGains | PidNumbers
    ) -> tuple[PedalState, PedalPositions]:
        """One step.

        Args:
            state: what the last step returned.
            wanted: set-point of the speed [m/s], positive ahead.
            slope: its slope [m/s²].
            speed: that the vehicle has [m/s].
            gains: from :meth:`gains`.
        """
        gear, loop = state
        standing = abs(speed) < self._options.hold_speed
        if wanted == 0.0 and standing:
            return PedalState(gear), PedalPositions(0.0, self._hold, gear)
        if wanted * gear < 0.0 and standing:
            gear, loop = -gear, PidState()
        train, radius = self._powertrain, self._powertrain.radius
        closed, opened = train.limits(gear, speed / radius)
        along = gear * speed
        resistance = self._drag * along * abs(along) + (self._rolling if along > 0.0 else 0.0)
        loop, force = pid_step(
            loop,
            gear * wanted,
            along,
            gains=gains,
            period=self._period,
            limits=PidLimits((min(closed, opened) - self._most) / radius, max(closed, opened) / radius),
            feedforward=self._inertia * gear * slope + resistance,
        )
        torque = force * radius
        if torque < closed:
            return PedalState(gear, loop), PedalPositions(0.0, invert_map(train.maps.brake, closed - torque), gear)
        part = (torque - closed) / (opened - closed) if opened > closed else 0.0
        return PedalState(gear, loop), PedalPositions(invert_map(train.maps.throttle, part), 0.0, gear)
