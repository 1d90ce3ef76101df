"""Velocity command interface: limits, rejection of invalid messages, and the dead-man switch.

A command is a message (speed, steering, stamp). The stamp is the time at which the message was made, so that a missing
message can be distinguished from a repeated one. When the last valid message is older than 0.2 s, the speed set-point
becomes zero and the steering angle is held, until the next message (0.2 s and the held angle as in the MIR Bolt and the
CAT Vehicle, whose scripts do not send the zero).
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

from mirdrake.core.checks import check_number
from mirdrake.core.vectors import Setpoint

TOLERANCE = 1e-9
"""Two times closer than this are the same time [s]."""


@dataclass(frozen=True, slots=True)
class CommandLimits:
    """Limits of a velocity command.

    Attributes:
        minimum_speed: lowest speed, negative when reversing is allowed [m/s].
        maximum_speed: highest speed [m/s].
        steering: largest bicycle angle to either side [rad].
        timeout: age of the last message above which the speed becomes zero [s].

    Raises:
        ConfigError: not numbers, or out of order.
    """

    minimum_speed: float = -math.inf
    maximum_speed: float = math.inf
    steering: float = math.inf
    timeout: float = 0.2

    def __post_init__(self) -> None:
        owner = "CommandLimits"
        check_number(owner, "minimum_speed", self.minimum_speed, unit="m/s", infinite=True, at_most=0.0)
        check_number(owner, "maximum_speed", self.maximum_speed, unit="m/s", infinite=True, at_least=0.0)
        check_number(owner, "steering", self.steering, unit="rad", infinite=True, at_least=0.0)
        check_number(owner, "timeout", self.timeout, unit="s", infinite=True, above=0.0)


class CommandState(NamedTuple):
    """The last good message.

    Attributes:
        speed: as received [m/s].
        steering: as received [rad].
        stamp: when it was made [s]; -inf: there was none yet.
    """

    speed: float = 0.0
    steering: float = 0.0
    stamp: float = -math.inf


class CommandResult(NamedTuple):
    """Result of a message.

    Attributes:
        setpoint: speed and steering within the limits.
        alive: False when the dead-man holds the speed at zero.
    """

    setpoint: Setpoint
    alive: bool


NO_COMMAND_LIMITS = CommandLimits()


def command_step(
    state: CommandState,
    speed: float,
    steering: float,
    stamp: float,
    time: float,
    limits: CommandLimits = NO_COMMAND_LIMITS,
) -> tuple[CommandState, CommandResult]:
    """Process a message, which may be new, repeated or invalid.

    A message counts when its three numbers are finite and its stamp is neither older than the last one's nor in the
    future. Anything else is not a message, and the last valid one grows older.

    Args:
        state: what the last step returned; ``CommandState()`` at first.
        speed: set-point of the speed [m/s].
        steering: set-point of the bicycle angle [rad].
        stamp: when the message was made [s].
        time: now [s].
        limits: limits and timeout.

    Returns:
        The state for the next step, and the set-point.
    """
    # One test for three numbers: a sum with NaN or an infinity is not finite.
    if math.isfinite(speed + steering + stamp) and state.stamp <= stamp <= time + TOLERANCE:
        state = CommandState(speed, steering, stamp)
    alive = time - state.stamp <= limits.timeout + TOLERANCE
    last_steering = min(max(state.steering, -limits.steering), limits.steering)
    speed_setpoint = min(max(state.speed, limits.minimum_speed), limits.maximum_speed) if alive else 0.0
    return state, CommandResult(Setpoint(speed_setpoint, last_steering), alive)
