"""Base of the behaviours: ports, period, and a decision that is held until the next."""

import math
from abc import abstractmethod
from typing import NamedTuple

import numpy as np
from pydrake.systems.framework import Context, DiscreteValues

from mirdrake.controllers.ackermann import Ackermann
from mirdrake.controllers.behaviours.fan import BEAMS, Array, Fan, range_signals
from mirdrake.controllers.behaviours.outline import ShapedVehicle, outline_of
from mirdrake.core.checks import check_number
from mirdrake.core.errors import DivergedError
from mirdrake.core.leaf_system import LeafSystem
from mirdrake.core.signals import declare_state_output, declare_vector_input
from mirdrake.core.vectors import COMMAND, STATE, Command


class View(NamedTuple):
    """Inputs of a behaviour at one time.

    Attributes:
        x: position of the vehicle frame B in the world [m].
        y: position [m].
        yaw: direction [rad].
        speed: forward [m/s].
        ranges: the scan (n) [m].
        points: what its beams hit, in B (m, 2) [m].
    """

    x: float
    y: float
    yaw: float
    speed: float
    ranges: Array
    points: Array


class Decision(NamedTuple):
    """Set-points of a behaviour.

    Attributes:
        speed: set-point of the speed [m/s].
        steering: set-point of the bicycle angle [rad].
    """

    speed: float
    steering: float


class Behaviour(LeafSystem):
    """A driver that reads the range scan and decides every `period`.

    Input ports:
        state (12) [m, rad, m/s, rad/s]: :data:`~mirdrake.core.vectors.STATE`.
        ranges (181) [m]: distances from the middle of the front bumper, beams from -90 to 90 degrees.

    Output ports:
        command (3) [m/s, rad, s]: speed, steering, stamp.

    The command is a state, held between the updates: the update at time t reads the inputs at t and shows right after
    t; initialisation shows the first one, so it is right from t = 0.

    State: discrete, group 0 the command, group 1 the memory of the behaviour, NaN before the first decision.

    Args:
        vehicle: vehicle to drive.
        period: time between decisions [s].
        memory: numbers that the behaviour remembers.

    Attributes:
        law: steering law of the vehicle.
        outline: its box.
        fan: the beams of the scan.

    Raises:
        ConfigError: the period is not positive, or the vehicle's lengths are wrong.
        DivergedError: (while running) the vehicle state is not finite.
    """

    def __init__(self, vehicle: ShapedVehicle, *, period: float, memory: int = 0):
        super().__init__()
        self.period = check_number(type(self).__name__, "period", period, unit="s", above=0.0)
        self.law, self.outline = Ackermann(vehicle.geometry), outline_of(vehicle)
        self.fan = Fan(self.outline.front)
        self.state = declare_vector_input(self, "state", STATE)
        self.ranges = declare_vector_input(self, "ranges", range_signals(BEAMS))
        self._command = self.DeclareDiscreteState(len(COMMAND))
        self._memory = self.DeclareDiscreteState(np.full(memory, math.nan))
        self.command = declare_state_output(self, "command", COMMAND, self._command)
        self.DeclareInitializationDiscreteUpdateEvent(self._update)
        self.DeclarePeriodicDiscreteUpdateEvent(period_sec=self.period, offset_sec=0.0, update=self._update)

    @abstractmethod
    def decide(self, view: View, memory: Array) -> Decision:
        """Return the set-points for the present view.

        Deciding twice on the same view must give the same: initialisation and the first update both do.

        Args:
            view: what is known.
            memory: what was remembered; what is written into it is remembered next time.
        """

    def _update(self, context: Context, values: DiscreteValues) -> None:
        x, y, _, _, _, yaw, vx, *_ = self.state.Eval(context).tolist()
        if not math.isfinite(x + y + yaw + vx):
            raise DivergedError(
                f"{type(self).__name__}: the vehicle is at ({x}, {y}); the simulation has become unstable"
            )
        ranges = self.ranges.Eval(context)
        # A copy: `decide` writes into it, and the Context is constant here.
        memory = context.get_discrete_state(self._memory).value().copy()
        speed, steering = self.decide(View(x, y, yaw, vx, ranges, self.fan.points(ranges)), memory)
        values.set_value(self._command, Command(max(speed, 0.0), self.law.clip(steering), context.get_time()))
        values.set_value(self._memory, memory)
