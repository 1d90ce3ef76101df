"""Pictures of cameras, in files named by time, and their driving log.

A picture is named ``YYYY-mm-dd-HH-MM-SS-ffffff`` after the simulated time from a start time; the default is 1970-01-01,
so that equal runs give equal files. ``driving_log.txt`` has a line for each picture: its name, the steering angle [rad]
and the speed [m/s] in full precision, separated by tabs, ended by carriage return and line feed. The numbers are
measurements, not commands.

Colours are JPEG. Depths are PNG of 16 bits in millimetres, 0 where there is none; labels are PNG of 16 bits.
"""

import io
import os
from collections import deque
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from mirdrake.core.files import read_errors, write_errors, write_file

DRIVING_LOG = "driving_log.txt"

JPEG_QUALITY = 90
"""Of pictures, 1 .. 95."""

WAITING = 6
"""Pictures of a camera that may wait for being written: what they take of memory, and what a kill can lose."""

EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_NAME = "%Y-%m-%d-%H-%M-%S-%f"


def parse_start(text: str | None) -> datetime:
    """Return the date and time of the start of a run; UTC if it has no time zone.

    Args:
        text: for example ``2026-05-31 12:00``; None: 1970-01-01.

    Raises:
        ValueError: the text is not a date and time.
    """
    try:
        moment = EPOCH if text is None else datetime.fromisoformat(text)
    except ValueError:
        raise ValueError(f"'{text}' is not a date and time; write it as 2026-05-31 12:00") from None
    return moment.replace(tzinfo=UTC) if moment.tzinfo is None else moment.astimezone(UTC)


def picture_name(time: float, start: datetime = EPOCH) -> str:
    """Return a simulated time [s] as date and time after a start, to the microsecond."""
    # Rounded to whole microseconds as an integer; a float of seconds would lose the last digits of a date.
    return (start + timedelta(microseconds=round(1e6 * time))).strftime(_NAME)


def picture_time(name: str, start: datetime = EPOCH) -> float:
    """Return the simulated time [s] of a picture's name, with or without a suffix.

    Raises:
        ValueError: the text is not the name of a picture.
    """
    moment = datetime.strptime(name.partition(".")[0], _NAME).replace(tzinfo=UTC)
    return (moment - start) / timedelta(microseconds=1) * 1e-6


def make_pool() -> ThreadPoolExecutor:
    """Return threads that encode and write pictures while the next ones are rendered; Pillow releases Python's lock."""
    return ThreadPoolExecutor(min(2, os.cpu_count() or 1), thread_name_prefix="pictures")


class PictureLog:
    """Writer of the pictures of one camera during a run, with steering angle and speed of the vehicle at each.

    Pictures are encoded and written by a pool of threads; a line of the driving log is written when its picture is on
    disk, in order. Without a pool all is done at once.

    Args:
        folder: is made.
        pool: pool of threads; shared by all cameras.
        start: date and time of the start of the run.

    Raises:
        RunError: the folder cannot be written.
    """

    def __init__(self, folder: Path, *, pool: ThreadPoolExecutor | None = None, start: datetime = EPOCH) -> None:
        self._folder, self._pool, self._start = folder, pool, start
        self._waiting: deque[tuple[Future[None], str]] = deque()
        with write_errors(folder):
            folder.mkdir()
            self._log = (folder / DRIVING_LOG).open("ab", buffering=0)
        self.count = 0

    def write(self, time: float, pixels: NDArray[Any], *, steering: float, speed: float) -> None:
        """Add a picture.

        Args:
            time: simulated time [s].
            pixels: colours uint8 (height, width, 3), depths float32 [m], or numbers of 16 bits (height, width).
            steering: measured bicycle steering angle, positive to the left [rad].
            speed: measured speed of the vehicle frame's origin, forward [m/s].
        """
        name = picture_name(time, self._start) + (".jpg" if pixels.dtype == np.uint8 else ".png")
        line = f"{name}\t{float(steering)!r}\t{float(speed)!r}\r\n"
        if pixels.flags.writeable:
            pixels = pixels.copy()  # the next one may be drawn into it meanwhile
        task = partial(_write_picture, self._folder / name, pixels)
        self.count += 1
        if self._pool is None:
            task()
            self._print_line(line)
            return
        self._waiting.append((self._pool.submit(task), line))
        self._settle(WAITING)

    def flush(self) -> None:
        """Wait until all pictures are on disk."""
        self._settle(0)

    def close(self) -> None:
        """Write all pictures to disk, and finish."""
        try:
            self.flush()
        finally:
            self._log.close()

    def _settle(self, limit: int) -> None:
        """Log the pictures that are written; wait for the first ones if more than so many are not."""
        # Only from the front: lines of the log stay in the order of time even if a later picture is ready first.
        while self._waiting and (len(self._waiting) > limit or self._waiting[0][0].done()):
            future, line = self._waiting.popleft()
            # Raises the error of the thread, such as a full disk, in the thread of the simulation.
            future.result()
            self._print_line(line)

    def _print_line(self, line: str) -> None:
        with write_errors(self._folder / DRIVING_LOG):
            self._log.write(line.encode())


def _write_picture(path: Path, pixels: NDArray[Any]) -> None:
    write_file(path, encode(pixels))


def encode(pixels: NDArray[Any]) -> bytes:
    """Return a picture as the bytes of a file: JPEG of colours, PNG of depths and labels.

    Args:
        pixels: colours uint8 (height, width, 3), depths float32 [m], or numbers of 16 bits (height, width).
    """
    file = io.BytesIO()
    if pixels.dtype == np.uint8:
        Image.fromarray(np.ascontiguousarray(pixels)).save(file, "JPEG", quality=JPEG_QUALITY)
    else:
        values = pixels[:, :, 0] if pixels.ndim == 3 else pixels
        if np.issubdtype(values.dtype, np.floating):
            # Millimetres as 16-bit integers reach 65.535 m; farther depths are limited to it, and 0 stands for none.
            values = np.where(np.isfinite(values), np.clip(np.rint(1e3 * values), 0, 65535), 0)
        Image.fromarray(np.ascontiguousarray(values.astype(np.uint16))).save(file, "PNG", compress_level=1)
    return file.getvalue()


@dataclass(frozen=True)
class Picture:
    """A recorded picture.

    Attributes:
        time: simulated [s].
        path: path of the file.
        steering: measured bicycle steering angle [rad].
        speed: measured speed [m/s].
    """

    time: float
    path: Path
    steering: float
    speed: float

    @property
    def pixels(self) -> NDArray[Any]:
        """Colours uint8 (height, width, 3), or numbers uint16 (height, width), depths in mm."""
        with read_errors(self.path), Image.open(self.path) as image:
            return np.asarray(image)


def read_pictures(folder: Path, start: datetime = EPOCH) -> list[Picture]:
    """Return the pictures in the driving log of a folder; an incomplete last line is ignored.

    Args:
        folder: folder of one camera.
        start: date and time of the start of the run.
    """
    with read_errors(folder / DRIVING_LOG):
        lines = (folder / DRIVING_LOG).read_bytes().decode().splitlines(keepends=True)
        # Only complete lines: a kill may leave half of one.
        rows = [line.split() for line in lines if line.endswith("\n")]
        return [
            Picture(picture_time(name, start), folder / Path(name).name, float(steering), float(speed))
            for name, steering, speed in rows
        ]


def picture_folders(folder: Path | None) -> Sequence[Path]:
    """Return the folders of a run that have pictures."""
    return [] if folder is None else sorted(path.parent for path in folder.glob(f"*/{DRIVING_LOG}"))
