"""The sensors in the run report: what was recorded, pictures, and scans from above."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mirdrake.core.recording.arrays import ArrayLog, Samples
from mirdrake.core.recording.pictures import PictureLog
from mirdrake.core.recording.vectors import VectorLog
from mirdrake.report.run_report import render_report
from mirdrake.report.sensor_views import make_sensors
from mirdrake.runs.logs import Run
from mirdrake.sensors.ranging.lidar import LidarScan
from mirdrake.vehicles import Vehicle
from mirdrake.vehicles.inspection import find_sensors
from mirdrake.vehicles.outline import measure_outline
from tests.test_report import Page, make_run, scene

USED = ["front_lidar", "roof_lidar", "imu", "front_camera", "right_camera"]
WALL = 12.0
"""Distance of a wall ahead of each sensor, across its x axis [m]."""


def bolt() -> Vehicle:
    return scene().vehicles["ego"]


def record_sensors(folder: Path) -> None:
    """Record a wall ahead, two pictures and three samples of an IMU; no picture of the right camera."""
    mount: Any = bolt().sensors.mounts["front_lidar"]
    angles = np.linspace(mount.start_angle, mount.end_angle, mount.beams)
    log = ArrayLog(folder / "ego.front_lidar.parquet", units={"ranges": "m"})
    for time in (9.0, 10.0, 11.0):
        seen = (np.abs(angles) < 1.0) & (time == 10.0)  # only the scan in the middle of the run has the wall
        log.write(time, np.where(seen, WALL / np.cos(angles), np.inf))
    log.close()
    # A lidar of 2 x 5 beams; of its two rows the lower one meets the road.
    azimuths, elevations = np.linspace(0.4, -0.4, 5), np.array([-0.3, 0.0])
    height = next(sensor.place[2] for sensor in find_sensors(bolt()) if sensor.name == "roof_lidar")
    ranges = np.stack((np.full(5, height / np.sin(0.3)), WALL / np.cos(azimuths))).astype(np.float32)
    cloud = ArrayLog(folder / "ego.roof_lidar.parquet", units={"ranges": "m"})
    cloud.write(10.0, LidarScan(10.0, ranges, np.zeros(5), azimuths, elevations, np.eye(3, 4), np.zeros(6)))
    cloud.close()
    imu = VectorLog(folder / "ego.imu.parquet", {"fx": "m/s^2", "wz": "rad/s"})
    for time in (0.0, 0.01, 0.02):
        imu.write(time, np.array([0.0, time]))
    imu.close()
    pictures = PictureLog(folder / "ego.front_camera")
    for time in (5.0, 10.0):
        pictures.write(time, np.full((48, 64, 3), 120, dtype=np.uint8), steering=0.0, speed=5.0)
    pictures.close()


@pytest.fixture(scope="module")
def sensor_run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    folder = tmp_path_factory.mktemp("sensors")
    record_sensors(folder)
    run = make_run(folder, duration=20.0, rate=10.0)
    return replace(run, spec=run.spec | {"sensors": {"ego": USED}})


def test_each_sensor_of_a_run_has_a_row_with_what_was_recorded(sensor_run):
    rows = {row.name: row for row in make_sensors(sensor_run, "ego", bolt()).rows}
    assert list(rows) == USED
    assert rows["front_lidar"].recorded == "3 scans of 180 beams in ego.front_lidar.parquet"
    assert rows["roof_lidar"].recorded == "1 scan of 2 × 5 beams in ego.roof_lidar.parquet"
    assert rows["imu"].recorded == "3 samples of fx, wz in ego.imu.parquet"
    assert rows["front_camera"].recorded.startswith("2 pictures of ")
    assert rows["right_camera"].recorded == "nothing (record.cameras is false)"
    assert rows["front_lidar"].kind == "laser scanner"
    assert rows["front_lidar"].preset == "sick_lms291"
    assert rows["front_lidar"].rate == "50\u00a0Hz"
    place = next(sensor.place for sensor in find_sensors(bolt()) if sensor.name == "imu")
    assert rows["imu"].place == ", ".join(f"{value:.3f}" for value in place)


def test_the_page_shows_a_picture_and_scans(sensor_run):
    text = render_report(sensor_run)
    page = Page(text)
    assert not page.open
    assert "Sensors" in page.text
    (picture,) = (image for image in page.all("img") if (image["alt"] or "").startswith("front_camera"))
    assert picture["alt"] == "front_camera at 10.0\u00a0s"
    assert str(picture["src"]).startswith("data:image/jpeg;base64,")
    assert text.count('class="plot scan"') == 2
    assert text == render_report(sensor_run)


def test_a_run_without_sensors_has_no_section_of_them(tmp_path):
    assert 'id="sensors"' not in render_report(make_run(tmp_path, duration=20.0, rate=10.0))


def test_a_run_without_a_scene_has_no_section_of_sensors(sensor_run):
    assert make_sensors(sensor_run, "ego", None).rows == []


def test_a_wall_is_drawn_at_its_distance_from_the_vehicle(sensor_run):
    """The front of the vehicle and the wall in one drawing, in metres by the width of the vehicle."""
    views = make_sensors(sensor_run, "ego", bolt()).views
    drawings = {view.caption.partition(" at ")[0]: str(view.drawing) for view in views if view.drawing}
    outline = measure_outline(bolt().urdf, packages=bolt().packages, base_link=bolt().spec.base_link)
    assert outline is not None
    places = {sensor.name: sensor.place for sensor in find_sensors(bolt())}
    for name in ("front_lidar", "roof_lidar"):
        drawing = drawings[name]
        front, width = (float(re.findall(rf'<rect [^>]*\b{key}="([\d.]+)"', drawing)[0]) for key in ("y", "width"))
        scale = width / (outline.left - outline.right)
        (dots,) = re.findall(r'<path d="([^"]+)" stroke="var\(--main\)"', drawing)
        heights = {float(y) for y in re.findall(r"M[\d.]+ ([\d.]+)h", dots)}
        assert len(heights) == 1
        distance = (front - heights.pop()) / scale
        # A cell of 1.6 px, and coordinates of 0.1 px.
        assert distance == pytest.approx(places[name][0] + WALL - outline.front, abs=1.0 / scale)
    assert 'stroke="var(--edge)"' in drawings["roof_lidar"]
    assert 'stroke="var(--edge)"' not in drawings["front_lidar"]


def test_one_sample_is_read_from_any_part(tmp_path):
    """Row groups of several parts, as after a kill."""
    log = ArrayLog(tmp_path / "ego.lidar.parquet")
    values = np.arange(12, dtype=np.float32).reshape(6, 2)
    for index, sample in enumerate(values):
        log.write(0.1 * index, sample)
        log._table.flush()  # type: ignore[union-attr]
    for finish in (False, True):
        if finish:
            log.close()
        samples = Samples(tmp_path / "ego.lidar.parquet")
        for index in range(6):
            np.testing.assert_array_equal(samples.sample(index)["ranges"], values[index])
        with pytest.raises(IndexError, match="no sample 6"):
            samples.sample(6)
        assert samples.shape("ranges") == (2,)


def test_a_name_can_be_looked_for_among_samples_and_sensors(sensor_run):
    assert "ego.imu" in sensor_run.arrays
    assert "ego.radar" not in sensor_run.arrays
    assert "fx" in sensor_run.arrays["ego.imu"]
    assert "time" not in sensor_run.arrays["ego.imu"]
