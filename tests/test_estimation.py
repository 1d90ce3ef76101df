"""Filter bank: closed forms, weights of hypotheses, bit-equality, missing values, errors, the LeafSystem."""

import json
import time
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, LogVectorOutput
from scipy.linalg import expm

import mirdrake as mir
from benchmarks.calibration.filters import draw, judge
from mirdrake.cli import main
from mirdrake.core.errors import ConfigError
from mirdrake.estimation import FilterBank, FilterSpec
from mirdrake.estimation.kernel import triangularise
from mirdrake.estimation.system import OnlineFilter
from mirdrake.estimation.tyre_laws import friction_difference
from mirdrake.identification import load_data
from mirdrake.identification.filter_log import filter_log
from mirdrake.single_track import linearize_single_track
from mirdrake.single_track.dynamics import Variant, lateral_forces
from tests.batch_rigs import CAR

PERIOD = 0.02
SENSORS = {"steering": 0.001, "vx": 0.05, "yaw_rate": 0.005, "lateral_acceleration": 0.1}


BRUSH = Variant("brush", relaxation=True)


def drive(span=10.0, parameters=None, seed=0, force=600.0):
    """Return measurements (t, 4), forces (t, 2) and the run of a slalom with slow changes of the speed."""
    fine = 4
    times = np.arange(0.0, span, PERIOD / fine)
    steering = 0.04 * np.sin(1.9 * times) * np.minimum(times, 1.0)
    drive_force = force * (1.0 + np.sin(0.5 * times))
    inputs = np.stack([steering, drive_force, np.zeros(len(times))], axis=1)
    run = mir.batch(CAR, BRUSH, parameters=parameters, step=PERIOD / fine).reset(vx=20.0).run(inputs, hold=1)
    seen = np.stack([np.append(steering, 0.0), *(run[name][0] for name in list(SENSORS)[1:])], axis=1)[:-1:fine]
    noise = np.random.default_rng(seed).normal(size=seen.shape) * list(SENSORS.values())
    return seen + noise, inputs[::fine, 1:], run


def test_triangular_factors_are_those_of_a_qr_decomposition():
    given = np.random.default_rng(0).normal(size=(4, 9))
    expected = np.linalg.qr(given.T)[1].T
    expected = expected * np.sign(np.diag(expected))
    array = given.copy()
    triangularise(array, 4, 9)
    assert np.tril(array[:, :4]) == pytest.approx(expected, rel=1e-12)
    assert np.tril(array[:, :4]) @ np.tril(array[:, :4]).T == pytest.approx(given @ given.T, rel=1e-12)


def test_a_linear_motion_has_the_estimates_of_the_kalman_filter():
    # Straight on at 20 m/s with deviations so small that the car is linear: its matrices by the matrix exponential.
    spec = FilterSpec(
        tyres="linear", adaptation_time=0.0, sensors={**SENSORS, "steering": {"noise": 1e-3, "bias": 2e-3}}
    )
    bank = FilterBank(CAR, spec).reset(vx=20.0, steering=0.0)
    names, tiny = list(bank.names), 1e-4
    memory = bank._groups[0].memory
    memory.root[...] *= tiny
    memory.process[...] *= tiny**2
    memory.noise[...] *= tiny**2
    mean, covariance = memory.mean[0].copy(), memory.root[0] @ memory.root[0].T
    process, noise = memory.process[0].copy(), np.diag(memory.noise[0])

    linear = linearize_single_track(CAR, Variant("linear", relaxation=True), speed=20.0)
    model = ["vx", "vy", "yaw_rate", "front_slip", "rear_slip"]
    part = linear.part(states=model, inputs=["steering", "drive"], outputs=["lateral_acceleration"])
    # The car slows down by drag and rolling resistance: the drive force holds the speed.
    forces = np.array([linear.steady["drive"], 0.0])
    n, h = len(names), PERIOD / bank.steps
    rows = [names.index(name) for name in model]
    # Half of the push of the accelerations; a step under the steering angle in its middle, which changes linearly.
    push, turn = np.eye(n), np.zeros((n, n + 1))
    for state, name in (("vx", "longitudinal"), ("vy", "lateral"), ("yaw_rate", "yaw")):
        push[names.index(state), names.index(f"{name}_disturbance")] = 0.5 * PERIOD
    block = expm(np.block([[part.A, part.B[:, :1]], [np.zeros((1, 6))]]) * h)
    transition = np.eye(n + 1)  # the last column: the acceleration of the steering
    for step in range(bank.steps):
        middle = (step + 0.5) * h
        turn = np.eye(n + 1)
        turn[np.ix_(rows, rows)] = block[:5, :5]
        for column, weight in ((0, 1.0), (1, middle), (n, 0.5 * middle**2)):
            turn[rows, column] = block[:5, 5] * weight
        transition = turn @ transition
    transition[0, 1], transition[0, n], transition[1, n] = PERIOD, 0.5 * PERIOD**2, PERIOD
    wide = np.block([[push, np.zeros((n, 1))], [np.zeros((1, n)), np.ones((1, 1))]])
    transition = (wide @ transition @ wide)[:n]
    for name, correlation_time in ((f"{kind}_disturbance", 0.5) for kind in ("longitudinal", "lateral", "yaw")):
        transition[names.index(name)] *= np.exp(-PERIOD / correlation_time)
    measure = np.zeros((4, n))
    for row, name in enumerate(("steering", "vx", "yaw_rate")):
        measure[row, names.index(name)] = 1.0
    measure[0, names.index("steering_bias")] = measure[3, names.index("lateral_disturbance")] = 1.0
    measure[3, rows] = part.C[0]
    measure[3, 0] = part.D[0, 0]

    random = np.random.default_rng(1)
    seen = np.array([0.0, 20.0, 0.0, 0.0]) + tiny * random.normal(size=(20, 4)) * list(SENSORS.values())
    found = bank.run(seen, np.tile(forces, (20, 1)))
    centre = np.zeros(n)
    centre[names.index("vx")] = 20.0
    x = mean - centre
    for k, y in enumerate(seen):
        if k:
            x = transition[:, :n] @ x
            noisy = transition[:, n:] * process[n] @ transition[:, n:].T
            covariance = transition[:, :n] @ covariance @ transition[:, :n].T + noisy + np.diag(process[:n])
        inside = measure @ covariance @ measure.T + noise
        innovation = y - measure @ (x + centre)
        gain = covariance @ measure.T @ np.linalg.inv(inside)
        x = x + gain @ innovation
        covariance = covariance - gain @ inside @ gain.T
        likelihood = -0.5 * (
            innovation @ np.linalg.solve(inside, innovation) + np.linalg.slogdet(2 * np.pi * inside)[1]
        )
        assert found.likelihoods[0, k] == pytest.approx(likelihood, rel=1e-5)
    sizes = np.sqrt(np.diag(covariance))
    assert (memory.mean[0] - centre) / sizes == pytest.approx(x / sizes, abs=2e-4)
    root = memory.root[0]
    assert root @ root.T / np.outer(sizes, sizes) == pytest.approx(covariance / np.outer(sizes, sizes), abs=2e-5)


def test_stiffness_and_bias_are_estimated_within_their_intervals():
    seen, forces, run = drive(span=30.0)
    seen[:, 0] += 0.004
    bank = mir.filter_bank(
        CAR, sensors={**SENSORS, "steering": {"noise": 0.001, "bias": 0.01}},
        parameters={"front_stiffness": 70e3, "rear_stiffness": 140e3},
        estimate={"front_stiffness": 0.3, "rear_stiffness": 0.3},
    )  # fmt: skip
    found = bank.run(seen, forces)
    for name, value in (("front_stiffness", 90e3), ("rear_stiffness", 110e3), ("steering_bias", 0.004)):
        low, high = (end[0, -1] for end in found.interval(name))
        assert low < value < high
        assert high - low < 0.3 * value + 0.002
    for name in ("vx", "vy", "yaw_rate"):
        low, high = (end[0, 500:] for end in found.interval(name))
        inside = (low < run[name][0, :-1:4][500:]) & (run[name][0, :-1:4][500:] < high)
        assert inside.mean() > 0.9
    assert found.consistent[0, 500:].mean() > 0.9
    assert bank.noise[0] == pytest.approx(list(SENSORS.values()), rel=0.2)


def test_noise_that_is_three_times_larger_is_found():
    seen, forces, _ = drive(span=40.0)
    given = {**SENSORS, "yaw_rate": SENSORS["yaw_rate"] / 3.0, "vx": 3.0 * SENSORS["vx"]}
    bank = mir.filter_bank(CAR, sensors=given)
    bank.run(seen, forces)
    assert bank.noise[0] == pytest.approx(list(SENSORS.values()), rel=0.25)


def test_the_weights_go_to_the_true_hypothesis():
    seen, forces, _ = drive(parameters={"mass": [1900.0]}, span=20.0)
    masses = [1300.0, 1500.0, 1700.0, 1900.0, 2100.0]
    # Forces are known: what remains of the longitudinal acceleration is small.
    settings: dict[str, Any] = {"longitudinal_disturbance": {"sigma": 0.05}}
    bank = mir.filter_bank(CAR, sensors=SENSORS, hypotheses=[{"parameters": {"mass": m}} for m in masses], **settings)
    found = bank.run(seen, forces)
    assert found.filters[3] == "mass=1900"
    assert found.weights[3, -1] > 0.99
    assert found.weights.sum(axis=0) == pytest.approx(1.0)
    mean, deviation = found.combined("vy")
    assert mean[-1] == pytest.approx(found["vy"][3, -1], abs=1e-3)
    assert deviation[-1] > 0.0
    # A tyre law as a hypothesis: two variants, each in its own compiled loop.
    laws = mir.filter_bank(CAR, sensors=SENSORS, hypotheses=[{"tyres": "linear"}, {"tyres": "brush"}], **settings)
    strong, forces, _ = drive(parameters={"front_friction": [0.3], "rear_friction": [0.3]}, span=10.0)
    laws = FilterBank(CAR, laws.spec.model_copy(update={"parameters": {"front_friction": 0.3, "rear_friction": 0.3}}))
    assert laws.run(strong, forces).weights[1, -1] > 0.99


def test_filters_of_a_bank_are_the_same_alone_and_step_by_step():
    seen, forces, _ = drive(span=2.0)
    seen[30:40, 2] = np.nan
    changes = [{"front_stiffness": c} for c in (70e3, 90e3, 110e3)]
    settings: dict[str, Any] = {"sensors": SENSORS, "estimate": {"friction": 0.1, "rear_stiffness": 0.2}}
    together = mir.filter_bank(CAR, hypotheses=[{"parameters": c} for c in changes], **settings).run(seen, forces)
    for row, change in enumerate(changes):
        bank = mir.filter_bank(CAR, parameters=change, **settings)
        alone = bank.run(seen, forces)
        assert alone.means[0].tolist() == together.means[row].tolist()
        assert alone.deviations[0].tolist() == together.deviations[row].tolist()
        assert alone.likelihoods[0].tolist() == together.likelihoods[row].tolist()
        bank.reset()
        steps = [bank.step(y, u) for y, u in zip(seen, forces, strict=True)]
        assert steps[-1].means[0, 0].tolist() == alone.means[0, -1].tolist()
        assert steps[-1].consistent[0, 0] == alone.consistent[0, -1]
        assert steps[-1].time[0] == pytest.approx(alone.time[-1])


def test_each_filter_may_have_its_own_car_and_log():
    logs = [drive(span=2.0, seed=seed) for seed in (1, 2)]
    bank = mir.filter_bank(CAR, sensors=SENSORS, hypotheses=[{"name": "first"}, {"name": "second"}])
    found = bank.run(np.stack([log[0] for log in logs]), logs[0][1])
    alone = mir.filter_bank(CAR, sensors=SENSORS).run(logs[1][0], logs[1][1])
    assert found["vy"][1].tolist() == alone["vy"][0].tolist()
    assert found.filters == ("first", "second")


def test_missing_measurements_widen_the_interval():
    seen, forces, _ = drive(span=4.0)
    seen[100:, 1:] = np.nan
    found = mir.filter_bank(CAR, sensors=SENSORS).run(seen, forces)
    low, high = found.interval("yaw_rate")
    assert (high - low)[0, -1] > 2.0 * (high - low)[0, 99]
    assert np.isfinite(found["yaw_rate"]).all()


def test_a_filter_begins_with_the_first_speed_that_is_measured():
    seen, forces, run = drive(span=2.0)
    seen[:5, 1] = np.nan
    bank = mir.filter_bank(CAR, sensors=SENSORS)
    steps = [bank.step(y, u) for y, u in zip(seen, forces, strict=True)]
    assert steps[-1]["vx"][0, 0] == pytest.approx(run["vx"][0, -5], abs=0.1)
    assert bank.reset().run(seen, forces)["vx"][0, 0] == pytest.approx(20.0, abs=0.3)


def test_a_filter_that_diverges_is_reported_and_the_others_continue():
    seen, forces, _ = drive(span=2.0)
    own = np.stack([seen, seen])
    own[0, 50, 1] = 1e300
    bank = mir.filter_bank(CAR, sensors=SENSORS, hypotheses=[{"name": "bad"}, {"name": "good"}])
    found = bank.run(own, forces)
    assert np.isnan(found["vy"][0, -1])
    assert np.isfinite(found["vy"][1]).all()
    assert found.weights[:, -1].tolist() == [0.0, 1.0]
    assert not found.consistent[0, -1]


def test_a_change_of_the_car_during_the_drive_is_followed():
    # Friction drops from 1.0 to 0.4 after 15 s.
    parts = [drive(span=15.0), drive(span=25.0, parameters={"front_friction": [0.4], "rear_friction": [0.4]})]
    seen, forces = (np.concatenate([part[i] for part in parts]) for i in (0, 1))
    hypotheses = [{"parameters": {"front_friction": f, "rear_friction": f}} for f in (1.0, 0.4)]
    bank = mir.filter_bank(CAR, sensors=SENSORS, hypotheses=hypotheses, switching_time=10.0)
    found = bank.run(seen, forces)
    assert found.weights[0, 700] > 0.9
    assert found.weights[1, -1] > 0.9


def test_estimates_are_tables():
    seen, forces, _ = drive(span=1.0)
    found = mir.filter_bank(CAR, sensors=SENSORS, estimate={"friction": 0.1}).run(seen, forces)
    table = found.table()
    assert table.attrs["units"]["vy_low"] == "m/s"
    assert (table["friction_low"] < table["friction"]).all()
    assert {"weight", "consistent"} <= {*table.columns}
    with pytest.raises(ConfigError, match="no quantity 'vyy'; did you mean 'vy'"):
        found["vyy"]
    with pytest.raises(ConfigError, match="no filter '7'"):
        found.table(7)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"sensors": ["yaw_rat"]}, "no sensor measures 'yaw_rat'; did you mean 'yaw_rate'"),
        ({"sensors": ["vx"]}, "the sensors have no 'steering'"),
        ({"sensors": ["steering", "roll"]}, "a filter without roll has no 'roll'"),
        ({"estimate": {"frction": 0.1}}, "no parameter 'frction'; did you mean 'friction'"),
        ({"estimate": {"friction": 0.1, "front_friction": 0.1}}, "'front_friction' is estimated twice"),
        ({"hypotheses": [{"tyres": "kinematic"}]}, "the kinematic model has no tyres"),
        ({"parameters": {"mas": 1.0}}, "no parameter 'mas'; did you mean 'mass'"),
        ({"perod": 0.1}, "did you mean 'period'"),
    ],
)
def test_wrong_settings_are_rejected(settings, message):
    with pytest.raises(ConfigError, match=message):
        mir.filter_bank(CAR, **settings)


def test_wrong_shapes_are_rejected():
    bank = mir.filter_bank(CAR)
    with pytest.raises(ConfigError, match="measurements have the shape"):
        bank.run(np.zeros((5, 3)))
    with pytest.raises(ConfigError, match="4 samples of forces, 5 of measurements"):
        bank.run(np.zeros((5, 4)), np.zeros((4, 2)))
    with pytest.raises(ConfigError, match="no state 'vz'"):
        bank.reset(vz=1.0)


def test_the_system_has_the_estimates_of_the_bank():
    bank = mir.filter_bank(CAR, sensors=SENSORS, hypotheses=[{}, {"parameters": {"mass": 1900.0}}])
    values = {"steering": 0.02, "vx": 20.0, "yaw_rate": 0.1, "lateral_acceleration": 2.0}
    builder = DiagramBuilder()
    system = builder.AddSystem(OnlineFilter(bank, known_forces=True))
    for name, value in {**{k: [v] for k, v in values.items()}, "forces": [500.0, 0.0]}.items():
        source = builder.AddSystem(ConstantVectorSource(value))
        builder.Connect(source.get_output_port(), system.GetInputPort(name))
    log = LogVectorOutput(system.GetOutputPort("estimate"), builder, PERIOD)
    weights = LogVectorOutput(system.GetOutputPort("weights"), builder, PERIOD)
    diagram = builder.Build()
    # Two contexts do not disturb each other.
    simulators = [Simulator(diagram) for _ in range(2)]
    for until in (0.1, 0.2):
        for simulator in simulators:
            simulator.AdvanceTo(until - 0.5 * PERIOD)
    rows = [log.FindLog(simulator.get_context()).data() for simulator in simulators]
    assert rows[0].tolist() == rows[1].tolist()
    alone = FilterBank(CAR, bank.spec)
    found = alone.run(np.tile(list(values.values()), (10, 1)), np.tile([500.0, 0.0], (10, 1)))
    expected = np.stack([found.combined(name)[0] for name in bank.names])
    assert rows[0][:, 1:10].tolist() == expected[:, :9].tolist()
    assert weights.FindLog(simulators[0].get_context()).data()[:, 9].tolist() == found.weights[:, 8].tolist()


def test_a_diagram_file_has_filter_banks():
    d = mir.Diagram(world="test_track", time_step=0.005)
    ego = d.add_vehicle("bolt", start="line")
    d.drive(ego, mir.PathTracking(track="main", speed=8.0))
    block = d.add(
        "estimator", "filter_bank", vehicle="bolt", sensors=["steering", "vx", "yaw_rate"], estimate={"friction": 0.1}
    )
    d.connect("ego.control.measurements.steering", block.steering)
    d.connect("ego.vx", block.vx)
    d.connect("ego.wz", block.yaw_rate)
    run = d.simulate(2.0)
    table = run.table
    assert table is not None
    assert table["estimator.estimate.vx"].iloc[-1] == pytest.approx(table["ego.vx"].iloc[-1], abs=0.1)


@pytest.mark.slow
def test_filters_take_at_least_ten_thousand_steps_per_core_second():
    seen, forces, _ = drive(span=20.0)
    hypotheses = [{"parameters": {"mass": m}} for m in np.linspace(1300.0, 1700.0, 20)]
    bank = mir.filter_bank(CAR, sensors=SENSORS, hypotheses=hypotheses, estimate={"friction": 0.1, "stiffness": 0.2})
    bank.run(seen[:2], forces[:2])
    began = time.process_time()
    bank.run(seen, forces)
    assert 20 * len(seen) / (time.process_time() - began) > 10_000


def test_a_log_is_filtered_by_its_channels(tmp_path, capsys):
    seen, _, _ = drive(span=6.0, force=100.0)
    table = pd.DataFrame(seen, columns=["road_wheel_angle", "vx", "yaw_rate", "lateral_acceleration"])
    table.insert(0, "time", PERIOD * np.arange(len(table)))
    table.to_csv(tmp_path / "drive.csv", index=False)
    units = ("rad", "m/s", "rad/s", "m/s^2")
    channels = {n: {"column": n, "unit": unit} for n, unit in zip(table.columns[1:], units, strict=True)}
    data = {
        "mirdrake": "data/1",
        "time": {"column": "time", "unit": "s"},
        "channels": channels,
        "logs": [{"file": "drive.csv"}],
    }
    (tmp_path / "drives.yaml").write_text(json.dumps(data))
    log = load_data(tmp_path / "drives.yaml").logs[0]
    spec = FilterSpec.model_validate({"sensors": list(SENSORS)})
    found = filter_log(log, CAR, spec)
    alone = FilterBank(CAR, spec.model_copy(update={"period": PERIOD})).run(seen)
    assert found["vy"] == pytest.approx(alone["vy"], abs=1e-6)
    with pytest.raises(ConfigError, match="no channel for the sensor 'roll'"):
        filter_log(log, CAR, FilterSpec.model_validate({"sensors": ["steering", "roll"], "roll": True}))

    out = tmp_path / "estimates.csv"
    code = main(["identify", "filter", str(tmp_path / "drives.yaml"), "bolt", "--out", str(out)])
    assert code in (0, 1)
    assert "front_stiffness" in capsys.readouterr().out
    assert len(pd.read_csv(out)) == len(seen)


@pytest.mark.parametrize("use", [0.2, 0.6, 1.2])
def test_another_tyre_law_explains_the_same_force_by_another_friction(use):
    """Linear force and limit of 1: the Magic Formula has the force of the brush at a limit that is smaller by d."""
    shape, curvature = 1.193, -1.003
    shaped = replace(CAR, front_shape=shape, front_curvature=curvature)
    brush, magic = lateral_forces()["brush"], lateral_forces()["magic_formula"]
    less = float(np.exp(-friction_difference("brush", np.array([use]), shaped)[0]))
    assert magic(use, 1.0, less, shape, curvature) == pytest.approx(brush(use, 1.0, 1.0, 1.3, 0.0), rel=2e-3)
    more = float(np.exp(friction_difference("magic_formula", np.array([use]), shaped)[0]))
    assert brush(use, 1.0, more, 1.3, 0.0) == pytest.approx(magic(use, 1.0, 1.0, shape, curvature), rel=2e-3)
    assert friction_difference("linear", np.array([use]), shaped) == 0.0
    assert friction_difference("brush", np.array([4.0]), shaped) < 0.01  # sliding tyres show their limit


@pytest.mark.slow
def test_intervals_of_drawn_vehicles_contain_the_truth():
    # Seeds that no setting was chosen by; half of the truths have effects that the filter lacks.
    records = [judge(drawn) for drawn in map(draw, range(1000, 1024)) if drawn is not None]
    cells = [
        covered
        for record in records
        for parameter in record["parameters"].values()
        for covered, consistent in zip(parameter["covered"], record["consistent"], strict=True)
        if consistent
    ]
    assert len(cells) > 150
    assert np.mean(cells) > 0.88
    assert np.mean([record["states"] for record in records]) > 0.93
