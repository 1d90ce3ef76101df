"""Training of a network by regression on the expert's commands, resumable and repeatable on one machine.

The loss is Huber's (P. J. Huber, "Robust estimation of a location parameter", Ann. Math. Statist. 35(1), 1964), so that
a few large labels of recoveries do not dominate. Each epoch has its own seed, and the state of the training is written
after each, so that a training that was killed continues with the same weights as one that was not.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from math import cos, pi
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mirdrake.core.digest import digest_data
from mirdrake.core.files import replacing
from mirdrake.learning.data import DrivingData
from mirdrake.learning.pilotnet import Architecture, import_torch, make_pilotnet
from mirdrake.learning.spec import TrainSpec

Array = NDArray[np.float64]

Report = Callable[[int, int, str], None]
"""Called with the numbers of trained and all pictures, and a remark."""


@dataclass(frozen=True)
class Scaling:
    """Mean and standard deviation of the further inputs and of the labels in the training data.

    Attributes:
        input_mean: (inputs).
        input_scale: (inputs); 1 for an input that does not vary.
        label_scale: (labels). Labels are not shifted, so that a mirrored picture has the opposite label.
    """

    input_mean: tuple[float, ...]
    input_scale: tuple[float, ...]
    label_scale: tuple[float, ...]


@dataclass
class Trained:
    """A trained network.

    Attributes:
        module: PyTorch module.
        architecture: its architecture.
        scaling: of inputs and labels.
        training_loss: Huber's loss of each epoch, in units of the scaled labels.
        validation_error: root of the mean squared error of the first label on the validation data, of each epoch.
        pictures: number of pictures for training.
    """

    module: Any
    architecture: Architecture
    scaling: Scaling
    training_loss: list[float]
    validation_error: list[float]
    pictures: int

    def predict(self, data: DrivingData) -> Array:
        """Return the outputs for all pictures of a data set (n, labels)."""
        torch = import_torch()
        parts = []
        with torch.no_grad(), one_thread():
            for pictures, inputs, _, _ in data.batches(64):
                parts.append(self.evaluate(pictures, inputs))
        return np.concatenate(parts) if parts else np.zeros((0, self.architecture.outputs))

    def evaluate(self, pictures: NDArray[Any], inputs: NDArray[Any]) -> Array:
        """Return the outputs (n, labels) for pictures (n, height, width, 3), 0 to 255, and inputs (n, inputs)."""
        torch = import_torch()
        with torch.no_grad(), one_thread():
            result = self.module(*_tensors(torch, pictures, inputs, self.scaling)).numpy().astype(np.float64)
        scaled: Array = result * np.asarray(self.scaling.label_scale)
        return scaled


@contextmanager
def one_thread() -> Iterator[None]:
    """Run PyTorch in one thread, with deterministic algorithms, within the block."""
    torch = import_torch()
    threads, deterministic = torch.get_num_threads(), torch.are_deterministic_algorithms_enabled()
    torch.set_num_threads(1)
    torch.use_deterministic_algorithms(True)
    try:
        yield
    finally:
        torch.set_num_threads(threads)
        torch.use_deterministic_algorithms(deterministic)


def train(
    data: DrivingData,
    validation: DrivingData,
    spec: TrainSpec,
    *,
    seed: int,
    file: Path | None = None,
    report: Report | None = None,
) -> Trained:
    """Train a PilotNet.

    Args:
        data: pairs to learn.
        validation: pairs at other places, for the error that is reported.
        spec: epochs, learning rate, changes of the pictures.
        seed: of the initial weights, of the order and the changes of the pictures.
        file: for the state of the training after each epoch; if it has one of this training, that is continued.
        report: shows the progress.

    Raises:
        ConfigError: the pictures are too small.
        MissingDependencyError: PyTorch is not installed.
    """
    torch = import_torch()
    architecture = Architecture(*data.preparation.shape, len(data.inputs), len(data.labels))
    scaling = _scaling(data)
    # Identifies the training, so that the state of another one is not continued; the scaling represents the data.
    key = digest_data([spec.model_dump(mode="json"), seed, repr(scaling), len(data), len(validation)])
    # The caller's random state stays as it was; the weights depend on the seed only.
    with one_thread(), torch.random.fork_rng():
        torch.manual_seed(seed)
        module = make_pilotnet(architecture)
        optimizer = torch.optim.Adam(module.parameters(), lr=spec.learning_rate)
        result = Trained(module, architecture, scaling, [], [], len(data))
        _resume(torch, file, key, result, optimizer)
        for epoch in range(len(result.training_loss), spec.epochs):
            # The learning rates follow a schedule over epochs.
            rates = _learning_rates(spec, epoch, len(data))
            result.training_loss.append(_epoch(torch, result, optimizer, data, spec, (seed, epoch), rates, report))
            error = result.predict(validation)[:, 0] - validation.values[:, 0]
            result.validation_error.append(float(np.sqrt(np.mean(error**2))))
            # After each epoch: an interrupted training continues from here with the same random numbers.
            if file is not None:
                state = {
                    "key": key, "module": module.state_dict(), "optimizer": optimizer.state_dict(),
                    "loss": result.training_loss, "error": result.validation_error,
                }  # fmt: skip
                with replacing(file) as temporary:
                    torch.save(state, temporary)
    module.eval()
    return result


def _epoch(
    torch: Any,
    result: Trained,
    optimizer: Any,
    data: DrivingData,
    spec: TrainSpec,
    seed: tuple[int, int],
    rates: Iterator[float],
    report: Report | None,
) -> float:
    """Train one epoch, and return the mean loss."""
    total, done = 0.0, 0
    scale = torch.tensor(result.scaling.label_scale, dtype=torch.float32)
    # Labels are scaled, so the width of the loss is scaled alike.
    width = spec.huber / float(scale[0])
    batches = data.batches(spec.batch, seed=seed, mirror=spec.mirror, brightness=spec.brightness, noise=spec.noise)
    for (pictures, inputs, labels, weights), rate in zip(batches, rates, strict=False):
        # Set by hand instead of a scheduler: the rate is a function of the step, also after a resumption.
        for group in optimizer.param_groups:
            group["lr"] = rate
        output = result.module(*_tensors(torch, pictures, inputs, result.scaling))
        target = torch.from_numpy(labels) / scale
        loss = torch.nn.functional.huber_loss(output, target, reduction="none", delta=width).mean(dim=1)
        # Weighted after the loss, so that rare labels count more without being repeated.
        if spec.balance:
            loss = loss * torch.from_numpy(weights)
        mean = loss.mean()
        optimizer.zero_grad()
        mean.backward()
        optimizer.step()
        total, done = total + float(loss.detach().sum()), done + len(labels)
        if report is not None:
            before = seed[1] * len(data)
            report(before + done, spec.epochs * len(data), f"loss {total / done:.4f}")
    return total / max(done, 1)


def _learning_rates(spec: TrainSpec, epoch: int, count: int) -> Iterator[float]:
    """Yield the learning rate of each step of an epoch: a short increase, then half a cosine down to zero."""
    steps = -(-count // spec.batch)
    every, warm = steps * spec.epochs, max(1, min(steps, 100))
    for step in range(epoch * steps, (epoch + 1) * steps):
        yield spec.learning_rate * min(1.0, (step + 1) / warm) * 0.5 * (1.0 + cos(pi * step / every))


def _tensors(torch: Any, pictures: NDArray[Any], inputs: NDArray[Any], scaling: Scaling) -> tuple[Any, Any]:
    """Return scaled pictures, in memory as they are (channels last), and scaled inputs."""
    # A view, not a copy: channels stay last in memory, the layout of the module.
    images = torch.from_numpy(np.asarray(pictures, dtype=np.float32)).permute(0, 3, 1, 2)
    images = images / 127.5 - 1.0
    shifted = np.asarray(inputs, dtype=np.float32) - np.asarray(scaling.input_mean, dtype=np.float32)
    return images, torch.from_numpy(shifted / np.asarray(scaling.input_scale, dtype=np.float32))


def _scaling(data: DrivingData) -> Scaling:
    inputs = data.table[list(data.inputs)].to_numpy(dtype=float)
    deviations = inputs.std(axis=0)
    # Root mean square about zero, not about the mean: see Scaling.
    labels = np.sqrt(np.mean(data.values**2, axis=0))
    return Scaling(
        tuple(inputs.mean(axis=0).tolist()),
        tuple(np.where(deviations > 1e-3, deviations, 1.0).tolist()),
        tuple(np.where(labels > 1e-9, labels, 1.0).tolist()),
    )


def _resume(torch: Any, file: Path | None, key: str, result: Trained, optimizer: Any) -> None:
    """Read the state of an unfinished training; that of another one is ignored."""
    if file is None or not file.is_file():
        return
    try:
        state = torch.load(file, weights_only=True)
    except Exception:  # damaged: train from the start
        return
    if state.get("key") != key:
        return
    result.module.load_state_dict(state["module"])
    optimizer.load_state_dict(state["optimizer"])
    result.training_loss += state["loss"]
    result.validation_error += state["error"]
