"""Cases of the blind set: a vehicle, its present control and the delay of its actuators, drawn by number and seed."""

import math
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import yaml

from mirdrake.vehicles import load_vehicle
from mirdrake.vehicles.scaffold import new_vehicle

LOOPS = ("speed", "steering")
"""Loops that are tuned."""


@dataclass(frozen=True)
class Case:
    """A vehicle of the blind set.

    Attributes:
        number: of the case, from 0.
        seed: of the set.
        mass: [kg].
        wheelbase: [m].
        track: [m].
        wheel_radius: [m].
        drive: front, rear or all.
        slip_tyres: whether the variant ``handling`` is driven, with a brush tyre and pedals.
        delay: of the actuators [s].
        hand_set: whether wheels and steering have PID controllers set by hand instead of the servos of a new vehicle.
        speed_bandwidth: of the hand-set speed [rad/s].
        steering_bandwidth: of the hand-set steering [rad/s].
    """

    number: int
    seed: int
    mass: float
    wheelbase: float
    track: float
    wheel_radius: float
    drive: str
    slip_tyres: bool
    delay: float
    hand_set: bool
    speed_bandwidth: float
    steering_bandwidth: float

    @property
    def vehicle(self) -> str:
        """Name of the vehicle, with its variant."""
        return f"blind_{self.seed}_{self.number}{'@handling' if self.slip_tyres else ''}"

    def row(self) -> dict[str, object]:
        """Return the case as plain data."""
        return asdict(self)


def draw_case(number: int, seed: int) -> Case:
    """Draw a case; it depends on its number and the seed only.

    The mass is log-uniform from 10 kg to 20 t. Lengths grow with the cube root of the mass, as those of bodies of equal
    density, and are scattered by 12 %. Bandwidths that are set by hand are below 0.35 over the delay of the loop, which
    an engineer would choose to be safe (a phase margin of 70° for an integrator).
    """
    random = np.random.default_rng([seed, number])
    mass = float(np.exp(random.uniform(math.log(10.0), math.log(20_000.0))))
    size = (mass / 1450.0) ** (1.0 / 3.0) * float(np.exp(random.normal(0.0, 0.12)))
    delay = float(random.uniform(0.0, 0.15))
    fastest = 0.35 / (delay + 0.05)
    return Case(
        number=number,
        seed=seed,
        mass=round(mass, 1),
        wheelbase=round(2.6 * size, 3),
        track=round(1.5 * size * float(random.uniform(0.93, 1.05)), 3),
        wheel_radius=round(0.31 * size * float(random.uniform(0.9, 1.1)), 3),
        drive=str(random.choice(["front", "rear", "all"])),
        slip_tyres=bool(random.random() < 0.25),
        delay=round(delay, 3),
        hand_set=bool(random.random() < 0.6),
        speed_bandwidth=round(min(float(np.exp(random.uniform(math.log(0.3), math.log(2.0)))), fastest), 3),
        steering_bandwidth=round(min(float(np.exp(random.uniform(0.0, math.log(4.0)))), fastest), 3),
    )


def write_case(case: Case, folder: Path) -> Path:
    """Write the vehicle of a case and return its folder."""
    vehicle = new_vehicle(
        case.vehicle.partition("@")[0],
        wheelbase=case.wheelbase,
        track=case.track,
        mass=case.mass,
        wheel_radius=case.wheel_radius,
        wheel_width=round(0.65 * case.wheel_radius, 3),
        drive=case.drive,
        sensors="none",
        folder=folder,
    )
    if case.hand_set:
        _set_by_hand(case, vehicle)
    return vehicle


def _set_by_hand(case: Case, vehicle: Path) -> None:
    """Replace the servos by PID controllers: the speed of a mass, and the angle of a motor with damping.

    A torque kp accelerates a mass on n driven wheels by kp n / (m r²), so that kp = ω m r² / n; a damped motor turns by
    kp / b, so that kp = ω b. The integral part of the speed has a time of 4 / ω.
    """
    loaded = load_vehicle(str(vehicle))
    driven = len(loaded.spec.driven_wheels())
    gain = case.speed_bandwidth * case.mass * case.wheel_radius**2 / driven
    damping = _steering_damping(vehicle)
    file = vehicle / "control.yaml"
    control = yaml.safe_load(file.read_text(encoding="utf-8"))
    control["speed"] |= {"kp": 0.0, "ki": 0.0}
    control["wheel_speed"] = {"kind": "pid", "kp": gain, "ki": 0.25 * case.speed_bandwidth * gain}
    control["steering"] = {"kind": "pid", "kp": case.steering_bandwidth * damping}
    file.write_text(yaml.safe_dump(control, sort_keys=False), encoding="utf-8")


def _steering_damping(vehicle: Path) -> float:
    """Return the damping of a steering joint [N m s/rad]."""
    from xml.etree import ElementTree

    joints = ElementTree.fromstring(load_vehicle(str(vehicle)).urdf).findall("joint")
    return next(
        float(dynamics.get("damping", "0"))
        for joint in joints
        if "steer" in str(joint.get("name")) and (dynamics := joint.find("dynamics")) is not None
    )
