"""Driving data: recorded pictures with the expert's commands, for learning.

::

    data = mir.driving_data(["runs/a", "runs/b"], image="ego.front_camera", label="ego.steering_command",
                            where="abs lateral_error < 1 m", crop={"top": 50})
    training, validation = data.split(validation=0.2, gap=20.0)
    for pictures, inputs, labels, weights in training.batches(64, seed=0, mirror=True, brightness=0.2, noise=0.01):
        ...

A label is read at the time at which the picture was exposed, or `lead` later: a command that is computed from a picture
acts after the delay of the loop, and should be the one that the expert gives by then.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.lib.format import open_memmap
from numpy.typing import NDArray

from mirdrake.core.digest import digest_data
from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.files import replacing, write_errors
from mirdrake.core.paths import cache_folder
from mirdrake.core.recording.pictures import Picture
from mirdrake.core.yaml_io import Source, validate
from mirdrake.learning.mirroring import mirror_signs
from mirdrake.learning.preparation import CropSpec, Preparation
from mirdrake.learning.selection import holds, value_at
from mirdrake.runs.logs import Run, load_run

Array = NDArray[np.float64]

NOISE_BANK = 1 << 22
"""Random numbers that are drawn once for an epoch; each picture takes a part of them from a random place."""

BINS = 31
"""Intervals of the labels, by whose counts pictures are weighted."""


class Batch(NamedTuple):
    """Pictures of one step of training.

    Attributes:
        pictures: float32 (n, height, width, 3), 0 to 255.
        inputs: further inputs float32 (n, inputs).
        labels: float32 (n, labels).
        weights: float32 (n), 1 on average over the data.
    """

    pictures: NDArray[np.float32]
    inputs: NDArray[np.float32]
    labels: NDArray[np.float32]
    weights: NDArray[np.float32]


@dataclass(frozen=True)
class DrivingData:
    """Pairs of a picture and a label, indexable; the pictures stay in a file.

    Attributes:
        file: array of all pictures uint8 (n, height, width, 3), a NumPy file.
        table: a row for each pair: `row` in the file, run, time [s], place [m], the inputs and labels.
        inputs: names of the further inputs.
        labels: names of the labels.
        preparation: cropping and resizing that the pictures have gone through.
    """

    file: Path
    table: pd.DataFrame
    inputs: tuple[str, ...]
    labels: tuple[str, ...]
    preparation: Preparation

    def __len__(self) -> int:
        return len(self.table)

    def __getitem__(self, index: int) -> tuple[NDArray[np.uint8], Array]:
        """Return a picture uint8 (height, width, 3) and its labels (n)."""
        row = self.table.iloc[index]
        return np.array(self._pictures()[int(row["row"])]), row[list(self.labels)].to_numpy(dtype=float)

    @property
    def times(self) -> Array:
        """Time of the exposure of each picture since the start of its run [s]."""
        return self.table["time"].to_numpy(dtype=float)

    @property
    def values(self) -> Array:
        """Labels (n, labels)."""
        return self.table[list(self.labels)].to_numpy(dtype=float)

    @property
    def weights(self) -> Array:
        """Weights that balance rare labels, 1 on average: by the square root of how rare the first label is."""
        first = self.values[:, 0]
        # The square root is a compromise: full balancing would give single rare labels the weight of whole bins.
        counts, edges = np.histogram(first, bins=BINS)
        bins = np.clip(np.digitize(first, edges[1:-1]), 0, BINS - 1)
        weights: Array = 1.0 / np.sqrt(np.maximum(counts[bins], 1))
        return np.asarray(weights / weights.mean()) if len(weights) else weights

    def where(self, rows: NDArray[np.bool_]) -> "DrivingData":
        """Return the pairs for which `rows` (n) is true."""
        return replace(self, table=self.table[rows].reset_index(drop=True))

    def split(
        self, validation: float = 0.1, *, gap: float = 20.0, parts: int = 5
    ) -> tuple["DrivingData", "DrivingData"]:
        """Return the data for training and for validation, split by place along the track.

        Each track is divided into `parts` of equal length, and the end of each part is for validation. Pictures for
        training within `gap` of it are left out, as neighbouring pictures are nearly equal.

        Args:
            validation: share of the length for validation.
            gap: least distance along the track between the two [m].
            parts: number of parts.

        Raises:
            ConfigError: the runs have no place along a track, or are too short for the gap.
        """
        # A random split would put near duplicates of training pictures into the validation.
        if self.table["place"].isna().any():
            raise ConfigError("the runs have no progress along a track, so the pictures cannot be split by place")
        training, held_out = np.zeros(len(self), dtype=bool), np.zeros(len(self), dtype=bool)
        # Runs of the same world share a track, so that no place is in both parts by different runs.
        for rows in self.table.groupby("track").indices.values():
            place = self.table["place"].to_numpy(dtype=float)[rows]
            # A run that ends early has not seen the whole track, so the longest progress of all runs counts.
            length = float(self.table["length"].to_numpy(dtype=float)[rows].max())
            # Every part loses a gap at both ends, next to the validation of this part and of the one before.
            part = length / parts
            if part * (1.0 - validation) <= 2.0 * gap:
                raise ConfigError(
                    f"a track of {length:.0f} m in {parts} parts leaves nothing for training with a gap of {gap:g} m"
                )
            within = np.mod(place, part)
            first = part * (1.0 - validation)
            held_out[rows] = within >= first
            training[rows] = (within >= gap) & (within <= first - gap)
        if not training.any() or not held_out.any():
            raise ConfigError("too few places for a split: drive farther, or reduce validation and gap")
        return self.where(training), self.where(held_out)

    def batches(
        self,
        size: int,
        *,
        seed: int | Sequence[int] | None = None,
        mirror: bool = False,
        brightness: float = 0.0,
        noise: float = 0.0,
    ) -> Iterator[Batch]:
        """Yield all pairs once in batches, in random order if there is a seed.

        Args:
            size: pairs in each batch; the last one may be smaller.
            seed: of order and changes; None: in order.
            mirror: mirror half of the pictures with their inputs, and change the signs of their labels.
            brightness: each picture is multiplied by a factor within 1 ± brightness.
            noise: standard deviation of noise on each colour, full scale 1.

        Raises:
            ConfigError: an input has no mirrored value; see :mod:`mirdrake.learning.mirroring`.
        """
        random = np.random.default_rng(seed)
        # One random stream in a fixed order of calls: equal seeds give equal batches.
        order = random.permutation(len(self)) if seed is not None else np.arange(len(self))
        rows, labels = self.table["row"].to_numpy(), self.values.astype(np.float32)
        inputs, weights = self.table[list(self.inputs)].to_numpy(dtype=np.float32), self.weights.astype(np.float32)
        signs = mirror_signs(self.inputs) if mirror else None
        # Drawing new noise for every pixel would take longer than the training step.
        bank = random.standard_normal(NOISE_BANK, dtype=np.float32) * np.float32(255.0 * noise) if noise else None
        for begin in range(0, len(order), size):
            chosen = order[begin : begin + size]
            stored = self._pictures()  # mapped anew, so that pages that were read do not stay in memory
            # Reading in the order of the file, then back into that of the batch: the double argsort is the inverse
            # permutation.
            pictures = stored[np.sort(rows[chosen])][np.argsort(np.argsort(rows[chosen]))].astype(np.float32)
            # Indexing with an array copies, so that the change of signs stays within this batch.
            label, given = labels[chosen], inputs[chosen]
            if signs is not None:
                turned = random.random(len(chosen)) < 0.5
                pictures[turned] = pictures[turned, :, ::-1]
                label[turned] *= -1.0
                given[turned] *= signs
            if brightness:
                factors = random.uniform(1.0 - brightness, 1.0 + brightness, len(chosen))
                pictures *= factors.astype(np.float32)[:, np.newaxis, np.newaxis, np.newaxis]
            if bank is not None:
                count = pictures[0].size
                for picture, start in zip(pictures, random.integers(0, NOISE_BANK - count, len(chosen)), strict=True):
                    picture += bank[start : start + count].reshape(picture.shape)
            # Cameras saturate, too.
            if brightness or noise:
                np.clip(pictures, 0.0, 255.0, out=pictures)
            yield Batch(pictures, given, label, weights[chosen])

    def _pictures(self) -> NDArray[np.uint8]:
        stored: NDArray[np.uint8] = np.load(self.file, mmap_mode="r")
        return stored


def driving_data(
    runs: Sequence[Run | Path | str] | Run | Path | str,
    *,
    image: str = "ego.front_camera",
    label: str | Sequence[str] = "ego.steering_command",
    inputs: Sequence[str] = (),
    where: str | None = None,
    lead: float = 0.0,
    crop: CropSpec | Mapping[str, int] | None = None,
    size: tuple[int, int] | None = None,
    folder: Path | None = None,
) -> DrivingData:
    """Return the pictures of runs with the commands of the expert at the time of exposure.

    Args:
        runs: runs or their folders.
        image: name of the camera; ``<vehicle>.<camera>``.
        label: signals that are learnt.
        inputs: signals that the network takes besides the picture.
        where: condition on the signals of the vehicle, such as ``"abs lateral_error < 1 m and speed > 1 m/s"``; see
            :mod:`mirdrake.requirements`.
        lead: labels are read so much after the exposure [s].
        crop: pixels to cut off: top, bottom, left, right.
        size: width and height to resize the cropped pictures to [pixel].
        folder: for the array of pictures; by default a cache folder. It is reused if it has the same data.

    Raises:
        ConfigError: a run has no such pictures or signals, a picture is missing, or nothing is left.
    """
    given = [runs] if isinstance(runs, Run | Path | str) else list(runs)
    loaded = [run if isinstance(run, Run) else load_run(run) for run in given]
    labels, names = (label,) if isinstance(label, str) else tuple(label), tuple(inputs)
    spec = crop if isinstance(crop, CropSpec) else validate(dict(crop or {}), CropSpec, Source("crop", {}))
    tables, pictures = [], []
    for index, run in enumerate(loaded):
        # Tables keep the index of their run, by which DAgger treats runs separately.
        rows, used = _pairs(run, index, image, labels, names, where=where, lead=lead)
        tables.append(rows)
        pictures += used
    table = pd.concat(tables, ignore_index=True)
    if table.empty:
        raise ConfigError(f"no picture of {image} is left; check `where` and the driving logs")
    table["row"] = np.arange(len(table))
    first = pictures[0].pixels
    preparation = Preparation(first.shape[1], first.shape[0], spec, size)
    file = _store(pictures, preparation, spec, folder)
    return DrivingData(file, table, names, labels, preparation)


def _pairs(
    run: Run,
    index: int,
    image: str,
    labels: tuple[str, ...],
    inputs: tuple[str, ...],
    *,
    where: str | None,
    lead: float,
) -> tuple[pd.DataFrame, list[Picture]]:
    """Return a row for each picture of a run that is used, and these pictures."""
    place = str(run.folder or "run")
    if image not in run.pictures:
        recorded = ", ".join(sorted(run.pictures)) or "none; set record: {cameras: true}"
        raise ConfigError(f"no pictures of '{image}'; cameras with pictures: {recorded}", where=place)
    pictures = run.pictures[image]
    signals = run.signals
    for name in (*labels, *inputs):
        if name not in signals:
            raise ConfigError(f"no signal '{name}'; {did_you_mean(name, map(str, signals.columns))}", where=place)
    # A second of tolerance: the last picture may be exposed after the last sample of the signals.
    times = np.array([picture.time for picture in pictures])
    end = float(signals.index[-1]) if len(signals) else -1.0
    if times.max(initial=end) > end + 1.0:
        raise ConfigError(
            f"the driving log does not match the signals: its last picture is of {times.max():g} s, "
            f"the last sample of {end:g} s",
            where=place,
        )
    missing = next((picture.path for picture in pictures if not picture.path.is_file()), None)
    if missing is not None:
        raise ConfigError(
            "is in the driving log, but there is no such picture; record the run again", file=str(missing)
        )

    # Labels that would be read after the end of the run do not exist.
    usable = times + lead <= end + 1e-9
    vehicle = image.partition(".")[0]
    if where is not None:
        usable &= holds(where, run, vehicle, times)
    data: dict[str, Any] = {"run": index, "time": times}
    data |= {name: value_at(signals, name, times) for name in inputs}
    data |= {name: value_at(signals, name, times + lead) for name in labels}
    progress = f"{vehicle}.progress"
    # Held, not interpolated: between the end of a lap and the next one, interpolation would give places in between.
    data["place"] = value_at(signals, progress, times, held=True) if progress in signals else np.nan
    # The world identifies the track, also between runs of different studies.
    data["track"] = digest_data({"world": run.spec.get("world"), "progress": progress})[:12]
    data["length"] = float(signals[progress].max()) if progress in signals and len(signals) else np.nan
    table = pd.DataFrame(data)[usable]
    return table, [picture for picture, keep in zip(pictures, usable, strict=True) if keep]


def _store(pictures: Sequence[Picture], preparation: Preparation, crop: CropSpec, folder: Path | None) -> Path:
    """Write the prepared pictures as one array, unless it exists, and return its file."""
    # Times of modification instead of contents: hashing thousands of pictures would take as long as preparing them.
    stamps = [(str(picture.path.resolve()), picture.path.stat().st_mtime_ns) for picture in pictures]
    key = digest_data({"pictures": stamps, "crop": crop.model_dump(), "shape": preparation.shape})
    file = (folder or cache_folder("driving_data")) / f"pictures-{key[:16]}.npy"
    if file.is_file():
        return file
    with write_errors(file):
        file.parent.mkdir(parents=True, exist_ok=True)
    with replacing(file) as temporary:
        array = open_memmap(temporary, mode="w+", dtype=np.uint8, shape=(len(pictures), *preparation.shape, 3))
        for index, picture in enumerate(pictures):
            try:
                array[index] = preparation(picture.pixels)
            except ConfigError as error:
                # A picture that cannot be read is named already.
                raise (error if error.where == str(picture.path) else error.under(str(picture.path))) from None
        array.flush()
        # Closes the mapping before the file is renamed.
        del array
    return file
