"""Delays of channels, computed from the delays between channels.

Relations between channels give their delays up to a common constant. The constant is the one that

1. the data file names (``clock: CHANNEL``), or else
2. delays the fewest sources, as channels of one source have one delay, or else
3. keeps the response of the vehicle behind the steering, or else
4. makes channels lag rather than lead, as sensors, filters and networks cause delays.
"""

from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from mirdrake.identification.alignment import CERTAIN


class Tie(NamedTuple):
    """Difference between two channels.

    Attributes:
        first: a channel.
        second: the channel it is compared with.
        value: how much the first one exceeds the second one: a delay [s], or the rate of a clock [s/s].
        sigma: its standard deviation.
    """

    first: str
    second: str
    value: float
    sigma: float


class Response(NamedTuple):
    """Delay of a channel behind the steering, which causes it.

    Attributes:
        channel: the channel.
        value: its delay [s].
        slack: how early it may be, by the uncertainty [s].
    """

    channel: str
    value: float
    slack: float


def solve_ties(
    ties: Sequence[Tie],
    least: float,
    *,
    sources: Sequence[Collection[str]] = (),
    clock: str | None = None,
    response: Response | None = None,
    one_sided: bool = True,
) -> dict[str, float]:
    """Return the values of all channels that are tied, zero for those that need no change.

    Args:
        ties: differences between channels.
        least: smaller differences count as none, as do insignificant ones.
        sources: channels that come from one source, which count as one.
        clock: channel whose value is zero.
        response: a channel that must not precede the steering; None if unknown.
        one_sided: whether values are positive, as delays are and rates of clocks are not.
    """
    names = sorted({name for tie in ties for name in (tie.first, tie.second)})
    if not names:
        return {}
    # Least squares over the differences; connected channels form a group.
    matrix, right = np.zeros((len(ties), len(names))), np.zeros(len(ties))
    groups = {name: name for name in names}
    for row, tie in enumerate(ties):
        # Each tie is divided by its deviation, with a floor so that one very certain tie does not make the rest
        # singular.
        scale = 1.0 / max(tie.sigma, 0.01 * least)
        matrix[row, names.index(tie.first)], matrix[row, names.index(tie.second)] = scale, -scale
        right[row] = tie.value * scale
        # The difference of two channels is known only within a group of connected ones.
        old, new = groups[tie.second], groups[tie.first]
        groups = {name: new if group == old else group for name, group in groups.items()}
    solved = np.linalg.lstsq(matrix, right, rcond=None)[0]
    covariance = np.linalg.pinv(matrix.T @ matrix)

    # Each member of a group may be the one without delay.
    source = {name: min(group) for group in sources for name in group}
    values: dict[str, float] = {}
    for group in sorted(set(groups.values())):
        members = [name for name in names if groups[name] == group]
        index = [names.index(name) for name in members]
        spread = covariance[np.ix_(index, index)]
        away = solved[index][:, None] - solved[index]
        variance = np.maximum(np.diag(spread)[:, None] + np.diag(spread) - 2.0 * spread, 0.0)
        away = np.where(np.abs(away) > np.maximum(least, CERTAIN * np.sqrt(variance)), away, 0.0)

        # Equal choices give the same values, up to their uncertainty: then the most certain one.
        choices = [
            (_rank(dict(zip(members, column, strict=True)), source, least, response, one_sided), uncertain, zero)
            for zero, (column, uncertain) in enumerate(zip(away.T.tolist(), variance.sum(axis=0).tolist(), strict=True))
        ]
        zero = members.index(clock) if clock in members else min(choices)[-1]
        values |= dict(zip(members, away[:, zero].tolist(), strict=True))
    return values


def _rank(
    shifts: Mapping[str, float], source: Mapping[str, str], least: float, response: Response | None, one_sided: bool
) -> tuple[int, bool, int]:
    """Return the number of delayed sources, whether the response leads the steering, and by how much channels lead."""
    moved = {source.get(name, name) for name, shift in shifts.items() if shift}
    acausal = response is not None and response.value - shifts.get(response.channel, 0.0) < -response.slack
    early = -sum(min(shift, 0.0) for shift in shifts.values())
    return len(moved), acausal, round(early / least) if one_sided else 0
