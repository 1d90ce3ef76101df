"""The driver of a cockpit: a system that outputs the manual command."""

from pydrake.systems.framework import BasicVector, Context

from mirdrake.core.leaf_system import LeafSystem
from mirdrake.core.signals import declare_vector_output
from mirdrake.core.vectors import COMMAND

KIND = f"{__name__}:HumanDriver"
"""Kind of this driver in a diagram file."""


class HumanDriver(LeafSystem):
    """Outputs the latest command.

    Output ports:
        command (3) [m/s, rad, s]: speed, steering, and the time as the stamp. :meth:`set_command` changes it between
            two calls of ``AdvanceTo``. Run folders record the commands, so that a drive can be repeated.
    """

    def __init__(self) -> None:
        super().__init__()
        self._command = (0.0, 0.0)
        self.command = declare_vector_output(self, "command", COMMAND, self._calc, prerequisites=[self.time_ticket()])

    def set_command(self, speed: float, steering: float) -> None:
        """Set the command.

        Args:
            speed: [m/s].
            steering: angle of the single-track model [rad].
        """
        self._command = (speed, steering)

    def _calc(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector([*self._command, context.get_time()])
