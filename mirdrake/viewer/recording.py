"""A Meshcat recording of a run that opens offline: one HTML file, with the camera following the first vehicle.

The recording is made from the run's signals, not during the run: it costs the simulation nothing, and a run that was
killed can be watched too.
"""

from math import ceil
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.geometry import Meshcat, MeshcatVisualizer, MeshcatVisualizerParams
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.framework import DiagramBuilder

from mirdrake.diagram_spec import make_spec
from mirdrake.errors import RunError
from mirdrake.logs import Run, write_file
from mirdrake.plant import PlantSpec, make_plant
from mirdrake.vehicles import WHEELS, load_vehicle
from mirdrake.viewer.meshcat import make_meshcat, place_camera
from mirdrake.worlds import load_world


def write_recording(run: Run, *, frames_per_second: float = 20.0) -> Path:
    """Write recording.html into the folder of a run.

    Args:
        run: a run with a folder and with pose and joint signals.
        frames_per_second: of simulated time [Hz].

    Raises:
        RunError: the run has no folder or no samples.
    """
    if run.folder is None or run.signals.empty:
        raise RunError("recording: the run has no folder or no samples")
    meshcat = make_meshcat(world=load_world(run.spec["world"]))
    draw_run(run, meshcat, frames_per_second=frames_per_second)
    path = run.folder / "recording.html"
    write_file(path, meshcat.StaticHtml())
    return path


def draw_run(run: Run, meshcat: Meshcat, *, frames_per_second: float = 20.0) -> None:
    """Put a run into a Meshcat as an animation with play controls.

    Args:
        run: a run with pose and joint signals.
        meshcat: where to draw.
        frames_per_second: of simulated time [Hz].
    """
    spec = make_spec(run.spec)
    builder = DiagramBuilder()
    world = load_world(spec.world)
    vehicles = {name: load_vehicle(entry.model, arguments=entry.arguments) for name, entry in spec.vehicles.items()}
    parts = make_plant(builder, world, vehicles, spec=PlantSpec(contact="point"))
    params = MeshcatVisualizerParams(publish_period=1.0 / frames_per_second)
    visualizer = MeshcatVisualizer.AddToBuilder(builder, parts.scene_graph, meshcat, params)
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    plant_context = parts.plant.GetMyMutableContextFromRoot(context)

    times = run.signals.index.to_numpy()
    step = float(np.median(np.diff(times))) if times.size > 1 else 1.0
    stride = max(1, ceil(1.0 / (frames_per_second * step) - 1e-9))
    rows = range(0, times.size, stride)
    readers = [_Reader(run, part) for part in parts.vehicles.values()]

    first = readers[0]
    place_camera(meshcat, x=first.pose[0, 0], y=first.pose[0, 1], yaw=first.pose[0, 5])
    # Setting the camera moves it within /Cameras/default; animating that parent's position makes it follow.
    origin = first.pose[0, :3].copy()
    visualizer.StartRecording(set_transforms_while_recording=False)
    animation = visualizer.get_mutable_recording()
    for row in rows:
        context.SetTime(float(times[row] - times[0]))
        for reader in readers:
            reader.pose_at(plant_context, row)
        diagram.ForcedPublish(context)
        frame = animation.frame(context.get_time())
        shift = first.pose[row, :3] - origin
        animation.SetTransform(frame, "/Cameras/default", RigidTransform([shift[0], shift[1], 0.0]))
    visualizer.StopRecording()
    animation.set_autoplay(True)
    visualizer.PublishRecording()


class _Reader:
    """Samples of one vehicle as a pose of the plant."""

    def __init__(self, run: Run, part: Any) -> None:
        self._part = part
        name, signals = part.name, run.signals
        self.pose = signals[[f"{name}.{key}" for key in ("x", "y", "z", "roll", "pitch", "yaw")]].to_numpy()
        self._wheels = signals[[f"{name}.wheel_angle.{wheel}" for wheel in WHEELS]].to_numpy()
        self._steering = signals[[f"{name}.steering_angle.{side}" for side in ("left", "right")]].to_numpy()

    def pose_at(self, plant_context: Any, row: int) -> None:
        """Write one sample into the plant's context."""
        x, y, z, roll, pitch, yaw = self.pose[row]
        plant = self._part.base.GetParentPlant()
        X_WB = RigidTransform(RollPitchYaw(roll, pitch, yaw), [x, y, z])
        plant.SetFloatingBaseBodyPoseInWorldFrame(plant_context, self._part.base, X_WB)
        for joint, angle in zip(self._part.wheels, self._wheels[row], strict=True):
            joint.set_angle(plant_context, angle)
        for joint, angle in zip(self._part.steering, self._steering[row], strict=True):
            joint.set_angle(plant_context, angle)
