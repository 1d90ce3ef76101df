"""Props of a world in a plant: static props belong to the world body, dynamic ones have a body of their own.

A static prop costs very little per step: its shapes are on the world body, whose shapes are never tested against each
other.
"""

import itertools
import json
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

import numpy as np
from pydrake.common import MemoryFile
from pydrake.geometry import (
    AddContactMaterial,
    AddRigidHydroelasticProperties,
    Box,
    GeometryId,
    InMemoryMesh,
    Mesh,
    ProximityProperties,
    Shape,
    Sphere,
)
from pydrake.math import RigidTransform
from pydrake.multibody.plant import CoulombFriction, MultibodyPlant
from pydrake.multibody.tree import RigidBody
from pydrake.systems.framework import Context

from mirdrake.worlds import PlacedProp, World
from mirdrake.worlds.props import DISSIPATION, STIFFNESS, Color, Solid

_GREY = (0.72, 0.71, 0.68, 1.0)  # colour of a prop without mesh and colour


@dataclass(frozen=True)
class PropsInPlant:
    """The props of a world in a plant.

    Attributes:
        owners: prop of each collision geometry.
        bumps: geometries that vehicles may drive over.
        bodies: body of each dynamic prop.
        poses: start poses X_WP of the dynamic props.
    """

    owners: dict[GeometryId, str] = field(default_factory=dict)
    bumps: set[GeometryId] = field(default_factory=set)
    bodies: dict[str, RigidBody] = field(default_factory=dict)
    poses: dict[str, RigidTransform] = field(default_factory=dict)

    def reset(self, plant: MultibodyPlant, context: Context) -> None:
        """Move the dynamic props to their start poses.

        Args:
            plant: the finalised plant.
            context: the plant's context, changed.
        """
        for name, body in self.bodies.items():
            plant.SetFloatingBaseBodyPoseInWorldFrame(context, body, self.poses[name])


def add_props(plant: MultibodyPlant, world: World) -> PropsInPlant:
    """Add the props of a world to a plant that is not finalised yet.

    Args:
        plant: a plant with a scene graph.
        world: the world.

    Returns:
        the props with their geometries and bodies.
    """
    added = PropsInPlant()
    for placed in world.props:
        prop, material = placed.prop, ProximityProperties()
        AddContactMaterial(
            friction=CoulombFriction(prop.mu, prop.mu),
            dissipation=DISSIPATION,
            point_stiffness=STIFFNESS,
            properties=material,
        )
        if prop.driven_over:
            AddRigidHydroelasticProperties(0.05, material)
        if placed.static:
            body, X_BP = plant.world_body(), placed.X_WP
        else:
            instance = plant.AddModelInstance(f"prop/{placed.name}")
            body, X_BP = plant.AddRigidBody(placed.name, instance, prop.inertia), RigidTransform()
            added.bodies[placed.name], added.poses[placed.name] = body, placed.X_WP
        for index, solid in enumerate(prop.solids):
            name = f"prop/{placed.name}/{index}"
            geometry = plant.RegisterCollisionGeometry(body, X_BP @ solid.X_PS, solid.shape, name, material)
            added.owners[geometry] = placed.name
            if prop.driven_over:
                added.bumps.add(geometry)
            for number, (shape, X_PG) in enumerate([] if placed.static else _feet(solid)):
                foot = plant.RegisterCollisionGeometry(body, X_BP @ X_PG, shape, f"{name}/foot{number}", material)
                added.owners[foot] = placed.name
        for index, (shape, X_PG) in enumerate(looks(placed)):
            rgba = np.array([*placed.color, 1.0] if placed.color else _GREY)
            plant.RegisterVisualGeometry(body, X_BP @ X_PG, shape, f"prop/{placed.name}/look{index}", rgba)
    return added


def _feet(solid: Solid) -> list[tuple[Shape, RigidTransform]]:
    """Return small spheres in the corners of a box, flush with its faces, on which it rests.

    Drake's point contact has one point per pair of shapes, the deepest corner of a box, so that a box would rattle
    from corner to corner; each sphere has its own point.

    Returns:
        shapes and their poses X_PG; none for other shapes than boxes.
    """
    if not isinstance(solid.shape, Box):
        return []
    radius = 0.02 * float(min(solid.shape.size()))
    reach = 0.5 * solid.shape.size() - radius
    return [
        (Sphere(radius), solid.X_PS @ RigidTransform(reach * np.array(signs)))
        for signs in itertools.product((-1.0, 1.0), repeat=3)
    ]


def looks(placed: PlacedProp) -> list[tuple[Shape, RigidTransform]]:
    """Return the visual shapes of a prop and their poses X_PG."""
    prop = placed.prop
    if prop.visual is None:
        return [(solid.shape, solid.X_PS) for solid in prop.solids]
    scale = np.asarray(prop.scale, dtype=float)
    if placed.color is not None and prop.paint is not None and prop.visual.suffix == ".gltf":
        return [(Mesh(_painted(prop.visual, prop.paint, placed.color), scale), RigidTransform())]
    return [(Mesh(str(prop.visual), scale), RigidTransform())]


@lru_cache(maxsize=256)
def _painted(path: Path, material: str, color: Color) -> InMemoryMesh:
    """Return a copy of a glTF file with another colour of one material."""
    data = json.loads(path.read_text(encoding="utf-8"))
    for entry in data.get("materials", ()):
        if entry.get("name") == material:
            shading = entry.setdefault("pbrMetallicRoughness", {})
            shading["baseColorFactor"] = [component**2.2 for component in color] + [1.0]  # sRGB to linear
    uris = [item["uri"] for key in ("buffers", "images") for item in data.get(key, ()) if "uri" in item]
    beside = {uri: path.parent / uri for uri in uris if not uri.startswith("data:")}
    return InMemoryMesh(mesh_file=MemoryFile(json.dumps(data), ".gltf", path.stem), supporting_files=beside)
