"""The key of a world from above: surfaces and their friction, kinds of props, starts, goals, overlaps."""

import math
from collections.abc import Sequence

from markupsafe import escape
from shapely.geometry.base import BaseGeometry

from mirdrake.report.plan_sheet import (
    BLUE,
    GREEN,
    GROUND,
    INK,
    PLAIN,
    RED,
    ROAD,
    SIDE,
    darker,
    fill_of,
    friction_of,
    length_of,
)
from mirdrake.worlds import PlacedProp, World
from mirdrake.worlds.world import track_mu

Overlap = tuple[str, str, BaseGeometry]
"""Names of two props, and where both are, seen from above [m]."""

ROW = 21.0  # [px] of the key
_MOST_ROWS = 10  # of one part of the key


def make_key(world: World, overlaps: Sequence[Overlap]) -> list[str]:
    """Rows of the key as templates of their place."""
    ground = world.ground
    parts = [("Ground", [_row([GROUND[ground.surface]], friction_of("ground", ground.surface, ground.mu))])]
    for name in world.roads():
        spec = world.spec.tracks[name]
        parts[0][1].append(_row([ROAD[spec.surface]], friction_of(name, spec.surface, track_mu(spec))))
    for patch in world.patches:
        fill = ROAD.get(patch.surface or "", PLAIN)
        parts[0][1].append(_row([fill], friction_of(patch.name, patch.surface, patch.mu), dashed=True))
    if ground.grade:
        parts[0][1].append(_row([], f"slope {100 * ground.grade:g} % up towards {math.degrees(ground.heading):g}°"))
    kinds: dict[str, list[PlacedProp]] = {}
    for placed in world.props:
        kinds.setdefault(placed.prop.name, []).append(placed)
    fills = {kind: list(dict.fromkeys(map(fill_of, members)))[:4] for kind, members in kinds.items()}
    parts.append(("Props", [_row(fills[kind], f"{len(members)} × {kind}") for kind, members in kinds.items()]))
    places = [_row([BLUE], f"start {name}") for name in world.starts]
    for name, goal in world.goals.items():
        what = f": {goal.laps} lap{'s' if goal.laps > 1 else ''}" if goal.laps else ""
        places.append(_row([GREEN], f"goal {name}{what}", dashed=True))
    parts.append(("Starts and goals", places))
    parts.append((f"Overlaps: {len(overlaps)}", [_row([RED], f"{a}, {b}") for a, b, _ in overlaps]))
    rows: list[str] = []
    for title, entries in parts:
        if not entries:
            continue
        shown = entries if len(entries) <= _MOST_ROWS else entries[: _MOST_ROWS - 1]
        rest = [] if shown is entries else [_row([], f"and {len(entries) - len(shown)} more")]
        bold = 'dy="0.35em" font-size="13" font-weight="700"'
        heading = f'<text x="{{x:.2f}}" y="{{ym:.2f}}" {bold} fill="{INK}">{title}</text>'
        rows += [*([""] if rows else []), heading, *shown, *rest]
    return rows


def _row(fills: Sequence[str], text: str, *, dashed: bool = False) -> str:
    """A row: a swatch with one or several colours, and a text that is cut where the picture ends."""
    while length_of(text, 12.0) > SIDE - 62.0:
        text = text[:-2].rstrip("…") + "…"
    dash = ' stroke-dasharray="3 2"' if dashed else ""
    swatch, part = "", 16.0 / max(len(fills), 1)
    for number, fill in enumerate(fills):
        swatch += (
            f'<rect x="{{x:.2f}}" y="{{y:.2f}}" transform="translate({number * part:.2f} 4)" width="{part:.2f}" '
            f'height="12" fill="{fill}" stroke="{darker(fill)}"{dash}/>'
        )
    shown = str(escape(text)).replace("{", "{{").replace("}", "}}")
    return f'{swatch}<text x="{{x2:.2f}}" y="{{ym:.2f}}" dy="0.35em" font-size="12" fill="{INK}">{shown}</text>'
