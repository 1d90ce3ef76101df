"""Maps of the pedals: tables from their positions to drive torque and brake torque."""

from mirdrake.core.interpolation import Rows
from mirdrake.vehicles.powertrain_spec import Pedals


class PedalMaps:
    """Maps of the pedals of a vehicle.

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
