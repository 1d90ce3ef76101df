"""Standard manoeuvres: their definitions with sources, drivers, runs, and figures of handling."""

from mirdrake.manoeuvres.base import Metric, Outcome
from mirdrake.manoeuvres.facts import Facts, find_facts
from mirdrake.manoeuvres.registry import MANOEUVRES, find_names, read_settings, run_manoeuvre
from mirdrake.manoeuvres.rig import Rig

__all__ = [
    "MANOEUVRES",
    "Facts",
    "Metric",
    "Outcome",
    "Rig",
    "find_facts",
    "find_names",
    "read_settings",
    "run_manoeuvre",
]
