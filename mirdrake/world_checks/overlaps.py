"""Overlapping props, with depth and position, by the collision shapes of the simulation.

::

    boxes seen from above ──► outlines and heights ──► Drake's penetration queries in a process of their own

The first two steps exclude pairs that cannot overlap, so that a world without faults does not start that process. If a
query ends the process, its pair is reported, and a new process continues with the others.

The depth of an overlap is the length of the shortest translation that separates the two props, see separation.py.
"""

import json
import pickle
import re
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from pydrake.geometry import Shape
from pydrake.math import RigidTransform
from shapely.geometry.base import BaseGeometry

from mirdrake.world_checks import sentences
from mirdrake.world_checks.faults import Fault, Position
from mirdrake.world_checks.separation import Separation, separate
from mirdrake.worlds import PlacedProp
from mirdrake.worlds.outlines import Outline, gap_between, outlines_of

LEAST_DEPTH = 1e-4
"""Smallest depth of an overlap [m]; less is contact, or rounding."""

UNCERTAIN = 1e-3
"""Difference of the bounds of a depth above which both are reported [m]."""

TIME_LIMIT = 10.0
"""Time limit of all queries together [s]; 10 ms are added for each."""

MOST_NEIGHBOURS = 100_000
"""Pairs of props whose bounding boxes touch that are examined."""

MOST_OVERLAPS = 200
"""Pairs of props that are reported as overlapping, or as closer than `min_gap`; the others are counted."""

MOST_FAILURES = 8
"""Queries that may end the process before the others are skipped."""

COMMAND: tuple[str, ...] = (sys.executable, "-P", str(Path(__file__).with_name("worker.py")))
"""The process that asks Drake."""

_LIBRARY = re.compile(r"fcl|qhull|QH\d|\.(?:h|cc|cpp|c):|libccd|::", re.IGNORECASE)
"""Texts of FCL and Qhull, which name functions instead of props."""

_CHUNK = 256  # props whose neighbours are looked up at once

Pair = tuple[int, int]
MayOverlap = Callable[[PlacedProp, PlacedProp], bool]


class Neighbours:
    """Search for props of a world that are near each other, and their outlines.

    Args:
        props: of the world.

    Attributes:
        is_crowded: more than `MOST_NEIGHBOURS` pairs are near each other, and only the first ones were returned.
    """

    def __init__(self, props: Sequence[PlacedProp]) -> None:
        self.props = props
        self.is_crowded = False
        self._outlines: dict[int, tuple[Outline, ...]] = {}
        self._bounds = shapely.bounds([prop.footprint for prop in props]).reshape(-1, 4)
        self._heights = np.array([(prop.bottom, prop.top) for prop in props]).reshape(-1, 2)
        xmin, ymin, xmax, ymax = self._bounds.T
        self._tree = shapely.STRtree(shapely.box(xmin, ymin, xmax, ymax))

    def outlines(self, index: int) -> tuple[Outline, ...]:
        """Return the outlines of one prop, in the order of its solids."""
        if index not in self._outlines:
            self._outlines[index] = outlines_of(self.props[index])
        return self._outlines[index]

    def pairs(self, gap: float = 0.0) -> list[Pair]:
        """Return pairs of props whose bounding boxes are within a gap [m], the first one earlier in the file."""
        wide = self._bounds + gap * np.array([-1.0, -1.0, 1.0, 1.0])
        boxes = np.asarray(shapely.box(*wide.T))
        pairs: list[Pair] = []
        # In chunks, because the number of pairs grows with the square of the number of props in one place.
        for begin in range(0, len(boxes), _CHUNK):
            first, second = self._tree.query(boxes[begin : begin + _CHUNK])
            first = first + begin
            near = (
                (first < second)
                & (self._heights[first, 0] <= self._heights[second, 1] + gap)
                & (self._heights[second, 0] <= self._heights[first, 1] + gap)
            )
            pairs += sorted(zip(first[near].tolist(), second[near].tolist(), strict=True))
            if len(pairs) > MOST_NEIGHBOURS:
                self.is_crowded = True
                return pairs[:MOST_NEIGHBOURS]
        return pairs

    def touching(self, area: BaseGeometry) -> list[int]:
        """Return the props whose bounding boxes seen from above touch that of an area."""
        return sorted(self._tree.query(area).tolist())

    def colliding(self, one: int, other: int) -> Iterator[Pair]:
        """Yield the pairs of solids of two props that may overlap."""
        for i, a in enumerate(self.outlines(one)):
            for j, b in enumerate(self.outlines(other)):
                high = min(a.top, b.top) - max(a.bottom, b.bottom)
                if high > LEAST_DEPTH and a.may_touch(b) and gap_between(a, b) < -LEAST_DEPTH:
                    yield i, j

    def gap(self, one: int, other: int) -> float:
        """Return the distance of two props seen from above [m], negative if they overlap."""
        return min(gap_between(a, b) for a in self.outlines(one) for b in self.outlines(other))


def find_overlaps(near: Neighbours, may_overlap: MayOverlap) -> list[Fault]:
    """Return the faults of props that overlap, and of those for which Drake gave no result.

    Args:
        near: the props.
        may_overlap: whether two props may overlap.
    """
    props = near.props
    queries: list[_Query] = []
    suspects = 0
    for a, b in near.pairs():
        if may_overlap(props[a], props[b]) or not (solids := list(near.colliding(a, b))):
            continue
        suspects += 1
        if suspects > MOST_OVERLAPS:
            break
        queries += [_Query((a, b), pair) for pair in solids]
    answer = _ask(props, queries)
    faults = []
    for (a, b), hit in sorted(answer.hits.items()):
        if hit.depth > LEAST_DEPTH:
            separation = separate(props[a], props[b])
            if separation.depth > LEAST_DEPTH:
                faults.append(_overlap(near, a, b, hit, separation))
    reported = {fault.names for fault in faults}
    for (a, b), reason in sorted(answer.failed.items()):
        if (props[a].name, props[b].name) not in reported:
            faults.append(_unchecked(props[a], props[b], reason))
    if suspects > MOST_OVERLAPS or near.is_crowded:
        faults.append(Fault("unchecked", sentences.too_many_pairs(MOST_OVERLAPS, MOST_NEIGHBOURS), "props"))
    return faults


# --- the inner parts ----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Hit:
    """The deepest overlap of two solids of two props: the solids, their depth by Drake [m], position in W [m]."""

    solids: Pair
    depth: float
    position: Position


@dataclass(frozen=True)
class _Query:
    """A pair of props and a pair of their solids."""

    props: Pair
    solids: Pair


@dataclass
class _Answer:
    hits: dict[Pair, _Hit] = field(default_factory=dict)
    failed: dict[Pair, str] = field(default_factory=dict)


def _ask(props: Sequence[PlacedProp], queries: list[_Query]) -> _Answer:
    """Return the results of Drake; if a query ends the process, another process continues with the next one."""
    shapes: dict[str, tuple[int, Shape]] = {}

    def side(prop: int, number: int) -> tuple[int, RigidTransform]:
        solid = props[prop].prop.solids[number]
        index, _ = shapes.setdefault(repr(solid.shape), (len(shapes), solid.shape))
        return index, props[prop].X_WP @ solid.X_PS

    pairs = [(*side(q.props[0], q.solids[0]), *side(q.props[1], q.solids[1])) for q in queries]
    known = [shape for _, shape in shapes.values()]
    answer, done, failures = _Answer(), 0, 0
    while done < len(queries):
        job = pickle.dumps({"shapes": known, "pairs": pairs[done:]})
        hits, reason = _talk(job, TIME_LIMIT + 0.01 * (len(queries) - done))
        for query, hit in zip(queries[done:], hits, strict=False):
            before = answer.hits.get(query.props)
            if hit is not None and (before is None or hit[0] > before.depth):
                answer.hits[query.props] = _Hit(query.solids, hit[0], (hit[1][0], hit[1][1], hit[1][2]))
        done += len(hits)
        if done < len(queries):
            answer.failed[queries[done].props] = reason
            done, failures = done + 1, failures + 1
        if failures >= MOST_FAILURES and done < len(queries):
            reason = f"skipped after {failures} failures, the last: {reason}"
            answer.failed |= {query.props: reason for query in queries[done:]}
            break
    return answer


def _talk(job: bytes, time_limit: float) -> tuple[list[Any], str]:
    """Run the process with a job; return its results, and the reason if some are missing."""
    try:
        process = subprocess.Popen(COMMAND, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    except OSError as error:
        return [], f"no process can be started: {error.strerror or error}"
    with process:
        try:
            out, err = process.communicate(job, timeout=time_limit)
            reason = f"Drake's query ended its process ({_ending(process.returncode, err)})"
        except subprocess.TimeoutExpired:
            process.kill()
            out, _ = process.communicate()
            reason = f"Drake's query did not end within {time_limit:.0f} s"
    return [message["hit"] for message in _messages(out) if "hit" in message], reason


def _messages(out: bytes) -> Iterator[dict[str, Any]]:
    for line in out.decode(errors="replace").splitlines():
        try:
            message = json.loads(line)
        except ValueError:  # text of Drake, or half a line
            continue
        if isinstance(message, dict):
            yield message


def _ending(code: int, err: bytes) -> str:
    """Return how a process ended: its signal, or its exit code and last message unless it is a library's."""
    if code < 0:
        return f"signal {-code}"
    words = [line.strip() for line in err.decode(errors="replace").splitlines() if line.strip()]
    own = bool(words) and not _LIBRARY.search(words[-1])
    return f"exit code {code}: {words[-1][:200]}" if own else f"exit code {code}"


def _overlap(near: Neighbours, a: int, b: int, hit: _Hit, separation: Separation) -> Fault:
    one, other = near.props[a], near.props[b]
    shared = shapely.intersection(near.outlines(a)[hit.solids[0]].area, near.outlines(b)[hit.solids[1]].area)
    polygon = tuple((float(x), float(y)) for x, y in shapely.get_coordinates(shared.convex_hull)[:-1])
    depth = separation.depth
    least = separation.least if depth - separation.least > UNCERTAIN else depth
    message = sentences.overlap(one, other, (least, depth), hit.position)
    return Fault("overlap", message, one.where, (one.name, other.name), depth, hit.position, polygon)


def _unchecked(one: PlacedProp, other: PlacedProp, reason: str) -> Fault:
    return Fault("unchecked", sentences.unchecked(one, other, reason), one.where, (one.name, other.name))
