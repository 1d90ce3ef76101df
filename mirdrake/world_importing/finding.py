"""Where the models of a world lie: folders that were given, Gazebo's search paths, and the folders around the world."""

import os
from collections.abc import Mapping
from pathlib import Path
from urllib.parse import unquote

from mirdrake.vehicles.importing.packages import Packages

VARIABLES = (
    "GAZEBO_MODEL_PATH",
    "GAZEBO_RESOURCE_PATH",
    "GZ_SIM_RESOURCE_PATH",
    "IGN_GAZEBO_RESOURCE_PATH",
    "SDF_PATH",
)
"""Environment variables in which Gazebo looks for models."""

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

    def find(self, name: str) -> Path | None:
        """The folder of a model or package, also of a model without model.config; None if it is not to be found."""
        for above in list(self._start.parents)[:_LEVELS_UP] if name not in self._known else ():
            for beside in _BESIDE:
                folder = above / beside / name
                if _is_plain(name) and (folder / "model.sdf").is_file():
                    self._known[name] = folder
                    break
            if name in self._known:
                break
        return super().find(name) if _is_plain(name) else None

    def resolve(self, address: str, *, folder: Path) -> tuple[Path | None, str]:
        """See :meth:`Packages.resolve`; what is missing is told with what was searched."""
        path, remark = super().resolve(address, folder=folder)
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


def _from_environment() -> dict[str, Path]:
    """Models in the folders that the environment names, the first one of a name."""
    found: dict[str, Path] = {}
    for variable in VARIABLES:
        for entry in os.environ.get(variable, "").split(os.pathsep):
            top = Path(entry) if entry else None
            try:
                folders = sorted(top.iterdir()) if top is not None and top.is_dir() else []
            except OSError:
                continue
            for folder in folders:
                if any((folder / mark).is_file() for mark in ("model.config", "model.sdf", "package.xml")):
                    found.setdefault(folder.name, folder)
    return found
