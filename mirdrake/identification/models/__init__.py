"""Models whose parameters are fitted to recorded drives."""

from mirdrake.identification.models.base import Drive, Model, ModelSpec
from mirdrake.identification.models.registry import MODELS, make_model

__all__ = ["MODELS", "Drive", "Model", "ModelSpec", "make_model"]
