"""A world from above as SVG: the one drawer of the plan of a world and of the maps in reports.

::

    World, Sheet, Palette ── draw_world ──► elements of SVG, layer by layer

    surfaces, signals, starts, overlaps          of the world; here
    props, actors                                of the world; map_props.py
    driven lines, vehicles, marked places        of a run; drive_layers.py
    frame, grid, names, key                      of a plan that is a file of its own; plan.py

A layer is a function of the world, the sheet and the palette that returns elements. The first layers are below.
"""

import math
from collections.abc import Callable, Iterable, Sequence

import numpy as np
from markupsafe import Markup, escape
from shapely.geometry.base import BaseGeometry

from mirdrake.report.map_sheet import Box, Palette, Sheet, friction_label, line_tag, shape_tag, text_tag
from mirdrake.worlds import World
from mirdrake.worlds.drawing import DrawnArea, DrawnLine, make_drawing

Overlap = tuple[str, str, BaseGeometry]
"""Names of two props, and the area that both cover, seen from above [m]."""

Layer = Callable[[World, Sheet, Palette], Iterable[str]]
"""Returns elements of SVG."""

_SURFACES = {"ground", "verge", "network", "road", "patch", "goal"}
_SIGNAL_SHAPES = {
    "lights": '<rect x="-3.5" y="-9" width="7" height="18" rx="2" fill="#1f2937"/><circle cy="-5.5" r="2.2" '
    'fill="#ef4444"/><circle r="2.2" fill="#f59e0b"/><circle cy="5.5" r="2.2" fill="#22c55e"/>',
    "stop": '<path d="M-2.5 -6h5L6 -2.5v5L2.5 6h-5L-6 2.5v-5Z" fill="#dc2626" stroke="#fff"/>',
    "yield": '<path d="M-6 -5H6L0 5.5Z" fill="#fff" stroke="#dc2626" stroke-width="2"/>',
}


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
    # The tolerance keeps a power of ten from falling to the step below it.
    return next(step * power for step in (5.0, 2.0, 1.0) if step * power <= value * (1.0 + 1e-9))


# --- layers of the world -----------------------------------------------------------------------------------------


def surfaces(world: World, sheet: Sheet, palette: Palette) -> Iterable[str]:
    """Draw the ground, verges, tracks with their markings, patches of friction, and goals."""
    drawing = make_drawing(world)
    # A palette without details is for small pictures, in which only roads and goals can be recognised.
    for area in drawing.areas:
        data = sheet.path(area.area) if area.layer in _SURFACES else ""
        if not data or (area.layer in {"ground", "verge"} and not palette.detailed):
            continue
        title = _surface_title(world, area) if palette.detailed else ""
        if area.layer == "goal":
            dashed = 'fill-opacity="0.16" stroke-dasharray="5 3"'
            yield shape_tag(data, palette.goal, stroke=palette.goal, title=title, kind="goal", more=dashed)
        elif area.layer == "patch":
            fill, dashed = palette.patch(area.surface), 'fill-opacity="0.8" stroke-dasharray="6 4"'
            yield shape_tag(data, fill, stroke=palette.edge(fill), title=title, kind="patch", more=dashed)
        elif area.layer in {"network", "road"}:
            fill = palette.road(area.surface or "")
            edge = "#8d949d" if palette.detailed else palette.edge(fill)
            yield shape_tag(data, fill, stroke=edge, title=title, kind="road")
            # Markings follow their road immediately, so that a later road covers them at a crossing.
            for line in drawing.lines:
                if line.layer == "marking" and line.name == area.name:
                    yield _marking(line, sheet, palette)
        else:
            stroke = "#cbd0d6" if area.layer == "ground" else None
            yield shape_tag(data, palette.ground(area.surface or ""), stroke=stroke)
    for line in drawing.lines:
        if line.layer == "gate":
            yield line_tag(sheet.polyline(line.points), palette.goal, 4.0, more='class="goal"')


def _surface_title(world: World, area: DrawnArea) -> str:
    """Return the tooltip of a track, patch or goal; none of the ground."""
    if area.layer == "network":
        return f"{area.name}: {area.surface}, μ {area.mu:g}"
    if area.layer == "road":
        track = world.tracks[area.name]
        # A road with edges of its own has no constant width.
        prefix = "" if track.edges is None else "up to "
        size = f"{track.length:.1f} m, {prefix}{track.width:.4g} m wide"
        return f"track {area.name}: {size}, {area.surface}, μ {area.mu:g}"
    if area.layer == "patch" and area.mu is not None:
        return f"patch {friction_label(area.name, area.surface, area.mu)}"
    return f"goal {area.name}" if area.layer == "goal" else ""


def _marking(line: DrawnLine, sheet: Sheet, palette: Palette) -> str:
    """Draw a painted line of a track."""
    dash = ""
    if line.dash is not None:
        dash = f'stroke-dasharray="{line.dash[0] * sheet.scale:.1f} {line.dash[1] * sheet.scale:.1f}"'
    # A line of true width would be invisible from far above; a start line is a line of two points.
    width = max(line.width * sheet.scale, 1.6 if len(line.points) == 2 else 0.7)
    return line_tag(sheet.polyline(line.points), palette.marking, round(width, 2), more=dash)


def signals(world: World, sheet: Sheet, _: Palette) -> Iterable[str]:
    """Draw traffic lights and signs of the network."""
    for signal in make_drawing(world).signals:
        x, y = sheet.place([[signal.x, signal.y]])[0].tolist()
        title = f"<title>{escape(signal.kind)} {escape(signal.name)}</title>"
        yield f'<g class="signal" transform="translate({x:.2f} {y:.2f})">{title}{_SIGNAL_SHAPES[signal.kind]}</g>'


def overlap_areas(overlaps: Sequence[Overlap]) -> Layer:
    """Return a layer of areas that two props cover, with a circle around small ones."""

    def draw(_: World, sheet: Sheet, palette: Palette) -> Iterable[str]:
        for a, b, area in overlaps:
            dense = 'fill-opacity="0.75" stroke-width="1.5"'
            title = f"{a} and {b} overlap"
            data = sheet.path(area)
            yield shape_tag(data, palette.alarm, stroke="#991b1b", title=title, kind="overlap", more=dense)
            x0, y0, x1, y1 = sheet.bounds(area)
            # Overlaps of a few pixels would be missed without a circle.
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
    # Rotation by the heading with y downwards: (x, y) -> (x c + y s, -x s + y c).
    return np.asarray(sheet.place([[start.x, start.y]]) + outline @ np.array([[c, -s], [s, c]]))


def starts(world: World, sheet: Sheet, palette: Palette) -> Iterable[str]:
    """Draw an arrow at each start."""
    for name, start in world.starts.items():
        points = start_arrow(world, name, sheet)
        title = f"start {name} at ({start.x:.2f}, {start.y:.2f}) m, {math.degrees(start.yaw):.1f}°"
        data = "M" + "L".join(f"{x:.2f} {y:.2f}" for x, y in points) + "Z"
        yield shape_tag(data, palette.start, stroke=palette.paper, title=title, kind="start")


def scale_bar_box(sheet: Sheet) -> Box:
    """Return the part of the picture in which the scale bar is [px]."""
    return sheet.left, sheet.bottom - 34.0, sheet.left + 28.0 + sheet.width / 6.0, sheet.bottom


def scale_bar(_: World, sheet: Sheet, palette: Palette) -> Iterable[str]:
    """Draw a bar of a round length, at most a sixth of the picture, at the bottom left."""
    length = round_down(sheet.width / 6.0 / sheet.scale)
    x, y = sheet.left + 14.0, sheet.bottom - 12.0
    yield line_tag(f"M{x:.1f} {y:.1f}h{length * sheet.scale:.1f}", palette.ink, 2.0)
    yield text_tag(x, y - 6.0, f"{length:g} m", color=palette.ink)
