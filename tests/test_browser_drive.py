"""The page of a drive in a headless browser: it loads, the car is visible, keys and sliders have an effect.

The tests wait for the readings of the page, never for a time: beside others the browser is slow, and the car gets far.
"""

import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from math import pi
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mirdrake.runs.logs import load_run
from mirdrake.runs.simulation import simulate
from mirdrake.viewer import write_recording
from tests.chromium import NEEDS_BROWSER, PICTURES, assert_not_blank, open_browser, take_picture

pytestmark = NEEDS_BROWSER

Picture = NDArray[np.uint8]
Readings = dict[str, Any]

_READINGS = "return JSON.parse(document.body.dataset.readings || '{}')"
_TWO_MORE = """
const done = arguments[0], first = viewer.renderer.info.render.frame, end = performance.now() + 20000;
(function look() {
  if (viewer.renderer.info.render.frame >= first + 2 || performance.now() > end) return done();
  viewer.set_dirty();
  setTimeout(look, 20);
})();
"""


class Page:
    """A drive with its page in a browser.

    Args:
        browser: Selenium's driver.
        url: of the page.
    """

    def __init__(self, browser: Any, url: str) -> None:
        self.browser = browser
        browser.get(url)
        self.until(lambda readings: "speed" in readings)

    def readings(self) -> Readings:
        """Return the latest readings of the page."""
        result: Readings = self.browser.execute_script(_READINGS)
        return result

    def until(self, true: Callable[[Readings], bool], *, seconds: float = 60.0) -> Readings:
        """Return the first readings for which a condition is true."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            readings = self.readings()
            if true(readings):
                return readings
            time.sleep(0.05)
        raise AssertionError(f"never true within {seconds} s; the last was {self.readings()}")

    @contextmanager
    def held(self, code: str) -> Iterator[None]:
        """Hold a key by the browser's protocol."""
        key = {"code": code, "key": code}
        self.browser.execute_cdp_cmd("Input.dispatchKeyEvent", {"type": "rawKeyDown", **key})
        try:
            yield
        finally:
            self.browser.execute_cdp_cmd("Input.dispatchKeyEvent", {"type": "keyUp", **key})

    def click(self, name: str) -> None:
        """Click the element with this id."""
        from selenium.webdriver.common.by import By

        self.browser.find_element(By.ID, name).click()

    def text(self, name: str) -> str:
        """Return the text of the element with this id."""
        result: str = self.browser.execute_script("return document.getElementById(arguments[0]).textContent", name)
        return result

    def stand(self) -> Readings:
        """Stop the car."""
        with self.held("Space"):
            return self.until(lambda readings: abs(readings["speed"]) < 0.1 and readings["speed_command"] == 0.0)

    def look(self, name: str) -> Picture:
        """Save an image of the page after two more frames; return the part between the panels."""
        self.browser.execute_async_script(_TWO_MORE)
        picture = take_picture(self.browser, f"drive/{name}")
        width, height = self.browser.execute_script(
            "return [document.getElementById('side').getBoundingClientRect().left,"
            " document.getElementById('dash').getBoundingClientRect().top]"
        )
        return picture[62 : int(height) - 4, : int(width) - 4]


def start(folder: Path, *arguments: str) -> "subprocess.Popen[str]":
    """Return a drive in a process of its own."""
    command = [sys.executable, "-m", "mirdrake.cli", "drive", *arguments, "--port", "0", "--out", str(folder / "runs")]
    root = Path(__file__).parents[1]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, cwd=root)


def address(process: "subprocess.Popen[str]") -> str:
    """Return the address that a drive prints."""
    assert process.stdout is not None
    lines = []
    for line in process.stdout:
        lines.append(line)
        match = re.search(r"http://\S+", line)
        if match:
            return match[0]
    raise AssertionError(f"no address: {''.join(lines)}")


def finish(process: "subprocess.Popen[str]") -> None:
    """End a drive as Ctrl-C does and check that it prints no error."""
    process.send_signal(signal.SIGINT)
    out, _ = process.communicate(timeout=60)
    assert process.returncode == 0, out
    assert "Traceback" not in out


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Iterator["subprocess.Popen[str]"]:
    """A drive on bare asphalt, which draws quickly; it begins while the browser does."""
    process = start(tmp_path_factory.mktemp("drive_page"), "bolt", "empty", "--no-pages")
    yield process
    finish(process)


@pytest.fixture(scope="module")
def browser(drive: "subprocess.Popen[str]", tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """Headless Chromium."""
    with open_browser(tmp_path_factory.mktemp("chromium"), width=1024, height=800, network=True) as driver:
        yield driver


@pytest.fixture(scope="module")
def page(browser: Any, drive: "subprocess.Popen[str]") -> Page:
    sys.stdout.write(f"\npictures of the page: {PICTURES / 'drive'}\n")
    return Page(browser, address(drive))


def paint(image: Picture) -> NDArray[np.bool_]:
    """Return the mask of the pixels with the blue of the car."""
    part = image.astype(int)
    mask: NDArray[np.bool_] = (part[..., 2] > part[..., 0] + 60) & (part[..., 2] > part[..., 1] + 25)
    return mask


def turned(readings: Readings, before: Readings) -> float:
    """Return the heading change of the car to the left, -π to π [rad]."""
    return float((readings["yaw"] - before["yaw"] + pi) % (2.0 * pi) - pi)


def apart(image: Picture, other: Picture) -> float:
    """Return the difference of two images, of 255."""
    return float(np.abs(image.astype(int) - other.astype(int)).max(axis=2).mean())


def test_the_page_loads_and_shows_the_car_in_the_middle_of_what_the_panel_leaves_free(page: Page) -> None:
    image = page.look("1_start")
    assert_not_blank(image)
    blue = paint(image)
    assert blue.mean() > 0.004
    assert 0.45 < np.nonzero(blue)[1].mean() / image.shape[1] < 0.55
    texts = page.browser.execute_script("return document.body.innerText")
    for words in ("Chevrolet Bolt EV", "Reset", "Record", "speed.kp", "contact forces", "brake; press again: reverse"):
        assert words in texts
    assert "to accelerate" in page.text("help")
    severe = [entry["message"] for entry in page.browser.get_log("browser") if entry["level"] == "SEVERE"]
    assert severe == []


def test_nothing_on_the_page_overlaps(page: Page) -> None:
    boxes = page.browser.execute_script(
        "return ['bar', 'side', 'dash'].map(id => { const b = document.getElementById(id).getBoundingClientRect();"
        " return [b.left, b.top, b.right, b.bottom]; }).concat([[0, 0, innerWidth, innerHeight]])"
    )
    *panels, window = boxes
    for i, (left, top, right, bottom) in enumerate(panels):
        assert left >= 0 and top >= 0 and right <= window[2] and bottom <= window[3]  # noqa: PT018
        for other in panels[i + 1 :]:
            assert right <= other[0] or other[2] <= left or bottom <= other[1] or other[3] <= top


def test_keys_drive_and_steer_the_car(page: Page) -> None:
    before = page.readings()
    with page.held("ArrowUp"):
        readings = page.until(lambda readings: readings["x"] > before["x"] + 2.0 and readings["speed"] > 1.0)
        assert readings["speed_command"] > 0.0
    # The throttle is let go: the faster, the less the keys steer, and a slow browser makes the car fast.
    with page.held("ArrowLeft"):
        page.until(lambda readings: readings["steering"] > 0.01 and turned(readings, before) > 0.05)
        page.look("2_left_turn")
    assert not page.browser.execute_script("return document.getElementById('help').checkVisibility()")
    page.stand()
    page.until(lambda _: page.text("state") == "ready: press ↑ or W" and page.text("gear") == "N")


def test_a_slider_changes_a_gain(page: Page) -> None:
    from selenium.webdriver.common.action_chains import ActionChains
    from selenium.webdriver.common.by import By

    assert page.readings()["gains"]["speed.kp"] == 1.0
    slider = page.browser.find_element(By.ID, "gain-speed.kp")
    page.browser.execute_script("arguments[0].scrollIntoView()", slider)
    ActionChains(page.browser).move_to_element_with_offset(slider, 40, 0).click().perform()
    value = page.until(lambda readings: readings["gains"]["speed.kp"] != 1.0)["gains"]["speed.kp"]
    assert 2.5 < value < 5.0  # right of the middle of 0 to 5
    page.click("given")
    page.until(lambda readings: readings["gains"]["speed.kp"] == 1.0)


def test_reset_returns_the_car(page: Page) -> None:
    assert page.readings()["x"] > 2.0  # it was driven
    page.click("reset")
    readings = page.until(lambda readings: readings["distance"] < 0.5)
    assert (readings["x"], readings["y"]) == pytest.approx((0.0, 0.0), abs=0.6)
    assert_not_blank(page.look("3_after_reset"))


@pytest.mark.slow
def test_a_page_without_connection_loses_the_wheel_and_the_car_brakes(page: Page) -> None:
    cable = {"latency": 0, "downloadThroughput": -1, "uploadThroughput": -1}
    page.browser.execute_cdp_cmd("Network.enable", {})
    with page.held("KeyW"):
        page.until(lambda readings: readings["speed"] > 2.0)
        page.browser.execute_cdp_cmd("Network.emulateNetworkConditions", {"offline": True, **cable})
        page.until(lambda _: page.text("state") == "no answer")
    page.browser.execute_cdp_cmd("Network.emulateNetworkConditions", {"offline": False, **cable})
    page.until(lambda readings: readings["lost"] and abs(readings["speed"]) < 0.1 and readings["speed_command"] == 0.0)
    page.until(lambda _: page.text("state") == "input lost" and "input lost: braking" in page.text("note"))
    page.look("4_input_lost")
    with page.held("KeyW"):
        page.until(lambda readings: not readings["lost"] and readings["speed"] > 0.5)
    page.stand()


@pytest.mark.slow
def test_a_game_pad_drives(page: Page) -> None:
    pad = (
        "const pad = {connected: true, axes: [-0.6, 0, 0, 0], buttons: Array.from({length: 17}, (_, i) =>"
        " ({value: i === 7 ? 0.8 : 0, pressed: i === 7}))}; navigator.getGamepads = () => [pad];"
    )
    page.browser.execute_script(pad)
    page.until(
        lambda readings: readings["speed"] > 1.0 and readings["steering"] > 0.01 and readings["steering_command"] > 0.01
    )
    page.browser.execute_script("navigator.getGamepads = () => []")
    page.stand()


@pytest.mark.slow
def test_the_views_look_different_and_overlays_are_drawn(page: Page) -> None:
    page.click("layer-contacts")
    page.until(lambda readings: "contacts" in readings["layers"])
    images = []
    for number, name in enumerate(("follow", "cockpit", "map"), start=1):
        with page.held(f"Digit{number}"):
            pass
        images.append(page.look(f"5_{name}"))
    for i, image in enumerate(images):
        assert image.std() > 5.0
        assert all(apart(image, other) > 10.0 for other in images[i + 1 :])
    with page.held("Digit1"):
        pass


@pytest.mark.slow
def test_recording_writes_a_run(page: Page) -> None:
    with page.held("KeyW"):
        page.click("record")
        begun = page.until(lambda readings: readings["recording"] is not None)
        folder = Path(begun["recording"])
        page.until(
            lambda readings: readings["recording"] is not None and readings["distance"] > begun["distance"] + 5.0
        )
    page.click("record")
    page.until(lambda readings: readings["recording"] is None)
    run = load_run(folder)
    assert run["ego.x"].iloc[-1] - run["ego.x"].iloc[0] > 1.0
    assert len(run.signals) > 10
    page.stand()


# --- recorded ----------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_recorded_run_opens_offline_and_has_the_same_views(browser: Any, tmp_path: Path) -> None:
    data = {
        "world": "empty",
        "vehicles": {"ego": {"model": "bolt", "speed": 5.0}},
        "control": {"ego": {"kind": "constant", "speed": 5.0}},
        "plant": {"contact": "point"},
        "duration": 0.5,
    }
    run = simulate(data, folder=tmp_path / "run")
    browser.get(write_recording(run).as_uri())
    end = time.monotonic() + 60.0
    while browser.execute_script("return typeof viewer") != "object" and time.monotonic() < end:
        time.sleep(0.1)
    pictures = []
    for number, name in enumerate(("Follow", "Cockpit", "Map")):
        browser.execute_script("document.querySelectorAll('#views button')[arguments[0]].click()", number)
        browser.execute_script("viewer.animator.pause(); viewer.animator.seek(0.2); viewer.render();")
        pictures.append(take_picture(browser, f"recording/{name}"))
        assert browser.execute_script("return document.querySelector('#views button.on').textContent") == name
    assert_not_blank(pictures[0])
    assert apart(pictures[0], pictures[1]) > 10.0
    assert apart(pictures[1], pictures[2]) > 10.0


# --- the pace ----------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_with_a_software_renderer_beside_it_the_drive_keeps_half_the_pace(browser: Any, tmp_path: Path) -> None:
    process = start(tmp_path, "mkz", "parking_lot", "--no-pages")
    try:
        browser.set_window_size(1280, 800)
        page = Page(browser, address(process))
        for layer in ("lidar", "contacts", "tyres", "friction"):
            browser.execute_script(f"document.getElementById('layer-{layer}').click()")
        with page.held("KeyW"), page.held("KeyA"):
            began, first = time.monotonic(), page.readings()["time"]
            time.sleep(60.0)
            readings, passed = page.readings(), time.monotonic() - began
            assert_not_blank(page.look("6_pace"))
    finally:
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=60)
    factor = (readings["time"] - first) / passed
    sys.stdout.write(f"\nreal-time factor with a software renderer {factor:.3f}\n")
    assert factor >= 0.5
