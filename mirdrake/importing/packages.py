"""Search for the packages and models that a file refers to, without ROS.

A package is a folder with a package.xml, a model a folder with a model.config. Both are found by the name in that file
and by the name of the folder, in the folders above the file and a few levels below each. The number of folders is
limited.
"""

import os
import re
import tarfile
import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from urllib.parse import unquote

from mirdrake.core.paths import resolved

LEVELS_UP, LEVELS_DOWN, MOST_FOLDERS = 6, 3, 4000
_SKIPPED = {"build", "devel", "install", "log", "node_modules", "venv", "site-packages", "proc", "sys", "dev"}
_NAME = re.compile(r"<name>\s*([^<]+?)\s*</name>")
_SUFFIX = re.compile("_(description|base|model|urdf|robot|gazebo|sim|simulation)s?$")
_ARCHIVES = (".tar.gz", ".tgz", ".tar.xz", ".tar.bz2", ".tar", ".zip")
_POINTER = b"version https://git-lfs"


class Packages:
    """The packages around a file.

    Args:
        start: the file.
        given: package name -> folder, from the user; they take precedence.
    """

    def __init__(self, start: Path, given: Mapping[str, Path] | None = None) -> None:
        self._start = resolved(start)
        self._known: dict[str, Path] = {name: resolved(Path(folder)) for name, folder in (given or {}).items()}
        self._seen: set[Path] = set()
        self._levels = self._folders_above()
        self.used: dict[str, Path] = {}

    def find(self, name: str) -> Path | None:
        """Return the folder of a package or model; None if it is not found."""
        while name not in self._known:
            above = next(self._levels, None)
            if above is None:
                return None
            self._look_below(above)
        self.used[name] = self._known[name]
        return self._known[name]

    def own(self) -> tuple[str, Path]:
        """Return name and folder of the package of the file; the folder of the file if it has none."""
        for folder in list(self._start.parents)[:LEVELS_UP]:
            names = _names_of(folder)
            if names:
                self.used[names[0]] = folder
                return names[0], folder
        return self._start.parent.name, self._start.parent

    def beside(self) -> list[Path]:
        """Return sibling packages with the same prefix: ``car_control`` for ``car_description``."""
        name, folder = self.own()
        start = _SUFFIX.sub("", name)
        folders = []
        for other in _folders_in(folder.parent) if _names_of(folder) else ():
            names = _names_of(other)
            if other != folder and names and (names[0] == start or names[0].startswith(f"{start}_")):
                folders.append(other)
        return folders

    def resolve(self, address: str, *, folder: Path) -> tuple[Path | None, str]:
        """Return the file of an address, and a remark if it is missing or not at its address.

        Args:
            address: package://, model://, file:// or a path.
            folder: folder to which paths are relative.

        Returns:
            the file or None, and a remark on it or "".
        """
        text = unquote(address.strip())
        # Addresses of packages and models are relative to their folder, all others to that of the file.
        root = folder
        if "://" in text:
            scheme, _, rest = text.partition("://")
            if scheme not in {"package", "model", "file"}:
                return None, f"{scheme}:// is not supported; only package://, model:// and file:// are"
            if scheme == "file":
                path = Path(rest)
            else:
                name, _, inner = rest.partition("/")
                # Fuel and Gazebo call a package a model; the message uses the word of the address.
                folder_of = self.find(name)
                if folder_of is None:
                    kind = "package" if scheme == "package" else "model"
                    return None, f"{kind} '{name}' is not found; give its folder with --package {name}=DIR"
                root, path = folder_of, folder_of / inner
        else:
            path = Path(text)
            path = path if path.is_absolute() else folder / path
        path = Path(os.path.normpath(path))
        # A file under Git LFS that was not downloaded exists, but is a text of three lines.
        if path.is_file():
            return (None, _POINTER_TEXT) if _is_pointer(path) else (path, "")
        return self._nearly(path, root)

    def _nearly(self, path: Path, root: Path) -> tuple[Path | None, str]:
        """Return the file that is probably meant, or the reason why there is none."""
        # The usual reasons for a missing file: other case, another folder, an archive, or Git LFS.
        other = _any_case(path)
        if other is not None:
            return (None, _POINTER_TEXT) if _is_pointer(other) else (other, "found with different upper and lower case")
        # Only a unique file of that name is used; among several the right one is not known.
        same = [candidate for candidate in _files(root) if candidate.name.lower() == path.name.lower()]
        if len(same) == 1:
            return same[0], f"not at its address; used is the file of that name in {same[0].parent.name}/"
        for archive in _files(root):
            if archive.name.lower().endswith(_ARCHIVES) and _holds(archive, path.name):
                return None, f"packed in {archive.name}; unpack it and import again"
        return None, "no such file"

    # --- the search ---

    def _folders_above(self) -> Iterator[Path]:
        """Yield the folders to search, nearest first; never the root of the disk."""
        for folder in list(self._start.parents)[:LEVELS_UP]:
            if folder.parent == folder:
                return
            yield folder

    def _look_below(self, top: Path) -> None:
        level = [top]
        for _ in range(LEVELS_DOWN + 1):
            following: list[Path] = []
            for folder in level:
                if folder in self._seen or len(self._seen) > MOST_FOLDERS:
                    continue
                self._seen.add(folder)
                for name in _names_of(folder):
                    self._known.setdefault(name, folder)
                following += _folders_in(folder)
            level = following


_POINTER_TEXT = "only a Git LFS pointer; fetch the file with git lfs pull and import again"


def _names_of(folder: Path) -> list[str]:
    """Return the names of a package or model folder, that of its file first; none if it is neither."""
    for file in ("package.xml", "model.config"):
        path = folder / file
        try:
            if path.is_file():
                match = _NAME.search(path.read_text(encoding="utf-8", errors="replace"))
                inside = [match.group(1)] if match and file == "package.xml" else []
                return list(dict.fromkeys([*inside, folder.name]))
        except OSError:
            continue
    return []


def _folders_in(folder: Path) -> list[Path]:
    try:
        return sorted(
            entry
            for entry in folder.iterdir()
            if not entry.name.startswith(".") and entry.name not in _SKIPPED and entry.is_dir()
        )
    except OSError:
        return []


def _files(root: Path) -> Iterator[Path]:
    """Yield files below a package folder, from at most 4000 folders."""
    waiting, count = [root], 0
    while waiting and count < MOST_FOLDERS:
        folder = waiting.pop()
        count += 1
        try:
            yield from sorted(entry for entry in folder.iterdir() if entry.is_file())
        except OSError:
            continue
        waiting += _folders_in(folder)


def _any_case(path: Path) -> Path | None:
    """Return the file whose path differs in upper and lower case only."""
    known = path
    while not known.exists() and known.parent != known:
        known = known.parent
    for part in path.parts[len(known.parts) :]:
        try:
            same = [entry for entry in sorted(known.iterdir()) if entry.name.lower() == part.lower()]
        except OSError:
            return None
        if not same:
            return None
        known = same[0]
    return known if known.is_file() and known != path else None


def _is_pointer(path: Path) -> bool:
    try:
        with path.open("rb") as file:
            return file.read(len(_POINTER)) == _POINTER
    except OSError:
        return False


def _holds(archive: Path, name: str) -> bool:
    """Return whether an archive contains a file of a name."""
    try:
        if archive.suffix == ".zip":
            with zipfile.ZipFile(archive) as packed:
                names = packed.namelist()
        else:
            with tarfile.open(archive) as packed:
                names = packed.getnames()
    except (OSError, tarfile.TarError, zipfile.BadZipFile, EOFError):
        return False
    return any(Path(entry).name == name for entry in names)
