"""A diagram as a picture: blocks, and what flows between them.

Needs Graphviz' ``dot``, which is no Python package; without it there is the text in its language.
"""

import shutil
import subprocess
from collections import defaultdict

from mirdrake.diagram import Assembly
from mirdrake.errors import MissingDependencyError

_COLOURS = {"plant": "#dbe7f3", "scene_graph": "#eceff1", "user": "#fdebd0", "vehicle": "#e3f1e4"}


def write_dot(assembly: Assembly) -> str:
    """The blocks of a diagram in Graphviz' language; log sinks are left out.

    Arrows are labelled with the output's name, and with the input's where it differs.
    """
    diagram = assembly.diagram
    lines = [
        "digraph {",
        '  graph [rankdir=LR, nodesep=0.25, ranksep=0.9, fontname="Helvetica", bgcolor="transparent"];',
        '  node [shape=box, style="rounded,filled", fontname="Helvetica", fontsize=12, margin="0.18,0.10", color="#607d8b"];',
        '  edge [fontname="Helvetica", fontsize=9, color="#607d8b", fontcolor="#37474f", arrowsize=0.7];',
    ]
    systems = {system.get_name(): system for system in diagram.GetSystems()}
    shown = [name for name in systems if not name.startswith("log/")]
    for name in shown:
        lines.append(f'  "{name}" [label={_label(name, systems[name])}, fillcolor="{_colour(name, assembly)}"];')

    edges: dict[tuple[str, str], list[str]] = defaultdict(list)
    for (sink, sink_index), (source, source_index) in diagram.connection_map().items():
        tail, head = source.get_name(), sink.get_name()
        if tail in shown and head in shown:
            output = source.get_output_port(source_index).get_name()
            given = sink.get_input_port(sink_index).get_name()
            edges[tail, head].append(_edge_label(output, given))
    for (tail, head), labels in edges.items():
        text = "\\n".join(sorted(set(labels)))
        lines.append(f'  "{tail}" -> "{head}" [label="{text}"];')
    for index in range(diagram.num_input_ports()):
        name = diagram.get_input_port(index).get_name()
        (locator, *_) = diagram.GetInputPortLocators(diagram.get_input_port(index).get_index())
        lines.append(f'  "in/{name}" [label="{name}", shape=plaintext, style="", color="transparent"];')
        lines.append(f'  "in/{name}" -> "{locator[0].get_name()}" [style=dashed];')
    lines.append("}")
    return "\n".join(lines) + "\n"


def draw_svg(assembly: Assembly) -> str:
    """The same as an SVG picture.

    Raises:
        MissingDependencyError: Graphviz is not installed.
    """
    dot = shutil.which("dot")
    if dot is None:
        raise MissingDependencyError(
            "drawing a diagram needs Graphviz: install your system's package 'graphviz' (Debian: apt install graphviz)"
        )
    done = subprocess.run([dot, "-Tsvg"], input=write_dot(assembly), capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise MissingDependencyError(f"Graphviz' dot failed: {done.stderr.strip().splitlines()[0]}")
    return done.stdout[done.stdout.index("<svg") :]


def _label(name: str, system: object) -> str:
    kind = type(system).__name__.rstrip("_").split("_𝓣")[0]
    return f'<<b>{name}</b><br/><font point-size="9">{kind}</font>>'


def _colour(name: str, assembly: Assembly) -> str:
    if name in assembly.spec.systems:
        return _COLOURS["user"]
    if name.split(".")[0] in assembly.parts.vehicles:
        return _COLOURS["vehicle"]
    return _COLOURS.get(name, _COLOURS["scene_graph"])


def _edge_label(output: str, given: str) -> str:
    """Names of both ends; numbered ports such as y0 or u1 say nothing and are left out."""
    names = [name for name in (output, given) if not (len(name) <= 3 and name[0] in "uy" and name[1:].isdigit())]
    unique = list(dict.fromkeys(names))
    return " → ".join(unique)
