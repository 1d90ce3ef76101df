"""An inspection as text for a terminal, and the links and joints of a vehicle as a graph."""

import html
import math
from collections.abc import Iterable, Sequence

from mirdrake.assembly.drawing import run_dot
from mirdrake.core.constants import GRAVITY
from mirdrake.vehicles.figures import Inspection, JointFigures, JointRole, LinkFigures, SensorFigures

_COLOURS = {"body": "#dbe7f3", "wheel": "#e3f1e4", "knuckle": "#fdebd0", "sensor": "#f3e5f5", "frame": "#eceff1"}


def figure_rows(figures: Inspection) -> list[tuple[str, str, str]]:
    """Return the figures of a vehicle for terminal and page: name, value with its unit, and a note."""
    front, rear = figures.loads
    inner, outer = (math.degrees(angle) for angle in figures.steering_limits)
    clearance = figures.ground_clearance
    sizes = [("Size of the collision shapes", figures.size, "length, width, height above the road")]
    if figures.visual_size:
        sizes.append(("Size of the visual shapes", figures.visual_size, "with mirrors and antennas"))
    # Each figure has its definition beside it, because tracks, radii and circles have several.
    return [
        ("Mass", f"{figures.mass:.1f} kg" if figures.mass >= 100.0 else f"{figures.mass:.4g} kg", ""),
        ("Centre of mass", _metres(figures.com), "x from the rear axle, y, z from the road"),
        (
            "Axle loads at rest",
            f"front {_load(front)} ({100 * figures.front_share:.1f} %), rear {_load(rear)}",
            "",
        ),
        ("Load on the left wheels", f"{100.0 * figures.side_share:.1f} %", "of the total"),
        ("Wheelbase", f"{figures.wheelbase:.3f} m", ""),
        ("Tracks", _metres(figures.tracks), "front, rear; between contact centres"),
        ("Kingpin track", f"{figures.kingpin_track:.3f} m", "between the steering axes, on the road"),
        ("Wheel radii", _metres(figures.wheel_radii, digits=4), "front, rear"),
        ("Wheel widths", _metres(figures.wheel_widths), "front, rear; of the collision shapes"),
        *((name, " x ".join(f"{edge:.3f}" for edge in size) + " m", note) for name, size, note in sizes),
        ("Ground clearance", f"{clearance:.3f} m" if math.isfinite(clearance) else "-", "of the collision shapes"),
        (
            "Wheels at full lock",
            f"{inner:.1f} deg, {outer:.1f} deg",
            "inner, outer: cot(outer) = cot(inner) + kingpin track / L",
        ),
        (
            "Turning radius",
            f"{figures.turning_radius:.2f} m",
            "rear axle's centre: L / tan(inner) + kingpin track / 2",
        ),
        ("Turning circle", f"{figures.turning_circle:.2f} m", "kerb to kerb, diameter"),
        ("Wall to wall", f"{figures.wall_circle:.2f} m", "diameter of the outermost corner of the collision shapes"),
        (
            "Inertia",
            ", ".join(f"{value:.4g}" for value in figures.inertia) + " kg m²",
            "roll, pitch, yaw about the centre of mass",
        ),
        ("Radii of gyration", _metres(figures.gyration), "roll, pitch, yaw: √(I / m)"),
        (
            "Dynamic index",
            f"{figures.dynamic_index:.2f}",
            "k² / (a b) of the yaw inertia; cars have 0.8 to 1.1, robots 0.4 to 0.7",
        ),
        ("Rollover threshold", f"{figures.static_stability:.2f} g", "T / 2h, on rigid tyres"),
    ]


def _metres(values: Sequence[float], *, digits: int = 3) -> str:
    """Return lengths without negative zeros."""
    return ", ".join(f"{round(value, digits) + 0.0:.{digits}f}" for value in values) + " m"


def describe(figures: Inspection) -> str:
    """Return the figures as text with aligned columns."""
    # Text for a terminal: the same rows as on the page.
    rows = [(name, value, f"({note})" if note else "") for name, value, note in figure_rows(figures)]
    parts = [
        f"{figures.vehicle}: {figures.title}, {figures.drive} drive, grade {figures.grade}",
        _columns(rows, indent=2),
        "links",
        _columns(
            [
                ("", "mass [kg]", "principal moments [kg m²]", "box of that inertia [m]", "box of its shapes [m]", ""),
                *(_link_row(link) for link in figures.links if link.mass),
            ],
            indent=2,
        ),
        "joints",
        _columns(
            [
                ("", "type", "parent", "axis", "limits [rad]", "[rad/s]", "[N m s/rad]", "role"),
                *(_joint_row(joint) for joint in figures.joints if joint.kind != "fixed"),
            ],
            indent=2,
        ),
    ]
    # Actuators are listed even if there are none, as a vehicle without any cannot move.
    rows_of = [(actuator.joint, f"{actuator.effort:.4g}", actuator.moves) for actuator in figures.actuators]
    parts += ["actuators", _columns([("", "[N m]", "function"), *rows_of], indent=2)]
    if figures.sensors:
        mounts = [(s.name, s.kind, s.frame, numbers(s.place), f"{s.rate:g} Hz") for s in figures.sensors]
        parts += ["sensors", _columns([("", "kind", "frame", "position [m]", "rate"), *mounts], indent=2)]
    parts.append("warnings" if figures.warnings else "no warnings")
    parts += [f"  {warning}" for warning in figures.warnings]
    return "\n".join(parts)


def describe_view(sensor: SensorFigures) -> str:
    """Return the field of view and the range of a sensor; a dash for one without a viewing direction."""
    if not sensor.across:
        return "–"
    across = math.degrees(sensor.across[1] - sensor.across[0])
    upward = math.degrees(sensor.upward[1] - sensor.upward[0])
    high = f" × {upward:.0f}°" if upward else ""
    return f"{across:.0f}°{high}, {sensor.reach[0]:g} to {sensor.reach[1]:g} m"


def draw_links(figures: Inspection) -> str:
    """Return links and joints as an SVG graph: bodies and frames are nodes, joints are arrows.

    Raises:
        MissingDependencyError: Graphviz is not installed.
    """
    return run_dot(write_links_dot(figures), purpose="drawing the links")


def write_links_dot(figures: Inspection) -> str:
    """Return links and joints as a graph in the DOT language."""
    # Colours of the graph show the role of a link, found by the joint above it.
    roles = {joint.child: joint.role for joint in figures.joints if joint.role}
    mounts = {sensor.frame for sensor in figures.sensors}
    lines = [
        "digraph {",
        '  graph [rankdir=LR, nodesep=0.2, ranksep=0.9, fontname="Helvetica", bgcolor="transparent"];',
        '  node [shape=box, style="rounded,filled", fontname="Helvetica", fontsize=12, color="#607d8b"];',
        '  edge [fontname="Helvetica", fontsize=10, color="#607d8b", fontcolor="#37474f", arrowsize=0.7];',
    ]
    for link in figures.links:
        role = roles.get(link.name, JointRole.NONE)
        kind = "wheel" if role.is_wheel else "knuckle" if role else "body" if link.mass else "frame"
        kind = "sensor" if kind == "frame" and link.name in mounts else kind
        weight = f'<br/><font point-size="9">{link.mass:.4g} kg</font>' if link.mass else ""
        label = f"<<b>{html.escape(link.name)}</b>{weight}>"
        lines.append(f'  "{_quoted(link.name)}" [label={label}, fillcolor="{_COLOURS[kind]}"];')
    for joint in figures.joints:
        how = f"{joint.kind} along" if joint.kind == "prismatic" else f"{joint.kind} about"
        axis = f"\\n{how} {axis_name(joint.axis)}" if joint.axis else ""
        style = ", style=dashed" if joint.kind == "fixed" else ""
        name = "" if joint.kind == "fixed" else _quoted(joint.name)
        ends = f'"{_quoted(joint.parent)}" -> "{_quoted(joint.child)}"'
        lines.append(f'  {ends} [label="{name}{axis}"{style}];')
    return "\n".join([*lines, "}"]) + "\n"


def _load(force: float) -> str:
    """Return a load in N and kg, to a tenth of a percent or better."""
    newton = f"{force:.0f}" if abs(force) >= 1000.0 else f"{force:.4g}"
    kilogram = force / GRAVITY
    return f"{newton} N, " + (f"{kilogram:.1f} kg" if abs(kilogram) >= 100.0 else f"{kilogram:.4g} kg")


def _link_row(link: LinkFigures) -> tuple[str, ...]:
    extent = " x ".join(f"{edge:.3g}" for edge in link.extent) if link.extent[0] else "-"
    note = f"spin {link.spin:.2f} m R²" if link.spin is not None else ""
    edges = " x ".join(f"{edge:.3g}" for edge in link.edges)
    return link.name, f"{link.mass:.4g}", numbers(link.moments), edges, extent, note


def _joint_row(joint: JointFigures) -> tuple[str, ...]:
    return (
        joint.name,
        joint.kind,
        joint.parent,
        axis_name(joint.axis),
        limits_of(joint),
        f"{joint.velocity:g}",
        f"{joint.damping:g}",
        joint.role_text or "-",
    )


def limits_of(joint: JointFigures) -> str:
    """Return the limits of a joint [rad]; those of a prismatic joint have their unit, m."""
    free = math.isinf(joint.lower) and math.isinf(joint.upper)
    unit = " m" if joint.kind == "prismatic" else ""
    return "free" if free else f"{joint.lower:g} .. {joint.upper:g}{unit}"


def axis_name(axis: Sequence[float]) -> str:
    """Return the letter of an axis of base_link, or its direction."""
    names: dict[tuple[float, ...], str] = {(1.0, 0.0, 0.0): "x", (0.0, 1.0, 0.0): "y", (0.0, 0.0, 1.0): "z"}
    return names.get(tuple(round(value, 6) + 0.0 for value in axis), numbers(axis))


def numbers(values: Iterable[float]) -> str:
    """Return numbers separated by blanks, four significant digits each."""
    return " ".join(f"{value:.4g}" for value in values)


def _columns(rows: Sequence[Sequence[str]], *, indent: int) -> str:
    """Return rows as text, each column as wide as its widest entry."""
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    lines = ("  ".join(text.ljust(width) for text, width in zip(row, widths, strict=True)) for row in rows)
    return "\n".join(" " * indent + line.rstrip() for line in lines)


def _quoted(text: str) -> str:
    return text.replace("\\", "\\\\").replace('"', '\\"')
