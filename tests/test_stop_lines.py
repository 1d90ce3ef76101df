"""Stop lines ahead of a full vehicle: which of them are reported, and at which one a driver stops."""

import math
from pathlib import Path

import numpy as np
import pytest

from mirdrake.actors.road_ahead import LINES, ROAD_AHEAD, next_lines
from mirdrake.controllers.behaviours.laws import brake_speed
from mirdrake.controllers.traffic_driver import Braking, arrival_time, stop_line
from mirdrake.worlds.lights import AMBER, GREEN, RED, Light
from mirdrake.worlds.pieces import Piece
from mirdrake.worlds.tracks import Track
from tests.actor_rigs import simulation, world_file
from tests.test_behaviours import FRONT, drive

DRIVER = Braking(2.0, 8.0, 0.3, 1.0)
FREE = {"stops": math.inf, "goes": -math.inf}
Line = tuple[float, float, float]


def line(distance: float, light: float, left: float = 2.0) -> Line:
    """Return a line with its light."""
    return distance, light, left


def test_lines_that_are_not_open_are_reported_nearest_first() -> None:
    rng = np.random.default_rng(1)
    for _ in range(500):
        lights = [
            (float(rng.uniform(-1.0, 300.0)), float(rng.integers(0, 3)), float(rng.uniform(0.0, 30.0)))
            for _ in range(rng.integers(0, 8))
        ]
        closed = float(rng.choice([math.inf, rng.uniform(-1.0, 300.0)]))
        found = np.array(next_lines(closed, lights)).reshape(LINES, 3)
        # By definition: the k-th smallest distance of all lines that are not open.
        shut = [one for one in (*lights, (closed, RED, math.inf)) if one[1] != GREEN and one[0] < math.inf]
        distances = np.sort([one[0] for one in shut])
        for k, (distance, light, left) in enumerate(found):
            if k < len(distances):
                assert (distance, light, left) in shut
                assert distance == distances[k]
            else:
                assert (distance, light, left) == (math.inf, GREEN, math.inf)
    assert len(ROAD_AHEAD) == 2 + 3 * LINES


def test_the_arrival_at_a_line_before_a_stop_is_the_integral_of_the_braking_profile() -> None:
    rng = np.random.default_rng(2)
    for _ in range(100):
        speed, stop = float(rng.uniform(1.0, 30.0)), float(rng.uniform(5.0, 400.0))
        place = float(rng.uniform(0.1, stop - 1.5))
        x = np.linspace(0.0, place, 2001)
        profile = [brake_speed(stop - 1.0 - at, deceleration=2.0, reaction=0.3) for at in x]
        expected = float(np.trapezoid(1.0 / np.minimum(profile, speed), x))
        assert arrival_time(place, speed, stop, DRIVER) == pytest.approx(expected, rel=1e-3)
        assert arrival_time(place, speed, math.inf, DRIVER) == pytest.approx(place / speed)
    assert arrival_time(9.5, 10.0, 10.0, DRIVER) == math.inf  # it stops 1 m before the line at 10 m


def test_the_nearest_line_that_requires_a_stop_counts() -> None:
    """At 20 m/s a comfortable stop needs 20 0.3 + 20²/(2 2) = 106 m; amber for 2 s more is reached from 34 m."""
    near, go, stop = line(10.0, AMBER), line(33.9, AMBER), line(34.1, AMBER)
    red = line(60.0, RED)
    cases: list[tuple[list[Line], float]] = [
        ([], math.inf),
        ([red], 60.0),
        ([go], math.inf),
        ([stop], 34.1),
        # Braking for the red light at 60 m, it is at 10 m after 0.7 s, but at 33.9 m after 2.8 s.
        ([near, red], 60.0),
        ([go, red], 33.9),
        ([stop, red], 34.1),
        ([near, line(10.1, AMBER), red], 60.0),
        ([near, line(50.0, RED, math.inf), red], 50.0),
        # 139 m and 119 m - 106 m before it begins to brake.
        ([go, line(140.0, AMBER)], 140.0),
        ([go, line(120.0, AMBER)], 33.9),
    ]
    for lines, distance in cases:
        assert stop_line(lines, 20.0, DRIVER, **FREE)[0] == distance, lines


def test_decisions_about_amber_lights_are_kept() -> None:
    # To stop: even if the line could be reached now.
    assert stop_line([line(34.1, AMBER)], 20.0, DRIVER, **FREE) == (34.1, 34.1, -math.inf)
    assert stop_line([line(34.0, AMBER, 2.3)], 20.0, DRIVER, stops=34.1, goes=-math.inf)[0] == 34.0
    assert stop_line([], 20.0, DRIVER, stops=34.1, goes=-math.inf)[1] == math.inf
    # Another light, which became amber in front of it, is a new decision.
    both = [line(5.0, AMBER), line(34.0, AMBER, 2.3)]
    assert stop_line(both, 20.0, DRIVER, stops=34.1, goes=-math.inf)[0] == 34.0

    # To go on: as long as half of the margin of 0.3 s is enough.
    assert stop_line([line(33.9, AMBER)], 20.0, DRIVER, **FREE) == (math.inf, math.inf, 33.9)
    for distance, ahead in ((36.9, math.inf), (37.1, 37.1)):
        assert stop_line([line(distance, AMBER)], 20.0, DRIVER, stops=math.inf, goes=distance)[0] == ahead
    # At red, only if the vehicle cannot stop any more: at 8 m/s within 8²/(2 8) = 4 m.
    for distance, speed, ahead in ((3.9, 8.0, math.inf), (4.1, 8.0, 4.1), (0.5, 0.0, 0.5), (-0.5, 0.0, math.inf)):
        assert stop_line([line(distance, RED)], speed, DRIVER, stops=math.inf, goes=distance)[0] == ahead
        assert stop_line([line(distance, RED)], speed, DRIVER, **FREE)[0] == distance
    # But not past a closed line, nor past a red light behind it.
    assert stop_line([line(3.0, RED, math.inf)], 8.0, DRIVER, stops=math.inf, goes=3.0)[0] == 3.0
    assert stop_line([line(3.0, RED), line(6.0, RED)], 8.0, DRIVER, stops=math.inf, goes=3.0)[0] == 6.0


@pytest.mark.parametrize("closed", [False, True])
def test_a_vehicle_sees_a_red_light_behind_a_green_one(closed: bool, tmp_path: Path) -> None:
    segments = [{"line": 200}, *([{"arc": {"radius": 40, "angle": "180 deg"}}, {"line": 200}] if closed else [])]
    if closed:
        segments.append({"arc": {"radius": 40, "angle": "180 deg"}})
    tracks = {"main": {"segments": segments, "closed": closed}}
    always = {"green": {"green": 1000, "amber": 0, "red": 0}, "red": {"green": 1e-3, "amber": 0, "red": 1000}}
    signals = {
        name: {"controls": [f"main@{s}"], "programme": always[kind], "offset": 1.0}
        for name, kind, s in (("a", "green", 60.0), ("b", "red", 75.0), ("c", "green", 90.0), ("d", "red", 10.0))
    }
    world = world_file(tmp_path, tracks=tracks, signals=signals)
    driver = {"kind": "traffic", "track": "main", "speed": 10}
    run = simulation(world, speed=0.0, start={"x": 40, "y": 0}, control={"ego": driver})
    context = run.assembly.make_context()
    system = run.assembly.diagram.GetSubsystemByName("ego.road")
    found = system.GetOutputPort("road_ahead").Eval(system.GetMyContextFromRoot(context))[2:].reshape(LINES, 3)
    front = 40.0 + max(float(x) for x in run._volumes["ego"].outline[:, 0])
    # A red line behind the vehicle is ahead on a closed track.
    length = 2.0 * 200.0 + 2.0 * math.pi * 40.0
    expected = [75.0 - front, length + 10.0 - front] if closed else [75.0 - front]
    np.testing.assert_allclose(found[: len(expected), 0], expected, atol=1e-6)
    assert np.all(found[: len(expected), 1] == RED)
    assert np.all(found[len(expected) :] == (math.inf, GREEN, math.inf))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_no_red_light_is_passed_among_lights_close_to_each_other(seed: int) -> None:
    """25 drives of each seed past 2 to 4 lights, 6 m to 60 m apart, with random cycles."""
    rng, road = np.random.default_rng(seed), Track([Piece(1200.0, 0.0, 0.0)], closed=False)
    stops = 0
    for _ in range(25):
        speed = float(rng.uniform(6.0, 25.0))
        places = 300.0 + np.cumsum(rng.uniform(6.0, 60.0, rng.integers(2, 5)))
        lights = {}
        for number, place in enumerate(places.tolist()):
            green, amber, red = rng.uniform(2.0, 15.0), rng.uniform(3.0, 5.0), rng.uniform(2.0, 10.0)
            # Green begins at a random time before the start, so that a comfortable stop is possible at first.
            offset = float(rng.uniform(0.0, green + amber + red))
            lights[place] = Light(str(number), green, amber, red, offset, ())
        driver = {"kind": "traffic", "speed": speed}
        run = drive(driver, tracks={"main": road}, lights=lights, speed=speed, start=(100.0, 0.0, 0.0), duration=90.0,
                    brakes=9.0)  # fmt: skip
        for place, light in lights.items():
            crossed = np.flatnonzero(run.x + FRONT >= place)
            assert crossed.size, (seed, light)
            assert light.state(run.t[crossed[0]]) != RED, (seed, light)
            waits = (run.x + FRONT > place - 2.0) & (run.x + FRONT < place) & (run.speed < 0.05)
            stops += bool(waits.any())
    assert stops > 10
