"""Base of models that are simulated as a whole: derivatives are differences between complete runs."""

from abc import abstractmethod
from collections.abc import Mapping

from mirdrake.identification.models.base import Array, Model, Segment


class SimulatedModel(Model):
    """Model whose runs are made by another simulator."""

    difference_step = 0.01
    """Change of a scaled parameter or state for a derivative: contact forces are not smooth on a smaller scale."""

    tolerance = 3e-4

    @abstractmethod
    def run(self, p: Mapping[str, float], drive: Segment, first: Array) -> tuple[Array, Array] | None:
        """Return the sensor readings (outputs, n) and the state after the last sample (states).

        Args:
            p: parameters.
            drive: recorded channels.
            first: state at the first sample (states).

        Returns:
            None if the run fails.
        """
