"""Motion of the wheels and generalised forces on them: compared with the Jacobians of the plant."""

import numpy as np
import pytest
from pydrake.math import RollPitchYaw
from pydrake.multibody.tree import JacobianWrtVariable
from pydrake.systems.framework import DiagramBuilder

from mirdrake.plant.plant import make_plant
from mirdrake.plant.wheels.motion import add_road_force, base_motion, wheel_motion, wheel_places
from mirdrake.vehicles import load_vehicle
from mirdrake.worlds import load_world


@pytest.fixture(scope="module", params=["bolt", "bolt@handling", "unior"])
def parts(request):
    vehicles = {"other": load_vehicle("bolt"), "ego": load_vehicle(request.param)}
    return make_plant(DiagramBuilder(), load_world("empty"), vehicles)


def some_state(parts, seed):
    """Return a context with a car that rolls, steers, bounces and slides on the road."""
    random = np.random.default_rng(seed)
    plant, part = parts.plant, parts.vehicles["ego"]
    context = plant.CreateDefaultContext()
    roll_pitch_yaw = [*random.uniform(-0.1, 0.1, 2), random.uniform(-3.0, 3.0)]
    positions = plant.GetPositions(context).copy()
    quaternion = RollPitchYaw(*roll_pitch_yaw).ToQuaternion().wxyz()
    start = part.base.floating_positions_start()
    positions[start : start + 4] = 1.001 * quaternion  # norms drift
    positions[start + 4 : start + 7] = [
        random.uniform(-9.0, 9.0),
        random.uniform(-9.0, 9.0),
        random.uniform(-0.02, 0.1),
    ]
    for joint in part.steering:
        positions[joint.position_start()] = random.uniform(-0.5, 0.5)
    for joint in part.suspension:
        positions[joint.position_start()] = random.uniform(-0.05, 0.05)
    plant.SetPositions(context, positions)
    plant.SetVelocities(context, random.uniform(-5.0, 5.0, plant.num_velocities()))
    return context


@pytest.mark.parametrize("seed", range(3))
def test_slip_velocity_and_generalised_force_are_those_of_the_wheels_point_on_the_road(parts, seed):
    plant, part, context = parts.plant, parts.vehicles["ego"], some_state(parts, seed)
    state = plant.GetPositionsAndVelocities(context).tolist()
    velocities = plant.GetVelocities(context)
    world = plant.world_frame()
    for wheel, joint in zip(wheel_places(part), part.wheels, strict=True):
        wheel = wheel._replace(rolling=0.0)
        motion = wheel_motion(
            state, wheel, base_motion(state, wheel.base, plant.num_positions()), plant.num_positions()
        )
        pose = plant.EvalBodyPoseInWorld(context, joint.child_body())
        assert [motion.x, motion.y, motion.z] == pytest.approx(pose.translation(), abs=1e-9)
        assert motion.axle == pytest.approx(pose.rotation().matrix()[:, 1], abs=1e-9)

        contact = np.array(motion.arm_base) + plant.EvalBodyPoseInWorld(context, part.base).translation()
        assert contact[2] == pytest.approx(0.0, abs=1e-9)
        assert np.dot(contact - pose.translation(), motion.axle) == pytest.approx(0.0, abs=1e-9)  # in the wheel plane
        assert np.linalg.norm(contact - pose.translation()) == pytest.approx(motion.radius, abs=1e-9)
        ahead = np.array([*motion.ahead, 0.0])
        left = np.cross([0.0, 0.0, 1.0], ahead)
        assert np.cross(motion.axle, [0.0, 0.0, 1.0]) @ ahead > 0.0
        assert np.sin(motion.inclination) == pytest.approx(motion.axle[2])

        point = pose.inverse().multiply(contact)
        jacobian = plant.CalcJacobianSpatialVelocity(
            context, JacobianWrtVariable.kV, joint.child_body().body_frame(), point, world, world
        )
        velocity = jacobian @ velocities
        assert velocity[3:] @ ahead == pytest.approx(motion.slip_x, abs=1e-9)
        assert velocity[3:] @ left == pytest.approx(motion.vy, abs=1e-9)
        assert motion.vx - motion.slip_x == pytest.approx(motion.spin * motion.radius, abs=1e-9)

        fx, fy, mz, fz, mx = 1234.0, -2345.0, 56.0, 789.0, 321.0
        force = [0.0] * plant.num_velocities()
        add_road_force(force, wheel, motion, fx, fy, mz, fz, mx=mx)
        moment = mx * ahead + [0.0, 0.0, mz]
        expected = jacobian.T @ np.array([*moment, *(fx * ahead + fy * left + [0.0, 0.0, fz])])
        assert force == pytest.approx(expected, abs=1e-9 * 1e3)


def test_a_force_does_no_work_but_against_the_slip_whatever_the_rolling_radius(parts):
    plant, part, context = parts.plant, parts.vehicles["ego"], some_state(parts, 5)
    state, velocities = plant.GetPositionsAndVelocities(context).tolist(), plant.GetVelocities(context)
    for wheel in wheel_places(part):
        wheel = wheel._replace(rolling=0.31)
        motion = wheel_motion(
            state, wheel, base_motion(state, wheel.base, plant.num_positions()), plant.num_positions()
        )
        assert motion.slip_x == pytest.approx(motion.vx - 0.31 * motion.spin)
        force = [0.0] * plant.num_velocities()
        add_road_force(force, wheel, motion, 1234.0, -2345.0, 0.0)
        assert force @ velocities == pytest.approx(1234.0 * motion.slip_x - 2345.0 * motion.vy, rel=1e-9)


def test_the_sink_rate_of_a_wheel_centre_is_that_of_drake(parts):
    plant, part, context = parts.plant, parts.vehicles["ego"], some_state(parts, 7)
    state = plant.GetPositionsAndVelocities(context).tolist()
    for wheel, joint in zip(wheel_places(part), part.wheels, strict=True):
        motion = wheel_motion(
            state, wheel, base_motion(state, wheel.base, plant.num_positions()), plant.num_positions()
        )
        fall = -plant.EvalBodySpatialVelocityInWorld(context, joint.child_body()).translational()[2]
        # steering an inclined wheel lifts it slightly, which is neglected
        assert motion.sink == pytest.approx(fall, abs=5.0 * abs(wheel.offset) * 0.2 + 1e-9)
