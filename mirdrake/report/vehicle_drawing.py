"""Drawings of a vehicle to scale as SVG: from the right, from above, at full lock; in the colours of the page."""

import html
import math
from collections.abc import Sequence

import numpy as np
import shapely

from mirdrake.report.surfaces import Surface, picture_of
from mirdrake.report.words import format_quantity
from mirdrake.vehicles.figures import Inspection, SensorFigures

WIDTH = 1000.0
"""Of every drawing, in its own units."""

_PICTURE = 1400  # pixels across a vehicle
_WEDGE = 0.42  # drawn reach of a sensor over the length of the vehicle


class Drawing:
    """Drawing commands in metres that become SVG in the units of the page.

    Args:
        left: x at the left edge of the drawing [m].
        top: height at its top edge [m].
        scale: units per metre.
        height: height of the drawing, in units.
    """

    def __init__(self, *, left: float, top: float, scale: float, height: float) -> None:
        self.scale, self._left, self._top, self._height = scale, left, top, height
        self._parts: list[str] = []
        self._wedges: set[tuple[str, ...]] = set()

    def at(self, x: float, y: float) -> tuple[float, float]:
        """Return a point [m] in units of the page."""
        return (x - self._left) * self.scale, (self._top - y) * self.scale

    def add(self, text: str) -> None:
        """Add SVG without changes."""
        self._parts.append(text)

    def line(self, start: tuple[float, float], end: tuple[float, float], kind: str) -> None:
        """Add a straight line between two points [m]; `kind` is its CSS class."""
        (x1, y1), (x2, y2) = self.at(*start), self.at(*end)
        self.add(f'<line class="{kind}" x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}"/>')

    def text(self, x: float, y: float, words: str, *, kind: str = "label", anchor: str = "middle") -> None:
        """Add a text at a position in units of the page."""
        self.add(f'<text class="{kind}" x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}">{html.escape(words)}</text>')

    def image(self, address: str, box: tuple[float, float, float, float]) -> None:
        """Add a picture of a box left, low, right, high [m]."""
        left, low, right, high = box
        x, y = self.at(left, high)
        size = f'width="{(right - left) * self.scale:.1f}" height="{(high - low) * self.scale:.1f}"'
        self.add(f'<image x="{x:.1f}" y="{y:.1f}" {size} preserveAspectRatio="none" href="{address}"/>')

    def across(self, start: float, end: float, level: float, words: str, *, touch: float) -> None:
        """Add a dimension line between two x [m] at `level`, a y of the page; its ends start at height `touch` [m]."""
        (x1, y0), (x2, _) = self.at(start, touch), self.at(end, touch)
        for x in (x1, x2):
            self.add(f'<line class="witness" x1="{x:.1f}" y1="{y0:.1f}" x2="{x:.1f}" y2="{level + 5:.1f}"/>')
        self.add(f'<line class="measure" x1="{x1:.1f}" y1="{level:.1f}" x2="{x2:.1f}" y2="{level:.1f}"/>')
        self.text(0.5 * (x1 + x2), level - 6.0, words, kind="size")

    def upward(self, start: float, end: float, place: float, words: str, *, touch: float) -> None:
        """Add a dimension between two heights [m]; its witness lines begin at x = `touch` [m]."""
        (x0, y1), (_, y2) = self.at(touch, start), self.at(touch, end)
        # Witness lines end a little beyond the measure line, on the side away from the vehicle, as in technical
        # drawings.
        outward = 5.0 if place > x0 else -5.0
        for y in (y1, y2):
            self.add(f'<line class="witness" x1="{x0:.1f}" y1="{y:.1f}" x2="{place + outward:.1f}" y2="{y:.1f}"/>')
        self.add(f'<line class="measure" x1="{place:.1f}" y1="{y1:.1f}" x2="{place:.1f}" y2="{y2:.1f}"/>')
        middle = 0.5 * (y1 + y2)
        x = place + (-7.0 if outward > 0.0 else 14.0)
        self.add(
            f'<text class="size" text-anchor="middle" transform="translate({x:.1f} {middle:.1f}) rotate(-90)">'
            f"{html.escape(words)}</text>"
        )

    def balance(self, x: float, y: float) -> None:
        """Add the symbol of a centre of mass [m]: a disc with black and white quarters."""
        (u, v), r = self.at(x, y), 9.0
        quarters = f"M{u:.1f} {v:.1f}v{-r}a{r} {r} 0 0 1 {r} {r}zM{u:.1f} {v:.1f}v{r}a{r} {r} 0 0 1 {-r} {-r}z"
        self.add(f'<circle class="disc" cx="{u:.1f}" cy="{v:.1f}" r="{r}"/><path class="quarters" d="{quarters}"/>')

    def wedge(self, x: float, y: float, begin: float, end: float, reach: float) -> None:
        """Add a field of view: a sector about a point [m] between two angles [rad], or a disc."""
        u, v = self.at(x, y)
        r = reach * self.scale
        key = tuple(f"{value:.2f}" for value in (u, v, begin, end, r))
        # Sensors with the same view, such as a stereo pair, would darken one another.
        if key in self._wedges:
            return
        self._wedges.add(key)
        # SVG cannot draw an arc whose ends coincide.
        if end - begin > 2.0 * math.pi - 0.02:
            self.add(f'<circle class="sees" cx="{u:.1f}" cy="{v:.1f}" r="{r:.1f}"/>')
            return
        # Heights grow upwards, in the picture downwards: angles change their sign.
        (x1, y1), (x2, y2) = ((u + r * math.cos(angle), v - r * math.sin(angle)) for angle in (begin, end))
        large = int(end - begin > math.pi)
        arc = f"A{r:.1f} {r:.1f} 0 {large} 0 {x2:.1f} {y2:.1f}"
        self.add(f'<path class="sees" d="M{u:.1f} {v:.1f}L{x1:.1f} {y1:.1f}{arc}z"/>')

    def outline(self, surface: Surface, axes: tuple[int, int], *, kind: str = "solid") -> None:
        """Add the hull of a shape in the projection along the third axis."""
        hull = shapely.MultiPoint(surface.triangles.reshape(-1, 3)[:, axes]).convex_hull
        if isinstance(hull, shapely.Polygon):
            points = " ".join("{:.1f},{:.1f}".format(*self.at(x, y)) for x, y in hull.exterior.coords[:-1])
            self.add(f'<polygon class="{kind}" points="{points}"/>')

    def numbers(self, sensors: Sequence[SensorFigures], axes: tuple[int, int]) -> None:
        """Add the sensors as dots with numbers; sensors at the same position share a tag."""
        places: dict[tuple[int, int], list[int]] = {}
        for number, sensor in enumerate(sensors, start=1):
            u, v = self.at(sensor.place[axes[0]], sensor.place[axes[1]])
            places.setdefault((round(u), round(v)), []).append(number)
        taken: list[tuple[float, float]] = []
        for (u, v), group in places.items():
            self.add(f'<circle class="mount" cx="{u}" cy="{v}" r="3.5"/>')
            words = _ranges(group)
            half = max(8.5, 3.4 * len(words) + 3.0)
            x, y = u + 4.5 + half, v - 12.0
            # Tags are moved to the right until none overlaps another.
            while any(abs(x - a) < 2.0 * half and abs(y - b) < 18.0 for a, b in taken):
                x += 19.0
            taken.append((x, y))
            size = f'x="{x - half:.1f}" y="{y - 8.5:.1f}" width="{2.0 * half:.1f}" height="17" rx="8.5"'
            self.add(f'<rect class="tag" {size}/>')
            self.text(x, y + 3.6, words, kind="number")

    def svg(self, label: str) -> str:
        """Return the drawing."""
        return (
            f'<svg class="sheet" xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH:.0f} {self._height:.0f}" '
            f'role="img" aria-label="{html.escape(label)}">{"".join(self._parts)}</svg>'
        )


def draw_side(figures: Inspection, seen: Sequence[Surface], solid: Sequence[Surface]) -> str:
    """Return a vehicle from the right, with lengths and axle loads."""
    points = _points([*seen, *solid])
    low, high = points.min(axis=0), points.max(axis=0)
    # The vehicle takes 74 % of the width; dimensions are beside it.
    scale = 0.74 * WIDTH / (high[0] - low[0])
    sensors = [sensor.place[2] for sensor in figures.sensors]
    top = max(float(high[2]), *sensors) if sensors else float(high[2])
    room = (84.0 if any(sensor.upward for sensor in figures.sensors) else 42.0) / scale
    left = 0.5 * (low[0] + high[0]) - 0.5 * WIDTH / scale
    drawing = Drawing(left=left, top=top + room, scale=scale, height=(top + room) * scale + 150.0)
    _, ground = drawing.at(0.0, 0.0)
    drawing.add(f'<rect class="road" x="0" y="{ground:.1f}" width="{WIDTH:.0f}" height="7"/>')
    box = (float(low[0]), min(0.0, float(low[2])), float(high[0]), float(high[2]))
    drawing.image(picture_of(seen or solid, view="side", box=box, width=_PICTURE), box)
    for sensor in figures.sensors:
        # Seen from the side, only sensors that look ahead or back have an opening angle in this plane.
        if sensor.upward and abs(math.cos(sensor.yaw)) > 0.5:
            # A sensor that looks back is mirrored in this projection.
            ahead = sensor.pitch if math.cos(sensor.yaw) > 0.0 else math.pi - sensor.pitch
            begin, end = (ahead + angle for angle in sensor.upward)
            drawing.wedge(sensor.place[0], sensor.place[2], begin, end, _drawn_reach(sensor, figures))
    drawing.add('<g class="solids">')
    for surface in solid:
        drawing.outline(surface, (0, 2))
    drawing.add("</g>")

    # The arrow points at the road, since the axle load acts on it.
    # Axle loads stand below the axles, lengths below them, heights at the side.
    front, rear = figures.loads
    for x, load, share in ((figures.wheelbase, front, figures.front_share), (0.0, rear, 1.0 - figures.front_share)):
        u, _ = drawing.at(x, 0.0)
        drawing.add(f'<path class="load" d="M{u:.1f} {ground + 10:.1f}l-7 12h5v16h4v-16h5z"/>')
        drawing.text(u + 14.0, ground + 34.0, format_quantity(load, "N", digits=4), kind="force", anchor="start")
        drawing.text(u - 14.0, ground + 34.0, f"{100.0 * share:.0f} %", kind="force", anchor="end")
    drawing.across(0.0, figures.wheelbase, ground + 82.0, f"wheelbase {figures.wheelbase:.3f} m", touch=0.0)
    solids = _points(solid or seen)
    begin, end = float(solids[:, 0].min()), float(solids[:, 0].max())
    drawing.across(begin, end, ground + 120.0, f"length {figures.size[0]:.3f} m", touch=0.0)
    right = drawing.at(float(high[0]), 0.0)[0]
    drawing.upward(0.0, figures.size[2], right + 60.0, f"height {figures.size[2]:.3f} m", touch=end)
    x, _, z = figures.com
    first = drawing.at(float(low[0]), 0.0)[0]
    drawing.upward(0.0, z, first - 38.0, f"{z:.3f} m", touch=x)
    drawing.balance(x, z)
    drawing.numbers(figures.sensors, (0, 2))
    return drawing.svg(f"{figures.title} from the right, to scale")


def draw_top(figures: Inspection, seen: Sequence[Surface], solid: Sequence[Surface]) -> str:
    """Return a vehicle from above, with widths and fields of view."""
    points = _points([*seen, *solid])
    low, high = points.min(axis=0), points.max(axis=0)
    scale = 0.74 * WIDTH / (high[0] - low[0])
    # Room for the fields of view of sensors to both sides.
    half = max(float(np.abs(points[:, 1]).max()), *(abs(sensor.place[1]) for sensor in figures.sensors), 0.0)
    half += (70.0 if any(sensor.across for sensor in figures.sensors) else 24.0) / scale
    left = 0.5 * (low[0] + high[0]) - 0.5 * WIDTH / scale
    drawing = Drawing(left=left, top=half, scale=scale, height=2.0 * half * scale)
    drawing.line((float(low[0]) - 20.0 / scale, 0.0), (float(high[0]) + 20.0 / scale, 0.0), "middle")
    box = (float(low[0]), float(low[1]), float(high[0]), float(high[1]))
    drawing.image(picture_of(seen or solid, view="top", box=box, width=_PICTURE), box)
    for sensor in figures.sensors:
        if sensor.across:
            begin, end = (sensor.yaw + angle for angle in sensor.across)
            drawing.wedge(sensor.place[0], sensor.place[1], begin, end, _drawn_reach(sensor, figures))
    drawing.add('<g class="solids">')
    for surface in solid:
        drawing.outline(surface, (0, 1))
    drawing.add("</g>")
    # Tracks and widths stand at the end at which they are measured.
    first, last = drawing.at(float(low[0]), 0.0)[0], drawing.at(float(high[0]), 0.0)[0]
    front, rear = (0.5 * track for track in figures.tracks)
    drawing.upward(-front, front, last + 34.0, f"track {2.0 * front:.3f} m", touch=figures.wheelbase)
    drawing.upward(-rear, rear, first - 38.0, f"track {2.0 * rear:.3f} m", touch=0.0)
    width = 0.5 * figures.size[1]
    drawing.upward(-width, width, last + 84.0, f"width {figures.size[1]:.3f} m", touch=float(high[0]))
    drawing.balance(figures.com[0], figures.com[1])
    drawing.numbers(figures.sensors, (0, 1))
    return drawing.svg(f"{figures.title} from above, to scale")


def draw_lock(figures: Inspection, seen: Sequence[Surface], wheels: Sequence[Surface]) -> str:
    """Return a vehicle at full lock to the left, with its turning circles.

    Args:
        figures: figures of the vehicle.
        seen: its surfaces, wheels steered.
        wheels: collision shapes of the wheels, steered.
    """
    wall, kerb, middle = 0.5 * figures.wall_circle, 0.5 * figures.turning_circle, figures.turning_radius
    room = 1.06 * wall
    scale = 0.56 * WIDTH / (2.0 * room)
    drawing = Drawing(left=-0.5 * WIDTH / scale, top=middle + room, scale=scale, height=2.0 * room * scale)
    # The turning centre is at the height of the rear axle, to its left.
    u, v = drawing.at(0.0, middle)
    for radius, kind in ((wall, "wall"), (kerb, "kerb"), (middle, "path")):
        drawing.add(f'<circle class="{kind}" cx="{u:.1f}" cy="{v:.1f}" r="{radius * scale:.1f}"/>')
    inner, outer = (0.5 * figures.kingpin_track, -0.5 * figures.kingpin_track)
    # Ackermann geometry: perpendiculars of all wheels meet in the turning centre.
    for x, y in ((figures.wheelbase, inner), (figures.wheelbase, outer), (0.0, -0.5 * figures.tracks[1])):
        drawing.line((0.0, middle), (x, y), "ray")
    points = _points(seen)
    low, high = points.min(axis=0), points.max(axis=0)
    box = (float(low[0]), float(low[1]), float(high[0]), float(high[1]))
    drawing.image(picture_of(seen, view="top", box=box, width=_PICTURE // 2), box)
    for wheel in wheels:
        drawing.outline(wheel, (0, 1), kind="tread")
    drawing.add(f'<circle class="mount" cx="{u:.1f}" cy="{v:.1f}" r="4"/>')
    degrees = [math.degrees(angle) for angle in figures.steering_limits]
    drawing.text(u, v - 12.0, f"inner wheel {degrees[0]:.1f}°, outer wheel {degrees[1]:.1f}°", kind="size")
    # The circles differ by line style, explained at the right.
    label = WIDTH - 205.0
    rows = (
        ("wall", "wall to wall", figures.wall_circle),
        ("kerb", "kerb to kerb", figures.turning_circle),
        ("path", "rear axle's centre", 2.0 * middle),
    )
    for row, (kind, words, diameter) in enumerate(rows):
        y = 46.0 + 52.0 * row
        drawing.add(
            f'<line class="{kind}" x1="{label - 44:.1f}" y1="{y - 4:.1f}" x2="{label - 12:.1f}" y2="{y - 4:.1f}"/>'
        )
        drawing.text(label, y, f"{diameter:.2f} m", kind="force", anchor="start")
        drawing.text(label, y + 19.0, words, kind="label", anchor="start")
    return drawing.svg(f"{figures.title} at full lock, to scale")


def _ranges(numbers: Sequence[int]) -> str:
    """Return increasing numbers as a text: 2, 5–10."""
    runs: list[list[int]] = []
    for number in numbers:
        if runs and number == runs[-1][-1] + 1:
            runs[-1].append(number)
        else:
            runs.append([number])
    return ", ".join(str(run[0]) if len(run) == 1 else f"{run[0]}–{run[-1]}" for run in runs)


def _points(surfaces: Sequence[Surface]) -> np.ndarray:
    """Return all corners (n, 3) [m]; those of a small box without shapes."""
    if not surfaces:
        return np.array([[-0.1, -0.1, 0.0], [0.1, 0.1, 0.1]])
    points: np.ndarray = np.concatenate([surface.triangles.reshape(-1, 3) for surface in surfaces])
    return points


def _drawn_reach(sensor: SensorFigures, figures: Inspection) -> float:
    """Return the drawn range of a field of view [m]: all of a sonar, others are cut."""
    drawn_limit = _WEDGE * max(figures.size[0], figures.wheelbase)
    return min(sensor.reach[1], drawn_limit) if sensor.reach else drawn_limit
