"""The full vehicle on its tyres and springs against the single-track model made from the same folder.

Lateral acceleration is that below the centre of mass, in the plane of the road. What load transfer, aligning moments
and the yielding steering do in a steady turn is in the stiffness of the reduced model's axles. It rolls itself: at 60
km/h and 1 Hz this takes the difference of the lateral acceleration from 7 to 3 %.
"""

import functools

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput

from mirdrake.core.vectors import STATE
from mirdrake.manoeuvres import Rig, find_facts
from mirdrake.manoeuvres.drivers import OpenLoopDriver
from mirdrake.manoeuvres.record import Record
from mirdrake.single_track import estimate_parameters, make_single_track_vehicle
from mirdrake.tyres import SlipTyres
from mirdrake.vehicles import load_vehicle

G = 9.80665
NAME = "bolt@handling"
OTHERS = ["mkz@handling", "catvehicle@handling", "unior@handling"]
START = 1.0
_ROWS = [signal.name for signal in STATE]


@functools.cache
def _rig(name: str) -> Rig:
    vehicle = load_vehicle(name)
    return Rig(name, vehicle, find_facts(vehicle))


def _reduced(name: str, profile, *, speed: float, duration: float) -> Record:
    """Return the response of the single-track model behind the vehicle's control unit to the same command."""
    rig, builder = _rig(name), DiagramBuilder()
    model = builder.AddNamedSystem(
        "reduced",
        make_single_track_vehicle(
            rig.vehicle, tyres="brush", relaxation=True, roll=rig.vehicle.spec.suspension is not None
        ),
    )
    driver = builder.AddNamedSystem("driver", OpenLoopDriver(profile, speeds=[[0.0, speed]]))
    builder.Connect(driver.command, model.GetInputPort("command"))
    builder.Connect(model.GetOutputPort("state"), driver.state)
    log = LogVectorOutput(model.GetOutputPort("state"), builder, publish_period=0.01)
    diagram = builder.Build()
    simulator = Simulator(diagram)
    context = simulator.get_mutable_context()
    track = model.GetSubsystemByName("single_track")
    track.set_state(track.GetMyContextFromRoot(context), vx=speed)
    simulator.AdvanceTo(duration)
    signal_log = log.FindLog(context)
    x = dict(zip(_ROWS, signal_log.data(), strict=True))
    return Record(
        label="reduced", time=signal_log.sample_times(), x=x["x"], y=x["y"], yaw=x["yaw"], vx=x["vx"], vy=x["vy"],
        yaw_rate=x["wz"], roll=x["roll"], steering=0.0 * x["x"], ahead=rig.facts.ahead, ratio=1.0,
    )  # fmt: skip


def _both(name: str, profile, *, speed: float, duration: float) -> tuple[Record, Record]:
    rig = _rig(name)
    full = rig.run("full", rig.open_driver(profile, speeds=[[0.0, speed]]), duration=duration, speed=speed)
    return full, _reduced(name, profile, speed=speed, duration=duration)


def _angle(name: str, lateral: float, speed: float) -> float:
    return _rig(name).facts.steering_for(lateral * G, speed)


def _error(full, reduced, name: str) -> float:
    """Return the root mean square of the difference from the beginning of the steering on, over the largest value."""
    expected = getattr(full, name)
    late = full.time > START
    actual = np.interp(full.time, reduced.time, getattr(reduced, name))
    return float(np.sqrt(np.mean((actual - expected)[late] ** 2)) / np.max(np.abs(expected)))


def _check_steps(vehicle: str, speed: float, lateral: float) -> None:
    profile = {"kind": "step", "amplitude": _angle(vehicle, lateral, speed), "start": START, "rise": 0.15}
    full, reduced = _both(vehicle, profile, speed=speed, duration=4.0)
    assert np.max(full.lateral_acceleration) == pytest.approx(lateral * G, rel=0.1)  # it is what the test is about
    for name in ("yaw_rate", "lateral_acceleration"):
        assert _error(full, reduced, name) < 0.05, name
        gains = [float(np.mean(getattr(run, name)[run.time > 3.5])) for run in (full, reduced)]
        assert gains[1] == pytest.approx(gains[0], rel=0.02 if vehicle == NAME else 0.05), name


def _check_sines(vehicle: str, speed: float, lateral: float, frequency: float) -> None:
    profile = {"kind": "sine", "amplitude": _angle(vehicle, lateral, speed), "start": START, "frequency": frequency}
    full, reduced = _both(vehicle, profile | {"periods": 2.0}, speed=speed, duration=START + 2.0 / frequency + 0.5)
    assert np.max(np.abs(full.lateral_acceleration)) > 0.4 * lateral * G
    for name in ("yaw_rate", "lateral_acceleration"):
        assert _error(full, reduced, name) < 0.05, name
    if _rig(vehicle).vehicle.spec.suspension is not None:
        assert _error(full, reduced, "roll") < 0.07


@pytest.mark.parametrize("lateral", [0.1, 0.3])
def test_a_step_of_steering(lateral):
    _check_steps(NAME, 100.0 / 3.6, lateral)


@pytest.mark.parametrize(("kmh", "frequency"), [(100.0, 0.5), (60.0, 1.0)])
def test_a_sine_of_steering(kmh, frequency):
    _check_sines(NAME, kmh / 3.6, 0.3, frequency)


@pytest.mark.parametrize("vehicle", OTHERS)
def test_other_vehicles_at_three_tenths_of_g(vehicle):
    speed = (50.0 if vehicle.startswith("unior") else 100.0) / 3.6
    _check_steps(vehicle, speed, 0.3)
    _check_sines(vehicle, speed, 0.3, 0.5)


@pytest.mark.slow
@pytest.mark.parametrize("vehicle", OTHERS)
@pytest.mark.parametrize("lateral", [0.1, 0.2, 0.3])
@pytest.mark.parametrize("share", [0.6, 1.0])
def test_other_vehicles_at_other_speeds(vehicle, lateral, share):
    """The Unior, whose wheelbase is a quarter to a third of a car's, at half of the speeds."""
    speed = share * (50.0 if vehicle.startswith("unior") else 100.0) / 3.6
    _check_steps(vehicle, speed, lateral)
    for frequency in (0.5, 1.0):
        _check_sines(vehicle, speed, lateral, frequency)


@pytest.mark.slow
@pytest.mark.parametrize(("kmh", "lateral"), [(60.0, 0.1), (60.0, 0.2), (60.0, 0.3), (100.0, 0.2)])
def test_a_step_at_other_speeds(kmh, lateral):
    _check_steps(NAME, kmh / 3.6, lateral)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kmh", "frequency"),
    [(60.0, 0.5), (100.0, 0.5), (60.0, 1.0), (100.0, 1.0)],
    ids=["60-half", "100-half", "60-one", "100-one"],
)
@pytest.mark.parametrize("lateral", [0.1, 0.2, 0.3])
def test_sines_at_other_speeds(kmh, frequency, lateral):
    _check_sines(NAME, kmh / 3.6, lateral, frequency)


def test_steady_state_slip_of_a_turn_is_included_in_the_stiffness():
    """Without roll, aligning moments and compliance the axles are stiffer; these effects are a sixth of the slip."""
    vehicle = load_vehicle(NAME)
    p, tyres = estimate_parameters(vehicle), vehicle.spec.tyres
    assert isinstance(tyres, SlipTyres)
    laws = tyres.axle_laws(vehicle.folder)
    loads = [0.5 * p.mass * G * length / p.wheelbase for length in (p.rear_length, p.front_length)]
    front, rear = (2.0 * law(load, 0.0, 1.0).contact.stiffness_y for law, load in zip(laws, loads, strict=True))
    assert 0.75 * front < p.front_stiffness < 0.95 * front
    assert 0.85 * rear < p.rear_stiffness < rear
    assert p.front_relaxation == laws[0](loads[0], 0.0, 1.0).contact.length_y


def test_a_slippery_road_takes_friction_from_the_axles_of_a_tyre_model():
    vehicle = load_vehicle(NAME)
    dry, ice = estimate_parameters(vehicle), estimate_parameters(vehicle, friction=0.2)
    assert ice.front_friction == pytest.approx(dry.front_friction * 0.2 / 0.85, rel=0.05)
