"""Numbers and poses in the text of XML files, with errors that name the place."""

import math
from collections import Counter
from collections.abc import Sequence
from xml.etree.ElementTree import Element

import numpy as np
from pydrake.math import RigidTransform, RollPitchYaw

from mirdrake.core.errors import ModelError
from mirdrake.importing.shape import Vector


def read_numbers(text: str | None, *, count: int, default: Sequence[float], where: str, what: str) -> Vector:
    """Return numbers from a text; `default` if the text is missing.

    Raises:
        ModelError: not so many finite numbers.
    """
    if text is None or not text.strip():
        return np.array(default, dtype=float)
    try:
        values = [float(word) for word in text.split()]
    except ValueError:
        values = []
    if len(values) != count or not all(map(math.isfinite, values)):
        wanted = f"{count} finite numbers" if count > 1 else "a finite number"
        raise ModelError(f"{what} '{' '.join(text.split())[:60]}' should be {wanted}{_template(text)}", where=where)
    return np.array(values)


def read_number(text: str | None, *, where: str, what: str) -> float | None:
    """Return a number, which may be infinite; None if the text is missing.

    Raises:
        ModelError: the text is not a number.
    """
    if text is None or not text.strip():
        return None
    value = to_number(text)
    if value is None or math.isnan(value):
        raise ModelError(f"{what} '{text.strip()[:60]}' should be a number{_template(text)}", where=where)
    return value


def to_number(text: str) -> float | None:
    """Return the number in a text, which may be infinite or NaN; None for any other text."""
    try:
        return float(text)
    except ValueError:
        return None


def _template(text: str) -> str:
    """Return advice for an expression that a template program should have replaced."""
    for mark, name in (("${", "xacro"), ("$(", "xacro"), ("<%", "ERB"), ("{{", "Jinja"), ("@(", "Empy")):
        if mark in text:
            return f"; it is an expression of {name} that was not expanded: give the expanded file"
    return ""


def make_pose(xyz: Sequence[float] | Vector, rpy: Sequence[float] | Vector) -> RigidTransform:
    """Return a pose from position [m] and roll, pitch, yaw [rad]."""
    return RigidTransform(RollPitchYaw(*[float(angle) for angle in rpy]), [float(value) for value in xyz])


def leaves(element: Element, prefix: str = "") -> dict[str, str]:
    """Return texts and attributes of all elements below one by dotted path; repeated tags are ``tag[2]``."""
    values: dict[str, str] = {}
    count: Counter[str] = Counter()
    for child in element:
        count[child.tag] += 1
        path = f"{prefix}{child.tag}" + (f"[{count[child.tag]}]" if count[child.tag] > 1 else "")
        for key, value in child.attrib.items():
            values[f"{path}.{key}"] = value
        if len(child):
            values |= leaves(child, f"{path}.")
        elif (child.text or "").strip():
            values[path] = (child.text or "").strip()
    return values
