"""Import of road maps, scenarios and GPS tracks: what becomes of them, and one line for what is left out."""

import math
import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pymap3d
import pytest

from mirdrake.core.errors import ConfigError
from mirdrake.core.xml_reader import parse_xml
from mirdrake.importing.roads import import_road_world, is_road_file
from mirdrake.importing.roads.gps_tracks import _heights
from mirdrake.importing.roads.openscenario import read_scenario_world
from mirdrake.importing.roads.osc_file import Scenario, Spot, find_spot, lane_beside, lanes_between
from mirdrake.importing.roads.road_world import RoadWorld
from mirdrake.importing.worlds import WorldImport
from mirdrake.worlds import World, load_world
from mirdrake.worlds.networks.opendrive_network import read_network
from mirdrake.worlds.recorded import recorded_rows
from mirdrake.worlds.scenery import scenery
from tests.opendrive_maps import crossing, document, geometry, grid, lane, linked, road, section, signal
from tests.timing import reference_seconds


def imported(folder: Path, file: str, text: str, **options: object) -> tuple[WorldImport, World]:
    source = folder / file
    source.write_text(text, encoding="utf-8")
    result = import_road_world(source, folder=folder / "worlds", **options)  # type: ignore[arg-type]
    return result, load_world(str(result.path))


def lost(result: WorldImport) -> list[str]:
    return [f"{change.part}: {change.old}" for change in result.changes if change.left_out]


def test_opendrive_map_becomes_the_network_of_a_world_with_a_start_on_a_lane(tmp_path: Path) -> None:
    sign = signal("s", 5.0, "274.1")
    result, world = imported(tmp_path, "My Town.xodr", crossing(signals={180: sign}))
    assert result.path.name == "my_town.yaml"
    assert world.network is not None
    assert len(world.network.lanes) == 20
    assert lost(result) == ["signs of type 274.1, without effect: 1"]
    start = world.starts["road"]
    found, s, offset = world.network.locate(start.x, start.y)
    assert (s, offset) == pytest.approx((10.0, 0.0), abs=1e-3)
    assert math.cos(start.yaw - float(found.pose(s)[2])) == pytest.approx(1.0, abs=1e-6)
    with pytest.raises(ConfigError, match="exists already; choose another name, or force to replace it"):
        import_road_world(tmp_path / "My Town.xodr", folder=tmp_path / "worlds")
    import_road_world(tmp_path / "My Town.xodr", folder=tmp_path / "worlds", force=True)


def test_heights_of_a_map_with_a_bridge_are_left_out_with_a_line(tmp_path: Path) -> None:
    high = '<elevationProfile><elevation s="0" a="6" b="0" c="0" d="0"/></elevationProfile>'
    text = document(road("1", geometry(0, 0, 0, 100.0)), road("2", geometry(50, -50, math.pi / 2, 100.0), more=high))
    result, world = imported(tmp_path, "bridge.xodr", text)
    assert world.ground.terrain.flat
    (change,) = result.changes
    assert (change.part, change.new) == ("heights of the roads", "flat ground")
    assert re.fullmatch(r"lanes at \(\S+, \S+\) m differ in height by 6 m", change.old)
    # Without the bridge, the ground has the heights.
    result, world = imported(
        tmp_path, "hill.xodr", document(road("2", geometry(50, -50, math.pi / 2, 100.0), more=high))
    )
    assert float(world.ground.terrain.height(50.0, 0.0)) == pytest.approx(6.0)
    assert not result.changes


def test_the_grid_of_the_ground_fits_the_size_of_a_map(tmp_path: Path) -> None:
    slope = '<elevationProfile><elevation s="0" a="1" b="0.01" c="0" d="0"/></elevationProfile>'
    # 1.1 km x 1.1 km and 3.6 km x 3.6 km: with 1 m the larger one would have 13 million nodes.
    for length, cell in ((1500.0, "1"), (5000.0, "2")):
        result, world = imported(
            tmp_path, f"map_{cell}.xodr", document(road("1", geometry(0, 0, math.pi / 4, length), more=slope))
        )
        assert f"cell: {cell}}}" in result.path.read_text(encoding="utf-8")
        place = length / 2.0 * math.sqrt(0.5)
        assert float(world.ground.terrain.height(place, place)) == pytest.approx(1.0 + 0.01 * length / 2.0, abs=0.01)


def test_a_map_of_500_roads_is_imported_and_laid_out_within_seconds(tmp_path: Path) -> None:
    source = tmp_path / "town.xodr"
    mark = "<roadMark sOffset='0' type='broken' color='white' width='0.12'/>"
    source.write_text(grid(7, mark), encoding="utf-8")

    def lay_out() -> None:
        result = import_road_world(source, folder=tmp_path, force=True)
        assert result.entries == 596  # 84 streets with two lanes, and 428 ways
        scenery(load_world(str(result.path)))

    assert reference_seconds(lay_out, times=1) < 10.0


def test_each_element_of_a_map_that_is_not_read_has_a_line(tmp_path: Path) -> None:
    parts = (
        '<lateralProfile><shape s="0" t="0" a="0" b="0" c="0" d="0"/></lateralProfile><objects><tunnel id="t" s="1"/>'
        '<bridge id="b" s="2"><validity/></bridge></objects><surface><CRG file="a.crg"/></surface>'
        '<userData code="x"/><railroad/>'
    )
    rules = '<access rule="deny" restriction="trucks"/><height sOffset="0" inner="0.1" outer="0.1"/>'
    street = road("1", geometry(0, 0, 0, 60.0), section([lane(1, more=rules)], [lane(-1)]), more=parts, links=(
        '<predecessor elementType="road" elementId="7" contactPoint="end"/>'
    ))  # fmt: skip
    junctions = '<junction id="J" type="virtual"><connection incomingRoad="1" connectingRoad="9"/></junction>'
    station = '<station id="s"><platform id="p"/></station>'
    result, _ = imported(tmp_path, "rich.xodr", document(street, junctions, station))
    assert lost(result) == [
        "links to roads or junctions that the file does not contain: 2, first road 1 to road 7",
        "virtual junctions, whose connections begin within a road: 1",
        "elements <access>: 1",
        "elements <height> of lanes above the road, for example of kerbs: 1",
        "elements <shape>, cross-section profiles: 1",
        "elements <tunnel>: 1",
        "elements <bridge>: 1",
        "elements <surface>: 1",
        "elements <station>: 1",
    ]


def test_a_chain_of_1000_roads_without_links_of_lanes_is_read_within_seconds(tmp_path: Path) -> None:
    def links(i: int) -> str:
        return linked(f"road {i - 1} end" if i else "", f"road {i + 1} start" if i < 999 else "")

    source = tmp_path / "chain.xodr"
    source.write_text(document(*(road(str(i), geometry(20.0 * i, 0, 0, 20.0), links=links(i)) for i in range(1000))))
    lanes = read_network(source).lanes
    assert sum(len(lane.successors) for lane in lanes.values()) == 2 * 999
    assert reference_seconds(lambda: read_network(source), times=1) < 5.0


def gpx(places: np.ndarray, heights: np.ndarray | None = None) -> str:
    lat, lon, _ = pymap3d.enu2geodetic(places[:, 0], places[:, 1], 0.0, 48.0, 11.0, 0.0)
    rows = [
        f'<trkpt lat="{a:.9f}" lon="{b:.9f}">'
        + ("" if heights is None else f"<ele>{heights[i]:.2f}</ele>")
        + "</trkpt>"
        for i, (a, b) in enumerate(zip(lat, lon, strict=True))
    ]
    return "<gpx xmlns='http://www.topografix.com/GPX/1/1'><trk><trkseg>" + "\n".join(rows) + "</trkseg></trk></gpx>"


def test_exact_gpx_circle_keeps_its_length_and_closes(tmp_path: Path) -> None:
    angle = np.linspace(0.0, 2.0 * math.pi, 121)[:-1]
    places = 60.0 * np.column_stack((np.sin(angle), 1.0 - np.cos(angle)))
    result, world = imported(tmp_path, "lap.gpx", gpx(places))
    track = world.tracks["main"]
    assert track.closed
    assert track.length == pytest.approx(2.0 * math.pi * 60.0, rel=1e-4)
    assert track.min_radius == pytest.approx(60.0, rel=0.02)
    assert not any("smoothed" in (change.new or "") for change in result.changes)


def test_noisy_track_is_smoothed_by_the_smallest_amount_that_a_car_can_follow(tmp_path: Path) -> None:
    noise = np.random.default_rng(1)
    x = np.arange(0.0, 300.0, 3.0)
    places = np.column_stack((x, 10.0 * np.sin(x / 40.0))) + noise.normal(0.0, 0.5, (len(x), 2))
    result, world = imported(tmp_path, "noisy.gpx", gpx(places))
    track = world.tracks["main"]
    assert track.min_radius >= 8.0
    assert track.folds() is None
    spec = world.spec.tracks["main"].csv
    assert spec is not None
    assert 0.1 < spec.smooth < 0.8  # of the order of the noise
    assert any("smallest amount" in change.reason for change in result.changes)
    _, offset = track.project(x, 10.0 * np.sin(x / 40.0))
    assert float(np.sqrt(np.mean(np.square(offset)))) < 0.6


def test_csv_with_latitude_longitude_and_height_has_relief(tmp_path: Path) -> None:
    x = np.arange(0.0, 400.0, 4.0)
    lat, lon, _ = pymap3d.enu2geodetic(x, 0.0 * x, 0.0, 48.0, 11.0, 0.0)
    rows = [
        f"{t},{a:.9f},{b:.9f},{500.0 + 0.05 * e:.3f}" for t, a, b, e in zip(range(len(x)), lat, lon, x, strict=True)
    ]
    result, world = imported(tmp_path, "drive.csv", "time,lat,lon,alt\n" + "\n".join(rows) + "\n")
    assert world.tracks["main"].length == pytest.approx(396.0, abs=0.5)
    height = world.ground.terrain.height(np.array([100.0, 300.0]), np.array([0.0, 0.0]))
    assert float(height[1] - height[0]) == pytest.approx(10.0, abs=0.3)
    assert "width of the road, 6 m, is not in the source" in result.checks[0]


@pytest.mark.parametrize(
    ("file", "text", "message"),
    [
        ("a.csv", "x,y\n1,2\n", r"a.csv: no columns of latitude and longitude; name them lat and lon \[deg\]"),
        ("a.csv", "lat,lon\n1,2\n3,x\n", r"a.csv:3: column 'lon': 'x' is not a number"),
        ("a.csv", "lat,lon\n91,2\n", r"a.csv:2: 91, 2 deg is not a latitude and a longitude"),
        ("a.gpx", "<gpx><trk/></gpx>", "a.gpx: 0 positions; a track needs four or more"),
        (
            "a.csv",
            "lat,lon\n0,0\n0,0.0005\n0,0.0015\n0,0.002\n",
            "a.csv:4: 111.3 m from the position before; a track needs at most 100 m; record the way, or export",
        ),
        ("a.gpx", "<kml/>", "a.gpx:1: <kml> is not GPX, whose root is <gpx>"),
        ("a.xml", "<osm/>", "a.xml:1: <osm> is not CommonRoad, whose root is <commonRoad>"),
        ("a.xml", "<commonRoad/>", "a.xml:1: contains no lanelet"),
        ("a.xosc", "<OpenSCENARIO/>", "a.xosc:1: no <Storyboard>; catalogues and variations are not scenarios"),
        ("a.xodr", "<OpenDRIVE/>", "a.xodr:1: contains no road"),
    ],
)
def test_faults_of_files_have_one_line(tmp_path: Path, file: str, text: str, message: str) -> None:
    (tmp_path / file).write_text(text, encoding="utf-8")
    assert is_road_file(tmp_path / file)
    with pytest.raises(ConfigError, match=message) as error:
        import_road_world(tmp_path / file, folder=tmp_path / "worlds")
    assert "\n" not in str(error.value)
    assert not (tmp_path / "worlds").exists() or not any((tmp_path / "worlds").iterdir())


def test_the_declaration_of_an_xml_file_may_follow_a_licence() -> None:
    text = "<!-- Licence\n of <?xml?> two lines -->\n<?xml version='1.0'\n encoding='{}'?>\n<a>\n<b name='ä'/></a>"
    for encoding in ("UTF-8", "ISO-8859-1"):
        found = parse_xml(text.format(encoding).encode(encoding), "a.xodr", error=ConfigError)
        assert [(element.tag, line) for element, line in found.lines.items()] == [("a", 5), ("b", 6)]
        assert found.root[0].get("name") == "ä"
    for wrong in (b"<a/><?xml version='1.0'?>", b"<!-- --> text <?xml version='1.0'?><a/>", b"<!-- -" * 100_000):
        with pytest.raises(ConfigError, match=r"^a\.xodr:1: not valid XML"):
            parse_xml(wrong, "a.xodr", error=ConfigError)


# --- CommonRoad ---------------------------------------------------------------------------------------------------


def bound(tag: str, places: list[tuple[float, float]], mark: str = "solid") -> str:
    points = "".join(f"<point><x>{x}</x><y>{y}</y></point>" for x, y in places)
    return f"<{tag}>{points}<lineMarking>{mark}</lineMarking></{tag}>"


def lanelet(name: int, x: tuple[float, float], right: float, more: str = "", mark: str = "dashed") -> str:
    """Return a straight lanelet of 4 m width to the east, or to the west if x decreases."""
    left = right + (4.0 if x[1] > x[0] else -4.0)
    stations = np.linspace(*x, 6).tolist()
    sides = bound("leftBound", [(s, left) for s in stations], mark) + bound(
        "rightBound", [(s, right) for s in stations]
    )
    return f'<lanelet id="{name}">{sides}{more}</lanelet>'


def state(tag: str, x: float, y: float, time: int, speed: float = 0.0) -> str:
    return (
        f"<{tag}><position><point><x>{x}</x><y>{y}</y></point></position><orientation><exact>0.1</exact></orientation>"
        f"<time><exact>{time}</exact></time><velocity><exact>{speed}</exact></velocity></{tag}>"
    )


BOX = "<shape><rectangle><length>4.5</length><width>1.8</width></rectangle></shape>"
STATES = state("state", 11.0, 2.0, 1, 10.0) + state("state", 12.0, 2.1, 2, 9.5)
LIMIT = "<trafficSignID>274</trafficSignID><additionalValue>13.9</additionalValue>"
PHASES = (("red", 50), ("redYellow", 10), ("green", 30), ("yellow", 10))
CYCLE = "".join(f"<cycleElement><duration>{n}</duration><color>{c}</color></cycleElement>" for c, n in PHASES)
FIRST = (
    '<successor ref="2"/><adjacentLeft ref="3" drivingDir="same"/><trafficSignRef ref="7"/><trafficLightRef ref="8"/>'
)
PARTS = (
    lanelet(1, (0.0, 100.0), 0.0, FIRST),
    lanelet(2, (100.0, 150.0), 0.0, '<predecessor ref="1"/><laneletType>urban</laneletType>'),
    lanelet(3, (0.0, 100.0), 4.0, '<adjacentRight ref="1" drivingDir="same"/>', "solid"),
    lanelet(4, (100.0, 0.0), 12.0, "<laneletType>bicycleLane</laneletType>"),
    f'<trafficSign id="7"><trafficSignElement>{LIMIT}</trafficSignElement></trafficSign>',
    f'<trafficLight id="8"><cycle>{CYCLE}</cycle></trafficLight>',
    f'<staticObstacle id="20"><type>parkedVehicle</type>{BOX}{state("initialState", 60.0, 6.0, 0)}</staticObstacle>',
    f'<dynamicObstacle id="30"><type>car</type>{BOX}{state("initialState", 10.0, 2.0, 0, 10.0)}',
    f"<trajectory>{STATES}</trajectory></dynamicObstacle>",
    f'<planningProblem id="40">{state("initialState", 5.0, 2.0, 0, 8.0)}',
    '<goalState><position><lanelet ref="2"/></position></goalState></planningProblem>',
)
COMMONROAD = '<commonRoad timeStepSize="0.1" commonRoadVersion="2020a">' + "\n".join(PARTS) + "</commonRoad>"


def test_commonroad_lanelets_obstacles_goals_and_recorded_traffic(tmp_path: Path) -> None:
    result, world = imported(tmp_path, "ZAM_Test-1_1_T-1.xml", COMMONROAD)
    network = world.network
    assert network is not None
    first = network.lanes["1"]
    assert first.length == pytest.approx(100.0)
    assert (first.width[0], first.left, first.successors) == (4.0, "3", ("2",))
    assert first.speed_limit == pytest.approx(13.9)
    assert (first.change, network.lanes["3"].change) == ("left", "none")
    assert network.lanes["4"].kind == "biking"
    assert float(network.lanes["4"].yaw[0]) == pytest.approx(math.pi)
    assert [(line.lane, line.s, line.kind, line.signal) for line in network.stop_lines] == [
        ("1", 100.0, "lights", "light_8")
    ]
    (prop,) = world.props
    assert prop.X_WP.translation()[:2] == pytest.approx([60.0, 6.0])
    assert prop.prop.size == pytest.approx((4.5, 1.8, 1.5))
    assert world.starts["p40"].speed == pytest.approx(8.0)
    area = world.goals["p40"].area
    assert area is not None
    assert (area.centroid.x, area.centroid.y) == pytest.approx((125.0, 2.0))
    table = (result.path.parent / result.path.stem / "recorded" / "30.csv").read_text().splitlines()
    assert table[0] == "t_s,x_m,y_m,yaw_rad,speed_m_s"
    assert [float(cell) for cell in table[3].split(",")] == pytest.approx([0.2, 12.0, 2.1, 0.1, 9.5])
    (actor,) = world.actors
    assert (actor.name, actor.prop.name) == ("o30", "sedan")
    # At 0.2 s its middle is where the file says, and its frame behind it.
    assert actor.spec.recorded is not None
    assert actor.spec.recorded.rows[2] == pytest.approx((0.2, 12.0, 2.1, 0.1))
    x, y, yaw = 12.0 - actor.rear_axle * math.cos(0.1), 2.1 - actor.rear_axle * math.sin(0.1), 0.1
    assert recorded_rows(actor.spec, actor.rear_axle)[2, 1:4] == pytest.approx([x, y, yaw])
    assert lost(result) == []
    # Green of 30 steps of 0.1 s begins 60 steps after the start, and the cycle takes 100 steps.
    light = world.spec.signals["light_8"]
    assert (light.programme.green, light.programme.amber, light.programme.red) == pytest.approx((3.0, 1.0, 6.0))
    assert light.offset == pytest.approx(4.0)


def test_commonroad_planning_problems_are_tests(tmp_path: Path) -> None:
    goal = '<lanelet ref="2"/></position>'
    timed = COMMONROAD.replace(
        goal, f"{goal}<time><intervalStart>10</intervalStart><intervalEnd>150</intervalEnd></time>"
    )
    _, world = imported(tmp_path, "timed.xml", timed)
    (test,) = world.spec.tests
    assert (test.name, test.start, test.goal) == ("p40", "p40", "p40")
    assert test.duration == pytest.approx(15.0)
    # The route begins on lane 1 and ends on lane 2, whose middle at 125 m is the goal.
    track = world.tracks["p40_route"]
    s, offset = track.project(np.array([5.0, 125.0]), np.array([2.0, 2.0]))
    np.testing.assert_allclose(offset, 0.0, atol=0.01)
    assert track.length > s[1] + 15.0
    # Lane 4 is opposite, and no lane leads to it.
    result, world = imported(tmp_path, "apart.xml", COMMONROAD.replace(goal, '<lanelet ref="4"/></position>'))
    assert not world.spec.tests
    assert lost(result) == ["test of p40: "]


def test_commonroad_lights_without_a_line_of_their_own_are_left_out(tmp_path: Path) -> None:
    light = COMMONROAD[COMMONROAD.index("<trafficLight ") : COMMONROAD.index("<staticObstacle")]
    second = light.replace('id="8"', 'id="9"') + light.replace('id="8"', 'id="10"')
    text = COMMONROAD.replace(light, light + second).replace(
        '<trafficLightRef ref="8"/>', 2 * '<trafficLightRef ref="8"/>'
    )
    text = text.replace('<trafficLightRef ref="8"/>', '<trafficLightRef ref="9"/>', 1)
    result, world = imported(tmp_path, "lights.xml", text)
    assert list(world.lights) == ["light_8"]
    assert lost(result) == ["cycle of light 'light_9': ", "cycle of light 'light_10': "]


# --- OpenSCENARIO -------------------------------------------------------------------------------------------------

THREE_LANES = document(
    road(
        "0", geometry(0.0, 0.0, 0.0, 1000.0), section(right=[lane(-1, "border", 2.0), *(lane(n) for n in (-2, -3, -4))])
    )
)

SCENARIO = (Path(__file__).parent / "cut_in.xosc").read_text(encoding="utf-8")


def scenario(folder: Path, text: str = SCENARIO, map_text: str = THREE_LANES) -> RoadWorld:
    (folder / "road.xodr").write_text(map_text, encoding="utf-8")
    (folder / "cut_in.xosc").write_text(text, encoding="utf-8")
    return read_scenario_world(folder / "cut_in.xosc", "cut_in")


def block(made: RoadWorld, key: str) -> list[str]:
    """Return the lines of a block of the world file."""
    match = re.search(rf"^{key}:\n((?:  .*\n)+)", made.text, re.MULTILINE)
    return [] if match is None else [line.strip() for line in match[1].splitlines()]


def test_openscenario_positions_and_speeds(tmp_path: Path) -> None:
    made = scenario(tmp_path)
    # Lane -3 is from 5.5 to 9 m right of the reference line; the offset is to its left.
    assert block(made, "start") == ["ego: {at: [5, -6.75], yaw: 0 deg, speed: 16.5}"]
    # One lane to the right and 85 m ahead; the pose of an actor is that of its rear axle.
    assert block(made, "actors") == [
        "- {actor: sedan, name: other, on_lane: {lane: 0.0.-4, s: 90, offset: 0}, speed: 11}"
    ]
    assert block(made, "props") == ["- {box: [0.6, 0.7, 1], name: barrel, at: [300, -7], yaw: 28.6479 deg}"]
    assert block(made, "tracks") == ["ego_lane: {route: {from: 0.0.-3@0, to: 0.0.-3@1000}}"]
    assert "duration: 40 s" in block(made, "tests")


def test_openscenario_lists_what_is_no_step(tmp_path: Path) -> None:
    changes = [change for change in scenario(tmp_path).changes if change.left_out]
    lines = [f"{change.part}: {change.old}" for change in changes]
    assert "entity 'Lost': car" in lines
    assert "action on 'Ego' at the beginning: ActivateControllerAction" in lines
    (cut_in,) = [change for change in changes if change.part == "'CutIn' of Other"]
    assert cut_in.reason == "a condition of a step has no delay"
    for part in (
        "LaneChangeActionDynamics dynamicsShape=sinusoidal value=2.0 dynamicsDimension=rate",
        "TimeHeadwayCondition entityRef=Other value=1.5 rule=lessThan of Ego, rising edge, 0.5 s later",
    ):
        assert part in cut_in.old


HEADWAY = '<TimeHeadwayCondition entityRef="Other" value="1.5" rule="lessThan"/>'
DISTANCE = (
    '<RelativeDistanceCondition entityRef="Other" relativeDistanceType="longitudinal" value="30" freespace="{}" '
    'rule="lessThan"/>'
)
AFTER = "<SimulationTimeCondition value='4' rule='greaterThan'/>"


def test_openscenario_lists_all_that_it_does_not_read(tmp_path: Path) -> None:
    rain = "<GlobalAction><EnvironmentAction><Environment name='rain'/></EnvironmentAction></GlobalAction>"
    text = (
        SCENARIO.replace(
            "<Storyboard>", "<VariableDeclarations><VariableDeclaration name='v'/></VariableDeclarations><Storyboard>"
        )
        .replace("<Actions>", f"<Actions>{rain}", 1)
        .replace("</Entities>", "<EntitySelection name='all'><Members/></EntitySelection></Entities>")
        .replace("<ManeuverGroup", "<ManeuverGroup maximumExecutionCount='3'", 1)
    )
    made = scenario(tmp_path, text)
    lines = {f"{change.part}: {change.old}" for change in made.changes}
    assert "EnvironmentAction at the beginning: Environment" in lines
    assert {"elements <EntitySelection>: 1", "elements <VariableDeclarations>: 1"} <= lines
    assert any(re.fullmatch(r"'.*' of Other: repetitions: 3", line) for line in lines)


@pytest.mark.parametrize(
    ("condition", "expected"),
    [
        # 1.5 s behind at 16.5 m/s and 3.5 m beside: sqrt(24.75² + 3.5²) / 16.5 s, less 0.5 m of the lateral offset.
        (HEADWAY, f"when: ego within {math.hypot(24.75, 4.0) / 16.5:.4f}".rstrip("0") + " s"),
        (DISTANCE.format("false"), f"when: ego within {math.hypot(30.0, 4.0):.4f} m"),
        # Front of the ego (2.25 + 1.35 m) and rear of the other (2.4 - 1.4 m) are within the boxes.
        (DISTANCE.format("true"), f"when: ego within {math.hypot(34.6, 4.0):.4f} m"),
        (AFTER, "at: 4 s"),
    ],
)
def test_openscenario_triggers_become_triggers_of_steps(tmp_path: Path, condition: str, expected: str) -> None:
    text = SCENARIO.replace('delay="0.5"', 'delay="0"').replace(HEADWAY, condition)
    # The rate of a sinusoidal lane change is its peak: 3.5 m take π/2 · 3.5 / 2 s.
    assert block(scenario(tmp_path, text), "scenario") == ["other:", f"- {{{expected}, change_lane: left in 2.7489 s}}"]


def test_openscenario_speed_actions_become_rates(tmp_path: Path) -> None:
    action = re.search(r"<LateralAction>.*</LateralAction>", SCENARIO, re.DOTALL)
    assert action is not None
    text = SCENARIO.replace('delay="0.5"', 'delay="0"').replace(HEADWAY, AFTER)

    def step(shape: str, dimension: str, value: float) -> str:
        target = '<SpeedActionTarget><AbsoluteTargetSpeed value="3"/></SpeedActionTarget>'
        dynamics = f'<SpeedActionDynamics dynamicsShape="{shape}" value="{value}" dynamicsDimension="{dimension}"/>'
        new = f"<LongitudinalAction><SpeedAction>{dynamics}{target}</SpeedAction></LongitudinalAction>"
        return block(scenario(tmp_path, text.replace(action[0], new)), "scenario")[1]

    # From 11 to 3 m/s: in 4 s, over 28 m (11² - 3² = 2 a 28), at a rate, at once.
    assert step("linear", "time", 4.0) == "- {at: 4 s, change_speed: {to: 3, rate: 2}}"
    assert step("linear", "distance", 28.0) == "- {at: 4 s, change_speed: {to: 3, rate: 2}}"
    assert step("linear", "rate", 6.0) == "- {at: 4 s, change_speed: {to: 3, rate: 6}}"
    assert step("step", "time", 0.0) == "- {at: 4 s, change_speed: {to: 3, rate: 50}}"


def test_openscenario_headings_are_absolute_unless_they_are_relative(tmp_path: Path) -> None:
    scenario(tmp_path)
    map_file = tmp_path / "turned.xodr"
    map_file.write_text(document(road("0", geometry(0.0, 0.0, 1.0, 100.0))), encoding="utf-8")
    source, network = Scenario(tmp_path / "cut_in.xosc"), read_network(map_file)
    other = {"Ego": Spot((0.0, 0.0, 0.3), "0.0.-1", 5.0)}

    def yaw(position: str, turn: str) -> float:
        element = ElementTree.fromstring(f"<Position>{position.format(turn)}</Position>")
        spot = find_spot(source, element, network, other)
        assert spot is not None
        return spot.pose[2]

    on_lane = '<LanePosition roadId="0" laneId="-1" s="5">{}</LanePosition>'
    beside = '<RelativeLanePosition entityRef="Ego" dLane="0" ds="10">{}</RelativeLanePosition>'
    near = '<RelativeObjectPosition entityRef="Ego" dx="1" dy="0">{}</RelativeObjectPosition>'
    for position, base in ((on_lane, 1.0), (beside, 1.0), (near, 0.3)):
        assert yaw(position, "") == pytest.approx(base)
        assert yaw(position, '<Orientation type="relative" h="0.2"/>') == pytest.approx(base + 0.2)
        assert yaw(position, '<Orientation type="absolute" h="0.2"/>') == pytest.approx(0.2)
        assert yaw(position, '<Orientation h="0.2"/>') == pytest.approx(0.2)


def test_openscenario_lanes_are_counted_without_a_lane_0() -> None:
    numbers = [-3, -2, -1, 1, 2, 3]
    for i, number in enumerate(numbers):
        for j, other in enumerate(numbers):
            assert lane_beside(number, j - i) == other
            assert lanes_between(number, other) == j - i


def test_openscenario_lane_change_to_the_other_direction_is_reported_as_such(tmp_path: Path) -> None:
    text = SCENARIO.replace('delay="0.5"', 'delay="0"').replace('laneId="-3"', 'laneId="-1"').replace("$lane", "0")
    text = text.replace('<RelativeTargetLane entityRef="Ego" value="0"/>', '<AbsoluteTargetLane value="WANTED"/>')
    lanes = section([lane(1)], [lane(-1), lane(-2)])
    map_text = document(road("0", geometry(0.0, 0.0, 0.0, 1000.0), lanes))
    for target, reason in (("1", "the target is one of the other"), ("3", "the target is 3 lanes away")):
        made = scenario(tmp_path, text.replace("WANTED", target), map_text)
        reason_given = next(c.reason for c in made.changes if c.part == "'CutIn' of Other" and c.left_out)
        assert reason_given.endswith(reason)
    assert "change_lane: right" in block(scenario(tmp_path, text.replace("WANTED", "-2"), map_text), "scenario")[1]


def test_openscenario_track_ends_on_its_lane_also_where_a_rounded_length_would_not(tmp_path: Path) -> None:
    short = document(road("0", geometry(0.0, 0.0, 0.0, 114.25636)))
    text = SCENARIO.replace('laneId="-3" s="5"', 'laneId="-1" s="5"')
    (track,) = block(scenario(tmp_path, text, short), "tracks")
    assert track == "ego_lane: {route: {from: 0.0.-1@0, to: 0.0.-1@114.2563}}"
    world = import_road_world(tmp_path / "cut_in.xosc", folder=tmp_path / "worlds")
    assert list(load_world(str(world.path)).starts) == ["ego"]


def test_openscenario_entities_have_the_values_of_parameters_of_the_file_and_of_their_catalogue(tmp_path: Path) -> None:
    (tmp_path / "road.xodr").write_text(document(road("0", geometry(0.0, 0.0, 0.0, 100.0))), encoding="utf-8")
    box = '<BoundingBox><Center x="$middle"/><Dimensions length="$length" width="2" height="1.5"/></BoundingBox>'
    own = '<ParameterDeclarations><ParameterDeclaration name="{}" value="{}"/></ParameterDeclarations>'
    entry = f'<Vehicle name="bus" vehicleCategory="bus">{own.format("length", 12)}{box}</Vehicle>'
    (tmp_path / "bus.xosc").write_text(f"<OpenSCENARIO><Catalog>{entry}</Catalog></OpenSCENARIO>", encoding="utf-8")
    assigned = '<ParameterAssignments><ParameterAssignment parameterRef="length" value="$long"/></ParameterAssignments>'
    file = f"""<OpenSCENARIO>
      <ParameterDeclarations>
        <ParameterDeclaration name="what" value="van"/><ParameterDeclaration name="long" value="9"/>
        <ParameterDeclaration name="length" value="5"/><ParameterDeclaration name="middle" value="1.5"/>
      </ParameterDeclarations>
      <CatalogLocations><VehicleCatalog><Directory path="."/></VehicleCatalog></CatalogLocations>
      <Entities>
        <ScenarioObject name="a"><Vehicle vehicleCategory="$what">{box}</Vehicle></ScenarioObject>
        <ScenarioObject name="b"><CatalogReference catalogName="c" entryName="bus"/></ScenarioObject>
        <ScenarioObject name="c">
          <CatalogReference catalogName="c" entryName="bus">{assigned}</CatalogReference></ScenarioObject>
      </Entities><Storyboard/></OpenSCENARIO>"""
    (tmp_path / "file.xosc").write_text(file, encoding="utf-8")
    found = [(one.kind, one.size[0], one.middle) for one in Scenario(tmp_path / "file.xosc").entities()]
    assert found == [("van", 5.0, 1.5), ("bus", 12.0, 1.5), ("bus", 9.0, 1.5)]


def test_openscenario_test_of_an_ego_at_the_end_of_its_lane_has_no_track(tmp_path: Path) -> None:
    short = document(road("0", geometry(0.0, 0.0, 0.0, 1.0)))
    text = SCENARIO.replace('laneId="-3" s="5"', 'laneId="-1" s="0.5"')
    made = scenario(tmp_path, text, short)
    assert block(made, "tracks") == []
    assert "behaviour: {kind: blind}" in block(made, "tests")
    (tmp_path / "cut_in").mkdir()
    for name, content in made.files.items():
        (tmp_path / "cut_in" / name).write_bytes(content)
    (tmp_path / "cut_in.yaml").write_text(made.text, encoding="utf-8")
    assert list(load_world(str(tmp_path / "cut_in.yaml")).starts) == ["ego"]


def test_openscenario_names_a_parameter_or_map_that_is_missing(tmp_path: Path) -> None:
    (tmp_path / "cut_in.xosc").write_text(SCENARIO, encoding="utf-8")
    with pytest.raises(ConfigError, match=r"cut_in.xosc:8: no such file: 'road.xodr'; put the road network where"):
        read_scenario_world(tmp_path / "cut_in.xosc", "cut_in")
    with pytest.raises(ConfigError, match=r"cut_in.xosc:\d+: unknown parameter 'sped' in value; did you mean 'speed'"):
        scenario(tmp_path, SCENARIO.replace("${speed}", "$sped"))


@pytest.mark.parametrize(
    ("expression", "fault"),
    [
        ("${$speed * (1 + $share)}", ""),
        ("${$speed * 10 ..20}", "is not arithmetic on parameters"),
        ("${round($speed)}", "'round' is not a number"),
        ("${$speed / $sped}", "unknown parameter 'sped' in value; did you mean 'speed'"),
        ("${$speed / 0}", "division by zero"),
    ],
)
def test_openscenario_expressions_are_arithmetic_on_parameters(tmp_path: Path, expression: str, fault: str) -> None:
    share = '<ParameterDeclaration name="share" parameterType="double" value="${1 / (1 + 1)}"/></ParameterDeclarations>'
    text = SCENARIO.replace("${speed}", expression).replace("</ParameterDeclarations>", share)
    if fault:
        with pytest.raises(ConfigError, match=re.escape(fault)):
            scenario(tmp_path, text)
        return
    plain = block(scenario(tmp_path, SCENARIO), "start")
    value = re.compile(r"speed: ([\d.]+)")
    (before,), (after,) = (value.findall("".join(rows)) for rows in (plain, block(scenario(tmp_path, text), "start")))
    assert float(after) == pytest.approx(1.5 * float(before), rel=1e-6)


def test_heights_of_a_closed_track_are_averaged_across_its_joint() -> None:
    angle = np.linspace(0.0, 2.0 * math.pi, 241)[:-1]
    places, length = 100.0 * np.column_stack((np.cos(angle), np.sin(angle))), 200.0 * math.pi
    rows = re.findall(r"\[([^,\]]+), ([^\]]+)\]", _heights(places, 5.0 * np.sin(angle), length, closed=True))
    at, height = np.array(rows, dtype=float).T
    # The mean of a sine over a window keeps its phase, so that heights stay antisymmetric about the joint.
    np.testing.assert_allclose(height[1:], -height[:0:-1], atol=2e-3)
    # Trapezoids over 17 points of 5 m: the mean of cosines about the middle scales the sine.
    scale = np.cos(np.linspace(-40.0, 40.0, 17) / 100.0).mean()
    np.testing.assert_allclose(height, 5.0 * scale * np.sin(at / 100.0), atol=5e-3)
