import itertools
import math
from pathlib import Path

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.special import fresnel

from mirdrake.core.errors import ConfigError
from mirdrake.worlds.opendrive import OpenDriveRoad, read_opendrive
from mirdrake.worlds.pieces import Piece, Placement, advance
from mirdrake.worlds.tracks import Track
from tests.timing import reference_seconds

TWO_LANES = """<laneSection s="0">
<left><lane id="2" type="sidewalk"><width sOffset="0" a="2" b="0" c="0" d="0"/></lane>
<lane id="1" type="driving"><width sOffset="0" a="3" b="0" c="0" d="0"/></lane></left>
<center><lane id="0" type="none"/></center>
<right><lane id="-1" type="driving"><width sOffset="0" a="4" b="0" c="0" d="0"/></lane></right>
</laneSection>"""
RIGHT_LANE = """<laneSection s="0"><center><lane id="0" type="none"/></center>
<right><lane id="-1" type="driving"><width sOffset="0" a="3.5" b="0" c="0" d="0"/></lane></right></laneSection>"""
LINE = "<line/>"


def geometry(pose: Placement, length: float, shape: str, *, s: float = 0.0) -> str:
    x, y, yaw = pose
    return f'<geometry s="{s!r}" x="{x!r}" y="{y!r}" hdg="{yaw!r}" length="{length!r}">{shape}</geometry>\n'


def road(
    geometries: str, *, key: str = "1", lanes: str = TWO_LANES, link: str = "", junction: str = "-1", more: str = ""
) -> str:
    return (
        f'<road name="" id="{key}" junction="{junction}" length="1"><link>{link}</link>\n'
        f"<planView>{geometries}</planView>\n<lanes>{lanes}</lanes>{more}</road>\n"
    )


def link(kind: str, key: str, contact: str = "start") -> str:
    return f'<{kind} elementType="road" elementId="{key}" contactPoint="{contact}"/>'


def read(
    folder: Path, roads: str, *, choice: str | None = None, lane: str = "driving", head: str = "", more: str = ""
) -> OpenDriveRoad:
    file = folder / "road.xodr"
    file.write_text(
        f'<?xml version="1.0"?>\n{head}<OpenDRIVE>\n<header revMajor="1" revMinor="7"/>\n{roads}{more}</OpenDRIVE>\n',
        encoding="utf-8",
    )
    return read_opendrive(file, road=choice, lane=lane)


def track_of(road_read: OpenDriveRoad) -> Track:
    track = Track(road_read.pieces, start=road_read.start, closed=road_read.closed, edges=road_read.edges)
    assert track.length == pytest.approx(road_read.length)
    return track


def shape_of(piece: Piece) -> str:
    if piece.start_curvature == piece.end_curvature:
        return f'<arc curvature="{piece.start_curvature!r}"/>' if piece.start_curvature else LINE
    return f'<spiral curvStart="{piece.start_curvature!r}" curvEnd="{piece.end_curvature!r}"/>'


def plan(pieces: list[Piece], start: Placement = (0.0, 0.0, 0.0)) -> str:
    """Return a plan view of pieces."""
    text, s = "", 0.0
    for piece in pieces:
        text += geometry(start, piece.length, shape_of(piece), s=s)
        start, s = advance(start, piece), s + piece.length
    return text


BEND = [Piece(50.0, 0.0, 0.0), Piece(30.0, 0.0, 1 / 40), Piece(25.0, 1 / 40, 1 / 40), Piece(30.0, 1 / 40, 0.0)]


# --- the reference line -------------------------------------------------------------------------------------------


def test_lines_arcs_and_spirals_are_read_exactly(tmp_path: Path):
    road_read = read(tmp_path, road(plan(BEND, (100.0, -20.0, 0.5))))
    assert road_read.pieces == BEND
    assert road_read.start == (100.0, -20.0, 0.5)
    assert (road_read.closed, road_read.name, road_read.length) == (False, "1", 135.0)
    assert (set(road_read.left.tolist()), set(road_read.right.tolist())) == ({3.0}, {4.0})
    assert road_read.left_out == ["lanes other than 'driving', unless they are between: sidewalk"]


def test_a_spiral_ends_as_the_fresnel_integrals_give(tmp_path: Path):
    road_read = read(tmp_path, road(geometry((0.0, 0.0, 0.0), 30.0, '<spiral curvStart="0" curvEnd="0.05"/>')))
    scale = math.sqrt(math.pi * 20.0 * 30.0)
    sine, cosine = fresnel(30.0 / scale)
    assert track_of(road_read).pose_at(30.0) == pytest.approx((scale * cosine, scale * sine, 30.0 / 40.0), abs=1e-9)


def test_a_ring_of_arcs_is_closed(tmp_path: Path):
    quarter = Piece(10.0 * math.pi, 1 / 20, 1 / 20)
    road_read = read(tmp_path, road(plan([quarter] * 4)))
    assert road_read.closed
    track = track_of(road_read)
    assert track.length == pytest.approx(40.0 * math.pi, rel=1e-12)
    assert shapely.area(track.area) == pytest.approx(math.pi * (24.0**2 - 17.0**2), rel=1e-4)


POLY3 = '<poly3 a="0" b="0" c="0.004" d="-2e-5"/>'


def test_a_poly3_is_followed_within_a_millimetre(tmp_path: Path):
    length = quad(lambda u: math.hypot(1.0, 0.008 * u - 6e-5 * u * u), 0.0, 80.0)[0]
    road_read = read(tmp_path, road(geometry((5.0, 6.0, 0.3), length, POLY3)))
    track = track_of(road_read)
    assert track.length == pytest.approx(length, rel=1e-6)
    u = np.linspace(0.0, 80.0, 500)
    v = 0.004 * u**2 - 2e-5 * u**3
    x, y = 5.0 + u * math.cos(0.3) - v * math.sin(0.3), 6.0 + u * math.sin(0.3) + v * math.cos(0.3)
    assert np.abs(track.project(x, y)[1]).max() < 3e-4
    assert track.pose_at(track.length)[:2] == pytest.approx((x[-1], y[-1]), abs=2e-3)
    assert all(a.end_curvature == b.start_curvature for a, b in itertools.pairwise(road_read.pieces))
    assert road_read.left_out[-1] == "reference line: fitted within 0.2 mm (poly3)"


@pytest.mark.parametrize("span", ['pRange="normalized"', 'pRange="arcLength"', ""])
def test_a_parampoly3_of_either_range_is_followed_within_a_millimetre(tmp_path: Path, span: str):
    def u(p: np.ndarray) -> np.ndarray:
        return 60.0 * p - 12.0 * p**3

    def v(p: np.ndarray) -> np.ndarray:
        return 25.0 * p**2 - 8.0 * p**3

    length = quad(lambda p: math.hypot(60.0 - 36.0 * p * p, 50.0 * p - 24.0 * p * p), 0.0, 1.0)[0]
    k = length if "arcLength" in span else 1.0
    u_part = f'aU="0" bU="{60 / k!r}" cU="0" dU="{-12 / k**3!r}"'
    v_part = f'aV="0" bV="0" cV="{25 / k**2!r}" dV="{-8 / k**3!r}"'
    shape = f"<paramPoly3 {u_part} {v_part} {span}/>"
    track = track_of(read(tmp_path, road(geometry((1.0, 2.0, 0.0), length, shape))))
    p = np.linspace(0.0, 1.0, 300)
    assert track.length == pytest.approx(length, rel=1e-6)
    assert np.abs(track.project(1.0 + u(p), 2.0 + v(p))[1]).max() < 3e-4


def test_geometries_that_nearly_meet_are_smoothed_over(tmp_path: Path):
    first = geometry((0.0, 0.0, 0.0), 50.0, LINE)
    second = geometry((50.02, 0.01, 0.001), 20.0 * math.pi, '<arc curvature="0.025"/>', s=50.0)
    road_read = read(tmp_path, road(first + second))
    assert road_read.left_out[-1] == "reference line: fitted within 0.2 mm (gaps of up to 0.022 m and 0.057 deg)"
    assert road_read.length == pytest.approx(50.0 + 20.0 * math.pi, abs=0.03)
    assert track_of(road_read).folds() is None


def test_geometries_of_zero_length_are_skipped(tmp_path: Path):
    text = geometry((0.0, 0.0, 0.0), 0.0, LINE) + plan(BEND) + geometry((0.0, 0.0, 0.0), 1e-9, LINE, s=135.0)
    assert read(tmp_path, road(text)).pieces == BEND


# --- lanes --------------------------------------------------------------------------------------------------------


def widths(*lanes: tuple[int, str, str], s: float = 0.0, single: str = "") -> str:
    """Return a lane section of (id, type, records)."""
    left = "".join(f'<lane id="{i}" type="{t}">{r}</lane>' for i, t, r in lanes if i > 0)
    right = "".join(f'<lane id="{i}" type="{t}">{r}</lane>' for i, t, r in lanes if i < 0)
    sides = (f"<left>{left}</left>" if left else "") + (f"<right>{right}</right>" if right else "")
    return f'<laneSection s="{s}" {single}>{sides}</laneSection>'


def width(a: float, b: float = 0.0, c: float = 0.0, d: float = 0.0, *, at: float = 0.0, tag: str = "width") -> str:
    return f'<{tag} sOffset="{at}" a="{a}" b="{b}" c="{c}" d="{d}"/>'


STRAIGHT = plan([Piece(100.0, 0.0, 0.0)])


def test_cubic_widths_and_offsets_become_edges(tmp_path: Path):
    lanes = '<laneOffset s="0" a="0.5" b="0" c="0" d="0"/><laneOffset s="60" a="0.5" b="0.01" c="0" d="0"/>' + widths(
        (1, "driving", width(3.0) + width(3.0, 0.0, 3e-3, -5e-5, at=20.0) + width(4.0, at=60.0)),
        (-2, "driving", width(2.0)),  # farther out than -1, but listed first
        (-1, "driving", width(3.0)),
    )
    road_read = read(tmp_path, road(STRAIGHT, lanes=lanes))
    track = track_of(road_read)
    s = np.array([0.0, 10.0, 30.0, 45.0, 59.0, 61.0, 100.0])
    offset = 0.5 + 0.01 * np.maximum(s - 60.0, 0.0)
    u = np.clip(s - 20.0, 0.0, 40.0)
    lane = np.where(s < 60.0, 3.0 + 3e-3 * u**2 - 5e-5 * u**3, 4.0)
    assert track.left_width(s) == pytest.approx(offset + lane, abs=2e-3)
    assert track.right_width(s) == pytest.approx(5.0 - offset, abs=1e-9)


def test_a_lane_between_driving_lanes_belongs_to_the_road(tmp_path: Path):
    lanes = widths(
        (1, "driving", width(3.0)),
        (2, "median", width(1.0)),
        (3, "driving", width(3.0)),
        (4, "shoulder", width(2.0)),
        (-1, "driving", width(3.0)),
    )
    road_read = read(tmp_path, road(STRAIGHT, lanes=lanes))
    assert set(road_read.left.tolist()) == {7.0}
    assert road_read.left_out == ["lanes other than 'driving', unless they are between: median, shoulder"]


def test_borders_give_the_edges_of_a_lane(tmp_path: Path):
    lanes = widths(
        (1, "driving", width(3.0, 0.01, tag="border")),
        (2, "driving", width(6.0, tag="border")),
        (-1, "driving", width(3.5) + width(-9.0, tag="border")),  # widths count when both are there
        (-2, "driving", width(-5.0, tag="border")),
    )
    track = track_of(read(tmp_path, road(STRAIGHT, lanes=lanes)))
    assert track.left_width([0.0, 100.0]).tolist() == pytest.approx([6.0, 6.0])
    assert track.right_width([0.0, 100.0]).tolist() == pytest.approx([5.0, 5.0])
    lane_track = track_of(read(tmp_path, road(STRAIGHT, lanes=lanes), lane="1"))
    assert lane_track.width == pytest.approx(4.0, abs=1e-6)


def test_a_lane_that_begins_along_the_road_widens_it_within_ten_centimetres(tmp_path: Path):
    lanes = widths((1, "driving", width(3.0)), (-1, "driving", width(3.0)))
    lanes += widths((1, "driving", width(3.0)), (-1, "driving", width(3.0)), (-2, "driving", width(3.0)), s=40.0)
    track = track_of(read(tmp_path, road(STRAIGHT, lanes=lanes)))
    assert track.right_width([39.89, 39.95, 40.0, 70.0]).tolist() == pytest.approx([3.0, 4.5, 6.0, 6.0])
    assert shapely.is_valid(track.area)


def test_sections_for_one_side_leave_the_other_as_it_is(tmp_path: Path):
    lanes = widths((1, "driving", width(3.0)), (-1, "driving", width(3.0)))
    lanes += widths((1, "driving", width(5.0)), s=40.0, single='singleSide="true"')
    track = track_of(read(tmp_path, road(STRAIGHT, lanes=lanes)))
    assert track.left_width([10.0, 70.0]).tolist() == pytest.approx([3.0, 5.0])
    assert track.right_width([10.0, 70.0]).tolist() == pytest.approx([3.0, 3.0])


def test_the_centre_line_moves_onto_lanes_on_one_side(tmp_path: Path):
    arc = [Piece(50.0, 0.0, 0.0), Piece(20.0 * math.pi, 1 / 40, 1 / 40)]
    road_read = read(tmp_path, road(plan(arc, (0.0, 0.0, math.pi / 2)), lanes=RIGHT_LANE))
    assert road_read.start == pytest.approx((1.75, 0.0, math.pi / 2))
    assert road_read.pieces[1] == pytest.approx((20.0 * math.pi * 41.75 / 40, 1 / 41.75, 1 / 41.75))
    assert road_read.left.tolist() == pytest.approx([1.75] * len(road_read.s))
    assert road_read.s[-1] == pytest.approx(road_read.length)
    assert road_read.left_out == [
        "reference line: not within the lanes 'driving'; the centre line is moved -1.75 m to the left"
    ]
    spiral = track_of(read(tmp_path, road(plan(BEND), lanes=RIGHT_LANE)))
    x, y = Track(BEND).point(np.linspace(0.0, 135.0, 400), -1.75)
    assert np.abs(spiral.project(x, y)[1]).max() < 3e-4
    assert spiral.width == pytest.approx(3.5, abs=3e-3)


def test_lanes_that_wander_are_followed_in_their_middle(tmp_path: Path):
    lanes = widths((-1, "none", width(0.0, 0.1)), (-2, "driving", width(4.0)))
    road_read = read(tmp_path, road(STRAIGHT, lanes=lanes))
    assert road_read.left_out[1].endswith("'driving'; the centre line is moved to the middle of the lanes")
    track = track_of(road_read)
    assert track.pose_at(0.0) == pytest.approx((0.0, -2.0, -math.atan(0.1)), abs=2e-3)
    assert track.length == pytest.approx(math.hypot(100.0, 10.0), abs=1e-3)


def test_lanes_of_zero_width_get_a_centimetre(tmp_path: Path):
    lanes = widths((1, "driving", width(0.0, 0.03)), (-1, "none", width(1.0)))
    road_read = read(tmp_path, road(STRAIGHT, lanes=lanes))
    assert road_read.left.min() == 0.01
    assert "widths below 0.01 m to one side: made 0.01 m" in road_read.left_out
    assert track_of(road_read).width == pytest.approx(3.0, abs=0.02)


# --- chains -------------------------------------------------------------------------------------------------------


def reverse(pieces: list[Piece], start: Placement) -> tuple[list[Piece], Placement]:
    for piece in pieces:
        start = advance(start, piece)
    back = [Piece(p.length, -p.end_curvature, -p.start_curvature) for p in reversed(pieces)]
    return back, (start[0], start[1], start[2] + math.pi)


def test_roads_are_joined_by_their_links_in_either_direction(tmp_path: Path):
    middle = (10.0, 0.0, 0.0)
    for piece in BEND:
        middle = advance(middle, piece)
    tail = [Piece(40.0, -1 / 60, -1 / 60)]
    back, start = reverse(tail, middle)
    text = road(plan(back, start), key="b", link=link("successor", "a", "end"))
    text += road(plan(BEND, (10.0, 0.0, 0.0)), key="a", link=link("successor", "b", "end"))
    road_read = read(tmp_path, text, choice="a, b")
    assert np.array(road_read.pieces) == pytest.approx(np.array(BEND + tail), abs=1e-12)
    assert road_read.start == (10.0, 0.0, 0.0)
    assert road_read.name == "a .. b"
    track = track_of(road_read)
    assert track.left_width([10.0, 160.0]).tolist() == pytest.approx([3.0, 4.0])  # b's lanes change sides
    assert track.right_width([10.0, 160.0]).tolist() == pytest.approx([4.0, 3.0])
    assert {p.length for p in read(tmp_path, text).pieces} == {p.length for p in BEND + tail}
    assert read(tmp_path, text, choice="b").pieces == back


@pytest.mark.parametrize("order", list(itertools.permutations("abcd", 4))[::5])
def test_four_roads_in_any_order_are_one_ring(tmp_path: Path, order: tuple[str, ...]):
    side = [Piece(30.0, 0.0, 0.0), Piece(5.0 * math.pi, 0.1, 0.1)]
    poses = [(0.0, 0.0, 0.0)]
    for _ in range(4):
        poses.append(advance(advance(poses[-1], side[0]), side[1]))
    texts = {
        key: road(
            plan(side, poses[i]),
            key=key,
            link=link("predecessor", "abcd"[i - 1], "end") + link("successor", "abcd"[(i + 1) % 4]),
        )
        for i, key in enumerate("abcd")
    }
    road_read = read(tmp_path, "".join(texts[key] for key in order))
    assert road_read.closed
    assert road_read.length == pytest.approx(4 * (30.0 + 5.0 * math.pi))
    assert road_read.start == pytest.approx(poses["abcd".index(order[0])])
    track = track_of(road_read)
    assert track.gap == pytest.approx((0.0, 0.0), abs=1e-9)
    assert shapely.area(track.area) == pytest.approx(120.0 * 7.0 + math.pi * (14.0**2 - 7.0**2), rel=1e-4)


def test_two_roads_that_meet_at_both_ends_are_a_ring(tmp_path: Path):
    half = Piece(20.0 * math.pi, 1 / 20, 1 / 20)
    both = (
        link("predecessor", "2", "end") + link("successor", "2"),
        link("predecessor", "1", "end") + link("successor", "1"),
    )
    text = road(plan([half]), key="1", link=both[0]) + road(plan([half], (0.0, 40.0, math.pi)), key="2", link=both[1])
    road_read = read(tmp_path, text)
    assert road_read.closed
    assert road_read.pieces == [half, half]
    assert road_read.start == (0.0, 0.0, 0.0)


def test_a_step_in_width_where_a_ring_closes_is_spread(tmp_path: Path):
    lanes = widths((1, "driving", width(3.0)), (-1, "driving", width(3.0, 0.01)))
    road_read = read(tmp_path, road(plan([Piece(40.0 * math.pi, 1 / 20, 1 / 20)]), lanes=lanes))
    assert road_read.closed
    assert road_read.right[0] == road_read.right[-1] == pytest.approx(3.0)
    assert road_read.right[-2] == pytest.approx(3.0 + 0.4 * math.pi, abs=0.02)
    track_of(road_read)


def test_a_road_through_a_junction_is_joined_when_it_is_named(tmp_path: Path):
    text = road(plan([Piece(20.0, 0.0, 0.0)]), key="1") + road(
        plan([Piece(30.0, 0.0, 0.0)], (20.0, 0.0, 0.0)), key="7", junction="3"
    )
    assert read(tmp_path, text).length == 20.0  # the only road outside junctions
    road_read = read(tmp_path, text, choice="1,7", more='<junction id="3" name="crossing"/>')
    assert road_read.length == 50.0
    assert "junctions: 1" in road_read.left_out


def test_omissions_are_listed(tmp_path: Path):
    more = """<elevationProfile><elevation s="0" a="1.5" b="0" c="0" d="0"/></elevationProfile>
    <objects><object id="1"/><object id="2"/></objects><signals><signal id="1"/></signals>"""
    text = road(STRAIGHT, more=more, lanes=TWO_LANES.replace("<left>", '<left><roadMark type="solid"/>', 1))
    road_read = read(tmp_path, text + road(STRAIGHT, key="9"), choice="1", more='<junction id="5"/>')
    assert road_read.left_out == [
        "heights and slopes: the road is flat",
        "other roads: 1",
        "signals: 1",
        "objects: 2",
        "road marks: 1",
        "junctions: 1",
        "lanes other than 'driving', unless they are between: sidewalk",
    ]
    flat = '<elevationProfile><elevation s="0" a="0.0000000000000000e+00" b="-0" c="0E+00" d="0"/></elevationProfile>'
    assert not any("heights" in note for note in read(tmp_path, road(STRAIGHT, more=flat)).left_out)


# --- random roads and speed ---------------------------------------------------------------------------------------

curvatures = st.sampled_from([0.0, 0.0, 1 / 15, -1 / 25, 1 / 80, -1 / 200])
parts = st.lists(st.builds(Piece, st.floats(1.0, 60.0), curvatures, curvatures), min_size=1, max_size=8)


@settings(max_examples=40, deadline=None)
@given(parts, st.floats(-1e5, 1e5), st.floats(-3.0, 3.0))
def test_any_segments_survive_a_round_trip_through_a_file(
    tmp_path_factory: pytest.TempPathFactory, pieces: list[Piece], x: float, yaw: float
):
    road_read = read(tmp_path_factory.getbasetemp(), road(plan(pieces, (x, 0.0, yaw))))
    if road_read.closed:
        return
    assert road_read.pieces == pieces
    assert road_read.start == (x, 0.0, yaw)
    track_of(road_read)


def test_a_long_road_is_read_quickly(tmp_path: Path):
    pieces = [Piece(10.0, 0.0, 0.0), Piece(10.0, 0.02, 0.02), Piece(10.0, -0.02, -0.02)] * 140
    records = "".join(width(3.0, 0.0, 1e-3, -1e-4, at=10.0 * i) for i in range(420))
    lanes = widths((1, "driving", records), (-1, "driving", width(3.0)))
    text = road(plan(pieces), lanes=lanes)
    assert read(tmp_path, text).length == pytest.approx(4200.0)
    assert reference_seconds(lambda: read(tmp_path, text)) < 2.0


# --- faults -------------------------------------------------------------------------------------------------------

STILL = '<paramPoly3 aU="0" bU="0" cU="0" dU="0" aV="0" bV="0" cV="0" dV="0"/>'
ONE = STILL.replace('bU="0"', 'bU="1"').replace("/>", ' pRange="normalized"/>')
HAIR = geometry((0.0, 0.0, 0.0), 50.0, LINE) + geometry((60.0, 0.0, 0.0), 50.0, LINE, s=50.0)
KINK = geometry((0.0, 0.0, 0.0), 50.0, LINE) + geometry((50.0, 0.0, 1.5), 50.0, LINE, s=50.0)


@pytest.mark.parametrize(
    ("roads", "options", "expected"),
    [
        ("", {}, "road.xodr:2: contains no road"),
        (road(""), {}, "road.xodr:4: road '1' has no <geometry> of any length in <planView>"),
        (road(STRAIGHT, lanes=""), {}, "road.xodr:4: road '1' has no <laneSection> and therefore no width"),
        (road(STRAIGHT).replace('length="100.0"', ""), {}, "road.xodr:5: <geometry> has no 'length'; give it a number"),
        (
            road(STRAIGHT).replace('x="0.0"', 'x="far"'),
            {},
            "road.xodr:5: x 'far' of <geometry> should be a number within",
        ),
        (
            road(STRAIGHT).replace('hdg="0.0"', 'hdg="nan"'),
            {},
            "hdg 'nan' of <geometry> should be a number within ±1e8",
        ),
        (road(STRAIGHT).replace('"100.0"', '"-1"'), {}, "length -1 m of <geometry>; it must be from 0 to 100000 m"),
        (
            road(STRAIGHT).replace("<line/>", "<curve/>"),
            {},
            "<geometry> contains 'curve'; use line, arc, spiral, poly3 or",
        ),
        (road(STRAIGHT).replace("<line/>", ""), {}, "<geometry> contains ''; use line, arc,"),
        (road(STRAIGHT).replace("<line/>", "<arc/>"), {}, "road.xodr:5: <arc> has no 'curvature'; give it a number"),
        (road(STRAIGHT).replace("<line/>", '<arc curvature="200"/>'), {}, "curvature 200 1/m of <arc> is too large"),
        (road(geometry((0.0, 0.0, 0.0), 0.0005, LINE)), {}, "road '1' is 0.0005 m long; remove it"),
        (
            road(geometry((0.0, 0.0, 0.0), 9.0, ONE)),
            {},
            "<paramPoly3> is 1 m long, but its <geometry> states 9 m; correct",
        ),
        (road(geometry((0.0, 0.0, 0.0), 9.0, STILL)), {}, "<paramPoly3> is 0 m long, but its <geometry> states 9 m"),
        (
            road(STRAIGHT + geometry((100.0, 0.0, 0.0), 20.0, LINE, s=50.0)),
            {},
            "road.xodr:6: <geometry> begins at s = 50 m after the first, but the parts before are 100 m long; correct",
        ),
        (road(STRAIGHT, lanes=RIGHT_LANE.replace("3.5", "3500")), {}, "lanes reach 500 m beside the reference line"),
        (
            road(HAIR),
            {},
            "road.xodr:6: begins 10 m and 0 deg away from the end of the one before, at road.xodr:5; cor",
        ),
        (road(KINK), {}, "road.xodr:6: begins 0 m and 85.9 deg away from the end of the one before, at road.xodr:5"),
        (
            road(STRAIGHT),
            {"lane": "drivin"},
            ":7: no lane 'drivin' here; did you mean 'driving'? (allowed: driving, sidewalk)",
        ),
        (road(STRAIGHT), {"choice": "2"}, "road.xodr: no road '2'; allowed: 1"),
        (road(STRAIGHT) + road(STRAIGHT, key="west"), {"choice": "1, wst"}, "no road 'wst'; did you mean 'west'?"),
        (
            road(STRAIGHT) + road(STRAIGHT, key="2"),
            {},
            "road.xodr: its 2 roads do not form one chain; select one, or several as '1, 7, 2'; allowed: ",
        ),
        (road(STRAIGHT) + road(STRAIGHT, key="2"), {"choice": "1,2"}, "road.xodr:14: begins 0 m and 180 deg away"),
        (road(STRAIGHT) + "<road>", {}, "road.xodr:13: not valid XML: mismatched tag"),
        (road(STRAIGHT, lanes=RIGHT_LANE.replace('a="3.5"', 'a="x"')), {}, "road.xodr:8: a 'x' of <width> should be"),
    ],
)
def test_faults_are_reported_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, roads: str, options: dict[str, str], expected: str
):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ConfigError) as caught:
        read(tmp_path, roads, **options)
    message = str(caught.value)
    assert expected in message
    assert message.startswith("road.xodr:")
    assert "\n" not in message


@pytest.mark.parametrize(
    "head",
    [
        '<!DOCTYPE a [\n<!ENTITY x "xx">\n<!ENTITY y "&x;&x;">]>\n',
        '<!DOCTYPE a [\n<!ENTITY x SYSTEM "file:///etc/hostname">]>\n',
        '<!DOCTYPE a [\n<!ENTITY % x SYSTEM "file:///etc/hostname">\n%x;]>\n',
    ],
)
def test_entities_are_rejected(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, head: str):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ConfigError, match=r"^road\.xodr:3: declares the XML entity '.*'; write out its value"):
        read(tmp_path, road(STRAIGHT), head=head)


def test_files_that_are_not_opendrive_are_reported_in_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ConfigError, match=r"^none\.xodr: No such file or directory$"):
        read_opendrive("none.xodr")
    for text, expected in (
        ("<sdf/>", r"a\.xodr:1: <sdf> is not OpenDRIVE, whose root is <OpenDRIVE>"),
        ("", r"a\.xodr:1: not valid XML: no element found"),
        ('<?xml version="1.0" encoding="nobody-knows"?><OpenDRIVE/>', r"a\.xodr(:1)?: not valid XML: unknown encoding"),
    ):
        Path("a.xodr").write_text(text)
        with pytest.raises(ConfigError, match=f"^{expected}"):
            read_opendrive("a.xodr")
    with Path("a.xodr").open("wb") as file:
        file.truncate(100_000_001)
    with pytest.raises(ConfigError, match="more than 100 MB of XML; cut out the roads that are needed"):
        read_opendrive("a.xodr")


def test_name_spaces_do_not_matter(tmp_path: Path):
    file = tmp_path / "road.xodr"
    text = f'<x:OpenDRIVE xmlns:x="http://example.org">{road(STRAIGHT)}</x:OpenDRIVE>'
    file.write_text(text.replace("<road", "<x:road").replace("</road", "</x:road"))
    assert read_opendrive(file).length == 100.0
