"""What a vehicle's files say of the parameters of a model: starts of a fit, and what its results are compared with.

A single track with relaxation and pneumatic trail has the tyres as their law has them at the static load; with roll the
camber thrust of leaning wheels stands apart. In a slow turn of lateral acceleration ay the body leans by φ, the tyres
of an axle bring F at the slip α, with the aligning moment M, all of it in the limit of a small ay::

    F = m ay b / L (front), m ay a / L (rear)        C = -F / α0        e = (α0 - α) / φ

with α0 the slip and M0 the moment of upright wheels of the same force; then t = |M0| / F, and leaning wheels have the
moment (M - M0) / φ more. Without roll C = -F / α and t = |M| / F, and leaning is in them. Where what is recorded is
what the steering is asked for, and not the angle of the wheels, its servos of stiffness k and damping d give way to the
moments of both wheels by 1 / 2 k, late by d / k. A single track without relaxation has effective axles instead, see
:mod:`mirdrake.single_track.axles`.
"""

import math
from collections.abc import Sequence

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from scipy.optimize import brentq, least_squares

from mirdrake.core.constants import GRAVITY
from mirdrake.identification.models.base import Array
from mirdrake.single_track import SingleTrackParameters, estimate_parameters
from mirdrake.tyres.wheel_laws import TyreAtLoad, TyreLaw, make_tyre_laws
from mirdrake.vehicles import Vehicle
from mirdrake.vehicles.parse import parse_urdf
from mirdrake.vehicles.powertrain_spec import rotor_inertia

_LATERAL = 0.02 * GRAVITY  # of the turn [m/s²]: the limit of small ones
_SPEED = 20.0  # at which the laws are asked [m/s]
_LARGEST = 0.3  # slip angle [rad]
_ROLLING = (0.1, 1.4, 14)  # frequencies at which roll is asked, over the natural one: first, last, number
_LATE = 0.01  # about what dampers are late by [s]
_CHANGE = 0.02  # of a load, to see what the stiffness does
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
        "front_drive": p.front_drive,
        "front_brake": p.front_brake,
        "rotating_mass": p.rotating_mass,
        "hand_wheel_ratio": vehicle.spec.steering.ratio,
    }
    lag = vehicle.spec.actuators.steering.time_constant
    if not measured and lag > 0.0 and kind != "plant":
        found["steering_lag"] = lag
    wheels = _of_wheels(vehicle)
    rolls = {} if vehicle.spec.suspension is None else _of_roll(vehicle, wheels["wheel_momentum"])
    leaning = kind == "single_track_roll" and bool(rolls)
    if kind.startswith("single_track"):
        found |= (rolls | wheels) if leaning else {one: wheels[one] for one in ("spin_inertia", "steering_inertia")}
    laws = make_tyre_laws(vehicle)
    if laws is not None and relaxation and kind.startswith("single_track"):
        gain = rolls.get("roll_gain", 0.0)
        if not measured:
            found |= _steering_give(vehicle)
        found |= _of_tyres(laws, p, gain, upright=kind == "single_track_roll")
        if leaning:
            front, rear = _camber_moments(laws, p, gain)
            found |= {"camber_moment": front, "roll_moment": found["roll_moment"] + front + rear}
    return found


def _of_roll(vehicle: Vehicle, momentum: float) -> dict[str, float]:
    """Roll of the body, with the force of the tyres as its input, and what it does to the car.

    Frequency, damping and lateness of the dampers are those with which the equations of the model come closest to how
    the body rolls on springs, tyres and wheels that swing between them.

    Args:
        vehicle: with a suspension.
        momentum: of the wheels over the speed [kg m]; yawed with ay / vx, they roll the body.
    """
    p = estimate_parameters(vehicle, roll=True)
    arm = p.roll_mass * p.roll_height
    righting = p.roll_stiffness - arm * GRAVITY
    inertia = p.roll_inertia + p.roll_mass * p.roll_height**2 - arm * arm / p.mass
    frequency = math.sqrt(righting / inertia)
    damping = 0.5 * p.roll_damping / (frequency * inertia)
    rates = frequency * np.linspace(*_ROLLING)
    swings = [estimate_parameters(vehicle, roll=True, roll_frequency=float(rate)) for rate in rates]
    resisting = np.array([
        complex(one.roll_stiffness - arm * GRAVITY - inertia * rate**2, rate * one.roll_damping)
        for one, rate in zip(swings, rates, strict=True)
    ])  # fmt: skip
    wanted = rates * righting / resisting  # roll rate over what a force would lean the body by if it stayed

    def misses(z: Array) -> Array:
        gain, natural, ratio, late = z * (1.0, frequency, damping, _LATE)
        damped = 2.0 * ratio * natural * 1j * rates / (1.0 + 1j * rates * late)
        missed = rates * gain * natural**2 / (natural**2 - rates**2 + damped) - wanted
        return np.concatenate((missed.real, missed.imag)) / frequency

    found = least_squares(misses, np.ones(4)).x * (1.0, frequency, damping, _LATE)
    gain, natural, ratio, late = found.tolist()
    return {
        "roll_gain": gain * (arm + momentum) / righting,
        "roll_frequency": natural,
        "roll_damping": ratio,
        "roll_damper_time": max(late, 0.0),
        "roll_arm": arm / p.mass,
        "roll_steer": -p.front_roll_slip,
        "roll_steer_rear": -p.rear_roll_slip,
        "roll_moment": -p.rolling_resistance * p.roll_stiffness,  # which moves load by its moment over the track
    }


def _of_wheels(vehicle: Vehicle) -> dict[str, float]:
    """What wheels do: their angular momentum over the speed of the car, how they resist yawing and being steered.

    A motor adds to the inertia of each wheel that it drives, as it does in the plant.
    """
    plant, _, _ = parse_urdf(vehicle.urdf, packages=vehicle.packages, where_line=str)
    geometry = vehicle.geometry
    tracks = (geometry.front_track, geometry.front_track, geometry.rear_track, geometry.rear_track)
    momentum = resisting = 0.0
    names, spec = vehicle.spec.joints.wheels.names(), vehicle.spec
    rolling = 1.0 if spec.tyres.kind == "coulomb" else spec.tyres.rolling_ratio
    for index, (name, unloaded, track) in enumerate(zip(names, geometry.wheel_radii, tracks, strict=True)):
        inertia, radius = spin_inertia(plant, name), rolling * unloaded
        momentum += inertia / radius
        rotor = rotor_inertia(spec.powertrain, drive=spec.drive, front=index < 2)
        resisting += (inertia + rotor) * (0.5 * track / radius) ** 2  # those outside of a bend turn faster
    inertias = plant.CalcMassMatrix(plant.CreateDefaultContext()).diagonal()
    steered = sum(float(inertias[plant.GetJointByName(name).velocity_start()]) for name in spec.joints.steering.names())
    return {"wheel_momentum": momentum, "spin_inertia": resisting, "steering_inertia": steered}


def spin_inertia(plant: MultibodyPlant, joint: str) -> float:
    """Of what turns on a joint, about its axis, without a motor [kg m²]."""
    revolute = plant.GetJointByName(joint)
    body = revolute.child_body()
    axis = revolute.frame_on_child().GetFixedPoseInBodyFrame().rotation().multiply(revolute.revolute_axis())
    inertia = body.default_spatial_inertia()
    tensor = inertia.Shift(inertia.get_com()).CalcRotationalInertia().CopyToFullMatrix3()
    return float(axis @ tensor @ axis)


def _steering_give(vehicle: Vehicle) -> dict[str, float]:
    """How the steering gives way to the moments of its wheels."""
    servo = vehicle.control.steering
    if servo.kind != "servo" or servo.stiffness <= 0.0:
        return {}
    return {
        "steering_compliance": 0.5 / servo.stiffness,
        "steering_compliance_time": servo.damping / servo.stiffness,
    }


def _of_tyres(laws: Sequence[TyreLaw], p: SingleTrackParameters, gain: float, *, upright: bool) -> dict[str, float]:
    """Stiffness, trail and relaxation of the axles; see the head of the module.

    Args:
        laws: of front and rear tyres.
        p: mass and lengths.
        gain: roll angle over lateral acceleration [rad s²/m].
        upright: whether the stiffness is that of upright wheels.
    """
    found: dict[str, float] = {}
    growths = []
    for axle, law, (force, load) in zip(_AXLES, laws, _turn(p), strict=True):
        less, more = (_slip(law(factor * load, 0.0, 1.0), force) for factor in (1.0 - _CHANGE, 1.0 + _CHANGE))
        growths.append(math.log(less / more) / math.log((1.0 + _CHANGE) / (1.0 - _CHANGE)))
        tyre = law(load, 0.0 if upright else gain * _LATERAL, 1.0)
        slip = _slip(tyre, force)
        found |= {
            f"cornering_stiffness_{axle}": -2.0 * force / slip,
            f"relaxation_{axle}": tyre.contact.length_y,
            f"trail_{axle}": abs(_moment(tyre, slip)) / force,
        }
    # Stiffness grows more slowly than the load.
    return found | {"load_transfer": p.com_height * sum(growths) / len(growths)}


def _camber_moments(laws: Sequence[TyreLaw], p: SingleTrackParameters, gain: float) -> tuple[float, float]:
    """Moment of both leaning wheels of an axle beside that of their force, over roll, front and rear [N m/rad]."""
    found = []
    for law, (force, load) in zip(laws, _turn(p), strict=True):
        upright, leaning = (
            _moment(tyre, _slip(tyre, force)) for tyre in (law(load, roll, 1.0) for roll in (0.0, gain * _LATERAL))
        )
        found.append(2.0 * (leaning - upright) / (gain * _LATERAL))
    return found[0], found[1]


def _turn(p: SingleTrackParameters) -> list[tuple[float, float]]:
    """Lateral force and load of a wheel in the turn, front and rear [N]."""
    length = p.front_length + p.rear_length
    return [
        (0.5 * p.mass * _LATERAL * arm / length, 0.5 * p.mass * GRAVITY * arm / length)
        for arm in (p.rear_length, p.front_length)
    ]


def _moment(tyre: TyreAtLoad, slip: float) -> float:
    """Aligning moment [N m]."""
    return float(tyre.forces(0.0, math.tan(slip), _SPEED)[2])


def _slip(tyre: TyreAtLoad, wanted: float) -> float:
    """Slip angle [rad] at which a tyre has a lateral force [N]."""
    return float(brentq(lambda slip: tyre.forces(0.0, math.tan(slip), _SPEED)[1] - wanted, -_LARGEST, _LARGEST))
