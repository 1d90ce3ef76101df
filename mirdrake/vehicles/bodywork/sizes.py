"""Size of a body, and the room that its wheels need."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from mirdrake.core.errors import ModelError

STEERING = 0.65
"""Largest angle of a front wheel that the wheel arches leave room for [rad]."""


@dataclass(frozen=True)
class BodySize:
    """Main dimensions of a vehicle's looks [m].

    Attributes:
        wheelbase: distance of the axles.
        track: distance between the middle planes of the wheels; of the wider axle, if they differ.
        length: length of the body.
        width: width of the body, without mirrors.
        height: height of the body above the road.
        wheel_radius: radius of the tyres.
        wheel_width: width of the tyres.
        ground_clearance: height of the underside of the body.
        front_overhang: distance from the front axle to the front end.
    """

    wheelbase: float
    track: float
    length: float
    width: float
    height: float
    wheel_radius: float
    wheel_width: float
    ground_clearance: float
    front_overhang: float

    @property
    def front(self) -> float:
        """Return the x coordinate of the front end [m]."""
        return self.wheelbase + self.front_overhang

    def check(self) -> None:
        """Check that the dimensions make a vehicle.

        Raises:
            ModelError: the dimensions contradict each other.
        """
        for item in fields(self):
            value = getattr(self, item.name)
            if not (np.isfinite(value) and value > 0):
                raise ModelError(f"{item.name} of the body is {value:g} m; it must be positive")
        if self.front_overhang >= self.length - 0.5 * self.wheelbase or self.ground_clearance >= 0.8 * self.height:
            raise ModelError(
                f"a body of length {self.length:g} m, front overhang {self.front_overhang:g} m, height "
                f"{self.height:g} m and ground clearance {self.ground_clearance:g} m has no room for a cabin; check "
                "these four dimensions"
            )


def arch_clearance(radius: float, width: float, steering: float = STEERING) -> tuple[float, float]:
    """Return how far a steered wheel reaches: from its axle's line in the side view, and inwards from its middle [m].

    The wheel is a cylinder that turns by ``steering`` about the vertical axis through its centre. A point of its rim at
    the angle φ lies at x = R cos φ cos δ + w/2 sin δ and z = R sin φ.
    """
    # The largest distance has no simple closed form; a fine table is exact enough for a clearance.
    phi = np.linspace(0.0, np.pi / 2, 721)
    s, c = np.sin(abs(steering)), np.cos(steering)
    reach = np.hypot(radius * np.cos(phi) * c + width / 2 * s, radius * np.sin(phi))
    return float(reach.max()), float(radius * s + width / 2 * c)
