"""Forces of a suspension that Drake has no element for: anti-roll bars and bump stops.

Springs are elements of Drake (:func:`mirdrake.plant.plant.add_vehicle`), and forces of the arms are part of the tyre
forces (:mod:`mirdrake.plant.wheels.arms`). What follows here is applied as generalised forces on the joints of the
wheel travels z, which are positive in bump.

**Dampers.** The joint damping of a discrete step of Drake takes the velocity at the end of the step (implicit Euler).
It would lead the other forces by half a step: at 5 ms the body's vertical motion is wrong by 3 % at 3 Hz and by 11
degrees at 20 Hz. One half of a damper is therefore joint damping, the other one acts here on the velocity at the
beginning of the step: the trapezoidal rule, of second order and stable for any damping.

**Anti-roll bar**: a torsion spring between the wheels of an axle, with the stiffness k,

    F_left = -k (z_left - z_right) = -F_right.

A roll angle φ of the body makes z_left - z_right = T φ over the track T, so a bar adds k T² to the axle's roll
stiffness; the two springs c contribute c T² / 2.

**Bump stop**: F = -c (z - z0) beyond the travel z0.
"""

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import AffineSystem, MatrixGain, Saturation

from mirdrake.core.errors import ConfigError
from mirdrake.core.yaml_io import where
from mirdrake.plant.plant import VehicleInPlant
from mirdrake.vehicles import WHEELS

Array = npt.NDArray[np.float64]

MAX_STOP_RATE = 1.0
"""Largest product of the time step and the natural frequency of a wheel on its bump stop [1].

The stop is integrated explicitly, which is unstable above 2."""


def make_axle_forces(plant: MultibodyPlant, part: VehicleInPlant) -> MatrixGain | None:
    """Return a gain from the state of a model instance to the plant's generalised forces; None without suspension.

    The forces are those of the anti-roll bars and of the explicit half of the dampers.

    Args:
        plant: finalised plant.
        part: the vehicle.
    """
    springs = part.vehicle.spec.suspension
    if springs is None or not part.suspension:
        return None
    # Indices of the joints' positions and velocities in the state of the instance: Drake sorts them as in the whole.
    q = plant.GetPositionsFromArray(part.instance, np.arange(plant.num_positions(), dtype=float)).tolist()
    v = plant.GetVelocitiesFromArray(part.instance, np.arange(plant.num_velocities(), dtype=float)).tolist()
    columns = [q.index(joint.position_start()) for joint in part.suspension]
    rows = [joint.velocity_start() for joint in part.suspension]
    D = np.zeros((plant.num_velocities(), plant.num_multibody_states(part.instance)))
    for axle, bar in ((0, springs.front), (2, springs.rear)):
        left, right = axle, axle + 1
        D[rows[left], columns[left]] = D[rows[right], columns[right]] = -bar.anti_roll
        D[rows[left], columns[right]] = D[rows[right], columns[left]] = bar.anti_roll
    for joint, row, corner in zip(part.suspension, rows, springs.corners(), strict=True):
        D[row, len(q) + v.index(row)] = joint.default_damping() - corner.damping
    return MatrixGain(D)


def make_bump_stops(plant: MultibodyPlant, part: VehicleInPlant) -> Diagram | None:
    """Return bump stops, from the state of a model instance to the plant's generalised forces; None without stops.

    Args:
        plant: finalised plant.
        part: the vehicle.

    Raises:
        ConfigError: a stop is too stiff for the time step of the plant.
    """
    spec = part.vehicle.spec
    if spec.suspension is None or not part.suspension:
        return None
    stops = [axle.bump_stop for axle in spec.suspension.corners()]
    if not any(stops):
        return None
    picked = plant.GetPositionsFromArray(part.instance, np.arange(plant.num_positions(), dtype=float)).tolist()
    pick = np.zeros((len(WHEELS), plant.num_multibody_states(part.instance)))
    # A wheel without a stop keeps zeros here and has no force.
    begin, stiffness = np.zeros(len(WHEELS)), np.zeros(len(WHEELS))
    for index, (joint, stop) in enumerate(zip(part.suspension, stops, strict=True)):
        if stop is None:
            continue
        pick[index, picked.index(joint.position_start())] = 1.0
        begin[index], stiffness[index] = stop.travel, stop.stiffness
        below = plant.GetBodiesKinematicallyAffectedBy([joint.index()])
        unsprung = sum(float(plant.get_body(body).default_mass()) for body in below)
        if part.period * math.sqrt(stop.stiffness / unsprung) > MAX_STOP_RATE:
            limit = unsprung * (MAX_STOP_RATE / part.period) ** 2
            raise ConfigError(
                f"the bump stop of {stop.stiffness:g} N/m is too stiff for "
                f"{unsprung:.3g} kg of unsprung mass and steps of {part.period:g} s; at most {limit:.3g} N/m, or "
                "smaller steps",
                where=where(spec, "suspension"),
            )
    builder = DiagramBuilder()
    # Travel beyond the stop; C++ blocks, because they are evaluated in each step.
    travel = builder.AddNamedSystem("travel", MatrixGain(pick))
    beyond = builder.AddNamedSystem("beyond", Saturation(begin, np.full(len(WHEELS), math.inf)))
    # -c (z - z0), on the rows of the joints.
    rows = _rows(plant, part)
    force = builder.AddNamedSystem("force", _affine(-rows * stiffness, rows @ (stiffness * begin)))
    builder.Connect(travel.get_output_port(), beyond.get_input_port())
    builder.Connect(beyond.get_output_port(), force.get_input_port())
    builder.ExportInput(travel.get_input_port(), "state")
    builder.ExportOutput(force.get_output_port(), "generalized_force")
    return builder.Build()


def _rows(plant: MultibodyPlant, part: VehicleInPlant) -> Array:
    """Return the matrix (num_velocities, 4) that puts forces on the wheel travels at their places."""
    rows = np.zeros((plant.num_velocities(), len(WHEELS)))
    for index, joint in enumerate(part.suspension):
        rows[joint.velocity_start(), index] = 1.0
    return rows


def _affine(D: Array, y0: Array | Sequence[float]) -> AffineSystem:
    """Return the system y = D u + y0."""
    outputs, inputs = D.shape
    return AffineSystem(
        A=np.zeros((0, 0)), B=np.zeros((0, inputs)), f0=np.zeros(0), C=np.zeros((outputs, 0)), D=D, y0=np.asarray(y0)
    )
