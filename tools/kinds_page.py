"""The page docs/kinds.md, which ``python -m tools.kinds_page docs/kinds.md`` writes from the registries.

A key is a field of the class of its kind. Its unit is the text in brackets in the description of the field.
"""

import math
import re
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Literal, NamedTuple, get_args, get_origin

from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from mirdrake.assembly.blocks import BLOCKS
from mirdrake.controllers.driver import Driver
from mirdrake.controllers.drivers import DRIVERS
from mirdrake.core.constants import GRAVITY
from mirdrake.core.yaml_io import Schema
from mirdrake.identification.models.registry import MODELS, model_class
from mirdrake.manoeuvres.registry import MANOEUVRES
from mirdrake.requirements.observation import EVENTS, SIGNALS, SIGNALS_BY_NAME
from mirdrake.tyres.base import Tyres
from mirdrake.tyres.registry import TYRES
from mirdrake.vehicles.differential_spec import DIFFERENTIALS, Differential
from mirdrake.vehicles.joint_control import JOINT_CONTROLS
from mirdrake.vehicles.mount import Mount
from mirdrake.vehicles.mounts import SENSOR_KINDS, SENSORS
from mirdrake.vehicles.powertrain_spec import POWERTRAINS
from mirdrake.worlds.actors_spec import BEHAVIOUR_KINDS, BEHAVIOURS, ActorBehaviour, ActorEntry, Step
from mirdrake.worlds.case_spec import CaseSpec
from mirdrake.worlds.spec import GoalSpec, StartSpec

HEAD = """\
# Kinds and their keys

All drivers, blocks, sensors, tyres and other kinds that a YAML file can name, with all their keys. The page is
generated from the program. `kind: "module:Class"` names a driver or block of your own; its keys are the arguments of
the class.

A number without a unit is in the unit of its column. Most numbers can have another unit, such as `36 km/h`, `5 deg` or
`20 ms`. A default of `-` means that the key is optional and not set.
`mirdrake schema` writes the formats of whole files for editors, which then complete the keys and check the values."""

Classes = Mapping[str, type[Schema]]


class Section(NamedTuple):
    """Title and place of some kinds, their classes, and the classes whose docstrings describe them."""

    title: str
    place: str
    classes: Classes
    described: Mapping[str, type] = {}


SECTIONS = (
    Section(
        "Drivers",
        "Values of `control` in a diagram file and of `behaviour` in a test; see [diagrams](diagrams.md). The ports of "
        "a driver of your own, `module:Class`, are listed in [worlds](worlds.md#a-driver-of-your-own).",
        DRIVERS,
    ),
    Section("Blocks", "Entries of `systems` in a diagram file; see [diagrams](diagrams.md).", BLOCKS),
    Section(
        "Sensors",
        "Entries of `mounts` in sensors.yaml; see [sensors](sensors.md).",
        {kind: SENSOR_KINDS[kind] for kind in SENSORS},
    ),
    Section("Tyres", "`tyres` in vehicle.yaml; see [tyres](tyres.md).", TYRES),
    Section("Powertrains", "`powertrain` in vehicle.yaml; see [powertrain](powertrain.md).", POWERTRAINS),
    Section("Differentials", "`differential.front` and `differential.rear` of a powertrain.", DIFFERENTIALS),
    Section("Speed control", "`wheel_speed` in control.yaml.", JOINT_CONTROLS["wheel_speed"]),
    Section("Steering control", "`steering` in control.yaml.", JOINT_CONTROLS["steering"]),
    Section(
        "Behaviours of actors",
        "`behaviour` of an actor in a world file; see [traffic](traffic.md#actors).",
        {kind: BEHAVIOUR_KINDS[kind] for kind in BEHAVIOURS},
    ),
    Section(
        "Parts of a world file",
        "Entries of `start`, `goals`, `tests`, `actors` and `scenario`; see [worlds](worlds.md).",
        {"start": StartSpec, "goals": GoalSpec, "tests": CaseSpec, "actors": ActorEntry, "scenario": Step},
    ),
    Section(
        "Identification models",
        "`model` in an identification study; see [identification](identification_reference.md).",
        {kind: model_class(kind).Options for kind in MODELS},
        {kind: model_class(kind) for kind in MODELS},
    ),
    Section("Manoeuvres", "Settings of `mirdrake manoeuvre`; see [manoeuvres](manoeuvres.md).", MANOEUVRES),
)
ROUND = {
    "rad": ("deg", math.radians(1.0)),
    "rad/s": ("deg/s", math.radians(1.0)),
    "m/s": ("km/h", 1.0 / 3.6),
    "m/s²": ("g", GRAVITY),
}
"""Unit of a default that is not a round number in SI, and its size."""

REGISTERED = (Driver, Mount, Tyres, Differential, ActorBehaviour)
"""Bases of classes that have a section of their own."""


def write_page() -> str:
    """Return the page."""
    parts = [HEAD, *(line for section in SECTIONS for line in _section(section))]
    return "\n".join([*parts, *_signals(), ""])


def split_unit(description: str) -> tuple[str, str]:
    """Return the unit of a description and its other text."""
    head = re.match(r"\[([^\]]+)\](?:, \[([^\]]+)\])? ?", description)
    if head:
        return ", ".join(filter(None, head.groups())), description[head.end() :]
    found = list(re.finditer(r" ?\[([^\[\]]+)\]", description))
    if not found or len({match[1] for match in found}) > 1:
        return "", description.removesuffix(" [-]")
    return found[-1][1], description[: found[-1].start()] + description[found[-1].end() :]


def keys_of(model: type[Schema]) -> dict[str, FieldInfo]:
    """Return the keys of a class in a file and their fields, without ``kind``."""
    fields = ((field.alias or name, field) for name, field in model.model_fields.items())
    return {name: field for name, field in fields if name not in {"kind", "source"}}


def summary(model: type) -> str:
    """Return the first paragraph of a docstring."""
    paragraph = " ".join((model.__doc__ or "").split("\n\n")[0].split())
    return re.sub(r":\w+:`~?([^`]+)`", r"`\1`", paragraph).replace("``", "`")


def _section(section: Section) -> Iterator[str]:
    """Yield the lines of a section: its kinds, then the mappings in their keys."""
    title, place, classes, described = section
    yield from ("", f"## {title}", "", place)
    shared = _shared(classes)
    if shared:
        yield from ("", f"### All {title.lower()}", "", *_table(shared))
    inner: dict[type[Schema], list[str]] = {}
    for kind, model in classes.items():
        base = next((name for name, other in classes.items() if other in model.__mro__[1:]), "")
        known = keys_of(classes[base]) if base else shared
        own = {name: field for name, field in keys_of(model).items() if not _same(field, known.get(name))}
        also = f" All keys of [`{base}`](#{base}), and:" if base else ""
        yield from ("", f"### `{kind}`", "", summary(described.get(kind, model)) + also)
        yield from (["", *_table(own)] if own else [] if keys_of(model) else ["", "No keys."])
        _collect(keys_of(model), inner)
    for model, names in inner.items():
        listed = ", ".join(f"`{name}`" for name in names)
        yield from ("", f"### Keys of {listed}", "", summary(model), "", *_table(keys_of(model)))


def _shared(classes: Classes) -> dict[str, FieldInfo]:
    """Return the keys that all classes have, with the same meaning."""
    first, *others = map(keys_of, classes.values())
    return {
        name: field
        for name, field in first.items()
        if len(others) > 1 and all(_same(field, other.get(name)) for other in others)
    }


def _same(field: FieldInfo, other: FieldInfo | None) -> bool:
    return other is not None and (field.description, field.default) == (other.description, other.default)


def _collect(keys: Mapping[str, FieldInfo], inner: dict[type[Schema], list[str]]) -> None:
    """Add the classes of mappings in the values of some keys, with the keys that have them."""
    for name, field in keys.items():
        for model in map(_origin, _models(field.annotation)):
            new = model not in inner
            if name not in inner.setdefault(model, []):
                inner[model].append(name)
            if new:
                _collect(keys_of(model), inner)


def _origin(model: type[Schema]) -> type[Schema]:
    """Return the base of a class that has the same keys, such as that of all errors of sensors."""
    for base in model.__mro__[1:]:
        if issubclass(base, Schema) and keys_of(base).keys() == keys_of(model).keys():
            return base
    return model


def _models(annotation: Any) -> Iterator[type[Schema]]:
    if isinstance(annotation, type) and issubclass(annotation, Schema):
        if not issubclass(annotation, REGISTERED):
            yield annotation
        return
    for part in get_args(annotation):
        yield from _models(part)


def _table(keys: Mapping[str, FieldInfo]) -> Iterator[str]:
    yield "| key | unit | default | meaning |"
    yield "|---|---|---|---|"
    for name, field in keys.items():
        unit, meaning = split_unit(field.description or "")
        words = [word for word in _words(field.annotation) if not re.search(rf"\b{word}\b", meaning)]
        choices = f": {', '.join(f'`{word}`' for word in words)}" if words else ""
        unit = "" if unit in {"-", "1"} else unit
        cells = (f"`{name}`", unit, _default(field, unit), meaning + choices)
        yield "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def _words(annotation: Any) -> Iterator[str]:
    """Yield the words that a value can be."""
    if get_origin(annotation) is Literal:
        yield from (str(word) for word in get_args(annotation))
        return
    for part in get_args(annotation):
        yield from _words(part)


def _default(field: FieldInfo, unit: str) -> str:
    if field.is_required():
        return "required"
    value = field.default
    if value is PydanticUndefined or value is None or isinstance(value, Schema) or value in ([], {}, ""):
        return "-"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        other, factor = ROUND.get(unit, ("", 1.0))
        exact = math.isclose(value, float(f"{value:.3g}"), rel_tol=1e-9)
        return f"{value:.3g}" if exact or not other else f"{value / factor:.4g} {other}"
    if isinstance(value, tuple | list):
        return "[" + ", ".join(f"{part:.6g}" if isinstance(part, float) else str(part) for part in value) + "]"
    return str(value)


def _signals() -> Iterator[str]:
    yield from ("", "## Signals and events of requirements", "")
    yield from (
        "`expect` of a test; see [worlds](worlds.md#tests).",
        "",
        "| signal | unit | meaning |",
        "|---|---|---|",
    )
    for name, (unit, text) in (SIGNALS | SIGNALS_BY_NAME).items():
        yield f"| `{name}` | {unit} | {text} |"
    yield from ("", "Every other signal of a run can be named, too, by its name with a dot.")
    yield from ("", "| event | meaning |", "|---|---|", *(f"| `{name}` | {text} |" for name, text in EVENTS.items()))


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(write_page(), encoding="utf-8")
