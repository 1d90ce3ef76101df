"""A Meshcat that listens on this machine only, with the sky, the sun and the camera where a driver expects them."""

from math import cos, sin

import numpy as np
from pydrake.geometry import Meshcat, MeshcatParams

from mirdrake.worlds import World

SKY_TOP, SKY_BOTTOM = [0.35, 0.56, 0.84], [0.83, 0.90, 0.96]


def make_meshcat(*, port: int = 0, world: World | None = None) -> Meshcat:
    """A Meshcat on localhost.

    Args:
        port: 0 lets Drake choose; otherwise a free port.
        world: gives sky and sun, if there is one.
    """
    params = MeshcatParams(host="localhost", port=port or None, show_stats_plot=False)
    meshcat = Meshcat(params)
    meshcat.SetProperty("/Background", "top_color", SKY_TOP)
    meshcat.SetProperty("/Background", "bottom_color", SKY_BOTTOM)
    meshcat.SetProperty("/Grid", "visible", False)
    meshcat.SetProperty("/Axes", "visible", False)
    if world is not None and world.spec.lights.sun is not None:
        sun = world.spec.lights.sun
        direction = [cos(sun.elevation) * cos(sun.azimuth), cos(sun.elevation) * sin(sun.azimuth), sin(sun.elevation)]
        meshcat.SetProperty("/Lights/DirectionalLight/<object>", "position", [60.0 * value for value in direction])
    return meshcat


def place_camera(meshcat: Meshcat, *, x: float, y: float, yaw: float, distance: float = 9.0) -> None:
    """Look at a vehicle from behind its left shoulder.

    Args:
        meshcat: where.
        x: position of the vehicle [m].
        y: the same, to the left [m].
        yaw: heading of the vehicle [rad].
        distance: from the vehicle [m].
    """
    angle = yaw + np.pi - 0.6
    eye = [x + distance * cos(angle), y + distance * sin(angle), 0.45 * distance]
    target = [x + 1.3 * cos(yaw), y + 1.3 * sin(yaw), 0.6]
    meshcat.SetCameraPose(eye, target)
