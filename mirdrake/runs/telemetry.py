"""Telemetry: named signals with units, the columns of signals.parquet, from the vectors that Drake logs.

Only raw vectors are logged during a simulation. Derived signals, such as roll and pitch or the lateral error on the
track, are computed here for a whole block of samples at once.
"""

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import Context
from pydrake.systems.primitives import VectorLogSink

from mirdrake.assembly.diagram import Assembly, Tap
from mirdrake.core.vectors import STATE
from mirdrake.plant.plant import VehicleInPlant
from mirdrake.sensors.ground_truth import vehicle_state
from mirdrake.vehicles import WHEELS
from mirdrake.vehicles.geometry import VehicleGeometry
from mirdrake.worlds import World
from mirdrake.worlds.tracks import Track

Array = NDArray[np.float64]

LEAP = 1.0
"""Excess of a change of progress over twice the distance travelled that indicates another section of the road [m]."""

Columns = dict[str, Array]


class Telemetry:
    """Reader of the logs of a running assembly, block by block.

    Attributes:
        units: unit of every column, "" for pure numbers.

    Args:
        assembly: the built diagram.
    """

    def __init__(self, assembly: Assembly) -> None:
        self._assembly = assembly
        self._progress: dict[str, float] = {}
        self._start: dict[str, float] = {}
        self.units: dict[str, str] = {"time": "s"}

    def read(self, context: Context) -> tuple[Array, Columns]:
        """Return all samples since the last call, and clear the logs.

        Args:
            context: Context of the whole diagram.

        Returns:
            times [s] (n), and the columns by name, n samples each.
        """
        assembly = self._assembly
        logs: dict[VectorLogSink, Array] = {}
        times: Array = np.empty(0)
        # Copies, because Clear and the next step overwrite the buffers that Drake returns as views.
        for sink in {tap.sink for tap in assembly.taps.values()}:
            log = sink.FindMutableLog(context)
            taken, logs[sink] = log.sample_times().copy(), log.data().copy()
            log.Clear()
            # All sinks publish at the same times; the shortest log has the samples that every log has, also after an
            # error in a block.
            times = taken if len(logs) == 1 or taken.size < times.size else times
        raw = {name: logs[tap.sink][tap.rows, : times.size] for name, tap in assembly.taps.items()}
        columns: Columns = {}
        if "plant_state" not in raw:
            return times, columns
        for part in assembly.parts.vehicles.values():
            self._add_vehicle(columns, part, raw)
        # Poses of props: no velocities are recorded, so zeros stand in and only the first six signals are kept.
        for name, body in assembly.parts.props.bodies.items():
            pose = raw["plant_state"][body.floating_positions_start() :][:7]
            for signal, values in zip(STATE[:6], vehicle_state(pose, np.zeros((6, times.size))), strict=False):
                self._put(columns, f"props.{name}.{signal.name}", values, signal.unit)
        if "actors" in assembly.taps:
            self._add_named(columns, assembly.taps["actors"], raw["actors"], prefix="actors")
        # Lights follow a fixed programme in time, so their state is computed, not logged.
        for name, light in assembly.parts.world.lights.items():
            self._put(columns, f"signals.{name}", light.state(times), "")
        for kind in ("wheel_load", "resistance", "other_contacts"):
            for name in (kind, *(f"{vehicle}.{kind}" for vehicle in assembly.parts.vehicles)):
                if name in raw:
                    self._add_named(columns, assembly.taps[name], raw[name], prefix="")
        # Sensors and user systems may have several ports, each its own tap `<system>.<port>`.
        for sensor in (f"{vehicle}.{sensor}" for vehicle, names in assembly.spec.sensors.items() for sensor in names):
            for name in raw:
                if name == sensor or name.startswith(f"{sensor}."):
                    self._add_named(columns, assembly.taps[name], raw[name], prefix=name)
        for system in assembly.spec.systems:
            for name, tap in assembly.taps.items():
                if name.startswith(f"{system}."):
                    self._add_named(columns, tap, raw[name], prefix=name)
        for name, tap in assembly.taps.items():
            if tap.is_chosen:
                self._add_named(columns, tap, raw[name], prefix="")
        return times, columns

    def _put(self, columns: Columns, name: str, values: Array, unit: str) -> None:
        columns[name] = values
        self.units[name] = unit

    def _add_named(self, columns: Columns, tap: Tap, values: Array, *, prefix: str) -> None:
        """Add a column per element, named by the port's signals, or numbered if it does not declare any."""
        for index, row in enumerate(values):
            if tap.contents is None:
                name = prefix if len(values) == 1 else f"{prefix}.{index}"
                self._put(columns, name, row, "")
            else:
                # A port with a single element takes the name of the port; otherwise each signal adds its own name.
                signal = tap.contents[index]
                name = signal.name if not prefix else prefix if len(values) == 1 else f"{prefix}.{signal.name}"
                self._put(columns, name, row, signal.unit)

    def _add_vehicle(self, columns: Columns, part: VehicleInPlant, raw: dict[str, Array]) -> None:
        """Add pose, twist, joints, commands and track coordinates of one vehicle."""
        # Drake's state is [q, v]; a floating base has 7 positions (quaternion first) and 6 velocities (angular first).
        x, plant, name = raw["plant_state"], self._assembly.parts.plant, part.name
        positions = plant.num_positions()
        pose = x[part.base.floating_positions_start() :][:7]
        twist = x[positions + part.base.floating_velocities_start_in_v() :][:6]
        state = np.array(vehicle_state(pose, twist, part.period))
        for signal, values in zip(STATE, state, strict=True):
            self._put(columns, f"{name}.{signal.name}", values, signal.unit)
        for side, joint in zip(("left", "right"), part.steering, strict=True):
            self._put(columns, f"{name}.steering_angle.{side}", x[joint.position_start()], "rad")
        for wheel, joint in zip(WHEELS, part.wheels, strict=True):
            angle = (
                x[joint.position_start()] - 0.5 * part.period * x[positions + joint.velocity_start()]
            )  # as for the pose
            self._put(columns, f"{name}.wheel_angle.{wheel}", angle, "rad")
        for wheel, joint in zip(WHEELS, part.wheels, strict=True):
            self._put(columns, f"{name}.wheel_speed.{wheel}", x[positions + joint.velocity_start()], "rad/s")
        for wheel, joint in zip(WHEELS, part.suspension, strict=False):  # none without springs
            rate = x[positions + joint.velocity_start()]
            self._put(columns, f"{name}.travel.{wheel}", x[joint.position_start()] - 0.5 * part.period * rate, "m")
        # The logged torques are those of this model instance only, while input_start counts over the whole plant.
        torques = raw[f"{name}.joint_torques"]
        first = min(plant.get_joint_actuator(i).input_start() for i in plant.GetJointActuatorIndices(part.instance))
        for wheel, actuator in zip(WHEELS, part.wheel_actuators, strict=True):
            self._put(columns, f"{name}.wheel_torque.{wheel}", torques[actuator.input_start() - first], "N m")
        # Commands and status values share names such as steering_angle; the suffix keeps them apart.
        for port, suffix in (("status", ""), ("command", "_command")):
            tap = self._assembly.taps.get(f"{name}.{port}")
            if tap is None or tap.contents is None:
                continue
            for signal, values in zip(tap.contents, raw[tap.name], strict=True):
                # The stamp is a time of the message, not a signal of the vehicle.
                if signal.name != "stamp":
                    self._put(columns, f"{name}.{signal.name}{suffix}", values, signal.unit)
        if (tap := self._assembly.taps.get(f"{name}.powertrain_status")) is not None:
            self._add_named(columns, tap, raw[tap.name], prefix=f"{name}.powertrain")
        if (tap := self._assembly.taps.get(f"{name}.tyre_forces")) is not None:
            self._add_named(columns, tap, raw[tap.name], prefix="")
        if (tap := self._assembly.taps.get(f"{name}.battery_status")) is not None:
            self._add_named(columns, tap, raw[tap.name], prefix=f"{name}.battery")
        if (tap := self._assembly.taps.get(f"{name}.rear_steering")) is not None:
            self._add_named(columns, tap, raw[tap.name], prefix=name)
        self._add_track(columns, part, state)

    def _add_track(self, columns: Columns, part: VehicleInPlant, state: Array) -> None:
        """Add the track coordinates of a vehicle, and the number of its wheels on a road."""
        world, name = self._assembly.parts.world, part.name
        px, py, yaw = state[0], state[1], state[5]
        self._put(columns, f"{name}.wheels_on_road", wheels_on_road(world, part.vehicle.geometry, px, py, yaw), "")
        track_name = self._assembly.tracks[name]
        if track_name is None or px.size == 0:
            return
        track = world.tracks[track_name]
        # s continues from the last block, so that a crossing at the border of two blocks does not change the section.
        s, lateral = _follow(track, px, py, self._progress.get(name))
        _, _, direction = track.pose(s)
        last = self._progress.get(name, float(s[0]))
        if track.closed:
            # Unroll s over the start line: a step of nearly a whole length is a lap forward (-1) or backward (+1).
            turns = np.round(np.diff(s, prepend=np.mod(last, track.length)) / track.length)
            # Sum of the turns inside the block plus the laps of the blocks before, so
            # that laps do not restart per block.
            unrolled = s - track.length * np.cumsum(turns) + np.floor(last / track.length) * track.length
        else:
            unrolled = s
        self._progress[name] = float(unrolled[-1])
        start = self._start.setdefault(name, float(unrolled[0]))
        self._put(columns, f"{name}.progress", s, "m")
        self._put(columns, f"{name}.lateral_error", lateral, "m")
        # Wrapped to [-pi, pi): the difference of two headings may be off by whole turns.
        heading = np.mod(yaw - direction + np.pi, 2.0 * np.pi) - np.pi
        self._put(columns, f"{name}.heading_error", heading, "rad")
        self._put(columns, f"{name}.curvature", track.curvature(s), "1/m")
        if track.closed:
            # Laps count from where the vehicle started, not from the start line of the track.
            self._put(columns, f"{name}.lap", (unrolled - start) / track.length, "")


def wheels_on_road(world: World, geometry: VehicleGeometry, x: Array, y: Array, yaw: Array) -> Array:
    """Return the number of wheels of a vehicle on a road (n); four in a world without roads.

    Args:
        world: world with the roads.
        geometry: dimensions of the vehicle.
        x: positions of its origin (n) [m].
        y: the same (n) [m].
        yaw: heading (n) [rad].
    """
    base, front, rear = geometry.wheelbase, geometry.front_track / 2.0, geometry.rear_track / 2.0
    cos, sin = np.cos(yaw), np.sin(yaw)
    # Wheel centres in the vehicle frame: origin on the rear axle, x forward, y to the left (ISO 8855).
    corners = ((base, front), (base, -front), (0.0, rear), (0.0, -rear))
    on_road = [world.on_road(x + a * cos - b * sin, y + a * sin + b * cos) for a, b in corners]
    count: Array = np.count_nonzero(on_road, axis=0).astype(float)
    return count


def _follow(track: Track, x: Array, y: Array, last: float | None) -> tuple[Array, Array]:
    """Return the track coordinates of a path; where the track crosses itself, they stay on the same section.

    Args:
        track: the track.
        x: positions [m] (n).
        y: positions [m] (n).
        last: s before the first position, in any lap [m]; None at the start.
    """
    s, lateral = track.project(x, y)
    if not s.size:
        return s, lateral
    # project returns s within one lap, so the last value is reduced to the same range before the comparison.
    near = float(s[0] if last is None else np.mod(last, track.length) if track.closed else last)
    leaps = np.abs(np.diff(s, prepend=near))
    # Over the start line of a closed track, the shorter way round is the real change of s.
    if track.closed:
        leaps = np.minimum(leaps, track.length - leaps)
    # The nearest point jumps where the track crosses itself; only then is the slower search sample by sample needed.
    if (leaps > 2.0 * np.hypot(np.diff(x, prepend=x[0]), np.diff(y, prepend=y[0])) + LEAP).any():
        for i in range(x.size):
            near, lateral[i] = track.project(float(x[i]), float(y[i]), near=near)
            s[i] = near
    return s, lateral
