"""The road ahead of a full vehicle: the next object on its lane, and the next lines at which it may have to stop."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np
import numpy.typing as npt
from pydrake.systems.framework import BasicVector, Context

from mirdrake.actors import lanes, occupancy
from mirdrake.actors.crew import (
    Bodies,
    FullVehicle,
    junction_spans,
    lines_on_tracks,
    outline_sizes,
    yield_line_rows,
)
from mirdrake.actors.lanes import LaneTable, lane_table, project
from mirdrake.actors.motion import STATE
from mirdrake.actors.occupancy import ahead, fill, fill_yield_lines
from mirdrake.actors.traffic import LINE_AHEAD, PLANAR, actor_signals
from mirdrake.core.compiled import compiled
from mirdrake.core.leaf_system import LeafSystem
from mirdrake.core.signals import declare_vector_input, declare_vector_output, signals
from mirdrake.worlds import World
from mirdrake.worlds.lights import GREEN, RED
from mirdrake.worlds.pieces import Array

LINES = 3
"""Number of lines in :data:`ROAD_AHEAD`.

The nearest red light or closed line ends what a driver has to know, so only a driver with more than two amber lights
before that misses one.
"""

ROAD_AHEAD = signals(
    ("gap", "m", "to the vehicle, actor or, with an outline on the lane, pedestrian ahead; inf: none"),
    ("speed", "m/s", "of that along the lane"),
    *(
        signal
        for end in ("", *(f"_{k}" for k in range(2, LINES + 1)))
        for signal in (
            (f"line{end}", "m", "from the front to a line with a red or amber light, or a closed line; inf: none"),
            (f"light{end}", "", "state of the light: 0 red, also of a closed line, 1 amber, 2 no line"),
            (f"left{end}", "s", "time for which it stays in that state; inf: closed line, or no line"),
        )
    ),
)
"""What is ahead of a vehicle on its lane: the next object, and the next lines that are not open, nearest first.

Closed lines are yield lines, and lines of junctions that the vehicle must not pass. Green lights do not occur: they
restrict nothing, and hide no light behind them.
"""

_BELOW = 1.0  # [m] behind the front bumper that a line still counts


class RoadAhead(LeafSystem):
    """The next object and the next lines that are not open on the lane of a vehicle: the nearest lane of a track.

    Input ports:
        plant_state: state of the plant.
        actor_states (6 n): states of the actors; only in a world with actors.
        junction_line (1) [m]: station of the line of a junction that the vehicle must not pass; only if it drives by
            the right of way, see :class:`mirdrake.actors.traffic.Traffic`.
    Output ports:
        road_ahead (11) [m, m/s, m, -, s, m, -, s, m, -, s]: :data:`ROAD_AHEAD`.

    Args:
        world: the world.
        track: track that the vehicle follows.
        name: name of the vehicle.
        vehicles: all vehicles by name.
        obeys: whether each vehicle, then each actor, drives by the right of way (m + n); default: none does.
        state_size: elements of the state of the plant.
    """

    def __init__(
        self,
        world: World,
        track: str,
        name: str,
        vehicles: Mapping[str, FullVehicle],
        *,
        state_size: int,
        obeys: Sequence[bool] = (),
    ) -> None:
        super().__init__()

        # Only lanes in the direction of the track; oncoming traffic on other lanes is not ahead.
        own = {lane.id: lane for lane in world.lanes.values() if lane.road == track and lane.direction > 0}
        self._own = len(own)
        # Behind them, those to which it yields.
        for one in world.yield_lines:
            if any(lane in own for lane, _ in one.lines):
                own |= {lane: world.lanes[lane] for lane, _, _ in one.conflicts}
        self._lanes, numbers = lane_table(own)
        self._yield_lines = yield_line_rows(world.yield_lines, world.lanes, numbers)
        self._bodies = Bodies(state_size, tuple(vehicles.values()))
        self._me = list(vehicles).index(name)
        # Vehicles first, then actors: the order of the numbers in the compiled step.
        shapes = [outline_sizes(vehicle.volume) for vehicle in vehicles.values()]
        shapes += [(actor.front, actor.rear, actor.half_width) for actor in world.actors]
        self._shape = np.array(shapes, dtype=float)
        self._obeys = np.zeros(len(shapes), np.int64)
        self._obeys[: len(obeys)] = obeys
        self._spans = junction_spans(world.ways if any(obeys) else (), numbers)
        self._lights = [
            (light, numbers[lane], s)
            for light in world.lights.values()
            for lane, s in lines_on_tracks(light.lines, world.lanes)
            if lane in numbers
        ]
        self._look: Callable[..., tuple[float, float, int, float, float]] = compiled(
            look_ahead, parts=(*lanes.PARTS, *occupancy.PARTS)
        )
        self.plant_state = self.DeclareVectorInputPort("plant_state", state_size)
        needs = [self.plant_state.ticket(), self.time_ticket()]
        self.actor_states = None
        if world.actors:
            contents = actor_signals([actor.name for actor in world.actors], PLANAR)
            self.actor_states = declare_vector_input(self, "actor_states", contents)
            needs.append(self.actor_states.ticket())
        self.junction_line = None
        if self._obeys[self._me]:
            self.junction_line = declare_vector_input(self, "junction_line", LINE_AHEAD)
            needs.append(self.junction_line.ticket())
        self.road_ahead = declare_vector_output(self, "road_ahead", ROAD_AHEAD, self._calc, prerequisites=needs)

    def _calc(self, context: Context, output: BasicVector) -> None:
        objects = self._bodies.planar(self.plant_state.Eval(context))
        if self.actor_states is not None:
            # Without the yaw rate, which occupancy does not use.
            actors = self.actor_states.Eval(context).reshape(-1, len(PLANAR))[:, :5]
            objects = np.vstack((objects, actors))
        gap, speed, lane, front, closed = self._look(
            self._lanes, self._own, self._shape, objects, self._me, self._yield_lines, self._obeys, self._spans
        )
        if self.junction_line is not None:
            station = float(self.junction_line.Eval(context)[0])
            # A line that it has passed, by less than it may move in the time of an update, is that in front of it.
            closed = min(closed, max(station - front, 0.0))
        lights = self._lights_ahead(lane, front, context.get_time())
        output.SetFromVector([gap, speed, *next_lines(closed, lights)])

    def _lights_ahead(self, lane: int, front: float, time: float) -> list[tuple[float, float, float]]:
        """Return distance [m], state, and the time that is left of it [s] of all lights ahead."""
        length, is_closed = (self._lanes.lanes[lane][key] for key in ("length", "closed"))
        found = []
        for light, number, s in self._lights:
            away = s - front
            if is_closed:
                # Wrapped into -1 m to length - 1 m: a line just behind the bumper keeps its negative distance.
                away = (away + _BELOW) % float(length) - _BELOW
            if number == lane and away >= -_BELOW:  # a line below the front bumper counts for a metre
                found.append((away, *light.phase(time)))
        return found


def next_lines(closed: float, lights: Iterable[tuple[float, float, float]]) -> list[float]:
    """Return the next lines that are not open, nearest first, as in :data:`ROAD_AHEAD`.

    Args:
        closed: distance to the next closed line [m]; infinite: none.
        lights: distance [m], state, and the time that is left of it [s] of the lights ahead.
    """
    lines = [line for line in lights if line[1] != GREEN]
    if closed < math.inf:
        lines.append((closed, float(RED), math.inf))
    none = (math.inf, float(GREEN), math.inf)
    return [value for line in (sorted(lines) + LINES * [none])[:LINES] for value in line]


def look_ahead(
    t: LaneTable,
    own: int,
    shape: Array,
    objects: Array,
    me: int,
    yield_lines: Array,
    obeys: npt.NDArray[np.int64],
    spans: Array,
) -> tuple[float, float, int, float, float]:
    """Return what is ahead of a vehicle.

    These are gap [m] and speed [m/s] of the next object, the lane of the vehicle, the station of its front [m], and the
    distance from that to the next closed yield line [m].

    Args:
        t: lanes of its track, then those with priority.
        own: number of the lanes of its track.
        shape: front, rear and half of the width of all objects (n, 3) [m].
        objects: x, y, yaw, vx, vy of all objects (n, 5) [m, rad, m/s].
        me: number of the vehicle among them.
        yield_lines: yield lines (k, 7).
        obeys: 1 for each object that drives by the right of way of junctions (n).
        spans: parts of the lanes within junctions, see :func:`mirdrake.actors.occupancy.fill` (l, 3).
    """
    x, y, yaw = objects[me, 0], objects[me, 1], objects[me, 2]
    front, rear, half_width = shape[me, 0], shape[me, 1], shape[me, 2]
    middle, half = 0.5 * (front - rear), 0.5 * (front + rear)

    # The vehicle is on the lane whose centre line is nearest to its middle.
    best, lane, s, offset = math.inf, 0, 0.0, 0.0
    for number in range(own):
        station, aside = project(t, number, x + middle * math.cos(yaw), y + middle * math.sin(yaw))
        if abs(aside) < best:
            best, lane, s, offset = abs(aside), number, station, aside

    on_lanes = np.empty(
        len(objects) * len(t.lanes) + 2 * len(yield_lines), occupancy.OBJECT
    )  # each object can touch every lane once
    # No rows of actors: actors have no lane of this table here and count as bodies, like vehicles.
    count = fill(t, shape, np.arange(len(objects)), obeys, spans, np.empty(0, STATE), objects, on_lanes)
    gap, speed, _ = ahead(
        t, lane, s, half, offset - half_width, offset + half_width, me, math.inf, 0.0, 0.0, on_lanes, count
    )

    # Lines are written behind the objects.
    closed = math.inf
    for k in range(count, fill_yield_lines(t, yield_lines, on_lanes, count)):
        line = on_lanes[k]
        if line.lane == lane and line.blocker != me and line.middle - s - half >= -_BELOW:
            closed = min(closed, line.middle - s - half)
    return gap, speed, lane, s + half, closed
