"""Batches of cars: the bits of the single model, closed forms, dead cars, threads, errors, the speed."""

import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest

import mirdrake as mir
from mirdrake.batched import Batch, BatchRun, Ground
from mirdrake.core.errors import ConfigError
from mirdrake.single_track import SingleTrackParameters, estimate_parameters, find_steady_state
from mirdrake.single_track.dynamics import CompiledEquations, Variant
from mirdrake.single_track.parameters import PARAMETERS
from mirdrake.vehicles import load_vehicle
from tests.batch_rigs import BRUSH, CAR, LINEAR, MAGIC, RICH, STEP, random_columns, runge_kutta_steps


def car_of(cars, index):
    """Return parameters of one car of a batch."""
    return SingleTrackParameters(**{name: float(cars.parameters[name][index]) for name in PARAMETERS})


def inputs_of(variant):
    """Return steering, drive force and, with actuators, a set-point of the speed."""
    return [0.03, 400.0, 0.0, 0.0, 25.0][: len(variant.input_names)]


def compare(variant, count, steps):
    cars = mir.batch(CAR, variant, parameters=random_columns(count), step=STEP).reset(vx=np.linspace(0.5, 30.0, count))
    starts = cars.state.copy()
    cars.step(inputs_of(variant), steps)
    for index in range(count):
        alone = runge_kutta_steps(variant, car_of(cars, index), starts[index], inputs_of(variant), steps)
        assert cars.state[index].tolist() == alone.tolist()


@pytest.mark.parametrize("variant", [LINEAR, RICH, MAGIC], ids=["linear", "rich", "magic_formula"])
def test_a_batch_has_the_bits_of_the_equations_in_python(variant):
    compare(variant, count=4, steps=60)


@pytest.mark.slow
@pytest.mark.parametrize("variant", [LINEAR, BRUSH, RICH], ids=["linear", "brush", "rich"])
def test_a_batch_has_the_bits_of_the_equations_in_python_over_ten_seconds(variant):
    compare(variant, count=50, steps=2000)


def test_a_batch_has_the_bits_of_the_compiled_equations_of_the_single_model():
    cars = mir.batch(CAR, RICH, step=STEP).reset(vx=20.0)
    single, u = CompiledEquations(RICH), inputs_of(RICH)
    x = cars.state[0].copy()
    for _ in range(100):
        k: list[np.ndarray] = []
        for time_, of in ((0.0, None), (0.5 * STEP, 0), (0.5 * STEP, 1), (STEP, 2)):
            stage = x if of is None else x + time_ * k[of]
            k.append(single(single.parameters(np.array(CAR.values())), stage, single.inputs(u))[0])
        x = x + STEP / 6.0 * (k[0] + 2.0 * (k[1] + k[2]) + k[3])
    cars.step(u, 100)
    assert cars.state[0].tolist() == x.tolist()


def test_one_call_many_calls_and_a_run_are_the_same():
    first, many, whole = (mir.batch(CAR, BRUSH, parameters=random_columns(5)).reset(vx=15.0) for _ in range(3))
    first.step([0.05, 0.0, 0.0], 40)
    for _ in range(10):
        many.step([0.05, 0.0, 0.0], 4)
    run = whole.run(np.tile([0.05, 0.0, 0.0], (10, 1)), hold=4)
    assert first.state.tolist() == many.state.tolist() == whole.state.tolist()
    assert run.values[:, -1, :6].tolist() == whole.state.tolist()
    assert first.time == pytest.approx(0.2)
    assert run.time.tolist() == pytest.approx(np.linspace(0.0, 0.2, 11).tolist())


def test_threads_do_not_change_the_bits():
    single, divided = (mir.batch(CAR, RICH, parameters=random_columns(7), threads=k).reset(vx=15.0) for k in (1, 2))
    for cars in (single, divided):
        cars.step(inputs_of(RICH), 50)
    assert single.state.tolist() == divided.state.tolist()


def test_coasting_cars_slow_down_as_the_closed_form_of_drag():
    # m v' = -c v²: v = v0 / (1 + c v0 t / m)
    drag = np.array([0.3, 0.6, 0.9])
    car = replace(CAR, rolling_resistance=0.0, rotating_mass=0.0)
    run = mir.batch(car, BRUSH, parameters={"drag": drag}).reset(vx=30.0).run(np.zeros((200, 3)), hold=10)
    expected = 30.0 / (1.0 + np.outer(drag, run.time) * 30.0 / 1500.0)
    assert run["vx"] == pytest.approx(expected, rel=1e-10)
    assert run["longitudinal_acceleration"] == pytest.approx(-drag[:, None] * run["vx"] ** 2 / 1500.0, rel=1e-10)


def test_the_steady_circle_remains_one():
    car = replace(CAR, max_force=1e6)
    steady = find_steady_state(car, RICH, speed=15.0, steering=0.05)
    cars = mir.batch(car, RICH, count=3)
    cars.state[:] = steady.state
    cars.step(steady.inputs, 1000)
    assert cars.state[:, 3:] == pytest.approx(np.tile(steady.state[3:], (3, 1)), rel=1e-8, abs=1e-12)
    assert cars["yaw"] == pytest.approx(5.0 * steady["yaw_rate"], rel=1e-8)


def test_a_failed_car_is_reported_and_the_others_continue():
    cars, alone = (mir.batch(CAR, BRUSH, count=n).reset(vx=15.0) for n in (3, 1))
    cars.state[1, 3] = 1e300
    for each in (cars, alone):
        each.step([0.05, 0.0, 0.0], 50)
    assert cars.diverged_cars.tolist() == [1]
    assert cars.state[0].tolist() == cars.state[2].tolist() == alone.state[0].tolist()
    run = cars.run(np.zeros((2, 3)))
    assert np.isnan(run["vx"][1]).all()
    assert np.isfinite(run["vx"][[0, 2]]).all()
    assert run.diverged.tolist() == [1]
    cars.reset([1], vx=15.0)
    assert cars.diverged_cars.tolist() == []
    assert cars["vx"][1] == 15.0 != cars["vx"][0]


def test_a_run_is_labelled():
    run = mir.batch(CAR, RICH, count=2).reset(vx=10.0).run(np.zeros((5, 5)))
    assert isinstance(run, BatchRun)
    assert run.names[:4] == ["x", "y", "yaw", "vx"]
    assert run.units["yaw_rate"] == "rad/s"
    table = run.table(1)
    assert table.index.name == "time"
    assert table.attrs["units"]["vx"] == "m/s"
    assert table["vx"].tolist() == run["vx"][1].tolist()


def test_a_hill_a_patch_of_ice_and_a_gust_act_by_place():
    # Level for x < 0, then a rise of 5 %: a coasting car without losses has v² = v0² - 2 g' x, g' = g sin(atan 0.05).
    x = np.linspace(-50.0, 50.0, 1001)
    hill = Ground(x, [-1.0, 1.0], slope_x=np.where(x[:, None] > 0.0, 0.05, 0.0) * np.ones((1, 2)))
    free = replace(CAR, rolling_resistance=0.0, drag=0.0, rotating_mass=0.0)
    run = mir.batch(free, BRUSH, ground=hill, step=0.001).reset(x=-5.0, vx=10.0).run(np.zeros((250, 3)), hold=10)
    position, speed = run["x"][0], run["vx"][0]
    down = 9.80665 * np.sin(np.arctan(0.05))
    on_hill = position > 0.1
    assert speed[on_hill] == pytest.approx(np.sqrt(100.0 - 2.0 * down * (position[on_hill] - 0.05)), rel=1e-4)
    assert (speed[position < 0.0] == 10.0).all()

    # Ice halves the drive force that the tyres can take: 0.98 of friction times load, for rear and front together.
    ice = Ground([-1e3, 1e3], [-1e3, 1e3], friction=0.1)
    car = replace(free, front_drive=0.5, com_height=0.0, max_force=1e6)
    cars = mir.batch(car, BRUSH, ground=ice).reset(vx=10.0)
    cars.step([0.0, 1e5, 0.0], 200)
    assert cars["vx"] == pytest.approx(10.0 + 0.98 * 0.1 * 9.80665, rel=1e-9)

    gust = Ground([-1e3, 1e3], [-1e3, 1e3], wind_x=10.0)
    cars = mir.batch(replace(free, drag=0.5), BRUSH, ground=gust).reset(vx=10.0)
    cars.step([0.0, 0.0, 0.0], 200)
    assert cars["vx"][0] == pytest.approx(10.0, abs=1e-12)


def test_a_car_that_only_the_check_of_the_table_rejects_raises_an_error(monkeypatch):
    monkeypatch.setattr("mirdrake.batched.table.are_allowed", lambda table: np.arange(len(table)) != 1)
    with pytest.raises(ConfigError, match="car 1: a parameter is out of range: mass=1000"):
        mir.batch(CAR, parameters={"mass": [900.0, 1000.0]})


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: Ground([0.0, 1.0, 3.0], [0.0, 1.0]), "x must be two or more evenly spaced"),
        (lambda: Ground([0.0, 1.0], [0.0, 1.0], friction=[1.0, 0.5]), r"friction has the shape \(2,\)"),
        (lambda: Ground([0.0, 1.0], [0.0, 1.0], friction=0.0), "friction is 0; it must be above 0"),
        (lambda: mir.batch(CAR, parameters={"mas": [1.0]}), "no parameter 'mas'.*mass"),
        (lambda: mir.batch(CAR, parameters={"mass": [1e3, 2e3], "drag": [1.0]}), "'drag' has 1 values.*2 cars"),
        (lambda: mir.batch(CAR, parameters={"mass": [1e3, -1.0]}), "car 1: .*mass"),
        (lambda: mir.batch(CAR, parameters={"roll_stiffness": [6e4, 10.0]}), "car 1: .*roll_stiffness"),
        (lambda: mir.batch(CAR, parameters={"drag": [np.nan]}), "car 0: .*drag"),
        (lambda: mir.batch(CAR, count=0), "0 cars"),
        (lambda: mir.batch(CAR, threads=0), "threads is 0"),
        (lambda: mir.batch(CAR, Variant("ice")), "unknown tyres 'ice'"),
        (lambda: mir.batch(CAR, count=2).step([0.0, 0.0]), r"shape \(2,\); give \(3,\)"),
        (lambda: mir.batch(CAR, count=2).step(np.zeros((3, 3))), r"shape \(3, 3\)"),
        (lambda: mir.batch(CAR, count=2).run([0.0, 0.0, 0.0]), r"give \(times, 3\)"),
        (lambda: mir.batch(CAR).reset(v=1.0), "no state 'v'"),
        (lambda: mir.batch(CAR).run(np.zeros((1, 3)))["speed"], "no signal 'speed'"),
        (lambda: mir.batch(CAR).run(np.zeros((1, 3))).table(1), "no car 1"),
    ],
)
def test_errors_name_the_faulty_value(call, message):
    with pytest.raises(ConfigError, match=message):
        call()


def test_a_vehicle_gives_its_parameters():
    cars = mir.batch("bolt", count=2)
    assert isinstance(cars, Batch)
    assert cars.parameters["mass"].tolist() == [estimate_parameters(load_vehicle("bolt")).mass] * 2


def test_a_batch_starts_without_the_plant_and_pandas():
    """The start from cached machine code takes less than a second only without these imports."""
    code = "import sys, mirdrake.batched; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    heavy = {"pandas", "scipy", "shapely", "pydrake.multibody", "mirdrake.vehicles", "mirdrake.controllers"}
    assert heavy & set(done.stdout.split()) == set()


@pytest.mark.slow
def test_the_rate_per_core():
    cars = mir.batch(CAR, RICH, count=4096).reset(vx=20.0)
    cars.step(inputs_of(RICH), 1)
    rates = []
    for _ in range(5):
        began = time.process_time()
        cars.step(inputs_of(RICH), 100)
        rates.append(4096 * 100 / (time.process_time() - began))
    assert max(rates) >= 2.0e6


_START = """
import time
import mirdrake as mir
from mirdrake.single_track.dynamics import Variant
from tests.batch_rigs import CAR
mir.batch(CAR, Variant("brush"), count=10).reset(vx=20.0).step([0.02, 0.0, 0.0])
print(time.process_time())
"""


@pytest.mark.slow
def test_a_process_steps_within_a_second_of_its_start():
    """Kept machine code; processor time, which includes the start of Python."""
    seconds = []
    for _ in range(3):
        done = subprocess.run([sys.executable, "-c", _START], capture_output=True, text=True, check=True)
        seconds.append(float(done.stdout))
    assert min(seconds[1:]) < 1.0
