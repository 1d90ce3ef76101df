"""Models that are simulated as a whole: no rates to batch, derivatives by whole runs beside the first one."""

from abc import abstractmethod
from collections.abc import Mapping

from mirdrake.identification.models.base import Array, Model, Segment, Values


class SimulatedModel(Model):
    """A model whose runs are made elsewhere."""

    difference_step = 0.01
    """Change of a scaled parameter or a state for a derivative: contact is not smooth in smaller ones."""

    tolerance = 3e-4

    @abstractmethod
    def run(self, p: Mapping[str, float], drive: Segment, first: Array) -> tuple[Array, Array] | None:
        """What the sensors show (outputs, n), and the state behind the last sample (states).

        Args:
            p: parameters.
            drive: recorded channels.
            first: state at the first sample (states).

        Returns:
            None if the run fails.
        """

    def input_signals(self, p: Mapping[str, float], drive: Segment, times: Array) -> Array:
        """Not used: a run reads the drive itself."""
        raise NotImplementedError

    def rates(self, x: Array, u: Array, p: Values) -> Array:
        """Not used: there is no equation."""
        raise NotImplementedError

    def observe(self, x: Array, u: Array, p: Values) -> Array:
        """Not used: a run gives the outputs."""
        raise NotImplementedError
