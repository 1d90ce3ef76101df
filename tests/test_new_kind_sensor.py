"""A user adds a kind of sensor: a file with its system and its mount, and a line that registers it."""

import pytest

from tests.new_kind import run_in_copy

TACHOGRAPH = '''\
"""Tachograph: distance travelled in whole steps."""

from typing import Literal

import numpy as np
from pydantic import Field
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform

from mirdrake.core.signals import signals
from mirdrake.sensors.mount import SensorMount
from mirdrake.sensors.sampling import SampledSensor, mount_pose


class Tachograph(SampledSensor):
    def __init__(self, frame, mount, stream):
        super().__init__(signals(("distance", "m")), mount, stream=stream, initial=[0.0])
        self.step, self.body = mount.step, int(mount_pose(frame)[0].index())
        self.body_poses = self.DeclareAbstractInputPort("body_poses", AbstractValue.Make([RigidTransform()]))
        self.declare_first_sample()

    def measure(self, context):
        x, y, _ = self.body_poses.Eval(context)[self.body].translation()
        return np.array([self.step * np.floor(np.hypot(x, y) / self.step)])


class TachographMount(SensorMount):
    """Distance travelled."""

    kind: Literal["tachograph"]
    step: float = Field(default=0.1, gt=0, description="[m] step of the reading")

    def make(self, *, parts, part, stream):
        return Tachograph(parts.plant.GetFrameByName(self.frame, part.instance), self, stream)
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


@pytest.mark.essential
def test_a_kind_of_sensor_is_a_file_and_a_line(tmp_path):
    line = '    "stereo_camera": "mirdrake'
    run_in_copy(
        tmp_path,
        new={"sensors/tachograph.py": TACHOGRAPH},
        lines=[
            ("vehicles/mounts.py", line, f'    "tachograph": "mirdrake.sensors.tachograph:TachographMount",\n{line}'),
        ],
        check=CHECK,
    )
