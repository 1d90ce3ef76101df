"""A file of finished work, a line each, that survives whatever kills the process.

The first line says what the work is for; each of the others is a record with a key. Numbers come back to the last bit.
"""

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mirdrake.core.errors import RunError
from mirdrake.core.files import write_errors
from mirdrake.core.json_io import parse_json

Record = dict[str, Any]


class Journal:
    """Records by key, in memory and, if it has a file, on disk as soon as they are added.

    Args:
        file: made with its folder if it is not there; None keeps everything in memory.
        purpose: what the work is for, plain data; a file with another purpose is refused.

    Raises:
        RunError: the file was begun for another purpose, is none of these, or cannot be written.
    """

    def __init__(self, file: Path | str | None, purpose: Mapping[str, Any]) -> None:
        self.file = Path(file) if file is not None else None
        self.records: dict[str, Record] = {}
        self._purpose = json.loads(json.dumps(purpose, sort_keys=True))
        if self.file is None:
            return
        with write_errors(self.file):
            self.file.parent.mkdir(parents=True, exist_ok=True)
            text = self.file.read_bytes() if self.file.is_file() else b""
        whole = text[: text.rfind(b"\n") + 1]  # a kill may have left half a line
        if whole:
            self._read(whole.decode(errors="replace").splitlines())
            if len(whole) < len(text):
                with write_errors(self.file):
                    os.truncate(self.file, len(whole))
        else:
            with write_errors(self.file), self.file.open("wb") as stream:
                stream.write(self._line({"purpose": self._purpose}))

    def __contains__(self, key: object) -> bool:
        return str(key) in self.records

    def __getitem__(self, key: object) -> Record:
        return self.records[str(key)]

    def __len__(self) -> int:
        return len(self.records)

    def add(self, key: object, record: Record) -> None:
        """Add a record; plain data."""
        self.records[str(key)] = record
        if self.file is not None:
            with write_errors(self.file), self.file.open("ab") as stream:
                stream.write(self._line({"key": str(key), **record}))

    def _read(self, lines: list[str]) -> None:
        try:
            head, *entries = [parse_json(line) for line in lines]
            purpose = head["purpose"]
            self.records = {entry.pop("key"): entry for entry in entries}
        except (ValueError, KeyError, TypeError, AttributeError):
            raise RunError(f"{self.file}: is no journal of finished work; choose another file") from None
        if purpose != self._purpose:
            raise RunError(f"{self.file}: was begun for something else ({self._difference(purpose)}); choose another")

    def _difference(self, other: Any) -> str:
        names = set(self._purpose) | set(other) if isinstance(other, dict) else set()
        return ", ".join(sorted(name for name in names if other.get(name) != self._purpose.get(name))) or "its purpose"

    @staticmethod
    def _line(data: Mapping[str, Any]) -> bytes:
        return (json.dumps(data) + "\n").encode()
