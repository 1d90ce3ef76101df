"""Powertrain and brakes of the single-track model: the laws of the full vehicle, on wheels that roll without slip."""

from collections.abc import MutableSequence

from pydrake.systems.framework import Context, DiscreteValues

from mirdrake.core.leaf_system import LeafSystem
from mirdrake.core.signals import declare_state_output, declare_vector_input
from mirdrake.core.vectors import STATE
from mirdrake.plant.powertrain import PEDALS, STATUS, Measured, PowertrainLaw
from mirdrake.plant.powertrain.brakes import driven_rate, split_drive
from mirdrake.plant.powertrain.law import PowertrainNumbers, pedal_torques
from mirdrake.plant.powertrain.system import RATE
from mirdrake.single_track.signals import FORCES
from mirdrake.vehicles import Vehicle

_VX = [signal.name for signal in STATE].index("vx")


def make_single_track_law(vehicle: Vehicle, *, mass: float, rotating: float) -> PowertrainLaw:
    """Return the powertrain law of a vehicle whose wheels roll without slip.

    Args:
        vehicle: a loaded vehicle.
        mass: mass of the vehicle [kg].
        rotating: mass equivalent of the rotating parts [kg].
    """
    geometry = vehicle.geometry
    # The period is that of the output of the single-track model, at which the law is evaluated.
    return PowertrainLaw(
        vehicle.spec,
        radii=geometry.wheel_radii,
        mass=mass,
        wheelbase=geometry.wheelbase,
        rotating=rotating,
        period=1.0 / RATE,
    )


def road_forces(
    numbers: PowertrainNumbers,
    radii: tuple[float, float, float, float],
    memory: MutableSequence[float],
    throttle: float,
    brake: float,
    gear: float,
    speed: float,
) -> tuple[float, float]:
    """Advance the powertrain by a step and return drive and brake force at the road [N].

    Args:
        numbers: numbers of the powertrain.
        radii: radii of the wheels [m].
        memory: its memory, changed.
        throttle: pedal position [1].
        brake: pedal position [1].
        gear: 1 drive, 0 neutral, -1 reverse.
        speed: speed of the vehicle [m/s].
    """
    # All wheels roll without slip, so each has the speed of the vehicle over its own radius.
    rates = (speed / radii[0], speed / radii[1], speed / radii[2], speed / radii[3])
    found = pedal_torques(numbers, memory, 0, throttle, brake, gear, driven_rate(rates, numbers.shares), False)
    drives = split_drive(min(max(found.gear, -1.0), 1.0) * found.torque, numbers.shares)
    drive = drives[0] / radii[0] + drives[1] / radii[1] + drives[2] / radii[2] + drives[3] / radii[3]
    brakes = found.brakes
    return drive, brakes[0] / radii[0] + brakes[1] / radii[1] + brakes[2] / radii[2] + brakes[3] / radii[3]


class SingleTrackPowertrain(LeafSystem):  # type: ignore[misc, unused-ignore]
    """System from pedals to the forces of the single-track model.

    Input ports:
        pedals (3): throttle, brake, gear.
        state (12): of the vehicle.
    Output ports:
        forces (3) [N, N, m/s]: drive force, brake force, and the speed (without wheel servos).
        powertrain_status (9): as of the full vehicle.

    The outputs are discrete states, updated at the rate of the full vehicle's powertrain.

    Args:
        law: powertrain law, from :func:`make_single_track_law`.
    """

    def __init__(self, law: PowertrainLaw) -> None:
        super().__init__()
        self._law = law
        self.pedals = declare_vector_input(self, "pedals", PEDALS)
        self.state = declare_vector_input(self, "state", STATE)
        self._forces = self.DeclareDiscreteState(len(FORCES))

        # The law keeps a memory (gear, lags), so it is a discrete system with a fixed rate; forces are held between
        # updates.
        self._status = self.DeclareDiscreteState(len(STATUS))
        self._memory = self.DeclareDiscreteState(law.rest())
        self.forces = declare_state_output(self, "forces", FORCES, self._forces)
        self.powertrain_status = declare_state_output(self, "powertrain_status", STATUS, self._status)
        self.DeclareInitializationDiscreteUpdateEvent(self._initialize)
        self.DeclarePeriodicDiscreteUpdateEvent(1.0 / RATE, 0.0, self._update)

    def _initialize(self, context: Context, values: DiscreteValues) -> None:
        values.set_value(self._memory, self._law.rest(self.state.Eval(context)[_VX].item()))

    def _update(self, context: Context, values: DiscreteValues) -> None:
        speed = self.state.Eval(context)[_VX].item()
        memory = context.get_discrete_state(self._memory).value().tolist()
        # All wheels roll without slip, so each has the speed of the vehicle over its own radius.
        rates = [speed / radius for radius in self._law.radii]
        measured = Measured((rates[0], rates[1], rates[2], rates[3]), (speed,) * 4, speed)
        memory, torques = self._law.step(memory, self.pedals.Eval(context).tolist(), measured)
        drive, brake = (
            sum(torque / radius for torque, radius in zip(four, self._law.radii, strict=True))
            for four in (torques.drive, torques.brake)
        )
        # The third force is the set-point of the wheel servos; the present speed makes the servos add no force.
        values.set_value(self._forces, [drive, brake, speed])
        values.set_value(self._status, list(torques.status))
        values.set_value(self._memory, memory)
