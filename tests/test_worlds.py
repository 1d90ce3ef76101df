import base64
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mirdrake.core.errors import ConfigError, WorldError
from mirdrake.core.paths import data_root
from mirdrake.core.yaml_io import parse_yaml
from mirdrake.world_checks import check_world
from mirdrake.worlds import World, WorldSpec, load_world, make_world
from mirdrake.worlds.loading import parse_world
from mirdrake.worlds.scenery import (
    SKIES,
    TILES,
    SceneryItem,
    lights,
    render_params,
    scenery,
    sky_colors,
    sun_light,
    texture_path,
)
from mirdrake.worlds.world import SURFACE_MU
from tests.timing import reference_seconds

WORLDS = sorted(path.stem for path in (data_root() / "worlds").glob("*.yaml"))
RELIEFS = ("hill_road", "kerb_and_bumps", "rough_road")
"""Worlds whose meshes follow an uneven ground, with more triangles."""


def world(text: str) -> World:
    return make_world(parse_yaml("mirdrake: world/1\n" + text, WorldSpec, name="w.yaml"))


def message(text: str) -> str:
    with pytest.raises((ConfigError, WorldError)) as caught:
        world(text)
    return str(caught.value)


def track(segments: str, **keys: object) -> str:
    lines = [f"    {key}: {value}" for key, value in keys.items()]
    return "\n".join(["tracks:", "  main:", *lines, f"    segments: {segments}"])


CIRCLE = "[{arc: {radius: 10, angle: 360 deg}}]"


# --- the worlds that come with mirdrake ---------------------------------------------------------------------------


@pytest.mark.parametrize("name", WORLDS)
def test_every_world_of_mirdrake_loads(name: str):
    loaded = load_world(name)
    assert loaded.name == name
    assert loaded.starts
    assert loaded.path == data_root() / "worlds" / f"{name}.yaml"


def test_the_three_first_worlds_are_there():
    assert {"empty", "skidpad", "test_track"} <= set(WORLDS)


def test_the_car_starts_on_the_line_of_the_test_track_and_looks_along_it():
    start = load_world("test_track").start("line")
    assert (start.x, start.y, start.yaw) == pytest.approx((-92.0, -41.0, 0.0))
    assert (start.track, start.s) == ("main", 0.0)


def test_the_circles_of_the_skidpad_are_18_25_m_apart_and_touch_at_the_origin():
    tracks = load_world("skidpad").tracks
    middles = [
        np.mean(np.column_stack(t.pose(np.linspace(0, t.length, 1000, endpoint=False))[:2]), axis=0)
        for t in tracks.values()
    ]
    assert middles[0] - middles[1] == pytest.approx([0.0, 18.25], abs=1e-9)
    assert tracks["left"].project(0.0, 0.0)[1] == pytest.approx(0.0, abs=1e-9)
    assert tracks["right"].project(0.0, 0.0)[1] == pytest.approx(0.0, abs=1e-9)
    inner = np.hypot(*(tracks["left"].boundaries()[0] - middles[0]).T)
    assert 2 * inner == pytest.approx(np.full(len(inner), 15.25), abs=1e-9)


def test_an_empty_world_needs_two_lines():
    plain = world("name: plain")
    assert plain.starts["origin"].yaw == 0.0
    assert plain.tracks == {}
    assert plain.road_mu == SURFACE_MU["asphalt"]
    assert plain.on_road([0.0, 50.0], [0.0, 0.0]).all()


def test_a_world_without_a_name_has_that_of_its_file(tmp_path: Path):
    file = tmp_path / "yard.yaml"
    file.write_text("mirdrake: world/1\n")
    assert load_world(str(file)).name == "yard"


def test_one_of_everything_is_understood():
    everything = world("""
name: all
seed: 3
ground: {surface: gravel, mu: 0.55, size: [300, 200], slope: {grade: 0.1, heading: 90 deg}}
tracks:
  loop:
    segments:
      - {line: 40}
      - {arc: {radius: 20, angle: 180 deg, transition: 10 deg}}
      - {line: 40}
      - {arc: {radius: 20, angle: 180 deg, transition: 10 deg}}
    start: {at: [1 m, 2], yaw: 10 deg}
    closed: true
    width: 400 cm
    thickness: 10 mm
    surface: concrete
    mu: 0.8
    verge: grass
    markings: [{line: center, kind: dashed, width: 0.2, dash: [2, 4]}]
    expected_length: 233.4 +- 20
  lane:
    segments:
      - {clothoid: {from_radius: straight, to_radius: -30, length: 20}}
      - {clothoid: {from_radius: -30, to_radius: inf, angle: -10 deg}}
    length: 60
lights: {sun: {azimuth: 90 deg, elevation: 30 deg, intensity: 0.8}, ambient: 0.2}
sky: overcast
start:
  a: {at: [1, 2], yaw: 90 deg, speed: 36 km/h}
  b: {on_track: {track: loop, s: 5, offset: -1}}
goals: {disc: {at: [3, 4], radius: 2}, gate: {gate: {track: loop, s: 10}}, laps: {laps: 2}}
""")
    assert everything.starts["a"].speed == 10.0
    assert everything.tracks["lane"].length == pytest.approx(60.0)
    assert everything.road_mu == 0.85  # of the lane, which is asphalt
    assert everything.mu(*everything.tracks["loop"].pose_at(120.0)[:2]) == 0.8
    scenery(everything)


# --- tracks from their description --------------------------------------------------------------------------------


def test_two_auto_lines_close_a_track_with_uneven_corners():
    lines, radii = ("auto", "auto", "30", "20"), (5, 7, 6, 8)
    parts = [f"{{line: {a}}}, {{arc: {{radius: {r}, angle: 90 deg}}}}" for a, r in zip(lines, radii, strict=True)]
    sides = f"[{', '.join(parts)}]"
    loop = world(track(sides, closed="true")).tracks["main"]
    assert loop.gap == pytest.approx((0.0, 0.0), abs=1e-12)
    # Along x: a + 5 + 8 = 30 + 7 + 6, so a = 30; along y: b + 5 + 7 = 20 + 6 + 8, so b = 22.
    assert [p.length for p in loop.pieces if not p.start_curvature] == pytest.approx([30.0, 22.0, 30.0, 20.0])


def test_a_third_auto_line_makes_the_length():
    corner = "{arc: {radius: 5, angle: 90 deg}}"
    sides = f"[{{line: auto}}, {corner}, {{line: auto}}, {corner}, {{line: auto}}, {corner}, {{line: 10}}, {corner}]"
    loop = world(track(sides, closed="true", length=100)).tracks["main"]
    assert loop.length == pytest.approx(100.0, abs=1e-10)
    long_side = (100.0 - 2 * math.pi * 5.0 - 2 * 10.0) / 2  # what four quarter circles and two short sides leave
    assert [p.length for p in loop.pieces if not p.start_curvature] == pytest.approx([long_side, 10.0, long_side, 10.0])


def test_length_scales_a_circle_of_10_m_to_a_radius_of_100_over_two_pi():
    loop = world(track(CIRCLE, closed="true", length=100)).tracks["main"]
    assert loop.length == pytest.approx(100.0)
    assert loop.min_radius == pytest.approx(100.0 / (2 * math.pi))


def test_transitions_turn_part_of_the_angle_of_an_arc():
    bend = world(track("[{arc: {radius: 20, angle: -90 deg, transition: 20 deg}}]")).tracks["main"]
    assert math.degrees(sum(piece.turn for piece in bend.pieces)) == pytest.approx(-90.0)
    # Each clothoid turns 20 deg = L / (2 R), so L = 2 * 20 * 0.34907 = 13.963 m; the arc keeps 50 deg: 17.453 m.
    assert [piece.length for piece in bend.pieces] == pytest.approx([13.9626, 17.4533, 13.9626], abs=1e-4)


def test_a_clothoid_given_by_its_angle_has_twice_that_angle_over_the_sum_of_its_curvatures():
    bend = world(track("[{clothoid: {from_radius: 25, to_radius: 16, angle: 20 deg}}]")).tracks["main"]
    assert bend.length == pytest.approx(2 * math.radians(20) / (1 / 25 + 1 / 16))


# --- messages -----------------------------------------------------------------------------------------------------


def test_an_unclosed_track_is_reported_with_its_gap():
    square = "[{line: 20}, {arc: {radius: 5, angle: 90 deg}}]"
    assert message(track(square, closed="true")) == (
        "w.yaml:3: tracks.main: does not close: gap 25.5 m, 90 deg; allowed are 1 mm and 0.01 deg; make the angles add "
        "up to 360 deg and set two lines that are not parallel to auto, or set closed: false"
    )


def test_two_millimetres_are_too_much_and_half_a_millimetre_is_not():
    half = "{arc: {radius: 10, angle: 180 deg}}"
    world(track(f"[{{line: 20.0005}}, {half}, {{line: 20}}, {half}]", closed="true"))
    fault = message(track(f"[{{line: 20.002}}, {half}, {{line: 20}}, {half}]", closed="true"))
    assert fault.startswith("w.yaml:3: tracks.main: does not close: gap 0.002 m, 0 deg;")


LOOP = track(CIRCLE)
HALF = "{arc: {radius: 9, angle: 180 deg}}"
FAULTS = [
    ("tracksx: {}", "2: tracksx: unknown field; did you mean 'tracks'?"),
    ("ground: {surface: tarmac}", "2: ground.surface: "),
    ("ground: {mu: -1}", "2: ground.mu: "),
    ("ground: {size: [0, 1]}", "2: ground.size: both sides must be above 0 m and at most 100 km"),
    (track("[]"), "4: tracks.main.segments: "),
    (track("[{line: -3}]"), "4: tracks.main.segments.0.line: -3 is neither a length of at least 1 mm nor 'auto'"),
    (track("[{line: automatic}]"), "4: tracks.main.segments.0.line: 'automatic' is neither a length"),
    (track("[{line: 3, arc: {radius: 3, angle: 1}}]"), "4: tracks.main.segments.0: give exactly one of line, arc and"),
    (
        track("[{arc: {radius: 3, angle: 90}}]"),
        "4: tracks.main.segments.0.arc: angle must not be 0, nor above 720 deg;",
    ),
    (
        track("[{arc: {radius: 3, angle: 90 deg, transition: 50 deg}}]"),
        "4: tracks.main.segments.0.arc: the two transitions turn more than the angle",
    ),
    (
        track("[{clothoid: {to_radius: 30}}]"),
        "4: tracks.main.segments.0.clothoid: give exactly one of length and angle",
    ),
    (
        track("[{clothoid: {to_radius: 30, angle: -20 deg}}]"),
        "4: tracks.main.segments.0.clothoid: angle does not fit the radii",
    ),
    (
        track("[{clothoid: {to_radius: nan, length: 20}}]"),
        "4: tracks.main.segments.0.clothoid.to_radius: 'nan' is neither a signed radius",
    ),
    (
        track(CIRCLE, expected_length="965"),
        "4: tracks.main.expected_length: 965 is not a length with its tolerance; write for",
    ),
    (
        track(CIRCLE, expected_length="965 +- 1"),
        "4: tracks.main.expected_length: the track is 62.831853 m long; expected are 965 +- 1 m",
    ),
    (track(CIRCLE, width=20), "3: tracks.main: the inner edge folds: smallest radius 10 m, width 20 m"),
    (track("[{line: auto}]"), "4: tracks.main.segments: 1 auto lines; a closed track needs two"),
    (
        track(f"[{{line: auto}}, {HALF}, {{line: auto}}, {HALF}]", closed="true"),
        "5: tracks.main.segments: the auto lines cannot close the track because they are parallel",
    ),
    (
        track(
            "[{line: auto}, {arc: {radius: 20, angle: 90 deg}}, {line: auto}, {arc: {radius: 9, angle: 270 deg}}]",
            closed="true",
        ),
        "5: tracks.main.segments: auto lines would need lengths of ",
    ),
    (
        "start: {a: {at: [1000, 0]}}",
        "2: start.a.at: start outside the world: (1000, 0) m; the ground extends from (-200, -200) to (200, 200) m",
    ),
    (
        LOOP + "\nstart: {a: {on_track: {track: mian}}}",
        "5: start.a.on_track.track: unknown track 'mian'; did you mean 'main'?",
    ),
    (
        LOOP + "\nstart: {a: {on_track: {track: main, s: 70}}}",
        "5: start.a.on_track.s: start outside the world: s = 70 m; the track is 62.8319 m long",
    ),
    (
        LOOP + "\nstart: {a: {on_track: {track: main, offset: 1.6}}}",
        "5: start.a.on_track.offset: start outside the world: 1.6 m beside the centre line",
    ),
    ("start: {a: {at: [0, 0], on_track: {track: main}}}", "2: start.a: give either at and yaw, or on_track"),
    ("goals: {a: {gate: {track: main}}}", "2: goals.a.gate.track: unknown track 'main'; the world has no tracks"),
    ("goals: {a: {}}", "2: goals.a: give exactly one of at, gate and laps"),
]


@pytest.mark.parametrize(("text", "expected"), FAULTS)
def test_a_fault_is_named_with_its_line(text: str, expected: str):
    assert message(text).startswith(f"w.yaml:{expected}")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (
            "tracks: {main: {segments: [{line: 9}]}}\nstart: {a: {on_track: {s: 1}}}",
            "3: start.a.on_track.track: is missing: the name of a track; allowed: main",
        ),
        (
            "start: {a: {on_track: {s: 1}}}",
            "2: start.a.on_track.track: is missing: the name of a track; the world has no tracks",
        ),
        ("start: {on_track: {track: main}}", "2: start: has no name; write start: {NAME: {on_track: …}}"),
        ("goals: {at: [0, 0], radius: 1}", "2: goals: has no name; write goals: {NAME: {at: …}}"),
    ],
)
def test_a_missing_name_is_named_with_the_names_that_exist(text: str, expected: str, tmp_path: Path):
    with pytest.raises(ConfigError) as caught:
        parse_world(f"mirdrake: world/1\n{text}\n", tmp_path / "w.yaml")
    assert f"w.yaml:{expected}" in str(caught.value)


def test_a_goal_may_have_the_name_of_a_key(tmp_path: Path):
    world = parse_world("mirdrake: world/1\ngoals: {at: {at: [1, 2]}}\n", tmp_path / "w.yaml")
    assert list(world.goals) == ["at"]


def test_the_version_of_the_language_is_required():
    with pytest.raises(ConfigError, match=r"^w\.yaml:1: mirdrake: is missing; write `mirdrake: world/1` as its first"):
        parse_yaml("name: x", WorldSpec, name="w.yaml")
    with pytest.raises(ConfigError, match="'world/2' is not allowed"):
        parse_yaml("mirdrake: world/2", WorldSpec, name="w.yaml")


def test_all_faults_of_the_starts_are_reported_at_once():
    assert len(message("start: {a: {at: [1000, 0]}, b: {at: [0, 1000]}}").splitlines()) == 2


def test_unknown_names_are_answered_with_near_ones():
    loaded = load_world("test_track")
    with pytest.raises(
        ConfigError, match=r"d\.yaml:4: start: world 'test_track' has no start 'lines'; did you mean 'line'"
    ):
        loaded.start("lines", where="d.yaml:4: start")
    with pytest.raises(ConfigError, match="has no track 'mian'; did you mean 'main'"):
        loaded.track("mian")
    with pytest.raises(ConfigError, match=r"d\.yaml:3: world: unknown world 'test_trak'; did you mean 'test_track'"):
        load_world("test_trak", where="d.yaml:3: world")


KEYS = [
    "tracks",
    "main",
    "segments",
    "line",
    "arc",
    "clothoid",
    "radius",
    "angle",
    "from_radius",
    "to_radius",
    "length",
]
KEYS += ["start", "at", "yaw", "on_track", "track", "s", "offset", "ground", "size", "mu", "surface", "width", "goals"]
TEXTS = ["auto", "inf", "straight", "true", "asphalt", "1", "-3", "0", "1e300", "1e-9", "90 deg", "5 +- 1", "null", "~"]
words = st.sampled_from([*KEYS, "closed", "expected_length", *TEXTS, ".", ".nan", "{}", "[]"])
values = st.recursive(
    words, lambda inner: st.lists(inner, max_size=3).map(lambda v: "[" + ", ".join(v) + "]")
    | st.dictionaries(words, inner, max_size=3).map(lambda d: "{" + ", ".join(f"{k}: {v}" for k, v in d.items()) + "}"),
    max_leaves=8,
)  # fmt: skip


@settings(max_examples=60, deadline=None)
@given(st.dictionaries(words, values, max_size=4), st.text(max_size=40))
def test_garbage_gives_a_message_or_a_world(keys: dict[str, str], tail: str):
    faults: list[str] = []
    for text in ("\n".join(f"{key}: {value}" for key, value in keys.items()), tail):
        try:
            world(text)
        except (ConfigError, WorldError) as error:
            faults.append(str(error))
    assert all(faults)


lengths = st.one_of(st.just("auto"), st.floats(-1.0, 1e7).map(repr), st.sampled_from(["1e-9", "0.001", "1e5", "x"]))
radii = st.one_of(st.sampled_from(["straight", "inf", "1e-12", "0.01", "1e9"]), st.floats(-50.0, 50.0).map(repr))
degrees = st.floats(-800.0, 800.0).map(lambda angle: f"{angle} deg")
segments = st.one_of(
    st.builds("{{line: {}}}".format, lengths),
    st.builds("{{arc: {{radius: {}, angle: {}, transition: {}}}}}".format, radii, degrees, degrees),
    st.builds("{{arc: {{radius: {}, angle: {}}}}}".format, radii, degrees),
    st.builds("{{clothoid: {{from_radius: {}, to_radius: {}, length: {}}}}}".format, radii, radii, lengths),
    st.builds("{{clothoid: {{from_radius: {}, to_radius: {}, angle: {}}}}}".format, radii, radii, degrees),
)


@settings(max_examples=150, deadline=None)
@given(st.lists(segments, min_size=1, max_size=5), st.booleans(), st.sampled_from(["", "1e-3", "50", "99999"]))
def test_any_segments_give_a_message_or_a_road(parts: list[str], closed: bool, length: str):
    keys = {"closed": str(closed).lower()} | ({"length": length} if length else {})
    fault = ""
    try:
        road = world(track("[" + ", ".join(parts) + "]", width=0.01, **keys)).tracks["main"]
    except (ConfigError, WorldError) as error:
        fault = str(error)
    else:
        assert np.isfinite(np.column_stack(road.pose(np.linspace(0.0, road.length, 50)))).all()
    assert not fault or fault.startswith("w.yaml:")


# --- friction and slope -------------------------------------------------------------------------------------------


def test_friction_is_that_of_the_road_on_it_and_of_the_grass_beside_it():
    loaded = load_world("test_track")
    s = np.linspace(0.0, 960.0, 400)
    assert (loaded.mu(*loaded.tracks["main"].point(s, 1.4)) == 0.9).all()
    assert (loaded.mu(*loaded.tracks["main"].point(s, -1.6)) == 0.5).all()
    assert loaded.mu(np.zeros((2, 3)), 0.0).shape == (2, 3)
    assert loaded.road_mu == 0.9


def test_a_verge_of_2_m_lies_between_road_and_ground():
    loaded = world("ground: {surface: concrete}\n" + track("[{line: 100}]", verge="ice"))
    assert loaded.mu([50.0] * 4, [0.0, 2.0, -3.4, 3.6]).tolist() == [0.85, 0.1, 0.1, 0.85]


def test_on_a_grade_of_75_percent_gravity_pulls_downhill_with_3_fifths():
    ground = world("ground: {slope: {grade: 0.75, heading: 90 deg}}").ground  # a 3-4-5 triangle
    assert ground.gravity == pytest.approx([0.0, -0.6 * 9.80665, -0.8 * 9.80665], abs=1e-12)


# --- what it looks like -------------------------------------------------------------------------------------------


def gltf(item: SceneryItem) -> dict[str, Any]:
    document: dict[str, Any] = json.loads(item.shape.source().in_memory().mesh_file.contents())
    return document


def heights(document: dict[str, Any]) -> tuple[float, float]:
    limits = [document["accessors"][p["attributes"]["POSITION"]] for m in document["meshes"] for p in m["primitives"]]
    return min(limit["min"][1] for limit in limits), max(limit["max"][1] for limit in limits)


def triangles(document: dict[str, Any]) -> int:
    return sum(document["accessors"][p["indices"]]["count"] // 3 for m in document["meshes"] for p in m["primitives"])


@pytest.mark.parametrize("name", [name for name in WORLDS if name not in RELIEFS])
def test_scenery_has_less_than_40000_triangles_and_is_made_in_a_moment(name: str):
    loaded = load_world(name)
    items = scenery(loaded)
    assert reference_seconds(lambda: scenery(loaded)) < 1.0
    assert len({item.name for item in items}) == len(items)
    assert sum(triangles(gltf(item)) for item in items) < 40_000


@pytest.mark.slow
@pytest.mark.parametrize("name", RELIEFS)
def test_scenery_of_a_relief_has_less_than_250000_triangles(name: str):
    assert sum(triangles(gltf(item)) for item in scenery(load_world(name))) < 250_000


def test_the_road_is_seen_at_z_0_and_the_grass_10_mm_lower():
    items = {item.name: gltf(item) for item in scenery(load_world("test_track"))}
    assert heights(items["world/main/road"]) == pytest.approx((0.0, 0.0))
    assert heights(items["world/edges"]) == pytest.approx((-0.01, 0.0))
    assert heights(items["world/main/lines"]) == pytest.approx((0.0, 0.0))
    assert heights(items["world/ground"]) == pytest.approx((-0.01, -0.01))


def test_ground_road_and_paint_cover_the_plane_without_overlap():
    def area(document: dict[str, Any]) -> float:
        blob = base64.b64decode(document["buffers"][0]["uri"].split(",")[1])
        views, accessors, total = document["bufferViews"], document["accessors"], 0.0
        for primitive in document["meshes"][0]["primitives"]:

            def read(index: int, kind: str) -> np.ndarray:
                view = views[accessors[index]["bufferView"]]
                return np.frombuffer(blob, kind, offset=view["byteOffset"], count=view["byteLength"] // 4)

            points = read(primitive["attributes"]["POSITION"], "<f4").reshape(-1, 3).astype(float)
            corners = points[read(primitive["indices"], "<u4").reshape(-1, 3)]
            # y is up in glTF: the area seen from above is half the y component of the cross product.
            areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 1] / 2
            assert (areas > -1e-4).all()  # every triangle faces up (or is a side)
            total += areas.sum()
        return total

    loaded = load_world("test_track")
    items = {item.name: area(gltf(item)) for item in scenery(loaded)}
    xmin, ymin, xmax, ymax = loaded.ground.extent
    plane = (xmax - xmin + 2000.0) * (ymax - ymin + 2000.0)
    assert sum(items.values()) == pytest.approx(plane, rel=1e-6)
    assert items["world/main/road"] + items["world/main/lines"] == pytest.approx(965.0 * 3.0, rel=1e-3)
    # Faces of 10 mm on both sides of the road.
    assert items["world/edges"] == pytest.approx(965.0 * 0.02, rel=1e-2)
    # Two solid lines of 0.1 m, dashes of half the length, and a start line 0.4 m wide that crosses them.
    paint = 0.1 * (2 * 965.0 + 965.0 / 2) + 0.4 * (2.9 - 0.3) + 0.1 * 0.2
    assert items["world/main/lines"] == pytest.approx(paint, abs=0.5)


def test_textures_repeat_and_lie_beside_their_mesh():
    ground = next(item for item in scenery(load_world("test_track")) if item.name == "world/ground")
    document = gltf(ground)
    assert document["samplers"][0]["wrapS"] == document["samplers"][0]["wrapT"] == 10497  # REPEAT of OpenGL
    files = ground.shape.source().in_memory().supporting_files
    assert [image["uri"] for image in document["images"]] == list(files) == ["grass.jpg"]


def test_every_surface_has_a_texture_of_less_than_300_kb():
    assert set(TILES) == set(SURFACE_MU)
    for surface in TILES:
        assert 5_000 < texture_path(surface).stat().st_size < 300_000


def test_the_sun_in_the_north_east_shines_to_the_south_west_and_down():
    loaded = world("lights: {sun: {azimuth: 45 deg, elevation: 30 deg, intensity: 0.7}}")
    sun = sun_light(loaded)
    level = math.cos(math.radians(30)) / math.sqrt(2)
    assert sun.direction == pytest.approx([-level, -level, -0.5])
    assert lights(loaded)[0].intensity == pytest.approx(0.7 * math.pi)
    assert all(light.frame == "world" for light in render_params(loaded).lights)


@pytest.mark.parametrize("sky", SKIES)
def test_skies_have_colours(sky: str):
    zenith, horizon = sky_colors(world(f"sky: {sky}"))
    assert (horizon > zenith).all()
    assert render_params(world(f"sky: {sky}")).default_clear_color == pytest.approx(horizon)


# --- how long it takes ---------------------------------------------------------------------------------------------

MANY = {
    "500 props": """
props:
  - {prop: sedan, name: car, grid: {origin: [-150, -150], step: [10, 15], count: [20, 15]}, yaw: 0 .. 360 deg}
  - {prop: cone, grid: {origin: [-150, 80], step: [3, 3], count: [50, 4]}}
""",
    "100 cars in 70 m": """
props:
  - {box: [4.5, 1.8, 1.5], name: car, scatter: {region: {rect: {size: [70, 70]}}, count: 100}, yaw: 0 .. 360 deg}
""",
}


@pytest.mark.parametrize("text", MANY.values(), ids=MANY)
def test_many_props_are_laid_out_and_checked_within_a_second(text, tmp_path):
    path = tmp_path / "many.yaml"
    path.write_text(f"mirdrake: world/1\n{text}", encoding="utf-8")
    load_world(str(path))  # imports and meshes are read once

    def lay_out_and_check() -> None:
        crowded = load_world(str(path), overrides=["seed=2"])
        assert len(crowded.props) >= 100
        assert not check_world(crowded)

    assert reference_seconds(lay_out_and_check) < 1.0


def test_the_drawing_of_a_world_has_each_thing_once_in_the_order_in_which_it_is_drawn() -> None:
    from mirdrake.worlds.drawing import make_drawing

    world = make_world(
        {
            "mirdrake": "world/1",
            "tracks": {
                "main": {
                    "segments": [{"line": 40}], "verge": "grass",
                    "markings": [{"line": "left"}, {"line": "start", "kind": "dashed"}],
                }
            },
            "ground": {"patches": [{"name": "ice", "disc": {"radius": 2}, "surface": "ice"}]},
            "goals": {"exit": {"at": [30, 0]}, "line": {"gate": {"track": "main", "s": 20}}},
            "props": [{"box": [1, 1, 2], "at": [5, 5]}, {"box": [1, 1, 1], "at": [9, 5]}],
        }
    )  # fmt: skip
    drawing = make_drawing(world)
    assert [(area.layer, area.name) for area in drawing.areas] == [
        ("ground", ""), ("verge", "main"), ("road", "main"), ("patch", "ice"), ("goal", "exit"),
        ("prop", "box_2"), ("prop", "box"),
    ]  # fmt: skip
    assert [line.layer for line in drawing.lines] == ["marking", "marking", "gate"]
    left, start, gate = (line.points for line in drawing.lines)
    assert np.allclose(left[:, 1], 1.4)
    assert np.allclose(start, [[0, -1.4], [0, 1.4]])
    assert np.allclose(gate, [[20, -1.5], [20, 1.5]])
    assert [start.name for start in drawing.starts] == ["origin"]
