"""Margins of whole loops, cut at their effort: a cascade against its closed form, and the path against the plant."""

import math
from typing import Any

import numpy as np
import pytest

from mirdrake.tuning.designs import make_designs, slower_designs
from mirdrake.tuning.loops.base import Conditions
from mirdrake.tuning.loops.evaluate import LoopEvaluator, bench_of, loops_of
from mirdrake.tuning.loops.registry import LOOP_KINDS, make_loop_spec
from mirdrake.tuning.margins import margins_of
from mirdrake.tuning.spec import make_tuning

PERIOD, POLE, GAIN = 0.02, 0.96, 0.08

OWN = f"""\
from pydrake.systems.framework import LeafSystem


class Line(LeafSystem):
    '''A lag, and the integral of its output.'''

    def __init__(self):
        super().__init__()
        self.u, state = self.DeclareVectorInputPort("u", 1), self.DeclareDiscreteState(2)
        self.DeclareVectorOutputPort("speed", 1, lambda c, o: o.SetFromVector(self.at(c)[:1]), {{self.xd_ticket()}})
        self.DeclareVectorOutputPort("place", 1, lambda c, o: o.SetFromVector(self.at(c)[1:]), {{self.xd_ticket()}})
        self.DeclarePeriodicDiscreteUpdateEvent({PERIOD}, 0.0, self.update)

    def at(self, context):
        return context.get_discrete_state(0).value()

    def update(self, context, state):
        speed, place = self.at(context)
        state.set_value(0, [{POLE} * speed + {GAIN} * self.u.Eval(context)[0], place + {PERIOD} * speed])


class Step(LeafSystem):
    def __init__(self):
        super().__init__()
        self.DeclareVectorOutputPort("y", 1, lambda c, o: o.SetFromVector([float(c.get_time() >= 0.5)]))
"""

CASCADE = """\
world: empty
vehicles: {ego: {model: bolt}}
control: {ego: {kind: constant, speed: 0}}
plant: {contact: point, time_step: 0.02}
systems:
  step: {kind: "own_cascade:Step"}
  outer: {kind: pid, kp: 1.0, ki: 0.0, period: 0.02}
  inner: {kind: pid, kp: 2.0, ki: 1.0, period: 0.02}
  line: {kind: "own_cascade:Line"}
connect:
  - [step.y, outer.reference]
  - [line.place, outer.measurement]
  - [outer.control, inner.reference]
  - [line.speed, inner.measurement]
  - [inner.control, line.u]
"""


@pytest.fixture
def cascade(tmp_path):
    (tmp_path / "own_cascade.py").write_text(OWN, encoding="utf-8")
    (tmp_path / "cascade.yaml").write_text(CASCADE, encoding="utf-8")
    loop: dict[str, Any] = {
        "diagram": "cascade.yaml",
        "reference": "step.y",
        "output": "line.place",
        "effort": "inner.control",
    }
    loop["parameters"] = ["outer.kp", "inner.kp", "inner.ki"]
    return make_loop_spec(make_tuning({"loop": loop, "folder": str(tmp_path), "test": {"duration": 6.0}}))


def test_a_cascade_has_the_margins_of_its_closed_form_at_the_effort(cascade):
    # P(z) = b / (z - a) from the effort to the speed, T / (z - 1) from there to the place; the inner controller is
    # kp + ki T / (z - 1), of the error K (r - place) - speed. Controls are held: who reads one reads that of the period
    # before.
    gains = {"outer.kp": 1.5, "inner.kp": 3.0, "inner.ki": 2.0}

    def exact(w):
        z = np.exp(1j * np.asarray(w) * PERIOD)
        speed = GAIN / (z * (z - POLE))
        return (3.0 + 2.0 * PERIOD / (z - 1.0)) * speed * (1.0 + 1.5 * PERIOD / (z * (z - 1.0)))

    ((response, low, high),) = loops_of(cascade, gains)
    w = np.geomspace(0.05, high, 50)
    assert response(w) == pytest.approx(exact(w), rel=1e-4)
    expected = margins_of(exact, low, high)
    found = LoopEvaluator(cascade)(gains).figures
    assert found["ms"] == pytest.approx(expected.max_sensitivity, rel=1e-3)
    assert found["delay_margin_s"] == pytest.approx(expected.delay_margin, rel=1e-3)
    # The gain margin is that of the plant: a line of a larger gain is stable below it, and not above.
    assert expected.gain_margin == pytest.approx(found["gain_margin"], rel=1e-3)
    for part, status in ((0.9, "ok"), (1.1, "unstable")):
        factor = part * expected.gain_margin
        changed = gains | {name: factor * gains[name] for name in ("inner.kp", "inner.ki")}
        assert LoopEvaluator(cascade)(changed).status == status


def test_rules_give_a_cascade_its_gains_from_the_inside_to_the_outside(cascade):
    assert cascade.kind == "cascade"
    identified = bench_of(cascade).identify()
    # The inner loop is designed with the outer one open: b / (z (z - a)) is a lag of T / (1 - a) = 0.5 s and gain 2.
    inner, outer = (experiment.parameters for experiment in identified.experiments)
    assert inner["time_constant"].value == pytest.approx(PERIOD / (1.0 - POLE), rel=0.05)
    assert inner["gain"].value == pytest.approx(GAIN / (1.0 - POLE), rel=0.01)
    # The outer loop sees the inner one closed with kp = 2: an integrator of gain 2 kp / (1 + 2 kp), as its integral
    # part is slow.
    assert outer["gain"].value == pytest.approx(0.8, rel=0.05)
    designs = {design.name: design.gains for design in LOOP_KINDS["cascade"].designs(identified, 1.4)[0]}
    assert {"SIMC", "SIMC 2", "AMIGO PI", "shaped PI"} <= set(designs)
    for gains in (designs["SIMC 2"], designs["AMIGO PI"]):
        assert list(gains) == ["outer.kp", "inner.kp", "inner.ki"]
        result = LoopEvaluator(cascade)(gains)
        assert result.status == "ok"
        assert result.figures["ms"] < 2.0


def test_a_loop_of_a_diagram_has_no_delays_beyond_its_own():
    study = make_tuning({"vehicle": "bolt", "loop": "path"})
    assert all(LOOP_KINDS[kind].delays(study) == (0.0, 0.0) for kind in ("diagram", "block", "cascade", "path"))


def test_an_effort_that_is_no_output_has_no_margins(tmp_path, cascade):
    loop = {"diagram": str(tmp_path / "cascade.yaml"), "reference": "step.y", "output": "line.place"}
    loop["effort"] = "ego.steering_setpoint"
    parameters = {"parameters": ["outer.kp", "inner.kp"]}
    spec = make_loop_spec(make_tuning({"loop": loop | parameters, "folder": str(tmp_path)}))
    assert spec.period is None
    assert math.isnan(LoopEvaluator(spec)({"outer.kp": 1.0, "inner.kp": 2.0}).figures["ms"])


def test_a_loop_that_is_open_at_the_operating_point_has_no_margins_but_an_error():
    # At 0.5 s the Bolt begins its circle with the largest steering angle, so the command does not respond.
    loop = {
        "diagram": "bolt_skidpad",
        "reference": 0.0,
        "output": "ego.lateral_error",
        "effort": "ego.steering_command",
    }
    study = {"loop": loop | {"parameters": ["ego.driver.damping"]}, "test": {"duration": 3.0}}
    failed = LoopEvaluator(make_loop_spec(make_tuning(study)))({"ego.driver.damping": 1.0})
    assert failed.status == "failed"
    assert (
        "the loop is open at 0.5 s, where it is linearised: 'ego.steering_command' is at a limit there" in failed.reason
    )
    later = make_loop_spec(make_tuning(study | {"test": {"duration": 4.0, "step_time": 2.0}}))
    assert 1.0 < LoopEvaluator(later)({"ego.driver.damping": 1.0}).figures["ms"] < 10.0


@pytest.fixture(scope="module")
def path():
    return make_loop_spec(make_tuning({"vehicle": "bolt", "loop": "path", "test": {"duration": 6.0}}))


def test_rules_for_a_double_integrator_give_the_gains_of_a_path(path):
    identified = bench_of(path).identify()
    assert identified.inertial is not None
    gain, delay = identified.inertial
    # Half a period of the hold and one of the actuators' at least, a few more of the tyres at most.
    assert gain == 1.0
    assert delay == pytest.approx(0.03, abs=0.015)
    designs = {design.parameter or 0.0: design.gains for design in slower_designs(identified)}
    # SIMC without integral part: two equal poles at 1 / (2 (times + 1) delay).
    for times, gains in designs.items():
        assert gains["ego.driver.convergence_time"] == pytest.approx(2.0 * (times + 1.0) * delay, rel=1e-3)
        assert gains["ego.driver.damping"] == pytest.approx(1.0)
    assert {design.rule for design in make_designs(identified, max_sensitivity=1.4)[0]} == {"simc_inertia"}


def test_the_open_loop_of_a_path_is_a_double_integrator_with_a_pd_controller(path):
    time, damping = 0.8, 0.9
    ((response, *_),) = loops_of(path, {"ego.driver.convergence_time": time, "ego.driver.damping": damping})
    # Below 1 rad/s neither the tyres nor the actuators matter much.
    w = np.array([0.3, 0.6, 1.0])
    exact = (1.0 / time**2 + 2.0 * damping / time * 1j * w) / (1j * w) ** 2
    assert np.abs(response(w) / exact) == pytest.approx(1.0, abs=0.08)
    assert np.degrees(np.angle(response(w) / exact)) == pytest.approx(0.0, abs=6.0)


def test_a_path_is_stable_with_a_delay_within_its_margin_only(path):
    gains = {"ego.driver.convergence_time": 0.5, "ego.driver.damping": 1.0}
    evaluate = LoopEvaluator(path)
    margin = evaluate(gains).figures["delay_margin_s"]
    delays = [evaluate(gains, Conditions(delay=part * margin)) for part in (0.8, 1.3)]
    assert [result.status for result in delays] == ["ok", "unstable"]
