"""Packages of the extras of mirdrake, which are imported only when they are needed."""

from importlib import import_module
from typing import Any

from mirdrake.core.errors import MissingDependencyError


def import_extra(module: str, *, need: str, extra: str, otherwise: str = "", where: str = "") -> Any:
    """Return a module of an extra.

    Args:
        module: name of the module.
        need: what needs which package, for the error.
        extra: name of the extra.
        otherwise: what else the user can do, for the error.
        where: place of what needs it, for the error.

    Raises:
        MissingDependencyError: it is not installed.
    """
    try:
        return import_module(module)
    except ImportError:
        raise MissingDependencyError(f"{need}: pip install 'mirdrake[{extra}]'{otherwise}", where=where) from None
