"""Import of vehicles: recognition by motion, correction of impossible values, and drives of the result."""

import re
from math import cos, pi, sin, tan
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from pydrake.math import RigidTransform, RollPitchYaw

from mirdrake.assembly.diagram import assemble
from mirdrake.cli import main
from mirdrake.core.errors import ConfigError, ModelError
from mirdrake.importing.changes import Changes
from mirdrake.importing.shape import Shape
from mirdrake.importing.vehicles import import_vehicle
from mirdrake.importing.vehicles.model import (
    Controller,
    Inertial,
    Joint,
    Limits,
    Link,
    Plugin,
    SourceModel,
    Surface,
    Transmission,
)
from mirdrake.importing.vehicles.recognise import recognise
from mirdrake.importing.vehicles.repair import repair
from mirdrake.importing.vehicles.report import assumptions
from mirdrake.importing.vehicles.ros_control import read_ros2_control
from mirdrake.importing.vehicles.springs import WheelSpring, _travel
from mirdrake.runs.simulation import Simulation
from mirdrake.vehicles import load_vehicle

WHEELBASE, TRACK, RADIUS, WIDTH, KINGPIN = 2.6, 1.5, 0.3, 0.2, 0.05
BODY, WHEEL, HUB = 1400.0, 20.0, 10.0
X, Y, Z = np.eye(3)
LIE = RollPitchYaw(pi / 2, 0.0, 0.0)  # a cylinder's axis from z to -y


def at(*xyz):
    return RigidTransform(np.array(xyz, dtype=float))


def box_tensor(mass, x, y, z):
    return mass / 12.0 * np.diag([y * y + z * z, x * x + z * z, x * x + y * y])


def wheel_tensor(mass=WHEEL, radius=RADIUS, width=WIDTH):
    across = mass * (3 * radius**2 + width**2) / 12.0
    return np.diag([across, mass * radius**2 / 2.0, across])


def wheel_link(name, radius=RADIUS, width=WIDTH, mass=WHEEL):
    shape = Shape("cylinder", (radius, width), RigidTransform(LIE, np.zeros(3)), where="car.urdf:50")
    inertial = Inertial(mass, RigidTransform(), wheel_tensor(mass, radius, width), "car.urdf:51")
    return Link(name, inertial, [], [shape], where="car.urdf:49")


def body_link(name="chassis"):
    shape = Shape("box", (4.0, 1.1, 0.6), at(0.0, 0.0, 0.3), where="car.urdf:5")
    tensor = box_tensor(BODY, 4.0, 1.5, 1.2)
    return Link(name, Inertial(BODY, at(0.0, 0.0, 0.2), tensor, "car.urdf:4"), [shape], [shape], where="car.urdf:3")


def axle(joint, parent, child, *position, axis=Y, kind="continuous"):
    return Joint(joint, kind, parent, child, at(*position), axis=axis, where="car.urdf:60")


def kingpin(joint, parent, child, *position, limit=0.6):
    limits = Limits(-limit, limit, 1000.0, 0.5)
    return Joint(joint, "revolute", parent, child, at(*position), axis=Z, limits=limits, where="car.urdf:70")


def add(model, *parts):
    for part in parts:
        (model.links if isinstance(part, Link) else model.joints)[part.name] = part
    return model


def car():
    """Return root in the middle of the car at axle height; names without meaning."""
    model = add(SourceModel("car"), body_link())
    half, side = WHEELBASE / 2, TRACK / 2
    for sign, letter in ((1, "a"), (-1, "b")):
        hub = Link(f"hub_{letter}", Inertial(HUB, RigidTransform(), np.diag([0.1, 0.1, 0.1])), where="car.urdf:40")
        add(model, hub, wheel_link(f"w1{letter}"), wheel_link(f"w2{letter}"))
        add(model, kingpin(f"k{letter}", "chassis", hub.name, half, sign * (side - KINGPIN), 0.0))
        add(model, axle(f"j1{letter}", hub.name, f"w1{letter}", 0.0, sign * KINGPIN, 0.0))
        add(model, axle(f"j2{letter}", "chassis", f"w2{letter}", -half, sign * side, 0.0))
    return model


def roles_of(model, drive=None):
    roles = recognise(model, drive)
    return {name: wheel.joint.name for name, wheel in roles.wheels.items()}, roles


def repaired(model, drive="rear"):
    return repair(model, recognise(model, drive), name="car")


def lines(item):
    return [f"{c.part} | {c.old} | {c.new_text} | {c.reason}" for c in item.changes]


def reports(item, *words):
    return any(all(word in line for word in words) for line in lines(item))


EXPECTED = {"front_left": "j1a", "front_right": "j1b", "rear_left": "j2a", "rear_right": "j2b"}


# --- recognising -------------------------------------------------------------------------------------------------


def test_wheels_and_steering_are_recognised_by_their_motion():
    wheels, roles = roles_of(car())
    assert wheels == EXPECTED
    assert [joint.name for joint in roles.steering] == ["ka", "kb"]


@pytest.mark.parametrize("yaw", [pi, pi / 2, -2.0])
def test_the_steered_axle_is_the_front_for_any_heading_of_the_source(yaw):
    # yaw turns the whole car below a new root: the left side stays left
    model = car()
    add(
        model,
        Link("root"),
        Joint("turn", "fixed", "root", "chassis", RigidTransform(RollPitchYaw(0, 0, yaw), [0, 0, 0])),
    )
    wheels, roles = roles_of(model)
    assert wheels == EXPECTED
    assert any(change.part == "direction of travel" for change in roles.changes) == (cos(yaw) < 0)
    layout = repaired(model).layout
    assert layout.wheelbase == pytest.approx(WHEELBASE)
    assert layout.X_MB.rotation().matrix()[:2, 0] == pytest.approx([cos(yaw), sin(yaw)])


def test_a_revolute_joint_with_the_limits_of_sdf_turns_freely():
    model = car()
    for name in EXPECTED.values():
        model.joints[name].kind = "revolute"
        model.joints[name].limits = Limits(-1e16, 1e16)
    assert roles_of(model)[0] == EXPECTED


@pytest.mark.parametrize("kind", ["universal", "revolute2"])
def test_a_joint_that_steers_and_spins_becomes_a_knuckle_and_a_wheel(kind):
    model = car()
    for letter, sign in (("a", 1), ("b", -1)):
        joint = model.joints.pop(f"j1{letter}")
        del model.joints[f"k{letter}"], model.links[f"hub_{letter}"]
        position = at(WHEELBASE / 2, sign * TRACK / 2, 0.0)
        add(model, Joint(joint.name, kind, "chassis", joint.child, position, axis=Z, axis2=Y, limits=Limits(-0.5, 0.5)))
    wheels, _ = roles_of(model)
    assert wheels == EXPECTED
    result = repaired(model)
    # a quarter of the wheel's 20 kg is the knuckle's
    assert result.knuckles[0].mass.mass == pytest.approx(5.0)
    assert result.wheels["front_left"].mass.mass == pytest.approx(15.0)
    assert result.steering_joints == ("j1a", "j1b")
    assert result.wheel_joints["front_left"] == "j1a_spin"
    assert result.numbers["steering_limit"].value == 0.5
    assert result.layout.kingpin_track == pytest.approx(TRACK)


@pytest.mark.parametrize("union", ["a", "b"])
def test_a_knuckle_on_one_side_only_leaves_the_total_mass(union):
    model, sign = car(), {"a": 1, "b": -1}[union]
    joint = model.joints.pop(f"j1{union}")
    model.links[joint.child].inertial.mass += HUB  # its wheel has the mass of the hub that it lacks
    del model.joints[f"k{union}"], model.links[f"hub_{union}"]
    position = at(WHEELBASE / 2, sign * TRACK / 2, 0.0)
    add(model, Joint(joint.name, "universal", "chassis", joint.child, position, axis=Z, axis2=Y))
    result = repaired(model)
    assert [part.mass.mass for part in result.knuckles] == pytest.approx([HUB, HUB])
    assert [result.wheels[f"front_{side}"].mass.mass for side in ("left", "right")] == pytest.approx([WHEEL, WHEEL])
    assert result.total_mass() == pytest.approx(BODY + 4 * WHEEL + 2 * HUB)


def test_suspension_joints_are_fixed_and_their_values_reported():
    model = car()
    for letter in "ab":
        spring = Joint(f"s{letter}", "prismatic", "chassis", f"slide_{letter}", model.joints[f"k{letter}"].X_PJ, axis=Z)
        spring.stiffness, spring.limits = 3152.0, Limits(-0.1, 0.1)
        model.joints[f"k{letter}"].parent = spring.child
        model.joints[f"k{letter}"].X_PJ = RigidTransform()
        add(model, Link(spring.child), spring)
        arm = Joint(f"t{letter}", "revolute", "chassis", f"arm_{letter}", limits=Limits(-0.3, 0.3), axis=Y)
        model.joints[f"j2{letter}"].parent = arm.child
        add(model, Link(arm.child), arm)
    model.joints["sb"].kind = "fixed"
    assert roles_of(model)[0] == EXPECTED
    result = repaired(model)
    assert reports(result, "joint 'sa'", "3152 N/m", "fixed at zero")
    assert reports(result, "joint 'tb'", "fixed at zero")
    assert result.layout.wheelbase == pytest.approx(WHEELBASE)


def test_of_two_steered_axles_the_rear_one_is_fixed():
    model = car()
    for letter, sign in (("a", 1), ("b", -1)):
        add(model, Link(f"rear_hub_{letter}"))
        add(model, kingpin(f"rk{letter}", "chassis", f"rear_hub_{letter}", -WHEELBASE / 2, sign * TRACK / 2, 0.0))
        model.joints[f"j2{letter}"] = axle(f"j2{letter}", f"rear_hub_{letter}", f"w2{letter}", 0.0, 0.0, 0.0)
    wheels, roles = roles_of(model)
    assert wheels == EXPECTED
    assert [change.part for change in roles.changes if change.new == "fixed at zero"] == [
        "joint 'rka'",
        "joint 'rkb'",
    ]
    result = repaired(model)
    assert len([line for line in lines(result) if "'rka'" in line]) == 1
    assert any("steering.rear" in line for line in assumptions(result))


def test_assumptions_name_an_estimated_mass_and_steering_limit_with_the_value_of_the_source():
    model = car()
    model.links["chassis"].inertial.mass = 0.02
    for letter in "ab":
        model.joints[f"k{letter}"].limits = Limits(-90.0, 90.0)
    said = " ".join(assumptions(repaired(model)))
    assert re.search(r"Mass of the body: 0\.02 kg in the source, [\d.]+ kg is estimated", said)
    assert "±0.6 rad is assumed" in said
    assert "Top speed: not in the source, 11.2 m/s is assumed" in said
    assert "estimated" not in " ".join(assumptions(repaired(car())))


def test_rear_wheels_below_the_cage_of_a_differential_are_still_two_wheels():
    model = car()
    cage = Link("cage", Inertial(3.0, RigidTransform(), np.eye(3) * 0.01), where="car.urdf:80")
    add(model, cage, axle("cage_joint", "chassis", "cage", -WHEELBASE / 2, 0.0, 0.0))
    for letter, sign in (("a", 1), ("b", -1)):
        model.joints[f"j2{letter}"] = axle(f"j2{letter}", "cage", f"w2{letter}", 0.0, sign * TRACK / 2, 0.0)
    wheels, _ = roles_of(model)
    assert wheels == EXPECTED
    result = repaired(model)
    assert result.body.mass.mass == pytest.approx(BODY + 3.0)
    assert reports(result, "joint 'cage_joint'", "fixed at zero")


# --- rejected vehicles ----------------------------------------------------------------------------------------------


def arm():
    model = add(SourceModel("arm"), Link("foot"))
    for number in range(4):
        shape = Shape("cylinder", (0.05, 0.4), at(0, 0, 0.2))
        add(model, Link(f"part{number}", collisions=[shape]))
        below = "foot" if number == 0 else f"part{number - 1}"
        add(
            model,
            Joint(f"turn{number}", "continuous", below, f"part{number}", at(0, 0, 0.4), axis=X if number % 2 else Z),
        )
    return model


def drone():
    model = add(SourceModel("drone"), body_link())
    for number, (x, y) in enumerate(((1, 1), (1, -1), (-1, 1), (-1, -1))):
        add(model, Link(f"rotor{number}", collisions=[Shape("cylinder", (0.3, 0.02))]))
        add(model, Joint(f"spin{number}", "continuous", "chassis", f"rotor{number}", at(x, y, 0.5), axis=Z))
    return model


def two_driven(casters):
    model = add(SourceModel("robot"), body_link())
    for letter, y in (("l", 0.3), ("r", -0.3)):
        add(model, wheel_link(letter, 0.1, 0.04), axle(f"drive_{letter}", "chassis", letter, 0, y, -0.2))
    if casters == "ball":
        add(model, Link("ball", collisions=[Shape("sphere", (0.05,))]))
        add(model, Joint("mount", "fixed", "chassis", "ball", at(-0.4, 0, -0.25)))
    else:
        for letter, y in (("l", 0.25), ("r", -0.25)):
            add(model, Link(f"fork_{letter}"), wheel_link(f"small_{letter}", 0.08, 0.03))
            swivel = Joint(f"swivel_{letter}", "continuous", "chassis", f"fork_{letter}", at(-0.5, y, -0.1), axis=Z)
            add(model, swivel, axle(f"roll_{letter}", f"fork_{letter}", f"small_{letter}", -0.05, 0, -0.12))
    return model


def without(model, *names):
    for name in names:
        joint = model.joints.pop(name)
        del model.links[joint.child]
    return model


def skid_steer():
    model = car()
    for letter in "ab":
        model.joints[f"k{letter}"].kind = "fixed"
    return model


def six_wheels():
    model = car()
    for letter, sign in (("a", 1), ("b", -1)):
        add(model, wheel_link(f"w3{letter}"), axle(f"j3{letter}", "chassis", f"w3{letter}", 0.0, sign * TRACK / 2, 0.0))
    return model


def whole_axle():
    model = car()
    add(model, Link("beam"), kingpin("fifth_wheel", "chassis", "beam", WHEELBASE / 2, 0.0, 0.0))
    for letter, sign in (("a", 1), ("b", -1)):
        without(model, f"k{letter}")
        model.joints[f"j1{letter}"] = axle(f"j1{letter}", "beam", f"w1{letter}", 0.0, sign * TRACK / 2, 0.0)
    return model


def rigid_axle():
    model = car()
    model.joints.pop("j2b")
    position = at(0.0, -TRACK, 0.0)
    add(model, Joint("weld", "fixed", "w2a", "w2b", position))
    return model


def half_steered():
    model = car()
    model.joints["kb"].kind = "fixed"
    return model


REJECTED = {
    "an arm": (arm, "no road wheels: 5 links with 4 continuous joints"),
    "a drone": (drone, "no road wheels"),
    "differential drive": (lambda: two_driven("ball"), "2 driven wheels and 1 caster .*'drive_l', 'drive_r'"),
    "differential drive on swivels": (lambda: two_driven("swivel"), "2 driven wheels and 2 casters"),
    "differential drive on a skid": (lambda: without(two_driven("ball"), "mount"), "2 driven wheels on one axle"),
    "a tricycle": (lambda: without(car(), "j2b"), "tricycle: 3 wheels .* on 2 axles"),
    "a bicycle": (lambda: without(car(), "j2b", "j1a"), "bicycle"),
    "a lorry": (six_wheels, "6 wheels .* on 3 axles"),
    "skid-steer": (skid_steer, "skid-steer: four wheels .*no steering joint"),
    "an axle steered as a whole": (whole_axle, "'fifth_wheel' steers an axle as a whole"),
    "a rigid axle": (rigid_axle, "'j2a' turns the wheels of both sides"),
    "one steered wheel": (half_steered, "only one of which is steered"),
    "an empty file": (lambda: SourceModel("nothing"), "no links"),
}


@pytest.mark.parametrize(("build", "message"), REJECTED.values(), ids=REJECTED)
def test_other_vehicles_are_rejected_with_their_kind(build, message):
    with pytest.raises(ModelError, match=message) as caught:
        recognise(build())
    assert "\n" not in str(caught.value)


def test_wheels_with_missing_meshes_are_named():
    model = car()
    model.links["w2b"].collisions = [Shape("mesh", address="meshes/wheel.stl")]
    with pytest.raises(ModelError, match=r"3 wheels .*; 'j2b' turns like a wheel .* meshes/wheel\.stl"):
        recognise(model)


# --- what is driven ----------------------------------------------------------------------------------------------


def unusable(change):
    """Return the car whose left steering joint is not usable, with the reason."""

    def build():
        model = car()
        for letter in "ab":
            model.joints[f"k{letter}"].name = f"steer_{letter}"
        model.joints = {joint.name: joint for joint in model.joints.values()}
        for name in ("steer_a", "steer_b"):
            change(model.joints[name])
        return model

    return build


def incline(joint):
    joint.axis = np.array([1.0, 0.0, 1.0])


UNUSABLE = {
    "fixed": (lambda joint: setattr(joint, "kind", "fixed"), "'steer_a' is fixed, 'steer_b' is fixed"),
    "prismatic": (lambda joint: setattr(joint, "kind", "prismatic"), "'steer_a' is prismatic"),
    "inclined": (incline, r"'steer_a' has an axis 45 degrees off the vertical \(at most 37\)"),
    "level": (lambda joint: setattr(joint, "axis", X), "'steer_a' has an axis 90 degrees off the vertical"),
}


def limited_wheels(model):
    """Give all wheels limits and names of a steering."""
    for joint in [joint for joint in model.joints.values() if joint.child.startswith("w")]:
        joint.kind, joint.name, joint.limits = "revolute", f"steer_{joint.child}", Limits(-0.7, 0.7)
    model.joints = {joint.name: joint for joint in model.joints.values()}
    return model


def test_wheels_with_limits_are_no_steering_whatever_their_name():
    with pytest.raises(
        ModelError, match=r"cannot be used as wheels: 'steer_w..' turns from -0\.7 to 0\.7 rad only"
    ) as caught:
        recognise(limited_wheels(car()))
    assert "off the vertical" not in str(caught.value)


def test_steered_wheels_without_a_joint_to_turn_on_are_named():
    model = car()
    for letter in "ab":
        model.joints[f"j1{letter}"].kind = "fixed"
    with pytest.raises(ModelError, match=r"'ka' carries 'w1a', which is round but has no joint to turn on") as caught:
        recognise(model)
    assert "differential" not in str(caught.value)
    assert "caster" not in str(caught.value)


@pytest.mark.parametrize(("change", "reason"), UNUSABLE.values(), ids=UNUSABLE)
def test_steering_joints_that_cannot_be_used_are_named_with_the_reason(change, reason):
    with pytest.raises(ModelError, match=f"no usable steering joint; cannot be used as steering: .*{reason}") as caught:
        recognise(unusable(change)())
    assert "\n" not in str(caught.value)


def test_steering_joints_without_wheels_and_fixed_wheels_are_named():
    model = skid_steer()
    add(model, Link("column"), kingpin("steering_wheel_joint", "chassis", "column", 0.0, 0.0, 0.5))
    with pytest.raises(ModelError, match="'steering_wheel_joint' carries no wheel"):
        recognise(model)
    model = car()
    model.joints["j2b"].kind, model.joints["j2b"].name = "fixed", "rear_wheel_b"
    with pytest.raises(ModelError, match=r"tricycle: .*cannot be used as wheels: 'rear_wheel_b' is fixed"):
        recognise(model)


def test_transmissions_decide_the_driven_axle_unless_the_user_does():
    model = car()
    model.transmissions = [Transmission(name, ("velocity",), where="car.urdf:9") for name in ("j1a", "j1b")]
    model.transmissions += [Transmission(name, ("position",)) for name in ("ka", "kb")]
    assert recognise(model).drive == "front"
    assert recognise(model, "all").drive == "all"


def test_controllers_decide_the_driven_axle_if_all_wheels_have_transmissions():
    model = car()
    model.transmissions = [Transmission(name, ("effort",)) for name in EXPECTED.values()]
    assert recognise(model).drive == "all"
    kind = "effort_controllers/JointVelocityController"
    model.controllers = [Controller(name, kind, (name,), where="gains.yaml") for name in ("j2a", "j2b")]
    assert recognise(model).drive == "rear"


def test_a_plugin_drives_the_axle_that_it_names():
    model = car()
    model.plugins = [
        Plugin("drive", "libackermann_drive.so", {"left_joint": "j1a", "right_joint": "j1b", "steer": "ka"})
    ]
    assert recognise(model).drive == "front"


def test_transmissions_without_interface_count_if_they_are_not_on_all_wheels():
    model = car()
    model.transmissions = [Transmission(name) for name in ("j1a", "j1b", "ka", "kb")]
    assert recognise(model).drive == "front"
    model.transmissions = [Transmission(name) for name in (*EXPECTED.values(), "ka", "kb")]
    assert recognise(model).drive_source == ""


def test_a_plugin_of_four_driven_wheels_drives_both_axles():
    model = car()
    names = {f"wheel_{index}_joint": joint for index, joint in enumerate(EXPECTED.values())}
    model.plugins.append(Plugin("gz::sim::systems::FourwidsDrive", "gz-sim-fourwids-drive-system", names))
    assert recognise(model).drive == "all"


@pytest.mark.parametrize(("front", "back", "drive"), [("800", "0", "front"), ("0", "300.5", "rear"), ("4", "4", "all")])
def test_torques_of_a_plugin_decide_the_driven_axle(front, back, drive):
    model = car()
    values = {"front_left_wheel": "j1a", "front_torque": front, "back_torque": back, "back_brake_torque": "7"}
    values |= {"front_steer_torque": "6", "feedback_torque": "5"}
    model.plugins.append(Plugin("hybrid_drive", "libhybrid.so", values, "car.urdf:90"))
    _, roles = roles_of(model)
    assert (roles.drive, roles.drive_source) == (drive, "imported: torques of the plugin, car.urdf:90")


def test_rear_wheels_are_driven_if_the_source_states_nothing():
    _, roles = roles_of(car())
    assert roles.drive == "rear"
    assert any(change.part == "driven axle" for change in roles.changes)


# --- straightening -----------------------------------------------------------------------------------------------


def test_the_base_frame_is_on_the_road_below_the_rear_axle():
    layout = repaired(car()).layout
    assert layout.X_MB.translation() == pytest.approx([-WHEELBASE / 2, 0.0, -RADIUS])
    assert layout.kingpin_track == pytest.approx(TRACK - 2 * KINGPIN)
    assert (layout.tracks, layout.radii, layout.widths) == ((TRACK, TRACK), (RADIUS, RADIUS), (WIDTH, WIDTH))


def test_reversed_axes_and_their_limits_are_corrected():
    model = car()
    model.joints["j1a"].axis = -Y
    model.joints["ka"].axis = -Z
    model.joints["ka"].limits = Limits(-0.6, 0.5, 1000.0, 0.5)  # about -z: 0.6 to the left, the inner wheel
    model.joints["kb"].limits = Limits(-0.6, 0.5, 1000.0, 0.5)  # 0.6 to the right, the inner wheel
    result = repaired(model)
    assert reports(result, "joint 'j1a': sense of the axis", "to the left")
    assert reports(result, "joint 'ka': sense of the axis", "upwards")
    assert result.numbers["steering_limit"].value == 0.6
    assert result.steering_joints == ("ka", "kb")


def test_inclined_steering_axes_and_camber_are_removed_and_reported_in_degrees():
    model = car()
    for letter, sign in (("a", 1), ("b", -1)):
        inclination = np.radians(10.0)
        model.joints[f"k{letter}"].axis = np.array([0.0, -sign * sin(inclination), cos(inclination)])
        camber = np.radians(2.0)
        model.joints[f"j2{letter}"].axis = np.array([0.0, cos(camber), sign * sin(camber)])
    result = repaired(model)
    assert reports(result, "joint 'ka': axis", "10 degrees off the vertical", "vertical")
    assert reports(result, "joint 'j2a': axis", "2 degrees of camber")
    # the axis meets the road further out, by the radius times the tangent of the inclination
    assert result.layout.kingpin_track == pytest.approx(
        TRACK - 2 * KINGPIN + 2 * RADIUS * tan(np.radians(10)), abs=1e-3
    )


def test_a_wheel_that_is_6_mm_off_is_mirrored_and_one_that_is_12_cm_off_is_rejected():
    model = car()
    model.joints["j2a"].X_PJ = at(-WHEELBASE / 2 + 0.006, TRACK / 2, 0.0)
    result = repaired(model)
    assert reports(result, "joint 'j2a': place", "mirrored")
    model.joints["j2a"].X_PJ = at(-WHEELBASE / 2 + 0.12, TRACK / 2, 0.0)
    with pytest.raises(ModelError, match=r"'j2a' is 0\.06 0 0 m from the mirrored"):
        repaired(model)


def test_wheels_of_an_axle_that_differ_by_a_percent_get_the_mean_radius():
    model = car()
    model.links["w2a"] = wheel_link("w2a", RADIUS * 1.01)
    result = repaired(model)
    assert result.layout.radii == (RADIUS, pytest.approx(RADIUS * 1.005))
    model.links["w2a"] = wheel_link("w2a", RADIUS * 1.2)
    with pytest.raises(ModelError, match="radii of the rear wheels"):
        repaired(model)


def test_larger_rear_wheels_touch_the_same_road():
    model = car()
    for letter, sign in (("a", 1), ("b", -1)):
        model.links[f"w2{letter}"] = wheel_link(f"w2{letter}", 0.36)
        model.joints[f"j2{letter}"].X_PJ = at(-WHEELBASE / 2, sign * TRACK / 2, 0.06)
    layout = repaired(model).layout
    assert layout.radii == (RADIUS, 0.36)
    assert layout.X_MB.rotation().IsNearlyIdentity(1e-9)


def test_a_source_that_is_not_level_is_rotated():
    model = car()
    for letter, sign in (("a", 1), ("b", -1)):  # front wheels 26 mm higher: asin(0.026 / 2.6) = 0.01 rad
        model.joints[f"k{letter}"].X_PJ = at(WHEELBASE / 2, sign * (TRACK / 2 - KINGPIN), 0.026)
    result = repaired(model)
    assert reports(result, "level", "0.573 degrees of pitch")
    assert result.layout.wheelbase == pytest.approx(np.hypot(WHEELBASE, 0.026))


def test_a_ball_for_a_wheel_becomes_a_cylinder_and_an_off_centre_shape_is_centred():
    model = car()
    for name in ("w2a", "w2b"):
        model.links[name].collisions = [Shape("sphere", (RADIUS,))]
    model.links["w1a"].collisions[0].X_LG = RigidTransform(LIE, [0.0, 0.0, 0.01])
    result = repaired(model)
    assert result.layout.widths[1] == pytest.approx(0.4 * 2 * RADIUS)
    assert reports(result, "joint 'j2a'", "sphere of radius 0.3 m", "0.24 m wide")
    assert reports(result, "joint 'j1a'", "0.01 m from the joint's axis", "centred")


def test_a_wheel_without_round_collision_shape_is_measured_on_its_visual():
    model = car()
    for name in ("w2a", "w2b"):
        link = model.links[name]
        link.visuals, link.collisions = link.collisions, []
    result = repaired(model)
    assert result.layout.radii[1] == RADIUS
    assert reports(result, "joint 'j2a': collision shape", "none that is round")


def test_a_root_link_that_lies_on_its_side_in_the_model_is_turned_up():
    # in SDF the root link may have a pose; here its z axis looks ahead and its x axis up
    model = car()
    on_side = RollPitchYaw(0.0, -pi / 2, 0.0)
    model.links["chassis"].X_ML = RigidTransform(on_side, np.array([0.0, 0.0, 1.0]))
    turn = RigidTransform(on_side, np.zeros(3)).inverse()
    for joint in model.joints.values():
        if joint.parent == "chassis":
            joint.X_PJ = turn @ joint.X_PJ
    wheels, _ = roles_of(model)
    assert wheels == EXPECTED
    assert repaired(model).layout.X_MB.translation() == pytest.approx([-WHEELBASE / 2, 0.0, 1.0 - RADIUS])


def test_different_radii_of_visual_and_collision_shape_are_reported():
    model = car()
    shape = model.links["w2a"].collisions[0]
    model.links["w2a"].visuals = [Shape("cylinder", (0.356, WIDTH), shape.X_LG)]
    result = repaired(model)
    assert result.layout.radii[1] == RADIUS
    assert reports(result, "joint 'j2a': radius", "looks like 0.356 m", "please check")


# --- masses ------------------------------------------------------------------------------------------------------


def test_plausible_masses_are_kept():
    result = repaired(car())
    assert result.total_mass() == pytest.approx(BODY + 4 * WHEEL + 2 * HUB)
    com = result.centre_of_mass(result.layout)
    # body midway 0.2 m above the axles, two hubs in front: (1400 x 1.3 + 60 x 2.6) / 1500 and 0.3 + 0.2 x 1400 / 1500
    assert com == pytest.approx([1.3173, 0.0, 0.4867], abs=1e-4)
    assert np.diag(result.wheels["rear_left"].mass.inertia) == pytest.approx(np.diag(wheel_tensor()))
    assert not [line for line in lines(result) if "mass" in line.split("|")[0] or "inertia" in line.split("|")[0]]


BOX = box_tensor(BODY, 4.0, 1.1, 0.6)
IMPOSSIBLE = {
    "triangle inequality": np.diag([63.0, 1048.0, 1600.0]),
    "above zero": np.diag([100.0, -1.0, 100.0]),
    "not a number": np.full((3, 3), np.nan),
    "m from its centre, in a link of": 1e6 * np.diag([1.0, 1.5, 2.0]),
    "would be within": np.diag([1e-3, 1e-3, 1e-3]),
    "placeholder": np.eye(3) * 100.0,
}


@pytest.mark.parametrize(("why", "inertia"), IMPOSSIBLE.items(), ids=IMPOSSIBLE)
def test_an_impossible_inertia_becomes_that_of_the_bounding_box(why, inertia):
    model = car()
    model.links["chassis"].inertial.inertia = inertia
    result = repaired(model)
    assert reports(result, "link 'chassis': inertia", why)
    assert result.body.mass.inertia == pytest.approx(BOX)


@pytest.mark.parametrize("order", [(1, 0, 2), (2, 1, 0), (1, 2, 0), (2, 0, 1)])
def test_moments_of_exchanged_axes_go_to_the_axes_that_the_shapes_have(order):
    # 4.0 x 1.5 x 1.2 m: mass spread as in the box has 1.15 m along x, more than the shapes' reach of 0.75 and 0.6 m
    model = car()
    own = box_tensor(BODY, 4.0, 1.5, 1.2)
    model.links["chassis"].inertial.inertia = own[np.ix_(order, order)]
    result = repaired(model)
    assert reports(result, "link 'chassis': inertia along x, y, z", "outside of the link's shapes")
    moments = np.diag(result.body.mass.inertia)
    assert moments[0] < min(moments[1:])  # least about the long axis
    assert sorted(moments) == pytest.approx(sorted(np.diag(own)))


@pytest.mark.parametrize("scale", [0.3, 1.0, 2.0])
def test_moments_that_fit_the_shapes_or_no_order_of_axes_are_kept(scale):
    model = car()
    own = scale * box_tensor(BODY, 4.0, 1.5, 1.2)
    model.links["chassis"].inertial.inertia = own
    result = repaired(model)
    assert not reports(result, "link 'chassis': inertia along x, y, z", "")
    assert result.body.mass.inertia == pytest.approx(own)


def test_the_parts_of_a_body_add_up_about_their_common_centre():
    model = car()
    add(
        model, Link("battery", Inertial(600.0, RigidTransform(), box_tensor(600.0, 1.0, 1.0, 0.2)), where="car.urdf:80")
    )
    add(model, Joint("mount", "fixed", "chassis", "battery", at(0.5, 0.0, -0.1)))
    mass = repaired(model).body.mass
    # centre: 1400 at (0, 0.2), 600 at (0.5, -0.1) in x, z; reduced mass 1400 x 600 / 2000 = 420
    assert mass.mass == 2000.0
    assert mass.com == pytest.approx([WHEELBASE / 2 + 0.15, 0.0, RADIUS + 0.11])
    own = box_tensor(BODY, 4.0, 1.5, 1.2) + box_tensor(600.0, 1.0, 1.0, 0.2)
    assert np.diag(mass.inertia) == pytest.approx(np.diag(own) + 420 * np.array([0.09, 0.34, 0.25]))
    assert mass.inertia[0, 2] == pytest.approx(420 * 0.5 * 0.3)


def test_spin_inertia_in_the_wrong_slot_goes_to_the_wheel_axis():
    model = car()
    spin, across = WHEEL * RADIUS**2 / 2, 0.5
    for name in ("w2a", "w2b"):
        model.links[name].inertial.inertia = np.diag([across, across, spin])
    result = repaired(model)
    assert np.diag(result.wheels["rear_left"].mass.inertia) == pytest.approx([across, spin, across])
    assert reports(result, "rear wheels: inertia", "z axis")


def test_wheels_with_40_times_the_inertia_become_solid_cylinders():
    model = car()
    for name in ("w2a", "w2b"):
        model.links[name].inertial.inertia = 40 * wheel_tensor()
    result = repaired(model)
    assert result.wheels["rear_left"].mass.inertia == pytest.approx(wheel_tensor())


def test_moving_links_without_mass_get_an_estimate():
    model = car()
    for name, link in model.links.items():
        if name != "chassis":
            link.inertial = None
    result = repaired(model)
    # 283 kg per m³ of wheel cylinder, at most 2.5 % of the body: pi x 0.09 x 0.2 x 283 = 16.0
    assert result.wheels["front_left"].mass.mass == pytest.approx(16.0, abs=0.01)
    assert result.knuckles[0].mass.mass == pytest.approx(8.0, abs=0.01)
    model.links["chassis"].inertial = None
    assert repaired(model).body.mass.mass == pytest.approx(140 * 4.0 * 1.1 * 0.6)


def test_a_wheel_of_impossible_mass_gets_that_of_the_other_one():
    model = car()
    model.links["w2b"].inertial.mass = 1e6
    result = repaired(model)
    assert reports(result, "link 'w2b': mass", "1e+06 kg", "treated as missing")
    assert [result.wheels[name].mass.mass for name in ("rear_left", "rear_right")] == [WHEEL, WHEEL]


def test_a_centre_of_mass_far_outside_of_its_link_is_moved_into_it():
    model = car()
    model.links["hub_a"].inertial.X_LI = at(0.0, 40.0, 0.0)
    result = repaired(model)
    assert reports(result, "link 'hub_a': centre of mass", "40 m from there")
    assert result.knuckles[0].mass.com == pytest.approx(np.zeros(3))


@pytest.mark.parametrize(("position", "what"), [((0.0, 0.0, -0.8), "below the road"), ((0, 0, 3), "above the car")])
def test_a_centre_of_mass_outside_of_the_car_is_moved_to_a_third_of_its_height(position, what):
    model = car()
    model.links["chassis"].inertial.X_LI = at(*position)
    result = repaired(model)
    com = result.centre_of_mass(result.layout)
    assert com[2] == pytest.approx(0.35 * 0.9)  # the box ends 0.6 m above the axles
    assert reports(result, "centre of mass of the car: height", what)


def test_a_centre_of_mass_ahead_of_the_front_axle_is_moved_between_the_axles():
    model = car()
    model.links["chassis"].inertial.X_LI = at(1.5, 0.0, 0.2)
    result = repaired(model)
    com = result.centre_of_mass(result.layout)
    assert com[0] == pytest.approx(WHEELBASE / 2)


NONSENSE = (0.0, -1.0, float("nan"), float("inf"), 1e16, -1e16, 1e-12, 1e6, 3.0, -0.3)


def corrupt(model, chance):
    """Damage one element of a model."""
    link = model.links[chance.choice(list(model.links))]
    joint = model.joints[chance.choice(list(model.joints))]
    value = chance.choice(NONSENSE)
    spot = int(chance.integers(3))
    choice = int(chance.integers(7))
    if choice == 0:
        link.inertial.mass = value
    elif choice == 1:
        link.inertial.inertia = link.inertial.inertia.copy()
        link.inertial.inertia[spot, int(chance.integers(3))] = value
    elif choice == 2:
        link.inertial.X_LI = at(*np.roll([5.0, -3.0, 1e4], spot))
    elif choice == 3 and link.collisions:
        link.collisions[0].size = (value, *link.collisions[0].size[1:])
    elif choice == 4:
        joint.limits = Limits(*chance.choice(NONSENSE, size=4))
    elif choice == 5:
        joint.kind = str(chance.choice(["revolute", "fixed", "floating", "universal", "revolute2", "ball", "gearbox"]))
    else:
        joint.axis = np.roll([value, 0.0, 1.0], spot)


def test_200_damaged_cars_are_repaired_or_rejected_in_one_line():
    cars = 0
    for seed in range(200):
        chance = np.random.default_rng(seed)
        model = car()
        for _ in range(2):
            corrupt(model, chance)
        rejection: ModelError | None = None
        try:
            result = repaired(model)
        except ModelError as error:
            rejection = error
        if rejection is not None:
            assert "\n" not in str(rejection)
            continue
        cars += 1
        for part in result:
            low, middle, high = np.linalg.eigvalsh(part.mass.inertia)
            assert part.mass.mass > 0.0
            assert low > 0.0
            assert low + middle > high
            assert np.isfinite(part.mass.com).all()
        assert all(np.isfinite(number.value) and number.value > 0.0 for number in result.numbers.values())
    assert cars > 60


# --- limits and contact ------------------------------------------------------------------------------------------


def test_steering_without_usable_limits_gets_those_of_the_other_side_or_of_the_bolt():
    model = car()
    model.joints["kb"].kind = "continuous"
    model.joints["ka"].limits = Limits(-0.7, 0.7, 1000.0, 0.5)
    assert repaired(model).numbers["steering_limit"].value == 0.7
    model.joints["ka"].kind = "continuous"  # now both: the numbers are better than none
    assert repaired(model).numbers["steering_limit"].value == 0.6
    assert reports(repaired(model), "joint 'ka': limits", "±0.7 rad")
    for name in ("ka", "kb"):
        model.joints[name].kind, model.joints[name].limits = "revolute", Limits(0.0, 0.0, 0.0, 0.0)
    result = repaired(model)
    assert result.numbers["steering_limit"].value == 0.6
    assert reports(result, "joint 'ka': limits", "0 … 0 rad")


def test_ranges_of_ros2_control_replace_estimates():
    """Commands are limited by the interface, so its range acts like the limit of a plugin."""
    text = """<ros2_control name="s" type="system">
      <joint name="ka"><command_interface name="position"><param name="min">-0.41</param><param name="max">0.43</param>
      </command_interface><state_interface name="position"/></joint>
      <joint name="kb"><command_interface name="position"><param name="min">0</param></command_interface></joint>
      <joint name="j2a"><command_interface name="velocity"><param name="max">40</param></command_interface>
        <command_interface name="effort"><param name="min">-300</param><param name="max">300</param></command_interface>
      </joint>
      <joint name="j1a"><command_interface name="velocity"><param name="max">5</param></command_interface></joint>
      <joint name="no"><command_interface name="velocity"><param name="max">many</param></command_interface></joint>
    </ros2_control>"""
    model = car()
    read_ros2_control(ElementTree.fromstring(text), model, lambda _: "car.urdf:90")
    assert [entry.ranges for entry in model.transmissions] == [
        {"position": 0.41}, {}, {"velocity": 40.0, "effort": 300.0}, {"velocity": 5.0}, {}
    ]  # fmt: skip
    numbers = repaired(model, "rear").numbers
    assert numbers["steering_limit"].value == 0.41
    assert numbers["steering_limit"].source.endswith("car.urdf:90")
    assert numbers["wheel_speed_limit"].value == pytest.approx(40.0)  # not that of the front wheel, which rolls
    assert numbers["max_torque"].value == pytest.approx(600.0)


def test_the_steering_limit_of_a_plugin_counts_where_the_joints_have_none():
    model = car()
    for name in ("ka", "kb"):
        model.joints[name].kind, model.joints[name].limits = "continuous", Limits()
    model.plugins.append(Plugin("drive", "libdrive.so", {"max_steer": "0.45", "max_speed": "9"}, "car.urdf:80"))
    result = repaired(model)
    assert result.numbers["steering_limit"].value == 0.45
    assert result.numbers["steering_limit"].source == "imported: plugin, car.urdf:80"
    assert reports(result, "plugin 'drive'", "max_steer 0.45, max_speed 9")


@pytest.mark.parametrize("nonsense", [0.0, -1.0, float("nan"), float("inf"), 1e9])
def test_limits_that_mean_no_limit_are_estimated(nonsense):
    model = car()
    for joint in model.joints.values():
        joint.limits = Limits(joint.limits.lower, joint.limits.upper, nonsense, nonsense)
    numbers = repaired(model).numbers
    # 1500 kg: half the weight as thrust at the wheels; 0.8 wheel loads at a radius; 0.16 m/s over the radius
    assert numbers["max_torque"].value == pytest.approx(0.5 * 1500 * 9.80665 * RADIUS)
    assert numbers["steering_effort"].value == pytest.approx(0.8 * 1500 * 9.80665 / 4 * RADIUS)
    assert numbers["steering_rate"].value == pytest.approx(0.16 / RADIUS)
    assert all(number.source.startswith("estimated: ") for name, number in numbers.items() if name != "steering_limit")


def test_plausible_limits_of_the_source_are_kept_with_their_place():
    model = car()
    for name in ("j2a", "j2b"):
        model.joints[name].limits = Limits(effort=900.0, velocity=90.0)
    numbers = repaired(model).numbers
    assert numbers["max_torque"].value == 1800.0
    assert numbers["wheel_speed_limit"].value == 90.0
    assert numbers["wheel_speed_limit"].source == "imported: car.urdf:60"
    assert numbers["steering_rate"].value == 0.5


def test_an_impossible_torque_of_one_axle_does_not_count():
    """The other axle states a possible one; equal wheels have it, as with limits of joints."""
    model = car()
    values = {"front_torque": "1e6", "back_torque": "300"}
    model.plugins.append(Plugin("drive", "libdrive.so", values, "car.urdf:80"))
    assert repaired(model, "all").numbers["max_torque"].value == pytest.approx(4 * 300.0)
    model.plugins[-1].values["front_torque"] = "200"
    assert repaired(model, "all").numbers["max_torque"].value == pytest.approx(2 * (200.0 + 300.0))


PRIUS = {
    "front_torque": "859.4", "back_torque": "0", "front_brake_torque": "1031.28", "back_brake_torque": "687.52",
    "max_speed": "38.0", "max_steer": "0.55", "min_gas_flow": "9e-05", "flwheel_steering_p_gain": "1e4",
}  # fmt: skip


def test_figures_of_a_drive_plugin_replace_estimates_and_wider_joint_limits():
    model = car()
    for name in ("j1a", "j1b", "j2a", "j2b"):
        model.joints[name].limits = Limits(effort=1e7, velocity=1e6)
    model.plugins.append(Plugin("drive", "libPriusHybridPlugin.so", PRIUS, "car.urdf:80"))
    numbers = repaired(model, drive=None).numbers
    assert recognise(model).drive == "front"
    assert {key: numbers[key].value for key in ("steering_limit", "max_torque", "brake_torque")} == pytest.approx(
        {"steering_limit": 0.55, "max_torque": 2 * 859.4, "brake_torque": 2 * (1031.28 + 687.52)}
    )
    assert numbers["brake_front_share"].value == pytest.approx(0.6)
    assert numbers["wheel_speed_limit"].value == pytest.approx(38.0 / RADIUS)
    assert all(
        numbers[key].source.startswith("imported: plugin, car.urdf:80") for key in ("max_torque", "brake_torque")
    )


@pytest.mark.parametrize(
    ("values", "key", "value"),
    [
        ({"max_steer": "0.5", "max_steering_angle": "7.5", "max_speed": "20"}, "steering_limit", 0.5),  # of ROS 2
        ({"max_steer": "0.5", "max_steering_angle": "7.5", "max_speed": "20"}, "steering_ratio", 15.0),
        ({"steering_limit": "0.4", "max_velocity": "12", "min_velocity": "-3"}, "steering_limit", 0.4),  # of gz-sim
        ({"steering_limit": "0.4", "max_velocity": "12", "min_velocity": "-3"}, "wheel_speed_limit", 12 / RADIUS),
        ({"maxSteeringAngle": "0.3"}, "steering_limit", 0.3),
        ({"steeringAngleLimitDeg": "20"}, "steering_limit", np.radians(20)),
        ({"max_steer": "0.9"}, "steering_limit", 0.6),  # wider than the joints
        ({"wheelTorque": "350"}, "max_torque", 700.0),  # of diff_drive, of one wheel
        ({"max_steering_rate": "0.4"}, "steering_rate", 0.4),
        ({"front_brake_torque": "900", "back_brake_torque": "0"}, "brake_front_share", 1.0),
        ({"front_brake_torque": "1e300", "back_brake_torque": "1"}, "brake_torque", 1.5 * 1500 * 9.80665 * RADIUS),
        ({"max_brake_torque": "900"}, "brake_torque", 3600.0),  # of one wheel
        ({"max_brake_torque": "5000"}, "brake_torque", 5000.0),  # of all wheels
    ],
)
def test_figures_of_common_plugins_are_understood(values, key, value):
    model = car()
    model.plugins.append(Plugin("drive", "libdrive.so", values, "car.urdf:80"))
    assert repaired(model).numbers[key].value == pytest.approx(value)


@pytest.mark.parametrize("factor", [0.02, 0.5, 6.0, 30.0])
def test_an_unusual_limit_is_kept_with_a_warning_and_only_an_impossible_one_replaced(factor):
    share = 0.25 * 1500 * 9.80665 * RADIUS
    model = car()
    for name in ("j2a", "j2b"):
        model.joints[name].limits = Limits(effort=factor * share)
    result = repaired(model)
    assert result.numbers["max_torque"].value == pytest.approx(2 * factor * share)
    assert reports(result, "torque of a driven wheel", "please check") == (factor != 0.5)


@pytest.mark.parametrize(("mu", "became"), [(10000.0, 0.9), (0.0, 0.9), (0.6, 0.6), (1.75, 1.75)])
def test_friction_of_a_tyre_is_kept_and_that_of_a_solver_is_not(mu, became):
    model = car()
    for name in ("w2a", "w2b"):
        model.links[name].surface = Surface(mu, mu, 1e7, 1.0, where="car.urdf:90")
    result = repaired(model)
    assert result.numbers["rear_friction"].value == became
    assert reports(result, "friction of the rear tyres") == (mu != became)
    assert reports(result, "contact stiffness of the tyres", "kp 1e+07 N/m")


# --- end to end --------------------------------------------------------------------------------------------------


def urdf(scale=1.0, mass=1500.0, extra="", body="", name="buggy"):
    """Return a car in URDF whose root lies between the axles on the road."""
    length, side, radius, width = 2.6 * scale, 0.75 * scale, 0.3 * scale, 0.2 * scale
    wheel = 0.013 * mass
    hub = wheel / 2
    main = mass - 4 * wheel - 2 * hub

    def inertial(weight, moments, position="0 0 0"):
        ixx, iyy, izz = np.diag(moments)
        tensor = f'ixx="{ixx:.9g}" iyy="{iyy:.9g}" izz="{izz:.9g}" ixy="0" ixz="0" iyz="0"'
        return f'<inertial><origin xyz="{position}"/><mass value="{weight:.9g}"/><inertia {tensor}/></inertial>'

    box = f'<geometry><box size="{4 * scale:g} {1.1 * scale:g} {0.6 * scale:g}"/></geometry>'
    tyre = f'<origin rpy="1.5707963 0 0"/><geometry><cylinder radius="{radius:g}" length="{width:g}"/></geometry>'
    out = [f'<robot name="{name}">', '<link name="base_link"/>']
    out.append('<link name="chassis">' + inertial(main, box_tensor(main, 4 * scale, 1.5 * scale, 1.2 * scale)))
    out.append(body or f"<visual>{box}</visual><collision>{box}</collision>")
    out.append(f'</link><joint name="weld" type="fixed"><parent link="base_link"/><child link="chassis"/>'
               f'<origin xyz="0 0 {0.55 * scale:g}"/></joint>')  # fmt: skip

    def turn(kind, joint, parent, child, position, axis, limit):
        out.append(
            f'<joint name="{joint}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
            f'<origin xyz="{" ".join(f"{value:g}" for value in position)}"/>'
            f'<axis xyz="{axis}"/><limit {limit}/></joint>'
        )

    low = radius - 0.55 * scale
    for letter, sign in (("l", 1), ("r", -1)):
        out.append(f'<link name="hub_{letter}">{inertial(hub, box_tensor(hub, radius, radius, radius))}</link>')
        position = (length / 2, sign * 0.7 * scale, low)
        limit = 'lower="-0.6" upper="0.6" effort="1000" velocity="1"'
        turn("revolute", f"steer_{letter}", "chassis", f"hub_{letter}", position, "0 0 1", limit)
        for end, parent, position in (
            ("f", f"hub_{letter}", (0, sign * 0.05 * scale, 0)),
            ("r", "chassis", (-length / 2, sign * side, low)),
        ):
            link = f"wheel_{end}{letter}"
            tensor = wheel_tensor(wheel, radius, width)
            shapes = f"<visual>{tyre}</visual><collision>{tyre}</collision>"
            out.append(f'<link name="{link}">{inertial(wheel, tensor)}{shapes}</link>')
            turn("continuous", f"axle_{end}{letter}", parent, link, position, "0 1 0", 'effort="-1" velocity="0"')
    return "\n".join([*out, extra, "</robot>"])


def write(folder, **options):
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "car.urdf").write_text(urdf(**options))
    return folder / "car.urdf"


SIZES = {"full size": ({}, 5.0), "1:10": ({"scale": 1 / 6, "mass": 3.5}, 2.0)}  # wheel radius 0.3 and 0.05 m


@pytest.fixture
def same_process(monkeypatch):
    """Check in this process instead of a child process: these folders are known to load."""
    monkeypatch.setattr("mirdrake.importing.vehicles.check_loads", lambda folder: None)


@pytest.fixture(scope="module", params=SIZES)
def driven(request, tmp_path_factory):
    options, speed = SIZES[request.param]
    root = tmp_path_factory.mktemp("import")
    return import_vehicle(write(root / "source", **options), folder=root / "models"), speed


def drive(result, rows, duration):
    spec = {
        "world": "empty",
        "vehicles": {"ego": {"model": str(result.folder)}},
        "control": {"ego": {"kind": "schedule", "rows": rows}},
    }
    return Simulation(assemble(spec)).run(duration=duration).signals


@pytest.mark.essential
def test_an_imported_car_rests_drives_ten_metres_straight_and_circles(driven):
    result, speed = driven
    stop = 5.0 + (10.0 - speed) / speed  # at rest for 3 s, faster for 2 s, then on to 10 m
    rows = [
        {"time": 0, "speed": 0}, {"time": 3, "speed": 0}, {"time": 5, "speed": speed},
        {"time": stop, "speed": speed}, {"time": stop + 1, "speed": speed, "steering": 0.2},
    ]  # fmt: skip
    signals = drive(result, rows, stop + 4)
    rest = signals.loc[2.9:3.0]
    assert np.abs(rest[["ego.vx", "ego.vy", "ego.vz"]].to_numpy()).max() < 1e-3
    line = signals.loc[:stop].iloc[-1]
    assert line["ego.x"] == pytest.approx(10.0, abs=0.1)
    assert abs(line["ego.y"]) < 0.01
    steady = signals.loc[stop + 2.5 :]
    ideal = steady["ego.vx"].mean() * tan(0.2) / result.vehicle.geometry.wheelbase
    assert steady["ego.wz"].mean() == pytest.approx(ideal, rel=0.01)
    assert steady["ego.vx"].mean() == pytest.approx(speed, rel=0.01)


def test_the_folder_is_that_of_any_vehicle(driven):
    result, _ = driven
    names = {path.name for path in result.folder.iterdir()}
    assert names == {
        "README.md", "contact.xacro", "control.yaml", "main.urdf.xacro", "properties.xacro", "sensors.xacro",
        "sensors.yaml", "structure.xacro", "vehicle.yaml",
    }  # fmt: skip
    vehicle = result.vehicle
    assert vehicle.warnings == ()
    assert vehicle.spec.numbers_without_source() == []
    assert vehicle.spec.sources_without_number() == []
    assert vehicle.spec.grade == "C"
    assert vehicle.spec.licence == "unknown: see README"
    assert 'name="chassis"' in vehicle.urdf
    for drive_axle in ("front", "all"):
        assert load_vehicle(str(result.folder), arguments={"drive": drive_axle}).spec.drive == drive_axle


def test_the_readme_lists_every_change_by_file_and_line(driven):
    result, _ = driven
    readme = (result.folder / "README.md").read_text()
    assert "### car.urdf" in readme
    for change in result.changes:
        assert f"| {change.part} | {change.old} | {change.new_text} |" in readme
    assert str(result.folder.parent.parent) not in readme


def test_dimensions_are_those_of_the_source(driven):
    geometry, scale = driven[0].vehicle.geometry, driven[0].vehicle.geometry.wheelbase / 2.6
    assert scale == pytest.approx(1.0 if driven[1] == 5.0 else 1 / 6, rel=1e-5)
    assert (geometry.front_track, geometry.rear_track) == pytest.approx((1.5 * scale, 1.5 * scale), rel=1e-5)
    assert geometry.kingpin_track == pytest.approx(1.4 * scale, rel=1e-5)
    assert geometry.front_wheel_radius == pytest.approx(0.3 * scale, rel=1e-5)
    assert geometry.front_wheel_width == pytest.approx(0.2 * scale, rel=1e-5)
    assert (geometry.steering_limit, geometry.steering_rate) == (0.6, 1.0)


def test_collision_shapes_of_the_body_are_raised_above_the_road_and_a_missing_one_becomes_a_box(tmp_path, same_process):
    box = '<geometry><box size="4 1.1 1.2"/></geometry>'  # from 5 cm below the road on
    result = import_vehicle(write(tmp_path / "a", body=f"<collision>{box}</collision>"), folder=tmp_path / "a")
    assert reports(result, "collision shape", "from -0.05 to 1.15 m", "from 0.052 m on")  # 0.02 of the wheelbase
    result = import_vehicle(write(tmp_path / "b", body=f"<visual>{box}</visual>"), folder=tmp_path / "b")
    assert reports(result, "collision shape", "none", "from 0.135 m on")  # the estimated clearance, 0.45 radii
    assert abs(drive(result, [{"time": 0, "speed": 0}], 3.0)["ego.vz"].iloc[-1]) < 1e-3


# --- a body that would not be seen -------------------------------------------------------------------------------


def shape_text(kind, geometry, position="0 0 0", colour=""):
    return f'<{kind}><origin xyz="{position}"/><geometry>{geometry}</geometry>{colour}</{kind}>'


def box_text(*size):
    return f'<box size="{" ".join(f"{value:g}" for value in size)}"/>'


FULL = shape_text("collision", box_text(4, 1.1, 0.6))
SMALL = shape_text("collision", box_text(0.3, 0.2, 0.1))
LIDAR = shape_text("visual", '<cylinder radius="0.1" length="0.1"/>', "1 0 0.5")
PLATE = shape_text("visual", box_text(1.0, 0.5, 0.02), "-1 0 0.4")
GLASS = '<material name="glass"><color rgba="1 1 1 0"/></material>'
UNSEEN = {
    "nothing": "",
    "no package": shape_text("visual", '<mesh filename="package://gone/body.dae"/>'),
    "no file": shape_text("visual", '<mesh filename="body.obj"/>'),
    "lidar": LIDAR,
    "plate": PLATE,
    "lidar and plate": LIDAR + PLATE,
    "broken mesh and lidar": shape_text("visual", '<mesh filename="car.urdf"/>') + LIDAR,
    "invisible": shape_text("visual", box_text(4, 1.1, 0.6), colour=GLASS),
    "scenery": shape_text("visual", box_text(100, 100, 0.1)),
}


@pytest.mark.parametrize("unseen", UNSEEN)
@pytest.mark.parametrize("solid", ["", FULL, SMALL])
def test_a_body_without_visuals_is_drawn_by_its_collision_shapes_or_a_box(tmp_path, same_process, unseen, solid):
    source = write(tmp_path / "source", body=UNSEEN[unseen] + solid + " ")
    result = import_vehicle(source, folder=tmp_path)
    (warning,) = result.warnings
    assert "no visual shape that can be used" in warning
    assert ("its collision shapes are drawn" in warning) == (solid == FULL)
    assert reports(result, "collision shape", "box") == (solid != FULL)
    if solid == SMALL:
        assert reports(result, "collision shape", "1 shapes that cover 2 % of wheelbase x track")
    readme = (result.folder / "README.md").read_text()
    assert readme.partition("1. ")[2].startswith(warning)
    boxes = outline_boxes(result)
    assert any(x > 2.6 and y > 0.9 and 0.3 < z < 2.5 for x, y, z in boxes["visual"])
    assert any(x > 2.6 and y > 0.9 and 0.3 < z < 2.5 for x, y, z in boxes["collision"])


def outline_boxes(result):
    """Return sizes of the boxes of the body in the written URDF."""
    root = ElementTree.fromstring(result.vehicle.urdf)
    link = next(link for link in root.iter("link") if link.get("name") == "base_link")
    return {
        kind: [
            tuple(map(float, str(box.get("size")).split())) for shape in link.iter(kind) for box in shape.iter("box")
        ]
        for kind in ("visual", "collision")
    }


def frame_of_tubes():
    """Return a space frame: 1.2 m wide, ten tubes that meet, which cover a tenth of its plan."""
    lengthwise = [shape_text("visual", box_text(3.0, 0.05, 0.05), f"0 {y} 0") for y in (-0.6, 0.6)]
    across = [shape_text("visual", box_text(0.05, 1.2, 0.05), f"{x} 0 0") for x in np.linspace(-1.5, 1.5, 8)]
    return "".join(lengthwise + across)


@pytest.mark.parametrize("observed", [shape_text("visual", box_text(3, 0.8, 0.5)), frame_of_tubes()])
def test_a_visible_body_or_frame_is_unchanged(tmp_path, same_process, observed):
    result = import_vehicle(write(tmp_path / "source", body=observed + SMALL), folder=tmp_path)
    assert result.warnings == ()
    assert not reports(result, "link 'base_link': visuals")


@pytest.mark.parametrize(("code", "words"), [(0, ""), (2, "a portrait needs EGL"), (-11, ""), (None, "")])
def test_the_terminal_reports_a_missing_body_first_and_a_missing_picture(
    tmp_path, same_process, capsys, monkeypatch, code, words
):
    monkeypatch.setattr("mirdrake.importing.vehicles.check.run_module", lambda *given, **options: (code, words))
    source = write(tmp_path / "source", body=UNSEEN["no file"])
    assert main(["import", "vehicle", str(source), "--out", str(tmp_path)]) == 0
    printed = capsys.readouterr()
    assert printed.out.startswith("warning: The body has no visual shape that can be used")
    # Outside of the search path the folder is named by its path, which the next command takes.
    following = re.search(r"next: mirdrake view (\S+); mirdrake inspect \1", printed.out)
    assert following is not None
    assert (Path(following[1]) / "vehicle.yaml").is_file()
    reason = {0: "", 2: words, -11: "the renderer crashed", None: "not drawn within 120 s"}[code]
    assert printed.err == (f"note: README.md has no picture of the vehicle: {reason}\n" if reason else "")


SENSORS = """
<gazebo reference="chassis">
 <sensor type="camera" name="eye"><pose>1 0 0.4 0 0 0</pose><update_rate>30</update_rate>
  <camera><horizontal_fov>1.396</horizontal_fov><image><width>800</width><height>600</height></image>
   <clip><near>0.02</near><far>300</far></clip><noise><stddev>0.007</stddev></noise></camera></sensor>
 <sensor type="ray" name="flat"><update_rate>50</update_rate><ray><scan><horizontal><samples>180</samples>
  <min_angle>-1.57</min_angle><max_angle>1.57</max_angle></horizontal></scan><range><min>1.5</min><max>80</max></range>
  </ray></sensor>
 <sensor type="gpu_ray" name="round"><update_rate>5</update_rate><ray><scan><horizontal><samples>100</samples>
  <min_angle>-0.4</min_angle><max_angle>0.4</max_angle></horizontal><vertical><samples>20</samples>
  <min_angle>-0.0349</min_angle><max_angle>0.326</max_angle></vertical></scan><range><min>1</min><max>50</max></range>
  </ray></sensor>
 <sensor type="imu" name="imu"/>
 <sensor type="contact" name="bumper"><update_rate>30</update_rate></sensor>
</gazebo>"""


def test_gazebo_sensors_become_mounts_and_the_rest_is_reported(tmp_path, same_process):
    result = import_vehicle(write(tmp_path / "source", extra=SENSORS), folder=tmp_path)
    mounts: Any = result.vehicle.sensors.mounts
    assert {name: mount.kind for name, mount in mounts.items()} == {
        "eye": "camera", "flat": "laser_scanner", "round": "lidar", "imu": "imu",
    }  # fmt: skip
    assert (mounts["eye"].width, mounts["eye"].near, mounts["eye"].noise) == (800, 0.02, 0.007)
    assert (mounts["flat"].beams, mounts["flat"].far) == (180, 80.0)
    assert (mounts["round"].rows, mounts["round"].vertical_end) == (20, 0.326)
    assert reports(result, "sensor 'bumper'", "contact", "left out")
    assert reports(result, "sensor 'imu': rate", "100 Hz")
    # camera at 1 m ahead of the middle, 0.4 above the chassis, which is 0.55 m above the road
    assert 'name="eye_mount_joint"' in result.vehicle.urdf
    assert 'xyz="2.3 0 0.95"' in result.vehicle.urdf


def test_pid_gains_of_the_source_become_a_variant(tmp_path, same_process):
    source = write(tmp_path / "source" / "urdf")
    (tmp_path / "source" / "package.xml").write_text(
        "<package><name>buggy_description</name><license>MIT</license></package>"
    )
    (tmp_path / "source" / "config").mkdir()
    gains = "\n".join(
        f"{joint}_controller: {{type: effort_controllers/{kind}, joint: {joint}, pid: {{p: 100.0, i: 0.01, d: 10.0}}}}"
        for joint, kind in (("axle_rl", "JointVelocityController"), ("axle_rr", "JointVelocityController"),
                            ("steer_l", "JointPositionController"), ("steer_r", "JointPositionController"))
    )  # fmt: skip
    (tmp_path / "source" / "config" / "control.yaml").write_text(gains)
    result = import_vehicle(source, folder=tmp_path)
    control: Any = load_vehicle(f"{result.folder}@imported").control
    assert (control.wheel_speed.kind, control.wheel_speed.kp) == ("pid", 100.0)
    assert (control.steering.ki, control.steering.kd) == (0.01, 10.0)
    assert result.vehicle.control.steering.kind == "servo"
    assert result.vehicle.spec.licence == "MIT"
    assert result.vehicle.spec.drive == "rear"


def test_an_existing_vehicle_is_only_replaced_by_force(tmp_path, same_process):
    source = write(tmp_path / "source")
    first = import_vehicle(source, name="mine", folder=tmp_path)
    (first.folder / "note").write_text("old")
    with pytest.raises(ConfigError, match="exists already"):
        import_vehicle(source, name="mine", folder=tmp_path)
    import_vehicle(source, name="mine", folder=tmp_path, force=True, progress=lambda text: None)
    assert not (first.folder / "note").exists()
    assert {path.name for path in tmp_path.iterdir()} == {"mine", "source"}


def test_nothing_is_written_when_an_import_fails(tmp_path):
    source = write(tmp_path / "source", name="two words")
    (tmp_path / "source" / "car.urdf").write_text(urdf().replace("continuous", "fixed"))
    with pytest.raises(ModelError, match="no road wheels"):
        import_vehicle(source, folder=tmp_path / "models")
    assert {path.name for path in tmp_path.iterdir()} == {"source"}
    with pytest.raises(ConfigError, match="drive 'left'"):
        import_vehicle(source, folder=tmp_path, drive="left")  # type: ignore[arg-type]


def test_a_folder_that_does_not_load_is_an_error_of_one_line_and_is_removed(tmp_path, monkeypatch):
    monkeypatch.setattr("mirdrake.importing.vehicles.write._geometry", lambda shape: '<box size="0 0 0"/>')
    with pytest.raises(ModelError, match="does not load: ") as caught:
        import_vehicle(write(tmp_path / "source"), folder=tmp_path / "models")
    assert "\n" not in str(caught.value)
    assert {path.name for path in tmp_path.iterdir()} == {"source"}


def test_a_crash_while_loading_becomes_an_error_of_one_line(tmp_path, monkeypatch):
    crashing = tmp_path / "python"
    crashing.write_text("#!/bin/sh\necho 'Segmentation fault' >&2\nexit 139\n")
    crashing.chmod(0o755)
    monkeypatch.setattr("sys.executable", str(crashing))
    with pytest.raises(ModelError, match=r"crashes Drake \(exit 139\): Segmentation fault") as caught:
        import_vehicle(write(tmp_path / "source"), folder=tmp_path / "models")
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "models").exists()


def test_an_imported_vehicle_imported_again_is_the_same_car(driven, tmp_path, same_process):
    first = driven[0]
    again = import_vehicle(first.folder / "main.urdf.xacro", name="again", folder=tmp_path, drive="rear")
    was, now = first.vehicle.geometry, again.vehicle.geometry
    for name in ("wheelbase", "front_track", "rear_track", "kingpin_track", "front_wheel_radius", "steering_limit"):
        assert getattr(now, name) == pytest.approx(getattr(was, name), rel=1e-5), name
    texts = [(result.folder / "properties.xacro").read_text() for result in (first, again)]
    masses = [[line for line in text.splitlines() if "mass" in line or "_i" in line] for text in texts]
    assert masses[0] == masses[1]


# --- before anything is written ----------------------------------------------------------------------------------


def test_a_dry_run_reports_changes_and_rejections_and_writes_nothing(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("mirdrake.importing.vehicles.write_car", lambda *_, **__: pytest.fail("meshes are converted"))
    write(tmp_path / "source", extra=SENSORS)
    assert main(["import", "vehicle", "source/car.urdf", "--dry-run"]) == 0
    out = capsys.readouterr().out
    assert "would be written" in out
    assert "car.urdf:31: sensor 'bumper': type contact -> left out (mirdrake has no such sensor)" in out
    (tmp_path / "models" / "buggy").mkdir(parents=True)
    for options in ([], ["--name", "buggy"]):  # a folder of that name is reported, and does not hide the changes
        assert main(["import", "vehicle", "source/car.urdf", "--dry-run", *options]) == 0
        out = capsys.readouterr().out
        assert "warning: models/buggy exists already; choose another name, or use --force" in out
        assert "sensor 'bumper'" in out
        assert main(["import", "vehicle", "source/car.urdf", *options]) == 2
        assert "models/buggy exists already" in capsys.readouterr().err
    (tmp_path / "models" / "buggy").rmdir()
    (tmp_path / "models").rmdir()
    (tmp_path / "source" / "car.urdf").write_text(urdf().replace("continuous", "fixed"))
    assert main(["import", "vehicle", "source/car.urdf", "--dry-run"]) == 2
    assert "no road wheels" in capsys.readouterr().err
    assert {path.name for path in tmp_path.iterdir()} == {"source"}


def test_left_out_sensors_are_in_the_terminal_and_in_the_readme(tmp_path, capsys, same_process):
    source = write(tmp_path / "source", extra=SENSORS.replace("<min>1.5</min>", "<min>80</min>"))
    assert main(["import", "vehicle", str(source), "--out", str(tmp_path)]) == 0
    assert "sensor 'flat': type ray -> left out (near (80 m) must be below far (80 m))" in capsys.readouterr().out
    assert "sensor 'flat' | type ray | left out" in (tmp_path / "buggy" / "README.md").read_text()


# --- springs -----------------------------------------------------------------------------------------------------

K, C = 30_000.0, 2500.0


def sprung(dialect: str, kind: str = "prismatic"):
    """Return the car with a joint between the body and each wheel, whose spring is written in one of the dialects."""
    model = car()
    for name in ("ka", "kb", "j2a", "j2b"):
        joint = model.joints[name]
        slide = Joint(f"s_{name}", kind, "chassis", f"c_{name}", joint.X_PJ, axis=Z, where="car.urdf:75")
        slide.limits = Limits(-0.08, 0.12)
        if kind == "revolute":  # an arm that trails by half a metre
            slide.X_PJ, slide.axis = joint.X_PJ @ at(0.5, 0.0, 0.0), Y
            joint.X_PJ = at(-0.5, 0.0, 0.0)
        else:
            joint.X_PJ = RigidTransform()
        joint.parent = slide.child
        add(model, Link(slide.child, Inertial(5.0, RigidTransform(), np.diag([0.05, 0.05, 0.05]))), slide)
        if dialect == "joint":
            slide.stiffness, slide.damping = K, C
        elif dialect == "damper only":
            slide.damping = C
        elif dialect == "controller":
            kinds = "effort_controllers/JointPositionController"
            model.controllers.append(Controller("c", kinds, (slide.name,), {slide.name: {"p": K, "d": C}}))
        elif dialect == "plugin":
            values = {"joint_name": slide.name, "spring_stiffness": str(K), "damping": str(C)}
            model.plugins.append(Plugin("shock", "libspring.so", values))
    return model


@pytest.mark.parametrize("dialect", ["joint", "controller", "plugin"])
def test_springs_of_the_source_become_the_suspension(dialect):
    result = repaired(sprung(dialect))
    springs = result.springs
    assert springs is not None
    for end in ("front", "rear"):
        values = [springs.numbers[f"{end}_{key}"].value for key in ("stiffness", "damping", "anti_roll")]
        assert values == pytest.approx([K, C, 0.0])
    assert (springs.rebound, springs.bump) == pytest.approx((-0.08, 0.12))
    assert set(result.spring_joints.values()) == {"s_ka", "s_kb", "s_j2a", "s_j2b"}
    assert result.total_mass() == pytest.approx(BODY + 4 * WHEEL + 2 * HUB + 20.0)
    assert not reports(result, "s_ka", "fixed at zero")


@pytest.mark.parametrize("dialect", ["none", "damper only"])
def test_a_stiffness_that_the_source_lacks_is_estimated_by_the_ride_frequency(dialect):
    result = repaired(sprung(dialect))
    assert result.springs is not None
    numbers = result.springs.numbers
    assert numbers["front_stiffness"].value == pytest.approx(result.estimates.front_stiffness)
    assert reports(result, "suspension: front springs", "none", "ride frequency 1.25 Hz")
    assert (numbers["rear_damping"].value == C) == (dialect == "damper only")


def test_a_swing_arm_with_a_spring_becomes_a_vertical_spring_of_the_same_rate_at_the_wheel():
    result = repaired(sprung("joint", kind="revolute"))
    assert result.springs is not None
    assert result.springs.numbers["rear_stiffness"].value == pytest.approx(K / 0.5**2)
    assert (result.springs.rebound, result.springs.bump) == pytest.approx((-0.04, 0.06))


@pytest.mark.parametrize("stiffness", [0.0, -5.0, float("inf"), float("nan")])
def test_an_impossible_stiffness_is_estimated(stiffness):
    model = sprung("joint")
    for joint in model.joints.values():
        if joint.kind == "prismatic":
            joint.stiffness = stiffness
    result = repaired(model)
    assert result.springs is not None
    assert result.springs.numbers["front_stiffness"].source.startswith("estimated: ride frequency")


def test_springs_that_carry_nothing_or_not_all_wheels_are_left_out_with_the_reason():
    model = sprung("joint")
    model.links["chassis"].inertial = Inertial(BODY, at(1.5, 0.0, 0.2), box_tensor(BODY, 4.0, 1.5, 1.2))
    for name in ("c_j2a", "c_j2b"):
        model.links[name].inertial = Inertial(500.0, RigidTransform(), np.diag([50.0, 50.0, 50.0]))
    result = repaired(model)
    assert result.springs is None
    assert reports(result, "suspension", "left out", "heavier than its wheel load")
    model = sprung("joint")
    for name in ("s_ka", "s_j2b"):
        model.joints[name].kind = "fixed"
    result = repaired(model)
    assert result.springs is None
    assert reports(result, "suspension", "2 of 4 wheels on springs", "front left, rear right")
    assert reports(result, "joint 's_kb'", "fixed at zero", "mirdrake needs springs at both wheels of an axle")


@pytest.mark.parametrize(
    ("fixed", "sprung_end", "rigid_end"), [("ka kb", "rear", "front"), ("j2a j2b", "front", "rear")]
)
@pytest.mark.parametrize("kind", ["prismatic", "revolute"])
def test_springs_of_one_axle_stay_and_the_other_axle_is_almost_rigid(fixed, sprung_end, rigid_end, kind):
    model = sprung("joint", kind)
    for name in fixed.split():
        model.joints[f"s_{name}"].kind = "fixed"
    result = repaired(model)
    assert result.springs is not None
    rate = K if kind == "prismatic" else K / 0.5**2
    values = {key: number.value for key, number in result.springs.numbers.items()}
    assert values[f"{sprung_end}_stiffness"] == pytest.approx(rate)
    assert values[f"{rigid_end}_stiffness"] == pytest.approx(5.0 * result.estimates.tyre_stiffness)
    assert values[f"{rigid_end}_anti_roll"] == 0.0
    assert reports(result, f"suspension: {rigid_end} springs", "none", "please check", "no springs at this axle")
    assert result.total_mass() == pytest.approx(BODY + 4 * WHEEL + 2 * HUB + 20.0)
    assert set(result.spring_joints) == set(result.wheels)


HUBS = (("steer_l", "hub_l"), ("steer_r", "hub_r"), ("axle_rl", "wheel_rl"), ("axle_rr", "wheel_rr"))


@pytest.mark.parametrize("hubs", [HUBS, HUBS[:2], HUBS[2:]], ids=["all", "front", "rear"])
def test_a_car_with_springs_rests_on_them(tmp_path, same_process, hubs):
    slide = (
        '<link name="c_{0}"/><joint name="s_{0}" type="prismatic"><parent link="chassis"/><child link="c_{0}"/>'
        '<axis xyz="0 0 -1"/><limit lower="-0.1" upper="0.1" effort="0" velocity="1"/></joint>'
    )
    text = urdf(extra="".join(slide.format(name) for _, name in hubs))
    for joint, child in hubs:
        head, _, tail = text.partition(f'<joint name="{joint}"')
        text = head + f'<joint name="{joint}"' + tail.replace('"chassis"', f'"c_{child}"', 1)
    (tmp_path / "source").mkdir()
    (tmp_path / "source" / "car.urdf").write_text(text)
    result = import_vehicle(tmp_path / "source" / "car.urdf", folder=tmp_path)
    springs = result.vehicle.spec.suspension
    assert springs is not None
    assert springs.front.stiffness > 1e4
    run = drive(result, [{"time": 0, "speed": 2.0}], 4.0)
    assert run["ego.vx"].iloc[-1] == pytest.approx(2.0, abs=0.05)
    assert abs(run["ego.vz"].iloc[-1]) < 5e-3


def test_a_travel_without_the_zero_position_has_the_length_that_all_springs_allow():
    """From 0.02 to 0.10 m and from 0.05 to 0.12 m: both allow 0.05 to 0.10 m, half of it to each side of zero."""
    ranges = ((0.02, 0.10), (0.05, 0.12))
    springs = [
        WheelSpring(Joint("s", "prismatic", "a", "b", axis=Z, limits=Limits(low, high), where="car.urdf:60"))
        for low, high in ranges
    ]
    changes = Changes()
    estimates: Any = SimpleNamespace(suspension_travel=0.1)
    assert _travel(springs, estimates, changes) == pytest.approx((-0.025, 0.025))
    (change,) = changes
    assert (change.old, change.new) == ("0.05 … 0.1 m", "±0.025 m")
