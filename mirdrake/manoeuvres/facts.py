"""What manoeuvres need to know of a vehicle: size, mass, steering, what its motor can hold."""

import math
from dataclasses import dataclass

from mirdrake.core.constants import GRAVITY
from mirdrake.single_track import SingleTrackParameters, estimate_parameters
from mirdrake.vehicles import Vehicle
from mirdrake.vehicles.outline import measure_outline

CAR_WHEELBASE = 2.6
"""Wheelbase of the car for which the manoeuvres are defined [m]: the Chevrolet Bolt's."""

_SWING = 0.4
"""Phase of a driver's frequency in the time until the car turns, see :meth:`Facts.quickest` [rad]."""

_CONTROL = 0.02
"""Part of that time that driver and control unit take, a period each [s]."""

SMALL = 1.5
"""Wheelbase below which a vehicle is smaller than a car, so that speeds and courses are scaled [m]."""


@dataclass(frozen=True)
class Facts:
    """Figures of a vehicle.

    Attributes:
        name: of the vehicle.
        title: make and model.
        wheelbase: [m].
        mass: all of it [kg].
        parameters: of its single-track model.
        ahead: of the centre of mass before the rear axle [m].
        rear: x of the rear end of the body, from the rear axle [m].
        front: x of its front end [m].
        width: of the body [m].
        ratio: hand-wheel angle over road-wheel angle [1].
        steering_limit: of the bicycle angle [rad].
        steering_rate: of the road wheels [rad/s].
        tyres: kind of the tyres.
        has_tyre_law: whether tyre forces come from a tyre law.
        pedals: whether it is driven through pedals.
        top_speed: that its motor's power can hold on the flat [m/s].
        full_throttle: acceleration that its motor and driven wheels allow from standstill [m/s²].
        scale: of lengths for its size [1]; 1 for cars.
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
    has_tyre_law: bool
    pedals: bool
    top_speed: float
    full_throttle: float
    scale: float

    @property
    def understeer(self) -> float:
        """Estimated understeer gradient at the road wheels [rad s²/m], of the single-track model's stiffnesses."""
        p = self.parameters
        return p.mass / p.wheelbase * (p.rear_length / p.front_stiffness - p.front_length / p.rear_stiffness)

    def steering_for(self, lateral_acceleration: float, speed: float) -> float:
        """Estimated bicycle angle [rad] for a lateral acceleration [m/s²] at a speed [m/s]."""
        return (self.wheelbase / speed**2 + self.understeer) * lateral_acceleration

    def pointing(self, speed: float) -> float:
        """Estimated distance before the rear axle [m] of the point that moves as the body points, in a steady turn.

        It is at the rear axle at a crawl and moves ahead with the slip of the rear tyres, by v² m a / (L Cr).
        """
        p = self.parameters
        place = speed**2 * p.mass * p.front_length / (p.wheelbase * p.rear_stiffness)
        return min(place, p.wheelbase)

    def quickest(self, speed: float) -> float:
        """Natural frequency [rad/s] with which a driver can hold a line at a speed [m/s] and not swing with the car.

        The car turns late by the time that its steering and its front tyres take; the swing in yaw grows where that
        is more than 0.4 rad of the driver's frequency.
        """
        p = self.parameters
        return _SWING / (p.steering_lag + p.front_relaxation / speed + _CONTROL)

    def steadiness(self, speed: float) -> float:
        """How far a driver should go by where the car moves, and not by where it points, at a speed [m/s]; up to 1.

        Tyres of relaxation length σ that relax slowly are springs of C/σ on which the car sways, with a damping ratio
        of v √(m / (σ C)) / 2: a driver who answers to that excites it. Twice the ratio is what this is.
        """
        p = self.parameters
        springs = (p.front_stiffness + p.rear_stiffness) / max(p.front_relaxation, 1e-6)
        return min(1.0, speed * math.sqrt(p.mass / springs) / max(p.front_relaxation, 1e-6))


def find_facts(vehicle: Vehicle) -> Facts:
    """The figures of a loaded vehicle."""
    spec, geometry = vehicle.spec, vehicle.geometry
    parameters = estimate_parameters(vehicle)
    box = measure_outline(vehicle.urdf, packages=vehicle.packages, base_link=spec.base_link)
    length = geometry.wheelbase
    half = 0.35 * length if box is None else max(-box.right, box.left)
    rear, front = (-0.3 * length, 1.4 * length) if box is None else (box.rear, box.front)
    radius = geometry.front_wheel_radius if spec.drive != "rear" else geometry.rear_wheel_radius
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
        has_tyre_law=spec.tyres.has_law,
        pedals=vehicle.control.wheel_speed.uses_pedals,
        top_speed=_top_speed(vehicle, parameters, radius),
        full_throttle=spec.powertrain.max_torque / radius / parameters.mass,
        scale=1.0 if length >= SMALL else length / CAR_WHEELBASE,
    )


def _top_speed(vehicle: Vehicle, parameters: SingleTrackParameters, radius: float) -> float:
    """Speed [m/s] at which rolling resistance and drag take all of the power, or the governor acts."""
    power = vehicle.spec.powertrain.max_power
    governed = getattr(vehicle.spec.powertrain, "governed_speed", None)
    rolling = parameters.rolling_resistance * parameters.mass * GRAVITY
    force = vehicle.spec.powertrain.max_torque / radius
    low, high = 0.0, 200.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        needed = rolling + parameters.drag * middle**2
        low, high = (middle, high) if needed <= min(force, power / middle) else (low, middle)
    return min(low, governed) if governed else low
