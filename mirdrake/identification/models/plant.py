"""The full Drake plant, for parameters that live in its Context.

The Diagram is built once. Recorded inputs are fed in as tables; each run starts from the log's first speeds, settled on
its tyres and springs, and what sensors would show is compared. Derivatives are differences between whole runs.

=====================  =======  ==================================================================================
``mass``               kg       of the whole vehicle
``rear_length``        m        centre of mass before the rear axle
``com_height``         m        centre of mass over the road, unloaded springs
``yaw_inertia``        kg m²    of the whole vehicle about its centre of mass; pitch inertia changes by as much
``wheel_damping``      N m s    of each wheel's bearing
``friction``           1        of the road
``rolling_resistance`` 1        of the tyres; of vehicles with a tyre model
=====================  =======  ==================================================================================

A recorded angle of the wheels is imposed by a servo that is much stiffer than the vehicle's, ahead by what the control
unit holds it (half a period and a step). Other steering channels go to the servo of the vehicle; if its lag is in the
recorded angle of the hand wheel already, the steering's delay makes up for it and may be negative.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context

from mirdrake.assembly.diagram import Assembly, assemble
from mirdrake.assembly.diagram_spec import make_spec
from mirdrake.core.constants import GRAVITY
from mirdrake.core.errors import ConfigError, MirdrakeError, did_you_mean
from mirdrake.execution.parameters import find_knobs
from mirdrake.identification.models.base import Array, Segment, channel_of, pick_outputs
from mirdrake.identification.models.plant_context import body_inertia, measure, set_damping
from mirdrake.identification.models.plant_parameters import plant_parameters
from mirdrake.identification.models.simulated import SimulatedModel
from mirdrake.identification.models.single_track import SPEED
from mirdrake.identification.models.steer import STEERING, steering_angle
from mirdrake.runs.telemetry import vehicle_states
from mirdrake.vehicles import WHEELS, Vehicle, load_vehicle

EGO = "ego"
DRIVES: dict[str, tuple[str, ...]] = {
    "torque": ("drive_torque",),
    "pedals": ("throttle",),
    "speed": (),
}
"""How a log's drive is fed in, and which channels that needs; the first that the log has is taken."""

OUTPUTS = ["vx", "vy", "yaw_rate", "longitudinal_acceleration", "lateral_acceleration", "roll", "roll_rate"]

CONTACTS = ("point", "hydroelastic")

_BLOCKS = "mirdrake.identification.models.plant_blocks:"
_NEVER = 1e6
_STIFFER, _CORNER = 100.0, 100.0
"""A recorded angle of the wheels has the give of the steering in it: the servo that follows it is so much stiffer than
the vehicle's, and follows up to a corner [rad/s]."""

_FIRST = 0.2
"""Time over which the first speeds of a log are read [s]."""

_KEPT = 64
"""Runs that are remembered."""


class PlantModel(SimulatedModel):
    """See the head of the module.

    Args:
        offered: channels that all logs have.
        given: what is known of parameters, by name.
        wheelbase: not used; that of the vehicle counts.
        vehicle: its name or folder; of a study its ``vehicle``.
        contact: "point" or "hydroelastic".
        time_step: of the plant [s].
        drive: one of :data:`DRIVES`; left out: the first that all logs have the channels of.
        outputs: channels to compare; None: all that there are.
        settle: time in which the car settles before the first sample [s].
        rate: of the control unit [Hz]; left out: the vehicle's, or fast enough to follow a recorded angle.
        world: that it drives in; level, with the same friction everywhere.

    Raises:
        ConfigError: a channel or the vehicle is missing, an option unknown, or the plant cannot be built.
    """

    kind = "plant"
    states = ("vx",)
    state_scales = (0.5,)

    def __init__(
        self,
        offered: set[str],
        given: Mapping[str, float],
        wheelbase: float | None,
        *,
        vehicle: str | None = None,
        contact: str = "point",
        time_step: float | None = None,
        drive: str | None = None,
        outputs: list[str] | None = None,
        settle: float = 1.0,
        rate: float | None = None,
        world: str = "empty",
    ) -> None:
        del given, wheelbase
        if contact not in CONTACTS:
            raise ConfigError(f"model.contact: unknown contact '{contact}'; {did_you_mean(contact, CONTACTS)}")
        for name, value in (("time_step", time_step), ("rate", rate), ("settle", settle)):
            if value is not None and not (isinstance(value, int | float) and 0.0 <= value < math.inf):
                raise ConfigError(f"model.{name}: must be a positive number, got {value!r}")
        if vehicle is None:
            raise ConfigError("model plant: needs a vehicle; name one at 'vehicle' of the study")
        loaded = load_vehicle(vehicle, where="vehicle")
        self.title = f"plant of {loaded.name}, {contact} contact"
        self._steer = channel_of(offered, STEERING, "the steering", self.kind)
        self._speed = channel_of(offered, SPEED, "the speed", self.kind)
        self._way = _find_drive(drive, offered, loaded)
        extra = tuple(name for name in ("brake",) if self._way == "pedals" and name in offered)
        extra += tuple(name for name in ("brake_torque",) if self._way == "torque" and name in offered)
        self.inputs = tuple(dict.fromkeys((self._steer, *DRIVES[self._way], *extra, self._speed)))
        possible = [name for name in OUTPUTS if name != "vx" or self._way != "speed"]
        self.outputs = pick_outputs(offered, possible, outputs, self.kind)
        self._settle = float(settle)
        self._step = 0.5 / loaded.control.rate if time_step is None else float(time_step)
        self._vehicle = loaded
        self._stiff = self._steer == "road_wheel_angle"
        self._rate = float(rate or (0.5 / self._step if self._stiff else loaded.control.rate))
        self._lead = 0.5 / self._rate + self._step if self._stiff else 0.0
        self.assembly = self._build(vehicle, contact, world)
        self._simulator = Simulator(self.assembly.diagram)
        part = self.assembly.parts.vehicles[EGO]
        self._part, plant = part, self.assembly.parts.plant
        self._whole, self._rest = measure(plant, part), measure(plant, part, base=False)
        self._knobs = find_knobs({EGO: loaded}, self.assembly.parts.world)
        friction = float(self.assembly.parts.world.ground.mu) if "road.friction" in self._knobs else None
        damping = float(part.wheels[0].default_damping_vector()[0])
        self.parameters = plant_parameters(loaded, self._steer, self._whole, self._rest, damping, friction)
        self._runs: dict[tuple[Any, ...], tuple[Segment, tuple[Array, Array] | None]] = {}

    def _build(self, model: str, contact: str, world: str) -> Assembly:
        systems: dict[str, Any] = {"steering_table": {"kind": f"{_BLOCKS}Table", "size": 1}}
        connect = [["steering_table.y", f"{EGO}.steering_reference"]]
        pedals = self._vehicle.control.wheel_speed.kind == "pedals"
        if self._way == "speed":
            systems["speed_table"] = {"kind": f"{_BLOCKS}Table", "size": 1}
            connect.append(["speed_table.y", f"{EGO}.speed_reference"])
        if self._way == "pedals":
            systems["pedals_table"] = {"kind": f"{_BLOCKS}Table", "size": 3}
            connect.append(["pedals_table.y", f"{EGO}.pedals_reference"])
        if self._vehicle.spec.tyres.kind != "coulomb":
            systems["moments"] = {"kind": f"{_BLOCKS}WheelMoments"}
            source = f"{EGO}.wheel_torque"
            if self._way == "torque" or not pedals:
                systems["torque_table"] = {"kind": f"{_BLOCKS}Table", "size": 8}
                source = "torque_table.y"
            connect += [[source, "moments.torque"], [f"{EGO}.wheel_speeds", "moments.spins"]]
            connect.append(["moments.y", f"{EGO}.wheel_torque"])
        control: dict[str, Any] = {"dead_man": _NEVER, "rate": self._rate}
        servo = self._vehicle.control.steering
        if self._stiff and servo.kind == "servo":
            stiffness = _STIFFER * servo.stiffness
            control["steering"] = {"stiffness": stiffness, "damping": stiffness / _CORNER}
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
            "record": {"rate": min(1.0 / self._step, 2000.0), "meshcat": False, "report": False},
        }
        try:
            return assemble(make_spec(data))
        except MirdrakeError as error:
            raise ConfigError(f"model plant: {error}") from None

    # --- runs -------------------------------------------------------------------------------------------------------

    def initial_states(self, p: Mapping[str, float], drive: Segment, rows: NDArray[np.intp]) -> Array:
        """Speed as measured, the mean of a few samples."""
        del p
        return np.array([[_first(drive.channels(self._speed), drive.step, int(row)) for row in rows]])

    def run(self, p: Mapping[str, float], drive: Segment, first: Array) -> tuple[Array, Array] | None:
        """One run; the last ones are remembered."""
        key = (id(drive), tuple(p.values()), first.tobytes())
        if key not in self._runs:
            if len(self._runs) >= _KEPT:
                self._runs.pop(next(iter(self._runs)))
            self._runs[key] = drive, self._simulate(p, drive, float(first[0]))  # kept, so that its id is
        return self._runs[key][1]

    def _simulate(self, p: Mapping[str, float], drive: Segment, speed: float) -> tuple[Array, Array] | None:
        assembly, begin = self.assembly, self._settle
        try:
            context = self._context(p, drive, speed)
        except ValueError:
            return None
        end = begin + drive.step * drive.size
        simulator = self._simulator
        simulator.reset_context(context)
        try:
            simulator.Initialize()
            if begin > 0.0:
                simulator.AdvanceTo(begin)
                self._set_speeds(context, drive, speed)
            simulator.AdvanceTo(end)
        except RuntimeError:
            return None
        log = assembly.taps["plant_state"].sink.FindLog(context)
        times, x = np.array(log.sample_times()) - begin, np.array(log.data())
        keep = times > -0.4 * self._step if begin == 0.0 else times > 0.4 * self._step
        seen = self._seen(p, x[:, keep])
        samples = drive.step * np.arange(drive.size)
        y = np.array([np.interp(samples, times[keep], seen[name]) for name in self.outputs])
        if not np.isfinite(y).all():
            return None
        return y, np.array([seen["vx"][-1]])

    def _context(self, p: Mapping[str, float], drive: Segment, speed: float) -> Context:
        """A new Context with parameters and tables in it, the car at its start.

        Raises:
            ValueError: the mass properties are impossible.
        """
        assembly, part = self.assembly, self._part
        plant = assembly.parts.plant
        inertia = body_inertia(self._whole, self._rest, p)
        assembly.starts[EGO] = replace(assembly.starts[EGO], speed=speed)
        context = assembly.make_context()
        plant_context = plant.GetMyMutableContextFromRoot(context)
        part.base.SetSpatialInertiaInBodyFrame(plant_context, inertia)
        set_damping(plant_context, part, p["wheel_damping"])
        if "friction" in p and p["friction"] != assembly.parts.world.ground.mu:
            self._knobs["road.friction"].turn(assembly, context, p["friction"])
        angle = steering_angle({"steering_lag": 0.0, **p}, drive, self._steer, _fine(drive))
        self._fill(context, "steering_table", drive, angle, self._lead)
        if self._way == "speed":
            self._fill(context, "speed_table", drive, drive.at(self._speed, _fine(drive)))
        if self._way == "pedals":
            throttle = np.clip(drive.at("throttle", _fine(drive)), 0.0, 1.0)
            brake = np.zeros_like(throttle)
            if "brake" in drive.inputs:
                brake = np.clip(drive.at("brake", _fine(drive)), 0.0, 1.0)
            self._fill(context, "pedals_table", drive, np.stack((throttle, brake, np.ones_like(brake))))
        if "torque_table" in assembly.spec.systems:
            self._fill(context, "torque_table", drive, self._torques(drive))
        if "moments" in assembly.spec.systems:
            more = p["rolling_resistance"] - self._vehicle.spec.tyres.rolling_resistance
            share = p["rear_length"] / self._vehicle.geometry.wheelbase
            load = 0.5 * p["mass"] * GRAVITY * np.array([share, share, 1.0 - share, 1.0 - share])
            block = assembly.diagram.GetSubsystemByName("moments")
            moments = more * load * np.array(self._vehicle.geometry.wheel_radii)
            block.set_moments(block.GetMyMutableContextFromRoot(context), moments)
        for port in ("speed_reference", "reference_stamp"):
            if assembly.diagram.HasInputPort(f"{EGO}.{port}"):
                value = speed if port == "speed_reference" else 0.0
                assembly.diagram.GetInputPort(f"{EGO}.{port}").FixValue(context, [value])
        return context

    def _fill(self, context: Context, name: str, drive: Segment, values: Array, lead: float = 0.0) -> None:
        block = self.assembly.diagram.GetSubsystemByName(name)
        times = self._settle - lead + _fine(drive)
        block.set_rows(block.GetMyMutableContextFromRoot(context), times, np.atleast_2d(values))

    def _torques(self, drive: Segment) -> Array:
        """Drive and brake torques of the wheels (8, n) [N m]; none if a log has none."""
        times = _fine(drive)
        found = np.zeros((8, len(times)))
        if self._way != "torque":
            return found
        driven = [WHEELS.index(wheel) for wheel in self._vehicle.spec.driven_wheels()]
        found[driven] = drive.at("drive_torque", times) / len(driven)
        if "brake_torque" in drive.inputs:
            share = self._vehicle.spec.brakes.front_share
            brake = np.abs(drive.at("brake_torque", times))
            found[4:6], found[6:8] = 0.5 * share * brake, 0.5 * (1.0 - share) * brake
        return found

    def _set_speeds(self, context: Context, drive: Segment, speed: float) -> None:
        """The log's first speeds for a car that has settled: forward, to the left and about the vertical."""
        plant, part = self.assembly.parts.plant, self._part
        plant_context = plant.GetMyMutableContextFromRoot(context)
        x = plant.GetPositionsAndVelocities(plant_context)
        positions = plant.num_positions()
        pose = x[part.base.floating_positions_start() :][:7, None]
        place = positions + part.base.floating_velocities_start_in_v()
        state = vehicle_states(pose, x[place : place + 6, None])[:, 0]
        yaw, now = state[5], state[6]
        turn, side = state[11], state[7]
        if "yaw_rate" in drive.outputs:
            turn = _first(drive.outputs["yaw_rate"], drive.step, 0)
        if "vy" in drive.outputs:
            side = _first(drive.outputs["vy"], drive.step, 0) - turn * float(self._whole.com[0])
        velocities = plant.GetVelocities(plant_context).copy()
        at = part.base.floating_velocities_start_in_v()
        velocities[at + 2] = turn
        velocities[at + 3] = speed * math.cos(yaw) - side * math.sin(yaw)
        velocities[at + 4] = speed * math.sin(yaw) + side * math.cos(yaw)
        ratio = speed / now if abs(now) > 0.1 else 1.0
        for joint in part.wheels:
            velocities[joint.velocity_start()] *= ratio
        plant.SetVelocities(plant_context, velocities)

    def _seen(self, p: Mapping[str, float], x: Array) -> dict[str, Array]:
        """What sensors show, by channel, from states of the plant (states, n)."""
        part = self._part
        place = self.assembly.parts.plant.num_positions() + part.base.floating_velocities_start_in_v()
        state = vehicle_states(x[part.base.floating_positions_start() :][:7], x[place:][:6])
        vx, vy, turn = state[6], state[7], state[11]
        ahead = float(self._whole.com[0])
        slopes = [np.gradient(values, self._step) for values in (vx, vy, turn)]
        there, tilt = ahead + p["accelerometer_ahead"], p["accelerometer_tilt"]
        return {
            "vx": vx,
            "vy": vy + (ahead + p["velocity_ahead"]) * turn,
            "yaw_rate": turn,
            "longitudinal_acceleration": slopes[0] - vy * turn - there * turn**2 - tilt * GRAVITY * state[4],
            "lateral_acceleration": slopes[1] + vx * turn + there * slopes[2] + tilt * GRAVITY * state[3],
            "roll": state[3],
            "roll_rate": state[9],
        }

    def plausible_range(self, name: str, p: Mapping[str, float]) -> tuple[float, float]:
        """Within what cargo can do."""
        del p
        whole = self._whole
        ranges = {
            "mass": (0.5 * whole.mass, 2.5 * whole.mass),
            "yaw_inertia": (0.5 * float(whole.inertia[2, 2]), 3.0 * float(whole.inertia[2, 2])),
        }
        return ranges.get(name, (-np.inf, np.inf))

    def suggest_experiment(self, names: frozenset[str]) -> str:
        """Which drive would tell these parameters apart."""
        if names & {"friction"}:
            return "brake or turn to the limit of the tyres"
        if names & {"mass", "rolling_resistance", "wheel_damping"}:
            return "accelerate hard, then coast; record the torque at the wheels"
        return "do step steers and a sweep to 2 Hz, and record the lateral velocity"


def _find_drive(asked: str | None, offered: set[str], vehicle: Vehicle) -> str:
    """How the drive is fed in.

    Raises:
        ConfigError: unknown, not of this vehicle, or a channel is missing.
    """
    able = {"torque": vehicle.spec.tyres.kind != "coulomb", "pedals": vehicle.control.wheel_speed.kind == "pedals"}
    if asked is None:
        fits = (name for name, needs in DRIVES.items() if set(needs) <= offered and able.get(name, True))
        return next(fits)
    if asked not in DRIVES:
        raise ConfigError(f"model.drive: unknown drive '{asked}'; {did_you_mean(asked, DRIVES)}")
    if not able.get(asked, True):
        need = "a tyre model" if asked == "torque" else "pedals"
        raise ConfigError(f"model.drive: {asked} needs a vehicle with {need}, {vehicle.name} has none; take speed")
    for name in DRIVES[asked]:
        if name not in offered:
            raise ConfigError(f"model.drive: {asked} needs channel '{name}' in every log; map its column in 'channels'")
    return asked


def _fine(drive: Segment) -> Array:
    """Times of the samples from the first one on (n) [s]."""
    return np.asarray(drive.step * np.arange(drive.size), dtype=np.float64)


def _first(values: Array, step: float, row: int) -> float:
    """A channel at a row: of a straight line through the samples behind it."""
    count = max(round(_FIRST / step), 3)
    part = values[row : row + count]
    good = np.isfinite(part)
    if good.sum() < 3:
        return float(part[good][0]) if good.any() else 0.0
    slope, level = np.polyfit(np.flatnonzero(good), part[good], 1)
    del slope
    return float(level)
