"""Ranges in which gains are searched: those of a study, or around those of the rules, and around the best trials."""

import math
from collections.abc import Iterable, Sequence

from mirdrake.core.errors import ConfigError
from mirdrake.core.yaml_io import where
from mirdrake.tuning.loops.base import LoopSpec
from mirdrake.tuning.loops.reduced import find_loop_margins
from mirdrake.tuning.loops.registry import LOOP_KINDS
from mirdrake.tuning.search_range import Range, Space
from mirdrake.tuning.spec import TuningSpec
from mirdrake.tuning.trials import Trial

Gains = dict[str, float]

NEAR, NEAR_LINEAR = 1.25, 0.05
"""Margin of a search around the best trials: factor of a logarithmic range, share of a linear one [1]."""


def search_space(spec: TuningSpec, loop: LoopSpec, known: Sequence[Gains], max_sensitivity: float) -> Space:
    """Return the range of each gain: that of the study or of the kind of loop, or one around those of the rules.

    Args:
        spec: the study.
        loop: its loop.
        known: gains of the rules.
        max_sensitivity: largest allowed Ms [1]; rules far above it do not count, unless too few are left.

    Raises:
        ConfigError: a gain has no range.
    """
    # Rules far above the limit of Ms would widen the range into gains that cannot be chosen.
    near = [gains for gains in known if find_loop_margins(loop, gains)["ms"] <= 1.5 * max_sensitivity]
    known = near if len(near) > 2 else known
    # Precedence: range of the study, usual range of the kind of loop, range around the rules.
    space: Space = {}
    for gain in loop.gains:
        usual = LOOP_KINDS[loop.kind].ranges
        given = [gains[gain] for gains in known if gains[gain] > 0.0]
        if gain in spec.search.ranges:
            space[gain] = spec.search.ranges[gain].range()
        elif gain in usual:
            space[gain] = usual[gain]
        elif not given:
            raise ConfigError(
                f"{where(spec, 'search', 'ranges')}: no rule gives a value of {gain}; write a range for it"
            )
        # Gains of rules differ by factors: a logarithmic range, a factor of three beyond them on both sides.
        elif loop.role(gain) == "kp":
            space[gain] = Range(min(given) / 3.0, max(given) * 3.0)
        else:  # integral and derivative parts may be zero
            space[gain] = Range(0.0, max(given) * 1.5, "linear")
    return space


def inside(space: Space, gains: Iterable[Gains]) -> list[Gains]:
    """Return the gains that are within the ranges, each once."""
    distinct: list[Gains] = []
    for candidate in gains:
        if candidate not in distinct and all(candidate[name] in entry for name, entry in space.items()):
            distinct.append(dict(candidate))
    return distinct


def space_around(space: Space, leaders: Sequence[Trial]) -> Space:
    """Return the part of the space around the best trials: beyond them by as much as they differ, and a margin."""
    near: Space = {}
    for gain, entry in space.items() if leaders else ():
        values = [trial.gains[gain] for trial in leaders]
        low, high = min(values), max(values)
        if entry.scale == "log":
            # Relative width on a logarithmic range, absolute width on a linear one.
            factor = NEAR * high / low
            low, high = low / factor, high * factor
        else:
            width = high - low + NEAR_LINEAR * (entry.high - entry.low)
            low, high = low - width, high + width
        near[gain] = Range(max(low, entry.low), min(high, entry.high), entry.scale)
    return near or space


def map_space(space: Space, gains: Gains, gain_margin: float) -> Space:
    """Return ranges of the first two gains for a map around gains, wide enough for the limit of stability."""
    # Beyond the gain margin, so that the limit of stability is on the map.
    times = max(4.0, min(1.6 * gain_margin, 12.0)) if math.isfinite(gain_margin) else 4.0
    ranges: Space = {}
    for name, entry in list(space.items())[:2]:
        high = min(max(times * gains[name], 0.3 * entry.high), 3.0 * entry.high)
        low = max(high / 60.0, entry.low) if entry.scale == "log" else entry.low
        ranges[name] = Range(low, high, entry.scale)
    return ranges
