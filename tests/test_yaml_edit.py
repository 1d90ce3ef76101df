"""Setting values in YAML texts: only the selected values change, and no other byte."""

import math
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from mirdrake.core.errors import ConfigError
from mirdrake.core.yaml_edit import REMOVED, Edit, edit_yaml, scalar_text, value_at
from mirdrake.core.yaml_tree import parse_tree

ROOT = Path(__file__).resolve().parent.parent
FILES = sorted([*ROOT.glob("models/*/*.yaml"), *ROOT.glob("models/*/variants/*.yaml")])
LOOPS = """\
# Gains.
rate: 50             # Hz
speed:               # trims
  kp: 1.0
  ki: 1.0  # [1/s]

wheel_speed:
  kind: servo
  gain: 200          # N m s/rad
steering: {kind: servo, stiffness: 5.0e4, damping: 1.0e3}  # both wheels
"""


def _edited(text: str, *edits: Edit) -> str:
    return edit_yaml(text, edits, name="control.yaml")


def test_a_value_is_replaced_in_place() -> None:
    assert _edited(LOOPS, Edit("wheel_speed.gain", 63.5)) == LOOPS.replace("200 ", "63.5 ")


def test_a_value_in_braces_is_replaced_too() -> None:
    assert _edited(LOOPS, Edit("steering.damping", 70.0)) == LOOPS.replace("1.0e3", "70.0")


def test_an_equal_value_leaves_the_text_unchanged() -> None:
    assert _edited(LOOPS, Edit("steering.stiffness", 50000), Edit("speed.kp", 1)) == LOOPS


def test_a_missing_key_comes_last_in_its_mapping() -> None:
    after = LOOPS.replace("ki: 1.0  # [1/s]\n", "ki: 1.0  # [1/s]\n  max_correction: 2.5\n")
    assert _edited(LOOPS, Edit("speed.max_correction", 2.5)) == after


def test_a_missing_mapping_is_added_with_its_key() -> None:
    assert _edited(LOOPS, Edit("assumed.track.front", 1.5)) == LOOPS + "assumed:\n  track:\n    front: 1.5\n"


def test_a_key_is_taken_out_with_its_line() -> None:
    after = LOOPS.replace("  gain: 200          # N m s/rad\n", "")
    assert _edited(LOOPS, Edit("wheel_speed.gain", REMOVED)) == after
    assert _edited(LOOPS, Edit("steering.kind", REMOVED)) == LOOPS.replace("kind: servo, ", "")
    assert _edited(LOOPS, Edit("steering.damping", REMOVED)) == LOOPS.replace(", damping: 1.0e3", "")
    assert _edited("a: 1\nb: 2", Edit("b", REMOVED)) == "a: 1"


def test_a_comment_is_written_above_its_key_once_and_replaced_by_the_next() -> None:
    first = _edited(LOOPS, Edit("speed.kp", 2.0, comment="tuned on Monday", replaces="tuned "))
    assert first == LOOPS.replace("  kp: 1.0\n", "  # tuned on Monday\n  kp: 2.0\n")
    assert _edited(first, Edit("speed.kp", 2.0, comment="tuned on Monday", replaces="tuned ")) == first
    second = _edited(first, Edit("speed.kp", 3.0, comment="tuned on Tuesday", replaces="tuned "))
    assert second == LOOPS.replace("  kp: 1.0\n", "  # tuned on Tuesday\n  kp: 3.0\n")


def test_a_key_in_braces_has_its_comment_above_the_whole_entry() -> None:
    after = _edited(LOOPS, Edit("steering.damping", 7, comment="tuned"))
    assert "\n# tuned\nsteering: {kind: servo, stiffness: 5.0e4, damping: 7}  # both wheels\n" in after


@pytest.mark.parametrize(
    ("before", "edit", "after"),
    [
        ("", Edit("a.b", 1), "a:\n  b: 1\n"),
        ("# nothing yet", Edit("a", 1), "# nothing yet\na: 1\n"),
        ("a:   # to be filled\n", Edit("a", 3), "a: 3   # to be filled\n"),
        ("a:\n", Edit("a.b.c", 3), "a: {b: {c: 3}}\n"),
        ("a: {}", Edit("a.b", 3), "a: {b: 3}"),
        ("a: ~\nb: 1\n", Edit("a.b", True), "a: {b: true}\nb: 1\n"),
        ("a: 1\r\nb: {c: 2}\r\n", Edit("d", 4), "a: 1\r\nb: {c: 2}\r\nd: 4\r\n"),
        ("a: 1  # no end of line", Edit("d", 4), "a: 1  # no end of line\nd: 4"),
        ("a:\n- b: 1\n- b: 2 # second\n", Edit("a.1.b", 7), "a:\n- b: 1\n- b: 7 # second\n"),
        ("a:\n- b: 1\n- b: 2\n", Edit("a.0.c", 7), "a:\n- b: 1\n  c: 7\n- b: 2\n"),
        ("\ufeffa: 1\n", Edit("a", 2), "\ufeffa: 2\n"),
        ("s:\n  a.b: old  # dotted key\n", Edit(("s", "a.b"), "new: text"), 's:\n  a.b: "new: text"  # dotted key\n'),
        ("a: &x 1\nb: *x  # same\n", Edit("b", 2), "a: &x 1\nb: 2  # same\n"),
        ("a: &x {c: 1}\nb:\n  <<: *x\n", Edit("b.c", 2), "a: &x {c: 1}\nb:\n  <<: *x\n  c: 2\n"),
        ("a: 'it''s\n  long'\nb: 1\n", Edit("a", 2), "a: 2\nb: 1\n"),
        ("a: |\n  text\n\nb: 1\n", Edit("c", 2), "a: |\n  text\n\nb: 1\nc: 2\n"),
        ("---\na: 1\n...\n", Edit("c", 2), "---\na: 1\nc: 2\n...\n"),
        ("a: 1\n", Edit("b.c", (1.0, 2)), "a: 1\nb:\n  c: [1.0, 2]\n"),
        ("a: [1, 2]  # m/s\nb: 3\n", Edit("a", (4, 5.5, 6)), "a: [4, 5.5, 6]  # m/s\nb: 3\n"),
        ("a: [1.0,2]\n", Edit("a", (1, 2)), "a: [1.0,2]\n"),
        ("a: 1\n", Edit("a", (1, 2)), "a: [1, 2]\n"),
    ],
)
def test_odd_layouts(before: str, edit: Edit, after: str) -> None:
    assert edit_yaml(before, [edit]) == after


@pytest.mark.parametrize(
    ("text", "edit", "message"),
    [
        ("a: {b: 1}", Edit("a", 1), "control.yaml:1: a: is a mapping; a single value is expected"),
        ("x: 0\na: 5", Edit("a.b", 1), "control.yaml:2: a: is a single value; a mapping (key: value) is expected"),
        ("a: [1]", Edit("a.3", 1), "control.yaml:1: a: is a list of 1; '3' is not an index of it"),
        ("a: [1]", Edit("a", 1), "control.yaml:1: a: is a list; a single value is expected"),
        ("a:\n- 1\n", Edit("a", (1, 2)), "control.yaml:1: a: is a list in lines; write it in brackets, or remove it"),
        ("a: |\n  x\n", Edit("a", 1), "control.yaml:1: a: is a text of several lines; edit it by hand"),
        (
            "a: &x {b: 1}\nc: *x",
            Edit("c.b", 2),
            "control.yaml:2: c: is an alias; write out its value",
        ),
        (
            "a: &x {b: 1}\nc: *x",
            Edit("a.b", 2),
            "control.yaml:1: a.b: cannot be changed without changing something else; edit the file by hand",
        ),
        ("a: 1", Edit("", 2), "control.yaml: '' is not a path such as speed.kp"),
        ("a: 1", Edit("a", math.nan), "nan cannot be written; it must be a finite number"),
        ("a: 1\n b: 2", Edit("a", 2), "control.yaml:2: not valid YAML: mapping values are not allowed here"),
        ("a: 1", Edit("a", 2, comment="x\ny"), "a: a comment is one line of printable text, not 'x\\ny'"),
    ],
)
def test_impossible_edits_are_rejected(text: str, edit: Edit, message: str) -> None:
    with pytest.raises(ConfigError) as caught:
        _edited(text, edit)
    assert str(caught.value) == message


# --- properties ---


def _leaves(data: Any, path: tuple[str, ...] = ()) -> dict[tuple[str, ...], Any]:
    if isinstance(data, dict | list) and data:
        items = data.items() if isinstance(data, dict) else ((str(k), item) for k, item in enumerate(data))
        return {key: leaf for name, value in items for key, leaf in _leaves(value, (*path, name)).items()}
    return {path: data}


_scalars = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-(10**12), 10**12),
    st.floats(allow_nan=False, allow_infinity=False),
    st.text(),
)


@given(value=_scalars)
def test_every_scalar_reads_back_in_yaml_1_2_and_numbers_in_1_1_as_well(value: Any) -> None:
    text = f"key: {scalar_text(value)}\n"
    assert parse_tree(text, "text")[0] == {"key": value}
    read = yaml.safe_load(text)["key"]
    assert read == value
    assert type(read) is type(value)


@given(key=st.text(min_size=1), value=_scalars)
def test_every_key_can_be_added_to_braces_and_blocks(key: str, value: Any) -> None:
    for text in ("a: {b: 1}\n", "a:\n  b: 1\n"):
        assert parse_tree(edit_yaml(text, [Edit(("a", key), value)]), "text")[0]["a"] == {"b": 1, key: value}


Pieces = list[str | tuple[tuple[str, ...], str]]


@st.composite
def _texts(draw: st.DrawFn) -> Pieces:
    """Return a YAML text of nested mappings with comments, odd spaces, braces and both line ends, in pieces.

    A piece is text that must stay, or the path of a scalar and how it is written.
    """
    newline = draw(st.sampled_from(["\n", "\r\n"]))
    numbers = iter(range(1000))
    pieces: Pieces = []

    def block(path: tuple[str, ...], indent: int, depth: int) -> None:
        for _ in range(draw(st.integers(1, 3))):
            key = f"k{next(numbers)}"
            if draw(st.booleans()):
                pieces.append(draw(st.sampled_from(["", "# note", f"{' ' * indent}# note: {{x}}"])) + newline)
            tail = draw(st.sampled_from(["", "  # why", " #", "   "])) + newline
            kind = draw(st.sampled_from(["scalar", "flow", "map"] if depth < 3 else ["scalar", "flow"]))
            begin = f"{' ' * indent}{key}:"
            if kind == "map":
                pieces.append(begin + tail)
                block((*path, key), indent + draw(st.sampled_from([1, 2, 4])), depth + 1)
            elif kind == "flow":
                pieces.extend([f"{begin} {{ a: ", ((*path, key, "a"), "1"), ",b: ", ((*path, key, "b"), "'x'")])
                pieces.append(" }" + tail)
            else:
                written = ["1", "1.50", "'it''s'", '"a # b"', "two words", "90 deg", "~", "true"]
                pieces.append(begin + " " * draw(st.integers(1, 3)))
                pieces.extend([((*path, key), draw(st.sampled_from(written))), tail])

    block((), 0, 0)
    pieces.append(draw(st.sampled_from(["", "# end", newline])))
    return pieces


def _joined(pieces: Pieces, new: dict[tuple[str, ...], str] | None = None) -> str:
    return "".join(piece if isinstance(piece, str) else (new or {}).get(piece[0], piece[1]) for piece in pieces)


def _paths(pieces: Pieces) -> list[tuple[str, ...]]:
    return [piece[0] for piece in pieces if not isinstance(piece, str)]


@settings(max_examples=80, deadline=None)
@given(pieces=_texts(), value=_scalars, data=st.data())
def test_only_the_wanted_value_changes_and_no_other_byte(pieces: Pieces, value: Any, data: st.DataObject) -> None:
    path = data.draw(st.sampled_from(_paths(pieces)))
    text = _joined(pieces)
    before = _leaves(parse_tree(text, "text")[0])
    after = edit_yaml(text, [Edit(path, value)])
    same = before[path] == value and isinstance(before[path], bool) == isinstance(value, bool)
    assert after == (text if same else _joined(pieces, {path: scalar_text(value)}))
    assert _leaves(parse_tree(after, "text")[0]) == {**before, path: value}


@settings(max_examples=80, deadline=None)
@given(pieces=_texts(), data=st.data())
def test_a_comment_adds_one_line_and_nothing_else(pieces: Pieces, data: st.DataObject) -> None:
    path, text = data.draw(st.sampled_from(_paths(pieces))), _joined(pieces)
    after = edit_yaml(text, [Edit(path, 12345, comment="tuned")])
    lines = after.splitlines()
    index = next(k for k, line in enumerate(lines) if line.strip() == "# tuned")
    assert "\n".join(lines[:index] + lines[index + 1 :]) == "\n".join(_joined(pieces, {path: "12345"}).splitlines())
    assert "12345" in lines[index + 1]


@settings(max_examples=80, deadline=None)
@given(pieces=_texts(), value=_scalars, data=st.data())
def test_a_new_key_can_be_taken_out_again_and_the_old_bytes_are_back(
    pieces: Pieces, value: Any, data: st.DataObject
) -> None:
    path, text = (*data.draw(st.sampled_from(_paths(pieces)))[:-1], "added"), _joined(pieces)
    after = edit_yaml(text, [Edit(path, value)])
    assert value_at(parse_tree(after, "text")[0], path) == value
    assert edit_yaml(after, [Edit(path, REMOVED)]) == text


@pytest.mark.parametrize("file", FILES, ids=lambda file: "/".join(file.parts[-3:]))
def test_numbers_of_every_shipped_file_can_be_set_and_only_their_line_changes(file: Path) -> None:
    text = file.read_bytes().decode()
    data, _ = parse_tree(text, file.name)
    leaves = {path: leaf for path, leaf in _leaves(data).items() if isinstance(leaf, int | float)}
    for path, leaf in list(leaves.items())[::5][:4]:
        if isinstance(leaf, bool):
            continue
        after = edit_yaml(text, [Edit(path, leaf + 1.25)], name=file.name)
        assert _leaves(parse_tree(after, file.name)[0]) == {**_leaves(data), path: leaf + 1.25}
        changed = [(a, b) for a, b in zip(text.split("\n"), after.split("\n"), strict=True) if a != b]
        assert len(changed) == 1
