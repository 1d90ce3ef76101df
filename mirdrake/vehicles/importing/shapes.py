"""Shapes of a car as files and elements that Drake takes, and a body that does not drag on the road."""

from collections.abc import Sequence
from dataclasses import replace
from math import pi
from pathlib import Path

import numpy as np
from pydrake.math import RigidTransform, RollPitchYaw

from mirdrake.vehicles.importing.car import Car, Part
from mirdrake.vehicles.importing.meshes import MeshError, convert_collision, convert_visual
from mirdrake.vehicles.importing.model import Change, Shape
from mirdrake.vehicles.importing.names import Names
from mirdrake.vehicles.importing.round_shapes import Bounds, bounds_in

CLEARANCE = 0.02
"""Height over the wheelbase below which a collision shape of the body would carry the car on a bump or in a bend."""

_LEVEL = 1e-3
_LYING = RollPitchYaw(pi / 2.0, 0.0, 0.0)
_RUBBER, _PAINT = (0.1, 0.1, 0.1, 1.0), (0.6, 0.6, 0.6, 1.0)


def convert_shapes(car: Car, folder: Path) -> list[Change]:
    """Write the meshes of a car below its folder, and put the new shapes in place of the old ones.

    Args:
        car: its parts are changed.
        folder: the vehicle's.
    """
    changes: list[Change] = []
    files: set[str] = set()
    written: dict[tuple[object, ...], Shape] = {}
    pictures = {part.name: part.visuals[0].where for part in car.parts if part.visuals}
    pictures = pictures or {part.name: "" for part in car.parts}
    for part in car.parts:
        part.visuals = [
            new for shape in part.visuals if (new := _visual(shape, part, folder, files, written, changes)) is not None
        ]
    solid: list[Shape] = []
    for shape in car.body.collisions:
        solid += _collision(shape, car.body, folder, files, changes)
    low = CLEARANCE * car.layout.wheelbase
    car.body.collisions = [new for shape in solid if (new := _lift(shape, car.body, low, changes)) is not None]
    if not car.body.collisions:
        car.body.collisions = [_box(car, changes)]
    lost = [(part, pictures[part.name]) for part in car.parts if part.name in pictures and not part.visuals]
    changes += _show_what_touches(car, lost)
    return changes


def _visual(
    shape: Shape,
    part: Part,
    folder: Path,
    files: set[str],
    written: dict[tuple[object, ...], Shape],
    changes: list[Change],
) -> Shape | None:
    """A visual; the same mesh is written once."""
    what = f"link '{part.name}': visual"
    if shape.kind == "plane" or not _is_sound(shape):
        changes.append(Change(shape.where, what, f"{shape.kind} {shape.size}", "left out", "nothing that can be drawn"))
        return None
    if shape.kind != "mesh":
        return shape
    if shape.mesh is None:  # told when it was read
        return None
    key = (shape.mesh, shape.scale, shape.submesh, shape.rgba, shape.texture)
    if key in written:
        known = written[key]
        return replace(known, X_LG=shape.X_LG, where=shape.where)
    name = Names.unique(Path(shape.address or "mesh").stem.replace(".", "_"), files)
    try:
        new, found = convert_visual(shape, folder, name=name)
    except MeshError as error:
        changes.append(error.left_out(shape.where, what))
        return None
    changes += found
    written[key] = new
    return new


def _collision(shape: Shape, part: Part, folder: Path, files: set[str], changes: list[Change]) -> list[Shape]:
    what = f"link '{part.name}': collision shape"
    if shape.kind == "plane" or not _is_sound(shape):
        changes.append(
            Change(shape.where, what, f"{shape.kind} {shape.size}", "left out", "nothing that can be touched")
        )
        return []
    if shape.kind == "mesh" and shape.mesh is None:  # told when it was read
        return []
    name = Names.unique(f"{Path(shape.address or 'mesh').stem}_collision".replace(".", "_"), files)
    try:
        new, found = convert_collision(shape, folder, name=name)
    except MeshError as error:
        changes.append(error.left_out(shape.where, what))
        return []
    changes += found
    return new


def _is_sound(shape: Shape) -> bool:
    """Whether a primitive has a size, and a shape a place."""
    return bool(np.isfinite(shape.X_LG.translation()).all()) and all(0.0 < size < 1000.0 for size in shape.size)


def _lift(shape: Shape, body: Part, low: float, changes: list[Change]) -> Shape | None:
    """A collision shape of the body that stays above the road; None if it lies on it."""
    box = bounds_in(shape, RigidTransform())
    if box is None or box[0][2] >= low:
        return shape
    bottom, top = float(box[0][2]), float(box[1][2])
    what = f"link '{body.name}': collision shape"
    was = f"{shape.kind} from {bottom:.4g} to {top:.4g} m above the road"
    why = "it would carry the car in place of the wheels"
    if top - low < 0.3 * (top - bottom):
        changes.append(Change(shape.where, what, was, "left out", why))
        return None
    R = shape.X_LG.rotation().matrix()
    if shape.kind == "box" and np.abs(np.abs(R[2]).max() - 1.0) < _LEVEL:
        edge = int(np.argmax(np.abs(R[2])))
        size = list(shape.size)
        size[edge] = top - low
        changes.append(Change(shape.where, what, was, f"from {low:.4g} m on", why))
        return replace(shape, size=tuple(size), X_LG=_raised(shape.X_LG, (low - bottom) / 2.0))
    changes.append(Change(shape.where, what, was, f"{low - bottom:.4g} m higher", why))
    return replace(shape, X_LG=_raised(shape.X_LG, low - bottom))


def _raised(X: RigidTransform, height: float) -> RigidTransform:
    return RigidTransform(X.rotation(), X.translation() + np.array([0.0, 0.0, height]))


def _show_what_touches(car: Car, lost: Sequence[tuple[Part, str]]) -> list[Change]:
    """Body and wheels whose pictures are all lost look like their collision shapes: nobody sees a car without any."""
    changes = []
    for part, where in lost:
        rear = [key.startswith("rear") for key, wheel in car.wheels.items() if wheel is part]
        if rear:
            size = (car.layout.radii[rear[0]], car.layout.widths[rear[0]])
            part.visuals = [Shape("cylinder", size, RigidTransform(_LYING, np.zeros(3)), rgba=_RUBBER)]
        elif part is car.body:
            part.visuals = [replace(shape, rgba=_PAINT) for shape in part.collisions]
        if part.visuals:
            what, why = f"link '{part.name}': visuals", "nobody would see the car"
            changes.append(Change(where, what, "none that can be drawn", "its collision shapes", why))
    return changes


def _box(car: Car, changes: list[Change]) -> Shape:
    """A body without collision shape gets the box around it."""
    lower, upper = (np.array(corner) for corner in car.bounds)
    lower[2] = max(lower[2], min(car.estimates.ground_clearance, 0.5 * upper[2]))
    bounds: Bounds = (lower, upper)
    size = bounds[1] - bounds[0]
    became = f"box {size[0]:.4g} x {size[1]:.4g} x {size[2]:.4g} m, from {lower[2]:.3g} m on"
    where = car.body.visuals[0].where if car.body.visuals else ""
    what = f"link '{car.body.name}': collision shape"
    changes.append(
        Change(where, what, "none", became, "the box around the body; without one it would pass through walls")
    )
    return Shape("box", tuple(size.tolist()), RigidTransform(0.5 * (lower + upper)), where=where)
