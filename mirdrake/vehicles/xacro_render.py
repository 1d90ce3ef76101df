"""xacro into URDF text, in memory, with the source line of every element.

xacro itself forgets lines. The files are therefore parsed here: every element gets the attribute ``_at``, the index of
its place in a table. Elements of the expanded model keep theirs, which gives :class:`Urdf` its ``where``.
During an expansion the functions of the xacro module that parse and expand are wrapped; xacro keeps its state in
module globals anyway, hence the lock.

A file from elsewhere may be hostile. Expressions are evaluated by :mod:`mirdrake.vehicles.xacro_expressions`, not by
Python; the number of elements, the amount of text, the depth of macros and the time have limits; YAML files are read
from the packages only, environment variables by :data:`VARIABLES` only. ``docs/security.md`` lists all of it.
"""

import contextlib
import glob
import os
import re
import sys
import threading
import time
import xml.dom.minidom
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple
from unittest import mock
from xml.etree import ElementTree
from xml.parsers import expat

import xacro
import yaml
from xacro.substitution_args import convert_value

from mirdrake.core.errors import ModelError, Place, did_you_mean, printable
from mirdrake.core.xml_reader import parse_xml
from mirdrake.core.yaml_io import display_path
from mirdrake.vehicles.expansions import Expansions
from mirdrake.vehicles.xacro_expressions import Evaluator
from mirdrake.vehicles.xacro_functions import LARGEST

_AT = "_at"
_USED = re.compile(r"\$\(arg\s+(\w+)\s*\)")
_LOCK = threading.Lock()

VARIABLES = frozenset({"ROS_DISTRO", "ROS_VERSION", "ROS_PYTHON_VERSION", "GAZEBO_VERSION", "GZ_VERSION"})
"""Environment variables that a file may read, besides those that :data:`MORE_VARIABLES` lists."""

MORE_VARIABLES = "MIRDRAKE_XACRO_ENV"
"""Environment variable with the names of further readable variables, separated by commas."""

ELEMENTS = 20_000
"""Elements that an expansion evaluates."""

TEXT = 20_000_000
"""Characters that an expansion evaluates."""

MACROS = 300
"""Largest depth of nested macro calls."""

SECONDS = 1.5
"""Processor time of an expansion with all its expressions [s]."""

FILE_SIZE, YAML_SIZE = 20_000_000, 300_000
"""Bytes of an XML file, and of a YAML file."""

VALUES, NESTED = 20_000, 50
"""Largest number of values of a YAML file, and largest depth of nesting."""

LONGEST_MESSAGE = 400
"""Characters of xacro's part of a message."""

_PACKAGE_FOLDERS = {"urdf", "xacro", "robots", "robot", "description", "models", "model", "launch", "config", "params"}


class Warned(NamedTuple):
    """A warning of an expansion, with its place as ``file:line``."""

    where: str
    text: str

    def __str__(self) -> str:
        return f"{self.where}: {self.text}"


@dataclass(frozen=True)
class Urdf:
    """An expanded model.

    Attributes:
        text: URDF, without xacro tags.
        root: the same as a tree.
        places: place in the source of the element that starts on each line of `text`.
        files: every file that took part, main file first.
        warnings: those of xacro.
    """

    text: str
    root: ElementTree.Element
    places: Mapping[int, Place]
    lines: Mapping[ElementTree.Element, int]
    files: tuple[Path, ...]
    warnings: tuple[Warned, ...] = ()

    def where(self, element: ElementTree.Element, *path: str) -> Place:
        """Return ``file:line`` of an element in its source, with a name of the element if it is given."""
        place = self.where_line(self.lines.get(element, 0))
        return Place(place.file, place.line, path)

    def where_line(self, line: int) -> Place:
        """Return ``file:line`` in the source of a line of the expanded text."""
        known = [number for number in self.places if number <= line]
        return self.places[max(known)] if known else Place(display_path(self.files[0]), 1)


@dataclass
class _Expansion:
    """State of an expansion: places, arguments, files and their contents, warnings, limits, texts of YAML files."""

    given: frozenset[str] = frozenset()
    places: list[Place] = field(default_factory=list)
    arguments: dict[str, Place] = field(default_factory=dict)
    required: dict[str, Place] = field(default_factory=dict)
    used: dict[str, Place] = field(default_factory=dict)
    files: list[Path] = field(default_factory=list)
    cursor: int | None = None
    warnings: list[Warned] = field(default_factory=list)
    find: Callable[[str], Path | None] | None = None
    packages: list[Path] = field(default_factory=list)
    began: float = field(default_factory=time.thread_time)
    elements: int = 0
    characters: int = 0
    texts: dict[str, tuple[str, int, tuple[str, ...]]] = field(default_factory=dict)
    contents: dict[Path, bytes] = field(default_factory=dict)
    depends_on_files_only: bool = True

    def tick(self) -> None:
        """Raise an error when the time of the expansion is over."""
        # Processor time of this thread: a busy machine must not reject a valid file.
        if time.thread_time() - self.began > SECONDS:
            raise ModelError(f"the expansion takes more than {SECONDS:g} s of processor time", where=self.where())

    def count(self, *, elements: int = 0, characters: int = 0) -> None:
        """Raise an error when the expansion gets too large."""
        self.tick()
        self.elements, self.characters = self.elements + elements, self.characters + characters
        if self.elements > ELEMENTS:
            raise ModelError(
                f"more than {ELEMENTS} elements; does a macro call itself without an end?", where=self.where()
            )
        if self.characters > TEXT or characters > LARGEST:
            raise ModelError(
                f"too much text: a value of {LARGEST} characters, {TEXT} in all are allowed", where=self.where()
            )

    def missing(self) -> dict[str, Place]:
        """Return arguments with neither a value nor a default, declared or only used."""
        undeclared = {
            name: location
            for name, location in self.used.items()
            if name not in self.arguments and name not in self.given
        }
        return self.required | undeclared

    def where(self) -> Place:
        return self.places[self.cursor] if self.cursor is not None else Place(display_path(self.files[0]), 1)

    def note(self, node: Any) -> None:
        """Remember the element that xacro is at."""
        if node.hasAttribute(_AT):
            self.cursor = int(node.getAttribute(_AT))

    def parse(self, path: Path) -> xml.dom.minidom.Document:
        """Return a file as a DOM tree whose elements have the attribute of their place."""
        name = display_path(path)
        try:
            problem = "" if path.is_file() or not path.exists() else "is a folder" if path.is_dir() else "is not a file"
            if not problem and path.stat().st_size > FILE_SIZE:
                problem = f"has more than {FILE_SIZE} bytes"
            data = b"" if problem else path.read_bytes()  # reading a pipe or a device would never end
        except OSError as error:
            problem = (error.strerror or "cannot be read") if path.exists() else "no such file"
        if problem:
            prefix = f"{self.where()}: include: " if self.files else ""
            raise ModelError(problem, where=f"{prefix}{name}")

        # The own parser knows the line of each element; minidom gives the tree that xacro needs.
        self.files.append(path)
        self.contents[path] = data
        lines = parse_xml(data, name, error=ModelError).lines.values()
        try:
            document = xml.dom.minidom.parseString(data)
        except expat.ExpatError as error:  # undeclared name space prefixes
            raise ModelError(f"not valid XML: {expat.ErrorString(error.code)}", file=name, line=error.lineno) from None
        # Arguments are found in the text, since xacro reports the first missing one only.
        for number, words in enumerate(data.decode("utf-8", errors="replace").splitlines(), start=1):
            for match in _USED.finditer(words):
                self.used.setdefault(match.group(1), Place(name, number))
        # minidom has no lines: each element gets the number of its place as an attribute, which xacro copies.
        for node, line in zip(_elements(document.documentElement), lines, strict=True):
            node.setAttribute(_AT, str(len(self.places)))
            place = Place(name, line)
            self.places.append(place)
            if node.tagName == "xacro:arg":
                self.arguments.setdefault(node.getAttribute("name"), place)
                if not node.hasAttribute("default"):  # which xacro asks for, even of an argument that is given
                    if node.getAttribute("name") in self.given:
                        node.setAttribute("default", "")
                    else:
                        self.required.setdefault(node.getAttribute("name"), place)
        return document

    def read_yaml(self, filename: str) -> Any:
        """Read a YAML file of the packages, for ``xacro.load_yaml``.

        Raises:
            XacroException: it is outside of them, too large or not valid.
        """
        path = Path(xacro.abs_filename_spec(str(filename)))
        # a file that is a link belongs to the package of the link and to that of its target
        roots = {_package_of(path) for file in self.files for path in (file, file.resolve())} | set(self.packages)
        resolved = path.resolve()
        if not any(resolved.is_relative_to(root) for root in roots):
            raise xacro.XacroException(
                f"load_yaml: {display_path(path)} is outside of the vehicle's package {display_path(min(roots))}"
            )
        if not resolved.is_file():
            raise xacro.XacroException(f"load_yaml: {display_path(path)}: no such file")
        if resolved.stat().st_size > YAML_SIZE:
            raise xacro.XacroException(f"load_yaml: {display_path(path)} has more than {YAML_SIZE} bytes")
        # Units such as !degrees are tags of xacro; a file is limited before any value is constructed.
        for unit in xacro.ConstructUnits:
            _Yaml.add_constructor(unit.value.tag, unit.constructor)
        xacro.filestack.append(str(path))
        try:
            self.contents[resolved] = resolved.read_bytes()
            text = self.contents[resolved].decode("utf-8")
            # Events come before any tree exists, so a hostile file takes little memory; aliases are counted afterwards.
            depth = 0
            for number, event in enumerate(yaml.parse(text, Loader=_Yaml)):
                depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
                if number > VALUES or depth > NESTED:
                    limits = f"{VALUES} values, {NESTED} within one another"
                    raise xacro.XacroException(f"load_yaml: {display_path(path)}: too large; allowed are {limits}")
            node = yaml.compose(text, Loader=_Yaml)
            if _expanded_size(node, {}) > LARGEST:
                raise xacro.XacroException(
                    f"load_yaml: {display_path(path)}: more than {LARGEST} values, aliases expanded"
                )
            if node is not None:
                self._note_texts(node, display_path(path), (), set())
            loader = _Yaml("")
            return xacro.YamlListWrapper.wrap(None if node is None else loader.construct_document(node))
        except (yaml.YAMLError, ValueError, TypeError) as error:
            raise xacro.XacroException(f"load_yaml: {display_path(path)}: {_one_line(error)}") from None
        finally:
            xacro.filestack.pop()

    def origin(self, text: str) -> str:
        """Return the place of a text of a YAML file as the tail of a message; "" if it comes from elsewhere."""
        if text not in self.texts:
            return ""
        name, line, keys = self.texts[text]
        return f" ({name}:{line}: {'.'.join(keys)})"

    def _note_texts(self, node: yaml.Node, name: str, keys: tuple[str, ...], seen: set[int]) -> None:
        """Remember the place of each text of a YAML document, for errors of expressions that need a number."""
        if id(node) in seen:
            return
        seen.add(id(node))
        if isinstance(node, yaml.ScalarNode) and node.tag == "tag:yaml.org,2002:str":
            self.texts.setdefault(node.value, (name, node.start_mark.line + 1, keys))
        elif isinstance(node, yaml.MappingNode):
            for key, value in node.value:
                step = str(key.value) if isinstance(key, yaml.ScalarNode) else "?"
                self._note_texts(value, name, (*keys, step), seen)
        elif isinstance(node, yaml.SequenceNode):
            for index, value in enumerate(node.value):
                self._note_texts(value, name, (*keys, str(index)), seen)

    def found(self, package: str) -> str:
        """Return the folder of a package, for ``$(find package)``."""
        self.depends_on_files_only = False
        folder = self.find(package) if self.find is not None else None
        if folder is None and self.find is not None:
            hint = f"give its folder with --package {package}=DIR"
            raise ModelError(f"package '{package}' is not found; {hint}", where=self.where())
        if folder is None:
            text = f"$(find {package}): ROS packages are not available; give a path relative to this file"
            raise xacro.XacroException(text)
        self.packages.append(folder.resolve())
        return str(folder)

    def variable(self, name: str, default: str | None = None) -> str:
        """Return an environment variable, for ``$(env)`` and ``$(optenv)``.

        Raises:
            XacroException: the variable is not set or may not be read, and has no default.
        """
        self.depends_on_files_only = False
        allowed = VARIABLES | {name_of.strip() for name_of in os.environ.get(MORE_VARIABLES, "").split(",")}
        if name in allowed and name in os.environ:
            return os.environ[name]
        reason = "is not set" if name in allowed else f"is not read; allow it with {MORE_VARIABLES}={name}"
        # A default replaces a variable that may not be read, with a warning if it is set.
        if default is None:
            raise xacro.XacroException(f"environment variable '{printable(name)}' {reason}")
        if name not in allowed and name in os.environ:
            self.warnings.append(Warned(self.where(), f"environment variable '{printable(name)}' {reason}"))
        return default


class _Yaml(yaml.SafeLoader):
    """YAML with the units of xacro, such as ``!degrees 90``."""


def _expanded_size(node: Any, known: dict[int, int]) -> int:
    """Return the number of values of a YAML document with its aliases written out.

    Raises:
        XacroException: a value contains itself.
    """
    if node is None or isinstance(node, yaml.ScalarNode):
        return 1
    if id(node) in known:
        if known[id(node)] == 0:
            raise xacro.XacroException("load_yaml: a value contains itself")
        return known[id(node)]
    # Zero marks a node that is being counted: meeting it again means a cycle.
    known[id(node)] = 0
    pairs = isinstance(node, yaml.MappingNode)
    parts = [part for pair in node.value for part in pair] if pairs else node.value
    known[id(node)] = 1 + sum(_expanded_size(part, known) for part in parts)
    return known[id(node)]


def _package_of(file: Path) -> Path:
    """Return the package folder of a file; without ``package.xml`` the file's folder, or the one above ``urdf``."""
    folder = Path(os.path.abspath(file)).parent.resolve()
    for above in (folder, *folder.parents):
        if (above / "package.xml").is_file():
            return above
    return folder.parent if folder.name in _PACKAGE_FOLDERS else folder


class MissingArgumentsError(ModelError):
    """Xacro arguments without value and without default.

    Attributes:
        arguments: name -> ``file:line``.
    """

    def __init__(self, arguments: Mapping[str, Place]) -> None:
        self.arguments = dict(arguments)
        first = next(iter(self.arguments.values()))
        # The place of the first argument is at the beginning.
        names = ", ".join(name + (f" ({place})" if place != first else "") for name, place in self.arguments.items())
        options = " ".join(f"--argument {name}=VALUE" for name in self.arguments)
        super().__init__(f"xacro arguments without value: {names}; give them with {options}", where=first)


def render_xacro(
    path: Path,
    *,
    arguments: Mapping[str, str] | None = None,
    defaults: Mapping[str, str] | None = None,
    where: str = "",
    find: Callable[[str], Path | None] | None = None,
) -> Urdf:
    """Expand a xacro file.

    Args:
        path: the main file.
        arguments: values of its ``<xacro:arg>``.
        defaults: more values, for those arguments that the files know.
        where: prefix of errors about `arguments`, for example ``"drive.yaml:4: vehicles.ego.arguments"``.
        find: folder of a package, for ``$(find name)``; None for one that it does not know. Without it there are no
            packages.

    Raises:
        MissingArgumentsError: arguments have neither a value nor a default.
        ModelError: XML or xacro errors, unknown arguments, or xacro tags that were not expanded.
    """
    # xacro substitutes text, so that numbers of the caller become text first.
    given = {name: str(value) for name, value in (arguments or {}).items()}
    others = dict(defaults or {})

    def expand() -> tuple[Urdf, Mapping[Path, bytes] | None]:
        note = _Expansion(frozenset({*given, *others}), find=find)
        urdf = _expand(path, given, others, where, note)
        return urdf, note.contents if note.depends_on_files_only else None

    return _EXPANSIONS.get((str(path), *map(frozenset, (given.items(), others.items()))), expand)


_EXPANSIONS: Expansions[Urdf] = Expansions()


def _expand(path: Path, given: Mapping[str, str], defaults: Mapping[str, str], where: str, note: _Expansion) -> Urdf:
    """Expand a xacro file; arguments as of :func:`render_xacro`, values as texts."""
    with _LOCK, _wrapped_xacro(note):
        try:
            xacro.init_stacks(str(path))
            document = note.parse(path)
            xacro.process_doc(document, mappings=dict(defaults) | dict(given), verbosity=0)
        except xacro.XacroException as error:
            # An unknown argument may be the cause of xacro's error, so it is reported first.
            _check_arguments(given, note, where)
            cause: Any = error
            while isinstance(cause, xacro.XacroException):  # each property that is evaluated adds one
                cause = cause.exc
            if isinstance(cause, ModelError):
                raise cause from None
            # xacro stops at the first missing argument; report all of them at once.
            missing = note.missing()
            if missing and ("argument" in str(error) or "'default'" in str(error)):
                raise MissingArgumentsError(missing) from None
            raise ModelError(_one_line(error), where=note.where()) from None
        except ModelError:
            raise
        except Exception as error:
            # Python errors of expressions reach this point without the position, which the note has.
            if note.required and "'default'" in str(error):
                raise MissingArgumentsError(note.required) from None
            raise ModelError(f"xacro: {_one_line(error)}", where=note.where()) from None
    _check_arguments(given, note, where)
    return _finish(document, note)


def _check_arguments(given: Mapping[str, str], note: _Expansion, where: str) -> None:
    for name in given:
        if name not in note.arguments and name not in note.used:
            raise ModelError(
                f"unknown argument '{printable(name)}'; {did_you_mean(name, note.arguments)}",
                where=where or display_path(note.files[0]),
            )


def _finish(document: xml.dom.minidom.Document, note: _Expansion) -> Urdf:
    """Return text, tree and line table of an expanded document."""
    places: list[Place] = []
    last = Place(display_path(note.files[0]), 1)
    root_node: Any = document.documentElement
    for node in _elements(root_node):
        if node.hasAttribute(_AT):
            last = note.places[int(node.getAttribute(_AT))]
            node.removeAttribute(_AT)
        if node.tagName.startswith("xacro:"):
            raise ModelError(f"'<{node.tagName}>' was not expanded: no such xacro tag or macro", where=last)
        places.append(last)
    _drop_space_and_comments(root_node)
    text: str = root_node.toprettyxml(indent="  ")
    # The pretty-printed text is parsed again: its elements come in the same order as those of the tree.
    starts = list(parse_xml(text, display_path(note.files[0]), error=ModelError).lines.values())
    root = ElementTree.fromstring(text)
    lines = dict(zip(root.iter(), starts, strict=True))
    return Urdf(text, root, dict(zip(starts, places, strict=True)), lines, tuple(note.files), tuple(note.warnings))


@contextlib.contextmanager
def _wrapped_xacro(note: _Expansion) -> Iterator[None]:
    """Make xacro parse and evaluate through `note`, with its position, without printing."""
    # Originals first: the wrappers call them.
    check_attrs, handle_macro_call, eval_all = xacro.check_attrs, xacro.handle_macro_call, xacro.eval_all
    eval_extension, eval_text = xacro.eval_extension, xacro.eval_text
    arguments = xacro.substitution_args_context
    evaluator = Evaluator(
        load_yaml=note.read_yaml,
        abs_filename=xacro.abs_filename_spec,
        argument=lambda name: arguments["arg"][name],
        warn=lambda text: note.warnings.append(Warned(note.where(), text)),
        tick=note.tick,
        origin=note.origin,
    )

    # xacro has no hooks: its functions are replaced by ones that note the position and count before they call it.
    def parse(source: Any, filename: Any = None) -> Any:
        return note.parse(Path(filename)) if source is None else source

    def noted_check_attrs(tag: Any, *rest: Any) -> Any:
        _take(tag)
        return check_attrs(tag, *rest)

    def noted_macro_call(node: Any, *rest: Any) -> Any:
        if node.tagName.startswith("xacro:"):
            _take(node)
        if len(xacro.macrostack) > MACROS:
            raise ModelError(f"more than {MACROS} macros within one another; does one call itself?", where=note.where())
        return handle_macro_call(node, *rest)

    def noted_eval_all(node: Any, *rest: Any) -> Any:
        note.note(node)
        note.count(elements=1)
        return eval_all(node, *rest)

    def noted_eval_text(text: Any, symbols: Any) -> Any:
        value = eval_text(text, symbols)
        note.count(characters=len(value) if isinstance(value, str) else 0)
        return value

    def evaluate(text: str, symbols: Any, _: Any = None) -> Any:
        return evaluator.evaluate(text, symbols)

    def argument(name: str) -> Any:
        return convert_value(str(arguments["arg"][name]), "auto")

    def extension(text: str) -> Any:
        # Substitutions that read files or the environment are evaluated here, harmless ones by xacro.
        inside = text.removeprefix("$(").removesuffix(")")
        words = inside.split()
        if inside.startswith("eval "):
            # Xacro's own functions read the environment and files without a record; these note what the result depends
            # on.
            functions: dict[str, object] = {"arg": argument, "env": note.variable, "find": note.found, "true": True}
            functions |= {"optenv": lambda name, default="": note.variable(name, default), "false": False}
            functions |= {"dirname": lambda: str(Path(xacro.abs_filename_spec("")).resolve())}
            values = {name: argument(name) for name in arguments["arg"]}
            return str(evaluator.evaluate(inside[5:], {}, names=values | functions))
        if words and words[0] in {"find", "find-pkg-share"} and len(words) == 2:
            return note.found(words[1])
        if words and words[0] == "env" and len(words) == 2:
            return note.variable(words[1])
        if words and words[0] == "optenv" and len(words) > 1:
            return note.variable(words[1], " ".join(words[2:]))
        if words and words[0] not in {"arg", "cwd", "dirname"}:
            raise xacro.XacroException(
                f"{text}: unknown substitution; there are arg, cwd, dirname, env, eval, find, optenv"
            )
        return eval_extension(text)

    def matching(pattern: str) -> list[str]:
        note.depends_on_files_only = False
        return glob.glob(pattern)

    # xacro would reject the attribute in its own tags, and take it as a parameter of a macro.
    def _take(node: Any) -> None:
        note.note(node)
        if node.hasAttribute(_AT):
            node.removeAttribute(_AT)

    def warning(*texts: Any, **_: Any) -> None:
        note.warnings.append(Warned(note.where(), " ".join(map(str, texts))))

    # All replacements are undone together, also after an error, because xacro is shared by the whole process.
    limit = sys.getrecursionlimit()
    sys.setrecursionlimit(max(limit, 20 * MACROS))  # a macro within a macro takes some ten calls
    with (
        mock.patch.object(xacro, "parse", parse),
        mock.patch.object(xacro, "glob", SimpleNamespace(glob=matching)),
        mock.patch.object(xacro, "check_attrs", noted_check_attrs),
        mock.patch.object(xacro, "handle_macro_call", noted_macro_call),
        mock.patch.object(xacro, "eval_all", noted_eval_all),
        mock.patch.object(xacro, "eval_extension", extension),
        mock.patch.object(xacro, "warning", warning),
        mock.patch.object(xacro, "eval_text", noted_eval_text),
        mock.patch.object(xacro, "safe_eval", evaluate),
    ):
        try:
            yield
        finally:
            sys.setrecursionlimit(limit)


def _elements(node: Any) -> Iterator[Any]:
    """Yield an element and all below it, in document order."""
    yield node
    for child in node.childNodes:
        if child.nodeType == child.ELEMENT_NODE:
            yield from _elements(child)


def _drop_space_and_comments(node: Any) -> None:
    for child in list(node.childNodes):
        if child.nodeType == child.ELEMENT_NODE:
            _drop_space_and_comments(child)
        elif child.nodeType == child.COMMENT_NODE or not child.data.strip():
            node.removeChild(child)


def _one_line(error: Exception) -> str:
    # Python writes functions with their address in memory, which is different in each run.
    parts = re.sub(r" at 0x[0-9a-f]+", "", " ".join(str(error).split())).split(" when evaluating expression ")
    text = printable(" in ".join(parts[:2])) or type(error).__name__
    return text if len(text) <= LONGEST_MESSAGE else f"{text[:LONGEST_MESSAGE]} …"
