"""Functions of a registry that a mapping of a diagram file selects by its ``kind``."""

from collections.abc import Callable, Mapping
from typing import TypeVar

from mirdrake.core.checks import checks_arguments
from mirdrake.core.errors import ConfigError, did_you_mean

T = TypeVar("T")


def make_by_kind(data: Mapping[str, object], registry: Mapping[str, Callable[..., T]], *, what: str) -> T:
    """Return the result of the function that ``kind`` names; the other keys are its arguments.

    Args:
        data: for example ``{kind: circle, radius: 100, turn: 1}``.
        registry: functions by kind.
        what: name of what they make, for error messages.

    Raises:
        ConfigError: the kind is unknown, or the function does not take these arguments.
    """
    arguments = dict(data)
    kind = str(arguments.pop("kind", None))
    if kind not in registry:
        raise ConfigError(f"unknown kind '{kind}'; {did_you_mean(kind, registry)}", where=what)
    try:
        return checks_arguments(registry[kind], f"{what} {kind}")(**arguments)
    except TypeError as error:
        raise ConfigError(str(error), where=f"{what} {kind}") from None
