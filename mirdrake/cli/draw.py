"""``mirdrake draw``: a diagram's blocks and connections."""

import argparse
from contextlib import nullcontext
from pathlib import Path

from mirdrake.cli.common import add_set, add_trust, skipped_lines
from mirdrake.core.errors import ConfigError
from mirdrake.core.yaml_io import shown

MORE = """\
User modules (kind: "module:Class") are executed only with --trust; without it they are not drawn.

An element of a vector is connected by its name: connect: [[ego.state.vx, notch.u]].

examples:
  mirdrake draw bolt_test_track --out blocks.svg
  mirdrake draw bolt_test_track --ports"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    parser.add_argument("diagram", help="name or path of a diagram file")
    add_set(parser)
    parser.add_argument("--ports", action="store_true", help="list all ports with their elements and units, and stop")
    add_trust(parser)
    parser.add_argument("--out", type=Path, metavar="FILE", help=".svg or .dot (default: <name>.svg)")


def run(options: argparse.Namespace) -> int:
    """Draw the diagram, or list its ports."""
    from mirdrake.assembly.diagram import assemble, load_diagram
    from mirdrake.assembly.diagram_spec import without_user_systems
    from mirdrake.assembly.drawing import draw_svg, write_dot
    from mirdrake.core.files import write_file
    from mirdrake.core.user_modules import without_user_code

    spec = load_diagram(options.diagram, overrides=options.set)
    skipped: list[str] = []
    if not options.trust:
        spec, skipped = without_user_systems(spec)
    with nullcontext() if options.trust else without_user_code():
        assembly = assemble(spec)
    if options.ports:
        for title, ports in (("outputs", assembly.outputs), ("inputs", assembly.inputs)):
            print(f"{title}:")
            width = max(map(len, ports), default=0)
            for name, contents in sorted(ports.items()):
                elements = ", ".join(f"{signal.name} [{signal.unit or '-'}]" for signal in contents or ())
                print(f"  {name:{width}}  {elements}".rstrip())
        return 0
    out = options.out or Path(f"{assembly.spec.name}.svg")
    if out.suffix not in {".svg", ".dot"}:
        raise ConfigError(f"--out {out}: the name must end in .svg or .dot")
    write_file(out, draw_svg(assembly) if out.suffix == ".svg" else write_dot(assembly))
    print(shown(out))
    for line in skipped_lines(skipped, "drawn"):
        print(f"  {line}")
    return 0
