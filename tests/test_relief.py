"""Relief of worlds: keys, messages, shipped worlds, meshes on the terrain."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely

from mirdrake.assembly.scene import Scene, read_scene, write_scene
from mirdrake.core.errors import ConfigError, WorldError
from mirdrake.ground import Terrain
from mirdrake.ground.terrain import Block, Wave
from mirdrake.worlds import World, load_world, make_world
from mirdrake.worlds.draping import TOLERANCE, Roads, drape
from mirdrake.worlds.lock import lock_hash
from mirdrake.worlds.meshes import Surface, fill

STRAIGHT = {"segments": [{"line": 100}], "width": 6}


def world_with(*relief: dict[str, Any], **tracks: Any) -> World:
    return make_world({"mirdrake": "world/1", "tracks": tracks, "ground": {"relief": list(relief)}})


def test_elevation_grade_and_banking_of_a_road() -> None:
    ground = world_with({"road": {"along": "main", "elevation": [[0, 0], [50, 5], [100, 5]]}}, main=STRAIGHT).ground
    assert ground.terrain.height([0.0, 50.0, 80.0], 0.0) == pytest.approx([0.0, 5.0, 5.0], abs=1e-6)
    ground = world_with({"road": {"along": "main", "grade": [[0, 0.0], [100, 0.1]]}}, main=STRAIGHT).ground
    assert ground.terrain.height(60.0, 0.0) == pytest.approx(0.0005 * 60.0**2, abs=1e-6)  # a parabola
    ground = world_with({"road": {"along": "main", "banking": [[0, "-10 deg"]]}}, main=STRAIGHT).ground
    assert ground.terrain.height(50.0, -2.0) == pytest.approx(2.0 * math.tan(math.radians(10.0)))


def test_obstacles_on_a_track() -> None:
    terrain = world_with(
        {"kerb": {"along": "main", "side": "right", "height": "10 cm"}},
        {"pothole": {"on_track": {"track": "main", "s": 20, "offset": -1}, "length": 1.0, "depth": 0.05}},
        {"ramp": {"at": [40, 0], "length": 4, "height": 0.4}},
        main=STRAIGHT,
    ).ground.terrain
    assert terrain.height([10.0, 20.5, 42.0], [-3.2, -1.0, 0.0]) == pytest.approx([0.1, -0.05, 0.2], abs=1e-6)


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ({"road": {"along": "mian"}}, "unknown track 'mian'"),
        ({"grid": {"file": "none.npy"}}, "no such file"),
        ({"bump": {"at": [0, 0], "length": 0.1, "height": 0.5, "shape": "trapezoid"}}, "make slope steeper"),
        ({"bump": {"length": 0.6, "height": 0.1}}, "exactly one of at and on_track"),
        ({"kerb": {"along": "main", "side": "left", "slope": "90 deg"}}, "less than or equal"),
        ({"roughness": {}}, "exactly one of"),
    ],
)
def test_messages(entry: dict[str, Any], message: str) -> None:
    with pytest.raises((ConfigError, WorldError)) as error:
        world_with(entry, main=STRAIGHT)
    assert message in str(error.value)


@pytest.mark.parametrize("table", ["elevation", "banking"])
def test_a_table_beside_a_closed_track_is_one_line(table: str) -> None:
    circle = {"segments": [{"arc": {"radius": 20, "angle": "360 deg"}}], "closed": True, "width": 6}
    with pytest.raises(ConfigError, match=rf"{table}: no s is on the closed track 'main', from 0 to 125\.7 m"):
        world_with({"road": {"along": "main", table: [[500, 0], [600, 0.1]]}}, main=circle)


def test_a_run_folder_has_the_heights_of_its_world(tmp_path: Path) -> None:
    """The file of heights changes after the run; the ground of the run does not."""
    heights, world = tmp_path / "hills.npy", tmp_path / "hills.yaml"
    np.save(heights, np.arange(16.0).reshape(4, 4))
    world.write_text("mirdrake: world/1\nground: {relief: [{grid: {file: hills.npy}}]}\n", encoding="utf-8")
    run = tmp_path / "run"
    run.mkdir()
    write_scene(Scene(load_world(str(world)), {}), run)
    np.save(heights, np.zeros((4, 4)))
    assert read_scene(run).world.ground.terrain.height(1.0, 2.0) == pytest.approx(9.0)
    heights.unlink()
    assert read_scene(run).world.ground.terrain.height(1.0, 2.0) == pytest.approx(9.0)


def test_an_embankment_that_reaches_another_part_of_the_road() -> None:
    """Two straights 20 m apart, one of them 5 m higher: an embankment of 30 m does not fit between them."""
    bend = {"arc": {"radius": 10, "angle": "180 deg"}}
    track = {"segments": [{"line": 100}, bend, {"line": 100}], "width": 4}
    entry = {"along": "main", "elevation": [[0, 0], [100, 0], [150, 5]], "embankment": 30}
    with pytest.raises(WorldError, match="make the embankment shorter"):
        world_with({"road": entry}, main=track)


@pytest.mark.parametrize("name", ["hill_road", "rough_road", "kerb_and_bumps"])
def test_shipped_worlds_have_a_relief(name: str) -> None:
    world = load_world(name)
    track = world.tracks["main"]
    s = np.linspace(0.0, track.length - 1.0, 400)
    z = world.ground.terrain.height(*track.point(s, -2.0))
    assert 0.02 < z.max() - z.min() < 20.0
    if name == "hill_road":
        grade = np.gradient(world.ground.terrain.height(*track.point(s, 0.0)), s)
        assert 0.05 < np.abs(grade).max() < 0.12
    assert lock_hash(world) == lock_hash(load_world(name))


def test_a_draped_mesh_is_within_the_tolerance_and_has_no_cracks() -> None:
    """At 1000 random points near the road; edges of neighbours are the same."""
    terrain = Terrain([Wave(0.5, 12.0, 30.0, 3.0, x=2.0), Block(0.3, 3.0, 2.0, 3.0, 4.0, 2.0, x=5.0, y=4.0, yaw=1.0)])
    area = shapely.box(0.0, -10.0, 20.0, 10.0)
    surface = drape(fill(area, z=0.0, tile=1.0, color=(1.0, 1.0, 1.0), texture=None), terrain, Roads(shapely.Polygon()))
    corners = surface.vertices[surface.triangles]
    random = np.random.default_rng(5)
    weights = random.dirichlet([1.0, 1.0, 1.0], 1000)
    points = np.einsum("nc,ncd->nd", weights, corners[random.integers(len(corners), size=1000)])
    errors = np.abs(points[:, 2] - terrain.height(points[:, 0], points[:, 1]))
    assert np.quantile(errors, 0.99) < 1.25 * TOLERANCE
    # Every inner edge belongs to two triangles.
    edges = np.sort(np.concatenate([surface.triangles[:, [i, (i + 1) % 3]] for i in range(3)]), axis=1)
    unique, count = np.unique(edges, axis=0, return_counts=True)
    lonely = surface.vertices[unique[count == 1]].mean(axis=1)
    border = np.minimum.reduce([lonely[:, 0], 20.0 - lonely[:, 0], lonely[:, 1] + 10.0, 10.0 - lonely[:, 1]])
    assert np.abs(border).max() < 1e-9


def test_the_triangles_of_a_large_area_share_their_edges() -> None:
    """A square of 900 m with a round hole, which is cut along a grid beside rectangles that are not."""
    area = shapely.box(-450.0, -450.0, 450.0, 450.0).difference(shapely.Point(95.0, 50.0).buffer(100.0, quad_segs=60))
    surface = fill(area, z=0.0, tile=1.0, color=(1.0, 1.0, 1.0), texture=None)
    # The places where the grid cuts the circle differ by rounding.
    places, index = np.unique(np.round(surface.vertices[:, :2] @ [1.0, 1.0j], 6), return_inverse=True)
    edges = np.sort(np.concatenate([index[surface.triangles[:, [i, (i + 1) % 3]]] for i in range(3)]), axis=1)
    unique, count = np.unique(edges, axis=0, return_counts=True)
    lonely = places[unique[count == 1]].mean(axis=1)
    middle = np.column_stack((lonely.real, lonely.imag))
    outside, hole = np.abs(middle).max(axis=1) > 449.9, np.linalg.norm(middle - [95.0, 50.0], axis=1) < 100.1
    assert (outside | hole).all()
    assert len(surface.triangles) < 1000


def test_a_thin_triangle_is_divided_where_its_neighbours_are() -> None:
    """A rhombus of 4 by 6 m with a triangle of 3 mm height in the middle; inner edges belong to two triangles."""
    terrain = Terrain([Wave(0.5, 1.0, 10.0, 1.0, x=x) for x in (0.5, 1.5, 2.5, 3.5)])
    corners = np.array([[0.0, 0.0], [4.0, 0.0], [1.6, 0.003], [2.0, -3.0], [2.0, 3.0]])
    vertices, triangles = (
        np.column_stack((corners, np.zeros(5))),
        np.array([[0, 1, 2], [0, 3, 1], [0, 2, 4], [2, 1, 4]]),
    )
    normal = np.tile([0.0, 0.0, 1.0], (5, 1))
    flat = Surface(vertices, triangles, normal, corners, (1.0, 1.0, 1.0), None)
    surface = drape(flat, terrain, Roads(shapely.Polygon()))
    edges = np.sort(np.concatenate([surface.triangles[:, [i, (i + 1) % 3]] for i in range(3)]), axis=1)
    unique, count = np.unique(edges, axis=0, return_counts=True)
    x, y = surface.vertices[unique[count == 1]].mean(axis=1)[:, :2].T
    assert len(x) > 100
    assert np.abs(y) == pytest.approx(1.5 * np.minimum(x, 4.0 - x), abs=1e-9)


def test_a_triangle_without_area_is_not_divided_again_and_again() -> None:
    """Three corners on a line at 0, 1.6 and 4 m, over waves of 1 m.

    The line from 0 to 4 m has no error at its quarters, where it is compared with the terrain, but its parts have.
    """
    terrain = Terrain([Wave(0.5, 1.0, 10.0, 1.0, x=x) for x in range(4)])
    x = np.array([0.0, 1.6, 4.0])
    surface = Surface(
        np.column_stack((x, 0.0 * x, 0.0 * x)), np.array([[0, 1, 2]]), np.tile([0.0, 0.0, 1.0], (3, 1)),
        np.zeros((3, 2)), (1.0, 1.0, 1.0), None,
    )  # fmt: skip
    assert terrain.height(np.arange(5.0), 0.0) == pytest.approx(np.zeros(5))
    draped = drape(surface, terrain, Roads(shapely.Polygon()))
    assert 10 < len(draped.triangles) < 200
    assert len(draped.triangles) == len(draped.vertices) - 2  # a polygon without points inside
    terrain = Terrain([Wave(0.5, 1.0, 10.0, 1.0, x=x) for x in (0.5, 1.5, 2.5, 3.5)])
    # Upright ones have an area, also if they have none from above.
    upright = replace(
        surface,
        vertices=np.array([[0.0, 0.0, -0.05], [4.0, 0.0, -0.05], [4.0, 0.0, 0.0]]),
        normal=np.tile([0.0, 1.0, 0.0], (3, 1)),
    )
    assert len(drape(upright, terrain, Roads(shapely.Polygon())).triangles) > 10
