"""Parts of OpenDRIVE files: the tree of elements with their lines, and the geometries of a reference line.

After ASAM OpenDRIVE, chapter "Geometry": every geometry has a pose and a length, and is a line, an arc, a spiral, a
cubic over u (`poly3`) or two cubics over a parameter (`paramPoly3`). Profiles over s are rows of cubics.
"""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from mirdrake.core.errors import ConfigError
from mirdrake.core.xml_reader import parse_xml, read_xml_bytes
from mirdrake.core.yaml_io import display_path
from mirdrake.worlds.pieces import Array, Piece, Placement, advance
from mirdrake.worlds.tracks import Track

_LARGEST = 100_000_000  # bytes
_LARGEST_NUMBER = 1e8
SAME = 1e-6
"""Distance of stations that are one [m]."""
LONGEST = 1e5
"""Longest road [m]."""

# --- XML ---------------------------------------------------------------------------------------------------------

Places = Mapping[Element, str]


def parse_opendrive(path: Path) -> tuple[Element, Places]:
    """Return a file as a tree without name spaces, with ``file:line`` of every element.

    Raises:
        ConfigError: the file cannot be read, is not XML or not OpenDRIVE, or declares entities.
    """
    data = read_xml_bytes(path, largest=_LARGEST, error=ConfigError, advice="cut out the roads that are needed")
    document = parse_xml(data, display_path(path), error=ConfigError, prefixes=False)
    root = document.root
    if root.tag != "OpenDRIVE":
        raise ConfigError(f"<{root.tag}> is not OpenDRIVE, whose root is <OpenDRIVE>", where=document.where(root))
    return root, {element: document.where(element) for element in document.lines}


def number_of(element: Element, key: str, places: Places, default: float | None = None) -> float:
    """Return an attribute as a number within ±1e8.

    Raises:
        ConfigError: the attribute is not such a number, or is missing and has no default.
    """
    text = element.get(key)
    if text is None and default is not None:
        return default
    if text is None:
        raise ConfigError(f"<{element.tag}> has no '{key}'; give it a number", where=places[element])
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    # `not <=` also rejects NaN, which is the value of a text that is not a number.
    if not abs(value) <= _LARGEST_NUMBER:
        raise ConfigError(
            f"{key} '{text[:40]}' of <{element.tag}> should be a number within ±1e8", where=places[element]
        )
    return value


@dataclass(frozen=True)
class Cubics:
    """Cubic polynomials, each valid from its start to the next one."""

    rows: Array
    """start [m], a, b, c and d, N x 5, sorted"""

    @staticmethod
    def read(elements: Iterable[Element], key: str, places: Places, *, begin: float = 0.0) -> "Cubics":
        """Return the polynomials of elements whose start is begin + their attribute `key`.

        Of several that begin at the same station, all but the last one have no length; some files have NaN there.
        """
        last = {begin + number_of(e, key, places): e for e in elements}
        rows = [[s, *(number_of(last[s], name, places) for name in "abcd")] for s in sorted(last)]
        return Cubics(np.array(rows, dtype=float).reshape(-1, 5))

    def __call__(self, s: Array, at: float) -> tuple[Array, Array, Array]:
        """Return values and two derivatives at s by the polynomial that is valid at the station `at`; 0 without one."""
        valid = np.flatnonzero(self.rows[:, 0] <= at + SAME)
        if not valid.size:
            return np.zeros_like(s), np.zeros_like(s), np.zeros_like(s)
        begin, a, b, c, d = self.rows[valid[-1]]
        u = s - begin
        return a + u * (b + u * (c + u * d)), b + u * (2.0 * c + u * 3.0 * d), 2.0 * c + 6.0 * d * u


# --- the reference line ------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Leg:
    """A geometry of a reference line, in driving direction."""

    where: str
    kind: str
    length: float
    begin: Placement
    end: Placement
    piece: Piece | None
    """None for polynomials"""
    pose: Callable[[Array], tuple[Array, Array, Array]]
    """x, y and yaw at distances from the start"""

    def reversed(self) -> "Leg":
        """Return the leg in the opposite direction."""

        def pose(u: Array) -> tuple[Array, Array, Array]:
            x, y, yaw = self.pose(self.length - u)
            return x, y, yaw + math.pi

        (x0, y0, yaw0), (x1, y1, yaw1) = self.begin, self.end
        old = self.piece
        # Driven backwards, a left bend is a right one, and the end comes first.
        piece = None if old is None else Piece(old.length, -old.end_curvature, -old.start_curvature)
        begin, end = (x1, y1, yaw1 + math.pi), (x0, y0, yaw0 + math.pi)
        return replace(self, begin=begin, end=end, piece=piece, pose=pose)


def read_leg(geometry: Element, places: Places) -> Leg | None:
    """Return a geometry, or None if its length is 0."""
    where = places[geometry]
    x, y, yaw, length = (number_of(geometry, key, places) for key in ("x", "y", "hdg", "length"))
    if not 0.0 <= length <= LONGEST:
        raise ConfigError(f"length {length:g} m of <geometry>; it must be from 0 to {LONGEST:g} m", where=where)
    if length < 1e-6:
        return None
    shape = next(iter(geometry), None)
    kind = "" if shape is None else shape.tag
    if shape is None or kind not in {"line", "arc", "spiral", "poly3", "paramPoly3"}:
        raise ConfigError(f"<geometry> contains '{kind}'; use line, arc, spiral, poly3 or paramPoly3", where=where)
    # Polynomials have no closed arc length: their pose is a function, sampled at both ends for the checks of joints.
    if kind in {"poly3", "paramPoly3"}:
        pose = _read_polynomial(shape, (x, y, yaw), length, places)
        x0, y0, yaw0 = (float(v[0]) for v in pose(np.array([0.0])))
        x1, y1, yaw1 = (float(v[0]) for v in pose(np.array([length])))
        return Leg(where, kind, length, (x0, y0, yaw0), (x1, y1, yaw1), None, pose)
    # Lines, arcs and spirals are clothoids with constant or linear curvature: one piece of a track each.
    first = last = 0.0
    if kind == "arc":
        first = last = number_of(shape, "curvature", places)
    elif kind == "spiral":
        first, last = number_of(shape, "curvStart", places), number_of(shape, "curvEnd", places)
    piece = Piece(length, first, last)

    # A curvature given as a radius, or in other units, would give a track of thousands of turns.
    if max(abs(first), abs(last)) > 100.0 or length * max(abs(first), abs(last)) > 1e3:
        raise ConfigError(f"curvature {max(first, last, key=abs):g} 1/m of <{kind}> is too large", where=places[shape])

    def along(u: Array) -> tuple[Array, Array, Array]:
        return Track([piece], start=(x, y, yaw)).pose(u)

    return Leg(where, kind, length, (x, y, yaw), advance((x, y, yaw), piece), piece, along)


def _read_polynomial(
    shape: Element, start: Placement, length: float, places: Places
) -> Callable[[Array], tuple[Array, Array, Array]]:
    """Return poses along a `poly3` (v over u) or a `paramPoly3` (u and v over p), by arc length.

    Without `pRange` p ends at 1 or at the length, whichever gives the better length of the curve.
    """
    if shape.tag == "poly3":
        # v = a + b u + c u² + d u³ over u itself: u is a polynomial, too, with the coefficients 0, 1, 0, 0.
        v = [number_of(shape, key, places) for key in "abcd"]
        u, ends = [0.0, 1.0, 0.0, 0.0], [length]
    else:
        u, v = ([number_of(shape, f"{key}{axis}", places) for key in "abcd"] for axis in "UV")
        # Files of both kinds leave pRange out; the stated length then decides.
        ends = {"arcLength": [length], "normalized": [1.0]}.get(shape.get("pRange", ""), [1.0, length])
    along, across = (np.polynomial.Polynomial(c) for c in (u, v))
    tables = []
    for end in ends:
        # Arc length as a table over p, because a cubic curve has no closed form of it.
        p = np.linspace(0.0, end, max(65, math.ceil(4.0 * length) + 1))
        speed = np.hypot(along.deriv()(p), across.deriv()(p))
        middle = (p[1:] + p[:-1]) / 2.0
        halfway = np.hypot(along.deriv()(middle), across.deriv()(middle))
        travelled = np.append(0.0, np.cumsum((speed[:-1] + 4.0 * halfway + speed[1:]) / 6.0 * np.diff(p)))  # Simpson
        tables.append((abs(travelled[-1] - length), p, travelled))
    _, p, travelled = min(tables, key=lambda table: float(table[0]))
    if shape.tag == "poly3":  # u ends at the given length
        p, travelled = p[travelled < length], travelled[travelled < length]
        rest = length - travelled[-1]
        # The last point by one step at the speed there: the table is fine enough for a linear remainder.
        p = np.append(p, p[-1] + rest / math.hypot(1.0, float(across.deriv()(p[-1]))))
        travelled = np.append(travelled, length)
    # A length wrong by a factor of two comes from wrong coefficients, not from rounding in the file.
    if not np.isfinite(travelled).all() or not 0.5 < travelled[-1] / length < 2.0 or (np.diff(travelled) <= 0.0).any():
        raise ConfigError(
            f"<{shape.tag}> is {travelled[-1]:.4g} m long, but its <geometry> states {length:.4g} m; "
            "correct the length, the coefficients or pRange",
            where=places[shape],
        )
    x0, y0, yaw0 = start
    c, s = math.cos(yaw0), math.sin(yaw0)

    def pose(station: Array) -> tuple[Array, Array, Array]:
        # Stations are scaled, so that the geometry ends where the next one begins, in spite of a rounded length.
        q = np.interp(station * (travelled[-1] / length), travelled, p)
        a, b = along(q), across(q)
        yaw = yaw0 + np.arctan2(across.deriv()(q), along.deriv()(q))
        return x0 + c * a - s * b, y0 + s * a + c * b, yaw

    return pose
