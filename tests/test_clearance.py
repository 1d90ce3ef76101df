"""Clearance and overlap of vehicles with props and with one another, against closed forms and brute force."""

import math
from dataclasses import replace
from functools import cache
from itertools import product
from typing import Any

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.geometry import Box, Cylinder, Sphere
from pydrake.math import RigidTransform, RollPitchYaw
from shapely import affinity

from mirdrake.controllers.behaviours.outline import volume_of
from mirdrake.vehicles import load_vehicle
from mirdrake.worlds import PlacedProp, Prop
from mirdrake.worlds.clearance import Part, Slab, Volume, clearance, clearance_between, place_outline
from mirdrake.worlds.props import Solid, load_prop

SQUARE = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
BLOCK = Volume((Slab(SQUARE, 0.1, 1.5),), 0.1)


@cache
def bolt() -> Volume:
    """Return the volume of the Bolt."""
    return volume_of(load_vehicle("bolt"))


def place(*solids: tuple[Any, RigidTransform], x: float = 0.0, y: float = 0.0, yaw: float = 0.0) -> PlacedProp:
    """Return a prop of some solids."""
    prop = Prop("thing", tuple(Solid(*solid) for solid in solids), (1.0, 1.0, 1.0), 100.0)
    return PlacedProp("thing", prop, RigidTransform(RollPitchYaw(0.0, 0.0, yaw), [x, y, 0.0]))


def box(size: tuple[float, float, float], at: tuple[float, float, float]) -> tuple[Any, RigidTransform]:
    """Return a box; `at` is the middle of its lower face."""
    return Box(*size), RigidTransform([at[0], at[1], at[2] + 0.5 * size[2]])


def post(x: float, y: float) -> PlacedProp:
    return place(box((1.0, 1.0, 1.0), (0.0, 0.0, 0.0)), x=x, y=y)


def at(x: float, y: float, yaw: float = 0.0) -> Any:
    return np.array([[x, y, yaw]])


def test_clearance_is_the_distance_of_two_boxes_and_the_depth_of_an_overlap() -> None:
    poses = np.array([[5, 0, 0], [5, 5, 0], [5, 0, math.pi / 4], [1.2, 0, 0], [math.nan, 0, 0]])
    expected = [3.5, 3.5 * math.sqrt(2.0), 4.5 - math.sqrt(2.0), -0.3, math.inf]
    assert clearance(BLOCK, poses, [post(0, 0), post(0, 50)]) == pytest.approx(expected)
    bump = post(0, 0)
    bump = replace(bump, prop=replace(bump.prop, driven_over=True))
    assert np.isinf(clearance(BLOCK, poses, [bump])).all()
    assert np.isinf(clearance(BLOCK, poses, [])).all()


@given(st.floats(-3, 3), st.floats(-3, 3), st.floats(-4, 4))
@settings(max_examples=100, deadline=None)
def test_an_overlap_is_undone_by_its_depth(x: float, y: float, yaw: float) -> None:
    corners = place_outline(SQUARE, at(x, y, yaw))[0]
    distance = float(clearance(BLOCK, at(x, y, yaw), [post(0, 0)])[0])
    square, stone = shapely.polygons(corners), shapely.box(-0.5, -0.5, 0.5, 0.5)
    if distance > 0.0:
        assert distance == pytest.approx(shapely.distance(square, stone))
        return
    edges = np.concatenate([np.diff(corners[:3], axis=0) / 2.0, [[1.0, 0.0], [0.0, 1.0]]])
    moves = [sign * (-distance + 1e-6) * edge for edge in edges for sign in (-1.0, 1.0)]
    assert any(not shapely.intersects(shapely.polygons(corners + move), stone) for move in moves)
    assert not any(shapely.distance(shapely.polygons(corners + 0.9 * move), stone) > 1e-6 for move in moves)


# --- three dimensions ----------------------------------------------------------------------------------------------

HALF = 1.765 / 2.0  # of the width of the bolt, whose cabin is 1.3 m wide from 1 m upwards and 1.595 m high
TREE = place((Cylinder(0.2, 3.0), RigidTransform([0, 0, 1.5])), (Sphere(2.0), RigidTransform([0, 0, 4.0])))
GATE = place(*[box((0.2, 0.2, 2.5), (0.0, side, 0.0)) for side in (-2.0, 2.0)], box((0.2, 4.2, 0.4), (0.0, 0.0, 2.5)))
TABLE = place(box((1.0, 2.0, 0.05), (0.0, 0.0, 0.75)), box((0.1, 0.1, 0.75), (0.0, 0.0, 0.0)))
SHELF = place(box((2.0, 0.6, 0.1), (0.0, 0.0, 1.3)), box((2.0, 0.1, 1.3), (0.0, 0.25, 0.0)))
KERB = place(box((4.0, 0.3, 0.12), (0.0, 0.0, 0.0)))
STEP = place(box((4.0, 0.3, 0.30), (0.0, 0.0, 0.0)))


@pytest.mark.parametrize(
    ("prop", "y", "expected"),
    [
        (TREE, -HALF - 0.5 - 0.2, 0.5),  # below the crown, beside the trunk
        (TREE, -HALF, -0.2),
        (GATE, 0.0, 1.9 - HALF),  # below the bar
        (GATE, 0.2 + HALF, 1.7 - 2 * HALF),
        (TABLE, -1.0 - 0.3 - HALF, 0.3),  # the top counts, at the height of the bonnet
        (TABLE, -1.0 + 0.1 - HALF, -0.1),
        (SHELF, -0.3 - HALF, HALF - 0.65),  # a board beside the cabin, over the bonnet: the cabin is narrower
        (KERB, 0.0, math.inf),  # lower than the ground clearance
        (STEP, 0.0, -HALF - 0.15),
    ],
)
def test_only_objects_within_reach_of_the_vehicle_count(prop: PlacedProp, y: float, expected: float) -> None:
    for x in (-1.3, -0.9):
        assert float(clearance(bolt(), at(x, y), [prop])[0]) == pytest.approx(expected, abs=2e-3)


def test_a_volume_begins_where_wheels_roll_over_a_step() -> None:
    corners = np.array(list(product((-1.0, 3.0), (-0.9, 0.9), (0.3, 1.5))))
    wheel = np.array(list(product((-0.3, 0.3), (0.7, 0.9), (0.0, 0.6))))
    assert Volume.of([Part(corners, False), Part(wheel, True)], 0.3).low == pytest.approx(0.2)
    assert Volume.of([Part(corners - [0, 0, 0.2], False), Part(wheel, True)], 0.3).low == pytest.approx(0.1)
    assert Volume.of([Part(corners - [0, 0, 0.4], False), Part(wheel, True)], 0.3).low == pytest.approx(0.02)


def _random_prop(rng: np.random.Generator) -> PlacedProp:
    """Return a prop of one to four leaning boxes, upright cylinders and balls at all heights around a car."""
    solids = []
    for _ in range(rng.integers(1, 5)):
        middle = RigidTransform(
            RollPitchYaw(*rng.uniform(-0.7, 0.7, 3)), [*rng.uniform(-0.8, 0.8, 2), rng.uniform(0, 2.2)]
        )
        kind = rng.integers(3)
        if kind == 0:
            solids.append((Box(*rng.uniform(0.1, 1.5, 3)), middle))
        elif kind == 1:
            solids.append(
                (Cylinder(rng.uniform(0.05, 0.6), rng.uniform(0.2, 2.0)), RigidTransform(middle.translation()))
            )
        else:
            solids.append((Sphere(rng.uniform(0.1, 0.7)), middle))
    return place(*solids, yaw=rng.uniform(-3, 3))


def _layers(prop: PlacedProp, low: float, high: float) -> list[Any]:
    """Return the areas covered by a prop between two heights, from thin layers of independent formulas."""
    layers: list[Any] = []
    for solid in prop.prop.solids:
        X = prop.X_WP @ solid.X_PS
        x, y, z = X.translation()
        for height in np.linspace(low, high, 25):
            if isinstance(solid.shape, Sphere) and abs(height - z) < solid.shape.radius():
                layers.append(shapely.Point(x, y).buffer(math.sqrt(solid.shape.radius() ** 2 - (height - z) ** 2), 64))
            elif isinstance(solid.shape, Cylinder) and abs(height - z) < solid.shape.length() / 2.0:
                layers.append(shapely.Point(x, y).buffer(solid.shape.radius(), 64))
            elif isinstance(solid.shape, Box):
                half = solid.shape.size() / 2.0
                corners = np.array(list(product((-1, 1), repeat=3))) * half
                edges = [(a, b) for a in corners for b in corners if (a != b).sum() == 1]
                ends = [X.multiply(np.array(edge).T) for edge in edges]
                cut = [a + (height - a[2]) / (b[2] - a[2]) * (b - a) for a, b in (end.T for end in ends)
                       if (a[2] - height) * (b[2] - height) < 0.0]  # fmt: skip
                if len(cut) > 2:
                    layers.append(shapely.MultiPoint([point[:2] for point in cut]).convex_hull)
    return layers


def _free(car: list[tuple[Any, Any]], move: Any) -> bool:
    """Return whether the parts of a car are free after a translation, each against the shapes at its heights."""
    return not any(shapely.intersects(affinity.translate(shape, *move), solid) for shape, solid in car)


@pytest.mark.parametrize(
    "seeds", [range(12), pytest.param(range(12, 60), marks=pytest.mark.slow)], ids=["some", "many"]
)
def test_distance_and_depth_agree_with_brute_force_on_random_props(seeds: range) -> None:
    """Distances by thin layers; depths by trying moves in all directions, in steps of 1 cm."""
    angles = np.linspace(0.0, 2.0 * math.pi, 72, endpoint=False)
    overlapping = 0
    for seed in seeds:
        rng = np.random.default_rng(seed)
        prop, pose = _random_prop(rng), rng.uniform([-4, -4, -3], [4, 4, 3])[None]
        measured_distance = float(clearance(bolt(), pose, [prop])[0])
        car = [(shapely.Polygon(place_outline(slab.outline, pose)[0]), shapely.union_all(layers))
               for slab in bolt().slabs if (layers := _layers(prop, slab.low + 1e-6, slab.high - 1e-6))]  # fmt: skip
        if not car:
            assert measured_distance == math.inf
            continue
        distance = min(shapely.distance(shape, solid) for shape, solid in car)
        if measured_distance > 0.03:
            assert distance == pytest.approx(measured_distance, abs=0.03)  # layers are up to 3 cm apart
            continue
        overlapping += 1
        reach = -measured_distance - 0.06
        for length in np.arange(0.0, max(reach, 0.0), 0.05):
            assert not any(_free(car, length * np.array([math.cos(a), math.sin(a)])) for a in angles)
        rim = [
            (-measured_distance + 0.01) * np.array([math.cos(a), math.sin(a)]) for a in np.linspace(0, 2 * math.pi, 360)
        ]
        assert any(_free(car, move) for move in rim)
    assert overlapping >= len(seeds) // 5


# --- vehicles ------------------------------------------------------------------------------------------------------


def test_vehicles_count_each_with_its_own_shape_where_it_is_at_the_time() -> None:
    mine = np.array([[0, 0, 0], [0, 0, 0], [0, 0, 0.5], [0, 0, 0]], dtype=float)
    theirs = np.array([[0, 2.0, 0], [10, 0, math.pi], [0, 1.0, 0.5], [math.nan, 0, 0]], dtype=float)
    distance = clearance_between(bolt(), mine, bolt(), theirs)
    front = 2.601 / 2 + 2.085
    across = abs(-math.sin(0.5) * 0.0 + math.cos(0.5) * 1.0)
    expected = [2.0 - 2.0 * HALF, 10.0 - 2.0 * front, -(2.0 * HALF - across), math.inf]
    assert distance == pytest.approx(expected, abs=1e-6)
    low = Volume((Slab(SQUARE, 0.1, 0.5),), 0.1)
    high = Volume((Slab(SQUARE, 0.6, 1.5),), 0.1)
    assert np.isinf(clearance_between(low, mine, high, mine)).all()


def test_the_clearance_of_two_vehicles_is_that_of_their_nearest_pair_of_slabs() -> None:
    rng = np.random.default_rng(3)
    mine = rng.uniform([-9, -9, -3], [9, 9, 3], (60, 3))
    theirs = mine + rng.uniform([-8, -8, -3], [8, 8, 3], (60, 3))
    pairs = [
        shapely.distance(
            shapely.polygons(place_outline(a.outline, mine)), shapely.polygons(place_outline(b.outline, theirs))
        )
        for a in bolt().slabs
        for b in bolt().slabs
        if min(a.high, b.high) > max(a.low, b.low) + 1e-9
    ]
    nearest = np.min(pairs, axis=0)
    found = clearance_between(bolt(), mine, bolt(), theirs, rows=np.arange(50))
    apart = nearest[:50] > 0.0
    assert 20 < apart.sum() < 50
    # The same bits: pairs are only left out where they cannot be nearer.
    assert (found[:50][apart] == nearest[:50][apart]).all()
    assert (found[:50][~apart] < 0.0).all()
    assert np.isinf(found[50:]).all()


def test_a_prop_of_the_library_is_seen_by_its_heights() -> None:
    tree = PlacedProp("tree", load_prop("tree"), RigidTransform())
    assert tree.footprint.bounds[3] > 1.0
    (trunk,) = tree.between(0.2, 1.0)
    assert trunk.bounds[3] < 0.4
    assert not tree.between(50.0, 60.0)
