"""Vehicles and worlds in a plant, and the ground truth read from it."""

import numpy as np
import pytest
from pydrake.common.eigen_geometry import AngleAxis
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource

import mirdrake as mir
from mirdrake.core.errors import ModelError
from mirdrake.plant.plant import PlantSpec, add_vehicle, make_plant, set_start
from mirdrake.sensors.ground_truth import GroundTruth, vehicle_state
from mirdrake.vehicles import load_vehicle
from mirdrake.worlds import load_world


@pytest.fixture
def parked():
    """A plant with a Bolt in the empty world."""
    builder = DiagramBuilder()
    parts = make_plant(builder, load_world("empty"), {"ego": load_vehicle("bolt")}, spec=PlantSpec(contact="point"))
    return builder, parts


def test_each_part_alone_with_plain_drake():
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, 0.005)
    bolt = mir.add_vehicle(plant, "bolt")
    mir.add_world(plant, "empty")
    plant.Finalize()
    steering = builder.AddSystem(mir.AckermannSteering(bolt.vehicle.geometry))
    diagram = builder.Build()
    assert steering.GetInputPort("steering").size() == 1
    assert plant.CalcTotalMass(plant.CreateDefaultContext(), [bolt.instance]) == pytest.approx(1616.0)
    Simulator(diagram).AdvanceTo(0.01)


@pytest.mark.parametrize("name", ["bolt@handling", "unior@handling"])
@pytest.mark.parametrize("step", [0.01, 0.0025])
def test_a_steering_servo_has_its_time_constant_at_any_step(name: str, step: float) -> None:
    """Wheels in the air: the slow solution of I λ² + (d + D) λ + k = 0, with I from the mass matrix."""
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, step)
    part = add_vehicle(plant, name, contact="point")
    plant.mutable_gravity_field().set_gravity_vector([0.0, 0.0, 0.0])
    plant.Finalize()
    simulator = Simulator(builder.Build())
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    actuators = plant.num_actuators()
    plant.get_actuation_input_port(part.instance).FixValue(context, np.zeros(actuators))
    plant.get_desired_state_input_port(part.instance).FixValue(context, np.zeros(2 * actuators))
    for joint in part.steering:
        joint.set_angle(context, 0.01)
    joint = part.steering[0]
    inertia = 1.0 / np.linalg.inv(plant.CalcMassMatrix(context))[joint.velocity_start(), joint.velocity_start()]
    (servo, _) = part.vehicle.control.steering_servos()
    assert servo is not None
    rate = max(np.roots([inertia, servo.damping + joint.default_damping(), servo.stiffness]).real)
    angles = []
    for time in (0.1, 0.15):
        simulator.AdvanceTo(time)
        angles.append(joint.get_angle(context))
    assert np.log(angles[1] / angles[0]) / 0.05 == pytest.approx(rate, rel=0.01)


def test_a_plant_without_a_scene_graph_is_rejected():
    plant = MultibodyPlant(0.001)
    with pytest.raises(ModelError, match="no scene graph"):
        mir.add_vehicle(plant, "bolt")


def test_two_vehicles_of_one_model_keep_their_own_joints_and_actuators():
    builder = DiagramBuilder()
    bolt = load_vehicle("bolt")
    parts = make_plant(builder, load_world("empty"), {"first": bolt, "second": bolt})
    first, second = parts.vehicles["first"], parts.vehicles["second"]
    for actuator, other in zip(first.wheel_actuators, second.wheel_actuators, strict=True):
        assert actuator.model_instance() == first.instance
        assert other.model_instance() == second.instance
    assert {joint.model_instance() for joint in second.steering} == {second.instance}
    assert set(first.tyres).isdisjoint(second.tyres)


def test_a_slope_tilts_gravity_against_uphill(tmp_path):
    path = tmp_path / "ramp.yaml"
    path.write_text("mirdrake: world/1\nname: ramp\nground: {slope: {grade: 0.75, heading: 0 deg}}\n")
    builder = DiagramBuilder()
    parts = make_plant(builder, load_world(str(path)), {})
    # a 3-4-5 triangle: sine 0.6, cosine 0.8
    assert parts.plant.gravity_field().gravity_vector() == pytest.approx([-0.6 * 9.80665, 0.0, -0.8 * 9.80665])


def test_the_car_starts_in_equilibrium(parked):
    builder, parts = parked
    part = parts.vehicles["ego"]
    zeros = builder.AddSystem(ConstantVectorSource(np.zeros(12)))
    builder.Connect(zeros.get_output_port(), parts.plant.get_desired_state_input_port(part.instance))
    simulator = Simulator(builder.Build())
    context = parts.plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    set_start(parts.plant, context, part, x=3.0, y=-2.0, yaw=0.5)
    before = part.base.EvalPoseInWorld(context).translation().copy()
    assert before[:2] == pytest.approx([3.0, -2.0])
    simulator.AdvanceTo(1.0)
    after = part.base.EvalPoseInWorld(context).translation()
    assert after == pytest.approx(before, abs=2e-4)


def test_ground_truth_equals_the_state_of_the_plant(parked):
    builder, parts = parked
    plant, part = parts.plant, parts.vehicles["ego"]
    truth = builder.AddSystem(GroundTruth(plant, part))
    builder.Connect(plant.get_state_output_port(), truth.plant_state)
    diagram = builder.Build()
    root = diagram.CreateDefaultContext()
    context = plant.GetMyMutableContextFromRoot(root)
    rng = np.random.default_rng(1)
    roll, pitch, yaw = 0.3, -0.2, 2.5
    X_WB = RigidTransform(RollPitchYaw(roll, pitch, yaw), [1.0, 2.0, 3.0])
    plant.SetFloatingBaseBodyPoseInWorldFrame(context, part.base, X_WB)
    plant.SetVelocities(context, rng.normal(size=plant.num_velocities()))
    positions = plant.GetPositions(context).copy()
    start = part.base.floating_positions_start()
    positions[start : start + 4] *= 1.01  # the norm drifts while Drake steps
    plant.SetPositions(context, positions)

    V_WB = part.base.EvalSpatialVelocityInWorld(context)

    def at(X_WB: RigidTransform) -> list[float]:
        R_BW = X_WB.rotation().inverse()
        velocities = [*R_BW.multiply(V_WB.translational()), *R_BW.multiply(V_WB.rotational())]
        return [*X_WB.translation(), *RollPitchYaw(X_WB.rotation()).vector(), *velocities]

    # The pose at the time of the velocities is half a step behind.
    turn, half = V_WB.rotational(), 0.5 * part.period
    back = RotationMatrix(AngleAxis(-half * np.linalg.norm(turn), turn / np.linalg.norm(turn)))
    moved = RigidTransform(back @ X_WB.rotation(), X_WB.translation() - half * V_WB.translational())
    state = truth.state.Eval(truth.GetMyContextFromRoot(root))
    assert state == pytest.approx(at(moved), abs=1e-7)

    spins = [joint.get_angular_rate(context) for joint in part.wheels]
    assert truth.wheel_speeds.Eval(truth.GetMyContextFromRoot(root)) == pytest.approx(spins)

    x = plant.GetPositionsAndVelocities(context)[:, None]
    twist = x[plant.num_positions() + part.base.floating_velocities_start_in_v() :][:6]
    assert np.ravel(vehicle_state(x[start : start + 7], twist)) == pytest.approx(at(X_WB), abs=1e-12)


def test_ground_truth_on_a_track_gives_offset_heading_error_and_progress():
    builder = DiagramBuilder()
    world = load_world("test_track")
    parts = make_plant(builder, world, {"ego": load_vehicle("bolt")}, spec=PlantSpec(contact="point"))
    plant, part = parts.plant, parts.vehicles["ego"]
    truth = builder.AddSystem(GroundTruth(plant, part, track=world.tracks["main"]))
    builder.Connect(plant.get_state_output_port(), truth.plant_state)
    root = builder.Build().CreateDefaultContext()
    # the start straight runs along x at y = -41 from x = -92, where progress is zero
    set_start(plant, plant.GetMyMutableContextFromRoot(root), part, x=-62.0, y=-40.7, yaw=0.1)
    path = truth.path.Eval(truth.GetMyContextFromRoot(root))
    assert path == pytest.approx([0.3, 0.1, 30.0], abs=1e-9)
