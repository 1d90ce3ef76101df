"""Distribution of drive and brake torque: axles, open differentials, regenerative and friction brakes.

Torques of four wheels are in the order front left, front right, rear left, rear right.
"""

from typing import NamedTuple

Four = tuple[float, float, float, float]


class AxleShares(NamedTuple):
    """Shares of the axles in the drive torque [1]; their sum is 1."""

    front: float
    rear: float


def drive_shares(drive: str, front_share: float) -> AxleShares:
    """Return the shares of the axles: one axle, or `front_share` with all wheels driven."""
    front = {"front": 1.0, "rear": 0.0}.get(drive, front_share)
    return AxleShares(front, 1.0 - front)


def split_drive(torque: float, shares: AxleShares) -> Four:
    """Return the torques of the wheels [N m]; an open differential gives both wheels of an axle the same torque."""
    front, rear = 0.5 * shares.front * torque, 0.5 * shares.rear * torque
    return front, front, rear, rear


def driven_rate(rates: Four, shares: AxleShares) -> float:
    """Return the spin rate at the input of the differentials [rad/s], which have no losses."""
    front_left, front_right, rear_left, rear_right = rates
    return 0.5 * (shares.front * (front_left + front_right) + shares.rear * (rear_left + rear_right))


def split_brakes(
    torque: float, front_share: float, generator: float, shares: AxleShares, motor_first: bool = False
) -> tuple[float, Four]:
    """Divide a braking torque between motor and friction brakes.

    The motor brakes first, up to its limit. By default the share of each axle does not depend on the source.

    Args:
        torque: demanded torque of all wheels together [N m].
        front_share: share of the front axle [1].
        generator: largest braking torque of the motor at the wheels [N m], positive.
        shares: distribution of the motor torque to the axles.
        motor_first: whether the motor provides the whole torque up to its limit, and the friction brakes the rest.

    Returns:
        torque of the motor at the wheels [N m], positive, and the brake torques of the wheels [N m].
    """
    if motor_first:
        motor = min(generator, torque)
        front, rear = 0.5 * (torque - motor) * front_share, 0.5 * (torque - motor) * (1.0 - front_share)
        return motor, (front, front, rear, rear)
    front, rear = torque * front_share, torque * (1.0 - front_share)
    # Motor torque is divided by `shares`: it may rise until one driven axle has its whole share from the motor.
    motor = generator
    if shares.front > 0.0:
        motor = min(motor, front / shares.front)
    if shares.rear > 0.0:
        motor = min(motor, rear / shares.rear)
    left_front, left_rear = 0.5 * (front - motor * shares.front), 0.5 * (rear - motor * shares.rear)
    return motor, (left_front, left_front, left_rear, left_rear)


BRAKE_PARTS = (split_drive, driven_rate, split_brakes)
"""Functions that can be compiled."""
