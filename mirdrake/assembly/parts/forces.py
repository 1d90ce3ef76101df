"""External forces on the plant: tyres, air, suspensions, and their sum."""

from collections.abc import Mapping

from pydrake.systems.framework import OutputPort
from pydrake.systems.primitives import Adder

from mirdrake.assembly.diagram_spec import DiagramSpec
from mirdrake.assembly.wiring import Wiring
from mirdrake.core.signals import signals_of
from mirdrake.plant.aerodynamics import AirForces, Gust, has_air_forces
from mirdrake.plant.plant import PlantParts
from mirdrake.plant.suspension import make_axle_forces, make_bump_stops
from mirdrake.plant.wheels import GroundTyres, TyreSystem, WheelReadings, WheelTyres


def add_tyres(wiring: Wiring, parts: PlantParts) -> tuple[WheelReadings, dict[str, TyreSystem]]:
    """Add the tyres of all vehicles and the counter of their other contacts; the vehicles' systems connect to them."""
    plant, vehicles = parts.plant, list(parts.vehicles.values())
    # Contact results are read once for all vehicles, as often as the fastest control unit runs.
    period = 1.0 / max(part.vehicle.control.rate for part in vehicles)
    readings = WheelReadings(vehicles, ground=parts.ground, scenery=parts.props.owners, period=period)
    wiring.add("wheel_readings", readings)
    wiring.link(plant.get_contact_results_output_port(), readings.contact_results)

    models: dict[str, TyreSystem] = {}
    for part in vehicles:
        friction = parts.world.road_mu
        tyres: TyreSystem
        if parts.wheel_contact == "tyre":
            tyres = GroundTyres(plant, part, parts.terrain, friction=friction)
        else:
            tyres = WheelTyres(plant, part, friction=friction)
        wiring.add(f"{part.name}.tyres", tyres)
        wiring.link(plant.get_state_output_port(), tyres.plant_state)
        wiring.sinks[f"{part.name}.wheel_torque"] = (tyres.wheel_torque, signals_of(tyres.wheel_torque))
        wiring.sources[f"{part.name}.tyre_forces"] = (tyres.tyre_forces, signals_of(tyres.tyre_forces))
        models[part.name] = tyres
    return readings, models


def add_outer_forces(wiring: Wiring, parts: PlantParts, tyres: Mapping[str, TyreSystem], spec: DiagramSpec) -> None:
    """Add aerodynamics and the forces of suspensions, and the sum of all external forces."""
    plant = parts.plant
    forces: list[OutputPort] = []
    for name, part in parts.vehicles.items():
        forces.append(tyres[name].generalized_force)
        # A powertrain, if there is one, drives and brakes the wheels.
        if f"{name}.wheel_torque" in wiring.sources:
            wiring.defaults.append((f"{name}.wheel_torque", f"{name}.wheel_torque"))
        springs = make_axle_forces(plant, part)
        if springs is not None:
            wiring.add(f"{name}.axle_forces", springs)
            wiring.link(plant.get_state_output_port(part.instance), springs.get_input_port())
            forces.append(springs.get_output_port())
        stops = make_bump_stops(plant, part)
        if stops is not None:
            wiring.add(f"{name}.bump_stops", stops)
            wiring.link(plant.get_state_output_port(part.instance), stops.get_input_port())
            forces.append(stops.get_output_port())
        if has_air_forces(part, spec.plant.air_density):
            gusts = [Gust(one.velocity, one.start, one.duration, one.rise) for one in spec.plant.gusts]
            air = AirForces(plant, part, density=spec.plant.air_density, wind=spec.plant.wind, gusts=gusts)
            wiring.add(f"{name}.aerodynamics", air)
            wiring.link(plant.get_state_output_port(), air.plant_state)
            wiring.sources[f"{name}.air_force"] = (air.air_force, signals_of(air.air_force))
            forces.append(air.generalized_force)
    # The plant has one input for external forces, so that their sum is a system of its own.
    total = forces[0]
    if len(forces) > 1:
        adder = Adder(len(forces), plant.num_velocities())
        wiring.add("generalized_forces", adder)
        for index, port in enumerate(forces):
            wiring.link(port, adder.get_input_port(index))
        total = adder.get_output_port()
    wiring.link(total, plant.get_applied_generalized_force_input_port())
