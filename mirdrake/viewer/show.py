"""Look at a vehicle or a world in Meshcat."""

from math import pi
from pathlib import Path

from pydrake.geometry import Meshcat, MeshcatVisualizer
from pydrake.multibody.meshcat import JointSliders
from pydrake.systems.framework import Diagram, DiagramBuilder

from mirdrake.diagram import DiagramSpec, assemble
from mirdrake.logs import write_file
from mirdrake.plant import make_plant
from mirdrake.vehicles import Vehicle
from mirdrake.viewer.meshcat import overlook, place_camera
from mirdrake.worlds import World, load_world


def show_vehicle(vehicle: Vehicle, meshcat: Meshcat) -> tuple[Diagram, JointSliders]:
    """A vehicle on an empty plane with a slider for every joint.

    Returns:
        the diagram and its sliders: call ``sliders.Run(diagram)`` to follow the sliders until its button is pressed.
    """
    builder = DiagramBuilder()
    parts = make_plant(builder, load_world("empty"), {vehicle.name: vehicle})
    MeshcatVisualizer.AddToBuilder(builder, parts.scene_graph, meshcat)
    limits = {"lower_limit": -pi, "upper_limit": pi, "step": 0.01}
    sliders = builder.AddNamedSystem("sliders", JointSliders(meshcat, parts.plant, **limits))
    diagram = builder.Build()
    place_camera(meshcat, x=0.0, y=0.0, yaw=0.0, distance=5.0)
    diagram.ForcedPublish(diagram.CreateDefaultContext())
    return diagram, sliders


def show_world(world: World, meshcat: Meshcat) -> Diagram:
    """A world from above."""
    builder = DiagramBuilder()
    parts = make_plant(builder, world, {})
    MeshcatVisualizer.AddToBuilder(builder, parts.scene_graph, meshcat)
    diagram = builder.Build()
    overlook(meshcat, world)
    diagram.ForcedPublish(diagram.CreateDefaultContext())
    return diagram


def show_diagram(spec: DiagramSpec, meshcat: Meshcat) -> Diagram:
    """A diagram's vehicles in its world, at their starts."""
    assembly = assemble(spec, meshcat=meshcat)
    start = next(iter(assembly.starts.values()))
    place_camera(meshcat, x=start.x, y=start.y, yaw=start.yaw)
    assembly.diagram.ForcedPublish(assembly.make_context())
    return assembly.diagram


def write_page(meshcat: Meshcat, path: Path) -> None:
    """What a Meshcat shows, as one HTML file that opens offline."""
    write_file(path, meshcat.StaticHtml())
