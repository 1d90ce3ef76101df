"""Vehicle parameters in the Context of its plant: mass, centre of mass, yaw inertia, wheel damping."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex, SpatialInertia, UnitInertia
from pydrake.systems.framework import Context

from mirdrake.core.errors import first_line
from mirdrake.identification.models.base import Array
from mirdrake.plant.plant import VehicleInPlant


@dataclass(frozen=True)
class MassProperties:
    """Mass properties of several bodies, in the axes of the vehicle frame.

    Attributes:
        mass: [kg].
        com: centre of mass relative to the middle of the rear axle on the ground (3) [m].
        inertia: about the centre of mass (3, 3) [kg m²].
    """

    mass: float
    com: Array
    inertia: Array


def measure(plant: MultibodyPlant, part: VehicleInPlant, *, base: bool = True) -> MassProperties:
    """Return the mass properties of a vehicle as in its files.

    Args:
        plant: the finalised plant.
        part: the vehicle in it.
        base: whether its base body counts.
    """
    context = plant.CreateDefaultContext()
    plant.SetFloatingBaseBodyPoseInWorldFrame(context, part.base, RigidTransform())
    bodies = [index for index in plant.GetBodyIndices(part.instance) if base or index != part.base.index()]
    return _whole(plant, context, bodies)


def _whole(plant: MultibodyPlant, context: Context, bodies: list[BodyIndex]) -> MassProperties:
    spatial = plant.CalcSpatialInertia(context, plant.world_frame(), bodies)
    com = np.array(spatial.get_com())
    inertia = spatial.Shift(spatial.get_com()).CalcRotationalInertia().CopyToFullMatrix3()
    return MassProperties(float(spatial.get_mass()), com, np.array(inertia))


def _about(part: MassProperties, place: Array) -> Array:
    """Return the inertia about another point (3, 3)."""
    # Parallel axis theorem (Steiner).
    arm = part.com - place
    return np.asarray(part.inertia + part.mass * (arm @ arm * np.eye(3) - np.outer(arm, arm)))


def body_inertia(whole: MassProperties, rest: MassProperties, p: Mapping[str, float]) -> SpatialInertia:
    """Return the inertia of the base body with which the whole vehicle has the requested mass properties.

    The roll inertia of the vehicle stays; the pitch inertia changes by as much as the yaw inertia, as if masses were
    moved along the car.

    Args:
        whole: the vehicle as in its files.
        rest: the same without its base body.
        p: mass [kg], rear_length: centre of mass ahead of the rear axle [m], com_height [m], yaw_inertia about the
            centre of mass [kg m²].

    Raises:
        ValueError: no body can have such an inertia.
    """
    # The rest of the vehicle is fixed, so the base body takes the difference.
    mass = p["mass"] - rest.mass
    if mass <= 0.0:
        raise ValueError(f"the wheels alone have {rest.mass:.4g} kg")
    com = np.array([p["rear_length"], whole.com[1], p["com_height"]])
    own = (p["mass"] * com - rest.mass * rest.com) / mass
    inertia = whole.inertia.copy()
    change = p["yaw_inertia"] - whole.inertia[2, 2]
    inertia[1, 1] += change
    inertia[2, 2] += change
    about = inertia - _about(rest, com)  # of the base body about the common centre of mass
    about -= _about(MassProperties(mass, own, np.zeros((3, 3))), com)
    # Drake's constructor takes the inertia of a unit mass.
    about /= mass
    unit = UnitInertia(*np.diag(about), about[0, 1], about[0, 2], about[1, 2])
    try:
        found = SpatialInertia.MakeFromCentralInertia(mass, own, unit * mass)
    except RuntimeError as error:
        raise ValueError(first_line(error)) from None
    if not found.IsPhysicallyValid():
        raise ValueError("no body can have such an inertia")
    return found


def set_damping(context: Context, part: VehicleInPlant, damping: float) -> None:
    """Write the damping of all wheel joints [N m s/rad] into a Context of the plant."""
    for joint in part.wheels:
        joint.SetDampingVector(context, [damping])
