"""Plausibility checks of the figures of a vehicle."""

import math

from mirdrake.vehicles.estimates import ROBOT_MASS
from mirdrake.vehicles.figures import Inspection, JointRole, LinkFigures
from mirdrake.vehicles.vehicle import Vehicle

SPIN_FACTORS = (0.4, 1.0)
"""Plausible spin inertia of a wheel over m R²: a solid disc has 0.5, a hoop 1."""

SIZE_RATIOS = (1.0 / 4.0, 1.5)
"""Plausible length of the equivalent inertia box over the length of the collision shapes."""

DYNAMIC_INDICES = ((0.46, 0.96), (0.68, 1.10))
"""Least and largest yaw inertia over m a b of published robots below 100 kg and of heavier vehicles.

These are the vehicles of tests/data/yaw_inertias.csv: among robots, F1TENTH has the least and BARC the largest.
"""

LEAST_MISFIT = 1.5
"""Least factor between the ratio of roll to pitch inertia and that of a homogeneous box where an exchange is suspected.

Masses are not distributed as in a box: vehicles whose moments are nearly equal differ from it by less.
"""

MOST_FRICTION = 2.0
"""Largest plausible friction coefficient; racing tyres on a clean track stay below."""


def find_oddities(figures: Inspection, vehicle: Vehicle) -> list[str]:
    """Return a message for each implausible figure.

    Args:
        figures: figures of the vehicle.
        vehicle: the vehicle, for its limits and the sources of its numbers.
    """
    return [
        *_balance(figures),
        *(line for link in figures.links for line in _odd_link(link, figures)),
        *_contact(figures),
        *_limits(figures, vehicle),
        *(f"vehicle.yaml: no source for {path}" for path in vehicle.spec.numbers_without_source()),
    ]


def _balance(figures: Inspection) -> list[str]:
    """Centre of mass and inertia of the whole vehicle."""
    messages = []
    x, y, z = figures.com
    # Ranges are wide: a message here should be right for any wheeled vehicle, from a robot to a lorry.
    if not 0.0 < x < figures.wheelbase:
        messages.append(
            f"centre of mass {x:.3f} m ahead of the rear axle: not between the axles, the vehicle tips over"
        )
    elif not 0.25 < figures.front_share < 0.75:
        messages.append(f"{100.0 * figures.front_share:.0f} % of the weight is on the front axle; cars have 40 to 65 %")
    if z <= 0.0:
        messages.append(f"centre of mass {-z:.3f} m below the road: load transfer has the wrong sign")
    elif figures.static_stability < 1.0:
        messages.append(
            f"centre of mass {z:.3f} m above the road: tips at {figures.static_stability:.2f} g sideways, "
            "before it slides"
        )
    if abs(y) > 0.02 * figures.tracks[1]:
        messages.append(f"centre of mass {abs(y):.3f} m to the {'left' if y > 0.0 else 'right'}")
    # Outside of what is published, with margins, the masses are probably wrong. Robots have their mass nearer to the
    # middle than cars; up to twice their mass the limits are theirs.
    robots, cars = DYNAMIC_INDICES
    least = 0.75 * (robots if figures.mass < 2.0 * ROBOT_MASS else cars)[0]
    if not least < figures.dynamic_index < 4.0 / 3.0 * cars[1]:
        messages.append(
            f"yaw inertia {figures.inertia[2]:.4g} kg m²: {figures.dynamic_index:.2f} m a b; cars have {cars[0]:.2f} "
            f"to {cars[1]:.2f}, robots below {ROBOT_MASS:.0f} kg {robots[0]:.2f} to {robots[1]:.2f}"
        )
    return [*messages, *_exchanged_axes(figures)]


def _exchanged_axes(figures: Inspection) -> list[str]:
    """Return a message if roll and pitch inertia fit a box of the vehicle's size better when they are exchanged."""
    length, width, height = figures.size
    roll, pitch, _ = figures.inertia
    expected = (width**2 + height**2) / (length**2 + height**2)
    # Roll over pitch inertia relative to that of a homogeneous box, as they are and exchanged; 0 is the box's ratio.
    given, exchanged = (abs(math.log(ratio / expected)) for ratio in (roll / pitch, pitch / roll))
    if roll < pitch or given < math.log(LEAST_MISFIT) or exchanged > 0.5 * given:
        return []
    return [
        f"roll inertia {roll:.4g} kg m² exceeds pitch inertia {pitch:.4g} kg m², but the vehicle is {length:.3g} m "
        f"long and {width:.3g} m wide; are x and y exchanged?"
    ]


def _odd_link(link: LinkFigures, figures: Inspection) -> list[str]:
    """Return messages on the inertia and the friction of a link."""
    messages = []
    small, middle, large = link.moments
    # Wheels are judged by their axis of rotation, other links by the box that their inertia implies.
    if link.spin is not None:
        if not SPIN_FACTORS[0] <= link.spin <= SPIN_FACTORS[1]:
            messages.append(
                f"wheel '{link.name}': inertia about its axis is {link.spin:.2f} m R²; a disc has 0.5, a hoop 1"
            )
        elif link.spin_is_smaller:
            messages.append(
                f"wheel '{link.name}': its largest moment of inertia, {large:.4g} kg m², is not about the axis that "
                "it turns about; are two moments exchanged?"
            )
    elif link.size_ratio is not None and not SIZE_RATIOS[0] <= link.size_ratio <= SIZE_RATIOS[1]:
        messages.append(
            f"link '{link.name}': inertia of a box {link.edges[0]:.3g} m long, but its shapes measure "
            f"{link.extent[0]:.3g} m"
        )
    # Equality in the triangle inequality: all mass in one plane, which a heavy part of a vehicle never has.
    if link.spin is None and link.triangle is not None and link.triangle < 1.001 and link.mass > 0.05 * figures.mass:
        messages.append(f"link '{link.name}': inertia of a flat plate ({small:.4g} + {middle:.4g} = {large:.4g} kg m²)")
    if link.friction is not None and link.friction > MOST_FRICTION:
        messages.append(f"link '{link.name}': friction {link.friction:g}; tyres on dry asphalt have about 1")
    return messages


def _contact(figures: Inspection) -> list[str]:
    """Return messages on wheels that overlap other links, and on the ground clearance."""
    messages = [
        f"wheel '{overlap.wheel}' sticks {1000.0 * overlap.depth:.0f} mm deep in '{overlap.link}' {overlap.pose}"
        for overlap in figures.overlaps
    ]
    if figures.ground_clearance < 0.02 * figures.wheelbase:
        messages.append(f"ground clearance {figures.ground_clearance:.3f} m; the body may scrape")
    return messages


def _limits(figures: Inspection, vehicle: Vehicle) -> list[str]:
    """Return messages on joints without limits."""
    messages = []
    for joint in figures.joints:
        if joint.role is JointRole.STEERING and math.isinf(vehicle.geometry.steering_rate):
            messages.append(f"joint '{joint.name}': no limit of its rate; the steering jumps")
        elif joint.role.is_wheel and math.isinf(joint.velocity):
            messages.append(f"joint '{joint.name}': no limit of its speed")
        if math.isinf(joint.effort):
            messages.append(f"joint '{joint.name}': no effort limit; it can give any torque")
    return messages
