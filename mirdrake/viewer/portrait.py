"""A still picture of a vehicle on asphalt, from its front left, rendered offscreen by Drake.

``python -m mirdrake.viewer.portrait FOLDER`` adds it to the README.md of a vehicle folder.
"""

import sys
from math import cos, pi, sin, tan
from pathlib import Path

import numpy as np
import shapely
from numpy.typing import NDArray
from PIL import Image
from pydrake.common import MemoryFile
from pydrake.geometry import (
    ClippingRange,
    ColorRenderCamera,
    GeometryInstance,
    InMemoryMesh,
    LightParameter,
    Mesh,
    PerceptionProperties,
    RenderCameraCore,
    RenderEngineVtkParams,
    RenderLabel,
    Rgba,
    SceneGraph,
)
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.systems.framework import Context, DiagramBuilder
from pydrake.systems.sensors import CameraInfo

from mirdrake.core.errors import MirdrakeError, MissingDependencyError, first_line
from mirdrake.core.hulls import bounding_points
from mirdrake.plant.plant import PlantParts, PlantSpec, VehicleInPlant, make_plant, set_start
from mirdrake.sensors.cameras.rendering import add_renderer, use_plain_textures
from mirdrake.vehicles import Vehicle, load_vehicle
from mirdrake.worlds import World, load_world
from mirdrake.worlds.scenery import lights, sky_colors

Array = NDArray[np.float64]

FIELD_OF_VIEW = 28.0 * pi / 180.0
"""Horizontal field of view [rad], of a 72 mm lens on 36 mm film; longer lenses distort the proportions less."""

PORTRAIT = "portrait.png"
"""Picture in a vehicle folder."""

_AZIMUTH, _ELEVATION = 0.62, 0.115  # [rad] of the camera, seen from the vehicle: to the left, above
_MARGIN = 1.22  # room around the vehicle
_FINER = 2  # pixels drawn for one that is kept, each way
_SUN = (1.25, 0.95)  # [rad] azimuth and elevation of the sun, on the camera's side of the vehicle
_SHADE = 0.13  # darkness of one layer of the shadow, of which there are several for a soft edge
_LAYERS = 9
_STEER = 0.35  # part of the steering limit that the wheels are turned by


def draw_portrait(vehicle: Vehicle, *, width: int = 960, height: int = 540) -> Image.Image:
    """Return a picture of a vehicle.

    Args:
        vehicle: vehicle to draw.
        width: width of the picture [pixel].
        height: height of the picture [pixel].

    Raises:
        MissingDependencyError: no renderer is available.
    """
    builder = DiagramBuilder()
    world = load_world("empty")
    parts = make_plant(builder, world, {vehicle.name: vehicle}, spec=PlantSpec(contact="point"))
    part = parts.vehicles[vehicle.name]
    # Points of the posed vehicle decide about shadow and camera, before the diagram is built.
    points = _seen_points(parts, part, _pose(parts, part, parts.plant.CreateDefaultContext()))
    _add_shadow(parts, points)
    # Perception properties must be final before the renderer is added.
    use_plain_textures(parts.plant, parts.scene_graph)
    _add_renderer(parts.scene_graph, world)
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    _pose(parts, part, parts.plant.GetMyMutableContextFromRoot(context))
    X_WC, distance = _place(np.vstack(points), width / height)
    # Drawn at a multiple of the size and reduced, for smoother edges.
    focal = 0.5 * _FINER * width / tan(0.5 * FIELD_OF_VIEW)
    size = (_FINER * width, _FINER * height)
    info = CameraInfo(*size, focal, focal, 0.5 * size[0], 0.5 * size[1])
    core = RenderCameraCore("portrait", info, ClippingRange(0.2 * distance, 500.0 * distance), RigidTransform())
    query = parts.scene_graph.get_query_output_port().Eval(parts.scene_graph.GetMyContextFromRoot(context))
    camera = ColorRenderCamera(core, False)
    picture = query.RenderColorImage(camera, parts.scene_graph.world_frame_id(), X_WC)
    # Pixels without a label are sky; the renderer draws a uniform background only.
    labels = query.RenderLabelImage(camera, parts.scene_graph.world_frame_id(), X_WC)
    sky = labels.data[:, :, 0] == int(RenderLabel.kEmpty)
    small = Image.fromarray(_with_sky(picture.data[:, :, :3].astype(float), sky, world).astype(np.uint8))
    return small.resize((width, height), Image.Resampling.LANCZOS)


def try_portrait(vehicle: Vehicle, *, width: int = 960, height: int = 540) -> Image.Image | None:
    """Return a picture of a vehicle, or None without a renderer."""
    try:
        return draw_portrait(vehicle, width=width, height=height)
    except MissingDependencyError:
        return None


def add_portrait(folder: Path) -> None:
    """Draw a vehicle folder into ``portrait.png`` beside its README.md, and show it there below the title.

    Raises:
        MirdrakeError: the vehicle cannot be loaded, or there is nothing to render with.
    """
    draw_portrait(load_vehicle(str(folder))).save(folder / PORTRAIT, format="PNG")
    readme = folder / "README.md"
    title, _, rest = readme.read_text(encoding="utf-8").partition("\n")
    readme.write_text(f"{title}\n\n![{title.lstrip('# ')}]({PORTRAIT})\n{rest}", encoding="utf-8")


def _pose(parts: PlantParts, part: VehicleInPlant, context: Context) -> Context:
    """Put a vehicle on the road, its wheels turned a little to the left, for a plant's context; returns it."""
    set_start(parts.plant, context, part, x=0.0, y=0.0, yaw=0.0)
    for joint in part.steering:
        joint.set_angle(context, _STEER * part.vehicle.geometry.steering_limit)
    return context


def _seen_points(parts: PlantParts, part: VehicleInPlant, context: Context) -> list[Array]:
    """Return points (n, 3) [m] with the hull of each visual shape."""
    inspector = parts.scene_graph.model_inspector()
    # The axles are always in the picture, even if a vehicle has no visual shapes.
    hulls = [np.array([[0.0, 0.0, 0.0], [part.vehicle.geometry.wheelbase, 0.0, 0.0]])]
    for index in parts.plant.GetBodyIndices(part.instance):
        body = parts.plant.get_body(index)
        X_WB = parts.plant.EvalBodyPoseInWorld(context, body)
        for geometry in parts.plant.GetVisualGeometriesForBody(body):
            # Convex hulls of meshes are much smaller than the meshes and have the same extent.
            points = bounding_points(inspector, X_WB, geometry)
            hulls += [] if points is None else [points]
    return hulls


def _add_shadow(parts: PlantParts, points: list[Array]) -> None:
    """Add a soft shadow on the road: dark layers, each a little smaller than the one below.

    The renderer's own shadows are as coarse as the ground is wide, a texel a metre.
    """
    azimuth, elevation = _SUN
    slant = np.array([cos(azimuth), sin(azimuth)]) / tan(elevation)
    # Parallel projection along the sun's rays onto the ground.
    hulls = [shapely.MultiPoint(part[:, :2] - np.maximum(part[:, 2:], 0.0) * slant).convex_hull for part in points]
    shadow = shapely.union_all(hulls)
    size = float(np.ptp(np.vstack(points), axis=0).max())
    world = parts.plant.GetBodyFrameIdOrThrow(parts.plant.world_body().index())
    for layer in range(_LAYERS):
        # Layers from larger to smaller than the shadow: their sum is a soft edge.
        edge = (0.3 - layer / (_LAYERS - 1)) * 0.10 * size
        outline = shadow.buffer(edge)
        if outline.is_empty:
            break
        lines = []
        for triangle in shapely.get_parts(shapely.constrained_delaunay_triangles(outline)):
            corners = shapely.get_coordinates(shapely.orient_polygons(triangle))[:3]
            lines.append(corners)
        # Each layer a little higher, or coplanar triangles would flicker.
        height = 2e-4 * size * (layer + 1)
        mesh = Mesh(InMemoryMesh(mesh_file=MemoryFile(_write_obj(np.array(lines), height), ".obj", "shadow")))
        properties = PerceptionProperties()
        properties.AddProperty("phong", "diffuse", Rgba(0.0, 0.0, 0.0, _SHADE))
        instance = GeometryInstance(RigidTransform(), mesh, f"shadow/{layer}")
        instance.set_perception_properties(properties)
        parts.scene_graph.RegisterGeometry(parts.plant.get_source_id(), world, instance)


def _write_obj(triangles: Array, height: float) -> str:
    """Return horizontal triangles (n, 3, 2) [m] at a height [m] as an OBJ file."""
    lines = [f"v {x:.6f} {y:.6f} {height:.6f}" for x, y in triangles.reshape(-1, 2).tolist()]
    lines.append("vn 0 0 1")
    lines += [f"f {i}//1 {i + 1}//1 {i + 2}//1" for i in range(1, 3 * len(triangles), 3)]
    return "\n".join(lines) + "\n"


def _lights(world: World) -> list[LightParameter]:
    """Return the lights of a world with the sun on the camera's side."""
    azimuth, elevation = _SUN
    towards = np.array([cos(elevation) * cos(azimuth), cos(elevation) * sin(azimuth), sin(elevation)])
    # The world's sun is replaced, its ambient lights are kept.
    _, *ambient = lights(world)
    color = Rgba(1.0, 0.97, 0.92, 1.0)
    sun = LightParameter(type="directional", frame="world", direction=-towards, intensity=1.15 * pi, color=color)
    return [sun, *ambient]


def _add_renderer(scene_graph: SceneGraph, world: World) -> None:
    # The renderer mixes the colours at edges, so what is behind them has the colour of the sky there.
    _, horizon = _sky_edges(world)
    params = RenderEngineVtkParams(lights=_lights(world), default_clear_color=horizon.tolist(), force_to_pbr=True)
    add_renderer(scene_graph, "portrait", params, needs="a portrait needs", instead="")


def _place(corners: Array, aspect: float) -> tuple[RigidTransform, float]:
    """Return pose (z ahead, x to the right, y down) and distance of a camera whose picture the points fill.

    Args:
        corners: points that must be visible (n, 3) [m].
        aspect: width over height of the picture.
    """
    back = np.array([cos(_ELEVATION) * cos(_AZIMUTH), cos(_ELEVATION) * sin(_AZIMUTH), sin(_ELEVATION)])
    ahead = -back
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    down = np.cross(ahead, right)
    # Columns of R_WC are the camera's axes in the world: right, down, ahead.
    R_WC = RotationMatrix(np.column_stack([right, down, ahead]))
    target = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
    slope = tan(0.5 * FIELD_OF_VIEW)
    distance = 0.0
    for _ in range(3):  # the middle of what is seen moves a little with the distance
        seen = (corners - target) @ R_WC.matrix()
        # Distance at which the outermost point, seen at its own depth, touches the margin; in both directions.
        distance = float(
            max(
                (np.abs(seen[:, 0]) * _MARGIN / slope - seen[:, 2]).max(),
                (np.abs(seen[:, 1]) * _MARGIN / (slope / aspect) - seen[:, 2]).max(),
            )
        )
        projected = seen[:, :2] / (seen[:, 2] + distance)[:, None]
        middle = 0.5 * (projected.min(axis=0) + projected.max(axis=0)) * distance
        # The view is centred on the projected middle, which perspective moves away from that of the box.
        target = target + R_WC.matrix()[:, :2] @ middle
    return RigidTransform(R_WC, target + distance * back), distance


def _sky_edges(world: World) -> tuple[Array, Array]:
    """Return the colours (3), 0 .. 1, of the sky at the top of the picture and at the horizon."""
    zenith, horizon = sky_colors(world)
    return 0.45 * zenith + 0.55 * horizon, 0.5 * horizon + 0.5


def _with_sky(pixels: Array, sky: NDArray[np.bool_], world: World) -> Array:
    """Return a picture (height, width, 3), 0 .. 255, with a sky that is paler towards the horizon.

    Args:
        pixels: picture (height, width, 3), 0 .. 255.
        sky: pixels without any geometry (height, width).
        world: world with the colours of the sky.
    """
    if not sky.any():
        return pixels
    top, horizon = _sky_edges(world)
    # The horizon is the lowest row with sky.
    last = int(np.nonzero(sky.any(axis=1))[0].max()) + 1
    share = (np.arange(pixels.shape[0]) / last).clip(0.0, 1.0)[:, None]
    rows = 255.0 * ((1.0 - share) * top + share * horizon)
    return np.where(sky[:, :, None], rows[:, None, :], pixels)


def main() -> int:
    """Add a portrait to the folder that the command line names."""
    try:
        add_portrait(Path(sys.argv[1]))
    except MirdrakeError as error:
        sys.stderr.write(f"{first_line(error)}\n")
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
