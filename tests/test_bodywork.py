"""Car bodies made of outlines: their bounds, closed skins, room for the wheels, and files that repeat to the byte."""

import json
from dataclasses import replace
from functools import cache
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
import shapely
import trimesh
from scipy.spatial import cKDTree

from mirdrake.core.errors import ModelError
from mirdrake.core.paths import data_root
from mirdrake.vehicles import load_vehicle
from mirdrake.vehicles.bodywork import BODY_STYLES, write_car
from mirdrake.vehicles.bodywork.body import _STYLES, _draw_body
from mirdrake.vehicles.bodywork.mesh import Mesh
from mirdrake.vehicles.bodywork.shapes import ALONG_Y, extrude, revolve, rounded_box
from mirdrake.vehicles.bodywork.shell import Frame, Shell
from mirdrake.vehicles.bodywork.sizes import STEERING, BodySize, arch_clearance
from mirdrake.vehicles.bodywork.wheels import build_wheel
from tests.marks import mostly_slow
from tools.meshes.outlines.car import CarOutline, build_skin
from tools.meshes.outlines.curves import curve, smooth_max, smooth_min
from tools.meshes.outlines.shell import half_shell
from tools.meshes.outlines.solids import pillow, tube
from tools.meshes.outlines.wheels import WheelDesign

MODELS = ["bolt", "catvehicle", "mkz", "unior"]
OUTLINES = [name for name in MODELS if name != "unior"]  # the Unior has an open body of its own
SIZES = {
    "hatchback": (
        {"wheelbase": 2.60, "track": 1.52, "length": 4.20, "width": 1.76, "height": 1.48},
        {"wheel_radius": 0.316, "wheel_width": 0.205, "ground_clearance": 0.15, "front_overhang": 0.80},
    ),
    "sedan": (
        {"wheelbase": 3.20, "track": 1.64, "length": 6.00, "width": 1.95, "height": 1.55},
        {"wheel_radius": 0.35, "wheel_width": 0.245, "ground_clearance": 0.16, "front_overhang": 1.10},
    ),
    "suv": (
        {"wheelbase": 0.19, "track": 0.13, "length": 0.30, "width": 0.155, "height": 0.125},
        {"wheel_radius": 0.026, "wheel_width": 0.018, "ground_clearance": 0.014, "front_overhang": 0.055},
    ),
    "van": (
        {"wheelbase": 3.66, "track": 1.71, "length": 5.93, "width": 2.02, "height": 2.6},
        {"wheel_radius": 0.34, "wheel_width": 0.235, "ground_clearance": 0.17, "front_overhang": 1.0},
    ),
    "truck": (
        {"wheelbase": 4.2, "track": 1.96, "length": 7.5, "width": 2.45, "height": 3.3},
        {"wheel_radius": 0.42, "wheel_width": 0.25, "ground_clearance": 0.25, "front_overhang": 1.3},
    ),
    "robot": (
        {"wheelbase": 0.57, "track": 0.45, "length": 0.90, "width": 0.56, "height": 0.40},
        {"wheel_radius": 0.095, "wheel_width": 0.09, "ground_clearance": 0.06, "front_overhang": 0.15},
    ),
}


def size_of(style: str) -> BodySize:
    return BodySize(**SIZES[style][0], **SIZES[style][1])


@cache
def outline_of(model: str) -> CarOutline:
    car: CarOutline = import_module(f"tools.meshes.{model}").CAR
    return car


@cache
def shell_of(model: str) -> tuple[np.ndarray, np.ndarray]:
    return half_shell(build_skin(outline_of(model)))


def triangles_of(path: Path, *, without: tuple[str, ...] = ()) -> tuple[np.ndarray, np.ndarray]:
    """Return the triangles (n, 3, 3) of a written mesh in the car's frame, and the normals at their corners."""
    document = json.loads(path.read_text(encoding="utf-8"))
    blob = path.with_suffix(".bin").read_bytes()

    def data(index: int, kind: str, columns: int) -> np.ndarray:
        accessor = document["accessors"][index]
        view = document["bufferViews"][accessor["bufferView"]]
        count = accessor["count"] * columns
        return np.frombuffer(blob, kind, count, view["byteOffset"]).reshape(-1, columns)

    triangles = []
    for primitive in document["meshes"][0]["primitives"]:
        if document["materials"][primitive["material"]]["name"] in without:
            continue
        kind = "<u2" if document["accessors"][primitive["indices"]]["componentType"] == 5123 else "<u4"
        faces = data(primitive["indices"], kind, 1).reshape(-1, 3)
        both = [data(primitive["attributes"][name], "<f4", 3).astype(float) for name in ("POSITION", "NORMAL")]
        triangles.append([(array[:, [0, 2, 1]] * [1, -1, 1])[faces] for array in both])  # y up to z up
    return np.concatenate([t for t, _ in triangles]), np.concatenate([n for _, n in triangles])


def samples_of(triangles: np.ndarray) -> np.ndarray:
    """Return points (n, 3) spread over triangles."""
    weights = np.array([(i, j, 4 - i - j) for i in range(5) for j in range(5 - i)]) / 4
    points: np.ndarray = np.einsum("wk,tkc->twc", weights, triangles).reshape(-1, 3)
    return points


def deepest_in_tyre(points: np.ndarray, centre: tuple[float, float, float], wheel: WheelDesign, angle: float) -> float:
    """Return the depth [m] of points inside a steered tyre, a cylinder; negative outside."""
    p = points[np.abs(points - centre).max(axis=1) < wheel.radius + wheel.width] - centre
    x, y = np.cos(angle) * p[:, 0] + np.sin(angle) * p[:, 1], -np.sin(angle) * p[:, 0] + np.cos(angle) * p[:, 1]
    depth = np.minimum(wheel.radius - np.hypot(x, p[:, 2]), wheel.width / 2 - np.abs(y))
    return float(depth.max())


def test_a_curve_passes_its_knots_does_not_overshoot_and_stays_constant_beyond() -> None:
    f = curve((0.0, 0.0), (1.0, 0.0), (2.0, 1.0), (3.0, 1.0))
    np.testing.assert_array_equal(f(np.array([-1.0, 0.0, 1.0, 2.0, 3.0, 9.0])), [0, 0, 0, 1, 1, 1])
    between = f(np.linspace(0, 3, 61))
    assert between.min() == 0.0
    assert between.max() == 1.0


def test_a_rounded_maximum_is_a_quarter_of_its_radius_above_the_crease_and_exact_away_from_it() -> None:
    a = np.array([1.0, 1.0, 1.0])
    b = np.array([1.0, 1.2, 0.5])
    np.testing.assert_allclose(smooth_max(a, b, 0.2), [1.05, 1.2, 1.0], rtol=0, atol=1e-15)
    np.testing.assert_allclose(smooth_min(a, b, 0.2), [0.95, 1.0, 0.5], rtol=0, atol=1e-15)


def test_a_straight_wheel_reaches_its_radius_and_half_its_width() -> None:
    reach, inwards = arch_clearance(0.3, 0.2, 0.0)
    assert reach == pytest.approx(0.3, abs=1e-12)
    assert inwards == pytest.approx(0.1, abs=1e-12)


def test_a_wheel_across_reaches_the_corner_of_its_side_view() -> None:
    # At 90° the side view shows the tyre's width and height: the farthest point is its upper corner, √(0.3² + 0.1²).
    reach, inwards = arch_clearance(0.3, 0.2, np.pi / 2)
    assert reach == pytest.approx(np.hypot(0.3, 0.1), abs=1e-9)
    assert inwards == pytest.approx(0.3, abs=1e-9)


@pytest.mark.parametrize(
    "mesh",
    [
        pillow("paint", (1.0, 2.0, 3.0)),
        tube("paint", [(0, 0, 0), (1, 0, 0)], 0.1),
        rounded_box("paint", (1.0, 2.0, 3.0)),
        extrude("paint", shapely.box(-1, -2, 1, 2), 0.0, 1.0, bevel=0.1),
        extrude("paint", shapely.Point(0, 0).buffer(1.0), -1.0, 1.0, axes=ALONG_Y),
        revolve("paint", [(-1.0, 0.0), (-1.0, 1.0), (1.0, 1.0), (1.0, 0.0)], 12),
    ],
)
def test_normals_of_small_solids_point_away_from_their_middle(mesh: Mesh) -> None:
    ((triangles, normals),) = [
        (np.concatenate([t for t, _ in chunks]), np.concatenate([n for _, n in chunks]))
        for chunks in mesh.parts.values()
    ]
    middle = triangles.reshape(-1, 3).mean(axis=0)
    assert np.all(np.einsum("ijk,ijk->ij", triangles - middle, normals) > -1e-9)


@pytest.mark.parametrize("name", OUTLINES)
def test_the_skin_before_cutting_is_closed_and_its_normals_point_outwards(name: str) -> None:
    skin = build_skin(outline_of(name))
    points, faces = shell_of(name)
    both = np.concatenate([points[faces], (points[faces] * [1, -1, 1])[:, ::-1]])
    mesh = trimesh.Trimesh(both.reshape(-1, 3), np.arange(3 * len(both)).reshape(-1, 3), process=False)
    mesh.merge_vertices(digits_vertex=7)
    mesh.update_faces(mesh.nondegenerate_faces())
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    size = mesh.extents
    assert 0.5 < mesh.volume / np.prod(size) < 0.8  # positive: faces turn outwards; a car fills its box so far
    assert np.all(skin.function(points + 0.01 * skin.normals(points)) > 0)
    assert np.all(skin.function(points - 0.01 * skin.normals(points)) < 0)


def cars() -> list[str]:
    return [style for style in BODY_STYLES if _STYLES[style].curves is not None]


@pytest.mark.parametrize("style", cars())
def test_the_lofted_skin_of_a_new_vehicle_is_closed_and_stays_closed_with_its_windows(style: str) -> None:
    curves = _STYLES[style].curves
    assert curves is not None
    shell = Shell(curves, Frame(-0.8, 3.4, 2.6, 0.88, 0.15, 1.5, 0.36))
    before = area(shell.triangles)
    _draw_body(shell, _STYLES[style])
    assert area(shell.triangles) == pytest.approx(before, rel=1e-9)  # regions divide the skin and lose none of it
    triangles = shell.triangles
    both = np.concatenate([triangles, (triangles * [1, -1, 1])[:, ::-1]])
    face = np.cross(both[:, 1] - both[:, 0], both[:, 2] - both[:, 0])
    # A closed surface: its area vectors add up to zero, and its volume does not depend on the origin.
    np.testing.assert_allclose(face.sum(axis=0) / 2, 0.0, atol=1e-6)
    volume = float(np.einsum("ij,ij->", both.mean(axis=1), face)) / 6
    assert 0.5 < volume / (4.2 * 1.76 * 1.35) < 0.95


@pytest.mark.parametrize("style", mostly_slow(BODY_STYLES, fast=2))
def test_faces_of_a_new_vehicle_look_where_their_normals_point(style: str, tmp_path: Path) -> None:
    write_car(tmp_path, style=style, size=size_of(style))
    triangles, normals = triangles_of(tmp_path / "meshes" / "body.gltf")
    face = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    turn = np.einsum("ij,ij->i", face, normals.mean(axis=1))
    assert area(triangles[turn < 0]) < 1e-3 * area(triangles)


@pytest.mark.parametrize("model", mostly_slow(MODELS, fast=2))
def test_faces_of_a_body_look_where_their_normals_point(model: str) -> None:
    triangles, normals = triangles_of(data_root() / "models" / model / "meshes" / "body.gltf")
    face = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    area = np.linalg.norm(face, axis=1)
    large_enough = area > 2e-6  # of thinner slivers, rounding to float32 decides the direction
    turn = np.einsum("ij,ij->i", face, normals.mean(axis=1))
    assert np.all(turn[large_enough] > 0)
    assert area[~large_enough].sum() < 1e-3 * area.sum()


@pytest.mark.parametrize(
    ("model", "low", "high"),
    [  # painted skin: rear and front end, half width, top
        ("bolt", (-0.715, 0.8825), (3.451, 1.595)),
        ("catvehicle", (-0.913, 0.903), (3.524, 1.720)),
        ("mkz", (-1.040, 0.932), (3.885, 1.476)),
    ],
)
def test_the_skin_of_a_bundled_car_has_its_published_size(
    model: str, low: tuple[float, float], high: tuple[float, float]
) -> None:
    points, _ = shell_of(model)
    extent = [points[:, 0].min(), points[:, 1].max(), points[:, 0].max(), points[:, 2].max()]
    np.testing.assert_allclose(extent, [*low, *high], rtol=0, atol=0.01)


@pytest.mark.parametrize("model", MODELS)
def test_steered_front_wheels_and_rear_wheels_of_a_bundled_car_touch_no_part_of_the_body(model: str) -> None:
    g = load_vehicle(model).geometry
    # Half axles of the Unior end in its wheels.
    triangles, _ = triangles_of(data_root() / "models" / model / "meshes" / "body.gltf", without=("rim_shadow",))
    points = samples_of(triangles)
    front = WheelDesign(g.front_wheel_radius, g.front_wheel_width, 0.5 * g.front_wheel_radius)
    rear = WheelDesign(g.rear_wheel_radius, g.rear_wheel_width, 0.5 * g.rear_wheel_radius)
    scrub = (g.front_track - g.kingpin_track) / 2
    for angle in np.linspace(-g.steering_limit, g.steering_limit, 7):
        x, y = g.wheelbase - scrub * np.sin(angle), g.kingpin_track / 2 + scrub * np.cos(angle)
        assert deepest_in_tyre(points, (x, y, front.radius), front, angle) < 0
    assert deepest_in_tyre(points, (0.0, g.rear_track / 2, rear.radius), rear, 0.0) < 0


@pytest.mark.parametrize("model", mostly_slow(sorted(MODELS, reverse=True)))
def test_the_committed_meshes_are_those_of_the_script_and_small(model: str, tmp_path: Path) -> None:
    folder = data_root() / "models" / model / "meshes"
    import_module(f"tools.meshes.{model}").write(tmp_path)
    for name in ("body.gltf", "wheel.gltf"):
        stale = f"run python -m tools.meshes.{model}"
        ours, theirs = (json.loads((root / name).read_text(encoding="utf-8")) for root in (tmp_path, folder))
        assert ours["materials"] == theirs["materials"], stale
        for material in ours["materials"]:
            others = tuple(m["name"] for m in ours["materials"] if m != material)
            created, committed = (triangles_of(root / name, without=others)[0] for root in (tmp_path, folder))
            # Another processor rounds the last bit otherwise, and a triangle on a border is cut in two or is not.
            assert area(created) == pytest.approx(area(committed), abs=3e-5), stale
            assert max(new_corners(created, committed), new_corners(committed, created)) < 60, stale
    assert all(path.stat().st_size < 1.5e6 for path in folder.glob("*.bin"))


def area(triangles: np.ndarray) -> float:
    a, b, c = triangles.transpose(1, 0, 2)
    return 0.5 * float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())


def new_corners(triangles: np.ndarray, others: np.ndarray) -> int:
    """Return the number of triangle corners that are not, to a tenth of a millimetre, corners of other triangles."""
    distance, _ = cKDTree(others.reshape(-1, 3)).query(triangles.reshape(-1, 3))
    return int(np.count_nonzero(distance > 1e-4))


@pytest.mark.parametrize("style", mostly_slow(SIZES, fast=3))
def test_a_new_body_has_the_given_size_and_room_for_its_wheels(style: str, tmp_path: Path) -> None:
    sizes = {**SIZES[style][0], **SIZES[style][1]}
    write_car(tmp_path, style=style, size=size_of(style))
    # Half axles of bodies of boxes end in their wheels.
    triangles, _ = triangles_of(tmp_path / "meshes" / "body.gltf", without=("rim_shadow",))
    corners = triangles.reshape(-1, 3)
    front = sizes["wheelbase"] + sizes["front_overhang"]
    close = 0.01 * min(1.0, sizes["length"])
    extent = [corners[:, 0].min(), corners[:, 0].max(), corners[:, 2].min(), corners[:, 2].max()]
    requested = [front - sizes["length"], front, sizes["ground_clearance"], sizes["height"]]
    np.testing.assert_allclose(extent, requested, rtol=0, atol=close)
    low = corners[corners[:, 2] < 0.58 * sizes["ground_clearance"] + 0.42 * sizes["height"]]  # below the mirrors
    assert np.ptp(low[:, 1]) == pytest.approx(sizes["width"], abs=close)
    wheel = WheelDesign(sizes["wheel_radius"], sizes["wheel_width"], 0.5 * sizes["wheel_radius"])
    points = samples_of(triangles)
    side, height = sizes["track"] / 2, sizes["wheel_radius"]
    for angle in np.linspace(-STEERING, STEERING, 7):
        assert deepest_in_tyre(points, (sizes["wheelbase"], side, height), wheel, angle) < 0
    assert deepest_in_tyre(points, (0.0, side, height), wheel, 0.0) < 0
    tyre = triangles_of(tmp_path / "meshes" / "wheel.gltf")[0].reshape(-1, 3)
    assert np.hypot(tyre[:, 0], tyre[:, 2]).max() == pytest.approx(wheel.radius, rel=1e-3)
    assert np.abs(tyre[:, 1]).max() == pytest.approx(wheel.width / 2, rel=0.01)
    assert sum(path.stat().st_size for path in (tmp_path / "meshes").iterdir()) < 1.5e6


@pytest.mark.parametrize("style", mostly_slow(["robot", "hatchback"]))
def test_the_same_sizes_give_the_same_bytes(style: str, tmp_path: Path) -> None:
    for folder in ("first", "second"):
        write_car(tmp_path / folder, style=style, size=size_of(style))
    for name in ("body.gltf", "body.bin", "wheel.gltf", "wheel.bin"):
        first, second = ((tmp_path / folder / "meshes" / name).read_bytes() for folder in ("first", "second"))
        assert first == second


def test_a_wheel_looks_the_same_only_after_a_whole_turn() -> None:
    mesh = build_wheel(0.3234, 0.215, rim=0.66)
    valve = mesh.corners("valve").mean(axis=0)
    assert np.hypot(valve[0], valve[2]) > 0.15


def test_an_unknown_style_is_rejected_with_the_list_and_impossible_sizes_with_their_values(tmp_path: Path) -> None:
    with pytest.raises(
        ModelError, match=r"unknown body style 'coupe'; allowed: hatchback, sedan, suv, van, truck, robot"
    ):
        write_car(tmp_path, style="coupe", size=size_of("robot"))
    with pytest.raises(ModelError, match=r"wheel_radius of the body is -0.1 m; it must be positive"):
        write_car(tmp_path, style="robot", size=replace(size_of("robot"), wheel_radius=-0.1))
    assert not list(tmp_path.iterdir())
