"""Masses and inertias of body, knuckles and wheels: left and right are equal, missing ones are estimated."""

import numpy as np

from mirdrake.importing.changes import Change, Changes, Code, unusual
from mirdrake.importing.shape import Vector
from mirdrake.importing.vehicles.car import Layout, Mass, Part, Parts
from mirdrake.importing.vehicles.inertia import DENSITY, box_inertia, cylinder_inertia, gather, moments_text, widen
from mirdrake.importing.vehicles.kinematics import Tree
from mirdrake.importing.vehicles.round_shapes import Bounds

# Reflection at the xz plane: S I S changes the sign of the products of inertia xy and yz.
MIRROR = np.diag([1.0, -1.0, 1.0])
SPIN = (0.2, 1.1)
"""Spin inertia of a wheel over mass times radius squared: 0.5 a solid cylinder, 1 a hoop; a hub may be heavy."""

COM_HEIGHT = 0.35
"""Height of the centre of mass over that of the car, if that of the source is implausible: cars have 0.33 to 0.40."""

BODY_DENSITY = (0.2, 3000.0)
"""Plausible mass of a body over the volume of the box around the car [kg/m³]: cars 100 to 200, Gazebo demos 0.5."""

WHEEL_DENSITY = (2.0, 20_000.0)
"""Plausible mass of a wheel over the volume of its cylinder [kg/m³]: 280 for cars, 7800 for solid steel."""

UNION_SHARE = 0.25
"""Of a wheel's mass that becomes the knuckle of a joint that steers and spins at once (Bolt 10 of 30 kg)."""

NO_MASS = "a moving link needs a mass"

HEAVY = 1.8
"""Density over that of cars from which pounds are suspected behind a number of kilograms."""

POUND = 0.45359237


def gather_masses(tree: Tree, layout: Layout, parts: Parts, bounds: Bounds) -> list[Change]:
    """Set the mass of each part, from its links or estimated; left and right are equal afterwards."""
    body, knuckles, wheels = parts.body, parts.knuckles, parts.wheels
    # Masses of the links first; implausible ones are then treated as missing.
    changes = Changes()
    # Half the diagonal of the body stands for the size of its links without shapes.
    size = 0.5 * float(np.linalg.norm(bounds[1] - bounds[0]))
    body.mass = gather(tree, body.links, body.X_MP, size, changes)
    for part in knuckles:
        part.mass = gather(tree, part.links, part.X_MP, layout.radii[0], changes)
    for key, part in wheels.items():
        radius, width = (values[key.startswith("rear")] for values in (layout.radii, layout.widths))
        part.mass = gather(tree, part.links, part.X_MP, radius, changes, wheel=(radius, width))
    where = tree.model.links[tree.root].where
    around = _around(layout, bounds)
    _discard_implausible(body, float(np.prod(around)), BODY_DENSITY, tree, changes)
    for key, part in wheels.items():
        radius, width = (values[key.startswith("rear")] for values in (layout.radii, layout.widths))
        _discard_implausible(part, np.pi * radius**2 * width, WHEEL_DENSITY, tree, changes)
    # A knuckle has no measured volume; a cube with the wheel radius as edge replaces it, and zero mass is allowed.
    for part in knuckles:
        _discard_implausible(part, layout.radii[0] ** 3, (0.0, WHEEL_DENSITY[1]), tree, changes)
    front = (wheels["front_left"], wheels["front_right"])
    _part_from_wheel(knuckles, front)
    # Missing masses: the body by density, wheels and knuckles relative to it.
    if body.mass.mass <= 0.0:
        edges = bounds[1] - bounds[0]
        mass = DENSITY * float(np.prod(edges))
        body.mass = Mass(mass, 0.5 * (bounds[0] + bounds[1]), box_inertia(mass, edges))
        became = f"{mass:.4g} kg: {DENSITY:g} kg/m³ of the box around it"
        changes.add(Code.MASS, where, f"link '{body.name}': mass", "none", became, NO_MASS)
    for end, radius, width in zip(("front", "rear"), layout.radii, layout.widths, strict=True):
        pair = (wheels[f"{end}_left"], wheels[f"{end}_right"])
        if max(part.mass.mass for part in pair) <= 0.0:
            mass = min(283.0 * np.pi * radius**2 * width, 0.025 * body.mass.mass)  # as in estimates.HOW
            _set_wheels(pair, mass, cylinder_inertia(mass, radius=radius, length=width, axis=1))
            changes.add(
                Code.MASS,
                _where(pair, tree),
                f"{end} wheels: mass",
                "none",
                f"{mass:.4g} kg",
                "estimated as for a new vehicle",
            )
            continue
        _mirror(f"{end} wheels", pair, tree, changes)
        _repair_wheel(pair, end, radius, width, tree, changes)
    # A knuckle without links takes its mass from the wheel, so that the sum is unchanged.
    if not any(part.links for part in knuckles):
        _split(knuckles, front, layout.radii[0], tree, changes)
    elif max(part.mass.mass for part in knuckles) <= 0.0:
        mass = 0.5 * front[0].mass.mass
        _set_knuckles(knuckles, mass, layout.radii[0])
        why = "a moving link needs a mass; estimated as half a wheel's"
        changes.add(Code.MASS, _where(knuckles, tree), "steering knuckles: mass", "none", f"{mass:.4g} kg", why)
    else:
        _mirror("steering knuckles", knuckles, tree, changes)
    for end in ("front", "rear") if parts.carriers else ():
        _weigh_carriers(end, parts, layout, tree, changes)
    for part in parts:
        part.mass.inertia = widen(part.mass.inertia)
    return changes


def _weigh_carriers(end: str, parts: Parts, layout: Layout, tree: Tree, changes: Changes) -> None:
    """Set the masses of the carriers of an axle; without masses in the source, a share of the body's."""
    radius, body = layout.radii[end == "rear"], parts.body
    pair = (parts.carriers[f"{end}_left"], parts.carriers[f"{end}_right"])
    for part in pair:
        # A knuckle is often modelled as several links, or as none.
        part.mass = gather(tree, part.links, part.X_MP, radius, changes)
        if part.links:
            _discard_implausible(part, radius**3, (0.0, WHEEL_DENSITY[1]), tree, changes)
    if max(part.mass.mass for part in pair) > 0.0:
        _mirror(f"{end} carriers", pair, tree, changes)
        return
    # The share of the body bounds the estimate for very light bodies, such as those of scale models.
    mass = min(0.5 * parts.wheels[f"{end}_left"].mass.mass, 0.02 * body.mass.mass)
    places = layout.places()
    inertia = cylinder_inertia(mass, radius=0.3 * radius, length=0.3 * radius, axis=2)
    for part, side in zip(pair, ("left", "right"), strict=True):
        part.mass = Mass(mass, places[f"{end}_{side}"], inertia.copy())
    # The carriers take their mass from the body, so that the total is unchanged.
    scale = 1.0 - 2.0 * mass / body.mass.mass
    body.mass = Mass(scale * body.mass.mass, body.mass.com, scale * body.mass.inertia)
    became = f"{mass:.4g} kg each, of the body's"
    location = tree.model.links[tree.root].where
    changes.add(
        Code.MASS, location, f"{end} carriers: mass", "none", became, "half a wheel's; a moving link needs a mass"
    )


def check_balance(parts: Parts, layout: Layout, bounds: Bounds, where: str) -> list[Change]:
    """Move an implausible centre of mass of the car by moving that of the body."""
    changes = Changes()
    # With the centre of mass outside of its wheels a car tips over or lifts an axle in the first step.
    com, total, body = parts.centre_of_mass(layout), parts.total_mass(), parts.body
    # A body may be a flat plate, but the car is at least as high as its wheels.
    height = max(float(bounds[1][2]), 2.0 * max(layout.radii))
    wanted = com.copy()
    if not 0.0 < com[2] <= height:
        wanted[2] = COM_HEIGHT * height
        became = f"{wanted[2]:.4g} m: {COM_HEIGHT:g} of the height"
        why = "below the road" if com[2] <= 0.0 else f"above the car, which is {height:.3g} m high"
        changes.add(
            Code.MASS, where, "centre of mass of the car: height", f"{com[2]:.4g} m above the road", became, why
        )
    if not 0.05 * layout.wheelbase < com[0] < 0.95 * layout.wheelbase:
        wanted[0] = 0.5 * layout.wheelbase
        was = f"{com[0]:.4g} m ahead of the rear axle"
        why = f"the axles are {layout.wheelbase:.4g} m apart; it would tip over or unload an axle"
        changes.add(Code.MASS, where, "centre of mass of the car: along", was, f"{wanted[0]:.4g} m: midway", why)
    if abs(com[1]) > 0.25 * min(layout.tracks):
        wanted[1] = 0.0
        was = f"{com[1]:.4g} m to the left"
        changes.add(Code.MASS, where, "centre of mass of the car: sideways", was, "0 m", "it would almost tip over")
    if body.mass.mass < 0.5 * total:
        was = f"{body.mass.mass:.4g} kg of {total:.4g} kg"
        why = "the wheels and knuckles are heavier than the body"
        changes.append(unusual(where, "mass of the body", was, why))
    # Only the body moves: wheels and knuckles have their place.
    moved = body.mass.com + (wanted - com) * total / body.mass.mass
    body.mass.com = np.where(np.abs(moved) < 1e-6, 0.0, moved)
    # The density around the whole car shows masses in pounds or grams, which each link alone would not.
    edges = _around(layout, bounds)
    density = total / float(np.prod(edges))
    if edges[0] > 2.0 and density > HEAVY * DENSITY:
        why = f"{density:.0f} kg per m³ around it, cars have about {DENSITY:g}; pounds would be {total * POUND:.0f} kg"
        changes.append(unusual(where, "mass of the car", f"{total:.5g} kg", why))
    return changes


def _around(layout: Layout, bounds: Bounds) -> Vector:
    """Return the edges of the bounding box of a car and its wheels, from the road up [m]."""
    length, width = (bounds[1] - bounds[0])[:2]
    long, wide = layout.wheelbase + 2.0 * max(layout.radii), max(layout.tracks) + max(layout.widths)
    return np.array([max(length, long), max(width, wide), max(bounds[1][2], 2.0 * max(layout.radii))])


def _discard_implausible(
    part: Part, volume: float, densities: tuple[float, float], tree: Tree, changes: Changes
) -> None:
    """Discard a mass that no part of this size has."""
    density = part.mass.mass / volume
    if part.mass.mass > 0.0 and not densities[0] <= density <= densities[1]:
        where = tree.model.links[part.links[0]].where
        why = f"{density:.3g} kg per m³ of the space it takes; {densities[0]:g} to {densities[1]:g} is plausible"
        changes.add(
            Code.MASS, where, f"link '{part.name}': mass", f"{part.mass.mass:.4g} kg", "treated as missing", why
        )
        part.mass = Mass()


# --- pairs -------------------------------------------------------------------------------------------------------


def _mirror(changed_part: str, pair: tuple[Part, Part], tree: Tree, changes: Changes) -> None:
    """Set left and right to their mirrored mean; a side without mass to the other one."""
    left, right = (part.mass for part in pair)
    if min(left.mass, right.mass) <= 0.0:
        whole = left if left.mass > 0.0 else right
        # A mass of the right side is reflected to the left, since the pair is set from the left one.
        flip = np.eye(3) if whole is left else MIRROR
        mean, com, inertia = whole.mass, flip @ whole.com, flip @ whole.inertia @ flip
    else:
        mean, com = 0.5 * (left.mass + right.mass), 0.5 * (left.com + MIRROR @ right.com)
        inertia = 0.5 * (left.inertia + MIRROR @ right.inertia @ MIRROR)
    if abs(left.mass - right.mass) > 1e-3 * mean:
        was = f"{left.mass:.4g} and {right.mass:.4g} kg"
        changes.add(
            Code.MASS,
            _where(pair, tree),
            f"{changed_part}: mass",
            was,
            f"{mean:.4g} kg each",
            "left and right are equal",
        )
    pair[0].mass = Mass(mean, com, inertia)
    pair[1].mass = Mass(mean, MIRROR @ com, MIRROR @ inertia @ MIRROR)


def _where(pair: tuple[Part, Part], tree: Tree) -> str:
    """Return the place of the first link of a pair; a part that mirdrake adds has no link in the source."""
    return next((tree.model.links[name].where for part in pair for name in part.links), "")


def _part_from_wheel(knuckles: tuple[Part, Part], wheels: tuple[Part, Part]) -> None:
    """Take the mass of a knuckle without links from its wheel, if the knuckle of the other side has links."""
    for mine, other, wheel in zip(knuckles, knuckles[::-1], wheels, strict=True):
        mass, whole = other.mass, wheel.mass
        if not mine.links and 0.0 < mass.mass < whole.mass:
            mine.mass = Mass(mass.mass, MIRROR @ mass.com, MIRROR @ mass.inertia @ MIRROR)
            rest = 1.0 - mass.mass / whole.mass
            wheel.mass = Mass(rest * whole.mass, whole.com, rest * whole.inertia)


def _set_wheels(pair: tuple[Part, Part], mass: float, inertia: Vector) -> None:
    for part in pair:
        part.mass = Mass(mass, np.zeros(3), inertia.copy())


def _set_knuckles(pair: tuple[Part, Part], mass: float, radius: float) -> None:
    inertia = cylinder_inertia(mass, radius=0.3 * radius, length=0.3 * radius, axis=2)
    for part in pair:
        part.mass = Mass(mass, np.zeros(3), inertia.copy())


def _repair_wheel(pair: tuple[Part, Part], end: str, radius: float, width: float, tree: Tree, changes: Changes) -> None:
    """Balance a wheel, and make its spin axis the axis with the largest moment of inertia."""
    mass = pair[0].mass
    location = tree.model.links[pair[0].links[0]].where
    part = f"{end} wheels"
    offset = float(np.linalg.norm(mass.com))
    if offset > max(1e-3, 0.02 * radius):
        was = f"{offset:.3g} m from the wheel's centre"
        changes.add(Code.MASS, location, f"{part}: centre of mass", was, "in it", "wheels are balanced")
    # The largest moment of a wheel is about its axis; files often have it in another slot.
    moments = mass.inertia.diagonal()
    order = np.argsort(moments)
    top = int(order[2])
    # A cylinder with w² > 3 r² has its largest moment across its axis, so that wide rollers stay as they are.
    if top != 1 and 3.0 * radius**2 > width**2 and moments[top] > 1.05 * moments[order[1]]:
        others = [i for i in range(3) if i != top]
        moments = np.array([moments[others].mean(), moments[top], moments[others].mean()])
        was = f"{'xyz'[top]} axis has the largest moment, {moments_text(mass.inertia)}"
        changes.add(
            Code.INERTIA, location, f"{part}: inertia", was, "about the wheel's own axis", "the wheel spins about y"
        )
    spin, across = float(moments[1]), 0.5 * float(moments[0] + moments[2])
    relative = spin / (mass.mass * radius**2)
    # The triangle inequality demands across >= spin / 2; a thin disc has just this value.
    if not SPIN[0] <= relative <= SPIN[1] or across < 0.5 * spin * (1.0 - 1e-6):
        inertia = cylinder_inertia(mass.mass, radius=radius, length=width, axis=1)
        was = f"spin {spin:.4g}, across {across:.4g} kg m²"
        became = f"solid cylinder: spin {inertia[1, 1]:.4g}, across {inertia[0, 0]:.4g} kg m²"
        why = f"spin is {relative:.3g} m r²; wheels have 0.5 to 1"
        changes.add(Code.INERTIA, location, f"{part}: inertia", was, became, why)
    else:
        inertia = np.diag([across, spin, across])
    _set_wheels(pair, mass.mass, inertia)


def _split(knuckles: tuple[Part, Part], wheels: tuple[Part, Part], radius: float, tree: Tree, changes: Changes) -> None:
    """Take the mass of the knuckles from wheels whose joint steers and spins."""
    whole = wheels[0].mass
    mass = UNION_SHARE * whole.mass
    _set_wheels(wheels, whole.mass - mass, whole.inertia * (1.0 - UNION_SHARE))
    _set_knuckles(knuckles, mass, radius)
    location = tree.model.links[wheels[0].links[0]].where
    became = f"wheel of {whole.mass - mass:.4g} kg and steering knuckle of {mass:.4g} kg"
    why = "mirdrake has separate joints for steering and spin"
    changes.add(Code.MASS, location, "front wheels: mass", f"{whole.mass:.4g} kg", became, why)
