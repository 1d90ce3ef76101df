"""Run folders with small pictures, written without a simulation, for tests of driving data."""

from pathlib import Path
from typing import Any

import numpy as np

from mirdrake.core.recording.pictures import PictureLog
from mirdrake.runs.logs import RunWriter

LENGTH = 400.0
"""Length of the track [m]."""

SPEED = 5.0
"""[m/s]"""


def write_run(folder: Path, *, seconds: float = 80.0, rate: float = 10.0, width: int = 8, height: int = 6) -> Path:
    """Write a run at constant speed along a track.

    The steering command is sin(t) [rad], the lateral error cos(t) [m]. The left half of each picture is red, 100 + its
    number modulo 100; the right half is black.
    """
    writer = RunWriter(folder, {"world": {"name": "ring"}, "record": {}})
    times = np.arange(0.0, seconds + 1e-9, 0.02)
    units = {"ego.steering_command": "rad", "ego.lateral_error": "m", "ego.progress": "m", "ego.vx": "m/s"}
    columns: dict[str, Any] = {
        "ego.steering_command": np.sin(times),
        "ego.lateral_error": np.cos(times),
        "ego.progress": np.mod(SPEED * times, LENGTH),
        "ego.vx": np.full(len(times), SPEED),
        "ego.vy": np.zeros(len(times)),
    }
    writer.write_signals(times, columns, units | {"ego.vy": "m/s"})
    writer.finish(lambda: {"simulated_s": seconds, "stop_reason": "duration"})
    log = PictureLog(folder / "ego.front_camera")
    for index in range(round(seconds * rate) + 1):
        pixels = np.zeros((height, width, 3), dtype=np.uint8)
        pixels[:, : width // 2, 0] = 100 + index % 100
        log.write(index / rate, pixels, steering=0.0, speed=SPEED)
    log.close()
    return folder
