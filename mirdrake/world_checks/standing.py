"""What stands on the ground, what is in it and what hangs in the air; and gaps between props that a rule forbids.

A prop stands if its lowest point is at the ground, within a tolerance, or if it rests on a prop that stands. One that
is fixed may also be held from the side, as a sign on a wall; one that can be knocked over would fall. This holds for
all props, also for those whose height is given. The tolerance is 2 cm; a rule `on_ground` sets that of the props that
it names, the last one that does so counts. A large one lets a lamp hang in the air, or a bump lie in the ground.
"""

from collections.abc import Sequence

from mirdrake.world_checks.faults import Fault, amount
from mirdrake.world_checks.overlaps import LEAST_DEPTH, MOST_OVERLAPS, Neighbours, place_of
from mirdrake.worlds import PlacedProp
from mirdrake.worlds.outlines import Outline, gap_between
from mirdrake.worlds.rules import Rules
from mirdrake.worlds.rules_spec import OnGroundSpec

TOLERANCE = float(OnGroundSpec.model_fields["tolerance"].default)
"""Gap or depth from which a prop does not stand on the ground [m], unless a rule says otherwise."""


def find_unsettled(near: Neighbours, rules: Rules | None) -> list[Fault]:
    """Props that are buried, or hang in the air."""
    props = near.props
    if not props:
        return []
    tolerances = [_tolerance(prop, rules) for prop in props]
    bottoms = [_bottom(near, index, tolerances[index]) for index in range(len(props))]
    faults = []
    for prop, bottom, tolerance in zip(props, bottoms, tolerances, strict=True):
        if bottom < -tolerance - 1e-9:
            text = (
                f"{prop.where}: '{prop.name}' is {amount(-bottom)} deep in the ground; raise it, or allow that by a "
                "rule on_ground with a tolerance"
            )
            faults.append(Fault("buried", text, (prop.name,), -bottom, _middle(prop, bottom)))
    standing = {index for index, bottom in enumerate(bottoms) if bottom <= tolerances[index] + 1e-9}
    hanging = set(range(len(props))) - standing
    if not hanging:
        return faults
    neighbours: dict[int, list[int]] = {}
    for a, b in near.pairs(max(TOLERANCE, *(tolerances[index] for index in hanging))):
        for one, other in ((a, b), (b, a)):
            if one in hanging:
                neighbours.setdefault(one, []).append(other)
    while held := {
        index
        for index in hanging
        if any(
            other in standing and _holds(near.outlines(other), near.outlines(index), props[index], tolerances[index])
            for other in neighbours.get(index, ())
        )
    }:
        standing |= held
        hanging -= held
    for index in sorted(hanging):
        prop, bottom = props[index], bottoms[index]
        text = (
            f"{prop.where}: '{prop.name}' hangs {amount(bottom)} above the ground with nothing below; lower it, put "
            "something below, or allow that by a rule on_ground with a tolerance"
        )
        faults.append(Fault("floating", text, (prop.name,), bottom, _middle(prop, bottom)))
    return faults


def find_gaps(near: Neighbours, rules: Rules | None, skip: set[tuple[str, ...]]) -> list[Fault]:
    """Props that are side by side and nearer than the rule min_gap allows.

    Args:
        near: the props.
        rules: of the world.
        skip: names of pairs that have a fault already.
    """
    if rules is None or rules.min_gap <= 0.0:
        return []
    props, faults = near.props, []
    for a, b in near.pairs(rules.min_gap):
        one, other = props[a], props[b]
        beside = min(one.top, other.top) - max(one.bottom, other.bottom) > LEAST_DEPTH
        if not beside or (one.name, other.name) in skip or rules.may_overlap(one, other):
            continue
        gap = max(0.0, near.gap(a, b))
        if gap < rules.min_gap - LEAST_DEPTH:
            text = (
                f"{one.where}: '{one.name}' is {amount(gap)} from '{other.name}' ({place_of(other)}); the rule min_gap "
                f"({rules.gap_where.rpartition(': ')[0] or 'rules'}) asks for {amount(rules.min_gap)}"
            )
            faults.append(Fault("gap", text, (one.name, other.name), gap, _middle(one, one.bottom)))
            if len(faults) == MOST_OVERLAPS:
                break
    return faults


# --- the inner parts ----------------------------------------------------------------------------------------------


def _bottom(near: Neighbours, index: int, tolerance: float) -> float:
    """Height of the lowest point of a prop [m]; where a look at its corners tells that it stands, theirs.

    The corners of what is round lie up to 1 % outside of it.
    """
    prop = near.props[index]
    if abs(prop.bottom) + 0.01 * (prop.top - prop.bottom) <= tolerance:
        return prop.bottom
    return min(part.bottom for part in near.outlines(index))


def _tolerance(prop: PlacedProp, rules: Rules | None) -> float:
    named = [rule.tolerance for rule in (rules.on_ground if rules else ()) if prop.is_called(rule.props)]
    return named[-1] if named else TOLERANCE


def _holds(base: Sequence[Outline], hung: Sequence[Outline], prop: PlacedProp, tolerance: float) -> bool:
    """Whether a prop rests on another, or is held by it from the side."""
    lowest = min(part.bottom for part in hung)
    for part in hung:
        for other in base:
            if gap_between(part, other) > tolerance:
                continue
            if part.bottom <= lowest + tolerance and abs(part.bottom - other.top) <= tolerance:
                return True
            if part.bottom < other.top + tolerance and part.top > other.bottom - tolerance and prop.static:
                return True
    return False


def _middle(prop: PlacedProp, height: float) -> tuple[float, float, float]:
    point = prop.footprint.centroid
    return float(point.x), float(point.y), height
