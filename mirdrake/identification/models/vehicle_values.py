"""What a vehicle's files say of the parameters of a model: starts of a fit, and what its results are compared with.

A single track with relaxation and pneumatic trail has the tyres as their law has them at the static load; with roll the
camber thrust of leaning wheels stands apart. In a slow turn of lateral acceleration ay the body leans by φ, the tyres
of an axle bring F at the slip α, with the aligning moment M, all of it in the limit of a small ay::

    F = m ay b / L (front), m ay a / L (rear)        C = -F / α0        t = |M| / F        e = (α0 - α) / φ

with α0 the slip of upright wheels. Without roll C = -F / α, and leaning is in it. Where what is recorded is what the
steering is asked for, and not the angle of the wheels, its servos of stiffness k and damping d give way to the moment,
late by d / k. With c = C t / 2 k the front axle then answers a slip with C / (1 + σ p / v + c / (1 + p d / k)), nearly
with C / (1 + c) and the relaxation length (σ - c v d / k) / (1 + c), here at v = 20 m/s. Where the model rolls, the
moment of the leaning wheels, M - M0 with M0 that of upright ones of the same force, turns what gives way by
-(M - M0) / 2 k, which goes with φ, and c has the trail of M0. The front wheels, which spin with the angular momentum
h v, are a gyroscope: rolled with the rate p, they turn it by -h v p / 2 k. A single track without relaxation has
effective axles instead, see :mod:`mirdrake.single_track.axles`.
"""

import math
from collections.abc import Sequence

from pydrake.multibody.plant import MultibodyPlant
from scipy.optimize import brentq

from mirdrake.single_track import SingleTrackParameters, estimate_parameters
from mirdrake.tyres.wheel_laws import TyreAtLoad, TyreLaw, make_tyre_laws
from mirdrake.vehicles import Vehicle
from mirdrake.vehicles.parse import parse_urdf
from mirdrake.worlds.world import GRAVITY

_LATERAL = 0.02 * GRAVITY  # of the turn [m/s²]: the limit of small ones
_SPEED = 20.0  # at which the laws are asked, and the steering gives way [m/s]
_LARGEST = 0.3  # slip angle [rad]
_AXLES = ("front", "rear")


def vehicle_values(
    vehicle: Vehicle, kind: str = "single_track", *, relaxation: bool = True, measured: bool = True
) -> dict[str, float]:
    """Values by name of the parameter.

    Args:
        vehicle: a loaded vehicle.
        kind: of the model.
        relaxation: False: of a single track with effective axles.
        measured: whether the angle of the wheels is recorded, and not what the steering is asked for.

    Raises:
        ConfigError: a .tir file is missing or wrong.
    """
    p = estimate_parameters(vehicle)
    found: dict[str, float] = {
        "mass": p.mass,
        "yaw_inertia": p.yaw_inertia,
        "front_length": p.front_length,
        "rear_length": p.rear_length,
        "com_height": p.com_height,
        "cornering_stiffness_front": p.front_stiffness,
        "cornering_stiffness_rear": p.rear_stiffness,
        "rolling_resistance": p.rolling_resistance,
        "drag": p.drag,
        "rotating_mass": p.rotating_mass,
        "hand_wheel_ratio": vehicle.spec.steering.ratio,
    }
    lag = vehicle.spec.actuators.steering.time_constant
    if not measured and lag > 0.0 and kind != "plant":
        found["steering_lag"] = lag
    leaning = {} if vehicle.spec.suspension is None else _of_roll(vehicle)
    give = (0.0, 0.0) if measured else _steering_give(vehicle)
    if kind == "single_track_roll":
        found |= leaning
        if leaning:
            found["roll_rate_steer"] = give[0] * _wheel_momentum(vehicle, 2)
    laws = make_tyre_laws(vehicle)
    if laws is not None and relaxation and kind.startswith("single_track"):
        tyres = _of_tyres(laws, p, leaning.get("roll_gain", 0.0), give, upright=kind == "single_track_roll")
        if "roll_steer" in tyres:  # of what gives way, beside that of the leaning wheels' thrust
            tyres["roll_steer"] += leaning["roll_steer"]
        found |= tyres
    return found


def _of_roll(vehicle: Vehicle) -> dict[str, float]:
    """Roll of the body, with the force of the tyres as its input, and what spinning wheels have to do with it."""
    p = estimate_parameters(vehicle, roll=True)
    arm = p.roll_mass * p.roll_height
    righting = p.roll_stiffness - arm * GRAVITY
    inertia = p.roll_inertia + p.roll_mass * p.roll_height**2 - arm * arm / p.mass
    frequency = math.sqrt(righting / inertia)
    return {
        "roll_gain": arm / righting,
        "roll_frequency": frequency,
        "roll_damping": 0.5 * p.roll_damping / (frequency * inertia),
        "roll_arm": arm / p.mass,
        "roll_steer": -p.front_roll_slip,
        "roll_steer_rear": -p.rear_roll_slip,
        "wheel_momentum": _wheel_momentum(vehicle),
    }


def _wheel_momentum(vehicle: Vehicle, count: int = 4) -> float:
    """Angular momentum of the first wheels, those in front first, over the speed of the car [kg m]."""
    plant, _, _ = parse_urdf(vehicle.urdf, packages=vehicle.packages, where_line=str)
    names, radii = vehicle.spec.joints.wheels.names()[:count], vehicle.geometry.wheel_radii[:count]
    return sum(spin_inertia(plant, name) / radius for name, radius in zip(names, radii, strict=True))


def spin_inertia(plant: MultibodyPlant, joint: str) -> float:
    """Of what turns on a joint, about its axis, without a motor [kg m²]."""
    revolute = plant.GetJointByName(joint)
    body = revolute.child_body()
    axis = revolute.frame_on_child().GetFixedPoseInBodyFrame().rotation().multiply(revolute.revolute_axis())
    inertia = body.default_spatial_inertia()
    tensor = inertia.Shift(inertia.get_com()).CalcRotationalInertia().CopyToFullMatrix3()
    return float(axis @ tensor @ axis)


def _steering_give(vehicle: Vehicle) -> tuple[float, float]:
    """Angle of the front wheels over the aligning moment of both [rad/(N m)], and how late it comes [s]."""
    servo = vehicle.control.steering
    if servo.kind != "servo" or servo.stiffness <= 0.0:
        return 0.0, 0.0
    return 0.5 / servo.stiffness, servo.damping / servo.stiffness


def _of_tyres(
    laws: Sequence[TyreLaw], p: SingleTrackParameters, gain: float, give: tuple[float, float], *, upright: bool
) -> dict[str, float]:
    """Stiffness, trail and relaxation of the axles; see the head of the module.

    Args:
        laws: of front and rear tyres.
        p: mass and lengths.
        gain: roll angle over lateral acceleration [rad s²/m].
        give: of the steering, see :func:`_steering_give`.
        upright: whether the stiffness is that of upright wheels.
    """
    found: dict[str, float] = {}
    length = p.front_length + p.rear_length
    for axle, law, arm in zip(_AXLES, laws, (p.rear_length, p.front_length), strict=True):
        force, load = 0.5 * p.mass * _LATERAL * arm / length, 0.5 * p.mass * GRAVITY * arm / length
        straight, leaning = law(load, 0.0, 1.0), law(load, gain * _LATERAL, 1.0)
        slip = _slip(leaning, force)
        trail = abs(leaning.forces(0.0, math.tan(slip), _SPEED)[2]) / force
        own = _slip(straight, force) if upright else slip
        stiffness = -2.0 * force / own
        pull = abs(straight.forces(0.0, math.tan(own), _SPEED)[2]) / force if upright else trail  # the rest is camber's
        yielding = stiffness * pull * give[0] if axle == "front" else 0.0
        if axle == "front" and yielding > 0.0 and gain > 0.0 and upright:
            found["roll_steer"] = -2.0 * (trail - pull) * force * give[0] / (gain * _LATERAL)
        found |= {
            f"cornering_stiffness_{axle}": stiffness / (1.0 + yielding),
            f"relaxation_{axle}": max(straight.contact.length_y - yielding * _SPEED * give[1], 0.0) / (1.0 + yielding),
            f"trail_{axle}": trail,
        }
    return found


def _slip(tyre: TyreAtLoad, wanted: float) -> float:
    """Slip angle [rad] at which a tyre has a lateral force [N]."""
    return float(brentq(lambda slip: tyre.forces(0.0, math.tan(slip), _SPEED)[1] - wanted, -_LARGEST, _LARGEST))
