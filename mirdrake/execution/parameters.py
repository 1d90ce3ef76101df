"""Context parameters: numbers of a built diagram that a run may change in its Context, without building it again.

==============================  ======  =============================================================================
``<vehicle>.speed.kp``, ``ki``  1, 1/s  trim of the speed loop; not of a vehicle with pedals
``<vehicle>.wheel_speed.*``     own     gains of the wheel loops' kind: kp, ki, kd of pid; kp, ki of pedals
``<vehicle>.steering.*``        own     gains of the steering loops' kind: kp, ki, kd of pid
``<vehicle>.mass_scale``        1       factor of mass and inertia of all bodies; controllers are not adapted
``road.friction``               1       coefficient of the whole road, where it is the same everywhere
==============================  ======  =============================================================================

A new context parameter is a line in :func:`find_context_parameters`. Gains of servos are not among them, as Drake keeps
them in the plant and not in the Context; nor are gains that control.yaml schedules over speed.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

from pydrake.multibody.tree import SpatialInertia
from pydrake.systems.framework import Context

from mirdrake.assembly.diagram import Assembly
from mirdrake.controllers.runtime_gains import set_gain
from mirdrake.vehicles import WHEELS, Vehicle
from mirdrake.vehicles.spec import RuntimeGain
from mirdrake.worlds import World


@dataclass(frozen=True)
class ContextParameter:
    """A number that a run may change in its Context.

    Attributes:
        name: as in the table above.
        unit: unit of its value.
        apply: sets the value in a new Context of the assembly's diagram.
        positive: whether its value must be above zero.
    """

    name: str
    unit: str
    apply: Callable[[Assembly, Context, float], None]
    positive: bool = False


def find_context_parameters(vehicles: Mapping[str, Vehicle], world: World) -> dict[str, ContextParameter]:
    """Return the context parameters of a diagram by name.

    Args:
        vehicles: vehicles of the diagram, by name.
        world: world of the diagram.
    """
    parameters: list[ContextParameter] = []
    for name, vehicle in vehicles.items():
        parameters += [
            ContextParameter(f"{name}.{gain.path}", gain.unit, partial(_set_gain, name, gain))
            for gain in vehicle.control.gains()
        ]
        parameters.append(ContextParameter(f"{name}.mass_scale", "1", partial(_scale_mass, name), positive=True))
    # With several coefficients, one number could not describe the road.
    if len({world.ground.mu, *(mu for _, mu in world.friction_areas)}) == 1:
        parameters.append(ContextParameter("road.friction", "1", _set_friction, positive=True))
    return {parameter.name: parameter for parameter in parameters}


def _set_gain(vehicle: str, gain: RuntimeGain, assembly: Assembly, context: Context, value: float) -> None:
    control = assembly.diagram.GetSubsystemByName(f"{vehicle}.control")
    set_gain(control, context, gain, value)


def _scale_mass(vehicle: str, assembly: Assembly, context: Context, value: float) -> None:
    plant = assembly.parts.plant
    plant_context = plant.GetMyMutableContextFromRoot(context)
    for index in plant.GetBodyIndices(assembly.parts.vehicles[vehicle].instance):
        body = plant.get_body(index)
        inertia = body.CalcSpatialInertiaInBodyFrame(plant_context)
        mass: Any = inertia.get_mass()
        # Massless links (frames of joints) have no inertia to scale.
        if mass > 0.0:
            # Unit inertia is per mass, so that it stays, and the inertia scales with the mass.
            scaled = SpatialInertia(value * mass, inertia.get_com(), inertia.get_unit_inertia())
            body.SetSpatialInertiaInBodyFrame(plant_context, scaled)


def _set_friction(assembly: Assembly, context: Context, value: float) -> None:
    for tyres in assembly.tyres.values():
        for wheel in range(len(WHEELS)):
            tyres.set_friction(tyres.GetMyMutableContextFromRoot(context), wheel, value)
