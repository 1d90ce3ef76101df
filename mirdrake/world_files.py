"""Files of a built world: lock file, SDF world with its meshes, plan view."""

import re
from dataclasses import dataclass
from pathlib import Path

from mirdrake.core.files import staging, write_errors
from mirdrake.core.yaml_io import display_path
from mirdrake.report.plan import Overlap, draw_plan, find_overlaps
from mirdrake.worlds import World
from mirdrake.worlds.lock import content_hash, content_text, lock_content
from mirdrake.worlds.sdf_export import export_sdf


@dataclass(frozen=True)
class Build:
    """The files of a built world.

    Attributes:
        folder: folder of the files.
        lock: path of the lock file; `sdf` and `plan` likewise.
        meshes: number of files of meshes.
        hash: digest of the lock file.
        left_out: features that SDF cannot represent, one line each.
        overlaps: props that overlap: two names, and the area [m].
    """

    folder: Path
    lock: Path
    sdf: Path
    plan: Path
    meshes: int
    hash: str
    left_out: tuple[str, ...]
    overlaps: tuple[Overlap, ...]


def build_world(world: World, folder: Path | str) -> Build:
    """Write a world's lock file, SDF world and plan: all files or none.

    Args:
        world: the world.
        folder: folder for the files; it is created if it does not exist.

    Raises:
        WorldError: a mesh cannot be read.
        RunError: the folder cannot be written.
    """
    folder, name = Path(folder), file_name(world.name)
    sdf = export_sdf(world, file=f"{name}.sdf")
    overlaps = tuple(find_overlaps(world))
    files = dict(sdf.files)
    files[f"{name}.svg"] = draw_plan(world, overlaps=overlaps).encode()
    content = lock_content(world)
    files[f"{name}.lock.yaml"] = content_text(content).encode()
    _write_all(folder, files)
    lock, plan = folder / f"{name}.lock.yaml", folder / f"{name}.svg"
    meshes = len(sdf.files) - 1
    return Build(folder, lock, folder / f"{name}.sdf", plan, meshes, content_hash(content), sdf.left_out, overlaps)


def file_name(name: str) -> str:
    """Return the name of a world as a file name of letters, digits, underscores, dots and dashes."""
    return re.sub(r"[^\w.-]+", "_", name)[:100].strip("._") or "world"


# --- the inner parts ---------------------------------------------------------------------------------------------


def _write_all(folder: Path, files: dict[str, bytes]) -> None:
    """Write all files or none."""
    with write_errors(Path(display_path(folder))):
        for name in files:
            if (folder / name).is_dir():
                raise IsADirectoryError(0, f"{name} is a folder")
        with staging(folder) as stage:
            for name, content in files.items():
                (stage.path / name).parent.mkdir(parents=True, exist_ok=True)
                (stage.path / name).write_bytes(content)
            stage.publish(merge=True)
