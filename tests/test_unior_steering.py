"""The steering of the Unior: its motor, the road torque, and a tuned loop that is insensitive to the time step."""

from pathlib import Path

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from mirdrake.assembly.diagram import assemble
from mirdrake.assembly.diagram_spec import make_spec
from mirdrake.core.constants import GRAVITY
from mirdrake.core.contacts import ContactModel
from mirdrake.tuning.identify import Identification, identify_loop
from mirdrake.tuning.loops.base import Conditions, Evaluation
from mirdrake.tuning.loops.evaluate import LoopEvaluator, plant_bench
from mirdrake.tuning.loops.registry import make_loop_spec
from mirdrake.tuning.spec import load_tuning
from mirdrake.vehicles import load_vehicle

STUDY = Path(__file__).parents[1] / "studies" / "unior_steering.yaml"
TUNED = {"kp": 18.42, "ki": 30.76, "kd": 0.023}  # what the study finds, docs/tuning_method.md
STALL, FREE_SPEED, GEAR = 11.2, 48.0 * 2.0 * np.pi / 60.0, 260.6  # data sheet of the XW540-T260 at 14.8 V


def turn(step: float, *, contact: str = "point", rate: float = 0.1, speed: float = 1.6) -> dict[str, np.ndarray]:
    """Return the mean road torque on both kingpins [N m]: at breakaway, at a steady rate [rad/s], and held.

    The wheels are held by a servo ten times as stiff as the model's; the torque of the motor's damping is subtracted.
    """
    servo = {"kind": "servo", "stiffness": 5407.0, "damping": 108.1}
    car = {"model": "unior", "speed": speed, "control": {"dead_man": 1e6, "steering": servo}}
    plan = {"world": "empty", "vehicles": {"ego": car}, "plant": {"contact": contact, "time_step": step}}
    assembly = assemble(make_spec({"name": "turn", **plan}))
    simulator, plant, part = Simulator(assembly.diagram), assembly.parts.plant, assembly.parts.vehicles["ego"]
    context = simulator.get_mutable_context()
    channels = [int(actuator.input_start()) for actuator in part.steering_actuators]
    angles = [joint.position_start() for joint in part.steering]
    rates = [plant.num_positions() + joint.velocity_start() for joint in part.steering]
    damping = [joint.default_damping() for joint in part.steering]
    motors, gains = plant.num_actuators(), part.steering_actuators[0].get_controller_gains()
    rows = []
    for k in range(round(3.0 / step)):
        set_point = rate * min(max(k * step - 1.0, 0.0), 1.0)
        for name, value in (("speed_reference", speed), ("steering_reference", set_point), ("reference_stamp", 0.0)):
            assembly.diagram.GetInputPort(f"ego.{name}").FixValue(context, [value])
        simulator.AdvanceTo((k + 1) * step)
        inner = plant.GetMyContextFromRoot(context)
        # Torque of the servo at the end of the step, with the set-points of the step.
        state, wanted = (
            plant.GetPositionsAndVelocities(inner),
            plant.get_desired_state_input_port(part.instance).Eval(inner),
        )
        rows.append(
            [
                gains.p * (wanted[u] - state[q]) + gains.d * (wanted[motors + u] - state[v]) - c * state[v]
                for u, c, q, v in zip(channels, damping, angles, rates, strict=True)
            ]
        )
    times, torques = step * np.arange(1, len(rows) + 1), np.array(rows)
    spans = {"beginning": (1.0, 1.1), "turning": (1.3, 2.0), "held": (2.3, 3.0)}
    return {name: torques[(times > low) & (times <= high)].mean(axis=0) for name, (low, high) in spans.items()}


def trial(
    vehicle: str = "unior",
    *,
    step: float | None = None,
    contact: ContactModel | None = None,
    delay: float = 0.05,
) -> Evaluation:
    """Return the study's trial with the tuned gains."""
    spec = load_tuning(STUDY)
    spec.vehicle = vehicle
    if step is not None:
        spec.plant.time_step = step
        spec.plant.model_fields_set.add("time_step")
    if contact is not None:
        spec.plant.contact = contact
        spec.plant.model_fields_set.add("contact")
    return LoopEvaluator(make_loop_spec(spec))(TUNED, Conditions(delay=delay))


def test_the_torque_at_a_kingpin_is_that_of_the_motor_data_sheet() -> None:
    bench = plant_bench(make_loop_spec(load_tuning(STUDY)))
    plant, part = bench.assembly.parts.plant, bench.part
    matrix = plant.CalcMassMatrix(plant.CreateDefaultContext())
    for joint, actuator in zip(part.steering, part.steering_actuators, strict=True):
        assert joint.default_damping() == pytest.approx(STALL / FREE_SPEED, rel=1e-3)
        assert actuator.effort_limit() == pytest.approx(STALL, rel=0.02)
        rotor = 0.02661 * (GEAR / 225.0) ** 2
        assert actuator.default_reflected_inertia() == pytest.approx(rotor, rel=1e-3)
        wheel = 0.9 * ((3.0 * 0.13**2 + 0.11**2) / 12.0 + 0.0078**2)
        knuckle = 0.45 * 0.039**2 / 2.0
        index = joint.velocity_start()
        assert matrix[index, index] == pytest.approx(rotor + wheel + knuckle, rel=1e-3)


def test_the_road_asks_the_same_of_a_turning_wheel_at_every_step() -> None:
    """Straight ahead it is rolling resistance times the kingpin offset, on a circle the pivoting moment of the patch.

    That moment is C w² / 12 times the curvature: 0.43 N m with C = 30 N and w = 0.11 m. The step has no effect.
    """
    left, right = turn(0.005, rate=0.0)["held"]
    assert 0.5 * (right - left) == pytest.approx(0.01 * 43.5 * GRAVITY / 4.0 * 0.0078, rel=0.1)
    steps = {step: turn(step) for step in (0.005, 0.00125)}
    wheelbase = load_vehicle("unior").geometry.wheelbase
    pivoting = 30.0 * 43.5 * GRAVITY / 4.0 * 0.11**2 / 12.0 * np.tan(0.1) / wheelbase
    for response in steps.values():
        assert response["held"].mean() == pytest.approx(pivoting, rel=0.03)
    for name in ("turning", "held"):
        assert steps[0.005][name] == pytest.approx(steps[0.00125][name], rel=0.005)


def test_the_tuned_steering_does_not_hinge_on_the_step() -> None:
    results = [trial(step=step) for step in (0.005, 0.00125)]
    assert [result.status for result in results] == ["ok", "ok"]
    coarse, fine = (result.figures["iae"] for result in results)
    assert coarse == pytest.approx(fine, rel=0.02)
    assert max(result.figures["overshoot_percent"] for result in results) <= 5.0


def test_the_tuned_steering_does_not_shimmy_on_tyres() -> None:
    for delay in (0.05, 0.1):
        assert trial("unior@handling", delay=delay).status == "ok"


@pytest.mark.slow
@pytest.mark.parametrize("contact", ["point", "tyre", "hydroelastic"])
@pytest.mark.parametrize("step", [0.00125, 0.0025, 0.005, 0.01])
def test_the_tuned_steering_does_not_depend_on_contact_and_step(contact: ContactModel, step: float) -> None:
    result = trial(step=step, contact=contact)
    assert result.status == "ok"
    assert result.figures["iae"] == pytest.approx(0.01916, rel=0.03)


@pytest.mark.slow
def test_the_contact_does_not_change_the_torque_of_the_road() -> None:
    point, patch = (turn(0.005, contact=contact) for contact in ("point", "hydroelastic"))
    for name in ("turning", "held"):
        assert patch[name].mean() == pytest.approx(point[name].mean(), rel=0.01)


@pytest.fixture(scope="module")
def identified() -> Identification:
    return identify_loop(plant_bench(make_loop_spec(load_tuning(STUDY))))


@pytest.mark.slow
def test_the_experiments_find_the_joint(identified: Identification) -> None:
    """Gain 1/J, damping c/J, delay 50 ms and the hold, both wheels together and against each other; all fit by 98 %."""
    inertia = 0.03569 + 0.00528
    for model in identified.experiments:
        if model.name in ("frequency_response", "wheels_apart"):
            assert model.fit_percent is not None
            assert model.fit_percent > 98.0
            gain, damping, delay = (model.parameters[name].value for name in ("gain", "damping", "delay"))
            assert gain == pytest.approx(1.0 / inertia, rel=0.15)
            assert damping / gain == pytest.approx(STALL / FREE_SPEED, rel=0.03)
            assert delay == pytest.approx(0.055, abs=0.005)
            # The spring of the patch, C w² / (12 σ), relaxes while the wheel rolls by σ = 0.25 m.
            spring = 30.0 * 43.5 * GRAVITY / 4.0 * 0.11**2 / 12.0 / 0.25
            assert model.parameters["stiffness"].value / gain == pytest.approx(spring, rel=0.1)
            assert model.parameters["relaxation_time"].value == pytest.approx(0.25 / 1.6, rel=0.1)
    assert identified.first is not None
    assert identified.inertial is None
