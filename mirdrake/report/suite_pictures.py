"""Pictures of a suite's report as SVG: the place from above, margins over time, bars."""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from markupsafe import Markup, escape

from mirdrake.report.track_map import round_down
from mirdrake.report.words import format_quantity

Point = Sequence[float]

PLAN = 520.0
"""Width of a plan [px]."""

_LOW, _HIGH = 190.0, 460.0  # [px] least and most height of a plan
_AROUND = 8.0  # [m] shown around the drive
_WIDEST = 40.0  # [m] that a plan shows at least
_CURVE = (520.0, 104.0)  # [px] width and height of a curve
_LEFT, _RIGHT, _TOP, _BOTTOM = 66.0, 18.0, 8.0, 20.0  # [px] around its axes


class _View(NamedTuple):
    """From the world [m] to the picture [px]."""

    x: float
    y: float
    scale: float
    width: float
    height: float

    def place(self, point: Point) -> tuple[float, float]:
        return (point[0] - self.x) * self.scale, self.height - (point[1] - self.y) * self.scale

    def path(self, points: Iterable[Point], *, closed: bool = True) -> str:
        placed = " ".join(f"{x:.1f} {y:.1f}" for x, y in map(self.place, points))
        return f"M{placed}Z" if closed else f"M{placed}"

    def sees(self, points: Sequence[Point]) -> bool:
        """Whether the box around some points is in the picture, at least in part."""
        placed = [self.place(point) for point in points]
        xs, ys = [x for x, _ in placed], [y for _, y in placed]
        return bool(placed) and max(xs) > 0 and min(xs) < self.width and max(ys) > 0 and min(ys) < self.height


def draw_plan(sketch: Mapping[str, Any], worst: int | None, *, failed: bool) -> Markup:
    """The place from above: roads, patches, goals, props, the driven line, the vehicle at its worst moment.

    Args:
        sketch: see :mod:`mirdrake.suites.sketch`.
        worst: number of the finding whose worst moment is shown.
        failed: whether it failed.
    """
    view = _view(sketch)
    parts = [f'<rect width="{view.width:.0f}" height="{view.height:.0f}" class="ground"/>']
    for kind in ("roads", "patches", "goals"):
        rings = [ring for ring in sketch.get(kind, ()) if view.sees(ring)]
        if rings:
            parts.append(f'<path class="{kind}" fill-rule="evenodd" d="{"".join(map(view.path, rings))}"/>')
    props = [ring for ring in sketch.get("props", ()) if view.sees(ring)]
    if props:
        parts.append(f'<path class="props" d="{"".join(map(view.path, props))}"/>')
    if len(sketch.get("line", ())) > 1:
        parts.append(f'<path class="drive" d="{view.path(sketch["line"], closed=False)}"/>')
    for kind in ("start", "end"):
        if sketch.get(kind):
            parts.append(f'<path class="car" d="{view.path(sketch[kind])}"/>')
            parts.append(_word(view, sketch[kind], kind, above=kind == "end"))
    if worst is not None and sketch["findings"][worst]["outline"]:
        finding = sketch["findings"][worst]
        name = "worst bad" if failed else "worst"
        parts.append(f'<path class="car {name}" d="{view.path(finding["outline"])}"/>')
        x, y = view.place(_middle(finding["outline"]))
        radius = max(16.0, 3.2 * view.scale)
        parts.append(f'<circle class="ring {name}" cx="{x:.1f}" cy="{y:.1f}" r="{radius:.1f}"/>')
        above = y - radius - 5.0 if y - radius > 18.0 else y + radius + 14.0
        parts.append(f'<text x="{x:.1f}" y="{above:.1f}" text-anchor="middle">{finding["worst_time"]:.2f} s</text>')
    parts.append(_scale_bar(view))
    return _svg("plan", view.width, view.height, "The place from above with the driven line.", parts)


def _view(sketch: Mapping[str, Any]) -> _View:
    """What of the world is shown: the drive and a bit around it; all that stands in it if nothing was driven."""
    points = [*sketch.get("line", ()), *sketch.get("start", ()), *sketch.get("end", ())]
    points += [point for finding in sketch.get("findings", ()) for point in finding["outline"]]
    if not points:
        points = [point for kind in ("roads", "goals", "props") for ring in sketch.get(kind, ()) for point in ring]
    points = points or [[0.0, 0.0]]
    xs, ys = [point[0] for point in points], [point[1] for point in points]
    x0, x1, y0, y1 = min(xs) - _AROUND, max(xs) + _AROUND, min(ys) - _AROUND, max(ys) + _AROUND
    scale = min(PLAN / max(x1 - x0, _WIDEST), _HIGH / (y1 - y0))
    height = min(max(_LOW, (y1 - y0) * scale), _HIGH)
    return _View((x0 + x1) / 2.0 - PLAN / 2.0 / scale, (y0 + y1) / 2.0 - height / 2.0 / scale, scale, PLAN, height)


def _middle(points: Sequence[Point]) -> tuple[float, float]:
    return sum(point[0] for point in points) / len(points), sum(point[1] for point in points) / len(points)


def _word(view: _View, outline: Sequence[Point], word: str, *, above: bool) -> str:
    placed = [view.place(point) for point in outline]
    x, y = _middle(placed)[0], min(y for _, y in placed) - 5.0 if above else max(y for _, y in placed) + 13.0
    return f'<text x="{x:.1f}" y="{min(y, view.height - 4.0):.1f}" text-anchor="middle">{word}</text>'


def _scale_bar(view: _View) -> str:
    length = round_down(view.width / 6.0 / view.scale)
    right, y = 12.0 + length * view.scale, view.height - 10.0
    return f'<path class="bar" d="M12 {y:.1f}H{right:.1f}"/><text x="12" y="{y - 5.0:.1f}">{length:g} m</text>'


def draw_curve(curve: Mapping[str, Any], *, unit: str, margin: float | None, passed: bool) -> Markup:
    """A margin over time, with a dot where it was decided; if it fails, what is below zero in red.

    Args:
        curve: an entry of ``findings`` in a sketch.
        unit: of the margin.
        margin: that of the requirement.
        passed: whether it holds.
    """
    width, height = _CURVE
    known = [float(value) for value in curve["margins"] if value is not None]
    if not known:
        return Markup("")
    low, high = min(0.0, *known), max(0.0, *known)
    room = 0.08 * (high - low) or 0.1
    low, high = low - room, high + room
    first = float(curve["times"][0])
    last = max(float(curve["times"][-1]), first + 1e-3)

    def x_of(time: float) -> float:
        return _LEFT + (time - first) / (last - first) * (width - _LEFT - _RIGHT)

    def y_of(value: float) -> float:
        return _TOP + (high - value) / (high - low) * (height - _TOP - _BOTTOM)

    zero, parts = y_of(0.0), []
    values = _ticks(low, high, 3)
    for value in values:
        y, mark = y_of(value), f"{_number(value)} {unit if value == values[-1] else ''}".strip()
        parts.append(f'<path class="grid" d="M{_LEFT:.0f} {y:.1f}H{width - _RIGHT:.0f}"/>')
        parts.append(f'<text x="{_LEFT - 6:.0f}" y="{y + 4:.1f}" text-anchor="end">{escape(mark)}</text>')
    times = _ticks(first, last, 6)
    parts += [
        f'<text x="{x_of(time):.1f}" y="{height - 5:.0f}" text-anchor="middle">{_number(time)}'
        f"{' s' if time == times[-1] else ''}</text>"
        for time in times
    ]
    for piece in _pieces(curve):
        line = " ".join(f"{x_of(t):.1f} {y_of(v):.1f}" for t, v in piece)
        below = " ".join(f"{x_of(t):.1f} {max(y_of(v), zero):.1f}" for t, v in piece)
        ends = x_of(piece[-1][0]), x_of(piece[0][0])
        if not passed:
            parts.append(f'<path class="below" d="M{below}L{ends[0]:.1f} {zero:.1f}H{ends[1]:.1f}Z"/>')
        parts.append(f'<path class="curve" d="M{line}"/>')
    parts.append(f'<path class="zero" d="M{_LEFT:.0f} {zero:.1f}H{width - _RIGHT:.0f}"/>')
    if margin is not None:
        x, y = x_of(min(max(curve["worst_time"], first), last)), y_of(min(max(margin, low), high))
        parts.append(f'<circle class="dot{"" if passed else " bad"}" cx="{x:.1f}" cy="{y:.1f}" r="4"/>')
    text = f"Margin over time in {unit or 'pure numbers'}; it was decided at {curve['worst_time']:g} s."
    return _svg("margin", width, height, text, parts)


def draw_bar(margin: float | None, largest: float, *, passed: bool) -> Markup:
    """A margin as a bar from the middle: to the right what holds, to the left what fails."""
    share = 1.0 if margin is None else min(1.0, abs(margin) / largest) if largest > 0.0 else 0.0
    length = max(1.5, 40.0 * share)
    x = 41.0 if passed else 41.0 - length
    rect = f'<rect class="{"good" if passed else "bad"}" x="{x:.1f}" y="2" width="{length:.1f}" height="8" rx="1.5"/>'
    return _svg("tiny", 82.0, 12.0, "", [rect, '<path class="zero" d="M41 0V12"/>'])


def _pieces(curve: Mapping[str, Any]) -> list[list[tuple[float, float]]]:
    """The stretches without gaps."""
    pieces: list[list[tuple[float, float]]] = [[]]
    for time, value in zip(curve["times"], curve["margins"], strict=True):
        if value is None:
            pieces.append([])
        else:
            pieces[-1].append((time, value))
    return [piece for piece in pieces if piece]


def _ticks(low: float, high: float, count: int) -> list[float]:
    step = 10.0 ** math.floor(math.log10((high - low) / count))
    step *= next(factor for factor in (1.0, 2.0, 5.0, 10.0) if (high - low) / (step * factor) <= count)
    return [step * index for index in range(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1)]


def _number(value: float) -> str:
    return format_quantity(value, digits=2) if value % 1.0 else f"{value:.0f}".replace("-", "−")


def _svg(name: str, width: float, height: float, label: str, parts: Sequence[str]) -> Markup:
    role = f'role="img" aria-label="{escape(label)}"' if label else 'aria-hidden="true"'
    return Markup(f'<svg class="{name}" viewBox="0 0 {width:.0f} {height:.0f}" {role}>{"".join(parts)}</svg>')
