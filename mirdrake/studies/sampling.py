"""Sampling of a study: from ranges and lists to the values of each run."""

import math
import warnings
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mirdrake.core.errors import ConfigError
from mirdrake.core.yaml_io import where
from mirdrake.studies.spec import DrawnSampling, GridSampling, ParameterSpec, StudySpec

MOST = 10_000_000
"""Largest number of runs."""


def sample(spec: StudySpec) -> list[tuple[Any, ...]]:
    """Return the values of every run as a tuple in the order of the parameters.

    Raises:
        ConfigError: the parameters do not fit the kind of sampling.
    """
    sampling, parameters = spec.sampling, spec.parameters
    # Drawn samples are in the unit cube and are spread over the ranges by their distributions.
    if isinstance(sampling, DrawnSampling):
        unit = draw(sampling.kind, sampling.runs, len(parameters), spec.seed)
        columns = [spread(entry, unit[:, column]) for column, entry in enumerate(parameters.values())]
        return list(zip(*columns, strict=True))
    for name, entry in parameters.items():
        if entry.values is None and entry.count is None:
            more = " a count, or" if isinstance(sampling, GridSampling) else ""
            raise ConfigError(f"a {sampling.kind} needs{more} values", where=where(spec, "parameters", name))
    # Grids and lists have given values: all combinations, or one after another.
    lists = [divide(entry) for entry in parameters.values()]
    if isinstance(sampling, GridSampling):
        if math.prod(map(len, lists)) > MOST:
            raise ConfigError(f"the grid has more than {MOST} runs; use fewer values", where=where(spec, "parameters"))
        return list(product(*lists))
    first = next(iter(parameters))
    for name, values in zip(parameters, lists, strict=True):
        if len(values) != len(lists[0]):
            raise ConfigError(
                "a list needs as many values for each parameter; "
                f"{first} has {len(lists[0])}, {name} has {len(values)}",
                where=where(spec, "parameters", name),
            )
    return list(zip(*lists, strict=True))


def draw(kind: str, runs: int, size: int, seed: int) -> NDArray[np.float64]:
    """Draw points of the unit cube, shape (runs, size).

    Args:
        kind: random, latin_hypercube, or sobol (scrambled); the last two by ``scipy.stats.qmc``.
        runs: number of points.
        size: number of coordinates.
        seed: equal seeds give equal points.
    """
    generator = np.random.default_rng(seed)
    if kind == "random":
        return generator.random((runs, size))
    from scipy.stats import qmc  # the import takes half a second, which a worker does not need

    if kind == "latin_hypercube":
        return np.asarray(qmc.LatinHypercube(size, seed=generator).random(runs))
    with warnings.catch_warnings():  # SciPy warns of a number of runs that is not a power of two
        warnings.simplefilter("ignore", UserWarning)
        return np.asarray(qmc.Sobol(size, seed=generator).random(runs))


def spread(entry: ParameterSpec, unit: NDArray[np.float64]) -> list[Any]:
    """Map numbers between 0 and 1, shape (n,), to values of a parameter."""
    if entry.values is not None:
        count = len(entry.values)
        # Equal shares of 0 to 1; the minimum is for u = 1.
        return [entry.values[min(int(u * count), count - 1)] for u in unit]
    assert entry.low is not None
    assert entry.high is not None
    if entry.scale == "log":
        values = np.exp(np.log(entry.low) + unit * (np.log(entry.high) - np.log(entry.low)))
        # Exponential and logarithm may leave the range by rounding, which the parameter could reject.
        return [float(value) for value in np.clip(values, entry.low, entry.high)]
    return [float(value) for value in entry.low + unit * (entry.high - entry.low)]


def divide(entry: ParameterSpec) -> list[Any]:
    """Return the values of a list, or of a range divided evenly into its count."""
    if entry.values is not None:
        return list(entry.values)
    assert entry.low is not None
    assert entry.high is not None
    assert entry.count is not None
    even = np.geomspace if entry.scale == "log" else np.linspace
    return [float(value) for value in even(entry.low, entry.high, entry.count)]
