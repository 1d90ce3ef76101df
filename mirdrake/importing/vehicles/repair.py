"""From a recognised model to a car that mirdrake can drive; each correction is a Change."""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from pydrake.math import RigidTransform

from mirdrake.importing.changes import Change, Changes, Code
from mirdrake.importing.meshes.convert import with_known_submesh
from mirdrake.importing.shape import Shape
from mirdrake.importing.vehicles.body_cover import COVERED, LARGEST, body_boxes, plan_cover, usual_bounds
from mirdrake.importing.vehicles.car import Car, Frame, Layout, Part, Parts
from mirdrake.importing.vehicles.joints import imported_gains, report_joints
from mirdrake.importing.vehicles.kinematics import Tree, source_name
from mirdrake.importing.vehicles.limits import collect_numbers, steering_limit
from mirdrake.importing.vehicles.masses import check_balance, gather_masses
from mirdrake.importing.vehicles.model import SourceModel
from mirdrake.importing.vehicles.names import Names
from mirdrake.importing.vehicles.recognise import Roles
from mirdrake.importing.vehicles.round_shapes import Bounds, join_bounds
from mirdrake.importing.vehicles.sensors import make_mounts
from mirdrake.importing.vehicles.springs import WheelSpring, find_springs, make_springs
from mirdrake.importing.vehicles.straighten import SIDES, straighten
from mirdrake.vehicles.estimates import Estimates, estimate
from mirdrake.vehicles.spec import WHEELS

BASE = "base_link"


def repair(model: SourceModel, roles: Roles, *, name: str, springs: bool = True) -> Car:
    """Make a car of a recognised model.

    Args:
        model: model as read.
        roles: roles from :func:`mirdrake.importing.vehicles.recognise.recognise`.
        name: name of the vehicle folder.
        springs: whether springs of the source become a suspension.

    Raises:
        ModelError: left and right differ too much.
    """
    # Dimensions and parts.
    changes = Changes([*model.changes, *roles.changes])
    layout, more = straighten(roles)
    changes += more
    names = Names()
    sprung, more = find_springs(roles) if springs else ({}, [])
    changes += more
    parts = _make_parts(roles, layout, names, sprung, changes)
    # Masses, which need the size of the body, and balance, which needs all masses.
    bounds = _body_bounds(parts.body, layout, changes)
    changes += gather_masses(roles.tree, layout, parts, bounds)
    where = model.links[roles.tree.root].where or source_name(model)
    changes += check_balance(parts, layout, bounds, where)
    # Limits and estimates; the steering limit is an input of the estimates.
    limit, more = steering_limit(roles)
    changes += more
    mass, com_x = parts.total_mass(), float(parts.centre_of_mass(layout)[0])
    # Tyres are estimated per axle, because front and rear wheels may differ in radius and width.
    whole, front, rear = (_estimates(roles, layout, bounds, mass, com_x, limit.value, end) for end in (None, 0, 1))
    numbers, more = collect_numbers(roles, limit, whole, (front, rear))
    changes += more
    # Springs that would carry nothing are fixed instead, which changes the parts: start again without springs.
    suspension = None
    if sprung:
        suspension, more = make_springs(sprung, parts, layout=layout, estimates=whole)
        if suspension is None:
            car = repair(model, roles, name=name, springs=False)
            return replace(car, changes=Changes([*car.changes, *more]))
        changes += more
    # Names, frames and sensors last, since sensors refer to frames of all parts.
    wheel_joints, steering_joints = _name_joints(roles, names)
    spring_joints = {
        key: names.joint(item.joint.name) if item.joint is not None else names.new_joint(f"{key}_spring")
        for key, item in sprung.items()
    }
    changes += report_joints(roles, sprung=[item.joint for item in sprung.values() if item.joint is not None])
    changes += _report_collisions(roles, (*parts.knuckles, *parts.carriers.values()), layout)
    frames, places = _make_frames(roles, parts, names)
    mounts, mount_frames, more = make_mounts(model, places, names)
    changes += more
    return Car(
        **vars(parts),
        name=name,
        title=" ".join(model.name.replace("_", " ").split()) or name,
        base=parts.body.name,
        layout=layout,
        wheel_joints=wheel_joints,
        steering_joints=steering_joints,
        spring_joints=spring_joints,
        springs=suspension,
        drive=roles.drive,
        drive_source=roles.drive_source,
        numbers=numbers,
        estimates=whole,
        bounds=bounds,
        frames=frames,
        mount_frames=mount_frames,
        mounts=mounts,
        variant=imported_gains(model, roles, changes),
        licence="; ".join(model.texts[key] for key in ("licence", "licence file") if model.texts.get(key)),
        changes=changes,
        warnings=[
            f"{change.part}: {change.old} does not exist, so the whole mesh is used."
            for change in changes
            if change.code is Code.SUBMESH
        ],
    )


def _estimates(
    roles: Roles, layout: Layout, bounds: Bounds, mass: float, com_x: float, limit: float, end: int | None
) -> Estimates:
    """Return estimates for the car with the tyres of the front (0) or rear axle (1), else their mean."""
    radius, width = (float(np.mean(values)) if end is None else values[end] for values in (layout.radii, layout.widths))
    edges = bounds[1] - bounds[0]
    return estimate(
        mass=mass,
        wheelbase=layout.wheelbase,
        track=sum(layout.tracks) / 2.0,
        wheel_radius=radius,
        wheel_width=width,
        # The box may be that of a bare frame; the car is at least as large as its wheels and axles.
        height=max(float(bounds[1][2]), 2.0 * radius),
        length=max(float(edges[0]), layout.wheelbase),
        width=max(float(edges[1]), min(layout.tracks)),
        drive=roles.drive,
        steering_limit=limit,
        front_axle_share=float(np.clip(com_x / layout.wheelbase, 0.1, 0.9)),
    )


# --- parts -------------------------------------------------------------------------------------------------------


def _make_parts(
    roles: Roles, layout: Layout, names: Names, sprung: Mapping[str, WheelSpring], changes: Changes
) -> Parts:
    """Return body, knuckles, wheels and, with springs, carriers, with their shapes."""
    tree = roles.tree
    # Free joints separate the parts of the car; links behind any other joint become rigid with their part.
    free = {wheel.joint.name for wheel in roles.wheels.values()} | {joint.name for joint in roles.steering}
    # A spring below the steering joint is inside of the knuckle and separates nothing.
    free |= {item.joint.name for item in sprung.values() if item.joint is not None and not item.steered}
    root = tree.model.links[tree.root]
    if tree.root == BASE or BASE not in tree.poses:
        base = names.link(BASE)
    else:
        base = names.link(tree.root)
        why = f"another link is called '{BASE}'"
        changes.add(Code.FRAME, root.where, "name of the base link", tree.root, f"{base} stays", why)
    body = Part(base, tree.rigid_with(tree.root, free), layout.X_MB)
    if not layout.X_MB.IsNearlyEqualTo(RigidTransform(), 1e-6):
        # Components below a micrometre are rounding of the matrix products.
        x, y, z = np.where(np.abs(layout.X_MB.translation()) < 1e-6, 0.0, layout.X_MB.translation())
        was = f"link '{tree.root}', {_shown(-x, -y, -z)} m from the new place along its axes"
        became = f"link '{base}', on the road below the centre of the rear axle, x ahead"
        changes.add(Code.FRAME, root.where, "base frame", was, became, "convention of mirdrake")
    # A joint that steers and spins has no link between both motions: the knuckle is new.
    knuckles = []
    for side, joint in zip(SIDES, roles.steering, strict=True):
        wheel = roles.wheels[f"front_{side}"]
        if joint is wheel.joint:  # steers and spins in one
            knuckles.append(Part(names.new(f"{wheel.joint.child}_knuckle"), [], layout.parts[f"{side}_knuckle"]))
        else:
            links = tree.rigid_with(joint.child, free)
            knuckles.append(Part(names.link(joint.child), links, layout.parts[f"{side}_knuckle"]))
    wheels = {}
    for key in WHEELS:
        child = roles.wheels[key].joint.child
        wheels[key] = Part(names.link(child), tree.rigid_with(child, free), layout.parts[key])
    carriers = {}
    for key, item in sprung.items():
        child = "" if item.steered or item.joint is None else item.joint.child
        carried = tree.rigid_with(child, free) if child else []
        name = names.link(child) if child else names.new(f"{key}_carrier")
        carriers[key] = Part(name, carried, layout.X_MB)
    parts = Parts(body=body, knuckles=(knuckles[0], knuckles[1]), wheels=wheels, carriers=carriers)
    for part in parts:
        _take_shapes(tree, part)
    body.visuals = _with_known_submeshes(body.visuals, changes)
    body.collisions = _with_known_submeshes(body.collisions, changes)
    return parts


def _take_shapes(tree: Tree, part: Part) -> None:
    # Shapes go from their link L to the part P: X_PL = X_PM X_ML.
    X_PM = part.X_MP.inverse()
    for name in part.links:
        link, X_PL = tree.model.links[name], X_PM.multiply(tree.poses[name])
        part.visuals += [replace(shape, X_LG=X_PL.multiply(shape.X_LG)) for shape in link.visuals]
        part.collisions += [replace(shape, X_LG=X_PL.multiply(shape.X_LG)) for shape in link.collisions]


def _with_known_submeshes(shapes: Iterable[Shape], changes: Changes) -> list[Shape]:
    """Return the shapes of the body with whole meshes instead of unknown submeshes, each mesh once."""
    shapes_left: list[Shape] = []
    for shape in shapes:
        known, more = with_known_submesh(shape)
        changes += more
        # Several unknown submeshes of one mesh all become the whole mesh, which is drawn once.
        if not more or not any(
            other.mesh == known.mesh
            and not other.submesh
            and other.scale == known.scale
            and other.X_LG.IsNearlyEqualTo(known.X_LG, 1e-9)
            for other in shapes_left
        ):
            shapes_left.append(known)
    return shapes_left


def _body_bounds(body: Part, layout: Layout, changes: Changes) -> Bounds:
    """Return the bounding box of the body: of its visuals, else of its collision shapes, else an estimate."""
    limits = np.array(LARGEST) * layout.wheelbase
    for shapes in (body.visuals, body.collisions):
        boxes = body_boxes(shapes, layout)
        bounds = join_bounds(boxes)
        # Only bounds of the size of a car count that cover enough of its plan view; flags, masts and sensors do not.
        good = bounds is not None and (bounds[1] - bounds[0] <= limits).all() and bounds[1][2] > 0.0
        if bounds is not None and good and plan_cover(boxes, layout) >= COVERED:
            return bounds
    lower, upper = usual_bounds(layout)
    # The height counts from the road, as that of a car does, not from the ground clearance.
    length, width, height = (float(edge) for edge in upper - [lower[0], lower[1], 0.0])
    became = f"{length:.3g} x {width:.3g} x {height:.3g} m, estimated from wheelbase, track and wheels"
    where = body.visuals[0].where if body.visuals else ""
    why = "needed for mass and aerodynamics"
    changes.add(Code.SHAPE, where, "size of the body", "no shapes of the size of the car", became, why)
    return lower, upper


def _name_joints(roles: Roles, names: Names) -> tuple[dict[str, str], tuple[str, str]]:
    """Return the names of wheel and steering joints."""
    steering = [names.joint(joint.name) for joint in roles.steering]
    wheels = {}
    for key, wheel in roles.wheels.items():
        # A joint that steers and spins keeps its name for the steering; its spin becomes a new joint.
        both = any(wheel.joint is joint for joint in roles.steering)
        wheels[key] = names.new_joint(f"{wheel.joint.name}_spin") if both else names.joint(wheel.joint.name)
    return wheels, (steering[0], steering[1])


def _make_frames(roles: Roles, parts: Parts, names: Names) -> tuple[list[Frame], dict[str, tuple[str, RigidTransform]]]:
    """Return links that became part of another one as frames, and the new place of every link."""
    tree, frames = roles.tree, []
    places: dict[str, tuple[str, RigidTransform]] = {}
    for part in parts:
        X_PM = part.X_MP.inverse()
        for name in part.links:
            X_PL = X_PM.multiply(tree.poses[name])
            places[name] = (part.name, X_PL)
            # The link that names a part is the part itself; all others stay available as frames.
            main = part is not parts.body and name == part.links[0]
            if main or (name == tree.root and parts.body.name == names.link(name)):
                continue
            joint = tree.above[name].name if name in tree.above else f"{name}_frame"
            frames.append(Frame(names.link(name), names.joint(joint), part.name, X_PL))
    return frames, places


def _report_collisions(roles: Roles, knuckles: Iterable[Part], layout: Layout) -> list[Change]:
    """Return the changes of the collision shapes of wheels and knuckles, which are replaced."""
    changes = Changes()
    links = roles.tree.model.links
    for key, wheel in roles.wheels.items():
        rear = key.startswith("rear")
        shapes = [shape for name in roles.tree.rigid_with(wheel.joint.child, ()) for shape in links[name].collisions]
        # A single cylinder stays what it is, and a single sphere has its own change in `straighten`.
        plain = len(shapes) == 1 and shapes[0].kind == "cylinder"
        if shapes and not plain and not (wheel.shape.width_from and len(shapes) == 1):
            was = ", ".join(_shape_text(shape) for shape in shapes[:4]) + (", …" if len(shapes) > 4 else "")
            became = f"cylinder of radius {layout.radii[rear]:.4g} m, {layout.widths[rear]:.4g} m wide"
            changed_part = f"link '{wheel.joint.child}': collision shapes"
            changes.add(
                Code.SHAPE,
                shapes[0].where,
                changed_part,
                was,
                became,
                "the collision geometry of a wheel is a cylinder",
            )
    for part in knuckles:
        for shape in part.collisions:
            changed_part = f"link '{part.name}': collision shape"
            why = "parts between wheel and body have no collision geometry"
            changes.add(Code.SHAPE, shape.where, changed_part, _shape_text(shape), None, why)
        part.collisions.clear()
    return changes


def _shape_text(shape: Shape) -> str:
    if shape.kind == "mesh":
        return f"mesh {Path(shape.address).name or shape.mesh}"
    return f"{shape.kind} {' x '.join(f'{value:.4g}' for value in shape.size)} m".replace("  ", " ")


def _shown(*values: float) -> str:
    # Adding 0.0 turns -0.0 into 0.0.
    return " ".join(f"{value + 0.0:.4g}" for value in values)
