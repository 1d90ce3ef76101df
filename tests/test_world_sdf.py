"""SDF worlds: Drake reads the world that was written."""

import io
import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from PIL import Image
from pydrake.geometry import Box, Convex, Cylinder, HalfSpace, Role, SceneGraph, Shape, Sphere
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.systems.framework import DiagramBuilder

from mirdrake.core.errors import WorldError
from mirdrake.plant import obstacles
from mirdrake.worlds import World, load_world, make_world
from mirdrake.worlds.props import DISSIPATION, STIFFNESS
from mirdrake.worlds.sdf_export import SdfExport, export_sdf, model_names

WORLD: dict[str, Any] = {
    "mirdrake": "world/1",
    "name": "corner shop",
    "ground": {
        "mu": 0.7,
        "slope": {"grade": 0.1, "heading": "90 deg"},
        "patches": [{"disc": {"radius": 2}, "mu": 0.2}],
    },
    "tracks": {"lane": {"segments": [{"line": 40}], "mu": 0.9, "start": {"at": [0, -30]}}},
    "props": [
        {"prop": "sedan", "name": "car", "grid": {"step": [6, 9], "count": [2, 1]}, "color": [0.9, 0.1, 0.2]},
        {"prop": "barrel", "at": [10, 20], "yaw": "30 deg"},
        {"prop": "cone", "name": "knocked", "at": [12, 20], "scale": 1.5, "static": False, "mass": 7},
        {"prop": "building", "at": [40, 40], "size": [15, 10, 8], "yaw": "-100 deg"},
        {"prop": "speed_bump", "at": [20, -30]},
        {"box": [1, 2, 3], "name": "car_0", "at": [30, 0, 4], "pitch": "20 deg", "roll": "-10 deg", "yaw": "170 deg"},
        {"sphere": 0.5, "at": [35, 0], "static": False},
        {"cylinder": [0.2, 4], "name": "post", "at": [38, 0]},
    ],
}


def test_relief_is_reported_as_it_does_not_collide() -> None:
    bump = {"bump": {"at": [5, 0], "length": 1, "height": 0.1}}
    (line,) = export_sdf(make_world({"mirdrake": "world/1", "name": "bumpy", "ground": {"relief": [bump]}})).left_out
    assert line == "collision with the relief of the ground (it collides as a plane at z = 0)"


@pytest.fixture(scope="module")
def world() -> World:
    return make_world(WORLD)


@pytest.fixture(scope="module")
def export(world: World) -> SdfExport:
    return export_sdf(world, file="shop.sdf")


@pytest.fixture(scope="module")
def loaded(export: SdfExport, tmp_path_factory: pytest.TempPathFactory) -> tuple[Any, ...]:
    return _load(export, tmp_path_factory.mktemp("sdf"))


def _load(export: SdfExport, folder: Path) -> tuple[Any, ...]:
    for name, content in export.files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 0.001)
    Parser(plant).AddModels(str(folder / next(name for name in export.files if name.endswith(".sdf"))))
    plant.Finalize()
    diagram = builder.Build()
    return plant, scene_graph, diagram, diagram.CreateDefaultContext()


def _solids(plant: MultibodyPlant, scene_graph: SceneGraph, model: str) -> list[tuple[Shape, RigidTransform, Any]]:
    """Shapes, poses X_BG and properties of what a model collides with."""
    body = plant.GetBodyByName("body", plant.GetModelInstanceByName(model))
    inspector = scene_graph.model_inspector()
    return [
        (inspector.GetShape(geometry), inspector.GetPoseInFrame(geometry), inspector.GetProximityProperties(geometry))
        for geometry in plant.GetCollisionGeometriesForBody(body)
    ]


def test_every_prop_is_where_it_was_with_the_solids_it_had(
    world: World, export: SdfExport, loaded: tuple[Any, ...]
) -> None:
    plant, scene_graph, _, context = loaded
    plant_context = plant.GetMyContextFromRoot(context)
    assert plant.num_model_instances() == 2 + 1 + len(world.props)  # Drake's own two, the ground
    for placed in world.props:
        model = export.models[placed.name]
        body = plant.GetBodyByName("body", plant.GetModelInstanceByName(model))
        assert plant.EvalBodyPoseInWorld(plant_context, body).IsNearlyEqualTo(placed.X_WP, 1e-9)
        solids = _solids(plant, scene_graph, model)
        assert len(solids) == len(placed.prop.solids)
        for solid, (shape, X_PS, properties) in zip(placed.prop.solids, solids, strict=True):
            assert type(shape) is type(solid.shape)
            assert X_PS.IsNearlyEqualTo(solid.X_PS, 1e-9)
            np.testing.assert_allclose(_numbers(shape), _numbers(solid.shape), atol=1e-6)
            friction = properties.GetProperty("material", "coulomb_friction")
            assert (friction.static_friction(), friction.dynamic_friction()) == (placed.prop.mu, placed.prop.mu)
            assert properties.GetProperty("material", "hunt_crossley_dissipation") == DISSIPATION
            assert properties.GetProperty("material", "point_contact_stiffness") == STIFFNESS
            assert properties.HasProperty("hydroelastic", "compliance_type") == placed.prop.driven_over


def _numbers(shape: Shape) -> list[float]:
    if isinstance(shape, Box):
        return list(shape.size())
    if isinstance(shape, Cylinder):
        return [shape.radius(), shape.length()]
    if isinstance(shape, Sphere):
        return [shape.radius()]
    assert isinstance(shape, Convex)
    hull = shape.GetConvexHull()
    points = np.array([hull.vertex(i) for i in range(hull.num_vertices())])
    return [float(x) for x in np.concatenate((points.min(axis=0), points.max(axis=0), [hull.centroid()[2]]))]


def test_loose_props_have_their_mass(world: World, export: SdfExport, loaded: tuple[Any, ...]) -> None:
    plant = loaded[0]
    own = MultibodyPlant(0.001)
    scene_graph = SceneGraph()
    own.RegisterAsSourceForSceneGraph(scene_graph)
    bodies = obstacles.add_props(own, world).bodies
    assert set(bodies) == {"knocked", "sphere"}
    for placed in world.props:
        body = plant.GetBodyByName("body", plant.GetModelInstanceByName(export.models[placed.name]))
        assert plant.IsAnchored(body) == placed.static
        if not placed.static:
            expected = bodies[placed.name].default_spatial_inertia()
            np.testing.assert_allclose(
                body.default_spatial_inertia().CopyToFullMatrix6(), expected.CopyToFullMatrix6(), atol=1e-9
            )


def test_the_ground_is_a_box_with_the_friction_of_the_road(world: World, loaded: tuple[Any, ...]) -> None:
    plant, scene_graph, _, _ = loaded
    ((shape, X, properties),) = _solids(plant, scene_graph, "ground")
    assert isinstance(shape, Box)
    assert X.translation()[2] == -shape.size()[2] / 2.0
    for position in np.reshape(world.ground.extent, (2, 2)):
        assert (np.abs(position - X.translation()[:2]) < shape.size()[:2] / 2.0).all()
    assert properties.GetProperty("material", "coulomb_friction").dynamic_friction() == 0.9
    inspector = scene_graph.model_inspector()
    assert not any(isinstance(inspector.GetShape(g), HalfSpace) for g in inspector.GetAllGeometryIds(Role.kProximity))


def test_elements_without_an_sdf_equivalent_are_reported_and_in_a_comment(export: SdfExport) -> None:
    assert export.left_out == (
        "friction 0.7 beside the tracks (the ground has 0.9 everywhere)",
        "friction 0.2 of patch 'patch_0'",
    )
    for line in export.left_out:
        assert f"<!-- left out: {line} -->" in export.files["shop.sdf"].decode()


def test_gravity_tilts_with_the_slope_and_the_sun_shines_down(world: World, export: SdfExport) -> None:
    tree = ElementTree.fromstring(export.files["shop.sdf"]).find("world")
    assert tree is not None
    gravity = [float(x) for x in str(tree.findtext("gravity")).split()]
    np.testing.assert_allclose(gravity, world.ground.gravity, atol=1e-9)
    assert gravity[1] < -0.9
    assert float(str(tree.findtext("light/direction")).split()[2]) < 0.0


def test_the_file_refers_only_to_meshes_beside_it(export: SdfExport) -> None:
    text = export.files["shop.sdf"].decode()
    uris = set(re.findall(r"<uri>(.*?)</uri>", text))
    assert uris == {name for name in export.files if name.endswith(".obj")}
    for name in uris:
        for material in re.findall(r"mtllib (\S+)", export.files[name].decode()):
            assert f"{name.rpartition('/')[0]}/{material}" in export.files


def test_meshes_are_upright_and_have_the_size_of_the_prop(world: World, export: SdfExport) -> None:
    tree = ElementTree.fromstring(export.files["shop.sdf"]).find("world")
    assert tree is not None
    for placed in world.props:
        if placed.prop.visual is None:
            continue
        points = []
        model = tree.find(f"model[@name='{export.models[placed.name]}']")
        assert model is not None
        for mesh in model.iterfind("link/visual/geometry/mesh"):
            content = export.files[str(mesh.findtext("uri"))].decode()
            vertices = re.findall(r"(?m)^v (\S+) (\S+) (\S+)$", content)
            scale = [float(x) for x in str(mesh.findtext("scale")).split()]
            points.append(np.array(vertices, dtype=float) * scale)
            assert content.count("\nvn ") > 3
        size = np.ptp(np.vstack(points), axis=0)
        np.testing.assert_allclose(size, placed.prop.size, atol=0.02 * max(placed.prop.size))
        assert abs(np.vstack(points)[:, 2].min()) < 0.02


def test_a_painted_car_has_its_colour_and_keeps_its_windows(export: SdfExport) -> None:
    tree = ElementTree.fromstring(export.files["shop.sdf"]).find("world")
    assert tree is not None
    paint = [visual.findtext("material/diffuse") for visual in tree.iterfind("model[@name='car_0']/link/visual")]
    assert paint == [None, "0.9 0.1 0.2 1"]
    materials = export.files["meshes/sedan/sedan.mtl"].decode()
    assert len(set(re.findall(r"Kd .*", materials))) > 5


def test_names_are_plain_and_all_different() -> None:
    given = ["a[1]", "a_1", "a.1", "block[2].building[0]", "_x", "ground", "9 lives", "", "ü"]
    names = model_names(given, taken={"ground"})
    assert len(set(names)) == len(given)
    assert "ground" not in names
    assert names[3] == "block_2_building_0"
    assert all(re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name) and "__" not in name for name in names)


def test_the_contact_is_that_of_the_plant(world: World) -> None:
    own = MultibodyPlant(0.001)
    scene_graph = SceneGraph()
    own.RegisterAsSourceForSceneGraph(scene_graph)
    owners = obstacles.add_props(own, world).owners
    assert set(owners.values()) == {placed.name for placed in world.props}
    for geometry in owners:
        properties = scene_graph.model_inspector().GetProximityProperties(geometry)
        assert properties.GetProperty("material", "point_contact_stiffness") == STIFFNESS
        assert properties.GetProperty("material", "hunt_crossley_dissipation") == DISSIPATION


def test_the_test_track_is_seen(tmp_path: Path) -> None:
    export = export_sdf(load_world("test_track"))
    _, scene_graph, _, _ = _load(export, tmp_path)
    inspector = scene_graph.model_inspector()
    assert inspector.NumGeometriesWithRole(Role.kIllustration) == 4  # ground, road, its edges, paint
    road, edges = (
        np.array(
            re.findall(r"(?m)^v (\S+) (\S+) (\S+)$", export.files[f"meshes/scenery/{name}.obj"].decode()), dtype=float
        )
        for name in ("world_main_road", "world_edges")
    )
    assert np.ptp(road[:, 2]) == road[:, 2].max() == 0.0
    assert (edges[:, 2].min(), edges[:, 2].max()) == (-0.01, 0.0)
    assert np.ptp(road[:, 0]) == pytest.approx(266.2, abs=1.0)


def test_a_textured_mesh_keeps_its_picture(tmp_path: Path) -> None:
    box = trimesh.creation.box(extents=[1.0, 2.0, 3.0])
    picture = Image.new("RGB", (4, 4), (200, 30, 30))
    material = trimesh.visual.material.PBRMaterial(baseColorTexture=picture, name="print")
    box.visual = trimesh.visual.TextureVisuals(uv=box.vertices[:, :2], material=material)
    for name, content in trimesh.Scene(box).export(file_type="gltf").items():
        (tmp_path / name.replace("model.gltf", "crate.gltf")).write_bytes(content)
    path = tmp_path / "w.yaml"
    path.write_text("mirdrake: world/1\nprops: [{file: crate.gltf, at: [1, 2]}]\n", encoding="utf-8")
    export = export_sdf(load_world(str(path)))
    assert "map_Kd crate_0.png" in export.files["meshes/crate/crate.mtl"].decode()
    back = Image.open(io.BytesIO(export.files["meshes/crate/crate_0.png"]))
    assert back.getpixel((0, 0)) == (200, 30, 30)
    (tmp_path / "out").mkdir()
    _load(export, tmp_path / "out")


def test_a_missing_mesh_is_an_error_of_one_line(tmp_path: Path) -> None:
    mesh = tmp_path / "rock.obj"
    mesh.write_text(trimesh.creation.box().export(file_type="obj", include_texture=False), encoding="utf-8")
    path = tmp_path / "w.yaml"
    path.write_text("mirdrake: world/1\nprops: [{file: rock.obj, at: [1, 2]}]\n", encoding="utf-8")
    world = load_world(str(path))
    mesh.unlink()
    with pytest.raises(WorldError, match=r"^rock\.obj: cannot be read: No such file or directory$"):
        export_sdf(world)
