"""Meshcat on this machine only, with sky, sun and cameras for vehicles."""

import math
import weakref
from collections.abc import Iterator
from contextlib import contextmanager
from math import cos, exp, pi, sin

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Meshcat
from pydrake.math import RigidTransform, RollPitchYaw

from mirdrake.core.drake_errors import is_meshcat_crash
from mirdrake.core.errors import RunError
from mirdrake.viewer.private_meshcat import Upstream, make_private_meshcat, release
from mirdrake.viewer.server import PageServer
from mirdrake.worlds import World
from mirdrake.worlds.scenery import set_sky

Array = NDArray[np.float64]

WORLD_PATH, LIGHTS_PATH = "/drake", "/Lights"
"""Paths of the world and the lights in Meshcat's scene tree."""

SHADOWS = 16.0
"""Half the side of the square around the followed vehicle in which shadows are drawn [m]."""

_ELEVATION, _ASPECT = math.radians(48.0), 1.5  # of the camera above a world, and of the window
_FIELD_OF_VIEW = math.radians(75.0)  # of Meshcat, vertical


def make_meshcat(
    *, port: int | None = None, world: World | None = None, title: str = "mirdrake", controls: bool = False
) -> Meshcat:
    """Return a Meshcat with a page on localhost; its ``web_url()`` is the address of the page, with a token.

    Meshcat itself has no port: see :mod:`mirdrake.viewer.server`. The page is served until the process
    ends.

    Args:
        port: None takes the first free one from 7000 on, 0 any free one; otherwise a free port from 1024 on.
        world: defines sky and sun, if given.
        title: of the page.
        controls: whether Meshcat's controls are open at the start.

    Raises:
        RunError: the port is taken.
    """
    server = PageServer("Meshcat", ports=range(7000, 8000) if port is None else [port], title=title, controls=controls)
    try:
        meshcat, upstream = make_private_meshcat(url=server.url)
    except RunError:
        server.stop_listening()
        raise
    # The server was made first, because its address is the one that Meshcat reports.
    server.upstream = upstream
    server.start()
    # Meshcat may be released without an explicit close.
    weakref.finalize(meshcat, server.close)
    _set_up(meshcat, world)
    return meshcat


def make_offline_meshcat(*, world: World | None = None) -> Meshcat:
    """Return a Meshcat without a page, for ``StaticHtml()``.

    Args:
        world: defines sky and sun, if given.

    Raises:
        RunError: Meshcat is disabled.
    """
    meshcat, upstream = make_private_meshcat()
    upstream.close()
    _set_up(meshcat, world)
    return meshcat


@contextmanager
def offline_meshcat(*, world: World | None = None) -> Iterator[Meshcat]:
    """Yield a Meshcat without a page, for ``StaticHtml()``; it is freed at the end.

    Args:
        world: defines sky and sun, if given.

    Raises:
        RunError: Meshcat is disabled.
    """
    meshcat = make_offline_meshcat(world=world)
    yield meshcat
    release(meshcat)  # not after an error, whose traceback may keep a diagram that draws in it


def make_meshcat_behind(*, world: World) -> tuple[Meshcat, Upstream]:
    """Return a Meshcat without a page, and the connection to it for a server with another page.

    Args:
        world: defines sky and sun.

    Raises:
        RunError: Meshcat is disabled.
    """
    meshcat, upstream = make_private_meshcat()
    weakref.finalize(meshcat, upstream.close)
    _set_up(meshcat, world)
    return meshcat, upstream


def _set_up(meshcat: Meshcat, world: World | None) -> None:
    """Remove grid and axes, and set the sky."""
    meshcat.SetProperty("/Grid", "visible", False)
    meshcat.SetProperty("/Axes", "visible", False)
    if world is not None:
        set_sky(meshcat, world)


@contextmanager
def meshcat_faults() -> Iterator[None]:
    """Raise the end of Meshcat's thread as a :class:`RunError`; Drake raises a RuntimeError.

    Raises:
        RunError: Meshcat has ended.
    """
    try:
        yield
    except RuntimeError as error:
        # Other errors of Drake are faults of the program and must not be hidden.
        if not is_meshcat_crash(str(error)):
            raise
        raise RunError("Meshcat has ended unexpectedly, and the page with it") from None


def place_camera(meshcat: Meshcat, *, x: float, y: float, yaw: float) -> None:
    """Place the camera 6 m behind a vehicle, to its left.

    Args:
        meshcat: Meshcat with the vehicle.
        x: position of the vehicle [m].
        y: position of the vehicle [m].
        yaw: heading of the vehicle [rad].
    """
    distance = 6.0
    angle = yaw + pi - 0.6
    target = [x + 1.3 * cos(yaw), y + 1.3 * sin(yaw), 0.6]
    eye = [target[0] + distance * cos(angle), target[1] + distance * sin(angle), 0.4 * distance]
    meshcat.SetCameraPose(eye, target)


def cast_shadows(meshcat: Meshcat, world: World) -> None:
    """Let the sun cast shadows within :data:`SHADOWS` of the point that the camera follows.

    Args:
        meshcat: shows the world.
        world: has the intensity of the sun.
    """
    sun = f"{LIGHTS_PATH}/FillLight/<object>"
    # More light of the sun and less of the sky, or the shadows would be pale.
    meshcat.SetProperty(f"{LIGHTS_PATH}/AmbientLight/<object>", "intensity", 0.2)
    meshcat.SetProperty(sun, "intensity", 2.6 * world.spec.lights.sun.intensity)
    for side, sign in (("left", -1.0), ("right", 1.0), ("bottom", -1.0), ("top", 1.0)):
        meshcat.SetProperty(sun, f"shadow.camera.{side}", sign * SHADOWS)
    meshcat.SetProperty(sun, "shadow.mapSize.width", 2048.0)
    meshcat.SetProperty(sun, "shadow.mapSize.height", 2048.0)
    # Without a bias, surfaces cast stripes of shadow on themselves.
    meshcat.SetProperty(sun, "shadow.bias", -5e-4)
    meshcat.SetProperty(sun, "shadow.normalBias", 0.03)
    meshcat.SetProperty(sun, "castShadow", True)


def content_bounds(world: World) -> tuple[Array, Array]:
    """Return the smallest and largest x, y of everything on the ground of a world [m], else those of the ground."""
    boxes = [placed.footprint.bounds for placed in world.props]
    boxes += [track.bounds for track in world.tracks.values()]
    boxes += [] if world.network is None else [world.network.bounds]
    boxes += [patch.area.bounds for patch in world.patches]
    boxes += [goal.area.bounds for goal in world.goals.values() if goal.area is not None]
    # A start alone, at the origin, is in every world.
    if not boxes:
        boxes.append(world.ground.extent)
    boxes += [(start.x, start.y, start.x, start.y) for start in world.starts.values()]
    boxes += [(x, y, x, y) for x, y, _ in map(world.actor_start, world.moving)]
    table = np.array(boxes, dtype=float)
    return table[:, :2].min(axis=0), table[:, 2:].max(axis=0)


def overlook(meshcat: Meshcat, world: World) -> None:
    """Place the camera above the south side of a world, as near as everything stays in view."""
    eye, target = overview(world)
    meshcat.SetCameraPose(eye.tolist(), target.tolist())


def overview(world: World) -> tuple[Array, Array]:
    """Return the position of the camera of :func:`overlook`, and the point that it looks at [m]."""
    low, high = content_bounds(world)
    middle, (long, wide) = 0.5 * (low + high), np.maximum(0.5 * (high - low), 4.0).tolist()
    corners = np.array([[sx * long, sy * wide, z] for sx in (-1, 1) for sy in (-1, 1) for z in (0.0, 4.0)])
    c, s = math.cos(_ELEVATION), math.sin(_ELEVATION)
    # Coordinates of the corners upwards and towards the viewer; perspective divides by the distance from the viewer.
    up, near = corners @ [0.0, s, c], corners @ [0.0, -c, s]
    limit = 0.88 * math.tan(0.5 * _FIELD_OF_VIEW)
    distance = float((near + np.maximum(np.abs(up) / limit, np.abs(corners[:, 0]) / (limit * _ASPECT))).max())
    x, y = middle.tolist()
    return np.array([x, y - c * distance, s * distance]), np.array([x, y, 0.0])


class ChaseCamera:
    """Camera behind a vehicle whose heading follows with a first-order lag.

    Args:
        meshcat: Meshcat with the vehicle.
    """

    def __init__(self, meshcat: Meshcat) -> None:
        self._meshcat = meshcat
        self._heading: float | None = None

    def follow(self, X_WB: RigidTransform, *, elapsed: float, lag: float) -> None:
        """Move the world under the camera.

        Args:
            X_WB: pose of the vehicle.
            elapsed: time since the last call [s].
            lag: time constant of the heading [s]; 0 for none.
        """
        x, y, _ = X_WB.translation()
        yaw = RollPitchYaw(X_WB.rotation()).yaw_angle()
        if self._heading is None or lag <= 0.0:
            self._heading = yaw
        else:
            # The shorter way round, then a first-order lag that does not depend on the frame rate.
            self._heading += ((yaw - self._heading + pi) % (2.0 * pi) - pi) * (1.0 - exp(-elapsed / lag))
        X_CW, X_CL = chase(x=x, y=y, yaw=self._heading)
        self._meshcat.SetTransform(WORLD_PATH, X_CW)
        self._meshcat.SetTransform(LIGHTS_PATH, X_CL)

    def forget(self) -> None:
        """Take the heading of the vehicle at the next call, after a jump of the vehicle."""
        self._heading = None


def chase(*, x: float, y: float, yaw: float) -> tuple[RigidTransform, RigidTransform]:
    """Return the poses of world and lights with which a fixed camera follows a vehicle.

    Meshcat's camera has a fixed target. So the world is moved under the camera: the vehicle is at the origin and heads
    along x, and the mouse can turn the view around it.

    Args:
        x: position of the vehicle [m].
        y: position of the vehicle [m].
        yaw: heading to follow [rad].

    Returns:
        transforms of :data:`WORLD_PATH` and :data:`LIGHTS_PATH`.
    """
    X_WC = RigidTransform(RollPitchYaw(0.0, 0.0, yaw), [x, y, 0.0])
    X_CW = X_WC.inverse()
    # Lights turn with the world but are not displaced: the sun is infinitely far away.
    return X_CW, RigidTransform(X_CW.rotation(), [0.0, 0.0, 0.0])
