"""``mirdrake ports``: the ports of a diagram with their elements and units."""

import argparse
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING

from mirdrake.cli.common import add_set, add_trust, assemble_for_display, skipped_lines
from mirdrake.core.errors import ConfigError

if TYPE_CHECKING:
    from mirdrake.core.signals import Signals

MORE = """\
An entry of `connect` names an output and an input, or an element after a dot: [ego.state.vx, notch.u].
`record.signals` names outputs. User modules are executed only with --trust.

examples:
  mirdrake ports bolt_test_track
  mirdrake ports bolt_test_track 'ego.control.*'"""

MOST_ELEMENTS = 50
"""Largest number of elements of a port that are listed one by one."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    parser.add_argument("diagram", help="name or path of a diagram file")
    parser.add_argument("pattern", nargs="?", default="*", help="only ports of these names, as 'ego.control.*'")
    add_set(parser)
    add_trust(parser)


def _listed(contents: "Signals") -> str:
    """Return the elements of a port with their units; of many elements, the first and the last."""
    elements = [f"{signal.name} [{signal.unit or '-'}]" for signal in contents]
    if len(elements) > MOST_ELEMENTS:
        return f"{elements[0]} … {elements[-1]}, {len(elements)} elements"
    return ", ".join(elements)


def run(options: argparse.Namespace) -> int:
    """List the ports."""
    assembly, skipped = assemble_for_display(options.diagram, options.set, trust=options.trust)
    # Outputs and inputs are listed apart, because the same name may be both.
    chosen = {
        title: {name: contents for name, contents in sorted(ports.items()) if fnmatchcase(name, options.pattern)}
        for title, ports in (("outputs", assembly.outputs), ("inputs", assembly.inputs))
    }
    if not any(chosen.values()):
        raise ConfigError(f"no port matches '{options.pattern}'; leave it out to list all")
    for title, ports in chosen.items():
        print(f"{title}:")
        width = max(map(len, ports), default=0)
        for name, contents in ports.items():
            print(f"  {name:{width}}  {_listed(contents or ())}".rstrip())
    for line in skipped_lines(skipped, "ports", "listed"):
        print(f"  {line}")
    return 0
