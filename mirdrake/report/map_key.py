"""The key of a plan: surfaces with their friction, kinds of props, starts, goals, overlaps."""

import math
from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

from markupsafe import escape

from mirdrake.core.wording import plural
from mirdrake.report.map_sheet import DOCUMENT, INK, fill_of, friction_label, text_length
from mirdrake.report.world_map import Overlap
from mirdrake.worlds import PlacedProp, World

_ROW = 21.0  # [px]
_MOST_ROWS = 10  # of one section


class _Row(NamedTuple):
    """A row of the key: the colours of its swatch and a text."""

    fills: Sequence[str]
    text: str
    dashed: bool = False


def draw_key(world: World, overlaps: Sequence[Overlap], x: float, y: float, width: float) -> tuple[list[str], float]:
    """Return the key as elements of SVG, and its height [px].

    Args:
        world: the world.
        overlaps: overlaps of its props.
        x: left edge [px].
        y: upper edge [px].
        width: [px]; longer texts are cut.
    """
    elements: list[str] = []
    row = 0
    for title, entries in _sections(world, overlaps):
        row += 1 if row else 0  # an empty row between sections
        middle = y + _ROW * row + 10.0
        bold = 'dy="0.35em" font-size="13" font-weight="700"'
        elements.append(f'<text x="{x:.2f}" y="{middle:.2f}" {bold} fill="{INK}">{escape(title)}</text>')
        row += 1
        # The key must fit on the page beside the map: long lists end with the number of the remaining entries.
        shown = entries if len(entries) <= _MOST_ROWS else entries[: _MOST_ROWS - 1]
        if len(shown) < len(entries):
            shown = [*shown, _Row([], f"and {len(entries) - len(shown)} more")]
        for entry in shown:
            elements.append(_draw_row(entry, x, y + _ROW * row, width))
            row += 1
    return elements, _ROW * row


def _sections(world: World, overlaps: Sequence[Overlap]) -> list[tuple[str, list[_Row]]]:
    """Return the sections that are not empty: title and rows."""
    # Only what the world contains is in the key.
    ground = world.ground
    surfaces = [_Row([DOCUMENT.ground(ground.surface)], friction_label("ground", ground.surface, ground.mu))]
    surfaces += [
        _Row([DOCUMENT.road(road.surface)], friction_label(road.name, road.surface, road.mu))
        for road in world.road_areas
    ]
    for patch in world.patches:
        label = friction_label(patch.name, patch.surface, patch.mu)
        surfaces.append(_Row([DOCUMENT.patch(patch.surface)], label, dashed=True))
    if ground.grade:
        surfaces.append(_Row([], f"slope {100 * ground.grade:g} % up towards {math.degrees(ground.heading):g}°"))

    # Props are counted by kind, with up to four colours each.
    kinds: dict[str, list[PlacedProp]] = {}
    for placed in world.props:
        kinds.setdefault(placed.prop.name, []).append(placed)
    fills = {kind: list(dict.fromkeys(map(fill_of, members)))[:4] for kind, members in kinds.items()}
    props = [_Row(fills[kind], f"{len(members)} × {kind}") for kind, members in kinds.items()]

    count = Counter([actor.prop.name for actor in world.actors] + [full.model for full in world.full_actors])
    colours = {actor.prop.name: fill_of(actor.placed(0.0, 0.0, 0.0)) for actor in world.actors}
    moving = [_Row([colours.get(kind, DOCUMENT.vehicle)], f"{number} × {kind}") for kind, number in count.items()]

    # Symbols as on the map: the key shows what a colour and a dashed line mean.
    places = [_Row([DOCUMENT.start], f"start {name}") for name in world.starts]
    for name, goal in world.goals.items():
        laps = f": {plural(goal.laps, 'lap')}" if goal.laps else ""
        places.append(_Row([DOCUMENT.goal], f"goal {name}{laps}", dashed=True))
    alarms = [_Row([DOCUMENT.alarm], f"{a}, {b}") for a, b, _ in overlaps]
    sections = [
        ("Ground", surfaces),
        ("Props", props),
        ("Actors", moving),
        ("Starts and goals", places),
        (f"Overlaps: {len(overlaps)}", alarms),
    ]
    return [(title, rows) for title, rows in sections if rows]


def _draw_row(row: _Row, x: float, y: float, width: float) -> str:
    """Draw a swatch with one or several colours, and a text that is cut at the right edge."""
    text = row.text
    # SVG neither wraps nor cuts text.
    while text_length(text, 12.0) > width - 24.0:
        text = text[:-2].rstrip("…") + "…"
    dash = ' stroke-dasharray="3 2"' if row.dashed else ""
    # Several colours share one swatch, so that all swatches are of the same width.
    swatch, part = "", 16.0 / max(len(row.fills), 1)
    for number, fill in enumerate(row.fills):
        swatch += (
            f'<rect x="{x + number * part:.2f}" y="{y + 4.0:.2f}" width="{part:.2f}" height="12" fill="{fill}" '
            f'stroke="{DOCUMENT.edge(fill)}"{dash}/>'
        )
    attributes = f'x="{x + 24.0:.2f}" y="{y + 10.0:.2f}" dy="0.35em"'
    return f'{swatch}<text {attributes} font-size="12" fill="{INK}">{escape(text)}</text>'
