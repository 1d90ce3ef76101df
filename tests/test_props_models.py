"""The bundled props: their files, collision solids against visual meshes, and files against the generator."""

import json
import math
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
import yaml
from scipy.spatial import ConvexHull, cKDTree

from mirdrake.core.paths import data_root
from mirdrake.worlds.props import load_prop, make_mesh_prop
from tools.meshes.props import PROPS, write_prop

ROOT = data_root() / "models" / "props"
NAMES = sorted(path.parent.name for path in ROOT.glob("*/prop.yaml"))
NEEDED = {"description", "source", "size", "mass", "visual", "resizable", "driven_over", "solids"}
EXPECTED = {
    "cone", "barrel", "jersey_barrier", "stop_sign", "traffic_light", "pedestrian", "sedan", "van", "tree", "house",
    "building", "thrift_store", "lamp_post", "wall", "speed_bump", "cyclist",
}  # fmt: skip
TRIANGLES = {"cone": 1000, "sedan": 15000, "van": 15000, "tree": 15000, "pedestrian": 15000, "cyclist": 15000}
LONG_ALONG_X = {"jersey_barrier", "wall", "building", "sedan", "van", "cyclist"}
PUBLISHED = {  # [m]; None without a regulation
    "cone": (None, None, 28 * 0.0254),
    "barrel": (None, None, 36 * 0.0254),
    "jersey_barrier": (3.05, 24 * 0.0254, 32 * 0.0254),
    "stop_sign": (None, 30 * 0.0254, (84 + 30) * 0.0254),
    "pedestrian": (None, None, 1.75),
    "sedan": (4.5, None, 1.45),
    "speed_bump": (None, None, 0.075),
    "wall": (4.0, 8 * 0.0254, None),
}


@cache
def spec_of(name: str) -> dict[str, Any]:
    spec: dict[str, Any] = yaml.safe_load((ROOT / name / "prop.yaml").read_text(encoding="utf-8"))
    return spec


@cache
def visual_of(name: str) -> trimesh.Trimesh:
    """Return the mesh in the prop's frame, z up."""
    mesh = trimesh.load(ROOT / name / spec_of(name)["visual"], force="scene").to_geometry()
    mesh.apply_transform([[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
    return mesh


REACH = 2.2  # [m] height up to which a car may touch things


def angle_of(value: float | str) -> float:
    return math.radians(float(value.removesuffix(" deg"))) if isinstance(value, str) else value


def points_of(name: str, solid: dict[str, Any]) -> np.ndarray:
    """Return corners (n, 3) of a solid in the prop's frame; a cylinder's are those of a prism of 64 sides."""
    if "convex" in solid:
        return np.asarray(trimesh.load(ROOT / name / solid["convex"], process=False).vertices)
    if "box" in solid:
        corners = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)]) * np.array(solid["box"]) / 2
    else:
        radius, height = solid["cylinder"]
        turn = 2 * np.pi * np.arange(64) / 64
        rim = np.stack([radius * np.cos(turn), radius * np.sin(turn)], axis=1)
        corners = np.concatenate([np.c_[rim, np.full(64, sign * height / 2)] for sign in (-1, 1)])
    angles = [angle_of(solid.get(key, 0.0)) for key in ("roll", "pitch", "yaw")]
    turned: np.ndarray = corners @ trimesh.transformations.euler_matrix(*angles, "sxyz")[:3, :3].T + solid["at"]
    return turned


def solids_of(name: str) -> Iterator[np.ndarray]:
    for solid in spec_of(name)["solids"]:
        yield points_of(name, solid)


def test_the_props_are_those_of_the_list() -> None:
    assert set(NAMES) == EXPECTED


@pytest.mark.parametrize("name", NAMES)
def test_a_prop_has_all_required_fields_and_no_others(name: str) -> None:
    spec = spec_of(name)
    assert set(spec) | {"mu", "paint"} == NEEDED | {"mu", "paint"}
    assert set(spec) >= NEEDED
    assert all(isinstance(spec[key], str) and spec[key].strip() for key in ("description", "source", "visual"))
    assert len(spec["size"]) == 3
    assert min(spec["size"]) > 0
    assert spec["mass"] > 0
    assert 0 < spec.get("mu", 0.6) < 1.5
    assert spec["resizable"] is (name in {"building", "wall"})
    assert spec["driven_over"] is (name == "speed_bump")
    files = {"prop.yaml", spec["visual"], Path(spec["visual"]).with_suffix(".bin").name}
    for solid in spec["solids"]:
        (kind,) = set(solid) & {"box", "cylinder", "convex"}
        if kind == "convex":
            assert set(solid) == {"convex"}
            files.add(solid["convex"])
        else:
            assert {"at"} <= set(solid) - {kind} <= {"at", "roll", "pitch", "yaw"}
            assert len(solid[kind]) == {"box": 3, "cylinder": 2}[kind]
            assert min(solid[kind]) > 0
    assert {path.name for path in (ROOT / name).iterdir()} == files


@pytest.mark.parametrize("name", NAMES)
def test_visual_meshes_fill_the_box_above_the_ground(name: str) -> None:
    x, y, z = spec_of(name)["size"]
    low, high = visual_of(name).bounds
    np.testing.assert_allclose(low, [-x / 2, -y / 2, 0.0], rtol=0, atol=0.01)
    np.testing.assert_allclose(high, [x / 2, y / 2, z], rtol=0, atol=0.01)
    assert low[2] == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize("name", PUBLISHED)
def test_sizes_are_the_published_ones(name: str) -> None:
    for measured, published in zip(spec_of(name)["size"], PUBLISHED[name], strict=True):
        assert published is None or measured == pytest.approx(published, abs=0.005)


@pytest.mark.parametrize("name", sorted(LONG_ALONG_X))
def test_long_props_are_long_along_x(name: str) -> None:
    x, y, _ = spec_of(name)["size"]
    assert x > y


@pytest.mark.parametrize("name", NAMES)
def test_solids_stay_in_the_box_and_touch_the_ground(name: str) -> None:
    x, y, z = spec_of(name)["size"]
    points = np.concatenate(list(solids_of(name)))
    assert np.all(np.abs(points[:, :2]) <= np.array([x, y]) / 2 + 1e-3)
    assert points[:, 2].max() <= z + 1e-3
    assert points[:, 2].min() == pytest.approx(0.0, abs=1e-3)


def depth_outside(name: str, points: np.ndarray) -> np.ndarray:
    """Return the lower bound of the distance of points (n, 3) to all solids [m]; negative inside."""
    outside = np.full(len(points), np.inf)
    for corners in solids_of(name):
        equations = ConvexHull(corners).equations
        outside = np.minimum(outside, (points @ equations[:, :3].T + equations[:, 3]).max(axis=1))
    return outside


@pytest.mark.parametrize("name", sorted(set(NAMES) - {"tree"}))
def test_a_car_cannot_drive_through_visible_objects(name: str) -> None:
    # All that is seen is in a solid or a few cm from one; mirrors of cars and goods behind glass aside.
    mesh = visual_of(name)
    points = np.concatenate([mesh.vertices, trimesh.sample.sample_surface(mesh, 3000, seed=1)[0]])
    if name in {"sedan", "van"}:
        points = points[np.abs(points[:, 1]) < {"sedan": 0.9, "van": 0.99}[name]]
    assert depth_outside(name, points).max() < {"thrift_store": 0.15, "house": 0.25}.get(name, 0.08)


@pytest.mark.parametrize("name", sorted(set(NAMES) - {"tree"}))
def test_collision_solids_are_close_to_the_visual_surface(name: str) -> None:
    surface = cKDTree(trimesh.sample.sample_surface(visual_of(name), 40_000, seed=1)[0])
    corners = np.concatenate(list(solids_of(name)))
    corners = corners[corners[:, 2] < REACH]
    large = {"house", "building", "thrift_store"}  # few points on much surface
    assert surface.query(corners)[0].max() < (0.2 if name in large else 0.1)


@pytest.mark.parametrize("name", sorted(set(NAMES) - {"tree"}))
def test_collision_solids_cover_the_visual_mesh(name: str) -> None:
    visual, collision = visual_of(name).vertices, np.concatenate(list(solids_of(name)))
    visual, collision = visual[visual[:, 2] < REACH], collision[collision[:, 2] < REACH]
    gap = np.maximum(visual.max(axis=0) - collision.max(axis=0), collision.min(axis=0) - visual.min(axis=0))[:2]
    allowed = {  # mirrors, and sills of windows
        "sedan": (0.03, 0.15), "van": (0.03, 0.20), "house": (0.11, 0.11), "thrift_store": (0.11, 0.11),
        "traffic_light": (0.05, 0.03),
    }  # fmt: skip
    assert np.all(gap <= allowed.get(name, (0.03, 0.03)))


@pytest.mark.parametrize("name", NAMES)
def test_meshes_are_sound_files(name: str) -> None:
    path = ROOT / name / spec_of(name)["visual"]
    data = json.loads(path.read_text(encoding="utf-8"))
    assert data["asset"]["version"] == "2.0"
    assert not data.get("images")
    assert not data.get("textures")
    (buffer,) = data["buffers"]
    size = (path.parent / buffer["uri"]).stat().st_size
    assert buffer["byteLength"] == size
    assert all(view.get("byteOffset", 0) + view["byteLength"] <= size for view in data["bufferViews"])
    for mesh in data["meshes"]:
        for part in mesh["primitives"]:
            assert 0 <= part["material"] < len(data["materials"])
            assert {"POSITION", "NORMAL"} <= set(part["attributes"])
    mesh = visual_of(name)
    assert np.isfinite(mesh.vertices).all()
    np.testing.assert_allclose(np.linalg.norm(mesh.vertex_normals, axis=1), 1.0, rtol=0, atol=1e-3)


@pytest.mark.parametrize("name", NAMES)
def test_a_prop_is_read_as_its_file_states(name: str) -> None:
    prop, spec = load_prop(name), spec_of(name)
    assert prop.size == tuple(spec["size"])
    assert (prop.mass, prop.driven_over, len(prop.solids)) == (spec["mass"], spec["driven_over"], len(spec["solids"]))
    for solid, corners in zip(prop.solids, solids_of(name), strict=True):  # as Drake has it, and as it is read here
        np.testing.assert_allclose(np.ptp(solid.corners, axis=0), np.ptp(corners, axis=0), rtol=0.02, atol=0.01)
    assert prop.visual is not None
    np.testing.assert_allclose(make_mesh_prop(prop.visual).size, prop.size, rtol=0, atol=0.01)


def test_the_readme_has_a_row_for_each_prop() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    rows = [line.split("|") for line in text.splitlines() if line.startswith("|")]
    table = {row[1].strip(): [row[i].strip() for i in (2, 3, 4, 5, 7)] for row in rows[2:]}
    for name in NAMES:
        spec = spec_of(name)
        size = " x ".join(f"{side:g}" for side in spec["size"])
        expected = [size, str(spec["mass"]), str(len(spec["solids"])), str(len(visual_of(name).faces)), spec["source"]]
        assert table[name] == expected
    assert set(table) == set(NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_the_paint_is_a_material_of_the_mesh(name: str) -> None:
    text = (ROOT / name / spec_of(name)["visual"]).read_text(encoding="utf-8")
    names = {material["name"] for material in yaml.safe_load(text)["materials"]}
    assert ("paint" in names) is ("paint" in spec_of(name))
    assert spec_of(name).get("paint", "paint") == "paint"


@pytest.mark.parametrize("name", NAMES)
def test_meshes_are_light(name: str) -> None:
    assert len(visual_of(name).faces) < TRIANGLES.get(name, 5000)


def test_all_props_together_are_small() -> None:
    assert sum(path.stat().st_size for name in NAMES for path in (ROOT / name).iterdir()) < 4e6


@pytest.mark.slow
def test_the_committed_files_are_those_of_the_generator(tmp_path: Path) -> None:
    """To the byte; meshes by corners and area, as the diagonals of flat faces depend on how libraries round."""
    assert set(PROPS) == set(NAMES)
    for name in NAMES:
        write_prop(tmp_path, name)
        made = {path.name: path.read_bytes() for path in (tmp_path / name).iterdir()}
        committed = {path.name: path.read_bytes() for path in (ROOT / name).iterdir()}
        assert made.keys() == committed.keys()
        for file, data in made.items():
            if not file.endswith(".bin"):
                assert data == committed[file], f"tools.meshes.props {name}"
                continue
            found, expected = (numbers_of(tmp_path / name, file), numbers_of(ROOT / name, file))
            assert found.keys() == expected.keys()
            for key, values in found.items():
                for rows, others in ((values, expected[key]), (expected[key], values)):
                    assert cKDTree(others).query(rows)[0].max() < 1e-5, f"{name} {key}"
                if key.endswith("POSITION"):
                    areas = [trimesh.triangles.area(rows.reshape(-1, 3, 3)).sum() for rows in (values, expected[key])]
                    assert areas[0] == pytest.approx(areas[1], rel=1e-5)


@pytest.mark.parametrize("name", NAMES)
def test_normals_have_length_1(name: str) -> None:
    for file in (ROOT / name).glob("*.bin"):
        for key, values in numbers_of(ROOT / name, file.name).items():
            if key.endswith("NORMAL"):
                np.testing.assert_allclose(np.linalg.norm(values, axis=1), 1.0, rtol=0, atol=1e-5)


def numbers_of(folder: Path, file: str) -> dict[str, np.ndarray]:
    """Return the attributes of the corners of all triangles, by mesh, its part, and the meaning of the attribute."""
    data, content = json.loads((folder / file).with_suffix(".gltf").read_text()), (folder / file).read_bytes()
    kinds = {5121: np.uint8, 5123: np.uint16, 5125: np.uint32, 5126: np.float32}
    columns = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}

    def array(number: int) -> np.ndarray:
        accessor = data["accessors"][number]
        view = data["bufferViews"][accessor["bufferView"]]
        begin = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
        width = columns[accessor["type"]]
        kind = kinds[accessor["componentType"]]
        return np.frombuffer(content, kind, width * accessor["count"], begin).reshape(-1, width)

    return {
        f"{i} {k} {meaning}": array(number)[array(part["indices"]).ravel()]
        for i, mesh in enumerate(data["meshes"])
        for k, part in enumerate(mesh["primitives"])
        for meaning, number in part["attributes"].items()
    }
