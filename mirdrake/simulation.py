"""From a diagram to a run: seed, initial state, advance, progress, reasons to stop."""

import math
import os
import platform
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from pydrake.geometry import Meshcat
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, System

from mirdrake.controllers.ackermann import Ackermann
from mirdrake.controllers.vectors import STATE
from mirdrake.diagram import Assembly, DiagramSpec, assemble
from mirdrake.errors import ConfigError, RunError
from mirdrake.logs import PictureLog, Run, RunWriter, read_signals, spec_hash
from mirdrake.sensors import Camera, GroundTruth
from mirdrake.telemetry import Array, Columns, Telemetry
from mirdrake.yaml_io import shown, where

BLOCK = 1.0
"""Simulated time between two looks at the logs [s], the grain of the progress bar."""

LONG_BLOCK = 10.0
"""The same where nobody waits for the samples [s]."""

SLICE = 0.125
"""Simulated time between two looks at whether to stop [s]; a power of two, so that its multiples are exact."""

STRAIGHT = 1e-4
"""Curvature below which a track counts as straight [1/m], and time for which a command must have been constant [s]."""
STEADY = 2.0

_VX = [signal.name for signal in STATE].index("vx")

Progress = Callable[[float, float], None]


def simulate(
    spec: DiagramSpec | Mapping[str, Any] | str,
    *,
    duration: float | None = None,
    folder: Path | str | None = None,
    meshcat: Meshcat | None = None,
    realtime_rate: float = 0.0,
    progress: Progress | None = None,
) -> Run:
    """Simulate a diagram once.

    Args:
        spec: a diagram spec, its data or its name.
        duration: simulated time [s]; the spec's if left out.
        folder: run folder to write; None keeps the run in memory.
        meshcat: shows the run while it goes on.
        realtime_rate: 1 for real time, 0 for as fast as it goes.
        progress: called with simulated time and duration [s] every simulated second.

    Returns:
        the run, also when it was interrupted by Ctrl-C or diverged: see ``summary["stop_reason"]``.

    Raises:
        ConfigError, ModelError, WorldError, DiagramError: the diagram cannot be built.
        RunError: the folder cannot be written, or a block of the user's raised.
    """
    return Simulation(assemble(spec, meshcat=meshcat)).run(
        duration=duration, folder=folder, realtime_rate=realtime_rate, progress=progress
    )


class Simulation:
    """A built diagram that can be run again and again; each run starts from a new Context.

    Args:
        assembly: from :func:`mirdrake.diagram.assemble`.
    """

    def __init__(self, assembly: Assembly) -> None:
        self.assembly = assembly
        self._simulator = Simulator(assembly.diagram)

    def run(
        self,
        *,
        duration: float | None = None,
        folder: Path | str | None = None,
        realtime_rate: float = 0.0,
        progress: Progress | None = None,
        change: Callable[[Context], None] | None = None,
        monitor: Callable[[Context], None] | None = None,
    ) -> Run:
        """One run; see :func:`simulate`.

        Args:
            duration: see :func:`simulate`, as are the next three.
            folder: see :func:`simulate`.
            realtime_rate: see :func:`simulate`.
            progress: see :func:`simulate`.
            change: changes the new Context before the start, for example gains or masses.
            monitor: called with the Context after every step; it looks and changes nothing.
        """
        assembly, simulator = self.assembly, self._simulator
        end = assembly.spec.duration if duration is None else duration
        if not (math.isfinite(end) and end > 0.0):
            raise ConfigError(f"duration {end} s is not allowed; it must be a positive time")
        data = resolved_spec(assembly, duration=end)
        context = assembly.make_context()
        if change is not None:
            change(context)
        self._check_inputs(context)
        writer = RunWriter(Path(folder), data) if folder is not None else None
        simulator.reset_context(context)
        simulator.set_target_realtime_rate(realtime_rate)
        simulator.clear_monitor()
        watchers: list[Callable[[Context], None]] = [monitor] if monitor is not None else []
        if writer is not None and assembly.cameras:
            watchers.append(_Pictures(assembly, writer.folder))
        if watchers:
            simulator.set_monitor(lambda context: _call_all(watchers, context))
        telemetry, blocks, events = Telemetry(assembly), _Blocks(writer), _Events(writer)
        began = time.perf_counter()
        reason, failure = "duration", None
        try:
            with _interrupt() as interrupted:
                simulator.Initialize()
                reason = self._advance(context, end, telemetry, blocks, events, progress, interrupted)
        except KeyboardInterrupt:
            reason = "interrupted"
        except RunError:  # the folder cannot be written any more
            raise
        except Exception as error:
            failure = _failure(error)
            reason = f"failed: {failure}"
        times, columns = telemetry.read(context)
        blocks.add(times, columns, telemetry.units)
        wall = time.perf_counter() - began
        simulated = float(context.get_time())
        if failure is None and reason not in {"duration", "laps"}:
            events.add(simulated, "stop", reason)
        elif failure is not None:
            events.add(simulated, "failure", failure)

        if assembly.visualizer is not None:
            assembly.diagram.ForcedPublish(context)
        figures = partial(make_summary, assembly, data, simulated=simulated, wall=wall, reason=reason)
        table, summary = None, {}
        if writer is not None:
            summary = writer.finish(lambda: figures(read_signals(writer.folder, _figure_columns(assembly))))
        else:
            table = blocks.frame()
            summary = figures(table)
        if failure is not None:
            place = f"{writer.folder}: " if writer is not None else ""
            raise RunError(f"{place}the run failed at t = {simulated:.3f} s: {failure}")
        return Run(writer.folder if writer else None, data, summary, telemetry.units, events.entries, table)

    def _check_inputs(self, context: Context) -> None:
        """Refuse a diagram with open inputs, as of a vehicle that nobody drives, unless `change` gave them values."""
        diagram, spec = self.assembly.diagram, self.assembly.spec
        ports = [diagram.get_input_port(index) for index in range(diagram.num_input_ports())]
        open_ports = [port.get_name() for port in ports if not port.HasValue(context)]
        if open_ports:
            place, name = where(spec, "control"), open_ports[0].split(".")[0]
            raise ConfigError(
                f"{place}: nobody drives '{name}' (open inputs: {', '.join(open_ports)}); "
                f"add control.{name}, for example {{kind: constant, speed: 5}}, or connect blocks of yours to them"
            )

    def _advance(
        self,
        context: Context,
        end: float,
        telemetry: Telemetry,
        blocks: "_Blocks",
        events: "_Events",
        progress: Progress | None,
        interrupted: threading.Event,
    ) -> str:
        """Advance block by block until something stops the run; returns the reason."""
        plant = self.assembly.parts.plant
        plant_context = plant.GetMyContextFromRoot(context)
        laps = self.assembly.spec.laps
        vehicles = list(self.assembly.parts.vehicles)
        count = 0
        commands = [source for source, sink in self.assembly.spec.connect if sink.split(".")[0] in vehicles]
        watched = blocks.written or laps is not None or progress is not None
        slices = round((BLOCK if watched else LONG_BLOCK) / SLICE)
        while context.get_time() < end - 1e-9:
            count += 1
            self._simulator.AdvanceTo(min(count * SLICE, end))
            if count % slices and not interrupted.is_set() and context.get_time() < end - 1e-9:
                continue
            times, columns = telemetry.read(context)
            blocks.add(times, columns, telemetry.units)
            events.look(times, columns, vehicles)
            if progress is not None:
                progress(context.get_time(), end)
            if not np.all(np.isfinite(plant.GetPositionsAndVelocities(plant_context))):
                return f"diverged: {_not_finite(times, columns) or 'a position or velocity is no number'}"
            fault = _not_finite(times, {name: columns[name] for name in commands if name in columns})
            if fault is not None:
                return f"diverged: {fault}"
            lap = columns.get(f"{vehicles[0]}.lap")
            if laps is not None and lap is not None and lap.size and lap[-1] >= laps:
                return "laps"
            if interrupted.is_set() and context.get_time() < end - 1e-9:
                return "interrupted"
        return "duration"


def _not_finite(times: Array, columns: Columns) -> str | None:
    """The first sample that is no finite number, in words."""
    bad = {name: ~np.isfinite(values) for name, values in columns.items()}
    wrong = [(int(np.argmax(rows)), name) for name, rows in bad.items() if rows.any()]
    if not wrong:
        return None
    row, name = min(wrong)
    return f"{name} is {columns[name][row]:g} at t = {times[row]:g} s"


@contextmanager
def _interrupt() -> Iterator[threading.Event]:
    """While inside, Ctrl-C sets the event, and the run stops between two slices; a second Ctrl-C stops it at once.

    An exception in the middle of a step would leave logs of unequal length. Outside the main thread, and where somebody
    else handles Ctrl-C, everything stays as it is.
    """
    event = threading.Event()
    mine = threading.current_thread() is threading.main_thread()
    if not mine or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield event
        return

    def handle(number: int, frame: Any) -> None:
        if event.is_set():
            signal.default_int_handler(number, frame)
        event.set()

    signal.signal(signal.SIGINT, handle)
    try:
        yield event
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _failure(error: Exception) -> str:
    """An exception of a block as one line, with the file and line that raised it if these are the user's."""
    lines = str(error).strip().splitlines()
    text = f"{type(error).__name__}: {lines[0]}" if lines else type(error).__name__
    frame = error.__traceback__
    while frame is not None and frame.tb_next is not None:
        frame = frame.tb_next
    if frame is None:
        return text
    file = Path(frame.tb_frame.f_code.co_filename)
    return text if file.is_relative_to(Path(__file__).parent) else f"{shown(file)}:{frame.tb_lineno}: {text}"


def resolved_spec(assembly: Assembly, *, duration: float) -> dict[str, Any]:
    """The spec with every default, the hash of what it refers to, and the versions in use: enough to repeat a run."""
    data = assembly.spec.model_dump(mode="json")
    data["duration"] = duration
    data.pop("provenance", None)
    folder = data.pop("folder", None)  # the hash is that of the contents, wherever they lie
    world = assembly.parts.world
    content = {
        name: spec_hash(
            {
                "urdf": part.vehicle.urdf,
                "spec": part.vehicle.spec.model_dump(mode="json"),
                "control": part.vehicle.control.model_dump(mode="json"),
                "sensors": part.vehicle.sensors.model_dump(mode="json"),
            }
        )
        for name, part in assembly.parts.vehicles.items()
    }
    content["world"] = spec_hash(world.spec.model_dump(mode="json"))
    for name, system in assembly.own_systems().items():
        content[name] = spec_hash({"source": _source_text(system)})
    versions = {name: version(name) for name in ("mirdrake", "drake", "numpy")} | {"python": platform.python_version()}
    digest = spec_hash({"spec": data, "content": content})
    if folder is not None:
        data["folder"] = folder
    data["provenance"] = {"spec_sha256": digest, "content_sha256": content, "versions": versions}
    return data


def _source_text(system: System) -> str:
    """The file that defines a user's class; empty for a class without one."""
    module = sys.modules.get(type(system).__module__)
    file = getattr(module, "__file__", None)
    return Path(file).read_text(encoding="utf-8", errors="replace") if file and file.endswith(".py") else ""


def make_summary(
    assembly: Assembly, data: Mapping[str, Any], signals: pd.DataFrame, *, simulated: float, wall: float, reason: str
) -> dict[str, Any]:
    """The figures of a run, as in summary.json."""
    summary: dict[str, Any] = {
        "diagram": data["name"],
        "world": data["world"],
        "simulated_s": round(simulated, 9),
        "wall_s": round(wall, 3),
        "real_time_factor": round(simulated / wall, 2) if wall > 0.0 else None,
        "stop_reason": reason,
        "seed": data["seed"],
        "spec_sha256": data["provenance"]["spec_sha256"],
        "versions": data["provenance"]["versions"],
        "vehicles": {},
    }
    for name, part in assembly.parts.vehicles.items():
        summary["vehicles"][name] = {"model": part.vehicle.name} | _vehicle_figures(signals, name)
    return summary


_FIGURES = ("vx", "speed_command", "wheels_on_road", "lap", "lateral_error", "curvature")


def _figure_columns(assembly: Assembly) -> list[str]:
    """The signals that the figures of a summary are made of."""
    return [f"{name}.{signal}" for name in assembly.parts.vehicles for signal in _FIGURES]


def _vehicle_figures(signals: pd.DataFrame, name: str) -> dict[str, Any]:
    """Figures of one vehicle; those that the world or the run cannot give are None."""

    def column(suffix: str) -> Array | None:
        key = f"{name}.{suffix}"
        return signals[key].to_numpy() if key in signals and len(signals) else None

    figures: dict[str, Any] = {
        "laps": None,
        "max_abs_lateral_error_m": None,
        "mean_speed_error_percent": None,
        "off_road_s": None,
        "distance_m": None,
        "max_speed_mps": None,
    }
    vx, command, wheels = column("vx"), column("speed_command"), column("wheels_on_road")
    lap, lateral, curvature = column("lap"), column("lateral_error"), column("curvature")
    if vx is None or len(signals) < 2:
        return figures
    times = signals.index.to_numpy()
    step = float(times[1] - times[0])
    figures["distance_m"] = round(float(np.sum(np.abs(vx)) * step), 3)
    figures["max_speed_mps"] = round(float(np.max(np.abs(vx))), 4)
    if wheels is not None:
        figures["off_road_s"] = round(float(np.sum(wheels < 4) * step), 3)
    if lap is not None and lateral is not None:
        figures["laps"] = round(float(lap[-1]), 4)
        figures["max_abs_lateral_error_m"] = round(float(np.max(np.abs(lateral))), 4)
    if command is not None:
        steady = _steady(command, samples=max(1, round(STEADY / step))) & (np.abs(command) > 0.1)
        if curvature is not None:
            steady &= np.abs(curvature) < STRAIGHT
        if steady.any():
            error = np.mean((vx[steady] - command[steady]) / command[steady])
            figures["mean_speed_error_percent"] = round(100.0 * float(error), 4)
    return figures


def _steady(values: Array, *, samples: int) -> np.ndarray[Any, np.dtype[np.bool_]]:
    """Where a signal has not changed during the last samples."""
    changed = np.abs(np.diff(values, prepend=values[0])) > 1e-9
    changed[0] = True
    last = np.maximum.accumulate(np.where(changed, np.arange(values.size), 0))
    result: np.ndarray[Any, np.dtype[np.bool_]] = np.arange(values.size) - last >= samples
    return result


class _Blocks:
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


class _Events:
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


class _Pictures:
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


def _call_all(watchers: list[Callable[[Context], None]], context: Context) -> None:
    for watcher in watchers:
        watcher(context)


def default_folder(name: str, *, base: Path | None = None) -> Path:
    """``runs/<name>-<UTC time>`` below a folder, with a number added if it is taken."""
    stamp = time.strftime("%Y%m%dT%H%M%SZ", time.gmtime())
    root = (base or Path.cwd()) / "runs"
    folder, number = root / f"{name}-{stamp}", 1
    while folder.exists():
        number += 1
        folder = root / f"{name}-{stamp}-{number}"
    return Path(os.path.relpath(folder)) if base is None else folder
