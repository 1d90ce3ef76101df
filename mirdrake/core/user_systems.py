"""User systems: classes in user modules, named ``module:Class``."""

import inspect
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from pydrake.systems.framework import System

from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.user_modules import import_user_module


def make_user_system(
    kind: str,
    parameters: Mapping[str, Any],
    *,
    where: str,
    folder: Path | None = None,
    offered: Mapping[str, Any] | None = None,
    locate: Callable[[str], str] | None = None,
) -> System:
    """Construct a user system.

    Args:
        kind: ``module:Class``; the class must be a Drake system.
        parameters: arguments of its constructor.
        where: ``file:line: path`` of the entry, for errors.
        folder: searched for the module besides the import path and the working directory.
        offered: further arguments, which are passed if the constructor has parameters of these names.
        locate: returns ``file:line: path`` of a parameter, for errors; without it they have `where`.

    Raises:
        ConfigError: the module or class does not exist, a number is given as text, or the constructor rejects the
            parameters.
    """
    maker, offered = _load_class(kind, where=where, folder=folder), offered or {}
    arguments = dict(parameters)
    named = _named(maker)
    # Extra arguments are passed only to constructors that name them, which keeps simple user systems simple.
    allowed = [p.name for p in named if p.kind in (p.POSITIONAL_OR_KEYWORD, p.KEYWORD_ONLY)]
    # With **options, the constructor itself must decide what it accepts.
    if named and not any(p.kind is p.VAR_KEYWORD for p in named):
        for name in arguments:
            if name not in allowed:
                known = [own for own in allowed if own not in offered]
                raise ConfigError(f"{kind} has no parameter '{name}'; {did_you_mean(name, known)}", where=where)
    # Code would use the text in a computation and fail in the middle of a run.
    for argument in named:
        value = arguments.get(argument.name)
        if isinstance(value, str) and _takes_number(argument):
            location = locate(argument.name) if locate is not None else f"{where}: {argument.name}"
            class_name = kind.rpartition(":")[2]
            raise ConfigError(f"{location} is text '{value}'; {class_name} takes a number, in SI units")
    # The user's parameters win over the offered ones.
    arguments = {name: value for name, value in offered.items() if name in allowed} | arguments
    return construct(lambda: maker(**arguments), kind, where=where)


def user_defaults(kind: str, *, folder: Path | str | None = None) -> dict[str, object]:
    """Return the defaults of the arguments of a user system; none of a C++ class, whose signature is not known.

    Raises:
        ConfigError: the module or class does not exist.
    """
    maker = _load_class(kind, where=kind, folder=None if folder is None else Path(folder))
    return {argument.name: argument.default for argument in _named(maker) if argument.default is not argument.empty}


def sampling_period(kind: str, parameters: Mapping[str, Any], *, folder: Path | str | None = None) -> float | None:
    """Return the period of all events of a system [s]; None if it is not known.

    It is known of a class whose attribute `sampled_with` names the argument that has it, by its default if it is not
    given.
    """
    if ":" not in kind:
        return None
    try:
        maker = _load_class(kind, where=kind, folder=None if folder is None else Path(folder))
    except ConfigError:  # it is reported when the system is made
        return None
    argument = getattr(maker, "sampled_with", "")
    defaults = {own.name: own.default for own in _named(maker)}
    period = parameters.get(argument, defaults.get(argument))
    return float(period) if isinstance(period, int | float) and period > 0.0 else None


def _named(maker: type[System]) -> tuple[inspect.Parameter, ...]:
    try:
        return tuple(inspect.signature(maker).parameters.values())
    except ValueError:  # C++ classes have no signature
        return ()


def _takes_number(argument: inspect.Parameter) -> bool:
    """Return whether a parameter is a number by its annotation; by its default if it has no annotation."""
    if argument.annotation is argument.empty:
        return isinstance(argument.default, int | float) and not isinstance(argument.default, bool)
    # Types, unions, and the texts that `from __future__ import annotations` makes of them, have the same names.
    annotation = argument.annotation
    types = set(re.findall(r"\w+", annotation.__name__ if isinstance(annotation, type) else str(annotation)))
    types -= {"None", "NoneType", "typing", "Optional", "Union"}
    return bool(types) and types <= {"int", "float"}


def construct(factory: Callable[[], System], kind: str, *, where: str) -> System:
    """Return the system that a factory makes.

    Args:
        factory: makes the system.
        kind: name of its class, for errors.
        where: ``file:line: path`` of the entry, for errors.

    Raises:
        ConfigError: the constructor rejects its arguments.
    """
    try:
        return factory()
    except ConfigError as error:
        raise error.under(where) from None
    except KeyboardInterrupt:
        raise
    # User code may raise anything, SystemExit and GeneratorExit as well; the program must name the location.
    except BaseException as error:
        lines = [line.strip() for line in str(error).splitlines() if line.strip()]
        text = lines[0] if lines else ""
        if len(lines) > 1 and "incompatible constructor arguments" in text:  # of pydrake: the first signature
            text = f"its arguments do not fit {lines[1].removeprefix('1. ').split('.')[-1]}"
        raise ConfigError(f"{kind} cannot be made: {type(error).__name__}: {text}", where=where) from None


def _load_class(kind: str, *, where: str, folder: Path | None) -> type[System]:
    """Load the class ``module:Class``."""
    module_name, _, class_name = kind.partition(":")
    try:
        module = import_user_module(module_name, folder=folder)
    except ConfigError as error:
        raise error.under(where) from None
    maker = getattr(module, class_name, None)
    if not isinstance(maker, type) or not issubclass(maker, System):
        # Imported classes are not offered as suggestions, only those that the module defines.
        own = {name: value for name, value in vars(module).items() if getattr(value, "__module__", "") == module_name}
        classes = [name for name, value in own.items() if isinstance(value, type) and issubclass(value, System)]
        raise ConfigError(
            f"'{class_name}' is not a Drake system in {module_name}; {did_you_mean(class_name, classes)}", where=where
        )
    return maker
