"""Edits of list items and scalars in YAML texts: each changes its target and keeps every other byte."""

import random

import pytest
import yaml

from mirdrake.core.errors import ConfigError
from mirdrake.core.yaml_items import find_span, insert_item, item_text, remove_item, set_scalar

YARD = """\
# a yard
mirdrake: world/1   # the format
props:
  # the first car
  # is red
  - {prop: sedan, at: [0, 0]}  # parked

  # a comment of nobody

  - prop: van      # in lines
    at: [5, 2.50]
    yaw: 90 deg
  - {prop: cone, at: [1, 1]}
rules: [{min_gap: 0.4}]
"""


def test_a_scalar_is_replaced_where_it_is() -> None:
    assert set_scalar(YARD, ("props", "1", "yaw"), "45 deg") == YARD.replace("90 deg", "45 deg")
    assert set_scalar(YARD, ("props", "0", "at", "1"), "-3.5") == YARD.replace("[0, 0]", "[0, -3.5]")


def test_a_missing_key_is_added_to_its_mapping() -> None:
    assert set_scalar(YARD, ("props", "0", "yaw"), "5 deg") == YARD.replace("[0, 0]}", "[0, 0], yaw: 5 deg}")
    assert set_scalar(YARD, ("props", "1", "z"), "1") == YARD.replace("90 deg\n", "90 deg\n    z: 1\n")


def test_an_inserted_item_is_one_more_line_at_the_end_of_its_list() -> None:
    item = "{prop: tree, at: [9, 9]}"
    expected = YARD.replace("[1, 1]}\n", f"[1, 1]}}\n  - {item}\n")
    assert insert_item(YARD, ("props",), item) == expected


def test_a_missing_list_is_added() -> None:
    assert insert_item("a: 1\n", ("props",), "{prop: tree}") == "a: 1\nprops:\n  - {prop: tree}\n"
    assert insert_item("a: 1", ("props",), "{prop: tree}") == "a: 1\nprops:\n  - {prop: tree}"
    assert insert_item("props: []\nb: 2\n", ("props",), "{a: 1}") == "props: [{a: 1}]\nb: 2\n"
    assert insert_item("props:\nb: 2\n", ("props",), "{a: 1}") == "props:\n  - {a: 1}\nb: 2\n"


def test_an_item_goes_with_the_comments_directly_above_it() -> None:
    text = remove_item(YARD, ("props", "0"))
    assert text == YARD.replace("  # the first car\n  # is red\n  - {prop: sedan, at: [0, 0]}  # parked\n", "")
    text = remove_item(YARD, ("props", "1"))
    assert text == YARD.replace("  - prop: van      # in lines\n    at: [5, 2.50]\n    yaw: 90 deg\n", "")


def test_the_last_item_takes_the_key_of_its_list() -> None:
    assert remove_item("a: 1\nprops:\n  - {b: 2}\n", ("props", "0")) == "a: 1\n"
    assert remove_item(YARD, ("rules", "0")) == YARD.replace("rules: [{min_gap: 0.4}]\n", "")


def test_items_in_brackets_are_removed_with_their_comma() -> None:
    text = "p: [{a: 1}, {b: 2}, {c: 3}]\n"
    assert remove_item(text, ("p", "0")) == "p: [{b: 2}, {c: 3}]\n"
    assert remove_item(text, ("p", "2")) == "p: [{a: 1}, {b: 2}]\n"


def test_an_item_of_several_lines_is_copied() -> None:
    item = item_text(YARD, ("props", "1"))
    assert item is not None
    data = yaml.safe_load(insert_item(YARD, ("props",), item))
    assert data["props"][3] == data["props"][1] == {"prop": "van", "at": [5, 2.5], "yaw": "90 deg"}


def test_line_ends_of_windows_are_kept() -> None:
    text = YARD.replace("\n", "\r\n")
    assert insert_item(text, ("props",), "{prop: tree}").count("\r\n") == text.count("\r\n") + 1
    assert "\n" not in remove_item(text, ("props", "0")).replace("\r\n", "")


def test_anchors_of_aliases_are_not_removed() -> None:
    text = "p:\n  - &one {a: 1}\n  - *one\n"
    with pytest.raises(ConfigError, match=r"p\.0: cannot be changed"):
        remove_item(text, ("p", "0"))
    with pytest.raises(ConfigError, match="alias"):
        set_scalar(text, ("p", "1"), "{a: 2}")


def test_a_value_that_is_not_yaml_is_rejected() -> None:
    with pytest.raises(ConfigError):
        set_scalar(YARD, ("props", "0", "at"), "[1, 2")
    with pytest.raises(ConfigError, match="cannot be changed"):
        set_scalar(YARD, ("props", "0", "prop"), "sedan, yaw: 3")


def test_the_lines_of_an_item_are_found() -> None:
    span = find_span(YARD, ("props", "1"))
    assert span is not None
    assert (span.first_line, span.last_line) == (10, 12)


def _random_text(rng: random.Random) -> str:
    """Return a list of items in several layouts with comments and blank lines between them."""
    lines = ["# head", "a: 1", "p:"] if rng.random() < 0.5 else ["p:"]
    for index in range(rng.randint(1, 6)):
        lines += [f"  # about {index}"] * rng.randint(0, 2)
        tail = rng.choice(["", "  # behind", "   "])
        if rng.random() < 0.5:
            lines.append(f"  - {{n: {index}, at: [{rng.randint(0, 9)}, {rng.random():.2f}]}}{tail}")
        else:
            lines += [f"  - n: {index}{tail}", f"    at: [{rng.randint(0, 9)}, 2]{rng.choice(['', '  # there'])}"]
        lines += [""] * rng.randint(0, 1)
    lines += rng.choice([[], ["# tail"], ["b: 2"], ["b: {c: [1, 2]}  # end"]])
    newline = rng.choice(["\n", "\r\n"])
    return newline.join(lines) + rng.choice([newline, ""])


@pytest.mark.parametrize("seed", range(20))
def test_random_edits_mean_what_they_should_and_can_be_undone_by_hand(seed: int) -> None:
    rng = random.Random(seed)
    for _ in range(15):
        text = _random_text(rng)
        data = yaml.safe_load(text)
        count = len(data["p"])
        index = rng.randrange(count)
        changed = set_scalar(text, ("p", str(index), "at", "0"), "42")
        differing = [pair for pair in zip(text.splitlines(), changed.splitlines(), strict=True) if pair[0] != pair[1]]
        assert len(differing) == (data["p"][index]["at"][0] != 42)
        longer = insert_item(text, ("p",), "{n: 99}")
        assert yaml.safe_load(longer) == {**data, "p": [*data["p"], {"n": 99}]}
        assert len(longer.splitlines()) == len(text.splitlines()) + 1
        assert remove_item(longer, ("p", str(count))) == text
        if count > 1:
            shorter = yaml.safe_load(remove_item(text, ("p", str(index))))
            assert shorter == {**data, "p": data["p"][:index] + data["p"][index + 1 :]}


def test_a_missing_value_is_added_with_the_mappings_above_it() -> None:
    assert set_scalar(YARD, ("start", "gate", "at"), "[1, 2]") == f"{YARD}start: {{gate: {{at: [1, 2]}}}}\n"
    empty = "a: {b: }\nc:   # nothing\nd: {}\n"
    assert set_scalar(empty, ("a", "b", "x"), "1") == empty.replace("b: }", "b: {x: 1} }")
    assert set_scalar(empty, ("c", "x", "z"), "1") == empty.replace("c:", "c: {x: {z: 1}}", 1)
    assert set_scalar(empty, ("d", "x", "z"), "1") == empty.replace("d: {}", "d: {x: {z: 1}}")
    with pytest.raises(ConfigError, match="is not in the file"):
        set_scalar(YARD, ("mirdrake", "x"), "1")
    merged = "a: &a {at: [1, 2]}\nb: {<<: *a}\n"
    with pytest.raises(ConfigError, match=r"b\.at: comes from a merge"):
        set_scalar(merged, ("b", "at", "0"), "5")


def test_an_item_is_inserted_before_another_one_and_its_comments() -> None:
    flow = "points: [[0, 0], [1, 1],\n         [2, 2]]\n"
    assert insert_item(flow, ("points",), "[5, 5]", index=2) == flow.replace("[2, 2]", "[5, 5], [2, 2]")
    assert insert_item(flow, ("points",), "[5, 5]", index=3) == flow.replace("[2, 2]", "[2, 2], [5, 5]")
    new = "  - {prop: cone}\n"
    assert insert_item(YARD, ("props",), "{prop: cone}", index=0) == YARD.replace("props:\n", f"props:\n{new}")
    assert insert_item(YARD, ("props",), "{prop: cone}", index=1) == YARD.replace(
        "  - prop: van", f"{new}  - prop: van"
    )
