"""Export of a camera's pictures as a video: MP4 with H.264, each frame at its simulated time."""

from fractions import Fraction
from pathlib import Path

import numpy as np

from mirdrake.core.errors import RunError
from mirdrake.core.extras import import_extra
from mirdrake.core.files import replacing, write_errors
from mirdrake.core.recording.pictures import Picture
from mirdrake.runs.logs import Run, reads_run

TICKS = 90_000
"""Rate of the video's clock [Hz]; times have a resolution of 11 µs."""

QUALITY = 20
"""Constant rate factor of H.264; a lower one gives a better and larger video."""


@reads_run
def write_videos(run: Run, folder: Path) -> dict[Path, int]:
    """Write a video for each camera of a run, ``<camera>.mp4``; depths and labels are not exported.

    Args:
        run: run with pictures.
        folder: folder of the videos, made if it does not exist.

    Returns:
        number of frames by file.

    Raises:
        MissingDependencyError: PyAV is not installed.
        RunError: no pictures were recorded, or a file cannot be written.
    """
    # A missing package is reported before pictures are read.
    import_extra("av", need="videos need PyAV", extra="video")
    cameras = {name: [p for p in pictures if p.path.suffix == ".jpg"] for name, pictures in run.pictures.items()}
    cameras = {name: pictures for name, pictures in cameras.items() if pictures}
    if not cameras:
        raise RunError("has no pictures; record them with record: {cameras: true}", where=str(run.folder))
    with write_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
    return {folder / f"{name}.mp4": write_video(p, folder / f"{name}.mp4") for name, p in cameras.items()}


def write_video(pictures: list[Picture], path: Path) -> int:
    """Write a video of pictures.

    Args:
        pictures: pictures of one camera, in the order of time.
        path: path of the .mp4 file.

    Returns:
        number of frames.

    Raises:
        MissingDependencyError: PyAV is not installed.
        RunError: the file cannot be written.
    """
    av = import_extra("av", need="videos need PyAV", extra="video")
    gaps = np.diff([picture.time for picture in pictures])
    # The frame rate is nominal, since each frame has its own time; the median ignores gaps.
    rate = Fraction(round(1.0 / float(np.median(gaps)))) if gaps.size else Fraction(1)
    options = {"video_track_timescale": str(TICKS)}
    with replacing(path) as temporary, av.open(str(temporary), "w", format="mp4", options=options) as container:
        stream = container.add_stream("libx264", rate=max(rate, Fraction(1)))
        height, width = pictures[0].pixels.shape[:2]
        # yuv420p halves the resolution of colours and needs even edges.
        stream.width, stream.height, stream.pix_fmt = width // 2 * 2, height // 2 * 2, "yuv420p"
        stream.options = {"crf": str(QUALITY), "preset": "veryfast"}
        # A clock much finer than the frame rate keeps the times of single frames.
        stream.codec_context.time_base = Fraction(1, TICKS)
        for picture in pictures:
            pixels = picture.pixels[: stream.height, : stream.width]
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(pixels), format="rgb24")
            frame.time_base, frame.pts = Fraction(1, TICKS), round(TICKS * (picture.time - pictures[0].time))
            container.mux(stream.encode(frame))
        # The encoder holds back some frames until it is flushed.
        container.mux(stream.encode())
    return len(pictures)
