"""Base of the behaviours: their numbers for the compiled functions."""

from abc import abstractmethod
from typing import ClassVar, Final

from pydantic import Field

from mirdrake.core.yaml_io import Acceleration
from mirdrake.worlds.actors_spec import ActorBehaviour

NUMBERS: Final = 12
"""Most numbers of a behaviour."""

LIMIT: Final = 0
"""Number of every behaviour: largest deceleration [m/s²]."""


class LaneBehaviour(ActorBehaviour):
    """A behaviour of actors that follow a lane or a path.

    Attributes:
        law: number of its law in :mod:`mirdrake.actors.laws`.
    """

    law: ClassVar[int]

    braking_limit: Acceleration = Field(default=8.0, gt=0.0, le=20.0, description="largest deceleration [m/s²]")

    @abstractmethod
    def numbers(self) -> tuple[float, ...]:
        """Return its parameters in the order of its law, after the largest deceleration."""
