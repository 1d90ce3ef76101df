"""Gains of a vehicle's loops as parameters of a Context, by the names they have in control.yaml."""

from dataclasses import dataclass

from pydrake.systems.framework import Context

from mirdrake.controllers import VehicleControl
from mirdrake.vehicles import Vehicle


@dataclass(frozen=True)
class Gain:
    """A gain that can be changed while a simulation runs.

    Attributes:
        path: its dotted path in control.yaml.
        unit: "" where the loop leaves it open.
        given: its value there.
        group: which numeric parameter of :class:`~mirdrake.controllers.VehicleControl`.
        index: which element of it.
    """

    path: str
    unit: str
    given: float
    group: int
    index: int

    @property
    def most(self) -> float:
        """The end of a slider: some times the given value, a round number."""
        return 1.0 if self.given == 0.0 else round(5.0 * self.given, 6)


def list_gains(vehicle: Vehicle) -> list[Gain]:
    """The gains of a vehicle that do something.

    With pedals the speed loop is theirs; servos have gains of Drake's, which are fixed once the plant is built; gains
    that control.yaml schedules over speed are none of these.
    """
    control, found = vehicle.control, []
    if control.wheel_speed.kind == "pedals":
        pedals = control.wheel_speed
        found += [
            Gain("wheel_speed.kp", "1/s", float(pedals.kp), 1, 0),
            Gain("wheel_speed.ki", "1/s²", float(pedals.ki), 1, 1),
        ]
    else:
        found += [
            Gain("speed.kp", "", float(control.speed.kp), 0, 0),
            Gain("speed.ki", "1/s", float(control.speed.ki), 0, 1),
        ]
    if control.wheel_speed.kind == "pid":
        wheels = control.wheel_speed
        units = ("N m s/rad", "N m/rad", "N m s²/rad")
        found += _pid("wheel_speed", (wheels.kp, wheels.ki, wheels.kd), units, 1)
    if control.steering.kind == "pid":
        steering = control.steering
        units = ("N m/rad", "N m/(rad s)", "N m s/rad")
        found += _pid("steering", (steering.kp, steering.ki, steering.kd), units, 2)
    fixed = control.scheduled_gains()
    return [gain for gain in found if gain.path not in fixed]


def set_gain(control: VehicleControl, context: Context, gain: Gain, value: float) -> None:
    """Write a gain into a Context.

    Args:
        control: the control unit.
        context: of the whole diagram.
        gain: which one.
        value: in its unit; finite and not negative.
    """
    own = control.GetMyMutableContextFromRoot(context)
    own.get_mutable_numeric_parameter(gain.group).SetAtIndex(gain.index, value)


def get_gain(control: VehicleControl, context: Context, gain: Gain) -> float:
    """A gain of a Context."""
    own = control.GetMyContextFromRoot(context)
    return float(own.get_numeric_parameter(gain.group).GetAtIndex(gain.index))


def _pid(loop: str, values: tuple[float, ...], units: tuple[str, ...], group: int) -> list[Gain]:
    names = ("kp", "ki", "kd")
    return [
        Gain(f"{loop}.{name}", unit, float(value), group, index)
        for index, (name, unit, value) in enumerate(zip(names, units, values, strict=True))
    ]
