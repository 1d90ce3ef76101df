"""A user adds a kind of joint control: one file, and one line that registers it."""

import pytest

from tests.new_kind import run_in_copy

KIND = '''\
"""Steering torque from a saturated error: full torque outside of a boundary layer."""

from typing import ClassVar, Literal, NamedTuple

from pydantic import Field

from mirdrake.vehicles.joint_control.base import JointControl


class SlidingNumbers(NamedTuple):
    width: float
    damping: float
    torque: float


def sliding_torque(memory, start, setpoint, measurement, feedforward, numbers, period, limits):
    rate = (measurement - memory[start]) / period if memory[start + 1] > 0.0 else 0.0
    memory[start], memory[start + 1] = measurement, 1.0
    share = (setpoint - measurement) / numbers.width
    torque = numbers.torque * min(max(share, -1.0), 1.0) - numbers.damping * rate
    return feedforward + min(max(torque, limits.minimum), limits.maximum)


class SlidingControl(JointControl):
    gains: ClassVar[dict[str, str]] = {"width": "rad", "damping": "N m s/rad"}
    memory: ClassVar[tuple[float, ...]] = (0.0, 0.0)
    number_type: ClassVar[type] = SlidingNumbers

    kind: Literal["sliding"]
    width: float = Field(gt=0, description="[rad] width of the boundary layer")
    damping: float = Field(default=0.0, ge=0, description="[N m s/rad]")
    torque: float = Field(gt=0, description="[N m] outside of the boundary layer")

    def torque_law(self):
        return sliding_torque

    def numbers(self, gains):
        return SlidingNumbers(*gains, self.torque)
'''

CHECK = """\
from mirdrake.assembly.diagram import assemble
from mirdrake.core.errors import ConfigError
from mirdrake.execution.parameters import find_context_parameters
from mirdrake.runs.simulation import Simulation
from mirdrake.single_track import estimate_parameters
from mirdrake.vehicles.joint_control import JOINT_CONTROLS

def spec(machine_code, **control):
    steering = {"kind": "sliding", "width": 0.1, "damping": 100.0, "torque": 800.0, **control}
    return {
        "world": "empty",
        "vehicles": {"ego": {"model": "bolt", "speed": 5.0, "control": {"rate": 200, "steering": steering}}},
        "control": {"ego": {"kind": "constant", "speed": 5.0, "steering": 0.1}},
        "plant": {"contact": "point", "machine_code": machine_code},
    }

# It steers: the yaw rate is about v tan(delta) / L; without slip of the tyres it would be 0.193 rad/s.
assert set(JOINT_CONTROLS["steering"]) == {"servo", "pid", "external", "sliding"}
run = Simulation(assemble(spec(False))).run(duration=1.5).signals
assert 0.17 < run["ego.wz"].iloc[-1] < 0.23, run["ego.wz"].iloc[-1]

# Its gains can be changed at run time, and its reduced model has the default lag.
assembly = assemble(spec(False))
vehicle = assembly.parts.vehicles["ego"].vehicle
parameters = find_context_parameters({"ego": vehicle}, assembly.parts.world)
assert {"ego.steering.width", "ego.steering.damping"} <= set(parameters)
assert estimate_parameters(vehicle).steering_lag == 0.02

# Its keys are checked like those of every kind.
try:
    assemble(spec(False, width=-1.0))
except ConfigError as error:
    assert "steering.width: -1.0 is not allowed" in str(error), error
else:
    raise AssertionError("a negative width is accepted")
"""

COMPILED = (
    CHECK.split("# It steers")[0]
    + """\
runs = [Simulation(assemble(spec(code))).run(duration=1.0).signals for code in (False, True)]
assert runs[0].equals(runs[1])
"""
)


def run(folder, check):
    registry = "vehicles/joint_control/__init__.py"
    run_in_copy(
        folder,
        new={"vehicles/joint_control/sliding.py": KIND},
        lines=[(registry, "    | SteeringPid\n", "    | SteeringPid\n    | SlidingControl\n")],
        imported=[(registry, "from mirdrake.vehicles.joint_control.sliding import SlidingControl")],
        check=check,
    )


@pytest.mark.essential
def test_a_kind_of_joint_control_is_one_file_and_one_line(tmp_path):
    run(tmp_path, CHECK)


@pytest.mark.slow  # Numba compiles the step with the new law
def test_machine_code_gives_the_same_signals_with_the_new_law(tmp_path):
    run(tmp_path, COMPILED)
