"""Small set-ups that several physics tests share."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource

from mirdrake.assembly.diagram import assemble
from mirdrake.plant.plant import PlantParts, PlantSpec, VehicleInPlant, make_plant, set_start
from mirdrake.plant.wheels import WheelTyres
from mirdrake.runs.logs import Run
from mirdrake.runs.simulation import Simulation
from mirdrake.vehicles import Vehicle, load_vehicle
from mirdrake.vehicles.joint_control import WheelPid
from mirdrake.worlds import load_world

GRAVITY = 9.80665


def free_rolling(vehicle: Vehicle) -> Vehicle:
    """Return a vehicle without wheel servos, which nothing drives or brakes."""
    control = vehicle.control.model_copy(update={"wheel_speed": WheelPid(kind="pid", kp=0.0)})
    return replace(vehicle, control=control)


def with_rolling_resistance(vehicle: Vehicle, coefficient: float) -> Vehicle:
    """Return a vehicle with another coefficient of rolling resistance [1]."""
    tyres = vehicle.spec.tyres.model_copy(update={"rolling_resistance": coefficient})
    return replace(vehicle, spec=vehicle.spec.model_copy(update={"tyres": tyres}))


@dataclass
class CoastingCar:
    """A Bolt that rolls straight ahead on the flat; steering held at zero, nothing else acts."""

    parts: PlantParts
    part: VehicleInPlant
    tyres: WheelTyres
    simulator: Simulator

    @property
    def speed(self) -> float:
        """Forward speed [m/s]."""
        plant = self.parts.plant
        velocities = plant.GetVelocities(plant.GetMyContextFromRoot(self.simulator.get_context()))
        return float(velocities[self.part.base.floating_velocities_start_in_v() + 3])

    @property
    def loads(self) -> np.ndarray:
        """Normal load of each wheel [N]."""
        return np.array(self.tyres.wheel_load.Eval(self.tyres.GetMyContextFromRoot(self.simulator.get_context())))

    def advance(self, duration: float) -> None:
        """Simulate on for a time [s]."""
        self.simulator.AdvanceTo(self.simulator.get_context().get_time() + duration)


def add_tyres(builder: DiagramBuilder, parts: PlantParts, *, friction: float = 0.85) -> WheelTyres:
    """Add the tyres of the only vehicle of a plant, whose wheels Drake's contact bears.

    The generalised force of the tyres is left to be connected.
    """
    plant, (part,) = parts.plant, parts.vehicles.values()
    tyres = WheelTyres(plant, part, friction=friction)
    builder.AddSystem(tyres)
    builder.Connect(plant.get_state_output_port(), tyres.plant_state)
    return tyres


def coasting_car(speed: float, spec: PlantSpec, *, coefficient: float | None = None) -> CoastingCar:
    """Return a car that coasts from a speed [m/s], with the tyre's own rolling resistance or another coefficient."""
    builder = DiagramBuilder()
    vehicle = free_rolling(load_vehicle("bolt"))
    if coefficient is not None:
        vehicle = with_rolling_resistance(vehicle, coefficient)
    parts = make_plant(builder, load_world("empty"), {"ego": vehicle}, spec=spec)
    plant, part = parts.plant, parts.vehicles["ego"]
    tyres = add_tyres(builder, parts)
    builder.Connect(tyres.generalized_force, plant.get_applied_generalized_force_input_port())
    straight = builder.AddSystem(ConstantVectorSource(np.zeros(2 * plant.num_actuators(part.instance))))
    builder.Connect(straight.get_output_port(), plant.get_desired_state_input_port(part.instance))
    simulator = Simulator(builder.Build())
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    set_start(plant, context, part, x=0.0, y=0.0, yaw=0.0, speed=speed)
    simulator.Initialize()
    return CoastingCar(parts, part, tyres, simulator)


def drive(duration: float, *, speed: float = 0.0, world: str = "empty", control: Any = None, **plant: Any) -> Run:
    """Return a Bolt on a world under a driver from data; in memory."""
    spec = {
        "world": world,
        "vehicles": {"ego": {"model": "bolt", "speed": speed}},
        "control": {"ego": control or {"kind": "constant", "speed": speed}},
        "plant": plant,
    }
    return Simulation(assemble(spec)).run(duration=duration)
