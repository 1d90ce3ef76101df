"""XML as a tree whose elements know their line, and numbers read from it with errors that name it."""

import math
import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree
from xml.parsers import expat

import numpy as np
from pydrake.math import RigidTransform, RollPitchYaw

from mirdrake.core.errors import ModelError
from mirdrake.core.yaml_io import shown
from mirdrake.importing.vehicles.model import Vector

LARGEST = 50_000_000
"""Largest size of an XML file [bytes]."""

_TOKEN = re.compile(  # a comment, declaration or CDATA that does not end takes the rest, so that the time is linear
    r"<!--.*?(?:-->|\Z)|<\?.*?(?:\?>|\Z)|<!\[CDATA\[.*?(?:\]\]>|\Z)|<![A-Za-z][^<>]*>"
    r"|<(?P<tag>/?[^\s<>/\"'=!?]+)(?P<inside>(?:[^<>\"']++|\"[^\"]*+\"|'[^']*+')*+)>"
    r"|[^<]+|<",
    re.DOTALL,
)
_VALUE = re.compile(r"\"[^\"]*+\"|'[^']*+'")
_AMPERSAND = re.compile(r"&(?!(?:lt|gt|amp|quot|apos|#[0-9]{1,7}|#x[0-9A-Fa-f]{1,6});)")
_CONTROL = re.compile(
    r"[\x00-\x08\x0b\x0c\x0e-\x1f\ufffe\uffff]|&#(?:0*(?:[0-8]|1[0-9]|2[0-9]|3[01])|x0*1?[0-9A-Fa-f]);"
)


def parse_xml(path: Path) -> tuple[ElementTree.Element, dict[ElementTree.Element, str]]:
    """A file as a tree, and ``file:line`` of every element.

    What Gazebo's parser (tinyxml2) accepts although the XML standard forbids it is accepted, too: see :func:`_strict`.

    Raises:
        ModelError: it cannot be read, is not XML, or declares entities, which could grow without bounds.
    """
    name = shown(path)
    try:
        if path.stat().st_size > LARGEST:
            raise ModelError(f"{name}: more than {LARGEST // 1_000_000} MB of XML; split the file")
        data = path.read_bytes()
    except OSError as error:
        raise ModelError(f"{name}: {error.strerror or error}") from None
    before, mark, _ = data.replace(b"\0", b"").partition(b"<!ENTITY")
    if mark:
        line = before.count(b"\n") + 1
        raise ModelError(f"{name}:{line}: declares an XML entity; write out what it stands for")
    try:
        return _parse(data, name)
    except ModelError:
        return _parse(_strict(data), name)


def _strict(data: bytes) -> bytes:
    """The same document as XML that the standard allows, line by line.

    tinyxml2 accepts, and files of Gazebo have: ``--`` within comments, anything before the declaration or a second
    declaration, encodings that are wrong or unknown, ``&`` that begins no entity, ``<`` within attributes, control
    characters, and attributes without space between them.
    """
    text = data.removeprefix(b"\xef\xbb\xbf").decode("utf-8", errors="replace")

    def clean(words: str) -> str:
        return _CONTROL.sub(" ", _AMPERSAND.sub("&amp;", words)).replace("]]>", "]]&gt;")

    def value(match: re.Match[str]) -> str:
        return f" {clean(match[0]).replace('<', '&lt;')} "

    def token(match: re.Match[str]) -> str:
        words = match[0]
        if match["tag"] is not None:
            empty = match["inside"].endswith("/")
            inside = match["inside"].removesuffix("/")
            inside = _VALUE.sub(value, re.sub(r"=\s*", "=", inside))
            return f"<{match['tag']}{inside.replace('= ', '=')}{'/' if empty else ''}>"
        if words.startswith("<![CDATA["):
            return _CONTROL.sub(" ", words)
        if words.startswith(("<!", "<?")):
            ended = words.endswith("-->" if words.startswith("<!--") else ">")
            return "\n" * words.count("\n") if ended else words
        return clean(words)

    return _TOKEN.sub(token, text.replace("\r\n", "\n")).strip(" \t\ufeff").encode()


def _parse(data: bytes, name: str) -> tuple[ElementTree.Element, dict[ElementTree.Element, str]]:
    """A document as a tree with places; what follows its root is not read.

    Raises:
        ModelError: it is not XML.
    """
    places: dict[ElementTree.Element, str] = {}
    root: list[ElementTree.Element] = []
    stack: list[ElementTree.Element] = []
    parser = expat.ParserCreate()

    def start(tag: str, attributes: dict[str, str]) -> None:
        element = ElementTree.Element(tag, attributes)
        places[element] = f"{name}:{parser.CurrentLineNumber}"
        (stack[-1].append if stack else root.append)(element)
        stack.append(element)

    def text(words: str) -> None:
        if stack:
            stack[-1].text = (stack[-1].text or "") + words

    def end(_: str) -> None:
        stack.pop()

    parser.StartElementHandler, parser.EndElementHandler, parser.CharacterDataHandler = start, end, text
    try:
        parser.Parse(data, True)
    except expat.ExpatError as error:
        after = root and not stack and error.code == expat.errors.codes[expat.errors.XML_ERROR_JUNK_AFTER_DOC_ELEMENT]
        if not after:
            raise ModelError(f"{name}:{error.lineno}: not valid XML: {expat.ErrorString(error.code)}") from None
    except (ValueError, LookupError) as error:  # an unknown encoding
        raise ModelError(f"{name}: not valid XML: {error}") from None
    return root[0], places


def read_numbers(text: str | None, *, count: int, default: Sequence[float], where: str, what: str) -> Vector:
    """Numbers from a text; `default` where there is none.

    Raises:
        ModelError: not so many finite numbers.
    """
    if text is None or not text.strip():
        return np.array(default, dtype=float)
    try:
        values = [float(word) for word in text.split()]
    except ValueError:
        values = []
    if len(values) != count or not all(map(math.isfinite, values)):
        wanted = f"{count} finite numbers" if count > 1 else "a finite number"
        raise ModelError(f"{where}: {what} '{' '.join(text.split())[:60]}' should be {wanted}{_template(text)}")
    return np.array(values)


def read_number(text: str | None, *, where: str, what: str) -> float | None:
    """A number that may be infinite, or None where there is none.

    Raises:
        ModelError: it is no number.
    """
    if text is None or not text.strip():
        return None
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if math.isnan(value):
        raise ModelError(f"{where}: {what} '{text.strip()[:60]}' should be a number{_template(text)}")
    return value


def _template(text: str) -> str:
    """What to do about an expression that some program should have replaced."""
    for mark, name in (("${", "xacro"), ("$(", "xacro"), ("<%", "ERB"), ("{{", "Jinja"), ("@(", "Empy")):
        if mark in text:
            return f"; it is an expression of {name} that was not expanded: give the expanded file"
    return ""


def make_pose(xyz: Sequence[float] | Vector, rpy: Sequence[float] | Vector) -> RigidTransform:
    """A pose from place [m] and roll, pitch, yaw [rad]."""
    return RigidTransform(RollPitchYaw(*[float(angle) for angle in rpy]), [float(value) for value in xyz])


def leaves(element: ElementTree.Element, prefix: str = "") -> dict[str, str]:
    """Texts and attributes of all elements below one, by dotted path; the second of a kind is ``tag[2]``."""
    found: dict[str, str] = {}
    count: Counter[str] = Counter()
    for child in element:
        count[child.tag] += 1
        path = f"{prefix}{child.tag}" + (f"[{count[child.tag]}]" if count[child.tag] > 1 else "")
        for key, value in child.attrib.items():
            found[f"{path}.{key}"] = value
        if len(child):
            found |= leaves(child, f"{path}.")
        elif (child.text or "").strip():
            found[path] = (child.text or "").strip()
    return found
