"""Entries of the new world before they become text."""

from dataclasses import dataclass, field

import numpy as np
from pydrake.math import RigidTransform, RollPitchYaw

from mirdrake.importing.worlds.known import plain_name
from mirdrake.importing.worlds.model import SourceObject

NEAR = 5e-5
"""Half of the last digit that is written [m]."""


@dataclass
class Entry:
    """One entry of ``props``.

    Attributes:
        what: its first key and value: prop, box, cylinder, sphere or file.
        name: unique in the world.
        X_WP: pose of its frame P, on the ground below its middle.
        obj: object of the source.
        layout: text of a layout; "" for ``at``.
        size, scale, color, static, mass: as in a world file.
    """

    what: tuple[str, str | tuple[float, ...]]
    name: str
    X_WP: RigidTransform
    obj: SourceObject
    layout: str = ""
    size: tuple[float, ...] | None = None
    scale: float = 1.0
    color: tuple[float, float, float] | None = None
    static: bool = True
    mass: float | None = None
    others: list[str] = field(default_factory=list)
    """names in the source of the objects of a grid after the first"""

    def text(self) -> str:
        """Return the entry in YAML's flow style."""
        key, value = self.what
        parts = [f"{key}: {value if isinstance(value, str) else _value(value)}", f"name: {self.name}"]
        x, y, z = (number(value) for value in self.X_WP.translation())
        roll, pitch, yaw = (degrees(angle) for angle in RollPitchYaw(self.X_WP.rotation()).vector())
        # A layout states its own positions.
        if self.layout:
            parts += [self.layout, *([f"z: {z}"] if z != "0" else [])]
        else:
            parts.append(f"at: [{x}, {y}{f', {z}' if z != '0' else ''}]")
        turned = (("yaw", yaw), ("pitch", pitch), ("roll", roll))
        parts += [f"{word}: {angle}" for word, angle in turned if angle != "0 deg"]
        if self.size is not None:
            parts.append(f"size: {_value(self.size)}")
        if self.scale != 1.0:
            parts.append(f"scale: {number(self.scale)}")
        if self.color is not None:
            parts.append(f"color: [{', '.join(f'{part:.3g}' for part in self.color)}]")
        if not self.static:
            parts.append("static: false")
            if self.mass is not None:
                parts.append(f"mass: {self.mass:.6g}")
        return f"  - {{{', '.join(parts)}}}"

    def look(self) -> tuple[object, ...]:
        """Return the properties that entries of one grid share."""
        angles = tuple(degrees(angle) for angle in RollPitchYaw(self.X_WP.rotation()).vector())
        height = number(self.X_WP.translation()[2])
        return (self.what, angles, height, self.size, self.scale, self.color, self.static, self.mass, self.layout)


def number(value: float) -> str:
    """Return a length rounded to 0.1 mm as short text."""
    text = f"{round(float(value), 4) + 0.0:.4f}".rstrip("0").rstrip(".")
    return "0" if text in {"-0", ""} else text


def degrees(angle: float) -> str:
    """Return an angle in degrees rounded to 1e-4 as text."""
    value = float(np.degrees(angle))
    # An angle from rounded radians, such as 89.9998 deg, is written as a whole number.
    value = value if abs(value - round(value)) > 0.0005 else float(round(value))
    text = number(value)
    return "180 deg" if text == "-180" else f"{text} deg"


def _value(values: tuple[float, ...]) -> str:
    return number(values[0]) if len(values) == 1 else f"[{', '.join(number(value) for value in values)}]"


def into_grids(entries: list[Entry]) -> list[Entry]:
    """Return entries with full rows and columns merged into grids, in the order of their first entries."""
    groups: dict[tuple[object, ...], list[Entry]] = {}
    for entry in entries:
        groups.setdefault(entry.look(), []).append(entry)
    done: list[Entry] = []
    for group in groups.values():
        grid = _grid(group) if len(group) >= 3 and not group[0].layout else None
        done += [grid] if grid is not None else group
    return done


def _grid(group: list[Entry]) -> Entry | None:
    # A grid is full: as many entries as rows times columns, with equal steps.
    places = np.array([np.round(entry.X_WP.translation()[:2], 4) for entry in group])
    xs, ys = (np.unique(places[:, axis]) for axis in (0, 1))
    # Counts alone would also fit objects at the same place.
    if len(xs) * len(ys) != len(group) or len(np.unique(places, axis=0)) != len(group):
        return None
    steps = []
    for line in (xs, ys):
        gaps = np.diff(line)
        if len(gaps) and float(np.ptp(gaps)) > 1e-4:
            return None
        step = round(float((line[-1] - line[0]) / len(gaps)), 4) if len(gaps) else 0.0
        # The rounded step must still lead to the last object.
        if len(gaps) and abs(line[0] + step * len(gaps) - line[-1]) > NEAR:
            return None
        steps.append(step)
    # A grid begins at its lowest y and x.
    first = min(group, key=lambda entry: tuple(entry.X_WP.translation()[[1, 0]]))
    first.others = [entry.obj.name for entry in group if entry is not first]
    step_text = f"[{number(steps[0])}, {number(steps[1])}]"
    origin = f"[{number(xs[0])}, {number(ys[0])}]"
    first.name = next((entry.name for entry in group if entry.name == plain_name(entry.obj.kind)), first.name)
    first.layout = f"grid: {{origin: {origin}, step: {step_text}, count: [{len(xs)}, {len(ys)}]}}"
    return first
