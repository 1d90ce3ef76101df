"""Shapes of a car as files and elements for Drake, with a body that does not touch the road."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import pi
from pathlib import Path

import numpy as np
from pydrake.math import RigidTransform, RollPitchYaw

from mirdrake.importing.changes import Change, Changes, Code
from mirdrake.importing.meshes.convert import MeshError, convert_collision, convert_visual
from mirdrake.importing.meshes.convex import CUT_TIME, CutTime
from mirdrake.importing.shape import Shape
from mirdrake.importing.vehicles.body_cover import COVERED, body_boxes, plan_cover, usual_bounds
from mirdrake.importing.vehicles.car import Car, Part
from mirdrake.importing.vehicles.names import Names
from mirdrake.importing.vehicles.round_shapes import Bounds, bounds_in

CLEARANCE = 0.02
"""Height over the wheelbase below which a collision shape of the body would carry the car on a bump or in a bend."""

_LEVEL = 1e-3
_LYING = RollPitchYaw(pi / 2.0, 0.0, 0.0)
_RUBBER, _PAINT = (0.1, 0.1, 0.1, 1.0), (0.6, 0.6, 0.6, 1.0)


def convert_shapes(car: Car, folder: Path, *, convex_time: float = CUT_TIME) -> list[Change]:
    """Write the meshes of a car below its folder, and put the new shapes in place of the old ones.

    Args:
        car: its parts are changed.
        folder: the vehicle's.
        convex_time: time limit for cutting collision meshes into convex parts [s].
    """
    changes = Changes()
    files: set[str] = set()
    written: dict[tuple[object, ...], Shape] = {}
    # Visuals.
    places = {part.name: part.visuals[0].where for part in car if part.visuals}
    drawn: list[Shape] = []
    for part in car:
        converted = [(shape, _visual(shape, part, folder, files, written, changes)) for shape in part.visuals]
        part.visuals = [new for _, new in converted if new is not None]
        if part is car.body:
            drawn = [shape for shape, new in converted if new is not None]
    # Collision shapes, raised above the road.
    solid: list[Shape] = []
    time = CutTime(convex_time)
    for shape in car.body.collisions:
        solid += _collision(shape, car.body, folder, files, changes, time)
    # The limit is relative to the wheelbase, so that it suits scale models, too.
    low = CLEARANCE * car.layout.wheelbase
    car.body.collisions = [new for shape in solid if (new := _lift(shape, car.body, low, changes)) is not None]
    # Replacements for missing ones.
    bodyless = plan_cover(body_boxes(drawn, car.layout), car.layout) < COVERED
    if bodyless:
        changes += _show_body(car, changes)
    elif not car.body.collisions:
        car.body.collisions = [_box(car, car.bounds, "none", changes)]
    changes += _show_wheels(car, places, every=bodyless)
    return changes


def _visual(
    shape: Shape, part: Part, folder: Path, files: set[str], written: dict[tuple[object, ...], Shape], changes: Changes
) -> Shape | None:
    """Return a converted visual; each mesh is written once."""
    changed_part = f"link '{part.name}': visual"
    # A plane is infinite and cannot be part of a car.
    if shape.kind == "plane" or not _is_sound(shape):
        changes.add(Code.SHAPE, shape.where, changed_part, f"{shape.kind} {shape.size}", None, "it has no valid size")
        return None
    if shape.kind != "mesh":
        return shape
    if shape.mesh is None:  # reported by the reader
        return None
    # Shapes of one mesh, such as those of four wheels, share its file.
    key = (shape.mesh, shape.scale, shape.submesh, shape.rgba, shape.texture)
    if key in written:
        known = written[key]
        return replace(known, X_LG=shape.X_LG, where=shape.where)
    name = Names.unique(Path(shape.address or "mesh").stem.replace(".", "_"), files)
    try:
        new, more = convert_visual(shape, folder, name=name)
    except MeshError as error:
        changes.append(error.left_out(shape.where, changed_part))
        return None
    changes += more
    written[key] = new
    return new


def _collision(shape: Shape, part: Part, folder: Path, files: set[str], changes: Changes, time: CutTime) -> list[Shape]:
    changed_part = f"link '{part.name}': collision shape"
    if shape.kind == "plane" or not _is_sound(shape):
        changes.add(Code.SHAPE, shape.where, changed_part, f"{shape.kind} {shape.size}", None, "it has no valid size")
        return []
    # Planes have no volume: as the collision shape of a moving part they would collide with everything on one side.
    if shape.kind == "mesh" and shape.mesh is None:  # reported by the reader
        return []
    name = Names.unique(f"{Path(shape.address or 'mesh').stem}_collision".replace(".", "_"), files)
    try:
        new, more = convert_collision(shape, folder, name=name, time=time)
    except MeshError as error:
        changes.append(error.left_out(shape.where, changed_part))
        return []
    changes += more
    return new


def _is_sound(shape: Shape) -> bool:
    """Return whether pose and size of a shape are finite and the size is positive."""
    return bool(np.isfinite(shape.X_LG.translation()).all()) and all(0.0 < size < 1000.0 for size in shape.size)


def _lift(shape: Shape, body: Part, low: float, changes: Changes) -> Shape | None:
    """Return a collision shape of the body raised above the road; None if most of it is below."""
    box = bounds_in(shape, RigidTransform())
    if box is None or box[0][2] >= low:
        return shape
    bottom, top = float(box[0][2]), float(box[1][2])
    part = f"link '{body.name}': collision shape"
    was = f"{shape.kind} from {bottom:.4g} to {top:.4g} m above the road"
    why = "it would touch the road before the wheels"
    if top - low < 0.3 * (top - bottom):
        changes.add(Code.SHAPE, shape.where, part, was, None, why)
        return None
    # An upright box is cut off at the bottom; any other shape is moved up.
    R = shape.X_LG.rotation().matrix()
    if shape.kind == "box" and np.abs(np.abs(R[2]).max() - 1.0) < _LEVEL:
        # Only the edge along the vertical becomes shorter.
        edge = int(np.argmax(np.abs(R[2])))
        size = list(shape.size)
        size[edge] = top - low
        changes.add(Code.SHAPE, shape.where, part, was, f"from {low:.4g} m on", why)
        # The pose of a box is that of its middle, which rises by half of the cut.
        return replace(shape, size=tuple(size), X_LG=_raised(shape.X_LG, (low - bottom) / 2.0))
    changes.add(Code.SHAPE, shape.where, part, was, f"{low - bottom:.4g} m higher", why)
    return replace(shape, X_LG=_raised(shape.X_LG, low - bottom))


def _raised(X: RigidTransform, height: float) -> RigidTransform:
    return RigidTransform(X.rotation(), X.translation() + np.array([0.0, 0.0, height]))


def _show_body(car: Car, reported: Sequence[Change]) -> list[Change]:
    """Draw the collision shapes of a body whose visuals do not cover it; a box where these do not cover it either.

    Visuals that are drawn, such as sensors, stay.
    """
    changes = Changes()
    body, part = car.body, f"link '{car.body.name}': visuals"
    where = body.visuals[0].where if body.visuals else body.collisions[0].where if body.collisions else ""
    cover = plan_cover(body_boxes(body.collisions, car.layout), car.layout)
    shown, verb = "its collision shapes", "are"
    # Collision shapes that cover little are those of parts: a box then looks more like the vehicle.
    if cover < COVERED:
        was = "none"
        if body.collisions:
            was = f"{len(body.collisions)} shapes that cover {100.0 * cover:.0f} % of wheelbase x track"
        body.collisions = [_box(car, usual_bounds(car.layout), was, changes)]
        shown, verb = "a box of the usual size for its wheelbase and track", "is"
    was = f"{len(body.visuals)} that cover little of it" if body.visuals else "none that can be drawn"
    body.visuals += [replace(shape, rgba=_PAINT) for shape in body.collisions]
    changes.add(Code.SHAPE, where, part, was, shown, "the body would be invisible")
    lost = [change for change in reported if change.part == f"link '{body.name}': visual" and change.left_out]
    reason = f" ({lost[0].old}: {lost[0].reason})" if lost else ""
    car.warnings.append(f"The body has no visual shape that can be used{reason}: {shown} {verb} drawn instead.")
    return changes


def _show_wheels(car: Car, places: Mapping[str, str], *, every: bool) -> list[Change]:
    """Draw wheels as cylinders where their visuals are lost.

    Args:
        car: its wheels are changed.
        places: part that had visuals -> place in the source.
        every: also wheels that had none, which may be drawn with the body.
    """
    changes = Changes()
    for key, wheel in car.wheels.items():
        if wheel.visuals or not (every or wheel.name in places):
            continue
        rear = key.startswith("rear")
        size = (car.layout.radii[rear], car.layout.widths[rear])
        wheel.visuals = [Shape("cylinder", size, RigidTransform(_LYING, np.zeros(3)), rgba=_RUBBER)]
        part, why = f"link '{wheel.name}': visuals", "the wheel would be invisible"
        changes.add(Code.SHAPE, places.get(wheel.name, ""), part, "none that can be drawn", "its collision shapes", why)
    return changes


def _box(car: Car, bounds: Bounds, was: str, changes: Changes) -> Shape:
    """Return a collision shape for a body: its bounding box, above the road."""
    lower, upper = (np.array(corner) for corner in bounds)
    # At most half of the height, so that a low body keeps a box.
    lower[2] = max(lower[2], min(car.estimates.ground_clearance, 0.5 * upper[2]))
    size = upper - lower
    became = f"box {size[0]:.4g} x {size[1]:.4g} x {size[2]:.4g} m, from {lower[2]:.3g} m on"
    where = car.body.visuals[0].where if car.body.visuals else ""
    part = f"link '{car.body.name}': collision shape"
    why = "the box around the body; without it, the car would have no collision geometry"
    changes.add(Code.SHAPE, where, part, was, became, why)
    return Shape("box", tuple(size.tolist()), RigidTransform(0.5 * (lower + upper)), where=where)
