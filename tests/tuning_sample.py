"""A tuning result as a study writes it, from a small but real tuning of a textbook loop.

The loop is the wheel speed of a small car: torque to speed, first order with dead time, gain 2 rad/s per N m, time
constant 1 s, dead time 0.05 s, controlled every 10 ms with a limit of 8 N m. All numbers are results of
:mod:`mirdrake.tuning`: step test, rules, shaping, a grid, a random search, exact margins, a Monte Carlo.
"""

import json
import math
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from mirdrake.core.errors import ConfigError
from mirdrake.core.json_io import finite_or_none
from mirdrake.core.pid import PidGains, PidLimits
from mirdrake.studies.spec import ParameterSpec
from mirdrake.tuning import (
    FirstOrder,
    LinearProcess,
    find_margins,
    fit_first_order,
    is_stable,
    maximize_integral_gain,
    response_figures,
    run_relay_test,
    run_step_test,
    simulate_loop,
)
from mirdrake.tuning.acceptance import Criterion
from mirdrake.tuning.designs import Design
from mirdrake.tuning.gain_map import map_of_two_gains
from mirdrake.tuning.identify import relay_experiment, simple_experiment
from mirdrake.tuning.loops.base import NOMINAL, Conditions, Course, Evaluation, Fidelity, Gain, LoopModel, LoopSpec
from mirdrake.tuning.margins import loop_range, loop_response
from mirdrake.tuning.result import CandidateResult, TuningResult, result_text, write_result
from mirdrake.tuning.robustness import run_monte_carlo
from mirdrake.tuning.rules import amigo, lambda_tuning, simc, ziegler_nichols_step, ziegler_nichols_ultimate
from mirdrake.tuning.search import search
from mirdrake.tuning.spec import MARGINS
from mirdrake.tuning.stages import Candidate
from mirdrake.tuning.tables import responses_table
from mirdrake.tuning.trials import make_trial

TRUE = FirstOrder(2.0, 1.0, 0.05)
PERIOD, DURATION, STEP = 0.01, 4.0, 3.0
LIMITS = PidLimits(-8.0, 8.0)
COST, CONSTRAINTS = {"iae": 1.0}, {"overshoot_percent": 5.0, "ms": 1.6}


def _gains(values: Mapping[str, float]) -> PidGains:
    kp, ki, kd = (float(values.get(name, 0.0)) for name in ("kp", "ki", "kd"))
    return PidGains(kp, ki, kd, filter_time=0.02 if kd else 0.0)


def _held(plant: FirstOrder) -> FirstOrder:
    """Return the plant with half a period of delay for the hold."""
    return FirstOrder(plant.gain, plant.time_constant, plant.delay + 0.5 * PERIOD)


def evaluate(gains: Mapping[str, float], conditions: Conditions = NOMINAL, fidelity: Fidelity = "plant") -> Evaluation:
    """Status, figures and response of gains; friction has no effect."""
    plant = FirstOrder(TRUE.gain, TRUE.time_constant * conditions.mass, TRUE.delay + (conditions.delay or 0.0))
    pid = _gains(gains)
    count = round(DURATION / PERIOD)
    reference = np.where(np.arange(count) * PERIOD < 0.2, 0.0, STEP)
    process = LinearProcess(plant.transfer_function(), PERIOD)
    simulated = simulate_loop(process, pid, period=PERIOD, reference=reference, limits=LIMITS)
    response = pd.DataFrame(
        {
            "t": simulated.time,
            "reference": simulated.reference,
            "output": simulated.measurement,
            "effort": simulated.control,
        }
    )
    try:
        stable = is_stable(_held(plant).transfer_function(), pid)
    except ConfigError:
        stable = False
    if not stable:
        return Evaluation("unstable", response=response, reason="a pole of the closed loop is in the right half plane")
    figures = asdict(response_figures(*(response[name] for name in response), limits=LIMITS))
    figures["overshoot_percent"] = 100.0 * figures.pop("overshoot")
    figures.pop("finite")
    robust = find_margins(_held(plant), pid)
    margins = (
        robust.max_sensitivity, robust.max_complementary, robust.gain_margin, math.degrees(robust.phase_margin),
        robust.delay_margin, robust.disk_margin,
    )  # fmt: skip
    return Evaluation("ok", figures | dict(zip(MARGINS, margins, strict=True)), response)


def _loop() -> LoopSpec:
    units = {"kp": "N m s/rad", "ki": "N m/rad", "kd": "N m s²/rad"}
    return LoopSpec(
        kind="wheel_speed",
        diagram={"plant": {"time_step": PERIOD}},
        vehicle="ego",
        gains={name: Gain(unit, f"wheel_speed.{name}") for name, unit in units.items()},
        reference="wheel_speed_setpoint",
        output="driven wheels",
        effort="joint_torque",
        output_unit="rad/s",
        effort_unit="N m",
        course=Course(STEP, 0.2, 0.0, DURATION, DURATION),
        period=PERIOD,
        settings={"wheel_speed.kind": "pid"},
        model=LoopModel({"main": TRUE.transfer_function()}),
    )


def write_sample(
    folder: Path,
    *,
    vehicle: str = "unior",
    runs: int = 40,
    trials: int = 60,
    cells: tuple[int, int] = (13, 11),
    seed: int = 3,
) -> TuningResult:
    """Tune, and write the result folder."""
    # Experiments and designs.
    record = run_step_test(LinearProcess(TRUE.transfer_function(), PERIOD), period=PERIOD, duration=6.0, amplitude=1.0)
    model = fit_first_order(record)
    relay = run_relay_test(
        LinearProcess(TRUE.transfer_function(), PERIOD), period=PERIOD, amplitude=1.0, hysteresis=0.01, duration=60.0
    )
    ultimate = relay.ultimate_gain, relay.ultimate_period
    created = {
        "Ziegler-Nichols step PI": ("ziegler_nichols_step", None, ziegler_nichols_step(model, "PI")),
        "Ziegler-Nichols relay PI": ("ziegler_nichols_relay", None, ziegler_nichols_ultimate(*ultimate, "PI")),
        "SIMC": ("simc", 1.0, simc(model)),
        "AMIGO": ("amigo", None, amigo(model, "PI")),
        "lambda": ("lambda", 0.3, lambda_tuning(model, 0.3)),
        "shaped PI": ("largest_integral_gain", 1.4, maximize_integral_gain(model, max_sensitivity=1.4)),
    }
    designs = [
        Design("cautious", "baseline", {"kp": 0.46, "ki": 0.46, "kd": 0.0}),
        Design("published", "baseline", {"kp": 100.0, "ki": 0.01, "kd": 10.0}),
    ]
    designs += [
        Design(name, "shaped" if rule == "largest_integral_gain" else "rule",
               {"kp": pid.kp, "ki": pid.ki, "kd": pid.kd}, rule, parameter)
        for name, (rule, parameter, pid) in created.items()
    ]  # fmt: skip

    # Search and map.
    space = {"kp": ParameterSpec(low=0.3, high=12.0, scale="log"), "ki": ParameterSpec(low=0.2, high=30.0, scale="log")}
    judged: dict[str, Any] = {"cost": COST, "constraints": CONSTRAINTS, "fixed": {"kd": 0.0}}
    search_result = search(evaluate, space, method="random", trials=trials, seed=seed, **judged)
    assert search_result.best is not None
    designs.append(Design("searched", "searched", search_result.best.gains))
    grid = {
        "kp": ParameterSpec(low=0.5, high=30.0, scale="log", count=cells[0]),
        "ki": ParameterSpec(low=0.2, high=200.0, scale="log", count=cells[1]),
    }
    evaluations = {design.name: evaluate(design.gains) for design in designs}
    tried = [
        Candidate(design, make_trial(k, design.gains, evaluations[design.name], COST, CONSTRAINTS),
                  evaluations[design.name].response)
        for k, design in enumerate(designs)
    ]  # fmt: skip
    feasible = [candidate for candidate in tried if candidate.trial.feasible]
    best = min(feasible, key=lambda candidate: candidate.trial.cost)
    rule = min(
        (candidate for candidate in feasible if candidate.design.kind == "rule"),
        key=lambda candidate: candidate.trial.cost,
    )

    # Monte Carlo, the same draws for each.
    chosen = dict.fromkeys(("cautious", "published", rule.name, best.name))
    gains = {candidate.name: candidate.design.gains for candidate in tried}
    ranges = {"mass": (0.8, 1.2), "friction": (0.3, 1.0), "delay": (0.0, 0.1)}
    monte_carlo = run_monte_carlo(evaluate, {name: gains[name] for name in chosen}, ranges, runs=runs, seed=seed)
    curves = []
    for name, values in gains.items():
        low, high = loop_range(_held(TRUE), _gains(values))
        w = np.geomspace(max(low, 0.05), min(high, 300.0), 300)
        value = loop_response(_held(TRUE), _gains(values))(w)
        curves.append(pd.DataFrame({"candidate": name, "omega": w, "re": value.real, "im": value.imag}))

    figures = best.trial.figures
    failures = monte_carlo.failures(best.name).failures
    criteria = [Criterion("cheaper_than_baseline", figures["iae"], tried[0].trial.figures["iae"], met=True)]
    criteria += [
        Criterion("constraint", figures[name], limit, figures[name] <= limit, name)
        for name, limit in CONSTRAINTS.items()
    ]
    criteria.append(Criterion("monte_carlo", float(failures), 0.0, failures == 0))
    result = TuningResult(
        name="textbook_wheel",
        vehicle=vehicle,
        spec={"mirdrake": "tuning/1", "name": "textbook_wheel", "loop": "wheel_speed", "seed": seed},
        spec_sha256="5d41402abc4b2a76b9719d911017c592ae5d41402abc4b2a76b9719d911017c5",
        seed=seed,
        versions={"mirdrake": "0.1"},
        loop=_loop(),
        candidates=tuple(
            CandidateResult(
                candidate.name, candidate.design.kind, candidate.design.gains, candidate.trial.status,
                {name: value for name, value in candidate.trial.figures.items() if not math.isnan(value)},
                finite_or_none(candidate.trial.cost), candidate.trial.feasible, candidate.design.rule,
                candidate.design.parameter, candidate.trial.reason, candidate.trial.rejections(CONSTRAINTS),
            )
            for candidate in tried
        ),
        baseline="cautious",
        best=best.name,
        best_rule=rule.name,
        cost=COST,
        constraints=CONSTRAINTS,
        experiments=(simple_experiment("step_test", model, fit_percent=99.9), relay_experiment(relay)),
        robustness=monte_carlo.summary({}),
        acceptance=tuple(criteria),
        wall_s=12.3,
        folder=folder,
    )  # fmt: skip
    tables = {
        "responses": responses_table(tried),
        "trials": search_result.table,
        "map": map_of_two_gains(evaluate, grid, **judged),
        "monte_carlo": monte_carlo.table,
        "frequency": pd.concat(curves, ignore_index=True),
    }
    return write_result(result, tables)


def short_result(vehicle: str, folder: Path = Path()) -> TuningResult:
    """Return a short result: three candidates of the loop above, for tests that need no tables."""
    rows = {
        "cautious": ("baseline", 0.46, 0.46, 2.17),
        "lambda": ("rule", 1.42857, 1.42857, 1.0512),
        "searched": ("searched", 3.540818334574936, 2.749375385638452, 0.604600),
    }
    return TuningResult(
        name="sample",
        vehicle=vehicle,
        spec={},
        spec_sha256="0123456789abcdef" * 4,
        seed=0,
        versions={},
        loop=_loop(),
        candidates=tuple(
            CandidateResult(name, kind, {"kp": kp, "ki": ki, "kd": 0.0}, "ok", {"iae": cost}, cost, feasible=True)  # type: ignore[arg-type]
            for name, (kind, kp, ki, cost) in rows.items()
        ),
        baseline="cautious",
        best="searched",
        best_rule="lambda",
        cost=COST,
        constraints=CONSTRAINTS,
        folder=folder,
    )


def result_data(vehicle: str) -> dict[str, Any]:
    """Return the short result as the data of tuning.json."""
    data: dict[str, Any] = json.loads(result_text(short_result(vehicle)))
    return data
