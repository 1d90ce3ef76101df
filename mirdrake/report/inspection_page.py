"""An inspection as one HTML page: the vehicle to scale, its figures, what looks wrong, its links and joints."""

import base64
import io
import math
from collections.abc import Sequence
from typing import Any

from markupsafe import Markup

from mirdrake.core.errors import MissingDependencyError
from mirdrake.report.inspection import axis_name, draw_links, limits_of
from mirdrake.report.page import render_page
from mirdrake.report.surfaces import collect_surfaces
from mirdrake.report.svg import embed_svg, svg_size
from mirdrake.report.vehicle_drawing import draw_lock, draw_side, draw_top
from mirdrake.report.words import title_case
from mirdrake.vehicles import Vehicle
from mirdrake.vehicles.figures import Inspection, SensorFigures
from mirdrake.viewer.portrait import try_portrait

_TEMPLATE = "inspection.html.jinja"
_GRADES = {
    "A": "data measured on the vehicle",
    "B": "published data, the rest assumed",
    "C": "mostly assumed data",
}


def render_inspection(figures: Inspection, vehicle: Vehicle, *, portrait: bool = True) -> str:
    """The text of the page; see :func:`mirdrake.report.inspection.write_inspection`."""
    seen, solid = collect_surfaces(vehicle), collect_surfaces(vehicle, collision=True)
    inner, outer = figures.steering_limits
    turned = collect_surfaces(vehicle, steering=(inner, outer))
    turned_solid = collect_surfaces(vehicle, collision=True, steering=(inner, outer))
    wheels = {joint.child for joint in figures.joints if "wheel" in joint.role}
    graph, graph_note = _graph(figures)
    return render_page(
        _TEMPLATE,
        filters={"figure": _figure, "axis": axis_name, "limits": limits_of, "title_case": title_case},
        figures=figures,
        grade=_GRADES[figures.grade],
        portrait=_portrait(vehicle) if portrait else None,
        tiles=_tiles(figures),
        side=Markup(draw_side(figures, seen, solid)),
        top=Markup(draw_top(figures, seen, solid)),
        lock=Markup(draw_lock(figures, turned or turned_solid, [part for part in turned_solid if part.link in wheels])),
        looks=any(sensor.across for sensor in figures.sensors),
        views=[_view(sensor) for sensor in figures.sensors],
        facts=_facts(figures),
        massive=[link for link in figures.links if link.mass],
        movable=[joint for joint in figures.joints if joint.kind != "fixed"],
        graph=graph,
        graph_note=graph_note,
    )


def _tiles(figures: Inspection) -> list[tuple[str, str, str]]:
    """What a person wants to know first: a name, a value, a word on it."""
    front, rear = (100.0 * share for share in (figures.front_share, 1.0 - figures.front_share))
    return [
        ("Mass", f"{_figure(figures.mass)} kg", f"{front:.0f} % on the front axle, {rear:.0f} % on the rear"),
        ("Wheelbase", f"{figures.wheelbase:.3f} m", _track(figures)),
        ("Turning circle", f"{figures.turning_circle:.2f} m", "kerb to kerb, diameter"),
        ("Centre of mass", f"{figures.com[2]:.3f} m", "above the road"),
        ("Tips at", f"{figures.static_stability:.2f} g", "sideways, on rigid tyres: T / 2h"),
        ("Yaw inertia", f"{_figure(figures.inertia[2])} kg m²", f"dynamic index {figures.dynamic_index:.2f}"),
        ("Wheel radius", f"{figures.wheel_radii[0]:.4g} m", _rear_radius(figures)),
        (
            "Ground clearance",
            f"{figures.ground_clearance:.3f} m" if math.isfinite(figures.ground_clearance) else "–",
            "of the collision shapes",
        ),
    ]


def _track(figures: Inspection) -> str:
    front, rear = figures.tracks
    return (
        f"track {front:.3f} m" if math.isclose(front, rear, abs_tol=5e-4) else f"track {front:.3f}, rear {rear:.3f} m"
    )


def _rear_radius(figures: Inspection) -> str:
    front, rear = figures.wheel_radii
    return "all four" if math.isclose(front, rear, abs_tol=1e-6) else f"front; rear {rear:.4g} m"


def _facts(figures: Inspection) -> list[tuple[str, str, str]]:
    """The rest of the figures: name, value, formula or meaning."""
    inner, outer = (math.degrees(angle) for angle in figures.steering_limits)
    inertia = ", ".join(map(_figure, figures.inertia))
    size = "{:.3f} × {:.3f} × {:.3f} m".format
    lock = "rear axle's centre: L / tan(inner) + kingpin track / 2"
    rows = [
        (
            "Centre of mass",
            "{:.3f}, {:.3f}, {:.3f} m".format(*(round(value, 3) + 0.0 for value in figures.com)),
            "ahead of the rear axle, left, up",
        ),
        ("Axle loads at rest", " and ".join(f"{_figure(load)} N" for load in figures.loads), "front, rear"),
        ("Load on the left", f"{100.0 * figures.side_share:.1f} %", "of the whole"),
        ("Tracks", "{:.3f}, {:.3f} m".format(*figures.tracks), "front, rear; between contact centres"),
        ("Between the steering axes", f"{figures.kingpin_track:.3f} m", "on the road"),
        ("Wheel widths", "{:.3f}, {:.3f} m".format(*figures.wheel_widths), "front, rear; of the collision shapes"),
        ("Size for contact", size(*figures.size), "length, width, height over the road"),
        ("Size to the eye", size(*(figures.visual_size or figures.size)), "mirrors and antennas count"),
        (
            "Wheels at full lock",
            f"{inner:.1f}°, {outer:.1f}°",
            "inner, outer: cot(outer) = cot(inner) + kingpin track / L",
        ),
        ("Turning radius", f"{figures.turning_radius:.2f} m", lock),
        ("Wall to wall", f"{figures.wall_circle:.2f} m", "diameter of the outermost corner of the collision shapes"),
        ("Inertia", f"{inertia} kg m²", "roll, pitch, yaw about the centre of mass"),
        ("Radii of gyration", "{:.3f}, {:.3f}, {:.3f} m".format(*figures.gyration), "roll, pitch, yaw: √(I / m)"),
        ("Dynamic index", f"{figures.dynamic_index:.2f}", "k² / (a b) of the yaw inertia; cars have 0.8 to 1.1"),
    ]
    return rows if figures.visual_size else [row for row in rows if row[0] != "Size to the eye"]


def _view(sensor: SensorFigures) -> str:
    """What a sensor sees, in words."""
    if not sensor.across:
        return "–"
    across = math.degrees(sensor.across[1] - sensor.across[0])
    upward = math.degrees(sensor.upward[1] - sensor.upward[0])
    high = f" × {upward:.0f}°" if upward else ""
    return f"{across:.0f}°{high}, {sensor.reach[0]:g} to {sensor.reach[1]:g} m"


def _portrait(vehicle: Vehicle) -> str | None:
    """A rendered picture as a ``data:`` address, None where there is nothing to render with."""
    picture = try_portrait(vehicle, width=1032, height=516)
    if picture is None:
        return None
    file = io.BytesIO()
    picture.save(file, "JPEG", quality=88, optimize=True)
    return "data:image/jpeg;base64," + base64.b64encode(file.getvalue()).decode("ascii")


def _graph(figures: Inspection) -> tuple[Markup | None, str]:
    """The picture of links and joints, or why there is none."""
    try:
        text = draw_links(figures)
    except MissingDependencyError as error:
        return None, str(error)
    size = svg_size(text)
    attributes: dict[str, Any] = {"role": "img", "aria-label": "Links, and the joints between them"}
    if size:
        attributes["style"] = f"width:{max(320.0, min(size[0], 4000.0)):.0f}px"
    return Markup(embed_svg(text, "links-", attributes=attributes, decimals=2, scope=".diagram")), ""


def _figure(value: float | Sequence[float] | None) -> str:
    """A number to four significant digits."""
    if value is None or isinstance(value, Sequence) or not math.isfinite(value):
        return "–"
    return f"{value:,.0f}".replace(",", "\u202f") if abs(value) >= 1000.0 else f"{value:.4g}".replace("-", "−")
