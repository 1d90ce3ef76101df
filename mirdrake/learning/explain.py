"""What a network looks at: the effect of each pixel on the steering, where it differs most from the expert.

The saliency of a pixel is the derivative of the output by its colours (K. Simonyan, A. Vedaldi, A. Zisserman, "Deep
inside convolutional networks", arXiv 1312.6034, 2013), averaged over pictures with noise (D. Smilkov et al.,
"SmoothGrad: removing noise by adding noise", arXiv 1706.03825, 2017).
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mirdrake.core.files import replacing
from mirdrake.learning.drives import PILOT, Car
from mirdrake.learning.pilotnet import Architecture, import_torch, make_pilotnet
from mirdrake.learning.preparation import CropSpec, Preparation
from mirdrake.learning.selection import value_at
from mirdrake.learning.training import one_thread
from mirdrake.runs.logs import Run

SHOWN = 6
"""Pictures with the largest differences."""

APART = 20.0
"""Least distance along the track between two of them [m]."""

NOISY, NOISE = 16, 0.05
"""Number of pictures with noise, and its standard deviation, full scale 1."""

LARGEST = 99.5
"""Percentile of the saliency that counts as 1."""

FILE = "explanation.npz"


def find_saliency(module: Any, pictures: NDArray[Any]) -> NDArray[np.float64]:
    """Return the effect of each pixel on the first output (n, height, width), from 0 to 1 in each picture.

    Args:
        module: PyTorch module of :func:`~mirdrake.learning.pilotnet.make_pilotnet`, without further inputs or with
            inputs at their means.
        pictures: prepared pictures (n, height, width, 3), 0 to 255.
    """
    torch = import_torch()
    random, plain = np.random.default_rng(0), np.asarray(pictures, dtype=np.float32)
    total = np.zeros(plain.shape[:3])
    inputs = torch.zeros(len(plain), getattr(module, "inputs", 0))
    with one_thread():
        for _ in range(NOISY):
            # SmoothGrad: single gradients are noisy, their mean over disturbed pictures shows the structure.
            noisy = plain + 255.0 * NOISE * random.standard_normal(plain.shape, dtype=np.float32)
            # Gradients by the scaled picture; inputs at zero are those at their means.
            value = (torch.from_numpy(noisy).permute(0, 3, 1, 2) / 127.5 - 1.0).requires_grad_(True)
            module(value, inputs)[:, 0].sum().backward()
            total += value.grad.abs().sum(dim=1).numpy()
    # A percentile, so that a single pixel does not darken the rest of the picture.
    largest = np.percentile(total, LARGEST, axis=(1, 2), keepdims=True)
    scaled: NDArray[np.float64] = np.clip(total / np.maximum(largest, 1e-12), 0.0, 1.0)
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
    # Difference between network and expert for every picture, at the time at which the command acts.
    found: list[tuple[float, float, float, float, Any]] = []
    # The command of a picture acts after a delay, so that commands are compared at that later time.
    for run in runs:
        pictures = run.pictures.get(car.image, [])
        times = np.array([picture.time for picture in pictures])
        given = value_at(run.signals, f"{PILOT}.y", times + lead)
        wanted = value_at(run.signals, car.command, times + lead)
        places = value_at(run.signals, f"{car.vehicle}.progress", times, held=True)
        found += zip(np.abs(given - wanted), places, given, wanted, pictures, strict=True)
    # Neighbouring pictures are nearly equal, so the largest differences must lie apart along the track.
    chosen: list[tuple[float, float, float, float, Any]] = []
    for entry in sorted(found, key=lambda entry: -entry[0]):
        if len(chosen) < SHOWN and all(abs(entry[1] - other[1]) >= APART for other in chosen):
            chosen.append(entry)
    if not chosen:
        return 0
    # The same crop and size as in training.
    pixels = [entry[4].pixels for entry in chosen]
    preparation = Preparation(pixels[0].shape[1], pixels[0].shape[0], crop, size)
    prepared = np.stack([preparation(picture) for picture in pixels])
    # The number of further inputs is that by which the first dense layer is wider than the features.
    state = torch.load(folder / "training.pt", weights_only=True)["module"]
    inputs = state["dense.0.weight"].shape[1] - Architecture(*preparation.shape).features()
    module = make_pilotnet(Architecture(*preparation.shape, inputs))
    module.load_state_dict(state)
    arrays: dict[str, Any] = {
        "pictures": np.stack(pixels),
        "prepared": prepared,
        "cropped": np.array(preparation.cropped),
        "saliency": find_saliency(module, prepared),
        "place": np.array([entry[1] for entry in chosen]),
        "network": np.array([entry[2] for entry in chosen]),
        "expert": np.array([entry[3] for entry in chosen]),
    }
    with replacing(folder / FILE) as temporary, temporary.open("wb") as stream:
        np.savez_compressed(stream, **arrays)
    return len(chosen)
