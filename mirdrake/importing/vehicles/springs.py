"""Springs of a source as the suspension of the vehicle: one vertical joint per wheel, with stiffness and damping."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite, pi, sqrt

import numpy as np

from mirdrake.core.constants import GRAVITY
from mirdrake.importing.changes import Change, Code
from mirdrake.importing.vehicles.car import Layout, Number, Part, SpringSet
from mirdrake.importing.vehicles.masses import centre_of_mass, total_mass
from mirdrake.importing.vehicles.model import Joint, SourceModel
from mirdrake.importing.vehicles.recognise import Roles
from mirdrake.vehicles.estimates import HOW, Estimates
from mirdrake.vehicles.spec import WHEELS

UPRIGHT = 0.7
"""Smallest cosine between the axis of a sliding joint and the vertical."""

LEVEL = 0.35
"""Largest sine between the axis of a swing arm and the horizontal."""

USUAL = (0.4, 8.0)
"""Ride frequencies [Hz] of a vehicle with the wheels of a car that need no check; small ones have higher ones."""

ENDS = ("front", "rear")


@dataclass(frozen=True)
class WheelSpring:
    """A joint of the source on which one wheel moves up and down.

    Attributes:
        joint: prismatic, or a swing arm.
        up: rate of the wheel's height over the joint's position: cosine of a sliding joint's axis, lever [m] of an arm.
        steered: whether the joint is below the steering joint, and so part of the knuckle.
    """

    joint: Joint
    up: float
    steered: bool


_STIFFNESS, _DAMPING = re.compile("stiff|spring_?(k|const|rate)|^k[ps]?$|^kx$", re.I), re.compile("damp|^k?[cd]$", re.I)


def take_springs(model: SourceModel) -> None:
    """Give joints the stiffness and damping that controllers and plugins state for them, where they have none.

    A position controller whose output is a force is a spring: p is its stiffness and d its damping.
    """
    given: dict[str, tuple[float, float]] = {}
    for controller in model.controllers:
        if "position" in controller.kind.lower() and "effort" in controller.kind.lower():
            for name, gains in controller.gains.items():
                for moved in (name,) if name else controller.joints:
                    given[moved] = (gains.get("p", 0.0), gains.get("d", 0.0))
    for plugin in model.plugins:
        leaves = {key: key.rpartition(".")[2].partition("[")[0] for key in plugin.values}
        numbers = {key: value for key, text in plugin.values.items() if (value := _number(text)) is not None}
        stiffness = [value for key, value in numbers.items() if _STIFFNESS.search(leaves[key])]
        damping = [value for key, value in numbers.items() if _DAMPING.search(leaves[key])]
        if len(set(stiffness)) == 1:
            words = {word for text in plugin.values.values() for word in text.replace(",", " ").split()}
            given |= dict.fromkeys(words & set(model.joints), (stiffness[0], damping[0] if damping else 0.0))
    for name, (k, c) in given.items():
        joint = model.joints.get(name)
        if joint is not None and joint.kind == "prismatic" and joint.stiffness is None and isfinite(k) and k > 0.0:
            joint.stiffness, joint.damping = k, joint.damping or (c if isfinite(c) and c > 0.0 else 0.0)


def _number(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None


def find_springs(roles: Roles) -> tuple[dict[str, WheelSpring], list[Change]]:
    """Return the spring joint of each wheel by the wheel's name; empty unless all four wheels have one."""
    take_springs(roles.tree.model)
    found: dict[str, WheelSpring] = {}
    for name, wheel in roles.wheels.items():
        others = {
            joint.name
            for other in roles.wheels.values()
            if other is not wheel
            for joint in roles.tree.path(other.joint.child)
        }
        steering = False
        for joint in roles.tree.path(wheel.joint.child):
            steering = steering or any(joint is item for item in roles.steering)
            up = _rate(roles, joint, wheel.point)
            if joint.name in others or not up:
                continue
            better = name not in found or (found[name].joint.stiffness is None and joint.stiffness is not None)
            if better:
                found[name] = WheelSpring(joint, up, steering)
    if not found or len(found) == len(WHEELS):
        return found, []
    missing = ", ".join(name.replace("_", " ") for name in WHEELS if name not in found)
    where = next(iter(found.values())).joint.where
    why = f"mirdrake needs springs at all four wheels; there is none at: {missing}"
    return {}, [Change(Code.SUSPENSION, where, "suspension", f"{len(found)} of 4 wheels on springs", None, why)]


def _rate(roles: Roles, joint: Joint, wheel: np.ndarray) -> float:
    """Return the vertical speed of a wheel over the speed of a joint; 0 if the joint is not its spring."""
    axis = roles.tree.axis(joint)
    if axis is None:
        return 0.0
    if joint.kind == "prismatic":
        return float(axis[2]) if abs(axis[2]) >= UPRIGHT else 0.0
    if joint.kind == "revolute" and joint.stiffness and abs(axis[2]) <= LEVEL:
        arm = wheel - roles.tree.pose(joint).translation()
        lever = float(np.cross(axis, arm)[2])
        return lever if abs(lever) > 0.3 * float(np.linalg.norm(arm)) else 0.0
    return 0.0


def make_springs(
    springs: dict[str, WheelSpring],
    *,
    body: Part,
    knuckles: tuple[Part, Part],
    wheels: dict[str, Part],
    carriers: dict[str, Part],
    layout: Layout,
    estimates: Estimates,
) -> tuple[SpringSet | None, list[Change]]:
    """Return stiffness, damping and travel of all springs; None if a spring would carry nothing.

    Args:
        springs: of all wheels.
        body: with its mass, as have all parts.
        knuckles: left and right.
        wheels: by name.
        carriers: what moves up and down with a wheel, by the wheel's name.
        layout: dimensions.
        estimates: for the whole car.
    """
    where = next(iter(springs.values())).joint.where
    parts = [body, *knuckles, *wheels.values(), *carriers.values()]
    # Wheel loads minus the weight below the springs: what each spring carries.
    com, weight = centre_of_mass(body, knuckles, wheels, layout, carriers), total_mass(parts) * GRAVITY
    share = float(com[0]) / layout.wheelbase
    track = share * layout.tracks[0] + (1.0 - share) * layout.tracks[1]
    loads = {}
    for name in WHEELS:
        front, left = name.startswith("front"), name.endswith("left")
        side = 0.5 + (1.0 if left else -1.0) * float(com[1]) / track
        knuckle = knuckles[not left].mass.mass if front else 0.0
        below = wheels[name].mass.mass + carriers[name].mass.mass + knuckle
        loads[name] = weight * (share if front else 1.0 - share) * side - below * GRAVITY
    if min(loads.values()) <= 0.0:
        name = min(loads, key=lambda key: loads[key])
        why = f"the {name.replace('_', ' ')} wheel and its unsprung parts are heavier than its wheel load"
        return None, [Change(Code.SUSPENSION, where, "suspension", f"springs at {len(springs)} wheels", None, why)]
    numbers: dict[str, Number] = {}
    changes: list[Change] = []
    for end in ENDS:
        pair = [springs[f"{end}_{side}"] for side in ("left", "right")]
        body_mass = 0.5 * (loads[f"{end}_left"] + loads[f"{end}_right"]) / GRAVITY
        _fill(end, pair, body_mass, estimates, numbers, changes)
    low, high = _travel(list(springs.values()), estimates, changes)
    return SpringSet(numbers, low, high), changes


def _fill(
    end: str,
    pair: Sequence[WheelSpring],
    body_mass: float,
    estimates: Estimates,
    numbers: dict[str, Number],
    changes: list[Change],
) -> None:
    """Set stiffness, damping and anti-roll bar of an axle at the wheel."""
    joint, what = pair[0].joint, f"suspension: {end} springs"
    given = [item.joint.stiffness / item.up**2 for item in pair if item.joint.stiffness is not None]
    good = [value for value in given if isfinite(value) and value > 0.0]
    slow = sqrt(estimates.max_correction / 2.0)  # times of this vehicle over those of a car
    # A stiffness of the source counts without an anti-roll bar; an estimated one has both.
    if good:
        stiffness = sum(good) / len(good)
        numbers[f"{end}_stiffness"] = Number(stiffness, f"imported: {joint.where}")
        numbers[f"{end}_anti_roll"] = Number(0.0, "imported: the source has no anti-roll bar")
        frequency = sqrt(stiffness / body_mass) / (2.0 * pi)
        low, high = (bound / slow for bound in USUAL)
        why = f"ride frequency {frequency:.2g} Hz; {low:.2g} to {high:.2g} Hz is common"
        became = f"{stiffness:.4g} N/m at the wheel" + ("" if low <= frequency <= high else ": please check")
    else:
        stiffness = float(getattr(estimates, f"{end}_stiffness"))
        numbers[f"{end}_stiffness"] = Number(stiffness, HOW[f"{end}_stiffness"])
        numbers[f"{end}_anti_roll"] = Number(float(getattr(estimates, f"{end}_anti_roll")), HOW[f"{end}_anti_roll"])
        became = f"{stiffness:.4g} N/m at the wheel: please check"
        why = HOW[f"{end}_stiffness"]
    was = "none" if not given else ", ".join(f"{value:.4g} N/m" for value in given)
    changes.append(Change(Code.SUSPENSION, joint.where, what, was, became, why))
    # Without damping in the source, the damping ratio is 0.3, common for cars.
    damping = [item.joint.damping / item.up**2 for item in pair]
    good = [value for value in damping if isfinite(value) and value > 0.0]
    if good:
        numbers[f"{end}_damping"] = Number(sum(good) / len(good), f"imported: {joint.where}")
        return
    value = 2.0 * 0.3 * sqrt(stiffness * body_mass)
    numbers[f"{end}_damping"] = Number(value, HOW[f"{end}_damping"])
    changes.append(
        Change(
            Code.SUSPENSION,
            joint.where,
            f"suspension: {end} dampers",
            "none",
            f"{value:.4g} N s/m",
            HOW[f"{end}_damping"],
        )
    )


def _travel(springs: Sequence[WheelSpring], estimates: Estimates, changes: list[Change]) -> tuple[float, float]:
    """Return the rebound (below 0) and bump travel [m] that all joints allow."""
    lows, highs = [], []
    for item in springs:
        lower, upper = item.joint.limits.lower, item.joint.limits.upper
        ends = sorted(item.up * value for value in (lower, upper) if value is not None and abs(value) < 1e3)
        if len(ends) == 2 and ends[1] > ends[0]:
            lows.append(ends[0])
            highs.append(ends[1])
    usual, where = estimates.suspension_travel, springs[0].joint.where
    if not lows:
        changes.append(
            Change(Code.SUSPENSION, where, "suspension: travel", "none", f"±{usual:.3g} m", HOW["suspension_travel"])
        )
        return -usual, usual
    low, high = max(lows), min(highs)
    if low < 0.0 < high:
        return low, high
    half = 0.5 * (min(highs) - min(lows))
    half = half if half > 0.0 else usual
    why = "the zero position of the loaded car is in the middle of the travel"
    changes.append(
        Change(Code.SUSPENSION, where, "suspension: travel", f"{low:.3g} … {high:.3g} m", f"±{half:.3g} m", why)
    )
    return -half, half
