"""Longitudinal force that the test of a speed loop requires of the tyres, over the available one (grip use).

Above 1, no gains can follow the set-point. The available force is that of :mod:`mirdrake.vehicles.traction`.
"""

import numpy as np

from mirdrake.tuning.loops.base import Conditions, LoopSpec
from mirdrake.tuning.loops.bench import PlantBench
from mirdrake.vehicles.traction import Axles


def axles_of(bench: PlantBench) -> Axles:
    """Return the axles of the vehicle on a bench."""
    plant, part = bench.assembly.parts.plant, bench.part
    context = plant.CreateDefaultContext()
    # Default context: the car at its design position, without the load of the test.
    centre = plant.CalcCenterOfMassPositionInWorld(context, [part.instance])
    hubs = [plant.EvalBodyPoseInWorld(context, joint.child_body()).translation() for joint in part.wheels]
    front, rear = np.mean(hubs[:2], axis=0), np.mean(hubs[2:], axis=0)
    # Contact height of the tyres: the hub less the rolling radius under load.
    road = front[2] - part.rolling_radii(plant)[0]
    driven = part.vehicle.spec.drive
    return Axles(
        to_front=float(front[0] - centre[0]),
        to_rear=float(centre[0] - rear[0]),
        height=float(centre[2] - road),
        front=driven != "rear",
        rear=driven != "front",
    )


def grip_use(axles: Axles, loop: LoopSpec, conditions: Conditions) -> float:
    """Return the grip use of the test of a speed loop under conditions [1]."""
    limits = loop.diagram["vehicles"][loop.vehicle]["control"]["speed"]
    slope = limits["max_acceleration"] if loop.course.step > 0.0 else -limits["max_deceleration"]
    friction = loop.friction if conditions.friction is None else conditions.friction
    return axles.use(friction or 0.0, conditions.grade, slope)
