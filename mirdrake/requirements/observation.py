"""Signals and events of one vehicle in one run, with margins, for requirements.

:func:`observe` works it all out from a run's samples. Signals are those of the run, without the vehicle's name in
front, and further ones of :data:`SIGNALS`. An event has, for every sample, a truth and a margin: how far it is from
changing, positive where the event holds.
"""

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray

from mirdrake.core.errors import RunError
from mirdrake.core.vectors import WHEELS
from mirdrake.requirements.surroundings import (
    GAP,
    TIME_TO_COLLISION,
    Mover,
    clearance_to,
    gap_to,
    movers_of,
    time_to_collision,
    touches,
)
from mirdrake.runs.incidents import NEAR, OF_ACTORS
from mirdrake.runs.logs import Run
from mirdrake.vehicles import Vehicle
from mirdrake.vehicles.geometry import VehicleGeometry
from mirdrake.vehicles.outline import Outline, measure_outline
from mirdrake.worlds import World
from mirdrake.worlds.clearance import clearance
from mirdrake.worlds.lights import RED

Array = NDArray[np.float64]
Truth = NDArray[np.bool_]

STANDING = 0.05
"""Speed below which a vehicle counts as stopped [m/s]."""

TIPPED = math.radians(45.0)
"""Tilt of the vehicle against the road from which it counts as rolled over [rad]."""

TOUCH = 1e-3
"""Least penetration of a contact [m]. The clearance of bodies in contact is zero, even if their outlines are apart."""

AT_RED = "at red"
"""Event of a world with lights: the vehicle runs over red."""

_FAR = 50.0  # [m] distance from a stop line at which it has no meaning
_SLOWEST = 1.0  # [m/s] smallest denominator of the slip, which is undefined (0/0) at standstill

SIGNALS: dict[str, tuple[str, str]] = {
    "speed": ("m/s", "speed of the rear axle's centre over the ground"),
    "accel": ("m/s^2", "forward acceleration, without gravity"),
    "lateral_accel": ("m/s^2", "acceleration to the left, without gravity"),
    "yaw_rate": ("rad/s", "yaw rate, positive to the left"),
    "slip": ("", "largest of all wheels: (rim speed - ground speed) / ground speed"),
    "clearance": (
        "m",
        "horizontal distance of the vehicle's collision shapes to the nearest prop, in its initial pose, vehicle or "
        "actor; only shapes at the same height count; negative: depth of overlap",
    ),
    "time_to_collision": (
        "s",
        "time until it touches a vehicle, actor or prop if all keep their velocities and do not turn; inf: never",
    ),
    "laps": ("", "distance along the track since the start, in laps"),
    "lap_time": ("s", "time since the current lap began"),
    "time": ("s", "time since the start"),
    "x": ("m", "position of the rear axle's centre in the world"),
    "y": ("m", "position of the rear axle's centre in the world"),
    "z": ("m", "height of the rear axle's centre in the world"),
    "roll": ("rad", "roll angle, right side down"),
    "pitch": ("rad", "pitch angle, nose down"),
    "yaw": ("rad", "heading, from x towards y"),
    "vx": ("m/s", "velocity forward, in the vehicle's frame"),
    "vy": ("m/s", "velocity to the left, in the vehicle's frame"),
    "vz": ("m/s", "velocity upwards, in the vehicle's frame"),
    "wx": ("rad/s", "roll rate, in the vehicle's frame"),
    "wy": ("rad/s", "pitch rate, in the vehicle's frame"),
    "wz": ("rad/s", "yaw rate, in the vehicle's frame"),
    "wheels_on_road": ("", "number of wheels on the road, 0 to 4"),
    "progress": ("m", "distance along the track"),
    "lateral_error": ("m", "distance to the left of the track"),
    "heading_error": ("rad", "heading relative to that of the track, positive to the left"),
    "curvature": ("1/m", "curvature of the track, positive to the left"),
    "lap": ("", "number of completed laps"),
    "speed_command": ("m/s", "speed set-point of the driver"),
    "steering_command": ("rad", "steering set-point of the driver"),
    "speed_setpoint": ("m/s", "speed that the control unit follows"),
    "steering_setpoint": ("rad", "steering angle that the control unit follows"),
    "speed_trim": ("m/s", "correction of the speed set-point by the speed controller"),
    "other_contacts": ("", "number of contacts that are not a tyre on the ground"),
}
"""Unit and meaning of each signal; others have a dot in their name. The collision shapes are those of the vehicle at
rest, not tilted."""

SIGNALS_BY_NAME: dict[str, tuple[str, str]] = {
    "gap to NAME": ("m", "clearance to one vehicle or actor"),
    "signals.NAME": ("", "state of a traffic light: 0 red, 1 amber, 2 green"),
    "actors.NAME.SIGNAL": ("", "a signal of an actor: x, y, yaw, speed, acceleration, yaw_rate or gap"),
}
"""Unit and meaning of the signals of other objects."""

TRACK_SIGNALS = ("progress", "lateral_error", "heading_error", "curvature", "lap", "laps", "lap_time")
"""Signals that only a world with a track has."""

LAP_SIGNALS = ("lap", "laps", "lap_time")
"""Those of them that only a closed track has."""

EVENTS = {
    "collision": "the vehicle touches a prop, another vehicle or an actor; margin: the clearance, taken negative",
    "stopped": f"slower than {STANDING} m/s; margin in m/s",
    "on road": "all four wheels; margin: from the outermost wheel to the edge of the road",
    "rollover": f"tilted by more than {round(math.degrees(TIPPED))} deg; margin: the tilt beyond that",
}
"""Events by name; besides, there is ``at NAME`` for every goal of the world."""


class Event(NamedTuple):
    """Condition of an event at each sample."""

    truth: Truth
    margin: Array
    """how far from changing: positive where it is so"""
    unit: str
    scale: float = 1.0
    """size that is usual for the margin, in its unit"""


@dataclass(frozen=True)
class Observation:
    """Signals and events of one vehicle in one run.

    Attributes:
        times: since the start of the run [s] (n), rising.
        signals: signals by name (n each).
        units: units of the signals.
        events: events by name; ``at NAME`` for goals.
        goal: name of the goal that ``at goal`` means.
        corners: corners of the vehicle's outline in W [m] (n, 4, 2), front left first, to the left.
        movers: other vehicles and actors.
    """

    times: Array
    signals: Mapping[str, Array]
    units: Mapping[str, str] = field(default_factory=dict)
    events: Mapping[str, Event] = field(default_factory=dict)
    goal: str | None = None
    corners: Array = field(default_factory=lambda: np.empty((0, 4, 2)))
    movers: tuple[Mover, ...] = ()


def observe(
    run: Run,
    world: World,
    vehicle_name: str,
    vehicle: Vehicle,
    *,
    goal: str | None = None,
    others: Mapping[str, Vehicle] | None = None,
    wanted: Collection[str] = (),
) -> Observation:
    """Return all signals and events of one vehicle in a run.

    Args:
        run: a run with samples.
        world: world of the run.
        vehicle_name: its name in the run.
        vehicle: the vehicle.
        goal: name of the goal that ``at goal`` means; the world's goal of the name "goal" if left out.
        others: the other vehicles of the run, by their names in it; one of that name is left out.
        wanted: names of signals that take long to compute and are needed: ``time_to_collision``, ``gap to NAME``.

    Raises:
        RunError: the run has no samples.
    """
    # Keep the first of samples with equal times: np.gradient would divide by zero between them.
    table = run.signals
    first = ~table.index.duplicated()
    table, actors = table[first], run.actors[first] if len(run.actors) else run.actors
    if table.empty:
        raise RunError("the run has no samples to judge")
    times = table.index.to_numpy(dtype=float) - float(table.index[0])
    signals: dict[str, Array] = {str(name): table[name].to_numpy(dtype=float) for name in table}
    units = {name: run.units.get(name, "") for name in signals}
    # Signals of the judged vehicle also get names without its prefix, as requirements are written about it.
    prefix = f"{vehicle_name}."
    for name in [name for name in signals if name.startswith(prefix)]:
        signals[name.removeprefix(prefix)], units[name.removeprefix(prefix)] = signals[name], units[name]

    # What follows from the motion of the vehicle alone.
    signals |= _motion(times, signals) | {"slip": _slip(signals, vehicle.geometry), "time": times}
    if "lap" in signals:
        signals |= {"laps": signals["lap"], "lap_time": _lap_time(times, signals["lap"])}

    # What follows from the objects around it.
    corners = _corners(signals, outline(vehicle))
    movers = {
        mover.name: mover for mover in movers_of(world, actors, signals, {**(others or {}), vehicle_name: vehicle})
    }
    signals |= {f"{OF_ACTORS}{name}": actors[name].to_numpy(dtype=float) for name in actors}
    units |= {name: run.units.get(name, "") for name in signals if name.startswith(OF_ACTORS)}
    own = movers.pop(vehicle_name)
    # Static props first: their clearance is the bound that lets far movers be skipped.
    signals["clearance"] = clearance_to(own, list(movers.values()), clearance(own.volume, own.poses, world.props))
    # Gaps and times to collision are costly, so they are computed only if the requirement names them.
    for name in wanted:
        if name.startswith(GAP) and (other := movers.get(name.removeprefix(GAP))) is not None:
            signals[name], units[name] = gap_to(own, other), "m"
    if TIME_TO_COLLISION in wanted:
        signals[TIME_TO_COLLISION] = time_to_collision(own, movers.values(), world)
    # Units last: they are for the signals that exist by now.
    units |= {name: unit for name, (unit, _) in SIGNALS.items() if name in signals}
    events = {
        "collision": _collision(
            signals, touches(own, [movers[actor.name] for actor in world.actors if actor.name in movers])
        ),
        "stopped": _event(STANDING - signals["speed"], "m/s")._replace(scale=STANDING),
        "on road": _on_road(world, signals, vehicle.geometry),
        "rollover": _event(_tilt(signals) - TIPPED, "rad")._replace(scale=TIPPED),
    }
    for name, aim in world.goals.items():
        reached = _at_goal(world, aim, signals, run.spec, vehicle_name)
        if reached is not None:
            events[f"at {name}"] = reached
    if world.lights:
        # Red lights are judged at the front of the collision shapes, not at the rear axle's centre.
        events[AT_RED] = _at_red(world, signals, max(float(x) for x in own.volume.outline[:, 0]))
    if goal is None and "at goal" in events:
        goal = "goal"
    return Observation(times, signals, units, events, goal, corners, tuple(movers.values()))


def outline(vehicle: Vehicle) -> Outline:
    """Return the bounding box of a vehicle's collision shapes at its design position; a point if there are none."""
    box = measure_outline(vehicle.urdf, packages=vehicle.packages, base_link=vehicle.spec.base_link)
    return box or Outline(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


# --- signals -----------------------------------------------------------------------------------------------------


def _motion(times: Array, signals: Mapping[str, Array]) -> dict[str, Array]:
    """Return speed and accelerations of the vehicle's origin, along its axes."""
    vx, vy, wz = signals["vx"], signals["vy"], signals["wz"]
    # Derivatives in a rotating frame: the Coriolis terms ω × v are added to the rates of the components.
    rate_x, rate_y = (np.gradient(v, times) if times.size > 1 else np.zeros(1) for v in (vx, vy))
    return {"speed": np.hypot(vx, vy), "accel": rate_x - wz * vy, "lateral_accel": rate_y + wz * vx, "yaw_rate": wz}


def _slip(signals: Mapping[str, Array], geometry: VehicleGeometry) -> Array:
    """Return the largest slip of the four wheels, with their unloaded radius."""
    slips = []
    # Wheels in the order front left, front right, rear left, rear right: even numbers are on the left.
    for i, wheel in enumerate(WHEELS):
        front, side = i < 2, (1.0, -1.0)[i % 2]
        x = geometry.wheelbase if front else 0.0
        y = side * (geometry.front_track if front else geometry.rear_track) / 2.0
        angle = signals[f"steering_angle.{('left', 'right')[i % 2]}"] if front else 0.0
        # Velocity of a wheel's contact point in the vehicle frame, v + ω × r, then along its steered direction.
        ahead, aside = signals["vx"] - signals["wz"] * y, signals["vy"] + signals["wz"] * x
        over_ground = ahead * np.cos(angle) + aside * np.sin(angle)
        rim = signals[f"wheel_speed.{wheel}"] * geometry.wheel_radii[i]
        slips.append(np.abs(rim - over_ground) / np.maximum(np.abs(over_ground), _SLOWEST))
    return np.asarray(np.max(slips, axis=0))


def _lap_time(times: Array, lap: Array) -> Array:
    # A vehicle that rolls back over the line does not begin the lap again, hence the running maximum.
    begun = np.maximum.accumulate(np.floor(np.maximum(lap, 0.0) + 1e-9))
    # Index of the sample at which the present lap began, carried forward.
    first = np.concatenate(([True], np.diff(begun) > 0.0))
    return times - times[np.maximum.accumulate(np.where(first, np.arange(times.size), 0))]


def _tilt(signals: Mapping[str, Array]) -> Array:
    """Return the angle between the vehicle's z axis and that of W [rad]."""
    # Element (3, 3) of the rotation matrix Rz Ry Rx; clip, as rounding may exceed 1.
    return np.asarray(np.arccos(np.clip(np.cos(signals["roll"]) * np.cos(signals["pitch"]), -1.0, 1.0)))


# --- objects around the vehicle ----------------------------------------------------------------------------------


def _corners(signals: Mapping[str, Array], box: Outline) -> Array:
    """Return the corners of the outline in W [m] (n, 4, 2)."""
    ahead = np.array([box.front, box.rear, box.rear, box.front])
    aside = np.array([box.left, box.left, box.right, box.right])
    x, y, yaw = (signals[name][:, None] for name in ("x", "y", "yaw"))
    cos, sin = np.cos(yaw), np.sin(yaw)
    return np.stack([x + ahead * cos - aside * sin, y + ahead * sin + aside * cos], axis=2)


# --- events ------------------------------------------------------------------------------------------------------


def _event(margin: Array, unit: str) -> Event:
    return Event(margin >= 0.0, margin, unit)


def _collision(signals: Mapping[str, Array], touched: Truth) -> Event:
    """Return the event that collision shapes overlap something, a contact force acts near one, or an actor is touched.

    Args:
        signals: signals of the vehicle.
        touched: whether it has touched an actor since the sample before (n).
    """
    free = signals["clearance"].copy()
    # A contact force that is far from props, vehicles and actors acts between the body and the road: no collision.
    touching = (signals.get("other_contacts", np.zeros(free.size)) > 0.0) & (free < NEAR)
    touching |= touched
    free[touching] = np.minimum(free[touching], -TOUCH)
    return Event(free <= 0.0, -free, "m")


def _on_road(world: World, signals: Mapping[str, Array], geometry: VehicleGeometry) -> Event:
    """Return the event of being on the road, with the signed distance of the outermost wheel to its edge."""
    x, y, yaw = signals["x"], signals["y"], signals["yaw"]
    roads = [road.area for road in world.road_areas if road.drivable]
    # A world without roads cannot be left: always true, with an infinite margin.
    if not roads:
        return Event(np.ones(x.size, dtype=bool), np.full(x.size, math.inf), "m")
    cos, sin = np.cos(yaw), np.sin(yaw)
    ahead = (geometry.wheelbase, geometry.wheelbase, 0.0, 0.0)
    aside = np.array([1.0, -1.0, 1.0, -1.0]) / 2.0 * np.repeat([geometry.front_track, geometry.rear_track], 2)
    # The union removes inner edges between adjoining roads and lanes, which are not edges of the road.
    area = shapely.union_all(roads)
    inside = [_inside_by(area, x + a * cos - b * sin, y + a * sin + b * cos) for a, b in zip(ahead, aside, strict=True)]
    return _event(np.min(inside, axis=0), "m")


def _at_red(world: World, signals: Mapping[str, Array], front: float) -> Event:
    """Return the event that the front of the vehicle is beyond a stop line that it had not passed before red.

    The margin is the distance of the front beyond the line while its light is red, negative before the line.

    Args:
        world: world with lights.
        signals: signals of the vehicle.
        front: distance of its front from its origin [m].
    """
    x, y, yaw = signals["x"], signals["y"], signals["yaw"]
    nose_x, nose_y = x + front * np.cos(yaw), y + front * np.sin(yaw)
    # Lines whose light is not red have no margin; -inf never wins the maximum over the lines.
    margin = np.full(x.size, -math.inf)
    for light in world.lights.values():
        red = light.state(signals["time"]) == RED
        for lane_id, s in light.lines:
            lane = world.lanes[lane_id]
            # Position relative to the stop line: along the lane (beyond) and across it (aside).
            px, py, heading = (float(value) for value in lane.pose(s))
            dx, dy = nose_x - px, nose_y - py
            beyond = dx * math.cos(heading) + dy * math.sin(heading)
            aside = np.abs(dy * math.cos(heading) - dx * math.sin(heading))
            # Only the vehicles in this lane, near the line and in its direction of travel; a line has no width
            # elsewhere.
            near = (
                red & (aside <= 0.5 * float(lane.width_at(s))) & (np.abs(beyond) < _FAR) & (np.cos(yaw - heading) > 0.0)
            )
            # A vehicle that is beyond the line when red begins may go on.
            begins = red & ~np.concatenate(([False], red[:-1]))
            row = np.where(begins, np.arange(x.size), 0)
            begun = np.maximum.accumulate(row)
            counts = near & (beyond[begun] <= 0.0)
            margin = np.where(counts, np.maximum(margin, beyond), margin)
    return Event(margin > 0.0, margin, "m")


def _inside_by(area: Any, x: Array, y: Array) -> Array:
    """Return the distance to the edge of an area [m] (n), negative outside."""
    # Samples without a pose (NaN) keep a NaN margin, which is reported as "cannot be judged".
    result = np.full(x.size, math.nan)
    good = np.flatnonzero(np.isfinite(x) & np.isfinite(y))
    # A tree of single segments, not one distance to the boundary: long runs on large maps need the fast look-up.
    lines = [shapely.get_coordinates(part) for part in shapely.get_parts(shapely.boundary(area))]
    ends = np.concatenate([np.stack([line[:-1], line[1:]], axis=1) for line in lines])
    segments = np.asarray(shapely.linestrings(ends))
    points = shapely.points(x[good], y[good])
    # query_nearest returns pairs of indices in its own order; row leads back to the point.
    (row, _), distance = shapely.STRtree(segments).query_nearest(points, return_distance=True, all_matches=False)
    shapely.prepare(area)
    within = shapely.contains_xy(area, x[good], y[good])
    result[good[row]] = np.where(within[row], distance, -distance)
    return result


def _at_goal(world: World, goal: Any, signals: Mapping[str, Array], spec: Mapping[str, Any], name: str) -> Event | None:
    """Return the event of being in an area, beyond a gate, or at the end of the laps; None if it is not known."""
    x, y = signals["x"], signals["y"]
    if goal.area is not None:
        return _event(_inside_by(goal.area, x, y), "m")
    if goal.laps is not None:
        return _event(signals["lap"] - goal.laps, "") if "lap" in signals else None
    track_name, gate = goal.gate
    # Progress is recorded for one track only; for another one the positions are projected onto it.
    track = world.tracks[track_name]
    followed = (spec.get("control") or {}).get(name) or {}
    measured = followed.get("track") or next(iter(world.tracks))
    good = np.isfinite(x) & np.isfinite(y)
    if measured == track_name and "progress" in signals:
        s = signals["progress"]
    elif good.all():
        s = track.project(x, y)[0]
    else:
        return None
    # Distances from the start along the track, so that a gate behind the start of a closed track lies ahead.
    driven, ahead = s - s[0], gate - s[0]
    # Undo the jumps of a whole length at the seam of a closed track.
    if track.closed:
        driven = driven - track.length * np.cumsum(np.round(np.diff(s, prepend=s[0]) / track.length))
        ahead = ahead % track.length
        ahead = track.length if min(ahead, track.length - ahead) < 1e-6 else ahead  # a gate at the start: a whole lap
    return _event(driven - ahead, "m")
