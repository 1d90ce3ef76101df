"""Search paths of models, worlds, diagrams and studies.

A name is looked up in this order:

1. as a path (absolute, or relative to the working directory),
2. as ``<folder>/{models,worlds,diagrams,studies}/<name>`` in each folder of the environment variable ``MIRDRAKE_PATH``,
3. the same below the working directory,
4. in the data shipped with mirdrake.

Hidden files and folders are ignored; new vehicles and worlds are made in them (:func:`mirdrake.core.files.staging`).
"""

import os
import sys
from pathlib import Path

from mirdrake.core.errors import ConfigError, closest, did_you_mean

_PACKAGE = Path(__file__).resolve().parents[1]


def data_root() -> Path:
    """Return the folder of models/, worlds/, diagrams/ and studies/: share/ if installed, otherwise the checkout."""
    share = _PACKAGE / "share"
    return share if share.is_dir() else _PACKAGE.parent


def resolved(path: Path) -> Path:
    """Return an absolute path without links; a loop of links raises an error only when the file is opened."""
    return Path(os.path.realpath(path))


def search_folders(kind: str) -> list[Path]:
    """Return the existing folders in which names of one kind are looked up, in order of priority.

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
    """Return all names of one kind with their files (for models: their folders), sorted by name.

    Args:
        kind: "models", "worlds", "diagrams" or "studies".
    """
    paths: dict[str, Path] = {}
    for folder in search_folders(kind):
        if kind == "models":
            entries = {path.parent.name: path.parent for path in folder.glob("*/vehicle.yaml")}
        else:
            entries = {path.stem: path for path in folder.glob("*.yaml")}
        for name, path in entries.items():
            if not is_hidden(name):
                paths.setdefault(name, path)
    return dict(sorted(paths.items()))


def is_hidden(name: str) -> bool:
    """Return whether a file or folder of that name is hidden and never listed."""
    return name.startswith(".")


def find(kind: str, name: str, *, where: str = "") -> Path:
    """Return the file (for models: the folder) of a name.

    Args:
        kind: "models", "worlds", "diagrams" or "studies".
        name: a bare name or a path.
        where: prefix of the error message, for example ``"drive.yaml:3: world"``.

    Raises:
        ConfigError: the name is unknown.
    """
    noun = {"models": "vehicle", "worlds": "world", "diagrams": "diagram", "studies": "study"}[kind]
    as_path = Path(os.path.expanduser(name))  # keeps "~nobody", for which Path.expanduser raises an error
    is_yaml = as_path.suffix in {".yaml", ".yml"}
    # An existing file or folder comes before a name of the library.
    if _is_file(as_path / "vehicle.yaml") if kind == "models" else is_yaml and _is_file(as_path):
        return resolved(as_path)
    known = names(kind)
    if name in known:
        return known[name]
    if os.sep in name or is_yaml:
        wanted = "a folder with a vehicle.yaml" if kind == "models" else "a .yaml file"
        if _exists(as_path):
            raise ConfigError(f"no {noun} at '{name}'; expected: {wanted}", where=where)
        raise ConfigError(f"no {noun} at '{name}': {missing_file(as_path, kind)}", where=where)
    raise ConfigError(f"unknown {noun} '{name}'; {did_you_mean(name, known)}", where=where)


def _exists(path: Path) -> bool:
    """Return whether a path exists; False for a name that a file cannot have."""
    try:
        return path.exists()
    except OSError:
        return False


def missing_file(path: Path, kind: str = "") -> str:
    """Return the reason why a path leads to nothing, with the most similar file or vehicle of its folder.

    Args:
        path: it does not exist.
        kind: "models" for vehicles only, another kind for .yaml files only; "" for both.
    """
    folder = path.parent
    if not folder.is_dir():
        return f"no such folder '{folder}'"
    files = [] if kind == "models" else [*folder.glob("*.yaml"), *folder.glob("*.yml")]
    vehicles = [file.parent for file in folder.glob("*/vehicle.yaml")] if kind in {"", "models"} else []
    near = closest(path.name, [entry.name for entry in (*files, *vehicles) if not is_hidden(entry.name)])
    what = "no such folder" if kind == "models" else "no such file" if path.suffix else "no such file or folder"
    return f"{what}; did you mean '{folder / near}'?" if near else what


def _is_file(path: Path) -> bool:
    """Return whether a file exists; False for a name that a file cannot have."""
    try:
        return path.is_file()
    except OSError:  # the name is too long, or the folder is not accessible
        return False


def cache_folder(kind: str) -> Path:
    """Return the cache folder ``mirdrake/<kind>`` of the user (XDG_CACHE_HOME); it may not exist.

    Args:
        kind: kind of the content, for example "convex".
    """
    given = os.environ.get("XDG_CACHE_HOME", "")
    if os.path.isabs(given):  # the XDG specification ignores relative paths
        base = Path(given)
    elif sys.platform == "darwin":
        base = Path(os.path.expanduser("~/Library/Caches"))
    elif sys.platform == "win32":
        base = Path(os.environ.get("LOCALAPPDATA") or os.path.expanduser("~"))
    else:
        base = Path(os.path.expanduser("~/.cache"))
    return base / "mirdrake" / kind


def installed_version(distribution: str) -> str | None:
    """Return the version of an installed distribution; None if only its sources are on the import path."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version(distribution)
    except PackageNotFoundError:
        return None
