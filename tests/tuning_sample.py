"""A tuning result folder as a study writes it, made by a small but real tuning of a textbook loop.

The loop is the wheel speed of a small car: torque to speed, first order with dead time, gain 2 rad/s per N m, time
constant 1 s, dead time 0.05 s, controlled every 10 ms with a limit of 8 N m. Every number comes from
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
from scipy.stats import binomtest

from mirdrake.core.errors import ConfigError
from mirdrake.core.pid import PidGains, PidLimits
from mirdrake.tuning import (
    FirstOrder,
    LinearProcess,
    RelayResult,
    find_margins,
    fit_first_order,
    is_stable,
    maximize_integral_gain,
    response_figures,
    run_relay_test,
    run_step_test,
    simulate_loop,
)
from mirdrake.tuning.margins import loop_range, loop_response
from mirdrake.tuning.rules import amigo, lambda_tuning, simc, ziegler_nichols_step, ziegler_nichols_ultimate

TRUE = FirstOrder(2.0, 1.0, 0.05)
PERIOD, DURATION, STEP = 0.01, 4.0, 3.0
LIMITS = PidLimits(-8.0, 8.0)
LIMIT_MS, LIMIT_OVERSHOOT = 1.6, 5.0


def _gains(values: Mapping[str, float]) -> PidGains:
    kp, ki, kd = (float(values.get(name, 0.0)) for name in ("kp", "ki", "kd"))
    return PidGains(kp, ki, kd, filter_time=0.02 if kd else 0.0)


def _late(plant: FirstOrder) -> FirstOrder:
    """The plant with half a period of delay for the hold."""
    return FirstOrder(plant.gain, plant.time_constant, plant.delay + 0.5 * PERIOD)


def evaluate(values: Mapping[str, float], plant: FirstOrder = TRUE) -> dict[str, Any]:
    """Status, figures, margins and response of gains."""
    gains = _gains(values)
    count = round(DURATION / PERIOD)
    reference = np.where(np.arange(count) * PERIOD < 0.2, 0.0, STEP)
    process = LinearProcess(plant.transfer_function(), PERIOD)
    response = simulate_loop(process, gains, period=PERIOD, reference=reference, limits=LIMITS)
    frame = pd.DataFrame(
        {
            "t": response.time,
            "reference": response.reference,
            "output": response.measurement,
            "effort": response.control,
        }
    )
    try:
        stable = is_stable(_late(plant).transfer_function(), gains)
    except ConfigError:
        stable = False
    if not stable:
        return {
            "status": "unstable",
            "reason": "a pole of the closed loop is in the right half plane",
            "response": frame,
            "figures": {},
            "margins": None,
        }
    found = asdict(response_figures(*(frame[name] for name in frame), limits=LIMITS))
    found["overshoot_percent"] = 100.0 * found.pop("overshoot")
    found.pop("finite")
    margins = find_margins(_late(plant), gains)
    told = {
        "gain_margin": margins.gain_margin,
        "phase_margin_deg": math.degrees(margins.phase_margin),
        "delay_margin_s": margins.delay_margin,
        "ms": margins.max_sensitivity,
        "mt": margins.max_complementary,
        "disk_margin": margins.disk_margin,
    }
    return {"status": "ok", "reason": "", "response": frame, "figures": found | told, "margins": told}


def _cost(found: Mapping[str, Any]) -> float:
    return float(found["figures"]["iae"]) if found["status"] == "ok" else math.inf


def _feasible(found: Mapping[str, Any]) -> bool:
    figures = found["figures"]
    return bool(
        found["status"] == "ok" and figures["ms"] <= LIMIT_MS and figures["overshoot_percent"] <= LIMIT_OVERSHOOT
    )


Entry = tuple[str, str, str, dict[str, float]]


def _rules() -> tuple[list[Entry], FirstOrder, RelayResult]:
    record = run_step_test(LinearProcess(TRUE.transfer_function(), PERIOD), period=PERIOD, duration=6.0, amplitude=1.0)
    model = fit_first_order(record)
    relay = run_relay_test(
        LinearProcess(TRUE.transfer_function(), PERIOD), period=PERIOD, amplitude=1.0, hysteresis=0.01, duration=60.0
    )
    ultimate = relay.ultimate_gain, relay.ultimate_period
    found = [
        ("Ziegler-Nichols step PI", "rule", "from the step test", ziegler_nichols_step(model, "PI")),
        ("Ziegler-Nichols ultimate PI", "rule", "from relay feedback", ziegler_nichols_ultimate(*ultimate, "PI")),
        ("SIMC", "rule", "from the step test, closed-loop time = dead time", simc(model)),
        ("AMIGO", "rule", "from the step test", amigo(model, "PI")),
        ("lambda", "rule", "from the step test, closed-loop time 0.3 s", lambda_tuning(model, 0.3, "PI")),
        (
            "largest ki, Ms 1.4",
            "shaped",
            "largest integral gain with Ms at most 1.4",
            maximize_integral_gain(model, max_sensitivity=1.4),
        ),
    ]
    return [(name, kind, how, {"kp": g.kp, "ki": g.ki, "kd": g.kd}) for name, kind, how, g in found], model, relay


def write_sample(
    folder: Path,
    *,
    vehicle: str = "unior",
    runs: int = 40,
    trials: int = 60,
    cells: tuple[int, int] = (13, 11),
    seed: int = 3,
) -> Path:
    """Tune, and write the result folder."""
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(seed)
    rules, model, relay = _rules()
    entries: list[Entry] = [("cautious", "baseline", "a third of the file's", {"kp": 0.46, "ki": 0.46, "kd": 0.0})]
    entries += [("published", "baseline", "the gains of the papers", {"kp": 100.0, "ki": 0.01, "kd": 10.0})]
    entries += rules

    # Search and map.
    draws = np.exp(rng.uniform(np.log([0.3, 0.2]), np.log([12.0, 30.0]), (trials, 2)))
    tried = [({"kp": kp, "ki": ki, "kd": 0.0}, evaluate({"kp": kp, "ki": ki})) for kp, ki in draws.tolist()]
    points = []
    for kp in np.geomspace(0.5, 30.0, cells[0]).tolist():
        for ki in np.geomspace(0.2, 200.0, cells[1]).tolist():
            one = evaluate({"kp": kp, "ki": ki})
            points.append({
                "kp": kp, "ki": ki, "cost": _cost(one), "ms": one["figures"].get("ms", math.nan),
                "stable": one["status"] == "ok", "feasible": _feasible(one),
            })  # fmt: skip
    good = [(_cost(one), number) for number, (_, one) in enumerate(tried) if _feasible(one)]
    number = min(good)[1]
    entries.append(("searched", "searched", f"trial {number} of {trials}, drawn at random", tried[number][0]))

    found = {name: evaluate(gains) for name, _, _, gains in entries}
    costs = {name: _cost(one) for name, one in found.items()}
    feasible = [name for name, one in found.items() if _feasible(one)]
    best = min(feasible, key=costs.__getitem__)
    best_rule = min((name for name, kind, *_ in entries if kind == "rule" and name in feasible), key=costs.__getitem__)

    # Monte Carlo, the same draws for each.
    draws = rng.uniform((0.8, 0.3, 0.0), (1.2, 1.0, 0.1), (runs, 3))
    rows, spread = [], {}
    names = list(dict.fromkeys(("cautious", "published", best_rule, best)))
    gains_of = {name: gains for name, _, _, gains in entries}
    for name in names:
        mine = []
        for run, (mass, friction, delay) in enumerate(draws.tolist()):
            plant = FirstOrder(TRUE.gain, TRUE.time_constant * mass, TRUE.delay + delay)
            one = evaluate(gains_of[name], plant)
            row = {"candidate": name, "run": run, "mass": mass, "friction": friction, "delay": delay}
            mine.append(row | one["figures"] | {"status": one["status"]})
        failures = sum(row["status"] != "ok" for row in mine)
        interval = binomtest(failures, runs).proportion_ci(0.95)
        figures = {}
        for figure in ("iae", "overshoot_percent", "settling_time", "ms"):
            values = np.array([row.get(figure, math.inf) for row in mine], dtype=float)
            middle, high = (float(value) for value in np.quantile(values, (0.5, 0.95), method="higher"))
            figures[figure] = {"median": _null(middle), "p95": _null(high), "worst": _null(float(values.max()))}
        spread[name] = {
            "figures": figures,
            "failures": failures,
            "failure_rate": failures / runs,
            "low": interval.low,
            "high": interval.high,
        }
        rows += mine

    responses = pd.concat(
        [one["response"].iloc[:400].assign(candidate=name) for name, one in found.items()], ignore_index=True
    )
    responses[["candidate", "t", "reference", "output", "effort"]].to_parquet(folder / "responses.parquet", index=False)
    rows_of = [
        {"number": k, **gains, **one["figures"], "cost": _cost(one), "feasible": _feasible(one)}
        | {"status": one["status"]}
        for k, (gains, one) in enumerate(tried)
    ]
    pd.DataFrame(rows_of).to_parquet(folder / "trials.parquet", index=False)
    pd.DataFrame(points).to_parquet(folder / "map.parquet", index=False)
    pd.DataFrame(rows).to_parquet(folder / "monte_carlo.parquet", index=False)
    curves = []
    for name, gains in gains_of.items():
        low, high = loop_range(_late(TRUE), _gains(gains))
        w = np.geomspace(max(low, 0.05), min(high, 300.0), 300)
        value = loop_response(_late(TRUE), _gains(gains))(w)
        curves.append(pd.DataFrame({"candidate": name, "omega": w, "re": value.real, "im": value.imag}))
    pd.concat(curves, ignore_index=True).to_parquet(folder / "frequency.parquet", index=False)

    base = found["cautious"]["figures"]
    chosen = found[best]["figures"]
    limits = [
        ("IAE over the baseline's", chosen["iae"] / base["iae"], 0.5),
        ("overshoot [%]", chosen["overshoot_percent"], LIMIT_OVERSHOOT),
        ("Ms", chosen["ms"], LIMIT_MS),
        ("failures of the Monte Carlo", spread[best]["failures"], 0),
    ]
    data = {
        "mirdrake": "tuning-result/1",
        "name": "textbook_wheel",
        "vehicle": vehicle,
        "spec": {
            "mirdrake": "tuning/1", "name": "textbook_wheel", "vehicle": vehicle, "loop": "wheel_speed",
            "cost": {"iae": 1.0}, "constraints": {"overshoot_percent": LIMIT_OVERSHOOT, "ms": LIMIT_MS}, "seed": seed,
        },
        "spec_sha256": "5d41402abc4b2a76b9719d911017c592ae5d41402abc4b2a76b9719d911017c5",
        "seed": seed,
        "versions": {"mirdrake": "0.1"},
        "loop": {
            "name": "wheel_speed", "reference": "wheel_speed_setpoint", "output": "driven wheels",
            "effort": "joint_torque", "output_unit": "rad/s", "effort_unit": "N m",
            "settings": {"wheel_speed.kind": "pid"},
            "gains": {
                "kp": {"unit": "N m s/rad", "path": "wheel_speed.kp"},
                "ki": {"unit": "N m/rad", "path": "wheel_speed.ki"},
                "kd": {"unit": "N m s²/rad", "path": "wheel_speed.kd"},
            },
        },
        "models": [
            {
                "name": "step test", "kind": "first order with delay", "fit_percent": 99.9, "note": "least squares",
                "parameters": {
                    "gain": [model.gain, "rad/(s N m)"], "time_constant": [model.time_constant, "s"],
                    "delay": [model.delay, "s"],
                },
            },
            {
                "name": "relay feedback", "kind": "ultimate point", "fit_percent": None, "note": "",
                "parameters": {
                    "ultimate_gain": [relay.ultimate_gain, "N m s/rad"],
                    "ultimate_period": [relay.ultimate_period, "s"],
                },
            },
        ],
        "candidates": [
            {
                "name": name, "kind": kind, "how": how, "gains": gains, "status": found[name]["status"],
                "figures": {key: _null(value) for key, value in found[name]["figures"].items()},
                "margins": found[name]["margins"] and {k: _null(v) for k, v in found[name]["margins"].items()},
                "cost": _null(costs[name]), "feasible": _feasible(found[name]), "reason": found[name]["reason"],
            }
            for name, kind, how, gains in entries
        ],
        "baseline": "cautious", "best": best, "best_rule": best_rule, "schedule": None,
        "robustness": {
            "runs": runs, "ranges": {"mass": [0.8, 1.2], "friction": [0.3, 1.0], "delay": [0.0, 0.1]},
            "candidates": spread,
        },
        "acceptance": [
            {"what": what, "value": value, "limit": limit, "met": bool(value <= limit)} for what, value, limit in limits
        ],
        "wall_s": 12.3,
    }  # fmt: skip
    (folder / "tuning.json").write_text(json.dumps(data, indent=1, allow_nan=False, ensure_ascii=False))
    return folder


def _null(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def result_data(vehicle: str) -> dict[str, Any]:
    """A short tuning.json: three candidates of the loop above, for tests that need no tables."""
    gains = {
        "cautious": ("baseline", 0.46, 0.46, 2.17, True),
        "lambda": ("rule", 1.42857, 1.42857, 1.0512, True),
        "searched": ("searched", 3.540818334574936, 2.749375385638452, 0.604600, True),
    }
    return {
        "mirdrake": "tuning-result/1",
        "name": "sample",
        "vehicle": vehicle,
        "spec_sha256": "0123456789abcdef" * 4,
        "loop": {
            "name": "wheel_speed", "output_unit": "rad/s", "effort_unit": "N m",
            "settings": {"wheel_speed.kind": "pid"},
            "gains": {
                name: {"unit": unit, "path": f"wheel_speed.{name}"}
                for name, unit in (("kp", "N m s/rad"), ("ki", "N m/rad"), ("kd", "N m s²/rad"))
            },
        },
        "candidates": [
            {
                "name": name, "kind": kind, "how": "", "gains": {"kp": kp, "ki": ki, "kd": 0.0},
                "figures": {"iae": cost}, "margins": None, "cost": cost, "feasible": feasible, "status": "ok",
                "reason": "",
            }
            for name, (kind, kp, ki, cost, feasible) in gains.items()
        ],
        "baseline": "cautious", "best": "searched", "best_rule": "lambda",
    }  # fmt: skip
