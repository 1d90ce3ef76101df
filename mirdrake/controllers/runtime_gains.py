"""Gains of a control unit in a Context, whether the unit is one fused system or a Diagram of blocks."""

from pydrake.systems.framework import BasicVector, Context, Diagram, System

from mirdrake.vehicles.spec import RuntimeGain

_BLOCKS = (("speed_pid",), ("wheel_loops", "pedal_loop"), ("steering_loops",))
"""Blocks that hold the gains of each group; a vehicle has one of them."""


def set_gain(control: System, context: Context, gain: RuntimeGain, value: float) -> None:
    """Write a gain into a Context.

    Args:
        control: the control unit.
        context: the Context of the whole diagram.
        gain: which gain.
        value: in its unit; finite and not negative.
    """
    _parameter(control, context, gain).SetAtIndex(gain.index, value)


def get_gain(control: System, context: Context, gain: RuntimeGain) -> float:
    """Return a gain of the Context of the whole diagram."""
    return float(_parameter(control, context, gain).GetAtIndex(gain.index))


def _parameter(control: System, context: Context, gain: RuntimeGain) -> BasicVector:
    system, group = control, gain.group
    if isinstance(control, Diagram):
        names = next(name for name in _BLOCKS[gain.group] if control.HasSubsystemNamed(name))
        system, group = control.GetSubsystemByName(names), 0
    return system.GetMyMutableContextFromRoot(context).get_mutable_numeric_parameter(group)
