"""Labels of a world in Meshcat: texts on white plates that face the camera of the overview, none over another."""

import io
import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont
from pydrake.common import MemoryFile
from pydrake.geometry import InMemoryMesh
from pydrake.math import RigidTransform, RollPitchYaw

from mirdrake.core.meshes import Primitive, gltf_text, pbr_material
from mirdrake.viewer.pages import data_address

Array = NDArray[np.float64]

MOST = 400
"""Largest number of labels; more of them make a page slow."""

_TILT = math.radians(-35.0)  # about x: towards a camera in the south and above
_FONT_SIZE, _HEIGHT, _MARGIN = 40, 60, 14  # of the text, of the plate, and beside the text [pixels]


@dataclass(frozen=True)
class Label:
    """A text on a plate that is tilted towards the south.

    Attributes:
        text: the text.
        position: middle of the plate in W [m].
        height: height of the plate [m].
    """

    text: str
    position: tuple[float, float, float]
    height: float

    @property
    def X_WL(self) -> RigidTransform:  # noqa: N802
        """Pose of the plate, which is in the x-z plane of L and faces -y."""
        return RigidTransform(RollPitchYaw(_TILT, 0.0, 0.0), list(self.position))

    @property
    def _box(self) -> tuple[float, float, float, float]:
        return _font().getbbox(self.text)

    @property
    def corners(self) -> Array:
        """Corners of a plate of 1 m height in L (4, 3) [m]."""
        half = 0.5 * self._width / _HEIGHT
        return np.array([[-half, 0.0, -0.5], [half, 0.0, -0.5], [half, 0.0, 0.5], [-half, 0.0, 0.5]])

    @property
    def _width(self) -> int:
        left, _, right, _ = self._box
        return int(right - left) + 2 * _MARGIN

    def mesh(self) -> InMemoryMesh:
        """Return the plate as a glTF mesh of 1 m height; Meshcat has no texts."""
        left, top, _, bottom = self._box
        image = Image.new("RGB", (self._width, _HEIGHT), (255, 255, 255))
        ImageDraw.Draw(image).text(
            (_MARGIN - left, 0.5 * (_HEIGHT - (bottom - top)) - top),
            self.text,
            fill=(0, 0, 0),
            font=_font(),
            stroke_width=1,
        )
        # Eight colours are enough for smooth edges and keep the picture small.
        picture = io.BytesIO()
        image.quantize(8).save(picture, "PNG", optimize=True)
        paper = pbr_material((0.0, 0.0, 0.0, 1.0), roughness=1.0)  # emission has no shading
        paper |= {"emissiveTexture": {"index": 0}, "emissiveFactor": [1.0, 1.0, 1.0], "doubleSided": True}
        triangles, uv = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.uint16), np.array([[0, 1], [1, 1], [1, 0], [0, 0]])
        plate = Primitive(self.corners, np.tile([0.0, -1.0, 0.0], (4, 1)), triangles, paper, uv=uv)
        document = gltf_text([plate], images=[data_address(picture.getvalue(), "image/png")])
        return InMemoryMesh(mesh_file=MemoryFile(document, ".gltf", f"label {self.text}"))


@cache
def _font() -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(size=_FONT_SIZE)


def apart(labels: Iterable[Label], eye: Array, target: Array) -> list[Label]:
    """Return the labels that do not cover an earlier one in the picture of a camera, at most :data:`MOST`.

    Args:
        labels: the most important one first.
        eye: position of the camera in W [m].
        target: point that it looks at [m].
    """
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right = right / np.linalg.norm(right)
    axes = np.array([right, np.cross(right, forward), forward])
    kept: list[Label] = []
    taken = np.empty((0, 4))  # left, low, right, high of each kept label
    for label in labels:
        # Perspective: coordinates in the picture are those along its axes over the depth.
        x, y, depth = axes @ (label.X_WL @ (label.height * label.corners.T) - eye[:, None])
        if depth.min() <= 0.0:
            continue
        box = np.array([(x / depth).min(), (y / depth).min(), (x / depth).max(), (y / depth).max()])
        covers = (box[:2] < taken[:, 2:]) & (taken[:, :2] < box[2:])
        if covers.all(axis=1).any():
            continue
        kept.append(label)
        taken = np.vstack([taken, box])
        if len(kept) == MOST:
            break
    return kept
