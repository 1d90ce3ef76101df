"""Bases of models with equations of motion, which the estimators integrate, in arrays or by machine code."""

from abc import abstractmethod
from collections.abc import Mapping, Sequence

from mirdrake.batched.log_runs import LogRuns
from mirdrake.identification.models.base import Array, Model, Segment, Values


class EquationModel(Model):
    """Equations ẋ = f(x, u, p), y = h(x, u, p).

    Attributes:
        input_parameters: parameters that change :meth:`input_signals`.
    """

    input_parameters: frozenset[str] = frozenset()

    @abstractmethod
    def input_signals(self, p: Mapping[str, float], drive: Segment, times: Array) -> Array:
        """Return the inputs of the equations (inputs, times).

        Args:
            p: parameters.
            drive: recorded channels.
            times: relative to the first sample, evenly spaced [s].
        """

    @abstractmethod
    def rates(self, x: Array, u: Array, p: Values) -> Array:
        """Return the time derivatives of the states.

        Args:
            x: states (states, columns, shots).
            u: inputs (inputs, columns, shots).
            p: parameters (columns, 1) each.
        """

    @abstractmethod
    def observe(self, x: Array, u: Array, p: Values) -> Array:
        """Return the sensor readings of :attr:`outputs` (outputs, …); arguments as in :meth:`rates`, or more axes."""


class CompiledModel(EquationModel):
    """Equations that are also available as machine code for complete runs.

    Attributes:
        uses_machine_code: whether estimators use it; the equations give the same runs, more slowly.
        sensor_parameters: parameters that change the outputs only, not the states.
    """

    uses_machine_code: bool = True
    sensor_parameters: frozenset[str] = frozenset()

    @abstractmethod
    def run_log(
        self, columns: Sequence[Mapping[str, float]], inputs: Array, rows: Sequence[int], starts: Array, step: float,
        substeps: int, follows: Sequence[bool],
    ) -> LogRuns:  # fmt: skip
        """Return complete runs along a log by machine code.

        Args:
            columns: parameters of each run (n).
            inputs: sets of inputs at the ends and middles of the steps (sets, times, inputs).
            rows: index of the inputs of each run (n).
            starts: initial states (n, states).
            step: step of the integration [s].
            substeps: steps per sample.
            follows: whether a run differs from the first one by its initial state and sensor parameters only (n).
        """
