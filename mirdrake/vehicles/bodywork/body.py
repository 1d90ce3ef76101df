"""Bodies and wheels of new vehicles in a given size: :func:`write_car`."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
import shapely
from shapely.geometry import LineString, Point

from mirdrake.core.errors import ModelError
from mirdrake.vehicles.bodywork.mesh import MATERIALS, Material, Mesh
from mirdrake.vehicles.bodywork.robot import build_robot, build_truck_bed
from mirdrake.vehicles.bodywork.shapes import Array, rounded_box, triangulate
from mirdrake.vehicles.bodywork.shell import (
    BELOW,
    FRONT,
    FRONT_LEFT,
    LEFT,
    REAR,
    REAR_LEFT,
    Curves,
    Frame,
    Shell,
    seen,
)
from mirdrake.vehicles.bodywork.sizes import BodySize, arch_clearance
from mirdrake.vehicles.bodywork.wheels import build_wheel

_LENGTH = 4.2  # bodies are made in this length and scaled at the end, so that details keep their proportions [m]


@dataclass(frozen=True)
class Style:
    """A kind of body.

    Attributes:
        color: colour of the paint, sRGB.
        curves: curves of its skin; None for a robot.
        windscreen: stations of the upper and the lower edge of the windscreen.
        windows: stations of the side windows, as (rear end, front end).
        doors: stations of the shut lines of the doors.
        gate: station of the rear window, heights of its lower and upper edge; None for none.
        rim: radius of the rim over that of the tyre.
        cleats: tread blocks around the wheel, see :func:`mirdrake.vehicles.bodywork.wheels.build_wheel`.
        cab: station of the rear end of the skin; the bed of a truck is behind it.
    """

    color: tuple[float, float, float]
    curves: Curves | None = None
    windscreen: tuple[float, float] = (0.6, 1.1)
    windows: tuple[tuple[float, float], ...] = ()
    doors: tuple[float, ...] = ()
    gate: tuple[float, float, float] | None = None
    rim: float = 0.66
    cleats: int = 0
    cab: float = -1.0


_CAR_PLAN = ((-1.0, 0.88), (-0.75, 0.955), (0.0, 1.0), (1.0, 1.0), (1.5, 0.97), (2.0, 0.86))
_STYLES = {
    "hatchback": Style(
        (0.86, 0.30, 0.08),
        Curves(
            deck=((-1.0, 0.63), (-0.5, 0.62), (0.3, 0.60), (0.9, 0.575), (1.25, 0.54), (1.7, 0.47), (2.0, 0.39)),
            roof=((-1.0, 0.60), (-0.96, 0.70), (-0.86, 0.85), (-0.72, 0.93), (-0.3, 0.985), (0.15, 1.0), (0.42, 0.985),
                  (0.60, 0.94), (1.0, 0.70), (1.28, 0.50), (2.0, 0.2)),
            plan=_CAR_PLAN
        ),
        windscreen=(0.60, 1.14), windows=((-0.50, 0.02), (0.06, 0.43), (0.46, 1.0)), doors=(0.02, 0.44, 0.92),
        gate=(-0.85, 0.66, 0.90)
    ),
    "sedan": Style(
        (0.38, 0.42, 0.47),
        Curves(
            deck=((-1.0, 0.66), (-0.8, 0.67), (-0.4, 0.64), (0.3, 0.615), (0.9, 0.585), (1.3, 0.55), (1.7, 0.48),
                  (2.0, 0.39)),
            roof=((-1.0, 0.40), (-0.45, 0.64), (-0.22, 0.78), (0.0, 0.91), (0.14, 0.97), (0.32, 1.0), (0.46, 0.985),
                  (0.64, 0.93), (1.0, 0.71), (1.28, 0.50), (2.0, 0.2)),
            plan=_CAR_PLAN
        ),
        windscreen=(0.62, 1.14), windows=((-0.30, 0.08), (0.12, 0.48), (0.51, 1.02)), doors=(0.06, 0.49, 0.94),
        gate=(-0.22, 0.69, 0.91)
    ),
    "suv": Style(
        (0.13, 0.36, 0.26),
        Curves(
            deck=((-1.0, 0.61), (0.3, 0.605), (0.9, 0.59), (1.3, 0.57), (1.75, 0.52), (2.0, 0.45)),
            roof=((-1.0, 0.60), (-0.97, 0.74), (-0.90, 0.90), (-0.78, 0.955), (-0.3, 0.99), (0.2, 1.0), (0.48, 0.985),
                  (0.64, 0.94), (1.0, 0.71), (1.2, 0.56), (2.0, 0.2)),
            plan=((-1.0, 0.91), (-0.75, 0.965), (0.0, 1.0), (1.0, 1.0), (1.5, 0.985), (2.0, 0.90)), tumblehome=0.24
        ),
        windscreen=(0.63, 1.12), windows=((-0.80, -0.06), (-0.02, 0.45), (0.48, 1.02)), doors=(-0.04, 0.46, 0.95),
        gate=(-0.90, 0.67, 0.90)
    ),
    "van": Style(
        (0.86, 0.87, 0.88),
        Curves(
            deck=((-1.0, 0.46), (0.9, 0.46), (1.2, 0.45), (1.5, 0.41), (1.8, 0.37), (2.0, 0.30)),
            roof=((-1.0, 0.975), (-0.6, 0.995), (0.2, 1.0), (0.72, 0.98), (0.84, 0.94), (0.95, 0.86), (1.5, 0.43),
                  (2.0, 0.2)),
            plan=((-1.0, 0.97), (-0.8, 1.0), (1.0, 1.0), (1.5, 0.96), (2.0, 0.85)), tumblehome=0.10, shoulder=0.02,
            sweep=(0.03, 0.24), bulge=(0.02, 0.10), edge=0.07
        ),
        windscreen=(0.94, 1.42), windows=((0.60, 1.25),), doors=(0.10, 0.56, 1.04), rim=0.60
    ),
    "truck": Style(
        (0.10, 0.27, 0.55),
        Curves(
            deck=((-1.0, 0.42), (1.0, 0.42), (2.0, 0.42)),
            roof=((-1.0, 0.80), (0.6, 0.83), (1.3, 0.82), (1.75, 0.77), (1.95, 0.56), (2.0, 0.50)),
            plan=((-1.0, 0.98), (1.0, 0.98), (1.8, 0.95), (2.0, 0.92)), tumblehome=0.04, shoulder=0.01,
            sweep=(0.02, 0.10), bulge=(0.02, 0.03), edge=0.06
        ),
        windscreen=(1.76, 1.97), windows=((0.55, 1.62),), doors=(0.45, 1.6), rim=0.60, cab=0.72
    ),
    "robot": Style((0.92, 0.62, 0.05), rim=0.55, cleats=14),
}  # fmt: skip

BODY_STYLES = tuple(_STYLES)


def write_car(folder: Path, *, style: str, size: BodySize) -> None:
    """Write ``meshes/body.gltf`` and ``meshes/wheel.gltf``, each with a ``.bin``, into the folder of a vehicle.

    The body fills the given size; only door mirrors protrude from the width. The wheel arches leave room for front
    wheels at :data:`mirdrake.vehicles.bodywork.sizes.STEERING`, as far as the body is high enough.

    Raises:
        ModelError: the style does not exist, or the sizes do not make a vehicle.
    """
    if style not in _STYLES:
        raise ModelError(f"unknown body style {style!r}; allowed: {', '.join(_STYLES)}")
    size.check()
    form = _STYLES[style]
    # Draw at the usual length and scale back: all widths of lines and roundings are those of a car.
    scale = size.length / _LENGTH
    scaled = BodySize(**{item.name: getattr(size, item.name) / scale for item in fields(size)})
    body = build_robot(scaled) if form.curves is None else _build_car(form, form.curves, scaled)
    wheel = build_wheel(scaled.wheel_radius, scaled.wheel_width, rim=form.rim, cleats=form.cleats)
    meshes = folder / "meshes"
    meshes.mkdir(parents=True, exist_ok=True)
    materials = {**MATERIALS, "paint": Material(form.color, 0.36, 0.12)}
    for name, mesh in (("body", body), ("wheel", wheel)):
        mesh.scaled(scale).write(meshes / f"{name}.gltf", materials=materials, grid=5e-5 * scale)


def _build_car(style: Style, curves: Curves, size: BodySize) -> Mesh:
    """Return the body of a car, a van or a lorry."""
    # Room that a wheel needs at full lock, ahead of its steering axis and towards the middle.
    reach, inwards = arch_clearance(size.wheel_radius, size.wheel_width)
    inner = max(size.track / 2.0 - inwards - 0.03, 0.12 * size.width)
    # The arches end below the deck: above it is the bonnet.
    deck = min(height for _, height in curves.deck if height) + 0.09
    room = size.ground_clearance + max(deck, 0.45) * (size.height - size.ground_clearance) - 0.02
    arch = max(min(max(reach + 0.03, 1.12 * size.wheel_radius), room - size.wheel_radius), 1.02 * size.wheel_radius)
    # The skin of a lorry is its cab, whose own origin is a little ahead of its rear end.
    rear, shift = size.front - size.length, 0.0
    if style.cab > -1.0:
        back = style.cab * size.wheelbase
        shift = back + 0.05
        rear = back
    frame = Frame(
        rear - shift,
        size.front - shift,
        size.wheelbase - shift,
        size.width / 2.0,
        size.ground_clearance,
        size.height,
        arch,
    )

    # Only the left half is drawn; the right one is its mirror image.
    shell = Shell(curves, frame)
    axles = (0.0, size.wheelbase) if style.cab == -1.0 else (frame.wheelbase,)
    _draw_body(shell, style)
    half = Mesh()
    for axle in axles:
        opening = Point(axle, size.wheel_radius).buffer(arch, quad_segs=24)
        shell.cut("cladding", LEFT, opening.buffer(0.05, quad_segs=24), facing=0.2)
        shell.cut(None, LEFT, opening, facing=0.0)
        shell.cut(None, BELOW, shapely.box(axle - arch, inner, axle + arch, 3.0), facing=0.2)
        half.add_mesh(_wheelhouse(shell, axle, size.wheel_radius, arch, inner))
    half.add_mesh(shell.mesh())
    half.add_mesh(_parts(shell, style))
    mesh = Mesh()
    mesh.add_mesh(half, None, (shift, 0.0, 0.0))
    if style.cab > -1.0:
        mesh.add_mesh(build_truck_bed(size, style.cab * size.wheelbase, inner, arch))
    both = Mesh()
    both.add_mesh(mesh)
    both.add_mesh(mesh.mirrored())
    return both


def _draw_body(shell: Shell, style: Style) -> None:
    """Draw underside, cladding, windows, lamps, grille and shut lines on the skin."""
    # Measures are fractions of the height and the half width, so that one drawing fits all sizes.
    f, tall = shell.frame, shell.frame.high - shell.frame.low
    wide = f.half_width

    def z(height: float) -> float:
        return f.low + height * tall

    # Order matters: later cuts are drawn over earlier ones.
    shell.cut("dark", BELOW, shapely.box(-9, -9, 9, 9), facing=0.75)
    sill = 0.115 * tall
    for view in (LEFT, FRONT, REAR):
        shell.cut("cladding", view, shapely.box(-9, 0, 9, f.low + sill), facing=0.0)

    # Side windows: a dark band between belt and roof, with the panes in it.
    xs = np.linspace(shell.x(style.windows[0][0]), shell.x(style.windows[-1][1]), 40)
    belt = [(x, shell.value("deck", x) + 0.03 * tall) for x in xs]
    rail = [(x, shell.value("roof", x) - 0.075 * tall) for x in xs]
    band = shapely.Polygon([*belt, *rail[::-1]]).buffer(0) if style.windows else shapely.Polygon()
    band = max(shapely.get_parts(band), key=lambda part: float(part.area))
    # Shrinking and growing back rounds the corners of an outline.
    band = band.buffer(-0.025).buffer(0.025, quad_segs=4)
    shell.cut("gloss_black", LEFT, band, facing=0.15)
    for rear, front in style.windows:
        pane = band.buffer(-0.02).intersection(shapely.box(shell.x(rear), -9, shell.x(front), 9))
        shell.cut("glass", LEFT, pane.buffer(-0.02).buffer(0.02, quad_segs=4), facing=0.15)

    # Windscreen and rear window: between the pillars of the cabin.
    screens = {FRONT: [(x := shell.x(s), shell.value("roof", x)) for s in np.linspace(*style.windscreen, 8)]}
    if style.gate is not None:
        station, lower, upper = style.gate
        screens[REAR] = [(shell.x(station), z(height)) for height in np.linspace(lower, upper, 8)]
    for view, points in screens.items():
        pillar = (0.045 if view == FRONT else 0.10) * wide
        edge = [(shell.cabin(x, height) - pillar, height) for x, height in points]
        pane = shapely.Polygon([(-0.1, edge[0][1]), *edge, (-0.1, edge[-1][1])])
        pane = pane.buffer(-0.06).buffer(0.06, quad_segs=4)
        shell.cut("gloss_black", view, pane, facing=0.08)
        shell.cut("glass", view, pane.buffer(-0.025), facing=0.08)

    # Shut lines.
    for station in style.doors:
        x = shell.x(station)
        line = LineString([(x, f.low + sill), (x, shell.value("deck", x) + 0.03 * tall)])
        shell.cut("gap", LEFT, line.buffer(0.004, cap_style="flat"), facing=0.2, only="paint")
    if style.gate is None and style.cab == -1.0:  # the rear doors of a van
        shell.cut("gap", REAR, shapely.box(-0.1, f.low + sill, 0.006, z(0.95)), facing=0.2, only="paint")

    # The front: headlamps around the corners, grille, air intake and number plate.
    nose = shell.value("deck", f.front - 0.02)
    face = nose - f.low
    corner = f.front - 0.35 * (f.front - f.wheelbase - f.arch)
    low, high = f.low + 0.62 * face, f.low + 0.84 * face
    head = [
        (f.front - 0.03, 0.50 * wide, low),
        (f.front - 0.10, 0.80 * wide, low),
        (corner, 0.97 * wide, high - 0.02),
        (corner + 0.04, 0.95 * wide, high + 0.04),
        (f.front - 0.09, 0.78 * wide, high),
        (f.front - 0.03, 0.46 * wide, high),
    ]
    lamp = seen(FRONT_LEFT, head, rounding=0.02)
    shell.cut("gloss_black", FRONT_LEFT, lamp, facing=0.05)
    shell.cut("lamp", FRONT_LEFT, lamp.buffer(-0.012), facing=0.05)
    shell.cut(
        "lamp_white", FRONT_LEFT, lamp.buffer(-0.03).intersection(lamp.centroid.buffer(0.4 * (high - low))), facing=0.05
    )
    for bottom, top, across in ((0.66, 0.82, 0.40), (0.24, 0.48, 0.62)):
        opening = shapely.box(-0.1, f.low + bottom * face, across * wide, f.low + top * face)
        opening = opening.buffer(-0.03).buffer(0.03, quad_segs=4)
        shell.cut("dark", FRONT, opening)
        for height in np.linspace(bottom, top, 5)[1:-1]:
            middle = f.low + height * face
            bar = shapely.box(-9, middle - 0.009, 9, middle + 0.009).intersection(opening.buffer(-0.012))
            shell.cut("grille", FRONT, bar)

    # The rear: lamps, number plate and the shut line of the boot.
    face = shell.value("deck", f.rear + 0.02) - f.low
    tail = f.rear + 0.16 * (-f.arch - f.rear)
    low, high = f.low + 0.62 * face, f.low + 0.86 * face
    rear_lamp = [
        (f.rear + 0.02, 0.56 * wide, low), (f.rear + 0.05, 0.86 * wide, low), (tail, 0.97 * wide, low + 0.02),
        (tail, 0.97 * wide, high), (f.rear + 0.05, 0.86 * wide, high), (f.rear + 0.02, 0.56 * wide, high),
    ]  # fmt: skip
    lamp = seen(REAR_LEFT, rear_lamp, rounding=0.02)
    shell.cut("gloss_black", REAR_LEFT, lamp, facing=0.05)
    shell.cut("lamp_red", REAR_LEFT, lamp.buffer(-0.010), facing=0.05)
    shell.cut("lamp_dark_red", REAR_LEFT, lamp.buffer(-0.035), facing=0.05)
    shell.cut("plate", REAR, shapely.box(-0.1, f.low + 0.50 * face, 0.25, f.low + 0.50 * face + 0.11))


def _wheelhouse(shell: Shell, axle: float, radius: float, arch: float, inner: float) -> Mesh:
    """Return the dark inside of the left wheel arch at an axle."""
    mesh = Mesh()
    # A half circle over the wheel, extended downwards at both ends.
    angle = np.concatenate([np.zeros(3), np.linspace(0.0, np.pi, 33), np.full(3, np.pi)])
    drop = np.concatenate([[0.12, 0.08, 0.04], np.zeros(33), [0.04, 0.08, 0.12]])
    x = axle + arch * np.cos(angle)
    z = np.maximum(radius + arch * np.sin(angle) - drop, shell.frame.low + 0.005)
    # A little inside of the skin, so that the two surfaces do not coincide.
    outer = np.array([shell.side(float(p), float(q)) for p, q in zip(x, z, strict=True)]) - 0.004
    normal = np.stack([-np.cos(angle), np.zeros_like(x), -np.sin(angle)], axis=1)
    outside, inside = (np.stack([x, y, z], axis=1) for y in (np.maximum(outer, inner), np.full_like(x, inner)))
    mesh.add_grid("dark", np.stack([outside, inside]), np.stack([normal, normal]))
    wall: Array = triangulate(shapely.Polygon(np.stack([x, z], axis=1)).buffer(0))
    corners = np.stack([wall[..., 0], np.full(wall.shape[:2], inner), wall[..., 1]], axis=-1)
    mesh.add_flat("dark", corners, (0, 1, 0))
    return mesh


def _parts(shell: Shell, style: Style) -> Mesh:
    """Return door mirror and handles of the left side."""
    mesh, tall = Mesh(), shell.frame.high - shell.frame.low
    # The mirror is at the front end of the foremost window, a handle near the rear end of each door's window.
    x = shell.x(style.windows[-1][1]) - 0.16
    z = shell.value("deck", x) + 0.085 * tall
    side = shell.side(x, shell.value("deck", x))
    mesh.add_mesh(rounded_box("paint", (0.12, 0.19, 0.13), sharpness=0.6), None, (x, side + 0.07, z))
    mesh.add_mesh(rounded_box("glass", (0.02, 0.16, 0.10)), None, (x - 0.056, side + 0.07, z))
    mesh.add_mesh(rounded_box("gloss_black", (0.07, 0.16, 0.03)), None, (x, side - 0.02, z - 0.06))
    for rear, _ in style.windows[-2:]:
        x = shell.x(rear) + 0.13
        z = shell.value("deck", x) - 0.09 * tall
        handle = rounded_box("cladding", (0.17, 0.026, 0.030), sharpness=0.5)
        mesh.add_mesh(handle, None, (x, shell.side(x, z) - 0.004, z))
    return mesh
