"""Props of a world in a plant: what stands still is part of the world body, what can be knocked over has its own body.

A static prop costs next to nothing in a step: its shapes lie on the world body, where no two of them are ever tested
against each other.
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

_GREY = (0.72, 0.71, 0.68, 1.0)  # of a prop without mesh and colour


@dataclass(frozen=True)
class PropsInPlant:
    """The props of a world in a plant.

    Attributes:
        owners: prop of each collision geometry.
        bumps: those of them that are made to be driven over.
        bodies: body of each prop that can be knocked over.
        poses: where those start, X_WP.
    """

    owners: dict[GeometryId, str] = field(default_factory=dict)
    bumps: set[GeometryId] = field(default_factory=set)
    bodies: dict[str, RigidBody] = field(default_factory=dict)
    poses: dict[str, RigidTransform] = field(default_factory=dict)

    def reset(self, plant: MultibodyPlant, context: Context) -> None:
        """Put what can be knocked over where it starts.

        Args:
            plant: the finalised plant.
            context: the plant's context, changed.
        """
        for name, body in self.bodies.items():
            plant.SetFloatingBaseBodyPoseInWorldFrame(context, body, self.poses[name])


def add_props(plant: MultibodyPlant, world: World) -> PropsInPlant:
    """Put the props of a world into a plant that is not finalised yet.

    Args:
        plant: with a scene graph.
        world: its props.

    Returns:
        what belongs to which prop.
    """
    found = PropsInPlant()
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
            found.bodies[placed.name], found.poses[placed.name] = body, placed.X_WP
        for index, solid in enumerate(prop.solids):
            name = f"prop/{placed.name}/{index}"
            geometry = plant.RegisterCollisionGeometry(body, X_BP @ solid.X_PS, solid.shape, name, material)
            found.owners[geometry] = placed.name
            if prop.driven_over:
                found.bumps.add(geometry)
            for number, (shape, X_PG) in enumerate([] if placed.static else _feet(solid)):
                foot = plant.RegisterCollisionGeometry(body, X_BP @ X_PG, shape, f"{name}/foot{number}", material)
                found.owners[foot] = placed.name
        for index, (shape, X_PG) in enumerate(looks(placed)):
            rgba = np.array([*placed.color, 1.0] if placed.color else _GREY)
            plant.RegisterVisualGeometry(body, X_BP @ X_PG, shape, f"prop/{placed.name}/look{index}", rgba)
    return found


def _feet(solid: Solid) -> list[tuple[Shape, RigidTransform]]:
    """Small balls in the corners of a box, flush with its faces, on which it rests.

    Drake's point contact finds one point of a box on the ground, the deepest corner, so that a box would rattle from
    corner to corner; each ball has a point of its own.

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
    """What is seen of a prop: shapes and their poses X_PG."""
    prop = placed.prop
    if prop.visual is None:
        return [(solid.shape, solid.X_PS) for solid in prop.solids]
    scale = np.asarray(prop.scale, dtype=float)
    if placed.color is not None and prop.paint is not None and prop.visual.suffix == ".gltf":
        return [(Mesh(_painted(prop.visual, prop.paint, placed.color), scale), RigidTransform())]
    return [(Mesh(str(prop.visual), scale), RigidTransform())]


@lru_cache(maxsize=256)
def _painted(path: Path, material: str, color: Color) -> InMemoryMesh:
    """A glTF file with one of its materials in another colour; the file itself is left alone."""
    data = json.loads(path.read_text(encoding="utf-8"))
    for entry in data.get("materials", ()):
        if entry.get("name") == material:
            shading = entry.setdefault("pbrMetallicRoughness", {})
            shading["baseColorFactor"] = [component**2.2 for component in color] + [1.0]  # sRGB to linear
    uris = [item["uri"] for key in ("buffers", "images") for item in data.get(key, ()) if "uri" in item]
    beside = {uri: path.parent / uri for uri in uris if not uri.startswith("data:")}
    return InMemoryMesh(mesh_file=MemoryFile(json.dumps(data), ".gltf", path.stem), supporting_files=beside)
