"""A user adds a kind of sensor: a file with its mount, a file with its system, and a line that registers each."""

from tests.new_kind import run_in_copy

MOUNT = '''\
"""Mount of a tachograph."""

from typing import Literal

from pydantic import Field

from mirdrake.vehicles.mount import Mount


class TachographMount(Mount):
    """Distance travelled."""

    kind: Literal["tachograph"]
    step: float = Field(default=0.1, gt=0, description="[m] step of the reading")
'''

SYSTEM = '''\
"""Tachograph: distance travelled in whole steps."""

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform

from mirdrake.core.signals import signals
from mirdrake.sensors.sampling import SampledSensor, mount_pose


class Tachograph(SampledSensor):
    def __init__(self, frame, mount, stream):
        super().__init__(signals(("distance", "m")), rate=mount.rate, noise=[0.0], stream=stream, initial=[0.0])
        self.step, self.body = mount.step, int(mount_pose(frame)[0].index())
        self.body_poses = self.DeclareAbstractInputPort("body_poses", AbstractValue.Make([RigidTransform()]))
        self.declare_first_sample()

    def measure(self, context):
        x, y, _ = self.body_poses.Eval(context)[self.body].translation()
        return np.array([self.step * np.floor(np.hypot(x, y) / self.step)])


def make_tachograph(mount, *, parts, part, stream):
    return Tachograph(parts.plant.GetFrameByName(mount.frame, part.instance), mount, stream)
'''

CHECK = """\
from mirdrake.assembly.diagram import assemble
from mirdrake.runs.simulation import Simulation
from mirdrake.vehicles.mounts import SensorsSpec

spec = SensorsSpec(mounts={"tacho": {"kind": "tachograph", "frame": "base_link", "rate": 20, "step": 0.5}})
import mirdrake.assembly.scene as scene
original = scene.load_vehicle
from dataclasses import replace
scene.load_vehicle = lambda *args, **kw: replace(original(*args, **kw), sensors=spec)
data = {
    "world": "empty",
    "vehicles": {"ego": {"model": "bolt", "speed": 5.0, "start": {"x": 0.0}}},
    "control": {"ego": {"kind": "constant", "speed": 5.0}},
    "sensors": {"ego": ["tacho"]},
    "plant": {"contact": "point"},
}
run = Simulation(assemble(data)).run(duration=2.0).signals
values = run[next(name for name in run.columns if name.startswith("ego.tacho"))]
assert abs(values.iloc[-1] - 9.5) <= 0.5, values.iloc[-1]
assert set((values / 0.5).round(9) % 1.0) == {0.0}
"""


def test_a_kind_of_sensor_is_a_mount_and_a_system_with_a_line_each(tmp_path):
    mounts, sensors = "vehicles/mounts.py", "sensors/__init__.py"
    run_in_copy(
        tmp_path,
        new={"vehicles/tachograph_mount.py": MOUNT, "sensors/tachograph.py": SYSTEM},
        lines=[
            (mounts, "    | SteeringAngleMount\n", "    | SteeringAngleMount\n    | TachographMount\n"),
            (sensors, '    "stereo_camera": make', '    "tachograph": make_tachograph,\n    "stereo_camera": make'),
        ],
        imported=[
            (mounts, "from mirdrake.vehicles.tachograph_mount import TachographMount"),
            (sensors, "from mirdrake.sensors.tachograph import make_tachograph"),
        ],
        check=CHECK,
    )
