"""Changes of joints: fixed joints, actuators, plugins and gains."""

from collections.abc import Iterable, Sequence
from math import isfinite

from mirdrake.importing.changes import Change, Changes, Code
from mirdrake.importing.values import to_number
from mirdrake.importing.vehicles.limits import driven_wheels, limit_text
from mirdrake.importing.vehicles.model import Controller, Joint, Plugin, SourceModel
from mirdrake.importing.vehicles.recognise import Roles

MOST_NUMBERS = 24
"""Numbers of a plugin that a report names."""

_SUSPENSION = "mirdrake needs springs at both wheels of an axle; this one is fixed at its zero position"
_WHY = {
    "revolute": "it neither steers a front wheel nor drives a wheel",
    "continuous": "it neither steers a front wheel nor drives a wheel",
}


def report_joints(roles: Roles, *, sprung: Sequence[Joint] = ()) -> list[Change]:
    """Return the changes of joints that are fixed, change their type, lose friction or get an actuator.

    Args:
        roles: roles of the joints.
        sprung: joints that become the suspension.
    """
    changes = Changes()
    # Joints are compared by identity: a joint that steers and spins has both roles.
    wheels = [wheel.joint for wheel in roles.wheels.values()]
    used = [*wheels, *(joint for joint in roles.steering if all(joint is not other for other in wheels))]
    reported = {change.part for change in roles.changes if change.code is Code.JOINT_FIXED}
    # Only a prismatic joint that carries a wheel is a suspension.
    carrying = {joint.name for wheel in wheels for joint in roles.tree.path(wheel.child)}
    for joint in roles.tree.above.values():
        if joint.kind != "fixed" and all(joint is not other for other in (*used, *sprung)):
            part = f"joint '{joint.name}'"
            if part not in reported:
                springs = joint.kind == "prismatic" and joint.name in carrying
                code = Code.SUSPENSION_FIXED if springs else Code.JOINT_FIXED
                why = _SUSPENSION if springs else _WHY.get(joint.kind, "mirdrake has no such joint in a car")
                changes.add(code, joint.where, part, _words(joint), "fixed at zero", why)
    for joint in used:
        changes += _of_used(joint, spins=any(joint is other for other in wheels))
    for joint in sprung:
        why = "suspension travel is vertical in mirdrake; zero is the position of the loaded car at rest"
        became = "prismatic, along the vertical: suspension"
        changes.add(Code.JOINT, joint.where, f"joint '{joint.name}'", _words(joint), became, why)
    changes += _actuators(roles, used)
    return changes


def _words(joint: Joint) -> str:
    words = [joint.kind]
    low, high = joint.limits.lower, joint.limits.upper
    unit, spring = ("m", "N/m") if joint.kind == "prismatic" else ("rad", "N m/rad")
    if low is not None or high is not None:
        words.append(f"{limit_text(low)} … {limit_text(high)} {unit}")
    if joint.stiffness is not None:
        words.append(f"stiffness {joint.stiffness:.4g} {spring}")
    if joint.damping:
        words.append(f"damping {joint.damping:.4g} {spring.replace('N m/rad', 'N m s/rad').replace('N/m', 'N s/m')}")
    if joint.mimic:
        words.append(f"follows '{joint.mimic}'")
    return ", ".join(words)


def _of_used(joint: Joint, *, spins: bool) -> list[Change]:
    """Return the changes of a wheel or steering joint."""
    changes = Changes()
    part = f"joint '{joint.name}'"
    # The two axes of such a joint become joints of their own, with a knuckle between them.
    if joint.kind in ("universal", "revolute2"):
        became = "a steering joint, a knuckle and a wheel joint"
        why = "a joint has one degree of freedom in mirdrake"
        changes.add(Code.JOINT, joint.where, part, f"{joint.kind}: steers and spins", became, why)
    elif spins and joint.kind != "continuous":
        changes.add(Code.JOINT, joint.where, part, _words(joint), "continuous", "a wheel joint has no limits")
    if joint.mimic:
        why = "the Ackermann law sets the angle of each wheel" if not spins else "each wheel rolls independently"
        changes.add(Code.JOINT, joint.where, f"{part}: mimic", f"follows '{joint.mimic}'", None, why)
    if joint.damping or joint.friction:
        was = f"damping {joint.damping:.4g} N m s/rad, friction {joint.friction:.4g} N m"
        why = "rolling resistance is a property of the tyre" if spins else "damping is a property of the steering servo"
        changes.add(Code.JOINT, joint.where, f"{part}: losses", was, None, why)
    return changes


def _actuators(roles: Roles, used: Sequence[Joint]) -> list[Change]:
    """Return the changes of joints without actuator, of gear ratios and of plugins."""
    model = roles.tree.model
    moved = {item.joint for item in model.transmissions}
    missing = [joint for joint in used if joint.name not in moved]
    changes = Changes()
    if missing:
        names = ", ".join(f"'{joint.name}'" for joint in missing)
        why = "each wheel has a brake and each steering joint a servo"
        changes.add(Code.ACTUATOR, missing[0].where, f"actuators of {names}", "none", "added", why)
    for item in model.transmissions:
        # Only gear ratios at wheels and steering change what a torque means.
        if item.reduction != 1.0 and any(item.joint == joint.name for joint in used):
            was = f"{item.reduction:g}"
            why = "torques are given at the joint"
            changes.add(Code.ACTUATOR, item.where, f"joint '{item.joint}': reduction", was, None, why)
    for plugin in model.plugins:
        part = f"plugin '{plugin.name or plugin.filename}'"
        was = ", ".join([plugin.filename, *_numbers_of(plugin)])
        changes.add(Code.PLUGIN, plugin.where, part, was, None, "Gazebo plugins are not executed")
    return changes


def _numbers_of(plugin: Plugin) -> list[str]:
    """Return the numeric parameters of a plugin by name."""
    numbers = {key: to_number(text) for key, text in plugin.values.items()}
    words = [f"{key} {value:.6g}" for key, value in numbers.items() if value is not None]
    return words[:MOST_NUMBERS] + (["…"] if len(words) > MOST_NUMBERS else [])


# --- gains -------------------------------------------------------------------------------------------------------


def imported_gains(model: SourceModel, roles: Roles, changes: Changes) -> dict[str, object] | None:
    """Return variants/imported.yaml with the PID gains of the source; None if it has none for wheels and steering."""
    wheels = [roles.wheels[name].joint.name for name in driven_wheels(roles.drive)]
    gains_by_loop = {
        "wheel_speed": _gains(model, wheels),
        "steering": _gains(model, [joint.name for joint in roles.steering]),
    }
    known = {part: item for part, item in gains_by_loop.items() if item is not None}
    for part, (gains, controller) in known.items():
        was = ", ".join(f"{key} {value:g}" for key, value in gains.items())
        # A variant with half of the gains would mix two tunings.
        complete = len(known) == len(gains_by_loop)
        became = "in variants/imported.yaml" if complete else None
        why = (
            "the estimated gains are the default; these are for comparison"
            if complete
            else "the gains of the other joints are missing"
        )
        changes.add(Code.GAINS, controller.where, f"gains of {part} ('{controller.name}')", was, became, why)
    if len(known) < len(gains_by_loop):
        return None
    control = {part: _pid(gains) for part, (gains, _) in known.items()}
    places = ", ".join(dict.fromkeys(controller.where for _, controller in known.values()))
    return {"description": f"With the PID gains of the source ({places})", "control": control}


def _gains(model: SourceModel, joints: Iterable[str]) -> tuple[dict[str, float], Controller] | None:
    """Return the gains of the first joint whose controller outputs a torque."""
    wanted = list(joints)
    for controller in model.controllers:
        kind = controller.kind.lower()
        # Gains of a controller with another output have other units.
        if kind and "effort" not in kind:
            continue
        for joint, gains in controller.gains.items():
            mine = joint in wanted or (not joint and any(name in wanted for name in controller.joints))
            good = all(isfinite(value) for value in gains.values()) and gains.get("p", 0.0) > 0.0
            if mine and good and min(gains.get(key, 0.0) for key in ("p", "i", "d")) >= 0.0:
                return gains, controller
    return None


def _pid(gains: dict[str, float]) -> dict[str, object]:
    pid: dict[str, object] = {"kind": "pid", "kp": gains["p"], "ki": gains.get("i", 0.0), "kd": gains.get("d", 0.0)}
    clamp = abs(gains.get("i_clamp", gains.get("i_clamp_max", 0.0)))
    if clamp > 0.0:
        pid["max_integral"] = clamp
    return pid
