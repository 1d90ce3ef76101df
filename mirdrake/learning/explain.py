"""What a network looks at: VisualBackProp, and the pictures at which it differs most from the expert.

Source: M. Bojarski et al., "VisualBackProp: efficient visualization of CNNs", arXiv 1611.05418, 2016. The mean over the
channels of each layer's activation is scaled up and multiplied with that of the layer before, from the last convolution
back to the picture.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mirdrake.core.files import replacing
from mirdrake.learning.drives import PILOT, Car
from mirdrake.learning.pilotnet import CONVOLUTIONS, Architecture, import_torch, make_pilotnet
from mirdrake.learning.preparation import CropSpec, Preparation
from mirdrake.learning.selection import value_at
from mirdrake.learning.training import one_thread
from mirdrake.runs.logs import Run

SHOWN = 6
"""Pictures with the largest differences."""

APART = 20.0
"""Least distance along the track between two of them [m]."""

FILE = "explanation.npz"


def visual_back_prop(module: Any, pictures: NDArray[Any]) -> NDArray[np.float64]:
    """Return the regions that the convolutions of a PilotNet respond to (n, height, width), from 0 to 1.

    Args:
        module: PyTorch module of :func:`~mirdrake.learning.pilotnet.make_pilotnet`.
        pictures: prepared pictures (n, height, width, 3), 0 to 255.
    """
    torch = import_torch()
    functional = torch.nn.functional
    with torch.no_grad(), one_thread():
        value = torch.from_numpy(np.asarray(pictures, dtype=np.float32)).permute(0, 3, 1, 2) / 127.5 - 1.0
        sizes, means = [value.shape[2:]], []
        for layer in module.convolutions[: 2 * len(CONVOLUTIONS)]:
            value = layer(value)
            if isinstance(layer, torch.nn.ReLU):
                means.append(value.mean(dim=1, keepdim=True))
                sizes.append(value.shape[2:])
        mask = means[-1]
        for index in range(len(CONVOLUTIONS) - 1, -1, -1):
            _, kernel, stride = CONVOLUTIONS[index]
            height, width = sizes[index]
            spare = [(height - kernel) % stride, (width - kernel) % stride]
            mask = functional.conv_transpose2d(
                mask, torch.ones(1, 1, kernel, kernel), stride=stride, output_padding=spare
            )
            mask = mask * means[index - 1] if index else mask
        result = mask[:, 0].numpy().astype(np.float64)
    least, most = result.min(axis=(1, 2), keepdims=True), result.max(axis=(1, 2), keepdims=True)
    scaled: NDArray[np.float64] = (result - least) / np.maximum(most - least, 1e-12)
    return scaled


def write_pictures(
    runs: Sequence[Run], car: Car, folder: Path, *, lead: float, crop: CropSpec, size: tuple[int, int] | None
) -> int:
    """Write the pictures of a drive at which network and expert differ most, with what the network looks at.

    Args:
        runs: segments of the drive.
        car: see :class:`~mirdrake.learning.drives.Car`.
        folder: with the state of the training; explanation.npz is written there.
        lead: time after the exposure at which the command acts [s].
        crop: of the preparation.
        size: of the preparation.

    Returns:
        number of pictures.
    """
    torch = import_torch()
    found: list[tuple[float, float, float, float, Any]] = []
    for run in runs:
        pictures = run.pictures.get(car.image, [])
        times = np.array([picture.time for picture in pictures])
        given = value_at(run.signals, f"{PILOT}.y", times + lead)
        wanted = value_at(run.signals, car.command, times + lead)
        places = value_at(run.signals, f"{car.vehicle}.progress", times, held=True)
        found += zip(np.abs(given - wanted), places, given, wanted, pictures, strict=True)
    chosen: list[tuple[float, float, float, float, Any]] = []
    for entry in sorted(found, key=lambda entry: -entry[0]):
        if len(chosen) < SHOWN and all(abs(entry[1] - other[1]) >= APART for other in chosen):
            chosen.append(entry)
    if not chosen:
        return 0
    pixels = [entry[4].pixels for entry in chosen]
    preparation = Preparation(pixels[0].shape[1], pixels[0].shape[0], crop, size)
    prepared = np.stack([preparation(picture) for picture in pixels])
    state = torch.load(folder / "training.pt", weights_only=True)["module"]
    inputs = state["dense.0.weight"].shape[1] - Architecture(*preparation.shape).features()
    module = make_pilotnet(Architecture(*preparation.shape, inputs))
    module.load_state_dict(state)
    arrays = {
        "pictures": np.stack(pixels),
        "prepared": prepared,
        "saliency": visual_back_prop(module, prepared),
        "place": np.array([entry[1] for entry in chosen]),
        "network": np.array([entry[2] for entry in chosen]),
        "expert": np.array([entry[3] for entry in chosen]),
    }
    with replacing(folder / FILE) as temporary, temporary.open("wb") as stream:
        np.savez_compressed(stream, **arrays)
    return len(chosen)
