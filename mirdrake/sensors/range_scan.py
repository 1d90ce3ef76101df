"""Ideal range scan: exact distances to the props of a world and to other vehicles.

The origin is the middle of the front bumper. The beams are in the ground plane; they meet the outlines, seen from
above, of the parts of props and other vehicles that the vehicle can touch: between `height` and its roof.

The distances are exact. Each segment is intersected only with the beams between its ends, which are a few thousand
intersections instead of some hundred thousand where there are many props.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.framework import BasicVector, Context
from shapely.geometry.polygon import orient

from mirdrake.actors.traffic import PLANAR, actor_signals
from mirdrake.controllers.behaviours.fan import BEAMS, END_ANGLE, REACH, START_ANGLE, beam_angles, range_signals
from mirdrake.controllers.behaviours.outline import ShapedVehicle, outline_of, volume_of
from mirdrake.core.checks import check_number
from mirdrake.core.errors import ConfigError
from mirdrake.core.leaf_system import LeafSystem
from mirdrake.core.signals import Signal, declare_vector_input, declare_vector_output
from mirdrake.core.vectors import STATE
from mirdrake.worlds import Actor, PlacedProp, World
from mirdrake.worlds.clearance import Volume

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Chains = tuple[Array, Array, Bools]

_GRAZING = 1e-12  # beams this close to the end of a segment hit it [rad]


def cut_beams(x: Array, y: Array, edge: Bools, angles: Array, reach: float, *, step: float = 0.0) -> Array:
    """Return the distances along beams to chains of segments.

    Args:
        x: corners in the frame of the scan (m) [m].
        y: corners (m) [m].
        edge: whether there is a segment from each corner to the next (m - 1).
        angles: angles of the beams, rising, within -pi to pi (n) [rad].
        reach: largest distance [m].
        step: distance between adjacent angles, if constant [rad]; it saves the search for the beams.
    """
    # A segment that is seen from bearing a to bearing b is hit by exactly the beams in between.
    bearing = np.arctan2(y, x)
    number = np.flatnonzero(edge)
    first, second = bearing[number], bearing[number + 1]
    low, high = np.minimum(first, second), np.maximum(first, second)
    behind = high - low > math.pi  # these are seen across the backward direction
    # Such a segment is split: one part up to +pi, a copy from -pi.
    if behind.any():
        number = np.concatenate((number, number[behind]))
        low, high = (
            np.concatenate((np.where(behind, high, low), np.full(behind.sum(), -math.pi))),
            np.concatenate((np.where(behind, math.pi, high), low[behind])),
        )
    if step:
        # Beams are evenly spaced: their indices follow from a division, which saves two binary searches per segment.
        start = np.maximum(np.ceil((low - angles[0] - _GRAZING) / step), 0.0).astype(int)
        stop = np.minimum(np.floor((high - angles[0] + _GRAZING) / step), angles.size - 1.0).astype(int) + 1
    else:
        start = np.searchsorted(angles, low - _GRAZING, side="left")
        stop = np.searchsorted(angles, high + _GRAZING, side="right")
    seen = np.flatnonzero(stop > start)
    result = np.full(angles.size, math.inf)
    if seen.size == 0:
        return result

    number, start = number[seen], start[seen]
    count = stop[seen] - start
    # Pairs (segment, beam) as flat arrays: for each segment the indices start ... stop - 1, one after the other.
    beam = np.arange(count.sum()) + np.repeat(start - np.cumsum(count) + count, count)
    number = np.repeat(number, count)
    cos, sin = np.cos(angles)[beam], np.sin(angles)[beam]
    px, py = x[number], y[number]
    dx, dy = x[number + 1] - px, y[number + 1] - py
    # Intersection of the ray t (cos, sin) with the line p + u d: t = (p x d) / (e x d), with the cross products in 2D.
    across = cos * dy - sin * dx
    with np.errstate(invalid="ignore", divide="ignore"):
        distance = (px * dy - py * dx) / across
    # Beam and segment are parallel: the quotient is not defined, the nearer end is the distance.
    end_on = np.abs(across) <= 1e-12 * (np.abs(dx) + np.abs(dy))
    if end_on.any():
        nearer = np.minimum(np.hypot(px, py), np.hypot(px + dx, py + dy))
        distance = np.where(end_on, nearer, distance)
    # Several segments may hit the same beam; plain indexing would keep the last one instead of the least.
    np.minimum.at(result, beam, np.maximum(distance, 0.0))
    result[result > reach] = math.inf
    return result


class _Shapes:
    """Rings of many polygons as chains of corners, with the circles around the polygons."""

    def __init__(self, polygons: Sequence[Any]):
        self.polygons = np.array(polygons, dtype=object)
        # Prepared geometries make the repeated point-in-polygon tests fast.
        shapely.prepare(self.polygons)
        rings = [_rings(polygon) for polygon in polygons]
        self.count = np.array([sum(map(len, part)) for part in rings], dtype=int)
        flat = [ring for part in rings for ring in part]
        self.x, self.y = np.vstack(flat).T.copy() if flat else np.empty((2, 0))
        # Rings are stored one after the other; there is no segment from the last
        # corner of a ring to the first of the next.
        self.edge = np.ones(self.x.size, dtype=bool)  # from each corner to the next
        self.edge[np.cumsum([len(ring) for ring in flat], dtype=int) - 1] = False
        bounds = shapely.bounds(self.polygons).reshape(-1, 4)
        # A circle around each polygon, for a quick test of what is in reach.
        self.centre = 0.5 * (bounds[:, :2] + bounds[:, 2:])
        self.radius = 0.5 * np.hypot(bounds[:, 2] - bounds[:, 0], bounds[:, 3] - bounds[:, 1])


def _rings(polygon: Any) -> list[Array]:
    """Return the closed rings of a polygon, each (m, 2) [m]; the polygon is on their left."""
    # Orientation is needed later: only sides that face the scanner are intersected.
    polygon = orient(polygon)
    return [shapely.get_coordinates(ring) for ring in (polygon.exterior, *polygon.interiors)]


def _polygons(geometry: Any) -> list[Any]:
    """Return the polygons of a footprint."""
    parts = shapely.get_parts(geometry, return_index=False)
    return [part for part in parts if shapely.get_dimensions(part) == 2 and not part.is_empty]


class RangeScan(LeafSystem):
    """Distances from the front bumper to props and other vehicles.

    Input ports:
        state (12) [m, rad, m/s, rad/s]: of the vehicle, :data:`~mirdrake.core.vectors.STATE`.
        prop_poses (3 k) [m, m, rad]: x, y, yaw of each of :attr:`movable`, in this order; only with movable props.
            Without connection, props have their initial poses, and vehicles are not detected. :class:`PropPoses`
            outputs the poses of the plant.
        actor_states (6 n): states of the actors, see :class:`mirdrake.actors.traffic.Traffic`; only with actors.

    Output ports:
        ranges (n) [m]: distance along each beam to the nearest outline, inf beyond the reach; all 0 when the origin
            is within an outline. It is computed only when it is read: a driver reads it once per update.

    A movable prop has the outline and the height with which it was placed, turned by its yaw, also after it was knocked
    over. Props that vehicles drive over are not detected.

    Args:
        world: world with the props.
        vehicle: vehicle that carries the scanner.
        beams: number of beams.
        start_angle: angle of the first [rad].
        end_angle: angle of the last [rad].
        reach: largest distance [m].
        height: height above which objects are detected [m]; default: the height that the vehicle rolls over, see
            :class:`mirdrake.worlds.clearance.Volume`.
        front: distance of the origin ahead of the vehicle frame B [m]; default: the front of its collision shapes.
        vehicles: other vehicles by name.
        actors: actors of the world.

    Attributes:
        movable: names of the movable props that are detected, then of the vehicles. Actors come after these.
        angles: angles of the beams (n) [rad].

    Raises:
        ConfigError: a number out of range.
    """

    def __init__(
        self,
        world: World,
        vehicle: ShapedVehicle,
        *,
        beams: int = BEAMS,
        start_angle: float = START_ANGLE,
        end_angle: float = END_ANGLE,
        reach: float = REACH,
        height: float | None = None,
        front: float | None = None,
        vehicles: Mapping[str, ShapedVehicle] | None = None,
        actors: Sequence[Actor] = (),
    ):
        super().__init__()
        outline, volume, owner = outline_of(vehicle), volume_of(vehicle), "RangeScan"
        check_number(owner, "beams", beams, at_least=1)
        check_number(owner, "start_angle", start_angle, unit="rad", at_least=-math.pi)
        check_number(owner, "end_angle", end_angle, unit="rad", at_least=start_angle, at_most=math.pi)
        # Two or more beams at one angle would give a step of zero, by which indices are divided.
        if start_angle == end_angle and beams > 1:
            raise ConfigError(
                f"{beams} beams need an end_angle above start_angle, got {end_angle:g} rad twice", where=owner
            )
        self.reach = check_number(owner, "reach", reach, unit="m", above=0.0)
        low = check_number(owner, "height", volume.low if height is None else height, unit="m")
        self.front = check_number(owner, "front", outline.front if front is None else front, unit="m")
        self.angles = beam_angles(beams, start_angle, end_angle)
        self._step = float(self.angles[1] - self.angles[0]) if beams > 1 else 0.0
        # With a view of at most half a turn ahead, everything behind the bumper can be skipped.
        self._ahead_only = start_angle >= -0.5 * math.pi and end_angle <= 0.5 * math.pi

        # Fixed outlines are merged in the world; movable ones are stored in the frames of their bodies.
        seen = [(prop, prop.between(low, volume.high)) for prop in world.props if not prop.prop.driven_over]
        fixed = [polygon for prop, areas in seen if prop.static for area in areas for polygon in _polygons(area)]
        self._fixed = _Shapes(_polygons(shapely.union_all(fixed)) if fixed else [])
        moving = [(prop.name, _planar_pose(prop.X_WP), _at_origin(prop, areas)) for prop, areas in seen
                  if not prop.static and areas]  # fmt: skip
        # Placed out of reach until the port is connected, so that vehicles are not detected without it.
        moving += [
            (name, _NOWHERE, _outline_between(other, low, volume.high)) for name, other in (vehicles or {}).items()
        ]
        self.movable = tuple(name for name, _, _ in moving)
        # Actors come last, as their poses are from another port.
        moving += [(actor.name, _NOWHERE, _area_between(actor.volume, low, volume.high)) for actor in actors]
        parts = [(index, part) for index, (_, _, area) in enumerate(moving) for part in _polygons(area)]
        # A footprint of several polygons has one pose: `_owner` is the index of the pose of each polygon.
        self._moving, self._owner = _Shapes([part for _, part in parts]), np.array([index for index, _ in parts], int)
        self._placed = np.array([pose for _, pose, _ in moving]).reshape(-1, 3)

        # The port of poses exists only if something can move; other worlds need no connection to it.
        self.state = declare_vector_input(self, "state", STATE)
        needs = [self.state.ticket()]
        self.prop_poses = None
        if self.movable:
            contents = [Signal(f"{name}.{key}", unit) for name in self.movable for key, unit in _PLANAR]
            self.prop_poses = declare_vector_input(self, "prop_poses", contents)
            needs.append(self.prop_poses.ticket())
        self.actor_states = None
        if actors:
            self.actor_states = declare_vector_input(
                self, "actor_states", actor_signals([actor.name for actor in actors], PLANAR)
            )
            needs.append(self.actor_states.ticket())
        contents = list(range_signals(beams))
        self.ranges = declare_vector_output(self, "ranges", contents, self._calc, prerequisites=needs)

    def _calc(self, context: Context, output: BasicVector) -> None:
        x, y, _, _, _, yaw, *_ = self.state.Eval(context).tolist()
        poses = self._placed
        if self.prop_poses is not None and self.prop_poses.HasValue(context):
            poses = self.prop_poses.Eval(context).reshape(-1, 3)
        if self.actor_states is not None:
            actors = self.actor_states.Eval(context).reshape(-1, len(PLANAR))[:, :3]
            # Without connected prop poses, only the placed part before the actors is kept.
            poses = np.vstack((poses[: len(self.movable)], actors))
        output.SetFromVector(self.look(x + self.front * math.cos(yaw), y + self.front * math.sin(yaw), yaw, poses))

    def look(self, x: float, y: float, yaw: float, poses: Array | None = None) -> Array:
        """Return the scan from a pose.

        Args:
            x: origin of the scan in the world [m].
            y: origin [m].
            yaw: direction of the beam of angle 0 [rad].
            poses: x, y, yaw of :attr:`movable` (k, 3) [m, rad]; default: where props were placed, and no vehicles.

        Returns:
            Distances (n) [m].
        """
        (px, py, edge), inside = self._near_fixed(x, y, yaw)
        if self._owner.size and not inside:
            more, inside = self._near_moving(x, y, yaw, self._placed if poses is None else poses)
            # Chains may be concatenated, because each of them ends without a segment to the next corner.
            px, py, edge = (np.concatenate(both) for both in zip((px, py, edge), more, strict=True))
        if inside:
            return np.zeros(self.angles.size)
        # Polygons are on the left of their rings, so a side that faces the scanner runs clockwise seen from it.
        edge = edge[:-1] & (px[:-1] * py[1:] < py[:-1] * px[1:])  # the others are on the far sides of their polygons
        return cut_beams(px, py, edge, self.angles, self.reach, step=self._step)

    def _in_view(self, x: Array, y: Array, radius: Array) -> tuple[Any, Any]:
        """Return which circles in the frame of the scan may be hit by a beam, and which contain its origin (m)."""
        square = x * x + y * y
        seen = square <= (self.reach + radius) ** 2
        # A circle that reaches the half plane x >= 0 may still be hit.
        if self._ahead_only:
            seen &= x >= -radius
        return seen, square <= radius * radius

    def _near_fixed(self, x: float, y: float, yaw: float) -> tuple[Chains, bool]:
        """Return the static footprints in the frame of the scan, and whether one contains its origin."""
        shapes, cos, sin = self._fixed, math.cos(yaw), math.sin(yaw)
        # Circles are tested first, so that only corners of polygons in reach are transformed.
        dx, dy = shapes.centre[:, 0] - x, shapes.centre[:, 1] - y
        seen, around = self._in_view(cos * dx + sin * dy, cos * dy - sin * dx, shapes.radius)
        inside = bool(around.any() and shapely.intersects_xy(shapes.polygons[around], x, y).any())
        which = np.flatnonzero(np.repeat(seen, shapes.count))
        dx, dy = shapes.x[which] - x, shapes.y[which] - y
        return (cos * dx + sin * dy, cos * dy - sin * dx, shapes.edge[which]), inside

    def _near_moving(self, x: float, y: float, yaw: float, poses: Array) -> tuple[Chains, bool]:
        """Return the movable footprints, likewise; their corners are stored in the frames of their props."""
        shapes = self._moving
        dx, dy = poses[:, 0] - x, poses[:, 1] - y
        cos, sin = math.cos(yaw), math.sin(yaw)
        turn = poses[:, 2] - yaw
        # Poses of the props in the frame of the scan, one for each polygon.
        px, py, c, s = np.array((cos * dx + sin * dy, cos * dy - sin * dx, np.cos(turn), np.sin(turn)))[:, self._owner]
        cx, cy = shapes.centre.T
        seen, around = self._in_view(px + c * cx - s * cy, py + s * cx + c * cy, shapes.radius)
        inside = False
        if around.any():
            ax, ay, ac, asin = px[around], py[around], c[around], s[around]
            # Inverse transformation R^T (0 - p): the polygons stay in their own frames, where they are prepared.
            own = -ac * ax - asin * ay, asin * ax - ac * ay  # the scan's origin in the frames of these props
            inside = bool(shapely.intersects_xy(shapes.polygons[around], *own).any())
        which = np.flatnonzero(np.repeat(seen, shapes.count))
        px, py, c, s = np.repeat(np.array((px, py, c, s))[:, seen], shapes.count[seen], axis=1)
        lx, ly = shapes.x[which], shapes.y[which]
        return (px + c * lx - s * ly, py + s * lx + c * ly, shapes.edge[which]), inside


_PLANAR = (("x", "m"), ("y", "m"), ("yaw", "rad"))
_NOWHERE = (1e9, 1e9, 0.0)  # [m], [rad] a pose that is out of reach


def _planar_pose(X_WP: RigidTransform) -> tuple[float, float, float]:
    """Return x, y [m] and yaw [rad] of a pose."""
    x, y, _ = X_WP.translation().tolist()
    return x, y, float(RollPitchYaw(X_WP.rotation()).yaw_angle())


def _at_origin(prop: PlacedProp, areas: Sequence[Any]) -> Any:
    """Return the union of the areas that a prop covers, in its frame P."""
    x, y, yaw = _planar_pose(prop.X_WP)
    cos, sin = math.cos(yaw), math.sin(yaw)

    def move(points: Array) -> Array:
        dx, dy = points[:, 0] - x, points[:, 1] - y
        return np.column_stack((cos * dx + sin * dy, cos * dy - sin * dx))

    return shapely.transform(shapely.union_all(areas), move)


def _outline_between(vehicle: ShapedVehicle, low: float, high: float) -> Any:
    """Return the area that a vehicle covers between two heights, in its frame B."""
    return _area_between(volume_of(vehicle), low, high)


def _area_between(volume: Volume, low: float, high: float) -> Any:
    """Return the area that a volume covers between two heights, in its frame."""
    slabs = [slab for slab in volume.slabs if slab.low < high and slab.high > low]
    return shapely.union_all([shapely.Polygon(slab.outline) for slab in slabs])


class PropPoses(LeafSystem):
    """Poses of movable props and of vehicles in the plane, from the plant.

    Input ports:
        body_poses: the plant's output of that name.
    Output ports:
        prop_poses (3 k) [m, m, rad]: x, y, yaw of each, for :class:`RangeScan`.

    Args:
        bodies: index of each one's body, in the order of :attr:`RangeScan.movable`; its frame is P of the prop, or B of
            the vehicle.
        names: names of the props and vehicles.
    """

    def __init__(self, bodies: Sequence[Any], names: Sequence[str]):
        super().__init__()
        self._bodies = [int(body) for body in bodies]
        self.body_poses = self.DeclareAbstractInputPort("body_poses", AbstractValue.Make([RigidTransform()]))
        contents = [Signal(f"{name}.{key}", unit) for name in names for key, unit in _PLANAR]
        self.prop_poses = declare_vector_output(
            self, "prop_poses", contents, self._calc, prerequisites=[self.body_poses.ticket()]
        )

    def _calc(self, context: Context, output: BasicVector) -> None:
        poses = self.body_poses.Eval(context)
        output.SetFromVector([value for body in self._bodies for value in _planar_pose(poses[body])])
