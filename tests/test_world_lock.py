"""The lock of a world: the same bytes everywhere, a line for each prop, a hash of the content."""

import dataclasses
import math
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
import yaml

from mirdrake.core.errors import WorldError
from mirdrake.core.paths import data_root
from mirdrake.worlds import Track, load_world, make_world
from mirdrake.worlds.lock import content_hash, lock_content, lock_hash, lock_text

LOT = """\
mirdrake: world/1
name: lot
seed: 3
params: {mu: 0.3}
ground: {size: [60, 40], patches: [{name: ice, disc: {center: [6, 0], radius: 3}, surface: ice, mu: $mu}]}
tracks: {lane: {segments: [{line: 20}, {clothoid: {to_radius: 15, length: 10}}], start: {at: [-20, -15]}}}
start: {gate: {at: [-22, 0], yaw: 30 deg}, way: {on_track: {track: lane, s: 5}}}
goals: {exit: {at: [22, 0], radius: 1.5}, end: {gate: {track: lane, s: 18}}}
props:
  - {prop: sedan | van, name: car, grid: {step: [6, 14], count: [3, 2]}, yaw: [90 deg, -90 deg], jitter: {x: 0 .. 0.2}}
  - {prop: cone, line: {from: [-20, 3], to: [-14, 3], spacing: 3}, static: false}
  - {box: [1, 2, 3], at: [-10, 12], color: [0.2, 0.4 .. 0.6, 0.8]}
  - {prop: tree, scatter: {region: {rect: {center: [0, 15], size: [50, 5]}}, count: 4}, yaw: 0 .. 360 deg}
"""

PROGRAM = """\
import sys
from mirdrake.worlds import load_world
from mirdrake.worlds.lock import lock_text
for seed in sys.argv[2:]:
    sys.stdout.buffer.write(lock_text(load_world(sys.argv[1], overrides=[f"seed={seed}"])).encode())
"""


@pytest.fixture
def lot(tmp_path: Path) -> Path:
    path = tmp_path / "worlds of mine" / "lot.yaml"
    path.parent.mkdir()
    path.write_text(LOT, encoding="utf-8")
    return path


def _lines(text: str) -> list[str]:
    """Return the lines of the props."""
    return text.partition("\nprops:\n")[2].splitlines()


def _boxes(**keys: Any) -> dict[str, Any]:
    return {"mirdrake": "world/1", "name": "boxes", "props": [{"box": [1, 2, 3], "at": [4, 5]}], **keys}


def test_two_processes_in_other_folders_and_orders_write_the_same_bytes(lot: Path, tmp_path: Path) -> None:
    seeds = ("3", "4", "5")
    here = {seed: lock_text(load_world(str(lot), overrides=[f"seed={seed}"])) for seed in seeds}
    assert len(set(here.values())) == len(seeds)
    runs = []
    for number, order in enumerate((seeds, seeds[::-1])):  # both at once, as two workers do it
        folder = tmp_path / f"folder {number}"
        folder.mkdir()
        path = str(lot) if number else str(Path("..") / lot.parent.name / lot.name)
        runs.append(
            (
                order,
                subprocess.Popen(
                    [sys.executable, "-c", f"import sys; sys.path[:0] = {sys.path!r}\n{PROGRAM}", path, *order],
                    cwd=folder,
                    env={"PYTHONHASHSEED": str(number + 1), "OPENBLAS_NUM_THREADS": "1"},
                    stdout=subprocess.PIPE,
                ),
            )
        )
    for order, process in runs:
        written, _ = process.communicate(timeout=60)
        assert process.returncode == 0
        assert written.decode() == "".join(here[seed] for seed in order)


def test_no_path_of_this_machine_is_in_a_lock(lot: Path) -> None:
    text = lock_text(load_world(str(lot)))
    assert str(lot.parent) not in text
    assert str(data_root()) not in text
    assert "props/sedan/prop.yaml:" in text or "props/van/prop.yaml:" in text


def test_the_hash_is_the_same_in_every_python() -> None:
    bend = {"arc": {"radius": 20, "angle": "70 deg", "transition": "9 deg"}}
    spec = _boxes(
        ground={"mu": 0.8, "patches": [{"rect": {"size": [3, 1], "yaw": "30 deg"}, "surface": "ice"}]},
        tracks={"bend": {"segments": [{"line": 7}, bend]}},
    )
    spec["props"].append({"cylinder": [0.3, 1.1], "ring": {"center": [40, 9], "radius": 7, "count": 11}})
    assert lock_hash(make_world(spec)) == "bfacc202f79c6982d6e00836eff519274aa790fd8331b20f218db74fd0f80777"


def test_the_content_of_a_lock_file_has_the_hash_in_it(lot: Path) -> None:
    world = load_world(str(lot))
    back = yaml.safe_load(lock_text(world))
    assert back["hash"] == lock_hash(world) == content_hash(back)
    back["props"][2]["pose"][0] += 1e-6
    assert content_hash(back) != lock_hash(world)


def test_a_comment_leaves_the_hash_and_all_else_changes_it(lot: Path) -> None:
    before = lock_hash(load_world(str(lot)))
    lot.write_text("# a comment\n" + LOT.replace("size: [60, 40]", "size: [60 m, 4000 cm]"), encoding="utf-8")
    assert lock_hash(load_world(str(lot))) == before
    for old, new in (
        ("seed: 3", "seed: 4"), ("mu: 0.3", "mu: 0.31"), ("radius: 1.5", "radius: 1.6"), ("yaw: 30 deg", "yaw: 31 deg"),
        ("length: 10", "length: 11"), ("static: false", "static: true"), ("[0.2, ", "[0.3, "), ("s: 18", "s: 19"),
    ):  # fmt: skip
        assert LOT.count(old) == 1
        lot.write_text(LOT.replace(old, new), encoding="utf-8")
        assert lock_hash(load_world(str(lot))) != before, new


def test_a_new_prop_leaves_the_lines_of_the_others(lot: Path) -> None:
    before = _lines(lock_text(load_world(str(lot))))
    assert len(before) == 6 + 3 + 1 + 4
    extra = "props:\n  - {prop: barrel, at: [20, -10]}\n  - {sphere: 1, name: ball, at: [25, -12]}\n"
    lot.write_text(LOT.replace("props:\n", extra), encoding="utf-8")
    after = _lines(lock_text(load_world(str(lot))))
    assert [line for line in after if "barrel" not in line and "ball" not in line] == before
    assert len(after) == len(before) + 2


def test_every_prop_is_in_its_line_as_it_is_in_the_world(lot: Path) -> None:
    world = load_world(str(lot))
    entries = yaml.safe_load(lock_text(world))["props"]
    for placed, entry in zip(world.props, entries, strict=True):
        assert (entry["name"], entry["kind"], entry["static"]) == (placed.name, placed.prop.name, placed.static)
        np.testing.assert_allclose(entry["pose"][:3], placed.X_WP.translation(), atol=1e-9)
        heading = placed.X_WP.rotation().matrix()[:2, 0]
        np.testing.assert_allclose([math.cos(entry["pose"][3]), math.sin(entry["pose"][3])], heading, atol=1e-9)
        np.testing.assert_allclose(entry["size"], placed.prop.size, atol=1e-9)
        assert ("mass" in entry) != placed.static
    assert lock_text(world).count('solids: "') == len(world.props)  # in quotes also where it begins with a letter
    assert any(entry["solids"][0].isalpha() for entry in entries)
    assert {len({e["solids"] for e in entries if e["kind"] == kind}) for kind in ("cone", "tree")} == {1}


def test_equal_poses_have_equal_lock_text() -> None:
    texts = set()
    for x, yaw in ((0.0, math.pi), (-0.0, -math.pi), (1e-13, math.pi + 1e-13), (-1e-13, -math.pi - 1e-13)):
        world = make_world(_boxes(props=[{"box": [1, 2, 3], "at": [x, 5.0], "yaw": yaw}]))
        texts.add(lock_text(world))
    assert len(texts) == 1
    assert "pose: [0, 5, 0, 3.141592654, 0, 0]" in texts.pop()


@pytest.mark.parametrize("value", [1e-7, 1e20, -2.5, 0.1 + 0.2, 3, "no", "e", "hello"])
def test_parameters_are_read_back_as_they_are(value: Any) -> None:
    assert yaml.safe_load(lock_text(make_world(_boxes(params={"a": value}))))["params"] == {"a": value}


@pytest.mark.parametrize("name", ["no", "12", "3e5", "0123456789abcdef", 'a "b": [c, ü]', "two\nlines", "# x", "*"])
def test_names_are_read_back_as_they_are(name: str) -> None:
    world = make_world(_boxes(name=name))
    back = yaml.safe_load(lock_text(world))
    assert back["name"] == name
    assert back["hash"] == lock_hash(world)


def test_solids_of_another_size_have_another_hash() -> None:
    def solids(**keys: Any) -> str:
        return str(lock_content(make_world(_boxes(props=[{"at": [0, 0], **keys}])))["props"][0]["solids"])

    hashes = [solids(prop="cone"), solids(prop="cone", scale=1.1), solids(box=[1, 1, 1]), solids(box=[1, 1, 1.1])]
    assert len(set(hashes)) == 4
    assert solids(prop="cone") == hashes[0]


def test_a_mesh_beside_the_world_is_named_from_there_and_counts(tmp_path: Path) -> None:
    world = tmp_path / "deep" / "rocks.yaml"
    (tmp_path / "meshes").mkdir()
    world.parent.mkdir()
    world.write_text("mirdrake: world/1\nprops: [{file: ../meshes/rock.obj, at: [1, 2]}]\n", encoding="utf-8")
    rock = tmp_path / "meshes" / "rock.obj"
    mesh = trimesh.creation.box(extents=[1.0, 2.0, 3.0])
    rock.write_text("mtllib rock.mtl\n" + mesh.export(file_type="obj", include_texture=False), encoding="utf-8")
    (tmp_path / "meshes" / "rock.mtl").write_text("newmtl a\nmap_Kd -clamp on rock.png\n", encoding="utf-8")
    (tmp_path / "meshes" / "rock.png").write_bytes(b"1")
    names = [f"../meshes/rock.{ending}" for ending in ("mtl", "obj", "png")]
    content = lock_content(load_world(str(world)))
    assert list(content["files"]) == names
    (tmp_path / "meshes" / "rock.png").write_bytes(b"2")
    assert lock_hash(load_world(str(world))) != content_hash(content)
    loaded = load_world(str(world))
    (tmp_path / "meshes" / "rock.png").unlink()
    with pytest.raises(WorldError, match=r"^rock\.png: cannot be read: No such file or directory$"):
        lock_hash(loaded)


def test_a_road_of_varying_width_is_locked_with_its_edges() -> None:
    world = make_world(_boxes(tracks={"lane": {"segments": [{"line": 20}]}}))
    assert "widths" not in lock_content(world)["tracks"]["lane"]
    wide = Track(world.tracks["lane"].pieces, edges=([0.0, 5.0, 20.0], [1.0, 2.0, 2.0], [1.5, 1.5, 3.0]))
    wider = dataclasses.replace(world, tracks={"lane": wide})
    assert yaml.safe_load(lock_text(wider))["tracks"]["lane"]["widths"] == [[0, 1, 1.5], [5, 2, 1.5], [20, 2, 3]]
    assert lock_hash(wider) != lock_hash(world)


def test_a_network_without_banking_has_the_hash_of_before_banking_was_read() -> None:
    found = yaml.safe_load(lock_text(load_world("town")))["network"]["content"]
    assert found == "fb31200f8c7d402138011008211672b90bc946d1dedaa6f758b6d6469ab02140"
