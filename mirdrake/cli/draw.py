"""``mirdrake draw``: a diagram's blocks and connections."""

import argparse
from contextlib import nullcontext
from pathlib import Path

from mirdrake.cli.verb import add_set, add_trust, not_executed
from mirdrake.errors import ConfigError
from mirdrake.yaml_io import shown

HELP = "draw a diagram's blocks and connections as SVG (needs Graphviz)"
MORE = """\
A module of your own (kind: "module:Class") is executed with --trust only; without, it is not drawn.

example:
  mirdrake draw bolt_test_track --out blocks.svg"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The verb's arguments."""
    parser.add_argument("diagram", help="name or path of a diagram file")
    add_set(parser)
    add_trust(parser)
    parser.add_argument("--out", type=Path, metavar="FILE", help=".svg or .dot (default: <name>.svg)")


def run(options: argparse.Namespace) -> int:
    """Draw."""
    from mirdrake.diagram import assemble, load_diagram
    from mirdrake.diagram_spec import without_own_systems
    from mirdrake.drawing import draw_svg, write_dot
    from mirdrake.logs import write_file
    from mirdrake.own_modules import without_own_code

    spec = load_diagram(options.diagram, overrides=options.set)
    skipped: list[str] = []
    if not options.trust:
        spec, skipped = without_own_systems(spec)
    with nullcontext() if options.trust else without_own_code():
        assembly = assemble(spec)
    out = options.out or Path(f"{assembly.spec.name}.svg")
    if out.suffix not in {".svg", ".dot"}:
        raise ConfigError(f"--out {out}: the name must end in .svg or .dot")
    write_file(out, draw_svg(assembly) if out.suffix == ".svg" else write_dot(assembly))
    print(shown(out))
    for line in not_executed(skipped):
        print(f"  {line.replace('checked', 'drawn', 1)}")
    return 0
