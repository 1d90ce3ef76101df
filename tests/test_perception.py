"""The distance to the object ahead, and point clouds in Meshcat."""

from typing import Any

import numpy as np
import pytest
from pydrake.geometry import Box, Meshcat
from pydrake.math import RigidTransform
from pydrake.systems.framework import DiagramBuilder

from mirdrake.assembly.diagram import assemble
from mirdrake.core.errors import ConfigError
from mirdrake.sensors.perception import DistanceEstimator, add_cloud_overlays, nearest_return, show_points
from mirdrake.sensors.ranging.laser_scanner import LaserScanner
from mirdrake.sensors.ranging.lidar import Lidar
from mirdrake.viewer.private_meshcat import make_private_meshcat
from tests.ranging_rigs import ABOVE, Room, lidar, scanner
from tests.sensor_rigs import held


@pytest.fixture
def meshcat() -> Meshcat:
    return make_private_meshcat()[0]


def test_the_nearest_return_of_the_sector_counts() -> None:
    angles = [-0.3, -0.1, 0.0, 0.1, 0.3]
    assert nearest_return([1.0, 5.0, 4.0, np.inf, 2.0], angles) == (4.0, 0.0)
    assert nearest_return([1.0, 3.0, 4.0, np.inf, 2.0], angles) == (3.0, -0.1)
    assert nearest_return([1.0, np.inf, np.inf, np.inf, 2.0], angles) == (np.inf, 0.0)
    assert nearest_return([1.0, 5.0, 4.0, 6.0, 2.0], angles, low=0.2, high=1.0) == (2.0, 0.3)


def _follow(room: Room, **more: Any) -> tuple[Any, Any, DistanceEstimator]:
    mount = scanner(beams=361, rolling=False, rate=20.0)
    sensor = LaserScanner(room.world(), room.carrier.body_frame(), mount)
    estimator = DistanceEstimator(beams=361, start_angle=mount.start_angle, end_angle=mount.end_angle, **more)
    room.builder.AddSystem(estimator)
    room.builder.AddSystem(sensor)
    for name in ("body_poses", "body_spatial_velocities"):
        room.builder.Connect(room.plant.GetOutputPort(name), sensor.GetInputPort(name))
    room.builder.Connect(sensor.sample, estimator.ranges)
    room.builder.Connect(sensor.stamp, estimator.stamp)
    return room.start(), sensor, estimator


def test_distance_angle_and_speed_of_a_car_ahead() -> None:
    room = Room()
    room.starts[0] = (room.carrier, ABOVE, (10.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    room.body("lead", Box(2.0, 2.0, 2.0), X_WB=RigidTransform([31.0, 0.0, 1.0]), velocity=(7.0, 0.0, 0.0))
    room.put(Box(1.0, 1.0, 5.0), RigidTransform([8.0, 4.0, 1.0]))  # beside the sector
    simulator, _, estimator = _follow(room)
    assert held(estimator, simulator, "nearest").tolist() == [np.inf, 0.0, 0.0]
    simulator.AdvanceTo(0.03)
    assert held(estimator, simulator, "nearest") == pytest.approx([30.0, 0.0, 0.0], abs=1e-6)
    for k in range(1, 6):
        simulator.AdvanceTo(0.05 * k + 0.03)
        assert held(estimator, simulator, "nearest") == pytest.approx([30.0 - 0.15 * k, 0.0, -3.0], abs=1e-6)


def test_a_thing_that_comes_into_view_has_no_speed_at_first() -> None:
    room = Room()
    room.put(Box(1.0, 200.0, 9.0), RigidTransform([40.5, 0.0, 0.0]))
    room.body("crossing", Box(0.02, 2.0, 2.0), X_WB=RigidTransform([10.01, -4.1, 1.0]), velocity=(0.0, 10.0, 0.0))
    simulator, _, estimator = _follow(room)
    observed = []
    for k in range(14):
        simulator.AdvanceTo(0.05 * k + 0.03)
        observed.append(held(estimator, simulator, "nearest"))
    speeds, distances = np.array(observed)[:, 2], np.array(observed)[:, 0]
    assert distances.max() == pytest.approx(40.0)
    assert distances.min() == pytest.approx(10.0, abs=0.01)
    assert np.abs(speeds).max() < 1.0  # not 600 m/s


def test_the_speed_can_be_filtered() -> None:
    room = Room()
    room.starts[0] = (room.carrier, ABOVE, (4.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    room.put(Box(1.0, 20.0, 9.0), RigidTransform([40.5, 0.0, 0.0]))
    simulator, _, estimator = _follow(room, filter_time=0.2)
    simulator.AdvanceTo(0.43)  # eight differences
    assert held(estimator, simulator, "nearest")[2] == pytest.approx(-4.0 * (1.0 - np.exp(-0.4 / 0.2)), abs=1e-3)


def test_it_is_made_for_a_scanner_or_from_a_diagram_file() -> None:
    room = Room()
    sensor = LaserScanner(room.world(), room.carrier.body_frame(), scanner(beams=11))
    assert DistanceEstimator.of(sensor).angles == pytest.approx(sensor.angles)
    spec: dict[str, Any] = {
        "world": "empty",
        "vehicles": {"ego": {"model": "catvehicle"}},
        "control": {"ego": {"kind": "constant", "speed": 0.0}},
        "sensors": {"ego": ["front_lidar"]},
        "systems": {
            "ahead": {
                "kind": "mirdrake.sensors.perception:DistanceEstimator",
                "beams": 180, "start_angle": -1.57, "end_angle": 1.57,
            }
        },
        "connect": [["ego.front_lidar", "ahead.ranges"], ["ego.front_lidar.stamp", "ahead.stamp"]],
    }  # fmt: skip
    assert "ahead.nearest" in assemble(spec).taps


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"beams": 0}, "beams is 0; it should be at least 1"),
        ({"rate": 0.0}, "rate is 0.0; it should be above 0"),
        ({"max_speed": -1.0}, "max_speed is -1.0; it should be above 0"),
        ({"filter_time": -1.0}, "filter_time is -1.0; it should be at least 0"),
        ({"low": 2.0, "high": 3.0}, r"no beam from -1 to 1 rad lies between low \(2\) and high \(3\) rad"),
    ],
)
def test_impossible_values_are_rejected(change: dict[str, float], message: str) -> None:
    arguments: dict[str, Any] = {"beams": 11, "start_angle": -1.0, "end_angle": 1.0} | change
    with pytest.raises(ConfigError, match=message):
        DistanceEstimator(**arguments)


def test_points_are_drawn(meshcat: Meshcat) -> None:
    show_points(meshcat, "some/points", [[1.0, 2.0, 0.0], [1.0, 2.0, 5.0]])
    assert meshcat.HasPath("/drake/some/points")
    show_points(meshcat, "some/points", np.empty((0, 3)))
    assert meshcat.HasPath("/drake/some/points")


def test_the_cloud_of_a_lidar_is_drawn_as_it_comes(meshcat: Meshcat) -> None:
    room = Room()
    room.put(Box(1.0, 20.0, 9.0), RigidTransform([10.0, 0.0, 0.0]))
    sensor = Lidar(room.world(), room.carrier.body_frame(), lidar())
    room.builder.AddSystem(sensor)
    for name in ("body_poses", "body_spatial_velocities"):
        room.builder.Connect(room.plant.GetOutputPort(name), sensor.GetInputPort(name))
    add_cloud_overlays(room.builder, meshcat, {"ego.roof": sensor})
    simulator = room.start()
    assert not meshcat.HasPath("/drake/clouds/ego/roof")
    simulator.AdvanceTo(0.25)
    assert meshcat.HasPath("/drake/clouds/ego/roof")


def test_overlays_of_no_lidars_add_nothing(meshcat: Meshcat) -> None:
    builder = DiagramBuilder()
    add_cloud_overlays(builder, meshcat, {})
    assert not builder.GetSystems()
