"""``mirdrake schema``: JSON Schemas of the YAML files, for editors."""

import argparse
import json
import os
from pathlib import Path

from mirdrake.core.yaml_io import display_path

MORE = """\
Without a kind it lists the kinds. Editors with the YAML language server (VS Code, Neovim, Emacs) use a schema when
the first line of a file names it, relative to the file. For a file in diagrams/, with schemas/ beside that folder:
  # yaml-language-server: $schema=../schemas/diagram.json

examples:
  mirdrake schema diagram > diagram.json
  mirdrake schema --out schemas              all of them, one file per kind"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    parser.add_argument("kind", nargs="?", help="vehicle, control, sensors, world, diagram and others")
    parser.add_argument("--out", type=Path, metavar="DIR", help="write files <kind>.json instead of printing")


def run(options: argparse.Namespace) -> int:
    """List the kinds, or print or write their schemas."""
    from mirdrake.core.files import write_file
    from mirdrake.schemas import KINDS, make_schema

    if options.out is None and options.kind is None:
        for name, kind in KINDS.items():
            print(f"{name:16}{kind.files:26}{kind.text}")
        return 0
    kinds = [options.kind] if options.kind is not None else list(KINDS)
    # All schemas are made before the first file is written.
    texts = {name: json.dumps(make_schema(name), indent=2, ensure_ascii=False) + "\n" for name in kinds}
    if options.out is None:
        print(texts[options.kind], end="")
        return 0
    options.out.mkdir(parents=True, exist_ok=True)
    for name, text in texts.items():
        path = options.out / f"{name}.json"
        write_file(path, text)
        print(f"{display_path(path)}    # yaml-language-server: $schema={Path(os.path.relpath(path)).as_posix()}")
    print("the paths are relative to this folder; in a file of a folder below it, begin them with ../")
    return 0
