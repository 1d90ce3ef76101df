"""Estimates of a filter bank over time: values with 95 % intervals, weights of the hypotheses, consistency."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mirdrake.batched.arrays import Floats, Mask
from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.signals import Signals

if TYPE_CHECKING:
    import pandas as pd

QUANTILE = 1.959964
"""Half the 95 % interval of a normal distribution over its standard deviation."""

MAX_CORRELATION = 0.3
"""Largest correlation of successive innovations of a consistent filter [1]."""

MAX_SQUARE = 2.0
"""Largest mean square of the normalised innovations of a consistent filter, and inverse of the least one [1]."""

_CHANCE = 3.3  # standard deviations that chance explains: 1 in 1000


@dataclass(frozen=True)
class Estimates:
    """Estimates of n filters at t times.

    Attributes:
        time: times [s] (t).
        filters: names of the filters (n).
        signals: name and unit of each quantity (q).
        means: means of the elements of the filters (n, t, q): the logarithm of a factor for positive parameters;
            NaN for quantities that a filter does not have, and after it has diverged.
        deviations: their standard deviations (n, t, q).
        scales: what a factor multiplies, 0 for an element that is no factor (n, q).
        shifts: what an element that is no factor is added to (n, q).
        sensors: names of the sensors (k).
        weights: probabilities of the hypotheses (n, t).
        likelihoods: logarithm of the probability density of each sample given those before (n, t).
        checks: moving averages of the squares of the normalised innovations and of the products of successive ones
            (n, t, 2, k); 1 and 0 are expected.
        window: number of samples of these averages.
        samples: number of samples before the first of these times.
    """

    time: Floats
    filters: tuple[str, ...]
    signals: Signals
    means: Floats
    deviations: Floats
    scales: Floats
    shifts: Floats
    sensors: tuple[str, ...]
    weights: Floats
    likelihoods: Floats
    checks: Floats
    window: float
    samples: int = 0

    @property
    def names(self) -> list[str]:
        """Names of the quantities."""
        return [signal.name for signal in self.signals]

    def __getitem__(self, name: str) -> Floats:
        """Return the estimates of a quantity (n, t); the median of a positive parameter.

        Raises:
            ConfigError: no filter has such a quantity.
        """
        return self._values(name, 0.0)

    def interval(self, name: str) -> tuple[Floats, Floats]:
        """Return the ends of the 95 % interval of a quantity (n, t) each.

        Raises:
            ConfigError: no filter has such a quantity.
        """
        return self._values(name, -QUANTILE), self._values(name, QUANTILE)

    def combined(self, name: str) -> tuple[Floats, Floats]:
        """Return mean and standard deviation of a quantity over the hypotheses with their weights (t) each.

        Raises:
            ConfigError: no filter has such a quantity.
        """
        low, high = self.interval(name)
        values, deviations = self[name], (high - low) / (2.0 * QUANTILE)
        # Filters without the quantity have no weight here.
        weights = np.where(np.isfinite(values), self.weights, 0.0)
        weights = weights / np.maximum(weights.sum(axis=0), 1e-300)
        mean = np.sum(weights * np.nan_to_num(values), axis=0)
        square = np.nan_to_num(deviations) ** 2 + (np.nan_to_num(values) - mean) ** 2
        return mean, np.sqrt(np.sum(weights * square, axis=0))

    @property
    def squares(self) -> Floats:
        """Mean square of the normalised innovations (n, t); 1 is expected."""
        return np.asarray(self.checks[:, :, 0].mean(axis=2))

    @property
    def correlations(self) -> Floats:
        """Largest correlation of successive innovations over the sensors (n, t); 0 is expected."""
        squares, products = self.checks[:, :, 0], self.checks[:, :, 1]
        return np.asarray(np.max(np.abs(products) / np.maximum(squares, 1e-12), axis=2))

    @property
    def consistent(self) -> Mask:
        """Whether innovations agree with model and noise (n, t); otherwise intervals may be too narrow.

        Their mean square has a chi-squared distribution, their correlation a standard deviation of N^-½.
        """
        count = np.minimum(self.samples + np.arange(1, len(self.time) + 1), 2.0 * self.window)
        chance = _CHANCE / np.sqrt(count)
        width = chance * np.sqrt(2.0 / len(self.sensors))
        fits = (self.squares < MAX_SQUARE + width) & (self.squares > 1.0 / MAX_SQUARE - width)
        return np.asarray(fits & (self.correlations < MAX_CORRELATION + chance))

    def table(self, chosen: int | str = 0) -> "pd.DataFrame":
        """Return estimates and interval ends of a filter, index ``time``; units in ``attrs["units"]``.

        Raises:
            ConfigError: there is no such filter.
        """
        import pandas as pd

        names = list(self.filters)
        if chosen not in names and chosen not in range(len(names)):
            raise ConfigError(f"filter bank: no filter '{chosen}'; {did_you_mean(str(chosen), names)}")
        row = names.index(chosen) if isinstance(chosen, str) else chosen
        columns, units = {}, {}
        for signal in self.signals:
            values = self[signal.name][row]
            if np.isnan(values).all():
                continue
            low, high = (end[row] for end in self.interval(signal.name))
            for suffix, series in (("", values), ("_low", low), ("_high", high)):
                columns[signal.name + suffix], units[signal.name + suffix] = series, signal.unit
        columns |= {"weight": self.weights[row], "consistent": self.consistent[row]}
        table = pd.DataFrame(columns, index=pd.Index(self.time, name="time"))
        table.attrs["units"] = units
        return table

    def _values(self, name: str, deviations: float) -> Floats:
        if name not in self.names:
            raise ConfigError(f"filter bank: no quantity '{name}'; {did_you_mean(name, self.names)}")
        column = self.names.index(name)
        element = self.means[:, :, column] + deviations * self.deviations[:, :, column]
        scale = self.scales[:, column, None]
        return np.asarray(np.where(scale > 0.0, scale * np.exp(element), self.shifts[:, column, None] + element))
