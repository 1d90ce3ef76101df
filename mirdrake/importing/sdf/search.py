"""Search for the models that an SDF file includes.

The folders are those given by the user, Gazebo's search paths, the local cache of Fuel, and the folders around the
file. Nothing is downloaded.
"""

import os
from collections.abc import Mapping
from pathlib import Path
from urllib.parse import unquote

from mirdrake.core.wording import plural
from mirdrake.importing.packages import Packages
from mirdrake.importing.sdf.elements import model_file

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
    """The models around an SDF file.

    Args:
        start: the file.
        given: name -> folder, from the user; they take precedence over the search paths of the environment.
    """

    def __init__(self, start: Path, given: Mapping[str, Path] | None = None) -> None:
        super().__init__(start, {**_from_environment(), **(given or {})})
        around = [above / beside for above in list(self._start.parents)[:_LEVELS_UP] for beside in _BESIDE]
        self._tops = [*_search_folders(), *around]

    def find(self, name: str) -> Path | None:
        """Return the folder of a model or package, also of a model without model.config; None if there is none."""
        if name not in self._known and _is_plain(name):
            near = (top / name for top in self._tops if (top / name / "model.sdf").is_file())
            folder = next(near, None)
            if folder is not None:
                self._known[name] = folder
        return super().find(name) if _is_plain(name) else None

    def below(self, rest: str) -> Path | None:
        """Return a file or folder below the search paths, such as ``my_package/models/cone``; None if there is none.

        As in Gazebo, the folders between need no model.config or package.xml.
        """
        parts = [part for part in rest.split("/") if part not in {"", "."}]
        if not parts or ".." in parts or "\0" in rest:
            return None
        return next((top.joinpath(*parts) for top in self._tops if top.joinpath(*parts).exists()), None)

    def fuel(self, address: str) -> Path | None:
        """Return the newest version of an address in the local cache of Fuel; None if it is not there.

        ``https://fuel.gazebosim.org/1.0/OpenRobotics/models/Cone/2/files/meshes/cone.dae`` is
        ``fuel.gazebosim.org/openrobotics/models/cone/2/meshes/cone.dae`` there.
        """
        server, _, rest = unquote(address.strip()).partition("://")[2].partition("/")
        parts = [part for part in rest.split("/") if part]
        if "models" not in parts[:-1] or ".." in parts:
            return None
        index = parts.index("models")
        below = parts[index + 2 :]
        below = below[below.index("files") + 1 :] if "files" in below else []
        names = [server.lower(), *(part.lower() for part in parts[max(0, index - 1) : index + 2])]
        homes = [Path(entry) for name in FUEL_VARIABLES if (entry := os.environ.get(name, ""))]
        for cache in (*homes, *(Path.home() / folder for folder in _FUEL_CACHES)):
            try:
                versions = [folder for folder in cache.joinpath(*names).iterdir() if folder.name.isdecimal()]
            except OSError:
                continue
            # Versions are numbers: 10 is newer than 9.
            for folder in sorted(versions, key=lambda folder: -int(folder.name)):
                if folder.joinpath(*below).exists():
                    return folder.joinpath(*below)
        return None

    def find_model(self, address: str, folder: Path) -> tuple[Path | None, str]:
        """Return the SDF file of an ``<include>``, or None and the reason.

        Args:
            address: its ``<uri>``.
            folder: folder of the file that includes it.
        """
        if not address:
            return None, "it has no <uri>"
        scheme, mark, rest = address.partition("://")
        if mark and scheme not in {"model", "package", "file", "http", "https"}:
            return None, f"{scheme}:// is not supported; model://, package:// and file:// are"
        # A Fuel address may name its model with underscores or spaces; local folders have either.
        if mark and scheme in {"http", "https"}:
            name = model_name(address)
            match = self.fuel(address) or self.find(name) or self.find(name.replace(" ", "_"))
            path = model_file(match) if match and match.is_dir() else None
            why = f"it is not in the local cache of Fuel, and nothing is downloaded; give it with --package {name}=DIR"
            return path, "" if path else why

        # A folder of the package of that name; else what Gazebo finds when it joins its search paths and the address.
        name, _, below = rest.partition("/")
        target = folder / (rest if mark else address)
        if mark and scheme in {"model", "package"}:
            top = self.find(name)
            target = top / below if top is not None else target
            if top is None or not target.exists():
                joined = self.below(rest)
                if joined is None and top is None:
                    return None, f"the model does not exist; {searched()}; give its folder with --package {name}=DIR"
                target = joined or target
        elif not target.exists():
            target = self.below(rest if mark else address) or target
        if target.is_dir():
            path = model_file(target)
            return path, "" if path else "it does not contain model.sdf"
        if not target.is_file():
            return None, "no such file"
        return (target, "") if target.suffix not in {".urdf", ".xacro"} else (None, "it is not an SDF file")

    def resolve(self, address: str, *, folder: Path) -> tuple[Path | None, str]:
        """Return the file of an address as :meth:`Packages.resolve` does; remarks name the searched folders."""
        # An address of the Fuel server is looked up in its cache, then as a model of that name.
        text = unquote(address.strip())
        scheme, mark, rest = text.partition("://")
        if mark and scheme in {"http", "https"}:
            match = self.fuel(address)
            if match is not None and match.is_file():
                return match, ""
            name = model_name(address)
            text = f"model://{name}/meshes/{rest.rpartition('/')[2]}"
        elif not (mark and scheme == "file" and Path(rest).is_file()):
            match = self.below(rest if mark else text) if not (folder / text).is_file() else None
            if match is not None and match.is_file():
                return match, ""
        path, remark = super().resolve(text, folder=folder)
        return path, remark.replace(" is not found; ", f" is not found; {searched()}; ")


def searched() -> str:
    """Return a clause that lists the folders in which models were searched."""
    parts = []
    for variable in VARIABLES:
        folders = [entry for entry in os.environ.get(variable, "").split(os.pathsep) if entry]
        count = plural(len(folders), "folder") if folders else "not set"
        if folders or variable in {"GAZEBO_MODEL_PATH", "GZ_SIM_RESOURCE_PATH"}:
            parts.append(f"{variable} ({count})")
    return f"searched: {', '.join(parts)} and the folders beside and above the file"


def model_name(address: str) -> str:
    """Return the name of the model that an address refers to.

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
    """Return the folders of the environment variables, in Gazebo's order."""
    entries = [entry for variable in VARIABLES for entry in os.environ.get(variable, "").split(os.pathsep)]
    return [Path(entry) for entry in dict.fromkeys(entries) if entry]


def _from_environment() -> dict[str, Path]:
    """Return the models in the folders of the environment variables, the first one of a name."""
    models: dict[str, Path] = {}
    for top in _search_folders():
        try:
            folders = sorted(top.iterdir()) if top.is_dir() else []
        except OSError:
            continue
        for folder in folders:
            if any((folder / mark).is_file() for mark in ("model.config", "model.sdf", "package.xml")):
                models.setdefault(folder.name, folder)
    return models
