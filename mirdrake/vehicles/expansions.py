"""Expanded models of this process, which are expanded again only if something has changed.

An expansion depends on its arguments, on the working directory, which is in its messages, and on the contents of the
files that it read; these are compared byte by byte. One that depends on anything else, as on an environment variable or
on a pattern of file names, is not kept.
"""

import os
from collections import OrderedDict
from collections.abc import Callable, Hashable, Mapping
from pathlib import Path
from typing import Generic, TypeVar

T = TypeVar("T")

KEPT = 32
"""Number of results that are kept."""


class Expansions(Generic[T]):
    """Results by key, with the files that each depends on; the least recently used are dropped."""

    def __init__(self) -> None:
        self._kept: OrderedDict[Hashable, tuple[Mapping[Path, bytes], T]] = OrderedDict()

    def get(self, key: Hashable, make: Callable[[], tuple[T, Mapping[Path, bytes] | None]]) -> T:
        """Return a result, from before if its files are the same.

        Args:
            key: what the result depends on besides files and the working directory.
            make: makes the result, and returns the contents of all files that it depends on; None: it is not kept.
        """
        key = (os.getcwd(), key)
        known = self._kept.pop(key, None)
        if known is None or not all(_has(path, content) for path, content in known[0].items()):
            result, files = make()
            if files is None:
                return result
            known = (dict(files), result)
        self._kept[key] = known
        while len(self._kept) > KEPT:
            self._kept.popitem(last=False)
        return known[1]


def _has(path: Path, content: bytes) -> bool:
    """Return whether a file has this content."""
    try:
        return path.stat().st_size == len(content) and path.read_bytes() == content
    except OSError:
        return False
