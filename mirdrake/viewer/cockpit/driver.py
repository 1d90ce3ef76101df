"""The driver of a cockpit: a system whose output is what hands command."""

from pydrake.systems.framework import BasicVector, Context

from mirdrake.core.leaf_system import LeafSystem
from mirdrake.core.signals import declare_vector_output
from mirdrake.core.vectors import COMMAND

KIND = f"{__name__}:HumanDriver"
"""Of this driver in a diagram file."""


class HumanDriver(LeafSystem):
    """Commands what it was told last.

    Output ports:
        command (3) [m/s, rad, s]: speed, steering, and now as the stamp. It changes while a simulation runs, by
            :meth:`tell` between two calls of ``AdvanceTo``; so a simulation with it is as reproducible as its driver.
            Run folders keep the commands, and repeat them.
    """

    def __init__(self) -> None:
        super().__init__()
        self._told = (0.0, 0.0)
        self.command = declare_vector_output(self, "command", COMMAND, self._calc, prerequisites=[self.time_ticket()])

    def tell(self, speed: float, steering: float) -> None:
        """Command this from now on.

        Args:
            speed: wanted [m/s].
            steering: wanted bicycle angle [rad].
        """
        self._told = (speed, steering)

    def _calc(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector([*self._told, context.get_time()])
