"""A copy of the package with one new file and one new line, as a user would add a kind."""

import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


def run_in_copy(
    folder: Path,
    *,
    new: dict[str, str],
    check: str,
    lines: Sequence[tuple[str, str, str]] = (),
    imported: Sequence[tuple[str, str]] = (),
) -> None:
    """Run a script against a copy of the package to which a kind was added.

    Args:
        folder: where the copy is made.
        new: text of each new file, by its path below mirdrake/.
        check: the script; it fails by an exception.
        lines: path of a registry, a text of it, and that text with the new entry.
        imported: path of a registry, and the import that the new entry needs.

    Raises:
        AssertionError: the script failed; with the end of its output.
    """
    package = folder / "mirdrake"
    shutil.copytree(ROOT / "mirdrake", package, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("models", "worlds", "diagrams", "pyproject.toml"):
        (folder / name).symlink_to(ROOT / name)
    for path, text in new.items():
        (package / path).write_text(text, encoding="utf-8")
    for path, old, changed in lines:
        text = (package / path).read_text(encoding="utf-8")
        assert text.count(old) == 1, f"{path} has {old!r} {text.count(old)} times"
        (package / path).write_text(text.replace(old, changed), encoding="utf-8")
    for path, statement in imported:
        text = (package / path).read_text(encoding="utf-8")
        head, first, rest = text.partition("\nfrom mirdrake.")
        (package / path).write_text(f"{head}\n{statement}{first}{rest}", encoding="utf-8")
    environment = {**os.environ, "PYTHONPATH": str(folder), "NUMBA_CACHE_DIR": str(folder / "numba")}
    done = subprocess.run(
        [sys.executable, "-c", check], cwd=folder, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr[-2000:]
