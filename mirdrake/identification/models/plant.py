"""Full Drake plant, for parameters that live in its Context.

The Diagram is built once. Recorded inputs are fed in as tables; each run starts from the first speeds of the log,
settled on tyres and springs, and the sensor readings are compared. Derivatives are differences between complete runs.

=====================  =======  ==================================================================================
``mass``               kg       mass of the whole vehicle
``rear_length``        m        centre of mass ahead of the rear axle
``com_height``         m        height of the centre of mass above the road, springs unloaded
``yaw_inertia``        kg m²    yaw inertia of the whole vehicle; the pitch inertia changes by the same amount
``wheel_damping``      N m s    damping of each wheel bearing
``friction``           1        friction of the road
``rolling_resistance`` 1        rolling resistance of the tyres, for vehicles with a tyre model
=====================  =======  ==================================================================================

A recorded road wheel angle is imposed by a servo much stiffer than the vehicle's, ahead of time by the hold of the
control unit (half a period and a step). Other steering channels go to the servo of the vehicle. If the recorded hand
wheel angle contains the servo's lag already, the steering delay compensates for it and may be negative.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pydrake.systems.framework import Context

from mirdrake.assembly.diagram import Assembly, assemble
from mirdrake.assembly.diagram_spec import make_spec
from mirdrake.core.constants import GRAVITY
from mirdrake.core.contacts import STUDY_CONTACT, ContactModel
from mirdrake.core.errors import ConfigError, MirdrakeError
from mirdrake.core.json_io import Json
from mirdrake.execution.parameters import find_context_parameters
from mirdrake.identification.models.base import SPEED, Array, ModelOptions, Segment, find_channel, select_outputs
from mirdrake.identification.models.plant_context import body_inertia, measure, set_damping
from mirdrake.identification.models.plant_parameters import plant_parameters
from mirdrake.identification.models.simulated import SimulatedModel
from mirdrake.identification.models.steer import STEERING, steering_angle
from mirdrake.sensors.ground_truth import vehicle_state
from mirdrake.vehicles import WHEELS, Vehicle, load_vehicle

EGO = "ego"
DRIVES: dict[str, tuple[str, ...]] = {
    "torque": ("drive_torque",),
    "pedals": ("throttle",),
    "speed": (),
}
"""Channels that each way of feeding in the drive needs; the first one that the log allows is used."""

OUTPUTS = ["vx", "vy", "yaw_rate", "longitudinal_acceleration", "lateral_acceleration", "roll", "roll_rate"]


_BLOCKS = "mirdrake.identification.models.plant_blocks:"
_NEVER = 1e6
_STIFFER, _CORNER = 100.0, 100.0
"""A recorded road wheel angle contains the steering compliance: the servo that imposes it is stiffer than the vehicle's
by this factor, with this corner frequency [rad/s]."""

_FIRST = 0.2
"""Duration over which the initial speeds are estimated [s]."""

_MOST_SAMPLES = 2000.0
"""Highest rate of a diagram's record [Hz]."""

_KEPT = 64
"""Number of cached runs."""


class PlantOptions(ModelOptions):
    """Options of the plant model."""

    vehicle: str | None = Field(default=None, description="name or folder of the vehicle; that of the study [-]")
    contact: ContactModel = Field(default=STUDY_CONTACT, description="contact model [-]")
    time_step: float | None = Field(default=None, gt=0.0, description="step of the plant [s]")
    drive: Literal["torque", "pedals", "speed"] | None = Field(
        default=None, description="how the drive is fed in; the first one that all logs allow if left out [-]"
    )
    outputs: list[str] | None = Field(default=None, description="channels to compare; all if left out [-]")
    settle: float = Field(default=1.0, ge=0.0, description="time to settle before the first sample [s]")
    rate: float | None = Field(
        default=None, ge=0.0, description="rate of the control unit; the vehicle's, or as a recorded angle needs [Hz]"
    )
    world: str = Field(default="empty", description="world: level, with uniform friction [-]")


class PlantModel(SimulatedModel):
    """Full multibody plant; the parameters are in the docstring of the module.

    Raises:
        ConfigError: a channel or the vehicle is missing, or the plant cannot be built.
    """

    kind = "plant"
    Options = PlantOptions
    states = ("vx",)
    state_scales = (0.5,)

    def __init__(
        self, channels: set[str], known: Mapping[str, float], wheelbase: float | None, options: PlantOptions
    ) -> None:
        del known, wheelbase
        if options.vehicle is None:
            raise ConfigError("plant: needs a vehicle; name one at 'vehicle' of the study", path=("model",))
        loaded = load_vehicle(options.vehicle, where="vehicle")
        self.title = f"plant of {loaded.name}, {options.contact} contact"
        self._steer = find_channel(channels, STEERING, "the steering", self.kind)
        self._speed = find_channel(channels, SPEED, "the speed", self.kind)
        self._way = _find_drive(options.drive, channels, loaded)
        extra = tuple(name for name in ("brake",) if self._way == "pedals" and name in channels)
        extra += tuple(name for name in ("brake_torque",) if self._way == "torque" and name in channels)
        self.inputs = tuple(dict.fromkeys((self._steer, *DRIVES[self._way], *extra, self._speed)))
        possible = [name for name in OUTPUTS if name != "vx" or self._way != "speed"]
        self.outputs = select_outputs(channels, possible, options.outputs, self.kind)
        self._settle = options.settle
        # Twice the rate of the control unit, so that every control instant is a step of the plant.
        self._step = 0.5 / loaded.control.rate if options.time_step is None else options.time_step
        # Samples are whole steps apart, as between two steps the state is held and its slope would be a staircase.
        self._sample = self._step * max(1, math.ceil(1.0 / (_MOST_SAMPLES * self._step) - 1e-9))
        self._vehicle = loaded
        self._stiff = self._steer == "road_wheel_angle"
        # A recorded angle is held by the unit between two instants; the lead compensates the mean delay of this hold.
        self._rate = float(options.rate or (0.5 / self._step if self._stiff else loaded.control.rate))
        self._lead = 0.5 / self._rate + self._step if self._stiff else 0.0
        self.assembly = self._build(options.vehicle, options.contact, options.world)
        self._simulator = self.assembly.make_simulator()
        part = self.assembly.parts.vehicles[EGO]
        self._part, plant = part, self.assembly.parts.plant
        self._whole, self._rest = measure(plant, part), measure(plant, part, base=False)
        # A friction that differs over the ground is not a single parameter.
        self._parameters = find_context_parameters({EGO: loaded}, self.assembly.parts.world)
        friction = float(self.assembly.parts.world.ground.mu) if "road.friction" in self._parameters else None
        damping = float(part.wheels[0].default_damping_vector()[0])
        self.parameters = plant_parameters(loaded, self._steer, self._whole, self._rest, damping, friction)
        self._runs: dict[tuple[Any, ...], tuple[Segment, tuple[Array, Array] | None]] = {}

    @classmethod
    def vehicle_values(cls, vehicle: Vehicle, options: PlantOptions, *, measured: bool) -> dict[str, float]:
        """Return the common values; the lag of the steering is in the plant itself."""
        del measured
        return super().vehicle_values(vehicle, options, measured=True)

    def _build(self, model: str, contact: str, world: str) -> Assembly:
        """Assemble the plant with the tables that replace driver, torques and rolling resistance."""
        # Recorded inputs replace the driver: one table for each input of the vehicle.
        systems: Json = {"steering_table": {"kind": f"{_BLOCKS}Table", "size": 1}}
        connect = [["steering_table.y", f"{EGO}.steering_reference"]]
        pedals = self._vehicle.control.wheel_speed.uses_pedals
        if self._way == "speed":
            systems["speed_table"] = {"kind": f"{_BLOCKS}Table", "size": 1}
            connect.append(["speed_table.y", f"{EGO}.speed_reference"])
        if self._way == "pedals":
            systems["pedals_table"] = {"kind": f"{_BLOCKS}Table", "size": 3}
            connect.append(["pedals_table.y", f"{EGO}.pedals_reference"])
        if self._vehicle.spec.tyres.has_slip:
            # Rolling resistance is in the tyre law and not in the Context: its change is added as a moment on the
            # torques.
            systems["moments"] = {"kind": f"{_BLOCKS}WheelMoments"}
            source = f"{EGO}.wheel_torque"
            if self._way == "torque" or not pedals:
                systems["torque_table"] = {"kind": f"{_BLOCKS}Table", "size": 8}
                source = "torque_table.y"
            connect += [[source, "moments.torque"], [f"{EGO}.wheel_speeds", "moments.spins"]]
            connect.append(["moments.y", f"{EGO}.wheel_torque"])
        # Tables send no stamps, so the watchdog must not stop the vehicle.
        control: Json = {"dead_man": _NEVER, "rate": self._rate}
        servo = self._vehicle.control.steering
        if self._stiff and servo.kind == "servo":
            stiffness = _STIFFER * servo.stiffness
            control["steering"] = {"stiffness": stiffness, "damping": stiffness / _CORNER}
        # Starts at the origin of a level world and at rest: positions do not matter, and the speed is set per run.
        entry = {
            "model": model,
            "start": {"x": 0.0, "y": 0.0, "yaw": 0.0},
            "speed": 0.0,
            "control": control,
        }
        data = {
            "name": "plant of an identification",
            "world": world,
            "vehicles": {EGO: entry},
            "systems": systems,
            "connect": connect,
            "plant": {"contact": contact, "time_step": self._step},
            "record": {"rate": min(1.0 / self._sample, _MOST_SAMPLES), "meshcat": False, "report": False},
        }
        try:
            return assemble(make_spec(data))
        except MirdrakeError as error:
            raise ConfigError(f"plant: {error}", path=("model",)) from None

    # --- runs -------------------------------------------------------------------------------------------------------

    def initial_states(self, p: Mapping[str, float], drive: Segment, rows: NDArray[np.intp]) -> Array:
        """Return the measured speed, as the mean of a few samples."""
        del p
        return np.array([[_first(drive.channels(self._speed), drive.step, int(row)) for row in rows]])

    def run(self, p: Mapping[str, float], drive: Segment, first: Array) -> tuple[Array, Array] | None:
        """Simulate one run; the last ones are cached."""
        key = (id(drive), tuple(p.values()), first.tobytes())
        if key not in self._runs:
            # The oldest run goes first: dicts keep the order of insertion.
            if len(self._runs) >= _KEPT:
                self._runs.pop(next(iter(self._runs)))
            self._runs[key] = (
                drive,
                self._simulate(p, drive, float(first[0])),
            )  # the segment is kept so that its id stays unique
        return self._runs[key][1]

    def _simulate(self, p: Mapping[str, float], drive: Segment, speed: float) -> tuple[Array, Array] | None:
        assembly, begin = self.assembly, self._settle
        try:
            # Trial parameters can be impossible for the plant, for example a negative load; this counts as a
            # divergence.
            context = self._context(p, drive, speed)
        except ValueError:
            return None
        end = begin + drive.step * drive.size
        simulator = self._simulator
        simulator.reset_context(context)
        # Drake raises RuntimeError when the state is not finite any more.
        try:
            simulator.Initialize()
            if begin > 0.0:
                simulator.AdvanceTo(begin)
                self._set_speeds(context, drive, speed)
            simulator.AdvanceTo(end)
        except RuntimeError:
            return None
        # Samples while the car settles do not count.
        log = assembly.taps["plant_state"]
        times, x = np.array(log.times(context)) - begin, np.array(log.data(context))
        # The speeds are set at the end of settling, so the sample at that time has the old ones.
        keep = times > -0.4 * self._step if begin == 0.0 else times > 0.4 * self._step
        seen = self._sensor_readings(p, x[:, keep])
        samples = drive.step * np.arange(drive.size)
        # The log has the step of the plant, the data have their own.
        y = np.array([np.interp(samples, times[keep], seen[name]) for name in self.outputs])
        if not np.isfinite(y).all():
            return None
        return y, np.array([seen["vx"][-1]])

    def _context(self, p: Mapping[str, float], drive: Segment, speed: float) -> Context:
        """Return a new Context with parameters and tables, the car at its start.

        Raises:
            ValueError: the mass properties are impossible.
        """
        assembly, part = self.assembly, self._part
        plant = assembly.parts.plant
        inertia = body_inertia(self._whole, self._rest, p)
        # The start speed precedes the Context, as it determines its initial state.
        assembly.starts[EGO] = replace(assembly.starts[EGO], speed=speed)
        context = assembly.make_context()
        plant_context = plant.GetMyMutableContextFromRoot(context)
        # Mass properties live in the Context, so the Diagram is built once for all runs of a fit.
        part.base.SetSpatialInertiaInBodyFrame(plant_context, inertia)
        set_damping(plant_context, part, p["wheel_damping"])
        if "friction" in p and p["friction"] != assembly.parts.world.ground.mu:
            # A friction other than that of the world is a parameter of the ground.
            self._parameters["road.friction"].apply(assembly, context, p["friction"])
        # No lag here: the servo of the steering is part of the plant.
        angle = steering_angle({"steering_lag": 0.0, **p}, drive, self._steer, _sample_times(drive))
        self._fill(context, "steering_table", drive, angle, self._lead)
        if self._way == "speed":
            self._fill(context, "speed_table", drive, drive.at(self._speed, _sample_times(drive)))
        if self._way == "pedals":
            throttle = np.clip(drive.at("throttle", _sample_times(drive)), 0.0, 1.0)
            brake = np.zeros_like(throttle)
            if "brake" in drive.inputs:
                brake = np.clip(drive.at("brake", _sample_times(drive)), 0.0, 1.0)
            self._fill(context, "pedals_table", drive, np.stack((throttle, brake, np.ones_like(brake))))
        if "torque_table" in assembly.spec.systems:
            self._fill(context, "torque_table", drive, self._torques(drive))
        if "moments" in assembly.spec.systems:
            # The difference in rolling resistance acts as a moment on each wheel, by its static load.
            more = p["rolling_resistance"] - self._vehicle.spec.tyres.rolling_resistance
            share = p["rear_length"] / self._vehicle.geometry.wheelbase
            load = 0.5 * p["mass"] * GRAVITY * np.array([share, share, 1.0 - share, 1.0 - share])
            block = assembly.diagram.GetSubsystemByName("moments")
            moments = more * load * np.array(self._vehicle.geometry.wheel_radii)
            block.set_moments(block.GetMyMutableContextFromRoot(context), moments)
        # Ports that no table drives still need a value, or Drake cannot evaluate the control unit.
        for port in ("speed_reference", "reference_stamp"):
            if assembly.diagram.HasInputPort(f"{EGO}.{port}"):
                value = speed if port == "speed_reference" else 0.0
                assembly.diagram.GetInputPort(f"{EGO}.{port}").FixValue(context, [value])
        return context

    def _fill(self, context: Context, name: str, drive: Segment, values: Array, lead: float = 0.0) -> None:
        block = self.assembly.diagram.GetSubsystemByName(name)
        times = self._settle - lead + _sample_times(drive)
        block.set_rows(block.GetMyMutableContextFromRoot(context), times, np.atleast_2d(values))

    def _torques(self, drive: Segment) -> Array:
        """Return drive and brake torques of the wheels (8, n) [N m]; zero if the log has none."""
        times = _sample_times(drive)
        torques = np.zeros((8, len(times)))
        if self._way != "torque":
            return torques
        # An open differential divides the drive torque equally; brakes are divided between the axles by the vehicle's
        # share.
        driven = [WHEELS.index(wheel) for wheel in self._vehicle.spec.driven_wheels()]
        torques[driven] = drive.at("drive_torque", times) / len(driven)
        if "brake_torque" in drive.inputs:
            share = self._vehicle.spec.brakes.front_share
            brake = np.abs(drive.at("brake_torque", times))
            torques[4:6], torques[6:8] = 0.5 * share * brake, 0.5 * (1.0 - share) * brake
        return torques

    def _set_speeds(self, context: Context, drive: Segment, speed: float) -> None:
        """Set the initial speeds of the log for a settled car: forward, lateral and yaw."""
        plant, part = self.assembly.parts.plant, self._part
        plant_context = plant.GetMyMutableContextFromRoot(context)
        x = plant.GetPositionsAndVelocities(plant_context)
        positions = plant.num_positions()
        pose = x[part.base.floating_positions_start() :][:7, None]
        start = positions + part.base.floating_velocities_start_in_v()
        # The settled pose gives the directions; wheels spin up with the vehicle.
        state = np.array(vehicle_state(pose, x[start : start + 6, None]))[:, 0]
        yaw, now = state[5], state[6]
        turn, side = state[11], state[7]
        if "yaw_rate" in drive.outputs:
            turn = _first(drive.outputs["yaw_rate"], drive.step, 0)
        if "vy" in drive.outputs:
            side = _first(drive.outputs["vy"], drive.step, 0) - turn * float(self._whole.com[0])
        # Order of a floating base in Drake: angular velocity first, then that of the origin, both in the world frame.
        velocities = plant.GetVelocities(plant_context).copy()
        first = part.base.floating_velocities_start_in_v()
        velocities[first + 2] = turn
        velocities[first + 3] = speed * math.cos(yaw) - side * math.sin(yaw)
        velocities[first + 4] = speed * math.sin(yaw) + side * math.cos(yaw)
        # Wheels keep their ratio to the speed, and with it the slip to which the tyres have settled.
        ratio = speed / now if abs(now) > 0.1 else 1.0
        for joint in part.wheels:
            velocities[joint.velocity_start()] *= ratio
        plant.SetVelocities(plant_context, velocities)

    def _sensor_readings(self, p: Mapping[str, float], x: Array) -> dict[str, Array]:
        """Return the sensor readings by channel, from states of the plant (states, n)."""
        part = self._part
        start = self.assembly.parts.plant.num_positions() + part.base.floating_velocities_start_in_v()
        state = vehicle_state(x[part.base.floating_positions_start() :][:7], x[start:][:6], part.period)
        vx, vy, turn = state[6], state[7], state[11]
        ahead = float(self._whole.com[0])
        slopes = [np.gradient(values, self._sample) for values in (vx, vy, turn)]
        # Sensor positions are relative to the file's centre of mass, states to the rear axle.
        position, tilt = ahead + p["accelerometer_ahead"], p["accelerometer_tilt"]
        return {
            "vx": vx,
            "vy": vy + (ahead + p["velocity_ahead"]) * turn,
            "yaw_rate": turn,
            "longitudinal_acceleration": slopes[0] - vy * turn - position * turn**2 - tilt * GRAVITY * state[4],
            "lateral_acceleration": slopes[1] + vx * turn + position * slopes[2] + tilt * GRAVITY * state[3],
            "roll": state[3],
            "roll_rate": state[9],
        }

    def plausible_range(self, name: str, p: Mapping[str, float]) -> tuple[float, float]:
        """Return the range that cargo can cause."""
        del p
        whole = self._whole
        ranges = {
            "mass": (0.5 * whole.mass, 2.5 * whole.mass),
            "yaw_inertia": (0.5 * float(whole.inertia[2, 2]), 3.0 * float(whole.inertia[2, 2])),
        }
        return ranges.get(name, (-np.inf, np.inf))

    def suggest_experiment(self, names: frozenset[str], drives: Sequence[Segment] = ()) -> str:
        """Return which drive would identify these parameters."""
        del drives
        if names & {"friction"}:
            return "brake or turn to the limit of the tyres"
        if names & {"mass", "rolling_resistance", "wheel_damping"}:
            return "accelerate hard, then coast; record the torque at the wheels"
        return "do step steers and a sweep to 2 Hz, and record the lateral velocity"


def _find_drive(requested: str | None, channels: set[str], vehicle: Vehicle) -> str:
    """Return how the drive is fed in.

    Raises:
        ConfigError: not possible for this vehicle, or a channel is missing.
    """
    able = {"torque": vehicle.spec.tyres.has_slip, "pedals": vehicle.control.wheel_speed.uses_pedals}
    if requested is None:
        # Torques need no model of the powertrain, pedals that of the vehicle; the speed is always possible.
        fits = (name for name, needs in DRIVES.items() if set(needs) <= channels and able.get(name, True))
        return next(fits)
    path = ("model", "drive")
    if not able.get(requested, True):
        need = "a tyre model" if requested == "torque" else "pedals"
        raise ConfigError(f"{requested} needs a vehicle with {need}, {vehicle.name} has none; use speed", path=path)
    for name in DRIVES[requested]:
        if name not in channels:
            raise ConfigError(
                f"{requested} needs channel '{name}' in every log; map its column in 'channels'", path=path
            )
    return requested


def _sample_times(drive: Segment) -> Array:
    """Return the times of the samples relative to the first one (n) [s]."""
    return np.asarray(drive.step * np.arange(drive.size), dtype=np.float64)


def _first(values: Array, step: float, row: int) -> float:
    """Return a channel at a row, from a straight line through the following samples."""
    count = max(round(_FIRST / step), 3)
    part = values[row : row + count]
    good = np.isfinite(part)
    if good.sum() < 3:
        return float(part[good][0]) if good.any() else 0.0
    # The level of a line at the first sample: a mean would lag by half the window while the speed changes.
    slope, level = np.polyfit(np.flatnonzero(good), part[good], 1)
    del slope
    return float(level)
