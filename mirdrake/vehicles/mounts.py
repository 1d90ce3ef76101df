"""sensors.yaml: what is mounted in which frame of a vehicle."""

from collections.abc import Mapping
from math import copysign, degrees, pi
from typing import Annotated, Any, Literal, Self, get_args

from pydantic import BeforeValidator, Field, field_validator, model_validator

from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.yaml_io import Angle, Duration, Frequency, Length, Schema, Source, Speed, validate
from mirdrake.core.yaml_tree import below_preset
from mirdrake.vehicles.lens import LensSpec, check_lens
from mirdrake.vehicles.noise_spec import AccelerationNoise, AngleNoise, LengthNoise, RateNoise, SpeedNoise
from mirdrake.vehicles.presets import with_preset

MAX_LATITUDE = 89.9 * pi / 180.0  # east and north mean nothing at the poles


class Mount(Schema):
    """What every mounted sensor has."""

    frame: str = Field(min_length=1, description="link of the URDF; x ahead, y left, z up, also for cameras")
    rate: Frequency = Field(gt=0, le=10_000, description="[Hz]")
    latency: Duration = Field(default=0.0, ge=0, le=10, description="[s] from taking a sample until it is there")
    dropout: float = Field(default=0.0, ge=0, lt=1, description="[-] probability that a sample is lost")
    preset: str | None = Field(default=None, description="product whose numbers these are; models/sensors/")


class PictureMount(Mount):
    """What every camera has. A distorted picture has the focal length that the field of view gives without a lens."""

    width: int = Field(gt=0, le=8192, description="[pixel]")
    height: int = Field(gt=0, le=8192, description="[pixel]")
    horizontal_fov: Angle = Field(gt=0, description="[rad] whole angle, without the lens")
    near: Length = Field(default=0.1, gt=0, description="[m] clipping")
    far: Length = Field(default=300.0, gt=0, description="[m] clipping")
    noise: float = Field(default=0.0, ge=0, description="[-] of colours, standard deviation, of full scale 1")
    distortion: LensSpec | None = Field(default=None, description="of the lens, after Brown and Conrady; none: pinhole")
    label: bool = Field(default=False, description="also a picture of which object each pixel shows")

    @field_validator("horizontal_fov")
    @classmethod
    def _below_half_a_turn(cls, value: float) -> float:
        if value >= 3.14:
            raise ValueError(f"{degrees(value):g} deg cannot be drawn on a plane; a field of view is below 180 deg")
        return value

    @model_validator(mode="after")
    def _something_to_see(self) -> Self:
        if self.near >= self.far:
            raise ValueError(f"near ({self.near:g} m) should be below far ({self.far:g} m)")
        if self.distortion is not None:
            check_lens(self.distortion, width=self.width, height=self.height, horizontal_fov=self.horizontal_fov)
        return self


class CameraMount(PictureMount):
    """Colour camera."""

    kind: Literal["camera"]


class StereoCameraMount(PictureMount):
    """Two colour cameras side by side, the mounting frame midway between them."""

    kind: Literal["stereo_camera"]
    baseline: Length = Field(gt=0, le=10, description="[m] between the eyes")


class DatumSpec(Schema):
    """Where on the Earth the world's origin is, on the WGS 84 ellipsoid."""

    latitude: Angle = Field(default=0.0, ge=-MAX_LATITUDE, le=MAX_LATITUDE, description="[rad] north; write 45 deg")
    longitude: Angle = Field(default=0.0, ge=-pi, le=pi, description="[rad] east; write -81 deg")
    altitude: Length = Field(default=0.0, ge=-1000, le=10_000, description="[m] above the ellipsoid")
    heading: Angle = Field(
        default=0.5 * pi, ge=-2 * pi, le=2 * pi, description="[rad] of the world's x axis, clockwise from north"
    )


class GpsMount(Mount):
    """Position receiver."""

    kind: Literal["gps"]
    noise: LengthNoise = Field(default_factory=LengthNoise, description="[m] horizontal, each axis")
    vertical_noise: LengthNoise = Field(default_factory=LengthNoise, description="[m] of the altitude")
    velocity_noise: SpeedNoise = Field(default_factory=SpeedNoise, description="[m/s] each axis")
    datum: DatumSpec = Field(default_factory=DatumSpec, description="where on the Earth the world's origin is")
    fix: Literal["single", "differential", "rtk"] = Field(default="single", description="quality said in NMEA")


class ImuMount(Mount):
    """Rate gyros and accelerometers."""

    kind: Literal["imu"]
    gyro_noise: RateNoise = Field(default_factory=RateNoise, description="[rad/s] each axis")
    acceleration_noise: AccelerationNoise = Field(default_factory=AccelerationNoise, description="[m/s²] each axis")


class GroundTruthMount(Mount):
    """Exact pose and twist of a frame, as no sensor gives them."""

    kind: Literal["ground_truth"]


class SteeringAngleMount(Mount):
    """Angle sensor of the steering."""

    kind: Literal["steering_angle"]
    of: Literal["road_wheels", "left", "right", "hand_wheel"] = Field(
        default="road_wheels", description="mean of the two front wheels, one of them, or the mean x steering ratio"
    )
    counts: float | None = Field(default=None, gt=0, description="per revolution, in place of `resolution`")
    resolution: Angle = Field(default=0.0, ge=0, description="[rad] step of the reading; 0: none")
    offset: Angle = Field(default=0.0, description="[rad] reading with the wheels straight ahead")
    noise: AngleNoise = Field(default_factory=AngleNoise, description="[rad]")

    @model_validator(mode="after")
    def _one_step(self) -> Self:
        if self.counts is not None and self.resolution:
            raise ValueError("counts and resolution say the same; leave one of them out")
        return self

    def step(self) -> float:
        """Step of the reading [rad]; 0: none."""
        return self.resolution if self.counts is None else 2.0 * pi / self.counts


ROUNDED_TURN = 6.3
"""A full turn rounded to two digits [rad]: the widest fan of beams, which is shortened to 2 pi."""

MAX_RAYS = 1_000_000
"""Of one scan: casting them takes about 0.2 kB each."""


class Ranging(Mount):
    """What every sensor that measures distances has."""

    near: Length = Field(gt=0, description="[m] nearest distance")
    far: Length = Field(gt=0, description="[m] farthest distance")
    resolution: Length = Field(default=0.0, ge=0, description="[m] step of the reading; 0: none")
    noise: Length = Field(default=0.0, ge=0, description="[m] standard deviation")
    lost_beams: float = Field(default=0.0, ge=0, lt=1, description="[-] share of single beams that give no return")
    own_vehicle: bool = Field(default=False, description="whether the vehicle that carries it is seen [-]")

    @model_validator(mode="after")
    def _near_before_far(self) -> Self:
        if self.near >= self.far:
            raise ValueError(f"near ({self.near:g} m) should be below far ({self.far:g} m)")
        return self


class Turning(Ranging):
    """What every laser that turns has; it makes `rate` turns a second."""

    rolling: bool = Field(default=True, description="whether each column of beams leaves at a time of its own [-]")


class LaserScannerMount(Turning):
    """Rotating laser in one plane."""

    kind: Literal["laser_scanner"]
    beams: int = Field(gt=0, le=100_000, description="per scan")
    start_angle: Angle = Field(ge=-6.3, le=6.3, description="[rad] of the first beam, positive to the left")
    end_angle: Angle = Field(ge=-6.3, le=6.3, description="[rad] of the last beam")

    @model_validator(mode="after")
    def _one_turn(self) -> Self:
        self.end_angle = _within_turn(self.start_angle, self.end_angle)
        return self


class LidarMount(Turning):
    """Laser with several planes."""

    kind: Literal["lidar"]
    columns: int = Field(gt=0, le=100_000, description="beams per plane and turn")
    rows: int = Field(gt=0, le=1024, description="planes")
    horizontal_start: Angle = Field(ge=-6.3, le=6.3, description="[rad] positive to the left")
    horizontal_end: Angle = Field(ge=-6.3, le=6.3, description="[rad]")
    vertical_start: Angle = Field(ge=-1.6, le=1.6, description="[rad] positive upwards")
    vertical_end: Angle = Field(ge=-1.6, le=1.6, description="[rad]")

    @model_validator(mode="after")
    def _one_turn(self) -> Self:
        self.horizontal_end = _within_turn(self.horizontal_start, self.horizontal_end)
        _check_rays(self.columns, self.rows)
        return self


class DepthNoiseSpec(Schema):
    """Standard deviation of a depth z: base + growth (z - start)²."""

    base: Length = Field(default=0.0, ge=0, description="[m]")
    growth: float = Field(default=0.0, ge=0, description="[1/m]")
    start: Length = Field(default=0.0, ge=0, description="[m]")


DEPTH_NOISES = {
    "khoshelham": {"growth": 1.425e-3},
    "nguyen": {"base": 1.2e-3, "growth": 1.9e-3, "start": 0.4},
}
"""Of the first Kinect, as published. Khoshelham and Elberink, "Accuracy and resolution of Kinect depth data", Sensors
12 (2012) 1437-1454: 1.425e-5 z² in cm. Nguyen, Izadi and Lovell, "Modeling Kinect sensor noise for improved 3D
reconstruction and tracking", 3DIMPVT 2012: 0.0012 + 0.0019 (z - 0.4)² in m, surfaces seen at up to 60 deg."""


def _named_noise(value: Any) -> Any:
    if isinstance(value, str):
        if value not in DEPTH_NOISES:
            raise ValueError(f"unknown depth noise '{value[:40]}'; {did_you_mean(value, DEPTH_NOISES)}")
        return DEPTH_NOISES[value]
    return value


class DepthCameraMount(PictureMount):
    """Colour and depth camera. A depth is measured along the x axis of the mounting frame."""

    kind: Literal["depth_camera"]
    color: bool = Field(default=True, description="colours too; without them it is quicker")
    depth_near: Length = Field(gt=0, description="[m] nearest depth; 0 is shown for what is nearer")
    depth_far: Length = Field(gt=0, description="[m] farthest depth; infinity is shown for what is farther")
    depth_noise: Annotated[DepthNoiseSpec, BeforeValidator(_named_noise)] = Field(
        default_factory=DepthNoiseSpec, description="{base, growth, start}, or published: khoshelham, nguyen"
    )
    depth_resolution: Length = Field(default=0.0, ge=0, description="[m] step of the depth; 0: none")
    inverse_depth_resolution: float = Field(
        default=0.0, ge=0, description="[1/m] step of 1/z, as of a disparity; 2.85e-3 for the first Kinect; 0: none"
    )

    @model_validator(mode="after")
    def _depths(self) -> Self:
        if self.depth_near >= self.depth_far:
            raise ValueError(f"depth_near ({self.depth_near:g} m) should be below depth_far ({self.depth_far:g} m)")
        return self


class SonarMount(Ranging):
    """Ultrasonic range finder."""

    kind: Literal["sonar"]
    cone: Angle = Field(gt=0, lt=3.14, description="[rad] whole angle")
    rays: int = Field(default=200, ge=1, le=100_000, description="that the cone is made of")
    ground: bool = Field(default=False, description="whether the ground gives an echo [-]")


class RadarMount(Ranging):
    """Radar: range, azimuth and range rate of the nearest objects."""

    kind: Literal["radar"]
    horizontal_fov: Angle = Field(gt=0, lt=3.14, description="[rad] whole angle")
    vertical_fov: Angle = Field(gt=0, lt=3.14, description="[rad] whole angle")
    columns: int = Field(default=120, gt=0, le=100_000, description="rays across the field of view")
    rows: int = Field(default=10, gt=0, le=1024, description="rays from below to above")
    targets: int = Field(default=16, gt=0, le=256, description="that are reported, the nearest first")
    range_cell: Length = Field(default=0.5, gt=0, description="[m] returns so close behind the first are one target")
    azimuth_noise: Angle = Field(default=0.0, ge=0, description="[rad] standard deviation")
    range_rate_noise: Speed = Field(default=0.0, ge=0, description="[m/s] standard deviation")
    ground: bool = Field(default=False, description="whether the ground is a target [-]")

    @model_validator(mode="after")
    def _few_rays(self) -> Self:
        _check_rays(self.columns, self.rows)
        return self


class WheelEncoderMount(Mount):
    """Counter on a wheel."""

    kind: Literal["wheel_encoder"]
    counts: float = Field(gt=0, description="per revolution, all edges that are counted")
    quadrature: bool = Field(default=True, description="two channels: counts down rolling back; else up either way")
    wrap: int | None = Field(default=None, ge=2, description="the counter starts again from 0 there, as 65536")


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


def _within_turn(start: float, end: float) -> float:
    """Return the last angle of a fan of beams [rad]; a turn rounded to two digits or more, as 6.28319, is a full turn.

    Raises:
        ValueError: the fan is wider than one turn.
    """
    if abs(end - start) > ROUNDED_TURN + 1e-9:
        raise ValueError(f"from {start:g} to {end:g} rad is more than a turn of {2.0 * pi:.6g} rad")
    if abs(end - start) > 2.0 * pi + 1e-6:
        return start + copysign(2.0 * pi, end - start)
    return end


def _check_rays(columns: int, rows: int) -> None:
    """Refuse more rays than fit into memory."""
    if columns * rows > MAX_RAYS:
        raise ValueError(
            f"{columns} columns x {rows} rows are {columns * rows} rays a scan, which need about "
            f"{columns * rows * 2e-7:.1f} GB; at most {MAX_RAYS} are cast"
        )


_KINDS: dict[str, type[Any]] = {
    get_args(model.model_fields["kind"].annotation)[0]: model for model in get_args(get_args(SensorMount)[0])
}


class SensorsSpec(Schema):
    """sensors.yaml: mounted sensors by name."""

    mounts: dict[str, Annotated[SensorMount, BeforeValidator(with_preset)]] = Field(default_factory=dict)


def change_mounts(sensors: SensorsSpec, changes: Mapping[str, Mapping[str, Any]], *, source: Source) -> SensorsSpec:
    """Return mounted sensors with some keys changed; a preset replaces all keys but frame and datum.

    Args:
        sensors: of a vehicle.
        changes: by the names of mounts.
        source: where they were written, for errors.

    Raises:
        ConfigError: no such mount or key, or a value out of range.
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
