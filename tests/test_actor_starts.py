"""Actors that overlap at t = 0, as ``mirdrake world check`` reports them."""

import math
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from mirdrake.cli import main
from mirdrake.world_checks import check_world
from mirdrake.world_checks.faults import Fault
from mirdrake.worlds import make_world
from mirdrake.worlds.props import load_prop

Pose = tuple[float, float, float]


def find_faults(*actors: tuple[str, Pose], **keys: object) -> list[Fault]:
    """Return the faults of a world with actors ``a0``, ``a1`` … with the frame A at poses."""
    entries = [
        {"actor": kind, "name": f"a{number}", "path": [[x, y], [x + 9.0 * math.cos(yaw), y + 9.0 * math.sin(yaw)]]}
        for number, (kind, (x, y, yaw)) in enumerate(actors)
    ]
    return check_world(make_world({"mirdrake": "world/1", "actors": entries, **keys}))


@pytest.mark.parametrize("seed", range(5))
def test_of_barrels_exactly_those_nearer_than_a_diameter_overlap(seed: int) -> None:
    """A closed form: circles of diameter D at a distance d overlap by D - d."""
    diameter = load_prop("barrel").size[0]
    draw = np.random.default_rng(seed)
    points = draw.uniform(0.0, 12.0 * diameter, (60, 2))
    away = np.hypot(*(points[:, None] - points[None]).T)
    # The solid is a polygon, whose width differs from the circle by less than 2 %.
    margin = 0.02 * diameter
    faults = find_faults(*(("barrel", (x, y, 0.0)) for x, y in points.tolist()))
    found = {tuple(int(name[1:]) for name in fault.names): fault.depth for fault in faults}
    assert {fault.kind for fault in faults} == {"actor"}
    for (later, earlier), depth in found.items():
        assert earlier < later
        assert depth == pytest.approx(diameter - away[later, earlier], abs=margin)
    reported = {pair[0] for pair in found}
    near = {b for b in range(60) if (away[b, :b] < diameter + margin).any()}
    surely = {b for b in range(60) if (away[b, :b] < diameter - margin).any()}
    assert surely <= reported <= near
    assert 10 < len(surely) < 60


@pytest.mark.parametrize("seed", range(5))
def test_the_depth_is_that_of_the_shapes_wherever_they_are(seed: int) -> None:
    """A rigid motion of both, and their order, leave the depth; a translation by more than the depth separates them."""
    draw = np.random.default_rng(seed)
    x, y, yaw = draw.uniform((-2.0, -1.0, -math.pi), (2.0, 1.0, math.pi)).tolist()
    (fault,) = find_faults(("sedan", (0.0, 0.0, 0.0)), ("sedan", (x, y, yaw)))
    dx, dy, turn = draw.uniform((-50.0, -50.0, -math.pi), (50.0, 50.0, math.pi)).tolist()
    c, s = math.cos(turn), math.sin(turn)
    moved = ("sedan", (dx, dy, turn)), ("sedan", (dx + c * x - s * y, dy + s * x + c * y, yaw + turn))
    for pair in (moved, moved[::-1]):
        (same,) = find_faults(*pair)
        assert same.depth == pytest.approx(fault.depth, abs=1e-6)
    assert fault.depth is not None
    # A translation along one of 24 directions, within 7.5 degrees of the shortest one: 1 / cos(7.5 deg) = 1.009.
    ways = [(math.cos(a), math.sin(a)) for a in np.radians(np.arange(0.0, 360.0, 15.0)).tolist()]
    far = 1.01 * fault.depth + 0.01
    assert any(_are_apart((x + far * c, y + far * s, yaw)) for c, s in ways)


def _are_apart(pose: Pose) -> bool:
    return find_faults(("sedan", (0.0, 0.0, 0.0)), ("sedan", pose)) == []


def test_a_car_on_a_pedestrian_and_a_vehicle_on_an_actor_are_found_end_to_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    text = """\
mirdrake: world/1
tracks: {main: {segments: [{line: 60}], width: 6}}
start: {gate: {on_track: {track: main, s: 20}}}
actors:
  - {actor: sedan, name: car, on_track: {track: main, s: 8}}
  - {actor: pedestrian, name: walker, path: [[8, -0.5], [8, 6]]}
  - {actor: bolt, name: bolt, body: full, on_track: {track: main, s: 22}}
tests: [{name: waits, vehicle: bolt, behaviour: blind, expect: [never collision]}]
"""
    Path("w.yaml").write_text(text)
    assert main(["world", "check", "w.yaml"]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert [_head(line) for line in lines] == [
        "error: w.yaml:6: actors.1.actor: 'walker' overlaps 'car' (w.yaml:5) by",
        "error: w.yaml:3: start.gate: bolt at 'gate' overlaps the actor 'bolt' (w.yaml:7) by",
    ]
    assert "move one of them" in lines[0]
    # As the message asks: each of the two is moved.
    Path("w.yaml").write_text(text.replace("[8, -0.5]", "[8, 3]").replace("s: 22", "s: 30"))
    assert main(["world", "check", "w.yaml"]) == 0


def _head(line: str) -> str:
    return re.sub(r" by .*", " by", line)


@pytest.mark.parametrize(("begin", "found"), [(0.0, False), (1.0, True), (5.0, False)])
def test_a_recorded_actor_is_where_it_is_at_the_start_of_the_run(begin: float, found: bool) -> None:
    rows: Sequence[tuple[float, ...]] = [(t - begin, 10.0 * t, 0.0, 0.0) for t in (0.0, 0.5, 1.5, 5.0)]
    actors = [
        {"actor": "sedan", "name": "parked", "path": [[10.0, 0.0], [20.0, 0.0]]},
        {"actor": "sedan", "name": "seen", "recorded": {"file": "drive.csv", "begin": begin, "rows": rows}},
    ]
    faults = check_world(make_world({"mirdrake": "world/1", "actors": actors}))
    assert [fault.names for fault in faults] == ([("seen", "parked")] if found else [])


@pytest.mark.parametrize(("begin", "x"), [(-1.0, 0.0), (0.0, 0.0), (1.0, 10.0), (1.25, 12.5), (9.0, 50.0)])
def test_a_full_vehicle_starts_where_its_recording_is_at_the_start_of_the_run(begin: float, x: float) -> None:
    rows = [(t - begin, 10.0 * t, 0.0, 0.0) for t in (0.0, 0.5, 1.5, 5.0)]
    actor = {
        "actor": "bolt",
        "name": "seen",
        "body": "full",
        "recorded": {"file": "drive.csv", "begin": begin, "rows": rows},
    }
    world = make_world({"mirdrake": "world/1", "actors": [actor]})
    (full,) = world.full_actors
    assert full.start(world.lanes[full.lane]) == pytest.approx((x, 0.0, 0.0), abs=1e-9)


def test_a_row_of_actors_in_one_place_has_one_fault_each() -> None:
    faults = find_faults(*[("barrel", (0.0, 0.0, 0.0))] * 30)
    assert [fault.names for fault in faults] == [(f"a{number}", "a0") for number in range(1, 30)]
