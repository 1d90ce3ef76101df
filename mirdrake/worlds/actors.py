"""Actors of a world in their places: the prop, the lane or path, the parameters of the behaviour, the steps."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING

import numpy as np
import shapely
import shapely.affinity
from pydrake.math import RigidTransform, RollPitchYaw
from shapely.geometry.base import BaseGeometry

from mirdrake.core.errors import ConfigError, Place, WorldError, did_you_mean
from mirdrake.core.yaml_io import where
from mirdrake.worlds.actors_spec import ActorSpec, OnLaneSpec, OnTrackLaneSpec, Step, conditions
from mirdrake.worlds.arrange import css_color
from mirdrake.worlds.clearance import Part, Volume
from mirdrake.worlds.networks import Network
from mirdrake.worlds.networks.lane import Lane, lane_along
from mirdrake.worlds.pieces import Array
from mirdrake.worlds.props import Color, PlacedProp, Prop, load_prop
from mirdrake.worlds.recorded import recorded_path, recorded_rows, recorded_start
from mirdrake.worlds.track_lanes import lanes_of_world, station_on
from mirdrake.worlds.tracks import Track, check_station, find_track

if TYPE_CHECKING:
    from mirdrake.worlds.spec import WorldSpec

WALKER_LENGTH = 1.0
"""Length of a prop up to which it turns on the spot, as a pedestrian does [m]."""

WHEELBASE = 0.6
"""Wheelbase of an actor over its length; its overhangs are equal [-]. That of a compact car: 2.65 m of 4.5 m."""

SHARPEST = 2.0
"""Smallest radius of the path of an actor's rear axle over its wheelbase [-]: a car with 27 degrees of steering."""

_FINE = 0.25  # [m] between the nodes of a path
_CAR = (4.5, 1.8)  # [m] length and width of a car, for the paths of full vehicles, whose own sizes are not known here


@dataclass(frozen=True)
class Actor:
    """An actor in a world.

    Its frame A is on the ground below its rear axle, x forward; that of a walker below its middle. A follows the path.
    """

    name: str
    prop: Prop
    lane: str
    """id of the lane, or of its own path"""
    s: float
    """start along the lane [m]"""
    offset: float
    """to the left of the middle of the lane [m]"""
    spec: ActorSpec
    steps: tuple[Step, ...] = ()
    color: Color | None = None

    @property
    def walks(self) -> bool:
        """Whether it turns on the spot."""
        return self.prop.size[0] <= WALKER_LENGTH

    @property
    def rear_axle(self) -> float:
        """Distance of A behind the middle of the prop [m]."""
        return 0.0 if self.walks else 0.5 * WHEELBASE * self.prop.size[0]

    @property
    def min_radius(self) -> float:
        """Smallest radius of its path [m]."""
        return 0.0 if self.walks else SHARPEST * WHEELBASE * self.prop.size[0]

    @property
    def prop_pose(self) -> RigidTransform:
        """Pose X_AP of the frame of the prop in A."""
        return RigidTransform([self.rear_axle, 0.0, 0.0])

    @cached_property
    def volume(self) -> Volume:
        """Its collision shapes in A, for clearance and collision."""
        return _volume(self.prop, self.rear_axle)

    @property
    def front(self) -> float:
        """Distance of its front end ahead of A [m]."""
        return float(self.volume.outline[:, 0].max())

    @property
    def rear(self) -> float:
        """Distance of its rear end behind A [m]."""
        return -float(self.volume.outline[:, 0].min())

    @property
    def half_width(self) -> float:
        """Half of its width [m]."""
        return float(np.abs(self.volume.outline[:, 1]).max())

    def placed(self, x: float, y: float, yaw: float) -> PlacedProp:
        """Return its prop at a pose of A [m, m, rad]."""
        X_WA = RigidTransform(RollPitchYaw(0.0, 0.0, yaw), [x, y, 0.0])
        return PlacedProp(self.name, self.prop, X_WA @ self.prop_pose, color=self.color)


@dataclass(frozen=True)
class FullActor:
    """A full vehicle in a world that follows the motion of an actor: its frame A is that at the rear axle."""

    name: str
    model: str
    """name of a vehicle, or path of its folder"""
    lane: str
    """id of the lane, or of its own path"""
    s: float
    """start along the lane [m]"""
    offset: float
    """to the left of the middle of the lane [m]"""
    spec: ActorSpec
    steps: tuple[Step, ...] = ()

    @property
    def rear_axle(self) -> float:
        """Distance of A behind the middle of a car [m], for recordings of the middle."""
        return 0.5 * WHEELBASE * _CAR[0]

    @property
    def min_radius(self) -> float:
        """Smallest radius of its path [m]."""
        return SHARPEST * WHEELBASE * _CAR[0]

    @property
    def half_width(self) -> float:
        """Half of the width of its path [m]."""
        return 0.5 * _CAR[1]

    @property
    def length(self) -> float:
        """Length of a car [m]."""
        return _CAR[0]

    def area(self, x: float, y: float, yaw: float) -> BaseGeometry:
        """Return the outline of a car with A at a pose [m, m, rad], for maps."""
        rear, side = self.rear_axle - 0.5 * self.length, self.half_width
        box = shapely.box(rear, -side, rear + self.length, side)
        return shapely.affinity.translate(shapely.affinity.rotate(box, yaw, origin=(0, 0), use_radians=True), x, y)

    def start(self, lane: Lane) -> tuple[float, float, float]:
        """Return the position of A [m] and its yaw [rad] at the start on its lane."""
        if self.spec.recorded is not None:
            return recorded_start(recorded_rows(self.spec, self.rear_axle))
        x, y, yaw = lane.pose(self.s, self.offset)
        return float(x), float(y), float(yaw)


@lru_cache(maxsize=256)
def _volume(prop: Prop, rear_axle: float) -> Volume:
    """Return the collision shapes of a prop at a distance ahead of A [m]; cached, as many actors have the same prop."""
    points = [solid.corners_in(RigidTransform([rear_axle, 0.0, 0.0])) for solid in prop.solids]
    # No wheels, and an infinite wheel radius: only the clearance of the body decides what is an obstacle.
    return Volume.of([Part(corners, False) for corners in points], math.inf)


def lay_out_actors(
    spec: "WorldSpec",
    tracks: Mapping[str, Track],
    network: Network | None = None,
    props: Mapping[str, Prop] | None = None,
) -> tuple[tuple[Actor, ...], tuple[FullActor, ...], dict[str, Lane]]:
    """Return the actors of a world, the full vehicles among them, and their paths as lanes.

    Args:
        spec: the world file.
        tracks: its tracks.
        network: its road network.
        props: props of the actors by their names; default: those of the library.

    Raises:
        ConfigError, WorldError: an entry has a fault.
    """
    if not spec.actors and not spec.scenario:
        return (), (), {}
    lanes = lanes_of_world(spec.tracks, tracks, network)
    return _make_actors(spec.actors, spec.scenario, tracks, lanes, props or {})


def _make_actors(
    specs: Sequence[ActorSpec],
    scenario: Mapping[str, Sequence[Step]],
    tracks: Mapping[str, Track],
    lanes: Mapping[str, Lane],
    props: Mapping[str, Prop],
) -> tuple[tuple[Actor, ...], tuple[FullActor, ...], dict[str, Lane]]:
    """Return the actors and the full vehicles in the order of their names, and the lanes that are their own paths.

    Raises:
        ConfigError: a prop, track or lane does not exist, a name is used twice, or a path is too tight.
    """
    actors: dict[str, Actor | FullActor] = {}
    paths: dict[str, Lane] = {}
    place: tuple[str, float, float]
    for spec in specs:
        # Names are unique, because scenarios, triggers and signals refer to actors by them.
        if spec.name in actors:
            raise ConfigError(f"'{spec.name}' is used twice; give each actor its own name", where=where(spec, "name"))
        if spec.on_track is not None:
            lane, s = _on_track(spec.on_track, tracks, lanes)
            place = lane.id, s, spec.on_track.offset
        elif spec.on_lane is not None:
            place = _lane_of(spec.on_lane, lanes).id, spec.on_lane.s, spec.on_lane.offset
        else:
            # An actor with a path of its own gets a lane that only it uses, so that one law drives all actors.
            place = f"path/{spec.name}", 0.0, 0.0
        steps = tuple(scenario.get(spec.name, ()))
        actor: Actor | FullActor
        if spec.body == "full":
            actor = FullActor(spec.name, spec.actor, *place, spec, steps)
        else:
            # Actors with the same prop share it, so that a prop that was read from a run folder is not looked up again.
            prop = props.get(spec.name) or load_prop(spec.actor, where=where(spec, "actor"))
            color = css_color(spec.color, where=where(spec, "color")) if isinstance(spec.color, str) else spec.color
            actor = Actor(spec.name, prop, *place, spec, steps, color)
        if spec.path is not None:
            paths[actor.lane] = _path(actor)
        elif spec.recorded is not None:
            paths[actor.lane] = _recorded_path(actor)
        actors[spec.name] = actor
    for location, name, condition in conditions(specs, scenario):
        # Such a trigger would fire at once.
        if condition.of == name and condition.kind in {"distance", "time"}:
            raise ConfigError(f"'{name}' is always at its own place; name another actor or vehicle", where=location)
        # One beyond the end of the track would never fire.
        if condition.track is not None:
            check_station(condition.value, find_track(condition.track, tracks, where=location), where=location)
    # A scenario for a misspelt actor would be silently without effect.
    for name, steps_of in scenario.items():
        if name not in actors:
            location = where(steps_of[0]) if steps_of else Place("scenario")
            raise ConfigError(f"there is no actor '{name}'; {did_you_mean(name, actors)}", where=location)
    # Sorted by name: the order in the file has no effect on the simulation.
    ordered = [actors[name] for name in sorted(actors)]
    props_only = tuple(actor for actor in ordered if isinstance(actor, Actor))
    return props_only, tuple(actor for actor in ordered if isinstance(actor, FullActor)), paths


def _lane_of(spec: OnLaneSpec, lanes: Mapping[str, Lane]) -> Lane:
    """Return the lane of a place on a lane."""
    if spec.lane not in lanes:
        raise ConfigError(
            f"there is no lane '{spec.lane}'; {did_you_mean(spec.lane, lanes)}", where=where(spec, "lane")
        )
    lane = lanes[spec.lane]
    if not 0.0 <= spec.s <= lane.length:
        raise ConfigError(f"s = {spec.s:g} m; the lane is {lane.length:g} m long", where=where(spec, "s"))
    return lane


def _on_track(spec: OnTrackLaneSpec, tracks: Mapping[str, Track], lanes: Mapping[str, Lane]) -> tuple[Lane, float]:
    """Return the lane of a place on a track, and the station on it [m]."""
    track = find_track(spec.track, tracks, where=where(spec, "track"))
    known = [lane for lane in lanes.values() if lane.road == spec.track]
    forward = [lane for lane in known if lane.direction > 0]
    number: int = spec.lane if isinstance(spec.lane, int) else {"left": len(forward)}.get(str(spec.lane), 1)
    lane = lanes.get(f"{spec.track}.{number}")
    if lane is None:
        allowed = ", ".join(candidate.id.rpartition(".")[2] for candidate in known)
        raise ConfigError(f"track '{spec.track}' has no lane {spec.lane}; it has {allowed}", where=where(spec, "lane"))
    # On a closed track a station may be given beyond a lap, as by a row of actors.
    check_station(spec.s, track, where=where(spec, "s"))
    s = float(np.mod(spec.s, track.length)) if track.closed else spec.s
    return lane, station_on(lane, s)


# --- paths --------------------------------------------------------------------------------------------------------


def _path(actor: Actor | FullActor) -> Lane:
    """Return the path of one actor as a lane: straights, joined by arcs at its corners.

    Raises:
        WorldError: two corners are too close for the arcs, or equal.
    """
    spec = actor.spec
    assert spec.path is not None
    corners = np.array(spec.path, dtype=float)
    legs = np.diff(corners, axis=0)
    lengths = np.hypot(*legs.T)
    if (lengths < 0.1).any():
        index = int(np.argmin(lengths))
        raise WorldError("less than 0.1 m from the point before it", where=where(spec, "path", index + 1))
    # A walker may turn on the spot, a car may not: the smallest radius comes from the actor.
    radius = actor.min_radius if spec.radius is None else spec.radius
    if radius < actor.min_radius:
        raise WorldError(
            f"{radius:g} m; the smallest radius of a {spec.actor} is {actor.min_radius:.1f} m",
            where=where(spec, "radius"),
        )
    # Unwrapped, so that the turn at a corner is the smaller of the two possible ones.
    headings = np.unwrap(np.arctan2(legs[:, 1], legs[:, 0]))
    turns = np.diff(headings)
    # Length of the tangents of an arc: R tan(turn / 2); limited, because it is infinite at a turn by 180 degrees.
    cut = radius * np.tan(np.minimum(np.abs(turns), 3.0) / 2.0)  # of the legs before and after a corner
    # A leg between two corners must have room for the tangents of both.
    used = np.concatenate(([0.0], cut)) + np.concatenate((cut, [0.0]))
    if (used > lengths + 1e-9).any():
        index = int(np.argmax(used - lengths))
        raise WorldError(
            f"bends of {radius:.1f} m radius need {used[index]:.1f} m between this "
            f"corner and the next, which are {lengths[index]:.1f} m apart",
            where=where(spec, "path", index),
        )
    points, yaw = _with_arcs(corners, headings, turns, cut, radius)
    width = 2.0 * actor.half_width
    return replace(lane_along(actor.lane, points, yaw=yaw, width=width), kind="path")


def _recorded_path(actor: Actor | FullActor) -> Lane:
    """Return the path of a recorded actor.

    Raises:
        ConfigError: it has steps of a scenario.
    """
    if actor.steps:
        raise ConfigError(f"'{actor.name}' is recorded; a scenario has no effect on it", where=where(actor.steps[0]))
    lane = recorded_path(actor.lane, recorded_rows(actor.spec, actor.rear_axle), 2.0 * actor.half_width)
    return replace(lane, kind="path")


def _with_arcs(corners: Array, headings: Array, turns: Array, cut: Array, radius: float) -> tuple[Array, Array]:
    """Return points of a path and its headings there; without a radius the heading turns within 1 cm of a corner."""
    parts, directions = [corners[:1]], [headings[:1]]
    for corner, before, turn, length in zip(corners[1:-1], headings[:-1], turns, cut, strict=True):
        ahead = np.array([np.cos(before), np.sin(before)])
        after = np.array([np.cos(before + turn), np.sin(before + turn)])
        if radius <= 0.0:
            parts.append(np.array([corner - 0.005 * ahead, corner + 0.005 * after]))
            directions.append(np.array([before, before + turn]))
            continue
        angle = np.linspace(0.0, turn, max(3, int(np.ceil(abs(turn) * radius / _FINE)) + 1))
        side = np.array([-ahead[1], ahead[0]]) * np.sign(turn)
        centre = corner - length * ahead + radius * side
        turned = np.column_stack((np.cos(angle), np.sin(angle)))
        arm = -radius * side
        parts.append(centre + np.column_stack((turned[:, 0] * arm[0] - turned[:, 1] * arm[1],
                                               turned[:, 1] * arm[0] + turned[:, 0] * arm[1])))  # fmt: skip
        directions.append(before + angle)
    points, yaw = np.vstack([*parts, corners[-1:]]), np.concatenate([*directions, headings[-1:]])
    # Where two arcs meet without a straight between them, their common point occurs twice.
    distinct = np.concatenate(([True], np.hypot(*np.diff(points, axis=0).T) > 1e-6))
    return _with_ends(points[distinct], yaw[distinct])


def _with_ends(points: Array, yaw: Array) -> tuple[Array, Array]:
    """Return points and headings with two more points near the ends of each straight.

    The curvature of a lane is interpolated between its points: it changes within the distance between two of them.
    """
    legs = np.diff(points, axis=0)
    lengths = np.hypot(*legs.T)
    turns = np.abs(np.diff(yaw))
    if not turns.any():
        return points, yaw
    straight = np.flatnonzero((lengths > 3.0 * _FINE) & (turns < 1e-9))
    steps = _FINE * legs[straight] / lengths[straight, None]
    more = np.stack((points[straight] + steps, points[straight + 1] - steps), axis=1).reshape(-1, 2)
    after = np.repeat(straight + 1, 2)
    return np.insert(points, after, more, axis=0), np.insert(yaw, after, yaw[after - 1])
