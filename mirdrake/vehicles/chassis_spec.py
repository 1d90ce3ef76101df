"""Schemas of vehicle.yaml for suspension and aerodynamics.

Their force laws are in :mod:`mirdrake.plant.suspension` and :mod:`mirdrake.plant.aerodynamics`.
"""

from itertools import pairwise
from typing import Annotated, Any

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from mirdrake.core.yaml_io import Angle, Length, Schema

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


MAX_TRAVELS = 16
"""Largest number of different wheel travels in the tables of an axle."""


def _as_table(value: Any) -> Any:
    """Return a single number, or text with a unit, as a table with one row, which is constant."""
    return value if isinstance(value, list | tuple) else [(0.0, value)]


def _ascending(rows: list[tuple[float, float]]) -> list[tuple[float, float]]:
    if any(late[0] <= early[0] for early, late in pairwise(rows)):
        raise ValueError("needs rows (travel, value) with ascending travel")
    return rows


Travel = Annotated[Length, Field(ge=-0.5, le=0.5)]
Lean = Annotated[Angle, Field(ge=-0.3, le=0.3)]
AngleOverTravel = Annotated[
    list[tuple[Travel, Lean]],
    BeforeValidator(_as_table, json_schema_input_type=float | str | list[tuple[float | str, float | str]]),
    AfterValidator(_ascending),
]
HeightOverTravel = Annotated[
    list[tuple[Travel, Annotated[Length, Field(gt=-0.5, lt=1.0)]]],
    BeforeValidator(_as_table, json_schema_input_type=float | str | list[tuple[float | str, float | str]]),
    AfterValidator(_ascending),
]
SlopeOverTravel = Annotated[
    list[tuple[Travel, Annotated[float, Field(gt=-1, lt=1)]]],
    BeforeValidator(_as_table, json_schema_input_type=float | list[tuple[float | str, float]]),
    AfterValidator(_ascending),
]


class AxleSuspension(Schema):
    """Springs, dampers, anti-roll bar and geometry of an axle, all referred to the wheel.

    Each quantity of the geometry is a number, or a table of rows (wheel travel, value).
    """

    stiffness: float = Field(gt=0, description="[N/m] stiffness of one spring: force over wheel travel")
    damping: float = Field(ge=0, description="[N s/m] damping of one damper: force over velocity of the wheel travel")
    anti_roll: float = Field(
        default=0.0,
        ge=0,
        description="[N/m] force of the anti-roll bar on each wheel over the difference of wheel travel",
    )
    camber: AngleOverTravel = Field(
        default_factory=list, description="[rad] camber angle over wheel travel [m], positive if the top is outwards"
    )
    toe: AngleOverTravel = Field(
        default_factory=list, description="[rad] toe angle of a wheel over wheel travel [m], positive for toe-in"
    )
    roll_centre: HeightOverTravel = Field(
        default_factory=list, description="[m] height of the roll centre of the axle above the road, over travel [m]"
    )
    anti_brake: SlopeOverTravel = Field(
        default_factory=list,
        description="[1] part of the braking force of a wheel that its arms take as a vertical force, over travel [m]: "
        "positive reduces the dive of the front axle, and the lift of the rear axle",
    )
    anti_drive: SlopeOverTravel = Field(
        default_factory=list,
        description="[1] the same of forces that the brake does not cause, those of the motor among them: positive "
        "reduces the lift of the front axle, and the squat of the rear axle",
    )
    bump_stop: BumpStop | None = Field(default=None, description="null: only the end stops, the limits of the joints")

    @model_validator(mode="after")
    def _few_travels(self) -> "AxleSuspension":
        tables = (self.camber, self.toe, self.roll_centre, self.anti_brake, self.anti_drive)
        count = len({travel for table in tables for travel, _ in table})
        if count > MAX_TRAVELS:
            raise ValueError(
                f"the tables of an axle have {count} different travels, but at most {MAX_TRAVELS} are allowed; "
                "use the same travels in all tables"
            )
        return self


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
