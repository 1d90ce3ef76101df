"""Converted meshes have the pose and colours of Gazebo, and collision geometry."""

import base64
import json
import struct
import subprocess
import sys
from itertools import pairwise
from time import monotonic

import numpy as np
import pytest
import trimesh
from PIL import Image
from pydrake.geometry import Box, Convex, MeshcatVisualizer
from pydrake.geometry import Mesh as DrakeMesh
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

from mirdrake.core.errors import MissingDependencyError
from mirdrake.core.paths import cache_folder
from mirdrake.importing.meshes.convert import MeshError, convert_collision, convert_visual, mesh_bounds
from mirdrake.importing.meshes.convex import CutTime, make_hull
from mirdrake.importing.shape import Shape
from mirdrake.viewer.private_meshcat import make_private_meshcat
from tests.mesh_rigs import CORNERS, QUADS, TEXTURED, add_eye, box, flat, write_dae, write_stl


def mesh(path, **values):
    return Shape("mesh", mesh=path, address=f"package://car/meshes/{path.name}", where="car.urdf:7", **values)


def converted(shape, folder, name="part"):
    shape, changes = convert_visual(shape, folder, name=name)
    document = json.loads((folder / shape.address).read_text())
    return shape, changes, document


def gltf_bounds(shape):
    """In Drake's axes: z up."""
    low, high = trimesh.load_scene(shape.mesh).bounds
    return np.array([[low[0], -high[2], low[1]], [high[0], -low[2], high[1]]]).round(6)


@pytest.fixture(scope="module")
def look():
    """Renders glTF shapes: (shapes, eye, target) -> picture."""

    def take(shapes, eye=(3.0, -2.5, 2.5), target=(0.5, 0.5, 0.5)):
        builder = DiagramBuilder()
        plant, scene = AddMultibodyPlantSceneGraph(builder, 0.01)
        for k, shape in enumerate(shapes):
            drake = DrakeMesh(str(shape.mesh)) if shape.kind == "mesh" else Box(*shape.size)
            plant.RegisterVisualGeometry(plant.world_body(), shape.X_LG, drake, f"s{k}", [1, 1, 1, 1])
        plant.Finalize()
        picture = add_eye(builder, plant, scene, eye, target)
        diagram = builder.Build()
        return picture(diagram.CreateDefaultContext())

    return take


def share(picture, which):
    return float(which(*np.moveaxis(picture, 2, 0)).mean())


def red(r, g, b):
    return (r > 60) & (r > 2 * g + 20) & (r > 2 * b + 20)


def green(r, g, b):
    return (g > 60) & (g > 2 * r + 20) & (g > 2 * b + 20)


def blue(r, g, b):
    return (b > 60) & (b > 2 * r + 20) & (b > 2 * g + 20)


def test_a_primitive_turned_by_45_degrees_has_the_bounds_of_its_turned_edges():
    turn = RigidTransform(RollPitchYaw(0, 0, np.pi / 4), [1, 0, 0])
    low, high = mesh_bounds(Shape("box", (2.0, 2.0, 1.0), turn))
    assert high == pytest.approx([1 + 2**0.5, 2**0.5, 0.5])
    assert low == pytest.approx([1 - 2**0.5, -(2**0.5), -0.5])


def test_a_wheel_lying_across_has_its_radius_along_x_and_z():
    across = RigidTransform(RollPitchYaw(np.pi / 2, 0, 0), [0, 0, 0.3])
    low, high = mesh_bounds(Shape("cylinder", (0.3, 0.2), across))
    assert low == pytest.approx([-0.3, -0.1, 0.0], abs=1e-12)
    assert high == pytest.approx([0.3, 0.1, 0.6])
    assert mesh_bounds(Shape("sphere", (0.3,)))[1] == pytest.approx([0.3] * 3)
    assert mesh_bounds(Shape("capsule", (0.1, 0.4)))[1] == pytest.approx([0.1, 0.1, 0.3])
    assert mesh_bounds(Shape("ellipsoid", (0.1, 0.2, 0.3), across))[1] == pytest.approx([0.1, 0.3, 0.5])
    assert np.isinf(mesh_bounds(Shape("plane"))[1]).all()


def test_unit_and_nodes_of_collada_are_applied_and_its_up_axis_is_not(tmp_path):
    for up in ("Z_UP", "Y_UP", "X_UP"):
        path = write_dae(tmp_path / f"{up}.dae", unit="0.01", up=up, matrix="<translate>0 0 100</translate>")
        low, high = mesh_bounds(mesh(path, scale=(2.0, 2.0, 2.0)))
        assert low == pytest.approx([0.0, 0.0, 2.0])  # 100 of 0.01 m, twice as large
        assert high == pytest.approx([0.02, 0.02, 2.02])
        shape, changes, _ = converted(mesh(path, scale=(2.0, 2.0, 2.0)), tmp_path, up)
        assert gltf_bounds(shape) == pytest.approx(np.array([low, high]))
        expected = [change.old for change in changes]
        assert "unit of 0.01 m" in expected
        assert (f"up axis {up}" in expected) == (up != "Z_UP")


def test_nodes_turn_stretch_and_repeat_geometry(tmp_path):
    rotate = "<rotate>0 0 1 90</rotate><scale>2 1 1</scale>"
    again = '<node><translate>5 0 0</translate><instance_geometry url="#cube"/></node>'
    low, high = mesh_bounds(mesh(write_dae(tmp_path / "n.dae", matrix=rotate + again)))
    # x of 2 turned to y; the second one 5 along the stretched, turned x
    assert low == pytest.approx([-1, 0, 0], abs=1e-6)  # pycollada turns in single precision
    assert high == pytest.approx([0, 12, 1], abs=1e-5)


@pytest.mark.parametrize("name", ["part.stl", "PART.STL"])
def test_binary_stl_in_millimetres_is_a_thousandth_by_its_scale(tmp_path, name):
    path = write_stl(tmp_path / name, box((0, 0, 0), (300, 200, 100)))
    shape = mesh(path, scale=(1e-3, 1e-3, 1e-3), X_LG=RigidTransform([1, 0, 0]))
    low, high = mesh_bounds(shape)
    assert low == pytest.approx([1.0, 0, 0])
    assert high == pytest.approx([1.3, 0.2, 0.1])
    written, changes, document = converted(shape, tmp_path)
    assert changes == []
    assert written.scale == (1, 1, 1)
    assert written.address == "meshes/part.gltf"
    assert document["materials"][0]["pbrMetallicRoughness"]["baseColorFactor"][:3] == pytest.approx(
        [0.448] * 3, abs=1e-3
    )
    assert written.X_LG.translation() == pytest.approx([1, 0, 0])
    assert gltf_bounds(written)[1] == pytest.approx([0.3, 0.2, 0.1])


def test_ascii_stl_and_its_colour_from_the_link(tmp_path):
    facets = "".join(
        "facet normal 0 0 0\nouter loop\n" + "".join(f"vertex {x} {y} {z}\n" for x, y, z in t) + "endloop\nendfacet\n"
        for t in box((0, 0, 0), (1, 2, 3))
    )
    path = tmp_path / "a.stl"
    path.write_text(f"solid a\n{facets}endsolid a\n")
    written, _, document = converted(mesh(path, rgba=(1.0, 0.5, 0.0, 1.0)), tmp_path)
    assert gltf_bounds(written)[1] == pytest.approx([1, 2, 3])
    # sRGB 0.5 is 0.2140 of light
    assert document["materials"][0]["pbrMetallicRoughness"]["baseColorFactor"] == pytest.approx([1, 0.21404, 0, 1])
    assert written.rgba is None


def test_obj_takes_colours_and_textures_from_its_mtl_although_case_differs(tmp_path):
    Image.new("RGB", (4, 4), (0, 255, 0)).save(tmp_path / "Grass.PNG")
    (tmp_path / "c.mtl").write_text("newmtl a\nKd 1 0 0\nnewmtl b\nKd 1 1 1\nmap_Kd textures\\grass.png\n")
    lines = [f"v {x} {y} {z}" for x, y, z in CORNERS] + ["vt 0 0", "vt 1 0", "vt 1 1", "vt 0 1"]
    faces = ["f " + " ".join(f"{v + 1}/{k + 1}" for k, v in enumerate(quad)) for quad in QUADS]
    (tmp_path / "c.OBJ").write_text("\n".join(["mtllib c.mtl", *lines, "usemtl a", *faces[:5], "usemtl b", faces[5]]))
    written, changes, document = converted(mesh(tmp_path / "c.OBJ"), tmp_path)
    assert changes == []
    factors = {m["name"]: m["pbrMetallicRoughness"] for m in document["materials"]}
    assert factors["a"]["baseColorFactor"] == [1, 0, 0, 1]
    assert "baseColorTexture" in factors["b"]
    with Image.open(tmp_path / "meshes" / document["images"][0]["uri"]) as picture:
        assert picture.getpixel((0, 0)) == (0, 255, 0)
    assert gltf_bounds(written)[1] == pytest.approx([1, 1, 1])


def test_ply_and_glb_are_read_along_the_axes_of_the_file(tmp_path):
    solid = trimesh.Trimesh(box((0, 0, 0), (1, 2, 3)).reshape(-1, 3), np.arange(36).reshape(-1, 3), process=False)
    for kind in ("ply", "glb", "gltf"):
        path = tmp_path / f"solid.{kind}"
        if kind == "gltf":
            for name, content in trimesh.exchange.gltf.export_gltf(solid.scene()).items():
                (tmp_path / (path.name if name == "model.gltf" else name)).write_bytes(content)
        else:
            path.write_bytes(solid.export(file_type=kind))
        assert mesh_bounds(mesh(path))[1] == pytest.approx([1, 2, 3])
        written, changes, _ = converted(mesh(path), tmp_path, kind)
        assert gltf_bounds(written)[1] == pytest.approx([1, 2, 3])
        assert any("do not rotate glTF" in change.reason for change in changes) == (kind != "ply")


def test_a_mirrored_mesh_keeps_its_outside(tmp_path):
    path = write_stl(tmp_path / "m.stl", box((0, 0, 0), (1, 2, 3)))
    written, changes, _ = converted(mesh(path, scale=(1.0, -1.0, 1.0)), tmp_path)
    mirrored = trimesh.load_mesh(written.mesh, merge_primitives=True)
    mirrored.merge_vertices(merge_norm=True)
    assert mirrored.volume == pytest.approx(6.0)
    assert gltf_bounds(written).tolist() == [[0, -2, 0], [1, 0, 3]]
    assert [change.new for change in changes] == ["mirrored, outside kept outside"]
    outward = mirrored.vertex_normals @ np.eye(3)
    assert ((mirrored.vertices - mirrored.vertices.mean(axis=0)) * outward).sum(axis=1).min() > 0
    (solid,), _ = convert_collision(mesh(path, scale=(1.0, -1.0, 1.0)), tmp_path, name="c")
    assert solid.kind == "box"
    assert solid.X_LG.translation() == pytest.approx([0.5, -1.0, 1.5])


def test_a_submesh_is_chosen_by_the_name_of_its_node_and_can_be_centred(tmp_path):
    other = '</node><node name="wheel"><translate>9 0 0</translate><instance_geometry url="#cube"/>'
    path = write_dae(tmp_path / "two.dae", matrix=f'<instance_geometry url="#cube"/>{other}')
    assert mesh_bounds(mesh(path, submesh="wheel"))[0] == pytest.approx([9, 0, 0])
    assert mesh_bounds(mesh(path))[1] == pytest.approx([10, 1, 1])
    centred = mesh(path, submesh="wheel", scale=(2.0, 2.0, 2.0))
    centred.center = True
    assert mesh_bounds(centred)[1] == pytest.approx([1, 1, 1])
    with pytest.raises(MeshError, match=r"two\.dae: has no submesh 'whee': did you mean 'wheel'"):
        mesh_bounds(mesh(path, submesh="whee"))


def transparent(mode, color, factor):
    return (
        f'<transparent opaque="{mode}"><color>{color}</color></transparent>'
        f"<transparency><float>{factor}</float></transparency>"
    )


@pytest.mark.parametrize(
    ("written", "opacity"),
    [
        ("", 1.0),
        ("<transparent><color>1 1 1 0</color></transparent>", 1.0),  # Gazebo looks for the attribute first
        (transparent("A_ONE", "1 1 1 1", "0.4"), 0.4),
        (transparent("A_ONE", "1 1 1 0.5", "1"), 0.5),
        (transparent("RGB_ZERO", "0.5 0.5 0.5 1", "1"), 0.5),
        (transparent("RGB_ZERO", "0 0 0 1", "1"), 1.0),
        (transparent("A_ONE", "1 1 1 1", "0"), 1.0),
    ],
)
def test_opacity_of_collada_is_that_of_gazebo_and_never_zero(tmp_path, written, opacity):
    path = write_dae(tmp_path / "t.dae", transparent=written)
    _, changes, document = converted(mesh(path), tmp_path)
    material = document["materials"][0]
    assert material["pbrMetallicRoughness"]["baseColorFactor"][3] == pytest.approx(opacity, abs=1e-4)
    assert material.get("alphaMode", "OPAQUE") == ("BLEND" if opacity < 1 else "OPAQUE")
    assert any("wrong way round" in change.reason for change in changes) == ("<float>0</float>" in written)


@pytest.mark.parametrize(
    "picture", ["pic.png", "../materials/textures/PIC.PNG", "file:///C:\\work\\pic.png", "./p%69c.png"]
)
def test_textures_are_found_although_the_path_is_of_another_machine(tmp_path, picture):
    Image.new("RGBA", (2, 2), (0, 0, 255, 0)).save(tmp_path / "Pic.png")
    path = write_dae(tmp_path / "t.dae", looks=[("skin", TEXTURED)], picture=picture)
    _, changes, document = converted(mesh(path), tmp_path)
    assert changes == []
    assert document["images"] == [{"uri": "part_0.png"}]
    with Image.open(tmp_path / "meshes/part_0.png") as written:
        assert written.mode == "RGB"  # its alpha is not used: opaque


def test_a_missing_texture_becomes_grey_and_is_reported(tmp_path):
    path = write_dae(tmp_path / "t.dae", looks=[("skin", TEXTURED)], picture="gone.png")
    _, (change,), document = converted(mesh(path), tmp_path)
    assert "images" not in document
    assert (change.place, change.old, change.new) == ("car.urdf:7", "texture gone.png", None)
    assert change.part == "visual mesh package://car/meshes/t.dae"


def test_the_same_mesh_gives_the_same_bytes(tmp_path):
    Image.radial_gradient("L").save(tmp_path / "pic.png")
    path = write_dae(tmp_path / "t.dae", looks=[("skin", TEXTURED), ("paint", flat(1, 0, 0))])
    corner = write_stl(tmp_path / "l.stl", np.concatenate((corner_solid(),)))
    for turn in ("a", "b"):
        convert_visual(mesh(path), tmp_path / turn, name="v")
        convert_collision(mesh(corner), tmp_path / turn, name="c")
    files = sorted(p.name for p in (tmp_path / "a/meshes").iterdir())
    assert files == ["c_0.obj", "c_1.obj", "v.bin", "v.gltf", "v_0.png"]
    for name in files:
        assert (tmp_path / "a/meshes" / name).read_bytes() == (tmp_path / "b/meshes" / name).read_bytes()


def test_broken_triangles_are_left_out_and_counted(tmp_path):
    triangles = box((0, 0, 0), (1, 1, 1))
    broken = np.concatenate((triangles, np.full((2, 3, 3), np.nan), np.zeros((5, 3, 3))))
    path = write_stl(tmp_path / "b.stl", broken)
    written, (change,), _ = converted(mesh(path), tmp_path)
    assert (change.old, change.new) == ("19 triangles", "17 triangles")
    assert gltf_bounds(written)[1] == pytest.approx([1, 1, 1])


LINES = '<lines count="1"><input semantic="VERTEX" source="#v" offset="0"/><p>0 1</p></lines>'


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        ("gone.stl", None, "does not exist"),
        ("empty.stl", b"", "is an empty file"),
        ("none.stl", b" " * 80 + struct.pack("<I", 0), "has no triangle"),
        ("half.dae", b"<COLLADA><asset>", "cannot be read as DAE"),
        ("noise.stl", b"\x01\x02\x03" * 10, "has no triangle"),
        ("pointer.dae", b"version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 9\n", "git lfs pull"),
        ("tree.blend", b"BLENDER", "has an unknown format"),
        ("points.obj", b"v 0 0 0\nv 1 0 0\nl 1 2\n", "points.obj"),
    ],
)
def test_an_unusable_mesh_is_rejected_with_its_name_and_the_reason(tmp_path, name, content, reason):
    if content is not None:
        (tmp_path / name).write_bytes(content)
    for call in (
        mesh_bounds,
        lambda s: convert_visual(s, tmp_path, name="n"),
        lambda s: convert_collision(s, tmp_path, name="n"),
    ):
        with pytest.raises(MeshError, match=reason) as caught:
            call(mesh(tmp_path / name))
        assert name in str(caught.value)
        assert "\n" not in str(caught.value)
    change = caught.value.left_out("car.urdf:7", "visual of link 'a'")
    assert change.left_out
    assert not (tmp_path / "meshes").exists()


def test_unknown_addresses_and_scales_of_zero_are_rejected(tmp_path):
    with pytest.raises(MeshError, match=r"package://no/x\.dae: leads to no file"):
        mesh_bounds(Shape("mesh", address="package://no/x.dae"))
    path = write_stl(tmp_path / "s.stl", box((0, 0, 0), (1, 1, 1)))
    with pytest.raises(MeshError, match="scale 1 0 1 leaves nothing"):
        convert_visual(mesh(path, scale=(1.0, 0.0, 1.0)), tmp_path, name="n")


def test_lines_are_ignored_beside_triangles_and_rejected_alone(tmp_path):
    assert mesh_bounds(mesh(write_dae(tmp_path / "a.dae", extra=LINES)))[1] == pytest.approx([1, 1, 1])
    text = write_dae(tmp_path / "b.dae", extra=LINES).read_text()
    start, end = text.index("<polylist"), text.index("</polylist>") + len("</polylist>")
    (tmp_path / "b.dae").write_text(text[:start] + text[end:])
    with pytest.raises(MeshError, match="has no triangle"):
        mesh_bounds(mesh(tmp_path / "b.dae"))


def test_without_pycollada_the_error_names_what_to_install_and_stl_still_works(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "collada", None)
    with pytest.raises(MissingDependencyError, match=r"pip install 'mirdrake\[import\]'"):
        mesh_bounds(mesh(write_dae(tmp_path / "c.dae")))
    assert mesh_bounds(mesh(write_stl(tmp_path / "s.stl", box((0, 0, 0), (1, 1, 1)))))[1] == pytest.approx([1, 1, 1])


def corner_solid(width=0.5):
    """Return an L from above: 2 along x and 3 along y, 0.5 wide and high; 1.125 m³, and its hull 2.0625 m³."""
    outline = np.array([(0, 0), (2, 0), (2, width), (width, width), (width, 3), (0, 3)])
    floor = [(0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 5)]
    low, high = np.c_[outline, np.zeros(6)], np.c_[outline, np.full(6, 0.5)]
    triangles = [high[list(t)] for t in floor] + [low[list(t[::-1])] for t in floor]
    for a, b in pairwise([*range(6), 0]):
        triangles += [np.array([low[a], low[b], high[b]]), np.array([low[a], high[b], high[a]])]
    return np.array(triangles)


def parts_volume(shapes):
    return [trimesh.load_mesh(shape.mesh).volume for shape in shapes]


def test_an_l_shape_becomes_two_convex_parts(tmp_path):
    pytest.importorskip("coacd")
    path = write_stl(tmp_path / "l.stl", corner_solid())
    shapes, (change,) = convert_collision(mesh(path, X_LG=RigidTransform([0, 0, 1])), tmp_path, name="l")
    assert [shape.address for shape in shapes] == ["meshes/l_0.obj", "meshes/l_1.obj"]
    assert sum(parts_volume(shapes)) == pytest.approx(1.125, rel=0.02)
    assert change.new_text.startswith("2 convex parts (")
    assert all(shape.X_LG.translation()[2] == 1 for shape in shapes)
    for shape, volume in zip(shapes, parts_volume(shapes), strict=True):  # as Drake sees them
        hull = Convex(str(shape.mesh)).GetConvexHull()
        assert hull.num_faces() >= 4
        assert volume > 0.3


def test_without_coacd_the_l_becomes_its_hull_and_the_report_states_the_added_volume(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "coacd", None)
    path = write_stl(tmp_path / "l.stl", corner_solid())
    (shape,), (change,) = convert_collision(mesh(path), tmp_path, name="l")
    assert parts_volume([shape]) == [pytest.approx(2.0625, rel=1e-5)]
    assert change.new == "its convex hull (+83 % volume)"  # 2.0625 / 1.125 = 1.833
    assert "coacd is not installed" in change.reason


def test_holes_are_closed_before_the_decomposition_and_a_surface_with_gaps_becomes_its_hull(tmp_path):
    pytest.importorskip("coacd")
    open_end = corner_solid()[1:]  # without a triangle of its upper side
    shapes, (change,) = convert_collision(mesh(write_stl(tmp_path / "o.stl", open_end)), tmp_path, name="o")
    assert sum(parts_volume(shapes)) == pytest.approx(1.125, rel=0.02)
    assert "it is not closed" in change.new_text
    fin = np.array([[[0.5, 0.5, 0], [0.5, 0.5, 0.5], [1.5, 1.5, 0.5]]])  # three triangles meet at an edge
    path = write_stl(tmp_path / "f.stl", np.concatenate((corner_solid(), fin)))
    (hull,), (change,) = convert_collision(mesh(path), tmp_path, name="f")
    assert parts_volume([hull])[0] > 2.06
    assert "gaps" in change.reason


@pytest.mark.parametrize("end", [-9, "late"])
def test_a_surface_becomes_its_hull_at_the_time_limit(tmp_path, monkeypatch, end):
    def run(command, **_):
        if end == "late":
            raise subprocess.TimeoutExpired(command, 200)
        return subprocess.CompletedProcess(command, end, b"", b"")

    monkeypatch.setattr("mirdrake.importing.meshes.convex.find_spec", lambda name: name)
    monkeypatch.setattr(subprocess, "run", run)
    (hull,), (change,) = convert_collision(mesh(write_stl(tmp_path / "l.stl", corner_solid())), tmp_path, name="l")
    assert parts_volume([hull]) == [pytest.approx(2.0625, rel=1e-5)]
    assert "too long" in change.reason or "the time for convex decomposition" in change.reason


def test_separate_convex_bodies_become_one_part_each(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "coacd", None)
    legs = [box((x, y, 0), (x + 0.1, y + 0.1, 0.99)) for x in (0, 0.9) for y in (0, 0.9)]
    path = write_stl(tmp_path / "t.stl", np.concatenate([box((0, 0, 1), (1, 1, 1.1)), *legs]))
    shapes, (change,) = convert_collision(mesh(path), tmp_path, name="t")
    assert sorted(parts_volume(shapes)) == pytest.approx([0.0099] * 4 + [0.1], rel=1e-4)
    assert change.new == "5 convex parts (+0 % volume)"


def test_a_box_and_a_wheel_as_meshes_become_primitives_where_they_were(tmp_path):
    turn = RigidTransform(RollPitchYaw(0, 0, 0.3), [1, 2, 3])
    path = write_stl(tmp_path / "b.stl", box((0, 0, 0), (1000, 2000, 3000)))
    (solid,), (change,) = convert_collision(mesh(path, scale=(1e-3,) * 3, X_LG=turn), tmp_path, name="b")
    assert solid.kind == "box"
    assert solid.size == pytest.approx((1, 2, 3))
    assert solid.X_LG.translation() == pytest.approx(turn.multiply([0.5, 1.0, 1.5]))
    assert change.new == "box 1 x 2 x 3 m"
    wheel = trimesh.creation.cylinder(
        0.3, 0.2, sections=24, transform=RigidTransform(RollPitchYaw(np.pi / 2, 0, 0), [0, 0.5, 0]).GetAsMatrix4()
    )
    path = write_stl(tmp_path / "w.stl", wheel.triangles)
    (solid,), (change,) = convert_collision(mesh(path), tmp_path, name="w")
    assert solid.kind == "cylinder"
    assert solid.size == pytest.approx((0.3, 0.2), rel=1e-5)
    assert solid.X_LG.translation() == pytest.approx([0, 0.5, 0], abs=1e-6)
    assert abs(solid.X_LG.rotation().matrix()[1, 2]) == pytest.approx(1.0)
    assert change.reason == "it fills 99 % of it"  # 24 sides: 24 sin(15°) / 2 pi = 0.989


def test_a_convex_mesh_becomes_one_part_and_a_flat_one_a_plate(tmp_path):
    ball = trimesh.creation.icosphere(subdivisions=4)
    (part,), (change,) = convert_collision(mesh(write_stl(tmp_path / "s.stl", ball.triangles)), tmp_path, name="s")
    solid = trimesh.load_mesh(part.mesh)
    assert len(solid.vertices) <= 134
    assert solid.volume == pytest.approx(ball.volume, rel=0.08)
    assert change.new_text.startswith("its convex hull (-")
    sheet = np.array([[[0, 0, 0], [1, 0, 0], [1, 1, 0]], [[0, 0, 0], [1, 1, 0], [0, 1, 0]]], dtype=float)
    (plate,), _ = convert_collision(mesh(write_stl(tmp_path / "p.stl", sheet)), tmp_path, name="p")
    assert plate.kind == "box"
    assert sorted(plate.size) == pytest.approx([0.001, 1.0, 1.0], rel=1e-3)


def test_primitives_are_unchanged(tmp_path):
    shape = Shape("box", (1.0, 1.0, 1.0))
    assert convert_visual(shape, tmp_path, name="n") == (shape, [])
    assert convert_collision(shape, tmp_path, name="n") == ([shape], [])
    assert list(tmp_path.iterdir()) == []


def test_more_triangles_than_can_be_drawn_are_simplified(tmp_path, monkeypatch):
    pytest.importorskip("fast_simplification")
    monkeypatch.setattr("mirdrake.importing.meshes.write.FACE_LIMIT", 1000)
    ball = trimesh.creation.icosphere(subdivisions=4)
    path = write_stl(tmp_path / "s.stl", ball.triangles)
    written, (change,), _ = converted(mesh(path), tmp_path)
    assert change.old == "5120 triangles"
    assert int(change.new.split()[0]) <= 1000
    assert gltf_bounds(written) == pytest.approx(np.array([[-1] * 3, [1] * 3]), abs=0.03)
    monkeypatch.setitem(sys.modules, "fast_simplification", None)
    _, (change,), _ = converted(mesh(path), tmp_path, "again")
    assert "is not installed" in change.reason


def test_the_camera_sees_texture_colours_and_place(tmp_path, look):
    """Red and blue halves of a picture on the sides, green paint on top; beside it nothing."""
    picture = Image.new("RGB", (8, 8), (255, 0, 0))
    picture.paste((0, 0, 255), (0, 4, 8, 8))
    picture.save(tmp_path / "pic.png")
    path = write_dae(tmp_path / "t.dae", looks=[("skin", TEXTURED), ("paint", flat(0, 1, 0))])
    shape, _, _ = converted(mesh(path), tmp_path)
    image = look([shape])
    Image.fromarray(image.astype(np.uint8)).save(tmp_path / "seen.png")
    assert share(image, green) > 0.02
    assert share(image, red) > 0.015
    assert share(image, blue) > 0.015
    assert share(image, lambda r, g, b: r + g + b == 0) > 0.5


def test_the_camera_sees_vertex_colours_and_the_outside_of_mirrored_meshes(tmp_path, look):
    solid = trimesh.Trimesh(box((0, 0, 0), (1, 1, 1)).reshape(-1, 3), np.arange(36).reshape(-1, 3), process=False)
    solid.visual.vertex_colors = np.tile([0, 0, 255, 255], (36, 1)).astype(np.uint8)
    (tmp_path / "v.ply").write_bytes(solid.export(file_type="ply"))
    tinted, _, document = converted(mesh(tmp_path / "v.ply"), tmp_path, "v")
    assert "COLOR_0" in document["meshes"][0]["primitives"][0]["attributes"]
    path = write_stl(tmp_path / "m.stl", box((0, 0, 0), (1, 1, 1)))
    pose = RigidTransform([0, 3, 0])
    mirrored, _, _ = converted(mesh(path, scale=(1.0, -1.0, 1.0), rgba=(1.0, 0.0, 0.0, 1.0), X_LG=pose), tmp_path, "m")
    picture = look([tinted, mirrored], eye=(5.0, -3.0, 3.5), target=(0.5, 1.5, 0.5))
    Image.fromarray(picture.astype(np.uint8)).save(tmp_path / "seen.png")
    assert share(picture, blue) > 0.02
    assert share(picture, red) > 0.01


def test_meshcat_takes_the_gltf_with_its_texture(tmp_path):
    Image.new("RGB", (8, 8), (255, 0, 0)).save(tmp_path / "pic.png")
    shape, _, _ = converted(mesh(write_dae(tmp_path / "t.dae", looks=[("skin", TEXTURED)])), tmp_path)
    meshcat, _ = make_private_meshcat()
    builder = DiagramBuilder()
    plant, scene = AddMultibodyPlantSceneGraph(builder, 0.01)
    plant.RegisterVisualGeometry(plant.world_body(), RigidTransform(), DrakeMesh(str(shape.mesh)), "s", [1, 1, 1, 1])
    plant.Finalize()
    MeshcatVisualizer.AddToBuilder(builder, scene, meshcat)
    diagram = builder.Build()
    diagram.ForcedPublish(diagram.CreateDefaultContext())
    page = meshcat.StaticHtml()
    assert base64.b64encode((tmp_path / "meshes/part_0.png").read_bytes()).decode() in page or "part_0.png" in page


# --- winding -----------------------------------------------------------------------------------------------------


def random_map(rng):
    """Return an affine map with a random sign of its determinant."""
    frame, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    matrix = np.eye(4)
    matrix[:3, :3] = frame @ np.diag(rng.uniform(0.5, 2.0, 3) * rng.choice([-1.0, 1.0], 3)) @ frame.T
    matrix[:3, 3] = rng.normal(size=3)
    return matrix


def faces_of_a_cube(rng, wrong):
    """Return corners (12, 3, 3) and normals (12, 3); a share of the triangles is wound against its normals."""
    triangles = box((0, 0, 0), (1, 2, 3))
    cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    against = rng.random(12) < wrong
    triangles[against] = triangles[against][:, ::-1]
    return triangles, cross / np.linalg.norm(cross, axis=1)[:, None]


def as_obj(path, triangles, normals, matrix):
    """The map is in the coordinates; normals go with its inverse transpose."""
    triangles = triangles @ matrix[:3, :3].T + matrix[:3, 3]
    normals = normals @ np.linalg.inv(matrix[:3, :3])
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in triangles.reshape(-1, 3)]
    lines += [f"vn {x:.9g} {y:.9g} {z:.9g}" for x, y, z in normals]
    lines += [f"f {3 * k + 1}//{k + 1} {3 * k + 2}//{k + 1} {3 * k + 3}//{k + 1}" for k in range(len(triangles))]
    path.write_text("\n".join(lines))


def as_dae(path, triangles, normals, matrix):
    """Return the map is that of a node."""

    def source(name, rows):
        values = " ".join(f"{value:.9g}" for value in rows.ravel())
        axes = "".join(f'<param name="{axis}" type="float"/>' for axis in "XYZ")
        return (
            f'<source id="{name}"><float_array id="{name}a" count="{rows.size}">{values}</float_array>'
            f'<technique_common><accessor source="#{name}a" count="{len(rows)}" stride="3">{axes}</accessor>'
            "</technique_common></source>"
        )

    index = " ".join(f"{3 * k + corner} {k}" for k in range(len(triangles)) for corner in range(3))
    path.write_text(
        '<?xml version="1.0"?><COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1"><asset/>'
        f'<library_geometries><geometry id="g"><mesh>{source("p", triangles.reshape(-1, 3))}{source("n", normals)}'
        '<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>'
        f'<triangles count="{len(triangles)}"><input semantic="VERTEX" source="#v" offset="0"/>'
        f'<input semantic="NORMAL" source="#n" offset="1"/><p>{index}</p></triangles></mesh></geometry>'
        '</library_geometries><library_visual_scenes><visual_scene id="s"><node>'
        f'<matrix>{" ".join(f"{value:.9g}" for value in matrix.ravel())}</matrix><instance_geometry url="#g"/></node>'
        '</visual_scene></library_visual_scenes><scene><instance_visual_scene url="#s"/></scene></COLLADA>'
    )


def as_glb(path, triangles, normals, matrix):
    """The map is that of a node."""
    solid = trimesh.Trimesh(
        triangles.reshape(-1, 3), np.arange(36).reshape(-1, 3), vertex_normals=np.repeat(normals, 3, axis=0),
        process=False,
    )  # fmt: skip
    scene = trimesh.Scene()
    scene.add_geometry(solid, transform=matrix)
    path.write_bytes(scene.export(file_type="glb", include_normals=True))


def against_normals(written):
    """Return the share of the area of a glTF that is wound against its normals, and its volume."""
    document = json.loads(written.mesh.read_text())
    blob = written.mesh.with_suffix(".bin").read_bytes()

    def array(number):
        accessor = document["accessors"][number]
        kind, width = ("<u4", 1) if accessor["type"] == "SCALAR" else ("<f4", int(accessor["type"][-1]))
        start = document["bufferViews"][accessor["bufferView"]]["byteOffset"]
        return np.frombuffer(blob, kind, accessor["count"] * width, start).reshape(-1, width)

    wrong = total = volume = 0.0
    for primitive in document["meshes"][0]["primitives"]:
        index = array(primitive["indices"]).reshape(-1, 3)
        corners = array(primitive["attributes"]["POSITION"]).astype(float)[index]
        face = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        mean = array(primitive["attributes"]["NORMAL"])[index].mean(axis=1)
        area = np.linalg.norm(face, axis=1)
        wrong += float(area[np.einsum("ij,ij->i", face, mean) < 0].sum())
        total += float(area.sum())
        volume += float(np.einsum("ij,ij->", corners[:, 0], face)) / 6.0
    return wrong / total, volume


@pytest.mark.parametrize("kind", ["obj", "dae", "glb"])
@pytest.mark.parametrize("seed", range(8))
def test_stated_normals_decide_the_winding_whatever_mirrors_nodes_and_scales_have(tmp_path, kind, seed):
    rng = np.random.default_rng(seed)
    matrix = random_map(rng)
    triangles, normals = faces_of_a_cube(rng, wrong=(0.0, 0.3, 1.0)[seed % 3])
    path = tmp_path / f"c.{kind}"
    {"obj": as_obj, "dae": as_dae, "glb": as_glb}[kind](path, triangles, normals, matrix)
    scale = tuple((rng.choice([-1.0, 1.0], 3) * rng.uniform(0.5, 2.0, 3)).tolist())
    written, _, _ = converted(mesh(path, scale=scale), tmp_path)
    wrong, volume = against_normals(written)
    assert wrong == 0.0
    assert volume == pytest.approx(6.0 * abs(np.linalg.det(matrix[:3, :3]) * np.prod(scale)), rel=1e-4)


@pytest.mark.parametrize("seed", range(6))
def test_without_normals_the_outside_stays_outside_under_any_map(tmp_path, seed):
    rng = np.random.default_rng(seed)
    stretch = rng.choice([-1.0, 1.0], 3) * rng.uniform(0.5, 2.0, 3)
    scale = tuple((rng.choice([-1.0, 1.0], 3) * rng.uniform(0.5, 2.0, 3)).tolist())
    text = f"<rotate>0 1 1 {rng.uniform(0, 360):g}</rotate><scale>{' '.join(f'{value:g}' for value in stretch)}</scale>"
    for path in (
        write_dae(tmp_path / "n.dae", size=(1, 2, 3), matrix=text),
        write_stl(tmp_path / "n.stl", box((0, 0, 0), (1, 2, 3)) * stretch * np.sign(np.prod(stretch))),
    ):
        written, _, _ = converted(mesh(path, scale=scale), tmp_path, path.suffix[1:])
        wrong, volume = against_normals(written)
        assert wrong == 0.0
        assert volume == pytest.approx(6.0 * np.prod(np.abs(stretch)) * np.prod(np.abs(scale)), rel=1e-4)


@pytest.mark.parametrize("seed", range(4))
def test_of_two_coincident_opposite_faces_one_is_left_and_all_others_stay(tmp_path, seed):
    rng = np.random.default_rng(seed)
    triangles, normals = faces_of_a_cube(rng, wrong=0.0)
    doubled = rng.random(12) < 0.5
    doubled[0] = True
    back = np.roll(triangles[doubled][:, ::-1], int(rng.integers(3)), axis=1)
    again = triangles[~doubled][:1]  # facing the same way, as a sticker does
    order = rng.permutation(12 + len(back) + len(again))
    as_obj(
        tmp_path / "d.obj",
        np.concatenate((triangles, back, again))[order],
        np.concatenate((normals, -normals[doubled], normals[~doubled][:1]))[order],
        np.eye(4),
    )
    written, changes, _ = converted(mesh(tmp_path / "d.obj"), tmp_path)
    wrong, volume = against_normals(written)
    assert wrong == 0.0
    assert volume >= 6.0 - 1e-5  # those that face outwards are left
    assert [change.old for change in changes] == [f"{doubled.sum()} pairs of coincident opposite triangles"]


def test_the_camera_sees_both_sides_of_a_body_with_a_mirrored_node_equally_bright(tmp_path, look):
    """The left half is wound as if its node were not mirrored, as exporters do that reverse it themselves."""
    triangles, normals = faces_of_a_cube(np.random.default_rng(0), wrong=0.0)
    brightness = []
    for name, winding in (("right", 1), ("left", -1)):
        matrix = np.diag([1.0, 1.0, 1.0, 1.0]) if winding == 1 else np.diag([1.0, -1.0, 1.0, 1.0])
        as_dae(tmp_path / f"{name}.dae", triangles[:, ::winding], normals, matrix)
        written, _, _ = converted(mesh(tmp_path / f"{name}.dae"), tmp_path, name)
        picture = look([written], eye=(6.0, 0.0, 4.5), target=(0.5, winding * 1.0, 1.5))
        lit = picture.sum(axis=2)
        brightness.append(float(np.median(lit[lit > 0])))
    assert brightness[1] == pytest.approx(brightness[0], rel=0.3)


# --- cutting in bounded time, and its cache ----------------------------------------------------------------------


def hanging_library(folder, monkeypatch, text="import time\ntime.sleep(1000)\n"):
    """A module `coacd` that does not end."""
    folder.mkdir()
    (folder / "coacd.py").write_text(text)
    monkeypatch.setenv("PYTHONPATH", str(folder))
    monkeypatch.setattr("mirdrake.importing.meshes.convex.find_spec", lambda name: name)


@pytest.fixture(autouse=True)
def _own_cache(tmp_path_factory, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))


@pytest.mark.parametrize("text", ["import time\ntime.sleep(1000)\n", "while True: pass\n"])
def test_a_decomposition_that_hangs_is_killed_at_the_time_limit(tmp_path, monkeypatch, text):
    hanging_library(tmp_path / "lib", monkeypatch, text)
    path = write_stl(tmp_path / "l.stl", corner_solid())
    time = CutTime(1.0)
    start = monotonic()
    for number in range(3):  # the second and third are not begun
        (hull,), (change,) = convert_collision(mesh(path), tmp_path, name=f"l{number}", time=time)
        assert parts_volume([hull]) == [pytest.approx(2.0625, rel=1e-5)]
        assert "the time for convex decomposition, 1 s, is used up" in change.reason
    assert monotonic() - start < 5.0
    assert time.left <= 0.0


def counted(monkeypatch):
    """Return the number of processes that were started to cut."""
    real, calls = subprocess.run, []

    def run(*args, **options):
        calls.append(args)
        return real(*args, **options)

    monkeypatch.setattr(subprocess, "run", run)
    return calls


ANSWER = """
import numpy as np
Mesh = lambda points, faces: points
set_log_level = lambda level: None
def run_coacd(points, **how):
    low = points[points[:, 1] <= 0.6]
    return [(low, None), (points[points[:, 0] <= 0.6], None)]
"""


@pytest.mark.parametrize("damage", ["none", "cut short", "empty", "bit", "text", "folder"])
def test_parts_come_from_the_cache_unless_the_entry_is_damaged(tmp_path, monkeypatch, damage):
    hanging_library(tmp_path / "lib", monkeypatch, ANSWER)
    path = write_stl(tmp_path / "l.stl", corner_solid())
    calls = counted(monkeypatch)
    first, _ = convert_collision(mesh(path), tmp_path, name="a")
    (entry,) = cache_folder("convex").iterdir()
    content = entry.read_bytes()
    middle = content.index(b"part_0") + 200
    changed = {
        "none": content, "cut short": content[:100], "empty": b"", "text": b"no archive",
        "bit": content[:middle] + bytes([content[middle] ^ 1]) + content[middle + 1 :], "folder": b"",
    }  # fmt: skip
    entry.unlink()
    if damage == "folder":
        entry.mkdir()
    else:
        entry.write_bytes(changed[damage])
    again, _ = convert_collision(mesh(path), tmp_path, name="b")
    assert len(calls) == (1 if damage == "none" else 2)
    assert [trimesh.load_mesh(shape.mesh).bounds.tolist() for shape in again] == [
        trimesh.load_mesh(shape.mesh).bounds.tolist() for shape in first
    ]
    assert parts_volume(again) == parts_volume(first)
    if damage != "folder":
        assert [file.read_bytes() == content for file in cache_folder("convex").iterdir()] == [True]


def test_another_surface_or_version_is_cut_anew_and_an_unwritable_cache_is_not_a_fault(tmp_path, monkeypatch):
    hanging_library(tmp_path / "lib", monkeypatch, ANSWER)
    calls = counted(monkeypatch)
    for number, width in enumerate((0.5, 0.4, 0.5)):
        convert_collision(mesh(write_stl(tmp_path / f"{number}.stl", corner_solid(width))), tmp_path, name=f"{number}")
    assert len(calls) == 2
    monkeypatch.setattr("mirdrake.importing.meshes.convex.installed_version", lambda name: "another")
    convert_collision(mesh(tmp_path / "0.stl"), tmp_path, name="version")
    assert len(calls) == 3
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    shapes, _ = convert_collision(mesh(tmp_path / "0.stl"), tmp_path, name="unwritable")
    assert len(shapes) == 2


def test_the_hull_of_two_points_is_a_rod_between_them():
    ends = np.array([[0.0, 0.0, 0.0], [1.0, 2.0, 2.0]])
    hull = make_hull(ends)
    along = (hull.points - ends[0]) @ (ends[1] / 3.0)
    across = np.linalg.norm(hull.points - ends[0] - np.outer(along, ends[1] / 3.0), axis=1)
    assert (along.min(), along.max()) == pytest.approx((0.0, 3.0), abs=1e-6)
    assert across.max() == pytest.approx(0.5e-3 * np.sqrt(2.0), rel=1e-3)
    assert hull.volume == pytest.approx(3.0e-6, rel=1e-3)
