"""Numbers and names as a reader wants them."""

import math


def tell(value: float, unit: str = "", *, digits: int = 3) -> str:
    """A number to so many significant digits, with its unit: ``0.124 m``, ``965 m``, ``12 340 N``, ``–`` for none."""
    if value is None or not math.isfinite(value):
        return "–"
    if value == 0.0 or abs(value) < 1e-6:
        text = "0"
    else:
        decimals = min(max(0, digits - 1 - math.floor(math.log10(abs(value)))), 4)
        text = f"{value:,.{decimals}f}".replace(",", "\u202f").replace("-", "−")
        if float(f"{value:.{decimals}f}") == 0.0:
            text = f"{value:.1g}".replace("-", "−")
    if not unit:
        return text
    return f"{text}{unit}" if unit in {"°", "×"} else f"{text}\u00a0{unit}"


def clock(seconds: float) -> str:
    """A time of the run: ``83.2 s``, above ten minutes ``16 min 40 s``."""
    if not math.isfinite(seconds):
        return "–"
    if seconds < 600.0:
        return f"{seconds:.1f}\u00a0s"
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes}\u00a0min {rest:02d}\u00a0s"


def lasting(seconds: float) -> str:
    """A duration, rounded: ``0.50 s``, ``200 s``, ``60 min``."""
    return tell(seconds, "s") if seconds < 600.0 else f"{tell(seconds / 60.0)}\u00a0min"


def spoken(name: str) -> str:
    """A file name as a name: ``cat_vehicle`` → ``Cat vehicle``."""
    text = name.replace("_", " ").strip()
    return text[:1].upper() + text[1:]
