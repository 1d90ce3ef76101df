"""External forces on the plant: rolling resistance, tyres, air, suspensions, and their sum."""

from pydrake.systems.framework import OutputPort
from pydrake.systems.primitives import Adder

from mirdrake.assembly.diagram_spec import DiagramSpec
from mirdrake.assembly.wiring import Wiring
from mirdrake.core.errors import ConfigError
from mirdrake.core.signals import signals_of
from mirdrake.core.yaml_io import where
from mirdrake.plant.aerodynamics import AirForces, Gust, has_air_forces
from mirdrake.plant.plant import PlantParts
from mirdrake.plant.suspension import arms_transmit, make_anti_roll, make_arms, make_bump_stops
from mirdrake.plant.wheels import (
    LOAD_PERIOD,
    GroundReadings,
    GroundTyres,
    RollingResistance,
    WheelTyres,
    make_rolling_wheels,
    make_wheel_tyres,
)


def add_ground_tyres(wiring: Wiring, parts: PlantParts, spec: DiagramSpec) -> GroundReadings:
    """Add the tyres that touch the ground themselves, and the system that collects their loads."""
    plant, names = parts.plant, list(parts.vehicles)
    # Contacts are counted as often as the fastest control unit runs.
    rate = max(part.vehicle.control.rate for part in parts.vehicles.values())
    scenery = {*parts.ground, *parts.props.owners}
    readings = GroundReadings(names, scenery=scenery, period=1.0 / rate)
    wiring.add("rolling_resistance", readings)
    wiring.link(plant.get_contact_results_output_port(), readings.contact_results)
    for index, (name, part) in enumerate(parts.vehicles.items()):
        tyres = GroundTyres(
            plant,
            part,
            parts.terrain,
            friction=parts.world.road_mu,
            rolling_resistance=spec.plant.rolling_resistance == "tyre",
        )
        wiring.add(f"{name}.tyres", tyres)
        wiring.link(plant.get_state_output_port(), tyres.plant_state)
        wiring.link(tyres.wheel_load, readings.load_inputs[index])
        wiring.link(tyres.resistance, readings.resistance_inputs[index])
    return readings


def add_rolling_resistance(wiring: Wiring, parts: PlantParts, spec: DiagramSpec) -> RollingResistance | GroundReadings:
    """Add one system for all wheels, so that contact results are read once."""
    if parts.wheel_contact == "tyre":
        return add_ground_tyres(wiring, parts, spec)
    plant = parts.plant
    rate = max(part.vehicle.control.rate for part in parts.vehicles.values())
    wheels = [wheel for part in parts.vehicles.values() for wheel in make_rolling_wheels(part)]
    # `raw` keeps the numerical resistance of Drake and adds none; point contact has none to cancel.
    raw = spec.plant.rolling_resistance == "raw"
    cancel = not raw and parts.wheel_contact == "hydroelastic"
    tyre_models = any(part.tyre_model for part in parts.vehicles.values())
    system = RollingResistance(
        plant,
        [wheel._replace(coefficient=0.0) for wheel in wheels] if raw else wheels,
        ground=parts.ground,
        scenery=parts.props.owners,
        # Cancellation and tyre laws need loads at the rate of the control; otherwise a slow update is sufficient.
        period=1.0 / rate if cancel or tyre_models else LOAD_PERIOD,
        cancel_numerical=cancel,
        machine_code=tyre_models or spec.plant.machine_code,
    )
    wiring.add("rolling_resistance", system)
    wiring.link(plant.get_contact_results_output_port(), system.contact_results)
    wiring.link(plant.get_state_output_port(), system.plant_state)
    return system


def add_tyres(
    wiring: Wiring, parts: PlantParts, rolling: RollingResistance | GroundReadings
) -> dict[str, WheelTyres | GroundTyres]:
    """Add the tyre models of the vehicles that have one; a powertrain drives and brakes their wheels."""
    plant = parts.plant
    models: dict[str, WheelTyres | GroundTyres] = {}
    for index, (name, part) in enumerate(parts.vehicles.items()):
        tyres: WheelTyres | GroundTyres | None = None
        # With contact geometry the loads are those of the contact solver; ground tyres know their own.
        if isinstance(rolling, RollingResistance):
            # One system has the loads of all vehicles; each tyre system reads its part of them.
            first, loads = index * len(part.wheels), len(parts.vehicles) * len(part.wheels)
            wheel_tyres = make_wheel_tyres(plant, part, loads=loads, first=first, friction=parts.world.road_mu)
            if wheel_tyres is None:
                continue
            wiring.add(f"{name}.tyres", wheel_tyres)
            wiring.link(plant.get_state_output_port(), wheel_tyres.plant_state)
            wiring.link(rolling.wheel_load, wheel_tyres.wheel_load)
            tyres = wheel_tyres
        else:
            tyres = wiring.systems[f"{name}.tyres"]
        # Wheel torques of a powertrain go into the tyre system, which advances the spin of the wheels with them.
        wiring.sinks[f"{name}.wheel_torque"] = (tyres.wheel_torque, signals_of(tyres.wheel_torque))
        wiring.sources[f"{name}.tyre_forces"] = (tyres.tyre_forces, signals_of(tyres.tyre_forces))
        if f"{name}.wheel_torque" in wiring.sources:
            wiring.defaults.append((f"{name}.wheel_torque", f"{name}.wheel_torque"))
        models[name] = tyres
    return models


def add_outer_forces(
    wiring: Wiring, parts: PlantParts, rolling: RollingResistance | GroundReadings, spec: DiagramSpec
) -> None:
    """Add aerodynamics and the forces of suspensions, and the sum of all external forces."""
    plant = parts.plant
    # Ground tyres contain the rolling resistance, so their readings have no force.
    forces: list[OutputPort] = [rolling.generalized_force] if isinstance(rolling, RollingResistance) else []
    for name, part in parts.vehicles.items():
        tyres = wiring.systems.get(f"{name}.tyres")
        if isinstance(tyres, WheelTyres | GroundTyres):
            forces.append(tyres.generalized_force)
        anti_roll = make_anti_roll(plant, part)
        if anti_roll is not None:
            wiring.add(f"{name}.anti_roll", anti_roll)
            wiring.link(plant.get_state_output_port(part.instance), anti_roll.get_input_port())
            forces.append(anti_roll.get_output_port())
        stops = make_bump_stops(plant, part)
        if stops is not None:
            wiring.add(f"{name}.bump_stops", stops)
            wiring.link(plant.get_state_output_port(part.instance), stops.get_input_port())
            forces.append(stops.get_output_port())
        if arms_transmit(part.vehicle):
            if not isinstance(tyres, WheelTyres | GroundTyres):
                raise ConfigError(
                    f"{where(part.vehicle.spec, 'suspension')}: roll centres, anti_brake and anti_drive need "
                    "the forces of a tyre law; choose a kind of tyres other than coulomb"
                )
            arms = make_arms(plant, part, forces=tyres.tyre_forces.size())
            wiring.add(f"{name}.suspension_arms", arms)
            wiring.link(tyres.tyre_forces, arms.get_input_port())
            forces.append(arms.get_output_port())
        if has_air_forces(part, spec.plant.air_density):
            gusts = [Gust(one.velocity, one.start, one.duration, one.rise) for one in spec.plant.gusts]
            air = AirForces(plant, part, density=spec.plant.air_density, wind=spec.plant.wind, gusts=gusts)
            wiring.add(f"{name}.aerodynamics", air)
            wiring.link(plant.get_state_output_port(), air.plant_state)
            wiring.sources[f"{name}.air_force"] = (air.air_force, signals_of(air.air_force))
            forces.append(air.generalized_force)
    total = Adder(len(forces), plant.num_velocities())
    # The plant has one input for external forces, so that their sum is a system of its own.
    wiring.add("generalized_forces", total)
    for index, port in enumerate(forces):
        wiring.link(port, total.get_input_port(index))
    wiring.link(total.get_output_port(), plant.get_applied_generalized_force_input_port())
