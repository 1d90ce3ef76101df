"""Conversion of systems of python-control, if it is installed."""

from importlib import import_module
from typing import Any

from mirdrake.core.errors import ConfigError, MissingDependencyError


def control_library() -> Any:
    """Return the module ``control``.

    Raises:
        MissingDependencyError: it is not installed.
    """
    try:
        return import_module("control")
    except ImportError:
        raise MissingDependencyError(
            "models of python-control need python-control: pip install 'mirdrake[tuning]'"
        ) from None


def polynomials_of(system: Any) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return numerator and denominator of a linear system of python-control, highest power first.

    Raises:
        ConfigError: not a continuous system of one input and one output.
        MissingDependencyError: python-control is not installed.
    """
    control = control_library()
    if not isinstance(system, control.TransferFunction | control.StateSpace):
        raise ConfigError(f"a control.TransferFunction or control.StateSpace is needed, got {type(system).__name__}")
    if not system.issiso():
        raise ConfigError(f"one input and one output are needed, got {system.ninputs} and {system.noutputs}")
    if not system.isctime():
        raise ConfigError(f"a continuous system is needed, this one is sampled every {system.dt} s")
    fraction = control.tf(system) if isinstance(system, control.StateSpace) else system
    return tuple(fraction.num[0][0].tolist()), tuple(fraction.den[0][0].tolist())
