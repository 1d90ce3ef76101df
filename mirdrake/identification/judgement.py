"""Figures behind the verdicts of a fit; their sentences are made in :mod:`mirdrake.identification.messages`."""

from dataclasses import dataclass
from typing import Literal

from mirdrake.identification.fit import Verdict
from mirdrake.identification.models.base import Assumption
from mirdrake.identification.parameters import FitParameter


@dataclass(frozen=True)
class Judgement:
    """Verdict on a free parameter, and its reasons.

    Attributes:
        parameter: parameter of the fit.
        value: estimate.
        verdict: verdict.
        noise: standard deviation of the scaled parameter by the noise [1].
        by_assumptions: the same by the assumptions [1].
        between: the same between parts of the logs [1].
        structures: the same between structures that predict as well [1].
        sigma: standard deviation by all of them [1].
        bound: bound that the estimate is at.
        is_certain: whether the uncertainty alone would allow the parameter to be used.
        is_meaningless: whether the value is outside of its plausible range and uncertain, or the model is wrong.
        plausible: plausible range, if the value lies outside of it.
        depends_on: assumption with the largest effect, if assumptions matter more than noise.
        inseparable: names of strongly correlated parameters.
        remedy: experiment that would identify the parameter.
        prior_share: standard deviation by noise over that of the prior; 0 without one.
        contradicts: whether the given value lies outside of the interval, however wide that is.
    """

    parameter: FitParameter
    value: float
    verdict: Verdict
    noise: float
    by_assumptions: float
    between: float
    structures: float
    sigma: float
    bound: Literal["low", "high"] | None
    is_certain: bool
    is_meaningless: bool
    plausible: tuple[float, float] | None
    depends_on: Assumption | None
    inseparable: tuple[str, ...]
    remedy: str
    prior_share: float
    contradicts: bool


@dataclass(frozen=True)
class Combination:
    """Known combination of parameters with a name of its own.

    Attributes:
        name: what it is.
        value: its value [unit].
        sigma: standard deviation [unit].
        unit: its unit.
    """

    name: str
    value: float
    sigma: float
    unit: str


@dataclass(frozen=True)
class Direction:
    """Identified direction in the space of scaled parameters.

    Attributes:
        parts: parameters and their weights.
        sigma: standard deviation along the direction [1].
    """

    parts: tuple[tuple[FitParameter, float], ...]
    sigma: float
