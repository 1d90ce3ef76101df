"""A world in Meshcat with the findings of its check: overlaps in red, starts, goals, paths, names, collision shapes.

In the scene tree, below ``drake``, are ``visualizer`` (visual shapes), ``collision`` (collision shapes), and ``names``,
``actors``, ``faults``, ``starts``, ``goals``, ``paths``; each can be shown and hidden there, also in a saved page.
"""

import contextlib
import math

import numpy as np
import shapely
from pydrake.geometry import (
    Box,
    Cylinder,
    Mesh,
    Meshcat,
    MeshcatCone,
    MeshcatVisualizer,
    MeshcatVisualizerParams,
    Rgba,
    Role,
    Sphere,
)
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.framework import DiagramBuilder
from shapely.geometry.base import BaseGeometry

from mirdrake.plant.actors import add_actors, fix_at_start
from mirdrake.plant.plant import make_plant
from mirdrake.viewer.controls import LayerButtons, follow_controls
from mirdrake.viewer.labels import Label, apart
from mirdrake.viewer.meshcat import (
    WORLD_PATH,
    content_bounds,
    make_meshcat,
    make_offline_meshcat,
    overlook,
    overview,
)
from mirdrake.viewer.vehicle_view import SHAPE_COLOUR
from mirdrake.world_checks import Examination, Fault
from mirdrake.world_checks.paths import goal_area
from mirdrake.worlds.meshes import fill

LAYERS = {"Names": "KeyN", "Collision shapes": "KeyC", "Faults": "KeyF", "Paths": "KeyP"}
"""Buttons in Meshcat's controls, and their keys."""


_RED, _GREEN, _BLUE, _VIOLET, _MAGENTA = (
    Rgba(0.95, 0.05, 0.05, 0.75),
    Rgba(0.05, 0.62, 0.20, 1.0),
    Rgba(0.10, 0.40, 0.95, 0.45),
    Rgba(0.45, 0.15, 0.85, 0.9),
    Rgba(0.93, 0.20, 0.60, 0.9),
)
_MARKED = ("overlap", "actor", "start", "goal", "buried", "floating", "gap")
_PEOPLE, _PERSON = {"pedestrian", "cyclist"}, 0.02  # least height of their symbol over the size of the world
_RIBBON = 0.15  # [m] width of a path


class WorldView:
    """World with the findings of its check in Meshcat.

    Args:
        meshcat: Meshcat that shows the world.
        check: the world with its faults and paths.
        collision: whether collision shapes are visible at first.
        names: whether names are visible at first.
    """

    def __init__(self, meshcat: Meshcat, check: Examination, *, collision: bool = False, names: bool = True) -> None:
        assert check.world is not None
        self._meshcat, self.world, self._faults = meshcat, check.world, check.faults
        low, high = content_bounds(check.world)
        # Small worlds still get labels and arrows of a size that can be read.
        self._size = max(float((high - low).max()), 8.0)
        self._draw_props()
        self._draw_names()
        for number, fault in enumerate(fault for fault in check.faults if fault.kind in _MARKED):
            self._draw_fault(number, fault)
        self._draw_starts()
        self._draw_goals()
        for number, path in enumerate(check.paths):
            ribbon = shapely.LineString(path.poses[:, :2]).buffer(0.5 * _RIBBON)
            self._fill(f"paths/{number} {path.vehicle} {path.start} {path.goal}", ribbon, 0.06, _VIOLET)
        shown = {"Names": names, "Collision shapes": collision, "Faults": True, "Paths": True}
        paths = {"Names": "names", "Collision shapes": "collision", "Faults": "faults", "Paths": "paths"}
        self._layers = LayerButtons(meshcat, LAYERS, shown, {name: _path(path) for name, path in paths.items()})
        self._layers.apply()
        overlook(meshcat, check.world)

    @property
    def shown(self) -> dict[str, bool]:
        """Whether each layer is visible."""
        return self._layers.shown

    def follow(self) -> bool:
        """Apply the clicks on the buttons; return whether a layer has changed."""
        return self._layers.follow()

    def run(self, *, timeout: float | None = None) -> None:
        """Follow the buttons until "Stop" is pressed, or for a time [s]."""
        with contextlib.suppress(KeyboardInterrupt):
            follow_controls(self._meshcat, self.follow, timeout=timeout)

    def _draw_props(self) -> None:
        """Draw scenery, props, actors at their starts, and collision shapes."""
        builder = DiagramBuilder()
        parts = make_plant(builder, self.world, {})
        actors = add_actors(parts.scene_graph, self.world)
        MeshcatVisualizer.AddToBuilder(builder, parts.scene_graph, self._meshcat)
        shapes = MeshcatVisualizerParams(role=Role.kProximity, prefix="collision", default_color=SHAPE_COLOUR)
        MeshcatVisualizer.AddToBuilder(builder, parts.scene_graph, self._meshcat, shapes).set_name("collision shapes")
        diagram = builder.Build()
        context = diagram.CreateDefaultContext()
        parts.props.reset(parts.plant, parts.plant.GetMyMutableContextFromRoot(context))
        fix_at_start(parts.scene_graph, actors, self.world, context)
        diagram.ForcedPublish(context)
        # The vehicle of a full actor is loaded only by a simulation; here it is a box of the size of a car.
        for full in self.world.full_actors:
            x, y, yaw = self.world.actor_start(full)
            path, height = _path("actors", full.name), 1.5
            self._meshcat.SetObject(path, Box(full.length, 2.0 * full.half_width, height), _BLUE)
            middle = full.area(x, y, yaw).centroid
            X_WB = RigidTransform(RollPitchYaw(0.0, 0.0, yaw), [middle.x, middle.y, 0.5 * height])
            self._meshcat.SetTransform(path, X_WB)

    def _draw_names(self) -> None:
        """Draw labels above props and actors, and symbols of people."""
        world = self.world
        actors = [actor.placed(*world.actor_start(actor)) for actor in world.actors]
        faulty = {name for fault in self._faults for name in fault.names}
        eye, target = overview(world)
        labels: list[tuple[tuple[bool, bool, float], Label]] = []
        for index, placed in enumerate([*actors, *world.props]):
            xmin, ymin, xmax, ymax = placed.footprint.bounds
            x, y, top = 0.5 * (xmin + xmax), 0.5 * (ymin + ymax), max(placed.top, 0.0)
            if placed.prop.name in _PEOPLE and top < _PERSON * self._size:
                top = _PERSON * self._size
                self._draw_person(placed.name, x, y, top)
            # Readable in large worlds, but not larger than the prop is wide.
            height = min(max(0.15 * max(xmax - xmin, ymax - ymin), 0.014 * self._size), 0.026 * self._size)
            label = Label(placed.name, (x, y, top + 0.7 * height), height)
            distance = float(np.linalg.norm(eye - label.position))
            labels.append(((placed.name not in faulty, index >= len(actors), distance), label))
        # Names of faults first, then actors, then what is nearest to the camera.
        labels.sort(key=lambda item: item[0])
        for label in apart((label for _, label in labels), eye, target):
            path = _path("names", label.text)
            self._meshcat.SetObject(path, Mesh(label.mesh(), label.height))
            self._meshcat.SetTransform(path, label.X_WL)

    def _draw_person(self, name: str, x: float, y: float, height: float) -> None:
        """Draw the symbol of a person, which is visible from far away: a cone and a head."""
        # Beside the label: a path below it would be moved with it.
        base, head = _path("names", f"{name} (symbol)"), 0.2 * height
        self._meshcat.SetObject(f"{base}/body", MeshcatCone(0.75 * height, 0.22 * height, 0.22 * height), _MAGENTA)
        # The tip of Meshcat's cone is its origin, and its axis is z.
        tip = RigidTransform(RollPitchYaw(math.pi, 0.0, 0.0), [x, y, 0.75 * height])
        self._meshcat.SetTransform(f"{base}/body", tip)
        self._meshcat.SetObject(f"{base}/head", Sphere(head), _MAGENTA)
        self._meshcat.SetTransform(f"{base}/head", RigidTransform([x, y, height - head]))

    def _draw_fault(self, number: int, fault: Fault) -> None:
        """Draw a fault in red: the overlapping area at its height, and a needle that is visible from far away."""
        if fault.position is None:
            return
        x, y, z = fault.position
        base = f"faults/{number} {' '.join(fault.names) or fault.kind}"
        if len(fault.polygon) >= 3:
            area = shapely.Polygon(fault.polygon).buffer(0.02)
            for part, height in (("top", max(z, 0.0) + 0.02), ("ground", 0.05)):
                self._fill(f"{base}/{part}", area, height, _RED)
            # Visible through the props: overlaps are inside of them.
            seen_through = _path(f"{base}/top", "<object>")
            self._meshcat.SetProperty(seen_through, "material.depthTest", False)
            self._meshcat.SetProperty(seen_through, "renderOrder", 1.0)
        # Above the highest of its props, so that the needle is visible from afar.
        top = max((prop.top for prop in self.world.props if prop.name in fault.names), default=0.0)
        top, bottom = top + max(0.06 * self._size, 0.5), min(z, 0.0)
        thick = 0.001 * self._size
        needle = Cylinder(thick, top - bottom)
        self._meshcat.SetObject(_path(f"{base}/needle"), needle, _RED)
        self._meshcat.SetTransform(_path(f"{base}/needle"), RigidTransform([x, y, 0.5 * (top + bottom)]))
        for part, height, radius in (("place", z, 2.0 * thick), ("head", top, 6.0 * thick)):
            self._meshcat.SetObject(_path(f"{base}/{part}"), Sphere(radius), _RED)
            self._meshcat.SetTransform(_path(f"{base}/{part}"), RigidTransform([x, y, height]))

    def _draw_starts(self) -> None:
        """Draw starts as green arrows along the heading."""
        for name, start in self.world.starts.items():
            X_WB = RigidTransform(RollPitchYaw(0.0, 0.0, start.yaw), [start.x, start.y, 0.12])
            along = RollPitchYaw(0.0, 0.5 * math.pi, 0.0)
            shaft, head = _path("starts", name, "shaft"), _path("starts", name, "head")
            # Meshcat's cylinder is along z; turned to the heading.
            self._meshcat.SetObject(shaft, Cylinder(0.07, 1.6), _GREEN)
            self._meshcat.SetTransform(shaft, X_WB @ RigidTransform(along, [0.8, 0.0, 0.0]))
            self._meshcat.SetObject(head, MeshcatCone(0.8, 0.3, 0.3), _GREEN)
            tip = RollPitchYaw(0.0, -0.5 * math.pi, 0.0)  # the origin of Meshcat's cone is its tip
            self._meshcat.SetTransform(head, X_WB @ RigidTransform(tip, [2.4, 0.0, 0.0]))

    def _draw_goals(self) -> None:
        """Draw goals as blue areas."""
        for name in self.world.goals:
            area = goal_area(self.world, name)
            if area is not None:
                self._fill(f"goals/{name}", area, 0.04, _BLUE)

    def _fill(self, path: str, area: BaseGeometry, height: float, colour: Rgba) -> None:
        """Draw a flat area, visible from above and below."""
        surface = fill(area, z=height, tile=1.0, color=(0.0, 0.0, 0.0), texture=None)
        vertices = np.asfortranarray(surface.vertices.T)
        faces = np.asfortranarray(surface.triangles.T.astype(np.int32))
        self._meshcat.SetTriangleMesh(_path(path), vertices, faces, colour, side=Meshcat.SideOfFaceToRender.kDoubleSide)


def show_examination(
    check: Examination,
    *,
    offline: bool = False,
    port: int | None = None,
    collision: bool = False,
    names: bool = True,
) -> tuple[Meshcat, WorldView]:
    """Return a Meshcat on localhost with a world and the findings of its check.

    Args:
        check: see :func:`mirdrake.world_checks.examine`; its world must be laid out.
        offline: without a page, for a file.
        port: see :func:`mirdrake.viewer.make_meshcat`.
        collision: show the collision shapes at first.
        names: show the names at first.
    """
    title = check.world.name if check.world is not None else "mirdrake"
    meshcat = (
        make_offline_meshcat(world=check.world) if offline else make_meshcat(port=port, world=check.world, title=title)
    )
    return meshcat, WorldView(meshcat, check, collision=collision, names=names)


# --- the inner parts ----------------------------------------------------------------------------------------------


def _path(*names: str) -> str:
    return "/".join((WORLD_PATH, *names))
