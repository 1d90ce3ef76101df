"""Props and groups that can be dropped on the map, with their outlines from above."""

from pathlib import Path

from mirdrake.core.errors import MirdrakeError
from mirdrake.core.json_io import Json
from mirdrake.core.paths import data_root
from mirdrake.editor.picture import path_of
from mirdrake.worlds.loading import parse_world

_ONE = "mirdrake: world/1\nprops:\n  - {{{kind}: {name}, at: [0, 0]}}\n"


def palette(folder: Path) -> list[Json]:
    """Return props and groups with their outlines; those that cannot be placed alone are left out.

    Args:
        folder: folder of the world file.
    """
    props = sorted(path.parent.name for path in (data_root() / "models" / "props").glob("*/prop.yaml"))
    groups = sorted(path.stem for path in (data_root() / "worlds" / "groups").glob("*.yaml"))
    entries = []
    for kind, names in (("prop", props), ("group", groups)):
        for name in names:
            try:
                world = parse_world(_ONE.format(kind=kind, name=name), folder / "palette.yaml")
            except MirdrakeError:
                continue
            boxes = [placed.footprint.bounds for placed in world.props]
            if boxes:
                low = [min(box[side] for box in boxes) for side in (0, 1)]
                high = [max(box[side] for box in boxes) for side in (2, 3)]
                paths = [path_of(placed.footprint) for placed in world.props]
                kinds = [placed.prop.name for placed in world.props]
                entries.append({"what": kind, "name": name, "box": [*low, *high], "paths": paths, "kinds": kinds})
    return entries
