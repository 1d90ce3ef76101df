"""Look at a vehicle or a world in Meshcat."""

from pathlib import Path

from pydrake.geometry import Meshcat, MeshcatVisualizer
from pydrake.systems.framework import Diagram, DiagramBuilder

from mirdrake.diagram import DiagramSpec, assemble
from mirdrake.logs import write_file
from mirdrake.plant import make_plant
from mirdrake.viewer.meshcat import overlook, place_camera
from mirdrake.viewer.vehicle_view import show_vehicle
from mirdrake.worlds import World

__all__ = ["show_diagram", "show_vehicle", "show_world", "write_page"]


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
