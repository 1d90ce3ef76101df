"""Lanes of a network, their conflicts and priorities, against closed forms."""

import math
from dataclasses import replace

import numpy as np
import pytest

from mirdrake.core.errors import ConfigError, WorldError
from mirdrake.worlds.networks import Lane, Network, find_conflicts, lane_along


def straight(name: str, start: tuple[float, float], end: tuple[float, float], width: float = 3.0) -> Lane:
    return lane_along(name, np.linspace(start, end, 11), width=width)


def test_arc_length_heading_and_curvature_of_a_circle() -> None:
    angle = np.linspace(0.0, math.pi, 101)
    lane = lane_along("arc", 20.0 * np.column_stack((np.sin(angle), 1.0 - np.cos(angle))), yaw=angle)
    assert lane.length == pytest.approx(20.0 * math.pi, abs=1e-9)
    assert lane.curvature == pytest.approx(np.full(101, 0.05), abs=1e-9)
    x, y, yaw = lane.pose(lane.length / 2.0, 3.0)  # a quarter of the circle on, 3 m nearer to its centre (0, 20)
    assert (float(x), float(y), float(yaw)) == pytest.approx((17.0, 20.0, math.pi / 2.0), abs=1e-9)
    s, offset = lane.project(17.0, 20.0)
    assert (float(s), float(offset)) == pytest.approx((lane.length / 2.0, 3.0), abs=1e-3)
    assert lane.area.area == pytest.approx(math.pi / 2.0 * (21.75**2 - 18.25**2), rel=1e-3)


def test_headings_without_given_ones_follow_a_spline() -> None:
    angle = np.linspace(0.0, 1.0, 21)
    lane = lane_along("arc", 50.0 * np.column_stack((np.sin(angle), 1.0 - np.cos(angle))))
    assert lane.yaw == pytest.approx(angle, abs=1e-4)


def test_two_crossing_lanes_conflict_over_their_widths() -> None:
    lanes = {"a": straight("a", (-20.0, 0.0), (20.0, 0.0)), "b": straight("b", (0.0, -30.0), (0.0, 30.0), width=4.0)}
    (conflict,) = find_conflicts(lanes)
    assert conflict.lanes == ("a", "b")
    assert conflict.kind == "crossing"
    assert conflict.point == pytest.approx((0.0, 0.0), abs=1e-9)
    assert conflict.span("a") == pytest.approx((18.0, 22.0), abs=0.06)
    assert conflict.span("b") == pytest.approx((28.5, 31.5), abs=0.06)


def test_lanes_side_by_side_one_after_another_and_on_a_bridge_do_not_conflict() -> None:
    a = replace(straight("a", (0.0, 0.0), (20.0, 0.0)), successors=("c",))
    b = straight("b", (0.0, 3.0), (20.0, 3.0))
    c = replace(straight("c", (19.0, 0.0), (40.0, 0.0)), predecessors=("a",))
    bridge = straight("d", (10.0, -20.0), (10.0, 20.0))
    bridge = replace(bridge, z=bridge.z + 5.0)
    assert find_conflicts({lane.id: lane for lane in (a, b, c, bridge)}) == ()


def test_a_network_names_its_lanes_and_who_yields() -> None:
    lanes = {"a": straight("a", (-20.0, 0.0), (20.0, 0.0)), "b": straight("b", (0.0, -30.0), (0.0, 30.0))}
    network = Network("town", lanes, priorities=frozenset({("a", "b")}))
    assert [conflict.other("b") for conflict in network.yields("b")] == ["a"]
    assert network.yields("a") == ()
    lane, s, offset = network.locate(1.0, -10.0)
    assert lane.id == "b"
    assert (s, offset) == pytest.approx((20.0, -1.0))
    assert network.locate(0.1, 0.2, yaw=0.0)[0].id == "a"
    assert network.locate(0.1, 0.2, yaw=math.pi / 2)[0].id == "b"
    with pytest.raises(ConfigError, match=r"w.yaml:3: network 'town' has no lane 'aa'; did you mean 'a'"):
        network.lane("aa", where="w.yaml:3")


def test_a_lane_needs_two_points() -> None:
    with pytest.raises(WorldError, match="a lane needs two or more"):
        lane_along("a", [[0.0, 0.0], [0.0, 0.0]])
