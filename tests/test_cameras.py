"""Cameras against numbers computed by hand: pixel, depth, label and time of known points."""

import os
import subprocess
import sys
from collections.abc import Callable
from math import pi, radians, tan
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from pydrake.geometry import Box, QueryObject, RenderEngineVtkParams
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.plant import AddMultibodyPlant, MultibodyPlant, MultibodyPlantConfig
from pydrake.multibody.tree import FixedOffsetFrame
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from mirdrake.assembly.diagram import assemble
from mirdrake.core.errors import ConfigError
from mirdrake.core.paths import find
from mirdrake.core.yaml_io import parse_yaml
from mirdrake.sensors.cameras import rendering
from mirdrake.sensors.cameras.camera import Camera
from mirdrake.sensors.cameras.lens import LensSpec
from mirdrake.sensors.cameras.mounts import DepthCameraMount
from mirdrake.sensors.cameras.noise import color_noise, depth_noise
from mirdrake.sensors.cameras.rendering import add_renderer
from mirdrake.sensors.noise import noise_stream
from mirdrake.vehicles import load_vehicle
from mirdrake.vehicles.mounts import SENSOR_KINDS, SensorsSpec

FAULT = rendering._egl_fault()
needs_egl = pytest.mark.skipif(FAULT is not None, reason=f"cameras cannot be drawn here: {FAULT}")

WIDTH, HEIGHT = 320, 240
FOCAL = 0.5 * WIDTH / tan(pi / 4)  # 160 pixels
BARREL = {"k1": -0.2, "k2": 0.03, "p1": 0.002, "p2": -0.003, "k3": -0.001}
"""A wide-angle lens; its corners lie 8 % farther in than a pinhole's."""

PLATE = Box(0.6, 0.001, 0.6)
Furnish = Callable[[MultibodyPlant], None]


def make_mount(kind: str = "camera", **numbers: Any) -> Any:
    data = {"kind": kind, "frame": "mount", "rate": 10.0, "width": WIDTH, "height": HEIGHT, "horizontal_fov": pi / 2}
    more = {"depth_near": 0.5, "depth_far": 40.0} if kind == "depth_camera" else {}
    return SENSOR_KINDS[kind].model_validate(data | more | numbers)


class Studio:
    """A camera at (1, 2, 3) m that looks along the world's y axis, before a black background or a grey one."""

    def __init__(self, furnish: Furnish = lambda _: None, *, kind: str = "camera", grey: float = 0.0, **numbers: Any):
        builder = DiagramBuilder()
        plant, scene_graph = AddMultibodyPlant(MultibodyPlantConfig(time_step=0.01), builder)
        X_WS = RigidTransform(RollPitchYaw(0.0, 0.0, pi / 2), [1.0, 2.0, 3.0])
        frame = plant.AddFrame(FixedOffsetFrame("mount", plant.world_body(), X_WS))
        furnish(plant)
        plant.Finalize()
        add_renderer(scene_graph, "studio", RenderEngineVtkParams(default_clear_color=[grey] * 3))
        self.camera = builder.AddSystem(Camera(plant, frame, make_mount(kind, **numbers), renderer="studio", stream=1))
        builder.Connect(scene_graph.get_query_output_port(), self.camera.query_object)
        self.simulator = Simulator(builder.Build())

    def look(self) -> dict[str, np.ndarray]:
        pictures: dict[str, np.ndarray] = self.camera.look(self.simulator.get_context())
        return pictures

    def shown(self, port: str) -> Any:
        value = self.camera.GetOutputPort(port).Eval(self.camera.GetMyContextFromRoot(self.simulator.get_context()))
        return value.copy() if port == "stamp" else value.data.copy()


def plate(ahead: float, left: float, up: float) -> Furnish:
    """A red plate across the line of sight, turned so that its edges cross pixels everywhere; left is world -x."""

    def furnish(plant: MultibodyPlant) -> None:
        pose = RigidTransform(RollPitchYaw(0.0, 0.4, 0.0), [1.0 - left, 2.0 + ahead, 3.0 + up])
        plant.RegisterVisualGeometry(plant.world_body(), pose, PLATE, "plate", [1.0, 0.0, 0.0, 1.0])

    return furnish


def block(size: tuple[float, float, float], ahead: float, left: float, up: float) -> Furnish:
    """Return a block (size along ahead, left, up) around a point of the camera's mounting frame."""

    def furnish(plant: MultibodyPlant) -> None:
        pose, shape = RigidTransform([1.0 - left, 2.0 + ahead, 3.0 + up]), Box(size[1], size[0], size[2])
        plant.RegisterVisualGeometry(plant.world_body(), pose, shape, "block", [1.0, 1.0, 1.0, 1.0])

    return furnish


def middle_of_red(picture: np.ndarray) -> tuple[float, float]:
    """Return the column and row of the middle of what is red, weighted by how red: a border pixel is mixed."""
    weight = picture[:, :, 0].astype(float)
    rows, columns = np.indices(weight.shape)
    return float((columns * weight).sum() / weight.sum()), float((rows * weight).sum() / weight.sum())


# --- where a point is seen ---------------------------------------------------------------------------------------

PLACES = [(8.0, 0.0, 0.0), (8.0, 3.0, 1.0), (10.0, -6.0, -4.0), (6.0, 5.5, -4.0)]


@needs_egl
@pytest.mark.parametrize(("ahead", "left", "up"), PLACES)
def test_a_known_point_is_seen_at_its_pixel(ahead: float, left: float, up: float) -> None:
    column, row = middle_of_red(Studio(plate(ahead, left, up)).look()["color"])
    assert column == pytest.approx(159.5 - FOCAL * left / ahead, abs=0.2)
    assert row == pytest.approx(119.5 - FOCAL * up / ahead, abs=0.2)


@needs_egl
@pytest.mark.parametrize(("ahead", "left", "up"), PLACES)
def test_through_a_lens_a_known_point_is_seen_where_brown_and_conrady_have_it(
    ahead: float, left: float, up: float
) -> None:
    column, row = middle_of_red(Studio(plate(ahead, left, up), distortion=BARREL).look()["color"])
    x, y = -left / ahead, -up / ahead
    r2 = x * x + y * y
    radial = 1.0 - 0.2 * r2 + 0.03 * r2**2 - 0.001 * r2**3
    seen_x = x * radial + 2 * 0.002 * x * y - 0.003 * (r2 + 2 * x * x)
    seen_y = y * radial + 0.002 * (r2 + 2 * y * y) - 2 * 0.003 * x * y
    assert column == pytest.approx(159.5 + FOCAL * seen_x, abs=0.3)
    assert row == pytest.approx(119.5 + FOCAL * seen_y, abs=0.3)


@needs_egl
@pytest.mark.parametrize("lens", [BARREL, {"k1": 0.3, "p1": -0.005}], ids=["barrel", "pincushion"])
def test_a_distorted_picture_has_no_empty_border(lens: dict[str, float]) -> None:
    pictures = Studio(kind="depth_camera", grey=0.5, distortion=lens, depth_near=0.1).look()
    assert np.ptp(pictures["color"]) == 0
    assert pictures["color"][0, 0, 0] == pytest.approx(128, abs=1)
    assert np.all(np.isinf(pictures["depth"]))


@needs_egl
def test_the_border_is_drawn_like_the_middle() -> None:
    assert np.ptp(Studio(grey=0.5).look()["color"]) == 0


@pytest.mark.parametrize("lens", [BARREL, {"k1": 0.3, "k2": 0.1}, {"k1": -0.3, "k2": 0.1}, {}])
def test_distortion_and_its_inverse_cancel(lens: dict[str, float]) -> None:
    spec = LensSpec(**lens)
    x, y = np.meshgrid(np.linspace(-0.9, 0.9, 25), np.linspace(-0.7, 0.7, 21))
    back = spec.undistort(*spec.distort(x, y))
    assert np.abs(np.array(back) - [x, y]).max() < 1e-9


@needs_egl
@pytest.mark.parametrize("distance", [4.0, 9.0, 20.0])
def test_the_disparity_of_a_stereo_pair_is_focal_length_times_baseline_over_distance(distance: float) -> None:
    pictures = Studio(plate(distance, 0.6, -0.4), kind="stereo_camera", baseline=0.5).look()
    left, right = middle_of_red(pictures["left"]), middle_of_red(pictures["right"])
    assert left[0] - right[0] == pytest.approx(FOCAL * 0.5 / distance, abs=0.2)
    assert left[1] == pytest.approx(right[1], abs=0.1)
    assert left[0] == pytest.approx(159.5 - FOCAL * (0.6 - 0.25) / distance, abs=0.2)


@needs_egl
def test_both_eyes_look_at_the_same_moment_and_have_noise_of_their_own() -> None:
    studio = Studio(kind="stereo_camera", baseline=0.5, grey=0.5, noise=0.02)
    studio.simulator.AdvanceTo(0.15)
    left, right = studio.shown("left_color_image"), studio.shown("right_color_image")
    assert studio.shown("stamp") == pytest.approx([0.1], abs=1e-12)
    error = np.stack([picture[:, :, 0].ravel().astype(float) for picture in (left, right)])
    assert error.std(axis=1) == pytest.approx([5.1, 5.1], rel=0.02)
    assert abs(np.corrcoef(error)[0, 1]) < 0.02


# --- how far it is -----------------------------------------------------------------------------------------------


@needs_egl
@pytest.mark.parametrize("distance", [1.0, 5.0, 30.0])
def test_a_wall_across_has_the_same_depth_everywhere(distance: float) -> None:
    wall = block((1.0, 100.0, 100.0), distance + 0.5, 0.0, 0.0)
    depth = Studio(wall, kind="depth_camera").look()["depth"]
    assert depth.dtype == np.float32
    assert depth == pytest.approx(np.full((HEIGHT, WIDTH), distance), rel=1e-3)


@needs_egl
def test_the_ground_has_the_depth_of_the_ray_that_meets_it() -> None:
    ground = block((400.0, 400.0, 1.0), 0.0, 0.0, -2.0)  # its top is 1.5 m below the camera
    depth = Studio(ground, kind="depth_camera").look()["depth"]
    for row in (130, 150, 180, 210, 239):
        assert depth[row, ::40] == pytest.approx(np.full(8, 1.5 * FOCAL / (row - 119.5)), rel=1e-3)
    assert np.all(np.isinf(depth[:119]))  # the sky


@needs_egl
def test_a_box_has_the_depth_of_the_face_that_a_ray_meets_first() -> None:
    # from 5 to 7 m ahead, from 1 to 2 m to the left, from 1 m below to 1 m above
    depth = Studio(block((2.0, 1.0, 2.0), 6.0, 1.5, 0.0), kind="depth_camera").look()["depth"]
    for column, expected in ((108, 5.0), (120, 5.0), (132, FOCAL / 27.5), (135, FOCAL / 24.5)):
        # the front face is seen from left 1 to 2 m at 5 m, the right side (1 m to the left) behind it
        assert depth[120, column] == pytest.approx(expected, rel=1e-3), column
    assert np.isinf(depth[120, 90])
    assert np.isinf(depth[120, 140])


@needs_egl
def test_depth_is_0_below_and_infinite_above_the_range() -> None:
    for distance, expected in ((0.4, 0.0), (41.0, np.inf)):
        depth = Studio(block((0.1, 99.0, 99.0), distance + 0.05, 0.0, 0.0), kind="depth_camera").look()["depth"]
        assert np.all(depth == expected)


@needs_egl
def test_depths_through_a_lens_are_those_of_the_direction_that_a_pixel_sees() -> None:
    depth = Studio(block((400.0, 400.0, 1.0), 0.0, 0.0, -2.0), kind="depth_camera", distortion=BARREL).look()["depth"]
    rows, columns = np.array([150, 180, 239, 239]), np.array([20, 160, 0, 319])
    _, y = LensSpec(**BARREL).undistort((columns - 159.5) / FOCAL, (rows - 119.5) / FOCAL)
    half = 0.5 / FOCAL  # the nearest drawn pixel may be half a pixel away
    nearest, farthest = 1.5 / (y + half), 1.5 / (y - half)
    assert np.all((depth[rows, columns] >= 0.999 * nearest) & (depth[rows, columns] <= 1.001 * farthest))


@pytest.mark.parametrize(
    ("name", "distance", "deviation"),
    [
        ("khoshelham", 1.0, 1.425e-3),
        ("khoshelham", 3.0, 12.825e-3),
        ("nguyen", 1.0, 1.884e-3),  # 0.0012 + 0.0019 * 0.6²
        ("nguyen", 3.0, 14.044e-3),  # 0.0012 + 0.0019 * 2.6²
    ],
)
def test_the_noise_of_depths_is_the_published_one(name: str, distance: float, deviation: float) -> None:
    mount = make_mount("depth_camera", depth_noise=name)
    depths = np.full((HEIGHT, WIDTH), distance, dtype=np.float32)
    errors = [depth_noise(depths, mount, stream=5, index=index) - distance for index in (0, 1)]
    assert [error.std() for error in errors] == pytest.approx([deviation] * 2, rel=0.02)
    assert [error.mean() for error in errors] == pytest.approx([0.0] * 2, abs=5 * deviation / depths.size**0.5)
    assert abs(np.corrcoef(errors[0].ravel(), errors[1].ravel())[0, 1]) < 0.02


def test_noise_leaves_no_depth_outside_the_limits_and_nothing_where_nothing_is() -> None:
    mount = make_mount("depth_camera", depth_noise={"base": 0.5})
    depths = np.tile(np.array([0.0, 0.6, 39.9, np.inf], dtype=np.float32), (50, 50))
    noisy = depth_noise(depths, mount, stream=0, index=3)
    assert np.all(noisy[depths == 0.0] == 0.0)
    assert np.all(np.isinf(noisy[np.isinf(depths)]))
    there = noisy[(depths > 0.0) & np.isfinite(depths)]
    assert (there.min(), there.max()) == (0.5, 40.0)


def test_depths_come_in_steps() -> None:
    depths = np.linspace(0.6, 30.0, 200, dtype=np.float32).reshape(10, 20)
    even = depth_noise(depths, make_mount("depth_camera", depth_resolution=0.05), stream=0, index=0)
    assert np.abs(even / 0.05 - np.rint(even / 0.05)).max() < 1e-4
    assert np.abs(even - depths).max() <= 0.0251
    kinect = depth_noise(depths, make_mount("depth_camera", inverse_depth_resolution=2.85e-3), stream=0, index=0)
    assert np.unique(np.rint(1.0 / (kinect * 2.85e-3))).size == np.unique(kinect).size
    assert np.all(np.abs(kinect - depths) <= 0.51 * 2.85e-3 * np.maximum(depths, kinect) ** 2)


# --- colours, time, and what is not drawn ------------------------------------------------------------------------


@pytest.mark.parametrize("noise", [0.007, 0.02])
def test_the_noise_of_a_picture_has_its_standard_deviation(noise: float) -> None:
    image = np.full((HEIGHT, WIDTH, 4), 128, dtype=np.uint8)
    pictures = [color_noise(image, noise, stream=1, index=index).astype(float) for index in (0, 1)]
    expected = ((255 * noise) ** 2 + 1 / 12) ** 0.5  # and rounding
    assert pictures[0].std(axis=(0, 1)) == pytest.approx([expected] * 3, rel=0.02)
    assert pictures[0].mean() == pytest.approx(128.0, abs=5 * expected / pictures[0].size ** 0.5)
    rows = np.concatenate([picture.reshape(-1, 3).T for picture in pictures])
    assert np.abs(np.corrcoef(rows) - np.eye(6)).max() < 0.02


def test_noise_does_not_wrap_around_black_and_white() -> None:
    for level in (0, 255):
        picture = color_noise(np.full((60, 80, 4), level, dtype=np.uint8), 0.02, stream=1, index=0)
        assert np.abs(picture.astype(int) - level).max() < 30


@needs_egl
def test_a_picture_is_held_until_the_next_is_taken() -> None:
    studio = Studio(noise=0.02, grey=0.5)
    assert not studio.shown("color_image").any()
    pictures = []
    for time in (0.05, 0.09, 0.15):  # taken at 0, 0.1 s
        studio.simulator.AdvanceTo(time)
        pictures.append(studio.shown("color_image"))
    assert np.array_equal(pictures[0], pictures[1])
    assert not np.array_equal(pictures[1], pictures[2])


@needs_egl
@pytest.mark.parametrize("latency", [0.0, 0.03, 0.1, 0.25])
def test_every_picture_is_shown_after_its_latency(latency: float) -> None:
    """The pictures differ by their noise; the image shown at t + latency was taken at t."""
    studio = Studio(noise=0.02, grey=0.5, latency=latency, width=32, height=24)
    pictures: list[np.ndarray] = []
    for number in range(8):
        studio.simulator.AdvanceTo(0.1 * number)
        pictures.append(studio.look()["color"])
    again = Studio(noise=0.02, grey=0.5, latency=latency, width=32, height=24)
    for number in range(8 - 3):
        again.simulator.AdvanceTo(0.1 * number + latency + 1e-4)
        assert again.shown("stamp") == pytest.approx([0.1 * number], abs=1e-12)
        assert np.array_equal(again.shown("color_image")[:, :, :3], pictures[number])
        if latency > 0.0 and number:
            continue
        again.simulator.AdvanceTo(0.1 * number + latency + 0.09)
        assert again.shown("stamp") == pytest.approx([0.1 * number], abs=1e-12)


@needs_egl
def test_a_picture_is_drawn_once_however_often_it_is_looked_at(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[str] = []
    for name in ("RenderColorImage", "RenderDepthImage", "RenderLabelImage"):
        original = getattr(QueryObject, name)

        def counted(*args: Any, name: str = name, original: Any = original, **more: Any) -> Any:
            drawn.append(name)
            return original(*args, **more)

        monkeypatch.setattr(QueryObject, name, counted)
    cases: list[tuple[dict[str, Any], list[str]]] = [
        ({}, ["RenderColorImage"]),
        ({"kind": "depth_camera", "color": False}, ["RenderDepthImage"]),
    ]
    for numbers, expected in cases:
        studio = Studio(**numbers)
        studio.simulator.Initialize()
        drawn.clear()
        for _ in range(3):
            studio.look()
        studio.simulator.AdvanceTo(0.25)  # at 0, 0.1 and 0.2 s
        assert drawn == expected * 3


# --- labels ------------------------------------------------------------------------------------------------------

WORLD = """\
mirdrake: world/1
name: yard
ground: {surface: grass}
tracks:
  lane: {segments: [{line: 60}], start: {at: [-5, 0]}, width: 6}
props:
  - {box: [1, 1, 2], name: crate, at: [10, 3]}
  - {cylinder: [0.5, 2], name: post, at: [12, -2], static: false, mass: 30}
  - {prop: barrel, name: drum, at: [8, -4]}
start:
  here: {at: [0, 0]}
  there: {at: [20, 0]}
"""


def bolt_with(folder: Path, sensors: dict[str, Any]) -> Path:
    """Return a Bolt with other sensors."""
    model = folder / "bolt"
    model.mkdir()
    for path in find("models", "bolt").iterdir():
        (model / path.name).symlink_to(path)
    (model / "sensors.yaml").unlink()
    (model / "sensors.yaml").write_text(yaml.safe_dump({"mounts": sensors}, sort_keys=False), encoding="utf-8")
    return model


@needs_egl
def test_labels_name_the_object_at_a_pixel(tmp_path: Path) -> None:
    mount = make_mount("depth_camera", frame="front_camera", label=True, depth_near=0.3, depth_far=80.0)
    model = bolt_with(tmp_path, {"kinect": mount.model_dump(exclude_unset=True)})
    world = tmp_path / "yard.yaml"
    world.write_text(WORLD, encoding="utf-8")
    spec = {
        "world": str(world),
        "vehicles": {"ego": {"model": str(model), "start": "here"}, "other": {"model": "bolt", "start": "there"}},
        "control": {name: {"kind": "constant", "speed": 0.0} for name in ("ego", "other")},
        "sensors": {"ego": ["kinect"]},
        "plant": {"contact": "point"},
        "record": {"cameras": True, "meshcat": False, "report": False},
    }
    assembly = assemble(spec)
    camera = assembly.cameras["ego.kinect"][0]
    assert isinstance(camera, Camera)
    context = assembly.make_context()
    pictures = camera.look(context)
    plant = assembly.parts.plant
    frame = plant.GetFrameByName("front_camera", assembly.parts.vehicles["ego"].instance)
    X_SW = frame.CalcPoseInWorld(plant.GetMyContextFromRoot(context)).inverse()
    points = {
        "prop/crate": [9.5, 3.0, 1.0], "prop/post": [11.5, -2.0, 1.0], "prop/drum": [7.75, -4.0, 0.5],
        "vehicle/other": [20.0 - 0.7, 0.0, 0.9], "road": [6.0, 1.0, 0.0], "ground": [8.0, 6.0, 0.0],
    }  # fmt: skip
    for name, point in points.items():
        x, y, z = X_SW.multiply(np.array(point))
        row, column = round(119.5 - FOCAL * z / x), round(159.5 - FOCAL * y / x)
        assert camera.labels[int(pictures["label"][row, column])] == name
        assert pictures["depth"][row, column] == pytest.approx(x, abs=0.4)  # without anything in front of it
    assert camera.labels[int(pictures["label"][5, 160])] == "sky"
    assert set(np.unique(pictures["label"])) <= set(camera.labels)
    assert "vehicle/ego" in camera.labels.values()
    Simulator(assembly.diagram, context).AdvanceTo(0.01)
    shown = camera.GetOutputPort("label_image").Eval(camera.GetMyContextFromRoot(context)).data[:, :, 0]
    assert np.array_equal(shown, pictures["label"])


# --- rejected input ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        ({"horizontal_fov": "180 deg"}, r"3: mounts\.eye.*horizontal_fov.*180 deg cannot be projected.* below 180 deg"),
        ({"horizontal_fov": "0 deg"}, r"3: mounts\.eye.*horizontal_fov"),
        ({"width": 0}, r"3: mounts\.eye.*width"),
        ({"height": 100_000}, r"3: mounts\.eye.*height"),
        ({"rate": 0}, r"3: mounts\.eye.*rate"),
        ({"near": 5, "far": 2}, r"2: mounts\.eye.*near \(5 m\) must be below far \(2 m\)"),
        ({"distortion": {"k1": -2.0}}, r"2: mounts\.eye.*not invertible.*smaller"),
        ({"distortion": {"k1": 1e-6}, "horizontal_fov": "172 deg"}, r"2: mounts\.eye.*more than 170 deg"),
        ({"kind": "depth_camera", "depth_near": 4, "depth_far": 1}, r"depth_near \(4 m\) must be below depth_far"),
        ({"kind": "depth_camera", "depth_near": 1, "depth_far": 4, "depth_noise": "nguen"}, "did you mean 'nguyen'"),
        ({"kind": "stereo_camera", "baseline": 0}, r"mounts\.eye.*baseline"),
    ],
)
def test_bad_numbers_of_a_camera_are_rejected_with_their_line(change: dict[str, Any], fault: str) -> None:
    data = {"kind": "camera", "frame": "eye", "rate": 10, "width": 64, "height": 48, "horizontal_fov": "90 deg"}
    changed = data | change
    rows = [f"{key}: {yaml.safe_dump(changed[key], default_flow_style=True).splitlines()[0]}" for key in change]
    rest = [f"{key}: {value}" for key, value in changed.items() if key not in change]
    text = f"mounts:\n  eye:\n    {{{', '.join([*rows, *rest])}}}\n"
    with pytest.raises(ConfigError, match=fault):
        parse_yaml(text, SensorsSpec)


def test_a_frame_that_is_not_there_is_rejected(tmp_path: Path) -> None:
    model = bolt_with(tmp_path, {"eye": make_mount(frame="front_kamera").model_dump(exclude_unset=True)})
    with pytest.raises(ConfigError, match=r"sensors\.yaml:\d+: mounts\.eye\.frame: no link 'front_kamera'; did you"):
        load_vehicle(str(model))


def test_more_pixels_than_memory_are_rejected(monkeypatch: pytest.MonkeyPatch) -> None:
    spec = {
        "world": "empty",
        "vehicles": {"ego": {"model": "bolt"}},
        "control": {"ego": {"kind": "constant", "speed": 0.0}},
        "sensors": {"ego": ["front_camera"]},
        "record": {"cameras": True},
    }
    monkeypatch.setattr(os, "sysconf", {"SC_PHYS_PAGES": 10_000, "SC_PAGE_SIZE": 4096}.__getitem__)
    with pytest.raises(ConfigError, match=r"sensors\.yaml:\d+: mounts\.front_camera\.width: 800 x 800 pixels.*0\.0 GB"):
        assemble(spec)


# --- speed -------------------------------------------------------------------------------------------------------

DUMP = """
from pydrake.geometry import MakeRenderEngineVtk, RenderEngineVtkParams
from tests.test_cameras import Studio
Studio().look()
"""


@needs_egl
def test_our_filter_for_edges_is_named_after_the_one_of_this_vtk(tmp_path: Path) -> None:
    root = Path(__file__).resolve().parent.parent
    mesa = {"MESA_SHADER_DUMP_PATH": str(tmp_path), "MESA_SHADER_READ_PATH": str(tmp_path)}
    variables = os.environ | mesa | {"PYTHONPATH": str(root)}
    subprocess.run([sys.executable, "-c", DUMP], env=variables, check=True, cwd=root, capture_output=True)
    dumped = {path.name: path.read_text(encoding="utf-8") for path in tmp_path.glob("FS_*.glsl")}
    if not dumped:
        pytest.skip("these drivers are not Mesa's, or it cannot replace shaders")
    names = [name for name, text in dumped.items() if "vtkOpenGLFXAAFilter" in text]
    assert len(names) == 1
    assert (rendering.SHADERS / names[0]).is_file()


def test_the_numbers_of_a_mount_are_those_of_its_kind() -> None:
    assert isinstance(make_mount("depth_camera"), DepthCameraMount)
    assert noise_stream(0, "ego.eye") != noise_stream(0, "ego.other")
    assert radians(180.0) > make_mount().horizontal_fov
