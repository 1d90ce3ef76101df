"""Laser scanner, lidar, sonar and radar: time, motion, noise, limits, and rejected input."""

import shutil
import sys
from math import cos, pi, sin
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydrake.geometry import Box, Cylinder, Sphere
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.analysis import Simulator

from mirdrake.assembly.diagram import assemble
from mirdrake.core.errors import ConfigError, MissingDependencyError
from mirdrake.core.paths import data_root
from mirdrake.core.yaml_io import parse_yaml
from mirdrake.runs.simulation import Simulation
from mirdrake.sensors.ranging.faces import flat_faces
from mirdrake.sensors.ranging.laser_scanner import LaserScanner
from mirdrake.sensors.ranging.lidar import Lidar, LidarMount, LidarScan
from mirdrake.sensors.ranging.radar import Radar
from mirdrake.sensors.ranging.scene import RayScene
from mirdrake.sensors.ranging.sonar import Sonar
from mirdrake.sensors.ranging.world import RayWorld
from mirdrake.vehicles import load_vehicle
from mirdrake.vehicles.mounts import SENSORS, SensorsSpec
from tests.ranging_rigs import ABOVE, Room, lidar, radar, scanner, sonar
from tests.sensor_rigs import Carousel, held

MILLIMETRE = 1e-3


def make(kind: Any, room: Room, mount: Any, *, stream: int = 1, ground: bool = True, **more: Any) -> Any:
    """Return a sensor at the origin of the room's carrier."""
    return kind(room.world(ground=ground), room.carrier.body_frame(), mount, stream=stream, **more)


def _wall(room: Room, x: float, name: str | None = None) -> None:
    """A wall whose face is the plane x = const."""
    room.put(Box(1.0, 400.0, 10.0), RigidTransform([x + 0.5, 0.0, 5.0]), name)


# --- what is seen ------------------------------------------------------------------------------------------------


def test_a_scanner_measures_a_room() -> None:
    room = Room()
    for x, y, sides in ((7.5, 0.0, (1, 40, 9)), (0.0, 4.5, (40, 1, 9)), (0.0, -6.5, (40, 1, 9))):
        room.put(Box(*sides), RigidTransform([x, y, 0.0]))
    sensor = make(LaserScanner, room, scanner())
    angles = sensor.angles
    assert angles[[0, 180, -1]] == pytest.approx([-pi / 2, 0.0, pi / 2])
    with np.errstate(divide="ignore"):
        beside = np.where(angles > 0.0, 4.0 / np.sin(angles), np.where(angles < 0.0, -6.0 / np.sin(angles), np.inf))
    expected = np.minimum(7.0 / np.maximum(np.cos(angles), 1e-12), beside)
    assert np.abs(room.measure(sensor) - expected).max() < MILLIMETRE


def test_a_lidar_sees_the_ground_in_rings_and_a_pillar_above() -> None:
    room = Room()
    room.put(Cylinder(0.5, 8.0), RigidTransform([6.0, 0.0, 2.0]))
    sensor = make(Lidar, room, lidar(columns=181, rolling=False))
    scan = room.measure(sensor)
    assert scan.ranges.shape == (8, 181)
    assert scan.ranges.dtype == np.float32
    assert scan.elevations == pytest.approx(np.linspace(-0.3, 0.1, 8))
    assert scan.azimuths[90] == pytest.approx(0.0)
    down = scan.elevations[:, None] < 0.0
    rings = np.where(down, 1.0 / np.where(down, np.sin(-scan.elevations)[:, None], 1.0), np.inf)
    assert np.abs(scan.ranges[:5, 0] - rings[:5, 0]).max() < MILLIMETRE
    assert np.isinf(scan.ranges[6:, 0]).all()
    ahead = np.minimum(5.5 / np.cos(scan.elevations), rings[:, 0])
    assert np.abs(scan.ranges[:, 90] - ahead).max() < MILLIMETRE
    points = scan.points()
    assert len(points) == np.isfinite(scan.ranges).sum()
    assert points[:, 2].min() == pytest.approx(-1.0, abs=MILLIMETRE)
    assert scan.points_in_world()[:, 2].min() == pytest.approx(0.0, abs=MILLIMETRE)


def test_near_and_far_are_limits_and_objects_below_near_occlude_others() -> None:
    for distance, expected in ((0.4, np.inf), (0.6, 0.6), (9.9, 9.9), (10.1, np.inf)):
        room = Room()
        _wall(room, distance)
        _wall(room, distance + 3.0)
        sensor = make(LaserScanner, room, scanner(beams=1, start_angle=0.0, near=0.5, far=10.0))
        assert room.measure(sensor) == pytest.approx([expected])


def test_a_sonar_gives_the_nearest_echo_in_its_cone() -> None:
    for y, expected in ((0.0, 2.0 - 0.1), (0.35, np.hypot(2.0, 0.35) - 0.1), (1.5, 4.0)):
        room = Room()
        room.put(Sphere(0.1), RigidTransform([2.0, y, 1.0]))
        _wall(room, 4.0)
        readings = room.measure(make(Sonar, room, sonar(rays=2000)))
        assert readings == pytest.approx([expected], abs=5 * MILLIMETRE)
    empty = Room()
    assert np.isinf(empty.measure(make(Sonar, empty, sonar())))


def test_the_ground_gives_a_sonar_an_echo_only_if_asked() -> None:
    for ground, expected in ((False, np.inf), (True, 1.0 / sin(pi / 12))):
        room = Room()
        readings = room.measure(make(Sonar, room, sonar(ground=ground, rays=5000)))
        assert readings == pytest.approx([expected], abs=0.02)


def test_a_radar_resolves_objects_and_measures_their_speeds() -> None:
    room = Room()
    room.starts[0] = (room.carrier, ABOVE, (10.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    room.body("lead", Box(2.0, 2.0, 2.0), X_WB=RigidTransform([41.0, 0.0, 1.0]), velocity=(4.0, 0.0, 0.0))
    room.body("oncoming", Sphere(0.5), X_WB=RigidTransform([20.0, -5.0, 1.0]), velocity=(-12.0, 0.0, 0.0))
    room.put(Cylinder(0.5, 4.0), RigidTransform([30.0, 10.0, 1.0]), "prop/pole/look0")
    room.put(Box(1.0, 1.0, 4.0), RigidTransform([0.0, 40.0, 1.0]), "prop/beside/look0")  # out of view
    readings = room.measure(make(Radar, room, radar(columns=600, rows=21, range_cell=5.0))).reshape(4, 3)
    pole, oncoming = np.hypot(30.0, 10.0), np.hypot(20.0, 5.0)
    assert readings[:, 0] == pytest.approx([oncoming - 0.5, pole - 0.5, 40.0, np.inf], abs=5 * MILLIMETRE)
    assert readings[:, 1] == pytest.approx([-np.arctan2(5.0, 20.0), np.arctan2(10.0, 30.0), 0.0, 0.0], abs=2e-3)
    assert readings[:, 2] == pytest.approx([-22.0 * 20.0 / oncoming, -10.0 * 30.0 / pole, -6.0, 0.0], abs=0.02)


def test_a_radar_that_turns_sees_still_things_approach_as_its_antenna_moves() -> None:
    room = Room()
    room.starts[0] = (room.carrier, ABOVE, (3.0, 0.0, 0.0), (0.0, 0.0, 0.7))
    _wall(room, 20.0)
    readings = room.measure(make(Radar, room, radar(targets=1, range_cell=0.01)))
    assert readings == pytest.approx([20.0, 0.0, -3.0], abs=5e-3)


# --- time and motion ---------------------------------------------------------------------------------------------


def test_a_moving_body_is_seen_where_it_is_at_every_sample() -> None:
    room = Room()
    room.body("lead", Box(1.0, 2.0, 2.0), X_WB=RigidTransform([10.5, 0.0, 1.0]), velocity=(7.0, 0.0, 0.0))
    sensor = make(LaserScanner, room, scanner(rolling=False, beams=11, start_angle=-0.05, end_angle=0.05))
    simulator = room.start(sensor)
    for k in range(5):
        simulator.AdvanceTo(0.1 * k + 0.05)
        expected = (10.0 + 0.7 * k) / np.cos(sensor.angles)
        assert np.abs(held(sensor, simulator) - expected).max() < 1e-6


def test_two_moving_bodies_are_as_far_apart_as_they_are() -> None:
    room = Room()
    room.starts[0] = (room.carrier, ABOVE, (5.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    room.body("lead", Box(1.0, 2.0, 2.0), X_WB=RigidTransform([20.5, 0.0, 1.0]), velocity=(2.0, 0.0, 0.0))
    sensor = make(LaserScanner, room, scanner(beams=21, start_angle=-0.04, end_angle=0.04))
    simulator = room.start(sensor)
    simulator.AdvanceTo(0.35)
    time = 0.3 + sensor.times
    assert np.abs(held(sensor, simulator) - (20.0 - 3.0 * time) / np.cos(sensor.angles)).max() < MILLIMETRE


@pytest.mark.parametrize("rate", [0.0, 0.8, -2.0])
def test_every_beam_leaves_from_where_the_sensor_was_at_its_time(rate: float) -> None:
    carousel = Carousel([3.0, 0.0, 1.0], rate=rate)
    sides = [(12.5, 0.0, 1.0, 60.0), (-12.5, 0.0, 1.0, 60.0), (0.0, 12.5, 60.0, 1.0), (0.0, -12.5, 60.0, 1.0)]
    grey = np.array([0.5, 0.5, 0.5, 1.0])
    for index, (x, y, dx, dy) in enumerate(sides):  # a square room of 24 m
        X_WG = RigidTransform([x, y, 0.0])
        carousel.plant.RegisterVisualGeometry(
            carousel.plant.world_body(), X_WG, Box(dx, dy, 20.0), f"prop/{index}", grey
        )
    plant = carousel.finalize()
    world = RayWorld(plant, carousel.scene_graph)
    mount = lidar(columns=121, rows=3, vertical_start=0.0, vertical_end=0.2)
    sensor = Lidar(world, carousel.mount, mount)
    simulator = carousel.start(sensor)
    simulator.AdvanceTo(0.55)
    scan = held(sensor, simulator, "cloud")
    assert scan.time == pytest.approx(0.5)
    assert scan.beam_times[[0, 60, -1]] == pytest.approx([0.4, 0.45, 0.5])
    expected = _in_the_room(rate * scan.beam_times, scan.azimuths) / np.cos(scan.elevations)[:, None]
    assert np.abs(scan.ranges - expected).max() < MILLIMETRE
    corners = np.abs(scan.points_in_world()[:, :2]).max(axis=1)
    assert np.abs(corners - 12.0).max() < MILLIMETRE
    at_once = _in_the_room(np.full(121, 0.5 * rate), scan.azimuths)
    assert (np.abs(at_once - scan.ranges[0]).max() > 0.1) == (rate != 0.0)


def _in_the_room(yaw: np.ndarray, azimuths: np.ndarray) -> np.ndarray:
    """Return level distances to the walls of the square room from the arm's end at its yaws."""
    x, y, heading = 3.0 * np.cos(yaw), 3.0 * np.sin(yaw), yaw + azimuths
    c, s = np.cos(heading), np.sin(heading)
    with np.errstate(divide="ignore"):
        across, along = np.where(c > 0.0, 12.0 - x, -12.0 - x) / c, np.where(s > 0.0, 12.0 - y, -12.0 - y) / s
    level: np.ndarray = np.minimum(across, np.abs(along))
    return level


def test_a_turning_car_casts_each_column_from_its_own_pose() -> None:
    """A Bolt on a circle: the middle column points where the car did a twentieth of a second before."""
    spec: dict[str, Any] = {
        "world": "empty",
        "vehicles": {"ego": {"model": "mkz", "speed": 8.0, "start": {"x": 0.0, "y": 0.0, "yaw": 0.0}}},
        "control": {"ego": {"kind": "constant", "speed": 8.0, "steering": 0.15}},
        "sensors": {"ego": ["roof_lidar"]},
        "plant": {"contact": "point"},
    }
    assembly = assemble(spec)
    sensor = assembly.diagram.GetSubsystemByName("ego.roof_lidar")
    simulator = Simulator(assembly.diagram, assembly.make_context())
    simulator.AdvanceTo(2.0005)
    context = simulator.get_context()
    before = held(sensor, simulator, "cloud")
    simulator.AdvanceTo(2.1005)
    scan = held(sensor, simulator, "cloud")
    assert np.allclose(scan.beam_times[[0, -1]], [2.0, 2.1])
    # The pose at the first column is that of the last column of the turn before.
    turned = scan.pose[:, :3].T @ before.pose[:, :3]
    yaw = np.arctan2(turned[1, 0], turned[0, 0])
    assert yaw == pytest.approx(-0.1 * scan.twist[2], rel=0.02)
    assert np.hypot(*scan.twist[3:5]) == pytest.approx(8.0, rel=0.05)
    # Returns from the flat ground are on the ground, whatever the car did meanwhile.
    ground = scan.points_in_world()
    assert len(ground) > 1000
    assert np.abs(ground[:, 2]).max() < 0.15  # noise of 3 cm along beams that point down by up to 15 degrees
    assert context.get_time() == pytest.approx(2.1005)


def test_samples_are_taken_at_the_rate_and_shown_after_the_latency() -> None:
    room = Room()
    _wall(room, 10.0)
    room.starts[0] = (room.carrier, ABOVE, (1.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    mount = {"rate": 30.0, "latency": 0.02, "rolling": False, "beams": 1, "start_angle": 0.0}
    sensor = make(LaserScanner, room, scanner(**mount))
    simulator = room.start(sensor)
    for k in range(12):
        simulator.AdvanceTo(k / 30.0 + 0.02 - 1e-4)
        earlier = held(sensor, simulator, "stamp")[0]
        assert earlier == (pytest.approx((k - 1) / 30.0, abs=1e-12) if k else -np.inf)
        simulator.AdvanceTo(k / 30.0 + 0.02 + 1e-4)
        assert held(sensor, simulator, "stamp")[0] == pytest.approx(k / 30.0, abs=1e-12)
        assert held(sensor, simulator)[0] == pytest.approx(10.0 - k / 30.0, abs=0.006)  # a plant step of 5 ms


# --- noise -------------------------------------------------------------------------------------------------------


def _readings(seed: int = 1, **more: Any) -> np.ndarray:
    room = Room()
    _wall(room, 20.0)
    data = {"beams": 20_000, "start_angle": -1e-6, "end_angle": 1e-6} | more  # all beams see one distance
    return np.asarray(room.measure(make(LaserScanner, room, scanner(**data), stream=seed)))


def test_noise_has_its_standard_deviation_and_no_mean() -> None:
    error = _readings(noise=0.03) - 20.0
    assert error.std() == pytest.approx(0.03, rel=0.02)
    assert abs(error.mean()) < 4.0 * 0.03 / np.sqrt(error.size)
    assert np.abs(np.corrcoef(error[:-1], error[1:])[0, 1]) < 0.03


def test_readings_come_in_steps() -> None:
    steps = _readings(noise=0.1, resolution=0.05) / 0.05
    assert np.abs(steps - np.rint(steps)).max() < 1e-6
    assert len(np.unique(np.rint(steps))) > 8


def test_beams_are_lost_at_random() -> None:
    lost = np.isinf(_readings(lost_beams=0.1))
    assert lost.mean() == pytest.approx(0.1, abs=4.0 * np.sqrt(0.09 / lost.size))


def test_readings_stay_within_the_limits() -> None:
    readings = _readings(noise=1.0, far=20.5)
    assert readings.max() == 20.5
    assert np.isfinite(readings).all()


def test_the_same_seed_gives_the_same_noise_and_another_another() -> None:
    first, again, other = (_readings(seed, noise=0.03, beams=50) for seed in (1, 1, 2))
    assert (first == again).all()
    assert (first != other).all()


# --- on vehicles -------------------------------------------------------------------------------------------------


def _drive(sensors: list[str], model: str = "mkz", **more: Any) -> dict[str, Any]:
    return {
        "world": "empty",
        "vehicles": {"ego": {"model": model}, "other": {"model": "bolt", "start": {"x": 12.0, "y": 0.0, "yaw": 0.0}}},
        "control": {name: {"kind": "constant", "speed": 0.0} for name in ("ego", "other")},
        "sensors": {"ego": sensors},
        "plant": {"contact": "point"},
        **more,
    }


def test_a_vehicle_sees_another_but_not_itself() -> None:
    assembly = assemble(_drive(["roof_lidar"]))
    sensor = assembly.diagram.GetSubsystemByName("ego.roof_lidar")
    context = sensor.GetMyContextFromRoot(assembly.make_context())
    hits = sensor.caster.look(context)
    names = {sensor.caster.world.objects[index] for index in np.unique(hits.object_index) if index >= 0}
    assert names == {"ground", "other"}
    nearest = hits.distance[hits.object_index == sensor.caster.world.objects.index("other")].min()
    # Its rear axle is at 12 m, its tail up to 1 m behind that; the lidar is 1.1 m ahead of the origin, and looks down.
    assert 9.7 < nearest < 11.0


def test_its_own_vehicle_can_be_seen() -> None:
    vehicle = load_vehicle("mkz")
    mount = vehicle.sensors.mounts["roof_lidar"]
    assert isinstance(mount, LidarMount)
    assembly = assemble(_drive(["roof_lidar"]))
    part = assembly.parts.vehicles["ego"]
    own = mount.model_copy(update={"own_vehicle": True}).make(parts=assembly.parts, part=part, stream=1)
    without = mount.make(parts=assembly.parts, part=part, stream=1)
    bodies = {int(index) for index in assembly.parts.plant.GetBodyIndices(part.instance)}
    assert bodies & set(own.caster._movers)
    assert not bodies & set(without.caster._movers)


def test_a_rolling_lidar_sees_the_body_that_carries_it() -> None:
    """The roof below it moves along, so that it is where it was in every column."""
    room = Room()
    room.plant.RegisterVisualGeometry(
        room.carrier, RigidTransform([0.0, 0.0, -0.5]), Box(4.0, 4.0, 0.2), "roof", np.ones(4)
    )
    room.starts[0] = (room.carrier, ABOVE, (3.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    down = lidar(columns=36, rows=2, vertical_start=-0.5, vertical_end=-0.5 + 1e-9)
    sensor = make(Lidar, room, down)
    simulator = room.start(sensor)
    simulator.AdvanceTo(0.35)
    hits = sensor.caster.look(sensor.GetMyContextFromRoot(simulator.get_context()))
    assert hits.distance == pytest.approx(0.4 / sin(0.5), abs=MILLIMETRE)


def test_a_run_with_all_of_them_is_the_same_twice() -> None:
    runs = [
        Simulation(assemble(_drive(["roof_lidar", "sonar_front_left"]) | {"seed": 3})).run(duration=0.3)
        for _ in range(2)
    ]
    name = next(column for column in runs[0].signals if str(column).startswith("ego.sonar_front_left"))
    assert runs[0].signals[name].equals(runs[1].signals[name])


def test_kinds_are_registered() -> None:
    assert {"laser_scanner", "lidar", "sonar", "radar"} <= set(SENSORS)
    assert (LaserScanner.record, Lidar.record, Sonar.record, Radar.record) == ("array", "array", None, None)


def test_a_scan_that_was_never_taken_has_no_points() -> None:
    room = Room()
    sensor = make(Lidar, room, lidar())
    scan = held(sensor, room.start(sensor), "cloud")
    assert isinstance(scan, LidarScan)
    assert scan.time == -np.inf
    assert len(scan.points()) == 0
    assert len(scan.points_in_world()) == 0


# --- rejected input ----------------------------------------------------------------------------------------------

LASER = "{kind: laser_scanner, frame: s, rate: 10, beams: 5, start_angle: -1, end_angle: 1, near: 1, far: 5}"
LIDAR = (
    "{kind: lidar, frame: s, rate: 10, columns: 100, rows: 16, horizontal_start: -1, horizontal_end: 1, "
    "vertical_start: 0, vertical_end: 1, near: 1, far: 5}"
)
RADAR = "{kind: radar, frame: s, rate: 10, horizontal_fov: 1, vertical_fov: 0.1, near: 1, far: 5}"
SONAR = "{kind: sonar, frame: s, rate: 10, cone: 0.5, near: 1, far: 5}"


@pytest.mark.parametrize(
    ("text", "old", "new", "message"),
    [
        (LASER, "near: 1", "near: 5", r"near \(5 m\) must be below far \(5 m\)"),
        (SONAR, "near: 1", "near: 6", r"near \(6 m\) must be below far \(5 m\)"),
        (RADAR, "rate: 10", "rate: 0", r"rate: .*0"),
        (LIDAR, "rate: 10", "rate: -1", r"rate: .*"),
        (LASER, "end_angle: 1", "end_angle: 5.5", r"from -1 to 5.5 rad is more than a full turn"),
        (LIDAR, "horizontal_end: 1", "horizontal_end: 6", r"from -1 to 6 rad is more than a full turn"),
        (LIDAR, "columns: 100", "columns: 90000", r"90000 columns x 16 rows are 1440000 rays .* at most 1000000"),
        (RADAR, "near: 1", "columns: 100000, rows: 11, near: 1", r"100000 columns x 11 rows are 1100000 rays"),
        (LASER, "beams: 5", "beams: 100001", r"beams: .*100000"),
        (SONAR, "cone: 0.5", "cone: 180 deg", r"cone: .*3.14"),
        (SONAR, "cone: 0.5", "cone: 0.5, rays: 0", r"rays: .*"),
        (LASER, "beams: 5", "beams: 5, lost_beams: 1", r"lost_beams: .*"),
        (RADAR, "near: 1", "targets: 0, near: 1", r"targets: .*"),
    ],
)
def test_impossible_values_are_rejected_with_their_line(text: str, old: str, new: str, message: str) -> None:
    assert old in text
    parse_yaml(f"mounts:\n  s: {text}\n", SensorsSpec)
    with pytest.raises(ConfigError, match=rf"<text>:2: mounts\.s.*{message}"):
        parse_yaml(f"mounts:\n  s: {text.replace(old, new, 1)}\n", SensorsSpec)


def test_a_frame_that_is_not_there_is_rejected(tmp_path: Path) -> None:
    shutil.copytree(data_root() / "models" / "bolt", tmp_path / "bolt")
    (tmp_path / "bolt" / "sensors.yaml").unlink()
    (tmp_path / "bolt" / "sensors.yaml").write_text(f"mounts:\n  s: {SONAR.replace('frame: s', 'frame: gsp')}\n")
    with pytest.raises(ConfigError, match=r"sensors.yaml:2: mounts.s.frame: no link 'gsp'; did you mean 'gps'\?"):
        load_vehicle(str(tmp_path / "bolt"))


def test_without_embreex_the_message_names_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "embreex.mesh_construction", None)
    triangle = flat_faces(np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]), [[0, 1, 2]])
    with pytest.raises(MissingDependencyError, match="pip install embreex"):
        RayScene(triangle)


def test_an_empty_world_is_dark() -> None:
    room = Room()
    readings = room.measure(make(LaserScanner, room, scanner(), ground=False))
    assert np.isinf(readings).all()
    tilted = Room()
    tilted.starts[0] = (
        tilted.carrier,
        RigidTransform(RollPitchYaw(0.0, 0.1, 0.0), [0.0, 0.0, 1.0]),
        (0.0, 0.0, 0.0),
        (0.0, 0.0, 0.0),
    )
    readings = tilted.measure(make(LaserScanner, tilted, scanner()))
    assert readings[180] == pytest.approx(1.0 / sin(0.1), abs=MILLIMETRE)
    assert readings[150] == pytest.approx(1.0 / (sin(0.1) * cos(pi / 12)), abs=MILLIMETRE)
