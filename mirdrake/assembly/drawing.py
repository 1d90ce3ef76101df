"""Block diagrams as pictures: blocks and their connections.

Signals run from top to bottom, driver to control to plant, and back from the plant to whoever measures it: so a picture
fits the width of a page. The blocks of a vehicle are in a frame with its name. Graphviz' ``dot`` lays them out or,
without it, the Graphviz of the package pygraphviz; without both there is the text in its language.
"""

import html
import importlib.util
import re
import shutil
import subprocess
import sys
from collections import defaultdict
from collections.abc import Collection, Mapping

from pydrake.systems.framework import Diagram, System

from mirdrake.assembly.diagram import Assembly
from mirdrake.assembly.diagram_spec import SPLIT
from mirdrake.assembly.wiring import JOIN
from mirdrake.controllers.control_diagram import HOLD
from mirdrake.core.errors import ConfigError, MissingDependencyError

_COLOURS = {"plant": "#dbe7f3", "other": "#eceff1", "user": "#fdebd0", "vehicle": "#e3f1e4"}
_SERVANTS = {"scene_graph", "wheel_readings", "meshcat_visualizer"}  # drawn below the plant

_ELEMENTS = {name: name.split("_")[0] for name in (*SPLIT[:2], *JOIN[:2])} | {SPLIT[2]: "stamp", JOIN[2]: "stamp"}
_NUMBERED = re.compile(r"[uy][0-9]*")  # a numbered port without a name of its own

_PYGRAPHVIZ = """
import sys, pygraphviz
sys.stdout.buffer.write(pygraphviz.AGraph(string=sys.stdin.read()).draw(prog="dot", format="svg"))
"""

_HEAD = """\
digraph {
  graph [rankdir=TB, nodesep=0.25, ranksep=0.45, fontname="Helvetica", fontsize=12, bgcolor="transparent"];
  node [shape=box, style="rounded,filled", fontname="Helvetica", fontsize=12, margin="0.18,0.10", color="#607d8b"];
  edge [fontname="Helvetica", fontsize=10, color="#607d8b", fontcolor="#37474f", arrowsize=0.7];
"""


def write_dot(assembly: Assembly, *, expand: Collection[str] = ()) -> str:
    """Return the blocks of a diagram in the DOT language of Graphviz, without log sinks.

    Arrows are labelled with the output's name, and with the input's if that is more specific. The
    systems that split a command and join it again are drawn as bars.

    Args:
        assembly: the diagram.
        expand: names of the systems whose blocks are drawn, such as ``ego.control``.

    Raises:
        ConfigError: a system to expand does not exist or has no blocks.
    """
    diagram = assembly.diagram
    # Sinks that only log would hide the structure.
    systems = {system.get_name(): system for system in diagram.GetSystems()}
    shown = {name: system for name, system in systems.items() if not name.startswith("log/")}
    inner = {name: _blocks_of(name, shown) for name in expand}
    # One frame per vehicle, then the systems that belong to none.
    lines = [_HEAD]
    for vehicle in assembly.parts.vehicles:
        lines.append(f'  subgraph "cluster_{vehicle}" {{')
        lines.append(f'    label=<<b>{vehicle}</b>>; labeljust=l; style="rounded,dashed"; color="#90a4ae";')
        own = [name for name in shown if _vehicle_of(name, assembly) == vehicle]
        for name in own:
            lines += (
                _cluster(name, inner[name], assembly) if name in inner else [f"  {_node(name, shown[name], assembly)}"]
            )
        lines.append("  }")
    lines += [_node(name, shown[name], assembly) for name in shown if _vehicle_of(name, assembly) is None]

    # Several connections between two blocks are one arrow with all labels; ends in expanded systems are their blocks.
    edges: dict[tuple[str, str], list[str]] = defaultdict(list)
    for (sink, sink_index), (source, source_index) in diagram.connection_map().items():
        tail, head = source.get_name(), sink.get_name()
        if tail in shown and head in shown:
            output, given = source.get_output_port(source_index).get_name(), sink.get_input_port(sink_index).get_name()
            tail, output = _end(tail, output, inner)
            head, given = _end(head, given, inner)
            edges[tail, head].append(_edge_label(_bar_port(tail, output), _bar_port(head, given)))
    for name in inner:
        for (sink, sink_index), (source, source_index) in shown[name].connection_map().items():
            output, given = source.get_output_port(source_index).get_name(), sink.get_input_port(sink_index).get_name()
            edges[f"{name}.{source.get_name()}", f"{name}.{sink.get_name()}"].append(_edge_label(output, given))
    lines += [_edge(tail, head, labels) for (tail, head), labels in edges.items()]
    # Ports of the whole diagram become plain texts with dashed arrows.
    for index in range(diagram.num_input_ports()):
        port = diagram.get_input_port(index)
        (system, system_port), *_ = diagram.GetInputPortLocators(port.get_index())
        head, _ = _end(system.get_name(), system.get_input_port(system_port).get_name(), inner)
        lines.append(f'  "in/{port.get_name()}" [label="{port.get_name()}", shape=plaintext, style=""];')
        lines.append(f'  "in/{port.get_name()}" -> "{head}" [style=dashed];')
    lines.append("}")
    return "\n".join(lines) + "\n"


def _blocks_of(name: str, shown: Mapping[str, System]) -> dict[str, System]:
    """Return the systems within a system, by name."""
    system = shown.get(name)
    if not isinstance(system, Diagram):
        able = [own for own, other in shown.items() if isinstance(other, Diagram)]
        raise ConfigError(f"'{name}' has no blocks to draw; these have: {', '.join(able) or 'none'}")
    return {block.get_name(): block for block in system.GetSystems()}


def _cluster(name: str, blocks: Mapping[str, System], assembly: Assembly) -> list[str]:
    """Return the blocks within a system, in a frame."""
    lines = [f'    subgraph "cluster_{name}" {{', f'    label="{name}"; labeljust=l; style=rounded; color="#81a784";']
    lines += [f"    {_node(f'{name}.{block}', system, assembly)}" for block, system in blocks.items()]
    return [*lines, "    }"]


def _end(system: str, port: str, inner: Mapping[str, Mapping[str, System]]) -> tuple[str, str]:
    """Return the block and the port at an end of a connection: those within an expanded system."""
    if system not in inner:
        return system, port
    block, dot, own = port.partition(".")
    if not dot:
        # Ports of the whole unit have no block in their name: its inputs go to the first blocks, the rest to the hold.
        block, own = {"command": "dead_man", "plant_state": "measurements"}.get(port, HOLD), port
    if block not in inner[system]:  # an input that stands for a block which is left out
        block = HOLD
    return f"{system}.{block}", own


def draw_svg(assembly: Assembly, *, expand: Collection[str] = ()) -> str:
    """Return the block diagram as an SVG picture; see :func:`write_dot`.

    Raises:
        MissingDependencyError: Graphviz is not installed.
    """
    return run_dot(write_dot(assembly, expand=expand), purpose="drawing a diagram")


def fit_svg(svg: str, *, widest: float = 630.0) -> str:
    """Return a picture of Graphviz that is at most `widest` points wide and shrinks to the width of its page."""
    size = re.search(r'width="([\d.]+)pt" height="([\d.]+)pt"', svg)
    if size is not None and float(size[1]) > widest:
        # JupyterLab shows SVG as an image, for which max-width has no effect: width and height are reduced, too, to the
        # 840 pixels that a cell has in a window of 1300 pixels.
        height = widest * float(size[2]) / float(size[1])
        svg = svg.replace(size[0], f'width="{widest:g}pt" height="{height:.0f}pt"', 1)
    return svg.replace("<svg ", '<svg style="max-width: 100%; height: auto" ', 1)


def run_dot(text: str, *, purpose: str) -> str:
    """Return a text in the DOT language as SVG.

    Raises:
        MissingDependencyError: Graphviz is not installed; `purpose` is what it is needed for.
    """
    command = layout_command()
    if command is None:
        raise MissingDependencyError(
            f"{purpose} needs Graphviz: pip install 'mirdrake[drawing]', or the package of your system "
            "(Debian: apt install graphviz)"
        )
    done = subprocess.run(command, input=text, capture_output=True, text=True, check=False)
    if done.returncode != 0 or "<svg" not in done.stdout:
        reason = (done.stderr.strip().splitlines() or ["no output"])[-1]
        raise MissingDependencyError(f"Graphviz failed: {reason}")
    return done.stdout[done.stdout.index("<svg") :]


def layout_command() -> list[str] | None:
    """Return the command that reads DOT and writes SVG; None without Graphviz."""
    if (dot := shutil.which("dot")) is not None:
        return [dot, "-Tsvg"]
    # In a process of its own: its libraries and Drake's never meet, and its warnings about fonts stay there.
    return [sys.executable, "-c", _PYGRAPHVIZ] if importlib.util.find_spec("pygraphviz") else None


def _vehicle_of(name: str, assembly: Assembly) -> str | None:
    """Return the vehicle in whose frame a system is drawn."""
    vehicle, dot, _ = name.partition(".")
    return vehicle if dot and vehicle in assembly.parts.vehicles else None


def _node(name: str, system: System, assembly: Assembly) -> str:
    """Return a block; a bar for a multiplexer or demultiplexer of a command."""
    vehicle = _vehicle_of(name, assembly)
    if vehicle and name.endswith((".split", ".join")):
        return f'  "{name}" [label="", style=filled, fillcolor="#455a64", width=0.8, height=0.07, tooltip="{name}"];'
    title = name.removeprefix(f"{vehicle}.").removeprefix("control.") if vehicle else name
    kind = html.escape(type(system).__name__.split("_")[0])
    group = (
        "user" if name in assembly.spec.systems else "vehicle" if vehicle else "plant" if name == "plant" else "other"
    )
    label = f'<<b>{html.escape(title)}</b><br/><font point-size="9">{kind}</font>>'
    return f'  "{name}" [label={label}, fillcolor="{_COLOURS[group]}", tooltip="{_port_list(system)}"];'


def _port_list(system: System) -> str:
    """Return the names of the ports of a system, as the text that a pointer shows."""
    inputs = [system.get_input_port(index).get_name() for index in range(system.num_input_ports())]
    outputs = [system.get_output_port(index).get_name() for index in range(system.num_output_ports())]
    return html.escape(f"inputs: {', '.join(inputs) or 'none'}; outputs: {', '.join(outputs) or 'none'}")


def _edge(tail: str, head: str, labels: list[str]) -> str:
    """Return all connections from one block to another as one arrow; those of measurements do not order the blocks."""
    text = "\\n".join(dict.fromkeys(label for label in labels if label))
    if {tail, head} == {"plant", "scene_graph"}:
        text = "poses" if tail == "plant" else "contact"
    # Feedback arrows are written backwards or without rank, so that dot keeps the order driver, control, plant.
    if tail == "scene_graph" or (head == "plant" and tail in _SERVANTS):
        return f'  "{head}" -> "{tail}" [label="{text}", dir=back];'
    back = tail == "plant" and head not in _SERVANTS
    return f'  "{tail}" -> "{head}" [label="{text}"{", constraint=false" if back else ""}];'


def _bar_port(system: str, port: str) -> str:
    """Return the name of a port in diagram files, for the numbered ports of the bars; others keep their own."""
    kind, number = system.rpartition(".")[2], port[1:]
    names = {"split": SPLIT, "join": JOIN}.get(kind)
    return names[int(number)] if names and number.isdigit() and port[0] == {"split": "y", "join": "u"}[kind] else port


def _edge_label(output: str, given: str) -> str:
    """Return the names of both ends, or of one where the other adds nothing, such as a numbered port."""
    names = [_ELEMENTS.get(name, name) for name in (output, given) if not _NUMBERED.fullmatch(name)]
    if len(names) == 2 and names[1].endswith(names[0]):
        names.pop()
    return " → ".join(names)
