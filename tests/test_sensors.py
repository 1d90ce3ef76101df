"""IMU, GPS and camera against numbers worked by hand."""

import sys
from collections.abc import Callable, Sequence
from math import pi, radians, tan
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from PIL import Image
from pydrake.geometry import Box, RenderEngineVtkParams
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.plant import AddMultibodyPlant, MultibodyPlant, MultibodyPlantConfig
from pydrake.multibody.tree import FixedOffsetFrame, RevoluteJoint, SpatialInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, System
from pydrake.systems.primitives import VectorLogSink

from mirdrake.cli import main
from mirdrake.diagram import assemble, make_diagram
from mirdrake.errors import ConfigError, MissingDependencyError
from mirdrake.logs import Run, load_run, picture_name
from mirdrake.sensors import Camera, Gps, Imu, camera
from mirdrake.sensors.noise import noise_stream
from mirdrake.signals import signals_of
from mirdrake.simulation import Simulation
from mirdrake.vehicles.mounts import CameraMount

GRAVITY = 9.80665
FAULT = camera._egl_fault()
needs_egl = pytest.mark.skipif(FAULT is not None, reason=f"cameras cannot be drawn here: {FAULT}")


# --- a carousel: an arm that turns about the world's z axis -------------------------------------------------------


class Carousel:
    """An arm on a vertical axis through the origin, with a mounting frame on it, and a sensor that is logged."""

    def __init__(
        self, place: Sequence[float], *, rpy: Sequence[float] = (0.0, 0.0, 0.0), angle: float = 0.0, rate: float = 0.0
    ) -> None:
        self.builder = DiagramBuilder()
        config = MultibodyPlantConfig(time_step=0.005, use_sampled_output_ports=False)
        self.plant, self.scene_graph = AddMultibodyPlant(config, self.builder)
        self.plant.mutable_gravity_field().set_gravity_vector([0.0, 0.0, -GRAVITY])
        arm = self.plant.AddRigidBody("arm", SpatialInertia.SolidBoxWithMass(1.0, 1.0, 1.0, 1.0))
        axis = RevoluteJoint("axis", self.plant.world_frame(), arm.body_frame(), [0.0, 0.0, 1.0])
        self.joint = self.plant.AddJoint(axis)
        X_BS = RigidTransform(RollPitchYaw(*rpy), place)
        self.mount = self.plant.AddFrame(FixedOffsetFrame("mount", arm, X_BS))
        self.angle, self.rate = angle, rate

    def finalize(self) -> MultibodyPlant:
        self.plant.Finalize()
        return self.plant

    def run(self, sensor: System, duration: float, *, rate: float) -> np.ndarray:
        """Samples of the sensor, n x time; the log looks midway between two of them."""
        plant = self.plant
        feeds = {
            "body_poses": plant.get_body_poses_output_port(),
            "body_spatial_velocities": plant.get_body_spatial_velocities_output_port(),
            "body_spatial_accelerations": plant.get_body_spatial_accelerations_output_port(),
        }
        self.builder.AddSystem(sensor)
        for port in map(sensor.get_input_port, range(sensor.num_input_ports())):
            self.builder.Connect(feeds[port.get_name()], port)
        log = self.builder.AddSystem(VectorLogSink(sensor.sample.size(), publish_period=0.5 / rate))
        self.builder.Connect(sensor.sample, log.get_input_port())
        simulator = Simulator(self.builder.Build())
        context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
        self.joint.set_angle(context, self.angle)
        self.joint.set_angular_rate(context, self.rate)
        simulator.Initialize()
        simulator.AdvanceTo(duration)
        data: np.ndarray = log.FindLog(simulator.get_context()).data()[:, 1::2].copy()
        return data


def imu_reading(carousel: Carousel) -> np.ndarray:
    plant = carousel.finalize()
    reading: np.ndarray = carousel.run(Imu(plant, carousel.mount, rate=100.0), 0.1, rate=100.0)[:, -1]
    return reading


# --- IMU ---------------------------------------------------------------------------------------------------------


def test_an_imu_at_rest_on_the_level_reads_gravity_upwards() -> None:
    assert imu_reading(Carousel([1.0, 2.0, 3.0])) == pytest.approx([0.0, 0.0, 9.80665, 0.0, 0.0, 0.0], abs=1e-12)


def test_an_imu_rolled_by_30_degrees_to_the_right_reads_half_of_gravity_to_the_left() -> None:
    # roll +30 deg about x lifts the left side: y points up by 30 deg, f_y = g sin 30, f_z = g cos 30
    reading = imu_reading(Carousel([0.0, 0.0, 0.0], rpy=(radians(30), 0.0, 0.0)))
    assert reading[:3] == pytest.approx([0.0, 4.903325, 8.492808], abs=1e-6)


def test_an_imu_on_a_circle_reads_the_centripetal_force_of_its_own_place() -> None:
    # 0.5 rad/s about a centre 10 m to the left (v = 5 m/s, v²/R = 2.5 m/s²); mounted 1 m ahead of the point abeam:
    # acceleration -w² (1, -10) = (-0.25, 2.5) m/s²
    reading = imu_reading(Carousel([1.0, -10.0, 0.0], rate=0.5))
    assert reading == pytest.approx([-0.25, 2.5, 9.80665, 0.0, 0.0, 0.5], abs=1e-9)


def test_an_imu_that_is_mounted_turned_reads_in_its_own_frame() -> None:
    # turned by +90 deg: its x axis is the arm's y, its y axis the arm's -x
    reading = imu_reading(Carousel([1.0, -10.0, 0.0], rpy=(0.0, 0.0, pi / 2), rate=0.5))
    assert reading == pytest.approx([2.5, 0.25, 9.80665, 0.0, 0.0, 0.5], abs=1e-9)


def test_an_imu_in_free_fall_reads_no_force() -> None:
    builder = DiagramBuilder()
    config = MultibodyPlantConfig(time_step=0.005, use_sampled_output_ports=False)
    plant, _ = AddMultibodyPlant(config, builder)
    body = plant.AddRigidBody("stone", SpatialInertia.SolidBoxWithMass(1.0, 1.0, 1.0, 1.0))
    plant.Finalize()
    imu = builder.AddSystem(Imu(plant, body.body_frame(), rate=100.0))
    for name, port in (
        ("body_poses", plant.get_body_poses_output_port()),
        ("body_spatial_velocities", plant.get_body_spatial_velocities_output_port()),
        ("body_spatial_accelerations", plant.get_body_spatial_accelerations_output_port()),
    ):
        builder.Connect(port, imu.GetInputPort(name))
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(0.1)
    assert imu.sample.Eval(imu.GetMyContextFromRoot(simulator.get_context())) == pytest.approx(np.zeros(6), abs=1e-12)


def test_the_noise_of_an_imu_has_its_two_standard_deviations() -> None:
    carousel = Carousel([0.0, 0.0, 0.0])
    plant = carousel.finalize()
    imu = Imu(plant, carousel.mount, rate=100.0, acceleration_noise=0.02, gyro_noise=0.002, stream=noise_stream(0, "a"))
    samples = carousel.run(imu, 20.0, rate=100.0)
    assert samples.shape == (6, 2000)
    assert samples.std(axis=1) == pytest.approx([0.02] * 3 + [0.002] * 3, rel=0.1)
    assert samples.mean(axis=1) == pytest.approx([0, 0, GRAVITY, 0, 0, 0], abs=4 * 0.02 / 2000**0.5)
    assert np.abs(np.corrcoef(samples) - np.eye(6)).max() < 0.1  # 4.5 standard deviations of 1/sqrt(2000)


def test_the_elements_of_an_imu_have_names_and_units() -> None:
    carousel = Carousel([0.0, 0.0, 0.0])
    contents = signals_of(Imu(carousel.finalize(), carousel.mount, rate=100.0).sample)
    assert contents is not None
    assert [(signal.name, signal.unit) for signal in contents][2:4] == [("fz", "m/s²"), ("wx", "rad/s")]


# --- GPS ---------------------------------------------------------------------------------------------------------


def test_a_gps_without_noise_gives_the_place_of_its_antenna() -> None:
    # the arm points along the world's y axis: 3 m ahead and 1 m to the left are x = -1 m, y = 3 m
    carousel = Carousel([3.0, 1.0, 2.0], angle=pi / 2)
    carousel.finalize()
    samples = carousel.run(Gps(carousel.mount, rate=10.0), 0.3, rate=10.0)
    assert samples == pytest.approx(np.tile([[-1.0], [3.0], [2.0]], 3), abs=1e-12)


def test_a_gps_holds_the_place_of_its_last_sample() -> None:
    # 1 rad/s at 2 m: the sample at 0.1 s is shown at 0.15 s
    carousel = Carousel([2.0, 0.0, 0.0], rate=1.0)
    carousel.finalize()
    samples = carousel.run(Gps(carousel.mount, rate=10.0), 0.2, rate=10.0)
    assert samples[:, 1] == pytest.approx([1.990008, 0.199667, 0.0], abs=1e-6)  # 2 cos 0.1, 2 sin 0.1


def test_the_noise_of_a_gps_is_horizontal_and_has_its_standard_deviation() -> None:
    carousel = Carousel([0.0, 0.0, 2.0])
    carousel.finalize()
    x, y, z = carousel.run(Gps(carousel.mount, rate=100.0, noise=1.5, stream=7), 20.0, rate=100.0)
    assert [x.std(), y.std()] == pytest.approx([1.5, 1.5], rel=0.1)
    assert [x.mean(), y.mean()] == pytest.approx([0.0, 0.0], abs=4 * 1.5 / 2000**0.5)
    assert abs(np.corrcoef(x[1:], x[:-1])[0, 1]) < 0.1  # white
    assert np.all(z == 2.0)


# --- in a diagram ------------------------------------------------------------------------------------------------


def parked(sensors: Sequence[str], **more: Any) -> dict[str, Any]:
    """A Bolt that stands on an empty plane, with sensors."""
    return {
        "world": "empty",
        "vehicles": {"ego": {"model": "bolt"}},
        "control": {"ego": {"kind": "constant", "speed": 0.0}},
        "sensors": {"ego": list(sensors)},
        "plant": {"contact": "point"},
        "record": {"meshcat": False, "report": False},
    } | more


def run(sensors: Sequence[str], **more: Any) -> Run:
    return Simulation(assemble(parked(sensors, **more))).run(duration=0.2)


def test_sensors_are_columns_of_the_signals_with_units() -> None:
    done = run(["gps", "imu"])
    names = [name for name in done.signals.columns if name.startswith(("ego.gps", "ego.imu"))]
    assert names == [*(f"ego.gps.{a}" for a in "xyz"), *(f"ego.imu.{a}" for a in ("fx", "fy", "fz", "wx", "wy", "wz"))]
    assert [done.units[name] for name in ("ego.gps.x", "ego.imu.fx", "ego.imu.wz")] == ["m", "m/s²", "rad/s"]
    assert done["ego.imu.fz"].mean() == pytest.approx(GRAVITY, abs=0.03)  # noise of 0.02 m/s², 11 samples


def test_equal_seeds_give_equal_samples_and_others_do_not() -> None:
    first, again, other = run(["imu"], seed=3), run(["imu"], seed=3), run(["imu"], seed=4)
    assert first.signals.equals(again.signals)
    assert not np.any(first["ego.imu.wz"].to_numpy()[1:] == other["ego.imu.wz"].to_numpy()[1:])


def test_one_more_sensor_changes_nothing_about_the_noise_of_the_others() -> None:
    alone, together = run(["imu"]), run(["gps", "imu"])
    names = [name for name in alone.signals.columns if name.startswith("ego.imu")]
    assert len(names) == 6
    assert alone.signals[names].equals(together.signals[names])


def test_sensors_are_outputs_of_a_diagram() -> None:
    diagram = make_diagram(parked(["gps", "imu"]))
    assert [diagram.GetOutputPort(name).size() for name in ("ego.gps", "ego.imu")] == [3, 6]


def test_a_sensor_that_is_named_twice_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"sensors\.ego\.1: 'imu' is named twice"):
        assemble(parked(["imu", "imu"]))


def test_a_camera_that_nobody_looks_through_is_not_there(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(camera, "_egl_fault", lambda: "not installed")
    assembly = assemble(parked(["front_camera"]))
    assert assembly.parts.scene_graph.RendererCount() == 0
    assert not assembly.diagram.HasSubsystemNamed("ego.front_camera")
    assert assembly.unread == ("ego.front_camera.color_image",)


def test_recording_cameras_without_a_camera_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"record\.cameras: no camera is in use; name one under sensors"):
        assemble(parked(["imu"], record={"cameras": True}))


def test_without_egl_the_message_names_the_packages(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(camera, "_egl_fault", lambda: "libEGL.so.1 is not installed")
    monkeypatch.setattr(sys, "platform", "linux")
    with pytest.raises(MissingDependencyError, match=r"libEGL.*apt install libegl1 libgl1-mesa-dri"):
        assemble(parked(["front_camera"], record={"cameras": True}))


# --- camera ------------------------------------------------------------------------------------------------------

WIDTH, HEIGHT = 320, 240


def camera_mount(**numbers: Any) -> CameraMount:
    data = {"frame": "mount", "rate": 10.0, "width": WIDTH, "height": HEIGHT, "horizontal_fov": pi / 2}
    return CameraMount(kind="camera", **(data | numbers))


class Studio:
    """A camera at (1, 2, 3) m that looks along the world's y axis, before a black background."""

    def __init__(self, furnish: Callable[[MultibodyPlant], None] = lambda _: None, **numbers: Any) -> None:
        builder = DiagramBuilder()
        plant, scene_graph = AddMultibodyPlant(MultibodyPlantConfig(time_step=0.01), builder)
        X_WS = RigidTransform(RollPitchYaw(0.0, 0.0, pi / 2), [1.0, 2.0, 3.0])
        frame = plant.AddFrame(FixedOffsetFrame("mount", plant.world_body(), X_WS))
        furnish(plant)
        plant.Finalize()
        grey = [0.5, 0.5, 0.5] if "noise" in numbers else [0.0, 0.0, 0.0]
        camera.add_renderer(scene_graph, "studio", RenderEngineVtkParams(default_clear_color=grey))
        self.camera = builder.AddSystem(Camera(plant, frame, camera_mount(**numbers), renderer="studio", stream=1))
        builder.Connect(scene_graph.get_query_output_port(), self.camera.GetInputPort("query_object"))
        self.simulator = Simulator(builder.Build())

    def held(self) -> np.ndarray:
        port = self.camera.GetOutputPort("color_image")
        data: np.ndarray = port.Eval(self.camera.GetMyContextFromRoot(self.simulator.get_context())).data.copy()
        return data


@needs_egl
@pytest.mark.parametrize(("ahead", "left", "up"), [(8.0, 0.0, 0.0), (8.0, 3.0, 1.0), (10.0, -6.0, -4.0)])
def test_a_known_point_is_seen_at_its_pixel(ahead: float, left: float, up: float) -> None:
    def furnish(plant: MultibodyPlant) -> None:
        # the camera looks along +y of the world, its left is -x
        place = RigidTransform([1.0 - left, 2.0 + ahead, 3.0 + up])
        plant.RegisterVisualGeometry(plant.world_body(), place, Box(0.5, 0.001, 0.5), "plate", [1.0, 0.0, 0.0, 1.0])

    studio = Studio(furnish)
    pixels = studio.camera.look(studio.simulator.get_context())
    rows, columns = np.nonzero(pixels[:, :, 0])  # a plate across the line of sight: its middle is seen in the middle
    focal = 160.0 / tan(pi / 4)  # 160 pixels
    assert columns.mean() == pytest.approx(159.5 - focal * left / ahead, abs=0.1)
    assert rows.mean() == pytest.approx(119.5 - focal * up / ahead, abs=0.1)


@needs_egl
def test_the_noise_of_a_picture_has_its_standard_deviation() -> None:
    studio = Studio(noise=0.02)
    pixels = studio.camera.look(studio.simulator.get_context()).astype(float)
    assert pixels.std(axis=(0, 1)) == pytest.approx([5.1] * 3, rel=0.02)  # 0.02 of 255, and rounding: 1/12 of its own
    assert np.abs(np.corrcoef(pixels.reshape(-1, 3).T) - np.eye(3)).max() < 0.02


@needs_egl
def test_a_picture_is_held_until_the_next_is_taken() -> None:
    studio = Studio(noise=0.02)
    pictures = []
    for time in (0.05, 0.09, 0.15):  # taken at 0, 0.1 s
        studio.simulator.AdvanceTo(time)
        pictures.append(studio.held())
    assert np.array_equal(pictures[0], pictures[1])
    assert not np.array_equal(pictures[1], pictures[2])


@needs_egl
def test_a_camera_sees_other_vehicles_but_not_its_own(tmp_path: Path) -> None:
    # one behind the other: the bonnet would be in both pictures, the blue car ahead is in one
    world = tmp_path / "queue.yaml"
    starts = "start:\n  back: {at: [0, 0]}\n  front: {at: [8, 0]}\n"
    world.write_text(f"mirdrake: world/1\nname: queue\nground: {{surface: asphalt}}\n{starts}", encoding="utf-8")
    names = {"behind": "back", "ahead": "front"}
    spec = parked([], world=str(world), record={"cameras": True})
    spec["vehicles"] = {name: {"model": "bolt", "start": start} for name, start in names.items()}
    spec["control"] = {name: {"kind": "constant", "speed": 0.0} for name in names}
    spec["sensors"] = {name: ["front_camera"] for name in names}
    assembly = assemble(spec)
    context = assembly.make_context()
    pictures = {name: assembly.cameras[f"{name}.front_camera"][0].look(context).astype(int) for name in names}
    blue = {name: int(((p[:, :, 2] - p[:, :, 0] > 80) & (p[:, :, 2] > 100)).sum()) for name, p in pictures.items()}
    assert blue["behind"] > 5000
    assert blue["ahead"] == 0


def test_pictures_are_named_by_simulated_time_from_1970_on() -> None:
    assert picture_name(0.0) == "1970-01-01-00-00-00-000000"
    assert picture_name(1.0 / 30.0) == "1970-01-01-00-00-00-033333"
    assert picture_name(3661.25) == "1970-01-01-01-01-01-250000"


FILE = """\
world: test_track
vehicles:
  ego: {model: bolt, start: line, speed: 5}
control:
  ego: {kind: path_tracking, track: main, speed: 5 m/s}
sensors: {ego: [front_camera, gps, imu]}
record: {cameras: true, meshcat: false, report: false}
duration: 0.1
"""


@needs_egl
def test_a_run_writes_pictures_and_a_driving_log(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    diagram = tmp_path / "drive.yaml"
    diagram.write_text(FILE, encoding="utf-8")
    for name in ("a", "b"):
        assert main(["run", str(diagram), "--out", str(tmp_path / name)]) == 0
    capsys.readouterr()
    folder = tmp_path / "a" / "ego.front_camera"
    log = [line.split("\t") for line in (folder / "driving_log.txt").read_text(encoding="utf-8").splitlines()]
    names = [f"1970-01-01-00-00-00-{us:06d}.jpg" for us in (0, 33333, 66667, 100000)]  # 30 Hz, both ends
    assert [row[0] for row in log] == names
    assert sorted(path.name for path in folder.iterdir()) == [*names, "driving_log.txt"]
    assert [float(row[1]) for row in log] == pytest.approx([0.0] * 4, abs=1e-3)  # straight ahead
    assert [float(row[2]) for row in log] == pytest.approx([5.0] * 4, abs=0.05)
    with Image.open(folder / names[1]) as picture:
        assert picture.size == (800, 800)
        sky, road = np.asarray(picture)[100, 400], np.asarray(picture)[700, 200]
    assert sky.min() > 180
    assert np.ptp(road.astype(int)) < 40  # grey
    again = tmp_path / "b" / "ego.front_camera"
    assert all((folder / name).read_bytes() == (again / name).read_bytes() for name in (*names, "driving_log.txt"))
    signals = load_run(tmp_path / "a").signals
    assert {"ego.gps.x", "ego.imu.fz"} <= set(signals.columns)


BLOCK = """\
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import BasicVector, LeafSystem
from pydrake.systems.sensors import ImageRgba8U


class Brightness(LeafSystem):
    def __init__(self):
        super().__init__()
        self.image = self.DeclareAbstractInputPort("image", AbstractValue.Make(ImageRgba8U()))
        self.DeclareVectorOutputPort("mean", BasicVector(1), self.calc)

    def calc(self, context, output):
        output.SetFromVector([self.image.Eval(context).data[:, :, :3].mean()])
"""


@needs_egl
def test_a_block_of_the_users_can_read_a_camera(tmp_path: Path) -> None:
    (tmp_path / "seeing_blocks.py").write_text(BLOCK, encoding="utf-8")
    done = run(
        ["front_camera"],
        systems={"eye": {"kind": "seeing_blocks:Brightness"}},
        connect=[["ego.front_camera.color_image", "eye.image"]],
        folder=str(tmp_path),
    )
    brightness: pd.Series = done["eye.mean"]
    assert brightness.iloc[0] == 0.0  # no picture yet
    assert 60.0 < brightness.iloc[-1] < 220.0
