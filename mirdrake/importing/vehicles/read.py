"""Description files of any format into a :class:`SourceModel`."""

import os
from collections.abc import Mapping
from pathlib import Path

from mirdrake.core.errors import ModelError
from mirdrake.core.yaml_io import display_path
from mirdrake.importing.gazebo_xml import read_gazebo_xml
from mirdrake.importing.packages import Packages
from mirdrake.importing.sdf.elements import model_file
from mirdrake.importing.sdf.search import Models
from mirdrake.importing.vehicles.model import SourceModel
from mirdrake.importing.vehicles.read_sdf import read_sdf
from mirdrake.importing.vehicles.read_urdf import read_urdf
from mirdrake.importing.vehicles.ros_control import read_controllers

_LICENCES = ("LICENSE", "LICENCE", "LICENSE.txt", "LICENSE.md", "COPYING")


def read_source(
    path: Path, *, packages: Mapping[str, Path] | None = None, arguments: Mapping[str, str] | None = None
) -> SourceModel:
    """Return the contents of a URDF, xacro or SDF file with its package.

    Args:
        path: the file, or the folder of a package or model with one description.
        packages: package name -> folder; others are looked for around the file.
        arguments: values of xacro arguments; relative paths are relative to the working directory.

    Raises:
        MissingArgumentsError: xacro arguments need values.
        ModelError: the file does not exist, or is not a valid description of a vehicle.
    """
    # Relative paths in arguments are those of the user, not of the file.
    path = _main_file(Path(path))
    arguments = {name: _absolute(value) for name, value in (arguments or {}).items()}
    around = Models(path, packages) if _is_sdf(path) else Packages(path, packages)
    name, folder = around.own()
    if isinstance(around, Models):
        if arguments:
            raise ModelError(
                f"an SDF file has no arguments, but {', '.join(arguments)} given", where=display_path(path)
            )
        model = read_sdf(path, models=around)
    else:
        model = read_urdf(path, packages=around, arguments=arguments)
    if not model.links:
        raise ModelError("no links in the model", where=f"{display_path(path)}:1")
    read_controllers(dict.fromkeys([folder, *around.used.values()]), model)
    # Packages beside this one may belong to other robots: only controllers of its joints count.
    read_controllers(around.beside(), model, only=set(model.joints))
    model.texts = _texts(folder)
    model.texts.setdefault("package", name)
    return model


def _absolute(value: str) -> str:
    """Return the value of an argument; relative paths of existing files become absolute."""
    path = Path(value)
    if path.is_absolute() or not value or (os.sep not in value and not path.suffix and value not in (".", "..")):
        return value
    try:
        exists = path.exists()
    except (OSError, ValueError):
        return value
    return str(path.absolute()) if exists else value


def _main_file(path: Path) -> Path:
    """Return the description file: the file itself, or the only one in a folder."""
    if path.is_file():
        if path.name == "model.config":
            return _main_file(path.parent)
        if path.name.endswith(".world"):
            raise ModelError("a world, not a vehicle; give the file of a model", where=display_path(path))
        return path
    if not path.is_dir():
        raise ModelError("no such file", where=display_path(path))
    # A Gazebo folder states its file in model.config, so nothing has to be guessed.
    sdf = model_file(path)
    if sdf is not None:
        return sdf
    candidates = [
        file
        for below in ("", "urdf", "xacro", "robots", "description")
        for file in sorted((path / below).glob("*"))
        if file.suffix in {".urdf", ".xacro", ".sdf"} and file.is_file()
    ]
    # Packages split a car over many xacro files; the complete one is a <robot> with a name.
    whole = [file for file in dict.fromkeys(candidates) if _is_whole(file)]
    if len(whole) != 1:
        names = ", ".join(display_path(file) for file in whole[:8]) or "none"
        raise ModelError(
            f"give the file that describes the vehicle; there are {len(whole)}: {names}", where=display_path(path)
        )
    return whole[0]


def _is_whole(path: Path) -> bool:
    """Return whether a file describes a complete model, which has a name, and not a part of one."""
    try:
        root = read_gazebo_xml(path).root
    except ModelError:
        return False
    return root.tag == "sdf" or (root.tag == "robot" and bool(root.get("name")))


def _is_sdf(path: Path) -> bool:
    """Return whether the root element of a file is <sdf>."""
    if path.suffix == ".xacro" or path.name.endswith(".xacro"):
        return False
    if path.suffix == ".sdf":
        return True
    root = read_gazebo_xml(path).root
    return root.tag == "sdf"


def _texts(folder: Path) -> dict[str, str]:
    """Return the licence and author that the package states."""
    texts: dict[str, str] = {}
    for name in ("package.xml", "model.config"):
        path = folder / name
        if path.is_file():
            try:
                root = read_gazebo_xml(path).root
            except ModelError:
                continue
            licences = [(entry.text or "").strip() for entry in root.iter("license")]
            authors = [" ".join(" ".join(entry.itertext()).split()) for entry in root.iter("author")]
            authors = authors or [(entry.text or "").strip() for entry in root.iter("maintainer")]
            if any(licences):
                texts["licence"] = ", ".join(filter(None, licences))
            if any(authors):
                texts["author"] = ", ".join(filter(None, authors))
    # The text of a licence file begins with its name.
    for name in _LICENCES:
        path = folder / name
        if path.is_file():
            words = path.read_text(encoding="utf-8", errors="replace").strip().splitlines()
            texts["licence file"] = words[0][:120] if words else name
            break
    return texts
