"""Aerodynamic forces on a vehicle: drag along the relative wind, side force, and lift of each axle.

With ρ the density of the air, w the velocity of the air relative to the vehicle, u its longitudinal
component and A a drag or lift coefficient times the frontal area,

    drag  F = ½ ρ A |w| w    in the direction of the relative wind, parallel to the road,
    lift  F = ½ ρ A u²       at the axle, along z of the vehicle frame B,
    side  F = ½ ρ A |w| w_y  along y of B, with the lateral component w_y.

The drag acts above or below the centre of mass at a given height, so it transfers load between the axles. Without data
the area is the same from all directions. The side force acts ``side_ahead`` of the centre of mass: its yaw moment turns
a car away from the wind. In the coefficients of SAE J1594 at a small angle β of the wind, side_area = A dC_S/dβ and
side_ahead = L (dC_YM/dβ) / (dC_S/dβ) plus the distance from the centre of mass to the middle of the wheelbase L.

Wind is uniform; gusts begin and end with half a cosine.
"""

from collections.abc import Sequence
from math import cos, hypot, pi
from typing import NamedTuple

from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import Context, DiscreteValues

from mirdrake.core.errors import ConfigError
from mirdrake.core.leaf_system import LeafSystem
from mirdrake.core.signals import Signal, declare_state_output
from mirdrake.plant.plant import VehicleInPlant
from mirdrake.plant.wheels.motion import base_motion


class Gust(NamedTuple):
    """A gust in the whole world, in addition to the wind.

    Attributes:
        velocity: of the air at full strength, in the world, x and y [m/s].
        start: begin [s].
        duration: from begin to end [s].
        rise: duration of the begin and of the end [s].
    """

    velocity: tuple[float, float]
    start: float
    duration: float
    rise: float

    def strength(self, time: float) -> float:
        """Return the part of the full strength at a time [s], from 0 to 1."""
        edge = min(time - self.start, self.start + self.duration - time)
        if edge <= 0.0:
            return 0.0
        return 1.0 if edge >= self.rise else 0.5 - 0.5 * cos(pi * edge / self.rise)


class AirForces(LeafSystem):
    """Aerodynamic forces on one vehicle.

    Input ports:
        plant_state: the plant's state, positions and velocities.
    Output ports:
        generalized_force: value for the plant's applied generalised force (num_velocities) [N, N m].
        air_force (3) [N]: in the world, drag, side force and lift together.

    The outputs are discrete states, updated at the rate of the vehicle's controllers: the speed changes slowly.

    Args:
        plant: finalised plant.
        part: the vehicle.
        density: density of the air [kg/m³].
        wind: velocity of the air in the world, x and y [m/s].
        gusts: added to the wind.

    Raises:
        ConfigError: the density is negative.
    """

    def __init__(
        self,
        plant: MultibodyPlant,
        part: VehicleInPlant,
        *,
        density: float,
        wind: Sequence[float] = (0.0, 0.0),
        gusts: Sequence[Gust] = (),
    ) -> None:
        super().__init__()
        if not density >= 0.0:
            raise ConfigError(f"AirForces: density {density} is not allowed; it must be zero or above, in kg/m³")
        shape = part.vehicle.spec.aerodynamics
        # ρ / 2 times area: forces follow by the square of the relative speed.
        self._drag, self._lifts = (
            0.5 * density * shape.drag_area,
            (
                0.5 * density * shape.front_lift_area,
                0.5 * density * shape.rear_lift_area,
            ),
        )
        self._side = self._drag if shape.side_area is None else 0.5 * density * shape.side_area
        self._side_ahead = shape.side_ahead
        self._wind, self._gusts = (float(wind[0]), float(wind[1])), tuple(gusts)
        self._point, self._wheelbase = pressure_centre(plant, part), part.vehicle.geometry.wheelbase
        # Drake's order of positions and velocities, to read them from the state vector.
        self._positions, self._velocities = plant.num_positions(), plant.num_velocities()
        self._base = (part.base.floating_positions_start(), part.base.floating_velocities_start_in_v())
        self.plant_state = self.DeclareVectorInputPort("plant_state", plant.num_multibody_states())
        # A discrete state: the force is held between the updates, which have the rate of the control unit.
        self._force = self.DeclareDiscreteState(self._velocities)
        self._shown = self.DeclareDiscreteState(3)
        self.generalized_force = self.DeclareStateOutputPort("generalized_force", self._force)
        signals = [Signal(f"air_force_{axis}", "N", "force of the air, in the world") for axis in "xyz"]
        self.air_force = declare_state_output(self, "air_force", signals, self._shown)
        self.DeclarePeriodicDiscreteUpdateEvent(1.0 / part.vehicle.control.rate, 0.0, self._update)

    def _update(self, context: Context, state: DiscreteValues) -> None:
        base = base_motion(self.plant_state.Eval(context).tolist(), self._base, self._positions)
        (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = base.rows
        wx, wy, wz = base.turning
        px, _, pz = self._point
        rx, ry, rz = (
            xx * px + xz * pz,
            yx * px + yz * pz,
            zx * px + zz * pz,
        )  # pressure centre from B's origin, in the world

        # Drag at the pressure centre, by the relative wind there, parallel to the road.
        wind_x, wind_y = self._wind
        for gust in self._gusts:
            strength = gust.strength(context.get_time())
            wind_x, wind_y = wind_x + strength * gust.velocity[0], wind_y + strength * gust.velocity[1]
        air_x = wind_x - (base.velocity[0] + wy * rz - wz * ry)
        air_y = wind_y - (base.velocity[1] + wz * rx - wx * rz)
        # |v| v: the force has the direction of the relative wind.
        speed = hypot(air_x, air_y)
        pull = self._drag * speed
        fx, fy = pull * air_x, pull * air_y

        # The drag has a lateral part; the side force replaces it. It acts ahead of the pressure centre.
        across = air_x * xy + air_y * yy
        side = self._side * speed * across
        more = side - pull * across
        fx, fy = fx + more * xy, fy + more * yy
        yaw = self._side_ahead * side

        # Lift at the axles, in the plane y = 0 of B: moments about B's origin are about its y axis only.
        along = air_x * xx + air_y * yx
        front, rear = (area * along * along for area in self._lifts)
        # Lift at the front axle turns the nose up: a negative moment about y, to the left.
        lift, moment = front + rear, -front * self._wheelbase
        force = [0.0] * self._velocities
        v = self._base[1]
        force[v : v + 6] = (
            moment * xy - rz * fy + yaw * xz,
            moment * yy + rz * fx + yaw * yz,
            moment * zy + rx * fy - ry * fx + yaw * zz,
            fx + lift * xz,
            fy + lift * yz,
            lift * zz,
        )
        state.get_mutable_value(self._force)[:] = force
        state.get_mutable_value(self._shown)[:] = force[v + 3 : v + 6]


def pressure_centre(plant: MultibodyPlant, part: VehicleInPlant) -> tuple[float, float, float]:
    """Return the point of application of the drag in the vehicle frame B [m]: at the centre of mass's x, at the height.

    Args:
        plant: finalised plant.
        part: the vehicle.
    """
    context = plant.CreateDefaultContext()
    plant.SetFloatingBaseBodyPoseInWorldFrame(context, part.base, RigidTransform())
    x, _, z = plant.CalcCenterOfMassPositionInWorld(context, [part.instance]).tolist()
    height = part.vehicle.spec.aerodynamics.height
    return x, 0.0, z if height is None else height


def has_air_forces(part: VehicleInPlant, density: float) -> bool:
    """Return whether there are aerodynamic forces on a vehicle."""
    shape = part.vehicle.spec.aerodynamics
    return density > 0.0 and any((shape.drag_area, shape.side_area, shape.front_lift_area, shape.rear_lift_area))
