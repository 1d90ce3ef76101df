"""Files with grids of heights: NPY, CSV, PNG, OBJ."""

from pathlib import Path

import numpy as np
import scipy  # it imports its parts when they are first used
from numpy.typing import NDArray

from mirdrake.core.errors import ConfigError, first_line
from mirdrake.core.yaml_io import display_path

Array = NDArray[np.float64]

_SUFFIXES = (".npy", ".csv", ".png", ".obj")


def read_heights(
    path: Path, *, cell: float, lowest: float = 0.0, highest: float | None = None, place: str = ""
) -> tuple[Array, tuple[float, float]]:
    """Read a grid of heights.

    Args:
        path: NPY or CSV with rows along y, the first one at the smallest y; a grey PNG with 8 or 16 bits, whose top row
            has the largest y; or an OBJ mesh, which is sampled from above.
        cell: spacing of the grid [m]; an OBJ is sampled at it.
        lowest: height of black in a PNG; added to the heights of other files [m].
        highest: height of white in a PNG [m].
        place: prefix of messages, ``file:line: key``.

    Returns:
        Heights [m], rows along y, and the position of the first one relative to the origin of the file (2) [m].

    Raises:
        ConfigError: the file is missing, not readable, or has no grid of finite numbers.
    """
    suffix = path.suffix.lower()
    if suffix not in _SUFFIXES:
        raise ConfigError(
            f"'{path.name[:80]}' is not a file of heights; use one of {', '.join(_SUFFIXES)}", where=place
        )
    if not path.is_file():
        raise ConfigError(f"no such file: {display_path(path)}", where=place)
    origin = (0.0, 0.0)
    # Readers raise different errors for damaged files; all become one line with the place of the key.
    try:
        if suffix == ".npy":
            z = np.asarray(np.load(path, allow_pickle=False), dtype=float) + lowest
        elif suffix == ".csv":
            z = np.atleast_2d(np.loadtxt(path, delimiter=",")) + lowest
        elif suffix == ".png":
            z = _read_png(path, lowest, highest, place)
        else:
            z, origin = _read_obj(path, cell)
            z += lowest
    except (OSError, ValueError) as error:
        raise ConfigError(f"{display_path(path)}: cannot be read: {first_line(error)}", where=place) from None
    if z.ndim != 2 or min(z.shape) < 2 or not np.isfinite(z).all():
        raise ConfigError(
            f"{display_path(path)}: {z.shape} values; a grid has at least 2 x 2 finite heights", where=place
        )
    return z, origin


def _read_png(path: Path, lowest: float, highest: float | None, place: str) -> Array:
    from PIL import Image

    if highest is None:
        raise ConfigError(
            f"{display_path(path)}: a PNG has no heights in m; give highest, the height of white", where=place
        )
    with Image.open(path) as image:
        # Pillow opens 16-bit grey as I or I;16, depending on its version; `convert` would clip these to 8 bits.
        grey = np.asarray(image if image.mode in ("L", "I", "I;16") else image.convert("L"), dtype=float)
        white = 255.0 if image.mode not in ("I", "I;16") else 65535.0
    return lowest + (highest - lowest) * grey[::-1] / white


def _read_obj(path: Path, cell: float) -> tuple[Array, tuple[float, float]]:
    """Sample the upper side of a mesh, z up; outside of it the height is that of the nearest vertex."""
    vertices, faces = [], []
    for line in path.read_text(encoding="utf-8", errors="replace").splitlines():
        words = line.split()
        if words[:1] == ["v"]:
            vertices.append([float(word) for word in words[1:4]])
        elif words[:1] == ["f"]:
            corners = [int(word.split("/")[0]) for word in words[1:]]

            # Indices of OBJ begin at one; negative ones count back from the vertices read so far.
            corners = [corner - 1 if corner > 0 else len(vertices) + corner for corner in corners]
            # A polygon becomes a fan of triangles, which is right for convex ones.
            faces += [(corners[0], corners[i], corners[i + 1]) for i in range(1, len(corners) - 1)]
    if len(vertices) < 3 or not faces:
        raise ValueError("it has no faces")
    points, triangles = np.array(vertices), np.array(faces)
    if triangles.min() < 0 or triangles.max() >= len(points):
        raise ValueError("a face has a vertex that does not exist")
    low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    # The tolerance avoids an extra row where the size is a multiple of the cell up to rounding.
    count = np.maximum(np.ceil((high - low) / cell - 1e-9).astype(int) + 1, 2)
    # Minus infinity below everything: each triangle raises the nodes under it, so that the upper side remains.
    z = np.full((count[1], count[0]), -np.inf)
    for a, b, c in points[triangles]:
        _raise_over(z, a, b, c, low, cell)
    missing = ~np.isfinite(z)
    if missing.any():
        x, y = np.meshgrid(low[0] + cell * np.arange(count[0]), low[1] + cell * np.arange(count[1]))
        nearest = scipy.spatial.cKDTree(points[:, :2]).query(np.column_stack([x[missing], y[missing]]))[1]
        z[missing] = points[nearest, 2]
    return z, (float(low[0]), float(low[1]))


def _raise_over(z: Array, a: Array, b: Array, c: Array, low: Array, cell: float) -> None:
    """Raise the nodes of a grid that are below a triangle to it."""
    # Grid nodes in the bounding box of the triangle.
    first = np.maximum(np.ceil((np.minimum(np.minimum(a, b), c)[:2] - low) / cell - 1e-9).astype(int), 0)
    last = np.floor((np.maximum(np.maximum(a, b), c)[:2] - low) / cell + 1e-9).astype(int)
    if (last < first).any():
        return
    i, j = np.meshgrid(np.arange(first[0], last[0] + 1), np.arange(first[1], last[1] + 1))
    x, y = low[0] + cell * i - a[0], low[1] + cell * j - a[1]
    # Barycentric coordinates in the plan view; a vertical triangle has no area there and hides no node.
    (ux, uy, uz), (vx, vy, vz) = b - a, c - a
    determinant = ux * vy - uy * vx
    if abs(determinant) < 1e-12:
        return
    p, q = (x * vy - y * vx) / determinant, (y * ux - x * uy) / determinant
    # The tolerance includes nodes on shared edges, which would otherwise fall between two triangles.
    inside = (p >= -1e-9) & (q >= -1e-9) & (p + q <= 1.0 + 1e-9)
    rows, columns = j[inside], i[inside]
    z[rows, columns] = np.maximum(z[rows, columns], a[2] + p[inside] * uz + q[inside] * vz)
