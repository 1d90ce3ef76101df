"""Convex decomposition of meshes: Drake uses the convex hull of a mesh, so a concave one needs several parts."""

import json
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from io import BytesIO
from itertools import pairwise
from pathlib import Path
from time import monotonic
from typing import Any

import numpy as np
import shapely
import trimesh
from numpy.typing import NDArray
from pydrake.math import RigidTransform, RotationMatrix
from scipy.spatial import ConvexHull, QhullError

from mirdrake.core.digest import digest
from mirdrake.core.errors import RunError
from mirdrake.core.files import write_file
from mirdrake.core.paths import cache_folder, installed_version
from mirdrake.importing.meshes.cut import SECONDS, settings
from mirdrake.importing.meshes.write import weld

Array = NDArray[np.float64]

PART_LIMIT = 16
"""Convex parts of a collision shape."""

CORNER_LIMIT = 128
"""Corners of a convex part."""

_CONVEX = 0.02  # of the size, that a surface may lie within its hull
_PLATE = 1e-3  # [m], thickness that a flat mesh gets
_BOX_FILL, _CYLINDER_FILL = 0.97, 0.93  # a prism of 10 sides fills 0.935 of its cylinder, a box 0.64
_FACES = 2000  # for decomposing; more are simplified first
_BODIES = 100  # more are too slow to cut
_SAMPLES = 10_000  # triangles that are tested to find whether a mesh is convex
_CONCAVITY = 0.04  # CoACD's threshold
_ZIP = b"PK\x03\x04"  # a library may print before it
_GAIN = 0.9  # parts are worth it if they have less than this share of the hull's volume


CUT_TIME = 60.0
"""Time for cutting all meshes of a vehicle into convex parts [s]."""


class CutTime:
    """Time for the convex decomposition of meshes.

    Attributes:
        limit: limit at the beginning [s].
        left: what remains of it [s].
    """

    def __init__(self, limit: float = CUT_TIME) -> None:
        self.limit = self.left = limit


@dataclass(frozen=True)
class Hull:
    """A convex part: corners [m], triangles counter-clockwise from outside, volume [m³]."""

    points: Array
    faces: NDArray[np.int64]
    volume: float

    def depths(self, points: Array) -> Array:
        """Return the distances of points (n, 3) below its surface [m], negative outside."""
        a, b, c = (self.points[self.faces[:, k]] for k in range(3))
        normal = np.cross(b - a, c - a)
        length = np.linalg.norm(normal, axis=1)
        normal, a = normal[length > 0.0] / length[length > 0.0][:, None], a[length > 0.0]
        distances: Array = (np.einsum("ij,ij->i", normal, a) - points @ normal.T).min(axis=1)
        return distances


@dataclass(frozen=True)
class Parts:
    """Convex parts of a mesh.

    Attributes:
        hulls: the parts.
        whole: the hull of all.
        volume: volume of the mesh itself [m³]; None if it is not closed.
        missing: why it was not decomposed, or "".
    """

    hulls: tuple[Hull, ...]
    whole: Hull
    volume: float | None
    missing: str = ""


def make_hull(points: Array) -> Hull:
    """Return the convex hull of points [m]; points in a plane or on a line become a plate or rod of 1 mm."""
    # Qhull rejects flat and collinear points: they are thickened to 1 mm first.
    try:
        hull = ConvexHull(points)
    except (QhullError, ValueError):
        middle = points.mean(axis=0)
        # Principal axes of the points; those without extent get the thickness.
        # Fewer than three points have less than three of them, unless the full matrix adds the others.
        _, spread, axes = np.linalg.svd(points - middle, full_matrices=len(points) < 3)
        flat = np.pad(spread, (0, 3 - len(spread))) < 1e-6 * max(float(spread.max()), 1e-3)
        cloud = points
        for axis in axes[flat] if flat.any() else np.eye(3):
            cloud = np.concatenate((cloud - 0.5 * _PLATE * axis, cloud + 0.5 * _PLATE * axis))
        try:
            # QJ moves points by rounding errors, so that a plate is accepted.
            hull = ConvexHull(cloud, qhull_options="QJ")
        except (QhullError, ValueError):  # thinner than rounding allows: the box around it, at least 1 mm thick
            low, high = points.min(axis=0), points.max(axis=0)
            thin = high - low < _PLATE
            low, high = low - 0.5 * _PLATE * thin, high + 0.5 * _PLATE * thin
            cloud = np.array(
                [[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])]
            )
            hull = ConvexHull(cloud)
        points = cloud
    # Many corners make contact slow and change the shape little.
    corners = points[hull.vertices]
    if len(corners) > CORNER_LIMIT:
        corners = _fewer(corners)
        hull, points = ConvexHull(corners), corners
        corners = points[hull.vertices]
    # Sorted corners and faces give the same bytes for the same mesh.
    order = np.lexsort(corners.T[::-1])
    new_index = np.full(len(points), -1)
    new_index[hull.vertices[order]] = np.arange(len(order))
    faces = new_index[hull.simplices]
    corners = corners[order]
    a, b, c = (corners[faces[:, k]] for k in range(3))
    # Triangles of Qhull have no common orientation; `equations` has the outward normals.
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), hull.equations[:, :3]) < 0.0
    faces[inward] = faces[inward][:, ::-1]
    faces = np.array(sorted(_lowest_first(face) for face in faces.tolist()), dtype=np.int64)
    return Hull(corners, faces, float(hull.volume))


def _lowest_first(face: list[int]) -> list[int]:
    first = face.index(min(face))
    return face[first:] + face[:first]


def _fewer(corners: Array) -> Array:
    """Return the outermost corners in evenly distributed directions (Fibonacci lattice on the sphere)."""
    step = np.arange(CORNER_LIMIT) + 0.5
    height, turn = 1.0 - 2.0 * step / CORNER_LIMIT, np.pi * (1.0 + 5.0**0.5) * step
    radius = np.sqrt(1.0 - height**2)
    directions = np.column_stack((radius * np.cos(turn), radius * np.sin(turn), height))
    # Scaled to a cube, a flat shape keeps corners in all directions.
    scaled = (corners - corners.mean(axis=0)) / np.ptp(corners, axis=0)
    outermost = (directions @ scaled.T).argmax(axis=1)
    # The outermost corners along the axes keep the bounding box.
    axes = np.concatenate((corners.argmin(axis=0), corners.argmax(axis=0)))
    selected: Array = corners[np.unique(np.concatenate((outermost, axes)))]
    return selected


def split_convex(corners: Array, time: CutTime | None = None) -> Parts:
    """Return the convex parts of a mesh.

    Connected bodies are decomposed separately. Those that are convex (no triangle lies deeper in the hull than
    2 % of its size) become their hull; the others are cut by CoACD (Wei et al., ACM Trans. Graph. 41(4), 2022), if it
    is installed. More bodies than parts allowed are cut together.

    Args:
        corners: (n, 3, 3) [m].
        time: time for all meshes that are cut with it; :data:`CUT_TIME` for this one if left out.
    """
    time = time or CutTime()
    points, index = weld(corners.reshape(-1, 3))
    faces = index.reshape(-1, 3)
    # Welding makes thin triangles into lines, with two equal corners.
    distinct = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    faces = faces[distinct]
    whole = make_hull(points)
    volume = _volume(points, faces)
    if not len(faces) or is_convex(points, faces, whole):
        return Parts((whole,), whole, volume)
    # Separate bodies are decomposed one by one, the largest first, and those below 0.1 % of the size are dropped.
    bodies = _bodies(len(points), faces)
    groups = [faces[bodies == body] for body in range(bodies.max() + 1)]
    groups.sort(key=lambda group: -float(np.ptp(points[np.unique(group)], axis=0).max()))
    extent = float(np.ptp(points, axis=0).max())
    groups = [group for group in groups if np.ptp(points[np.unique(group)], axis=0).max() > 1e-3 * extent]
    if len(groups) > _BODIES:
        return Parts((whole,), whole, volume, f"{len(groups)} separate bodies are too many for convex decomposition")
    if len(groups) > PART_LIMIT:
        groups = [np.concatenate(groups)]
    # Each remaining body keeps at least one part of the limit.
    hulls: list[Hull] = []
    missing = ""
    for number, group in enumerate(groups):
        hull = make_hull(points[np.unique(group)])
        if is_convex(points, group, hull):
            hulls.append(hull)
            continue
        room = PART_LIMIT - len(hulls) - (len(groups) - number - 1)
        parts, fault = _cut(points, group, limit=max(room, 1), time=time)
        missing = missing or fault
        gain = 0 < len(parts) <= max(room, 1) and sum(part.volume for part in parts) < _GAIN * hull.volume
        hulls.extend(parts if gain else [hull])
    # Without a volume of the mesh, parts with more volume than the hull of all are not an improvement.
    if sum(hull.volume for hull in hulls) > whole.volume and len(hulls) > 1 and volume is None:
        hulls = [whole]
    return Parts(tuple(hulls), whole, volume, missing)


def is_convex(points: Array, faces: NDArray[np.int64], hull: Hull) -> bool:
    """Return whether the centres of all triangles are at most 2 % of the size below the surface of the hull."""
    size = float(np.linalg.norm(np.ptp(hull.points, axis=0)))
    # A sample of the triangles is enough for large meshes.
    corners = points[faces[:: 1 + len(faces) // _SAMPLES]]
    middles = np.concatenate((corners.mean(axis=1), *(0.5 * (corners[:, k] + corners[:, k - 1]) for k in range(3))))
    # Chunks of about five million distances limit the memory.
    return all(
        float(hull.depths(chunk).max()) <= _CONVEX * size
        for chunk in np.array_split(middles, max(1, len(middles) * len(hull.faces) // 5_000_000))
    )


def _volume(points: Array, faces: NDArray[np.int64]) -> float | None:
    """Return the volume of a closed surface [m³]; None if the surface is not closed."""
    # A closed surface with one orientation has each edge once in each direction.
    edges = np.concatenate((faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]))
    forth = np.sort(edges[:, 0] * len(points) + edges[:, 1])
    back = np.sort(edges[:, 1] * len(points) + edges[:, 0])
    if not np.array_equal(forth, back):
        return None
    # Divergence theorem: volumes of tetrahedra with a common corner, near the points to keep digits.
    a, b, c = (points[faces[:, k]] - points.mean(axis=0) for k in range(3))
    return abs(float(np.einsum("ij,ij->", a, np.cross(b, c)))) / 6.0


def _bodies(count: int, faces: NDArray[np.int64]) -> NDArray[Any]:
    label = trimesh.graph.connected_component_labels(np.concatenate((faces[:, :2], faces[:, 1:])), count)
    _, bodies = np.unique(label[faces[:, 0]], return_inverse=True)
    return np.asarray(bodies).ravel()


def _cut(points: Array, faces: NDArray[np.int64], *, limit: int, time: CutTime) -> tuple[list[Hull], str]:
    if find_spec("coacd") is None:
        return [], "coacd is not installed; install it for convex decomposition"
    # CoACD needs a closed surface and gets slow for many triangles.
    used, index = np.unique(faces, return_inverse=True)
    corners, triangles = _close(points[used], index.reshape(-1, 3))
    if _volume(corners, triangles) is None:
        return [], "its surface has gaps; convex decomposition needs a closed surface"
    if len(triangles) > _FACES:
        fewer = _simplified(corners, triangles)
        corners, triangles = fewer if _volume(*fewer) is not None else (corners, triangles)
    bodies = int(_bodies(len(corners), triangles).max()) + 1
    # The cache is keyed by everything that the result depends on; a decomposition takes seconds to minutes.
    how = {"limit": limit, "concavity": _CONCAVITY, "bodies": bodies}
    entry = _cache_entry(corners, triangles, how)
    parts = _load_parts(entry)
    if parts is None:
        # CoACD runs in a process of its own, because it cannot be interrupted and may crash on damaged surfaces.
        message = BytesIO()
        seconds = min(float(10 * SECONDS), time.left)
        np.savez(message, points=corners, faces=triangles, seconds=seconds + 1.0, **how)  # type: ignore[arg-type]
        content, missing = _run_cut(message.getvalue(), seconds, time)
        if missing:
            return [], missing
        parts = _parts_in(content)
        if parts is None:
            return [], "convex decomposition took too long; the surface may intersect itself"
        _store(entry, content)
    hulls = [make_hull(part) for part in parts if len(part) > 3]
    return [hull for hull in hulls if hull.volume > 0.0], ""


def _run_cut(message: bytes, seconds: float, time: CutTime) -> tuple[bytes, str]:
    """Return the output of the decomposition process, or the reason why there is none."""
    used_up = f"the time for convex decomposition, {time.limit:g} s, is used up"
    if seconds <= 0.0:
        return b"", used_up
    script = Path(__file__).with_name("cut.py")
    start = monotonic()
    try:
        # -P: modules beside the script, such as read.py, are not imported in place of others.
        done = subprocess.run([sys.executable, "-P", str(script)], input=message, capture_output=True, timeout=seconds)
    except subprocess.TimeoutExpired:
        late = f"convex decomposition took more than {10 * SECONDS} s"
        return b"", used_up if seconds < 10 * SECONDS else late
    finally:
        time.left -= monotonic() - start
    first = done.stdout.find(_ZIP)
    return (done.stdout[first:], "") if done.returncode == 0 and first >= 0 else (b"", "")


def _cache_entry(corners: Array, triangles: NDArray[np.int64], how: Mapping[str, float]) -> Path:
    """Return the cache file of a decomposition; its name is the hash of all inputs."""
    version = installed_version("coacd")
    text = json.dumps([1, version, how, settings(int(how["bodies"])), corners.shape, triangles.shape], sort_keys=True)
    # With a fixed byte order the name is the same on all machines.
    arrays = np.ascontiguousarray(corners, dtype="<f8"), np.ascontiguousarray(triangles, dtype="<i8")
    return cache_folder("convex") / f"{digest(text, *(array.tobytes() for array in arrays))}.npz"


def _load_parts(entry: Path) -> list[Array] | None:
    """Return the parts of a cache file; None if it is missing or damaged."""
    try:
        return _parts_in(entry.read_bytes())
    except OSError:
        return None


def _parts_in(content: bytes) -> list[Array] | None:
    try:
        with np.load(BytesIO(content)) as answer:  # a zip archive, with checksums
            parts = [np.asarray(answer[f"part_{number}"], dtype=float) for number in range(len(answer.files))]
    except Exception:  # numpy, zipfile and zlib have errors of many kinds
        return None
    sound = all(part.ndim == 2 and part.shape[1] == 3 and np.isfinite(part).all() for part in parts)
    return parts if parts and sound else None


def _store(entry: Path, content: bytes) -> None:
    """Write a cache entry whole or not at all; a cache that cannot be written is not used."""
    try:
        entry.parent.mkdir(parents=True, exist_ok=True)
        write_file(entry, content)
    except (OSError, RunError):
        pass


def _simplified(corners: Array, triangles: NDArray[np.int64]) -> tuple[Array, NDArray[np.int64]]:
    try:
        import fast_simplification
    except ImportError:
        return corners, triangles
    fewer, left = fast_simplification.simplify(corners, triangles, target_reduction=1.0 - _FACES / len(triangles))
    return np.asarray(fewer, dtype=float), np.asarray(left, dtype=np.int64)


def _close(points: Array, faces: NDArray[np.int64]) -> tuple[Array, NDArray[np.int64]]:
    """Fill each hole whose edge is one simple loop by a fan from its middle."""
    edges = np.concatenate((faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]])).tolist()
    present = {(a, b) for a, b in edges}
    rim = {b: a for a, b in present if (b, a) not in present}  # the way that the missing triangles would run
    middles: list[Array] = []
    fans: list[tuple[int, int, int]] = []
    while rim:
        # The smallest index, because a set has no order that results could rely on.
        start = min(rim)
        loop = [start]
        following = rim.pop(start)
        while following != start and following in rim:
            loop.append(following)
            following = rim.pop(following)
        if following == start:
            middle = len(points) + len(middles)
            middles.append(points[loop].mean(axis=0))
            fans += [(a, b, middle) for a, b in pairwise([*loop, start])]
    if not fans:
        return points, faces
    return np.concatenate((points, middles)), np.concatenate((faces, np.array(fans, dtype=np.int64)))


def fit_box(hull: Hull) -> tuple[tuple[float, float, float], RigidTransform] | None:
    """Return edges [m] and pose of a box that the hull fills to 97 %; None if there is none."""
    for R in _frames(hull):
        turned = hull.points @ R
        low, high = turned.min(axis=0), turned.max(axis=0)
        if hull.volume > 0.0 and hull.volume >= _BOX_FILL * float(np.prod(high - low)):
            x, y, z = (float(edge) for edge in high - low)
            return (x, y, z), RigidTransform(RotationMatrix(R), R @ (0.5 * (low + high)))
    return None


def fit_cylinder(hull: Hull) -> tuple[tuple[float, float], RigidTransform] | None:
    """Return radius, length [m] and pose of a cylinder (axis z) that the hull fills to 93 %; None if there is none."""
    for R in _frames(hull):
        turned = hull.points @ R
        for axis in (0, 1, 2):
            # The cyclic order of the other axes keeps the frame right-handed.
            across = np.roll(np.arange(3), -axis)[1:]
            circle = shapely.minimum_bounding_circle(shapely.MultiPoint(turned[:, across]))
            radius = float(shapely.minimum_bounding_radius(shapely.MultiPoint(turned[:, across])))
            low, high = float(turned[:, axis].min()), float(turned[:, axis].max())
            if radius > 0.0 and hull.volume > 0.0 and hull.volume >= _CYLINDER_FILL * np.pi * radius**2 * (high - low):
                middle = np.empty(3)
                middle[across] = circle.centroid.x, circle.centroid.y
                middle[axis] = 0.5 * (low + high)
                frame = R[:, [*across, axis]]
                return (radius, high - low), RigidTransform(RotationMatrix(frame), R @ middle)
    return None


def _frames(hull: Hull) -> Sequence[Array]:
    """Return candidate axes of a box or cylinder: those of the mesh, and the principal axes of the hull's surface."""
    a, b, c = (hull.points[hull.faces[:, k]] for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    middle = (a + b + c) / 3.0
    # Weights by area: the axes are those of the surface, however fine its triangles are.
    centred = middle - (area @ middle) / area.sum()
    _, axes = np.linalg.eigh((centred * area[:, None]).T @ centred)
    largest = np.cross(b - a, c - a)[area.argmax()]
    first = largest / np.linalg.norm(largest)
    along = (b - a)[area.argmax()]
    second = along / np.linalg.norm(along)
    faced = np.column_stack((first, second, np.cross(first, second)))
    # Eigenvectors may form a reflection; a rotation has the determinant 1.
    return [np.eye(3), faced, axes if np.linalg.det(axes) > 0.0 else axes[:, ::-1]]
