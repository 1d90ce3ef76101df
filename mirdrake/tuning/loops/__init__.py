"""Loops to tune: tests of gains on the full plant, or on a reduced model of the loop."""

from mirdrake.tuning.loops.base import (
    NOMINAL,
    Conditions,
    Course,
    Evaluation,
    Evaluator,
    Fidelity,
    Gain,
    LoopModel,
    LoopSpec,
    Status,
)

__all__ = [
    "NOMINAL", "Conditions", "Course", "Evaluation", "Evaluator", "Fidelity", "Gain", "LoopModel", "LoopSpec", "Status",
]  # fmt: skip
