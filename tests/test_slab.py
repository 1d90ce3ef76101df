"""Roads with a thickness: what tyres, lidars and pictures find at their edges."""

import base64
import json
from collections.abc import Iterator
from math import pi
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
from pydrake.math import RigidTransform
from pydrake.systems.framework import DiagramBuilder

from mirdrake.ground import Terrain
from mirdrake.ground.terrain import FACE, Slab
from mirdrake.plant.plant import make_plant
from mirdrake.sensors.ranging.beams import grid
from mirdrake.sensors.ranging.motion import BodyState
from mirdrake.sensors.ranging.world import GROUND, Beams, ray_world
from mirdrake.worlds import load_world, make_world
from mirdrake.worlds.scenery import SceneryItem, scenery
from tests.ground_rigs import WHEEL_LOADS, drive

CROSSING = {"main": {"segments": [{"line": 60}], "width": 24.0, "start": {"at": [32, -30], "yaw": "90 deg"}}}
"""A road across the x axis, from x = 20 to 44 m."""


@pytest.mark.parametrize("thickness", [0.004, 0.05])
def test_the_ground_beside_a_slab_is_lower_by_its_thickness(thickness: float) -> None:
    """A face of 45 degrees, at least 10 mm long, against shapely's distances; slopes against differences."""
    spikes = shapely.Polygon([(0, 0), (30, 0), (30, 20), (15, 0.5), (0, 20)], [[(2, 2), (2, 6), (4, 2)]])
    area = shapely.union(spikes, shapely.Point(60.0, 5.0).buffer(7.0))
    terrain, face = Terrain([Slab(area, thickness)]), max(thickness, FACE)
    random = np.random.default_rng(2)
    edge: Any = shapely.boundary(area)
    near = shapely.line_interpolate_point(edge, random.uniform(0.0, edge.length, 4000))
    points = np.vstack(
        [
            random.uniform([-20.0, -20.0], [90.0, 40.0], (4000, 2)),
            shapely.get_coordinates(near) + random.normal(0.0, face, (4000, 2)),
        ]
    )
    away = shapely.distance(area, shapely.points(points))
    assert np.sum((away > 0.0) & (away < face)) > 500
    x, y = points.T
    values = terrain.slopes(x, y)
    np.testing.assert_allclose(values[:, 0], -thickness * np.minimum(away / face, 1.0), atol=1e-13)
    step = 1e-7
    inside = shapely.distance(edge, shapely.points(points)) > step
    smooth = inside & (np.abs(away - face) > 2.0 * step)
    along = (terrain.height(x + step, y) - terrain.height(x - step, y)) / (2.0 * step)
    across = (terrain.height(x, y + step) - terrain.height(x, y - step)) / (2.0 * step)
    np.testing.assert_allclose(values[smooth, 1:], np.column_stack([along, across])[smooth], atol=1e-5)


def test_only_a_thickness_lowers_the_ground() -> None:
    """The test track has 10 mm; by default roads have none, and the plane stays a plane."""
    world = load_world("test_track")
    x, y = world.tracks["main"].point(np.linspace(0.0, 900.0, 50), 1.4)
    assert (world.ground.terrain.height(x, y) == 0.0).all()
    assert world.ground.terrain.height(world.ground.extent[0], world.ground.extent[1]) == -0.01
    assert make_world({"mirdrake": "world/1", "tracks": CROSSING}).ground.terrain.flat


def faces(item: SceneryItem) -> Iterator[np.ndarray]:
    """Yield the triangles of each primitive of a mesh (n, 3, 3), z up."""
    document = json.loads(item.shape.source().in_memory().mesh_file.contents())
    blob = base64.b64decode(document["buffers"][0]["uri"].split(",")[1])

    def read(index: int, kind: str) -> np.ndarray:
        view = document["bufferViews"][document["accessors"][index]["bufferView"]]
        return np.frombuffer(blob, kind, offset=view["byteOffset"], count=view["byteLength"] // 4)

    for primitive in document["meshes"][0]["primitives"]:
        points = read(primitive["attributes"]["POSITION"], "<f4").reshape(-1, 3).astype(float)
        yield points[read(primitive["indices"], "<u4").reshape(-1, 3)][..., [0, 2, 1]] * [1.0, -1.0, 1.0]


def test_the_meshes_of_the_test_track_are_the_ground_of_its_tyres() -> None:
    """Random points of all triangles: within 1 mm; 1 of 1000, where faces cross at inner corners, within 5 mm."""
    world, random = load_world("test_track"), np.random.default_rng(3)
    for item in scenery(world):
        for triangles in faces(item):
            weights = random.dirichlet([1.0, 1.0, 1.0], (len(triangles), 4))
            points = np.einsum("nki,nij->nkj", weights, triangles).reshape(-1, 3)
            errors = np.abs(points[:, 2] - world.ground.terrain.height(points[:, 0], points[:, 1]))
            assert errors.max() < 5e-3
            assert (errors > 1e-3).mean() < 1e-3


def test_a_lidar_sees_the_edge_of_the_road() -> None:
    """Heights of hits beside the road are 10 mm below those on it."""
    content = {"mirdrake": "world/1", "tracks": {"main": {**CROSSING["main"], "thickness": "10 mm"}}}
    parts = make_plant(DiagramBuilder(), make_world(content), {})
    beams = Beams(grid(np.linspace(-pi, pi, 360), np.radians(np.linspace(-40.0, -5.0, 16))), np.zeros(360))
    state = BodyState(np.eye(3), np.array([43.3, -0.2, 1.5]), np.zeros(3), np.zeros(3))
    hits = ray_world(parts).cast(beams, RigidTransform(), (state, state), {}, period=0.1, far=60.0)
    seen = hits.object_index == GROUND
    points = state.p + hits.distance[seen][:, None] * beams.directions[seen]
    on_road = np.abs(points[:, 0] - 32.0) < 12.0
    assert min(on_road.sum(), (~on_road).sum()) > 1000
    np.testing.assert_allclose(points[on_road, 2], 0.0, atol=1e-5)
    beside = np.abs(points[:, 0] - 32.0) > 12.01
    np.testing.assert_allclose(points[beside, 2], -0.01, atol=1e-5)


def test_wheels_cross_the_edge_of_a_road_with_every_contact(tmp_path: Path) -> None:
    """At 4 m/s: each axle rises by 10 mm and falls again where its wheels cross the edges; the contacts agree."""
    tracks = {"main": {**CROSSING["main"], "thickness": "10 mm"}}
    drives = {
        contact: drive(tmp_path, world={"tracks": tracks}, contact=contact, speed=4.0, duration=16.0)
        for contact in ("tyre", "point", "hydroelastic")
    }
    signals = drives["tyre"]
    for other in ("point", "hydroelastic"):
        assert (drives[other] == signals).all(axis=None)

    # Heights at rest beside the road, with both axles on it, and beyond it.
    x, z = signals["ego.x"], signals["ego.z"]
    before, after = z[(x > 12.0) & (x < 16.0)].mean(), z[x > 56.0].mean()
    top = z[(x > 34.0) & (x < 40.0)].mean()
    assert top - before == pytest.approx(0.01, abs=2e-5)
    assert after == pytest.approx(before, abs=1e-5)

    # The ring of the radius r touches the edge where its chord at the height h of the edge ends, √(2 r d - d²) before
    # it with d = h + the compression of the tyre, the height of the rear axle above the wheel at rest.
    radius, depth = 0.3338, -before
    reach = float(np.sqrt(2.0 * radius * depth - depth**2))
    for name, ahead in zip(WHEEL_LOADS, (2.601, 2.601, 0.0, 0.0), strict=True):
        load = signals[name]
        rest = load[(x > 12.0) & (x < 16.0)].mean()
        assert load[(x > 12.0) & (x + ahead < 46.0)].max() > 1.05 * rest
        if ahead:
            first = (x + ahead)[(np.abs(load - rest) > 0.02 * rest) & (x > 12.0)].iloc[0]
            assert 20.0 - reach < first < 20.0 - 0.7 * reach
