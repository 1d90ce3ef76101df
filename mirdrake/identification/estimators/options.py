"""Options of the estimator."""

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class EstimatorOptions:
    """Options of the estimator.

    Attributes:
        loss: loss function; huber: residuals beyond 2.5 sigma count linearly.
        shooting: length of pieces with initial states of their own [s]; None: each segment is one piece.
        continuity: standard deviation of the gap between pieces over the scale of the states; None: pieces are not
        joined.
            A small value gives a prediction-error method that allows little disturbance.
        offsets: whether sensor offsets are estimated.
        bootstrap: draws of the block bootstrap; 0 for none.
        profile: whether the profile likelihood of each free parameter is computed.
        iterations: largest number of evaluations of one optimisation.
        seed: seed of the bootstrap.
    """

    loss: Literal["huber", "linear", "soft_l1"] = "huber"
    shooting: float | None = None
    continuity: float | None = None
    offsets: bool = True
    bootstrap: int = 0
    profile: bool = False
    iterations: int = 60
    seed: int = 0
