"""Poses of the links and joints of a source model at zero joint positions."""

from collections.abc import Container
from dataclasses import dataclass

import numpy as np
from pydrake.math import RigidTransform, RotationMatrix

from mirdrake.core.errors import ModelError
from mirdrake.core.yaml_io import display_path
from mirdrake.importing.changes import Changes, Code
from mirdrake.importing.shape import Vector
from mirdrake.importing.vehicles.model import Joint, SourceModel

UP = np.array([0.0, 0.0, 1.0])

FREE = ("floating", "planar")
"""Joints that separate models: links below them are not part of the vehicle."""


@dataclass(frozen=True)
class Tree:
    """The links that descend from one root.

    Attributes:
        model: source model.
        root: the link without a parent.
        poses: poses of each link in the frame M of the model, z up, all joints at zero; parents come before their
            children.
        above: the joint that carries a link; the root has none.
    """

    model: SourceModel
    root: str
    poses: dict[str, RigidTransform]
    above: dict[str, Joint]

    def path(self, link: str) -> list[Joint]:
        """Return joints from the root to a link, in this order."""
        joints = []
        while link in self.above:
            joints.append(self.above[link])
            link = joints[-1].parent
        return joints[::-1]

    def rigid_with(self, link: str, free: Container[str]) -> list[str]:
        """Return a link and its descendants, except beyond a joint named in `free`."""
        links = [link]
        for name in self.poses:  # parents come first
            if name in self.above and self.above[name].parent in links and self.above[name].name not in free:
                links.append(name)
        return links

    def pose(self, joint: Joint) -> RigidTransform:
        """Return pose of a joint's frame J in M."""
        return self.poses[joint.parent].multiply(joint.X_PJ)

    def axis(self, joint: Joint, *, second: bool = False) -> Vector | None:
        """Return unit axis of a joint in M, or None if it has no direction."""
        axis = joint.axis2 if second else joint.axis
        length = 0.0 if axis is None else float(np.linalg.norm(axis))
        if axis is None or not np.isfinite(length) or length < 1e-9:
            return None
        turned: Vector = self.pose(joint).rotation().matrix() @ (np.asarray(axis, dtype=float) / length)
        return turned


def make_tree(model: SourceModel) -> tuple[Tree, Changes]:
    """Return the largest tree of a model, and what was left out of it.

    Raises:
        ModelError: the model has no links, or its joints form a loop.
    """
    location = source_name(model)
    if not model.links:
        raise ModelError("no links in it; give the file that describes the vehicle", where=location)
    # Each link has one parent: a second joint would close a loop.
    changes = Changes()
    above: dict[str, Joint] = {}
    for joint in model.joints.values():
        part, was = f"joint '{joint.name}'", f"{joint.kind}, {joint.parent} to {joint.child}"
        # The vehicle is free, so a joint to the world is left out; only a fixed one would have changed its motion.
        if joint.parent == "world" or joint.kind in FREE:
            if joint.parent == "world" and joint.kind == "fixed":
                changes.add(Code.JOINT, joint.where, part, was, None, "a vehicle is not fixed to the world")
        elif joint.parent not in model.links or joint.child not in model.links:
            lost = joint.parent if joint.parent not in model.links else joint.child
            changes.add(Code.JOINT, joint.where, part, was, None, f"the link '{lost}' does not exist")
        elif joint.child in above or joint.kind == "gearbox":
            why = "it closes a kinematic loop; a vehicle is a tree of links"
            changes.add(Code.JOINT, joint.where, part, was, None, why)
        else:
            above[joint.child] = joint
    # Files may contain several trees, for example a ground link; the vehicle is the largest.
    roots = [name for name in model.links if name not in above and name != "world"]
    if not roots:
        raise ModelError("the joints form a loop; no link is the root", where=location)
    trees = [_grow(model, root, above) for root in roots]
    tree = max(trees, key=lambda tree: len(tree.poses))  # the first of equals
    for name, link in model.links.items():
        if name not in tree.poses and name != "world":
            why = "no joint connects it to the vehicle"
            changes.add(Code.JOINT, link.where, f"link '{name}'", "part of the model", None, why)
    return tree, changes


def _grow(model: SourceModel, root: str, above: dict[str, Joint]) -> Tree:
    children: dict[str, list[Joint]] = {}
    for joint in above.values():
        children.setdefault(joint.parent, []).append(joint)
    poses = {root: model.links[root].X_ML or RigidTransform()}
    waiting = [root]
    while waiting:
        # Breadth first: `rigid_with` relies on parents before their children.
        link = waiting.pop(0)
        for joint in children.get(link, []):
            poses[joint.child] = poses[link].multiply(joint.X_PJ).multiply(joint.X_JC)
            waiting.append(joint.child)
    return Tree(model, root, poses, {name: joint for name, joint in above.items() if name in poses})


def source_name(model: SourceModel) -> str:
    """Return the main file, as messages name it."""
    return display_path(model.files[0]) if model.files else model.name


def frame_about(origin: Vector, *, y: Vector, up: Vector) -> RigidTransform:
    """Return the frame at a point with a given y axis and its z axis as near to `up` as possible."""
    z = up - y * (y @ up)
    z = z / np.linalg.norm(z)
    return RigidTransform(RotationMatrix(np.column_stack([np.cross(y, z), y, z])), origin)
