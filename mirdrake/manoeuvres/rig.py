"""Runs of a manoeuvre: the full plant, or the single-track model behind the same driver."""

import json
import math
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd
import yaml
from pydrake.systems.framework import Context

from mirdrake.assembly.diagram import assemble
from mirdrake.assembly.scene import Scene
from mirdrake.batched.control import COMMANDS, STATUS
from mirdrake.core.contacts import STUDY_CONTACT
from mirdrake.core.errors import ConfigError, RunError
from mirdrake.core.files import write_file
from mirdrake.core.vectors import STATE
from mirdrake.manoeuvres.base import Array, Diverged
from mirdrake.manoeuvres.facts import Facts
from mirdrake.manoeuvres.record import Record, bicycle_angles, unwrapped
from mirdrake.manoeuvres.reduced import (
    RATE,
    STOP_SAMPLES,
    ReducedCar,
    ReducedLog,
    ReducedParameters,
    ReducedRun,
    Stop,
    alone,
)
from mirdrake.plant.plant import PlantSpec
from mirdrake.runs.logs import RunWriter
from mirdrake.runs.simulation import Simulation
from mirdrake.runs.stop import StopReason
from mirdrake.vehicles import Vehicle
from mirdrake.worlds.loading import make_world
from mirdrake.worlds.world import SURFACE_MU

Model = Literal["full", "single_track"]
STANDSTILL = "standstill"
"""Stop detail of a run that ends at standstill; signals.parquet ends with the last sample before it."""

_STOP_PERIOD = STOP_SAMPLES / RATE
"""Time between two evaluations of the stop condition [s]."""

_EXTENT = 20_000.0
"""Side of the ground [m]."""


@dataclass
class _StopMonitor:
    """Monitor that evaluates a stop condition every :data:`_STOP_PERIOD` and keeps the reason."""

    stop: Stop | None
    state: Callable[[Context], Sequence[float]]
    reason: str = "duration"
    last: float = -1.0

    def __call__(self, context: Context) -> bool:
        now = context.get_time()
        if self.stop is None or now < self.last + _STOP_PERIOD:
            return False
        self.last = now
        reason = self.stop(now, self.state(context))
        self.reason = reason or self.reason
        return reason is not None


@dataclass
class Rig:
    """Vehicle and conditions of manoeuvres, and their runs.

    Attributes:
        model: name of the vehicle, for the diagram.
        vehicle: the loaded vehicle.
        facts: its figures.
        kind: "full" or "single_track".
        plant: settings of the plant, as in a diagram file; see :attr:`contact` for the default contact.
        friction: friction of the road [1].
        seed: seed of random steering and of sensors.
        folder: folder in which each run writes its own; None writes nothing.
        report: called with the name of each run before it starts.
        records: all runs so far.
        arguments: xacro arguments of the vehicle.
        changes: parameters of the single-track model in place of those of the vehicle, by name.
        gains: gains of its control unit in place of those of control.yaml, by name, as ``speed.kp``.
        simulate: simulates a run of the single-track model; by default alone, as a batch of one car.
    """

    model: str
    vehicle: Vehicle
    facts: Facts
    kind: Model = "full"
    plant: Mapping[str, Any] = field(default_factory=dict)
    friction: float = SURFACE_MU["asphalt"]
    seed: int = 0
    folder: Path | None = None
    report: Callable[[str], None] = lambda _: None
    records: list[Record] = field(default_factory=list)
    arguments: Mapping[str, str] = field(default_factory=dict)
    changes: Mapping[str, float] = field(default_factory=dict)
    gains: Mapping[str, float] = field(default_factory=dict)
    simulate: Callable[[ReducedRun], ReducedLog] = field(default_factory=lambda: alone(ReducedParameters()))

    def __post_init__(self) -> None:
        if (self.changes or self.gains) and self.kind == "full":
            names = [*(f"single_track.{name}" for name in self.changes), *(f"gains.{name}" for name in self.gains)]
            raise ConfigError("is a setting of the single-track model; leave it out for the full plant", where=names[0])
        if self.changes:
            # The driver knows the car that he drives.
            self.facts = self.facts.with_parameters(self.changes)

    @property
    def pedals(self) -> bool:
        """Whether drivers may press pedals."""
        return self.facts.pedals

    @property
    def contact(self) -> str:
        """Contact model of the plant on the plane z = 0, by default tyre contact, which uneven ground always has."""
        return str(self.plant.get("contact", STUDY_CONTACT))

    @property
    def _time_step(self) -> float:
        """Return the time step of the plant [s]."""
        return float(self.plant.get("time_step", PlantSpec().time_step))

    def with_step(self, time_step: float) -> "Rig":
        """Return the same rig with another time step of the plant [s], unless the user has set one."""
        return replace(self, plant={"time_step": time_step} | dict(self.plant))

    def line_driver(
        self, line: Mapping[str, object], *, speed: float = math.inf, **settings: object
    ) -> dict[str, object]:
        """Return the entry of a PathDriver for this vehicle at a speed [m/s]; None values of `settings` are omitted."""
        numbers = {
            "ahead": self.facts.ahead,
            "understeer": max(self.facts.understeer, 0.0),
            "frequency": min(5.0 / self.facts.scale**0.5, self.facts.quickest(speed)),
            "preview": 0.1,
            "course": self.facts.steadiness(speed),
        }
        return _driver("PathDriver", line=dict(line), **(numbers | _given(settings)))

    def open_driver(self, profile: Mapping[str, object], **settings: object) -> dict[str, object]:
        """Return the entry of an OpenLoopDriver; None values of `settings` are omitted."""
        return _driver("OpenLoopDriver", profile=dict(profile), **_given(settings))

    def run(
        self,
        label: str,
        driver: Mapping[str, object],
        *,
        duration: float,
        speed: float = 0.0,
        y: float = 0.0,
        x: float = 0.0,
        ground: Mapping[str, object] | None = None,
        stop: Stop | None = None,
        parked: bool = False,
    ) -> Record:
        """Simulate one run.

        Args:
            label: name of the run and of its folder.
            driver: driver, as under ``control`` of a diagram file.
            duration: longest simulated time [s].
            speed: speed at the start [m/s].
            y: y of the start [m].
            x: x of the start [m].
            ground: keys of the world's ground besides flat asphalt: slope, patches.
            stop: stop condition.
            parked: whether parking brakes hold the wheels; full plant only.

        Raises:
            Diverged: the run diverged.
            ConfigError: a setting is out of range.
        """
        self.report(label)
        # A large plane: no manoeuvre reaches its edge.
        world: dict[str, object] = {
            "mirdrake": "world/1",
            "name": label,
            "ground": {"surface": "asphalt", "mu": self.friction, "size": [_EXTENT, _EXTENT]} | dict(ground or {}),
        }
        if self.kind == "full":
            entry = {"model": self.model, "start": {"x": x, "y": y, "yaw": 0.0}, "speed": speed, "parked": parked}
            entry |= {"arguments": dict(self.arguments)} if self.arguments else {}
            record = self._run_plant(label, driver, world, entry, duration=duration, stop=stop)
        else:
            record = self._run_single_track(label, driver, world, (x, y), duration=duration, speed=speed, stop=stop)
        self.records.append(record)
        return record

    # --- the full plant --------------------------------------------------------------------------------------------

    def _run_plant(
        self,
        label: str,
        driver: Mapping[str, object],
        world: Mapping[str, object],
        entry: Mapping[str, object],
        *,
        duration: float,
        stop: Stop | None,
    ) -> Record:
        folder = self.folder / label if self.folder is not None else None
        # Diagrams name their world by a file; it is read while the diagram is assembled and not needed later.
        with tempfile.TemporaryDirectory() as scratch:
            file = Path(scratch) / "world.yaml"
            write_file(file, yaml.safe_dump(dict(world), sort_keys=False))
            spec = {
                "name": label,
                "world": str(file),
                "vehicles": {"ego": dict(entry)},
                "control": {"ego": dict(driver)},
                "plant": dict(self.plant) | {"contact": self.contact},
                # Samples within a step would repeat those of its beginning.
                "record": {"rate": min(RATE, 1.0 / self._time_step), "meshcat": False, "report": False},
                "duration": duration,
                "seed": self.seed,
            }
            assembly = assemble(spec)
        # Stop conditions read the ground truth of the vehicle, without noise and delay of sensors.
        truth = assembly.diagram.GetSubsystemByName("ego.truth")
        monitor = _StopMonitor(stop, lambda context: truth.state.Eval(truth.GetMyContextFromRoot(context)).tolist())
        try:
            run = Simulation(assembly).run(until=monitor if stop is not None else None)
        # A plant that diverges is a result of the manoeuvre, not an error of the program.
        except RunError as error:
            raise Diverged(f"{label}: {error}") from None
        # Simulation turns Ctrl-C into a stop reason; a set of manoeuvres must end, too.
        ended = run.stop.reason
        if ended is StopReason.INTERRUPTED:
            raise KeyboardInterrupt
        signals = run.signals
        # Written also for a run that diverged, so that it can be examined.
        if folder is not None:
            data = run.spec | {"world": {**run.spec["world"], "name": "world.yaml"}}
            detail = monitor.reason if ended is StopReason.CONDITION else run.stop.detail
            summary = run.summary | {"stop_detail": detail, "world": label}
            _write(folder, data, signals, run.units, summary, world, run.scene())
        if run.diverged:
            raise Diverged(f"{label}: {run.stop}")
        # Names without the vehicle, as in the single-track model, so that the same metrics read both.
        columns = {str(name).removeprefix("ego."): signals[name].to_numpy() for name in signals}
        units = {name.removeprefix("ego."): unit for name, unit in run.units.items()}
        angle = bicycle_angles(columns["steering_angle.left"], columns["steering_angle.right"])
        return self._record(label, signals.index.to_numpy(), columns, angle, units, monitor.reason)

    # --- the single-track model -------------------------------------------------------------------------------------

    def _run_single_track(
        self,
        label: str,
        driver: Mapping[str, object],
        world: Mapping[str, object],
        start: tuple[float, float],
        *,
        duration: float,
        speed: float,
        stop: Stop | None,
    ) -> Record:
        begin = time.perf_counter()
        log = self.simulate(
            ReducedRun(
                label=label,
                car=ReducedCar(self.vehicle, self.changes, self.gains),
                friction=self.friction,
                gravity=_gravity(json.dumps(world["ground"])),
                driver=driver,
                x=start[0],
                y=start[1],
                speed=speed,
                duration=duration,
                stop=stop,
            )
        )
        columns = dict(log.columns)
        units = {"time": "s", "steering_angle": "rad"} | {signal.name: signal.unit for signal in STATE}
        units |= {signal.name: signal.unit for signal in (*STATUS, *COMMANDS)}
        if self.folder is not None:
            table = pd.DataFrame({f"ego.{name}": values for name, values in columns.items()}, index=log.time)
            # The time column belongs to all vehicles and has no prefix.
            named = {f"ego.{name}" if name != "time" else name: unit for name, unit in units.items()}
            data = {"model": "single_track", "vehicle": self.model, "driver": dict(driver), "speed": speed}
            reason = StopReason.DURATION if log.reason == "duration" else StopReason.CONDITION
            detail = "" if reason is StopReason.DURATION else log.reason
            summary = {"stop_reason": reason, "stop_detail": detail, "wall_s": round(time.perf_counter() - begin, 3)}
            scene = Scene(make_world(dict(world)), {"ego": self.vehicle})
            _write(self.folder / label, data, table, named, summary, world, scene)
        angle = columns.pop("steering_angle")
        return self._record(label, log.time, columns, angle, units, log.reason)

    # --- both -------------------------------------------------------------------------------------------------------

    def _record(
        self, label: str, times: Array, columns: dict[str, Array], angle: Array, units: Mapping[str, str], stop: str
    ) -> Record:
        # These are fields of the record; all others are kept by name.
        taken = ("x", "y", "vx", "vy", "roll")
        return Record(
            label=label,
            time=times,
            # Unwrapped: turns of more than 180 degrees must not jump.
            yaw=unwrapped(columns["yaw"]),
            yaw_rate=columns["wz"],
            steering=angle,
            ahead=self.facts.ahead,
            ratio=self.facts.ratio,
            others={name: values for name, values in columns.items() if name not in taken},
            units=units,
            stop=stop,
            **{name: columns[name] for name in taken},
        )


@lru_cache
def _gravity(ground: str) -> tuple[float, float, float]:
    """Return gravity over a ground [m/s²]; a slope tilts it.

    Args:
        ground: the ground of a world file as text, so that the worlds of a sweep are made once.
    """
    world = make_world({"mirdrake": "world/1", "name": "ground", "ground": json.loads(ground)})
    x, y, z = (float(part) for part in world.ground.gravity)
    return x, y, z


def _driver(kind: str, **settings: object) -> dict[str, object]:
    """Return the entry of a driver of manoeuvres for ``control`` of a diagram file."""
    return {"kind": f"mirdrake.manoeuvres.drivers:{kind}", **settings}


def _given(settings: Mapping[str, object]) -> dict[str, object]:
    return {key: value for key, value in settings.items() if value is not None}


def _write(
    folder: Path,
    data: Mapping[str, object],
    table: pd.DataFrame,
    units: Mapping[str, str],
    summary: Mapping[str, object],
    world: Mapping[str, object],
    scene: Scene,
) -> None:
    """Write a run folder, as those of ``mirdrake run``; the world is beside its spec."""
    if summary["stop_detail"] == STANDSTILL:
        # The stop condition is evaluated every _STOP_PERIOD. Until then tyres and springs push the vehicle back, with
        # speeds below zero that do not belong to the braking.
        table = table.iloc[: int(np.flatnonzero(table["ego.vx"] >= 0.0)[-1]) + 1]
    writer = RunWriter(folder, data, scene)
    write_file(folder / "world.yaml", yaml.safe_dump(dict(world), sort_keys=False))
    columns = {str(name): table[name].to_numpy() for name in table}
    writer.write_signals(table.index.to_numpy(dtype=float), columns, units)
    writer.finish(lambda: summary)
