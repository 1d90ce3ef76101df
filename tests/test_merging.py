"""Fixed objects merged into one mesh look unchanged, and remain separate objects for everything but drawing."""

from math import pi
from typing import Any

import numpy as np
import pytest
from pydrake.geometry import Box, Cylinder, Role
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.plant import MultibodyPlant

from mirdrake.assembly.diagram import assemble
from mirdrake.sensors.cameras import merging, rendering
from mirdrake.sensors.cameras.merging import merge_still_things
from mirdrake.sensors.ranging.world import RayWorld
from tests import test_cameras
from tests.test_cameras import Studio

pytestmark = pytest.mark.skipif(rendering._egl_fault() is not None, reason="cameras cannot be drawn here")


def furnish(plant: MultibodyPlant) -> None:
    """A board behind a box and a cylinder, 4 m and more ahead of the camera; two colours."""
    objects = {
        "prop/board/0": (Box(6.0, 0.1, 6.0), [1.0, 9.0, 3.0], 0.0, [0.5, 0.6, 0.7, 1.0]),
        "prop/box/0": (Box(0.5, 0.7, 0.9), [0.3, 6.0, 3.1], 0.6, [0.8, 0.2, 0.1, 1.0]),
        "prop/drum/0": (Cylinder(0.4, 1.1), [1.7, 6.0, 2.8], 0.0, [0.8, 0.2, 0.1, 1.0]),
        "prop/pane/0": (Box(0.4, 0.01, 0.4), [1.0, 5.0, 3.6], 0.0, [0.1, 0.2, 0.9, 0.5]),  # seen through
    }
    for name, (shape, position, yaw, rgba) in objects.items():
        X_WG = RigidTransform(RollPitchYaw(0.1, 0.0, yaw), position)
        plant.RegisterVisualGeometry(plant.world_body(), X_WG, shape, name, rgba)


def look(monkeypatch: pytest.MonkeyPatch, *, merged: bool) -> dict[str, np.ndarray]:
    """Return colours and depths of the furniture, drawn as one mesh or not."""
    add_renderer = rendering.add_renderer

    def add(scene_graph: Any, name: str, params: Any) -> None:
        params.force_to_pbr = True
        params.lights = []
        if merged:
            assert merge_still_things(plants[0], scene_graph, merged_in=[name]) == 3
        add_renderer(scene_graph, name, params)

    plants: list[MultibodyPlant] = []

    def furnish_and_keep(plant: MultibodyPlant) -> None:
        plants.append(plant)
        furnish(plant)

    with monkeypatch.context() as patch:
        patch.setattr(test_cameras, "add_renderer", add)
        return Studio(furnish_and_keep, kind="depth_camera", grey=0.3).look()


def test_an_image_of_merged_objects_equals_that_of_the_single_objects(monkeypatch: pytest.MonkeyPatch) -> None:
    apart, merged = (look(monkeypatch, merged=merged) for merged in (False, True))
    differ = np.abs(apart["color"].astype(int) - merged["color"]).max(axis=2)
    assert np.ptp(apart["color"]) > 100
    assert (differ > 2).mean() < 1e-3  # the cylinder's outline
    assert np.array_equal(np.isfinite(apart["depth"]), np.isfinite(merged["depth"]))
    hit = np.isfinite(apart["depth"])
    ratio = merged["depth"][hit] / apart["depth"][hit]
    assert (np.abs(ratio - 1.0) > 1e-3).mean() < 1e-3
    assert np.ptp(apart["depth"][hit]) > 3.0


@pytest.mark.parametrize(
    ("faces", "volume"),
    [
        (merging._box(Box(1.0, 2.0, 3.0)), 6.0),
        (merging._cylinder(Cylinder(0.5, 2.0)), 2.0 * 64 * 0.5 * 0.25 * np.sin(2.0 * pi / 64)),
    ],
    ids=["box", "cylinder"],
)
def test_a_shape_is_closed_and_faces_outwards(faces: merging.Faces, volume: float) -> None:
    points, normals, triangles = faces
    a, b, c = (points[triangles[:, corner]] for corner in range(3))
    assert np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0 == pytest.approx(volume)
    normal = np.cross(b - a, c - a)
    assert (np.einsum("ij,ij->i", normal, normals[triangles[:, 0]]) > 0.0).all()
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0)


def diagram(**changes: Any) -> dict[str, Any]:
    mounts = {"front_camera": {"width": 64, "height": 48}}
    return {
        "world": "obstacles",
        "vehicles": {"ego": {"model": "bolt", "mounts": mounts}},
        "control": {"ego": {"kind": "constant", "speed": 0.0}},
        "record": {"cameras": True},
        "sensors": {"ego": ["front_camera"]},
    } | changes


WORLD = """\
mirdrake: world/1
name: obstacles
ground: {surface: asphalt}
props:
  - {box: [0.5, 2.0, 2.0], at: [9, 0], color: [0.8, 0.2, 0.1]}
  - {cylinder: [0.4, 2.0], at: [8, 3], color: [0.1, 0.4, 0.8]}
start: {origin: {at: [0, 0]}}
"""


def test_rays_and_labels_distinguish_merged_objects(tmp_path: Any) -> None:
    path = tmp_path / "obstacles.yaml"
    path.write_text(WORLD, encoding="utf-8")
    mounts = {"front_camera": {"width": 64, "height": 48, "label": True}}
    vehicles = {
        "ego": {"model": "bolt", "mounts": {"front_camera": {"width": 64, "height": 48}}},
        "other": {"model": "bolt", "mounts": mounts, "start": {"x": 0.0, "y": 3.5}},
    }
    spec = diagram(world=str(path), vehicles=vehicles, sensors={"ego": ["front_camera"], "other": ["front_camera"]})
    spec["control"] = {name: {"kind": "constant", "speed": 0.0} for name in vehicles}
    assembly = assemble(spec)
    scene_graph = assembly.parts.scene_graph
    inspector = scene_graph.model_inspector()
    names = [
        inspector.GetName(geometry)
        for geometry in inspector.GetGeometries(inspector.world_frame_id(), Role.kPerception)
    ]
    assert names.count(merging.NAME) == 1
    objects = RayWorld(assembly.parts.plant, scene_graph).objects
    assert {"prop/box", "prop/cylinder"} <= set(objects)
    assert not [item for item in objects if "merged" in item]
    context = assembly.make_context()
    plain, labelled = (assembly.diagram.GetSubsystemByName(f"{name}.front_camera") for name in vehicles)
    shown = labelled.look(context)["label"]
    assert {"prop/box", "prop/cylinder"} <= {labelled.labels[number] for number in np.unique(shown)}
    colors = plain.look(context)["color"].astype(int)
    box = (colors[:, :, 0] > 2 * colors[:, :, 2]).sum()
    assert box > 20  # it sees the red box, in the mesh
    assert colors.shape == (48, 64, 3)


def test_a_single_thing_is_left_alone(tmp_path: Any) -> None:
    path = tmp_path / "obstacles.yaml"
    path.write_text("\n".join(line for line in WORLD.splitlines() if "cylinder" not in line), encoding="utf-8")
    assembly = assemble(diagram(world=str(path)))
    inspector = assembly.parts.scene_graph.model_inspector()
    names = [
        inspector.GetName(geometry)
        for geometry in inspector.GetGeometries(inspector.world_frame_id(), Role.kPerception)
    ]
    assert merging.NAME not in names
    camera = assembly.diagram.GetSubsystemByName("ego.front_camera")
    colors = camera.look(assembly.make_context())["color"].astype(int)
    assert (colors[:, :, 0] > 2 * colors[:, :, 2]).sum() > 20
