import itertools
import math

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad, solve_ivp
from scipy.special import fresnel

from mirdrake.core.errors import WorldError
from mirdrake.worlds import Piece, Track, load_world
from mirdrake.worlds.pieces import advance
from tests.timing import reference_seconds


@pytest.fixture(scope="module")
def main_track() -> Track:
    return load_world("test_track").tracks["main"]


# --- closed forms -------------------------------------------------------------------------------------------------


def test_a_line_of_40_m_ends_40_m_ahead():
    assert advance((1.0, 2.0, math.pi / 2), Piece(40.0, 0.0, 0.0)) == pytest.approx((1.0, 42.0, math.pi / 2), abs=1e-13)


def test_a_left_quarter_circle_of_20_m_ends_20_m_ahead_and_20_m_left():
    quarter = Piece(20.0 * math.pi / 2, 1 / 20, 1 / 20)
    assert advance((0.0, 0.0, 0.0), quarter) == pytest.approx((20.0, 20.0, math.pi / 2), abs=1e-13)


def test_a_right_half_circle_of_5_m_ends_10_m_to_the_right():
    half = Piece(5.0 * math.pi, -1 / 5, -1 / 5)
    assert advance((0.0, 0.0, 0.0), half) == pytest.approx((0.0, -10.0, -math.pi), abs=1e-13)


def test_a_full_circle_of_9_125_m_is_57_33_m_long_and_closes():
    circle = Track([Piece(2 * math.pi * 9.125, 1 / 9.125, 1 / 9.125)], closed=True)
    assert circle.length == pytest.approx(57.33406592801372, abs=1e-12)  # 2 pi 9.125
    assert circle.gap == pytest.approx((0.0, 0.0), abs=1e-12)


def test_a_clothoid_from_straight_turns_its_length_over_twice_its_radius():
    assert Piece(25.0, 0.0, 1 / 50).turn == pytest.approx(0.25)


def test_a_clothoid_from_straight_ends_as_the_fresnel_integrals_give():
    length, radius = 30.0, 20.0
    scale = math.sqrt(math.pi * radius * length)  # x = scale C(length / scale), y = scale S(length / scale)
    sine, cosine = fresnel(length / scale)
    assert advance((0.0, 0.0, 0.0), Piece(length, 0.0, 1 / radius)) == pytest.approx(
        (scale * cosine, scale * sine, length / (2 * radius)), abs=1e-11
    )


@pytest.mark.parametrize("length", [0.05, 3.0, 40.0])
@pytest.mark.parametrize(("start", "end"), list(itertools.permutations([0.0, 1 / 7, -1 / 12, 1 / 300], 2)))
def test_the_end_of_a_clothoid_agrees_with_an_independent_quadrature(length: float, start: float, end: float):
    def yaw(u: float) -> float:
        return 0.3 + start * u + (end - start) / length * u * u / 2

    x = quad(lambda u: math.cos(yaw(u)), 0.0, length, epsabs=1e-12, limit=200)[0]
    y = quad(lambda u: math.sin(yaw(u)), 0.0, length, epsabs=1e-12, limit=200)[0]
    assert advance((5.0, -3.0, 0.3), Piece(length, start, end)) == pytest.approx((5 + x, y - 3, yaw(length)), abs=1e-10)


def test_the_whole_test_track_is_what_integrating_its_curvature_gives(main_track: Track):
    ends = main_track.knots
    state = np.array(main_track.pose_at(0.0))
    for begin, end in itertools.pairwise(ends):
        k0, k1 = main_track.curvature_at(begin + 1e-9), main_track.curvature_at(end - 1e-9)

        def slope(
            s: float, q: np.ndarray, a: float = begin, b: float = end, k0: float = k0, k1: float = k1
        ) -> list[float]:
            return [math.cos(q[2]), math.sin(q[2]), k0 + (k1 - k0) * (s - a) / (b - a)]

        state = solve_ivp(slope, (begin, end), state, rtol=1e-11, atol=1e-11).y[:, -1]
        assert np.array(main_track.pose_at(end - 1e-12)) == pytest.approx(state, abs=1e-6)


# --- the test track -----------------------------------------------------------------------------------------------


def test_the_test_track_is_965_m_long_and_closes(main_track: Track):
    assert main_track.length == pytest.approx(965.0, abs=1e-6)
    assert main_track.gap == pytest.approx((0.0, 0.0), abs=1e-9)


def test_the_test_track_fits_in_266_m_by_85_m(main_track: Track):
    xmin, ymin, xmax, ymax = main_track.bounds
    assert xmax - xmin == pytest.approx(266.0, abs=0.5)
    assert ymax - ymin == pytest.approx(85.0, abs=0.5)


def test_no_bend_of_the_test_track_is_tighter_than_7_m(main_track: Track):
    assert main_track.min_radius == pytest.approx(7.0, abs=1e-12)
    s = np.linspace(0.0, 965.0, 20001)
    assert np.abs(main_track.curvature(s)).max() <= 1 / 7.0 + 1e-12


def test_curvature_of_the_test_track_has_no_steps(main_track: Track):
    # The sharpest clothoid goes from 0 to 1/7 within 2 * 7 * 20 deg = 4.89 m: 0.0292 per metre; hairpin 1/8 in 6.98 m.
    s = np.arange(0.0, 965.0, 0.01)
    steps = np.abs(np.diff(main_track.curvature(np.append(s, 965.0))))
    assert steps.max() <= 0.01 * (1 / 7) / (2 * 7 * math.radians(20)) + 1e-9


def test_heading_of_the_test_track_is_the_integral_of_its_curvature(main_track: Track):
    s = np.linspace(0.0, 964.999, 96500)
    _, _, yaw = main_track.pose(s)
    middle = (s[1:] + s[:-1]) / 2
    assert np.abs(np.diff(yaw) - main_track.curvature(middle) * np.diff(s)).max() < 1e-5
    assert yaw[-1] == pytest.approx(2 * math.pi, abs=1e-9)


def test_the_test_track_has_a_hairpin_and_ten_right_angles(main_track: Track):
    bends = [math.degrees(piece.turn) for piece in main_track.pieces]
    arcs = [sum(group) for turning, group in itertools.groupby(bends, key=lambda turn: turn != 0.0) if turning]
    # Neighbouring bends without a straight between them come out as their sum; the right angles stand alone.
    assert sum(abs(abs(turn) - 90.0) < 1e-9 for turn in arcs) == 10
    assert sum(abs(turn + 178.0) < 1e-9 for turn in arcs) == 1


def test_the_start_line_lies_on_a_straight_of_more_than_100_m(main_track: Track):
    assert not main_track.curvature(np.linspace(-25.0, 150.0, 500)).any()


def test_there_are_at_least_3_m_of_grass_between_parts_of_the_test_track(main_track: Track):
    s = np.arange(0.0, 965.0, 0.5)
    points = np.column_stack(main_track.pose(s)[:2])
    gap = np.hypot(*(points[:, None] - points[None]).transpose(2, 0, 1))
    along = np.abs(s[:, None] - s)
    along = np.minimum(along, 965.0 - along)
    assert gap[along > 25.0].min() - 3.0 > 3.0


def test_the_test_track_does_not_cross_itself(main_track: Track):
    left, right = main_track.boundaries()
    assert shapely.LinearRing(left).is_simple
    assert shapely.LinearRing(right).is_simple
    road = main_track.area
    assert isinstance(road, shapely.Polygon)
    assert road.is_valid
    assert road.area == pytest.approx(965.0 * 3.0, rel=1e-4)  # length times width, whatever the bends
    assert len(road.interiors) == 1


# --- projection ---------------------------------------------------------------------------------------------------


def test_a_point_one_metre_left_of_a_straight_is_at_e_y_plus_one():
    line = Track([Piece(100.0, 0.0, 0.0)], start=(10.0, 5.0, 0.0))
    assert line.project(40.0, 6.0) == pytest.approx((30.0, 1.0), abs=1e-12)


def test_beyond_the_ends_of_an_open_track_s_stays_and_poses_go_on_straight():
    line = Track([Piece(100.0, 0.0, 0.0)])
    assert line.project(-5.0, 2.0) == pytest.approx((0.0, 2.0))
    assert line.project(150.0, -2.0, near=99.0) == pytest.approx((100.0, -2.0))
    assert [float(v) for v in line.pose(130.0)] == pytest.approx([130.0, 0.0, 0.0])
    assert line.pose_at(-7.0) == pytest.approx((-7.0, 0.0, 0.0))
    assert line.curvature_at(130.0) == 0.0


def test_beyond_the_ends_of_an_open_bend_poses_go_on_along_the_tangent():
    bend = Track([Piece(5.0 * math.pi, 1 / 10, 1 / 10)])  # a quarter circle to (10, 10), then up
    x, y, yaw = bend.pose([-3.0, 5.0 * math.pi + 4.0])
    assert np.array([x, y, yaw]) == pytest.approx(np.array([[-3.0, 10.0], [0.0, 14.0], [0.0, math.pi / 2]]), abs=1e-9)
    assert bend.curvature([-3.0, 1.0, 16.0]) == pytest.approx([0.0, 0.1, 0.0])


def test_projection_undoes_the_pose_along_the_test_track(main_track: Track):
    rng = np.random.default_rng(1)
    s, offset = rng.uniform(0.0, 965.0, 5000), rng.uniform(-1.5, 1.5, 5000)
    x, y = main_track.point(s, offset)
    for near in (None, s + rng.uniform(-0.5, 0.5, 5000)):
        arc_length, lateral = main_track.project(x, y, near=near)
        assert np.abs(arc_length - s).max() < 1e-6
        assert np.abs(lateral - offset).max() < 1e-6


def test_a_point_gives_the_result_of_arrays(main_track: Track):
    rng = np.random.default_rng(2)
    x, y = rng.uniform(-140.0, 140.0, 300), rng.uniform(-45.0, 45.0, 300)
    many = np.column_stack(main_track.project(x, y))
    pointwise = np.array([main_track.project(a, b) for a, b in zip(x.tolist(), y.tolist(), strict=True)])
    assert np.abs(many[:, 1] - pointwise[:, 1]).max() < 1e-6
    s = rng.uniform(-2000.0, 2000.0, 200)
    assert np.column_stack(main_track.pose(s)) == pytest.approx(np.array([main_track.pose_at(v) for v in s.tolist()]))
    assert main_track.curvature(s) == pytest.approx([main_track.curvature_at(v) for v in s.tolist()])


def test_the_lateral_error_is_the_distance_to_the_nearest_point(main_track: Track):
    rng = np.random.default_rng(3)
    x, y = rng.uniform(-140.0, 140.0, 200), rng.uniform(-45.0, 45.0, 200)
    line = shapely.LineString(np.column_stack(main_track.pose(np.linspace(0.0, 965.0, 200_000))[:2]))
    _, lateral = main_track.project(x, y)
    # The nearest of samples 0.5 m apart may belong to another stretch that is farther away by less than 1 cm.
    assert np.abs(np.abs(lateral) - shapely.distance(line, shapely.points(x, y))).max() < 0.01


def test_a_near_hint_stays_on_its_stretch_of_road(main_track: Track):
    x, y, _ = main_track.pose_at(340.0)  # before the hairpin
    s, lateral = main_track.project(x, y, near=339.0)
    assert (s, lateral) == pytest.approx((340.0, 0.0), abs=1e-9)
    circles = load_world("skidpad").tracks
    left_s, left_e = circles["left"].project(0.0, 0.2, near=57.0)
    assert left_e == pytest.approx(0.2)
    assert min(left_s, circles["left"].length - left_s) < 1e-6


def test_a_wrong_near_hint_is_repaired(main_track: Track):
    x, y, _ = main_track.pose_at(700.0)
    assert main_track.project(x, y, near=10.0) == pytest.approx((700.0, 0.0), abs=1e-6)
    s, lateral = main_track.project(np.array([x]), np.array([y]), near=np.array([10.0]))
    assert (s[0], lateral[0]) == pytest.approx((700.0, 0.0), abs=1e-6)


def test_poses_of_a_closed_track_are_periodic(main_track: Track):
    s = np.array([0.1, 100.0, 964.9])
    for lap in (-965.0, 965.0, 9650.0):
        assert np.column_stack(main_track.pose(s + lap)) == pytest.approx(np.column_stack(main_track.pose(s)), abs=1e-8)


def test_points_that_are_not_numbers_have_no_track_coordinates(main_track: Track):
    s, lateral = main_track.project(np.array([0.0, math.nan, math.inf]), np.array([0.0, 0.0, 0.0]))
    assert np.isfinite(s).tolist() == [True, False, False]
    assert np.isfinite(lateral).tolist() == [True, False, False]
    with pytest.raises(ValueError, match="cannot project the point"):
        main_track.project(math.nan, 0.0)


def test_a_point_is_on_the_road_when_it_is_less_than_half_a_width_from_the_centre_line(main_track: Track):
    s = np.linspace(0.0, 965.0, 2000)
    for offset, on_road in ((1.497, True), (-1.497, True), (1.503, False), (-1.503, False), (0.0, True)):
        assert (main_track.inside(*main_track.point(s, offset)) == on_road).all()


def test_projecting_near_the_last_place_is_quick(main_track: Track):
    s = np.linspace(0.0, 960.0, 500)
    points = list(zip(*(values.tolist() for values in (*main_track.point(s, 0.3), s + 0.2)), strict=True))

    def project() -> None:
        for x, y, near in points:
            main_track.project(x, y, near=near)

    assert reference_seconds(project) / len(points) < 50e-6  # about 10 us


# --- random tracks ------------------------------------------------------------------------------------------------

curvatures = st.sampled_from([0.0, 0.0, 1 / 6, -1 / 6, 1 / 15, -1 / 25, 1 / 80, -1 / 200])
pieces = st.lists(st.builds(Piece, st.floats(0.5, 40.0), curvatures, curvatures), min_size=1, max_size=8)


@settings(max_examples=60, deadline=None)
@given(pieces, st.floats(0.0, 1.0), st.floats(-1.5, 1.5), st.floats(-3.0, 3.0))
def test_projection_undoes_the_pose_on_any_track(parts: list[Piece], share: float, offset: float, yaw: float):
    track = Track(parts, start=(3.0, -4.0, yaw))
    s = share * track.length
    x, y = (float(value) for value in track.point(s, offset))
    assert track.project(x, y, near=s) == pytest.approx((s, offset), abs=1e-6)
    nearby, lateral = track.project(np.array([x]), np.array([y]), near=[min(s + 0.4, track.length)])
    assert (nearby[0], lateral[0]) == pytest.approx((s, offset), abs=1e-6)
    # Without a hint another stretch of a road that crosses itself may be found, but none that is farther away.
    assert abs(track.project(x, y)[1]) <= abs(offset) + 0.02


@settings(max_examples=40, deadline=None)
@given(pieces)
def test_neighbouring_points_of_any_track_are_as_far_apart_as_their_s(parts: list[Piece]):
    track = Track(parts)
    s = np.linspace(0.0, track.length, 4001)
    x, y, _ = track.pose(s)
    chords, arcs = np.hypot(np.diff(x), np.diff(y)), np.diff(s)
    assert (chords <= arcs + 1e-12).all()
    assert (chords >= arcs * (1 - (arcs / 6.0) ** 2 / 24) - 1e-12).all()  # a chord of a circle of 6 m, the sharpest


# --- varying width ------------------------------------------------------------------------------------------------


def wavy(length: float, *, closed: bool = False) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return edges from 1.5 to 3.5 m to the left and from 1 to 2 m to the right."""
    s = np.linspace(0.0, length, 121)
    left, right = 2.5 + np.sin(2 * np.pi * 3 * s / length), 1.5 + 0.5 * np.cos(2 * np.pi * 2 * s / length)
    if closed:
        left[-1], right[-1] = left[0], right[0]
    return s, left, right


def test_edges_of_steady_width_make_the_same_road_as_a_width(main_track: Track):
    pieces = main_track.pieces
    edges = ([0.0, 965.0], [1.5, 1.5], [1.5, 1.5])
    same = Track(pieces, start=main_track.pose_at(0.0), closed=True, edges=edges)
    assert same.width == 3.0
    assert shapely.area(shapely.symmetric_difference(same.area, main_track.area)) < 0.02  # both are true to 1 mm
    assert same.bounds == pytest.approx(main_track.bounds, abs=2e-3)


def test_a_straight_that_becomes_wider_is_a_trapezium():
    taper = Track([Piece(40.0, 0.0, 0.0)], edges=([0.0, 40.0], [1.0, 3.0], [2.0, 2.0]))
    assert taper.width == 5.0
    assert shapely.area(taper.area) == pytest.approx(40.0 * (3.0 + 5.0) / 2)
    assert taper.bounds == pytest.approx((0.0, -2.0, 40.0, 3.0))
    assert taper.inside([20.0, 20.0, 20.0], [1.99, 2.01, -1.99]).tolist() == [True, False, True]


def test_a_circle_with_its_centre_line_beside_the_middle_has_the_area_of_a_ring():
    circle = Track(
        [Piece(40.0 * math.pi, 1 / 20, 1 / 20)], closed=True, edges=([0.0, 40.0 * math.pi], [4.0] * 2, [1.0] * 2)
    )
    assert shapely.area(circle.area) == pytest.approx(math.pi * (21.0**2 - 16.0**2), rel=1e-4)


def test_widths_have_the_shape_of_s_and_are_periodic_on_a_closed_track():
    circle = Track([Piece(100.0, 2 * math.pi / 100, 2 * math.pi / 100)], closed=True, edges=wavy(100.0, closed=True))
    s = np.array([[0.0, 12.5], [99.0, -1.0]])
    assert circle.left_width(s).shape == circle.right_width(s).shape == (2, 2)
    assert circle.left_width(s + 300.0) == pytest.approx(circle.left_width(s))
    assert circle.right_width(-1.0) == pytest.approx(float(circle.right_width(99.0)))
    plain = Track([Piece(10.0, 0.0, 0.0)], width=3.0)
    assert plain.left_width([-5.0, 2.0, 50.0]).tolist() == plain.right_width([1.0] * 3).tolist() == [1.5] * 3
    taper = Track([Piece(40.0, 0.0, 0.0)], edges=([0.0, 40.0], [1.0, 3.0], [2.0, 2.0]))
    assert taper.left_width([-5.0, 10.0, 50.0]).tolist() == [1.0, 1.5, 3.0]


@pytest.mark.parametrize("closed", [True, False])
def test_the_sides_of_a_road_of_varying_width_are_true_to_a_millimetre(main_track: Track, closed: bool):
    track = Track(main_track.pieces, closed=closed, edges=wavy(965.0, closed=True))
    s = np.linspace(0.0, 964.99, 60_000)
    for side, line in zip((track.left_width(s), -track.right_width(s)), track.boundaries(), strict=True):
        off = shapely.distance(shapely.LineString(line), shapely.points(*track.point(s, side)))
        assert off.max() < 1.2e-3
    inner = np.linspace(1.0, 963.0, 3000)
    for offset, on_road in ((-2e-3, True), (2e-3, False)):
        assert (track.inside(*track.point(inner, track.left_width(inner) + offset)) == on_road).all()
        assert (track.inside(*track.point(inner, -track.right_width(inner) - offset)) == on_road).all()
    assert shapely.is_valid(track.area)
    assert len(track.stations()) < 8000


def test_bands_may_follow_the_edge():
    taper = Track([Piece(40.0, 0.0, 0.0)], edges=([0.0, 40.0], [1.0, 3.0], [2.0, 2.0]))
    paint = taper.band(lambda s: taper.left_width(s) - 0.15, lambda s: taper.left_width(s) - 0.05)
    assert shapely.area(paint) == pytest.approx(40.0 * 0.1)
    assert tuple(shapely.bounds(paint)) == pytest.approx((0.0, 0.85, 40.0, 2.95))
    assert shapely.area(taper.outline(sagitta=0.01)) == pytest.approx(160.0)


def test_an_inner_edge_folds_where_it_reaches_the_centre_of_the_bend():
    bend = [Piece(30.0, 0.0, 0.0), Piece(20.0, 1 / 5, 1 / 5), Piece(30.0, 0.0, 0.0)]
    s = [0.0, 40.0, 80.0]
    assert Track(bend, width=9.99).folds() is None
    assert Track(bend, width=10.0).folds() is not None
    assert Track(bend, edges=(s, [1.0, 5.5, 1.0], [9.0] * 3)).folds() == pytest.approx(40.0)
    assert Track(bend, edges=(s, [4.9] * 3, [9.0] * 3)).folds() is None  # the outer edge may be as far as it likes
    mirrored = [Piece(piece.length, -piece.start_curvature, -piece.end_curvature) for piece in bend]
    assert Track(mirrored, edges=(s, [9.0] * 3, [1.0, 5.5, 1.0])).folds() == pytest.approx(40.0)


def test_a_fold_between_two_stations_is_found():
    # k d = 0.2 u (1 + 9 (1 - u)), largest at u = 10/18, where it is 1/2 and twice that with twice the curvature
    track = Track([Piece(36.0, 0.0, 0.36)], edges=([0.0, 36.0], [10.0, 1.0], [1.0, 1.0]))
    assert track.folds() == pytest.approx(36.0 * 10 / 18)
    assert Track([Piece(36.0, 0.0, 0.359)], edges=([0.0, 36.0], [10.0, 1.0], [1.0, 1.0])).folds() is None


widths = st.lists(st.floats(0.2, 8.0), min_size=2, max_size=6)


@settings(max_examples=60, deadline=None)
@given(pieces, widths, widths)
def test_a_road_folds_where_samples_of_its_edges_fold(parts: list[Piece], left: list[float], right: list[float]):
    n = min(len(left), len(right))
    length = math.fsum(part.length for part in parts)
    track = Track(parts, edges=(np.linspace(0.0, length, n), left[:n], right[:n]))
    s = np.concatenate([np.linspace(a + 1e-9, b - 1e-9, 400) for a, b in itertools.pairwise(track.knots)])
    k = track.curvature(s)
    inner = np.maximum(k * track.left_width(s), -k * track.right_width(s))
    location = track.folds()
    if location is None:
        assert inner.max() < 1.0 + 1e-6
    else:
        assert inner.max() > 0.99
        near = np.abs(s - location) < 0.2
        assert inner[near].max() == pytest.approx(inner.max(), abs=0.02 * max(1.0, inner.max()))


@pytest.mark.parametrize(
    ("edges", "expected"),
    [
        (([0.0, 5.0, 10.0], [1.0, 1.0], [1.0, 1.0]), "shapes (3,), (2,), (2,); give s, left and right with one value"),
        (([0.0], [1.0], [1.0]), "two or more"),
        (([0.0, math.nan, 10.0], [1.0] * 3, [1.0] * 3), "some values are not finite; give numbers in m"),
        (([0.0, 9.0], [1.0] * 2, [1.0] * 2), "s goes from 0 to 9 m; make it go from 0 to 10.000000 m"),
        (
            ([0.0, 5.0, 5.0, 10.0], [1.0] * 4, [1.0] * 4),
            "s does not increase from 5 to 5 m; sort the stations, each once",
        ),
        (([0.0, 4.0, 10.0], [1.0, 0.0, 1.0], [1.0] * 3), "left is 0 m at s = 4 m; make it more than 0"),
        (([0.0, 4.0, 10.0], [1.0] * 3, [1.0, -2.0, 1.0]), "right is -2 m at s = 4 m; make it more than 0"),
        (([0.0, 10.0], [1.0, 2.0], [1.0] * 2), "left is 1 m at the start and 2 m at the end of a closed track"),
    ],
)
def test_edges_that_do_not_fit_are_rejected_in_one_line(edges: tuple[list[float], ...], expected: str):
    with pytest.raises(WorldError) as caught:
        Track([Piece(10.0, 0.0, 0.0)], closed=True, edges=edges, name="loop")  # type: ignore[arg-type]
    message = str(caught.value)
    assert message.startswith("track 'loop': edges")
    assert expected in message
    assert "\n" not in message


@pytest.mark.parametrize("gap", [7e-4, -7e-4])
def test_points_at_the_seam_of_a_track_that_closes_within_a_millimetre_are_projected(gap: float) -> None:
    half = Piece(5.0 * math.pi, 0.2, 0.2)
    track = Track([Piece(10.0, 0.0, 0.0), half, Piece(10.0 + gap, 0.0, 0.0), half], closed=True)
    x = np.linspace(-2e-3, 2e-3, 81)
    for offset in (-1.0, 0.0, 0.5):
        s, lateral = track.project(x, np.full_like(x, offset))
        assert np.minimum(s, track.length - s).max() < 5e-3
        assert np.abs(lateral - offset).max() < 1e-6
        for x_seam in x.tolist():
            for near in (None, 1.0, track.length - 1.0):
                s_one, lateral_one = track.project(x_seam, offset, near=near)
                assert min(s_one, track.length - s_one) < 5e-3
                assert abs(lateral_one - offset) < 1e-6
