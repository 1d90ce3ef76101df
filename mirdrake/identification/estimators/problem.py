"""Residuals and their derivatives: the problem that least squares solves."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from mirdrake.identification.estimators.shooting import Sensitivity, Shots, make_shots, simulate
from mirdrake.identification.evidence import effective_samples
from mirdrake.identification.models.base import Array, Model, Segment
from mirdrake.identification.parameters import FitParameter

OUTLIERS = 5.0
"""Largest share of outliers in the residuals of an output [%]."""

_START = 3.0
"""Standard deviation of the initial state from its guess over its scale: a weak prior."""


@dataclass
class Problem:
    """Free parameters θ, sensor offsets of each log, initial states of each segment.

    Unknowns z: scaled free parameters; then offsets over their usual size, by log and output; then initial states of
    each segment, as the difference from their guess over the scale of the state.

    Residuals: outputs of each segment over their noise (outputs x n each), sample by sample, zero where nothing was
    measured; then the gaps between pieces of one log if they are joined; then priors of parameters, offsets and states.

    Attributes:
        model: the model.
        drives: segments that it is fitted to.
        unknowns: all parameters of the model.
        sigmas: noise by output [unit].
        offsets: whether sensors have offsets.
        joined: standard deviation of the gap between pieces of a log over the scales of the states; None if free.
    """

    model: Model
    drives: Sequence[Segment]
    unknowns: Sequence[FitParameter]
    sigmas: Mapping[str, float]
    offsets: bool = True
    joined: float | None = None
    _shots: list[Shots] = field(init=False, repr=False)
    _last: tuple[bytes, list[Sensitivity]] | None = field(default=None, init=False, repr=False)
    _closed: bytes = field(default=b"", init=False, repr=False)

    def __post_init__(self) -> None:
        self.free = [unknown for unknown in self.unknowns if unknown.kind != "fixed"]
        guess = self.model.complete({unknown.info.name: unknown.info.guess for unknown in self.unknowns})
        self._guess = guess
        self._shots = [make_shots(self.model, drive, guess) for drive in self.drives]
        # Guesses at the first parameters stay the reference of the initial states, as nodes move during the fit.
        self._starts = [shots.nodes[:, 0].copy() for shots in self._shots]
        self.logs = list(dict.fromkeys(drive.log for drive in self.drives))
        # Each log has its own offsets, as sensors are zeroed between logs.
        self.sensors = [
            (log, i)
            for log in self.logs
            for i, name in enumerate(self.model.outputs)
            if self.offsets and self.model.offset_scale(name) > 0.0
        ]
        self.masks, self._measured = [], []
        for drive in self.drives:
            values = np.array([drive.outputs[name] for name in self.model.outputs])
            self.masks.append(np.isfinite(values))
            self._measured.append(np.where(np.isfinite(values), values, 0.0))

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return len(self.free) + len(self.sensors) + len(self.drives) * len(self.model.states)

    @property
    def measured(self) -> int:
        """Number of residuals of measurements, including those of missing values, which are zero."""
        return int(sum(mask.size for mask in self.masks))

    @property
    def samples(self) -> int:
        """Number of measured values."""
        return int(sum(mask.sum() for mask in self.masks))

    def bounds(self) -> tuple[Array, Array]:
        """Return the bounds of the unknowns."""
        low, high = np.full(self.size, -np.inf), np.full(self.size, np.inf)
        for i, parameter in enumerate(self.free):
            low[i], high[i] = parameter.to_scaled(parameter.info.low), parameter.to_scaled(parameter.info.high)
        return low, high

    def values(self, z: Array) -> dict[str, float]:
        """Return all parameters for given unknowns."""
        values = dict(self._guess)
        for parameter, scaled in zip(self.free, z, strict=False):
            values[parameter.info.name] = parameter.to_value(float(scaled))
        return self.model.complete(values)

    def scaled(self, values: Mapping[str, float]) -> Array:
        """Return the unknowns for given parameters, without offsets and with guessed initial states."""
        z = np.zeros(self.size)
        for i, parameter in enumerate(self.free):
            z[i] = parameter.to_scaled(values[parameter.info.name])
        return z

    def _run(self, z: Array, *, derivatives: bool) -> list[Sensitivity] | None:
        """Simulate all segments; None if the model diverges. The last run is kept for the Jacobian."""
        # The optimiser asks for residuals and Jacobian at the same unknowns; the run with derivatives serves both.
        if self._last is not None and self._last[0] == z.tobytes():
            return self._last[1]
        # After a run at the same unknowns the shots are closed already. The mark is cleared in case this run fails.
        closed, self._closed = z.tobytes() == self._closed, b""
        base = self.values(z)
        # One column per free parameter, changed in its scaled value: all derivatives come from one batch of runs.
        columns = [base]
        if derivatives:
            for parameter, scaled in zip(self.free, z, strict=False):
                changed = parameter.to_value(float(scaled) + self.model.difference_step)
                columns.append(self.model.complete({**base, parameter.info.name: changed}))
        # Unknowns are, in this order: parameters, offsets of sensors, and the initial state of each segment.
        runs = []
        scales, size = np.array(self.model.state_scales), len(self.model.states)
        for k, (shots, start) in enumerate(zip(self._shots, self._starts, strict=True)):
            offset = len(self.free) + len(self.sensors) + k * size
            first = start + scales * z[offset : offset + size]
            run = simulate(
                self.model,
                shots,
                columns,
                first,
                changes=self.model.difference_step,
                derivatives=derivatives,
                closed=closed,
            )
            if run is None:  # retry from the measured states
                shots.nodes = make_shots(self.model, shots.drive, base).nodes
                run = simulate(
                    self.model, shots, columns, first, changes=self.model.difference_step, derivatives=derivatives
                )
            if run is None:
                return None
            runs.append(run)
        self._closed = z.tobytes()
        if derivatives:
            self._last = (z.tobytes(), runs)
        return runs

    def traces(self, z: Array) -> list[Array]:
        """Return the model outputs with offsets (outputs, n), by segment.

        Raises:
            FloatingPointError: the model diverges.
        """
        runs = self._run(z, derivatives=False)
        if runs is None:
            raise FloatingPointError("the states of the model diverge")
        return [run.y + self._offsets_of(z, drive)[:, None] for run, drive in zip(runs, self.drives, strict=True)]

    def _offsets_of(self, z: Array, drive: Segment) -> Array:
        offsets = np.zeros(len(self.model.outputs))
        for k, (log, i) in enumerate(self.sensors):
            if log == drive.log:
                offsets[i] = z[len(self.free) + k] * self.model.offset_scale(self.model.outputs[i])
        return offsets

    def with_median_offsets(self, z: Array) -> Array:
        """Return unknowns whose offsets make the median of the residuals of each sensor of a log zero.

        Raises:
            FloatingPointError: the model diverges.
        """
        traces, z = self.traces(z), z.copy()
        for k, (log, i) in enumerate(self.sensors):
            left = [
                (seen - trace)[i, mask[i]]
                for trace, seen, mask, drive in zip(traces, self._measured, self.masks, self.drives, strict=True)
                if drive.log == log
            ]
            away = np.concatenate(left)
            if len(away):
                z[len(self.free) + k] += float(np.median(away)) / self.model.offset_scale(self.model.outputs[i])
        return z

    def residuals(self, z: Array) -> Array:
        """Return the residuals at given unknowns; NaN if the model diverges."""
        runs = self._run(z, derivatives=False)
        if runs is None:
            return np.full(self.rows, np.nan)
        parts = []
        noise = np.array([self.sigmas[name] for name in self.model.outputs])
        for run, drive, mask, seen in zip(runs, self.drives, self.masks, self._measured, strict=True):
            off = (run.y + self._offsets_of(z, drive)[:, None] - seen) / noise[:, None]
            # Missing values count as zero instead of being removed, so that rows keep their place in the Jacobian.
            parts.append(np.where(mask, off, 0.0).T.ravel())
        parts += self._gaps(z, runs)
        return np.concatenate([*parts, self._priors(z)])

    @property
    def rows(self) -> int:
        """Number of residuals."""
        return self.measured + len(self._joints()) * len(self.model.states) + self._prior_rows

    def jacobian(self, z: Array) -> Array:
        """Return the derivatives of the residuals (rows, unknowns)."""
        runs = self._run(z, derivatives=True)
        jacobian = np.zeros((self.rows, self.size))
        if runs is None:
            return jacobian * np.nan
        # Measurements: by parameters, initial states and offsets.
        free, size, row = len(self.free), len(self.model.states), 0
        noise = np.array([self.sigmas[name] for name in self.model.outputs])
        for k, (run, drive, mask) in enumerate(zip(runs, self.drives, self.masks, strict=True)):
            shown = mask.T.ravel()[:, None]
            block = jacobian[row : row + mask.size]
            block[:, :free] = np.moveaxis(run.by_parameters / noise[:, None, None], 0, 1).reshape(mask.size, free)
            start = free + len(self.sensors) + k * size
            by_start = run.by_start / noise[:, None, None] * np.array(self.model.state_scales)
            block[:, start : start + size] = np.moveaxis(by_start, 0, 1).reshape(mask.size, size)
            for j, (log, i) in enumerate(self.sensors):
                if log == drive.log:
                    # Outputs alternate from row to row, hence the stride.
                    block[i :: len(noise), free + j] = self.model.offset_scale(self.model.outputs[i]) / noise[i]
            block *= shown
            row += mask.size
        # Gaps between joined pieces.
        for k in self._joints():
            rows = slice(row, row + size)
            assert self.joined is not None
            by = runs[k].last_by / (np.array(self.model.state_scales)[:, None] * self.joined)
            jacobian[rows, :free] = by[:, :free]
            start = free + len(self.sensors) + k * size
            jacobian[rows, start : start + size] = by[:, free:] * np.array(self.model.state_scales)
            # The state of the next piece enters with the opposite sign; both are over their scales.
            jacobian[rows, start + size : start + 2 * size] = -np.eye(size) / self.joined
            row += size
        # Priors.
        for i, parameter in enumerate(self.free):
            if parameter.prior is not None:
                # Priors of a study are normal in the value, not in its logarithm, so the slope of the scaling enters.
                jacobian[row, i] = parameter.slope(parameter.to_value(float(z[i]))) / parameter.prior[1]
                row += 1
            elif parameter.info.usual > 0.0:
                jacobian[row, i] = 1.0 / parameter.info.usual_at(float(z[i]))
                row += 1
        rest = self.size - free
        weights = np.ones(rest)
        weights[len(self.sensors) :] = 1.0 / _START
        jacobian[row:, free:] = np.diag(weights)
        return jacobian

    def _joints(self) -> list[int]:
        """Return the indices of segments that the next one continues."""
        if self.joined is None:
            return []
        return [k for k in range(len(self.drives) - 1) if is_continuation(self.drives[k], self.drives[k + 1])]

    def _gaps(self, z: Array, runs: Sequence[Sensitivity]) -> list[Array]:
        size, gaps = len(self.model.states), []
        scales = np.array(self.model.state_scales)
        for k in self._joints():
            offset = len(self.free) + len(self.sensors) + (k + 1) * size
            after = self._starts[k + 1] + scales * z[offset : offset + size]
            gaps.append((runs[k].last - after) / (scales * (self.joined or 1.0)))
        return gaps

    @property
    def _prior_rows(self) -> int:
        """Number of residuals of priors: parameters with a prior or a usual size, sensors and initial states."""
        priors = sum(parameter.prior is not None or parameter.info.usual > 0.0 for parameter in self.free)
        return priors + self.size - len(self.free)

    def _priors(self, z: Array) -> Array:
        residuals = []
        for parameter, scaled in zip(self.free, z, strict=False):
            if parameter.prior is not None:
                residuals.append((parameter.to_value(float(scaled)) - parameter.prior[0]) / parameter.prior[1])
            elif parameter.info.usual > 0.0:
                residuals.append(float(scaled) / parameter.info.usual_at(float(scaled)))
        rest = z[len(self.free) :].copy()
        rest[len(self.sensors) :] /= _START
        return np.concatenate((np.array(residuals), rest))

    def spread(self, z: Array) -> dict[str, float]:
        """Return the noise of the outputs [unit]: the root mean square of the residuals, with outliers limited.

        Autocorrelated residuals count as fewer samples. The autocorrelation that all outputs share is that of the
        noise; it enlarges all alike, so that noise does not outweigh what is usual for a vehicle.
        """
        traces, spread, repeats = self.traces(z), {}, {}
        for i, name in enumerate(self.model.outputs):
            off = np.concatenate([
                (trace[i] - seen[i])[mask[i]]
                for trace, seen, mask in zip(traces, self._measured, self.masks, strict=True)
            ])  # fmt: skip
            # Outliers are limited, so that glitches do not inflate the noise. What more than a few samples have is not
            # an outlier: without noise, the bulk of a log may fit exactly and its transients not.
            cutoff = 1.0
            if len(off):
                cutoff = max(6.0 * float(np.median(np.abs(off))), float(np.percentile(np.abs(off), 100.0 - OUTLIERS)))
            off = np.clip(off, -cutoff, cutoff)
            spread[name] = float(np.sqrt(np.mean(off**2))) or 1e-9
            repeats[name] = len(off) / effective_samples(off) if np.ptp(off) > 0.0 else 1.0
        shared = float(np.sqrt(min(repeats.values())))
        return {name: value * shared for name, value in spread.items()}


def is_continuation(segment: Segment, other: Segment) -> bool:
    """Whether a segment begins where another one ends."""
    gap = other.start - segment.start - segment.step * segment.size
    return segment.log == other.log and abs(gap) < 0.5 * segment.step


def transfer_states(z: Array, before: Problem, now: Problem) -> Array:
    """Return the sensor offsets and initial states of one problem for another model of the same segments.

    Args:
        z: unknowns of `before`: parameters, sensor offsets, and initial states relative to their guesses.
        before: problem of these unknowns.
        now: problem with another model; states that `before` does not have stay at their guesses.
    """
    offsets, starts = np.split(z[len(before.free) :], [len(before.sensors)])
    old_names, new_names = before.model.states, now.model.states
    states = np.zeros((len(now.drives), len(new_names)))
    for i, name in enumerate(new_names):
        if name in old_names:
            states[:, i] = starts.reshape(-1, len(old_names))[:, old_names.index(name)]
    return np.concatenate((offsets, states.ravel()))
