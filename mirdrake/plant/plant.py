"""MultibodyPlant of vehicles and a world.

:func:`make_plant` makes a finalised plant; :func:`add_vehicle` and :func:`add_world` add to any plant before it is
finalised. The road is one half space; its visual geometry is on top of it.
"""

import re
from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import cos, expm1, sin, sqrt
from typing import Literal

import numpy as np
from pydantic import Field
from pydrake.geometry import (
    AddCompliantHydroelasticProperties,
    AddContactMaterial,
    AddRigidHydroelasticProperties,
    Box,
    CollisionFilterDeclaration,
    DefaultProximityProperties,
    GeometryId,
    GeometrySet,
    HalfSpace,
    ProximityProperties,
    Role,
    SceneGraph,
    SceneGraphConfig,
    Shape,
)
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlant, CoulombFriction, MultibodyPlant, MultibodyPlantConfig
from pydrake.multibody.tree import (
    Joint,
    JointActuator,
    JointIndex,
    ModelInstanceIndex,
    PdControllerGains,
    PrismaticSpring,
    RigidBody,
    SpatialInertia,
)
from pydrake.systems.framework import Context, DiagramBuilder

from mirdrake.core.constants import GRAVITY
from mirdrake.core.contacts import ContactModel
from mirdrake.core.drake_log import filter_drake_log
from mirdrake.core.errors import ModelError
from mirdrake.core.vectors import SIDES
from mirdrake.core.yaml_io import Duration, Period, Schema, Speed
from mirdrake.ground import FLAT, Terrain
from mirdrake.plant.actors import ActorsInScene, add_solid_actors, exclude_world
from mirdrake.plant.obstacles import PropsInPlant, add_props, terrain_of
from mirdrake.plant.rest_pose import RestPose, find_rest_pose
from mirdrake.plant.seen_scene import SeenScene
from mirdrake.plant.wheel_shape import (
    LEAST_DEPTH,
    TREAD,
    make_wheel_shape,
    patch_size,
    usual_stiffness,
)
from mirdrake.tyres import SlipTyres
from mirdrake.tyres.vertical import VerticalTyre
from mirdrake.vehicles import WHEELS, Vehicle, load_vehicle, make_package_map
from mirdrake.vehicles.joint_control import ServoGains
from mirdrake.worlds import World, load_world
from mirdrake.worlds.scenery import scenery

SCHEME = "semi_explicit_euler"
"""Drake's integrator for a continuous plant: velocities from the forces at the beginning of a step, positions from the
velocities at its end, as in a discrete plant. It is symplectic."""

PARKING_STIFFNESS = 1e7
"""Stiffness of a parking brake [N m/rad]: a car of 2 t on a slope of 5 degrees moves by 0.01 mm."""

PARKING_INERTIA = 1e4
"""Inertia added to a parked wheel [kg m²]. Drake regularises friction by a thousandth of the mobility of a body. This
is high for a wheel of 1 kg m² and lets a car on a slope creep by 0.05 mm/s; a parked wheel is as immobile as a car."""

MAX_SHAPES_WITH_HALF_SPACE = 12
"""Number of collision shapes up to which a half space is safe. A half space has no bounds, which unbalances Drake's
broad-phase tree; where the tree is more than ten levels deeper than a balanced one, rebalancing it aborts the process
(measured with Drake 1.51 and 1.58: 15 shapes may, 100 always do). With a dozen shapes it cannot become so deep."""

# Vehicles may leave the scenery without falling off the box.
_MARGIN, _DEPTH = 1000.0, 10.0  # box for the ground: margin around the world, and depth [m]

_SLIGHT = 0.01  # depth of hollows in which other bodies do not touch the ground [m]
_CLEARANCE = 0.2  # distance of the plane for other bodies below uneven ground [m]

DISSIPATION = 0.1
"""Damping of a contact whose shapes have none, over its force [s/m]."""

BOUNCE_DAMPING = 0.25
"""Damping ratio of a vehicle without suspension on Coulomb tyres [1]: such a model leaves the suspension out, whose
damping ratio is 0.2 to 0.4 (T. Gillespie, Fundamentals of Vehicle Dynamics (1992), chapter 5); that of rubber alone,
some per cent, would let it bounce and pitch for seconds."""

ROAD_STIFFNESS = 1e12
"""Point-contact stiffness of the road [N/m]: much stiffer than a tyre, so that the tyre's stiffness dominates."""


class GustSpec(Schema):
    """A gust of wind, the same in the whole world."""

    velocity: tuple[Speed, Speed] = Field(description="of the air at full strength, x and y of the world [m/s]")
    start: Duration = Field(ge=0.0, description="begin [s]")
    duration: Duration = Field(gt=0.0, description="from begin to end [s]")
    rise: Duration = Field(0.2, ge=0.0, description="duration of the begin and of the end, each half a cosine [s]")


class PlantSpec(Schema):
    """Time step and contact of the plant."""

    time_step: Period = Field(0.005, gt=0.0, le=0.05, description="discrete step of the plant [s]")
    contact: ContactModel = Field(
        "hydroelastic",
        description="what bears wheels on the plane z = 0: contact patches (hydroelastic), faster point contact "
        "(point), or a vertical tyre (tyre), which uneven ground always has [-]",
    )
    approximation: Literal["lagged", "sap", "similar"] = Field(
        "similar", description="Drake's discrete contact approximation; lagged loses grip with speed [-]"
    )
    stiction_tolerance: float = Field(1e-5, gt=0.0, description="slip speed taken for sticking [m/s]")
    air_density: float = Field(1.2, ge=0.0, description="density of the air; 0: no aerodynamic forces [kg/m³]")
    wind: tuple[Speed, Speed] = Field((0.0, 0.0), description="velocity of the air in the world, x and y [m/s]")
    gusts: list[GustSpec] = Field(default_factory=list, description="gusts, added to the wind")
    machine_code: bool | None = Field(
        None,
        description="whether to compile control units, with bit-equal results; by default for long durations [-]",
    )


@dataclass(frozen=True)
class VehicleInPlant:
    """Vehicle in a plant.

    Attributes:
        name: name of the vehicle in the plant.
        vehicle: the loaded vehicle.
        instance: its model instance.
        base: its base body with the vehicle frame B.
        wheels: wheel joints, front left, front right, rear left, rear right.
        steering: steering joints, left and right.
        wheel_actuators: actuators of the wheel joints.
        steering_actuators: actuators of the steering joints.
        tyres: collision geometry of each wheel's tyre.
        tyre_mu: friction coefficient of each tyre's rubber [-].
        compression: vertical stiffness and damping of a front and a rear tyre, the same on every contact.
        patches: modulus times width of the mesh of a front and a rear tyre in hydroelastic contact [N/m]; zeros in
            other contacts.
        parked: whether parking brakes hold the wheels.
        suspension: suspension joints in the order of the wheels; empty without suspension.
        terrain: the ground that its tyres touch.
        period: time step of the plant [s].
        servos: gains of the wheels' and the steering's servos, if the plant itself does not solve them.
        rate_gains: factor on the set-point of the rate of a steering joint, see :func:`implicit_servo`.
    """

    name: str
    vehicle: Vehicle
    instance: ModelInstanceIndex
    base: RigidBody
    wheels: tuple[Joint, ...]
    steering: tuple[Joint, ...]
    wheel_actuators: tuple[JointActuator, ...]
    steering_actuators: tuple[JointActuator, ...]
    tyres: tuple[GeometryId, ...]
    tyre_mu: tuple[float, ...]
    compression: tuple[VerticalTyre, VerticalTyre]
    patches: tuple[float, float] = (0.0, 0.0)
    parked: bool = False
    suspension: tuple[Joint, ...] = ()
    terrain: Terrain = FLAT
    period: float = 0.0
    servos: Mapping[JointIndex, ServoGains] = field(default_factory=dict)
    rate_gains: Mapping[JointIndex, float] = field(default_factory=dict)

    def rest_compressions(self, plant: MultibodyPlant) -> tuple[float, float]:
        """Return the compression of a front and a rear tyre at rest on level ground [m], in the finalised plant."""
        context = plant.CreateDefaultContext()
        plant.SetFloatingBaseBodyPoseInWorldFrame(context, self.base, RigidTransform())
        # With the vehicle frame at the origin, x of the centre of mass is its distance from the rear axle.
        weight = plant.CalcTotalMass(context, [self.instance]) * GRAVITY
        share = plant.CalcCenterOfMassPositionInWorld(context, [self.instance])[0] / self.vehicle.geometry.wheelbase
        front, rear = self.compression
        return front(weight * share / 2.0), rear(weight * (1.0 - share) / 2.0)

    def rolling_radii(self, plant: MultibodyPlant) -> tuple[float, float]:
        """Return speed over spin rate of a front and a rear wheel that roll freely on level ground [m].

        This is the height of the axle at rest, or the effective rolling radius of tyres with slip.
        """
        geometry, tyres = self.vehicle.geometry, self.vehicle.spec.tyres
        if isinstance(tyres, SlipTyres):
            return tyres.rolling_ratio * geometry.front_wheel_radius, tyres.rolling_ratio * geometry.rear_wheel_radius
        front, rear = self.rest_compressions(plant)
        return geometry.front_wheel_radius - front, geometry.rear_wheel_radius - rear


@dataclass(frozen=True)
class PlantParts:
    """Finalised plant with its world and vehicles.

    Attributes:
        plant: the plant.
        scene_graph: its scene graph.
        world: the world.
        vehicles: vehicles by name.
        ground: collision geometries of the road plane.
        props: the props of the world.
        terrain: height of the ground, with the props that vehicles drive over.
        wheel_contact: what bears the wheels: that of the settings on the plane z = 0, on other ground a vertical tyre.
        actors: the solid actors of the world; all, if they were added by :func:`mirdrake.plant.actors.add_actors`.
    """

    plant: MultibodyPlant
    scene_graph: SceneGraph
    world: World
    vehicles: dict[str, VehicleInPlant] = field(default_factory=dict)
    ground: tuple[GeometryId, ...] = ()
    props: PropsInPlant = field(default_factory=PropsInPlant)
    terrain: Terrain = FLAT
    wheel_contact: ContactModel = "hydroelastic"
    actors: ActorsInScene = field(default_factory=ActorsInScene)

    @property
    def lead(self) -> float:
        """Half a step [s], by which positions lead velocities, as the velocities at its end move the bodies."""
        return 0.5 * max((part.period for part in self.vehicles.values()), default=0.0)

    @cached_property
    def seen(self) -> SeenScene:
        """The scene as cameras see it."""
        return SeenScene(self.plant, self.scene_graph, lead=self.lead, actors=self.actors.source)


def make_plant(
    builder: DiagramBuilder,
    world: World,
    vehicles: Mapping[str, Vehicle],
    *,
    spec: PlantSpec | None = None,
    parked: Container[str] = (),
    continuous: bool = False,
) -> PlantParts:
    """Add a finalised plant with a world and vehicles to a diagram under construction.

    Args:
        builder: receives the plant and its scene graph.
        world: the world.
        vehicles: vehicles by name in the plant.
        spec: step and contact settings.
        parked: names of vehicles with parking brakes on.
        continuous: whether the plant may be continuous, stepped by :data:`SCHEME`; it is if nothing in it needs Drake's
            contact solver.
    """
    spec = spec or PlantSpec()
    # The contact geometry of the ground is plane.
    terrain = terrain_of(world)
    wheel_contact = contact_of_wheels(spec, terrain)
    continuous = continuous and not needs_solver(wheel_contact, world)
    # Explicit friction under its own weight would chatter at speeds below g dt.
    slip = max(spec.stiction_tolerance, GRAVITY * spec.time_step) if continuous else spec.stiction_tolerance
    config = MultibodyPlantConfig(
        time_step=0.0 if continuous else spec.time_step,
        contact_model="hydroelastic_with_fallback" if wheel_contact == "hydroelastic" else "point",
        discrete_contact_approximation=spec.approximation,
        stiction_tolerance=slip,
        use_sampled_output_ports=False,  # contact results are those of the next step, solved once
    )
    # Drake's defaults, 50 s/m and 0.1 s, would overdamp the tyres.
    defaults = DefaultProximityProperties(hunt_crossley_dissipation=DISSIPATION, relaxation_time=0.0)
    filter_drake_log()
    plant, scene_graph = AddMultibodyPlant(config, SceneGraphConfig(default_proximity_properties=defaults), builder)
    parts = {
        name: replace(
            add_vehicle(
                plant,
                vehicle,
                name=name,
                contact=wheel_contact,
                parked=name in parked,
                period=spec.time_step,
            ),
            terrain=terrain,
        )
        for name, vehicle in vehicles.items()
    }
    solid = add_solid_actors(plant, world)
    # Wheels that have a tyre of their own on the ground must not touch the contact geometry as well.
    ground, props = add_world(plant, world)
    exclude_world(plant, scene_graph, solid)
    for part in parts.values():
        if wheel_contact == "tyre":
            for tyre in part.tyres:
                _exclude_contact(scene_graph, tyre, [*ground, *props.bumps])
    plant.Finalize()
    return PlantParts(plant, scene_graph, world, parts, ground, props, terrain, wheel_contact, solid)


def solves_joints(plant: MultibodyPlant) -> bool:
    """Return whether Drake solves servos, dampers and limits of the joints: with the contact, in a discrete plant."""
    return bool(plant.time_step() > 0.0)


def contact_of_wheels(spec: PlantSpec, terrain: Terrain) -> ContactModel:
    """Return the contact model of the wheels: only the tyre model rolls on uneven ground."""
    return spec.contact if terrain.flat else "tyre"


def needs_solver(wheel_contact: ContactModel, world: World) -> bool:
    """Return whether a plant needs Drake's contact solver, for its wheels or for bodies that move; then it is discrete.

    Such bodies are too light for explicit contact forces.
    """
    loose = any(not placed.static for placed in world.props) or any(a.spec.body == "solid" for a in world.actors)
    return loose or wheel_contact != "tyre"


def add_vehicle(
    plant: MultibodyPlant,
    vehicle: Vehicle | str,
    *,
    name: str | None = None,
    contact: ContactModel = "hydroelastic",
    parked: bool = False,
    period: float | None = None,
) -> VehicleInPlant:
    """Add a vehicle to a plant that is not finalised yet.

    The tyre cylinders of the vehicle file become smooth contact shapes
    (:func:`mirdrake.plant.wheel_shape.make_wheel_shape`), and the joints whose control has an implicit servo
    get its gains, which Drake then solves implicitly.

    Args:
        plant: a plant with a scene graph.
        vehicle: a loaded vehicle, or its name.
        name: name in the plant; by default the name of the vehicle.
        contact: contact model, for the shape of the tyres.
        parked: whether parking brakes hold every wheel at its present angle. (Drake's joint locking reads out of
            bounds with wheels on the ground in 1.51.)
        period: time step by which a continuous plant is integrated [s]; by default that of the plant.

    Raises:
        ModelError: the plant has no scene graph, or a wheel has no cylinder to roll on.
    """
    vehicle = load_vehicle(vehicle) if isinstance(vehicle, str) else vehicle
    name = name or vehicle.name
    parser = Parser(plant)
    scene_graph = parser.scene_graph()
    if scene_graph is None:
        raise ModelError(f"add_vehicle: the plant has no scene graph, so '{name}' cannot touch the road")
    # Two vehicles of one diagram may be of the same model.
    parser.SetAutoRenaming(True)
    parser.package_map().AddMap(make_package_map(vehicle.packages))
    urdf = vehicle.urdf
    if contact != "hydroelastic":  # saves Drake the meshes of hydroelastic shapes, 0.1 s per vehicle
        urdf = re.sub(r"<drake:(?:compliant|rigid)_hydroelastic\s*/>", "", urdf)
    (instance,) = parser.AddModelsFromString(urdf, "urdf")
    if plant.GetModelInstanceName(instance) != name:
        plant.RenameModelInstance(instance, name)

    # Joints and actuators by role.
    joints = vehicle.spec.joints
    wheels = tuple(plant.GetJointByName(getattr(joints.wheels, wheel), instance) for wheel in WHEELS)
    steering = tuple(plant.GetJointByName(getattr(joints.steering, side), instance) for side in SIDES)
    # Actuators are found by their joints, as the names of transmissions are free.
    actuators = {
        actuator.joint().index(): actuator
        for actuator in map(plant.get_joint_actuator, plant.GetJointActuatorIndices())
    }
    wheel_actuators = tuple(actuators[joint.index()] for joint in wheels)
    steering_actuators = tuple(actuators[joint.index()] for joint in steering)

    # A discrete plant solves PD gains implicitly with the contact, so stiff servos are stable at any step.
    servos: dict[JointIndex, ServoGains] = {}
    rate_gains: dict[JointIndex, float] = {}
    wheel_gains, driven = vehicle.control.wheel_servo(), vehicle.spec.driven_wheels()
    for wheel, actuator in zip(WHEELS, wheel_actuators, strict=True):
        if parked:
            servos[actuator.joint().index()] = ServoGains(PARKING_STIFFNESS, PARKING_STIFFNESS / 100.0)
            actuator.set_default_gear_ratio(1.0)
            actuator.set_default_rotor_inertia(PARKING_INERTIA)
        elif wheel_gains is not None and wheel in driven:
            servos[actuator.joint().index()] = wheel_gains
        # The inertia is already referred to the wheel, hence the gear ratio 1.
        rotor = vehicle.spec.powertrain.wheel_inertia(drive=vehicle.spec.drive, front=wheel in WHEELS[:2])
        if rotor > 0.0 and not parked:
            actuator.set_default_gear_ratio(1.0)
            actuator.set_default_rotor_inertia(rotor)
    period = plant.time_step() if period is None else period
    for servo, actuator in zip(vehicle.control.steering_servos(), steering_actuators, strict=True):
        if servo is not None:
            joint = actuator.joint()
            inertia = _carried_inertia(joint, wheels) + float(actuator.default_reflected_inertia())
            damping, continuous = float(joint.default_damping()), not solves_joints(plant)
            servos[joint.index()] = implicit_servo(servo, inertia, damping, period, continuous=continuous)
            # The torque of the set-point of the rate is that of the servo's own damping.
            if servos[joint.index()].damping > 0.0:
                rate_gains[joint.index()] = servo.damping / servos[joint.index()].damping
    if solves_joints(plant):
        for joint_index, gains in servos.items():
            actuators[joint_index].set_controller_gains(PdControllerGains(p=gains.stiffness, d=gains.damping))

    # Contact shapes of the tyres, and their stiffness.
    ratio = None if vehicle.spec.tyres.has_slip or vehicle.spec.suspension else BOUNCE_DAMPING
    bodies = [plant.get_body(index) for index in plant.GetBodyIndices(instance)]
    load = GRAVITY * sum(body.default_mass() for body in bodies) / len(wheels)
    of_files = vehicle.spec.tyres.vertical_tyres(vehicle.folder)
    tyres, frictions, verticals, patches = [], [], [], []
    sizes = zip(WHEELS, wheels, vehicle.geometry.wheel_radii, vehicle.geometry.wheel_widths, strict=True)
    for index, (wheel, joint, radius, width) in enumerate(sizes):
        # Copies of the ids: those of GetCollisionGeometriesForBody keep the plant alive, and systems keep them.
        frame = plant.GetBodyFrameIdOrThrow(joint.child_body().index())
        geometries = scene_graph.model_inspector().GetGeometries(frame, Role.kProximity)
        if len(geometries) != 1:
            raise ModelError(
                f"link '{joint.child_body().name()}' has {len(geometries)} collision shapes; a wheel needs one",
                where=name,
            )
        material = scene_graph.model_inspector().GetProximityProperties(geometries[0])
        frictions.append(material.GetProperty("material", "coulomb_friction").dynamic_friction())
        vertical = of_files[index >= 2] or _vertical_of_shape(material, radius, ratio=ratio, load=load)
        patch = 0.0
        if contact != "tyre":
            # Drake's contact has a linear spring; that of the static load has the same rest pose.
            depth = vertical(load)
            if contact == "hydroelastic":
                depth = max(depth, LEAST_DEPTH * radius)
                patch = load / patch_size(radius, depth)
            vertical = VerticalTyre(load / depth, damping=vertical.damping)
        shape = make_wheel_shape(contact, radius=radius, width=width, mirrored=wheel.endswith("right"))
        properties = _tyre_properties(vertical, patch, radius=radius, width=width)
        tyres.append(_shape_tyre(plant, scene_graph, joint, geometries[0], shape, properties))
        verticals.append(vertical)
        patches.append(patch)
    return VehicleInPlant(
        name=name,
        vehicle=vehicle,
        instance=instance,
        base=plant.GetBodyByName(vehicle.spec.base_link, instance),
        wheels=wheels,
        steering=steering,
        wheel_actuators=wheel_actuators,
        steering_actuators=steering_actuators,
        tyres=tuple(tyres),
        tyre_mu=tuple(frictions),
        compression=(verticals[0], verticals[2]),  # both wheels of an axle have the same tyre
        patches=(patches[0], patches[2]),
        parked=parked,
        suspension=_add_springs(plant, vehicle, instance),
        period=period,
        servos={} if solves_joints(plant) else servos,
        rate_gains=rate_gains,
    )


def implicit_servo(
    servo: ServoGains, inertia: float, damping: float, period: float, *, continuous: bool = False
) -> ServoGains:
    """Return the gains with which an implicit step has the time constant of a servo.

    A step of length dt gives the error q of a joint, and its rate v at the beginning of the step,

        (I / dt + c + D) Δv = -k q - (c + D) v,    c = d + k dt,

    with the damping D of the joint: Drake's contact solver solves a servo so. A decaying error z^n then has

        c + D = {k z dt + I (1 - z)² / dt} / {z (1 - z)}.

    With the servo's own d the error decays too slowly, by k dt / (2 d). The d of this c has z = exp(λ dt) with the
    slow solution of I λ² + (d + D) λ + k = 0. A continuous plant takes D at the mean of both rates
    (:mod:`mirdrake.plant.wheels.joint_step`), hence D (1 + z) / (2 z). A servo that oscillates keeps its gains.

    Args:
        servo: gains of the servo.
        inertia: inertia about the joint [kg m²].
        damping: of the joint [N m s/rad].
        period: length of the step [s].
        continuous: whether the plant is continuous.
    """
    k, d = servo.stiffness, servo.damping + damping
    square = d * d - 4.0 * k * inertia
    if k == 0.0 or square <= 0.0 or period == 0.0:
        return servo
    decay = -expm1(-2.0 * k / (d + sqrt(square)) * period)  # 1 - z
    z = 1.0 - decay
    total = k * period / decay + inertia * decay / (period * z)
    own = total - damping * (0.5 * (1.0 + z) / z if continuous else 1.0)
    return ServoGains(k, max(own - k * period, 0.0))


def _carried_inertia(steering: Joint, wheels: Sequence[Joint]) -> float:
    """Return the inertia of a wheel and its carrier about their steering joint [kg m²]."""
    carrier = steering.child_body()
    total = carrier.default_spatial_inertia().ReExpress(RotationMatrix())  # a copy
    for wheel in wheels:
        if wheel.parent_body().index() == carrier.index():
            X_CJ, X_WJ = (
                frame.GetFixedPoseInBodyFrame() for frame in (wheel.frame_on_parent(), wheel.frame_on_child())
            )
            X_CW = X_CJ @ X_WJ.inverse()
            own = wheel.child_body().default_spatial_inertia()
            total += own.ReExpress(X_CW.rotation()).Shift(-X_CW.translation())
    X_CS = steering.frame_on_child().GetFixedPoseInBodyFrame()
    about = total.Shift(X_CS.translation()).CalcRotationalInertia().CopyToFullMatrix3()
    axis = X_CS.rotation() @ steering.revolute_axis()
    return float(axis @ about @ axis)


def _add_springs(plant: MultibodyPlant, vehicle: Vehicle, instance: ModelInstanceIndex) -> tuple[Joint, ...]:
    """Add springs, preloaded for zero travel at rest, and dampers to the suspension joints; return the joints."""
    names, suspension = vehicle.spec.joints.suspension, vehicle.spec.suspension
    if names is None or suspension is None:
        return ()
    joints = tuple(plant.GetJointByName(name, instance) for name in names.names())
    # PrismaticSpring gives -k (x - x0): at zero travel the spring presses the wheel down with its static load.
    for joint, corner, load in zip(joints, suspension.corners(), vehicle.spring_loads, strict=True):
        plant.AddForceElement(PrismaticSpring(joint, -load / corner.stiffness, corner.stiffness))
        # A discrete plant takes the velocity at the end of the step. That of its beginning acts on the other half, an
        # external force of :func:`mirdrake.plant.suspension.make_axle_forces`: the trapezoidal rule.
        joint.set_default_damping(corner.damping * (0.5 if plant.time_step() > 0.0 else 1.0))
    return joints


def _vertical_of_shape(
    material: ProximityProperties, radius: float, *, ratio: float | None, load: float
) -> VerticalTyre:
    """Return stiffness and damping of a tyre from its collision shape, or usual ones.

    With a damping `ratio` of the bounce under the load [N], the dissipation d of the tyre is at least that which gives
    it: a force F (1 + d x') on the stiffness k damps the load F = k x by F d, so that d = 2 ratio / sqrt(g x).
    """
    usual = usual_stiffness(load, radius)
    stiffness = material.GetPropertyOrDefault("material", "point_contact_stiffness", usual)
    damping = material.GetPropertyOrDefault("material", "hunt_crossley_dissipation", DISSIPATION)
    if ratio is not None:
        damping = max(damping, 2.0 * ratio / sqrt(GRAVITY * load / stiffness))
    return VerticalTyre(stiffness, damping=damping)


def _tyre_properties(vertical: VerticalTyre, patch: float, *, radius: float, width: float) -> ProximityProperties:
    """Return the contact material of a tyre; `patch` as in :class:`VehicleInPlant`."""
    properties = ProximityProperties()
    AddContactMaterial(
        dissipation=vertical.damping,
        point_stiffness=vertical.stiffness,
        friction=CoulombFriction(0.0, 0.0),
        properties=properties,
    )
    if patch > 0.0:
        modulus = patch / (TREAD * width)
        AddCompliantHydroelasticProperties(resolution_hint=radius, hydroelastic_modulus=modulus, properties=properties)
    return properties


def _shape_tyre(
    plant: MultibodyPlant,
    scene_graph: SceneGraph,
    wheel: Joint,
    tyre: GeometryId,
    shape: Shape,
    properties: ProximityProperties,
) -> GeometryId:
    """Register the shape of a tyre on the wheel carrier, in place of the wheel; return its id.

    The shape has no friction, as tyre forces come from the tyre law, so its rotation has no physical effect. But a
    discrete step takes the patch of a turning shape at the old angle and its pressure at the new one. The load of a
    rolling wheel would then act about v dt ahead of the axle, and brake it by many times the rolling resistance of a
    tyre. A shape that does not turn has no such moments.
    """
    apart, source = _filtered_geometries(scene_graph, tyre), plant.get_source_id()
    scene_graph.RemoveRole(source, tyre, Role.kProximity)
    # Pose of the wheel in its carrier at zero joint angle.
    X_PJ, X_WJ = (frame.GetFixedPoseInBodyFrame() for frame in (wheel.frame_on_parent(), wheel.frame_on_child()))
    X_PW = X_PJ.multiply(X_WJ.inverse())
    fixed = plant.RegisterCollisionGeometry(wheel.parent_body(), X_PW, shape, f"{wheel.name()}_tyre", properties)
    _exclude_contact(scene_graph, fixed, apart)
    return fixed


def _exclude_contact(scene_graph: SceneGraph, tyre: GeometryId, others: list[GeometryId]) -> None:
    declaration = CollisionFilterDeclaration().ExcludeBetween(GeometrySet(tyre), GeometrySet(others))
    scene_graph.collision_filter_manager().Apply(declaration)


def _filtered_geometries(scene_graph: SceneGraph, tyre: GeometryId) -> list[GeometryId]:
    """Return the shapes that collision filters exclude; a change of shape removes the filter (Drake 1.51, 1.58)."""
    inspector = scene_graph.model_inspector()
    others = inspector.GetGeometryIds(GeometrySet(inspector.GetAllGeometryIds()), Role.kProximity)
    return [other for other in others if other != tyre and inspector.CollisionFiltered(tyre, other)]


def add_world(plant: MultibodyPlant, world: World | str) -> tuple[tuple[GeometryId, ...], PropsInPlant]:
    """Add ground, scenery and props of a world to a plant that is not finalised yet, after the vehicles.

    The road is the plane z = 0 of the world frame. A slope tilts gravity, not the frame, so that the road stays the
    plane z = 0. It is a half space where that is safe, see :data:`MAX_SHAPES_WITH_HALF_SPACE`: on the world body
    with few props, on its own body with few moving shapes. Else it is the top of a box, which costs up to twice the
    step time.

    Returns:
        the collision geometries of the road, and the props.
    """
    world = load_world(world) if isinstance(world, str) else world
    # Props first: their number of shapes decides between half space and box.
    props = add_props(plant, world)
    material = ProximityProperties()
    friction = CoulombFriction(world.road_mu, world.road_mu)
    AddContactMaterial(friction=friction, dissipation=0.0, point_stiffness=ROAD_STIFFNESS, properties=material)
    AddRigidHydroelasticProperties(material)
    lowest = _lowest_point(world)
    # SceneGraph has one tree for geometries of the world body and one for all others, also of welded bodies.
    body, shape, X_BG = plant.world_body(), HalfSpace(), RigidTransform([0.0, 0.0, lowest])
    still = len(plant.GetCollisionGeometriesForBody(body))
    if still > MAX_SHAPES_WITH_HALF_SPACE:
        # The plant also counts the shapes of wheels that those of their tyres have replaced.
        shapes = Parser(plant).scene_graph().model_inspector().NumGeometriesWithRole(Role.kProximity)
        if shapes - still > MAX_SHAPES_WITH_HALF_SPACE:
            side = 2.0 * (max(map(abs, world.ground.extent)) + _MARGIN)
            shape, X_BG = Box(side, side, _DEPTH), RigidTransform([0.0, 0.0, lowest - _DEPTH / 2.0])
        else:
            body = plant.AddRigidBody("ground", plant.AddModelInstance("ground"), SpatialInertia.Zero())
            plant.WeldFrames(plant.world_frame(), body.body_frame())
    ground = plant.RegisterCollisionGeometry(body, X_BG, shape, "road", material)
    pads = [
        plant.RegisterCollisionGeometry(plant.world_body(), X_WG, shape, f"road/{name}", material)
        for name, shape, X_WG in _pads(world)
    ]
    plant.mutable_gravity_field().set_gravity_vector(world.ground.gravity)
    for item in scenery(world):
        rgba = item.rgba if item.rgba is not None else [1.0, 1.0, 1.0, 1.0]
        plant.RegisterVisualGeometry(plant.world_body(), item.X_WG, item.shape, f"scenery/{item.name}", rgba)
    return (ground, *pads), props


def _pads(world: World) -> Iterator[tuple[str, Box, RigidTransform]]:
    """Yield a box below each free prop on a relief, its top in the tangent plane: name, shape, pose.

    The plane for other bodies is at the lowest point of the relief; a prop that is pushed off its pad falls down to it.
    """
    for placed in world.props:
        if not placed.static and not world.ground.terrain.flat:
            xmin, ymin, xmax, ymax = placed.footprint.bounds
            side = 2.0 * max(xmax - xmin, ymax - ymin) + 2.0
            yield placed.name, Box(side, side, _DEPTH), placed.X_WP @ RigidTransform([0.0, 0.0, -0.5 * _DEPTH])


def _lowest_point(world: World) -> float:
    """Return the height of the lowest point of the ground, at most zero [m]: that of the plane for other bodies."""
    terrain = world.ground.terrain
    if terrain.flat:
        return 0.0
    xmin, ymin, xmax, ymax = world.ground.extent
    # A grid of 101 x 101 points is dense enough for a plane with a clearance.
    x, y = np.meshgrid(np.linspace(xmin, xmax, 101), np.linspace(ymin, ymax, 101))
    lowest = float(terrain.height(x, y).min())
    return lowest - _CLEARANCE if lowest < -_SLIGHT else 0.0


def set_start(
    plant: MultibodyPlant,
    context: Context,
    part: VehicleInPlant,
    *,
    x: float,
    y: float,
    yaw: float,
    speed: float = 0.0,
) -> None:
    """Put a vehicle on the road, with tyres and springs compressed as at rest, rolling freely straight ahead.

    Positions of the plant lead its velocities by half a step: it is half a step ahead of its place.

    Args:
        plant: the finalised plant.
        context: the plant's context, changed.
        part: the vehicle.
        x: position of the rear axle's centre in the world [m].
        y: the same, to the left [m].
        yaw: heading [rad].
        speed: forward speed [m/s]; the wheels roll, unless the vehicle is parked: then they slide.
    """
    # P: the plane below the wheels, x along the heading. B rests on it with pitch and roll of its own.
    if part.terrain.flat:
        pose = _rest_pose(plant, part, yaw=yaw)
        X_WB, direction = RigidTransform(RollPitchYaw(pose.roll, pose.pitch, yaw), [x, y, pose.z]), None
    else:
        R_WP, height = _tangent_plane(part, x, y, yaw)
        pose = _rest_pose(plant, part, R_WP=R_WP)
        X_PB = RigidTransform(RollPitchYaw(pose.roll, pose.pitch, 0.0), [0.0, 0.0, pose.z])
        X_WB = RigidTransform(R_WP, [x, y, height]) @ X_PB
        direction = R_WP.col(0)
    for joint, travel in zip(part.suspension, pose.travel, strict=False):
        joint.set_translation(context, travel)
    velocity = speed * (np.array([cos(yaw), sin(yaw), 0.0]) if direction is None else direction)
    ahead = RigidTransform(0.5 * part.period * velocity)
    plant.SetFloatingBaseBodyPoseInWorldFrame(context, part.base, ahead @ X_WB)

    # The floating base has angular, then linear velocities, both in the world.
    velocities = plant.GetVelocities(context).copy()
    start = part.base.floating_velocities_start_in_v()
    velocities[start : start + 6] = [0.0, 0.0, 0.0, *velocity]
    for joint, radius in zip(part.wheels, [radius for radius in part.rolling_radii(plant) for _ in SIDES], strict=True):
        spin = 0.0 if part.parked else speed / radius
        velocities[joint.velocity_start()] = spin
        joint.set_angle(context, 0.5 * part.period * spin)
    plant.SetVelocities(context, velocities)


def _rest_pose(
    plant: MultibodyPlant, part: VehicleInPlant, *, yaw: float = 0.0, R_WP: RotationMatrix | None = None
) -> RestPose:
    """Return the rest pose of a vehicle on a plane; with tyres compressed as on level ground if it is too steep."""
    pose = find_rest_pose(plant, part, yaw=yaw, R_WP=R_WP)
    if pose is not None:
        return pose
    front, rear = part.rest_compressions(plant)
    return RestPose(-rear, (front - rear) / part.vehicle.geometry.wheelbase, 0.0, (0.0,) * len(WHEELS))


def _tangent_plane(part: VehicleInPlant, x: float, y: float, yaw: float) -> tuple[RotationMatrix, float]:
    """Return the plane through the ground below the wheels: its axes, x along the heading, and its height at (x, y).

    It is fitted by least squares to four points, so on twisted ground the vehicle settles at the start.
    """
    geometry = part.vehicle.geometry
    half_front, half_rear, length = 0.5 * geometry.front_track, 0.5 * geometry.rear_track, geometry.wheelbase
    wheels = np.array([[length, half_front], [length, -half_front], [0.0, half_rear], [0.0, -half_rear]])
    R = np.array([[cos(yaw), -sin(yaw)], [sin(yaw), cos(yaw)]])
    places = wheels @ R.T + [x, y]
    # Least squares for z = height + along x + across y, with x and y in the axes of the vehicle.
    z = part.terrain.height(places[:, 0], places[:, 1])
    height, along, across = np.linalg.lstsq(np.column_stack([np.ones(4), wheels]), z, rcond=None)[0].tolist()
    ahead = np.array([cos(yaw), sin(yaw), along]) / sqrt(1.0 + along * along)
    normal = np.array([*(R @ [-along, -across]), 1.0]) / sqrt(1.0 + along * along + across * across)
    return RotationMatrix(np.column_stack([ahead, np.cross(normal, ahead), normal])), height
