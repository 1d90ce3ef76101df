"""Places in source files relative to their package, as reports name them."""

import os
import re
from pathlib import Path

from mirdrake.core.yaml_io import display_path
from mirdrake.importing.changes import Change

_MARKS = ("package.xml", "model.config")
_LEVELS = 6
_LINE = re.compile(r"(.*?)((?::\d[\d-]*)?)$", re.DOTALL)


class Places:
    """Short names for the files of a model.

    Args:
        main: the main file.
    """

    def __init__(self, main: Path) -> None:
        self._root = _package(main)
        self._above = str(self._root.parent) + os.sep

    def short(self, place: str) -> str:
        """Return ``file`` or ``file:line`` relative to the package."""
        match = _LINE.match(place)
        assert match is not None, "it matches everything"
        file, line = match.groups()
        return f"{self.file(Path(file))}{line}" if file and os.path.exists(file) else self.text(place)

    def file(self, path: Path) -> str:
        """Return a file relative to the main package, else to its own package."""
        full = Path(os.path.abspath(path))
        for root in (self._root, _package(full)):
            if full.is_relative_to(root):
                start = root.parent if _is_package(root) else root
                return full.relative_to(start).as_posix()
        return full.name

    def text(self, text: str) -> str:
        """Return a text without the folders above the package."""
        start = self._above if _is_package(self._root) else str(self._root) + os.sep
        for prefix in (start, display_path(Path(start)) + os.sep):
            # A prefix such as "./" would match in the middle of other paths.
            if len(prefix) > 2:
                text = text.replace(prefix, "")
        return text

    def change(self, change: Change) -> Change:
        """Return a change without absolute folders in its texts."""
        return Change(
            change.code,
            self.short(change.place),
            self.text(change.part),
            self.text(change.old),
            None if change.new is None else self.text(change.new),
            self.text(change.reason),
        )


def _is_package(folder: Path) -> bool:
    return any((folder / mark).is_file() for mark in _MARKS)


def _package(file: Path) -> Path:
    """Return the package folder of a file, else the folder of the file."""
    folder = Path(os.path.abspath(file)).parent
    return next((above for above in (folder, *list(folder.parents)[:_LEVELS]) if _is_package(above)), folder)


def without_folder(message: str, folder: Path) -> str:
    """Return a message without the folder in which an import makes its files; it is gone when the message is read."""
    return message.replace(f"{display_path(folder)}{os.sep}", "").replace(f"{folder}{os.sep}", "")
