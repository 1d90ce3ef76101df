"""Where gains are searched: the ranges of a file, or around those of the rules, and around the best trials."""

from collections.abc import Iterable, Mapping
from typing import Any

from mirdrake.core.errors import ConfigError
from mirdrake.core.yaml_io import where
from mirdrake.tuning.loops.base import LoopSpec
from mirdrake.tuning.loops.reduced import find_loop_margins
from mirdrake.tuning.outcome import Candidate
from mirdrake.tuning.spec import TuningSpec
from mirdrake.tuning.trials import Trial, Trials


def search_space(spec: TuningSpec, loop: LoopSpec, known: list[dict[str, float]]) -> dict[str, dict[str, Any]]:
    """Range of each gain: the file's, or a decade around those of the rules.

    Raises:
        ConfigError: neither gives one.
    """
    space: dict[str, dict[str, Any]] = {}
    for gain in loop.gains:
        if gain in spec.search.ranges:
            space[gain] = spec.search.ranges[gain].model_dump()
            continue
        if gain in loop.options.get("ranges", {}):
            space[gain] = dict(loop.options["ranges"][gain])
            continue
        given = [gains[gain] for gains in known if gains[gain] > 0.0]
        if not given:
            raise ConfigError(
                f"{where(spec, 'search', 'ranges')}: no rule gives a value of {gain}; write a range for it"
            )
        low, high = min(given) / 3.0, max(given) * 3.0
        if gain == "kp":
            space[gain] = {"low": low, "high": high, "scale": "log"}
        else:  # may be left out
            space[gain] = {"low": 0.0, "high": max(given) * 1.5, "scale": "linear"}
    return space


def near_the_limits(loop: LoopSpec, tried: list[Candidate], max_sensitivity: float) -> list[Candidate]:
    """Of the rules those that are not far above the largest Ms allowed; all if these are too few for a range."""
    limit = 1.5 * max_sensitivity
    mild = [one for one in tried if find_loop_margins(loop, one.design.gains)["ms"] <= limit]
    return mild if len(mild) > 2 else tried


def known_starts(
    space: Mapping[str, Mapping[str, Any]], *groups: Iterable[Candidate] | Iterable[Trial]
) -> list[dict[str, float]]:
    """Known gains to begin with: those within the ranges, the best first."""
    starts: list[dict[str, float]] = []
    for group in groups:
        for one in group:
            gains = dict(one.design.gains if isinstance(one, Candidate) else one.gains)
            inside = all(entry["low"] <= gains[name] <= entry["high"] for name, entry in space.items())
            if inside and gains not in starts:
                starts.append(gains)
    return starts


def leaders_of(coarse: Trials) -> list[Trial]:
    """The best trials of the reduced model."""
    ranked = sorted(coarse.trials, key=lambda one: (one.violation, one.cost, one.number))
    return [one for one in ranked if one.status == "ok"][:5]


def space_around(space: dict[str, dict[str, Any]], leaders: list[Trial]) -> dict[str, dict[str, Any]]:
    """The part of the space around the best trials."""
    if not leaders:
        return space
    near = {}
    for gain, entry in space.items():
        values = [one.gains[gain] for one in leaders]
        if entry["scale"] == "log":
            low, high = min(values) / 2.0, max(values) * 1.5
        else:
            width = 0.25 * (entry["high"] - entry["low"])
            low, high = min(values) - width, max(values) + width
        near[gain] = {**entry, "low": max(low, entry["low"]), "high": min(high, entry["high"])}
    return near
