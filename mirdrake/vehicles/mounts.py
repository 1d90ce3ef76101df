"""sensors.yaml: what is mounted in which frame of a vehicle.

Kinds that no sensor system simulates yet are data: a diagram that names one is told so.
"""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from mirdrake.yaml_io import Acceleration, Angle, AngularRate, Frequency, Length, Schema


class Mount(Schema):
    """What every mounted sensor has."""

    frame: str = Field(min_length=1, description="link of the URDF; x ahead, y left, z up, also for cameras")
    rate: Frequency = Field(gt=0, le=10_000, description="[Hz]")


class CameraMount(Mount):
    """Colour camera."""

    kind: Literal["camera"]
    width: int = Field(gt=0, le=8192, description="[pixel]")
    height: int = Field(gt=0, le=8192, description="[pixel]")
    horizontal_fov: Angle = Field(gt=0, lt=3.14, description="[rad] whole angle")
    near: Length = Field(default=0.1, gt=0, description="[m] clipping")
    far: Length = Field(default=300.0, gt=0, description="[m] clipping")
    noise: float = Field(default=0.0, ge=0, description="[-] standard deviation, of full scale 1")


class GpsMount(Mount):
    """Position receiver."""

    kind: Literal["gps"]
    noise: Length = Field(default=0.0, ge=0, description="[m] standard deviation, horizontal, each axis")


class ImuMount(Mount):
    """Rate gyros and accelerometers."""

    kind: Literal["imu"]
    gyro_noise: AngularRate = Field(default=0.0, ge=0, description="[rad/s] standard deviation of a sample")
    acceleration_noise: Acceleration = Field(default=0.0, ge=0, description="[m/s²] standard deviation of a sample")


class Ranging(Mount):
    """What every sensor that measures distances has."""

    near: Length = Field(gt=0, description="[m] nearest distance")
    far: Length = Field(gt=0, description="[m] farthest distance")
    resolution: Length = Field(default=0.0, ge=0, description="[m] step of the reading; 0: none")
    noise: Length = Field(default=0.0, ge=0, description="[m] standard deviation")

    @model_validator(mode="after")
    def _near_before_far(self) -> Self:
        if self.near >= self.far:
            raise ValueError(f"near ({self.near:g} m) should be below far ({self.far:g} m)")
        return self


class LaserScannerMount(Ranging):
    """Rotating laser in one plane. Data only."""

    kind: Literal["laser_scanner"]
    beams: int = Field(gt=0, le=100_000, description="per scan")
    start_angle: Angle = Field(ge=-6.3, le=6.3, description="[rad] of the first beam, positive to the left")
    end_angle: Angle = Field(ge=-6.3, le=6.3, description="[rad] of the last beam")


class LidarMount(Ranging):
    """Laser with several planes. Data only."""

    kind: Literal["lidar"]
    columns: int = Field(gt=0, le=100_000, description="beams per plane and turn")
    rows: int = Field(gt=0, le=1024, description="planes")
    horizontal_start: Angle = Field(ge=-6.3, le=6.3, description="[rad] positive to the left")
    horizontal_end: Angle = Field(ge=-6.3, le=6.3, description="[rad]")
    vertical_start: Angle = Field(ge=-1.6, le=1.6, description="[rad] positive upwards")
    vertical_end: Angle = Field(ge=-1.6, le=1.6, description="[rad]")


class DepthCameraMount(Mount):
    """Colour and depth camera. Data only."""

    kind: Literal["depth_camera"]
    width: int = Field(gt=0, le=8192, description="[pixel]")
    height: int = Field(gt=0, le=8192, description="[pixel]")
    horizontal_fov: Angle = Field(gt=0, lt=3.14, description="[rad] whole angle")
    near: Length = Field(default=0.1, gt=0, description="[m] clipping of the colour picture")
    far: Length = Field(default=300.0, gt=0, description="[m] clipping of the colour picture")
    depth_near: Length = Field(gt=0, description="[m] nearest depth")
    depth_far: Length = Field(gt=0, description="[m] farthest depth")
    noise: float = Field(default=0.0, ge=0, description="[-] of the colours, standard deviation, of full scale 1")


class SonarMount(Ranging):
    """Ultrasonic range finder. Data only."""

    kind: Literal["sonar"]
    cone: Angle = Field(gt=0, lt=3.14, description="[rad] whole angle")


class WheelEncoderMount(Mount):
    """Counter on a wheel. Data only."""

    kind: Literal["wheel_encoder"]
    counts: float = Field(gt=0, description="per revolution")


SensorMount = Annotated[
    CameraMount
    | DepthCameraMount
    | GpsMount
    | ImuMount
    | LaserScannerMount
    | LidarMount
    | SonarMount
    | WheelEncoderMount,
    Field(discriminator="kind"),
]


class SensorsSpec(Schema):
    """sensors.yaml: mounted sensors by name."""

    mounts: dict[str, SensorMount] = Field(default_factory=dict)
