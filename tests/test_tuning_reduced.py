"""The reduced model of a loop: its compiled test, resonances, rolling radii, and the screening of the Monte Carlo."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from mirdrake.core.compiled import compiled, records
from mirdrake.core.pid import PidGains, PidLimits
from mirdrake.tuning import LinearProcess, TransferFunction, simulate_loop
from mirdrake.tuning.designs import Design
from mirdrake.tuning.frequency_response import FrequencyResponse
from mirdrake.tuning.identify import fit_factors, fit_response, slow_model
from mirdrake.tuning.loops.base import NOMINAL, Conditions, Evaluation, LoopModel, LoopSpec, OuterLoop
from mirdrake.tuning.loops.evaluate import plant_bench
from mirdrake.tuning.loops.reduced import loop_plants
from mirdrake.tuning.loops.reduced_kernel import KERNEL_PARTS, RunNumbers, simulate_test
from mirdrake.tuning.loops.registry import make_loop_spec
from mirdrake.tuning.loops.speed import radius_per_mass
from mirdrake.tuning.process_models import discrete_matrices
from mirdrake.tuning.screening import COST, SAMPLE, WORST, InRuns, check_ranks, choose_runs, is_decided
from mirdrake.tuning.spec import load_tuning
from mirdrake.tuning.stages import Candidate, Stages
from mirdrake.tuning.trials import Trial

ROOT = Path(__file__).parents[1]
PERIOD = 0.02
LAGGED = TransferFunction((3.0,), (0.2, 1.0, 0.0), 0.047)
GAINS = PidGains(1.1, 0.6, 0.05, filter_time=0.04)


@pytest.fixture(scope="module")
def bolt() -> LoopSpec:
    return make_loop_spec(load_tuning(ROOT / "studies/bolt_speed.yaml"))


def run(plant: TransferFunction, wanted: Any, *, machine_code: bool = True, **changes: Any) -> tuple[Any, Any]:
    """Return outputs and efforts of the compiled test, or of its source in Python."""
    parts, count, inputs = discrete_matrices(plant, PERIOD), len(wanted), {}
    output_row = changes.pop("output_row", parts.row)
    for name in ("feedforward", "loads", "resistances", "noise"):
        inputs[name] = changes.pop(name, np.zeros(count))
    numbers = RunNumbers(
        PERIOD, parts.whole, parts.through, scale=1.0, start=0.0, radius=1.0, is_output=True, outer=False,
        pid=GAINS.numbers(), limits=PidLimits(), outer_pid=PidGains(0.0).numbers(),
        outer_limits=PidLimits(),
    )._replace(**changes)  # fmt: skip
    outputs, efforts = np.zeros(count), np.zeros(count)
    function: Callable[..., Any] = compiled(simulate_test, parts=KERNEL_PARTS) if machine_code else simulate_test
    stable = function(
        records(RunNumbers, [numbers]).view(np.recarray), parts.step, parts.old, parts.new, parts.held, parts.row,
        output_row, wanted, *inputs.values(), outputs, efforts,
    )  # fmt: skip
    assert stable
    return outputs, efforts


def test_the_compiled_test_is_the_simulation_of_its_loop() -> None:
    wanted = np.where(np.arange(300) >= 10, 1.0, 0.0)
    outputs, efforts = run(LAGGED, wanted)
    other = simulate_loop(LinearProcess(LAGGED, PERIOD), GAINS, period=PERIOD, reference=wanted)
    assert outputs == pytest.approx(other.measurement, abs=1e-12)
    # A dead time of 2.35 periods: the control acts in the third period after its own.
    assert efforts[3:] == pytest.approx(other.control[:-3], abs=1e-12)


def test_machine_code_gives_the_numbers_of_its_source() -> None:
    wanted, noise = np.linspace(0.0, 1.0, 200), np.random.default_rng(1).normal(0.0, 0.01, 200)
    changes = {
        "noise": noise,
        "outer": True,
        "outer_pid": PidGains(1.0, 0.8).numbers(),
        "radius": 1.01,
        "is_output": False,
    }
    first, second = (run(LAGGED, wanted, machine_code=fast, **changes) for fast in (True, False))
    assert np.array_equal(first, second)


def test_loads_act_without_the_dead_time_and_resistances_are_no_effort() -> None:
    inertia, idle = TransferFunction((1.0 / 4.0,), (1.0, 0.0), 0.1), PidGains(0.0).numbers()
    t = np.arange(100) * PERIOD
    outputs, efforts = run(inertia, np.zeros(100), pid=idle, loads=np.full(100, 3.0), resistances=np.full(100, -1.0))
    assert outputs == pytest.approx(0.25 * 2.0 * t, abs=1e-12)
    assert efforts[1:] == pytest.approx(3.0)


def test_factors_are_found_only_in_data_that_have_them() -> None:
    omega = np.geomspace(0.5, 60.0, 24)
    plain, below = TransferFunction((2.0,), (1.0, 0.01), 0.06), (1.0, 12.0, 480.0)
    one = TransferFunction((1.0,), (1.0,))
    # The measurement lags behind the output, as the wheels of a car whose front is lifted when it accelerates.
    car = (TransferFunction((0.4, 2.0, 480.0), below), TransferFunction((1.2, 14.4, 480.0), below))
    for known in (car, (one, one)):
        responses = []
        for number, factor in enumerate(known):
            values = (plain * factor).response(omega)
            # Errors of half a percent, as of a plant that is not quite linear.
            values = values * (1.0 + 0.005 * np.random.default_rng(number).normal(size=24))
            responses.append(FrequencyResponse(omega, values, 0.005 * np.abs(values)))
        first, _ = fit_response(responses[1], (1.0, 2.0, 0.05), order=1)
        main, found = fit_factors(responses, first)
        for true, factor in zip(known, found, strict=True):
            assert (main * factor).response(omega) == pytest.approx((plain * true).response(omega), rel=0.03)
            assert (len(factor.denominator) == 3) == (known is car)
        assert main.delay == pytest.approx(0.06, abs=0.002)


def test_the_slow_model_has_the_phase_of_the_factor_at_low_frequencies() -> None:
    plain, factor = TransferFunction((2.0,), (1.0, 0.01), 0.06), TransferFunction((0.4, 2.0, 480.0), (1.0, 12.0, 480.0))
    slow, omega = slow_model(plain, factor), np.array([0.5, 1.0])
    assert slow.delay == pytest.approx(0.06 + 10.0 / 480.0)
    assert slow.response(omega) == pytest.approx((plain * factor).response(omega), rel=2e-3)
    # A lead of 21 ms does not shorten the dead time.
    lead = TransferFunction((1.0, 22.0, 480.0), (1.0, 12.0, 480.0))
    assert slow_model(plain, lead).delay == 0.06


def test_the_plant_of_the_controller_has_measurement_and_output(bolt: LoopSpec) -> None:
    below = (1.0, 12.0, 480.0)
    model = LoopModel(
        {"main": LAGGED},
        measured=TransferFunction((0.4, 2.0, 480.0), below),
        output=TransferFunction((1.2, 14.4, 480.0), below),
        outer=OuterLoop(1.5, 0.7, 2.0),
    )
    s = 1j * (omega := np.array([0.3, 2.0, 9.0, 30.0]))
    measured, output = model.to_measurement(LAGGED).response(omega), model.to_output(LAGGED).response(omega)
    seen = loop_plants(replace(bolt, model=model))["main"].response(omega)
    assert seen == pytest.approx(measured + (1.5 + 0.7 / s) * output, rel=1e-9)


def test_the_rolling_radius_of_a_coulomb_tyre_does_not_depend_on_its_load(bolt: LoopSpec) -> None:
    # It is the height of the axle at rest; a tyre compressed by a fifth more load would lose 7 % per unit of mass.
    assert radius_per_mass(plant_bench(bolt), 26.0) == pytest.approx(0.0, abs=1e-3)


def rows_of(costs: Any, *, status: Any = None) -> pd.DataFrame:
    count = len(costs)
    given = ["ok"] * count if status is None else status
    return pd.DataFrame({"run": range(count), "iae": costs, "peak_effort": 1.0, "status": given})


def test_the_plant_makes_runs_of_long_delay_little_friction_and_large_cost_per_step() -> None:
    draws = [Conditions(delay=0.05, friction=0.8, step=1.0) for _ in range(60)]
    draws = [replace(draw, seed=number) for number, draw in enumerate(draws)]
    draws[20], draws[30] = replace(draws[20], delay=0.1), replace(draws[30], friction=0.3)
    draws[41] = replace(draws[41], step=2.0)
    costs = np.linspace(1.0, 1.1, 60)
    costs[40], costs[41] = 3.0, 2.0  # the latter is 1 per step, the smallest
    status = ["ok"] * 60
    status[50] = "unstable"
    chosen = choose_runs(rows_of(costs, status=status), draws, {"iae": 1.0})
    assert {20, 30, 40, 50} <= chosen
    assert 41 not in chosen
    assert len(chosen) < 24
    grip = np.where(np.arange(60) == 43, 0.1, 1.0)
    assert 43 in choose_runs(rows_of(costs), draws, {"iae": 1.0}, grip=grip)


def test_a_model_that_ranks_the_runs_differently_is_not_trusted() -> None:
    costs = np.random.default_rng(0).random(30)
    plant = rows_of(1.2 * costs + 0.01 * np.sin(40.0 * costs))
    assert check_ranks(rows_of(costs), plant, {"iae": 1.0}).is_trusted
    assert not check_ranks(rows_of(costs[::-1]), plant, {"iae": 1.0}).is_trusted
    assert not check_ranks(rows_of(np.ones(30)), plant, {"iae": 1.0}).is_trusted
    lost = ["unstable", *["ok"] * 29]
    # A model that fails where the plant does not is wrong; a candidate that fails on the plant is rejected anyway.
    assert not check_ranks(rows_of(costs, status=lost), plant, {"iae": 1.0}).is_trusted
    assert check_ranks(rows_of(costs[::-1]), rows_of(costs, status=lost), {"iae": 1.0}).is_trusted


def test_runs_of_which_none_is_stable_need_no_figures() -> None:
    lost = pd.DataFrame({"run": range(30), "status": "unstable"})
    draws = [Conditions(delay=0.05, friction=0.8, seed=number) for number in range(30)]
    assert len(choose_runs(lost, draws, {"iae": 1.0}, grip=np.ones(30))) >= WORST
    assert check_ranks(lost, lost, {"iae": 1.0}).is_trusted  # it fails on the plant as well


def test_gains_are_ranked_by_their_mean_cost_in_the_test_and_in_runs() -> None:
    @dataclass(frozen=True)
    class Loop:
        """The cost of the plant is twice that of the model, and grows with the delay; gain 9 fails in a run."""

        def __call__(
            self, gains: Mapping[str, float], conditions: Conditions = NOMINAL, fidelity: str = "plant"
        ) -> Evaluation:
            if gains["kp"] == 9.0 and conditions.delay:
                return Evaluation("unstable")
            cost = (1.0 + 10.0 * (conditions.delay or 0.0)) / gains["kp"]
            return Evaluation("ok", {"iae": 2.0 * cost if fidelity == "plant" else cost})

    test = InRuns(Loop(), (Conditions(delay=0.1), Conditions(delay=0.3)), {"iae": 1.0})
    # Costs 1, 2 and 4 on the model: the mean is 7/3 of that in the test.
    assert test({"kp": 1.0}).figures == pytest.approx({"iae": 2.0, COST: 2.0 * 7.0 / 3.0})
    assert test({"kp": 1.0}, fidelity="reduced").figures == pytest.approx({"iae": 1.0, COST: 7.0 / 3.0})
    assert COST not in test({"kp": 1.0}, Conditions(delay=0.1)).figures
    assert test({"kp": 9.0}).figures[COST] == math.inf


def test_a_median_is_decided_by_the_sign_test() -> None:
    assert is_decided(np.full(6, 0.9))
    assert not is_decided(np.full(5, 0.9))  # 2 / 2⁵ = 0.06
    assert is_decided(np.array([0.9] * 10 + [1.1] * 2))
    assert not is_decided(np.array([0.9] * 9 + [1.1] * 3))
    assert not is_decided(np.ones(12))


@dataclass(frozen=True)
class Costs:
    """Costs by the draw: those of the plant are 1.2 times those of the model, or not related to them."""

    spec: LoopSpec
    keep: bool = False
    made = {"plant": 0, "reduced": 0}  # noqa: RUF012

    def __call__(
        self, gains: Mapping[str, float], conditions: Conditions = NOMINAL, fidelity: str = "plant"
    ) -> Evaluation:
        Costs.made[fidelity] += 1
        cost = (1.0 + conditions.mass * conditions.step) / gains.get("kp", 0.5)
        if fidelity == "plant":
            cost *= 1.2 if gains.get("ki", 1.0) else 1.0 + 3.0 * (conditions.seed % 7)
        return Evaluation("ok", {"iae": cost, "peak_effort": 1.0})


def test_the_plant_makes_a_part_of_the_runs_if_the_model_ranks_them(
    bolt: LoopSpec, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mirdrake.tuning.stages.LoopEvaluator", Costs)
    monkeypatch.setattr(Stages, "_grip", None)
    spec = load_tuning(ROOT / "studies/bolt_speed.yaml")
    stages = Stages(spec, replace(bolt, model=LoopModel({"main": LAGGED})), tmp_path, "key", None, 0, lambda *_: None)
    trial = Trial(0, {}, "ok", {}, 1.0, 0.0)

    def made(name: str, **gains: float) -> Candidate:
        return Candidate(Design(name, "rule", gains), trial)

    good, servo, wrong = made("good", kp=2.0, ki=1.0), made("servo"), made("wrong", kp=1.0, ki=0.0)
    runs = stages.monte_carlo([good, servo], pairs=[("good", "servo")])
    assert runs is not None
    assert Costs.made["reduced"] == 100
    assert Costs.made["plant"] < 50
    rows = runs.rows("good")
    assert list(rows["run"]) == list(range(100))
    assert set(rows["fidelity"]) == {"plant", "reduced"}
    assert runs.correlation["good"] == pytest.approx(1.0)
    # The present servo has no model: the plant makes the sample, which decides the median.
    assert list(runs.rows("servo")["run"]) == list(range(SAMPLE))
    assert runs.median_ratio("good", "servo", {"iae": 1.0}) == pytest.approx(0.25)
    other = stages.monte_carlo([wrong])
    assert other is not None
    assert set(other.rows("wrong")["fidelity"]) == {"plant"}
    assert len(other.rows("wrong")) == 100
