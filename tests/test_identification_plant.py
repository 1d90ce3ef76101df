"""The full plant as a model: parameters come back from drives of a plant with cargo in its Context."""

import numpy as np
import pandas as pd
import pytest
from pydrake.math import RigidTransform

from mirdrake.core.constants import GRAVITY
from mirdrake.core.errors import ConfigError
from mirdrake.identification import DataSet, Log
from mirdrake.identification.channels import CHANNELS as CHANNEL_UNITS
from mirdrake.identification.estimators import EstimatorOptions, fit
from mirdrake.identification.estimators.segments import make_segments
from mirdrake.identification.identify import identify
from mirdrake.identification.models import ModelSpec, make_model
from mirdrake.identification.models.plant import PlantModel
from mirdrake.identification.models.plant_context import body_inertia, measure
from mirdrake.identification.parameters import Setting
from mirdrake.identification.study import load_identification
from tests.plant_drives import CARGO, data_set, drive_with_cargo, noisy

CHANNELS = (
    "vx", "vy", "yaw_rate", "longitudinal_acceleration", "lateral_acceleration", "road_wheel_angle", "drive_torque",
    "brake_torque",
)  # fmt: skip
QUICK = ModelSpec("plant", {"vehicle": "bolt@handling", "time_step": 0.01, "settle": 0.5})


def within(result, truth, name, part=0.02):
    parameter = result[name]
    assert parameter.value == pytest.approx(truth[name], rel=part)
    assert parameter.low < truth[name] < parameter.high


@pytest.fixture(scope="module")
def coasting():
    """A model, and a straight drive without torque from 15 m/s, with the wheels straight."""
    n = 150
    zero = np.zeros(n)
    time = np.arange(n) * np.float64(0.02)
    channels = {
        "road_wheel_angle": zero, "vx": 15.0 - 0.1 * time, "drive_torque": zero, "yaw_rate": zero,
    }  # fmt: skip
    log = Log("coasting", "train", time, {**channels, "yaw_rate": np.asarray(1e-6 * np.sin(50.0 * time))})
    options = {"vehicle": "bolt@handling", "time_step": 0.01, "settle": 0.5, "outputs": ["vx"]}
    model = make_model(ModelSpec("plant", options), DataSet((log,)), {})
    (drive,), _ = make_segments(model, (log,))
    return model, drive, {info.name: info.guess for info in model.parameters}


def deceleration(coasting, **changes):
    model, drive, p = coasting
    (vx,), last = model.run({**p, "steering_delay": 0.0, **changes}, drive, np.array([15.0]))
    assert last[0] == pytest.approx(vx[-1], abs=0.02)
    return -np.polyfit(drive.time[20:], vx[20:], 1)[0]


def test_the_base_body_takes_the_difference_in_mass_properties(coasting):
    model, _, _ = coasting
    *_, truth = drive_with_cargo(duration=0.1)
    plant, part = model.assembly.parts.plant, model.assembly.parts.vehicles["ego"]
    whole, rest = measure(plant, part), measure(plant, part, base=False)
    context = plant.CreateDefaultContext()
    plant.SetFloatingBaseBodyPoseInWorldFrame(context, part.base, RigidTransform())
    part.base.SetSpatialInertiaInBodyFrame(context, body_inertia(whole, rest, truth))
    inertia = plant.CalcSpatialInertia(context, plant.world_frame(), plant.GetBodyIndices(part.instance))
    tensor = inertia.Shift(inertia.get_com()).CalcRotationalInertia().CopyToFullMatrix3()
    assert inertia.get_mass() == pytest.approx(truth["mass"])
    assert inertia.get_com()[0] == pytest.approx(truth["rear_length"])
    assert inertia.get_com()[2] == pytest.approx(truth["com_height"])
    assert tensor[2, 2] == pytest.approx(truth["yaw_inertia"])
    assert tensor[0, 0] == pytest.approx(whole.inertia[0, 0])
    assert truth["mass"] == pytest.approx(whole.mass + sum(mass for mass, _ in CARGO))
    with pytest.raises(ValueError, match="wheels alone"):
        body_inertia(whole, rest, {**truth, "mass": 0.5 * rest.mass})
    with pytest.raises(ValueError, match="inertia"):
        body_inertia(whole, rest, {**truth, "yaw_inertia": 1.0})


def test_resistances_in_the_context_decelerate_as_computed(coasting):
    model, _, p = coasting
    radius = float(np.mean(model.assembly.parts.vehicles["ego"].vehicle.geometry.wheel_radii))
    free = deceleration(coasting)
    # What turns with the wheels and the motor makes the car a few per cent heavier than its mass.
    rolling = deceleration(coasting, rolling_resistance=p["rolling_resistance"] + 0.02) - free
    assert 0.92 < rolling / (0.02 * GRAVITY) < 1.0
    damped = deceleration(coasting, wheel_damping=2.0) - free
    assert 0.92 < damped / (4 * 2.0 * 14.5 / radius**2 / p["mass"]) < 1.02
    # Air brakes a heavy car less; rolling resistance goes with the mass.
    light = p["rolling_resistance"] * GRAVITY
    assert deceleration(coasting, mass=1.2 * p["mass"]) == pytest.approx(light + (free - light) / 1.2, rel=0.03)
    assert deceleration(coasting) == free


def test_accelerations_of_short_steps_are_the_slopes_of_the_speed():
    """A step of 0.3 ms is below the shortest period of the record, 0.5 ms; every other step is a sample."""
    time = np.arange(0.0, 0.3, 0.01)
    zero = 0.0 * time
    channels = {"road_wheel_angle": zero, "vx": 15.0 - 0.1 * time, "drive_torque": zero - 500.0}
    log = Log("braking", "train", time, {**channels, "longitudinal_acceleration": zero + 1e-6 * np.sin(50.0 * time)})
    options = {"vehicle": "bolt@handling", "time_step": 3e-4, "settle": 0.2}
    model = make_model(ModelSpec("plant", options), DataSet((log,)), {})
    assert isinstance(model, PlantModel)
    (drive,), _ = make_segments(model, (log,))
    run = model.run({info.name: info.guess for info in model.parameters}, drive, np.array([15.0]))
    assert run is not None
    y = run[0]
    vx, acceleration = y[model.outputs.index("vx")], y[model.outputs.index("longitudinal_acceleration")]
    slope = (vx[-2] - vx[10]) / (time[-2] - time[10])
    assert slope < -0.2
    assert acceleration[10:-1].mean() == pytest.approx(slope, rel=0.05)


def test_impossible_parameters_give_no_run(coasting):
    model, drive, p = coasting
    assert model.run({**p, "yaw_inertia": 1.0}, drive, np.array([15.0])) is None


@pytest.mark.slow
def test_mass_and_yaw_inertia_come_back():
    exact = drive_with_cargo(duration=2.0, step=0.01)
    truth = exact[2]
    settings = {name: Setting(fixed=truth[name]) for name in ("rear_length", "com_height")}
    settings |= {"steering_offset": Setting(free=False)}
    settings |= {"mass": Setting(guess=1800.0), "yaw_inertia": Setting(guess=3700.0)}
    options = EstimatorOptions(offsets=False, iterations=3)
    result = fit(data_set(noisy(exact, names=CHANNELS, every=1)), QUICK, parameters=settings, options=options)
    within(result, truth, "mass")
    assert result["yaw_inertia"].value == pytest.approx(truth["yaw_inertia"], rel=0.04)
    assert result["yaw_inertia"].low < truth["yaw_inertia"] < result["yaw_inertia"].high


@pytest.mark.slow
def test_more_parameters_and_a_validation_log_in_a_study(tmp_path):
    exact = drive_with_cargo(duration=6.0)
    truth = exact[2]
    for seed, name in ((1, "first"), (2, "second")):
        log = noisy(exact, seed=seed, names=CHANNELS)
        pd.DataFrame({"time": log.time, **log.channels}).to_csv(tmp_path / f"{name}.csv", index=False)
    mapped = "\n".join(f"    {name}: {{column: {name}, unit: {CHANNEL_UNITS[name].unit}}}" for name in CHANNELS)
    (tmp_path / "cargo.yaml").write_text(f"""\
mirdrake: identification/1
data:
  logs:
    - {{file: first.csv}}
    - {{file: second.csv, use: validation}}
  channels:
{mapped}
vehicle: bolt@handling
model: {{kind: plant, contact: point, time_step: 0.005}}
parameters:
  com_height: {{fixed: {truth["com_height"]} m}}
  rear_length: {{low: 1.0, high: 2.0}}
  steering_offset: {{free: false}}
""")
    identification = identify(load_identification(tmp_path / "cargo.yaml"), tmp_path)
    for name in ("mass", "yaw_inertia"):
        within(identification.fit, truth, name)
    # What is left of the steering's give and hold looks like a shifted centre of mass; its interval does not know that.
    assert identification.fit["rear_length"].value == pytest.approx(truth["rear_length"], rel=0.025)
    assert abs(identification.fit["steering_delay"].value) < 0.004
    assert identification.fit.channel("yaw_rate").nrmse_percent > 90.0
    assert identification.fit["mass"].verdict == "contradicts the given value"


@pytest.mark.parametrize(
    ("options", "missing", "words"),
    [
        ({"vehicle": None}, "", "needs a vehicle"),
        ({"drive": "pedal"}, "", "model.drive: 'pedal' is not allowed; allowed: .*'pedals'"),
        ({"drive": "pedals"}, "", "needs channel 'throttle'"),
        ({"vehicle": "bolt", "drive": "torque"}, "", "needs a vehicle with a tyre model"),
        ({"contact": "points"}, "", "model.contact: 'points' is not allowed; allowed: 'hydroelastic'"),
        ({"settle": -1.0}, "", "model.settle"),
        ({"time_step": 0.0}, "", "model.time_step"),
        ({"time_steps": 0.01}, "", "model.time_steps: unknown field; did you mean 'time_step'"),
        ({"outputs": ["jerk"]}, "", "no output 'jerk'"),
        ({}, "road_wheel_angle", "needs the steering"),
    ],
)
def test_impossible_options_raise_an_error(options, missing, words):
    time = np.arange(0.0, 1.0, 0.01)
    channels = {name: np.sin(time) for name in CHANNELS if name != missing}
    data = DataSet((Log("drive", "train", time, channels),))
    with pytest.raises(ConfigError, match=words):
        make_model(ModelSpec("plant", {"vehicle": "bolt@handling"} | options), data, {})


def test_the_drive_input_follows_the_channels():
    time = np.arange(0.0, 1.0, 0.01)
    channels = {name: np.sin(time) for name in ("vx", "yaw_rate", "road_wheel_angle")}
    model = make_model(ModelSpec("plant", {"vehicle": "bolt"}), DataSet((Log("a", "train", time, channels),)), {})
    assert isinstance(model, PlantModel)
    assert model.outputs == ("yaw_rate",)
    assert "rolling_resistance" not in {info.name for info in model.parameters}
    (drive,), _ = make_segments(model, (Log("a", "train", time, {**channels, "vx": 8.0 + 0.0 * time}),))
    run = model.run({info.name: info.guess for info in model.parameters}, drive, np.array([8.0]))
    assert run is not None
    assert np.isfinite(run[0]).all()
