"""Whole files or none, and what the file system says when it refuses, on one line."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from mirdrake.errors import RunError


def write_file(path: Path, content: str | bytes) -> None:
    """Write a whole file or nothing: to a temporary name, then renamed.

    Raises:
        RunError: it cannot be written.
    """
    temporary = path.with_name(f".{path.name}.tmp")
    try:
        with told(path):
            temporary.write_bytes(content.encode() if isinstance(content, str) else content)
            os.replace(temporary, path)
    except RunError:
        with suppress(OSError):  # below a file, or in a folder that is not there
            temporary.unlink(missing_ok=True)
        raise


@contextmanager
def told(path: Path) -> Iterator[None]:
    """Failures of the file system as RunError."""
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error).splitlines()[0]
        raise RunError(f"{path}: cannot be written: {reason}; choose another folder with --out") from None
