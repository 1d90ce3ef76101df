"""The vector environment: thousands of cars of the single-track model on the track of a diagram, in one call."""

import math
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import ArrayLike, NDArray

from mirdrake.assembly.diagram_spec import DiagramSpec
from mirdrake.batched import Batch
from mirdrake.batched.lane import ACTUATOR, LANE_PARTS, PID, SETPOINTS, SIGNALS, LaneNumbers, drive_on_track
from mirdrake.controllers.ackermann import Ackermann
from mirdrake.controllers.drivable_line import make_centre_line
from mirdrake.controllers.path_tracking import PathTables
from mirdrake.core.compiled import compiled, records
from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.pid import PidGains, PidLimits, PidNumbers, PidState
from mirdrake.gym.env import DriveEnv
from mirdrake.gym.readings import AHEAD
from mirdrake.plant.powertrain import ActuatorLaw
from mirdrake.single_track import estimate_parameters
from mirdrake.single_track.dynamics import Variant, lateral_force_of
from mirdrake.vehicles import Vehicle
from mirdrake.worlds.tracks import Track

Observations = NDArray[np.float32]
Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]

REWARDS = ("progress", "centred_progress")
"""Rewards, as of :mod:`mirdrake.gym.judging`."""

ENDS = ("off_road",)
"""Ends of an episode; the single-track model has neither collisions nor rollover."""

STARTS = ("anywhere_on_track",)
"""Starts besides that of the diagram file."""

MINIMUM_WHEELS = 3.0
"""An episode ends with fewer wheels on the road, as in :func:`mirdrake.gym.judging.off_road`."""


class VectorDriveEnv(gymnasium.vector.VectorEnv[Observations, Observations, NDArray[Any]]):
    """Drive many cars on the track of a diagram file, each on its own.

    Names, ranges, rewards and ends are those of :class:`mirdrake.gym.env.DriveEnv`, so that a policy that was trained
    here drives there. The cars are single-track models with brush tyres and the control unit's limits, steering
    actuator and speed loop; nothing but the road exists: no collisions, no sensors. An episode that has ended is reset
    by the next step, whose action is ignored (``AutoresetMode.NEXT_STEP``).

    Args:
        num_envs: number of cars.
        diagram: name, file, spec or data of a diagram; its vehicle has servos and a track.
        overrides: ``"dotted.path=value"`` texts over the file.
        vehicle: the one that acts; the first of the file if left out.
        observe: signals of :data:`mirdrake.batched.lane.SIGNALS`, for example ``ego.vx``, and
            ``ego.curvature_ahead.20``; by default those of the single environment.
        rate: steps per second [Hz].
        reward: ``progress`` or ``centred_progress``.
        ends: what ends an episode: ``off_road``.
        start: ``anywhere_on_track``; the start of the file if left out.
        duration: time after which an episode is truncated [s]; that of the file if left out.
        control_period: period of the control unit and step of the integration [s]; that of control.yaml if left out.
        parameters: values (num_envs) of parameters of the single-track model that differ between the cars.
        relaxation: whether slip builds up over the relaxation length.
        threads: number of threads that share the cars.
        render_mode: None.

    Attributes:
        observation_names: names of the elements of an observation.
        action_names: names of the elements of an action.
        action_bounds: their ranges, (2, 2).
        cars: the batch.

    Raises:
        ConfigError: the diagram has no track, the vehicle has no servos, or an unknown name.
    """

    metadata: dict[str, Any] = {"render_modes": [], "autoreset_mode": AutoresetMode.NEXT_STEP}  # noqa: RUF012

    def __init__(
        self,
        num_envs: int = 1,
        diagram: DiagramSpec | Mapping[str, Any] | str = "bolt_test_track",
        *,
        overrides: Sequence[str] = (),
        vehicle: str | None = None,
        observe: Sequence[str] | None = None,
        rate: float = 10.0,
        reward: str = "progress",
        ends: Sequence[str] = ENDS,
        start: str | None = None,
        duration: float | None = None,
        control_period: float | None = None,
        parameters: Mapping[str, ArrayLike] | None = None,
        relaxation: bool = False,
        threads: int = 1,
        render_mode: str | None = None,
    ) -> None:
        # Functions of a Moment cannot run in the compiled loop, so only built-in names are allowed.
        for kind, given, allowed in (("reward", [reward], REWARDS), ("end", ends, ENDS), ("start", [start], STARTS)):
            for name in given:
                if name is not None and name not in allowed:
                    raise ConfigError(f"vector environment: unknown {kind} '{name}'; {did_you_mean(name, allowed)}")
        # The single environment is built once for its names, ranges and checks, so that a policy fits both.
        single = DriveEnv(
            diagram, overrides=overrides, vehicle=vehicle, observe=observe, rate=rate, start=start, duration=duration
        )
        self.num_envs, self.render_mode = int(num_envs), render_mode
        self.vehicle, self.period, self.duration = single.vehicle, single.period, single.duration
        self.observation_names, self.action_names = single.observation_names, single.action_names
        self.action_bounds = single.action_bounds
        self.single_observation_space, self.single_action_space = single.observation_space, single.action_space
        self.observation_space = gymnasium.vector.utils.batch_space(self.single_observation_space, self.num_envs)
        self.action_space = gymnasium.vector.utils.batch_space(self.single_action_space, self.num_envs)
        self._centred, self._ends_off_road, self._random_start = reward == REWARDS[1], bool(ends), start is not None

        # Vehicle, track and start of the diagram.
        assembly = single.assembly
        part, name = assembly.parts.vehicles[self.vehicle], assembly.tracks[self.vehicle]
        if name is None:
            raise ConfigError(f"vector environment: the world of '{self.vehicle}' has no track")
        track = assembly.parts.world.tracks[name]
        self._start, self._track = assembly.starts[self.vehicle], track
        self._columns, self._distances = self._find_columns(self.observation_names)

        # Cars and control units; the number of control periods of a step is whole.
        control = part.vehicle.control
        self._control_period = control_period or 1.0 / control.rate
        self._periods = round(self.period / self._control_period)
        # A step is a whole number of control periods: actions change at control instants only.
        if self._periods < 1 or abs(self._periods * self._control_period - self.period) > 1e-9:
            raise ConfigError(
                f"vector environment: a step of {self.period:g} s is not a multiple of the control period of "
                f"{self._control_period:g} s; give control_period"
            )
        # Gravity of the diagram's world, as in the single environment, instead of the default.
        gravity = [float(value) for value in assembly.parts.world.ground.gravity]
        self.cars = Batch(
            estimate_parameters(part.vehicle, gravity=gravity),
            Variant("brush", relaxation=relaxation, actuators=True),
            columns=parameters,
            count=self.num_envs,
            step=self._control_period,
            threads=threads,
        )
        # The unit computes with the nominal mass: it does not know how the cars differ.
        numbers, self._size = lane_numbers(part.vehicle, track, self._control_period, self.cars.nominal.mass)
        self._lanes = records(LaneNumbers, [numbers])
        self._gains = records(PidNumbers, [PidGains(control.speed.kp, control.speed.ki).numbers()])
        self._tables = lane_tables(track)

        # State of the units and episodes. Signals stay between steps, so that a diverged car keeps finite ones.
        n = self.num_envs
        self._memory: Floats = np.zeros((n, self._size))
        self._progress: Floats = np.zeros(n)
        self._signals: Floats = np.zeros((n, len(SIGNALS) + len(self._distances)))
        self._steps = np.zeros(n, dtype=np.int64)
        self._ended: Flags = np.zeros(n, dtype=bool)
        space = self.single_observation_space
        assert isinstance(space, gymnasium.spaces.Box)
        self._low, self._high = space.low, space.high

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observations, dict[str, Any]]:
        """Start new episodes of all cars.

        Args:
            seed: seed of random starts.
            options: not used.
        """
        del options
        if seed is not None:
            self._np_random, self._np_random_seed = gymnasium.utils.seeding.np_random(seed)
        self.cars.reset()
        self._place(np.arange(self.num_envs))
        # Episodes that had ended before this reset do not restart once more in the next step.
        self._ended[:] = False
        self._advance(0, ~self._ended)
        return self._observations(), {"time": self._steps * self.period}

    def step(
        self, actions: Observations
    ) -> tuple[Observations, NDArray[Any], NDArray[Any], NDArray[Any], dict[str, Any]]:
        """Advance all cars by one period.

        Returns:
            observations, rewards, terminated, truncated, and an info with ``time`` [s] and ``diverged``, the cars whose
            state is not a number. Cars whose episode ended in the step before start a new one: their action is ignored
            and their reward is 0.
        """
        # NaN counts as the middle of the range, as in the single environment.
        low, high = self.action_bounds[:, 0], self.action_bounds[:, 1]
        share = np.clip(np.nan_to_num(np.asarray(actions, dtype=float)), -1.0, 1.0)
        self._setpoints = 0.5 * (low + high + share * (high - low))
        again = np.flatnonzero(self._ended)
        self._advance(self._periods, ~self._ended)
        self._steps += 1
        if len(again):
            # Cars that start again are placed after the step and only their signals are written, without motion.
            self._place(again)
            self._advance(0, self._ended)
        diverged = self.cars.diverged.copy()

        # Rewards and ends, as in the single environment.
        signals = self._signals
        rewards = signals[:, 3] * np.cos(signals[:, 10]) * self.period
        if self._centred:
            rewards *= np.maximum(0.0, 1.0 - np.abs(signals[:, 9]) / 2.0)
        terminated = diverged.copy()
        if self._ends_off_road:
            terminated |= signals[:, 12] < MINIMUM_WHEELS
        # With NEXT_STEP autoreset the step that resets has reward 0 and ends nothing, whatever the place of the car.
        truncated = self._steps * self.period >= self.duration - 1e-9
        rewards[diverged] = 0.0
        rewards[again], terminated[again], truncated[again] = 0.0, False, False
        self._ended = terminated | truncated
        info = {"time": self._steps * self.period, "diverged": diverged}
        return self._observations(diverged), rewards, terminated, truncated, info

    def _place(self, cars: NDArray[np.int64]) -> None:
        """Put cars to their starts."""
        start, track = self._start, self._track
        x, y, yaw = (np.full(len(cars), value) for value in (start.x, start.y, start.yaw))
        if self._random_start:
            # Uniform along the track; the pose on the centre line also gives the first guess of the projection.
            s = self.np_random.uniform(0.0, track.length, len(cars))
            x, y, yaw = track.pose(s)
        else:
            s = np.full(len(cars), float(track.project(start.x, start.y)[0]))
        self.cars.reset(cars, x=x, y=y, yaw=yaw, vx=start.speed)
        # Set-points start at the start speed and straight ahead, so that no ramp begins an episode.
        memory = np.zeros(self._size)
        memory[SETPOINTS] = start.speed
        memory[PID:ACTUATOR] = PidState()
        self._memory[cars], self._progress[cars], self._steps[cars] = memory, s, 0

    def _advance(self, periods: int, chosen: Flags) -> None:
        """Advance the chosen cars (num_envs) and write their signals; with 0 periods only the latter."""
        cars = self.cars
        # The kernel skips cars with the flag of divergence, so the others have it while it runs.
        diverged = cars.diverged.copy()
        cars.diverged[~chosen] = True
        # Without periods set-points are not read, and before the first action there are none.
        setpoints = self._setpoints if periods else np.zeros((self.num_envs, 2))
        cars.share(
            self._kernel, self._lanes, self._gains, self._tables, self._distances, setpoints, periods,
            cars.step_time, 1, self._memory, self._progress, self._signals,
        )  # fmt: skip
        cars.diverged[~chosen] = diverged[~chosen]

    def _observations(self, diverged: Flags | None = None) -> Observations:
        """Return the observations; those of diverged cars are zero, within their ranges."""
        values = self._signals[:, self._columns].astype(np.float32)
        if diverged is not None and diverged.any():
            values[diverged] = 0.0
        return np.clip(values, self._low, self._high, out=values)

    def _find_columns(self, names: Sequence[str]) -> tuple[NDArray[np.int64], Floats]:
        """Return the column of each observation, and the distances ahead of the further columns [m]."""
        # Signals have fixed columns; each distance ahead gets one behind them.
        known = {f"{self.vehicle}.{signal}": index for index, signal in enumerate(SIGNALS)}
        columns: list[int] = []
        distances: list[float] = []
        for name in names:
            prefix = f"{self.vehicle}.{AHEAD}."
            if name.startswith(prefix):
                columns.append(len(SIGNALS) + len(distances))
                distances.append(float(name.removeprefix(prefix)))
            elif name in known:
                columns.append(known[name])
            else:
                raise ConfigError(f"vector environment: no signal '{name}'; {did_you_mean(name, known)}")
        return np.array(columns), np.array(distances, dtype=float)

    @cached_property
    def _kernel(self) -> Any:
        return compiled(drive_on_track, lateral_force_of(self.cars.variant), parts=LANE_PARTS, nogil=True)


def lane_numbers(vehicle: Vehicle, track: Track, period: float, mass: float) -> tuple[LaneNumbers, int]:
    """Return the numbers of a vehicle's control unit on a track, and the length of the unit's memory.

    Args:
        vehicle: a loaded vehicle.
        track: the track.
        period: control period [s].
        mass: mass for which the unit computes the drive force [kg].

    Raises:
        ConfigError: the vehicle has another steering law than Ackermann, other assumed dimensions, or no servos.
    """
    control, spec, geometry = vehicle.control, vehicle.spec, vehicle.geometry
    # The compiled loop has only these laws; others would drive differently without a message.
    if control.wheel_speed.kind != "servo" or spec.steering.law != "ackermann":
        raise ConfigError(
            f"vector environment: '{vehicle.name}' needs wheel_speed of kind servo and Ackermann steering; it has "
            f"'{control.wheel_speed.kind}' and '{spec.steering.law}'"
        )
    if control.assumed.wheelbase is not None or control.assumed.track is not None:
        raise ConfigError(f"vector environment: '{vehicle.name}' assumes other dimensions; leave out `assumed`")
    # The radius of a driven wheel converts its torque and speed; the assumed one is that of the control unit.
    radius = geometry.front_wheel_radius if spec.drive != "rear" else geometry.rear_wheel_radius
    # The lag of the steering is a part of the control unit in the loop.
    correction, actuator = control.speed.max_correction, ActuatorLaw(spec.actuators.steering, period=period)
    assumed = control.assumed.wheel_radius or radius
    numbers = LaneNumbers(
        fastest=math.inf if control.speed.max_speed is None else control.speed.max_speed,
        acceleration=control.speed.max_acceleration,
        deceleration=control.speed.max_deceleration,
        steering=Ackermann(geometry).numbers,
        actuator=actuator.numbers,
        actuator_size=actuator.size,
        speed_limits=PidLimits(-correction, correction),
        true_over_assumed=radius / assumed,
        force_per_acceleration=mass * assumed / radius,
        period=period,
        path=PathTables(make_centre_line(track)).numbers,
        wheelbase=geometry.wheelbase,
        front=geometry.front_track / 2.0,
        rear=geometry.rear_track / 2.0,
    )
    return numbers, ACTUATOR + actuator.size


def lane_tables(track: Track) -> Floats:
    """Return x, y, yaw, curvature, left and right width at the points of the centre line (points, 6)."""
    centre = make_centre_line(track)
    # The last point may exceed the length by rounding, beyond which widths are not defined.
    s = np.arange(len(centre.x)) * centre.spacing
    inside = np.minimum(s, centre.length)
    # Curvatures belong to intervals, of which there is one fewer than points; the last row is never read.
    curvature = np.append(centre.curvature, 0.0)
    return np.column_stack(
        [centre.x, centre.y, centre.yaw, curvature, track.left_width(inside), track.right_width(inside)]
    )
