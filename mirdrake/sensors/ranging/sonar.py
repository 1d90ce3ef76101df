"""Ultrasonic range finder: the nearest echo in a cone."""

from typing import Any, ClassVar, Literal

import numpy as np
from pydantic import Field
from pydrake.multibody.tree import Frame
from pydrake.systems.framework import Context

from mirdrake.core.signals import signals
from mirdrake.core.yaml_io import Angle
from mirdrake.sensors.ranging.beams import cone
from mirdrake.sensors.ranging.caster import Caster
from mirdrake.sensors.ranging.faces import Array
from mirdrake.sensors.ranging.mount import Ranging
from mirdrake.sensors.ranging.world import RayWorld
from mirdrake.sensors.sampling import SampledSensor
from mirdrake.vehicles.mount import FieldOfView

SONAR = signals(("range", "m", "distance of the nearest echo, inf: none"))
"""Output of a sonar."""


class Sonar(SampledSensor):
    """Sonar: distance of the nearest surface in a cone about the x axis of its frame.

    The cone is a bundle of rays that leave at the same time; an object smaller than the gaps between them may be
    missed. A surface nearer than the near limit hides the surfaces behind it. The echo does not depend on the direction
    of a surface. The ground, which reflects sound forward, gives no echo unless the mount has `ground: true`.

    Input ports:
        body_poses: the plant's output.
        body_spatial_velocities: the plant's output.
    Output ports:
        sample (1) [m]: :data:`SONAR`.
        stamp (1) [s]: when the sample was taken.

    Args:
        world: surfaces that give returns.
        frame: frame of the sonar; fixed to a body.
        mount: cone, limits, rate and noise.
        stream: stream from :func:`mirdrake.sensors.noise.noise_stream`.
        hidden: bodies that give no returns.
    """

    record = None

    def __init__(
        self, world: RayWorld, frame: Frame, mount: "SonarMount", *, stream: int = 0, hidden: tuple[int, ...] = ()
    ) -> None:
        super().__init__(SONAR, mount, stream=stream, initial=[np.inf])
        self.mount = mount
        self.caster = Caster(
            self, world, frame, mount, cone(mount.cone, mount.rays), stream=stream, hidden=hidden, ground=mount.ground
        )

    def measure(self, context: Context) -> Array:
        """Return the nearest echo [m] (1), with noise."""
        distance = self.caster.look(context).distance.ravel()
        nearest = distance[distance >= self.mount.near].min(initial=np.inf)
        return self.caster.reading(np.array([nearest]), round(context.get_time() * self.rate))


class SonarMount(Ranging):
    """Ultrasonic range finder."""

    system: ClassVar[Any] = Sonar
    kind: Literal["sonar"]
    cone: Angle = Field(gt=0, lt=3.14, description="[rad] full opening angle of the beam")
    rays: int = Field(default=200, ge=1, le=100_000, description="rays that sample the cone")
    ground: bool = Field(default=False, description="[-] whether the ground gives an echo")

    def field_of_view(self) -> FieldOfView:
        """Return the cone."""
        half = 0.5 * self.cone
        return FieldOfView((-half, half), (-half, half), (self.near, self.far))
