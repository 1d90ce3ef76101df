"""Anti-roll bars: a torsion spring between the wheels of an axle, which acts on the difference of their travel.

Springs and dampers are elements of Drake (:func:`mirdrake.plant.plant.add_vehicle`). A bar couples two joints, for
which Drake has no force element. Its forces are therefore applied externally: with travels z and the stiffness k,

    F_left = -k (z_left - z_right) = -F_right.

A roll angle φ of the body makes z_left - z_right = T φ over the track T, so a bar adds k T² to the axle's roll
stiffness; the two springs c contribute c T² / 2. The model has no suspension arms, hence no anti-dive, and the
roll axis is on the road.
"""

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.primitives import MatrixGain

from mirdrake.plant.plant import VehicleInPlant


def make_anti_roll(plant: MultibodyPlant, part: VehicleInPlant) -> MatrixGain | None:
    """Return a gain from the state of a model instance to the plant's generalised forces; None without bars.

    Args:
        plant: finalised plant.
        part: the vehicle.
    """
    springs = part.vehicle.spec.suspension
    if springs is None or not part.suspension or not (springs.front.anti_roll or springs.rear.anti_roll):
        return None
    # Indices of the joints' positions in the state of the instance: Drake sorts them as in the whole state.
    picked = plant.GetPositionsFromArray(part.instance, np.arange(plant.num_positions(), dtype=float)).tolist()
    columns = [picked.index(joint.position_start()) for joint in part.suspension]
    rows = [joint.velocity_start() for joint in part.suspension]
    D = np.zeros((plant.num_velocities(), plant.num_multibody_states(part.instance)))
    for axle, bar in ((0, springs.front), (2, springs.rear)):
        left, right = axle, axle + 1
        D[rows[left], columns[left]] = D[rows[right], columns[right]] = -bar.anti_roll
        D[rows[left], columns[right]] = D[rows[right], columns[left]] = bar.anti_roll
    return MatrixGain(D)
