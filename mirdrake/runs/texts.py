"""The end and the figures of a run, from its summary, in words for a reader."""

from collections.abc import Mapping
from typing import Any

from mirdrake.runs.stop import StopReason

_STOPS: Mapping[str, str] = {
    StopReason.DURATION: "ran for its whole duration",
    StopReason.LAPS: "all laps driven",
    StopReason.CONDITION: "stopped by its condition",
    StopReason.INTERRUPTED: "interrupted; what was done is kept",
    StopReason.KILLED: "killed; what was written is kept",
}
_FIGURES = {
    "laps": "{:.3f} laps",
    "max_abs_lateral_error_m": "largest lateral error {:.3f} m",
    "mean_speed_error_percent": "mean speed error on straights {:.3f} %",
    "off_road_s": "off the road for {:.2f} s",
}


def describe_stop(summary: Mapping[str, Any]) -> str:
    """Return how a run ended; empty if its summary does not have it."""
    reason, detail = summary.get("stop_reason"), summary.get("stop_detail")
    return ": ".join(str(text) for text in (_STOPS.get(str(reason), reason), detail) if text)


def describe_figures(figures: Mapping[str, Any]) -> list[str]:
    """Return the figures that a vehicle has in a summary."""
    return [text.format(figures[key]) for key, text in _FIGURES.items() if isinstance(figures.get(key), int | float)]
