"""Bodies of plates and boxes: the body of a robot and the bed of a lorry."""

from __future__ import annotations

import shapely
from shapely.geometry import Point

from mirdrake.vehicles.bodywork.mesh import Mesh
from mirdrake.vehicles.bodywork.shapes import ALONG_Y, extrude, rounded_box, rounded_rectangle
from mirdrake.vehicles.bodywork.sizes import BodySize, arch_clearance


def build_robot(size: BodySize) -> Mesh:
    """Return the body of a robot: a tub between the wheels, a deck above them, a housing and bumpers."""
    # Room that a wheel needs at full lock; the deck is above it, the tub between the wheels.
    reach, inwards = arch_clearance(size.wheel_radius, size.wheel_width)
    front, rear, low, tall = size.front, size.front - size.length, size.ground_clearance, size.height
    half = size.width / 2.0
    over = min(size.wheel_radius + 1.05 * reach, low + 0.8 * (tall - low))  # underside of the deck
    narrow = max(size.track / 2.0 - inwards - 0.03, 0.12 * size.width)
    mesh = Mesh()

    # The tub with battery and motors, and the stubs of the axles.
    tub = rounded_rectangle((rear + 0.05 * size.length, front - 0.05 * size.length), (-narrow, narrow), 0.08)
    floor = low + 0.62 * (over - low)
    mesh.add_mesh(extrude("cladding", tub, low, floor, bevel=0.04))
    for x in (0.08 * size.wheelbase, 0.5 * size.wheelbase, 0.92 * size.wheelbase):
        for y in (-0.8 * narrow, 0.8 * narrow):
            mesh.add_mesh(extrude("rim_machined", Point(x, y).buffer(0.05), floor, over))
    for axle in (0.0, size.wheelbase):
        stub = Point(axle, size.wheel_radius).buffer(0.10 * size.wheel_radius)
        end = size.track / 2.0 - 0.45 * size.wheel_width
        mesh.add_mesh(extrude("rim_shadow", stub, -end, end, axes=ALONG_Y))

    # The deck: a painted tray with a metal plate on it.
    deck = over + 0.18 * (tall - over)
    tray = rounded_rectangle((rear + 0.02, front - 0.02), (-half, half), 0.16)
    mesh.add_mesh(extrude("paint", tray, over, deck, bevel=0.025))
    mesh.add_mesh(extrude("rim_dark", tray.buffer(-0.09), deck, deck + 0.012))
    for x in (rear + 0.16, front - 0.16):
        for y in (-half + 0.16, half - 0.16):
            mesh.add_mesh(extrude("rim_machined", Point(x, y).buffer(0.03, quad_segs=4), deck, deck + 0.03))

    # The housing of the electronics, with a screen in front, vents on the sides and a coloured lid.
    box = (0.02 * size.wheelbase, 0.86 * size.wheelbase)
    lid = deck + 0.82 * (tall - deck)
    housing = rounded_rectangle(box, (-0.58 * half, 0.58 * half), 0.12)
    mesh.add_mesh(extrude("grille", housing, deck, lid))
    mesh.add_mesh(extrude("paint", housing.buffer(0.035), lid, tall, bevel=0.02))
    rise = lid - deck
    for x, material in ((box[1] + 0.004, "glass"), (box[0] - 0.004, "dark")):
        plate = rounded_box(material, (0.02, 0.62 * half, 0.55 * rise), sharpness=0.25)
        mesh.add_mesh(plate, None, (x, 0.0, deck + 0.52 * rise))
    for k in range(5):
        x = box[0] + (0.3 + 0.1 * k) * (box[1] - box[0])
        for sign in (-1.0, 1.0):
            vent = rounded_box("dark", (0.035, 0.02, 0.5 * rise), sharpness=0.4, count=(8, 5))
            mesh.add_mesh(vent, None, (x, sign * 0.58 * half, deck + 0.5 * rise))
    # An emergency stop and a mast with an antenna on the deck behind the housing.
    back = 0.5 * (box[0] + rear)
    mesh.add_mesh(extrude("lamp_red", Point(back, -0.4 * half).buffer(0.07), deck, deck + 0.07, bevel=0.02))
    mesh.add_mesh(extrude("rim_machined", Point(back, 0.4 * half).buffer(0.03), deck, tall - 0.04))
    mesh.add_mesh(extrude("plate", Point(back, 0.4 * half).buffer(0.12, quad_segs=8), tall - 0.06, tall, bevel=0.02))

    # Bumpers as wide as the body where the wheels leave room, and lamps on the edge of the deck.
    bar = min(0.05, 0.3 * max(size.front_overhang - reach, 0.02), 0.3 * max(-rear - size.wheel_radius, 0.02)) + 0.01
    height = low + 0.4 * (over - low)
    for end, sign, room in ((front, -1.0, size.front_overhang - reach), (rear, 1.0, -rear - size.wheel_radius)):
        wide = half if room > bar else narrow
        bumper = rounded_rectangle(tuple(sorted((end, end + sign * bar))), (-wide, wide), 0.5 * bar)  # type: ignore[arg-type]
        mesh.add_mesh(extrude("dark", bumper, height - bar, height + bar))
        for y in (-0.6 * narrow, 0.6 * narrow):
            x0, x1 = sorted((end + sign * 0.5 * bar, end + sign * 0.07 * size.length))
            strut = shapely.box(x0, y - 0.03, x1, y + 0.03)
            mesh.add_mesh(extrude("rim_dark", strut, height - 0.03, height + 0.03))
    for y in (-0.68 * half, 0.68 * half):
        for x, material in ((front - 0.02, "lamp_white"), (rear + 0.02, "lamp_red")):
            lamp = rounded_box(material, (0.03, 0.34 * half, 0.45 * (deck - over)), sharpness=0.5)
            mesh.add_mesh(lamp, None, (x, y, 0.5 * (over + deck)))
    return mesh


def build_truck_bed(size: BodySize, cab: float, inner: float, arch: float) -> Mesh:
    """Return the left half of frame and freight box behind a cab that ends at x = ``cab``.

    Args:
        size: size of the whole lorry.
        cab: x of the rear end of the cab [m].
        inner: the wheel arches reach inwards to this distance from the middle [m].
        arch: radius of the wheel arches [m].
    """
    rear, half = size.front - size.length, size.width / 2.0
    # The floor of the box is above the wheels with their arches.
    floor = max(size.wheel_radius + arch, size.ground_clearance + 0.25 * (size.height - size.ground_clearance))
    rail = min(0.6 * inner, 0.3)
    mesh = extrude("cladding", shapely.box(rear + 0.05, 0.0, size.wheelbase, rail), size.ground_clearance, floor - 0.06)
    mesh.add_mesh(extrude("rim_shadow", shapely.box(rear + 0.02, 0.0, cab, 0.92 * half), floor - 0.06, floor))
    mesh.add_mesh(extrude("rim_machined", shapely.box(rear, 0.0, cab - 0.05, half), floor, size.height, bevel=0.02))
    for x in (rear + 0.02, cab - 0.07):  # frames of the box
        post = shapely.box(x, 0.0, x + 0.03, half + 0.001)
        mesh.add_mesh(extrude("grille", post, floor, size.height - 0.02))
    stub_end = size.track / 2.0 - 0.45 * size.wheel_width
    stub = Point(0.0, size.wheel_radius).buffer(0.12 * size.wheel_radius)
    mesh.add_mesh(extrude("rim_shadow", stub, 0.0, stub_end, axes=ALONG_Y))
    guard = shapely.box(arch + 0.08, 0.9 * half, cab - 0.12, 0.93 * half)
    mesh.add_mesh(extrude("cladding", guard, 0.8 * size.wheel_radius, floor - 0.1))
    under = shapely.box(rear + 0.02, 0.0, rear + 0.06, 0.94 * half)
    mesh.add_mesh(extrude("dark", under, 0.8 * size.wheel_radius, 1.1 * size.wheel_radius))
    for y, material in ((0.8, "lamp_red"), (0.62, "amber")):
        lamp = rounded_box(material, (0.03, 0.14 * half, 0.08), sharpness=0.4)
        mesh.add_mesh(lamp, None, (rear + 0.015, y * half, 0.95 * size.wheel_radius))
    return mesh
