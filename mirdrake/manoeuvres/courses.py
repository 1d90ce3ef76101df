"""Lanes between cones, and lines through them, as pure geometry.

A section of a course is a range x0 .. x1 in which the whole body must stay between y_low and y_high. Cones are the
edges of sections; they are not bodies of the world.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
import scipy  # it imports its parts when they are first used

from mirdrake.core.errors import ConfigError
from mirdrake.manoeuvres.base import Array
from mirdrake.manoeuvres.by_kind import make_by_kind

_STRAIGHT = 0.002
"""Weight of the total curvature of a planned line against its largest curvature [1/m per rad]."""

_REACH = 60
"""Samples of a line to both sides of the last one among which the nearest is searched."""

_CHECK_STEP = 0.005
"""Largest distance between two positions at which the body is checked against the cones, over its length [1]."""


class Section(NamedTuple):
    """Range of x in which the body must stay between two lines of cones, `low` and `high` in y [m]; one may be inf."""

    x0: float
    x1: float
    low: float
    high: float


class Body(NamedTuple):
    """Body seen from above, relative to the rear axle's centre: rear end, front end, half of its width [m]."""

    rear: float
    front: float
    half_width: float


@dataclass(frozen=True)
class Line:
    """Line to follow, sampled at equal steps of the arc length.

    Attributes:
        s: arc length [m].
        x: coordinate of the world [m].
        y: coordinate of the world [m].
        yaw: unwrapped heading [rad].
        curvature: positive to the left [1/m].
    """

    s: Array
    x: Array
    y: Array
    yaw: Array
    curvature: Array

    @cached_property
    def table(self) -> Array:
        """Columns s, x, y, yaw, curvature (n, 5)."""
        return np.column_stack([self.s, self.x, self.y, self.yaw, self.curvature])


def project_line(line: Array, x: float, y: float, near: int) -> tuple[int, float, float]:
    """Return the index of the nearest sample, the arc length of the projection, and the offset to the left [m].

    Args:
        line: table of a line.
        x: coordinate of the point [m].
        y: coordinate of the point [m].
        near: index around which :data:`_REACH` samples are searched to both sides; -1: all are.
    """
    # The search around the last sample keeps the station where a line crosses itself, and is faster.
    low = 0 if near < 0 else max(0, near - _REACH)
    high = len(line) if near < 0 else min(len(line), near + _REACH)
    squared = (line[low:high, 1] - x) ** 2 + (line[low:high, 2] - y) ** 2
    if near < 0:  # a line of several laps passes the same point again: the first lap counts
        # Among all samples within one step of the nearest one take the first, with the samples that follow it.
        limit, first = (math.sqrt(np.min(squared)) + (line[1, 0] - line[0, 0])) ** 2, 0
        while squared[first] > limit:
            first += 1
        squared = squared[: first + _REACH]
    index = low + int(np.argmin(squared))

    # Project onto the tangent of the nearest sample; the parabola κ/2 x² corrects the offset for the curvature.
    yaw = float(line[index, 3])
    dx, dy = x - float(line[index, 1]), y - float(line[index, 2])
    along, lateral = dx * math.cos(yaw) + dy * math.sin(yaw), dy * math.cos(yaw) - dx * math.sin(yaw)
    lateral -= 0.5 * float(line[index, 4]) * along**2
    return index, float(line[index, 0]) + along, lateral


def line_at(line: Array, s: float) -> tuple[float, float]:
    """Return heading [rad] and curvature [1/m] of a table of a line at an arc length [m]."""
    step = float(line[1, 0] - line[0, 0])
    # 1.001 keeps index + 1 within the line.
    position = min(max((s - float(line[0, 0])) / step, 0.0), len(line) - 1.001)
    index = int(position)
    part = position - index
    yaw = float(line[index, 3]) * (1.0 - part) + float(line[index + 1, 3]) * part
    return yaw, float(line[index, 4]) * (1.0 - part) + float(line[index + 1, 4]) * part


def from_curvature(curvature: Array, step: float) -> Line:
    """Return a line from the origin along x with given curvatures [1/m] at equal steps [m]."""
    # Trapezoidal rule for curvature and direction: the error falls with the square of the step.
    heading = np.concatenate(([0.0], np.cumsum(0.5 * (curvature[1:] + curvature[:-1]) * step)))
    x = np.concatenate(([0.0], np.cumsum(0.5 * (np.cos(heading[1:]) + np.cos(heading[:-1])) * step)))
    y = np.concatenate(([0.0], np.cumsum(0.5 * (np.sin(heading[1:]) + np.sin(heading[:-1])) * step)))
    return Line(step * np.arange(len(curvature), dtype=np.float64), x, y, heading, curvature)


def straight(*, length: float) -> Line:
    """Return a straight line along x."""
    count = max(3, math.ceil(length / 0.5) + 1)
    return from_curvature(np.zeros(count, dtype=np.float64), length / (count - 1))


def circle(*, radius: float, turn: float = 1.0, laps: float = 1.0) -> Line:
    """Return laps of a circle that starts at the origin along x; `turn` is 1 to the left, -1 to the right."""
    step = min(0.25, radius / 40.0)
    count = math.ceil(2.0 * math.pi * radius * laps / step) + 1
    return from_curvature(np.full(count, math.copysign(1.0 / radius, turn)), step)


def eight(*, radius: float, laps: int = 2, ease: float = 0.0) -> Line:
    """Return laps to the right, then as many to the left, from the middle of a figure of eight along x.

    Args:
        radius: radius of both circles [m].
        laps: number of laps on each circle.
        ease: distance before and after the middle in which the curvature changes linearly from one circle to the other
            [m]; it moves both circles outwards by about ease² / (6 radius).
    """
    # At least 240 samples a lap, and at most 0.25 m between two of them.
    step = 2.0 * math.pi * radius / max(240, math.ceil(2.0 * math.pi * radius / 0.25))
    count = round(2.0 * math.pi * radius * laps / step)
    # From right (-1/R) to left (1/R) in the middle; a tenth more at the end gives a finishing run a line ahead.
    travelled = step * (np.arange(2 * count + count // 10) - count + 0.5)
    # A clip of a linear function is the transition (clothoid); without one it takes a tenth of a step.
    line = from_curvature(np.clip(travelled / max(ease, 0.1 * step), -1.0, 1.0) / radius, step)
    # Rotate and translate the line so that the centres are on the y axis, at equal distances from the origin.
    centres = [
        np.array([line.x[i] - turn * radius * np.sin(line.yaw[i]), line.y[i] + turn * radius * np.cos(line.yaw[i])])
        for i, turn in ((0, -1.0), (-1, 1.0))
    ]
    across, middle = centres[1] - centres[0], 0.5 * (centres[0] + centres[1])
    # atan2(across_x, across_y) is the angle from the y axis to the line between the centres.
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
    """Return the path of the rear axle's centre through sections with the least largest curvature, by a linear program.

    The curvature is approximated by y'', as slopes are small. Its derivative has a weight, so that a steering can
    follow, and its sum a small one, so that the path is straight where no bend is needed.

    Args:
        sections: sections of the course, see :class:`Section`; None for an open side.
        rear: rear end of the body, see :class:`Body` [m].
        front: front end of the body [m].
        half_width: half of the width of the body [m].
        margin: distance between body and cones [m]; half of the available room if there is less.
        end: x of the end of the path [m], where it is parallel to x.
        start: x of its start [m], where it is parallel to x.
        smoothness: length over which the curvature may reach its largest value [m].

    Raises:
        ConfigError: no path meets the bounds.
    """
    # At most 400 samples bound the size of the linear program; half a metre or a tenth of the body is fine enough.
    step = max((end - start) / 400.0, min(0.5, front / 10.0))
    x = np.arange(start, end + step, step)
    count = len(x)
    values: list[float] = []
    rows: list[int] = []
    columns: list[int] = []
    limits: list[float] = []
    size = 2 * count + 2  # y, largest |y''|, largest |y'''|, all |y''|

    # One row of A_ub z <= b_ub in coordinates, as a dense matrix would have millions of zeros.
    def add(coefficients: Mapping[int, float], limit: float) -> None:
        for index, value in coefficients.items():
            values.append(value)
            rows.append(len(limits))
            columns.append(index)
        limits.append(limit)

    # Bounds of the derivatives: |y''| and |y'''| at every sample.
    for i in range(1, count - 1):
        # A minimum of the largest absolute value is linear with bounds: |y''_i| <= w_i <= w_max, the same for y'''.
        add({count + 2 + i: 1.0, count: -1.0}, 0.0)
        for sign in (1.0, -1.0):
            add({i - 1: sign / step**2, i: -2.0 * sign / step**2, i + 1: sign / step**2, count + 2 + i: -1.0}, 0.0)
    # The third difference covers four samples, so the loop ends one sample earlier.
    for i in range(1, count - 2):
        for sign in (1.0, -1.0):
            cubic = sign / step**3
            add({i - 1: -cubic, i: 3.0 * cubic, i + 1: -3.0 * cubic, i + 2: cubic, count + 1: -1.0}, 0.0)
    # The body between the cones: five points of each side, with the slope of the path as its heading.
    for section in sections:
        x0, x1 = float(section[0] or 0.0), float(section[1] or 0.0)
        # An open side has no bound.
        low = -math.inf if section[2] is None else float(section[2])
        high = math.inf if section[3] is None else float(section[3])
        # A lane that is too narrow for the margin keeps half of its free space on each side, and remains feasible.
        clearance_kept = min(margin, max(0.0, 0.25 * (high - low - 2.0 * half_width))) + half_width
        for i in range(1, count - 1):
            for lever in np.linspace(rear, front, 5):
                # Half a step around the section counts as well, so that short sections have a sample.
                if not x0 - 0.5 * step <= x[i] + lever <= x1 + 0.5 * step:
                    continue
                # Lateral position of a body point: y + lever · slope, with the slope by central differences.
                slope = float(lever) / (2.0 * step)
                if high < math.inf:
                    add({i: 1.0, i + 1: slope, i - 1: -slope}, high - clearance_kept)
                if low > -math.inf:
                    add({i: -1.0, i + 1: -slope, i - 1: slope}, -clearance_kept - low)

    # The path begins straight along y = 0 and ends parallel to x.
    still = 4  # samples at the start without curvature
    fixed = np.zeros((still + 1, size))
    fixed[range(still), range(still)] = 1.0
    fixed[still, count - 1], fixed[still, count - 2] = 1.0, -1.0
    # Least largest curvature first; smoothness weighs its derivative, and a small weight the sum of |y''|.
    cost = np.zeros(size)
    cost[count], cost[count + 1] = 1.0, smoothness
    cost[count + 2 :] = _STRAIGHT * step
    # y is free, bounds of absolute values are not negative.
    bounds = [(None, None)] * count + [(0.0, None)] * (size - count)
    solution = scipy.optimize.linprog(
        cost,
        A_ub=scipy.sparse.csr_matrix((values, (rows, columns)), shape=(len(limits), size)),
        b_ub=np.array(limits),
        A_eq=fixed,
        b_eq=np.zeros(still + 1),
        bounds=bounds,
    )
    if not solution.success:
        raise ConfigError("there is no path through the course: the vehicle is too wide or too long for it")
    return resample(x, solution.x[:count])


def resample(x: Array, y: Array) -> Line:
    """Return a line through points at steps of equal chord length, with heading and curvature by differences."""
    # Samples of the linear program are even in x; a driver looks up the line by arc length.
    lengths = np.concatenate(([0.0], np.cumsum(np.hypot(np.diff(x), np.diff(y)))))
    s = np.linspace(0.0, lengths[-1], len(x))
    px, py = np.interp(s, lengths, x), np.interp(s, lengths, y)
    yaw = np.unwrap(np.arctan2(np.gradient(py, s), np.gradient(px, s)))
    return Line(s, px, py, yaw, np.gradient(yaw, s))


LINES: dict[str, Callable[..., Line]] = {"straight": straight, "circle": circle, "eight": eight, "within": within}


def make_line(data: Mapping[str, object]) -> Line:
    """Return a line from ``{kind: circle, radius: 100, turn: 1}``, see :func:`make_by_kind`."""
    return make_by_kind(data, LINES, what="line")


def clearance(x: Array, y: Array, yaw: Array, body: Body, sections: Sequence[Section]) -> Array:
    """Return the smallest distance between the sides of the body and the cones by section [m]; negative for a hit.

    The sides are cut at the ends of a section. Positions between the samples are interpolated, as a section may be
    shorter than the distance that a fast car travels between two samples.

    Args:
        x: positions of the rear axle's centre (n) [m].
        y: the same (n) [m].
        yaw: heading (n) [rad].
        body: size of the body.
        sections: sections of the course.

    Returns:
        a distance for each section; inf where the body never was in it.
    """
    # The longest step of the record decides how many positions are checked between two samples.
    longest = float(np.max(np.hypot(np.diff(x), np.diff(y)), initial=0.0))
    parts = max(1, math.ceil(longest / (_CHECK_STEP * (body.front - body.rear))))
    positions = np.arange((len(x) - 1) * parts + 1) / parts
    x, y, yaw = (np.interp(positions, np.arange(len(x)), values) for values in (x, y, yaw))
    cos, sin = np.cos(yaw), np.sin(yaw)
    rooms = np.full(len(sections), np.inf)
    for side in (body.half_width, -body.half_width):
        # x0, y0 is the rear corner and x1, y1 the front corner of this side.
        (x0, x1), (y0, y1) = (
            [x + lever * cos - side * sin for lever in (body.rear, body.front)],
            [y + lever * sin + side * cos for lever in (body.rear, body.front)],
        )
        # A side across the course (x0 = x1) would divide by zero.
        along = np.where(np.abs(x1 - x0) > 1e-9, x1 - x0, 1e-9)
        for number, section in enumerate(sections):
            # Positions along the side (0 rear, 1 front) at which the section begins and ends; clipped to the side
            # below.
            cuts = ((section.x0 - x0) / along, (section.x1 - x0) / along)
            inside = (np.maximum(x0, x1) >= section.x0) & (np.minimum(x0, x1) <= section.x1)
            for cut in cuts:
                across = y0 + np.clip(cut, 0.0, 1.0) * (y1 - y0)
                # Smallest distance to the two lines of cones; negative beyond one of them.
                room = np.minimum(section.high - across, across - section.low)
                rooms[number] = min(rooms[number], float(np.min(room, where=inside, initial=np.inf)))
    return rooms
