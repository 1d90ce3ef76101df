"""Studies of a manoeuvre: each run is a candidate that drives it and is judged by its figures and criteria.

With the single-track model the candidates of a shard drive together, as one batch of cars; with the full plant a shard
is one candidate.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from mirdrake.core.digest import digest_data
from mirdrake.core.errors import ConfigError, did_you_mean, one_line
from mirdrake.core.yaml_io import Source, validate, where
from mirdrake.execution.job import Outcome, Status
from mirdrake.manoeuvres.base import ManoeuvreSpec
from mirdrake.manoeuvres.base import Outcome as ManoeuvreOutcome
from mirdrake.manoeuvres.facts import Facts, find_facts
from mirdrake.manoeuvres.registry import MANOEUVRES, read_settings, run_manoeuvre
from mirdrake.manoeuvres.rig import Model, Rig
from mirdrake.manoeuvres.together import run_manoeuvres
from mirdrake.studies.plan import Plan, Shard
from mirdrake.studies.sampling import sample
from mirdrake.studies.spec import StudySpec
from mirdrake.vehicles import Vehicle, load_vehicle

LARGEST = 1000
"""Most runs of a shard."""

SAMPLES = 1.2e6
"""Most samples of the runs of a shard; each has about 160 bytes, as do its copies during the evaluation."""

_OWN = ("single_track", "gains")
"""Settings that map names to numbers."""


@dataclass(frozen=True, kw_only=True)
class ManoeuvreShard(Shard):
    """Some candidates of a study of a manoeuvre; the metrics are keys of its figures.

    Attributes:
        manoeuvre: name of the manoeuvre.
        vehicle: name of the vehicle.
        model: plant or single_track.
        settings: settings of all candidates, by dotted path.
    """

    manoeuvre: str
    vehicle: str
    model: str
    settings: dict[str, Any]


def make_manoeuvre_plan(spec: StudySpec) -> Plan:
    """Check a study of a manoeuvre.

    Raises:
        ConfigError, ModelError: ``file:line: path: what is wrong``.
    """
    name = spec.manoeuvre or ""
    if name not in MANOEUVRES:
        raise ConfigError(
            f"unknown manoeuvre '{name}'; {did_you_mean(name, list(MANOEUVRES))}", where=where(spec, "manoeuvre")
        )
    vehicle, _ = _load(spec.vehicle or "")
    try:
        base = _read_settings(spec.overrides)
    except ConfigError as error:
        raise error.under(where(spec, "overrides")) from None
    # The ends of each range are tried, so that faults are reported before the start.
    for path, entry in spec.parameters.items():
        for value in entry.ends():
            try:
                _make_rig(spec, vehicle, base, {path: value})
            except ConfigError as error:
                raise error.faults[0].under(where(spec, "parameters", path)) from None
    if len(set(spec.metrics)) < len(spec.metrics):
        raise ConfigError("each metric must have a different name", where=where(spec, "metrics"))
    content = digest_data([vehicle.urdf, vehicle.spec.model_dump(mode="json"), vehicle.control.model_dump(mode="json")])
    return Plan(spec, {}, {}, sample(spec), 0.0, content)


def make_manoeuvre_shards(plan: Plan) -> list[ManoeuvreShard]:
    """Divide a study of a manoeuvre into shards.

    Raises:
        ConfigError: the manoeuvre has no such figure.
    """
    spec = plan.spec
    size = 1 if spec.model == "plant" else LARGEST
    outcome, samples = _try_nominal(spec)
    # A manoeuvre that the vehicle of the file cannot drive has no figures whose names could be checked.
    known = [metric.key for metric in outcome.metrics]
    for column, metric in enumerate(spec.metrics):
        if known and metric not in known:
            raise ConfigError(
                f"{spec.manoeuvre} has no figure '{metric}'; {did_you_mean(metric, known)}",
                where=where(spec, "metrics", column),
            )
    size = int(min(max(SAMPLES / max(samples, 1000), 1), size))
    shards = []
    for number, first in enumerate(range(0, len(plan.rows), size)):
        values = zip(*plan.rows[first : first + size], strict=True)
        columns = {path: list(column) for path, column in zip(spec.parameters, values, strict=True)}
        shards.append(
            ManoeuvreShard(
                number=number, first=first, columns=columns, metrics=tuple(spec.metrics), settings=dict(spec.overrides),
                manoeuvre=spec.manoeuvre or "", vehicle=spec.vehicle or "", model=spec.model,
            )
        )  # fmt: skip
    return shards


def run_manoeuvre_shard(shard: ManoeuvreShard) -> list[Outcome]:
    """Drive the candidates of a shard; an error is the outcome of its candidate."""
    try:
        return _run(shard)
    except Exception as error:
        return shard.lost(one_line(error))


def _run(shard: ManoeuvreShard) -> list[Outcome]:
    vehicle, _ = _load(shard.vehicle)
    base, name = _read_settings(shard.settings), shard.manoeuvre
    made: dict[int, tuple[Rig, ManoeuvreSpec]] = {}
    results: dict[int, ManoeuvreOutcome | Exception] = {}
    for k in range(shard.count):
        try:
            made[k] = _make_rig(shard, vehicle, base, {path: values[k] for path, values in shard.columns.items()})
        except ConfigError as error:
            results[k] = error
    # Runs that diverge overflow on purpose; they are reported as unstable.
    with np.errstate(all="ignore"):
        if shard.model == "single_track" and made:
            rigs, specs = zip(*made.values(), strict=True)
            results |= dict(zip(made, run_manoeuvres(name, rigs, specs), strict=True))
        elif made:
            results |= {k: run_manoeuvre(name, rig, spec) for k, (rig, spec) in made.items()}
    return [_outcome(shard, k, results[k]) for k in range(shard.count)]


def _outcome(shard: ManoeuvreShard, k: int, result: ManoeuvreOutcome | Exception) -> Outcome:
    """Return the row of a candidate."""
    if isinstance(result, Exception):
        return Outcome(shard.first + k, "failed", one_line(result))
    status: Status = "unstable" if result.verdict == "diverged" else "ok"
    values = {metric.key: metric.value for metric in result.metrics}
    numbers = [values.get(name) for name in shard.metrics]
    metrics = tuple(float("nan") if number is None else number for number in numbers)
    return Outcome(shard.first + k, status, result.reason, result.simulated, metrics, result.verdict)


def _try_nominal(spec: StudySpec) -> tuple[ManoeuvreOutcome, int]:
    """Return the outcome of the single-track model without changes, and the number of samples of its runs."""
    vehicle, facts = _load(spec.vehicle or "")
    base = _read_settings(spec.overrides)
    rig = Rig(spec.vehicle or "", vehicle, facts, kind="single_track", friction=base.friction, seed=base.seed)
    outcome = run_manoeuvre(spec.manoeuvre or "", rig, getattr(base, spec.manoeuvre or ""))
    return outcome, sum(len(record.time) for record in rig.records)


def _make_rig(
    study: StudySpec | ManoeuvreShard, vehicle: Vehicle, base: Any, values: Mapping[str, Any]
) -> tuple[Rig, ManoeuvreSpec]:
    """Return a candidate: the rig and the settings of the manoeuvre.

    Raises:
        ConfigError: an unknown setting, or a value out of range.
    """
    name = study.manoeuvre or ""
    spec: ManoeuvreSpec = getattr(base, name)
    given: dict[str, Any] = {}
    numbers = {"single_track": dict(base.single_track), "gains": dict(base.flat_gains())}
    friction = base.friction
    for path, value in values.items():
        head, _, rest = path.partition(".")
        if head == name and rest in type(spec).model_fields:
            given[rest] = value
        elif path == "friction":
            friction = _number(value)
        elif head in _OWN and rest:
            numbers[head][rest] = _number(value)
        else:
            known = [
                "friction",
                *(f"{name}.{field}" for field in type(spec).model_fields),
                *(f"{own}." for own in _OWN),
            ]
            raise ConfigError(f"the manoeuvre has no setting '{path}'; {did_you_mean(path, known)}")
    if not 0.0 < friction <= 2.0:
        raise ConfigError(f"friction is {friction:g}; it must be above 0 and at most 2")
    if given:
        spec = validate(spec.model_dump(exclude_unset=True) | given, type(spec), Source(name, {}))
    _, facts = _load(study.vehicle or "")
    kind: Model = "full" if study.model == "plant" else "single_track"
    rig = Rig(
        study.vehicle or "",
        vehicle,
        facts,
        kind=kind,
        plant=base.plant.model_dump(exclude_unset=True),
        friction=friction,
        seed=base.seed,
        changes=numbers["single_track"],
        gains=numbers["gains"],
    )
    return rig, spec


def _number(value: Any) -> float:
    if isinstance(value, str | bool):
        raise ConfigError(f"{value!r} is not a number")
    return float(value)


def _read_settings(settings: Mapping[str, Any]) -> Any:
    """Return the settings of all manoeuvres."""
    return read_settings(
        f"{path}={value if isinstance(value, str) else json.dumps(value)}" for path, value in settings.items()
    )


@lru_cache(maxsize=2)
def _load(name: str) -> tuple[Vehicle, Facts]:
    vehicle = load_vehicle(name)
    return vehicle, find_facts(vehicle)
