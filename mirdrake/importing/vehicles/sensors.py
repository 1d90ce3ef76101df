"""Gazebo sensors as mounts of sensors.yaml; each is checked against the schema before meshes are converted."""

import re
from collections.abc import Iterator, Mapping
from math import atan2, degrees, inf, isfinite, isnan, radians

import numpy as np
from pydrake.math import RigidTransform

from mirdrake.importing.changes import Change, Changes, Code
from mirdrake.importing.values import make_pose
from mirdrake.importing.vehicles.car import Frame
from mirdrake.importing.vehicles.model import SensorTag, SourceModel
from mirdrake.importing.vehicles.names import Names
from mirdrake.importing.vehicles.sensor_fit import FARTHEST, MountData, fit_mount

RATES = {
    "camera": 30.0,
    "stereo_camera": 30.0,
    "depth_camera": 30.0,
    "laser_scanner": 40.0,
    "lidar": 10.0,
    "imu": 100.0,
    "gps": 10.0,
    "sonar": 10.0,
}
"""Default rates [Hz] of sensors without a rate or with rate zero, which means "in every step"."""

REACH = 100.0
"""Distance from its link [m] beyond which the place of a sensor is a mistake."""

_KINDS = {
    "camera": "camera", "wideanglecamera": "camera", "wide_angle_camera": "camera", "multicamera": "stereo_camera",
    "depth": "depth_camera", "depth_camera": "depth_camera", "rgbd": "depth_camera", "rgbd_camera": "depth_camera",
    "ray": "lidar", "gpu_ray": "lidar", "lidar": "lidar", "gpu_lidar": "lidar",
    "imu": "imu", "gps": "gps", "navsat": "gps", "sonar": "sonar",
}  # fmt: skip

_TURNS = 1e6  # [rad] or [deg]: larger angles have no digits left
_PARALLEL = 1e-3  # [rad] between the eyes of a stereo camera
_CAMERA = {"width": 800, "height": 600, "horizontal_fov": 1.047, "near": 0.1, "far": 100.0}
_SONAR = re.compile("sonar|ultraso|gazebo_ros_range|range_sensor", re.IGNORECASE)
_DEPTH = re.compile("kinect|depth|realsense", re.IGNORECASE)


def make_mounts(
    model: SourceModel, places: Mapping[str, tuple[str, RigidTransform]], names: Names
) -> tuple[dict[str, MountData], list[Frame], list[Change]]:
    """Return mounts, their frames, and the changes of sensors without counterpart.

    Args:
        model: model as read.
        places: link of the source -> link of the car that carries it, and its pose in there.
        names: names of links that are taken, and new ones.
    """
    mounts: dict[str, MountData] = {}
    frames: list[Frame] = []
    changes = Changes()
    taken: set[str] = set()
    for sensor in model.sensors:
        part, was = f"sensor '{sensor.name}'", f"type {sensor.kind}"
        kind = _kind_of(sensor)
        if kind is None or sensor.link not in places:
            why = "mirdrake has no such sensor" if kind is None else f"the link '{sensor.link}' does not exist"
            changes.add(Code.SENSOR, sensor.where, part, was, None, why)
            continue
        # Links that do not move against each other became one, so a pose refers to the merged part.
        parent, X_PL = places[sensor.link]
        X_LS = sensor.X_LS
        distance = float(np.linalg.norm(X_LS.translation()))
        # The comparison is false for NaN, too.
        if not distance <= REACH:
            why = f"a sensor is at most {REACH:g} m from its link"
            changes.add(Code.SENSOR, sensor.where, f"{part}: place", f"{distance:.3g} m away", "at the link", why)
            X_LS = RigidTransform()
        # One sensor of Gazebo may become several mounts, for example a depth camera and its colour image.
        for suffix, mount, X_SC in _Reader(sensor, changes).mounts(kind):
            label = re.sub(r"[^A-Za-z0-9_]+", "_", f"{sensor.name}{suffix}")[:64]
            frame = names.new(f"{label}_mount")
            joint = names.new_joint(f"{frame}_joint")
            frames.append(Frame(frame, joint, parent, X_PL.multiply(X_LS).multiply(X_SC)))
            name = names.unique(label, taken)
            mounts[name] = {"kind": mount.pop("kind"), "frame": frame, **mount}
    return mounts, frames, changes


def _kind_of(sensor: SensorTag) -> str | None:
    """Return the kind of mount for a sensor, by its type and by its plugins."""
    kind = _KINDS.get(sensor.kind)
    words = " ".join((*sensor.plugins, sensor.values.get("plugin.output_type", "")))
    if kind == "lidar" and (_SONAR.search(words) or words.rstrip().endswith("/Range")):
        return "sonar"
    if kind == "camera" and _DEPTH.search(words):
        return "depth_camera"
    return kind


class _Reader:
    """Reads the values of one sensor; missing and invalid values become changes."""

    def __init__(self, sensor: SensorTag, changes: Changes) -> None:
        self._sensor, self._changes = sensor, changes

    def mounts(self, kind: str) -> Iterator[tuple[str, MountData, RigidTransform]]:
        """Yield valid mounts with a name suffix and their pose in the sensor; none if the sensor is left out."""
        cameras = sorted({key.split(".")[0] for key in self._sensor.values if re.match(r"camera(\[\d+\])?\.", key)})
        # Two eyes make a stereo camera; any other number becomes separate cameras.
        if kind == "stereo_camera" and len(cameras) != 2:
            eyes = [(f"_{number}" if number else "", camera, "camera") for number, camera in enumerate(cameras)]
            eyes = eyes or [("", "camera", "camera")]
        else:
            eyes = [("", "camera", kind)]
        for suffix, camera, label in eyes:
            mount = self._fill(label, camera)
            X_SC = self._pose(camera) if label in ("camera", "depth_camera", "stereo_camera") else RigidTransform()
            if label == "stereo_camera" and mount is not None:
                # The mount of a stereo camera is midway between its eyes.
                left, right = X_SC, self._pose(cameras[1])
                across = left.inverse().multiply(right.translation())
                turn = left.rotation().InvertAndCompose(right.rotation()).ToAngleAxis().angle()
                if turn > _PARALLEL:
                    why = "the eyes of a stereo camera are parallel"
                    self._add_change("right eye", f"{degrees(turn):.3g} deg against the left one", "parallel", why)
                mount["baseline"] = float(np.linalg.norm(across)) or self._get("plugin.hackBaseline") or 0.0
                X_SC = RigidTransform(left.rotation(), 0.5 * (left.translation() + right.translation()))
            yield from self._checked(suffix, mount, X_SC)

    def _checked(
        self, suffix: str, mount: MountData | None, X_SC: RigidTransform
    ) -> Iterator[tuple[str, MountData, RigidTransform]]:
        """Yield the mount corrected to the schema; nothing if it cannot be corrected."""
        if mount is None:
            return
        kind = mount["kind"]
        defaults = _CAMERA if "camera" in kind else {}
        fitted, corrections, reason = fit_mount(mount, defaults)
        for item in corrections:
            self._add_change(item.key, item.old, item.new, item.reason)
        if fitted is None:
            part, was = f"sensor '{self._sensor.name}'", f"type {self._sensor.kind}"
            self._changes.add(Code.SENSOR, self._sensor.where, part, was, None, reason)
            return
        yield suffix, fitted, X_SC

    def _fill(self, kind: str, camera: str) -> MountData | None:
        mount: MountData = {"kind": kind, "rate": self._rate(kind)}
        if kind in ("camera", "stereo_camera"):
            return self._camera(mount, camera)
        if kind == "depth_camera":
            return self._depth(mount, camera)
        fill = {"lidar": self._lidar, "imu": self._imu, "gps": self._gps, "sonar": self._sonar}
        return fill[kind](mount)

    def _rate(self, kind: str) -> float:
        rate = self._sensor.rate
        if rate is not None and isfinite(rate) and 0.0 < rate <= 10_000.0:
            return rate
        was = "none" if rate is None else f"{rate:g} Hz"
        self._add_change("rate", was, f"{RATES[kind]:g} Hz", "allowed are rates above 0 and up to 10000 Hz")
        return RATES[kind]

    def _add_change(self, part: str, was: str, became: str, why: str) -> None:
        self._changes.add(Code.SENSOR, self._sensor.where, f"sensor '{self._sensor.name}': {part}", was, became, why)

    def _get(self, *keys: str) -> float | None:
        """Return the first of these values that is a number; the first number of a list."""
        for key in keys:
            text = self._sensor.values.get(key, "").replace(",", " ").split()
            if not text:
                continue
            try:
                value = float(text[0])
            except ValueError:
                value = float("nan")
            if not isnan(value):
                return value
            self._add_change(key, " ".join(text)[:40], "not used", "it should be a number")
        return None

    def _or(self, part: str, default: float, *keys: str) -> float:
        """Return the first of these values that is a number, or a default with a change."""
        value = self._get(*keys)
        if value is None:
            self._add_change(part, "none", f"{default:g}", "not in the source; Gazebo's default")
            return default
        return value

    def _pose(self, camera: str) -> RigidTransform:
        """Return the pose of a camera in its sensor; that of the sensor, with a change, if it is not possible."""
        text = self._sensor.values.get(f"{camera}.pose", "")
        if not text.strip():
            return RigidTransform()
        try:
            values = np.array([float(word) for word in text.split()])
        except ValueError:
            values = np.empty(0)
        # The comparison is false for NaN, too.
        if len(values) != 6 or not np.abs(values[:3]).max() <= REACH or not np.abs(values[3:]).max() <= _TURNS:
            why = f"a pose has six numbers, and a camera is at most {REACH:g} m from its sensor"
            self._add_change(f"{camera}.pose", " ".join(text.split())[:40], "that of the sensor", why)
            return RigidTransform()
        in_degrees = self._sensor.values.get(f"{camera}.pose.degrees") in ("1", "true")
        return make_pose(values[:3], np.radians(values[3:]) if in_degrees else values[3:])

    def _noise(self, mount: MountData, **keys: tuple[str, ...]) -> MountData:
        """Return the standard deviations of the source."""
        for key, paths in keys.items():
            value = self._get(*paths)
            if value:
                mount[key] = value
        return mount

    # --- kinds ---

    def _camera(self, mount: MountData, camera: str) -> MountData:
        for key in ("width", "height"):
            value = self._or(key, _CAMERA[key], f"{camera}.image.{key}", f"camera.image.{key}")
            mount[key] = _whole(value)
        fov = ("horizontal_fov", f"{camera}.horizontal_fov", "camera.horizontal_fov")
        mount["horizontal_fov"] = self._or(fov[0], _CAMERA["horizontal_fov"], *fov[1:])
        for key in ("near", "far"):
            mount[key] = self._or(key, _CAMERA[key], f"{camera}.clip.{key}", f"camera.clip.{key}")
        return self._noise(mount, noise=(f"{camera}.noise.stddev", "camera.noise.stddev"))

    def _depth(self, mount: MountData, camera: str) -> MountData:
        self._camera(mount, camera)
        for end, cutoff in (("near", "pointCloudCutoff"), ("far", "pointCloudCutoffMax")):
            paths = (f"{camera}.depth_camera.clip.{end}", f"plugin.{cutoff}")
            value = self._get(*paths)
            # Without a range of depths, that of the picture counts.
            mount[f"depth_{end}"] = value if value is not None and value > 0.0 else mount[end]
        if mount["depth_near"] <= 0.0:
            mount["depth_near"] = _CAMERA["near"]
        if mount["depth_far"] <= mount["depth_near"]:
            mount["depth_far"] = max(mount["depth_near"], mount["far"], _CAMERA["far"])
        return mount

    def _scan(self, path: str) -> float | None:
        return self._get(f"ray.{path}", f"lidar.{path}")

    def _lidar(self, mount: MountData) -> MountData | None:
        # Gazebo interpolates its samples to samples x resolution beams.
        columns = _whole(
            (self._scan("scan.horizontal.samples") or 0.0) * (self._scan("scan.horizontal.resolution") or 1.0)
        )
        rows = _whole((self._scan("scan.vertical.samples") or 1.0) * (self._scan("scan.vertical.resolution") or 1.0))
        start, end = self._scan("scan.horizontal.min_angle"), self._scan("scan.horizontal.max_angle")
        near, far = self._scan("range.min"), self._scan("range.max")
        if columns < 1 or start is None or end is None or near is None or far is None:
            texts = ("none" if value is None else f"{value:g}" for value in (start, end, near, far))
            was = "{} beams from {} to {} rad, {} to {} m".format(f"{columns:g}", *texts)
            why = "number of beams, angles or range are missing"
            self._changes.add(Code.SENSOR, self._sensor.where, f"sensor '{self._sensor.name}'", was, None, why)
            return None
        # A single beam has no angle between beams; its end must equal its start.
        single = columns == 1 and rows <= 1
        # Several rows make a lidar with a point cloud; one row makes a scanner, whose ranges are a list.
        if rows > 1:
            mount |= {"kind": "lidar", "columns": columns, "rows": rows, "horizontal_start": start}
            mount["horizontal_end"] = end
            mount["vertical_start"] = self._or("vertical start", -0.26, *_both("scan.vertical.min_angle"))
            mount["vertical_end"] = self._or("vertical end", 0.26, *_both("scan.vertical.max_angle"))
        else:
            kind = "laser_scanner"
            mount |= {"kind": kind, "beams": columns, "start_angle": start, "end_angle": start if single else end}
        mount |= {"near": near, "far": far}
        noise = (*_both("noise.stddev"), "plugin.gaussianNoise")
        return self._noise(mount, resolution=_both("range.resolution"), noise=noise)

    def _imu(self, mount: MountData) -> MountData:
        return self._noise(
            mount,
            gyro_noise=("imu.angular_velocity.x.noise.stddev", "imu.noise.rate.stddev", "plugin.rateGaussianNoise",
                        "rateGaussianNoise"),
            acceleration_noise=("imu.linear_acceleration.x.noise.stddev", "imu.noise.accel.stddev",
                                "plugin.accelGaussianNoise", "accelGaussianNoise"),
        )  # fmt: skip

    def _gps(self, mount: MountData) -> MountData:
        kinds = ("gps", "navsat")
        self._noise(
            mount,
            noise=(*(f"{kind}.position_sensing.horizontal.noise.stddev" for kind in kinds), "plugin.gaussianNoise",
                   "gaussianNoise"),
            vertical_noise=(*(f"{kind}.position_sensing.vertical.noise.stddev" for kind in kinds),),
            velocity_noise=(*(f"{kind}.velocity_sensing.horizontal.noise.stddev" for kind in kinds),
                            "plugin.velocityGaussianNoise", "velocityGaussianNoise"),
        )  # fmt: skip
        # Hector's GPS plugin has angles in degrees.
        datum = {
            key: value if key == "altitude" else radians(value)
            for key in ("latitude", "longitude", "altitude", "heading")
            if (value := self._get(f"reference{key.capitalize()}", f"plugin.reference{key.capitalize()}")) is not None
            and isfinite(value)
        }
        if datum:
            mount["datum"] = {"heading": 0.0, **datum}  # hector's x axis points north unless it has a heading
        return mount

    def _sonar(self, mount: MountData) -> MountData:
        near = self._get("sonar.min", "ray.range.min", "lidar.range.min", "plugin.min_range", "min_range")
        far = self._get("sonar.max", "ray.range.max", "lidar.range.max", "plugin.max_range", "max_range")
        mount |= {"near": 0.02 if near is None else near, "far": 4.0 if far is None else far}
        # The angle of the cone in the order of reliability: plugin, scan, radius at the far end.
        cone = self._get("plugin.fov", "fov")
        start, end = self._scan("scan.horizontal.min_angle"), self._scan("scan.horizontal.max_angle")
        if cone is None and start is not None and end is not None and abs(end - start) > 0.0:
            cone = abs(end - start)
        if cone is None:  # Gazebo's sonar is a cone with this radius at its far end
            radius = self._get("sonar.radius")
            cone = 2.0 * atan2(0.5 if radius is None else radius, min(mount["far"], FARTHEST))
        mount["cone"] = cone
        noise = (*_both("noise.stddev"), "plugin.gaussianNoise", "gaussianNoise")
        return self._noise(mount, resolution=_both("range.resolution"), noise=noise)


def _both(path: str) -> tuple[str, str]:
    """Return the path below each of the element names of Gazebo's lidar."""
    return f"ray.{path}", f"lidar.{path}"


def _whole(value: float) -> float:
    """Return the nearest integer of a count; infinity is unchanged."""
    return round(value) if isfinite(value) else inf if value > 0.0 else 0
