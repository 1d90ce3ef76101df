"""The world editor on generated worlds: comments, odd indentation, flow style, anchors, CRLF; and all shipped ones."""

import random
from dataclasses import dataclass
from difflib import unified_diff
from pathlib import Path
from typing import Any

import pytest

from mirdrake.core.errors import MirdrakeError
from mirdrake.core.paths import data_root
from mirdrake.editor.document import Document
from mirdrake.editor.elements import LockedError
from mirdrake.editor.gestures import read_gesture, with_line_ends
from mirdrake.editor.scene import Scene, read_scene

PATH = Path("generated.yaml").resolve()
COMMENTS = ("# mine", "#", "#: {prop: cone, at: [1, 2]}", "# - {prop: tree}", "# °µ — “quoted”", "# 'open", "#\ttab")


@dataclass(frozen=True)
class Entry:
    """An entry of `props` as it was generated: its lines with the comments above, and what a gesture may do."""

    lines: tuple[str, ...]
    draggable: bool = True
    removable: bool = True


def comment(rng: random.Random) -> str:
    return rng.choice(COMMENTS)


def entry(rng: random.Random, indent: str, number: int) -> Entry:
    """Return an entry in a random style, with comment lines above that belong to it."""
    x, y = rng.choice(["1", "-2.50", "3 m", "250 cm", "+4", "0.125"]), rng.choice(["7", "-1e1", "12.0", "3.5 m"])
    kind, trail = rng.choice(["cone", "barrel", "tree"]), rng.choice(["", "", "  " + comment(rng)])
    pad = " " * rng.choice([1, 1, 2, 3])
    deep = indent + " " + pad
    gap, turn = rng.choice(["", " "]), rng.randrange(360)
    style = rng.choice(["flow", "flow", "lines", "block", "quoted", "list", "random", "grid"])
    body = {
        "flow": [f"-{pad}{{{gap}prop: {kind}, at: [{gap}{x},{gap or ' '}{y}{gap}], yaw: {turn} deg{gap}}}{trail}"],
        "lines": [f"-{pad}{{prop: {kind},{trail}", f"{deep}at: [{x}, {y}]}}"],
        "block": [f"-{pad}prop: {kind}{trail}", f"{deep}at: [{x}, {y}]", f"{deep}color: red"],
        "quoted": [f"""-{pad}{{"prop": '{kind}', 'at': ["{x}", '{y}'], name: "n{number}"}}{trail}"""],
        "list": [f"-{pad}prop: {kind}", f"{deep}at:{trail}", f"{deep}- {x}", f"{deep}- {y}"],
        "random": [f"-{pad}{{prop: {kind}, at: [{x}, 3 +- 0.5]}}{trail}"],
        "grid": [f"-{pad}{{prop: {kind}, grid: {{origin: [{x}, {y}], step: [3, 3], count: [2, 2]}}}}{trail}"],
    }[style]  # fmt: skip
    above = [comment(rng) for _ in range(rng.choice([0, 0, 1, 2]))]
    lines = [indent + above_line for above_line in above] + [indent + body[0], *body[1:]]
    return Entry(tuple(lines), draggable=style != "random")


def anchored(rng: random.Random, indent: str) -> list[Entry]:
    """Return an entry with an anchor and two that depend on it."""
    return [
        Entry(
            (f"{indent}- &base {{prop: cone, at: [{rng.randrange(9)}, 5], scale: 1.5}}",),
            draggable=False,
            removable=False,
        ),
        Entry((f"{indent}- {{<<: *base, at: [4, {rng.randrange(9)}]}}",)),
        Entry((f"{indent}- *base",), draggable=False),
    ]


def generated(rng: random.Random) -> tuple[str, list[Entry], str]:
    """Return the text of a world, the entries of its props, and its line end."""
    indent = rng.choice(["", " ", "  ", "    "])
    entries = [entry(rng, indent, number) for number in range(rng.randrange(2, 7))]
    if rng.random() < 0.3:
        entries[1:1] = anchored(rng, indent)
    head = ["mirdrake: world/1", *rng.choice([[], ["", comment(rng)], ["---"][:0]])]
    head += rng.choice([[], ["params: {a: 3}  # of nothing"], ["ground:", "    surface:   grass # green", ""]])
    groups = ["groups:", "   pair:", "      props: [{prop: cone, at: [0, 0]}, {prop: cone, at: [2, 0]}]", ""]
    head += groups if rng.random() < 0.3 else []
    lines = [*head, rng.choice(["props:", "props:   # all of them"])]
    for one in entries:
        # A blank line or a comment of another indentation belongs to no entry.
        lines += [*rng.choice([[], [], [""], ["", indent + "      # of nobody"]]), *one.lines]
    lines += rng.choice(
        [[], ["start: {gate: {at: [-9, -9]}}"], ["", "# the end", "goals: {exit: {at: [90, 90]}}", comment(rng)]]
    )
    newline = rng.choice(["\n", "\n", "\n", "\r\n"])
    return newline.join(lines) + rng.choice([newline, newline, ""]), entries, newline


def changed_lines(before: str, after: str) -> int:
    """Return how many lines differ; both texts have as many."""
    return sum(a != b for a, b in zip(before.splitlines(True), after.splitlines(True), strict=True))


def text_after(scene: Scene, **gesture: Any) -> str:
    return read_gesture(gesture).text(scene, "generated.yaml")


def examine(seed: int, folder: Path) -> int:
    """Drag, insert, delete, type and undo in a generated world; return how many gestures were made."""
    rng = random.Random(seed)
    text, entries, newline = generated(rng)
    path, made = folder / f"w{seed}.yaml", 0
    path.write_bytes(text.encode())
    document, scene = Document(path), read_scene(text, PATH)
    for number, one in enumerate(entries):
        key = f"props/{number}"
        handle = scene.elements[key].handles[0]
        moves = [{"element": key, "handle": "body", "x": 17.25, "y": handle.y}]
        if not one.draggable:
            with pytest.raises((LockedError, MirdrakeError)):
                text_after(scene, kind="drag", moves=moves)
        else:
            # Only x changes, so that also a position in two lines changes in one.
            after = text_after(scene, kind="drag", moves=moves)
            assert changed_lines(text, after) == 1, (seed, number)
            moved = read_scene(after, PATH).elements[key].handles[0]
            assert (moved.x, moved.y) == pytest.approx((17.25, handle.y), abs=1e-9)
            document.change(after)
            made += 1
        try:
            after = text_after(scene, kind="delete", elements=[key])
        except MirdrakeError:
            assert not one.removable, (seed, number)
            continue
        assert one.removable
        whole = newline.join(one.lines)
        # Without a line break at the end, the one before the entry goes.
        expected = (
            text.replace(whole + newline, "", 1) if whole + newline in text else text.replace(newline + whole, "", 1)
        )
        assert after == expected or text.count(whole) > 1, (seed, number)
        document.change(after)
        made += 1
    after = text_after(scene, kind="insert", what="prop", name="van", x=-30.5, y=4.0)
    rows = after.splitlines()
    new = [row for row in rows if row.strip() == "- {prop: van, at: [-30.5, 4]}"]
    assert len(new) == 1
    rows.remove(new[0])
    assert rows == text.splitlines()
    assert after.count("\r") == (after.count("\n") if newline == "\r\n" else 0)
    document.change(after)
    # The browser shows the text with line feeds only.
    assert with_line_ends(text.replace("\r\n", "\n"), text) == text
    while document.can_undo:
        document.undo()
    document.save()
    assert path.read_bytes() == text.encode()
    document.close()
    return made


@pytest.mark.parametrize("seeds", [range(3), pytest.param(range(3, 1000), marks=pytest.mark.slow)], ids=["3", "997"])
def test_gestures_in_generated_worlds_change_their_lines_alone_and_undo_restores_every_byte(seeds, tmp_path):
    assert sum(examine(seed, tmp_path) for seed in seeds) > 4 * len(seeds)


def test_every_element_of_the_shipped_worlds_is_dragged_within_its_own_lines_or_states_why():
    """Each body moves by 1 m: only lines of the element change, and its body is at the new place."""
    moved = locked = 0
    for source in sorted((data_root() / "worlds").glob("p*.yaml")):
        text = source.read_text(encoding="utf-8")
        scene = read_scene(text, source)
        for key, element in scene.elements.items():
            body = element.handles[0]
            if body.lock:
                locked += 1
                continue
            moves = [{"element": key, "handle": "body", "x": body.x + 1.0, "y": body.y}]
            after = text_after(scene, kind="drag", moves=moves)
            lines = list(unified_diff(text.splitlines(), after.splitlines(), n=0, lineterm=""))[2:]
            # One line differs, or one is added for a value that was not there.
            assert sum(line[0] == "+" for line in lines) <= 1 >= sum(line[0] == "-" for line in lines), (source, key)
            moved += 1
    assert moved > 10
    assert locked > 0
