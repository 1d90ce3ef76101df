"""YAML text and import report of the new world."""

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np

from mirdrake.importing.changes import TABLE_HEAD, Change, rows_by_file, table_cell
from mirdrake.importing.places import Places
from mirdrake.importing.worlds.entry import Entry, degrees, number
from mirdrake.importing.worlds.ground import GroundText
from mirdrake.importing.worlds.model import Sun


def world_text(
    name: str,
    *,
    source: str,
    ground: GroundText,
    suns: Sequence[Sun],
    starts: Mapping[str, str],
    entries: Sequence[Entry],
    scenery: Sequence[str],
    overlaps: Sequence[tuple[str, str]],
    heights: Mapping[str, float],
) -> str:
    """Return the YAML text of a world.

    Args:
        name: name of the world.
        source: origin, for the first line.
        ground: base plane and patches.
        suns: the first one is used.
        starts: name -> its keys; the first one is that of a run which names none.
        entries: its objects.
        scenery: keys of meshes that are visual only.
        overlaps: pairs of props that overlap in the source.
        heights: name of a prop -> how far it is off the ground in the source [m].
    """
    lines = [
        f"# Imported from {_plain(source)}; {name}.md lists what was changed or left out.",
        "mirdrake: world/1",
        f"name: {name}",
        "",
    ]
    # Keys are in the order of a world file written by hand.
    parts = [f"surface: {ground.surface}"]
    if ground.mu is not None:
        parts.append(f"mu: {ground.mu:.4g}")
    if ground.size is not None:
        parts.append(f"size: [{number(ground.size[0])}, {number(ground.size[1])}]")
    if ground.patches:
        lines += ["ground:", *(f"  {part}" for part in parts), "  patches:", *ground.patches]
    else:
        # A short ground fits on one line, as a person would write it.
        lines.append(f"ground: {{{', '.join(parts)}}}")
    if ground.tracks:
        lines += ["", "tracks:", *(f"  {track}: {{{keys}}}" for track, keys in ground.tracks.items())]
    if suns:
        # A light shines along its direction, but a sun is described by where it is: the opposite signs.
        d = suns[0].direction / np.linalg.norm(suns[0].direction)
        azimuth, elevation = math.atan2(-d[1], -d[0]), math.asin(float(np.clip(-d[2], -1.0, 1.0)))
        lines += ["", f"lights: {{sun: {{azimuth: {degrees(azimuth)}, elevation: {degrees(elevation)}}}}}"]
    if starts:
        lines += ["", "start:"]
        lines += [f"  {start}: {{{keys}}}" for start, keys in starts.items()]
    if entries:
        lines += ["", "props:", *(entry.text() for entry in entries)]
    if scenery:
        lines += ["", "scenery:", *(f"  - {{{keys}}}" for keys in scenery)]
    # Gazebo accepts overlaps; the checks of a world need a rule for each to accept it.
    if overlaps or heights:
        lines += ["", "rules:  # objects that overlap, float or are buried in the source"]
        lines += [
            f"  - {{on_ground: {{props: {_pattern(a)}, tolerance: {number(gap)}}}}}" for a, gap in heights.items()
        ]
        lines += [f"  - {{allow_overlap: [{_pattern(a)}, {_pattern(b)}]}}" for a, b in overlaps]
    return "\n".join(lines) + "\n"


def _pattern(name: str) -> str:
    # An asterisk without quotes would be an alias of YAML.
    return f'"{name}"' if "*" in name else name


def report_text(
    name: str,
    *,
    files: Iterable[Path],
    entries: Sequence[Entry],
    changes: Sequence[Change],
    places: Places,
    checks: Sequence[str],
) -> str:
    """Return the import report.

    Args:
        name: name of the world.
        files: files of the source.
        entries: objects of the new world.
        changes: changes with short places.
        places: short names of files.
        checks: sentences on what the user should check.
    """
    lines = [
        f"# Import of {name}",
        "",
        "Source files: " + ", ".join(f"`{places.file(path)}`" for path in files) + ".",
        "",
    ]
    # What the user should check comes first; the complete list of changes is long.
    if checks:
        lines += ["## Please check", "", *(f"- {table_cell(check)}" for check in checks), ""]
    if entries:
        lines += [
            "## Objects",
            "",
            "| in the source | line | in the world | as |",
            "| --- | --- | --- | --- |",
        ]
        for entry in entries:
            key, value = entry.what
            part = (
                f"{key} {value}" if isinstance(value, str) else f"{key} {' x '.join(number(side) for side in value)} m"
            )
            names = [entry.obj.name, *entry.others]
            source = names[0] if len(names) == 1 else f"{names[0]} … {names[-1]} ({len(names)})"
            element = entry.name + ("[]" if entry.layout else "")
            row = (source, places.short(entry.obj.where), element, part)
            lines.append("| " + " | ".join(map(table_cell, row)) + " |")
        lines.append("")
    lines += ["## Changes", ""]
    if not changes:
        lines += ["Nothing.", ""]
    # Rows are grouped by source file, because a world includes many models with the same fault.
    for file, rows in rows_by_file(changes, merge=True):
        lines += [
            f"### {table_cell(file) or 'No place in the source'}",
            "",
            *TABLE_HEAD,
            *(row.text for row in rows),
            "",
        ]
    return "\n".join(lines)


def _plain(text: str) -> str:
    return re.sub(r"[\x00-\x1f]", " ", text)
