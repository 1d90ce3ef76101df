"""Where the models of a world lie: folders that were given, Gazebo's search paths, and the folders around the world."""

import os
from collections.abc import Mapping
from pathlib import Path
from urllib.parse import unquote

from mirdrake.importing.vehicles.packages import Packages

VARIABLES = (
    "GAZEBO_MODEL_PATH",
    "GAZEBO_RESOURCE_PATH",
    "GZ_SIM_RESOURCE_PATH",
    "IGN_GAZEBO_RESOURCE_PATH",
    "SDF_PATH",
)
"""Environment variables in which Gazebo looks for models."""

FUEL_VARIABLES = ("GZ_FUEL_CACHE_PATH", "IGN_FUEL_CACHE_PATH")
"""Environment variables that name the cache of models downloaded from Fuel."""

_FUEL_CACHES = (".gz/fuel", ".ignition/fuel")  # below the home folder
_LEVELS_UP = 4
_BESIDE = ("", "models", "gazebo_models", "gazebo/models")


class Models(Packages):
    """The models around a world file.

    Args:
        start: the world file.
        given: name -> folder, from the user; they win over the search paths of the environment.
    """

    def __init__(self, start: Path, given: Mapping[str, Path] | None = None) -> None:
        super().__init__(start, {**_from_environment(), **(given or {})})
        around = [above / beside for above in list(self._start.parents)[:_LEVELS_UP] for beside in _BESIDE]
        self._tops = [*_search_folders(), *around]

    def find(self, name: str) -> Path | None:
        """The folder of a model or package, also of a model without model.config; None if it is not to be found."""
        if name not in self._known and _is_plain(name):
            near = (top / name for top in self._tops if (top / name / "model.sdf").is_file())
            folder = next(near, None)
            if folder is not None:
                self._known[name] = folder
        return super().find(name) if _is_plain(name) else None

    def below(self, rest: str) -> Path | None:
        """A file or folder below the search paths, as Gazebo joins both: ``my_package/models/cone``; None if none is.

        Gazebo asks for no model.config or package.xml in the folders between.
        """
        parts = [part for part in rest.split("/") if part not in {"", "."}]
        if not parts or ".." in parts or "\0" in rest:
            return None
        return next((top.joinpath(*parts) for top in self._tops if top.joinpath(*parts).exists()), None)

    def fuel(self, address: str) -> Path | None:
        """What the local cache of Fuel has of an address, in its newest version; None if it has nothing.

        ``https://fuel.gazebosim.org/1.0/OpenRobotics/models/Cone/2/files/meshes/cone.dae`` is
        ``fuel.gazebosim.org/openrobotics/models/cone/2/meshes/cone.dae`` there.
        """
        server, _, rest = unquote(address.strip()).partition("://")[2].partition("/")
        parts = [part for part in rest.split("/") if part]
        if "models" not in parts[:-1] or ".." in parts:
            return None
        at = parts.index("models")
        below = parts[at + 2 :]
        below = below[below.index("files") + 1 :] if "files" in below else []
        names = [server.lower(), *(part.lower() for part in parts[max(0, at - 1) : at + 2])]
        homes = [Path(entry) for name in FUEL_VARIABLES if (entry := os.environ.get(name, ""))]
        for cache in (*homes, *(Path.home() / folder for folder in _FUEL_CACHES)):
            try:
                versions = [folder for folder in cache.joinpath(*names).iterdir() if folder.name.isdecimal()]
            except OSError:
                continue
            for folder in sorted(versions, key=lambda folder: -int(folder.name)):
                if folder.joinpath(*below).exists():
                    return folder.joinpath(*below)
        return None

    def resolve(self, address: str, *, folder: Path) -> tuple[Path | None, str]:
        """See :meth:`Packages.resolve`; a missing file is reported with the folders that were searched."""
        text = unquote(address.strip())
        scheme, mark, rest = text.partition("://")
        if mark and scheme in {"http", "https"}:
            found = self.fuel(address)
            if found is not None and found.is_file():
                return found, ""
            name = model_name(address)
            text = f"model://{name}/meshes/{rest.rpartition('/')[2]}"
        elif not (mark and scheme == "file" and Path(rest).is_file()):
            found = self.below(rest if mark else text) if not (folder / text).is_file() else None
            if found is not None and found.is_file():
                return found, ""
        path, remark = super().resolve(text, folder=folder)
        return path, remark.replace(" is not here; ", f" is not here; {searched()}; ")


def searched() -> str:
    """Where models were looked for, in words."""
    parts = []
    for variable in VARIABLES:
        folders = [entry for entry in os.environ.get(variable, "").split(os.pathsep) if entry]
        count = f"{len(folders)} folder{'s' if len(folders) != 1 else ''}" if folders else "not set"
        if folders or variable in {"GAZEBO_MODEL_PATH", "GZ_SIM_RESOURCE_PATH"}:
            parts.append(f"{variable} ({count})")
    return f"searched were {', '.join(parts)} and the folders beside and above the file"


def model_name(address: str) -> str:
    """The name of the model that an address means.

    ``cone`` of ``model://cone/meshes/cone.dae`` and of ``model://my_package/models/cone``.
    """
    text = unquote(address.strip())
    if "://" in text:
        scheme, _, rest = text.partition("://")
        parts = [part for part in rest.split("/") if part]
        if scheme in {"http", "https"} and "models" in parts[:-1]:
            return parts[parts.index("models") + 1]
        return _of_path(parts)
    return _of_path([part for part in text.split("/") if part not in {"", ".", ".."}])


def _of_path(parts: list[str]) -> str:
    if parts and "." in parts[-1]:
        parts = parts[:-1]
    parts = [part for part in parts if part not in {"meshes", "materials", "models"}]
    return parts[-1] if parts else ""


def _is_plain(name: str) -> bool:
    return bool(name) and name not in {".", ".."} and "/" not in name and "\0" not in name


def _search_folders() -> list[Path]:
    """The folders that the environment names, in Gazebo's order."""
    entries = [entry for variable in VARIABLES for entry in os.environ.get(variable, "").split(os.pathsep)]
    return [Path(entry) for entry in dict.fromkeys(entries) if entry]


def _from_environment() -> dict[str, Path]:
    """Models in the folders that the environment names, the first one of a name."""
    found: dict[str, Path] = {}
    for top in _search_folders():
        try:
            folders = sorted(top.iterdir()) if top.is_dir() else []
        except OSError:
            continue
        for folder in folders:
            if any((folder / mark).is_file() for mark in ("model.config", "model.sdf", "package.xml")):
                found.setdefault(folder.name, folder)
    return found
