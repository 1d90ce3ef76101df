"""Loops to tune: what a set of gains does on the full plant, or on a reduced model of the loop."""

from mirdrake.tuning.loops.base import NOMINAL, Conditions, Evaluation, Evaluator, Fidelity, Loop, LoopSpec, Status

__all__ = ["NOMINAL", "Conditions", "Evaluation", "Evaluator", "Fidelity", "Loop", "LoopSpec", "Status"]
