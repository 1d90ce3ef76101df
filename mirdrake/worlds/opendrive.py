"""Roads from OpenDRIVE files (.xodr, 1.4 to 1.8): one road or a chain of them, as pieces and edges of a track.

After ASAM OpenDRIVE, chapters "Geometry" and "Lanes": the reference line of a road is a row of geometries, each with
its own pose and length. Lines, arcs and spirals become pieces of linear curvature; `poly3` and `paramPoly3` are
sampled and fitted, and so is a reference line whose geometries do not meet. Lanes are side by side
from the reference line, shifted by `laneOffset`, with widths or borders that are cubic in s. Heights, junctions,
signals and objects are left out, and listed.

::

    .xodr ── parse_opendrive ──► elements, their lines       opendrive_parts.py
    <geometry> ── read_leg ──► Leg                           opendrive_parts.py
    <road> ──► RoadPart: legs, edges of its lanes                opendrive_lanes.py
    parts end to end ── read_opendrive ──► OpenDriveRoad     here
"""

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from mirdrake.core.errors import ConfigError, WorldError, did_you_mean
from mirdrake.core.yaml_io import display_path
from mirdrake.worlds.centre_lines import edges_from_widths, pieces_through
from mirdrake.worlds.opendrive_lanes import RoadPart
from mirdrake.worlds.opendrive_parts import LONGEST, Leg, parse_opendrive
from mirdrake.worlds.pieces import Array, Piece, Placement, advance
from mirdrake.worlds.tracks import Track

_EXACT = (1e-4, 1e-4)  # [m], [rad] largest gaps between geometries that are joined exactly
_APART = (0.5, 0.5)  # [m], [rad] largest gaps between geometries
_TOLERANCE = 2e-4  # [m] of fitted curves
_RAMP = 0.1  # [m] over which a step in width is spread
_THINNEST = 0.01  # [m] least width to either side
_WIDEST = 500.0  # [m]


@dataclass(frozen=True)
class OpenDriveRoad:
    """A road, or a chain of roads, of an OpenDRIVE file: the arguments of a :class:`Track`."""

    name: str
    """name of the road in the file, else its id; of a chain the first and the last"""
    pieces: list[Piece]
    """the centre line"""
    start: Placement
    """x [m], y [m] and yaw [rad] at s = 0"""
    closed: bool
    """its end meets its start"""
    s: Array
    """stations of the widths [m], from 0 to the length"""
    left: Array
    """distance [m] of the left edge of the lanes from the centre line at s"""
    right: Array
    """distance [m] of the right edge at s"""
    left_out: list[str]
    """parts of the file that are left out or approximated, one line each"""

    @property
    def length(self) -> float:
        """Length of the centre line [m]."""
        return math.fsum(piece.length for piece in self.pieces)

    @property
    def edges(self) -> tuple[Array, Array, Array]:
        """Argument `edges` of :class:`mirdrake.worlds.Track`."""
        return self.s, self.left, self.right


def read_opendrive(path: str | Path, *, road: str | None = None, lane: str = "driving") -> OpenDriveRoad:
    """Read a road of an OpenDRIVE file.

    Args:
        path: the file.
        road: id of the road, or several in driving order, separated by commas. None selects the only road outside
            junctions, or all of them if their links form one chain.
        lane: type of the lanes that form the road, from the leftmost to the rightmost of them, or the id of one lane.
            If the reference line is not within them, the centre line is moved there.

    Raises:
        ConfigError: the file or the road is invalid, or the road does not exist.
    """
    path = Path(path)

    # Roads are joined in the order in which they connect; widths are sampled along all of them.
    root, places = parse_opendrive(path)
    roads = {element.get("id", ""): element for element in root.iterfind("road")}
    if not roads:
        raise ConfigError("contains no road", where=places[root])
    ids = _choose(road, roads, display_path(path))
    parts = [RoadPart(roads[key], lane, places) for key in ids]
    legs, (s, top, bottom), closed = _join(parts)
    where = parts[0].where
    if sum(leg.length for leg in legs) > LONGEST:
        raise ConfigError(f"longer than {LONGEST / 1e3:g} km; choose fewer roads", where=where)
    # A wrong coefficient of a cubic width soon reaches kilometres, which no road has.
    if max(np.abs(top).max(), np.abs(bottom).max()) > _WIDEST:
        raise ConfigError(f"lanes reach {_WIDEST:g} m beside the reference line; correct their widths", where=where)

    # The centre line is between the edges: on the reference line, or moved by a steady offset, or in their middle.
    left_out = _left_out(root, roads, ids, lane)
    middle = np.zeros_like(s)
    if top.min() < _RAMP or bottom.max() > -_RAMP:
        # A constant offset keeps lines and arcs exact, so it is preferred where it is within the lanes everywhere.
        steady = top.min() - bottom.max() > 2.0 * _RAMP
        middle = np.full_like(s, (top.min() + bottom.max()) / 2.0) if steady else (top + bottom) / 2.0
        how = f"{middle[0]:.3g} m to the left" if steady else "to the middle of the lanes"
        left_out.append(f"reference line: not within the lanes '{lane}'; the centre line is moved {how}")
    # Widths are measured from the moved centre line; t is positive to the left.
    left, right = top - middle, middle - bottom
    if min(left.min(), right.min()) < _THINNEST:
        left_out.append(f"widths below {_THINNEST:g} m to one side: made {_THINNEST:g} m")
        left, right = np.maximum(left, _THINNEST), np.maximum(right, _THINNEST)

    # Lines, arcs and spirals become pieces exactly if the centre line is parallel to them; other geometries are fitted.
    name = " .. ".join(dict.fromkeys((parts[0].name, parts[-1].name)))
    pieces = _exact(legs, closed, middle)
    if pieces is not None:
        # The offset is constant here, so that the start only moves to the left by it.
        x, y, yaw = legs[0].begin
        start = (x - middle[0] * math.sin(yaw), y + middle[0] * math.cos(yaw), yaw)
        ends = np.cumsum([0.0] + [leg.length for leg in legs])
        # The moved centre line is shorter or longer in bends; stations are transferred piece by piece.
        s = np.interp(s, ends, np.cumsum([0.0] + [piece.length for piece in pieces]))
        return OpenDriveRoad(name, pieces, start, closed, s, left, right, left_out)
    left_out.append(f"reference line: fitted within {1e3 * _TOLERANCE:g} mm ({_why(legs, closed)})")
    points, stations = _sample(legs, closed, s, middle)
    try:
        pieces, start = pieces_through(points, closed=closed, tolerance=_TOLERANCE)
        track = Track(pieces, start=start, closed=closed)
        edges = edges_from_widths(track, points, np.interp(stations, s, left), np.interp(stations, s, right))
    except WorldError as error:
        raise ConfigError(f"road '{name}': {error}", where=where) from None
    return OpenDriveRoad(name, pieces, start, closed, *edges, left_out)


# --- which roads -------------------------------------------------------------------------------------------------


def _choose(road: str | None, roads: Mapping[str, Element], name: str) -> list[str]:
    """Return the ids of the roads in driving order.

    Raises:
        ConfigError: a road does not exist, or no road is selected and they do not form one chain.
    """
    if road is not None:
        ids = [road] if road in roads else [key.strip() for key in str(road).split(",")]
        for key in ids:
            if key not in roads:
                raise ConfigError(f"no road '{key}'; {did_you_mean(key, roads)}", where=name)
        return ids

    # Roads of junctions overlap each other and cannot be a part of the chain.
    free = [key for key, element in roads.items() if element.get("junction", "-1") in {"-1", ""}] or list(roads)
    links: dict[str, dict[str, str]] = {key: dict(_links(roads[key], free)) for key in free}
    # Links of both directions, because files often state only one of the two.
    beside = {
        key: list(dict.fromkeys([*links[key].values(), *(other for other in free if key in links[other].values())]))
        for key in free
    }
    ends = [key for key in free if len(beside[key]) < 2]
    # A chain begins at an end that has no predecessor, so that it is driven in the direction of its road.
    first = next((key for key in ends if "predecessor" not in links[key]), (ends or free)[0])
    chain, following = [first], links[first].get("successor", next(iter(beside[first]), ""))
    while following and following not in chain:
        chain.append(following)
        following = next((key for key in beside[following] if key not in chain), "")
    # A road with three neighbours is a branch, even if all roads were visited.
    if len(chain) < len(free) or any(len(neighbours) > 2 for neighbours in beside.values()):
        raise ConfigError(
            f"its {len(free)} roads do not form one chain; select one, or several as '1, 7, 2'; "
            f"{did_you_mean('', free)}",
            where=name,
        )
    return chain


def _links(road: Element, among: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Yield predecessor and successor of a road, if they are among some roads."""
    for key in ("predecessor", "successor"):
        link = road.find(f"link/{key}")
        other = "" if link is None or link.get("elementType") != "road" else link.get("elementId", "")
        if other in among and other != road.get("id"):
            yield key, other


# --- roads end to end --------------------------------------------------------------------------------------------


def _miss(a: Placement, b: Placement) -> tuple[float, float]:
    """Return the distance [m] and the difference in heading [rad] between two poses."""
    return math.hypot(a[0] - b[0], a[1] - b[1]), abs(math.remainder(a[2] - b[2], 2.0 * math.pi))


def _join(parts: Sequence[RoadPart]) -> tuple[list[Leg], tuple[Array, Array, Array], bool]:
    """Return legs and edges of all roads, reversed where necessary, and whether the end meets the start.

    Raises:
        ConfigError: two geometries or two roads do not meet.
    """
    legs: list[Leg] = []
    stations: list[Array] = []
    tops: list[Array] = []
    bottoms: list[Array] = []
    for part in parts:
        turned = [leg.reversed() for leg in reversed(part.legs)]
        # The first road ends at an end of the second; every other begins where the one before ends.
        follow = [parts[1].legs[0].begin, parts[1].legs[-1].end] if len(parts) > 1 else [part.legs[-1].end]
        misses = [
            _miss(legs[-1].end, run[0].begin)[0] if legs else min(_miss(run[-1].end, end)[0] for end in follow)
            for run in (part.legs, turned)
        ]
        # Reversed only where the given direction does not fit and the other one fits better.
        back = misses[0] > _APART[0] and misses[1] < misses[0]
        travelled = sum(leg.length for leg in legs)
        for leg in turned if back else part.legs:
            gap = _miss(legs[-1].end, leg.begin) if legs else (0.0, 0.0)
            if gap[0] > _APART[0] or gap[1] > _APART[1]:
                raise ConfigError(
                    f"begins {gap[0]:.3g} m and {math.degrees(gap[1]):.3g} deg away from the end of the "
                    f"one before, at {legs[-1].where}; correct x, y, hdg or length, or the order of the roads",
                    where=leg.where,
                )
            legs.append(leg)
        stations.append(travelled + (part.length - part.s[::-1] if back else part.s))
        # Seen in the opposite direction, left and right are exchanged and t changes its sign.
        tops.append(-part.bottom[::-1] if back else part.top)
        bottoms.append(-part.top[::-1] if back else part.bottom)
    gap = _miss(legs[-1].end, legs[0].begin)
    # A road shorter than the tolerance would otherwise count as closed.
    closed = gap[0] < _APART[0] and gap[1] < _APART[1] and sum(leg.length for leg in legs) > 4.0 * _APART[0]
    s, top, bottom = (np.concatenate(values) for values in (stations, tops, bottoms))
    if (
        closed and max(abs(top[-1] - top[0]), abs(bottom[-1] - bottom[0])) > 1e-6
    ):  # the step at the seam comes before it
        s, top, bottom = np.append(s, s[-1]), np.append(top, top[0]), np.append(bottom, bottom[0])
    return legs, _spread_steps(s, top, bottom), closed


def _spread_steps(s: Array, top: Array, bottom: Array) -> tuple[Array, Array, Array]:
    """Return increasing stations: of two equal ones the first is removed, or moved back by 0.1 m if the edges step."""
    # Edges may jump at a station, but widths must be functions of s: the step becomes a ramp.
    same = np.append(np.diff(s) < 1e-6, False)
    step = np.append(np.maximum(np.abs(np.diff(top)), np.abs(np.diff(bottom))) > 1e-4, False)
    # At most half of the distance to the station before, so that stations keep increasing.
    before = np.append(s[0] - 2.0 * _RAMP, s[:-1])
    moved = np.where(same & step, s - np.minimum(_RAMP, (s - before) / 2.0), s)
    keep = (~same | step) & np.append(np.diff(moved) > 1e-9, True)
    moved[0] = 0.0
    return moved[keep], top[keep], bottom[keep]


def _exact(legs: Sequence[Leg], closed: bool, middle: Array) -> list[Piece] | None:
    """Return the pieces of the legs, moved sideways by a constant offset; None if they cannot be joined exactly."""
    offset = float(middle[0])
    if np.ptp(middle) > 1e-9 or any(leg.piece is None for leg in legs):
        return None
    pose, pieces = legs[0].begin, []
    for leg in legs:
        assert leg.piece is not None
        # The pose is advanced piece by piece, so that errors of the stated geometries add up and are noticed.
        apart = _miss(pose, leg.begin)
        length, first, last = leg.piece
        # Parallel curves: arcs remain arcs of another radius, but the parallel of a spiral is not a spiral.
        shrink = 1.0 - offset * first
        if apart[0] > _EXACT[0] or apart[1] > _EXACT[1] or (offset and first != last) or shrink < 0.05:
            return None
        pose = advance(pose, leg.piece)
        pieces.append(Piece(length * shrink, first / shrink, last / shrink) if offset else leg.piece)
    apart = _miss(pose, legs[0].begin)
    return None if closed and (apart[0] > _EXACT[0] or apart[1] > _EXACT[1]) else pieces


def _why(legs: Sequence[Leg], closed: bool) -> str:
    """Return the reason why the geometries are approximated instead of used exactly."""
    kinds = sorted({leg.kind for leg in legs if leg.piece is None})
    pairs = [*itertools.pairwise(legs), *([(legs[-1], legs[0])] if closed else [])]
    gaps = [_miss(a.end, b.begin) for a, b in pairs] or [(0.0, 0.0)]
    gap, kink = max(gap for gap, _ in gaps), math.degrees(max(kink for _, kink in gaps))
    apart = [f"gaps of up to {gap:.2g} m and {kink:.2g} deg"] if gap > 1e-6 or kink > 1e-4 else []
    return ", ".join(kinds + apart) or "moved spirals or widths"


def _sample(legs: Sequence[Leg], closed: bool, s: Array, middle: Array) -> tuple[Array, Array]:
    """Return points of the centre line, N x 2, and their s along the reference line [m]."""
    total = sum(leg.length for leg in legs)
    # At least 32 points, and at most 20 000, whatever the length of the road.
    step = max(min(1.0, total / 32.0), total / 20_000.0)
    points: list[Array] = []
    stations: list[Array] = []
    travelled = 0.0
    for i, leg in enumerate(legs):
        # The end of a leg is the begin of the next one, and that of a closed line its first point.
        last = i == len(legs) - 1 and not closed
        parts = max(1, math.ceil(leg.length / step))
        u = leg.length * np.arange(parts + last) / parts
        x, y, yaw = leg.pose(u)
        t = np.interp(travelled + u, s, middle)
        points.append(np.column_stack((x - t * np.sin(yaw), y + t * np.cos(yaw))))
        stations.append(travelled + u)
        travelled += leg.length
    places, station = np.vstack(points), np.concatenate(stations)
    # Nearly equal points, at gaps between geometries, would bend the fitted curve.
    far = np.concatenate(([True], np.hypot(*np.diff(places, axis=0).T) > 0.1 * step))
    far[-1] &= not closed or math.dist(places[-1], places[0]) > 0.1 * step
    return places[far], station[far]


# --- omissions ---------------------------------------------------------------------------------------------------

_HEIGHTS = (
    "elevationProfile/elevation",
    "lateralProfile/superelevation",
    "lateralProfile/crossfall",
    "lateralProfile/shape",
)


def _left_out(root: Element, roads: Mapping[str, Element], ids: Sequence[str], lane: str) -> list[str]:
    """Return the parts of the file that a track does not represent, one line each."""
    chosen = [roads[key] for key in ids]
    notes = []
    heights = [part for road in chosen for path in _HEIGHTS for part in road.iterfind(path)]
    # A coefficient is 0 if nothing is left without the characters of a zero, such as those of -0.0e+00.
    if any((part.get(key) or "0").strip("-+.0eE") for part in heights for key in "abcd"):
        notes.append("heights and slopes: the road is flat")
    if len(ids) < len(roads):
        notes.append(f"other roads: {len(roads) - len(set(ids))}")
    for title, path in (("signals", "signals/signal"), ("objects", "objects/object"), ("road marks", ".//roadMark")):
        if lines := sum(1 for road in chosen for _ in road.iterfind(path)):
            notes.append(f"{title}: {lines}")
    if lines := sum(1 for _ in root.iterfind("junction")):
        notes.append(f"junctions: {lines}")
    lanes = {e.get("type", "") for road in chosen for e in road.iter("lane") if e.get("id") != "0"}
    if others := sorted(kind for kind in lanes if kind != lane):
        notes.append(f"lanes other than '{lane}', unless they are between: {', '.join(others)}")
    offset = root.find("header/offset")
    if offset is not None and any((offset.get(key) or "0").strip("-+.0eE") for key in ("x", "y", "hdg")):
        notes.append("offset of the header: positions are those of the roads")
    return notes
