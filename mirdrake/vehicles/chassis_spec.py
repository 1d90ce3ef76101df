"""Schemas of vehicle.yaml for suspension and aerodynamics.

Their force laws are in :mod:`mirdrake.plant.suspension` and :mod:`mirdrake.plant.aerodynamics`.
"""

from pydantic import Field

from mirdrake.core.yaml_io import Length, Schema

# --- suspension --------------------------------------------------------------------------------------------------


class WheelJoints(Schema):
    """Continuous joints of the four wheels."""

    front_left: str
    front_right: str
    rear_left: str
    rear_right: str

    def names(self) -> tuple[str, str, str, str]:
        """Return the joint names in the order of :data:`mirdrake.vehicles.spec.WHEELS`."""
        return (self.front_left, self.front_right, self.rear_left, self.rear_right)


class SuspensionJoints(WheelJoints):
    """Prismatic joints of the wheel suspension, positive in bump; 0 is the loaded vehicle at rest."""


class BumpStop(Schema):
    """A spring that a wheel meets near the end of its bump travel."""

    travel: Length = Field(gt=0, description="[m] bump travel at which the stop is met")
    stiffness: float = Field(gt=0, description="[N/m] stiffness of the stop: force over further travel")


class AxleSuspension(Schema):
    """Springs, dampers, anti-roll bar and geometry of an axle, all referred to the wheel."""

    stiffness: float = Field(gt=0, description="[N/m] stiffness of one spring: force over wheel travel")
    damping: float = Field(ge=0, description="[N s/m] damping of one damper: force over velocity of the wheel travel")
    anti_roll: float = Field(
        default=0.0,
        ge=0,
        description="[N/m] force of the anti-roll bar on each wheel over the difference of wheel travel",
    )
    roll_centre: Length = Field(
        default=0.0, gt=-0.5, lt=1.0, description="[m] height of the roll centre of the axle above the road"
    )
    anti_brake: float = Field(
        default=0.0,
        gt=-1,
        lt=1,
        description="[1] part of the braking force of a wheel that its arms take as a vertical force: positive reduces "
        "the dive of the front axle, and the lift of the rear axle",
    )
    anti_drive: float = Field(
        default=0.0,
        gt=-1,
        lt=1,
        description="[1] the same of the driving force: positive reduces the lift of the front axle, and the squat of "
        "the rear axle",
    )
    bump_stop: BumpStop | None = Field(default=None, description="null: only the end stops, the limits of the joints")


class Suspension(Schema):
    """Suspension of both axles.

    The preload follows from the masses, so that the vehicle rests in its design position.
    """

    front: AxleSuspension
    rear: AxleSuspension

    def corners(self) -> tuple[AxleSuspension, AxleSuspension, AxleSuspension, AxleSuspension]:
        """Return the suspension of each wheel, in the order of :data:`mirdrake.vehicles.spec.WHEELS`."""
        return (self.front, self.front, self.rear, self.rear)


# --- aerodynamics ------------------------------------------------------------------------------------------------


class Aerodynamics(Schema):
    """Aerodynamic drag, side force and lift. The drag is 1/2 x density x drag_area x (relative air speed)²."""

    drag_area: float = Field(ge=0, description="[m²] drag coefficient x frontal area")
    height: Length | None = Field(
        default=None,
        ge=0,
        description="[m] height of the centre of pressure above the road; null: height of the centre of mass",
    )
    side_area: float | None = Field(
        default=None,
        ge=0,
        description="[m²] side force coefficient x frontal area, for the lateral part of the relative air speed; "
        "null: as drag_area",
    )
    side_ahead: float = Field(
        default=0.0,
        description="[m] point of action of the side force, ahead of the centre of mass; positive for cars, which yaw "
        "away from the wind",
    )
    front_lift_area: float = Field(default=0.0, description="[m²] lift coefficient of the front axle x frontal area")
    rear_lift_area: float = Field(
        default=0.0, description="[m²] lift coefficient of the rear axle x frontal area; negative is downforce"
    )
