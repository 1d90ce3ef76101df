"""The plan of a world: a picture of its own with grid, names, key and overlaps.

The element with the class ``map`` states how a point of W becomes a point of the picture:
``data-left + (x - data-x) · data-scale`` and ``data-bottom - (y - data-y) · data-scale``.

::

    World ── draw_world ──► ground, goals, starts           world_map.py
    props, actors ──► outlines and symbols                  map_props.py
    Labels ──► names without overlaps                       map_labels.py
    draw_key ──► rows at the right side                     map_key.py
    draw_plan ──► frame, grid, axes, and all of these       here
"""

import math
from collections.abc import Iterable, Sequence

import numpy as np
import shapely
from markupsafe import escape
from shapely.geometry.base import BaseGeometry

from mirdrake.core.wording import plural
from mirdrake.report.map_key import draw_key
from mirdrake.report.map_labels import Labels, label_patches, label_props, label_tracks
from mirdrake.report.map_props import actors, prop_box, props
from mirdrake.report.map_sheet import DOCUMENT, INK, MUTED, Palette, Sheet, line_tag, text_tag
from mirdrake.report.world_map import (
    Overlap,
    draw_world,
    overlap_areas,
    round_down,
    signals,
    start_arrow,
    starts,
    surfaces,
)
from mirdrake.worlds import World
from mirdrake.worlds.drawing import make_drawing

__all__ = ["Overlap", "draw_plan", "find_overlaps"]

_LEFT, _TOP, _BOTTOM, _SIDE = 48.0, 66.0, 34.0, 250.0  # [px] around the map; the key is at its right side
_LEAST, _MOST = 420.0, 740.0  # [px] least width and height, largest height of the map
_FOOT = 66.0  # [px] for scale bar and axes at the bottom
_KEY_MARGIN = 26.0  # [px]
_FONT = "Helvetica, Arial, 'Liberation Sans', 'DejaVu Sans', sans-serif"


def find_overlaps(world: World) -> list[Overlap]:
    """Return the props that overlap seen from above and in height, unless a rule allows it; at least 1 cm²."""
    footprints = [placed.footprint for placed in world.props]
    tree = shapely.STRtree(footprints)
    overlaps: list[Overlap] = []
    pairs = tree.query(footprints, predicate="intersects").T.tolist() if footprints else []
    # Sorted, as the tree does not return pairs in a defined order.
    for i, j in sorted(pairs):
        a, b = world.props[i], world.props[j]
        # Each pair once, and only if the props overlap in height, too.
        if i >= j or min(a.top, b.top) - max(a.bottom, b.bottom) < 1e-3:
            continue
        area = a.footprint.intersection(b.footprint)
        if area.area > 1e-4 and not (world.rules is not None and world.rules.may_overlap(a, b)):
            overlaps.append((a.name, b.name, area))
    return overlaps


def draw_plan(world: World, *, overlaps: Sequence[Overlap] = (), width: float = 1200.0) -> str:
    """Return the plan of a world as an SVG document.

    Args:
        world: the world.
        overlaps: overlaps of its props; drawn in red.
        width: width of the picture [px]; a narrow world makes it narrower.
    """
    # The sheet is at least as wide as the key needs; the picture keeps the aspect ratio of the world.
    sheet = _make_sheet(world, max(width, _LEFT + _LEAST + _SIDE))
    layers = [surfaces, _grid, signals, props, overlap_areas(overlaps), actors, starts]
    body = draw_world(world, sheet, DOCUMENT, layers)
    bar, ticks = _draw_scale(sheet), _draw_ticks(sheet)
    labels = _make_labels(world, sheet, overlaps)
    right = sheet.left + sheet.width + _KEY_MARGIN
    # The key may be higher than the map.
    key, key_height = draw_key(world, overlaps, right, sheet.top, _SIDE - _KEY_MARGIN - 12.0)
    height = max(sheet.bottom + _BOTTOM, sheet.top + key_height + 10.0)
    total = sheet.left + sheet.width + _SIDE
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
        text_tag(sheet.left, 51.0, _subtitle(world), size=13.0, color=MUTED),
        # The script of the page converts pixels to metres with these attributes.
        f'<g class="map" clip-path="url(#frame)" data-x="{sheet.x:.4f}" data-y="{sheet.y:.4f}" '
        f'data-scale="{sheet.scale:.6f}" data-left="{sheet.left:.2f}" data-bottom="{sheet.bottom:.2f}">',
        f'<rect {frame} fill="#f8f9fa"/>',
        body, *labels.elements, bar,
        "</g>",
        f'<rect {frame} fill="none" stroke="#9ca3af"/>',
        ticks, *key,
        "</svg>\n",
    ])  # fmt: skip


def _make_sheet(world: World, width: float) -> Sheet:
    """Return a sheet with everything in the world, and room for scale bar and axes at the bottom."""
    boxes = [area.bounds for area in _contents(world)] or [world.ground.extent]
    low, high = np.array(boxes)[:, :2].min(axis=0), np.array(boxes)[:, 2:].max(axis=0)
    # A world of one prop is not enlarged without limit.
    size = np.maximum(high - low, 12.0)
    middle, size = (low + high) / 2.0, size + 2.0 * (1.0 + 0.05 * size.max())
    # The narrower of both directions decides.
    scale = float(min((width - _LEFT - _SIDE) / size[0], (_MOST - _FOOT / 2.0) / size[1]))
    across = max(_LEAST, float(size[0]) * scale)
    foot = max(0.0, _FOOT - 0.05 * float(size.max()) * scale)
    height = max(_LEAST, float(size[1]) * scale + foot)
    x, y = middle - np.array([across, height + foot]) / 2.0 / scale
    return Sheet((float(x), float(y)), scale, (across, height), left=_LEFT, top=_TOP, decimals=2)


def _contents(world: World) -> list[BaseGeometry]:
    """Return the areas that must be in the picture."""
    areas: list[BaseGeometry] = [track.area for track in world.tracks.values()]
    areas += [road.area for road in world.road_areas if not road.is_track]
    areas += [patch.area for patch in world.patches] + [placed.footprint for placed in world.props]
    areas += [goal.area for goal in world.goals.values() if goal.area is not None]
    areas += [shapely.Point(*world.actor_start(actor)[:2]) for actor in world.moving]
    return areas + [shapely.Point(start.x, start.y) for start in world.starts.values()]


def _make_labels(world: World, sheet: Sheet, overlaps: Sequence[Overlap]) -> Labels:
    """Write the labels: goals and starts first, as they are never left out."""
    # Each label avoids what was written before it, so that the order is that of importance.
    labels = Labels(sheet)
    drawing = make_drawing(world)
    goals = [(area.name, area.area) for area in drawing.layer("goal")]
    goals += [(line.name, shapely.LineString(line.points)) for line in drawing.lines if line.layer == "gate"]
    for name, area in goals:
        labels.block(sheet.bounds(area))
        labels.write_beside([sheet.bounds(area)], name, color=DOCUMENT.goal, weight=700)
    for _, _, area in overlaps:
        x0, y0, x1, y1 = sheet.bounds(area)
        labels.block((x0 - 2.0, y0 - 2.0, x1 + 2.0, y1 + 2.0), text=True)
        if max(x1 - x0, y1 - y0) < 12.0:  # has a circle around it
            x, y = (x0 + x1) / 2.0, (y0 + y1) / 2.0
            labels.block((x - 12.0, y - 12.0, x + 12.0, y + 12.0))
    arrows = {}
    for name in world.starts:
        (x0, y0), (x1, y1) = (f(start_arrow(world, name, sheet), axis=0).tolist() for f in (np.min, np.max))
        arrows[name] = (x0, y0, x1, y1)
        labels.block(arrows[name], text=True)
    for name, box in arrows.items():
        labels.write_beside([box], name, color=DOCUMENT.start, weight=700)

    # Scale bar and axes have their corners.
    left, right, bottom = sheet.left + 16.0, sheet.left + sheet.width - 58.0, sheet.bottom
    length = _scale_length(sheet) * sheet.scale
    labels.block((left - 6.0, bottom - 40.0, left + length + 6.0, bottom - 8.0), text=True)
    labels.block((right - 8.0, bottom - 74.0, right + 54.0, bottom - 8.0), text=True)
    for placed in world.props:
        labels.block(prop_box(placed, sheet))
    for actor in world.actors:
        labels.block(prop_box(actor.placed(*world.actor_start(actor)), sheet))
    for full in world.full_actors:
        labels.block(sheet.bounds(full.area(*world.actor_start(full))))
    # Positions of roads are known only by points along them.
    label_patches(sheet, world, labels)
    for track in world.roads().values():
        s = np.arange(0.0, track.length, max(6.0 / sheet.scale, track.length / 2000.0))
        labels.avoid(sheet.place(np.column_stack(track.point(s))), track.width / 2.0 * sheet.scale)
    label_tracks(sheet, world, labels)
    label_props(sheet, world, labels)
    return labels


# --- the frame ---------------------------------------------------------------------------------------------------


def _grid(_: World, sheet: Sheet, palette: Palette) -> Iterable[str]:
    lines = [f"M{x:.2f} {sheet.top:.2f}V{sheet.bottom:.2f}" for x, _ in _ticks(sheet, 0)]
    lines += [f"M{sheet.left:.2f} {y:.2f}H{sheet.left + sheet.width:.2f}" for y, _ in _ticks(sheet, 1)]
    yield line_tag("".join(lines), palette.ink, 1.0, more='stroke-opacity="0.07"')


def _draw_ticks(sheet: Sheet) -> str:
    parts = [text_tag(x, sheet.bottom + 16.0, t, size=11.0, color=MUTED, anchor="middle") for x, t in _ticks(sheet, 0)]
    parts += [text_tag(sheet.left - 7.0, y, t, size=11.0, color=MUTED, anchor="end", middle=True)
              for y, t in _ticks(sheet, 1)]  # fmt: skip
    return "\n".join(parts)


def _ticks(sheet: Sheet, axis: int) -> list[tuple[float, str]]:
    """Return the positions of round coordinates in the picture, and their texts."""
    step = 2.0 * round_down(50.0 / sheet.scale)
    step = step if str(step).strip("0.")[0] in "125" else 5.0 * step / 4.0
    low, size = (sheet.x, sheet.width) if axis == 0 else (sheet.y, sheet.height)
    marks = np.arange(math.ceil(low / step), math.floor((low + size / sheet.scale) / step) + 1) * step
    placed = sheet.place(np.column_stack((marks, marks)))[:, axis]
    return [
        (position, f"{mark + 0.0:g}".replace("-", "−")) for position, mark in zip(placed.tolist(), marks, strict=True)
    ]


def _scale_length(sheet: Sheet) -> float:
    """Return a round length for the scale bar [m]."""
    return round_down(160.0 / sheet.scale)


def _draw_scale(sheet: Sheet) -> str:
    """Draw a bar of a round length at the bottom left, and the axes at the bottom right."""
    # Screen y points down, world y up.
    length = _scale_length(sheet)
    x, y, pixels = sheet.left + 16.0, sheet.bottom - 16.0, length * sheet.scale
    parts = [
        line_tag(f"M{x:.2f} {y - 4:.2f}v8M{x:.2f} {y:.2f}h{pixels:.2f}m0 -4v8", INK, 1.6),
        text_tag(x + pixels / 2.0, y - 7.0, f"{length:g} m", anchor="middle", halo=DOCUMENT.paper),
    ]
    x, y = sheet.left + sheet.width - 58.0, sheet.bottom - 18.0
    for dx, dy, name, color in ((1.0, 0.0, "x", "#b91c1c"), (0.0, -1.0, "y", DOCUMENT.goal)):
        tip = (x + 32.0 * dx, y + 32.0 * dy)
        sides = ((6.0 * dx, 6.0 * dy), (4.0 * dy, 4.0 * dx), (-4.0 * dy, -4.0 * dx))
        corners = "L".join(f"{tip[0] + px:.2f} {tip[1] + py:.2f}" for px, py in sides)
        label_x, label_y = tip[0] + 13.0 * dx, tip[1] + 13.0 * dy
        parts += [
            line_tag(f"M{x:.2f} {y:.2f}L{tip[0]:.2f} {tip[1]:.2f}", color, 2.0),
            f'<path d="M{corners}Z" fill="{color}"/>',
            text_tag(label_x, label_y, name, color=color, weight=700, anchor="middle", middle=True),
        ]
    return "\n".join(parts)


def _subtitle(world: World) -> str:
    xmin, ymin, xmax, ymax = world.ground.extent
    facts = [f"seed {world.spec.seed}"]
    for key, value in list(world.spec.params.items())[:5]:
        facts.append(f"{key} = {value:.6g}" if isinstance(value, int | float) else f"{key} = {value}")
    facts.append(plural(len(world.props), "prop"))
    facts += [plural(len(world.moving), "actor")] if world.moving else []
    return "  ·  ".join([*facts, f"ground {xmax - xmin:.4g} m × {ymax - ymin:.4g} m"])
