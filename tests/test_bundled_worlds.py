"""The bundled worlds: everything in its place for any seed, rules kept, starts and goals free, courses as published."""

from collections.abc import Iterable
from functools import cache

import numpy as np
import pytest
import shapely
from shapely.geometry.base import BaseGeometry

from mirdrake.controllers.behaviours.outline import outline_of
from mirdrake.core.errors import ConfigError
from mirdrake.core.paths import data_root
from mirdrake.core.yaml_io import load_yaml
from mirdrake.vehicles import load_vehicle
from mirdrake.world_checks import check_world
from mirdrake.worlds import PlacedProp, World, load_world, make_world
from mirdrake.worlds.spec import WorldSpec

GROUPS = sorted(path.stem for path in (data_root() / "worlds" / "groups").glob("*.yaml"))
COUNTS = {  # props of each kind that the name of a world promises
    "parking_lot": {"sedan|van": 12, "pedestrian": 1},
    "city_block_grid": {"building": 27, "thrift_store": 9, "jersey_barrier": 36, "cone|barrel": 12, "traffic_light": 2},
    "thrift_store": {"thrift_store": 1, "jersey_barrier": 12, "lamp_post": 10, "sedan|van": 16},
    "barrels": {"barrel": 46, "wall": 2},
    "neighbourhood": {"house": 15, "tree": 23, "sedan|van": 6, "stop_sign": 1, "pedestrian": 8, "speed_bump": 2},
    "town": {"traffic_light": 4, "tree": 13, "house": 8},
    "lane_change_1": {"cone": 54},
    "lane_change_2": {"cone": 30},
}
RANDOM = sorted(set(COUNTS) - {"lane_change_1", "lane_change_2"})
BOLT = (-0.8, 3.5, 0.9)  # [m] rear and front end about frame B, half width, with a little room


@cache
def seeded(name: str, seed: int) -> World:
    return load_world(name, overrides=[f"seed={seed}"])


def solid(props: Iterable[PlacedProp]) -> list[PlacedProp]:
    return [prop for prop in props if not prop.prop.driven_over]


def car_at(x: float, y: float, yaw: float) -> BaseGeometry:
    rear, front, half = BOLT
    corners = np.array([[rear, -half], [front, -half], [front, half], [rear, half]])
    c, s = np.cos(yaw), np.sin(yaw)
    return shapely.Polygon(corners @ np.array([[c, s], [-s, c]]) + [x, y])


def too_close(world: World) -> list[str]:
    """Return the pairs of props that overlap or whose gap is less than the rule `min_gap`."""
    assert world.rules is not None
    gap = world.rules.min_gap
    areas = [prop.footprint for prop in world.props]
    pairs = []
    for a, b in shapely.STRtree(areas).query(areas, predicate="dwithin", distance=max(gap - 1e-6, 0.0)).T.tolist():
        first, second = world.props[a], world.props[b]
        apart = first.bottom > second.top + gap or second.bottom > first.top + gap
        if a < b and not apart and not world.rules.may_overlap(first, second):
            pairs.append(f"{first.name}, {second.name}: {first.footprint.distance(second.footprint):.3f} m")
    return pairs


def test_all_worlds_with_props_are_tested_here() -> None:
    names = {path.stem for path in (data_root() / "worlds").glob("*.yaml")}
    assert {name for name in names if load_world(name).props} == set(COUNTS)


@pytest.mark.parametrize("name", COUNTS)
def test_a_world_has_the_props_of_its_name(name: str) -> None:
    kinds = [placed.prop.name for placed in load_world(name).props]
    for words, count in COUNTS[name].items():
        assert sum(kind in words.split("|") for kind in kinds) == count, words


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("name", COUNTS)
def test_everything_finds_a_place_and_keeps_the_rules(name: str, seed: int) -> None:
    world = seeded(name, seed)
    assert world.unplaced_props == ()
    assert world.rules is not None
    assert world.rules.broken(world.props) == []
    assert too_close(world) == []
    xmin, ymin, xmax, ymax = world.ground.extent
    assert all(shapely.box(xmin, ymin, xmax, ymax).covers(placed.footprint) for placed in world.props)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("name", COUNTS)
def test_starts_and_goals_are_free_and_connected(name: str, seed: int) -> None:
    world = seeded(name, seed)
    assert world.goals
    props = solid(world.props)
    for start in world.starts.values():
        car = car_at(start.x, start.y, start.yaw)
        assert not [placed.name for placed in props if placed.footprint.intersects(car)]
    for goal in world.goals.values():
        assert goal.area is not None
        assert not [placed.name for placed in props if placed.footprint.intersects(goal.area)]

    # A disc as wide as the car has a way: needed, though not enough, for a car.
    free = shapely.box(*world.ground.extent).difference(
        shapely.union_all([placed.footprint.buffer(BOLT[2]) for placed in props])
    )
    assert world.rules is not None
    assert world.rules.drivable
    for rule in world.rules.drivable:
        start, area = world.starts[rule.from_], world.goals[rule.to].area
        assert area is not None
        parts = [part for part in shapely.get_parts(free) if part.covers(shapely.Point(start.x, start.y))]
        assert len(parts) == 1
        assert parts[0].covers(area.centroid)


@pytest.mark.slow
@pytest.mark.parametrize("name", COUNTS)
def test_a_world_is_sound(name: str) -> None:
    assert [str(fault) for fault in check_world(name, time_limit=60.0)] == []


@pytest.mark.parametrize("name", RANDOM)
def test_chance_depends_on_the_seed_alone(name: str) -> None:
    def poses(world: World) -> dict[str, list[float]]:
        return {placed.name: placed.X_WP.GetAsMatrix34().ravel().tolist() for placed in world.props}

    assert poses(seeded(name, 0)) == poses(load_world(name, overrides=["seed=0"]))
    assert poses(seeded(name, 0)) != poses(seeded(name, 1))


# --- groups --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", GROUPS)
def test_a_group_file_holds_the_group_of_its_name(name: str) -> None:
    assert list(load_yaml(data_root() / "worlds" / "groups" / f"{name}.yaml", WorldSpec).groups) == [name]


@pytest.mark.parametrize(
    ("name", "given"),
    [(name, {}) for name in GROUPS]
    + [
        ("city_block", {"side": 55}),
        ("city_block", {"side": 70, "low": 5, "high": 6, "barrier": "barrel"}),
        ("cone_lane", {"length": 4, "width": 3, "spacing": 0.5}),
        ("parking_lot", {"columns": 15, "bay": 2.6, "aisle": 6}),
        ("parking_lot", {"columns": 1}),
        ("thrift_store_with_barriers", {"gate": 4, "depth": 15}),
    ],
)
def test_a_group_needs_no_parameters_and_takes_others(name: str, given: dict[str, float | str]) -> None:
    world = make_world({"mirdrake": "world/1", "props": [{"group": name, "at": [5, -3], "yaw": 0.5, "with": given}]})
    assert len(world.props) > 5
    assert world.unplaced_props == ()
    assert too_close(world) == []


# --- the courses of ISO 3888 -----------------------------------------------------------------------------------------


def lane(world: World, name: str) -> tuple[float, float, float, float]:
    """First and last x of the cones' middles, and the y of the right and left limit of the free lane [m]."""
    left = [placed for placed in world.props if placed.name.startswith(f"{name}.left")]
    right = [placed for placed in world.props if placed.name.startswith(f"{name}.right")]
    x = [placed.X_WP.translation()[0] for placed in (*left, *right)]
    limits = max(p.footprint.bounds[3] for p in right), min(p.footprint.bounds[1] for p in left)
    return min(x), max(x), *limits


def test_the_course_for_a_double_lane_change_is_that_of_iso_3888_1() -> None:
    world, b = load_world("lane_change_1"), 1.765
    wide = 1.1 * b + 0.25
    np.testing.assert_allclose(lane(world, "A"), (0, 15, -wide / 2, wide / 2), rtol=0, atol=1e-9)
    np.testing.assert_allclose(lane(world, "B"), (45, 70, 3.5, 3.5 + 1.2 * b + 0.25), rtol=0, atol=1e-9)
    np.testing.assert_allclose(lane(world, "C"), (95, 125, -wide / 2, -wide / 2 + 1.3 * b + 0.25), rtol=0, atol=1e-9)


def test_the_course_for_obstacle_avoidance_is_that_of_iso_3888_2() -> None:
    world, b = load_world("lane_change_2"), 1.765
    wide = 1.1 * b + 0.25
    np.testing.assert_allclose(lane(world, "A"), (0, 12, -wide / 2, wide / 2), rtol=0, atol=1e-9)
    np.testing.assert_allclose(lane(world, "B"), (25.5, 36.5, wide / 2 + 1, wide / 2 + 2 + b), rtol=0, atol=1e-9)
    np.testing.assert_allclose(lane(world, "C"), (49, 61, -wide / 2, 3 - wide / 2), rtol=0, atol=1e-9)


def test_the_lanes_are_for_the_bolt() -> None:
    width = 2.0 * outline_of(load_vehicle("bolt")).half_width
    for name in ("lane_change_1", "lane_change_2"):
        assert load_world(name).spec.params["b"] == pytest.approx(width, abs=0.01)


@pytest.mark.parametrize("number", [1, 2])
def test_a_bolt_on_the_path_keeps_off_the_cones(number: int) -> None:
    world = load_world(f"lane_change_{number}")
    track = world.tracks[f"iso{number}"]
    cars = [car_at(*track.pose_at(float(s))) for s in np.arange(0.0, track.length, 0.25)]
    cones = shapely.union_all([placed.footprint for placed in world.props])
    assert cones.distance(shapely.union_all(cars)) > 0.12
    assert track.min_radius > 15.0


def test_colours_have_names(tmp_path):
    path = tmp_path / "w.yaml"
    path.write_text("mirdrake: world/1\nprops:\n  - {prop: sedan, at: [0, 0], color: navy}\n", encoding="utf-8")
    (car,) = load_world(str(path)).props
    assert car.color == pytest.approx((0.0, 0.0, 128 / 255))
    path.write_text("mirdrake: world/1\nprops:\n  - {prop: sedan, at: [0, 0], color: navvy}\n", encoding="utf-8")
    with pytest.raises(ConfigError, match=r"w\.yaml:3: props\.0\.color: unknown colour 'navvy'; did you mean 'navy'"):
        load_world(str(path))
