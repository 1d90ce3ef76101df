"""Props in the same place: with depth and place, on the very shapes that are simulated.

::

    boxes seen from above ──► outlines and heights ──► Drake's penetration queries in a process of their own

The first two only rule out what is surely apart, so that a sound world does not start that process. If a query ends the
process, the pair that did it is told, and a new process goes on with the others.

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

from mirdrake.world_checks.faults import Fault, amount, spot
from mirdrake.world_checks.separation import Separation, separate
from mirdrake.worlds import PlacedProp
from mirdrake.worlds.outlines import Outline, gap_between, outlines_of

LEAST_DEPTH = 1e-4
"""Depth from which props overlap [m]; less is touching, and rounding."""

UNCERTAIN = 1e-3
"""Difference of the bounds of a depth from which both are reported [m]."""

PATIENCE = 10.0
"""Time that all queries together may take, and 10 ms more for each [s]."""

MOST_NEIGHBOURS = 100_000
"""Pairs of props whose bounding boxes touch that are examined."""

MOST_OVERLAPS = 200
"""Pairs of props that are reported as overlapping, or as closer than `min_gap`; the others are counted."""

MOST_DEATHS = 8
"""Queries that may end the process before the rest is given up."""

COMMAND: tuple[str, ...] = (sys.executable, "-P", str(Path(__file__).with_name("worker.py")))
"""The process that asks Drake."""

_LIBRARY = re.compile(r"fcl|qhull|QH\d|\.(?:h|cc|cpp|c):|libccd|::", re.IGNORECASE)
"""Words of FCL and Qhull, which name functions and no prop."""

_CHUNK = 256  # props whose neighbours are looked up at once

Pair = tuple[int, int]
MayOverlap = Callable[[PlacedProp, PlacedProp], bool]


class Neighbours:
    """Which props of a world are near each other, and their outlines.

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
        """Of one prop, in the order of its solids."""
        if index not in self._outlines:
            self._outlines[index] = outlines_of(self.props[index])
        return self._outlines[index]

    def pairs(self, gap: float = 0.0) -> list[Pair]:
        """Pairs of props whose boxes are within a gap [m] in x, y and z, the first one earlier in the file."""
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

    def at(self, area: BaseGeometry) -> list[int]:
        """The props whose boxes seen from above touch that of an area."""
        return sorted(self._tree.query(area).tolist())

    def colliding(self, one: int, other: int) -> Iterator[Pair]:
        """The solids of two props that are not surely apart, or touching."""
        for i, a in enumerate(self.outlines(one)):
            for j, b in enumerate(self.outlines(other)):
                high = min(a.top, b.top) - max(a.bottom, b.bottom)
                if high > LEAST_DEPTH and a.may_touch(b) and gap_between(a, b) < -LEAST_DEPTH:
                    yield i, j

    def gap(self, one: int, other: int) -> float:
        """Distance of two props seen from above [m]; negative: they overlap there."""
        return min(gap_between(a, b) for a in self.outlines(one) for b in self.outlines(other))


def find_overlaps(near: Neighbours, may_overlap: MayOverlap) -> list[Fault]:
    """Props that are in the same place, and those of which Drake could not say.

    Args:
        near: the props.
        may_overlap: whether two may.
    """
    props = near.props
    questions: list[_Question] = []
    suspects = 0
    for a, b in near.pairs():
        if may_overlap(props[a], props[b]) or not (solids := list(near.colliding(a, b))):
            continue
        suspects += 1
        if suspects > MOST_OVERLAPS:
            break
        questions += [_Question((a, b), pair) for pair in solids]
    answer = _ask(props, questions)
    faults = []
    for (a, b), hit in sorted(answer.hits.items()):
        if hit.depth > LEAST_DEPTH:
            separation = separate(props[a], props[b])
            if separation.depth > LEAST_DEPTH:
                faults.append(_overlap(near, a, b, hit, separation))
    told = {fault.names for fault in faults}
    for (a, b), reason in sorted(answer.failed.items()):
        if (props[a].name, props[b].name) not in told:
            faults.append(_unchecked(props[a], props[b], reason))
    if suspects > MOST_OVERLAPS or near.is_crowded:
        faults.append(
            Fault(
                "unchecked",
                f"props: only the first {MOST_OVERLAPS} overlapping pairs, or the first {MOST_NEIGHBOURS} neighbouring "
                "pairs, of props are examined; correct these, then check again",
            )
        )
    return faults


# --- the inner parts ----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Hit:
    """The deepest overlap of two solids of two props: the solids, their depth by Drake [m], place in W [m]."""

    solids: Pair
    depth: float
    place: tuple[float, float, float]


@dataclass(frozen=True)
class _Question:
    """A solid of a prop and one of another."""

    props: Pair
    solids: Pair


@dataclass
class _Answer:
    hits: dict[Pair, _Hit] = field(default_factory=dict)
    failed: dict[Pair, str] = field(default_factory=dict)


def _ask(props: Sequence[PlacedProp], questions: list[_Question]) -> _Answer:
    """What Drake says; where a question ends the process, another one goes on with the next question."""
    shapes: dict[str, tuple[int, Shape]] = {}

    def side(prop: int, number: int) -> tuple[int, RigidTransform]:
        solid = props[prop].prop.solids[number]
        index, _ = shapes.setdefault(repr(solid.shape), (len(shapes), solid.shape))
        return index, props[prop].X_WP @ solid.X_PS

    pairs = [(*side(q.props[0], q.solids[0]), *side(q.props[1], q.solids[1])) for q in questions]
    known = [shape for _, shape in shapes.values()]
    answer, done, deaths = _Answer(), 0, 0
    while done < len(questions):
        job = pickle.dumps({"shapes": known, "pairs": pairs[done:]})
        hits, reason = _talk(job, PATIENCE + 0.01 * (len(questions) - done))
        for question, hit in zip(questions[done:], hits, strict=False):
            before = answer.hits.get(question.props)
            if hit is not None and (before is None or hit[0] > before.depth):
                answer.hits[question.props] = _Hit(question.solids, hit[0], (hit[1][0], hit[1][1], hit[1][2]))
        done += len(hits)
        if done < len(questions):
            answer.failed[questions[done].props] = reason
            done, deaths = done + 1, deaths + 1
        if deaths >= MOST_DEATHS and done < len(questions):
            reason = f"not asked after {deaths} failures, the last: {reason}"
            answer.failed |= {question.props: reason for question in questions[done:]}
            break
    return answer


def _talk(job: bytes, patience: float) -> tuple[list[Any], str]:
    """Run the process with a job: its answers, and why there are not more of them."""
    try:
        process = subprocess.Popen(COMMAND, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    except OSError as error:
        return [], f"no process can be started: {error.strerror or error}"
    with process:
        try:
            out, err = process.communicate(job, timeout=patience)
            reason = f"Drake's query ended its process ({_ending(process.returncode, err)})"
        except subprocess.TimeoutExpired:
            process.kill()
            out, _ = process.communicate()
            reason = f"Drake's query had no end after {patience:.0f} s"
    return [message["hit"] for message in _messages(out) if "hit" in message], reason


def _messages(out: bytes) -> Iterator[dict[str, Any]]:
    for line in out.decode(errors="replace").splitlines():
        try:
            message = json.loads(line)
        except ValueError:  # Drake's own words, or half a line
            continue
        if isinstance(message, dict):
            yield message


def _ending(code: int, err: bytes) -> str:
    """How a process ended: its signal, or its exit code and last message unless it is a library's."""
    if code < 0:
        return f"signal {-code}"
    words = [line.strip() for line in err.decode(errors="replace").splitlines() if line.strip()]
    own = bool(words) and not _LIBRARY.search(words[-1])
    return f"exit code {code}: {words[-1][:200]}" if own else f"exit code {code}"


def _overlap(near: Neighbours, a: int, b: int, hit: _Hit, separation: Separation) -> Fault:
    one, other = near.props[a], near.props[b]
    shared = shapely.intersection(near.outlines(a)[hit.solids[0]].area, near.outlines(b)[hit.solids[1]].area)
    polygon = tuple((float(x), float(y)) for x, y in shapely.get_coordinates(shared.convex_hull)[:-1])
    depth = amount(separation.depth)
    if separation.depth - separation.least > UNCERTAIN:
        depth = f"{amount(separation.least)} to {depth}"
    text = (
        f"{one.where}: '{one.name}' overlaps '{other.name}' ({place_of(other)}) by {depth} at "
        f"{spot(*hit.place)}; move one of them, or allow it by a rule allow_overlap"
    )
    return Fault("overlap", text, (one.name, other.name), separation.depth, hit.place, polygon)


def _unchecked(one: PlacedProp, other: PlacedProp, reason: str) -> Fault:
    text = (
        f"{one.where}: whether '{one.name}' overlaps '{other.name}' ({place_of(other)}) is not known: {reason}; "
        "move or turn one of them a little"
    )
    return Fault("unchecked", text, (one.name, other.name))


def place_of(prop: PlacedProp) -> str:
    """``file:line`` of a prop's entry."""
    return prop.where.rpartition(": ")[0] or prop.where or "the world"
