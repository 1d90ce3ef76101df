"""Limits, torques and friction of a car: possible values of the source are kept, others are estimated.

Limits of joints and figures of drive plugins have the same weight: the smallest one is used.
"""

from collections.abc import Iterator, Sequence
from math import inf, isfinite, pi

from mirdrake.importing.changes import Change, Changes, Code, unusual
from mirdrake.importing.vehicles.car import Number
from mirdrake.importing.vehicles.model import Limits, Link, Surface
from mirdrake.importing.vehicles.recognise import Roles, Wheel, turns_freely
from mirdrake.importing.vehicles.stated import Stated, read_stated
from mirdrake.vehicles.estimates import HOW, WHEEL_SPEED, Estimates
from mirdrake.vehicles.spec import Drive

Given = tuple[float | None, str]
"""A value of the source and its place; None where the source has none."""

POWER_SHARE = 0.45
"""Of the top speed up to which a powertrain with the torque of the source has it, as the Bolt."""

STEERING_LIMIT = 0.6
"""Of the inner wheel [rad], where a source has none: Bolt, Escape and Polaris GEM have 0.6 to 0.61."""

FRICTION = (0.1, 2.0)
"""Friction that a tyre on a road may have; Gazebo models have up to 1e7, meant as "does not slip"."""

USUAL_LIMIT = (0.1, 1.2)
"""Steering limits [rad] that need no check."""

TORQUE = (0.1, 4.0)
"""Drive torque of a source over the estimate that needs no check."""

EFFORT = (0.3, 10.0)
"""The same for the steering."""

RATE = (0.2, 20.0)
"""Steering rates [rad/s] that need no check."""

SPEED = (1.5, 100.0)
"""Maximum speeds [m/s] that need no check."""

BRAKE = (0.2, 4.0)
"""Brake torque of a source over the estimate that needs no check."""

MOST_TORQUE, MOST_EFFORT, MOST_RATE, MOST_SPEED = 40.0, 100.0, 100.0, 150.0
"""Above them a number means "no limit": a thrust of 20 g; a steering torque that moves 80 wheel loads at the wheel's
radius; a rate [rad/s] of no servo; a speed [m/s] of no vehicle on wheels that roll."""


def steering_limit(roles: Roles) -> tuple[Number, list[Change]]:
    """Return the largest steering angle of the inner wheel [rad]."""
    inner: list[tuple[float, str]] = []
    loose: list[tuple[float, str, str, str]] = []  # numbers at joints that have no limits
    changes = Changes()
    # Joint limits count from the angle that turns left, so those of a reversed axis are exchanged.
    for side, joint in zip(("left", "right"), roles.steering, strict=True):
        axis = roles.tree.axis(joint)
        up = axis is None or axis[2] >= 0.0
        # The inner wheel turns further: towards its own side the left wheel is the inner one.
        low, high = _range(joint.limits)
        if not up:
            low, high = -high, -low
        reach, outer = (high, -low) if side == "left" else (-low, high)
        part = f"joint '{joint.name}': limits"
        was = f"{limit_text(joint.limits.lower)} … {limit_text(joint.limits.upper)} rad"
        # A continuous joint may carry limits that URDF ignores; they are a hint at what its author meant.
        free = turns_freely(joint, joint.limits)
        if free and 0.0 < reach < pi / 2.0 and 0.0 < outer < pi / 2.0:
            loose.append((reach, joint.where, part, f"{joint.kind}, {was}"))
        elif free:
            why = "a steering joint has limits"
            changes.add(Code.LIMIT, joint.where, part, f"{joint.kind}, {was}", "see the steering limit", why)
        elif not (reach > 0.0 and outer > 0.0):
            changes.add(
                Code.LIMIT, joint.where, part, was, "see the steering limit", "the wheel cannot steer to both sides"
            )
        elif reach >= pi / 2.0:
            changes.add(
                Code.LIMIT, joint.where, part, was, "see the steering limit", "steering angles are below 90 degrees"
            )
        else:
            inner.append((reach, joint.where))
            # Within 1 % the author gave both wheels the same limit; more is a deliberate outer angle.
            if abs(outer - reach) > 0.01 * reach:
                why = "the limit is that of the inner wheel; the outer angle follows from the Ackermann law"
                changes.add(Code.LIMIT, joint.where, part, was, f"±{reach:.4g} rad", why)
    # Values at joints without limits are used if no joint has valid limits.
    for reach, where, part, was in loose:
        if inner:
            changes.add(Code.LIMIT, where, part, was, "see the steering limit", "a steering joint has limits")
        else:
            why = "a continuous joint has no limits; its limit values are used"
            changes.add(Code.LIMIT, where, part, was, f"±{reach:.4g} rad", why)
    inner = inner or [(reach, where) for reach, where, _, _ in loose]
    # A plugin commands at most its own limit, so the smaller one acts.
    stated = [item for item in _all_stated(roles) if item.figure == "steering_limit"]
    tight = min((item for item in stated if item.value > 0.0), key=lambda item: item.value, default=None)
    if tight is not None and tight.value < min((reach for reach, _ in inner), default=inf):
        was = f"±{min(inner)[0]:.4g} rad at the joints" if inner else "none at the joints"
        why = f"{tight.key} of the plugin, used for the inner wheel"
        changes.add(Code.LIMIT, tight.where, "steering limit", was, f"±{tight.value:.4g} rad", why)
        changes += _check_usual("steering limit", "rad", tight.value, tight.where, USUAL_LIMIT)
        return Number(tight.value, f"imported: plugin, {tight.where}"), changes
    if not inner:
        text = f"estimated: {STEERING_LIMIT:g} rad, value of the Bolt; no usable limit in the source"
        where = roles.steering[0].where
        changes.add(Code.LIMIT, where, "steering limit", "none", f"±{STEERING_LIMIT:g} rad", "value of the Bolt")
        return Number(STEERING_LIMIT, text), changes
    limit, where = min(inner)
    # mirdrake has one limit for both sides: the smaller one is reached by both.
    if len(inner) == 2 and abs(inner[0][0] - inner[1][0]) > 0.01 * limit:
        was = f"left {inner[0][0]:.4g}, right {inner[1][0]:.4g} rad"
        changes.add(
            Code.LIMIT, where, "steering limit", was, f"±{limit:.4g} rad", "the limit is the same to both sides"
        )
    changes += _check_usual("steering limit", "rad", limit, where, USUAL_LIMIT)
    return Number(limit, f"imported: {where}"), changes


def _all_stated(roles: Roles) -> list[Stated]:
    """Return the figures of plugins, and those of the command interfaces of ros2_control."""
    stated, model = read_stated(roles.tree.model.plugins), roles.tree.model
    steering = {joint.name for joint in roles.steering}
    driven = {roles.wheels[name].joint.name: roles.wheels[name] for name in driven_wheels(roles.drive)}
    for entry in model.transmissions:
        scales: dict[str, tuple[str, float]] = {}  # figure and scale by interface
        if entry.joint in steering:
            scales = {"position": ("steering_limit", 1.0), "velocity": ("steering_rate", 1.0)}
            scales["effort"] = ("steering_effort", 1.0)
        elif entry.joint in driven:
            # The velocity range of a wheel is an angular one; times the radius it is the speed of the car.
            scales = {"velocity": ("max_speed", driven[entry.joint].shape.radius), "effort": ("torque", 1.0)}
        for interface, largest in entry.ranges.items():
            if interface in scales:
                figure, scale = scales[interface]
                stated.append(Stated(figure, "", largest * scale, f"wheel {interface} range", entry.where))
    return stated


def _range(limits: Limits) -> tuple[float, float]:
    low = -inf if limits.lower is None else limits.lower
    high = inf if limits.upper is None else limits.upper
    return low, high


def limit_text(value: float | None) -> str:
    """Return a limit for a report."""
    return "none" if value is None else f"{value:.4g}"


def collect_numbers(
    roles: Roles, limit: Number, estimates: Estimates, tyres: tuple[Estimates, Estimates]
) -> tuple[dict[str, Number], list[Change]]:
    """Return all numbers of a car except dimensions and masses, and the changes.

    Args:
        roles: roles of the joints.
        limit: limit of the steering.
        estimates: estimates for the whole car.
        tyres: estimates with the radius and width of the front and of the rear wheels.
    """
    changes = Changes()
    numbers = {"steering_limit": limit}
    steering, wheels = roles.steering, roles.wheels
    stated = _all_stated(roles)
    # The smallest wheel turns fastest at a given speed of the car.
    radius = min(wheel.shape.radius for wheel in wheels.values())

    def plugins(figure: str, scale: float = 1.0) -> list[Given]:
        matching = [item for item in stated if item.figure == figure]
        return [(item.value * scale, f"plugin, {item.where}") for item in matching]

    # Limits that plugins state come before those of the joints.
    effort = estimates.steering_effort
    rates = [(joint.limits.velocity, joint.where) for joint in steering]
    efforts = [(joint.limits.effort, joint.where) for joint in steering]
    speeds = [(_limits(wheel).velocity, wheel.joint.where) for wheel in wheels.values()]
    possible: tuple[tuple[str, str, str, list[Given], tuple[float, float], float], ...] = (
        ("steering_rate", "steering rate", "rad/s", plugins("steering_rate") + rates, RATE, MOST_RATE),
        ("steering_effort", "steering torque", "N m", plugins("steering_effort") + efforts,
         (EFFORT[0] * effort, EFFORT[1] * effort), MOST_EFFORT * effort),
        ("wheel_speed_limit", "speed limit of the wheels", "rad/s", plugins("max_speed", 1.0 / radius) + speeds,
         (SPEED[0] / radius, SPEED[1] / radius), MOST_SPEED / radius),
    )  # fmt: skip
    for key, part, unit, given, usual, possible_limit in possible:
        numbers[key] = _choose_value(part, unit, given, usual, possible_limit, _estimate(estimates, key), changes)
    numbers["max_torque"] = _drive_torque(roles, stated, estimates, changes)
    numbers["brake_torque"], numbers["brake_front_share"] = _brakes(stated, estimates, changes)
    for field in ("rolling_resistance", "steering_ratio", "drag_area", "tyre_dissipation"):
        numbers[field] = _estimate(estimates, field)
    ratio = next((item for item in stated if item.figure == "steering_ratio" and 1.0 <= item.value <= 100.0), None)
    if ratio is not None:
        numbers["steering_ratio"] = Number(ratio.value, f"imported: plugin, {ratio.where}")
    # A stated torque gives the power, a stated top speed changes it in proportion.
    top = min(numbers["wheel_speed_limit"].value, WHEEL_SPEED)
    power = Number(estimates.max_power * top / estimates.wheel_speed_limit, HOW["max_power"])
    if numbers["max_torque"].source.startswith("imported"):
        how = f"estimated: full torque up to {POWER_SHARE} of the top speed, as the Bolt"
        power = Number(numbers["max_torque"].value * top * POWER_SHARE, how)
    numbers["max_power"] = power
    for end, tyre in zip(("front", "rear"), tyres, strict=True):
        pair = [wheels[f"{end}_{side}"] for side in ("left", "right")]
        numbers[f"{end}_tyre_stiffness"] = _estimate(tyre, "tyre_stiffness")
        numbers[f"{end}_friction"] = _friction(roles, end, pair, changes)
    _report_stiffness(roles, list(wheels.values()), numbers, changes)
    return numbers, changes


def _drive_torque(roles: Roles, stated: Sequence[Stated], estimates: Estimates, changes: Changes) -> Number:
    """Return the torque of all driven wheels together [N m]."""
    driven = driven_wheels(roles.drive)
    share = estimates.max_torque / len(driven)
    ends = {name.split("_")[0] for name in driven}
    given: list[Given] = []
    for item in stated:
        if item.figure == "torque" and item.value > 0.0 and item.end in (*ends, ""):
            # Without an axle or the word wheel, a figure is of one wheel or of all: the nearer estimate decides, with
            # the geometric mean of both as the border.
            per_wheel = item.end or "wheel" in item.key.lower() or item.value <= share * len(driven) ** 0.5
            given.append((item.value if per_wheel else item.value / len(driven), f"plugin, {item.where}"))
    given += [(_limits(roles.wheels[name]).effort, roles.wheels[name].joint.where) for name in driven]
    torque = _choose_value(
        "torque of a driven wheel",
        "N m",
        given,
        (TORQUE[0] * share, TORQUE[1] * share),
        MOST_TORQUE * share,
        Number(share, HOW["max_torque"]),
        changes,
    )
    # A plugin that states both axles may drive them differently, so the total is not that of equal wheels.
    possible = [item for item in stated if item.figure == "torque" and 0.0 < item.value <= MOST_TORQUE * share]
    by_end = {item.end: item for item in possible if item.end}
    total = torque.value * len(driven)
    if roles.drive == "all" and len(by_end) == 2 and torque.source.startswith("imported: plugin"):
        total = 2.0 * sum(item.value for item in by_end.values())
    text = torque.source if torque.source.startswith("estimated") else f"{torque.source}, of {len(driven)} wheels"
    return Number(total, text)


def _brakes(stated: Sequence[Stated], estimates: Estimates, changes: Changes) -> tuple[Number, Number]:
    """Return the brake torque of all wheels together [N m] and the share of the front axle [-]."""
    # Plugins state brake torques per wheel, per axle or in total.
    brakes = [item for item in stated if item.figure == "brake_torque" and isfinite(item.value)]
    estimate, share = _estimate(estimates, "brake_torque"), _estimate(estimates, "brake_front_share")
    if not any(item.value > 0.0 for item in brakes):
        return estimate, share
    by_end = {item.end: item.value for item in brakes}
    where = brakes[0].where
    # Figures are of one wheel; without an axle also of all together: whichever is nearer to the estimate.
    if "front" in by_end and "rear" in by_end:
        total = 2.0 * (by_end["front"] + by_end["rear"])
    elif "front" in by_end:
        total = 2.0 * by_end["front"] / share.value
    elif "rear" in by_end:
        total = 2.0 * by_end["rear"] / (1.0 - share.value)
    else:
        total = by_end[""] if by_end[""] >= 0.5 * estimate.value else 4.0 * by_end[""]
    allowed = (BRAKE[0] * estimate.value, BRAKE[1] * estimate.value)
    total_number = _choose_value(
        "brake torque", "N m", [(total, f"plugin, {where}")], allowed, MOST_TORQUE * estimate.value, estimate, changes
    )
    if "front" in by_end and "rear" in by_end and total_number is not estimate:
        share = Number(2.0 * by_end["front"] / total, f"imported: plugin, {where}")
    return total_number, share


def driven_wheels(drive: Drive) -> tuple[str, ...]:
    """Return names of the driven wheels."""
    front, rear = ("front_left", "front_right"), ("rear_left", "rear_right")
    return {"front": front, "rear": rear, "all": front + rear}[drive]


def _limits(wheel: Wheel) -> Limits:
    return wheel.joint.limits2 if wheel.second else wheel.joint.limits


def _estimate(estimates: Estimates, field: str) -> Number:
    return Number(float(getattr(estimates, field)), HOW[field])


def _choose_value(
    part: str,
    unit: str,
    given: Sequence[Given],
    usual: tuple[float, float],
    possible_limit: float,
    estimate: Number,
    changes: Changes,
) -> Number:
    """Return the smallest possible value of the source, else the estimate."""
    # Several places may limit the same quantity; what is smallest acts first.
    # Gazebo files use zero, negative and huge values for "no limit".
    known = [(value, where) for value, where in given if value is not None]
    good = [(value, where) for value, where in known if isfinite(value) and 0.0 < value <= possible_limit]
    how = estimate.source.removeprefix("estimated: ")
    if good:
        value, where = min(good, key=lambda item: item[0])  # the first of equals
        changes += _check_usual(part, unit, value, where, usual)
        return Number(value, f"imported: {where}")
    if known:
        value, where = known[0]
        why = (
            "zero or less means no limit"
            if value <= 0.0
            else "not a number"
            if value != value
            else f"impossible, so it means no limit; at most {possible_limit:.3g} {unit} is possible"
        )
        became = f"{estimate.value:.4g} {unit}: {how}"
        changes.add(Code.LIMIT, _place(where), part, f"{value:.4g} {unit}", became, why)
    else:
        where = given[0][1]
        changes.add(Code.LIMIT, where, part, "none", f"{estimate.value:.4g} {unit}: {how}", "not in the source")
    return estimate


def _check_usual(part: str, unit: str, value: float, where: str, usual: tuple[float, float]) -> Iterator[Change]:
    """Yield a change for a value that is possible but unusual."""
    if not usual[0] <= value <= usual[1]:
        why = f"unusual: {usual[0]:.3g} to {usual[1]:.3g} {unit} is common"
        yield unusual(_place(where), part, f"{value:.4g} {unit}", why)


def _place(where: str) -> str:
    """Return ``file:line`` of the origin of a value."""
    return where.removeprefix("plugin, ")


# --- contact -----------------------------------------------------------------------------------------------------


def _wheel_links(roles: Roles, wheels: Sequence[Wheel]) -> list[Link]:
    links = roles.tree.model.links
    return [links[name] for wheel in wheels for name in roles.tree.rigid_with(wheel.joint.child, ())]


def _friction(roles: Roles, end: str, pair: Sequence[Wheel], changes: Changes) -> Number:
    """Return the friction coefficient of an axle's tyres; one for both directions of Gazebo."""
    # Gazebo has a coefficient along and one across, for each wheel; a tyre law has one per axle.
    surfaces = [link.surface for link in _wheel_links(roles, pair) if link.surface is not None]
    given = [(value, item.where) for item in surfaces for value in (item.mu, item.mu2) if value is not None]
    low, high = FRICTION
    good = [value for value, _ in given if isfinite(value) and low <= value <= high]
    part = f"friction of the {end} tyres"
    if good and len(good) == len(given):
        mean = sum(good) / len(good)
        where = given[0][1]
        if max(good) - min(good) > 1e-3 * mean:
            was = ", ".join(f"{value:g}" for value in good)
            why = "the same along and across, left and right"
            changes.add(Code.CONTACT, where, part, was, f"{mean:.4g}", why)
        return Number(mean, f"imported: {where}")
    if given:
        where = given[0][1]
        was = ", ".join(dict.fromkeys(f"{value:g}" for value, _ in given))
        why = f"tyres on roads have {low:g} to {high:g}; Gazebo's numbers mean that nothing slips"
        changes.add(Code.CONTACT, where, part, was, "0.9", why)
    else:
        changes.add(
            Code.CONTACT, pair[0].joint.where, part, "not stated", "0.9", HOW["friction"].removeprefix("estimated: ")
        )
    return Number(0.9, HOW["friction"])


def _report_stiffness(roles: Roles, wheels: Sequence[Wheel], numbers: dict[str, Number], changes: Changes) -> None:
    """Report contact stiffness and damping, which are solver settings of ODE."""
    surfaces = [link.surface for link in _wheel_links(roles, wheels) if link.surface is not None]
    given = [item for item in surfaces if item.stiffness is not None or item.damping is not None or item.others]
    if given:
        first = given[0]
        was = _contact_text(first)
        became = f"{numbers['front_tyre_stiffness'].value:.4g} N/m"
        why = "kp and kd belong to Gazebo's contact solver, not to tyres; estimated from the load"
        changes.add(Code.CONTACT, first.where, "contact stiffness of the tyres", was, became, why)
    # Contact of other bodies matters when the car turns over or hits something.
    turning = {link.name for link in _wheel_links(roles, wheels)}
    for name in roles.tree.poses:
        link = roles.tree.model.links[name]
        if link.surface is not None and name not in turning and (was := _contact_text(link.surface)):
            became = "that of all bodies: friction 0.5"
            why = "only tyres have a contact of their own"
            changes.add(Code.CONTACT, link.surface.where, f"link '{name}': contact", was, became, why)


def _contact_text(surface: Surface) -> str:
    """Return the contact data of a link for a report."""
    words = [f"friction {' and '.join(f'{mu:g}' for mu in (surface.mu, surface.mu2) if mu is not None)}"]
    words = words if surface.mu is not None or surface.mu2 is not None else []
    for name, value, unit in (("kp", surface.stiffness, "N/m"), ("kd", surface.damping, "N s/m")):
        if value is not None:
            words.append(f"{name} {value:.4g} {unit}")
    words += [f"{key} {value}" for key, value in surface.others.items()]
    return ", ".join(words)
