"""Shaded pictures of triangles in parallel projection with a depth buffer, without a graphics driver."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray
from PIL import Image
from trimesh.visual.material import PBRMaterial

from mirdrake.core.meshes import linear_to_srgb

Array = NDArray[np.float64]

_UPRIGHT = np.array(
    [[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]
)  # glTF has y up (glTF 2.0 specification, section 3.4)
_AT_ONCE = 1_500_000  # pixels processed together
_FINER = 2  # pixels drawn for one of the picture, in each direction


def draw_triangles(
    triangles: Array, colours: Array, *, light: Array, box: tuple[float, float, float, float], width: int
) -> Image.Image:
    """Return a picture with a transparent background.

    Args:
        triangles: corners (n, 3, 3) in the axes of the view: to the right, up, towards the viewer [m].
        colours: colours of the triangles (n, 3), 0 .. 1.
        light: direction to the light in the axes of the view (3); it always comes from the viewer's side.
        box: region of the view: left, low, right, high [m].
        width: width of the picture [pixel].
    """
    left, low, right, high = box
    columns = _FINER * width
    scale = columns / (right - left)
    rows = _FINER * max(1, round((high - low) * scale / _FINER))
    pixels = np.zeros((rows, columns, 4), dtype=np.uint8)
    if len(triangles):
        normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
        normals /= np.maximum(np.linalg.norm(normals, axis=1), 1e-12)[:, None]
        # Orientation of foreign meshes is unreliable; every normal is turned to the viewer.
        normals *= np.where(normals[:, 2] < 0.0, -1.0, 1.0)[:, None]
        towards = np.array([light[0], light[1], abs(light[2])])
        shade = 0.50 + 0.50 * np.clip(normals @ towards, 0.0, 1.0) + 0.12 * normals[:, 2]
        painted = 255.0 * np.clip(colours * shade[:, None] + 0.03, 0.0, 1.0)
        x, y = (triangles[:, :, 0] - left) * scale, (high - triangles[:, :, 1]) * scale
        _fill(pixels, x, y, triangles[:, :, 2], painted.astype(np.uint8))
    # Reduced by averaging: smooth edges, also in the opacity.
    return Image.fromarray(pixels).resize((width, rows // _FINER), Image.Resampling.BOX)


def read_triangles(path: Path, colour: Sequence[float]) -> list[tuple[Array, NDArray[np.int64], Array]]:
    """Return (points [m], faces, colours) of the parts of a mesh file, z up; none if it cannot be read.

    Args:
        path: the file.
        colour: red, green, blue of parts without a material, 0 .. 1.
    """
    try:
        scene = trimesh.load(path, force="scene")
        parts = scene.dump()
    except Exception:  # whatever a reader of foreign files raises; the hull is drawn instead
        return []
    upright = path.suffix.lower() in {".gltf", ".glb"}
    surfaces = []
    for part in parts:
        if not isinstance(part, trimesh.Trimesh) or not len(part.faces):
            continue
        points = np.asarray(part.vertices) @ (_UPRIGHT.T if upright else np.eye(3))
        surfaces.append((points, np.asarray(part.faces), _face_colours(part, colour)))
    return surfaces


def _face_colours(part: trimesh.Trimesh, colour: Sequence[float]) -> Array:
    """Return sRGB colours (n, 3) of the faces, 0 .. 1: of the texture, of the material, or the given one."""
    material = getattr(part.visual, "material", None)
    if material is None:
        return np.tile(colour, (len(part.faces), 1))
    texture = getattr(material, "baseColorTexture", None) or getattr(material, "image", None)
    if texture is not None and getattr(part.visual, "uv", None) is not None:
        of_vertices = np.asarray(part.visual.to_color().vertex_colors)[:, :3] / 255.0
        mean: Array = of_vertices[part.faces].mean(axis=1)
        return mean
    color = np.asarray(material.main_color)[:3] / 255.0
    # Factors of glTF are linear light; its textures are sRGB.
    color = linear_to_srgb(color) if isinstance(material, PBRMaterial) else color
    return np.tile(color, (len(part.faces), 1))


def _fill(pixels: NDArray[np.uint8], x: Array, y: Array, depth: Array, colours: NDArray[np.uint8]) -> None:
    """Fill triangles; the nearest triangle of a pixel is visible.

    Args:
        pixels: picture (rows, columns, 4), red, green, blue, opacity; changed.
        x: corners (n, 3), across [pixel].
        y: the same, downwards [pixel].
        depth: the same, towards the viewer.
        colours: colours of the triangles (n, 3).
    """
    rows, columns, _ = pixels.shape
    picture, nearest = pixels.reshape(-1, 4), np.full(rows * columns, -np.inf)
    # Twice the signed area; the barycentric coordinates below are divided by it.
    twice = (x[:, 1] - x[:, 0]) * (y[:, 2] - y[:, 0]) - (x[:, 2] - x[:, 0]) * (y[:, 1] - y[:, 0])
    # Pixels whose middles may be inside: those of the box around each triangle.
    first_x = np.clip(np.ceil(x.min(axis=1) - 0.5), 0, columns).astype(int)
    first_y = np.clip(np.ceil(y.min(axis=1) - 0.5), 0, rows).astype(int)
    wide = np.clip(np.floor(x.max(axis=1) - 0.5) + 1, 0, columns).astype(int) - first_x
    count = np.maximum(wide, 0) * np.maximum(
        np.clip(np.floor(y.max(axis=1) - 0.5) + 1, 0, rows).astype(int) - first_y, 0
    )
    # Triangles seen edge-on cover no pixel and would divide by zero.
    count[np.abs(twice) < 1e-9] = 0
    some = np.nonzero(count)[0]
    begin = 0
    total = np.cumsum(count[some])
    while begin < len(some):
        before = total[begin - 1] if begin else 0
        # At least one triangle at a time, even if it covers more pixels than the limit.
        end = max(begin + 1, int(np.searchsorted(total, before + _AT_ONCE)))
        part = some[begin:end]
        begin = end
        which = np.repeat(part, count[part])
        # Number of each pixel within the box of its triangle, which gives row and column.
        within = np.arange(len(which)) - np.repeat(np.cumsum(count[part]) - count[part], count[part])
        column, row = first_x[which] + within % wide[which], first_y[which] + within // wide[which]
        u, v = column + 0.5 - x[which, 0], row + 0.5 - y[which, 0]
        second = (u * (y[which, 2] - y[which, 0]) - v * (x[which, 2] - x[which, 0])) / twice[which]
        third = (v * (x[which, 1] - x[which, 0]) - u * (y[which, 1] - y[which, 0])) / twice[which]
        z = depth[which, 0] + second * (depth[which, 1] - depth[which, 0]) + third * (depth[which, 2] - depth[which, 0])
        pixel = row * columns + column
        # Tolerance at the edges, so that no gap remains between neighbouring triangles.
        seen = (second >= -1e-9) & (third >= -1e-9) & (second + third <= 1.0 + 1e-9) & (z > nearest[pixel])
        which, pixel, z = which[seen], pixel[seen], z[seen]
        order = np.argsort(z, kind="stable")  # the last one written stays
        pixel, which = pixel[order], which[order]
        nearest[pixel] = z[order]
        picture[pixel, :3] = colours[which]
        picture[pixel, 3] = 255
