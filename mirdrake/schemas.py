"""JSON Schemas of the YAML files, with which editors complete keys, show units and mark faults.

They are derived from the models of the files. Short forms that readers accept besides (a bare name for a world, ``$mu``
in a world file, a preset in place of a kind) are added here. A schema does not know other files: ``mirdrake check``
reports whether a start or a joint exists.
"""

from collections.abc import Callable, Iterable, Iterator
from copy import deepcopy
from importlib import import_module
from inspect import signature
from pathlib import Path
from typing import Any, NamedTuple

from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.json_io import Json
from mirdrake.core.yaml_io import load_yaml, read_tree

DIALECT = "https://json-schema.org/draft/2020-12/schema"


class Kind(NamedTuple):
    """A file format.

    Attributes:
        model: its pydantic model as ``module:Class``.
        files: name of such files, or their usual place.
        text: their content.
        head: value of the key ``mirdrake`` in such a file; "" for a format that is recognised by the name of the file.
        reader: function that reads such a file and checks it beyond its model, as ``module:function``.
    """

    model: str
    files: str
    text: str
    head: str = ""
    reader: str = ""


KINDS: dict[str, Kind] = {
    "vehicle": Kind("mirdrake.vehicles.spec:VehicleSpec", "vehicle.yaml", "joints, tyres, powertrain of a vehicle"),
    "control": Kind("mirdrake.vehicles.spec:ControlSpec", "control.yaml", "gains and limits of a vehicle"),
    "sensors": Kind("mirdrake.vehicles.mounts:SensorsSpec", "sensors.yaml", "sensors of a vehicle and their mounts"),
    "variant": Kind("mirdrake.vehicles.spec:VariantSpec", "variants/*.yaml", "changes of a variant of a vehicle"),
    "figures": Kind(
        "mirdrake.manoeuvres.published:PublishedFigures",
        "published_figures.yaml",
        "published figures of a vehicle",
        reader="mirdrake.manoeuvres.published:read_published",
    ),
    "presets": Kind("mirdrake.vehicles.presets:PresetsSpec", "models/sensors/*.yaml", "sensors as products"),
    "prop": Kind("mirdrake.worlds.props:PropFile", "prop.yaml", "a prop"),
    "world": Kind("mirdrake.worlds.spec:WorldSpec", "worlds/*.yaml", "a world and its tests, world/1", "world/1"),
    "diagram": Kind(
        "mirdrake.assembly.diagram_spec:DiagramSpec", "diagrams/*.yaml", "vehicles, world and control, wired"
    ),
    "study": Kind(
        "mirdrake.studies.spec:StudySpec",
        "study.yaml",
        "many variations of a diagram, study/1",
        "study/1",
        "mirdrake.studies.spec:load_study",
    ),
    "tuning": Kind(
        "mirdrake.tuning.spec:TuningSpec",
        "tuning.yaml",
        "a control loop to tune, tuning/1",
        "tuning/1",
        "mirdrake.tuning.check:load_checked",
    ),
    "learning": Kind(
        "mirdrake.learning.spec:LearningSpec",
        "learning.yaml",
        "a network that learns to drive, learning/1",
        "learning/1",
        "mirdrake.learning.spec:load_learning",
    ),
    "data": Kind(
        "mirdrake.identification.spec:DataSpec",
        "data.yaml",
        "recorded drives as a data set, data/1",
        "data/1",
        "mirdrake.identification.data:load_data",
    ),
    "identification": Kind(
        "mirdrake.identification.study:StudySpec",
        "identification.yaml",
        "a model to fit to drives, identification/1",
        "identification/1",
        "mirdrake.identification.study:load_identification",
    ),
}
"""The file formats by name."""


def format_of(path: Path) -> str:
    """Return the format of a YAML file, a name in :data:`KINDS`: by its key ``mirdrake``, else by its name.

    A file without either is a diagram.

    Raises:
        ConfigError: the file cannot be read, or its key ``mirdrake`` is not a format.
    """
    data, source = read_tree(path)
    head = data.get("mirdrake") if isinstance(data, dict) else None
    if head is not None:
        heads = {entry.head: name for name, entry in KINDS.items() if entry.head}
        if not isinstance(head, str) or head not in heads:
            raise ConfigError(
                f"unknown format {str(head)[:60]!r}; {did_you_mean(str(head), heads)}", where=source.where("mirdrake")
            )
        return heads[head]
    if path.parent.name == "variants":
        return "variant"
    if isinstance(data, dict) and set(data) == {"presets"}:
        return "presets"
    named = next((name for name, entry in KINDS.items() if entry.files == path.name and not entry.head), "")
    if named or not isinstance(data, dict) or set(data) <= _keys("diagram"):
        return named or "diagram"
    # Files of the other formats need their key, which is forgotten easily.
    fitting = [name for name, entry in KINDS.items() if entry.head and set(data) <= _keys(name)]
    if len(fitting) == 1:
        line = f"mirdrake: {KINDS[fitting[0]].head}"
        raise ConfigError(f"is missing; write `{line}` as its first line", where=source.where("mirdrake"))
    return "diagram"


def _keys(name: str) -> set[str]:
    """Return the keys at the top of a file of a format."""
    return set(_load(KINDS[name].model).model_fields)


def check_file(path: Path, *, overrides: Iterable[str] = ()) -> None:
    """Read a file with the reader of its format, or check it against its model.

    Raises:
        ConfigError: the file has faults.
    """
    entry = KINDS[format_of(path)]
    if not entry.reader:
        load_yaml(path, _load(entry.model), overrides=overrides)
        return
    reader = _load(entry.reader)
    if "overrides" in signature(reader).parameters:
        reader(path, overrides=overrides)
    elif overrides:
        raise ConfigError(f"--set: not for {entry.files} ({entry.head})")
    else:
        reader(path)


def make_schema(kind: str) -> Json:
    """Return the JSON Schema of a file format.

    Args:
        kind: a name in :data:`KINDS`.

    Raises:
        ConfigError: the format is unknown.
    """
    if kind not in KINDS:
        raise ConfigError(f"unknown file format '{kind}'; {did_you_mean(kind, KINDS)}")
    entry = KINDS[kind]
    schema = _schema_of(entry.model)
    _add_short_forms(schema)
    if kind in _ADDITIONS:
        _ADDITIONS[kind](schema)
    head = {"$schema": DIALECT, "title": f"mirdrake {entry.files}: {entry.text}"}
    return head | {key: value for key, value in schema.items() if key != "title"}


def _schema_of(model: str) -> Json:
    schema: Json = _load(model).model_json_schema(mode="validation")
    return schema


def _load(place: str) -> Any:
    """Return the object ``module:name``."""
    module, _, name = place.partition(":")
    return getattr(import_module(module), name)


def _nodes(schema: Any) -> Iterator[Json]:
    """Yield every mapping of a schema, inner ones first."""
    if isinstance(schema, dict):
        for value in list(schema.values()):
            yield from _nodes(value)
        yield schema
    elif isinstance(schema, list):
        for value in schema:
            yield from _nodes(value)


# --- short forms that readers accept besides their models -----------------------------------------------------------


_SHORT: dict[str, Json] = {
    "Traction": {"type": "boolean"},
    "Antilock": {"type": "boolean"},
    "Stability": {"type": "boolean"},
    "Column": {"type": "string"},
    "CsvSpec": {"type": "string"},
    "XodrSpec": {"type": "string"},
    "DepthNoiseSpec": {"type": "string"},
}
"""Short forms of mappings, by the name of their model."""


def _add_short_forms(schema: Json) -> None:
    """Add a text, number or boolean in place of a mapping, and units for numbers of noise."""
    from mirdrake.sensors.noise_spec import NoiseSpec

    noises = {model.__name__ for model in NoiseSpec.__subclasses__()}
    definitions = schema.get("$defs", {})
    for name in definitions:
        if name in noises:
            for node in list(_nodes(definitions[name])):
                if node.get("type") == "number":
                    node["type"] = ["number", "string"]
            definitions[name] = {"anyOf": [definitions[name], {"type": ["number", "string"]}]}
        elif name in _SHORT:
            definitions[name] = {"anyOf": [definitions[name], _SHORT[name]]}


def _add_to_world(schema: Json) -> None:
    """Add parameters and random values wherever a number or one of several words is allowed."""
    for node in _nodes(schema):
        if node.get("type") in {"number", "integer"}:
            limits = {key: node.pop(key) for key in list(node) if key in _NUMERIC}
            node["anyOf"] = [limits, {"type": "string", "pattern": r"\$|\.\.|\+-|\|"}]
        elif "enum" in node:
            words = {key: node.pop(key) for key in ("enum", "type") if key in node}
            node["anyOf"] = [words, {"type": "string", "pattern": r"\$|\|"}]


_NUMERIC = {"type", "minimum", "maximum", "exclusiveMinimum", "exclusiveMaximum", "multipleOf"}


def _add_to_diagram(schema: Json) -> None:
    """Add the bare name of a world, mirdrake's blocks with their parameters, and user classes."""
    from mirdrake.assembly.blocks import BLOCKS

    definitions, properties = schema["$defs"], schema["properties"]
    world = properties["world"]
    about = {"description": world.pop("description")} if "description" in world else {}
    properties["world"] = {"anyOf": [{"type": "string"}, dict(world)], **about}
    driver = properties["control"].get("additionalProperties", {})
    for option in (driver, *properties["control"].get("patternProperties", {}).values()):
        if "oneOf" in option:
            option["oneOf"].append({"type": "string"})
            option.pop("discriminator", None)
    own = {"type": "string", "pattern": "^[^:]+:[^:]+$", "description": "user class, module:Class [-]"}
    definitions["OwnDriverSpec"]["properties"]["kind"] = own
    blocks = []
    for kind, model in BLOCKS.items():
        block = model.model_json_schema(mode="validation")
        # References of a block lead to the definitions of the whole file.
        definitions |= block.pop("$defs", {})
        block["properties"] = {"kind": {"const": kind}} | block.get("properties", {})
        block["required"] = ["kind", *block.get("required", [])]
        blocks.append(block)
    blocks.append(definitions["SystemEntry"] | {"properties": {"kind": own}})
    definitions["SystemEntry"] = {"title": "A block", "oneOf": blocks}


def _add_to_sensors(schema: Json) -> None:
    """Add a preset in place of a kind, with any key of any sensor."""
    from mirdrake.vehicles.presets import presets

    union = schema["properties"]["mounts"]["additionalProperties"]
    names = [option["$ref"].rsplit("/", 1)[1] for option in union["oneOf"]]
    known: Json = {"anyOf": [{"enum": sorted(presets())}, {"type": "string"}]}  # the user may have files with others
    keys: Json = {"preset": known | {"description": "sensor product, see models/sensors [-]"}}
    for name in names:
        for key, value in schema["$defs"][name]["properties"].items():
            if key != "kind":
                keys.setdefault(key, {"anyOf": []})["anyOf"].append(value)
    schema["$defs"]["Preset"] = {
        "title": "A product",
        "type": "object",
        "properties": keys,
        "required": ["preset", "frame"],
        "additionalProperties": False,
    }
    union.pop("discriminator", None)
    union["oneOf"].append({"$ref": "#/$defs/Preset"})


def _add_to_variant(schema: Json) -> None:
    """Add the parts of the vehicle's own files, without required keys."""
    for part in ("vehicle", "control", "sensors"):
        if part not in schema["properties"]:
            continue
        inner = make_schema(part)
        for node in _nodes(inner):
            node.pop("required", None)
            if "oneOf" in node:  # without the discriminating key several may fit
                node["anyOf"] = node.pop("oneOf")
                node.pop("discriminator", None)
        schema.setdefault("$defs", {}).update(inner.pop("$defs", {}))
        for key in ("$schema", "title"):
            inner.pop(key, None)
        schema["properties"][part] = deepcopy(inner)


def _add_to_identification(schema: Json) -> None:
    """Add the kind of a model as a text."""
    schema["properties"]["model"]["type"] = ["object", "string"]


_ADDITIONS: dict[str, Callable[[Json], None]] = {
    "world": _add_to_world,
    "diagram": _add_to_diagram,
    "sensors": _add_to_sensors,
    "variant": _add_to_variant,
    "identification": _add_to_identification,
}
