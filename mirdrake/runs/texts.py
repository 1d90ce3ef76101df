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


STRAIGHT_ON = 5e-4
"""Lateral error below which a vehicle drives straight on: a test of the speed does not steer [m]."""


def describe_stop(summary: Mapping[str, Any]) -> str:
    """Return how a run ended; empty if its summary does not have it."""
    reason, detail = summary.get("stop_reason"), summary.get("stop_detail")
    return ": ".join(str(text) for text in (_STOPS.get(str(reason), reason), detail) if text)


def describe_findings(summary: Mapping[str, Any]) -> list[str]:
    """Return what a reader of a run should know though it did not end the run."""
    lines = []
    for name, figures in (summary.get("vehicles") or {}).items():
        missed = figures.get("speed_missed")
        if missed:
            lines.append(
                f"{name}: speed is {missed['error_mps']:.2g} m/s away from its set-point for "
                f"{missed['duration_s']:.3g} s, from t = {missed['from_s']:.3g} s on"
            )
        wheel = figures.get("wheel_oscillation")
        if wheel:
            lines.append(
                f"{name}: the {wheel['wheel']} wheel oscillates at {wheel['frequency_hz']:.2g} Hz, by "
                f"{wheel['amplitude_radps']:.2g} rad/s about {wheel['speed_radps']:.2g} rad/s, for "
                f"{wheel['duration_s']:.3g} s, from t = {wheel['from_s']:.3g} s on: it slips; "
                "lower gains of wheel_speed, or slower set-points, prevent this"
            )
    return lines


def describe_figures(figures: Mapping[str, Any]) -> list[str]:
    """Return the figures that a vehicle has in a summary, without the lateral error of one that drives straight on."""
    return [
        text.format(figures[key])
        for key, text in _FIGURES.items()
        if isinstance(figures.get(key), int | float)
        and not (key == "max_abs_lateral_error_m" and figures[key] < STRAIGHT_ON)
    ]
