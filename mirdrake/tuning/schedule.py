"""PID controller with gains scheduled over speed, as a block of a diagram."""

import math
from collections.abc import Sequence

from pydrake.systems.framework import Context

from mirdrake.controllers.pid import DiscretePid
from mirdrake.core.pid import NO_LIMITS, PidGains, PidLimits
from mirdrake.core.signals import declare_vector_input, signals
from mirdrake.vehicles.joint_control import GainTable


class ScheduledPid(DiscretePid):
    """A PID controller whose gains follow a :class:`GainTable`.

    In a diagram file::

        systems:
          cruise: {kind: "mirdrake.tuning.schedule:ScheduledPid", speeds: [5, 25], kp: [2, 1], period: 0.02}

    Input ports:
        reference (1), measurement (1): see :class:`~mirdrake.controllers.pid.DiscretePid`.
        schedule (1) [m/s]: speed at which the gains are read at every update; the control does not jump.

    Output ports:
        control (1): see there.

    Args:
        speeds: of the table [m/s], increasing.
        kp: proportional gain at each speed.
        ki: integral gain at each speed; default 0.
        kd: derivative gain at each speed; default 0.
        period: time between updates [s].
        filter_time: of the derivative [s].
        minimum: smallest control.
        maximum: largest control.

    Raises:
        ConfigError: speeds that do not increase, rows of other lengths, or values out of range.
    """

    def __init__(
        self,
        speeds: Sequence[float],
        kp: Sequence[float],
        ki: Sequence[float] | None = None,
        kd: Sequence[float] | None = None,
        *,
        period: float,
        filter_time: float = 0.0,
        minimum: float = -math.inf,
        maximum: float = math.inf,
    ) -> None:
        given = {"kp": kp, "ki": ki, "kd": kd}
        rows = {name: tuple(map(float, values)) for name, values in given.items() if values is not None}
        self.table = GainTable(tuple(map(float, speeds)), rows)
        self._filter_time = filter_time
        limits = PidLimits(minimum, maximum) if (minimum, maximum) != (-math.inf, math.inf) else NO_LIMITS
        super().__init__(self._gains_at(self.table.speeds[0]), period=period, limits=limits)
        self.schedule = declare_vector_input(self, "schedule", signals(("speed", "m/s")))

    def get_gains(self, context: Context) -> PidGains:
        """Return the gains of the table at the speed of the input port."""
        return self._gains_at(self.schedule.Eval(context).item())

    def _gains_at(self, speed: float) -> PidGains:
        return PidGains(**self.table.at(speed), filter_time=self._filter_time)
