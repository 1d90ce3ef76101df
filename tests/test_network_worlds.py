"""Networks in world files: routes as tracks, roads and friction, lock file, run folder, pictures, a drive."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy
import shapely
from shapely.ops import substring

from mirdrake.core.compiled import compiled
from mirdrake.core.errors import ConfigError, WorldError
from mirdrake.report.plan import draw_plan
from mirdrake.runs.simulation import simulate
from mirdrake.worlds import World, load_world
from mirdrake.worlds.lock import lock_text
from mirdrake.worlds.networks import Network
from mirdrake.worlds.networks.lane import lane_along
from mirdrake.worlds.networks.network_relief import fill_from_nearest
from mirdrake.worlds.networks.opendrive_omissions import continuity
from mirdrake.worlds.networks.paint import dashes
from mirdrake.worlds.networks.routes import find_place, find_route
from mirdrake.worlds.scenery import scenery
from mirdrake.worlds.stored import read_world, world_data
from tests.opendrive_maps import LANE, crossing, document, geometry, lane, linked, road, section, signal
from tests.timing import reference_seconds
from tools.town import make_town

ROUTE = "tracks: {way: {route: {from: 180.0.1@10, to: 90.0.-1@30}}}\n"


def world(folder: Path, text: str = ROUTE, xodr: str | None = None) -> World:
    (folder / "map.xodr").write_text(crossing() if xodr is None else xodr, encoding="utf-8")
    file = folder / "w.yaml"
    file.write_text(
        f"mirdrake: world/1\nground: {{surface: grass}}\nnetwork: {{xodr: map.xodr}}\n{text}", encoding="utf-8"
    )
    return load_world(str(file))


def network_of(folder: Path, xodr: str | None = None) -> Network:
    network = world(folder, "", xodr).network
    assert network is not None
    return network


def three_lanes(marks: str = "") -> str:
    """Return a road of 200 m to the east with three lanes, of which the outer ones end in roads of their own."""
    lanes = section(right=[lane(n, more=marks, after="-1" if n == -3 else "") for n in (-1, -2, -3)])
    exit_lane = section(right=[lane(-1, before="-3")])
    return document(
        road("1", geometry(0, 0, 0, 200.0), lanes, links=linked(after="road 2 start")),
        road("2", geometry(200, -7, 0, 50.0), exit_lane, links=linked(before="road 1 end")),
    )


def test_shortest_route_over_a_crossing_has_the_length_of_its_lanes(tmp_path: Path) -> None:
    route = find_route(network_of(tmp_path), ("180.0.1", 10.0), ("90.0.-1", 30.0))
    assert route.lanes == ("180.0.1", "180_left.0.-1", "90.0.-1")
    assert route.length == pytest.approx(40.0 + 11.75 * math.pi / 2.0 + 30.0, rel=1e-4)


def test_route_on_a_ring_of_one_lane_goes_over_its_end() -> None:
    angle = np.linspace(0.0, 2.0 * math.pi, 200)
    points = 20.0 * np.column_stack((np.cos(angle), np.sin(angle)))
    ring = replace(lane_along("ring", points, width=3.5), successors=("ring",))
    route = find_route(Network("ring", {"ring": ring}), ("ring", 100.0), ("ring", 30.0))
    assert route.length == pytest.approx(ring.length - 100.0 + 30.0, rel=1e-3)


def test_route_on_one_lane_ends_ahead_of_its_start_or_goes_round(tmp_path: Path) -> None:
    network = network_of(tmp_path)
    assert find_route(network, ("0.0.1", 5.0), ("0.0.1", 25.0)).length == pytest.approx(20.0)
    with pytest.raises(WorldError, match=r"no lanes lead from 0.0.1@25 to 0.0.1@5; choose places in the direction"):
        find_route(network, ("0.0.1", 25.0), ("0.0.1", 5.0))


def test_route_via_a_place_is_the_chain_of_both_parts(tmp_path: Path) -> None:
    route = find_route(network_of(tmp_path), ("180.0.1", 10.0), ("0.0.-1", 30.0), via=[("180.0.1", 20.0)])
    assert route.lanes == ("180.0.1", "180_straight.0.-1", "0.0.-1")
    assert route.length == pytest.approx(90.0)


def test_route_changes_lanes_smoothly_where_it_must(tmp_path: Path) -> None:
    route = find_route(network_of(tmp_path, three_lanes()), ("1.0.-1", 20.0), ("2.0.-1", 30.0))
    assert route.lanes == ("1.0.-1", "1.0.-2", "1.0.-3", "2.0.-1")
    x, y = route.points.T
    assert (y[0], y[-1]) == pytest.approx((-LANE / 2.0, -2.5 * LANE))
    slope = np.diff(y) / np.diff(x)
    # Each change blends over 40 m: a quintic has its largest slope 15/8 of the mean in the middle.
    assert slope.min() == pytest.approx(-15.0 / 8.0 * LANE / 40.0, rel=0.01)
    assert slope.max() < 1e-9
    assert (x[-1], x[0]) == pytest.approx((230.0, 20.0))


def test_solid_lines_forbid_lane_changes(tmp_path: Path) -> None:
    network = network_of(tmp_path, three_lanes('<roadMark sOffset="0" type="solid"/>'))
    with pytest.raises(WorldError, match="no lanes lead from"):
        find_route(network, ("1.0.-1", 20.0), ("2.0.-1", 30.0))


def test_places_by_lane_and_by_position(tmp_path: Path) -> None:
    network = network_of(tmp_path)
    assert find_place(network, "0.0.1@12.5 m") == ("0.0.1", 12.5)
    assert find_place(network, "0.0.1") == ("0.0.1", 0.0)
    name, s = find_place(network, (30.0, 1.5))
    assert name == "0.0.1"
    assert s == pytest.approx(30.0)
    for place, message in (
        ("0.0.1@99", "s = 99 m; lane '0.0.1' is 50 m long"),
        ("0.0.7", "no lane '0.0.7'; did you mean '0.0.1'"),
        ("@3", "'@3' is not a place; write lane@station"),
    ):
        with pytest.raises(ConfigError, match=message):
            find_place(network, place)


def test_route_becomes_a_track_that_follows_its_lanes(tmp_path: Path) -> None:
    made = world(tmp_path)
    track = made.tracks["way"]
    assert track.length == pytest.approx(70.0 + 11.75 * math.pi / 2.0, abs=1e-3)
    assert not made.spec.tracks["way"].road
    assert track.width == pytest.approx(LANE, abs=1e-6)
    assert made.network is not None
    left = made.network.lanes["180_left.0.-1"]
    s, offset = track.project(left.x, left.y)
    assert np.abs(offset).max() < 2e-3
    assert np.ptp(s) == pytest.approx(left.length, abs=1e-3)


def test_lanes_are_road_with_their_own_friction(tmp_path: Path) -> None:
    made = world(tmp_path, "")
    assert made.on_road([0.0, 30.0, 30.0], [0.0, 3.4, 3.6]).tolist() == [True, True, False]
    assert made.mu([30.0, 30.0], [1.0, 10.0]) == pytest.approx([0.85, 0.5])
    assert [area.name for area in made.road_areas] == ["lanes"]
    # Arms and ways: four arms of 50 m, and the square between them with rounded corners, closed without gaps.
    area = made.road_areas[0].area
    assert shapely.get_num_geometries(area) == 1
    assert len(shapely.get_parts(area)[0].interiors) == 0


def test_faults_of_networks_and_routes_have_their_place(tmp_path: Path) -> None:
    for text, message in (
        (
            "tracks: {way: {route: {from: 180.0.1, to: 9.0.1}}}",
            r"w.yaml:4: tracks.way.route.to: network 'map' has no lane",
        ),
        ("tracks: {way: {route: {from: 90.0.-1, to: 180.0.1}}}", r"w.yaml:4: tracks.way.route: no lanes lead from"),
        ("tracks: {way: {route: {from: 90.0.-1, to: 3, via: []}}}", r"w.yaml:4: tracks.way.route.to"),
    ):
        with pytest.raises((ConfigError, WorldError), match=message):
            world(tmp_path, text)
    file = tmp_path / "w.yaml"
    file.write_text("mirdrake: world/1\nnetwork: {xodr: mapp.xodr}\n", encoding="utf-8")
    with pytest.raises(
        ConfigError, match=r"w.yaml:2: network.xodr: no such file: 'mapp.xodr'; did you mean 'map.xodr'"
    ):
        load_world(str(file))
    file.write_text("mirdrake: world/1\ntracks: {way: {route: {from: a, to: b}}}\n", encoding="utf-8")
    with pytest.raises(WorldError, match=r"w.yaml:2: tracks.way.route: the world has no network; add for example"):
        load_world(str(file))


def test_run_folders_and_lock_files_contain_the_network(tmp_path: Path) -> None:
    made = world(tmp_path, xodr=crossing(signals={180: signal("L", 0.5, "1000001", dynamic="yes")}))
    again = read_world(json.loads(json.dumps(world_data(made, str))), lambda _: None)
    assert again.network is not None
    assert lock_text(again) == lock_text(made)
    assert "network: {surface: asphalt" in lock_text(made)
    (tmp_path / "map.xodr").write_text(crossing((0, 90, 180)), encoding="utf-8")
    assert lock_text(load_world(str(tmp_path / "w.yaml"))) != lock_text(made)


def test_plan_shows_lanes_signals_and_stop_lines(tmp_path: Path) -> None:
    bare = draw_plan(world(tmp_path, ""))
    text = draw_plan(world(tmp_path, "", crossing(signals={180: signal("L", 0.5, "1000001", dynamic="yes")})))
    assert "lights L" in text
    assert text.count('class="signal"') == 1
    assert text.count("<path") > bare.count("<path")
    names = [item.name for item in scenery(world(tmp_path, ""))]
    assert names == ["world/ground", "world/network/lanes"]


def test_the_map_of_the_shipped_town_is_that_of_its_tool() -> None:
    from xml.etree import ElementTree

    made = load_world("town")
    tree = make_town()
    ElementTree.indent(tree)
    assert made.path is not None
    shipped = made.path.parent / "maps" / "town.xodr"
    assert shipped.read_text(encoding="utf-8") == ElementTree.tostring(tree, encoding="unicode") + "\n"
    assert made.network is not None
    rows = list(continuity(made.network))
    assert len(rows) == 48
    assert max(gap for *_, gap, _ in rows) < 1e-6
    assert {junction.rule for junction in made.network.junctions.values()} == {"lights", "priority"}
    # Vehicles on the ring have priority over those that enter.
    assert ("ring_west_on.0.-1", "ring_west_in.0.-1") in made.network.priorities


def test_heights_of_lanes_are_those_of_the_ground(tmp_path: Path) -> None:
    profile = '<elevationProfile><elevation s="0" a="1" b="0.05" c="-0.00025" d="0"/></elevationProfile>'
    banked = profile + '<lateralProfile><superelevation s="0" a="0.05" b="0" c="0" d="0"/></lateralProfile>'
    for more, slope in ((profile, 0.0), (banked, math.tan(0.05))):
        text = document(road("1", geometry(0, 0, 0, 200.0), section([lane(1)], [lane(-1), lane(-2)]), more=more))
        (tmp_path / "map.xodr").write_text(text, encoding="utf-8")
        (tmp_path / "w.yaml").write_text(
            "mirdrake: world/1\nground: {relief: [{network: {cell: 1 m}}]}\nnetwork: {xodr: map.xodr}\n",
            encoding="utf-8",
        )
        made = load_world(str(tmp_path / "w.yaml"))
        x, y = np.meshgrid(np.linspace(2.0, 198.0, 50), [-5.0, -1.75, 0.0, 1.75])
        expected = 1.0 + 0.05 * x - 0.00025 * x**2 + slope * y
        assert np.abs(made.ground.terrain.height(x, y) - expected).max() < 0.01
        again = read_world(json.loads(json.dumps(world_data(made, str))), lambda _: None)
        assert (again.ground.terrain.height(x, y) == made.ground.terrain.height(x, y)).all()


def test_a_bridge_has_no_ground(tmp_path: Path) -> None:
    high = '<elevationProfile><elevation s="0" a="6" b="0" c="0" d="0"/></elevationProfile>'
    text = document(road("1", geometry(0, 0, 0, 100.0)), road("2", geometry(50, -50, math.pi / 2, 100.0), more=high))
    (tmp_path / "map.xodr").write_text(text, encoding="utf-8")
    head = "mirdrake: world/1\nnetwork: {xodr: map.xodr}\n"
    (tmp_path / "w.yaml").write_text(f"{head}ground: {{relief: [{{network: {{}}}}]}}\n", encoding="utf-8")
    with pytest.raises(
        WorldError, match=r"w.yaml:3: ground.relief.0.network: lanes at .* differ in height by 6 m; the"
    ):
        load_world(str(tmp_path / "w.yaml"))
    (tmp_path / "w.yaml").write_text(head, encoding="utf-8")
    made = load_world(str(tmp_path / "w.yaml"))
    assert made.network is not None
    assert made.network.conflicts == ()


@pytest.mark.slow
def test_a_full_vehicle_drives_a_route_over_a_junction(tmp_path: Path) -> None:
    world(
        tmp_path, "tracks: {way: {route: {from: 180.0.1@20, to: 90.0.-1@25}}}\nstart: {a: {on_track: {track: way}}}\n"
    )
    file = tmp_path / "drive.yaml"
    file.write_text(
        "world: w.yaml\nvehicles: {ego: {model: bolt, start: a}}\n"
        "control: {ego: {kind: path_tracking, track: way, speed: 6 m/s}}\nduration: 12 s\n",
        encoding="utf-8",
    )
    run = simulate(str(file))
    signals = run.signals
    x, y = signals["ego.x"].to_numpy(), signals["ego.y"].to_numpy()
    made = load_world(str(tmp_path / "w.yaml"))
    s, offset = made.tracks["way"].project(x, y)
    assert s[-1] > 50.0  # beyond the junction: it ends 48.5 m after the start
    assert np.abs(offset).max() < 0.3
    assert made.on_road(x, y).all()


def test_dashes_are_parts_of_their_line() -> None:
    """Against the substrings of GEOS, for 200 lines with bends; and 10 000 dashes take less than a second."""
    rng, worst = np.random.default_rng(3), 0.0
    for k in range(200):
        points = np.cumsum(rng.uniform(-1.0, 3.0, (rng.integers(2, 60), 2)), axis=0)
        # Every fifth line is straight, with dashes that begin and end at its points.
        points, (dash, gap) = (points, rng.uniform(0.2, 8.0, 2)) if k % 5 else (np.arange(24.0).reshape(-1, 2), (1, 2))
        line = shapely.LineString(points)
        starts = np.arange(0.0, line.length, dash + gap)
        parts = [substring(line, start, min(start + dash, line.length)) for start in starts]
        expected = [part for part in parts if part.length > 0.01]
        found = dashes(points, float(dash), float(gap))
        assert len(found) == len(expected)
        worst = max([worst, *shapely.hausdorff_distance(found, expected)])
        np.testing.assert_allclose(shapely.length(found), shapely.length(expected), atol=1e-9)
    assert worst < 1e-9
    assert len(dashes(np.array([[0.0, 0.0], [0.005, 0.0]]), 1.0, 1.0)) == 0

    x = np.arange(0.0, 120_000.0)
    long = np.column_stack((x, 50.0 * np.sin(x / 500.0)))
    assert reference_seconds(lambda: dashes(long, 4.0, 8.0)) < 1.0


def test_nodes_beyond_the_lanes_have_the_height_of_the_nearest_point() -> None:
    """Against a search tree, by the distance, as two points can be equally near; also with columns of points."""
    rng = np.random.default_rng(4)
    for k in range(20):
        points = rng.uniform(0.0, 30.0, (rng.integers(1, 200), 2))
        points = np.round(points) if k % 2 else points
        points = points[np.lexsort((points[:, 1], points[:, 0]))]
        heights = np.where(rng.random((25, 40)) < 0.8, np.nan, -1.0)
        nodes = np.argwhere(np.isnan(heights))
        kept = heights == -1.0
        compiled(fill_from_nearest, parts=())(points, np.arange(float(len(points))), 0.9, heights)
        assert (heights[kept] == -1.0).all()
        x, y = 0.9 * nodes[:, 1], 0.9 * nodes[:, 0]
        chosen = points[heights[nodes[:, 0], nodes[:, 1]].astype(int)]
        nearest = scipy.spatial.cKDTree(points).query(np.column_stack((x, y)))[0]
        np.testing.assert_allclose(np.hypot(*(chosen - np.column_stack((x, y))).T), nearest, atol=1e-9)
