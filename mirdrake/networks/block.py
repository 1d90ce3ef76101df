"""``kind: network``: a block that evaluates the network of an ONNX file at a rate, with a latency."""

from math import floor, inf
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context, DiscreteValues, InputPort, System
from pydrake.systems.sensors import ImageDepth32F, ImageRgba8U

from mirdrake.core.errors import ConfigError
from mirdrake.core.leaf_system import LeafSystem
from mirdrake.core.signals import declare_state_output, declare_vector_input, signals
from mirdrake.core.yaml_io import Duration, Frequency, Schema
from mirdrake.networks.onnx_file import NetworkInput, OnnxNetwork

DEFAULT_RATE = 20.0
"""Evaluations per second of a network whose file does not state a rate [Hz]."""


class NetworkBlock(Schema):
    """A network in an ONNX file. Inputs: `image` and vectors by their names in the file. Output y."""

    file: str = Field(description="path of the ONNX file, relative to the diagram file [-]")
    image: str | None = Field(
        None, description="camera whose colours the input `image` takes, or an output port with pictures [-]"
    )
    rate: Frequency | None = Field(
        None, gt=0.0, le=1000.0, description="evaluations per second [Hz]; by default that in the file, or 20 Hz"
    )
    latency: Duration = Field(
        0.0, ge=0.0, le=10.0, description="time from reading the inputs to the output, in simulated time [s]"
    )
    initial: list[float] | None = Field(None, min_length=1, description="output before the first result; zero [-]")

    def make(self) -> System:
        """Return the system.

        Raises:
            ConfigError: the file is not a network with pictures and vectors, or `initial` has another size.
            MissingDependencyError: ONNX Runtime is not installed.
        """
        network = OnnxNetwork(Path(self.file))
        return Network(network, rate=self.rate, latency=self.latency, initial=self.initial)


class Network(LeafSystem):  # type: ignore[misc, unused-ignore]
    """Network that is evaluated at a rate; between two evaluations the output is held.

    An evaluation at time t reads the inputs at t. A camera of the same rate and without latency has taken its picture
    by then. The result is at the output from right after t + latency. Before the first picture of a camera the network
    is not evaluated.

    Input ports:
        image: pictures, if the network has one input of pictures; several have their names in the file.
        others: vectors, with their names in the file.

    Output ports:
        y: the output (n). Several outputs have their names in the file.

    Args:
        network: the network.
        rate: evaluations per second [Hz]; by default that of the network, or :data:`DEFAULT_RATE`.
        latency: time from the inputs to the output [s].
        initial: output before the first result (n), of the first output; zero by default.

    Attributes:
        rate: evaluations per second [Hz].
        sha256: hash of the file.

    Raises:
        ConfigError: `initial` has another size than the output.
    """

    def __init__(
        self,
        network: OnnxNetwork,
        *,
        rate: float | None = None,
        latency: float = 0.0,
        initial: list[float] | None = None,
    ) -> None:
        super().__init__()
        self._network, self.sha256, self._latency = network, network.sha256, latency
        self.rate = rate or network.rate or DEFAULT_RATE

        # Inputs.
        pictures = [entry for entry in network.inputs if entry.pictures is not None]
        self._inputs: dict[str, InputPort] = {}
        for entry in network.inputs:
            if entry.pictures is None:
                contents = signals(*((f"{entry.name}{index}", "") for index in range(entry.size)))
                self._inputs[entry.name] = declare_vector_input(self, entry.name, contents)
            else:
                name = "image" if len(pictures) == 1 else entry.name
                model = AbstractValue.Make(_empty_image(entry))
                self._inputs[entry.name] = self.DeclareAbstractInputPort(name, model)

        # Outputs: one vector of the state holds all of them, a queue those whose latency has not passed.
        sizes = [len(contents) for contents in network.outputs.values()]
        first = np.zeros(sizes[0]) if initial is None else np.asarray(initial)
        if first.size != sizes[0]:
            raise ConfigError(f"initial has {first.size} elements, the output of {network.file} has {sizes[0]}")
        values = [first, *(np.zeros(size) for size in sizes[1:])]
        self._held = [self.DeclareDiscreteState(value) for value in values]
        for (name, contents), state in zip(network.outputs.items(), self._held, strict=True):
            declare_state_output(self, "y" if len(sizes) == 1 else name, contents, state)
        self._sizes = sizes
        self.DeclarePeriodicDiscreteUpdateEvent(1.0 / self.rate, 0.0, self._evaluate)
        # The queue has a row for each result on its way, one more for a result that is written while another is read,
        # and -inf in rows that have no result yet.
        if latency > 0.0:
            self._slots = floor(latency * self.rate + 1e-6) + 2
            self._queue = self.DeclareDiscreteState(np.full(self._slots * (1 + sum(sizes)), -inf))
            self.DeclarePeriodicDiscreteUpdateEvent(1.0 / self.rate, latency, self._show)

    def _evaluate(self, context: Context, state: DiscreteValues) -> None:
        """Evaluate the network; its result is output immediately, or waits in the queue."""
        values = {}
        for entry in self._network.inputs:
            value = self._inputs[entry.name].Eval(context)
            if entry.pictures is not None:
                value = _pixels(entry, value)
                # Without a picture the output stays as it is; the event comes again a period later.
                if value is None:
                    return
            values[entry.name] = value
        result = np.concatenate(list(self._network(values).values()))
        # Rounding the time to a number of the evaluation identifies its row without an equality of floats.
        if not self._latency:
            self._put(state, result)
            return
        number = round(context.get_time() * self.rate)
        row = state.get_mutable_vector(self._queue).get_mutable_value()[self._row(number)]
        row[0], row[1:] = number, result

    def _show(self, context: Context, state: DiscreteValues) -> None:
        """Output the result whose latency has passed."""
        number = round((context.get_time() - self._latency) * self.rate)
        row = context.get_discrete_state(self._queue).get_value()[self._row(number)]
        # An evaluation without a picture has written no result: the row then has an older number.
        if row[0] == number:
            self._put(state, row[1:])

    def _row(self, number: int) -> slice:
        width = 1 + sum(self._sizes)
        # A ring: rows of the numbers are reused after their latency has passed.
        begin = number % self._slots * width
        return slice(begin, begin + width)

    def _put(self, state: DiscreteValues, result: Any) -> None:
        begin = 0
        for index, size in zip(self._held, self._sizes, strict=True):
            state.get_mutable_vector(index).SetFromVector(result[begin : begin + size])
            begin += size


def _empty_image(entry: NetworkInput) -> Any:
    """Return an image of the size that an input takes; of size 0 if it takes any."""
    kind = ImageRgba8U if entry.pictures == "colour" else ImageDepth32F
    if entry.width is None or entry.height is None:
        return kind()
    return kind(entry.width, entry.height)


def _pixels(entry: NetworkInput, image: Any) -> Any:
    """Return the pixels of a picture (height, width, channels); None if no picture has been taken."""
    if entry.pictures == "depth":
        return image.data
    # Rendered pictures are opaque; alpha 0 marks the image that a camera has before its first picture.
    return image.data[:, :, :3] if image.data[0, 0, 3] else None
