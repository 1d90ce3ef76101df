"""Placed props of the new world: their extent and their overlaps."""

from pathlib import Path

import numpy as np
import shapely

from mirdrake.importing.worlds.entry import Entry
from mirdrake.worlds.props import PlacedProp, Prop, load_prop, make_primitive

_TOUCH = 1e-3  # [m] that footprints must run into each other to overlap


def place(entries: list[Entry], folder: Path) -> list[PlacedProp]:
    """Return the props of single entries in order; files are relative to `folder`.

    Raises:
        ConfigError: one of them cannot be loaded.
    """
    known: dict[object, Prop] = {}
    done = []
    for entry in entries:
        if entry.layout:
            continue
        key = (entry.what, entry.size, entry.scale)
        if key not in known:
            known[key] = _prop(entry, folder)
        done.append(PlacedProp(entry.name, known[key], entry.X_WP, entry.static))
    return done


def _prop(entry: Entry, folder: Path) -> Prop:
    kind, value = entry.what
    if isinstance(value, str):
        size = None if entry.size is None else (entry.size[0], entry.size[1], entry.size[2])
        return (
            load_prop(f"{(folder / value).resolve()}/")
            if kind == "file"
            else load_prop(value, size=size, scale=entry.scale)
        )
    return make_primitive(kind, value)


def reach(props: list[PlacedProp]) -> float:
    """Return the largest distance of props from the origin along x or y [m]."""
    return max((float(np.abs(prop.footprint.bounds).max()) for prop in props), default=0.0)


def find_overlaps(props: list[PlacedProp]) -> list[tuple[str, str]]:
    """Return the names of props that overlap in the plan view and in height, in order."""
    if not props:
        return []
    prints = [prop.footprint.buffer(-_TOUCH / 2.0) for prop in props]
    # Footprints are shrunk by the tolerance, so that touching props do not overlap.
    tree = shapely.STRtree(prints)
    first, second = tree.query(prints, predicate="intersects")
    return [
        (props[i].name, props[j].name)
        for i, j in sorted(zip(first.tolist(), second.tolist(), strict=True))
        if i < j and props[i].bottom < props[j].top - _TOUCH and props[j].bottom < props[i].top - _TOUCH
    ]
