"""Blocks that feed recorded inputs into a plant: tables and wheel torques; their values live in a Context."""

import numpy as np
from pydrake.common.value import Value
from pydrake.systems.framework import BasicVector, Context

from mirdrake.core.leaf_system import LeafSystem
from mirdrake.identification.models.base import Array

SMOOTH_SPIN = 0.3
"""Wheel speed below which its rolling resistance fades [rad/s], as that of the tyres."""


class Table(LeafSystem):  # type: ignore[misc, unused-ignore]
    """Values over time, linear in between, held before the first and after the last.

    Output port:
        y (size).

    Abstract parameter 0 of the Context: times (n) [s] and values (size, n).

    Args:
        size: number of values.
    """

    def __init__(self, size: int) -> None:
        super().__init__()
        self.size = int(size)
        self._rows = self.DeclareAbstractParameter(Value[object]((np.zeros(1), np.zeros((self.size, 1)))))
        # The output depends on time and table only, so that Drake keeps it while other parts of the Context change.
        needs = {self.time_ticket(), self.all_parameters_ticket()}
        self.y = self.DeclareVectorOutputPort("y", self.size, self._calc, prerequisites_of_calc=needs)

    def set_rows(self, context: Context, times: Array, values: Array) -> None:
        """Write the table into a Context of this system.

        Args:
            context: context of this system, changed.
            times: rising (n) [s].
            values: (size, n).
        """
        context.get_mutable_abstract_parameter(self._rows).set_value((times, values))

    def _calc(self, context: Context, output: BasicVector) -> None:
        times, values = context.get_abstract_parameter(self._rows).get_value()
        now = context.get_time()
        output.SetFromVector([float(np.interp(now, times, row)) for row in values])


class WheelMoments(LeafSystem):  # type: ignore[misc, unused-ignore]
    """Adds a rolling-resistance moment to the drive torques of the wheels.

    Input ports:
        torque (8) [N m]: drive torques of the wheels, then the torques that their brakes can give.
        spins (4) [rad/s]: wheel speeds.
    Output port:
        y (8) [N m].

    Parameter 0 of the Context: moment against the rolling of each wheel (4) [N m].
    """

    def __init__(self) -> None:
        super().__init__()
        self.torque = self.DeclareVectorInputPort("torque", 8)
        self.spins = self.DeclareVectorInputPort("spins", 4)
        self._moments = self.DeclareNumericParameter(BasicVector([0.0] * 4))
        self.y = self.DeclareVectorOutputPort("y", 8, self._calc)

    def set_moments(self, context: Context, moments: Array) -> None:
        """Write the moments (4) [N m] into a Context of this system."""
        context.get_mutable_numeric_parameter(self._moments).SetFromVector(moments)

    def _calc(self, context: Context, output: BasicVector) -> None:
        # A copy: Eval returns the cache of the source.
        values = self.torque.Eval(context).copy()
        moments = context.get_numeric_parameter(self._moments).value()
        if moments.any():
            values[:4] -= moments * np.tanh(self.spins.Eval(context) / SMOOTH_SPIN)
        output.SetFromVector(values)
