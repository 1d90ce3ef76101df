"""Position receiver."""

from typing import TYPE_CHECKING

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.multibody.tree import Frame
from pydrake.systems.framework import Context

from mirdrake.sensors.sampling import Array, SampledSensor, mount_pose
from mirdrake.signals import signals
from mirdrake.vehicles.mounts import GpsMount

if TYPE_CHECKING:
    from mirdrake.plant import PlantParts, VehicleInPlant

GPS = signals(("x", "m"), ("y", "m"), ("z", "m"))
"""Position of the mount's origin in the world; no geodetic coordinates."""


class Gps(SampledSensor):
    """Position of a frame in the world.

    Input ports:
        body_poses: the plant's output.
    Output ports:
        sample (3) [m]: :data:`GPS`. Noise is horizontal; the height is exact. The first sample is there from the start.

    Args:
        frame: where the antenna is mounted; fixed to a body.
        rate: samples per second [Hz].
        noise: standard deviation of a sample, each horizontal axis [m].
        stream: from :func:`mirdrake.sensors.noise.noise_stream`.
    """

    def __init__(self, frame: Frame, *, rate: float, noise: float = 0.0, stream: int = 0) -> None:
        super().__init__(GPS, rate=rate, noise=[noise, noise, 0.0], stream=stream, initial=[0.0, 0.0, 0.0])
        body, X_BS = mount_pose(frame)
        self._body, self._place = int(body.index()), X_BS.translation()
        self.body_poses = self.DeclareAbstractInputPort("body_poses", AbstractValue.Make([RigidTransform()]))
        self.DeclareInitializationDiscreteUpdateEvent(self._update)

    def measure(self, context: Context) -> Array:
        """Position of the antenna in the world [m] (3)."""
        return np.array(self.body_poses.Eval(context)[self._body].multiply(self._place))


def make_gps(mount: GpsMount, *, parts: "PlantParts", part: "VehicleInPlant", stream: int) -> Gps:
    """The receiver of a vehicle as its sensors.yaml describes it."""
    frame = parts.plant.GetFrameByName(mount.frame, part.instance)
    return Gps(frame, rate=mount.rate, noise=mount.noise, stream=stream)
