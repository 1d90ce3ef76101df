"""Where models, worlds, diagrams and studies are found.

A name is looked up, first match wins, as

1. a path as it stands (absolute, or relative to the working directory),
2. ``<folder>/{models,worlds,diagrams,studies}/<name>`` in each folder of the environment variable ``MIRDRAKE_PATH``,
3. the same below the working directory,
4. the data shipped with mirdrake.

Hidden files and folders have no name. New vehicles and worlds are made in a hidden folder (:func:`staging`) and appear
when they are complete.
"""

import os
import shutil
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from mirdrake.core.errors import ConfigError, did_you_mean

_PACKAGE = Path(__file__).resolve().parents[1]
_STAGING = ".mirdrake-"
_ABANDONED = 86_400.0  # [s], age of a staging folder that nobody uses, where no lock shows it


def data_root() -> Path:
    """Folder that holds models/, worlds/, diagrams/ and studies/: share/ when installed, else the checkout."""
    share = _PACKAGE / "share"
    return share if share.is_dir() else _PACKAGE.parent


def resolved(path: Path) -> Path:
    """Return an absolute path without links; a loop of links is no error here, but where the file is opened."""
    return Path(os.path.realpath(path))


def search_folders(kind: str) -> list[Path]:
    """The existing folders in which names of one kind are looked up, first one first.

    Args:
        kind: "models", "worlds", "diagrams" or "studies".
    """
    entries = os.environ.get("MIRDRAKE_PATH", "").split(os.pathsep)
    roots = [Path(os.path.expanduser(entry)) for entry in entries if entry]
    roots += [Path(os.curdir), data_root()]
    folders: list[Path] = []
    for root in roots:
        folder = resolved(root / kind)
        if folder.is_dir() and folder not in folders:
            folders.append(folder)
    return folders


def names(kind: str) -> dict[str, Path]:
    """All names of one kind with their files (for models: their folders), sorted by name.

    Args:
        kind: "models", "worlds", "diagrams" or "studies".
    """
    found: dict[str, Path] = {}
    for folder in search_folders(kind):
        if kind == "models":
            entries = {path.parent.name: path.parent for path in folder.glob("*/vehicle.yaml")}
        else:
            entries = {path.stem: path for path in folder.glob("*.yaml")}
        for name, path in entries.items():
            if not is_hidden(name):
                found.setdefault(name, path)
    return dict(sorted(found.items()))


def is_hidden(name: str) -> bool:
    """Whether a file or folder of that name is never listed, as those in which something is being made."""
    return name.startswith(".")


def find(kind: str, name: str, *, where: str = "") -> Path:
    """The file (for models: the folder) that a name stands for.

    Args:
        kind: "models", "worlds", "diagrams" or "studies".
        name: a bare name or a path.
        where: prefix of the error message, for example ``"drive.yaml:3: world"``.

    Raises:
        ConfigError: nothing has that name.
    """
    one = {"models": "vehicle", "worlds": "world", "diagrams": "diagram", "studies": "study"}[kind]
    prefix = f"{where}: " if where else ""
    as_path = Path(os.path.expanduser(name))  # leaves "~nobody" alone, where Path.expanduser raises
    is_yaml = as_path.suffix in {".yaml", ".yml"}
    if _is_file(as_path / "vehicle.yaml") if kind == "models" else is_yaml and _is_file(as_path):
        return resolved(as_path)
    known = names(kind)
    if name in known:
        return known[name]
    if os.sep in name or is_yaml:
        wanted = "a folder with a vehicle.yaml" if kind == "models" else "a .yaml file"
        raise ConfigError(f"{prefix}no {one} at '{name}': {wanted} is expected there")
    raise ConfigError(f"{prefix}unknown {one} '{name}'; {did_you_mean(name, known)}")


def _is_file(path: Path) -> bool:
    """Whether there is such a file; no for a name that no file can have."""
    try:
        return path.is_file()
    except OSError:  # too long, or in a folder we may not enter
        return False


def cache_folder(kind: str) -> Path:
    """Folder for what can be computed again: ``mirdrake/<kind>`` in the user's cache (XDG_CACHE_HOME); may not exist.

    Args:
        kind: of the content, for example "convex".
    """
    given = os.environ.get("XDG_CACHE_HOME", "")
    if os.path.isabs(given):  # the XDG specification has relative paths ignored
        base = Path(given)
    elif sys.platform == "darwin":
        base = Path(os.path.expanduser("~/Library/Caches"))
    elif sys.platform == "win32":
        base = Path(os.environ.get("LOCALAPPDATA") or os.path.expanduser("~"))
    else:
        base = Path(os.path.expanduser("~/.cache"))
    return base / "mirdrake" / kind


# --- new files and folders ---------------------------------------------------------------------------------------


class Staging:
    """A hidden folder in which files are made before they appear together beside it; see :func:`staging`.

    Attributes:
        folder: where they are to appear.
        path: where they are made.
    """

    def __init__(self, folder: Path, hidden: Path) -> None:
        self.folder, self._hidden = folder, hidden
        self.path = hidden / "new"
        self.path.mkdir()

    def publish(self, replaced: Iterable[Path] = ()) -> None:
        """Move what was made into its folder, YAML files last.

        What it replaces is removed when all of it is in place; if a move fails, everything is as before. If the process
        is killed meanwhile, the next :func:`staging` in the folder puts back what was replaced.

        Args:
            replaced: other files or folders beside the new ones that go.
        """
        made = sorted(self.path.iterdir(), key=lambda path: (path.suffix == ".yaml", path.name))
        gone = dict.fromkeys([*replaced, *(self.folder / path.name for path in made)])
        old = self._hidden / "old"
        old.mkdir()
        (self._hidden / "names").write_text("\n".join(path.name for path in made), encoding="utf-8")
        try:
            for path in gone:
                if path.is_symlink() or path.exists():
                    path.rename(old / path.name)
            for path in made:
                path.rename(self.folder / path.name)
        except OSError:
            _undo(self._hidden)
            raise
        old.rename(self._hidden / "done")  # from here on nothing is undone


@contextmanager
def staging(folder: Path) -> Iterator[Staging]:
    """Make files in a hidden folder that is removed at the end, whether they were published or not.

    Folders that killed processes left there are removed, too.

    Args:
        folder: where the files are to appear; it is made, and removed if nothing is published.
    """
    missing = [parent for parent in (folder, *folder.parents) if not parent.exists()]
    hidden: Path | None = None
    lock: int | None = None
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for path in folder.glob(f"{_STAGING}*"):
            _remove_abandoned(path)
        while hidden is None or lock is None:  # another process may take it for abandoned before it is locked
            hidden = Path(tempfile.mkdtemp(prefix=_STAGING, dir=folder))
            lock = _lock(hidden)
        yield Staging(folder, hidden)
    finally:
        if hidden is not None:
            shutil.rmtree(hidden, ignore_errors=True)
        if lock is not None and lock >= 0:
            os.close(lock)
        for parent in missing:  # the inner ones first
            with suppress(OSError):  # not empty
                parent.rmdir()


def _lock(hidden: Path) -> int | None:
    """Lock a folder until the process ends; None if it is locked or gone, -1 where folders cannot be locked."""
    try:
        import fcntl
    except ImportError:
        return -1
    try:
        lock = os.open(hidden, os.O_RDONLY)
    except OSError:
        return None
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if hidden.is_dir():
            return lock
    except BlockingIOError:
        pass
    except OSError:  # a file system without locks
        os.close(lock)
        return -1
    os.close(lock)
    return None


def _remove_abandoned(hidden: Path) -> None:
    """Remove the staging folder of a process that was killed, and put back what it was replacing."""
    lock = _lock(hidden)
    if lock is None:
        return
    try:
        if lock >= 0 or time.time() - hidden.stat().st_mtime > _ABANDONED:
            _undo(hidden)
            shutil.rmtree(hidden, ignore_errors=True)
    except OSError:
        pass  # it is hidden anyway
    finally:
        if lock >= 0:
            os.close(lock)


def _undo(hidden: Path) -> None:
    """Remove what was published but not completed, and put back what it replaced."""
    old, names = hidden / "old", hidden / "names"
    if not old.is_dir() or not names.is_file():
        return
    for name in names.read_text(encoding="utf-8").splitlines():
        moved = not (hidden / "new" / name).exists()
        if moved and (hidden.parent / name).exists():
            (hidden.parent / name).rename(hidden / "new" / name)
    for path in sorted(old.iterdir()):
        path.rename(hidden.parent / path.name)


def installed_version(distribution: str) -> str | None:
    """Version of an installed distribution, or None where Python finds its package without one, as in a source tree."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version(distribution)
    except PackageNotFoundError:
        return None
