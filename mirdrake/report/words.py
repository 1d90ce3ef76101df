"""Numbers, durations and names as texts for a reader."""

import math

from mirdrake.readers.units import format_unit

_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def format_quantity(value: float | None, unit: str = "", *, digits: int = 3) -> str:
    """Return a number with its unit: ``0.124 m``, ``965 m``, ``12 340 N``; ``–`` for a missing or non-finite one.

    Args:
        value: the number.
        unit: its unit; powers are written as superscripts (``kg m^2`` becomes ``kg m²``).
        digits: significant digits, at most four decimals.
    """
    if value is None or not math.isfinite(value):
        return "–"
    if value == 0.0 or abs(value) < 1e-6:
        text = "0"
    else:
        # Digits count, not decimals, but at most four decimals: more would claim an accuracy that no simulation has.
        decimals = min(max(0, digits - 1 - math.floor(math.log10(abs(value)))), 4)
        text = f"{value:,.{decimals}f}".replace(",", "\u202f").replace("-", "−")
        # A small value must not be rounded to zero.
        if float(f"{value:.{decimals}f}") == 0.0:
            text = format_significant(value, 1)
    if not unit:
        return text
    return f"{text}{unit}" if unit in {"°", "×"} else f"{text}\u00a0{format_unit(unit)}"


def format_significant(value: float, digits: int = 4) -> str:
    """Return a finite number with significant digits: ``100 800``, ``0.04036``, ``−4.36·10⁻⁵``."""
    text = f"{value:.{digits}g}"
    mantissa, mark, exponent = text.partition("e")
    if mark and 0 <= int(exponent) < 7:
        # Four digits stay together, as in numbers that have no exponent.
        text = f"{float(text):{',' if int(exponent) > 3 else ''}.0f}".replace(",", "\u202f")
    elif mark:
        text = f"{mantissa}·10{str(int(exponent)).translate(_SUPERSCRIPTS)}"
    return text.replace("-", "−")


def format_time(seconds: float) -> str:
    """Return a time of a run: ``83.2 s``; from ten minutes on ``16 min 40 s``."""
    if not math.isfinite(seconds):
        return "–"
    if seconds < 600.0:
        return f"{seconds:.1f}\u00a0s"
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes}\u00a0min {rest:02d}\u00a0s"


def format_duration(seconds: float) -> str:
    """Return a rounded duration: ``0.50 s``, ``200 s``, ``60 min``."""
    return format_quantity(seconds, "s") if seconds < 600.0 else f"{format_quantity(seconds / 60.0)}\u00a0min"


def title_case(name: str) -> str:
    """Return the name of a file or key as a title: ``cat_vehicle`` → ``Cat vehicle``."""
    text = name.replace("_", " ").strip()
    return text[:1].upper() + text[1:]
