"""Driving data: labels at the exposure, conditions, splits by place, changes of pictures, speed, memory, faults."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import mirdrake as mir
from mirdrake.core.errors import ConfigError
from mirdrake.learning.data import DrivingData
from mirdrake.learning.preparation import CropSpec, Preparation, area_matrix
from tests.learning_rigs import LENGTH, SPEED, write_run


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_run(tmp_path_factory.mktemp("driving") / "run")


def test_a_label_is_the_command_at_the_exposure(run: Path, tmp_path: Path) -> None:
    data = mir.driving_data(run, folder=tmp_path)
    assert len(data) == 801
    assert data.values[:, 0] == pytest.approx(np.sin(data.times), abs=1e-9)
    picture, label = data[37]
    assert picture.shape == (6, 8, 3)
    assert picture[3, 1, 0] == pytest.approx(137, abs=4)  # JPEG
    assert label == pytest.approx([np.sin(3.7)])


def test_a_lead_reads_later_commands_and_drops_the_end_of_the_run(run: Path, tmp_path: Path) -> None:
    data = mir.driving_data(run, lead=0.15, folder=tmp_path)
    assert data.values[:, 0] == pytest.approx(np.sin(data.times + 0.15), abs=1e-4)  # between samples of 0.02 s
    assert data.times[-1] == pytest.approx(79.8)


def test_a_condition_selects_pictures(run: Path, tmp_path: Path) -> None:
    data = mir.driving_data(run, where="abs lateral_error < 0.5 m and speed > 4 m/s", folder=tmp_path)
    assert len(data) == int(np.sum(np.abs(np.cos(0.1 * np.arange(801))) < 0.5))
    with pytest.raises(ConfigError, match="unknown signal 'lateral_erorr'; did you mean 'lateral_error'"):
        mir.driving_data(run, where="lateral_erorr < 1", folder=tmp_path)


def test_training_and_validation_are_apart_along_the_track(run: Path, tmp_path: Path) -> None:
    training, validation = mir.driving_data(run, folder=tmp_path).split(0.2, gap=20.0)
    first, second = (np.mod(SPEED * part.times, LENGTH) for part in (training, validation))
    apart = np.abs(first[:, np.newaxis] - second[np.newaxis, :])
    assert np.minimum(apart, LENGTH - apart).min() >= 20.0 - 1e-6
    assert len(validation) == pytest.approx(0.2 * 801, abs=4)
    with pytest.raises(ConfigError, match="leaves nothing for training with a gap of 200 m"):
        mir.driving_data(run, folder=tmp_path).split(0.2, gap=200.0)


def test_a_short_first_run_does_not_shorten_the_track(run: Path, tmp_path: Path) -> None:
    short = write_run(tmp_path / "short", seconds=10.0)
    training, validation = mir.driving_data([short, run], folder=tmp_path).split(0.2, gap=20.0)
    _, alone = mir.driving_data(run, folder=tmp_path).split(0.2, gap=20.0)
    assert len(validation) == len(alone)  # the short run ends before the first place for validation, 64 m
    assert (training.table["run"] == 0).any()


def test_mirrored_pictures_have_opposite_labels(run: Path, tmp_path: Path) -> None:
    data = mir.driving_data(run, folder=tmp_path)
    seen = 0
    for pictures, _, labels, _ in data.batches(64, seed=1, mirror=True):
        number = np.rint(pictures[:, 3].max(axis=(1, 2)) - 100.0)
        is_mirrored = pictures[:, 3, 6, 0] > 50.0
        seen += int(is_mirrored.sum())
        plain = np.where(is_mirrored, -1.0, 1.0) * labels[:, 0]
        distance = np.abs(plain[:, np.newaxis] - np.sin(0.1 * (number[:, np.newaxis] + 100.0 * np.arange(9))))
        assert np.median(distance.min(axis=1)) < 0.1  # JPEG changes some numbers by a few units
    assert 300 < seen < 500


def test_mirrored_pictures_have_mirrored_inputs(run: Path, tmp_path: Path) -> None:
    data = mir.driving_data(run, inputs=["ego.vx", "ego.lateral_error"], folder=tmp_path)
    for pictures, inputs, labels, _ in data.batches(64, seed=1, mirror=True):
        sign = np.where(pictures[:, 3, 6, 0] > 50.0, -1.0, 1.0)
        assert inputs[:, 0] == pytest.approx(np.full(len(labels), SPEED))
        # The label is sin(t) and the lateral error cos(t); the time is that of the picture.
        assert labels[:, 0] ** 2 + inputs[:, 1] ** 2 == pytest.approx(np.ones(len(labels)), abs=1e-3)
        number = np.rint(pictures[:, 3].max(axis=(1, 2)) - 100.0)
        times = 0.1 * (number[:, np.newaxis] + 100.0 * np.arange(9))
        away = np.abs(sign[:, np.newaxis] * inputs[:, 1:] - np.cos(times)) + np.abs(
            sign[:, np.newaxis] * labels[:, :1] - np.sin(times)
        )
        assert np.median(away.min(axis=1)) < 0.2  # JPEG changes some numbers by a few units
    data = mir.driving_data(run, inputs=["ego.progress"], folder=tmp_path)
    with pytest.raises(ConfigError, match=r"input 'ego\.progress' has no known mirrored value"):
        next(data.batches(64, mirror=True))
    assert next(data.batches(64)).inputs.shape == (64, 1)


def test_batches_repeat_with_a_seed_and_stay_within_the_range(run: Path, tmp_path: Path) -> None:
    data = mir.driving_data(run, folder=tmp_path)
    options: dict[str, Any] = {"mirror": True, "brightness": 0.3, "noise": 0.05}
    first, second, other = (
        np.concatenate([batch.pictures for batch in data.batches(64, seed=seed, **options)]) for seed in (3, 3, 4)
    )
    assert np.array_equal(first, second)
    assert not np.array_equal(first, other)
    assert first.min() >= 0.0
    assert first.max() <= 255.0


def test_weights_raise_rare_labels(run: Path, tmp_path: Path) -> None:
    data = mir.driving_data(run, folder=tmp_path)
    assert data.weights.mean() == pytest.approx(1.0)
    size = np.abs(data.values[:, 0])
    assert data.weights[size < 0.1].mean() > data.weights[size > 0.98].mean()  # a sine is most often at its ends


def test_area_resizing_keeps_means_and_is_exact_for_whole_factors() -> None:
    assert area_matrix(4, 2) == pytest.approx(np.array([[0.5, 0.5, 0, 0], [0, 0, 0.5, 0.5]]))
    assert area_matrix(3, 2) == pytest.approx(np.array([[2 / 3, 1 / 3, 0], [0, 1 / 3, 2 / 3]]))
    pixels = np.arange(6 * 8 * 3, dtype=np.uint8).reshape(6, 8, 3)
    prepared = Preparation(8, 6, CropSpec(top=2), (4, 2))(pixels)
    expected = pixels[2:].reshape(2, 2, 4, 2, 3).astype(float).mean(axis=(1, 3))
    assert prepared == pytest.approx(np.rint(expected))


def test_a_missing_picture_is_reported_in_one_line(tmp_path: Path) -> None:
    folder = write_run(tmp_path / "run", seconds=4.0)
    missing = sorted((folder / "ego.front_camera").glob("*.jpg"))[7]
    missing.unlink()
    with pytest.raises(
        ConfigError, match=r"-700000\.jpg: is in the driving log, but there is no such picture"
    ) as error:
        mir.driving_data(folder, folder=tmp_path / "data")
    assert "\n" not in str(error.value)


def test_a_log_that_does_not_match_is_reported_in_one_line(tmp_path: Path) -> None:
    folder = write_run(tmp_path / "run", seconds=4.0)
    log = folder / "ego.front_camera" / "driving_log.txt"
    log.write_bytes(log.read_bytes().replace(b"00-00-03-", b"00-09-03-"))
    with pytest.raises(ConfigError, match=r"the driving log does not match the signals: its last picture is of 543"):
        mir.driving_data(folder, folder=tmp_path / "data")


def test_other_faults_are_reported_in_one_line(run: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"no pictures of 'ego.camera'; cameras with pictures: ego\.front_camera"):
        mir.driving_data(run, image="ego.camera")
    with pytest.raises(ConfigError, match=r"no signal 'ego.steering'; did you mean 'ego.steering_command'"):
        mir.driving_data(run, label="ego.steering", folder=tmp_path)
    with pytest.raises(ConfigError, match="crop: nothing is left of pictures of 8 x 6 pixels"):
        mir.driving_data(run, crop={"top": 6}, folder=tmp_path)
    other = write_run(tmp_path / "other", seconds=1.0, width=16)
    with pytest.raises(ConfigError, match="a picture has 16 x 6 pixels, the others 8 x 6"):
        mir.driving_data([run, other], folder=tmp_path / "data")


def test_the_pictures_are_stored_once(run: Path, tmp_path: Path) -> None:
    first = mir.driving_data(run, folder=tmp_path)
    written = first.file.stat().st_mtime_ns
    assert mir.driving_data(run, folder=tmp_path).file.stat().st_mtime_ns == written
    assert mir.driving_data(run, crop={"top": 1}, folder=tmp_path).file != first.file


READ_ALL = """
import sys, time
from pathlib import Path
from typing import Any
import numpy as np, pandas as pd
from mirdrake.learning.data import DrivingData
from mirdrake.learning.preparation import CropSpec, Preparation
count = 36_000
table = pd.DataFrame({"row": np.arange(count), "time": 0.1 * np.arange(count), "place": 0.0, "label": 0.0})
data = DrivingData(Path(sys.argv[1]), table, (), ("label",), Preparation(200, 66, CropSpec()))
began = time.process_time()
options = {"seed": 0, "mirror": True, "brightness": 0.2, "noise": 0.01}
read = sum(len(batch.labels) for batch in data.batches(64, **options))
largest = next(line for line in open("/proc/self/status") if line.startswith("VmHWM"))  # of this process alone
print(read, read / (time.process_time() - began), int(largest.split()[1]) / 1024)
"""


@pytest.mark.slow
def test_36_000_pictures_are_read_at_2000_a_second_within_500_mb(tmp_path: Path) -> None:
    file = tmp_path / "pictures.npy"
    array = np.lib.format.open_memmap(file, mode="w+", dtype=np.uint8, shape=(36_000, 66, 200, 3))
    for begin in range(0, len(array), 1000):
        array[begin : begin + 1000] = np.arange(1000, dtype=np.uint8)[:, np.newaxis, np.newaxis, np.newaxis]
    array.flush()
    del array
    done = subprocess.run([sys.executable, "-c", READ_ALL, str(file)], capture_output=True, text=True, check=True)
    read, rate, memory = map(float, done.stdout.split())
    assert read == 36_000
    assert rate > 2000.0
    assert memory < 500.0


def test_data_without_a_place_cannot_be_split() -> None:
    table = pd.DataFrame({"row": [0], "time": [0.0], "place": [np.nan], "track": ["a"], "length": [np.nan]})
    data = DrivingData(Path("none.npy"), table, (), (), Preparation(8, 6, CropSpec()))
    with pytest.raises(ConfigError, match="no progress along a track"):
        data.split()
