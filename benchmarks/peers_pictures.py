"""Job W2 beside MuJoCo and PyBullet: colours and depths of the same obstacles, of the same size, without shadows."""

import importlib.util
import os
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack, closing
from functools import partial
from math import atan, degrees, tan
from multiprocessing import get_context
from statistics import median
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.timing import Times, installed, timed
from benchmarks.w2 import EYE, FAR, FIELD, HEIGHT, NEAR, RATE, SPEED, WIDTH, Scene

Pictures = Iterator[tuple[NDArray[np.uint8], NDArray[np.float32]]]
"""Colours (height, width, 3) and depths [m] (height, width), a frame each."""

VERTICAL = 2.0 * atan(tan(0.5 * FIELD) * HEIGHT / WIDTH)
"""Vertical field of view [rad]."""


def obstacles() -> list[dict[str, Any]]:
    """Return the obstacles of ``obstacles_36``: sides, or radius and height [m]; centre [m], heading, colour."""
    from pydrake.geometry import Box
    from pydrake.math import RollPitchYaw

    from mirdrake.worlds import load_world

    shapes = []
    for placed in load_world("obstacles_36").props:
        (solid,) = placed.prop.solids
        X_WS, shape = placed.X_WP @ solid.X_PS, solid.shape
        size = shape.size().tolist() if isinstance(shape, Box) else [shape.radius(), shape.length()]
        yaw = float(RollPitchYaw(X_WS.rotation()).yaw_angle())
        color = list(placed.color or (0.5, 0.5, 0.5))
        shapes.append({"size": size, "at": X_WS.translation().tolist(), "yaw": yaw, "color": color})
    return shapes


def run_in_turn(*, duration: float, repeat: int) -> dict[str, Any]:
    """Return the time of a frame here and of every peer that is installed and can draw, each in a process of its own.

    They draw in turn, so that a machine that is slow for a while is slow for all of them.

    Args:
        duration: simulated time [s].
        repeat: how often; medians are given.

    Returns:
        ``color_and_depth`` and ``depth``, ours, and ``peers``; for each peer the median of ours over its time of the
        same turn, too (``ours_over_it``).
    """
    shapes = obstacles()
    drawing: dict[str, Callable[[], Drawn]] = {
        "color_and_depth": partial(_draw_ours, duration),
        "depth": partial(_draw_ours, duration, color=False),
    }
    if installed("mujoco"):
        drawing["mujoco"] = partial(_draw, mujoco_pictures, duration, shapes)
    if installed("pybullet") and importlib.util.find_spec("eglRenderer") is not None:
        drawing["pybullet"] = partial(_draw, bullet_pictures, duration, shapes)
    turns: dict[str, list[Drawn]] = {name: [] for name in drawing}
    with ExitStack() as stack:
        pools = {name: stack.enter_context(ProcessPoolExecutor(1, mp_context=get_context("spawn"))) for name in drawing}
        for _ in range(repeat):
            for name, draw in drawing.items():
                turns[name].append(pools[name].submit(draw).result())
    results = {name: _figures(drawn) for name, drawn in turns.items()}
    for name in results.keys() - {"color_and_depth", "depth"}:
        pairs = zip(turns["color_and_depth"], turns[name], strict=True)
        results[name]["ours_over_it"] = median(
            (ours.times.wall / ours.frames) / (theirs.times.wall / theirs.frames) for ours, theirs in pairs
        )
    ours = {name: results.pop(name) for name in ("color_and_depth", "depth")}
    for figures in ours.values():
        figures["missing"] = round(duration * RATE) + 1 - figures["frames"]
    return ours | {"peers": results}


class Drawn(NamedTuple):
    """Time of drawing, number of frames, and the nearest depth of the last one [m]."""

    times: Times
    frames: int
    nearest: float


def _figures(drawn: list[Drawn]) -> dict[str, Any]:
    return {
        "ms_per_frame": 1e3 * median(turn.times.wall / turn.frames for turn in drawn),
        "cpu_ms_per_frame": 1e3 * median(turn.times.cpu / turn.frames for turn in drawn),
        "frames": drawn[-1].frames,
        "nearest_m": drawn[-1].nearest,
    }


_scenes: dict[bool, Scene] = {}


def _draw_ours(duration: float, *, color: bool = True) -> Drawn:
    if color not in _scenes:
        _scenes[color] = Scene(color=color)
        _scenes[color].run(2.0 / RATE)  # compiles the shaders
    taken: list[dict[str, Any]] = []
    times = timed(lambda: taken.extend(_scenes[color].run(duration)))
    depth = taken[-1]["depth"]
    return Drawn(times, len(taken), float(depth[np.isfinite(depth)].min()))


def _draw(
    make: Callable[[float, list[dict[str, Any]]], Pictures], duration: float, shapes: list[dict[str, Any]]
) -> Drawn:
    pictures = make(duration + 1.0 / RATE, shapes)
    for _ in range(2):  # contexts are made and shaders compiled
        next(pictures)
    taken: list[Any] = []
    times = timed(lambda: taken.extend(pictures))
    return Drawn(times, len(taken), float(taken[-1][1].min()))


def mujoco_pictures(duration: float, shapes: list[dict[str, Any]]) -> Pictures:
    """MuJoCo's pictures; its own settings but for shadows, which are off."""
    os.environ["MUJOCO_GL"] = "egl"
    import mujoco

    geoms = "".join(map(_mujoco_geom, shapes))
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco>
          <option timestep="{1.0 / 300.0}"/>
          <statistic extent="1"/>
          <visual>
            <map znear="{NEAR}" zfar="{FAR}"/>
            <quality shadowsize="0"/>
            <global offwidth="{WIDTH}" offheight="{HEIGHT}"/>
          </visual>
          <asset>
            <texture name="asphalt" type="2d" builtin="flat" mark="random" random="0.3" rgb1="0.3 0.3 0.3"
                     markrgb="0.4 0.4 0.4" width="512" height="512"/>
            <material name="asphalt" texture="asphalt" texrepeat="1 1" texuniform="true"/>
          </asset>
          <worldbody>
            <light directional="true" dir="-0.3 0.3 -1" castshadow="false"/>
            <geom type="plane" size="200 200 1" material="asphalt"/>
            {geoms}
            <body pos="0 0 {EYE}">
              <joint type="slide" axis="1 0 0"/>
              <inertial pos="0 0 0" mass="1" diaginertia="0.1 0.1 0.1"/>
              <camera name="eye" xyaxes="0 -1 0 0 0 1" fovy="{degrees(VERTICAL)}"/>
            </body>
          </worldbody>
        </mujoco>"""
    )
    data = mujoco.MjData(model)
    data.qvel[0] = SPEED
    with closing(mujoco.Renderer(model, HEIGHT, WIDTH)) as renderer:
        for frame in range(round(duration * RATE) + 1):
            while data.time < frame / RATE - 1e-9:
                mujoco.mj_step(model, data)
            renderer.update_scene(data, camera="eye")
            colors = renderer.render()
            renderer.enable_depth_rendering()
            depths = renderer.render()
            renderer.disable_depth_rendering()
            yield colors, depths


def _mujoco_geom(obstacle: dict[str, Any]) -> str:
    words = {key: " ".join(map(str, obstacle[key])) for key in ("at", "color")}
    turn = f"{np.cos(0.5 * obstacle['yaw'])} 0 0 {np.sin(0.5 * obstacle['yaw'])}"
    about = f'pos="{words["at"]}" quat="{turn}" rgba="{words["color"]} 1"'
    if len(obstacle["size"]) == 3:
        return f'<geom type="box" size="{" ".join(str(0.5 * side) for side in obstacle["size"])}" {about}/>'
    return f'<geom type="cylinder" size="{obstacle["size"][0]} {0.5 * obstacle["size"][1]}" {about}/>'


def bullet_pictures(duration: float, shapes: list[dict[str, Any]]) -> Pictures:
    """PyBullet's pictures, by its plugin eglRenderer; colours and depths are of one call."""
    import pybullet
    from pybullet_utils.bullet_client import BulletClient

    client = BulletClient(pybullet.DIRECT)
    try:
        plugin = importlib.util.find_spec("eglRenderer")
        assert plugin is not None
        client.loadPlugin(plugin.origin, "_eglRendererPlugin")
        client.setTimeStep(1.0 / 300.0)
        ground = client.createVisualShape(pybullet.GEOM_BOX, halfExtents=[200, 200, 0.5], rgbaColor=[0.3, 0.3, 0.3, 1])
        client.createMultiBody(0.0, baseVisualShapeIndex=ground, basePosition=[0.0, 0.0, -0.5])
        for obstacle in shapes:
            sizes: dict[str, Any] = {"shapeType": pybullet.GEOM_BOX}
            if len(obstacle["size"]) == 3:
                sizes["halfExtents"] = [0.5 * side for side in obstacle["size"]]
            else:
                sizes = {
                    "shapeType": pybullet.GEOM_CYLINDER,
                    "radius": obstacle["size"][0],
                    "length": obstacle["size"][1],
                }
            look = client.createVisualShape(**sizes, rgbaColor=[*obstacle["color"], 1.0])
            turn = client.getQuaternionFromEuler([0.0, 0.0, obstacle["yaw"]])
            client.createMultiBody(0.0, -1, look, basePosition=obstacle["at"], baseOrientation=turn)
        lens = client.computeProjectionMatrixFOV(degrees(VERTICAL), WIDTH / HEIGHT, NEAR, FAR)
        for frame in range(round(duration * RATE) + 1):
            for _ in range(10 if frame else 0):
                client.stepSimulation()
            x = SPEED * frame / RATE
            view = client.computeViewMatrix([x, 0.0, EYE], [x + 1.0, 0.0, EYE], [0.0, 0.0, 1.0])
            _, _, colors, depths, _ = client.getCameraImage(
                WIDTH, HEIGHT, view, lens, shadow=0, renderer=pybullet.ER_BULLET_HARDWARE_OPENGL,
                flags=pybullet.ER_NO_SEGMENTATION_MASK,
            )  # fmt: skip
            buffer = np.asarray(depths, dtype=np.float32).reshape(HEIGHT, WIDTH)
            pixels = np.asarray(colors, dtype=np.uint8).reshape(HEIGHT, WIDTH, 4)[:, :, :3]
            yield pixels, NEAR * FAR / (FAR - (FAR - NEAR) * buffer)
    finally:
        client.disconnect()
