"""``mirdrake world build``: a world settled, for Gazebo, and from above."""

import argparse
import os
import re
import shutil
import sys
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from mirdrake.errors import ConfigError, RunError, did_you_mean
from mirdrake.yaml_io import shown

if TYPE_CHECKING:
    from mirdrake.report.plan import Overlap
    from mirdrake.worlds import World

HELP = "write a world's lock file, its SDF world for Gazebo and Drake, and its plan"
MORE = """\
NAME.lock.yaml says where everything is, with a hash: the same seed gives the same bytes everywhere. NAME.sdf is the
world for Gazebo and Drake, with its meshes. NAME.svg is the plan from above, overlaps in red.
Exit codes: 0 built, 1 built, but something found no place in the world, 2 bad input.

examples:
  mirdrake world build parking_lot
  mirdrake world build parking_lot -o out --set seed=3 -p mu=0.3"""

_SHOWN = 5  # lines of a kind that are printed


@dataclass(frozen=True)
class Build:
    """What was written.

    Attributes:
        folder: where.
        lock: the lock file; `sdf` and `plan` likewise.
        meshes: number of files of meshes.
        hash: SHA-256 of all that is settled.
        left_out: what the SDF world cannot say, one line each.
        overlaps: props that overlap: two names, and the area [m].
    """

    folder: Path
    lock: Path
    sdf: Path
    plan: Path
    meshes: int
    hash: str
    left_out: tuple[str, ...]
    overlaps: "tuple[Overlap, ...]"


def build_world(world: "World", folder: Path | str) -> Build:
    """Write a world's lock file, SDF world and plan.

    Everything is made before anything is written; a folder that cannot take all files gets none.

    Args:
        world: the world.
        folder: for the files; made if there is none.

    Raises:
        WorldError: a mesh cannot be read.
        RunError: the folder cannot be written.
    """
    from mirdrake.report.plan import draw_world, find_overlaps
    from mirdrake.worlds.lock import content_hash, content_text, lock_content
    from mirdrake.worlds.sdf_export import export_sdf

    folder, name = Path(folder), file_name(world.name)
    sdf = export_sdf(world, file=f"{name}.sdf")
    overlaps = tuple(find_overlaps(world))
    files = dict(sdf.files)
    files[f"{name}.svg"] = draw_world(world, overlaps=overlaps).encode()
    content = lock_content(world)
    files[f"{name}.lock.yaml"] = content_text(content).encode()
    _write_all(folder, files)
    lock, plan = folder / f"{name}.lock.yaml", folder / f"{name}.svg"
    meshes = len(sdf.files) - 1
    return Build(folder, lock, folder / f"{name}.sdf", plan, meshes, content_hash(content), sdf.left_out, overlaps)


def file_name(name: str) -> str:
    """The name of a world as that of a file: letters, digits, underscores, dots and dashes."""
    return re.sub(r"[^\w.-]+", "_", name)[:100].strip("._") or "world"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The verb's arguments."""
    parser.add_argument("world", metavar="FILE", help="name or path of a world file")
    parser.add_argument("-o", "--out", type=Path, metavar="DIR", help="folder for the files (default: worlds-out/NAME)")
    parser.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", help="override a key of the file, as seed=3"
    )
    parser.add_argument(
        "-p", "--param", action="append", default=[], metavar="NAME=VALUE", help="set a parameter, as mu=0.3"
    )


def run(options: argparse.Namespace) -> int:
    """Build."""
    from mirdrake.worlds import load_world

    overrides = [*options.set, *_parameters(options.world, options.param)]
    world = load_world(options.world, overrides=overrides)
    build = build_world(world, options.out or Path("worlds-out") / file_name(world.name))
    count = len(world.props)
    width = max(len(path.name) for path in (build.lock, build.sdf, build.plan))
    print(f"{shown(build.folder)}/")
    print(
        f"  {build.lock.name:{width}}  {count} prop{'s' * (count != 1)}, seed {world.spec.seed}, hash {build.hash[:12]}"
    )
    print(f"  {build.sdf.name:{width}}  for Gazebo and Drake, with {build.meshes} files in meshes/")
    print(f"  {build.plan.name:{width}}  from above")
    _tell("left out of the SDF world: ", build.left_out)
    _tell("overlap: ", [f"{a} and {b}, {area.area:.2g} m²" for a, b, area in build.overlaps])
    for line in world.homeless:
        print(f"error: {line}", file=sys.stderr)
    return 1 if world.homeless else 0


# --- the inner parts ---------------------------------------------------------------------------------------------


def _parameters(name: str, texts: Sequence[str]) -> list[str]:
    """``NAME=VALUE`` texts as overrides of parameters that the world has."""
    from mirdrake.paths import find
    from mirdrake.yaml_io import read_tree

    if not texts:
        return []
    data, _ = read_tree(find("worlds", name))
    known = data.get("params") if isinstance(data, dict) else None
    known = known if isinstance(known, dict) else {}
    overrides = []
    for text in texts:
        key, mark, _ = text.partition("=")
        if not mark or not key:
            raise ConfigError(f"-p {text}: expected NAME=VALUE, for example mu=0.3")
        if key.strip() not in known:
            hint = did_you_mean(key, map(str, known)) if known else "it has none; add it under params"
            raise ConfigError(f"-p {text}: the world has no parameter '{key}'; {hint}")
        overrides.append(f"params.{text}")
    return overrides


def _tell(what: str, lines: Sequence[str]) -> None:
    for line in lines[:_SHOWN]:
        print(f"{what}{line}")
    if len(lines) > _SHOWN:
        print(f"{what}and {len(lines) - _SHOWN} more")


def _write_all(folder: Path, files: dict[str, bytes]) -> None:
    """Write all files or none: into a folder beside them first, then each renamed."""
    needed = {folder, *(above for name in files for above in (folder / name).parents if folder in above.parents)}
    missing = [path for path in (*folder.parents, *needed) if not path.exists()]
    staging: Path | None = None
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name in files:
            if (folder / name).is_dir():
                raise IsADirectoryError(0, f"{name} is a folder")
        staging = Path(tempfile.mkdtemp(prefix=".build-", dir=folder))
        for name, content in files.items():
            (staging / name).parent.mkdir(parents=True, exist_ok=True)
            (staging / name).write_bytes(content)
        for path in needed:
            path.mkdir(parents=True, exist_ok=True)
        for name in files:
            os.replace(staging / name, folder / name)
    except OSError as error:
        if staging is not None:
            shutil.rmtree(staging, ignore_errors=True)
        for path in sorted(missing, key=lambda path: -len(path.parts)):  # those that were made, if they are empty
            with suppress(OSError):
                path.rmdir()
        reason = error.strerror or str(error).splitlines()[0]
        raise RunError(f"{shown(folder)}: cannot be written: {reason}; choose another folder with -o") from None
    finally:
        if staging is not None:
            shutil.rmtree(staging, ignore_errors=True)
