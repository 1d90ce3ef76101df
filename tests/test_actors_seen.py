"""Actors are seen where they are at the time of each beam and picture, and are judged and recorded."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydrake.systems.framework import Context

from mirdrake.runs.logs import load_run
from mirdrake.sensors.ranging.lidar import LidarScan
from mirdrake.viewer import make_meshcat
from mirdrake.viewer.cockpit import Cockpit, drive_spec
from mirdrake.viewer.recording import draw_run
from mirdrake.worlds.actors import WHEELBASE
from tests.actor_rigs import simulation, world_file

SPEED = 15.0  # [m/s] of the actor
LENGTH, WIDTH, HEIGHT = 4.0, 0.2, 2.0  # [m] of the prop "wall"
AXLE = 0.5 * WHEELBASE * LENGTH  # [m] from its rear axle to its middle
ACTOR = {"actor": "wall", "name": "bus", "speed": SPEED}
LIDAR = {"preset": "velodyne_vlp16", "noise": 0.0, "resolution": 0.0}


def crossing(x: float, *, begin: float = -40.0) -> dict[str, Any]:
    """Return an actor that crosses ahead of the vehicle, to the left."""
    return ACTOR | {"path": [[x, begin], [x, 400.0]]}


def middle(time: Any, begin: float = -40.0) -> Any:
    """Return y of the middle of the crossing actor [m]: it moves at a constant speed from the begin of its path."""
    return begin + SPEED * time + AXLE


@pytest.mark.slow
def test_lidar_sees_an_actor_at_the_time_of_each_beam(tmp_path: Path) -> None:
    world = world_file(tmp_path, actors=[crossing(12.0)], tracks=None)
    drive = simulation(world, sensors={"ego": ["roof_lidar"]}, ego={"mounts": {"roof_lidar": LIDAR}})
    port = drive.assembly.ports["ego.roof_lidar.cloud"]
    scans: dict[float, LidarScan] = {}

    def keep(context: Context) -> None:
        scan: LidarScan = port.Eval(port.get_system().GetMyContextFromRoot(context))
        scans.setdefault(scan.time, scan)

    drive.run(duration=4.5, monitor=keep)
    checked = 0
    for scan in scans.values():
        if not np.isfinite(scan.time) or scan.time < 0.15:
            continue
        sine, cosine = np.sin(scan.elevations)[:, None], np.cos(scan.elevations)[:, None]
        local = np.stack(
            (cosine * np.cos(scan.azimuths), cosine * np.sin(scan.azimuths), sine + 0.0 * scan.azimuths), axis=-1
        )
        with np.errstate(invalid="ignore"):
            points = (local * scan.ranges[:, :, None]) @ scan.pose[:, :3].T + scan.pose[:, 3]
        beam_times = np.broadcast_to(scan.beam_times, scan.ranges.shape)
        hit = np.isfinite(scan.ranges) & (points[:, :, 2] > 0.05)  # not on the ground
        x, y, z = points[hit].T
        along = y - middle(beam_times[hit])
        # Each hit is on the surface of the box at its own time: on the near face, or on one of its ends.
        box = np.array([0.5 * WIDTH, 0.5 * LENGTH])
        beyond = np.maximum(np.abs(np.column_stack((x - 12.0, along))) - box, 0.0)
        assert np.hypot(*beyond.T).max(initial=0.0) < 0.02
        assert (z < HEIGHT + 0.02).all()
        inside = np.minimum(box[0] - np.abs(x - 12.0), box[1] - np.abs(along))
        assert inside.max(initial=0.0) < 0.02
        checked += hit.sum() > 20
    assert checked >= 20


@pytest.mark.slow
def test_label_picture_shows_an_actor_where_it_is(tmp_path: Path) -> None:
    world = world_file(tmp_path, actors=[crossing(25.0, begin=-12.0)], tracks=None)
    mount = {"front_camera": {"label": True, "rate": 30, "width": 640, "height": 480}}
    sensors = {"ego": ["front_camera"]}
    record = {"meshcat": False, "report": False, "cameras": True}
    drive = simulation(world, sensors=sensors, ego={"mounts": mount}, record=record)
    run = drive.run(duration=1.6, folder=tmp_path / "run")
    part = drive.assembly.parts.vehicles["ego"]
    spec: Any = part.vehicle.sensors.mounts["front_camera"]
    plant = drive.assembly.parts.plant
    frame = plant.GetFrameByName(spec.frame, part.instance)
    system = drive.assembly.cameras["ego.front_camera"][0]
    number = next(label for label, name in system.labels.items() if name == "actor/bus")
    focal = 0.5 * 640 / np.tan(0.5 * spec.horizontal_fov)
    X_WS = frame.CalcPoseInWorld(plant.GetMyContextFromRoot(drive.assembly.make_context()))  # the vehicle stands
    checked = 0
    for picture in run.pictures["ego.front_camera.label"]:
        corners = [
            [25.0 + a * WIDTH / 2, middle(picture.time, -12.0) + b * LENGTH / 2, c * HEIGHT]
            for a in (-1, 1) for b in (-1, 1) for c in (0, 1)
        ]  # fmt: skip
        p = np.array([X_WS.inverse() @ np.array(corner) for corner in corners])
        u, v = 319.5 - focal * p[:, 1] / p[:, 0], 239.5 - focal * p[:, 2] / p[:, 0]
        if u.min() < 2 or u.max() > 637:
            continue
        rows, columns = np.nonzero(picture.pixels == number)
        assert abs(columns.min() - u.min()) < 1.0
        assert abs(columns.max() - u.max()) < 1.0
        assert abs(rows.min() - v.min()) < 1.0
        checked += 1
    assert checked >= 20


def test_radar_and_sonar_measure_the_range_of_an_actor(tmp_path: Path) -> None:
    world = world_file(tmp_path, actors=[ACTOR | {"path": [[100, 0], [0, 0]]}], tracks=None)
    preset = {"kind": "radar", "frame": "front_camera", "rate": 20, "near": 0.5, "far": 150, "targets": 2}
    preset |= {"horizontal_fov": 0.05, "vertical_fov": 0.05}
    drive = simulation(world, sensors={"ego": ["front_camera"]}, ego={"mounts": {}}, duration=2.0)
    from mirdrake.sensors.ranging.radar import RadarMount
    from mirdrake.sensors.ranging.sonar import SonarMount

    echo = {"kind": "sonar", "frame": "front_camera", "rate": 20, "near": 0.5, "far": 150, "cone": 0.02, "rays": 50}
    parts = drive.assembly.parts
    radar, sonar = (
        mount.make(parts=parts, part=parts.vehicles["ego"], stream=0)
        for mount in (RadarMount(**preset), SonarMount(**echo))
    )
    port = drive.assembly.diagram.GetSubsystemByName("traffic").states
    readings: list[tuple[float, Any, float]] = []

    def reading(system: Any, context: Context) -> Any:
        own = system.CreateDefaultContext()
        own.SetTime(context.get_time())
        plant = parts.plant
        plant_context = plant.GetMyContextFromRoot(context)
        for name in ("body_poses", "body_spatial_velocities"):
            value = plant.GetOutputPort(name).EvalAbstract(plant_context)
            system.GetInputPort(name).FixValue(own, value)
        states = port.Eval(port.get_system().GetMyContextFromRoot(context))
        system.GetInputPort("actor_states").FixValue(own, states)
        return system.measure(own)

    def keep(context: Context) -> None:
        readings.append((context.get_time(), reading(radar, context), float(reading(sonar, context)[0])))

    drive.run(duration=0.5, monitor=keep)
    frame = parts.plant.GetFrameByName("front_camera")
    X_WS = frame.CalcPoseInWorld(parts.plant.GetMyContextFromRoot(drive.assembly.make_context()))
    for time, sample, distance in readings[10:]:
        front = 100.0 - SPEED * time - AXLE - 0.5 * LENGTH
        assert sample[0] == pytest.approx(front - X_WS.translation()[0], abs=0.02)
        assert sample[2] == pytest.approx(-SPEED, abs=0.05)
        assert distance == pytest.approx(front - X_WS.translation()[0], abs=0.02)


def test_ranges_and_clearance_know_actors(tmp_path: Path) -> None:
    world = world_file(tmp_path, actors=[ACTOR | {"path": [[30, 0], [300, 0]], "speed": 0}], tracks=None)
    drive = simulation(world, speed=5.0, control={"ego": {"kind": "obstacle_stopper", "speed": 5, "distance": 3}})
    run = drive.run(duration=9.0)
    end = 30.0 + AXLE - 0.5 * LENGTH  # the rear end of the wall
    front = max(float(x) for x in drive._volumes["ego"].outline[:, 0])
    left = end - front - float(run["ego.x"].iloc[-1])
    assert left == pytest.approx(3.0, abs=0.15)
    assert run["ego.vx"].iloc[-1] == pytest.approx(0.0, abs=0.02)


def test_the_cockpit_draws_actors_without_any_sensor(tmp_path: Path) -> None:
    world = world_file(tmp_path, actors=[crossing(12.0)], tracks=None)
    data = {"world": str(world), "vehicles": {"ego": {"model": "bolt"}}, "plant": {"contact": "point"}}
    meshcat = make_meshcat(port=0)
    cockpit = Cockpit(drive_spec(data), meshcat=meshcat)
    assert cockpit.picture is not None
    cockpit.picture.draw(cockpit.assembly.make_context(), passed=0.1)
    assert meshcat.HasPath("visualizer/actor/bus")


def test_a_collision_between_samples_is_recorded(tmp_path: Path) -> None:
    begin = -10.0
    world = world_file(tmp_path, actors=[crossing(20.0, begin=begin)], tracks=None)
    drive = simulation(world, speed=25.0)
    run = drive.run(duration=1.2, folder=tmp_path / "run")
    events = [event for event in run.events if event["kind"] == "collision"]
    assert len(events) == 1
    assert "ego: collision with 'bus'" in events[0]["text"]
    reached = 20.0 - 0.5 * WIDTH - max(float(x) for x in drive._volumes["ego"].outline[:, 0])
    assert events[0]["time"] == pytest.approx(reached / 25.0, abs=0.02)
    assert run.summary["vehicles"]["ego"]["collisions"][0]["difference_mps"] == pytest.approx(np.hypot(25, 15), abs=0.3)

    # A recording has it as well.
    meshcat = make_meshcat(port=0)
    draw_run(load_run(tmp_path / "run"), meshcat)
    assert meshcat.HasPath("visualizer/actor/bus")

    # The run folder has the actor: its own table with units, the same samples, and the world to draw it in.
    stored = load_run(tmp_path / "run")
    assert stored.actors["bus.y"].iloc[25] == pytest.approx(begin + 0.5 * SPEED, abs=1e-9)
    assert stored.units["actors.bus.speed"] == "m/s"
    assert [actor.name for actor in stored.scene().world.actors] == ["bus"]
    assert not any(str(name).startswith("bus") for name in stored.signals)
