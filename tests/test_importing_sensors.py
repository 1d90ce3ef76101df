"""Gazebo sensors, valid and invalid ones, become mounts that the schema of sensors.yaml allows."""

from math import pi, radians
from random import Random
from typing import Any

import numpy as np
import pytest
from pydrake.math import RotationMatrix

from mirdrake.core.errors import MirdrakeError
from mirdrake.importing.vehicles.car import Car
from mirdrake.importing.vehicles.read import read_source
from mirdrake.importing.vehicles.recognise import recognise
from mirdrake.importing.vehicles.repair import repair
from mirdrake.sensors.ranging.laser_scanner import LaserScannerMount
from mirdrake.vehicles.mounts import SensorsSpec
from tests.test_importing import reports, write


def car_with(folder, extra: str) -> Car:
    """Return the car with `extra` in its URDF, up to the step before meshes are converted."""
    model = read_source(write(folder, extra=extra))
    car = repair(model, recognise(model), name="car")
    SensorsSpec.model_validate({"mounts": car.mounts})
    return car


def laser(
    name="laser", kind="ray", first="-1.57", last="1.57", near="0.1", far="30", samples="180", rows="", rate="10"
):
    vertical = f"<vertical>{rows}</vertical>" if rows else ""
    return (
        f'<gazebo reference="chassis"><sensor name="{name}" type="{kind}"><update_rate>{rate}</update_rate><ray><scan>'
        f"<horizontal><samples>{samples}</samples><min_angle>{first}</min_angle><max_angle>{last}</max_angle>"
        f"</horizontal>{vertical}</scan><range><min>{near}</min><max>{far}</max></range></ray></sensor></gazebo>"
    )


def planes(samples="16", first="-0.26", last="0.26"):
    return f"<samples>{samples}</samples><min_angle>{first}</min_angle><max_angle>{last}</max_angle>"


# --- single corrections ------------------------------------------------------------------------------------------

FIXED: dict[str, tuple[str, dict[str, float]]] = {
    "degrees": (laser(first="-90", last="90"), {"start_angle": -pi / 2, "end_angle": pi / 2}),
    "full turn, rounded": (laser(first="0", last="6.28319"), {"start_angle": 0.0, "end_angle": 6.28319}),
    "two turns": (laser(first="-6.28", last="6.28"), {"start_angle": -pi, "end_angle": pi}),
    "near beyond far": (laser(near="30", far="0.1"), {"near": 0.1, "far": 30.0}),
    "near zero": (laser(near="0.0"), {"near": 1e-3}),
    "far infinite": (laser(far="inf"), {"far": 1e5}),
    "too many beams": (laser(samples="999999"), {"beams": 100_000}),
    "too many planes": (laser(samples="10", rows=planes("4000")), {"rows": 1024, "columns": 10}),
    "too many rays": (laser(samples="20000", rows=planes("128")), {"rows": 128, "columns": 7812}),
    "planes in degrees": (laser(rows=planes(first="-15", last="15")), {"vertical_end": radians(15)}),
    "rate not a number": (laser(rate="fast"), {"rate": 10.0}),
}


@pytest.mark.parametrize(("extra", "expected"), FIXED.values(), ids=FIXED)
def test_a_value_with_one_meaning_is_corrected_and_reported(tmp_path, extra, expected):
    car = car_with(tmp_path, extra)
    mount = car.mounts["laser"]
    assert {key: mount[key] for key in expected} == pytest.approx(expected)
    assert reports(car, "sensor 'laser'") == (expected.get("end_angle") != 6.28319)


@pytest.mark.parametrize("digits", range(2, 12))
def test_a_full_turn_rounded_to_any_number_of_digits_is_a_full_turn(digits):
    end = float(f"{2 * pi:.{digits - 1}f}")
    fan = {"kind": "laser_scanner", "frame": "f", "rate": 10, "near": 0.1, "far": 10, "beams": 360}
    mount = LaserScannerMount.model_validate(fan | {"start_angle": 0.0, "end_angle": end})
    assert mount.end_angle <= 2 * pi + 1e-6
    half = float(f"{pi:.{digits}f}")
    LaserScannerMount.model_validate(fan | {"start_angle": -half, "end_angle": half})


@pytest.mark.parametrize(
    ("extra", "reason"),
    [
        (laser(near="3", far="3"), "near (3 m) must be below far (3 m)"),
        (laser(samples="0"), "number of beams, angles or range are missing"),
        (laser(first="-1e9"), "start_angle: Input should be greater than or equal to -6.3"),
        (laser(kind="contact"), "mirdrake has no such sensor"),
        (laser().replace("chassis", "nowhere"), "the link 'nowhere' does not exist"),
    ],
)
def test_a_sensor_without_a_correction_is_left_out_with_the_reason(tmp_path, extra, reason):
    car = car_with(tmp_path, extra)
    assert not car.mounts
    assert reports(car, "sensor 'laser'", "left out", reason)


# --- nonsense by seed --------------------------------------------------------------------------------------------

LEAVES = {
    "camera": ("camera/horizontal_fov", "camera/image/width", "camera/image/height", "camera/clip/near",
               "camera/clip/far", "camera/noise/stddev"),
    "ray": ("ray/scan/horizontal/samples", "ray/scan/horizontal/resolution", "ray/scan/horizontal/min_angle",
            "ray/scan/horizontal/max_angle", "ray/scan/vertical/samples", "ray/scan/vertical/min_angle",
            "ray/scan/vertical/max_angle", "ray/range/min", "ray/range/max", "ray/range/resolution",
            "ray/noise/stddev"),
    "imu": ("imu/angular_velocity/x/noise/stddev", "imu/linear_acceleration/x/noise/stddev"),
    "gps": ("gps/position_sensing/horizontal/noise/stddev", "gps/velocity_sensing/horizontal/noise/stddev",
            "plugin/referenceLatitude", "plugin/referenceLongitude", "plugin/referenceAltitude"),
    "sonar": ("sonar/min", "sonar/max", "sonar/radius"),
}  # fmt: skip
LEAVES |= {
    "multicamera": LEAVES["camera"],
    "wideanglecamera": LEAVES["camera"],
    "depth": (*LEAVES["camera"], "camera/depth_camera/clip/near", "camera/depth_camera/clip/far",
              "plugin/pointCloudCutoff", "plugin/pointCloudCutoffMax"),
    "gpu_lidar": tuple(path.replace("ray/", "lidar/") for path in LEAVES["ray"]),
}  # fmt: skip
SOUND = {"horizontal_fov": 1.2, "width": 640, "height": 480, "near": 0.1, "far": 50, "samples": 16, "min_angle": -0.5,
         "max_angle": 0.5, "min": 0.2, "max": 30, "resolution": 1, "stddev": 0.01, "radius": 0.5,
         "referenceLatitude": 49, "referenceLongitude": 8, "referenceAltitude": 100, "pointCloudCutoff": 0.4,
         "pointCloudCutoffMax": 5}  # fmt: skip
NONSENSE = ("nan", "inf", "-inf", "-1", "0", "1e300", "-1e300", "1e-300", "much", "", "90", "-180", "360", "6.28319",
            "1 2 3", "${x", "0x10", "1e9", "2000", "true", "١")  # fmt: skip


def nest(path: str, text: str) -> str:
    tag, _, rest = path.partition("/")
    return f"<{tag}>{nest(rest, text)}</{tag}>" if rest else f"<{tag}>{text}</{tag}>"


def nonsense(random: Random, number: int) -> str:
    """Return a sensor whose values are each sound, nonsense, or absent."""
    kind = random.choice(list(LEAVES))
    tree: dict[str, Any] = {}
    for path in LEAVES[kind]:
        if random.random() < 0.1:
            continue
        sound = random.random() < 0.6
        value = str(SOUND[path.rpartition("/")[2]]) if sound else random.choice(NONSENSE)
        below = tree
        for part in path.split("/")[:-1]:
            below = below.setdefault(part, {})
        below[path.rpartition("/")[2]] = value

    def text(item: Any) -> str:
        return (
            item if isinstance(item, str) else "".join(f"<{key}>{text(value)}</{key}>" for key, value in item.items())
        )

    rate, pose = random.choice((*NONSENSE, "10", "20")), random.choice((*NONSENSE, "0 0 1 0 0 0", "1e9 0 0 0 0 0"))
    link, name = (
        random.choice(("chassis", "base_link", "hub_l", "none")),
        random.choice((f"s{number}", "", "a b", "é:$")),
    )
    head = f"<update_rate>{rate}</update_rate><pose>{pose}</pose>"
    return f'<gazebo reference="{link}"><sensor name="{name}" type="{kind}">{head}{text(tree)}</sensor></gazebo>'


@pytest.mark.parametrize("seed", range(25))
def test_no_value_of_a_sensor_rejects_the_car(tmp_path, seed):
    """20 sensors a seed, each of which becomes a mount or is left out with a row."""
    random = Random(seed)
    extra = "\n".join(nonsense(random, number) for number in range(20)).replace("${x", "$x")
    try:
        car = car_with(tmp_path, extra)
    except MirdrakeError as error:
        pytest.fail(str(error))
    dropped = {
        change.place
        for change in car.changes
        if change.part.startswith("sensor") and change.left_out and change.part.endswith("'")
    }
    assert len(car.mounts) + len(dropped) == 20


# --- plugins -----------------------------------------------------------------------------------------------------


def plugin(file: str, inside: str, reference: str = "", name: str = "unit") -> str:
    head = f' reference="{reference}"' if reference else ""
    return f'<gazebo{head}><plugin name="{name}" filename="{file}">{inside}</plugin></gazebo>'


PLUGINS = {
    "hector imu": (
        plugin("libhector_gazebo_ros_imu.so", "<updateRate>50.0</updateRate><bodyName>hub_l</bodyName>"
               "<accelGaussianNoise>0.3 0.3 0.3</accelGaussianNoise><rateGaussianNoise>0.02 0 0</rateGaussianNoise>"),
        {"kind": "imu", "rate": 50.0, "acceleration_noise": 0.3, "gyro_noise": 0.02},
    ),
    "hector gps": (
        plugin("libhector_gazebo_ros_gps.so", "<updateRate>4.0</updateRate><bodyName>hub_l</bodyName>"
               "<gaussianNoise>0.4 0.4 0.6</gaussianNoise><referenceLatitude>49.9</referenceLatitude>"),
        {"kind": "gps", "rate": 4.0, "noise": 0.4, "datum": {"heading": 0.0, "latitude": radians(49.9)}},
    ),
    "gazebo_ros_imu": (plugin("libgazebo_ros_imu.so", "<frameName>hub_l</frameName><updateRate>20</updateRate>"),
                       {"kind": "imu", "rate": 20.0}),
    "by reference": (plugin("libgazebo_ros_gps.so", "<update_rate>5</update_rate>", "hub_l"),
                     {"kind": "gps", "rate": 5.0}),
    "of px4": (plugin("libgazebo_imu_plugin.so", "<linkName>hub_l</linkName>"), {"kind": "imu", "rate": 100.0}),
    "sonar in a ray": (
        laser().replace("</ray>", '</ray><plugin name="s" filename="libhector_gazebo_ros_sonar.so"/>')
        .replace("chassis", "hub_l").replace("1.57", "0.2"),
        {"kind": "sonar", "cone": 0.4, "near": 0.1, "far": 30.0},
    ),
    "range": (
        laser().replace("</ray>", '</ray><plugin name="s" filename="libgazebo_ros_range.so"><fov>0.5</fov></plugin>')
        .replace("chassis", "hub_l"),
        {"kind": "sonar", "cone": 0.5},
    ),
    "range of ROS 2": (
        laser().replace("</ray>", '</ray><plugin name="s" filename="libgazebo_ros_ray_sensor.so">'
                        "<output_type>sensor_msgs/Range</output_type></plugin>").replace("chassis", "hub_l"),
        {"kind": "sonar", "cone": 3.13},
    ),
    "navsat": ('<gazebo reference="hub_l"><sensor name="n" type="navsat"><update_rate>1</update_rate></sensor>'
               "</gazebo>",
               {"kind": "gps", "rate": 1.0}),
    "kinect": (
        '<gazebo reference="hub_l"><sensor name="k" type="depth"><update_rate>20</update_rate><camera>'
        "<horizontal_fov>1.05</horizontal_fov></camera><plugin name='k' filename='libgazebo_ros_openni_kinect.so'>"
        "<pointCloudCutoff>0.5</pointCloudCutoff><pointCloudCutoffMax>3.0</pointCloudCutoffMax></plugin></sensor></gazebo>",
        {"kind": "depth_camera", "depth_near": 0.5, "depth_far": 3.0},
    ),
    "stereo": (
        '<gazebo reference="hub_l"><sensor name="m" type="multicamera"><camera name="left"><pose>0 0.06 0 0 0 0</pose>'
        "</camera><camera name='right'><pose>0 -0.06 0 0 0 0</pose></camera></sensor></gazebo>",
        {"kind": "stereo_camera", "baseline": 0.12},
    ),
}  # fmt: skip


@pytest.mark.parametrize(("extra", "expected"), PLUGINS.values(), ids=PLUGINS)
def test_plugins_of_sensors_become_sensors_on_their_link(tmp_path, extra, expected):
    car = car_with(tmp_path, extra)
    (mount,) = car.mounts.values()
    assert {key: mount[key] for key in expected} == {
        key: pytest.approx(value) if isinstance(value, float) else value for key, value in expected.items()
    }
    assert [frame.parent for frame in car.mount_frames] == ["hub_l"]
    assert not reports(car, "plugin 'unit'", "Gazebo plugins are not executed")


def test_a_sensor_plugin_without_a_link_is_at_the_root_and_one_with_an_unknown_link_is_left_out(tmp_path):
    for inside in ("", "<frameId>a_label</frameId>"):
        car = car_with(tmp_path, plugin("libhector_gazebo_ros_imu.so", inside))
        assert [frame.parent for frame in car.mount_frames] == [car.base]
    car = car_with(tmp_path, plugin("libhector_gazebo_ros_imu.so", "<bodyName>gone</bodyName>"))
    assert not car.mounts
    assert reports(car, "sensor 'unit'", "left out", "the link 'gone' does not exist")


@pytest.mark.parametrize(
    ("file", "reason"),
    [
        ("libgazebo_ros_p3d.so", "ground truth is not a sensor"),
        ("libhector_gazebo_ros_magnetic.so", "mirdrake has no such sensor"),
        ("gz-sim-imu-system", "Gazebo plugins are not executed"),
    ],
)
def test_other_plugins_are_reported_and_do_not_become_sensors(tmp_path, file, reason):
    car = car_with(tmp_path, plugin(file, "", name="gz::sim::systems::Imu"))
    assert not car.mounts
    assert reports(car, "plugin", "left out", reason)


def test_a_camera_has_the_rotation_of_its_pose_in_the_sensor(tmp_path):
    def turned(pose: str) -> tuple[Car, Any]:
        inside = f"<pose>0 0 1 0 0 0.3</pose><camera>{pose}</camera>"
        car = car_with(tmp_path, f"<gazebo reference='hub_l'><sensor name='m' type='camera'>{inside}</sensor></gazebo>")
        return car, car.mount_frames[0].X_PF.rotation()

    _, plain = turned("")
    for pose, angle in (("<pose>0 0 0 0 0.2 0</pose>", 0.2), ("<pose degrees='1'>0 0 0 0 10 0</pose>", radians(10.0))):
        _, pitched = turned(pose)
        turn = plain.inverse().multiply(pitched).matrix()
        np.testing.assert_allclose(turn, RotationMatrix.MakeYRotation(angle).matrix(), atol=1e-12)
    car, wrong = turned("<pose>0 0 0 0 0.2</pose>")
    np.testing.assert_allclose(wrong.matrix(), plain.matrix(), atol=1e-12)
    assert reports(car, "camera.pose", "0 0 0 0 0.2", "six numbers")


def test_eyes_that_are_not_parallel_are_reported(tmp_path):
    eyes = "".join(
        f"<camera name='{name}'><pose>0 {y} 0 0 0 {yaw}</pose></camera>"
        for name, y, yaw in (("left", 0.06, 0.0), ("right", -0.06, 0.1))
    )
    car = car_with(tmp_path, f"<gazebo reference='hub_l'><sensor name='m' type='multicamera'>{eyes}</sensor></gazebo>")
    assert reports(car, "right eye", "5.73 deg", "parallel")
