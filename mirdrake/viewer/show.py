"""Look at a vehicle or a world in Meshcat."""

from collections.abc import Iterable
from pathlib import Path

from pydrake.geometry import Meshcat, MeshcatVisualizer
from pydrake.systems.framework import Diagram, DiagramBuilder

from mirdrake.assembly.diagram import DRAWING_PERIOD, DiagramSpec, assemble
from mirdrake.assembly.scene import Scene
from mirdrake.core.files import write_file
from mirdrake.plant.actors import add_actors, fix_at_start
from mirdrake.plant.plant import make_plant
from mirdrake.viewer.meshcat import LIGHTS_PATH, WORLD_PATH, chase, overlook, place_camera
from mirdrake.viewer.pages import with_title
from mirdrake.viewer.vehicle_view import show_vehicle
from mirdrake.viewer.views import View, with_views
from mirdrake.worlds import World

__all__ = ["show_diagram", "show_vehicle", "show_world", "write_page"]


def show_world(world: World, meshcat: Meshcat, *, camera: bool = True) -> Diagram:
    """Show a world, from above unless the camera is to stay where it is."""
    builder = DiagramBuilder()
    parts = make_plant(builder, world, {})
    actors = add_actors(parts.scene_graph, world)
    MeshcatVisualizer.AddToBuilder(builder, parts.scene_graph, meshcat)
    diagram = builder.Build()
    if camera:
        overlook(meshcat, world)
    context = diagram.CreateDefaultContext()
    fix_at_start(parts.scene_graph, actors, world, context)
    diagram.ForcedPublish(context)
    return diagram


def show_diagram(spec: DiagramSpec, meshcat: Meshcat, *, scene: Scene | None = None) -> Diagram:
    """Show a diagram's vehicles in its world, at their starts; the world is moved until the first heads along x.

    Args:
        spec: spec of the diagram.
        meshcat: Meshcat instance in which to draw.
        scene: scene of the diagram, if it is made already.
    """
    assembly = assemble(spec, meshcat=meshcat, scene=scene, drawing_period=DRAWING_PERIOD, continuous=False)
    start = next(iter(assembly.starts.values()))
    place_camera(meshcat, x=0.0, y=0.0, yaw=0.0)
    assembly.diagram.ForcedPublish(assembly.make_context())
    X_CW, X_CL = chase(x=start.x, y=start.y, yaw=start.yaw)
    meshcat.SetTransform(WORLD_PATH, X_CW)
    meshcat.SetTransform(LIGHTS_PATH, X_CL)
    return assembly.diagram


def write_page(meshcat: Meshcat, path: Path, *, views: Iterable[View] = ()) -> None:
    """Write the content of a Meshcat as one HTML file that opens offline.

    Args:
        meshcat: its content.
        path: path of the file.
        views: views with buttons in the page.
    """
    chosen, page = tuple(views), with_title(meshcat.StaticHtml(), path.stem)
    write_file(path, with_views(page, chosen) if chosen else page)
