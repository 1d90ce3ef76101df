"""The parts of a YAML text with their positions, for editors that change a part and keep every other byte."""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import yaml

LINE_BREAK = re.compile(r"\r\n|[\n\r\x85\u2028\u2029]")
"""Line breaks of YAML 1.1."""


@dataclass(slots=True)
class Node:
    """A part of the text: characters start to end; of a block collection, up to the end of its last value.

    Attributes:
        kind: scalar, alias, mapping or list.
        column: column of the first character.
        flow: written in braces or brackets.
        keys, values: of a mapping; of a list only values.
    """

    kind: str
    start: int
    end: int
    column: int
    line: int
    flow: bool = False
    style: str | None = None
    text: str = ""
    keys: "list[Node]" = field(default_factory=list)
    values: "list[Node]" = field(default_factory=list)


def read_nodes(text: str) -> Node | None:
    """Return the events of a text as a tree with positions; None if the text is empty."""
    events: Iterator[Any] = yaml.parse(text, Loader=yaml.SafeLoader)
    for event in events:
        if isinstance(event, yaml.DocumentStartEvent):
            root = _compose(next(events), events, text)
            return None if root.kind == "scalar" and root.start == root.end else root
    return None


def _compose(event: Any, events: Iterator[Any], text: str) -> Node:
    start, end = event.start_mark, event.end_mark
    node = Node("", start.index, end.index, start.column, start.line)
    if isinstance(event, yaml.AliasEvent):
        node.kind = "alias"
    elif isinstance(event, yaml.ScalarEvent):
        node.kind, node.style, node.text = "scalar", event.style, event.value
        # The text of a block ends with its line breaks, which belong to the lines that follow.
        if node.style in {"|", ">"}:
            node.end = node.start + len(text[node.start : node.end].rstrip())
    else:
        # A child of a block ends before the indentation of what follows, where PyYAML's end mark is too late.
        node.kind, node.flow = ("mapping" if isinstance(event, yaml.MappingStartEvent) else "list"), event.flow_style
        while not isinstance(closing := next(events), yaml.CollectionEndEvent):
            child = _compose(closing, events, text)
            if node.kind == "mapping":
                node.keys.append(child)
                child = _compose(next(events), events, text)
            node.values.append(child)
        last: Any = closing.end_mark
        if node.flow:
            node.end = last.index
        else:
            node.end = max([node.end, *(child.end for child in node.values)])
            node.column = node.keys[0].column if node.keys else node.column
    return node


def child_of(node: Node, key: str) -> tuple[int, Node] | None:
    """Return the index and the value of a key or list item; None if there is none."""
    if node.kind == "list":
        index = int(key) if key.isdecimal() and len(key) < 7 else -1
        return (index, node.values[index]) if 0 <= index < len(node.values) else None
    for index, (key_node, value) in enumerate(zip(node.keys, node.values, strict=True)):
        if key_node.text == key:
            return index, value
    return None


def line_start(text: str, position: int) -> int:
    """Return the position of the first character of a line."""
    start = 0
    for match in LINE_BREAK.finditer(text, 0, position):
        start = match.end()
    return start


def line_end(text: str, position: int) -> int:
    """Return the position of the line break that ends a line, after its comment."""
    match = LINE_BREAK.search(text, position)
    return match.start() if match else len(text)
