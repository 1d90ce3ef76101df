"""The view of `mirdrake view VEHICLE`: sliders of the joints of the vehicle, and layers with buttons and keys."""

import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pydrake.geometry import Meshcat, MeshcatVisualizer

from mirdrake.vehicles import load_vehicle
from mirdrake.viewer import make_meshcat, show_vehicle
from mirdrake.viewer.show import write_page
from mirdrake.viewer.vehicle_view import BUTTONS, look_at
from mirdrake.worlds import load_world
from tests.chromium import NEEDS_BROWSER
from tests.test_browser import browser, colours, picture, severe  # noqa: F401


class Remote:
    """A wrapper of Meshcat whose buttons a test can press; the scene goes to a real Meshcat."""

    def __init__(self, meshcat: Meshcat) -> None:
        self._meshcat = meshcat
        self.clicks: dict[str, int] = {}
        self.visible: dict[str, bool] = {}
        self.poses: dict[str, np.ndarray] = {}

    def __getattr__(self, name):
        return getattr(self._meshcat, name)

    def AddButton(self, name, keycode=""):  # noqa: N802
        self.clicks.setdefault(name, 0)
        self._meshcat.AddButton(name, keycode)

    def GetButtonClicks(self, name):  # noqa: N802
        return self.clicks[name]

    def SetProperty(self, path, name, value):  # noqa: N802
        if name == "visible":
            self.visible[path] = value
        self._meshcat.SetProperty(path, name, value)

    def SetTransform(self, path, X):  # noqa: N802
        self.poses[path] = X.GetAsMatrix4()
        self._meshcat.SetTransform(path, X)


@pytest.fixture(scope="module")
def real():
    """One Meshcat for all tests; each view replaces the one before."""
    return make_meshcat(port=0, world=load_world("empty"))


@pytest.fixture
def view(real, monkeypatch):
    """A function (options) -> the view of a Bolt, and the remote with which to press buttons."""
    add = MeshcatVisualizer.AddToBuilder

    def make(model="bolt", **options):
        real.DeleteAddedControls()
        remote = Remote(real)
        with monkeypatch.context() as patch:
            patch.setattr(
                "mirdrake.viewer.vehicle_view.MeshcatVisualizer.AddToBuilder",
                lambda builder, graph, _, *params: add(builder, graph, real, *params),
            )
            _, vehicle_view = show_vehicle(load_vehicle(model), remote, **options)
        return vehicle_view, remote

    return make


def test_each_own_joint_has_a_slider_within_its_limits_and_the_floating_base_has_none(view):
    vehicle_view, remote = view()
    joints = {f"front {side} steering [rad]" for side in ("left", "right")}
    joints |= {f"{end} {side} wheel [rad]" for end in ("front", "back") for side in ("left", "right")}
    assert set(remote.GetSliderNames()) == joints
    remote.SetSliderValue("front left steering [rad]", 5.0)
    assert remote.GetSliderValue("front left steering [rad]") == pytest.approx(0.6)
    assert vehicle_view.shown == {"Frames": False, "Collision shapes": False, "Meshes": True}


def test_a_slider_turns_its_wheel_and_nothing_else(view):
    vehicle_view, remote = view()
    before = {path: pose.copy() for path, pose in remote.poses.items()}
    assert not vehicle_view.follow()
    remote.SetSliderValue("front left steering [rad]", 0.5)
    assert vehicle_view.follow()
    moved = {path for path, pose in remote.poses.items() if not np.allclose(pose, before[path], atol=1e-12)}
    assert moved == {f"/drake/frames/{name}" for name in ("front_left_knuckle", "front_left_wheel", "centre of mass")}
    turned = remote.poses["/drake/frames/front_left_knuckle"][:3, 0]
    np.testing.assert_allclose(turned[:2], [np.cos(0.5), np.sin(0.5)], atol=1e-4)


def test_the_car_rests_on_compressed_tyres(view):
    _, remote = view()
    # d = N / k with k = 200 kN/m: 22.19 mm for 4437 N, 17.43 mm for 3486 N.
    for name, depth in (("front_left_wheel", 4437.0 / 200e3), ("rear_right_wheel", 3486.0 / 200e3)):
        assert remote.poses[f"/drake/frames/{name}"][2, 3] == pytest.approx(0.3234 - depth, abs=1e-5)


def test_a_button_switches_its_layer_and_no_other(view):
    vehicle_view, remote = view()
    paths = {"Frames": "/drake/frames", "Collision shapes": "/drake/collision", "Meshes": "/drake/visualizer/bolt"}
    assert [remote.visible[path] for path in paths.values()] == [False, False, True]
    for name, path in paths.items():
        before = dict(remote.visible)
        remote.clicks[name] += 1
        assert vehicle_view.follow()
        assert remote.visible == before | {path: not before[path]}
    remote.clicks["Meshes"] += 2  # twice since the last look: as before
    assert not vehicle_view.follow()


def test_layers_can_be_chosen_from_the_start(view):
    _, remote = view(frames=True, collision=True, meshes=False)
    assert remote.visible["/drake/frames"]
    assert remote.visible["/drake/collision"]
    assert not remote.visible["/drake/visualizer/bolt"]


def test_the_view_ends_at_its_stop_button_or_after_a_time(view):
    vehicle_view, remote = view()
    begin = time.monotonic()
    vehicle_view.Run(vehicle_view._diagram, timeout=0.1)
    assert 0.1 <= time.monotonic() - begin < 3.0
    assert "Stop" not in remote.GetButtonNames()
    remote.clicks["Stop"] = 1
    vehicle_view.Run(vehicle_view._diagram)  # returns at once


def test_the_camera_is_as_near_as_the_vehicle_is_small(real):
    eyes: list[np.ndarray] = []

    class Eye(Remote):
        def SetCameraPose(self, eye, target):  # noqa: N802
            eyes.append(np.asarray(eye) - np.asarray(target))

    vehicle = load_vehicle("bolt")
    tenth = replace(
        vehicle.geometry,
        **{
            key: 0.1 * getattr(vehicle.geometry, key)
            for key in ("wheelbase", "front_wheel_radius", "rear_wheel_radius")
        },
    )
    meshcat = Eye(real)
    look_at(meshcat, vehicle)
    look_at(meshcat, replace(vehicle, geometry=tenth))
    np.testing.assert_allclose(eyes[1], 0.1 * eyes[0])


class TestBrowser:
    """With a browser."""

    pytestmark = NEEDS_BROWSER

    def test_keys_switch_layers_in_the_picture(self, request):
        driver = request.getfixturevalue("browser")
        driver.set_window_size(500, 400)  # drawn without a graphics card
        meshcat = make_meshcat(port=0, world=load_world("empty"))
        _, vehicle_view = show_vehicle(load_vehicle("bolt"), meshcat)
        driver.get(meshcat.web_url())
        assert _settled(driver, lambda image: _blue(image) > 0.03), "no car"
        plain = picture(driver)
        assert severe(driver) == []
        assert colours(plain) > 60
        assert set(vehicle_view.shown) == set(BUTTONS)

        _press(driver, vehicle_view, "KeyC")
        assert vehicle_view.shown["Collision shapes"]
        assert _settled(driver, lambda image: _red(image) > 0.05), "no collision shapes"
        _press(driver, vehicle_view, "KeyC")
        assert _settled(driver, lambda image: _red(image) < 0.01), "collision shapes stay"
        _press(driver, vehicle_view, "KeyM")
        assert _settled(driver, lambda image: _blue(image) < 0.005), "meshes stay"
        _press(driver, vehicle_view, "KeyF")
        assert _settled(driver, lambda image: _red(image) > 5e-4), "no frames"
        assert severe(driver) == []
        driver.get("about:blank")  # before the server goes

    def test_a_page_shows_the_layers_it_was_made_with(self, request, tmp_path: Path):
        driver = request.getfixturevalue("browser")
        driver.set_window_size(500, 400)  # drawn without a graphics card
        meshcat = make_meshcat(port=0, world=load_world("empty"))
        show_vehicle(load_vehicle("bolt"), meshcat, collision=True, meshes=False)
        write_page(meshcat, tmp_path / "bolt.html")
        severe(driver)  # what pages before this one said
        driver.get((tmp_path / "bolt.html").as_uri())
        assert _settled(driver, lambda image: _red(image) > 0.05 and _blue(image) < 0.005)
        assert severe(driver) == []


def _red(image):
    """Part of a picture that is clearly red."""
    pixels = image.astype(int)
    return float(((pixels[..., 0] > pixels[..., 1] + 60) & (pixels[..., 0] > pixels[..., 2] + 60)).mean())


def _blue(image):
    """Part of a picture that is clearly blue, as the car's paint."""
    pixels = image.astype(int)
    return float(((pixels[..., 2] > pixels[..., 0] + 60) & (pixels[..., 2] > pixels[..., 1] + 25)).mean())


def _settled(driver, condition, *, patience=30.0):
    """Return whether the image fulfils a condition within some seconds."""
    end = time.monotonic() + patience
    while time.monotonic() < end:
        if condition(picture(driver)):
            return True
        time.sleep(0.2)
    return False


def _press(driver, vehicle_view, code):
    """Press a key in the page, and let the view see it."""
    driver.execute_script(
        "document.dispatchEvent(new KeyboardEvent('keydown', {code: arguments[0], bubbles: true}))", code
    )
    end = time.monotonic() + 10.0
    while not vehicle_view.follow() and time.monotonic() < end:
        time.sleep(0.05)
