"""Limits, torques and friction of a car: what a source says plausibly is kept, the rest is estimated."""

import re
from collections.abc import Sequence
from math import inf, isfinite, pi

from mirdrake.vehicles.estimates import HOW, Estimates
from mirdrake.vehicles.importing.car import Number
from mirdrake.vehicles.importing.model import Change, Limits, Link, Surface
from mirdrake.vehicles.importing.recognise import Roles, Wheel, turns_freely
from mirdrake.vehicles.spec import Drive

STEERING_LIMIT = 0.6
"""Of the inner wheel [rad], where a source has none: Bolt, Escape and Polaris GEM have 0.6 to 0.61."""

FRICTION = (0.1, 2.0)
"""Friction that a tyre on a road may have; Gazebo models have up to 1e7, meant as "does not slip"."""

TORQUE = (0.1, 4.0)
"""Drive torque of a source over the estimate, within which it is believed."""

EFFORT = (0.3, 100.0)
"""The same for the steering."""

RATE = (0.2, 20.0)
"""Steering rates [rad/s] that are believed."""

WHEEL_SPEED = (5.0, 1000.0)
"""Wheel speeds [rad/s] that are believed."""

_STEERING_LIMIT = re.compile("max_?steer|steer(ing)?(_angle)?_?limit", re.IGNORECASE)


def steering_limit(roles: Roles) -> tuple[Number, list[Change]]:
    """The angle that the inner wheel reaches [rad]."""
    inner: list[tuple[float, str]] = []
    loose: list[tuple[float, str, str, str]] = []  # numbers at joints that have no limits
    changes = []
    for side, joint in zip(("left", "right"), roles.steering, strict=True):
        axis = roles.tree.axis(joint)
        up = axis is None or axis[2] >= 0.0
        low, high = _range(joint.limits)
        if not up:
            low, high = -high, -low
        reach, outer = (high, -low) if side == "left" else (-low, high)
        what = f"joint '{joint.name}': limits"
        was = f"{_text(joint.limits.lower)} … {_text(joint.limits.upper)} rad"
        free = turns_freely(joint, joint.limits)
        if free and 0.0 < reach < pi / 2.0 and 0.0 < outer < pi / 2.0:
            loose.append((reach, joint.where, what, f"{joint.kind}, {was}"))
        elif free:
            changes.append(Change(joint.where, what, f"{joint.kind}, {was}", "those below", "steering has an end"))
        elif not (reach > 0.0 and outer > 0.0):
            changes.append(Change(joint.where, what, was, "those below", "a wheel that cannot turn to both sides"))
        elif reach >= pi / 2.0:
            changes.append(
                Change(joint.where, what, was, "those below", "beyond a right angle a wheel rolls backwards")
            )
        else:
            inner.append((reach, joint.where))
            if abs(outer - reach) > 0.01 * reach:
                why = "limits mean the inner wheel; the outer one follows from the steering law"
                changes.append(Change(joint.where, what, was, f"±{reach:.4g} rad", why))
    for reach, where, what, was in loose:
        if inner:
            changes.append(Change(where, what, was, "those below", "steering has an end"))
        else:
            why = "steering has an end; a continuous joint has none, but its numbers say where it was meant"
            changes.append(Change(where, what, was, f"±{reach:.4g} rad", why))
    inner = inner or [(reach, where) for reach, where, _, _ in loose]
    plugin = None if inner else _plugin_limit(roles)
    if plugin is not None:
        value, where = plugin
        why = "the limit of the plugin, taken for the inner wheel"
        changes.append(Change(where, "steering limit", "none at the joints", f"±{value:.4g} rad", why))
        return Number(value, f"imported: plugin, {where}"), changes
    if not inner:
        text = f"estimated: {STEERING_LIMIT:g} rad, as the Bolt; no usable limit in the source"
        where = roles.steering[0].where
        changes.append(Change(where, "steering limit", "none", f"±{STEERING_LIMIT:g} rad", "as the Bolt"))
        return Number(STEERING_LIMIT, text), changes
    limit, where = min(inner)
    if len(inner) == 2 and abs(inner[0][0] - inner[1][0]) > 0.01 * limit:
        was = f"left {inner[0][0]:.4g}, right {inner[1][0]:.4g} rad"
        changes.append(Change(where, "steering limit", was, f"±{limit:.4g} rad", "a car steers alike to both sides"))
    return Number(limit, f"imported: {where}"), changes


def _plugin_limit(roles: Roles) -> tuple[float, str] | None:
    """The steering limit [rad] that a plugin has, and where; None if none has one."""
    for plugin in roles.tree.model.plugins:
        for key, text in plugin.values.items():
            if _STEERING_LIMIT.search(key.rpartition(".")[2]) is None:
                continue
            try:
                value = abs(float(text))
            except ValueError:
                continue
            if 0.0 < value < pi / 2.0:
                return value, plugin.where
    return None


def _range(limits: Limits) -> tuple[float, float]:
    low = -inf if limits.lower is None else limits.lower
    high = inf if limits.upper is None else limits.upper
    return low, high


def _text(value: float | None) -> str:
    return "none" if value is None else f"{value:.4g}"


def collect_numbers(
    roles: Roles, limit: Number, estimates: Estimates, tyres: tuple[Estimates, Estimates]
) -> tuple[dict[str, Number], list[Change]]:
    """All numbers of a car beside dimensions and masses, and what was not believed.

    Args:
        roles: of the joints.
        limit: of the steering.
        estimates: for the whole car.
        tyres: the same with the radius and width of the front and of the rear wheels.
    """
    changes: list[Change] = []
    numbers = {"steering_limit": limit}
    steering, wheels = roles.steering, roles.wheels
    driven = driven_wheels(roles.drive)
    numbers["steering_rate"] = _believe(
        "steering rate",
        "rad/s",
        [(joint.limits.velocity, joint.where) for joint in steering],
        RATE,
        _estimate(estimates, "steering_rate"),
        changes,
    )
    effort = estimates.steering_effort
    numbers["steering_effort"] = _believe(
        "steering torque",
        "N m",
        [(joint.limits.effort, joint.where) for joint in steering],
        (EFFORT[0] * effort, EFFORT[1] * effort),
        _estimate(estimates, "steering_effort"),
        changes,
    )
    speeds = [(_limits(wheel).velocity, wheel.joint.where) for wheel in wheels.values()]
    torques = [(_limits(wheels[name]).effort, wheels[name].joint.where) for name in driven]
    numbers["wheel_speed_limit"] = _believe(
        "speed limit of the wheels",
        "rad/s",
        speeds,
        WHEEL_SPEED,
        _estimate(estimates, "wheel_speed_limit"),
        changes,
    )
    share = estimates.max_torque / len(driven)
    torque = _believe(
        "torque of a driven wheel",
        "N m",
        torques,
        (TORQUE[0] * share, TORQUE[1] * share),
        Number(share, HOW["max_torque"]),
        changes,
    )
    total = torque.value * len(driven)
    text = torque.source if torque.source.startswith("estimated") else f"{torque.source}, of {len(driven)} wheels"
    numbers["max_torque"] = Number(total, text)
    for key, field in (
        ("max_power", "max_power"),
        ("brake_torque", "brake_torque"),
        ("brake_front_share", "brake_front_share"),
        ("rolling_resistance", "rolling_resistance"),
        ("steering_ratio", "steering_ratio"),
        ("drag_area", "drag_area"),
        ("tyre_resolution", "tyre_resolution"),
        ("tyre_dissipation", "tyre_dissipation"),
    ):
        numbers[key] = _estimate(estimates, field)
    for end, own in zip(("front", "rear"), tyres, strict=True):
        pair = [wheels[f"{end}_{side}"] for side in ("left", "right")]
        numbers[f"{end}_tyre_modulus"] = _estimate(own, "tyre_modulus")
        numbers[f"{end}_tyre_stiffness"] = _estimate(own, "tyre_point_stiffness")
        numbers[f"{end}_friction"] = _friction(roles, end, pair, changes)
    _say_stiffness(roles, list(wheels.values()), numbers, changes)
    return numbers, changes


def driven_wheels(drive: Drive) -> tuple[str, ...]:
    """Names of the driven wheels."""
    front, rear = ("front_left", "front_right"), ("rear_left", "rear_right")
    return {"front": front, "rear": rear, "all": front + rear}[drive]


def _limits(wheel: Wheel) -> Limits:
    return wheel.joint.limits2 if wheel.second else wheel.joint.limits


def _estimate(estimates: Estimates, field: str) -> Number:
    return Number(float(getattr(estimates, field)), HOW[field])


def _believe(
    what: str,
    unit: str,
    given: Sequence[tuple[float | None, str]],
    allowed: tuple[float, float],
    estimate: Number,
    changes: list[Change],
) -> Number:
    """The smallest given value if all are plausible, else the estimate."""
    known = [(value, where) for value, where in given if value is not None]
    good = [(value, where) for value, where in known if isfinite(value) and allowed[0] <= value <= allowed[1]]
    if known and len(good) == len(known):
        value, where = min(good)
        return Number(value, f"imported: {where}")
    how = estimate.source.removeprefix("estimated: ")
    if known:
        value, where = next(item for item in known if item not in good)
        why = (
            "zero or less, meant as no limit"
            if value <= 0.0
            else "no number"
            if value != value
            else (f"plausible are {allowed[0]:.3g} to {allowed[1]:.3g} {unit}")
        )
        changes.append(Change(where, what, f"{value:.4g} {unit}", f"{estimate.value:.4g} {unit}: {how}", why))
    else:
        where = given[0][1]
        changes.append(Change(where, what, "none", f"{estimate.value:.4g} {unit}: {how}", "not in the source"))
    return estimate


# --- contact -----------------------------------------------------------------------------------------------------


def _wheel_links(roles: Roles, wheels: Sequence[Wheel]) -> list[Link]:
    links = roles.tree.model.links
    return [links[name] for wheel in wheels for name in roles.tree.rigid_with(wheel.joint.child, ())]


def _friction(roles: Roles, end: str, pair: Sequence[Wheel], changes: list[Change]) -> Number:
    """Friction of an axle's tyres; mu and mu2 act along two directions, a tyre here has one for both."""
    surfaces = [link.surface for link in _wheel_links(roles, pair) if link.surface is not None]
    given = [(value, item.where) for item in surfaces for value in (item.mu, item.mu2) if value is not None]
    low, high = FRICTION
    good = [value for value, _ in given if isfinite(value) and low <= value <= high]
    what = f"friction of the {end} tyres"
    if good and len(good) == len(given):
        mean = sum(good) / len(good)
        where = given[0][1]
        if max(good) - min(good) > 1e-3 * mean:
            was = ", ".join(f"{value:g}" for value in good)
            why = "the same along and across, left and right"
            changes.append(Change(where, what, was, f"{mean:.4g}", why))
        return Number(mean, f"imported: {where}")
    if given:
        where = given[0][1]
        was = ", ".join(dict.fromkeys(f"{value:g}" for value, _ in given))
        why = f"tyres on roads have {low:g} to {high:g}; Gazebo's numbers mean that nothing slips"
        changes.append(Change(where, what, was, "0.9", why))
    else:
        changes.append(
            Change(pair[0].joint.where, what, "not said", "0.9", HOW["friction"].removeprefix("estimated: "))
        )
    return Number(0.9, HOW["friction"])


def _say_stiffness(roles: Roles, wheels: Sequence[Wheel], numbers: dict[str, Number], changes: list[Change]) -> None:
    """Contact stiffness and damping of ODE are solver settings."""
    surfaces = [link.surface for link in _wheel_links(roles, wheels) if link.surface is not None]
    given = [item for item in surfaces if item.stiffness is not None or item.damping is not None or item.others]
    if given:
        first = given[0]
        was = _contact_text(first)
        became = (
            f"modulus {numbers['front_tyre_modulus'].value:.4g} Pa, {numbers['front_tyre_stiffness'].value:.4g} N/m"
        )
        why = "kp and kd belong to Gazebo's contact solver, not to tyres; estimated from the load"
        changes.append(Change(first.where, "contact stiffness of the tyres", was, became, why))
    turning = {link.name for link in _wheel_links(roles, wheels)}
    for name in roles.tree.poses:
        link = roles.tree.model.links[name]
        if link.surface is not None and name not in turning and (was := _contact_text(link.surface)):
            became = "that of all bodies: friction 0.5"
            why = "only tyres have a contact of their own"
            changes.append(Change(link.surface.where, f"link '{name}': contact", was, became, why))


def _contact_text(surface: Surface) -> str:
    """What a source says about the contact of a link."""
    words = [f"friction {' and '.join(f'{mu:g}' for mu in (surface.mu, surface.mu2) if mu is not None)}"]
    words = words if surface.mu is not None or surface.mu2 is not None else []
    for name, value, unit in (("kp", surface.stiffness, "N/m"), ("kd", surface.damping, "N s/m")):
        if value is not None:
            words.append(f"{name} {value:.4g} {unit}")
    words += [f"{key} {value}" for key, value in surface.others.items()]
    return ", ".join(words)
