"""SVG documents as elements of an HTML page.

Matplotlib and Graphviz write whole SVG documents. :func:`embed_svg` turns one into an element without effects on the
page: no scripts, no external references, ids that are unique in the page, coordinates with few decimals. Reserved
colours (:data:`THEME`) become CSS variables, so that one drawing serves light and dark pages.
"""

import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable, Mapping

# Colours that stand for CSS variables: drawings use these values, the page defines their appearance.
THEME: dict[str, str] = {
    "ink": "#010101",
    "muted": "#010102",
    "grid": "#010103",
    "paper": "#010104",
    "road": "#010105",
    "edge": "#010106",
    "main": "#010107",
    "left": "#010108",
    "right": "#010109",
    "alarm": "#01010a",
    "own1": "#01010b",
    "own2": "#01010c",
    "own3": "#01010d",
    "own4": "#01010e",
}
SCALE_STEPS = 8
THEME |= {f"scale{step}": f"#0102{step:02x}" for step in range(SCALE_STEPS)}
_VARIABLES = {colour: f"var(--{name})" for name, colour in THEME.items()}

_COLOUR = re.compile(r"#010[12][0-9a-f]{2}")
_DECIMALS = re.compile(r"(-?\d+)\.(\d{2,})")
_LOCAL_URL = re.compile(r"url\(\s*['\"]?#([^)'\"\s]+)['\"]?\s*\)")
_FONT = re.compile(r"\s*font-family:[^;]*;?")
_DOCTYPE = re.compile(r"<!DOCTYPE[^>\[]*(?:\[.*?\]\s*)?>", re.DOTALL)
_UNSAFE_ELEMENTS = {
    "script",
    "foreignobject",
    "metadata",
    "iframe",
    "object",
    "embed",
    "audio",
    "video",
    "image",
    "set",
    "animate",
}
_NUMERIC = {"d", "points", "x", "y", "x1", "x2", "y1", "y2", "cx", "cy", "r", "width", "height", "transform"}


def embed_svg(
    text: str,
    prefix: str,
    *,
    attributes: Mapping[str, str] | None = None,
    data: Mapping[str, Mapping[str, str]] | None = None,
    decimals: int = 1,
    scope: str = "",
) -> str:
    """Return an SVG document as an element for an HTML page.

    Args:
        text: the document.
        prefix: put before every id that is kept; unique in the page.
        attributes: set on the root in place of its width and height.
        data: further attributes by the id of an element, for example ``{"curve": {"data-name": "speed"}}``.
        decimals: decimals of coordinates that are kept.
        scope: CSS selector to which style sheets of the document are limited; without it they are dropped.

    Raises:
        ValueError: `text` is not an SVG document.
    """
    try:
        # A document type may declare entities; it is removed before the parser sees it.
        root = ElementTree.fromstring(_DOCTYPE.sub("", text, count=1).lstrip("\ufeff \r\n\t"))
    except ElementTree.ParseError as error:
        raise ValueError(f"not an SVG document: {error}") from None
    _drop_namespaces(root.iter())
    if root.tag != "svg":
        raise ValueError(f"not an SVG document: its root is <{root.tag}>")
    _drop_unsafe(root, scope)
    # The page sets the size; a style on the root could hide or move it.
    for name in ("width", "height", "version", "style"):
        root.attrib.pop(name, None)

    # Ids are kept only if something refers to them, which makes the page smaller.
    used = {
        match for element in root.iter() for value in element.attrib.values() for match in _LOCAL_URL.findall(value)
    }
    used |= {element.attrib["href"][1:] for element in root.iter() if "href" in element.attrib}
    keep = used | set(data or {})
    for element in root.iter():
        _clean(element, prefix, keep, data or {}, decimals)
    root.attrib.update(attributes or {})
    written = ElementTree.tostring(root, encoding="unicode", short_empty_elements=True)
    # Last, on the text: reserved colours occur in attributes and styles.
    return _COLOUR.sub(lambda match: _VARIABLES.get(match.group(), match.group()), written)


def embed_graph(text: str, prefix: str, label: str) -> str:
    """Return a graph of Graphviz as an element in its own size; see :func:`embed_svg`.

    Args:
        text: the document.
        prefix: prefix of ids, unique in the page.
        label: text for readers who cannot see the picture.
    """
    attributes, size = {"role": "img", "aria-label": label}, svg_size(text)
    if size:
        attributes["style"] = f"width:{max(320.0, min(size[0], 4000.0)):.0f}px"
    return embed_svg(text, prefix, attributes=attributes, decimals=2, scope=".diagram")


def svg_size(text: str) -> tuple[float, float] | None:
    """Return width and height of an SVG document in user units, from its viewBox; None if it has none."""
    match = re.search(r"viewBox\s*=\s*['\"]\s*[-\d.eE+]+[\s,]+[-\d.eE+]+[\s,]+([\d.eE+]+)[\s,]+([\d.eE+]+)", text)
    return (float(match.group(1)), float(match.group(2))) if match else None


def _drop_namespaces(elements: Iterable[ElementTree.Element]) -> None:
    for element in elements:
        if isinstance(element.tag, str):
            element.tag = element.tag.rpartition("}")[2]
        element.attrib = {name.rpartition("}")[2]: value for name, value in element.attrib.items()}


def _drop_unsafe(parent: ElementTree.Element, scope: str) -> None:
    for child in list(parent):
        is_style = child.tag == "style"
        # Styles are kept only within a scope, or they would change the rest of the page.
        if child.tag.lower() in _UNSAFE_ELEMENTS or (is_style and not (scope and _is_tame(child.text or ""))):
            parent.remove(child)
            continue
        # CSS nesting limits the rules to the drawing.
        if is_style:
            child.text = f"{scope} {{ {child.text} }}"
        _drop_unsafe(child, scope)
        # Empty groups remain where unsafe content was removed.
        if child.tag in {"defs", "g"} and not len(child) and not child.attrib.get("id"):
            parent.remove(child)


def _is_tame(css: str) -> bool:
    """Whether a style sheet has balanced braces and no external references."""
    depth = 0
    # A closing brace too many would end the scope.
    for character in css:
        depth += {"{": 1, "}": -1}.get(character, 0)
        if depth < 0:
            return False
    return depth == 0 and not re.search(r"url\s*\(|@import|expression|\\|<", css, re.IGNORECASE)


def _clean(
    element: ElementTree.Element, prefix: str, keep: set[str], data: Mapping[str, Mapping[str, str]], decimals: int
) -> None:
    for name, value in list(element.attrib.items()):
        # An address that is not a fragment would load something from outside.
        leads_out = (name == "href" and not value.startswith("#")) or value.count("url(") > len(
            _LOCAL_URL.findall(value)
        )
        # onclick and others are scripts.
        if leads_out or name.lower().startswith("on"):
            del element.attrib[name]
        elif name == "id":
            element.attrib.update(data.get(value, {}))
            if value in keep and value not in data:
                element.attrib[name] = prefix + value
            else:
                del element.attrib[name]
        elif name == "href":
            element.attrib[name] = f"#{prefix}{value[1:]}"
        elif name in _NUMERIC:
            rounded = _DECIMALS.sub(lambda match: _rounded(match, decimals), value)
            element.attrib[name] = rounded.replace("\n", "").replace(" L ", "L").strip() if name == "d" else rounded
        elif "url(" in value:
            element.attrib[name] = _LOCAL_URL.sub(rf"url(#{prefix}\1)", value)
        elif name == "style":
            # The font is that of the page.
            element.attrib[name] = _FONT.sub("", value)
    # Rounding of tiny angles leaves rotations by -0.
    if element.attrib.get("transform", "").startswith("rotate(-0 "):
        del element.attrib["transform"]
    if element.text is not None and not element.text.strip():
        element.text = None
    if element.tail is not None and not element.tail.strip():
        element.tail = None


def _rounded(match: re.Match[str], decimals: int) -> str:
    return f"{float(match.group()):.{decimals}f}".removesuffix("0").removesuffix(".")
