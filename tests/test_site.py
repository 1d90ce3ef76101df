"""The documentation site: which files become its pages, and their links. ``make docs`` builds it."""

import subprocess
import sys
import time
from fnmatch import fnmatch
from pathlib import Path, PurePosixPath
from typing import Any

import pytest

from tools import site
from tools.api_page import ROOT
from tools.site import MENU, rewrite_links, site_pages


def test_a_link_between_files_becomes_a_link_between_pages():
    """A page of docs/, a notebook, and a README of a vehicle; a picture; a file that is no page; a folder."""
    pages = {
        PurePosixPath("docs/tyres.md"): PurePosixPath("tyres.md"),
        PurePosixPath("notebooks/01.ipynb"): PurePosixPath("tutorials/01.ipynb"),
        PurePosixPath("models/bolt/README.md"): PurePosixPath("shipped_vehicles/bolt.md"),
    }
    text = (
        "[a](../models/bolt/README.md#mass) [b](../notebooks/01.ipynb) ![c](drive.jpg) [d](../mirdrake/x.py) [e](../t)"
    )
    assert rewrite_links(text, PurePosixPath("docs/tyres.md"), pages, "build/pages") == (
        "[a](shipped_vehicles/bolt.md#mass) [b](tutorials/01.ipynb) ![c](drive.jpg) [d](../../mirdrake/x.py) e"
    )
    assert rewrite_links("[t](../../docs/tyres.md)", PurePosixPath("models/bolt/README.md"), pages, "build/pages") == (
        "[t](../tyres.md)"
    )
    assert rewrite_links("[w](https://drake.mit.edu) [h](#here)", PurePosixPath("docs/tyres.md"), pages, "b") == (
        "[w](https://drake.mit.edu) [h](#here)"
    )


def test_every_page_is_in_the_menu_once():
    shown = {page.with_suffix("").as_posix() for page in site_pages().values()} - {"index"}
    for page in sorted(shown):
        entries = [entry for entries in MENU.values() for entry in entries if fnmatch(page, entry)]
        listed = page.startswith("shipped_vehicles/")
        assert len(entries) + listed == 1, f"name {page} in MENU of tools/site.py"
    assert (ROOT / "docs" / "conf.py").is_file()


def test_formulas_within_paragraphs_are_formulas_of_the_site():
    """Notebooks write ``$$…$$`` on a line of a paragraph; without this setting MyST shows the dollar signs."""
    sources = [path.read_text(encoding="utf-8") for path in (ROOT / "notebooks").glob("*.ipynb")]
    assert any('"$$' in text for text in sources)
    assert "myst_dmath_double_inline = True" in (ROOT / "docs" / "conf.py").read_text(encoding="utf-8")


def test_an_interrupted_build_leaves_the_site_of_an_earlier_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "site"
    folder.mkdir()
    (folder / "index.html").write_text("old", encoding="utf-8")
    # In place of Sphinx: a program that writes half a site and never ends, and Ctrl-C at that time.
    half = "import pathlib, sys, time; f = pathlib.Path(sys.argv[-1]); f.mkdir(); (f / 'half').touch(); time.sleep(60)"

    class Build(subprocess.Popen[bytes]):
        def __init__(self, command: list[str], **options: Any) -> None:
            super().__init__([sys.executable, "-c", half, *command[-2:]], **options)

        def wait(self, timeout: float | None = None) -> int:
            if self.poll() is None and not (tmp_path / "site.new" / "half").exists():
                while not (tmp_path / "site.new" / "half").exists():
                    time.sleep(0.01)
                raise KeyboardInterrupt
            return super().wait(timeout)

    monkeypatch.setattr(site, "collect_pages", lambda _: None)
    monkeypatch.setattr(subprocess, "Popen", Build)
    monkeypatch.setattr(sys, "argv", ["site", str(folder)])
    assert site.main() == 130
    assert [file.name for file in tmp_path.iterdir()] == ["site"]
    assert (folder / "index.html").read_text(encoding="utf-8") == "old"
    assert capsys.readouterr().err == f"interrupted: {folder} is that of an earlier build\n"
