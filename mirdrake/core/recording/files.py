"""Whole files or none, and what the file system says when it refuses, on one line."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pyarrow as pa
import yaml

from mirdrake.core.errors import ConfigError, MirdrakeError, RunError


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


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Raise whatever a damaged file of a run folder causes as a ConfigError with one line."""
    try:
        yield
    except MirdrakeError:
        raise
    except (*_DAMAGE, RecursionError, yaml.YAMLError, pa.ArrowException) as error:
        reason = getattr(error, "strerror", None) or next(iter(str(error).splitlines()), "") or type(error).__name__
        raise ConfigError(f"{path}: damaged, cannot be read: {reason[:160]}") from error


_DAMAGE = (OSError, ValueError, TypeError, LookupError, AttributeError, ArithmeticError, SyntaxError)
