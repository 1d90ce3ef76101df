"""OBJ files of packages: submeshes by object and group, all forms of faces, materials and textures."""

import itertools

import numpy as np
import pytest
from PIL import Image

from mirdrake.importing.meshes.convert import mesh_bounds, with_known_submesh
from mirdrake.importing.meshes.read import MeshError, read_mesh, select_submesh
from mirdrake.importing.shape import Shape
from tests.mesh_rigs import CORNERS, QUADS

LIBRARY = "newmtl red\nKd 1 0 0\nnewmtl blue\nKd 0 0 1\n"


def read(tmp_path, text, library=LIBRARY):
    (tmp_path / "car.mtl").write_text(library)
    (tmp_path / "car.obj").write_text(text)
    return read_mesh(tmp_path / "car.obj")


def chosen(mesh, tmp_path, name):
    return select_submesh(mesh, tmp_path / "car.obj", name)


def area(pieces):
    corners = np.concatenate([piece.corners for piece in pieces])
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return float(np.linalg.norm(cross, axis=1).sum()) / 2.0


def cube(rng, first, offset, materials, heading):
    """Return lines of a cube whose faces are in random materials, quads or triangles, absolute or relative."""
    lines = [f"v {x + offset:g} {y:g} {z:g}" for x, y, z in CORNERS]
    lines += heading if rng.random() < 0.5 or not materials else [f"usemtl {materials[0]}", *heading]
    relative = rng.random() < 0.5
    for quad in QUADS:
        if materials and rng.random() < 0.7:
            lines.append(f"usemtl {materials[rng.integers(len(materials))]}")
        corners = [corner - 8 if relative else first + corner for corner in quad]
        faces = [corners] if rng.random() < 0.5 else [corners[:3], [corners[0], *corners[2:]]]
        lines += ["f " + " ".join(f"{index}" for index in face) for face in faces]
    return lines


@pytest.mark.parametrize("seed", range(20))
def test_a_submesh_is_found_by_object_or_group_whichever_materials_split_it(tmp_path, seed):
    rng = np.random.default_rng(seed)
    names = ["chassis", "wheel_left", "Body Work"]
    key = "og"[seed % 2]
    materials = [[], ["red"], ["red", "blue"], ["red", "missing"]][seed % 4]
    lines = ["mtllib car.mtl"] * (seed % 3 > 0)
    for number, name in enumerate(names):
        lines += cube(rng, 8 * number + 1, 10.0 * number, materials, [f"{key} {name}"])
    mesh = read(tmp_path, "\n".join(lines) + "\n")
    for number, name in enumerate(names):
        pieces = chosen(mesh, tmp_path, name)
        assert area(pieces) == pytest.approx(6.0)
        corners = np.concatenate([piece.corners.reshape(-1, 3) for piece in pieces])
        assert corners.min(axis=0) == pytest.approx([10.0 * number, 0, 0])
        assert corners.max(axis=0) == pytest.approx([10.0 * number + 1, 1, 1])
    assert area(mesh.pieces) == pytest.approx(18.0)


def test_several_groups_on_one_line_groups_in_an_object_and_a_new_object_that_ends_them(tmp_path):
    rng = np.random.default_rng(0)
    lines = ["mtllib car.mtl", *cube(rng, 1, 0.0, ["red", "blue"], ["o car", "g body left"])]
    lines += cube(rng, 9, 10.0, ["red"], ["g body right"])
    lines += cube(rng, 17, 20.0, [], ["o trailer"])
    lines += cube(rng, 25, 30.0, [], ["g"])
    mesh = read(tmp_path, "\n".join(lines))
    expected = {"car": 12.0, "body": 12.0, "left": 6.0, "right": 6.0, "body left": 6.0, "trailer": 12.0, "": 24.0}
    assert {name: area(chosen(mesh, tmp_path, name)) for name in expected} == pytest.approx(expected)
    with pytest.raises(MeshError, match=r"no submesh 'bodi'.*body.*trailer"):
        chosen(mesh, tmp_path, "bodi")


def test_a_submesh_that_does_not_exist_becomes_the_whole_mesh_with_the_names_that_do(tmp_path):
    read(tmp_path, "\n".join(cube(np.random.default_rng(0), 1, 2.0, ["red"], ["g Body"])))
    shape = Shape("mesh", mesh=tmp_path / "car.obj", address="car.obj", submesh="Chassis", center=True, where="m.sdf:3")
    known, (change,) = with_known_submesh(shape)
    assert mesh_bounds(known)[0] == pytest.approx([2, 0, 0])
    assert (change.place, change.old, change.new) == ("m.sdf:3", "submesh 'Chassis'", "the whole mesh")
    assert "Body" in change.reason
    centred = Shape("mesh", mesh=tmp_path / "car.obj", address="car.obj", submesh="Body", center=True)
    assert with_known_submesh(centred) == (centred, [])
    assert mesh_bounds(centred)[1] == pytest.approx([0.5, 0.5, 0.5])


@pytest.mark.parametrize("seed", range(10))
def test_polygons_of_any_form_keep_their_area_and_their_outside(tmp_path, seed):
    """Star-shaped outlines with 4 to 12 corners in a random plane; most are not convex."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(4, 13))
    angles = np.sort(rng.uniform(0, 2 * np.pi, count) / count + 2 * np.pi * np.arange(count) / count)
    flat = rng.uniform(0.2, 2.0, count)[:, None] * np.column_stack((np.cos(angles), np.sin(angles)))
    x, y = flat.T
    exact = 0.5 * float(x @ np.roll(y, -1) - y @ np.roll(x, -1))
    frame, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    points = np.column_stack((flat, np.zeros(count))) @ frame.T + rng.normal(size=3)
    text = [f"v {a:.9g} {b:.9g} {c:.9g}" for a, b, c in points]
    (piece,) = read(tmp_path, "\n".join([*text, "f " + " ".join(map(str, range(1, count + 1)))])).pieces
    cross = np.cross(piece.corners[:, 1] - piece.corners[:, 0], piece.corners[:, 2] - piece.corners[:, 0])
    normal = frame[:, 2] * np.sign(np.linalg.det(frame))
    outward = np.cross(frame[:, 0], frame[:, 1])
    assert (cross @ outward > 0).all()
    assert cross.sum(axis=0) @ outward / 2 == pytest.approx(exact, rel=1e-6)
    assert np.abs(normal @ outward) == pytest.approx(1.0)


@pytest.mark.parametrize(
    "face", ["1 2 3", "1/1 2/2 3/3", "1//1 2//1 3//1", "1/1/1 2/2/1 3/3/1", "-3/-3/-1 -2/-2/-1 -1/-1/-1"]
)
def test_all_forms_of_corners(tmp_path, face):
    text = f"v 0 0 0\nv 1 0 0 # a comment\nv\t0 1 \\\n0\nvt 0 0\nvt 1 0\nvt 0 1 0\nvn 0 0 1\ns 1\nf {face}\nl 1 2\n"
    (piece,) = read(tmp_path, text).pieces
    assert piece.corners.tolist() == [[[0, 0, 0], [1, 0, 0], [0, 1, 0]]]
    assert (piece.uv is not None) == (face.count("/") in (3, 6) and "//" not in face)
    assert (piece.normals is not None) == (("/1" in face and face != "1/1 2/2 3/3") or face.startswith("-"))
    if piece.uv is not None:
        assert piece.uv.tolist() == [[[0, 0], [1, 0], [0, 1]]]


def test_negative_indices_count_back_from_the_vertices_read_so_far(tmp_path):
    text = "g a\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf -3 -2 -1\ng b\nv 5 0 0\nv 6 0 0\nv 5 1 0\nf -3 -2 -1\n"
    mesh = read(tmp_path, text)
    assert chosen(mesh, tmp_path, "a")[0].corners.max() == 1
    assert chosen(mesh, tmp_path, "b")[0].corners[0].min(axis=0).tolist() == [5, 0, 0]


def test_a_face_with_a_vertex_that_is_not_there_is_left_out_and_counted(tmp_path):
    mesh = read(tmp_path, "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nf 1 2 9\nf 1 x 3\nf 1 2\n")
    assert sum(len(piece.corners) for piece in mesh.pieces) == 1
    assert mesh.notes[0].old == "3 triangles"


@pytest.mark.parametrize(("scale", "extra"), list(itertools.product((1, 255), ("", " 0.5"))))
def test_vertices_carry_colours(tmp_path, scale, extra):
    mark = extra if scale == 1 else ""
    rows = [f"v {x} {y} 0 {r * scale} {g * scale} 0{mark}" for x, y, r, g in ((0, 0, 1, 0), (1, 0, 0, 1), (0, 1, 0, 0))]
    (piece,) = read(tmp_path, "\n".join([*rows, "f 1 2 3"])).pieces
    assert piece.colors is not None
    assert piece.colors[0].tolist() == [[1, 0, 0, 1], [0, 1, 0, 1], [0, 0, 0, 1]]
    (plain,) = read(tmp_path, "v 0 0 0 1\nv 1 0 0 1\nv 0 1 0 1\nf 1 2 3").pieces  # a weight, no colour
    assert plain.colors is None


def test_a_missing_material_file_is_reported_and_its_parts_keep_their_names(tmp_path):
    mesh = read(tmp_path, "mtllib gone.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\ng body\nusemtl paint\nf 1 2 3\n")
    assert [(note.old, note.reason) for note in mesh.notes] == [("material file gone.mtl", "the file is missing")]
    (piece,) = chosen(mesh, tmp_path, "body")
    assert (piece.material.name, piece.material.rgba) == ("paint", None)


@pytest.mark.parametrize(
    "line", ["tex ture.png", "-s 2 2 1 -o 0 0 tex ture.png", "..\\textures\\Tex Ture.PNG", "C:\\car\\tex ture.png"]
)
def test_textures_are_found_behind_options_and_below_other_folders(tmp_path, line):
    (tmp_path / "textures").mkdir()
    Image.new("RGB", (2, 2), (0, 255, 0)).save(tmp_path / "textures" / "tex ture.png")
    library = f"newmtl my paint\nKd 0 0 0\nmap_Kd {line}\nnewmtl odd\nKd 1 1 1\nd 0\n"
    text = "mtllib car.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nusemtl my paint\nf 1/1 2/1 3/1\n"
    mesh = read(tmp_path, text + "usemtl odd\nv 0 0 5\nf 1 2 4\n", library)
    looks = {piece.material.name: piece.material for piece in mesh.pieces}
    assert looks["my paint"].picture is not None
    assert looks["my paint"].rgba == (1, 1, 1, 1)
    assert looks["odd"].rgba == (1, 1, 1, 1)
    assert [note.new for note in mesh.notes if "odd" in note.old] == ["opaque"]


def test_opacity_and_colours_of_materials(tmp_path):
    library = "newmtl a\nKd 0 0 1\nd 0.25\nnewmtl b\nKd 1 0 0\nTr 0.25\nnewmtl c\nNs 3\nnewmtl e\nKd 0 0 0\nKe 1 0 0\n"
    faces = "".join(f"usemtl {name}\nv 0 0 {k}\nv 1 0 {k}\nv 0 1 {k}\nf -3 -2 -1\n" for k, name in enumerate("abce"))
    looks = {
        piece.material.name: piece.material for piece in read(tmp_path, "mtllib car.mtl\n" + faces, library).pieces
    }
    assert {name: look.rgba for name, look in looks.items()} == {
        "a": (0, 0, 1, 0.25), "b": (1, 0, 0, 0.75), "c": (0.7, 0.7, 0.7, 1), "e": (0, 0, 0, 1),
    }  # fmt: skip
    assert looks["e"].emission == (1, 0, 0)


@pytest.mark.parametrize(("opacity", "mode"), [("", "RGB"), ("map_d both.png\n", "RGBA"), ("map_d mask.png\n", "RGBA")])
def test_an_alpha_channel_is_opacity_only_with_map_d(tmp_path, opacity, mode):
    """The Prius of OSRF keeps a mask of its paint in the alpha channel: its lamps and bumpers were holes."""
    Image.new("RGBA", (2, 2), (200, 10, 10, 0)).save(tmp_path / "both.png")
    Image.new("L", (4, 4), 0).save(tmp_path / "mask.png")
    library = f"newmtl paint\nKd 1 1 1\nmap_Kd both.png\n{opacity}"
    text = "mtllib car.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nusemtl paint\nf 1/1 2/1 3/1\n"
    (piece,) = read(tmp_path, text, library).pieces
    picture = piece.material.picture
    assert picture is not None
    assert picture.mode == mode
    assert picture.getpixel((0, 0)) == (200, 10, 10, 0)[: len(mode)]
