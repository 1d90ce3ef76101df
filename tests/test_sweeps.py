"""Contacts of moving outlines between samples against an independent computation with polygons."""

import math
from itertools import product

import numpy as np
import pytest
import shapely
import shapely.affinity

from mirdrake.worlds.clearance import Slab, Volume, place_outline
from mirdrake.worlds.sweeps import TOUCH, first_contacts, times_to_contact

BOX = np.array([[3.4, 0.9], [-1.0, 0.9], [-1.0, -0.9], [3.4, -0.9]])
SMALL = np.array([[0.15, 0.3], [-0.15, 0.3], [-0.15, -0.3], [0.15, -0.3]])
PERIOD = 0.02  # [s]


def volume(outline: np.ndarray, low: float = 0.1, high: float = 1.5) -> Volume:
    """Return a prism."""
    return Volume((Slab(outline, low, high),), low)


def polygon(outline: np.ndarray, pose: np.ndarray) -> shapely.Polygon:
    """Return an outline at a pose."""
    return shapely.Polygon(place_outline(outline, pose[None])[0])


def crossing(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return times and the poses of a car and of another object, on straight lines and circles."""
    times = np.arange(0.0, 2.0, PERIOD)
    poses = []
    for speed, reach in ((rng.uniform(5.0, 30.0), 1.0), (rng.uniform(0.5, 15.0), 1.0)):
        heading, turn = rng.uniform(-math.pi, math.pi), rng.choice([0.0, rng.uniform(-0.5, 0.5)])
        meeting, place = rng.uniform(0.5, 1.5), rng.uniform(-3.0, 3.0, 2) * reach
        yaw = heading + turn * times
        steps = np.column_stack((np.cos(yaw), np.sin(yaw))) * speed * PERIOD
        path = np.vstack(([0.0, 0.0], np.cumsum(steps[:-1], axis=0)))
        path += place - path[int(meeting / PERIOD)]
        poses.append(np.column_stack((path, yaw)))
    return times, poses[0], poses[1]


@pytest.mark.parametrize("count", [25, pytest.param(500, marks=pytest.mark.slow)])
def test_random_crossings_equal_an_exact_test_of_swept_polygons(count: int) -> None:
    rng = np.random.default_rng(3)
    one, other = volume(BOX), volume(SMALL)
    hits = 0
    for _ in range(count):
        times, mine, theirs = crossing(rng)
        found = first_contacts(one, mine, other, theirs)
        touched = bool(np.isfinite(found).any())
        # Densely: the distance of the polygons in steps of 1/40 of a sample, near the closest approach only.
        away = np.hypot(*(mine[:, :2] - theirs[:, :2]).T)
        smallest, first = math.inf, math.inf
        for row in np.flatnonzero(away < 6.0):
            if row == 0:
                continue
            for share in np.linspace(0.0, 1.0, 41):
                a = mine[row - 1] + share * (mine[row] - mine[row - 1])
                b = theirs[row - 1] + share * (theirs[row] - theirs[row - 1])
                distance = polygon(BOX, a).distance(polygon(SMALL, b))
                if distance <= 0.0 and not math.isfinite(first):
                    first = times[row - 1] + share * PERIOD
                smallest = min(smallest, distance)
            if math.isfinite(first):
                break
        # In 1/40 of a sample the objects move by less than 3 cm; a nearer miss cannot be told from a touch that way.
        if smallest > TOUCH and smallest < 0.03:
            continue
        assert touched == (smallest <= 0.0)
        if touched:
            hit = int(np.argmax(np.isfinite(found)))
            assert times[max(hit - 1, 0)] + found[hit] * PERIOD == pytest.approx(first, abs=PERIOD / 30.0)
            hits += 1
    assert 0.2 * count < hits < 0.98 * count


def test_a_grazing_pass_between_two_samples_is_found() -> None:
    # Two points of time 20 ms apart, at 40 m/s: a pedestrian-sized object is passed completely between them.
    mine = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    theirs = np.array([[1.0, -2.0, 0.0], [1.0, 2.0, 0.0]])
    share = first_contacts(volume(BOX), mine, volume(SMALL), theirs)[1]
    assert share == pytest.approx((2.0 - 0.9 - 0.3) / 4.0, abs=1e-3)


def test_objects_at_other_heights_do_not_touch() -> None:
    poses = np.zeros((2, 3))
    assert not np.isfinite(first_contacts(volume(BOX), poses, volume(SMALL, 2.0, 3.0), poses)).any()


@pytest.mark.parametrize(("gap", "closing"), list(product([5.0, 20.0], [2.0, 10.0, -3.0])))
def test_time_to_collision_on_a_line_is_gap_over_closing_speed(gap: float, closing: float) -> None:
    mine, theirs = np.array([[0.0, 0.0, 0.0]]), np.array([[3.4 + gap + 1.0, 0.0, 0.0]])
    own, other = np.array([[12.0, 0.0]]), np.array([[12.0 - closing, 0.0]])
    time = float(times_to_contact(volume(BOX), mine, own, volume(BOX), theirs, other)[0])
    assert time == pytest.approx(gap / closing) if closing > 0.0 else math.isinf(time)


def test_time_to_collision_of_a_pass_beside_is_infinite() -> None:
    mine, theirs = np.array([[0.0, 0.0, 0.0]]), np.array([[30.0, 2.0, 0.0]])
    standing = np.zeros((1, 2))
    own = np.array([[10.0, 0.0]])
    assert math.isinf(times_to_contact(volume(BOX), mine, own, volume(BOX), theirs, standing)[0])
    theirs[0, 1] = 1.7
    assert math.isfinite(times_to_contact(volume(BOX), mine, own, volume(BOX), theirs, standing)[0])
