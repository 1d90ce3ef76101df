"""Ray casting in a rigid scene: Embree finds the face, formulas give the exact distance.

Embree (Wald et al. 2014, "Embree: a kernel framework for efficient CPU ray tracing"; Apache 2.0; Python binding
embreex) works in single precision. It is only used to find the first face that a ray hits; the distance is computed
from the plane or the quadric of that face in double precision.
"""

from hashlib import blake2b
from typing import Any
from weakref import WeakValueDictionary

import numpy as np
from numpy.typing import NDArray

from mirdrake.core.compiled import compiled
from mirdrake.core.errors import MissingDependencyError
from mirdrake.sensors.ranging.faces import Array, Bools, Faces, Ints

_ROUNDS = 64  # largest number of enclosing triangles that a ray may graze
_STEP = 1e-4  # [m] beyond an enclosing triangle that was grazed
_EDGE_ON = 1e-9  # sine of the angle between a ray and a face


class RayScene:
    """Faces that rays are cast against.

    Args:
        faces: faces in the frame of the scene.

    Attributes:
        centre: middle of the box around all faces (3) [m].
        radius: radius of the sphere about it that contains all faces [m]; 0 without faces.

    Raises:
        MissingDependencyError: embreex is not installed.
    """

    def __init__(self, faces: Faces) -> None:
        points = faces.corners.reshape(-1, 3)
        self.centre = 0.5 * (points.min(axis=0) + points.max(axis=0)) if len(points) else np.zeros(3)
        # Relative to the centre, so that single precision has its resolution where the faces are.
        self._corners = (faces.corners - self.centre).astype(np.float32)  # from the centre of the scene
        outermost = np.einsum("nij,nij->ni", self._corners, self._corners).max(initial=0.0)
        # Slightly enlarged for roundings of single precision.
        self.radius = 1.000001 * float(np.sqrt(outermost))
        self.count = len(faces.corners)
        edge1 = faces.corners[:, 1] - faces.corners[:, 0]
        edge2 = faces.corners[:, 2] - faces.corners[:, 0]
        normal = np.cross(edge1, edge2)
        length = np.linalg.norm(normal, axis=1)
        # Degenerate triangles get a zero normal instead of NaN.
        self._normal = normal / np.where(length > 0.0, length, 1.0)[:, None]
        self._offset = np.einsum("ij,ij->i", self._normal, faces.corners[:, 0])
        self._curve, self._cap = faces.curve, faces.cap
        quadrics = faces.quadrics
        self._factor = np.array([quadric.factor for quadric in quadrics]).reshape(-1, 3, 3)
        self._middle = np.array([quadric.centre for quadric in quadrics]).reshape(-1, 3)
        self._axis = np.array([quadric.axis for quadric in quadrics]).reshape(-1, 3)
        self._low = np.array([quadric.low for quadric in quadrics])
        self._high = np.array([quadric.high for quadric in quadrics])
        self._embree = _make_embree(self._corners) if self.count else None

    def cast(self, origins: Array, directions: Array, far: float) -> tuple[Array, Ints]:
        """Return the first hits of rays.

        Args:
            origins: origins in the frame of the scene (n, 3) or (1, 3) [m].
            directions: unit vectors (n, 3).
            far: largest distance [m].

        Returns:
            distances (n) [m], inf where nothing is hit, and the faces that are hit (n), -1 for none. A ray that starts
            inside a round surface does not hit it.
        """
        count = len(directions)
        distance = np.full(count, np.inf)
        # Embree finds the first triangle; round shapes are enclosed by triangles and solved exactly afterwards.
        if self._embree is None or count == 0:
            return distance, np.full(count, -1)
        face = self._first(origins - self.centre, directions, far)
        # Most scenes have flat faces only, and none that a ray meets edge-on.
        planes = compiled(meet_planes, parts=())
        if not self._low.size and planes(self._normal, self._offset, origins, directions, face, distance):
            return distance, face
        rays = np.flatnonzero(face >= 0)
        hit = face[rays]
        # A ray may graze several round shapes one after the other; a few rounds suffice.
        for _ in range(_ROUNDS):
            if not rays.size:
                break
            o = origins if len(origins) == 1 else origins[rays]
            with np.errstate(divide="ignore", invalid="ignore"):
                along, missed = self._exact(o, directions.take(rays, axis=0), hit)
            distance[rays] = along
            if missed is None:
                break
            # Rays that pass between the enclosing triangle and the round surface continue behind that face.
            rays, passed = rays[missed], along[missed] + _STEP
            distance[rays], face[rays] = np.inf, -1
            o = origins if len(origins) == 1 else origins[rays]
            again = self._first(o + passed[:, None] * directions[rays] - self.centre, directions[rays], far)
            seen = again >= 0
            rays, hit = rays[seen], again[seen]
            face[rays] = hit
        return distance, face

    def _first(self, origins: Array, directions: Array, far: float) -> Ints:
        """Return the index of the first face that each ray hits (n); -1 without a hit.

        Args:
            origins: origins of the rays relative to the centre of the scene (n, 3) or (1, 3) [m].
            directions: unit vectors (n, 3).
            far: largest range [m].
        """
        start = np.empty(directions.shape, dtype=np.float32)
        start[:] = origins
        limit = np.full(len(directions), far, dtype=np.float32)
        assert self._embree is not None
        result: Ints = self._embree.run(start, directions.astype(np.float32), dists=limit, query="INTERSECT")
        return result

    def _exact(self, origins: Array, directions: Array, faces: Ints) -> tuple[Array, Bools | None]:
        """Return the distances (n) [m] to the exact surfaces of faces, and which rays only graze it (n), or None."""
        normal = self._normal.take(faces, axis=0)  # for rows much faster than an index
        towards, from_origin = _dot(normal, directions), _dot(normal, origins)
        distance = (self._offset[faces] - from_origin) / towards
        # Parallel to the plane the quotient is useless; such a ray meets the nearest corner.
        if np.abs(towards).min() < _EDGE_ON:
            edge_on = np.abs(towards) < _EDGE_ON
            distance[edge_on] = self._nearest_corner(origins, directions, faces, edge_on)
        if not self._low.size:
            return distance, None
        # Only faces around a round shape need the quadratic equation.
        curve = self._curve[faces]
        which = np.flatnonzero(curve >= 0)
        if not which.size:
            return distance, None
        o = origins if len(origins) == 1 else origins[which]
        near, inside = self._enter(o, directions.take(which, axis=0), curve[which])
        cap = self._cap[faces[which]]
        if cap.any():  # within the edge of an end the flat face counts
            ends = which[cap]
            o = origins if len(origins) == 1 else origins[ends]
            at_end = self._within(o + distance[ends, None] * directions[ends], curve[ends])
            near[cap] = np.where(at_end, distance[ends], near[cap])
            inside[cap] |= at_end
        if inside.all():
            distance[which] = near
            return distance, None
        distance[which[inside]] = near[inside]
        missed = np.zeros(len(faces), dtype=bool)
        missed[which] = ~inside
        return distance, missed

    def _enter(self, origins: Array, directions: Array, curve: Ints) -> tuple[Array, Bools]:
        """Return the distances (n) [m] at which rays enter quadrics, and whether that is between the ends."""
        factor, axis = self._factor.take(curve, axis=0), self._axis.take(curve, axis=0)
        fd = _products(factor, directions[:, None])
        if len(origins) == 1:  # few quadrics, many rays
            from_middle = origins - self._middle
            all_fo = _products(self._factor, from_middle[:, None])
            fo, c = all_fo.take(curve, axis=0), (_dot(all_fo, all_fo) - 1.0)[curve]
            start = _dot(self._axis, from_middle)[curve]
        else:
            from_middle = origins - self._middle.take(curve, axis=0)
            fo = _products(factor, from_middle[:, None])
            c, start = _dot(fo, fo) - 1.0, _dot(axis, from_middle)
        # |F (o + t d - m)|² = 1 is a quadratic a t² + 2 b t + c = 0; the smaller root is where the ray enters.
        a, b = _dot(fd, fd), _dot(fd, fo)
        near = (-b - np.sqrt(b * b - a * c)) / a  # nan: passes by
        along = start + near * _dot(axis, directions)
        inside: Bools = (near >= 0.0) & (along >= self._low[curve]) & (along <= self._high[curve])
        return near, inside

    def _within(self, points: Array, curve: Ints) -> Bools:
        """Return whether points (n, 3) are inside of quadrics extended beyond their ends."""
        local = _products(self._factor.take(curve, axis=0), (points - self._middle.take(curve, axis=0))[:, None])
        within: Bools = _dot(local, local) <= 1.0
        return within

    def _nearest_corner(self, origins: Array, directions: Array, faces: Ints, edge_on: Bools) -> Array:
        """Return the distances (n) [m] along rays to the nearest corners of faces that they meet edge-on."""
        o = origins if len(origins) == 1 else origins[edge_on]
        corners = self._corners[faces[edge_on]] + (self.centre - o)[:, None]
        nearest: Array = np.einsum("nij,nj->ni", corners, directions[edge_on]).min(axis=1)
        return nearest


_scenes: "WeakValueDictionary[bytes, RayScene]" = WeakValueDictionary()


def ray_scene(faces: Faces) -> RayScene:
    """Return the scene of faces; equal faces share one scene while it is in use.

    Building the same world or vehicle again therefore takes neither preparation nor memory.
    """
    # A hash of the contents is the key: models that are parsed again give new arrays with equal numbers.
    digest = blake2b(faces.corners.tobytes())
    digest.update(faces.curve.tobytes() + faces.cap.tobytes())
    for quadric in faces.quadrics:
        digest.update(
            np.array([*quadric.factor.flat, *quadric.centre, *quadric.axis, quadric.low, quadric.high]).tobytes()
        )
    scene = _scenes.get(digest.digest())
    if scene is None:
        scene = _scenes[digest.digest()] = RayScene(faces)
    return scene


def meet_planes(normal: Array, offset: Array, origins: Array, directions: Array, face: Ints, distance: Array) -> bool:
    """Write the distances of rays to the planes of the faces that they hit; return whether none is met edge-on.

    Args:
        normal: unit normals of all faces (m, 3).
        offset: distances of their planes from the origin along these (m) [m].
        origins: origins of the rays (n or 1, 3) [m].
        directions: unit vectors (n, 3).
        face: number of the face of each ray, -1 for none (n).
        distance: distances (n) [m]; written where there is a face.
    """
    for ray in range(len(directions)):
        number, start = face[ray], ray if len(origins) > 1 else 0
        if number < 0:
            continue
        x, y, z = normal[number, 0], normal[number, 1], normal[number, 2]
        towards = x * directions[ray, 0] + y * directions[ray, 1] + z * directions[ray, 2]
        if abs(towards) < _EDGE_ON:
            return False
        from_origin = x * origins[start, 0] + y * origins[start, 1] + z * origins[start, 2]
        distance[ray] = (offset[number] - from_origin) / towards
    return True


def _dot(a: Array, b: Array) -> Array:
    """Return the scalar products (n) of vectors (n, 3) with as many or with one (1, 3)."""
    product: Array = a @ b[0] if len(b) == 1 else _products(a, b)
    return product


def _products_by_einsum(a: Array, b: Array) -> Array:
    """Return the scalar products along the last axis."""
    products: Array = np.einsum("...j,...j->...", a, b)
    return products


_products = getattr(np, "vecdot", _products_by_einsum)  # NumPy 2 has it; half the time for a few hundred rays


def _make_embree(corners: NDArray[np.float32]) -> Any:
    try:
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene
    except ImportError:
        raise MissingDependencyError(
            "lasers, radars and sonars need embreex to cast rays: pip install embreex, or leave those sensors out"
        ) from None
    # robust: rays along shared edges do not slip through between two triangles.
    scene = EmbreeScene(robust=True)
    TriangleMesh(scene, np.ascontiguousarray(corners))
    return scene
