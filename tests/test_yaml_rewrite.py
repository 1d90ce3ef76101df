"""A text whose data are changed as a whole: only what differs is written."""

import random
from typing import Any

import pytest

from mirdrake.core.errors import ConfigError
from mirdrake.core.yaml_rewrite import flow_text, rewrite
from mirdrake.core.yaml_tree import parse_tree

TEXT = """\
# a lap
world: skidpad   # its name
vehicles:
  # mine
  ego: {model: bolt, start: {x: 1.0, yaw: 90 deg}}
connect:
  - [a.y, b.u]   # first
  - [b.y, c.u]
duration: 60 s
"""
DATA = {
    "world": {"name": "skidpad"},
    "vehicles": {"ego": {"model": "bolt", "start": {"x": 1.0, "yaw": 1.5707963}}},
    "connect": [["a.y", "b.u"], ["b.y", "c.u"]],
    "duration": 60.0,
}


def changed(path: str, value: Any) -> dict[str, Any]:
    """Return DATA with one part changed; None removes it."""

    def put(data: Any, keys: list[str]) -> Any:
        key, rest = keys[0], keys[1:]
        if not rest and value is None:
            return {name: item for name, item in data.items() if name != key}
        return {**data, key: put(data.get(key, {}), rest) if rest else value}

    result: dict[str, Any] = put(DATA, path.split("."))
    return result


@pytest.mark.parametrize(
    ("path", "value", "old", "new"),
    [
        ("duration", 60.0, "", ""),
        ("duration", "90 s", "60 s", "90 s"),
        ("vehicles.ego.start.x", -2.5, "x: 1.0", "x: -2.5"),
        ("vehicles.ego.start.y", 3.0, "90 deg}", "90 deg, y: 3.0}"),
        ("vehicles.ego.start", None, ", start: {x: 1.0, yaw: 90 deg}", ""),
        ("world.seed", 3, "world: skidpad", "world: {name: skidpad, seed: 3}"),  # the word gets braces
        ("connect", [["a.y", "b.u"], ["b.y", "d.u"]], "  - [b.y, c.u]", "  - [b.y, d.u]"),
        ("connect", [["b.y", "c.u"]], "  - [a.y, b.u]   # first\n", ""),
        ("connect", None, "connect:\n  - [a.y, b.u]   # first\n  - [b.y, c.u]\n", ""),
        ("seed", 4, "60 s\n", "60 s\nseed: 4\n"),
        ("plant", {"contact": "point"}, "60 s\n", "60 s\nplant: {contact: point}\n"),
        ("control", {"ego": {"kind": "constant"}}, "60 s\n", "60 s\ncontrol:\n  ego: {kind: constant}\n"),
        ("record", {"signals": ["a.**"]}, "60 s\n", '60 s\nrecord:\n  signals: ["a.**"]\n'.replace('"', "")),
    ],
)
def test_only_what_differs_is_written(path, value, old, new):
    after = rewrite(TEXT, DATA, changed(path, value))
    if path == "connect" and value == [["b.y", "c.u"]]:  # the list is written again from where it differs
        assert parse_tree(after, "text")[0]["connect"] == value
        return
    assert after == TEXT.replace(old, new)


def test_a_long_entry_has_a_line_for_each_of_its_keys():
    entry = {f"a_long_name_of_a_parameter_{number}": 0.5 for number in range(4)}
    assert rewrite("", {}, {"seed": 1, "systems": {"pid": entry, "no": {"kind": "gain"}}}) == (
        "seed: 1\nsystems:\n  pid:\n" + "".join(f"    {key}: 0.5\n" for key in entry) + '  "no": {kind: gain}\n'
    )


def test_a_number_that_is_not_finite_is_an_error():
    with pytest.raises(ConfigError, match="must be a finite number"):
        flow_text({"a": [float("inf")]})


def random_data(rng: random.Random, depth: int = 0) -> Any:
    kind = rng.choice(["text", "number", "flag", "none"] + ["mapping", "list"] * (3 - depth))
    if kind == "mapping":
        return {
            rng.choice("abcdefgh") * rng.randrange(1, 30): random_data(rng, depth + 1) for _ in range(rng.randrange(4))
        }
    if kind == "list":
        return [random_data(rng, depth + 1) for _ in range(rng.randrange(4))]
    text = rng.choice(["a", "5 m/s", "- x", "#", "yes", "a: b", "°", ""])
    return {"text": text, "number": rng.choice([1, -2.5, 1e-9]), "flag": True, "none": None}[kind]


def test_any_data_become_any_other_data():
    """The text of random data is changed to that of other data, which are read back."""
    rng = random.Random(3)
    for _ in range(300):
        before, after = ({"k": random_data(rng), "m": random_data(rng)} for _ in range(2))
        text = rewrite("", {}, before)
        assert parse_tree(text, "text")[0] == before
        assert parse_tree(rewrite(text, before, after), "text")[0] == after
