"""A Meshcat recording of a run that opens offline: one HTML file, with the camera following the first vehicle.

The recording is made from the signals after the run, so that it does not slow the simulation down and also works for a
run that was killed.
"""

from math import ceil
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Meshcat, MeshcatAnimation, MeshcatVisualizer, MeshcatVisualizerParams
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.framework import DiagramBuilder

from mirdrake.core.errors import RunError
from mirdrake.core.files import write_file
from mirdrake.plant.actors import add_actors
from mirdrake.plant.plant import PlantSpec, make_plant
from mirdrake.plant.wheels.motion import REAR_WHEELS
from mirdrake.plant.wheels.wheel_looks import add_wheel_looks
from mirdrake.runs.logs import Run
from mirdrake.vehicles import WHEELS
from mirdrake.viewer.meshcat import LIGHTS_PATH, WORLD_PATH, cast_shadows, chase, offline_meshcat, place_camera
from mirdrake.viewer.pages import with_title
from mirdrake.viewer.player import Motion, with_player
from mirdrake.viewer.views import View, make_views, with_views

Array = NDArray[np.float64]

CAMERA_SWING = 1.6
"""Averaging time of the camera's heading [s]."""

_POSE = ("x", "y", "z", "roll", "pitch", "yaw")
_ENDLESS = 10**6  # repetitions of a recording
_GAUGE = 0.1  # [s] between the values of the play bar


def write_recording(run: Run, *, frames_per_second: float = 20.0) -> Path:
    """Write recording.html into the folder of a run.

    Args:
        run: a run with a folder and with pose and joint signals.
        frames_per_second: frames per second of simulated time [Hz].

    Raises:
        RunError: the run has no folder, no samples or no scene.
    """
    if run.folder is None or run.signals.empty:
        raise RunError("recording: the run has no folder or no samples")
    path = run.folder / "recording.html"
    write_file(path, recording_page(run, frames_per_second=frames_per_second))
    return path


def recording_page(run: Run, *, frames_per_second: float = 20.0) -> str:
    """Return the page of a recording, with a play bar and buttons for views.

    Args:
        run: a run with pose and joint signals.
        frames_per_second: frames per second of simulated time [Hz].

    Raises:
        RunError: the run has no scene.
    """
    with offline_meshcat(world=run.scene().world) as meshcat:
        draw_run(run, meshcat, frames_per_second=frames_per_second)
        page = with_title(meshcat.StaticHtml(), f"{run.summary.get('diagram', 'run')} · recording")
    return with_player(with_views(page, views_of(run)), _motion(run, next(iter(run.scene().vehicles))))


def views_of(run: Run) -> tuple[View, ...]:
    """Return the views of the vehicle of a run that the camera follows."""
    return make_views(next(iter(run.scene().vehicles.values())))


def _motion(run: Run, name: str) -> Motion:
    """Return speed and steering angle of a vehicle for the play bar."""
    times = run.signals.index.to_numpy()
    grid = np.arange(times[0], times[-1] + 1e-9, _GAUGE)
    left, right = (run.signals[f"{name}.steering_angle.{side}"].to_numpy() for side in ("left", "right"))
    steering = np.degrees(np.interp(grid, times, 0.5 * (left + right)))
    speed = np.interp(grid, times, run.signals[f"{name}.vx"].to_numpy())
    return Motion(
        start=float(times[0]), period=_GAUGE, speed=speed.round(2).tolist(), steering=steering.round(2).tolist()
    )


def draw_run(run: Run, meshcat: Meshcat, *, frames_per_second: float = 20.0) -> None:
    """Put a run into a Meshcat as an animation with play controls.

    Args:
        run: a run with pose and joint signals.
        meshcat: Meshcat instance in which to draw.
        frames_per_second: frames per second of simulated time [Hz].
    """
    builder, scene = DiagramBuilder(), run.scene()
    # Nothing is simulated here, so that hydroelastic shapes need not be prepared.
    parts = make_plant(builder, scene.world, scene.vehicles, spec=PlantSpec(contact="point"))
    actors = add_actors(parts.scene_graph, scene.world)
    looks = {name: add_wheel_looks(parts.plant, parts.scene_graph, part) for name, part in parts.vehicles.items()}
    params = MeshcatVisualizerParams(publish_period=1.0 / frames_per_second)
    visualizer = MeshcatVisualizer.AddToBuilder(builder, parts.scene_graph, meshcat, params)
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    plant_context = parts.plant.GetMyMutableContextFromRoot(context)

    times = run.signals.index.to_numpy()
    step = float(np.median(np.diff(times))) if times.size > 1 else 1.0
    # Whole samples only; the tolerance keeps a ratio such as 4.9999 from skipping a frame.
    stride = max(1, ceil(1.0 / (frames_per_second * step) - 1e-9))
    rows = range(0, times.size, stride)
    readers = [_Reader(run, part) for part in parts.vehicles.values()]
    loose = {
        body: run.signals[[f"props.{name}.{key}" for key in _POSE]].to_numpy()
        for name, body in parts.props.bodies.items()
    }

    names = [f"{name}.{key}" for name in actors.frames for key in ("x", "y", "yaw")]
    # A run that was killed early may have no samples of the actors yet.
    moves = run.actors[names].to_numpy().reshape(times.size, -1, 3) if names and not run.actors.empty else None
    scene_context = parts.scene_graph.GetMyMutableContextFromRoot(context)

    place_camera(meshcat, x=0.0, y=0.0, yaw=0.0)
    cast_shadows(meshcat, scene.world)
    # The camera follows the first vehicle.
    followed = readers[0].pose
    headings = smooth_headings(times, followed[:, 5])
    # Transforms go into the animation only; no browser follows while it is made.
    visualizer.StartRecording(set_transforms_while_recording=False)
    animation = visualizer.get_mutable_recording()
    for row in rows:
        # Animations begin at 0, also if the samples do not.
        context.SetTime(float(times[row] - times[0]))
        for reader in readers:
            reader.pose_at(plant_context, row)
        for reader in readers:
            wheels = looks[reader.name]
            if wheels is not None:
                drawn = wheels.poses(parts.plant.GetPositions(plant_context), reader.rear[row])
                parts.scene_graph.get_source_pose_port(wheels.source).FixValue(scene_context, drawn)
        for body, poses in loose.items():
            X_WP = RigidTransform(RollPitchYaw(poses[row, 3:]), poses[row, :3])
            parts.plant.SetFloatingBaseBodyPoseInWorldFrame(plant_context, body, X_WP)
        if moves is not None and actors.source is not None:
            port = parts.scene_graph.get_source_pose_port(actors.source)
            port.FixValue(scene_context, actors.poses(moves[row]))
        diagram.ForcedPublish(context)
        frame = animation.frame(context.get_time())
        X_CW, X_CL = chase(x=followed[row, 0], y=followed[row, 1], yaw=headings[row])
        animation.SetTransform(frame, WORLD_PATH, X_CW)
        animation.SetTransform(frame, LIGHTS_PATH, X_CL)
    visualizer.StopRecording()
    animation.set_autoplay(True)
    animation.set_loop_mode(MeshcatAnimation.LoopMode.kLoopRepeat)
    animation.set_repetitions(_ENDLESS)
    visualizer.PublishRecording()


def smooth_headings(times: Array, yaw: Array) -> Array:
    """Return the heading of the following camera: the moving average over :data:`CAMERA_SWING`.

    Args:
        times: [s] (n), equally spaced.
        yaw: [rad] (n), within ±π or not.

    Returns:
        heading [rad] (n), without jumps.
    """
    # Unwrapped first: the mean of 179 and -179 deg is not 0.
    heading = np.unwrap(yaw)
    if times.size < 3:
        return heading
    half = min(round(0.5 * CAMERA_SWING / float(np.median(np.diff(times)))), times.size - 1)
    # Ends are repeated, so that the average has as many values as samples.
    padded = np.concatenate([np.full(half, heading[0]), heading, np.full(half, heading[-1])])
    # Moving average by differences of the cumulative sum, in linear time.
    total = np.cumsum(np.concatenate([[0.0], padded]))
    mean: Array = (total[2 * half + 1 :] - total[: -2 * half - 1]) / (2 * half + 1)
    return mean


class _Reader:
    """Samples of one vehicle as a pose of the plant."""

    def __init__(self, run: Run, part: Any) -> None:
        self._part = part
        name, signals = part.name, run.signals
        self.pose = signals[[f"{name}.{key}" for key in _POSE]].to_numpy()
        self._wheels = signals[[f"{name}.wheel_angle.{wheel}" for wheel in WHEELS]].to_numpy()
        self._steering = signals[[f"{name}.steering_angle.{side}" for side in ("left", "right")]].to_numpy()
        rear = [f"{name}.steering_angle.{wheel}" for wheel in REAR_WHEELS]
        self.name = name
        self.rear = signals[rear].to_numpy() if rear[0] in signals else np.zeros((len(signals), len(rear)))
        self._springs = [joint for joint in part.suspension if f"{name}.travel.{WHEELS[0]}" in signals]
        self._travel = signals[[f"{name}.travel.{wheel}" for wheel in WHEELS if self._springs]].to_numpy()

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
        for joint, travel in zip(self._springs, self._travel[row], strict=True):
            joint.set_translation(plant_context, travel)
