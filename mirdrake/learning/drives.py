"""Runs of the expert and of the network: their diagrams, their segments between interventions, their figures."""

import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from math import nan, tau
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.math import RollPitchYaw
from pydrake.systems.framework import Context

from mirdrake.assembly.diagram import assemble
from mirdrake.assembly.diagram_spec import make_spec
from mirdrake.core.errors import ConfigError
from mirdrake.core.files import write_errors
from mirdrake.core.json_io import Json
from mirdrake.plant.plant import set_start
from mirdrake.runs.logs import Run, load_run
from mirdrake.runs.simulation import Simulation
from mirdrake.runs.stop import StopReason
from mirdrake.studies.plan import put

PILOT = "pilot"
"""Name of the block of the network."""

SINES = 3
"""Sines whose sum is the injected error of the steering."""

FREQUENCIES = (0.1, 0.5)
"""Range of their frequencies [Hz]."""

INTERVENTION_TIME = 6.0
"""Time that an intervention counts for in the autonomy [s] (Bojarski et al., arXiv 1604.07316, section 7)."""

MOST_INTERVENTIONS = 20
"""Interventions after which a drive ends."""

DELAY_STEP = 0.01
"""Approximate sampling period of the delayed steering of the expert [s]."""

CHECK_PERIOD = 0.1
"""Time between two checks of the lateral error [s]."""


@dataclass(frozen=True)
class Figures:
    """Figures of a drive.

    Attributes:
        laps: distance along the track over its length [1].
        time: simulated [s].
        interventions: times that the car left the line by more than the limit or diverged, to be put back.
        autonomy: 1 - 6 s · interventions / time [1].
        rms: root mean square of the lateral error [m].
        largest: largest lateral error [m].
        off_road: time with a wheel off the road [s].
        finished: whether all laps were driven.
    """

    laps: float
    time: float
    interventions: int
    autonomy: float
    rms: float
    largest: float
    off_road: float
    finished: bool


@dataclass(frozen=True)
class Drive:
    """A drive: the folders of its segments, and its figures."""

    folders: tuple[str, ...]
    figures: Figures

    def record(self) -> Json:
        """Return plain data for a journal."""
        return {"folders": list(self.folders), "figures": asdict(self.figures)}

    @classmethod
    def read(cls, record: Mapping[str, Any]) -> "Drive":
        """Return the drive of a record."""
        return cls(tuple(record["folders"]), Figures(**record["figures"]))

    def runs(self, base: Path) -> list[Run]:
        """Return the runs of the segments."""
        return [load_run(base / folder) for folder in self.folders]


@dataclass(frozen=True)
class Car:
    """What drives where.

    Attributes:
        vehicle: name of the vehicle in the diagram.
        camera: name of its camera.
    """

    vehicle: str
    camera: str

    @property
    def image(self) -> str:
        """Name of the camera in runs."""
        return f"{self.vehicle}.{self.camera}"

    @property
    def command(self) -> str:
        """Signal of the expert's steering."""
        return f"{self.vehicle}.steering_command"

    @property
    def reference(self) -> str:
        """Input that the steering is connected to."""
        return f"{self.vehicle}.steering_reference"


def with_camera(diagram: Json, car: Car, *, rate: float, world: Any = None) -> Json:
    """Return a diagram that records the pictures of one camera at a rate [Hz], in another world if one is given."""
    # Only this camera renders: pictures of other cameras and sensors would cost time and are not learnt.
    mounts = diagram["vehicles"][car.vehicle].get("mounts") or {}
    mounts = {**mounts, car.camera: {**mounts.get(car.camera, {}), "rate": rate}}
    data = put(diagram, f"vehicles.{car.vehicle}.mounts", mounts)
    record = {**(diagram.get("record") or {}), "cameras": True, "meshcat": False, "report": False}
    data = {**data, "sensors": {**data.get("sensors", {}), car.vehicle: [car.camera]}, "record": record}
    return data if world is None else {**data, "world": {"name": world} if isinstance(world, str) else world}


def with_errors(diagram: Json, car: Car, *, rms: float, seed: Sequence[int]) -> Json:
    """Return a diagram in which errors are added to the steering of the expert: a sum of sines.

    The expert sees what they do to the car and corrects it. Its commands, without the errors, are the labels.

    Args:
        diagram: of the expert.
        car: see :class:`Car`.
        rms: root mean square of the errors [rad].
        seed: of frequencies and phases.
    """
    if rms <= 0.0:
        return diagram
    # Smooth errors below 0.5 Hz, which the vehicle follows: a fast error would hardly move it.
    random = np.random.default_rng(seed)
    frequencies, phases = random.uniform(*FREQUENCIES, SINES), random.uniform(0.0, tau, SINES)
    # A sine of amplitude A has the mean square A² / 2, and those of independent sines add.
    amplitude = rms * (2.0 / SINES) ** 0.5
    systems: Json = {
        f"error{index}": {"kind": "sine", "amplitude": amplitude, "frequency": float(f), "phase": float(phase)}
        for index, (f, phase) in enumerate(zip(frequencies, phases, strict=True))
    }
    systems["with_errors"] = {"kind": "adder", "inputs": SINES + 1}
    pairs = [(car.command, "with_errors.u0"), ("with_errors.sum", car.reference)]
    pairs += [(f"error{index}.y0", f"with_errors.u{index + 1}") for index in range(SINES)]
    return _connected(diagram, systems, pairs)


def with_network(diagram: Json, car: Car, *, file: Path, latency: float, inputs: Sequence[str] = ()) -> Json:
    """Return a diagram in which a network steers; the expert's commands are still computed and recorded."""
    systems = {PILOT: {"kind": "network", "file": str(file), "image": car.image, "latency": latency}}
    pairs = [(f"{PILOT}.y", car.reference)]
    pairs += [(f"{car.vehicle}.{name}", f"{PILOT}.inputs.inputs{index}") for index, name in enumerate(inputs)]
    return _connected(diagram, systems, pairs)


def with_delay(diagram: Json, car: Car, *, rate: float, latency: float) -> Json:
    """Return a diagram in which the expert's steering acts with the delay of a network: a perfect copy of the expert.

    Args:
        diagram: of the expert.
        car: see :class:`Car`.
        rate: commands per second [Hz].
        latency: of each [s].
    """
    # A network's command is held for a period and acts after its latency; the copy gets both.
    systems: Json = {"held": {"kind": "hold", "period": 1.0 / rate}}
    pairs, source = [(car.command, "held.u")], "held.y"
    if latency > 0.0:
        period = latency / max(1, round(latency / DELAY_STEP))
        systems["late"] = {"kind": "delay", "delay": latency, "period": period}
        pairs, source = [*pairs, (source, "late.u")], "late.y"
    record = {**(diagram.get("record") or {}), "cameras": False, "meshcat": False, "report": False}
    return _connected({**diagram, "sensors": {}, "record": record}, systems, [*pairs, (source, car.reference)])


def _connected(diagram: Json, systems: Mapping[str, Any], pairs: Sequence[tuple[str, str]]) -> Json:
    # An input port has one connection, so the one to the driver is replaced.
    taken = {sink for _, sink in pairs}
    remaining = [pair for pair in diagram.get("connect", ()) if pair[1] not in taken]
    return {**diagram, "systems": {**diagram.get("systems", {}), **systems}, "connect": [*remaining, *pairs]}


def drive(
    diagram: Json,
    car: Car,
    folder: Path,
    *,
    base: Path,
    laps: float,
    limit: float,
    duration: float | None = None,
    progress: Callable[[float], None] | None = None,
) -> Drive:
    """Drive a car along its track in segments; after each intervention it is put back onto the centre line.

    Args:
        diagram: the diagram with its driver.
        car: see :class:`Car`.
        folder: for the run folders of the segments; what an interrupted drive has left there is removed.
        base: folder that the paths of the segments are relative to.
        laps: laps to drive.
        limit: lateral error that is an intervention [m].
        duration: simulated time [s]; by default that of the diagram for each lap.
        progress: called with the share that is done.

    Raises:
        ConfigError: the diagram cannot be built, or the vehicle has no track.
        KeyboardInterrupt: Ctrl-C.
    """
    if folder.exists():
        with write_errors(folder):
            shutil.rmtree(folder)
    # The diagram is built once for all segments. Laps are counted here, as each segment starts its own count.
    spec = make_spec({**diagram, "laps": None})
    assembly = assemble(spec)
    part, name = assembly.parts.vehicles[car.vehicle], assembly.tracks[car.vehicle]
    if name is None:
        raise ConfigError(f"the world '{assembly.parts.world.name}' has no track for the vehicle '{car.vehicle}'")
    track, start = assembly.parts.world.tracks[name], assembly.starts[car.vehicle]
    simulation, plant = Simulation(assembly), assembly.parts.plant
    time_left = duration or spec.duration * max(1.0, laps)
    whole, wanted, covered = time_left, laps * float(track.length), 0.0
    speed, place, interventions = start.speed, None, 0
    runs: list[Run] = []
    folders: list[str] = []
    # Each pass is a run from the last place to the next intervention, which starts a new segment with its own folder.
    while covered < wanted - 1e-6 and time_left > CHECK_PERIOD and interventions < MOST_INTERVENTIONS:
        watch = _Watch(plant, part, track, limit=limit, distance=wanted - covered)

        # Defaults bind the values of this pass, as a closure would read those of a later one.
        def put_on_line(context: Context, place: float | None = place, speed: float = speed) -> None:
            if place is not None:
                x, y, yaw = (float(value) for value in track.pose(place))
                own = plant.GetMyMutableContextFromRoot(context)
                set_start(plant, own, part, x=x, y=y, yaw=yaw, speed=speed)

        def show(time: float, _: float, before: float = whole - time_left) -> None:
            if progress is not None:
                progress(min((before + time) / whole, 1.0))

        path = folder / f"segment-{len(runs) + 1}"
        run = simulation.run(duration=time_left, folder=path, change=put_on_line, until=watch, progress=show)
        if run.stop.reason is StopReason.INTERRUPTED:
            raise KeyboardInterrupt
        runs.append(run)
        folders.append(str(path.relative_to(base)))
        time_left -= float(run.summary["simulated_s"])
        covered += watch.covered
        # Put back where it left the line, at its speed: an intervention changes only the lateral state.
        place, speed = watch.place, max(watch.speed, 0.0)
        # The end of the time or of the distance is not an intervention.
        interventions += int(watch.has_left or run.diverged)
        if run.stop.reason is not StopReason.CONDITION and not run.diverged:
            break
    # With a duration of its own, a run of the expert is finished at its end, not after a lap.
    finished = covered >= wanted - 1e-6 or (duration is not None and len(runs) == 1 and time_left <= CHECK_PERIOD)
    figures = _figures(runs, car.vehicle, covered / float(track.length), interventions, finished=finished)
    return Drive(tuple(folders), figures)


class _Watch:
    """Condition that ends a segment: the car is too far off its line, or has driven the whole distance."""

    def __init__(self, plant: Any, part: Any, track: Any, *, limit: float, distance: float) -> None:
        self._plant, self._part, self._track = plant, part, track
        self._limit, self._distance, self._next = limit, distance, 0.0
        self.covered, self.speed, self.has_left = 0.0, 0.0, False
        self.place: float | None = None

    def __call__(self, context: Context) -> bool:
        # Projecting at every step of the plant would slow the run down.
        if context.get_time() < self._next - 1e-9:
            return False
        self._next = context.get_time() + CHECK_PERIOD
        own = self._plant.GetMyContextFromRoot(context)
        pose = self._part.base.EvalPoseInWorld(own)
        velocity = self._part.base.EvalSpatialVelocityInWorld(own).translational()
        yaw = RollPitchYaw(pose.rotation()).yaw_angle()
        x, y, _ = pose.translation()
        s, lateral = (float(value) for value in self._track.project(x, y))
        if self.place is not None:
            # Differences wrapped to half a lap, so that passing the start line is not a jump back.
            step, length = s - self.place, float(self._track.length)
            self.covered += (step + 0.5 * length) % length - 0.5 * length if self._track.closed else step
        self.place, self.speed = s, float(velocity[0] * np.cos(yaw) + velocity[1] * np.sin(yaw))
        self.has_left = bool(abs(lateral) > self._limit and self.covered < self._distance)
        return self.has_left or self.covered >= self._distance


def _figures(runs: Sequence[Run], vehicle: str, laps: float, interventions: int, *, finished: bool) -> Figures:
    # Over all runs of the drive: an intervention ends a run, and the next one begins there.
    errors = np.concatenate([run[f"{vehicle}.lateral_error"].to_numpy(dtype=float) for run in runs])
    time = sum(float(run.summary["simulated_s"]) for run in runs)
    off = sum(float(run.summary["vehicles"][vehicle]["off_road_s"] or 0.0) for run in runs)
    return Figures(
        laps=round(laps, 4),
        time=round(time, 3),
        interventions=interventions,
        autonomy=round(max(0.0, 1.0 - INTERVENTION_TIME * interventions / time), 4) if time else nan,
        rms=round(float(np.sqrt(np.mean(errors**2))), 4),
        largest=round(float(np.abs(errors).max()), 4),
        off_road=round(off, 3),
        finished=finished,
    )
