"""Generate the visual meshes of the Ford Escape Hybrid 2008: ``body.gltf`` and ``wheel.gltf`` (with ``.bin`` files).

The car is modelled from scratch: the outlines below are all there is of it; ``tools.meshes.outlines`` makes the
meshes of them. Frames are ISO 8855 (x forward, y left, z up; metres). The origin of the body is on the ground below the
centre of the rear axle; that of the wheel is at its centre, spinning about y.

Usage: ``python -m tools.meshes.catvehicle`` writes them into ``models/catvehicle/meshes``; the result is deterministic.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import shapely
from shapely.geometry import Point

from mirdrake.vehicles.bodywork.mesh import Material, Mesh
from tools.meshes.outlines.car import CarOutline, describe, write_outline
from tools.meshes.outlines.curves import curve
from tools.meshes.outlines.drawing import Drawing
from tools.meshes.outlines.parts import Part
from tools.meshes.outlines.regions import FRONT, FRONT_LEFT, LEFT, REAR, REAR_LEFT, Region, outline, stroke
from tools.meshes.outlines.shell import Form
from tools.meshes.outlines.solids import pillow, plate, prism, rot_z, tube
from tools.meshes.outlines.wheels import BROAD_SPOKES, WheelDesign, revolve

FORM = Form(
    plan=curve((-0.95, 0.820), (-0.6, 0.872), (-0.2, 0.898), (0.3, 0.903), (2.2, 0.903), (2.65, 0.903), (2.9, 0.896),
               (3.15, 0.872), (3.35, 0.826), (3.52, 0.745)),
    side_inset=curve((0.18, 0.09), (0.28, 0.042), (0.36, 0.022), (0.50, 0.016), (0.70, 0.010), (0.90, 0.000),
                     (1.00, 0.003), (1.08, 0.022), (1.20, 0.07)),
    nose=curve((0.20, 3.40), (0.30, 3.475), (0.42, 3.518), (0.55, 3.524), (0.66, 3.518), (0.72, 3.495), (0.85, 3.485),
               (0.98, 3.455), (1.06, 3.39), (1.15, 3.20)),
    tail=curve((0.22, -0.77), (0.32, -0.860), (0.42, -0.903), (0.55, -0.913), (0.64, -0.905), (0.71, -0.868),
               (0.85, -0.858),
               (1.00, -0.852), (1.10, -0.83), (1.2, -0.75)),
    deck=curve((-1.0, 1.125), (0.5, 1.120), (1.7, 1.115), (2.2, 1.110), (2.7, 1.092), (3.1, 1.066), (3.3, 1.042),
               (3.42, 1.005), (3.50, 0.94), (3.7, 0.75)),
    bottom=curve((-0.9, 0.36), (-0.5, 0.26), (-0.25, 0.210), (2.9, 0.210), (3.2, 0.23), (3.52, 0.28)),
    roof=curve((-1.0, 1.660), (-0.6, 1.690), (-0.2, 1.709), (0.4, 1.720), (0.9, 1.718), (1.2, 1.704), (1.42, 1.666),
               (1.6, 1.588), (1.85, 1.415), (2.1, 1.218), (2.4, 0.97), (2.8, 0.65), (3.6, 0.0), (5.0, -1.0)),
    cabin_plan=curve((-0.95, 0.742), (-0.6, 0.785), (-0.2, 0.808), (0.3, 0.822), (1.6, 0.824), (2.1, 0.812),
                     (2.6, 0.77)),
    cabin_taper=curve((0.85, 0.08), (1.00, 0.015), (1.12, 0.0), (1.3, 0.028), (1.5, 0.075), (1.65, 0.125),
                      (1.75, 0.18)),
    cabin_tail=curve((0.85, -0.76), (1.05, -0.842), (1.15, -0.845), (1.3, -0.822), (1.5, -0.768), (1.65, -0.705),
                     (1.75, -0.62)),
    half_width=0.903, spine=(-0.30, 2.95), spine_height=curve((-0.6, 0.88), (1.5, 0.84), (3.2, 0.70)),
    nose_sweep=(0.21, 2.8, 0.4), tail_sweep=(0.09, 3.0, 0.3), deck_crown=0.030, ridge=(0.022, 0.58, 0.09, 1.9, 0.5),
    roof_sweep=0.16, roof_crown=0.040, back_sweep=(0.09, 2.6, 1.05), flare=(0.018, 0.465, 0.05),
    blends=(0.02, 0.065, 0.075, 0.04, 0.075, 0.06, 0.04),
)  # fmt: skip


def draw_regions() -> tuple[Region, ...]:
    """Return everything that is drawn on the body, in the order of drawing."""
    d = Drawing()
    d.underbody([(-1.1, 0.66), (-0.40, 0.66), (0.40, 0.42), (2.2, 0.42), (3.06, 0.50),
                 (4, 0.50)], front=0.50, rear=0.66,
                arch=0.052)  # fmt: skip
    d.side_windows(
        belt=[(2.10, 1.150), (1.8, 1.150), (1.2, 1.152), (0.5, 1.158), (0.0, 1.165), (-0.55, 1.178)],
        rail=[(-0.60, 1.560), (0.0, 1.592), (0.4, 1.602), (0.9, 1.604), (1.2, 1.595), (1.38, 1.565), (1.60, 1.455)],
        back=[(-0.70, 1.20), (-0.68, 1.40)], front=[(1.86, 1.285), (2.00, 1.20)],
        panes=[(1.78, 2.3, 0.0), (0.92, 1.74, 0.0), (0.10, 0.85, 0.03), (-0.8, -0.02, 0.14)], frame=0.022,
    )  # fmt: skip
    d.screen(FRONT, [(-0.1, 1.128), (0.50, 1.125), (0.69, 1.135), (0.735, 1.17), (0.715, 1.32), (0.69, 1.45),
                     (0.66, 1.56),
                     (0.61, 1.615), (0.45, 1.632), (-0.1, 1.640)])  # fmt: skip
    d.screen(REAR, [(-0.1, 1.165), (0.60, 1.170), (0.66, 1.21), (0.665, 1.38), (0.62, 1.56), (0.52, 1.595),
                    (-0.1, 1.605)],
             border=0.035, facing=0.2)  # fmt: skip

    # Front: an upright grille with a bright frame and three bars, tall lamps, a bumper with intake and fog lamps.
    frame = d.draw("chrome", FRONT, [(-0.1, 0.715), (0.36, 0.715), (0.43, 0.76), (0.455, 0.955), (0.42, 0.985),
                                     (-0.1, 0.990)], round_by=0.015)  # fmt: skip
    inner = d.draw("dark", FRONT, frame.buffer(-0.022))
    d.bars(FRONT, inner, (0.795, 0.852, 0.908), thick=0.030, material="chrome")
    intake = d.draw(
        "dark", FRONT, [(-0.1, 0.395), (0.42, 0.395), (0.47, 0.43), (0.45, 0.525), (-0.1, 0.525)], round_by=0.02
    )
    d.bars(FRONT, intake.buffer(-0.012), (0.44, 0.485), thick=0.014, material="grille")
    d.draw("lamp", FRONT, shapely.box(-0.1, 0.30, 0.36, 0.345))
    lamp = [(3.46, 0.49, 0.755), (3.36, 0.70, 0.765), (3.12, 0.83, 0.790), (2.93, 0.89, 0.860), (2.98, 0.88, 0.985),
            (3.20, 0.80, 1.010), (3.38, 0.66, 1.005), (3.44, 0.49, 0.985)]  # fmt: skip
    edge = d.lamp(FRONT_LEFT, lamp, [("gloss_black", 0.0), ("lamp", 0.012)])
    left, low, right, high = edge.bounds
    side_on = (
        left if edge.intersection(shapely.box(left, low, left + 0.05, high)).centroid.y > (low + high) / 2 else right
    )
    outer = shapely.box(min(side_on, side_on - np.sign(side_on - edge.centroid.x) * 0.11), low,
                        max(side_on, side_on - np.sign(side_on - edge.centroid.x) * 0.11), high)  # fmt: skip
    d.draw("amber", FRONT_LEFT, outer.intersection(edge.buffer(-0.014)))
    middle = edge.centroid
    for shift, radius in ((0.075, 0.062), (-0.062, 0.056)):
        spot = (
            Point(middle.x + np.sign(side_on - middle.x) * -shift, middle.y)
            .buffer(radius)
            .intersection(edge.buffer(-0.018))
        )
        d.draw("gloss_black", FRONT_LEFT, spot)
        d.draw("lamp_white", FRONT_LEFT, spot.buffer(-0.016))
    fog = Point(0.60, 0.445)
    d.draw("dark", FRONT, fog.buffer(0.062, quad_segs=6))
    d.draw("lamp", FRONT, fog.buffer(0.046, quad_segs=6))
    d.draw("lamp_white", FRONT, fog.buffer(0.028, quad_segs=5))

    # Rear: upright lamps at the corners, plate recess with a bright bar, bumper with reflectors.
    tail = [(-0.862, 0.685, 0.735), (-0.72, 0.87, 0.735), (-0.60, 0.90, 0.76), (-0.60, 0.90, 1.125),
            (-0.72, 0.85, 1.155),
            (-0.83, 0.70, 1.140)]  # fmt: skip
    edge = d.lamp(REAR_LEFT, tail, [("gloss_black", 0.0), ("lamp_red", 0.009)])
    for low, high, material in ((0.905, 0.985, "plate"), (0.86, 0.90, "amber")):
        band = shapely.box(edge.bounds[0], low, edge.bounds[2], high).intersection(edge.buffer(-0.020))
        d.draw(material, REAR_LEFT, band)
    d.draw("cladding", REAR, [(-0.1, 0.80), (0.32, 0.80), (0.34, 0.945), (-0.1, 0.945)], round_by=0.01)
    d.draw("chrome", REAR, shapely.box(-0.1, 0.955, 0.40, 0.985))
    d.draw("lamp_red", REAR, shapely.box(0.56, 0.50, 0.72, 0.535))
    d.draw("grille", REAR, shapely.box(-0.1, 0.575, 0.62, 0.585))

    d.gaps(LEFT, [
        [(1.98, 1.15), (1.98, 1.00), (2.01, 0.85), (2.02, 0.66), (2.0, 0.45)],
        [(0.87, 1.155), (0.87, 0.95), (0.885, 0.70), (0.90, 0.43)],
        [(0.60, 0.43), (0.56, 0.58), (0.46, 0.72), (0.26, 0.86), (0.08, 0.95), (0.04, 1.165)],
        [(2.01, 1.055), (2.6, 1.040), (2.98, 1.015)], [(3.10, 0.78), (3.09, 0.62), (3.06, 0.52)],
        [(-0.48, 0.62), (-0.68, 0.66)],
    ])  # fmt: skip
    d.gaps(FRONT, [[(-0.05, 1.012), (0.48, 1.010)]])
    d.gaps(REAR, [[(-0.05, 0.70), (0.66, 0.70), (0.69, 0.73)], [(0.69, 1.14), (0.70, 1.55)]])
    d.draw("gap", LEFT, outline([(-0.34, 0.86), (-0.20, 0.86), (-0.20, 1.0),
                                 (-0.34, 1.0)], 0.02).boundary.buffer(0.0025),
           facing=0.25, only=("paint",))  # fmt: skip
    for x, z in ((1.43, 0.60), (0.50, 0.62)):  # rubbing strip on the doors
        shape = shapely.box(x - 0.48 if x > 1 else 0.62, z - 0.035, x + 0.52 if x > 1 else 0.86, z + 0.035)
        d.draw("cladding", LEFT, shape, facing=0.25, only=("paint",))
    d.draw("chrome", LEFT, stroke([(2.20, 0.86), (2.40, 0.865)], 0.035), facing=0.25, only=("paint",))
    return d.result()


def sensor_head() -> Mesh:
    """Return the roof rack's load about the middle of its front bar: a platform, a spinning lidar, a camera head."""
    mesh = Mesh()
    mesh.add_mesh(pillow("rim_machined", (0.62, 0.80, 0.022), 0.15), None, (-0.22, 0, 0.020))
    can = [(-0.045, 0.0), (-0.045, 0.055), (0.045, 0.055), (0.045, 0.0)]
    upright = np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]])  # takes y up
    bracket = [(-0.03, 0.0), (-0.03, 0.085), (0.03, 0.06), (0.03, 0.0)]
    mesh.add_mesh(revolve("cladding", bracket, 24, smooth=False), upright, (-0.10, 0, 0.060))
    mesh.add_mesh(revolve("grille", [(y * 0.8, r) for y, r in can], 32, smooth=False), upright, (-0.10, 0, 0.125))
    mesh.add_mesh(
        revolve("accent", [(y * 0.32, r * 1.03) for y, r in can], 32, smooth=False), upright, (-0.10, 0, 0.128)
    )
    mesh.add_mesh(pillow("cladding", (0.09, 0.30, 0.07), 0.3), None, (0.08, 0, 0.065))
    for y in (-0.11, 0.0, 0.11):
        mesh.add_mesh(pillow("gloss_black", (0.02, 0.045, 0.045), 0.8, (14, 7)), None, (0.125, y, 0.068))
        mesh.add_mesh(pillow("glass", (0.014, 0.03, 0.03), 0.9, (12, 7)), None, (0.134, y, 0.068))
    mesh.add_mesh(pillow("plate", (0.13, 0.13, 0.05), 0.7), None, (-0.40, 0.24, 0.055))
    mesh.add_mesh(pillow("cladding", (0.22, 0.30, 0.07), 0.2), None, (-0.38, -0.18, 0.065))
    return mesh


def place_parts() -> tuple[Part, ...]:
    """Return the small solids: those of the left side with a mirror image, and those in the middle."""
    sideways = rot_z(-0.15)
    parts = [
        Part(pillow("cladding", (0.13, 0.22, 0.17), 0.45, (16, 11)), (1.86, 0.985, 1.205), sideways, pair=True),
        Part(pillow("gloss_black", (0.09, 0.20, 0.04), 0.5, (10, 5)), (1.88, 0.885, 1.145), pair=True),
        Part(pillow("glass", (0.02, 0.19, 0.14), 0.4, (12, 5)), (1.798, 0.975, 1.205), sideways, pair=True),
    ]
    for x, z in ((1.02, 1.0), (0.16, 1.01)):
        recess = pillow("gap", (0.17, 0.012, 0.055), 0.5, (10, 5))
        handle = pillow("cladding", (0.18, 0.034, 0.032), 0.5, (12, 7))
        parts.append(Part(recess, (x, 0.3, z), on=LEFT, shift=(0, 0, -0.004), pair=True))
        parts.append(Part(handle, (x, 0.3, z), on=LEFT, shift=(0, 0.010, 0.006), pair=True))
    # Rails along the roof, bars across them, and what they carry.
    rail = [(-0.52, 0.56, 1.70), (-0.44, 0.56, 1.745), (1.02, 0.56, 1.755), (1.12, 0.56, 1.715)]
    parts.append(Part(tube("cladding", rail, 0.018), (0, 0, 0), pair=True))
    parts.append(Part(pillow("cladding", (0.10, 0.05, 0.07), 0.5, (10, 5)), (0.30, 0.56, 1.715), pair=True))
    parts += [Part(tube("grille", [(0, -0.60, 1.775), (0, 0.60, 1.775)], 0.016), (x, 0, 0)) for x in (1.0, 0.58)]
    parts.append(Part(sensor_head(), (1.0, 0, 1.785)))
    angles = np.linspace(0.0, 2.0 * np.pi, 28, endpoint=False)

    def oval(size: float) -> shapely.geometry.base.BaseGeometry:
        return outline([(0.095 * size * float(np.cos(a)), 0.038 * size * float(np.sin(a))) for a in angles])

    flip = rot_z(np.pi)
    parts += [
        Part(prism("chrome", oval(1.0), 0.014), (3.0, 0, 0.852), on=FRONT, shift=(-0.001, 0, 0)),
        Part(prism("badge", oval(0.88), 0.018), (3.0, 0, 0.852), on=FRONT, shift=(-0.001, 0, 0)),
        Part(prism("badge", oval(0.62), 0.010), (-0.3, 0.0, 1.045), flip, on=REAR, shift=(0.003, 0, 0)),
        Part(plate("CAT 2008"), (3.0, 0, 0.60), on=FRONT, shift=(-0.005, 0, 0)),
        Part(plate("ESCAPE"), (-0.3, 0, 0.872), flip, on=REAR, shift=(0.002, 0, 0)),
        Part(pillow("lamp_red", (0.02, 0.26, 0.02), 0.4, (12, 7)), (-0.3, 0, 1.632), on=REAR, shift=(0, 0, 0)),
    ]
    return tuple(parts)


CAR = CarOutline(
    form=FORM,
    wheelbase=2.619,
    wheel=WheelDesign(radius=0.3672, width=0.2336, rim_radius=0.215, rim=BROAD_SPOKES),
    arch_radius=0.425,
    arch_inner=0.42,
    regions=draw_regions(),
    parts=place_parts(),
    materials={
        "paint": Material((0.90, 0.91, 0.91), 0.38, 0.0),
        "cladding": Material((0.33, 0.34, 0.35), 0.75),
        "badge": Material((0.05, 0.13, 0.42), 0.4, 0.1),
    },
)


def write(folder: Path) -> dict[str, Mesh]:
    """Write both meshes into a folder; return them by name."""
    return write_outline(folder, CAR, generator="mirdrake tools/meshes/catvehicle.py")


if __name__ == "__main__":
    target = Path(__file__).resolve().parents[2] / "models" / "catvehicle" / "meshes"
    for line in describe(target, write(target)):
        print(line)
