"""What the training logs of a lateral model cover, so that advice names only what they lack."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mirdrake.identification.excitation import bandwidth
from mirdrake.identification.models.base import Array, Segment

VARIED = 0.3
"""Range of the speed of turns over its mean that counts as several speeds [1]."""

ONE_SIDED = 0.3
"""Share of the largest lateral acceleration that a turn to the other side must reach [1]."""

FLAT = 0.8
"""Bandwidth of the steering over the frequency that a sweep reaches, if its rate has a flat spectrum [1]."""

LONG = 30.0
"""Duration of turns that is long enough for offsets and positions of sensors [s]."""


@dataclass(frozen=True)
class Coverage:
    """Ranges that logs cover.

    Attributes:
        speeds: whether turns were driven at several speeds.
        sides: whether there are turns to both sides.
        bandwidth: frequency below which 80 % of the power of the steering rate lie [Hz].
        turning: duration of the turns [s].
    """

    speeds: bool = False
    sides: bool = False
    bandwidth: float = 0.0
    turning: float = 0.0

    def sweep_to(self, frequency: float) -> bool:
        """Return whether the steering was as fast as a sweep to a frequency [Hz]."""
        return self.bandwidth >= FLAT * frequency


def make_coverage(drives: Sequence[Segment], steering: str, speed: str) -> Coverage:
    """Return what segments cover.

    Args:
        drives: training segments.
        steering: channel of the steering.
        speed: channel of the speed.
    """
    drives = [drive for drive in drives if drive.part == "train" and drive.size > 2]
    if not drives:
        return Coverage()
    velocity = np.concatenate([drive.inputs[speed] for drive in drives])
    lateral = velocity * np.concatenate([_turning_rate(drive, steering, speed) for drive in drives])
    lateral = np.nan_to_num(lateral)
    # Percentiles, as a single shock is not a turn.
    right, left = np.percentile(lateral, (1.0, 99.0))
    largest = max(-float(right), float(left), 1e-9)
    turns = np.abs(lateral) > ONE_SIDED * largest
    low, high = np.percentile(velocity[turns], (5.0, 95.0)) if turns.any() else (0.0, 0.0)
    mean = float(np.mean(velocity[turns])) if turns.any() else 0.0
    steps = np.concatenate([np.full(drive.size, drive.step) for drive in drives])
    return Coverage(
        speeds=bool(high - low > VARIED * abs(mean) > 0.0),
        sides=bool(min(-right, left) > ONE_SIDED * largest),
        bandwidth=max(bandwidth(drive.inputs[steering], drive.step) for drive in drives),
        turning=float(np.sum(steps[turns])),
    )


def _turning_rate(drive: Segment, steering: str, speed: str) -> Array:
    """Return the yaw rate, or what is proportional to it in slow turns."""
    return np.asarray(drive.outputs.get("yaw_rate", drive.inputs[speed] * drive.inputs[steering]))
