"""Base of the mounts: the keys that all entries of sensors.yaml have."""

from typing import ClassVar, NamedTuple

from pydantic import Field

from mirdrake.core.yaml_io import Duration, Frequency, Schema


class FieldOfView(NamedTuple):
    """Region that a sensor sees, in its mounting frame.

    Attributes:
        across: azimuth [rad] from right to left, about the x axis.
        upward: elevation [rad] from below to above.
        reach: nearest and farthest distance [m].
    """

    across: tuple[float, float]
    upward: tuple[float, float]
    reach: tuple[float, float]


class Mount(Schema):
    """Keys of every mounted sensor; base of all kinds.

    Attributes:
        takes_pictures: whether it is a camera: rendered, and only when its pictures are recorded or connected.
    """

    takes_pictures: ClassVar[bool] = False

    kind: str
    frame: str = Field(min_length=1, description="link of the URDF; x forward, y left, z up, also for cameras")
    rate: Frequency = Field(gt=0, le=10_000, description="[Hz] sample rate")
    latency: Duration = Field(default=0.0, ge=0, le=10, description="[s] time from the sample to its output")
    dropout: float = Field(default=0.0, ge=0, lt=1, description="[-] probability that a sample is lost")
    preset: str | None = Field(default=None, description="product whose values are used, see models/sensors/")

    def field_of_view(self) -> FieldOfView | None:
        """Return the region that the sensor sees; None for a sensor without a viewing direction."""
        return None
