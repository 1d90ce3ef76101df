"""Debian's Chromium without a screen, for the tests of pages."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

CHROMIUM, DRIVER = "/usr/bin/chromium", "/usr/bin/chromedriver"

NEEDS_BROWSER = [
    pytest.mark.browser,
    pytest.mark.skipif(not (os.access(CHROMIUM, os.X_OK) and os.access(DRIVER, os.X_OK)), reason=f"needs {CHROMIUM}"),
]
"""Marks of tests that open a page."""


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
