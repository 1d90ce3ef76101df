"""The same jobs in MuJoCo and PyBullet, with models written from the numbers of the job."""

import logging
import tempfile
from collections.abc import Callable
from functools import partial
from math import atan2, cos, pi, sin, tan
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.job import SETTLING, SPEED, STEADY, STEERING, WHEELBASE, circle_figures
from benchmarks.timing import rates, timed

TRACK, RADIUS, WIDTH, FRICTION = 1.5, 0.32, 0.2, 0.9
CHASSIS, KNUCKLE, WHEEL = 1535.0, 5.0, 20.0
COM_X, COM_Z, BOX = WHEELBASE / 2.0, 0.55, (4.0, 1.6, 0.9)
SERVO_STIFFNESS, SERVO_DAMPING, WHEEL_GAIN = 20000.0, 400.0, 850.0
KP, KI = 0.5, 0.5
GRAVITY = 9.81
CONTROL = 0.02

WHEEL_INERTIA = (
    WHEEL * (3 * RADIUS**2 + WIDTH**2) / 12,
    WHEEL * RADIUS**2 / 2,
    WHEEL * (3 * RADIUS**2 + WIDTH**2) / 12,
)
CHASSIS_INERTIA = tuple(CHASSIS * (a * a + b * b) / 12 for a, b in ((BOX[1], BOX[2]), (BOX[0], BOX[2]), BOX[:2]))
CORNERS = (("fl", WHEELBASE, TRACK / 2), ("fr", WHEELBASE, -TRACK / 2), ("rl", 0.0, TRACK / 2), ("rr", 0.0, -TRACK / 2))


class Command(NamedTuple):
    """Command of the joints: angles of the steering joints [rad], spin rates of the rear wheels [rad/s]."""

    left: float
    right: float
    rear_left: float
    rear_right: float


class Driver:
    """The schedule of W1, Ackermann angles and speeds, and the PI speed loop; the same law as mirdrake's.

    Args:
        period: time between calls [s].
        kp: proportional gain of the speed loop.
        parked: wants to stand still.
    """

    def __init__(self, *, period: float = CONTROL, kp: float = KP, parked: bool = False) -> None:
        self._period, self._kp, self._parked, self._integral = period, kp, parked, 0.0

    def command(self, time: float, speed: float) -> Command:
        """Return the command at a time [s], from the speed of the rear axle's centre [m/s]."""
        if self._parked:
            return Command(0.0, 0.0, 0.0, 0.0)
        speed_setpoint, t = min(time, SPEED), tan(STEERING * min(max(time - 5.0, 0.0), 1.0))
        error = speed_setpoint - speed
        self._integral += KI * error * self._period
        spin, half = (speed_setpoint + self._kp * error + self._integral) / RADIUS, 0.5 * t * TRACK / WHEELBASE
        left, right = (atan2(t, 1.0 - half), atan2(t, 1.0 + half))
        return Command(left, right, spin * (1.0 - half), spin * (1.0 + half))


def write_mjcf(*, wheels: str, step: float, slope: float = 0.0, held: bool = False) -> str:
    """Return the car and the road for MuJoCo.

    Args:
        wheels: "cylinder" or "sphere".
        step: [s].
        slope: of the road, uphill ahead [rad]; gravity is tilted.
        held: lock the wheels.
    """
    size = f"{RADIUS} {WIDTH / 2}" if wheels == "cylinder" else f"{RADIUS}"

    def wheel(name: str, x: float, y: float, z: float) -> str:
        return (
            f'<body name="{name}" pos="{x} {y} {z}"><joint name="{name}" axis="0 1 0"/>'
            f'<inertial pos="0 0 0" mass="{WHEEL}" diaginertia="{" ".join(map(str, WHEEL_INERTIA))}"/>'
            f'<geom type="{wheels}" size="{size}" euler="90 0 0" friction="{FRICTION} 0 0" '
            'contype="1" conaffinity="2"/></body>'
        )

    bodies = ""
    for name, x, y in CORNERS:
        if name.startswith("r"):
            bodies += wheel(name, x, y, RADIUS)
            continue
        bodies += (
            f'<body name="{name}_knuckle" pos="{x} {y} {RADIUS}"><joint name="{name}_steer" axis="0 0 1"/>'
            f'<inertial pos="0 0 0" mass="{KNUCKLE}" diaginertia="0.05 0.05 0.05"/>{wheel(name, 0.0, 0.0, 0.0)}</body>'
        )
    locks = "".join(f'<joint joint1="{name}" polycoef="0 0 0 0 0"/>' for name, _, _ in CORNERS) if held else ""
    return f"""<mujoco><compiler angle="degree" autolimits="true"/>
<option timestep="{step}" gravity="{-GRAVITY * sin(slope)} 0 {-GRAVITY * cos(slope)}" integrator="implicitfast"/>
<worldbody><geom type="plane" size="0 0 1" friction="{FRICTION} 0 0" contype="2" conaffinity="1"/>
<body name="car"><freejoint/>
<inertial pos="{COM_X} 0 {COM_Z}" mass="{CHASSIS}" diaginertia="{" ".join(map(str, CHASSIS_INERTIA))}"/>
{bodies}</body></worldbody>
<actuator>
<position joint="fl_steer" kp="{SERVO_STIFFNESS}" kv="{SERVO_DAMPING}"/>
<position joint="fr_steer" kp="{SERVO_STIFFNESS}" kv="{SERVO_DAMPING}"/>
<velocity joint="rl" kv="{WHEEL_GAIN}"/><velocity joint="rr" kv="{WHEEL_GAIN}"/></actuator>
<equality>{locks}</equality></mujoco>"""


class MujocoCar:
    """The car in MuJoCo, reused for several runs.

    Args:
        wheels: "cylinder" or "sphere".
        step: [s].
        slope: of the road [rad].
        held: lock the wheels.
    """

    def __init__(self, *, wheels: str, step: float = 0.002, slope: float = 0.0, held: bool = False) -> None:
        import mujoco

        self._mujoco = mujoco
        self._model = mujoco.MjModel.from_xml_string(write_mjcf(wheels=wheels, step=step, slope=slope, held=held))
        self._steps = round(CONTROL / step)

    def run(self, duration: float, driver: Driver) -> np.ndarray[Any, np.dtype[np.float64]]:
        """Drive; samples at the control rate: time, x, y, yaw, speed ahead, yaw rate (n x 6)."""
        mujoco, model = self._mujoco, self._model
        data, rows = mujoco.MjData(model), []
        qpos, qvel, ctrl = data.qpos, data.qvel, data.ctrl
        for tick in range(round(duration / CONTROL)):
            w, i, j, k = qpos[3:7].tolist()
            yaw = atan2(2.0 * (i * j + w * k), 1.0 - 2.0 * (j * j + k * k))
            speed = float(qvel[0]) * cos(yaw) + float(qvel[1]) * sin(yaw)
            rows.append((tick * CONTROL, float(qpos[0]), float(qpos[1]), yaw, speed, float(qvel[5])))
            ctrl[:] = driver.command(tick * CONTROL, speed)
            mujoco.mj_step(model, data, self._steps)
        return np.array(rows)


def write_urdf() -> str:
    """Return the car for PyBullet; the origin of a URDF's base in PyBullet is its centre of mass."""

    def inertia(values: tuple[float, ...]) -> str:
        return f'<inertia ixx="{values[0]}" iyy="{values[1]}" izz="{values[2]}" ixy="0" ixz="0" iyz="0"/>'

    text = f'<link name="car"><inertial><mass value="{CHASSIS}"/>{inertia(CHASSIS_INERTIA)}</inertial></link>'
    for name, x, y in CORNERS:
        parent, position = "car", f"{x - COM_X} {y} {RADIUS - COM_Z}"
        if name.startswith("f"):
            text += (
                f'<link name="{name}_knuckle"><inertial><mass value="{KNUCKLE}"/>{inertia((0.05, 0.05, 0.05))}'
                f'</inertial></link><joint name="{name}_steer" type="revolute"><origin xyz="{position}"/>'
                f'<parent link="car"/><child link="{name}_knuckle"/>'
                '<axis xyz="0 0 1"/><limit lower="-0.6" upper="0.6" effort="20000" velocity="10"/></joint>'
            )
            parent, position = f"{name}_knuckle", "0 0 0"
        text += (
            f'<link name="{name}"><inertial><mass value="{WHEEL}"/>{inertia(WHEEL_INERTIA)}</inertial>'
            f'<collision><origin rpy="{pi / 2} 0 0"/><geometry><cylinder radius="{RADIUS}" length="{WIDTH}"/>'
            f'</geometry></collision></link><joint name="{name}_joint" type="continuous"><origin xyz="{position}"/>'
            f'<parent link="{parent}"/><child link="{name}"/>'
            '<axis xyz="0 1 0"/></joint>'
        )
    return f'<?xml version="1.0"?><robot name="car">{text}</robot>'


class BulletCar:
    """The car in PyBullet at its default step of 1/240 s; control every fifth step.

    Args:
        slope: of the road [rad].
        held: lock the wheels.
    """

    def __init__(self, *, slope: float = 0.0, held: bool = False) -> None:
        import pybullet
        from pybullet_utils.bullet_client import BulletClient

        self._pb, self._slope, self._held = pybullet, slope, held
        self._client = BulletClient(pybullet.DIRECT)
        with tempfile.TemporaryDirectory() as folder:
            self._urdf = Path(folder) / "car.urdf"
            self._urdf.write_text(write_urdf())
            self._load()

    def _load(self) -> None:
        client, pb = self._client, self._pb
        client.setGravity(-GRAVITY * sin(self._slope), 0.0, -GRAVITY * cos(self._slope))
        ground = client.createMultiBody(0.0, client.createCollisionShape(pb.GEOM_PLANE))
        client.changeDynamics(ground, -1, lateralFriction=1.0)
        self._car = client.loadURDF(str(self._urdf), [COM_X, 0.0, COM_Z], flags=pb.URDF_USE_INERTIA_FROM_FILE)
        count = client.getNumJoints(self._car)
        joints = {client.getJointInfo(self._car, i)[1].decode(): i for i in range(count)}
        self._steering = [joints["fl_steer"], joints["fr_steer"]]
        self._wheels = [joints[f"{name}_joint"] for name, _, _ in CORNERS]
        for wheel in self._wheels:
            client.changeDynamics(self._car, wheel, lateralFriction=FRICTION)
        for link in range(-1, count):
            client.changeDynamics(self._car, link, linearDamping=0.0, angularDamping=0.0)
        for joint in self._wheels[:2]:
            force = 1e5 if self._held else 0.0
            client.setJointMotorControl2(self._car, joint, pb.VELOCITY_CONTROL, targetVelocity=0.0, force=force)
        self._start = client.saveState()

    def run(self, duration: float, driver: Driver) -> np.ndarray[Any, np.dtype[np.float64]]:
        """Drive; samples as :meth:`MujocoCar.run`."""
        client, pb, car, rows = self._client, self._pb, self._car, []
        client.restoreState(self._start)
        period = 5.0 / 240.0
        for tick in range(round(duration / period)):
            (x, y, _), (i, j, k, w) = client.getBasePositionAndOrientation(car)
            (vx, vy, _), (_, _, wz) = client.getBaseVelocity(car)
            yaw = atan2(2.0 * (i * j + w * k), 1.0 - 2.0 * (j * j + k * k))
            speed = vx * cos(yaw) + vy * sin(yaw)
            rows.append((tick * period, x - COM_X * cos(yaw), y - COM_X * sin(yaw), yaw, speed, wz))
            command = driver.command(tick * period, speed)
            client.setJointMotorControlArray(
                car, self._steering, pb.POSITION_CONTROL, targetPositions=command[:2], forces=[20000.0] * 2
            )
            client.setJointMotorControlArray(
                car, self._wheels[2:], pb.VELOCITY_CONTROL, targetVelocities=command[2:], forces=[1e5] * 2
            )
            for _ in range(5):
                client.stepSimulation()
        return np.array(rows)

    def close(self) -> None:
        """End the physics server."""
        self._client.disconnect()


def peers() -> dict[str, tuple[Callable[..., Any], float, float]]:
    """Return the installed peers: name -> (factory of the car, step [s], control period [s])."""
    peers_found: dict[str, tuple[Callable[..., Any], float, float]] = {}
    try:
        import mujoco  # noqa: F401
    except ImportError:
        logging.getLogger(__name__).info("mujoco is not installed")
    else:
        peers_found["mujoco_sphere"] = (lambda **more: MujocoCar(wheels="sphere", **more), 0.002, CONTROL)
        peers_found["mujoco_cylinder"] = (lambda **more: MujocoCar(wheels="cylinder", **more), 0.002, CONTROL)
    try:
        import pybullet  # noqa: F401
    except ImportError:
        logging.getLogger(__name__).info("pybullet is not installed")
    else:
        peers_found["pybullet"] = (BulletCar, 1.0 / 240.0, 5.0 / 240.0)
    return peers_found


def _drive(car: Any, duration: float, period: float) -> None:
    car.run(duration, Driver(period=period))


def run_peers(*, duration: float, parked: float, repeat: int) -> dict[str, Any]:
    """Job W1 of every peer that is installed."""
    results = {}
    for name, (make, step, period) in peers().items():
        car = make()
        samples = car.run(duration, Driver(period=period))
        drive = partial(_drive, car, duration, period)
        times = [timed(drive) for _ in range(repeat)]
        steady = samples[samples[:, 0] > max(duration - STEADY, 0.0)]
        result = {"step_ms": 1e3 * step, **rates(times, duration=duration, step=step)}
        result |= circle_figures(steady[:, 4], steady[:, 5])
        for case, slope in (("flat", 0.0), ("slope", 5.0 * pi / 180.0)):
            still = make(slope=slope, held=slope > 0.0).run(SETTLING + parked, Driver(period=period, parked=True))
            still = still[still[:, 0] >= SETTLING - 1e-6]
            result[f"creep_{case}_mm"] = 1e3 * float(np.hypot(*(still[-1, 1:3] - still[0, 1:3])))
            result[f"yaw_drift_{case}_mrad"] = 1e3 * float(still[-1, 3] - still[0, 3])
        results[name] = result
    return results
