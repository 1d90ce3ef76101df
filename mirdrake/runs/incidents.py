"""Incidents of a run that are reported immediately: impossible starts, collisions, vehicles that leave the ground."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
import shapely
from numpy.typing import NDArray

from mirdrake.plant.plant import VehicleInPlant
from mirdrake.runs.contact_periods import ContactPeriods
from mirdrake.worlds import PlacedProp, Start, World
from mirdrake.worlds.clearance import Volume, clearance, clearance_between, place_outline
from mirdrake.worlds.sweeps import first_contacts

Array = NDArray[np.float64]

OF_ACTORS = "actors."
"""Begin of the names of the signals of actors among those of a run."""

NEAR = 0.3
"""Largest distance of a contact force from the prop or vehicle that it is assigned to [m]; others are with the road."""

LEAST_DEPTH = 1e-3
"""Least reported depth of a start inside a prop or vehicle [m]."""

_SPEED_MARGIN = 1.02  # start speed over the top speed above which it is reported
_MOVING = 0.05  # [m/s] speed above which a vehicle moves


@dataclass(frozen=True)
class Incident:
    """Incident of a run.

    Attributes:
        time: time since the start of the run [s].
        kind: ``start``, ``collision``, ``ground`` or ``contact``; the last is an event only.
        text: message of one line.
        vehicle: name of the vehicle.
        other: name of the prop or vehicle of a collision.
        speed: speed of the vehicle at that time [m/s].
        difference: magnitude of the difference of the velocities of vehicle and actor [m/s]; None with other objects.
    """

    time: float
    kind: str
    text: str
    vehicle: str
    other: str = ""
    speed: float = 0.0
    difference: float | None = None


@dataclass
class Incidents:
    """Detector of incidents in the samples of a run, block by block.

    A collision of a pair is reported once. Its end and further contacts of the pair are events of kind ``contact``.

    Args:
        world: world of the run.
        vehicles: vehicles by name.
        volumes: volumes of the vehicles for collisions, by name.

    Attributes:
        reported: all incidents so far, without those of kind ``contact``.
    """

    world: World
    vehicles: Mapping[str, VehicleInPlant]
    volumes: Mapping[str, Volume]
    reported: list[Incident] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._props = [prop for prop in self.world.props if not prop.prop.driven_over]
        self._tree = shapely.STRtree([prop.footprint for prop in self._props])
        self._outside: set[str] = set()
        self._periods: dict[tuple[str, str], ContactPeriods] = {}
        self._last: dict[str, Array] = {}  # pose of each vehicle at the last sample
        self._last_actors: dict[tuple[str, str], Array] = {}
        self._last_time = 0.0

    def check_starts(self, starts: Mapping[str, Start]) -> list[Incident]:
        """Return the impossible starts of vehicles."""
        incidents = [
            Incident(0.0, "start", f"{name}: {text}", name)
            for name, start in starts.items()
            for text in self._start_faults(name, start, starts)
        ]
        self.reported += incidents
        return incidents

    def look(self, times: Array, columns: Mapping[str, Array]) -> list[Incident]:
        """Return the new incidents in a block of samples.

        Args:
            times: times of the samples (n) [s].
            columns: signals by name (n each).
        """
        if not len(times):
            return []
        poses = {name: _poses(columns, name) for name in self.vehicles if f"{name}.x" in columns}
        touching = {name: self._touching(name, poses, times, columns) for name in poses}
        incidents = [incident for name in poses for incident in self._collisions(name, touching[name], times, columns)]
        incidents += [incident for name in poses for incident in self._actors(name, poses[name], times, columns)]
        self._last_time = float(times[-1])
        incidents += [incident for name in poses for incident in self._left_ground(name, poses[name], times)]
        self.reported += sorted(incidents, key=lambda incident: incident.time)
        # Contacts need the collisions already reported, and are events only: they do not join `reported`.
        incidents += self._contacts(times, touching, columns)
        return sorted(incidents, key=lambda incident: incident.time)

    # --- starts ---------------------------------------------------------------------------------------------------

    def _start_faults(self, name: str, start: Start, starts: Mapping[str, Start]) -> Iterator[str]:
        volume, pose = self.volumes[name], np.array([[start.x, start.y, start.yaw]])
        # Clearance is negative inside an object, so the depth of penetration is its negative.
        for prop in self._near(volume, pose):
            depth = -float(clearance(volume, pose, [prop])[0])
            if depth > LEAST_DEPTH:
                yield f"starts in '{prop.name}', {depth:.2f} m deep; move the start or the prop"
        # Each pair once: a vehicle is only compared with those listed before it.
        for other in list(starts)[: list(starts).index(name)]:
            other_pose = np.array([[starts[other].x, starts[other].y, starts[other].yaw]])
            depth = -float(clearance_between(volume, pose, self.volumes[other], other_pose)[0])
            if depth > LEAST_DEPTH:
                yield f"starts in '{other}', {depth:.2f} m deep; move one of them"
        # Every corner of the outline must be on the ground, or a wheel may start over the edge.
        if volume.slabs and not self._is_on_ground(place_outline(volume.outline, pose)[0]).all():
            yield f"starts beyond the ground, {self._ground}; move the start or set ground.size"
        yield from self._speed_faults(name, start)

    def _speed_faults(self, name: str, start: Start) -> Iterator[str]:
        part, speed = self.vehicles[name], start.speed
        ahead, back = top_speeds(part)
        if speed > _SPEED_MARGIN * ahead:
            yield f"starts at {speed:.4g} m/s; its top speed is {ahead:.1f} m/s; lower its start speed"
        elif -speed > _SPEED_MARGIN * back:
            yield f"starts at {speed:.4g} m/s; its top speed backwards is {back:.1f} m/s; lower its start speed"
        if abs(speed) > _MOVING and part.parked:
            yield f"starts at {speed:.4g} m/s although it is parked: its wheels slide"
        if start.track is not None and start.s is not None:
            curvature = abs(float(self.world.tracks[start.track].curvature_at(start.s)))
            mu = float(self.world.mu(start.x, start.y))
            # Limit of lateral grip v = sqrt(mu g / kappa) of a point mass; on a straight there is none.
            limit = math.sqrt(mu * float(-self.world.ground.gravity[2]) / curvature) if curvature > 0.0 else math.inf
            if abs(speed) > limit:
                yield (
                    f"starts at {speed:.4g} m/s in a bend of {1.0 / curvature:.0f} m radius, where friction {mu:g} "
                    f"allows {limit:.1f} m/s"
                )

    # --- during the run -------------------------------------------------------------------------------------------

    def _touching(
        self, name: str, poses: Mapping[str, Array], times: Array, columns: Mapping[str, Array]
    ) -> dict[str, NDArray[np.bool_]]:
        """Return when a vehicle touches each object: overlapping shapes, or a contact force near the nearest one."""
        volume, mine = self.volumes[name], poses[name]
        # `other_contacts` counts contacts without naming the objects, so a contact is assigned to the nearest one.
        contacts = columns.get("other_contacts", np.zeros(len(times))) > 0.0
        gaps = {prop.name: clearance(volume, mine, [prop]) for prop in self._near(volume, mine)}
        for other, theirs in poses.items():
            if other != name and self._may_meet(name, mine, other, theirs):
                gaps[other] = clearance_between(volume, mine, self.volumes[other], theirs)
        for actor in self.world.actors:
            key = f"{OF_ACTORS}{actor.name}"
            if actor.spec.body == "solid" and f"{key}.x" in columns:
                gaps[actor.name] = clearance_between(volume, mine, actor.volume, _poses(columns, key))
        nearest = np.min(list(gaps.values()), axis=0) if gaps else np.empty(0)
        # Overlap alone misses contacts of stiff bodies, which stay apart in the
        # samples; force alone does not name the object.
        return {other: (gap <= 0.0) | (contacts & (gap < NEAR) & (gap <= nearest)) for other, gap in gaps.items()}

    def _collisions(
        self, name: str, touching: Mapping[str, NDArray[np.bool_]], times: Array, columns: Mapping[str, Array]
    ) -> Iterator[Incident]:
        """Return the first contact of a vehicle with each object; that with actors is found between samples."""
        actors = {actor.name for actor in self.world.actors}
        known = {
            incident.other for incident in self.reported if (incident.kind, incident.vehicle) == ("collision", name)
        }
        for other, touches in touching.items():
            if touches.any() and other not in known | actors:
                row = int(np.argmax(touches))
                before = max(row - 1, 0)  # the contact may already have reduced the speed of its sample
                speed = float(np.hypot(columns[f"{name}.vx"][before], columns[f"{name}.vy"][before]))
                text = f"{name}: collision with '{other}' at {speed:.1f} m/s"
                yield Incident(float(times[row]), "collision", text, name, other, speed)

    def _contacts(
        self, times: Array, touching: Mapping[str, Mapping[str, NDArray[np.bool_]]], columns: Mapping[str, Array]
    ) -> Iterator[Incident]:
        """Return where contacts begin and end; the first of each pair with an object is a collision already."""
        by_pair = {(name, other): touches for name, pairs in touching.items() for other, touches in pairs.items()}
        touches = np.any([*by_pair.values()], axis=0) if by_pair else np.zeros(len(times), dtype=bool)
        name = next(iter(self.vehicles)) if len(self.vehicles) == 1 else "a vehicle"
        # A contact without an object nearby is one with the ground; the signals do not identify the vehicle.
        by_pair[name, ""] = (columns.get("other_contacts", np.zeros(len(times))) > 0.0) & ~touches
        # Pairs of earlier blocks that are not near any more still need their end, so they are looked at too.
        for pair in {**self._periods, **by_pair}:
            periods = self._periods.setdefault(pair, ContactPeriods())
            other = f"'{pair[1]}'" if pair[1] else "the ground or a low prop"
            for time, event in periods.look(times, by_pair.get(pair, np.zeros(len(times), dtype=bool))):
                if event != ContactPeriods.FIRST or not pair[1]:
                    yield Incident(time, "contact", f"{pair[0]}: contact with {other} {event}", *pair)

    def _actors(self, name: str, mine: Array, times: Array, columns: Mapping[str, Array]) -> Iterator[Incident]:
        """Return the first contacts of a vehicle with each actor, also between samples."""
        known = {incident.other for incident in self.reported if incident.vehicle == name}
        # The path begins with the last pose of the block before, or a contact between two blocks would be missed.
        begin = self._last.get(name)
        stamps = times if begin is None else np.concatenate(([self._last_time], times))
        path = mine if begin is None else np.vstack((begin, mine))
        self._last[name] = mine[-1]
        for actor in self.world.actors:
            key = f"{OF_ACTORS}{actor.name}"
            if f"{key}.x" not in columns:
                continue
            theirs = _poses(columns, key)
            if begin is not None:
                theirs = np.vstack((self._last_actors[name, actor.name], theirs))
            self._last_actors[name, actor.name] = theirs[-1]
            if actor.name in known:
                continue
            # Actors have no contact force in the plant, so their contacts are found by
            # sweeping both outlines between samples.
            contacts = first_contacts(self.volumes[name], path, actor.volume, theirs)
            if not np.isfinite(contacts).any():
                continue
            row = int(np.argmax(np.isfinite(contacts)))
            before = max(row - 1, 0)
            # A contact lies at a fraction of the interval before its row; times are interpolated linearly.
            time = float(stamps[before] + contacts[row] * (stamps[row] - stamps[before]))
            # `stamps` has one more entry than the columns if the last pose was prepended.
            sample = min(max(before - (begin is not None), 0), len(times) - 1)
            yield self._with_actor(name, actor.name, time, sample, columns)

    def _with_actor(self, name: str, actor: str, time: float, row: int, columns: Mapping[str, Array]) -> Incident:
        """Return the collision of a vehicle and an actor, with the speeds of a sample."""
        vx, vy, yaw = (float(columns[f"{name}.{key}"][row]) for key in ("vx", "vy", "yaw"))
        # Velocity of the vehicle in the world frame, from its components in the vehicle frame.
        own = np.array([vx * math.cos(yaw) - vy * math.sin(yaw), vx * math.sin(yaw) + vy * math.cos(yaw)])
        key = f"{OF_ACTORS}{actor}"
        speed, heading = float(columns[f"{key}.speed"][row]), float(columns[f"{key}.yaw"][row])
        difference = float(np.hypot(*(own - speed * np.array([math.cos(heading), math.sin(heading)]))))
        text = (
            f"{name}: collision with '{actor}' at {math.hypot(vx, vy):.1f} m/s, speed difference {difference:.1f} m/s"
        )
        return Incident(time, "collision", text, name, actor, math.hypot(vx, vy), difference)

    def _left_ground(self, name: str, poses: Array, times: Array) -> Iterator[Incident]:
        good = np.isfinite(poses).all(axis=1)
        # Poses of a diverged vehicle are NaN, which would count as outside.
        outside = good & ~self._is_on_ground(poses[:, :2])
        if outside.any() and name not in self._outside:
            row = int(np.argmax(outside))
            x, y = poses[row, :2].tolist()
            text = f"{name}: left the world's ground at ({x:.1f}, {y:.1f}) m, {self._ground}"
            yield Incident(float(times[row]), "ground", text, name)
        if good.any():  # a vehicle that returns and leaves again is reported again
            (self._outside.add if outside[good][-1] else self._outside.discard)(name)

    # --- candidates -----------------------------------------------------------------------------------------------

    def _near(self, volume: Volume, poses: Array) -> list[PlacedProp]:
        """Return the props that a vehicle may touch at its poses, or have a contact with."""
        good = poses[np.isfinite(poses).all(axis=1)]
        if not self._props or not volume.slabs or not len(good):
            return []
        # The hull of the vehicle and the footprint of a prop are at least as near to each other as their slabs are.
        shapes = shapely.polygons(place_outline(volume.outline, good))
        return [
            self._props[index] for index in np.unique(self._tree.query(shapes, predicate="dwithin", distance=NEAR)[1])
        ]

    def _may_meet(self, name: str, mine: Array, other: str, theirs: Array) -> bool:
        volumes = (self.volumes[name], self.volumes[other])
        # Two circles around the origins that do not come near each other cannot touch: the exact test is not needed.
        reach = NEAR + sum(float(np.hypot(*volume.outline.T).max()) for volume in volumes if volume.slabs)
        apart = np.hypot(*(mine[:, :2] - theirs[:, :2]).T)
        return bool((apart[np.isfinite(apart)] < reach).any())

    def _is_on_ground(self, points: Array) -> NDArray[np.bool_]:
        xmin, ymin, xmax, ymax = self.world.ground.extent
        return np.asarray((points >= (xmin, ymin)).all(axis=1) & (points <= (xmax, ymax)).all(axis=1))

    @property
    def _ground(self) -> str:
        xmin, ymin, xmax, ymax = self.world.ground.extent
        return f"which reaches from ({xmin:g}, {ymin:g}) to ({xmax:g}, {ymax:g}) m"


def top_speeds(part: VehicleInPlant) -> tuple[float, float]:
    """Return the top speeds forward and in reverse [m/s] from the limits of wheels, motor and governor."""
    radius, drive = min(part.vehicle.geometry.wheel_radii), part.vehicle.spec.powertrain
    limits = [float(joint.velocity_upper_limits()[0]) * radius for joint in part.wheels]
    wheels = min([limit for limit in limits if limit > 0.0], default=math.inf)
    ahead, backwards = drive.top_speeds(radius)
    return min(wheels, ahead), min(wheels, backwards)


def _poses(columns: Mapping[str, Array], name: str) -> Array:
    return np.column_stack([columns[f"{name}.{key}"] for key in ("x", "y", "yaw")])
