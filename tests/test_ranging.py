"""Rays against closed forms: every shape, meshes, ground and slopes."""

import base64
import json
from math import cos, pi, sin, tan
from pathlib import Path

import numpy as np
import pytest
from pydrake.common import MemoryFile
from pydrake.geometry import (
    Box,
    Capsule,
    Convex,
    Cylinder,
    Ellipsoid,
    HalfSpace,
    InMemoryMesh,
    Mesh,
    MeshcatCone,
    Shape,
    Sphere,
)
from pydrake.math import RigidTransform, RollPitchYaw

from mirdrake.assembly.diagram import assemble
from mirdrake.sensors.ranging import beams
from mirdrake.sensors.ranging.motion import BodyState, body_state, poses_at, rotations
from mirdrake.sensors.ranging.scene import RayScene
from mirdrake.sensors.ranging.world import ray_world
from tests.ranging_rigs import Room, cast

MILLIMETRE = 1e-3
TILTED = RigidTransform(RollPitchYaw(0.3, -0.4, 1.1), [6.0, -2.0, 1.5])


def _towards(target: np.ndarray, spread: float, count: int = 3000) -> tuple[np.ndarray, np.ndarray]:
    """Return a start (3) and directions (n, 3) around the one to a place."""
    generator, start = np.random.default_rng(5), np.array([-3.0, 1.0, 0.5])
    directions = target - start + spread * generator.uniform(-1.0, 1.0, (count, 3))
    return start, directions / np.linalg.norm(directions, axis=1)[:, None]


# --- formulas, in the frame of the shape: start (3), directions (n, 3), distances (n) -----------------------------


def _box(o: np.ndarray, d: np.ndarray, half: np.ndarray) -> np.ndarray:
    low, high = np.sort(np.stack(((-half - o) / d, (half - o) / d)), axis=0)
    enter, leave = low.max(axis=1), high.min(axis=1)
    return np.where(enter <= leave, enter, np.inf)


def _cylinder(o: np.ndarray, d: np.ndarray, radius: float, half: float) -> np.ndarray:
    a, b = (d[:, :2] ** 2).sum(axis=1), d[:, :2] @ o[:2]
    with np.errstate(invalid="ignore"):
        root = np.sqrt(b * b - a * (o[:2] @ o[:2] - radius**2))
    low, high = np.sort(np.stack(((-half - o[2]) / d[:, 2], (half - o[2]) / d[:, 2])), axis=0)
    enter, leave = np.maximum((-b - root) / a, low), np.minimum((-b + root) / a, high)
    return np.where(enter <= leave, enter, np.inf)


def _ellipsoid(o: np.ndarray, d: np.ndarray, radii: np.ndarray) -> np.ndarray:
    p, q = o / radii, d / radii
    a, b = (q * q).sum(axis=1), q @ p
    with np.errstate(invalid="ignore"):
        enter = (-b - np.sqrt(b * b - a * (p @ p - 1.0))) / a
    return np.where(np.isfinite(enter), enter, np.inf)


def _capsule(o: np.ndarray, d: np.ndarray, radius: float, half: float) -> np.ndarray:
    """Return the distance by sphere tracing, down to a nanometre."""
    along = np.zeros(len(d))
    for _ in range(600):
        p = o + along[:, None] * d
        axis = np.clip(p[:, 2], -half, half)
        along = (
            np.minimum(along, 60.0)
            + np.linalg.norm(p - np.column_stack((np.zeros((len(p), 2)), axis)), axis=1)
            - radius
        )
    return np.where(along < 50.0, along, np.inf)


SHAPES: list[tuple[Shape, object]] = [
    (Box(1.0, 2.0, 0.7), lambda o, d: _box(o, d, np.array([0.5, 1.0, 0.35]))),
    (Cylinder(0.6, 1.4), lambda o, d: _cylinder(o, d, 0.6, 0.7)),
    (Cylinder(12.0, 0.05), lambda o, d: _cylinder(o, d, 12.0, 0.025)),
    (Sphere(0.8), lambda o, d: _ellipsoid(o, d, np.full(3, 0.8))),
    (Ellipsoid(0.4, 1.2, 0.8), lambda o, d: _ellipsoid(o, d, np.array([0.4, 1.2, 0.8]))),
    (Capsule(0.5, 1.0), lambda o, d: _capsule(o, d, 0.5, 0.5)),
]


@pytest.mark.parametrize(("shape", "formula"), SHAPES, ids=lambda value: type(value).__name__)
@pytest.mark.parametrize("far_away", [0.0, 3000.0])
def test_every_ray_is_within_a_millimetre_of_the_formula(shape, formula, far_away: float) -> None:
    room, away = Room(), np.array([far_away, -far_away, 0.0])
    X_WG = RigidTransform(TILTED.rotation(), TILTED.translation() + away)
    room.put(shape, X_WG)
    start, directions = _towards(TILTED.translation(), 2.5)
    start = start + away
    distances = cast(room, start, directions).distance.ravel()
    R = X_WG.rotation().matrix()
    expected = formula((start - X_WG.translation()) @ R, directions @ R)
    hits = np.isfinite(expected)
    assert 100 < hits.sum() < len(hits) - 100
    assert (np.isfinite(distances) != hits).sum() == 0
    assert np.abs(distances[hits] - expected[hits]).max() < 0.001 * MILLIMETRE


def test_a_ray_that_misses_a_cylinder_hits_the_object_behind_it() -> None:
    room = Room()
    room.put(Cylinder(0.5, 2.0), RigidTransform([10.0, 0.0, 0.0]))
    room.put(Cylinder(0.5, 2.0), RigidTransform([20.0, 0.0, 0.0]))
    room.put(Box(1.0, 10.0, 10.0), RigidTransform([30.5, 0.0, 0.0]))
    for index in range(12):  # also through the gap between the cylinder and the prism that wraps it
        offset = 0.5 + (index - 6) * 1e-4 + 5e-5
        hits = cast(room, [0.0, offset, 0.0], [[1.0, 0.0, 0.0]])
        expected = 30.0 if offset > 0.5 else 10.0 - np.sqrt(0.25 - offset**2)
        assert hits.distance[0, 0] == pytest.approx(expected, abs=1e-6)


def test_a_cone_is_as_exact_as_it_is_faceted() -> None:
    room = Room()
    room.put(MeshcatCone(2.0, 1.0, 1.0), RigidTransform([5.0, 0.0, -1.0]))  # from its tip at z = -1 upwards
    angles = np.linspace(0.05, 0.9, 30)
    distances = [cast(room, [0.0, 0.0, z], [[1.0, 0.0, 0.0]]).distance[0, 0] for z in angles]
    assert np.abs(np.array(distances) - (5.0 - 0.5 * (1.0 + angles))).max() < MILLIMETRE


# --- meshes ------------------------------------------------------------------------------------------------------

CORNERS = np.array([[1.0, 2.0, 3.0], [2.0, 2.0, 3.0], [1.0, 4.0, 3.0], [1.0, 2.0, 5.0]])  # a tetrahedron, z up
TRIANGLES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
VIEWS = (([0.0, 2.5, 3.5], [1.0, 0.0, 0.0], 1.0), ([1.2, 0.0, 3.2], [0.0, 1.0, 0.0], 2.0),
         ([1.2, 2.2, 0.0], [0.0, 0.0, 1.0], 3.0))  # fmt: skip


def _gltf(buffer: str) -> str:
    points = np.column_stack((CORNERS[:, 0], CORNERS[:, 2], -CORNERS[:, 1])).astype("<f4")
    indices = TRIANGLES.astype("<u4")
    return json.dumps(
        {
            "asset": {"version": "2.0"},
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": [{"mesh": 0}],
            "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
            "accessors": [
                {
                    "bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3",
                    "min": points.min(axis=0).tolist(), "max": points.max(axis=0).tolist(),
                },
                {"bufferView": 1, "componentType": 5125, "count": 12, "type": "SCALAR"},
            ],
            "bufferViews": [
                {"buffer": 0, "byteOffset": 0, "byteLength": points.nbytes},
                {"buffer": 0, "byteOffset": points.nbytes, "byteLength": indices.nbytes},
            ],
            "buffers": [{"byteLength": points.nbytes + indices.nbytes, "uri": buffer}],
        }
    )  # fmt: skip


def _binary() -> bytes:
    points = np.column_stack((CORNERS[:, 0], CORNERS[:, 2], -CORNERS[:, 1])).astype("<f4")
    return points.tobytes() + TRIANGLES.astype("<u4").tobytes()


def _obj() -> str:
    lines = [f"v {x} {y} {z}" for x, y, z in CORNERS] + [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in TRIANGLES]
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("scale", [1.0, 0.5])
@pytest.mark.parametrize("kind", ["gltf", "obj", "gltf in memory", "obj in memory", "hull"])
def test_meshes_are_seen_where_drake_draws_them(kind: str, scale: float, tmp_path: Path) -> None:
    embedded = "data:application/octet-stream;base64," + base64.b64encode(_binary()).decode()
    (tmp_path / "a.gltf").write_text(_gltf(embedded))
    (tmp_path / "a.obj").write_text(_obj())
    beside = {"a.bin": MemoryFile(_binary(), ".bin", "a")}
    shape: Shape
    if kind == "gltf in memory":
        shape = Mesh(InMemoryMesh(mesh_file=MemoryFile(_gltf("a.bin"), ".gltf", "a"), supporting_files=beside), scale)
    elif kind == "obj in memory":
        shape = Mesh(InMemoryMesh(mesh_file=MemoryFile(_obj(), ".obj", "a")), scale)
    elif kind == "hull":
        shape = Convex(str(tmp_path / "a.obj"), scale)
    else:
        shape = Mesh(str(tmp_path / f"a.{kind}"), scale)
    room = Room()
    room.put(shape, RigidTransform())
    for start, direction, distance in VIEWS:
        measured_distance = cast(room, scale * np.array(start), [direction]).distance[0, 0]
        assert measured_distance == pytest.approx(scale * distance, abs=1e-6)


# --- ground and slopes -------------------------------------------------------------------------------------------


def test_the_ground_is_the_plane_under_the_wheels() -> None:
    down = np.radians([-89.9, -30.0, -5.0, -1.0, 0.0, 20.0])
    hits = cast(Room(), [400.0, 7.0, 1.8], beams.grid([0.7], down).reshape(-1, 3), ground=True, far=150.0)
    expected = [1.8 / sin(-angle) for angle in down[:4]] + [np.inf, np.inf]
    assert hits.distance[0] == pytest.approx(expected, abs=1e-9)
    assert hits.object_index[0].tolist() == [0, 0, 0, 0, -1, -1]


@pytest.mark.parametrize("slope", [2.0, 10.0, 45.0])
def test_a_slope_is_seen_where_its_surface_is(slope: float) -> None:
    room, angle = Room(), np.radians(slope)
    # A slab whose upper face goes through (10, 0, 0) and rises with x.
    X = RigidTransform(RollPitchYaw(0.0, -angle, 0.0), [10.0, 0.0, 0.0])
    room.put(Box(200.0, 50.0, 1.0), X @ RigidTransform([0.0, 0.0, -0.5]))
    for height in (0.2, 1.0, 2.0):
        ahead = cast(room, [0.0, 0.0, height], [[1.0, 0.0, 0.0]], ground=True).distance[0, 0]
        assert ahead == pytest.approx(10.0 + height / tan(angle), abs=1e-6)
        for pitch in (-0.15, 0.02):
            direction = [cos(pitch), 0.0, sin(pitch)]
            distance = cast(room, [0.0, 0.0, height], [direction], ground=True, far=1e4).distance[0, 0]
            on_slope = (height + 10.0 * tan(angle)) / (cos(pitch) * tan(angle) - sin(pitch))
            on_ground = height / -sin(pitch) if pitch < 0.0 else np.inf
            if 0.0 < on_slope < 90.0:
                assert distance == pytest.approx(min(on_slope, on_ground), abs=1e-6)


def test_a_half_space_that_is_seen_is_left_to_the_ground() -> None:
    room = Room()
    room.put(HalfSpace(), RigidTransform())
    assert cast(room, [0.0, 0.0, 1.0], [[0.0, 0.0, -1.0]], ground=True).distance[0, 0] == 1.0


def test_roads_and_their_markings_are_not_steps_in_the_ground() -> None:
    spec = {"world": "test_track", "vehicles": {"ego": {"model": "bolt"}}, "sensors": {"ego": []}}
    assembly = assemble(spec)
    world = ray_world(assembly.parts)
    assert world is ray_world(assembly.parts)  # one for all sensors
    assert not [name for name in world.objects if "road" in name or "scenery" in name]


def test_objects_have_the_names_of_props_and_vehicles() -> None:
    room = Room()
    room.put(Box(1.0, 1.0, 1.0), RigidTransform([5.0, 0.0, 0.0]), "prop/gate[1]/look0")
    room.put(Box(1.0, 1.0, 1.0), RigidTransform([5.0, 2.0, 0.0]), "prop/gate[1]/look1")
    room.put(Box(1.0, 1.0, 1.0), RigidTransform([5.0, 4.0, 0.0]), "prop/gate[2]/look0")
    hits = cast(room, [0.0, 0.0, 0.0], [[5.0, 0.0, 0.0], [5.0, 2.0, 0.0], [5.0, 4.0, 0.0]])
    assert [room.world().objects[index] for index in hits.object_index[0]] == [
        "prop/gate[1]",
        "prop/gate[1]",
        "prop/gate[2]",
    ]


# --- beams and motion --------------------------------------------------------------------------------------------


def test_a_cone_holds_its_axis_its_rim_and_nothing_beyond() -> None:
    directions = beams.cone(0.5, 200).directions[0]
    angles = np.arccos(np.clip(directions[:, 0], -1.0, 1.0))
    assert np.linalg.norm(directions, axis=1) == pytest.approx(np.ones(200))
    assert angles[0] == 0.0
    assert angles.max() == pytest.approx(0.25)
    gap = max(np.sort(np.arccos(np.clip(directions @ direction, -1.0, 1.0)))[1] for direction in directions)
    assert gap < 3.0 * 0.25 / np.sqrt(200)


def test_a_rotating_sensor_scans_a_full_turn_in_a_period() -> None:
    assert beams.turn_times(np.linspace(-pi, pi, 5), 10.0) == pytest.approx([-0.1, -0.075, -0.05, -0.025, 0.0])
    assert beams.turn_times(np.linspace(1.0, -1.0, 3), 10.0) == pytest.approx([-0.1 / pi, -0.05 / pi, 0.0])


def _on_a_spiral(t: float) -> BodyState:
    """Return exact state on a path with growing speed and turn rate."""
    yaw, rate = 0.3 + 0.5 * t + 0.4 * t * t, 0.5 + 0.8 * t
    c, s = cos(yaw), sin(yaw)
    R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    p = np.array([4.0 * sin(yaw), -4.0 * cos(yaw), 0.2 * t])
    return BodyState(R, p, np.array([0.0, 0.0, rate]), np.array([4.0 * rate * c, 4.0 * rate * s, 0.2]))


def test_a_body_between_two_samples_is_where_it_was() -> None:
    before, now, times = _on_a_spiral(1.0), _on_a_spiral(1.1), np.linspace(-0.1, 0.0, 21)
    R, p = poses_at(times, before, now, 0.1)
    exact = [_on_a_spiral(1.1 + t) for t in times]
    assert np.abs(p - [state.p for state in exact]).max() < 0.01 * MILLIMETRE
    assert np.abs(R - [state.R for state in exact]).max() < 1e-6
    # With the present velocity alone it would be some centimetres off.
    alone = poses_at(times, None, now, 0.1)[1]
    assert np.abs(alone - [state.p for state in exact]).max() > 0.02


def test_a_wheel_is_turned_back_at_its_rate() -> None:
    spin = np.array([0.0, 40.0, 0.0])
    state = BodyState(np.eye(3), np.zeros(3), spin, np.zeros(3))
    R, _ = poses_at(np.array([-0.1, -0.05]), state, state, 0.1)
    assert np.abs(R - rotations(np.array([-4.0, -2.0])[:, None] * [0.0, 1.0, 0.0])).max() < 1e-12


def test_rotation_vectors_and_matrices_belong_together() -> None:
    vectors = np.random.default_rng(2).uniform(-1.5, 1.5, (50, 3))
    vectors[:2] = [0.0, 0.0, 0.0], [1e-9, 0.0, 0.0]
    matrices = rotations(vectors)
    assert np.abs(np.einsum("nij,nkj->nik", matrices, matrices) - np.eye(3)).max() < 1e-14
    # Between two states that rest, half of the rotation vector has passed after half of the period.
    for vector, R, half in zip(vectors, matrices, rotations(0.5 * vectors), strict=True):
        before = BodyState(matrices[5], np.zeros(3), np.zeros(3), np.zeros(3))
        now = BodyState(matrices[5] @ R, np.zeros(3), np.zeros(3), np.zeros(3))
        assert np.abs(poses_at(np.array([-0.05]), before, now, 0.1)[0][0] - matrices[5] @ half).max() < 1e-12, vector


def test_the_state_of_a_body_survives_as_numbers() -> None:
    state = _on_a_spiral(0.7)
    again = body_state(state.numbers())
    for name in ("R", "p", "w", "v"):
        assert getattr(again, name) == pytest.approx(getattr(state, name))


def test_a_wall_seen_edge_on_ends_the_ray_at_its_edge() -> None:
    room = Room()
    room.put(Box(2.0, 1.0, 1.0), RigidTransform([6.0, 0.5, 0.0]))  # one side lies in the plane y = 0
    room.put(Box(1.0, 9.0, 9.0), RigidTransform([20.5, 0.0, 0.0]))
    distance = cast(room, [0.0, 0.0, 0.1], [[1.0, 0.0, 0.0]]).distance[0, 0]
    assert distance == pytest.approx(5.0, abs=1e-6) or distance == pytest.approx(20.0, abs=1e-6)


def test_the_same_faces_are_prepared_once_and_others_anew() -> None:
    def scene(radius: float) -> RayScene:
        room = Room()
        room.put(Cylinder(radius, 2.0), RigidTransform([10.0, 0.0, 0.0]))
        return room.world()._fixed

    first = scene(0.5)
    assert scene(0.5) is first
    assert scene(0.6) is not first
