"""Job W1: the car drives a straight and a circle, and is parked; the whole diagram and the bare plant."""

from collections.abc import Mapping, Sequence
from statistics import median
from typing import Any

import numpy as np
from pydrake.geometry import (
    CollisionFilterDeclaration,
    DefaultProximityProperties,
    GeometrySet,
    ProximityProperties,
    Role,
    SceneGraphConfig,
)
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlant, CoulombFriction, MultibodyPlant, MultibodyPlantConfig
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from benchmarks.job import DURATION, PARKED, SETTLING, SPEED, STEADY, STEERING, circle_figures
from benchmarks.timing import Times, rates, timed
from mirdrake.assembly.diagram import assemble
from mirdrake.assembly.diagram_spec import DiagramSpec, load_diagram
from mirdrake.controllers.ackermann import Ackermann
from mirdrake.plant.plant import DISSIPATION, VehicleInPlant, add_vehicle, add_world, set_start
from mirdrake.plant.wheel_shape import make_wheel_shape
from mirdrake.runs.simulation import Simulation
from mirdrake.vehicles import Vehicle, load_vehicle

STEPS = dict.fromkeys(("tyre", "point", "hydroelastic"), (0.002, 0.005, 0.01, 0.02))
"""Plant steps [s] per contact setting."""


APPROXIMATIONS = {"tyre": ("similar",), "point": ("similar", "sap"), "hydroelastic": ("similar",)}
"""Drake's contact approximations that are tried; with point contact sap solves faster, and vertical tyres have none."""


def make_spec(contact: str, step: float, *, approximation: str = "similar", left: bool = True) -> DiagramSpec:
    """Return the diagram of the job with contact settings, a plant step [s] and a direction of the circle."""
    overrides = [f"plant.contact={contact}", f"plant.time_step={step}", f"plant.approximation={approximation}"]
    spec = load_diagram("w1", overrides=overrides)
    if not left:
        rows = spec.control["ego"].rows  # type: ignore[attr-defined]
        assert rows is not None
        rows[-1].steering = -rows[-1].steering
    return spec


class BarePlant:
    """A plant as Drake alone has it, with the contact, step and set-point of a diagram, driven by C++ blocks alone.

    In place of vertical tyres it has point contact.

    Its wheels turn with their contact shapes, whose friction drives and guides the car. Wheel speeds and steering
    angles come from a trajectory and go to the joints' servos; there is no speed loop, no driver, no rolling
    resistance, no log.

    Args:
        spec: the diagram.
        rolling_radius: speed over spin rate of a wheel that bears its load [m]; the diagram's speed loop finds it, so
            that both drive at the same speed.
    """

    def __init__(self, spec: DiagramSpec, *, rolling_radius: float) -> None:
        entry = spec.vehicles["ego"]
        vehicle = load_vehicle(entry.model, arguments=entry.arguments)
        builder = DiagramBuilder()
        self.plant, self._part = _add_friction_plant(builder, spec, vehicle)
        plant = self.plant
        count = plant.num_actuators(self._part.instance)
        first = min(plant.get_joint_actuator(i).input_start() for i in plant.GetJointActuatorIndices())

        law = Ackermann(vehicle.geometry)
        times = [*np.linspace(0.0, 6.0, 61), 1e4]
        rows = []
        for time in times:
            speed, steering = min(time, SPEED), STEERING * min(max(time - 5.0, 0.0), 1.0)
            row = [0.0] * (2 * count)
            for actuator, angle in zip(self._part.steering_actuators, law.wheel_angles(steering), strict=True):
                row[actuator.input_start() - first] = angle
            ratios = law.wheel_speed_ratios(steering)
            for actuator, ratio in zip(self._part.wheel_actuators, ratios, strict=True):
                row[count + actuator.input_start() - first] = speed * ratio / rolling_radius
            rows.append(row)
        path = PiecewisePolynomial.FirstOrderHold(times, np.array(rows).T)
        set_point = builder.AddSystem(TrajectorySource(path))
        zero = builder.AddSystem(ConstantVectorSource([0.0] * count))
        builder.Connect(set_point.get_output_port(), plant.get_desired_state_input_port(self._part.instance))
        builder.Connect(zero.get_output_port(), plant.get_actuation_input_port(self._part.instance))
        self._simulator = Simulator(builder.Build())

    def run(self, duration: float) -> Context:
        """Drive from the start for a time [s]; the context at the end."""
        simulator = self._simulator
        context = simulator.get_system().CreateDefaultContext()
        plant = self.plant
        set_start(plant, plant.GetMyMutableContextFromRoot(context), self._part, x=0.0, y=0.0, yaw=0.0)
        simulator.reset_context(context)
        simulator.Initialize()
        simulator.AdvanceTo(duration)
        return context

    def steady(self, duration: float, *, last: float = STEADY) -> dict[str, float]:
        """Return the accuracy of the bare drive, from samples of its last seconds."""
        context = self.run(max(duration - last, 0.01))
        plant, base = self.plant, self._part.base
        vx, wz = [], []
        for time in np.arange(context.get_time(), duration, 0.02):
            self._simulator.AdvanceTo(time)
            plant_context = plant.GetMyContextFromRoot(context)
            velocity = plant.EvalBodySpatialVelocityInWorld(plant_context, base)
            R_WB = plant.EvalBodyPoseInWorld(plant_context, base).rotation()
            vx.append((R_WB.inverse() @ velocity.translational())[0])
            wz.append(velocity.rotational()[2])
        return circle_figures(np.array(vx), np.array(wz))


def _add_friction_plant(
    builder: DiagramBuilder, spec: DiagramSpec, vehicle: Vehicle
) -> tuple[MultibodyPlant, VehicleInPlant]:
    """Add a finalised plant with the vehicle of a diagram, whose wheels have contact friction instead of a tyre law."""
    # A plant of Drake alone has no vertical tyres; point contact is its fastest.
    contact = "point" if spec.plant.contact == "tyre" else spec.plant.contact
    config = MultibodyPlantConfig(
        time_step=spec.plant.time_step,
        contact_model="hydroelastic_with_fallback" if contact == "hydroelastic" else "point",
        discrete_contact_approximation=spec.plant.approximation,
        stiction_tolerance=spec.plant.stiction_tolerance,
        use_sampled_output_ports=False,
    )
    defaults = DefaultProximityProperties(hunt_crossley_dissipation=DISSIPATION, relaxation_time=0.0)
    plant, scene_graph = AddMultibodyPlant(config, SceneGraphConfig(default_proximity_properties=defaults), builder)
    part = add_vehicle(plant, vehicle, name="ego", contact=contact)
    geometry, source = vehicle.geometry, plant.get_source_id()
    for index, (joint, tyre) in enumerate(zip(part.wheels, part.tyres, strict=True)):
        material = ProximityProperties(scene_graph.model_inspector().GetProximityProperties(tyre))
        material.UpdateProperty(
            "material", "coulomb_friction", CoulombFriction(part.tyre_mu[index], part.tyre_mu[index])
        )
        scene_graph.RemoveRole(source, tyre, Role.kProximity)
        shape = make_wheel_shape(
            contact,
            radius=geometry.wheel_radii[index],
            width=geometry.wheel_widths[index],
            mirrored=index % 2 == 1,
        )
        plant.RegisterCollisionGeometry(joint.child_body(), RigidTransform(), shape, f"turning_{index}", material)
    # Nothing of the car touches itself.
    bodies = [plant.get_body(index) for index in plant.GetBodyIndices(part.instance)]
    shapes = GeometrySet([shape for body in bodies for shape in plant.GetCollisionGeometriesForBody(body)])
    scene_graph.collision_filter_manager().Apply(CollisionFilterDeclaration().ExcludeWithin(shapes))
    add_world(plant, spec.world.load())
    plant.Finalize()
    return plant, part


def _rolling_radius(signals: Any) -> float:
    """Return the speed over spin rate of the rear wheels at the end of a drive [m]."""
    last = signals.iloc[-1]
    return float(2.0 * last["ego.vx"] / (last["ego.wheel_speed.rear_left"] + last["ego.wheel_speed.rear_right"]))


def contact_faces(bare: BarePlant, duration: float) -> list[int]:
    """Polygons of each hydroelastic contact at the end of a bare drive."""
    context = bare.run(duration)
    plant = bare.plant
    results = plant.get_contact_results_output_port().Eval(plant.GetMyContextFromRoot(context))
    infos = [results.hydroelastic_contact_info(i) for i in range(results.num_hydroelastic_contacts())]
    return [info.contact_surface().num_faces() for info in infos]


def drive(
    contact: str, step: float, *, approximation: str = "similar", duration: float = DURATION, repeat: int = 3
) -> dict[str, Any]:
    """One row of W1: accuracy of the whole diagram, its speed, and what it costs over the bare plant.

    Whole diagram and bare plant run by turns in this process; the ratio is taken pair by pair, from processor times,
    and the median of the pairs is given.

    Args:
        contact: "hydroelastic", "point" or "tyre".
        step: of the plant [s].
        approximation: Drake's contact approximation.
        duration: simulated time [s].
        repeat: number of pairs.
    """
    spec = make_spec(contact, step, approximation=approximation)
    whole = Simulation(assemble(spec))
    runs = [whole.run(duration=duration)]  # warms up
    bare = BarePlant(spec, rolling_radius=_rolling_radius(runs[0].signals))
    bare.run(min(duration, 1.0))
    whole_times: list[Times] = []
    bare_times: list[Times] = []
    for _ in range(repeat):
        whole_times.append(timed(lambda: runs.append(whole.run(duration=duration))))
        bare_times.append(timed(lambda: bare.run(duration)))
        del runs[1:]

    left = runs[0].signals
    mirrored = make_spec(contact, step, approximation=approximation, left=False)
    right = Simulation(assemble(mirrored)).run(duration=duration).signals
    since = max(duration - STEADY, 0.0) + 1e-3
    left, right = left[left.index > since], right[right.index > since]
    rate_left, rate_right = float(left["ego.wz"].mean()), float(right["ego.wz"].mean())
    return {
        "contact": contact,
        "approximation": approximation,
        "step_ms": 1e3 * step,
        **rates(whole_times, duration=duration, step=step),
        **circle_figures(left["ego.vx"].to_numpy(), left["ego.wz"].to_numpy()),
        "mirror_difference_percent": 100.0 * (rate_left + rate_right) / abs(rate_left) if rate_left else None,
        "height_std_mm": 1e3 * float(left["ego.z"].std()),
        "faces_per_wheel": contact_faces(bare, duration),
        "bare": rates(bare_times, duration=duration, step=step) | bare.steady(duration),
        "overhead": median(w.cpu / b.cpu for w, b in zip(whole_times, bare_times, strict=True)),
        "overhead_wall": median(w.wall / b.wall for w, b in zip(whole_times, bare_times, strict=True)),
    }


def park(contact: str, step: float, *, world: str, brakes: bool, seconds: float = PARKED) -> dict[str, Any]:
    """Creep of a parked car.

    Args:
        contact: "hydroelastic", "point" or "tyre".
        step: of the plant [s].
        world: flat or slope.
        brakes: parking brakes on, or the speed loop alone holds the car.
        seconds: how long, after the settling.
    """
    overrides = [f"world={world}", f"vehicles.ego.parked={str(brakes).lower()}"]
    overrides += [f"plant.contact={contact}", f"plant.time_step={step}"]
    run = Simulation(assemble(load_diagram("w1_parked", overrides=overrides))).run(duration=SETTLING + seconds)
    still = run.signals[run.signals.index >= SETTLING - 1e-6]
    first, last = still.iloc[0], still.iloc[-1]
    creep = np.hypot(last["ego.x"] - first["ego.x"], last["ego.y"] - first["ego.y"])
    return {
        "contact": contact,
        "step_ms": 1e3 * step,
        "world": world,
        "brakes": brakes,
        "creep_mm": 1e3 * float(creep),
        "yaw_drift_mrad": 1e3 * float(last["ego.yaw"] - first["ego.yaw"]),
    }


def run_w1(*, duration: float, parked: float, repeat: int, steps: Mapping[str, Sequence[float]]) -> dict[str, Any]:
    """Job W1 of mirdrake: all drives and all parked cars."""
    drives = [
        drive(contact, step, approximation=approximation, duration=duration, repeat=repeat)
        for contact in steps
        for step in steps[contact]
        for approximation in APPROXIMATIONS[contact]
    ]
    places = (("empty", False), ("empty", True), ("slope_5_deg", True))
    still = [
        park(contact, 0.005, world=world, brakes=brakes, seconds=parked)
        for contact in steps
        for world, brakes in places
    ]
    return {"drives": drives, "parked": still}
