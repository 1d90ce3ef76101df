"""Visual and collision shapes of a source model."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RigidTransform

Vector = NDArray[np.float64]


@dataclass
class Shape:
    """A visual or collision shape.

    Attributes:
        kind: box, cylinder (axis z), sphere, capsule (axis z), ellipsoid, plane or mesh.
        size: box: three edges; cylinder and capsule: radius, length; sphere: radius; ellipsoid: three half axes [m].
        X_LG: pose in its link.
        mesh: resolved file of a mesh; None if the file does not exist.
        address: address of the mesh, as written.
        scale: three scale factors of the mesh.
        submesh: name of the part of the mesh; "" for all.
        center: whether the part is moved so that the centre of its bounding box is the origin.
        rgba: colour; None if the source has none.
        texture: picture file; None if there is none.
        where: ``file:line``.
    """

    kind: str
    size: tuple[float, ...] = ()
    X_LG: RigidTransform = field(default_factory=RigidTransform)
    mesh: Path | None = None
    address: str = ""
    scale: tuple[float, float, float] = (1.0, 1.0, 1.0)
    submesh: str = ""
    center: bool = False
    rgba: tuple[float, float, float, float] | None = None
    texture: Path | None = None
    where: str = ""
