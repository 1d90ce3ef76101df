"""Energy of an electric vehicle: losses of the drive unit, and the battery.

Motor, inverter and their losses take the electric power

    P = T ω + kc T² + ki |ω| + kw |ω|³ + C

with the torque T and the speed ω of the motor (J. Larminie, J. Lowry, Electric Vehicle Technology Explained, chapter 6:
copper, iron, windage and constant losses). Other consumers add their auxiliary power. The battery is an open-circuit
voltage U over the state of charge, and a resistance R (chapter 2)::

    P = U I - R I²,        d(charge)/dt = -I / capacity

Charging from the grid takes the energy of the cells over the charging efficiency. The temperature is not modelled, and
the battery does not limit the motor: its limits are `max_power` and `regeneration`.
"""

from math import sqrt
from typing import NamedTuple

from pydrake.systems.framework import Context, DiscreteValues

from mirdrake.core.interpolation import read_map
from mirdrake.core.leaf_system import LeafSystem
from mirdrake.core.signals import declare_state_output, declare_vector_input, signals
from mirdrake.plant.powertrain.system import RATE, STATUS
from mirdrake.vehicles.powertrain_spec import Battery, MotorLosses

BATTERY = signals(
    ("power", "W", "at the terminals, positive while it discharges"),
    ("current", "A", "positive while it discharges"),
    ("voltage", "V", "at the terminals"),
    ("charge", "", "state of charge, 0 to 1"),
    ("energy", "J", "taken from the cells since the start"),
    ("heat", "J", "of its resistance since the start"),
    ("drive_losses", "J", "of motor and inverter since the start"),
)
_MOTOR_SPEED, _MOTOR_TORQUE = (
    next(index for index, signal in enumerate(STATUS) if signal.name == name)
    for name in ("motor_speed", "motor_torque")
)


class BatteryState(NamedTuple):
    """State of a battery and its flows, in the order of :data:`BATTERY`."""

    power: float
    current: float
    voltage: float
    charge: float
    energy: float = 0.0
    heat: float = 0.0
    drive_losses: float = 0.0


def drive_unit_loss(losses: MotorLosses, torque: float, speed: float) -> float:
    """Return the losses of motor and inverter [W].

    Args:
        losses: coefficients.
        torque: of the motor [N m].
        speed: of the motor [rad/s].
    """
    size = abs(speed)
    return losses.copper * torque**2 + losses.iron * size + losses.windage * size**3 + losses.constant


def battery_at_rest(battery: Battery) -> BatteryState:
    """Return the battery at its initial charge, without a current."""
    voltage = read_map(battery.open_circuit_voltage, battery.initial_charge)
    return BatteryState(0.0, 0.0, voltage, battery.initial_charge)


def battery_step(battery: Battery, state: BatteryState, power: float, loss: float, period: float) -> BatteryState:
    """Return the state after a period of constant power.

    Args:
        battery: its parameters.
        state: state before.
        power: at the terminals, positive while it discharges [W].
        loss: part of it that motor and inverter lose [W].
        period: [s].
    """
    source, resistance = read_map(battery.open_circuit_voltage, state.charge), battery.resistance
    # The smaller root of P = U I - R I²; at most the largest power U² / (4 R). This form also holds without resistance.
    square = max(source * source - 4.0 * resistance * power, 0.0)
    power = min(power, source * source / (4.0 * resistance)) if resistance > 0.0 else power
    current = 2.0 * power / (source + sqrt(square))
    return BatteryState(
        power,
        current,
        source - resistance * current,
        state.charge - current * period / (3600.0 * battery.capacity),
        state.energy + source * current * period,
        state.heat + resistance * current * current * period,
        state.drive_losses + loss * period,
    )


class BatteryPack(LeafSystem):  # type: ignore[misc, unused-ignore]
    """Battery of a vehicle with pedals and an electric motor.

    Input ports:
        powertrain_status (9): of :class:`mirdrake.plant.powertrain.Powertrain`.
    Output ports:
        battery_status (7): :data:`BATTERY`.

    The output is a discrete state, updated as often as the powertrain.

    Args:
        battery: its parameters.
        losses: losses of motor and inverter.
    """

    def __init__(self, battery: Battery, losses: MotorLosses) -> None:
        super().__init__()
        self._battery, self._losses = battery, losses
        self.powertrain_status = declare_vector_input(self, "powertrain_status", STATUS)
        self._state = self.DeclareDiscreteState(list(battery_at_rest(battery)))
        self.battery_status = declare_state_output(self, "battery_status", BATTERY, self._state)
        self.DeclarePeriodicDiscreteUpdateEvent(1.0 / RATE, 0.0, self._update)

    def _update(self, context: Context, state: DiscreteValues) -> None:
        status = self.powertrain_status.Eval(context)
        torque, speed = float(status[_MOTOR_TORQUE]), float(status[_MOTOR_SPEED])
        loss = drive_unit_loss(self._losses, torque, speed)
        before = BatteryState(*context.get_discrete_state(self._state).value().tolist())
        power = torque * speed + loss + self._battery.auxiliary_power
        state.set_value(self._state, list(battery_step(self._battery, before, power, loss, 1.0 / RATE)))
