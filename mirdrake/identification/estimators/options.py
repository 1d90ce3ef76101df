"""How a model is fitted."""

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class EstimatorOptions:
    """How a model is fitted.

    Attributes:
        loss: what residuals weigh; huber: those beyond 2.5 sigma only linearly.
        shooting: length of pieces with first states of their own [s]; None: each log is one piece.
        continuity: standard deviation of the gap between pieces, over the usual size of the states; None: pieces are
            not joined. Small: prediction error that lets little disturbance in.
        offsets: whether sensor offsets are estimated.
        bootstrap: draws of the block bootstrap; 0: none.
        profile: whether the profile likelihood of each free parameter is worked out.
        iterations: most evaluations of one least squares.
        seed: of the bootstrap.
    """

    loss: Literal["huber", "linear", "soft_l1"] = "huber"
    shooting: float | None = None
    continuity: float | None = None
    offsets: bool = True
    bootstrap: int = 0
    profile: bool = False
    iterations: int = 60
    seed: int = 0
