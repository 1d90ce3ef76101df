"""``mirdrake world build``: lay out a world and write it for Gazebo and as a plan."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from mirdrake.cli.common import add_param, add_set, parse_pairs
from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.wording import plural
from mirdrake.core.yaml_io import display_path

MORE = """\
NAME.lock.yaml lists the pose of every object, with a hash: the same seed gives the same bytes everywhere. NAME.sdf is
the world for Gazebo and Drake, with its meshes. NAME.svg is the plan from above, overlaps in red.
Exit codes: 0 built, 1 built, but a prop could not be placed, 2 bad input.

examples:
  mirdrake world build parking_lot
  mirdrake world build parking_lot -o out --set seed=3 -p mu=0.3"""

_MOST_LINES = 5  # of a kind


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    parser.add_argument("world", metavar="FILE", help="name or path of a world file")
    parser.add_argument("-o", "--out", type=Path, metavar="DIR", help="folder for the files (default: worlds-out/NAME)")
    add_set(parser, "seed=3")
    add_param(parser)


def run(options: argparse.Namespace) -> int:
    """Lay out the world and write its files."""
    from mirdrake.world_files import build_world, file_name
    from mirdrake.worlds import load_world

    # Parameters are overrides of `params`, checked by the same schema.
    overrides = [*options.set, *_parameter_overrides(options.world, options.param)]
    world = load_world(options.world, overrides=overrides)
    build = build_world(world, options.out or Path("worlds-out") / file_name(world.name))
    count = plural(len(world.props), "prop")
    width = max(len(path.name) for path in (build.lock, build.sdf, build.plan))
    print(f"{display_path(build.folder)}/")
    print(f"  {build.lock.name:{width}}  {count}, seed {world.spec.seed}, hash {build.hash[:12]}")
    print(f"  {build.sdf.name:{width}}  for Gazebo and Drake, with {build.meshes} files in meshes/")
    print(f"  {build.plan.name:{width}}  plan from above")
    _print_some("left out of the SDF world: ", build.left_out)
    # Overlaps are faults of the world, but not of the files that were written.
    _print_some("overlap: ", [f"{a} and {b}, {area.area:.2g} m²" for a, b, area in build.overlaps])
    for line in world.unplaced_props:
        print(f"error: {line}", file=sys.stderr)
    return 1 if world.unplaced_props else 0


def _parameter_overrides(name: str, texts: Sequence[str]) -> list[str]:
    """Return ``NAME=VALUE`` texts as overrides of parameters that the world has."""
    from mirdrake.core.paths import find
    from mirdrake.core.yaml_io import read_tree

    if not texts:
        return []
    data, _ = read_tree(find("worlds", name))
    params = data.get("params") if isinstance(data, dict) else None
    known = params if isinstance(params, dict) else {}
    for key, value in parse_pairs("-p", texts, "for example mu=0.3").items():
        if key.strip() not in known:
            hint = did_you_mean(key, map(str, known)) if known else "it has none; add it under params"
            raise ConfigError(f"-p {key}={value}: the world has no parameter '{key}'; {hint}")
    return [f"params.{text}" for text in texts]


def _print_some(label: str, lines: Sequence[str]) -> None:
    """Print the first lines, and how many more there are."""
    for line in lines[:_MOST_LINES]:
        print(f"{label}{line}")
    if len(lines) > _MOST_LINES:
        print(f"{label}and {len(lines) - _MOST_LINES} more")
