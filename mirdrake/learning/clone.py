"""Behavioural cloning: a network learns to steer from an expert, drives, and learns from its own drives (DAgger).

::

    expert with injected errors ─► pictures, commands ─► training ─► pilot.onnx ─► drive ─► figures
                                          ▲                                         │ the expert labels what
                                          └──────────────── rounds ─────────────────┘ the network has seen

DAgger: S. Ross, G. Gordon, D. Bagnell, "A reduction of imitation learning and structured prediction to no-regret online
learning", AISTATS 2011. Labels of an unstable drive are large and would dominate: pictures far from the line, and those
with a label far from the network's command, are left out, and the loss is robust.

Finished steps are in journal.jsonl; a study that was stopped or killed continues after the last one, the training after
its last epoch.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mirdrake.assembly.diagram_spec import make_spec
from mirdrake.assembly.scene import make_scene
from mirdrake.core.digest import digest, digest_data
from mirdrake.core.errors import ConfigError, MissingDependencyError, did_you_mean
from mirdrake.core.files import read_errors, write_errors
from mirdrake.core.json_io import Json
from mirdrake.core.paths import installed_version
from mirdrake.core.signals import Signal
from mirdrake.core.yaml_io import where
from mirdrake.execution.journal import Journal
from mirdrake.learning.data import DrivingData, driving_data
from mirdrake.learning.delays import DelayMargin, delay_sentence, find_delay_margin, is_delay_the_cause
from mirdrake.learning.drives import PILOT, Car, Drive, drive, with_camera, with_delay, with_errors, with_network
from mirdrake.learning.explain import write_pictures
from mirdrake.learning.exporting import export_onnx
from mirdrake.learning.mirroring import mirror_signs
from mirdrake.learning.pilotnet import Architecture, import_torch
from mirdrake.learning.preparation import Preparation
from mirdrake.learning.result import JOURNAL, CloneResult, RoundResult, write_result
from mirdrake.learning.selection import value_at
from mirdrake.learning.spec import LearningSpec, load_learning
from mirdrake.learning.training import Trained, train
from mirdrake.sensors.cameras.mounts import PictureMount
from mirdrake.studies.plan import read_diagram

Progress = Callable[[str, float], None]
"""Called with the step and the share of it that is done."""


@dataclass(frozen=True)
class _Setup:
    """A checked study.

    Attributes:
        spec: the study.
        diagram: data of the diagram with the expert.
        car: its vehicle and camera.
        worlds: worlds to learn in, by label.
        judged: worlds to drive in, by label.
        folder: folder of the study.
        journal: finished steps.
        progress: see :data:`Progress`.
    """

    spec: LearningSpec
    diagram: Json
    car: Car
    worlds: Json
    judged: Json
    folder: Path
    journal: Journal
    progress: Progress

    def step(self, key: str, work: Callable[[], Json]) -> Json:
        """Return the record of a step; it is done unless the journal has it."""
        if key not in self.journal:
            began = time.process_time()
            record = work()
            self.journal.add(key, {**record, "processor_s": round(time.process_time() - began, 2)})
        return self.journal[key]


def clone(
    study: LearningSpec | Path | str,
    *,
    out: Path | str,
    progress: Progress | None = None,
    warn: Callable[[str], None] | None = None,
) -> CloneResult:
    """Teach a network to drive like the expert of a diagram.

    Args:
        study: a learning spec or its file.
        out: folder of the result; created. An unfinished result of this study is continued.
        progress: see :data:`Progress`.
        warn: called with a sentence before anything is trained if the delay of the loop is too large.

    Raises:
        ConfigError, ModelError, WorldError: the study, its diagram, vehicle or world has faults.
        MissingDependencyError: PyTorch, onnx or ONNX Runtime is not installed.
        RunError: the folder belongs to something else.
        KeyboardInterrupt: Ctrl-C; call again to continue.
    """
    spec = study if isinstance(study, LearningSpec) else load_learning(study)
    _check_packages()
    setup = _set_up(spec, Path(out), progress or (lambda *_: None))
    # Before any training: a delay that the expert itself cannot tolerate makes learning futile.
    margins = setup.step("delay", lambda: _delay(setup))
    delay = DelayMargin(**{key: value for key, value in margins.items() if key != "processor_s"})
    delayed = _delayed_expert(setup)
    if warn is not None and is_delay_the_cause(delay, delayed.figures):
        warn(delay_sentence(delay, delayed.figures))
    collected = [
        _expert_run(setup, label, world, index)
        for label, world in setup.worlds.items()
        for index in range(spec.collect.runs)
    ]
    # DAgger: each round trains on all data so far; the last network only drives, its runs would train no other.
    rounds: list[RoundResult] = []
    own: list[Drive] = []
    for number in range(spec.rounds.count + 1):
        rounds.append(_round(setup, number, collected, own))
        if number < spec.rounds.count:
            own += _own_runs(setup, number)
    processor = sum(float(record["processor_s"]) for record in setup.journal.records.values())
    result = CloneResult(
        name=spec.name,
        folder=setup.folder,
        spec=spec.model_dump(mode="json"),
        seed=spec.seed,
        # Versions belong to the result, because trained weights depend on them.
        versions={
            name: installed_version(name) or "not installed"
            for name in ("mirdrake", "drake", "numpy", "torch", "onnxruntime")
        },
        vehicle=setup.car.vehicle,
        delay=delay,
        delayed_expert=delayed,
        collected=tuple(collected),
        rounds=tuple(rounds),
        processor_s=round(processor, 1),
    )
    return write_result(result)


def _check_packages() -> None:
    """Raise an error of a missing package before anything is simulated."""
    import_torch()
    for name, distribution in (("onnx", "onnx"), ("onnxruntime", "onnxruntime")):
        if installed_version(distribution) is None:
            raise MissingDependencyError(f"learning needs {name}: pip install 'mirdrake[learning]'")


def _set_up(spec: LearningSpec, folder: Path, progress: Progress) -> _Setup:
    """Check a study, and create or continue its folder."""
    # Plain data with the overrides applied, so that the purpose of the journal changes with them.
    diagram = read_diagram(spec, spec.diagram, spec.overrides).model_dump(mode="json")
    diagram.pop("provenance", None)
    car = Car(spec.vehicle, spec.camera)
    if car.vehicle not in diagram["vehicles"]:
        hint = did_you_mean(car.vehicle, diagram["vehicles"])
        raise ConfigError(f"the diagram has no vehicle '{car.vehicle}'; {hint}", where=where(spec, "vehicle"))
    if car.vehicle not in diagram.get("control", {}):
        raise ConfigError(
            f"'{car.vehicle}' has no driver, so there is no expert to learn from", where=where(spec, "diagram")
        )
    # Before anything is driven: training would raise the error only after all runs of the expert.
    if spec.train.mirror:
        try:
            mirror_signs([f"{car.vehicle}.{name}" for name in spec.inputs])
        except ConfigError as error:
            raise error.under(where(spec, "inputs")) from None
    own = diagram["world"]
    worlds = _labelled(spec.worlds) or _labelled([own])
    judged = _labelled(spec.drive.worlds) or _labelled([own])
    for key, chosen in (("worlds", worlds), ("drive", judged)):
        for world in chosen.values():
            _check_world(spec, diagram, car, world, key)
    with write_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
    # The name of the study is not part of its purpose, so that renaming does not discard finished steps.
    purpose = {"study": digest_data(spec.model_dump(mode="json", exclude={"name"})), "diagram": digest_data(diagram)}
    return _Setup(spec, diagram, car, worlds, judged, folder.resolve(), Journal(folder / JOURNAL, purpose), progress)


def _labelled(worlds: list[str | Json]) -> Json:
    """Return worlds by a label: the name, with the number of the entry if there are several."""
    entries = [_entry(world) for world in worlds]
    # Labels name folders and steps of the journal, so they must be unique and free of path separators.
    names = [Path(str(entry.get("name"))).stem for entry in entries]
    if len(names) > 1:
        names = [f"{name}-{index + 1}" for index, name in enumerate(names)]
    return dict(zip(names, entries, strict=True))


def _entry(world: str | Json) -> Json:
    """Return a world with its parameters as an entry of a diagram."""
    return {"name": world} if isinstance(world, str) else world


def _check_world(spec: LearningSpec, diagram: Json, car: Car, world: Any, key: str) -> None:
    """Check that the diagram can be laid out in a world, and that the camera and its pictures fit the network."""
    try:
        # Every world is laid out before the first run: a fault in the last one would otherwise show after hours.
        scene = make_scene(make_spec({**diagram, "world": _entry(world)}, name=""))
    except ConfigError as error:
        raise error.faults[0].under(where(spec, key)) from None
    mounts = scene.vehicles[car.vehicle].sensors.mounts
    mount = mounts.get(car.camera)
    if not isinstance(mount, PictureMount):
        cameras = [name for name, entry in mounts.items() if entry.takes_pictures]
        hint = did_you_mean(car.camera, cameras)
        raise ConfigError(f"{car.vehicle} has no camera '{car.camera}'; {hint}", where=where(spec, "camera"))
    try:
        preparation = Preparation(mount.width, mount.height, spec.picture.crop, spec.picture.size)
        Architecture(*preparation.shape).features()
    except ConfigError as error:
        raise error.under(where(spec, "picture")) from None


def _delay(setup: _Setup) -> Json:
    spec = setup.spec
    setup.progress("delay margin", 0.0)
    margin = find_delay_margin(
        setup.diagram, setup.car.reference, latency=spec.latency, rate=spec.rate, lead=spec.label_lead
    )
    return dict(vars(margin))


def _drive(
    setup: _Setup, key: str, title: str, diagram: Json, *, laps: float, limit: float, duration: float | None = None
) -> Drive:
    """Return a drive, which is a step of the study; see :func:`mirdrake.learning.drives.drive`."""

    def work() -> Json:
        return drive(
            diagram, setup.car, setup.folder / "runs" / key, base=setup.folder, laps=laps, limit=limit,
            duration=duration, progress=lambda share: setup.progress(title, share),
        ).record()  # fmt: skip

    return Drive.read(setup.step(key, work))


def _delayed_expert(setup: _Setup) -> Drive:
    """Return one lap of the expert whose steering has the delay of the network, in the first world to drive in."""
    spec, title = setup.spec, "expert with the delay of the network"
    diagram = {**setup.diagram, "world": _entry(next(iter(setup.judged.values())))}
    diagram = with_delay(diagram, setup.car, rate=spec.rate, latency=spec.latency)
    return _drive(setup, "delayed-expert", title, diagram, laps=1.0, limit=spec.drive.intervention)


def _expert_run(setup: _Setup, label: str, world: Any, index: int) -> Drive:
    """Return a run of the expert with injected errors; they increase from none in the first run of a world."""
    spec, collect = setup.spec, setup.spec.collect
    # Labels are unique, so the index of the world is a stable part of the seed.
    seed = (spec.seed, list(setup.worlds).index(label), index)
    # From zero to the largest error: clean runs for precision, disturbed ones for recoveries.
    size = collect.errors * index / max(collect.runs - 1, 1)
    diagram = with_camera(setup.diagram, setup.car, rate=collect.rate, world=world)
    diagram = with_errors(diagram, setup.car, rms=size, seed=seed)
    key, title = f"expert-{label}-{index + 1}", f"expert {label} {index + 1}"
    return _drive(setup, key, title, diagram, laps=1.0, limit=float("inf"), duration=collect.duration)


def _network_run(setup: _Setup, key: str, number: int, world: Any, laps: float) -> Drive:
    """Return a drive with the network of round `number` as the driver."""
    spec, file = setup.spec, _round_folder(setup, number) / "pilot.onnx"
    # At the network's own rate, so that pictures and evaluations coincide in time.
    diagram = with_camera(setup.diagram, setup.car, rate=spec.rate, world=world)
    diagram = with_network(diagram, setup.car, file=file, latency=spec.latency, inputs=spec.inputs)
    return _drive(setup, key, f"drive {key}", diagram, laps=laps, limit=spec.drive.intervention)


def _own_runs(setup: _Setup, number: int) -> list[Drive]:
    """Return drives of the network of a round in the worlds to learn in, which the expert labels."""
    return [
        _network_run(setup, f"dagger-{number}-{label}-{index + 1}", number, world, 1.0)
        for label, world in setup.worlds.items()
        for index in range(setup.spec.rounds.runs)
    ]


def _round_folder(setup: _Setup, number: int) -> Path:
    return setup.folder / f"round-{number}"


def _round(setup: _Setup, number: int, collected: list[Drive], own: list[Drive]) -> RoundResult:
    """Train on all runs so far, export the network, and drive with it."""
    spec, folder = setup.spec, _round_folder(setup, number)
    with write_errors(folder):
        folder.mkdir(exist_ok=True)
    file = folder / "pilot.onnx"

    # The work of a step is done once and its result is read from the journal when a study is continued.
    def work() -> Json:
        setup.progress(f"pictures of round {number}", 0.0)
        # Validation by place, not at random: neighbouring pictures are nearly equal.
        data = _data(setup, collected, own)
        training, validation = data.split(spec.train.validation, gap=spec.train.gap)

        def show(done: int, total: int, text: str) -> None:
            setup.progress(f"training of round {number}, {text}", done / total)

        trained = train(training, validation, spec.train, seed=spec.seed, file=folder / "training.pt", report=show)
        _export(setup, trained, data.preparation, file)
        return {
            "pictures": len(training),
            "training_loss": trained.training_loss,
            "validation_error": trained.validation_error,
            "sha256": digest(file.read_bytes()),
        }

    record = setup.step(f"train-{number}", work)
    with read_errors(file):
        # Drives of a continued study must be those of the network that the journal describes.
        if digest(file.read_bytes()) != record["sha256"]:
            raise ConfigError("has changed since it was trained; choose another folder with --out", where=str(file))
    drives = {
        label: _network_run(setup, f"drive-{number}-{label}", number, world, spec.drive.laps)
        for label, world in setup.judged.items()
    }
    if number == spec.rounds.count:
        setup.step(f"explain-{number}", lambda: _explain(setup, number, next(iter(drives.values()))))
    return RoundResult(
        number=number,
        pictures=int(record["pictures"]),
        training_loss=tuple(record["training_loss"]),
        validation_error=tuple(record["validation_error"]),
        file=str(file.relative_to(setup.folder)),
        sha256=record["sha256"],
        drives=drives,
    )


def _data(setup: _Setup, collected: list[Drive], own: list[Drive]) -> DrivingData:
    """Return the pictures of all runs; of the network's own runs only those with a label near its command."""
    spec, car = setup.spec, setup.car
    expert = [run for drive in collected for run in drive.runs(setup.folder)]
    driven = [run for drive in own for run in drive.runs(setup.folder)]
    # Runs of the expert come first, so that the index of a run shows whether the expert or the network drove.
    condition = spec.collect.where
    data = driving_data(
        [*expert, *driven],
        image=car.image,
        label=car.command,
        inputs=[f"{car.vehicle}.{name}" for name in spec.inputs],
        where=condition,
        lead=spec.label_lead,
        crop=spec.picture.crop,
        size=spec.picture.size,
        folder=setup.folder / "pictures",
    )
    if not driven:
        return data
    selected = np.ones(len(data), dtype=bool)
    runs, times, labels = data.table["run"].to_numpy(), data.times, data.values[:, 0]
    for index, run in enumerate(driven, start=len(expert)):
        rows = np.flatnonzero(runs == index)
        at = times[rows]
        # The network's command acts `lead` after its picture; the label was read at the same time.
        given = value_at(run.signals, f"{PILOT}.y", at + spec.label_lead)
        lateral = value_at(run.signals, f"{car.vehicle}.lateral_error", at)
        # Labels far from the command, or far from the line, belong to an unstable drive and would dominate the loss.
        near = np.abs(labels[rows] - given) < spec.rounds.label
        selected[rows] = near & (np.abs(lateral) < spec.rounds.lateral)
    return data.where(selected)


def _export(setup: _Setup, trained: Trained, preparation: Preparation, file: Path) -> None:
    notes = {"camera": setup.car.image, "seed": setup.spec.seed, "lead": setup.spec.label_lead}
    export_onnx(trained, preparation, file, rate=setup.spec.rate, outputs=(Signal("steering", "rad"),), **notes)


def _explain(setup: _Setup, number: int, driven: Drive) -> Json:
    """Write the pictures with the largest differences of network and expert, and what the network looks at."""
    setup.progress("saliency", 0.0)
    spec, folder = setup.spec, _round_folder(setup, number)
    runs = driven.runs(setup.folder)
    count = write_pictures(
        runs, setup.car, folder, lead=spec.label_lead, crop=spec.picture.crop, size=spec.picture.size
    )
    return {"pictures": count}
