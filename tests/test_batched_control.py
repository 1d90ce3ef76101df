"""Control units in a batch: the Drake diagram of the same model, gains, delay, watchdog, noise, errors."""

import time
from dataclasses import replace

import numpy as np
import pytest
from pydrake.systems.analysis import ResetIntegratorFromFlags, Simulator
from pydrake.systems.framework import DiagramBuilder

import mirdrake as mir
from mirdrake.batched import BatchControl, PathDriver
from mirdrake.batched.noise import normal
from mirdrake.controllers import PathGains, PathTracker
from mirdrake.core.errors import ConfigError
from mirdrake.single_track import SingleTrackControl, estimate_parameters, make_single_track_vehicle
from mirdrake.single_track.dynamics import Variant
from mirdrake.tuning.loops.base import Course
from mirdrake.tuning.loops.judge import judge
from mirdrake.vehicles import load_vehicle
from mirdrake.vehicles.joint_control.pid import WheelPid
from mirdrake.vehicles.spec import RearSteering
from mirdrake.worlds import load_world

VARIANT = Variant("brush", relaxation=True, actuators=True)
START = {"x": -91.0, "y": -40.6, "yaw": 0.05, "vx": 5.0}  # beside the track
STEP, PERIOD = 0.001, 0.02  # [s]; forces at their limits have kinks, which need short steps


@pytest.fixture(scope="module")
def bolt():
    return load_vehicle("bolt")


@pytest.fixture(scope="module")
def parameters(bolt):
    return estimate_parameters(bolt)


def make_control(
    bolt, parameters, count=1, *, speed=5.0, columns=None, variant=VARIANT, step=STEP, threads=1, start=None, **options
):
    cars = mir.batch(parameters, variant, count=count, parameters=columns, step=step, threads=threads)
    cars.reset(**(start or {"vx": speed}))
    return BatchControl(cars, bolt, **options)


def course(duration):
    """Return steps of the speed and a slalom; speed [m/s] and steering [rad] per control period."""
    t = np.arange(round(duration / PERIOD)) * PERIOD
    speed = np.select([t < duration / 3, t < 2 * duration / 3], [8.0, 3.0], 12.0)
    return np.column_stack([speed, 0.1 * np.sin(0.3 * t)])


def drive_in_drake(vehicle, parameters, commands, delay, step=STEP, speed=5.0):
    """Return position, speed, yaw rate, set-point and trim of the speed at the control instants, by Drake."""
    diagram = make_single_track_vehicle(vehicle, tyres="brush", relaxation=True, parameters=parameters, delay=delay)
    simulator = Simulator(diagram)
    context = simulator.get_mutable_context()
    model = diagram.GetSubsystemByName("single_track")
    model.set_state(model.GetMyContextFromRoot(context), vx=speed)
    ResetIntegratorFromFlags(simulator, "runge_kutta3", step)
    simulator.get_mutable_integrator().set_fixed_step_mode(True)
    command, state = diagram.GetInputPort("command"), diagram.GetOutputPort("state")
    rows = []
    for k, row in enumerate(commands.tolist()):
        command.FixValue(context, [*row, k * PERIOD])
        if k == 0:
            simulator.Initialize()
        before = state.Eval(context)[[0, 1, 6, 11]]
        simulator.AdvanceTo((k + 1) * PERIOD)
        # The status is that after the step of the unit at the begin of the period, which is held.
        rows.append([*before, *diagram.GetOutputPort("status").Eval(context)[[0, 2]]])
    return np.array(rows).T


def compare_with_drake(bolt, parameters, duration, delay):
    commands = course(duration)
    run = make_control(bolt, parameters, delay=delay).run(commands)
    x, y, speed, yaw_rate, setpoint, trim = drive_in_drake(bolt, parameters, commands, delay)
    assert run["vx"][0] == pytest.approx(speed, abs=1e-6)
    assert run["yaw_rate"][0] == pytest.approx(yaw_rate, abs=1e-6)
    assert run["x"][0] == pytest.approx(x, abs=1e-5)
    assert run["y"][0] == pytest.approx(y, abs=1e-5)
    assert run["speed_setpoint"][0] == pytest.approx(setpoint, abs=1e-9)
    assert run["speed_trim"][0] == pytest.approx(trim, abs=1e-5)


@pytest.mark.essential
def test_the_loop_drives_as_the_drake_diagram(bolt, parameters):
    compare_with_drake(bolt, parameters, duration=3.0, delay=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("delay", [0.0, 0.1])
def test_the_loop_drives_as_the_drake_diagram_for_a_minute(bolt, parameters, delay):
    compare_with_drake(bolt, parameters, duration=60.0, delay=delay)


def drive_with_pedals(name, commands, speed):
    """Return the same signals of a vehicle with pedals, by the batch and by Drake."""
    car = load_vehicle(name)
    parameters = estimate_parameters(car)
    control = make_control(car, parameters, speed=speed, delay=0.04)
    assert control.period == PERIOD
    run = control.run(commands)
    ours = np.array([run[name][0] for name in ("x", "y", "vx", "yaw_rate", "speed_setpoint", "speed_trim")])
    return ours, drive_in_drake(car, parameters, commands, delay=0.04, speed=speed), run


@pytest.mark.essential
def test_pedals_drive_as_the_drake_diagram():
    """An electric motor: full throttle, regenerative and friction brakes, the hold brake, reverse."""
    t = np.arange(round(4.0 / PERIOD)) * PERIOD
    speeds = np.select([t < 1.0, t < 2.0, t < 3.0], [6.0, 0.5, 0.0], -2.0)
    ours, drakes, run = drive_with_pedals("bolt@handling", np.column_stack([speeds, 0.05 * np.sin(t)]), speed=2.0)
    assert ours == pytest.approx(drakes, abs=1e-6)
    assert run["drive_force"][0].max() > 3000.0
    assert run["brake_force"][0].max() > 1000.0
    assert run["vx"][0, -1] < -0.1


@pytest.mark.slow
@pytest.mark.parametrize("name", ["bolt@handling", "mkz@handling"])
def test_pedals_drive_as_the_drake_diagram_for_a_minute(name):
    """The Lincoln MKZ has an engine with converter and gearbox, which shifts up and down."""
    t = np.arange(round(60.0 / PERIOD)) * PERIOD
    speeds = np.select([t < 20.0, t < 35.0, t < 50.0], [30.0, 10.0, 20.0], 0.0)
    ours, drakes, _ = drive_with_pedals(name, np.column_stack([speeds, 0.01 * np.sin(0.3 * t)]), speed=5.0)
    assert ours[2] == pytest.approx(drakes[2], abs=1e-6)
    assert ours[3] == pytest.approx(drakes[3], abs=1e-6)


COURSE = Course(step=3.0, step_time=0.0, load=0.0, load_time=8.0, duration=8.0, speed=5.0)


def verdict(time_, setpoint, speed, trim):
    """Return the status of a run and whether its overshoot and settling time are within limits, as in a tuning."""
    found = judge(time_, setpoint, speed, trim, course=COURSE)
    limits = {"overshoot_percent": 10.0, "settling_time": 4.0}
    return found.status, {name: bool(found.figures[name] <= limit) for name, limit in limits.items() if found.figures}


@pytest.mark.slow
def test_a_thousand_draws_have_the_verdicts_of_the_drake_diagrams_at_a_twentieth_of_their_time(bolt, parameters):
    """Mass, friction and delay are drawn, gains are too high for the longest delays; Drake drives every 25th draw."""
    count, step, rng = 1000, 0.005, np.random.default_rng(4)
    commands = np.tile([8.0, 0.0], (round(COURSE.duration / PERIOD), 1))
    gains = {"speed.kp": np.full(count, 4.0), "speed.ki": np.full(count, 2.0)}
    masses, friction = rng.uniform(0.7, 1.4, count), rng.uniform(0.2, 1.0, count)
    delays = PERIOD * rng.integers(0, 16, count)
    columns = {name: getattr(parameters, name) * masses for name in ("mass", "yaw_inertia", "rotating_mass")}
    columns |= {name: getattr(parameters, name) * friction for name in ("front_friction", "rear_friction")}
    make_control(bolt, parameters, step=step, gains={"speed.kp": 1.0}).run(commands)  # loads the machine code

    began = time.process_time()
    control = make_control(bolt, parameters, count, columns=columns, step=step, gains=gains, delay=delays)
    run = control.run(commands, outputs=["vx", "speed_setpoint", "speed_trim"])
    ours = [verdict(run.time, *row) for row in zip(run["speed_setpoint"], run["vx"], run["speed_trim"], strict=True)]
    batch_time = (time.process_time() - began) / count

    speed_loop = bolt.control.speed.model_copy(update={"kp": 4.0, "ki": 2.0})
    tuned = replace(bolt, control=bolt.control.model_copy(update={"speed": speed_loop}))
    drawn = range(0, count, 25)
    began, theirs = time.process_time(), []
    for k in drawn:
        own = replace(parameters, **{name: float(values[k]) for name, values in columns.items()})
        with pytest.MonkeyPatch.context() as patch:
            # The unit does not know the mass of the car.
            patch.setattr(
                "mirdrake.single_track.vehicle.SingleTrackControl",
                lambda vehicle, *, mass, rotating, delay: SingleTrackControl(
                    vehicle, mass=parameters.mass, rotating=parameters.rotating_mass, delay=delay
                ),
            )
            _, _, speed, _, setpoint, trim = drive_in_drake(tuned, own, commands, float(delays[k]), step)
        theirs.append(verdict(run.time, setpoint, speed, trim))
    drake_time = (time.process_time() - began) / len(drawn)
    assert [ours[k] for k in drawn] == theirs
    # Both verdicts occur, and both limits decide.
    assert {status for status, _ in ours} == {"ok", "unstable"}
    for name in ("overshoot_percent", "settling_time"):
        assert len({within[name] for status, within in ours if status == "ok"}) == 2
    assert drake_time > 20.0 * batch_time, (drake_time, batch_time)


def test_gains_over_speed_are_those_of_the_drake_diagram(bolt, parameters):
    schedule = {"speeds": [4.0, 6.0, 9.0], "kp": [150.0, 300.0, 200.0]}
    wheel = {"kind": "pid", "kp": 1.0, "ki": 40.0, "kd": 1.0, "schedule": schedule}
    control = bolt.control.model_copy(update={"wheel_speed": WheelPid.model_validate(wheel)})
    scheduled = replace(bolt, control=control)
    compare_with_drake(scheduled, parameters, duration=3.0, delay=0.1)


def follow_in_drake(bolt, parameters, world, gains, duration):
    """Return the signals of a path tracker with the Drake diagram of the same vehicle: vx, yaw rate, path error."""
    builder = DiagramBuilder()
    vehicle = builder.AddSystem(
        make_single_track_vehicle(bolt, tyres="brush", relaxation=True, parameters=parameters, delay=0.1)
    )
    tracker = builder.AddSystem(PathTracker(world.tracks["main"], bolt.geometry, gains=gains))
    builder.Connect(vehicle.GetOutputPort("state"), tracker.state)
    builder.Connect(tracker.command, vehicle.GetInputPort("command"))
    simulator = Simulator(builder.Build())
    ResetIntegratorFromFlags(simulator, "runge_kutta3", STEP)
    simulator.get_mutable_integrator().set_fixed_step_mode(True)
    root = simulator.get_mutable_context()
    model = vehicle.GetSubsystemByName("single_track")
    model.set_state(vehicle.GetSubsystemContext(model, vehicle.GetMyMutableContextFromRoot(root)), **START)
    simulator.Initialize()
    rows = []
    for k in range(round(duration / PERIOD)):
        state = vehicle.GetOutputPort("state").Eval(vehicle.GetMyContextFromRoot(root))
        simulator.AdvanceTo((k + 1) * PERIOD)  # the tracker's output is held until its next update
        rows.append([state[6], state[11], *tracker.path_error.Eval(tracker.GetMyContextFromRoot(root))])
    return np.array(rows).T


def compare_on_a_track(bolt, parameters, duration):
    world = load_world("test_track")
    gains = PathGains(9.0, understeer_gradient=0.002)
    driver = PathDriver(world.tracks["main"], bolt.geometry, gains, columns={"speed": [9.0, 4.0]})
    control = make_control(bolt, parameters, 2, delay=0.1, start=START)
    run = control.follow(driver, periods=round(duration / PERIOD))
    speed, yaw_rate, lateral, heading, progress, laps = follow_in_drake(bolt, parameters, world, gains, duration)
    assert run["vx"][0] == pytest.approx(speed, abs=1e-6)
    assert run["yaw_rate"][0] == pytest.approx(yaw_rate, abs=1e-6)
    for name, theirs in (("lateral", lateral), ("heading", heading), ("progress", progress), ("laps", laps)):
        assert run[name][0] == pytest.approx(theirs, abs=1e-5), name
    assert run["vx"][1].max() < 5.1


def test_a_path_tracker_drives_as_the_drake_diagram(bolt, parameters):
    compare_on_a_track(bolt, parameters, duration=4.0)


@pytest.mark.slow
def test_a_path_tracker_drives_as_the_drake_diagram_for_a_minute(bolt, parameters):
    compare_on_a_track(bolt, parameters, duration=60.0)


def test_each_car_has_its_own_gains_delay_and_mass(bolt, parameters):
    columns = {"mass": np.array([1400.0, 1700.0, 2000.0])}
    gains, delays = {"speed.kp": np.array([0.5, 1.0, 1.5]), "speed.ki": np.array([0.2, 1.0, 2.0])}, [0.0, 0.06, 0.2]
    together = make_control(bolt, parameters, 3, columns=columns, gains=gains, delay=delays)
    run = together.run(course(2.0))
    assert len(set(run["vx"][:, -1].tolist())) == 3
    alone = make_control(bolt, parameters, columns={"mass": [1700.0]}, delay=0.06)
    assert alone.run(course(2.0))["vx"][0].tolist() == run["vx"][1].tolist()
    divided = make_control(bolt, parameters, 3, columns=columns, gains=gains, delay=delays, threads=2)
    assert divided.run(course(2.0)).values.tolist() == run.values.tolist()


def test_two_runs_continue_as_one(bolt, parameters):
    whole, parts = (make_control(bolt, parameters, 2, delay=0.1, noise=0.05) for _ in range(2))
    commands = course(2.0)
    run = whole.run(commands)
    pieces = [parts.run(commands[:33]), parts.run(commands[33:])]
    assert np.hstack([piece["vx"] for piece in pieces]).tolist() == run["vx"].tolist()
    assert pieces[1].time[0] == pytest.approx(0.66)


def test_without_messages_the_watchdog_stops_the_car(bolt, parameters):
    commands = np.full((300, 2), np.nan)
    commands[:50] = 8.0, 0.0
    run = make_control(bolt, parameters, speed=8.0).run(commands)
    last = 49 * PERIOD
    after = run.time > last + bolt.control.dead_man + 1e-9
    assert (run["speed_setpoint"][0, ~after] == 8.0).all()
    assert run["speed_setpoint"][0, after][0] == pytest.approx(8.0 - bolt.control.speed.max_deceleration * PERIOD)
    assert run["speed_setpoint"][0, -1] == 0.0
    assert abs(run["vx"][0, -1]) < 0.05


def test_results_can_be_thinned(bolt, parameters):
    whole, thin = (make_control(bolt, parameters, 2) for _ in range(2))
    run, some = whole.run(course(1.0)), thin.run(course(1.0), outputs=["vx", "speed_trim"], every=10)
    assert some.names == ["vx", "speed_trim"]
    assert some["vx"].tolist() == run["vx"][:, ::10].tolist()
    assert some.time.tolist() == run.time[::10].tolist()


def test_noise_depends_on_seed_car_and_step_only(bolt, parameters):
    runs = [
        make_control(bolt, parameters, n, noise=0.1, seed=seed).run(course(1.0))["vx"]
        for n, seed in ((3, 1), (5, 1), (3, 2))
    ]
    assert runs[0].tolist() == runs[1][:3].tolist()
    assert (runs[0][:, -1] != runs[2][:, -1]).all()
    assert len(set(runs[0][:, -1].tolist())) == 3


def test_the_compiled_noise_is_that_of_python(bolt, parameters):
    # A standing car whose speed loop is proportional only: the trim is the noise times the gain.
    control = make_control(bolt, parameters, 2, speed=0.0, noise=0.01, seed=5, gains={"speed.kp": 1.0, "speed.ki": 0.0})
    run = control.run(np.full((1, 2), [1.0, 0.0]))
    seed, cars, zero = (np.array(value, dtype=np.uint64) for value in ([5], [0, 1], [0]))
    measured = 0.01 * normal(seed, cars, zero, zero)
    assert run["speed_trim"][:, 0] == pytest.approx(run["speed_setpoint"][:, 0] - measured, rel=1e-12)


def test_the_generator_is_normal_and_white():
    steps = np.arange(200_000, dtype=np.uint64)
    seed, cars, channel = (np.array([value], dtype=np.uint64) for value in (7, 3, 0))
    values, other = normal(seed, cars, steps, channel), normal(seed, cars + np.uint64(1), steps, channel)
    error = 1.0 / np.sqrt(len(steps))
    assert abs(values.mean()) < 4.0 * error
    assert abs(values.var() - 1.0) < 4.0 * np.sqrt(2.0) * error
    assert abs((values**4).mean() - 3.0) < 4.0 * np.sqrt(96.0) * error  # variance of the fourth power: 105 - 9
    assert abs((values[1:] * values[:-1]).mean()) < 4.0 * error
    assert abs((values * other).mean()) < 4.0 * error


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"variant": Variant("brush")}, "actuators=True"),
        ({"gains": {"speed.kd": 1.0}}, "no gain 'speed.kd'.*speed.kp"),
        ({"delay": 0.013}, "delay of car 0 is 0.013 s.*multiple of the control period, 0.02 s"),
        ({"delay": [0.0, 0.1, 0.2]}, "delay must be a number"),
        ({"noise": -1.0}, "noise must be a number of 0 or more"),
        ({"step": 0.003}, "step of 0.003 s does not divide the control period of 0.02 s"),
    ],
)
def test_errors_name_the_faulty_value(bolt, parameters, options, message):
    with pytest.raises(ConfigError, match=message):
        make_control(bolt, parameters, **options)


def test_rear_wheel_steering_is_rejected(bolt, parameters):
    steering = bolt.spec.steering.model_copy(update={"rear": RearSteering.model_validate({"ratio": -0.2})})
    steered = replace(bolt, spec=bolt.spec.model_copy(update={"steering": steering}))
    with pytest.raises(ConfigError, match="steers its rear wheels"):
        make_control(steered, parameters)


def test_a_wrong_command_is_an_error(bolt, parameters):
    control = make_control(bolt, parameters, 2)
    with pytest.raises(ConfigError, match=r"shape \(5, 3\); give \(periods, 2\)"):
        control.run(np.zeros((5, 3)))
    with pytest.raises(ConfigError, match="no signal 'speed'"):
        control.run(np.zeros((5, 2)), outputs=["speed"])
