"""Job tyres: processor time of tyre models in the drive of W1, on a rough road, and of the single-track model."""

from functools import partial
from statistics import median
from typing import Any

from pydrake.systems.analysis import ResetIntegratorFromFlags, Simulator
from pydrake.systems.framework import Diagram, DiagramBuilder, TriggerType
from pydrake.systems.primitives import LogVectorOutput

from benchmarks.job import DURATION, SPEED, STEADY, STEERING, circle_figures
from benchmarks.timing import Times, rates, timed
from mirdrake.assembly.diagram import assemble
from mirdrake.assembly.diagram_spec import load_diagram
from mirdrake.controllers import ConstantCommand
from mirdrake.runs.simulation import Simulation
from mirdrake.single_track import make_single_track, make_single_track_vehicle
from mirdrake.vehicles import load_vehicle

KINDS = {"coulomb": "w1_car", "brush": "w1_car@brush", "magic_formula": "w1_car@magic_formula"}
"""Kinds of tyres and the vehicles that have them; all else is the same."""

LOG_PERIOD = 0.02
"""[s] between the samples that are logged of the single-track model."""


def drive(contact: str, *, step: float = 0.005, duration: float = DURATION, repeat: int = 3) -> dict[str, Any]:
    """Return the drive of W1 with every kind of tyre, by turns in this process.

    Args:
        contact: "hydroelastic" or "point".
        step: of the plant [s].
        duration: simulated time [s].
        repeat: number of rounds.

    Returns:
        per kind its speed, the figures of its circle, and `over_coulomb`: processor time over that of Coulomb tyres in
        the same round, median.
    """
    overrides = [f"plant.contact={contact}", f"plant.time_step={step}"]
    simulations, figures = {}, {}
    for kind, model in KINDS.items():
        spec = load_diagram("w1", overrides=[*overrides, f"vehicles.ego.model={model}"])
        simulations[kind] = Simulation(assemble(spec))
        signals = simulations[kind].run(duration=duration).signals  # warms up
        last = signals[signals.index > max(duration - STEADY, 0.0) + 1e-3]
        figures[kind] = circle_figures(last["ego.vx"].to_numpy(), last["ego.wz"].to_numpy())
    times: dict[str, list[Times]] = {kind: [] for kind in KINDS}
    for _ in range(repeat):
        for kind, simulation in simulations.items():
            times[kind].append(timed(partial(simulation.run, duration=duration)))
    plain = [time.cpu for time in times["coulomb"]]
    return {
        kind: {
            **rates(taken, duration=duration, step=step),
            **figures[kind],
            "over_coulomb": median(time.cpu / other for time, other in zip(taken, plain, strict=True)),
        }
        for kind, taken in times.items()
    }


def rough_road(*, repeat: int = 3, duration: float | None = None) -> dict[str, float]:
    """Return the speed of a whole diagram of the Bolt with Magic Formula tyres on a rough road, with its log.

    Args:
        repeat: number of runs.
        duration: simulated time [s]; that of the diagram by default.
    """
    spec = load_diagram("rough_road")
    simulation, duration = Simulation(assemble(spec)), duration or spec.duration
    run = partial(simulation.run, duration=duration)
    run()  # warms up
    return rates([timed(run) for _ in range(repeat)], duration=duration, step=spec.plant.time_step)


def _model(period: float | None = None) -> tuple[Diagram, Any, dict[str, list[float]]]:
    """Return the single-track model of the car, with brush tyres and relaxation; a constant steering angle, no force.

    Fixed in the Context: Drake takes what a ConstantVectorSource gives to change with time, and asks again each time.

    Args:
        period: between two samples of the state [s], each of which ends a step of the integrator; None: its own steps.
    """
    builder = DiagramBuilder()
    model = builder.AddSystem(make_single_track(load_vehicle(KINDS["brush"]), tyres="brush", relaxation=True))
    if period is None:
        LogVectorOutput(model.state, builder, publish_triggers={TriggerType.kPerStep})
    else:
        LogVectorOutput(model.state, builder, publish_period=period)
    return builder.Build(), model, {"steering": [STEERING], "forces": [0.0, 0.0]}


def _vehicle() -> tuple[Diagram, Any, dict[str, list[float]]]:
    """Return the single-track model behind the control unit of the vehicle, which works at 50 Hz."""
    builder, car = DiagramBuilder(), load_vehicle(KINDS["brush"])
    vehicle = builder.AddSystem(make_single_track_vehicle(car, tyres="brush", relaxation=True))
    command = builder.AddSystem(ConstantCommand(SPEED, STEERING, period=LOG_PERIOD))
    builder.Connect(command.get_output_port(0), vehicle.GetInputPort("command"))
    LogVectorOutput(vehicle.GetOutputPort("state"), builder, publish_period=LOG_PERIOD)
    return builder.Build(), vehicle.GetSubsystemByName("single_track"), {}


def reduced(make: Any, *, scheme: str | None = None, duration: float = DURATION, repeat: int = 3) -> dict[str, float]:
    """Return the real-time factor of a diagram with the single-track model, and the error of its final position.

    Args:
        make: builds it; gives the diagram, the model in it, and what its input ports are fixed to.
        scheme: of Drake's integrators with fixed steps of LOG_PERIOD; None: the one that comes, with error control.
        duration: simulated time [s].
        repeat: number of runs; the best is given, as other load on the machine can only add.
    """
    diagram, model, inputs = make()

    def run(scheme: str | None = scheme, step: float = LOG_PERIOD) -> Any:
        simulator = Simulator(diagram)
        context = model.GetMyContextFromRoot(simulator.get_mutable_context())
        for port, values in inputs.items():
            model.GetInputPort(port).FixValue(context, values)
        if scheme is not None:
            ResetIntegratorFromFlags(simulator, scheme, step)
            simulator.get_mutable_integrator().set_fixed_step_mode(True)
        model.set_state(context, vx=SPEED)
        simulator.Initialize()
        simulator.AdvanceTo(duration)
        return model.state.Eval(context).copy()

    error = abs(run() - run("runge_kutta3", 0.1 * LOG_PERIOD))
    times = [timed(run) for _ in range(repeat)]
    return {
        "rtf": duration / min(time.wall for time in times),
        "rtf_cpu": duration / min(time.cpu for time in times),
        "error_mm": 1e3 * float(max(error[:2])),
        "error_mrad_per_s": 1e3 * float(error[11]),
    }


def run_tyres(*, duration: float = DURATION, repeat: int = 3) -> dict[str, Any]:
    """Run all parts of the job."""
    return {
        "drives": {contact: drive(contact, duration=duration, repeat=repeat) for contact in ("point", "hydroelastic")},
        "rough_road": rough_road(duration=min(duration, 20.0), repeat=repeat),
        "single_track": {
            "model": reduced(_model, duration=duration, repeat=repeat),
            "model_sampled": reduced(partial(_model, LOG_PERIOD), duration=duration, repeat=repeat),
            "model_sampled_second_order": reduced(
                partial(_model, LOG_PERIOD), scheme="runge_kutta2", duration=duration, repeat=repeat
            ),
            "with_control_unit": reduced(_vehicle, duration=duration, repeat=repeat),
        },
    }
