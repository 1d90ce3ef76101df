"""Marks that several test files share."""

from collections.abc import Iterable
from typing import Any

import pytest


def mostly_slow(values: Iterable[Any], *, fast: int = 1) -> list[Any]:
    """Return parameters of which the first ones belong to the fast tests and the others to the slow ones."""
    return [
        value
        if index < fast
        else pytest.param(*(value if isinstance(value, tuple) else (value,)), marks=pytest.mark.slow)
        for index, value in enumerate(values)
    ]
