"""Cars of a batch on a track: set-points with limits, speed loop, place on the centre line, and resets, compiled.

The centre line is a table with constant spacing, see :mod:`mirdrake.controllers.path_law`. A point is projected from
the last place.
"""

import math
from typing import Any, NamedTuple

from mirdrake.batched.arrays import Floats
from mirdrake.batched.kernels import KERNEL_PARTS, Fleet, steps_of_car, write_state
from mirdrake.controllers.ackermann import SteeringNumbers, approach
from mirdrake.controllers.cruise import cruise_step
from mirdrake.controllers.path_law import PathNumbers, Place, project
from mirdrake.core.maths import wrap_angle
from mirdrake.core.pid import PidLimits, pid_step, read_pid, write_pid
from mirdrake.plant.powertrain.actuator import ActuatorNumbers, actuator_step, follow
from mirdrake.single_track.dynamics import Inputs, LateralForce, State, read_state

SIGNALS = (
    "x", "y", "yaw", "vx", "vy", "wz", "speed_setpoint", "steering_setpoint", "speed_trim", "lateral_error",
    "heading_error", "progress", "wheels_on_road", "curvature",
)  # fmt: skip
"""Signals of a car on a track, by their names in a run; the curvature at further distances follows."""

SETPOINTS, PID = 0, 2
"""Indices in the memory of a car: last set-points of speed and steering, state of the speed loop."""

ACTUATOR = PID + 9
"""Start of the steering actuator in the memory."""


class LaneNumbers(NamedTuple):
    """Numbers of the control unit and the track.

    Attributes:
        fastest: largest magnitude of the speed set-point [m/s].
        acceleration: largest rate of increase of the speed set-point [m/s²].
        deceleration: largest rate of decrease of the speed set-point [m/s²].
        steering: numbers of the steering law.
        actuator: numbers of the steering actuator.
        actuator_size: length of its memory.
        speed_limits: limits of the trim [m/s].
        true_over_assumed: true over assumed radius of the wheels [1].
        force_per_acceleration: feed-forward of the drive force over the slope of the speed set-point [kg].
        period: control period [s].
        path: numbers of the track.
        wheelbase: [m].
        front: half of the front track [m].
        rear: half of the rear track [m].
    """

    fastest: float
    acceleration: float
    deceleration: float
    steering: SteeringNumbers
    actuator: ActuatorNumbers
    actuator_size: int
    speed_limits: PidLimits
    true_over_assumed: float
    force_per_acceleration: float
    period: float
    path: PathNumbers
    wheelbase: float
    front: float
    rear: float


def drive_on_track(
    law: LateralForce,
    cars: Fleet,
    lanes: Any,
    gains: Any,
    tables: Floats,
    distances: Floats,
    setpoints: Floats,
    periods: int,
    step: float,
    steps: int,
    memory: Floats,
    progress: Floats,
    signals: Floats,
    first: int,
    last: int,
) -> None:
    """Advance cars on a track under set-points that are held, and write their signals.

    Args:
        law: lateral force of an axle.
        cars: all cars.
        lanes: one record of :class:`LaneNumbers`.
        gains: gains of the speed loop, one record.
        tables: centre line (points, 6): x [m], y [m], yaw [rad], curvature [1/m], left and right width [m].
        distances: distances ahead at which the curvature is read [m].
        setpoints: speed [m/s] and steering [rad] of each car (n, 2).
        periods: number of control periods; 0: only write the signals.
        step: step of the integration [s].
        steps: steps in a control period.
        memory: memory of each control unit (n, memory), updated.
        progress: arc length of each car (n) [m], updated.
        signals: :data:`SIGNALS`, then the curvatures ahead (n, signals), overwritten.
        first: first car.
        last: car after the last one.
    """
    lane = lanes[0]
    for i in range(first, last):
        if cars.diverged[i]:
            continue
        x = read_state(cars.states[i], cars.positions)
        # Without control periods only the signals are written, for cars that were just placed.
        trim = 0.0
        for _ in range(periods):
            u, trim = _control(lane, gains[0], memory[i], setpoints[i, 0], setpoints[i, 1], x.vx)
            alive, x = steps_of_car(law, cars, i, x, u, step, steps)
            if not alive:
                cars.diverged[i] = True
                break
        write_state(cars.states[i], cars.positions, x)
        if cars.diverged[i]:
            continue
        # Newton's method starts from the predicted arc length, so that one or two steps suffice at any speed.
        _, place = project(lane.path, tables, x.x, x.y, progress[i] + x.vx * periods * lane.period)
        # Beyond the ends of an open track the nearest point is the end itself.
        progress[i] = place.s if lane.path.closed else min(max(place.s, 0.0), lane.path.length)
        place = Place(progress[i], place.lateral, place.yaw, place.curvature)
        _write_signals(lane, tables, distances, cars.parameters[i].rear_length, x, memory[i], trim, place, signals[i])


def _control(
    lane: Any, gains: Any, memory: Any, speed_command: float, steering_command: float, measured: float
) -> tuple[Inputs, float]:
    """Return the inputs of the model for a control period and the trim of the speed [m/s]; the memory is updated.

    The steps are those of :func:`mirdrake.controllers.control_step.control_step` for a vehicle with servos, without the
    angles of single wheels.
    """
    last_speed = memory[SETPOINTS]
    # Limits are those of the magnitude of the speed: in reverse, braking increases the signed set-point.
    up, down = lane.acceleration * lane.period, lane.deceleration * lane.period
    if last_speed < 0.0:
        up, down = down, up
    speed_command = min(max(speed_command, -lane.fastest), lane.fastest)
    speed = min(max(speed_command, last_speed - down), last_speed + up)
    steering = approach(lane.steering, memory[SETPOINTS + 1], steering_command, lane.period)
    memory[SETPOINTS], memory[SETPOINTS + 1] = speed, steering
    # The last element of the actuator's memory is its output; the servo of the model also needs its rate.
    before = memory[ACTUATOR + lane.actuator_size - 1]
    angle = actuator_step(memory, ACTUATOR, lane.actuator_size, steering, lane.actuator)
    loop, trimmed = cruise_step(read_pid(memory, PID), speed, measured, lane.period, gains, lane.speed_limits)
    write_pid(memory, PID, loop)
    # Feed-forward of the drive force by the set-point before the trim: the trim corrects the speed only.
    rate, drive = (angle - before) / lane.period, lane.force_per_acceleration * (speed - last_speed) / lane.period
    return Inputs(angle, drive, 0.0, rate, trimmed * lane.true_over_assumed), trimmed - speed


def _interval(path: PathNumbers, s: float) -> int:
    """Return the interval of the tables that contains an arc length; the first or last one beyond the ends."""
    if path.closed:
        s %= path.length
    return min(max(int(s / path.spacing), 0), path.last)


def _write_signals(
    lane: Any,
    tables: Floats,
    distances: Floats,
    rear_length: float,
    x: State,
    memory: Any,
    trim: float,
    place: Place,
    row: Any,
) -> None:
    """Write the signals of a car."""
    # The yaw of the model counts whole turns.
    heading = wrap_angle(x.yaw - place.yaw)
    row[0], row[1], row[2] = x.x, x.y, wrap_angle(x.yaw)
    # The model's vy is that of the centre of mass; signals are those of the rear axle's centre, as in a run.
    row[3], row[4], row[5] = x.vx, x.vy - rear_length * x.yaw_rate, x.yaw_rate
    row[6], row[7], row[8] = memory[SETPOINTS], memory[SETPOINTS + 1], trim
    row[9], row[10], row[11] = place.lateral, heading, place.s
    row[12], row[13] = _wheels_on_road(lane, tables, place, heading), tables[_interval(lane.path, place.s), 3]
    for j in range(len(distances)):
        row[14 + j] = tables[_interval(lane.path, place.s + distances[j]), 3]


def _wheels_on_road(lane: Any, tables: Floats, place: Place, heading: float) -> float:
    """Return the number of wheels between the edges of the track.

    A wheel at (l, w) in the axes of the car has the offset e + l sin θ + w cos θ - κ l² / 2 from the centre line, with
    θ the heading error and an error of the order κ² l³.
    """
    cosine, sine, wheels = math.cos(heading), math.sin(heading), 0.0
    for axle in range(2):
        ahead, half = (lane.wheelbase, lane.front) if axle == 0 else (0.0, lane.rear)
        for side in range(2):
            w = half if side == 0 else -half
            # Widths are read at the wheel's own place along the line, as a track may widen.
            along = ahead * cosine - w * sine
            offset = place.lateral + ahead * sine + w * cosine - 0.5 * place.curvature * along * along
            i = _interval(lane.path, place.s + along)
            if -tables[i, 5] <= offset <= tables[i, 4]:
                wheels += 1.0
    return wheels


LANE_PARTS: tuple[Any, ...] = (
    *KERNEL_PARTS, _control, project, _interval, _write_signals, _wheels_on_road, approach, cruise_step,
    pid_step, read_pid, write_pid, actuator_step, follow,
)  # fmt: skip
"""Functions that :func:`drive_on_track` calls."""
