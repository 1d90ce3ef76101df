"""Springs of a source as the suspension of the vehicle: one vertical joint per wheel, with stiffness and damping."""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import isfinite, pi, sqrt

import numpy as np

from mirdrake.core.constants import GRAVITY
from mirdrake.importing.changes import Change, Changes, Code
from mirdrake.importing.values import to_number
from mirdrake.importing.vehicles.car import Layout, Number, Parts, SpringSet
from mirdrake.importing.vehicles.model import Joint, SourceModel
from mirdrake.importing.vehicles.recognise import Roles
from mirdrake.importing.vehicles.straighten import SIDES
from mirdrake.vehicles.estimates import HOW, Estimates
from mirdrake.vehicles.spec import WHEELS

UPRIGHT = 0.7
"""Smallest cosine between the axis of a sliding joint and the vertical."""

LEVEL = 0.35
"""Largest sine between the axis of a swing arm and the horizontal."""

USUAL = (0.4, 8.0)
"""Ride frequencies [Hz] of a vehicle with the wheels of a car that need no check; small ones have higher ones."""

RIGID = 5.0
"""Stiffness of an axle without springs over that of its tyres: almost rigid, and stable at the usual time steps."""

ENDS = ("front", "rear")


@dataclass(frozen=True)
class WheelSpring:
    """A joint on which one wheel moves up and down.

    Attributes:
        joint: joint of the source, prismatic or a swing arm; None for a wheel of an axle without springs.
        up: rate of the wheel's height over the joint's position: cosine of a sliding joint's axis, lever [m] of an arm.
        steered: whether the joint is below the steering joint, and so part of the knuckle.
    """

    joint: Joint | None = None
    up: float = 1.0
    steered: bool = False

    @property
    def stiffness(self) -> float | None:
        """Stiffness at the wheel [N/m], as the source states it."""
        given = self.joint.stiffness if self.joint is not None else None
        return None if given is None else given / self.up**2


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
        numbers = {key: value for key, text in plugin.values.items() if (value := to_number(text)) is not None}
        stiffness = [value for key, value in numbers.items() if _STIFFNESS.search(leaves[key])]
        damping = [value for key, value in numbers.items() if _DAMPING.search(leaves[key])]
        # Only a plugin with one stiffness is clear; it holds for all joints that the plugin names.
        if len(set(stiffness)) == 1:
            words = {word for text in plugin.values.values() for word in text.replace(",", " ").split()}
            given |= dict.fromkeys(words & set(model.joints), (stiffness[0], damping[0] if damping else 0.0))
    for name, (k, c) in given.items():
        joint = model.joints.get(name)
        # A stiffness in the joint itself takes precedence.
        if joint is not None and joint.kind == "prismatic" and joint.stiffness is None and isfinite(k) and k > 0.0:
            joint.stiffness, joint.damping = k, joint.damping or (c if isfinite(c) and c > 0.0 else 0.0)


def find_springs(roles: Roles) -> tuple[dict[str, WheelSpring], list[Change]]:
    """Return the spring of each wheel by the wheel's name; empty unless both wheels of an axle have one.

    If only one axle has springs, the wheels of the other axle have springs without a joint of the source.
    """
    take_springs(roles.tree.model)
    springs = {name: spring for name in WHEELS if (spring := _spring_of(roles, name)) is not None}
    ends = [end for end in ENDS if all(f"{end}_{side}" in springs for side in SIDES)]
    if len(ends) == 2 or not springs:
        return springs, []
    if ends:
        return {name: springs[name] if name.startswith(ends[0]) else WheelSpring() for name in WHEELS}, []
    missing = ", ".join(name.replace("_", " ") for name in WHEELS if name not in springs)
    why = f"mirdrake needs springs at both wheels of an axle; there is none at: {missing}"
    was = f"{len(springs)} of 4 wheels on springs"
    return {}, [Change(Code.SUSPENSION, _place(springs.values()), "suspension", was, None, why)]


def _spring_of(roles: Roles, name: str) -> WheelSpring | None:
    """Return the spring between the body and a wheel, which no other wheel may share."""
    wheel = roles.wheels[name]
    # A joint that carries another wheel as well is an axle or a frame, not the spring of this wheel.
    others = (other for other in roles.wheels.values() if other is not wheel)
    shared = {joint.name for other in others for joint in roles.tree.path(other.joint.child)}
    spring: WheelSpring | None = None
    steered = False
    for joint in roles.tree.path(wheel.joint.child):
        steered = steered or any(joint is item for item in roles.steering)
        up = _rate(roles, joint, wheel.point)
        if joint.name in shared or not up:
            continue
        # Of several joints one with a stiffness counts, else the one nearest to the body.
        if spring is None or (spring.stiffness is None and joint.stiffness is not None):
            spring = WheelSpring(joint, up, steered)
    return spring


def _place(springs: Iterable[WheelSpring]) -> str:
    """Return the place in the source of the first spring that has one."""
    return next((spring.joint.where for spring in springs if spring.joint is not None), "")


def _rate(roles: Roles, joint: Joint, wheel: np.ndarray) -> float:
    """Return the vertical speed of a wheel over the speed of a joint; 0 if the joint is not its spring."""
    axis = roles.tree.axis(joint)
    if axis is None:
        return 0.0
    # A sliding joint moves the wheel along its axis: the rate is the vertical component.
    if joint.kind == "prismatic":
        return float(axis[2]) if abs(axis[2]) >= UPRIGHT else 0.0
    if joint.kind == "revolute" and joint.stiffness and abs(axis[2]) <= LEVEL:
        # A swing arm moves the wheel with axis x arm: the rate is the vertical component, a lever in m.
        arm = wheel - roles.tree.pose(joint).translation()
        lever = float(np.cross(axis, arm)[2])
        # With a shorter lever the wheel moves mainly to the side, so that the joint is not a suspension.
        return lever if abs(lever) > 0.3 * float(np.linalg.norm(arm)) else 0.0
    return 0.0


def make_springs(
    springs: dict[str, WheelSpring], parts: Parts, *, layout: Layout, estimates: Estimates
) -> tuple[SpringSet | None, list[Change]]:
    """Return stiffness, damping and travel of all springs; None if a spring would carry nothing.

    Args:
        springs: springs of all wheels.
        parts: parts with their masses.
        layout: dimensions.
        estimates: estimates for the whole car.
    """
    where = _place(springs.values())
    # Wheel loads minus the weight below the springs: what each spring carries.
    com, weight = parts.centre_of_mass(layout), parts.total_mass() * GRAVITY
    # Lever rule about the rear axle: share of the weight on the front axle.
    share = float(com[0]) / layout.wheelbase
    track = share * layout.tracks[0] + (1.0 - share) * layout.tracks[1]
    loads = {}
    for name in WHEELS:
        front, left = name.startswith("front"), name.endswith("left")
        # y is positive to the left, so a centre of mass on the left loads the left wheels.
        side = 0.5 + (1.0 if left else -1.0) * float(com[1]) / track
        # The unsprung mass: knuckle (front only), wheel and carrier.
        knuckle = parts.knuckles[not left].mass.mass if front else 0.0
        below = parts.wheels[name].mass.mass + parts.carriers[name].mass.mass + knuckle
        loads[name] = weight * (share if front else 1.0 - share) * side - below * GRAVITY
    if min(loads.values()) <= 0.0:
        name = min(loads, key=lambda key: loads[key])
        why = f"the {name.replace('_', ' ')} wheel and its unsprung parts are heavier than its wheel load"
        return None, [Change(Code.SUSPENSION, where, "suspension", f"springs at {len(springs)} wheels", None, why)]
    numbers: dict[str, Number] = {}
    changes = Changes()
    for end in ENDS:
        pair = [springs[f"{end}_{side}"] for side in SIDES]
        # Sprung mass above one wheel of the axle, for ride frequency and damping ratio.
        body_mass = 0.5 * (loads[f"{end}_left"] + loads[f"{end}_right"]) / GRAVITY
        _fill(end, pair, body_mass, where, estimates, numbers, changes)
    low, high = _travel(list(springs.values()), estimates, changes)
    return SpringSet(numbers, low, high), changes


def _fill(
    end: str,
    pair: Sequence[WheelSpring],
    body_mass: float,
    elsewhere: str,
    estimates: Estimates,
    numbers: dict[str, Number],
    changes: Changes,
) -> None:
    """Set stiffness, damping and anti-roll bar of an axle at the wheel.

    Changes of an axle without springs get the place `elsewhere`.
    """
    part, where = f"suspension: {end} springs", _place(pair) or elsewhere
    given = [item.stiffness for item in pair if item.stiffness is not None]
    good = [value for value in given if isfinite(value) and value > 0.0]
    slow = sqrt(estimates.max_correction / 2.0)  # times of this vehicle over those of a car
    # A stiffness of the source counts without an anti-roll bar; an estimated one has both.
    if good:
        stiffness = sum(good) / len(good)
        numbers[f"{end}_stiffness"] = Number(stiffness, f"imported: {where}")
        numbers[f"{end}_anti_roll"] = Number(0.0, "imported: the source has no anti-roll bar")
        # Froude scaling: a vehicle of a tenth of the size has times shorter by √10, hence higher ride frequencies.
        frequency = sqrt(stiffness / body_mass) / (2.0 * pi)
        low, high = (bound / slow for bound in USUAL)
        why = f"ride frequency {frequency:.2g} Hz; {low:.2g} to {high:.2g} Hz is common"
        became = f"{stiffness:.4g} N/m at the wheel" + ("" if low <= frequency <= high else ": please check")
    elif pair[0].joint is None:
        stiffness = RIGID * estimates.tyre_stiffness
        why = f"the source has no springs at this axle: {RIGID:g} times the stiffness of its tyres is almost rigid"
        numbers[f"{end}_stiffness"] = Number(
            stiffness, f"estimated: {RIGID:g} times the tyre, for an axle without springs"
        )
        numbers[f"{end}_anti_roll"] = Number(0.0, "imported: the source has no anti-roll bar")
        became = f"{stiffness:.4g} N/m at the wheel: please check"
    else:
        stiffness = float(getattr(estimates, f"{end}_stiffness"))
        why = HOW[f"{end}_stiffness"]
        numbers[f"{end}_stiffness"] = Number(stiffness, why)
        numbers[f"{end}_anti_roll"] = Number(float(getattr(estimates, f"{end}_anti_roll")), HOW[f"{end}_anti_roll"])
        became = f"{stiffness:.4g} N/m at the wheel: please check"
    was = "none" if not given else ", ".join(f"{value:.4g} N/m" for value in given)
    changes.add(Code.SUSPENSION, where, part, was, became, why)
    # Force and speed of a joint both scale with the rate, so its damping at the wheel has the rate squared.
    # Without damping in the source, the damping ratio is 0.3, common for cars.
    damping = [item.joint.damping / item.up**2 for item in pair if item.joint is not None]
    good = [value for value in damping if isfinite(value) and value > 0.0]
    if good:
        numbers[f"{end}_damping"] = Number(sum(good) / len(good), f"imported: {where}")
        return
    value, why = 2.0 * 0.3 * sqrt(stiffness * body_mass), HOW[f"{end}_damping"]
    numbers[f"{end}_damping"] = Number(value, why)
    changes.add(Code.SUSPENSION, where, f"suspension: {end} dampers", "none", f"{value:.4g} N s/m", why)


def _travel(springs: Sequence[WheelSpring], estimates: Estimates, changes: Changes) -> tuple[float, float]:
    """Return the rebound (below 0) and bump travel [m] that all joints allow."""
    lows, highs = [], []
    for item in springs:
        if item.joint is None:
            continue
        lower, upper = item.joint.limits.lower, item.joint.limits.upper
        # SDF writes "no limit" as ±1e16, so huge values are not ends of the travel.
        ends = sorted(item.up * value for value in (lower, upper) if value is not None and abs(value) < 1e3)
        if len(ends) == 2 and ends[1] > ends[0]:
            lows.append(ends[0])
            highs.append(ends[1])
    usual, where = estimates.suspension_travel, _place(springs)
    if not lows:
        changes.add(Code.SUSPENSION, where, "suspension: travel", "none", f"±{usual:.3g} m", HOW["suspension_travel"])
        return -usual, usual
    low, high = max(lows), min(highs)
    # Zero has to be inside of the travel, because it is the position of the loaded car.
    if low < 0.0 < high:
        return low, high
    half = 0.5 * (high - low)
    half = half if half > 0.0 else usual
    why = "the zero position of the loaded car is in the middle of the travel"
    changes.add(Code.SUSPENSION, where, "suspension: travel", f"{low:.3g} … {high:.3g} m", f"±{half:.3g} m", why)
    return -half, half
