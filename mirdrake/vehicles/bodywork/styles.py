"""Cars of no maker: outlines of a hatchback, a sedan and a sport utility, drawn in their usual size."""

from __future__ import annotations

from dataclasses import dataclass, replace

import shapely

from mirdrake.vehicles.bodywork.curves import curve
from mirdrake.vehicles.bodywork.drawing import Drawing
from mirdrake.vehicles.bodywork.parts import Part
from mirdrake.vehicles.bodywork.regions import FRONT, FRONT_LEFT, LEFT, REAR, REAR_LEFT, Region
from mirdrake.vehicles.bodywork.shell import Form, Skin
from mirdrake.vehicles.bodywork.solids import pillow, rot_z
from mirdrake.vehicles.bodywork.wheels import BROAD_SPOKES, DOUBLE_SPOKES, FAN_SPOKES, Rim


@dataclass(frozen=True)
class Style:
    """A car drawn in its usual size: its form, regions, parts and rim, and the sizes :func:`write_car` starts from.

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


def hatchback() -> Style:
    """A five-door hatchback: 4.20 m long, 1.76 m wide, 1.48 m high, wheelbase 2.60 m."""
    form = Form(
        plan=curve((-0.85, 0.79), (-0.5, 0.848), (-0.1, 0.878), (0.3, 0.880), (2.2, 0.880), (2.6, 0.880), (2.85, 0.868),
                   (3.1, 0.828), (3.28, 0.762), (3.42, 0.66)),
        side_inset=curve(*_INSET),
        nose=curve((0.12, 3.24), (0.20, 3.325), (0.32, 3.388), (0.46, 3.400), (0.58, 3.393), (0.68, 3.365),
                   (0.76, 3.32),
                   (0.86, 3.22), (1.0, 3.0)),
        tail=curve((0.15, -0.62), (0.24, -0.72), (0.34, -0.775), (0.48, -0.800), (0.60, -0.797), (0.70, -0.772),
                   (0.85, -0.765), (0.95, -0.755), (1.05, -0.72), (1.2, -0.60)),
        deck=curve((-0.9, 1.01), (-0.4, 1.01), (0.5, 0.995), (1.6, 0.985), (2.2, 0.975), (2.7, 0.930), (3.0, 0.875),
                   (3.2, 0.815), (3.33, 0.74), (3.6, 0.55)),
        bottom=curve((-0.8, 0.27), (-0.45, 0.19), (-0.2, 0.150), (2.9, 0.150), (3.2, 0.165), (3.4, 0.20)),
        roof=curve((-0.85, 1.33), (-0.6, 1.385), (-0.3, 1.430), (0.2, 1.466), (0.7, 1.480), (1.0, 1.478), (1.3, 1.452),
                   (1.55, 1.388), (1.8, 1.280), (2.1, 1.130), (2.4, 0.975), (2.7, 0.82), (3.4, 0.40), (5.0, -0.5)),
        cabin_plan=curve((-0.8, 0.67), (-0.5, 0.735), (-0.2, 0.780), (0.2, 0.808), (0.8, 0.820), (1.6, 0.820),
                         (2.2, 0.800), (2.7, 0.75)),
        cabin_taper=curve((0.75, 0.10), (0.90, 0.02), (1.0, 0.0), (1.15, 0.050), (1.3, 0.118), (1.4, 0.175),
                          (1.5, 0.24)),
        cabin_tail=curve((0.75, -0.62), (0.95, -0.745), (1.05, -0.735), (1.2, -0.665), (1.35, -0.575), (1.45, -0.50),
                         (1.6, -0.36)),
        half_width=0.88, spine=(-0.20, 2.80),
        spine_height=curve((-0.5, 0.74), (1.5, 0.68), (3.0, 0.55)), ridge=(0.012, 0.55, 0.10, 2.0, 0.6),
    )  # fmt: skip
    d = Drawing()
    d.underbody([(-1, 0.30), (-0.4, 0.30), (0.34, 0.25), (2.3, 0.25), (3.0, 0.24), (4, 0.24)], front=0.24, rear=0.32)
    d.side_windows(
        belt=[(2.12, 1.005), (1.9, 1.008), (1.2, 1.018), (0.5, 1.030), (0.0, 1.045), (-0.36, 1.075)],
        rail=[(-0.40, 1.315), (0.0, 1.362), (0.4, 1.382), (0.9, 1.388), (1.25, 1.370), (1.48, 1.325), (1.75, 1.215)],
        back=[(-0.50, 1.12), (-0.53, 1.20)], front=[(1.98, 1.10)],
        panes=[(1.82, 2.3, 0.02), (0.93, 1.77, 0.02), (0.04, 0.86, 0.04), (-0.6, -0.02, 0.06)],
    )  # fmt: skip
    d.screen(FRONT, [(-0.1, 0.985), (0.40, 0.985), (0.62, 0.995), (0.68, 1.03), (0.655, 1.15), (0.62, 1.26),
                     (0.575, 1.345),
                     (0.53, 1.385), (0.40, 1.405), (-0.1, 1.412)])  # fmt: skip
    d.screen(REAR, [(-0.1, 1.065), (0.45, 1.070), (0.575, 1.11), (0.57, 1.22), (0.50, 1.345), (0.40, 1.375),
                    (-0.1, 1.385)],
             border=0.03, facing=0.2)  # fmt: skip
    grille = d.draw("gloss_black", FRONT, [(-0.1, 0.615), (0.42, 0.625), (0.47, 0.66), (0.45, 0.715), (-0.1, 0.715)],
                    round_by=0.012)  # fmt: skip
    d.bars(FRONT, grille.buffer(-0.01), (0.645, 0.685), thick=0.012, material="chrome")
    intake = d.draw("dark", FRONT, [(-0.1, 0.29), (0.50, 0.29), (0.60, 0.34), (0.58, 0.44), (0.48, 0.47), (-0.1, 0.47)],
                    round_by=0.02)  # fmt: skip
    d.bars(FRONT, intake.buffer(-0.015), (0.345, 0.40), thick=0.014, material="cladding")
    head = [(3.33, 0.47, 0.620), (3.22, 0.66, 0.640), (3.02, 0.80, 0.690), (2.82, 0.85, 0.765), (2.98, 0.80, 0.775),
            (3.16, 0.68, 0.755), (3.30, 0.48, 0.715)]  # fmt: skip
    _headlamp(d, head)
    tail = [(-0.74, 0.42, 0.80), (-0.66, 0.66, 0.79), (-0.44, 0.84, 0.80), (-0.26, 0.86, 0.90), (-0.44, 0.80, 0.955),
            (-0.62, 0.66, 0.945), (-0.73, 0.42, 0.92)]  # fmt: skip
    _taillamp(d, tail)
    d.draw("plate", REAR, shapely.box(-0.1, 0.63, 0.25, 0.735))
    d.draw("cladding", REAR, shapely.box(-0.1, 0.36, 0.60, 0.40))
    d.gaps(LEFT, [
        [(1.98, 1.0), (1.98, 0.90), (2.02, 0.72), (2.02, 0.52), (1.98, 0.36), (1.93, 0.31), (0.92, 0.31)],
        [(0.885, 1.02), (0.885, 0.85), (0.90, 0.55), (0.92, 0.31)],
        [(0.92, 0.31), (0.60, 0.31), (0.52, 0.36), (0.44, 0.50), (0.34, 0.66), (0.18, 0.76), (0.06, 0.84),
         (0.01, 1.04)],
        [(2.02, 0.935), (2.40, 0.905), (2.80, 0.83)], [(2.86, 0.76), (2.84, 0.60), (2.80, 0.5)],
        [(-0.30, 0.52), (-0.50, 0.60)],
    ])  # fmt: skip
    d.gaps(FRONT, [[(-0.05, 0.755), (0.36, 0.758), (0.47, 0.745)]])
    d.gaps(REAR, [[(-0.05, 0.585), (0.60, 0.585), (0.68, 0.63), (0.68, 0.80)]])
    parts = _side_parts((1.86, 0.93, 1.055), ((1.10, 0.865), (0.16, 0.885)))
    return Style(form, d.result(), parts, replace(DOUBLE_SPOKES, cap="rim_dark"), 2.60, 0.80, 0.66)


def sedan() -> Style:
    """A four-door sedan: 4.75 m long, 1.82 m wide, 1.45 m high, wheelbase 2.75 m."""
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


def suv() -> Style:
    """A five-door sport utility: 4.50 m long, 1.86 m wide, 1.70 m high, wheelbase 2.70 m."""
    form = Form(
        plan=curve((-0.95, 0.84), (-0.6, 0.895), (-0.2, 0.925), (0.3, 0.930), (2.3, 0.930), (2.75, 0.930), (3.0, 0.918),
                   (3.25, 0.878), (3.45, 0.805), (3.62, 0.71)),
        side_inset=curve((0.15, 0.10), (0.26, 0.045), (0.34, 0.022), (0.50, 0.020), (0.66, 0.014), (0.80, 0.004),
                         (0.92, 0.000), (1.0, 0.010), (1.12, 0.045), (1.25, 0.10)),
        nose=curve((0.18, 3.44), (0.26, 3.525), (0.38, 3.588), (0.54, 3.600), (0.68, 3.595), (0.80, 3.575),
                   (0.88, 3.53),
                   (0.98, 3.42), (1.1, 3.2)),
        tail=curve((0.20, -0.72), (0.30, -0.82), (0.40, -0.875), (0.56, -0.900), (0.68, -0.895), (0.78, -0.868),
                   (0.95, -0.860), (1.05, -0.85), (1.15, -0.80), (1.3, -0.65)),
        deck=curve((-1.0, 1.13), (-0.4, 1.13), (0.5, 1.12), (1.7, 1.115), (2.3, 1.105), (2.8, 1.070), (3.15, 1.020),
                   (3.38, 0.960), (3.52, 0.87), (3.8, 0.60)),
        bottom=curve((-0.9, 0.36), (-0.5, 0.26), (-0.25, 0.210), (3.0, 0.210), (3.3, 0.23), (3.6, 0.27)),
        roof=curve((-0.95, 1.585), (-0.6, 1.640), (-0.2, 1.678), (0.4, 1.700), (0.9, 1.698), (1.2, 1.680),
                   (1.45, 1.628),
                   (1.7, 1.520), (2.0, 1.355), (2.3, 1.180), (2.6, 1.0), (3.4, 0.52), (5.0, -0.5)),
        cabin_plan=curve((-0.9, 0.74), (-0.5, 0.805), (-0.2, 0.840), (0.3, 0.862), (0.8, 0.868), (1.6, 0.868),
                         (2.2, 0.848),
                         (2.7, 0.80)),
        cabin_taper=curve((0.85, 0.10), (1.0, 0.02), (1.12, 0.0), (1.3, 0.046), (1.45, 0.10), (1.6, 0.16),
                          (1.72, 0.22)),
        cabin_tail=curve((0.85, -0.72), (1.05, -0.835), (1.15, -0.835), (1.3, -0.785), (1.5, -0.70), (1.62, -0.64),
                         (1.75, -0.52)),
        half_width=0.93, spine=(-0.25, 2.95),
        spine_height=curve((-0.6, 0.86), (1.5, 0.80), (3.2, 0.66)), ridge=(0.016, 0.62, 0.10, 2.0, 0.6),
        blends=(0.02, 0.09, 0.10, 0.05, 0.09, 0.08, 0.05),
    )  # fmt: skip
    d = Drawing()
    d.underbody([(-1.1, 0.47), (-0.4, 0.47), (0.42, 0.40), (2.3, 0.40), (3.0, 0.42), (4, 0.42)], front=0.36, rear=0.47,
                arch=0.045)  # fmt: skip
    d.side_windows(
        belt=[(2.16, 1.145), (1.9, 1.148), (1.2, 1.155), (0.5, 1.165), (0.0, 1.175), (-0.50, 1.195)],
        rail=[(-0.52, 1.535), (0.0, 1.575), (0.4, 1.592), (0.9, 1.600), (1.2, 1.588), (1.44, 1.545), (1.72, 1.420)],
        back=[(-0.66, 1.23), (-0.66, 1.40)], front=[(2.02, 1.24)],
        panes=[(1.86, 2.4, 0.02), (0.98, 1.81, 0.02), (0.04, 0.91, 0.03), (-0.75, -0.04, 0.05)],
    )  # fmt: skip
    d.screen(FRONT, [(-0.1, 1.118), (0.45, 1.118), (0.66, 1.13), (0.73, 1.17), (0.70, 1.30), (0.66, 1.43), (0.62, 1.53),
                     (0.57, 1.585), (0.42, 1.610), (-0.1, 1.620)])  # fmt: skip
    d.screen(REAR, [(-0.1, 1.185), (0.52, 1.190), (0.64, 1.23), (0.635, 1.38), (0.57, 1.53), (0.46, 1.560),
                    (-0.1, 1.575)],
             border=0.03, facing=0.2)  # fmt: skip
    grille = d.draw("gloss_black", FRONT, [(-0.1, 0.62), (0.38, 0.62), (0.47, 0.70), (0.49, 0.83), (0.44, 0.855),
                                           (-0.1, 0.86)], round_by=0.015)  # fmt: skip
    d.bars(FRONT, grille.buffer(-0.012), (0.675, 0.735, 0.795), thick=0.020, material="chrome")
    intake = d.draw(
        "dark", FRONT, [(-0.1, 0.40), (0.55, 0.40), (0.63, 0.44), (0.58, 0.54), (-0.1, 0.54)], round_by=0.02
    )
    d.bars(FRONT, intake.buffer(-0.015), (0.47,), thick=0.016, material="cladding")
    d.draw("grille", FRONT, [(-0.1, 0.26), (0.42, 0.26), (0.48, 0.33), (-0.1, 0.33)], round_by=0.01)
    head = [(3.52, 0.52, 0.735), (3.42, 0.70, 0.745), (3.22, 0.84, 0.775), (2.98, 0.90, 0.86), (3.16, 0.85, 0.895),
            (3.36, 0.72, 0.885), (3.50, 0.52, 0.855)]  # fmt: skip
    _headlamp(d, head)
    tail = [(-0.83, 0.58, 0.86), (-0.78, 0.72, 0.85), (-0.55, 0.88, 0.87), (-0.42, 0.90, 0.98), (-0.52, 0.88, 1.10),
            (-0.72, 0.78, 1.13), (-0.80, 0.62, 1.12)]  # fmt: skip
    _taillamp(d, tail)
    d.draw("plate", REAR, shapely.box(-0.1, 0.78, 0.25, 0.885))
    d.draw("grille", REAR, [(-0.1, 0.29), (0.48, 0.29), (0.54, 0.37), (-0.1, 0.37)], round_by=0.01)
    d.gaps(LEFT, [
        [(2.02, 1.14), (2.02, 1.02), (2.06, 0.82), (2.06, 0.62), (2.03, 0.43)],
        [(0.93, 1.155), (0.93, 0.95), (0.945, 0.68), (0.96, 0.40)],
        [(0.56, 0.40), (0.50, 0.58), (0.38, 0.74), (0.20, 0.86), (0.06, 0.95), (0.0, 1.17)],
        [(2.06, 1.07), (2.5, 1.045), (2.95, 0.965)], [(3.05, 0.86), (3.03, 0.70), (3.0, 0.6)],
        [(-0.40, 0.58), (-0.62, 0.66)],
    ])  # fmt: skip
    d.gaps(FRONT, [[(-0.05, 0.895), (0.42, 0.895), (0.52, 0.88)]])
    d.gaps(REAR, [[(-0.05, 0.72), (0.66, 0.72), (0.74, 0.77), (0.74, 0.85)]])
    parts = list(_side_parts((1.88, 0.975, 1.20), ((1.14, 0.99), (0.18, 1.005))))
    rail = pillow("gloss_black", (1.75, 0.035, 0.035), 0.45, (12, 7))
    parts.append(Part(rail, (0.42, 0.60, 1.668), pair=True))
    parts += [
        Part(pillow("gloss_black", (0.14, 0.05, 0.06), 0.5, (10, 5)), (x, 0.60, 1.65), pair=True) for x in (-0.35, 1.2)
    ]
    return Style(form, d.result(), tuple(parts), BROAD_SPOKES, 2.70, 0.96, 0.62)


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


STYLES = {"hatchback": hatchback, "sedan": sedan, "suv": suv}
