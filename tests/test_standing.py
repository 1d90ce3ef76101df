"""Props and actors stand on uneven ground, in the plant, for range sensors and for cameras."""

from math import cos, pi, radians, sin, sqrt
from typing import Any

import numpy as np
import pytest
from pydrake.geometry import SceneGraph
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from mirdrake.plant.actors import add_actors
from mirdrake.plant.plant import PlantSpec, make_plant
from mirdrake.sensors.ranging.world import RayWorld
from mirdrake.worlds import World, make_world

SLOPE = [{"plane": {"grade": 0.2, "heading": "30 deg", "height": 1.0}}]


def height(x: float, y: float) -> float:
    """Return the height of :data:`SLOPE` [m]."""
    return 1.0 + 0.2 * (x * cos(radians(30.0)) + y * sin(radians(30.0)))


def world_with(**keys: Any) -> World:
    return make_world({"mirdrake": "world/1", "ground": {"relief": SLOPE}, **keys})


def test_props_stand_on_the_ground_unless_a_height_is_given() -> None:
    group = {
        "props": [{"box": [1.0, 1.0, 0.5], "at": [2.0, 0.0]}, {"box": [1.0, 1.0, 0.5], "at": [0.0, 0.0], "z": 0.5}]
    }
    world = world_with(
        groups={"pair": group},
        props=[
            {"box": [1.0, 1.0, 0.5], "at": [5.0, -3.0]},
            {"box": [1.0, 1.0, 0.5], "at": [5.0, -6.0], "z": 2.5},
            {"group": "pair", "at": [-4.0, 4.0]},
            {"group": "pair", "at": [-8.0, 4.0], "z": 7.0},
        ],
    )
    heights = [prop.X_WP.translation()[2] for prop in world.props]
    on_group = height(-4.0, 4.0)
    expected = [height(5.0, -3.0), 2.5, height(-2.0, 4.0), on_group + 0.5, 7.0, 7.5]
    assert heights == pytest.approx(expected, abs=1e-9)
    # Static props are upright.
    assert all(prop.X_WP.rotation().matrix()[2, 2] == pytest.approx(1.0) for prop in world.props)


def test_a_free_prop_lies_on_the_slope_and_stays_there() -> None:
    world = world_with(props=[{"box": [1.0, 0.6, 0.4], "at": [3.0, 2.0], "yaw": "50 deg", "static": False}])
    normal = np.array(world.ground.terrain.at(3.0, 2.0).normal)
    assert world.props[0].X_WP.rotation().matrix()[:, 2] == pytest.approx(normal)
    builder = DiagramBuilder()
    parts = make_plant(builder, world, {}, spec=PlantSpec(contact="point"))
    simulator = Simulator(builder.Build())
    context = simulator.get_mutable_context()
    parts.props.reset(parts.plant, parts.plant.GetMyMutableContextFromRoot(context))
    simulator.AdvanceTo(1.0)
    (body,) = parts.props.bodies.values()
    pose = parts.plant.EvalBodyPoseInWorld(parts.plant.GetMyContextFromRoot(context), body)
    assert pose.translation() == pytest.approx(world.props[0].X_WP.translation(), abs=5e-3)


def test_actors_are_at_the_height_of_the_ground_and_vehicles_along_its_slope() -> None:
    track = {"segments": [{"line": 40}], "start": {"at": [-10, 0]}, "width": 6}
    actors = [
        {"actor": "sedan", "name": "car", "on_track": {"track": "main", "s": 5}, "speed": 5},
        {"actor": "pedestrian", "name": "walker", "on_track": {"track": "main", "s": 20}, "speed": 1},
    ]
    world = world_with(tracks={"main": track}, actors=actors)
    builder = DiagramBuilder()
    parts = make_plant(builder, world, {})
    scene: SceneGraph = parts.scene_graph
    placed = add_actors(scene, world)
    heading = pi / 6.0
    rows = np.array([[3.0, 1.0, heading, 4.0 * cos(heading), 4.0 * sin(heading), 0.0], [6.0, -2.0, 0.0, 1.0, 0.0, 0.0]])
    poses = placed.poses(rows)
    car, walker = (poses.value(frame) for frame in placed.frames.values())
    assert [pose.translation()[2] for pose in (car, walker)] == pytest.approx([height(3.0, 1.0), height(6.0, -2.0)])
    # Uphill along its heading: the x axis rises by 20 %, the y axis is level.
    assert car.rotation().col(0)[2] == pytest.approx(0.2 / sqrt(1.04))
    assert car.rotation().col(1)[2] == pytest.approx(0.0, abs=1e-9)
    assert walker.rotation().col(2) == pytest.approx([0.0, 0.0, 1.0])
    # Range sensors get the same poses.
    rays = RayWorld(parts.plant, scene, terrain=parts.terrain, actors=placed)
    state = rays.actor_states(rows)[0]
    assert state.p == pytest.approx(car.translation())
    assert pytest.approx(car.rotation().matrix()) == state.R
    assert state.v[2] == pytest.approx(0.2 * 4.0)
