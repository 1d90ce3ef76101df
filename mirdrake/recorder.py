"""What a run keeps while it goes on: blocks of samples, events, pictures."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from pydrake.systems.framework import Context

from mirdrake.controllers.ackermann import Ackermann
from mirdrake.controllers.vectors import STATE
from mirdrake.diagram import Assembly
from mirdrake.logs import PictureLog, RunWriter
from mirdrake.sensors import Camera, GroundTruth
from mirdrake.telemetry import Array, Columns

_VX = [signal.name for signal in STATE].index("vx")


class Blocks:
    """The blocks of samples of a run, written as they come or kept until the end."""

    def __init__(self, writer: RunWriter | None) -> None:
        self._writer = writer
        self.written = writer is not None
        self._times: list[Array] = []
        self._columns: list[Columns] = []

    def add(self, times: Array, columns: Columns, units: Mapping[str, str]) -> None:
        """Keep a block, or write it."""
        if not times.size:
            return
        if self._writer is not None:
            self._writer.write_signals(times, columns, units)
        else:
            self._times.append(times)
            self._columns.append(columns)

    def frame(self) -> pd.DataFrame:
        """All blocks as one table."""
        if not self._times:
            return pd.DataFrame(index=pd.Index([], name="time"))
        data = {name: np.concatenate([block[name] for block in self._columns]) for name in self._columns[0]}
        return pd.DataFrame(data, index=pd.Index(np.concatenate(self._times), name="time"))


class Events:
    """What happens in a run, found in its samples."""

    def __init__(self, writer: RunWriter | None) -> None:
        self._writer = writer
        self._last: dict[str, float] = {}
        self.entries: list[dict[str, Any]] = []

    def add(self, time: float, kind: str, text: str) -> None:
        """Keep an event, and write it."""
        self.entries.append({"time": round(time, 6), "kind": kind, "text": text})
        if self._writer is not None:
            self._writer.write_event(time, kind, text)

    def look(self, times: Array, columns: Columns, vehicles: list[str]) -> None:
        """Wheels that leave or regain the road, laps, and contacts that are not tyres on the road."""
        watched = {f"{name}.wheels_on_road": "road" for name in vehicles} | {f"{name}.lap": "lap" for name in vehicles}
        for key, kind in (watched | {"other_contacts": "contact"}).items():
            if key not in columns:
                continue
            values = np.floor(columns[key] + 1e-6)
            before = self._last.get(key, float(values[0]) if kind != "contact" else 0.0)
            for index in np.flatnonzero(np.diff(values, prepend=before)):
                self._report(float(times[index]), kind, key.split(".")[0], float(values[index]))
            self._last[key] = float(values[-1])

    def _report(self, time: float, kind: str, name: str, value: float) -> None:
        texts = {
            "road": f"{name}: {value:.0f} of 4 wheels on the road",
            "lap": f"{name}: lap {value:.0f} completed",
            "contact": f"{value:.0f} contacts that are not tyres on the road",
        }
        self.add(time, kind, texts[kind])


class Pictures:
    """A monitor that writes each picture in the moment that its camera takes it.

    Steps of the simulator end at these moments, as they are events of the camera.
    """

    def __init__(self, assembly: Assembly, folder: Path) -> None:
        self._cameras = [
            _Recorded(
                camera,
                PictureLog(folder / name),
                assembly.diagram.GetSubsystemByName(f"{vehicle}.truth"),
                Ackermann(assembly.parts.vehicles[vehicle].vehicle.geometry),
            )
            for name, (camera, vehicle) in assembly.cameras.items()
        ]

    def __call__(self, context: Context) -> None:
        """Look at every camera."""
        for camera in self._cameras:
            camera.look(context)


@dataclass
class _Recorded:
    """A camera, where its pictures go, and who knows what its vehicle does."""

    camera: Camera
    log: PictureLog
    truth: GroundTruth
    ackermann: Ackermann
    taken: int = 0

    def look(self, context: Context) -> None:
        """Write a picture if it is time for one."""
        time = context.get_time()
        if time < self.taken / self.camera.rate - 1e-9:
            return
        truth = self.truth.GetMyContextFromRoot(context)
        steering = self.ackermann.bicycle_angle(*self.truth.steering_angles.Eval(truth))
        speed = float(self.truth.state.Eval(truth)[_VX])
        self.log.write(time, self.camera.look(context), steering=steering, speed=speed)
        self.taken += 1
