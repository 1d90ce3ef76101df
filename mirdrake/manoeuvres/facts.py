"""Figures of a vehicle that manoeuvres need: size, mass, steering, top speed."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from mirdrake.core.constants import GRAVITY
from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.single_track import SingleTrackParameters, estimate_parameters, steady_steering, understeer_gradient
from mirdrake.single_track.from_vehicle import has_roll, tyres_of
from mirdrake.single_track.parameters import PARAMETERS
from mirdrake.vehicles import Vehicle
from mirdrake.vehicles.outline import measure_outline

CAR_WHEELBASE = 2.6
"""Wheelbase of the car for which the manoeuvres are defined [m]: the Chevrolet Bolt's."""

_DELAY_PHASE = 0.4
"""Allowed phase lag by delays at the natural frequency of the driver, see :meth:`Facts.quickest` [rad]."""

_CONTROL_DELAY = 0.02
"""Delay of driver and control unit, a period each [s]."""

SMALL = 1.5
"""Wheelbase below which speeds and courses are scaled to the size of the vehicle [m]."""


@dataclass(frozen=True)
class Facts:
    """Figures of a vehicle.

    Attributes:
        name: name of the vehicle.
        title: make and model.
        wheelbase: wheelbase [m].
        mass: total mass [kg].
        parameters: parameters of its single-track model.
        ahead: distance of the centre of mass ahead of the rear axle [m].
        rear: x of the rear end of the body, from the rear axle [m].
        front: x of the front end of the body, from the rear axle [m].
        width: width of the body [m].
        ratio: hand-wheel angle over road-wheel angle [1].
        steering_limit: largest bicycle angle [rad].
        steering_rate: largest rate of the road wheels [rad/s].
        tyres: kind of the tyres.
        has_slip: whether tyre forces follow from slip.
        pedals: whether it is driven through pedals.
        top_speed: top speed on the flat, by power, governor or limit of the set-point [m/s].
        scale: scale of lengths for its size [1]; 1 for cars.
        with_roll: parameters of its single-track model with roll; `parameters` if it has no suspension.
        model_tyres: tyre law of its single-track model.
        changes: parameters that differ from those of the vehicle, by name.
    """

    name: str
    title: str
    wheelbase: float
    mass: float
    parameters: SingleTrackParameters
    ahead: float
    rear: float
    front: float
    width: float
    ratio: float
    steering_limit: float
    steering_rate: float
    tyres: str
    has_slip: bool
    pedals: bool
    top_speed: float
    scale: float
    with_roll: SingleTrackParameters
    model_tyres: str
    changes: Mapping[str, float] = field(default_factory=dict)

    def with_parameters(self, changes: Mapping[str, float]) -> "Facts":
        """Return the figures of the vehicle with other parameters of its single-track model, by name.

        Raises:
            ConfigError: there is no such parameter, or a value is out of range.
        """
        if changes == self.changes:
            return self
        for name in changes:
            if name not in PARAMETERS:
                raise ConfigError(f"no such parameter; {did_you_mean(name, PARAMETERS)}", path=("single_track", name))
        parameters = replace(self.parameters, **changes)
        return replace(
            self,
            parameters=parameters,
            changes=dict(changes),
            mass=parameters.mass,
            ahead=parameters.rear_length,
            wheelbase=parameters.wheelbase,
        )

    @property
    def understeer(self) -> float:
        """Estimated understeer gradient at the road wheels, of the single-track model's stiffnesses [rad s²/m]."""
        return understeer_gradient(self.parameters)

    def steering_for(self, lateral_acceleration: float, speed: float) -> float:
        """Return the estimated bicycle angle [rad] for a lateral acceleration [m/s²] at a speed [m/s].

        It is that of the single-track model with its tyre law and roll, or of linear tyres beyond the limit of its law.
        """
        parameters = replace(self.with_roll, **self.changes) if self.changes else self.with_roll
        angle = steady_steering(parameters, self.model_tyres, lateral_acceleration, speed)
        return (self.wheelbase / speed**2 + self.understeer) * lateral_acceleration if math.isnan(angle) else angle

    def pointing(self, speed: float) -> float:
        """Return the estimated distance [m] ahead of the rear axle of the point without sideslip in a steady turn.

        It is at the rear axle at low speed and moves ahead with the slip of the rear tyres, by v² m a / (L Cr).
        """
        p = self.parameters
        return min(speed**2 * p.mass * p.front_length / (p.wheelbase * p.rear_stiffness), p.wheelbase)

    def quickest(self, speed: float) -> float:
        """Return the largest natural frequency [rad/s] of a driver at a speed [m/s] without oscillation.

        Steering, front tyres and control delay the yaw rate; oscillations in yaw grow where the phase lag of the delay
        is above 0.4 rad at the frequency of the driver.
        """
        p = self.parameters
        return _DELAY_PHASE / (p.steering_lag + p.front_relaxation / speed + _CONTROL_DELAY)

    def steadiness(self, speed: float) -> float:
        """Return the weight of the course against the heading in the feedback of a driver at a speed [m/s]; up to 1.

        Tyres with a long relaxation length σ act as springs C/σ, on which the car oscillates laterally with a damping
        ratio of v √(m / (σ C)) / 2. Feedback of the course excites this oscillation. The weight is twice the ratio.
        """
        p = self.parameters
        springs = (p.front_stiffness + p.rear_stiffness) / max(p.front_relaxation, 1e-6)
        return min(1.0, speed * math.sqrt(p.mass / springs) / max(p.front_relaxation, 1e-6))


def find_facts(vehicle: Vehicle) -> Facts:
    """Return the figures of a loaded vehicle."""
    spec, geometry = vehicle.spec, vehicle.geometry
    parameters = estimate_parameters(vehicle)
    rolls = has_roll(vehicle)
    box = measure_outline(vehicle.urdf, packages=vehicle.packages, base_link=spec.base_link)
    # Ends and sides of the collision shapes; without any, proportions of a usual car to the wheelbase.
    length = geometry.wheelbase
    half = 0.35 * length if box is None else max(-box.right, box.left)
    rear, front = (-0.3 * length, 1.4 * length) if box is None else (box.rear, box.front)
    radius = geometry.front_wheel_radius if spec.drive != "rear" else geometry.rear_wheel_radius

    # The steering limit is that of the inner wheel; Ackermann: cot δ = cot δ_inner + track / (2 L) for the bicycle
    # angle.
    inner = geometry.steering_limit
    limit = math.atan(1.0 / (1.0 / math.tan(inner) + geometry.kingpin_track / (2.0 * length)))
    return Facts(
        name=vehicle.name,
        title=spec.name,
        wheelbase=length,
        mass=parameters.mass,
        parameters=parameters,
        ahead=parameters.rear_length,
        rear=rear,
        front=front,
        width=2.0 * half,
        ratio=spec.steering.ratio,
        steering_limit=limit,
        steering_rate=geometry.steering_rate,
        tyres=spec.tyres.kind,
        has_slip=spec.tyres.has_slip,
        pedals=vehicle.control.wheel_speed.uses_pedals,
        top_speed=_top_speed(vehicle, parameters, radius),
        scale=1.0 if length >= SMALL else length / CAR_WHEELBASE,
        with_roll=estimate_parameters(vehicle, roll=True) if rolls else parameters,
        model_tyres=tyres_of(vehicle),
    )


def _top_speed(vehicle: Vehicle, parameters: SingleTrackParameters, radius: float) -> float:
    """Return the top speed [m/s]: where rolling resistance and drag need all of the power, or the lowest limit.

    Limits are those of the governor and of the set-point.
    """
    power = vehicle.spec.powertrain.max_power
    limits = (getattr(vehicle.spec.powertrain, "governed_speed", None), vehicle.control.speed.max_speed)
    rolling = parameters.rolling_resistance * parameters.mass * GRAVITY
    force = vehicle.spec.powertrain.max_torque / radius
    # Bisection on the largest speed at which the driving force, limited by torque or power, exceeds the resistance.
    low, high = 0.0, 200.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        needed = rolling + parameters.drag * middle**2
        low, high = (middle, high) if needed <= min(force, power / middle) else (low, middle)
    return min([low, *(float(limit) for limit in limits if limit)])
