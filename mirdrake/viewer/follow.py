"""A camera that follows the first vehicle while a simulation runs."""

import contextlib
from typing import Any

from pydrake.geometry import Meshcat
from pydrake.systems.framework import Context

from mirdrake.assembly.diagram import DRAWING_PERIOD, Assembly
from mirdrake.viewer.meshcat import ChaseCamera, place_camera

LAG = 0.5
"""Time constant of the camera's heading [s]."""


class FollowCamera:
    """A monitor for :meth:`mirdrake.runs.simulation.Simulation.run` that keeps the first vehicle in view.

    Args:
        meshcat: shows the run.
        assembly: the simulated diagram.
    """

    def __init__(self, meshcat: Meshcat, assembly: Assembly) -> None:
        self._camera, self._plant = ChaseCamera(meshcat), assembly.parts.plant
        self._base: Any = next(iter(assembly.parts.vehicles.values())).base
        self._next = 0.0
        with contextlib.suppress(RuntimeError):  # Meshcat has ended; the simulation continues
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
        with contextlib.suppress(RuntimeError):  # Meshcat has ended; the simulation continues
            self._camera.follow(X_WB, elapsed=DRAWING_PERIOD, lag=LAG)
