"""Models whose parameters are fitted to recorded drives."""

from mirdrake.identification.models.base import Model, ModelOptions, ModelSpec, Segment
from mirdrake.identification.models.registry import MODELS, make_model

__all__ = ["MODELS", "Model", "ModelOptions", "ModelSpec", "Segment", "make_model"]
