"""Place of the files of an imported world, and its name."""

import re
from collections.abc import Collection
from pathlib import Path

from mirdrake.core.errors import ConfigError, ModelError, WorldError, first_line
from mirdrake.core.yaml_io import display_path
from mirdrake.importing.places import without_folder
from mirdrake.worlds import World, load_world


def check_target(target: Path, name: str, *, force: bool, made: Collection[str]) -> list[Path]:
    """Return the files that a new world of this name would replace.

    Args:
        target: folder of the world.
        name: its name.
        force: existing files may be replaced.
        made: names of the files and folders that an import makes in the folder of the world.

    Raises:
        ConfigError: something is there that may not be replaced.
    """
    existing = [path for path in (target / f"{name}.yaml", target / f"{name}.md", target / name) if _exists(path)]
    if target.exists() and not target.is_dir():
        raise ConfigError(f"{display_path(target)} is not a folder; choose another one")
    if existing and not force:
        raise ConfigError(f"{display_path(existing[0])} exists already; choose another name, or force to replace it")
    for path in existing:
        wanted = path.is_dir() == (path.name == name)
        if path.is_symlink() or not wanted or (path.is_dir() and {entry.name for entry in path.iterdir()} - set(made)):
            raise ConfigError(
                f"{display_path(path)} was not made by an import, so it is not replaced; choose another name"
            )
    return existing


def load_imported(file: Path, source: Path) -> World:
    """Return the world of the file that an import has written.

    Raises:
        ModelError: the world cannot be loaded.
    """
    try:
        return load_world(str(file))
    except (ConfigError, WorldError) as error:
        fault = without_folder(first_line(error), file.parent)
        raise ModelError(f"the imported world cannot be loaded: {fault}", where=f"{display_path(source)}:1") from error


def plain_name(name: str) -> str:
    """Return a file name made of a world's name."""
    plain = re.sub(r"[^A-Za-z0-9_]+", "_", name).strip("_").lower()[:64]
    return plain if re.match(r"[a-z]", plain) and not is_word(plain) else f"world_{plain}"[:64].rstrip("_")


def is_word(name: str) -> bool:
    """Return whether YAML reads a name as another type than text."""
    return name.lower() in {"true", "false", "null", "yes", "no", "on", "off", "y", "n"}


def _exists(path: Path) -> bool:
    return path.is_symlink() or path.exists()
