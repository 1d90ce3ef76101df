"""Entries and triggers of actors, objects behind and ends of roads over several lanes."""

from typing import Any

import numpy as np
import pytest

from mirdrake.actors import occupancy, triggers
from mirdrake.actors.crew import make_crew
from mirdrake.actors.lanes import LaneRow, LaneTable, Node, Piece, lane_table
from mirdrake.actors.motion import STATE
from mirdrake.actors.occupancy import OBJECT, OnLane, behind, fill, way_to_end
from mirdrake.core.compiled import records
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
    now = np.zeros(4, STATE).view(np.recarray)
    after = now[0].copy()
    # Only the second of four actors crosses the gate: the last one, number -1, is elsewhere.
    now.side, now.x[1], now.x[3] = -1.0, 101.0, 50.0
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


def chain(*lengths: float) -> LaneTable:
    """Return a chain of straight lanes along x as attributes, as for compiled functions."""
    begins = np.cumsum((0.0, *lengths))
    rows = [
        LaneRow(2 * k, 2, 0, length, length, 0, 0, -1, 0, -1, -1, (k + 1 if k + 1 < len(lengths) else -1, -1, -1, -1),
                3.5, (begins[k], -1.75, begins[k + 1], 1.75))
        for k, length in enumerate(lengths)
    ]  # fmt: skip
    nodes = [Node(x, 0.0, 0.0, 0.0) for k in range(len(lengths)) for x in begins[k : k + 2]]
    tables = records(LaneRow, rows), records(Node, nodes), records(Piece, [])  # without pieces: nothing is projected
    return LaneTable(*(table.view(np.recarray) for table in tables))


def test_a_follower_on_an_earlier_lane_is_behind() -> None:
    table = chain(50.0, 5.0, 100.0)
    cars = [OnLane(0, 7, 40.0, 2.0, 13.0, -1.0, 1.0, -1), OnLane(2, 8, 30.0, 2.0, 5.0, -1.0, 1.0, -1)]
    objects = records(OnLane, cars).view(np.recarray)
    # From 40 m on the first lane to 10 m on the third one, less half of both lengths.
    assert behind(table, 2, 10.0, 2.0, 0, 300.0, objects, 2) == pytest.approx((15.0 + 10.0 - 4.0, 13.0, 7))
    assert behind(table, 2, 40.0, 2.0, 0, 300.0, objects, 2) == pytest.approx((10.0 - 4.0, 5.0, 8))
    assert behind(table, 0, 30.0, 2.0, 0, 300.0, objects, 2)[2] == -2


def test_the_end_of_a_road_is_seen_from_lanes_before_the_last() -> None:
    table = chain(50.0, 5.0, 100.0)
    assert way_to_end(table, 0, 20.0, 300.0) == 135.0
    assert way_to_end(table, 2, 20.0, 300.0) == 80.0
    assert way_to_end(table, 0, 20.0, 20.0) == np.inf


def test_objects_on_crossing_paths_are_those_of_an_exhaustive_search(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(4)
    bends = [[[0, 10 * k], [20, 10 * k + 5], [30, 30], [45, 32 - 8 * k]] for k in range(4)]
    straight = [[[-10, 12 * k], [50, 30 - 9 * k]] for k in range(3)]
    entries = [
        {"actor": "pedestrian", "name": f"p{k}", "path": path, "speed": 1.0}
        for k, path in enumerate([*bends, *straight])
    ]
    world = make_world({"mirdrake": "world/1", "actors": entries})
    tables, _ = lane_table(world.lanes)
    table = LaneTable(*(part.view(np.recarray) for part in tables))
    bodies = np.column_stack((rng.uniform(-20, 60, (60, 2)), rng.uniform(-3, 3, 60), rng.uniform(-6, 6, (60, 2))))
    shape = np.tile((2.5, 1.0, 0.9), (len(bodies), 1))

    def found() -> Any:
        objects = np.zeros(len(bodies) * len(table.lanes), OBJECT).view(np.recarray)
        none, now = np.zeros(len(bodies), np.int64), np.empty(0, STATE).view(np.recarray)
        count = fill(table, shape, np.arange(len(bodies)), none, np.empty((0, 3)), now, bodies, objects)
        return objects[:count]

    near = found()
    # Without the cheap tests, every object is projected onto every lane from the nearest of all nodes.
    monkeypatch.setattr(occupancy, "_is_clear", lambda *_: False)
    monkeypatch.setattr(occupancy, "is_beyond", lambda *_: False)
    nodes = [table.nodes[row.first : row.first + row.nodes] for row in table.lanes]
    monkeypatch.setattr(
        occupancy,
        "nearest_node",
        lambda _t, lane, x, y, _within: int(np.argmin(np.hypot(nodes[lane]["x"] - x, nodes[lane]["y"] - y))),
    )
    assert 20 < len(near) < 400
    assert near.tobytes() == found().tobytes()
