"""A camera that follows the first vehicle while a simulation runs."""

import contextlib
from math import exp, pi
from typing import Any

from pydrake.geometry import Meshcat
from pydrake.math import RollPitchYaw
from pydrake.systems.framework import Context

from mirdrake.assembly.diagram import DRAWING_PERIOD, Assembly
from mirdrake.viewer.meshcat import LIGHTS_PATH, WORLD_PATH, chase, place_camera

LAG = 0.5
"""Time constant of the camera's heading [s]."""


class FollowCamera:
    """A monitor for :meth:`mirdrake.runs.simulation.Simulation.run` that keeps the first vehicle in view.

    Args:
        meshcat: shows the run.
        assembly: the simulated diagram.
    """

    def __init__(self, meshcat: Meshcat, assembly: Assembly) -> None:
        self._meshcat, self._plant = meshcat, assembly.parts.plant
        self._base: Any = next(iter(assembly.parts.vehicles.values())).base
        self._next = 0.0
        self._heading: float | None = None
        with contextlib.suppress(RuntimeError):  # Meshcat has ended; the simulation goes on
            place_camera(meshcat, x=0.0, y=0.0, yaw=0.0)

    def __call__(self, context: Context) -> None:
        """Move the world under the camera, once per drawing period.

        Args:
            context: Context of the whole diagram.
        """
        time = context.get_time()
        if time < self._next:
            return
        self._next = time + DRAWING_PERIOD
        X_WB = self._plant.EvalBodyPoseInWorld(self._plant.GetMyContextFromRoot(context), self._base)
        x, y, _ = X_WB.translation()
        yaw = RollPitchYaw(X_WB.rotation()).yaw_angle()
        if self._heading is None:
            self._heading = yaw
        turn = (yaw - self._heading + pi) % (2.0 * pi) - pi
        self._heading += (1.0 - exp(-DRAWING_PERIOD / LAG)) * turn
        X_CW, X_CL = chase(x=x, y=y, yaw=self._heading)
        with contextlib.suppress(RuntimeError):  # Meshcat has ended; the simulation goes on
            self._meshcat.SetTransform(WORLD_PATH, X_CW)
            self._meshcat.SetTransform(LIGHTS_PATH, X_CL)
