"""Schemas of sensors.yaml: the sensors of a vehicle, each mounted in a frame.

A kind of sensor is one class here and one system in :mod:`mirdrake.sensors`.
"""

from collections.abc import Mapping
from math import atan, copysign, degrees, pi, tan
from typing import Annotated, Any, ClassVar, Literal, Self, get_args

from pydantic import BeforeValidator, Field, field_validator, model_validator

from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.yaml_io import Angle, Length, Schema, Source, Speed, validate
from mirdrake.core.yaml_tree import below_preset
from mirdrake.vehicles.lens import LensSpec, check_lens
from mirdrake.vehicles.mount import FieldOfView, Mount
from mirdrake.vehicles.noise_spec import AccelerationNoise, AngleNoise, LengthNoise, RateNoise, SpeedNoise
from mirdrake.vehicles.presets import with_preset

MAX_LATITUDE = 89.9 * pi / 180.0  # east and north are not defined at the poles


class PictureMount(Mount):
    """Keys of every camera. ``horizontal_fov`` sets the focal length; lens distortion does not change it."""

    takes_pictures: ClassVar[bool] = True

    width: int = Field(gt=0, le=8192, description="[pixel]")
    height: int = Field(gt=0, le=8192, description="[pixel]")
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


class CameraMount(PictureMount):
    """Colour camera."""

    kind: Literal["camera"]


class StereoCameraMount(PictureMount):
    """Stereo camera: two colour cameras side by side, with the mounting frame midway between them."""

    kind: Literal["stereo_camera"]
    baseline: Length = Field(gt=0, le=10, description="[m] distance between the two cameras")


class DatumSpec(Schema):
    """Position of the world's origin on the WGS 84 ellipsoid."""

    latitude: Angle = Field(
        default=0.0, ge=-MAX_LATITUDE, le=MAX_LATITUDE, description="[rad] positive north, for example 45 deg"
    )
    longitude: Angle = Field(default=0.0, ge=-pi, le=pi, description="[rad] positive east, for example -81 deg")
    altitude: Length = Field(default=0.0, ge=-1000, le=10_000, description="[m] above the ellipsoid")
    heading: Angle = Field(
        default=0.5 * pi, ge=-2 * pi, le=2 * pi, description="[rad] of the world's x axis, clockwise from north"
    )


class GpsMount(Mount):
    """Satellite navigation receiver (GNSS)."""

    kind: Literal["gps"]
    noise: LengthNoise = Field(default_factory=LengthNoise, description="[m] horizontal position error, each axis")
    vertical_noise: LengthNoise = Field(default_factory=LengthNoise, description="[m] altitude error")
    velocity_noise: SpeedNoise = Field(default_factory=SpeedNoise, description="[m/s] velocity error, each axis")
    datum: DatumSpec = Field(default_factory=DatumSpec, description="geographic position of the world's origin")
    fix: Literal["single", "differential", "rtk"] = Field(default="single", description="fix quality in NMEA sentences")


class ImuMount(Mount):
    """Inertial measurement unit: rate gyros and accelerometers."""

    kind: Literal["imu"]
    gyro_noise: RateNoise = Field(default_factory=RateNoise, description="[rad/s] gyro error, each axis")
    acceleration_noise: AccelerationNoise = Field(
        default_factory=AccelerationNoise, description="[m/s²] accelerometer error, each axis"
    )


class GroundTruthMount(Mount):
    """Exact pose and twist of a frame, without any error."""

    kind: Literal["ground_truth"]


class SteeringAngleMount(Mount):
    """Angle sensor of the steering."""

    kind: Literal["steering_angle"]
    of: Literal["road_wheels", "left", "right", "hand_wheel"] = Field(
        default="road_wheels",
        description="road_wheels: mean of both; left, right: one of them; hand_wheel: mean x steering ratio",
    )
    counts: float | None = Field(default=None, gt=0, description="counts per revolution, instead of `resolution`")
    resolution: Angle = Field(default=0.0, ge=0, description="[rad] resolution; 0: continuous")
    offset: Angle = Field(default=0.0, description="[rad] reading with the wheels straight ahead")
    noise: AngleNoise = Field(default_factory=AngleNoise, description="[rad]")

    @model_validator(mode="after")
    def _one_step(self) -> Self:
        if self.counts is not None and self.resolution:
            raise ValueError("counts and resolution are both given; give one of them")
        return self

    def step(self) -> float:
        """Return the resolution [rad]; 0: continuous."""
        return self.resolution if self.counts is None else 2.0 * pi / self.counts


ROUNDED_TURN = 6.3
"""Full turn rounded to two digits [rad]: the largest allowed angle between first and last beam; shortened to 2π."""

MAX_RAYS = 1_000_000
"""Largest number of rays of a scan; each needs about 0.2 kB."""


class Ranging(Mount):
    """Keys of every sensor that measures distances."""

    near: Length = Field(gt=0, description="[m] smallest measurable distance")
    far: Length = Field(gt=0, description="[m] largest measurable distance")
    resolution: Length = Field(default=0.0, ge=0, description="[m] resolution; 0: continuous")
    noise: Length = Field(default=0.0, ge=0, description="[m] standard deviation of the range")
    lost_beams: float = Field(default=0.0, ge=0, lt=1, description="[-] probability that a beam has no return")
    own_vehicle: bool = Field(default=False, description="[-] whether its own vehicle gives returns")

    @model_validator(mode="after")
    def _near_before_far(self) -> Self:
        if self.near >= self.far:
            raise ValueError(f"near ({self.near:g} m) must be below far ({self.far:g} m)")
        return self


class Turning(Ranging):
    """Keys of every rotating laser; it makes `rate` revolutions per second."""

    rolling: bool = Field(
        default=True, description="[-] whether each column is measured at its own time (rolling scan)"
    )


class LaserScannerMount(Turning):
    """Rotating laser scanner with one plane."""

    kind: Literal["laser_scanner"]
    beams: int = Field(gt=0, le=100_000, description="beams per scan")
    start_angle: Angle = Field(ge=-6.3, le=6.3, description="[rad] azimuth of the first beam, positive to the left")
    end_angle: Angle = Field(ge=-6.3, le=6.3, description="[rad] azimuth of the last beam")

    @model_validator(mode="after")
    def _one_turn(self) -> Self:
        self.end_angle = _within_turn(self.start_angle, self.end_angle)
        return self

    def field_of_view(self) -> FieldOfView:
        """Return the fan of beams."""
        return FieldOfView(_ascending(self.start_angle, self.end_angle), (0.0, 0.0), (self.near, self.far))


class LidarMount(Turning):
    """Rotating laser scanner with several planes."""

    kind: Literal["lidar"]
    columns: int = Field(gt=0, le=100_000, description="beams per plane and revolution")
    rows: int = Field(gt=0, le=1024, description="number of planes")
    horizontal_start: Angle = Field(
        ge=-6.3, le=6.3, description="[rad] azimuth of the first column, positive to the left"
    )
    horizontal_end: Angle = Field(ge=-6.3, le=6.3, description="[rad] azimuth of the last column")
    vertical_start: Angle = Field(ge=-1.6, le=1.6, description="[rad] elevation of the first plane, positive upwards")
    vertical_end: Angle = Field(ge=-1.6, le=1.6, description="[rad] elevation of the last plane")

    @model_validator(mode="after")
    def _one_turn(self) -> Self:
        self.horizontal_end = _within_turn(self.horizontal_start, self.horizontal_end)
        _check_rays(self.columns, self.rows)
        return self

    def field_of_view(self) -> FieldOfView:
        """Return the region between the outermost planes and columns."""
        across = _ascending(self.horizontal_start, self.horizontal_end)
        return FieldOfView(across, _ascending(self.vertical_start, self.vertical_end), (self.near, self.far))


class DepthNoiseSpec(Schema):
    """Standard deviation of a depth z: base + growth (z - start)²."""

    base: Length = Field(default=0.0, ge=0, description="[m] standard deviation at `start`")
    growth: float = Field(default=0.0, ge=0, description="[1/m] coefficient of the quadratic term")
    start: Length = Field(default=0.0, ge=0, description="[m] depth at which the quadratic term begins")


DEPTH_NOISES = {
    "khoshelham": {"growth": 1.425e-3},
    "nguyen": {"base": 1.2e-3, "growth": 1.9e-3, "start": 0.4},
}
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


class SonarMount(Ranging):
    """Ultrasonic range finder."""

    kind: Literal["sonar"]
    cone: Angle = Field(gt=0, lt=3.14, description="[rad] full opening angle of the beam")
    rays: int = Field(default=200, ge=1, le=100_000, description="rays that sample the cone")
    ground: bool = Field(default=False, description="[-] whether the ground gives an echo")

    def field_of_view(self) -> FieldOfView:
        """Return the cone."""
        half = 0.5 * self.cone
        return FieldOfView((-half, half), (-half, half), (self.near, self.far))


class RadarMount(Ranging):
    """Radar: range, azimuth and range rate of the nearest objects."""

    kind: Literal["radar"]
    horizontal_fov: Angle = Field(gt=0, lt=3.14, description="[rad] full angle")
    vertical_fov: Angle = Field(gt=0, lt=3.14, description="[rad] full angle")
    columns: int = Field(default=120, gt=0, le=100_000, description="rays across the field of view")
    rows: int = Field(default=10, gt=0, le=1024, description="rays from the bottom to the top of the field of view")
    targets: int = Field(default=16, gt=0, le=256, description="largest number of reported targets, the nearest first")
    range_cell: Length = Field(
        default=0.5, gt=0, description="[m] returns within this distance of the first one are one target"
    )
    azimuth_noise: Angle = Field(default=0.0, ge=0, description="[rad] standard deviation of the azimuth")
    range_rate_noise: Speed = Field(default=0.0, ge=0, description="[m/s] standard deviation of the range rate")
    ground: bool = Field(default=False, description="[-] whether the ground is a target")

    @model_validator(mode="after")
    def _few_rays(self) -> Self:
        _check_rays(self.columns, self.rows)
        return self

    def field_of_view(self) -> FieldOfView:
        """Return the region between the outermost rays."""
        side, up = 0.5 * self.horizontal_fov, 0.5 * self.vertical_fov
        return FieldOfView((-side, side), (-up, up), (self.near, self.far))


class WheelEncoderMount(Mount):
    """Incremental encoder on a wheel."""

    kind: Literal["wheel_encoder"]
    counts: float = Field(gt=0, description="counts per revolution: all counted edges")
    quadrature: bool = Field(
        default=True, description="true: counts down when rolling backwards; false: counts up both ways"
    )
    wrap: int | None = Field(
        default=None, ge=2, description="modulus of the counter, for example 65536; null: unlimited"
    )


SensorMount = Annotated[
    CameraMount
    | DepthCameraMount
    | GpsMount
    | GroundTruthMount
    | ImuMount
    | LaserScannerMount
    | LidarMount
    | RadarMount
    | SonarMount
    | SteeringAngleMount
    | StereoCameraMount
    | WheelEncoderMount,
    Field(discriminator="kind"),
]


def _ascending(a: float, b: float) -> tuple[float, float]:
    return min(a, b), max(a, b)


def _within_turn(start: float, end: float) -> float:
    """Return the last angle of a fan of beams [rad], where a rounded full turn such as 6.28319 is shortened to 2π.

    Raises:
        ValueError: the fan is wider than a full turn.
    """
    if abs(end - start) > ROUNDED_TURN + 1e-9:
        raise ValueError(f"from {start:g} to {end:g} rad is more than a full turn of {2.0 * pi:.6g} rad")
    if abs(end - start) > 2.0 * pi + 1e-6:
        return start + copysign(2.0 * pi, end - start)
    return end


def _check_rays(columns: int, rows: int) -> None:
    """Check that the rays of a scan fit into memory."""
    if columns * rows > MAX_RAYS:
        raise ValueError(
            f"{columns} columns x {rows} rows are {columns * rows} rays per scan and need about "
            f"{columns * rows * 2e-7:.1f} GB; allowed: at most {MAX_RAYS} rays"
        )


_KINDS: dict[str, type[Any]] = {
    get_args(model.model_fields["kind"].annotation)[0]: model for model in get_args(get_args(SensorMount)[0])
}


class SensorsSpec(Schema):
    """sensors.yaml: the mounted sensors by name."""

    mounts: dict[str, Annotated[SensorMount, BeforeValidator(with_preset)]] = Field(default_factory=dict)


def change_mounts(sensors: SensorsSpec, changes: Mapping[str, Mapping[str, Any]], *, source: Source) -> SensorsSpec:
    """Return mounted sensors with some keys changed; a preset replaces all keys except frame and datum.

    Args:
        sensors: of a vehicle.
        changes: changed keys by the name of the mount.
        source: file of the changes, for messages.

    Raises:
        ConfigError: a mount or key does not exist, or a value is out of range.
    """
    mounts = dict(sensors.mounts)
    for name, keys in changes.items():
        if name not in mounts:
            raise ConfigError(f"{source.where(name)}: no sensor '{name}' is mounted; {did_you_mean(name, mounts)}")
        data = below_preset(mounts[name].model_dump(exclude_unset=True), keys) | dict(keys)
        place = source._replace(prefix=(*source.prefix, name))
        try:
            data = with_preset(data)
        except ValueError as error:
            raise ConfigError(f"{place.where('preset')}: {error}") from None
        # A preset may be of another kind than the sensor that it replaces.
        mounts[name] = validate(data, _KINDS.get(str(data.get("kind")), type(mounts[name])), place)
    return SensorsSpec(mounts=mounts)
