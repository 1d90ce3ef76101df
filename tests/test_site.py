"""The documentation site: which files become its pages, and their links. ``make docs`` builds it."""

from fnmatch import fnmatch
from pathlib import PurePosixPath

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
