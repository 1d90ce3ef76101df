"""Bodies made of boxes: robots, vans and lorries. They fill the collision boxes of a new vehicle."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from shapely.geometry import Polygon

from mirdrake.vehicles.bodywork.car import arch_clearance
from mirdrake.vehicles.bodywork.gltf import Mesh
from mirdrake.vehicles.bodywork.solids import pillow, prism
from mirdrake.vehicles.bodywork.wheels import WheelDesign

BOX_STYLES = ("van", "truck", "robot")

_SIDE = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])  # depth, y, z of a prism to y, z, x


def build_boxes(style: str, sizes: Mapping[str, float], *, steering: float) -> Mesh:
    """Return the body of a robot, a van or a lorry.

    Args:
        style: one of :data:`BOX_STYLES`.
        sizes: as the arguments of :func:`mirdrake.vehicles.bodywork.generic.write_car`; about 4 m long.
        steering: largest angle of a front wheel that must stay clear [rad].
    """
    length, width, height, base = (sizes[name] for name in ("length", "width", "height", "wheelbase"))
    low, radius = sizes["ground_clearance"], sizes["wheel_radius"]
    front = base + sizes["front_overhang"]
    rear = front - length
    reach, inwards = arch_clearance(WheelDesign(radius, sizes["wheel_width"], 0.5 * radius), steering)
    over = min(radius + 1.04 * max(reach, radius), low + 0.8 * (height - low))  # above the wheels
    narrow = max(2.0 * (sizes["track"] / 2.0 - inwards - 0.03), 0.12 * width)
    mesh = Mesh()

    def box(material: str, x: Sequence[float], y: float, z: Sequence[float], middle: float = 0.0) -> None:
        """Add a box from x[0] to x[1], y wide, from z[0] to z[1]."""
        corners = [(x[0], z[0]), (x[1], z[0]), (x[1], z[1]), (x[0], z[1])]
        slab(material, corners, y, middle)

    def slab(material: str, side: Sequence[Sequence[float]], y: float, middle: float = 0.0) -> None:
        """Add a side view (x, z), extruded y wide about y = middle."""
        mesh.add_mesh(prism(material, Polygon([(z, x) for x, z in side]), y), _SIDE, (0.0, middle - y / 2.0, 0.0))

    # Between the wheels a frame, and bumpers as wide as the vehicle where the wheels leave room.
    bar = min(0.12 * (over - low), 0.3 * max(front - base - reach, 0.02), 0.3 * max(-rear - radius, 0.02)) + 0.01
    box("cladding", (rear + bar, front - bar), narrow, (low, over))
    bumper = low + 0.45 * (over - low)
    for end, sign, room in ((front, -1.0, front - base - reach), (rear, 1.0, -rear - radius)):
        wide = width if room > bar else narrow
        box("cladding", sorted((end, end + sign * bar)), wide, (bumper, bumper + 2.0 * bar))

    if style == "robot":
        # A deck over the wheels, and on it a box of electronics with a lid and a mast's foot.
        deck = over + 0.12 * (height - over)
        box("paint", (rear + 2.0 * bar, front - 2.0 * bar), width, (over, deck))
        box("rim_machined", (rear + 4.0 * bar, front - 4.0 * bar), 0.86 * width, (deck, deck + 0.01))
        lid = deck + 0.8 * (height - deck)
        box("grille", (0.12 * base, 0.78 * base), 0.62 * width, (deck, lid))
        box("paint", (0.10 * base, 0.80 * base), 0.66 * width, (lid, height))
        box("dark", (0.775 * base, 0.785 * base), 0.4 * width, (deck + 0.25 * (lid - deck), deck + 0.75 * (lid - deck)))
        lamps, lamp_z, lamp = front - 2.0 * bar, (over + deck) / 2.0, 0.5 * (deck - over)
    elif style == "van":
        # One volume with a sloping front; glass lies on its faces.
        waist, nose = over + 0.25 * (height - over), front - 0.30 * sizes["front_overhang"] - 0.16 * base
        body = [(rear + bar, over), (front - bar, over), (front - bar, waist), (nose, waist + 0.1 * (height - waist)),
                (0.86 * nose, height), (rear + bar, height)]  # fmt: skip
        slab("paint", body, width)
        cab = height - waist
        sill, top, low_edge = waist + 0.16 * cab, waist + 0.92 * cab, waist + 0.12 * cab
        slab("glass", [(0.87 * nose, top), (0.985 * nose, sill), (0.62 * nose, sill), (0.62 * nose, top)], width + 0.01)
        slab("glass", [(nose + 0.01, low_edge), (nose - 0.02, low_edge), (0.86 * nose + 0.02, height - 0.06),
                       (0.86 * nose + 0.05, height - 0.06)], 0.88 * width)  # fmt: skip
        lamps, lamp_z, lamp = front - bar, over + 0.6 * (waist - over), 0.25 * (waist - over)
    else:
        # A cab ahead of a box of freight.
        back, waist = base - 0.9 * radius, over + 0.35 * (height - over)
        roof = low + 0.86 * (height - low)
        side = [(back, over), (front - bar, over), (front - bar, waist), (front - 2.5 * bar, roof), (back, roof)]
        slab("paint", side, 0.96 * width)
        slab("glass", [(front - bar + 0.01, waist), (front - bar - 0.02, waist), (front - 2.5 * bar, roof - 0.08),
                       (front - 2.5 * bar + 0.03, roof - 0.08)], 0.86 * width)  # fmt: skip
        box("glass", (back + 0.35 * (front - back), front - 3.0 * bar), 0.97 * width, (waist, roof - 0.1))
        box("rim_machined", (rear + bar, back - 0.1), width, (over, height))
        lamps, lamp_z, lamp = front - bar, over + 0.35 * (waist - over), 0.2 * (waist - over)

    for hand in (-1.0, 1.0):
        for material, x in (("lamp_white", lamps), ("lamp_red", rear + (2.0 if style == "robot" else 1.0) * bar)):
            at = (x, hand * 0.36 * width, lamp_z)
            mesh.add_mesh(pillow(material, (0.04, 0.16 * width, lamp), 0.5), None, at)
    for axle in (0.0, base):
        hub = sizes["track"] - 0.9 * sizes["wheel_width"]
        box("rim_shadow", (axle - 0.1 * radius, axle + 0.1 * radius), hub, (0.9 * radius, 1.1 * radius))
    return mesh
