"""A Meshcat that listens on this machine only, with the sky, the sun and the camera where a driver expects them."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from math import cos, pi, sin

from pydrake.geometry import Meshcat, MeshcatParams
from pydrake.math import RigidTransform, RollPitchYaw

from mirdrake.errors import RunError
from mirdrake.worlds import World
from mirdrake.worlds.scenery import set_sky

WORLD_PATH, LIGHTS_PATH = "/drake", "/Lights"
"""Where Drake puts the world, and the lights, in Meshcat's scene tree."""


def make_meshcat(*, port: int | None = None, world: World | None = None) -> Meshcat:
    """A Meshcat on localhost.

    Args:
        port: None takes the first free one from 7000 on, 0 any free one; otherwise a free port from 1024 on.
        world: gives sky and sun, if there is one.

    Raises:
        RunError: the port is taken.
    """
    try:
        with _quietly():
            meshcat = Meshcat(MeshcatParams(host="localhost", port=port, show_stats_plot=False))
    except RuntimeError as error:
        wanted = "any port" if port is None else f"port {port}"
        reason = str(error).strip().splitlines()[0]
        raise RunError(f"Meshcat cannot listen on {wanted} of localhost: {reason}; choose another port") from None
    meshcat.SetProperty("/Grid", "visible", False)
    meshcat.SetProperty("/Axes", "visible", False)
    if world is not None:
        set_sky(meshcat, world)
    return meshcat


def place_camera(meshcat: Meshcat, *, x: float, y: float, yaw: float, distance: float = 6.0) -> None:
    """Look at a vehicle from behind its left shoulder.

    Args:
        meshcat: where.
        x: position of the vehicle [m].
        y: the same, to the left [m].
        yaw: heading of the vehicle [rad].
        distance: from the vehicle [m].
    """
    angle = yaw + pi - 0.6
    target = [x + 1.3 * cos(yaw), y + 1.3 * sin(yaw), 0.6]
    eye = [target[0] + distance * cos(angle), target[1] + distance * sin(angle), 0.4 * distance]
    meshcat.SetCameraPose(eye, target)


def overlook(meshcat: Meshcat, world: World) -> None:
    """Look at all of a world from above its south side."""
    left, south, right, north = world.ground.extent
    size = max(right - left, north - south)
    x, y = 0.5 * (left + right), 0.5 * (south + north)
    meshcat.SetCameraPose([x, y - 0.3 * size, 0.32 * size], [x, y, 0.0])


def chase(*, x: float, y: float, yaw: float) -> tuple[RigidTransform, RigidTransform]:
    """Where world and lights have to be for a camera at rest to follow a vehicle.

    Meshcat's camera looks at a fixed point, whatever happens to the scene tree above it. So the world is moved under
    the camera, until the vehicle is at the origin and heads along x; the mouse can still turn the view around it.

    Args:
        x: position of the vehicle [m].
        y: the same, to the left [m].
        yaw: heading to follow [rad].

    Returns:
        transforms of :data:`WORLD_PATH` and :data:`LIGHTS_PATH`.
    """
    X_WC = RigidTransform(RollPitchYaw(0.0, 0.0, yaw), [x, y, 0.0])
    X_CW = X_WC.inverse()
    return X_CW, RigidTransform(X_CW.rotation(), [0.0, 0.0, 0.0])


@contextmanager
def _quietly() -> Iterator[None]:
    """Keep Drake from telling its log where Meshcat listens; callers say it where it is of use."""
    log = logging.getLogger("drake")
    level = log.level
    log.setLevel(max(level, logging.WARNING))
    try:
        yield
    finally:
        log.setLevel(level)
