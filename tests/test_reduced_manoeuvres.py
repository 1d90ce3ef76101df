"""Manoeuvres with the single-track model: the Drake diagram of the same model and driver, and many cars at once."""

from functools import cache

import numpy as np
import pytest
from pydrake.systems.analysis import ResetIntegratorFromFlags, Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput

from mirdrake.core.vectors import STATE
from mirdrake.manoeuvres import Rig, find_facts
from mirdrake.manoeuvres.drivers import OpenLoopDriver, PathDriver
from mirdrake.manoeuvres.reduced import RATE, ReducedLog, ReducedParameters, ReducedRun, has_roll, simulate
from mirdrake.manoeuvres.registry import run_manoeuvre
from mirdrake.single_track import SingleTrack, SingleTrackControl, estimate_parameters
from mirdrake.single_track.dynamics import Variant
from mirdrake.single_track.from_vehicle import tyres_of
from mirdrake.single_track.powertrain import SingleTrackPowertrain, make_single_track_law
from mirdrake.vehicles import load_vehicle


@cache
def rig_of(name: str) -> Rig:
    vehicle = load_vehicle(name)
    return Rig(name, vehicle, find_facts(vehicle), kind="single_track")


def drive_in_drake(run: ReducedRun, step: float) -> dict[str, np.ndarray]:
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
    ResetIntegratorFromFlags(simulator, "runge_kutta3", step)
    simulator.get_mutable_integrator().set_fixed_step_mode(True)
    context = simulator.get_mutable_context()
    model.set_state(model.GetMyContextFromRoot(context), x=run.x, y=run.y, vx=run.speed)
    simulator.AdvanceTo(run.duration)
    state, steering = (log.FindLog(context).data() for log in logs)
    named = {signal.name: row for signal, row in zip(STATE, state, strict=True)}
    return named | {"steering_angle": steering[0]}


def runs_of(rig: Rig, name: str, **settings) -> list[ReducedRun]:
    """Return the runs of a manoeuvre."""
    from mirdrake.manoeuvres.registry import MANOEUVRES

    runs = []
    ours = rig.simulate

    def keep(run: ReducedRun) -> ReducedLog:
        runs.append(run)
        return ours(run)

    run_manoeuvre(name, replace_simulate(rig, keep), MANOEUVRES[name](**settings))
    return runs


def replace_simulate(rig: Rig, function) -> Rig:
    from dataclasses import replace

    return replace(rig, simulate=function)
