"""Segments of logs for the estimators: constant step, inputs without gaps."""

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from mirdrake.core.errors import ConfigError
from mirdrake.identification.channels import channel
from mirdrake.identification.data import Array, Log
from mirdrake.identification.input_noise import estimate_noise, without_noise
from mirdrake.identification.models.base import Model, Segment
from mirdrake.identification.timing import median_step
from mirdrake.readers.units import format_unit

MAX_GAP = 0.25
"""Gaps of the inputs up to this length are interpolated [s]; a longer one ends a segment."""

NOTABLE = 0.01
"""Noise of an input over its standard deviation above which it is reported [1]."""

MAX_SAMPLES = 400_000
"""Largest number of samples of a data set; larger ones are averaged as well."""

HISTORY = 2.0
"""Duration of the inputs kept before the beginning of a piece, for delays and lags [s]."""

SETTLED = 3.0
"""Time constants after which a lag has forgotten its initial state [1]: 5 % are left."""

MIN_SLOPE, MOVES = 4, 0.02
"""Least number of samples for the slope at the beginning of an input; change within dead time and lag, over its range,
from which it moves there [1]."""

MIN_SAMPLES = 20
"""Least number of samples of a segment."""


def make_segments(model: Model, logs: tuple[Log, ...], piece: float | None = None) -> tuple[list[Segment], list[str]]:
    """Return the segments of logs, and notes about the resampling.

    Args:
        model: model whose channels are needed.
        logs: recorded logs.
        piece: length of the pieces that segments are cut into [s]; None for whole segments.

    Raises:
        ConfigError: a log lacks a channel or its values, or a channel is constant.
    """
    pieces, notes, faults = [], [], []
    # The total length decides how finely all logs are resampled.
    total = sum(len(log.time) for log in logs)
    for log in logs:
        try:
            segments, more = _log_segments(model, log, total)
        except ConfigError as error:
            # Faults of all logs at once.
            faults.append(error)
            continue
        for segment in segments:
            pieces += _pieces(segment, piece)
        notes += more
    if faults:
        raise ConfigError(faults=faults)
    return pieces, notes


def after_unknown_inputs(model: Model, drives: Sequence[Segment], p: Mapping[str, float]) -> list[Segment]:
    """Return segments without their beginnings that depend on inputs before the log.

    A dead time d and a lag τ relate the first samples to inputs that are not recorded. Before its first sample an input
    is taken as held, which is right for a log that begins with a command at rest. If the command moves there, the
    response is unknown until d + 3 τ, when 5 % of the difference are left; these samples are used as history only.

    Args:
        model: model with dead times and lags.
        drives: segments.
        p: parameters.
    """
    shorter = []
    for drive in drives:
        rows, most = 0, drive.size // 5  # at least four fifths of a segment are kept, however slow the response is
        for name, (delay, lag) in model.input_memory(p).items():
            if drive.before.get(name, np.empty(0)).size:
                continue
            values = drive.inputs[name]
            early = min(max(round((max(delay, 0.0) + lag) / drive.step), MIN_SLOPE), most)
            slope = float(np.polyfit(np.arange(early), values[:early], 1)[0])
            if abs(slope) * early > MOVES * float(np.ptp(np.percentile(values, (5.0, 95.0)))):
                rows = max(rows, round((max(delay, 0.0) + SETTLED * lag) / drive.step))
        shorter.append(_without_beginning(drive, min(rows, most)))
    return shorter


def _without_beginning(drive: Segment, rows: int) -> Segment:
    """Return a segment whose first samples are history."""
    if rows == 0:
        return drive
    return Segment(
        drive.log, drive.part, drive.start + drive.step * rows, drive.step,
        {name: values[rows:] for name, values in drive.inputs.items()},
        {name: values[rows:] for name, values in drive.outputs.items()},
        {name: values[:rows] for name, values in drive.inputs.items()},
    )  # fmt: skip


def _check_channels(model: Model, log: Log) -> None:
    """Reject a log that lacks a channel of the model or its values."""
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
        # An output that never changes contains no information, and has no noise that could be estimated.
        if name in model.outputs and np.ptp(values[good]) == 0.0:
            raise ConfigError(f"log {log.name}: {name} is constant at {values[good][0]:.4g}; leave the log out")


def _log_segments(model: Model, log: Log, total: int) -> tuple[list[Segment], list[str]]:
    """Resample a log to its median step and cut it where the inputs have gaps."""
    _check_channels(model, log)
    notes, time = [], log.time
    # Repeated times would be ambiguous for the interpolation.
    keep = np.append(True, np.diff(time) > 0.0)
    time, channels = time[keep], {name: values[keep] for name, values in log.channels.items()}
    step = median_step(time)
    # The estimators integrate with a constant step.
    even = np.arange(time[0], time[-1] + 0.5 * step, step)
    if len(even) > 20 * len(time):
        raise ConfigError(f"log {log.name}: its gaps are longer than the recorded stretches; split it at the gaps")

    # Inputs are interpolated over short gaps; outputs without a value stay missing.
    inputs: dict[str, Array] = {}
    whole: NDArray[np.bool_] = np.ones(len(even), dtype=bool)
    for name in model.inputs:
        inputs[name], near = _resampled(time, channels[name], even, MAX_GAP)
        whole &= near
    outputs = {}
    for name in model.outputs:
        values, near = _resampled(time, channels[name], even, 1.5 * step)
        outputs[name] = np.where(near, values, np.nan)

    # More samples than the estimators need are averaged. The mean is the same filter for inputs and outputs, so that
    # the model still holds between them, and it attenuates noise above the new Nyquist frequency.
    many = max(int(np.floor(model.sample_time / step + 1e-6)), int(np.ceil(total / MAX_SAMPLES)), 1)
    if many > 1:
        rows = len(even) // many * many
        even = even[:rows].reshape(-1, many).mean(axis=1)
        inputs = {name: values[:rows].reshape(-1, many).mean(axis=1) for name, values in inputs.items()}
        outputs = {name: values[:rows].reshape(-1, many).mean(axis=1) for name, values in outputs.items()}
        whole = np.asarray(whole[:rows].reshape(-1, many).all(axis=1))
        step *= many
        notes.append(f"log {log.name}: averaged over {many} samples to {1.0 / step:.4g} Hz")

    # Segments are the stretches in which all inputs have values.
    drives = []
    # Padded by zeros, so that every stretch has a begin and an end, also at the ends of the log.
    edges = np.flatnonzero(np.diff(np.concatenate(([0], whole.astype(int), [0]))))
    for first, last in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        if last - first < MIN_SAMPLES:
            continue
        rows_ = slice(first, last)
        # A fit takes its inputs as exact, so their noise is removed from them.
        clean = {name: values[rows_] for name, values in inputs.items()}
        clean |= {
            name: without_noise(values, estimate_noise(values))
            for name, values in clean.items()
            if name not in model.exact_inputs
        }
        for name, values in clean.items():
            removed = float(np.std(values - inputs[name][rows_]))
            if removed > NOTABLE * float(np.std(values)):
                size = f"{removed:.2g} {format_unit(channel(name).unit)}"
                notes.append(f"log {log.name}: noise of {name} removed ({size})")
        drives.append(
            Segment(
                log.name, log.use, float(even[first]), step, clean,
                {name: values[rows_] for name, values in outputs.items()},
            )
        )  # fmt: skip
    if not drives:
        raise ConfigError(f"log {log.name}: no {MIN_SAMPLES} samples in a row have all of {', '.join(model.inputs)}")
    if len(drives) > 1:
        notes.append(f"log {log.name}: {len(drives)} segments, separated by gaps of more than {MAX_GAP:g} s")
    return drives, notes


def _resampled(time: Array, values: Array, even: Array, gap: float) -> tuple[Array, NDArray[np.bool_]]:
    """Return values at even times, and where the samples on both sides are near enough."""
    good = np.isfinite(values)
    known = time[good]
    interpolated = np.interp(even, known, values[good])
    # The tolerance lets a sample at the very time count as its own neighbour on both sides.
    after = np.clip(np.searchsorted(known, even - 1e-9), 0, len(known) - 1)
    before = np.clip(np.searchsorted(known, even + 1e-9) - 1, 0, len(known) - 1)
    near = (known[after] - known[before] <= gap) & (even >= known[0] - gap) & (even <= known[-1] + gap)
    return interpolated, near


def _pieces(drive: Segment, length: float | None) -> list[Segment]:
    """Cut a segment into pieces that keep the preceding inputs as their history."""
    if length is None:
        return [drive]
    rows = max(round(length / drive.step), MIN_SAMPLES)
    count, history = max(drive.size // rows, 1), round(HISTORY / drive.step)
    # The last piece takes the remainder, as a short one could not determine its initial state.
    edges = [k * rows for k in range(count)] + [drive.size]
    return [
        Segment(
            drive.log, drive.part, drive.start + drive.step * first, drive.step,

            {name: values[first:last] for name, values in drive.inputs.items()},
            {name: values[first:last] for name, values in drive.outputs.items()},
            {name: values[max(first - history, 0) : first] for name, values in drive.inputs.items()},
        )
        for first, last in pairwise(edges)
    ]  # fmt: skip
