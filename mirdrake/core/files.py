"""Files and folders that are written completely or not at all, and file system errors as one-line errors.

A file is written under a temporary name beside it and renamed (:func:`write_file`, :func:`replacing`). Several files
and folders are made in a hidden folder (:func:`staging`) and appear together when all of them are complete.
"""

import os
import shutil
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import yaml

from mirdrake.core.errors import ConfigError, MirdrakeError, RunError, first_line

_STAGING = ".mirdrake-"
_ABANDONED = 86_400.0  # [s], age of an unused staging folder, for file systems without locks


def write_file(path: Path, content: str | bytes) -> None:
    """Write a file completely or not at all.

    Raises:
        RunError: the file cannot be written.
    """
    with replacing(path) as temporary:
        temporary.write_bytes(content.encode() if isinstance(content, str) else content)


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a temporary path whose file replaces `path` at the end; after an error it is removed instead.

    Raises:
        RunError: the file cannot be written.
    """
    # In the same folder, as a rename is atomic only within one file system; the process number keeps writers apart.
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        with write_errors(path):
            yield temporary
            # os.replace overwrites an existing file in one step, so a reader sees the old content or the new one.
            os.replace(temporary, path)
    except BaseException:
        with suppress(OSError):  # its folder may not exist
            temporary.unlink(missing_ok=True)
        raise


@contextmanager
def write_errors(path: Path) -> Iterator[None]:
    """Raise errors of the file system as a RunError of one line that names the path."""
    try:
        yield
    except OSError as error:
        reason = error.strerror or first_line(error)
        raise RunError(f"cannot be written: {reason}; choose another folder", where=str(path)) from None


@contextmanager
def read_errors(path: Path) -> Iterator[None]:
    """Raise the errors that a damaged file causes as a ConfigError of one line that names the path."""
    try:
        yield
    except MirdrakeError:
        raise
    except Exception as error:
        # PyArrow takes long to import; where it is not loaded, it cannot have raised.
        arrow = sys.modules.get("pyarrow")
        if not isinstance(error, (*_DAMAGE, *((arrow.ArrowException,) if arrow is not None else ()))):
            raise
        reason = getattr(error, "strerror", None) or first_line(error)
        raise ConfigError(f"damaged, cannot be read: {reason[:160]}", where=str(path)) from error


_DAMAGE = (
    OSError, ValueError, TypeError, LookupError, AttributeError, ArithmeticError, SyntaxError, RecursionError,
    yaml.YAMLError,
)  # fmt: skip


# --- several files and folders ------------------------------------------------------------------------------------


class Staging:
    """A hidden folder in which files are made before they appear together beside it; see :func:`staging`.

    Attributes:
        folder: folder of the published files.
        path: temporary folder of the files.
    """

    def __init__(self, folder: Path, hidden: Path) -> None:
        self.folder, self._hidden = folder, hidden
        self.path = hidden / "new"
        self.path.mkdir()

    def publish(self, replaced: Iterable[Path] = (), *, merge: bool = False) -> None:
        """Move the new files into their folder, YAML files last.

        Replaced files are removed when all new ones are in place; if a move fails, the old files are restored. If the
        process is killed meanwhile, the next :func:`staging` in the folder restores them.

        Args:
            replaced: other files or folders directly in the folder that are removed.
            merge: replace single files in folders that exist, instead of these folders.
        """
        paths = [path for path in self.path.rglob("*") if not path.is_dir()] if merge else list(self.path.iterdir())
        # A YAML file names the other files; it comes last, so that a reader never finds a name without its file.
        made = [path.relative_to(self.path) for path in sorted(paths, key=lambda path: (path.suffix == ".yaml", path))]
        removed = dict.fromkeys([*(Path(path.name) for path in replaced), *made])

        # The two lists are what a later process needs to undo a publication that was killed.
        old, made_folders = self._hidden / "old", list[Path]()
        (self._hidden / "names").write_text("\n".join(map(str, made)), encoding="utf-8")
        (self._hidden / "replaced").write_text("\n".join(map(str, removed)), encoding="utf-8")
        # Its existence means that the publication is incomplete; see `_undo`.
        old.mkdir()
        try:
            # Old files are moved, not deleted: a failure in the middle can put them back.
            for name in removed:
                target = self.folder / name
                if target.is_symlink() or target.exists():
                    (old / name).parent.mkdir(parents=True, exist_ok=True)
                    target.rename(old / name)
            for name in made:
                parent = (self.folder / name).parent
                made_folders += [above for above in (parent, *parent.parents) if not above.exists()]
                parent.mkdir(parents=True, exist_ok=True)
                (self.path / name).rename(self.folder / name)
        except OSError:
            _undo(self._hidden)
            for folder in made_folders:
                with suppress(OSError):  # not empty
                    folder.rmdir()
            raise
        # Renaming is the commit: one atomic step separates "undo" from "done".
        old.rename(self._hidden / "done")  # from here on nothing is undone


@contextmanager
def staging(folder: Path) -> Iterator[Staging]:
    """Make files in a hidden folder that is removed at the end, whether they were published or not.

    Folders that killed processes left there are removed, too.

    Args:
        folder: folder of the published files; it is created, and removed if nothing is published.
    """
    # Folders that do not exist yet, so that only these are removed if nothing is published.
    missing = [parent for parent in (folder, *folder.parents) if not parent.exists()]
    hidden: Path | None = None
    lock: int | None = None
    try:
        folder.mkdir(parents=True, exist_ok=True)
        # A process that was killed cannot clean up; the next one in the same folder does.
        for path in folder.glob(f"{_STAGING}*"):
            _remove_abandoned(path)
        while hidden is None or lock is None:  # another process may remove the new folder before it is locked
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
    """Lock a folder until the process ends.

    Returns:
        the file descriptor that holds the lock; None if another process holds it or the folder is gone; -1 where
        folders cannot be locked.
    """
    # Windows has no fcntl; without a lock, the age of a folder decides whether it was abandoned.
    try:
        import fcntl
    except ImportError:
        return -1
    try:
        lock = os.open(hidden, os.O_RDONLY)
    except OSError:
        return None
    try:
        # The folder may have been removed between opening and locking it.
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
    # A live process holds the lock of its folder, so only folders of dead ones can be locked.
    lock = _lock(hidden)
    if lock is None:
        return
    try:
        if lock >= 0 or time.time() - hidden.stat().st_mtime > _ABANDONED:
            _undo(hidden)
            shutil.rmtree(hidden, ignore_errors=True)
    except OSError:
        pass  # a hidden folder that remains has no effect
    finally:
        if lock >= 0:
            os.close(lock)


def _undo(hidden: Path) -> None:
    """Withdraw an incomplete publication, and put back what it replaced."""
    old, names, replaced = hidden / "old", hidden / "names", hidden / "replaced"
    if not old.is_dir():
        return
    for name in names.read_text(encoding="utf-8").splitlines():
        # Only files that left `new` were published; withdrawing others would take files of somebody else.
        moved = not (hidden / "new" / name).exists()
        if moved and (hidden.parent / name).exists():
            (hidden.parent / name).rename(hidden / "new" / name)
    for name in replaced.read_text(encoding="utf-8").splitlines():
        if (old / name).is_symlink() or (old / name).exists():
            (old / name).rename(hidden.parent / name)
