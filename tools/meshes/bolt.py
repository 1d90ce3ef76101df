"""Generate the visual meshes of the Chevrolet Bolt EV: ``body.gltf`` and ``wheel.gltf`` (with their ``.bin`` files).

The car is modelled from scratch: the outlines below are all there is of it; ``tools.meshes.outlines`` makes the
meshes of them. Frames are ISO 8855 (x forward, y left, z up; metres). The origin of the body is on the ground below the
centre of the rear axle; that of the wheel is at its centre, spinning about y.

Usage: ``python -m tools.meshes.bolt`` writes them into ``models/bolt/meshes``; the result is deterministic.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import shapely
from shapely.geometry import Point
from shapely.geometry.base import BaseGeometry

from mirdrake.vehicles.bodywork.mesh import Material, Mesh
from tools.meshes.outlines.car import CarOutline, describe, write_outline
from tools.meshes.outlines.curves import curve, smooth_line
from tools.meshes.outlines.parts import Part, Spoiler
from tools.meshes.outlines.regions import (
    BELOW,
    FRONT,
    FRONT_LEFT,
    LEFT,
    REAR,
    REAR_LEFT,
    Region,
    arches,
    outline,
    seen,
    stroke,
)  # fmt: skip
from tools.meshes.outlines.shell import Form
from tools.meshes.outlines.solids import pillow, plate, prism, rot_y, rot_z
from tools.meshes.outlines.wheels import WheelDesign

PLAN = curve(
    (-0.75, 0.800), (-0.45, 0.852), (-0.1, 0.8800), (0.3, 0.8790), (1.2, 0.8765), (2.2, 0.8790), (2.6, 0.8815),
    (2.85, 0.872), (3.1, 0.835), (3.3, 0.770), (3.46, 0.66),
)  # fmt: skip
SIDE_INSET = curve(
    (0.10, 0.11), (0.20, 0.048), (0.27, 0.022), (0.36, 0.023), (0.46, 0.022), (0.60, 0.016), (0.74, 0.006),
    (0.85, 0.000), (0.92, 0.010), (1.02, 0.045), (1.15, 0.10),
)  # fmt: skip
NOSE = curve(
    (0.12, 3.30), (0.20, 3.375), (0.32, 3.432), (0.46, 3.451), (0.58, 3.446), (0.70, 3.425), (0.80, 3.385),
    (0.90, 3.31), (1.0, 3.15),
)  # fmt: skip
TAIL = curve(
    (0.15, -0.52), (0.24, -0.62), (0.34, -0.685), (0.48, -0.715), (0.60, -0.713), (0.66, -0.690), (0.72, -0.668),
    (0.85, -0.674), (0.95, -0.672), (1.02, -0.655), (1.10, -0.60), (1.2, -0.50),
)  # fmt: skip
DECK = curve(
    (-0.8, 1.120), (-0.4, 1.120), (0.5, 1.095), (1.5, 1.065), (2.2, 1.055), (2.6, 1.025), (2.9, 0.985), (3.15, 0.930),
    (3.32, 0.868), (3.42, 0.80), (3.6, 0.60),
)  # fmt: skip
ROOF = curve(
    (-0.80, 1.430), (-0.5, 1.497), (-0.2, 1.545), (0.2, 1.578), (0.6, 1.5935), (0.9, 1.595), (1.2, 1.587),
    (1.5, 1.556), (1.75, 1.485), (2.0, 1.372), (2.3, 1.212), (2.6, 1.040), (2.9, 0.86), (3.6, 0.40), (5.0, -0.5),
)  # fmt: skip
CABIN_PLAN = curve(
    (-0.75, 0.66), (-0.5, 0.735), (-0.2, 0.785), (0.2, 0.818), (0.8, 0.832), (1.6, 0.832), (2.2, 0.815), (2.7, 0.77)
)
CABIN_TAPER = curve((0.75, 0.12), (0.95, 0.02), (1.05, 0.0), (1.2, 0.040), (1.35, 0.098), (1.5, 0.175), (1.6, 0.24))
CABIN_TAIL = curve(
    (0.75, -0.50), (0.95, -0.640), (1.07, -0.638), (1.2, -0.592), (1.35, -0.525), (1.45, -0.47), (1.6, -0.36)
)
BOTTOM = curve((-0.75, 0.26), (-0.45, 0.19), (-0.2, 0.150), (2.9, 0.145), (3.2, 0.165), (3.45, 0.20))


def draw_regions() -> tuple[Region, ...]:
    """Return everything that is drawn on the body, in the order of drawing."""
    regions: list[Region] = []

    def draw(material: str | None, view: Sequence[float], shape: BaseGeometry, facing: float = 0.1) -> None:
        regions.append(Region(material, view, shape, facing))

    # Underbody and lower cladding, all around the car.
    draw("dark", BELOW, outline([(-1, -1), (4, -1), (4, 1), (-1, 1)]), 0.75)
    sill = [(-0.9, 0.0), (-0.9, 0.40), (-0.34, 0.40), (0.34, 0.285), (2.26, 0.285), (2.94, 0.27), (3.6, 0.27), (3.6, 0)]
    draw("cladding", LEFT, outline(sill), 0.0)
    draw("cladding", FRONT, outline([(-0.1, 0), (1, 0), (1, 0.27), (-0.1, 0.27)]), 0.1)
    draw("cladding", REAR, outline([(-0.1, 0), (1, 0), (1, 0.40), (-0.1, 0.40)]), 0.1)
    regions.append(arches("cladding", 0.018))

    # Side windows: one dark band with the panes in it, which ends in the black "floating roof" pillar.
    belt = smooth_line([(2.27, 1.064), (1.9, 1.064), (1.2, 1.075), (0.5, 1.10), (0.05, 1.135), (-0.28, 1.19)], 20)
    rail = smooth_line([(-0.46, 1.392), (-0.1, 1.436), (0.4, 1.474), (0.9, 1.486), (1.3, 1.476), (1.62, 1.425)], 20)
    pillar = smooth_line([(1.62, 1.425), (1.86, 1.315), (2.07, 1.180), (2.27, 1.064)], 12)
    back = [(-0.36, 1.205), (-0.70, 1.225), (-0.70, 1.33), (-0.62, 1.365)]
    band = outline([*belt, *back, *rail, *pillar[1:-1]], 0.012)
    draw("gloss_black", LEFT, band, 0.15)
    panes = band.buffer(-0.022, join_style="mitre")
    for x_low, x_high, slant in ((1.93, 2.30, 0.02), (1.02, 1.88, 0.02), (0.13, 0.93, 0.03), (-0.26, 0.07, 0.05)):
        box = outline([(x_low, 1.0), (x_high, 1.0), (x_high - slant, 1.6), (x_low - slant, 1.6)])
        pane = panes.intersection(box).buffer(-0.014, quad_segs=3).buffer(0.014, quad_segs=3).simplify(4e-4)
        draw("glass", LEFT, pane, 0.15)

    # Windscreen and rear window.
    screen = [(-0.1, 1.058), (0.30, 1.060), (0.55, 1.064), (0.69, 1.076), (0.695, 1.11), (0.68, 1.20), (0.655, 1.30),
              (0.615, 1.40), (0.575, 1.458), (0.53, 1.480), (0.40, 1.500), (0.20, 1.515), (-0.1, 1.520)]  # fmt: skip
    draw("gloss_black", FRONT, outline(screen), 0.12)
    draw("glass", FRONT, outline(screen).buffer(-0.028).intersection(shapely.box(-0.05, 1.0, 1, 1.6)), 0.12)
    hatch = [(-0.1, 1.030), (0.50, 1.045), (0.66, 1.10), (0.675, 1.20), (0.635, 1.33), (0.585, 1.39), (0.50, 1.425),
             (0.48, 1.46), (-0.1, 1.50)]  # fmt: skip
    draw("gloss_black", REAR, outline(hatch), 0.2)
    draw("glass", REAR, outline([(-0.1, 1.115), (0.50, 1.125), (0.585, 1.20), (0.50, 1.405), (-0.1, 1.425)], 0.02), 0.2)

    # Front: closed grille panel, headlamps, lower intake, fog lamp pods.
    draw("gloss_black", FRONT, outline([(-0.1, 0.618), (0.34, 0.632), (0.50, 0.680), (0.56, 0.765), (0.40, 0.760),
                                        (-0.1, 0.754)], 0.01), 0.1)  # fmt: skip
    for row in range(3):
        z = 0.652 + 0.032 * row
        draw("grille", FRONT, outline([(-0.1, z), (0.36 + 0.05 * row, z), (0.375 + 0.05 * row, z + 0.014),
                                       (-0.1, z + 0.014)]), 0.1)  # fmt: skip
    lamp = seen(
        FRONT_LEFT,
        [
            (3.38, 0.42, 0.685),
            (3.30, 0.60, 0.702),
            (3.12, 0.76, 0.748),
            (2.95, 0.83, 0.825),
            (2.84, 0.84, 0.890),
            (3.02, 0.79, 0.878),
            (3.20, 0.67, 0.838),
            (3.34, 0.46, 0.775),
        ],
    )
    bezel = outline(lamp, 0.012)
    draw("gloss_black", FRONT_LEFT, bezel, 0.15)
    draw("lamp", FRONT_LEFT, bezel.buffer(-0.013), 0.15)
    low, high = lamp[:5], [lamp[7], lamp[6], lamp[5], lamp[4]]
    draw("lamp_white", FRONT_LEFT, stroke(high, 0.03).intersection(bezel.buffer(-0.012)), 0.15)
    draw("amber", FRONT_LEFT, stroke(low[2:], 0.028).intersection(bezel.buffer(-0.013)), 0.15)
    for position, radius in (((3.335, 0.515, 0.743), 0.032), ((3.24, 0.64, 0.772), 0.032)):
        spot = Point(seen(FRONT_LEFT, [position])[0])
        draw("gloss_black", FRONT_LEFT, spot.buffer(radius, quad_segs=5), 0.15)
        draw("lamp_white", FRONT_LEFT, spot.buffer(radius * 0.6, quad_segs=4), 0.15)
    intake = outline([(-0.1, 0.285), (0.46, 0.285), (0.53, 0.33), (0.50, 0.425), (0.36, 0.470), (-0.1, 0.480)], 0.015)
    draw("dark", FRONT, intake, 0.1)
    for z in (0.335, 0.385, 0.435):
        draw("cladding", FRONT, shapely.box(-0.1, z - 0.008, 1, z + 0.008).intersection(intake.buffer(-0.012)), 0.1)
    pod = outline(seen(FRONT_LEFT, [(3.30, 0.60, 0.315), (3.10, 0.78, 0.33), (3.06, 0.80, 0.47), (3.20, 0.72, 0.50),
                                    (3.31, 0.60, 0.42)]), 0.012)  # fmt: skip
    draw("cladding", FRONT_LEFT, pod, 0.1)
    drl = stroke(seen(FRONT_LEFT, [(3.30, 0.60, 0.40), (3.20, 0.72, 0.475), (3.07, 0.80, 0.45)]), 0.016)
    draw("lamp_white", FRONT_LEFT, drl.intersection(pod.buffer(-0.006)), 0.1)

    # Rear: tail lamps high on the hatch, plate recess, reflectors.
    tail = outline(seen(REAR_LEFT, [(-0.66, 0.40, 0.945), (-0.60, 0.62, 0.925), (-0.42, 0.80, 0.945),
                                    (-0.30, 0.83, 1.045), (-0.44, 0.76, 1.075), (-0.58, 0.58, 1.035),
                                    (-0.655, 0.40, 0.995)]), 0.014)  # fmt: skip
    draw("gloss_black", REAR_LEFT, tail, 0.1)
    draw("lamp_red", REAR_LEFT, tail.buffer(-0.010), 0.1)
    draw("lamp_dark_red", REAR_LEFT, tail.buffer(-0.034), 0.1)
    draw("cladding", REAR, outline([(-0.1, 0.715), (0.27, 0.715), (0.30, 0.865), (-0.1, 0.865)], 0.01), 0.1)
    draw("lamp_red", REAR, outline([(0.52, 0.425), (0.72, 0.435), (0.72, 0.462), (0.52, 0.452)]), 0.1)

    # Shut lines.
    line = 0.0065
    gaps: list[tuple[Sequence[float], list[tuple[float, float]]]] = [
        (LEFT, [(2.06, 1.062), (2.06, 0.95), (2.10, 0.75), (2.11, 0.55), (2.08, 0.38), (2.03, 0.335), (1.02, 0.335)]),
        (LEFT, [(0.975, 1.085), (0.975, 0.90), (0.99, 0.60), (1.02, 0.335)]),
        (LEFT, [(1.02, 0.335), (0.62, 0.335), (0.52, 0.36), (0.44, 0.48), (0.36, 0.62), (0.20, 0.72), (0.08, 0.80),
                (0.04, 0.90), (0.03, 1.135)]),
        (LEFT, [(2.20, 0.985), (2.40, 0.975), (2.70, 0.940), (2.90, 0.880)]),
        (LEFT, [(2.06, 0.985), (2.20, 0.985)]),
        (LEFT, [(2.87, 0.86), (2.80, 0.62)]),
        (LEFT, [(-0.31, 0.55), (-0.42, 0.62), (-0.48, 0.67)]),
        (FRONT, [(-0.05, 0.790), (0.36, 0.793), (0.47, 0.790)]),
        (REAR, [(-0.05, 0.665), (0.62, 0.665), (0.70, 0.70), (0.72, 0.95)]),
    ]  # fmt: skip
    regions += [Region("gap", view, stroke(points, line), 0.25, ("paint",)) for view, points in gaps]
    charge = outline([(2.70, 0.735), (2.50, 0.75), (2.50, 0.90), (2.68, 0.885)], 0.02)
    regions.append(Region("gap", LEFT, charge.boundary.buffer(0.0025), 0.25, ("paint",)))
    return tuple(regions)


def place_parts() -> tuple[Part, ...]:
    """Return the small solids: door mirror and handles of the left side, plates, emblems of no maker, aerial."""
    sideways = rot_z(-0.18)
    parts = [
        Part(pillow("paint", (0.145, 0.19, 0.13), 0.62, (16, 11)), (1.965, 0.945, 1.115), sideways, pair=True),
        Part(pillow("gloss_black", (0.10, 0.20, 0.035), 0.5, (10, 5)), (1.985, 0.880, 1.055), pair=True),
        Part(pillow("glass", (0.02, 0.155, 0.10), 0.5, (12, 5)), (1.894, 0.935, 1.115), sideways, pair=True),
    ]
    for x, z in ((1.16, 0.905), (0.20, 0.925)):
        recess = pillow("gap", (0.19, 0.012, 0.045), 0.5, (10, 5))
        handle = pillow("paint", (0.205, 0.034, 0.026), 0.5, (12, 7))
        parts.append(Part(recess, (x, 0.3, z), on=LEFT, shift=(0, 0, -0.004), pair=True))
        parts.append(Part(handle, (x, 0.3, z), on=LEFT, shift=(0, 0.010, 0.006), pair=True))
    angles = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    oval = outline([(0.055 * float(np.cos(a)), 0.022 * float(np.sin(a))) for a in angles])
    flip = rot_z(np.pi)
    parts += [
        Part(plate("MIR 2017"), (3.0, 0, 0.54), on=FRONT, shift=(-0.005, 0, -0.005)),
        Part(plate("BOLT EV"), (-0.3, 0, 0.79), flip, on=REAR, shift=(0.002, 0, 0)),
        Part(prism("gold", oval, 0.014), (3.0, 0, 0.69), on=FRONT, shift=(-0.004, 0, 0)),
        Part(prism("gold", oval, 0.014), (-0.3, 0, 0.965), flip, on=REAR, shift=(0.004, 0, 0)),
        Part(pillow("gloss_black", (0.15, 0.035, 0.075), 0.8, (16, 9)), (-0.17, 0, 1.560), rot_y(-0.25)),
    ]
    return tuple(parts)


CAR = CarOutline(
    form=Form(
        plan=PLAN, side_inset=SIDE_INSET, nose=NOSE, tail=TAIL, deck=DECK, bottom=BOTTOM, roof=ROOF,
        cabin_plan=CABIN_PLAN, cabin_taper=CABIN_TAPER, cabin_tail=CABIN_TAIL, half_width=0.8825
    ),
    wheelbase=2.601,
    wheel=WheelDesign(radius=0.3234, width=0.215, rim_radius=0.2159),
    arch_radius=0.368,
    arch_inner=0.46,
    regions=draw_regions(),
    parts=place_parts(),
    rear_spoiler=Spoiler(),
    materials={"paint": Material((0.07, 0.45, 0.90), 0.36, 0.1)},
)  # fmt: skip


def write(folder: Path) -> dict[str, Mesh]:
    """Write both meshes into a folder; return them by name."""
    return write_outline(folder, CAR, generator="mirdrake tools/meshes/bolt.py")


if __name__ == "__main__":
    target = Path(__file__).resolve().parents[2] / "models" / "bolt" / "meshes"
    for line in describe(target, write(target)):
        print(line)
