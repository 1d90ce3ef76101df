"""A user adds a kind of driver: one file, and one line that registers it."""

import pytest

from tests.new_kind import run_in_copy

KIND = '''\
"""Drive a sinusoidal steering angle at constant speed."""

import math
from typing import Literal

from pydantic import Field

from mirdrake.controllers.driver import Driver
from mirdrake.core.leaf_system import LeafSystem
from mirdrake.core.signals import declare_vector_output
from mirdrake.core.vectors import COMMAND
from mirdrake.core.yaml_io import Angle, Speed


class Weave(LeafSystem):
    def __init__(self, speed, amplitude, frequency):
        super().__init__()
        self.settings = speed, amplitude, 2.0 * math.pi * frequency
        declare_vector_output(self, "command", COMMAND, self._calc, prerequisites=[self.time_ticket()])

    def _calc(self, context, output):
        speed, amplitude, omega = self.settings
        time = context.get_time()
        output.SetFromVector([speed, amplitude * math.sin(omega * time), time])


class WeaveSpec(Driver):
    """Sinusoidal steering at constant speed."""

    kind: Literal["weave"] = Field(description="sinusoidal steering [-]")
    speed: Speed = Field(5.0, gt=0.0, description="set-point [m/s]")
    amplitude: Angle = Field(0.1, gt=0.0, description="amplitude of the bicycle angle [rad]")
    frequency: float = Field(0.5, gt=0.0, description="frequency [Hz]")

    def make_system(self, *_, **__):
        return Weave(self.speed, self.amplitude, self.frequency)
'''

CHECK = """\
from mirdrake.controllers.drivers import DRIVERS
from mirdrake.core.errors import ConfigError
from mirdrake.runs.simulation import simulate

data = {
    "world": "empty",
    "vehicles": {"ego": {"model": "bolt", "speed": 5.0}},
    "control": {"ego": {"kind": "weave", "amplitude": "6 deg"}},
    "plant": {"contact": "point"},
    "duration": 2.0,
}
assert "weave" in DRIVERS
run = simulate(data)
assert 0.10 < run["ego.steering_command"].max() < 0.105
assert run["ego.wz"].max() > 0.1 and run["ego.wz"].min() < -0.1
data["control"]["ego"]["amplitud"] = 0.1
try:
    simulate(data)
except ConfigError as error:
    assert "amplitud: unknown field; did you mean 'amplitude'" in str(error), error
else:
    raise AssertionError("a misspelt key is accepted")
"""


@pytest.mark.essential
def test_a_kind_of_driver_is_one_file_and_one_line(tmp_path):
    registry = "controllers/drivers.py"
    run_in_copy(
        tmp_path,
        new={"controllers/weave.py": KIND},
        lines=[(registry, "    TrafficDriverSpec,\n)", "    TrafficDriverSpec,\n    WeaveSpec,\n)")],
        imported=[(registry, "from mirdrake.controllers.weave import WeaveSpec")],
        check=CHECK,
    )
