"""A journal of finished work: a file with one JSON record per line, which survives whatever ends the process.

Each record has a key. The first line may state the purpose of the work, so that a journal is not continued for another
one. Numbers are restored bit for bit.
"""

import json
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from mirdrake.core.errors import RunError
from mirdrake.core.files import read_errors, write_errors, write_file
from mirdrake.core.json_io import Json, parse_json

Record = Json
"""Plain data, as JSON has it."""


class Journal:
    """Records by key, in memory and, if there is a file, on disk as soon as they are added.

    Args:
        file: it is created with its folder if it does not exist; None keeps the records in memory.
        purpose: plain data about the work, written to the first line; None for a file whose folder states the purpose.
        key: name under which the key is written in the line of a record.

    Raises:
        RunError: the file was begun for another purpose, or cannot be written.
        ConfigError: the file is damaged, or not a journal.
    """

    def __init__(self, file: Path | str | None, purpose: Mapping[str, Any] | None = None, *, key: str = "key") -> None:
        self.file = Path(file) if file is not None else None
        self.records: dict[str, Record] = {}
        self._key = key
        # Through JSON and back, so that tuples and numbers compare equal with what a file returns.
        self._header = [] if purpose is None else [{"purpose": json.loads(json.dumps(purpose, sort_keys=True))}]
        if self.file is None:
            return
        with write_errors(self.file):
            self.file.parent.mkdir(parents=True, exist_ok=True)
            text = self.file.read_bytes() if self.file.is_file() else b""

        # A kill may have left half a line, to which the next record must not be appended.
        complete = len(_complete_lines(text))
        if complete:
            self._read(text)
            if complete < len(text):
                with write_errors(self.file):
                    os.truncate(self.file, complete)
        else:
            self._write()

    def __contains__(self, key: object) -> bool:
        return str(key) in self.records

    def __getitem__(self, key: object) -> Record:
        return self.records[str(key)]

    def __len__(self) -> int:
        return len(self.records)

    def add(self, key: object, record: Record) -> None:
        """Add a record."""
        self.records[str(key)] = record
        if self.file is not None:
            # Opened for each record: nothing is left in a buffer when the process is killed.
            with write_errors(self.file), self.file.open("ab") as stream:
                stream.write(self._line(str(key)))

    def keep(self, keys: Iterable[object]) -> None:
        """Keep the records of these keys, in this order, and remove all others."""
        self.records = {str(key): self.records[str(key)] for key in keys}
        self._write()

    def _write(self) -> None:
        if self.file is not None:
            write_file(self.file, b"".join([*map(_encoded, self._header), *map(self._line, self.records)]))

    def _line(self, key: str) -> bytes:
        return _encoded({**self.records[key], self._key: key})

    def _read(self, text: bytes) -> None:
        assert self.file is not None
        lines = _parse(self.file, text)
        if self._header:
            with read_errors(self.file):
                # The first line is compared before any record is used; records of other work must not be mixed in.
                purpose, expected = lines.pop(0)["purpose"], self._header[0]["purpose"]
                names = sorted(name for name in {*purpose, *expected} if purpose.get(name) != expected.get(name))
            if names:
                raise RunError(
                    f"was begun for another purpose ({', '.join(names)}); choose another file", where=str(self.file)
                )
        with read_errors(self.file):
            self.records = {entry.pop(self._key): entry for entry in lines}


def read_records(file: Path, *, key: str = "key") -> dict[str, Record]:
    """Return the records of a journal without a purpose; a file that does not exist has none.

    Raises:
        ConfigError: the file is damaged, or not a journal.
    """
    if not file.is_file():
        return {}
    with read_errors(file):
        return {entry.pop(key): entry for entry in _parse(file, file.read_bytes())}


def _parse(file: Path, text: bytes) -> list[Record]:
    """Return the objects of all complete lines."""
    with read_errors(file):
        return [dict(parse_json(line)) for line in _complete_lines(text).decode().splitlines()]


def _complete_lines(text: bytes) -> bytes:
    return text[: text.rfind(b"\n") + 1]


def _encoded(record: Record) -> bytes:
    return (json.dumps(record) + "\n").encode()
