"""Reader of YAML files to pydantic models, with errors that name file, line and key.

Every file format of mirdrake is a pydantic model derived from :class:`Schema`. :func:`load_yaml` reads a file,
:func:`parse_yaml` a text. Both keep the line of every key, so that errors of later stages can also name it,
by :func:`where`.

Numbers may carry a unit (``90 deg``, ``8 m/s``, ``36 km/h``, ``20 ms``): annotate the field with one of
:data:`Angle`, :data:`Length`, :data:`Speed`, :data:`Duration` and so on; the value becomes SI.
"""

import math
import re
from collections.abc import Callable, Hashable, Iterable, Iterator
from functools import cache
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, PrivateAttr, ValidationError

from mirdrake.core.constants import GRAVITY
from mirdrake.core.errors import ConfigError, FaultCode, Place, did_you_mean, dotted
from mirdrake.core.json_io import Json
from mirdrake.core.paths import names, resolved
from mirdrake.core.yaml_tree import Key as Key  # with `as`: also public here
from mirdrake.core.yaml_tree import Source as Source
from mirdrake.core.yaml_tree import in_file, merge_over
from mirdrake.core.yaml_tree import parse_tree as parse_tree

SchemaT = TypeVar("SchemaT", bound="Schema")

MOST_FAULTS = 50
"""Maximum number of faults reported for a file."""

SHORTEST_PERIOD = 1e-5
"""Shortest step or period in a file [s]."""


class Schema(BaseModel):
    """Base of every file format. Unknown keys, NaN and infinity are rejected, and so is `true` for a number in a file.

    Two models are equal if their fields are, whatever their files.
    """

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False, validate_default=False)

    _source: Source | None = PrivateAttr(default=None)

    def __eq__(self, other: object) -> bool:
        return type(self) is type(other) and self.__dict__ == other.__dict__


def where(spec: Schema, *path: Hashable) -> Place:
    """Return the place of a key of a loaded spec, for error messages of later stages."""
    source = spec._source or Source(type(spec).__name__, {})
    return source.where(*path)


def file_line(spec: Schema, *path: Hashable) -> Place:
    """Return ``file:line`` of a key of a loaded spec."""
    source = spec._source or Source(type(spec).__name__, {})
    return source.place(*path)


# --- numbers with units ------------------------------------------------------------------------------------------

_UNITS: dict[str, dict[str, float]] = {
    "rad": {"rad": 1.0, "deg": math.pi / 180.0, "°": math.pi / 180.0},
    "m": {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "km": 1e3, "in": 0.0254, "ft": 0.3048},
    "m/s": {"m/s": 1.0, "km/h": 1.0 / 3.6, "mph": 0.44704},
    "s": {"s": 1.0, "ms": 1e-3, "min": 60.0, "h": 3600.0},
    "rad/s": {"rad/s": 1.0, "deg/s": math.pi / 180.0, "rpm": 2.0 * math.pi / 60.0},
    "kg": {"kg": 1.0, "lb": 0.45359237, "t": 1000.0},
    "N": {"N": 1.0, "kN": 1e3, "lbf": 4.4482216152605},
    "N m": {"N m": 1.0, "Nm": 1.0, "kN m": 1e3, "kNm": 1e3},
    "W": {"W": 1.0, "kW": 1e3, "hp": 745.6998715822702},
    "Hz": {"Hz": 1.0, "kHz": 1e3},
    "kg m²": {"kg m²": 1.0, "kg m^2": 1.0},
    "-": {},
    "m/s^2": {"m/s^2": 1.0, "m/s²": 1.0, "g": GRAVITY},
}
_NUMBER = re.compile(r"([-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?)\s*(.*)", re.DOTALL)


def to_si(value: Any, unit: str) -> Any:
    """Return a number or a text such as ``"90 deg"`` as a number in a given SI unit, other values unchanged.

    Raises:
        ValueError: the unit in the text does not fit.
    """
    if not isinstance(value, str):
        return value
    # The number is split from its unit before the table is known, so that an unknown unit can be named.
    match = _NUMBER.fullmatch(value.strip())
    if match is None:
        return value
    number, given = float(match.group(1)), match.group(2)
    if not given:
        return number
    scale = _UNITS[unit].get(given)
    if scale is None:
        allowed = ", ".join(_UNITS[unit]) or "none"
        raise ValueError(f"unit {shown_value(given)} does not fit; allowed: {allowed}")
    return number * scale


def any_to_si(value: str) -> float | str:
    """Return a text such as ``"90 deg"`` as a number in the SI unit of its quantity, other texts unchanged."""
    match = _NUMBER.fullmatch(value.strip())
    for known in _UNITS.values():
        if match is not None and match.group(2) in known:
            return float(match.group(1)) * known[match.group(2)]
    return value


def _quantity(unit: str) -> BeforeValidator:
    def convert(value: Any) -> Any:
        if isinstance(value, bool):
            raise ValueError(f"must be a number in {unit}, not {str(value).lower()}")
        return to_si(value, unit)

    return BeforeValidator(convert, json_schema_input_type=float | str)


def _long_enough(value: float) -> float:
    """Reject a period so short that a run would not end; the field itself rejects zero and negative ones."""
    if 0.0 < value < SHORTEST_PERIOD:
        raise ValueError(
            f"{value:g} s is too short; at least {SHORTEST_PERIOD:g} s, which is already "
            f"{1.0 / SHORTEST_PERIOD:.0f} steps per simulated second"
        )
    return value


Angle = Annotated[float, _quantity("rad")]
Length = Annotated[float, _quantity("m")]
Speed = Annotated[float, _quantity("m/s")]
Duration = Annotated[float, _quantity("s")]
Period = Annotated[Duration, AfterValidator(_long_enough)]
AngularRate = Annotated[float, _quantity("rad/s")]
Mass = Annotated[float, _quantity("kg")]
Force = Annotated[float, _quantity("N")]
Torque = Annotated[float, _quantity("N m")]
Power = Annotated[float, _quantity("W")]
Frequency = Annotated[float, _quantity("Hz")]
Acceleration = Annotated[float, _quantity("m/s^2")]


_PATTERNS: dict[str, str] = {}


def matching(pattern: str, words: str) -> Any:
    """Return the field of a text that must match a pattern; `words` describe it in messages."""
    _PATTERNS[pattern] = words
    return Field(pattern=pattern, description=f"{words} [-]")


# --- reading -----------------------------------------------------------------------------------------------------


def parse_yaml(text: str, schema: type[SchemaT], *, name: str = "<text>", overrides: Iterable[str] = ()) -> SchemaT:
    """Parse a YAML text to a validated model.

    Args:
        text: the YAML text; empty for all defaults.
        schema: the pydantic model of the format.
        name: name of the text in error messages, normally the file name.
        overrides: ``"dotted.path=value"`` texts, applied over the file in their order; the value is YAML, a number in
            the path is the index of a list item, as in ``connect.0=[a.y, b.u]``.

    Raises:
        ConfigError: the text has faults; one line each, ``name:line: dotted.path: fault``.
    """
    data, source = _overridden(text, name, overrides)
    return validate(data, schema, source)


def read_tree(path: Path, *, overrides: Iterable[str] = ()) -> tuple[Any, Source]:
    """Read a YAML file as plain data with the locations of its keys, overrides applied; see :func:`parse_yaml`.

    Raises:
        ConfigError: the file cannot be read, is not YAML, or an override is wrong.
    """
    return _overridden(read_text(path), display_path(path), overrides)


def validate(data: Any, schema: type[SchemaT], source: Source) -> SchemaT:
    """Validate plain data; the model keeps its source.

    Args:
        data: data from :func:`parse_tree`, or a part of it.
        schema: the pydantic model of the format.
        source: locations of the keys; its prefix is the path of `data` in the file.

    Raises:
        ConfigError: the data have faults, one per line.
    """
    try:
        spec = schema.model_validate(data)
    except ValidationError as error:
        # Each line costs a search for similar names: a file of another kind may have thousands of unknown keys.
        entries = error.errors()
        # The JSON Schema is made at the first unknown key only, and not kept: a kind may be registered later.
        keys = cache(schema.model_json_schema)
        faults = [_fault(entry, keys, source) for entry in entries[:MOST_FAULTS]]
        if len(entries) > MOST_FAULTS:
            more = len(entries) - MOST_FAULTS
            faults.append(source.error(f"{more} more faults; correct these first", code="too_many"))
        raise ConfigError(faults=faults) from None
    # pydantic reads true as 1.0 for a plain float, so the data of the file are compared with the model.
    truths = list(_truth_for_number(spec, data, ()))
    if truths:
        raise ConfigError(
            faults=[source.error(f"{word} is not a number", *path, code="not_a_number") for path, word in truths]
        )
    _attach(spec, source, source.prefix)
    return spec


def load_yaml(
    path: Path, schema: type[SchemaT], *, overrides: Iterable[str] = (), over: tuple[Any, Source] | None = None
) -> SchemaT:
    """Load a YAML file as a validated model; see :func:`parse_yaml`.

    Args:
        path: the file.
        schema: the pydantic model of the format.
        overrides: ``"dotted.path=value"`` texts.
        over: a partial tree and its locations, merged over the file; see :func:`mirdrake.core.yaml_tree.merge_over`.

    Raises:
        ConfigError: the file cannot be read, or has faults.
    """
    text, name = read_text(path), display_path(path)
    if over is None:
        return parse_yaml(text, schema, name=name, overrides=overrides)
    data, source = merge_over(*parse_tree(text, name), *over)
    return validate(data, schema, source)


def read_text(path: Path) -> str:
    """Read a text file.

    Raises:
        ConfigError: the file cannot be read, or is not UTF-8.
    """
    name = display_path(path)
    try:
        return path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise ConfigError("no such file", file=name, code="no_such_file") from None
    except IsADirectoryError:
        raise ConfigError("is a folder; a YAML file is expected", file=name, code="unreadable") from None
    except UnicodeDecodeError as error:
        raise ConfigError(f"not UTF-8 text (byte {error.start})", file=name, code="unreadable") from None
    except (OSError, ValueError) as error:  # ValueError: a zero byte in the name
        reason = getattr(error, "strerror", None) or error
        raise ConfigError(f"cannot be read: {reason}", file=name, code="unreadable") from None


def display_path(path: Path) -> str:
    """Return a path for display: relative to the working directory if it is below that."""
    try:
        return str(path.resolve().relative_to(Path.cwd()))
    except (OSError, RuntimeError, ValueError):  # no working directory, a loop of links, or another folder
        return str(path)


def shortest_name(kind: str, path: Path) -> str:
    """Return the name of a vehicle, world or diagram if a lookup finds this path, else the path for display.

    Args:
        kind: "models", "worlds" or "diagrams".
        path: the folder of a vehicle, or the file.
    """
    name = path.name if kind == "models" else path.stem
    known = names(kind).get(name)
    return name if known is not None and resolved(known) == resolved(path) else display_path(path)


# --- the inner parts ---------------------------------------------------------------------------------------------


def shown_value(value: Any) -> str:
    """Return a value as in YAML, truncated if it is long."""
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    if isinstance(value, dict | list | Schema):
        return "a list" if isinstance(value, list) else "a mapping"
    text = repr(value[:80] if isinstance(value, str) else value)
    return text if len(text) <= 60 else f"{text[:56]} …{text[-1]}"


_NOT_NUMBERS = {"float_type", "float_parsing", "int_type", "int_parsing", "int_from_float"}


def _fault(entry: Any, json_schema: Callable[[], Json], source: Source) -> ConfigError:
    """Return an error of pydantic in the words of this module, with its location."""
    location = tuple(entry["loc"])
    # Tags of unions are part of pydantic's location, but not of the file.
    path = in_file(location, source)

    # Messages of pydantic are replaced where they do not state what was given and what is allowed.
    kind, given, context = entry["type"], entry["input"], entry.get("ctx", {})
    # Where a function reads the kind, pydantic has its name in place of that of the key.
    key = context.get("discriminator", "()").strip("'")
    key = "kind" if key.endswith("()") else key
    # Prefixes of pydantic state how a rule is implemented, not what is wrong.
    message = str(entry["msg"]).removeprefix("Value error, ").removeprefix("Assertion failed, ")
    message = message.removeprefix("Input should be ")
    code: FaultCode = "bad_value"
    if kind == "extra_forbidden":
        code = "unknown_key"
        # For an unknown key, its own line is known; the path may already end with it.
        if path[-1:] != (str(location[-1]),):
            path = (*path, location[-1])
        known = {name for node in _properties(json_schema(), location[:-1]) for name in node}
        message = f"unknown field; {did_you_mean(location[-1], known)}"
    elif kind == "missing":
        code = "missing_key"
        path = (*path, location[-1])
        message = "is missing"
        if path == ("mirdrake",) and not source.prefix:
            head = json_schema()["properties"]["mirdrake"]["const"]
            message = f"is missing; write `mirdrake: {head}` as its first line"
    elif kind == "union_tag_invalid":
        code = "unknown_kind"
        tags = [tag.strip().strip("'") for tag in context["expected_tags"].split(", ")]
        path = (*path, key)
        message = f"unknown {key} {shown_value(context['tag'])}; {did_you_mean(context['tag'], tags)}"
    elif kind == "union_tag_not_found":
        code = "missing_kind"
        kinds = {node[key]["const"] for node in _properties(json_schema(), location) if "const" in node.get(key, {})}
        needed = (
            f"needs a '{key}'" if isinstance(given, dict) else f"{shown_value(given)} is not a mapping with a '{key}'"
        )
        message = f"{needed}; {did_you_mean('', kinds)}" if kinds else needed
    elif kind == "literal_error":
        code = "not_allowed"
        message = f"{shown_value(given)} is not allowed; allowed: {context['expected']}"
    elif kind in {"model_type", "model_attributes_type", "dict_type", "list_type", "tuple_type"}:
        code = "wrong_type"
        message = f"{shown_value(given)} is not a {'list' if kind[0] in 'lt' else 'mapping (key: value)'}"
    elif kind == "string_type":
        code = "wrong_type"
        message = f"{shown_value(given)} is not a text"
    elif kind in _NOT_NUMBERS:
        code = "not_a_number"
        message = f"{shown_value(given)} is not a{' whole' if kind.startswith('int') else ''} number"
    elif kind in {"too_long", "too_short"}:
        # The kind of bound determines which of both lengths was missed.
        code = "wrong_length"
        allowed = context.get("max_length", context.get("min_length"))
        message = f"has {context['actual_length']} items; at {'most' if kind == 'too_long' else 'least'} {allowed}"
    elif kind == "string_pattern_mismatch" and context["pattern"] in _PATTERNS:
        message = f"{shown_value(given)} is not allowed; use {_PATTERNS[context['pattern']]}"
    elif kind == "finite_number":
        code = "not_finite"
        message = f"{given} is not a finite number"
    elif kind not in {"value_error", "assertion_error"}:
        message = f"{shown_value(given)} is not allowed; it should be {message[:1].lower() + message[1:]}"
    return source.error(" ".join(message.split()), *path, code=code)


def _properties(root: Json, location: Key) -> list[Json]:
    """Return the properties of each mapping that may be at this location, from the JSON Schema of the file."""
    nodes = [root]

    # Unions and references: a location may have several possible schemas, which are all searched.
    def resolve(node: Json) -> list[Json]:
        if "$ref" in node:
            return resolve(root["$defs"][node["$ref"].rsplit("/", 1)[1]])
        for word in ("anyOf", "oneOf", "allOf"):
            if word in node:
                return [leaf for option in node[word] for leaf in resolve(option)]
        return [node]

    # Each step of the location leads to properties, items or values of the candidates.
    for step in location:
        following: list[Json] = []
        for node in (leaf for candidate in nodes for leaf in resolve(candidate)):
            if isinstance(step, int) and "items" in node:
                following.append(node["items"])
            elif step in node.get("properties", {}):
                following.append(node["properties"][step])
            elif isinstance(node.get("additionalProperties"), dict):
                following.append(node["additionalProperties"])
            else:  # a mapping whose keys must match a pattern
                following += node.get("patternProperties", {}).values()
        if following:  # otherwise the step is the tag of a union: keep the candidates with that tag
            nodes = following
        else:
            tagged = [
                leaf
                for candidate in nodes
                for leaf in resolve(candidate)
                if leaf.get("properties", {}).get("kind", {}).get("const") == step
            ]
            nodes = tagged or nodes
    return [leaf.get("properties", {}) for candidate in nodes for leaf in resolve(candidate)]


def _overridden(text: str, name: str, overrides: Iterable[str]) -> tuple[Any, Source]:
    """Parse a text to plain data, and apply overrides."""
    data, source = parse_tree(text, name)
    data = {} if data is None else data
    if isinstance(data, dict):  # other data are rejected by the schema
        for override in overrides:
            data, source = _apply_override(data, override, source)
    return data, source


def _apply_override(data: Json, override: str, source: Source) -> tuple[Json, Source]:
    """Return data and source with one ``dotted.path=value`` set; containers on the path are copied.

    Raises:
        ConfigError: the override is malformed, not YAML, or has a list index that does not exist.
    """
    printable = override if override.isprintable() else repr(override)
    given_as = f"--set {printable}" if len(printable) <= 80 else f"--set {printable[:79]}…"
    # Only the first "=" separates, as the value may have more of them.
    path, separator, text = override.partition("=")
    keys = [key.strip() for key in path.split(".")]
    if not separator or not all(keys):
        raise ConfigError(
            "expected KEY.PATH=VALUE, for example control.ego.speed=8", file=given_as, code="bad_override"
        )
    value, inner = parse_tree(text, given_as)
    result = dict(data)
    node: Any = result
    full: Key = ()
    # Lines of the file below the replaced value are not valid any more; errors there must name the override.
    replaced = len(keys)  # from this depth on, values come from the override
    for depth, key in enumerate(keys, start=1):
        step: Any = key
        if isinstance(node, list):
            if not (key.isdecimal() and len(key) < 7 and int(key) < len(node)):
                text = f"{dotted(full)} is a list of {len(node)}; '{key}' is not an index of it"
                raise ConfigError(text, file=given_as, code="bad_override")
            step = int(key)
        full = (*full, step)
        if depth == len(keys):
            # An empty text parses to an empty mapping without lines; `--set key=` means null.
            node[step] = value if inner.lines else None
            break
        child = node[step] if isinstance(node, list) else node.get(step)
        if not isinstance(child, dict | list):
            replaced = min(replaced, depth)
        # Copied on the way down: the caller's data, and aliases of the same node, stay unchanged.
        node[step] = list(child) if isinstance(child, list) else dict(child) if isinstance(child, dict) else {}
        node = node[step]
    replaced_path = full[:replaced]
    lines = {key: line for key, line in source.lines.items() if key[:replaced] != replaced_path}
    overrides = {key: text for key, text in source.overrides.items() if key[:replaced] != replaced_path}
    overrides |= {full[:length]: given_as for length in range(replaced, len(full))}
    overrides |= {(*full, *key): given_as for key in ((), *inner.lines)}
    return result, source._replace(lines=lines, overrides=overrides)


def _truth_for_number(value: Any, data: Any, path: Key) -> Iterator[tuple[Key, str]]:
    """Yield where the data have true or false and the model a number, as pydantic reads true as 1.0."""
    if isinstance(data, bool) and isinstance(value, int | float) and not isinstance(value, bool):
        yield path, str(data).lower()
    elif isinstance(data, dict) and isinstance(value, Schema):
        for name, field in type(value).model_fields.items():
            key = field.alias or name
            yield from _truth_for_number(getattr(value, name), data.get(key), (*path, key))
    elif isinstance(data, dict) and isinstance(value, dict):
        for key, item in value.items():
            yield from _truth_for_number(item, data.get(key), (*path, key))
    elif isinstance(data, list) and isinstance(value, list | tuple):
        for index, (item, given) in enumerate(zip(value, data, strict=False)):
            yield from _truth_for_number(item, given, (*path, index))


def _attach(value: Any, source: Source, path: Key) -> None:
    """Set the source of every nested model."""
    if isinstance(value, Schema):
        # Keys of the file are aliases where Python's names differ from them.
        value._source = source._replace(prefix=path)
        for name, field in type(value).model_fields.items():
            item = getattr(value, name)
            if isinstance(item, Schema) and item is field.default:  # pydantic shares frozen defaults between specs
                item = value.__dict__[name] = item.model_copy(deep=True)
            _attach(item, source, (*path, field.alias or name))
    elif isinstance(value, dict):
        for key, item in value.items():
            _attach(item, source, (*path, key))
    elif isinstance(value, list | tuple):
        for index, item in enumerate(value):
            _attach(item, source, (*path, index))
