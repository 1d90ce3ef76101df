"""Props, groups and actors that can be dropped on the map, with pictures drawn from their meshes.

What draws is imported when a picture is drawn: they are kept, and most editors open without drawing any.
"""

import io
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from mirdrake.core.digest import digest
from mirdrake.core.errors import MirdrakeError
from mirdrake.core.files import write_file
from mirdrake.core.paths import cache_folder, data_root
from mirdrake.worlds.loading import make_world
from mirdrake.worlds.props import PlacedProp, Prop, prop_names
from mirdrake.worlds.world import World

Array = NDArray[np.float64]

ACTORS = ("pedestrian", "cyclist", "sedan", "van")
"""Props that are offered as actors; a file may use any other."""

_SIZE = (112, 80)  # [pixel] of a picture, twice its size on the page
_AZIMUTH, _ELEVATION = np.radians(-38.0), np.radians(24.0)  # of the viewer: from the front right, above
_LIGHT = np.array([0.35, -0.30, 0.89])  # towards the sun, in W
_MARGIN = 1.06
_GREY = (0.62, 0.66, 0.70)
_VERSION = b"2"  # of the pictures in the cache of the user


def palette(world: World) -> list[dict[str, str]]:
    """Return kind and name of everything that can be dropped on the map of a world."""
    shipped = sorted(path.stem for path in (data_root() / "worlds" / "groups").glob("*.yaml"))
    props = prop_names()
    return [
        *({"what": "prop", "name": name} for name in props),
        *({"what": "actor", "name": name} for name in ACTORS if name in props),
        *({"what": "group", "name": name} for name in dict.fromkeys([*world.spec.groups, *shipped])),
    ]


def picture(what: str, name: str, data: Mapping[str, Any], path: Path) -> bytes | None:
    """Return the picture of a prop, group or actor as PNG; None if it cannot be placed alone.

    Args:
        what: prop, group or actor.
        name: its name.
        data: the world file, which may have groups of its own.
        path: its path.
    """
    definitions = {key: data[key] for key in ("params", "groups", "include") if key in data}
    entry = {"group" if what == "group" else "prop": name, "at": [0, 0]}
    try:
        placed = make_world({"mirdrake": "world/1", **definitions, "props": [entry]}, path=path).props
    except MirdrakeError:
        return None
    if not placed:
        return None
    # Pictures are kept for all worlds, as long as the props and their places are the same.
    content = [repr((_stamp(prop.prop), prop.X_WP.GetAsMatrix34().round(6).tolist())) for prop in placed]
    file = cache_folder("palette") / f"{digest(_VERSION + repr(content).encode())[:32]}.png"
    if file.is_file():
        return file.read_bytes()
    drawn = _draw(placed)
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        write_file(file, drawn)
    except (MirdrakeError, OSError):  # a cache that cannot be written only costs time
        pass
    return drawn


def _draw(placed: Sequence[PlacedProp]) -> bytes:
    """Return a three-quarter view."""
    from mirdrake.viewer.raster import draw_triangles

    cos_a, sin_a, cos_e, sin_e = np.cos(_AZIMUTH), np.sin(_AZIMUTH), np.cos(_ELEVATION), np.sin(_ELEVATION)
    # Rows: to the right, up, and towards the viewer.
    rotation = np.array([
        [-sin_a, cos_a, 0.0], [-sin_e * cos_a, -sin_e * sin_a, cos_e], [cos_e * cos_a, cos_e * sin_a, sin_e],
    ])  # fmt: skip
    parts = [part for prop in placed for part in _placed_triangles(prop)]
    triangles = np.concatenate([triangles for triangles, _ in parts]) @ rotation.T
    low, high = triangles[:, :, :2].min(axis=(0, 1)), triangles[:, :, :2].max(axis=(0, 1))
    # The whole of it in the middle of the picture.
    middle, width = 0.5 * (low + high), max(high[0] - low[0], (high[1] - low[1]) * _SIZE[0] / _SIZE[1]) * _MARGIN
    half = 0.5 * width * np.array([1.0, _SIZE[1] / _SIZE[0]])
    box = (*(middle - half).tolist(), *(middle + half).tolist())
    drawing = draw_triangles(
        triangles, np.concatenate([colours for _, colours in parts]), light=rotation @ _LIGHT, box=box, width=_SIZE[0]
    )
    file = io.BytesIO()
    # 64 colours are enough for a small picture, and a third of the bytes.
    drawing.quantize(64, method=Image.Quantize.FASTOCTREE).save(file, "PNG", optimize=True)
    return file.getvalue()


def _placed_triangles(placed: PlacedProp) -> Iterator[tuple[Array, Array]]:
    R, p = placed.X_WP.rotation().matrix(), placed.X_WP.translation()
    for triangles, colours in _triangles(placed.prop):
        yield triangles @ R.T + p, colours


@lru_cache(maxsize=32)
def _triangles(prop: Prop) -> list[tuple[Array, Array]]:
    """Return corners (n, 3, 3) in P [m] and colours (n, 3) of a prop: of its mesh, else of its solids."""
    import trimesh

    from mirdrake.viewer.raster import read_triangles

    parts = read_triangles(prop.visual, _GREY) if prop.visual is not None else []
    if parts:
        return [((points * prop.scale)[faces], colours) for points, faces, colours in parts]
    hulls = [trimesh.convex.convex_hull(solid.corners) for solid in prop.solids]
    return [(np.asarray(hull.triangles), np.tile(_GREY, (len(hull.faces), 1))) for hull in hulls]


def _stamp(prop: Prop) -> tuple[object, ...]:
    mesh = None if prop.visual is None else digest(prop.visual.read_bytes())
    return prop.name, prop.size, prop.scale, mesh
