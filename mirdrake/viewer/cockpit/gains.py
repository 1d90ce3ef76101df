"""Gains of a vehicle's loops as parameters of a Context."""

from pydrake.systems.framework import Context

from mirdrake.controllers import VehicleControl
from mirdrake.vehicles.spec import RuntimeGain


def slider_of(gain: RuntimeGain) -> dict[str, str | float]:
    """Return path, unit, value and maximum of a gain's slider; at most five times the value in control.yaml."""
    return {
        "path": gain.path,
        "unit": "" if gain.unit == "1" else gain.unit,
        "given": gain.value,
        "most": 1.0 if gain.value == 0.0 else round(5.0 * gain.value, 6),
    }


def set_gain(control: VehicleControl, context: Context, gain: RuntimeGain, value: float) -> None:
    """Write a gain into a Context.

    Args:
        control: the control unit.
        context: the Context of the whole diagram.
        gain: which gain.
        value: in its unit; finite and not negative.
    """
    own = control.GetMyMutableContextFromRoot(context)
    own.get_mutable_numeric_parameter(gain.group).SetAtIndex(gain.index, value)


def get_gain(control: VehicleControl, context: Context, gain: RuntimeGain) -> float:
    """Return a gain of the Context of the whole diagram."""
    own = control.GetMyContextFromRoot(context)
    return float(own.get_numeric_parameter(gain.group).GetAtIndex(gain.index))
