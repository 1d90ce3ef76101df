"""Broken world files: each gives a world or a one-line error."""

import copy
import random

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mirdrake.core.errors import MirdrakeError
from mirdrake.core.paths import data_root, names
from mirdrake.worlds import load_world
from tests.marks import mostly_slow

WORLDS = {name: (data_root() / "worlds" / f"{name}.yaml").read_text(encoding="utf-8") for name in names("worlds")}
FAST = (
    "neighbourhood", "cut_out", "random_track", "thrift_store", "crossing_with_lights", "kerb_and_bumps", "roundabout",
    "town",
)  # fmt: skip
"""Worlds of the fast tests, chosen so that together they have most keys of the language."""

BY_SPEED = mostly_slow([*FAST, *sorted(set(WORLDS) - set(FAST))], fast=len(FAST))
SPOILERS: list[object] = [
    None, True, -1, 0, 1e308, float("nan"), float("inf"), "", " ", "$", "$nobody", "1 ..", "3 .. 1", ".. 2", "0 +- -1",
    "a | b", "|", "1/0", "$a*$a", "9" * 400, "-5 km", "3 furlongs", "90 deg", [], [[]], {}, {"at": [0, 0]}, ["x"] * 3,
    "sedan", "../../etc", "\u0000", "ünïcode", 10**30, "1e999", "((((1))))", "1 .. 2 .. 3", "main", "2 | 3 | $pitch",
]  # fmt: skip


def settle(path, text):
    """Read a file; whether it is a world."""
    path.write_text(text, encoding="utf-8")
    try:
        load_world(str(path))
    except MirdrakeError as error:
        message = str(error)
    else:
        return True
    assert message
    for line in message.splitlines():
        assert line.strip(), message
        assert len(line) < 1200, line
    return False


def places(node, path=()):
    """Every place in a tree of lists and mappings."""
    yield path
    if isinstance(node, dict):
        for key, value in node.items():
            yield from places(value, (*path, key))
    elif isinstance(node, list):
        for index, value in enumerate(node):
            yield from places(value, (*path, index))


def spoil(tree, chance):
    """Replace, remove, double, rename or swap one value."""
    where = chance.choice([path for path in places(tree) if path])
    parent = tree
    for key in where[:-1]:
        parent = parent[key]
    key, kind = where[-1], chance.randrange(5)
    if kind == 0:
        parent[key] = copy.deepcopy(chance.choice(SPOILERS))
    elif kind == 1:
        del parent[key]
    elif kind == 2 and isinstance(parent, list):
        parent.append(copy.deepcopy(parent[key]))
    elif kind == 3 and isinstance(parent, dict):
        parent[f"{key}x"] = parent.pop(key)
    else:
        other = chance.choice([path for path in places(tree) if path])
        value = tree
        for step in other:
            value = value[step]
        parent[key] = copy.deepcopy(value)
    return tree


@pytest.mark.parametrize("name", BY_SPEED)
def test_a_mutated_world_is_laid_out_or_rejected_line_by_line(tmp_path, name):
    chance = random.Random(name)
    (tmp_path / "groups").mkdir()
    sound = 0
    for number in range(15):
        tree = yaml.safe_load(WORLDS[name])
        for _ in range(chance.choice([1, 1, 1, 2, 4])):
            tree = spoil(tree, chance)
        sound += settle(tmp_path / f"w{number}.yaml", yaml.safe_dump(tree, allow_unicode=True))
    assert sound < 25


@pytest.mark.parametrize("name", BY_SPEED)
def test_a_truncated_file_is_rejected_line_by_line(tmp_path, name):
    chance, text = random.Random(name), WORLDS[name]
    for number in range(25):
        cut = chance.randrange(len(text))
        torn = (
            text[:cut],
            text[:cut] + chance.choice("{}[]:,&*!|>'\"%@`\t\n-?#\u2028") + text[cut:],
            text[:cut] + text[cut + chance.randrange(1, 40) :],
        )[number % 3]
        settle(tmp_path / f"w{number}.yaml", torn)


VALUES = st.one_of(
    st.floats(allow_nan=True),
    st.integers(-(10**6), 10**6),
    st.text(max_size=12),
    st.sampled_from(["0 .. 3", "1 | 2", "$p", "$p*2", "0 +- 0.5", "90 deg", "-1 .. 1 m", "sedan | van", "2 .. $p"]),
)
PAIRS, COUNTS = st.lists(VALUES, min_size=2, max_size=2), st.one_of(st.integers(0, 9), VALUES)
LAYOUTS = st.one_of(
    st.builds(lambda at: {"at": at}, st.lists(VALUES, min_size=1, max_size=4)),
    st.builds(lambda step, count: {"grid": {"step": step, "count": count}}, PAIRS, PAIRS),
    st.builds(lambda radius, count: {"ring": {"radius": radius, "count": count}}, VALUES, COUNTS),
    st.builds(lambda to, count: {"line": {"from": [0, 0], "to": to, "count": count}}, PAIRS, COUNTS),
    st.builds(lambda r, count: {"scatter": {"region": {"disc": {"radius": r}}, "count": count}}, VALUES, COUNTS),
)
ENTRIES = st.builds(
    lambda shape, layout, more: {**shape, **layout, **more},
    st.sampled_from([{"prop": "cone"}, {"box": [1, 2, 3]}, {"sphere": "$p"}, {"prop": "sedan | van"}, {"group": "g"}]),
    LAYOUTS,
    st.dictionaries(st.sampled_from(["yaw", "z", "scale", "pitch", "name", "static", "color"]), VALUES, max_size=2),
)


@settings(max_examples=120, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
@given(entries=st.lists(ENTRIES, min_size=1, max_size=3), p=VALUES, seed=st.integers(0, 9))
def test_any_value_anywhere_in_the_props(tmp_path, entries, p, seed):
    group = {"params": {"q": 1}, "props": [{"box": [1, 1, "$q"], "at": [0, 0]}]}
    tree = {"mirdrake": "world/1", "seed": seed, "params": {"p": p}, "props": entries, "groups": {"g": group}}
    settle(tmp_path / "w.yaml", yaml.safe_dump(tree, allow_unicode=True))
