"""Loops of a user's diagram around a pid block: models, rules and margins, against closed forms."""

import math

import numpy as np
import pytest

from mirdrake.tuning.designs import make_designs
from mirdrake.tuning.loops.base import Conditions
from mirdrake.tuning.loops.evaluate import LoopEvaluator, bench_of
from mirdrake.tuning.loops.reduced import find_loop_margins
from mirdrake.tuning.loops.registry import make_loop_spec
from mirdrake.tuning.models import FirstOrder
from mirdrake.tuning.spec import make_tuning
from mirdrake.tuning.tune import tune

pytest.importorskip("control")

PERIOD, GAIN, TIME_CONSTANT = 0.02, 2.0, 0.5
POLE = math.exp(-PERIOD / TIME_CONSTANT)
B = GAIN * (1.0 - POLE)

OWN_LAG = f"""\
from pydrake.systems.framework import LeafSystem


class Lag(LeafSystem):
    def __init__(self):
        super().__init__()
        self.u, state = self.DeclareVectorInputPort("u", 1), self.DeclareDiscreteState(1)
        self.DeclareStateOutputPort("y", state)
        self.DeclarePeriodicDiscreteUpdateEvent({PERIOD}, 0.0, self.update)

    def update(self, context, state):
        x = context.get_discrete_state(0).value()[0]
        state.set_value(0, [{POLE!r} * x + {B!r} * self.u.Eval(context)[0]])


class Step(LeafSystem):
    def __init__(self):
        super().__init__()
        self.DeclareVectorOutputPort("y", 1, lambda c, o: o.SetFromVector([float(c.get_time() >= 0.5)]))
"""

DIAGRAM = """\
world: empty
vehicles: {ego: {model: bolt}}
control: {ego: {kind: constant, speed: 0}}
plant: {contact: point, time_step: 0.02}
systems:
  step: {kind: "own_pid_block_lag:Step"}
  pid: {kind: pid, kp: 0.5, ki: 0.5, period: 0.02}
  lag: {kind: "own_pid_block_lag:Lag"}
connect:
  - [step.y, pid.reference]
  - [lag.y, pid.measurement]
  - [pid.control, lag.u]
"""

PARAMETERS = ["pid.kp", "pid.ki"]


@pytest.fixture
def study(tmp_path):
    (tmp_path / "own_pid_block_lag.py").write_text(OWN_LAG, encoding="utf-8")
    (tmp_path / "loop.yaml").write_text(DIAGRAM, encoding="utf-8")

    def make(**more):
        loop = {"diagram": "loop.yaml", "reference": "step.y", "output": "lag.y", "effort": "pid.control"}
        data = {"loop": loop | {"parameters": PARAMETERS}, "folder": str(tmp_path), "test": {"duration": 4.0}}
        return make_tuning(data | more)

    return make


def test_margins_are_those_of_the_closed_form(study):
    # The lag reads the control of the period before: P(z) = b / (z (z - a)). With ki T / kp = 1 - a the zero of the
    # controller cancels the pole a: L = kp b / (z (z - 1)), |L| = kp b / (2 sin(wT/2)), arg L = -90° - 1.5 wT.
    kp = 2.0
    gains = {"pid.kp": kp, "pid.ki": kp * (1.0 - POLE) / PERIOD}
    identified = bench_of(make_loop_spec(study())).identify()
    margins = find_loop_margins(identified.loop, gains)
    crossover = 2.0 / PERIOD * math.asin(0.5 * kp * B)
    phase = 0.5 * math.pi - 1.5 * crossover * PERIOD
    assert margins["phase_margin_deg"] == pytest.approx(math.degrees(phase), rel=1e-3)
    assert margins["delay_margin_s"] == pytest.approx(phase / crossover, rel=1e-3)
    assert margins["gain_margin"] == pytest.approx(1.0 / (kp * B), rel=1e-3)  # 1.5 wT = 90°, sin(wT/2) = 1/2
    w = np.geomspace(0.01, 0.99 * math.pi / PERIOD, 20_000)
    z = np.exp(1j * w * PERIOD)
    assert margins["ms"] == pytest.approx(np.abs(1.0 / (1.0 + kp * B / (z * (z - 1.0)))).max(), rel=1e-3)


def test_the_model_is_that_of_the_users_system_and_all_rules_apply(study):
    identified = bench_of(make_loop_spec(study())).identify()
    assert isinstance(identified.first, FirstOrder)
    assert identified.first.gain == pytest.approx(GAIN, rel=0.01)
    assert identified.first.time_constant == pytest.approx(TIME_CONSTANT, rel=0.05)
    assert identified.first.delay == pytest.approx(PERIOD, rel=0.1)
    designs, _ = make_designs(identified, max_sensitivity=1.6)
    names = " ".join(design.name for design in designs)
    assert all(rule in names for rule in ("SIMC", "lambda", "AMIGO PI", "Ziegler-Nichols step PI", "shaped PI"))
    assert all(set(design.gains) == set(PARAMETERS) for design in designs)


def test_a_delay_in_the_margin_is_stable_on_the_plant_and_a_longer_one_is_not(study):
    kp = 8.0  # delay margin of 0.02 s
    gains = {"pid.kp": kp, "pid.ki": kp * (1.0 - POLE) / PERIOD}
    identified = bench_of(make_loop_spec(study())).identify()
    margin = find_loop_margins(identified.loop, gains)["delay_margin_s"]
    evaluate = LoopEvaluator(identified.loop)
    assert evaluate(gains, Conditions(delay=0.8 * margin)).status == "ok"
    assert evaluate(gains, Conditions(delay=1.3 * margin)).status == "unstable"


def test_a_loop_of_signals_that_is_no_pid_loop_has_no_model(study):
    loop = {"diagram": "loop.yaml", "reference": "step.y", "output": "lag.y", "effort": "pid.control"}
    assert make_loop_spec(study(loop=loop | {"parameters": ["pid.kp"]})).kind == "diagram"
    assert make_loop_spec(study()).kind == "pid_block"


@pytest.mark.slow
def test_a_study_of_such_a_loop_has_rules_margins_and_a_robust_winner(study, tmp_path):
    spec = study(
        search={"trials": 6, "confirm": 3}, robustness={"runs": 4, "delay": [0.0, 0.04]}, constraints={"ms": 1.6}
    )
    result = tune(spec, out=tmp_path / "out")
    best = next(candidate for candidate in result.candidates if candidate.name == result.best)
    assert result.best_rule is not None
    assert best.figures["ms"] <= 1.6
    assert best.figures["delay_margin_s"] >= 1.5 * 0.04
    assert {check.name for check in best.margins} <= {"gain_margin", "delay_margin_s"}
    assert all(0.9 <= check.ratio <= 1.0 for check in best.margins)  # at the margin itself the loop oscillates
