"""Signals of a running diagram by name, and their ranges.

Names are those of a run's signals: ``ego.vx``, ``ego.lateral_error``, ``ego.imu.wz``, ``notch.y``. Only the ports that
are asked for are evaluated.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import inf, pi

import numpy as np
from pydrake.systems.framework import Context, OutputPort, PortDataType, System

from mirdrake.assembly.diagram import Assembly
from mirdrake.controllers.ackermann import make_steering_law
from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.signals import Signal, signals_of
from mirdrake.plant.plant import VehicleInPlant
from mirdrake.runs.telemetry import wheels_on_road
from mirdrake.vehicles import WHEELS

TOP_SPEED = 50.0
"""Largest speed of the observations, also for vehicles without a speed limit [m/s]."""

LARGE = 1e6
"""Bound of a signal without a known range; Gymnasium requires finite bounds."""

AHEAD = "curvature_ahead"
"""Prefix of the curvature ahead: ``ego.curvature_ahead.20`` is the curvature of the track 20 m ahead [1/m]."""


@dataclass(frozen=True)
class Reading:
    """Signal of a diagram.

    Attributes:
        name: name of the signal in a run.
        unit: unit; "" for a pure number.
        low: smallest plausible value.
        high: largest plausible value.
        read: function of the Context of the diagram that returns the value.
    """

    name: str
    unit: str
    low: float
    high: float
    read: Callable[[Context], float]


class Readings:
    """Signals of a built diagram.

    Args:
        assembly: the built diagram.
    """

    def __init__(self, assembly: Assembly) -> None:
        self._assembly = assembly
        self._systems: dict[str, System] = {system.get_name(): system for system in assembly.diagram.GetSystems()}
        self.known: dict[str, Reading] = {}
        for name, part in assembly.parts.vehicles.items():
            self.known |= {reading.name: reading for reading in self._of_vehicle(name, part)}
        contacts = self._port_of_others()
        self.known["other_contacts"] = Reading("other_contacts", "", 0.0, LARGE, _reader(*contacts, 0))
        # Only the user's blocks and sensors: systems that the assembly adds are not signals of a run.
        own = [*assembly.spec.systems, *(f"{v}.{s}" for v, names in assembly.spec.sensors.items() for s in names)]
        for name in own:
            if name in self._systems:
                self.known |= {reading.name: reading for reading in self._of_system(name, self._systems[name])}

    def find(self, name: str, *, bounds: Mapping[str, Sequence[float]] | None = None) -> list[Reading]:
        """Return the signals of a name: the signal itself, or all whose names begin with it.

        Args:
            name: name of a signal, or of a port or sensor with several signals.
            bounds: other ranges, by name.

        Raises:
            ConfigError: the signal is unknown, or a range is empty.
        """
        # Curvatures ahead are made on demand, as any distance is allowed.
        vehicle, _, rest = name.partition(".")
        if rest.startswith(f"{AHEAD}.") and self._assembly.tracks.get(vehicle):
            self.known.setdefault(name, self._ahead(name, vehicle, rest.removeprefix(f"{AHEAD}.")))
        readings = [self.known[name]] if name in self.known else []
        readings = readings or [reading for full, reading in self.known.items() if full.startswith(f"{name}.")]
        if not readings:
            raise ConfigError(f"the diagram has no signal '{name}'; {did_you_mean(name, self.known)}")
        # The range of a single signal comes before that of its group.
        ranges = bounds or {}
        return [_within(reading, ranges.get(reading.name, ranges.get(name))) for reading in readings]

    def _of_vehicle(self, name: str, part: VehicleInPlant) -> Iterator[Reading]:
        """Add ground truth, track coordinates and set-points of one vehicle."""
        assembly = self._assembly
        truth, control = self._systems[f"{name}.truth"], self._systems[f"{name}.control"]
        # Ranges only bound the observation space, so they are generous; observations are clipped to them.
        left, south, right, north = assembly.parts.world.ground.extent
        speed, turn = top_speed(part), 10.0
        spin = 2.0 * speed / min(part.vehicle.geometry.wheel_radii)
        limit = part.vehicle.geometry.steering_limit
        ranges = {
            "x": (left, right), "y": (south, north), "z": (-10.0, 100.0),
            "roll": (-pi, pi), "pitch": (-pi / 2, pi / 2), "yaw": (-pi, pi),
            "vx": (-speed, speed), "vy": (-speed, speed), "vz": (-speed, speed),
            "wx": (-turn, turn), "wy": (-turn, turn), "wz": (-turn, turn),
        }  # fmt: skip
        for signal, index, port in _elements(truth.GetOutputPort("state")):
            yield Reading(f"{name}.{signal.name}", signal.unit, *ranges[signal.name], _reader(truth, port, index))
        for group, prefix, range_ in (
            ("wheel_speeds", "wheel_speed", (-spin, spin)),
            ("steering_angles", "steering_angle", (-limit, limit)),
        ):
            for signal, index, port in _elements(truth.GetOutputPort(group)):
                yield Reading(f"{name}.{prefix}.{signal.name}", signal.unit, *range_, _reader(truth, port, index))
        # Set-points come from the control unit, not from the truth: they are what it has limited.
        wanted = {"speed_setpoint": speed, "steering_setpoint": limit, "speed_trim": speed}
        for signal, index, port in _elements(control.GetOutputPort("status")):
            bound = wanted[signal.name]
            yield Reading(f"{name}.{signal.name}", signal.unit, -bound, bound, _reader(control, port, index))
        # Readings for rewards that no sensor has.
        yield Reading(f"{name}.wheels_on_road", "", 0.0, float(len(WHEELS)), self._wheels_on_road(truth, part))
        track_name = assembly.tracks[name]
        if track_name is None:
            return
        track = assembly.parts.world.tracks[track_name]
        # The diagonal of the ground bounds any distance from a line on it.
        wide = float(np.hypot(right - left, north - south))
        path = truth.GetOutputPort("path")
        names = {"lateral": "lateral_error", "heading": "heading_error", "progress": "progress"}
        spans = {"lateral": (-wide, wide), "heading": (-pi, pi), "progress": (0.0, track.length)}
        for signal, index, port in _elements(path):
            full = f"{name}.{names[signal.name]}"
            yield Reading(full, signal.unit, *spans[signal.name], _reader(truth, port, index))
        yield self._ahead(f"{name}.curvature", name, "0")

    def _ahead(self, full: str, vehicle: str, metres: str) -> Reading:
        """Return the curvature of the track at a distance ahead."""
        try:
            distance = float(metres)
        except ValueError:
            distance = -1.0
        if not 0.0 <= distance < inf:
            raise ConfigError(f"'{full}': '{metres}' is not a distance in m; write for example {vehicle}.{AHEAD}.20")
        track = self._assembly.parts.world.tracks[str(self._assembly.tracks[vehicle])]
        progress = _reader(
            self._systems[f"{vehicle}.truth"], self._systems[f"{vehicle}.truth"].GetOutputPort("path"), 2
        )

        def curvature(context: Context) -> float:
            s = progress(context) + distance
            # Ahead of the end of an open track the curvature of its end is read.
            s = s % track.length if track.closed else min(s, track.length)
            return float(track.curvature(s))

        return Reading(full, "1/m", -1.0, 1.0, curvature)

    def _wheels_on_road(self, truth: System, part: VehicleInPlant) -> Callable[[Context], float]:
        """Return the function that counts the wheels on a road."""
        world, geometry, state = self._assembly.parts.world, part.vehicle.geometry, truth.GetOutputPort("state")

        def count(context: Context) -> float:
            values = state.Eval(truth.GetMyContextFromRoot(context))
            return float(wheels_on_road(world, geometry, values[0:1], values[1:2], values[5:6])[0])

        return count

    def _of_system(self, name: str, system: System) -> Iterator[Reading]:
        """Add the vector outputs of a sensor or user block, with the names of their elements in a run."""
        ports = [system.get_output_port(index) for index in range(system.num_output_ports())]
        for port in ports:
            if port.get_data_type() != PortDataType.kVectorValued:
                continue
            # Drake's names of single outputs are those that a run shortens to y, or to the name of the sensor alone.
            word = port.get_name()
            word = {"y0": "y", "delayed_u": "y"}.get(word, word) if len(ports) == 1 else word
            prefix = name if word == "sample" else f"{name}.{word}"
            for signal, index, _ in _elements(port):
                full = prefix if port.size() == 1 else f"{prefix}.{signal.name}"
                yield Reading(full, signal.unit, -LARGE, LARGE, _reader(system, port, index))

    def _port_of_others(self) -> tuple[System, OutputPort]:
        """Return the port that counts contacts of vehicles other than tyres on the road."""
        system = next(system for system in self._systems.values() if system.HasOutputPort("other_contacts"))
        return system, system.GetOutputPort("other_contacts")


def top_speed(part: VehicleInPlant) -> float:
    """Return the top speed of motor or governor, at most the largest set-point and :data:`TOP_SPEED` [m/s]."""
    # The smallest wheel gives the lowest speed for a motor speed.
    ahead, _ = part.vehicle.spec.powertrain.top_speeds(min(part.vehicle.geometry.wheel_radii))
    return min(ahead, part.vehicle.control.speed.max_speed or TOP_SPEED, TOP_SPEED)


def steering_limit(part: VehicleInPlant) -> float:
    """Return the largest bicycle steering angle of a vehicle [rad]."""
    steering = part.vehicle.spec.steering
    return float(make_steering_law(part.vehicle.geometry, steering.law, factor=steering.factor).limit)


def _elements(port: OutputPort) -> list[tuple[Signal, int, OutputPort]]:
    known = signals_of(port) or [Signal(str(index), "") for index in range(port.size())]
    return [(signal, index, port) for index, signal in enumerate(known)]


def _reader(system: System, port: OutputPort, index: int) -> Callable[[Context], float]:
    return lambda context: float(port.Eval(system.GetMyContextFromRoot(context))[index])


def _within(reading: Reading, bounds: Sequence[float] | None) -> Reading:
    if bounds is None:
        return reading
    low, high = check_bounds(bounds, reading.name)
    return Reading(reading.name, reading.unit, low, high, reading.read)


def check_bounds(bounds: Sequence[float], name: str) -> tuple[float, float]:
    """Return a range as two finite numbers, of which the second is larger.

    Raises:
        ConfigError: the bounds are not such a range.
    """
    try:
        low, high = (float(value) for value in bounds)
    except (TypeError, ValueError):
        raise ConfigError(f"bounds of '{name}': {bounds!r} are not two numbers (low, high)") from None
    if not -inf < low < high < inf:
        raise ConfigError(f"bounds of '{name}': low {low:g} must be below high {high:g}, both finite")
    return low, high
