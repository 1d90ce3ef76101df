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
import scipy  # it imports its parts when they are first used
import shapely
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

from mirdrake.core.meshes import srgb_to_linear
from mirdrake.ground import Terrain
from mirdrake.ground.terrain import Grid
from mirdrake.worlds import PlacedProp, Prop, World
from mirdrake.worlds.props import DISSIPATION, STIFFNESS, Color, Solid

_CELL = 0.01
"""Spacing of the heights of a prop that vehicles drive over [m]."""

_STEEP = 1e-9  # vertical component of the normal of a vertical face [1]
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
        prop, material = placed.prop, contact_material(placed.prop)
        # Rigid: the compliance is that of the tyre.
        if prop.driven_over:
            AddRigidHydroelasticProperties(0.05, material)
        # Static props are part of the world body, dynamic ones free bodies with a start pose.
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
            # Extra contact points at the base keep a free prop from rocking on a single point.
            for number, (shape, X_PG) in enumerate([] if placed.static else _feet(solid)):
                foot = plant.RegisterCollisionGeometry(body, X_BP @ X_PG, shape, f"{name}/foot{number}", material)
                added.owners[foot] = placed.name
        # What is seen may differ from what collides.
        for index, (shape, X_PG) in enumerate(looks(placed)):
            rgba = np.array([*placed.color, 1.0] if placed.color else _GREY)
            plant.RegisterVisualGeometry(body, X_BP @ X_PG, shape, f"prop/{placed.name}/look{index}", rgba)
    return added


def contact_material(prop: Prop) -> ProximityProperties:
    """Return the properties of contact with a prop."""
    material = ProximityProperties()
    AddContactMaterial(
        friction=CoulombFriction(prop.mu, prop.mu),
        dissipation=DISSIPATION,
        point_stiffness=STIFFNESS,
        properties=material,
    )
    return material


def terrain_of(world: World) -> Terrain:
    """Return the ground of a world with the props that vehicles drive over."""
    ground = world.ground.terrain
    bumps = [grid for placed in world.props if placed.prop.driven_over for grid in _tops(placed, ground)]
    return ground.with_layers(bumps) if bumps else ground


def _tops(placed: PlacedProp, ground: Terrain) -> list[Grid]:
    """Return the upper surface of each solid of a prop above the ground, as local grids; solids must not overlap.

    Shapes are convex: the height at a point is the smallest one of the planes of the upper facets of the hull.
    """
    grids = []
    for solid in placed.prop.solids:
        corners = np.array([placed.X_WP @ corner for corner in solid.corners.reshape(-1, 3)])
        outline = shapely.oriented_envelope(shapely.MultiPoint(corners[:, :2]))
        ring = shapely.get_coordinates(outline)

        # Grid along the edges of the smallest rectangle around the solid, with a right-handed pair of axes.
        along = ring[1] - ring[0]
        length, yaw = float(np.hypot(*along)), float(np.arctan2(along[1], along[0]))
        across = ring[3] - ring[0] if len(ring) > 4 else ring[2] - ring[1]
        width = float(np.hypot(*across))
        e = along / length
        n = np.array([-e[1], e[0]])
        origin = ring[0] if n @ across > 0.0 else ring[0] + across
        # One more node on each side has the height zero, so that a vertical face is one cell long.
        u = _CELL * np.arange(-1, int(np.ceil(length / _CELL)) + 2)
        v = _CELL * np.arange(-1, int(np.ceil(width / _CELL)) + 2)
        points = origin + u[None, :, None] * e + v[:, None, None] * n
        # Facets a x + b y + c z + d = 0 with outward normals: heights of upper and lower facets, and vertical walls.
        planes = scipy.spatial.ConvexHull(corners).equations
        heights = [-(points @ plane[:2] + plane[3]) / plane[2] for plane in planes if abs(plane[2]) > _STEEP]
        upwards = planes[np.abs(planes[:, 2]) > _STEEP, 2] > 0.0
        z = np.min([height for height, up in zip(heights, upwards, strict=True) if up], axis=0)
        bottom = np.max([height for height, up in zip(heights, upwards, strict=True) if not up], axis=0)
        walls = [points @ plane[:2] + plane[3] > _STEEP for plane in planes if abs(plane[2]) <= _STEEP]
        outside = (z <= bottom) | np.any(walls, axis=0)
        z = np.where(outside, 0.0, np.maximum(z - ground.height(points[..., 0], points[..., 1]), 0.0))
        x, y = origin - _CELL * (e + n)
        grids.append(Grid(z, _CELL, x=float(x), y=float(y), yaw=yaw, smooth=False, local=True))
    return grids


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
            shading["baseColorFactor"] = [*srgb_to_linear(np.array(color)).tolist(), 1.0]
    # Buffers beside the file are not in its text; Drake needs them as supporting files.
    uris = [item["uri"] for key in ("buffers", "images") for item in data.get(key, ()) if "uri" in item]
    beside = {uri: path.parent / uri for uri in uris if not uri.startswith("data:")}
    return InMemoryMesh(mesh_file=MemoryFile(json.dumps(data), ".gltf", path.stem), supporting_files=beside)
