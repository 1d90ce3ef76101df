"""``mirdrake list``: what there is."""

import argparse

from mirdrake.paths import names, search_folders
from mirdrake.yaml_io import shown

HELP = "list vehicles, worlds, diagrams, and the kinds of blocks"
MORE = "example:\n  mirdrake list worlds"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The verb's arguments."""
    parser.add_argument("what", nargs="?", choices=["models", "worlds", "diagrams", "blocks"], help="only these")


def run(options: argparse.Namespace) -> int:
    """Print names and paths."""
    for kind in [options.what] if options.what else ["models", "worlds", "diagrams", "blocks"]:
        print(f"{kind}:")
        if kind == "blocks":
            from mirdrake.blocks import BLOCKS

            for name, schema in BLOCKS.items():
                print(f"  {name:22} {(schema.__doc__ or '').splitlines()[0]}")
            continue
        for name, path in names(kind).items():
            print(f"  {name:22} {shown(path)}")
        if not search_folders(kind):
            print(f"  (no folder {kind}/ found)")
    return 0
