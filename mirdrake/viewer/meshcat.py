"""Meshcat on this machine only, with sky, sun and cameras for vehicles."""

import weakref
from collections.abc import Iterator
from contextlib import contextmanager
from math import cos, exp, pi, sin

from pydrake.geometry import Meshcat
from pydrake.math import RigidTransform, RollPitchYaw

from mirdrake.core.drake_errors import is_meshcat_crash
from mirdrake.core.errors import RunError
from mirdrake.viewer.private_meshcat import Upstream, make_private_meshcat, release
from mirdrake.viewer.server import PageServer
from mirdrake.worlds import World
from mirdrake.worlds.scenery import set_sky

WORLD_PATH, LIGHTS_PATH = "/drake", "/Lights"
"""Paths of the world and the lights in Meshcat's scene tree."""

SHADOWS = 16.0
"""Half the side of the square around the followed vehicle in which shadows are drawn [m]."""


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


def overlook(meshcat: Meshcat, world: World) -> None:
    """Place the camera above the south side of a world, with the whole world in view."""
    left, south, right, north = world.ground.extent
    size = max(right - left, north - south)
    x, y = 0.5 * (left + right), 0.5 * (south + north)
    meshcat.SetCameraPose([x, y - 0.3 * size, 0.32 * size], [x, y, 0.0])


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
