"""The files that determine the results of a diagram: those of its world, its vehicles and its user modules."""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from mirdrake.core.digest import digest
from mirdrake.core.files import read_errors
from mirdrake.worlds import World
from mirdrake.worlds.lock import used_files

_USER_CODE = re.compile(r"([A-Za-z_][\w.]*):[A-Za-z_]\w*")  # module:name


def input_digest(world: World, vehicles: Iterable[Path], controllers: Any, folder: Path) -> str:
    """Return the SHA-256 of the input files; it changes with the content of any of them.

    Args:
        world: the world.
        vehicles: vehicle folders.
        controllers: plain data that may name user code as ``module:name``.
        folder: folder of these modules; those that are elsewhere are not regarded.

    Raises:
        ConfigError: a file cannot be read.
    """
    files = dict(used_files(world))
    if world.path is not None:
        beside = world.path.parent
        grids = [layer.grid.file for layer in world.spec.ground.relief if layer.grid is not None]
        files |= {name: beside / name for name in (world.path.name, *world.spec.include, *grids)}
    for vehicle in sorted(set(vehicles)):
        # All files of a vehicle: which of them a variant or an argument of its xacro uses is not known here.
        inner = [path for path in vehicle.rglob("*") if path.is_file()]
        files |= {
            f"{vehicle.name}/{path.relative_to(vehicle)}": path
            for path in inner
            if not any(part.startswith((".", "__")) for part in path.relative_to(vehicle).parts)
        }
    for module in _user_modules(controllers):
        path = folder.joinpath(*module.split(".")).with_suffix(".py")
        if path.is_file():
            files[module] = path
    contents: list[str | bytes] = []
    for name in sorted(files):
        with read_errors(files[name]):
            # The size separates the contents: two files are not the same as one with the text of both.
            content = files[name].read_bytes()
        contents += [f"{name} {len(content)}\n", content]
    return digest(*contents)


def _user_modules(data: Any) -> Iterator[str]:
    """Yield the modules that texts in plain data name."""
    if isinstance(data, str):
        if match := _USER_CODE.fullmatch(data):
            yield match[1]
    elif isinstance(data, Mapping | Sequence):
        for item in data.values() if isinstance(data, Mapping) else data:
            yield from _user_modules(item)
