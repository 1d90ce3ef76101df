"""`mirdrake replay`: the Meshcat recording with synchronised camera images."""

import io
import json
import re
import threading
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from mirdrake.cli import main
from mirdrake.core.errors import RunError
from mirdrake.runs.logs import Run, load_run
from mirdrake.runs.simulation import simulate
from mirdrake.viewer import replay
from mirdrake.viewer.replay import Replay, write_replay
from tests.chromium import NEEDS_BROWSER, open_browser
from tests.recording_rigs import install_stubs
from tests.test_recording import drive


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Two seconds with pictures that get brighter, and depths."""
    folder = tmp_path_factory.mktemp("replay") / "run"
    spec = drive(duration=2.0)
    spec["sensors"] = {"ego": ["left_camera"]}
    with pytest.MonkeyPatch.context() as patch:
        install_stubs(patch, several=True)
        simulate(spec, folder=folder)
    return load_run(folder)


@pytest.fixture(scope="module")
def page(run: Run, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page that opens offline."""
    path = tmp_path_factory.mktemp("page") / "replay.html"
    assert main(["replay", str(run.folder), "--out", str(path)]) == 0
    return path


def cameras_of(text: str) -> list[dict[str, Any]]:
    match = re.search(r'<script id="pictures" type="application/json">(.*?)</script>', text, re.DOTALL)
    assert match is not None
    cameras: list[dict[str, Any]] = json.loads(match[1])
    return cameras


def test_a_page_has_every_picture_with_its_time(page: Path) -> None:
    cameras = {camera["name"]: camera for camera in cameras_of(page.read_text(encoding="utf-8"))}
    assert list(cameras) == ["ego.left_camera", "ego.left_camera.depth", "ego.left_camera.label"]
    for camera in cameras.values():
        np.testing.assert_allclose(camera["times"], np.arange(61) / 30.0, atol=1e-6)
        assert len(camera["sources"]) == len(camera["speed"]) == len(camera["steering"]) == 61
    assert cameras["ego.left_camera"]["sources"][0].startswith("data:image/jpeg;base64,")


def test_a_page_of_a_long_run_leaves_pictures_out(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(replay, "MOST", 50)
    write_replay(run, tmp_path / "replay.html")
    cameras = cameras_of((tmp_path / "replay.html").read_text(encoding="utf-8"))
    assert [len(camera["times"]) for camera in cameras] == [16, 16, 16]  # every fourth of 61
    np.testing.assert_allclose(cameras[0]["times"], np.arange(0, 61, 4) / 30.0, atol=1e-6)


def test_the_page_on_this_machine_gives_each_picture_and_nothing_else(run: Run) -> None:
    served = Replay(run)
    thread = threading.Thread(target=served.serve)
    thread.start()
    try:
        with urllib.request.urlopen(served.url) as answer:
            cameras = cameras_of(answer.read().decode())
        with urllib.request.urlopen(served.url + cameras[0]["sources"][7]) as answer:
            assert answer.headers["Content-Type"] == "image/jpeg"
            assert answer.read() == run.pictures["ego.left_camera"][7].path.read_bytes()
        with urllib.request.urlopen(served.url + cameras[1]["sources"][7]) as answer:
            depth = Image.open(io.BytesIO(answer.read()))
        assert (depth.mode, depth.getpixel((5, 5))) == ("L", 255)
        for path in ("spec.yaml", "../spec.yaml", "pictures/ego.left_camera/driving_log.txt"):
            with pytest.raises(urllib.error.HTTPError, match="404") as caught:
                urllib.request.urlopen(served.url + path)
            caught.value.close()
        with pytest.raises(RunError, match=r"cannot listen on port \d+ of localhost: Address already in use; choose"):
            Replay(run, port=int(urlsplit(served.url).port or 0))
    finally:
        served.close()
        thread.join()


def test_a_run_that_cannot_be_replayed_is_an_error(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], run: Run
) -> None:
    (tmp_path / "bare").mkdir()
    (tmp_path / "bare" / "spec.yaml").write_bytes((run.folder or tmp_path).joinpath("spec.yaml").read_bytes())
    expected_errors = {
        "not a run folder": [str(tmp_path), "--out", str(tmp_path / "x.html")],
        "has no samples to replay": [str(tmp_path / "bare"), "--out", str(tmp_path / "x.html")],
        "is a folder; a file is expected": [str(run.folder), "--out", str(tmp_path)],
    }
    for words, arguments in expected_errors.items():
        assert main(["replay", *arguments]) == 2
        error = capsys.readouterr().err
        assert words in error
        assert error.count("\n") == 1
    assert not (tmp_path / "x.html").exists()


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """Headless Chromium."""
    with open_browser(tmp_path_factory.mktemp("chromium")) as driver:
        yield driver


class TestBrowser:
    """With a browser, and without a network."""

    pytestmark = NEEDS_BROWSER

    def test_the_pictures_follow_the_recording(self, page: Path, browser: Any) -> None:
        from selenium.webdriver.support.ui import WebDriverWait

        browser.get(page.as_uri())
        ready = (
            "return typeof viewer == 'object' && viewer.animator.duration > 1.9 && document.readyState == 'complete'"
        )
        WebDriverWait(browser, 60).until(lambda driver: driver.execute_script(ready))
        seek = "viewer.animator.pause(); viewer.animator.seek(arguments[0]); viewer.render();"
        caption = "return document.querySelector('#cameras figcaption').textContent"
        levels = {}
        for time in (0.5, 1.8):
            browser.execute_script(seek, time)
            WebDriverWait(browser, 30).until(lambda driver, t=time: f"· {t:.2f} s ·" in driver.execute_script(caption))
            image = browser.find_element("css selector", "#cameras img")
            WebDriverWait(browser, 30).until(
                lambda driver, picture=image: driver.execute_script("return arguments[0].complete", picture)
            )
            shown = np.asarray(Image.open(io.BytesIO(image.screenshot_as_png)).convert("RGB"))
            levels[time] = float(np.median(shown))
        assert levels == pytest.approx({0.5: 20.0 + 15.0, 1.8: 20.0 + 54.0}, abs=2.0)
        whole = _picture(browser)
        assert len(np.unique((whole // 8).reshape(-1, 3), axis=0)) > 60  # the car, ground and sky beside it
        errors = [entry["message"] for entry in browser.get_log("browser") if entry["level"] == "SEVERE"]
        assert not errors


def _picture(browser: Any) -> NDArray[np.uint8]:
    return np.asarray(Image.open(io.BytesIO(browser.get_screenshot_as_png())).convert("RGB"))
