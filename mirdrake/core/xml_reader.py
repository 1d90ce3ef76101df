"""Reader of XML files to trees with the line of each element; files are bounded in size and have no entities.

Over expat of the standard library: ElementTree's own parser has no lines, and lxml would be one more dependency for
them alone.
"""

import re
from collections import Counter
from collections.abc import Container, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn
from xml.etree.ElementTree import Element
from xml.parsers import expat

from mirdrake.core.errors import MirdrakeError, printable
from mirdrake.core.yaml_io import display_path

__all__ = ["Element", "XmlDocument", "count_unread", "parse_xml", "read_xml_bytes"]

_LATE_DECLARATION = re.compile(
    rb"(?s)(?=[\s<](?!\?))\s*+(?:<!--(?>.*?-->)\s*+)*+(<\?xml\s(?:[^>]*?encoding=[\"']([\w.-]+)[\"'])?[^>]*\?>)"
)
"""XML declaration that follows white space or comments, and its encoding."""

_TEXT_AFTER_ROOT = expat.errors.codes[expat.errors.XML_ERROR_JUNK_AFTER_DOC_ELEMENT]


@dataclass(frozen=True)
class XmlDocument:
    """A parsed file.

    Attributes:
        root: element; tags keep their prefix and attributes their order.
        lines: line of the start tag of each element, in the order of the document.
        name: name of the file, for messages.
    """

    root: Element
    lines: Mapping[Element, int]
    name: str

    def where(self, element: Element) -> str:
        """Return ``file:line`` of an element."""
        return f"{self.name}:{self.lines[element]}"


def read_xml_bytes(path: Path, *, largest: int, error: type[MirdrakeError], advice: str) -> bytes:
    """Return the content of an XML file.

    Args:
        path: the file.
        largest: size that is allowed [bytes].
        error: class of the errors.
        advice: what the user can do about a larger file.

    Raises:
        MirdrakeError: of the given class; the file cannot be read or is too large.
    """
    try:
        if path.stat().st_size > largest:
            raise error(f"more than {largest // 1_000_000} MB of XML; {advice}", where=display_path(path))
        return path.read_bytes()
    except OSError as fault:
        raise error(str(fault.strerror or fault), where=display_path(path)) from None


def parse_xml(
    data: bytes | str, name: str, *, error: type[MirdrakeError], prefixes: bool = True, text_after_root: bool = False
) -> XmlDocument:
    """Parse a document.

    Entities are rejected: they can grow without bounds and can refer to other files.

    Args:
        data: content of the file.
        name: name of the file, for messages.
        error: class of the errors.
        prefixes: keep the name space prefix of tags.
        text_after_root: ignore what follows the root element instead of rejecting it.

    Raises:
        MirdrakeError: of the given class; the data are not valid XML or declare entities.
    """
    lines: dict[Element, int] = {}
    stack: list[Element] = []
    root: list[Element] = []
    parser = expat.ParserCreate()
    # A licence before the declaration is frequent, and other readers accept it; to this parser it would be an error.
    if isinstance(data, bytes) and (late := _LATE_DECLARATION.match(data)) is not None:
        begin, end_of_it = late.span(1)
        data = data[:begin] + b"\n" * late[1].count(b"\n") + data[end_of_it:]
        parser = expat.ParserCreate(late[2].decode() if late[2] else None)

    def start(tag: str, attributes: dict[str, str]) -> None:
        element = Element(tag if prefixes else tag.rpartition(":")[2], attributes)
        lines[element] = parser.CurrentLineNumber
        (stack[-1].append if stack else root.append)(element)
        stack.append(element)

    def end(_: str) -> None:
        stack.pop()

    def text(words: str) -> None:
        # Text behind the root element belongs to no element.
        if stack:
            stack[-1].text = (stack[-1].text or "") + words

    def reject_entity(entity: str, *_: Any) -> NoReturn:
        # The name is from an untrusted file: it must not bring control characters into a terminal.
        shown_entity = printable(str(entity), "?")[:60]
        location = f"{name}:{parser.CurrentLineNumber}"
        raise error(f"declares the XML entity '{shown_entity}'; write out its value", where=location)

    parser.StartElementHandler, parser.EndElementHandler, parser.CharacterDataHandler = start, end, text
    # All three handlers, as an entity may be declared, external, or skipped by the parser.
    parser.EntityDeclHandler = parser.ExternalEntityRefHandler = parser.SkippedEntityHandler = reject_entity
    try:
        parser.Parse(data, True)
    except expat.ExpatError as fault:
        # The error is tolerated only if everything before it was a complete document.
        complete = bool(root) and not stack
        if not (text_after_root and complete and fault.code == _TEXT_AFTER_ROOT):
            raise error(f"not valid XML: {expat.ErrorString(fault.code)}", file=name, line=fault.lineno) from None
    except (ValueError, LookupError) as fault:  # an unknown encoding
        raise error(f"not valid XML: {fault}", where=name) from None
    return XmlDocument(root[0], lines, name)


def count_unread(
    element: Element, *, read: Container[str], leaves: Container[str] = (), metadata: Container[str] = ()
) -> Counter[str]:
    """Return how often each kind of element below an element occurs that a reader does not read.

    Args:
        element: the element.
        read: tags of the elements that it reads; others count, without their parts.
        leaves: tags whose parts are read, or reported, together with them.
        metadata: tags that state nothing about the contents, which do not count.
    """
    found: Counter[str] = Counter()
    for child in element:
        if child.tag in leaves or child.tag in metadata:
            continue
        if child.tag in read:
            found += count_unread(child, read=read, leaves=leaves, metadata=metadata)
        # An empty element, such as <surface/>, states nothing.
        elif child.attrib or len(child) or (child.text or "").strip():
            found[child.tag] += 1
    return found
