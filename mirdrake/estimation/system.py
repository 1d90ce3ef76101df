"""A filter bank as a LeafSystem, and ``kind: filter_bank`` of diagram files."""

import numpy as np
from pydantic import Field
from pydrake.systems.framework import Context, DiscreteValues

from mirdrake.core.leaf_system import LeafSystem
from mirdrake.core.signals import Signal, declare_state_output, declare_vector_input, signals
from mirdrake.estimation.bank import FilterBank, filter_bank
from mirdrake.estimation.spec import SENSORS, FilterSpec

FORCES = signals(
    ("drive", "N", "drive force at the road, negative for engine braking"),
    ("brake", "N", "brake force at the road, positive"),
)
"""Input port of known forces."""


class OnlineFilter(LeafSystem):  # type: ignore[misc, unused-ignore]
    """Filter bank that estimates states and parameters of a car while it drives.

    At each sampling time it takes the present measurements, and outputs the estimates right after that time, over all
    hypotheses with their weights. A measurement that is not a number is missing.

    Input ports:
        steering, vx, yaw_rate, …: a port (1) for each sensor, in the unit of the sensor.
        forces (2) [N]: :data:`FORCES`, if `known_forces`.

    Output ports:
        estimate (q): means of the states, accelerations that the model lacks, and slow quantities, by name.
        deviation (q): their standard deviations.
        weights (n) [1]: probability of each hypothesis.
        consistent (1) [1]: 1 if the innovations of the most probable filter agree with its model and noise.

    Args:
        bank: the filters, which begin anew.
        known_forces: whether drive and brake force are inputs.
    """

    def __init__(self, bank: FilterBank, *, known_forces: bool = False) -> None:
        super().__init__()
        self.bank = bank
        self._sensors = [declare_vector_input(self, name, [Signal(name, SENSORS[name][0])]) for name in bank.sensors]
        self._forces = declare_vector_input(self, "forces", FORCES) if known_forces else None
        # The memory of the filters is a state of the Context, so that several Contexts do not disturb each other.
        start = bank.reset().memory
        self._memory = self.DeclareDiscreteState(start)
        contents = bank.signals
        weights = [Signal(f"weight_{name}".replace(" ", "_"), "", f"of the hypothesis {name}") for name in bank.filters]
        outputs = {
            "estimate": contents,
            "deviation": contents,
            "weights": weights,
            "consistent": [Signal("consistent", "", "1: innovations agree with model and noise")],
        }
        self._held = []
        for name, elements in outputs.items():
            initial = bank.weights if name == "weights" else np.zeros(len(elements))
            self._held.append(self.DeclareDiscreteState(initial))
            declare_state_output(self, name, elements, self._held[-1])
        self.DeclarePeriodicDiscreteUpdateEvent(bank.spec.period, 0.0, self._update)

    def _update(self, context: Context, state: DiscreteValues) -> None:
        """Advance the filters by a sample."""
        bank = self.bank
        bank.memory = context.get_discrete_state(self._memory).value()
        forces = None if self._forces is None else self._forces.Eval(context)
        found = bank.step(np.array([port.Eval(context)[0] for port in self._sensors]), forces)
        combined = [found.combined(name) for name in bank.names]
        best = int(np.argmax(bank.weights))
        values = (
            [mean[0] for mean, _ in combined],
            [deviation[0] for _, deviation in combined],
            bank.weights,
            [float(found.consistent[best, 0])],
        )
        state.set_value(self._memory, bank.memory)
        for index, value in zip(self._held, values, strict=True):
            state.set_value(index, value)


class FilterBlock(FilterSpec):
    """A filter bank. Inputs: a port for each sensor. Outputs estimate, deviation, weights, consistent."""

    vehicle: str = Field(description="vehicle whose parameters the filters begin with [-]")
    known_forces: bool = Field(default=False, description="whether drive and brake force are an input, `forces` [-]")

    def make(self) -> OnlineFilter:
        """Return the system."""
        spec = FilterSpec(**{name: getattr(self, name) for name in FilterSpec.model_fields})
        return OnlineFilter(filter_bank(self.vehicle, spec), known_forces=self.known_forces)
