"""Runs of a manoeuvre: the full plant, or the single-track model behind the same driver."""

import math
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd
import yaml
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, DiagramBuilder, EventStatus
from pydrake.systems.primitives import LogVectorOutput

from mirdrake.assembly.diagram import assemble
from mirdrake.assembly.scene import Scene
from mirdrake.controllers.drivers import OwnDriverSpec
from mirdrake.core.errors import RunError
from mirdrake.core.files import write_file
from mirdrake.core.vectors import STATE
from mirdrake.manoeuvres.base import Diverged
from mirdrake.manoeuvres.facts import Facts
from mirdrake.manoeuvres.record import Record, bicycle_angles
from mirdrake.runs.logs import RunWriter
from mirdrake.runs.simulation import Simulation
from mirdrake.runs.stop import StopReason
from mirdrake.single_track import SingleTrack, SingleTrackControl
from mirdrake.single_track.dynamics import Variant
from mirdrake.single_track.from_vehicle import estimate_parameters
from mirdrake.single_track.powertrain import SingleTrackPowertrain, make_single_track_law
from mirdrake.vehicles import Vehicle
from mirdrake.worlds import World
from mirdrake.worlds.loading import make_world
from mirdrake.worlds.world import SURFACE_MU

Model = Literal["full", "single_track"]
Stop = Callable[[float, Sequence[float]], str | None]
"""Time [s] and state (12) of the vehicle to why the run is over, or None."""

RATE = 200.0
"""Samples of the logs per second [Hz]: a steering wheel that moves for a tenth of a second needs that many."""

_LOOK = 0.05
"""Time between two looks at whether to stop [s]."""

_EXTENT = 20_000.0
"""Side of the ground [m]."""

_DRIVERS = "mirdrake.manoeuvres.drivers:"


@dataclass
class _Look:
    """Asks every :data:`_LOOK` whether a run is over, and keeps the reason."""

    stop: Stop | None
    state: Callable[[Context], Sequence[float]]
    reason: str = "duration"
    last: float = -1.0

    def __call__(self, context: Context) -> bool:
        now = context.get_time()
        if self.stop is None or now < self.last + _LOOK:
            return False
        self.last = now
        why = self.stop(now, self.state(context))
        if why is None:
            return False
        self.reason = why
        return True


@dataclass
class Rig:
    """Where manoeuvres are driven.

    Attributes:
        model: name of the vehicle, for the diagram.
        vehicle: the loaded vehicle.
        facts: its figures.
        kind: "full" or "single_track".
        plant: settings of the plant, as in a diagram file; see :attr:`contact` for the contact that is left out.
        friction: of the road [1].
        seed: of everything random.
        folder: where the runs are written, one folder a run; None writes nothing.
        tell: told what is being driven.
        records: all runs so far.
        arguments: of the xacro files, with which the vehicle was loaded.
    """

    model: str
    vehicle: Vehicle
    facts: Facts
    kind: Model = "full"
    plant: Mapping[str, Any] = field(default_factory=dict)
    friction: float = SURFACE_MU["asphalt"]
    seed: int = 0
    folder: Path | None = None
    tell: Callable[[str], None] = lambda _: None
    records: list[Record] = field(default_factory=list)
    arguments: Mapping[str, str] = field(default_factory=dict)

    @property
    def pedals(self) -> bool:
        """Whether drivers may press pedals."""
        return self.facts.pedals

    @property
    def contact(self) -> str:
        """Contact of the plant: where tyres have a law of their own, points, else patches, unless it is given.

        Both carry the load of tyres with a law and nothing else; points take half of the time.
        """
        return str(self.plant.get("contact", "point" if self.facts.has_tyre_law else "hydroelastic"))

    def with_step(self, time_step: float) -> "Rig":
        """The same rig with another time step of the plant [s], unless one was asked for."""
        return replace(self, plant={"time_step": time_step} | dict(self.plant))

    def line_driver(self, line: Mapping[str, Any], *, speed: float = math.inf, **settings: Any) -> dict[str, Any]:
        """A driver along a line, at a speed [m/s], with the vehicle's numbers; with `pedals` it presses them."""
        scale = self.facts.scale
        kind = "PathPedalDriver" if settings.get("pedals") is not None else "PathDriver"
        numbers = {
            "ahead": self.facts.ahead,
            "understeer": max(self.facts.understeer, 0.0),
            "frequency": min(5.0 / scale**0.5, self.facts.quickest(speed)),
            "preview": 0.1,
            "course": self.facts.steadiness(speed),
        }
        settings = {key: value for key, value in settings.items() if value is not None}
        return {"kind": _DRIVERS + kind, "line": dict(line)} | numbers | settings

    def open_driver(self, profile: Mapping[str, Any], **settings: Any) -> dict[str, Any]:
        """A driver by a profile; with `pedals` it presses them."""
        kind = "OpenLoopPedalDriver" if settings.get("pedals") is not None else "OpenLoopDriver"
        settings = {key: value for key, value in settings.items() if value is not None}
        return {"kind": _DRIVERS + kind, "profile": dict(profile)} | settings

    def run(
        self,
        label: str,
        driver: Mapping[str, Any],
        *,
        duration: float,
        speed: float = 0.0,
        y: float = 0.0,
        x: float = 0.0,
        ground: Mapping[str, Any] | None = None,
        stop: Stop | None = None,
        parked: bool = False,
    ) -> Record:
        """One run.

        Args:
            label: name of its folder.
            driver: as under ``control`` of a diagram file.
            duration: longest simulated time [s].
            speed: at the start [m/s].
            y: of the start [m].
            x: the same [m].
            ground: of the world, over flat asphalt: slope, patches.
            stop: see :data:`Stop`.
            parked: parking brakes hold the wheels; full plant only.

        Raises:
            Diverged: the run did.
            ConfigError: a setting makes no sense.
        """
        self.tell(label)
        world = {
            "mirdrake": "world/1",
            "name": label,
            "ground": {"surface": "asphalt", "mu": self.friction, "size": [_EXTENT, _EXTENT]} | dict(ground or {}),
        }
        place = {"x": x, "y": y, "yaw": 0.0}
        if self.kind == "full":
            entry = {"model": self.model, "start": place, "speed": speed, "parked": parked}
            entry |= {"arguments": dict(self.arguments)} if self.arguments else {}
            record = self._run_plant(label, driver, world, entry, duration=duration, stop=stop)
        else:
            record = self._run_single_track(label, driver, world, place, duration=duration, speed=speed, stop=stop)
        self.records.append(record)
        return record

    # --- the full plant --------------------------------------------------------------------------------------------

    def _run_plant(
        self,
        label: str,
        driver: Mapping[str, Any],
        world: Mapping[str, Any],
        entry: Mapping[str, Any],
        *,
        duration: float,
        stop: Stop | None,
    ) -> Record:
        folder = self.folder / label if self.folder is not None else None
        with tempfile.TemporaryDirectory() as scratch:
            file = Path(scratch) / "world.yaml"
            write_file(file, yaml.safe_dump(dict(world), sort_keys=False))
            spec = {
                "name": label,
                "world": str(file),
                "vehicles": {"ego": dict(entry)},
                "control": {"ego": dict(driver)},
                "plant": dict(self.plant) | {"contact": self.contact},
                "record": {"rate": RATE, "meshcat": False, "report": False},
                "duration": duration,
                "seed": self.seed,
            }
            assembly = assemble(spec)
        truth = assembly.diagram.GetSubsystemByName("ego.truth")
        look = _Look(stop, lambda context: truth.state.Eval(truth.GetMyContextFromRoot(context)).tolist())
        try:
            run = Simulation(assembly).run(until=look if stop is not None else None)
        except RunError as error:
            raise Diverged(f"{label}: {error}") from None
        ended = run.stop.reason
        if ended is StopReason.INTERRUPTED:
            raise KeyboardInterrupt
        signals = run.signals
        if folder is not None:
            data = dict(run.spec)
            data["world"] = {**data["world"], "name": "world.yaml"}
            detail = look.reason if ended is StopReason.CONDITION else run.stop.detail
            summary = run.summary | {"stop_detail": detail, "world": label}
            self._write(folder, data, signals, run.units, summary, world, run.scene())
        if run.diverged:
            raise Diverged(f"{label}: {run.stop}")
        columns = {str(name).removeprefix("ego."): signals[name].to_numpy() for name in signals}
        units = {name.removeprefix("ego."): unit for name, unit in run.units.items()}
        angle = bicycle_angles(columns["steering_angle.left"], columns["steering_angle.right"])
        return self._record(label, signals.index.to_numpy(), columns, angle, units, look.reason)

    # --- the single-track model -------------------------------------------------------------------------------------

    def _run_single_track(
        self,
        label: str,
        driver: Mapping[str, Any],
        world: Mapping[str, Any],
        place: Mapping[str, float],
        *,
        duration: float,
        speed: float,
        stop: Stop | None,
    ) -> Record:
        began = time.perf_counter()
        scene: World = make_world(dict(world))
        roll = self.vehicle.spec.suspension is not None
        parameters = estimate_parameters(
            self.vehicle, friction=self.friction, gravity=[float(part) for part in scene.ground.gravity], roll=roll
        )
        builder = DiagramBuilder()
        variant = Variant("brush", relaxation=True, actuators=True, roll=roll)
        model = builder.AddNamedSystem("single_track", SingleTrack(parameters, variant))
        mass, rotating = parameters.mass, parameters.rotating_mass
        control = builder.AddNamedSystem("control", SingleTrackControl(self.vehicle, mass=mass, rotating=rotating))
        pilot = OwnDriverSpec(**dict(driver)).make_system(self.vehicle, scene, where=label)
        builder.AddNamedSystem("driver", pilot)
        builder.Connect(control.steering, model.steering)
        if self.pedals:
            law = make_single_track_law(self.vehicle, mass=mass, rotating=rotating)
            powertrain = builder.AddNamedSystem("powertrain", SingleTrackPowertrain(law))
            foot = pilot.GetOutputPort("pedals") if pilot.HasOutputPort("pedals") else control.pedals
            builder.Connect(foot, powertrain.pedals)
            builder.Connect(model.state, powertrain.state)
            builder.Connect(powertrain.forces, model.forces)
        else:
            builder.Connect(control.forces, model.forces)
        for port in (control.state, pilot.GetInputPort("state")):
            builder.Connect(model.state, port)
        builder.Connect(model.steering_angle, control.steering_angle)
        builder.Connect(pilot.GetOutputPort("command"), control.command)
        ports = (model.state, model.steering_angle, control.status, pilot.GetOutputPort("command"))
        logs = [LogVectorOutput(port, builder, publish_period=1.0 / RATE) for port in ports]
        diagram = builder.Build()
        simulator = Simulator(diagram)
        context = simulator.get_mutable_context()
        model.set_state(model.GetMyContextFromRoot(context), x=place["x"], y=place["y"], vx=speed)
        look = _Look(stop, lambda context: model.state.Eval(model.GetMyContextFromRoot(context)).tolist())
        simulator.set_monitor(
            lambda context: (
                EventStatus.ReachedTermination(model, look.reason) if look(context) else EventStatus.DidNothing()
            )
        )
        try:
            simulator.Initialize()
            simulator.AdvanceTo(duration)
        except Exception as error:  # whatever a step may raise
            raise Diverged(f"{label}: {str(error).splitlines()[0]}") from None
        found = [log.FindLog(context) for log in logs]
        times = found[0].sample_times().copy()
        columns = {signal.name: row for signal, row in zip(STATE, found[0].data(), strict=True)}
        units = {"time": "s"} | {signal.name: signal.unit for signal in STATE}
        columns["steering_angle"], units["steering_angle"] = found[1].data()[0], "rad"
        for name, unit, row in zip(
            ("speed_setpoint", "steering_setpoint", "speed_trim", "speed_command", "steering_command"),
            ("m/s", "rad", "m/s", "m/s", "rad"),
            (*found[2].data(), *found[3].data()[:2]),
            strict=True,
        ):
            columns[name], units[name] = row, unit
        if not all(np.isfinite(values).all() for values in columns.values()):
            raise Diverged(f"{label}: a state is no finite number")
        if self.folder is not None:
            table = pd.DataFrame({f"ego.{name}": values for name, values in columns.items()}, index=times)
            named = {f"ego.{name}" if name != "time" else name: unit for name, unit in units.items()}
            data = {"model": "single_track", "vehicle": self.model, "driver": dict(driver), "speed": speed}
            summary = {
                "stop_reason": StopReason.CONDITION,
                "stop_detail": look.reason,
                "wall_s": round(time.perf_counter() - began, 3),
            }
            self._write(self.folder / label, data, table, named, summary, world, Scene(scene, {"ego": self.vehicle}))
        angle = columns.pop("steering_angle")
        return self._record(label, times, columns, angle, units, look.reason)

    # --- both -------------------------------------------------------------------------------------------------------

    def _record(
        self,
        label: str,
        times: Any,
        columns: dict[str, Any],
        angle: Any,
        units: Mapping[str, str],
        stop: str,
    ) -> Record:
        taken = ("x", "y", "vx", "vy", "roll")
        return Record(
            label=label,
            time=times,
            yaw=np.unwrap(columns["yaw"]),
            yaw_rate=columns["wz"],
            steering=angle,
            ahead=self.facts.ahead,
            ratio=self.facts.ratio,
            others={name: values for name, values in columns.items() if name not in taken},
            units=units,
            stop=stop,
            **{name: columns[name] for name in taken},
        )

    def _write(
        self,
        folder: Path,
        data: Mapping[str, Any],
        table: pd.DataFrame,
        units: Mapping[str, str],
        summary: Mapping[str, Any],
        world: Mapping[str, Any],
        scene: Scene,
    ) -> None:
        """Write a run folder, as those of ``mirdrake run``; the world is beside its spec."""
        writer = RunWriter(folder, data, scene)
        write_file(folder / "world.yaml", yaml.safe_dump(dict(world), sort_keys=False))
        columns = {str(name): table[name].to_numpy() for name in table}
        writer.write_signals(table.index.to_numpy(dtype=float), columns, units)
        writer.finish(lambda: summary)
