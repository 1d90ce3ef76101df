"""Gains of a control unit in a Context, whether the unit is one fused system or a Diagram of blocks."""

from pydrake.systems.framework import BasicVector, Context, Diagram, System

from mirdrake.vehicles.spec import STEERING_LOOPS, RuntimeGain

_BLOCKS = (("speed_pid",), ("wheel_loops", "pedal_loop"), STEERING_LOOPS)
"""Blocks that hold the gains of each group; a vehicle has one or both of them."""


def set_gain(control: System, context: Context, gain: RuntimeGain, value: float) -> None:
    """Write a gain into a Context.

    Args:
        control: the control unit.
        context: the Context of the whole diagram.
        gain: which gain.
        value: in its unit; finite and not negative.
    """
    for parameter in _parameters(control, context, gain):
        parameter.SetAtIndex(gain.index, value)


def get_gain(control: System, context: Context, gain: RuntimeGain) -> float:
    """Return a gain of the Context of the whole diagram."""
    return float(_parameters(control, context, gain)[0].GetAtIndex(gain.index))


def _parameters(control: System, context: Context, gain: RuntimeGain) -> list[BasicVector]:
    """Return the parameters that hold a gain: one, or one for each steering joint."""
    systems, group = [control], gain.group
    if isinstance(control, Diagram):
        systems = [control.GetSubsystemByName(name) for name in _BLOCKS[group] if control.HasSubsystemNamed(name)]
        group = 0
    return [system.GetMyMutableContextFromRoot(context).get_mutable_numeric_parameter(group) for system in systems]
