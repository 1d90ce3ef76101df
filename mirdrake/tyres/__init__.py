"""Tyre models: forces and moments of the road on a tyre by slip, load and inclination."""

from mirdrake.tyres.base import SlipTyres, SteadyLaw, TyreAtLoad, TyreLaw, Tyres
from mirdrake.tyres.registry import TYRES, TyreSpec

__all__ = ["TYRES", "SlipTyres", "SteadyLaw", "TyreAtLoad", "TyreLaw", "TyreSpec", "Tyres"]
