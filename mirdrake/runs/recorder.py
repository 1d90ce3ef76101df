"""Recording of a run in progress: blocks of samples, events, and the samples of sensors."""

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from math import inf
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from pydrake.systems.framework import Context, System

from mirdrake.assembly.diagram import Assembly
from mirdrake.controllers.ackermann import Ackermann
from mirdrake.core.errors import RunError
from mirdrake.core.recording.arrays import SUFFIX, ArrayLog
from mirdrake.core.recording.pictures import PictureLog, make_pool
from mirdrake.core.recording.vectors import VectorLog
from mirdrake.core.signals import signals_of
from mirdrake.core.vectors import STATE
from mirdrake.runs.incidents import OF_ACTORS
from mirdrake.runs.logs import Event, RunWriter
from mirdrake.runs.telemetry import Array, Columns
from mirdrake.sensors.ground_truth import GroundTruth

_VX = [signal.name for signal in STATE].index("vx")


class Blocks:
    """Blocks of samples of a run, which are written immediately or kept until the end."""

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
        """Return all blocks as one table."""
        if not self._times:
            return pd.DataFrame(index=pd.Index([], name="time"))
        data = {name: np.concatenate([block[name] for block in self._columns]) for name in self._columns[0]}
        return pd.DataFrame(data, index=pd.Index(np.concatenate(self._times), name="time"))


class Events:
    """Events of a run, detected in its samples."""

    def __init__(self, writer: RunWriter | None) -> None:
        self._writer = writer
        self._last: dict[str, float] = {}
        self.entries: list[Event] = []

    def add(self, time: float, kind: str, text: str) -> None:
        """Keep an event, and write it."""
        self.entries.append(Event(time=round(time, 6), kind=kind, text=text))
        if self._writer is not None:
            self._writer.write_event(self.entries[-1])

    def look(self, times: Array, columns: Columns, vehicles: list[str]) -> None:
        """Add events of wheels that leave or regain the road, and laps."""
        if not len(times):  # a run may end before the first sample of a block
            return
        watched = {f"{name}.wheels_on_road": "road" for name in vehicles} | {f"{name}.lap": "lap" for name in vehicles}
        for key, kind in watched.items():
            if key not in columns:
                continue
            # Laps are fractions: floor finds whole laps, and the tolerance keeps 1.0 -
            # rounding from counting one sample late.
            values = np.floor(columns[key] + 1e-6)
            # Before the first block, the start is not an event: a vehicle may start with two wheels beside the road.
            before = self._last.get(key, float(values[0]))
            for index in np.flatnonzero(np.diff(values, prepend=before)):
                self._report(float(times[index]), kind, key.split(".")[0], float(values[index]))
            self._last[key] = float(values[-1])
        for key in columns:
            if key.startswith(OF_ACTORS) and key.endswith(".braking_limit"):
                # Only rising edges: the begin of braking at the limit, not its end.
                begun = np.flatnonzero(np.diff(columns[key], prepend=self._last.get(key, 0.0)) > 0.0)
                self._last[key] = float(columns[key][-1])
                for index in begun:
                    name = key.removeprefix(OF_ACTORS).removesuffix(".braking_limit")
                    self.add(float(times[index]), "actor", f"{name}: brakes at its limit")

    def _report(self, time: float, kind: str, name: str, value: float) -> None:
        texts = {
            "road": f"{name}: {value:.0f} of 4 wheels on the road",
            "lap": f"{name}: lap {value:.0f} completed",
        }
        self.add(time, kind, texts[kind])


class Recorder:
    """Monitor that writes new samples of sensors after each step; it is a context manager.

    A sample is written when it is output, with the time at which it was taken; a lost sample is not written. Samples
    that were taken but not output at the end of the run are written then, see :meth:`counts`. Outputs change in events
    of the sensors, at which steps of the simulator end, so no sample is missed.

    Interface of a sensor:

    - ``record`` is "pictures" or "array"; other samples are vectors.
    - ``rate`` [Hz], ``latency`` [s], and ``under_way(context)``, the samples that were taken but not output.
    - Pictures: ports ``stamp`` [s] and ``shot``, an object with ``pictures``, arrays by name; or a method
      ``look(context)`` that returns an array, or several by name.
    - Arrays: a port ``sample``, or an abstract port of a dataclass with a ``time`` [s]; optionally ``stamp`` [s].
    - Vectors: ports ``sample`` and ``stamp``; sensors without them are not recorded here.

    Args:
        assembly: the built diagram.
        folder: folder of the run.
    """

    def __init__(self, assembly: Assembly, folder: Path) -> None:
        start = assembly.spec.record.start
        # Pictures are compressed by threads beside the simulation.
        self._pool = make_pool() if assembly.cameras else None
        self._cameras = [
            _Camera(
                camera,
                partial(PictureLog, pool=self._pool, start=start),
                folder / name,
                assembly.diagram.GetSubsystemByName(f"{vehicle}.truth"),
                Ackermann(assembly.parts.vehicles[vehicle].vehicle.geometry),
            )
            for name, (camera, vehicle) in assembly.cameras.items()
        ]
        self._samples = [
            _Samples(sensor, ArrayLog(folder / f"{name}{SUFFIX}", units={"ranges": "m"}))
            for name, sensor in assembly.arrays.items()
        ]
        # Vector sensors are recorded sample by sample, at their own rate.
        for name, sensor in vector_sensors(assembly).items():
            units = {signal.name: signal.unit for signal in signals_of(sensor.GetOutputPort("sample")) or ()}
            self._samples.append(_Samples(sensor, VectorLog(folder / f"{name}{SUFFIX}", units)))
        self._streams: list[_Camera | _Samples] = [*self._cameras, *self._samples]
        self._context: Context | None = None

    def __enter__(self) -> "Recorder":
        return self

    def __exit__(self, kind: type[BaseException] | None, *rest: object) -> None:
        """Write pending samples and those in memory; after a failure, as many as possible."""
        # Each stream is finished and closed even if another fails (full disk); the first fault is reported at the end.
        fault: RunError | None = None
        for stream in self._streams:
            try:
                if self._context is not None:
                    stream.finish(self._context)
            except RunError as error:
                fault = fault or error
            try:
                stream.close()
            except RunError as error:
                fault = fault or error
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)
        # An exception of the run itself explains more than a fault of closing files after it.
        if fault is not None and kind is None:
            raise fault

    def __call__(self, context: Context) -> None:
        """Record new samples of every sensor."""
        self._context = context
        for stream in self._streams:
            stream.look(context)

    def counts(self) -> dict[str, dict[str, int]]:
        """Return the number of samples by sensor (``recorded``), and how many were not output at the end.

        The latter (``under_way``) were taken so late that their latency had not passed.
        """
        recorded = {path.name: log.count for camera in self._cameras for path, log in camera.logs.items()}
        recorded |= {samples.log.name: samples.log.count for samples in self._samples}
        late = {camera.folder.name: camera.late for camera in self._cameras}
        late |= {samples.log.name: samples.late for samples in self._samples}
        late = {name: count for name, count in late.items() if count}
        return {key: counts for key, counts in (("recorded", recorded), ("under_way", late)) if counts}


def vector_sensors(assembly: Assembly) -> dict[str, System]:
    """Return the sensors of a diagram whose vector samples are recorded, by name."""
    names = [f"{vehicle}.{sensor}" for vehicle, sensors in assembly.spec.sensors.items() for sensor in sensors]
    if not assembly.spec.record.signals:
        return {}
    sensors = {name: assembly.diagram.GetSubsystemByName(name) for name in names if name in assembly.taps}
    return {name: sensor for name, sensor in sensors.items() if sensor.HasOutputPort("stamp")}


@dataclass
class _Camera:
    """Camera with the logs of its pictures and the ground truth of its vehicle."""

    camera: Any
    make_log: Callable[[Path], PictureLog]
    folder: Path
    truth: GroundTruth
    ackermann: Ackermann
    taken: int = 0
    last: float = -inf
    late: int = 0
    logs: dict[Path, PictureLog] = field(default_factory=dict)
    _drives: deque[tuple[float, float, float]] = field(default_factory=deque)

    def look(self, context: Context) -> None:
        """Write a picture if there is a new one.

        A camera with a ``stamp`` renders by itself, others render here.
        """
        time = context.get_time()
        # From the count, not by adding the period: rounding errors do not accumulate. The tolerance is for event times.
        due = time >= self.taken / self.camera.rate - 1e-9
        if due:
            self.taken += 1
            # Steering and speed are those at the exposure; the picture appears only
            # after the latency, so they queue here.
            truth = self.truth.GetMyContextFromRoot(context)
            steering = self.ackermann.bicycle_angle(*self.truth.steering_angles.Eval(truth))
            self._drives.append((time, steering, float(self.truth.state.Eval(truth)[_VX])))
        if not self.camera.HasOutputPort("stamp"):
            if due:
                self._write(time, self.camera.look(context))
            return
        self._look(context)

    def finish(self, context: Context) -> None:
        """Write the last samples of the run, output or pending."""
        if self.camera.HasOutputPort("stamp"):
            self._look(context)
        if hasattr(self.camera, "under_way"):
            for time, shot in self.camera.under_way(self.camera.GetMyContextFromRoot(context)):
                self._write(time, shot.pictures)
                self.late += 1

    def _look(self, context: Context) -> None:
        own = self.camera.GetMyContextFromRoot(context)
        stamp = float(self.camera.GetOutputPort("stamp").Eval(own)[0])
        if stamp > self.last:
            self.last = stamp
            self._write(stamp, self.camera.GetOutputPort("shot").Eval(own).pictures)

    def _write(self, time: float, pictures: Any) -> None:
        """Write the pictures of a time [s], with steering and speed of the vehicle at that time."""
        while len(self._drives) > 1 and self._drives[0][0] < time - 1e-6:  # those of lost pictures
            self._drives.popleft()
        _, steering, speed = self._drives.popleft()
        for name, pixels in (pictures if isinstance(pictures, Mapping) else {"color": pictures}).items():
            path = self.folder if name == "color" else self.folder.with_name(f"{self.folder.name}.{name}")
            if path not in self.logs:
                self.logs[path] = self.make_log(path)
            self.logs[path].write(time, pixels, steering=steering, speed=speed)

    def close(self) -> None:
        """Write all pictures to disk."""
        # Each log is closed even if another could not be written.
        _close_all(list(self.logs.values()))


@dataclass
class _Samples:
    """Sensor with samples of arrays or vectors, and its log."""

    sensor: Any
    log: ArrayLog | VectorLog
    last: float = -inf
    late: int = 0

    def __post_init__(self) -> None:
        ports = [self.sensor.get_output_port(index) for index in range(self.sensor.num_output_ports())]
        by_name = {port.get_name(): port for port in ports}
        self._stamp = by_name.pop("stamp", None)
        self._port = by_name.get("sample", next(iter(by_name.values())))
        # Sampling events lie on a grid of 1/rate, so evaluating the port earlier would be wasted; it may be expensive.
        latency, rate = getattr(self.sensor, "latency", 0.0), float(self.sensor.rate)
        self._wait = (1.0 / rate if self._stamp is not None else 0.0) + latency - 1e-9
        self._count = 0

    def look(self, context: Context) -> None:
        """Write a sample if there is a new one."""
        self.log.flush_if_due()
        if context.get_time() >= self.last + self._wait:  # earliest time of the next sample
            self._look(context)

    def finish(self, context: Context) -> None:
        """Write the last samples of the run, output or pending."""
        self._look(context)
        if hasattr(self.sensor, "under_way"):
            for time, sample in self.sensor.under_way(self.sensor.GetMyContextFromRoot(context)):
                self._write(time, sample)
                self.late += 1

    def _look(self, context: Context) -> None:
        # A sensor without a stamp computes on request: it is evaluated on its own grid of k/rate plus latency.
        if self._stamp is None and context.get_time() <= self._due() + 1e-9:
            return
        # Sensors with a stamp have a new sample when it changes, others at their rate.
        own = self.sensor.GetMyContextFromRoot(context)
        if self._stamp is not None:
            time = float(self._stamp.Eval(own)[0])
            if time <= self.last:
                return
        sample = self._port.Eval(own)
        if self._stamp is None:
            time = float(getattr(sample, "time", self._count / self.sensor.rate))
            if time <= self.last:
                return
        self._write(time, sample)

    def _write(self, time: float, sample: Any) -> None:
        self.log.write(time, sample)
        self._count += 1
        self.last = time

    def _due(self) -> float:
        return self._count / float(self.sensor.rate) + float(getattr(self.sensor, "latency", 0.0))

    def close(self) -> None:
        """Write all samples to disk as one file."""
        self.log.close()


def _close_all(logs: list[PictureLog]) -> None:
    fault: RunError | None = None
    for log in logs:
        try:
            log.close()
        except RunError as error:
            fault = error
    if fault is not None:
        raise fault
