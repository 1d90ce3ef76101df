"""Freely rolling reference vehicles for the tests of energy: no motor, no brake, no aerodynamic forces."""

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from pydrake.systems.framework import Context

from mirdrake.assembly.diagram import Assembly, assemble
from mirdrake.core.paths import data_root
from mirdrake.plant.wheels.motion import base_motion, wheel_motion, wheel_places

HANDLING = ("bolt", "mkz", "catvehicle", "unior")
"""Those that have a variant `handling`."""


def free_handling(folder: Path, name: str) -> str:
    """A copy of a vehicle with a variant `free`: as `handling`, without rolling resistance, and nothing turns its
    wheels."""
    model = folder / name
    shutil.copytree(data_root() / "models" / name, model)
    variant = yaml.safe_load((model / "variants" / "handling.yaml").read_text(encoding="utf-8"))
    variant["vehicle"]["tyres"]["rolling_resistance"] = 0.0
    variant["vehicle"].pop("actuators", None)
    variant["vehicle"].pop("brakes", None)
    variant["vehicle"].pop("sources", None)
    variant["control"]["wheel_speed"] = {"kind": "pid", "kp": 0.0, "ki": 0.0, "kd": 0.0}
    (model / "variants" / "free.yaml").write_text(yaml.safe_dump(variant), encoding="utf-8")
    return f"{model}@free"


def rolling_car(model: str, *, speed: float, steering: float, contact: str = "point") -> Assembly:
    """Return a diagram with one car on a plane of dry asphalt, without air."""
    world = Path(model).parent / "asphalt.yaml"
    world.write_text("mirdrake: world/1\nground: {surface: asphalt}\n", encoding="utf-8")
    spec: dict[str, Any] = {
        "world": str(world),
        "vehicles": {"ego": {"model": model, "speed": speed, "start": {"x": 0, "y": 0}}},
        "control": {"ego": {"kind": "constant", "speed": speed, "steering": steering}},
        "plant": {"air_density": 0.0, "contact": contact},
        "record": {"rate": 50.0},
    }
    return assemble(spec)


class EnergyWatch:
    """A monitor that adds up what tyres and dampers take, and what the steering servos give.

    Attributes:
        stored: kinetic energy, potential energy of weight, springs and bars, after each step [J].
        taken: work of the road on the sliding and turning tyres, and of the dampers, until then [J].
        steered: work of the steering servos until then [J].
    """

    def __init__(self, assembly: Assembly) -> None:
        self._step = assembly.spec.plant.time_step
        self._plant, self._part = assembly.parts.plant, assembly.parts.vehicles["ego"]
        self._tyres, self._places = assembly.tyres["ego"], wheel_places(self._part)
        self._before: Any = None
        self.stored: list[float] = []
        self.taken: list[float] = [0.0]
        self.steered: list[float] = [0.0]

    def __call__(self, context: Context) -> None:
        plant, part = self._plant, self._part
        own = plant.GetMyContextFromRoot(context)
        q, v = plant.GetPositions(own), plant.GetVelocities(own)
        energy = plant.CalcKineticEnergy(own) + plant.CalcPotentialEnergy(own)  # Drake counts rotors in
        springs, damped = part.vehicle.spec.suspension, 0.0
        if springs is not None:
            travel = [float(q[joint.position_start()]) for joint in part.suspension]
            for left, bar in ((0, springs.front), (2, springs.rear)):
                energy += 0.5 * bar.anti_roll * (travel[left] - travel[left + 1]) ** 2
            for joint, corner in zip(part.suspension, springs.corners(), strict=True):
                damped += corner.damping * float(v[joint.velocity_start()]) ** 2
        self.stored.append(float(energy))

        state = plant.GetPositionsAndVelocities(own).tolist()
        base = base_motion(state, self._places[0].base, plant.num_positions(), part.period)
        motions = [wheel_motion(state, wheel_place, base, plant.num_positions()) for wheel_place in self._places]
        turning = [base.turning[2]] * 4
        for wheel, joint in enumerate(part.steering):
            turning[wheel] += float(v[joint.velocity_start()])
        if self._before is not None:
            tyre_forces = np.array(self._tyres.tyre_forces.Eval(self._tyres.GetMyContextFromRoot(context))).reshape(
                4, 5
            )
            step, work = self._step, 0.0
            early_motions, early_turning, early_damped = self._before
            for early, late, (fx, fy, mz, _, _), early_turn, late_turn in zip(
                early_motions, motions, tyre_forces, early_turning, turning, strict=True
            ):
                slide = 0.5 * (early.slip_x + late.slip_x) * fx + 0.5 * (early.vy + late.vy) * fy
                spin = 0.5 * (early.spin * early.axle[2] + late.spin * late.axle[2])
                work += slide + mz * (0.5 * (early_turn + late_turn) + spin)
            self.taken.append(self.taken[-1] + step * (work - 0.5 * (damped + early_damped)))
            power = 0.0
            for joint, actuator in zip(part.steering, part.steering_actuators, strict=True):
                torque = plant.get_net_actuation_output_port().Eval(own)[int(actuator.index())]
                power += float(torque) * float(v[joint.velocity_start()])
            self.steered.append(self.steered[-1] + step * power)
        self._before = (motions, turning, damped)
