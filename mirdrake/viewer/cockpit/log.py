"""The recording of a manual drive: a run folder.

Time starts at 0 with the recording. spec.yaml has the pose of the vehicle and drives it by the recorded commands, so
that ``mirdrake run FOLDER/spec.yaml`` repeats the drive.
"""

from collections.abc import Mapping
from copy import deepcopy
from dataclasses import replace
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any

import yaml
from pydrake.systems.framework import Context

from mirdrake.assembly.diagram import Assembly
from mirdrake.assembly.diagram_spec import Place
from mirdrake.controllers.schedule import ScheduleSpec
from mirdrake.core.files import write_file
from mirdrake.core.json_io import Json
from mirdrake.runs.logs import SPEC, Run, RunWriter, read_signals
from mirdrake.runs.recorder import Blocks, Events, Recorder, vector_sensors
from mirdrake.runs.stop import Stop, StopReason
from mirdrake.runs.summary import figure_columns, make_summary, resolved_spec
from mirdrake.runs.telemetry import Telemetry

_OPEN = 3600.0  # [s] duration in spec.yaml until the recording ends


class DriveLog:
    """A run folder that is being written.

    Args:
        assembly: the simulated diagram.
        folder: new or empty.
        context: context at the start, its time 0.
        name: name of the driven vehicle.
        gains: changed gains by their path in control.yaml, for spec.yaml.

    Raises:
        RunError: the folder cannot be made or written.
    """

    def __init__(
        self, assembly: Assembly, folder: Path, context: Context, *, name: str, gains: Mapping[str, float] | None = None
    ) -> None:
        # The recording starts where the car is now: its spec repeats the run from this state.
        truth = assembly.diagram.GetSubsystemByName(f"{name}.truth")
        state = truth.GetOutputPort("state").Eval(truth.GetMyContextFromRoot(context))
        entry = assembly.spec.vehicles[name].model_copy(
            update={
                "start": Place(x=float(state[0]), y=float(state[1]), yaw=float(state[5])),
                "speed": float(state[6]),
                "control": _merge_gains(assembly.spec.vehicles[name].control, gains or {}),
            }
        )
        spec = assembly.spec.model_copy(
            update={"vehicles": assembly.spec.vehicles | {name: entry}, "control": {}, "name": folder.name}
        )
        self._assembly, self._name = replace(assembly, spec=spec), name
        self._data = self._resolve(_OPEN)
        self._writer = RunWriter(folder, self._data, assembly.scene)
        # A recorder costs time, so that there is one only if a sensor has something to record.
        self._recorder: Recorder | None = None
        if assembly.cameras or assembly.arrays or vector_sensors(assembly):
            self._recorder = Recorder(assembly, folder)
            self._recorder.__enter__()
        self._telemetry, self._blocks, self._events = (
            Telemetry(assembly),
            Blocks(self._writer),
            Events(self._writer),
        )
        self._began = perf_counter()
        self.folder = folder

    def watch(self, context: Context) -> None:
        """Record the sensors after a step."""
        if self._recorder is not None:
            self._recorder(context)

    def read(self, context: Context) -> None:
        """Read the samples since the last call and write them to the log."""
        times, columns = self._telemetry.read(context)
        if not times.size:
            return
        self._blocks.add(times, columns, self._telemetry.units)
        self._events.look(times, columns, [self._name])

    def add(self, time: float, kind: str, text: str) -> None:
        """Write an event: time [s], kind and text."""
        self._events.add(time, kind, text)

    def finish(self, context: Context, *, reason: str) -> Run:
        """Close the folder.

        Args:
            context: context at the end.
            reason: why the recording ends.
        """
        self.read(context)
        if self._recorder is not None:
            self._recorder.__exit__(None)
        # The duration is known only now, so that spec.yaml is written again.
        simulated, wall = float(context.get_time()), perf_counter() - self._began
        self._events.add(simulated, "stop", reason)
        self._data = self._resolve(max(simulated, 1e-3))
        text = yaml.safe_dump(self._data, sort_keys=False, allow_unicode=True, width=100)
        write_file(self.folder / SPEC, text)
        stop = Stop(StopReason.INTERRUPTED, reason)
        figures = partial(make_summary, self._assembly, self._data, simulated=simulated, wall=wall, stop=stop)
        recorded = self._recorder.counts() if self._recorder is not None else {}
        # Figures are computed from the files, as the signals are not kept in memory.
        read = partial(read_signals, self.folder, figure_columns(self._assembly))
        summary = self._writer.finish(lambda: figures(read()) | recorded)
        units, scene = self._telemetry.units, self._assembly.scene
        return Run(self.folder, self._data, summary, units, self._events.entries, laid_out=scene)

    def _resolve(self, duration: float) -> Json:
        data = resolved_spec(self._assembly, duration=duration)
        commands = ScheduleSpec(kind="schedule", file=".", vehicle=self._name)
        data["control"] = {self._name: commands.model_dump(mode="json")}
        return data


def _merge_gains(control: Mapping[str, Any], gains: Mapping[str, float]) -> Mapping[str, Any]:
    """Return changes of a control.yaml merged with gains by their paths."""
    data: Json = deepcopy(dict(control))
    for path, value in gains.items():
        loop, _, gain = path.partition(".")
        data.setdefault(loop, {})[gain] = value
    return data
