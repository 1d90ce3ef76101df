"""``mirdrake world build``: a world settled, for Gazebo, and from above."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.yaml_io import shown

HELP = "write a world's lock file, its SDF world for Gazebo and Drake, and its plan"
MORE = """\
NAME.lock.yaml says where everything is, with a hash: the same seed gives the same bytes everywhere. NAME.sdf is the
world for Gazebo and Drake, with its meshes. NAME.svg is the plan from above, overlaps in red.
Exit codes: 0 built, 1 built, but something found no place in the world, 2 bad input.

examples:
  mirdrake world build parking_lot
  mirdrake world build parking_lot -o out --set seed=3 -p mu=0.3"""

_SHOWN = 5  # lines of a kind that are printed


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
    from mirdrake.world_files import build_world, file_name
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
    from mirdrake.core.paths import find
    from mirdrake.core.yaml_io import read_tree

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
