"""A world from above as SVG: the one drawer of the plan of a world and of the maps in reports.

::

    World, Sheet, Palette ── draw_world ──► elements of SVG, layer by layer

    surfaces, goals, props, starts, overlaps     of the world; here
    driven lines, vehicles, marked places        of a run; drive_layers.py
    frame, grid, names, key                      of a plan that is a file of its own; plan.py

A layer is a function of the world, the sheet and the palette that returns elements. The first layers are below.
"""

import math
from collections.abc import Callable, Iterable, Sequence

import numpy as np
import shapely
from markupsafe import Markup, escape
from shapely.geometry.base import BaseGeometry

from mirdrake.report.map_sheet import Palette, Sheet, friction_label, line_tag, shape_tag, text_tag
from mirdrake.worlds import PlacedProp, World
from mirdrake.worlds.spec import MarkingSpec
from mirdrake.worlds.tracks import Track
from mirdrake.worlds.world import track_mu, verge

Overlap = tuple[str, str, BaseGeometry]
"""Names of two props, and the area that both cover, seen from above [m]."""

Layer = Callable[[World, Sheet, Palette], Iterable[str]]
"""Returns elements of SVG."""

_FACING = {"sedan", "van", "pedestrian"}  # kinds of props with a front
_SMALL = 6.0  # [px] smaller props are dots


def draw_world(world: World, sheet: Sheet, palette: Palette, layers: Sequence[Layer]) -> str:
    """Return layers of a world from above as elements of SVG, the first one below."""
    return "\n".join(element for layer in layers for element in layer(world, sheet, palette) if element)


def draw_figure(
    world: World, sheet: Sheet, palette: Palette, layers: Sequence[Layer], *, kind: str, description: str
) -> Markup:
    """Return layers of a world as one figure of a page, with a scale bar.

    Args:
        world: the world.
        sheet: the region and the size of the figure.
        palette: its colours.
        layers: the first one is below.
        kind: classes of the SVG element.
        description: text for readers who cannot see the picture.
    """
    body = draw_world(world, sheet, palette, [*layers, scale_bar])
    return Markup(
        f'<svg class="{kind}" viewBox="0 0 {sheet.width:.0f} {sheet.height:.0f}" role="img" '
        f'aria-label="{escape(description)}">{body}</svg>'
    )


def round_down(value: float) -> float:
    """Return the largest of 1, 2, 5, 10, 20, 50, … that is not above a positive value."""
    power = 10.0 ** math.floor(math.log10(value))
    return next(step * power for step in (5.0, 2.0, 1.0) if step * power <= value * (1.0 + 1e-9))


# --- layers of the world -----------------------------------------------------------------------------------------


def surfaces(world: World, sheet: Sheet, palette: Palette) -> Iterable[str]:
    """Draw the ground, the verges, the tracks with their markings, and patches of friction."""
    if palette.detailed:
        fill = palette.ground(world.ground.surface)
        yield shape_tag(sheet.path(shapely.box(*world.ground.extent)), fill, stroke="#cbd0d6")
    roads = world.roads()
    for name, track in roads.items():
        edges = world.spec.tracks[name].verge
        if palette.detailed and edges is not None and edges != world.ground.surface:
            yield shape_tag(sheet.path(verge(track)), palette.ground(edges))
    for name, track in roads.items():
        spec = world.spec.tracks[name]
        most = "" if track.edges is None else "up to "
        size = f"{track.length:.1f} m, {most}{track.width:.4g} m wide"
        title = f"track {name}: {size}, {spec.surface}, μ {track_mu(spec):g}" if palette.detailed else ""
        fill = palette.road(spec.surface)
        edge = "#8d949d" if palette.detailed else palette.edge(fill)
        yield shape_tag(sheet.path(track.area), fill, stroke=edge, title=title, kind="road")
        for marking in spec.markings:
            yield _marking(track, marking, sheet, palette)
    for patch in world.patches:
        fill = palette.patch(patch.surface)
        title = f"patch {friction_label(patch.name, patch.surface, patch.mu)}" if palette.detailed else ""
        dashed = 'fill-opacity="0.8" stroke-dasharray="6 4"'
        yield shape_tag(sheet.path(patch.area), fill, stroke=palette.edge(fill), title=title, kind="patch", more=dashed)


def _marking(track: Track, marking: MarkingSpec, sheet: Sheet, palette: Palette) -> str:
    """Draw a painted line of a track."""
    inset = 0.05 + marking.width / 2.0
    s = np.zeros(1) if marking.line == "start" else np.append(track.stations(), track.length)
    left, right = track.left_width(s) - inset, inset - track.right_width(s)
    if marking.line == "start":
        points = np.array(track.point(0.0, np.append(right, left))).T
    else:
        offset = {"left": left, "right": right, "center": np.zeros_like(s)}[marking.line]
        points = np.array(track.point(s, offset)).T
    dash = ""
    if marking.kind == "dashed":
        dash = f'stroke-dasharray="{marking.dash[0] * sheet.scale:.1f} {marking.dash[1] * sheet.scale:.1f}"'
    # A line of true width would be invisible from far above.
    width = max(marking.width * sheet.scale, 1.6 if marking.line == "start" else 0.7)
    return line_tag(sheet.polyline(points), palette.marking, round(width, 2), more=dash)


def goals(world: World, sheet: Sheet, palette: Palette) -> Iterable[str]:
    """Draw goals: areas, and gates across tracks."""
    for name, goal in world.goals.items():
        title = f"goal {name}" if palette.detailed else ""
        if goal.area is not None:
            dashed = 'fill-opacity="0.16" stroke-dasharray="5 3"'
            color = palette.goal
            yield shape_tag(sheet.path(goal.area), color, stroke=color, title=title, kind="goal", more=dashed)
        elif goal.gate is not None:
            ends = gate_ends(world, goal.gate)
            yield line_tag(sheet.polyline(ends), palette.goal, 4.0, more='class="goal"')


def gate_ends(world: World, gate: tuple[str, float]) -> np.ndarray:
    """Return the ends (2, 2) of a gate in W [m], half a metre beyond the edges of its track."""
    track = world.tracks[gate[0]]
    right, left = float(track.right_width(gate[1])) + 0.5, float(track.left_width(gate[1])) + 0.5
    return np.array(track.point([gate[1]] * 2, [-right, left])).T


def props(world: World, sheet: Sheet, palette: Palette) -> Iterable[str]:
    """Draw props, higher ones on top, small ones as dots."""
    # Props of one colour share an element where none needs a tooltip: a forest is drawn a hundred times in a suite.
    shared: dict[str, list[str]] = {}
    for placed in sorted(world.props, key=lambda placed: placed.top):
        fill = palette.prop(placed)
        x0, y0, x1, y1 = sheet.bounds(placed.footprint)
        small = max(x1 - x0, y1 - y0) < _SMALL
        x, y = (x0 + x1) / 2.0, (y0 + y1) / 2.0
        if not palette.detailed:
            radius = max(1.4, (x1 - x0) / 2.0)
            dot = f"M{x - radius:.1f} {y:.1f}a{radius:.1f} {radius:.1f} 0 1 0 {2 * radius:.1f} 0a{radius:.1f} "
            dot += f"{radius:.1f} 0 1 0 {-2 * radius:.1f} 0Z"
            visible = x1 > 0.0 and x0 < sheet.width and y1 > 0.0 and y0 < sheet.height
            if visible:
                shared.setdefault(fill, []).append(dot if small else sheet.path(placed.footprint))
        elif small:
            yield (
                f'<circle class="prop" cx="{x:.2f}" cy="{y:.2f}" r="3.2" fill="{fill}" stroke="{palette.edge(fill)}">'
                f"<title>{escape(_prop_title(placed))}</title></circle>"
            )
        else:
            edge, title = palette.edge(fill), _prop_title(placed)
            yield shape_tag(sheet.path(placed.footprint), fill, stroke=edge, title=title, kind="prop")
            yield _front(placed, sheet, edge)
    for fill, paths in shared.items():
        thin = 'stroke-width="0.6"'
        yield shape_tag("".join(paths), fill, stroke=palette.edge(fill), kind="prop", more=thin)


def _prop_title(placed: PlacedProp) -> str:
    x, y, _ = placed.X_WP.translation()
    movable = "" if placed.static else ", can be knocked over"
    return f"{placed.name}: {placed.prop.name} at ({x:.2f}, {y:.2f}) m, {placed.top:.2f} m high{movable}"


def _front(placed: PlacedProp, sheet: Sheet, color: str) -> str:
    """Draw a triangle at the front of a vehicle or a pedestrian."""
    length, width, _ = placed.prop.size
    if placed.prop.name not in _FACING or length * sheet.scale <= 4.0:
        return ""
    triangle = np.array([[0.5, 0.0, 0.0], [0.32, 0.42, 0.0], [0.32, -0.42, 0.0]]) * [length, width, 0.0]
    points = [(placed.X_WP @ point)[:2] for point in triangle]
    return f'<path d="{sheet.line(points, closed=True)}" fill="{color}" fill-opacity="0.75"/>'


def overlap_areas(overlaps: Sequence[Overlap]) -> Layer:
    """Return a layer of areas that two props cover, with a circle around small ones."""

    def draw(_: World, sheet: Sheet, palette: Palette) -> Iterable[str]:
        for a, b, area in overlaps:
            dense = 'fill-opacity="0.75" stroke-width="1.5"'
            title = f"{a} and {b} overlap"
            data = sheet.path(area)
            yield shape_tag(data, palette.alarm, stroke="#991b1b", title=title, kind="overlap", more=dense)
            x0, y0, x1, y1 = sheet.bounds(area)
            if max(x1 - x0, y1 - y0) < 12.0:
                x, y = (x0 + x1) / 2.0, (y0 + y1) / 2.0
                circle = f'<circle cx="{x:.2f}" cy="{y:.2f}" r="11" fill="none"'
                yield f'{circle} stroke="{palette.alarm}" stroke-width="2"/>'

    return draw


def start_arrow(world: World, name: str, sheet: Sheet) -> np.ndarray:
    """Return the outline (7, 2) of the arrow of a start in the picture [px]; it begins at the vehicle's origin."""
    start = world.starts[name]
    outline = np.array([[0.0, 3.5], [14.0, 3.5], [14.0, 9.0], [28.0, 0.0], [14.0, -9.0], [14.0, -3.5], [0.0, -3.5]])
    c, s = math.cos(start.yaw), math.sin(start.yaw)
    return np.asarray(sheet.place([[start.x, start.y]]) + outline @ np.array([[c, -s], [s, c]]))


def starts(world: World, sheet: Sheet, palette: Palette) -> Iterable[str]:
    """Draw an arrow at each start."""
    for name, start in world.starts.items():
        points = start_arrow(world, name, sheet)
        title = f"start {name} at ({start.x:.2f}, {start.y:.2f}) m, {math.degrees(start.yaw):.1f}°"
        data = "M" + "L".join(f"{x:.2f} {y:.2f}" for x, y in points) + "Z"
        yield shape_tag(data, palette.start, stroke=palette.paper, title=title, kind="start")


def scale_bar(_: World, sheet: Sheet, palette: Palette) -> Iterable[str]:
    """Draw a bar of a round length, at most a sixth of the picture, at the bottom left."""
    length = round_down(sheet.width / 6.0 / sheet.scale)
    x, y = sheet.left + 14.0, sheet.bottom - 12.0
    yield line_tag(f"M{x:.1f} {y:.1f}h{length * sheet.scale:.1f}", palette.ink, 2.0)
    yield text_tag(x, y - 6.0, f"{length:g} m", color=palette.ink)
