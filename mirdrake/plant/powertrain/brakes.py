"""Where drive and brake torque go: axles, open differentials, and what the motor brakes in place of the brakes.

Torques of four wheels are in the order front left, front right, rear left, rear right.
"""

from typing import NamedTuple

Four = tuple[float, float, float, float]


class AxleShares(NamedTuple):
    """Parts of the drive torque [1]; they add up to 1."""

    front: float
    rear: float


def drive_shares(drive: str, front_share: float) -> AxleShares:
    """Parts of the axles: one of them, or as stated with all wheels driven."""
    front = {"front": 1.0, "rear": 0.0}.get(drive, front_share)
    return AxleShares(front, 1.0 - front)


def split_drive(torque: float, shares: AxleShares) -> Four:
    """Torques of the wheels [N m]: an open differential gives both wheels of an axle the same."""
    front, rear = 0.5 * shares.front * torque, 0.5 * shares.rear * torque
    return front, front, rear, rear


def driven_rate(rates: Four, shares: AxleShares) -> float:
    """Spin rate in front of the differentials [rad/s], so that no power is lost in them."""
    front_left, front_right, rear_left, rear_right = rates
    return 0.5 * (shares.front * (front_left + front_right) + shares.rear * (rear_left + rear_right))


def split_brakes(torque: float, front_share: float, *, generator: float, shares: AxleShares) -> tuple[float, Four]:
    """What the motor and what the brakes of the wheels do of a braking torque.

    Each axle keeps its part of the torque, whoever gives it: the motor first, up to what it can.

    Args:
        torque: asked for, at all wheels together [N m].
        front_share: part of the front axle [1].
        generator: largest braking torque of the motor at the wheels [N m], positive.
        shares: how the differentials share it.

    Returns:
        torque of the motor at the wheels [N m], positive, and the brake torques of the wheels [N m].
    """
    front, rear = torque * front_share, torque * (1.0 - front_share)
    wanted = [axle / share for axle, share in ((front, shares.front), (rear, shares.rear)) if share > 0.0]
    motor = min(generator, *wanted)
    left_front, left_rear = 0.5 * (front - motor * shares.front), 0.5 * (rear - motor * shares.rear)
    return motor, (left_front, left_front, left_rear, left_rear)
