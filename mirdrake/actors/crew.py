"""The actors of a world as arrays for the compiled time step."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import shapely

from mirdrake.actors import triggers
from mirdrake.actors.behaviours import recorded
from mirdrake.actors.behaviours.base import NUMBERS, LaneBehaviour
from mirdrake.actors.behaviours.walk import BEGIN, END, Walk
from mirdrake.actors.lanes import LaneTable, lane_table
from mirdrake.actors.laws import sees
from mirdrake.actors.motion import STATE, set_pose
from mirdrake.actors.reservations import ComingRow, Driver, MeetingRow, WayRow, Ways
from mirdrake.actors.step import Crew, Member
from mirdrake.core.compiled import Records, records
from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.yaml_io import where
from mirdrake.worlds import Actor, World
from mirdrake.worlds.actors import FullActor
from mirdrake.worlds.actors_spec import Step, Trigger
from mirdrake.worlds.clearance import Volume
from mirdrake.worlds.networks.lane import Lane
from mirdrake.worlds.networks.ways import Way, meetings
from mirdrake.worlds.pieces import Array
from mirdrake.worlds.recorded import recorded_rows
from mirdrake.worlds.yield_lines import YieldLine

_TRIGGERS = {
    "distance": triggers.DISTANCE, "time": triggers.TIME, "past": triggers.PAST, "gap_below": triggers.GAP_BELOW,
    "gap_above": triggers.GAP_ABOVE, "speed_below": triggers.SPEED_BELOW, "speed_above": triggers.SPEED_ABOVE,
}  # fmt: skip
_GATE = 1.0  # [m] beyond the edges of the road
_BESIDE = 1.0  # [m] largest distance of a track from a stop line that it passes
_ALONG = math.radians(30.0)  # largest angle between them
_FASTEST = 20.0  # [m/s] up to which vehicles before a junction are seen in time


@dataclass(frozen=True)
class FullVehicle:
    """What actors know about a full vehicle: its outline, and where its state is in that of the plant."""

    volume: Volume
    position: int
    """index of the quaternion of its base in the positions"""
    velocity: int
    """index of its angular velocity in the state"""
    min_radius: float = 0.0
    """smallest radius of the path of its rear axle [m]"""
    track: str | None = None
    """track that its driver follows in traffic, by the right of way of junctions; None: another driver"""
    law: LaneBehaviour | None = None
    """law of that driver"""


@dataclass(frozen=True)
class Bodies:
    """The bases of the full vehicles in the state of the plant."""

    size: int
    """elements of the state"""
    vehicles: Sequence[FullVehicle]

    def planar(self, state: Array) -> Array:
        """Return x, y [m], yaw [rad], vx, vy [m/s] of the vehicles in W (m, 5)."""
        rows = np.empty((len(self.vehicles), 5))
        for row, vehicle in zip(rows, self.vehicles, strict=True):
            # Positions of a floating base in Drake: quaternion (w, x, y, z), then translation.
            w, x, y, z, px, py = state[vehicle.position : vehicle.position + 6].tolist()
            # Velocities of a floating base in Drake: angular velocity (3), then translational velocity in W.
            vx, vy = state[vehicle.velocity + 3 : vehicle.velocity + 5].tolist()
            yaw = float(np.arctan2(2.0 * (x * y + w * z), w * w + x * x - y * y - z * z))
            row[:] = px, py, yaw, vx, vy
        return rows


def make_crew(world: World, vehicles: Mapping[str, FullVehicle], state_size: int) -> tuple[LaneTable, Crew, Bodies]:
    """Return the lanes of a world, its actors as arrays, and the vehicles among them.

    Args:
        world: the world.
        vehicles: full vehicles by name.
        state_size: elements of the state of the plant.

    Raises:
        ConfigError: a trigger refers to what does not exist, or a full vehicle cannot follow its path.
    """
    lanes, _ = lane_table(world.lanes)
    actors = world.moving

    # Numbers as in the compiled step: actors first, then vehicles. The place of a full vehicle is that of its body.
    objects = {actor.name: number for number, actor in enumerate(world.actors)}
    objects |= {name: len(actors) + number for number, name in enumerate(vehicles)}
    full = {actor.name: len(world.actors) + number for number, actor in enumerate(world.full_actors)}
    owners = [*range(len(world.actors)), *([-1] * len(full)), *(full.get(name, objects[name]) for name in vehicles)]
    steps: list[list[float]] = []
    # Each behaviour has its own number of settings: rows of equal width hold them all.
    members, recordings = [], [np.empty((0, 5))]
    numbers = np.zeros((len(actors) + len(vehicles), NUMBERS))
    for row, actor in zip(numbers, actors, strict=False):
        behaviour = actor.spec.behaviour
        assert isinstance(behaviour, LaneBehaviour)
        values = (behaviour.braking_limit, *behaviour.numbers())
        first = len(steps)
        row[: len(values)] = values
        law = behaviour.law
        if isinstance(behaviour, Walk):
            row[BEGIN], row[END] = road_on_path(world, actor)
        if actor.spec.recorded is not None:
            law, begin = recorded.LAW, sum(map(len, recordings))
            recordings.append(recorded_rows(actor.spec, actor.rear_axle))
            row[recorded.FIRST], row[recorded.LAST] = begin, begin + len(recordings[-1])
        # A delayed start is the first step of the scenario, so that the other steps wait for it.
        if actor.spec.starts is not None:
            steps.append([*_trigger(actor.spec.starts, world, objects), triggers.START, 0.0, 0.0])
        steps += [[*_trigger(one, world, objects), *_action(one)] for one in actor.steps]
        radius = actor.min_radius
        if isinstance(actor, FullActor):
            radius = vehicles[actor.name].min_radius
            check_path(actor, world, radius)
        members.append(Member(law, actor.spec.speed, radius, first, len(steps)))
    lane_numbers = {name: number for number, name in enumerate(world.lanes)}
    # Those that drive by the right of way: actors whose law regards others, and vehicles in traffic.
    found = world.ways if any(sees(one.law) for one in members) or any(one.track for one in vehicles.values()) else ()
    ways = way_table(found, world.lanes, lane_numbers)
    drivers = [Driver(int(len(ways.rows) > 0 and sees(member.law)), 0, 0) for member in members]
    for row, vehicle in zip(numbers[len(actors) :], vehicles.values(), strict=True):
        own = [lane_numbers[name] for name in track_lanes(world, vehicle.track)]
        drivers.append(Driver(int(any(lane in own for lane in ways.rows["lane"])), *_range_of(own)))
        if vehicle.law is not None:
            row[: 1 + len(vehicle.law.numbers())] = vehicle.law.braking_limit, *vehicle.law.numbers()
    # Sizes of vehicles as well, since gaps are between outlines.
    shapes = [(actor.front, actor.rear, actor.half_width) for actor in world.actors]
    shapes += [outline_sizes(vehicles[name].volume) for name in full]
    shapes += [outline_sizes(vehicle.volume) for vehicle in vehicles.values()]
    crew = Crew(
        records(Member, members),
        numbers,
        np.array(shapes, dtype=float).reshape(-1, 3),
        np.array(owners, dtype=np.int64),
        np.array(steps, dtype=float).reshape(-1, triggers.WIDE),
        *stop_lines(world),
        yield_line_rows(world.yield_lines, world.lanes, lane_numbers),
        np.vstack(recordings),
        records(Driver, drivers),
        ways,
        junction_spans(found, lane_numbers),
    )
    return lanes, crew, Bodies(state_size, tuple(vehicles.values()))


def check_path(actor: FullActor, world: World, radius: float) -> None:
    """Check that a full vehicle can follow its own path.

    Args:
        actor: the actor.
        world: its world.
        radius: smallest radius of the path of its rear axle [m].

    Raises:
        ConfigError: the path has tighter bends.
    """
    tightest = 1.0 / max(float(np.abs(world.lanes[actor.lane].curvature).max()), 1e-9)
    if actor.spec.path is not None and tightest < radius:
        raise ConfigError(
            f"bends of {tightest:.1f} m radius; the smallest radius of {actor.model} is "
            f"{radius:.2f} m; give a larger radius",
            where=where(actor.spec, "path"),
        )


def road_on_path(world: World, actor: Actor | FullActor) -> tuple[float, float]:
    """Return begin and end of the first road that the path of an actor crosses [m]; equal without one."""
    path = world.lanes[actor.lane]
    roads = shapely.union_all([lane.area for lane in world.lanes.values() if lane.kind != "path"])
    inside = shapely.intersection(shapely.LineString(np.column_stack((path.x, path.y))), roads)
    # Several parts where the path crosses more than one road; only the first one along the path counts.
    first = min(
        (path.project(*shapely.get_coordinates(part).T)[0] for part in shapely.get_parts(inside) if not part.is_empty),
        key=lambda stations: float(stations.min()),
        default=np.zeros(1),
    )
    return float(first.min()), float(first.max())


def stop_lines(world: World) -> tuple[Array, Array]:
    """Return lane, light and station [m] of each stop line (q, 3), and the programmes of the lights (p, 4) [s].

    Lights are numbered in the order of the world, lanes in that of :attr:`World.lanes`.
    """
    numbers = {name: number for number, name in enumerate(world.lanes)}
    lines = [
        (numbers[lane], light, s)
        for light, one in enumerate(world.lights.values())
        for lane, s in lines_on_tracks(one.lines, world.lanes)
    ]
    table = np.array(lines, dtype=float).reshape(-1, 3)
    programmes = [(one.green, one.amber, one.red, one.offset) for one in world.lights.values()]
    return table, np.array(programmes, dtype=float).reshape(-1, 4)


def lines_on_tracks(lines: Sequence[tuple[str, float]], lanes: Mapping[str, Lane]) -> Iterator[tuple[str, float]]:
    """Yield stop lines, each a lane and a station [m], and where tracks that are no roads pass them."""
    followers = [lane for lane in lanes.values() if lane.kind == "line"]
    for name, s in lines:
        yield name, s
        x, y, yaw = lanes[name].pose(s)
        for lane in followers:
            station, offset = lane.project(x, y)
            turn = math.remainder(float(lane.pose(station)[2] - yaw), 2.0 * math.pi)
            # A line beyond an end is projected onto the end.
            if lane.id != name and abs(offset) < _BESIDE and abs(turn) < _ALONG and 0.0 < station < lane.length:
                yield lane.id, float(station)


def way_table(ways: Sequence[Way], lanes: Mapping[str, Lane], numbers: Mapping[str, int]) -> Ways:
    """Return the ways through junctions as arrays.

    Args:
        ways: the ways.
        lanes: lanes of the world by id.
        numbers: their numbers.
    """
    # Sorted, so that those of a lane are in a row, in the order in which they are reached.
    ways = sorted(ways, key=lambda way: (numbers[way.lane], way.s))
    junctions = {name: number for number, name in enumerate(sorted({way.junction for way in ways}))}
    pairs = {(pair.way, pair.other): pair for pair in meetings(ways)}
    met: list[MeetingRow] = []
    coming: list[ComingRow] = []
    rows: list[WayRow] = []
    for number, way in enumerate(ways):
        first, begin = len(met), len(coming)
        met += [
            MeetingRow(
                pair.other,
                pair.begin,
                pair.end,
                pairs[other, number].begin,
                pairs[other, number].end,
                int(pair.yields),
                pair.gap,
            )
            for (own, other), pair in pairs.items()
            if own == number
        ]
        coming += [
            ComingRow(numbers[name], *zone.span, zone.gap, distance)
            for zone in way.zones
            for name, distance in _lanes_to(zone.other, lanes, zone.gap * _FASTEST * zone.yields, way.lanes[0][0])
        ]
        rows.append(
            WayRow(
                numbers[way.lane],
                junctions[way.junction],
                way.s,
                way.length,
                int(way.stops),
                first,
                len(met),
                begin,
                len(coming),
            )
        )
    begins = np.searchsorted([row.lane for row in rows], np.arange(len(lanes) + 1)).astype(np.int64)
    return Ways(records(WayRow, rows), records(MeetingRow, met), records(ComingRow, coming), begins)


def junction_spans(ways: Sequence[Way], numbers: Mapping[str, int]) -> Array:
    """Return lane, begin and end of the parts of tracks within junctions (k, 3) [m]; lanes of `numbers` only."""
    rows = [
        (numbers[way.lane], way.s, way.s + way.length)
        for way in ways
        if way.lane in numbers and way.lane != way.lanes[0][0]
    ]
    return np.array(rows, dtype=float).reshape(-1, 3)


def track_lanes(world: World, track: str | None) -> list[str]:
    """Return the lanes of a track in its direction."""
    return [lane.id for lane in world.lanes.values() if lane.road == track and lane.direction > 0]


def _range_of(own: Sequence[int]) -> tuple[int, int]:
    return (min(own), max(own) + 1) if own else (0, 0)


def yield_line_rows(lines: Sequence[YieldLine], lanes: Mapping[str, Lane], numbers: Mapping[str, int]) -> Array:
    """Return yield lines on some lanes (k, 7); see :func:`mirdrake.actors.occupancy.fill_yield_lines`.

    There is a row for each lane from which vehicles come to a place of conflict within the gap.

    Args:
        lines: the yield lines.
        lanes: lanes of the world by id.
        numbers: numbers of some of them by id, with those that have priority.
    """
    rows = [
        (numbers[lane], s, numbers[before], begin, end, one.gap, distance)
        for one in lines
        for lane, s in one.lines
        if lane in numbers
        for other, begin, end in one.conflicts
        for before, distance in _lanes_to(other, lanes, one.gap * _FASTEST, lane)
        if before in numbers
    ]
    return np.array(rows, dtype=float).reshape(-1, 7)


def _lanes_to(lane: str, lanes: Mapping[str, Lane], far: float, without: str) -> Iterator[tuple[str, float]]:
    """Yield a lane and those before it up to a distance [m], each with the distance from its begin to that of the lane.

    Args:
        lane: id of the lane.
        lanes: lanes by id.
        far: the distance.
        without: a lane; those before it are its own approach, and left out.
    """
    seen, waiting = {without, *lanes[without].predecessors} - {lane}, [(lane, 0.0)]
    while waiting:
        name, distance = waiting.pop()
        if name in seen:
            continue
        seen.add(name)
        yield name, distance
        if distance < far:
            waiting += [
                (before, distance + lanes[before].length) for before in lanes[name].predecessors if before in lanes
            ]


def start_states(world: World, lanes: LaneTable) -> Records:
    """Return the states of the actors at the start, then those of the full vehicles among them (n)."""
    numbers = {name: number for number, name in enumerate(world.lanes)}
    # Fields are attributes here as in compiled code, because Python calls the same `set_pose`.
    lanes = LaneTable(*(table.view(np.recarray) for table in lanes))
    rows = np.zeros(len(world.moving), STATE).view(np.recarray)
    for row, actor in zip(rows, world.moving, strict=True):
        moves = actor.spec.starts is None
        row.lane, row.s, row.offset, row.old = numbers[actor.lane], actor.s, actor.offset, -1.0
        # The side of a gate is unknown until the first step; nothing is ahead until it has been searched.
        row.started, row.side, row.gap = float(moves), np.nan, np.inf
        row.desired = actor.spec.speed
        row.v = actor.spec.speed if moves else 0.0
        if actor.spec.recorded is None:
            set_pose(lanes, row)
        else:
            samples = recorded_rows(actor.spec, actor.rear_axle)
            recorded.replay(samples, 0, len(samples), 0.0, np.inf, row)
    return rows.view(np.ndarray)


def outline_sizes(volume: Volume) -> tuple[float, float, float]:
    """Return front, rear and half of the width of a vehicle [m]."""
    x, y = volume.outline.T
    return float(x.max()), -float(x.min()), float(np.abs(y).max())


def _trigger(trigger: Trigger, world: World, objects: Mapping[str, int]) -> list[float]:
    """Return the first columns of a step.

    Raises:
        ConfigError: its vehicle, actor or track does not exist.
    """
    if trigger.at is not None:
        return [triggers.AT, -1.0, trigger.at, 0.0, 0.0, 0.0, 0.0]
    condition = trigger.when
    assert condition is not None
    subject, gate = -1.0, [0.0, 0.0, 0.0, 0.0]
    # Unset means the actor itself, whose number is not known here: -1.
    if condition.of is not None:
        if condition.of not in objects:
            hint = did_you_mean(condition.of, objects)
            raise ConfigError(f"there is no vehicle or actor '{condition.of}'; {hint}", where=where(trigger, "when"))
        subject = float(objects[condition.of])
    if condition.track is not None:
        track = world.tracks[condition.track]
        # A line across the whole road, with a tolerance for vehicles that pass beside it.
        half = _GATE + max(float(track.left_width(condition.value)), float(track.right_width(condition.value)))
        gate = [*track.pose_at(condition.value), half]
    return [_TRIGGERS[condition.kind], subject, condition.value, *gate]


def _action(step: Step) -> list[float]:
    """Return the last columns of a step: the action and its numbers."""
    if step.change_speed is not None:
        return [triggers.CHANGE_SPEED, step.change_speed.to, step.change_speed.rate]
    if step.change_lane is not None:
        return [triggers.CHANGE_LANE, 1.0 if step.change_lane.to == "left" else -1.0, step.change_lane.within]
    if step.stop is not None:
        return [triggers.STOP, step.stop.rate, 0.0]
    assert step.go is not None
    return [triggers.GO, step.go.rate, 0.0]
