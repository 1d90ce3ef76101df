"""A YAML text with the values of other data, and everything else as it was written."""

from collections.abc import Mapping
from typing import Any

from mirdrake.core.errors import ConfigError
from mirdrake.core.yaml_edit import scalar_text
from mirdrake.core.yaml_items import insert_item, remove_item, set_scalar
from mirdrake.core.yaml_nodes import LINE_BREAK

Path = tuple[str, ...]

_WIDTH = 120  # characters of a line


def rewrite(text: str, before: Any, after: Any, *, name: str = "<text>", path: Path = ()) -> str:
    """Return a text changed where two data differ.

    Comments, order, units and layout of everything else stay. A value that cannot be changed alone, such as an element
    of a mapping that the text writes as a word, is replaced with the smallest part around it that can.

    Args:
        text: the text; empty, with no data before, for a new one.
        before: what its reader makes of it, which may have other units and written-out short forms.
        after: the same data with changes.
        name: name of the text in errors, normally the file name.
        path: path of the data in the text.

    Raises:
        ConfigError: there is no such part.
    """
    if before == after:
        return text
    try:
        if isinstance(before, Mapping) and isinstance(after, Mapping):
            return _rewrite_mapping(text, before, after, name, path)
        if isinstance(before, list) and isinstance(after, list):
            return _rewrite_list(text, before, after, name, path)
        return set_scalar(text, path, flow_text(after), name=name)
    except ConfigError:
        if not path:
            raise
    try:
        return set_scalar(text, path, flow_text(after), name=name)
    except ConfigError:
        # A part in lines can only be replaced with its key, at the end of the text.
        if len(path) > 1:
            raise
    return _appended(remove_item(text, path, name=name), _lines(f"{scalar_text(path[0])}:", after))


def _rewrite_mapping(text: str, before: Mapping[str, Any], after: Mapping[str, Any], name: str, path: Path) -> str:
    for key in [key for key in before if key not in after]:
        text = remove_item(text, (*path, key), name=name)
    for key, value in after.items():
        if key in before:
            text = rewrite(text, before[key], value, name=name, path=(*path, key))
        elif path:
            text = set_scalar(text, (*path, key), flow_text(value), name=name)
        else:
            text = _appended(text, _lines(f"{scalar_text(key)}:", value))
    return text


def _rewrite_list(text: str, before: list[Any], after: list[Any], name: str, path: Path) -> str:
    same = next((i for i, (old, new) in enumerate(zip(before, after, strict=False)) if old != new), None)
    same = min(len(before), len(after)) if same is None else same
    # The last one first, so that the numbers of the others stay.
    for index in reversed(range(same, len(before))):
        text = remove_item(text, (*path, str(index)), name=name)
    for item in after[same:]:
        text = insert_item(text, path, flow_text(item), name=name)
    # The key of a list goes with its last item.
    return text if after else set_scalar(text, path, "[]", name=name)


def flow_text(value: Any) -> str:
    """Return data as YAML on one line.

    Raises:
        ConfigError: a number is not finite.
    """
    if isinstance(value, Mapping):
        return f"{{{', '.join(f'{scalar_text(key)}: {flow_text(item)}' for key, item in value.items())}}}"
    if isinstance(value, list):
        return f"[{', '.join(map(flow_text, value))}]"
    return scalar_text(value)


def _lines(head: str, value: Any, indent: str = "") -> list[str]:
    """Return the lines of an entry: one if it fits and is not a key of the file with parts of their own."""
    line = f"{indent}{head} {flow_text(value)}"
    if not isinstance(value, Mapping | list) or not value:
        return [line]
    entries = [(f"{scalar_text(key)}:", item) for key, item in value.items()] if isinstance(value, Mapping) else [
        ("-", item) for item in value
    ]  # fmt: skip
    has_parts = any(isinstance(item, Mapping | list) for _, item in entries)
    if len(line) <= _WIDTH and (indent or not has_parts):
        return [line]
    return [f"{indent}{head}", *(part for name, item in entries for part in _lines(name, item, f"{indent}  "))]


def _appended(text: str, lines: list[str]) -> str:
    match = LINE_BREAK.search(text)
    newline = match.group() if match else "\n"
    gap = "" if not text or text.endswith(newline) else newline
    return f"{text}{gap}{newline.join(lines)}{newline}"
