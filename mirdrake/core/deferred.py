"""Names of a package that load their module, and what it imports, when they are first used (PEP 562)."""

import sys
from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any


def defer(package: str, modules: Mapping[str, str]) -> Callable[[str], Any]:
    """Return the ``__getattr__`` of a package for names that are loaded when they are first used.

    Args:
        package: its ``__name__``.
        modules: the module of the package that has each name.
    """

    def load(name: str) -> Any:
        # `from package import module` comes here first; this error makes Python look for the module.
        if name not in modules:
            raise AttributeError(f"module '{package}' has no attribute '{name}'")
        value = getattr(import_module(f"{package}.{modules[name]}"), name)
        # Found without this function from now on.
        setattr(sys.modules[package], name, value)
        return value

    return load
