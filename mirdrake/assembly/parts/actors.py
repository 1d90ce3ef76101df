"""The actors of a world in a diagram."""

import math

from mirdrake.actors.crew import FullVehicle
from mirdrake.actors.road_ahead import RoadAhead
from mirdrake.actors.traffic import Traffic
from mirdrake.assembly.diagram_spec import DiagramSpec
from mirdrake.assembly.parts.sensors import cameras_of
from mirdrake.assembly.wiring import Wiring
from mirdrake.controllers.behaviours.outline import volume_of
from mirdrake.core.errors import ConfigError
from mirdrake.core.signals import signals_of
from mirdrake.core.yaml_io import where
from mirdrake.plant.plant import PlantParts

TRAFFIC = "traffic"
"""Name of the system of all actors in a diagram."""


def add_traffic(wiring: Wiring, parts: PlantParts, spec: DiagramSpec) -> Traffic | None:
    """Add the system of the actors, with the motions that full vehicles follow; None in a world without actors.

    Raises:
        ConfigError: an actor has the name of a vehicle, or a trigger refers to a vehicle that does not exist.
    """
    world, plant = parts.world, parts.plant
    if not (world.actors or world.full_actors):
        return None
    for actor in world.actors:
        if actor.name in parts.vehicles:
            raise ConfigError(
                f"{where(actor.spec, 'name')}: '{actor.name}' is the name of a vehicle of the diagram; rename the actor"
            )
    vehicles = _full_vehicles(parts)
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


def add_road_ahead(wiring: Wiring, parts: PlantParts, name: str, track: str) -> None:
    """Add what the driver of a vehicle knows about the road ahead."""
    plant = parts.plant
    size = plant.get_state_output_port().size()
    system = RoadAhead(parts.world, track, name, _full_vehicles(parts), state_size=size)
    wiring.add(f"{name}.road", system)
    wiring.link(plant.get_state_output_port(), system.plant_state)
    if system.actor_states is not None:
        wiring.link(wiring.systems[TRAFFIC].GetOutputPort("states"), system.actor_states)
    wiring.sources[f"{name}.road_ahead"] = (system.road_ahead, signals_of(system.road_ahead))


def _full_vehicles(parts: PlantParts) -> dict[str, FullVehicle]:
    """Return the full vehicles by name."""
    return {
        name: FullVehicle(
            volume_of(part.vehicle),
            part.base.floating_positions_start(),
            parts.plant.num_positions() + part.base.floating_velocities_start_in_v(),
            part.vehicle.geometry.wheelbase / math.tan(part.vehicle.geometry.steering_limit),
        )
        for name, part in parts.vehicles.items()
    }
