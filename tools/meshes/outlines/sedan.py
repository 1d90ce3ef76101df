"""Outline of a four-door sedan of no maker, drawn in its usual size and fitted to another one."""

from __future__ import annotations

from dataclasses import dataclass

import shapely

from tools.meshes.outlines.car import CarOutline, Warp, arch_clearance
from tools.meshes.outlines.curves import Array, curve
from tools.meshes.outlines.drawing import Drawing
from tools.meshes.outlines.parts import Part
from tools.meshes.outlines.regions import FRONT, FRONT_LEFT, LEFT, REAR, REAR_LEFT, Region
from tools.meshes.outlines.shell import Form, Skin
from tools.meshes.outlines.solids import pillow, rot_z
from tools.meshes.outlines.wheels import FAN_SPOKES, Rim, WheelDesign

STEERING = 0.65
"""Largest angle of a front wheel that the wheel openings leave room for [rad]."""


@dataclass(frozen=True)
class Style:
    """A car drawn in its usual size: its form, regions, parts and rim, and the sizes :func:`fit` starts from.

    Attributes:
        form: the skin; regions: what is drawn on it; parts: small solids; rim: of the wheels.
        wheelbase: as drawn [m].
        shoulder: height of the wings above the wheels as drawn [m]; wheel openings stay below it.
        profile: rim radius over tyre radius.
    """

    form: Form
    regions: tuple[Region, ...]
    parts: tuple[Part, ...]
    rim: Rim
    wheelbase: float
    shoulder: float
    profile: float

    @property
    def skin(self) -> Skin:
        """The surface, without swellings around the wheels: they would not fit wheels of another size."""
        return Skin(self.form, (), 0.0)


def _side_parts(mirror: tuple[float, float, float], handles: tuple[tuple[float, float], ...]) -> tuple[Part, ...]:
    """Door mirror at a place, handles at places (x, z), of the left side."""
    x, y, z = mirror
    parts = [
        Part(pillow("paint", (0.13, 0.19, 0.13), 0.6, (16, 11)), (x, y, z), rot_z(-0.18), pair=True),
        Part(pillow("gloss_black", (0.10, 0.20, 0.035), 0.5, (10, 5)), (x + 0.02, y - 0.07, z - 0.055), pair=True),
        Part(pillow("glass", (0.02, 0.155, 0.10), 0.5, (12, 5)), (x - 0.064, y - 0.01, z), rot_z(-0.18), pair=True),
    ]
    for x, z in handles:
        handle = pillow("paint", (0.20, 0.034, 0.026), 0.5, (12, 7))
        parts.append(Part(handle, (x, 0.3, z), on=LEFT, shift=(0, 0.010, 0.006), pair=True))
    return tuple(parts)


_INSET = (
    (0.10, 0.11), (0.20, 0.048), (0.27, 0.022), (0.46, 0.020), (0.60, 0.014), (0.72, 0.004), (0.80, 0.000),
    (0.88, 0.010), (1.00, 0.045), (1.15, 0.10),
)  # fmt: skip


def sedan() -> Style:
    """Return a four-door sedan: 4.75 m long, 1.82 m wide, 1.45 m high, wheelbase 2.75 m."""
    form = Form(
        plan=curve((-1.10, 0.80), (-0.8, 0.862), (-0.4, 0.900), (0.2, 0.910), (2.4, 0.910), (2.8, 0.908), (3.05, 0.895),
                   (3.3, 0.855), (3.52, 0.785), (3.72, 0.68)),
        side_inset=curve(*_INSET),
        nose=curve((0.12, 3.54), (0.20, 3.620), (0.32, 3.688), (0.46, 3.700), (0.56, 3.692), (0.66, 3.660),
                   (0.74, 3.610),
                   (0.84, 3.48), (1.0, 3.2)),
        tail=curve((0.15, -0.86), (0.24, -0.96), (0.34, -1.02), (0.48, -1.045), (0.62, -1.050), (0.75, -1.040),
                   (0.88, -1.045), (0.98, -1.035), (1.05, -0.98), (1.2, -0.8)),
        deck=curve((-1.1, 0.995), (-0.95, 1.010), (-0.5, 1.010), (0.2, 0.985), (1.6, 0.965), (2.3, 0.955), (2.8, 0.910),
                   (3.2, 0.845), (3.45, 0.785), (3.60, 0.72), (3.9, 0.50)),
        bottom=curve((-1.0, 0.27), (-0.55, 0.19), (-0.3, 0.150), (3.1, 0.150), (3.4, 0.165), (3.7, 0.20)),
        roof=curve((-1.2, 0.75), (-0.9, 0.915), (-0.55, 1.110), (-0.25, 1.260), (0.05, 1.362), (0.45, 1.430),
                   (0.85, 1.450), (1.15, 1.442), (1.45, 1.395), (1.75, 1.285), (2.1, 1.110), (2.45, 0.93), (2.8, 0.75),
                   (3.6, 0.35), (5.0, -0.5)),
        cabin_plan=curve((-0.95, 0.56), (-0.6, 0.65), (-0.2, 0.745), (0.2, 0.80), (0.8, 0.828), (1.6, 0.828),
                         (2.2, 0.805),
                         (2.7, 0.75)),
        cabin_taper=curve((0.75, 0.10), (0.90, 0.02), (0.98, 0.0), (1.12, 0.055), (1.28, 0.135), (1.38, 0.195),
                          (1.5, 0.27)),
        cabin_tail=curve((0.70, -1.0), (1.0, -0.95), (1.3, -0.90), (1.6, -0.80)),
        half_width=0.91, spine=(-0.45, 3.05), roof_sweep=0.10,
        spine_height=curve((-0.9, 0.70), (1.5, 0.66), (3.3, 0.54)), ridge=(0.012, 0.58, 0.10, 2.1, 0.6),
        deck_crown=0.045, mesh=(46, 16, 35),
    )  # fmt: skip
    d = Drawing()
    d.underbody(
        [(-1.2, 0.27), (-0.4, 0.27), (0.34, 0.225), (2.4, 0.225), (3.1, 0.22), (4, 0.22)], front=0.22, rear=0.29
    )
    d.side_windows(
        belt=[(2.20, 0.985), (1.9, 0.988), (1.2, 0.998), (0.5, 1.010), (0.0, 1.025), (-0.42, 1.062)],
        rail=[(-0.38, 1.115), (-0.1, 1.235), (0.2, 1.315), (0.6, 1.350), (1.0, 1.356), (1.3, 1.335), (1.52, 1.285),
              (1.80, 1.170)],
        back=[(-0.46, 1.075)], front=[(2.05, 1.06)], surround="chrome",
        panes=[(1.88, 2.4, 0.02), (0.98, 1.83, 0.02), (0.08, 0.91, 0.05), (-0.6, 0.02, 0.10)],
    )  # fmt: skip
    d.screen(FRONT, [(-0.1, 0.965), (0.42, 0.965), (0.63, 0.975), (0.69, 1.01), (0.66, 1.13), (0.62, 1.24),
                     (0.57, 1.32),
                     (0.52, 1.355), (0.40, 1.375), (-0.1, 1.385)])  # fmt: skip
    d.screen(REAR, [(-0.1, 1.050), (0.40, 1.050), (0.56, 1.060), (0.575, 1.10), (0.53, 1.23), (0.48, 1.315),
                    (0.40, 1.345),
                    (-0.1, 1.360)], border=0.03, facing=0.1)  # fmt: skip
    grille = d.draw("chrome", FRONT, [(-0.1, 0.43), (0.34, 0.43), (0.44, 0.56), (0.46, 0.665), (0.40, 0.70),
                                      (-0.1, 0.705)],
                    round_by=0.015)  # fmt: skip
    inner = d.draw("dark", FRONT, grille.buffer(-0.016))
    d.bars(FRONT, inner.buffer(-0.004), [0.47 + 0.038 * k for k in range(6)], thick=0.012, material="grille")
    intake = d.draw("dark", FRONT, [(-0.1, 0.27), (0.60, 0.27), (0.68, 0.31), (0.64, 0.37), (-0.1, 0.37)],
                    round_by=0.02)  # fmt: skip
    d.bars(FRONT, intake.buffer(-0.012), (0.32,), thick=0.014, material="cladding")
    head = [(3.60, 0.50, 0.610), (3.48, 0.70, 0.622), (3.28, 0.83, 0.660), (3.02, 0.88, 0.725), (3.20, 0.84, 0.745),
            (3.42, 0.70, 0.725), (3.57, 0.50, 0.695)]  # fmt: skip
    _headlamp(d, head)
    tail = [(-1.02, 0.40, 0.80), (-0.96, 0.66, 0.785), (-0.76, 0.86, 0.79), (-0.55, 0.89, 0.87), (-0.74, 0.85, 0.925),
            (-0.93, 0.68, 0.935), (-1.03, 0.40, 0.91)]  # fmt: skip
    _taillamp(d, tail)
    d.draw("plate", REAR, shapely.box(-0.1, 0.63, 0.25, 0.735))
    d.draw("cladding", REAR, shapely.box(-0.1, 0.20, 0.52, 0.33))
    d.gaps(LEFT, [
        [(2.06, 0.98), (2.06, 0.88), (2.11, 0.70), (2.11, 0.50), (2.07, 0.33), (2.02, 0.285), (0.97, 0.285)],
        [(0.935, 1.0), (0.935, 0.82), (0.95, 0.55), (0.97, 0.285)],
        [(0.97, 0.285), (0.60, 0.285), (0.52, 0.34), (0.45, 0.48), (0.36, 0.64), (0.20, 0.75), (0.10, 0.83),
         (0.05, 1.02)],
        [(2.11, 0.915), (2.55, 0.885), (3.0, 0.81)], [(3.06, 0.72), (3.04, 0.55), (3.0, 0.45)],
        [(-0.50, 0.50), (-0.68, 0.56)],
    ])  # fmt: skip
    d.gaps(FRONT, [[(-0.05, 0.735), (0.40, 0.735), (0.50, 0.72)]])
    d.gaps(REAR, [[(-0.05, 0.585), (0.40, 0.585), (0.46, 0.62), (0.46, 0.79)]])
    parts = _side_parts((1.93, 0.955, 1.030), ((1.16, 0.845), (0.24, 0.865)))
    return Style(form, d.result(), parts, FAN_SPOKES, 2.75, 0.78, 0.68)


def _headlamp(d: Drawing, corners: list[tuple[float, float, float]]) -> None:
    """A clear lamp with a dark bezel, a bright brow and two round reflectors."""
    bezel = d.lamp(FRONT_LEFT, corners, [("gloss_black", 0.0), ("lamp", 0.011)])
    middle = bezel.centroid
    low, high = bezel.bounds[0], bezel.bounds[2]
    step = 0.2 * (high - low)
    for x in (middle.x - step, middle.x + 0.35 * step):
        spot = shapely.Point(x, middle.y - 0.004).buffer(0.034).intersection(bezel.buffer(-0.012))
        d.draw("gloss_black", FRONT_LEFT, spot)
        d.draw("lamp_white", FRONT_LEFT, spot.buffer(-0.011))


def _taillamp(d: Drawing, corners: list[tuple[float, float, float]]) -> None:
    """A red lamp with a darker heart and a white lens."""
    edge = d.lamp(REAR_LEFT, corners, [("gloss_black", 0.0), ("lamp_red", 0.009), ("lamp_dark_red", 0.032)])
    low, high = edge.bounds[1], edge.bounds[3]
    middle = (low + high) / 2
    lens = shapely.box(edge.bounds[0], middle - 0.012, edge.bounds[2], middle + 0.012).intersection(edge.buffer(-0.036))
    d.draw("plate", REAR_LEFT, lens)


def fit(style: Style, sizes: dict[str, float], *, points: Array) -> CarOutline:
    """Return a style's car in the given sizes; ``points`` (n, 3) are those of its skin."""
    wheel = WheelDesign(
        sizes["wheel_radius"], sizes["wheel_width"], style.profile * sizes["wheel_radius"], rim=style.rim
    )
    length, height, clearance = sizes["length"], sizes["height"], sizes["ground_clearance"]
    reach, inwards = arch_clearance(wheel, STEERING)
    front = sizes["wheelbase"] + sizes["front_overhang"]
    low, high = points.min(axis=0), points.max(axis=0)
    top = max([high[2], *(float(p.mesh.corners()[:, 2].max()) + p.at[2] for p in style.parts if p.on is None)])
    # The wings must be above the wheel openings; the proportions are adapted where the wheels are large.
    tall = (height - clearance) / (top - low[2])
    wing = clearance + (style.shoulder - low[2]) * tall
    room = clearance + 0.78 * (height - clearance)
    arch_radius = max(
        min(max(reach + 0.06 * wheel.radius, 1.10 * wheel.radius), room - wheel.radius - 0.02), 1.02 * wheel.radius
    )
    wing = min(max(wing, wheel.radius + arch_radius + 0.06), max(room, wing))
    warp = Warp(
        x=((low[0], front - length), (0.0, 0.0), (style.wheelbase, sizes["wheelbase"]), (high[0], front)),
        y=((0.0, 0.0), (high[1], sizes["width"] / 2)),
        z=((low[2], clearance), (style.shoulder, wing), (top, height)),
    )
    inner = max(sizes["track"] / 2 - inwards - 0.03, 0.12 * sizes["width"])
    return CarOutline(
        form=style.form, wheelbase=sizes["wheelbase"], wheel=wheel, arch_radius=arch_radius, arch_inner=inner,
        regions=style.regions, parts=style.parts, warp=warp,
    )  # fmt: skip
