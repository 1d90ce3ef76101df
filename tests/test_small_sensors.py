"""IMU, GPS, wheel encoder, steering angle sensor and ground truth against numbers computed by hand."""

from math import cos, pi, radians, sin, sqrt
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydrake.multibody.plant import AddMultibodyPlant, MultibodyPlantConfig
from pydrake.multibody.tree import SpatialInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from mirdrake.assembly.diagram import assemble
from mirdrake.core.signals import signals_of
from mirdrake.runs.simulation import Simulation
from mirdrake.sensors.geodesy import DatumSpec, to_geodetic
from mirdrake.sensors.gps import Gps, GpsMount
from mirdrake.sensors.ground_truth import GroundTruthMount, TruthSensor
from mirdrake.sensors.imu import Imu, ImuMount
from mirdrake.sensors.nmea import Fix, checksum, gga, rmc
from mirdrake.sensors.noise import noise_stream
from mirdrake.sensors.steering_angle import SteeringAngle, SteeringAngleMount
from mirdrake.sensors.wheel_encoder import WheelEncoder, WheelEncoderMount
from tests.sensor_rigs import GRAVITY, Carousel, held, vehicle_with


def imu_reading(carousel: Carousel) -> np.ndarray:
    plant = carousel.finalize()
    reading: np.ndarray = carousel.run(imu_on(plant, carousel.mount, rate=100.0), 0.1, rate=100.0)[:, -1]
    return reading


# --- sensors from the keys of their mounts -----------------------------------------------------------------------


def imu_on(plant: Any, frame: Any, *, stream: int = 0, **keys: Any) -> Imu:
    return Imu(plant, frame, ImuMount(kind="imu", frame="mount", **keys), stream=stream)


def gps_on(frame: Any, *, stream: int = 0, **keys: Any) -> Gps:
    return Gps(frame, GpsMount(kind="gps", frame="mount", **keys), stream=stream)


def encoder_of(plant: Any, joint: Any, **keys: Any) -> WheelEncoder:
    return WheelEncoder(plant, joint, WheelEncoderMount(kind="wheel_encoder", frame="wheel", **keys))


def steering_of(plant: Any, joint: Any, *, ratio: float = 1.0, **keys: Any) -> SteeringAngle:
    return SteeringAngle(plant, [joint], SteeringAngleMount(kind="steering_angle", frame="b", **keys), ratio=ratio)


# --- IMU ---------------------------------------------------------------------------------------------------------


def test_an_imu_at_rest_on_the_level_reads_gravity_upwards() -> None:
    assert imu_reading(Carousel([1.0, 2.0, 3.0])) == pytest.approx([0.0, 0.0, 9.80665, 0.0, 0.0, 0.0], abs=1e-12)


def test_an_imu_rolled_by_30_degrees_to_the_right_reads_half_of_gravity_to_the_left() -> None:
    # roll +30 deg about x lifts the left side: y points up by 30 deg, f_y = g sin 30, f_z = g cos 30
    reading = imu_reading(Carousel([0.0, 0.0, 0.0], rpy=(radians(30), 0.0, 0.0)))
    assert reading[:3] == pytest.approx([0.0, 4.903325, 8.492808], abs=1e-6)


def test_an_imu_on_a_circle_reads_the_centripetal_force_of_its_own_place() -> None:
    # 0.5 rad/s about a centre 10 m to the left (v = 5 m/s, v²/R = 2.5 m/s²); mounted 1 m ahead of the point abeam:
    # acceleration -w² (1, -10) = (-0.25, 2.5) m/s²
    reading = imu_reading(Carousel([1.0, -10.0, 0.0], rate=0.5))
    assert reading == pytest.approx([-0.25, 2.5, 9.80665, 0.0, 0.0, 0.5], abs=1e-9)


def test_an_imu_on_a_banked_circle_reads_gravity_in_its_own_frame() -> None:
    # The plane of the circle slopes down by 20 degrees towards world x. At angle 0 the arm points down the slope:
    # f = g (-sin 20, 0, cos 20) in its frame, less the centripetal -w² r along the arm; at 90 degrees across it.
    slope, w, r = radians(20), 0.5, 8.0
    down, normal = GRAVITY * sin(slope), GRAVITY * cos(slope)
    for angle, expected in ((0.0, (-down - w * w * r, 0.0)), (pi / 2, (-w * w * r, down))):
        carousel = Carousel([r, 0.0, 0.0], slope=slope, rate=w, angle=angle)
        plant = carousel.finalize()
        imu = imu_on(plant, carousel.mount, rate=100.0)
        simulator = carousel.start(imu)
        simulator.AdvanceTo(0.001)  # the sample of t = 0
        assert held(imu, simulator) == pytest.approx([*expected, normal, 0.0, 0.0, w], abs=1e-9)


def test_two_imus_differ_by_the_lever_arm_between_them() -> None:
    # w x (w x r) of the arm between them: -w² (2, -1.5, 0)
    readings = [imu_reading(Carousel(position, rate=0.7)) for position in ([1.0, -10.0, 0.5], [3.0, -11.5, 1.0])]
    assert readings[1][:3] - readings[0][:3] == pytest.approx([-0.49 * 2.0, 0.49 * 1.5, 0.0], abs=1e-9)
    assert readings[1][3:] == pytest.approx(readings[0][3:], abs=1e-12)


def test_an_imu_that_is_mounted_turned_reads_in_its_own_frame() -> None:
    # turned by +90 deg: its x axis is the arm's y, its y axis the arm's -x
    reading = imu_reading(Carousel([1.0, -10.0, 0.0], rpy=(0.0, 0.0, pi / 2), rate=0.5))
    assert reading == pytest.approx([2.5, 0.25, 9.80665, 0.0, 0.0, 0.5], abs=1e-9)


@pytest.mark.parametrize("rate", [10.0, 30.0, 100.0, 200.0])
def test_an_imu_sees_the_plant_as_it_is_at_the_time_of_each_sample(rate: float) -> None:
    # turning at 2 rad/s about its own y axis, pitch 2 t: f = g (-sin, 0, cos); the plant's steps are 5 ms
    carousel = Carousel(rate=2.0, axis=(0.0, 1.0, 0.0))
    plant = carousel.finalize()
    samples = carousel.run(imu_on(plant, carousel.mount, rate=rate), 2.0, rate=rate)
    time = (
        np.ceil(np.arange(samples.shape[1]) / rate / 0.005 - 1e-6) * 0.005
    )  # between steps it is where the next leads
    expected = GRAVITY * np.array([-np.sin(2.0 * time), np.cos(2.0 * time)])
    assert samples[[0, 2]] == pytest.approx(expected, abs=1e-6)


def test_an_imu_in_free_fall_reads_no_force() -> None:
    builder = DiagramBuilder()
    config = MultibodyPlantConfig(time_step=0.005, use_sampled_output_ports=False)
    plant, _ = AddMultibodyPlant(config, builder)
    body = plant.AddRigidBody("stone", SpatialInertia.SolidBoxWithMass(1.0, 1.0, 1.0, 1.0))
    plant.Finalize()
    imu = builder.AddSystem(imu_on(plant, body.body_frame(), rate=100.0))
    for name, port in (
        ("body_poses", plant.get_body_poses_output_port()),
        ("body_spatial_velocities", plant.get_body_spatial_velocities_output_port()),
        ("body_spatial_accelerations", plant.get_body_spatial_accelerations_output_port()),
    ):
        builder.Connect(port, imu.GetInputPort(name))
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(0.1)
    assert imu.sample.Eval(imu.GetMyContextFromRoot(simulator.get_context())) == pytest.approx(np.zeros(6), abs=1e-12)


def test_the_noise_of_an_imu_has_its_two_standard_deviations() -> None:
    carousel = Carousel([0.0, 0.0, 0.0])
    plant = carousel.finalize()
    imu = imu_on(
        plant, carousel.mount, rate=100.0, acceleration_noise=0.02, gyro_noise=0.002, stream=noise_stream(0, "a")
    )
    samples = carousel.run(imu, 20.0, rate=100.0)
    assert samples.shape == (6, 2000)
    assert samples.std(axis=1) == pytest.approx([0.02] * 3 + [0.002] * 3, rel=0.1)
    assert samples.mean(axis=1) == pytest.approx([0, 0, GRAVITY, 0, 0, 0], abs=4 * 0.02 / 2000**0.5)
    assert np.abs(np.corrcoef(samples) - np.eye(6)).max() < 0.1  # 4.5 standard deviations of 1/sqrt(2000)


def test_the_elements_of_an_imu_have_names_and_units() -> None:
    carousel = Carousel([0.0, 0.0, 0.0])
    contents = signals_of(imu_on(carousel.finalize(), carousel.mount, rate=100.0).sample)
    assert contents is not None
    assert [(signal.name, signal.unit) for signal in contents][2:4] == [("fz", "m/s²"), ("wx", "rad/s")]


# --- GPS ---------------------------------------------------------------------------------------------------------


def test_a_gps_without_noise_gives_the_place_of_its_antenna() -> None:
    # the arm points along the world's y axis: 3 m ahead and 1 m to the left are x = -1 m, y = 3 m
    carousel = Carousel([3.0, 1.0, 2.0], angle=pi / 2)
    carousel.finalize()
    samples = carousel.run(gps_on(carousel.mount, rate=10.0), 0.3, rate=10.0)
    assert samples[:3] == pytest.approx(np.tile([[-1.0], [3.0], [2.0]], 3), abs=1e-12)


def test_a_gps_gives_the_velocity_of_its_antenna() -> None:
    # 0.5 rad/s at (4, 3): (-1.5, 2) m/s
    carousel = Carousel([4.0, 3.0, 2.0], rate=0.5)
    carousel.finalize()
    gps = gps_on(carousel.mount, rate=10.0)
    simulator = carousel.start(gps)
    assert held(gps, simulator)[3:6] == pytest.approx([-1.5, 2.0, 0.0], abs=1e-12)


def test_a_gps_holds_the_place_of_its_last_sample() -> None:
    # 1 rad/s at 2 m: the sample at 0.1 s is shown at 0.15 s
    carousel = Carousel([2.0, 0.0, 0.0], rate=1.0)
    carousel.finalize()
    samples = carousel.run(gps_on(carousel.mount, rate=10.0), 0.2, rate=10.0)
    assert samples[:3, 1] == pytest.approx([1.990008, 0.199667, 0.0], abs=1e-6)  # 2 cos 0.1, 2 sin 0.1


def test_the_noise_of_a_gps_is_horizontal_and_has_its_standard_deviation() -> None:
    carousel = Carousel([0.0, 0.0, 2.0])
    carousel.finalize()
    x, y, z = carousel.run(gps_on(carousel.mount, rate=100.0, noise=1.5, stream=7), 20.0, rate=100.0)[:3]
    assert [x.std(), y.std()] == pytest.approx([1.5, 1.5], rel=0.1)
    assert [x.mean(), y.mean()] == pytest.approx([0.0, 0.0], abs=4 * 1.5 / 2000**0.5)
    assert abs(np.corrcoef(x[1:], x[:-1])[0, 1]) < 0.1  # white
    assert np.all(z == 2.0)


# --- on the Earth ------------------------------------------------------------------------------------------------

RICE = DatumSpec(latitude=radians(29.7174), longitude=radians(-95.4018), altitude=15.0, heading=radians(30))
A, F = 6378137.0, 1.0 / 298.257223563  # WGS 84: semi-major axis [m] and flattening


def earth_centred(latitude: float, longitude: float, altitude: float) -> np.ndarray:
    """Return the earth-centred coordinates [m] of a place [deg, deg, m], from the definition of the ellipsoid."""
    phi, lam, e2 = radians(latitude), radians(longitude), F * (2.0 - F)
    n = A / sqrt(1.0 - e2 * sin(phi) ** 2)
    radius = (n + altitude) * cos(phi)
    return np.array([radius * cos(lam), radius * sin(lam), (n * (1.0 - e2) + altitude) * sin(phi)])


def in_world(location: np.ndarray, datum: DatumSpec) -> np.ndarray:
    """Return world coordinates [m] of a place by rotating the difference of earth-centred ones: an oracle."""
    origin = earth_centred(datum.latitude * 180 / pi, datum.longitude * 180 / pi, datum.altitude)
    phi, lam = datum.latitude, datum.longitude
    east = np.array([-sin(lam), cos(lam), 0.0])
    up = np.array([cos(phi) * cos(lam), cos(phi) * sin(lam), sin(phi)])
    north = np.cross(up, east)
    ahead = cos(datum.heading) * north + sin(datum.heading) * east
    difference: np.ndarray = np.array([ahead, np.cross(up, ahead), up]) @ (earth_centred(*location) - origin)
    return difference


DATUMS = [DatumSpec(), RICE, DatumSpec(latitude=radians(-77.85), longitude=radians(179.9999), heading=radians(-100))]


@pytest.mark.parametrize("datum", DATUMS, ids=["null_island", "rice", "mcmurdo"])
@pytest.mark.parametrize("point", [(0.0, 0.0, 0.0), (123.4, -567.8, 9.0), (-9000.0, 4000.0, 300.0), (0.0, 1e5, -50.0)])
def test_the_place_on_the_earth_is_right_to_a_hundredth_of_a_millimetre(point: Any, datum: DatumSpec) -> None:
    location = to_geodetic(point, datum)
    assert in_world(location, datum) == pytest.approx(np.array(point), abs=1e-5)


def test_north_and_east_of_a_datum_follow_its_heading() -> None:
    # x to the east: y is north. One minute of latitude at 45 degrees is 1852.2 m (meridian radius 6 367 382 m).
    datum = DatumSpec(latitude=radians(45), longitude=radians(-81))
    latitude, longitude, altitude = to_geodetic((0.0, 1852.2, 0.0), datum)
    assert latitude == pytest.approx(45.0 + 1.0 / 60.0, abs=1e-6)
    assert longitude == pytest.approx(-81.0, abs=1e-12)
    assert altitude == pytest.approx(1852.2**2 / (2 * 6367382.0), abs=1e-3)  # the plane leaves the Earth
    ahead = DatumSpec(latitude=radians(45), longitude=radians(-81), heading=0.0)  # x to the north
    assert to_geodetic((1852.2, 0.0, 0.0), ahead) == pytest.approx([latitude, longitude, altitude], abs=1e-9)


def test_a_gps_gives_its_geodetic_position() -> None:
    carousel = Carousel([300.0, 100.0, 2.0], angle=0.3)
    carousel.finalize()
    samples = carousel.run(
        gps_on(carousel.mount, rate=10.0, noise=0.5, vertical_noise=0.5, stream=3, datum=RICE), 0.3, rate=10.0
    )
    for sample in samples.T:
        assert in_world(sample[6:], RICE) == pytest.approx(
            sample[:3], abs=1e-4
        )  # its own geodetic position, with noise


# --- NMEA --------------------------------------------------------------------------------------------------------


def read_nmea(text: str) -> dict[str, list[str]]:
    """Return sentences by their names, checksums tested: a reader of its own, from the standard."""
    sentences = {}
    for line in text.split("\r\n")[:-1]:
        assert len(line) + 2 <= 82
        assert line[0] == "$"
        body, _, checksum_field = line[1:].partition("*")
        total = 0
        for character in body:
            total ^= ord(character)
        assert int(checksum_field, 16) == total
        name, *fields = body.split(",")
        sentences[name] = fields
    return sentences


def degrees_of(text: str, letter: str) -> float:
    whole = text.index(".") - 2
    return (float(text[:whole]) + float(text[whole:]) / 60.0) * {"N": 1, "E": 1, "S": -1, "W": -1}[letter]


def test_the_checksum_of_a_well_known_sentence() -> None:
    assert checksum("GPGGA,123519,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,") == "47"


def test_sentences_contain_the_values_given() -> None:
    fix = Fix(3723.456, -33.8568, 151.2153, 12.3456, speed=10.0, course=359.999, quality=4)
    assert gga(fix) == "$GPGGA,010203.46,3351.4080000,S,15112.9180000,E,4,12,0.8,12.346,M,0.0,M,,*" + gga(fix)[-4:]
    fields = read_nmea(rmc(fix))["GPRMC"]
    assert fields[:2] == ["010203.46", "A"]
    assert float(fields[6]) == pytest.approx(19.438, abs=1e-3)  # 10 m/s in knots
    assert fields[7:9] == ["0.00", "010170"]  # a course that rounds to a whole turn


def test_minutes_never_round_to_sixty() -> None:
    location = read_nmea(gga(Fix(0.0, 44.99999999999, -80.99999999999, 0.0)))["GPGGA"][1:5]
    assert location == ["4500.0000000", "N", "08100.0000000", "W"]


def test_a_gps_speaks_nmea() -> None:
    # heading 30 degrees: x of the world points 30 degrees east of north. On the arm at angle 0 the velocity is along y,
    # to the left of x: course 30 - 90 = 300 degrees; 0.1 rad/s at 200 m: 20 m/s
    carousel = Carousel([200.0, 0.0, 1.0], rate=0.1)
    carousel.finalize()
    gps = gps_on(carousel.mount, rate=5.0, datum=RICE)
    simulator = carousel.start(gps)
    sentences = read_nmea(held(gps, simulator, "nmea"))
    location = sentences["GPGGA"]
    measured = [degrees_of(location[1], location[2]), degrees_of(location[3], location[4]), float(location[8])]
    assert in_world(np.array(measured), RICE) == pytest.approx([200.0, 0.0, 1.0], abs=1e-3)
    assert float(sentences["GPRMC"][6]) * 1852.0 / 3600.0 == pytest.approx(20.0, abs=1e-3)
    assert float(sentences["GPRMC"][7]) == pytest.approx(300.0, abs=0.01)
    simulator.AdvanceTo(0.3)
    assert read_nmea(held(gps, simulator, "nmea"))["GPGGA"][0] == "000000.20"  # of the sample, not of now


def test_a_gps_with_latency_has_no_output_before_its_first_fix() -> None:
    carousel = Carousel([1.0, 2.0, 3.0])
    carousel.finalize()
    gps = gps_on(carousel.mount, rate=10.0, latency=0.25)
    simulator = carousel.start(gps)
    simulator.AdvanceTo(0.24)
    assert held(gps, simulator, "nmea") == ""
    assert np.all(np.isnan(held(gps, simulator)))
    simulator.AdvanceTo(0.26)
    assert held(gps, simulator)[:3] == pytest.approx([1.0, 2.0, 3.0])


# --- encoder, steering, truth ------------------------------------------------------------------------------------


def turning(sensor_of: Any, *, rate: float, angle: float = 0.0, duration: float = 1.0) -> np.ndarray:
    """Return samples at 10 Hz of a sensor of the angle of a joint that turns at a rate [rad/s]."""
    carousel = Carousel(rate=rate, angle=angle, axis=(0.0, 1.0, 0.0))
    plant = carousel.finalize()
    return carousel.run(sensor_of(plant, carousel.joint), duration, rate=10.0)


def test_an_encoder_counts_whole_steps_of_the_angle() -> None:
    # 100 counts a turn at 3 rad/s: 0.3 rad from sample to sample are 4.7746 counts
    counts = turning(lambda plant, joint: encoder_of(plant, joint, rate=10.0, counts=100.0), rate=3.0)[0]
    assert counts.tolist() == [0, 4, 9, 14, 19, 23, 28, 33, 38, 42]


def test_only_a_quadrature_encoder_counts_down_when_the_wheel_rolls_back() -> None:
    back = turning(lambda plant, joint: encoder_of(plant, joint, rate=10.0, counts=125.5), rate=-3.0)[0]
    assert back.tolist() == [np.floor(-0.3 * k * 125.5 / (2 * pi)) for k in range(10)]
    single_channel = turning(
        lambda plant, joint: encoder_of(plant, joint, rate=10.0, counts=125.5, quadrature=False), rate=-3.0
    )[0]
    assert single_channel.tolist() == [-count for count in back]


def test_an_encoder_wraps_around() -> None:
    counts = turning(lambda plant, joint: encoder_of(plant, joint, rate=10.0, counts=100.0, wrap=16), rate=-3.0)[0]
    assert counts.tolist() == [np.floor(-30.0 * k / (2 * pi)) % 16 for k in range(10)]
    assert max(counts) < 16


def test_a_steering_angle_sensor_has_steps_an_offset_and_a_ratio() -> None:
    # 0.02 rad x 16 + 0.1 rad = 0.42 rad: 24.06 steps of 1 degree
    angle, steps = turning(
        lambda plant, joint: steering_of(plant, joint, rate=10.0, ratio=16.0, resolution=radians(1), offset=0.1),
        rate=0.0,
        angle=0.02,
        duration=0.1,
    )[:, 0]
    assert steps == 24.0
    assert angle == pytest.approx(24.0 * pi / 180.0, abs=1e-12)
    exact = turning(lambda plant, joint: steering_of(plant, joint, rate=10.0), rate=0.3)[0]
    assert exact == pytest.approx(0.03 * np.arange(10), abs=1e-9)


def test_the_noise_of_a_steering_angle_has_its_standard_deviation() -> None:
    def make(plant: Any, joint: Any) -> SteeringAngle:
        return steering_of(plant, joint, rate=10.0, noise=0.01)

    angle = turning(make, rate=0.0, duration=60.0)[0]
    assert angle.std() == pytest.approx(0.01, rel=0.1)
    assert angle.mean() == pytest.approx(0.0, abs=4 * 0.01 / 600**0.5)


def test_ground_truth_is_that_of_the_mounting_frame() -> None:
    # arm at 90 degrees, 0.5 rad/s; the mount 3 m ahead and turned by 30 degrees to the left
    carousel = Carousel([3.0, 0.0, 1.0], rpy=(0.0, 0.0, radians(30)), angle=pi / 2, rate=0.5)
    carousel.finalize()
    truth = TruthSensor(carousel.mount, GroundTruthMount(kind="ground_truth", frame="mount", rate=10.0))
    simulator = carousel.start(truth)
    # its speed of 1.5 m/s is along y of the arm, 60 degrees to the left of the mount's x axis
    speed = [1.5 * cos(radians(60)), 1.5 * sin(radians(60)), 0.0]
    assert held(truth, simulator) == pytest.approx([0.0, 3.0, 1.0, 0.0, 0.0, radians(120), *speed, 0.0, 0.0, 0.5])


# --- on vehicles -------------------------------------------------------------------------------------------------


def test_the_encoders_of_a_vehicle_count_its_wheels_turns() -> None:
    sensors = ["encoder_front_left", "encoder_rear_right", "gps"]
    spec = {
        "world": "empty",
        "vehicles": {"ego": {"model": "mkz", "speed": 5.0}},
        "control": {"ego": {"kind": "constant", "speed": 5.0}},
        "sensors": {"ego": sensors},
        "plant": {"contact": "point"},
        "record": {"meshcat": False, "report": False, "rate": 50},
    }
    done = Simulation(assemble(spec)).run(duration=1.0)
    for wheel in ("front_left", "rear_right"):
        counts = done[f"ego.encoder_{wheel}"].to_numpy()  # logged at the encoder's rate
        steps = done[f"ego.wheel_angle.{wheel}"].to_numpy() * 125.5 / (2 * pi)
        assert 250.0 < counts[-1] < 350.0
        assert np.all(counts == np.floor(steps + 1e-9))
    assert done["ego.gps.latitude"].iloc[-1] == pytest.approx(45.0, abs=1e-3)  # within 100 m of the datum
    assert done["ego.gps.longitude"].iloc[-1] == pytest.approx(-81.0, abs=1e-3)


def test_an_imu_of_a_parked_car_on_a_slope_reads_the_slope(tmp_path: Path) -> None:
    # 15 % uphill along x: g (sin, 0, cos) of atan 0.15 in the frame of the road, on which the car is level
    world = tmp_path / "hill.yaml"
    text = "mirdrake: world/1\nname: hill\nground: {surface: asphalt, slope: {grade: 0.15}}\n"
    world.write_text(text, encoding="utf-8")
    car = vehicle_with(tmp_path / "car", "mounts:\n  imu: {kind: imu, frame: imu, rate: 100}\n", model="bolt")
    spec = {
        "world": str(world),
        "vehicles": {"ego": {"model": str(car), "parked": True}},
        "control": {"ego": {"kind": "constant", "speed": 0.0}},
        "sensors": {"ego": ["imu"]},
        "plant": {"contact": "point"},
        "record": {"meshcat": False, "report": False},
    }
    done = Simulation(assemble(spec)).run(duration=2.0)
    reading = [float(done[f"ego.imu.{name}"].iloc[-20:].mean()) for name in ("fx", "fy", "fz")]
    assert reading == pytest.approx([1.454702, 0.0, 9.698016], abs=0.02)
