"""The world editor without a browser: changes of the file by gestures, and marks on the map."""

import json
import os
import random
import socket
import threading
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mirdrake.core.errors import ConfigError, MirdrakeError, RunError
from mirdrake.core.paths import data_root
from mirdrake.editor.document import Document
from mirdrake.editor.editor import Editor, world_path
from mirdrake.editor.elements import LockedError
from mirdrake.editor.gestures import read_gesture
from mirdrake.editor.marks import mark_overlaps
from mirdrake.editor.scene import Scene, read_scene
from mirdrake.editor.values import lock_reason, plain_number, write_number
from mirdrake.world_checks.overlaps import find_overlaps
from mirdrake.worlds import load_world

YARD = """\
mirdrake: world/1
params: {pitch: 4}
tracks: {lane: {segments: [{line: 60}], start: {at: [0, 20]}}}
ground:
  patches:
    - {name: ice, rect: {center: [0, -20], size: [6, 4]}, mu: 0.1}
props:
  - {prop: sedan, name: car, at: [0, 0], yaw: 90 deg}   # mine
  # a row of cones
  - {prop: cone, line: {from: [10, 0], to: [20, 0], count: 3}}
  - {prop: barrel, grid: {step: [2, 3], count: [2, 2]}, yaw: 0.5}
  - {prop: barrel, at: [2*$pitch, 0 +- 1]}
  - {prop: tree, ring: {center: [30, 0], radius: 5 m, count: 4}}
  - {prop: cone, along: {track: lane, s: [10, 20], count: 2}}
  - {prop: tree, scatter: {region: {disc: {center: [0, 40], radius: 8}}, count: 2}}
start: {gate: {at: [-10, 0], yaw: 0 deg}, road: {on_track: {track: lane, s: 3}}}
goals: {exit: {at: [40, 0]}, line: {gate: {track: lane, s: 50}}}
"""
PATH = Path("yard.yaml").resolve()


@pytest.fixture(scope="module")
def yard() -> Scene:
    return read_scene(YARD, PATH)


def changed(scene: Scene, **gesture: Any) -> str:
    """Return the text after a gesture."""
    return read_gesture(gesture).text(scene, "yard.yaml")


def drag(scene: Scene, element: str, x: float, y: float, handle: str = "body") -> str:
    move = {"element": element, "handle": handle, "x": x, "y": y}
    return changed(scene, kind="drag", moves=[move])


def lines_changed(before: str, after: str) -> list[tuple[str, str]]:
    return [pair for pair in zip(before.splitlines(), after.splitlines(), strict=True) if pair[0] != pair[1]]


@pytest.mark.parametrize(
    ("element", "handle", "position", "old", "new"),
    [
        ("props/0", "body", (3.5, -2.25), "at: [0, 0], yaw", "at: [3.5, -2.25], yaw"),
        ("props/0", "yaw", (0.0, -9.0), "yaw: 90 deg", "yaw: -90 deg"),
        ("props/1", "body", (15.0, 4.0), "from: [10, 0], to: [20, 0]", "from: [10, 4], to: [20, 4]"),
        ("props/1", "to", (22.0, 1.0), "to: [20, 0]", "to: [22, 1]"),
        ("props/2", "body", (1.0, 2.0), "count: [2, 2]}", "count: [2, 2], origin: [1, 2]}"),
        ("props/2", "step", (4.0, 5.0), "step: [2, 3]", "step: [4, 5]"),
        ("props/4", "body", (31.0, 1.0), "center: [30, 0]", "center: [31, 1]"),
        ("props/4", "radius", (30.0, 6.5), "radius: 5 m", "radius: 6.5 m"),
        ("props/5", "end", (24.0, 25.0), "s: [10, 20]", "s: [10, 24]"),
        ("props/6", "body", (5.0, 41.0), "center: [0, 40]", "center: [5, 41]"),
        ("start/gate", "body", (-12.0, 1.0), "at: [-10, 0]", "at: [-12, 1]"),
        ("start/road", "body", (7.0, 22.0), "s: 3}", "s: 7}"),
        ("goals/exit", "radius", (43.0, 4.0), "at: [40, 0]}", "at: [40, 0], radius: 5}"),
        ("goals/line", "body", (45.0, 18.0), "s: 50", "s: 45"),
        ("ground/patches/0", "corner", (4.0, -17.0), "size: [6, 4]", "size: [8, 6]"),
    ],
)
def test_a_moved_handle_changes_its_values_alone(yard, element, handle, position, old, new):
    x, y = position
    after = drag(yard, element, x, y, handle)
    assert after == YARD.replace(old, new)
    assert read_scene(after, PATH).world.name == "yard"


def test_a_value_that_is_not_a_plain_number_is_not_dragged(yard):
    with pytest.raises(LockedError, match=r"2\*\$pitch depends on \$pitch"):
        drag(yard, "props/3", 1.0, 1.0)
    with pytest.raises(LockedError, match="follows the track"):
        drag(yard, "props/5", 1.0, 1.0)
    assert lock_reason("0 +- 3 deg") == "0 +- 3 deg is drawn at random; change it in the panel"


def test_an_inserted_prop_is_one_line_more_and_leaves_the_others_where_they_were(yard):
    after = changed(yard, kind="insert", what="prop", name="van", x=-20.0, y=3.25)
    before, lines = YARD.splitlines(), after.splitlines()
    added = "  - {prop: van, at: [-20, 3.25]}"
    assert [line for line in lines if line != added] == before
    scene = read_scene(after, PATH)
    old = {placed.name: placed.X_WP.GetAsMatrix4() for placed in yard.world.props}
    new = {placed.name: placed.X_WP.GetAsMatrix4() for placed in scene.world.props}
    assert set(new) - set(old) == {"van"}
    assert all(np.array_equal(old[name], new[name]) for name in old)


def test_a_deleted_entry_goes_with_its_comment(yard):
    after = changed(yard, kind="delete", elements=["props/1", "props/0"])
    assert "mine" not in after
    assert "a row of cones" not in after
    assert len(after.splitlines()) == len(YARD.splitlines()) - 3


def test_a_copy_is_displaced_and_has_its_own_name(yard):
    after = changed(yard, kind="copy", elements=["props/0", "props/1"], dx=1.0, dy=-1.0)
    added = after.splitlines()[-4:-2]
    assert added == [
        "  - {prop: sedan, name: car_2, at: [1, -1], yaw: 90 deg}",
        "  - {prop: cone, line: {from: [11, -1], to: [21, -1], count: 3}}",
    ]


def test_an_entry_becomes_single_ones_at_the_same_positions(yard):
    scene = read_scene(changed(yard, kind="expand", element="props/2"), PATH)
    before = sorted(tuple(p.X_WP.translation()) for p in yard.world.props if p.prop.name == "barrel" and not p.random)
    after = sorted(tuple(p.X_WP.translation()) for p in scene.world.props if p.prop.name == "barrel" and not p.random)
    assert np.allclose(before, after, atol=5e-4)
    assert [entry["yaw"] for entry in scene.data["props"][-4:]] == ["28.65 deg"] * 4  # 0.5 rad


def test_starts_and_goals_are_added_with_free_names(yard):
    after = changed(yard, kind="insert", what="goal", name="exit", x=1.0, y=2.0)
    assert "exit_2: {at: [1, 2], radius: 2}}" in after
    empty = read_scene("mirdrake: world/1\n", PATH)
    assert changed(empty, kind="insert", what="start", name="start", x=1.0, y=2.0).endswith(
        "\nstart: {start: {at: [1, 2], yaw: 0 deg}}\n"
    )


@pytest.mark.parametrize(
    ("raw", "unit", "value", "written"),
    [
        ("90 deg", "rad", np.pi / 4, "45 deg"), (0.5, "rad", 1.0, "1"), (None, "rad", np.pi, "180 deg"),
        ("3 m", "m", 5.2999999999, "5.3 m"), (2, "m", -0.0001, "0"), ("250 cm", "m", 1.234, "123.4 cm"),
    ],
)  # fmt: skip
def test_numbers_keep_unit_and_a_sensible_precision(raw, unit, value, written):
    assert write_number(value, unit, like=raw) == written


def test_expressions_are_not_plain_numbers():
    assert [plain_number(raw, "m") for raw in ("1 | 2", "$a", "1 .. 2", "2*3", True, None)] == [None] * 6


# --- the file -----------------------------------------------------------------------------------------------------


WORLDS = sorted((data_root() / "worlds").glob("*.yaml"))


@pytest.mark.parametrize("source", WORLDS, ids=lambda path: path.stem)
def test_a_shipped_world_is_saved_byte_by_byte(source, tmp_path):
    path = tmp_path / source.name
    path.write_bytes(source.read_bytes())
    document = Document(path)
    document.change(document.text + "# x\n")
    document.undo()
    document.save()
    assert path.read_bytes() == source.read_bytes()
    document.close()


def test_a_second_editor_only_reads(tmp_path):
    path = tmp_path / "yard.yaml"
    path.write_text(YARD, encoding="utf-8")
    first, second = Document(path), Document(path)
    assert not first.read_only
    second.change(YARD + "# mine\n")
    with pytest.raises(RunError, match="open in another editor"):
        second.save()
    first.close()
    third = Document(path)
    assert not third.read_only
    third.close()
    assert [file.name for file in tmp_path.iterdir()] == ["yard.yaml"]


def test_a_change_by_another_program_is_not_overwritten(tmp_path):
    path = tmp_path / "yard.yaml"
    path.write_text(YARD, encoding="utf-8")
    document = Document(path)
    document.change(YARD + "# mine\n")
    path.write_text(YARD + "# theirs\n", encoding="utf-8")
    assert document.changed_outside()
    with pytest.raises(RunError, match="another program has changed this file"):
        document.save()
    document.reload()
    assert document.text.endswith("# theirs\n")
    document.undo()
    assert document.text.endswith("# mine\n")
    document.save(overwrite=True)
    assert path.read_text(encoding="utf-8").endswith("# mine\n")
    document.close()


def test_a_new_world_is_written_by_the_first_save(tmp_path):
    document = Document(tmp_path / "new.yaml")
    assert not document.is_saved
    assert not (tmp_path / "new.yaml").exists()
    document.save()
    assert read_scene((tmp_path / "new.yaml").read_text("utf-8"), tmp_path / "new.yaml").world.props == ()
    document.close()
    with pytest.raises(ConfigError, match="does not exist; create it first"):
        world_path(str(tmp_path / "nowhere" / "a.yaml"))


# --- overlaps -----------------------------------------------------------------------------------------------------


def random_yard(rng: random.Random) -> str:
    kinds = ["sedan", "barrel", "wall", "tree", "cone", "jersey_barrier", "lamp_post"]
    rows = [
        f"  - {{prop: {rng.choice(kinds)}, at: [{rng.uniform(-6, 6):.2f}, {rng.uniform(-6, 6):.2f}], "
        f"yaw: {rng.randrange(360)} deg}}"
        for _ in range(8)
    ]
    return "\n".join(["mirdrake: world/1", "props:", *rows]) + "\n"


@pytest.mark.parametrize("seeds", [range(3), pytest.param(range(3, 503), marks=pytest.mark.slow)], ids=["3", "500"])
def test_the_map_marks_the_findings_of_the_check(seeds):
    different, total = [], 0
    for seed in seeds:
        scene = read_scene(random_yard(random.Random(seed)), PATH)
        marks = {frozenset(mark.names): mark.depth for mark in mark_overlaps(scene)}
        rules = scene.world.rules
        assert rules is not None
        faults = {
            frozenset(fault.names): fault.depth or 0.0
            for fault in find_overlaps(scene.near, rules.may_overlap)
            if fault.kind == "overlap"
        }
        total += len(faults)
        if marks.keys() != faults.keys() or any(abs(marks[key] - faults[key]) > 0.01 for key in marks):
            different.append(seed)
    assert total >= len(seeds)
    assert different == []


# --- the server ---------------------------------------------------------------------------------------------------


@pytest.fixture
def editor(tmp_path: Path) -> Iterator[Editor]:
    (tmp_path / "yard.yaml").write_text(YARD, encoding="utf-8")
    editor = Editor(tmp_path / "yard.yaml", port=0)
    editor.start()
    yield editor
    editor.close()


def post(editor: Editor, to: str, **message: Any) -> dict[str, Any]:
    request = urllib.request.Request(
        editor.url + to, json.dumps(message).encode(), {"Content-Type": "application/json"}
    )
    with urllib.request.urlopen(request, timeout=60) as answer:
        reply: dict[str, Any] = json.load(answer)
    return reply


def test_the_page_sends_gestures_and_gets_the_new_state(editor):
    state = post(editor, "state")
    assert state["saved"]
    assert state["text"] == YARD
    reply = post(editor, "gesture", kind="drag", moves=[{"element": "props/0", "x": 5, "y": 6}])
    assert "at: [5, 6], yaw: 90 deg" in reply["text"]
    assert not reply["saved"]
    assert post(editor, "undo")["text"] == YARD
    assert post(editor, "redo")["text"] == reply["text"]
    assert post(editor, "save")["saved"]
    assert editor.document.path.read_text("utf-8") == reply["text"]


def test_overlaps_are_marked_while_a_prop_is_dragged(editor):
    moves = [{"element": "props/0", "handle": "body", "x": 10.0, "y": 0.0}]
    marks = post(editor, "preview", moves=moves, sequence=7)
    assert marks["sequence"] == 7
    assert {frozenset(mark["names"]) for mark in marks["marks"]} >= {frozenset({"car", "cone[0]"})}
    assert post(editor, "state")["text"] == YARD


@pytest.mark.parametrize(
    "message",
    [
        {}, {"kind": "drag"}, {"kind": "explode"}, {"kind": "drag", "moves": [{"element": "props/99", "x": 0, "y": 0}]},
        {"kind": "drag", "moves": [{"element": "props/0", "x": 1e400, "y": 0}]},
        {"kind": "set", "path": ["props", "0", "prop"], "value": "unicorn"},
        {"kind": "set", "path": ["props", "0", "at"], "value": "[1, 2"},
        {"kind": "insert", "what": "prop", "name": "../../x", "x": 0, "y": 0},
        {"kind": "delete", "elements": ["nothing/0"]}, {"kind": "copy", "elements": ["start/gate"], "dx": 0, "dy": 0},
        {"kind": "expand", "element": "start/gate"},
    ],
)  # fmt: skip
def test_a_bad_gesture_changes_nothing_and_states_why(editor, message):
    reply = post(editor, "gesture", **message)
    assert reply["error"]
    assert "\n" not in reply["error"].strip()
    assert editor.document.text == YARD


def test_a_typed_text_with_a_fault_keeps_the_map_and_is_reported(editor):
    reply = post(editor, "gesture", kind="text", value=YARD.replace("prop: sedan", "prop: sedann"))
    assert "sedann" in reply["text"]
    assert "scene" not in reply
    assert "yard.yaml:8" in reply["faults"][0]
    assert post(editor, "gesture", kind="text", value=YARD)["faults"] == []


def test_only_the_files_of_the_page_are_served(editor):
    for path in ("editor.js", "map.js", "editor.css"):
        assert urllib.request.urlopen(editor.url + path, timeout=10).status == 200
    for path in ("editor.py", "../editor.py", "page/editor.js", "nothing.js"):
        with pytest.raises(urllib.error.HTTPError):
            urllib.request.urlopen(editor.url + path, timeout=10)


# --- many gestures ------------------------------------------------------------------------------------------------


def random_gesture(scene: Scene, rng: random.Random) -> dict[str, Any]:
    """Return a gesture that a user might make: drags most often, then inserts, copies, deletes and typed values."""
    keys = list(scene.elements)
    kind = rng.choice(["drag", "drag", "drag", "insert", "copy", "delete", "expand", "set"])
    x, y = round(rng.uniform(-60, 60), 2), round(rng.uniform(-60, 60), 2)
    if kind == "insert" or not keys:
        what, name = rng.choice([("prop", "cone"), ("prop", "barrel"), ("start", "start"), ("goal", "goal")])
        return {"kind": "insert", "what": what, "name": name, "x": x, "y": y}
    key = rng.choice(keys)
    if kind == "drag":
        handle = rng.choice(scene.elements[key].handles).name
        return {"kind": "drag", "moves": [{"element": key, "handle": handle, "x": x, "y": y}]}
    if kind == "copy":
        return {"kind": "copy", "elements": [key], "dx": x, "dy": y}
    if kind == "delete":
        return {"kind": "delete", "elements": [key]}
    if kind == "expand":
        return {"kind": "expand", "element": key}
    return {"kind": "set", "path": [*scene.elements[key].path, "yaw"], "value": f"{rng.randrange(360)} deg"}


@pytest.mark.parametrize("seeds", [range(1), pytest.param(range(1, 60), marks=pytest.mark.slow)], ids=["1", "59"])
def test_after_random_gestures_the_file_means_what_is_shown_and_undo_restores_every_byte(seeds, tmp_path):
    for seed in seeds:
        rng = random.Random(seed)
        path = tmp_path / f"yard{seed}.yaml"
        begin = rng.choice([YARD, YARD.replace("\n", "\r\n"), "mirdrake: world/1"])
        path.write_bytes(begin.encode())
        document, scene, created = Document(path), read_scene(begin, path), 0
        for _ in range(50):
            try:
                text = read_gesture(random_gesture(scene, rng)).text(scene, "yard.yaml")
                after = read_scene(text, path)
            except (LockedError, MirdrakeError):
                continue
            document.change(text)
            scene, created = after, created + (text != begin)
        assert created > 15
        document.save()
        saved = load_world(str(path))
        assert [placed.name for placed in saved.props] == [placed.name for placed in scene.world.props]
        for saved_prop, shown_prop in zip(saved.props, scene.world.props, strict=True):
            assert np.allclose(saved_prop.X_WP.GetAsMatrix4(), shown_prop.X_WP.GetAsMatrix4(), atol=1e-9)
        while document.can_undo:
            document.undo()
        assert document.text == begin
        document.close()


def test_an_editor_that_finds_no_port_leaves_no_thread_and_no_lock(tmp_path: Path) -> None:
    path = tmp_path / "yard.yaml"
    with socket.create_server(("127.0.0.1", 0)) as taken, pytest.raises(MirdrakeError):
        Editor(path, port=taken.getsockname()[1])
    assert "world check" not in {thread.name for thread in threading.enumerate()}
    assert list(tmp_path.iterdir()) == []


def test_the_lock_of_a_document_is_removed_while_it_is_held(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Otherwise the file of an editor that has locked it in between would be removed."""
    document = Document(tmp_path / "yard.yaml")
    lock, close = document._lock_path, os.close
    remaining: list[bool] = []
    assert lock.exists()

    def watched(number: int) -> None:
        remaining.append(lock.exists())
        close(number)

    monkeypatch.setattr("mirdrake.editor.document.os.close", watched)
    document.close()
    assert remaining == [False]
