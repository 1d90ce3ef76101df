"""Parameters of many cars as one table, checked column by column."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from mirdrake.batched.arrays import Floats
from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.single_track.parameters import PARAMETERS, SingleTrackParameters, are_allowed


def make_table(parameters: SingleTrackParameters, columns: Mapping[str, ArrayLike], count: int | None) -> Floats:
    """Return the parameters of n cars (n, parameters), in the order of :data:`PARAMETERS`.

    Args:
        parameters: parameters that the cars share.
        columns: values (n) of parameters that differ, by name; a single number holds for all cars.
        count: number of cars; by default the length of the columns, or 1.

    Raises:
        ConfigError: an unknown parameter, columns of different lengths, or a value out of range, with its car.
    """
    arrays = {name: np.asarray(values, dtype=float) for name, values in columns.items()}
    for name, values in arrays.items():
        if name not in PARAMETERS:
            raise ConfigError(f"batch: no parameter '{name}'; {did_you_mean(name, PARAMETERS)}")
        if values.ndim > 1:
            raise ConfigError(f"batch: '{name}' has the shape {values.shape}; give a number, or one per car")
    lengths = {name: len(values) for name, values in arrays.items() if values.ndim == 1}
    # The number of cars is that of the first column with several values; the others must agree.
    n = count if count is not None else next(iter(lengths.values()), 1)
    if n < 1:
        raise ConfigError(f"batch: there are {n} cars; there must be 1 or more")
    for name, length in lengths.items():
        if length != n:
            raise ConfigError(f"batch: '{name}' has {length} values, but there are {n} cars; give one value per car")
    table = np.tile(parameters.values(), (n, 1))
    for name, values in arrays.items():
        table[:, PARAMETERS.index(name)] = values
    # The whole table is checked at once; only the first wrong car is built by itself, for the message of its fault.
    wrong = np.flatnonzero(~are_allowed(table))
    if len(wrong):
        row = dict(zip(PARAMETERS, table[wrong[0]].tolist(), strict=True))
        try:
            SingleTrackParameters(**row)
        except ConfigError as error:
            raise ConfigError(f"batch: car {wrong[0]}: {error}") from None
        # Both checks have the same ranges; should they ever differ, no car passes without a message.
        given = ", ".join(f"{name}={value:g}" for name, value in row.items())
        raise ConfigError(f"batch: car {wrong[0]}: a parameter is out of range: {given}")
    return table
