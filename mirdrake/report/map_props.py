"""Props and actors on a map: their outlines, and symbols for what would be too small to be seen."""

from collections.abc import Iterable

import numpy as np
from markupsafe import escape

from mirdrake.report.map_sheet import Box, Palette, Sheet, shape_tag
from mirdrake.worlds import PlacedProp, World

_FACING = {"sedan", "van", "pedestrian", "cyclist"}  # kinds of props with a front
_SMALL = 6.0  # [px] smaller props are dots
_DOT = 3.2  # [px] radius of a dot
_PLAIN_DOT, _PLAIN_PERSON = 1.4, 2.4  # [px] least radius on a map without details

# Pictograms around the position of a person [px], whose outline from above would be a few pixels.
_SYMBOLS = {
    "pedestrian": '<circle cy="-4.6" r="2.4"/><path d="M-3.3 7V.4A2.6 2.6 0 0 1 -.7 -2H.7A2.6 2.6 0 0 1 3.3 .4V7Z"/>',
    "cyclist": '<path d="M-8 3.4a3.2 3.2 0 1 0 6.4 0a3.2 3.2 0 1 0 -6.4 0ZM1.6 3.4a3.2 3.2 0 1 0 6.4 0a3.2 3.2 0 1 0 '
    '-6.4 0Z"/><path d="M-4.8 3.4L-1.8 -3.2L2.6 -.6L4.8 3.4L-.4 3.4Z"/><circle cx="1.4" cy="-5.6" r="2.4"/>',
}
_SYMBOL_BOX = {"pedestrian": (3.5, 7.0), "cyclist": (8.0, 8.0)}  # [px] half of width and height
_SYMBOL_BELOW = 14.0  # [px] longer footprints are drawn as they are


def prop_box(placed: PlacedProp, sheet: Sheet) -> Box:
    """Return the box around what is drawn of a prop: its footprint, its symbol or a dot [px]."""
    x0, y0, x1, y1 = sheet.bounds(placed.footprint)
    x, y, extent = (x0 + x1) / 2.0, (y0 + y1) / 2.0, max(x1 - x0, y1 - y0)
    if placed.prop.name in _SYMBOLS and extent < _SYMBOL_BELOW:
        wide, high = _SYMBOL_BOX[placed.prop.name]
    elif extent < _SMALL:
        wide = high = _DOT
    else:
        return x0, y0, x1, y1
    return x - wide, y - high, x + wide, y + high


def props(world: World, sheet: Sheet, palette: Palette) -> Iterable[str]:
    """Draw props, higher ones on top, small ones as dots and people as symbols."""
    ordered = sorted(world.props, key=lambda placed: placed.top)
    if not palette.detailed:
        yield from _plain_props(ordered, sheet, palette)
        return
    for placed in ordered:
        x, y, _ = placed.X_WP.translation()
        movable = "" if placed.static else ", can be knocked over"
        title = f"{placed.name}: {placed.prop.name} at ({x:.2f}, {y:.2f}) m, {placed.top:.2f} m high{movable}"
        yield from _draw_prop(placed, sheet, palette, title)


def actors(world: World, sheet: Sheet, palette: Palette) -> Iterable[str]:
    """Draw actors at their starts."""
    for full in world.full_actors:
        x, y, yaw = world.actor_start(full)
        title = f"{full.name}: {full.model}, starts at ({x:.2f}, {y:.2f}) m"
        yield shape_tag(
            sheet.path(full.area(x, y, yaw)), palette.vehicle, stroke=palette.paper, title=title, kind="prop"
        )
    for actor in world.actors:
        x, y, yaw = world.actor_start(actor)
        title = f"{actor.name}: {actor.prop.name}, starts at ({x:.2f}, {y:.2f}) m"
        yield from _draw_prop(actor.placed(x, y, yaw), sheet, palette, title)


def _draw_prop(placed: PlacedProp, sheet: Sheet, palette: Palette, title: str) -> Iterable[str]:
    """Draw the outline of a prop, its symbol, or a dot."""
    fill, (x0, y0, x1, y1) = palette.prop(placed), sheet.bounds(placed.footprint)
    x, y, extent = (x0 + x1) / 2.0, (y0 + y1) / 2.0, max(x1 - x0, y1 - y0)
    text = f"<title>{escape(title)}</title>"
    if placed.prop.name in _SYMBOLS and extent < _SYMBOL_BELOW:
        place = f'transform="translate({x:.2f} {y:.2f})" fill="{fill}" stroke="{palette.paper}" stroke-width="0.8"'
        yield f'<g class="prop" {place}>{text}{_SYMBOLS[placed.prop.name]}</g>'
    elif extent < _SMALL:
        place = f'cx="{x:.2f}" cy="{y:.2f}" r="{_DOT}" fill="{fill}" stroke="{palette.edge(fill)}"'
        yield f'<circle class="prop" {place}>{text}</circle>'
    else:
        edge = palette.edge(fill)
        yield shape_tag(sheet.path(placed.footprint), fill, stroke=edge, title=title, kind="prop")
        yield _front(placed, sheet, edge)


def _plain_props(ordered: Iterable[PlacedProp], sheet: Sheet, palette: Palette) -> Iterable[str]:
    """Draw props without tooltips; those of one colour share an element."""
    # A forest is drawn a hundred times in the report of a suite.
    shared: dict[str, list[str]] = {}
    for placed in ordered:
        x0, y0, x1, y1 = sheet.bounds(placed.footprint)
        # Only what is in the picture is written, as a world may have thousands of trees.
        if x1 <= 0.0 or x0 >= sheet.width or y1 <= 0.0 or y0 >= sheet.height:
            continue
        x, y = (x0 + x1) / 2.0, (y0 + y1) / 2.0
        r = max(_PLAIN_PERSON if placed.prop.name in _SYMBOLS else _PLAIN_DOT, (x1 - x0) / 2.0)
        dot = f"M{x - r:.1f} {y:.1f}a{r:.1f} {r:.1f} 0 1 0 {2 * r:.1f} 0a{r:.1f} {r:.1f} 0 1 0 {-2 * r:.1f} 0Z"
        small = max(x1 - x0, y1 - y0) < _SMALL
        shared.setdefault(palette.prop(placed), []).append(dot if small else sheet.path(placed.footprint))
    for fill, paths in shared.items():
        thin = 'stroke-width="0.6"'
        yield shape_tag("".join(paths), fill, stroke=palette.edge(fill), kind="prop", more=thin)


def _front(placed: PlacedProp, sheet: Sheet, color: str) -> str:
    """Draw a triangle at the front of a vehicle or a person."""
    length, width, _ = placed.prop.size
    if placed.prop.name not in _FACING or length * sheet.scale <= 4.0:
        return ""
    triangle = np.array([[0.5, 0.0, 0.0], [0.32, 0.42, 0.0], [0.32, -0.42, 0.0]]) * [length, width, 0.0]
    points = [(placed.X_WP @ point)[:2] for point in triangle]
    return f'<path d="{sheet.line(points, closed=True)}" fill="{color}" fill-opacity="0.75"/>'
