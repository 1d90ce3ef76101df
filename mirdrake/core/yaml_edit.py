"""Editor of single values in a YAML text that keeps every other byte: comments, order, layout, line ends.

:func:`edit_yaml` finds the positions by the marks of PyYAML's events and replaces the text between them; the file is
not written from its data. The result is parsed and compared with the expected data, so that an edit either changes only
its values or is rejected with ``file:line``.
"""

import json
import math
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final, NoReturn

from mirdrake.core.errors import ConfigError, dotted
from mirdrake.core.yaml_nodes import LINE_BREAK, Node, child_of, line_end, line_start, read_nodes
from mirdrake.core.yaml_tree import parse_tree

Scalar = bool | int | float | str | None
Value = Scalar | tuple[Scalar, ...]


class _Removed:
    def __repr__(self) -> str:
        return "REMOVED"


REMOVED: Final = _Removed()
"""Value of an :class:`Edit` that removes the key."""


@dataclass(frozen=True, slots=True)
class Edit:
    """One value to set.

    Attributes:
        path: dotted path, or the keys one by one where a key has a dot in it; a number is the index of a list item.
        value: text, number, true, false or None; a tuple of these, written as a list in brackets; or :data:`REMOVED`.
        comment: a line above the key, without ``#``.
        replaces: beginning of a comment line directly above that the new one replaces.
        remark: a comment behind the value of a key that is added on a line of its own, without ``#``.
    """

    path: str | tuple[str, ...]
    value: Value | _Removed
    comment: str = ""
    replaces: str = ""
    remark: str = ""

    @property
    def keys(self) -> tuple[str, ...]:
        """Keys from the outermost to the innermost mapping."""
        return tuple(self.path.split(".")) if isinstance(self.path, str) else self.path


def edit_yaml(text: str, edits: Iterable[Edit], *, name: str = "<text>") -> str:
    """Return a YAML text with some values changed.

    A missing key or mapping is added at the end of the mapping above. If the key has the value already, or a key to
    remove does not exist, only the comment is changed.

    Args:
        text: the text, line ends as they are in the file.
        edits: applied in their order.
        name: name of the text in error messages, normally the file name.

    Raises:
        ConfigError: the text is not YAML, a part of the path is not a mapping, the present value is a list, a mapping
            or an alias, or the new value cannot be written.
    """
    for edit in edits:
        text = _Editor(text, edit, name).edited()
    return text


def value_at(data: Any, keys: Sequence[str]) -> Any:
    """Return the value at a path of plain data; :data:`REMOVED` if there is none."""
    for key in keys:
        if isinstance(data, dict) and key in data:
            data = data[key]
        elif isinstance(data, list) and key.isdecimal() and int(key) < len(data):
            data = data[int(key)]
        else:
            return REMOVED
    return data


def _value_text(value: Value) -> str:
    return f"[{', '.join(map(scalar_text, value))}]" if isinstance(value, tuple) else scalar_text(value)


def scalar_text(value: Scalar) -> str:
    """Return a value as YAML that has the same meaning in versions 1.1 and 1.2.

    Raises:
        ConfigError: a number that is not finite.
    """
    # bool first, as True is also an int.
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    if isinstance(value, int):
        return str(int(value))
    if isinstance(value, float):
        if not math.isfinite(value):
            raise ConfigError(f"{value} cannot be written; it must be a finite number")
        # PyYAML reads 1e5 as a text, YAML 1.2 as a number; a point makes it a number in both.
        digits, mark, power = repr(float(value)).partition("e")
        return f"{digits if '.' in digits else f'{digits}.0'}{mark}{power}" if mark else digits
    # Plain style only for texts that no parser takes for another type, a comment or a key: words, numbers with a unit.
    plain = re.fullmatch(
        r"(?:[A-Za-z_]|-?[0-9]+(?:\.[0-9]+)? [A-Za-z])(?:[A-Za-z0-9_./()%+=*-]| (?! )(?![#:]))*", value
    ) and not value.endswith(" ")
    if plain and value.lower() not in _WORDS:
        return value
    # JSON strings are YAML strings in double quotes.
    quoted = json.dumps(value, ensure_ascii=False)
    return "".join(c if c.isprintable() and c != "\ufeff" else _escaped(c) for c in quoted)


# --- shared with yaml_items -------------------------------------------------------------------------------------------


def newline_of(text: str) -> str:
    """Return the first line break of a text; a line feed if it has none."""
    match = LINE_BREAK.search(text)
    return match.group() if match else "\n"


def space_before(text: str, node: Node) -> str:
    """Return the space that is missing in front of the new value of `key:` without a value."""
    return " " if node.start == node.end and text[node.start - 1 : node.start] not in {" ", ""} else ""


def cut_in_mapping(text: str, node: Node, entry: str) -> tuple[int, int, str]:
    """Return the cut that adds an entry at the end of a mapping: start, end, and what comes there."""
    if node.flow:
        last = node.values[-1].end if node.values else node.start + 1
        return last, last, f"{', ' if node.values else ''}{entry}"
    end = line_end(text, node.end)
    return end, end, f"{newline_of(text)}{' ' * node.column}{entry}"


def with_cut(text: str, cut: tuple[int, int, str]) -> str:
    """Return the text with a part replaced."""
    start, end, written = cut
    return f"{text[:start]}{written}{text[end:]}"


def without_flow_entry(text: str, parent: Node, index: int) -> str:
    """Return the text without an entry of a mapping or list in braces or brackets."""
    firsts = parent.keys if parent.kind == "mapping" else parent.values
    # The comma goes with the entry: up to the next one, or from the end of the one before.
    if index + 1 < len(firsts):
        return text[: firsts[index].start] + text[firsts[index + 1].start :]
    begin = parent.values[index - 1].end if index else firsts[index].start
    return text[:begin] + text[parent.values[index].end :]


def replaced(data: Any, path: Sequence[str], value: Any) -> Any:
    """Return data with a value set; containers are copied, so that aliases are independent."""
    if not path:
        return value
    key, rest = path[0], path[1:]
    if isinstance(data, list):
        return [replaced(item, rest, value) if str(index) == key else item for index, item in enumerate(data)]
    data = data or {}
    return {**data, key: replaced(data.get(key), rest, value)}


def without(data: Any, path: Sequence[str]) -> Any:
    """Return data without an item or a key; containers are copied."""
    key, rest = path[0], path[1:]
    if isinstance(data, list):
        if not rest:
            return [item for index, item in enumerate(data) if str(index) != key]
        return [without(item, rest) if str(index) == key else item for index, item in enumerate(data)]
    if not rest:
        return {name: value for name, value in data.items() if name != key}
    return {**data, key: without(data[key], rest)}


def verified(text: str, changed: str, wanted: Any, name: str, path: Sequence[str]) -> str:
    """Return a changed text; an edit that changed anything else is rejected, with the place in the original text."""
    try:
        after: Any = parse_tree(changed, name)[0]
    except ConfigError:
        after = REMOVED
    # Through JSON, since NaN differs from itself and the order of keys has no meaning.
    if json.dumps(after, sort_keys=True, default=repr) != json.dumps(wanted, sort_keys=True, default=repr):
        reject(text, name, path, "cannot be changed without changing something else; edit the file by hand")
    return changed


def reject(text: str, name: str, path: Sequence[str], problem: str) -> NoReturn:
    """Raise an error at a path of a text."""
    data, source = parse_tree(text, name)
    raise ConfigError(problem, where=source.where(*_typed(data, path)))


def _typed(data: Any, keys: Sequence[str]) -> Iterator[str | int]:
    """Return the keys with the indices of lists as numbers, as in :class:`Source`."""
    for key in keys:
        yield int(key) if isinstance(data, list) and key.isdecimal() else key
        data = value_at(data, (key,))


# --- the inner parts --------------------------------------------------------------------------------------------------

_WORDS = {"true", "false", "null", "yes", "no", "on", "off", "nan", "inf"}


def _escaped(character: str) -> str:
    code = ord(character)
    return f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}"


class _Editor:
    """One edit on one text."""

    def __init__(self, text: str, edit: Edit, name: str) -> None:
        self.text, self.edit, self.name = text, edit, name
        self.data, _ = parse_tree(text, name)
        self.root, self.newline = read_nodes(text), newline_of(text)

    def edited(self) -> str:
        """Return the text with the edit made.

        Raises:
            ConfigError: the edit is not possible.
        """
        keys, value = self.edit.keys, self.edit.value
        if not keys or not all(keys):
            raise ConfigError(f"'{dotted(keys)}' is not a path such as speed.kp", where=self.name)
        before = value_at(self.data, keys)
        wanted, text = self.data, self.text
        # An equal value leaves the text as it is, even if it is written differently (1.0 and 1).
        if not _same(before, value):
            if isinstance(value, _Removed):
                text, wanted = self._remove(keys), without(self.data, keys)
            else:
                text, wanted = self._set(keys, value), replaced(self.data, keys, value)
        if self.edit.comment and not isinstance(value, _Removed):
            text = _commented(text, self.edit)
        return verified(self.text, text, wanted, self.name, keys)

    def _set(self, keys: Sequence[str], value: Value) -> str:
        written = _value_text(value)
        # An empty file becomes a block with the keys.
        if self.root is None:
            return _appended(self.text, _block(keys, written, "", self.newline), self.newline)
        node = self.root
        for depth, key in enumerate(keys):
            self._check_container(node, keys[:depth])
            found = child_of(node, key)
            if found is None:
                if node.kind == "list":
                    self._reject(keys[:depth], f"is a list of {len(node.values)}; '{key}' is not an index of it")
                return self._add(node, keys[depth:], written)
            node = found[1]
            # A key with an empty value becomes a mapping in braces, as there is no line to indent under it.
            if depth + 1 < len(keys) and node.kind == "scalar" and value_at(self.data, keys[: depth + 1]) is None:
                inner = "".join(f"{{{scalar_text(key)}: " for key in keys[depth + 1 :])
                return self._put(node, f"{inner}{written}{'}' * (len(keys) - depth - 1)}")
        # Only a list in brackets has its extent on one line.
        if isinstance(value, tuple) and node.kind == "list":
            if not node.flow:
                self._reject(keys, "is a list in lines; write it in brackets, or remove it")
            return self._put(node, written)
        if node.kind not in {"scalar", "alias"}:
            self._reject(keys, f"is a {node.kind}; a single value is expected")
        if node.style in {"|", ">"}:
            self._reject(keys, "is a text of several lines; edit it by hand")
        return self._put(node, written)

    def _put(self, node: Node, written: str) -> str:
        """Return the text with a scalar replaced, which may be empty."""
        return f"{self.text[: node.start]}{space_before(self.text, node)}{written}{self.text[node.end :]}"

    def _add(self, node: Node, keys: Sequence[str], written: str) -> str:
        """Return the text with a new entry at the end of a mapping."""
        if node.flow:
            inner = "".join(f"{scalar_text(key)}: {{" for key in keys[:-1])
            entry = f"{inner}{scalar_text(keys[-1])}: {written}{'}' * (len(keys) - 1)}"
            return with_cut(self.text, cut_in_mapping(self.text, node, entry))
        remark = f"  # {self.edit.remark}" if self.edit.remark else ""
        lines = _block(keys, written, " " * node.column, self.newline) + remark
        end = line_end(self.text, node.end)
        if not self.text[:end]:
            return f"{lines}{self.newline}{self.text}"
        return f"{self.text[:end]}{self.newline}{lines}{self.text[end:]}"

    def _remove(self, keys: Sequence[str]) -> str:
        # The entry and its container: what is removed depends on whether it is in braces or on lines of its own.
        node, parent, place = self.root, None, 0
        for key in keys:
            found = child_of(node, key) if node is not None else None
            if node is None or found is None:
                self._reject(keys, "comes from an alias or a merge; edit the file by hand")
            parent, (place, node) = node, found
        assert parent is not None
        assert node is not None
        if parent.kind == "list":
            self._reject(keys, "is an item of a list; edit the file by hand")
        text, key_node = self.text, parent.keys[place]
        if parent.flow:
            return without_flow_entry(text, parent, place)
        begin = line_start(text, key_node.start)
        if text[begin : key_node.start].strip(" "):
            self._reject(keys, "shares its line with something else; edit the file by hand")
        end = line_end(text, node.end)
        match = LINE_BREAK.match(text, end)
        # Without a line break at the end, the line break before the entry is removed instead.
        if match:
            return text[:begin] + text[match.end() :]
        last = text[:begin]
        for match in LINE_BREAK.finditer(text, 0, begin):
            last = text[: match.start()]
        return last + text[end:]

    def _check_container(self, node: Node, keys: Sequence[str]) -> None:
        if node.kind == "alias":
            self._reject(keys, "is an alias; write out its value")
        if node.kind == "scalar":
            self._reject(keys, "is a single value; a mapping (key: value) is expected")

    def _reject(self, keys: Sequence[str], what: str) -> NoReturn:
        reject(self.text, self.name, keys, what)


def _same(before: Any, value: Any) -> bool:
    if isinstance(before, list) and isinstance(value, tuple):
        return len(before) == len(value) and all(map(_same, before, value))
    numbers = all(isinstance(number, int | float) and not isinstance(number, bool) for number in (before, value))
    # Types must agree, or true would equal 1; int and float of equal value are the same number.
    return (numbers and before == value) or (type(before) is type(value) and before == value)


def _block(keys: Sequence[str], written: str, indent: str, newline: str) -> str:
    """Return the lines of a new entry; each level of keys is indented by two spaces."""
    lines = [f"{indent}{'  ' * depth}{scalar_text(key)}:" for depth, key in enumerate(keys)]
    return f"{newline.join(lines)} {written}"


def _appended(text: str, lines: str, newline: str) -> str:
    """Append lines to a text that has only comments."""
    between = newline if text and not LINE_BREAK.search(text[-1]) else ""
    return f"{text}{between}{lines}{newline}"


def _commented(text: str, edit: Edit) -> str:
    """Set the comment above the line of a key; for a key in braces, above the line where its entry begins."""
    if not edit.comment.isprintable():
        raise ConfigError(
            f"a comment is one line of printable text, not {edit.comment[:60]!r}", where=dotted(edit.keys)
        )
    # The comment belongs to the deepest of the keys that exists.
    root = read_nodes(text)
    assert root is not None
    node, position = root, root.start
    for key in edit.keys:
        found = child_of(node, key)
        if found is None:
            break
        # Only keys outside of braces begin a line; for one in braces the comment is above its entry.
        if node.kind == "mapping" and not node.flow:
            position = node.keys[found[0]].start
        node = found[1]
    begin = line_start(text, position)
    line = text[begin : line_end(text, begin)]
    indent = line[: len(line) - len(line.lstrip(" "))]
    # The line above ends at the last break before this line, and begins at the one before that.
    breaks = list(LINE_BREAK.finditer(text, 0, begin))
    newline = breaks[-1].group() if breaks else (match.group() if (match := LINE_BREAK.search(text)) else "\n")
    if breaks:
        above = breaks[-2].end() if len(breaks) > 1 else 0
        present = text[above : breaks[-1].start()].strip(" ")
        if present == f"# {edit.comment}":
            return text
        # A comment of the same origin is replaced, so that repeated changes do not pile up.
        if edit.replaces and present.startswith(f"# {edit.replaces}"):
            return f"{text[:above]}{indent}# {edit.comment}{text[breaks[-1].start() :]}"
    return f"{text[:begin]}{indent}# {edit.comment}{newline}{text[begin:]}"
