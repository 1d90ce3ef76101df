"""Time columns that are not seconds since the start: steps from row to row, dates, and times of day."""

import re
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

Array = NDArray[np.float64]

_LONG = 1.0
"""Largest step from row to row [s]."""

MIN_ROWS = 20
"""Least number of samples of a log."""

MAX_BACKWARD_SHARE = 0.01
"""Largest share of rows whose time may precede that of an earlier row; more is an error, or not a clock."""


_CLOCK = r"\d{1,2}:\d\d:\d\d(\.\d+)?"
_ISO = re.compile(rf"\d{{4}}-\d\d-\d\d[T ]{_CLOCK}(Z|[+-]\d\d:?\d\d)?")
_NAMED_MONTH = re.compile(rf"\d{{1,2}}-[A-Za-z]{{3}}-\d{{4}} {_CLOCK}")
_TIME_OF_DAY = re.compile(_CLOCK)
_LEAST_DATES = 0.98
"""Least share of the cells of a column of dates that are dates."""


def seconds_of_texts(cells: "pd.Series[Any]") -> Array | None:
    """Return the seconds of dates with times, or of times of day (n), NaN for other cells; None for another column.

    Dates are those of ISO 8601, ``2026-03-01T12:00:00.5Z``, or with the name of the month, ``01-Mar-2026 12:00:00.5``;
    their seconds are since 1970. Times of day continue over midnights.

    Args:
        cells: column of texts.
    """
    texts = cells.astype("string").str.strip()
    known = texts[texts.notna()]
    if not len(known):
        return None
    for form in (_ISO, _NAMED_MONTH, _TIME_OF_DAY):
        if form.fullmatch(str(known.iloc[0])) is None or known.str.fullmatch(form).mean() < _LEAST_DATES:
            continue
        texts = texts.where(texts.str.fullmatch(form).fillna(False))
        if form is _TIME_OF_DAY:
            parts = texts.str.split(":", expand=True).astype("Float64").to_numpy(dtype=float, na_value=np.nan)
            return seconds_of_day(parts @ [1e4, 1e2, 1.0])
        dates = pd.to_datetime(texts, format="ISO8601" if form is _ISO else "mixed", utc=True, errors="coerce")
        microseconds = (dates - pd.Timestamp(0, tz="UTC")) / pd.Timedelta(microseconds=1)
        return np.asarray(microseconds, dtype=float) * 1e-6
    return None


def has_step_durations(time: Array) -> bool:
    """Whether a column contains the duration of each row: small values that decrease about as often as they increase.

    Args:
        time: the column (n) [s].
    """
    if not np.isfinite(time).all() or len(time) < MIN_ROWS:
        return False
    changes = np.diff(time)
    less, more = float(np.mean(changes < 0.0)), float(np.mean(changes > 0.0))
    return bool(time.min() >= 0.0 and 0.0 < np.median(time) < _LONG and less > max(MAX_BACKWARD_SHARE, 0.3 * more))


def is_time_of_day(numbers: Array) -> bool:
    """Whether numbers are HHMMSS.SS: no minute has more than 60 s, and each continues in the next.

    Args:
        numbers: the column (n); numbers within one minute are ambiguous and not accepted.
    """
    used = numbers[np.isfinite(numbers)]
    if len(used) < MIN_ROWS or used.min() < 0.0 or used.max() >= 240000.0:
        return False
    seconds, minutes, steps = used % 100.0, used // 100.0 % 100.0, np.diff(used)
    # HHMMSS jumps at each full minute, since 60 to 99 do not occur.
    over = np.flatnonzero(np.abs(steps) > 20.0)
    if not len(over) or seconds.max() >= 60.0 or minutes.max() >= 60.0:
        return False
    near = 3.0 * float(np.median(steps))
    return bool(np.all(seconds[over] > 60.0 - near) and np.all(seconds[over + 1] < near))


def seconds_of_day(clock: Array) -> Array:
    """Return seconds since the first midnight for HHMMSS.SS, continued over midnights.

    Args:
        clock: the column (n).
    """
    hours, rest = np.divmod(clock, 1e4)
    minutes, seconds = np.divmod(rest, 1e2)
    seconds_of_day = 3600.0 * hours + 60.0 * minutes + seconds
    # A step back by more than half a day is a midnight.
    midnights = np.append(0.0, np.cumsum(np.diff(seconds_of_day) < -43200.0))
    return np.asarray(seconds_of_day + 86400.0 * midnights)
