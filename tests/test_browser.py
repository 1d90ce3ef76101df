"""recording.html and report.html, opened offline in a headless browser."""

import io
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from pydrake.math import RigidTransform, RollPitchYaw

from mirdrake.assembly.diagram import assemble
from mirdrake.assembly.drawing import layout_command
from mirdrake.runs.logs import Run
from mirdrake.runs.simulation import Simulation
from mirdrake.viewer import FollowCamera
from mirdrake.viewer.meshcat import chase
from mirdrake.viewer.recording import smooth_headings
from mirdrake.workflow import run_diagram
from tests.chromium import NEEDS_BROWSER, open_browser

Picture = NDArray[np.uint8]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Six seconds on the test track with a bend to the left, all files written."""
    data = {
        "world": "test_track",
        "vehicles": {"ego": {"model": "bolt", "start": "line", "speed": 5.0}},
        "control": {
            "ego": {"kind": "schedule", "rows": [{"time": 0, "speed": 5}, {"time": 6, "speed": 5, "steering": 0.3}]}
        },
        "plant": {"contact": "point"},
        "duration": 6.0,
        "name": "browser",
    }
    return run_diagram(data, folder=tmp_path_factory.mktemp("browser") / "run")


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """Headless Chromium."""
    with open_browser(tmp_path_factory.mktemp("chromium")) as driver:
        yield driver


def picture(browser: Any) -> Picture:
    """Return a screenshot of the browser, as rows of red, green, blue."""
    return np.asarray(Image.open(io.BytesIO(browser.get_screenshot_as_png())).convert("RGB"))


def colours(image: Picture) -> int:
    """Return the number of colours of an image, with 32 steps a channel."""
    return len(np.unique((image // 8).reshape(-1, 3), axis=0))


def severe(browser: Any) -> list[str]:
    """Return errors in the browser's console."""
    return [entry["message"] for entry in browser.get_log("browser") if entry["level"] == "SEVERE"]


@pytest.fixture(scope="module")
def frames(run: Run, browser: Any) -> Callable[[float], Picture]:
    """A function (time [s]) -> picture of the recording at that time of its animation."""
    assert run.folder is not None
    browser.get((run.folder / "recording.html").as_uri())
    ready = "return typeof viewer == 'object' && viewer.animator.duration > 5 && document.readyState == 'complete'"
    from selenium.webdriver.support.ui import WebDriverWait

    WebDriverWait(browser, 60).until(lambda driver: driver.execute_script(ready))
    # Its white and its blue are not those of the scene.
    browser.execute_script("document.getElementById('player').style.display = 'none'")
    taken: dict[float, Picture] = {}

    def frame(time: float) -> Picture:
        if time not in taken:
            show = "viewer.animator.pause(); viewer.animator.seek(arguments[0]); viewer.render();"
            browser.execute_script(show, time)
            taken[time] = picture(browser)
        return taken[time]

    return frame


class TestBrowser:
    """With a browser."""

    pytestmark = NEEDS_BROWSER

    def test_the_recording_opens_offline_and_is_not_blank(
        self, frames: Callable[[float], Picture], browser: Any
    ) -> None:
        image = frames(0.5)
        assert severe(browser) == []
        assert colours(image) > 100
        assert image.std() > 20.0

    def test_the_recording_shows_sky_above_and_grass_below(self, frames: Callable[[float], Picture]) -> None:
        image = frames(0.5).astype(float)
        height, width, _ = image.shape
        sky = image[: height // 6, : width // 2].reshape(-1, 3).mean(axis=0)
        grass = image[-height // 6 :, : width // 4].reshape(-1, 3).mean(axis=0)
        assert sky.min() > 150.0  # bright
        assert sky[2] >= sky[0]  # not redder than blue
        assert grass[1] > 1.1 * max(grass[0], grass[2])  # green

    def test_the_car_is_in_the_middle_of_the_picture_all_the_time(self, frames: Callable[[float], Picture]) -> None:
        for time in (0.5, 3.0, 5.5):
            image = frames(time).astype(int)
            blue = (image[..., 2] > image[..., 0] + 60) & (image[..., 2] > image[..., 1] + 25)  # the car's paint
            rows, columns = np.nonzero(blue)
            height, width = blue.shape
            assert blue.mean() > 0.005, f"no car at {time} s"
            assert 0.3 < columns.mean() / width < 0.7
            assert 0.3 < rows.mean() / height < 0.7

    def test_the_recording_moves(self, frames: Callable[[float], Picture]) -> None:
        early, late = frames(0.5).astype(int), frames(5.5).astype(int)
        changed = np.abs(early - late).max(axis=2) > 24
        assert changed.mean() > 0.05

    def test_the_recording_plays_by_itself(self, run: Run, browser: Any) -> None:
        browser.get((run.folder / "recording.html").as_uri())  # type: ignore[operator]
        from selenium.webdriver.support.ui import WebDriverWait

        WebDriverWait(browser, 60).until(lambda driver: driver.execute_script("return viewer.animator.time") > 1.0)

    def test_the_play_bar_pauses_seeks_and_states_time_and_speed(self, run: Run, browser: Any) -> None:
        browser.get((run.folder / "recording.html").as_uri())  # type: ignore[operator]
        from selenium.webdriver.support.ui import WebDriverWait

        wait = WebDriverWait(browser, 60)
        wait.until(lambda driver: driver.execute_script("return viewer.animator.playing"))
        browser.execute_script("document.querySelector('#player button').click()")
        assert not browser.execute_script("return viewer.animator.playing")
        browser.execute_script(
            "const line = document.querySelector('#player input'); line.value = 4;"
            " line.dispatchEvent(new Event('input'));"
        )
        texts = "return [...document.querySelectorAll('#player span')].map(one => one.textContent)"
        wait.until(lambda driver: driver.execute_script(texts)[0].startswith("4.0 / "))
        speed = float(np.interp(4.0, run.signals.index, run["ego.vx"]))
        assert browser.execute_script(texts)[1].startswith(f"{speed:.1f} m/s")

    def test_the_report_opens_offline_and_is_not_blank(self, run: Run, browser: Any) -> None:
        browser.get((run.folder / "report.html").as_uri())  # type: ignore[operator]
        image = picture(browser)
        assert severe(browser) == []
        assert colours(image) > 20
        assert image.std() > 10.0
        assert browser.execute_script("return document.querySelectorAll('svg').length") >= 3
        assert browser.execute_script("return document.documentElement.scrollWidth <= window.innerWidth + 1")

    @pytest.mark.skipif(layout_command() is None, reason="Graphviz is not installed")
    def test_the_drawn_diagram_is_legible(self, run: Run, browser: Any) -> None:
        browser.get((run.folder / "diagram.svg").as_uri())  # type: ignore[operator]
        assert severe(browser) == []
        assert colours(picture(browser)) > 5
        texts = browser.execute_script("return [...document.querySelectorAll('text')].map(t => t.textContent)")
        assert {"driver", "control", "plant", "command", "state"} <= set(texts)


# --- the camera, without a browser ---------------------------------------------------------------------------------


def test_the_camera_keeps_a_steady_turn_and_softens_a_kink() -> None:
    times: Any = 0.02 * np.arange(501)
    steady = 0.5 * times
    wrapped = np.mod(steady + np.pi, 2.0 * np.pi) - np.pi
    followed = smooth_headings(times, wrapped)
    np.testing.assert_allclose(followed[50:-50], steady[50:-50], atol=1e-9)
    kinked = np.where(times < 5.0, 0.0, 1.0)  # the camera needs 1.6 s for a turn on the spot
    rate = np.diff(smooth_headings(times, kinked)) / 0.02
    assert rate.max() == pytest.approx(1.0 / 1.62)


def test_the_camera_is_content_with_very_short_runs(tmp_path: Path) -> None:
    for count in range(4):
        times: Any = 0.02 * np.arange(count)
        assert smooth_headings(times, np.zeros(count)).shape == (count,)


class Recorder:
    """A replacement of Meshcat that records the poses of objects."""

    def __init__(self) -> None:
        self.poses: dict[str, list[RigidTransform]] = {}

    def SetTransform(self, path: str, X: RigidTransform) -> None:  # noqa: N802
        self.poses.setdefault(path, []).append(X)

    def SetCameraPose(self, eye: Any, target: Any) -> None:  # noqa: N802
        self.view = np.asarray(target) - np.asarray(eye)


def test_the_world_moves_under_the_camera_so_that_the_car_heads_along_x() -> None:
    X_CW, X_CL = chase(x=10.0, y=5.0, yaw=np.pi / 2.0)
    np.testing.assert_allclose(X_CW @ [10.0, 5.0, 0.0], [0.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(X_CW @ [10.0, 7.0, 1.0], [2.0, 0.0, 1.0], atol=1e-12)  # 2 m ahead, 1 m up
    np.testing.assert_allclose(X_CL @ [0.0, 1.0, 0.0], [1.0, 0.0, 0.0], atol=1e-12)  # the sun turns with the world
    np.testing.assert_allclose(X_CL.translation(), 0.0)


def test_the_live_camera_follows_the_car_at_thirty_two_pictures_a_second() -> None:
    data = {
        "world": "empty",
        "vehicles": {"ego": {"model": "bolt", "speed": 5.0}},
        "control": {"ego": {"kind": "constant", "speed": 5.0, "steering": 0.2}},
        "plant": {"contact": "point"},
        "duration": 2.0,
    }
    assembly, meshcat = assemble(data), Recorder()
    run = Simulation(assembly).run(monitor=FollowCamera(meshcat, assembly))
    poses = meshcat.poses["/drake"]
    assert 55 <= len(poses) <= 65
    assert meshcat.view[0] > 0.0  # looks ahead
    assert meshcat.view[2] < 0.0  # and down
    last = run.signals[["ego.x", "ego.y", "ego.z"]].iloc[-1].to_numpy()
    np.testing.assert_allclose((poses[-1] @ last)[:2], [0.0, 0.0], atol=0.2)  # 5 m/s for one picture
    turned = -RollPitchYaw(poses[-1].rotation()).yaw_angle() - RollPitchYaw(poses[0].rotation()).yaw_angle()
    assert 0.3 * run["ego.yaw"].iloc[-1] < turned < run["ego.yaw"].iloc[-1]
