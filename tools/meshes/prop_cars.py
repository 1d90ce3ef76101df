"""The parked cars: bodies by ``tools.meshes.outlines``, coarser than those of vehicles that are driven."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import shapely
from shapely.geometry import Point

from mirdrake.vehicles.bodywork.mesh import Mesh
from tools.meshes.outlines.car import CarOutline, build_body, build_skin
from tools.meshes.outlines.curves import curve
from tools.meshes.outlines.drawing import Drawing
from tools.meshes.outlines.parts import Part
from tools.meshes.outlines.regions import FRONT, FRONT_LEFT, LEFT, REAR, REAR_LEFT
from tools.meshes.outlines.sedan import fit, sedan
from tools.meshes.outlines.shell import Form, half_shell
from tools.meshes.outlines.solids import pillow, rot_z
from tools.meshes.outlines.wheels import WheelDesign, revolve, sector, wheel_face


def parked_wheel(radius: float, width: float, spokes: int) -> Mesh:
    """Return a wheel that looks to the left and nowhere else, about its centre, spinning about y."""
    mesh = Mesh()
    rim, h = 0.66 * radius, width / 2
    profile = [(-h, rim), (-h, radius - 0.02), (-h + 0.025, radius), (h - 0.025, radius), (h, radius - 0.022),
               (h + 0.002, 0.5 * (rim + radius)), (h - 0.004, rim + 0.006)]  # fmt: skip
    mesh.add_mesh(revolve("rubber", profile, 24))
    mesh.add_mesh(revolve("rim_machined", [(h - 0.004, rim + 0.006), (h - 0.006, rim - 0.012)], 24, smooth=False))
    mesh.add_mesh(revolve("rim_dark", [(h - 0.006, rim - 0.012), (h - 0.07, rim - 0.02)], 24, smooth=False))
    mesh.add_mesh(wheel_face("rim_shadow", Point(0, 0).buffer(rim - 0.012, quad_segs=6), h - 0.07))
    arms = [sector(0.05, rim - 0.008, a - 10, a + 10, count=3) for a in 90 + 360.0 / spokes * np.arange(spokes)]
    star = shapely.union_all([*arms, Point(0, 0).buffer(0.30 * rim, quad_segs=4)])
    mesh.add_mesh(wheel_face("rim_machined", star, h - 0.022, skirt=0.03, skirt_material="rim_dark"))
    mesh.add_mesh(wheel_face("rim_dark", Point(0, 0).buffer(0.13 * rim, quad_segs=4), h - 0.016, skirt=0.006))
    inner = Mesh()
    inner.add_mesh(wheel_face("dark", Point(0, 0).buffer(rim, quad_segs=6), h))
    mesh.add_mesh(inner.mirrored())
    return mesh


def _car(outline: CarOutline, shell: tuple[np.ndarray, np.ndarray], track: float, spokes: int) -> Mesh:
    """Return a car on its wheels, origin on the ground below the middle of the axles."""
    mesh = Mesh()
    body = build_body(outline, shell=shell)
    wheel = parked_wheel(outline.wheel.radius, outline.wheel.width, spokes)
    mesh.add_mesh(body)
    for x in (0.0, outline.wheelbase):
        left = Mesh()
        left.add_mesh(wheel, None, (x, track / 2, outline.wheel.radius))
        mesh.add_mesh(left)
        mesh.add_mesh(left.mirrored())
    return mesh


def make_sedan() -> Mesh:
    """Return a four-door sedan, 4.5 m x 1.8 m x 1.45 m without the mirrors."""
    style = sedan()
    regions = tuple(r for r in style.regions if not (r.material == "chrome" and r.view == LEFT))  # too fine for it
    style = replace(style, form=replace(style.form, mesh=(19, 7, 16)), regions=regions)
    sizes = {
        "wheelbase": 2.65, "track": 1.54, "length": 4.5, "width": 1.8, "height": 1.45, "wheel_radius": 0.316,
        "wheel_width": 0.205, "ground_clearance": 0.15, "front_overhang": 0.87,
    }  # fmt: skip
    shell = half_shell(style.skin)
    car = fit(style, sizes, points=shell[0])
    car = replace(car, arch_radius=0.352, arch_inner=0.50)
    return _car(car, shell, 1.54, 10)


def _van_form() -> Form:
    return Form(
        plan=curve((-1.10, 0.930), (-0.9, 0.968), (-0.5, 0.985), (0.3, 0.990), (2.6, 0.990), (3.0, 0.985),
                   (3.3, 0.960), (3.55, 0.905), (3.75, 0.815), (3.89, 0.70)),
        side_inset=curve((0.18, 0.09), (0.28, 0.042), (0.36, 0.020), (0.55, 0.014), (0.80, 0.004), (0.95, 0.0),
                         (1.05, 0.006), (1.20, 0.030), (1.35, 0.08)),
        nose=curve((0.18, 3.72), (0.28, 3.825), (0.40, 3.880), (0.55, 3.890), (0.75, 3.875), (0.92, 3.825),
                   (1.02, 3.74), (1.12, 3.55)),
        tail=curve((0.22, -0.98), (0.34, -1.055), (0.48, -1.078), (0.62, -1.075), (0.72, -1.055), (0.95, -1.055),
                   (1.15, -1.045), (1.3, -0.98)),
        deck=curve((-1.2, 1.24), (1.8, 1.235), (2.6, 1.220), (3.0, 1.185), (3.3, 1.120), (3.55, 1.040), (3.72, 0.95),
                   (3.9, 0.78)),
        bottom=curve((-1.1, 0.36), (-0.7, 0.27), (-0.4, 0.220), (3.2, 0.220), (3.6, 0.235), (3.9, 0.28)),
        roof=curve((-1.2, 1.900), (-0.95, 1.945), (-0.5, 1.975), (0.4, 1.988), (1.3, 1.985), (1.7, 1.968),
                   (1.95, 1.915), (2.15, 1.820), (2.4, 1.655), (2.7, 1.425), (3.0, 1.19), (3.4, 0.86), (4.0, 0.35),
                   (5.0, -0.5)),
        cabin_plan=curve((-1.1, 0.880), (-0.8, 0.915), (-0.3, 0.935), (0.4, 0.942), (2.0, 0.940), (2.6, 0.915),
                         (3.1, 0.86)),
        cabin_taper=curve((1.0, 0.03), (1.15, 0.0), (1.3, 0.010), (1.5, 0.042), (1.7, 0.085), (1.85, 0.130),
                          (2.0, 0.19)),
        cabin_tail=curve((0.9, -1.02), (1.15, -1.045), (1.3, -1.040), (1.5, -1.015), (1.75, -0.965), (1.9, -0.92),
                         (2.0, -0.85)),
        half_width=0.990, spine=(-0.45, 2.95), spine_height=curve((-0.8, 1.02), (1.8, 0.98), (2.8, 0.86), (3.3, 0.76)),
        nose_sweep=(0.22, 2.7, 0.4), tail_sweep=(0.05, 3.4, 0.2), deck_crown=0.040, ridge=(0.014, 0.60, 0.10, 2.4, 0.6),
        roof_sweep=0.16, roof_crown=0.030, back_sweep=(0.05, 3.0, 1.05), flare=(0.016, 0.43, 0.05),
        blends=(0.02, 0.09, 0.085, 0.05, 0.09, 0.07, 0.05), cabin_floor=0.8, middle=1.2, mesh=(22, 8, 20),
    )  # fmt: skip


def make_van() -> Mesh:
    """Return a panel van with windows in front, 5.0 m x 2.0 m x 2.0 m without the mirrors."""
    d = Drawing()
    d.underbody([(-1.3, 0.44), (-0.40, 0.44), (0.42, 0.36), (2.5, 0.36), (3.35, 0.42), (4.2, 0.42)], front=0.42,
                rear=0.50, arch=0.035)  # fmt: skip
    d.side_windows(
        belt=[(2.76, 1.235), (2.4, 1.222), (1.9, 1.225), (1.48, 1.25)],
        rail=[(1.50, 1.72), (1.7, 1.79), (1.95, 1.765), (2.15, 1.690), (2.45, 1.490)],
        back=[(1.44, 1.30), (1.45, 1.62)], front=[(2.64, 1.34)],
        panes=[(2.36, 3.0, 0.0), (1.2, 2.31, 0.0)], frame=0.022,
    )  # fmt: skip
    d.screen(FRONT, [(-0.1, 1.275), (0.55, 1.275), (0.75, 1.290), (0.82, 1.33), (0.81, 1.45), (0.775, 1.62),
                     (0.73, 1.78), (0.68, 1.845), (0.50, 1.875), (-0.1, 1.885)])  # fmt: skip
    d.screen(REAR, [(0.06, 1.25), (0.66, 1.255), (0.72, 1.29), (0.70, 1.50), (0.66, 1.68), (0.60, 1.735),
                    (0.06, 1.745)], border=0.03, facing=0.2)  # fmt: skip
    grille = d.draw("gloss_black", FRONT, [(-0.1, 0.735), (0.44, 0.735), (0.52, 0.80), (0.50, 0.90), (-0.1, 0.915)],
                    round_by=0.015)  # fmt: skip
    d.bars(FRONT, grille.buffer(-0.014), (0.785, 0.845), thick=0.018, material="chrome")
    intake = d.draw("dark", FRONT, [(-0.1, 0.46), (0.56, 0.46), (0.64, 0.52), (0.58, 0.62), (-0.1, 0.62)],
                    round_by=0.02)  # fmt: skip
    d.bars(FRONT, intake.buffer(-0.015), (0.54,), thick=0.018, material="cladding")
    head = [(3.80, 0.55, 0.76), (3.68, 0.75, 0.775), (3.45, 0.92, 0.80), (3.20, 0.965, 0.93), (3.38, 0.93, 1.01),
            (3.58, 0.82, 0.99), (3.76, 0.58, 0.92)]  # fmt: skip
    bezel = d.lamp(FRONT_LEFT, head, [("gloss_black", 0.0), ("lamp", 0.014)])
    spot = bezel.centroid.buffer(0.055, quad_segs=4)
    d.draw("gloss_black", FRONT_LEFT, spot)
    d.draw("lamp_white", FRONT_LEFT, spot.buffer(-0.016))
    tail = [(-1.04, 0.80, 0.80), (-0.95, 0.93, 0.79), (-0.84, 0.97, 0.82), (-0.84, 0.95, 1.20), (-0.93, 0.91, 1.24),
            (-1.03, 0.80, 1.23)]  # fmt: skip
    edge = d.lamp(REAR_LEFT, tail, [("gloss_black", 0.0), ("lamp_red", 0.010)])
    for low, high, material in ((0.98, 1.04, "plate"), (0.91, 0.965, "amber")):
        d.draw(material, REAR_LEFT, shapely.box(-9, low, 9, high).intersection(edge.buffer(-0.020)))
    d.draw("plate", REAR, shapely.box(-0.1, 0.66, 0.26, 0.77))
    d.gaps(LEFT, [
        [(2.72, 1.22), (2.74, 1.00), (2.76, 0.70), (2.70, 0.40)],
        [(1.40, 1.80), (1.40, 0.40)], [(0.20, 1.86), (0.20, 0.78)],
        [(1.36, 1.10), (-0.60, 1.10)],
    ], width=0.010)  # fmt: skip
    d.gaps(FRONT, [[(-0.05, 0.955), (0.50, 0.950), (0.60, 0.935)]], width=0.010)
    d.gaps(REAR, [[(0.0, 0.56), (0.0, 1.88)], [(-0.05, 0.56), (0.90, 0.56)]], width=0.014)
    mirror = rot_z(-0.15)
    parts = [
        Part(pillow("cladding", (0.12, 0.20, 0.26), 0.45, (12, 7)), (2.50, 1.075, 1.36), mirror, pair=True),
        Part(pillow("glass", (0.02, 0.17, 0.22), 0.4, (8, 5)), (2.442, 1.070, 1.36), mirror, pair=True),
        Part(pillow("cladding", (0.08, 0.16, 0.05), 0.5, (8, 5)), (2.54, 0.98, 1.26), pair=True),
    ]
    for x in (1.62, 1.20):
        handle = pillow("cladding", (0.20, 0.040, 0.036), 0.5, (8, 5))
        parts.append(Part(handle, (x, 0.3, 1.06), on=LEFT, shift=(0, 0.012, 0), pair=True))
    car = CarOutline(
        form=_van_form(), wheelbase=2.93, wheel=WheelDesign(0.335, 0.215, 0.22), arch_radius=0.378, arch_inner=0.60,
        regions=d.result(), parts=tuple(parts),
    )  # fmt: skip
    return _car(car, half_shell(build_skin(car)), 1.70, 8)
