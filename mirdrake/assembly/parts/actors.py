"""The actors of a world in a diagram."""

import math

from mirdrake.actors.crew import FullVehicle, track_lanes
from mirdrake.actors.road_ahead import RoadAhead
from mirdrake.actors.traffic import Traffic
from mirdrake.assembly.diagram_spec import DiagramSpec
from mirdrake.assembly.parts.sensors import cameras_of
from mirdrake.assembly.wiring import Wiring
from mirdrake.controllers.behaviours.outline import volume_of
from mirdrake.controllers.traffic_driver import TrafficDriverSpec
from mirdrake.core.signals import signals_of
from mirdrake.plant.plant import PlantParts

TRAFFIC = "traffic"
"""Name of the system of all actors in a diagram."""


def add_traffic(wiring: Wiring, parts: PlantParts, spec: DiagramSpec) -> Traffic | None:
    """Add the system of the actors and of the right of way in junctions; None in a world without both.

    It has the motions that full vehicles follow, and the lines of junctions that vehicles must not pass.

    Raises:
        ConfigError: an actor has the name of a vehicle, or a trigger refers to a vehicle that does not exist.
    """
    world, plant = parts.world, parts.plant
    vehicles = _full_vehicles(parts, spec)
    on_ways = {lane for vehicle in vehicles.values() for lane in track_lanes(world, vehicle.track)}
    if not (world.actors or world.full_actors or (on_ways and on_ways & {way.lane for way in world.ways})):
        return None
    size = plant.get_state_output_port().size()
    # Cameras see actors at any time; otherwise poses are only drawn, and are not computed in every step of the plant.
    drawn = bool(cameras_of(spec, {name: part.vehicle for name, part in parts.vehicles.items()}))
    traffic = Traffic(world, vehicles, parts.actors, state_size=size, always=drawn, plant_step=plant.time_step())
    wiring.add(TRAFFIC, traffic)
    wiring.link(plant.get_state_output_port(), traffic.plant_state)
    for name, port in traffic.motions.items():
        wiring.sources[f"{name}.motion"] = (port, signals_of(port))
    if parts.actors.source is not None:
        wiring.link(traffic.poses, parts.scene_graph.get_source_pose_port(parts.actors.source))
    if parts.actors.instance is not None:
        wiring.link(traffic.desired, plant.get_desired_state_input_port(parts.actors.instance))
    return traffic


def add_road_ahead(wiring: Wiring, parts: PlantParts, spec: DiagramSpec, name: str, track: str) -> None:
    """Add what the driver of a vehicle knows about the road ahead."""
    plant = parts.plant
    size = plant.get_state_output_port().size()
    vehicles, traffic = _full_vehicles(parts, spec), wiring.systems.get(TRAFFIC)
    obeys = [] if traffic is None else [traffic.obeys[one] for one in (*vehicles, *traffic.names)]
    system = RoadAhead(parts.world, track, name, vehicles, obeys=obeys, state_size=size)
    wiring.add(f"{name}.road", system)
    wiring.link(plant.get_state_output_port(), system.plant_state)
    if system.actor_states is not None:
        wiring.link(wiring.systems[TRAFFIC].GetOutputPort("states"), system.actor_states)
    if system.junction_line is not None:
        wiring.link(wiring.systems[TRAFFIC].lines[name], system.junction_line)
    wiring.sources[f"{name}.road_ahead"] = (system.road_ahead, signals_of(system.road_ahead))


def _full_vehicles(parts: PlantParts, spec: DiagramSpec) -> dict[str, FullVehicle]:
    """Return the full vehicles by name."""
    drivers = {name: driver for name, driver in spec.control.items() if isinstance(driver, TrafficDriverSpec)}
    vehicles = {}
    for name, part in parts.vehicles.items():
        # A driver that ignores lights ignores the right of way as well.
        driver = drivers[name] if name in drivers and drivers[name].obeys_lights else None
        vehicles[name] = FullVehicle(
            volume_of(part.vehicle),
            part.base.floating_positions_start(),
            parts.plant.num_positions() + part.base.floating_velocities_start_in_v(),
            part.vehicle.geometry.wheelbase / math.tan(part.vehicle.geometry.steering_limit),
            None if driver is None else driver.track,
            None if driver is None else driver.idm(),
        )
    return vehicles
