"""Sensors and ground truth of one time are of one place, although positions of the plant lead its velocities."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.framework import Context

from mirdrake.assembly.diagram import assemble
from mirdrake.assembly.diagram_spec import make_spec
from mirdrake.runs.simulation import Simulation
from mirdrake.sensors.cameras import rendering
from mirdrake.sensors.ground_truth import vehicle_state
from tests.ground_rigs import on_ground

WALL, STEP = 60.0, 0.01  # m, s

MOUNTS: dict[str, dict[str, Any]] = {
    "roof_lidar": {
        "preset": "sick_lms291", "rate": 50.0, "beams": 3, "start_angle": "-20 deg", "end_angle": "20 deg",
        "near": 0.1, "far": 100.0, "noise": 0.0, "resolution": 0.0, "rolling": False,
    },
    "sonar_front_left": {
        "preset": "kinect_v1", "rate": 50.0, "width": 9, "height": 9, "horizontal_fov": "5 deg", "near": 0.1,
        "depth_near": 0.1, "depth_far": 90.0, "depth_noise": {}, "inverse_depth_resolution": 0.0,
    },
    "encoder_rear_left": {"rate": 100.0, "counts": 1e6, "quadrature": True, "wrap": None},
}  # fmt: skip


@pytest.mark.parametrize("contact", ["tyre", "point"])
def test_sensors_agree_with_the_ground_truth(tmp_path: Path, contact: str) -> None:
    """Braking from 12 m/s towards a wall at steps of 10 ms, where bodies of the plant are 60 mm ahead of the truth.

    Scanner and depth camera: within 0.01 mm and 0.1 mm (single precision) of the distance from the true pose. Encoder:
    within a count of the recorded angle, and that within 1e-9 rad of the trapezoidal sum of the recorded rate.
    """
    cameras = rendering._egl_fault() is None
    names = ["roof_lidar", "encoder_rear_left", *(["sonar_front_left"] if cameras else [])]
    assembly = on_ground(
        tmp_path,
        world={"props": [{"box": [1.0, 40.0, 6.0], "at": [WALL + 0.5, 0.0]}]},
        contact=contact,
        step=STEP,
        rows=[(0.0, 12.0, 0.0), (0.5, 12.0, 0.0), (2.5, 11.0, 0.0)],
        vehicles={
            "ego": {
                "model": "mkz@handling",
                "start": {"x": 0.0, "y": 0.0, "yaw": 0.0},
                "speed": 12.0,
                "mounts": {name: MOUNTS[name] for name in names},
            }
        },
        sensors={"ego": names},
        record={"rate": 1.0 / STEP, "report": False, "meshcat": False, "cameras": cameras},
    )
    plant, part = assembly.parts.plant, assembly.parts.vehicles["ego"]
    systems = {system.get_name(): system for system in assembly.diagram.GetSystems()}
    rest = plant.CreateDefaultContext()
    errors: dict[str, list[float]] = {name: [] for name in names}

    def distance(state: Any, frame: str) -> float:
        """Return the distance from a frame of the car to the wall, ahead [m]."""
        X_BS = plant.GetFrameByName(frame, part.instance).CalcPose(rest, part.base.body_frame())
        X_WS = RigidTransform(RollPitchYaw(state[3:6]), state[:3]) @ X_BS
        return float((WALL - X_WS.translation()[0]) / X_WS.rotation().matrix()[0, 0])

    def look(context: Context) -> None:
        own = plant.GetMyContextFromRoot(context)
        q, v = plant.GetPositions(own), plant.GetVelocities(own)
        pose = q[part.base.floating_positions_start() :][:7]
        twist = v[part.base.floating_velocities_start_in_v() :][:6]
        state = vehicle_state(pose, twist, STEP)
        scanner = systems["ego.roof_lidar"]
        seen = scanner.measure(scanner.GetMyContextFromRoot(context))[1]
        errors["roof_lidar"].append(seen - distance(state, "roof_lidar"))
        if cameras and len(errors["roof_lidar"]) % 20 == 0:
            seen = systems["ego.sonar_front_left"].look(context)["depth"][4, 4]
            errors["sonar_front_left"].append(seen - distance(state, "sonar_front_left"))

    signals = Simulation(assembly).run(duration=2.0, monitor=look).signals
    assert np.abs(errors["roof_lidar"]).max() < 1e-5
    assert not cameras or np.abs(errors["sonar_front_left"]).max() < 1e-4

    angle, spin = signals["ego.wheel_angle.rear_left"].to_numpy(), signals["ego.wheel_speed.rear_left"].to_numpy()
    assert np.abs(np.diff(angle) - 0.5 * STEP * (spin[1:] + spin[:-1])).max() < 1e-9
    assert angle[0] == pytest.approx(0.0, abs=1e-12)
    counts = signals["ego.encoder_rear_left"].to_numpy()
    assert np.abs(counts[:-1] - angle[:-1] * 1e6 / (2.0 * np.pi)).max() <= 1.0


@pytest.mark.skipif(rendering._egl_fault() is not None, reason="EGL cannot be used")
@pytest.mark.parametrize("contact", ["tyre", "point"])
def test_pictures_show_other_bodies_where_they_are_in_the_ground_truth(contact: str) -> None:
    """A car drives off behind another one, which is 40 mm ahead of its true pose at 8 m/s and steps of 10 ms.

    The depths are those of a scene at rest whose vehicles have their true poses, within 0.1 mm (single precision).
    """
    start = {"x": 0.0, "y": 0.0, "yaw": 0.0}
    mounts = {"sonar_front_left": MOUNTS["sonar_front_left"]}
    diagram = {
        "world": "empty",
        "vehicles": {
            "ego": {"model": "mkz@handling", "start": start, "speed": 2.0, "mounts": mounts},
            "other": {"model": "mkz@handling", "start": start | {"x": 12.0}, "speed": 8.0},
        },
        "control": {"ego": {"kind": "constant", "speed": 6.0}, "other": {"kind": "constant", "speed": 8.0}},
        "sensors": {"ego": ["sonar_front_left"]},
        "plant": {"contact": contact, "time_step": STEP},
        "record": {"rate": 1.0 / STEP, "report": False, "meshcat": False, "cameras": True},
    }
    assembly = assemble(make_spec(diagram))
    plant, camera = assembly.parts.plant, assembly.diagram.GetSubsystemByName("ego.sonar_front_left")
    errors: list[float] = []

    def look(context: Context) -> None:
        if round(context.get_time() / STEP) % 20:
            return
        still = assembly.diagram.CreateDefaultContext()
        still.SetTimeStateAndParametersFrom(context)
        own = plant.GetMyMutableContextFromRoot(still)
        q, v = plant.GetPositions(own).copy(), plant.GetVelocities(own).copy()
        plant.SetVelocities(own, 0.0 * v)
        for part in assembly.parts.vehicles.values():
            twist = v[part.base.floating_velocities_start_in_v() :][:6]
            state = vehicle_state(q[part.base.floating_positions_start() :][:7], twist, STEP)
            X_WB = RigidTransform(RollPitchYaw(state[3:6]), state[:3])
            plant.SetFloatingBaseBodyPoseInWorldFrame(own, part.base, X_WB)
            for joint in part.suspension:
                travel = joint.get_translation(own) - 0.5 * STEP * v[joint.velocity_start()]
                joint.set_translation(own, travel)
        seen, true = (camera.look(one)["depth"] for one in (context, still))
        errors.append(float(np.abs(seen - true).max()))
        assert true[4, 4] < 15.0  # it is the tail of the other car

    Simulation(assembly).run(duration=0.6, monitor=look)
    assert len(errors) >= 3
    assert max(errors) < 1e-4
