"""XML files of ROS and Gazebo, which need not be valid XML: what Gazebo's parser accepts is accepted."""

import re
from pathlib import Path
from xml.etree.ElementTree import Element

from mirdrake.core.errors import ModelError
from mirdrake.core.xml_reader import XmlDocument, parse_xml, read_xml_bytes
from mirdrake.core.yaml_io import display_path

__all__ = ["XmlFiles", "read_gazebo_xml"]

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


class XmlFiles:
    """XML files that have been read, and the places of all their elements."""

    def __init__(self) -> None:
        self._places: dict[Element, str] = {}

    def parse(self, path: Path) -> Element:
        """Return the root element of a file; see :func:`read_gazebo_xml` for errors."""
        document = read_gazebo_xml(path)
        self._places |= {element: f"{document.name}:{line}" for element, line in document.lines.items()}
        return document.root

    def where(self, element: Element) -> str:
        """Return ``file:line`` of an element; "" if it was not read from a file."""
        return self._places.get(element, "")


def read_gazebo_xml(path: Path) -> XmlDocument:
    """Return the tree of a file.

    What Gazebo's parser (tinyxml2) accepts although the XML standard forbids it is accepted, see :func:`_strict`; so is
    text after the root element.

    Raises:
        ModelError: the file cannot be read, is not XML or declares entities, which can grow without bounds.
    """
    name = display_path(path)
    data = read_xml_bytes(path, largest=LARGEST, error=ModelError, advice="split the file")
    before, mark, _ = data.replace(b"\0", b"").partition(b"<!ENTITY")  # the second reading would overlook it
    if mark:
        line = before.count(b"\n") + 1
        raise ModelError("declares an XML entity; replace each reference to it by its text", file=name, line=line)
    # Only a file that is not valid XML is repaired.
    try:
        return parse_xml(data, name, error=ModelError, text_after_root=True)
    except ModelError:
        return parse_xml(_strict(data), name, error=ModelError, text_after_root=True)


def _strict(data: bytes) -> bytes:
    """Return the same document as valid XML, with the same lines.

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
            # Line breaks of removed parts stay, so that the numbers of lines stay right.
            ended = words.endswith("-->" if words.startswith("<!--") else ">")
            return "\n" * words.count("\n") if ended else words
        return clean(words)

    return _TOKEN.sub(token, text.replace("\r\n", "\n")).strip(" \t\ufeff").encode()
