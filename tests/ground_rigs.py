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

    Positions lead velocities by half a step. The energy is at the time of the velocities: potential energies are the
    mean of two steps. The power in a step is that of its contacts with the mean of the velocities at its ends. At the
    time of the positions, or with contacts of both ends, both would have an error of first order in the step, which on
    a bump is that of several kilowatts.

    Args:
        assembly: the diagram.
        brake: torque of each brake, constant [N m].

    Attributes:
        energy: kinetic energy, and potential energy of weight, springs, bars and tyres, after each step [J].
        work: that of dampers, of the damping of the tyres, of their slip and of the brakes until then, negative [J].
            The overturning moment of the tyres, which is not logged, is not in it.
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
        q, v = plant.GetPositions(own).copy(), plant.GetVelocities(own).copy()
        springs = part.vehicle.spec.suspension
        assert springs is not None
        potential = plant.CalcPotentialEnergy(own)
        travel = [float(q[joint.position_start()]) for joint in part.suspension]
        for left, bar in ((0, springs.front), (2, springs.rear)):
            potential += 0.5 * bar.anti_roll * (travel[left] - travel[left + 1]) ** 2
        # The energy of a tyre is that of its effective deflection.
        for tyre, contact in zip(self._tyre_springs(), self._contacts(q, v), strict=True):
            depth = max(contact.deflection, 0.0)
            potential += depth**2 * (0.5 * tyre.stiffness + tyre.hardening * depth / 3.0)
        q_before, v_before, potential_before = self._before or (q, v, potential)
        self.energy.append(float(plant.CalcKineticEnergy(own) + 0.5 * (potential_before + potential)))
        self.momentum.append(plant.CalcSpatialMomentumInWorldAboutPoint(own, np.zeros(3)).translational())
        if self._before is not None:
            self._add_step(context, self._contacts(q_before, 0.5 * (v_before + v)), v_before, v)
        self._before = (q, v, potential)

    def _tyre_springs(self) -> list[VerticalTyre]:
        """Return the vertical tyre of each wheel."""
        tyres = [self._part.compression[wheel // 2] for wheel in range(len(self._places))]
        return [tyre for tyre in tyres if isinstance(tyre, VerticalTyre)]

    def _contacts(self, q: npt.NDArray[np.float64], v: npt.NDArray[np.float64]) -> list[GroundContact]:
        """Return the contacts of the wheels at positions and velocities of the same time."""
        x, positions, terrain = np.concatenate([q, v]), self._plant.num_positions(), self._terrain
        base, geometry = base_motion(x.tolist(), self._places[0].base, positions), self._part.vehicle.geometry
        return [
            GroundContact(*self._contact(x, place, radius, width, base, positions, terrain.data, terrain.samples))
            for place, radius, width in zip(self._places, geometry.wheel_radii, geometry.wheel_widths, strict=True)
        ]

    def _add_step(
        self,
        context: Context,
        contacts: list[GroundContact],
        v_before: npt.NDArray[np.float64],
        v: npt.NDArray[np.float64],
    ) -> None:
        """Add work and impulse of the last step; the logged forces are those that acted in it."""
        plant, part = self._plant, self._part
        tyres = self._tyres.GetMyContextFromRoot(context)
        forces = np.array(self._tyres.tyre_forces.Eval(tyres)).reshape(4, 5)
        loads, springs = self._tyres.wheel_load.Eval(tyres), part.vehicle.spec.suspension
        assert springs is not None
        power = 0.0
        for corner, joint in zip(springs.corners(), part.suspension, strict=True):
            rates = [float(velocity[joint.velocity_start()]) for velocity in (v_before, v)]
            power -= corner.damping * 0.5 * (rates[0] ** 2 + rates[1] ** 2)
        own = plant.GetMyContextFromRoot(context)
        force = np.array([0.0, 0.0, -GRAVITY * plant.CalcTotalMass(own, [part.instance])])
        for contact, tyre, load, (fx, fy, mz, _, _) in zip(contacts, self._tyre_springs(), loads, forces, strict=True):
            depth = max(contact.deflection, 0.0)
            elastic = contact.share * depth * (tyre.stiffness + tyre.hardening * depth)
            power -= (load - elastic) * contact.rate
            power += fx * (contact.vx - contact.spin * contact.rolling) + fy * contact.vy
            # About the normal the wheel turns with its carrier and, inclined, with a part of its spin.
            power += mz * (contact.turn + contact.spin * sin(contact.inclination))
            power -= self._brake * abs(contact.spin)
            force += fx * np.array(contact.ahead) + fy * np.array(contact.left) + load * np.array(contact.normal)
        self.work.append(self.work[-1] + part.period * power)
        self.impulse.append(self.impulse[-1] + part.period * force)
