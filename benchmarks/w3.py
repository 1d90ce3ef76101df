"""Job W3: a laser scanner and a lidar among 36 obstacles, against formulas and against MuJoCo's rays."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from math import pi, tau
from statistics import median
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.timing import installed

Array = NDArray[np.float64]

RATE = 10.0
HEIGHT, NEAR, FAR = 1.2, 0.2, 100.0
SIZES = {"360x1": (1, 360), "16x900": (16, 900)}
UPWARD = pi / 12.0  # of the highest and the lowest plane of 16
SPEED, TURN = 5.0, 0.4  # of the sensor in the moving case [m/s, rad/s]


@dataclass(frozen=True)
class Obstacle:
    """A box, or a cylinder if it has no yaw; its base is on the ground at x, y."""

    x: float
    y: float
    size: tuple[float, float, float]
    """of a box; radius, radius and height of a cylinder [m]"""
    yaw: float | None = None


def obstacles() -> list[Obstacle]:
    """Return the 24 boxes and 12 cylinders around the sensor at the origin."""
    generator = np.random.default_rng(3)
    shapes = []
    for index in range(36):
        angle, away = tau * index / 36.0, 5.0 + 25.0 * generator.random()
        x, y = away * np.cos(angle), away * np.sin(angle)
        if index % 3 == 2:
            radius = float(generator.uniform(0.2, 0.6))
            shapes.append(Obstacle(x, y, (radius, radius, float(generator.uniform(1.5, 3.0)))))
        else:
            sides = generator.uniform((0.5, 0.5, 1.5), (2.0, 2.0, 3.0))
            shapes.append(Obstacle(x, y, (sides[0], sides[1], sides[2]), float(generator.uniform(0.0, tau))))
    return shapes


def beams(rows: int, columns: int) -> Array:
    """Return directions (columns, rows, 3); rays are in the order in which the sensor has them."""
    azimuth = np.linspace(-pi, pi, columns)[:, None]
    elevation = np.linspace(-UPWARD, UPWARD, rows)[None, :] if rows > 1 else np.zeros((1, 1))
    parts = (np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation))
    return np.stack(np.broadcast_arrays(*parts), axis=-1)


def analytic(directions: Array, *, start: Array | None = None) -> Array:
    """Distances (n) [m] of rays (n, 3) from a point, by the formulas of slab, cylinder and plane; inf without a hit.

    It is independent of the measurements and serves as their reference.
    """
    o = np.array([0.0, 0.0, HEIGHT]) if start is None else start
    nearest = np.full(len(directions), np.inf)
    with np.errstate(divide="ignore", invalid="ignore"):
        ground = np.where(directions[:, 2] < 0.0, -o[2] / directions[:, 2], np.inf)
        nearest = np.minimum(nearest, ground)
        for obstacle in obstacles():
            local = o - (obstacle.x, obstacle.y, 0.5 * obstacle.size[2])
            if obstacle.yaw is not None:
                c, s = np.cos(obstacle.yaw), np.sin(obstacle.yaw)
                R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
                p, d, half = local @ R, directions @ R, 0.5 * np.array(obstacle.size)
                low, high = np.sort(np.stack(((-half - p) / d, (half - p) / d)), axis=0)
                enter, leave = low.max(axis=1), high.min(axis=1)
            else:
                radius, _, height = obstacle.size
                a = directions[:, 0] ** 2 + directions[:, 1] ** 2
                b = directions[:, 0] * local[0] + directions[:, 1] * local[1]
                root = np.sqrt(b * b - a * (local[0] ** 2 + local[1] ** 2 - radius**2))
                ends = np.sort(
                    np.stack([(side * 0.5 * height - local[2]) / directions[:, 2] for side in (-1.0, 1.0)]), axis=0
                )
                enter, leave = np.maximum((-b - root) / a, ends[0]), np.minimum((-b + root) / a, ends[1])
            hit = (enter <= leave) & (enter > 0.0)
            nearest = np.where(hit & (enter < nearest), enter, nearest)
    return np.where(nearest <= FAR, nearest, np.inf)


def run_w3(*, scans: int = 200) -> dict[str, Any]:
    """Return the time of a scan at rest, moving and with noise, the worst error, and MuJoCo beside it [ms, mm].

    Args:
        scans: of each kind; the median counts.
    """
    result: dict[str, Any] = {}
    for name, (rows, columns) in SIZES.items():
        directions = beams(rows, columns).reshape(-1, 3)
        truth = analytic(directions)
        rest, moving, noisy, distance = _ours(rows, columns, scans)
        entry: dict[str, Any] = {
            "ms_per_scan": rest,
            "ms_per_scan_moving": moving,
            "ms_per_scan_noise": noisy,
            **_errors(distance, truth),
        }
        if installed("mujoco"):
            entry["mujoco"] = _mujoco(directions, truth, scans)
        result[name] = entry
    return result


def _errors(distance: Array, truth: Array) -> dict[str, float]:
    """Return the worst error [mm] of rays that hit in both, and how many hit in one of them only."""
    both = np.isfinite(distance) & np.isfinite(truth)
    return {
        "worst_error_mm": 1e3 * float(np.abs(distance - truth)[both].max()),
        "beyond_1_mm": int((np.abs(distance - truth)[both] > 1e-3).sum()),
        "rays_that_differ": int((np.isfinite(distance) != np.isfinite(truth)).sum()),
        "rays_that_hit": int(np.isfinite(truth).sum()),
    }


def _clock(call: Callable[[], object], count: int) -> float:
    """Return the median time of a call [ms]."""
    times = []
    for _ in range(count):
        began = time.perf_counter()
        call()
        times.append(time.perf_counter() - began)
    return 1e3 * median(times)


def _ours(rows: int, columns: int, scans: int) -> tuple[float, float, float, Array]:
    """Return the median times [ms] of a scan at rest, moving and with noise, and the distances at rest (n) [m].

    A scan is all that the sensor does at a sample: poses from the plant, rays, readings.
    """
    rest, distance = _sensor(rows, columns, scans)
    moving, _ = _sensor(rows, columns, scans, moving=True)
    noisy, _ = _sensor(rows, columns, scans, noise=0.02)
    return rest, moving, noisy, distance


def _sensor(rows: int, columns: int, scans: int, *, moving: bool = False, noise: float = 0.0) -> tuple[float, Array]:
    from pydrake.math import RigidTransform
    from pydrake.multibody.math import SpatialVelocity
    from pydrake.multibody.plant import AddMultibodyPlant, MultibodyPlantConfig
    from pydrake.multibody.tree import SpatialInertia
    from pydrake.systems.framework import DiagramBuilder

    from mirdrake.sensors.ranging.laser_scanner import LaserScanner, LaserScannerMount
    from mirdrake.sensors.ranging.lidar import Lidar, LidarMount
    from mirdrake.sensors.ranging.world import RayWorld

    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlant(MultibodyPlantConfig(time_step=0.005), builder)
    _put_obstacles(plant)
    carrier = plant.AddRigidBody("carrier", SpatialInertia.SolidBoxWithMass(1.0, 1.0, 1.0, 1.0))
    plant.Finalize()
    world = RayWorld(plant, scene_graph)
    common: dict[str, Any] = {"frame": "carrier", "rate": RATE, "near": NEAR, "far": FAR, "noise": noise}
    sensor: Any
    if rows == 1:
        flat = LaserScannerMount(kind="laser_scanner", beams=columns, start_angle=-pi, end_angle=pi, **common)
        sensor = LaserScanner(world, carrier.body_frame(), flat)
    else:
        deep = LidarMount(
            kind="lidar",
            columns=columns,
            rows=rows,
            horizontal_start=-pi,
            horizontal_end=pi,
            vertical_start=-UPWARD,
            vertical_end=UPWARD,
            **common,
        )
        sensor = Lidar(world, carrier.body_frame(), deep)
    builder.AddSystem(sensor)
    for name in ("body_poses", "body_spatial_velocities"):
        builder.Connect(plant.GetOutputPort(name), sensor.GetInputPort(name))
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    mine = plant.GetMyMutableContextFromRoot(context)
    plant.SetFloatingBaseBodyPoseInWorldFrame(mine, carrier, RigidTransform([0.0, 0.0, HEIGHT]))
    if moving:
        plant.SetFreeBodySpatialVelocity(
            context=mine, body=carrier, V_JpJc=SpatialVelocity([0.0, 0.0, TURN], [SPEED, 0.0, 0.0])
        )
    own = sensor.GetMyContextFromRoot(context)

    def scan() -> Array:
        if rows == 1:
            return np.asarray(sensor.measure(own))
        return np.asarray(sensor.look(own).ranges).T.ravel().astype(float)

    distance = scan()
    return _clock(scan, scans), distance


def _put_obstacles(plant: Any) -> None:
    from pydrake.geometry import Box, Cylinder
    from pydrake.math import RigidTransform, RollPitchYaw

    for index, obstacle in enumerate(obstacles()):
        X_WG = RigidTransform(
            RollPitchYaw(0.0, 0.0, obstacle.yaw or 0.0), [obstacle.x, obstacle.y, 0.5 * obstacle.size[2]]
        )
        shape = Cylinder(obstacle.size[0], obstacle.size[2]) if obstacle.yaw is None else Box(*obstacle.size)
        plant.RegisterVisualGeometry(plant.world_body(), X_WG, shape, f"prop/{index}", np.array([0.5, 0.5, 0.5, 1.0]))


def _mujoco(directions: Array, truth: Array, scans: int) -> dict[str, float]:
    """Return the distances of the same rays by mj_multiRay, whose directions are in the world frame."""
    import mujoco

    geoms = "".join(_mujoco_geom(obstacle) for obstacle in obstacles())
    xml = f'<mujoco><worldbody><geom type="plane" size="200 200 1"/>{geoms}</worldbody></mujoco>'
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    count = len(directions)
    start, rays = np.array([0.0, 0.0, HEIGHT]), np.ascontiguousarray(directions).ravel()
    geom, distance = np.zeros(count, dtype=np.int32), np.zeros(count)

    def cast() -> None:
        mujoco.mj_multiRay(model, data, start, rays, None, 1, -1, geom, distance, None, count, FAR)

    cast()
    ranges = np.where((distance >= 0.0) & (distance <= FAR), distance, np.inf)
    return {"ms_per_scan": _clock(cast, scans), **_errors(ranges, truth)}


def _mujoco_geom(obstacle: Obstacle) -> str:
    position = f'pos="{obstacle.x} {obstacle.y} {0.5 * obstacle.size[2]}"'
    if obstacle.yaw is None:
        return f'<geom type="cylinder" size="{obstacle.size[0]} {0.5 * obstacle.size[2]}" {position}/>'
    half = " ".join(str(0.5 * side) for side in obstacle.size)
    turn = f"{np.cos(0.5 * obstacle.yaw)} 0 0 {np.sin(0.5 * obstacle.yaw)}"
    return f'<geom type="box" size="{half}" {position} quat="{turn}"/>'
