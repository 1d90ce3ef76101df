"""Estimators: from a data set and a model to a fit."""

from mirdrake.identification.estimators.options import EstimatorOptions
from mirdrake.identification.estimators.output_error import fit

__all__ = ["EstimatorOptions", "fit"]
