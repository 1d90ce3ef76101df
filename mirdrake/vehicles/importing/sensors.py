"""Gazebo's sensors as mounts of sensors.yaml."""

from collections.abc import Mapping
from math import isfinite

from pydrake.math import RigidTransform

from mirdrake.vehicles.importing.car import Frame
from mirdrake.vehicles.importing.model import Change, SensorTag, SourceModel
from mirdrake.vehicles.importing.names import Names

Mount = dict[str, object]

RATES = {
    "camera": 30.0,
    "depth_camera": 30.0,
    "laser_scanner": 40.0,
    "lidar": 10.0,
    "imu": 100.0,
    "gps": 10.0,
    "sonar": 10.0,
}
"""Where a sensor has no rate, or zero, which means "in every step" [Hz]."""

_KINDS = {
    "camera": "camera", "wideanglecamera": "camera", "wide_angle_camera": "camera", "multicamera": "camera",
    "depth": "depth_camera", "depth_camera": "depth_camera", "rgbd": "depth_camera", "rgbd_camera": "depth_camera",
    "ray": "lidar", "gpu_ray": "lidar", "lidar": "lidar", "gpu_lidar": "lidar",
    "imu": "imu", "gps": "gps", "navsat": "gps", "sonar": "sonar",
}  # fmt: skip


def make_mounts(
    model: SourceModel, places: Mapping[str, tuple[str, RigidTransform]], names: Names
) -> tuple[dict[str, Mount], list[Frame], list[Change]]:
    """Mounts, the frames they sit in, and what has no counterpart.

    Args:
        model: as read.
        places: link of the source -> link of the car that carries it, and its pose in there.
        names: of links that are taken, and new ones.
    """
    mounts: dict[str, Mount] = {}
    frames: list[Frame] = []
    changes: list[Change] = []
    taken: set[str] = set()
    for sensor in model.sensors:
        what, was = f"sensor '{sensor.name}'", f"type {sensor.kind}"
        kind = _KINDS.get(sensor.kind)
        if kind is None or sensor.link not in places:
            why = (
                "no sensor of mirdrake corresponds to it" if kind is None else f"its link '{sensor.link}' is not there"
            )
            changes.append(Change(sensor.where, what, was, "left out", why))
            continue
        mount = _Reader(sensor, changes).mount(kind)
        if mount is None:
            continue
        parent, X_PL = places[sensor.link]
        frame = names.new(f"{sensor.name}_mount")
        frames.append(Frame(frame, names.new_joint(f"{frame}_joint"), parent, X_PL.multiply(sensor.X_LS)))
        name = names.unique(sensor.name, taken)
        mounts[name] = {"kind": mount.pop("kind"), "frame": frame, **mount}
    return mounts, frames, changes


class _Reader:
    """One sensor's values, with a change for what is missing or impossible."""

    def __init__(self, sensor: SensorTag, changes: list[Change]) -> None:
        self._sensor, self._changes = sensor, changes

    def mount(self, kind: str) -> Mount | None:
        """The mount; None if the sensor makes no sense."""
        rate = self._sensor.rate
        if rate is None or not isfinite(rate) or not 0.0 < rate <= 10_000:
            default = RATES[kind]
            self._say("rate", "none" if rate is None else f"{rate:g} Hz", f"{default:g} Hz", "every sensor has a rate")
            rate = default
        if kind == "lidar":
            return self._lidar(rate)
        fill = {
            "camera": self._camera,
            "depth_camera": self._depth,
            "imu": self._imu,
            "gps": self._gps,
            "sonar": self._sonar,
        }
        return fill[kind]({"kind": kind, "rate": rate})

    def _say(self, part: str, was: str, became: str, why: str) -> None:
        self._changes.append(Change(self._sensor.where, f"sensor '{self._sensor.name}': {part}", was, became, why))

    def _get(self, *keys: str) -> float | None:
        for key in keys:
            try:
                value = float(self._sensor.values[key])
            except (KeyError, ValueError):
                continue
            if isfinite(value):
                return value
        return None

    def _within(self, part: str, value: float | None, low: float, high: float, default: float) -> float:
        """The value if it is allowed, else the default, and said."""
        if value is not None and low <= value <= high:
            return value
        was = "none" if value is None else f"{value:g}"
        self._say(part, was, f"{default:g}", f"{low:g} to {high:g} are allowed" if value is not None else "not said")
        return default

    def _camera(self, mount: Mount) -> Mount:
        mount["width"] = int(self._within("width", self._get("camera.image.width"), 1, 8192, 800))
        mount["height"] = int(self._within("height", self._get("camera.image.height"), 1, 8192, 600))
        fov = self._get("camera.horizontal_fov")
        mount["horizontal_fov"] = self._within("horizontal_fov", fov, 0.01, 3.1, 1.047)
        mount["near"] = self._within("near", self._get("camera.clip.near"), 1e-3, 100.0, 0.1)
        mount["far"] = self._within("far", self._get("camera.clip.far"), 1e-2, 1e5, 100.0)
        noise = self._get("camera.noise.stddev") or 0.0
        if noise > 0.0:
            mount["noise"] = noise
        return mount

    def _depth(self, mount: Mount) -> Mount:
        self._camera(mount)
        near, far = self._get("camera.depth_camera.clip.near"), self._get("camera.depth_camera.clip.far")
        mount["depth_near"] = near if near and near > 0.0 else mount["near"]
        mount["depth_far"] = far if far and far > 0.0 else mount["far"]
        return mount

    def _lidar(self, rate: float) -> Mount | None:
        def get(path: str) -> float | None:
            return self._get(f"ray.{path}", f"lidar.{path}")

        columns, rows = int(get("scan.horizontal.samples") or 0), int(get("scan.vertical.samples") or 1)
        columns = round(columns * (get("scan.horizontal.resolution") or 1.0))
        start, end = get("scan.horizontal.min_angle"), get("scan.horizontal.max_angle")
        near, far = get("range.min"), get("range.max")
        if columns < 1 or start is None or end is None or near is None or far is None or not 0.0 < near < far:
            was = f"{columns} beams, {near} to {far} m"
            self._changes.append(
                Change(
                    self._sensor.where, f"sensor '{self._sensor.name}'", was, "left out", "beams or range are missing"
                )
            )
            return None
        single = columns == 1 and rows == 1
        mount: Mount = {"kind": "lidar" if rows > 1 else "laser_scanner", "rate": rate}
        if rows > 1:
            mount |= {"columns": columns, "rows": rows, "horizontal_start": start, "horizontal_end": end}
            mount["vertical_start"] = self._within("vertical start", get("scan.vertical.min_angle"), -1.6, 1.6, -0.26)
            mount["vertical_end"] = self._within("vertical end", get("scan.vertical.max_angle"), -1.6, 1.6, 0.26)
        else:
            mount |= {"beams": columns, "start_angle": start, "end_angle": start if single else end}
        mount |= {"near": near, "far": far}
        for key, value in (("resolution", get("range.resolution")), ("noise", get("noise.stddev"))):
            if value is not None and value > 0.0:
                mount[key] = value
        return mount

    def _imu(self, mount: Mount) -> Mount:
        gyro = self._get("imu.angular_velocity.x.noise.stddev", "imu.noise.rate.stddev")
        acceleration = self._get("imu.linear_acceleration.x.noise.stddev", "imu.noise.accel.stddev")
        for key, value in (("gyro_noise", gyro), ("acceleration_noise", acceleration)):
            if value is not None and value >= 0.0:
                mount[key] = value
        return mount

    def _gps(self, mount: Mount) -> Mount:
        kinds = ("gps", "navsat")
        noise = self._get(*(f"{kind}.position_sensing.horizontal.noise.stddev" for kind in kinds))
        if noise is not None and noise >= 0.0:
            mount["noise"] = noise
        return mount

    def _sonar(self, mount: Mount) -> Mount:
        near, far = self._get("sonar.min") or 0.02, self._get("sonar.max") or 4.0
        radius = self._get("sonar.radius") or 0.5
        cone = min(2.0 * radius / far, 3.0)  # Gazebo's sonar is a cone with this radius at its far end
        return mount | {"cone": cone, "near": max(near, 1e-3), "far": max(far, 2e-3)}
