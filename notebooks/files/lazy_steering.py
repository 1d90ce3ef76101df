"""A steering actuator with a lag."""

from math import exp

from mirdrake.core.leaf_system import LeafSystem  # pydrake's, and freed with its diagram
from mirdrake.core.signals import declare_state_output, declare_vector_input, signals

ANGLE = signals(("steering", "rad"))


class LazySteering(LeafSystem):
    """A first-order lag.

    Input ports:
        u (1) [rad]: commanded angle.
    Output ports:
        y (1) [rad]: actual angle.

    Args:
        time_constant: of the lag [s].
        period: between updates [s].
    """

    def __init__(self, time_constant: float, period: float = 0.01):
        super().__init__()
        self.share = 1.0 - exp(-period / time_constant)
        self.angle = self.DeclareDiscreteState(1)
        self.u = declare_vector_input(self, "u", ANGLE)
        self.y = declare_state_output(self, "y", ANGLE, self.angle)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self.update)

    def update(self, context, state):
        y = context.get_discrete_state(self.angle).value()[0]
        state.set_value(self.angle, [y + self.share * (self.u.Eval(context)[0] - y)])
