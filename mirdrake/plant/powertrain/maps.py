"""Tables of pedals and torques with linear interpolation, constant outside, and their inverse."""

from collections.abc import Sequence

from mirdrake.vehicles.powertrain_spec import Pedals

Rows = Sequence[tuple[float, float]]
"""Rows (argument, value) with ascending arguments."""


def read_map(rows: Rows, argument: float) -> float:
    """Return the value of a table at an argument."""
    if argument <= rows[0][0]:
        return rows[0][1]
    x0, y0 = rows[0]
    for x1, y1 in rows:
        if argument < x1:
            return y0 + (y1 - y0) * (argument - x0) / (x1 - x0)
        x0, y0 = x1, y1
    return y0


def invert_map(rows: Rows, value: float) -> float:
    """Return the smallest argument at which a table with rising values reaches a value; the last one if it never does.

    For a value not above the first row's it is 0, not the end of the dead zone.
    """
    x0, y0 = rows[0]
    if value <= y0:
        return 0.0
    for x1, y1 in rows:
        if value <= y1:
            return x0 + (x1 - x0) * (value - y0) / (y1 - y0)
        x0, y0 = x1, y1
    return x0


class PedalMaps:
    """Maps of the pedals of a vehicle, and their inverse.

    Attributes:
        throttle: rows of pedal position [1] and share of the drive torque [1].
        brake: rows of pedal position [1] and torque of the four brakes [N m].

    Args:
        pedals: pedals of vehicle.yaml.
        brake_torque: largest torque of all brakes together [N m].
    """

    def __init__(self, pedals: Pedals, *, brake_torque: float) -> None:
        self.throttle: Rows = pedals.throttle or [(0.0, 0.0), (1.0, 1.0)]
        # No pedal gives more than the brakes have; the last piece is a line to full torque.
        brake = [(pedal, min(torque, brake_torque)) for pedal, torque in pedals.brake] or [(0.0, 0.0)]
        if brake[-1][0] < 1.0:
            brake.append((1.0, brake_torque))
        self.brake: Rows = brake

    def throttle_position(self, share: float) -> float:
        """Return the pedal position [1] for a share of the drive torque [1]."""
        return invert_map(self.throttle, share)

    def brake_position(self, torque: float) -> float:
        """Return the pedal position [1] for a torque of the four brakes [N m]."""
        return invert_map(self.brake, torque)
