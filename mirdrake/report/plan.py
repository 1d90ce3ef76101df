"""A world from above as an SVG picture: ground, friction, roads, props and their names, starts, goals, overlaps.

x goes to the right and y up. The element with the class ``map`` tells how a point of W becomes one of the picture:
``data-left + (x - data-x) · data-scale`` and ``data-bottom - (y - data-y) · data-scale``.

::

    World ── Sheet ──► metres to pixels, elements    plan_sheet.py
    draw_world ──► ground, props, starts, scale      here
    Names ──► names that do not lie on each other    plan_labels.py
    make_key ──► rows at the right side              plan_key.py
"""

import math
from collections.abc import Sequence

import numpy as np
import shapely
from markupsafe import escape

from mirdrake.report.plan_key import ROW, Overlap, make_key
from mirdrake.report.plan_labels import Names, name_patches, name_props, name_tracks
from mirdrake.report.plan_sheet import (
    BLUE,
    BOTTOM,
    GREEN,
    GROUND,
    INK,
    LEAST,
    LEFT,
    MUTED,
    PLAIN,
    RED,
    ROAD,
    SIDE,
    Array,
    Sheet,
    darker,
    fill_of,
    friction_of,
    shape_tag,
    text_tag,
)
from mirdrake.report.track_map import round_down
from mirdrake.worlds import World
from mirdrake.worlds.world import track_mu, verge

__all__ = ["Overlap", "draw_world", "find_overlaps"]

_FACING = {"sedan", "van", "pedestrian"}  # kinds whose front is shown
_FONT = "Helvetica, Arial, 'Liberation Sans', 'DejaVu Sans', sans-serif"


def find_overlaps(world: World) -> list[Overlap]:
    """Props that overlap seen from above and in height, as far as no rule allows it; less than 1 cm² is none."""
    props = world.props
    tree = shapely.STRtree([placed.footprint for placed in props])
    found: list[Overlap] = []
    pairs = tree.query([placed.footprint for placed in props], predicate="intersects").T.tolist() if props else []
    for i, j in sorted(pairs):
        a, b = props[i], props[j]
        if i >= j or min(a.top, b.top) - max(a.bottom, b.bottom) < 1e-3:
            continue
        area = a.footprint.intersection(b.footprint)
        if area.area > 1e-4 and not (world.rules is not None and world.rules.may_overlap(a, b)):
            found.append((a.name, b.name, area))
    return found


def draw_world(world: World, *, overlaps: Sequence[Overlap] = (), width: float = 1200.0) -> str:
    """A world from above as an SVG document.

    Args:
        world: the world.
        overlaps: where props are in each other; drawn in red.
        width: of the picture [px]; a narrow world makes it narrower.
    """
    sheet = Sheet(world, max(width, LEFT + LEAST + SIDE))
    names = Names(sheet)
    body = [_draw_ground(sheet, world), _draw_grid(sheet), _draw_goals(sheet, world, names)]
    body += [_draw_props(sheet, world), _draw_overlaps(sheet, overlaps, names), _draw_starts(sheet, world, names)]
    bar, ticks = _draw_scale(sheet, names), _draw_ticks(sheet)
    for placed in world.props:
        names.block(sheet.bounds(placed.footprint))
    name_patches(sheet, world, names)
    for track in world.roads().values():
        s = np.arange(0.0, track.length, max(6.0 / sheet.scale, track.length / 2000.0))
        names.avoid(sheet.place(np.column_stack(track.point(s))), track.width / 2.0 * sheet.scale)
    name_tracks(sheet, world, names)
    name_props(sheet, world, names)
    rows = make_key(world, overlaps)
    right = sheet.left + sheet.width + 26.0
    height = max(sheet.bottom + BOTTOM, sheet.top + ROW * len(rows) + 10.0)
    total = sheet.left + sheet.width + SIDE
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {total:.0f} {height:.0f}" width="{total:.0f}" '
        f'height="{height:.0f}" font-family="{_FONT}" role="img" aria-label="{escape(world.name)} from above">'
    )
    frame = f'x="{sheet.left:.2f}" y="{sheet.top:.2f}" width="{sheet.width:.2f}" height="{sheet.height:.2f}"'
    return "\n".join([
        head,
        f'<rect width="{total:.0f}" height="{height:.0f}" fill="#ffffff"/>',
        f'<clipPath id="frame"><rect {frame}/></clipPath>',
        text_tag(sheet.left, 30.0, world.name, size=22.0, weight=700),
        text_tag(sheet.left, 51.0, _about(world), size=13.0, color=MUTED),
        f'<g class="map" clip-path="url(#frame)" data-x="{sheet.x:.4f}" data-y="{sheet.y:.4f}" '
        f'data-scale="{sheet.scale:.6f}" data-left="{sheet.left:.2f}" data-bottom="{sheet.bottom:.2f}">',
        *body, *names.written, bar,
        "</g>",
        f'<rect {frame} fill="none" stroke="#9ca3af"/>',
        ticks,
        *(row.format(x=right, x2=right + 24.0, y=sheet.top + ROW * i, ym=sheet.top + ROW * i + 10.0)
          for i, row in enumerate(rows)),
        "</svg>\n",
    ])  # fmt: skip


# --- what is drawn -----------------------------------------------------------------------------------------------


def _draw_ground(sheet: Sheet, world: World) -> str:
    parts = [
        f'<rect x="{sheet.left:.2f}" y="{sheet.top:.2f}" width="{sheet.width:.2f}" height="{sheet.height:.2f}" '
        'fill="#f8f9fa"/>',
        shape_tag(sheet.path(shapely.box(*world.ground.extent)), GROUND[world.ground.surface], stroke="#cbd0d6"),
    ]
    for name, track in world.roads().items():
        edges = world.spec.tracks[name].edges
        if edges is not None and edges != world.ground.surface:
            parts.append(shape_tag(sheet.path(verge(track)), GROUND[edges]))
    for name, track in world.roads().items():
        spec = world.spec.tracks[name]
        most = "" if track.edges is None else "up to "
        wide = f"{track.length:.1f} m, {most}{track.width:.4g} m wide"
        title = f"track {name}: {wide}, {spec.surface}, μ {track_mu(spec):g}"
        parts.append(shape_tag(sheet.path(track.area), ROAD[spec.surface], stroke="#8d949d", title=title, kind="road"))
        for marking in spec.markings:
            inset = 0.05 + marking.width / 2.0
            s = np.zeros(1) if marking.line == "start" else np.append(track.stations(), track.length)
            left, right = track.left_width(s) - inset, inset - track.right_width(s)
            if marking.line == "start":
                points = np.array(track.point(0.0, np.append(right, left))).T
            else:
                points = np.array(
                    track.point(s, {"left": left, "right": right, "center": np.zeros_like(s)}[marking.line])
                ).T
            dash = ""
            if marking.kind == "dashed":
                dash = f' stroke-dasharray="{marking.dash[0] * sheet.scale:.1f} {marking.dash[1] * sheet.scale:.1f}"'
            thick = max(marking.width * sheet.scale, 1.6 if marking.line == "start" else 0.7)
            line = sheet.line(_simple(points, 0.15 / sheet.scale))
            parts.append(f'<path d="{line}" fill="none" stroke="#ffffff" stroke-width="{thick:.2f}"{dash}/>')
    for patch in world.patches:
        fill, title = (
            ROAD.get(patch.surface or "", PLAIN),
            f"patch {friction_of(patch.name, patch.surface, patch.mu)}",
        )
        element = shape_tag(sheet.path(patch.area), fill, stroke=darker(fill), title=title, kind="patch")
        parts.append(element.replace("<path ", '<path fill-opacity="0.8" stroke-dasharray="6 4" '))
    return "\n".join(parts)


def _draw_goals(sheet: Sheet, world: World, names: Names) -> str:
    parts = []
    for name, goal in world.goals.items():
        if goal.area is not None:
            element = shape_tag(sheet.path(goal.area), GREEN, stroke=GREEN, title=f"goal {name}", kind="goal")
            parts.append(element.replace("<path ", '<path fill-opacity="0.16" stroke-dasharray="5 3" '))
            box = sheet.bounds(goal.area)
        elif goal.gate is not None:
            track = world.tracks[goal.gate[0]]
            right, left = float(track.right_width(goal.gate[1])) + 0.5, float(track.left_width(goal.gate[1])) + 0.5
            ends = np.array(track.point([goal.gate[1]] * 2, [-right, left])).T
            parts.append(f'<path class="goal" d="{sheet.line(ends)}" stroke="{GREEN}" stroke-width="4"/>')
            box = sheet.bounds(shapely.LineString(ends))
        else:
            continue
        names.block(box)
        names.write_beside([box], name, color=GREEN, weight=700)
    return "\n".join(parts)


def _draw_props(sheet: Sheet, world: World) -> str:
    """Props, higher ones on top; small ones get a dot."""
    parts = []
    for placed in sorted(world.props, key=lambda placed: placed.top):
        x, y, _ = placed.X_WP.translation()
        moves = "" if placed.static else ", can be knocked over"
        title = f"{placed.name}: {placed.prop.name} at ({x:.2f}, {y:.2f}) m, {placed.top:.2f} m high{moves}"
        fill = fill_of(placed)
        x0, y0, x1, y1 = sheet.bounds(placed.footprint)
        if max(x1 - x0, y1 - y0) < 6.0:
            parts.append(
                f'<circle class="prop" cx="{(x0 + x1) / 2.0:.2f}" cy="{(y0 + y1) / 2.0:.2f}" r="3.2" fill="{fill}" '
                f'stroke="{darker(fill)}"><title>{escape(title)}</title></circle>'
            )
            continue
        parts.append(shape_tag(sheet.path(placed.footprint), fill, stroke=darker(fill), title=title, kind="prop"))
        length, breadth, _ = placed.prop.size
        if placed.prop.name in _FACING and length * sheet.scale > 4.0:
            tip = np.array([[0.5, 0.0, 0.0], [0.32, 0.42, 0.0], [0.32, -0.42, 0.0]]) * [length, breadth, 0.0]
            points = [(placed.X_WP @ point)[:2] for point in tip]
            parts.append(f'<path d="{sheet.line(points, closed=True)}" fill="{darker(fill)}" fill-opacity="0.75"/>')
    return "\n".join(parts)


def _draw_overlaps(sheet: Sheet, overlaps: Sequence[Overlap], names: Names) -> str:
    parts = []
    for a, b, area in overlaps:
        title = f"{a} and {b} overlap"
        element = shape_tag(sheet.path(area), RED, stroke="#991b1b", title=title, kind="overlap")
        parts.append(element.replace("<path ", '<path fill-opacity="0.75" stroke-width="1.5" '))
        x0, y0, x1, y1 = sheet.bounds(area)
        names.block((x0 - 2.0, y0 - 2.0, x1 + 2.0, y1 + 2.0), text=True)
        if max(x1 - x0, y1 - y0) < 12.0:
            x, y = (x0 + x1) / 2.0, (y0 + y1) / 2.0
            names.block((x - 12.0, y - 12.0, x + 12.0, y + 12.0))
            parts.append(f'<circle cx="{x:.2f}" cy="{y:.2f}" r="11" fill="none" stroke="{RED}" stroke-width="2"/>')
    return "\n".join(parts)


def _draw_starts(sheet: Sheet, world: World, names: Names) -> str:
    """Arrows from the vehicle's origin on."""
    parts, boxes = [], []
    outline = np.array([[0.0, 3.5], [14.0, 3.5], [14.0, 9.0], [28.0, 0.0], [14.0, -9.0], [14.0, -3.5], [0.0, -3.5]])
    for name, start in world.starts.items():
        c, s = math.cos(start.yaw), math.sin(start.yaw)
        points = sheet.place([[start.x, start.y]]) + outline @ np.array([[c, -s], [s, c]])
        text = f"start {name} at ({start.x:.2f}, {start.y:.2f}) m, {math.degrees(start.yaw):.1f}°"
        data = "M" + "L".join(f"{x:.2f} {y:.2f}" for x, y in points) + "Z"
        parts.append(shape_tag(data, BLUE, stroke="#ffffff", title=text, kind="start"))
        (x0, y0), (x1, y1) = points.min(axis=0), points.max(axis=0)
        boxes.append((name, (float(x0), float(y0), float(x1), float(y1))))
        names.block(boxes[-1][1], text=True)
    for name, box in boxes:
        names.write_beside([box], name, color=BLUE, weight=700)
    return "\n".join(parts)


# --- the frame ---------------------------------------------------------------------------------------------------


def _draw_grid(sheet: Sheet) -> str:
    lines = [f"M{x:.2f} {sheet.top:.2f}V{sheet.bottom:.2f}" for x, _ in _ticks(sheet, 0)]
    lines += [f"M{sheet.left:.2f} {y:.2f}H{sheet.left + sheet.width:.2f}" for y, _ in _ticks(sheet, 1)]
    return f'<path d="{"".join(lines)}" fill="none" stroke="{INK}" stroke-opacity="0.07"/>'


def _draw_ticks(sheet: Sheet) -> str:
    parts = [text_tag(x, sheet.bottom + 16.0, t, size=11.0, color=MUTED, anchor="middle") for x, t in _ticks(sheet, 0)]
    parts += [text_tag(sheet.left - 7.0, y, t, size=11.0, color=MUTED, anchor="end", middle=True)
              for y, t in _ticks(sheet, 1)]  # fmt: skip
    return "\n".join(parts)


def _ticks(sheet: Sheet, axis: int) -> list[tuple[float, str]]:
    """Places in the picture of round coordinates, and what stands there."""
    step = 2.0 * round_down(50.0 / sheet.scale)
    step = step if str(step).strip("0.")[0] in "125" else 5.0 * step / 4.0
    low, size = (sheet.x, sheet.width) if axis == 0 else (sheet.y, sheet.height)
    marks = np.arange(math.ceil(low / step), math.floor((low + size / sheet.scale) / step) + 1) * step
    placed = sheet.place(np.column_stack((marks, marks)))[:, axis]
    return [(place, f"{mark + 0.0:g}".replace("-", "−")) for place, mark in zip(placed.tolist(), marks, strict=True)]


def _draw_scale(sheet: Sheet, names: Names) -> str:
    """A bar of a round length at the bottom left, the axes at the bottom right."""
    length = round_down(160.0 / sheet.scale)
    x, y, long = sheet.left + 16.0, sheet.bottom - 16.0, length * sheet.scale
    text = f"{length:g} m"
    parts = [
        f'<path d="M{x:.2f} {y - 4:.2f}v8M{x:.2f} {y:.2f}h{long:.2f}m0 -4v8" stroke="{INK}" stroke-width="1.6" '
        'fill="none"/>',
        text_tag(x + long / 2.0, y - 7.0, text, anchor="middle", halo=True),
    ]
    names.block((x - 6.0, y - 24.0, x + long + 6.0, y + 8.0), text=True)
    x, y = sheet.left + sheet.width - 58.0, sheet.bottom - 18.0
    for dx, dy, name, color in ((1.0, 0.0, "x", "#b91c1c"), (0.0, -1.0, "y", GREEN)):
        tip = (x + 32.0 * dx, y + 32.0 * dy)
        sides = ((6.0 * dx, 6.0 * dy), (4.0 * dy, 4.0 * dx), (-4.0 * dy, -4.0 * dx))
        corners = "L".join(f"{tip[0] + px:.2f} {tip[1] + py:.2f}" for px, py in sides)
        parts += [
            f'<path d="M{x:.2f} {y:.2f}L{tip[0]:.2f} {tip[1]:.2f}" stroke="{color}" stroke-width="2"/>',
            f'<path d="M{corners}Z" fill="{color}"/>',
            text_tag(
                tip[0] + 13.0 * dx, tip[1] + 13.0 * dy, name, color=color, weight=700, anchor="middle", middle=True
            ),
        ]
    names.block((x - 8.0, y - 56.0, x + 54.0, y + 10.0), text=True)
    return "\n".join(parts)


def _about(world: World) -> str:
    xmin, ymin, xmax, ymax = world.ground.extent
    facts = [f"seed {world.spec.seed}"]
    for key, value in list(world.spec.params.items())[:5]:
        facts.append(f"{key} = {value:.6g}" if isinstance(value, int | float) else f"{key} = {value}")
    facts.append(f"{len(world.props)} prop{'s' * (len(world.props) != 1)}")
    return "  ·  ".join([*facts, f"ground {xmax - xmin:.4g} m × {ymax - ymin:.4g} m"])


def _simple(points: Array, tolerance: float) -> Array:
    return np.asarray(shapely.get_coordinates(shapely.simplify(shapely.LineString(points), tolerance)))
