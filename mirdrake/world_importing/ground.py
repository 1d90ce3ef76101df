"""The ground of the new world: planes, floors and roads of the source as base plane and patches."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import shapely
from pydrake.math import RigidTransform

from mirdrake.vehicles.importing.mesh_read import MeshError
from mirdrake.vehicles.importing.model import Change, Shape
from mirdrake.world_importing.entry import degrees, is_word, number
from mirdrake.world_importing.model import Array, Plane, SourceWorld, Thing
from mirdrake.world_importing.prop_folder import as_mesh
from mirdrake.world_importing.surfaces import FLAT, corners_of, outline, seen_from_above

_WORDS = (
    ("asphalt", ("asphalt", "road", "street", "racetrack", "tarmac")), ("grass", ("grass", "lawn", "field")),
    ("gravel", ("gravel", "dirt", "sand", "mud", "soil")), ("ice", ("ice", "snow")),
    ("concrete", ("concrete", "floor", "pavement", "sidewalk", "cement", "tile", "ground", "grey", "gray", "plane")),
)  # fmt: skip
_LEVEL = 1e-3  # [rad] tilt of what counts as level
_SMALLEST_FLOOR = 1.0  # [m²]
_WIDEST = 1e5  # [m] ground
_UNEVEN = 0.5  # [m] between the highest and the lowest point of roads that lie on level ground


@dataclass
class GroundText:
    """What the new world says of its ground.

    Attributes:
        surface, mu, size: of the base plane.
        patches: their entries, in order.
        height: of the base plane in W of the source [m]; the new W is that much higher.
    """

    surface: str = "concrete"
    mu: float | None = None
    size: tuple[float, float] | None = None
    patches: list[str] = field(default_factory=list)
    height: float = 0.0


def make_ground(world: SourceWorld, say: Callable[[Change], None]) -> GroundText:
    """The ground; floors are taken out of the world's things.

    Args:
        world: its `things` lose what becomes ground.
        say: called with every change.
    """
    ground = GroundText()
    level = []
    for plane in world.planes:
        tilt = math.acos(float(np.clip(plane.X_WP.rotation().matrix()[2, 2], -1.0, 1.0)))
        if tilt > _LEVEL:
            why = "the ground is level; a slope of the whole world is ground.slope"
            say(
                Change(plane.where, f"plane '{plane.name}'", f"tilted by {math.degrees(tilt):.4g} deg", "left out", why)
            )
        else:
            level.append(plane)
    floors = [floor for thing in world.things if (floor := _floor(thing)) is not None]
    if level:
        base = max(level, key=lambda plane: math.prod(plane.size or (1e6, 1e6)))
        ground.height = _height(float(base.X_WP.translation()[2]))
        _take_base(ground, base, say)
        for plane in level:
            if plane is not base:
                _patch_of_plane(ground, plane, base, say)
    elif floors:
        largest = max(floors, key=lambda floor: floor.area)
        if largest.area > 20.0 * _SMALLEST_FLOOR:
            ground.height = _height(largest.top)
            _take_floor(ground, largest, say)
            floors.remove(largest)
            world.things.remove(largest.thing)
    elif world.roads and np.ptp(heights := np.concatenate([road.points[:, 2] for road in world.roads])) < _UNEVEN:
        ground.height = _height(float(np.median(heights)))
        was = f"none; roads at z = {np.median(heights):.4g} m"
        say(Change(world.roads[0].where, "ground", was, f"ground of {ground.surface}", "a world has a base plane"))
    else:
        where = str(world.files[0]) + ":1"
        say(Change(where, "ground", "none", f"{ground.surface} at z = 0", "a world has one"))
    for floor in floors:
        if abs(floor.top - ground.height) <= FLAT / 2.0 or (
            floor.thickness <= FLAT and abs(floor.top - ground.height) <= FLAT
        ):
            world.things.remove(floor.thing)
            _patch_of_floor(ground, floor, say)
    for road in world.roads:
        line = shapely.LineString(road.points[:, :2])
        areas = outline([line.buffer(road.width / 2.0, cap_style="flat", join_style="mitre", mitre_limit=2.0)])
        surface = _surface(road.words) or "asphalt"
        _add_polygons(ground, areas, road.name, surface, None)
        heights = road.points[:, 2] - ground.height
        lifted = f", up to {np.abs(heights).max():.3g} m off the ground" if np.abs(heights).max() > FLAT else ""
        was = f"{len(road.points)} points, {road.width:g} m wide{lifted}"
        became = f"{len(areas)} patch{'es' if len(areas) != 1 else ''} of {surface}"
        why = "a line of points is no track: curvature would jump"
        say(Change(road.where, f"road '{road.name}'", was, became, why))
    if abs(ground.height) > 1e-4:
        where = level[0].where if level else f"{world.files[0]}:1"
        became = f"z = 0, everything {abs(ground.height):.4g} m {'lower' if ground.height > 0.0 else 'higher'}"
        say(Change(where, "height of the ground", f"z = {ground.height:.4g} m", became, "the ground is at z = 0"))
    return ground


def _height(height: float) -> float:
    """The height of a base plane [m]; one that is hardly off zero is left where it is."""
    return 0.0 if abs(height) <= FLAT / 2.0 else height


def _take_floor(ground: GroundText, floor: "_Floor", say: Callable[[Change], None]) -> None:
    """The largest floor as the base plane of a world without one; a patch if it is no level rectangle."""
    thing = floor.thing
    ground.surface = _surface(floor.words) or "concrete"
    was = f"no plane, but a floor of {floor.area:.4g} m² at z = {floor.top:.4g} m"
    if floor.rect and "yaw" not in floor.rect:
        reach = np.abs(np.concatenate([np.array(polygon.exterior.coords) for polygon in floor.polygons])).max(axis=0)
        ground.size = (round(2.0 * float(reach[0]), 2), round(2.0 * float(reach[1]), 2))
        ground.mu = thing.mu if thing.mu is not None and 0.0 < thing.mu <= 2.0 else None
        became = f"ground of {ground.surface}, {ground.size[0]:g} m x {ground.size[1]:g} m"
        say(Change(thing.where, f"model '{thing.name}'", was, became, "a world has a base plane"))
        return
    say(Change(thing.where, "ground", was, f"ground of {ground.surface}", "a world has a base plane"))
    _patch_of_floor(ground, floor, say)


def _take_base(ground: GroundText, plane: Plane, say: Callable[[Change], None]) -> None:
    ground.surface = _surface(plane.words) or "concrete"
    became = f"ground of {ground.surface}"
    x, y, _ = plane.X_WP.translation().tolist()
    if plane.size is not None and 2.0 * np.abs(_rectangle(plane)).max() <= _WIDEST:
        reach = np.abs(_rectangle(plane)).max(axis=0)
        ground.size = (round(2.0 * float(reach[0]), 2), round(2.0 * float(reach[1]), 2))
        became += f", {ground.size[0]:g} m x {ground.size[1]:g} m"
    was = f"plane at {x:.4g} {y:.4g}, mu {'as it is' if plane.mu is None else f'{plane.mu:g}'}"
    if plane.mu is not None and 0.0 < plane.mu <= 2.0:
        ground.mu = plane.mu
        became += f", mu {plane.mu:g}"
        why = "the base plane"
    elif plane.mu is not None:
        why = f"the base plane; a mu of {plane.mu:g} stands for no slip, that of the surface is taken"
    else:
        why = "the base plane; mu is that of the surface"
    say(Change(plane.where, f"plane '{plane.name}'", was, became, why))


def _rectangle(plane: Plane) -> Array:
    """Corners of a plane seen from above (4, 2) [m]."""
    a, b = plane.size or (1.0, 1.0)
    corners = 0.5 * np.array([[a, b, 0.0], [-a, b, 0.0], [-a, -b, 0.0], [a, -b, 0.0]])
    seen: Array = (corners @ plane.X_WP.rotation().matrix().T + plane.X_WP.translation())[:, :2]
    return seen


def _patch_of_plane(ground: GroundText, plane: Plane, base: Plane, say: Callable[[Change], None]) -> None:
    height = float(plane.X_WP.translation()[2]) - ground.height
    what, was = f"plane '{plane.name}'", f"plane {height:.4g} m over the ground"
    if plane.size is None or abs(height) > FLAT:
        say(Change(plane.where, what, was, "left out", f"'{base.name}' is the ground already"))
        return
    surface = _surface(plane.words) or ground.surface
    mu = plane.mu if plane.mu is not None and 0.0 < plane.mu <= 2.0 else None
    name = _patch_name(ground, plane.name)
    x, y, _ = plane.X_WP.translation().tolist()
    R = plane.X_WP.rotation().matrix()
    rect = _rect((x, y), plane.size, math.atan2(R[1, 0], R[0, 0]))
    ground.patches.append(_patch(name, rect, surface, mu))
    say(Change(plane.where, what, was, f"patch '{name}' of {surface}", f"'{base.name}' is the ground"))


@dataclass
class _Floor:
    """A level thing: its outlines seen from above, and how it lies [m]."""

    thing: Thing
    polygons: list[shapely.Polygon]
    rect: str
    area: float
    top: float
    thickness: float
    words: str


def _floor(thing: Thing) -> _Floor | None:
    """A static thing as a floor; None if it is none."""
    if not thing.static or not thing.collisions or thing.broken:
        return None
    polygons: list[shapely.Polygon] = []
    tops, bottoms, rect = [], [], ""
    for shape in thing.collisions:
        X = thing.X_WM @ shape.X_LG
        try:
            corners = _corners(shape) @ X.rotation().matrix().T + X.translation()
        except MeshError:
            return None
        low, high = corners[:, :, 2].min(), corners[:, :, 2].max()
        level = abs(float(X.rotation().matrix()[2, 2])) > 1.0 - 0.5 * _LEVEL**2
        if high - low > (0.5 if shape.kind == "box" and level else FLAT):
            return None
        tops.append(float(high))
        bottoms.append(float(low))
        polygons += seen_from_above(corners)
        if shape.kind == "box" and level:
            R = X.rotation().matrix()
            x, y, _ = X.translation().tolist()
            rect = _rect((x, y), (shape.size[0], shape.size[1]), math.atan2(R[1, 0], R[0, 0]))
    if max(tops) - min(tops) > FLAT:
        return None
    merged = outline(polygons) if polygons else []
    area = sum(polygon.area for polygon in merged)
    thickness = max(tops) - min(bottoms)
    if area < _SMALLEST_FLOOR or thickness > 0.1 * math.sqrt(area):
        return None
    words = " ".join([thing.name, thing.kind, *(shape.address for shape in thing.visuals)])
    return _Floor(thing, merged, rect if len(thing.collisions) == 1 else "", area, max(tops), thickness, words)


def _corners(shape: Shape) -> Array:
    if shape.kind == "mesh":
        moved = corners_of(shape)
        back: Array = (moved - shape.X_LG.translation()) @ shape.X_LG.rotation().matrix()
        return back
    mesh = as_mesh(shape)
    corners: Array = np.asarray(mesh.vertices, dtype=float)[np.asarray(mesh.faces)]
    return corners


def _patch_of_floor(ground: GroundText, floor: _Floor, say: Callable[[Change], None]) -> None:
    thing = floor.thing
    surface = _surface(floor.words) or ground.surface
    mu = thing.mu if thing.mu is not None and 0.0 < thing.mu <= 2.0 else None
    if floor.rect:
        name = _patch_name(ground, thing.name)
        ground.patches.append(_patch(name, floor.rect, surface, mu))
        became = f"patch '{name}' of {surface}"
    else:
        count = _add_polygons(ground, floor.polygons, thing.name, surface, mu)
        became = f"{count} patch{'es' if count != 1 else ''} of {surface}"
    was = f"level, {floor.thickness:.3g} m thick, {floor.area:.4g} m²"
    say(Change(thing.where, f"model '{thing.name}'", was, became, "what lies level on the ground is a part of it"))


def _add_polygons(
    ground: GroundText, polygons: list[shapely.Polygon], wanted: str, surface: str, mu: float | None
) -> int:
    for polygon in polygons:
        corners = list(polygon.exterior.coords)[:-1]
        text = f"polygon: [{', '.join(f'[{number(x)}, {number(y)}]' for x, y in corners)}]"
        ground.patches.append(_patch(_patch_name(ground, wanted), text, surface, mu))
    return len(polygons)


def _rect(center: tuple[float, float], size: tuple[float, float], yaw: float) -> str:
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


def _patch_name(ground: GroundText, wanted: str) -> str:
    plain = "".join(letter if letter.isascii() and letter.isalnum() else "_" for letter in wanted).strip("_").lower()
    plain = plain if plain[:1].isalpha() and not is_word(plain) else f"patch_{plain}".rstrip("_")
    taken = {patch.split("name: ")[1].split(",")[0] for patch in ground.patches}
    name, count = plain, 1
    while name in taken:
        count += 1
        name = f"{plain}_{count}"
    return name


def _surface(words: str) -> str | None:
    """The surface that names of models and materials speak of."""
    low = words.lower()
    return next((surface for surface, hints in _WORDS if any(hint in low for hint in hints)), None)


def lowered(X: RigidTransform, height: float) -> RigidTransform:
    """A pose in the new world, whose ground is at the height [m] that is given."""
    return RigidTransform(X.rotation(), X.translation() - np.array([0.0, 0.0, height]))
