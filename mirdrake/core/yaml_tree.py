"""YAML text into plain data, with the line of every key.

:func:`parse_tree` is the only door. It understands a safe part of YAML 1.2: mappings with text keys, lists, texts,
numbers, true, false and null, with anchors, aliases and ``<<`` merges, but no other tags. What pydantic makes of
the data is in :mod:`mirdrake.core.yaml_io`.
"""

import re
from collections.abc import Hashable, Iterable, Mapping
from typing import Any, NamedTuple

import yaml

from mirdrake.core.errors import ConfigError, FaultCode, dotted

Key = tuple[Hashable, ...]


class Source(NamedTuple):
    """Where a model came from: a file, the line of every key path in it, the overrides, and its own place in them."""

    name: str
    lines: Mapping[Key, int]
    prefix: Key = ()
    overrides: Mapping[Key, str] = {}  # key path -> the command line's "--set KEY=VALUE"

    def where(self, *path: Hashable) -> str:
        """``file:line: dotted.path`` of a key below this place, or the line of its nearest parent in the file."""
        full = (*self.prefix, *path)
        place = self.place(*path)
        return f"{place}: {dotted(full)}" if full else place

    def place(self, *path: Hashable) -> str:
        """Return ``file:line`` of a key below the prefix, or of its nearest parent in the file."""
        file, line = self.location(*path)
        return file if line is None else f"{file}:{line}"

    def location(self, *path: Hashable) -> tuple[str, int | None]:
        """Return file and line of a key below the prefix, or of its nearest parent; an override has no line."""
        full = (*self.prefix, *path)
        top = self._replace(prefix=())
        for length in range(len(full), -1, -1):
            key = in_file(full[:length], top)
            if len(key) == length:
                break
        override = self.overrides.get(key)
        return (override, None) if override else (self.name, self.lines.get(key))

    def error(self, text: str, *path: Hashable, code: FaultCode = "") -> ConfigError:
        """Return the error that a key below the prefix is wrong."""
        file, line = self.location(*path)
        return ConfigError(text, file=file, line=line, path=(*self.prefix, *path), code=code)


def lay_over(data: Any, source: Source, over: Any, over_source: Source) -> tuple[Any, Source]:
    """A tree with a partial tree laid over it.

    Mappings merge key by key unless their kinds differ; anything else is replaced. Of a mapping over which another
    preset is laid, only what :func:`below_preset` keeps remains.

    Args:
        data: the tree below, not changed.
        source: its places.
        over: the partial tree.
        over_source: its places; its prefix is the place of `over` in its file.

    Returns:
        the merged tree, and a source that finds every key where it was written last.
    """
    lines, places = dict(source.lines), dict(source.overrides)

    def merge(below: Any, above: Any, path: Key) -> Any:
        if path:
            places[path] = over_source.place(*path)
        if (
            isinstance(below, dict)
            and isinstance(above, dict)
            and below.get("kind") == above.get("kind", below.get("kind"))
        ):
            kept = below_preset(below, above)
            for key in [key for key in lines if key[: len(path)] == path and key[len(path) : len(path) + 1]]:
                if key[len(path)] in below and key[len(path)] not in kept:
                    del lines[key]
            below = kept
            return {**below, **{key: merge(below.get(key), value, (*path, key)) for key, value in above.items()}}
        for key in [key for key in lines if key[: len(path)] == path and len(key) > len(path)]:
            del lines[key]
        if isinstance(above, dict):
            return {key: merge(None, value, (*path, key)) for key, value in above.items()}
        return above

    return merge(data, over, ()), source._replace(lines=lines, overrides=places)


def below_preset(below: dict[Any, Any], above: Mapping[Any, Any]) -> dict[Any, Any]:
    """Return what remains of a mapping when another is merged over it.

    All of it, unless the one above names a preset: its numbers are those of the product, so those of the former product
    and those written over these must not remain. What belongs to the place (:data:`_PLACE`) does.
    """
    return {key: value for key, value in below.items() if key in _PLACE} if "preset" in above else below


_PLACE = {"frame", "datum"}  # where a sensor is mounted, and where on the Earth the world is


def parse_tree(text: str, name: str) -> tuple[Any, Source]:
    """A YAML text as plain Python data, with the line of every key; an empty text is an empty mapping.

    Raises:
        ConfigError: not YAML, a key is repeated, or the text means too much data.
    """
    lines: dict[Key, int] = {}
    try:
        loader = _Loader(text)
        node = loader.get_single_node()
        if node is None:
            return {}, Source(name, lines)
        _LineCollector(lines).visit(node, ())
        return loader.construct_document(node), Source(name, lines)
    except yaml.MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else 1
        raise ConfigError(_yaml_problem(error), file=name, line=line, code="not_yaml") from None
    except yaml.reader.ReaderError as error:
        line = text.count("\n", 0, error.position) + 1
        code = error.character if isinstance(error.character, int) else ord(str(error.character))
        text = f"not valid YAML: character {code:#x} is not allowed"
        raise ConfigError(text, file=name, line=line, code="not_yaml") from None
    except (ValueError, OverflowError):  # PyYAML lets a few out: "\UFFFFFFFF", %YAML 9999…
        text = "not valid YAML: a code or version out of range"
        raise ConfigError(text, file=name, line=loader.line + 1, code="not_yaml") from None


def _yaml_problem(error: yaml.MarkedYAMLError) -> str:
    """What is wrong, in one line, from PyYAML's two half sentences."""
    context, problem = error.context or "", error.problem or "unreadable"
    if "duplicate anchor" in context:
        problem = context.removeprefix("found ").partition(";")[0] + "; give each anchor its own name"
    elif "single document" in context:
        problem = "more than one document; remove the line '---'"
    elif "'\\t'" in problem:
        problem = "a tab stands here; indent with spaces"
    elif "could not determine a constructor" in problem:
        problem = problem.replace("could not determine a constructor for the tag", "unknown tag")
    elif isinstance(error, _FileFaultError):
        return problem
    return f"not valid YAML: {problem}"


# --- the inner parts --------------------------------------------------------------------------------------------------


_MAX_DEPTH = 60  # levels; also keeps Python's stack safe
_MAX_VALUES = 200_000  # keys and list items with aliases written out: a small file can mean billions


class _Loader(yaml.SafeLoader):
    """Plain data only, YAML 1.2 scalars: no on/off/yes/no, no base-60 numbers, 1e-3 is a number, keys are text."""

    depth = 0

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        """The next node; nesting too deep is an error with a line instead of a stack overflow."""
        self.depth += 1
        if self.depth > _MAX_DEPTH:
            raise _FileFaultError(problem=_TOO_DEEP, problem_mark=self.get_mark())
        node = super().compose_node(parent, index)
        self.depth -= 1
        return node

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        """A dict whose keys are the texts as written; ``<<`` merges first."""
        if not isinstance(node, yaml.MappingNode):
            raise _FileFaultError(problem="a mapping is expected", problem_mark=node.start_mark)
        self.flatten_mapping(node)
        return {key.value: self.construct_object(value, deep=deep) for key, value in node.value}

    def construct_number(self, node: yaml.ScalarNode) -> int | float:
        """An int if the text is one, else a float."""
        text = str(self.construct_scalar(node))
        try:
            if node.tag.endswith(":int"):
                number = int(text)
                float(number)  # a longer one could not be computed with
                return number
            return float(text.lower().replace(".inf", "inf").replace(".nan", "nan"))
        except (ValueError, OverflowError):
            raise _FileFaultError(problem="not a number, or too long", problem_mark=node.start_mark) from None

    def construct_truth(self, node: yaml.ScalarNode) -> bool:
        """True unless the text is false."""
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
_Loader.yaml_implicit_resolvers = {}
for _kind, (_letters, _pattern) in _SCALARS.items():
    _first = [letter.replace("\0", "") for letter in _letters]
    _Loader.add_implicit_resolver(f"tag:yaml.org,2002:{_kind}", re.compile(rf"^(?:{_pattern})$"), _first)
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
    """Valid YAML that a file of ours may not hold."""


class _LineCollector:
    """Fills `lines` with the line of every key and list item, aliases and merges written out."""

    def __init__(self, lines: dict[Key, int]) -> None:
        self.lines = lines
        self.visited = 0
        self.open: set[int] = set()  # nodes we are inside of

    def visit(self, node: yaml.Node, path: Key) -> None:
        """Take in a node and all below it.

        Raises:
            _FileFaultError: repeated or odd keys, an alias inside itself, too deep or too much.
        """
        self.visited += 1
        if id(node) in self.open:
            raise _fault_at(node, f"{dotted(path)}: an alias stands inside what it repeats")
        if len(path) > _MAX_DEPTH:
            raise _fault_at(node, _TOO_DEEP)
        if self.visited > _MAX_VALUES:
            raise _fault_at(node, f"more than {_MAX_VALUES} values (aliases written out)")
        self.open.add(id(node))
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
        for key, value in node.value:
            if not isinstance(key, yaml.ScalarNode):
                raise _fault_at(key, f"{dotted(path)}: a key must be a plain word".removeprefix(": "))
            here = (*path, key.value)
            if key.value in own:
                raise _fault_at(key, f"{dotted(here)}: repeated key; keep one of them")
            own.add(key.value)
            if key.tag.endswith(":merge"):
                merged += value.value if isinstance(value, yaml.SequenceNode) else [value]
                continue
            self.lines.setdefault(here, key.start_mark.line + 1)
            self.visit(value, here)
        for mapping in merged:  # after the own keys, which win
            self.visit(mapping, path)


def _fault_at(node: yaml.Node, problem: str) -> _FileFaultError:
    return _FileFaultError(problem=problem, problem_mark=node.start_mark)


def in_file(location: Iterable[Hashable], source: Source) -> Key:
    """The part of an error location below a source that stands in the file or an override (union tags do not)."""
    key = source.prefix
    for step in location:
        for candidate in ((*key, step), (*key, str(step))):
            if candidate in source.lines or candidate in source.overrides:
                key = candidate
                break
    return key[len(source.prefix) :]
