"""Props in the plant: fixed and movable ones, and the ground between many of them."""

import time

import numpy as np
import pytest
from pydrake.geometry import Box, HalfSpace
from pydrake.systems.analysis import Simulator

from mirdrake.assembly.diagram import assemble
from mirdrake.core.constants import GRAVITY
from mirdrake.runs.simulation import Simulation

POSTS = "{{box: [0.5, 0.5, 1], grid: {{origin: [0, {y}], step: [2, {step}], count: [{columns}, {rows}]}}{more}}}"


def posts(count, *, y=20.0, step=2.0, more=""):
    columns = min(count, 20)
    return POSTS.format(y=y, step=step, columns=columns, rows=-(-count // columns), more=more)


def build(tmp_path, props=(), *, vehicles=1, contact="point", driver="constant", **entry):
    path = tmp_path / "yard.yaml"
    lines = ["mirdrake: world/1", *(["props:", *(f"  - {prop}" for prop in props)] if props else [])]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    names = [f"car{number}" for number in range(vehicles)]
    return assemble(
        {
            "world": str(path),
            "vehicles": {
                name: {"model": "bolt", "start": {"x": 0, "y": -6.0 * number}} | entry
                for number, name in enumerate(names)
            },
            "control": dict.fromkeys(names, driver),
            "plant": {"contact": contact},
        }
    )


@pytest.mark.parametrize(
    ("props", "vehicles", "shape", "frame"),
    [
        ([], 1, HalfSpace, "world"),
        ([posts(10)], 2, HalfSpace, "world"),
        ([posts(400)], 1, HalfSpace, "ground"),
        ([posts(400)], 2, Box, "world"),
        ([posts(40), posts(20, y=-40, step=-2, more=", static: false, mass: 5")], 1, Box, "world"),
    ],
)
def test_the_ground_is_a_half_space_where_drake_can_bear_one(tmp_path, props, vehicles, shape, frame):
    assembly = build(tmp_path, props, vehicles=vehicles)
    (ground,), inspector = assembly.parts.ground, assembly.parts.scene_graph.model_inspector()
    assert isinstance(inspector.GetShape(ground), shape)
    assert inspector.GetName(inspector.GetFrameId(ground)).split("::")[0] == frame
    signals = Simulation(assembly).run(duration=0.3).signals  # a tree that cannot be balanced ends the process
    assert signals["car0.z"].abs().max() < 0.02


def test_shapes_that_tyres_with_slip_replace_do_not_count(tmp_path):
    """With 400 posts a car has a half space, whatever its tyres; the plant still counts the shapes of its wheels."""
    for model in ("bolt", "bolt@handling"):
        assembly = build(tmp_path, [posts(400)], model=model)
        (ground,), inspector = assembly.parts.ground, assembly.parts.scene_graph.model_inspector()
        assert isinstance(inspector.GetShape(ground), HalfSpace)


@pytest.mark.parametrize("contact", ["point", pytest.param("hydroelastic", marks=pytest.mark.slow)])
def test_on_a_box_a_car_circles_as_on_a_half_space(tmp_path, contact):
    runs = []
    for props in ([], [posts(40, y=60), posts(20, y=-60, step=-2, more=", static: false, mass: 5")]):
        driver = {"kind": "constant", "speed": 5.0, "steering": 0.2}
        assembly = build(tmp_path, props, contact=contact, driver=driver, speed=5.0)
        runs.append(Simulation(assembly).run(duration=6.0).signals.loc[4.0:].mean())
    for signal in ("wz", "vx", "z"):
        assert runs[1][f"car0.{signal}"] == pytest.approx(runs[0][f"car0.{signal}"], rel=2e-3)


def test_a_wall_stops_the_car_and_its_name_is_known(tmp_path):
    wall = "{box: [0.3, 6, 1], name: wall, at: [8, 0]}"
    assembly = build(tmp_path, [wall], driver={"kind": "constant", "speed": 2.0}, speed=2.0)
    signals = Simulation(assembly).run(duration=5.0).signals
    front = 3.4  # of the Bolt, ahead of its rear axle, about
    assert signals["car0.x"].iloc[-1] + front == pytest.approx(8.0 - 0.15, abs=0.15)
    assert signals["other_contacts"].iloc[-1] >= 1
    assert signals["other_contacts"].iloc[0] == 0
    assert set(assembly.parts.props.owners.values()) == {"wall"}


def test_a_movable_prop_is_pushed_aside_and_restored_in_a_new_context(tmp_path):
    assembly = build(
        tmp_path,
        ["{box: [0.4, 0.4, 0.7], name: crate, static: false, mass: 5, at: [6, 0]}"],
        driver={"kind": "constant", "speed": 3.0},
        speed=3.0,
    )
    plant, body = assembly.parts.plant, assembly.parts.props.bodies["crate"]

    def place(context):
        return plant.EvalBodyPoseInWorld(plant.GetMyContextFromRoot(context), body).translation()

    simulation = Simulation(assembly)
    assert plant.CalcTotalMass(plant.CreateDefaultContext(), [body.model_instance()]) == pytest.approx(5.0)
    for _ in range(2):
        np.testing.assert_allclose(place(assembly.make_context()), [6.0, 0.0, 0.0], atol=1e-9)
        signals = simulation.run(duration=2.5).signals
        assert signals["props.crate.x"].iloc[-1] > 7.0
        assert signals["props.crate.x"].iloc[0] == pytest.approx(6.0, abs=1e-3)
        assert signals["car0.vx"].iloc[-1] == pytest.approx(3.0, rel=0.02)


def test_a_movable_box_rests_and_slides_by_its_friction(tmp_path):
    """A box of 5 kg that is hit leaves with some speed v and comes to rest after v² / (2 mu g)."""
    assembly = build(tmp_path, ["{box: [0.4, 0.4, 0.2], name: crate, static: false, mass: 5, at: [20, 0]}"])
    plant, body = assembly.parts.plant, assembly.parts.props.bodies["crate"]
    context = assembly.make_context()
    own = plant.GetMyMutableContextFromRoot(context)
    velocities = plant.GetVelocities(own).copy()
    velocities[body.floating_velocities_start_in_v() + 4] = 2.0
    plant.SetVelocities(own, velocities)
    Simulator(assembly.diagram, context).AdvanceTo(2.0)
    slid = plant.EvalBodyPoseInWorld(own, body).translation()[1]
    inspector = assembly.parts.scene_graph.model_inspector()
    crate, *feet = plant.GetCollisionGeometriesForBody(body)
    mu = inspector.GetProximityProperties(crate).GetProperty("material", "coulomb_friction").dynamic_friction()
    road = assembly.parts.world.road_mu
    assert slid == pytest.approx(2.0**2 / (2.0 * (2 * mu * road / (mu + road)) * GRAVITY), rel=0.03)
    assert len(feet) == 8  # without them it rattles between its corners, up to 1 m/s, and never settles
    assert np.abs(plant.GetVelocities(own)[body.floating_velocities_start_in_v() :][:6]).max() < 1e-3


@pytest.mark.parametrize("contact", ["point", "hydroelastic"])
def test_four_hundred_props_cost_less_than_as_much_again(tmp_path, contact):
    (tmp_path / "none").mkdir()
    driver = {"kind": "constant", "speed": 5.0, "steering": 0.2}
    pair = [
        Simulation(build(folder, props, contact=contact, driver=driver, speed=5.0))
        for folder, props in ((tmp_path / "none", []), (tmp_path, [posts(400)]))
    ]
    best = [np.inf, np.inf]
    for _ in range(3):
        for index, simulation in enumerate(pair):
            began = time.process_time()
            simulation.run(duration=1.5)
            best[index] = min(best[index], time.process_time() - began)
    assert best[1] < 2.0 * best[0]
