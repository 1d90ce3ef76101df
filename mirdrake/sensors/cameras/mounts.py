"""Mounts of cameras. All kinds share one system, which is imported when a camera is made."""

from math import atan, degrees, tan
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self

from pydantic import BeforeValidator, Field, field_validator, model_validator

from mirdrake.core.errors import did_you_mean
from mirdrake.core.yaml_io import Angle, Length, Schema
from mirdrake.sensors.cameras.lens import LensSpec, check_lens
from mirdrake.sensors.mount import SensorMount
from mirdrake.vehicles.mount import FieldOfView

if TYPE_CHECKING:
    from mirdrake.plant.plant import PlantParts, VehicleInPlant
    from mirdrake.sensors.cameras.camera import Camera


class PictureMount(SensorMount):
    """Keys of every camera. ``horizontal_fov`` sets the focal length; lens distortion does not change it."""

    takes_pictures: ClassVar[bool] = True

    width: int = Field(gt=0, le=8192, description="[pixel] width of the picture")
    height: int = Field(gt=0, le=8192, description="[pixel] height of the picture")
    horizontal_fov: Angle = Field(gt=0, description="[rad] full angle, without lens distortion")
    near: Length = Field(default=0.1, gt=0, description="[m] near clipping distance")
    far: Length = Field(default=300.0, gt=0, description="[m] far clipping distance")
    noise: float = Field(default=0.0, ge=0, description="[-] standard deviation of each colour channel, full scale 1")
    distortion: LensSpec | None = Field(default=None, description="lens distortion (Brown-Conrady); null: pinhole")
    label: bool = Field(default=False, description="also output a label image: the object seen by each pixel")

    @field_validator("horizontal_fov")
    @classmethod
    def _below_half_a_turn(cls, value: float) -> float:
        if value >= 3.14:
            raise ValueError(
                f"a field of view of {degrees(value):g} deg cannot be projected onto a plane; allowed: below 180 deg"
            )
        return value

    @model_validator(mode="after")
    def _near_below_far(self) -> Self:
        if self.near >= self.far:
            raise ValueError(f"near ({self.near:g} m) must be below far ({self.far:g} m)")
        if self.distortion is not None:
            check_lens(self.distortion, width=self.width, height=self.height, horizontal_fov=self.horizontal_fov)
        return self

    def field_of_view(self) -> FieldOfView:
        """Return the region in the picture, without lens distortion."""
        side = 0.5 * self.horizontal_fov
        up = atan(tan(side) * self.height / self.width)
        return FieldOfView((-side, side), (-up, up), (self.near, self.far))

    def make(self, *, parts: "PlantParts", part: "VehicleInPlant", stream: int) -> "Camera":
        """Return the camera; adds the vehicle's renderer if there is none yet.

        Raises:
            ConfigError: its pictures do not fit into memory.
            MissingDependencyError: there is nothing to render with.
        """
        from mirdrake.sensors.cameras.camera import make_camera

        return make_camera(self, parts=parts, part=part, stream=stream)


class CameraMount(PictureMount):
    """Colour camera."""

    kind: Literal["camera"]


class StereoCameraMount(PictureMount):
    """Stereo camera: two colour cameras side by side, with the mounting frame midway between them."""

    kind: Literal["stereo_camera"]
    baseline: Length = Field(gt=0, le=10, description="[m] distance between the two cameras")


class DepthNoiseSpec(Schema):
    """Standard deviation of a depth z: base + growth (z - start)²."""

    base: Length = Field(default=0.0, ge=0, description="[m] standard deviation at `start`")
    growth: float = Field(default=0.0, ge=0, description="[1/m] coefficient of the quadratic term")
    start: Length = Field(default=0.0, ge=0, description="[m] depth at which the quadratic term begins")


DEPTH_NOISES = {"khoshelham": {"growth": 1.425e-3}, "nguyen": {"base": 1.2e-3, "growth": 1.9e-3, "start": 0.4}}
"""Published noise models of the Kinect v1.

Khoshelham and Elberink, "Accuracy and resolution of Kinect depth data", Sensors 12 (2012) 1437-1454: 1.425e-5 z² in cm.
Nguyen, Izadi and Lovell, "Modeling Kinect sensor noise for improved 3D reconstruction and tracking", 3DIMPVT 2012:
0.0012 + 0.0019 (z - 0.4)² in m, for surfaces seen at up to 60 deg.
"""


def _named_noise(value: Any) -> Any:
    if isinstance(value, str):
        if value not in DEPTH_NOISES:
            raise ValueError(f"unknown depth noise '{value[:40]}'; {did_you_mean(value, DEPTH_NOISES)}")
        return DEPTH_NOISES[value]
    return value


class DepthCameraMount(PictureMount):
    """Colour and depth camera. Depth is measured along the x axis of the mounting frame."""

    kind: Literal["depth_camera"]
    color: bool = Field(default=True, description="also output the colour image; false is faster")
    depth_near: Length = Field(gt=0, description="[m] smallest depth; nearer pixels are 0")
    depth_far: Length = Field(gt=0, description="[m] largest depth; farther pixels are infinite")
    depth_noise: Annotated[DepthNoiseSpec, BeforeValidator(_named_noise)] = Field(
        default_factory=DepthNoiseSpec, description="{base, growth, start}, or a published model: khoshelham, nguyen"
    )
    depth_resolution: Length = Field(default=0.0, ge=0, description="[m] resolution of the depth; 0: continuous")
    inverse_depth_resolution: float = Field(
        default=0.0, ge=0, description="[1/m] resolution of 1/z, as of a disparity; Kinect v1: 2.85e-3; 0: continuous"
    )

    @model_validator(mode="after")
    def _depths(self) -> Self:
        if self.depth_near >= self.depth_far:
            raise ValueError(f"depth_near ({self.depth_near:g} m) must be below depth_far ({self.depth_far:g} m)")
        return self

    def field_of_view(self) -> FieldOfView:
        """Return the region of the depth image."""
        return super().field_of_view()._replace(reach=(self.depth_near, self.depth_far))
