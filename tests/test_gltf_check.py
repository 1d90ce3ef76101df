"""glTF files that VTK would reject or misread are rejected when a vehicle is loaded, with the key."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from pydrake.geometry import Box, GeometryInstance, Mesh, SceneGraph
from pydrake.math import RigidTransform

from mirdrake.core.errors import ModelError
from mirdrake.core.hulls import hull_points
from mirdrake.core.paths import data_root
from mirdrake.vehicles.gltf_check import check_gltf


def copy_mesh(folder: Path, change: Callable[[dict[str, Any]], Any]) -> Path:
    """Return a copy of the Bolt's wheel after a change of its content."""
    for file in (data_root() / "models/bolt/meshes").iterdir():
        shutil.copy(file, folder / file.name)
    path = folder / "wheel.gltf"
    content = json.loads(path.read_text(encoding="utf-8"))
    change(content)
    path.write_text(json.dumps(content), encoding="utf-8")
    return path


def put(kind: str, **values: Any) -> Callable[[dict[str, Any]], Any]:
    """Return a change that sets keys of the first entry of a list, which is made if need be."""

    def change(content: dict[str, Any]) -> None:
        entries = content.setdefault(kind, [{}])
        entries[0].update(values)

    return change


def set_mode(content: dict[str, Any]) -> None:
    """Set an unknown mode."""
    content["meshes"][0]["primitives"][0]["mode"] = 99


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (put("bufferViews", target=9), "bufferViews[0].target is 9, not one of 34962, 34963"),
        (put("bufferViews", target=True), "bufferViews[0].target is True"),
        (put("bufferViews", target=[1]), "bufferViews[0].target is [1]"),
        (put("bufferViews", byteStride=7), "bufferViews[0].byteStride is 7"),
        (put("bufferViews", byteStride=4096), "bufferViews[0].byteStride is 4096"),
        (put("samplers", wrapS=1), "samplers[0].wrapS is 1"),
        (put("materials", alphaMode="GLASS"), "materials[0].alphaMode is GLASS"),
        (set_mode, "unknown mode 99"),
    ],
)
def test_constants_outside_the_specification_are_rejected(
    change: Callable[[dict[str, Any]], Any], words: str, tmp_path: Path
) -> None:
    path = copy_mesh(tmp_path, change)
    with pytest.raises(ModelError) as caught:
        check_gltf(path, "car.xacro:3")
    assert words in str(caught.value)
    assert str(caught.value).startswith("car.xacro:3: broken glTF file: ")


def test_the_bundled_mesh_is_sound(tmp_path: Path) -> None:
    check_gltf(copy_mesh(tmp_path, lambda content: None), "here")


def test_a_mesh_that_drake_cannot_read_is_one_line(tmp_path: Path) -> None:
    path = tmp_path / "broken.gltf"
    path.write_text('{"asset": {"version": "2.0"}, "bufferViews": [{"target": 9}]}', encoding="utf-8")
    scene = SceneGraph()
    source = scene.RegisterSource("car")
    add = scene.RegisterAnchoredGeometry
    broken = add(source, GeometryInstance(RigidTransform(), Mesh(str(path)), "body"))
    box = add(source, GeometryInstance(RigidTransform(), Box(1, 1, 1), "box"))
    assert hull_points(scene.model_inspector(), box) is None
    with pytest.raises(ModelError, match="'body': Drake cannot read its mesh") as caught:
        hull_points(scene.model_inspector(), broken)
    assert "\n" not in str(caught.value)
