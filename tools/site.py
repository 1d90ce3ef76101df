"""The documentation site: pages, notebooks and READMEs collected into one folder, and built there by Sphinx.

``python -m tools.site build/site`` writes the site. Warnings are errors: a link to nothing, a page in no menu, a
docstring that is not valid text. Links between files of the repository become links between pages of the site.
"""

import argparse
import contextlib
import importlib
import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path, PurePosixPath

# What loads Drake is imported where it is used, so that an interrupt at any time ends the program with one line.
ROOT = Path(__file__).resolve().parents[1]
STAGE = ROOT / "build" / "pages"
"""Folder where the pages are collected."""

MENU = {
    "Tutorials": ("own_car", "tutorials/*"),
    "How-to guides": (
        "vehicles", "coming_from_ros_and_gazebo", "diagrams", "python", "driving", "worlds", "traffic", "world_editor",
        "tuning", "identification", "estimation", "batch", "learning",
    ),
    "Reference": (
        "commands", "kinds", "runs", "sensors", "tyres", "suspension", "powertrain", "ground", "manoeuvres",
        "tuning_reference", "identification_reference", "glossary", "api", "modules", "shipped_vehicles",
    ),
    "Explanation": (
        "physics", "tuning_method", "identification_method", "validation", "benchmarks", "security",
        "architecture",
    ),
    "Project": ("gallery", "changelog", "contributing"),
}  # fmt: skip
"""Titles of the menu with their pages; a page that is missing here is an error of the build."""

LISTS = {"modules": "Public modules", "shipped_vehicles": "Shipped vehicles"}
"""Pages of which only the title is written by hand; they list the pages of a folder."""

LINK = re.compile(r"(\[[^\]\[]*\])\((?!\w+:|#|/)([^)#\s]+)(#[^)\s]*)?\)")
"""Markdown link or picture into the repository: its text in brackets, its target and its anchor."""


def site_pages() -> dict[PurePosixPath, PurePosixPath]:
    """Return the page of the site for each file of the repository that becomes one, both relative."""
    pages = {path: PurePosixPath(path.name) for path in _files("docs/*.md")}
    pages |= {path: PurePosixPath("tutorials", path.name) for path in _files("notebooks/*.ipynb")}
    pages |= {
        path: PurePosixPath("shipped_vehicles", f"{path.parent.name}.md") for path in _files("models/*/README.md")
    }
    pages[PurePosixPath("benchmarks/README.md")] = PurePosixPath("benchmarks.md")
    pages[PurePosixPath("CONTRIBUTING.md")] = PurePosixPath("contributing.md")
    pages[PurePosixPath("CHANGELOG.md")] = PurePosixPath("changelog.md")
    pages[PurePosixPath("README.md")] = PurePosixPath("index.md")
    return pages


def rewrite_links(text: str, source: PurePosixPath, pages: dict[PurePosixPath, PurePosixPath], stage: str) -> str:
    """Return the text of a file with its links as they have to be in its page.

    :param source: the file, relative to the repository.
    :param stage: the folder of the pages, relative to the repository.
    """
    here = PurePosixPath(stage) / pages.get(source, PurePosixPath(source.name))

    def rewritten(match: re.Match[str]) -> str:
        target = PurePosixPath(os.path.normpath(source.parent / match[2]))
        if target in pages:
            target = PurePosixPath(stage) / pages[target]
        elif target.parent == PurePosixPath("docs"):  # a picture, which is copied beside the pages
            target = PurePosixPath(stage) / target.name
        elif target.suffix in {"", ".md"}:  # a folder, or a text that is not a page: the site has nothing to show
            return match[1][1:-1]
        return f"{match[1]}({PurePosixPath(os.path.relpath(target, here.parent)).as_posix()}{match[3] or ''})"

    return LINK.sub(rewritten, text)


def collect_pages(stage: Path) -> None:
    """Collect the pages, the pictures, the settings of Sphinx and a page for each public module in a new folder."""
    shutil.rmtree(stage, ignore_errors=True)
    pages = site_pages()
    for source, page in pages.items():
        target = stage / page
        target.parent.mkdir(parents=True, exist_ok=True)
        text = (ROOT / source).read_text(encoding="utf-8")
        target.write_text(rewrite_links(text, source, pages, stage.relative_to(ROOT).as_posix()), encoding="utf-8")
    shutil.copytree(ROOT / "notebooks" / "files", stage / "tutorials" / "files")
    menu = [_menu(f":caption: {title}\n:hidden:", entries) for title, entries in MENU.items()]
    index = stage / "index.md"
    index.write_text("\n".join([index.read_text(encoding="utf-8"), *menu]), encoding="utf-8")
    for name, title in LISTS.items():
        (stage / f"{name}.md").write_text(f"# {title}\n\n{_menu(':maxdepth: 1', [f'{name}/*'])}", encoding="utf-8")
    for file in sorted((ROOT / "docs").iterdir()):
        if file.suffix in {".jpg", ".png", ".svg", ".py", ".css"}:
            shutil.copy(file, stage)
    write_modules(stage / "modules")
    write_film(stage / "film.html")


def write_modules(folder: Path) -> None:
    """Write a page for each public module, in which an object that several modules export is described once."""
    from tools.api_page import MODULES, public_names

    folder.mkdir()
    seen: set[int] = set()
    for name in MODULES:
        module = importlib.import_module(f"mirdrake.{name}")
        public = {id(getattr(module, one)): one for one, _ in public_names(name)}
        repeated = ", ".join(sorted(public[key] for key in seen & set(public))) or "_"
        seen |= set(public)
        directive = (
            f".. automodule:: mirdrake.{name}\n   :members:\n   :exclude-members: {repeated}\n   :show-inheritance:"
        )
        page = f"# mirdrake.{name}\n\n```{{eval-rst}}\n{directive}\n```\n"
        (folder / f"{name}.md").write_text(page, encoding="utf-8")


def write_film(path: Path) -> None:
    """Write the recording of the gallery: a car brakes for a pedestrian, as in the notebook about crossings."""
    from mirdrake.runs.simulation import simulate
    from mirdrake.runs.stop import StopReason
    from mirdrake.suites import collect_cases
    from mirdrake.viewer.recording import recording_page

    (case,) = collect_cases([ROOT / "notebooks" / "files" / "crossing.yaml"])
    run = simulate(case.diagram)
    # Ctrl-C ends a simulation early without an exception.
    if run.stop.reason is StopReason.INTERRUPTED:
        raise KeyboardInterrupt
    path.write_text(recording_page(run), encoding="utf-8")


def build_site(folder: Path, *, outputs: bool = True) -> int:
    """Build the site; return the exit code of Sphinx. A folder that exists is replaced when all pages are complete.

    Args:
        folder: where the site is written.
        outputs: run the notebooks.
    """
    collect_pages(STAGE)
    new = folder.with_name(f"{folder.name}.new")
    shutil.rmtree(new, ignore_errors=True)
    command = [sys.executable, "-m", "sphinx", "--fresh-env", "--fail-on-warning", "--keep-going", "--builder", "html"]
    if not outputs:
        command += ["--define", "nb_execution_mode=off"]
    # Else autodoc executes Drake's type stubs in place of its modules.
    environment = {**os.environ, "SPHINX_AUTODOC_IGNORE_NATIVE_MODULE_TYPE_STUBS": "1"}
    try:
        # Sphinx reports an interrupt as a crash. In a session of its own it does not get that of the terminal.
        with subprocess.Popen(
            [*command, str(STAGE), str(new)], env=environment, cwd=ROOT, start_new_session=True
        ) as run:
            try:
                code = run.wait()
            except KeyboardInterrupt:
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(run.pid, signal.SIGKILL)
                raise
        # With warnings the pages are complete, and are needed to find out what is wrong.
        if (new / "index.html").is_file():
            shutil.rmtree(folder, ignore_errors=True)
            new.rename(folder)
    finally:
        shutil.rmtree(new, ignore_errors=True)
    return code


def main() -> int:
    """Build the site."""
    parser = argparse.ArgumentParser(description="build the documentation site")
    parser.add_argument("folder", type=Path, help="where the site is written")
    parser.add_argument("--without-outputs", action="store_true", help="do not run the notebooks")
    options = parser.parse_args()
    try:
        return build_site(options.folder, outputs=not options.without_outputs)
    except KeyboardInterrupt:
        state = "is that of an earlier build" if options.folder.exists() else "is not built"
        # Sphinx's line of progress may be unfinished.
        print(f"{chr(10) if sys.stdout.isatty() else ''}interrupted: {options.folder} {state}", file=sys.stderr)
        return 130


def _menu(options: str, entries: Iterable[str]) -> str:
    listed = "\n".join(entries)
    return f"```{{toctree}}\n{options}\n:glob:\n\n{listed}\n```\n"


def _files(pattern: str) -> list[PurePosixPath]:
    return [PurePosixPath(path.relative_to(ROOT).as_posix()) for path in sorted(ROOT.glob(pattern))]


if __name__ == "__main__":
    raise SystemExit(main())
