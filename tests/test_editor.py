"""The world editor without a browser: changes of the file by gestures, and marks on the map."""

import json
import os
import random
import socket
import subprocess
import sys
import threading
import time
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
from mirdrake.editor.gestures import read_gesture, with_line_ends
from mirdrake.editor.marks import mark_overlaps
from mirdrake.editor.scene import Scene, read_scene
from mirdrake.editor.values import lock_reason, plain_number, write_number
from mirdrake.world_checks.overlaps import find_overlaps
from mirdrake.worlds import load_world

YARD = """\
mirdrake: world/1
params: {pitch: 4}
tracks:
  lane: {segments: [{line: 60}], start: {at: [0, 20]}}
  bend: {points: [[0, 70], [30, 76], [60, 70.50], [90, 76]]}
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
start: {gate: {at: [-10, 0], yaw: 0 deg}, road: {on_track: {track: lane, s: 3}}, free: {}}
goals: {exit: {at: [40, 0]}, line: {gate: {track: lane, s: 50}}}
actors:
  - {actor: pedestrian, name: walker, path: [[30, 15], [30, 25 m]], speed: 1.4, starts: {when: ego within 25 m}}
  - {actor: sedan, name: lead, on_track: {track: lane, s: 20, offset: 0.5}, starts: {when: ego past lane@10}}
  - {actor: van, name: row, along: {track: lane, s: 30, spacing: 9, count: 3}}
  - {actor: sedan, name: late, on_track: {track: lane, s: 10*$pitch}, starts: {when: ego past lane@2*$pitch}}
scenario:
  lead: [{at: 2 s, stop: {}}, {when: walker past lane@40, go: {}}]
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
        ("props/1", "spacing", (10.85, 0.3), "to: [20, 0], count: 3", "to: [20, 0], count: 5"),
        ("props/2", "count", (7.2, 1.4), "count: [2, 2]", "count: [4, 1]"),
        ("props/4", "count", (32.5, 4.33), "radius: 5 m, count: 4", "radius: 5 m, count: 6"),
        ("props/5", "spacing", (11.6, 20.0), "s: [10, 20], count: 2", "s: [10, 20], count: 3"),
        ("props/4", "body", (31.0, 1.0), "center: [30, 0]", "center: [31, 1]"),
        ("props/4", "radius", (30.0, 6.5), "radius: 5 m", "radius: 6.5 m"),
        ("props/5", "end", (24.0, 25.0), "s: [10, 20]", "s: [10, 24]"),
        ("props/6", "body", (5.0, 41.0), "center: [0, 40]", "center: [5, 41]"),
        ("start/gate", "body", (-12.0, 1.0), "at: [-10, 0]", "at: [-12, 1]"),
        ("start/road", "body", (7.0, 22.0), "s: 3}", "s: 7}"),
        ("goals/exit", "radius", (43.0, 4.0), "at: [40, 0]}", "at: [40, 0], radius: 5}"),
        ("goals/line", "body", (45.0, 18.0), "s: 50", "s: 45"),
        ("ground/patches/0", "corner", (4.0, -17.0), "size: [6, 4]", "size: [8, 6]"),
        ("start/free", "body", (5.0, 6.0), "free: {}", "free: {at: [5, 6]}"),
        ("start/free", "yaw", (0.0, 9.0), "free: {}", "free: {yaw: 90 deg}"),
        ("actors/0", "body", (32.0, 20.0), "[[30, 15], [30, 25 m]]", "[[32, 15], [32, 25 m]]"),
        ("actors/0", "point 1", (29.0, 27.0), "[30, 25 m]", "[29, 27 m]"),
        ("actors/0", "trigger", (10.0, 15.0), "ego within 25 m", "ego within 20 m"),
        ("actors/1", "body", (24.0, 20.5), "s: 20, offset", "s: 24, offset"),
        ("actors/1", "body", (20.0, 26.0), "offset: 0.5", "offset: 1.5"),
        ("actors/1", "trigger", (12.5, 20.0), "ego past lane@10}", "ego past lane@12.5}"),
        ("actors/1", "trigger 1", (44.0, 25.0), "walker past lane@40", "walker past lane@44"),
        ("actors/2", "body", (28.0, 21.0), "s: 30, spacing", "s: 28, spacing"),
        ("actors/2", "spacing", (41.0, 20.0), "spacing: 9", "spacing: 11"),
        ("tracks/bend", "point 1", (31.0, 77.0), "[30, 76]", "[31, 77]"),
        ("tracks/bend", "point 2", (61.0, 70.5), "[60, 70.50]", "[61, 70.50]"),
        ("tracks/lane", "body", (1.0, 21.0), "start: {at: [0, 20]}", "start: {at: [1, 21]}"),
        ("tracks/lane", "yaw", (9.0, 29.0), "at: [0, 20]}", "at: [0, 20], yaw: 45 deg}"),
    ],
)
def test_a_moved_handle_changes_its_values_alone(yard, element, handle, position, old, new):
    x, y = position
    after = drag(yard, element, x, y, handle)
    assert after == YARD.replace(old, new)
    assert read_scene(after, PATH).world.name == "yard"


QUOTED = """\
mirdrake: world/1
tracks: {lane: {segments: [{line: 60}]}}
props:
  - {prop: sedan, name: "car", at: ["3 m", '4'], yaw: '90 deg'}
actors:
  - {actor: pedestrian, name: a, path: [[30, 15], [30, 25]], speed: 1.4, starts: {when: "ego within 25 m"}}
  - {actor: sedan, name: b, on_track: {track: lane, s: 20}, speed: 3, starts: {when: 'ego past lane@10'}}
scenario:
  b: [{when: "a past lane@40", go: {}}]
"""


@pytest.mark.parametrize(
    ("element", "handle", "position", "old", "new"),
    [
        ("props/0", "body", (5.0, 6.0), """["3 m", '4']""", """["5 m", '6']"""),
        ("props/0", "yaw", (9.0, 4.0), "'90 deg'", "'0 deg'"),
        ("actors/0", "trigger", (10.0, 15.0), '"ego within 25 m"', '"ego within 20 m"'),
        ("actors/1", "trigger", (12.5, 1.0), "'ego past lane@10'", "'ego past lane@12.5'"),
        ("actors/1", "trigger 1", (44.0, 1.0), '"a past lane@40"', '"a past lane@44"'),
    ],
)
def test_a_dragged_value_keeps_its_quotes(element, handle, position, old, new):
    scene = read_scene(QUOTED, PATH)
    x, y = position
    after = drag(scene, element, x, y, handle)
    assert after == QUOTED.replace(old, new)
    read_scene(after, PATH)


def test_the_name_of_a_copy_keeps_its_quotes():
    after = changed(read_scene(QUOTED, PATH), kind="copy", elements=["props/0"], dx=1.0, dy=0.0)
    assert """- {prop: sedan, name: "car_2", at: ["4 m", '4'], yaw: '90 deg'}""" in after


def test_a_value_that_is_not_a_plain_number_is_not_dragged(yard):
    with pytest.raises(LockedError, match=r"2\*\$pitch depends on \$pitch"):
        drag(yard, "props/3", 1.0, 1.0)
    with pytest.raises(LockedError, match="follows the track"):
        drag(yard, "props/5", 1.0, 1.0)
    for handle in ("body", "trigger"):
        with pytest.raises(LockedError, match=r"\$pitch depends on \$pitch"):
            drag(yard, "actors/3", 1.0, 1.0, handle)
    assert lock_reason("0 +- 3 deg") == "0 +- 3 deg is drawn at random; change it in the panel"


@pytest.mark.parametrize(
    ("entry", "position", "written"),
    [
        ("line: {from: [0, 0], to: [12, 0], spacing: 4 m}", (1.0, 0.0), "spacing: 3 m"),
        ("line: {from: [0, 0], to: [12, 0], count: 1}", (2.0, 0.0), "count: 3"),
        ("along: {track: loop, count: 4}", (13.0, 0.0), "count: 2"),  # 78.8 m round: a prop each 39 m
        ("along: {track: lane, s: [20, 8], count: 3}", (39.0, 0.0), "count: 5"),  # backwards from x = 40 m
    ],
)
def test_the_handle_between_two_props_changes_their_number_or_spacing(entry, position, written):
    tracks = (
        "tracks: {lane: {segments: [{line: 60}], start: {at: [20, 0]}}, loop: {closed: true, segments: ["
        + ", ".join(["{line: 15}, {arc: {radius: 3, angle: 90 deg}}"] * 4)
        + "]}}"
    )
    text = f"mirdrake: world/1\n{tracks}\nprops:\n  - {{prop: cone, {entry}}}\n"
    scene = read_scene(text, PATH)
    handle = scene.elements["props/0"].handle("spacing")
    assert drag(scene, "props/0", handle.x, handle.y, "spacing") == text
    x, y = position
    assert written in drag(scene, "props/0", x, y, "spacing")


def test_a_count_that_is_not_plain_leaves_the_other_handles():
    text = "mirdrake: world/1\nparams: {n: 3}\nprops:\n  - {prop: cone, grid: {step: [2, 2], count: [$n, 1]}}\n"
    assert [handle.name for handle in read_scene(text, PATH).elements["props/0"].handles] == ["body", "step"]


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


@pytest.mark.parametrize(
    ("element", "index", "x", "y", "old", "new"),
    [
        ("tracks/bend", 1, 15, 74, "[30, 76]", "[15, 74], [30, 76]"),
        ("tracks/bend", 4, 120, 70, "[90, 76]]", "[90, 76], [120, 70]]"),
        ("actors/0", 1, 33, 20, "[30, 25 m]", "[33, 20], [30, 25 m]"),
    ],
)
def test_a_point_is_added_and_removed_in_its_line(yard, element, index, x, y, old, new):
    after = changed(yard, kind="insert_point", element=element, index=index, x=x, y=y)
    assert after == YARD.replace(old, new)
    assert changed(read_scene(after, PATH), kind="delete_point", element=element, index=index) == YARD
    with pytest.raises(LockedError, match="it has no points"):
        changed(yard, kind="delete_point", element="props/0", index=0)


def test_an_actor_is_dropped_on_the_road_below_it_and_a_pedestrian_gets_a_path(yard):
    after = changed(yard, kind="insert", what="actor", name="van", x=10.0, y=20.5)
    assert "\n  - {actor: van, on_track: {track: lane, s: 10}, speed: 8}\n" in after
    for name, x, y in (("pedestrian", 10.0, 20.5), ("sedan", -30.0, -30.0)):
        scene = read_scene(changed(yard, kind="insert", what="actor", name=name, x=x, y=y), PATH)
        path = scene.data["actors"][-1]["path"]
        assert path[0] == [x, y]
        assert len(scene.world.actors) == len(yard.world.actors) + 1


@pytest.mark.parametrize("start", ["", "start:\n", "start: {}\n", "start: {gate: }\n"])
def test_a_start_without_a_position_gets_one(start):
    text = f"mirdrake: world/1\n{start}goals: {{a: {{at: [1, 2]}}}}\n"
    if start in {"start:\n", "start: {gate: }\n"}:
        with pytest.raises(ConfigError, match="null is not a mapping"):
            read_scene(text, PATH)
        return
    scene = read_scene(text, PATH)
    after = drag(scene, "start/origin", 3.0, 4.0)
    added = "start: {origin: {at: [3, 4]}}\n"
    assert after == (text.replace(start, added) if start else text + added)


def test_line_ends_of_a_file_survive_typing():
    before = "a: 1\r\nb: 2\nc: 3\r\nd: 4"
    assert with_line_ends("a: 1\nb: 2\nc: 3\nd: 4", before) == before
    assert with_line_ends("a: 1\nb: 5\nx: 0\nc: 3\nd: 4\n", before) == "a: 1\r\nb: 5\r\nx: 0\r\nc: 3\r\nd: 4\r\n"
    assert with_line_ends("a: 1\nd: 4", before) == "a: 1\r\nd: 4"
    assert with_line_ends("x\n", "") == "x\n"


def test_a_deleted_entry_goes_with_its_comment(yard):
    after = changed(yard, kind="delete", elements=["props/1", "props/0"])
    assert "mine" not in after
    assert "a row of cones" not in after
    assert len(after.splitlines()) == len(YARD.splitlines()) - 3


def test_a_copy_is_displaced_and_has_its_own_name(yard):
    after = changed(yard, kind="copy", elements=["props/0", "props/1"], dx=1.0, dy=-1.0)
    begin = next(number for number, line in enumerate(YARD.splitlines()) if line.startswith("start:"))
    assert after.splitlines()[begin : begin + 2] == [
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


def test_a_text_that_was_not_saved_survives_the_end_of_its_editor(tmp_path):
    path = tmp_path / "yard.yaml"
    path.write_text(YARD, encoding="utf-8")
    document = Document(path)
    document.change(YARD + "# mine\n")
    # The end of the process: the lock is released, and nothing else is done.
    assert document._lock is not None
    os.close(document._lock)
    after = Document(path)
    assert after.restored
    assert after.text == YARD + "# mine\n"
    assert path.read_text(encoding="utf-8") == YARD
    after.undo()
    assert after.text == YARD
    after.redo()
    after.close()
    # Another program changes the file before the next editor is opened: it asks before it overwrites.
    path.write_text(YARD + "# theirs\n", encoding="utf-8")
    last = Document(path)
    assert last.text == YARD + "# mine\n"
    with pytest.raises(RunError, match="another program has changed this file"):
        last.save()
    last.save(overwrite=True)
    last.close()
    assert [file.name for file in tmp_path.iterdir()] == ["yard.yaml"]


def test_an_editor_that_closes_between_the_two_steps_of_a_lock_leaves_one_writer(tmp_path, monkeypatch):
    import fcntl

    path = tmp_path / "yard.yaml"
    path.write_text(YARD, encoding="utf-8")
    first, lock = Document(path), fcntl.flock
    closed: list[bool] = []

    def flock(file: int, operation: int) -> None:
        # The second editor has opened the lock file of the first, which now closes and removes it.
        if not closed:
            closed.append(True)
            first.close()
        lock(file, operation)

    monkeypatch.setattr(fcntl, "flock", flock)
    second = Document(path)
    third = Document(path)
    assert (second.read_only, third.read_only) == ("", "open in another editor; close that one first")
    second.close()


KILLED = """
import random, sys
from pathlib import Path
from mirdrake.editor.document import Document
document, number = Document(Path(sys.argv[1])), 0
begin = document.text.split("# step")[0]
print("ready", flush=True)
while True:
    number += 1
    document.change(f"{begin}# step {number} {'x' * random.randrange(200_000)}\\n")
    print(number, flush=True)
    if random.random() < 0.3:
        document.save()
"""


@pytest.mark.slow
def test_an_editor_killed_at_any_moment_leaves_a_whole_file_and_its_last_text(tmp_path):
    path = tmp_path / "yard.yaml"
    path.write_text(YARD, encoding="utf-8")
    rng = random.Random(5)
    for _ in range(8):
        process = subprocess.Popen([sys.executable, "-c", KILLED, str(path)], stdout=subprocess.PIPE, text=True)
        assert process.stdout is not None
        process.stdout.readline()
        time.sleep(rng.uniform(0.0, 0.2))
        process.kill()
        with process.stdout:
            steps = [int(line) for line in process.stdout.read().split("\n")[:-1] if line.isdecimal()]
        process.wait()
        text = path.read_text(encoding="utf-8")
        assert text == YARD or text.endswith(("x\n", " \n"))
        document = Document(path)
        # The last step that was reported, or the one that was being made.
        found = int(document.text.rpartition("# step ")[2].split(" ")[0]) if "# step" in document.text else 0
        assert found in {steps[-1], steps[-1] + 1} if steps else found <= 1 or document.text == text
        document.save(overwrite=True)
        document.close()


def test_a_new_world_is_written_by_the_first_save(tmp_path):
    document = Document(tmp_path / "new.yaml")
    assert not document.is_saved
    assert not (tmp_path / "new.yaml").exists()
    # Nothing is lost if it is closed without a change, so that no warning is printed.
    assert not document.is_kept
    document.change(document.text + "# a comment\n")
    assert document.is_kept
    document.save()
    assert not document.is_kept
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
    assert {"what": "actor", "name": "sedan"} in post(editor, "palette")["palette"]
    reply = post(editor, "gesture", kind="drag", moves=[{"element": "props/0", "x": 5, "y": 6}])
    assert "at: [5, 6], yaw: 90 deg" in reply["text"]
    assert not reply["saved"]
    assert post(editor, "undo")["text"] == YARD
    assert post(editor, "redo")["text"] == reply["text"]
    assert post(editor, "save")["saved"]
    assert editor.document.path.read_text("utf-8") == reply["text"]


def test_overlaps_are_marked_while_a_prop_is_dragged(editor):
    post(editor, "gesture", kind="insert", what="prop", name="barrel", x=-30.0, y=-30.0)
    post(editor, "gesture", kind="insert", what="prop", name="barrel", x=-30.2, y=-30.0)
    moves = [{"element": "props/0", "handle": "body", "x": 10.0, "y": 0.0}]
    marks = post(editor, "preview", moves=moves, sequence=7)
    assert marks["sequence"] == 7
    names = [frozenset(mark["names"]) for mark in marks["marks"]]
    # An overlap of others stays.
    assert names.count(frozenset({"car", "cone[0]"})) == 1
    assert len(names) == 2
    post(editor, "undo")
    assert post(editor, "undo")["text"] == YARD


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
    (fault,) = reply["faults"]
    assert fault["line"] == 10
    assert fault["title"].endswith(fault["text"].removeprefix("line 10"))
    assert fault["title"].partition(":10: ")[0].endswith("yard.yaml")
    assert post(editor, "gesture", kind="text", value=YARD)["faults"] == []


def test_only_the_files_of_the_page_are_served(editor):
    for path in ("editor.js", "map.js", "editor.css"):
        assert urllib.request.urlopen(editor.url + path, timeout=10).status == 200
    assert urllib.request.urlopen(editor.url + "palette/prop/cone.png", timeout=30).read().startswith(b"\x89PNG")
    unknown = ("palette/prop/..%2F..%2Fcone.png", "palette/group/nothing.png", "replay/..%2Fyard.yaml")
    for path in ("editor.py", "../editor.py", "page/editor.js", "nothing.js", *unknown):
        with pytest.raises(urllib.error.HTTPError):
            urllib.request.urlopen(editor.url + path, timeout=10)


# --- many gestures ------------------------------------------------------------------------------------------------


def random_gesture(scene: Scene, rng: random.Random) -> dict[str, Any]:
    """Return a gesture that a user might make: drags most often, then inserts, copies, deletes and typed values."""
    keys = list(scene.elements)
    kind = rng.choice(["drag", "drag", "drag", "insert", "copy", "delete", "expand", "set"])
    x, y = round(rng.uniform(-60, 60), 2), round(rng.uniform(-60, 60), 2)
    if kind == "insert" or not keys:
        kinds = [("prop", "cone"), ("prop", "barrel"), ("start", "start"), ("goal", "goal"), ("actor", "sedan")]
        what, name = rng.choice(kinds)
        return {"kind": "insert", "what": what, "name": name, "x": x, "y": y}
    key = rng.choice(keys)
    if kind == "drag":
        handle = rng.choice(scene.elements[key].handles).name
        return {"kind": "drag", "moves": [{"element": key, "handle": handle, "x": x, "y": y}]}
    if kind == "copy":
        return {"kind": "copy", "elements": [key], "dx": x, "dy": y}
    if kind == "delete":
        if scene.elements[key].points is not None:
            point = {"element": key, "index": 1}
            return rng.choice([point | {"kind": "delete_point"}, point | {"kind": "insert_point", "x": x, "y": y}])
        return {"kind": "delete", "elements": [key]}
    if kind == "expand":
        return {"kind": "expand", "element": key}
    return {"kind": "set", "path": [*scene.elements[key].path, "yaw"], "value": f"{rng.randrange(360)} deg"}


@pytest.mark.parametrize(
    ("seeds", "gestures"), [(range(1), 12), pytest.param(range(1, 60), 50, marks=pytest.mark.slow)], ids=["1", "59"]
)
def test_after_random_gestures_the_file_means_what_is_shown_and_undo_restores_every_byte(seeds, gestures, tmp_path):
    for seed in seeds:
        rng = random.Random(seed)
        path = tmp_path / f"yard{seed}.yaml"
        begin = rng.choice([YARD, YARD.replace("\n", "\r\n"), "mirdrake: world/1"])
        path.write_bytes(begin.encode())
        document, scene, created = Document(path), read_scene(begin, path), 0
        for _ in range(gestures):
            try:
                text = read_gesture(random_gesture(scene, rng)).text(scene, "yard.yaml")
                after = read_scene(text, path)
            except (LockedError, MirdrakeError):
                continue
            document.change(text)
            scene, created = after, created + (text != begin)
        assert created > gestures / 4
        document.save()
        saved = load_world(str(path))
        assert [placed.name for placed in saved.props] == [placed.name for placed in scene.world.props]
        assert saved.actors == scene.world.actors
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
