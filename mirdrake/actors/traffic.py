"""The actors of a world as one system: they are moved at 50 Hz, and have a pose at every time."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.geometry import FramePoseVector
from pydrake.systems.framework import BasicVector, Context, DiscreteValues

from mirdrake.actors import lanes, motion
from mirdrake.actors.behaviours import recorded
from mirdrake.actors.crew import FullVehicle, make_crew, start_states
from mirdrake.actors.motion import STATE
from mirdrake.actors.reservations import CLAIM
from mirdrake.actors.step import TimeStep, enter_next_lanes, go_on
from mirdrake.core.compiled import Records, compiled
from mirdrake.core.leaf_system import LeafSystem
from mirdrake.core.signals import Signal, Signals, declare_vector_output, signals
from mirdrake.plant.actors import ActorsInScene
from mirdrake.worlds import World
from mirdrake.worlds.pieces import Array

PERIOD = 0.02
"""Time between two updates [s]."""

PLANAR = (("x", "m"), ("y", "m"), ("yaw", "rad"), ("vx", "m/s"), ("vy", "m/s"), ("wz", "rad/s"))
"""Pose of the frame A of an actor in W, its velocity in W and its yaw rate."""

RECORDED = (
    ("x", "m"), ("y", "m"), ("yaw", "rad"), ("speed", "m/s"), ("acceleration", "m/s^2"), ("yaw_rate", "rad/s"),
    ("lane", ""), ("gap", "m"), ("braking_limit", ""),
)  # fmt: skip
"""Signals of an actor that a run records."""

LINE_AHEAD = signals(("station", "m"))
"""Station of the line of a junction, see :class:`Traffic`."""

PREVIEW = 0.3
"""Time by which the driver of a full vehicle looks ahead for bends [s]."""

MOTION = signals(
    ("x", "m"), ("y", "m"), ("yaw", "rad"), ("speed", "m/s"), ("acceleration", "m/s^2"),
    ("curvature", "1/m"), ("curvature_ahead", "1/m"),
)  # fmt: skip
"""Motion of an actor that the driver of a full vehicle follows: pose of its frame A in W, speed and acceleration, and
the curvature of its path here and where it is after :data:`PREVIEW` at this speed."""

_CRAWL = 0.1  # [m/s] below which a recorded path has no curvature


def actor_signals(names: Sequence[str], contents: Sequence[tuple[str, str]]) -> Signals:
    """Return the signals of all actors, named ``<actor>.<signal>``."""
    return tuple(Signal(f"{name}.{key}", unit) for name in names for key, unit in contents)


class Traffic(LeafSystem):
    """The actors of a world.

    An update at time t reads the vehicles and the actors at t and computes the actors at t + 20 ms. In between, poses
    are cubic in time, so that sensors get them at any time. All actors are updated from the states at t.

    Input ports:
        plant_state: state of the plant.
    Output ports:
        states (6 n): :data:`PLANAR` of each actor.
        signals (9 n): :data:`RECORDED` of each actor.
        poses: FramePoseVector of the frames A.
        desired (6 k, on a relief 8 k): x, y, yaw of all solid actors after the next step of the plant, then their rates
            now; on a relief x, y, z, yaw.
        motion_<name> (7): :data:`MOTION` of each actor that is a full vehicle.
        line_<name> (1) [m]: of each vehicle that drives by the right of way: station of the line of a junction that it
            must not pass, on its track; infinite: none.

    Args:
        world: the world.
        vehicles: full vehicles by name.
        scene: frames of the actors.
        state_size: elements of the state of the plant.
        plant_step: time step of the plant [s].
        always: whether `poses` are those of the present time, as cameras need, or those of the last update.

    Attributes:
        names: names of the actors in their order, without the full vehicles.
        motions: ports of the motions of the full vehicles by name.
        obeys: whether each actor and vehicle drives by the right of way of junctions, by name.
        lines: ports of the lines of junctions by the names of the vehicles.

    Raises:
        ConfigError: a trigger refers to a vehicle or actor that does not exist.
    """

    def __init__(
        self,
        world: World,
        vehicles: Mapping[str, FullVehicle],
        scene: ActorsInScene,
        *,
        state_size: int,
        always: bool = True,
        plant_step: float = 0.0,
    ) -> None:
        super().__init__()
        self.names = tuple(actor.name for actor in world.actors)
        self._scene, self._is_continuous, self._plant_step = scene, always, plant_step
        self._lanes, crew, self._bodies = make_crew(world, vehicles, state_size)
        self._step = TimeStep(self._lanes, crew)
        self._go_on = compiled(go_on, parts=(enter_next_lanes, *lanes.PARTS, *motion.PARTS))
        self._is_recorded = crew.members["law"] == recorded.LAW
        self._between = compiled(write_planar, parts=_PARTS)
        self._record = compiled(write_recorded, parts=_PARTS)
        start = start_states(world, self._lanes)
        self._all = len(start)
        numbers, claims = start.view(float), self._step.claims()
        self._ways, self._claims = crew.ways, claims.view(float).size
        # Copy of the state, with a record view of it: making such a view takes longer than the copy.
        self._copy = np.empty(2 * numbers.size)
        self._before, self._after = self._copy.view(STATE).reshape(2, self._all)
        self._next = np.empty_like(self._after)
        self._next_numbers = self._next.view(float)
        self.plant_state = self.DeclareVectorInputPort("plant_state", self._bodies.size)
        # The first update is at t = -PERIOD, formally: until the one at t = 0, outputs are those of the end, the start.
        self._state = self.DeclareDiscreteState(np.concatenate(([-PERIOD], claims.view(float), numbers, numbers)))
        # Without a ticket of the input: outputs depend on the state only, so that there is no algebraic loop.
        needs = [self.time_ticket(), self.discrete_state_ticket(self._state)]
        self.states = declare_vector_output(
            self, "states", actor_signals(self.names, PLANAR), self._calc_states, prerequisites=needs
        )
        self.signals = declare_vector_output(
            self, "signals", actor_signals(self.names, RECORDED), self._calc_signals, prerequisites=needs
        )
        self.poses = self.DeclareAbstractOutputPort(
            "poses",
            lambda: AbstractValue.Make(FramePoseVector()),
            self._calc_poses,
            # Without the time ticket poses are cached between updates, and the geometry engine has less to do.
            set(needs if always else needs[1:]),
        )
        # Elements of `states` in the order of the joints: places of all, then rates of all.
        solid = [self.names.index(name) for name in scene.solid]
        rows = [len(PLANAR) * i for i in solid]
        self._solid = np.array([row + k for part in (0, 3) for row in rows for k in range(part, part + 3)], dtype=int)
        size = len(self._solid) + (0 if scene.terrain.flat else 2 * len(rows))
        self.desired = self.DeclareVectorOutputPort("desired", size, self._calc_desired, set(needs))
        self.motions = {
            actor.name: declare_vector_output(
                self,
                f"motion_{actor.name}",
                MOTION,
                lambda context, output, number=number: self._calc_motion(context, output, number),
                prerequisites=needs,
            )
            for number, actor in enumerate(world.full_actors, start=len(self.names))
        }
        # An actor that is a full vehicle occurs twice; its behaviour drives it.
        obeys = [bool(one) for one in crew.drivers["obeys"]]
        self.obeys = dict(zip(vehicles, obeys[self._all :], strict=True))
        self.obeys |= {actor.name: one for actor, one in zip(world.moving, obeys, strict=False)}
        self.lines = {
            name: declare_vector_output(
                self,
                f"line_{name}",
                LINE_AHEAD,
                lambda context, output, number=number: self._calc_line(context, output, number),
                prerequisites=needs,
            )
            for number, name in enumerate(vehicles, start=self._all)
            if obeys[number]
        }
        self.DeclarePeriodicDiscreteUpdateEvent(PERIOD, 0.0, self._update)

    def _rows(self, context: Context) -> tuple[float, Records, Records]:
        """Return the time of the last update [s], and the states then and 20 ms later (n)."""
        values = context.get_discrete_state(self._state).value()
        self._copy[:] = values[1 + self._claims :]
        return float(values[0]), self._before, self._after

    def _claims_of(self, context: Context) -> Records:
        """Return the claims at the last update, of the actors and then of the vehicles (n + m)."""
        values = context.get_discrete_state(self._state).value()
        return np.asarray(values[1 : 1 + self._claims].view(CLAIM))

    def _update(self, context: Context, state: DiscreteValues) -> None:
        _, _, now = self._rows(context)
        vehicles = self._bodies.planar(self.plant_state.Eval(context))
        after = self._next
        time = context.get_time()
        # The last prediction becomes the present state; only the state 20 ms later is computed.
        claims = self._claims_of(context).copy()
        self._step(now, vehicles, time, PERIOD, after, claims)
        if self._solid.size:
            # A joint must not turn around where the yaw of a lane begins again.
            after["yaw"] -= 2.0 * np.pi * np.round((after["yaw"] - now["yaw"]) / (2.0 * np.pi))
        state.set_value(
            self._state,
            np.concatenate(([time], claims.view(float), self._copy[self._copy.size // 2 :], self._next_numbers)),
        )

    def _planar(self, context: Context, share: float | None = None) -> Array:
        """Return x, y, yaw, vx, vy, wz of the actors now, or at a share of the time step (n, 6)."""
        time, before, after = self._rows(context)
        before, after = before[: len(self.names)], after[: len(self.names)]
        planar = np.empty((len(self.names), len(PLANAR)))
        self._between(before, after, _share(context, time) if share is None else share, planar)
        return planar

    def _calc_states(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._planar(context).ravel())

    def solid_states(self, context: Context) -> Array:
        """Return the desired state of the bodies of all solid actors now, in the order of their joints."""
        values = np.asarray(self.states.Eval(context)[self._solid])
        if self._scene.terrain.flat:
            return values
        places, rates = values.reshape(2, -1, 3)
        # z is the height of the ground under the frame of the actor.
        ground = self._scene.terrain.slopes(places[:, 0], places[:, 1])
        climb = ground[:, 1] * rates[:, 0] + ground[:, 2] * rates[:, 1]
        both = (np.insert(part, 2, z, axis=1) for part, z in ((places, ground[:, 0]), (rates, climb)))
        return np.concatenate([part.ravel() for part in both])

    def _calc_desired(self, context: Context, output: BasicVector) -> None:
        values = self.solid_states(context)
        places, rates = np.split(values, 2)
        # The plant compares them with its own state after the step that begins now.
        places += self._plant_step * rates
        output.SetFromVector(values)

    def _calc_signals(self, context: Context, output: BasicVector) -> None:
        time, before, after = self._rows(context)
        before, after = before[: len(self.names)], after[: len(self.names)]
        rows = np.empty((len(self.names), len(RECORDED)))
        self._record(before, after, _share(context, time), rows)
        output.SetFromVector(rows.ravel())

    def _calc_motion(self, context: Context, output: BasicVector, number: int) -> None:
        time, before, after = self._rows(context)
        before, after = before[number : number + 1], after[number : number + 1].copy()
        rows, u = np.empty((1, len(RECORDED))), _share(context, time)
        self._record(before, after, u, rows)
        place, (speed, acceleration, rate) = rows[0, :3], rows[0, 3:6].tolist()
        if self._is_recorded[number]:  # the path of a recording is for maps; the motion has its own yaw rates
            here = ahead = rate / speed if speed > _CRAWL else 0.0
        else:
            here = self._go_on(self._lanes, after, (u - 1.0) * PERIOD * speed)
            ahead = self._go_on(self._lanes, after, PREVIEW * speed)
        output.SetFromVector([*place, speed, acceleration, here, ahead])

    def _calc_line(self, context: Context, output: BasicVector, number: int) -> None:
        claim = self._claims_of(context)[number]
        output.SetFromVector([self._ways.rows["s"][int(claim["way"])] if claim["closed"] == 1.0 else math.inf])

    def _calc_poses(self, context: Context, value: AbstractValue) -> None:
        always = None if self._is_continuous else 0.0
        value.set_value(self._scene.poses(self._planar(context, always)[:, :3]))


def _share(context: Context, time: float) -> float:
    """Return the share of the time step since an update at a time [s]."""
    return float(min(max((context.get_time() - time) / PERIOD, 0.0), 1.0))


def write_planar(before: Records, after: Records, u: float, planar: Array) -> None:
    """Write x, y, yaw [m, m, rad], vx, vy, wz [m/s, m/s, rad/s] of all actors at a share of the time step (n, 6).

    Arguments as those of :func:`_planar_of`.
    """
    for i in range(len(before)):
        planar[i] = _planar_of(before[i], after[i], u)


def write_recorded(before: Records, after: Records, u: float, rows: Array) -> None:
    """Write :data:`RECORDED` of all actors at a share of the time step (n, 9); arguments as those of `write_planar`."""
    for i in range(len(before)):
        x, y, yaw, _, _, wz = _planar_of(before[i], after[i], u)
        speed = (1.0 - u) * before[i].v + u * after[i].v
        # The yaw of a lane is continuous and grows on a closed one; recorded angles are within one turn.
        yaw = (yaw + math.pi) % (2.0 * math.pi) - math.pi
        rows[i] = (x, y, yaw, speed, after[i].a, wz, after[i].lane, after[i].gap, after[i].limit)


def _planar_of(before: Any, after: Any, u: float) -> tuple[float, float, float, float, float, float]:
    """Return x, y, yaw [m, m, rad], vx, vy, wz [m/s, m/s, rad/s] at a share of the time between two updates.

    They are cubic Hermite polynomials of poses and velocities at both ends, and their derivatives.

    Args:
        before: state at the last update.
        after: state at the next one.
        u: share of the time between them.
    """
    # The shorter way round: at the seam of a closed lane yaw jumps by a turn.
    turn = after.yaw - before.yaw
    turn -= 2.0 * math.pi * math.floor(turn / (2.0 * math.pi) + 0.5)
    x, vx = _hermite(before.x, after.x - before.x, before.vx, after.vx, u)
    y, vy = _hermite(before.y, after.y - before.y, before.vy, after.vy, u)
    yaw, wz = _hermite(before.yaw, turn, before.wz, after.wz, u)
    return x, y, yaw, vx, vy, wz


def _hermite(start: float, change: float, first: float, last: float, u: float) -> tuple[float, float]:
    """Return value and rate at a share of a time step, from the value, its change, and the rates at both ends."""
    left = 1.0 - u
    place = start + u * u * (3.0 - 2.0 * u) * change + PERIOD * u * (left * left * first + u * (u - 1.0) * last)
    rate = 6.0 * u * left / PERIOD * change + left * (1.0 - 3.0 * u) * first + u * (3.0 * u - 2.0) * last
    return place, rate


_PARTS = (_planar_of, _hermite)
