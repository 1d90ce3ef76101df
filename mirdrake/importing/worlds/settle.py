"""Loose objects that float, or are a little in the ground: put where they would come to rest."""

import numpy as np
from pydrake.math import RigidTransform

from mirdrake.importing.changes import Changes, Code
from mirdrake.importing.worlds.entry import Entry
from mirdrake.importing.worlds.model import Array
from mirdrake.world_checks.overlaps import Neighbours
from mirdrake.world_checks.support import TOLERANCE, find_unsupported
from mirdrake.worlds.outlines import gap_between
from mirdrake.worlds.props import PlacedProp

_SHALLOW = 0.1  # [m] depth in the ground up to which a loose object is put onto it
_TOUCH = 1e-3  # [m] that outlines must run into each other, seen from above, for one to rest on the other


def settle(entries: list[Entry], props: list[PlacedProp], where: str, changes: Changes) -> bool:
    """Lower loose objects that float onto what is below them, and lift those a little in the ground onto it.

    What rests on a lifted object is lifted with it.

    Args:
        entries: entries of the world; the poses of those that move are changed.
        props: its props.
        where: place of the changes.
        changes: get what moved.

    Returns:
        whether any moved.
    """
    near = Neighbours(props)
    faults = find_unsupported(near, None)
    floating = {fault.names[0] for fault in faults if fault.kind == "floating"}
    shallow = {fault.names[0] for fault in faults if fault.kind == "buried" and (fault.depth or 0.0) <= _SHALLOW}
    loose = {index for index, prop in enumerate(props) if not prop.static}
    down = {index for index in loose if props[index].name in floating}
    up = {index for index in loose if props[index].name in shallow}
    if not down and not up:
        return False
    # Only what is lifted can move others.
    shifts = _shifts(near, down | up, loose if up else down)
    moved = {index for index in loose if abs(shifts[index]) > 1e-9}
    by_name = {entry.name: entry for entry in entries}
    for index in moved:
        X = by_name[props[index].name].X_WP
        by_name[props[index].name].X_WP = RigidTransform(
            X.rotation(), X.translation() + np.array([0.0, 0.0, shifts[index]])
        )
    # Gazebo lets floating objects fall and pushes buried ones out.
    for indices, state, why in ((sorted(down & moved), "above", "fall"), (sorted(up & moved), "in", "be pushed out")):
        if indices:
            # One row for all: a world may have hundreds of loose objects that float by a millimetre.
            farthest = max(abs(float(shifts[index])) for index in indices)
            named = ", ".join(props[index].name for index in indices[:5])
            was = f"{len(indices)} up to {farthest:.3g} m {state} the ground: {named}"
            landed = all(abs(props[index].bottom + shifts[index]) < 1e-6 for index in indices)
            became = "on the ground" if landed else "on the ground, or on what is below them"
            part = f"loose objects {state} the ground"
            changes.add(Code.MODEL, where, part, was, became, f"they would {why} in the source")
    carried = sorted(moved - down - up)
    if carried:
        was = f"{len(carried)} on objects in the ground: {', '.join(props[index].name for index in carried[:5])}"
        changes.add(Code.MODEL, where, "loose objects", was, "lifted with them", "they rest on them")
    return bool(moved)


def _shifts(near: Neighbours, own: set[int], uppers: set[int]) -> Array:
    """Return how far each prop moves up [m], the others 0.

    Args:
        near: the props.
        own: those that move to the ground, unless something below ends their way.
        uppers: those that something below them can hold up or lift.
    """
    shifts = np.array([-prop.bottom if index in own else 0.0 for index, prop in enumerate(near.props)])
    below = [
        (upper, lower, gap)
        for upper in sorted(uppers)
        for lower in near.touching(near.props[upper].footprint)
        if lower != upper and (gap := _gap_to(near, upper, lower)) is not None
    ]
    # A prop ends at most the gap nearer to the one below than before; that one may rest on another, so passes are
    # repeated until nothing changes. Shifts only grow, and a chain has at most as many links as there are props.
    for _ in near.props:
        before = shifts.copy()
        for upper, lower, gap in below:
            shifts[upper] = max(shifts[upper], shifts[lower] - gap)
        if np.array_equal(before, shifts):
            break
    return shifts


def _gap_to(near: Neighbours, upper: int, lower: int) -> float | None:
    """Return the smallest height between a prop and solids of another one below it [m]; None without any."""
    gaps = [
        max(0.0, part.bottom - other.top)
        for part in near.outlines(upper)
        for other in near.outlines(lower)
        if part.bottom >= other.top - TOLERANCE
        and part.bottom > other.bottom  # plates thinner than the tolerance
        and part.may_touch(other)
        and gap_between(part, other) < -_TOUCH
    ]
    return min(gaps, default=None)
