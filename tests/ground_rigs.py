"""Drives on uneven ground, and the energy of a vehicle on its tyres."""

from collections.abc import Mapping, Sequence
from math import sin
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import yaml
from pandas import DataFrame
from pydrake.systems.framework import Context

from mirdrake.assembly.diagram import Assembly, assemble
from mirdrake.assembly.diagram_spec import make_spec
from mirdrake.core.compiled import compiled
from mirdrake.core.constants import GRAVITY
from mirdrake.ground.layers import GROUND_PARTS
from mirdrake.plant.wheels.ground_contact import CONTACT_PARTS, GroundContact, ground_contact
from mirdrake.plant.wheels.motion import base_motion, wheel_places
from mirdrake.runs.simulation import Simulation
from mirdrake.tyres.vertical import VerticalTyre

WHEEL_LOADS = [f"ego.wheel_load.{side}" for side in ("front_left", "front_right", "rear_left", "rear_right")]
TYRE_FX = [name.replace("wheel_load", "tyre_fx") for name in WHEEL_LOADS]
TYRE_FY = [name.replace("wheel_load", "tyre_fy") for name in WHEEL_LOADS]


def on_ground(
    folder: Path,
    *,
    relief: list[dict[str, Any]] | None = None,
    ground: Mapping[str, Any] | None = None,
    world: Mapping[str, Any] | None = None,
    model: str = "bolt@handling",
    contact: str = "tyre",
    step: float = 0.005,
    start: float = 0.0,
    speed: float = 0.0,
    steering: float = 0.0,
    rows: Sequence[tuple[float, float, float]] | None = None,
    control: Mapping[str, Any] | None = None,
    parked: bool = False,
    plant: Mapping[str, Any] | None = None,
    **more: Any,
) -> Assembly:
    """Return a diagram with a vehicle that starts along x, logged at every step.

    Args:
        folder: receives the world file.
        relief: layers of the ground.
        ground: further keys of the ground.
        world: further keys of the world.
        model: the vehicle.
        contact: of the plant.
        step: of the plant [s].
        start: x of the start [m]; y is zero.
        speed: at the start, and commanded [m/s].
        steering: commanded from 0.5 s on [rad].
        rows: commands instead: time [s], speed [m/s], steering [rad].
        control: driver instead of these commands.
        parked: whether parking brakes hold it.
        plant: further settings of the plant.
        more: further keys of the diagram.
    """
    content = {
        "mirdrake": "world/1",
        "ground": {"size": [4000, 4000], "relief": relief or [], **(ground or {})},
        **(world or {}),
    }
    file = folder / "world.yaml"
    file.write_text(yaml.safe_dump(content), encoding="utf-8")
    commands = rows or [(0.0, speed, 0.0), (0.5, speed, steering)]
    schedule = [dict(zip(("time", "speed", "steering"), row, strict=True)) for row in commands]
    entry = {"model": model, "start": {"x": start, "y": 0.0, "yaw": 0.0}, "speed": speed, "parked": parked}
    diagram = {
        "name": "ground",
        "world": str(file),
        "vehicles": {"ego": entry},
        "control": {"ego": dict(control or {"kind": "schedule", "rows": schedule})},
        "plant": {"contact": contact, "time_step": step, **(plant or {})},
        "record": {"rate": 1.0 / step, "report": False, "meshcat": False},
        **more,
    }
    return assemble(make_spec(diagram))


def drive(folder: Path, *, duration: float, **settings: Any) -> DataFrame:
    """Return the signals of a drive of :func:`on_ground`."""
    return Simulation(on_ground(folder, **settings)).run(duration=duration).signals


class TyreEnergy:
    """A monitor of a vehicle with springs on tyres of its own, without motors: energy, and work that dissipates it.

    Args:
        assembly: the diagram.
        brake: torque of each brake, constant [N m].

    Attributes:
        energy: kinetic energy, and potential energy of weight, springs, bars and tyres, after each step [J].
        work: that of dampers, of the damping of the tyres, of their slip and of the brakes until then, negative [J].
        momentum: of the vehicle in the world after each step (3) [N s].
        impulse: of the ground on the tyres and of the weight until then (3) [N s].
    """

    def __init__(self, assembly: Assembly, brake: float = 0.0) -> None:
        self._brake = brake
        self._plant, self._part, self._tyres = (
            assembly.parts.plant,
            assembly.parts.vehicles["ego"],
            assembly.tyres["ego"],
        )
        self._places, self._terrain = wheel_places(self._part), assembly.parts.terrain
        self._contact = compiled(ground_contact, parts=(*GROUND_PARTS, *CONTACT_PARTS))
        self._before: Any = None
        self.energy: list[float] = []
        self.work: list[float] = [0.0]
        self.momentum: list[npt.NDArray[np.float64]] = []
        self.impulse: list[npt.NDArray[np.float64]] = [np.zeros(3)]

    def __call__(self, context: Context) -> None:
        plant, part = self._plant, self._part
        own = plant.GetMyContextFromRoot(context)
        q, v = plant.GetPositions(own), plant.GetVelocities(own)
        energy = plant.CalcKineticEnergy(own) + plant.CalcPotentialEnergy(own)
        springs, geometry = part.vehicle.spec.suspension, part.vehicle.geometry
        assert springs is not None
        travel = [float(q[joint.position_start()]) for joint in part.suspension]
        for left, bar in ((0, springs.front), (2, springs.rear)):
            energy += 0.5 * bar.anti_roll * (travel[left] - travel[left + 1]) ** 2
        damped = sum(
            corner.damping * float(v[joint.velocity_start()]) ** 2
            for corner, joint in zip(springs.corners(), part.suspension, strict=True)
        )

        # Contacts of the wheels; the energy of a tyre is that of its effective deflection.
        x = plant.GetPositionsAndVelocities(own)
        base = base_motion(x.tolist(), self._places[0].base, plant.num_positions(), part.period)
        terrain = self._terrain
        contacts, elastic = [], []
        sizes = zip(self._places, geometry.wheel_radii, geometry.wheel_widths, strict=True)
        for wheel, (place, radius, width) in enumerate(sizes):
            numbers = self._contact(x, place, radius, width, base, plant.num_positions(), terrain.data, terrain.samples)
            contact, tyre = GroundContact(*numbers), part.compression[wheel // 2]
            assert isinstance(tyre, VerticalTyre)
            depth = max(contact.deflection, 0.0)
            energy += depth**2 * (0.5 * tyre.stiffness + tyre.hardening * depth / 3.0)
            contacts.append(contact)
            elastic.append(contact.share * depth * (tyre.stiffness + tyre.hardening * depth))
        self.energy.append(float(energy))

        # The logged forces are those of the last step: the velocities in it are the mean of its ends.
        tyres = self._tyres.GetMyContextFromRoot(context)
        forces = np.array(self._tyres.tyre_forces.Eval(tyres)).reshape(4, 5)
        loads = self._tyres.wheel_load.Eval(tyres)
        self.momentum.append(plant.CalcSpatialMomentumInWorldAboutPoint(own, np.zeros(3)).translational())
        if self._before is not None:
            early_contacts, early_elastic, early_damped = self._before
            power = -0.5 * (damped + early_damped)
            force = np.array([0.0, 0.0, -GRAVITY * plant.CalcTotalMass(own, [part.instance])])
            for early, late, rubber, load, (fx, fy, mz, _, _) in zip(
                early_contacts, contacts, early_elastic, loads, forces, strict=True
            ):
                power -= (load - rubber) * 0.5 * (early.rate + late.rate)
                power += fx * 0.5 * (early.vx - early.spin * early.rolling + late.vx - late.spin * late.rolling)
                power += fy * 0.5 * (early.vy + late.vy)
                # About the normal the wheel turns with its carrier and, inclined, with a part of its spin.
                turns = [contact.turn + contact.spin * sin(contact.inclination) for contact in (early, late)]
                power += mz * 0.5 * sum(turns)
                power -= self._brake * 0.5 * abs(early.spin + late.spin)
                force += fx * np.array(early.ahead) + fy * np.array(early.left)
                force += load * np.array(early.normal)
            self.work.append(self.work[-1] + part.period * power)
            self.impulse.append(self.impulse[-1] + part.period * force)
        self._before = (contacts, elastic, damped)
