"""Debian's Chromium without a screen, for the tests of pages."""

import io
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

CHROMIUM, DRIVER = "/usr/bin/chromium", "/usr/bin/chromedriver"

NEEDS_BROWSER = [
    pytest.mark.browser,
    pytest.mark.skipif(not (os.access(CHROMIUM, os.X_OK) and os.access(DRIVER, os.X_OK)), reason=f"needs {CHROMIUM}"),
]
"""Marks of tests that open a page."""

PICTURES = Path(__file__).parents[1] / "build" / "test_pictures"
"""Where pictures of pages are kept, a folder a test file; ``make clean`` removes them."""


def take_picture(driver: Any, name: str) -> NDArray[np.uint8]:
    """Return a picture of the page as rows of red, green, blue, kept as a file.

    Args:
        driver: of :func:`open_browser`.
        name: of the file in :data:`PICTURES`, without suffix; folders with slashes.
    """
    content = driver.get_screenshot_as_png()
    file = PICTURES / f"{name}.png"
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes(content)
    return np.asarray(Image.open(io.BytesIO(content)).convert("RGB"))


def assert_not_blank(picture: NDArray[np.uint8]) -> None:
    """Reject a blank picture: the same grey value nearly everywhere, or hardly any pixel that differs."""
    grey = picture.astype(float).mean(axis=2)
    counts = np.bincount(grey.astype(int).ravel(), minlength=256)
    assert grey.std() > 8.0, f"the picture is blank: its grey values differ by {grey.std():.1f} only"
    assert counts.max() < 0.9 * grey.size, "the picture is blank: one grey value covers nine tenths of it"
    assert np.count_nonzero(counts > 1e-4 * grey.size) > 20, "the picture is blank: it has hardly any shades"


@contextmanager
def open_browser(folder: Path, *, width: int = 900, height: int = 600, network: bool = False) -> Iterator[Any]:
    """Headless Chromium with software rendering.

    Args:
        folder: empty, for what the browser keeps.
        width: of its window [px].
        height: of its window [px].
        network: whether it finds anything that is not in a file; without, whatever is not there fails to load.

    Yields:
        Selenium's driver.
    """
    webdriver = pytest.importorskip("selenium.webdriver")
    options = webdriver.ChromeOptions()
    options.binary_location = CHROMIUM
    for argument in (
        "--headless=new",
        "--no-sandbox",
        "--use-gl=angle",
        "--use-angle=swiftshader",
        "--enable-unsafe-swiftshader",
        "--disable-gpu-compositing",  # as without a GPU: else each change of a text costs a core for 0.2 s
        "--disable-dev-shm-usage",
        "--hide-scrollbars",
        f"--window-size={width},{height}",
        f"--user-data-dir={folder}",
        *([] if network else ["--proxy-server=127.0.0.1:9"]),  # nobody listens there
    ):
        options.add_argument(argument)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(DRIVER))
    driver.set_page_load_timeout(120)
    driver.set_script_timeout(120)
    try:
        yield driver
    finally:
        driver.quit()
