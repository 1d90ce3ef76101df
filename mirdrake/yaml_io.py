"""YAML files into pydantic models, with errors that name file, line and key.

Every file format of mirdrake is a pydantic model derived from :class:`Schema`. :func:`load_yaml` reads a file,
:func:`parse_yaml` a text. Both keep the line of every key, so that later stages can still point into the file
with :func:`where`.

Numbers may carry a unit (``90 deg``, ``8 m/s``, ``36 km/h``, ``20 ms``): annotate the field with one of
:data:`Angle`, :data:`Length`, :data:`Speed`, :data:`Duration` and so on; the value becomes SI.
"""

import math
import re
from collections.abc import Hashable, Iterable, Mapping
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Any, NamedTuple, TypeVar, cast

import yaml
from pydantic import BaseModel, BeforeValidator, ConfigDict, PrivateAttr, ValidationError

from mirdrake.errors import ConfigError

SchemaT = TypeVar("SchemaT", bound="Schema")
Key = tuple[Hashable, ...]


class Source(NamedTuple):
    """Where a model came from: a file name, the line of every key path in it, and its own place in the file."""

    name: str
    lines: Mapping[Key, int]
    prefix: Key = ()

    def where(self, *path: Hashable) -> str:
        """``file:line: dotted.path`` of a key, or of its nearest parent that stands in the file."""
        key = _in_file(path, self.lines)
        line = self.lines.get(key)
        dotted = ".".join(str(step) for step in (*self.prefix, *path))
        place = f"{self.name}:{line}" if line else self.name
        return f"{place}: {dotted}" if dotted else place


class Schema(BaseModel):
    """Base of every file format: unknown keys, NaN and infinity are refused."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False, validate_default=False)

    _source: Source | None = PrivateAttr(default=None)


def where(spec: Schema, *path: Hashable) -> str:
    """``file:line: dotted.path`` of a key of a loaded spec, for error messages of later stages."""
    source = spec._source or Source(type(spec).__name__, {})
    return source.where(*path)


# --- numbers with units ------------------------------------------------------------------------------------------

_UNITS: dict[str, dict[str, float]] = {
    "rad": {"rad": 1.0, "deg": math.pi / 180.0},
    "m": {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "km": 1e3, "in": 0.0254, "ft": 0.3048},
    "m/s": {"m/s": 1.0, "km/h": 1.0 / 3.6, "mph": 0.44704},
    "s": {"s": 1.0, "ms": 1e-3, "min": 60.0, "h": 3600.0},
    "rad/s": {"rad/s": 1.0, "deg/s": math.pi / 180.0, "rpm": 2.0 * math.pi / 60.0},
    "kg": {"kg": 1.0, "lb": 0.45359237, "t": 1000.0},
    "N": {"N": 1.0, "kN": 1e3, "lbf": 4.4482216152605},
    "N m": {"N m": 1.0, "Nm": 1.0, "kN m": 1e3},
    "W": {"W": 1.0, "kW": 1e3},
    "Hz": {"Hz": 1.0, "kHz": 1e3},
    "m/s^2": {"m/s^2": 1.0, "m/s²": 1.0, "g": 9.80665},
}
_NUMBER = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(.*?)\s*$")


def to_si(value: Any, unit: str) -> Any:
    """A number or a text such as ``"90 deg"`` as a number in the SI unit given; anything else unchanged.

    Raises:
        ValueError: the text has a unit that does not fit.
    """
    if not isinstance(value, str):
        return value
    match = _NUMBER.match(value)
    if match is None:
        return value
    number, given = float(match.group(1)), match.group(2)
    if not given:
        return number
    scale = _UNITS[unit].get(given)
    if scale is None:
        allowed = ", ".join(_UNITS[unit])
        raise ValueError(f"unit '{given}' does not fit; allowed: {allowed}")
    return number * scale


def _quantity(unit: str) -> BeforeValidator:
    def convert(value: Any) -> Any:
        if isinstance(value, bool):
            raise ValueError(f"a number in {unit} is expected, not {str(value).lower()}")
        return to_si(value, unit)

    return BeforeValidator(convert, json_schema_input_type=float | str)


Angle = Annotated[float, _quantity("rad")]
Length = Annotated[float, _quantity("m")]
Speed = Annotated[float, _quantity("m/s")]
Duration = Annotated[float, _quantity("s")]
AngularRate = Annotated[float, _quantity("rad/s")]
Mass = Annotated[float, _quantity("kg")]
Force = Annotated[float, _quantity("N")]
Torque = Annotated[float, _quantity("N m")]
Power = Annotated[float, _quantity("W")]
Frequency = Annotated[float, _quantity("Hz")]
Acceleration = Annotated[float, _quantity("m/s^2")]


# --- reading -----------------------------------------------------------------------------------------------------


class _Loader(yaml.SafeLoader):
    """YAML 1.2 scalars: no on/off/yes/no, no base-60 numbers, and 1e-3 is a number."""


_Loader.yaml_implicit_resolvers = {
    first: [
        (tag, pattern) for tag, pattern in resolvers if tag not in {f"tag:yaml.org,2002:{t}" for t in ("bool", "float", "int", "timestamp")}
    ]
    for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
_Loader.add_implicit_resolver("tag:yaml.org,2002:bool", re.compile(r"^(?:true|True|TRUE|false|False|FALSE)$"), list("tTfF"))  # type: ignore[no-untyped-call]
_Loader.add_implicit_resolver("tag:yaml.org,2002:int", re.compile(r"^[-+]?[0-9]+$"), list("-+0123456789"))  # type: ignore[no-untyped-call]
_Loader.add_implicit_resolver(  # type: ignore[no-untyped-call]
    "tag:yaml.org,2002:float",
    re.compile(r"^(?:[-+]?(?:[0-9]+\.[0-9]*|\.[0-9]+|[0-9]+)(?:[eE][-+]?[0-9]+)?|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN))$"),
    list("-+0123456789."),
)


def _construct_int(loader: yaml.SafeLoader, node: yaml.ScalarNode) -> int:
    return int(loader.construct_scalar(node))


_Loader.add_constructor("tag:yaml.org,2002:int", _construct_int)


def parse_tree(text: str, name: str) -> tuple[Any, Source]:
    """A YAML text as plain Python data, with the line of every key.

    Raises:
        ConfigError: not YAML, or a key is repeated.
    """
    try:
        node = yaml.compose(text, Loader=_Loader)
    except yaml.MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else 1
        raise ConfigError(f"{name}:{line}: not valid YAML: {error.problem}") from None
    except yaml.YAMLError as error:
        raise ConfigError(f"{name}:1: not valid YAML: {str(error).splitlines()[0]}") from None
    lines: dict[Key, int] = {}
    if node is None:
        return {}, Source(name, lines)
    _collect_lines(node, (), lines, name, depth=0)
    loader = _Loader("")
    try:
        data = loader.construct_document(node)  # type: ignore[no-untyped-call]
    except yaml.MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else 1
        raise ConfigError(f"{name}:{line}: not valid YAML: {error.problem}") from None
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"{name}:1: not valid YAML: {error}") from None
    return data, Source(name, lines)


def parse_yaml(text: str, schema: type[SchemaT], *, name: str = "<text>", overrides: Iterable[str] = ()) -> SchemaT:
    """A YAML text as a checked model.

    Args:
        text: the YAML text; empty means all defaults.
        schema: the pydantic model of the format.
        name: what error messages call the text, normally the file name.
        overrides: ``"dotted.path=value"`` texts, applied over the file in their order; the value is YAML.

    Raises:
        ConfigError: one line per fault, each ``name:line: dotted.path: what is wrong``.
    """
    data, source = parse_tree(text, name)
    if data is None:
        data = {}
    for override in overrides:
        data = _apply_override(data, override)
    return validate(data, schema, source)


def validate(data: Any, schema: type[SchemaT], source: Source) -> SchemaT:
    """Plain data as a checked model that remembers its source.

    Raises:
        ConfigError: one line per fault.
    """
    try:
        spec = schema.model_validate(data)
    except ValidationError as error:
        faults = dict.fromkeys(_fault(entry, schema, source) for entry in error.errors())
        raise ConfigError("\n".join(faults)) from None
    _attach(spec, source, ())
    return spec


def load_yaml(path: Path, schema: type[SchemaT], *, overrides: Iterable[str] = ()) -> SchemaT:
    """A YAML file as a checked model; see :func:`parse_yaml`.

    Raises:
        ConfigError: the file cannot be read, or has faults.
    """
    name = shown(path)
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise ConfigError(f"{name}: no such file") from None
    except UnicodeDecodeError as error:
        raise ConfigError(f"{name}: not UTF-8 text (byte {error.start})") from None
    except OSError as error:
        raise ConfigError(f"{name}: cannot be read: {error.strerror}") from None
    return parse_yaml(text, schema, name=name, overrides=overrides)


def shown(path: Path) -> str:
    """A path as people like to read it: relative to the working directory when it lies below it."""
    try:
        return str(path.resolve().relative_to(Path.cwd()))
    except ValueError:
        return str(path)


# --- the inner parts ---------------------------------------------------------------------------------------------


def _collect_lines(node: yaml.Node, path: Key, lines: dict[Key, int], name: str, depth: int) -> None:
    """Fill `lines` with the line of every key and list item; a repeated key is an error."""
    if depth > 60:
        raise ConfigError(f"{name}:{node.start_mark.line + 1}: nested deeper than 60 levels")
    lines.setdefault(path, node.start_mark.line + 1)
    if isinstance(node, yaml.MappingNode):
        for key, value in node.value:
            here = (*path, str(key.value))
            if here in lines:
                dotted = ".".join(map(str, here))
                raise ConfigError(f"{name}:{key.start_mark.line + 1}: {dotted}: repeated key; keep one of them")
            lines[here] = key.start_mark.line + 1
            _collect_lines(value, here, lines, name, depth + 1)
    elif isinstance(node, yaml.SequenceNode):
        for index, value in enumerate(node.value):
            _collect_lines(value, (*path, index), lines, name, depth + 1)


def _in_file(location: Iterable[Hashable], lines: Mapping[Key, int]) -> Key:
    """The part of an error location that stands in the file (union tags do not)."""
    key: Key = ()
    for step in location:
        key = (*key, step) if (*key, step) in lines else key
    return key


def _fault(entry: Any, schema: type[Schema], source: Source) -> str:
    """One pydantic error as ``file:line: dotted.path: what is wrong``."""
    location = tuple(entry["loc"])
    parent = _in_file(location, source.lines)
    message = str(entry["msg"]).removeprefix("Value error, ").removeprefix("Input should be ")
    kind = entry["type"]
    path: Key = parent
    if kind == "extra_forbidden":
        allowed = _allowed_keys(schema, location[:-1])
        near = get_close_matches(str(location[-1]), allowed, n=1, cutoff=0.6)
        message = "unknown field"
        if near:
            message += f"; did you mean '{near[0]}'?"
        elif allowed:
            message += f"; allowed: {', '.join(sorted(allowed))}"
    elif kind == "missing":
        path = (*parent, location[-1])
        message = "is missing"
    elif kind == "union_tag_invalid":
        context = entry["ctx"]
        given, tags = context["tag"], [tag.strip().strip("'") for tag in context["expected_tags"].split(",")]
        near = get_close_matches(given, tags, n=1, cutoff=0.6)
        message = f"unknown kind '{given}'; " + (f"did you mean '{near[0]}'? " if near else "") + f"(allowed: {', '.join(tags)})"
        path = (*parent, "kind") if (*parent, "kind") in source.lines else parent
    elif kind == "union_tag_not_found":
        message = "needs a 'kind'"
    elif kind in {"value_error", "assertion_error"}:
        pass
    elif kind == "literal_error":
        message = f"'{entry['input']}' is not allowed; allowed: {entry['ctx']['expected']}"
    else:
        given = entry["input"]
        text = repr(given) if not isinstance(given, dict | list) else type(given).__name__
        message = f"{text} is not allowed; it should be {message[0].lower() + message[1:]}"
    dotted = ".".join(str(step) for step in path)
    line = source.lines.get(_in_file(path, source.lines))
    place = f"{source.name}:{line}" if line else source.name
    return f"{place}: {dotted}: {message}" if dotted else f"{place}: {message}"


def _allowed_keys(schema: type[Schema], location: Key) -> list[str]:
    """The keys a mapping at this location may have, read from the JSON schema."""
    root = schema.model_json_schema()
    nodes = [cast(dict[str, Any], root)]

    def resolve(node: dict[str, Any]) -> list[dict[str, Any]]:
        if "$ref" in node:
            return resolve(root["$defs"][node["$ref"].rsplit("/", 1)[1]])
        for word in ("anyOf", "oneOf", "allOf"):
            if word in node:
                return [leaf for option in node[word] for leaf in resolve(option)]
        return [node]

    for step in location:
        following: list[dict[str, Any]] = []
        for node in (leaf for candidate in nodes for leaf in resolve(candidate)):
            if isinstance(step, int) and "items" in node:
                following.append(node["items"])
            elif step in node.get("properties", {}):
                following.append(node["properties"][step])
            elif isinstance(node.get("additionalProperties"), dict):
                following.append(node["additionalProperties"])
        if following:  # a step that is not in the schema is the tag of a union: keep the candidates with that tag
            nodes = following
        else:
            tagged = [
                leaf
                for candidate in nodes
                for leaf in resolve(candidate)
                if leaf.get("properties", {}).get("kind", {}).get("const") == step
            ]
            nodes = tagged or nodes
    return sorted({key for candidate in nodes for leaf in resolve(candidate) for key in leaf.get("properties", {})})


def _apply_override(data: Any, override: str) -> Any:
    """Plain data with one ``dotted.path=value`` set; containers on the way are copied, not changed."""
    path, separator, text = override.partition("=")
    if not separator or not path.strip():
        raise ConfigError(f"--set {override}: expected KEY.PATH=VALUE, for example control.ego.speed=8")
    value, _ = parse_tree(text, f"--set {override}")
    if text.strip() == "":
        value = None
    keys = path.strip().split(".")
    result: Any = dict(data) if isinstance(data, dict) else {}
    node = result
    for key in keys[:-1]:
        child = node.get(key)
        if isinstance(child, list):
            raise ConfigError(f"--set {override}: '{key}' is a list; set it whole")
        node[key] = dict(child) if isinstance(child, dict) else {}
        node = node[key]
    node[keys[-1]] = value
    return result


def _attach(value: Any, source: Source, path: Key) -> None:
    """Give every nested model the part of the source below its own key."""
    if isinstance(value, Schema):
        inside = {key[len(path) :]: line for key, line in source.lines.items() if key[: len(path)] == path}
        value._source = Source(source.name, inside, path)
        for name, field in type(value).model_fields.items():
            _attach(getattr(value, name), source, (*path, field.alias or name))
    elif isinstance(value, dict):
        for key, item in value.items():
            _attach(item, source, (*path, key))
    elif isinstance(value, list | tuple):
        for index, item in enumerate(value):
            _attach(item, source, (*path, index))
