"""Layouts of props: ranges over the start of a closed track, groups without room."""

import math
from typing import Any

import pytest

from mirdrake.worlds import World, make_world


def ring_of(along: dict[str, Any]) -> World:
    """Return a world with posts along a ring of 400 m."""
    ring = {"segments": [{"arc": {"radius": 200.0 / math.pi, "angle": "360 deg"}}], "closed": True, "width": 6}
    post = {"cylinder": [0.1, 1], "name": "post", "along": {"track": "ring"} | along}
    return make_world({"mirdrake": "world/1", "tracks": {"ring": ring}, "props": [post]})


@pytest.mark.parametrize("number", [{"spacing": 30}, {"count": 4}])
def test_a_range_may_run_over_the_start_of_a_closed_track(number: dict[str, Any]) -> None:
    world = ring_of({"s": [350, 40]} | number)
    stations = [float(world.tracks["ring"].project(*prop.X_WP.translation()[:2])[0]) for prop in world.props]
    assert stations == pytest.approx([350.0, 380.0, 10.0, 40.0], abs=1e-3)


def test_a_group_without_room_does_not_take_the_props_of_another_one() -> None:
    inner = {"box": [2, 2, 1], "name": "crate", "scatter": {"region": {"rect": {"size": [6, 6]}}, "count": 2}}
    world = make_world({
        "mirdrake": "world/1",
        "groups": {"yard": {"props": [inner]}},
        "props": [
            {"box": [12, 12, 1], "name": "hall", "at": [0, 0]},
            {"group": "yard", "name": "full", "at": [0, 0]},
            {"group": "yard", "name": "free", "at": [40, 0]},
        ],
    })  # fmt: skip
    assert {prop.name for prop in world.props} == {"hall", "free.crate[0]", "free.crate[1]"}
    (line,) = world.unplaced_props
    assert "'full.crate[0]' and 1 more" in line.text
