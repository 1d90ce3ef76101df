"""Range scan: closed forms of a wall, a polygon and a turned box; heights, movable props, contact."""

import math
from typing import Any

import numpy as np
import pytest
import shapely
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform, RollPitchYaw
from shapely import affinity

from mirdrake.controllers.behaviours.fan import REACH, beam_angles
from mirdrake.controllers.behaviours.outline import Outline, outline_of
from mirdrake.core.errors import ConfigError
from mirdrake.core.signals import signals_of
from mirdrake.sensors.range_scan import PropPoses, RangeScan, cut_beams
from mirdrake.vehicles import load_vehicle
from tests.stand_ins import CarStandIn, PropStandIn, WorldStandIn

EXACT = 1e-9


def put(shape, x, y, yaw=0.0, *, name="prop", static=True, **heights):
    footprint = affinity.translate(affinity.rotate(shape, yaw, origin=(0, 0), use_radians=True), x, y)
    return PropStandIn(
        name, footprint, static=static, X_WP=RigidTransform(RollPitchYaw(0, 0, yaw), [x, y, 0]), **heights
    )


def make_scan(*props, **options):
    world: Any = WorldStandIn(list(props))
    return RangeScan(world, CarStandIn(), **options)


def edges_of(shape):
    points = shapely.get_coordinates(shape)
    return np.hstack((points[:-1], points[1:]))


def cut_all(shapes, x, y, angles):
    """Return the ranges by brute force, every beam with every edge."""
    edges = np.vstack([edges_of(shape) for shape in shapes]) - (x, y, x, y)
    cos, sin = np.cos(angles)[:, None], np.sin(angles)[:, None]
    px, py = edges[:, 0], edges[:, 1]
    dx, dy = edges[:, 2] - px, edges[:, 3] - py
    with np.errstate(divide="ignore", invalid="ignore"):
        across = cos * dy - sin * dx
        reach, part = (px * dy - py * dx) / across, (px * sin - py * cos) / across
    return np.where((part > -1e-12) & (part < 1 + 1e-12) & (reach >= 0), reach, math.inf).min(axis=1)


def scan(segments, x, y, yaw, angles, reach=REACH):
    """Return the distances along beams in any order to segments x0, y0, x1, y1 in the world."""
    beams = np.asarray(angles, dtype=float)
    wrapped = np.remainder(beams + math.pi, 2.0 * math.pi) - math.pi
    order = np.argsort(wrapped, kind="stable")
    corners = np.asarray(segments, dtype=float).reshape(-1, 2) - (x, y)
    cos, sin = math.cos(yaw), math.sin(yaw)
    px, py = cos * corners[:, 0] + sin * corners[:, 1], cos * corners[:, 1] - sin * corners[:, 0]
    # Corners come in pairs, so that only every second gap between two corners is a segment.
    edge = np.arange(len(corners)) % 2 == 0
    result = np.full(beams.size, math.inf)
    result[order] = cut_beams(px, py, edge[:-1], wrapped[order], reach)
    return result


# --- the plain function --------------------------------------------------------------------------------------------


def test_a_wall_is_seen_at_its_distance_over_the_cosine():
    angles = beam_angles()
    ranges = scan([[8.0, -1000.0, 8.0, 1000.0]], 1.0, 5.0, 0.0, angles, reach=50.0)
    exact = np.divide(7.0, np.cos(angles), out=np.full(181, math.inf), where=np.cos(angles) > 0.14)
    near = exact <= 50.0
    assert near.sum() == 163
    np.testing.assert_allclose(ranges[near], exact[near], atol=EXACT, rtol=0)
    assert np.isinf(ranges[~near]).all()


def test_a_wall_is_seen_from_any_direction_also_across_the_backward_one():
    for yaw in np.linspace(-7.0, 7.0, 29):
        angles = np.linspace(-math.pi, math.pi, 721)
        ranges = scan([[-3.0, -5.0, -3.0, 4.0]], 0.0, 0.0, yaw, angles)
        bearing = angles + yaw
        distance = -3.0 * np.tan(bearing)
        hit = (np.cos(bearing) < 0.0) & (distance > -5.0 + EXACT) & (distance < 4.0 - EXACT)
        np.testing.assert_allclose(ranges[hit], (-3.0 / np.cos(bearing))[hit], atol=EXACT, rtol=0)
        assert np.isinf(ranges[(np.cos(bearing) > 0.0) | (distance < -5.0 - EXACT) | (distance > 4.0 + EXACT)]).all()


def test_beams_may_come_in_any_order_and_beyond_a_turn():
    angles = np.array([2.0 * math.pi, 0.1, -0.1, -2.0 * math.pi])
    ranges = scan([[5.0, -9.0, 5.0, 9.0]], 0.0, 0.0, 0.0, angles)
    np.testing.assert_allclose(ranges, 5.0 / np.cos(angles), atol=EXACT)


def test_distances_to_a_regular_polygon_follow_from_its_edges():
    """Edges of a regular polygon about C lie at the apothem a: r = (a - n.(o - C)) / (n.b), the largest facing one."""
    count, radius, centre = 48, 0.8, np.array([6.0, 1.0])
    corner = 2.0 * math.pi * np.arange(count + 1) / count
    points = centre + radius * np.column_stack((np.cos(corner), np.sin(corner)))
    angles = np.linspace(-0.1, 0.4, 251)
    ranges = scan(np.hstack((points[:-1], points[1:])), 0.0, 0.0, 0.0, angles)
    middle = corner[:-1] + math.pi / count
    n, b = np.column_stack((np.cos(middle), np.sin(middle))), np.column_stack((np.cos(angles), np.sin(angles)))
    lead, room = b @ n.T, radius * math.cos(math.pi / count) + n @ centre
    enter = np.where(lead < 0.0, room / lead, -math.inf).max(axis=1)
    leave = np.where(lead > 0.0, room / lead, math.inf).min(axis=1)
    exact = np.where(enter <= leave, enter, math.inf)
    clear = np.abs(enter - leave) > 1e-6  # a beam through a corner by rounding only may be either
    np.testing.assert_allclose(ranges[clear], exact[clear], atol=EXACT, rtol=0)
    assert np.isfinite(exact).sum() > 100
    circle = 6.0 * np.cos(angles) + np.sin(angles)
    circle = circle - np.sqrt(np.maximum(circle**2 - 37.0 + 0.64, 0.0))
    assert (ranges >= circle - EXACT)[np.isfinite(ranges)].all()  # the circle around it is nearer


def test_a_turned_box_is_seen_by_its_slabs():
    yaw, centre, half = 0.7, np.array([5.0, -2.0]), np.array([1.0, 0.4])
    box = affinity.translate(affinity.rotate(shapely.box(-1.0, -0.4, 1.0, 0.4), yaw, use_radians=True), *centre)
    angles = np.linspace(-0.9, 0.3, 300)
    ranges = scan(edges_of(box), 0.0, 0.0, 0.0, angles)
    R = np.array([[math.cos(yaw), math.sin(yaw)], [-math.sin(yaw), math.cos(yaw)]])
    o, b = R @ -centre, np.column_stack((np.cos(angles), np.sin(angles))) @ R.T
    first, second = (-half - o) / b, (half - o) / b
    enter, leave = np.minimum(first, second).max(axis=1), np.maximum(first, second).min(axis=1)
    assert (enter < leave).sum() > 80
    np.testing.assert_allclose(ranges, np.where(enter <= leave, enter, math.inf), atol=EXACT, rtol=0)


def test_a_segment_seen_end_on_is_hit_at_its_nearer_end():
    assert scan([[7.0, 0.0, 3.0, 0.0]], 0.0, 0.0, 0.0, [0.0]) == pytest.approx(3.0)


def test_nothing_is_seen_without_segments_and_beyond_the_reach():
    assert np.isinf(scan(np.empty((0, 4)), 0.0, 0.0, 0.0, [0.0, 1.0])).all()
    wall = [[8.0, -1.0, 8.0, 1.0]]
    assert scan(wall, 0.0, 0.0, 0.0, [0.0], reach=8.0)[0] == 8.0
    assert np.isinf(scan(wall, 0.0, 0.0, 0.0, [0.0], reach=7.999)[0])


# --- the system ----------------------------------------------------------------------------------------------------


def scan_at(system, x, y, yaw, poses=None):
    context = system.CreateDefaultContext()
    system.state.FixValue(context, [x, y, 0.0, 0.0, 0.0, yaw, *[0.0] * 6])
    if poses is not None:
        system.prop_poses.FixValue(context, np.ravel(poses))
    return system.ranges.Eval(context)


@pytest.mark.parametrize("static", [True, False])
@pytest.mark.parametrize("fan", [(-0.5 * math.pi, 0.5 * math.pi, 181), (-math.pi, math.pi, 361), (0.0, 0.3, 2)])
def test_a_crowd_is_seen_as_without_shortcuts(static, fan):
    start, end, beams = fan
    generator = np.random.default_rng(3)
    shapes = [shapely.box(-0.2, -0.2, 0.2, 0.2), shapely.Point(0, 0).buffer(0.4), shapely.box(-2.2, -0.9, 2.2, 0.9)]
    places = [
        (*generator.uniform(4.0, 40.0, 2) * generator.choice([-1, 1], 2), *generator.uniform(-4, 4, 1))
        for _ in range(60)
    ]
    props = [put(shapes[i % 3], *position, name=f"p[{i}]", static=static) for i, position in enumerate(places)]
    system = make_scan(*props, beams=beams, start_angle=start, end_angle=end)
    for yaw in (0.0, 0.9, -2.5):
        x, y = 3.64 * math.cos(yaw), 3.64 * math.sin(yaw)
        exact = cut_all([prop.footprint for prop in props], x, y, system.angles + yaw)
        exact[exact > 50.0] = math.inf
        np.testing.assert_allclose(scan_at(system, 0.0, 0.0, yaw), exact, atol=EXACT, rtol=0)


def test_a_scan_hits_only_objects_between_its_height_and_the_roof():
    wall = shapely.box(-0.1, -2.0, 0.1, 2.0)
    low, far = put(wall, 10.0, 0.0, top=0.15), put(wall, 20.0, 0.0, top=0.16)
    sign = put(wall, 15.0, 0.0, bottom=4.0, top=5.0)
    middle = scan_at(make_scan(low, sign, far, front=0.0), 0.0, 0.0, 0.0)[90]
    assert middle == pytest.approx(19.9)
    assert scan_at(make_scan(low, sign, far, front=0.0, height=0.1), 0.0, 0.0, 0.0)[90] == pytest.approx(9.9)


@pytest.mark.parametrize("static", [True, False])
def test_all_is_zero_inside_a_footprint_also_where_footprints_overlap(static):
    """The car's nose may stick in what it has hit: it must not see the far side as free."""
    hall = put(shapely.box(-10, -10, 10, 10), 15.0, 0.0, name="hall", static=static)
    post = put(shapely.box(-1, -1, 1, 1), 6.0, 0.0, name="post", static=static)
    system = make_scan(hall, post, front=0.0)
    assert (scan_at(system, 5.5, 0.0, 0.0) == 0.0).all()
    assert (scan_at(system, 8.0, 0.3, 1.0) == 0.0).all()
    assert scan_at(system, 2.0, 0.0, 0.0)[90] == pytest.approx(3.0)


def test_a_yard_is_seen_from_within():
    yard = shapely.Polygon(shapely.box(-9, -9, 9, 9).exterior, [shapely.box(-8, -8, 8, 8).exterior])
    assert scan_at(make_scan(put(yard, 0.0, 0.0), front=0.0), 1.0, 0.0, 0.0)[[0, 90, 180]] == pytest.approx([8, 7, 8])


def test_movable_props_are_seen_where_they_are():
    box = shapely.box(-0.5, -1.0, 0.5, 1.0)
    system = make_scan(
        put(box, 9.0, 0.0, name="a", static=False),
        put(box, 30.0, 0.0, name="wall"),
        put(box, 20.0, 5.0, math.pi / 2, name="b", static=False),
        put(box, 5.0, 0.0, name="flat", static=False, top=0.1),
        front=0.0,
    )
    assert system.movable == ("a", "b")
    assert [signal.name for signal in signals_of(system.prop_poses) or ()] == [
        "a.x",
        "a.y",
        "a.yaw",
        "b.x",
        "b.y",
        "b.yaw",
    ]
    assert scan_at(system, 0.0, 0.0, 0.0)[90] == pytest.approx(8.5)
    moved = [[9.0, 7.0, 0.0], [20.0, 0.0, math.pi / 2]]
    assert scan_at(system, 0.0, 0.0, 0.0, moved)[90] == pytest.approx(19.0)
    moved[1][2] = math.pi / 4  # its corners point along x and y; the beam meets the edge beside the corner
    assert scan_at(system, 0.0, 0.0, 0.0, moved)[90] == pytest.approx(20.0 - 0.5 * math.sqrt(2.0))


def test_the_scan_turns_with_the_car_and_starts_at_its_bumper():
    wall = put(shapely.box(-5.0, -0.1, 5.0, 0.1), 0.0, 10.0)
    assert scan_at(make_scan(wall, front=3.0), 0.0, 0.0, math.pi / 2)[90] == pytest.approx(6.9)
    system = make_scan(wall)
    assert system.front == pytest.approx(1.4 * 2.6)
    contents = signals_of(system.ranges) or ()
    assert contents[0].name == "beam[0]"
    assert {signal.unit for signal in contents} == {"m"}


def test_a_world_without_props_is_free():
    assert np.isinf(scan_at(make_scan(), 0.0, 0.0, 0.0)).all()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"beams": 0}, "RangeScan: beams must be >= 1"),
        ({"reach": 0.0}, "RangeScan: reach must be > 0"),
        ({"start_angle": 1.0, "end_angle": 0.5}, "RangeScan: end_angle must be >= 1"),
        ({"start_angle": 0.5, "end_angle": 0.5}, "beams need an end_angle above"),
    ],
)
def test_impossible_scans_are_rejected(options, message):
    with pytest.raises(ConfigError, match=message):
        make_scan(**options)


def test_poses_of_props_come_from_the_plant():
    system = PropPoses([2, 1], ["b", "a"])
    context = system.CreateDefaultContext()
    poses = [RigidTransform(), RigidTransform(RollPitchYaw(0, 0, 0.3), [1, 2, 3]), RigidTransform([4, 5, 6])]
    system.body_poses.FixValue(context, AbstractValue.Make(poses))
    np.testing.assert_allclose(system.prop_poses.Eval(context), [4, 5, 0, 1, 2, 0.3], atol=1e-12)


# --- the box around a vehicle --------------------------------------------------------------------------------------


def test_the_front_is_that_of_the_collision_shapes():
    bolt = load_vehicle("bolt")
    outline = outline_of(bolt)
    assert outline.front == pytest.approx(2.601 / 2 + 2.085)  # as in its properties
    assert outline.front - outline.rear == pytest.approx(4.166)
    assert outline.half_width == pytest.approx(1.765 / 2)
    assert 1.4 < outline.height < 2.0


def test_a_vehicle_without_a_model_is_taken_for_an_ordinary_car():
    assert outline_of(CarStandIn()) == pytest.approx(Outline(-0.78, 3.64, 0.91, 1.56))
