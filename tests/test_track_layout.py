"""Tracks of world files: from segments, points, CSV files and OpenDRIVE roads, with varying widths."""

import base64
import itertools
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pandas
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from mirdrake.assembly.diagram import assemble, make_spec
from mirdrake.controllers.drivable_line import DrivingLimits, make_centre_line, make_drivable_line
from mirdrake.core.errors import ConfigError, WorldError
from mirdrake.report.vehicle_charts import VehicleSignals, make_charts
from mirdrake.report.words import format_quantity
from mirdrake.runs.simulation import Simulation
from mirdrake.worlds import Track, World, load_world
from mirdrake.worlds.scenery import scenery
from mirdrake.worlds.spec import TrackSpec
from mirdrake.worlds.track_layout import make_track
from tests.test_centre_lines import circuit
from tests.timing import reference_seconds

CIRCUIT_LENGTH = 4000.0


def write(folder: Path, text: str, **files: str) -> Path:
    """Return a world file with a track, and files beside it; `csv` becomes track.csv."""
    for suffix, content in files.items():
        (folder / f"track.{suffix}").write_text(content)
    path = folder / "w.yaml"
    path.write_text(f"mirdrake: world/1\n{text}\n")
    return path


def track_of(folder: Path, entry: str, **files: str) -> Track:
    return load_world(str(write(folder, f"tracks: {{main: {{{entry}}}}}", **files))).tracks["main"]


def message(folder: Path, monkeypatch: pytest.MonkeyPatch, text: str, **files: str) -> str:
    monkeypatch.chdir(folder)
    with pytest.raises((ConfigError, WorldError)) as caught:
        load_world(str(write(folder, text, **files)))
    reported = str(caught.value)
    assert "\n" not in reported
    return reported


def circuit_csv(spacing: float = 1.0) -> str:
    """Return a circuit of 4 km whose width goes from 7 to 11 m."""
    points = circuit(CIRCUIT_LENGTH, spacing)
    angles = 2 * np.pi * np.arange(len(points)) / len(points)
    rows = np.column_stack((points, 4.0 + np.sin(angles), 5.0 + np.cos(3 * angles)))
    return "# x_m,y_m,w_tr_right_m,w_tr_left_m\n" + "\n".join(",".join(f"{v:.6f}" for v in row) for row in rows) + "\n"


CIRCUIT = """
ground: {surface: grass}
tracks:
  main:
    csv: track.csv
    verge: gravel
    markings: [{line: left}, {line: right}, {line: center, kind: dashed}, {line: start, width: 0.4}]
start: {line: {on_track: {track: main, s: 0}}}"""


@pytest.fixture(scope="module")
def circuit_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("circuit"), CIRCUIT, csv=circuit_csv())


# --- segments -----------------------------------------------------------------------------------------------------


def test_the_length_of_segments_is_their_closed_form(tmp_path: Path):
    # Two clothoids of 20 deg at each bend of 90 deg, so 2 R 20 deg long each, and an arc of R 50 deg between.
    bend = 2 * (2 * 20.0 * math.radians(20)) + 20.0 * math.radians(50)
    spiral = 2 * math.radians(25) / (1 / 30.0 + 1 / 12.0)  # turns by its length times the mean curvature
    track = track_of(
        tmp_path,
        "segments: [{line: 40}, {arc: {radius: 20, angle: 90 deg, transition: 20 deg}}, {line: 15},"
        " {clothoid: {from_radius: -30, to_radius: -12, angle: -25 deg}}, {arc: {radius: 12, angle: -100 deg}}]",
    )
    assert track.length == pytest.approx(55.0 + bend + spiral + 12.0 * math.radians(100), rel=1e-9)
    x, y = track.point(np.linspace(0.0, track.length, 200_001))
    assert np.hypot(np.diff(x), np.diff(y)).sum() == pytest.approx(track.length, rel=1e-6)


def test_curvature_is_continuous_where_clothoids_join(tmp_path: Path):
    track = track_of(
        tmp_path,
        "segments: [{line: 30}, {clothoid: {to_radius: 25, length: 20}}, {arc: {radius: 25, angle: 40 deg}},"
        " {clothoid: {from_radius: 25, to_radius: -40, length: 35}},"
        " {clothoid: {from_radius: -40, length: 15}}, {line: 10},"
        " {arc: {radius: 9, angle: 60 deg, transition: 30 deg}}]",
    )
    joints = track.knots[1:-1]
    assert len(joints) == 7
    assert track.curvature(joints + 1e-9) == pytest.approx(track.curvature(joints - 1e-9), abs=1e-9)
    fine = np.arange(0.0, track.length, 1e-3)
    steepest = (1 / 9) / (2 * 9 * math.radians(30))  # of the last clothoids
    assert np.abs(np.diff(track.curvature(fine))).max() <= 1e-3 * steepest * (1 + 1e-6)


# --- points -------------------------------------------------------------------------------------------------------


def test_points_of_a_circle_are_the_circle(tmp_path: Path):
    angle = 2 * np.pi * np.arange(24) / 24
    points = np.column_stack((100.0 + 30.0 * np.cos(angle), 30.0 * np.sin(angle))).tolist()
    track = track_of(tmp_path, f"points: {points}, closed: true, width: 6")
    assert track.length == pytest.approx(60.0 * math.pi, rel=1e-9)
    assert shapely.area(track.area) == pytest.approx(math.pi * (33.0**2 - 27.0**2), rel=1e-4)
    assert track.pose_at(0.0) == pytest.approx((130.0, 0.0, math.pi / 2), abs=1e-9)


def test_an_open_row_of_points_begins_at_the_first_and_ends_at_the_last(tmp_path: Path):
    track = track_of(tmp_path, "points: [[0, 0], [20, 1], [40, 5], [60, 4], [80 m, 0]]")
    assert not track.closed
    assert track.pose_at(0.0)[:2] == pytest.approx((0.0, 0.0), abs=1e-6)
    assert track.pose_at(track.length)[:2] == pytest.approx((80.0, 0.0), abs=1e-6)
    assert track.project(40.0, 5.0)[1] == pytest.approx(0.0, abs=1e-3)
    assert track.width == 3.0


def test_a_start_moves_a_track_of_points(tmp_path: Path):
    points = "[[0, 0], [20, 0], [40, 0], [60, 0]]"
    track = track_of(tmp_path, f"points: {points}, start: {{at: [5, 6], yaw: 90 deg}}")
    assert track.pose_at(60.0) == pytest.approx((5.0, 66.0, math.pi / 2), abs=1e-9)


# --- CSV files ----------------------------------------------------------------------------------------------------


def test_a_circuit_of_4_km_has_the_widths_of_its_file(circuit_file: Path):
    track = load_world(str(circuit_file)).tracks["main"]
    assert track.closed
    assert track.length == pytest.approx(CIRCUIT_LENGTH, rel=1e-4)
    s = np.arange(0.0, 3999.0, 7.0)
    angles = 2 * np.pi * s / CIRCUIT_LENGTH
    assert track.right_width(s) == pytest.approx(4.0 + np.sin(angles), abs=0.01)
    assert track.left_width(s) == pytest.approx(5.0 + np.cos(3 * angles), abs=0.01)


def test_a_circuit_of_4_km_is_built_with_its_scenery_within_2_seconds(circuit_file: Path):
    assert reference_seconds(lambda: scenery(load_world(str(circuit_file)))) < 2.0


def test_columns_scale_and_smoothing_are_passed_on(tmp_path: Path):
    angle = 2 * np.pi * np.arange(200) / 200
    noise = np.random.default_rng(1).normal(0.0, 5.0, (200, 2))
    rows = np.column_stack((5000 * np.cos(angle), 5000 * np.sin(angle))) + noise  # in cm, 5 cm of noise
    text = "east north wl wr\n" + "\n".join(f"{x} {y} 300 200" for x, y in rows)
    entry = "csv: {file: track.csv, x: east, y: 2, left: wl, right: wr, scale: 0.01, smooth: 7 cm}"
    track = track_of(tmp_path, entry, csv=text)
    assert track.closed
    assert track.length == pytest.approx(100 * math.pi, rel=3e-3)
    assert track.min_radius > 40.0
    assert track.left_width(50.0) + track.right_width(50.0) == pytest.approx(5.0)
    assert track.left_width(50.0) == pytest.approx(3.0, abs=0.3)


def test_a_width_of_the_world_file_is_taken_instead_of_the_files(tmp_path: Path):
    track = track_of(tmp_path, "csv: track.csv, width: 4", csv=circuit_csv(10.0))
    assert track.edges is None
    assert track.width == 4.0


def test_a_csv_file_is_looked_for_beside_the_world_file_wherever_one_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    (tmp_path / "worlds").mkdir()
    (tmp_path / "lines").mkdir()
    (tmp_path / "lines" / "line.csv").write_text(circuit_csv(10.0))
    path = write(tmp_path / "worlds", "tracks: {main: {csv: ../lines/line.csv}}")
    monkeypatch.chdir("/")
    assert load_world(str(path)).tracks["main"].closed


@pytest.mark.parametrize("closed", [True, False])
def test_the_key_closed_overrides_the_file(tmp_path: Path, closed: bool):
    track = track_of(tmp_path, f"csv: track.csv, closed: {str(closed).lower()}", csv=circuit_csv(10.0))
    assert track.closed == closed
    assert track.length == pytest.approx(CIRCUIT_LENGTH - (0.0 if closed else 10.0), rel=1e-3)


# --- OpenDRIVE ----------------------------------------------------------------------------------------------------

ROAD = """<?xml version="1.0"?>
<OpenDRIVE><header revMajor="1" revMinor="7"/>
<road name="ring" id="7" junction="-1" length="1"><planView>
<geometry s="0" x="500" y="0" hdg="0" length="188.49555921538757"><arc curvature="0.03333333333333333"/></geometry>
</planView><lanes><laneSection s="0"><left><lane id="1" type="driving">
<width sOffset="0" a="3" b="0" c="0" d="0"/></lane></left><center><lane id="0" type="none"/></center>
<right><lane id="-1" type="driving"><width sOffset="0" a="4" b="0" c="0" d="0"/></lane></right></laneSection></lanes>
<signals><signal id="1"/></signals></road></OpenDRIVE>
"""


def test_a_road_of_an_opendrive_file_is_a_track(tmp_path: Path):
    for entry in ("xodr: track.xodr", "xodr: {file: track.xodr, road: 7, lane: driving}"):
        track = track_of(tmp_path, entry, xodr=ROAD)
        assert track.closed
        assert track.length == pytest.approx(60 * math.pi)
        assert (float(track.left_width(50.0)), float(track.right_width(50.0))) == (3.0, 4.0)
        assert track.pose_at(0.0) == pytest.approx((500.0, 0.0, 0.0))
        assert track.notes == ("signals: 1",)
    lane_track = track_of(tmp_path, "xodr: {file: track.xodr, lane: -1}, start: {at: [0, 0]}", xodr=ROAD)
    assert lane_track.width == pytest.approx(4.0)
    assert lane_track.length == pytest.approx(2 * math.pi * 32.0)
    assert lane_track.pose_at(0.0) == pytest.approx((0.0, 0.0, 0.0))


# --- varying widths -----------------------------------------------------------------------------------------------

TAPER = "segments: [{line: 100}], width: [[0, 4], [40, 4], [60, 8], [100, 8]]"


def test_a_width_may_be_given_at_places_along_the_track(tmp_path: Path):
    track = track_of(tmp_path, TAPER)
    assert track.left_width([0.0, 40.0, 50.0, 60.0, 100.0]).tolist() == [2.0, 2.0, 3.0, 4.0, 4.0]
    assert shapely.area(track.area) == pytest.approx(40 * 4 + 20 * 6 + 40 * 8)
    assert track.inside([20.0, 20.0, 80.0], [1.9, 2.1, 2.1]).tolist() == [True, False, True]


def test_the_widths_of_a_closed_track_go_on_from_the_last_place_to_the_first(tmp_path: Path):
    circle = "segments: [{arc: {radius: 50, angle: 360 deg}}], closed: true, length: 300"
    track = track_of(tmp_path, f"{circle}, width: [[50, 4], [250, 8]]")
    assert track.left_width([50.0, 150.0, 250.0, 0.0, 299.999999]) == pytest.approx([2.0, 3.0, 4.0, 3.0, 3.0])
    assert track_of(tmp_path, f"{circle}, width: [[0, 4], [150, 6], [300, 4]]").left_width(299.0) < 2.02


def test_edge_lines_follow_the_edges(tmp_path: Path):
    text = f"tracks: {{main: {{{TAPER}, markings: [{{line: left, width: 0.2}}, {{line: right, kind: dashed}}]}}}}"
    items = {item.name: item for item in scenery(load_world(str(write(tmp_path, text))))}
    corners = vertices(items["world/main/lines"])
    assert corners[corners[:, 0] < 40.0, 1].max() == pytest.approx(1.95, abs=1e-6)
    assert corners[corners[:, 0] > 60.0, 1].max() == pytest.approx(3.95, abs=1e-6)
    assert corners[corners[:, 0] < 40.0, 1].min() == pytest.approx(-1.95, abs=1e-6)
    assert corners[corners[:, 0] > 61.0, 1].min() == pytest.approx(-3.95, abs=1e-6)


def test_friction_and_road_end_at_the_edge_of_the_road(tmp_path: Path):
    loaded = load_world(str(write(tmp_path, f"ground: {{surface: grass}}\ntracks: {{main: {{{TAPER}}}}}")))
    assert loaded.mu([20.0, 20.0, 80.0, 80.0], [1.9, 2.1, 3.9, 4.1]).tolist() == [0.85, 0.5, 0.85, 0.5]
    assert loaded.on_road([20.0, 20.0, 80.0], [1.9, 2.1, 3.9]).tolist() == [True, False, True]


def test_a_start_must_be_on_the_road_as_wide_as_it_is_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def text(s: float, offset: float) -> str:
        return f"tracks: {{main: {{{TAPER}}}}}\nstart: {{a: {{on_track: {{track: main, s: {s}, offset: {offset}}}}}}}"

    assert load_world(str(write(tmp_path, text(80, 3.9)))).starts["a"].y == 3.9
    assert message(tmp_path, monkeypatch, text(20, 2.1)) == (
        "w.yaml:3: start.a.on_track.offset: start outside the world: 2.1 m beside the centre line; the edge of the "
        "road is 2 m away there; make the offset at most that"
    )


def test_props_regions_and_rules_are_relative_to_the_edge_of_the_road(tmp_path: Path):
    text = f"""
tracks: {{main: {{{TAPER}}}}}
ground:
  patches: [{{name: all, mu: 0.3, band: {{track: main}}}}, {{name: end, mu: 0.2, band: {{track: main, s: [50, 70]}}}}]
props: [{{box: [0.2, 0.2, 1], along: {{track: main, s: [0, 100], count: 11, side: both, distance: 1}}}}]
rules: [{{keep_clear: {{track: main, margin: 0.5}}}}]"""
    loaded = load_world(str(write(tmp_path, text)))
    places = np.array([prop.X_WP.translation()[:2] for prop in loaded.props])
    assert len(places) == 22
    expected = np.interp(places[:, 0], [0, 40, 60, 100], [3.0, 3.0, 5.0, 5.0])
    assert np.abs(places[:, 1]) == pytest.approx(expected)
    areas = {patch.name: patch.area for patch in loaded.patches}
    assert areas["all"].area == pytest.approx(600.0)
    assert areas["end"].area == pytest.approx(10 * 7 + 10 * 8)


def test_the_edges_are_as_far_apart_as_the_width(circuit_file: Path):
    (track,) = load_world(str(circuit_file)).tracks.values()
    assert track.edges is not None
    s = track.stations(sagitta=0.01)
    left, right = (np.column_stack(track.point(s, offset)) for offset in (track.left_width(s), -track.right_width(s)))
    gap = np.hypot(*(left - right).T)
    assert (gap.min(), gap.max()) == pytest.approx((7.1, 10.9), abs=0.1)


def test_the_chart_of_the_lateral_error_shows_edges_that_vary():
    time = np.linspace(0.0, 10.0, 50)
    frame = pandas.DataFrame({"ego.lateral_error": 0.5 * np.sin(time)}, index=time)
    edges = (2.0 + 0.1 * time, np.full(50, -3.0))
    (chart,) = make_charts(VehicleSignals(frame, "ego"), "a-", road_width=6.0, road_edges=edges)
    expected = min((edges[0] - frame["ego.lateral_error"]).min(), (frame["ego.lateral_error"] + 3.0).min())
    least = format_quantity(expected, "m", digits=2)
    assert f"Dashed: the edges of the road; the middle of the car is at least {least} from them." in chart.caption


# --- patches ------------------------------------------------------------------------------------------------------

PATCHES = """
ground:
  surface: grass
  size: [200, 100]
  patches:
    - {name: ice, surface: ice, disc: {center: [25, 0], radius: 6}}
    - {name: stones, surface: gravel, rect: {center: [42, 3], size: [14, 8], yaw: 20 deg}}
    - {name: wet, mu: 0.4, rect: {center: [30, 0], size: [14, 10]}}
    - {name: hidden, surface: gravel, rect: {center: [70, 0], size: [2, 2]}}
    - {name: roof, surface: concrete, rect: {center: [70, 0], size: [4, 4]}}
tracks:
  main: {segments: [{line: 80}], width: [[0, 6], [80, 10]], thickness: 20 mm, verge: gravel,
         markings: [{line: left}]}"""


def document(item: Any) -> dict[str, Any]:
    created: dict[str, Any] = json.loads(item.shape.source().in_memory().mesh_file.contents())
    return created


def triangles(item: Any) -> list[tuple[np.ndarray, dict[str, Any]]]:
    """Corners, M x 3 x 3 with z up, and material of every surface."""
    gltf = document(item)
    blob = base64.b64decode(gltf["buffers"][0]["uri"].split(",")[1])

    def read(index: int, kind: str) -> np.ndarray:
        view = gltf["bufferViews"][gltf["accessors"][index]["bufferView"]]
        return np.frombuffer(blob, kind, offset=view["byteOffset"], count=view["byteLength"] // 4)

    triangles_found = []
    for part in gltf["meshes"][0]["primitives"]:
        points = read(part["attributes"]["POSITION"], "<f4").reshape(-1, 3).astype(float)[:, [0, 2, 1]] * [1, -1, 1]
        triangles_found.append(
            (points[read(part["indices"], "<u4").reshape(-1, 3)], gltf["materials"][part["material"]])
        )
    return triangles_found


def vertices(item: Any) -> np.ndarray:
    return np.concatenate([corners.reshape(-1, 3) for corners, _ in triangles(item)])


def seen_from_above(corners: np.ndarray) -> np.ndarray:
    """Return areas of triangles [m²]; 0 for upright ones."""
    return np.asarray(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2] / 2)


def edges_of(loaded: World) -> Any:
    """Area of the faces at the edges of the roads."""
    slab = loaded.ground.slab
    assert slab is not None
    return shapely.buffer(slab.area, slab.face, join_style="mitre") - slab.area


def test_patches_are_visible_and_surfaces_do_not_overlap(tmp_path: Path):
    loaded = load_world(str(write(tmp_path, PATCHES)))
    items = {item.name: item for item in scenery(loaded)}
    assert {"world/patch.ice", "world/patch.stones", "world/patch.roof"} < set(items)
    assert "world/patch.hidden" not in items  # all of it is below the roof
    assert "world/patch.wet" not in items  # it has no surface
    assert document(items["world/patch.ice"])["images"] == [{"uri": "ice.jpg"}]

    # Every point is covered once: areas add up, and so do those of the patches.
    area = {name: sum(seen_from_above(corners).sum() for corners, _ in triangles(item)) for name, item in items.items()}
    assert sum(area.values()) == pytest.approx(2200.0 * 2100.0, rel=1e-9)
    # The faces at the edges of the road belong to no patch.
    edges = edges_of(loaded)
    assert area["world/patch.ice"] == pytest.approx((loaded.patches[0].area - edges).area, rel=1e-5)
    assert area["world/patch.stones"] == pytest.approx((loaded.patches[1].area - edges).area, rel=1e-5)
    assert area["world/patch.roof"] == pytest.approx(16.0, rel=1e-5)

    # On the road as high as the road, beside it as low as the grass.
    track = loaded.tracks["main"]
    for name in ("ice", "stones"):
        for corners, _ in triangles(items[f"world/patch.{name}"]):
            middle = corners.mean(axis=1)
            on_road = track.inside(middle[:, 0], middle[:, 1])
            assert middle[:, 2] == pytest.approx(np.where(on_road, 0.0, -0.02))


def test_a_patch_without_a_surface_darkens_the_surface_below(tmp_path: Path):
    loaded = load_world(str(write(tmp_path, PATCHES)))
    damp: dict[str, float] = {}
    for item in scenery(loaded):
        for corners, material in triangles(item):
            pbr = material["pbrMetallicRoughness"]
            if pbr["roughnessFactor"] < 0.9:
                assert max(pbr["baseColorFactor"][:3]) < 0.75
                middle = corners.mean(axis=1)
                wet = loaded.patches[2].area.buffer(1e-3)
                assert shapely.contains_xy(wet, middle[:, 0], middle[:, 1]).all()
                damp[item.name] = damp.get(item.name, 0.0) + float(seen_from_above(corners).sum())
    assert set(damp) == {"world/ground", "world/main/road", "world/main/lines", "world/patch.ice", "world/patch.stones"}
    # The narrow faces at the edges of the road are as dry as elsewhere.
    dry = shapely.intersection(edges_of(loaded), loaded.patches[2].area).area
    assert sum(damp.values()) == pytest.approx(14 * 10 - dry, rel=1e-6)


# --- driving ------------------------------------------------------------------------------------------------------


def test_a_point_on_the_line_of_the_path_tracker_gets_round_on_the_road(circuit_file: Path):
    loaded = load_world(str(circuit_file))
    track = loaded.tracks["main"]
    line = make_drivable_line(
        make_centre_line(track),
        speed=15.0,
        limits=DrivingLimits(),
        wheelbase=2.601,
        steering_limit=0.6,
        steering_rate=0.6,
    )
    count, step = len(line.offset), 0.5
    (x, y, yaw), s, driven = track.pose_at(0.0), 0.0, []
    for _ in range(round(track.length / step)):  # it steers as the line curves, and takes back what it is off the line
        s, lateral = track.project(x, y, near=s)
        index = int(s / track.length * count) % count
        assert abs(lateral - line.offset[index]) < 0.1
        heading = math.remainder(yaw - track.pose_at(s)[2] - line.slope[index], 2 * math.pi)
        turn = float(line.curvature[index]) - 0.3 * heading - 0.02 * (lateral - float(line.offset[index]))
        middle = yaw + turn * step / 2
        x, y, yaw = x + step * math.cos(middle), y + step * math.sin(middle), yaw + turn * step
        driven.append((x, y, yaw))
    path = np.array(driven)
    assert loaded.on_road(path[:, 0], path[:, 1]).all()
    assert np.hypot(*(path[-1, :2] - path[0, :2])) < 2.0
    assert math.remainder(path[-1, 2] - path[0, 2], 2 * math.pi) == pytest.approx(0.0, abs=0.05)
    assert abs(path[-1, 2] - path[0, 2]) == pytest.approx(2 * math.pi, abs=0.05)  # once round


@pytest.mark.slow
def test_a_bolt_laps_the_circuit_at_15_metres_per_second(circuit_file: Path):
    spec = {
        "world": str(circuit_file),
        "vehicles": {"ego": {"model": "bolt", "start": "line", "speed": 15}},
        "control": {"ego": {"kind": "path_tracking", "track": "main", "speed": 15}},
        "plant": {"contact": "point"},
        "duration": 300,
        "laps": 1,
    }
    run = Simulation(assemble(make_spec(spec))).run()
    assert run.summary["stop_reason"] == "laps"
    assert run.signals["ego.lap"].iloc[-1] >= 1.0
    assert run.signals["ego.lateral_error"].abs().max() < 0.1
    assert run.signals["ego.wheels_on_road"].min() == 4
    assert run.signals["ego.vx"].mean() == pytest.approx(15.0, abs=0.1)


# --- faults -------------------------------------------------------------------------------------------------------

HEAD = "# x_m,y_m,w_tr_right_m,w_tr_left_m\n"
ROWS = [f"{10 * i},{i % 2},2,2" for i in range(8)]
EIGHT = [(50 * math.sin(t), 25 * math.sin(2 * t)) for t in np.linspace(0.1, 2 * math.pi + 0.1, 41)[:-1]]


def csv(rows: list[str], head: str = HEAD) -> str:
    return head + "\n".join(rows) + "\n"


def world(entry: str) -> str:
    return f"tracks:\n  main:\n    {entry}"


FAULTS: list[tuple[str, str, dict[str, str]]] = [
    # a track of nothing, or of two things
    ("width: 3", "w.yaml:3: tracks.main: give exactly one of segments, points, csv, xodr, random and route", {}),
    (
        "segments: [{line: 3}]\n    csv: a.csv",
        "w.yaml:3: tracks.main: give exactly one of segments, points, csv, xodr, random and route",
        {},
    ),
    # a gap
    (
        "segments: [{line: 20}, {arc: {radius: 5, angle: 90 deg}}]\n    closed: true",
        "w.yaml:3: tracks.main: does not close: gap 25.5 m, 90 deg;",
        {},
    ),
    (
        "csv: track.csv\n    closed: true",
        "w.yaml:4: tracks.main.csv: track.csv:9: does not close: gap 70 m, 0 deg from the last point to the first; add",
        {"csv": csv([f"{10 * i},{(i % 2) * (1 < i < 6)},2,2" for i in range(8)])},
    ),
    (
        "csv: track.csv",
        "w.yaml:4: tracks.main.csv: track.csv:6: jumps 140 m from the point before; the median here is 10 m;",
        {"csv": csv(ROWS[:4] + [f"{10 * i + 130},0,2,2" for i in range(4, 9)])},
    ),
    (
        "xodr: track.xodr\n    closed: true",
        "w.yaml:3: tracks.main: does not close: gap 59.7 m, 169 deg; allowed are 1 mm and 0.01 deg; leave",
        {"xodr": ROAD.replace("188.49555921538757", "100")},
    ),
    # numbers and columns
    (
        "csv: track.csv",
        "w.yaml:4: tracks.main.csv: track.csv:4: y is not a finite number; correct it or delete the line",
        {"csv": csv([*ROWS[:2], "20,nan,2,2", *ROWS[3:]])},
    ),
    (
        "csv: {file: track.csv, left: w_left}",
        "w.yaml:4: tracks.main.csv: track.csv:2: no column 'w_left'; ",
        {"csv": csv(ROWS)},
    ),
    (
        "csv: track.csv",
        "w.yaml:4: tracks.main.csv: track.csv:2: no column 'w_tr_left_m'; did you mean 'w_tr_right_m'?",
        {"csv": csv([row.rpartition(",")[0] for row in ROWS], "x_m,y_m,w_tr_right_m\n")},
    ),
    (
        "csv: {file: track.csv, left: null}",
        "w.yaml:4: tracks.main.csv: right and left belong together; name both columns, or set both null",
        {"csv": csv(ROWS)},
    ),
    ("csv: {file: track.csv, x: true}", "w.yaml:4: tracks.main.csv.x: give the name of a column, or its number", {}),
    (
        "csv: trak.csv",
        "w.yaml:4: tracks.main.csv.file: no such file: 'trak.csv'; did you mean 'track.csv'? (allowed: track.csv)",
        {"csv": csv(ROWS)},
    ),
    ("csv: {file: a.csv, scal: 2}", "w.yaml:4: tracks.main.csv.scal: unknown field; did you mean 'scale'?", {}),
    ("xodr: {file: none.xodr}", "w.yaml:4: tracks.main.xodr.file: no such file: 'none.xodr'; give its path", {}),
    (
        "xodr: {file: track.xodr, road: 8}",
        "w.yaml:4: tracks.main.xodr: track.xodr: no road '8'; allowed: 7",
        {"xodr": ROAD},
    ),
    # too few points
    ("points: [[0, 0], [10, 0]]", "w.yaml:4: tracks.main.points: 2 points; a curve needs at least 4", {}),
    (
        "csv: track.csv",
        "w.yaml:4: tracks.main.csv: track.csv: 2 points; a track needs at least 4, one per line",
        {"csv": csv(ROWS[:2])},
    ),
    (
        "points: [[0, 0], [1, 0], [1e6, 0], [0, 1]]",
        "w.yaml:4: tracks.main.points: 2e+06 m from the first point to the last; allowed are 0.1 m to 100 km",
        {},
    ),
    ("points: []", "w.yaml:4: tracks.main.points: has 0 items; at least 1", {}),
    ("points: [[0, 0], [1, 0], [1, 0], [2, 0]]", "tracks.main.points: point 2 at (1, 0) m is repeated; remove one", {}),
    # crossings
    (
        f"points: {[list(p) for p in EIGHT]}\n    closed: true",
        "w.yaml:3: tracks.main: crosses itself at (",
        {},
    ),
    (
        "csv: {file: track.csv, left: null, right: null}",
        "correct it, or set crossing: true for a figure of eight",
        {"csv": csv([f"{x},{y},2,2" for x, y in EIGHT])},
    ),
    (
        "segments: [{line: 40}, {arc: {radius: 10, angle: 270 deg}}, {line: 40}]",
        "w.yaml:3: tracks.main: crosses itself at (30, 0) m: s = 30 m and 97.12 m; correct it, or set crossing: true",
        {},
    ),
    # folds
    (
        "csv: track.csv",
        "m (track.csv:",
        {"csv": csv([f"{10 * math.cos(a)},{-10 * math.sin(a)},15,3" for a in np.arange(0, 6.28, 0.2)])},
    ),
    (
        "segments: [{line: 40}, {arc: {radius: 5, angle: 90 deg}}]\n    width: [[0, 4], [40, 4], [45, 14]]",
        "w.yaml:3: tracks.main: the inner edge folds at s = 4",
        {},
    ),
    # widths
    (
        "segments: [{line: 9}]\n    width: [[0, 4], [10, 5]]",
        "w.yaml:5: tracks.main.width.1: s = 10 m; the track is 9 m",
        {},
    ),
    (
        "segments: [{line: 9}]\n    width: [[3, 4], [3, 5]]",
        "tracks.main.width: entry 2: s = 3 m; s must increase from 0",
        {},
    ),
    (
        "segments: [{line: 9}]\n    width: [[3, 4, 5]]",
        "tracks.main.width: entry 1 is not [s, width], two numbers in m",
        {},
    ),
    ("segments: [{line: 9}]\n    width: wide", "w.yaml:5: tracks.main.width: 'wide' is not a width; give a number", {}),
    ("segments: [{line: 9}]\n    width: 0", "tracks.main.width: a width must be from 0.01 to 100 m", {}),
    (
        "segments: [{arc: {radius: 10, angle: 360 deg}}]\n    closed: true\n    length: 60\n"
        "    width: [[0, 4], [60, 5]]",
        "w.yaml:7: tracks.main.width: 4 m at s = 0 and 5 m at the end of a closed track; make them equal",
        {},
    ),
    # other
    ("points: [[0, 0], [1, 0], [2, 0], [3, 0]]\n    length: 9", "length belongs to segments; set csv.scale, or", {}),
    (
        "csv: track.csv",
        "w.yaml:3: tracks.main: starts at (5e+06, 0) m, too far from the origin; set start to move it",
        {"csv": csv([f"{5_000_000 + 10 * i},0,2,2" for i in range(8)])},
    ),
]


@pytest.mark.parametrize(("entry", "expected", "files"), FAULTS)
def test_a_fault_is_reported_with_its_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, entry: str, expected: str, files: dict[str, str]
):
    reported = message(tmp_path, monkeypatch, world(entry), **files)
    assert reported.startswith("w.yaml:")
    assert expected in reported


def test_the_points_at_a_crossing_are_named_by_their_lines(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    text = csv([f"{x},{y},2,2" for x, y in EIGHT])
    reported = message(tmp_path, monkeypatch, world("csv: track.csv"), csv=text)
    places = [int(part.split(")")[0]) for part in reported.split("track.csv:")[1:]]
    crossing = np.array(EIGHT)[np.array(places) - 2]  # the first point is in line 2
    assert len(places) == 2
    assert np.hypot(*crossing.T).max() < 10.0  # the eight crosses itself at the origin


@pytest.mark.parametrize("more", ["crossing: true", "road: false"])
def test_a_figure_of_eight_can_be_allowed(tmp_path: Path, more: str):
    loaded: World = load_world(
        str(write(tmp_path, world(f"points: {[list(p) for p in EIGHT]}\n    closed: true\n    {more}")))
    )
    assert loaded.tracks["main"].gap[0] < 1e-6
    scenery(loaded)


@pytest.mark.parametrize("closed", ["true", "false"])
def test_a_circle_that_meets_its_start_does_not_cross_itself(tmp_path: Path, closed: str):
    track_of(tmp_path, f"segments: [{{arc: {{radius: 10, angle: 360 deg}}}}], closed: {closed}")


numbers = st.one_of(st.floats(-50.0, 50.0).map(lambda v: round(v, 3)), st.sampled_from([0.0, 1e6, 1e-7]))


@settings(max_examples=80, deadline=None)
@given(
    st.lists(st.tuples(numbers, numbers), min_size=1, max_size=9), st.booleans(), st.sampled_from(["", "width: 0.5"])
)
def test_any_points_give_a_message_or_a_road(
    tmp_path_factory: pytest.TempPathFactory, points: list[tuple[float, float]], closed: bool, more: str
):
    entry = f"points: {[list(p) for p in points]}\n    closed: {str(closed).lower()}\n    {more}"
    path = write(tmp_path_factory.getbasetemp(), world(entry))
    fault = ""
    try:
        track = load_world(str(path)).tracks["main"]
    except WorldError as error:
        fault = str(error)
    else:
        pieces = list(itertools.pairwise(track.pieces))
        assert all(a.end_curvature == b.start_curvature for a, b in pieces)
    assert not fault or "w.yaml:" in fault
    assert "\n" not in fault


# --- folds of lines through points --------------------------------------------------------------------------------


@pytest.mark.parametrize("source", ["points", "csv"])
@pytest.mark.parametrize(("corner", "width"), [(20.0, 12.0), (10.0, 6.0)])
def test_a_folded_line_through_points_is_smoothed_as_little_as_possible_with_a_note(
    tmp_path: Path, source: str, corner: float, width: float
) -> None:
    points = [(0.0, 0.0), (corner, 0.0), (2 * corner, 0.0), (2 * corner, corner), (2 * corner, 2 * corner)]
    given: dict[str, object] = {"points": points, "width": width}
    if source == "csv":
        rows = [f"{x},{y},{width / 2},{width / 2}" for x, y in points]
        (tmp_path / "line.csv").write_text("\n".join(["x_m,y_m,w_tr_right_m,w_tr_left_m", *rows]), encoding="utf-8")
        given = {"csv": {"file": "line.csv"}, "width": width}
    track = make_track(TrackSpec.model_validate(given), folder=tmp_path)
    assert track.folds() is None
    assert width / 2 < track.min_radius < 1.1 * width / 2
    (note,) = track.notes
    assert "the inner edge folds at s = " in note
    off = float(note.rpartition("up to ")[2].removesuffix(" m"))
    assert 0.0 < off < width / 2
    assert max(abs(float(e)) for e in track.project(*np.array(points).T)[1]) == pytest.approx(off, abs=0.01)


def test_a_fold_that_takes_more_than_half_the_width_and_one_of_exact_segments_stay_errors() -> None:
    hairpin = [(0.0, 0.0), (10.0, 0.0), (20.0, 0.0), (20.2, 0.4), (20.0, 0.8), (10.0, 0.8), (0.0, 0.8)]
    with pytest.raises(WorldError, match="the inner edge folds"):
        make_track(TrackSpec.model_validate({"points": hairpin, "width": 4.0}))
    bend = [{"line": 10}, {"arc": {"radius": 2.0, "angle": 1.5}}]
    with pytest.raises(WorldError, match="the inner edge folds"):
        make_track(TrackSpec.model_validate({"segments": bend, "width": 5.0}))
