"""Drives of the full plant of the Bolt on its springs, with a steering actuator, and their sensor signals.

What the plant is worth to a single track is worked out here from its files, without the code under test: mass, centre
and inertia of its bodies by Drake, the tyre's cornering stiffness by the formula of its .tir file, and the chain of the
steering by the numbers that are written into vehicle.yaml.
"""

import math
import re
import shutil
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.multibody.tree import BodyIndex

from mirdrake.assembly.diagram import assemble
from mirdrake.assembly.diagram_spec import make_spec
from mirdrake.core.paths import data_root
from mirdrake.identification import DataSet, Log
from mirdrake.runs.simulation import Simulation
from mirdrake.vehicles import load_vehicle
from mirdrake.vehicles.parse import parse_urdf

DELAY, LAG = 0.04, 0.06
"""Of the steering actuator [s]."""

RATE = 1600.0
"""Of plant, driver, control unit and record [Hz]. The plant is late by 7 % of a step: 0.7 % of the delay at 200 Hz."""

COASTING_RATE = 200.0
"""The same without steering [Hz]."""

SUNK = 0.019
"""The origin of the car's frame is so far below the road in the drives [m]: its tyres are round in the files, and have
2e5 N/m each in point contact."""

ROLLING = 0.9694
"""Rolling radius over that of the unloaded wheel [1]: variants/handling.yaml."""

DRIVES = {
    "sweep": (25.0, 22.0, {"kind": "sweep", "amplitude": 0.006, "first": 0.2, "last": 3.0, "length": 20.0}),
    "slow": (12.0, 22.0, {"kind": "random", "amplitude": 0.015, "first": 0.1, "last": 3.0, "length": 20.0}),
    "step": (20.0, 5.0, {"kind": "step", "amplitude": 0.012, "rise": 0.1}),
}
"""Speed at the start [m/s], duration [s] and steering, which begins after a second."""

NOISE = {
    "vx": 0.02, "vy": 0.02, "yaw_rate": 0.002, "roll_rate": 0.002, "lateral_acceleration": 0.05,
    "road_wheel_angle": 1e-4, "steering_command": 0.0,
}  # fmt: skip
"""Standard deviation of the noise of each sample.

At least twice that of the preset automotive_imu at 100 Hz, because a car vibrates; speeds are those of an optical
sensor, the angle is that of a hand wheel in steps of 0.1 degrees."""

OFFSET = {"vy": 0.01, "yaw_rate": 0.002, "roll_rate": -0.003, "lateral_acceleration": 0.05}


@dataclass
class Bolt:
    """A copy of the Bolt's folder whose steering has a delay and a lag.

    Attributes:
        model: path and variant.
    """

    model: str

    @classmethod
    def copy(cls, folder, *, firm=1):
        """Copy the vehicle into a folder; its steering is `firm` times as stiff and as damped."""
        target = folder / "bolt"
        shutil.copytree(data_root() / "models" / "bolt", target)
        file = target / "variants" / "handling.yaml"
        text = file.read_text()
        with_actuators = f"  actuators:\n    steering: {{delay: {DELAY}, time_constant: {LAG}}}\n"
        changed = text.replace("  actuators:\n", with_actuators, 1)
        assert changed != text
        servo = "stiffness: 5.0e4, damping: 1.0e3}"
        assert servo in changed
        changed = changed.replace(servo, f"stiffness: {5e4 * firm}, damping: {1e3 * firm}}}")
        file.write_text(changed)
        return cls(f"{target}@handling")

    def drive(self, profile, speed, duration, *, pedals=None, rate=RATE):
        """Return channels (n) by name; vy and lateral acceleration are those of the frame's origin."""
        driver: dict[str, Any] = {"kind": "mirdrake.manoeuvres.drivers:OpenLoopDriver"}
        driver |= {"speeds": [[0.0, speed]]} if pedals is None else {"pedals": pedals}
        driver |= {"profile": profile, "period": 1.0 / rate}
        pose = {"x": 0.0, "y": 0.0, "yaw": 0.0}
        spec = {
            "name": "drive",
            "world": "empty",
            "vehicles": {"ego": {"model": self.model, "start": pose, "speed": speed, "control": {"rate": rate}}},
            "control": {"ego": driver},
            "plant": {"contact": "point", "time_step": 1.0 / rate},
            "record": {"rate": rate, "meshcat": False, "report": False},
            "duration": duration,
        }
        signals = Simulation(assemble(make_spec(spec))).run().signals
        time = signals.index.to_numpy()
        recorded = {name: signals[f"ego.{name}"].to_numpy() for name in ("vx", "vy", "wz", "wx", "steering_command")}
        angles = [signals[f"ego.steering_angle.{side}"].to_numpy() for side in ("left", "right")]
        channels = {
            "vx": recorded["vx"], "vy": recorded["vy"], "yaw_rate": recorded["wz"], "roll_rate": recorded["wx"],
            "lateral_acceleration": np.gradient(recorded["vy"], time) + recorded["vx"] * recorded["wz"],
            "road_wheel_angle": 0.5 * (angles[0] + angles[1]), "steering_command": recorded["steering_command"],
        }  # fmt: skip
        return time, channels

    def lateral(self):
        """Return the drives of :data:`DRIVES`, exact."""
        return {
            name: self.drive({**profile, "start": 1.0}, speed, duration)
            for name, (speed, duration, profile) in DRIVES.items()
        }

    def coast(self, start=30.0, duration=70.0):
        """Return a coast-down in neutral, exact."""
        pedals = [[0.0, 0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]]
        still = {"kind": "step", "amplitude": 0.0}
        return self.drive(still, start, duration, pedals=pedals, rate=COASTING_RATE)


def noisy(exact, names, seed, *, name="drive", use="train", begin=0.5):
    """Return an exact drive as measured by sensors with noise and offsets, at 100 Hz."""
    time, channels = exact
    rate = 1.0 / (time[1] - time[0])
    random = np.random.default_rng(seed)
    rows = slice(round(begin * rate), None, round(rate / 100.0))
    noisy_channels = {
        name: (channels[name] + OFFSET.get(name, 0.0) + random.normal(0.0, NOISE[name], len(time)))[rows]
        for name in names
    }
    return Log(name, use, time[rows], noisy_channels)


def lateral_data(drives, names, seed=0):
    """Return a data set of the lateral drives; the step is for validation."""
    return DataSet(
        tuple(
            noisy(exact, names, 10 * seed + k, name=name, use="validation" if name == "step" else "train")
            for k, (name, exact) in enumerate(drives.items())
        )
    )


@dataclass
class Truth:
    """True parameters.

    Attributes:
        mass: [kg].
        front_length: [m].
        rear_length: [m].
        yaw_inertia: of all bodies about their common centre of mass [kg m²].
        spin_inertia: what wheels and motor add to it, since wheels outside turn faster in a bend [kg m²].
        rotating_mass: what turns with the wheels, reduced to the road [kg].
        stiffness: of both tyres of front and rear axle at their static load [N/rad].
        driven_stiffness: the same with the load transfer of rolling resistance and the longitudinal force of the front
            axle [N/rad].
    """

    mass: float
    front_length: float
    rear_length: float
    yaw_inertia: float
    spin_inertia: float
    rotating_mass: float
    stiffness: tuple[float, float]
    driven_stiffness: tuple[float, float]


def truth():
    """Return the true parameters of the Bolt from its files, see the module's docstring."""
    vehicle = load_vehicle("bolt@handling")
    plant, _, _ = parse_urdf(vehicle.urdf, packages=vehicle.packages, where_line=str)
    context = plant.CreateDefaultContext()
    bodies = [BodyIndex(number) for number in range(1, plant.num_bodies())]
    whole = plant.CalcSpatialInertia(context, plant.world_frame(), bodies)
    mass, ahead = whole.get_mass(), whole.get_com()[0]
    turn = whole.Shift(whole.get_com()).CalcRotationalInertia().CopyToFullMatrix3()[2, 2]
    radius, half = vehicle.geometry.front_wheel_radius, 0.5 * vehicle.geometry.front_track
    spin = 0.5 * 20.0 * radius**2  # solid cylinders of 20 kg: models/bolt/properties.xacro, 4
    turning = 4.0 * spin + 0.04 * 7.05**2  # the motor: variants/handling.yaml
    length = vehicle.geometry.wheelbase
    # Rolling resistance holds the wheels by Crr N R, which moves load to the rear. The front wheels pull the rear ones
    # to where they point, as if they were stiffer by that force.
    rolling = 0.0079 * mass * 9.80665
    pull = rolling * (length - ahead) / length
    tir = (data_root() / "models" / "tyres" / "215_50R17.tir").read_text()
    data = dict(re.findall(r"^(\w+)\s*=\s*(\S+)", tir, re.MULTILINE))
    nominal, k1, k2, k4 = (float(data[name]) for name in ("FNOMIN", "PKY1", "PKY2", "PKY4"))
    # H. B. Pacejka, Tyre and Vehicle Dynamics, 3rd ed., equation 4.E25.
    resting: list[float] = []
    driven: list[float] = []
    for moved, stiffnesses in ((0.0, resting), (rolling * radius, driven)):
        for moment in (mass * 9.80665 * ahead - moved, mass * 9.80665 * (length - ahead) + moved):
            load = 0.5 * moment / length
            stiffnesses.append(2.0 * abs(k1) * nominal * math.sin(k4 * math.atan(load / (k2 * nominal))))
    return Truth(
        mass, length - ahead, ahead, turn, turning * (half / (ROLLING * radius)) ** 2, turning / radius**2,
        (resting[0], resting[1]), (driven[0] + pull, driven[1]),
    )  # fmt: skip
