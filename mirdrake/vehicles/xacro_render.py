"""xacro into URDF text, in memory, with the source line of every element.

xacro itself forgets lines. The files are therefore parsed here: every element gets the attribute ``_at``, the index of
its place in a table. Elements of the expanded model keep theirs, which gives :class:`Urdf` its ``where``.
During an expansion the functions of the xacro module that parse and expand are wrapped; xacro keeps its state in
module globals anyway, hence the lock.
"""

import contextlib
import re
import threading
import xml.dom.minidom
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from unittest import mock
from xml.etree import ElementTree
from xml.parsers import expat

import xacro

from mirdrake.errors import ModelError, did_you_mean
from mirdrake.yaml_io import shown

Place = tuple[str, int]
_AT = "_at"
_USED = re.compile(r"\$\(arg\s+(\w+)\s*\)")
_LOCK = threading.Lock()


@dataclass(frozen=True)
class Urdf:
    """An expanded model.

    Attributes:
        text: URDF, without xacro tags.
        root: the same as a tree.
        places: (file, line in the source) of the element that starts on each line of `text`.
        files: every file that took part, main file first.
        warnings: what xacro had to say.
    """

    text: str
    root: ElementTree.Element
    places: Mapping[int, Place]
    lines: Mapping[ElementTree.Element, int]
    files: tuple[Path, ...]
    warnings: tuple[str, ...] = ()

    def where(self, element: ElementTree.Element) -> str:
        """``file:line`` of an element in its source."""
        return self.where_line(self.lines.get(element, 0))

    def where_line(self, line: int) -> str:
        """``file:line`` in the source of a line of the expanded text."""
        known = [number for number in self.places if number <= line]
        name, number = self.places[max(known)] if known else (shown(self.files[0]), 1)
        return f"{name}:{number}"


@dataclass
class _Expansion:
    """What is noted while xacro works."""

    given: frozenset[str] = frozenset()
    places: list[Place] = field(default_factory=list)
    arguments: dict[str, Place] = field(default_factory=dict)
    required: dict[str, Place] = field(default_factory=dict)
    used: dict[str, Place] = field(default_factory=dict)
    files: list[Path] = field(default_factory=list)
    cursor: int | None = None
    warnings: list[str] = field(default_factory=list)

    def missing(self) -> dict[str, Place]:
        """Arguments that have neither a value nor a default, declared or only used."""
        undeclared = {
            name: place for name, place in self.used.items() if name not in self.arguments and name not in self.given
        }
        return self.required | undeclared

    def where(self) -> str:
        name, line = self.places[self.cursor] if self.cursor is not None else (shown(self.files[0]), 1)
        return f"{name}:{line}"

    def note(self, node: Any) -> None:
        """Remember the element that xacro is at."""
        if node.hasAttribute(_AT):
            self.cursor = int(node.getAttribute(_AT))

    def parse(self, path: Path) -> xml.dom.minidom.Document:
        """One file as a DOM tree whose elements know their place."""
        name = shown(path)
        try:
            problem = "" if path.is_file() or not path.exists() else "is a folder" if path.is_dir() else "is no file"
            data = b"" if problem else path.read_bytes()  # reading a pipe or a device would never end
        except OSError as error:
            problem = (error.strerror or "cannot be read") if path.exists() else "no such file"
        if problem:
            at = f"{self.where()}: include: " if self.files else ""
            raise ModelError(f"{at}{name}: {problem}")
        self.files.append(path)
        lines: list[int] = []
        parser = expat.ParserCreate()
        parser.StartElementHandler = lambda *_: lines.append(parser.CurrentLineNumber)
        try:
            parser.Parse(data, True)
            document = xml.dom.minidom.parseString(data)
        except expat.ExpatError as error:
            what = expat.ErrorString(error.code)
            raise ModelError(f"{name}:{error.lineno}: not valid XML: {what}") from None
        for number, words in enumerate(data.decode("utf-8", errors="replace").splitlines(), start=1):
            for match in _USED.finditer(words):
                self.used.setdefault(match.group(1), (name, number))
        for node, line in zip(_elements(document.documentElement), lines, strict=True):
            node.setAttribute(_AT, str(len(self.places)))
            self.places.append((name, line))
            if node.tagName == "xacro:arg":
                self.arguments.setdefault(node.getAttribute("name"), (name, line))
                if not node.hasAttribute("default"):  # which xacro asks for, even of an argument that is given
                    if node.getAttribute("name") in self.given:
                        node.setAttribute("default", "")
                    else:
                        self.required.setdefault(node.getAttribute("name"), (name, line))
        return document


class MissingArgumentsError(ModelError):
    """Xacro arguments without value and without default.

    Attributes:
        arguments: name -> ``file:line``.
    """

    def __init__(self, arguments: Mapping[str, Place]) -> None:
        self.arguments = {name: f"{file}:{line}" for name, (file, line) in arguments.items()}
        first = next(iter(self.arguments.values()))
        names = ", ".join(f"{name} ({place})" for name, place in self.arguments.items())
        options = " ".join(f"--argument {name}=VALUE" for name in self.arguments)
        super().__init__(f"{first}: xacro arguments without value: {names}; give them with {options}")


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
    given = {name: str(value) for name, value in (arguments or {}).items()}
    note = _Expansion(frozenset({*given, *(defaults or {})}))
    with _LOCK, _wrapped_xacro(note, find):
        try:
            xacro.init_stacks(str(path))
            document = note.parse(path)
            xacro.process_doc(document, mappings=dict(defaults or {}) | given, verbosity=0)
        except xacro.XacroException as error:
            _check_arguments(given, note, where)
            cause = getattr(error, "exc", None)
            if isinstance(cause, ModelError):
                raise cause from None
            missing = note.missing()
            if missing and ("argument" in str(error) or "'default'" in str(error)):
                raise MissingArgumentsError(missing) from None
            raise ModelError(f"{note.where()}: {_one_line(error)}") from None
        except ModelError:
            raise
        except Exception as error:
            if note.required and "'default'" in str(error):
                raise MissingArgumentsError(note.required) from None
            raise ModelError(f"{note.where()}: xacro: {_one_line(error)}") from None
    _check_arguments(given, note, where)
    return _finish(document, note)


def _check_arguments(given: Mapping[str, str], note: _Expansion, where: str) -> None:
    for name in given:
        if name not in note.arguments and name not in note.used:
            prefix = f"{where}: " if where else f"{shown(note.files[0])}: "
            raise ModelError(f"{prefix}unknown argument '{_printable(name)}'; {did_you_mean(name, note.arguments)}")


def _finish(document: xml.dom.minidom.Document, note: _Expansion) -> Urdf:
    """Text, tree and line table of an expanded document."""
    places: list[Place] = []
    last: Place = (shown(note.files[0]), 1)
    root_node: Any = document.documentElement
    for node in _elements(root_node):
        if node.hasAttribute(_AT):
            last = note.places[int(node.getAttribute(_AT))]
            node.removeAttribute(_AT)
        if node.tagName.startswith("xacro:"):
            raise ModelError(f"{last[0]}:{last[1]}: '<{node.tagName}>' was not expanded: no such xacro tag or macro")
        places.append(last)
    _drop_space_and_comments(root_node)
    text: str = root_node.toprettyxml(indent="  ")
    starts: list[int] = []
    parser = expat.ParserCreate()
    parser.StartElementHandler = lambda *_: starts.append(parser.CurrentLineNumber)
    parser.Parse(text, True)
    root = ElementTree.fromstring(text)
    lines = dict(zip(root.iter(), starts, strict=True))
    return Urdf(text, root, dict(zip(starts, places, strict=True)), lines, tuple(note.files), tuple(note.warnings))


@contextlib.contextmanager
def _wrapped_xacro(note: _Expansion, find: Callable[[str], Path | None] | None) -> Iterator[None]:
    """Let xacro parse through `note`, tell it where it is, and print nothing."""
    check_attrs, handle_macro_call, eval_all = xacro.check_attrs, xacro.handle_macro_call, xacro.eval_all
    eval_extension = xacro.eval_extension

    def parse(source: Any, filename: Any = None) -> Any:
        return note.parse(Path(filename)) if source is None else source

    def noted_check_attrs(tag: Any, *rest: Any) -> Any:
        _take(tag)
        return check_attrs(tag, *rest)

    def noted_macro_call(node: Any, *rest: Any) -> Any:
        if node.tagName.startswith("xacro:"):
            _take(node)
        return handle_macro_call(node, *rest)

    def noted_eval_all(node: Any, *rest: Any) -> Any:
        note.note(node)
        return eval_all(node, *rest)

    def extension(text: str) -> Any:
        words = text.removeprefix("$(").removesuffix(")").split()
        if find is not None and words and words[0] in {"find", "find-pkg-share"} and len(words) == 2:
            folder = find(words[1])
            if folder is None:
                hint = f"give its folder with --package {words[1]}=DIR"
                raise ModelError(f"{note.where()}: package '{words[1]}' is not here; {hint}")
            return str(folder)
        if text.startswith("$(find "):
            raise xacro.XacroException(f"{text}: there are no ROS packages here; give a path relative to this file")
        return eval_extension(text)

    def _take(node: Any) -> None:
        note.note(node)
        if node.hasAttribute(_AT):
            node.removeAttribute(_AT)

    def warning(*texts: Any, **_: Any) -> None:
        note.warnings.append(f"{note.where()}: {' '.join(map(str, texts))}")

    with (
        mock.patch.object(xacro, "parse", parse),
        mock.patch.object(xacro, "check_attrs", noted_check_attrs),
        mock.patch.object(xacro, "handle_macro_call", noted_macro_call),
        mock.patch.object(xacro, "eval_all", noted_eval_all),
        mock.patch.object(xacro, "eval_extension", extension),
        mock.patch.object(xacro, "warning", warning),
    ):
        yield


def _elements(node: Any) -> Iterator[Any]:
    """An element and all below it, in document order."""
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
    parts = " ".join(str(error).split()).split(" when evaluating expression ")
    return _printable(" in ".join(parts[:2])) or type(error).__name__


def _printable(text: str) -> str:
    """The text with invisible characters spelt out."""
    return "".join(letter if letter.isprintable() else repr(letter)[1:-1] for letter in text)
