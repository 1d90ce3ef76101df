import itertools
import math
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import fresnel

from mirdrake.core.errors import ConfigError, WorldError
from mirdrake.worlds.centre_lines import edges_from_widths, pieces_through
from mirdrake.worlds.csv_tracks import read_csv_track
from mirdrake.worlds.pieces import Piece
from mirdrake.worlds.tracks import Track
from tests.timing import reference_seconds


def make(points: np.ndarray, *, closed: bool, smooth: float = 0.0, tolerance: float = 1e-3) -> Track:
    """Return a track through points, after checks that every track must pass."""
    pieces, start = pieces_through(points, closed=closed, smooth=smooth, tolerance=tolerance)
    pairs = list(itertools.pairwise(pieces)) + ([(pieces[-1], pieces[0])] if closed else [])
    assert all(a.end_curvature == b.start_curvature for a, b in pairs)
    track = Track(pieces, start=start, closed=closed)
    if closed:
        assert track.gap[0] < 1e-6
        assert abs(track.gap[1]) < 1e-8
    if not smooth:
        s, offset = track.project(points[:, 0], points[:, 1])
        x, y, _ = track.pose(s)
        assert np.hypot(x - points[:, 0], y - points[:, 1]).max() <= tolerance * (1 + 1e-6) + 1e-9
        assert np.abs(offset).max() <= tolerance * (1 + 1e-6) + 1e-9
    return track


def circuit(length: float, spacing: float) -> np.ndarray:
    """Return points of a closed circuit with bends both ways, at equal distances [m]."""
    angle = np.linspace(0.0, 2 * np.pi, 200_001)
    radius = 1.0 + 0.25 * np.sin(3 * angle) + 0.1 * np.cos(7 * angle + 1.0)
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    s = np.append(0.0, np.cumsum(np.hypot(np.diff(x), np.diff(y))))
    arc_length = np.linspace(0.0, s[-1], round(length / spacing) + 1)[:-1]
    return np.array([np.interp(arc_length, s, x), np.interp(arc_length, s, y)]).T * (length / float(s[-1]))


# --- closed forms -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("count", [4, 7, 100, 1000])
@pytest.mark.parametrize("sign", [1, -1])
def test_points_of_a_circle_give_the_circle(count: int, sign: int):
    angle = sign * 2 * np.pi * np.arange(count) / count
    points = np.column_stack((5.0 + 30.0 * np.cos(angle), -2.0 + 30.0 * np.sin(angle)))
    track = make(points, closed=True)
    assert track.length == pytest.approx(60.0 * math.pi, rel=1e-9)
    assert track.curvature(np.linspace(0, 180, 50)) == pytest.approx(np.full(50, sign / 30.0), rel=1e-6)
    assert track.pose_at(0.0)[:2] == pytest.approx((35.0, -2.0))
    assert track.pose_at(0.0)[2] == pytest.approx(sign * math.pi / 2)


def test_points_of_a_line_give_the_line():
    points = np.column_stack((np.linspace(0.0, 100.0, 30), np.linspace(0.0, 50.0, 30)))
    track = make(points, closed=False)
    assert track.length == pytest.approx(math.hypot(100, 50), rel=1e-12)
    assert track.min_radius > 1e6


def test_a_repeated_last_point_of_a_closed_curve_counts_once():
    angle = 2 * np.pi * np.arange(41) / 40
    points = 10.0 * np.column_stack((np.cos(angle), np.sin(angle)))
    assert make(points, closed=True).length == pytest.approx(20.0 * math.pi, rel=1e-9)


def test_a_line_an_arc_and_a_line_come_back_with_their_length():
    road = Track([Piece(60.0, 0.0, 0.0), Piece(20.0 * math.pi, 1 / 40, 1 / 40), Piece(60.0, 0.0, 0.0)])
    points = np.column_stack(road.pose(np.linspace(0.0, road.length, 366))[:2])
    track = make(points, closed=False, tolerance=1e-4)
    assert track.length == pytest.approx(120.0 + 20.0 * math.pi, rel=1e-6)
    assert track.curvature([30.0, 90.0, 150.0]) == pytest.approx([0.0, 1 / 40, 0.0], abs=2e-4)
    assert track.min_radius > 35.0  # the step in curvature makes it swing, but not much


def test_points_of_a_clothoid_by_fresnel_integrals_give_the_clothoid():
    length, radius = 80.0, 25.0
    scale = math.sqrt(math.pi * radius * length)
    s = np.linspace(0.0, length, 161)
    sine, cosine = fresnel(s / scale)
    track = make(scale * np.column_stack((cosine, sine)), closed=False)
    assert track.length == pytest.approx(length, rel=1e-6)
    assert track.curvature(s[:-1]) == pytest.approx(s[:-1] / (radius * length), abs=1e-6)
    assert track.pose_at(length)[2] == pytest.approx(length / (2 * radius), abs=1e-6)


def test_the_test_track_comes_back_from_its_points(worlds_track: Track):
    s = np.arange(965) * 1.0
    points = np.column_stack(worlds_track.pose(s)[:2])
    track = make(points, closed=True)
    assert track.length == pytest.approx(965.0, abs=2e-3)
    assert track.min_radius == pytest.approx(7.0, abs=0.25)


@pytest.fixture(scope="module")
def worlds_track() -> Track:
    from mirdrake.worlds import load_world

    return load_world("test_track").tracks["main"]


@pytest.mark.parametrize(
    "points",
    [
        [(0, 0), (100, 0), (100, 50), (0, 50)],  # a rectangle: bends of a quarter turn between points
        [(0, 0), (100, 0), (100, 1), (0, 1)],
        [(0, 0), (10, 5), (20, -5), (30, 5), (40, -5), (20, -20)],
        [(0, 0), (1, 0), (100, 0), (50, 80)],  # very unequal distances
        [(50 * math.sin(t), 25 * math.sin(2 * t)) for t in np.linspace(0, 2 * math.pi, 31)[:-1]],  # it crosses itself
    ],
)
def test_few_points_far_apart_are_joined_smoothly(points: list[tuple[float, float]]):
    make(np.array(points, dtype=float), closed=True)
    make(np.array(points, dtype=float), closed=False)


# --- random curves ------------------------------------------------------------------------------------------------

waves = st.lists(st.tuples(st.integers(2, 6), st.floats(0.0, 0.06), st.floats(0.0, 6.3)), min_size=0, max_size=3)


@settings(max_examples=60, deadline=None)
@given(waves, st.floats(10.0, 800.0), st.integers(30, 400), st.tuples(st.floats(-1e6, 1e6), st.floats(-1e6, 1e6)))
def test_any_smooth_closed_curve_is_followed(
    bends: list[tuple[int, float, float]], size: float, count: int, position: tuple[float, float]
):
    angle = 2 * np.pi * np.arange(count) / count
    radius = 1.0 + sum(a * np.cos(n * angle + phase) for n, a, phase in bends)
    points = size * np.column_stack((radius * np.cos(angle), radius * np.sin(angle))) + position
    track = make(points, closed=True)
    assert math.fsum(piece.turn for piece in track.pieces) == pytest.approx(2 * math.pi, abs=1e-8)
    fine = 2 * np.pi * np.arange(20_000) / 20_000
    radius = 1.0 + sum(a * np.cos(n * fine + phase) for n, a, phase in bends)
    ring = size * np.column_stack((radius * np.cos(fine), radius * np.sin(fine)))
    length = np.hypot(*(np.roll(ring, -1, axis=0) - ring).T).sum()
    assert track.length == pytest.approx(length, rel=2e-3)


@settings(max_examples=40, deadline=None)
@given(st.lists(st.tuples(st.floats(0.5, 40.0), st.floats(-0.6, 0.6)), min_size=4, max_size=40))
def test_any_open_row_of_points_is_followed(steps: list[tuple[float, float]]):
    heading = np.cumsum([turn for _, turn in steps])
    length = np.array([size for size, _ in steps])
    points = np.cumsum(np.column_stack((length * np.cos(heading), length * np.sin(heading))), axis=0)
    pieces, start = pieces_through(points, closed=False)
    track = Track(pieces, start=start)
    near = np.append(0.0, np.cumsum(length[1:])) * track.length / length[1:].sum()
    _, offset = track.project(points[:, 0], points[:, 1], near=near)
    assert start[:2] == pytest.approx(tuple(points[0]), abs=1e-9)
    assert np.abs(offset).max() < 1e-3 + 1e-6


# --- noise --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("closed", [True, False])
def test_smoothing_moves_points_by_the_rms_that_is_allowed_and_no_more(closed: bool):
    points = circuit(1000.0, 1.0)[: 1000 if closed else 700]
    noisy = points + np.random.default_rng(4).normal(0.0, 0.05, points.shape)
    rough, fine = make(noisy, closed=closed), make(noisy, closed=closed, smooth=0.07)
    near = np.arange(len(points)) * fine.length / (len(points) if closed else len(points) - 1)
    _, offset = fine.project(noisy[:, 0], noisy[:, 1], near=near)
    assert 0.04 < math.sqrt((offset**2).mean()) < 0.072
    _, error = fine.project(points[:, 0], points[:, 1], near=near)
    assert math.sqrt((error**2).mean()) < 0.05  # nearer to the true curve than the points are
    assert rough.min_radius < 2.0
    assert fine.min_radius > 5.0
    assert fine.length < rough.length
    assert len(fine.pieces) < 0.3 * len(points)


def test_smoothing_a_noisy_line_leaves_a_line():
    rng = np.random.default_rng(5)
    points = np.column_stack((np.arange(200.0), rng.normal(0.0, 0.02, 200)))
    track = make(points, closed=False, smooth=0.05)
    assert track.min_radius > 1e3


# --- speed --------------------------------------------------------------------------------------------------------


def test_a_circuit_of_4_km_is_fitted_within_a_second():
    points = circuit(4000.0, 1.0)
    noisy = points + np.random.default_rng(6).normal(0.0, 0.05, points.shape)
    for given_points, smooth in ((points, 0.0), (noisy, 0.0), (noisy, 0.07)):
        assert reference_seconds(partial(pieces_through, given_points, closed=True, smooth=smooth)) < 1.0


def test_a_circuit_of_4_km_with_widths_is_built_from_its_file_within_two_seconds(tmp_path: Path):
    points = circuit(4000.0, 1.0)
    angles = 2 * np.pi * np.arange(4000) / 4000
    rows = np.column_stack((points, 4.0 + np.sin(angles), 5.0 + np.cos(3 * angles)))
    file = tmp_path / "circuit.csv"
    np.savetxt(file, rows, fmt="%.6f", delimiter=",", header="x_m,y_m,w_tr_right_m,w_tr_left_m")
    created: list[Track] = []

    def make() -> None:
        table = read_csv_track(file)
        pieces, start = pieces_through(table.points, closed=table.looks_closed)
        bare = Track(pieces, start=start, closed=True)
        assert table.left is not None
        assert table.right is not None
        edges = edges_from_widths(bare, table.points, table.left, table.right)
        created.append(Track(pieces, start=start, closed=True, edges=edges))
        assert created[-1].folds() is None
        assert created[-1].area is not None

    assert reference_seconds(make) < 2.0
    track, area = created[-1], created[-1].area
    assert track.width == pytest.approx((rows[:, 2] + rows[:, 3]).max(), abs=0.01)
    assert shapely.area(area) == pytest.approx(
        np.trapezoid(np.append(rows[:, 2:].sum(axis=1), 9.0 + 1.0), dx=1.0), rel=0.02
    )
    x, y = track.point(np.arange(4000.0) * track.length / 4000.0)
    assert track.inside(x, y).all()


# --- widths -------------------------------------------------------------------------------------------------------


def test_widths_measured_along_a_line_become_edges():
    line = Track([Piece(100.0, 0.0, 0.0)])
    points = np.column_stack((np.arange(0.0, 101.0, 10.0), np.zeros(11)))
    s, left, right = edges_from_widths(line, points, 2.0 + 0.1 * np.arange(11), np.full(11, 3.0))
    assert s.tolist() == pytest.approx(points[:, 0].tolist())
    assert left == pytest.approx(2.0 + 0.01 * s)
    assert right == pytest.approx(np.full(len(s), 3.0))


def test_the_edges_stay_where_they_are_when_the_centre_line_passes_beside_the_points():
    line = Track([Piece(100.0, 0.0, 0.0)])
    points = np.column_stack((np.arange(5.0, 100.0, 10.0), np.full(10, 0.5)))  # half a metre to the left of it
    s, left, right = edges_from_widths(line, points, np.full(10, 2.0), np.full(10, 3.0))
    assert (s[0], s[-1]) == (0.0, 100.0)
    assert left == pytest.approx(np.full(len(s), 2.5))
    assert right == pytest.approx(np.full(len(s), 2.5))


def test_edges_of_a_closed_track_are_periodic():
    points = circuit(500.0, 2.0)
    pieces, start = pieces_through(points, closed=True)
    track = Track(pieces, start=start, closed=True)
    width = 3.0 + np.sin(2 * np.pi * np.arange(len(points)) / len(points))
    turned = np.roll(points, 100, axis=0), np.roll(width, 100)  # the file may start anywhere
    for places, values in ((points, width), (np.vstack((points, points[:1])), np.append(width, width[0]))):
        s, left, right = edges_from_widths(track, places, values, values)
        assert (s[0], s[-1], left[0], right[0]) == (0.0, track.length, left[-1], right[-1])
        assert (np.diff(s) > 0.0).all()
        assert Track(pieces, start=start, closed=True, edges=(s, left, right)).left_width(s[:-1]) == pytest.approx(
            left[:-1]
        )
    s, left, _ = edges_from_widths(track, *turned, turned[1])
    assert np.interp(100.0, s, left) == pytest.approx(np.interp(100.0, np.arange(250) * 2.0, width), abs=0.02)


def test_a_point_where_the_road_has_no_width_is_named():
    line, points = Track([Piece(90.0, 0.0, 0.0)]), np.column_stack((np.arange(0.0, 100.0, 10.0), np.zeros(10)))
    width = np.abs(np.arange(0.0, 100.0, 10.0) - 60.0) / 20.0
    with pytest.raises(WorldError, match=r"^the road is 0 m wide at point 7, at \(60, 0\) m$"):
        edges_from_widths(line, points, width, width)


def test_a_point_that_is_off_the_road_is_named():
    line = Track([Piece(100.0, 0.0, 0.0)])
    points = np.column_stack((np.arange(0.0, 100.0, 10.0), np.zeros(10)))
    points[3, 1] = 4.0
    with pytest.raises(WorldError, match=r"^point 4 is 4 m off the centre line, more than .* make smooth smaller$"):
        edges_from_widths(line, points, np.full(10, 2.0), np.full(10, 2.0))
    with pytest.raises(WorldError, match="10 points, but 9 widths to the left and 10 to the right"):
        edges_from_widths(line, points, np.full(9, 2.0), np.full(10, 2.0))


# --- messages -----------------------------------------------------------------------------------------------------

SQUARE = [(0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (0.0, 10.0)]


@pytest.mark.parametrize(
    ("points", "options", "expected"),
    [
        (SQUARE[:3], {}, "3 points; a curve needs at least 4"),
        ([*SQUARE[:3], SQUARE[0]], {}, "3 points; a curve needs at least 4"),
        ([1.0, 2.0, 3.0], {}, "points of shape (3,); give N x 2, x and y of each point [m]"),
        ([*SQUARE, (math.nan, 1.0)], {}, "point 5 is not finite; give numbers in m"),
        ([*SQUARE[:2], *SQUARE[1:]], {}, "point 2 at (10, 0) m is repeated; remove one of them"),
        (SQUARE, {"smooth": -1.0}, "smooth -1 m, tolerance 0.001 m: make smooth 0 or more and tolerance above 0"),
        (SQUARE, {"tolerance": 0.0}, "make smooth 0 or more and tolerance above 0"),
        (SQUARE, {"smooth": math.nan}, "make smooth 0 or more and tolerance above 0"),
        (SQUARE, {"smooth": 5.0}, "smooth 5 m is too much for points within 7.07 m; make it less than a tenth"),
    ],
)
def test_points_without_a_curve_are_rejected_in_one_line(
    points: list[object], options: dict[str, float], expected: str
):
    with pytest.raises(WorldError) as caught:
        pieces_through(points, closed=True, **options)  # type: ignore[arg-type]
    assert expected in str(caught.value)
    assert "\n" not in str(caught.value)


# --- files --------------------------------------------------------------------------------------------------------

ROWS = [
    (0.0, 0.0, 2.0, 3.0),
    (10.0, 0.0, 2.1, 3.1),
    (20.0, 1.0, 2.2, 3.2),
    (30.0, 3.0, 2.3, 3.3),
    (40.0, 6.0, 2.4, 3.4),
]


def write(folder: Path, text: str) -> Path:
    file = folder / "track.csv"
    file.write_text(text, encoding="utf-8")
    return file


def rows(separator: str = ",", *, decimal: str = ".") -> str:
    return "\n".join(separator.join(f"{v:g}".replace(".", decimal) for v in row) for row in ROWS) + "\n"


@pytest.mark.parametrize(
    "text",
    [
        "# x_m,y_m,w_tr_right_m,w_tr_left_m\n" + rows(),
        "#x_m, y_m, w_tr_right_m, w_tr_left_m\n" + rows(", "),
        "x_m;y_m;w_tr_right_m;w_tr_left_m\n" + rows(";"),
        "x_m;y_m;w_tr_right_m;w_tr_left_m\n" + rows(";", decimal=","),
        "# made by hand\n# 2024\n\n# x_m\ty_m\tw_tr_right_m\tw_tr_left_m\n" + rows("\t"),
        '"x_m","y_m","w_tr_right_m","w_tr_left_m"\n' + rows(),
        "\ufeff" + rows(),
        rows("   "),
        rows() + "\n# the end\n",
        "\n".join(line + "," for line in rows().splitlines()),
        rows().replace("\n", "\r\n"),
    ],
)
def test_files_of_many_kinds_are_read(tmp_path: Path, text: str):
    table = read_csv_track(write(tmp_path, text))
    assert table.points == pytest.approx(np.array(ROWS)[:, :2])
    assert table.right == pytest.approx(np.array(ROWS)[:, 2])
    assert table.left == pytest.approx(np.array(ROWS)[:, 3])
    assert not table.looks_closed


def test_columns_are_chosen_by_name_or_number_and_scaled(tmp_path: Path):
    text = "# s_m; left; y; x; right\n" + "".join(f"{i}; {d}; {y}; {x}; {c}\n" for i, (x, y, c, d) in enumerate(ROWS))
    file = write(tmp_path, text)
    for names in (("x", "y", "right", "left"), (4, 3, 5, 2), ("4", "3", "5", "2")):
        table = read_csv_track(file, x=names[0], y=names[1], right=names[2], left=names[3], scale=0.1)
        assert table.points == pytest.approx(0.1 * np.array(ROWS)[:, :2])
        assert table.right == pytest.approx(0.1 * np.array(ROWS)[:, 2])
        assert table.left == pytest.approx(0.1 * np.array(ROWS)[:, 3])


def test_files_of_points_alone_have_no_widths(tmp_path: Path):
    alone = "".join(f"{x},{y}\n" for x, y, _, _ in ROWS)
    assert read_csv_track(write(tmp_path, alone)).left is None
    named = read_csv_track(write(tmp_path, "# x_m,y_m\n" + alone), right=None, left=None)
    assert named.points.shape == (5, 2)
    assert named.right is None


def test_a_repeated_last_point_means_a_closed_track(tmp_path: Path):
    angle = 2 * np.pi * np.arange(41) / 40
    points = 20.0 * np.column_stack((np.cos(angle), np.sin(angle)))
    points[-1] = points[0]

    def read(count: int) -> tuple[int, bool]:
        text = "".join(f"{x!r},{y!r},2,3\n" for x, y in points[:count].tolist())
        table = read_csv_track(write(tmp_path, text))
        assert table.left is not None
        assert len(table.left) == len(table.points)
        return len(table.points), table.looks_closed

    assert read(41) == (40, True)
    assert read(40) == (40, True)
    assert read(30) == (30, False)


HEAD = "# x_m,y_m,w_tr_right_m,w_tr_left_m\n"


@pytest.mark.parametrize(
    ("text", "options", "expected"),
    [
        ("", {}, "track.csv: is empty; a header and rows of numbers are expected"),
        (HEAD, {}, "is empty"),
        (HEAD + "0,0,1,1\n1,0,1,1\n2,0,1,1\n", {}, "track.csv: 3 points; a track needs at least 4, one per line"),
        (
            HEAD + "0,0,1,1\n1,0,nan,1\n",
            {},
            "track.csv:3: right is not a finite number; correct it or delete the line",
        ),
        (HEAD + "0,0,1,1\n1,inf,1,1\n", {}, "track.csv:3: y 'inf' is not a finite number"),
        (HEAD + "0,0,1,1\n1,two,1,1\n", {}, "track.csv:3: y 'two' is not a finite number"),
        (HEAD + "0,0,1,1\n1,,1,1\n", {}, "track.csv:3: y is not a finite number"),
        (HEAD + "0,0,1,1\n1,0,1\n", {}, "track.csv:3: left is not a finite number"),
        (HEAD + "0,0,1,1\n1,0,1,0\n", {}, "track.csv:3: left is 0 m; widths are distances from the centre line to the"),
        (HEAD + rows(), {"x": "x_n"}, "track.csv:2: no column 'x_n'; did you mean 'x_m'? (allowed: w_tr_left_m, w_tr_"),
        (HEAD + rows(), {"left": "wide"}, "give the column of left, or set left: null if there is none"),
        (HEAD + rows(), {"x": 5}, "track.csv:2: x is column 5 of 4; columns are counted from 1"),
        (HEAD + rows(), {"x": 0}, "x is column 0 of 4; columns are counted from 1"),
        (rows(), {"x": "px"}, "track.csv:1: no column 'px', because the file has no header; give x a number from 1"),
        ("0,0,1\n1,0,1\n", {}, "track.csv:1: 3 columns without header; x, y, right and left are expected, or set left"),
        (
            HEAD + rows() + "40,6,1,1\n50,9,1,1\n",
            {},
            "track.csv:7: the point of line 6 is repeated; delete one of them",
        ),
        (
            HEAD + rows() + "50,90,1,1\n50,99,1,1\n50,250,1,1\n",
            {},
            "track.csv:9: jumps 151 m from the point before; the",
        ),
        (
            "".join(f"4,{y},1,1\n" for y in (*range(9), 33)),
            {},
            "track.csv:10: jumps 25 m from the point before; the median here is 1 m;",
        ),
        (
            HEAD + rows(),
            {"scale": 20.0},
            "track.csv:3: jumps 200 m from the point before; the median here is 202 m; sort",
        ),
        (HEAD + "0,0,1,1\n1,1e300,1,1\n", {}, "track.csv:3: y is 1e+300 m; correct it, or set scale"),
        (HEAD + rows(), {"scale": 0.0}, "track.csv: scale 0 is not allowed; give the metres per unit of the file"),
    ],
)
def test_faults_of_a_file_are_reported_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str, options: dict[str, object], expected: str
):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ConfigError) as caught:
        read_csv_track(write(tmp_path, text), **options)  # type: ignore[arg-type]
    message = str(caught.value)
    assert expected in message
    assert message.startswith("track.csv:")
    assert "\n" not in message


def test_files_that_cannot_be_read_are_reported_in_one_line(tmp_path: Path):
    with pytest.raises(ConfigError, match=r"none\.csv: no such file$"):
        read_csv_track(tmp_path / "none.csv")
    with pytest.raises(ConfigError, match="Is a directory"):
        read_csv_track(tmp_path)
    (tmp_path / "track.csv").write_bytes(b"\x93NUMPY\x01\x00\xff\xfe")
    with pytest.raises(ConfigError, match=r"track\.csv: is not text; CSV is expected"):
        read_csv_track(tmp_path / "track.csv")
    (tmp_path / "track.csv").write_bytes(b"1,2,3,4\n" * 2_600_000)
    with pytest.raises(ConfigError, match="more than 20 MB; reduce the number of points"):
        read_csv_track(tmp_path / "track.csv")


@settings(max_examples=200, deadline=None)
@given(st.text(alphabet='0123456789.,;- #xy_m\n\tenaif"', max_size=200))
def test_any_text_is_read_or_rejected_in_one_line(tmp_path_factory: pytest.TempPathFactory, text: str):
    file = write(tmp_path_factory.getbasetemp(), text)
    try:
        table = read_csv_track(file)
    except ConfigError as error:
        lines = str(error).splitlines()
    else:
        lines = [f"{len(table.points)} points"]
        assert len(table.points) >= 4
    assert len(lines) == 1


# --- points that are spaced unevenly, and roads that are too wide for their bends ----------------------------------


@pytest.mark.parametrize("seed", range(12))
def test_a_curve_through_unevenly_spaced_points_does_not_swing_out(seed: int):
    """Distances of 1 to 40 m and bends of up to 60 degrees in any order: the curve stays by the line between points."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(4, 14))
    lengths = np.exp(rng.uniform(0.0, math.log(40.0), count - 1))
    headings = np.cumsum(rng.uniform(-1.05, 1.05, count - 1))
    steps = np.column_stack((lengths * np.cos(headings), lengths * np.sin(headings)))
    points = np.vstack(([0.0, 0.0], np.cumsum(steps, axis=0)))
    pieces, start = pieces_through(points, closed=False)
    track = Track(pieces, start=start)
    curve = shapely.points(*track.point(np.linspace(0.0, track.length, 4000)))
    chords = [shapely.LineString(pair) for pair in itertools.pairwise(points)]
    allowed = [shapely.buffer(chord, 0.16 * chord.length) for chord in chords]
    assert shapely.covers(shapely.buffer(shapely.union_all(allowed), 1e-6), curve).all()
    assert shapely.distance(shapely.points(points), shapely.LineString(shapely.get_coordinates(curve))).max() < 0.02
