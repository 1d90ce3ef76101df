"""Loops to tune: blocks against their definition, the reduced model against the plant, conditions, rejected studies."""

import math
import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, LogVectorOutput

from mirdrake.core.errors import ConfigError, MirdrakeError
from mirdrake.core.pid import PidLimits
from mirdrake.core.yaml_io import parse_yaml
from mirdrake.plant.wheels.tyre_forces import make_spinning_wheels, wheel_laws
from mirdrake.tuning.check import check_study
from mirdrake.tuning.frequency_response import measure_frequency_response
from mirdrake.tuning.loops.base import Conditions, Course, LoopModel, LoopSpec
from mirdrake.tuning.loops.bench import WAIT, BenchLoop
from mirdrake.tuning.loops.blocks import DelayedActuator, NoisySensor
from mirdrake.tuning.loops.evaluate import LoopEvaluator, forget_bench, plant_bench
from mirdrake.tuning.loops.judge import judge
from mirdrake.tuning.loops.reduced import find_loop_margins, run_reduced
from mirdrake.tuning.loops.registry import make_loop_spec
from mirdrake.tuning.loops.speed import car_speed
from mirdrake.tuning.loops.vehicle_loop import fastest_spin
from mirdrake.tuning.models import TransferFunction
from mirdrake.tuning.spec import TuningSpec, make_tuning
from mirdrake.tuning.stages import at_finer_step
from mirdrake.vehicles.scaffold import new_vehicle

BOTH = "vehicle: bolt\nloop: speed\n"
BOLT = {"kp": 250.0, "ki": 100.0, "kd": 20.0}
# With 20 N m s² at 50 Hz the first torque depends on the tyres' compliance, which the reduced model does not have.
SMOOTH = BOLT | {"kd": 8.0}


def speed_loop(**test: Any) -> LoopSpec:
    return make_loop_spec(make_tuning({"vehicle": "bolt", "loop": "speed", "test": {"duration": 4.0, **test}}))


def with_model(spec: LoopSpec) -> LoopSpec:
    """Return the Bolt's loop with the model that its mass gives: torque on two wheels to wheel speed."""
    mass, radius = 1616.0, 0.3012
    model = LoopModel(
        {"main": TransferFunction((2.0 / (mass * radius**2),), (1.0, 0.006), 0.06)},
        scale=1.0 / radius,
        start=spec.course.speed,
        rise=0.6,
        fall=0.6,
        feedforward=mass * radius / 2,
        weight=mass * 9.80665 * radius / 2,
        drag=26.0,
        limit=1269.0,
    )
    return replace(spec, model=model)


def delayed_output(delay: float, *, excitation: float = 0.0, load: float = 0.0) -> list[float]:
    builder = DiagramBuilder()
    source = builder.AddSystem(ConstantVectorSource([2.0]))
    delay_block = builder.AddSystem(DelayedActuator(1, 0.1))
    builder.Connect(source.get_output_port(), delay_block.u)
    log = LogVectorOutput(delay_block.y, builder, publish_period=0.1)
    diagram = builder.Build()
    simulator = Simulator(diagram)
    context = simulator.get_mutable_context()
    delay_block.set_delay(delay_block.GetMyContextFromRoot(context), delay)
    delay_block.set_excitation(delay_block.GetMyContextFromRoot(context), [excitation])
    delay_block.set_load(delay_block.GetMyContextFromRoot(context), [load])
    simulator.AdvanceTo(0.95)
    return [round(float(value), 9) for value in log.FindLog(context).data()[0]]


def test_a_delayed_actuator_passes_through_without_delay() -> None:
    assert delayed_output(0.0)[1:] == [2.0] * 9


def test_a_delayed_actuator_delays_by_whole_and_fractional_periods() -> None:
    assert delayed_output(0.3)[1:6] == [0.0, 0.0, 0.0, 2.0, 2.0] or delayed_output(0.3)[1:6] == [
        0.0,
        0.0,
        2.0,
        2.0,
        2.0,
    ]
    whole, part = delayed_output(0.3), delayed_output(0.25)
    first = whole.index(2.0)
    assert part[first - 1] == 1.0
    assert part[first] == 2.0


def test_load_acts_after_the_delay_and_excitation_before() -> None:
    assert delayed_output(0.3, load=1.0)[2] == 1.0
    assert delayed_output(0.3, excitation=1.0)[2] == 0.0
    assert delayed_output(0.3, excitation=1.0)[-1] == 3.0


def test_a_delay_above_the_longest_is_rejected() -> None:
    with pytest.raises(ConfigError, match="delay"):
        delayed_output(0.6)


def test_noise_is_added_to_the_noisy_elements() -> None:
    builder = DiagramBuilder()
    source = builder.AddSystem(ConstantVectorSource([1.0, 1.0]))
    noisy = builder.AddSystem(NoisySensor(2, 0.1))
    builder.Connect(source.get_output_port(), noisy.u)
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    own = noisy.GetMyMutableContextFromRoot(context)
    noisy.set_noise(own, [1], np.array([0.5, -0.5]))
    assert noisy.y.Eval(own).tolist() == [1.0, 1.5]
    context.SetTime(0.1)
    assert noisy.y.Eval(own).tolist() == [1.0, 0.5]
    with pytest.raises(ConfigError, match="indices must be from 0 to 1"):
        noisy.set_noise(own, [2], np.zeros(1))


def test_the_step_of_the_plant_resolves_the_spin_of_light_wheels(tmp_path: Path) -> None:
    """The wheels of this robot lock at 5 ms and oscillate at 3.3 ms, on tyres with slip; at 1.7 ms they do not."""
    robot = new_vehicle("robot", wheelbase=0.58, track=0.32, mass=18.5, wheel_radius=0.064, wheel_width=0.042,
                        drive="front", sensors="none", folder=tmp_path)  # fmt: skip
    study = {"vehicle": f"{robot}@handling", "loop": "speed"}
    loop = make_loop_spec(make_tuning(study))
    bench = plant_bench(loop)
    fastest = fastest_spin(bench.plant, bench.part)
    wheel, (_, laws) = make_spinning_wheels(bench.plant, bench.part)[0], wheel_laws(bench.part)
    contact = laws[0](wheel.static_load, 0.0, 1.0).contact
    # C h² / (σ J) by hand.
    assert fastest >= 0.064 * math.sqrt(contact.stiffness_x / contact.length_x / wheel.inertia)
    assert loop.time_step * fastest <= 1.0
    assert 2.0 * loop.time_step * fastest > 1.0
    # A lighter robot, which is the harder case: the result does not depend on the step.
    light = Conditions(mass=0.88, friction=0.97, delay=0.048)
    usual, fine = (LoopEvaluator(one)(loop.present, light) for one in (loop, at_finer_step(loop)))
    assert usual.status == fine.status == "ok"
    assert usual.figures["iae"] == pytest.approx(fine.figures["iae"], rel=0.01)
    assert (1.0 / 50.0 / loop.time_step) == pytest.approx(round(1.0 / 50.0 / loop.time_step))
    assert make_loop_spec(make_tuning({**study, "plant": {"time_step": 0.005}})).time_step == 0.005


def course() -> Course:
    return Course(step=1.0, step_time=0.5, load=0.0, load_time=6.0, duration=10.0)


def test_a_sustained_oscillation_is_unstable_and_a_decaying_one_is_not() -> None:
    t = np.arange(0.0, 10.0, 0.02)
    ones = np.ones_like(t)
    stays = judge(t, ones, ones + 0.3 * np.sin(5.0 * t), ones, course=course())
    dies = judge(t, ones, ones + np.exp(-0.4 * t) * np.sin(5.0 * t), ones, course=course())
    slow = judge(t, ones, 1.0 - np.exp(-0.05 * t), ones, course=course())
    assert (stays.status, dies.status, slow.status) == ("unstable", "ok", "ok")
    assert judge(t, ones, np.where(t > 5.0, np.nan, 1.0), ones, course=course()).status == "unstable"
    assert judge(t, ones, ones, ones, course=course(), others={"a wheel": np.sin(5.0 * t)}).reason.startswith(
        "a wheel oscillates"
    )


@pytest.mark.parametrize("periods", [1.1, 1.6, 2.3, 3.5, 8.0, 20.0])
def test_no_phase_of_a_sustained_oscillation_is_a_decay(periods: float) -> None:
    """The bound 1 - 3 / (ω L)² is close: an oscillation that decays a little more than twice that is a decay."""
    t = np.arange(0.0, 10.0, 0.002)
    omega = 2.0 * np.pi * periods / 2.5  # periods in a quarter of the time
    rate = -math.log(1.0 - 6.0 / (2.5 * omega) ** 2) / 2.5
    for phase in np.linspace(0.0, 2.0 * np.pi, 24):
        stays, dies = np.sin(omega * t + phase), np.exp(-rate * t) * np.sin(omega * t + phase)
        assert not judge(t, stays, np.zeros_like(t), np.zeros_like(t), course=course()).decays
        assert judge(t, 3.0 * dies, np.zeros_like(t), np.zeros_like(t), course=course()).decays


def test_a_load_does_not_hide_a_sustained_oscillation() -> None:
    t = np.arange(0.0, 10.0, 0.02)
    ones = np.ones_like(t)
    error = 0.2 * np.sin(12.0 * t) + np.where(t > 6.0, np.exp(-3.0 * (t - 6.0)), 0.0)
    with_load = replace(course(), load=1.0)
    assert judge(t, ones, ones - error, ones, course=with_load).status == "unstable"
    dies = np.where(t > 6.0, np.exp(-0.3 * (t - 6.0)) * np.sin(12.0 * (t - 6.0)), 0.0)
    assert judge(t, ones, ones - dies, ones, course=with_load).status == "ok"


def test_an_oscillation_at_a_limit_of_the_effort_is_sustained() -> None:
    t = np.arange(0.0, 10.0, 0.02)
    ones, error = np.ones_like(t), np.exp(-0.1 * t) * np.sin(12.0 * t)
    limits = PidLimits(-1.0, 1.0)
    assert judge(t, ones, ones - error, 0.9 * np.sign(error), course=course(), limits=limits).status == "ok"
    assert judge(t, ones, ones - error, np.sign(error), course=course(), limits=limits).status == "unstable"


@pytest.mark.parametrize(
    ("count", "error", "reason"),
    [(19, 0.0, "the run ended after 19 samples"), (0, 0.0, "the run ended after 0"), (19, 11.0, "exceeds ten steps")],
)
def test_a_short_record_is_unstable_for_its_own_reason(count: int, error: float, reason: str) -> None:
    t, ones = np.linspace(0.0, 0.4, count), np.ones(count)
    result = judge(t, ones, ones - error, ones, course=course())
    assert result.status == "unstable"
    assert reason in result.reason


def test_figures_of_a_first_order_response() -> None:
    t = np.arange(0.0, 10.0, 0.001)
    output = np.where(t < 0.5, 0.0, 1.0 - np.exp(-(t - 0.5)))
    figures = judge(t, np.ones_like(t), output, np.zeros_like(t), course=course()).figures
    assert figures["iae"] == pytest.approx(1.0, rel=1e-3)
    assert figures["rise_time"] == pytest.approx(math.log(9.0), rel=1e-2)
    assert figures["overshoot_percent"] == pytest.approx(0.0, abs=1e-6)


def test_reduced_margins_are_those_of_an_integrator_with_delay() -> None:
    spec = with_model(speed_loop())
    assert spec.model is not None
    gain = 0.5 / (0.06 + 0.01) / spec.model.plants["main"].numerator[0]  # SIMC's gain: Ms 1.59 without integral part
    assert find_loop_margins(spec, {"kp": gain, "ki": 0.0, "kd": 0.0})["ms"] == pytest.approx(1.59, abs=0.05)
    assert run_reduced(spec, {"kp": 5.0 * gain, "ki": 0.0, "kd": 0.0}).status == "unstable"


def test_reduced_model_and_plant_agree() -> None:
    """In the loop of the wheels, which has no speed loop around it: its outputs are spin rates."""
    spec = make_loop_spec(
        make_tuning({"vehicle": "bolt", "loop": "wheel_speed", "test": {"duration": 4.0, "step": 6.6}})
    )
    model, radius = with_model(spec).model, 0.3012
    assert model is not None
    start, rise, feedforward = spec.course.speed / radius, 0.6 / radius, radius * model.feedforward
    wheels = replace(model, scale=1.0, start=start, rise=rise, fall=rise, feedforward=feedforward)
    evaluate = LoopEvaluator(replace(spec, model=wheels))
    reduced, plant = evaluate(SMOOTH, fidelity="reduced"), evaluate(SMOOTH)
    assert reduced.status == plant.status == "ok"
    # The reduced wheel is rigid; on its tyre it gains speed before the car does, so the peak of the effort is lower.
    for figure, tolerance in {"iae": 0.08, "peak_effort": 0.08, "rise_time": 0.03}.items():
        assert reduced.figures[figure] == pytest.approx(plant.figures[figure], rel=tolerance)


def test_conditions_change_the_context_only() -> None:
    evaluate = pickle.loads(pickle.dumps(LoopEvaluator(with_model(speed_loop(duration=2.0)))))
    first = evaluate(BOLT).figures["iae"]
    for other in (Conditions(mass=1.2), Conditions(delay=0.1), Conditions(grade=0.05), Conditions(friction=0.4)):
        assert evaluate(BOLT, other).status == "ok"
    assert evaluate(BOLT, Conditions(grade=0.05)).figures["iae"] > 1.5 * first
    assert evaluate(BOLT).figures["iae"] == first
    assert evaluate({**BOLT, "kp": math.nan}).status == "unstable"
    assert evaluate({"kq": 1.0}).status == "failed"


def test_a_test_does_not_depend_on_earlier_ones() -> None:
    evaluate = LoopEvaluator(speed_loop(duration=2.0), keep=True)
    hard = Conditions(mass=1.2, friction=0.4, delay=0.1, grade=0.05)
    tried = [(BOLT, hard), ({**BOLT, "kp": 600.0}, Conditions(mass=0.8)), (BOLT, Conditions())]
    alone = []
    for gains, conditions in tried:
        forget_bench(evaluate.spec)
        alone.append(evaluate(gains, conditions))
    for (gains, conditions), first in reversed(list(zip(tried, alone, strict=True))):
        again = evaluate(gains, conditions)
        assert again.figures == pytest.approx(first.figures, rel=0.0, abs=0.0, nan_ok=True)
        assert first.response is not None
        assert again.response is not None
        assert again.response.equals(first.response)


def test_a_diverging_loop_is_not_simulated_to_the_end() -> None:
    evaluation = LoopEvaluator(speed_loop(duration=30.0), keep=True)({"kp": -1000.0, "ki": 0.0, "kd": 0.0})
    assert evaluation.status == "unstable"
    assert evaluation.reason == "the error exceeds ten steps"
    assert evaluation.response is not None
    assert float(evaluation.response["t"].iloc[-1]) < 15.0


def test_figures_of_a_speed_loop_do_not_depend_on_the_step_of_the_plant() -> None:
    spec, plain = speed_loop(), make_tuning({"vehicle": "bolt", "loop": "speed", "test": {"duration": 4.0}})
    assert spec.diagram["plant"]["time_step"] == 0.005
    half = make_loop_spec(plain.model_copy(update={"plant": type(plain.plant)(time_step=0.0025)}))
    assert half.diagram["plant"]["time_step"] == 0.0025
    for gains in (SMOOTH, {"kp": 300.0, "ki": 150.0, "kd": 10.0}):
        whole, other = LoopEvaluator(spec)(gains).figures, LoopEvaluator(half)(gains).figures
        assert whole["iae"] == pytest.approx(other["iae"], rel=0.02)
        assert whole["rise_time"] == pytest.approx(other["rise_time"], rel=0.02)
        assert whole["overshoot_percent"] == pytest.approx(other["overshoot_percent"], abs=0.3)


@pytest.mark.parametrize(("step", "delay"), [(0.02, 0.05), (0.01, 0.05), (0.01, 0.0)])
def test_the_dead_time_of_a_bench_is_the_delay_and_the_mean_wait_for_the_actuator(step: float, delay: float) -> None:
    """A control acts at the next cycle of an actuator of the same period, whose phase is uniform: half a period."""
    phases = (np.arange(1000) + 0.5) / 1000.0
    waits = [math.ceil(7.0 - phase) + phase - 7.0 for phase in phases]
    assert np.mean(waits) == pytest.approx(WAIT, abs=1e-9)

    plant = {"time_step": step}
    spec = make_loop_spec(
        make_tuning({"vehicle": "bolt", "loop": "wheel_speed", "test": {"delay": delay}, "plant": plant})
    )
    bench = plant_bench(spec)
    loop = BenchLoop(bench, {"kp": 75.0, "ki": 0.0, "kd": 0.0})

    def excite(effort: float) -> tuple[float, float]:
        speed = float(car_speed(bench, bench.state(loop.context)[:, None])[0])
        return loop.step(effort)[0], speed

    (response,) = measure_frequency_response(
        excite, period=bench.period, frequencies=[2.0, 4.0], amplitude=100.0, cycles=1, settle=1
    )
    # The car is an integrator, of which 90° are taken off. (Its wheels lag behind it, as their tyres are unloaded.)
    lags = -(np.angle(response.values) + 0.5 * np.pi) / response.frequencies
    assert lags == pytest.approx(delay + WAIT * bench.period, abs=0.002)


@pytest.mark.parametrize(
    ("delay", "weights"), [(0.0, [0.5, 0.5, 0.0, 0.0]), (0.03, [0.0, 0.0, 1.0, 0.0]), (0.05, [0.0, 0.0, 0.0, 1.0])]
)
def test_the_control_of_a_unit_acts_on_the_bench_after_the_dead_time(delay: float, weights: list[float]) -> None:
    """The dead time is the delay and half a period of 20 ms: 10, 40 and 60 ms, or 0.5, 2 and 3 periods."""
    spec = speed_loop(delay=delay, duration=2.0)
    bench = plant_bench(spec)
    simulator = bench.assembly.make_simulator(bench.context({"kp": 250.0, "ki": 100.0, "kd": 30.0}, Conditions()))
    context = simulator.get_mutable_context()
    simulator.Initialize()
    bench._command(context, spec.course.speed + 1.0, 0.0)
    own, channel = bench._delay.GetMyContextFromRoot(context), bench.channels[0]
    controls, acting = [], []
    for number in range(60):
        # In the middle of a period, when all updates of its beginning have been made.
        simulator.AdvanceTo((number + 0.5) * bench.period)
        controls.append(float(bench._delay.u.Eval(own)[channel]))
        acting.append(float(bench._delay.y.Eval(own)[channel]))
    past = np.column_stack([controls[4 - lag : 60 - lag] for lag in range(4)])
    assert acting[4:] == pytest.approx(past @ weights, abs=1e-6)
    assert np.ptp(controls) > 50.0


def test_a_grade_needs_the_torque_that_holds_the_weight() -> None:
    evaluate = LoopEvaluator(speed_loop(duration=6.0, step=0.0001, load=0.0), keep=True)
    gains = {"kp": 400.0, "ki": 400.0, "kd": 0.0}
    flat, steep = (evaluate(gains, Conditions(grade=grade)).response for grade in (0.0, 0.04))
    assert flat is not None
    assert steep is not None
    rise = float(steep["effort"].iloc[-20:].mean() - flat["effort"].iloc[-20:].mean())
    assert rise == pytest.approx(1616.0 * 9.80665 * math.sin(0.04) * 0.3012 / 2, rel=0.03)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (BOTH + "search:\n  ranges:\n    kq: {low: 1, high: 2}", "t.yaml:5: search.ranges.kq: no gain 'kq'"),
        (BOTH + "search:\n  ranges:\n    kp: {low: 2, high: 2}", "t.yaml:5: search.ranges.kp: the range"),
        ("vehicle: bolt\nloop: speed\nbaseline: {kpp: 3}", "t.yaml:3: baseline.kpp: no gain"),
        (BOTH + "baseline: {kp: .inf}", "t.yaml:3: baseline.kp: inf is not a finite number"),
        (BOTH + "baseline: publishd", "t.yaml:3: baseline: 'publishd' is not allowed; allowed: 'present'"),
        (
            "vehicle: bolt\nloop: {diagram: bolt_skidpad, reference: 0, output: a, effort: b}",
            "t.yaml:2: loop.parameters: is missing",
        ),
        ("vehicle: bolt\nloop: speed\ncost:\n  iaee: 1", "t.yaml:4: cost.iaee: no figure 'iaee'; did you mean 'iae'"),
        ("vehicle: blot\nloop: speed", "t.yaml:1: vehicle"),
        ("vehicle: bolt@handling\nloop: wheel_speed", "t.yaml:2: loop: bolt@handling is driven by pedals"),
        ("loop: speed", "needs a vehicle"),
        (
            "loop:\n  diagram: bolt_skidpad\n  reference: 0\n  output: ego.lateral_eror\n"
            "  effort: ego.steering_setpoint\n  parameters: [ego.driver.damping]",
            "t.yaml:4: loop.output: no signal 'ego.lateral_eror' is logged; did you mean 'ego.lateral_error'",
        ),
        (
            "loop:\n  diagram: bolt_skidpad\n  reference: 0\n  output: ego.lateral_error\n"
            "  effort: ego.steering_setpoint\n  parameters: [ego.driver.dampin]",
            "t.yaml:6: loop.parameters.0: no parameter 'ego.driver.dampin'",
        ),
        (
            "loop:\n  diagram: nowhere\n  reference: 0\n  output: a\n  effort: b\n  parameters: [c]",
            "t.yaml:2: loop.diagram: unknown diagram 'nowhere'",
        ),
        (
            "loop:\n  diagram: bolt_skidpad\n  reference: 0\n  output: ego.lateral_error\n"
            "  effort: ego.steering_setpoint\n  parameters: [ego.driver.damping]\nsearch: {trials: 3}",
            "t.yaml:7: search.ranges: no rule gives a value of ego.driver.damping; write a range for it",
        ),
        (BOTH + "world: test_track", "t.yaml:3: world: the friction of test_track is not the same everywhere"),
        (BOTH + "cost:\n  delay_margin_s: 1", "t.yaml:4: cost.delay_margin_s: a larger value is better"),
        (BOTH + "cost:\n  iae: -1", "t.yaml:4: cost.iae: -1 is not allowed; a weight is 0 or more"),
        (BOTH + "cost: {iae: 0}", "t.yaml:3: cost: no figure has a weight"),
        (BOTH + "test:\n  step: 0", "t.yaml:4: test.step: 0 is not allowed"),
        (BOTH + "test:\n  duration: 3\n  step_time: 5", "t.yaml:5: test.step_time: 5 s is not before the end (3 s)"),
    ],
)  # fmt: skip
def test_faults_are_reported_with_file_and_line(text: str, expected: str) -> None:
    def check() -> None:
        spec = parse_yaml(text, TuningSpec, name="t.yaml")
        check_study(spec, make_loop_spec(spec))

    with pytest.raises(ConfigError) as error:
        check()
    assert expected in str(error.value)
    assert len(str(error.value).splitlines()) == 1


@pytest.mark.parametrize(
    ("connect", "expected"),
    [
        ("[wanted.y, pid.reference]", "pid.measurement"),
        ("[ego.spede, pid.measurement]", "loop.yaml:7: connect.0: unknown output 'ego.spede'"),
    ],
)
def test_a_loop_that_is_not_connected_is_rejected_with_its_line(connect: str, expected: str, tmp_path: Path) -> None:
    diagram = (
        "world: empty\nvehicles: {ego: {model: bolt}}\n"
        "systems:\n  pid: {kind: pid, kp: 1.0, period: 0.02}\n  wanted: {kind: constant, value: [1]}\n"
        f"connect:\n  - {connect}\n"
    )
    (tmp_path / "loop.yaml").write_text(diagram)
    loop = {"diagram": "loop.yaml", "reference": 1, "output": "a", "effort": "b", "parameters": ["pid.kp"]}
    spec = make_tuning({"loop": loop, "folder": str(tmp_path)})
    with pytest.raises(MirdrakeError) as error:
        make_loop_spec(spec)
    assert expected in str(error.value)
    assert "loop.yaml:" in str(error.value)


def test_a_path_is_a_loop() -> None:
    spec = make_loop_spec(make_tuning({"vehicle": "bolt", "loop": "path", "test": {"duration": 4.0}}))
    evaluate = LoopEvaluator(spec)
    soft, firm = (evaluate({"ego.driver.convergence_time": time, "ego.driver.damping": 1.0}) for time in (1.5, 0.6))
    assert firm.figures["iae"] < 0.7 * soft.figures["iae"]


def test_loops_are_tested_at_the_step_of_a_diagram() -> None:
    # The slip of a wheel decays with I v / (C r^2), 2 ms at 15 m/s for 1 kg m^2, 80 kN and 0.3 m.
    steps = {
        (vehicle, loop): make_loop_spec(make_tuning({"vehicle": vehicle, "loop": loop})).time_step
        for vehicle in ("bolt", "bolt@handling")
        for loop in ("speed", "steering")
    }
    assert steps == {
        ("bolt", "speed"): 0.005, ("bolt", "steering"): 0.005,
        ("bolt@handling", "speed"): 0.005, ("bolt@handling", "steering"): 0.005,
    }  # fmt: skip
