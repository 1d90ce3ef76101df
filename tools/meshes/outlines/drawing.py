"""Regions that most cars have: underbody, side windows, screens, lamps, grilles, shut lines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import shapely
from shapely.geometry.base import BaseGeometry

from tools.meshes.outlines.curves import smooth_line
from tools.meshes.outlines.regions import (
    BELOW,
    FRONT,
    LEFT,
    REAR,
    Region,
    arches,
    outline,
    seen,
    stroke,
)  # fmt: skip

Points = Sequence[Sequence[float]]


@dataclass
class Drawing:
    """Collects regions in the order of drawing; all points in metres in the frame of the body."""

    regions: list[Region] = field(default_factory=list)

    def draw(
        self, material: str | None, view: Sequence[float], shape: BaseGeometry | Points, *, round_by: float = 0.0,
        facing: float = 0.1, only: tuple[str, ...] = ()
    ) -> BaseGeometry:  # fmt: skip
        """Draw a shape, or the polygon through points (in the picture plane), and return it."""
        area = shape if isinstance(shape, BaseGeometry) else outline(shape, round_by)
        self.regions.append(Region(material, view, area, facing, only))
        return area

    def underbody(
        self, sill: Points, *, front: float, rear: float, arch: float = 0.018, trim: str = "cladding"
    ) -> None:
        """Draw the dark underside, and cladding below a line of (x, z), around the wheels and low at both ends."""
        self.draw("dark", BELOW, [(-3, -3), (9, -3), (9, 3), (-3, 3)], facing=0.75)
        if trim:
            line = [tuple(p) for p in sill]
            self.draw(trim, LEFT, [(line[0][0], 0.0), *line, (line[-1][0], 0.0)], facing=0.0)
            self.draw(trim, FRONT, shapely.box(-0.1, 0, 2, front))
            self.draw(trim, REAR, shapely.box(-0.1, 0, 2, rear))
            if arch:
                self.regions.append(arches(trim, arch))

    def side_windows(
        self, belt: Points, rail: Points, panes: Sequence[tuple[float, float, float]], *, frame: float = 0.020,
        frame_material: str = "gloss_black", surround: str = "", back: Points = (), front: Points = ()
    ) -> None:  # fmt: skip
        """Draw the side windows.

        Args:
            belt: lower edge from front to rear, (x, z).
            rail: upper edge from rear to front.
            panes: (rear end, front end, slant) of each pane: its front and rear edges move by ``-slant`` over 0.5 m.
            frame: width of the frame.
            frame_material: of the frame.
            surround: material of a bright line around it, "" for none.
            back: corners between the belt's rear end and the rail's.
            front: corners between the rail's front end and the belt's.
        """
        edge = [*smooth_line(belt, 20), *back, *smooth_line(rail, 24), *front]
        band = outline(edge, 0.012)
        if surround:
            self.draw(surround, LEFT, band.buffer(0.012, join_style="mitre"), facing=0.15)
        self.draw(frame_material, LEFT, band, facing=0.15)
        inner = band.buffer(-frame, join_style="mitre")
        low, high = band.bounds[1], band.bounds[3]
        for rear, ahead, slant in panes:
            shift = slant * (high - low) / 0.5
            box = outline([(rear, low), (ahead, low), (ahead - shift, high), (rear - shift, high)])
            pane = inner.intersection(box).buffer(-0.014, quad_segs=3).buffer(0.014, quad_segs=3).simplify(4e-4)
            self.draw("glass", LEFT, pane, facing=0.15)

    def screen(self, view: Sequence[float], edge: Points, *, border: float = 0.028, facing: float = 0.12) -> None:
        """Draw a windscreen or rear window from its left outline (y, z), with a black border."""
        shape = self.draw("gloss_black", view, edge, facing=facing)
        low, high = shape.bounds[1], shape.bounds[3]
        self.draw("glass", view, shape.buffer(-border).intersection(shapely.box(-0.05, low, 2, high)), facing=facing)

    def lamp(self, view: Sequence[float], corners: Points, layers: Sequence[tuple[str, float]], *,
             round_by: float = 0.01,
             facing: float = 0.12) -> BaseGeometry:  # fmt: skip
        """Draw a lamp whose outline goes through points of space; layers are (material, inset); return its outline."""
        shape = outline(seen(view, corners), round_by)
        for material, inset in layers:
            self.draw(material, view, shape.buffer(-inset) if inset else shape, facing=facing)
        return shape

    def bars(self, view: Sequence[float], within: BaseGeometry, heights: Sequence[float], *, thick: float,
             material: str, facing: float = 0.1) -> None:  # fmt: skip
        """Draw level bars within a shape."""
        for z in heights:
            bar = shapely.box(-3, z - thick / 2, 3, z + thick / 2).intersection(within)
            self.draw(material, view, bar, facing=facing)

    def gaps(self, view: Sequence[float], lines: Sequence[Points], *, width: float = 0.0065) -> None:
        """Draw shut lines on the paint."""
        for line in lines:
            self.draw("gap", view, stroke(line, width), facing=0.25, only=("paint",))

    def result(self) -> tuple[Region, ...]:
        """Return the drawn regions."""
        return tuple(self.regions)
