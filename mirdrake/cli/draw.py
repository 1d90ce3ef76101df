"""``mirdrake draw``: a diagram's blocks and connections."""

import argparse
from pathlib import Path

from mirdrake.cli.common import add_set, add_trust, assemble_for_display, skipped_lines
from mirdrake.core.errors import ConfigError
from mirdrake.core.yaml_io import display_path

MORE = """\
User modules (kind: "module:Class") are executed only with --trust; without it they are not drawn.

examples:
  mirdrake draw bolt_test_track --out blocks.svg
  mirdrake draw bolt_test_track --expand ego.control"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    parser.add_argument("diagram", help="name or path of a diagram file")
    add_set(parser)
    parser.add_argument("--expand", action="append", default=[], metavar="SYSTEM", help="draw the blocks of a system")
    add_trust(parser)
    parser.add_argument("--out", type=Path, metavar="FILE", help=".svg or .dot (default: <name>.svg)")


def run(options: argparse.Namespace) -> int:
    """Draw the diagram."""
    from mirdrake.assembly.drawing import draw_svg, write_dot
    from mirdrake.core.files import write_file

    assembly, skipped = assemble_for_display(options.diagram, options.set, trust=options.trust)
    out = options.out or Path(f"{assembly.spec.name}.svg")
    if out.suffix not in {".svg", ".dot"}:
        raise ConfigError(f"--out {out}: the name must end in .svg or .dot")
    draw = draw_svg if out.suffix == ".svg" else write_dot
    write_file(out, draw(assembly, expand=options.expand))
    print(display_path(out))
    for line in skipped_lines(skipped, "draw", "drawn"):
        print(f"  {line}")
    return 0
