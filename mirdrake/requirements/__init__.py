"""Requirements on a run in plain English, each with a signed margin.

::

    requirement = ["after" T] (always E | never E | eventually E ["within" T] | E until E | at end E)
    E           = E or E | E and E | not E | (E) | ["abs"] SIGNAL < VALUE | EVENT
    SIGNAL      = one of the list below, or any column of the run, with the dot in its name
    EVENT       = collision, stopped, on road, rollover, at goal, at NAME

    always clearance > 0.5 m
    never collision
    eventually stopped within 25 s
    after 5 s always abs lateral_error < 0.3 m or speed < 1 m/s
    speed < 5 m/s until at goal

Values may have a unit that fits (``36 km/h``); without one they are SI. Times count from the start of the run; what
follows ``after T`` counts from there. ``A until B`` asks that B happens, and that A holds at every sample before.

The margin is the quantitative semantics of signal temporal logic (A. Donzé, O. Maler, "Robust satisfaction of temporal
logic over real-valued signals", FORMATS 2010): positive where the requirement holds, and how far it is from changing,
in the SI unit of the signal that decides. ``and`` takes the least margin, ``or`` the greatest, whatever their units.
Over the samples that count it is the least of them for ``always``, the least of the opposite for ``never``, the
greatest for ``eventually``, that of the last sample for ``at end``. A signal that counts (:data:`COUNTS`) is half a
count away from changing when it has its last good value.

Signals (:data:`~mirdrake.requirements.observation.DERIVED`, :data:`~mirdrake.requirements.observation.RECORDED`)::

    speed               m/s     of the rear axle's centre over the ground
    accel               m/s^2   forward, without gravity
    lateral_accel       m/s^2   to the left, without gravity
    yaw_rate            rad/s   positive to the left
    slip                        largest of all wheels: (rim speed - ground speed) / ground speed
    clearance           m       to the nearest prop, vehicle or actor (collision shapes); negative: depth of overlap
    gap to NAME         m       clearance to one vehicle or actor
    time_to_collision   s       with vehicles, actors and props, if all keep their velocities; inf: never
    signals.NAME                state of a traffic light: 0 red, 1 amber, 2 green
    actors.NAME.speed   m/s     and other signals of an actor: x, y, yaw, acceleration, yaw_rate, gap
    laps                        along the track since the start
    lap_time            s       since the current lap began
    time                s       since the start
    x, y, z             m       rear axle's centre in the world
    roll, pitch, yaw    rad
    vx, vy, vz          m/s     forward, to the left, up, in the vehicle's frame
    wx, wy, wz          rad/s   in the vehicle's frame
    progress            m       along the track
    lateral_error       m       to the left of the track
    heading_error       rad     to the left of the track's heading
    curvature           1/m     of the track, positive to the left
    lap                         laps done
    wheels_on_road              0 .. 4
    other_contacts              contacts that are not a tyre on the ground
    speed_command, speed_setpoint, speed_trim       m/s
    steering_command, steering_setpoint             rad

Events: ``collision`` (margin: the clearance, taken negative, m), ``stopped`` (slower than 0.05 m/s; m/s), ``on road``
(from the outermost wheel to the edge, m), ``rollover`` (tilt beyond 45 deg, rad), ``at goal`` and ``at NAME`` (m inside
the goal's area or beyond its gate; laps for a goal of laps), ``at red`` (m of the front beyond a stop line that it had
not passed when its light became red).
"""

from mirdrake.requirements.judging import Finding, Requirement
from mirdrake.requirements.observation import Event, Observation, observe, outline
from mirdrake.requirements.parser import parse_requirement
from mirdrake.requirements.terms import COUNTS
from mirdrake.vehicles.outline import Outline

__all__ = [
    "COUNTS", "Event", "Finding", "Observation", "Outline", "Requirement", "observe", "outline", "parse_requirement",
]  # fmt: skip
