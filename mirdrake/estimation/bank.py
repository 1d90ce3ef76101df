"""Bank of filters that estimate states and slowly varying parameters of a car; the law is in the kernel."""

from collections.abc import Sequence
from dataclasses import replace
from math import ceil, exp
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import ArrayLike

from mirdrake.batched.arrays import Floats
from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.signals import Signal
from mirdrake.core.yaml_io import Source, validate
from mirdrake.estimation.estimates import Estimates
from mirdrake.estimation.layout import Group, drift_of, make_group, process_noise, sensor_noise, start_size, unit_of
from mirdrake.estimation.spec import (
    ACCELERATIONS,
    GROUPS,
    STATES,
    FilterSpec,
    HypothesisSpec,
)
from mirdrake.estimation.tyre_laws import AXLES, friction_difference, uses_of
from mirdrake.single_track.dynamics import Inputs, Variant, record_of
from mirdrake.single_track.parameters import PARAMETERS, POSITIVE, SingleTrackParameters

if TYPE_CHECKING:
    from mirdrake.vehicles import Vehicle

FORCES = Inputs._fields[1:3]
"""Known forces: drive and brake force at the road [N]."""

INTERVAL_FACTOR = 2.0
"""Factor on the standard deviations of slow quantities, measured on drawn vehicles (benchmarks/calibration).

A filter that estimates states and parameters together is too certain: it takes the errors of its linearisation, and of
noise that it has not adapted yet, for independent ones (L. Ljung, IEEE Trans. Automatic Control 24, 1979).
"""

BEGINNING = ("steering", "vx")
"""States that begin with their first measurement."""


class FilterBank:
    """Filters with different hypotheses on one car, or one filter for each of n cars.

    Attributes:
        spec: settings.
        parameters: parameters of each filter.
        filters: names of the filters (n).
        sensors: names of the sensors (k), the columns of measurements.
        weights: probability of each hypothesis given all measurements so far (n).
        time: time of the last sample since the start [s]; negative before the first.

    Args:
        parameters: parameters of the car.
        spec: settings.

    Raises:
        ConfigError: unknown tyres, a parameter out of range, or a state that a hypothesis does not have.
    """

    def __init__(self, parameters: SingleTrackParameters, spec: FilterSpec) -> None:
        self.spec = spec
        self.sensors = tuple(spec.sensors)
        self.steps = ceil(spec.period / spec.step - 1e-9)
        variants = [_variant(spec, hypothesis) for hypothesis in spec.hypotheses]
        self.parameters = [_parameters(parameters, spec, hypothesis) for hypothesis in spec.hypotheses]
        self.filters = _names(spec.hypotheses, variants)
        self._groups = [
            make_group(spec, variant, [i for i, other in enumerate(variants) if other == variant], self.parameters)
            for variant in dict.fromkeys(variants)
        ]
        priors = np.array([hypothesis.weight for hypothesis in spec.hypotheses])
        self._priors: Floats = priors / priors.sum()
        self.weights: Floats = self._priors.copy()
        self.time = -spec.period
        names: dict[str, None] = {}
        for group in self._groups:
            names |= dict.fromkeys(group.names)
        self.names = tuple(names)
        self.reset()

    def reset(self, **states: ArrayLike) -> Self:
        """Start all filters anew, from given states (a number, or one per filter) and initial uncertainties.

        States that are not given are zero, but `steering` and `vx` are those of the first measurement.

        Raises:
            ConfigError: no filter has such a state.
        """
        for name in states:
            if name not in STATES or name not in self.names:
                known = [state for state in STATES if state in self.names]
                raise ConfigError(f"filter bank: no state '{name}'; {did_you_mean(name, known)}")
        self.weights, self.time = self._priors.copy(), -self.spec.period
        self._unknown = {*BEGINNING} - {*states}
        self._uses = {(i, name): 0.0 for i in range(len(self.filters)) for name in self.names if name in AXLES}
        for group in self._groups:
            memory = group.memory
            for field in memory:
                field[...] = 0
            noise = np.array([sensor_noise(self.spec, name) for name in self.sensors])
            for row, i in enumerate(group.filters):
                hypothesis, base = self.spec.hypotheses[i], self.parameters[i].wheelbase
                sizes = [start_size(self.spec, name, base, hypothesis.disturbance) for name in group.names]
                memory.first_process[row] = process_noise(self.spec, group.names, sizes, base)
                memory.first_noise[row] = (hypothesis.noise * noise) ** 2
                memory.root[row] = np.diag(sizes)
            memory.process[...], memory.noise[...] = memory.first_process, memory.first_noise
            for column, name in enumerate(group.names):
                if name in states:
                    values = np.broadcast_to(np.asarray(states[name], dtype=float), (len(self.filters),))
                    memory.mean[:, column] = values[group.filters]
        return self

    def step(self, measurements: ArrayLike, forces: ArrayLike | None = None) -> Estimates:
        """Advance all filters by one sample, and return the estimates (one time).

        Args:
            measurements: (k) or (n, k), in the order of :attr:`sensors`; NaN for missing ones.
            forces: (2) or (n, 2), in the order of :data:`FORCES`; zero if None.

        Raises:
            ConfigError: a shape is wrong.
        """
        rows = None if forces is None else np.asarray(forces, dtype=float)[..., None, :]
        return self.run(np.asarray(measurements, dtype=float)[..., None, :], rows)

    def run(self, measurements: ArrayLike, forces: ArrayLike | None = None) -> Estimates:
        """Advance all filters over samples, and return the estimates after each of them.

        Args:
            measurements: (t, k) for all filters, or (n, t, k), in the order of :attr:`sensors`; NaN for missing ones.
            forces: (t, 2) for all filters, or (n, t, 2), in the order of :data:`FORCES`; zero if None.

        Raises:
            ConfigError: a shape is wrong.
        """
        n = len(self.filters)
        seen = _rows(measurements, "measurements", n, len(self.sensors))
        samples = seen.shape[1]
        given = _rows(np.zeros((samples, 2)) if forces is None else forces, "forces", n, 2)
        if given.shape[1] != samples:
            raise ConfigError(
                f"filter bank: {given.shape[1]} samples of forces, {samples} of measurements; give as many"
            )
        rows = np.zeros((*given.shape[:2], len(Inputs._fields)))
        rows[..., 1:3] = given
        self._begin(seen)
        shape = (n, samples, len(self.names))
        means, deviations = np.full(shape, np.nan), np.full(shape, np.nan)
        likelihoods, checks = np.empty((n, samples)), np.empty((n, samples, 2, len(self.sensors)))
        for group in self._groups:
            count, size = len(group.filters), len(group.names)
            mean, variance = np.empty((count, samples, size)), np.empty((count, samples, size))
            likelihood, check = np.empty((count, samples)), np.empty((count, samples, 2, len(self.sensors)))
            group.run(
                group.flags, group.design, group.own, group.present, record_of(group.present),
                rows if len(rows) == 1 else np.ascontiguousarray(rows[group.filters]),
                seen if len(seen) == 1 else np.ascontiguousarray(seen[group.filters]),
                self.spec.period / self.steps, self.steps, group.memory, 0, count, mean, variance, likelihood, check,
            )  # fmt: skip
            columns = np.array([self.names.index(name) for name in group.names])
            places = np.ix_(group.filters, np.arange(samples), columns)
            slow = np.array([name in self.spec.estimate or name.endswith("_bias") for name in group.names])
            means[places], deviations[places] = mean, np.where(slow, INTERVAL_FACTOR, 1.0) * np.sqrt(variance)
            for row, i in enumerate(group.filters.tolist()):
                for name, more in self._law_deviations(group, i, mean[row], variance[row]).items():
                    column = self.names.index(name)
                    deviations[i, :, column] = np.hypot(deviations[i, :, column], more)
            likelihoods[group.filters], checks[group.filters] = likelihood, check
        before = round(self.time / self.spec.period) + 1
        time = self.time + self.spec.period * np.arange(1, samples + 1)
        self.time = float(time[-1])
        weights = self._weigh(likelihoods)
        return Estimates(
            time, self.filters, self.signals, means, deviations, self._scales(), self._shifts(), self.sensors,
            weights, likelihoods, checks, self._window(), before,
        )  # fmt: skip

    def _law_deviations(self, group: Group, i: int, mean: Floats, variance: Floats) -> dict[str, Floats]:
        """Return the deviations by the tyre law (t) of the frictions that a filter estimates.

        Args:
            group: of the filter.
            i: its place in the bank.
            mean: its means (t, names).
            variance: their variances (t, names).
        """
        elements = [name for name in group.names if name in AXLES]
        uses = uses_of(group.names, mean, self.parameters[i]) if elements else {}
        deviations_by_law = {}
        for name in elements:
            use = np.maximum.reduce([uses[axle] for axle in AXLES[name]])
            # The largest use so far contains most information about the limit; NaN after a divergence does not count.
            use = np.maximum.accumulate(np.maximum(np.nan_to_num(use, posinf=0.0), self._uses.get((i, name), 0.0)))
            self._uses[i, name] = float(use[-1])
            time = self.time + self.spec.period * np.arange(1, len(use) + 1)
            prior = self.spec.estimate[name].sigma ** 2 + drift_of(self.spec, name) ** 2 * time
            column = group.names.index(name)
            learned = np.clip(1.0 - variance[:, column] / prior, 0.0, 1.0)
            difference = friction_difference(group.variant.tyres, use, self.parameters[i])
            deviations_by_law[name] = np.maximum(learned * difference, np.minimum(difference, np.abs(mean[:, column])))
        return deviations_by_law

    @property
    def signals(self) -> tuple[Signal, ...]:
        """Name and unit of each estimated quantity."""
        return tuple(Signal(name, unit_of(name)) for name in self.names)

    @property
    def memory(self) -> Floats:
        """The state of all filters as a vector; can be assigned."""
        fields = [field.ravel() for group in self._groups for field in group.memory]
        unknown = [name in self._unknown for name in BEGINNING]
        return np.concatenate([*fields, self.weights, [self.time], unknown, [*self._uses.values()]])

    @memory.setter
    def memory(self, vector: Floats) -> None:
        place = 0
        for group in self._groups:
            for field in group.memory:
                field[...] = vector[place : place + field.size].reshape(field.shape)
                place += field.size
        self.weights = np.array(vector[place : place + len(self.filters)])
        self.time, *rest = vector[place + len(self.filters) :].tolist()
        self._unknown = {name for name, flag in zip(BEGINNING, rest, strict=False) if flag}
        self._uses = dict(zip(self._uses, rest[len(BEGINNING) :], strict=True))

    @property
    def noise(self) -> Floats:
        """Present standard deviations of the noise of each sensor (n, k)."""
        noise = np.empty((len(self.filters), len(self.sensors)))
        for group in self._groups:
            noise[group.filters] = np.sqrt(group.memory.noise)
        return noise

    @property
    def disturbances(self) -> Floats:
        """Present standard deviations of :data:`ACCELERATIONS` (n, 3) [m/s², m/s², rad/s²]."""
        sizes = np.zeros((len(self.filters), len(ACCELERATIONS)))
        for group in self._groups:
            for place, column in enumerate(group.design.accelerations):
                if column >= 0:
                    left = 1.0 - group.design.decays[column] ** 2
                    sizes[group.filters, place] = np.sqrt(group.memory.process[:, column] / left)
        return sizes

    def _begin(self, seen: Floats) -> None:
        """Set steering angle and speed that are not known yet by their first measurements."""
        for name in self._unknown & {*self.sensors}:
            values = seen[:, :, self.sensors.index(name)]
            good = np.isfinite(values)
            if not good.any(axis=1).all():
                continue
            first = np.broadcast_to(values[np.arange(len(values)), good.argmax(axis=1)], (len(self.filters),))
            for group in self._groups:
                group.memory.mean[:, group.names.index(name)] = first[group.filters]
            self._unknown -= {name}

    def _weigh(self, likelihoods: Floats) -> Floats:
        """Return the probabilities of the hypotheses after each sample (n, t).

        Bayes' rule; between samples the true hypothesis changes to one drawn from the priors with the probability
        1 - exp(-h / T) (a hidden Markov model; Y. Bar-Shalom, X. R. Li and T. Kirubarajan, Estimation with Applications
        to Tracking and Navigation, 2001, section 11.6).
        """
        change = 0.0 if self.spec.switching_time is None else 1.0 - exp(-self.spec.period / self.spec.switching_time)
        weights = np.empty(likelihoods.shape)
        present = self.weights
        for t in range(likelihoods.shape[1]):
            present = (1.0 - change) * present + change * self._priors
            best = likelihoods[:, t].max()
            if np.isfinite(best):
                present = present * np.exp(likelihoods[:, t] - best)
            total = present.sum()
            # A filter that has diverged has no weight; if all have, or all weights vanish, they begin anew.
            present = present / total if total > 0.0 else self._priors
            weights[:, t] = present
        self.weights = present
        return weights

    def _scales(self) -> Floats:
        """Return what a factor multiplies, 0 for elements that are no factor (n, names)."""
        scales = np.zeros((len(self.filters), len(self.names)))
        for column, name in enumerate(self.names):
            if name in GROUPS:
                scales[:, column] = 1.0
            elif name in POSITIVE:
                scales[:, column] = [getattr(parameters, name) for parameters in self.parameters]
        return scales

    def _shifts(self) -> Floats:
        """Return the value that a change is added to (n, names)."""
        shifts = np.zeros((len(self.filters), len(self.names)))
        for column, name in enumerate(self.names):
            if name in PARAMETERS and name not in POSITIVE:
                shifts[:, column] = [getattr(parameters, name) for parameters in self.parameters]
        return shifts

    def _window(self) -> float:
        return self.spec.consistency_time / self.spec.period


def filter_bank(
    car: "Vehicle | SingleTrackParameters | str", spec: FilterSpec | None = None, **settings: Any
) -> FilterBank:
    """Return a bank of filters that estimate states and slowly varying parameters of a driving car.

    Args:
        car: a vehicle, its name, or parameters of the single-track model.
        spec: settings; by default those given by name.
        **settings: fields of :class:`FilterSpec`, as `sensors`, `estimate`, `hypotheses`, `period`.

    Raises:
        ConfigError: an unknown setting, or a value out of range.
        ModelError: the vehicle cannot be loaded.
    """
    if spec is None:
        spec = validate(settings, FilterSpec, Source("filter bank", {}))
    elif settings:
        raise ConfigError(f"filter bank: '{next(iter(settings))}' is given beside spec; put it into the spec")
    if not isinstance(car, SingleTrackParameters):
        from mirdrake.single_track.from_vehicle import estimate_parameters
        from mirdrake.vehicles import load_vehicle

        car = estimate_parameters(load_vehicle(car) if isinstance(car, str) else car, roll=spec.roll)
    return FilterBank(car, spec)


def _variant(spec: FilterSpec, hypothesis: HypothesisSpec) -> Variant:
    given = {name: getattr(hypothesis, name) for name in ("tyres", "relaxation", "roll")}
    common = {name: getattr(spec, name) for name in given}
    variant = Variant(**{name: common[name] if value is None else value for name, value in given.items()})
    if variant.tyres == "kinematic":
        raise ConfigError("filter bank: the kinematic model has no tyres; use linear tyres or a kind of tyres")
    variant.check()
    return variant


def _parameters(
    parameters: SingleTrackParameters, spec: FilterSpec, hypothesis: HypothesisSpec
) -> SingleTrackParameters:
    changes = {**spec.parameters, **hypothesis.parameters}
    for name in changes:
        if name not in PARAMETERS:
            raise ConfigError(f"filter bank: no parameter '{name}'; {did_you_mean(name, PARAMETERS)}")
    return replace(parameters, **changes)


def _names(hypotheses: Sequence[HypothesisSpec], variants: Sequence[Variant]) -> tuple[str, ...]:
    """Return the names of the filters; by default what differs."""
    several = len(set(variants)) > 1
    names = []
    for number, (hypothesis, variant) in enumerate(zip(hypotheses, variants, strict=True)):
        parts = [variant.tyres, *(word for word in ("relaxation", "roll") if getattr(variant, word))] if several else []
        parts += [f"{name}={value:g}" for name, value in hypothesis.parameters.items()]
        names.append(hypothesis.name or " ".join(parts) or f"filter_{number}")
    return tuple(names)


def _rows(given: ArrayLike, what: str, filters: int, columns: int) -> Floats:
    """Return an array (1 or n, t, columns)."""
    array = np.ascontiguousarray(given, dtype=float)
    array = array[None] if array.ndim == 2 else array
    if array.ndim != 3 or array.shape[2] != columns or len(array) not in (1, filters) or not array.shape[1]:
        raise ConfigError(
            f"filter bank: {what} have the shape {np.shape(given)}; give (samples, {columns}), or such an array for "
            f"each of the {filters} filters"
        )
    return array
