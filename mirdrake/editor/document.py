"""The text of a world file while it is edited: undo, redo, save, and changes by other programs."""

import json
import os
from contextlib import suppress
from pathlib import Path

from mirdrake.core.digest import digest
from mirdrake.core.errors import ConfigError, RunError
from mirdrake.core.files import write_file
from mirdrake.core.yaml_io import display_path

MOST_STEPS = 500
"""Largest number of texts that undo can restore."""

NEW_WORLD = "mirdrake: world/1\n\nground: {surface: asphalt}\n"
"""Text of a file that does not exist yet."""


class Document:
    """A text with its history and its file; line ends are kept as they are in the file.

    Only one editor has a file at a time: it holds the lock of a hidden file beside it. A second editor only reads.
    A text that is not saved is kept in another hidden file, so that it is not lost when the process ends at any moment;
    the next editor begins with it.

    Args:
        path: the file; if there is none, it begins as an empty world and is written by the first save.

    Attributes:
        text: the present text.
        read_only: why the file cannot be saved; empty if it can.
        restored: whether the text is one that an earlier editor has not saved; undo returns to the file.

    Raises:
        ConfigError: the file cannot be read.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._lock: int | None = None
        self.read_only = self._take_lock()
        self.is_new = not path.exists()
        self._saved = "" if self.is_new else _read(path)
        self.text = NEW_WORLD if self.is_new else self._saved
        self._undo: list[str] = []
        self._redo: list[str] = []
        self.restored = not self.read_only and self._restore()

    @property
    def name(self) -> str:
        """Name of the file in messages."""
        return display_path(self.path)

    @property
    def is_saved(self) -> bool:
        """Whether the file has the present text."""
        return not self.is_new and self.text == self._saved

    @property
    def is_kept(self) -> bool:
        """Whether a text that is not saved is kept for the next editor."""
        return not self.is_saved and bool(self._undo)

    @property
    def can_undo(self) -> bool:
        """Whether there is an earlier text."""
        return bool(self._undo)

    @property
    def can_redo(self) -> bool:
        """Whether a text was undone."""
        return bool(self._redo)

    def change(self, text: str) -> None:
        """Set a new text; the present one can be returned to."""
        if text != self.text:
            # A new change after an undo drops the redone branch, as in every editor.
            self._undo = [*self._undo[-MOST_STEPS + 1 :], self.text]
            self._redo, self.text = [], text
            self._keep()

    def undo(self) -> None:
        """Return to the text before the last change."""
        if self._undo:
            self._redo.append(self.text)
            self.text = self._undo.pop()
            self._keep()

    def redo(self) -> None:
        """Repeat the change that was undone last."""
        if self._redo:
            self._undo.append(self.text)
            self.text = self._redo.pop()
            self._keep()

    def changed_outside(self) -> bool:
        """Return whether another program changed the file since it was read or saved."""
        try:
            return not self.is_new and _read(self.path) != self._saved
        except ConfigError:
            return True

    def reload(self) -> None:
        """Take the text of the file; the present one can be returned to by undo.

        Raises:
            ConfigError: the file cannot be read.
        """
        self._saved = _read(self.path)
        self.is_new = False
        # As a change: undo returns to the text of the editor.
        self.change(self._saved)
        self._keep()

    def save(self, *, overwrite: bool = False) -> None:
        """Write the file, completely or not at all, with the mode that it had.

        Args:
            overwrite: write the file even if another program has changed it.

        Raises:
            RunError: the file is open in another editor, was changed by another program, or cannot be written.
        """
        if self.read_only:
            raise RunError(self.read_only, where=self.name)
        if not overwrite and self.is_new and self.path.exists():
            raise RunError("another program has made this file; reload it or overwrite it", where=self.name)
        if not overwrite and self.changed_outside():
            raise RunError("another program has changed this file; reload it or overwrite it", where=self.name)
        # write_file replaces the file by a new one, which would lose the permissions of the old.
        mode = self.path.stat().st_mode if self.path.exists() else None
        write_file(self.path, self.text.encode())
        if mode is not None:
            with suppress(OSError):
                self.path.chmod(mode & 0o777)
        self._saved, self.is_new = self.text, False
        self._keep()

    def close(self) -> None:
        """Release the file for other editors; a text that is not saved is kept for the next one."""
        if self._lock is not None:
            # Removed while it is locked: another editor could lock it between the two, and lose its file.
            with suppress(OSError):
                self._lock_path.unlink()
            os.close(self._lock)
            self._lock = None

    def _keep(self) -> None:
        """Write the text beside the file until it is saved."""
        # The editor that has the file is the only one that writes here. A full disk must not stop the editing.
        if self._lock is None:
            return
        with suppress(OSError, RunError):
            if not self.is_kept:
                self._kept_path.unlink(missing_ok=True)
            else:
                base = None if self.is_new else self._saved
                write_file(self._kept_path, json.dumps({"base": base, "text": self.text}))

    def _restore(self) -> bool:
        """Take the text that an earlier editor has kept; return whether there is one."""
        try:
            kept = json.loads(self._kept_path.read_text(encoding="utf-8"))
            base, text = kept["base"], kept["text"]
        except (OSError, ValueError, KeyError, TypeError):
            return False
        if not isinstance(text, str) or not isinstance(base, str | None) or text == self.text:
            return False
        # The file that the text was made from: if another program has changed it since, saving asks first.
        if base is not None:
            self._saved = base
        self._undo, self.text = [self.text], text
        return True

    @property
    def file_text(self) -> str:
        """Text of the file when this editor read or saved it last; of a new one, an empty world."""
        return NEW_WORLD if self.is_new else self._saved

    @property
    def _lock_path(self) -> Path:
        return self.path.with_name(f".{self.path.name}.editing")

    @property
    def _kept_path(self) -> Path:
        return self.path.with_name(f".{self.path.name}.unsaved")

    def _take_lock(self) -> str:
        """Lock the file for this process; return why it is read only."""
        try:
            import fcntl
        except ImportError:  # a system without these locks
            return ""
        while True:
            try:
                # A lock file, as the world file itself is replaced at each save and a lock on it would be lost.
                lock = os.open(self._lock_path, os.O_RDWR | os.O_CREAT, 0o600)
            except OSError as error:
                return f"its folder cannot be written: {error.strerror}; save it elsewhere"
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                os.close(lock)
                return "open in another editor; close that one first"
            # An editor that closes between the two calls removes the lock file: then the lock is of a file that no
            # other editor finds, and a second one would get the lock of the next.
            with suppress(OSError):
                if os.path.samestat(os.fstat(lock), os.stat(self._lock_path)):
                    self._lock = lock
                    return ""
            os.close(lock)


def revision_of(text: str) -> str:
    """Return a short identifier of a text."""
    return digest(text.encode())[:16]


def _read(path: Path) -> str:
    try:
        return path.read_bytes().decode("utf-8")
    except UnicodeDecodeError:
        raise ConfigError("not UTF-8; save it as UTF-8", where=display_path(path)) from None
    except OSError as error:
        raise ConfigError(f"cannot be read: {error.strerror}", where=display_path(path)) from None
