"""Medial axis of an area: the line with equal distance from both edges of a road.

The medial axis of a polygon is approximated by the Voronoi diagram of points on its boundary
(J. W. Brandt, V. R. Algazi, "Continuous skeleton computation by Voronoi diagram", CVGIP 55, 1992).
"""

import math
from collections import deque

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.spatial import QhullError, Voronoi
from shapely.ops import substring

from mirdrake.importing.worlds.model import Array

_MOST_POINTS = 5000  # on the boundary of an area
_STRAIGHT_ON = -0.5  # cosine between the directions away from a junction: a road that goes on turns by less than 60°


def medial_line(area: shapely.Polygon, width: float, *, narrowest: float) -> tuple[Array, Array]:
    """Return the longest line along the middle of an area, and its distance from the boundary at each point.

    Args:
        area: the area [m].
        width: its mean width [m].
        narrowest: least distance from the boundary, in widths.

    Returns:
        points (n, 2) [m] and distances (n) [m]; the last point of a closed line is the first. Empty without a line.
    """
    none = np.zeros((0, 2)), np.zeros(0)
    # Points on the boundary at a quarter of the width give a medial axis without gaps.
    simple = shapely.simplify(area, 0.02 * width)
    step = max(width / 4.0, simple.length / _MOST_POINTS)
    points = np.concatenate([shapely.get_coordinates(shapely.segmentize(ring, step)) for ring in
                             (simple.exterior, *simple.interiors)])  # fmt: skip
    try:
        diagram = Voronoi(np.unique(np.round(points, 6), axis=0))
    except (QhullError, ValueError):
        return none
    shapely.prepare(simple)
    vertices = diagram.vertices
    inside = shapely.contains_xy(simple, *vertices.T)
    clear = shapely.distance(shapely.points(vertices), simple.boundary)
    # Near the boundary the axis branches into each corner.
    inside &= clear > narrowest * width
    # Ridges with the index -1 extend to infinity (Voronoi of SciPy).
    edges: NDArray[np.int64] = np.array(
        [pair for pair in diagram.ridge_vertices if min(pair) >= 0], dtype=np.int64
    ).reshape(-1, 2)
    edges = edges[inside[edges].all(axis=1) & (edges[:, 0] != edges[:, 1])]
    if not len(edges):
        return none
    edges = _pruned(edges, vertices, 0.75 * width)
    if not len(edges):
        return none

    # A circuit has one long ring; a junction has small ones, where the path is the better line. The ring of a circuit
    # that crosses itself, as an eight, turns back at the crossing, where the road goes straight on.
    ring = _outer_ring(edges, vertices)
    path = _longest_path(edges, vertices)
    through = straight_circuit(edges, vertices, clear, width)
    line = path
    if ring is not None and _length(ring) > max(0.5 * _length(path), 4.0 * width):
        line = ring
    if _length(through) > 0.9 * _length(line):
        line = through
    return line, np.asarray(shapely.distance(shapely.points(line), simple.boundary))


def _length(line: Array) -> float:
    return float(np.hypot(*np.diff(line, axis=0).T).sum()) if len(line) > 1 else 0.0


def _pruned(edges: NDArray[np.int64], vertices: Array, shortest: float) -> NDArray[np.int64]:
    """Return edges without branches shorter than a length [m]."""
    lengths = np.hypot(*(vertices[edges[:, 0]] - vertices[edges[:, 1]]).T)
    alive = np.ones(len(edges), dtype=bool)
    beside: dict[int, list[int]] = {}
    for index, (a, b) in enumerate(edges.tolist()):
        beside.setdefault(a, []).append(index)
        beside.setdefault(b, []).append(index)
    # A short branch from a tip to a fork is noise of the boundary.
    for tip in [vertex for vertex, near in beside.items() if len(near) == 1]:
        # Follow the branch from its tip until it is long enough, ends, or meets another one.
        branch: list[int] = []
        total, vertex = 0.0, tip
        while total < shortest:
            ways = [index for index in beside[vertex] if alive[index] and index not in branch[-1:]]
            if len(ways) != 1 or (branch and ways[0] in branch):
                break
            branch.append(ways[0])
            total += lengths[ways[0]]
            a, b = edges[ways[0]].tolist()
            vertex = b if a == vertex else a
        # A tip that does not end at a fork is a line by itself and stays, however short.
        at_fork = sum(bool(alive[index]) for index in beside[vertex]) > 2
        if branch and total < shortest and at_fork:
            alive[branch] = False
    remaining: NDArray[np.int64] = edges[alive]
    return remaining


def _outer_ring(edges: NDArray[np.int64], vertices: Array) -> Array | None:
    """Return the outermost closed line of edges; None if there is none."""
    faces = shapely.get_parts(shapely.polygonize([shapely.LineString(vertices[edge]) for edge in edges]))
    if not len(faces):
        return None
    whole = max(shapely.get_parts(shapely.union_all(faces)), key=shapely.area)
    ring: Array = shapely.get_coordinates(shapely.get_exterior_ring(whole))
    return ring


def straight_circuit(edges: NDArray[np.int64], vertices: Array, clear: Array, width: float) -> Array:
    """Return the longest closed line that goes straight on at each junction; empty if there is none.

    Where four roads meet, the medial axis has two forks close to each other; forks are one junction if their inscribed
    circles touch.
    At a junction the branches are paired, the straightest pair first; a branch without a partner ends there.

    Args:
        edges: pairs of vertices (n, 2).
        vertices: places (m, 2) [m].
        clear: distance of each vertex from the boundary (m) [m].
        width: mean width of the road [m].
    """
    junction, branches = _branches(edges, vertices, clear)
    follows = _straight_on(junction, branches, vertices, width)
    best: Array = np.zeros((0, 2))
    unused = set(follows)
    while unused:
        end = first = min(unused)
        line: list[Array] = []
        # Along a branch from this end to the other, then into the branch that goes straight on.
        while end in unused:
            unused -= {end, other := (end[0], 1 - end[1])}
            branch = branches[end[0]]
            places = vertices[branch if end[1] == 0 else branch[::-1]]
            line.append(_without_ends(places, 0.75 * width))
            if other not in follows:
                break
            end = follows[other]
        if line and end == first:
            closed = np.vstack((*line, line[0][:1]))
            best = max(best, closed, key=_length)
    return best


def _branches(edges: NDArray[np.int64], vertices: Array, clear: Array) -> tuple[dict[int, int], list[list[int]]]:
    """Return the junction of each fork, and the branches between junctions as lists of vertices."""
    beside: dict[int, set[int]] = {}
    for a, b in edges.tolist():
        beside.setdefault(a, set()).add(b)
        beside.setdefault(b, set()).add(a)
    # Dead ends are not part of a circuit.
    tips = deque(vertex for vertex, near in beside.items() if len(near) == 1)
    while tips:
        tip = tips.popleft()
        for near in beside.pop(tip, ()):
            beside[near].discard(tip)
            if len(beside[near]) == 1:
                tips.append(near)
    forks = sorted(vertex for vertex, near in beside.items() if len(near) > 2)
    junction = {fork: fork for fork in forks}
    branches: list[list[int]] = []
    for fork in forks:
        for near in sorted(beside[fork]):
            branch = [fork, near]
            while branch[-1] not in junction:
                branch.append(next(vertex for vertex in beside[branch[-1]] if vertex != branch[-2]))
            # Each branch is found from both of its ends; it is taken once.
            if branch <= branch[::-1]:
                branches.append(branch)
    # Forks are one junction if their inscribed circles touch along the branch.
    short = [line for line in branches if _length(vertices[line]) < clear[line[0]] + clear[line[-1]]]
    for branch in short:
        begin, end = junction[branch[0]], junction[branch[-1]]
        junction = {fork: min(begin, end) if owner in (begin, end) else owner for fork, owner in junction.items()}
    return junction, [branch for branch in branches if branch not in short]


def _straight_on(
    junction: dict[int, int], branches: list[list[int]], vertices: Array, width: float
) -> dict[tuple[int, int], tuple[int, int]]:
    """Return the end of a branch, as its index and 0 or 1, that follows straight on the end of another one."""
    ends: dict[int, list[tuple[int, int]]] = {}
    away: dict[tuple[int, int], Array] = {}
    for index, branch in enumerate(branches):
        for side, line in enumerate((branch, branch[::-1])):
            places = vertices[line]
            # The direction at a distance at which the middle of the road no longer bends into the junction.
            leaves = _without_ends(places, 0.75 * width)[:2]
            away[index, side] = (leaves[-1] - leaves[0]) / max(math.dist(leaves[-1], leaves[0]), 1e-12)
            ends.setdefault(junction[line[0]], []).append((index, side))
    follows: dict[tuple[int, int], tuple[int, int]] = {}
    for meeting in ends.values():
        pairs = [(float(away[a] @ away[b]), a, b) for a in meeting for b in meeting if a < b]
        for cosine, a, b in sorted(pairs):
            if cosine < _STRAIGHT_ON and a not in follows and b not in follows:
                follows[a], follows[b] = b, a
    return follows


def _without_ends(places: Array, length: float) -> Array:
    """Return a line without a length [m] at its ends, or its middle if it is shorter."""
    line = shapely.LineString(places)
    cut = min(length, 0.4 * line.length)
    inner: Array = shapely.get_coordinates(substring(line, cut, line.length - cut))
    return inner


def _longest_path(edges: NDArray[np.int64], vertices: Array) -> Array:
    """Return the longest shortest path between two points of the largest connected part."""
    used, index = np.unique(edges, return_inverse=True)
    index = index.reshape(-1, 2)
    # SciPy takes an edge of length zero as missing.
    lengths = np.hypot(*(vertices[edges[:, 0]] - vertices[edges[:, 1]]).T) + 1e-12
    graph = coo_matrix((lengths, (index[:, 0], index[:, 1])), shape=(len(used), len(used))).tocsr()
    _, label = connected_components(graph, directed=False)
    start = int(np.flatnonzero(label == np.argmax(np.bincount(label)))[0])
    far = start
    before = np.zeros(0)
    # Two searches: the point farthest from any point is an end of the longest path.
    for _ in range(2):
        reach, before = dijkstra(graph, directed=False, indices=far, return_predecessors=True)
        start, far = far, int(np.argmax(np.where(np.isfinite(reach), reach, -1.0)))
    path = [far]
    while path[-1] != start:
        path.append(int(before[path[-1]]))
    line: Array = vertices[used[path]]
    return line
