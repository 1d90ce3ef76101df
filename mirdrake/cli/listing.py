"""``mirdrake list``: names of vehicles, worlds, diagrams and everything else that can be named."""

import argparse
from collections.abc import Iterator

from mirdrake.core.paths import names, search_folders
from mirdrake.core.yaml_io import display_path

MORE = """\
Without an argument: vehicles, worlds, diagrams and studies.

examples:
  mirdrake list drivers
  mirdrake list all"""

FILES = ("models", "worlds", "diagrams", "studies")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    parser.add_argument("what", nargs="?", choices=[*FILES, *OTHERS, "all"], help="list only these")


def run(options: argparse.Namespace) -> int:
    """Print names with their meaning."""
    chosen = {None: FILES, "all": (*FILES, *OTHERS)}.get(options.what, (options.what,))
    for kind in chosen:
        print(f"{kind}:")
        for name, text in OTHERS[kind]() if kind in OTHERS else _files(kind):
            print(f"  {name:26} {text}")
        if kind in FILES and not search_folders(kind):
            print(f"  (no folder {kind}/ found)")
    return 0


def _files(kind: str) -> Iterator[tuple[str, str]]:
    return ((name, display_path(path)) for name, path in names(kind).items())


def _blocks() -> Iterator[tuple[str, str]]:
    from mirdrake.assembly.blocks import BLOCKS

    return ((name, _first_line(schema)) for name, schema in BLOCKS.items())


def _drivers() -> Iterator[tuple[str, str]]:
    from mirdrake.controllers.drivers import DRIVERS

    return ((name, _first_line(schema)) for name, schema in sorted(DRIVERS.items()))


def _props() -> Iterator[tuple[str, str]]:
    from mirdrake.worlds.props import load_prop, prop_names

    for name in prop_names():
        x, y, z = load_prop(name).size
        yield name, f"{x:g} x {y:g} x {z:g} m"


def _sensors() -> Iterator[tuple[str, str]]:
    from mirdrake.vehicles.presets import presets

    return ((name, preset.name) for name, preset in sorted(presets().items()))


def _first_line(schema: type) -> str:
    return (schema.__doc__ or "").splitlines()[0]


OTHERS = {"props": _props, "sensors": _sensors, "drivers": _drivers, "blocks": _blocks}
"""What is listed only on request, with their functions."""
