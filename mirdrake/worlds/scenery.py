"""Visual geometry of a world: ground, roads and paint as meshes for Drake, sun and sky as data.

Road, paint and ground are cut out of each other, so that no two surfaces are close above each other, which would cause
z-fighting. The road's top is at z = 0, where the physical plane is; the ground beside it is lower by the thickness of
the roads, as it is for tyres. A friction patch is cut out likewise; one without its own surface shows the surface
below, darker and glossier, as if it were wet.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import tan
from pathlib import Path

import numpy as np
import shapely
from pydrake.common import MemoryFile
from pydrake.geometry import (
    InMemoryMesh,
    LightParameter,
    Mesh,
    Meshcat,
    RenderEngineVtkParams,
    Rgba,
    Shape,
)
from pydrake.math import RigidTransform, RollPitchYaw
from shapely.geometry.base import BaseGeometry

from mirdrake.core.paths import data_root, resolved
from mirdrake.ground.terrain import Slab
from mirdrake.worlds.draping import Roads, drape
from mirdrake.worlds.drawing import EDGE_LINE_INSET
from mirdrake.worlds.meshes import Surface, fill, make_gltf, skirt
from mirdrake.worlds.networks.paint import paint
from mirdrake.worlds.pieces import Array
from mirdrake.worlds.relief import KerbRelief
from mirdrake.worlds.slab import SAGITTA, seen_outline, without_details
from mirdrake.worlds.spec import MarkingSpec, ScenerySpec
from mirdrake.worlds.tracks import Offset, Track, offset_at
from mirdrake.worlds.world import World, verge

TILES = {"asphalt": 4.0, "grass": 6.0, "concrete": 4.0, "gravel": 3.0, "ice": 8.0}
"""Side of a texture tile [m]."""

SKIES = {"clear": ((70, 125, 200), (205, 222, 238)), "overcast": ((176, 182, 190), (214, 217, 220))}
"""Colours of the skies at the zenith and at the horizon, red, green, blue, 0 .. 255."""

_WHITE = (0.86, 0.86, 0.84)
_STONE, _STONE_WIDTH = (0.62, 0.61, 0.58), 0.15  # colour of kerbs, and visible width of their tops [m]
_PAINT = {"white": _WHITE, "yellow": (0.85, 0.62, 0.08)}
_WET, _WET_ROUGHNESS = (0.62, 0.66, 0.74), 0.55
_SIDE_GREY = {
    "asphalt": 0.10,
    "grass": 0.12,
    "concrete": 0.35,
    "gravel": 0.22,
    "ice": 0.70,
}  # linear grey
_APRON = 1000.0  # [m] visible ground beyond the world, up to the horizon


@dataclass(frozen=True)
class SceneryItem:
    """A visual geometry fixed in the world."""

    name: str
    shape: Shape
    X_WG: RigidTransform
    rgba: Array | None = None
    """colour, or None if the mesh contains its own"""


@dataclass(frozen=True)
class SunLight:
    """A directional light in W."""

    direction: Array
    """unit vector from the sun to the ground"""
    intensity: float
    """1 is a clear day [-]"""
    color: tuple[float, float, float]
    """red, green, blue, 0 .. 1"""


def texture_path(surface: str) -> Path:
    """Return the texture file of a surface."""
    return data_root() / "worlds" / "textures" / f"{surface}.jpg"


def scenery(world: World) -> list[SceneryItem]:
    """Return ground, roads and painted lines of a world as visual geometry of the world body.

    The meshes are in memory and refer to their textures by path; nothing is written.
    """
    items: list[SceneryItem] = []
    roads = {name: seen_outline(track) for name, track in world.roads().items()}
    names, tracks = list(roads), shapely.union_all(list(roads.values()))
    patches, wet = _seen_patches(world)
    covered = shapely.union_all(list(patches.values()))
    for index, name in enumerate(names):
        spec, track, road = world.spec.tracks[name], world.tracks[name], roads[name]
        others = [roads[other] for other in names if other != name]
        # Of two roads that cross, the later one is on top and remains whole.
        later = shapely.union_all([roads[other] for other in names[index + 1 :]])

        # Paint: the parts of lines that are not on other roads; then the road around them.
        lines = shapely.union_all([_line(track, marking) for marking in spec.markings])
        lines = shapely.difference(shapely.intersection(lines, road), shapely.union_all(others))
        bare = shapely.difference(shapely.difference(shapely.difference(road, lines), later), covered)
        lines = shapely.difference(lines, covered)
        surfaces = _textured(bare, spec.surface, wet, z=0.0)
        items.append(_item(f"world/{name}/road", surfaces, world))
        if not lines.is_empty:
            paint = _wetted(lines, wet, lambda part: fill(part, z=0.0, tile=1.0, color=_WHITE, texture=None))
            items.append(_item(f"world/{name}/lines", paint, world))

    # The network is below the tracks.
    items[:0] = _network_items(world, wet, shapely.union(tracks, covered))
    paved = [part.area for part in world.road_areas if not part.is_track]

    # Ground: everything beside the roads, lower by their thickness.
    depth = world.ground.depth
    plane = shapely.box(*world.ground.extent)
    wide = plane.buffer(_APRON, join_style="mitre")
    asphalt = shapely.union_all([*roads.values(), *paved])
    # Roads and their faces are cut out, as the ground is only centimetres below them and would flicker through.
    slab = world.ground.slab
    raised = asphalt if slab is None else shapely.buffer(asphalt, slab.face, join_style="mitre")
    if slab is not None:
        items.append(_item("world/edges", [_edges(_polygons(asphalt), slab, world)], world))
    ground = shapely.difference(shapely.difference(plane, raised), covered)
    apron = shapely.difference(shapely.difference(wide, plane), covered)
    parts: list[Surface] = []
    # Kerb stones are lighter than road and ground, as their height alone is hardly seen.
    kerbs = [entry.kerb for entry in world.spec.ground.relief if entry.kerb is not None]
    stones = _polygons(
        shapely.intersection(shapely.union_all([_stone(world.tracks[kerb.along], kerb) for kerb in kerbs]), ground)
    )
    if not stones.is_empty:
        ground = shapely.difference(ground, stones)
        parts += _wetted(stones, wet, lambda part: fill(part, z=-depth, tile=1.0, color=_STONE, texture=None))
    for name, track in world.roads().items():
        edges = world.spec.tracks[name].verge
        if edges is not None and edges != world.ground.surface:
            beside = shapely.intersection(without_details(verge(track)), ground)
            ground = shapely.difference(ground, beside)
            parts += _textured(beside, edges, wet, z=-depth)
    for part in (ground, apron):
        parts += _textured(part, world.ground.surface, wet, z=-depth)
    items.insert(0, _item("world/ground", parts, world))

    # Patches: at the height of the road on it, at that of the ground beside it.
    looks = {patch.name: patch.surface for patch in world.patches if patch.surface is not None}
    for name, area in patches.items():
        above, beside = (
            shapely.intersection(area, asphalt),
            shapely.difference(shapely.intersection(area, wide), raised),
        )
        both = _textured(above, looks[name], wet, z=0.0) + _textured(beside, looks[name], wet, z=-depth)
        if both:
            items.append(_item(f"world/patch.{name}", both, world))

    # Meshes without collision geometry.
    for index, mesh in enumerate(world.spec.scenery):
        X_WG = RigidTransform(RollPitchYaw(mesh.roll, mesh.pitch, mesh.yaw), mesh.at)
        items.append(SceneryItem(f"world/scenery.{index}", Mesh(str(scenery_file(world, mesh))), X_WG))
    return items


def scenery_file(world: World, mesh: ScenerySpec) -> Path:
    """Return the file of a mesh without collision geometry."""
    return resolved(world.path.parent if world.path is not None else Path.cwd()) / mesh.file


def sun_light(world: World) -> SunLight:
    """Return the sun of a world."""
    sun = world.spec.lights.sun
    level = np.cos(sun.elevation)
    towards = np.array([level * np.cos(sun.azimuth), level * np.sin(sun.azimuth), np.sin(sun.elevation)])
    return SunLight(-towards, sun.intensity, (1.0, 0.97, 0.92))


def sky_colors(world: World) -> tuple[Array, Array]:
    """Return red, green and blue, 0 .. 1, of the sky at the zenith and at the horizon."""
    zenith, horizon = SKIES[world.spec.sky]
    return np.array(zenith) / 255.0, np.array(horizon) / 255.0


def lights(world: World) -> list[LightParameter]:
    """Return the lights of a world for Drake's renderers: the sun, and three weak ones as ambient light.

    Without lights, Drake's VTK renderer puts one on the camera, and the ground in a driver's view is almost black.
    Physically based shading, which glTF meshes enable, divides the light of a matt surface by π. Intensities are
    multiplied by π, so that a white surface that faces a sun of intensity 1 is just white.
    """
    sun, ambient = sun_light(world), world.spec.lights.ambient
    level = sun.direction * [1.0, 1.0, 0.0]
    # A sun in the zenith has no horizontal direction; any one is right then.
    away = -level / np.linalg.norm(level) if level.any() else np.array([1.0, 0.0, 0.0])
    down = np.array([0.0, 0.0, -1.0])

    def light(direction: Array, intensity: float, color: tuple[float, float, float]) -> LightParameter:
        return LightParameter(
            type="directional", frame="world", direction=direction, intensity=np.pi * intensity, color=Rgba(*color, 1.0)
        )

    return [
        light(sun.direction, sun.intensity, sun.color),
        light(down, ambient, (0.88, 0.94, 1.0)),
        light(away, 0.7 * ambient, (0.88, 0.94, 1.0)),
        light(-down, 0.4 * ambient, (0.9, 0.95, 0.8)),
    ]


def render_params(world: World) -> RenderEngineVtkParams:
    """Return the settings of Drake's VTK renderer for a world: its lights, and a sky of one colour.

    An environment map would also show the sky's gradient, but takes nearly two minutes to prepare without a graphics
    card.
    """
    return RenderEngineVtkParams(lights=lights(world), default_clear_color=sky_colors(world)[1], force_to_pbr=True)


def set_sky(meshcat: Meshcat, world: World) -> None:
    """Set the sky of a world in Meshcat and a view up to the horizon; hide the grid and the axes.

    Meshcat also lights the scene with its background. A saturated blue would colour the ground, so the sky is paler.
    """
    zenith, horizon = sky_colors(world)
    meshcat.SetProperty("/Background", "top_color", (0.35 * zenith + 0.65).tolist())
    meshcat.SetProperty("/Background", "bottom_color", (0.5 * horizon + 0.5).tolist())
    towards = -sun_light(world).direction
    # The headlight of Meshcat would hide the shading by the sun.
    for lamp in (
        "SpotLight",
        "PointLightNegativeX",
        "PointLightPositiveX",
    ):  # bright spots near the origin
        meshcat.SetProperty(f"/Lights/{lamp}", "visible", False)
    meshcat.SetProperty("/Lights/AmbientLight/<object>", "intensity", 0.6)
    meshcat.SetProperty("/Lights/FillLight/<object>", "intensity", 1.5 * world.spec.lights.sun.intensity)
    meshcat.SetProperty("/Lights/FillLight/<object>", "position", (10.0 * towards).tolist())
    meshcat.SetProperty("/Cameras/default/rotated/<object>", "near", 0.1)
    meshcat.SetProperty("/Cameras/default/rotated/<object>", "far", 3.0 * _APRON)
    meshcat.SetProperty("/Grid", "visible", False)
    meshcat.SetProperty("/Axes", "visible", False)


# --- the inner parts ---------------------------------------------------------------------------------------------


def _network_items(world: World, wet: BaseGeometry, above: BaseGeometry) -> list[SceneryItem]:
    """Return the lanes of the network and their paint, without the areas that are above them."""
    if world.network is None or world.spec.network is None:
        return []
    paints = paint(world.network) if world.spec.network.markings else {}
    painted = shapely.union_all(list(paints.values()))
    items: list[SceneryItem] = []
    # Surfaces that lie on the network replace it: two coplanar faces would flicker.
    parts = [part for part in world.road_areas if not part.is_track]
    paved = shapely.union_all([part.area for part in parts])
    for part in parts:
        bare = shapely.difference(shapely.difference(without_details(part.area), painted), above)
        surfaces = _textured(bare, part.surface, wet, z=0.0)
        items.append(_item(f"world/network/{part.name}", surfaces, world))
    for color, area in paints.items():
        lines = shapely.difference(shapely.intersection(area, paved), above)
        if not _polygons(lines).is_empty:
            rgb = _PAINT[color]
            surfaces = _wetted(lines, wet, lambda part: fill(part, z=0.0, tile=1.0, color=rgb, texture=None))  # noqa: B023
            items.append(_item(f"world/network/{color}_lines", surfaces, world))
    return items


def _seen_patches(world: World) -> tuple[dict[str, BaseGeometry], BaseGeometry]:
    """Return the visible area of every patch with a surface, by name, and the area that looks wet."""
    seen: dict[str, BaseGeometry] = {}
    above: BaseGeometry = shapely.Polygon()
    wet: BaseGeometry = shapely.Polygon()

    # Later patches are on top: from the top down, each shows only what is not covered yet.
    for patch in reversed(world.patches):
        area = _polygons(shapely.difference(_polygons(patch.area), above))
        if patch.surface is None:
            wet = shapely.union(wet, area)
        else:
            seen[patch.name] = area
            above = shapely.union(above, area)
    return dict(reversed(seen.items())), wet


def _patch(track: Track, stations: Array, begin: float, end: float, right: Offset, left: Offset) -> shapely.Polygon:
    """Return the part of a track from one s [m] to another and between two offsets [m], as a polygon."""
    between = stations[(stations > begin + 1e-6) & (stations < end - 1e-6)]
    s = np.concatenate(([begin], between, [end]))
    a, b = (np.column_stack(track.point(s, offset_at(side, s))) for side in (left, right))
    return shapely.Polygon(np.vstack((a, b[::-1])))


def _line(track: Track, marking: MarkingSpec) -> BaseGeometry:
    """Return a painted line as a polygon."""
    # Stations are dense enough that the chord differs from the curve by less than the sagitta.
    half = marking.width / 2.0
    stations = track.stations(sagitta=SAGITTA)
    if marking.line == "start":
        # Centred on s = 0 where the track continues before it, else from the start on.
        begin = -half if track.closed else 0.0
        return _patch(
            track,
            stations,
            begin,
            begin + marking.width,
            lambda s: EDGE_LINE_INSET - track.right_width(s),
            lambda s: track.left_width(s) - EDGE_LINE_INSET,
        )

    def middle(s: Array) -> Array:
        if marking.line == "left":
            return track.left_width(s) - EDGE_LINE_INSET - half
        return np.zeros_like(s) if marking.line == "center" else EDGE_LINE_INSET + half - track.right_width(s)

    def right(s: Array) -> Array:
        return middle(s) - half

    def left(s: Array) -> Array:
        return middle(s) + half

    if marking.kind == "solid":
        return without_details(track.band(right, left, sagitta=SAGITTA))
    painted, period = marking.dash[0], sum(marking.dash)
    count = max(1, round(track.length / period)) if track.closed else int(np.ceil(track.length / period))
    if track.closed:  # a whole number of dashes
        # The ratio of painted to free is kept.
        painted, period = painted * track.length / (count * period), track.length / count
    begins = period * np.arange(count)
    ends = np.minimum(begins + painted, track.length)
    return shapely.MultiPolygon([_patch(track, stations, a, b, right, left) for a, b in zip(begins, ends, strict=True)])


def _stone(track: Track, kerb: KerbRelief) -> shapely.Polygon:
    """Return the face of a kerb and the front of its top as a polygon."""
    side = 1.0 if kerb.side == "left" else -1.0
    width = kerb.height / tan(kerb.slope) + min(kerb.width, _STONE_WIDTH)
    begin = 0.0 if kerb.from_ is None else max(kerb.from_, 0.0)
    end = track.length if kerb.to is None else min(kerb.to, track.length)

    def inner(s: Array) -> Array:
        return side * (track.left_width(s) if side > 0.0 else track.right_width(s))

    def outer(s: Array) -> Array:
        return inner(s) + side * width

    return _patch(track, track.stations(sagitta=SAGITTA), begin, end, inner, outer)


def _polygons(shape: BaseGeometry) -> shapely.MultiPolygon:
    """Return only the polygons of a shape; an intersection may also contain lines and points."""
    return shapely.MultiPolygon(
        [part for part in shapely.get_parts(shape) if part.geom_type == "Polygon" and part.area > 1e-8]
    )


def _textured(polygon: BaseGeometry, surface: str, wet: BaseGeometry, *, z: float) -> list[Surface]:
    """Return a horizontal polygon with the texture of a surface."""
    return _wetted(
        polygon,
        wet,
        lambda part: fill(part, z=z, tile=TILES[surface], color=(1.0, 1.0, 1.0), texture=surface),
    )


def _edges(outline: shapely.MultiPolygon, slab: Slab, world: World) -> Surface:
    """Return the faces at the edges of all roads, as grey as the surface that most of them have."""
    areas: dict[str, float] = {}
    for road in world.road_areas:
        areas[road.surface] = areas.get(road.surface, 0.0) + road.area.area
    surface = max(areas, key=lambda name: areas[name])
    grey = _SIDE_GREY[surface]
    return skirt(outline, height=slab.thickness, length=slab.face, tile=TILES[surface], color=(grey, grey, grey))


def _wetted(polygon: BaseGeometry, wet: BaseGeometry, make: Callable[[BaseGeometry], Surface]) -> list[Surface]:
    """Return the dry and the wet part of a polygon as surfaces, without empty ones."""
    dry, damp = _polygons(polygon), shapely.MultiPolygon()
    if not wet.is_empty:  # in this order, because GEOS cannot cut some collections of polygons and lines
        dry, damp = _polygons(shapely.difference(dry, wet)), _polygons(shapely.intersection(dry, wet))
    surfaces = [] if dry.is_empty else [make(dry)]
    if not damp.is_empty:
        below = make(damp)
        color = tuple(part * tint for part, tint in zip(below.color, _WET, strict=True))
        surfaces.append(replace(below, color=color, roughness=_WET_ROUGHNESS))  # type: ignore[arg-type]
    return surfaces


def _item(name: str, surfaces: list[Surface], world: World) -> SceneryItem:
    """Return surfaces, laid on the relief, as one visual geometry."""
    # Triangles are refined near roads only; far away a coarse mesh of the terrain is enough.
    if not world.ground.relief.flat:
        near = Roads(shapely.union_all([road.area for road in world.road_areas]))
        surfaces = [drape(surface, world.ground.relief, near) for surface in surfaces]
    # Supporting files of an in-memory mesh are found by the names in its glTF.
    textures = {surface.texture for surface in surfaces if surface.texture}
    named = [replace(surface, texture=f"{surface.texture}.jpg") if surface.texture else surface for surface in surfaces]
    mesh = InMemoryMesh(
        mesh_file=MemoryFile(make_gltf(named), ".gltf", name),
        supporting_files={f"{texture}.jpg": texture_path(texture) for texture in sorted(textures)},
    )
    return SceneryItem(name, Mesh(mesh), RigidTransform())
