"""Recording of a run: every image and every scan, once, in order, on disk however the run ends."""

import contextlib
import io
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from textwrap import dedent
from typing import Any

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from PIL import Image

from mirdrake.assembly.diagram_spec import RecordSpec
from mirdrake.core.errors import ConfigError, RunError
from mirdrake.core.recording.arrays import ArrayLog, RunArrays
from mirdrake.core.recording.pictures import PictureLog, encode, make_pool, parse_start, picture_time, read_pictures
from mirdrake.runs.logs import load_run
from mirdrake.runs.simulation import simulate
from mirdrake.sensors.cameras import rendering
from mirdrake.sensors.cameras.mounts import CameraMount
from mirdrake.sensors.noise import is_lost, noise_stream
from tests.recording_rigs import BEAMS, COLUMNS, ROWS, LateCamera, install_stubs, make_scan

ROOT = Path(__file__).resolve().parent.parent


def drive(**changes: Any) -> dict[str, Any]:
    """Return a CAT Vehicle that drives straight ahead, with a camera and two lasers, as plain data."""
    return {
        "world": "empty",
        "vehicles": {"ego": {"model": "catvehicle"}},
        "control": {"ego": {"kind": "constant", "speed": 2.0}},
        "sensors": {"ego": ["left_camera", "front_lidar", "roof_lidar", "imu"]},
        "plant": {"contact": "point"},
        "record": {"cameras": True, "meshcat": False, "report": False},
        "duration": 1.0,
    } | changes


@pytest.fixture
def stubbed(monkeypatch: pytest.MonkeyPatch) -> None:
    install_stubs(monkeypatch)


# --- counts and times ------------------------------------------------------------------------------------------------


@pytest.mark.usefixtures("stubbed")
def test_no_picture_and_no_scan_is_missing_and_each_has_its_time(tmp_path: Path) -> None:
    run = simulate(drive(), folder=tmp_path / "run")
    assert run.summary["recorded"] == {
        "ego.left_camera": 31,
        "ego.front_lidar": 30,
        "ego.roof_lidar": 5,
        "ego.imu": 100,  # that of 1 s is of the step after it
    }
    assert "under_way" not in run.summary

    again = load_run(tmp_path / "run")
    pictures = again.pictures["ego.left_camera"]
    np.testing.assert_allclose([picture.time for picture in pictures], np.arange(31) / 30.0, atol=1e-6)  # both ends
    levels = [int(picture.pixels[5, 5, 0]) for picture in pictures]
    np.testing.assert_allclose(levels, 20 + np.arange(31), atol=1)  # each at its place, after threads wrote them
    assert set(again.arrays) == {"ego.front_lidar", "ego.roof_lidar", "ego.imu"}
    scans = again.arrays["ego.front_lidar"]
    np.testing.assert_allclose(scans.times, np.arange(30) / 30.0, atol=1e-12)
    assert scans["ranges"].dtype == np.float32
    assert np.array_equal(scans["ranges"], np.repeat(np.arange(30.0), BEAMS).reshape(30, BEAMS))
    clouds = again.arrays["ego.roof_lidar"]
    np.testing.assert_allclose(clouds.times, [0.0, 0.2, 0.4, 0.6, 0.8], atol=1e-12)
    assert clouds["ranges"].shape == (5, ROWS, COLUMNS)
    assert np.array_equal(clouds["ranges"][:, 1, 1], np.arange(5.0))
    assert np.isinf(clouds["ranges"][:, 0, 0]).all()
    assert clouds["azimuths"].shape == (5, COLUMNS)
    assert clouds.units["ranges"] == "m"
    assert not [column for column in map(str, again.signals) if "lidar" in column]
    assert "ego.imu.fz" in again.signals


@pytest.mark.usefixtures("stubbed")
def test_equal_runs_give_equal_files(tmp_path: Path) -> None:
    for name in ("a", "b"):
        simulate(drive(duration=0.5), folder=tmp_path / name)
    files = [path.relative_to(tmp_path / "a") for path in sorted((tmp_path / "a").rglob("*")) if path.is_file()]
    assert len(files) > 20
    differ = [
        str(file) for file in files if (tmp_path / "a" / file).read_bytes() != (tmp_path / "b" / file).read_bytes()
    ]
    assert set(differ) <= {"summary.json"}  # the wall time


@pytest.mark.usefixtures("stubbed")
def test_the_driving_log_is_that_of_the_paper(tmp_path: Path) -> None:
    record = {"cameras": True, "meshcat": False, "report": False, "start_time": "2026-05-31 12:00"}
    run = simulate(drive(duration=0.1, record=record), folder=tmp_path / "run")
    text = (tmp_path / "run" / "ego.left_camera" / "driving_log.txt").read_bytes().decode()
    lines = text.split("\r\n")
    assert lines.pop() == ""
    assert [line.split("\t")[0] for line in lines] == [
        f"2026-05-31-12-00-00-{us:06d}.jpg" for us in (0, 33333, 66667, 100000)
    ]
    name, steering, speed = lines[-1].split("\t")
    assert (tmp_path / "run" / "ego.left_camera" / name).is_file()
    assert float(speed) == run["ego.vx"].iloc[-1]  # in full precision
    assert float(steering) == pytest.approx(0.0, abs=1e-9)
    assert [picture.time for picture in load_run(tmp_path / "run").pictures["ego.left_camera"]] == pytest.approx(
        [0.0, 0.033333, 0.066667, 0.1], abs=1e-9
    )


def test_depths_and_labels_are_pictures_of_16_bits(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install_stubs(monkeypatch, several=True)
    simulate(drive(duration=0.1), folder=tmp_path / "run")
    pictures = load_run(tmp_path / "run").pictures
    assert {name: len(images) for name, images in pictures.items()} == {
        "ego.left_camera": 4,
        "ego.left_camera.depth": 4,
        "ego.left_camera.label": 4,
    }
    depth, label = pictures["ego.left_camera.depth"][3].pixels, pictures["ego.left_camera.label"][3].pixels
    assert depth.dtype == label.dtype == np.uint16
    assert depth[0, 0] == 0  # nothing there
    assert np.unique(depth[1:]).tolist() == [1500]  # mm
    assert np.unique(label).tolist() == [3]


@pytest.mark.usefixtures("stubbed")
def test_arrays_are_not_recorded_when_they_shall_not_be(tmp_path: Path) -> None:
    record = {"arrays": False, "meshcat": False, "report": False}
    simulate(drive(duration=0.1, record=record), folder=tmp_path / "run")
    assert set(load_run(tmp_path / "run").arrays) == {"ego.imu"}


def test_pictures_that_come_late_have_the_time_they_were_taken_and_lost_ones_are_not_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    latency, dropout = 0.15, 0.3

    def camera(mount: Any, **_: Any) -> LateCamera:
        return LateCamera(mount, latency=latency, dropout=dropout)

    monkeypatch.setattr(CameraMount, "make", camera)
    spec = drive(sensors={"ego": ["left_camera"]}, duration=2.0)
    spec["record"] = spec["record"] | {"rate": 1000.0}
    run = simulate(spec, folder=tmp_path / "run")
    numbers = [number for number in range(61) if not is_lost(7, number, dropout)]
    assert 30 < len(numbers) < 50
    late = [number for number in numbers if number / 30.0 + latency >= 2.0]  # the last ones nobody was shown
    assert run.summary["under_way"] == {"ego.left_camera": len(late)}
    assert len(late) >= 2
    pictures = load_run(tmp_path / "run").pictures["ego.left_camera"]
    np.testing.assert_allclose([picture.time for picture in pictures], np.array(numbers) / 30.0, atol=1e-6)
    levels = [int(picture.pixels[4, 4, 0]) for picture in pictures]
    np.testing.assert_allclose(levels, 20 + np.array(numbers), atol=1)
    speeds = np.interp([picture.time for picture in pictures], run.signals.index, run["ego.vx"])
    np.testing.assert_allclose([picture.speed for picture in pictures], speeds, atol=0.02)  # then, not when they came
    assert np.ptp(speeds) > 1.0


def test_a_lost_picture_leaves_no_file_and_no_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def camera(mount: Any, **_: Any) -> LateCamera:
        return LateCamera(mount, latency=0.0, dropout=0.3)

    monkeypatch.setattr(CameraMount, "make", camera)
    simulate(drive(sensors={"ego": ["left_camera"]}), folder=tmp_path / "run")
    there = [number for number in range(31) if not is_lost(7, number, 0.3)]
    assert len(there) < 31
    folder = tmp_path / "run" / "ego.left_camera"
    names = [f"1970-01-01-00-00-{round(1e6 * number / 30.0) / 1e6:09.6f}.jpg".replace(".", "-", 1) for number in there]
    assert [line.split("\t")[0] for line in (folder / "driving_log.txt").read_text().splitlines()] == names
    assert sorted(path.name for path in folder.glob("*.jpg")) == names


def test_each_sample_of_a_vector_sensor_is_recorded_at_its_own_rate(tmp_path: Path) -> None:
    mounts = {
        "imu": {"rate": 125.0},  # does not fall on the plant's steps
        "gps": {"rate": 20.0, "latency": 0.33, "dropout": 0.2},
    }
    spec = drive(sensors={"ego": ["imu", "gps"]}, vehicles={"ego": {"model": "catvehicle", "mounts": mounts}})
    spec["control"] = {"ego": {"kind": "constant", "speed": 2.0, "steering": 0.2}}
    spec["record"] = {"meshcat": False, "report": False, "rate": 10.0}
    simulate(spec, folder=tmp_path / "run")
    run = load_run(tmp_path / "run")
    imu, gps = run.arrays["ego.imu"], run.arrays["ego.gps"]
    np.testing.assert_allclose(imu.times, np.arange(126) / 125.0, atol=1e-12)
    assert imu.units == {"fx": "m/s²", "fy": "m/s²", "fz": "m/s²", "wx": "rad/s", "wy": "rad/s", "wz": "rad/s"}
    assert np.unique(imu["wz"]).size == 126  # noise of its own on each
    frame = pd.read_parquet(tmp_path / "run" / "ego.imu.parquet")
    assert frame["fz"].tolist() == imu["fz"].tolist() == imu.frame()["fz"].tolist()
    assert frame.attrs["units"]["wz"] == "rad/s"

    stream = noise_stream(0, "ego.gps")
    taken = np.array([number for number in range(21) if not is_lost(stream, number, 0.2)]) / 20.0
    assert 10 < taken.size < 21
    np.testing.assert_allclose(gps.times, taken, atol=1e-12)
    late = int((taken + 0.33 > 1.0 - 1e-9).sum())
    assert late > 3
    assert run.summary["under_way"] == {"ego.gps": late}
    assert run.summary["recorded"] == {"ego.imu": 126, "ego.gps": taken.size}
    # What signals.parquet shows of it is the newest that has arrived.
    shown = [gps["x"][taken + 0.33 <= time + 1e-6] for time in run.signals.index]
    expected = [values[-1] if values.size else np.nan for values in shown]
    np.testing.assert_array_equal(run["ego.gps.x"], expected)


@pytest.mark.parametrize("name", ["sick", "camera"])
def test_scans_and_pictures_on_their_way_at_the_end_are_kept(name: str, tmp_path: Path) -> None:
    if name == "sick":
        pytest.importorskip("embreex")
    elif rendering._egl_fault() is not None:
        pytest.skip("cameras cannot be drawn here")
    sensor = {"sick": "front_lidar", "camera": "left_camera"}[name]
    changes = {"rate": 20.0, "latency": 0.12} | ({"width": 32, "height": 24} if name == "camera" else {})
    spec = drive(vehicles={"ego": {"model": "catvehicle", "mounts": {sensor: changes}}}, sensors={"ego": [sensor]})
    spec["record"] = spec["record"] | {"cameras": name == "camera"}
    run = simulate(spec | {"duration": 0.5}, folder=tmp_path / "run")
    assert run.summary["recorded"] == {f"ego.{sensor}": 11}
    assert run.summary["under_way"] == {f"ego.{sensor}": 3}  # of 0.4, 0.45 and 0.5 s
    again = load_run(tmp_path / "run")
    times = (
        [p.time for p in again.pictures["ego.left_camera"]]
        if name == "camera"
        else again.arrays["ego.front_lidar"].times
    )
    np.testing.assert_allclose(times, np.arange(11) / 20.0, atol=1e-6)


def test_the_scans_of_a_laser_scanner_and_a_lidar_are_recorded(tmp_path: Path) -> None:
    pytest.importorskip("embreex")
    spec = drive(sensors={"ego": ["front_lidar", "roof_lidar"]}, duration=0.5)
    spec["record"] = {"meshcat": False, "report": False}
    simulate(spec, folder=tmp_path / "run")
    arrays = load_run(tmp_path / "run").arrays
    np.testing.assert_allclose(arrays["ego.front_lidar"].times, np.arange(16) / 30.0, atol=1e-9)
    np.testing.assert_allclose(arrays["ego.roof_lidar"].times, np.arange(3) / 5.0, atol=1e-9)
    assert arrays["ego.front_lidar"]["ranges"].shape == (16, 180)
    assert arrays["ego.roof_lidar"]["ranges"].shape == (3, 20, 100)
    np.testing.assert_allclose(arrays["ego.roof_lidar"]["beam_times"][:, -1], arrays["ego.roof_lidar"].times, atol=1e-9)


# --- formats ---------------------------------------------------------------------------------------------------------


def test_arrays_open_with_pandas_in_one_line(tmp_path: Path) -> None:
    log = ArrayLog(tmp_path / "lidar.parquet")
    for number in range(3):
        log.write(0.1 * number, make_scan(0.1 * number, number))
    log.close()
    ranges = np.stack(list(pd.read_parquet(tmp_path / "lidar.parquet")["ranges"]))
    assert ranges.shape == (3, ROWS * COLUMNS)
    assert ranges[2, 5] == 2.0


def test_arrays_of_varying_size_come_back_one_by_one(tmp_path: Path) -> None:
    log = ArrayLog(tmp_path / "echoes.parquet")
    sizes = [2, 0, 3]
    for number, size in enumerate(sizes):
        log.write(float(number), np.full(size, float(number)))
    log.close()
    echoes = RunArrays(tmp_path, apart=["signals.parquet"])["echoes"]
    assert [array.tolist() for array in echoes["ranges"]] == [[0.0, 0.0], [], [2.0, 2.0, 2.0]]
    assert [(moment, arrays["ranges"].size) for moment, arrays in echoes.each()] == [(0.0, 2), (1.0, 0), (2.0, 3)]


def test_how_parts_were_cut_does_not_show(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, wait in (("a", 0.0), ("b", 1e9)):
        monkeypatch.setattr("mirdrake.core.recording.parts.FLUSH_AFTER", wait)
        log = ArrayLog(tmp_path / f"{name}.parquet")
        for number in range(40):
            log.write(0.1 * number, make_scan(0.1 * number, number))
        if not wait:
            assert len(list((tmp_path / "a.parquet").glob("part-*.parquet"))) == 40
        log.close()
    assert (tmp_path / "a.parquet").read_bytes() == (tmp_path / "b.parquet").read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.parquet", "b.parquet"]


def test_a_table_whose_process_was_killed_between_two_renames_opens(tmp_path: Path) -> None:
    log = ArrayLog(tmp_path / "lidar.parquet")
    log.write(0.5, make_scan(0.5, 7))
    log.close()
    parts = tmp_path / ".lidar.parquet.parts"
    parts.mkdir()
    (tmp_path / "lidar.parquet").rename(parts / "part-000000.parquet")
    arrays = RunArrays(tmp_path, apart=["signals.parquet"])
    assert arrays["lidar"].times.tolist() == [0.5]
    with pytest.raises(ConfigError, match=r"no array 'range'; did you mean 'ranges'"):
        arrays["lidar"]["range"]
    with pytest.raises(ConfigError, match=r"no arrays of 'lida'; did you mean 'lidar'"):
        arrays["lida"]


def test_a_line_of_the_log_that_is_not_whole_does_not_count(tmp_path: Path) -> None:
    log = PictureLog(tmp_path / "camera")
    for number in range(3):
        log.write(0.04 * number, np.zeros((8, 8, 3), dtype=np.uint8), steering=0.0, speed=1.0)
    log.close()
    path = tmp_path / "camera" / "driving_log.txt"
    path.write_bytes(path.read_bytes()[:-3])
    assert [picture.time for picture in read_pictures(tmp_path / "camera")] == pytest.approx([0.0, 0.04])


def test_a_picture_that_cannot_be_written_by_a_thread_is_an_error_of_the_run(tmp_path: Path) -> None:
    with make_pool() as pool:
        log = PictureLog(tmp_path / "camera", pool=pool)
        (tmp_path / "camera").rename(tmp_path / "gone")
        with (
            pytest.raises(RunError, match=r"cannot be written: No such file or directory; choose another folder"),
            contextlib.closing(log),
        ):
            log.write(0.0, np.zeros((8, 8, 3), dtype=np.uint8), steering=0.0, speed=1.0)


def test_depths_beyond_16_bits_are_cut() -> None:
    data = encode(np.array([[0.0004, 1.2344, 70.0, np.nan, -1.0]], dtype=np.float32))
    with Image.open(io.BytesIO(data)) as image:
        assert np.asarray(image).tolist() == [[0, 1234, 65535, 0, 0]]


@pytest.mark.parametrize("text", ["yesterday", "2026-13-01", ""])
def test_a_start_time_that_is_not_a_date_is_rejected(text: str) -> None:
    with pytest.raises(ValueError, match="is not a date and time; write it as 2026-05-31 12:00"):
        RecordSpec(start_time=text)


def test_a_start_time_may_have_a_utc_offset() -> None:
    assert parse_start("2026-05-31T12:00+02:00").isoformat() == "2026-05-31T10:00:00+00:00"
    assert picture_time("2026-05-31-10-00-01-500000.jpg", parse_start("2026-05-31T12:00+02:00")) == 1.5


# --- whatever ends the run -------------------------------------------------------------------------------------------

RUN = dedent(
    """\
    import sys
    sys.path.insert(0, {root!r})
    from mirdrake.vehicles.mounts import SENSOR_KINDS
    from mirdrake.runs.simulation import simulate
    from tests.recording_rigs import stubs
    from tests.test_recording import drive
    for kind, make in stubs().items():
        SENSOR_KINDS[kind].make = make
    simulate(drive(duration=600.0), folder={folder!r}, realtime_rate=1.0)
    """
)


def test_a_killed_run_opens_with_at_most_the_last_second_missing(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    code = RUN.format(root=str(ROOT), folder=str(folder))
    process = subprocess.Popen([sys.executable, "-c", code], env=os.environ | {"OPENBLAS_NUM_THREADS": "1"})
    try:
        deadline = time.monotonic() + 300.0
        while len(list(folder.glob("ego.left_camera/*.jpg"))) < 60:
            assert process.poll() is None, "the run ended by itself"
            assert time.monotonic() < deadline, "no pictures after five minutes"
            time.sleep(0.02)
    finally:
        process.send_signal(signal.SIGKILL)
        process.wait()
    names = sorted(path.name for path in folder.glob("ego.left_camera/*.jpg"))
    end = picture_time(names[-1])  # the last that is known to have been simulated
    run = load_run(folder)
    assert run.summary["stop_reason"] == "killed"
    pictures = run.pictures["ego.left_camera"]
    assert len(pictures) >= len(names) - 7  # those that were being written
    assert all(picture.pixels.shape == (800, 800, 3) for picture in pictures[-8:])
    np.testing.assert_allclose([p.time for p in pictures], np.arange(len(pictures)) / 30.0, atol=1e-6)
    assert run.signals.index[-1] > end - 1.0
    for name in ("ego.front_lidar", "ego.roof_lidar", "ego.imu"):
        times = run.arrays[name].times
        assert times[-1] > end - 1.0
        assert (np.diff(times) > 0.0).all()


def test_a_run_that_fails_keeps_its_pictures_and_scans(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install_stubs(monkeypatch)
    (tmp_path / "failing.py").write_text(
        dedent(
            """\
            from pydrake.systems.framework import BasicVector, LeafSystem


            class Failing(LeafSystem):
                def __init__(self):
                    super().__init__()
                    self.DeclareVectorOutputPort("y", BasicVector(1), self.calc)

                def calc(self, context, output):
                    if context.get_time() > 0.5:
                        raise ZeroDivisionError("no more")
            """
        ),
        encoding="utf-8",
    )
    spec = drive(systems={"own": {"kind": "failing:Failing"}}, folder=str(tmp_path))
    with pytest.raises(RunError, match="no more"):
        simulate(spec, folder=tmp_path / "run")
    run = load_run(tmp_path / "run")
    assert len(run.pictures["ego.left_camera"]) == 16  # 0 .. 0.5 s
    assert (tmp_path / "run" / "ego.roof_lidar.parquet").is_file()
    assert run.arrays["ego.roof_lidar"].times.tolist() == pytest.approx([0.0, 0.2, 0.4])


def resident() -> int:
    """Return the memory of this process [bytes]."""
    return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1]) * os.sysconf("SC_PAGE_SIZE")


@pytest.mark.slow
@pytest.mark.usefixtures("stubbed")
def test_memory_is_flat_over_two_thousand_pictures(tmp_path: Path) -> None:
    grown: list[int] = []

    def progress(time: float, end: float) -> None:
        if time > 6.0 and not grown:
            grown.append(resident())

    simulate(drive(duration=74.0), folder=tmp_path / "run", progress=progress)
    growth = resident() - grown[0]
    run = load_run(tmp_path / "run")
    assert len(run.pictures["ego.left_camera"]) == 74 * 30 + 1
    assert pq.read_metadata(tmp_path / "run" / "ego.front_lidar.parquet").num_rows == 74 * 30
    assert growth < 50e6, f"{growth / 1e6:.0f} MB"
