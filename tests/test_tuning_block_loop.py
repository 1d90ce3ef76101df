"""Loops of a user's diagram around a block of any class: models, rules and margins, against closed forms."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import mirdrake as mir
from mirdrake.assembly.diagram import assemble
from mirdrake.core.errors import ConfigError
from mirdrake.core.pid import NO_LIMITS, PidLimits
from mirdrake.report.tuning import write_tuning_report
from mirdrake.runs.simulation import Simulation
from mirdrake.tuning.designs import make_designs
from mirdrake.tuning.loops.base import Conditions
from mirdrake.tuning.loops.controller_block import ControllerBlock
from mirdrake.tuning.loops.evaluate import LoopEvaluator, bench_of
from mirdrake.tuning.loops.reduced import find_loop_margins
from mirdrake.tuning.loops.registry import make_loop_spec
from mirdrake.tuning.loops.signals import SignalBench
from mirdrake.tuning.margins import margins_of
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

PID_LOOP = {"diagram": "loop.yaml", "reference": "step.y", "output": "lag.y", "effort": "pid.control"}
PARAMETERS = ["pid.kp", "pid.ki"]

OWN_CONTROLLERS = """\
from pydrake.common.value import Value
from pydrake.systems.framework import LeafSystem


class Pi(LeafSystem):
    \"\"\"Control held between updates, of an error that is computed outside.\"\"\"

    def __init__(self, gain, reset=0.0, period=0.02):
        super().__init__()
        self.gain, self.reset, self.period = gain, reset, period
        self.DeclareVectorInputPort("error", 1)
        self.DeclareDiscreteState(2)
        self.DeclareVectorOutputPort("u", 1, self.calc, prerequisites_of_calc={self.xd_ticket()})
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self.update)

    def calc(self, context, output):
        output[0] = context.get_discrete_state(0).value()[0]

    def update(self, context, state):
        error, integral = self.get_input_port(0).Eval(context)[0], context.get_discrete_state(0).value()[1]
        state.set_value(0, [self.gain * error + integral, integral + self.reset * self.period * error])


class Continuous(LeafSystem):
    \"\"\"Continuous state, and one input for reference and measurement.\"\"\"

    def __init__(self, bandwidth=1.0):
        super().__init__()
        self.bandwidth = bandwidth
        self.DeclareVectorInputPort("both", 2)
        self.DeclareContinuousState(1)
        self.DeclareVectorOutputPort("u", 1, self.calc)

    def error(self, context):
        reference, measurement = self.get_input_port(0).Eval(context)
        return reference - measurement

    def DoCalcTimeDerivatives(self, context, derivatives):
        derivatives.get_mutable_vector().SetFromVector([self.bandwidth * self.error(context)])

    def calc(self, context, output):
        output[0] = 0.25 * self.bandwidth * self.error(context) + 0.5 * context.get_continuous_state_vector()[0]


class Speed(LeafSystem):
    \"\"\"In place of the speed PID: an output function of inputs and state.\"\"\"

    def __init__(self, p=1.0, i=0.5, period=0.02):
        super().__init__()
        self.p, self.i, self.period = p, i, period
        self.reference, self.measurement = (self.DeclareVectorInputPort(n, 1) for n in ("reference", "measurement"))
        self.DeclareDiscreteState(1)
        self.DeclareVectorOutputPort("output", 1, self.calc)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self.update)

    def error(self, context):
        return self.reference.Eval(context)[0] - self.measurement.Eval(context)[0]

    def calc(self, context, output):
        output[0] = self.p * self.error(context) + context.get_discrete_state(0).value()[0]

    def update(self, context, state):
        state.set_value(0, [context.get_discrete_state(0).value()[0] + self.i * self.period * self.error(context)])


class Remembers(LeafSystem):
    def __init__(self, gain=1.0):
        super().__init__()
        self.DeclareAbstractState(Value(""))
"""

OWN_PI = """\
  own: {kind: "own_controllers:Pi", gain: 0.5, reset: 0.5}
  minus: {kind: gain, gain: -1}
  error: {kind: adder}
connect:
  - [step.y, error.u0]
  - [lag.y, minus.u]
  - [minus.y, error.u1]
  - [error.sum, own.error]
  - [own.u, lag.u]
"""

OWN_CONTINUOUS = """\
  own: {kind: "own_controllers:Continuous"}
  both: {kind: "pydrake.systems.primitives:Multiplexer", num_scalar_inputs: 2}
connect:
  - [step.y, both.u0]
  - [lag.y, both.u1]
  - [both.y, own.both]
  - [own.u, lag.u]
"""

OWN_SPEED = """\
world: empty
vehicles: {ego: {model: bolt, speed: 3}}
control: {ego: {kind: schedule, rows: [{time: 0, speed: 3}, {time: 2, speed: 5}]}}
plant: {contact: point}
systems:
  ego.control.speed_pid: {kind: "own_controllers:Speed", p: 0.8}
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("loops")
    (folder / "own_pid_block_lag.py").write_text(OWN_LAG, encoding="utf-8")
    (folder / "own_controllers.py").write_text(OWN_CONTROLLERS, encoding="utf-8")
    (folder / "loop.yaml").write_text(DIAGRAM, encoding="utf-8")
    head = DIAGRAM.split("  pid:")[0] + '  lag: {kind: "own_pid_block_lag:Lag"}\n'
    (folder / "own.yaml").write_text(head + OWN_PI, encoding="utf-8")
    (folder / "continuous.yaml").write_text(head + OWN_CONTINUOUS, encoding="utf-8")
    (folder / "speed.yaml").write_text(OWN_SPEED, encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def study(folder):
    def make(**more):
        data = {"loop": PID_LOOP | {"parameters": PARAMETERS}, "folder": str(folder), "test": {"duration": 4.0}}
        return make_tuning(data | more)

    return make


@pytest.fixture(scope="module")
def pid_loop(study):
    return bench_of(make_loop_spec(study())).identify()


def test_margins_are_those_of_the_closed_form(pid_loop):
    # The lag reads the control of the period before: P(z) = b / (z (z - a)). With ki T / kp = 1 - a the zero of the
    # controller cancels the pole a: L = kp b / (z (z - 1)), |L| = kp b / (2 sin(wT/2)), arg L = -90° - 1.5 wT.
    kp = 2.0
    gains = {"pid.kp": kp, "pid.ki": kp * (1.0 - POLE) / PERIOD}
    margins = find_loop_margins(pid_loop.loop, gains)
    crossover = 2.0 / PERIOD * math.asin(0.5 * kp * B)
    phase = 0.5 * math.pi - 1.5 * crossover * PERIOD
    assert margins["phase_margin_deg"] == pytest.approx(math.degrees(phase), rel=1e-3)
    assert margins["delay_margin_s"] == pytest.approx(phase / crossover, rel=1e-3)
    assert margins["gain_margin"] == pytest.approx(1.0 / (kp * B), rel=1e-3)  # 1.5 wT = 90°, sin(wT/2) = 1/2
    w = np.geomspace(0.01, 0.99 * math.pi / PERIOD, 20_000)
    z = np.exp(1j * w * PERIOD)
    assert margins["ms"] == pytest.approx(np.abs(1.0 / (1.0 + kp * B / (z * (z - 1.0)))).max(), rel=1e-3)


def test_the_model_is_that_of_the_users_system_and_all_rules_apply(pid_loop):
    assert isinstance(pid_loop.first, FirstOrder)
    assert pid_loop.first.gain == pytest.approx(GAIN, rel=0.01)
    assert pid_loop.first.time_constant == pytest.approx(TIME_CONSTANT, rel=0.05)
    assert pid_loop.first.delay == pytest.approx(PERIOD, rel=0.1)
    designs, _ = make_designs(pid_loop, max_sensitivity=1.6)
    names = " ".join(design.name for design in designs)
    assert all(rule in names for rule in ("SIMC", "lambda", "AMIGO PI", "Ziegler-Nichols step PI", "shaped PI"))
    assert all(set(design.gains) == set(PARAMETERS) for design in designs)


def test_the_limits_of_the_effort_are_those_of_its_block(pid_loop):
    loop = pid_loop.loop
    assert bench_of(loop).limits == NO_LIMITS
    tuned = loop.diagram["systems"]["pid"]
    limited = {**tuned, "entry": {**tuned["entry"], "minimum": -2.0, "maximum": 0.8}}
    loop = replace(loop, diagram={**loop.diagram, "systems": {**loop.diagram["systems"], "pid": limited}})
    assert bench_of(loop).limits == PidLimits(-2.0, 0.8)
    # The proportional part is at the limit until the error of the first-order lag is 0.4: 1 - 1.6 (1 - e^(-t/T)).
    result = LoopEvaluator(loop)({"pid.kp": 2.0, "pid.ki": 0.0})
    assert result.figures["saturation_time"] == pytest.approx(
        -TIME_CONSTANT * math.log(1.0 - 0.6 / 1.6), abs=2.0 * PERIOD
    )


def test_a_delay_in_the_margin_is_stable_on_the_plant_and_a_longer_one_is_not(pid_loop):
    kp = 8.0  # delay margin of 0.02 s
    gains = {"pid.kp": kp, "pid.ki": kp * (1.0 - POLE) / PERIOD}
    margin = find_loop_margins(pid_loop.loop, gains)["delay_margin_s"]
    evaluate = LoopEvaluator(pid_loop.loop)
    assert evaluate(gains, Conditions(delay=0.8 * margin)).status == "ok"
    assert evaluate(gains, Conditions(delay=1.3 * margin)).status == "unstable"


def own(name, parameters, **more):
    return {
        "diagram": name,
        "reference": "step.y",
        "output": "lag.y",
        "effort": "own.u",
        "parameters": parameters,
    } | more


def test_a_class_of_the_user_has_rules_and_margins_and_the_plant_has_them_too(study):
    loop = own("own.yaml", ["own.gain", "own.reset"], roles={"own.gain": "kp", "own.reset": "ki"})
    identified = bench_of(make_loop_spec(study(loop=loop))).identify()
    kp = 2.0
    gains = {"own.gain": kp, "own.reset": kp * (1.0 - POLE) / PERIOD}
    margins = find_loop_margins(identified.loop, gains)
    crossover = 2.0 / PERIOD * math.asin(0.5 * kp * B)  # L as with the pid block, see above
    assert margins["gain_margin"] == pytest.approx(1.0 / (kp * B), rel=1e-5)
    assert margins["phase_margin_deg"] == pytest.approx(90.0 - math.degrees(1.5 * crossover * PERIOD), rel=1e-4)
    designs, _ = make_designs(identified, max_sensitivity=1.6)
    assert {"SIMC", "AMIGO PI", "shaped PI"} <= {design.name for design in designs}
    evaluate = LoopEvaluator(identified.loop)
    for factor, status in ((0.95, "ok"), (1.05, "unstable")):
        scaled = {name: factor * margins["gain_margin"] * value for name, value in gains.items()}
        assert evaluate(scaled).status == status


def test_a_continuous_controller_of_one_parameter_has_margins_but_no_rules(study):
    loop = make_loop_spec(study(loop=own("continuous.yaml", ["own.bandwidth"])))
    assert loop.present == {"own.bandwidth": 1.0}  # the default of the class
    identified = bench_of(loop).identify()
    assert make_designs(identified, max_sensitivity=1.6) == ((), ())
    found, bandwidth = find_loop_margins(identified.loop, {"own.bandwidth": 6.0}), 6.0

    def response(w):
        # Sampled and held: C(z) = b / 4 + b T / (2 (z - 1)); the lag reads the control of the same period.
        z = np.exp(1j * w * PERIOD)
        return bandwidth * (0.25 + 0.5 * PERIOD / (z - 1.0)) * B / (z - POLE)

    exact = margins_of(response, 0.02, 0.99 * math.pi / PERIOD)
    assert found["ms"] == pytest.approx(exact.max_sensitivity, rel=1e-4)
    assert math.radians(found["phase_margin_deg"]) == pytest.approx(exact.phase_margin, rel=1e-4)


def test_a_tuned_block_does_not_change_the_run(study, folder):
    loop = make_loop_spec(study(loop=own("own.yaml", ["own.gain", "own.reset"])))
    tuned = SignalBench(loop).simulation.run(duration=1.0).signals
    plain = Simulation(assemble(str(folder / "own.yaml"))).run(duration=1.0).signals
    assert list(tuned) == list(plain)
    assert np.array_equal(tuned.to_numpy(), plain.to_numpy(), equal_nan=True)


def test_a_system_with_abstract_state_cannot_be_tuned(folder):
    with pytest.raises(ConfigError, match="own_controllers:Remembers cannot be tuned: it has abstract state"):
        ControllerBlock({"kind": "own_controllers:Remembers"}, {"gain": 1.0}, str(folder))


@pytest.mark.slow
def test_a_class_in_place_of_the_speed_pid_has_the_margins_of_the_whole_linear_model(study, folder):
    names = [f"ego.control.speed_pid.{name}" for name in ("p", "i")]
    loop: dict[str, Any] = {
        "diagram": "speed.yaml",
        "reference": "ego.speed_setpoint",
        "output": "ego.vx",
        "parameters": names,
    }
    loop |= {"effort": "ego.control.speed_pid.output", "roles": dict(zip(names, ("kp", "ki"), strict=True))}
    test = {"duration": 5.0, "step_time": 2.0, "step": 2.0}
    identified = bench_of(make_loop_spec(study(loop=loop, test=test))).identify()
    found = find_loop_margins(identified.loop, identified.loop.present)
    # The independent computation: cut by a probe between measurement and block, in the diagram of the file.
    whole = mir.Diagram.load(str(folder / "speed.yaml")).linearize("ego.control.speed_pid.measurement", time=2.0)
    exact = whole.margins()
    assert found["ms"] == pytest.approx(exact.max_sensitivity, rel=1e-3)
    assert found["gain_margin"] == pytest.approx(exact.gain_margin, rel=1e-3)
    assert make_designs(identified, max_sensitivity=1.6)[0]
    assert LoopEvaluator(identified.loop)(identified.loop.present).status == "ok"


def test_parameters_that_are_not_those_of_one_block_have_no_model(study):
    assert make_loop_spec(study(loop=PID_LOOP | {"parameters": ["pid.kp", "ego.speed.kp"]})).kind == "diagram"
    assert make_loop_spec(study()).kind == "block"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("loop", "has_rules"),
    [
        (PID_LOOP | {"parameters": PARAMETERS}, True),
        (own("own.yaml", ["own.gain", "own.reset"], roles={"own.gain": "kp", "own.reset": "ki"}), True),
        (own("continuous.yaml", ["own.bandwidth"]), False),
    ],
    ids=["pid", "own PI", "own, one parameter"],
)
def test_a_study_of_such_a_loop_has_margins_and_a_robust_winner(study, tmp_path, loop, has_rules):
    spec = study(
        loop=loop,
        search={"trials": 6, "confirm": 3},
        robustness={"runs": 4, "delay": [0.0, 0.04]},
        constraints={"ms": 1.6},
    )
    result = tune(spec, out=tmp_path / "out")
    best = next(candidate for candidate in result.candidates if candidate.name == result.best)
    assert (result.best_rule is not None) == has_rules
    assert best.figures["ms"] <= 1.6
    assert best.figures["delay_margin_s"] >= 1.5 * 0.04
    assert {check.name for check in best.margins} <= {"gain_margin", "delay_margin_s"}
    assert all(0.9 <= check.ratio <= 1.0 for check in best.margins)  # at the margin itself the loop oscillates
    assert write_tuning_report(result).is_file()
