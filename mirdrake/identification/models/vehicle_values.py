"""Parameter values from the files of a vehicle: starting values of a fit, and references for its results.

A single track with relaxation and pneumatic trail has the tyres of the vehicle at their static load; with roll, camber
thrust is a separate effect. In a slow turn of lateral acceleration ay the body rolls by φ, and the tyres of an axle
have the force F at the slip α with the aligning moment M, all in the limit of a small ay::

    F = m ay b / L (front), m ay a / L (rear)        C = -F / α0        e = (α0 - α) / φ

α0 and M0 are slip and moment of upright wheels with the same force; then t = |M0| / F, and camber adds the moment
(M - M0) / φ. Without roll, C = -F / α and t = |M| / F contain the camber. Where the set-point of the steering is
recorded rather than the road wheel angle, its servos of stiffness k and damping d deflect under the moments of both
wheels by 1 / 2 k with the time constant d / k. A single track without relaxation has effective axles instead, see
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
from mirdrake.tyres import SlipTyres, TyreAtLoad, TyreLaw
from mirdrake.vehicles import Vehicle
from mirdrake.vehicles.parse import parse_urdf

_LATERAL = 0.02 * GRAVITY  # lateral acceleration of the turn [m/s²]: the limit of small ones
_SPEED = 20.0  # speed at which the tyre laws are evaluated [m/s]
_MAX_SLIP = 0.3  # largest slip angle [rad]
_ROLL_FREQUENCIES = (0.1, 1.4, 14)  # frequencies of the roll response over the natural one: first, last, number
_DAMPER_LAG = 0.01  # usual lag of the dampers [s]
_LOAD_CHANGE = 0.02  # relative change of a load for the derivative of the stiffness
_AXLES = ("front", "rear")


def common_values(vehicle: Vehicle, *, measured: bool) -> dict[str, float]:
    """Return the values that all models share, by name of the parameter.

    Args:
        vehicle: a loaded vehicle.
        measured: whether the road wheel angle is recorded, rather than its set-point.

    Raises:
        ConfigError: a .tir file is missing or wrong.
    """
    p = estimate_parameters(vehicle)
    values: dict[str, float] = {
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
    # A measured road wheel angle is behind the actuator and contains its lag.
    lag = vehicle.spec.actuators.steering.time_constant
    if not measured and lag > 0.0:
        values["steering_lag"] = lag
    return values


def single_track_values(
    vehicle: Vehicle, *, roll: bool = False, relaxation: bool = True, measured: bool = True
) -> dict[str, float]:
    """Return the values of a single track, by name of the parameter.

    Args:
        vehicle: a loaded vehicle.
        roll: whether the model has roll.
        relaxation: False for a single track with effective axles.
        measured: whether the road wheel angle is recorded, rather than its set-point.

    Raises:
        ConfigError: a .tir file is missing or wrong.
    """
    values = common_values(vehicle, measured=measured)
    wheels = _wheel_values(vehicle)
    roll_values = {} if vehicle.spec.suspension is None else _roll_values(vehicle, wheels["wheel_momentum"])
    has_roll = roll and bool(roll_values)
    # Without roll, the inertias of the wheels still act on yaw and steering.
    values |= (
        (roll_values | wheels) if has_roll else {name: wheels[name] for name in ("spin_inertia", "steering_inertia")}
    )
    tyres = vehicle.spec.tyres
    if isinstance(tyres, SlipTyres) and relaxation:
        laws = tyres.axle_laws(vehicle.folder)
        p, gain = estimate_parameters(vehicle), roll_values.get("roll_gain", 0.0)
        # A measured road wheel angle contains the compliance of the steering already.
        if not measured:
            values |= _steering_compliance(vehicle)
        values |= _tyre_values(laws, p, gain, upright=roll)
        if has_roll:
            front, rear = _camber_moments(laws, p, gain)
            values |= {"camber_moment": front, "roll_moment": values["roll_moment"] + front + rear}
    return values


def _roll_values(vehicle: Vehicle, momentum: float) -> dict[str, float]:
    """Return the roll dynamics with the tyre forces as input, and the effects of roll on the car.

    Frequency, damping and damper lag are fitted so that the equations of the model come closest to the roll response of
    the body on springs, tyres and the unsprung masses between them.

    Args:
        vehicle: vehicle with a suspension.
        momentum: angular momentum of the wheels over the speed [kg m]; yawing at ay / vx, they roll the body.
    """
    # Static roll: gravity reduces the stiffness, and the tyres take the lateral force at the road.
    p = estimate_parameters(vehicle, roll=True)
    arm = p.roll_mass * p.roll_height
    righting = p.roll_stiffness - arm * GRAVITY
    inertia = p.roll_inertia + p.roll_mass * p.roll_height**2 - arm * arm / p.mass
    frequency = math.sqrt(righting / inertia)
    damping = 0.5 * p.roll_damping / (frequency * inertia)
    # Dynamic roll: the response of body and unsprung masses at several frequencies, fitted by the model.
    rates = frequency * np.linspace(*_ROLL_FREQUENCIES)
    swings = [estimate_parameters(vehicle, roll=True, roll_frequency=float(rate)) for rate in rates]
    resisting = np.array([
        complex(car.roll_stiffness - arm * GRAVITY - inertia * rate**2, rate * car.roll_damping)
        for car, rate in zip(swings, rates, strict=True)
    ])  # fmt: skip
    target = rates * righting / resisting  # roll rate over the static roll angle under the same force

    def errors(z: Array) -> Array:
        # Unknowns over their first guesses, so that all are of the order of one.
        gain, natural, ratio, late = z * (1.0, frequency, damping, _DAMPER_LAG)
        damped = 2.0 * ratio * natural * 1j * rates / (1.0 + 1j * rates * late)
        # Real and imaginary parts: amplitude and phase of the response count alike.
        missed = rates * gain * natural**2 / (natural**2 - rates**2 + damped) - target
        return np.concatenate((missed.real, missed.imag)) / frequency

    solution = least_squares(errors, np.ones(4)).x * (1.0, frequency, damping, _DAMPER_LAG)
    gain, natural, ratio, late = solution.tolist()
    return {
        "roll_gain": gain * (arm + p.mass * p.overturning_arm + momentum) / righting,
        "roll_frequency": natural,
        "roll_damping": ratio,
        "roll_damper_time": max(late, 0.0),
        "roll_arm": arm / p.mass,
        "roll_steer": -p.front_roll_slip,
        "roll_steer_rear": -p.rear_roll_slip,
        "roll_moment": -p.rolling_resistance * p.roll_stiffness,  # by load transfer across the axle
    }


def _wheel_values(vehicle: Vehicle) -> dict[str, float]:
    """Return angular momentum over speed, additional yaw inertia and steering inertia of the wheels.

    A motor adds to the inertia of each wheel that it drives, as in the plant.
    """
    plant, _, _ = parse_urdf(vehicle.urdf, packages=vehicle.packages, where_line=str)
    geometry = vehicle.geometry
    tracks = (geometry.front_track, geometry.front_track, geometry.rear_track, geometry.rear_track)
    momentum = resisting = 0.0
    names, spec = vehicle.spec.joints.wheels.names(), vehicle.spec
    rolling = spec.tyres.rolling_ratio if isinstance(spec.tyres, SlipTyres) else 1.0
    for index, (name, unloaded, track) in enumerate(zip(names, geometry.wheel_radii, tracks, strict=True)):
        # A loaded wheel rolls with a smaller radius than its unloaded one.
        inertia, radius = spin_inertia(plant, name), rolling * unloaded
        momentum += inertia / radius
        rotor = spec.powertrain.wheel_inertia(drive=spec.drive, front=index < 2)
        resisting += (inertia + rotor) * (0.5 * track / radius) ** 2  # outer wheels turn faster
    # The diagonal of the mass matrix has the inertia of everything that a steering joint moves.
    inertias = plant.CalcMassMatrix(plant.CreateDefaultContext()).diagonal()
    steered = sum(float(inertias[plant.GetJointByName(name).velocity_start()]) for name in spec.joints.steering.names())
    return {"wheel_momentum": momentum, "spin_inertia": resisting, "steering_inertia": steered}


def spin_inertia(plant: MultibodyPlant, joint: str) -> float:
    """Return the inertia of the rotating parts of a joint about its axis, without a motor [kg m²]."""
    revolute = plant.GetJointByName(joint)
    body = revolute.child_body()
    axis = revolute.frame_on_child().GetFixedPoseInBodyFrame().rotation().multiply(revolute.revolute_axis())
    inertia = body.default_spatial_inertia()
    tensor = inertia.Shift(inertia.get_com()).CalcRotationalInertia().CopyToFullMatrix3()
    return float(axis @ tensor @ axis)


def _steering_compliance(vehicle: Vehicle) -> dict[str, float]:
    """Return compliance and time constant of the steering servos under the moments of both wheels."""
    servo = vehicle.control.steering
    if servo.kind != "servo" or servo.stiffness <= 0.0:
        return {}
    return {
        "steering_compliance": 0.5 / servo.stiffness,
        "steering_compliance_time": servo.damping / servo.stiffness,
    }


def _tyre_values(laws: Sequence[TyreLaw], p: SingleTrackParameters, gain: float, *, upright: bool) -> dict[str, float]:
    """Return stiffness, trail and relaxation of the axles; see the head of the module.

    Args:
        laws: laws of front and rear tyres.
        p: mass and lengths.
        gain: roll angle over lateral acceleration [rad s²/m].
        upright: whether the stiffness is that of upright wheels.
    """
    values: dict[str, float] = {}
    growths = []
    for axle, law, (force, load) in zip(_AXLES, laws, _turn(p), strict=True):
        less, more = (_slip(law(factor * load, 0.0, 1.0), force) for factor in (1.0 - _LOAD_CHANGE, 1.0 + _LOAD_CHANGE))
        # Exponent of the stiffness over the load, as a central difference of logarithms.
        growths.append(math.log(less / more) / math.log((1.0 + _LOAD_CHANGE) / (1.0 - _LOAD_CHANGE)))
        tyre = law(load, 0.0 if upright else gain * _LATERAL, 1.0)
        slip = _slip(tyre, force)
        values |= {
            f"cornering_stiffness_{axle}": -2.0 * force / slip,
            f"relaxation_{axle}": tyre.contact.length_y,
            f"trail_{axle}": abs(_moment(tyre, slip)) / force,
        }
    # Stiffness grows more slowly than the load.
    return values | {"load_transfer": p.com_height * sum(growths) / len(growths)}


def _camber_moments(laws: Sequence[TyreLaw], p: SingleTrackParameters, gain: float) -> tuple[float, float]:
    """Return the moment of both wheels of an axle over roll beside that of their force, front and rear [N m/rad]."""
    moments = []
    for law, (force, load) in zip(laws, _turn(p), strict=True):
        upright, cambered = (
            _moment(tyre, _slip(tyre, force)) for tyre in (law(load, roll, 1.0) for roll in (0.0, gain * _LATERAL))
        )
        moments.append(2.0 * (cambered - upright) / (gain * _LATERAL))
    return moments[0], moments[1]


def _turn(p: SingleTrackParameters) -> list[tuple[float, float]]:
    """Return lateral force and load of a wheel in the turn, front and rear [N]."""
    length = p.front_length + p.rear_length
    return [
        (0.5 * p.mass * _LATERAL * arm / length, 0.5 * p.mass * GRAVITY * arm / length)
        for arm in (p.rear_length, p.front_length)
    ]


def _moment(tyre: TyreAtLoad, slip: float) -> float:
    """Return the aligning moment [N m]."""
    return float(tyre.forces(0.0, math.tan(slip), _SPEED)[2])


def _slip(tyre: TyreAtLoad, force: float) -> float:
    """Return the slip angle at which a tyre has a lateral force [rad]."""
    return float(brentq(lambda slip: tyre.forces(0.0, math.tan(slip), _SPEED)[1] - force, -_MAX_SLIP, _MAX_SLIP))
