"""Parser of YAML to plain data with the line of every key.

:func:`parse_tree` reads a safe subset of YAML 1.2: mappings with text keys, lists, texts, numbers, true, false and
null, with anchors, aliases and ``<<`` merges, but no other tags. :mod:`mirdrake.core.yaml_io` validates the data.
"""

import copy
import re
from collections.abc import Hashable, Iterable, Mapping
from functools import lru_cache
from typing import Any, NamedTuple

import yaml

from mirdrake.core.errors import ConfigError, FaultCode, Place, dotted

Key = tuple[Hashable, ...]


class Source(NamedTuple):
    """Origin of a model: a file, the lines of its keys, the overrides, and the model's own path in the file."""

    name: str
    lines: Mapping[Key, int | None]  # None: data from Python, which have keys and no lines
    prefix: Key = ()
    overrides: Mapping[Key, str] = {}  # key path -> the command line's "--set KEY=VALUE"

    def where(self, *path: Hashable) -> Place:
        """Return the place of a key below the prefix, with the line of its nearest parent in the file."""
        return Place(*self._location(*path), (*self.prefix, *path))

    def place(self, *path: Hashable) -> Place:
        """Return ``file:line`` of a key below the prefix, or of its nearest parent in the file."""
        return Place(*self._location(*path))

    def error(self, text: str, *path: Hashable, code: FaultCode = "") -> ConfigError:
        """Return an error with this text at a key below the prefix."""
        return ConfigError(text, where=self.where(*path), code=code)

    def _location(self, *path: Hashable) -> tuple[str, int | None]:
        """Return file and line of a key below the prefix, or of its nearest parent; an override has no line."""
        full = (*self.prefix, *path)
        top = self._replace(prefix=())
        # From the full path upwards: a missing key has the line of its nearest parent.
        for length in range(len(full), -1, -1):
            key = in_file(full[:length], top)
            if len(key) == length:
                break
        override = self.overrides.get(key)
        return (override, None) if override else (self.name, self.lines.get(key))


def source_of_data(name: str, data: Any) -> Source:
    """Return the source of data from Python: the keys, without lines."""
    keys: dict[Key, None] = {}

    def note(value: Any, path: Key) -> None:
        if path:
            keys[path] = None
        items = value.items() if isinstance(value, Mapping) else enumerate(value) if isinstance(value, list) else ()
        for key, item in items:
            note(item, (*path, key))

    note(data, ())
    return Source(name, keys)


def merge_over(data: Any, source: Source, over: Any, over_source: Source) -> tuple[Any, Source]:
    """Merge a partial tree over a tree.

    Mappings merge key by key unless their kinds differ; other values are replaced. Where the partial tree names a
    preset, only the keys of :func:`below_preset` remain of the mapping below.

    Args:
        data: the tree below; it is not changed.
        source: locations of its keys.
        over: the partial tree.
        over_source: locations of its keys; its prefix is the path of `over` in its file.

    Returns:
        the merged tree, and a source that locates every key where it was last set.
    """
    lines, places = dict(source.lines), dict(source.overrides)

    def merge(below: Any, above: Any, path: Key) -> Any:
        if path:
            places[path] = over_source.place(*path)
        # Another kind has other keys, so that nothing of the mapping below may remain.
        if (
            isinstance(below, dict)
            and isinstance(above, dict)
            and below.get("kind") == above.get("kind", below.get("kind"))
        ):
            remaining = below_preset(below, above)
            # Keys that a preset removed must not keep their lines.
            for key in [key for key in lines if key[: len(path)] == path and key[len(path) : len(path) + 1]]:
                if key[len(path)] in below and key[len(path)] not in remaining:
                    del lines[key]
            below = remaining
            return {**below, **{key: merge(below.get(key), value, (*path, key)) for key, value in above.items()}}
        # A replaced value has no keys of the file below it any more.
        for key in [key for key in lines if key[: len(path)] == path and len(key) > len(path)]:
            del lines[key]
        if isinstance(above, dict):
            return {key: merge(None, value, (*path, key)) for key, value in above.items()}
        return above

    return merge(data, over, ()), source._replace(lines=lines, overrides=places)


def below_preset(below: dict[Any, Any], above: Mapping[Any, Any]) -> dict[Any, Any]:
    """Return what remains of a mapping when another is merged over it.

    All of it, unless the other names a preset: this sets the numbers of another product, so that those of the former
    product are removed. Keys of the installation (:data:`_PLACE`) remain.
    """
    return {key: value for key, value in below.items() if key in _PLACE} if "preset" in above else below


_PLACE = {"frame", "datum"}  # mounting frame of a sensor, position of the world on the Earth


def parse_tree(text: str, name: str) -> tuple[Any, Source]:
    """Parse a YAML text to plain data with the line of every key; an empty text is an empty mapping.

    Raises:
        ConfigError: the text is not YAML, repeats a key, or expands to too much data.
    """
    try:
        data, lines = _parsed(text)
    except yaml.MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else 1
        raise ConfigError(_yaml_problem(error), file=name, line=line, code="not_yaml") from None
    except yaml.reader.ReaderError as error:
        line = text.count("\n", 0, error.position) + 1
        code = error.character if isinstance(error.character, int) else ord(str(error.character))
        text = f"not valid YAML: character {code:#x} is not allowed"
        raise ConfigError(text, file=name, line=line, code="not_yaml") from None
    # A copy, because callers may change the data; aliases of a node stay one object.
    return copy.deepcopy(data), Source(name, lines)


@lru_cache(maxsize=8)
def _parsed(text: str) -> tuple[Any, dict[Key, int]]:
    """Return the data and lines of a text; a file is read for its format, and again with the reader of the format."""
    lines: dict[Key, int] = {}
    loader = _Loader(text)
    try:
        node = loader.get_single_node()
        if node is None:
            return {}, lines
        _LineCollector(lines).visit(node, ())
        return loader.construct_document(node), lines
    except (ValueError, OverflowError):  # PyYAML does not catch a few errors: "\UFFFFFFFF", %YAML 9999…
        problem = "not valid YAML: a code or version out of range"
        raise _FileFaultError(problem=problem, problem_mark=loader.get_mark()) from None


def _yaml_problem(error: yaml.MarkedYAMLError) -> str:
    """Return one line about an error of PyYAML, which has its message in two parts."""
    context, problem = error.context or "", error.problem or "unreadable"
    if "duplicate anchor" in context:
        problem = context.removeprefix("found ").partition(";")[0] + "; give each anchor its own name"
    elif "single document" in context:
        problem = "more than one document; remove the line '---'"
    elif "'\\t'" in problem:
        problem = "this line is indented with a tab; use spaces"
    elif "could not determine a constructor" in problem:
        problem = problem.replace("could not determine a constructor for the tag", "unknown tag")
    elif isinstance(error, _FileFaultError):
        return problem
    return f"not valid YAML: {problem}"


# --- the inner parts --------------------------------------------------------------------------------------------------


_MAX_DEPTH = 60  # levels; also keeps Python's stack safe
_MAX_VALUES = 200_000  # keys and list items with aliases written out: a small file can mean billions


class _Loader(yaml.SafeLoader):
    """Loader of plain data with YAML 1.2 scalars: on, off, yes and no are texts, 1e-3 is a number, keys are texts."""

    depth = 0

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        """Return the next node; nesting that is too deep raises an error with its line."""
        # PyYAML recurses for each level; a deep file would end in a RecursionError without a line.
        self.depth += 1
        if self.depth > _MAX_DEPTH:
            raise _FileFaultError(problem=_TOO_DEEP, problem_mark=self.get_mark())
        node = super().compose_node(parent, index)
        self.depth -= 1
        return node

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        """Return a dict whose keys are the texts as written, after ``<<`` merges."""
        if not isinstance(node, yaml.MappingNode):
            raise _FileFaultError(problem="a mapping is expected", problem_mark=node.start_mark)
        # Merges are resolved by PyYAML itself, own keys first.
        self.flatten_mapping(node)
        # Keys are texts as written, so that 1 and on stay names.
        return {key.value: self.construct_object(value, deep=deep) for key, value in node.value}

    def construct_number(self, node: yaml.ScalarNode) -> int | float:
        """Return an int or a float."""
        text = str(self.construct_scalar(node))
        try:
            # YAML 1.2 has no octal or sexagesimal numbers; Python's own conversion reads exactly the allowed form.
            if node.tag.endswith(":int"):
                number = int(text)
                float(number)  # a longer one cannot be used in computations
                return number
            return float(text.lower().replace(".inf", "inf").replace(".nan", "nan"))
        except (ValueError, OverflowError):
            raise _FileFaultError(problem="not a number, or too long", problem_mark=node.start_mark) from None

    def construct_truth(self, node: yaml.ScalarNode) -> bool:
        """Return a bool."""
        return str(self.construct_scalar(node)).lower() != "false"


_TOO_DEEP = f"nested deeper than {_MAX_DEPTH} levels"
_SCALARS = {  # kind: (first letters, pattern)
    "null": ("~nN\0", r"~|null|Null|NULL|"),
    "bool": ("tTfF", r"true|True|TRUE|false|False|FALSE"),
    "int": ("-+0123456789", r"[-+]?[0-9]+"),
    "float": (
        "-+.0123456789",
        r"[-+]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][-+]?[0-9]+)?|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN)",
    ),
    "merge": ("<", r"<<"),
}
# Replaces the resolvers of YAML 1.1, in which `no` is false and 12:30 is 750.
_Loader.yaml_implicit_resolvers = {}
for _kind, (_letters, _pattern) in _SCALARS.items():
    _first = [letter.replace("\0", "") for letter in _letters]
    _Loader.add_implicit_resolver(f"tag:yaml.org,2002:{_kind}", re.compile(rf"^(?:{_pattern})$"), _first)
# No tags beyond plain data: a file cannot construct Python objects.
_Loader.yaml_constructors = {
    "tag:yaml.org,2002:null": _Loader.construct_yaml_null,
    "tag:yaml.org,2002:bool": _Loader.construct_truth,
    "tag:yaml.org,2002:int": _Loader.construct_number,
    "tag:yaml.org,2002:float": _Loader.construct_number,
    "tag:yaml.org,2002:str": _Loader.construct_yaml_str,
    "tag:yaml.org,2002:seq": _Loader.construct_yaml_seq,
    "tag:yaml.org,2002:map": _Loader.construct_yaml_map,
    None: _Loader.construct_undefined,
}


class _FileFaultError(yaml.MarkedYAMLError):
    """Valid YAML that mirdrake does not accept."""


class _LineCollector:
    """Collector of the line of every key and list item, with aliases and merges expanded."""

    def __init__(self, lines: dict[Key, int]) -> None:
        self.lines = lines
        self.visited = 0
        self.open: set[int] = set()  # nodes that contain the present one

    def visit(self, node: yaml.Node, path: Key) -> None:
        """Collect the lines of a node and all nodes below it.

        Raises:
            _FileFaultError: repeated or complex keys, an alias inside itself, too many levels or values.
        """
        self.visited += 1
        # An anchor inside itself would be visited without end.
        if id(node) in self.open:
            raise _fault_at(node, f"{dotted(path)}: an alias is inside its own anchor")
        if len(path) > _MAX_DEPTH:
            raise _fault_at(node, _TOO_DEEP)
        if self.visited > _MAX_VALUES:
            raise _fault_at(node, f"more than {_MAX_VALUES} values (with aliases expanded)")
        self.open.add(id(node))
        # setdefault: own keys are visited before merged ones, and have priority.
        self.lines.setdefault(path, node.start_mark.line + 1)
        if isinstance(node, yaml.MappingNode):
            self._visit_mapping(node, path)
        elif isinstance(node, yaml.SequenceNode):
            for index, value in enumerate(node.value):
                self.visit(value, (*path, index))
        self.open.discard(id(node))

    def _visit_mapping(self, node: yaml.MappingNode, path: Key) -> None:
        own: set[str] = set()
        merged: list[yaml.Node] = []
        # Complex keys of YAML have no path that a message could name.
        for key, value in node.value:
            if not isinstance(key, yaml.ScalarNode):
                raise _fault_at(key, f"{dotted(path)}: a key must be a plain scalar".removeprefix(": "))
            here = (*path, key.value)
            if key.value in own:
                raise _fault_at(key, f"{dotted(here)}: repeated key; keep one of them")
            own.add(key.value)
            # A merge key is not a key of the file: its entries count where the mapping has none.
            if key.tag.endswith(":merge"):
                merged += value.value if isinstance(value, yaml.SequenceNode) else [value]
                continue
            self.lines.setdefault(here, key.start_mark.line + 1)
            self.visit(value, here)
        for mapping in merged:  # after the mapping's own keys, which have priority
            self.visit(mapping, path)


def _fault_at(node: yaml.Node, problem: str) -> _FileFaultError:
    return _FileFaultError(problem=problem, problem_mark=node.start_mark)


def in_file(location: Iterable[Hashable], source: Source) -> Key:
    """Return the part of an error location that is in the file or an override; tags of unions are not."""
    key = source.prefix
    for step in location:
        # Keys in a file are texts, steps of pydantic may be numbers.
        for candidate in ((*key, step), (*key, str(step))):
            if candidate in source.lines or candidate in source.overrides:
                key = candidate
                break
    return key[len(source.prefix) :]
