"""Drawn wheels: toe, camber and rear steering, which the bodies of the plant do not have."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydrake.geometry import Role
from pydrake.systems.framework import Context, DiagramBuilder

from mirdrake.assembly.diagram import assemble
from mirdrake.plant.plant import make_plant
from mirdrake.plant.wheels.wheel_looks import WheelLooks, add_wheel_looks
from mirdrake.runs.simulation import Simulation
from mirdrake.vehicles import Vehicle
from mirdrake.worlds import load_world
from tests.suspension_rigs import FRONT, REAR, on_springs
from tests.test_rear_steering import steered
from tests.test_suspension_geometry import TABLES

LEVEL = {"toe": [(0.0, 0.0)]}  # arms that do not move the wheel


def drawn(vehicle: Vehicle) -> tuple[Any, Any, Any, WheelLooks]:
    """Return plant, scene graph and part of a vehicle, and its drawn wheels."""
    parts = make_plant(DiagramBuilder(), load_world("empty"), {"ego": vehicle})
    looks = add_wheel_looks(parts.plant, parts.scene_graph, parts.vehicles["ego"])
    assert looks is not None
    return parts.plant, parts.scene_graph, parts.vehicles["ego"], looks


def test_wheels_without_angles_of_arms_are_drawn_at_their_bodies() -> None:
    plant, scene_graph, part, looks = drawn(on_springs(front=FRONT | LEVEL, rear=REAR | LEVEL))
    context, random = plant.CreateDefaultContext(), np.random.default_rng(1)
    q = random.uniform(-0.4, 0.4, plant.num_positions())
    base = part.base.floating_positions_start()
    q[base : base + 4] = [0.9, 0.1, -0.2, 0.3]
    q[base : base + 4] /= np.linalg.norm(q[base : base + 4])
    plant.SetPositions(context, q)
    poses = looks.poses(q, (0.0, 0.0))
    inspector = scene_graph.model_inspector()
    for joint, frame in zip(part.wheels, looks.frames, strict=True):
        body = plant.EvalBodyPoseInWorld(context, joint.child_body())
        assert poses.value(frame).IsNearlyEqualTo(body, 1e-9)
        # The geometry has moved to this frame.
        own = inspector.GetGeometries(plant.GetBodyFrameIdOrThrow(joint.child_body().index()), Role.kIllustration)
        assert not own
        assert inspector.GetGeometries(frame, Role.kIllustration)


@pytest.mark.parametrize("travel", [-0.08, 0.08])
def test_toe_and_camber_of_the_table_are_drawn(travel: float) -> None:
    plant, _, part, looks = drawn(on_springs(front=FRONT | TABLES, rear=REAR | TABLES))
    q = np.zeros(plant.num_positions())
    q[part.base.floating_positions_start()] = 1.0
    for joint in part.suspension:
        q[joint.position_start()] = travel
    poses = looks.poses(q, (0.0, 0.0))
    camber, toe = {-0.08: (0.02, -0.004), 0.08: (-0.05, 0.006)}[travel]
    for index, frame in enumerate(looks.frames):
        side = 1.0 if index % 2 == 0 else -1.0
        axle = poses.value(frame).rotation().col(1)
        # Positive camber inclines the top outwards, so that the outer end of the axle points downwards.
        assert np.arcsin(axle[2]) == pytest.approx(-side * camber, abs=1e-9)
        # Toe-in turns the front of the left wheel to the right.
        assert np.arctan2(-axle[0], axle[1]) == pytest.approx(-side * toe, abs=1e-9)


def test_steered_rear_wheels_are_drawn_turned(tmp_path: Path) -> None:
    spec: dict[str, Any] = {
        "world": "empty",
        "vehicles": {"ego": {"model": steered(tmp_path, {"ratio": -0.25}), "speed": 3.0}},
        "control": {"ego": {"kind": "constant", "speed": 3.0, "steering": 0.2}},
        "plant": {"contact": "tyre"},
    }
    assembly = assemble(spec, drawn=True)
    contexts: list[Context] = []
    row = Simulation(assembly).run(duration=0.8, monitor=contexts.append).signals.iloc[-1]
    context = contexts[-1]
    scene_graph, plant = assembly.parts.scene_graph, assembly.parts.plant
    query = scene_graph.get_query_output_port().Eval(scene_graph.GetMyContextFromRoot(context))
    looks = assembly.diagram.GetSubsystemByName("ego.wheel_poses").looks
    base = plant.EvalBodyPoseInWorld(plant.GetMyContextFromRoot(context), assembly.parts.vehicles["ego"].base)
    for side, frame in zip(("left", "right"), looks.frames[2:], strict=True):
        axle = (base.inverse() @ query.GetPoseInWorld(frame)).rotation().col(1)
        angle = row[f"ego.steering_angle.rear_{side}"]
        assert angle < -0.03
        assert np.arctan2(-axle[0], axle[1]) == pytest.approx(angle, abs=2e-3)


def test_wheels_of_other_vehicles_stay_on_their_bodies() -> None:
    spec = {
        "world": "empty",
        "vehicles": {"ego": {"model": "bolt@handling"}},
        "control": {"ego": {"kind": "constant", "speed": 0.0, "steering": 0.0}},
    }
    assert not assemble(spec, drawn=True).diagram.HasSubsystemNamed("ego.wheel_poses")
