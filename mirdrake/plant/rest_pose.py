"""Rest pose of a vehicle: height, pitch, roll and wheel travel, so that nothing moves when a run begins.

Seven unknowns: height z, pitch θ and roll φ of the vehicle frame, and the load N of each wheel. Four equations are the
geometry of wheel, tyre and spring between body and road, three the equilibrium of loads and weight, with c the centre
of mass, p the wheel centres (p_y: where their planes meet the road) and g gravity along and across the vehicle:

    R - p_z = compression(N)              Σ N = -m g_z
    Σ p_x N = m (c_z g_x - c_x g_z)       Σ p_y N = m (c_z g_y - c_y g_z)

Moments are about the height of the road, so forces along the road have none: the vehicle is held by its brakes or moves
at constant speed. Newton's method with finite differences converges in a few steps.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Joint, ModelInstanceIndex, RigidBody
from pydrake.systems.framework import Context

from mirdrake.core.errors import ConfigError
from mirdrake.vehicles import Vehicle

# Newton's method needs a few; more mean that there is no such pose.
_ITERATIONS = 20
_SCALE = np.array([1e-3, 1e-3, 1e-3, 1.0, 1.0, 1.0, 1.0])  # steps of the finite differences [m, rad, rad, N]


class RestingVehicle(Protocol):
    """Attributes of :class:`mirdrake.plant.plant.VehicleInPlant` that a rest pose needs."""

    @property
    def vehicle(self) -> Vehicle: ...  # noqa: D102
    @property
    def instance(self) -> ModelInstanceIndex: ...  # noqa: D102
    @property
    def base(self) -> RigidBody: ...  # noqa: D102
    @property
    def suspension(self) -> tuple[Joint, ...]: ...  # noqa: D102
    @property
    def compression(self) -> tuple[Callable[[float], float], Callable[[float], float]]: ...  # noqa: D102


class RestPose(NamedTuple):
    """Pose of a vehicle at rest on the road plane.

    Attributes:
        z: height of the vehicle frame's origin [m].
        pitch: positive nose down [rad].
        roll: positive to the right [rad].
        travel: travel of each wheel, in the order of WHEELS [m]; zeros without suspension.
    """

    z: float
    pitch: float
    roll: float
    travel: tuple[float, ...]


def check_balance(
    plant: MultibodyPlant, context: Context, vehicle: Vehicle, instance: ModelInstanceIndex, *, above: bool = False
) -> None:
    """Check that the centre of mass of a vehicle is between the axles, so that it does not tip over.

    Args:
        plant: holds the vehicle, finalised.
        context: context of the plant, with the vehicle frame at the origin of the world.
        vehicle: the vehicle.
        instance: its model instance.
        above: also reject a centre of mass below the road, where load transfer has the wrong sign.

    Raises:
        ConfigError: the vehicle tips over, or its centre of mass is below the road; with the place of the link that
            contributes most.
    """
    # Outside of the axles no rest pose exists: the contact solver would let the vehicle fall.
    x, _, z = plant.CalcCenterOfMassPositionInWorld(context, [instance]).tolist()
    length = vehicle.geometry.wheelbase
    if x <= 0.0:
        reason, axis, start = f"{-x:.3g} m behind the rear axle: it tips over backwards", 0, 0.0
    elif x >= length:
        reason, axis, start = f"{x - length:.3g} m ahead of the front axle: it tips over forwards", 0, length
    elif above and z <= 0.0:
        reason, axis, start = f"{-z:.3g} m below the road", 2, 0.0
    else:
        return
    # The sign makes the contribution positive for links that move the centre of mass to the wrong side.
    sign = 1.0 if x >= length else -1.0
    # The link that contributes most to the moment is where a wrong mass or origin is.
    bodies = [plant.get_body(index) for index in plant.GetBodyIndices(instance)]

    def contribution(body: RigidBody) -> float:
        centre = body.CalcCenterOfMassInBodyFrame(context)
        position = plant.EvalBodyPoseInWorld(context, body).multiply(centre)
        return float(sign * body.get_mass(context) * (position[axis] - start))

    worst = max(bodies, key=contribution).name()
    location = vehicle.link_places.get(worst, "")
    raise ConfigError(
        f"{location}{': ' if location else ''}the centre of mass of '{vehicle.name}' is {reason}; "
        f"check mass and origin of link '{worst}', which contributes most"
    )


def find_rest_pose(
    plant: MultibodyPlant, part: RestingVehicle, *, yaw: float = 0.0, R_WP: RotationMatrix | None = None
) -> RestPose | None:
    """Return the rest pose of a vehicle under the plant's gravity; None if it does not rest on all wheels.

    Args:
        plant: the finalised plant.
        part: the vehicle.
        yaw: its heading [rad]; it matters on a slope.
        R_WP: axes of the plane on which it rests, x along its heading; by default the plane z = 0.
    """
    # Mass, gravity in vehicle axes, wheel centres, and the load of each wheel at zero travel.

    # Centre of mass and gravity are taken in vehicle axes, with the suspension at zero travel.
    geometry, springs = part.vehicle.geometry, part.vehicle.spec.suspension
    context = plant.CreateDefaultContext()
    plant.SetFloatingBaseBodyPoseInWorldFrame(context, part.base, RigidTransform())
    mass = float(plant.CalcTotalMass(context, [part.instance]))
    com = plant.CalcCenterOfMassPositionInWorld(context, [part.instance])
    R_PW = RotationMatrix.MakeZRotation(-yaw) if R_WP is None else R_WP.inverse()
    g = R_PW.multiply(plant.gravity_field().gravity_vector())
    tracks = np.array([geometry.front_track, -geometry.front_track, geometry.rear_track, -geometry.rear_track])
    radii = np.array(geometry.wheel_radii)
    centres = np.column_stack([[geometry.wheelbase] * 2 + [0.0] * 2, 0.5 * tracks, radii])
    carried = np.zeros(4)  # load of each wheel on the road at zero travel
    if springs is not None:
        below = [plant.GetBodiesKinematicallyAffectedBy([joint.index()]) for joint in part.suspension]
        unsprung = [sum(plant.get_body(body).default_mass() for body in bodies) for bodies in below]
        # The road carries the unsprung mass of a wheel directly, beside the load of its spring.
        carried = np.array(part.vehicle.spring_loads) - g[2] * np.array(unsprung)

    # Travel of the wheels under loads: springs and anti-roll bars.
    def travel(loads: NDArray[np.float64]) -> NDArray[np.float64]:
        if springs is None:
            return np.zeros(4)
        spring_loads = []
        for axle, spring in ((0, springs.front), (2, springs.rear)):
            left, right = (loads - carried)[axle : axle + 2]
            # In heave only the springs act, in roll also the anti-roll bar, on the difference of the two travels.
            both, apart = (
                (left + right) / spring.stiffness,
                (left - right) / (spring.stiffness + 2.0 * spring.anti_roll),
            )
            spring_loads += [0.5 * (both + apart), 0.5 * (both - apart)]
        return np.array(spring_loads)

    # Residuals of the seven equations.
    def residual(unknown: NDArray[np.float64]) -> NDArray[np.float64]:
        z, pitch, roll, *loads = unknown
        N = np.array(loads)
        R_WB = RollPitchYaw(roll, pitch, 0.0).ToRotationMatrix().matrix()
        lifted = centres + np.outer(travel(N), [0.0, 0.0, 1.0])
        p, c = lifted @ R_WB.T + [0.0, 0.0, z], R_WB @ com + [0.0, 0.0, z]
        pressed = [part.compression[i // 2](load) for i, load in enumerate(loads)]
        sums = [N.sum() + mass * g[2], p[:, 0] @ N - mass * (c[2] * g[0] - c[0] * g[2])]
        across = p[:, 1] - radii * R_WB[1, 2]  # an inclined wheel touches the road in its own plane
        sums += [across @ N - mass * (c[2] * g[1] - c[1] * g[2])]
        # Forces over about the weight, so that all residuals have the size of millimetres and one tolerance fits.
        return np.concatenate([radii - p[:, 2] - pressed, np.array(sums) / (mass * 10.0)])

    # Start from the level pose with the static loads.
    share = com[0] / geometry.wheelbase
    start = -0.5 * mass * g[2] * np.array([share, share, 1.0 - share, 1.0 - share])
    pressed = [part.compression[i // 2](load) for i, load in enumerate(start)]
    unknown = np.array([-pressed[2], (pressed[0] - pressed[2]) / geometry.wheelbase, 0.0, *start])
    # The centre of mass is not between the axles.
    if (start <= 0.0).any():
        return None
    for _ in range(_ITERATIONS):
        now = residual(unknown)
        if np.abs(now).max() < 1e-12:
            break
        # Each step is a row of a diagonal matrix, so its sum is its length.
        slopes = [(residual(unknown + step) - now) / step.sum() for step in np.diag(_SCALE)]
        unknown = unknown - np.linalg.solve(np.column_stack(slopes), now)
        # A wheel that would have to pull at the road lifts: there is no rest on four wheels.
        if not np.isfinite(unknown).all() or (unknown[3:] <= 0.0).any():
            return None
    if np.abs(residual(unknown)).max() > 1e-9:
        return None
    # The travel must be within the limits of the joints.
    moved: Sequence[float] = travel(unknown[3:]).tolist()
    if any(
        not joint.position_lower_limits()[0] < z < joint.position_upper_limits()[0]
        for joint, z in zip(part.suspension, moved, strict=False)
    ):
        return None
    return RestPose(float(unknown[0]), float(unknown[1]), float(unknown[2]), tuple(moved))
