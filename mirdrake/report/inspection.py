"""The inspection report: the vehicle to scale, its figures, findings, links and joints."""

import io
import math
from collections.abc import Sequence

from markupsafe import Markup

from mirdrake.core.errors import MissingDependencyError
from mirdrake.core.wording import plural
from mirdrake.report.inspection_text import axis_name, describe_view, draw_links, figure_rows, limits_of
from mirdrake.report.page import Tile, render_page
from mirdrake.report.surfaces import collect_surfaces
from mirdrake.report.svg import embed_graph
from mirdrake.report.vehicle_drawing import draw_lock, draw_side, draw_top
from mirdrake.report.words import title_case
from mirdrake.vehicles import Vehicle
from mirdrake.vehicles.figures import Inspection
from mirdrake.viewer.pages import data_address
from mirdrake.viewer.portrait import try_portrait

_TEMPLATE = "inspection.html.jinja"
_GRADES = {
    "A": "data measured on the vehicle",
    "B": "published data, the rest assumed",
    "C": "mostly assumed data",
}


def render_inspection(figures: Inspection, vehicle: Vehicle, *, portrait: bool = True) -> str:
    """Return the report as one HTML page.

    Args:
        figures: figures of the vehicle.
        vehicle: vehicle whose shapes are drawn.
        portrait: begin with a rendered picture, if there is a renderer.
    """
    # The shapes are drawn twice: what is seen, and what collides.
    seen, solid = collect_surfaces(vehicle), collect_surfaces(vehicle, collision=True)
    inner, outer = figures.steering_limits
    # Ackermann angles at full lock, for the picture of the turning circle.
    turned = collect_surfaces(vehicle, steering=(inner, outer))
    turned_solid = collect_surfaces(vehicle, collision=True, steering=(inner, outer))
    wheels = {joint.child for joint in figures.joints if joint.role.is_wheel}
    graph, graph_note = _graph(figures)
    return render_page(
        _TEMPLATE,
        filters={"figure": _figure, "axis": axis_name, "limits": limits_of, "title_case": title_case},
        title=f"{figures.title} · inspection",
        over=f"{figures.vehicle} · inspection report",
        headline=_headline(figures),
        figures=figures,
        grade=_GRADES[figures.grade],
        portrait=_portrait(vehicle) if portrait else None,
        tiles=_tiles(figures),
        side=Markup(draw_side(figures, seen, solid)),
        top=Markup(draw_top(figures, seen, solid)),
        lock=Markup(draw_lock(figures, turned or turned_solid, [part for part in turned_solid if part.link in wheels])),
        looks=any(sensor.across for sensor in figures.sensors),
        views=[describe_view(sensor) for sensor in figures.sensors],
        facts=_facts(figures),
        massive=[link for link in figures.links if link.mass],
        movable=[joint for joint in figures.joints if joint.kind != "fixed"],
        graph=graph,
        graph_note=graph_note,
    )


def _headline(figures: Inspection) -> str:
    """Return the result: mass, wheelbase, and the number of findings."""
    count = len(figures.warnings)
    findings = plural(count, "finding") if count else "no findings"
    return f"{figures.title}: {_figure(figures.mass)} kg, wheelbase {figures.wheelbase:.3f} m, {findings}"


def _tiles(figures: Inspection) -> list[Tile]:
    """Return the most important figures."""
    front, rear = (100.0 * share for share in (figures.front_share, 1.0 - figures.front_share))
    # Without collision shapes of the body there is no clearance.
    clearance = figures.ground_clearance
    return [
        Tile("Mass", f"{_figure(figures.mass)} kg", f"{front:.0f} % on the front axle, {rear:.0f} % on the rear"),
        Tile("Wheelbase", f"{figures.wheelbase:.3f} m", _track(figures)),
        Tile("Turning circle", f"{figures.turning_circle:.2f} m", "kerb to kerb, diameter"),
        Tile("Height of centre of mass", f"{figures.com[2]:.3f} m", "above the road"),
        Tile("Rollover threshold", f"{figures.static_stability:.2f} g", "T / 2h, on rigid tyres"),
        Tile("Yaw inertia", f"{_figure(figures.inertia[2])} kg m²", f"dynamic index {figures.dynamic_index:.2f}"),
        Tile("Wheel radius", f"{figures.wheel_radii[0]:.4g} m", _rear_radius(figures)),
        Tile("Ground clearance", f"{clearance:.3f} m" if math.isfinite(clearance) else "–", "of the collision shapes"),
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
    """Return the figures without a tile: name, value, and formula or meaning."""
    tiles = {"Mass", "Wheelbase", "Turning circle", "Rollover threshold", "Wheel radii", "Ground clearance"}
    return [row for row in figure_rows(figures) if row[0] not in tiles]


def _portrait(vehicle: Vehicle) -> str | None:
    """Return a rendered picture as a ``data:`` address; None without a renderer."""
    picture = try_portrait(vehicle, width=1032, height=516)
    if picture is None:
        return None
    file = io.BytesIO()
    picture.save(file, "JPEG", quality=88, optimize=True)
    return data_address(file.getvalue(), "image/jpeg")


def _graph(figures: Inspection) -> tuple[Markup | None, str]:
    """Return the graph of links and joints, or the reason why there is none."""
    try:
        return Markup(embed_graph(draw_links(figures), "links-", "Links, and the joints between them")), ""
    except MissingDependencyError as error:
        return None, str(error)


def _figure(value: float | Sequence[float] | None) -> str:
    """Return a number with four significant digits."""
    if value is None or isinstance(value, Sequence) or not math.isfinite(value):
        return "–"
    return f"{value:,.0f}".replace(",", "\u202f") if abs(value) >= 1000.0 else f"{value:.4g}".replace("-", "−")
