"""Continuous plants (`plant.contact: tyre` without loose bodies): servos, dampers and limits of joints, and drives."""

from collections.abc import Callable
from math import exp
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from pandas import DataFrame
from pydrake.systems.analysis import Simulator

from mirdrake.assembly.diagram import Assembly, assemble, make_diagram
from mirdrake.assembly.diagram_spec import make_spec
from mirdrake.assembly.parts.steps import discrete_plant
from mirdrake.assembly.scene import make_scene
from mirdrake.core.compiled import compiled, records
from mirdrake.plant.plant import PlantParts, implicit_servo, make_plant, solves_joints
from mirdrake.plant.wheels.joint_step import JOINT_PARTS, JointMemory, StiffJoint, joint_steps
from mirdrake.runs.simulation import Simulation
from mirdrake.vehicles.joint_control import ServoGains
from tests.ground_rigs import on_ground


def move(
    *,
    joint: StiffJoint,
    inertia: float,
    load: Callable[[float], float],
    desired: float = 0.0,
    step: float = 0.005,
    duration: float = 1.0,
    start: float = 0.0,
    effort: Callable[[float], float] = lambda _: 0.0,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the positions of one joint after each step, and the torques of its servo.

    Args:
        joint: the joint with its inertia for the prediction.
        inertia: its true inertia.
        load: unknown torque on it at a time [N m]; the plant applies it.
        desired: set-point.
        step: [s].
        duration: [s].
        start: position at the start.
        effort: torque of the actuator without its servo [N m].
    """
    solve = compiled(joint_steps, parts=JOINT_PARTS)
    still = JointMemory(0, 0, 0, 0)
    joints, memory, after = records(StiffJoint, [joint]), *(records(JointMemory, [still]) for _ in "ab")
    x, force, actuation = np.array([start, 0.0]), np.zeros(1), np.zeros(1)
    positions, torques = [], []
    for k in range(round(duration / step)):
        force[0] = 0.0
        set_point = np.array([desired, 0.0])
        efforts = np.array([effort(k * step)])
        solve(x, 1, step, joints, 0, memory, efforts, set_point, force, after, actuation, np.zeros(1))
        # The plant: semi-explicit Euler, with the joint's damping at the beginning of the step.
        x[1] += step / inertia * (force[0] + actuation[0] + load(k * step) - joint.damping * x[1])
        x[0] += step * x[1]
        memory[:] = after
        positions.append(x[0])
        torques.append(actuation[0])
    return np.array(positions), np.array(torques)


FREE = StiffJoint(0, 0, 2.0, 0.0, 0.0, 0.0, -np.inf, np.inf, 0, np.inf)


@pytest.mark.parametrize("step", [0.001, 0.005])
def test_a_servo_moves_as_implicit_euler_and_near_its_closed_form(step: float) -> None:
    """2 kg m² on 200 N m/rad and 40 N m s/rad is critically damped, 10 rad/s: q = 1 - (1 + 10 t) exp(-10 t)."""
    joint = FREE._replace(stiffness=200.0, gain=40.0)
    q, _ = move(joint=joint, inertia=2.0, load=lambda _: 0.0, desired=1.0, step=step)
    # Implicit Euler, solved by itself.
    A = np.array([[1.0, -step], [100.0 * step, 1.0 + 20.0 * step]])
    state, implicit = np.zeros(2), []
    for _ in q:
        state = np.linalg.solve(A, state + np.array([0.0, 100.0 * step]))
        implicit.append(state[0])
    np.testing.assert_allclose(q, implicit, rtol=1e-9)
    exact = [1.0 - (1.0 + 10.0 * t) * exp(-10.0 * t) for t in step * np.arange(1, len(q) + 1)]
    assert np.abs(q - exact).max() < 5.0 * step


@pytest.mark.parametrize("step", [0.01, 0.005, 0.0025])
def test_a_joint_follows_the_torque_of_its_actuator_without_an_error_of_first_order(step: float) -> None:
    """The steering joint of the Unior, 1 N m from 0.1 s on: q = M / D (t - I / D (1 - exp(-D t / I)))."""
    inertia, damping = 0.0408, 2.228
    joint = FREE._replace(inertia=inertia, damping=damping)
    q, _ = move(joint=joint, inertia=inertia, load=lambda _: 0.0, step=step, effort=lambda t: float(t > 0.1 - 1e-9))
    t = np.maximum(step * np.arange(1, len(q) + 1) - 0.1, 0.0)
    exact = (t - inertia / damping * (1.0 - np.exp(-damping / inertia * t))) / damping
    # With the present torque only, q would be ahead by M dt / (2 D) at the end.
    assert np.abs(q - exact).max() < 0.4 * step * step


@pytest.mark.parametrize("ratio", [0.7, 1.0, 1.25])
def test_a_stiff_servo_is_stable_with_an_inexact_inertia_and_holds_a_load(ratio: float) -> None:
    """5e7 N m/rad at 5 ms under 100 N m: 100 / 5e7 rad from the set-point after 40 times d / k."""
    joint = FREE._replace(stiffness=5e7, gain=1e6, inertia=2.0 * ratio)
    q, torque = move(joint=joint, inertia=2.0, load=lambda _: 100.0, desired=0.1)
    np.testing.assert_allclose(q[160:], 0.1 + 100.0 / 5e7, atol=1e-9)
    np.testing.assert_allclose(torque[160:], -100.0, rtol=1e-6)


@pytest.mark.parametrize("step", [0.01, 0.0025])
@pytest.mark.parametrize("damping", [0.0, 4.0])
def test_an_adapted_servo_has_its_time_constant_at_any_step(step: float, damping: float) -> None:
    """0.02 kg m² on 540 N m/rad and 11 N m s/rad: the slow solution of I λ² + (d + D) λ + k = 0."""
    gains = implicit_servo(ServoGains(540.0, 11.0), 0.02, damping, step, continuous=True)
    joint = FREE._replace(inertia=0.02, damping=damping, stiffness=gains.stiffness, gain=gains.damping)
    q, _ = move(joint=joint, inertia=0.02, load=lambda _: 0.0, start=0.1, step=step, duration=0.2)
    rate = max(np.roots([0.02, 11.0 + damping, 540.0]).real)
    assert np.log(q[-1] / q[-6]) / (5.0 * step) == pytest.approx(rate, rel=0.005)


def test_a_servo_that_oscillates_keeps_its_gains() -> None:
    gains = ServoGains(540.0, 2.0)
    assert implicit_servo(gains, 0.05, 0.0, 0.005) == gains


def test_a_saturated_servo_accelerates_with_its_limit() -> None:
    joint = FREE._replace(stiffness=5e4, gain=1e3, effort_limit=10.0)
    q, torque = move(joint=joint, inertia=2.0, load=lambda _: 0.0, desired=10.0, duration=0.5)
    np.testing.assert_allclose(torque, 10.0)
    # Semi-explicit Euler: q = a dt² n (n + 1) / 2 with a = 5 rad/s².
    n = np.arange(1, 101)
    np.testing.assert_allclose(q, 5.0 * 0.005**2 * n * (n + 1) / 2.0, rtol=1e-9)


def test_a_joint_stops_at_its_limit_and_leaves_it() -> None:
    """A torque of 10 N m pushes it against the limit for 0.5 s, then pulls it off."""
    joint = FREE._replace(upper=0.2, actuator=-1)
    q, _ = move(joint=joint, inertia=2.0, load=lambda t: 10.0 if t < 0.5 else -10.0)
    assert q.max() == pytest.approx(0.2, abs=1e-3)
    np.testing.assert_allclose(q[80:100], 0.2, atol=1e-9)
    assert q[-1] < -0.3


@pytest.mark.parametrize("ratio", [0.5, 1.0, 1.3])
@pytest.mark.parametrize("damping", [20.0, 400.0, 1200.0, 1e4, 1e7])
def test_a_damper_of_any_strength_is_stable(damping: float, ratio: float) -> None:
    """2 kg, pushed for one step: the position settles at the momentum over the damping."""
    joint = FREE._replace(damping=damping, inertia=2.0 * ratio, actuator=-1)
    q, _ = move(joint=joint, inertia=2.0, load=lambda t: 400.0 if t < 0.002 else 0.0, duration=2.0)
    assert q[-1] == pytest.approx(400.0 * 0.005 / damping, rel=1e-6)


def test_a_stiff_damper_stops_its_joint_within_a_step() -> None:
    joint = FREE._replace(damping=1e4, actuator=-1)
    # The load of the first step is still expected in the second one.
    q, _ = move(joint=joint, inertia=2.0, load=lambda t: 400.0 if t < 0.002 else 0.0)
    np.testing.assert_allclose(np.diff(q[2:]), 0.0, atol=1e-12)


def test_damping_is_of_second_order() -> None:
    """2 kg on 800 N s/m, released with 0.1 m of travel by a spring of 2000 N/m: error of 5 ms below 1 %."""
    travel = []
    for step in (0.005, 0.000125):
        joint = FREE._replace(damping=100.0, actuator=-1)
        # A spring as the unknown force would need the position; a ramp has the same effect on the damper.
        q, _ = move(joint=joint, inertia=2.0, load=lambda t: 400.0 * t, step=step, duration=0.5)
        travel.append(q[-1])
    # m x'' + c x' = k t: x = k / c (t² / 2 - T t + T² (1 - exp(-t / T))), T = m / c.
    T, t = 2.0 / 100.0, 0.5
    exact = 4.0 * (t * t / 2.0 - T * t + T * T * (1.0 - exp(-t / T)))
    assert travel[1] == pytest.approx(exact, rel=1e-3)
    assert travel[0] == pytest.approx(exact, rel=1e-2)


# --- whole diagrams --------------------------------------------------------------------------------------------------


def diagram(model: str = "bolt@handling", **changes: Any) -> dict[str, Any]:
    """Return a drive at 10 m/s with a step of the steering at 1 s, sampled at 100 Hz, and braking from 3 s."""
    rows = [
        {"time": 0.0, "speed": 10.0, "steering": 0.0},
        {"time": 1.0, "speed": 10.0, "steering": 0.0},
        {"time": 1.1, "speed": 10.0, "steering": 0.04},
        {"time": 3.0, "speed": 10.0, "steering": 0.04},
        {"time": 3.5, "speed": 8.0, "steering": 0.04},
    ]
    data: dict[str, Any] = {
        "name": "turn",
        "world": "empty",
        "vehicles": {"ego": {"model": model, "start": {"x": 0.0, "y": 0.0, "yaw": 0.0}, "speed": 10.0}},
        "control": {"ego": {"kind": "schedule", "rows": rows}},
        "plant": {"contact": "tyre"},
        "record": {"rate": 100.0, "report": False, "meshcat": False},
        "duration": 4.0,
    }
    return data | changes


def signals_of(assembly: Assembly) -> DataFrame:
    return Simulation(assembly).run().signals


def figures(signals: DataFrame) -> dict[str, float]:
    """Return peak and steady state of the step of the steering, and the way of braking."""
    turn, steady = signals.loc[1.0:3.0], signals.loc[2.5:3.0].mean()
    return {
        "yaw_rate_peak": float(turn["ego.wz"].max()),
        "yaw_rate": float(steady["ego.wz"]),
        "lateral_velocity": float(steady["ego.vy"]),
        "roll": float(steady["ego.roll"]),
        "load_transfer": float(steady["ego.wheel_load.front_right"] - steady["ego.wheel_load.front_left"]),
        "pitch_range": float(np.ptp(signals.loc[3.0:]["ego.pitch"])),
        "speed": float(signals["ego.vx"].iloc[-1]),
    }


@pytest.mark.parametrize("model", ["bolt", "bolt@handling", "unior@handling", "mkz@handling"])
def test_a_drive_is_that_of_the_discrete_plant(model: str) -> None:
    """Within 1 %: the discrete plant has implicit Euler for dampers, and pitches less when it brakes."""
    spec = make_spec(diagram(model))
    discrete, continuous = assemble(spec, continuous=False), assemble(spec)
    assert solves_joints(discrete.parts.plant)
    assert not solves_joints(continuous.parts.plant)
    expected, found = figures(signals_of(discrete)), figures(signals_of(continuous))
    for name, value in expected.items():
        assert found[name] == pytest.approx(value, rel=1e-2, abs=1e-5), name


@pytest.mark.parametrize("model", ["bolt", "bolt@handling", "unior@handling", "mkz@handling"])
def test_half_the_step_changes_figures_by_less_than_a_percent(model: str) -> None:
    coarse, fine = (
        figures(signals_of(assemble(make_spec(diagram(model, plant={"contact": "tyre", "time_step": step})))))
        for step in (0.005, 0.0025)
    )
    for name, value in fine.items():
        assert coarse[name] == pytest.approx(value, rel=1e-2, abs=1e-5), name


def test_runs_are_repeatable_and_forces_are_there_at_the_start() -> None:
    simulation = Simulation(assemble(make_spec(diagram())))
    first, second = (simulation.run(duration=1.5).signals for _ in range(2))
    assert first.equals(second)
    loads = first[[name for name in first if "wheel_load" in str(name)]]
    np.testing.assert_allclose(loads.iloc[0], loads.iloc[50], rtol=1e-2)


def test_an_exported_diagram_needs_no_integrator_of_its_own() -> None:
    """With a plain Simulator it has the drive of `mirdrake run`, as its plant is discrete."""
    spec = make_spec(diagram())
    exported = make_diagram(spec)
    simulator = Simulator(exported)
    assembly = assemble(spec)
    simulator.reset_context(assemble(spec, continuous=False, expand=True).make_context())
    assert not simulator.get_context().num_continuous_states()
    assert assembly.make_context().num_continuous_states()


DELAY = {"kind": "mirdrake.tuning.loops.blocks:DelayedActuator", "size": 1, "period": 0.02}
CONNECT = [["ego.speed_command", "delay.u"]]


MANOEUVRE = {"kind": "mirdrake.manoeuvres.drivers:OpenLoopDriver", "profile": {"kind": "step", "amplitude": 0.02}}


@pytest.mark.parametrize(
    ("changes", "continuous"),
    [
        ({}, True),
        ({"plant": {"contact": "point"}}, False),
        ({"record": {"rate": 1000.0}}, False),  # samples within steps
        ({"record": {"signals": False, "rate": 1000.0}}, True),
        ({"systems": {"wave": {"kind": "sine", "frequency": 1.0}}}, False),
        ({"systems": {"delay": DELAY}, "connect": CONNECT}, True),  # its class states its period
        ({"systems": {"delay": DELAY | {"period": 0.012}}, "connect": CONNECT}, False),
        ({"world": "barrels"}, False),  # loose bodies
        ({"world": "hill_road"}, True),
        ({"sensors": {"ego": ["gps"]}}, True),
        ({"control": {"ego": {"kind": "constant", "period": 0.012}}}, True),  # a function of time, without events
        ({"control": {"ego": {"kind": "path_tracking", "speed": 5.0, "period": 0.012}}, "world": "test_track"}, False),
        ({"control": {"ego": MANOEUVRE}}, True),
        ({"control": {"ego": MANOEUVRE | {"period": 0.012}}}, False),
    ],
)
def test_only_what_disturbs_its_steps_makes_a_plant_discrete(changes: dict[str, Any], continuous: bool) -> None:
    data = diagram("bolt", **changes)
    if "world" in changes:
        data["vehicles"] = {"ego": {"model": "bolt"}}
    assert solves_joints(assemble(make_spec(data)).parts.plant) is not continuous


OWN_DRIVER = """
from mirdrake.controllers.schedule import ConstantCommand

class Unknown(ConstantCommand):
    def __init__(self, period: float = 0.01):
        super().__init__(5.0, 0.0, period=period)

class Stated(Unknown):
    sampled_with = "period"
"""


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"control": {"ego": {"kind": "own_stepped:Stated"}}}, None),
        ({"control": {"ego": {"kind": "own_stepped:Unknown"}}}, "control.ego: its period is not known"),
        ({"control": {"ego": {"kind": "own_stepped:Stated", "period": 0.012}}}, "control.ego: 0.012 s is not a"),
        ({"record": {"rate": 1000.0}}, "record.rate: 0.001 s is not a multiple of plant.time_step, 0.005 s"),
        # A plant that needs the contact solver is discrete in any case.
        ({"control": {"ego": {"kind": "own_stepped:Unknown"}}, "plant": {"contact": "point"}}, None),
        ({"control": {"ego": {"kind": "own_stepped:Unknown"}}, "world": "barrels"}, None),
    ],
)
def test_the_reason_why_a_plant_is_discrete_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, changes: dict[str, Any], reason: str | None
) -> None:
    (tmp_path / "own_stepped.py").write_text(OWN_DRIVER)
    monkeypatch.syspath_prepend(tmp_path)
    spec = make_spec(diagram("bolt", **changes))
    lines = discrete_plant(spec, make_scene(spec))
    assert len(lines) == (reason is not None)
    for line in lines:
        assert str(reason) in line
        assert line.endswith("; the plant is therefore discrete, and the run takes longer")


@pytest.mark.parametrize("step", [0.004, 0.005])
def test_the_plant_is_made_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step: float) -> None:
    """Whether its steps would be divided, here by the 10 ms of the powertrain, is known from the data."""
    made = []

    def make(*arguments: Any, **settings: Any) -> PlantParts:
        made.append(make_plant(*arguments, **settings))
        return made[-1]

    monkeypatch.setattr("mirdrake.assembly.diagram.make_plant", make)
    on_ground(tmp_path, contact="tyre", step=step, record={"rate": 50.0})
    assert [solves_joints(parts.plant) for parts in made] == [step == 0.004]


def test_a_car_stops_at_a_wall(tmp_path: Path) -> None:
    """The contact of bodies is explicit: the car stops at the same place, and gains no energy."""
    world = tmp_path / "world.yaml"
    wall = {"prop": "wall", "size": [0.3, 6, 1], "at": [15, 0.3]}
    world.write_text(yaml.safe_dump({"mirdrake": "world/1", "ground": {"size": [200, 200]}, "props": [wall]}))
    ego = {"model": "bolt", "start": {"x": 0.0, "y": 0.0}, "speed": 8.0}
    drive = {"ego": {"kind": "constant", "speed": 8.0}}
    data = diagram(world=str(world), vehicles={"ego": ego}, control=drive)
    assembly = assemble(make_spec(data))
    assert not solves_joints(assembly.parts.plant)
    signals = signals_of(assembly)
    discrete = signals_of(assemble(make_spec(data), continuous=False))
    assert signals["ego.x"].iloc[-1] == pytest.approx(discrete["ego.x"].iloc[-1], abs=0.02)
    assert abs(signals["ego.vx"].iloc[-1]) < 0.02
    assert signals["ego.vx"].min() > -2.0
    assert signals["ego.z"].max() < 0.1


@pytest.mark.parametrize("step", [0.01, 0.005, 0.004])
def test_no_step_of_a_run_is_divided(tmp_path: Path, step: float) -> None:
    """The checks for a stop fall on steps. The powertrain has a period of 10 ms: with 4 ms the plant is discrete."""
    times: list[float] = []
    assembly = on_ground(tmp_path, contact="tyre", step=step, speed=10.0, record={"rate": 50.0, "report": False})
    assert (assembly.parts.plant.time_step() == 0.0) == (step != 0.004)
    Simulation(assembly).run(duration=1.0, monitor=lambda context: times.append(context.get_time()))
    if step != 0.004:
        assert set(np.unique(np.round(np.diff(times), 9))) <= {0.0, step}


def test_the_steering_follows_a_ramp_as_in_the_discrete_plant(tmp_path: Path) -> None:
    """0.1 rad/s at 12 m/s and steps of 10 ms: within 2e-5 rad, while the roll rate turns the axes of the wheels."""
    settings: dict[str, Any] = {"contact": "tyre", "step": 0.01, "speed": 12.0, "steering": 0.05}
    spec = on_ground(tmp_path, **settings).spec
    angles = [
        Simulation(assemble(spec, continuous=continuous)).run(duration=0.5).signals["ego.steering_angle.left"]
        for continuous in (True, False)
    ]
    assert angles[1].iloc[-1] > 0.04
    assert np.abs(angles[0] - angles[1]).max() < 2e-5


def test_a_simulator_begins_at_the_time_of_its_context() -> None:
    """As a linear model does, which advances copies of a Context by one period."""
    assembly = assemble(
        make_spec({"world": "empty", "vehicles": {"ego": {"model": "bolt"}}, "plant": {"contact": "tyre"}})
    )
    assert not solves_joints(assembly.parts.plant)
    context = assembly.make_context()
    context.SetTime(1.5)
    assert assembly.make_simulator(context).get_context().get_time() == 1.5
