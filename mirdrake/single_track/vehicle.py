"""Diagram of a vehicle's single-track model, control unit and powertrain."""

from pydrake.systems.framework import Diagram, DiagramBuilder

from mirdrake.core.signals import copy_signals
from mirdrake.single_track.control import SingleTrackControl
from mirdrake.single_track.dynamics import Variant
from mirdrake.single_track.from_vehicle import estimate_parameters
from mirdrake.single_track.parameters import SingleTrackParameters
from mirdrake.single_track.powertrain import SingleTrackPowertrain, make_single_track_law
from mirdrake.single_track.system import SingleTrack
from mirdrake.vehicles import Vehicle


def make_single_track_vehicle(
    vehicle: Vehicle,
    *,
    tyres: str = "linear",
    relaxation: bool = False,
    roll: bool = False,
    parameters: SingleTrackParameters | None = None,
    delay: float = 0.0,
) -> Diagram:
    """Return the diagram of a vehicle's single-track model and control unit, driven like the full vehicle.

    Input ports of the diagram: command (3). Output ports: state (12), motion (7), status (3), with pedals also
    powertrain_status (9). Its systems are called "single_track" and "control", with pedals also "powertrain". The
    control unit is for floats only; use the model alone for derivatives.

    Args:
        vehicle: a loaded vehicle.
        tyres: "kinematic", "linear", or a kind of tyres, as "brush" or "magic_formula".
        relaxation: whether slip builds up over the relaxation length.
        roll: whether the body rolls.
        parameters: by default from :func:`estimate_parameters`.
        delay: delay of the actuators [s], a multiple of the period of control.yaml.

    Raises:
        ConfigError: an argument is not allowed.
    """
    parameters = parameters or estimate_parameters(vehicle, roll=roll)
    builder = DiagramBuilder()
    variant = Variant(tyres, relaxation, actuators=True, roll=roll)
    model = builder.AddNamedSystem("single_track", SingleTrack(parameters, variant))
    # The unit takes mass and rotating mass from the model's parameters, so that feedforward and model agree.
    mass, rotating = parameters.mass, parameters.rotating_mass
    control = builder.AddNamedSystem("control", SingleTrackControl(vehicle, mass=mass, rotating=rotating, delay=delay))
    outputs = {"state": model.state, "motion": model.motion, "status": control.status}
    # With pedals the powertrain turns them into forces; else the control unit outputs forces itself.
    if control.HasOutputPort("pedals"):
        law = make_single_track_law(vehicle, mass=mass, rotating=rotating)
        powertrain = builder.AddNamedSystem("powertrain", SingleTrackPowertrain(law))
        builder.Connect(control.pedals, powertrain.pedals)
        builder.Connect(model.state, powertrain.state)
        builder.Connect(powertrain.forces, model.forces)
        outputs["powertrain_status"] = powertrain.powertrain_status
    else:
        builder.Connect(control.forces, model.forces)
    builder.Connect(control.steering, model.steering)
    builder.Connect(model.state, control.state)
    builder.Connect(model.steering_angle, control.steering_angle)
    builder.ExportInput(control.command, "command")

    # A diagram's exported ports lose the names of their signals: copy them for recording and labels.
    ports = [(port, builder.ExportOutput(port, name)) for name, port in outputs.items()]
    diagram = builder.Build()
    for port, index in ports:
        copy_signals(port, diagram.get_output_port(index))
    diagram.set_name("single_track_vehicle")
    return diagram
