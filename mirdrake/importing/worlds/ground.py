"""The ground of the new world: planes, slabs, sheets and roads of the source as base plane, patches and tracks.

All drivable surfaces are ground (drivable.py). The ground of the new world is the plane z = 0: slightly higher surfaces
are lowered onto it, together with the objects on them. Roads get a centre line that drivers can follow (routes.py).
"""

import math
from dataclasses import dataclass, field, replace

import numpy as np
import shapely
import trimesh
from pydrake.math import RigidTransform

from mirdrake.core.wording import plural
from mirdrake.importing.changes import Changes, Code
from mirdrake.importing.meshes.read import MeshError
from mirdrake.importing.shape import Shape
from mirdrake.importing.target import is_word
from mirdrake.importing.worlds.drivable import (
    ROAD_WORDS,
    Surface,
    corners_in_world,
    footprints,
    heights_below,
    is_ground,
    is_island,
    surfaces_of,
    without,
)
from mirdrake.importing.worlds.entry import degrees, number
from mirdrake.importing.worlds.model import Array, Plane, Road, SourceObject, SourceWorld
from mirdrake.importing.worlds.routes import Route, route_in_area, route_of_line
from mirdrake.importing.worlds.surfaces import FLAT, outline

_WORDS = (
    ("asphalt", ROAD_WORDS),
    ("grass", ("grass", "lawn", "field")),
    ("gravel", ("gravel", "dirt", "sand", "mud", "soil")), ("ice", ("ice", "snow")),
    ("concrete", ("concrete", "floor", "pavement", "sidewalk", "cement", "tile", "ground", "grey", "gray", "plane")),
)  # fmt: skip
_LEVEL = 1e-3  # [rad] tilt of what counts as level
_WIDEST = 1e5  # [m] ground
_UNEVEN = 0.5  # [m] between the highest and the lowest point of roads on level ground
_LARGEST_BASE = 20.0  # [m²] from which on a floor may be the base plane
_LIFT = 3e-3  # [m] height of visuals above the ground, so that they do not flicker
_CAR_HEIGHT = 2.0  # [m] below which obstacles block a road
_CLEAR = 1.2  # [m] between the middle of a road and an obstacle: half a car and some room
_TURN = 4.6  # [m] radius that a small car can turn on
_LONG_ROUTE = 150.0  # [m] of a track that needs no other


@dataclass
class GroundText:
    """Ground of the new world.

    Attributes:
        surface, mu, size: of the base plane.
        patches: their entries, in order.
        tracks: their entries by name, in order; the longest first.
        routes: the same tracks laid out.
        drawn: visual-only objects.
        height: height of the base plane in W of the source [m]; the new W is that much higher.
        names: names of all patches and tracks.
        reach: farthest corner of a patch from the origin along x or y [m].
    """

    surface: str = "concrete"
    mu: float | None = None
    size: tuple[float, float] | None = None
    patches: list[str] = field(default_factory=list)
    tracks: dict[str, str] = field(default_factory=dict)
    routes: dict[str, Route] = field(default_factory=dict)
    drawn: list[SourceObject] = field(default_factory=list)
    height: float = 0.0
    names: set[str] = field(default_factory=set)
    reach: float = 0.0


def make_ground(world: SourceWorld, changes: Changes) -> GroundText:
    """Return the ground; objects that become ground are removed from the world, those on it are lowered.

    Args:
        world: its `objects` are changed.
        changes: get every change.
    """
    # All candidates for ground: level planes, and level faces of objects that do not move.
    ground = GroundText()
    level = _level_planes(world, changes)
    surfaces = [surface for obj in world.objects if _may_be_ground(obj) for surface in surfaces_of(obj)]
    # A slab that is thick for its width is an obstacle and not a floor.
    thin = [surface for surface in surfaces if surface.thickness <= 0.1 * math.sqrt(surface.area)]
    floors: list[Surface] = []

    # The base plane: a plane of the source, else its largest floor, else the height of its roads.
    if level:
        # A plane without size is unbounded: larger than any other.
        base = max(level, key=lambda plane: math.prod(plane.size or (1e6, 1e6)))
        ground.height = _height(float(base.X_WP.translation()[2]))
        _take_base(ground, base, changes)
        for plane in level:
            if plane is not base:
                _patch_of_plane(ground, plane, base, changes)
    elif thin and (largest := max(thin, key=lambda one: one.area)).area > _LARGEST_BASE:
        ground.height = _height(largest.top)
        if _is_base(largest, surfaces, world.roads):
            _take_floor(ground, largest, changes)
            floors.append(largest)
        else:
            ground.surface = "grass"
            was = f"no plane, but roads at z = {largest.top:.4g} m"
            changes.add(Code.GROUND, largest.obj.where, "ground", was, "ground of grass", "a world needs a base plane")
    elif world.roads and np.ptp(heights := np.concatenate([road.points[:, 2] for road in world.roads])) < _UNEVEN:
        ground.height = _height(float(np.median(heights)))
        was = f"none; roads at z = {np.median(heights):.4g} m"
        why = "a world needs a base plane"
        changes.add(Code.GROUND, world.roads[0].where, "ground", was, f"ground of {ground.surface}", why)
    else:
        where = str(world.files[0]) + ":1"
        changes.add(Code.GROUND, where, "ground", "none", f"{ground.surface} at z = 0", "a world needs a base plane")

    # Slabs and sheets, visual-only surfaces and roads; then the objects on them.
    accepted = [surface for surface in surfaces if is_ground(surface, ground.height)]
    roads_and_yards = [surface for surface in accepted if surface not in floors]
    accepted = [surface for surface in accepted if surface in floors or not is_island(surface, roads_and_yards)]
    roads = _lay_down(world, ground, [surface for surface in accepted if surface not in floors], changes)
    _take_out(world, ground, accepted, changes)
    roads += _lay_down(world, ground, _take_seen(world, ground, changes), changes)
    for road in world.roads:
        _lay_road(ground, road, changes)
    _add_routes(world, ground, roads, changes)
    _lower_things(world, ground, accepted, changes)
    if abs(ground.height) > 1e-4:
        where = level[0].where if level else f"{world.files[0]}:1"
        became = f"z = 0, everything {abs(ground.height):.4g} m {'lower' if ground.height > 0.0 else 'higher'}"
        changes.add(
            Code.GROUND, where, "height of the ground", f"z = {ground.height:.4g} m", became, "the ground is at z = 0"
        )
    return ground


def _level_planes(world: SourceWorld, changes: Changes) -> list[Plane]:
    level = []
    for plane in world.planes:
        # The z of the normal is the cosine of the tilt; rounding may put it above 1.
        tilt = math.acos(float(np.clip(plane.X_WP.rotation().matrix()[2, 2], -1.0, 1.0)))
        if tilt > _LEVEL:
            why = "the ground is level; ground.slope sets a slope of the whole world"
            changes.add(
                Code.GROUND, plane.where, f"plane '{plane.name}'", f"tilted by {math.degrees(tilt):.4g} deg", None, why
            )
        else:
            level.append(plane)
    return level


def _may_be_ground(obj: SourceObject) -> bool:
    """Return whether an object may be part of the ground: it does not move and was read completely."""
    return not obj.broken and not obj.wheels and not obj.absent and (obj.static or not obj.loose)


def _height(height: float) -> float:
    """Return the height of a base plane [m]; heights near zero become zero."""
    return 0.0 if abs(height) <= FLAT / 2.0 else height


def _is_base(floor: Surface, surfaces: list[Surface], roads: list[Road]) -> bool:
    """Return whether a floor is the ground of a whole world and not a road."""
    corners = [point for surface in surfaces for polygon in surface.polygons for point in polygon.exterior.coords]
    corners += [tuple(point[:2]) for road in roads for point in road.points]
    return floor.area > 0.5 * shapely.MultiPoint(corners).convex_hull.area


def _take_floor(ground: GroundText, floor: Surface, changes: Changes) -> None:
    """Use the largest floor as base plane of a world without one, and as a patch if it is not a level rectangle."""
    obj = floor.obj
    ground.surface = _surface_of(floor) or "concrete"
    was = f"no plane, but a floor of {floor.area:.4g} m² at z = {floor.top:.4g} m"
    rect = _rect_of(floor)
    # The base plane is centred at the origin, so that it reaches the farthest corner on both sides.
    reach = np.abs(np.concatenate([np.array(polygon.exterior.coords) for polygon in floor.polygons])).max(axis=0)
    ground.size = (round(2.0 * float(reach[0]), 2), round(2.0 * float(reach[1]), 2))
    if rect and "yaw" not in rect:
        ground.mu = _mu(obj)
        became = f"ground of {ground.surface}, {ground.size[0]:g} m x {ground.size[1]:g} m"
        changes.add(Code.GROUND, obj.where, f"model '{obj.name}'", was, became, "a world needs a base plane")
        return
    changes.add(Code.GROUND, obj.where, "ground", was, f"ground of {ground.surface}", "a world needs a base plane")
    _patches_of(ground, [floor], obj.name, ground.surface, _mu(obj))


def _take_base(ground: GroundText, plane: Plane, changes: Changes) -> None:
    ground.surface = _surface(plane.words) or "concrete"
    became = f"ground of {ground.surface}"
    x, y, _ = plane.X_WP.translation().tolist()
    if plane.size is not None and 2.0 * np.abs(_rectangle(plane)).max() <= _WIDEST:
        # The base plane is centred at the origin, so that it reaches the farthest corner on both sides.
        reach = np.abs(_rectangle(plane)).max(axis=0)
        ground.size = (round(2.0 * float(reach[0]), 2), round(2.0 * float(reach[1]), 2))
        became += f", {ground.size[0]:g} m x {ground.size[1]:g} m"
    was = f"plane at {x:.4g} {y:.4g}, mu {'as it is' if plane.mu is None else f'{plane.mu:g}'}"
    if plane.mu is not None and 0.0 < plane.mu <= 2.0:
        ground.mu = plane.mu
        became += f", mu {plane.mu:g}"
        why = "the base plane"
    elif plane.mu is not None:
        why = f"the base plane; mu {plane.mu:g} means no slip, so that of the surface is used"
    else:
        why = "the base plane; mu is that of the surface"
    changes.add(Code.GROUND, plane.where, f"plane '{plane.name}'", was, became, why)


def _rectangle(plane: Plane) -> Array:
    """Return the corners of a plane in the plan view (4, 2) [m]."""
    a, b = plane.size or (1.0, 1.0)
    corners = 0.5 * np.array([[a, b, 0.0], [-a, b, 0.0], [-a, -b, 0.0], [a, -b, 0.0]])
    seen: Array = (corners @ plane.X_WP.rotation().matrix().T + plane.X_WP.translation())[:, :2]
    return seen


def _patch_of_plane(ground: GroundText, plane: Plane, base: Plane, changes: Changes) -> None:
    height = float(plane.X_WP.translation()[2]) - ground.height
    part, was = f"plane '{plane.name}'", f"plane {height:.4g} m over the ground"
    # A second infinite or elevated plane has no meaning for cars on the first one.
    if plane.size is None or abs(height) > FLAT:
        changes.add(Code.GROUND, plane.where, part, was, None, f"'{base.name}' is the ground already")
        return
    surface = _surface(plane.words) or ground.surface
    mu = plane.mu if plane.mu is not None and 0.0 < plane.mu <= 2.0 else None
    name = _new_name(ground, plane.name)
    x, y, _ = plane.X_WP.translation().tolist()
    R = plane.X_WP.rotation().matrix()
    rect = _rect((x, y), plane.size, math.atan2(R[1, 0], R[0, 0]))
    ground.patches.append(_patch(name, rect, surface, mu))
    changes.add(Code.GROUND, plane.where, part, was, f"patch '{name}' of {surface}", f"'{base.name}' is the ground")


# --- slabs, sheets and visual-only surfaces ------------------------------------------------------------------------


def _lay_down(
    world: SourceWorld, ground: GroundText, surfaces: list[Surface], changes: Changes
) -> list[shapely.Polygon]:
    """Add patches for surfaces, adjacent similar ones together; return the areas of roads."""
    # Surfaces with the same look and friction that touch become one patch, the lowest first.
    alike: dict[tuple[str, float | None], list[Surface]] = {}
    for surface in sorted(surfaces, key=lambda item: item.top):
        if surface.top < ground.height - FLAT and world.planes:
            part, was = f"model '{surface.obj.name}'", f"level, {ground.height - surface.top:.3g} m below the ground"
            changes.add(Code.GROUND, surface.obj.where, part, was, None, "it is below the ground plane")
            continue
        # A visual has no friction coefficient, so that of the ground is used.
        mu = _mu(surface.obj) if surface.obj.collisions else ground.mu
        alike.setdefault((_surface_of(surface) or ground.surface, mu), []).append(surface)
    roads: list[shapely.Polygon] = []
    for (look, mu), group in alike.items():
        for together in _touching(group):
            first = together[0].obj
            count = _patches_of(ground, together, first.name, look, mu)
            above = max(surface.top for surface in together) - ground.height
            rise = max(surface.rise for surface in together)
            part = f"model '{first.name}'" + (f" and {len(together) - 1} that touch it" if len(together) > 1 else "")
            was = f"level, {together[0].thickness:.3g} m thick, {sum(item.area for item in together):.4g} m²"
            became = f"{plural(count, 'patch')} of {look}"
            why = "drivable surfaces are ground"
            if rise > FLAT:
                was, became = f"{was}, rising by {rise:.3g} m", f"{became}, flattened"
            elif above > FLAT:
                was, became = f"{was}, {above:.3g} m above the ground", f"{became}, {above:.3g} m lower"
            changes.add(Code.GROUND, first.where, part, was, became, why)
            # Paved or narrow surfaces may be roads, along which a centre line is searched.
            if look in {"asphalt", "concrete"} or any(item.width < 0.25 * math.sqrt(item.area) for item in together):
                roads += [polygon for surface in together for polygon in surface.polygons]
    return roads


def _touching(surfaces: list[Surface]) -> list[list[Surface]]:
    """Return surfaces in groups that touch each other."""
    # Each area grows by FLAT, so that gaps of up to twice this width count as contact.
    areas = [shapely.union_all(surface.polygons).buffer(FLAT) for surface in surfaces]
    pairs = shapely.STRtree(areas).query(areas, predicate="intersects")
    labels = trimesh.graph.connected_component_labels(pairs.T, len(surfaces))
    groups: dict[int, list[Surface]] = {}
    for label, surface in zip(labels.tolist(), surfaces, strict=True):
        groups.setdefault(label, []).append(surface)
    return list(groups.values())


def _take_out(world: SourceWorld, ground: GroundText, surfaces: list[Surface], changes: Changes) -> None:
    """Remove surfaces from their objects; the rest is an obstacle or visual only."""
    of: dict[SourceObject, list[Surface]] = {}
    for surface in surfaces:
        of.setdefault(surface.obj, []).append(surface)
    objects = []
    for obj in world.objects:
        rest = without(obj, of.get(obj, []))
        if rest.collisions or obj not in of:
            objects.append(rest if obj in of else obj)
            continue
        for change in obj.missing:
            changes.append(change)
        surfaces_of_obj = of[obj]
        # Visuals that differ from the patch stay as scenery, just above it.
        if any(not _looks_like(shape, obj, surfaces_of_obj) for shape in obj.visuals):
            ground.drawn.append(_lifted(rest, max(surface.top for surface in surfaces_of_obj) - ground.height))
    world.objects = objects


def _looks_like(shape: Shape, obj: SourceObject, surfaces: list[Surface]) -> bool:
    """Return whether a visual is a plain slab that looks like the surfaces of its object."""
    if shape.kind not in {"box", "plane", "cylinder"} or shape.texture is not None:
        return False
    try:
        corners = corners_in_world(shape, obj)
    except MeshError:
        return True
    area = shapely.MultiPoint(corners.reshape(-1, 3)[:, :2]).convex_hull
    covered = shapely.union_all([polygon for surface in surfaces for polygon in surface.polygons])
    top = float(corners[:, :, 2].max())
    near = any(abs(top - surface.top) <= FLAT for surface in surfaces)
    return (
        near
        # Nine tenths: the visual of a floor is rarely equal to its collision shape.
        and bool(shapely.area(shapely.intersection(area, covered)) > 0.9 * max(area.area, 1e-9))
        and (area.area > 0.05 * covered.area)
    )


def _lifted(obj: SourceObject, above: float) -> SourceObject:
    """Return a visual-only object moved down by a height [m] to just above the ground."""
    return replace(obj, X_WM=lowered(obj.X_WM, above - _LIFT), collisions=[])


def _take_seen(world: SourceWorld, ground: GroundText, changes: Changes) -> list[Surface]:
    """Move objects with visuals only to the scenery; return those of their surfaces that are ground."""
    taken: list[Surface] = []
    objects = []
    for obj in world.objects:
        # Objects with collision shapes are obstacles or ground in their own right.
        if obj.collisions or not obj.visuals or obj.absent or obj.broken or obj.wheels:
            objects.append(obj)
            continue
        level = [surface for surface in surfaces_of(obj, seen=True) if is_ground(surface, ground.height)]
        level = [
            surface for surface in level if surface.whole and surface.top > ground.height - FLAT and surface.width > 1.0
        ]
        taken += level
        # The ground becomes a plane: what is drawn on it is lifted by the difference of the heights.
        above = max((surface.top for surface in level), default=ground.height) - ground.height
        if any(not _looks_like(shape, obj, level) for shape in obj.visuals):
            ground.drawn.append(_lifted(obj, above))
        for change in obj.missing:
            changes.append(change)
        if not level:
            why = "it has no collision geometry in the source"
            changes.add(Code.GROUND, obj.where, f"model '{obj.name}'", "only visuals", "visual only", why)
    world.objects = objects
    return taken


def _lower_things(world: SourceWorld, ground: GroundText, surfaces: list[Surface], changes: Changes) -> None:
    """Lower the objects on surfaces that were lowered."""
    objects = [*world.objects, *ground.drawn]
    if not objects or not surfaces:
        return
    points = np.array([_foot(obj) for obj in objects])
    lower = heights_below(surfaces, points, ground.height)
    moved = [(obj, drop) for obj, drop in zip(objects, lower.tolist(), strict=True) if abs(drop) > 1e-4]
    for obj, drop in moved:
        obj.X_WM = lowered(obj.X_WM, drop)
    if moved:
        was = f"{len(moved)} on a surface up to {max(drop for _, drop in moved):.3g} m above the ground"
        why = "the surfaces below them were lowered"
        changes.add(Code.GROUND, f"{world.files[0]}:1", "objects on raised ground", was, "lowered with it", why)


def _foot(obj: SourceObject) -> Array:
    """Return the lowest point of an object below its centre, in W [m]; its position if no shape can be read."""
    clouds = []
    for shape in obj.collisions or obj.visuals:
        try:
            clouds.append(corners_in_world(shape, obj).reshape(-1, 3))
        except MeshError:
            continue
    if not clouds:
        return np.asarray(obj.X_WM.translation())
    points = np.concatenate(clouds)
    low, high = points.min(axis=0), points.max(axis=0)
    # FLAT higher: the lowest point may be sunk into the surface below it.
    return np.array([*(0.5 * (low + high))[:2], low[2] + FLAT])


# --- roads and their centre lines -----------------------------------------------------------------------------------


def _lay_road(ground: GroundText, road: Road, changes: Changes) -> None:
    """Add a road of the source as a track, else as patches."""
    heights = road.points[:, 2] - ground.height
    lifted = f", up to {np.abs(heights).max():.3g} m off the ground" if np.abs(heights).max() > FLAT else ""
    was = f"{len(road.points)} points, {road.width:g} m wide{lifted}"
    surface = _surface(road.words) or "asphalt"
    # A line that a car can follow becomes a track, which has markings, starts and goals.
    route = route_of_line(road.points[:, :2], road.width)
    if route is not None and route.is_road:
        name = _new_track(ground, road.name, route, f", surface: {surface}")
        became = f"track '{name}' of {surface}, {route.track.length:.4g} m long"
        changes.add(Code.ROAD, road.where, f"road '{road.name}'", was, became, "corners were rounded to arcs")
        return
    line = shapely.LineString(road.points[:, :2])
    areas = outline([line.buffer(road.width / 2.0, cap_style="flat", join_style="mitre", mitre_limit=2.0)])
    _add_polygons(ground, areas, road.name, surface, None)
    became = f"{plural(len(areas), 'patch')} of {surface}"
    if route is not None:
        became += f", and track '{_new_track(ground, road.name, route, '')}' along its middle"
    changes.add(
        Code.ROAD, road.where, f"road '{road.name}'", was, became, "it crosses itself or is too wide for its bends"
    )


def _add_routes(world: SourceWorld, ground: GroundText, roads: list[shapely.Polygon], changes: Changes) -> None:
    """Add a track along the largest connected roads unless a track is long enough; the longest comes first."""
    longest = max((route.track.length for route in ground.routes.values()), default=0.0)
    areas = [*roads, *(route.track.area for route in ground.routes.values())]
    if areas and longest < _LONG_ROUTE:
        # Gaps of a few centimetres between slabs are closed before the roads are followed.
        joined = shapely.union_all([area.buffer(2.0 * FLAT, join_style="mitre") for area in areas])
        joined = joined.buffer(-2.0 * FLAT, join_style="mitre")
        parts = sorted(
            (part for part in shapely.get_parts(joined) if part.geom_type == "Polygon"), key=lambda part: -part.area
        )
        obstacles = footprints(world.objects, ground.height + FLAT, ground.height + _CAR_HEIGHT)
        for part in parts[:3]:
            route = _route_around(part, obstacles)
            # A second track has to be clearly longer than those of the source.
            if route is None or route.track.length < 1.3 * longest:
                continue
            name = _new_track(ground, "road", route, ", road: false" if route.is_road else "")
            was = f"{part.area:.4g} m² of connected roads"
            became = f"track '{name}' along their middle, {route.track.length:.4g} m long"
            why = "drivers follow a centre line"
            changes.add(Code.ROAD, f"{world.files[0]}:1", "centre line of the roads", was, became, why)
            longest = route.track.length
    order = sorted(ground.routes, key=lambda name: -ground.routes[name].track.length)
    ground.routes = {name: ground.routes[name] for name in order}
    ground.tracks = {name: ground.tracks[name] for name in order}


def _route_around(area: shapely.Polygon, obstacles: list[shapely.Polygon]) -> Route | None:
    """Return the track along the middle of an area, or of its free part if obstacles block the middle."""
    route = route_in_area(area)
    if route is None or not obstacles:
        return route
    blocked = shapely.union_all([obstacle.buffer(_CLEAR) for obstacle in obstacles])
    # A point each metre is enough for obstacles that are wider than 2 m here.
    s = np.linspace(0.0, route.track.length, max(2, math.ceil(route.track.length)))
    line = shapely.LineString(np.column_stack(route.track.point(s, np.zeros_like(s))))
    if not line.intersects(blocked):
        return route
    # Around the obstacles, else on the largest part between them: with more room around them they divide the road.
    best: Route | None = None
    for room in (_CLEAR, 2.0 * _CLEAR, 4.0 * _CLEAR):
        free = _free_part(area, shapely.union_all([obstacle.buffer(room) for obstacle in obstacles]))
        # An obstacle that divides the road leaves longer forks at the end before it.
        ends = 0.5 if room == _CLEAR else 1.0
        around = route_in_area(free, area, ends=ends) if free is not None else None
        if around is not None and (best is None or around.track.min_radius > best.track.min_radius):
            best = around
        if best is not None and best.track.min_radius > _TURN:
            break
    return best or route


def _free_part(area: shapely.Polygon, blocked: shapely.Geometry) -> shapely.Polygon | None:
    """Return the largest part of an area where a car has room, without slits between blocked parts and the edge."""
    margin = min(_CLEAR, 0.5 * area.area / area.length)
    core = max(shapely.get_parts(shapely.difference(area.buffer(-margin), blocked)), key=shapely.area, default=None)
    if core is None:
        return None
    free = shapely.difference(shapely.intersection(area, core.buffer(margin, join_style="mitre")), blocked)
    parts = [part for part in shapely.get_parts(free) if isinstance(part, shapely.Polygon)]
    return max(parts, key=shapely.area, default=None)


def _new_track(ground: GroundText, wanted: str, route: Route, more: str) -> str:
    name = _new_name(ground, wanted)
    ground.tracks[name] = route.text + more
    ground.routes[name] = route
    return name


# --- text -----------------------------------------------------------------------------------------------------------


def _patches_of(ground: GroundText, surfaces: list[Surface], wanted: str, look: str, mu: float | None) -> int:
    """Add patches for touching surfaces; return their number."""
    for surface in surfaces:
        for polygon in surface.polygons:
            ground.reach = max(ground.reach, *map(abs, polygon.bounds))
    rect = _rect_of(surfaces[0]) if len(surfaces) == 1 else ""
    if rect:
        ground.patches.append(_patch(_new_name(ground, wanted), rect, look, mu))
        return 1
    polygons = [polygon for surface in surfaces for polygon in surface.polygons]
    return _add_polygons(ground, outline(polygons) if len(surfaces) > 1 else polygons, wanted, look, mu)


def _rect_of(surface: Surface) -> str:
    """Return a surface of a single box as a rectangle; "" for others."""
    if surface.box is None:
        return ""
    X = surface.obj.X_WM @ surface.box.X_LG
    R = X.rotation().matrix()
    x, y, _ = X.translation().tolist()
    return _rect((x, y), (surface.box.size[0], surface.box.size[1]), math.atan2(R[1, 0], R[0, 0]))


def _mu(obj: SourceObject) -> float | None:
    return obj.mu if obj.mu is not None and 0.0 < obj.mu <= 2.0 else None


def _surface_of(surface: Surface) -> str | None:
    """Return the kind of surface by the names of model and materials, else by colour."""
    named = _surface(surface.words)
    if named is not None:
        return named
    rgba = next((shape.rgba for shape in surface.obj.visuals if shape.rgba is not None), None)
    if rgba is None:
        return None
    red, green, blue = rgba[:3]
    if green > 1.2 * max(red, blue):
        return "grass"
    if red > 1.3 * blue and red > 0.25:
        return "gravel"
    return "asphalt" if max(red, green, blue) < 0.45 else "concrete"


def _add_polygons(
    ground: GroundText, polygons: list[shapely.Polygon], wanted: str, surface: str, mu: float | None
) -> int:
    for polygon in polygons:
        corners = list(polygon.exterior.coords)[:-1]
        text = f"polygon: [{', '.join(f'[{number(x)}, {number(y)}]' for x, y in corners)}]"
        ground.patches.append(_patch(_new_name(ground, wanted), text, surface, mu))
    return len(polygons)


def _rect(center: tuple[float, float], size: tuple[float, float], yaw: float) -> str:
    # A rectangle is unchanged by half a turn; a quarter turn exchanges its edges.
    yaw = math.remainder(yaw, math.pi)
    a, b = size
    if abs(abs(yaw) - math.pi / 2.0) < 1e-5:
        a, b, yaw = b, a, 0.0
    turned = f", yaw: {degrees(yaw)}" if degrees(yaw) != "0 deg" else ""
    x, y = center
    middle = "" if abs(x) < 5e-5 and abs(y) < 5e-5 else f"center: [{number(x)}, {number(y)}], "
    return f"rect: {{{middle}size: [{number(a)}, {number(b)}]{turned}}}"


def _patch(name: str, area: str, surface: str, mu: float | None) -> str:
    friction = f", mu: {mu:.4g}" if mu is not None else ""
    return f"    - {{name: {name}, {area}, surface: {surface}{friction}}}"


def _new_name(ground: GroundText, wanted: str) -> str:
    """Return a name that YAML reads as text and that no track or patch has."""
    plain = "".join(letter if letter.isascii() and letter.isalnum() else "_" for letter in wanted).strip("_").lower()
    plain = plain if plain[:1].isalpha() and not is_word(plain) else f"patch_{plain}".rstrip("_")
    name, count = plain, 1
    while name in ground.names:
        count += 1
        name = f"{plain}_{count}"
    ground.names.add(name)
    return name


def _surface(words: str) -> str | None:
    """Return the kind of surface that a name means."""
    low = words.lower()
    return next((surface for surface, hints in _WORDS if any(hint in low for hint in hints)), None)


def lowered(X: RigidTransform, height: float) -> RigidTransform:
    """Return a pose lowered by a height [m]; the ground of the new world is at that height of the source."""
    return RigidTransform(X.rotation(), X.translation() - np.array([0.0, 0.0, height]))
