"""Straight on without regard to obstacles: a bad driver, to check that a test notices one."""

from typing import Any, Literal

from pydantic import Field

from mirdrake.controllers.driver import DecisionPeriod, Driver
from mirdrake.controllers.schedule import ConstantCommand
from mirdrake.core.yaml_io import Speed


class BlindSpec(Driver):
    """Straight on, without regard to obstacles; verifies that a test fails for a bad driver."""

    kind: Literal["blind"] = Field(description="straight on without looking: a bad driver to test tests with [-]")
    speed: Speed = Field(5.0, ge=0.0, le=100.0, description="set-point of the speed [m/s]")
    period: DecisionPeriod = 0.05

    def make_system(self, *_: Any, **__: Any) -> ConstantCommand:
        """Return the driver as a system with the output ``command``."""
        return ConstantCommand(self.speed, period=self.period)
