"""Lanes between cones, and lines through them, as pure geometry.

A section of a course is a stretch x0 .. x1 in which the whole body must stay between y_low and y_high; cones are
thought of as its edges and never stand in the world.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import linprog
from scipy.sparse import csr_matrix

from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.manoeuvres.base import Array

_STRAIGHT = 0.002
"""Curvature [1/m] that a planned line may have more for each radian that it turns less."""

_BETWEEN = 0.005
"""Way between two places at which the body is checked against the cones, at most, over its length [1]."""


class Section(NamedTuple):
    """Where the body must stay between two lines of cones [m]; one side may be infinite."""

    x0: float
    x1: float
    low: float
    high: float


class Body(NamedTuple):
    """The body seen from above, from the rear axle's centre: rear end, front end, half of its width [m]."""

    rear: float
    front: float
    half_width: float


@dataclass(frozen=True)
class Line:
    """A line to follow, in samples of rising arc length.

    Attributes:
        s: arc length [m].
        x: [m].
        y: [m].
        yaw: heading, without jumps [rad].
        curvature: + left [1/m].
    """

    s: Array
    x: Array
    y: Array
    yaw: Array
    curvature: Array

    def project(self, x: float, y: float, near: int | None = None, reach: int = 60) -> tuple[int, float, float]:
        """The nearest sample's index, its arc length refined, and the offset to the left of the line [m].

        Args:
            x: of the point [m].
            y: of the point [m].
            near: index to look around; everywhere if left out.
            reach: samples to both sides.
        """
        low = 0 if near is None else max(0, near - reach)
        high = len(self.s) if near is None else min(len(self.s), near + reach)
        distances = np.hypot(self.x[low:high] - x, self.y[low:high] - y)
        if near is None:  # a line of several laps passes the same place again: its first lap counts
            step = float(self.s[1] - self.s[0])
            first = int(np.argmax(distances <= float(np.min(distances)) + step))
            distances = distances[: first + reach]
        index = low + int(np.argmin(distances))
        yaw = float(self.yaw[index])
        dx, dy = x - float(self.x[index]), y - float(self.y[index])
        along, lateral = dx * math.cos(yaw) + dy * math.sin(yaw), dy * math.cos(yaw) - dx * math.sin(yaw)
        lateral -= 0.5 * float(self.curvature[index]) * along**2
        return index, float(self.s[index]) + along, lateral

    def at(self, s: float) -> tuple[float, float]:
        """Heading [rad] and curvature [1/m] at an arc length [m]."""
        step = float(self.s[1] - self.s[0])
        place = min(max((s - float(self.s[0])) / step, 0.0), len(self.s) - 1.001)
        index = int(place)
        part = place - index
        yaw = float(self.yaw[index]) * (1.0 - part) + float(self.yaw[index + 1]) * part
        return yaw, float(self.curvature[index]) * (1.0 - part) + float(self.curvature[index + 1]) * part


def from_curvature(curvature: Array, step: float, *, yaw: float = 0.0) -> Line:
    """A line from the origin with given curvatures [1/m] at equal steps [m]."""
    turned = np.concatenate(([0.0], np.cumsum(0.5 * (curvature[1:] + curvature[:-1]) * step)))
    heading: Array = yaw + turned
    x = np.concatenate(([0.0], np.cumsum(0.5 * (np.cos(heading[1:]) + np.cos(heading[:-1])) * step)))
    y = np.concatenate(([0.0], np.cumsum(0.5 * (np.sin(heading[1:]) + np.sin(heading[:-1])) * step)))
    return Line(step * np.arange(len(curvature), dtype=np.float64), x, y, heading, curvature)


def straight(*, length: float) -> Line:
    """A straight along x."""
    count = max(3, math.ceil(length / 0.5) + 1)
    return from_curvature(np.zeros(count, dtype=np.float64), length / (count - 1))


def circle(*, radius: float, turn: float = 1.0, laps: float = 1.0) -> Line:
    """Laps of a circle that starts at the origin along x; `turn` is 1 to the left, -1 to the right."""
    step = min(0.25, radius / 40.0)
    count = math.ceil(2.0 * math.pi * radius * laps / step) + 1
    return from_curvature(np.full(count, math.copysign(1.0 / radius, turn)), step)


def eight(*, radius: float, laps: int = 2, ease: float = 0.0) -> Line:
    """Laps to the right, then as many to the left, from the middle of a figure of eight along x.

    Args:
        radius: of both circles [m].
        laps: of each.
        ease: way before and behind the middle on which the curvature goes steadily from one circle's to the other's
            [m]; both circles move outwards for it, by about ease² / (6 radius).
    """
    step = 2.0 * math.pi * radius / max(240, math.ceil(2.0 * math.pi * radius / 0.25))
    count = round(2.0 * math.pi * radius * laps / step)
    way = step * (np.arange(2 * count + count // 10) - count + 0.5)
    line = from_curvature(np.clip(way / max(ease, 0.1 * step), -1.0, 1.0) / radius, step)
    # Turned and moved so that the centres lie on the y axis, as far from the origin.
    centres = [
        np.array([line.x[i] - turn * radius * np.sin(line.yaw[i]), line.y[i] + turn * radius * np.cos(line.yaw[i])])
        for i, turn in ((0, -1.0), (-1, 1.0))
    ]
    across, middle = centres[1] - centres[0], 0.5 * (centres[0] + centres[1])
    angle = math.atan2(across[0], across[1])
    x, y = line.x - middle[0], line.y - middle[1]
    cos, sin = math.cos(angle), math.sin(angle)
    return replace(line, x=x * cos - y * sin, y=x * sin + y * cos, yaw=line.yaw + angle)


def within(
    *,
    sections: Sequence[Sequence[float | None]],
    rear: float,
    front: float,
    half_width: float,
    margin: float,
    end: float,
    start: float,
    smoothness: float = 8.0,
) -> Line:
    """The line of the rear axle's centre through sections whose largest curvature is smallest: a linear programme.

    The curvature is taken for y'', as slopes are small; its slope is kept small as well, so that a steering wheel can
    follow, and a little its sum, so that the line is straight where it need not bend.

    Args:
        sections: of the course, see :class:`Section`; None is no edge.
        rear: see :class:`Body`, as the next two [m].
        front: see there.
        half_width: see there.
        margin: room to leave between body and cones [m]; half of the room if there is less.
        end: x up to which the line goes [m]; it ends straight ahead.
        start: x from which it goes [m], straight ahead.
        smoothness: length over which the curvature may reach its largest value [m].

    Raises:
        ConfigError: no line leads through.
    """
    step = max((end - start) / 400.0, min(0.5, front / 10.0))
    x = np.arange(start, end + step, step)
    count = len(x)
    values: list[float] = []
    at: tuple[list[int], list[int]] = ([], [])  # rows and columns
    limits: list[float] = []
    size = 2 * count + 2  # y, largest y'', largest y''', amounts of y''

    def add(coefficients: Mapping[int, float], limit: float) -> None:
        for index, value in coefficients.items():
            values.append(value)
            at[0].append(len(limits))
            at[1].append(index)
        limits.append(limit)

    for i in range(1, count - 1):
        add({count + 2 + i: 1.0, count: -1.0}, 0.0)
        for sign in (1.0, -1.0):
            add({i - 1: sign / step**2, i: -2.0 * sign / step**2, i + 1: sign / step**2, count + 2 + i: -1.0}, 0.0)
    for i in range(1, count - 2):
        for sign in (1.0, -1.0):
            cubic = sign / step**3
            add({i - 1: -cubic, i: 3.0 * cubic, i + 1: -3.0 * cubic, i + 2: cubic, count + 1: -1.0}, 0.0)
    for section in sections:
        x0, x1 = float(section[0] or 0.0), float(section[1] or 0.0)
        low = -math.inf if section[2] is None else float(section[2])
        high = math.inf if section[3] is None else float(section[3])
        kept = min(margin, max(0.0, 0.25 * (high - low - 2.0 * half_width))) + half_width
        for i in range(1, count - 1):
            for lever in np.linspace(rear, front, 5):
                if not x0 - 0.5 * step <= x[i] + lever <= x1 + 0.5 * step:
                    continue
                slope = float(lever) / (2.0 * step)
                if high < math.inf:
                    add({i: 1.0, i + 1: slope, i - 1: -slope}, high - kept)
                if low > -math.inf:
                    add({i: -1.0, i + 1: -slope, i - 1: slope}, -kept - low)
    still = 4  # points at the start without curvature
    fixed = np.zeros((still + 1, size))
    fixed[range(still), range(still)] = 1.0
    fixed[still, count - 1], fixed[still, count - 2] = 1.0, -1.0
    cost = np.zeros(size)
    cost[count], cost[count + 1] = 1.0, smoothness
    cost[count + 2 :] = _STRAIGHT * step
    bounds = [(None, None)] * count + [(0.0, None)] * (size - count)
    found = linprog(
        cost,
        A_ub=csr_matrix((values, at), shape=(len(limits), size)),
        b_ub=np.array(limits),
        A_eq=fixed,
        b_eq=np.zeros(still + 1),
        bounds=bounds,
    )
    if not found.success:
        raise ConfigError("no line leads through the course: the vehicle is too wide or too long for it")
    return resample(x, found.x[:count])


def resample(x: Array, y: Array, step: float | None = None) -> Line:
    """A line through points at steps as equal as a chord allows, with heading and curvature by differences."""
    lengths = np.concatenate(([0.0], np.cumsum(np.hypot(np.diff(x), np.diff(y)))))
    count = len(x) if step is None else max(5, math.ceil(lengths[-1] / step) + 1)
    s = np.linspace(0.0, lengths[-1], count)
    px, py = np.interp(s, lengths, x), np.interp(s, lengths, y)
    yaw = np.unwrap(np.arctan2(np.gradient(py, s), np.gradient(px, s)))
    return Line(s, px, py, yaw, np.gradient(yaw, s))


LINES: dict[str, Callable[..., Line]] = {"straight": straight, "circle": circle, "eight": eight, "within": within}


def make_line(data: Mapping[str, Any]) -> Line:
    """A line from ``{kind: circle, radius: 100, turn: 1}``.

    Raises:
        ConfigError: no such kind, or it does not take these numbers.
    """
    settings = dict(data)
    kind = settings.pop("kind", None)
    if kind not in LINES:
        raise ConfigError(f"line: unknown kind {kind!r}; {did_you_mean(str(kind), LINES)}")
    try:
        return LINES[kind](**settings)
    except TypeError as error:
        raise ConfigError(f"line {kind}: {str(error).split(') ', 1)[-1]}") from None


def clearance(x: Array, y: Array, yaw: Array, body: Body, sections: Sequence[Section]) -> Array:
    """Smallest distance between the body's sides and the cones, by section [m]; negative where cones are hit.

    The sides are cut where a section begins and ends, and places between the samples count as well: a short section
    lies between two samples of a fast car, and a corner that goes in there is not overlooked by chance.

    Args:
        x: of the rear axle's centre (n) [m].
        y: the same [m].
        yaw: heading [rad].
        body: its size.
        sections: of the course.

    Returns:
        one number a section; inf where the body never was in it.
    """
    longest = float(np.max(np.hypot(np.diff(x), np.diff(y)), initial=0.0))
    parts = max(1, math.ceil(longest / (_BETWEEN * (body.front - body.rear))))
    at = np.arange((len(x) - 1) * parts + 1) / parts
    x, y, yaw = (np.interp(at, np.arange(len(x)), values) for values in (x, y, yaw))
    cos, sin = np.cos(yaw), np.sin(yaw)
    rooms = np.full(len(sections), np.inf)
    for side in (body.half_width, -body.half_width):
        (x0, x1), (y0, y1) = (
            [x + lever * cos - side * sin for lever in (body.rear, body.front)],
            [y + lever * sin + side * cos for lever in (body.rear, body.front)],
        )
        along = np.where(np.abs(x1 - x0) > 1e-9, x1 - x0, 1e-9)
        for number, section in enumerate(sections):
            cuts = ((section.x0 - x0) / along, (section.x1 - x0) / along)
            inside = (np.maximum(x0, x1) >= section.x0) & (np.minimum(x0, x1) <= section.x1)
            for cut in cuts:
                across = y0 + np.clip(cut, 0.0, 1.0) * (y1 - y0)
                room = np.minimum(section.high - across, across - section.low)
                rooms[number] = min(rooms[number], float(np.min(room, where=inside, initial=np.inf)))
    return rooms


def first_crossing(time: Array, values: Array, level: float) -> float:
    """First time at which a signal reaches a level from below, between the samples; NaN if never."""
    above = np.flatnonzero(values >= level)
    if not len(above):
        return math.nan
    index = int(above[0])
    if index == 0:
        return float(time[0])
    part = (level - values[index - 1]) / (values[index] - values[index - 1])
    return float(time[index - 1] + part * (time[index] - time[index - 1]))
