"""Random cases: vehicle, drives, sensors, faults and knowledge, each drawn by a seed."""

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.random import Generator
from vehiclemodels.vehicle_parameters import setup_vehicle_parameters

from benchmarks.calibration.truth import GRAVITY, STEP, Array, Kind, Vehicle

FAULTS = ("none", "late", "held", "glitches", "dropped", "repeated", "gap", "sign", "vy_sign", "degrees", "dummy")
"""Logger faults; the last but one and those of signs and units must be rejected or reported."""

MANOEUVRES = ("slalom", "sweep", "steps", "random", "lane_change", "circle", "laps", "dwell")


@dataclass(frozen=True)
class Sensors:
    """Sensors of a case.

    Attributes:
        step: sample time [s].
        steering: name of the steering channel.
        channels: recorded motion channels.
        noise: standard deviation of the noise by channel [SI].
        memory: correlation of the noise from row to row [1].
        bias: by channel [SI].
        drift: by channel [SI/s].
        resolution: by channel [SI]; 0 for none.
        accelerometer, velocity: positions ahead of the centre of mass [m].
        misaligned: rotation of the accelerometer about the vertical [rad].
        height: accelerometer above the roll axis [m].
    """

    step: float
    steering: str
    channels: tuple[str, ...]
    noise: dict[str, float]
    memory: float
    bias: dict[str, float]
    drift: dict[str, float]
    resolution: dict[str, float]
    accelerometer: float
    velocity: float
    misaligned: float
    height: float


@dataclass(frozen=True)
class Case:
    """A drawn case.

    Attributes:
        seed: seed.
        vehicle: the truth.
        sensors: the sensors.
        manoeuvres: by log; the last log is for validation.
        fault: one of :data:`FAULTS`.
        late: delay by channel [s].
        knowledge: "all", "sheet", "wheelbase" or "nothing".
        lively: lateral acceleration over the friction limit [1].
        speed: usual speed [m/s].
    """

    seed: int
    vehicle: Vehicle
    sensors: Sensors
    manoeuvres: tuple[str, ...]
    fault: str
    late: dict[str, float]
    knowledge: str
    lively: float
    speed: float
    known: dict[str, tuple[float, float]] = field(default_factory=dict)

    @property
    def is_of_the_fitted_family(self) -> bool:
        """Whether the fitted model contains the truth."""
        return self.vehicle.kind in {"linear", "brush", "magic"}


def draw_case(seed: int) -> Case:
    """Return the case of a seed."""
    random = np.random.default_rng(seed)
    kinds: tuple[Kind, ...] = ("linear", "brush", "magic", "two_track", "two_track", "multi_body")
    kind = kinds[seed % len(kinds)]
    vehicle = _multi_body(random) if kind == "multi_body" else _vehicle(random, kind)
    top = math.sqrt(GRAVITY * vehicle.wheelbase)
    lively = float(random.uniform(0.15, 0.75))
    speed = top * float(random.uniform(1.0, 4.5))
    if kind == "multi_body":
        lively, speed = min(lively, 0.5), float(random.uniform(12.0, 28.0))
    lateral = lively * vehicle.friction * GRAVITY
    # Understeer keeps every drawn vehicle stable; an oversteering one is driven below its critical speed.
    speed = min(speed, 0.7 * _critical_speed(vehicle))
    logs = int(random.choice([2, 3]))
    manoeuvres = tuple(str(name) for name in random.choice(MANOEUVRES, logs, replace=False))
    if random.random() < 0.12:
        manoeuvres = ("circle", "circle")
    sensors = _sensors(random, vehicle, lateral, speed)
    shares = np.array([3.0 if name == "late" else 1.0 for name in FAULTS[1:]])
    fault = "none" if random.random() < 0.5 else str(random.choice(FAULTS[1:], p=shares / shares.sum()))
    if fault == "vy_sign" and "vy" not in sensors.channels:
        fault = "none"
    late: dict[str, float] = {}
    if fault == "late":
        groups = [("vx", "vy"), ("yaw_rate", "lateral_acceleration"), ("vy",), ("lateral_acceleration",)]
        group = groups[int(random.integers(len(groups)))]
        late = dict.fromkeys(group, float(random.uniform(0.02, 0.15)))
    knowledge = str(random.choice(["all", "sheet", "wheelbase", "nothing"], p=[0.35, 0.25, 0.3, 0.1]))
    known = _knowledge(random, vehicle, knowledge)
    return Case(seed, vehicle, sensors, manoeuvres, fault, late, knowledge, lively, speed, known)


def _critical_speed(v: Vehicle) -> float:
    """Return the critical speed of an oversteering vehicle, infinite for others [m/s] (Rajamani, section 3.3)."""
    gradient = v.mass / v.wheelbase * (v.rear / v.stiffness_front - v.front / v.stiffness_rear)
    return math.sqrt(-v.wheelbase / gradient) if gradient < 0.0 else math.inf


def _vehicle(random: Generator, kind: Kind) -> Vehicle:
    """Return a vehicle of 12 kg to 20 t."""
    mass = float(np.exp(random.uniform(math.log(12.0), math.log(20e3))))
    length = float(np.clip(0.19 * mass**0.36 * random.uniform(0.85, 1.2), 0.3, 6.5))
    rear = length * float(random.uniform(0.42, 0.6))
    front = length - rear
    friction = float(random.uniform(0.6, 1.1))
    loads = mass * GRAVITY * rear / length, mass * GRAVITY * front / length
    slopes = float(random.uniform(6.0, 16.0)), float(random.uniform(7.0, 18.0))
    full = kind == "two_track"
    lagging = random.random() < 0.5
    return Vehicle(
        kind, mass, front, rear, mass * front * rear * float(random.uniform(0.8, 1.3)),
        slopes[0] * loads[0], slopes[1] * loads[1], friction,
        shape=float(random.uniform(1.2, 1.7)), curvature=float(random.uniform(-2.0, 0.4)),
        relaxation=length * float(random.uniform(0.1, 0.3)) if full or random.random() < 0.25 else 0.0,
        ratio=1.0, offset=float(random.normal(0.0, 0.004)),
        delay=float(random.uniform(0.0, 0.08)) if lagging else 0.0,
        lag=float(random.uniform(0.02, 0.12)) if lagging and random.random() < 0.5 else 0.0,
        height=length * float(random.uniform(0.12, 0.28)), track=length * float(random.uniform(0.5, 0.65)),
        roll_gain=float(random.uniform(0.003, 0.012)) if full else 0.0,
        roll_frequency=float(random.uniform(6.0, 14.0)) * (2.7 / length) ** 0.5,
        roll_damping=float(random.uniform(0.2, 0.5)), roll_front=float(random.uniform(0.4, 0.65)),
        load_exponent=float(random.uniform(0.7, 1.0)), drive_front=float(random.choice([0.0, 0.5, 1.0])),
    )  # fmt: skip


def _multi_body(random: Generator) -> Vehicle:
    """Return one of the cars of commonroad-vehicle-models; their stiffness includes camber and is not compared."""
    car = int(random.integers(1, 4))
    p = setup_vehicle_parameters(car)
    loads = p.m * GRAVITY * p.b / (p.a + p.b), p.m * GRAVITY * p.a / (p.a + p.b)
    return Vehicle(
        "multi_body", p.m, p.a, p.b, p.I_z, -p.tire.p_ky1 * loads[0], -p.tire.p_ky1 * loads[1], 1.0,
        offset=0.0, delay=float(random.uniform(0.0, 0.06)), height=p.h_s, car=car,
    )  # fmt: skip


def _sensors(random: Generator, vehicle: Vehicle, lateral: float, speed: float) -> Sensors:
    """Return sensors whose noise is 0.3 to 8 % of the signal."""
    channels = ["vx", "yaw_rate"]
    channels += ["lateral_acceleration"] if random.random() < 0.8 else []
    channels += ["vy"] if random.random() < 0.45 else []
    channels += ["longitudinal_acceleration"] if random.random() < 0.4 else []
    channels += ["yaw"] if random.random() < 0.25 else []
    steering = str(random.choice(["road_wheel_angle", "steering_wheel_angle", "steering_command"]))
    angle = vehicle.wheelbase * lateral / speed**2
    sizes = {
        "vx": 0.1 * speed, "yaw_rate": lateral / speed, "lateral_acceleration": lateral,
        "vy": 0.03 * speed, "longitudinal_acceleration": 1.0, "yaw": 0.5, steering: angle,
    }  # fmt: skip
    level = float(np.exp(random.uniform(math.log(0.003), math.log(0.08))))
    noise = {name: level * size * float(random.uniform(0.5, 2.0)) for name, size in sizes.items()}
    noise[steering] *= 0.3
    biased, drifting, coarse = random.random() < 0.5, random.random() < 0.2, random.random() < 0.3
    own = [name for name in sizes if name not in {"vx", "yaw", steering}]
    return Sensors(
        float(random.choice([0.01, 0.02, 0.02, 0.04])), steering, tuple(channels), noise,
        float(random.choice([0.0, 0.0, 0.8])),
        {name: 0.03 * sizes[name] * float(random.normal()) for name in own} if biased else {},
        {name: 5e-4 * sizes[name] * float(random.normal()) for name in own} if drifting else {},
        {name: 0.02 * size for name, size in sizes.items()} if coarse else {},
        vehicle.wheelbase * float(random.uniform(-0.3, 0.3)) if random.random() < 0.6 else 0.0,
        vehicle.wheelbase * float(random.choice([0.0, -vehicle.rear / vehicle.wheelbase, random.uniform(-0.5, 0.5)])),
        float(random.normal(0.0, 0.02)) if random.random() < 0.3 else 0.0,
        vehicle.height * float(random.uniform(-0.5, 0.5)),
    )  # fmt: skip


def _knowledge(random: Generator, v: Vehicle, knowledge: str) -> dict[str, tuple[float, float]]:
    """Return known values and their standard deviations; those of a data sheet are wrong by as much."""
    if knowledge not in {"all", "sheet"}:
        return {}
    share = {"all": 0.0, "sheet": 0.04}[knowledge]
    return {
        "mass": (v.mass * (1.0 + share * float(random.normal())), share * v.mass),
        "front_length": (v.front + share * v.wheelbase * float(random.normal()), share * v.wheelbase),
    }


def courses(case: Case, random: Generator) -> list[tuple[Array, Array]]:
    """Return the speed [m/s] and steering command of each log."""
    return [_course(case, name, random) for name in case.manoeuvres]


def _course(case: Case, name: str, random: Generator) -> tuple[Array, Array]:
    v = case.vehicle
    span = float(random.uniform(20.0, 40.0))
    t = STEP * np.arange(round(span / STEP))
    usual = case.speed
    lateral = case.lively * v.friction * GRAVITY
    quick = math.sqrt(2.7 / v.wheelbase)  # time scales with the square root of the length
    speed = usual * (1.0 + 0.05 * np.sin(0.3 * t + random.uniform(0, 6)))
    begin = np.clip((t - 1.0) / 1.0, 0.0, 1.0)
    if name == "slalom":
        shape = np.sin(2 * np.pi * random.uniform(0.25, 0.6) * quick * t)
    elif name == "sweep":
        low, high = 0.15 * quick, random.uniform(1.0, 2.5) * quick
        shape = np.sin(2 * np.pi * (low * t + 0.5 * (high - low) / span * t**2))
    elif name == "steps":
        levels = random.uniform(-1.0, 1.0, int(span / 4.0) + 2)
        raw = levels[(t / 4.0).astype(int)]
        shape = _smooth(raw, 0.1 / quick)
    elif name == "random":
        shape = _smooth(random.normal(size=len(t)), 0.15 / quick)
        shape = np.clip(shape / (2.0 * float(np.std(shape))), -1.3, 1.3)
    elif name == "lane_change":
        phase = np.mod(t, 8.0 / quick) * quick
        shape = np.where(phase < 2.0, np.sin(np.pi * phase), 0.0) - np.where(
            (phase > 3.5) & (phase < 5.5), np.sin(np.pi * (phase - 3.5)), 0.0
        )
        shape = _smooth(shape, 0.05 / quick)
    elif name == "circle":
        shape = np.ones(len(t))
        speed = usual * (0.4 + 0.6 * t / span)
    elif name == "laps":
        corner = _smooth(random.normal(size=len(t)), 1.2 / quick)
        shape = np.clip(corner / (1.5 * np.std(corner)), -1.0, 1.0)
        slow = _smooth(random.normal(size=len(t)), 2.5)
        speed = usual * np.clip(0.75 + 0.12 * slow / np.std(slow), 0.45, 1.05)
    else:
        phase = np.mod(t, 6.0) * 0.7 * quick
        shape = np.where(phase < 0.75, np.sin(2 * np.pi * phase), np.where(phase < 1.1, -1.0, 0.0))
        late = (phase >= 1.1) & (phase < 1.35)
        shape = _smooth(np.where(late, -np.cos(2 * np.pi * (phase - 1.1)), shape), 0.04 / quick)
    top = float(np.max(speed))
    understeer = v.mass / v.wheelbase * (v.rear / v.stiffness_front - v.front / v.stiffness_rear)
    angle = lateral * (v.wheelbase / top**2 + max(understeer, -0.5 * v.wheelbase / top**2))
    if name != "circle":
        shape = shape * begin
    wander = 0.02 * _smooth(random.normal(size=len(t)), 0.6)
    wander *= 0.0 if name == "circle" and random.random() < 0.5 else 1.0
    return speed, v.ratio * (min(angle, 0.5) * (shape + wander / max(float(np.std(wander)), 1e-9) * 0.02) - v.offset)


def _smooth(values: Array, width: float) -> Array:
    from scipy.ndimage import gaussian_filter1d

    return np.asarray(gaussian_filter1d(values, width / STEP, mode="nearest"))
