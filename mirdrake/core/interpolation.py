"""Tables of an argument and a value with linear interpolation, constant outside, and their inverse.

Rows are pairs, or an array (n, 2) for compiled functions.
"""

from typing import Any

Rows = Any
"""Rows (argument, value) with ascending arguments: a sequence of pairs, or an array (n, 2)."""


def read_map(rows: Rows, argument: float) -> float:
    """Return the value of a table at an argument."""
    low = 0
    if argument <= rows[0][0]:
        first: float = rows[0][1]
        return first
    for high in range(1, len(rows)):
        if argument < rows[high][0]:
            x0, y0, x1, y1 = rows[low][0], rows[low][1], rows[high][0], rows[high][1]
            value: float = y0 + (y1 - y0) * (argument - x0) / (x1 - x0)
            return value
        low = high
    last: float = rows[low][1]
    return last


def invert_map(rows: Rows, value: float) -> float:
    """Return the smallest argument at which a table with rising values reaches a value; the last one if it never does.

    For a value not above the first row's it is 0, not the end of the dead zone.
    """
    low = 0
    if value <= rows[0][1]:
        return 0.0
    for high in range(1, len(rows)):
        if value <= rows[high][1]:
            x0, y0, x1, y1 = rows[low][0], rows[low][1], rows[high][0], rows[high][1]
            argument: float = x0 + (x1 - x0) * (value - y0) / (y1 - y0)
            return argument
        low = high
    last: float = rows[low][0]
    return last


TABLE_PARTS = (read_map, invert_map)
"""Functions that can be compiled."""
