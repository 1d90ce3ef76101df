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


class AxleSuspension(Schema):
    """Springs, dampers and anti-roll bar of an axle, all referred to the wheel."""

    stiffness: float = Field(gt=0, description="[N/m] stiffness of one spring: force over wheel travel")
    damping: float = Field(ge=0, description="[N s/m] damping of one damper: force over velocity of the wheel travel")
    anti_roll: float = Field(
        default=0.0,
        ge=0,
        description="[N/m] force of the anti-roll bar on each wheel over the difference of wheel travel",
    )


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
    """Aerodynamic drag and lift. The drag is 1/2 x density x drag_area x (air speed relative to the vehicle)²."""

    drag_area: float = Field(ge=0, description="[m²] drag coefficient x frontal area")
    height: Length | None = Field(
        default=None,
        ge=0,
        description="[m] height of the centre of pressure above the road; null: height of the centre of mass",
    )
    front_lift_area: float = Field(default=0.0, description="[m²] lift coefficient of the front axle x frontal area")
    rear_lift_area: float = Field(
        default=0.0, description="[m²] lift coefficient of the rear axle x frontal area; negative is downforce"
    )
