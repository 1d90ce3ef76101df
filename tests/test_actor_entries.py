"""Entries and triggers of actors: names of rows, conditions about the actor itself, room for stop lines."""

from typing import Any

import numpy as np
import pytest

from mirdrake.actors import triggers
from mirdrake.actors.crew import make_crew
from mirdrake.actors.motion import COLUMNS, SIDE, X
from mirdrake.core.errors import ConfigError
from mirdrake.worlds import World, make_world


def world_of(*actors: dict[str, Any]) -> World:
    tracks = {"main": {"segments": [{"line": 400}]}}
    return make_world({"mirdrake": "world/1", "tracks": tracks, "actors": list(actors)})


def row(s: float, **more: Any) -> dict[str, Any]:
    along = {"track": "main", "s": s, "count": 2, "spacing": 20}
    return {"actor": "sedan", "along": along, "speed": 5, "behaviour": {"kind": "idm"}} | more


def test_rows_without_a_name_count_on() -> None:
    single = {"actor": "sedan", "on_track": {"track": "main", "s": 300}, "behaviour": {"kind": "idm"}}
    world = world_of(row(20), row(100), single, row(200, name="last"))
    assert {actor.name for actor in world.actors} == {*(f"sedan_{k}" for k in range(5)), "last_0", "last_1"}


def test_past_without_of_is_about_the_actor_itself() -> None:
    starts = {"when": {"kind": "past", "track": "main", "value": 100}}
    _, crew, _ = make_crew(world_of(row(20, starts=starts), row(200)), {}, 0)
    now, after = np.zeros((4, COLUMNS)), np.zeros(COLUMNS)
    # Only the second of four actors crosses the gate: the last one, number -1, is elsewhere.
    now[:, SIDE], now[1, X], now[3, X] = -1.0, 101.0, 50.0
    none = np.empty((0, 5))
    assert triggers.is_due(crew.steps[0], 1, now, none, 0.0, after)
    assert not triggers.is_due(crew.steps[0], 0, now, none, 0.0, after)


@pytest.mark.parametrize(
    ("condition", "message"),
    [
        ({"kind": "distance", "value": 5}, "needs of: the vehicle or actor"),
        ({"kind": "time", "value": 5}, "needs of: the vehicle or actor"),
        ({"kind": "past", "value": 5}, "needs track"),
    ],
)
def test_incomplete_conditions_are_refused(condition: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        world_of(row(20, starts={"when": condition}))
