"""The diagram file: vehicles, world, control, sensors and a user's own blocks, as data.

A diagram file replaces a launch file. It names vehicles, worlds and systems and sets numbers; keys that are left out
have defaults.
"""

import json
import os
from collections.abc import Iterable, Mapping
from datetime import date, datetime
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Annotated, Any, NamedTuple

from pydantic import BeforeValidator, ConfigDict, Discriminator, Field, Tag, field_validator

from mirdrake.controllers.drivers import DriverSpec
from mirdrake.core.json_io import Json
from mirdrake.core.paths import find, resolved
from mirdrake.core.recording.pictures import parse_start
from mirdrake.core.wording import plural
from mirdrake.core.yaml_io import (
    Angle,
    Duration,
    Frequency,
    Length,
    Schema,
    Speed,
    display_path,
    matching,
    parse_yaml,
    read_text,
    validate,
    where,
)
from mirdrake.core.yaml_tree import source_of_data
from mirdrake.plant.plant import PlantSpec
from mirdrake.vehicles.vehicle import VARIANT_MARK
from mirdrake.worlds import World, load_world

SPLIT = ("speed_command", "steering_command", "command_stamp")
"""Elements of a driver's command as outputs of its vehicle, behind which user blocks may be inserted."""

Name = Annotated[str, matching(r"^[A-Za-z_][A-Za-z0-9_]*$", "letters, digits and _")]

BlockName = Annotated[
    str,
    matching(
        r"^[A-Za-z_][A-Za-z0-9_]*(\.control\.[a-z_]+)?$",
        "letters, digits and _, or <vehicle>.control.<block> to replace a block of a control unit",
    ),
]


def _word_or_mapping(value: Any) -> str:
    """Discriminate a name from a mapping, so that a fault is reported once."""
    return "word" if isinstance(value, str) else "mapping"


class Place(Schema):
    """A pose on the ground of the world."""

    x: Length = Field(0.0, description="of the rear axle's centre [m]")
    y: Length = Field(0.0, description="the same, to the left [m]")
    yaw: Angle = Field(0.0, description="heading, positive to the left [rad]")


class VehicleEntry(Schema):
    """A vehicle in the world."""

    model: str = Field(description="name of a folder in models/, or a path; with @ and a variant behind it [-]")
    start: (
        Annotated[Annotated[str, Tag("word")] | Annotated[Place, Tag("mapping")], Discriminator(_word_or_mapping)]
        | None
    ) = Field(None, description="a start of the world, or {x, y, yaw}; the world's first one if left out [-]")
    speed: Speed | None = Field(None, description="speed at the start [m/s]; that of the start if left out")
    arguments: dict[str, str] = Field(default_factory=dict, description="xacro arguments [-]")
    mounts: dict[str, Json] = Field(
        default_factory=dict,
        description="keys of sensors.yaml to change, such as {front_camera: {rate: 25}, gps: {preset: rtk_gps}} [-]",
    )
    control: Json = Field(
        default_factory=dict, description="merged over its control.yaml, such as {wheel_speed: {kp: 3}} [-]"
    )
    parked: bool = Field(False, description="all wheels held by brakes, whatever is commanded [-]")


class SystemEntry(Schema):
    """A block: a kind of mirdrake, or a user class as ``module:Class``; the other keys are its parameters."""

    model_config = ConfigDict(extra="allow", allow_inf_nan=False)

    kind: str = Field(description="a kind of ours, or module:Class [-]")

    def parameters(self) -> Json:
        """Return the keys other than the kind."""
        return dict(self.model_extra or {})

    def set_parameter(self, name: str, value: Any) -> None:
        """Set a key other than the kind."""
        assert self.model_extra is not None
        self.model_extra[name] = value


class RecordSpec(Schema):
    """What a run records."""

    signals: bool | list[str] = Field(
        True, description="signals.parquet; a list adds inner signals, as [ego.control.**] [-]"
    )
    rate: Frequency = Field(50.0, gt=0.0, le=2000.0, description="samples of the signals per second [Hz]")
    cameras: bool = Field(False, description="pictures of the cameras in use, with a driving log [-]")
    arrays: bool = Field(True, description="scans of the laser scanners and lidars in use [-]")
    start_time: str | None = Field(
        None, description="date and time that pictures are named after, as 2026-05-31 12:00; 1970-01-01 if left out [-]"
    )
    meshcat: bool = Field(True, description="recording.html [-]")
    frames: Frequency = Field(20.0, gt=0.0, le=120.0, description="frames of the recording per second [Hz]")
    report: bool = Field(True, description="report.html [-]")

    @field_validator("start_time", mode="before")
    @classmethod
    def _is_a_time(cls, value: Any) -> Any:
        text = value.isoformat() if isinstance(value, date) else value  # YAML knows dates of its own
        if isinstance(text, str):
            parse_start(text)
        return text

    @property
    def inner_signals(self) -> list[str]:
        """Patterns of the inner signals to record."""
        return self.signals if isinstance(self.signals, list) else []

    @property
    def start(self) -> datetime:
        """Date and time of the start."""
        return parse_start(self.start_time)


class WorldEntry(Schema):
    """A world with changed values."""

    name: str = Field(description="name of a world, or a path [-]")
    seed: int | None = Field(None, description="instead of the file's [-]")
    params: dict[str, float | int | str] = Field(default_factory=dict, description="instead of the file's [-]")

    def load(self, *, where: str = "") -> World:
        """The world.

        Args:
            where: ``file:line: path`` of this entry, for errors.

        Raises:
            ConfigError, WorldError: there is none of that name, it has faults, or it cannot be laid out.
        """
        seed = [] if self.seed is None else [f"seed={self.seed}"]
        # Overrides are texts in YAML; JSON is a part of it and quotes what needs quotes.
        values = [f"params.{key}={json.dumps(value)}" for key, value in self.params.items()]
        return load_world(self.name, where=where, overrides=seed + values)


def _named(value: Any) -> Any:
    """Return a mapping with a name; a bare name is the world as in its file."""
    return {"name": value} if isinstance(value, str) else value


class DiagramSpec(Schema):
    """A diagram file."""

    world: Annotated[WorldEntry, BeforeValidator(_named)] = Field(
        description="name of a world, or a path; or {name, seed, params} [-]"
    )
    vehicles: dict[Name, VehicleEntry] = Field(min_length=1, description="vehicles by name [-]")
    control: dict[Name, DriverSpec] = Field(default_factory=dict, description="who drives which vehicle [-]")
    sensors: dict[Name, list[str]] = Field(default_factory=dict, description="sensors in use, per vehicle [-]")
    systems: dict[BlockName, SystemEntry] = Field(
        default_factory=dict,
        description="your own blocks; <vehicle>.control.<block> replaces a block of its control [-]",
    )
    connect: list[tuple[str, str]] = Field(default_factory=list, description="[output port, input port] pairs [-]")
    plant: PlantSpec = Field(default_factory=PlantSpec, description="step and contact [-]")
    record: RecordSpec = Field(default_factory=RecordSpec, description="what is written down [-]")
    duration: Duration = Field(
        10.0, gt=0.0, le=1e6, description="simulated time, unless `laps` ends the run earlier [s]"
    )
    laps: float | None = Field(
        None,
        gt=0.0,
        description="stop after so many laps of the first vehicle, or at `duration` if that is earlier [-]",
    )
    seed: int = Field(0, ge=0, description="of every random stream [-]")

    folder: str | None = Field(
        None, description="where modules of the user's own blocks lie; the file's folder if left out [-]"
    )
    provenance: Json | None = Field(None, description="written into spec.yaml by a run; not read [-]")
    name: str = Field("diagram", description="name in run folders; the file's own if left out [-]")

    @field_validator("name")
    @classmethod
    def _inside_the_folder(cls, value: str) -> str:
        if "/" in value or "\\" in value or not value.isprintable():
            raise ValueError("a name is part of the name of a run folder; it must have no '/', '\\' or line break")
        return value

    @field_validator("connect", mode="before")
    @classmethod
    def _pairs(cls, value: Any) -> Any:
        if isinstance(value, list):
            for entry in value:
                if not (isinstance(entry, list | tuple) and len(entry) == 2):
                    raise ValueError("a connection is a pair: [system.output, system.input]")
        return value


class Connection(NamedTuple):
    """A connection that a diagram file makes.

    Attributes:
        source: output port, or an element of one.
        sink: input port, or an element of one.
        place: ``file:line: path`` of its entry, for errors.
    """

    source: str
    sink: str
    place: str


def connections_of(spec: DiagramSpec) -> list[Connection]:
    """Return the pairs of `connect`, and the pictures that blocks take by their key `image`.

    The image of a block is the colours of a camera, or any output port by its full name.
    """
    pairs = [Connection(*pair, where(spec, "connect", index)) for index, pair in enumerate(spec.connect)]
    cameras = {f"{name}.{sensor}" for name, sensors in spec.sensors.items() for sensor in sensors}
    for name, entry in spec.systems.items():
        image = entry.parameters().get("image")
        if ":" not in entry.kind and isinstance(image, str):
            source = f"{image}.color_image" if image in cameras else image
            pairs.append(Connection(source, f"{name}.image", where(spec, "systems", name, "image")))
    return pairs


def without_user_systems(spec: DiagramSpec) -> tuple[DiagramSpec, list[str]]:
    """Return a diagram without user systems and drivers, and a line for each that was left out.

    A system that gets an input from one of them is left out, too, and so is a pattern of record.signals that may choose
    one of their signals.

    Args:
        spec: is not changed.
    """
    # A kind with a colon names a user's module, whose code is not run here.
    systems = {name: entry.kind for name, entry in spec.systems.items() if ":" in entry.kind}
    drivers = {name: entry.kind for name, entry in spec.control.items() if ":" in entry.kind}

    def missing(end: str) -> str:
        """Return what is left out with a port, "" if the port remains."""
        owner, _, port = end.partition(".")
        of_driver = port in SPLIT or port.startswith("driver") or port.split(".")[0] == "command"
        # The name of a block of a control unit has dots.
        system = next((name for name in systems if end.startswith(f"{name}.")), "")
        return system or (f"{owner}.driver" if owner in drivers and of_driver else "")

    found = bool(systems or drivers)
    while found:  # a system without one of its inputs is a fault
        found = False
        for source, sink, _ in connections_of(spec):
            fed = sink.split(".")[0]
            if missing(source) and fed in spec.systems and fed not in systems:
                systems[fed], found = f"an input is from {missing(source)}", True
    rest = spec.model_copy()
    rest.systems = {name: entry for name, entry in spec.systems.items() if name not in systems}
    rest.control = {name: entry for name, entry in spec.control.items() if name not in drivers}
    # Connections to systems and drivers that are left out would be faults.
    rest.connect = [pair for pair in spec.connect if not any(map(missing, pair))]
    lost = len(spec.connect) - len(rest.connect)
    # A pattern that chooses nothing is a fault, but the signals of what is left out are not known.
    unknown = [f"{name}." for name in systems]
    unknown += [f"{name}.{port}" for name in drivers for port in ("driver", "command", *SPLIT)]
    patterns = spec.record.inner_signals
    unchecked = [pattern for pattern in patterns if any(_may_begin(pattern, text) for text in unknown)]
    if unchecked:
        kept = [pattern for pattern in patterns if pattern not in unchecked]
        rest.record = spec.record.model_copy(update={"signals": kept or True})
    left_out = [f"systems.{name} ({kind})" for name, kind in systems.items()]
    left_out += [f"control.{name} ({kind})" for name, kind in drivers.items()]
    left_out += [f"{plural(lost, 'connection')} of these"] if lost else []
    return rest, left_out + [f"record.signals: {pattern}" for pattern in unchecked]


def _may_begin(pattern: str, text: str) -> bool:
    """Return whether a pattern of :func:`fnmatch.fnmatchcase` matches any name that begins with a text."""
    head, star, _ = pattern.partition("*")
    # Either a part of the pattern matches the whole text, or a star comes before its end and matches the rest.
    if any(fnmatchcase(text, head[:length]) for length in range(len(head) + 1)):
        return True
    return bool(star) and any(fnmatchcase(text[:length], head) for length in range(len(text) + 1))


def load_diagram(name: str, *, overrides: Iterable[str] = ()) -> DiagramSpec:
    """Return a checked diagram file.

    Args:
        name: a name below diagrams/, or a path.
        overrides: ``"dotted.path=value"`` texts, applied over the file.

    Raises:
        ConfigError: no such file, or it has faults.
    """
    path = find("diagrams", name)
    return parse_diagram(read_text(path), path, overrides=overrides)


def parse_diagram(text: str, path: Path, *, overrides: Iterable[str] = ()) -> DiagramSpec:
    """Return the checked diagram of the text of a file.

    Args:
        text: the text.
        path: the file, to which the paths in the text are relative.
        overrides: as in :func:`load_diagram`.

    Raises:
        ConfigError: the text has faults.
    """
    spec = parse_yaml(text, DiagramSpec, name=display_path(path), overrides=overrides)

    # Paths in the file are relative to it, so they are made absolute before the spec leaves the file.
    if "name" not in spec.model_fields_set:
        spec.name = path.stem
    kinds = [*(entry.kind for entry in spec.systems.values()), *(driver.kind for driver in spec.control.values())]
    if spec.folder is None and any(":" in kind for kind in kinds):
        spec.folder = str(path.parent)
    spec.world.name = _absolute(spec.world.name, path.parent)
    for entry in spec.vehicles.values():
        model, mark, variant = entry.model.partition(VARIANT_MARK)
        entry.model = f"{_absolute(model, path.parent)}{mark}{variant}"
    for system in spec.systems.values():
        if ":" not in system.kind and isinstance(file := system.parameters().get("file"), str):
            system.set_parameter("file", _absolute(file, path.parent, always=True))
    for driver in spec.control.values():
        driver.resolve_paths(path.parent)
    return spec


def _absolute(name: str, folder: Path, *, always: bool = False) -> str:
    """Return a path as an absolute one, relative to the folder if it exists there; a bare name unchanged.

    Args:
        name: a path, or a bare name.
        folder: folder of the diagram file.
        always: whether a bare name is a path, too.
    """
    # A bare name is looked up in the search folders later.
    if not always and os.sep not in name and not name.endswith((".yaml", ".yml")):
        return name
    for path in (folder / name, Path(name)):
        if path.exists():
            return str(resolved(path))
    return name


def make_spec(data: Mapping[str, Any], *, name: str = "diagram") -> DiagramSpec:
    """Return a checked diagram from plain data, such as :meth:`DiagramSpec.model_dump` returns.

    Args:
        data: the diagram.
        name: name of the diagram in error messages; they begin with the key if it is empty.

    Raises:
        ConfigError: it has faults.
    """
    return validate(dict(data), DiagramSpec, source_of_data(name, data))
