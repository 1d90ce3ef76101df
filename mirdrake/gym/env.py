"""The Gymnasium environment: a diagram that takes an action, runs for one period, and returns an observation."""

from collections.abc import Mapping, Sequence
from math import isfinite
from pathlib import Path
from typing import Any, ClassVar

import gymnasium
import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import Context, EventStatus
from pydrake.systems.primitives import ConstantVectorSource

from mirdrake.assembly.diagram import DiagramSpec, assemble, load_diagram, make_spec
from mirdrake.assembly.diagram_spec import SystemEntry
from mirdrake.assembly.wiring import JOIN
from mirdrake.core.errors import ConfigError, did_you_mean, first_line
from mirdrake.core.json_io import finite_or_none
from mirdrake.core.leaf_system import weak_callback
from mirdrake.gym.judging import ENDS, REWARDS, STARTS, End, Moment, Reward, Starts, find_function
from mirdrake.gym.readings import Readings, check_bounds, steering_limit, top_speed
from mirdrake.plant.plant import set_start
from mirdrake.plant.powertrain import PEDALS
from mirdrake.plant.wheels import RoadFriction

Array = NDArray[np.float32]
Info = dict[str, Any]
"""Gymnasium's dictionaries of options and information."""

_SPEED, _STEERING, _STAMP = JOIN
_PEDALS = "pedals_reference"
_ELEMENTS = {_PEDALS: [signal.name for signal in PEDALS]}
_AT_REST = {f"{_PEDALS}.gear": 1.0}


class DriveEnv(gymnasium.Env[Array, Array]):
    """Environment in which an action drives a vehicle of a diagram file for one period.

    An action is a vector of numbers from -1 to 1, scaled to the range of each input; :attr:`action_bounds` has the
    ranges in SI units. An observation is a vector of signals in SI units, clipped to the observation space.

    Python code runs at the rates of control unit, driver and sensors, not in every step of the plant, unless the
    friction of the ground varies.

    Args:
        diagram: name, file, spec or data of a diagram.
        overrides: ``"dotted.path=value"`` texts merged over the file, for example ``"plant.contact=point"``.
        vehicle: name of the controlled vehicle; by default the first of the file.
        observe: signals by their names in a run; also ports and sensors with several signals, and
            ``ego.curvature_ahead.20``. By default speed, yaw rate, steering and, on a track, lateral and heading error
            and the curvature at the vehicle, 10 m and 20 m ahead.
        act: inputs of the diagram: ``ego.speed_reference``, ``ego.steering_reference``,
            ``ego.pedals_reference.throttle``, inputs of your blocks, …; by default speed and steering of the vehicle.
            They replace the connections of the file to these inputs.
        bounds: other ranges by name, (low, high); required for inputs of user systems.
        rate: steps per second [Hz].
        reward: ``progress``, ``centred_progress``, ``module:name``, or a function of a :class:`Moment`.
        ends: termination conditions: ``off_road``, ``collision``, ``rollover``, ``module:name`` or functions.
        start: starts of the vehicles: ``anywhere_on_track``, ``module:name`` or a function; by default those of the
            file.
        duration: time after which an episode is truncated [s]; by default that of the file.
        render_mode: must be None; ``mirdrake run`` shows a run.

    Attributes:
        observation_names: names of the elements of an observation.
        observation_units: units of the elements of an observation.
        action_names: names of the elements of an action.
        action_bounds: ranges of the elements of an action (n, 2).
        assembly: the built diagram.

    Raises:
        ConfigError: a name is unknown, or a range or rate is not allowed.
    """

    metadata: ClassVar[dict[str, list[str]]] = {"render_modes": []}

    def __init__(
        self,
        diagram: DiagramSpec | Mapping[str, Any] | str = "bolt_test_track",
        *,
        overrides: Sequence[str] = (),
        vehicle: str | None = None,
        observe: Sequence[str] | None = None,
        act: Sequence[str] | None = None,
        bounds: Mapping[str, Sequence[float]] | None = None,
        rate: float = 10.0,
        reward: str | Reward = "progress",
        ends: Sequence[str | End] = ("off_road", "collision", "rollover"),
        start: str | Starts | None = None,
        duration: float | None = None,
        render_mode: str | None = None,
    ) -> None:
        # A deep copy, as blocks and connections are inserted below: the caller's spec stays as it was.
        spec = load_diagram(diagram, overrides=overrides) if isinstance(diagram, str) else diagram
        spec = spec.model_copy(deep=True) if isinstance(spec, DiagramSpec) else make_spec(spec)
        self.vehicle = next(iter(spec.vehicles)) if vehicle is None else vehicle
        if self.vehicle not in spec.vehicles:
            raise ConfigError(f"no vehicle '{vehicle}' in the diagram; {did_you_mean(vehicle, spec.vehicles)}")
        if not (isfinite(rate) and rate > 0.0):
            raise ConfigError(f"rate {rate} Hz is not allowed; it must be above 0")
        self.render_mode, self.period = render_mode, 1.0 / rate
        self.duration = spec.duration if duration is None else duration
        # The diagram, with a block that holds each action, and the functions of the user.
        inputs = list(act) if act is not None else [f"{self.vehicle}.{_SPEED}", f"{self.vehicle}.{_STEERING}"]
        self._inputs = _insert_actions(spec, inputs, set(bounds or {}))
        self.assembly = assemble(spec)
        folder = Path(spec.folder) if spec.folder is not None else None
        self.reward: Reward = find_function(reward, REWARDS, what="reward", folder=folder)
        self.ends: list[tuple[str, End]] = [
            (end if isinstance(end, str) else getattr(end, "__name__", "end"), function)
            for end in ends
            for function in [find_function(end, ENDS, what="end", folder=folder)]
        ]
        self.start: Starts | None = start and find_function(start, STARTS, what="start", folder=folder)  # type: ignore[assignment]

        # Spaces of observations and actions.
        self.readings = Readings(self.assembly)
        names = list(observe) if observe is not None else self._default_observations()
        # Names may be patterns, each of which gives several observations.
        self._observed = [reading for name in names for reading in self.readings.find(name, bounds=bounds)]
        if not self._observed:
            raise ConfigError("observe: is empty; name at least one signal")
        self.observation_names = [reading.name for reading in self._observed]
        self.observation_units = [reading.unit for reading in self._observed]
        # Single precision, the type that Gymnasium's libraries expect.
        low = np.array([reading.low for reading in self._observed], dtype=np.float32)
        high = np.array([reading.high for reading in self._observed], dtype=np.float32)
        self.observation_space = gymnasium.spaces.Box(low, high, dtype=np.float32)

        self.action_names = [name for source in self._inputs for name in source.acting]
        self.action_bounds = np.array([self._action_range(name, bounds or {}) for name in self.action_names])
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (len(self.action_names),), dtype=np.float32)
        self._check_watchdog()

        self._simulator = self.assembly.make_simulator()
        self._friction = RoadFriction(self.assembly.parts, self.assembly.tyres)
        if self._friction.varies:
            self._simulator.set_monitor(weak_callback(self._watch))
        # Names of the inserted blocks lead to their systems, whose values each step sets.
        systems = {system.get_name(): system for system in self.assembly.diagram.GetSystems()}
        self._sources: list[tuple[_Input, ConstantVectorSource]] = [
            (action_input, systems[action_input.block]) for action_input in self._inputs
        ]
        self._context: Context | None = None
        self._steps = 0

    def reset(self, *, seed: int | None = None, options: Info | None = None) -> tuple[Array, Info]:
        """Start a new episode of the same diagram, without building it again.

        Args:
            seed: seed of random starts; the noise of sensors has the seed of the diagram in each episode.
            options: ``{"start": {"ego": (x, y, yaw, speed)}}`` sets starts of vehicles [m, rad, m/s].

        Returns:
            the first observation, and ``{"time": 0.0}``.
        """
        super().reset(seed=seed)
        assembly = self.assembly
        # A new Context instead of a reset one: state of every system, also of user blocks, starts from its default.
        context = assembly.make_context()
        plant_context = assembly.parts.plant.GetMyMutableContextFromRoot(context)
        places: dict[str, Sequence[float]] = {}
        if self.start is not None:
            starts = self.start(assembly, self.np_random)
            places = {name: (start.x, start.y, start.yaw, start.speed) for name, start in starts.items()}
        # Starts by options come last, so that they override those of the start function.
        places |= (options or {}).get("start", {})
        for name, (x, y, yaw, speed) in places.items():
            if name not in assembly.parts.vehicles:
                raise ConfigError(f"start: no vehicle '{name}'; {did_you_mean(name, assembly.parts.vehicles)}")
            part = assembly.parts.vehicles[name]
            set_start(assembly.parts.plant, plant_context, part, x=x, y=y, yaw=yaw, speed=speed)
        if self._friction.varies:
            self._friction.start()
        self._context, self._steps = context, 0
        # Commands exist before events at time 0: the control unit then starts from the start speed, without a jump.
        self._command(self._at_rest())
        self._simulator.reset_context(context)
        self._simulator.Initialize()
        return self._observation(), {"time": 0.0}

    def step(self, action: Array) -> tuple[Array, float, bool, bool, Info]:
        """Advance by one period with one action.

        Returns:
            observation, reward, terminated, truncated, and an info with ``time`` [s]; ``ended_by`` is the termination
            condition. A state that is not finite ends the episode as ``diverged`` with reward 0. A reward that is not
            finite counts as 0 and is reported as ``bad_reward``.
        """
        if self._context is None:
            raise ConfigError("step: call reset first")
        values = self._command(np.asarray(action, dtype=float))
        # Times are multiples of the period, not sums: rounding would drift away from the control instants.
        self._steps += 1
        info: Info = {}
        truncated = self._steps * self.period >= self.duration - 1e-9
        try:
            self._simulator.AdvanceTo(self._steps * self.period)
            state = self.assembly.parts.plant.GetPositionsAndVelocities(
                self.assembly.parts.plant.GetMyContextFromRoot(self._context)
            )
            # Drake may integrate NaN without an error, hence the test of the state besides the exception.
            diverged = not np.isfinite(state).all()
        except RuntimeError as error:  # Drake cannot continue
            diverged, info["error"] = True, first_line(error)
        info["time"] = self._context.get_time()
        if diverged:
            info["ended_by"] = "diverged"
            return self._observation(diverged=True), 0.0, True, truncated, info
        # Rewards and ends see the same moment, which is evaluated once.
        moment = Moment(info["time"], self.period, values, self.vehicle, self.readings, self._context)
        reward = finite_or_none(self.reward(moment))
        if reward is None:
            info["bad_reward"] = True
        for name, end in self.ends:
            if end(moment):
                info["ended_by"] = name
                break
        return self._observation(), reward or 0.0, "ended_by" in info, truncated, info

    def _command(self, action: NDArray[np.float64]) -> dict[str, float]:
        """Set the inputs from an action, and return it by name in SI units."""
        assert self._context is not None
        low, high = self.action_bounds[:, 0], self.action_bounds[:, 1]
        # NaN of a diverged policy counts as the middle of the range.
        share = np.clip(np.nan_to_num(action), -1.0, 1.0)
        values = dict(zip(self.action_names, (0.5 * (low + high + share * (high - low))).tolist(), strict=True))
        for action_input, source in self._sources:
            vector = [
                values.get(name, rest) for name, rest in zip(action_input.elements, action_input.rest, strict=True)
            ]
            # The stamp is the time of the command: it resets the watchdog of the control unit at every step.
            if action_input.stamp:
                vector = [self._context.get_time()]
            inner = source.GetMyMutableContextFromRoot(self._context)
            source.get_mutable_source_value(inner).SetFromVector(vector)
        return values

    def _at_rest(self) -> NDArray[np.float64]:
        """Return the action before the first one: the speed of the start, and zero for everything else."""
        low, high = self.action_bounds.T
        speeds = {f"{name}.{_SPEED}": start.speed for name, start in self.assembly.starts.items()}
        # Inverse of the scaling of actions; a value out of the range is clipped by _command.
        values = np.array([speeds.get(name, 0.0) for name in self.action_names])
        share: NDArray[np.float64] = 2.0 * (values - low) / (high - low) - 1.0
        return share

    def _observation(self, *, diverged: bool = False) -> Array:
        space = self.observation_space
        assert isinstance(space, gymnasium.spaces.Box)
        if diverged:
            return np.clip(np.zeros(space.shape, dtype=np.float32), space.low, space.high)
        values = np.array([reading.read(self._context) for reading in self._observed], dtype=np.float32)
        clipped: Array = np.clip(np.nan_to_num(values), space.low, space.high)
        return clipped

    def _default_observations(self) -> list[str]:
        name = self.vehicle
        names = [f"{name}.vx", f"{name}.wz", f"{name}.steering_setpoint"]
        if self.assembly.tracks[name] is not None:
            names += [f"{name}.lateral_error", f"{name}.heading_error", f"{name}.curvature"]
            names += [f"{name}.curvature_ahead.10", f"{name}.curvature_ahead.20"]
        return names

    def _action_range(self, name: str, bounds: Mapping[str, Sequence[float]]) -> tuple[float, float]:
        vehicle, _, port = name.partition(".")
        # The user's bounds come first; other ranges follow from what the vehicle can do.
        if name in bounds:
            return check_bounds(bounds[name], name)
        part = self.assembly.parts.vehicles.get(vehicle)
        if part is not None and port == _SPEED:
            return 0.0, top_speed(part)
        if part is not None and port == _STEERING:
            return -steering_limit(part), steering_limit(part)
        if part is not None and port in {f"{_PEDALS}.throttle", f"{_PEDALS}.brake"}:
            return 0.0, 1.0
        raise ConfigError(f"act: the range of '{name}' is not known; give bounds={{'{name}': (low, high)}}")

    def _check_watchdog(self) -> None:
        """Check that the period is below the watchdog timeout, so that no vehicle stops between two steps."""
        for name in [action_input.port.split(".")[0] for action_input in self._inputs if action_input.stamp]:
            timeout = self.assembly.parts.vehicles[name].vehicle.control.dead_man
            if self.period > timeout:
                raise ConfigError(
                    f"rate {1.0 / self.period:g} Hz is too low: the watchdog of {name} stops it after {timeout:g} s "
                    f"without a command; set a rate of {1.0 / timeout:g} Hz or more"
                )

    def _watch(self, context: Context) -> EventStatus:
        self._friction.watch(context)
        return EventStatus.DidNothing()


class _Input:
    """Input port of the diagram and the block that holds its value during a step."""

    def __init__(self, port: str, block: str, elements: list[str], acting: list[str]) -> None:
        self.port, self.block, self.elements, self.acting = port, block, elements, acting
        self.stamp = port.endswith(f".{_STAMP}")
        short = [name.partition(".")[2] for name in elements]
        self.rest = [_AT_REST.get(name, 0.0) for name in short]


def _ports_of(spec: DiagramSpec, names: Sequence[str]) -> dict[str, list[str]]:
    """Return the names of inputs by their ports.

    Raises:
        ConfigError: the list of names is empty, a name is repeated, or it is not below a system or vehicle.
    """
    if not names:
        raise ConfigError("act: is empty; name at least one input")
    repeated = sorted({name for name in names if list(names).count(name) > 1})
    if repeated:
        raise ConfigError(f"act: '{repeated[0]}' is named twice; remove one")
    ports: dict[str, list[str]] = {}
    for name in names:
        # The longest owner, as the name of a system may begin with that of another.
        owner = max((own for own in [*spec.systems, *spec.vehicles] if name.startswith(f"{own}.")), key=len, default="")
        if not owner:
            known = [f"{vehicle}.{port}" for vehicle in spec.vehicles for port in (_SPEED, _STEERING, _PEDALS)]
            raise ConfigError(f"act: '{name}' is not an input of the diagram; {did_you_mean(name, known)}")
        port = name.removeprefix(f"{owner}.").partition(".")[0]
        ports.setdefault(f"{owner}.{port}", []).append(name)
    return ports


def _insert_actions(spec: DiagramSpec, names: Sequence[str], bounded: set[str]) -> list[_Input]:
    """Insert a block that holds a vector before each input that an action sets; the spec is changed."""
    ports = _ports_of(spec, names)
    for vehicle in spec.vehicles:
        # The driver is removed only if both its outputs are replaced; otherwise it still gives the other command and
        # stamps.
        reference = {f"{vehicle}.{_SPEED}", f"{vehicle}.{_STEERING}"}
        if reference <= set(ports):
            spec.control.pop(vehicle, None)  # the actions replace the driver
        if vehicle not in spec.control and reference & set(ports):
            ports[f"{vehicle}.{_STAMP}"] = []
        # Pedals without a driver: speed and steering get constants, as an open input port cannot be evaluated.
        if f"{vehicle}.{_PEDALS}" in ports and vehicle not in spec.control:
            for port in (_SPEED, _STEERING, _STAMP):
                ports.setdefault(f"{vehicle}.{port}", [])
    inputs = []
    for number, (port, acting) in enumerate(ports.items()):
        # The gear is not an action by default but is held at first gear; a range in `bounds` makes it one.
        elements = [f"{port}.{element}" for element in _ELEMENTS.get(port.rpartition(".")[2], [])] or [port]
        if acting == [port] and len(elements) > 1:
            acting = [name for name in elements if name.partition(".")[2] not in _AT_REST or name in bounded]
        for name in acting:
            if name not in elements:
                raise ConfigError(f"act: '{name}' is not an input of the diagram; {did_you_mean(name, elements)}")
        block = f"action_{number}"
        spec.systems[block] = SystemEntry(kind="constant", value=[0.0] * len(elements))
        spec.connect = [pair for pair in spec.connect if pair[1] != port] + [(f"{block}.y", port)]
        inputs.append(_Input(port, block, elements, acting))
    # Recording would cost time and memory in each episode; readings evaluate only the ports that are observed.
    spec.record = spec.record.model_copy(update={"signals": False, "cameras": False, "arrays": False})
    return inputs
