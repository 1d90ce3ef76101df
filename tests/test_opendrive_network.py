"""OpenDRIVE maps as networks against closed forms: crossings, a T junction, a roundabout, sections, profiles."""

import math
from pathlib import Path

import numpy as np
import pytest

from mirdrake.core.errors import ConfigError
from mirdrake.worlds.networks import Network
from mirdrake.worlds.networks.opendrive_network import read_network
from mirdrake.worlds.networks.opendrive_omissions import continuity
from tests.opendrive_maps import (
    LANE,
    REACH,
    RIGHT_ANGLE,
    TWO_WAY,
    arc,
    crossing,
    document,
    geometry,
    junction,
    lane,
    linked,
    one_lane,
    road,
    section,
    signal,
)  # fmt: skip


def read(folder: Path, text: str) -> Network:
    file = folder / "map.xodr"
    file.write_text(text, encoding="utf-8")
    return read_network(file)


def worst_gaps(network: Network) -> tuple[float, float]:
    rows = list(continuity(network))
    return max(gap for *_, gap, _ in rows), max(turn for *_, turn in rows)


def test_all_lanes_of_a_crossing_are_connected_without_gaps(tmp_path: Path) -> None:
    network = read(tmp_path, crossing())
    assert len(network.lanes) == 4 * 2 + 12
    assert network.lanes["180.0.1"].successors == ("180_straight.0.-1", "180_left.0.-1", "180_right.0.-1")
    assert network.lanes["180_left.0.-1"].successors == ("90.0.-1",)
    assert len(list(continuity(network))) == 24
    gap, turn = worst_gaps(network)
    assert gap < 1e-9
    assert turn < 1e-9
    assert network.notes == ()


def test_turns_of_a_crossing_have_the_length_and_curvature_of_their_arcs(tmp_path: Path) -> None:
    network = read(tmp_path, crossing())
    left, right = network.lanes["180_left.0.-1"], network.lanes["180_right.0.-1"]
    assert left.length == pytest.approx((REACH + LANE / 2.0) * RIGHT_ANGLE, abs=1e-9)
    assert right.length == pytest.approx((REACH - LANE / 2.0) * RIGHT_ANGLE, abs=1e-9)
    assert left.curvature == pytest.approx(np.full(len(left.s), 1.0 / 11.75), abs=1e-9)
    assert right.curvature == pytest.approx(np.full(len(right.s), -1.0 / 8.25), abs=1e-9)
    middle = left.pose(left.length / 2.0)  # its centre is at (-10, 10)
    assert middle[:2] == pytest.approx((-10.0 + 11.75 * math.sqrt(0.5), 10.0 - 11.75 * math.sqrt(0.5)), abs=1e-6)


def test_straight_lanes_of_a_crossing_conflict_where_they_cross(tmp_path: Path) -> None:
    network = read(tmp_path, crossing())
    pair = next(c for c in network.conflicts if set(c.lanes) == {"180_straight.0.-1", "270_straight.0.-1"})
    assert pair.kind == "crossing"
    assert pair.point == pytest.approx((LANE / 2.0, -LANE / 2.0), abs=1e-9)
    # Going east, the lane to the north is between x = 0 and 3.5 m, 10 m after the entry.
    assert pair.span("180_straight.0.-1") == pytest.approx((10.05, 13.45), abs=0.01)
    assert pair.span("270_straight.0.-1") == pytest.approx((6.55, 9.95), abs=0.01)


def test_right_before_left_and_oncoming_traffic_without_signs(tmp_path: Path) -> None:
    network = read(tmp_path, crossing())
    assert network.junctions["J"].rule == "right_before_left"
    # The arm at 270 deg is on the right of a driver who comes from 180 deg.
    assert ("270_straight.0.-1", "180_straight.0.-1") in network.priorities
    assert ("180_straight.0.-1", "90_straight.0.-1") in network.priorities
    assert ("0_straight.0.-1", "180_left.0.-1") in network.priorities
    assert ("0_right.0.-1", "180_left.0.-1") in network.priorities
    assert not {("0_left.0.-1", "180_left.0.-1"), ("180_left.0.-1", "0_left.0.-1")} & network.priorities
    assert {conflict.other("180_straight.0.-1") for conflict in network.yields("180_straight.0.-1")} == {
        "270_straight.0.-1", "270_left.0.-1", "270_right.0.-1",
    }  # fmt: skip


def test_yield_signs_lights_stated_priorities_and_all_way_stop(tmp_path: Path) -> None:
    signs = {90: signal("n", 0.5, "205"), 270: signal("s", 0.5, "206")}
    network = read(tmp_path, crossing(signals=signs))
    assert network.junctions["J"].rule == "priority"
    assert ("180_straight.0.-1", "270_straight.0.-1") in network.priorities
    assert {line.kind for line in network.stop_lines} == {"yield", "stop"}
    assert {line.lane for line in network.stop_lines} == {"90.0.1", "270.0.1"}
    assert all(line.s == pytest.approx(49.5) for line in network.stop_lines)

    network = read(tmp_path, crossing(signals={d: signal(f"stop{d}", 0.5, "206") for d in (0, 90, 180, 270)}))
    assert network.junctions["J"].rule == "all_way_stop"
    assert network.priorities == frozenset()

    stated = '<priority high="180_straight" low="270_straight"/>'
    network = read(tmp_path, crossing(more=stated))
    assert network.junctions["J"].rule == "priority"
    assert ("180_straight.0.-1", "270_straight.0.-1") in network.priorities


def test_lights_control_the_lane_of_their_orientation_at_the_painted_line(tmp_path: Path) -> None:
    light = signal("L", 0.5, "1000001", dynamic="yes") + signal("line", 2.0, "294") + signal("sign", 5.0, "274.1")
    network = read(tmp_path, crossing(signals={180: light}))
    assert network.signals["L"].kind == "lights"
    assert network.signals["L"].lanes == ("180.0.1",)
    # 0.5 m along an arm that leads to the west from (-10, 0), and 5 m to its left; it faces traffic to the east.
    place = network.signals["L"]
    assert (place.x, place.y, place.z, place.yaw) == pytest.approx((-10.5, -5.0, 2.0, 0.0), abs=1e-9)
    (line,) = network.stop_lines
    assert (line.lane, line.kind, line.signal) == ("180.0.1", "lights", "L")
    assert line.s == pytest.approx(48.0)
    assert network.junctions["J"].rule == "lights"
    assert network.notes == (("signs of type 274.1, without effect", "1"),)


@pytest.mark.parametrize("sign", ["205", "206"])
def test_lights_hold_before_a_sign_beside_them(tmp_path: Path, sign: str) -> None:
    signs = signal("sign", 0.5, sign) + signal("L", 0.5, "1000001", dynamic="yes")
    (line,) = read(tmp_path, crossing(signals={180: signs})).stop_lines
    assert (line.lane, line.kind, line.signal) == ("180.0.1", "lights", "L")


def test_objects_that_are_no_stop_lines_are_counted(tmp_path: Path) -> None:
    rows = ('type="building"', 'type="building" name="house"', 'name="bush"', 'type="roadMark" subtype="stopLine"')
    objects = "".join(f'<object id="{i}" s="{10 + i}" t="4" {row}/>' for i, row in enumerate(rows))
    straight = road("0", geometry(0.0, 0.0, 0.0, 50.0), more=f"<objects>{objects}</objects>")
    assert read(tmp_path, document(straight)).notes == (
        ("objects of type building", "2"),
        ("objects of type none", "1"),
    )


def test_validity_and_signal_reference(tmp_path: Path) -> None:
    two = section(right=[lane(-1), lane(-2)])
    only = '<validity fromLane="-2" toLane="-2"/>'
    signs = signal("a", 90.0, "206", orientation="+", more=only)
    reference = '<signalReference id="a" s="10" t="0" orientation="+"/>'
    network = read(
        tmp_path,
        document(
            road("1", geometry(0, 0, 0, 100.0), two, more=f"<signals>{signs}</signals>"),
            road("2", geometry(0, 50, 0, 100.0), two, more=f"<signals>{reference}</signals>"),
        ),
    )
    assert sorted((line.lane, line.s) for line in network.stop_lines) == [
        ("1.0.-2", 90.0),
        ("2.0.-1", 10.0),
        ("2.0.-2", 10.0),
    ]
    assert set(network.signals["a"].lanes) == {"1.0.-2", "2.0.-1", "2.0.-2"}


def test_t_junction_has_six_ways_and_its_dead_end_has_none(tmp_path: Path) -> None:
    network = read(tmp_path, crossing((0, 180, 270)))
    through = [lane for lane in network.lanes.values() if lane.junction == "J"]
    assert len(through) == 6
    assert network.lanes["270.0.1"].successors == ("270_left.0.-1", "270_right.0.-1")
    assert network.lanes["0.0.-1"].successors == ()
    assert worst_gaps(network)[0] < 1e-9
    # Two lanes that merge into one, and two that leave the same one.
    kinds = {frozenset(c.lanes): c.kind for c in network.conflicts}
    assert kinds[frozenset({"180_straight.0.-1", "270_right.0.-1"})] == "merge"
    assert kinds[frozenset({"270_left.0.-1", "270_right.0.-1"})] == "split"


def test_roundabout_closes_and_its_length_is_that_of_a_circle(tmp_path: Path) -> None:
    radius = 20.0
    parts, rows = [], []
    for i in range(4):
        a = i * RIGHT_ANGLE
        # Quarters from 15 deg after an arm to 15 deg before the next; the rest is in the junction of the next arm.
        for key, begin, angle, inside in (
            (f"q{i}", a + math.radians(15), math.radians(60), "-1"),
            (f"c{i}", a - math.radians(15), math.radians(30), f"J{i}"),
        ):
            view = arc(radius * math.cos(begin), radius * math.sin(begin), begin + RIGHT_ANGLE, radius, angle)
            links = linked(f"junction J{i}", f"junction J{(i + 1) % 4}")
            if inside != "-1":
                links = linked(f"road q{(i - 1) % 4} end", f"road q{i} start")
            row = one_lane("-1", "-1", 5.0) if inside != "-1" else one_lane("", "", 5.0)
            parts.append(road(key, view, row, links=links, junction=inside, offset=2.5))
        rows.append(junction(f"J{i}", [(f"q{(i - 1) % 4}", f"c{i}", "-1")]))
    network = read(tmp_path, document(*parts, *rows))
    total = 0.0
    name = "q0.0.-1"
    for _ in range(8):
        total += network.lanes[name].length
        (name,) = network.lanes[name].successors
    assert name == "q0.0.-1"
    assert total == pytest.approx(2.0 * math.pi * radius, abs=1e-9)
    assert worst_gaps(network)[0] < 1e-9
    assert network.area.area == pytest.approx(math.pi * (22.5**2 - 17.5**2), rel=1e-3)


def test_lanes_beside_a_curve_have_their_own_length_and_curvature(tmp_path: Path) -> None:
    network = read(tmp_path, document(road("1", arc(0.0, 0.0, 0.0, 50.0, 1.0), TWO_WAY)))
    right, left = network.lanes["1.0.-1"], network.lanes["1.0.1"]
    assert right.length == pytest.approx(51.75, abs=1e-9)
    assert left.length == pytest.approx(48.25, abs=1e-9)
    assert right.curvature == pytest.approx(np.full(len(right.s), 1.0 / 51.75), abs=1e-9)
    assert left.curvature == pytest.approx(np.full(len(left.s), -1.0 / 48.25), abs=1e-9)
    assert left.direction == -1
    assert (left.opposite, right.opposite) == (right.id, left.id)
    chord = np.hypot(np.diff(right.x), np.diff(right.y)).max()
    assert chord**2 / (8.0 * 51.75) < 1.1e-3  # the sagitta of the polyline


def test_sections_link_lanes_and_a_lane_that_opens_has_its_slope(tmp_path: Path) -> None:
    opening = lane(-2, after="-2").replace(
        '<width sOffset="0" a="3.5" b="0" c="0" d="0"/>', '<width sOffset="0" a="0" b="0" c="0.0105" d="-0.00014"/>'
    )  # from 0 to 3.5 m over 50 m, a smooth cubic: 3 w/L² = 0.0042 ... with c = 3 w / L² and d = -2 w / L³
    opening = opening.replace("0.0105", repr(3.0 * 3.5 / 50.0**2)).replace("-0.00014", repr(-2.0 * 3.5 / 50.0**3))
    first = section(right=[lane(-1, after="-1")])
    second = section(right=[lane(-1, before="-1", after="-1"), opening], s=50.0)
    third = section(right=[lane(-1, before="-1"), lane(-2, before="-2")], s=100.0)
    network = read(tmp_path, document(road("1", geometry(0, 0, 0, 150.0), first + second + third)))
    assert network.lanes["1.0.-1"].successors == ("1.1.-1",)
    assert network.lanes["1.1.-2"].successors == ("1.2.-2",)
    assert network.lanes["1.1.-2"].predecessors == ()
    assert network.lanes["1.1.-1"].right == "1.1.-2"
    assert network.lanes["1.1.-2"].left == "1.1.-1"
    new = network.lanes["1.1.-2"]
    # In the middle of the cubic, its width is 1.75 m and its centre is at -3.5 - 0.875 m with a slope of -0.75 w / L.
    x, y, yaw = (float(v) for v in new.pose(np.interp(75.0, new.x, new.s)))
    assert (x, y) == pytest.approx((75.0, -4.375), abs=1e-3)
    assert yaw == pytest.approx(-math.atan(0.75 * 3.5 / 50.0), abs=1e-4)
    assert max(worst_gaps(network)) < 1e-9


def test_of_polynomials_that_begin_at_the_same_station_the_last_one_counts(tmp_path: Path) -> None:
    none = '<width sOffset="0" a="nan" b="nan" c="nan" d="nan"/><width sOffset="0" a="9" b="0" c="0" d="0"/>'
    wide = lane(-1, width=3.0).replace("<width", none + "<width")
    network = read(tmp_path, document(road("0", geometry(0.0, 0.0, 0.0, 50.0), section(right=[wide]))))
    assert network.lane("0.0.-1").pose(10.0)[1] == pytest.approx(-1.5)


def test_speed_limits_heights_and_left_hand_traffic(tmp_path: Path) -> None:
    more = (
        '<type s="0" type="town"><speed max="50" unit="km/h"/></type>'
        '<elevationProfile><elevation s="0" a="2" b="0.05" c="0" d="0"/></elevationProfile>'
        '<lateralProfile><superelevation s="0" a="0.1" b="0" c="0" d="0"/></lateralProfile>'
    )
    lanes = section([lane(1)], [lane(-1, more='<speed sOffset="0" max="20" unit="mph"/>')])
    network = read(tmp_path, document(road("1", geometry(0, 0, 0, 100.0), lanes, more=more, rule="LHT")))
    left, right = network.lanes["1.0.1"], network.lanes["1.0.-1"]
    assert network.left_hand
    assert (left.direction, right.direction) == (1, -1)
    assert left.speed_limit == pytest.approx(50.0 / 3.6)
    assert right.speed_limit == pytest.approx(8.9408)
    assert left.z[0] == pytest.approx(2.0 + 1.75 * math.tan(0.1))
    assert left.z[-1] == pytest.approx(7.0 + 1.75 * math.tan(0.1))


def test_road_marks_allow_or_forbid_lane_changes(tmp_path: Path) -> None:
    solid, broken = '<roadMark sOffset="0" type="solid"/>', '<roadMark sOffset="0" type="broken"/>'
    lanes = section(right=[lane(-1, more=solid), lane(-2, more=broken), lane(-3)], centre=solid)
    network = read(tmp_path, document(road("1", geometry(0, 0, 0, 100.0), lanes)))
    assert [network.lanes[f"1.0.{n}"].change for n in (-1, -2, -3)] == ["none", "right", "both"]
    solid_lines = [line for line in network.markings if line.dash is None]
    assert len(network.markings) == 3
    assert sorted(float(line.points[0, 1]) for line in solid_lines) == pytest.approx([-3.5, 0.0])


def test_missing_links_are_added_where_lanes_meet_and_wrong_ones_are_reported(tmp_path: Path) -> None:
    text = document(
        road("1", geometry(0, 0, 0, 50.0), links=linked(after="road 2 start")),
        road("2", geometry(50, 0, 0, 50.0), links=linked(before="road 1 end")),
    )
    network = read(tmp_path, text)
    assert network.lanes["1.0.-1"].successors == ("2.0.-1",)
    assert network.lanes["2.0.1"].successors == ("1.0.1",)
    assert network.notes == (("connections of lanes that the file leaves out", "2 added, where lanes meet"),)

    wrong = section([lane(1, after="-1")], [lane(-1)])
    text = document(
        road("1", geometry(0, 0, 0, 50.0), wrong, links=linked(after="road 2 start")),
        road("2", geometry(50.2, 0, 0, 50.0), links=linked(before="road 1 end")),
    )
    notes = read(tmp_path, text).notes
    assert notes[0] == ("connections of lanes with opposite directions, left out", "1, first 1.0.1 and 2.0.-1")


def test_lanes_that_do_not_meet_are_reported(tmp_path: Path) -> None:
    lanes = section(right=[lane(-1, before="-1", after="-1")])
    text = document(
        road("1", geometry(0, 0, 0, 50.0), lanes, links=linked(after="road 2 start")),
        road("2", geometry(50, 0.2, 0.02, 50.0), lanes, links=linked(before="road 1 end")),
    )
    (note,) = read(tmp_path, text).notes
    assert note.part == "lanes that do not meet"
    assert note.detail.startswith("1 of 1 connections; worst 1.0.-1 to 2.0.-1, 0.2")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (document(), "map.xodr:2: contains no road"),
        (document(road("1", "")), "map.xodr:4: road '1' has no <geometry> of any length in <planView>"),
        (document(road("1", geometry(0, 0, 0, 9.0), "")), "map.xodr:4: road '1' has no <laneSection>"),
        (
            document(road("1", geometry(0, 0, 0, 9.0), section([lane(1, "sidewalk")]))),
            "none of its 1 lanes is for motor",
        ),
        (document(road("1", geometry(0, 0, 0, 99_999.0)) * 2), "allowed are 100 km"),
    ],
)
def test_faults_have_one_line_with_their_place(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(ConfigError) as error:
        read(tmp_path, text.replace('id="1" length="0.0"', 'id="2" length="0.0"', 1) if "99999" in text else text)
    assert message in str(error.value)
    assert "\n" not in str(error.value)
