"""Single-track model of a vehicle folder: parameters from its files and measured on its model.

A vehicle folder has mass, inertia and lengths, the limits of the motor, rolling resistance, drag, friction and the
gains of its servos. Its tyre law, if it has one, yields cornering stiffness, friction and relaxation lengths of the
axles, see :mod:`mirdrake.single_track.axles`; Coulomb friction alone has no cornering stiffness, and a
default is assumed.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Role
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.framework import Context

from mirdrake.core.constants import GRAVITY
from mirdrake.core.errors import ConfigError
from mirdrake.plant.rest_pose import check_balance
from mirdrake.plant.wheel_shape import usual_stiffness
from mirdrake.single_track.axles import Axle, Body, find_axles, find_overturning_arm, find_roll_stiffness
from mirdrake.single_track.dynamics import Variant, lateral_forces
from mirdrake.single_track.parameters import SingleTrackParameters
from mirdrake.single_track.system import SingleTrack
from mirdrake.vehicles import WHEELS, Vehicle
from mirdrake.vehicles.parse import parse_urdf

FRONT_STIFFNESS = 12.0
REAR_STIFFNESS = 16.0
"""Cornering stiffness of an axle over its load [1/rad]. Assumed: between 10 and 20 for the axles of passenger cars, the
front one softer by its steering, which gives 1.2 degrees of understeer a g. The controller of a Lincoln MKZ has 15 at
both axles (ApolloAuto/apollo, modules/control/conf/lincoln.pb.txt, 155 kN/rad on 2080 kg)."""

RELAXATION_OVER_RADIUS = 1.5
"""Relaxation length over wheel radius [1]. Assumed: 0.3 to 0.6 m for passenger cars (Pacejka, 3rd ed., chapter 7)."""

AIR_DENSITY = 1.2
"""[kg/m³]"""

BLEND_FROUDE = 0.2
"""v1 over sqrt(g L) [1]: 1 m/s for a car."""


def make_single_track(
    vehicle: Vehicle,
    *,
    tyres: str = "linear",
    relaxation: bool = False,
    actuators: bool = False,
    roll: bool = False,
    parameters: SingleTrackParameters | None = None,
    front_stiffness: float | None = None,
    rear_stiffness: float | None = None,
) -> SingleTrack:
    """Return the single-track model of a vehicle.

    Args:
        vehicle: a loaded vehicle.
        tyres: "kinematic", "linear", or a kind of tyres, as "brush".
        relaxation: whether slip builds up over the relaxation length.
        actuators: whether steering servo and wheel servos are part of the model;
            :func:`make_single_track_vehicle` adds the vehicle's control unit.
        roll: whether the body rolls on its suspension; `parameters` must then be those of a model with roll.
        parameters: by default from :func:`estimate_parameters`.
        front_stiffness: see :func:`estimate_parameters`; not together with `parameters`.
        rear_stiffness: the same at the rear.

    Raises:
        ConfigError: an argument is not allowed.
    """
    if parameters is None:
        parameters = estimate_parameters(
            vehicle, front_stiffness=front_stiffness, rear_stiffness=rear_stiffness, roll=roll
        )
    elif front_stiffness is not None or rear_stiffness is not None:
        raise ConfigError("make_single_track: give either parameters or stiffnesses; the parameters hold stiffnesses")
    return SingleTrack(parameters, Variant(tyres, relaxation, actuators, roll))


def tyres_of(vehicle: Vehicle) -> str:
    """Return the tyres of the variant that is most like a vehicle: its own law, or brush tyres if it has none."""
    kind = vehicle.spec.tyres.kind
    return kind if kind in lateral_forces() else "brush"


def has_roll(vehicle: Vehicle) -> bool:
    """Return whether the model of a vehicle rolls: parameters with roll need a suspension."""
    return vehicle.spec.suspension is not None


def estimate_parameters(
    vehicle: Vehicle,
    *,
    front_stiffness: float | None = None,
    rear_stiffness: float | None = None,
    friction: float | None = None,
    gravity: Sequence[float] | NDArray[np.float64] = (0.0, 0.0, -GRAVITY),
    drag: bool = True,
    roll: bool = False,
    roll_frequency: float = 0.0,
) -> SingleTrackParameters:
    """Return the parameters of a vehicle, from its files and measured on its model.

    Args:
        vehicle: a loaded vehicle.
        front_stiffness: cornering stiffness of the front axle [N/rad]; by default that of its tyre law, or without
            one :data:`FRONT_STIFFNESS` times its load, an assumption.
        rear_stiffness: the same at the rear.
        friction: friction of the road [1]; by default dry asphalt for a tyre law, and that of the tyres without one.
        gravity: gravity in the world [m/s²]; that of a world file is ``world.ground.gravity``.
        drag: whether there is aerodynamic drag.
        roll: whether the parameters are for a model with roll states; the effect of roll on the slip of the axles is
            then separate from their stiffness.
        roll_frequency: frequency of roll stiffness and damping [rad/s]; 0: slow turns.

    Raises:
        ConfigError: an argument is not allowed; the centre of mass is not above the road and between the axles; with
            `roll`, it has no suspension.
    """
    # Only the URDF counts here: masses, joints and collision shapes at the design position, base frame on the world's.
    plant, scene_graph, _ = parse_urdf(vehicle.urdf, packages=vehicle.packages, where_line=str)
    context, spec, geometry = plant.CreateDefaultContext(), vehicle.spec, vehicle.geometry
    base = plant.GetBodyByName(spec.base_link)
    plant.SetFloatingBaseBodyPoseInWorldFrame(context, base, RigidTransform())
    check_balance(plant, context, vehicle, base.model_instance(), above=True)
    wheels = [plant.GetJointByName(name) for name in spec.joints.wheels.names()]
    # Rotor inertia and torque limits are properties of Drake's actuators, found by the name of their joint.
    actuators = {
        (actuator := plant.get_joint_actuator(index)).joint().name(): actuator
        for index in plant.GetJointActuatorIndices()
    }

    # Mass, inertia, and the loads of the axles.
    mass = float(plant.CalcTotalMass(context))
    ahead, _, height = plant.CalcCenterOfMassPositionInWorld(context).tolist()
    # Body 0 is the world.
    bodies = [BodyIndex(number) for number in range(1, plant.num_bodies())]
    spatial = plant.CalcSpatialInertia(context, plant.world_frame(), bodies)
    # Yaw inertia of all bodies about the common centre of mass; the joints are at their zero angles.
    yaw_inertia = float(spatial.Shift(spatial.get_com()).CalcRotationalInertia().CopyToFullMatrix3()[2, 2])
    down = -float(gravity[2])
    front_load, rear_load = mass * down * ahead / geometry.wheelbase, mass * down * (1.0 - ahead / geometry.wheelbase)

    # Wheels: rotating masses, friction and stiffness of their tyres.
    rotating, frictions = 0.0, []
    loads = [0.5 * front_load] * 2 + [0.5 * rear_load] * 2
    springs = [usual_stiffness(load, radius) for load, radius in zip(loads, geometry.wheel_radii, strict=True)]
    inspector = scene_graph.model_inspector()
    # Inertia about the spin axis only; divided by r² it is a mass that accelerates with the vehicle.
    for index, (joint, radius) in enumerate(zip(wheels, geometry.wheel_radii, strict=True)):
        body = joint.child_body()
        axis = joint.frame_on_child().GetFixedPoseInBodyFrame().rotation().multiply(joint.revolute_axis())
        inertia = body.CalcSpatialInertiaInBodyFrame(context)
        tensor = inertia.Shift(inertia.get_com()).CalcRotationalInertia().CopyToFullMatrix3()
        # The inertia of a rotor is seen at the wheel with the square of the gear ratio.
        motor = actuators.get(joint.name())
        rotor = motor.default_rotor_inertia() * motor.default_gear_ratio() ** 2 if motor is not None else 0.0
        rotor += spec.powertrain.wheel_inertia(drive=spec.drive, front=index < 2)
        rotating += (float(axis @ tensor @ axis) + rotor) / radius**2
        for shape in plant.GetCollisionGeometriesForBody(body):
            properties = inspector.GetProperties(shape, Role.kProximity)
            if properties is not None and properties.HasProperty("material", "point_contact_stiffness"):
                springs[index] = float(properties.GetProperty("material", "point_contact_stiffness"))
            if properties is not None and properties.HasProperty("material", "coulomb_friction"):
                frictions.append(float(properties.GetProperty("material", "coulomb_friction").dynamic_friction()))
    # The files have undeformed tyres; at rest they are compressed.

    # Axle heights sink by load over the stiffness of two tyres; the centre of mass is between them.
    sag = front_load / (2.0 * springs[0]), rear_load / (2.0 * springs[2])
    height -= sag[1] + (sag[0] - sag[1]) * ahead / geometry.wheelbase
    # Limits and gains of the motors.
    # Torque limits and damping of the wheel servos become forces at the road: τ / r, and d / r² between speed and
    # force.
    driven = [WHEELS.index(name) for name in spec.driven_wheels()]
    max_torque, gain = 0.0, 0.0
    for index in driven:
        radius, motor = geometry.wheel_radii[index], actuators[wheels[index].name()]
        max_torque += float(motor.effort_limit()) / radius
        servo_gains = vehicle.control.wheel_speed.servo_gains()
        gain += 0.0 if servo_gains is None else servo_gains.damping / radius**2
    # Characteristics of the axles, or assumptions without a tyre law.
    unsprung = _unsprung(vehicle, plant)
    body = Body(mass, geometry.wheelbase - ahead, ahead, height, (springs[0], springs[2]), unsprung)
    axles = find_axles(vehicle, body, friction=friction, roll=roll)
    if axles is None:
        # The tyre with the least friction limits the vehicle; friction of the road replaces that of the tyres if given.
        grip = min(frictions, default=1.0) if friction is None else friction
        lengths = [RELAXATION_OVER_RADIUS * r for r in (geometry.front_wheel_radius, geometry.rear_wheel_radius)]
        axles = (
            Axle(FRONT_STIFFNESS * front_load, grip, lengths[0]),
            Axle(REAR_STIFFNESS * rear_load, grip, lengths[1]),
        )

    # Froude scaling: small robots get a low-speed range that is small in proportion to sqrt(g L).
    v1 = BLEND_FROUDE * (down * geometry.wheelbase) ** 0.5
    return SingleTrackParameters(
        mass=mass,
        yaw_inertia=yaw_inertia,
        front_length=geometry.wheelbase - ahead,
        rear_length=ahead,
        com_height=height,
        rotating_mass=rotating,
        front_stiffness=axles[0].stiffness if front_stiffness is None else front_stiffness,
        rear_stiffness=axles[1].stiffness if rear_stiffness is None else rear_stiffness,
        front_friction=axles[0].friction,
        rear_friction=axles[1].friction,
        front_relaxation=axles[0].relaxation,
        rear_relaxation=axles[1].relaxation,
        rolling_resistance=spec.tyres.rolling_resistance,
        drag=0.5 * AIR_DENSITY * spec.aerodynamics.drag_area if drag else 0.0,
        front_drive={"front": 1.0, "rear": 0.0, "all": 0.5}[spec.drive],
        front_brake=spec.brakes.front_share,
        max_force=max_torque,
        servo_gain=gain,
        steering_lag=vehicle.control.steering.lag(),
        gravity_x=float(gravity[0]),
        gravity_y=float(gravity[1]),
        gravity_z=float(gravity[2]),
        blend_start=v1,
        blend_end=3.0 * v1,
        **(_roll_parameters(vehicle, body, plant, context, roll_frequency) if roll else {}),
        front_roll_slip=axles[0].roll_slip,
        rear_roll_slip=axles[1].roll_slip,
        front_shape=axles[0].shape,
        rear_shape=axles[1].shape,
        front_curvature=axles[0].curvature,
        rear_curvature=axles[1].curvature,
    )


def _unsprung(vehicle: Vehicle, plant: MultibodyPlant) -> tuple[float, float]:
    """Return the unsprung mass of a front and a rear wheel [kg]; zero without suspension."""
    names = vehicle.spec.joints.suspension
    if names is None:
        return 0.0, 0.0
    front, rear = (
        # All bodies that the suspension joint carries: wheel, hub, steering knuckle; left and right are assumed equal.
        sum(plant.get_body(body).default_mass() for body in plant.GetBodiesKinematicallyAffectedBy([joint.index()]))
        for joint in (plant.GetJointByName(name) for name in (names.front_left, names.rear_left))
    )
    return front, rear


def _roll_parameters(
    vehicle: Vehicle, body: Body, plant: MultibodyPlant, context: Context, frequency: float
) -> dict[str, float]:
    """Return the roll parameters: the whole vehicle rolls about a line on the road, as wheels move along z only.

    Raises:
        ConfigError: the vehicle has no suspension.
    """
    names = vehicle.spec.joints.suspension
    if names is None:
        raise ConfigError(
            f"single track of '{vehicle.name}' with roll: it has no suspension; leave out roll, or use a variant with "
            "suspension"
        )
    unsprung = {
        index
        for name in names.names()
        for index in plant.GetBodiesKinematicallyAffectedBy([plant.GetJointByName(name).index()])
    }
    # Sum of the bodies about x of the world, the roll axis on the road; Steiner's part of the whole is removed at the
    # end.
    roll_inertia = 0.0  # about the roll axis
    for number in range(1, plant.num_bodies()):
        index = BodyIndex(number)
        spatial = plant.CalcSpatialInertia(context, plant.world_frame(), [index])
        _, y, z = spatial.get_com().tolist()
        own = spatial.Shift(spatial.get_com()).CalcRotationalInertia().CopyToFullMatrix3()[0, 0]
        # A wheel rolls and moves laterally with the body, but does not move up and down with it.
        roll_inertia += float(own + spatial.get_mass() * (z * z + (0.0 if index in unsprung else y * y)))
    roll_stiffness = find_roll_stiffness(vehicle, body, frequency)
    return {
        "roll_mass": body.mass,
        "roll_height": body.height,
        "roll_inertia": roll_inertia - body.mass * float(plant.CalcCenterOfMassPositionInWorld(context)[2]) ** 2,
        "roll_stiffness": sum(roll_stiffness.stiffness),
        "roll_damping": roll_stiffness.damping,
        "overturning_arm": find_overturning_arm(vehicle, body),
    }
