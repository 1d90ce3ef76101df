"""Edits of list items and scalars in a YAML text that keep every other byte.

:func:`set_scalar` and :func:`set_scalars` replace the text of values, :func:`insert_item` adds an item to a list,
:func:`remove_item` removes one with its comments, and :func:`item_text` returns one for a copy. A comment line directly
above an item belongs to it, and so does a comment behind it on the same line; a blank line ends the block.

As in :mod:`mirdrake.core.yaml_edit`, the result is read again: an edit changes what it is meant to change, or it is
rejected.
"""

import json
from bisect import bisect_left
from collections.abc import Sequence
from functools import lru_cache
from typing import Any, Final, NamedTuple

from mirdrake.core.yaml_edit import (
    REMOVED,
    cut_in_mapping,
    newline_of,
    reject,
    replaced,
    scalar_text,
    space_before,
    value_at,
    verified,
    with_cut,
    without,
    without_flow_entry,
)
from mirdrake.core.yaml_nodes import LINE_BREAK, Node, child_of, line_end, line_start, read_nodes
from mirdrake.core.yaml_tree import parse_tree

Path = Sequence[str]
"""Keys from the root of a text; a number, as text, is the index of a list item."""

_INDENT: Final = "  "


class Span(NamedTuple):
    """A part of a text: characters start to end, and its lines, counted from 1."""

    start: int
    end: int
    first_line: int
    last_line: int


def find_span(text: str, path: Path) -> Span | None:
    """Return the part of the text that a value occupies, without comments; None for an alias or a missing value."""
    node = _find(text, path)
    if node is None or node.kind == "alias":
        return None
    return Span(node.start, node.end, _line_of(text, node.start), _line_of(text, max(node.start, node.end - 1)))


def source_of(text: str, path: Path) -> str | None:
    """Return the text of a scalar as it is in the file; None if it is not a scalar."""
    node = _find(text, path)
    return text[node.start : node.end] if node is not None and node.kind == "scalar" else None


def set_scalar(text: str, path: Path, written: str, *, name: str = "<text>") -> str:
    """Return the text with one value replaced or added.

    Args:
        text: the text.
        path: path of the value; the last key is added to its mapping if it is missing.
        written: the new value as YAML, for example ``95 deg`` or ``[2, 3]``.
        name: name of the text in errors, normally the file name.

    Raises:
        ConfigError: the path does not exist or leads to an alias, or the value is not YAML.
    """
    return set_scalars(text, [(path, written)], name=name)


def set_scalars(
    text: str, changes: Sequence[tuple[Path, str]], *, name: str = "<text>", keep_quotes: bool = False
) -> str:
    """Return the text with several values replaced or added; see :func:`set_scalar`.

    Args:
        text: the text.
        changes: paths and new values as YAML.
        name: name of the text in errors.
        keep_quotes: new values without quotes get those of the values that they replace.

    Raises:
        ConfigError: one of them cannot be changed.
    """
    before, _ = parse_tree(text, name)
    data = before
    # All cuts are found in the original text, so that they can be applied together.
    cuts: list[tuple[int, int, str]] = []
    for path, plain in changes:
        written = _quoted_as(_find(text, path), plain) if keep_quotes else plain
        value = _parsed(written, name)
        cuts.append(_cut(text, before, path, written, name))
        data = replaced(data, path, value)
    # From the end, so that the positions before a cut stay; of two additions at one position the later is behind.
    changed = text
    in_order = sorted(cuts, key=lambda cut: cut[0])
    for cut in reversed(in_order):
        changed = with_cut(changed, cut)
    return verified(text, changed, data, name, changes[-1][0])


def _cut(text: str, before: Any, path: Path, written: str, name: str) -> tuple[int, int, str]:
    """Return start and end of the text that is replaced, and what comes there; `before` is the data of the text."""
    node = _find(text, path)
    if node is None:
        return _cut_missing(text, before, path, written, name)
    if node.kind == "alias":
        reject(text, name, path, "is an alias; edit the file by hand")
    if node.kind != "scalar" and not node.flow:
        reject(text, name, path, f"is a {node.kind} of several lines; edit the file by hand")
    return node.start, node.end, f"{space_before(text, node)}{written}"


def _cut_missing(text: str, before: Any, path: Path, written: str, name: str) -> tuple[int, int, str]:
    """Return the cut that adds a value, with the mappings above it that are missing, too."""
    length, parent = len(path) - 1, None
    while (parent := _find(text, path[:length])) is None and length:
        length -= 1
    if parent is not None and parent.kind == "alias":
        reject(text, name, path[:length], "is an alias; edit the file by hand")
    # A value without text of its own comes from a merge; adding a part of it would replace it as a whole.
    if length < len(path) - 1 and value_at(before, path[: length + 1]) not in (REMOVED, None):
        reject(text, name, path[: length + 1], "comes from a merge; edit the file by hand")
    for key in reversed(path[length + 1 :]):
        written = f"{{{scalar_text(key)}: {written}}}"
    entry = f"{scalar_text(path[length])}: {written}"
    if parent is not None and parent.kind == "mapping":
        return cut_in_mapping(text, parent, entry)
    # Else only `key:` without a value, or null, can get one.
    if parent is None or parent.kind != "scalar" or value_at(before, path[:length]) is not None:
        reject(text, name, path, "is not in the file")
    return parent.start, parent.end, f"{space_before(text, parent)}{{{entry}}}"


def _quoted_as(node: Node | None, written: str) -> str:
    """Return a text in the quotes of a value, unless it has its own."""
    if node is None or node.kind != "scalar" or written[:1] in {"'", '"'}:
        return written
    if node.style == '"':
        return json.dumps(written, ensure_ascii=False)
    doubled = written.replace("'", "''")
    return f"'{doubled}'" if node.style == "'" else written


def insert_item(text: str, path: Path, item: str, *, index: int | None = None, name: str = "<text>") -> str:
    """Return the text with an item more in a list; a missing list is added at the end of its mapping.

    Args:
        text: the text.
        path: path of the list.
        item: the item as YAML, in one line or as lines of a block whose first line begins at the item's text.
        index: number of the item that it comes before; default: it is the last one.
        name: name of the text in errors.

    Raises:
        ConfigError: there is something else than a list, or the item is not YAML.
    """
    data, _ = parse_tree(text, name)
    newline = newline_of(text)
    present = value_at(data, path)
    items = [] if present is REMOVED or present is None else present
    if not isinstance(items, list):
        reject(text, name, path, "is not a list")
    place = len(items) if index is None else index
    # The expected data: the changed text is parsed again and compared with it, so that an edit cannot damage a file.
    wanted = replaced(data, path, [*items[:place], _parsed(_dedented(item), name), *items[place:]])
    node = _find(text, path)
    if node is not None and node.kind == "list" and place < len(node.values):
        following = node.values[place]
        # Before the comments of the item that follows, or directly before it in braces.
        begin = following.start if node.flow else _block_of(text, following.start, following.end)[0]
        new = f"{item}, " if node.flow else f"{' ' * node.column}- {item}{newline}"
        return verified(text, f"{text[:begin]}{new}{text[begin:]}", wanted, name, path)
    if node is None:
        parent = _find(text, path[:-1])
        if parent is None or parent.kind != "mapping" or parent.flow:
            reject(text, name, path, "has no mapping in lines to be added to")
        indent = " " * parent.column
        entry = f"{scalar_text(path[-1])}:{newline}{indent}{_INDENT}- {item}"
        changed = with_cut(text, cut_in_mapping(text, parent, entry))
    elif node.kind == "alias":
        reject(text, name, path, "is an alias; edit the file by hand")
    elif node.kind == "scalar":  # `props:` without a value
        # The list is indented relative to its key, as the empty value has no column of its own.
        key_line = line_start(text, node.start)
        column = len(text[key_line:]) - len(text[key_line:].lstrip(" "))
        end = line_end(text, node.start)
        changed = f"{text[:end]}{newline}{' ' * column}{_INDENT}- {item}{text[end:]}"
    elif node.flow:
        # In brackets, behind the last item or the opening bracket.
        last = node.values[-1].end if node.values else node.start + 1
        changed = f"{text[:last]}{', ' if node.values else ''}{item}{text[last:]}"
    else:
        end = line_end(text, node.end)
        changed = f"{text[:end]}{newline}{' ' * node.column}- {item}{text[end:]}"
    return verified(text, changed, wanted, name, path)


def remove_item(text: str, path: Path, *, name: str = "<text>") -> str:
    """Return the text without a list item or key and the comments that belong to it.

    The key of a list is removed with the last item.

    Raises:
        ConfigError: the item does not exist, or other parts of the text depend on it.
    """
    data, _ = parse_tree(text, name)
    parent, index, node = _find_in_parent(text, path)
    if node is None or parent is None:
        reject(text, name, path, "is not in the file")
    # An empty list in lines cannot be written without its key.
    if parent.kind == "list" and len(parent.values) == 1:
        return remove_item(text, path[:-1], name=name)
    first = parent.keys[index] if parent.kind == "mapping" else node
    if parent.flow:
        changed = without_flow_entry(text, parent, index)
    else:
        begin, end = _block_of(text, first.start, node.end)
        changed = text[:begin] + text[end:]
    return verified(text, changed, without(data, path), name, path)


def item_text(text: str, path: Path) -> str | None:
    """Return the text of a list item without its comments, for :func:`insert_item`; None if it has none."""
    node = _find(text, path)
    return None if node is None or node.kind == "alias" else text[node.start : node.end]


# --- the inner parts --------------------------------------------------------------------------------------------------


def _find(text: str, path: Path) -> Node | None:
    return _find_in_parent(text, path)[2] if path else _nodes(text)


@lru_cache(maxsize=4)
def _nodes(text: str) -> Node | None:
    """Return the nodes of a text; reading a long text takes longer than all else here."""
    return read_nodes(text)


def _find_in_parent(text: str, path: Path) -> tuple[Node | None, int, Node | None]:
    """Return the parent of a value, its index in it, and the value; None for what is not there."""
    parent, index, node = None, 0, _nodes(text)
    for key in path:
        if node is None or node.kind not in {"mapping", "list"} or (match := child_of(node, key)) is None:
            return node, 0, None
        parent, (index, node) = node, match
    return parent, index, node


def _line_of(text: str, position: int) -> int:
    return 1 + bisect_left(_breaks(text), position)


@lru_cache(maxsize=4)
def _breaks(text: str) -> list[int]:
    return [match.start() for match in LINE_BREAK.finditer(text)]


def _block_of(text: str, start: int, end: int) -> tuple[int, int]:
    """Return the lines of an item with the comment lines directly above it and the line break at its end."""
    begin = line_start(text, start)
    indent = len(text[begin:]) - len(text[begin:].lstrip(" "))
    while begin > 0:
        # Before the line break, which may have two characters.
        above = line_start(text, begin - (2 if text.endswith("\r\n", 0, begin) else 1))
        line = text[above:begin]
        # A comment with another indentation belongs to what is around the item.
        is_own = line.lstrip(" ").startswith("#") and len(line) - len(line.lstrip(" ")) == indent
        if not is_own:
            break
        begin = above
    close = line_end(text, end)
    match = LINE_BREAK.match(text, close)
    if match:
        return begin, match.end()
    # The last line of the text: the line break before it goes, so that the text still ends as it did.
    breaks = list(LINE_BREAK.finditer(text, 0, begin))
    return (breaks[-1].start() if breaks else begin), close


def _dedented(item: str) -> str:
    """Return a block item of several lines so that it can be parsed alone."""
    lines = item.splitlines()
    if len(lines) < 2 or lines[0][:1] in "{[":
        return item
    # Lines after the first keep their indentation of the file, so the first is indented to match them.
    indents = [len(line) - len(line.lstrip(" ")) for line in lines[1:] if line.strip()]
    return " " * min(indents, default=0) + item


def _parsed(written: str, name: str) -> Any:
    data, _ = parse_tree(f"value:\n{written if written.startswith(' ') else f'  {written}'}\n", name)
    return data["value"]
