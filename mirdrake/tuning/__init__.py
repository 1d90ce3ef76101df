"""Tuning of control loops: experiments, models, rules, loop shaping, search, margins, Monte Carlo.

::

    TuningSpec ── tune.tune ──► TuningResult, its folder ── apply.plan_apply ──► control.yaml

The names below do not depend on a vehicle; :mod:`~mirdrake.tuning.loops` contains the loops of vehicles and diagrams.
"""

from mirdrake.tuning.figures import Figures, response_figures
from mirdrake.tuning.frequency_response import FrequencyResponse, measure_frequency_response
from mirdrake.tuning.gains import controller_response, from_series, from_standard, to_standard
from mirdrake.tuning.margins import Margins, UltimatePoint, find_margins, margins_of, ultimate_point
from mirdrake.tuning.models import FirstOrder, Integrator, Plant, TransferFunction, lags
from mirdrake.tuning.process_models import LinearProcess, PidLoop, Response, simulate_loop
from mirdrake.tuning.relay import RelayResult, run_relay_test
from mirdrake.tuning.shaping import design_for_phase_margin, maximize_integral_gain
from mirdrake.tuning.stability import is_stable
from mirdrake.tuning.step_test import StepRecord, fit_first_order, fit_integrator, run_step_test

__all__ = [
    "Figures", "FirstOrder", "FrequencyResponse", "Integrator", "LinearProcess", "Margins", "PidLoop", "Plant",
    "RelayResult", "Response", "StepRecord", "TransferFunction", "UltimatePoint", "controller_response",
    "design_for_phase_margin", "find_margins", "fit_first_order", "fit_integrator", "from_series", "from_standard",
    "is_stable", "lags", "margins_of", "maximize_integral_gain", "measure_frequency_response", "response_figures",
    "run_relay_test", "run_step_test", "simulate_loop", "to_standard", "ultimate_point",
]  # fmt: skip
