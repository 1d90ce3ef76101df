"""Models whose parameters are fitted to recorded drives."""

from mirdrake.identification.models.base import Model, ModelOptions, ModelSpec, Segment
from mirdrake.identification.models.equations import CompiledModel, EquationModel
from mirdrake.identification.models.registry import MODELS, make_model
from mirdrake.identification.models.simulated import SimulatedModel

__all__ = [
    "MODELS", "CompiledModel", "EquationModel", "Model", "ModelOptions", "ModelSpec", "Segment", "SimulatedModel",
    "make_model",
]  # fmt: skip
