"""Results of a batch: labelled arrays over cars and time."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mirdrake.batched.arrays import Floats, Integers
from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.signals import Signals

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class BatchRun:
    """Signals of all cars over time.

    Attributes:
        time: times of the rows [s] (t).
        values: signals (n, t, signals); NaN after a car has diverged.
        signals: name, unit and description of each signal.
        diverged: indices of the diverged cars.
    """

    time: Floats
    values: Floats
    signals: Signals
    diverged: Integers

    @property
    def names(self) -> list[str]:
        """Names of the signals."""
        return [signal.name for signal in self.signals]

    @property
    def units(self) -> dict[str, str]:
        """Units of the signals by name."""
        return {signal.name: signal.unit for signal in self.signals}

    def __getitem__(self, name: str) -> Floats:
        """Return a signal of all cars (n, t).

        Raises:
            ConfigError: the signal is unknown.
        """
        if name not in self.names:
            raise ConfigError(f"batch: no signal '{name}'; {did_you_mean(name, self.names)}")
        return self.values[:, :, self.names.index(name)]

    def table(self, car: int) -> "pd.DataFrame":
        """Return the signals of a car, index ``time``; units in ``attrs["units"]``.

        Raises:
            ConfigError: the index of the car is out of range.
        """
        import pandas as pd

        if not 0 <= car < len(self.values):
            raise ConfigError(f"batch: no car {car}; they are numbered from 0 to {len(self.values) - 1}")
        table = pd.DataFrame(np.array(self.values[car]), columns=self.names, index=pd.Index(self.time, name="time"))
        table.attrs["units"] = self.units
        return table
