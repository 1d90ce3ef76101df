"""An inspection as text for a terminal, and the links and joints of a vehicle as a graph."""

import html
import math
from collections.abc import Iterable, Sequence

from mirdrake.assembly.drawing import run_dot
from mirdrake.core.constants import GRAVITY
from mirdrake.vehicles.figures import Inspection, JointFigures, LinkFigures

_COLOURS = {"body": "#dbe7f3", "wheel": "#e3f1e4", "knuckle": "#fdebd0", "sensor": "#f3e5f5", "frame": "#eceff1"}


def describe(figures: Inspection) -> str:
    """Return the figures as text with aligned columns."""
    front, rear = figures.loads
    length, width, height = figures.size
    inner, outer = (math.degrees(angle) for angle in figures.steering_limits)
    roll, pitch, yaw = figures.inertia
    x, y, z = (round(value, 3) + 0.0 for value in figures.com)
    rows = [
        ("mass", f"{figures.mass:.1f} kg" if figures.mass >= 100.0 else f"{figures.mass:.4g} kg"),
        ("centre of mass", f"{x:.3f} m ahead of the rear axle, {y:.3f} m to the left, {z:.3f} m above the road"),
        (
            "axle loads",
            f"front {_load(front)} ({100 * figures.front_share:.1f} %), rear {_load(rear)}",
        ),
        ("left wheels", f"{100 * figures.side_share:.1f} % of the load"),
        ("wheelbase", f"{figures.wheelbase:.3f} m"),
        ("track", f"front {figures.tracks[0]:.3f} m, rear {figures.tracks[1]:.3f} m"),
        ("between steering axes", f"{figures.kingpin_track:.3f} m"),
        ("wheels", _wheels(figures)),
        ("size", f"{length:.3f} x {width:.3f} x {height:.3f} m (collision shapes)"),
        *(
            [("", "{:.3f} x {:.3f} x {:.3f} m (what is seen)".format(*figures.visual_size))]
            if figures.visual_size
            else []
        ),
        ("ground clearance", f"{figures.ground_clearance:.3f} m" if math.isfinite(figures.ground_clearance) else "-"),
        ("full lock", f"inner wheel {inner:.1f} deg, outer wheel {outer:.1f} deg"),
        ("turning radius", f"{figures.turning_radius:.2f} m (rear axle's centre)"),
        ("turning circle", f"{figures.turning_circle:.2f} m (kerb to kerb, diameter)"),
        ("", f"{figures.wall_circle:.2f} m (wall to wall, corners of the collision shapes)"),
        ("inertia", f"roll {roll:.4g}, pitch {pitch:.4g}, yaw {yaw:.4g} kg m² (about the centre of mass)"),
        ("radii of gyration", "roll {:.3f}, pitch {:.3f}, yaw {:.3f} m".format(*figures.gyration)),
        ("dynamic index", f"{figures.dynamic_index:.2f} (k² / a b of the yaw inertia; cars have 0.8 to 1.1)"),
        ("static stability", f"{figures.static_stability:.2f} (tips at so many g sideways)"),
    ]
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
    rows_of = [(actuator.joint, f"{actuator.effort:.4g}", actuator.moves) for actuator in figures.actuators]
    parts += ["actuators", _columns([("", "[N m]", "function"), *rows_of], indent=2)]
    if figures.sensors:
        mounts = [(s.name, s.kind, s.frame, numbers(s.place), f"{s.rate:g} Hz") for s in figures.sensors]
        parts += ["sensors", _columns([("", "kind", "frame", "position [m]", "rate"), *mounts], indent=2)]
    parts.append("warnings" if figures.warnings else "no warnings")
    parts += [f"  {warning}" for warning in figures.warnings]
    return "\n".join(parts)


def draw_links(figures: Inspection) -> str:
    """Return links and joints as an SVG graph: bodies and frames are nodes, joints are arrows.

    Raises:
        MissingDependencyError: Graphviz is not installed.
    """
    return run_dot(write_links_dot(figures), purpose="drawing the links")


def write_links_dot(figures: Inspection) -> str:
    """Return links and joints as a graph in the DOT language."""
    roles = {joint.child: joint.role for joint in figures.joints}
    mounts = {sensor.frame for sensor in figures.sensors}
    lines = [
        "digraph {",
        '  graph [rankdir=LR, nodesep=0.2, ranksep=0.9, fontname="Helvetica", bgcolor="transparent"];',
        '  node [shape=box, style="rounded,filled", fontname="Helvetica", fontsize=12, color="#607d8b"];',
        '  edge [fontname="Helvetica", fontsize=10, color="#607d8b", fontcolor="#37474f", arrowsize=0.7];',
    ]
    for link in figures.links:
        role = roles.get(link.name, "body")
        carries = role.endswith(("steering", "suspension"))
        kind = "wheel" if "wheel" in role else "knuckle" if carries else "body" if link.mass else "frame"
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


def _wheels(figures: Inspection) -> str:
    sizes = [
        f"radius {radius:.4f} m, width {width:.3f} m"
        for radius, width in zip(figures.wheel_radii, figures.wheel_widths, strict=True)
    ]
    return sizes[0] if sizes[0] == sizes[1] else f"front {sizes[0]}; rear {sizes[1]}"


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
        joint.role or "-",
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
