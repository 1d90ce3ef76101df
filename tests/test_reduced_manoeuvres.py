"""Manoeuvres with the single-track model: the Drake diagram of the same model and driver, and many cars at once."""

import time
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from pydrake.systems.analysis import ResetIntegratorFromFlags, Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput

from mirdrake.core.errors import ConfigError
from mirdrake.core.vectors import STATE
from mirdrake.manoeuvres import Rig, find_facts
from mirdrake.manoeuvres.base import Outcome
from mirdrake.manoeuvres.drivers import OpenLoopDriver, PathDriver
from mirdrake.manoeuvres.open_loop import StepSteerSpec
from mirdrake.manoeuvres.reduced import RATE, ReducedLog, ReducedParameters, ReducedRun, simulate
from mirdrake.manoeuvres.registry import MANOEUVRES, run_manoeuvre
from mirdrake.manoeuvres.straight import BrakingSpec
from mirdrake.manoeuvres.together import run_manoeuvres
from mirdrake.single_track import SingleTrack, SingleTrackControl, estimate_parameters
from mirdrake.single_track.dynamics import Variant
from mirdrake.single_track.from_vehicle import has_roll, tyres_of
from mirdrake.single_track.powertrain import SingleTrackPowertrain, make_single_track_law
from mirdrake.studies import load_results, run_study
from mirdrake.vehicles import load_vehicle

STEP = 0.0005
"""Step of both integrators [s]. Near standstill brakes have a pole at 100 1/s: there the methods of third and fourth
order differ by 3e-6 m/s at 1 ms, 3e-7 at 0.5 ms and 5e-8 at 0.25 ms."""


@cache
def rig_of(name: str) -> Rig:
    vehicle = load_vehicle(name)
    return Rig(name, vehicle, find_facts(vehicle), kind="single_track")


def drive_in_drake(run: ReducedRun) -> dict[str, np.ndarray]:
    """Return the signals of a run by Drake, with Runge-Kutta steps of third order."""
    vehicle, settings = run.car.vehicle, dict(run.driver)
    kind = settings.pop("kind")
    driver = OpenLoopDriver(**settings) if kind.endswith("OpenLoopDriver") else PathDriver(vehicle=vehicle, **settings)
    roll = has_roll(vehicle)
    parameters = estimate_parameters(vehicle, friction=run.friction, gravity=run.gravity, roll=roll)
    builder = DiagramBuilder()
    variant = Variant(tyres_of(vehicle), relaxation=True, actuators=True, roll=roll)
    model = builder.AddSystem(SingleTrack(parameters, variant))
    mass, rotating = parameters.mass, parameters.rotating_mass
    control = builder.AddSystem(SingleTrackControl(vehicle, mass=mass, rotating=rotating))
    builder.AddSystem(driver)
    builder.Connect(control.steering, model.steering)
    if control.HasOutputPort("pedals"):
        powertrain = builder.AddSystem(
            SingleTrackPowertrain(make_single_track_law(vehicle, mass=mass, rotating=rotating))
        )
        pedals = driver.GetOutputPort("pedals") if driver.HasOutputPort("pedals") else control.pedals
        builder.Connect(pedals, powertrain.pedals)
        builder.Connect(model.state, powertrain.state)
        builder.Connect(powertrain.forces, model.forces)
    else:
        builder.Connect(control.forces, model.forces)
    for port in (control.state, driver.state):
        builder.Connect(model.state, port)
    builder.Connect(model.steering_angle, control.steering_angle)
    builder.Connect(driver.command, control.command)
    logs = [LogVectorOutput(port, builder, publish_period=1.0 / RATE) for port in (model.state, model.steering_angle)]
    simulator = Simulator(builder.Build())
    ResetIntegratorFromFlags(simulator, "runge_kutta3", STEP)
    simulator.get_mutable_integrator().set_fixed_step_mode(True)
    context = simulator.get_mutable_context()
    model.set_state(model.GetMyContextFromRoot(context), x=run.x, y=run.y, vx=run.speed)
    simulator.AdvanceTo(run.duration)
    state, steering = (log.FindLog(context).data() for log in logs)
    named = {signal.name: row for signal, row in zip(STATE, state, strict=True)}
    return named | {"steering_angle": steering[0]}


def last_run(rig: Rig, name: str, **settings: Any) -> ReducedRun:
    """Return the last run of a manoeuvre."""
    runs = []

    def keep(run: ReducedRun) -> ReducedLog:
        runs.append(run)
        return rig.simulate(run)

    run_manoeuvre(name, replace(rig, simulate=keep), MANOEUVRES[name](**settings))
    return runs[-1]


@pytest.mark.parametrize(
    ("vehicle", "name", "duration"),
    [
        ("bolt@handling", "step_steer", 3.0),  # speed control by pedals, steering over time
        ("bolt@handling", "braking", 5.0),  # pedals over time along a line; regenerative and friction brakes
        ("bolt", "steady_state_circle", 4.0),  # servos on the wheels, a circle, a ramp of speed
    ],
)
def test_a_run_is_that_of_the_drake_diagram(vehicle, name, duration):
    run = replace(last_run(rig_of(vehicle), name), stop=None, duration=duration)
    (log,) = simulate([run], ReducedParameters(), longest_step=STEP)
    theirs = drive_in_drake(run)
    assert isinstance(log, ReducedLog)
    assert len(log.time) == len(theirs["vx"])
    for signal in ("vx", "vy", "wz", "steering_angle", "roll"):
        assert log.columns[signal] == pytest.approx(theirs[signal], abs=1e-6), signal
    for signal in ("x", "y", "yaw"):
        assert log.columns[signal] == pytest.approx(theirs[signal], abs=1e-5), signal


@pytest.mark.slow
@pytest.mark.parametrize(
    ("vehicle", "name"),
    [("mkz@handling", "acceleration"), ("bolt@handling", "skidpad"), ("unior@handling", "slalom"),
     ("bolt@handling", "sine_with_dwell"), ("bolt@handling", "coast_down")],
)  # fmt: skip
def test_long_runs_are_those_of_the_drake_diagram(vehicle, name):
    """An engine that shifts, lines that cross themselves, a small robot, a spin, neutral gear."""
    run = last_run(rig_of(vehicle), name)
    run = replace(run, stop=None, duration=min(run.duration, 20.0))
    (log,) = simulate([run], ReducedParameters(), longest_step=STEP)
    theirs = drive_in_drake(run)
    assert isinstance(log, ReducedLog)
    assert log.columns["vx"] == pytest.approx(theirs["vx"], abs=1e-6)
    assert log.columns["wz"] == pytest.approx(theirs["wz"], abs=1e-6)


CANDIDATES: list[tuple[dict[str, float], dict[str, float], dict[str, Any]]] = [
    ({}, {}, {}),
    ({"mass": 1900.0, "front_stiffness": 80e3}, {}, {}),
    ({}, {"wheel_speed.kp": 3.0}, {"speed": 22.0}),
    ({"com_height": 0.7}, {}, {"lateral": 6.0, "turn": "right"}),
    ({"rear_stiffness": 30e3}, {}, {"lateral": 7.0}),  # spins
]


def test_candidates_that_drive_together_have_the_outcomes_of_single_runs():
    """They need different numbers of runs."""
    rig = rig_of("bolt@handling")
    rigs = [replace(rig, changes=changes, friction=0.85 - 0.1 * k) for k, (changes, _, _) in enumerate(CANDIDATES)]
    gains = {"wheel_speed.kp": rig.vehicle.control.wheel_speed.gain_values()[0]}
    rigs = [replace(one, gains=gains | own) for one, (_, own, _) in zip(rigs, CANDIDATES, strict=True)]
    specs = [StepSteerSpec(**settings) for _, _, settings in CANDIDATES]
    together = run_manoeuvres("step_steer", rigs, specs)
    alone = [run_manoeuvre("step_steer", one, spec) for one, spec in zip(rigs, specs, strict=True)]
    assert len({len(outcome.runs) for outcome in alone}) > 1
    assert len({outcome.verdict for outcome in alone}) > 1
    for ours, theirs in zip(together, alone, strict=True):
        assert isinstance(ours, Outcome)
        assert replace(ours, wall=0.0, charts=[]) == replace(theirs, wall=0.0, charts=[])


def test_a_fault_of_a_candidate_does_not_stop_the_others():
    rig = rig_of("bolt@handling")
    rigs = [rig, replace(rig, gains={"speed.kp": 1.0, "wheel_speed.kd": 1.0}), replace(rig, changes={"mass": 1700.0})]
    good, bad, heavy = run_manoeuvres("braking", rigs, [BrakingSpec()] * 3)
    assert isinstance(bad, ConfigError)
    assert "no gain 'wheel_speed.kd'" in str(bad)
    assert isinstance(good, Outcome)
    assert isinstance(heavy, Outcome)
    assert good.metrics == run_manoeuvre("braking", rig, BrakingSpec()).metrics
    assert good.value("distance_100") != heavy.value("distance_100")


def test_an_unknown_parameter_and_one_for_the_full_plant_are_errors():
    rig = rig_of("bolt@handling")
    with pytest.raises(ConfigError, match=r"single_track\.masss: no such parameter; did you mean 'mass'"):
        replace(rig, changes={"masss": 1.0})
    with pytest.raises(ConfigError, match=r"single_track\.mass: is a setting of the single-track model"):
        replace(rig, kind="full", changes={"mass": 1700.0})


STUDY: dict[str, Any] = {
    "manoeuvre": "braking",
    "vehicle": "bolt@handling",
    "model": "single_track",
    "parameters": {
        "single_track.mass": {"low": 1400.0, "high": 1900.0},
        "friction": {"low": 0.4, "high": 0.9},
        "braking.speed": {"low": 20.0, "high": 30.0},
    },
    "sampling": {"kind": "sobol", "runs": 8},
    "metrics": ["mfdd", "time"],
}


def test_a_study_of_a_manoeuvre_has_the_verdicts_and_figures_of_single_runs(tmp_path):
    result = run_study(STUDY, out=tmp_path / "out", workers=0)
    assert list(result.table.columns) == [
        *STUDY["parameters"],
        "status",
        "verdict",
        "reason",
        "simulated",
        "mfdd",
        "time",
    ]
    assert load_results(tmp_path / "out").arrow.equals(result.arrow)
    rig = rig_of("bolt@handling")
    for _, row in result.table.iterrows():
        own = replace(rig, friction=row["friction"], changes={"mass": row["single_track.mass"]})
        outcome = run_manoeuvre("braking", own, BrakingSpec(speed=row["braking.speed"]))
        assert (row["verdict"], row["mfdd"], row["time"]) == (
            outcome.verdict, outcome.value("mfdd"), outcome.value("time")
        )  # fmt: skip


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"manoeuvre": "brakin"}, "manoeuvre: unknown manoeuvre 'brakin'; did you mean 'braking'"),
        ({"metrics": ["mfd"]}, "metrics.0: braking has no figure 'mfd'; did you mean 'mfdd'"),
        (
            {"parameters": {"braking.speeed": {"values": [20.0]}}},
            "the manoeuvre has no setting 'braking.speeed'; did you",
        ),
        ({"parameters": {"braking.brake": {"values": [2.0]}}}, "parameters.braking.brake: .*2.0 is not allowed"),
        ({"parameters": {"single_track.mass": {"values": [-1.0]}}}, "parameters.single_track.mass: .*mass"),
        ({"model": "plant"}, "parameters.single_track.mass: .*leave it out for the full plant"),
        ({"duration": 5.0}, "duration: a manoeuvre ends by itself"),
        ({"vehicle": None}, "manoeuvre and vehicle belong together"),
    ],
)
def test_faults_of_a_study_of_a_manoeuvre_name_their_place(changes, text):
    with pytest.raises(ConfigError, match=text):
        run_study(STUDY | changes, workers=0)


@pytest.mark.slow
def test_ten_thousand_candidates_drive_a_manoeuvre_in_two_minutes_of_processor_time():
    run_study(STUDY, workers=0)  # machine code
    began = time.process_time()
    study = STUDY | {"manoeuvre": "step_steer", "metrics": ["yaw_response", "yaw_overshoot"]}
    study["parameters"] = {
        "single_track.mass": {"low": 1400.0, "high": 1900.0},
        "single_track.rear_stiffness": {"low": 90e3, "high": 150e3},
    }
    result = run_study(study | {"sampling": {"kind": "sobol", "runs": 10_000}}, workers=0)
    assert result.counts["ok"] == 10_000
    assert (result.table["verdict"] == "done").mean() > 0.9
    assert time.process_time() - began < 120.0
