"""Sentences of the faults of a world: what was found, where, and how to correct it."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from mirdrake.core.errors import did_you_mean
from mirdrake.worlds import PlacedProp, World

if TYPE_CHECKING:
    from mirdrake.world_checks.actor_starts import Standing

Bounds = tuple[float, float, float, float]


def format_position(*position: float) -> str:
    """Return a position as text, for example ``(3.00, -1.20) m``."""
    # Rounding may leave "-0.00".
    return f"({', '.join(f'{value + 0.0:.2f}'.replace('-0.00', '0.00') for value in position)}) m"


def format_length(length: float) -> str:
    """Return a length as text: mm below 1 cm, cm below 1 m, else m; never rounded to 0."""
    if length < 0.01:
        return f"{1e3 * length:.2g} mm"
    return f"{1e2 * length:.3g} cm" if length < 1.0 else f"{length:.3g} m"


# --- props --------------------------------------------------------------------------------------------------------


def overlap(first: PlacedProp, second: PlacedProp, depth: tuple[float, float], position: Sequence[float]) -> str:
    """Return the sentence for two props that overlap; `depth` is a range [m], equal ends are one depth."""
    shallowest, deepest = (format_length(bound) for bound in depth)
    text = deepest if depth[0] == depth[1] else f"{shallowest} to {deepest}"
    return (
        f"'{first.name}' overlaps '{second.name}' ({second.file_line}) by {text} at {format_position(*position)}; "
        "move one of them, or allow the overlap by a rule allow_overlap"
    )


def too_many_pairs(overlaps: int, neighbours: int) -> str:
    """Return the sentence for a world with more pairs of props in one place than are examined."""
    return (
        f"only the first {overlaps} overlapping pairs, or the first {neighbours} neighbouring pairs, of props are "
        "examined; correct these, then check again"
    )


def gap(first: PlacedProp, second: PlacedProp, distance: float, required: float, rule: str) -> str:
    """Return the sentence for two props that are closer than a rule allows [m]."""
    return (
        f"'{first.name}' is {format_length(distance)} from '{second.name}' ({second.file_line}); the rule min_gap "
        f"({rule}) requires {format_length(required)}"
    )


def buried(prop: PlacedProp, depth: float) -> str:
    """Return the sentence for a prop below the ground [m]."""
    return (
        f"'{prop.name}' is {format_length(depth)} below the ground; raise it, or allow that by a rule on_ground with a "
        "tolerance"
    )


def floating(prop: PlacedProp, height: float) -> str:
    """Return the sentence for a prop above the ground [m] without support."""
    return (
        f"'{prop.name}' is {format_length(height)} above the ground without support; lower it, put something below, or "
        "allow that by a rule on_ground with a tolerance"
    )


# --- starts and goals ---------------------------------------------------------------------------------------------


def start_off_ground(vehicle: str, start: str, distance: float, extent: Bounds) -> str:
    """Return the sentence for a vehicle that is partly outside the ground [m] at a start."""
    low, high = format_position(*extent[:2]), format_position(*extent[2:])
    return (
        f"{vehicle} at '{start}' is {format_length(distance)} outside the ground, which extends from {low} to {high}; "
        "move the start or set ground.size"
    )


def start_in_prop(vehicle: str, start: str, prop: PlacedProp, depth: float, x: float, y: float) -> str:
    """Return the sentence for a vehicle that overlaps a prop [m] at a start."""
    return (
        f"{vehicle} at '{start}' overlaps '{prop.name}' ({prop.file_line}) by {format_length(depth)} at "
        f"{format_position(x, y)}; move the start or the prop"
    )


def actors_overlap(actor: "Standing", other: "Standing", depth: float) -> str:
    """Return the sentence for two actors that overlap at t = 0 [m]."""
    return (
        f"'{actor.name}' overlaps '{other.name}' ({other.file_line}) by {format_length(depth)} at t = 0, at "
        f"{format_position(*actor.pose[:2])}; move one of them along its lane or path, or to another one"
    )


def start_in_actor(start: "Standing", actor: "Standing", depth: float) -> str:
    """Return the sentence for a vehicle at a start that overlaps an actor at t = 0 [m]."""
    return (
        f"{start.name} overlaps the actor '{actor.name}' ({actor.file_line}) by {format_length(depth)} at t = 0, at "
        f"{format_position(*actor.pose[:2])}; move the start or the actor"
    )


def inside_prop(what: str, name: str, prop: PlacedProp, x: float, y: float) -> str:
    """Return the sentence for a start or goal whose centre is inside a prop."""
    return (
        f"{what} '{name}' at {format_position(x, y)} is inside '{prop.name}' ({prop.file_line}); move the {what} or "
        "the prop"
    )


def goal_as_start(name: str) -> str:
    """Return the message about a rule `drivable` whose start is a goal."""
    return f"'{name}' is a goal; a path begins at a start, which has a heading"


# --- paths --------------------------------------------------------------------------------------------------------


def goal_without_area(goal: str, world: World) -> str:
    """Return the message about a goal that has no area or does not exist."""
    return f"'{goal}' has no area; {did_you_mean(goal, [*world.goals, *world.starts])}"


def no_path(vehicle: str, margin: float, start: str, goal: str, reason: str) -> str:
    """Return the message about a goal that the vehicle cannot reach from a start."""
    clearance = f" with {margin:g} m on each side" if margin else ""
    return f"no path for {vehicle}{clearance} from '{start}' to '{goal}': {reason}"


def too_narrow(width: float, position: Sequence[float], names: Sequence[str], needed: float) -> str:
    """Return the reason that the widest passage between some props is too narrow [m]."""
    quoted = " and ".join(f"'{name}'" for name in names)
    between = f", {'between' if len(names) > 1 else 'at'} {quoted}" if names else ""
    return (
        f"the widest passage is {width:.2f} m wide at {format_position(*position)}{between}; {needed:.2f} m are needed"
    )


def cannot_turn(nearest: Sequence[float]) -> str:
    """Return the reason that every passage is wide enough, but the vehicle cannot turn."""
    return (
        "every passage is wide enough, but the vehicle cannot turn, even by reversing; it gets as far as "
        f"{format_position(*nearest)}"
    )


def search_ended(limit: float, nearest: Sequence[float]) -> str:
    """Return the reason for a missing path if the search ended at its limit of computing time [s]."""
    return f"none was found within {limit:g} s of computing; the search got as far as {format_position(*nearest)}"


# --- first steps --------------------------------------------------------------------------------------------------


def first_steps(vehicle: str, start: str, reason: str, advice: str) -> str:
    """Return the sentence for a simulation whose first steps fail."""
    return f"the first steps with {vehicle} at '{start}' fail: {reason}; {advice}"
