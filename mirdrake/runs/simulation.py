"""Simulation of a diagram: seed, initial state, time steps, progress, stop reasons."""

import math
import os
import re
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from pydrake.geometry import Meshcat
from pydrake.math import RollPitchYaw
from pydrake.systems.framework import Context, EventStatus, System

from mirdrake.assembly.diagram import Assembly, DiagramSpec, assemble
from mirdrake.controllers.behaviours.outline import volume_of
from mirdrake.core.checks import checks_arguments
from mirdrake.core.drake_errors import first_sentence, is_divergence
from mirdrake.core.errors import ConfigError, DivergedError, RunError, one_line
from mirdrake.core.yaml_io import display_path
from mirdrake.plant.wheels import RoadFriction
from mirdrake.runs.incidents import OF_ACTORS, Incident, Incidents
from mirdrake.runs.live_view import LiveView
from mirdrake.runs.logs import Run, RunWriter, read_signals
from mirdrake.runs.recorder import Blocks, Events, Recorder, vector_sensors
from mirdrake.runs.stop import Stop, StopReason
from mirdrake.runs.summary import figure_columns, make_summary, resolved_spec
from mirdrake.runs.telemetry import Array, Columns, Telemetry
from mirdrake.worlds import Start

BLOCK = 1.0
"""Simulated time between two readings of the logs [s], the resolution of the progress bar."""

SLOW_BLOCK = 0.25
"""The same with cameras [s]."""

LONG_BLOCK = 10.0
"""The same if samples are neither written nor evaluated during the run [s]."""

SLICE = 0.125
"""Approximate simulated time between two checks for a stop [s]; it is a multiple of the step of the plant."""

Progress = Callable[[float, float], None]

Report = Callable[[Incident], None]


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
        duration: simulated time [s]; by default that of the spec.
        folder: run folder to write; None keeps the run in memory.
        meshcat: shows the run live.
        realtime_rate: 1 for real time, 0 for as fast as possible.
        progress: called with simulated time and duration [s] every simulated second.

    Returns:
        the run, also when it was interrupted by Ctrl-C or diverged: see ``summary["stop_reason"]``.

    Raises:
        ConfigError, ModelError, WorldError, DiagramError: the diagram cannot be built.
        RunError: the folder cannot be written, or a user block raised an exception.
    """
    return Simulation(assemble(spec, meshcat=meshcat)).run(
        duration=duration, folder=folder, realtime_rate=realtime_rate, progress=progress
    )


class Simulation:
    """A built diagram that can be run again and again; each run starts from a new Context.

    Args:
        assembly: assembly from :func:`mirdrake.assembly.diagram.assemble`.
    """

    def __init__(self, assembly: Assembly) -> None:
        self.assembly = assembly
        self._simulator = assembly.make_simulator()
        self._volumes = {name: volume_of(part.vehicle) for name, part in assembly.parts.vehicles.items()}
        self._friction = RoadFriction(assembly.parts, assembly.tyres)

    @checks_arguments
    def run(
        self,
        *,
        duration: float | None = None,
        folder: Path | str | None = None,
        realtime_rate: float = 0.0,
        progress: Progress | None = None,
        change: Callable[[Context], None] | None = None,
        monitor: Callable[[Context], None] | None = None,
        until: Callable[[Context], bool] | None = None,
        report: Report | None = None,
    ) -> Run:
        """Run the simulation; see :func:`simulate`.

        Args:
            duration: see :func:`simulate`, as are the next three.
            folder: see :func:`simulate`.
            realtime_rate: see :func:`simulate`.
            progress: see :func:`simulate`.
            change: changes the new Context before the start, for example gains or masses.
            monitor: called with the Context after every step; it looks and changes nothing.
            until: called with the Context at the start and after every step; when it returns True, the run ends with
                the stop reason "condition".
            report: called immediately for every impossible start, collision, and vehicle that leaves the ground.
        """
        assembly, simulator = self.assembly, self._simulator
        end = assembly.spec.duration if duration is None else duration
        # Also rejects NaN and text: `run` is called from Python with values that no schema has checked.
        if not (isinstance(end, int | float) and math.isfinite(end) and end > 0.0):
            raise ConfigError(f"duration {end!r} s is not allowed; it must be a positive time")
        # A new Context, the run folder, and the watchers that are called after every step.
        # Resolved before the run, so that spec.yaml of a killed run already has the digests and versions.
        data = resolved_spec(assembly, duration=end)
        context = assembly.make_context()
        # `change` acts before the check of the inputs, because it may fix the value of an open port.
        if change is not None:
            change(context)
        self.assembly.check_inputs(context)
        writer = RunWriter(Path(folder), data, assembly.scene) if folder is not None else None
        # The Simulator is reused; a monitor of the last run would still act on the new Context.
        simulator.reset_context(context)
        simulator.set_target_realtime_rate(realtime_rate)
        simulator.clear_monitor()
        watchers: list[Callable[[Context], None]] = [monitor] if monitor is not None else []
        view = LiveView(assembly, assembly.meshcat) if assembly.meshcat is not None else None
        if view is not None:
            watchers.append(view)
        # Friction under the wheels must be set before any other watcher evaluates forces at this state.
        if self._friction.varies:
            self._friction.start()
            watchers.insert(0, self._friction.watch)
        # The recorder is a context manager: it has to close its files also after an exception in the middle of the run.
        recorder = None
        if writer is not None and (assembly.cameras or assembly.arrays or vector_sensors(assembly)):
            recorder = Recorder(assembly, writer.folder)
            watchers.append(recorder)
        met = threading.Event()
        if watchers or until is not None:
            simulator.set_monitor(lambda context: _watch(assembly.diagram, watchers, until, met, context))
        # The run itself; a failure is reported after the folder is finished.
        telemetry, blocks, events = Telemetry(assembly), Blocks(writer), Events(writer)
        start = time.perf_counter()
        stop = Stop(StopReason.DURATION)
        incidents = Incidents(assembly.parts.world, assembly.parts.vehicles, self._volumes)
        logs = _Logs(telemetry, blocks, events, incidents, report)
        # Before Initialize, so that an impossible start is reported even if the run fails right away.
        logs.report(incidents.check_starts(self._starts(context)))
        try:
            with _interrupt() as interrupted, recorder or nullcontext():
                simulator.Initialize()
                stop = self._advance(context, end, logs, progress, interrupted, met)
        except KeyboardInterrupt:
            stop = Stop(StopReason.INTERRUPTED)
        except RunError as error:
            if not isinstance(error, DivergedError):  # the folder can no longer be written
                raise
            stop = Stop(StopReason.DIVERGED, str(error))
        except BaseException as error:  # a user's block may raise anything, SystemExit and GeneratorExit as well
            if _is_divergence(error):
                stop = Stop(StopReason.DIVERGED, f"the solver failed: {first_sentence(str(error))}")
            else:
                stop = Stop(StopReason.FAILED, _failure(error))

        # The last samples and events, and the summary.
        times, columns = telemetry.read(context)
        blocks.add(times, columns, telemetry.units)
        logs.report(incidents.look(times, columns))
        wall = time.perf_counter() - start
        simulated = float(context.get_time())
        # A failed run keeps its folder up to the failure; only a stop that nobody asked for is an event.
        if stop.reason is StopReason.FAILED:
            events.add(simulated, "failure", stop.detail)
        elif not stop.as_asked:
            events.add(simulated, "stop", str(stop))

        # The drawing period skips most steps; without this call the page would not show the final state.
        if view is not None:
            view.update(context)
            if view.failed:
                events.add(view.failed_at, "view", "Meshcat has ended; the run continued without its page")
        # With a folder, the figures are read back from disk: the samples need not be kept in memory.
        figures = partial(
            make_summary, assembly, data, simulated=simulated, wall=wall, stop=stop, incidents=incidents.reported
        )
        recorded = recorder.counts() if recorder is not None else {}
        table: pd.DataFrame | None = None
        if writer is not None:
            read = partial(read_signals, writer.folder, figure_columns(assembly))
            summary = writer.finish(lambda: figures(read()) | recorded)
        else:
            table = blocks.frame()
            summary = figures(table)
        # Raised only now, when the folder with the samples that explain the failure is complete.
        if stop.reason is StopReason.FAILED:
            place = str(writer.folder) if writer is not None else ""
            raise RunError(f"the run failed at t = {simulated:.3f} s: {stop.detail}", where=place)
        written = writer.folder if writer else None
        return Run(written, data, summary, telemetry.units, events.entries, table, assembly.scene)

    def _starts(self, context: Context) -> dict[str, Start]:
        """Return the starts of the vehicles: those of the diagram, or as changed by `change`."""
        # Read from the Context, because `change` may have moved a vehicle or set its speed.
        plant = self.assembly.parts.plant
        plant_context, starts = plant.GetMyContextFromRoot(context), {}
        for name, part in self.assembly.parts.vehicles.items():
            asked = self.assembly.starts[name]
            pose = part.base.EvalPoseInWorld(plant_context)
            velocity = part.base.EvalSpatialVelocityInWorld(plant_context).translational()
            x, y, _ = pose.translation().tolist()
            yaw = float(RollPitchYaw(pose.rotation()).yaw_angle())
            # Forward speed is the component of the velocity along the vehicle's x axis (ISO 8855), negative in reverse.
            speed = float(velocity @ pose.rotation().matrix()[:, 0])
            # A start that was moved is no longer on its track, so the curvature there
            # must not be used to judge its speed.
            moved = math.hypot(x - asked.x, y - asked.y) > 1e-6
            starts[name] = Start(x, y, yaw, speed, None if moved else asked.track, None if moved else asked.s)
        return starts

    def _advance(
        self,
        context: Context,
        end: float,
        logs: "_Logs",
        progress: Progress | None,
        interrupted: threading.Event,
        met: threading.Event,
    ) -> Stop:
        """Advance block by block until the run stops, and return why."""
        telemetry, blocks, events = logs.telemetry, logs.blocks, logs.events
        plant = self.assembly.parts.plant
        plant_context = plant.GetMyContextFromRoot(context)
        laps = self.assembly.spec.laps
        vehicles = list(self.assembly.parts.vehicles)
        count = 0
        # Whatever a vehicle is given: by its driver, or by a block of the diagram.
        commands = [f"{name}.{part}" for name in vehicles for part in ("speed_command", "steering_command")]
        commands += [source for source, sink in self.assembly.spec.connect if sink.split(".")[0] in vehicles]
        # Samples are read rarely if nobody looks at them, often if a kill would lose pictures.
        watched = blocks.written or laps is not None or progress is not None
        step = self.assembly.spec.plant.time_step
        steps = self.assembly.steps_in(SLICE)
        slices = max(round((BLOCK if watched else LONG_BLOCK) / (steps * step)), 1)
        if blocks.written and self.assembly.cameras:  # it may be slower than real time; a kill must not lose more
            slices = max(round(SLOW_BLOCK / (steps * step)), 1)
        # The tolerance prevents a last step of rounding error size when the end is not a multiple of the slice.
        while context.get_time() < end - 1e-9:
            count += 1
            # The monitor may have met the condition in Initialize already; then no step is taken.
            if not met.is_set():
                # A multiple of the step instead of a sum: it is the time of the plant's event, without rounding.
                self._simulator.AdvanceTo(min(count * steps * step, end))
            stopping = interrupted.is_set() or met.is_set()
            if count % slices and not stopping and context.get_time() < end - 1e-9:
                continue
            # Samples are written before the checks below, so that the folder includes the samples that caused the stop.
            times, columns = telemetry.read(context)
            blocks.add(times, columns, telemetry.units)
            events.look(times, columns, vehicles)
            logs.report(logs.incidents.look(times, columns))
            if progress is not None:
                progress(context.get_time(), end)
            # Divergence: the state itself, not the samples, because the record period
            # may skip the state that is not finite.
            if not np.all(np.isfinite(plant.GetPositionsAndVelocities(plant_context))):
                # A message should name a signal of a vehicle, the cause; the actors only react to it.
                own = {name: values for name, values in columns.items() if not name.startswith(OF_ACTORS)}
                detail = _not_finite(times, own) or "a position or velocity is not finite"
                return Stop(StopReason.DIVERGED, detail)
            # A command that is not finite need not reach the state (limits, held values), but makes the run worthless.
            fault = _not_finite(times, {name: columns[name] for name in commands if name in columns})
            if fault is not None:
                return Stop(StopReason.DIVERGED, fault)
            lap = columns.get(f"{vehicles[0]}.lap")
            if laps is not None and lap is not None and lap.size and lap[-1] >= laps:
                return Stop(StopReason.LAPS)
            if met.is_set():
                return Stop(StopReason.CONDITION)
            # At the very end, an interrupt changes nothing: all of the time has been simulated.
            if interrupted.is_set() and context.get_time() < end - 1e-9:
                return Stop(StopReason.INTERRUPTED)
        return Stop(StopReason.DURATION)


class _Logs(NamedTuple):
    """The consumers of the samples of a run."""

    telemetry: Telemetry
    blocks: Blocks
    events: Events
    incidents: Incidents
    reporter: Report | None

    def report(self, incidents: Sequence[Incident]) -> None:
        """Record incidents as events, and report them immediately; later contacts of a pair are events only."""
        for incident in incidents:
            self.events.add(incident.time, incident.kind, incident.text)
            if self.reporter is not None and incident.kind != "contact":
                self.reporter(incident)


def _is_divergence(error: BaseException) -> bool:
    """Return whether Drake itself, not a block written in Python, has failed because of a divergent state."""
    # Innermost frame of the traceback: that of this file means that the exception comes from C++ below AdvanceTo.
    frame = error.__traceback__
    while frame is not None and frame.tb_next is not None:
        frame = frame.tb_next
    own = frame is not None and Path(frame.tb_frame.f_code.co_filename) == Path(__file__)
    return own and is_divergence(str(error))


def _not_finite(times: Array, columns: Columns) -> str | None:
    """Return a description of the first sample that is not finite; None if there is none."""
    bad = {name: ~np.isfinite(values) for name, values in columns.items()}
    wrong = [(int(np.argmax(rows)), name) for name, rows in bad.items() if rows.any()]
    if not wrong:
        return None
    # Earliest sample first; of several at the same sample, the first by name, so that the message is deterministic.
    row, name = min(wrong)
    return f"{name} is {columns[name][row]:g} at t = {times[row]:g} s"


@contextmanager
def _interrupt() -> Iterator[threading.Event]:
    """Have Ctrl-C set the event, so that the run stops between two steps; a second Ctrl-C stops it immediately.

    An exception in the middle of a step would leave logs of unequal length. Outside the main thread, or where Ctrl-C
    has another handler, nothing is changed.
    """
    event = threading.Event()
    mine = threading.current_thread() is threading.main_thread()
    if not mine or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield event
        return

    # A second Ctrl-C must end a run whose single step does not return.
    def handle(number: int, frame: Any) -> None:
        if event.is_set():
            signal.default_int_handler(number, frame)
        event.set()

    signal.signal(signal.SIGINT, handle)
    try:
        yield event
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _failure(error: BaseException) -> str:
    """Return the exception of a block as one line, with file and line if the code is the user's."""
    text = one_line(error)
    # Innermost frame: where the exception was raised, not where the Simulator was called.
    frame = error.__traceback__
    while frame is not None and frame.tb_next is not None:
        frame = frame.tb_next
    if frame is None:
        return text
    # A line of mirdrake's own code would not help the user; the message of the exception does.
    file = Path(frame.tb_frame.f_code.co_filename)
    return text if file.is_relative_to(Path(__file__).parents[1]) else f"{display_path(file)}:{frame.tb_lineno}: {text}"


def _watch(
    system: System,
    watchers: list[Callable[[Context], None]],
    until: Callable[[Context], bool] | None,
    met: threading.Event,
    context: Context,
) -> EventStatus:
    """Call all watchers; set `met` and terminate once `until` holds. This is Drake's monitor."""
    for watcher in watchers:
        watcher(context)
    # DidNothing lets the Simulator continue; ReachedTermination makes AdvanceTo return after this step.
    if until is None or not until(context):
        return EventStatus.DidNothing()
    met.set()
    return EventStatus.ReachedTermination(system, "condition")


def default_folder(name: str, *, base: Path | None = None) -> Path:
    """Return ``runs/<name>-<UTC time>`` below a folder, with a number if it exists already."""
    stamp = time.strftime("%Y%m%dT%H%M%SZ", time.gmtime())
    # A title, such as that of a loaded diagram, may have spaces and other characters that shells interpret.
    safe = re.sub(r"[^\w.-]+", "_", name).strip("_")
    root = (base or Path.cwd()) / "runs"
    folder, number = root / f"{safe}-{stamp}", 1
    while folder.exists():
        number += 1
        folder = root / f"{safe}-{stamp}-{number}"
    return Path(os.path.relpath(folder)) if base is None else folder
