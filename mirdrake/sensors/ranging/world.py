"""Scene for range sensors: the visible surfaces of a plant, and the ground.

Rays meet the geometry with the perception role, meshes triangle by triangle. The geometry fixed in the world is one
scene, which is built once and shared by all sensors. Every body that can move has a small scene, and rays are
transformed into its frame. The ground is that of the tyres: the infinite plane z = 0, or the relief of the world. On a
relief Embree finds a ray's hit on the visual mesh, which is then moved to the height function itself; a relief ends
with its mesh. Paint, and the few millimetres by which the ground beside a road is lower, give no returns.
"""

from collections.abc import Container
from dataclasses import dataclass
from functools import cached_property
from math import hypot
from typing import TYPE_CHECKING
from weakref import WeakKeyDictionary

import numpy as np
from pydrake.geometry import FrameId, Role, SceneGraph, SceneGraphInspector
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex, ModelInstanceIndex, RigidBody

from mirdrake.core.compiled import compiled
from mirdrake.ground import FLAT, Terrain
from mirdrake.sensors.ranging import motion
from mirdrake.sensors.ranging.faces import Array, Faces, Ints, joined
from mirdrake.sensors.ranging.motion import BodyState, planar_state, poses_at, write_pose
from mirdrake.sensors.ranging.scene import RayScene, ray_scene

if TYPE_CHECKING:
    from mirdrake.plant.actors import ActorsInScene
    from mirdrake.plant.plant import PlantParts

GROUND = 0
"""Number of the ground among the objects that rays meet."""

NOTHING = -1
"""Object of a ray that hits nothing."""

States = tuple[BodyState | None, BodyState]
"""States of a body one period ago, if known, and now."""

_SCENERY = "scenery/"  # names of the ground, the roads and their paint
_MESHES = "scenery/world/scenery."  # meshes without collision geometry, which give no returns
_MESH_ERROR = 1.0  # [m] by which a hit on the mesh of a relief may be off at a grazing angle
_MARGIN = 1e-3  # [m] around a body, for roundings
_STILL = 2e-4  # [m] that the surface of a body at rest may move in a period


@dataclass(frozen=True)
class Beams:
    """Rays in the frame S of a sensor, by columns; those of one column leave at the same time.

    Args:
        directions: unit vectors (columns, rows, 3).
        times: times of the columns after the sample is complete, 0 or negative (columns) [s].
    """

    directions: Array
    times: Array


@dataclass(frozen=True)
class Hits:
    """First hits of rays.

    Attributes:
        distance: (columns, rows) [m]; inf: nothing.
        object_index: number of the object (columns, rows), :data:`GROUND` or :data:`NOTHING`. All parts of a vehicle
            are one object, and so are those of a prop.
        body: index of the body (columns, rows), 0 for the world, -1 for nothing.
    """

    distance: Array
    object_index: Ints
    body: Ints


@dataclass(frozen=True)
class _Mover:
    """A body that can move, with its own scene."""

    body: int
    object_index: int
    scene: RayScene

    @property
    def size(self) -> float:
        """Largest distance of its surface from the origin of its frame [m]."""
        return hypot(*self.scene.centre.tolist()) + self.scene.radius


class RayWorld:
    """The visible surfaces of a finalised plant.

    Args:
        plant: the plant.
        scene_graph: its scene graph.
        ground: whether there is a ground.
        terrain: its height.
        actors: actors of the world; their numbers as bodies follow those of the plant.
        lead: time by which positions of the plant lead its velocities [s].

    Attributes:
        lead: as given.
        objects: names of the objects that rays can meet, by their numbers; the first is the ground.
        bodies: number of bodies of the plant.
        actors: number of actors.

    Raises:
        MissingDependencyError: embreex is not installed.
    """

    def __init__(
        self,
        plant: MultibodyPlant,
        scene_graph: SceneGraph,
        *,
        ground: bool = True,
        terrain: Terrain = FLAT,
        actors: "ActorsInScene | None" = None,
        lead: float = 0.0,
    ) -> None:
        self.objects, self.lead = ["ground"], lead
        self._ground, self._terrain, self._actors = ground, terrain, actors
        inspector, context = scene_graph.model_inspector(), plant.CreateDefaultContext()
        fixed: list[Faces] = []
        owners: list[Ints] = []
        # Bodies welded to the world never move and share one scene with it: one ray cast instead of one per prop.
        welded = plant.GetBodiesWeldedTo(plant.world_body())
        for body in welded:
            X_WB = plant.EvalBodyPoseInWorld(context, body)
            for name, faces in _looks(plant, inspector, body):
                fixed.append(faces.moved(X_WB))
                owners.append(np.full(len(faces.corners), self._number(name)))
        self._fixed = ray_scene(joined(fixed))
        # Index -1 of a ray that hits no face selects the last entry, which is NOTHING.
        self._fixed_object = np.concatenate([*owners, [NOTHING]])  # the last one for "no face"
        self._fixed_body = np.where(self._fixed_object == NOTHING, NOTHING, 0)
        self._relief: RayScene | None = None
        if ground and not terrain.flat:
            self._relief = ray_scene(joined(_ground_faces(plant, inspector)))
        self._movers: list[_Mover] = []
        # Sorted, so that the numbers of objects do not depend on the order of a set.
        for index in sorted(set(range(plant.num_bodies())) - {int(body.index()) for body in welded}):
            body = plant.get_body(BodyIndex(index))
            looks = [faces for _, faces in _looks(plant, inspector, body)]
            if looks:
                number = self._number(plant.GetModelInstanceName(body.model_instance()))
                self._movers.append(_Mover(index, number, ray_scene(joined(looks))))
        frames = {} if actors is None else actors.frames
        self.bodies, self.actors = plant.num_bodies(), len(frames)
        for index, (name, frame) in enumerate(frames.items(), start=self.bodies):
            faces_ = [faces for _, faces in _looks_of(inspector, frame)]
            self._movers.append(_Mover(index, self._number(f"actor/{name}"), ray_scene(joined(faces_))))

    def actor_states(self, rows: Array) -> list[BodyState]:
        """Return the states of the actors on the ground, from their motion in the plane (n, 6) [m, rad, m/s, rad/s]."""
        states = [planar_state(row) for row in rows]
        if self._actors is None or self._actors.terrain.flat:
            return states
        poses, slopes = self._actors.poses(rows), self._actors.terrain.slopes(rows[:, 0], rows[:, 1])
        result = []
        for state, frame, (_, along_x, along_y) in zip(states, self._actors.frames.values(), slopes, strict=True):
            X_WA, rising = poses.value(frame), along_x * state.v[0] + along_y * state.v[1]
            v = np.array([state.v[0], state.v[1], rising])
            result.append(BodyState(X_WA.rotation().matrix(), X_WA.translation(), state.w, v))
        return result

    def _number(self, name: str) -> int:
        if name not in self.objects:
            self.objects.append(name)
        return self.objects.index(name)

    def movers(self, hidden: Container[int] = ()) -> list[int]:
        """Return the indices of the bodies that can move and be seen, without the hidden ones."""
        return [mover.body for mover in self._movers if mover.body not in hidden]

    def cast(
        self,
        beams: Beams,
        X_BS: RigidTransform,
        carrier: States,
        movers: dict[int, States],
        *,
        period: float,
        far: float,
        ground: bool = True,
    ) -> Hits:
        """Return the first hits of the beams of a sensor.

        Args:
            beams: beams in the frame S of the sensor.
            X_BS: pose of S in the body B that carries it.
            carrier: state of B one period ago, if known, and now.
            movers: states of the visible bodies, by their indices.
            period: time between the two states [s].
            far: largest distance [m].
            ground: whether the ground gives returns.
        """
        columns, rows = beams.directions.shape[:2]
        local, times = beams.directions, beams.times
        seen = [mover for mover in self._movers if mover.body in movers]
        moving = not _rests(*carrier, period, far) or not all(
            _rests(*movers[mover.body], period, mover.size) for mover in seen
        )
        # If nothing moves noticeably during a turn, one pose serves all columns and none is interpolated.
        if times.any() and moving:
            R_WB, p_WB = poses_at(times, *carrier, period)
        else:  # one pose for all columns
            local, times = local.reshape(1, -1, 3), np.zeros(1)
            R_WB, p_WB = carrier[1].R[None], carrier[1].p[None]
        R_WS = R_WB @ X_BS.rotation().matrix()
        origins = p_WB + R_WB @ X_BS.translation()
        # Directions are rows: R d becomes d R^T.
        directions = np.matmul(local, R_WS.transpose(0, 2, 1))
        rays = _Rays(origins, directions.reshape(-1, 3), times, period, far)

        distance, face = self._fixed.cast(rays.starts(), rays.directions, far)
        hits = Hits(distance, self._fixed_object[face], self._fixed_body[face])
        if ground and self._relief is not None:
            _meet_relief(self._relief, self._terrain, rays, hits)
        elif ground and self._ground:
            _meet_ground(rays, hits)
        # Largest speed of the sensor: of the carrier's origin plus the lever arm times its turn rate.
        reach = _travel(*carrier) + _spin(*carrier) * hypot(*X_BS.translation())
        for mover in seen:
            # After the ground, as each mover only overwrites hits that are farther away.
            _meet(mover, movers[mover.body], reach, rays, hits)
        shape = (columns, rows)
        return Hits(hits.distance.reshape(shape), hits.object_index.reshape(shape), hits.body.reshape(shape))


@dataclass(frozen=True)
class _Rays:
    """Rays in the world, by columns that leave at the same time.

    Attributes:
        origins: origins of the columns (c, 3) [m].
        directions: column by column (n, 3).
        times: times of the columns (c) [s].
        period: time between the two states of all bodies [s].
        far: largest distance [m].
    """

    origins: Array
    directions: Array
    times: Array
    period: float
    far: float

    @cached_property
    def scratch(self) -> tuple[Ints, Array, Array]:
        """Arrays for numbers, origins and directions of as many rays, which the bodies use one after the other."""
        count = len(self.directions)
        return np.empty(count, np.int64), np.empty((count, 3)), np.empty((count, 3))

    def column(self, rays: Ints) -> Ints:
        """Return the column of each ray."""
        return rays // (len(self.directions) // len(self.times))

    def starts(self) -> Array:
        """Return the origin of each ray (n, 3), or (1, 3) if all have the same [m]."""
        if len(self.origins) == 1:
            return self.origins
        return np.repeat(self.origins, len(self.directions) // len(self.times), axis=0)


def _meet(mover: _Mover, states: States, reach: float, rays: _Rays, hits: Hits) -> None:
    """Update `hits` where a moving body is nearer.

    Args:
        mover: the body.
        states: states of the body.
        reach: largest speed of the origin of the rays [m/s].
        rays: the rays.
        hits: hits of the rays (n); updated.
    """
    # Only rays that can meet the sphere around the body, anywhere on the paths of both during the turn, are cast.
    now, centre = states[1], mover.scene.centre
    middle = now.p + now.R @ centre - rays.origins[-1]
    speed = _travel(*states) + _spin(*states) * hypot(*centre.tolist())
    # Times are negative, the first is the earliest; the factor allows for speeds that exceed both samples in between.
    radius = mover.scene.radius - 1.2 * (reach + speed) * float(rays.times[0]) + _MARGIN
    away = hypot(*middle.tolist())
    if away - radius > rays.far:
        return
    # A ray meets a sphere if the angle to its centre is less than asin(radius / distance); none from within it.
    axis, least = middle, -np.inf
    if away > radius:
        axis, least = middle / away, float(np.sqrt(1.0 - (radius / away) ** 2))
    # Only the columns of the rays that may hit are interpolated.
    before = states[0] or now
    rests = _rests(*states, rays.period, mover.size)
    seen, starts, directions = rays.scratch
    count = compiled(aim, parts=motion.PARTS)(
        rays.directions, rays.origins, rays.times, axis, least, now.numbers(), before.numbers(),
        states[0] is not None, rests, rays.period, seen, starts, directions,
    )  # fmt: skip
    if count == 0:
        return
    seen, directions = seen[:count], directions[:count]
    starts = starts[: 1 if len(rays.times) == 1 else count]  # all rays of one column have the same
    distance, _ = mover.scene.cast(starts, directions, rays.far)
    nearer = distance < hits.distance[seen]
    seen = seen[nearer]
    hits.distance[seen], hits.object_index[seen], hits.body[seen] = distance[nearer], mover.object_index, mover.body


def aim(
    directions: Array,
    origins: Array,
    times: Array,
    axis: Array,
    least: float,
    now: Array,
    before: Array,
    is_known: bool,
    rests: bool,
    period: float,
    seen: Ints,
    starts: Array,
    local: Array,
) -> int:
    """Write the rays that can meet a body, in its frame at the time of their column, and return their number.

    Args:
        directions: unit vectors of the rays in the world, column by column (n, 3).
        origins: origins of the columns, or of all of them (c or 1, 3) [m].
        times: times of the columns after the sample, 0 or negative (c) [s].
        axis: direction to the body in the world (3).
        least: smallest scalar product of such a ray with it.
        now: present state of the body, as the numbers of a :class:`mirdrake.sensors.ranging.motion.BodyState`.
        before: state one period ago.
        is_known: whether that is known.
        rests: whether the body hardly moves: it then has its present pose at all times.
        period: time between the two states [s].
        seen: numbers of the rays (n); written.
        starts: their origins in the frame of the body (n, 3) [m]; written.
        local: their directions in it (n, 3); written.
    """
    count, rows, pose, start = 0, len(directions) // len(times), now[:12].copy(), np.empty(3)
    for column in range(len(times)):
        is_posed = False
        for ray in range(column * rows, (column + 1) * rows):
            x, y, z = directions[ray, 0], directions[ray, 1], directions[ray, 2]
            if x * axis[0] + y * axis[1] + z * axis[2] < least:
                continue
            if not is_posed:
                is_posed = True
                if not rests:
                    write_pose(times[column], now, before, is_known, period, pose)
                origin = column if len(origins) > 1 else 0
                a, b, c = origins[origin, 0] - pose[9], origins[origin, 1] - pose[10], origins[origin, 2] - pose[11]
                # Into the frame of the body by R^T: its scene stays fixed there.
                for k in range(3):
                    start[k] = pose[k] * a + pose[3 + k] * b + pose[6 + k] * c
            seen[count] = ray
            for k in range(3):
                starts[count, k] = start[k]
                local[count, k] = pose[k] * x + pose[3 + k] * y + pose[6 + k] * z
            count += 1
    return count


def _meet_ground(rays: _Rays, hits: Hits) -> None:
    """Update `hits` where the plane z = 0 is nearer."""
    down = rays.directions[:, 2]
    # A ray that does not descend cannot meet the plane z = 0.
    seen = np.flatnonzero(down < 0.0)
    if not seen.size:
        return
    height = rays.origins[0, 2] if len(rays.origins) == 1 else rays.origins[rays.column(seen), 2]
    along = height / -down[seen]
    nearer = (along < hits.distance[seen]) & (along >= 0.0) & (along <= rays.far)
    seen = seen[nearer]
    hits.distance[seen], hits.object_index[seen], hits.body[seen] = along[nearer], GROUND, 0


def _meet_relief(mesh: RayScene, terrain: Terrain, rays: _Rays, hits: Hits) -> None:
    """Update `hits` where uneven ground is nearer."""
    # The mesh is only approximate; hits slightly beyond the limit may be within it on the exact surface.
    distance, _ = mesh.cast(rays.starts(), rays.directions, rays.far + _MESH_ERROR)
    seen = np.flatnonzero(distance < hits.distance + _MESH_ERROR)
    if not seen.size:
        return
    starts = rays.starts()
    starts = np.broadcast_to(starts, rays.directions.shape)[seen] if len(starts) == 1 else starts[seen]
    exact = distance[seen]
    terrain.refine_hits(np.ascontiguousarray(starts), rays.directions[seen], exact)
    nearer = (exact < hits.distance[seen]) & (exact <= rays.far)
    seen = seen[nearer]
    hits.distance[seen], hits.object_index[seen], hits.body[seen] = exact[nearer], GROUND, 0


def _travel(before: BodyState | None, now: BodyState) -> float:
    """Return the larger of both speeds [m/s]."""
    return max((before or now).speed, now.speed)


def _spin(before: BodyState | None, now: BodyState) -> float:
    """Return the larger of both turn rates [rad/s]."""
    return max((before or now).spin, now.spin)


def _rests(before: BodyState | None, now: BodyState, period: float, size: float) -> bool:
    """Return whether points within `size` [m] of a body's origin hardly move between two samples."""
    return period * (_travel(before, now) + size * _spin(before, now)) < _STILL


def _ground_faces(plant: MultibodyPlant, inspector: SceneGraphInspector) -> list[Faces]:
    """Return the faces of the ground, the roads and their paint in the world."""
    from mirdrake.sensors.ranging.shapes import faces_of

    frame = plant.GetBodyFrameIdOrThrow(plant.world_body().index())
    names = {geometry: inspector.GetName(geometry).rpartition("::")[2] for geometry in inspector.GetGeometries(frame)}
    ground = [key for key, name in names.items() if name.startswith(_SCENERY) and not name.startswith(_MESHES)]
    seen = [key for key in ground if inspector.GetPerceptionProperties(key) is not None]
    looks = [(faces_of(inspector, key), inspector.GetPoseInFrame(key)) for key in seen]
    return [faces.moved(X_WG) for faces, X_WG in looks if faces is not None]


def _looks(plant: MultibodyPlant, inspector: SceneGraphInspector, body: RigidBody) -> list[tuple[str, Faces]]:
    """Return the object of each visible geometry of a body, and its faces in the body's frame."""
    return _looks_of(inspector, plant.GetBodyFrameIdOrThrow(body.index()))


def _looks_of(inspector: SceneGraphInspector, frame: FrameId) -> list[tuple[str, Faces]]:
    """Return the object of each visible geometry of a frame, and its faces in it."""
    from mirdrake.sensors.ranging.shapes import faces_of

    looks = []
    for geometry in inspector.GetGeometries(frame, Role.kPerception):
        name = inspector.GetName(geometry).rpartition("::")[2]
        if name.startswith(_SCENERY):
            continue
        faces = faces_of(inspector, geometry)
        if faces is not None:
            owner = "/".join(name.split("/")[:2])  # prop/<name> of its parts
            looks.append((owner, faces.moved(inspector.GetPoseInFrame(geometry))))
    return looks


_worlds: "WeakKeyDictionary[MultibodyPlant, RayWorld]" = WeakKeyDictionary()


def ray_world(parts: "PlantParts") -> RayWorld:
    """Return the ray world of a plant; it is made at the first call and shared by all its sensors."""
    if parts.plant not in _worlds:
        terrain = parts.world.ground.terrain
        _worlds[parts.plant] = RayWorld(
            parts.plant, parts.scene_graph, terrain=terrain, actors=parts.actors, lead=parts.lead
        )
    return _worlds[parts.plant]


def instance_bodies(plant: MultibodyPlant, instance: ModelInstanceIndex) -> list[int]:
    """Return the indices of the bodies of a model."""
    return [int(index) for index in plant.GetBodyIndices(instance)]
