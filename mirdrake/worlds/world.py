"""Worlds: tracks, starts, goals, ground with its friction, props."""

import math
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import shapely
from numpy.typing import ArrayLike
from shapely.geometry.base import BaseGeometry

from mirdrake.core.constants import GRAVITY
from mirdrake.core.errors import WorldError, not_found
from mirdrake.ground import FLAT, Terrain
from mirdrake.ground.terrain import Slab
from mirdrake.worlds.actors import Actor, FullActor
from mirdrake.worlds.lights import Light, make_lights
from mirdrake.worlds.networks import Network
from mirdrake.worlds.networks.lane import Lane
from mirdrake.worlds.networks.paving import paved_areas
from mirdrake.worlds.networks.ways import Way, find_ways
from mirdrake.worlds.pieces import Array
from mirdrake.worlds.props import PlacedProp
from mirdrake.worlds.regions import Patch
from mirdrake.worlds.spec import TrackSpec, WorldSpec
from mirdrake.worlds.track_lanes import lanes_of_world
from mirdrake.worlds.tracks import Track
from mirdrake.worlds.yield_lines import YieldLine, make_yield_lines

if TYPE_CHECKING:
    from mirdrake.worlds.rules import Rules

SURFACE_MU = {"asphalt": 0.85, "concrete": 0.85, "gravel": 0.6, "grass": 0.5, "ice": 0.1}
"""Friction coefficients of dry surfaces [-]: asphalt and concrete (0.8 .. 0.9), gravel and ice are peak values of
J. Y. Wong, "Theory of Ground Vehicles", table of average road adhesion (after Taborek); grass is an estimate."""

_VERGE = 2.0  # [m]


@dataclass(frozen=True)
class Start:
    """A start: pose of the vehicle's frame B in W and its forward speed."""

    x: float
    """[m]"""
    y: float
    """[m]"""
    yaw: float
    """[rad], within ±π"""
    speed: float = 0.0
    """[m/s]"""
    track: str | None = None
    """track of a start that is given by `on_track`"""
    s: float | None = None
    """along that track [m]"""


@dataclass(frozen=True)
class Goal:
    """A goal: an area, a line across a track, or a number of laps."""

    name: str
    area: BaseGeometry | None = None
    """polygon in W [m]"""
    gate: tuple[str, float] | None = None
    """name of the track, and s on it [m]"""
    laps: int | None = None
    """laps of a closed track"""


@dataclass(frozen=True)
class Ground:
    """The base plane z = 0."""

    surface: str
    """its appearance"""
    mu: float
    """friction coefficient beside the tracks [-]"""
    extent: tuple[float, float, float, float]
    """smallest x, smallest y, largest x, largest y [m]; starts are inside, and the ground ends there"""
    grade: float = 0.0
    """rise over run [-]"""
    heading: float = 0.0
    """uphill direction [rad]"""
    relief: Terrain = FLAT
    """height of the roads and, if they have no thickness, of the ground over the base plane"""
    slab: Slab | None = None
    """roads with a thickness: the ground beside them is lower than the relief"""

    @cached_property
    def terrain(self) -> Terrain:
        """Height of the ground over the base plane."""
        return self.relief if self.slab is None else self.relief.with_layers([self.slab])

    @property
    def depth(self) -> float:
        """Height of the roads above the ground beside them [m]."""
        return 0.0 if self.slab is None else self.slab.thickness

    @property
    def gravity(self) -> Array:
        """Gravity in W [m/s²]: W stays on the road plane; a slope tilts gravity by its angle, towards downhill."""
        angle = math.atan(self.grade)
        downhill = GRAVITY * math.sin(angle)
        return np.array(
            [-downhill * math.cos(self.heading), -downhill * math.sin(self.heading), -GRAVITY * math.cos(angle)]
        )

    def check_position(self, x: float, y: float, *, where: str) -> None:
        """Check that a start is on the ground.

        Raises:
            WorldError: the position is off the ground; `where` is the prefix of the message.
        """
        xmin, ymin, xmax, ymax = self.extent
        if not (xmin <= x <= xmax and ymin <= y <= ymax):
            raise WorldError(
                f"start outside the world: ({x:g}, {y:g}) m; the ground extends from "
                f"({xmin:g}, {ymin:g}) to ({xmax:g}, {ymax:g}) m; move the start or set ground.size",
                where=where,
            )


@dataclass(frozen=True)
class RoadArea:
    """A paved area: a track, or lanes of the network."""

    name: str
    """name of the track, or of the kind of lanes of the network"""
    area: BaseGeometry
    """polygon in W [m]"""
    surface: str
    mu: float
    """friction coefficient [-]"""
    drivable: bool = True
    """vehicles on it are on the road"""
    is_track: bool = True
    """False: lanes of the network"""


@dataclass(frozen=True)
class World:
    """A world with everything in its place."""

    name: str
    spec: WorldSpec
    path: Path | None
    """its file"""
    tracks: dict[str, Track] = field(default_factory=dict)
    starts: dict[str, Start] = field(default_factory=dict)
    ground: Ground = field(
        default_factory=lambda: Ground("asphalt", SURFACE_MU["asphalt"], (-200.0, -200.0, 200.0, 200.0))
    )

    patches: tuple[Patch, ...] = ()
    """parts of the ground with their own friction; later ones on top"""
    goals: dict[str, Goal] = field(default_factory=dict)
    props: tuple[PlacedProp, ...] = ()
    """in the order of the file"""
    unplaced_props: tuple[WorldError, ...] = ()
    """an error for each entry with props that found no free position"""
    rules: "Rules | None" = field(default=None, compare=False)
    network: Network | None = field(default=None, compare=False)
    """lanes, stop lines and signals; None without"""
    paths: dict[str, Lane] = field(default_factory=dict, compare=False)
    """paths of single actors, by id"""
    actors: tuple[Actor, ...] = ()
    """in the order of their names"""
    full_actors: tuple[FullActor, ...] = ()
    """actors that are full vehicles, in the order of their names"""
    actor_entries: tuple[int, ...] = field(default=(), compare=False)
    """for each actor of the specification, the number of its entry in the file"""

    @cached_property
    def lanes(self) -> dict[str, Lane]:
        """Lanes of tracks and of the network, and paths of single actors, by id."""
        return lanes_of_world(self.spec.tracks, self.tracks, self.network) | self.paths

    @cached_property
    def lights(self) -> dict[str, Light]:
        """Traffic lights by name."""
        return make_lights(self.spec.signals, self.tracks, self.lanes, self.network) if self.spec.signals else {}

    @cached_property
    def yield_lines(self) -> tuple[YieldLine, ...]:
        """Lines at which vehicles wait for traffic with priority."""
        return make_yield_lines(self.spec.yield_lines, self.tracks, self.lanes)

    @cached_property
    def moving(self) -> tuple[Actor | FullActor, ...]:
        """All actors, the full vehicles among them last."""
        return (*self.actors, *self.full_actors)

    def actor_start(self, actor: Actor | FullActor) -> tuple[float, float, float]:
        """Return x [m], y [m] and yaw [rad] of frame A of an actor at the start."""
        x, y, yaw = self.lanes[actor.lane].pose(actor.s, actor.offset)
        return float(x), float(y), float(yaw)

    @cached_property
    def ways(self) -> tuple[Way, ...]:
        """Ways through the junctions of the network, also those of tracks along its lanes; none without a network."""
        return () if self.network is None else find_ways(self.network, self.lanes)

    @cached_property
    def road_mu(self) -> float:
        """Friction coefficient of the physical plane [-]: the largest in the world."""
        return max([self.ground.mu, *(mu for _, mu in self.friction_areas)])

    def mu(self, x: ArrayLike, y: ArrayLike) -> Array:
        """Return the friction coefficient [-] at points (world x, y [m], any shape).

        It is that of the last patch at the point, else of the last track, else of a verge, else of the ground.
        """
        x, y = np.broadcast_arrays(np.asarray(x, dtype=float), np.asarray(y, dtype=float))
        value = np.full(x.shape, self.ground.mu)
        for area, mu in self.friction_areas:
            value[shapely.contains_xy(area, x, y)] = mu
        return value

    @cached_property
    def friction_areas(self) -> tuple[tuple[BaseGeometry, float], ...]:
        """Areas [m] and their friction coefficients [-] on the ground, later ones on top."""
        areas: list[tuple[BaseGeometry, float]] = []
        for name, track in self.tracks.items():
            surface = self.spec.tracks[name].verge
            if surface is not None and surface != self.ground.surface:
                areas.append((verge(track), SURFACE_MU[surface]))
        areas += [(road.area, road.mu) for road in self.road_areas]
        areas += [(patch.area, patch.mu) for patch in self.patches]
        for area, _ in areas:
            shapely.prepare(area)
        return tuple(areas)

    def on_road(self, x: ArrayLike, y: ArrayLike) -> Array:
        """Return whether points (world x, y [m], any shape) are on a track; all are in a world without tracks."""
        x, y = np.broadcast_arrays(np.asarray(x, dtype=float), np.asarray(y, dtype=float))
        drivable = [road.area for road in self.road_areas if road.drivable]
        value = np.full(x.shape, not drivable)
        for area in drivable:
            shapely.prepare(area)
            value |= shapely.contains_xy(area, x, y)
        return value

    @cached_property
    def road_areas(self) -> tuple[RoadArea, ...]:
        """Paved areas, later ones on top: those of the network, then the tracks."""
        areas: list[RoadArea] = []
        if self.network is not None and self.spec.network is not None:
            for part in paved_areas(self.network):
                surface = part.surface or self.spec.network.surface
                mu = SURFACE_MU[surface] if part.surface or self.spec.network.mu is None else self.spec.network.mu
                areas.append(RoadArea(part.name, part.area, surface, mu, part.drivable, is_track=False))
        for name, track in self.roads().items():
            spec = self.spec.tracks[name]
            areas.append(RoadArea(name, track.area, spec.surface, track_mu(spec)))
        return tuple(areas)

    def roads(self) -> dict[str, Track]:
        """Return the tracks that are roads, by name."""
        return {name: track for name, track in self.tracks.items() if self.spec.tracks[name].road}

    def start(self, name: str, *, where: str = "") -> Start:
        """Return the start of a name.

        Raises:
            ConfigError: the start does not exist; `where` is the prefix of the message.
        """
        if name not in self.starts:
            raise not_found("start", name, self.starts, of=f"world '{self.name}'", where=where)
        return self.starts[name]

    def track(self, name: str, *, where: str = "") -> Track:
        """Return the track of a name.

        Raises:
            ConfigError: the track does not exist; `where` is the prefix of the message.
        """
        if name not in self.tracks:
            raise not_found("track", name, self.tracks, of=f"world '{self.name}'", where=where)
        return self.tracks[name]


def verge(track: Track) -> BaseGeometry:
    """Return the road with a verge of 2 m on both sides, as a polygon."""
    return shapely.buffer(track.area, _VERGE)


def track_mu(spec: TrackSpec) -> float:
    """Return the friction coefficient of a track [-]: the given one, or that of its surface."""
    return SURFACE_MU[spec.surface] if spec.mu is None else spec.mu
