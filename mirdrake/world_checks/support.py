"""Buried and floating props, and gaps between props that are too small.

A prop is supported if its lowest point is on the ground, within a tolerance, or if it rests on a supported prop. A
static prop may also be attached to the side of another, as a sign on a wall; one that can be knocked over would fall.
Where the ground is uneven, a prop on it has its lowest point between the lowest and the highest ground below that part.
The tolerance is 2 cm; the last rule `on_ground` that names a prop sets another one, for example for a hanging lamp.
"""

from collections.abc import Sequence

import shapely

from mirdrake.ground import FLAT, Terrain
from mirdrake.world_checks import sentences
from mirdrake.world_checks.faults import Fault
from mirdrake.world_checks.overlaps import LEAST_DEPTH, MOST_OVERLAPS, Neighbours
from mirdrake.worlds import PlacedProp
from mirdrake.worlds.outlines import Outline, gap_between
from mirdrake.worlds.rules import Rules
from mirdrake.worlds.rules_spec import OnGroundSpec

TOLERANCE = float(OnGroundSpec.model_fields["tolerance"].default)
"""Largest gap or depth of a prop on the ground [m], unless a rule sets another one."""


def find_unsupported(near: Neighbours, rules: Rules | None, terrain: Terrain = FLAT) -> list[Fault]:
    """Return the faults of buried and floating props.

    Args:
        near: the props.
        rules: rules of the world.
        terrain: the ground.
    """
    props = near.props
    if not props:
        return []
    tolerances = [_tolerance(prop, rules) for prop in props]
    bottoms = [_above_ground(near, index, tolerances[index], terrain) for index in range(len(props))]
    faults = []
    # Depth in the ground is a fault for itself; support is by the ground or, below, by other props.
    for prop, bottom, tolerance in zip(props, bottoms, tolerances, strict=True):
        if bottom < -tolerance - 1e-9:
            message = sentences.buried(prop, -bottom)
            place = _centre(prop, bottom if terrain.flat else prop.bottom)
            faults.append(Fault("buried", message, prop.where, (prop.name,), -bottom, place))
    supported = {index for index, bottom in enumerate(bottoms) if bottom <= tolerances[index] + 1e-9}
    floating = set(range(len(props))) - supported
    if not floating:
        return faults

    # Props that rest on supported props are supported, and so on until nothing changes.
    neighbours: dict[int, list[int]] = {}
    for a, b in near.pairs(max(TOLERANCE, *(tolerances[index] for index in floating))):
        for first, second in ((a, b), (b, a)):
            if first in floating:
                neighbours.setdefault(first, []).append(second)
    while added := {
        index
        for index in floating
        if any(
            other in supported
            and _supports(near.outlines(other), near.outlines(index), props[index], tolerances[index])
            for other in neighbours.get(index, ())
        )
    }:
        supported |= added
        floating -= added
    for index in sorted(floating):
        prop, bottom = props[index], bottoms[index]
        message = sentences.floating(prop, bottom)
        place = _centre(prop, bottom if terrain.flat else prop.bottom)
        faults.append(Fault("floating", message, prop.where, (prop.name,), bottom, place))
    return faults


def find_gaps(near: Neighbours, rules: Rules | None, skip: set[tuple[str, ...]]) -> list[Fault]:
    """Return the faults of props side by side that are closer than the rule min_gap allows.

    Args:
        near: the props.
        rules: rules of the world.
        skip: names of pairs that have a fault already.
    """
    if rules is None or rules.min_gap <= 0.0:
        return []
    props, faults = near.props, []
    for a, b in near.pairs(rules.min_gap):
        first, second = props[a], props[b]
        # Props above one another have no gap between their sides.
        side_by_side = min(first.top, second.top) - max(first.bottom, second.bottom) > LEAST_DEPTH
        if not side_by_side or (first.name, second.name) in skip or rules.may_overlap(first, second):
            continue
        gap = max(0.0, near.gap(a, b))
        if gap < rules.min_gap - LEAST_DEPTH:
            message = sentences.gap(first, second, gap, rules.min_gap, rules.gap_file_line)
            names = (first.name, second.name)
            faults.append(Fault("gap", message, first.where, names, gap, _centre(first, first.bottom)))
            if len(faults) == MOST_OVERLAPS:
                break
    return faults


# --- the inner parts ----------------------------------------------------------------------------------------------


def _above_ground(near: Neighbours, index: int, tolerance: float, terrain: Terrain) -> float:
    """Return the height of the lowest point of a prop above the ground [m]; negative below it.

    From its corners if these are on level ground already: the corners of round solids are up to 1 % outside of them.
    """
    prop = near.props[index]
    if terrain.flat and abs(prop.bottom) + 0.01 * (prop.top - prop.bottom) <= tolerance:
        return prop.bottom
    bottom = min(part.bottom for part in near.outlines(index))
    if terrain.flat:
        return bottom
    # The ground below the lowest parts, at their corners; beyond its range the prop is above or below all of it.
    lowest = [part.area for part in near.outlines(index) if part.bottom <= bottom + tolerance]
    corners = shapely.get_coordinates(lowest)
    ground = terrain.height(corners[:, 0], corners[:, 1])
    return bottom - min(max(bottom, float(ground.min())), float(ground.max()))


def _tolerance(prop: PlacedProp, rules: Rules | None) -> float:
    tolerances = [rule.tolerance for rule in (rules.on_ground if rules else ()) if prop.is_called(rule.props)]
    return tolerances[-1] if tolerances else TOLERANCE


def _supports(base: Sequence[Outline], upper: Sequence[Outline], prop: PlacedProp, tolerance: float) -> bool:
    """Return whether a prop rests on another, or is attached to its side."""
    lowest = min(part.bottom for part in upper)
    for part in upper:
        for other in base:
            if gap_between(part, other) > tolerance:
                continue
            # It rests on the other: its lowest part begins where the other ends.
            if part.bottom <= lowest + tolerance and abs(part.bottom - other.top) <= tolerance:
                return True
            # It is attached to the side: heights overlap. A prop that is not static would fall.
            if part.bottom < other.top + tolerance and part.top > other.bottom - tolerance and prop.static:
                return True
    return False


def _centre(prop: PlacedProp, height: float) -> tuple[float, float, float]:
    point = prop.footprint.centroid
    return float(point.x), float(point.y), height
