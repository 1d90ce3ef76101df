"""Generate the visual meshes of the Lincoln MKZ 2017: ``body.gltf`` and ``wheel.gltf`` (with their ``.bin`` files).

The car is modelled from scratch: the outlines below are all there is of it; ``tools.meshes.outlines`` makes the
meshes of them. Frames are ISO 8855 (x forward, y left, z up; metres). The origin of the body is on the ground below the
centre of the rear axle; that of the wheel is at its centre, spinning about y.

Usage: ``python -m tools.meshes.mkz`` writes them into ``models/mkz/meshes``; the result is deterministic.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import shapely
from shapely.geometry import LineString, Point

from mirdrake.vehicles.bodywork.mesh import Material, Mesh
from tools.meshes.outlines.car import CarOutline, describe, write_outline
from tools.meshes.outlines.curves import curve, smooth_line
from tools.meshes.outlines.drawing import Drawing
from tools.meshes.outlines.parts import Part
from tools.meshes.outlines.regions import (
    ABOVE,
    FRONT,
    FRONT_LEFT,
    LEFT,
    REAR,
    REAR_LEFT,
    Region,
    outline,
    seen,
    stroke,
)
from tools.meshes.outlines.shell import Form
from tools.meshes.outlines.solids import pillow, plate, prism, rot_y, rot_z
from tools.meshes.outlines.wheels import FAN_SPOKES, WheelDesign

FORM = Form(
    plan=curve((-1.10, 0.795), (-0.8, 0.866), (-0.4, 0.915), (0.1, 0.930), (0.8, 0.926), (1.6, 0.924), (2.4, 0.929),
               (2.85, 0.932), (3.1, 0.920), (3.4, 0.872), (3.65, 0.795), (3.9, 0.67)),
    side_inset=curve((0.10, 0.11), (0.19, 0.050), (0.26, 0.024), (0.34, 0.034), (0.46, 0.032), (0.60, 0.020),
                     (0.74, 0.005),
                     (0.83, 0.000), (0.90, 0.010), (1.00, 0.045), (1.15, 0.10)),
    nose=curve((0.12, 3.72), (0.19, 3.805), (0.30, 3.868), (0.42, 3.885), (0.52, 3.883), (0.62, 3.865), (0.70, 3.825),
               (0.78, 3.75), (0.88, 3.60), (1.0, 3.40)),
    tail=curve((0.14, -0.84), (0.24, -0.945), (0.34, -1.000), (0.50, -1.020), (0.64, -1.012), (0.76, -0.990),
               (0.86, -1.000),
               (0.95, -1.030), (1.01, -1.040), (1.07, -0.99), (1.2, -0.80)),
    deck=curve((-1.1, 1.030), (-0.95, 1.036), (-0.7, 1.026), (-0.3, 1.005), (0.2, 0.982), (1.6, 0.965), (2.4, 0.952),
               (2.9, 0.912), (3.3, 0.852), (3.6, 0.785), (3.78, 0.725), (4.0, 0.56)),
    bottom=curve((-1.0, 0.27), (-0.55, 0.18), (-0.3, 0.140), (3.2, 0.140), (3.5, 0.155), (3.85, 0.19)),
    roof=curve((-1.2, 0.905), (-0.95, 1.005), (-0.7, 1.105), (-0.4, 1.218), (-0.1, 1.313), (0.25, 1.395), (0.6, 1.447),
               (0.95, 1.473), (1.15, 1.476), (1.4, 1.456), (1.65, 1.398), (1.95, 1.278), (2.3, 1.110), (2.65, 0.93),
               (3.0, 0.75), (3.8, 0.35), (5.0, -0.5)),
    cabin_plan=curve((-1.0, 0.53), (-0.7, 0.62), (-0.3, 0.730), (0.1, 0.802), (0.6, 0.840), (1.2, 0.848), (1.8, 0.842),
                     (2.4, 0.812), (2.9, 0.75)),
    cabin_taper=curve((0.75, 0.10), (0.90, 0.02), (0.98, 0.0), (1.12, 0.055), (1.28, 0.138), (1.40, 0.205),
                      (1.5, 0.27)),
    cabin_tail=curve((0.70, -1.0), (1.0, -0.96), (1.3, -0.92), (1.6, -0.85)),
    half_width=0.932, spine=(-0.42, 3.22), spine_height=curve((-0.9, 0.70), (1.5, 0.66), (3.4, 0.52)),
    tail_sweep=(0.15, 2.6, 0.3), deck_crown=0.045, ridge=(0.016, 0.52, 0.09, 2.2, 0.6), roof_sweep=0.12,
    blends=(0.02, 0.08, 0.10, 0.05, 0.10, 0.08, 0.05), mesh=(48, 17, 37),
)  # fmt: skip


def draw_regions() -> tuple[Region, ...]:
    """Return everything that is drawn on the body, in the order of drawing."""
    d = Drawing()
    d.underbody([(-1.2, 0.22), (-0.4, 0.22), (0.34, 0.190), (2.5, 0.190), (3.2, 0.19),
                 (4.2, 0.19)], front=0.19, rear=0.24,
                arch=0.0)  # fmt: skip
    # A roof of glass between the screens, side windows in a bright frame.
    d.draw("gloss_black", ABOVE, [(1.60, -0.1), (1.60, 0.44), (1.50, 0.49), (0.25, 0.49), (0.12, 0.45), (0.12, -0.1)],
           round_by=0.03, facing=0.75)  # fmt: skip
    d.side_windows(
        belt=[(2.32, 0.988), (1.9, 0.992), (1.2, 1.000), (0.5, 1.012), (0.0, 1.030), (-0.50, 1.088)],
        rail=[(-0.50, 1.122), (-0.25, 1.205), (0.1, 1.298), (0.5, 1.360), (0.9, 1.386), (1.25, 1.382), (1.55, 1.338),
              (1.95, 1.170)],
        back=[(-0.56, 1.098)], front=[(2.20, 1.05)], surround="chrome", frame=0.016,
        panes=[(1.86, 2.5, 0.02), (1.02, 1.82, 0.02), (0.10, 0.96, 0.06), (-0.7, 0.05, 0.16)],
    )  # fmt: skip
    d.screen(FRONT, [(-0.1, 0.962), (0.44, 0.962), (0.66, 0.972), (0.72, 1.01), (0.68, 1.14), (0.635, 1.26),
                     (0.58, 1.345),
                     (0.53, 1.378), (0.40, 1.400), (-0.1, 1.410)])  # fmt: skip
    d.screen(REAR, [(-0.1, 1.090), (0.38, 1.090), (0.53, 1.098), (0.555, 1.13), (0.53, 1.23), (0.48, 1.325),
                    (0.40, 1.355),
                    (-0.1, 1.372)], border=0.03, facing=0.05)  # fmt: skip

    # Front: a grille of mesh in a bright frame, slim lamps of five lights, side intakes with a blade.
    frame = d.draw("chrome", FRONT, smooth_corner([(-0.1, 0.350), (0.30, 0.350), (0.40, 0.400), (0.475, 0.545),
                                                   (0.485, 0.620), (0.44, 0.668), (-0.1, 0.676)]))  # fmt: skip
    inner = d.draw("dark", FRONT, frame.buffer(-0.020))
    pitch = 0.062
    wires = [
        LineString([(k * pitch - 0.5, 0.30), (k * pitch - 0.5 + s * 0.40, 0.70)])
        for k in range(-8, 26)
        for s in (1, -1)
    ]
    mesh = shapely.union_all([wire.buffer(0.0065, cap_style="flat") for wire in wires])
    d.draw("grille", FRONT, mesh.intersection(inner.buffer(-0.003)))
    d.draw("dark", FRONT, outline([(-0.1, 0.485), (0.048, 0.485), (0.048, 0.635), (-0.1, 0.635)], 0.01))
    lamp = [(3.79, 0.505, 0.630), (3.70, 0.66, 0.628), (3.46, 0.83, 0.668), (3.14, 0.90, 0.752), (3.32, 0.86, 0.772),
            (3.58, 0.73, 0.748), (3.76, 0.52, 0.708)]  # fmt: skip
    edge = d.lamp(FRONT_LEFT, lamp, [("gloss_black", 0.0), ("grille", 0.009)])
    brow = stroke(seen(FRONT_LEFT, [lamp[6], lamp[5], lamp[4], lamp[3]]), 0.030)
    d.draw("lamp_white", FRONT_LEFT, brow.intersection(edge.buffer(-0.009)))
    left, right = edge.bounds[0], edge.bounds[2]
    inside = edge.buffer(-0.016)
    for k in range(5):
        position = left + (0.16 + 0.125 * k) * (right - left)
        if Point(seen(FRONT_LEFT, [lamp[0]])[0]).x > edge.centroid.x:
            position = right - (0.16 + 0.125 * k) * (right - left)
        column = inside.intersection(shapely.box(position - 0.017, 0.0, position + 0.017, 2.0))
        if column.is_empty:
            continue
        middle = column.centroid
        spot = shapely.box(middle.x - 0.016, middle.y - 0.016, middle.x + 0.016, middle.y + 0.014).intersection(inside)
        d.draw("lamp", FRONT_LEFT, spot)
    pod = outline(seen(FRONT_LEFT, [(3.72, 0.60, 0.270), (3.55, 0.76, 0.285), (3.46, 0.81, 0.38), (3.52, 0.80, 0.455),
                                    (3.70, 0.64, 0.400)]), 0.012)  # fmt: skip
    d.draw("dark", FRONT_LEFT, pod)
    blade = stroke(seen(FRONT_LEFT, [(3.74, 0.58, 0.305), (3.58, 0.74, 0.325), (3.47, 0.81, 0.405)]), 0.018)
    d.draw("chrome", FRONT_LEFT, blade)
    d.draw("dark", FRONT, outline([(-0.1, 0.245), (0.44, 0.245), (0.50, 0.275), (0.44, 0.310), (-0.1, 0.310)], 0.01))

    # Rear: one thin lamp across the whole car, plate below it, a dark skirt with a bright line.
    d.draw("gloss_black", REAR, shapely.box(-0.1, 0.868, 0.60, 0.952))
    wing = [(-1.03, 0.40, 0.868), (-0.95, 0.66, 0.858), (-0.74, 0.86, 0.850), (-0.50, 0.915, 0.905),
            (-0.56, 0.91, 0.955),
            (-0.74, 0.86, 0.968), (-0.95, 0.66, 0.965), (-1.04, 0.40, 0.952)]  # fmt: skip
    edge = d.lamp(REAR_LEFT, wing, [("gloss_black", 0.0), ("lamp_red", 0.012), ("lamp_dark_red", 0.030)])
    d.draw("lamp_red", REAR, shapely.box(-0.1, 0.882, 0.56, 0.938))
    d.draw("lamp_dark_red", REAR, shapely.box(-0.1, 0.900, 0.60, 0.920))
    d.draw("plate", REAR_LEFT, shapely.box(-9, 0.855, 9, 0.868).intersection(edge.buffer(-0.014)))
    d.draw("cladding", REAR, [(-0.1, 0.215), (0.60, 0.215), (0.66, 0.27), (0.62, 0.335), (-0.1, 0.335)], round_by=0.02)
    d.draw("chrome", REAR, shapely.box(-0.1, 0.338, 0.66, 0.350))
    d.draw("lamp_red", REAR, shapely.box(0.60, 0.42, 0.72, 0.445))

    d.gaps(LEFT, [
        [(2.14, 0.985), (2.14, 0.88), (2.19, 0.70), (2.19, 0.50), (2.15, 0.31), (2.10, 0.255), (1.00, 0.255)],
        [(0.975, 1.0), (0.975, 0.82), (0.985, 0.55), (1.00, 0.255)],
        [(1.00, 0.255), (0.58, 0.255), (0.50, 0.32), (0.45, 0.46), (0.37, 0.63), (0.22, 0.75), (0.10, 0.84),
         (0.05, 1.03)],
        [(2.19, 0.915), (2.6, 0.885), (3.12, 0.800)], [(3.24, 0.715), (3.22, 0.58), (3.19, 0.46)],
        [(-0.42, 0.48), (-0.62, 0.53), (-0.70, 0.70), (-0.70, 0.85)],
    ])  # fmt: skip
    # A bright strip above the sill.
    d.draw("chrome", LEFT, stroke(smooth_line([(2.42, 0.232), (1.5, 0.228), (0.42, 0.232)], 12), 0.014), facing=0.15)
    d.gaps(FRONT, [[(-0.05, 0.712), (0.40, 0.706), (0.49, 0.69)]])
    d.gaps(REAR, [[(-0.05, 0.615), (0.42, 0.615), (0.50, 0.64), (0.56, 0.86)]])
    return d.result()


def smooth_corner(points: list[tuple[float, float]]) -> shapely.geometry.base.BaseGeometry:
    """Return a polygon with well rounded corners."""
    return outline(points, 0.03)


def place_parts() -> tuple[Part, ...]:
    """Return the small solids: those of the left side with a mirror image, and those in the middle."""
    sideways = rot_z(-0.18)
    parts = [
        Part(pillow("paint", (0.12, 0.20, 0.12), 0.6, (16, 11)), (1.99, 0.955, 1.035), sideways, pair=True),
        Part(pillow("gloss_black", (0.10, 0.16, 0.03), 0.5, (10, 5)), (2.01, 0.90, 0.985), pair=True),
        Part(pillow("glass", (0.02, 0.165, 0.095), 0.5, (12, 5)), (1.931, 0.945, 1.035), sideways, pair=True),
        Part(
            pillow("chrome", (0.11, 0.13, 0.062), 0.4, (14, 7)),
            (-0.3, 0.50, 0.275),
            on=REAR,
            shift=(0.045, 0, 0),
            pair=True,
        ),
        Part(
            pillow("dark", (0.11, 0.11, 0.044), 0.4, (14, 7)),
            (-0.3, 0.50, 0.275),
            on=REAR,
            shift=(0.040, 0, 0),
            pair=True,
        ),
    ]
    for x, z in ((1.20, 0.838), (0.26, 0.855)):
        recess = pillow("gap", (0.19, 0.012, 0.040), 0.5, (10, 5))
        handle = pillow("paint", (0.21, 0.034, 0.022), 0.5, (12, 7))
        line = pillow("chrome", (0.20, 0.030, 0.007), 0.4, (12, 5))
        parts.append(Part(recess, (x, 0.3, z), on=LEFT, shift=(0, 0, -0.004), pair=True))
        parts.append(Part(handle, (x, 0.3, z), on=LEFT, shift=(0, 0.010, 0.006), pair=True))
        parts.append(Part(line, (x, 0.3, z), on=LEFT, shift=(0, 0.014, 0.010), pair=True))
    # Emblems of no maker: an upright frame.
    frame = shapely.box(-0.032, -0.058, 0.032, 0.058).difference(shapely.box(-0.021, -0.047, 0.021, 0.047))
    bar = shapely.box(-0.006, -0.058, 0.006, 0.058)
    badge = prism("chrome", bar, 0.012)
    for ring in shapely.get_parts(frame.difference(shapely.box(-1, -0.004, 1, 0.004))):
        badge.add_mesh(prism("chrome", ring, 0.014))
    flip = rot_z(np.pi)
    parts += [
        Part(badge, (3.2, 0, 0.560), on=FRONT, shift=(0.002, 0, 0)),
        Part(plate("MIR 2017"), (3.2, 0, 0.405), on=FRONT, shift=(-0.002, 0, 0)),
        Part(plate("MKZ"), (-0.4, 0, 0.735), flip, on=REAR, shift=(0.004, 0, 0)),
        Part(pillow("gloss_black", (0.14, 0.035, 0.06), 0.8, (16, 9)), (-0.03, 0, 1.345), rot_y(-0.30)),
    ]
    return tuple(parts)


CAR = CarOutline(
    form=FORM,
    wheelbase=2.8498,
    wheel=WheelDesign(radius=0.33, width=0.2, rim_radius=0.2286, rim=FAN_SPOKES),
    arch_radius=0.372,
    arch_inner=0.46,
    regions=draw_regions(),
    parts=place_parts(),
    materials={"paint": Material((0.12, 0.20, 0.44), 0.32, 0.15)},
)


def write(folder: Path) -> dict[str, Mesh]:
    """Write both meshes into a folder; return them by name."""
    return write_outline(folder, CAR, generator="mirdrake tools/meshes/mkz.py")


if __name__ == "__main__":
    target = Path(__file__).resolve().parents[2] / "models" / "mkz" / "meshes"
    for line in describe(target, write(target)):
        print(line)
