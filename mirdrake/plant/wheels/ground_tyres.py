"""Tyres that touch the ground themselves (`plant.contact: tyre`), in the plant.

The plant's contact has no wheels on the ground then. Vertical force, slip forces and rolling resistance of a vehicle's
tyres follow from the plant's state and the terrain, without delay; the equations are in
:mod:`mirdrake.plant.wheels.ground_step`.
"""

import numpy as np
from pydrake.multibody.plant import MultibodyPlant

from mirdrake.core.compiled import records
from mirdrake.core.errors import ConfigError
from mirdrake.ground import Terrain
from mirdrake.plant.plant import VehicleInPlant
from mirdrake.plant.wheels.ground_contact import CONTACT_SIZE
from mirdrake.plant.wheels.ground_step import GROUND_STEP_PARTS, GroundWheel, ground_step
from mirdrake.plant.wheels.tyre_forces import (
    REFERENCE_FRICTION,
    Bearing,
    TyreSystem,
    fastest_bounce,
    load_mobility,
    make_spinning_wheels,
)


def make_ground_wheels(plant: MultibodyPlant, part: VehicleInPlant) -> list[GroundWheel]:
    """Return the wheels of a vehicle in a finalised plant.

    Raises:
        ConfigError: the vehicle tips over, as its centre of mass is not between its axles.
    """
    wheels = []
    for index, wheel in enumerate(make_spinning_wheels(plant, part)):
        wheels.append(GroundWheel(wheel, part.compression[index >= 2]))
    return wheels


class GroundTyres(TyreSystem):
    """Tyre forces of a vehicle whose tyres touch the ground themselves.

    Args:
        plant: finalised plant.
        part: the vehicle.
        terrain: the ground.
        friction: friction of the ground at the start [1].

    Raises:
        ConfigError: a .tir file is missing or wrong, the vehicle tips over, or its tyres are too stiff for the steps.
    """

    def __init__(
        self,
        plant: MultibodyPlant,
        part: VehicleInPlant,
        terrain: Terrain,
        *,
        friction: float = REFERENCE_FRICTION,
    ) -> None:
        ground_wheels = make_ground_wheels(plant, part)
        # Explicit steps are unstable beyond ω dt = 2.
        bounce = fastest_bounce(plant, part, load_mobility(plant, part))
        if bounce * part.period > 2.0:
            raise ConfigError(
                f"the vehicle oscillates on its tyres with {bounce:.0f} rad/s, too fast for tyre contact "
                f"and steps of {part.period:g} s; choose a time_step of {1.9 / bounce:.2g} s or less, or contact: "
                "point on the plane",
                where=part.name,
            )
        wheels, static_loads = records(GroundWheel, ground_wheels), [one.wheel.static_load for one in ground_wheels]
        # A repeated step keeps the sampled contacts.
        data, samples, contacts = terrain.data, terrain.samples, np.zeros((len(wheels), CONTACT_SIZE))
        bearing = Bearing(
            step=ground_step,
            parts=GROUND_STEP_PARTS,
            wheels=wheels,
            static_loads=static_loads,
            arguments=lambda again: (data, samples, contacts, again),
            joints=True,
        )
        super().__init__(plant, part, bearing, friction=friction)
