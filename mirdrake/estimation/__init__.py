"""Estimation of states and slowly varying parameters of a driving car, by banks of Kalman filters."""

from mirdrake.estimation.bank import FORCES, FilterBank, filter_bank
from mirdrake.estimation.estimates import Estimates
from mirdrake.estimation.spec import FilterSpec

__all__ = ["FORCES", "Estimates", "FilterBank", "FilterSpec", "filter_bank"]
