"""Checks of worlds: each planted fault is found with its line, and nothing else."""

import itertools
import math
import time
from collections.abc import Sequence
from pathlib import Path
from textwrap import dedent
from typing import Any

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st
from pydrake.geometry import Box, Capsule, Convex, Cylinder, Shape, Sphere
from pydrake.math import RigidTransform, RollPitchYaw

from mirdrake.vehicles import load_vehicle
from mirdrake.world_checks import Fault, check_world, examine, overlaps
from mirdrake.world_checks.obstacles import Body, Obstacle, Room
from mirdrake.world_checks.passages import Passage
from mirdrake.world_checks.search import search_path
from mirdrake.world_checks.separation import separate
from mirdrake.worlds import PlacedProp, Prop, load_world, make_world
from mirdrake.worlds.outlines import Outline, gap_between, outlines_of
from mirdrake.worlds.props import Solid
from tests.timing import reference_seconds


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def write(text: str) -> str:
    """Return a world file w.yaml; its first line is 2 of the file."""
    Path("w.yaml").write_text("mirdrake: world/1\n" + dedent(text).lstrip("\n"), encoding="utf-8")
    return "w.yaml"


def check(text: str, **more) -> list[Fault]:
    return check_world(write(text), **more)


def texts(faults: list[Fault]) -> list[tuple[str, str]]:
    """Return kind, and place in the file."""
    return [(fault.kind, fault.text.split(": ")[0]) for fault in faults]


# --- worlds that cannot be laid out-----------------------------------------------------------------------------------


def test_the_worlds_of_mirdrake_are_sound() -> None:
    for name in ("empty", "skidpad", "test_track"):
        assert check_world(name) == []


def test_an_unknown_world_is_one_fault() -> None:
    (fault,) = check_world("skidpat")
    assert fault.kind == "file"
    assert "did you mean 'skidpad'?" in fault.text


def test_all_misspelt_names_are_reported_with_suggestions() -> None:
    faults = check(
        """
        props:
          - {prop: conee, at: [0, 0]}
          - {prop: barrel, at: [3, 0]}
          - {prop: sedn, at: [9, 0]}
        """
    )
    assert texts(faults) == [("file", "w.yaml:3"), ("file", "w.yaml:5")]
    assert "did you mean 'cone'?" in faults[0].text
    assert "did you mean 'sedan'?" in faults[1].text


def test_a_gap_in_a_track_is_reported_with_its_size() -> None:
    (fault,) = check(
        """
        tracks:
          main:
            closed: true
            segments: [{line: 10}, {arc: {radius: 5, angle: 180 deg}}, {line: 9}, {arc: {radius: 5, angle: 180 deg}}]
        """
    )
    assert fault.kind == "file"
    assert fault.text.startswith("w.yaml:")
    assert "1.000 m" in fault.text or "1 m" in fault.text


def test_unplaced_props_are_reported() -> None:
    (fault,) = check(
        """
        props:
          - {box: [2, 2, 1], scatter: {region: {rect: {size: [5, 5]}}, count: 20}}
        """
    )
    assert (fault.kind, fault.text.split(": ")[0]) == ("unplaced", "w.yaml:3")


def test_each_broken_rule_is_reported_with_its_prop() -> None:
    faults = check(
        """
        start: {gate: {at: [0, 0]}}
        props:
          - {prop: cone, at: [1, 0]}
          - {prop: cone, name: far, at: [9, 0]}
          - {prop: cone, name: near_far, at: [9.5, 0]}
        rules:
          - {keep_clear: {around: gate, radius: 3}}
          - {min_gap: 0.4}
          - {outside: {props: barel, region: {disc: {radius: 2}}}}
        """
    )
    assert texts(faults) == [("rule", "w.yaml:4"), ("rule", "w.yaml:10"), ("gap", "w.yaml:5")]
    assert faults[2].names == ("far", "near_far")
    assert faults[2].depth == pytest.approx(0.13, abs=0.002)  # cones 0.37 m wide
    assert "w.yaml:9" in faults[2].text


# --- overlaps -----------------------------------------------------------------------------------------------------

PAIR = """
props:
  - {{box: [2, 1, 1], name: left, at: [100, 50], yaw: {yaw}}}
  - {{{other}, name: right, at: [{x}, {y}], yaw: {yaw}}}
"""


def pair(gap: float, *, other: str = "box: [2, 1, 1]", yaw: float = 0.5, half: float = 1.0) -> list[Fault]:
    """Return a box and something else behind it, along the box's x."""
    far = 1.0 + half + gap
    return check(PAIR.format(yaw=yaw, other=other, x=100.0 + far * math.cos(yaw), y=50.0 + far * math.sin(yaw)))


@pytest.mark.parametrize(
    ("other", "half"), [("box: [2, 1, 1]", 1.0), ("cylinder: [0.3, 1]", 0.3), ("sphere: 0.4", 0.4)]
)
def test_one_millimetre_of_overlap_is_found_with_depth_and_place_and_one_of_gap_is_sound(
    other: str, half: float
) -> None:
    (fault,) = pair(-0.001, other=other, half=half)
    assert (fault.kind, fault.names, fault.text.split(": ")[0]) == ("overlap", ("left", "right"), "w.yaml:3")
    assert "(w.yaml:4)" in fault.text
    assert "1 mm" in fault.text
    assert fault.depth == pytest.approx(0.001, rel=0.01)
    assert fault.position is not None
    along = np.array([math.cos(0.5), math.sin(0.5)])
    assert (np.array(fault.position[:2]) - [100, 50]) @ along == pytest.approx(1.0, abs=0.002)
    assert shapely.Polygon(fault.polygon).buffer(0.002).contains(shapely.Point(100 + along[0], 50 + along[1]))
    assert pair(0.001, other=other, half=half) == []


@pytest.mark.parametrize("yaw", [0.0, 0.3, math.pi / 2, 2.0])
def test_contact_is_not_an_overlap(yaw: float) -> None:
    assert pair(0.0, yaw=yaw) == []
    assert pair(0.0, yaw=yaw, other="cylinder: [0.3, 1]", half=0.3) == []


def test_props_on_top_and_allowed_overlaps_are_not_reported() -> None:
    world = """
    props:
      - {box: [2, 2, 1], name: base, at: [0, 0]}
      - {box: [1, 1, 1], name: top, at: [0, 0, 1]}
      - {box: [1, 1, 1], name: side, at: [1.2, 0]}
    """
    assert [fault.names for fault in check(world)] == [("base", "side")]
    assert check(world + "rules:\n      - {allow_overlap: [base, 'si*']}\n") == []
    misspelt, _ = check(world + "rules:\n      - {allow_overlap: [base, 'so*']}\n")
    assert (misspelt.kind, "no prop is called 'so*'" in misspelt.text) == ("rule", True)


def test_every_pair_is_reported_by_its_collision_shapes() -> None:
    faults = check(
        """
        props:
          - {prop: sedan, name: car, line: {from: [0, 0], to: [12, 0], spacing: 4}}
          - {prop: cone, name: inside, at: [0.5, 0.2]}
        """
    )
    assert [fault.names for fault in faults] == [
        ("car[0]", "car[1]"), ("car[0]", "inside"), ("car[1]", "car[2]"), ("car[2]", "car[3]"),
    ]  # fmt: skip
    assert all(fault.depth is not None and fault.depth > 0.1 for fault in faults)


def test_five_hundred_props_are_laid_out_and_checked_within_a_second() -> None:
    name = write(
        """
        ground: {size: [400, 400]}
        props:
          - {prop: cone, grid: {origin: [-100, -150], step: [5, 5], count: [20, 10]}, yaw: 20 deg}
          - {prop: barrel, grid: {origin: [20, -150], step: [5, 5], count: [20, 10]}}
          - {box: [1, 2, 1], yaw: 0 .. 9, scatter: {region: {rect: {center: [0, 99], size: [90, 50]}}, count: 90}}
          - {box: [4, 2, 1], name: over, line: {from: [-150, 0], to: [-150, 27], count: 10}}
        """
    )
    load_world(name)

    def check() -> None:
        assert len(check_world(name)) == 9

    assert reference_seconds(check, clock=time.perf_counter) < 3.0  # 0.2 s on an idle machine
    write(Path(name).read_text().replace("mirdrake: world/1\n", "").replace("27]", "60]"))
    world = load_world(name)
    assert check_world(world) == []
    assert reference_seconds(lambda: check_world(world)) < 0.5  # 0.02 s: no outlines overlap


def test_a_pile_of_props_is_checked_within_limits_and_the_report_states_them(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(overlaps, "MOST_OVERLAPS", 5)
    world = "props:\n  - {prop: barrel, grid: {step: [0, 0], count: [30, 1]}}\n"
    faults = check(world)
    assert [fault.kind for fault in faults] == ["overlap"] * 5 + ["unchecked"]
    assert "first 5 overlapping pairs" in faults[-1].text
    monkeypatch.setattr(overlaps, "MOST_NEIGHBOURS", 20)
    faults = check(world + "rules:\n  - {allow_overlap: ['*', '*']}\n")
    assert [fault.kind for fault in faults] == ["unchecked"]


@pytest.mark.slow
def test_two_thousand_props_in_one_place_are_checked_within_half_a_minute() -> None:
    grid = "{origin: [0, 0], step: [0, 0], count: [2000, 1]}"
    for more in ("}", ", z: 3}\nrules:\n  - {min_gap: 0.5}\n  - {allow_overlap: ['*', '*']}"):
        begin = time.process_time()
        faults = check(f"props:\n  - {{prop: barrel, grid: {grid}{more}\n")
        assert any(fault.kind == "unchecked" for fault in faults)
        assert time.process_time() - begin < 30.0


def test_the_total_number_of_draws_of_a_world_is_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    from mirdrake.worlds import arrange

    entry = "  - {prop: barrel, name: NAME, scatter: {region: {rect: {size: [0.8, 0.8]}}, count: 1}}\n"
    world = write("props:\n" + "".join(entry.replace("NAME", f"b{i}") for i in range(40)))
    tries = itertools.count()
    true = arrange._PlacedProps.has_room

    def has_room(self: Any, props: Any) -> bool:
        next(tries)
        return bool(true(self, props))

    monkeypatch.setattr(arrange._PlacedProps, "has_room", has_room)
    monkeypatch.setattr(arrange, "MOST_DRAWS", 1000)
    assert len(load_world(world).unplaced_props) > 35
    assert next(tries) < 1000 + 400 + 40


# --- depth of overlaps --------------------------------------------------------------------------------------------


def placed(*solids: tuple[Shape, tuple[float, float, float]], X_WP: RigidTransform | None = None) -> PlacedProp:
    """Return a prop of shapes at places in its own frame [m]."""
    parts = tuple(Solid(shape, RigidTransform(list(position))) for shape, position in solids)
    return PlacedProp("p", Prop("p", parts, (1.0,) * 3, 1.0), X_WP or RigidTransform(), where="w:1: p")


BALL = Convex(np.random.default_rng(0).normal(size=(3, 2000)), "corners")
BALL_BOTTOM = min(BALL.GetConvexHull().vertex(i)[2] for i in range(BALL.GetConvexHull().num_vertices()))
CORNER = ((Box(2.0, 1.0, 1.0), (1.0, 0.5, 0.0)), (Box(1.0, 2.0, 1.0), (0.5, 1.0, 0.0)))
COMB = tuple((Box(0.5, 4.0, 2.0), (x, 0.0, 1.0)) for x in (-1.0, 0.0, 1.0))
POSTS = tuple((Cylinder(0.4, 2.0), (x, 0.0, 1.0)) for x in (0.0, 0.9))


@pytest.mark.parametrize("turned", [(0.0, 0.0, 0.0), (0.3, -0.2, 0.7)])
@pytest.mark.parametrize(
    ("first", "second", "depth"),
    [
        ([(Box(1, 1, 1), (0, 0, 0))], [(Box(1, 1, 1), (0.9, 0.2, 0.1))], 0.1),
        ([(Box(1, 1, 1), (0, 0, 0))], [(Box(1, 1, 1), (1, 0, 0))], 0.0),  # touching
        ([(Box(1, 1, 1), (0, 0, 0))], [(Box(1, 1, 1), (0, 0, 0))], 1.0),  # identical
        ([(Box(1, 1, 1), (0, 0, 0))], [(Sphere(0.1), (0.1, 0, 0))], 0.5),  # contained
        ([(Box(4, 4, 0.001), (0, 0, 0))], [(Box(1, 1, 1), (0, 0, 0.2))], 0.3005),  # thin
        ([(Box(1, 1, 1), (0, 0, 0))], [(Capsule(0.2, 1), (0.6, 0, 0))], 0.1),
        ([(Sphere(0.5), (0, 0, 0))], [(Sphere(0.7), (0.3, 0.4, 0))], 0.7),
        ([(Sphere(0.5), (0, 0, 0))], [(Sphere(0.5), (0, 0, 0))], 1.0),  # no direction is better than another
        ([(Cylinder(0.4, 2), (0, 0, 0))], [(Cylinder(0.4, 2), (0.5, 0, 0))], 0.3),
        ([(Box(1e4, 1e4, 2), (0, 0, -1))], [(Sphere(0.5), (0, 0, 0.3))], 0.2),
        (CORNER, [(Sphere(0.3), (1.1, 1.1, 0))], 0.2 * math.sqrt(2.0)),  # out of a re-entrant edge
        (COMB, [(Box(0.7, 4, 2), (0.5, 0, 1))], 1.1),  # each tooth alone: 0.1 m; the gaps are too narrow
        (POSTS, [(Sphere(0.5), (0.45, 0.1, 1))], math.sqrt(0.9**2 - 0.45**2) - 0.1),
        ([(BALL, (0, 0, 0))], [(Box(100, 100, 100), (0, 0, -50))], -BALL_BOTTOM),
    ],
)  # fmt: skip
def test_the_depth_of_an_overlap_agrees_with_closed_forms(
    first: list[tuple[Any, ...]], second: list[tuple[Any, ...]], depth: float, turned: tuple[float, float, float]
) -> None:
    X_WP = RigidTransform(RollPitchYaw(*turned), [50.0, -20.0, 3.0])
    separation = separate(placed(*first, X_WP=X_WP), placed(*second, X_WP=X_WP))
    assert separation.depth == pytest.approx(depth, abs=5e-4)
    assert depth - 1e-3 <= separation.least <= depth + 1e-6


@pytest.mark.parametrize("seed", range(12))
def test_the_bounds_of_the_depth_of_unions_contain_the_exact_depth(seed: int) -> None:
    rng = np.random.default_rng(seed)
    middles, halves = rng.uniform(-1.0, 1.0, (2, 4, 3)), rng.uniform(0.1, 0.8, (2, 4, 3))
    first, second = (
        placed(*((Box(*(2.0 * half)), tuple(middle)) for middle, half in zip(m, h, strict=True)))
        for m, h in zip(middles, halves, strict=True)
    )
    apart = middles[1][None] - middles[0][:, None]
    reach = halves[1][None] + halves[0][:, None]

    def is_free(t: np.ndarray) -> np.ndarray:
        """Return whether no two boxes along the axes overlap after translations (n, 3)."""
        return np.asarray((np.abs(apart - t[:, None, None]) >= reach - 1e-5).any(axis=-1).all(axis=(1, 2)))

    # The nearest free translation has each coordinate at 0 or at a side of a difference of two boxes.
    levels = [
        np.concatenate(([0.0], (apart - reach)[..., i].ravel(), (apart + reach)[..., i].ravel())) for i in range(3)
    ]
    grid = np.stack(np.meshgrid(*levels, indexing="ij"), axis=-1).reshape(-1, 3)
    truth = np.linalg.norm(grid, axis=1)[is_free(grid)].min()
    separation = separate(first, second)
    assert is_free(separation.translation[None]).all()
    assert separation.depth == pytest.approx(truth, abs=1e-3)
    assert separation.least <= truth + 1e-5


def random_shape(rng: np.random.Generator) -> Shape:
    """Return a box, cylinder, sphere, capsule or convex hull with sizes from 5 cm to 3 m."""
    sizes = np.exp(rng.uniform(np.log(0.05), np.log(3.0), 3))
    match rng.integers(5):
        case 0:
            return Box(*sizes)
        case 1:
            return Cylinder(*sizes[:2])
        case 2:
            return Sphere(sizes[0])
        case 3:
            return Capsule(*sizes[:2])
        case _:
            return Convex(rng.normal(size=(3, rng.integers(5, 40))) * sizes[:, None], "corners")


def extent_along(shape: Shape, X_WS: RigidTransform, directions: np.ndarray) -> np.ndarray:
    """Return the support function of a shape along unit vectors (n, 3) in W [m]."""
    local = directions @ X_WS.rotation().matrix()
    match shape:
        case Box():
            extent = np.abs(local) @ (0.5 * shape.size())
        case Sphere():
            extent = np.full(len(local), shape.radius())
        case Capsule():
            extent = shape.radius() + 0.5 * shape.length() * np.abs(local[:, 2])
        case Cylinder():
            extent = shape.radius() * np.hypot(local[:, 0], local[:, 1]) + 0.5 * shape.length() * np.abs(local[:, 2])
        case _:
            hull = shape.GetConvexHull()
            extent = (local @ np.array([hull.vertex(i) for i in range(hull.num_vertices())]).T).max(axis=1)
    return np.asarray(extent + directions @ X_WS.translation())


def depth_by_directions(shapes: Sequence[Shape], poses: Sequence[RigidTransform]) -> float:
    """Return the smallest extent of the Minkowski difference over directions [m]; negative: a gap at least as wide."""

    def extent(directions: np.ndarray) -> np.ndarray:
        first = extent_along(shapes[0], poses[0], directions)
        return np.asarray(first + extent_along(shapes[1], poses[1], -directions))

    number = np.arange(4000) + 0.5  # a Fibonacci lattice, then random steps that become smaller from the best points
    up, azimuth = 1.0 - 2.0 * number / len(number), math.pi * (1.0 + math.sqrt(5.0)) * number
    radius = np.sqrt(1.0 - up**2)
    directions = np.column_stack((np.cos(azimuth) * radius, np.sin(azimuth) * radius, up))
    best = directions[np.argsort(extent(directions))[:40]]
    rng, step = np.random.default_rng(0), 0.06
    for _ in range(50):
        trials = np.concatenate((best[:, None], best[:, None] + step * rng.normal(size=(len(best), 30, 3))), axis=1)
        trials /= np.linalg.norm(trials, axis=2, keepdims=True)
        extents = extent(trials.reshape(-1, 3)).reshape(len(best), -1)
        best = trials[np.arange(len(best)), extents.argmin(axis=1)]
        step *= 0.78
    return float(extent(best).min())


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_the_depth_of_random_pairs_is_the_smallest_extent_of_their_difference(seed: int) -> None:
    rng = np.random.default_rng(seed)
    count = 0
    while count < (40 if seed == 0 else 200):
        shapes = random_shape(rng), random_shape(rng)
        poses = [RigidTransform(RollPitchYaw(*rng.uniform(-3, 3, 3)), rng.uniform(-1, 1, 3)) for _ in shapes]
        depth = depth_by_directions(shapes, poses)
        if abs(depth) < 1e-3:
            continue
        first, second = (placed((shape, (0, 0, 0)), X_WP=pose) for shape, pose in zip(shapes, poses, strict=True))
        separation = separate(first, second)
        assert separation.depth == pytest.approx(max(depth, 0.0), abs=5e-4)
        assert separation.least <= depth + 1e-5 or depth < 0.0
        count += depth > 0.0


@pytest.mark.parametrize("turned", [(0.0, 0.0, 0.0), (math.pi / 4, 0.0, 0.0), (0.5, 0.8, 0.2)])
def test_an_overlap_with_the_side_of_a_turned_sphere_is_found(turned: tuple[float, float, float]) -> None:
    sphere = placed((Sphere(1.0), (0, 0, 0)), X_WP=RigidTransform(RollPitchYaw(*turned), [0.0, 0.0, 1.0]))
    assert (sphere.bottom, sphere.top) == pytest.approx((0.0, 2.0))
    for side in ((1.05, 0.0, 1.0), (0.0, 1.05, 1.0), (0.0, 0.0, 2.05)):
        box = placed((Box(0.2, 0.2, 0.2), side))
        (fault,) = overlaps.find_overlaps(overlaps.Neighbours([sphere, box]), lambda _a, _b: False)
        assert fault.depth == pytest.approx(0.05, abs=5e-4)


def test_the_depth_of_an_overlap_does_not_depend_on_the_order_of_the_props() -> None:
    rng = np.random.default_rng(3)
    shapes = [Box(0.5, 0.8, 0.4), Cylinder(0.3, 1.0), Sphere(0.4), Capsule(0.2, 0.7)]
    poses = [RigidTransform(RollPitchYaw(*rng.uniform(-3, 3, 3)), rng.uniform(-0.4, 0.4, 3)) for _ in shapes]
    for first in range(4):
        solid = placed((shapes[first], (0, 0, 0)), X_WP=poses[first])
        rest = Prop("rest", tuple(map(Solid, shapes[:first] + shapes[first + 1 :], poses[:first] + poses[first + 1 :])),
                    (1.0,) * 3, 1.0)  # fmt: skip
        other = PlacedProp("rest", rest, RigidTransform())
        assert separate(solid, other).depth == pytest.approx(separate(other, solid).depth, abs=1e-3)


def test_a_depth_that_is_not_certain_is_reported_as_a_range() -> None:
    # A slot of exactly the width of the bar: whether the bar fits into it cannot be decided by numbers.
    bars = placed((Box(0.5, 4.0, 2.0), (-0.5, 0.0, 1.0)), (Box(0.5, 4.0, 2.0), (0.5, 0.0, 1.0)))
    bar = placed((Box(0.5, 4.0, 2.0), (0.1, 0.0, 1.0)))
    (fault,) = overlaps.find_overlaps(overlaps.Neighbours([bars, bar]), lambda _a, _b: False)
    assert fault.depth == pytest.approx(0.9, abs=1e-3)
    assert "by 10 cm to 90 cm at" in fault.text


def test_a_world_check_reports_the_depth_that_separates_all_solids() -> None:
    X_WP = RigidTransform(RollPitchYaw(0.0, 0.0, 0.7), [5.0, 3.0, 0.0])
    comb, bar = placed(*COMB, X_WP=X_WP), placed((Box(0.7, 4.0, 2.0), (0.5, 0.0, 1.0)), X_WP=X_WP)
    (fault,) = overlaps.find_overlaps(overlaps.Neighbours([comb, bar]), lambda _a, _b: False)
    assert fault.depth == pytest.approx(1.1, abs=1e-3)
    assert "by 1.1 m at" in fault.text


# --- on the ground ------------------------------------------------------------------------------------------------


def test_buried_and_floating_props_are_reported_with_their_distance() -> None:
    faults = check(
        """
        props:
          - {box: [1, 1, 1], name: sunk, at: [0, 0, -0.3]}
          - {prop: cone, name: up, at: [3, 0], z: 25 cm}
          - {box: [1, 1, 1], name: tilted, at: [6, 0], pitch: 30 deg}
          - {prop: sedan, at: [12, 0]}
          - {sphere: 0.4, at: [20, 0]}
        """
    )
    assert texts(faults) == [("buried", "w.yaml:3"), ("buried", "w.yaml:5"), ("floating", "w.yaml:4")]
    assert [fault.depth for fault in faults] == pytest.approx([0.3, 0.25, 0.25])
    assert "30 cm" in faults[0].text


def test_props_on_uneven_ground_are_compared_with_the_ground_below_them() -> None:
    """A road along the x axis that rises by 1 m in 10 m: 2 m long boxes have 0.2 m of it below them."""
    faults = check(
        """
        ground: {relief: [{road: {along: main, grade: [[0, 0.1], [100, 0.1]]}}]}
        tracks: {main: {segments: [{line: 100}], width: 8}}
        props:
          - {box: [2, 1, 1], at: [20, 0]}
          - {box: [2, 1, 1], at: [30, 0, 3]}
          - {box: [2, 1, 1], at: [40, 0, 3.885]}
          - {box: [2, 1, 1], at: [50, 0, 4.85]}
          - {box: [2, 1, 1], at: [60, 0, 6.115]}
          - {box: [2, 1, 1], at: [70, 0, 7.3]}
          - {box: [2, 1, 1], at: [70, 0, 8.3], yaw: 10 deg}
          - {box: [2, 1, 1], at: [90, 0, 0]}
        """
    )
    # The first three and the fifth are on the ground within 2 cm. Of two boxes in the air, the upper one floats, too.
    found = {fault.text.split(": ")[0]: (fault.kind, fault.depth) for fault in faults}
    expected = {
        "w.yaml:8": ("buried", 0.05),
        "w.yaml:10": ("floating", 0.2),
        "w.yaml:11": ("floating", 1.2),
        "w.yaml:12": ("buried", 8.9),
    }
    assert found.keys() == expected.keys()
    for place, (kind, depth) in expected.items():
        assert found[place][0] == kind
        assert found[place][1] == pytest.approx(depth, abs=0.02)


def test_props_on_supported_props_are_not_floating() -> None:
    world = """
    props:
      - {box: [1, 1, 1], name: first, at: [0, 0]}
      - {box: [1, 1, 1], name: second, at: [0.2, 0, 1]}
      - {box: [1, 1, 1], name: third, at: [0.4, 0, 2]}
      - {box: [0.1, 1, 0.3], name: sign, at: [-0.55, 0, 0.4]}
      - {box: [1, 1, 1], name: lone, at: [5, 0, 1]}
      - {box: [1, 1, 1], name: on_lone, at: [5, 0, 2]}
    """
    assert [fault.names for fault in check(world)] == [("lone",), ("on_lone",)]
    loose = world.replace("at: [-0.55, 0, 0.4]", "at: [-0.55, 0, 0.4], static: false")
    assert [fault.names for fault in check(loose)] == [("sign",), ("lone",), ("on_lone",)]


def test_the_rule_on_ground_sets_the_tolerance_and_the_last_one_counts() -> None:
    world = """
    props:
      - {box: [1, 1, 1], name: lamp, at: [0, 0, 3]}
      - {box: [1, 1, 1], name: bump, at: [3, 0, -0.01]}
    rules: [RULES]
    """
    assert [fault.names for fault in check(world.replace("RULES", ""))] == [("lamp",)]
    lamp = "{on_ground: {props: lamp, tolerance: 3}}"
    assert check(world.replace("RULES", lamp)) == []
    strict = world.replace("RULES", "{on_ground: {tolerance: 1 mm}}, " + lamp)
    assert [(fault.kind, fault.names) for fault in check(strict)] == [("buried", ("bump",))]


# --- starts and goals ---------------------------------------------------------------------------------------------


def test_a_start_in_a_wall_is_reported_for_the_vehicle_or_else_for_its_centre() -> None:
    world = """
    start:
      gate: {at: [0, 0]}
      free: {at: [0, 20]}
    props:
      - {prop: wall, at: [3, 0], yaw: 90 deg}
    """
    assert check(world) == []
    (fault,) = check(world, vehicle="bolt")
    assert texts([fault]) == [("start", "w.yaml:3")]
    assert fault.names == ("wall",)
    assert "(w.yaml:6)" in fault.text
    front = 3.3855
    assert fault.depth == pytest.approx(front - 2.9, abs=1e-3)
    assert check(world.replace("at: [3, 0]", f"at: [{front + 0.101}, 0]"), vehicle="bolt") == []
    (fault,) = check(world.replace("at: [3, 0]", "at: [0, 0]"))
    assert texts([fault]) == [("start", "w.yaml:3")]


def test_a_vehicle_may_start_below_a_beam_and_on_a_bump_but_not_beyond_the_ground() -> None:
    world = """
    ground: {size: [40, 40]}
    start:
      gate: {at: [0, 0]}
      edge: {at: [0, 19.5]}
    props:
      - {box: [1, 6, 0.3], name: beam, at: [1, 0, 3]}
      - {box: [0.3, 0.3, 3], name: post, line: {from: [1, -2.8], to: [1, 2.8], count: 2}}
      - {prop: speed_bump, at: [2, 0]}
    """
    faults = check(world, vehicle="bolt")
    assert texts(faults) == [("start", "w.yaml:5")]
    assert "outside the ground" in faults[0].text


def test_a_goal_in_a_wall_is_reported() -> None:
    (fault,) = check("goals:\n  exit: {at: [5, 0], radius: 0.5}\nprops:\n  - {box: [2, 2, 1], at: [5, 0]}\n")
    assert texts([fault]) == [("goal", "w.yaml:3")]


# --- paths --------------------------------------------------------------------------------------------------------

GAP = """
ground: {{size: [50, 30]}}
start:
  gate: {{at: [-15, 0]}}
goals:
  exit: {{at: [15, 6], radius: 1}}
props:
  - {{box: [0.2, 14, 2], name: left, at: [0, {left}]}}
  - {{box: [0.2, 14, 2], name: right, at: [0, {right}]}}
  - {{box: [0.2, 14, 2], name: far_left, at: [0, {far_left}]}}
  - {{box: [0.2, 14, 2], name: far_right, at: [0, {far_right}]}}
"""
DRIVABLE = "rules:\n  - {drivable: {vehicle: bolt, from: gate, to: exit, margin: 0}}\n"
TEST = "tests:\n  - {name: out, goal: exit, behaviour: {kind: constant, speed: 2}, expect: [eventually at goal]}\n"


def gap_world(width: float) -> str:
    near, far = 7.0 + width / 2.0, 21.0 + width / 2.0
    return GAP.format(left=near, right=-near, far_left=far, far_right=-far)


@pytest.mark.parametrize("what", [DRIVABLE, TEST])
def test_there_is_a_path_through_a_gap_only_if_it_is_wider_than_the_car(what: str) -> None:
    width = 2.0 * Body.of(load_vehicle("bolt")).half_width
    (fault,) = check(gap_world(width - 0.05) + what)
    assert texts([fault]) == [("unreachable", "w.yaml:13")]
    assert "no path for bolt (1.76 m wide" in fault.text or "no path for bolt (1.77 m wide" in fault.text
    assert "1.71 m wide at (0.00, 0.00) m, between 'left' and 'right'" in fault.text
    report = examine(write(gap_world(width + 0.5) + what))
    assert report.faults == []
    (path,) = report.paths
    assert (path.vehicle, path.start, path.goal) == ("bolt", "gate", "exit")
    assert path.length < 35.0


def test_the_margin_of_the_rule_counts() -> None:
    world = gap_world(1.9)
    assert check(world + DRIVABLE) == []
    (fault,) = check(world + DRIVABLE.replace("margin: 0", "margin: 0.1"))
    assert "1.97 m are needed" in fault.text or "1.96 m are needed" in fault.text


def test_an_enclosed_goal_is_unreachable() -> None:
    (fault,) = check(gap_world(0.0) + DRIVABLE)
    assert texts([fault]) == [("unreachable", "w.yaml:13")]
    assert "the goal is enclosed" in fault.text


def test_a_path_stays_on_the_ground() -> None:
    world = gap_world(0.0).replace("far_left, at: [0, 21.0]", "far_left, at: [0, 35.0]")
    assert [fault.kind for fault in check(world + DRIVABLE)] == ["unreachable"]
    wide = world.replace("size: [50, 30]", "size: [50, 44]").replace("at: [0, 35.0]", "at: [0, 60.0]")
    assert check(wide + DRIVABLE) == []


TURN = """
ground: {{size: [80, 80]}}
params: {{w: {width}}}
start:
  gate: {{at: [0, 0]}}
goals:
  exit: {{at: [20, 16], radius: 1}}
props:
  - {{box: [24, 0.2, 2], name: south, at: [10, -$w/2 - 0.1]}}
  - {{box: [21.8 - $w/2, 0.2, 2], name: north, at: [8.9 - $w/4, $w/2 + 0.1]}}
  - {{box: [0.2, 20, 2], name: east, at: [20 + $w/2 + 0.1, 9.7 - $w/2]}}
  - {{box: [0.2, 19, 2], name: west, at: [20 - $w/2 - 0.1, 9.7 + $w/2]}}
  - {{box: [0.2, 8, 2], name: back, at: [-2, 0]}}
rules:
  - {{drivable: {{from: gate, to: exit, margin: 0}}}}
  - {{allow_overlap: ["*", "*"]}}
"""


def test_there_is_no_path_around_a_wide_corner_that_the_car_cannot_turn() -> None:
    (fault,) = check(TURN.format(width=2.4))
    assert texts([fault]) == [("unreachable", "w.yaml:15")]
    assert "cannot turn" in fault.text
    assert "turning radius 4.5 m" in fault.text
    report = examine(write(TURN.format(width=5.0)))
    assert report.faults == []
    assert len(report.paths) == 1


def test_the_robot_turns_where_the_car_cannot() -> None:
    world = TURN.format(width=2.4).replace("from: gate,", "vehicle: unior, from: gate,")
    assert check(world) == []


def test_a_search_that_reaches_its_time_limit_is_reported() -> None:
    (fault,) = check(TURN.format(width=5.0), time_limit=0.0)
    assert "none was found within 0 s of computing" in fault.text


def test_a_path_may_lead_to_a_gate_of_a_track_and_to_a_start() -> None:
    report = examine(
        write(
            """
            tracks: {main: {segments: [{line: 40}]}}
            start: {gate: {on_track: {track: main, s: 5}}, other: {at: [3, 12], yaw: 90 deg}}
            goals: {line: {gate: {track: main, s: 30}}, twice: {laps: 2}}
            rules:
              - {drivable: {from: gate, to: other}}
            tests:
              - {name: a, goal: line, behaviour: {kind: constant, speed: 2}, expect: [eventually at goal]}
            """
        )
    )
    assert report.faults == []
    assert [(path.start, path.goal) for path in report.paths] == [("gate", "other"), ("gate", "line")]
    assert report.paths[1].poses[-1, 0] == pytest.approx(30.0, abs=1.0)


def test_a_path_is_smooth_and_free_for_the_box_of_the_vehicle() -> None:
    world = load_world(write(gap_world(2.3) + DRIVABLE))
    (path,) = examine(world).paths
    body = Body.of(load_vehicle("bolt"))
    x, y, yaw = path.poses.T
    boxes = body.boxes(x, y, yaw)
    solids = shapely.union_all([prop.footprint for prop in world.props])
    assert not shapely.intersects(boxes, solids).any()
    step, turn = np.hypot(np.diff(x), np.diff(y)), np.abs(np.diff(yaw))
    assert (turn <= 1.01 * step / body.radius + 1e-9).all()
    along = (np.diff(x) * np.cos(0.5 * (yaw[1:] + yaw[:-1])) + np.diff(y) * np.sin(0.5 * (yaw[1:] + yaw[:-1]))) / step
    assert np.abs(along) == pytest.approx(1.0, abs=1e-6)


# --- tests of the file --------------------------------------------------------------------------------------------


def test_the_tests_of_a_world_are_checked_each_fault_once() -> None:
    faults = check(
        """
        start: {gate: {at: [0, 0]}}
        goals: {exit: {at: [9, 0]}}
        tests:
          - {name: a, vehicle: blt, behaviour: {kind: constant, speed: 2}, expect: [never colision]}
          - {name: b, start: gat, goal: exot, behaviour: {kind: constant, speed: 2}, expect: [never collision]}
        """
    )
    assert sorted(fault.text.split(": ")[1] for fault in faults) == [
        "tests.0.expect.0", "tests.0.vehicle", "tests.1.goal", "tests.1.start",
    ]  # fmt: skip
    assert {fault.text.split(": ")[0] for fault in faults} == {"w.yaml:5", "w.yaml:6"}
    assert len({fault.text for fault in faults}) == len(faults)


def test_overrides_reach_the_world_and_its_tests() -> None:
    world = "params: {x: 9}\ngoals: {exit: {at: [$x, 0]}}\nprops:\n  - {prop: wall, at: [0, 5]}\n" + TEST
    assert check(world) == []
    (fault,) = check(world, overrides=("params.x=900",))
    assert fault.kind == "unreachable"
    assert "'exit' is outside the ground" in fault.text
    (fault,) = check(world, overrides=("params.z=1",))
    assert fault.kind == "test"
    assert "unknown parameter 'z'" in fault.text


def test_a_world_made_in_python_is_checked_too() -> None:
    world = make_world({"mirdrake": "world/1", "props": [{"box": [1, 1, 1], "at": [0, 0, 2]}]})
    assert [fault.kind for fault in check_world(world)] == ["floating"]


# --- the parts ----------------------------------------------------------------------------------------------------


def test_outlines_have_the_heights_and_widths_of_the_solids() -> None:
    solids = (
        Solid(Cylinder(0.3, 1.0), RigidTransform([1.0, 0.0, 0.5])),
        Solid(Cylinder(0.3, 1.0), RigidTransform(RollPitchYaw(math.pi / 2, 0.0, 0.0), [0.0, 0.0, 0.3])),
        Solid(Sphere(0.4), RigidTransform([0.0, 2.0, 0.4])),
        Solid(Box(1.0, 2.0, 3.0), RigidTransform([0.0, 0.0, 1.5])),
    )
    placed = PlacedProp("p", Prop("p", solids, (1.0, 1.0, 1.0), 1.0), RigidTransform([5.0, 0.0, 0.0]))
    upright, lying, ball, box = outlines_of(placed)
    assert (upright.radius, upright.core.bounds[0], upright.bottom, upright.top) == pytest.approx((0.3, 6.0, 0.0, 1.0))
    assert (lying.bottom, lying.top) == pytest.approx((0.0, 0.6), abs=1e-9)
    assert lying.area.bounds == pytest.approx((4.7, -0.5, 5.3, 0.5), abs=0.003)
    assert (ball.radius, ball.bottom, ball.top) == pytest.approx((0.4, 0.0, 0.8))
    assert box.area.bounds == pytest.approx((4.5, -1.0, 5.5, 1.0))


@given(
    x=st.floats(-3, 3), y=st.floats(-3, 3), yaw=st.floats(0, 6.3), radius=st.sampled_from([0.0, 0.4]),
)  # fmt: skip
def test_a_translation_by_the_depth_separates_two_outlines(x: float, y: float, yaw: float, radius: float) -> None:
    outline = Outline(shapely.box(-1.0, -0.5, 1.0, 0.5), 0.0, 0.0, 1.0)
    other = shapely.affinity.rotate(shapely.box(-1.5, -0.2, 1.5, 0.2), yaw, use_radians=True, origin=(0, 0))
    two = Outline(shapely.affinity.translate(other, x, y), radius, 0.0, 1.0)
    gap = gap_between(outline, two)
    area = outline.area.intersection(two.area).area
    if gap > 1e-9:
        assert area == 0.0
        assert gap == pytest.approx(outline.area.distance(two.area), abs=0.01 * radius + 1e-9)
    elif gap < -1e-6 and not radius:
        assert area > 0.0
        normals = np.concatenate((outline.normals, two.normals))
        pushes = [shapely.affinity.translate(two.core, *(sign * -gap * n)) for n in normals for sign in (-1.0, 1.0)]
        assert min(outline.core.intersection(push).area for push in pushes) < 1e-6


def test_room_agrees_with_the_box_itself() -> None:
    rng = np.random.default_rng(3)
    outlines = [
        Outline(shapely.Point(*rng.uniform(-15, 15, 2)), float(rng.uniform(0.05, 1.0)), 0.0, 1.0) for _ in range(25)
    ]
    outlines.append(Outline(shapely.Polygon([(-5, -5), (5, -4.9), (5, -5)]), 0.0, 0.0, 1.0))
    body = Body("car", -0.8, 3.4, 0.9, 1.6, 4.5)
    room = Room([Obstacle(0, o) for o in outlines], (-20.0, -20.0, 20.0, 20.0), body, np.zeros((1, 2)))
    x, y, yaw = rng.uniform(-22, 22, 4000), rng.uniform(-22, 22, 4000), rng.uniform(-7, 7, 4000)
    free = room.is_free(x, y, yaw)
    assert 0.1 < free.mean() < 0.9
    assert (free == room.fits(x, y, yaw)).all()
    boxes = body.boxes(x, y, yaw)
    exact = ~shapely.intersects(boxes, shapely.union_all(room.areas)) & shapely.box(-20, -20, 20, 20).contains(boxes)
    assert (free == exact).all()


def test_the_bottleneck_is_found() -> None:
    walls = [shapely.box(-0.1, 0.6, 0.1, 20), shapely.box(-0.1, -20, 0.1, -0.7), shapely.box(5, 1.0, 5.2, 20),
             shapely.box(5, -20, 5.2, -1.0)]  # fmt: skip
    passage = Passage(walls, shapely.box(-20, -20, 20, 20), (-10, 3), shapely.Point(10, -4).buffer(1.0))
    assert passage.is_open(0.64)
    assert not passage.is_open(0.66)
    gap = passage.narrowest(0.9)
    assert gap.width == pytest.approx(1.3, abs=0.01)
    assert gap.position == pytest.approx((0.0, -0.05), abs=0.15)
    assert gap.between == (0, 1)


def test_a_car_turns_around_in_a_street_by_reversing() -> None:
    walls = [shapely.box(-15, 4, 15, 4.2), shapely.box(-15, -4.2, 15, -4)]
    body = Body("car", -0.8, 3.4, 0.9, 1.6, 4.5)
    room = Room([Obstacle(0, Outline(w, 0.0, 0.0, 1.0)) for w in walls], (-15, -20, 15, 20), body, np.zeros((1, 2)))
    path = search_path(room, (10.0, 0.0, 0.0), shapely.Point(-13.5, 0.0).buffer(0.5))
    assert path.outcome == "found"
    assert path.path[-1, 0] < -12.9


# --- conditions ---------------------------------------------------------------------------------------------------

WALKER = """
    tracks: {main: {segments: [{line: 60}], width: 3}}
    start: {gate: {on_track: {track: main, s: 2}}, ahead: {on_track: {track: main, s: 30}}}
    actors:
      - {actor: pedestrian, name: walker, path: [[20, -4], [20, 4]], speed: 1, starts: {when: CONDITION}}
    scenario:
      walker: [{when: walker past main@20, stop: {}}]
"""
WAITS = """
    tests:
      - name: waits
        behaviour: blind
        others: {leader: {start: ahead, behaviour: blind}}
        expect: [never collision]
"""


@pytest.mark.parametrize("condition", ["ego within 8 m", "leader within 3 s", "walker past main@60", "speed > 0 m/s"])
def test_conditions_may_name_the_vehicles_of_the_tests_and_the_actors(condition: str) -> None:
    assert check(WALKER.replace("CONDITION", condition) + WAITS) == []


@pytest.mark.parametrize(
    ("condition", "message"),
    [
        ("walker within 8 m", "'walker' is always at its own place"),  # would fire at once
        ("ego past main@61", "s = 61 m; the track is 60 m long"),  # would never fire
        ("ego past mian@8", "unknown track 'mian'; did you mean 'main'?"),
        ("ego within 0 m", "0; it must be above 0"),
        ("gap < -1 m", "-1; it must be above 0"),
        ("gap > -1 m", "-1; it must be 0 or more"),
        # A parameter has no unit: whether it is a distance or a time is written behind it.
        ("ego within $time", "4.0 has no unit"),
    ],
)
def test_a_condition_that_holds_always_or_never_is_a_fault(condition: str, message: str) -> None:
    (fault,) = check(WALKER.replace("CONDITION", condition) + "\n    params: {time: 4 s}\n")
    assert fault.kind == "file"
    assert fault.text.startswith(f"w.yaml:5: actors.0.starts.when: {message}")


def test_an_actor_with_the_name_of_a_vehicle_of_a_test_is_a_fault() -> None:
    text = (WALKER.replace("CONDITION", "speed > 0 m/s") + WAITS).replace("walker", "leader")
    (fault,) = check(text)
    assert fault.kind == "test"
    assert fault.text.startswith("w.yaml:5: actors.0.name: 'leader' is the name of a vehicle of the test 'waits'")


def test_the_starts_of_other_vehicles_of_a_test_are_checked() -> None:
    world = WALKER.replace("CONDITION", "speed > 0 m/s") + WAITS
    (fault,) = check(world + "    props: [{box: [1, 3, 1], name: wall, at: [32, 0]}]\n")
    assert (fault.kind, fault.names) == ("start", ("wall",))
    (fault,) = check(world.replace("start: ahead", "start: gate"))
    assert (fault.kind, fault.text.split(": ")[1]) == ("test", "tests.0.others.leader.start")
    assert "'leader' starts at the place of 'ego'" in fault.text


def test_a_gate_behind_the_end_of_its_track_is_a_fault() -> None:
    (fault,) = check("tracks: {main: {segments: [{line: 60}]}}\ngoals: {end: {gate: {track: main, s: 61}}}\n")
    assert fault.text == "w.yaml:3: goals.end.gate.s: s = 61 m; the track is 60 m long"


def test_a_condition_on_a_vehicle_that_a_test_does_not_have_is_a_fault() -> None:
    (fault,) = check(WALKER.replace("CONDITION", "scout within 8 m") + WAITS)
    assert (fault.kind, fault.text.split(": ")[0]) == ("test", "w.yaml:5")
    assert "there is no vehicle or actor 'scout' in the test 'waits'" in fault.text
    assert all(name in fault.text for name in ("walker", "ego", "leader"))


def test_without_tests_a_condition_may_name_a_vehicle_of_a_diagram() -> None:
    text = WALKER.replace("CONDITION", "scout within 8 m")
    result = examine(write(text))
    assert result.faults == []
    (line,) = result.remarks
    assert line.startswith("w.yaml:5: ")
    assert "no actor is called 'scout'" in line
    assert examine(write(text.replace("scout", "ego"))).remarks == []


# --- drivers of tests ---------------------------------------------------------------------------------------------

DRIVER = """
open("executed", "w").close()
from pydrake.systems.framework import LeafSystem


class Careful(LeafSystem):
    def __init__(self, size: int = 181):
        super().__init__()
        self.DeclareVectorInputPort("ranges", size)
        self.DeclareVectorOutputPort("command", 3, lambda context, output: None)
"""


@pytest.mark.parametrize(
    ("behaviour", "message"),
    [
        ("'own_driver:Careful'", ""),
        ("'own_driver:Careless'", "'Careless' is not a Drake system in own_driver; did you mean 'Careful'?"),
        ("{kind: 'own_driver:Careful', sise: 3}", "own_driver:Careful has no parameter 'sise'; did you mean 'size'?"),
        ("{kind: 'own_driver:Careful', size: 90}", "'ego.ranges' has 181 elements, 'ego.driver_ranges' takes 90"),
    ],
)
def test_user_drivers_of_tests_are_checked_only_with_trust(behaviour: str, message: str) -> None:
    Path("own_driver.py").write_text(DRIVER, encoding="utf-8")
    test = WAITS.replace("behaviour: blind\n", f"behaviour: {behaviour}\n")
    text = WALKER.replace("CONDITION", "ego within 8 m") + test
    result = examine(write(text))
    assert (result.faults, Path("executed").exists()) == ([], False)
    (line,) = result.remarks
    assert line.startswith("not checked: w.yaml:11: tests.0.behaviour (own_driver:Care")
    faults = examine(write(text), trust=True).faults
    assert Path("executed").exists()
    assert len(faults) == (1 if message else 0), faults
    if message:
        assert message in faults[0].text
        assert faults[0].text.startswith("w.yaml:11: tests.0.behaviour: ")
