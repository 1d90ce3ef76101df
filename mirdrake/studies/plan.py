"""The plan of a study: its diagram is loaded, every name in it is checked, and each run becomes a job."""

import copy
import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from mirdrake.assembly.diagram import Assembly, assemble
from mirdrake.assembly.diagram_spec import DiagramSpec, load_diagram, make_spec
from mirdrake.assembly.inputs import input_digest
from mirdrake.core.digest import digest_data
from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.json_io import Json
from mirdrake.core.paths import installed_version
from mirdrake.core.user_modules import load_user_function
from mirdrake.core.yaml_io import Schema, Source, validate, where
from mirdrake.execution.job import Job, Outcome, function_of
from mirdrake.execution.parameters import ContextParameter, find_context_parameters
from mirdrake.runs.summary import VEHICLE_FIGURES
from mirdrake.studies.sampling import sample
from mirdrake.studies.spec import StudySpec

_RESERVED = {"run", "status", "reason", "simulated"}
_FIGURES = ("simulated_s",)
_CHECKED = 200  # values of one parameter that are checked before the start


@dataclass(frozen=True)
class Plan:
    """A checked study.

    Attributes:
        spec: spec of the study.
        diagram: data of the diagram, with the values of all runs.
        parameters: context parameters that vary, by name.
        rows: values of each run, in the order of the parameters.
        duration: simulated time of a run [s].
        content: digest of the vehicles and the world of the diagram.
    """

    spec: StudySpec
    diagram: Json
    parameters: dict[str, ContextParameter]
    rows: list[tuple[Any, ...]]
    duration: float
    content: str

    @property
    def limit(self) -> float:
        """Wall time that a run may take [s]."""
        return self.spec.time_limit or 60.0 + 10.0 * self.duration

    def job(self, index: int) -> Job:
        """Return the job of a run."""
        values = dict(zip(self.spec.parameters, self.rows[index], strict=True))
        diagram = self.diagram
        for name, value in values.items():
            if name not in self.parameters:
                # Context parameters are set in the built diagram; all others change its data and need a new assembly.
                diagram = put(diagram, name, value)
        parameters = {name: float(value) for name, value in values.items() if name in self.parameters}
        spec = self.spec
        return Job(index, diagram, parameters, tuple(spec.metrics), self.duration, spec.folder, self.limit)

    @cached_property
    def units(self) -> dict[str, str | None]:
        """Unit of each parameter; empty if it is that of the diagram file, None if values are not numbers."""
        units: dict[str, str | None] = {}
        for column, name in enumerate(self.spec.parameters):
            texts = any(isinstance(row[column], str) for row in self.rows)
            units[name] = None if texts else self.parameters[name].unit if name in self.parameters else ""
        return units

    def manifest(self) -> Json:
        """Return the content of study.json."""
        study = self.spec.model_dump(mode="json", exclude={"time_limit", "folder"})
        study["diagram"] = self.diagram
        versions = {
            name: installed_version(name) or "not installed" for name in ("mirdrake", "drake", "numpy", "scipy")
        }
        # The digest identifies the study: a folder of another one is not continued.
        digest = digest_data({"study": study, "content": self.content})
        return {
            "runs": len(self.rows),
            "digest": digest,
            "content": self.content,
            "versions": versions,
            "units": self.units,
            "study": json.loads(json.dumps(study)),
        }


@dataclass(frozen=True, kw_only=True)
class Shard:
    """Some runs of a study, which are simulated together.

    Attributes:
        number: of the shard.
        first: index of its first run.
        columns: values of each run by parameter.
        metrics: names.
    """

    number: int
    first: int
    columns: dict[str, list[Any]]
    metrics: tuple[str, ...]

    @property
    def count(self) -> int:
        """Number of runs."""
        return len(next(iter(self.columns.values())))

    def lost(self, reason: str) -> list[Outcome]:
        """Return the outcomes of runs that could not be made."""
        return [Outcome(self.first + k, "failed", reason) for k in range(self.count)]


def make_plan(spec: StudySpec) -> Plan:
    """Check a study with its diagram.

    Raises:
        ConfigError, ModelError, WorldError: ``file:line: path: what is wrong``.
    """
    # Assembling the diagram once finds its faults and the names that parameters can have.
    assert spec.diagram is not None
    diagram = read_diagram(spec, spec.diagram, spec.overrides)
    assembly = _assemble(diagram)
    data = diagram.model_dump(mode="json")
    data.pop("provenance", None)
    vehicles = {name: part.vehicle for name, part in assembly.parts.vehicles.items()}
    world = assembly.parts.world
    # Parameters of the Context change a built diagram; all others need a new one for each run.
    known = find_context_parameters(vehicles, world)
    parameters = {name: known[name] for name in spec.parameters if _is_context_parameter(spec, name, known)}

    # The ends of each range are tried with the diagram: faults are reported before hours of simulation.
    for name, entry in spec.parameters.items():
        location = where(spec, "parameters", name)
        if name in parameters:
            _check_values(location, parameters[name], entry.ends())
            continue
        for value in entry.ends()[:_CHECKED]:
            try:
                make_spec(put(data, name, value), name="")
            except ConfigError as error:
                raise error.faults[0].under(location) from None
    _check_metrics(spec, list(vehicles))

    # Models and the world are part of the digest: a resumed study must not mix rows of different models.
    content: dict[str, list[Any]] = {}
    for name, vehicle in vehicles.items():
        specs = (vehicle.spec, vehicle.control, vehicle.sensors)
        content[name] = [vehicle.urdf, *(part.model_dump(mode="json") for part in specs)]
    files = input_digest(world, [vehicle.folder for vehicle in vehicles.values()], data, Path(diagram.folder or "."))
    digest = digest_data({"vehicles": content, "world": world.spec.model_dump(mode="json"), "files": files})
    return Plan(spec, data, parameters, sample(spec), spec.duration or diagram.duration, digest)


def put(data: Json, path: str, value: Any) -> Json:
    """Return data with a value set at a dotted path; the containers on the path are copied.

    Raises:
        ConfigError: the path leads to an item that a list does not have.
    """
    head, _, rest = path.partition(".")
    # A shallow copy per level: only the path to the value is new, the rest is shared between the jobs.
    result: Any = copy.copy(data) if isinstance(data, dict | list) else {}
    key: Any = head
    if isinstance(result, list):
        if not (head.isdecimal() and int(head) < len(result)):
            raise ConfigError(f"a list of {len(result)} has no item '{head}'; items count from 0")
        key = int(head)
    below = result[key] if isinstance(result, list) else result.get(key)
    result[key] = put(below, rest, value) if rest else value
    return result  # type: ignore[no-any-return]


def read_diagram(spec: Schema, given: str | Json, overrides: Mapping[str, Any]) -> DiagramSpec:
    """Return the diagram of a study with the changes for all of its runs.

    Args:
        spec: the study, for the places of errors.
        given: its key `diagram`.
        overrides: its key `overrides`: values by dotted path.

    Raises:
        ConfigError: there is no such diagram, or it has faults.
    """
    location = where(spec, "diagram")
    # A diagram may be named or be written in the study itself, whose lines its messages then have.
    if isinstance(given, str):
        try:
            diagram = load_diagram(given)
        except ConfigError as error:
            raise error.under(location) from None
    else:
        source = spec._source or Source("study", {})
        diagram = validate(dict(given), DiagramSpec, source._replace(prefix=(*source.prefix, "diagram")))
    if not overrides:
        return diagram
    data = diagram.model_dump(mode="json")
    # Each override is tried by itself, so that the message names the wrong one.
    for path, value in overrides.items():
        try:
            data = put(data, path, value)
            make_spec(data, name="")
        except ConfigError as error:
            raise error.faults[0].under(where(spec, "overrides", path)) from None
    return make_spec(data)


def _assemble(diagram: DiagramSpec) -> Assembly:
    """Build the diagram; one with open inputs is rejected."""
    assembly = assemble(diagram)
    assembly.check_inputs(assembly.make_context())
    return assembly


def _is_context_parameter(spec: StudySpec, name: str, known: Mapping[str, ContextParameter]) -> bool:
    """Return whether a parameter is one of the Context; otherwise it is a path of the diagram."""
    if name in known:
        return True
    head = name.partition(".")[0]
    location = where(spec, "parameters", name)
    if name in _RESERVED:
        raise ConfigError("is a column of the results and cannot be a parameter", where=location)
    if head in DiagramSpec.model_fields:
        # The runs of a study share these, so that their rows can be compared in one table.
        if head in {"folder", "name", "provenance", "record", "duration"}:
            raise ConfigError("cannot differ between runs", where=location)
        return False
    raise ConfigError(
        f"neither a context parameter nor a path of the diagram; {did_you_mean(name, known)}", where=location
    )


def _check_values(location: str, parameter: ContextParameter, values: list[Any]) -> None:
    for value in values:
        if isinstance(value, str | bool):
            raise ConfigError(f"{value!r} is not a number", where=location)
        if parameter.positive and value <= 0.0:
            raise ConfigError(f"{value:g} is not allowed; it must be above 0", where=location)


def _check_metrics(spec: StudySpec, vehicles: list[str]) -> None:
    figures = [*_FIGURES]
    for vehicle in vehicles:
        figures += [f"{vehicle}.{name}" for name in VEHICLE_FIGURES]
    # Columns of the results need different names.
    seen: set[str] = _RESERVED | set(spec.parameters)
    for column, name in enumerate(spec.metrics):
        location = where(spec, "metrics", column)
        if name in seen:
            raise ConfigError(f"'{name}' is already a column", where=location)
        seen = seen | {name}
        function, _ = function_of(name)
        if function:
            try:
                load_user_function(function, folder=spec.folder)
            except ConfigError as error:
                raise error.under(location) from None
        elif name not in figures:
            raise ConfigError(
                f"neither a figure of the summary nor a function module:name; {did_you_mean(name, figures)}",
                where=location,
            )
