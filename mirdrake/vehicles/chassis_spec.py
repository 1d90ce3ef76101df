"""Schemas of vehicle.yaml about what carries the body and what the air does to it: suspension, aerodynamics.

Their laws are in :mod:`mirdrake.plant.suspension` and :mod:`mirdrake.plant.aerodynamics`.
"""

from pydantic import Field

from mirdrake.core.yaml_io import Length, Schema

# --- suspension --------------------------------------------------------------------------------------------------


class SuspensionJoints(Schema):
    """The prismatic joints on which the wheels move up against the body; 0 is the loaded car at rest."""

    front_left: str
    front_right: str
    rear_left: str
    rear_right: str

    def names(self) -> tuple[str, str, str, str]:
        """Joint names in the order of :data:`mirdrake.vehicles.spec.WHEELS`."""
        return (self.front_left, self.front_right, self.rear_left, self.rear_right)


class AxleSuspension(Schema):
    """Springs, dampers and anti-roll bar of an axle, all at the wheel."""

    stiffness: float = Field(gt=0, description="[N/m] of one spring, force over wheel travel")
    damping: float = Field(ge=0, description="[N s/m] of one damper, force over speed of wheel travel")
    anti_roll: float = Field(
        default=0.0, ge=0, description="[N/m] force of the bar on each wheel over the difference of their travel"
    )


class Suspension(Schema):
    """Springs of both axles; their lengths follow from the masses, so that the car stands as designed."""

    front: AxleSuspension
    rear: AxleSuspension

    def corners(self) -> tuple[AxleSuspension, AxleSuspension, AxleSuspension, AxleSuspension]:
        """That of each wheel, in the order of :data:`mirdrake.vehicles.spec.WHEELS`."""
        return (self.front, self.front, self.rear, self.rear)


# --- aerodynamics ------------------------------------------------------------------------------------------------


class Aerodynamics(Schema):
    """Air resistance and lift. The drag is 1/2 x density x drag_area x (speed of the air past the car)²."""

    drag_area: float = Field(ge=0, description="[m²] drag coefficient x frontal area")
    height: Length | None = Field(
        default=None, ge=0, description="[m] of the drag over the road; empty: that of the centre of mass"
    )
    front_lift_area: float = Field(default=0.0, description="[m²] lift coefficient of the front axle x frontal area")
    rear_lift_area: float = Field(default=0.0, description="[m²] the same at the rear; negative presses down")
