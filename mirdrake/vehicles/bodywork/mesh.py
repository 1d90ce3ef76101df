"""Triangles collected by material, and the glTF files they are written to."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from mirdrake.core.meshes import Array, Primitive, area_vectors, pbr_material, srgb_to_linear, write_gltf


@dataclass(frozen=True)
class Material:
    """A material of glTF's metallic-roughness model; the colour is given in sRGB."""

    rgb: tuple[float, float, float]
    roughness: float
    metallic: float = 0.0
    emissive: float = 0.0

    def entry(self, name: str) -> dict[str, object]:
        """Return the material in glTF's form."""
        linear = [round(value, 5) for value in srgb_to_linear(np.array(self.rgb)).tolist()]
        material = {"name": name, **pbr_material((*linear, 1.0), roughness=self.roughness, metallic=self.metallic)}
        if self.emissive:
            material["emissiveFactor"] = [round(value * self.emissive, 5) for value in linear]
        return material


MATERIALS: dict[str, Material] = {
    "paint": Material((0.07, 0.45, 0.90), 0.36, 0.1),
    "glass": Material((0.13, 0.19, 0.25), 0.22),
    "gloss_black": Material((0.05, 0.05, 0.06), 0.3),
    "cladding": Material((0.13, 0.13, 0.14), 0.8),
    "gap": Material((0.03, 0.04, 0.07), 0.9),
    "dark": Material((0.04, 0.04, 0.045), 0.95),
    "grille": Material((0.24, 0.25, 0.27), 0.45, 0.2),
    "lamp": Material((0.80, 0.84, 0.88), 0.2, 0.1),
    "lamp_white": Material((1.0, 1.0, 1.0), 0.3, 0.0, 0.35),
    "lamp_red": Material((0.78, 0.03, 0.05), 0.25, 0.0, 0.08),
    "lamp_dark_red": Material((0.42, 0.02, 0.03), 0.3),
    "amber": Material((0.98, 0.55, 0.08), 0.35),
    "chrome": Material((0.82, 0.83, 0.85), 0.3, 0.25),
    "gold": Material((0.86, 0.66, 0.22), 0.35, 0.2),
    "plate": Material((0.93, 0.93, 0.90), 0.6),
    "plate_text": Material((0.06, 0.08, 0.20), 0.7),
    "rubber": Material((0.09, 0.09, 0.095), 0.9),
    "rubber_mark": Material((0.42, 0.42, 0.42), 0.8),
    "rim_machined": Material((0.90, 0.91, 0.93), 0.4, 0.1),
    "rim_dark": Material((0.20, 0.21, 0.23), 0.5, 0.1),
    "rim_shadow": Material((0.07, 0.07, 0.075), 0.9),
    "disc": Material((0.45, 0.45, 0.46), 0.5, 0.2),
    "accent": Material((0.05, 0.36, 0.86), 0.4, 0.1),
    "valve": Material((0.95, 0.25, 0.05), 0.5),
}


@dataclass
class Mesh:
    """Triangles with normals, collected by material."""

    parts: dict[str, list[tuple[Array, Array]]] = field(default_factory=dict)  # material: (triangles, normals) (n,3,3)

    def add(self, material: str, triangles: Array, normals: Array) -> None:
        """Add triangles (n, 3, 3) with the normals at their corners; turns those that face against their normals."""
        # Degenerate triangles have no direction; the others are wound so that their face agrees with the normals.
        face = area_vectors(triangles)
        keep = np.linalg.norm(face, axis=1) > 1e-10
        triangles, normals, face = triangles[keep], normals[keep], face[keep]
        wrong = np.einsum("ij,ij->i", face, normals.sum(axis=1)) < 0
        triangles = np.where(wrong[:, None, None], triangles[:, ::-1], triangles)
        normals = np.where(wrong[:, None, None], normals[:, ::-1], normals)
        self.parts.setdefault(material, []).append((triangles, normals))

    def add_grid(self, material: str, points: Array, normals: Array) -> None:
        """Add the quadrilaterals of a grid of points (m, n, 3)."""

        def split(a: Array) -> Array:
            p, q, r, s = a[:-1, :-1], a[1:, :-1], a[1:, 1:], a[:-1, 1:]
            # Two triangles for each quadrilateral.
            both = np.stack([np.stack([p, q, r], axis=2), np.stack([p, r, s], axis=2)])
            return both.reshape(-1, 3, 3)

        self.add(material, split(points), split(normals))

    def add_flat(self, material: str, triangles: Array, normal: Sequence[float] | Array) -> None:
        """Add flat triangles that share one normal."""
        self.add(material, triangles, np.broadcast_to(np.array(normal, dtype=float), triangles.shape).copy())

    def add_mesh(self, other: Mesh, rotation: Array | None = None, offset: Sequence[float] = (0, 0, 0)) -> None:
        """Add another mesh, rotated and moved."""
        R = np.eye(3) if rotation is None else rotation
        for material, chunks in other.parts.items():
            for triangles, normals in chunks:
                self.add(material, triangles @ R.T + np.array(offset), normals @ R.T)

    def mirrored(self) -> Mesh:
        """Return the mirror image at the plane y = 0."""
        flip = np.array([1.0, -1.0, 1.0])
        result = Mesh()
        for material, chunks in self.parts.items():
            for triangles, normals in chunks:
                result.add(material, triangles * flip, normals * flip)
        return result

    def transformed(self, move: Callable[[Array], Array], turn: Callable[[Array, Array], Array]) -> Mesh:
        """Return the image under ``move`` of points; ``turn`` maps (points, normals) to normals. Both take (…, 3)."""
        result = Mesh()
        for material, chunks in self.parts.items():
            for triangles, normals in chunks:
                result.add(material, move(triangles), turn(triangles, normals))
        return result

    def scaled(self, factor: float) -> Mesh:
        """Return the mesh enlarged about the origin."""
        return Mesh({name: [(t * factor, n) for t, n in chunks] for name, chunks in self.parts.items()})

    def corners(self, *materials: str) -> Array:
        """Return the corners (n, 3) of all triangles, or of those of the named materials."""
        chunks_of = [t.reshape(-1, 3) for name, chunks in self.parts.items() if not materials or name in materials
                 for t, _ in chunks]  # fmt: skip
        return np.concatenate(chunks_of) if chunks_of else np.zeros((0, 3))

    def write(
        self,
        path: Path,
        *,
        materials: Mapping[str, Material] = MATERIALS,
        generator: str = "mirdrake",
        grid: float = 5e-5,
    ) -> int:
        """Write ``path`` (.gltf) and its .bin beside it.

        Args:
            path: the .gltf file.
            materials: the material of every name used.
            generator: text of glTF's ``asset.generator``.
            grid: distance below which corners with like normals are merged [m].

        Returns:
            The number of triangles.
        """
        primitives = []
        for name in sorted(self.parts):
            corners = np.concatenate([t for t, _ in self.parts[name]]).reshape(-1, 3)
            normals = np.concatenate([n for _, n in self.parts[name]]).reshape(-1, 3)
            normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
            # Corners are merged if position and normal agree on a grid, so that sharp edges keep two normals.
            key = np.concatenate([np.round(corners / grid), np.round(normals * 60)], axis=1)
            _, first, inverse = np.unique(key, axis=0, return_index=True, return_inverse=True)
            faces = inverse.reshape(-1, 3)
            # Merging may collapse small triangles.
            good = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
            # glTF: 65535 is the restart index of 16-bit indices and may not be used.
            faces = faces[good].astype(np.uint16 if len(first) < 65535 else np.uint32)
            if len(faces):
                primitives.append(Primitive(corners[first], normals[first], faces, materials[name].entry(name)))
        write_gltf(path, primitives, generator=generator)
        return sum(len(primitive.triangles) for primitive in primitives)
