"""From logs to the drives that models are fitted to: even steps, no gaps in the inputs."""

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from mirdrake.core.errors import ConfigError
from mirdrake.identification.data import Array, Log
from mirdrake.identification.models.base import Model, Segment
from mirdrake.identification.timing import median_step

LONGEST_GAP = 0.25
"""Inputs are bridged by straight lines over this [s]; a longer gap ends a drive."""

FINEST = 0.004
"""Faster logs are averaged to steps of no less than this [s]."""

MOST = 400_000
"""Samples of a data set; more are averaged, too."""

HISTORY = 2.0
"""Inputs that a piece of a drive gets from before its beginning, for delays and lags [s]."""

LEAST = 20
"""Fewer samples are no drive."""


def make_segments(model: Model, logs: tuple[Log, ...], piece: float | None = None) -> tuple[list[Segment], list[str]]:
    """Drives of logs, and notes of what was done.

    Args:
        model: says which channels are wanted.
        logs: recorded drives.
        piece: length of the pieces that logs are cut into [s]; None: as long as they are.

    Raises:
        ConfigError: a log has a channel without values, or none that moves.
    """
    found, notes, faults = [], [], []
    total = sum(len(log.time) for log in logs)
    for log in logs:
        try:
            drives, told = _of_log(model, log, total)
        except ConfigError as error:
            faults.append(str(error))
            continue
        for drive in drives:
            found += _pieces(drive, piece)
        notes += told
    if faults:
        raise ConfigError("\n".join(faults))
    return found, notes


def _of_log(model: Model, log: Log, total: int) -> tuple[list[Segment], list[str]]:
    notes = []
    for name in (*model.inputs, *model.outputs):
        values = log.channels.get(name)
        if values is None:
            raise ConfigError(
                f"log {log.name}: has no channel '{name}', which model {model.kind} needs; map its column"
            )
        good = np.isfinite(values)
        if good.mean() < 0.2:
            raise ConfigError(
                f"log {log.name}: {name} has values in {100.0 * good.mean():.0f} % of the rows only; leave the log out"
            )
        if name in model.outputs and np.ptp(values[good]) == 0.0:
            raise ConfigError(
                f"log {log.name}: {name} is {values[good][0]:.4g} all the time; it says nothing, leave the log out"
            )
    time = log.time
    keep = np.append(True, np.diff(time) > 0.0)
    time, channels = time[keep], {name: values[keep] for name, values in log.channels.items()}
    step = median_step(time)
    even = np.arange(time[0], time[-1] + 0.5 * step, step)
    if len(even) > 20 * len(time):
        raise ConfigError(f"log {log.name}: its times have gaps that are longer than what is between them; cut it up")
    inputs: dict[str, Array] = {}
    whole: NDArray[np.bool_] = np.ones(len(even), dtype=bool)
    for name in model.inputs:
        inputs[name], near = _resampled(time, channels[name], even, LONGEST_GAP)
        whole &= near
    outputs = {}
    for name in model.outputs:
        values, near = _resampled(time, channels[name], even, 1.5 * step)
        outputs[name] = np.where(near, values, np.nan)
    many = max(int(np.floor(FINEST / step + 1e-6)), int(np.ceil(total / MOST)), 1)
    if many > 1:
        rows = len(even) // many * many
        even = even[:rows].reshape(-1, many).mean(axis=1)
        inputs = {name: values[:rows].reshape(-1, many).mean(axis=1) for name, values in inputs.items()}
        outputs = {name: values[:rows].reshape(-1, many).mean(axis=1) for name, values in outputs.items()}
        whole = np.asarray(whole[:rows].reshape(-1, many).all(axis=1))
        step *= many
        notes.append(f"log {log.name}: means of {many} samples, {1.0 / step:.4g} Hz")
    drives = []
    edges = np.flatnonzero(np.diff(np.concatenate(([0], whole.astype(int), [0]))))
    for first, last in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        if last - first < LEAST:
            continue
        rows_ = slice(first, last)
        drives.append(
            Segment(
                log.name, log.use, float(even[first]), step,
                {name: values[rows_] for name, values in inputs.items()},
                {name: values[rows_] for name, values in outputs.items()},
            )
        )  # fmt: skip
    if not drives:
        raise ConfigError(f"log {log.name}: no {LEAST} samples in a row have all of {', '.join(model.inputs)}")
    if len(drives) > 1:
        notes.append(f"log {log.name}: {len(drives)} drives, with gaps of more than {LONGEST_GAP:g} s between them")
    return drives, notes


def _resampled(time: Array, values: Array, even: Array, gap: float) -> tuple[Array, NDArray[np.bool_]]:
    """Values at even times, and where samples on both sides are near enough."""
    good = np.isfinite(values)
    known = time[good]
    found = np.interp(even, known, values[good])
    after = np.clip(np.searchsorted(known, even - 1e-9), 0, len(known) - 1)
    before = np.clip(np.searchsorted(known, even + 1e-9) - 1, 0, len(known) - 1)
    near = (known[after] - known[before] <= gap) & (even >= known[0] - gap) & (even <= known[-1] + gap)
    return found, near


def _pieces(drive: Segment, length: float | None) -> list[Segment]:
    if length is None:
        return [drive]
    rows = max(round(length / drive.step), LEAST)
    count, history = max(drive.size // rows, 1), round(HISTORY / drive.step)
    edges = [k * rows for k in range(count)] + [drive.size]
    return [
        Segment(
            drive.log, drive.part, drive.start + drive.step * first, drive.step,
            # An input goes on to the first sample of the next piece.
            {name: values[first:last] for name, values in drive.inputs.items()},
            {name: values[first:last] for name, values in drive.outputs.items()},
            {name: values[max(first - history, 0) : first] for name, values in drive.inputs.items()},
        )
        for first, last in pairwise(edges)
    ]  # fmt: skip
