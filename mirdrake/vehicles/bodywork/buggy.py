"""An open low car for small robots: floor plate, hull, bumpers, side bars, roll cage, electronics box and lamps."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from shapely.geometry import Polygon

from mirdrake.vehicles.bodywork.car import arch_clearance
from mirdrake.vehicles.bodywork.curves import curve
from mirdrake.vehicles.bodywork.gltf import Mesh
from mirdrake.vehicles.bodywork.solids import pillow, prism, tube
from mirdrake.vehicles.bodywork.wheels import WheelDesign

_UP = np.array([[0.0, 0, -1], [0, 1, 0], [1, 0, 0]])  # takes x up, and z backwards
_SECTIONS, _AROUND = 40, 32


def build_buggy(sizes: Mapping[str, float], *, steering: float) -> Mesh:
    """Return the body of an open car.

    Args:
        sizes: as the arguments of :func:`mirdrake.vehicles.bodywork.generic.write_car`; about 4 m long.
        steering: largest angle of a front wheel that must stay clear [rad].
    """
    length, width, height, base = (sizes[name] for name in ("length", "width", "height", "wheelbase"))
    clearance, radius = sizes["ground_clearance"], sizes["wheel_radius"]
    front = base + sizes["front_overhang"]
    rear = front - length
    tall = height - clearance
    bar = min(0.05, 0.10 * tall, 0.05 * width)  # radius of bumpers and side bars
    wheel = WheelDesign(radius, sizes["wheel_width"], 0.5 * radius)
    reach, inwards = arch_clearance(wheel, steering)
    least = 0.10 * width
    # Half widths of what may lie beside the steered front wheels, beside the rear wheels and between the axles.
    ahead = max(sizes["track"] / 2 - inwards - 0.03, least)
    behind = max(sizes["track"] / 2 - sizes["wheel_width"] / 2 - 0.05, least)
    between = max(min(0.36 * width, width / 2 - 3 * bar), ahead)
    low_x, high_x = radius + 0.10, base - reach - 0.10  # room between the wheels

    mesh = Mesh()
    start, end = rear + 2 * bar, front - 2 * bar
    gap = high_x - low_x
    if gap < 0.2:  # the wheels leave no room to be wide between them
        between = min(ahead, behind)
    knots = np.array([start, 0.0, low_x - 0.05, low_x + 0.25 * gap, high_x - 0.25 * gap, high_x + 0.08, base, end])
    knots = np.maximum.accumulate(knots) + 1e-6 * np.arange(len(knots))
    wides = (0.8 * behind, behind, behind, max(between, behind), between, ahead, 0.96 * ahead, 0.62 * ahead)
    plan = curve(*zip(knots.tolist(), wides, strict=True))
    xs = np.linspace(start, end, 48)
    half = plan(xs)
    edge = [(y, -x) for x, y in zip(xs, half, strict=True)] + [
        (-y, -x) for x, y in zip(xs[::-1], half[::-1], strict=True)
    ]
    thick = 0.05 * tall
    mesh.add_mesh(prism("cladding", Polygon(edge), thick), _UP, (0, 0, clearance))

    # The hull: a nose that rises to the cockpit, a flat cockpit rim, a cover over the rear axle.
    knots = np.array([start, 0.0, 0.30 * base, 0.55 * base, 0.80 * base, base, end])
    knots = np.maximum.accumulate(knots) + 1e-6 * np.arange(len(knots))
    top = curve(*zip(knots.tolist(), (0.34, 0.46, 0.47, 0.40, 0.37, 0.33, 0.15), strict=True))
    x = np.linspace(start + 0.02, end - 0.02, _SECTIONS)
    floor = clearance + thick
    rise, wide = top(x) * tall, 0.90 * plan(x)
    mesh.add_mesh(_hull("paint", x, wide, floor, rise))
    stripe = x[x > 0.62 * base]
    stripe[-1] += 0.008
    half_stripe = np.minimum(0.12 * width, 0.55 * wide[x > 0.62 * base])
    mesh.add_mesh(_hull("rim_machined", stripe, half_stripe, floor, top(stripe) * tall + 0.006))
    # Cockpit: a dark well with a box of electronics.
    well = (0.26 * base, 0.64 * base)
    deck = floor + float(top(np.array(0.45 * base))) * tall
    middle = (well[0] + well[1]) / 2
    mesh.add_mesh(pillow("dark", (well[1] - well[0], 1.25 * between, 0.12 * tall), 0.3), None, (middle, 0, deck))
    box = 0.34 * (well[1] - well[0])
    mesh.add_mesh(pillow("grille", (2 * box, 0.75 * between, 0.26 * tall), 0.2), None, (middle, 0, deck + 0.08 * tall))
    mesh.add_mesh(
        pillow("accent", (1.5 * box, 0.45 * between, 0.04 * tall), 0.2), None, (middle, 0, deck + 0.21 * tall)
    )

    # Roll cage: a hoop behind the cockpit, a lower one ahead of it, and stays.
    rod = min(0.045, 0.07 * tall)
    hoop_x, screen_x = 0.20 * base, 0.66 * base
    foot, crown = 0.93 * between, 0.62 * between
    hoop_z, screen_z = height - rod, clearance + 0.80 * tall
    for at, lean, high in ((hoop_x, 0.04 * base, hoop_z), (screen_x, -0.10 * base, screen_z)):
        knee = floor + 0.28 * tall
        hoop = [(at, -foot, floor), (at, -foot, knee), (at + 0.6 * lean, -foot, high - 0.25 * tall),
                (at + lean, -crown, high),
                (at + lean, crown, high), (at + 0.6 * lean, foot, high - 0.25 * tall), (at, foot, knee),
                (at, foot, floor)]  # fmt: skip
        mesh.add_mesh(tube("cladding", hoop, rod))
    for side in (-1.0, 1.0):
        roof = [(hoop_x + 0.04 * base, side * crown, hoop_z), (screen_x - 0.10 * base, side * crown, screen_z)]
        mesh.add_mesh(tube("cladding", roof, 0.9 * rod))
        tail_z = floor + 0.8 * float(top(np.array(start))) * tall
        stay = [(hoop_x + 0.04 * base, side * crown, hoop_z - rod), (0.6 * start, side * 0.55 * behind, tail_z)]
        mesh.add_mesh(tube("cladding", stay, 0.9 * rod))

    # Bumpers as wide as the car where the wheels leave room, side bars between the wheels.
    bar_z = clearance + max(bar, 0.14 * tall)
    for at, sign, room, inner in (
        (front, 1.0, sizes["front_overhang"] - reach, ahead),
        (rear, -1.0, -rear - radius, behind),
    ):
        wide_y = width / 2 if room > 4 * bar else min(inner + 2 * bar, width / 2)
        x0 = at - sign * bar
        bend, y0 = sign * min(2.5 * bar, max(room - bar, 0.5 * bar)), wide_y - bar
        points = [
            (x0 - bend, -y0, bar_z),
            (x0, -y0 + 2.5 * bar, bar_z),
            (x0, y0 - 2.5 * bar, bar_z),
            (x0 - bend, y0, bar_z),
        ]
        mesh.add_mesh(tube("cladding", points, bar))
        for side in (-0.4, 0.4):
            strut = [(x0, side * inner, bar_z), (x0 - sign * 6 * bar, side * inner, clearance + thick)]
            mesh.add_mesh(tube("cladding", strut, 0.7 * bar))
    for side in (-1.0, 1.0):
        y = side * (width / 2 - bar)
        if high_x - low_x > 8 * bar:
            inner_y = side * 0.8 * between
            rail = [
                (low_x + bar, inner_y, bar_z),
                (low_x + bar, y, bar_z),
                (high_x - bar, y, bar_z),
                (high_x - bar, inner_y, bar_z),
            ]
            mesh.add_mesh(tube("cladding", rail, bar))
            # Half axles, and the lamps.
        hub = sizes["track"] / 2 - 0.45 * sizes["wheel_width"]
        for axle in (0.0, base):
            mesh.add_mesh(tube("rim_shadow", [(axle, 0.0, radius), (axle, side * hub, radius)], 0.12 * radius))
        nose_x = base + 0.45 * (end - base)
        nose_z = floor + 0.92 * float(top(np.array(nose_x))) * tall
        lamp = 0.075 * tall
        mesh.add_mesh(
            pillow("cladding", (2.0 * lamp, 2.6 * lamp, 2.6 * lamp), 0.8), None, (nose_x, side * 0.42 * ahead, nose_z)
        )
        lens_at = (nose_x + 0.75 * lamp, side * 0.42 * ahead, nose_z)
        mesh.add_mesh(pillow("lamp_white", (0.9 * lamp, 2.0 * lamp, 2.0 * lamp), 0.8), None, lens_at)
        tail_at = (start + 0.02, side * 0.5 * behind, floor + 0.5 * float(top(np.array(start))) * tall)
        mesh.add_mesh(pillow("lamp_red", (0.06, 0.3 * behind, 0.1 * tall), 0.4), None, tail_at)
    return mesh


def _hull(material: str, x: np.ndarray, half: np.ndarray, floor: float, rise: np.ndarray) -> Mesh:
    """A shell over a level floor with rounded shoulders, of half widths and heights over x, closed at both ends."""
    mesh = Mesh()
    a = np.linspace(0.0, np.pi, _AROUND + 1)
    e = 0.45
    round_y, round_z = np.sign(np.cos(a)) * np.abs(np.cos(a)) ** e, np.abs(np.sin(a)) ** e
    round_z[[0, -1]] = 0.0
    p = np.stack([
        np.broadcast_to(x[:, None], (len(x), len(a))), half[:, None] * round_y, floor + rise[:, None] * round_z,
    ], axis=-1)  # fmt: skip
    across = np.gradient(p, axis=1)
    along = np.gradient(p, axis=0)
    n = np.cross(along, across)
    n /= np.maximum(np.linalg.norm(n, axis=-1, keepdims=True), 1e-12)
    centre = np.stack([x, 0 * x, floor + 0 * x], axis=-1)[:, None]
    n *= np.where(((p - centre) * n).sum(-1, keepdims=True) < 0, -1.0, 1.0)
    mesh.add_grid(material, p, n)
    for k, sign in ((0, -1.0), (-1, 1.0)):
        ring = p[k]
        hub = np.broadcast_to(np.array([x[k], 0.0, floor]), ring[1:].shape)
        mesh.add_flat(material, np.stack([hub, ring[:-1], ring[1:]], axis=1), (sign, 0, 0))
    return mesh
