"""Imported Gazebo worlds have the objects of the source at the same poses, and report all differences."""

import random
import re
import sys
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
import shapely
from pydrake.geometry import Box, Cylinder, HalfSpace, Role, Sphere
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

from mirdrake import cli
from mirdrake.core.errors import ConfigError, MirdrakeError, ModelError
from mirdrake.importing import packages
from mirdrake.importing.gazebo_xml import read_gazebo_xml
from mirdrake.importing.meshes.convex import make_hull
from mirdrake.importing.shape import Shape
from mirdrake.importing.worlds import import_world, surfaces
from mirdrake.importing.worlds.ground import _route_around
from mirdrake.importing.worlds.surfaces import cut_walls
from mirdrake.world_checks import check
from mirdrake.world_checks import first_steps as first_steps_of
from mirdrake.worlds.loading import load_world
from mirdrake.worlds.lock import lock_text
from mirdrake.worlds.scenery import scenery
from tests import trap_worlds as traps
from tests.marks import mostly_slow

MILLIMETRE = 1e-3


@pytest.fixture(autouse=True)
def _bare_environment(monkeypatch):
    """Search for models in the folder of the test only."""
    monkeypatch.setattr(packages, "LEVELS_UP", 2)
    for variable in ("GAZEBO_MODEL_PATH", "GAZEBO_RESOURCE_PATH", "GZ_SIM_RESOURCE_PATH", "IGN_GAZEBO_RESOURCE_PATH"):
        monkeypatch.delenv(variable, raising=False)
    monkeypatch.delenv("SDF_PATH", raising=False)


@pytest.fixture(autouse=True)
def _no_first_steps(request, monkeypatch):
    """The first steps take seconds; a test that needs them is marked by its argument `first_steps`."""
    if "first_steps" not in request.fixturenames:
        monkeypatch.setattr(check, "find_first_step_fault", lambda *_: [])


@pytest.fixture
def first_steps():
    """The importer makes the first steps of a simulation."""


def imported(path, folder, **options):
    """Return the import and the resulting world."""
    result = import_world(path, folder=folder, **options)
    return result, load_world(str(result.path))


def placed(world):
    return {prop.name: prop for prop in world.props}


def changes_of(result, what):
    """Return changes whose part has that text in it."""
    return [change for change in result.changes if what in change.part]


def box_of(prop):
    """Return the lowest and highest corner in W [m]."""
    return np.array([*prop.footprint.bounds[:2], prop.bottom, *prop.footprint.bounds[2:], prop.top])


# --- places -------------------------------------------------------------------------------------------------------


def drake_solids(path):
    """Return shapes that collide and their poses in W, as Drake reads a world: (kind, sizes, X_WG)."""
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 0.0)
    Parser(plant).AddModels(str(path))
    plant.Finalize()
    diagram = builder.Build()
    context = plant.GetMyContextFromRoot(diagram.CreateDefaultContext())
    inspector = scene_graph.model_inspector()
    solids = []
    for geometry in inspector.GetAllGeometryIds(Role.kProximity):
        shape = inspector.GetShape(geometry)
        if not isinstance(shape, HalfSpace):
            body = plant.GetBodyFromFrameId(inspector.GetFrameId(geometry))
            X_WG = plant.EvalBodyPoseInWorld(context, body) @ inspector.GetPoseInFrame(geometry)
            solids.append((shape, X_WG))
    return solids


def same_shape(first, second):
    if isinstance(first, Box) and isinstance(second, Box):
        return np.allclose(first.size(), second.size(), atol=1e-4)
    if isinstance(first, Cylinder) and isinstance(second, Cylinder):
        return np.allclose([first.radius(), first.length()], [second.radius(), second.length()], atol=1e-4)
    return isinstance(first, Sphere) and isinstance(second, Sphere) and abs(first.radius() - second.radius()) < 1e-4


@pytest.mark.parametrize("trap", [traps.nested, traps.tilted])
def test_collision_geometry_has_the_poses_of_drake(tmp_path, trap):
    path = trap(tmp_path)
    expected = drake_solids(path.rename(path.with_suffix(".sdf")))
    path = trap(tmp_path)
    _, world = imported(path, tmp_path / "worlds")
    solids = [(solid.shape, prop.X_WP @ solid.X_PS) for prop in world.props for solid in prop.prop.solids]
    assert len(solids) == len(expected) >= 4
    for shape, X_WG in expected:
        origins = [
            X.IsNearlyEqualTo(X_WG, 1e-3) and np.linalg.norm(X.translation() - X_WG.translation()) < MILLIMETRE
            for other, X in solids
            if same_shape(shape, other)
        ]
        assert any(origins), f"{shape} at {X_WG.translation()}"


def test_a_model_of_nothing_but_models_is_not_reported_as_left_out(tmp_path):
    inside = f"<model name='group'><static>1</static>{traps.model('a')}{traps.model('b', pose='5 0 0 0 0 0')}</model>"
    result, world = imported(traps.world(tmp_path, inside), tmp_path / "worlds")
    assert set(placed(world)) == {"group_a", "group_b"}
    assert not changes_of(result, "model 'group'")


def test_poses_of_a_saved_world_take_precedence(tmp_path):
    result, world = imported(traps.saved(tmp_path), tmp_path / "worlds")
    props = placed(world)
    assert set(props) == {"crate", "slab", "late"}
    np.testing.assert_allclose(props["crate"].X_WP.translation(), [4.0, -2.0, 0.0], atol=MILLIMETRE)
    assert RollPitchYaw(props["crate"].X_WP.rotation()).yaw_angle() == pytest.approx(0.5, abs=1e-5)
    assert not props["crate"].static
    np.testing.assert_allclose(box_of(props["slab"]), [9.0, -1.5, 0.0, 11.0, 1.5, 1.0], atol=MILLIMETRE)
    np.testing.assert_allclose(props["late"].X_WP.translation(), [-9.0, 0.0, 0.0], atol=MILLIMETRE)
    assert changes_of(result, "model 'gone'")[0].left_out
    assert changes_of(result, "model 'slab': scale")
    assert changes_of(result, "loose objects")  # the crate had sunk by 1 mm


def test_included_models_with_meshes(tmp_path):
    result, world = imported(traps.database(tmp_path), tmp_path / "out")
    props = placed(world)
    # crate.dae: 0.5 x 1 x 0.8 m, its middle at the model's origin, from z = 0 on
    boxes = {
        "crate": [0.75, -0.5, 0.0, 1.25, 0.5, 0.8],
        "crate_0": [2.5, -0.25, 0.0, 3.5, 0.25, 0.8],  # turned by 90 deg
        "gate_one": [-2.0, 7.8, 0.0, 2.0, 8.2, 3.4],
        "pair_a": [-8.25, -0.5, 0.0, -7.75, 0.5, 0.8],
        "pair_b": [-8.25, 2.5, 0.0, -7.75, 3.5, 0.8],
    }
    assert set(props) == set(boxes)
    for name, box in boxes.items():
        np.testing.assert_allclose(box_of(props[name]), box, atol=MILLIMETRE, err_msg=name)
    assert not props["crate"].static
    assert props["crate_0"].static
    under = shapely.box(-1.5, 7.9, 1.5, 8.1)
    low = [s for s in props["gate_one"].prop.solids if s.corners[:, 2].min() < 1.0]
    assert all(not under.intersects(shapely.MultiPoint(s.corners[:, :2] + [0.0, 8.0]).convex_hull) for s in low)
    assert changes_of(result, "name of a model")[0].new == "crate_0"
    names = {path.name for path in result.path.parent.glob("trap/props/crate/*")}
    assert {"prop.yaml", "visual.gltf"} <= names


def test_ground_floors_and_roads(tmp_path):
    result, world = imported(traps.ground(tmp_path), tmp_path / "worlds")
    assert set(placed(world)) == {"kerb"}
    assert shapely.box(*world.ground.extent).contains(shapely.box(-50.0, -40.0, 50.0, 40.0))
    assert {patch.name for patch in world.patches} == {"asphalt_lot", "grass_plane", "turned_floor"}
    assert next(iter(world.tracks)) == "main_street"
    places = [(0.0, 0.0, 0.7), (-30.0, 0.0, 0.4), (45.0, 35.0, 0.9), (20.0, -30.0, 0.85)]
    for x, y, mu in places:
        assert float(world.mu(x, y)) == pytest.approx(mu), (x, y)
    assert float(world.mu(20.01, 0.0)) == pytest.approx(0.9)  # the lot ends at x = 20 m
    street = world.tracks["main_street"].area
    np.testing.assert_allclose(street.bounds, [0.0, -33.0, 40.0, -27.0], atol=2.0 * MILLIMETRE)
    assert changes_of(result, "ramp_plane")[0].left_out


def test_the_ground_height_follows_from_roads_if_there_is_no_plane(tmp_path):
    result, world = imported(traps.outlines(tmp_path), tmp_path / "worlds")
    props = placed(world)
    ell = shapely.Polygon([(10, 20), (30, 20), (30, 28), (18, 28), (18, 40), (10, 40)])
    yard = shapely.box(-30, 10, -20, 20).difference(shapely.box(-27, 13, -23, 17))
    for name, area in (("ell", ell), ("yard", yard)):
        assert shapely.hausdorff_distance(props[name].footprint, area) < MILLIMETRE, name
        assert props[name].footprint.symmetric_difference(area).area < 0.01, name
        assert (props[name].bottom, props[name].top) == (pytest.approx(0.0, abs=1e-3), pytest.approx(6.0, abs=1e-3))
    assert changes_of(result, "height of the ground")[0].new == "z = 0, everything 5 m lower"


def test_rooms_within_walls_stay_free_and_terrain_is_reported(tmp_path):
    result, world = imported(traps.meshes(tmp_path), tmp_path / "worlds")
    props = placed(world)
    assert set(props) == {"maze", "room"}
    # In the middle of the maze, and of the room, whose middle is at (5, 5), there is nothing; at the walls there is.
    assert props["maze"].footprint.distance(shapely.Point(0.0, 0.0)) > 15.0
    assert props["maze"].footprint.distance(shapely.Point(0.0, -19.95)) < 0.01
    assert props["maze"].footprint.area == pytest.approx(40.0**2 - 39.8**2, abs=0.01)
    assert props["room"].footprint.distance(shapely.Point(5.0, 5.0)) > 1.8
    X = RigidTransform(RollPitchYaw(0.0, 0.0, 0.4), [5.0, 5.0, 0.0])
    for corner in ([-2.0, -2.0, 0.0], [2.0, 2.0, 0.0], [1.95, 0.0, 0.0]):
        assert props["room"].footprint.distance(shapely.Point((X @ np.array(corner))[:2])) < MILLIMETRE
    assert changes_of(result, "model 'hills'")
    assert any("left out collision geometry" in check for check in result.checks)
    assert {patch.name for patch in world.patches} == {"asphalt_road"}
    with pytest.raises(ModelError, match="terrain"):
        import_world(tmp_path / "trap.world", folder=tmp_path / "strict", strict=True)
    assert not (tmp_path / "strict").exists()


def test_the_floor_of_an_arena_is_ground_whatever_its_walls_are_called(tmp_path):
    corners = np.array([[-40, -30], [40, -30], [40, 30], [-40, 30]])
    floor = [f"v {x} {y} 0" for x, y in corners] + ["f 1 2 3", "f 1 3 4"]
    (tmp_path / "floor.obj").write_text("\n".join(floor) + "\n")
    walls = [f"v {x} {y} {z}" for z in (0, 1) for x, y in corners]
    walls += [f"f {a} {b} {b + 4}\nf {a} {b + 4} {a + 4}" for a, b in ((1, 2), (2, 3), (3, 4), (4, 1))]
    (tmp_path / "walls.obj").write_text("\n".join(walls) + "\n")
    links = "".join(
        f"<link name='{name}'><collision name='c'>{traps.shape('mesh', f'{name}.obj')}</collision>"
        f"<visual name='v'>{traps.shape('mesh', f'{name}.obj')}</visual></link>"
        for name in ("walls", "floor")
    )
    inside = f"<model name='arena'><static>1</static>{links}</model>"
    _, world = imported(traps.world(tmp_path, inside, plane=""), tmp_path / "worlds")
    arena = placed(world)["arena"]
    # The floor is not a part of the prop: only the walls are left, and the middle is free.
    assert arena.footprint.distance(shapely.Point(0.0, 0.0)) > 25.0
    assert arena.footprint.distance(shapely.Point(0.0, -30.0)) < 0.1


def test_the_middle_of_a_roundabout_is_an_obstacle_and_a_raised_yard_on_the_plane_is_not(tmp_path):
    inside = traps.model("circle", "cylinder", "20 0.04") + traps.model(
        "middle", "cylinder", "9 0.3", pose="0 0 0.15 0 0 0"
    )
    inside += traps.model("yard", size="18 18 0.3", pose="60 0 0.15 0 0 0")
    _, world = imported(traps.world(tmp_path, inside), tmp_path / "worlds")
    assert set(placed(world)) == {"middle"}
    assert {patch.name for patch in world.patches} == {"circle", "yard"}


@pytest.mark.parametrize("obstacle", [None, (1.0, 0.0), (1.0, 1.9), (1.8, -2.0)])
@pytest.mark.parametrize("width", [6.4, 8.0])
def test_the_line_on_square_corners_and_beside_obstacles_suits_a_car(width, obstacle):
    long, wide = 75.0, 50.0
    boxes = [(0, wide / 2, long, width), (0, -wide / 2, long, width), (long / 2, 0, width, wide + width)]
    boxes += [(-long / 2, 0, width, wide + width)]
    area = shapely.union_all([shapely.box(x - a / 2, y - b / 2, x + a / 2, y + b / 2) for x, y, a, b in boxes])
    assert isinstance(area, shapely.Polygon)
    crates = []
    if obstacle is not None:
        size, beside = obstacle
        crates = [shapely.box(-size / 2, wide / 2 + beside - size / 2, size / 2, wide / 2 + beside + size / 2)]
    route = _route_around(area, crates)
    assert route is not None
    track = route.track
    # On the narrow road a car cannot pass the crate in the middle on an arc of its radius: the line ends before it.
    assert track.closed == (width > 7.0 or obstacle != (1.0, 0.0))
    assert track.length == pytest.approx(2.0 * (long + wide), rel=0.12)
    s = np.linspace(0.0, track.length, 800)
    line = shapely.LineString(np.column_stack(track.point(s, np.zeros_like(s))))
    # A car of 4.5 m minimum radius, 1.8 m wide, stays on the road and passes the crate.
    assert track.min_radius > 4.5
    assert line.distance(area.boundary) > 1.0
    assert all(line.distance(crate) > 0.95 for crate in crates)


@pytest.mark.parametrize("blocked", [False, True])
@pytest.mark.parametrize("corners", [[(0, 0), (60, 0), (60, 50)], [(0, 0), (50, 0), (50, 19), (0, 19)]])
def test_a_narrow_road_turns_in_arcs_and_ends_before_an_obstacle(corners, blocked):
    area = shapely.LineString(corners).buffer(2.5, cap_style="flat", join_style="mitre")
    crates = [shapely.box(29.5, -0.5, 30.5, 0.5)] if blocked else []
    assert isinstance(area, shapely.Polygon)
    route = _route_around(area, crates)
    assert route is not None
    assert route.track.min_radius > 4.5
    s = np.linspace(0.0, route.track.length, 400)
    line = shapely.LineString(np.column_stack(route.track.point(s, np.zeros_like(s))))
    assert line.distance(area.boundary) > 1.0
    assert line.length > (0.4 if blocked else 0.85) * shapely.LineString(corners).length
    assert all(line.distance(crate) > 1.0 for crate in crates)


def posts(count):
    """Return the triangles (n, 3, 3) [m] of posts that are open on top, of 0.1 m x 0.1 m x (1 m and more)."""
    ring = np.array([[0.0, 0.0], [0.1, 0.0], [0.1, 0.1], [0.0, 0.1]])
    rows = []
    for number in range(count):
        low, high = (np.column_stack((ring, np.full(4, z))) for z in (0.0, 1.0 + 0.01 * number))
        shift = np.array([number % 20 + 0.3, number // 20 + 0.3, 0.0])
        for k in range(4):
            a, b = k, (k + 1) % 4
            rows += [np.array([low[a], low[b], high[b]]) + shift, np.array([low[a], high[b], high[a]]) + shift]
    return np.array(rows)


def test_more_separate_walls_than_a_prop_may_have_are_cut_to_the_largest(tmp_path):
    shape = Shape("mesh", where="trap.world:3")
    kept, left_out = cut_walls(shape, posts(200), tmp_path, name="wall")
    assert (len(kept), left_out) == (180, 20)
    # The lowest 20 posts are left out.
    meshes = [part.mesh for part in kept if part.mesh is not None]
    rows = [mesh.read_text(encoding="utf-8").splitlines() for mesh in meshes]
    heights = [max(float(row.split()[3]) for row in part if row.startswith("v ")) for part in rows]
    assert min(heights) == pytest.approx(1.2)
    assert cut_walls(shape, posts(150), tmp_path, name="wall")[1] == 0


def test_walls_of_more_triangles_than_a_cut_may_make_end_at_a_wide_grid(tmp_path, monkeypatch):
    monkeypatch.setattr(surfaces, "_MOST_TRIANGLES", 100)
    kept, left_out = cut_walls(Shape("mesh", where="trap.world:3"), posts(30), tmp_path, name="wall")
    assert left_out == 0
    assert 30 <= len(kept) <= 2 * 30  # a line of the grid may go through a post


def test_a_plane_with_other_visuals_leaves_them_as_scenery(tmp_path):
    tree = "<visual name='v'><pose>0 0 2 0 0 0</pose><geometry><sphere><radius>1</radius></sphere></geometry></visual>"
    floor = "<collision name='c'><geometry><plane><normal>0 0 1</normal><size>9 9</size></plane></geometry></collision>"
    inside = f"<model name='both'><static>1</static><pose>8 3 0 0 0 0</pose><link name='l'>{floor}{tree}</link></model>"
    _, world = imported(traps.world(tmp_path, inside), tmp_path / "worlds")
    (mesh,) = world.spec.scenery
    assert mesh.at == pytest.approx((8.0, 3.0, 0.0), abs=0.01)


def test_the_friction_of_a_box_is_reported(tmp_path):
    crate = (
        "<model name='crate'><pose>9 3 0.5 0 0 0</pose><link name='l'><collision name='c'><geometry><box>"
        "<size>1 1 1</size></box></geometry><surface><friction><ode><mu>0.2</mu></ode></friction></surface>"
        "</collision></link></model>"
    )
    result, _ = imported(traps.world(tmp_path, crate), tmp_path / "worlds")
    (change,) = changes_of(result, "model 'crate': friction")
    assert (change.old, change.new) == ("mu 0.2", "mu 0.6")


def test_populations(tmp_path):
    result, world = imported(traps.crowds(tmp_path), tmp_path / "worlds")
    count = Counter(prop.name.partition("[")[0] for prop in world.props)
    assert count == {"cans": 12, "row": 5, "loose": 6, "round": 4}
    assert not world.unplaced_props
    places = {name: np.array([p.X_WP.translation()[:2] for p in world.props if p.name.startswith(f"{name}[")])
              for name in count}  # fmt: skip
    # Four columns 2 m and three rows 3 m apart about (10, 20) m; five along y from -5 m in steps of 2 m.
    grid = {(7.0 + 2.0 * i, 17.0 + 3.0 * j) for i in range(4) for j in range(3)}
    assert {tuple(position) for position in places["cans"].round(6).tolist()} == grid
    np.testing.assert_allclose(places["row"], [(-20.0, y) for y in (-5, -3, -1, 1, 3)], atol=1e-6)
    assert np.all(np.abs(places["loose"] - [20.0, -20.0]) <= [4.0, 3.0])
    assert np.all(np.hypot(*(places["round"] + 20.0).T) <= 5.0)
    assert len(changes_of(result, "population")) == 4
    assert "1 to 5000" in changes_of(result, "model 'empty'")[0].reason


def test_populations_of_the_old_form(tmp_path):
    _, world = imported(traps.old_crowds(tmp_path), tmp_path / "worlds")
    count = Counter(prop.name.partition("[")[0] for prop in world.props)
    assert count == {"steps": 6, "some": 5, "round": 5, "row": 6}
    for prop in world.props:
        x, y, _ = prop.X_WP.translation()
        inside = {
            "steps": x in {-10.0, -8.0, -6.0} and y in {-12.0, -9.0},
            "some": 3.0 <= x <= 9.0 and 3.0 <= y <= 7.0,
            "round": np.hypot(x + 13.0, y - 3.0) <= 2.0,
            "row": -1.0 <= x <= 5.0 and y == pytest.approx(15.0),
        }
        assert inside[prop.name.partition("[")[0]], (prop.name, x, y)


# --- every omission is reported -----------------------------------------------------------------------------------


def test_elements_without_counterpart_are_reported(tmp_path):
    result, world = imported(traps.leftovers(tmp_path), tmp_path / "worlds")
    parts = [f"<{tag}>" for tag in ("gravity", "physics", "scene", "gui", "wind", "spherical_coordinates", "plugin",
                                    "magnetic_field", "audio")]  # fmt: skip
    parts += ["light 'lamp'", "light 'moon'", "actor 'walker'", "model 'hills'", "model 'ghost'", "model 'robot'"]
    report = result.path.with_suffix(".md").read_text()
    for part in parts:
        assert changes_of(result, part), part
        assert part.replace("<", "&lt;") in report, part
    assert world.starts["robot"].yaw == pytest.approx(np.pi, abs=1e-4)
    assert (world.starts["robot"].x, world.starts["robot"].y) == (-4.0, 3.0)
    assert set(placed(world)) == {"walker"}
    assert "m/s²" in changes_of(result, "gravity")[0].old


def test_each_element_of_a_rich_world_is_an_entry_or_reported(tmp_path):
    path = traps.rich(tmp_path)
    result, world = imported(path, tmp_path / "out")
    names = {prop.name.partition("[")[0] for prop in world.props}
    names |= {patch.name for patch in world.patches} | set(world.tracks)
    expected = {"gate", "construction_cone", "crate", "leaning", "block", "block_post", "walker", "can"}
    assert names == expected | {"floor", "street"}
    for part in ("model 'gone'", "light 'lamp'", "<plugin>", "model 'construction_cone'", "road 'street'", "<state>"):
        assert changes_of(result, part), part
    assert all(re.fullmatch(r"\S+:\d+", change.place) for change in result.changes)
    assert str(tmp_path) not in result.path.with_suffix(".md").read_text() + result.world_text


@pytest.mark.parametrize("fault", traps.broken())
def test_a_faulty_model_is_left_out_with_the_reason(tmp_path, fault):
    inside, word = traps.broken()[fault]
    path = traps.world(tmp_path, inside + traps.model("sound", pose="20 0 0.5 0 0 0"))
    result, world = imported(path, tmp_path / "worlds")
    assert "sound" in placed(world)
    omitted = [change for change in result.changes if word in change.reason]
    assert omitted, result.changes
    assert omitted[0].place == "trap.world:5"
    with pytest.raises(ModelError) as rejection:
        import_world(path, folder=tmp_path / "strict", strict=True)
    assert "\n" not in str(rejection.value)
    assert word in str(rejection.value)
    assert not (tmp_path / "strict").exists()


def test_unreadable_parts_of_a_model_are_reported(tmp_path):
    bad = '<link name="other"><pose>x</pose></link>'
    path = traps.world(tmp_path, traps.model("half", pose="5 0 0.5 0 0 0", extra=bad))
    result, world = imported(path, tmp_path / "worlds")
    assert set(placed(world)) == {"half"}
    assert "with all its following elements" in changes_of(result, "model 'half'")[0].new


def test_names_that_yaml_reads_as_something_else(tmp_path):
    inside = traps.model("true", pose="5 0 0.5 0 0 0") + traps.model("no", size="4 4 0.01", pose="0 9 0 0 0 0")
    _, world = imported(traps.world(tmp_path, inside, name="null"), tmp_path / "worlds")
    assert (world.name, set(placed(world))) == ("world_null", {"prop_true"})
    assert [patch.name for patch in world.patches] == ["patch_no"]


@pytest.mark.parametrize("size", ["1e6 1e6", "0 0", "-1 5"])
def test_planes_of_odd_sizes_are_the_usual_ground(tmp_path, size):
    _, world = imported(traps.world(tmp_path, "", plane=traps.PLANE.replace("100 80", size)), tmp_path / "worlds")
    assert world.ground.extent == (-200.0, -200.0, 200.0, 200.0)


# --- models that are not at hand ----------------------------------------------------------------------------------


def test_missing_models_are_reported_with_the_searched_folders(tmp_path, monkeypatch):
    path = traps.world(tmp_path, traps.include("model://no_such_thing"))
    monkeypatch.setenv("GZ_SIM_RESOURCE_PATH", f"{tmp_path / 'a'}:{tmp_path / 'b'}")
    result, _ = imported(path, tmp_path / "worlds")
    why = changes_of(result, "model 'no_such_thing'")[0].reason
    for part in ("GAZEBO_MODEL_PATH (not set)", "GZ_SIM_RESOURCE_PATH (2 folders)", "beside and above the file",
                 "--package no_such_thing=DIR"):  # fmt: skip
        assert part in why


@pytest.mark.parametrize("way", ["GAZEBO_MODEL_PATH", "GZ_SIM_RESOURCE_PATH", "package", "beside"])
def test_models_are_found(tmp_path, monkeypatch, way):
    folder = tmp_path / ("worlds/models" if way == "beside" else "elsewhere")
    model = traps.model_folder(folder, "thing", traps.model("thing", size="2 1 1", pose="0 0 0.5 0 0 0"), config=False)
    path = traps.world(tmp_path / "worlds", traps.include("model://thing", pose="3 4 0.5 0 0 0"))
    if way not in {"package", "beside"}:
        monkeypatch.setenv(way, str(folder))
    given = {"thing": model} if way == "package" else None
    _, world = imported(path, tmp_path / "out", packages=given)
    np.testing.assert_allclose(box_of(world.props[0]), [2.0, 3.5, 0.0, 4.0, 4.5, 1.0], atol=MILLIMETRE)


# --- rejections ---------------------------------------------------------------------------------------------------

BOMB = '<!DOCTYPE sdf [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;">]>\n<sdf version="1.6">&b;</sdf>'
OUTSIDE = (
    '<!DOCTYPE sdf [\n<!ENTITY x SYSTEM "file:///etc/hostname">]>\n<sdf version="1.6"><world name="w">&x;</world></sdf>'
)
REJECTED = {
    "bomb": (BOMB, ":1: declares an XML entity"),
    "external entity": (OUTSIDE, ":2: declares an XML entity"),
    "no XML": ("mirdrake: world/1\n", "not valid XML"),
    "unclosed": ("<sdf version='1.6'><world name='w'>", "not valid XML"),
    "empty": ("", "not valid XML"),
    "no world": ("<sdf version='1.6'><model name='m'/></sdf>", "use mirdrake import vehicle"),
    "robot": ("<robot name='r'/>", "contains no world"),
    "xacro": (
        "<sdf version='1.6' xmlns:xacro='x'><world name='w'><xacro:include filename='a'/></world></sdf>",
        "render the file first",
    ),
    "ancient": ("<gazebo version='1.0'><world name='w'/></gazebo>", "too old"),
}


@pytest.mark.parametrize("case", REJECTED)
def test_rejections_are_one_line_and_write_nothing(tmp_path, case):
    text, words = REJECTED[case]
    path = tmp_path / "bad.world"
    path.write_text(text)
    with pytest.raises(MirdrakeError) as rejection:
        import_world(path, folder=tmp_path / "worlds")
    assert words in str(rejection.value)
    assert "bad.world" in str(rejection.value)
    assert "\n" not in str(rejection.value)
    assert not (tmp_path / "worlds").exists()


def test_a_bomb_in_an_included_model_is_left_out(tmp_path):
    traps.model_folder(tmp_path / "models", "bomb", "")
    (tmp_path / "models/bomb/model.sdf").write_text(BOMB)
    result, _ = imported(traps.world(tmp_path, traps.include("model://bomb")), tmp_path / "worlds")
    assert any("declares an XML entity" in change.reason for change in result.changes)


def test_a_model_that_includes_itself(tmp_path):
    inner = '<model name="loop">' + traps.include("model://loop") + "</model>"
    traps.model_folder(tmp_path / "models", "loop", inner)
    result, _ = imported(traps.world(tmp_path, traps.include("model://loop")), tmp_path / "worlds")
    assert any("includes itself" in change.reason for change in result.changes)


def test_nothing_is_replaced_unless_it_was_imported(tmp_path):
    path = traps.nested(tmp_path)
    first, _ = imported(path, tmp_path / "worlds", name="lot")
    with pytest.raises(ConfigError, match="exists already"):
        import_world(path, folder=tmp_path / "worlds", name="lot")
    again = import_world(path, folder=tmp_path / "worlds", name="lot", force=True)
    assert again.world_text == first.world_text
    (tmp_path / "worlds/lot").mkdir()
    (tmp_path / "worlds/lot/mine.txt").write_text("mine")
    with pytest.raises(ConfigError, match="was not made by an import"):
        import_world(path, folder=tmp_path / "worlds", name="lot", force=True)
    assert sorted(entry.name for entry in (tmp_path / "worlds").iterdir()) == ["lot", "lot.md", "lot.yaml"]


# --- damage -------------------------------------------------------------------------------------------------------

ODD = ["nan", "1e400", "-1", "0", "x", "", "1 2", "../..", "&lt;", "é", "1e9", "true"]


def damage(text, chance):
    """Return a text with one to three faults."""
    for _ in range(chance.randint(1, 3)):
        kind = chance.randrange(6)
        numbers = list(re.finditer(r"-?\d+\.?\d*", text))
        tags = list(re.finditer(r"<(\w+)[^<>]*>", text))
        lines = text.splitlines(keepends=True)
        if kind == 0:
            match = chance.choice(numbers)
            text = text[: match.start()] + chance.choice(ODD) + text[match.end() :]
        elif kind == 1:
            match = chance.choice(tags)
            text = text[: match.start()] + text[match.end() :]
        elif kind == 2:  # whole elements go, or stand twice
            name = chance.choice(tags).group(1)
            elements = list(re.finditer(rf"<{name}\b[^<>]*>[^<>]*</{name}>", text))
            match = chance.choice(elements) if elements else chance.choice(tags)
            text = text[: match.end()] + chance.choice(["", match.group()]) + text[match.end() :]
            text = text[: match.start()] + text[match.end() :] if chance.random() < 0.5 else text
        elif kind == 3:
            index = chance.randrange(len(lines))
            text = "".join(lines[:index] + lines[index + 1 :])
        elif kind == 4:
            first, second = chance.choice(tags).group(1), chance.choice(tags).group(1)
            text = re.sub(rf"(</?){first}\b", rf"\g<1>{second}", text)
        else:
            names = re.findall(r'="([^"]*)"', text)
            text = text.replace(f'="{chance.choice(names)}"', f'="{chance.choice(names + ODD)}"', 1)
    return text


@pytest.mark.parametrize("block", mostly_slow(range(5)))
def test_a_damaged_world_gives_a_world_or_an_error_of_one_line(tmp_path, block):
    path = traps.rich(tmp_path)
    whole = path.read_text(encoding="utf-8")
    outcome: Counter[str] = Counter()
    for seed in range(20 * block, 20 * block + 20):
        path.write_text(damage(whole, random.Random(seed)), encoding="utf-8")
        target = tmp_path / f"out{seed}"
        result, fault = None, ""
        try:
            result = import_world(path, folder=target, name="w")
        except MirdrakeError as error:
            fault = str(error)
        if result is None:
            outcome["rejected"] += 1
            assert re.fullmatch(r"[^\n]*rich\.world:\d+: [^\n]+", fault), (seed, fault)
            assert not target.exists(), seed
        else:
            outcome["world"] += 1
            load_world(str(result.path))
            assert (target / "w.md").read_text(encoding="utf-8").startswith("# Import of w")
            assert {entry.name for entry in target.iterdir()} <= {"w", "w.md", "w.yaml"}, seed
    assert min(outcome["rejected"], outcome["world"]) > 2, outcome


@pytest.mark.parametrize("gap", [8.0, 10.0, 14.0, 18.0])
def test_the_road_ahead_of_a_start_is_free(tmp_path, gap):
    """Of places between obstacles on a road and an open stretch behind them, the start is on the open stretch."""
    boxes = "".join(
        f"<model name='b{index}'><static>true</static><pose>{x} 0 0.5 0 0 0</pose><link name='l'><collision name='c'>"
        "<geometry><box><size>1 4 1</size></box></geometry></collision></link></model>"
        for index, x in enumerate(np.arange(6.0, 60.0, gap))
    )
    path = tmp_path / "row.world"
    path.write_text(
        "<sdf version='1.6'><world name='row'><road name='main'><width>7</width><point>0 0 0</point>"
        f"<point>200 0 0</point></road>{boxes}</world></sdf>",
        encoding="utf-8",
    )
    world = load_world(str(import_world(path, folder=tmp_path / "out").path))
    start = next(iter(world.starts.values()))
    ahead = [prop.footprint.bounds[0] - start.x for prop in world.props if prop.footprint.bounds[2] > start.x]
    assert min(ahead, default=200.0 - start.x) > 30.0


# --- roads --------------------------------------------------------------------------------------------------------


def drive_along(world, seconds=20.0, speed=5.0):
    """Whether the longest track leads on free ground for a time at a speed [m/s]; a closed one is driven in laps."""
    track = next(iter(world.tracks.values()))
    length = min(seconds * speed, track.length) if not track.closed else seconds * speed
    s = np.mod(np.arange(0.0, length, 0.5), track.length)
    x, y = track.point(s, np.zeros_like(s))
    free = all(
        prop.footprint.distance(shapely.Point(point)) > 1.0 for prop in world.props for point in zip(x, y, strict=True)
    )
    return free and length >= min(seconds * speed, 60.0)


@pytest.mark.parametrize("height", mostly_slow([0.25, 0.01, 0.025, 0.1, 0.4]))
@pytest.mark.parametrize("with_plane", [True, False])
@pytest.mark.parametrize("seen_only", [False, True])
def test_a_circuit_of_slabs_is_a_road_at_any_height(tmp_path, height, with_plane, seen_only):
    if seen_only and not with_plane:
        pytest.skip("nothing would collide")
    result, world = imported(
        traps.circuit(tmp_path, height, with_plane=with_plane, seen_only=seen_only), tmp_path / "worlds"
    )
    assert {prop.name for prop in world.props} == {"cone"}
    assert float(next(iter(placed(world).values())).bottom) == pytest.approx(0.0, abs=5e-3)
    track = next(iter(world.tracks.values()))
    assert track.closed
    assert track.length == pytest.approx(2 * 100 + 2 * np.pi * 30, rel=0.03)
    assert drive_along(world)
    road = shapely.union_all([patch.area for patch in world.patches])
    for x, y in ((0.0, 30.0), (0.0, -30.0), (80.0, 0.0), (-80.0, 0.0)):
        assert road.distance(shapely.Point(x, y)) < 0.01, (x, y)
        assert {patch.surface for patch in world.patches} == {"asphalt"}
    start = next(iter(world.starts.values()))
    assert start.track is not None
    if height > 0.05 and not seen_only and with_plane:
        assert any("lower" in change.new for change in changes_of(result, "straight"))


@pytest.mark.parametrize("seed", mostly_slow(range(4)))
def test_a_circuit_as_a_mesh_is_a_road(tmp_path, seed):
    chance = random.Random(seed)
    kind = {"walls": 0.8 * (seed == 1), "rise": 3.0 * (seed == 2), "height": 0.3 * (seed == 3)}
    radius, width = chance.uniform(35.0, 60.0), chance.uniform(6.0, 9.0)
    path = traps.mesh_circuit(tmp_path, radius, width, seen_only=seed == 0, **kind)
    _, world = imported(path, tmp_path / "worlds")
    track = next(iter(world.tracks.values()))
    assert track.closed
    assert track.length == pytest.approx(2.0 * np.pi * radius, rel=0.02)
    assert track.width == pytest.approx(width, rel=0.1)
    assert drive_along(world)
    assert bool(world.props) == (seed == 1)
    assert len(world.spec.scenery) == (0 if seed == 1 else 1)


@pytest.mark.parametrize("named_by", ["g", "o", "usemtl", "file"])
def test_a_road_is_found_in_the_mesh_of_a_whole_town(tmp_path, named_by):
    _, world = imported(traps.town(tmp_path, 60.0, 8.0, named_by=named_by), tmp_path / "worlds")
    track = next(iter(world.tracks.values()))
    assert track.closed
    assert track.length == pytest.approx(2.0 * np.pi * 60.0, rel=0.02)
    assert track.width == pytest.approx(8.0, rel=0.1)
    assert drive_along(world)
    assert next(iter(world.starts.values())).track is not None
    (town,) = world.props
    assert town.top == pytest.approx(9.0, abs=0.02)
    assert min(world.spec.ground.size) >= 200.0


@pytest.mark.parametrize("seed", mostly_slow(range(6), fast=2))
def test_roads_of_points_are_tracks(tmp_path, seed):
    chance = random.Random(seed)
    points = [np.zeros(2)]
    heading = 0.0
    for _ in range(6):
        heading += chance.uniform(-0.6, 0.6)
        points.append(points[-1] + chance.uniform(25.0, 60.0) * np.array([np.cos(heading), np.sin(heading)]))
    text = "".join(f"<point>{x:.3f} {y:.3f} 0.02</point>" for x, y in points)
    inside = f"<road name='street'><width>6</width>{text}</road>"
    _, world = imported(traps.world(tmp_path, inside), tmp_path / "worlds")
    track = world.tracks["street"]
    line = shapely.LineString(points)
    x, y = track.point(s := np.linspace(0.0, track.length, 200), np.zeros_like(s))
    assert line.distance(shapely.MultiPoint(np.column_stack((x, y)))) < 1e-6
    assert max(line.distance(shapely.Point(point)) for point in zip(x, y, strict=True)) < 2.0
    assert next(iter(world.starts.values())).track == "street"
    assert drive_along(world)


def test_a_centre_line_goes_around_obstacles_on_a_wide_road(tmp_path):
    """A barrier in the middle of a slab of 120 m x 20 m; beside it there is room for a car."""
    slab = traps.model("asphalt", size="120 20 0.02", pose="0 0 0.01 0 0 0")
    foot = traps.model("jersey_barrier", size="1 2 0.1", pose="10 0 0.0 0 0 0")
    wall = traps.model("block", size="1 2 1", pose="10 0 0.5 0 0 0")
    _, world = imported(traps.world(tmp_path, slab + foot + wall), tmp_path / "worlds")
    assert drive_along(world)
    assert next(iter(world.tracks.values())).length > 80.0


def test_the_ground_reaches_below_surfaces_wider_than_its_plane(tmp_path):
    field = "".join(
        traps.model(f"asphalt_{k}", size="200 200 0.02", pose=f"{200 * k} 0 0.01 0 0 0") for k in (-1, 0, 1)
    )
    _, world = imported(traps.world(tmp_path, field), tmp_path / "worlds")
    xmin, ymin, xmax, ymax = world.ground.extent
    assert xmin <= -300.0
    assert xmax >= 300.0
    assert min(-ymin, ymax) >= 100.0


def test_objects_above_the_ground_remain_obstacles(tmp_path):
    inside = (
        traps.model("road", size="60 8 0.1", pose="0 0 0.05 0 0 0")
        + traps.model("sidewalk", size="60 2 0.15", pose="0 5 0.075 0 0 0")
        + traps.model("crate", size="1 1 0.4", pose="5 -7 0.2 0 0 0")
        + traps.model("hall", size="10 10 3", pose="0 20 1.5 0 0 0")
        + traps.model("deck", size="20 20 0.2", pose="0 -40 4 0 0 0")
    )
    _, world = imported(traps.world(tmp_path, inside), tmp_path / "worlds")
    assert {prop.name for prop in world.props} == {"sidewalk", "crate", "hall", "deck"}
    assert {patch.name for patch in world.patches} == {"road"}


def test_visual_only_objects_are_drawn(tmp_path):
    inside = (
        '<model name="tree"><static>1</static><pose>8 3 0 0 0 0.5</pose><link name="l"><visual name="v">'
        "<pose>0 0 2 0 0 0</pose><geometry><sphere><radius>1</radius></sphere></geometry></visual></link></model>"
    )
    result, world = imported(traps.world(tmp_path, inside), tmp_path / "worlds")
    assert not world.props
    (mesh,) = world.spec.scenery
    assert mesh.at == pytest.approx((8.0, 3.0, 0.003))
    assert (result.path.parent / mesh.file).is_file()
    assert [item.name for item in scenery(world)][-1] == "world/scenery.0"
    assert changes_of(result, "tree")[0].new == "visual only"
    lock_text(world)


# --- XML and search paths -----------------------------------------------------------------------------------------

_LENIENT = {
    "dashes": "<?xml version='1.0'?>\n<!-- a -- b ---\n -->\n<sdf><world/></sdf>",
    "byte order mark": "\ufeff<?xml version='1.0'?>\n\n\n<sdf><world/></sdf>",
    "space first": " \n<?xml version='1.0'?>\n\n<sdf><world/></sdf>",
    "comment first": "<!-- x -->\n<?xml version='1.0'?>\n\n<sdf><world/></sdf>",
    "two declarations": "<?xml version='1.0'?>\n<?xml version='1.0'?>\n\n<sdf><world/></sdf>",
    "encoding": "<?xml version='1.0' encoding='nonsense'?>\n\n\n<sdf><world/></sdf>",
    "no prefix": "\n\n\n<sdf><world><a:b c:d='1'/></world></sdf>",
    "ampersand": "\n\n\n<sdf a='x & y'><world>a & b &nbsp;</world></sdf>",
    "less than": "\n\n\n<sdf a='x < y'><world/></sdf>",
    "control": "\n\n\n<sdf><world>\x01 &#0;</world></sdf>",
    "attributes": "\n\n\n<sdf a='1'b = '2'><world/></sdf>",
    "after the root": "\n\n\n<sdf><world/></sdf>\n<other/> text",
    "data": "\n\n\n<sdf><world><![CDATA[ <a> & -- ]]> ]]></world></sdf>",
    "document type": "<!DOCTYPE sdf>\n\n\n<sdf><world/></sdf>",
}


@pytest.mark.parametrize("case", _LENIENT)
def test_xml_that_gazebo_reads_is_read(tmp_path, case):
    path = tmp_path / "a.sdf"
    path.write_text(_LENIENT[case], encoding="utf-8")
    document = read_gazebo_xml(path)
    assert [element.tag for element in document.root.iter()][:2] == ["sdf", "world"]
    assert document.where(document.root).endswith(":4")


@pytest.mark.parametrize(
    "text",
    ["", "text", "<sdf>", "<sdf><a></sdf>", "<sdf a=1/>", "<sdf><!-- <a/></sdf>", "<sdf a='1' a='2'/>",
     "<!DOCTYPE a [<!ENTITY b 'c'>]><sdf/>"],
)  # fmt: skip
def test_xml_that_gazebo_does_not_read_is_one_line(tmp_path, text):
    path = tmp_path / "a.sdf"
    path.write_text(text)
    with pytest.raises(ModelError, match=r"a\.sdf") as caught:
        read_gazebo_xml(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ["<a b='c", "<!-- -- ", "<a b='c\" ", "<![CDATA[", "<? ", "&", "<a b='1' "])
def test_damaged_xml_takes_linear_time(tmp_path, text):
    path = tmp_path / "a.sdf"
    path.write_text("<sdf><!-- -- -->" + text * 20_000)
    with pytest.raises(ModelError):
        read_gazebo_xml(path)


@pytest.mark.parametrize(
    "variable",
    ["GAZEBO_MODEL_PATH", "GAZEBO_RESOURCE_PATH", "GZ_SIM_RESOURCE_PATH", "IGN_GAZEBO_RESOURCE_PATH", "SDF_PATH"],
)
@pytest.mark.parametrize("address", ["model://my_package/deep/models/crate", "model://crate_here"])
def test_addresses_are_joined_to_the_search_paths(tmp_path, monkeypatch, variable, address):
    top = tmp_path / "elsewhere" / "top"
    traps.model_folder((top / address.partition("://")[2]).parent, address.rpartition("/")[2], traps.model("crate"),
                       config=False)  # fmt: skip
    monkeypatch.setenv(variable, f"{tmp_path / 'none'}:{top}")
    (tmp_path / "here").mkdir()
    _, world = imported(
        traps.world(tmp_path / "here", traps.include(address, pose="9 0 0.5 0 0 0")), tmp_path / "worlds"
    )
    assert len(world.props) == 1


def test_models_of_fuel_come_from_its_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("GZ_FUEL_CACHE_PATH", str(tmp_path / "cache"))
    uri = "https://fuel.gazebosim.org/1.0/OpenRobotics/models/My Crate"
    path = traps.world(tmp_path, traps.include(uri, pose="9 0 0.5 0 0 0"))
    result, world = imported(path, tmp_path / "one")
    assert not world.props
    assert any("local cache of Fuel" in change.reason for change in result.changes)
    home = tmp_path / "cache" / "fuel.gazebosim.org" / "openrobotics" / "models" / "my crate"
    for version in ("2", "10"):
        traps.model_folder(home, version, traps.model("crate", size=f"1 1 {version}"), config=False)
    _, world = imported(path, tmp_path / "two")
    assert world.props[0].prop.size[2] == pytest.approx(10.0)


def test_flat_and_tiny_meshes_give_no_messages_of_libraries(tmp_path):
    for seed, points in enumerate(
        (
            [[0, 0, 0]] * 4,
            [[0, 0, 0], [1, 1, 1], [2, 2, 2]],
            np.random.default_rng(1).normal(size=(9, 3)) * [1.0, 1.0, 1e-12],
            [[1e9, 0, 0], [1e9, 1e-9, 0], [1e9, 0, 1e-9]],
        )
    ):
        hull = make_hull(np.array(points, dtype=float))
        assert hull.volume > 0.0, seed
    (tmp_path / "sheet.obj").write_text(
        "v 0 0 0\nv 1 0 0\nv 1 1 1e-19\nv 0 1 0\nv 0 0 -1e-19\nf 1 2 3\nf 1 3 4\nf 1 3 2\nf 1 4 3\n"
    )
    geometry = f"<geometry><mesh><uri>file://{tmp_path}/sheet.obj</uri></mesh></geometry>"
    inside = (
        '<model name="sheet"><static>1</static><pose>5 5 1 1.5 0 0</pose><link name="l"><collision name="c">'
        f"{geometry}</collision></link></model>"
    )
    result, _ = imported(traps.world(tmp_path, inside), tmp_path / "worlds")
    text = result.path.with_suffix(".md").read_text()
    assert not re.search(r"\d{7,} %|[Qq]hull|QH\d|fcl", text)


# --- starts and checks --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", mostly_slow(range(5)))
def test_the_start_is_free(tmp_path, seed):
    chance = random.Random(seed)
    boxes = [("0 0 0.5 0 0 0.3", "3 3 1")] + [
        (f"{chance.uniform(-12, 12):.2f} {chance.uniform(-12, 12):.2f} 1 0 0 {chance.uniform(0, 3):.2f}", "2 1 2")
        for _ in range(40)
    ]
    inside = "".join(traps.model(f"box_{i}", size=size, pose=pose) for i, (pose, size) in enumerate(boxes))
    result, world = imported(traps.world(tmp_path, inside), tmp_path / "worlds")
    start = next(iter(world.starts.values()))
    car = shapely.affinity.translate(
        shapely.affinity.rotate(shapely.box(-0.9, -1.0, 3.4, 1.0), start.yaw, origin=(0, 0), use_radians=True),
        start.x,
        start.y,
    )
    assert not any(prop.footprint.intersects(car) for prop in world.props)
    assert not check.check_world(world, vehicle="bolt")
    assert not any("world check" in line for line in result.checks)


def test_a_world_without_starts_gets_one_with_room_ahead(tmp_path):
    inside = traps.model("box", size="1 1 1", pose="8 0 0.5 0 0 0")
    _, world = imported(traps.world(tmp_path, inside), tmp_path / "worlds")
    start = next(iter(world.starts.values()))
    c, s = np.cos(start.yaw), np.sin(start.yaw)
    lane = shapely.Polygon(
        [(start.x + c * u - s * v, start.y + s * u + c * v) for u, v in ((0, -1), (30, -1), (30, 1), (0, 1))]
    )
    assert not any(prop.footprint.intersects(lane) for prop in world.props)


def test_blocked_starts_of_the_source_are_left_out(tmp_path):
    robot = (
        '<model name="car"><pose>0 0 0.3 0 0 1</pose><link name="b"/>'
        '<link name="w1"/><link name="w2"/><link name="w3"/>'
        + "".join(
            f'<joint name="j{k}" type="revolute"><parent>b</parent><child>w{k}</child></joint>' for k in (1, 2, 3)
        )
        + "</model>"
    )
    result, world = imported(traps.world(tmp_path, robot + traps.model("wall", size="4 4 2", pose="0 0 1 0 0 0")),
                             tmp_path / "worlds")  # fmt: skip
    assert list(world.starts) == ["free"]
    assert changes_of(result, "start 'car'")[0].left_out


def test_loose_objects_above_the_ground_are_lowered(tmp_path):
    inside = traps.model("box", pose="5 5 3 0 0 0", static=False) + traps.model("lamp", pose="9 5 6 0 0 0")
    result, world = imported(traps.world(tmp_path, inside), tmp_path / "worlds")
    assert placed(world)["box"].bottom == pytest.approx(0.0, abs=1e-6)
    assert placed(world)["lamp"].bottom == pytest.approx(5.5)
    assert not any("world check" in line for line in result.checks)


def test_loose_objects_a_little_in_the_ground_are_put_onto_it(tmp_path):
    """A barrel placed on the plane below a slab of 25 mm would be pushed out; a buried block stays and is reported."""
    slab = traps.model("slab", size="60 9 0.025", pose="0 0 0.0125 0 0 0")
    barrel = traps.model("barrel", size="0.6 0.6 0.9", pose="5 3 0.45 0 0 0", static=False)
    deep = traps.model("deep", pose="9 3 0 0 0 0", static=False)
    result, world = imported(traps.world(tmp_path, slab + barrel + deep), tmp_path / "worlds")
    assert placed(world)["barrel"].bottom == pytest.approx(0.0, abs=1e-6)
    assert placed(world)["deep"].bottom < -0.4
    assert [line for line in result.checks if "world check" in line and "'deep'" in line]
    assert not [line for line in result.checks if "'barrel'" in line]
    (change,) = changes_of(result, "loose objects in the ground")
    assert change.old == "1 up to 0.025 m in the ground: barrel"


def test_loose_objects_fall_onto_what_is_below_them(tmp_path):
    """A chain of blocks, each beside the next but one; a cup 3 cm above a fixed table; a cup on one that floats."""
    chain = "".join(
        traps.model(f"block{k}", size="1 1 0.5", pose=f"{9 + 0.6 * k} 5 {1.25 + 0.5 * k} 0 0 0", static=False)
        for k in range(3)
    )
    table = traps.model("table", size="1 1 0.7", pose="5 9 0.35 0 0 0")
    cup = traps.model("cup", size="0.1 0.1 0.1", pose="5 9 0.78 0 0 0", static=False)
    shelf = traps.model("shelf", size="1 1 0.1", pose="9 12 1.05 0 0 0")
    book = traps.model("book", size="0.2 0.2 0.1", pose="9 12 1.45 0 0 0", static=False)
    result, world = imported(traps.world(tmp_path, chain + table + cup + shelf + book), tmp_path / "worlds")
    bottoms = {name: prop.bottom for name, prop in placed(world).items()}
    assert [bottoms[f"block{k}"] for k in range(3)] == pytest.approx([0.0, 0.5, 1.0], abs=1e-6)
    assert bottoms["cup"] == pytest.approx(0.7, abs=1e-6)
    assert bottoms["book"] == pytest.approx(1.1, abs=1e-6)
    assert not changes_of(result, "overlapping objects")
    (change,) = changes_of(result, "loose objects above the ground")
    assert change.old.startswith("5 up to 1 m above the ground")
    assert change.new == "on the ground, or on what is below them"


def test_what_rests_on_an_object_in_the_ground_is_lifted_with_it(tmp_path):
    crate = traps.model("crate", pose="9 5 0.45 0 0 0", static=False)
    cup = traps.model("cup", size="0.1 0.1 0.1", pose="9 5 1.0 0 0 0", static=False)
    result, world = imported(traps.world(tmp_path, crate + cup), tmp_path / "worlds")
    bottoms = {name: prop.bottom for name, prop in placed(world).items()}
    assert (bottoms["crate"], bottoms["cup"]) == pytest.approx((0.0, 1.0), abs=1e-6)
    assert not changes_of(result, "overlapping objects")
    assert changes_of(result, "loose objects")[-1].new == "lifted with them"


def test_a_world_that_makes_the_solver_fail_is_found(tmp_path, monkeypatch):
    _, world = imported(traps.world(tmp_path, traps.model("crate", pose="9 0 0.5 0 0 0", static=False)), tmp_path / "w")
    assert not first_steps_of.find_first_step_fault(world, (), "bolt")
    for program, words in (
        ("import os; os.abort()", "signal 6"),
        ("raise SystemExit(3)", "exit code 3"),
        ("""print('{"fault": "prop crate has 1e+09 m/s"}')""", r"1e\+09 m/s"),
    ):
        monkeypatch.setattr(first_steps_of, "COMMAND", (sys.executable, "-c", program))
        (fault,) = first_steps_of.find_first_step_fault(world, (), "bolt")
        assert fault.kind == "first_steps"
        assert re.search(words, fault.text)
        assert "crate" in fault.text


# --- the command --------------------------------------------------------------------------------------------------


@pytest.fixture
def command():
    """`mirdrake world import` in this process; returns the exit code."""
    return lambda *arguments: cli.main(["world", "import", *map(str, arguments)])


def test_command_prints_what_was_done(tmp_path, command, capsys):
    path = traps.leftovers(tmp_path)
    assert command(path, "--folder", tmp_path / "worlds", "--name", "rest") == 0
    out = capsys.readouterr().out
    assert str(Path("worlds") / "rest.yaml") in out
    for part in ("point light 'lamp'", "1 entries", "left out", "rest.md", "check: "):
        assert part in out
    assert (tmp_path / "worlds/rest.md").is_file()
    assert load_world(str(tmp_path / "worlds/rest.yaml")).name == "rest"


def test_command_options(tmp_path, command, capsys):
    model = traps.model_folder(tmp_path / "elsewhere", "thing", traps.model("thing"), config=False)
    path = traps.world(tmp_path / "a", traps.include("model://thing", pose="3 4 0.5 0 0 0"))
    strict = (path, "--folder", tmp_path / "worlds", "--strict")
    assert command(*strict) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "--package thing=DIR" in error
    assert not (tmp_path / "worlds").exists()
    assert command(*strict, "--package", f"thing={model}") == 0
    assert command(*strict, "--package", f"thing={model}") == 2
    assert "exists already" in capsys.readouterr().err
    assert command(*strict, "--package", f"thing={model}", "--force") == 0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["nowhere.world"], "nowhere.world"),
        (["a.world", "--package", "thing"], "expected NAME="),
        (["a.world", "--package", "thing=/no/such/folder"], "no such folder"),
        (["a.world", "--name", "no name"], "no name"),
    ],
)
def test_command_errors_are_one_line(tmp_path, monkeypatch, command, capsys, arguments, words):
    monkeypatch.chdir(tmp_path)
    traps.world(tmp_path, "", file="a.world")
    assert command(*arguments) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: ")
    assert error.count("\n") == 1
    assert words in error
    assert not (tmp_path / "worlds").exists()
