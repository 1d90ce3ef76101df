"""The page of a drive in a real browser without a screen: it loads, the car is seen, keys and sliders do something."""

import io
import json
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from mirdrake.logs import load_run
from mirdrake.simulation import simulate
from mirdrake.viewer import write_recording
from tests.chromium import NEEDS_BROWSER, open_browser

pytestmark = [*NEEDS_BROWSER, pytest.mark.slow]  # they drive in real time: other tests beside them take that away

Picture = NDArray[np.uint8]
Told = dict[str, Any]


class Page:
    """A drive with its page in a browser.

    Args:
        browser: Selenium's driver.
        url: of the page.
        folder: where pictures of it are kept.
    """

    def __init__(self, browser: Any, url: str, folder: Path) -> None:
        self.browser, self.folder = browser, folder
        browser.get(url)
        self.until(lambda told: "speed" in told)
        self._settle()

    def told(self) -> Told:
        """What the page was told last."""
        found: Told = json.loads(self.browser.execute_script("return document.body.dataset.told || '{}'"))
        return found

    def until(self, true: Callable[[Told], bool], *, seconds: float = 30.0) -> Told:
        """What is told as soon as something is true of it."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            told = self.told()
            if true(told):
                return told
            time.sleep(0.05)
        raise AssertionError(f"never true within {seconds} s; the last was {self.told()}")

    def key(self, code: str, *, down: bool) -> None:
        """Press or let go a key, as the browser's own protocol does it."""
        kind = "rawKeyDown" if down else "keyUp"
        self.browser.execute_cdp_cmd("Input.dispatchKeyEvent", {"type": kind, "code": code, "key": code})

    def look(self, name: str) -> Picture:
        """A picture of the page, kept as a file; what lies between the panels, as rows of red, green, blue."""
        self._settle()
        content = self.browser.get_screenshot_as_png()
        (self.folder / f"{name}.png").write_bytes(content)
        pixels = np.asarray(Image.open(io.BytesIO(content)).convert("RGB"))
        width = self.browser.execute_script("return document.getElementById('side').getBoundingClientRect().left")
        height = self.browser.execute_script("return document.getElementById('dash').getBoundingClientRect().top")
        return pixels[62 : int(height) - 4, : int(width) - 4]

    def _settle(self) -> None:
        """Wait until two more pictures were drawn."""
        count = "return viewer.renderer.info.render.frame"
        first, end = self.browser.execute_script(count), time.monotonic() + 20.0
        while self.browser.execute_script(count) < first + 2 and time.monotonic() < end:
            self.browser.execute_script("viewer.set_dirty()")
            time.sleep(0.1)


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """Headless Chromium."""
    with open_browser(tmp_path_factory.mktemp("chromium"), width=1280, height=800, network=True) as driver:
        yield driver


def start(folder: Path, *arguments: str) -> tuple["subprocess.Popen[str]", str]:
    """A drive in a process of its own, and the address that it prints."""
    command = [sys.executable, "-m", "mirdrake.cli", "drive", *arguments, "--port", "0", "--out", str(folder / "runs")]
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, cwd=Path(__file__).parents[1]
    )
    assert process.stdout is not None
    said = []
    for line in process.stdout:
        said.append(line)
        found = re.search(r"http://\S+", line)
        if found:
            return process, found[0]
    raise AssertionError(f"no address: {''.join(said)}")


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Path, str]]:
    """A drive on bare asphalt, which draws quickly; its folder and its address."""
    folder = tmp_path_factory.mktemp("drive_page")
    process, url = start(folder, "bolt", "empty", "--no-pages")
    yield folder, url
    process.send_signal(signal.SIGINT)
    out, _ = process.communicate(timeout=30)
    assert process.returncode == 0, out
    assert "Traceback" not in out


@pytest.fixture(scope="module")
def page(browser: Any, drive: tuple[Path, str]) -> Page:
    folder, url = drive
    sys.stdout.write(f"\npictures of the page: {folder}\n")
    return Page(browser, url, folder)


def paint(image: Picture) -> float:
    """Share of the picture that has the car's blue."""
    part = image.astype(int)
    return float(((part[..., 2] > part[..., 0] + 60) & (part[..., 2] > part[..., 1] + 25)).mean())


def test_the_page_loads_and_shows_the_car_in_its_middle(page: Page) -> None:
    image = page.look("1_start")
    assert image.std() > 15.0  # not blank
    assert paint(image) > 0.004
    part = image.astype(int)
    _, columns = np.nonzero((part[..., 2] > part[..., 0] + 60) & (part[..., 2] > part[..., 1] + 25))
    assert 0.45 < columns.mean() / image.shape[1] < 0.85  # of the part left of the panel
    texts = page.browser.execute_script("return document.body.innerText")
    for words in ("Chevrolet Bolt EV", "Reset", "Record", "speed.kp", "contacts", "brake; press again: reverse"):
        assert words in texts
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
    before = page.told()
    page.key("ArrowUp", down=True)
    told = page.until(lambda told: told["x"] > before["x"] + 2.0)
    assert told["speed"] > 1.0
    page.key("ArrowLeft", down=True)
    page.until(lambda told: told["steering"] > 0.1 and told["yaw"] > before["yaw"] + 0.05)
    page.look("2_left_turn")
    page.key("ArrowLeft", down=False)
    page.key("ArrowUp", down=False)
    page.key("Space", down=True)
    page.until(lambda told: abs(told["speed"]) < 0.1)
    page.key("Space", down=False)


def test_a_slider_changes_a_gain(page: Page) -> None:
    from selenium.webdriver.common.action_chains import ActionChains
    from selenium.webdriver.common.by import By

    assert page.told()["gains"]["speed.kp"] == 1.0
    slider = page.browser.find_element(By.ID, "gain-speed.kp")
    page.browser.execute_script("arguments[0].scrollIntoView()", slider)
    ActionChains(page.browser).move_to_element_with_offset(slider, 40, 0).click().perform()
    value = page.until(lambda told: told["gains"]["speed.kp"] != 1.0)["gains"]["speed.kp"]
    assert 2.5 < value < 5.0  # right of the middle of 0 to 5
    page.browser.find_element(By.ID, "given").click()
    page.until(lambda told: told["gains"]["speed.kp"] == 1.0)


def test_the_views_look_different_and_overlays_are_drawn(page: Page) -> None:
    from selenium.webdriver.common.by import By

    page.browser.find_element(By.ID, "layer-contacts").click()
    page.until(lambda told: "contacts" in told["layers"])
    images = []
    for number, name in enumerate(("follow", "cockpit", "map"), start=1):
        page.key(f"Digit{number}", down=True)
        page.key(f"Digit{number}", down=False)
        images.append(page.look(f"3_{name}"))
    for i, image in enumerate(images):
        assert image.std() > 5.0
        for other in images[i + 1 :]:
            assert np.abs(image.astype(int) - other.astype(int)).max(axis=2).mean() > 10.0
    page.key("Digit1", down=True)
    page.key("Digit1", down=False)


def test_recording_writes_a_run_and_reset_returns_the_car(page: Page) -> None:
    from selenium.webdriver.common.by import By

    press = page.browser.find_element
    page.key("KeyW", down=True)
    press(By.ID, "record").click()
    begun = page.until(lambda told: told["recording"] is not None)
    folder = Path(begun["recording"])
    page.until(lambda told: told["recording"] is not None and told["distance"] > begun["distance"] + 5.0)
    page.key("KeyW", down=False)
    press(By.ID, "record").click()
    page.until(lambda told: told["recording"] is None)
    run = load_run(folder)
    assert run["ego.x"].iloc[-1] - run["ego.x"].iloc[0] != 0.0
    assert len(run.signals) > 10
    press(By.ID, "reset").click()
    told = page.until(lambda told: told["distance"] < 0.5)
    assert (told["x"], told["y"]) == pytest.approx((0.0, 0.0), abs=0.6)
    page.look("4_after_reset")


def test_a_game_pad_drives(page: Page) -> None:
    pad = (
        "const pad = {connected: true, axes: [-0.6, 0, 0, 0], buttons: Array.from({length: 17}, (_, i) =>"
        " ({value: i === 7 ? 0.8 : 0, pressed: i === 7}))}; navigator.getGamepads = () => [pad];"
    )
    page.browser.execute_script(pad)
    told = page.until(lambda told: told["speed"] > 1.0 and told["steering"] > 0.05)
    assert told["wanted_steering"] > 0.0
    page.browser.execute_script("navigator.getGamepads = () => []")


def test_a_page_that_is_left_brakes_the_car(page: Page) -> None:
    page.key("KeyW", down=True)
    url = page.browser.current_url
    page.until(lambda told: told["speed"] > 1.0)
    page.browser.get("about:blank")
    time.sleep(4.0)
    page.browser.get(url)
    told = page.until(lambda told: "speed" in told)
    assert told["lost"]
    page.until(lambda told: abs(told["speed"]) < 0.1)
    assert "input lost" in page.browser.execute_script("return document.body.innerText")
    page.look("5_input_lost")
    page.key("KeyW", down=False)


# --- recorded ----------------------------------------------------------------------------------------------------


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
    end = time.monotonic() + 30.0
    while browser.execute_script("return typeof viewer") != "object" and time.monotonic() < end:
        time.sleep(0.1)
    pictures = []
    for number, name in enumerate(("Follow", "Cockpit", "Map")):
        browser.execute_script("document.querySelectorAll('#views button')[arguments[0]].click()", number)
        browser.execute_script("viewer.animator.pause(); viewer.animator.seek(0.2); viewer.render();")
        content = browser.get_screenshot_as_png()
        (tmp_path / f"{name}.png").write_bytes(content)
        pictures.append(np.asarray(Image.open(io.BytesIO(content)).convert("RGB")).astype(int))
        assert browser.execute_script("return document.querySelector('#views button.on').textContent") == name
    assert np.abs(pictures[0] - pictures[1]).max(axis=2).mean() > 10.0
    assert np.abs(pictures[1] - pictures[2]).max(axis=2).mean() > 10.0


# --- the pace ----------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_with_a_software_renderer_beside_it_the_drive_keeps_half_the_pace(browser: Any, tmp_path: Path) -> None:
    process, url = start(tmp_path, "mkz", "parking_lot", "--no-pages")
    try:
        page = Page(browser, url, tmp_path)
        for layer in ("lidar", "contacts", "tyres", "friction"):
            browser.execute_script(f"document.getElementById('layer-{layer}').click()")
        page.key("KeyW", down=True)
        page.key("KeyA", down=True)
        began, first = time.monotonic(), page.told()["time"]
        time.sleep(60.0)
        told, passed = page.told(), time.monotonic() - began
        page.look("pace")
    finally:
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=30)
    assert (told["time"] - first) / passed >= 0.5
