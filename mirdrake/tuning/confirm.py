"""Confirmation of gain and delay margins on the plant: the loop is driven at parts of the margin of its model.

A margin of the model is claimed if the plant is stable there. Otherwise the largest part of it at which the plant is
stable is found by bisection, and claimed. Delays are driven up to the longest one of the actuator.
"""

import math
from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mirdrake.tuning.loops.base import NOMINAL, Conditions, Evaluation
from mirdrake.tuning.loops.blocks import LONGEST
from mirdrake.tuning.models import Floats

BELOW, ABOVE = 0.9, 1.1
"""Parts of a margin at which the loop is driven first."""

RESOLUTION = 0.02
"""Width of the interval of parts at which the bisection ends."""

LEAST = 0.5
"""Smallest part of a margin that is tested; a loop that is not stable there has no margin."""

LARGEST_GAIN, LARGEST_DELAY = 20.0, 0.4
"""Margins above these are not driven: a factor on the gain [1] and a delay [s]."""

TRACE = 0.002
"""Oscillations below this fraction of the step do not grow; they are numerical."""


@dataclass(frozen=True)
class MarginCheck:
    """A margin of the model, and what the plant confirms of it.

    Attributes:
        name: gain_margin or delay_margin_s.
        model: margin of the model.
        claimed: the smaller one of model and plant.
        stable_at_above: whether the plant is stable at :data:`ABOVE` of the model's margin, or at the longest delay
            that can be driven if that is shorter.
    """

    name: str
    model: float
    claimed: float
    stable_at_above: bool

    @property
    def ratio(self) -> float:
        """Claimed margin over that of the model, at least :data:`LEAST`: smaller parts are not driven [1]."""
        return max(self.claimed / self.model, LEAST)


Call = tuple[Mapping[str, float], Conditions]
"""Arguments of a test: gains and conditions."""

Search = Generator[float, bool, MarginCheck]
"""Search of a margin: yields the parts to test, receives whether the plant is stable there."""


def confirm_margins(
    evaluate: Callable[[Sequence[Call]], Sequence[Evaluation]],
    gains: Mapping[str, float],
    figures: Mapping[str, float],
    *,
    delay: float,
    step: float,
) -> tuple[MarginCheck, ...]:
    """Drive a loop at parts of its gain and delay margin and return what can be claimed.

    Args:
        evaluate: tests gains under conditions, several at a time, and keeps the responses.
        gains: by name.
        figures: of the nominal test, with the margins of the model.
        delay: nominal delay of the actuator [s].
        step: of the set-point [y].
    """

    def scaled(factor: float) -> Call:
        return {name: factor * value for name, value in gains.items()}, NOMINAL

    def delayed(added: float) -> Call:
        # The limit is reached exactly, whatever the rounding of the sum.
        return gains, Conditions(delay=min(delay + added, LONGEST)) if added else NOMINAL

    # Missing margins (NaN) and those beyond the range that a plant can be driven at are not confirmed.
    searches: list[tuple[Search, Callable[[float], Call], float]] = []
    factor, lag = figures.get("gain_margin", math.nan), figures.get("delay_margin_s", math.nan)
    if 1.0 < factor <= LARGEST_GAIN:
        searches.append((_search("gain_margin", factor), scaled, factor))
    longest = LONGEST - delay
    if 0.0 < lag <= min(LARGEST_DELAY, longest / LEAST):
        searches.append((_search("delay_margin_s", lag, largest=longest / lag), delayed, lag))

    # The tests that both searches ask for next are made side by side.
    checks: dict[int, MarginCheck] = {}
    asked = {number: next(search) for number, (search, _, _) in enumerate(searches)}
    while asked:
        calls = [searches[number][1](part * searches[number][2]) for number, part in asked.items()]
        for number, result in zip(tuple(asked), evaluate(calls), strict=True):
            try:
                asked[number] = searches[number][0].send(_is_stable(result, step))
            except StopIteration as ended:
                checks[number] = ended.value
                del asked[number]
    return tuple(checks[number] for number in range(len(searches)))


def _search(name: str, margin: float, *, largest: float = math.inf) -> Search:
    """Find the largest part of a margin, up to 1, at which the plant is stable; parts up to `largest` can be driven.

    Yields a part, and is sent whether the plant is stable there.
    """
    # The model is conservative here: the claim is that of the model, which is the smaller one.
    first = min(ABOVE, largest)
    above = yield first
    if above or (first > 1.0 and (yield 1.0)):
        return MarginCheck(name, margin, margin, above)

    # Go down in steps of 0.1 until the plant is stable; below LEAST nothing is claimed.
    high = min(1.0, largest)
    low = high - (1.0 - BELOW)
    while not (yield low):
        high, low = low, low - (1.0 - BELOW)
        if low < LEAST:
            return MarginCheck(name, margin, 0.0, stable_at_above=False)
    # Bisection: `low` is stable and `high` is not.
    while high - low > RESOLUTION:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if (yield middle) else (low, middle)
    return MarginCheck(name, margin, low * margin, stable_at_above=False)


def _is_stable(result: Evaluation, step: float) -> bool:
    """Return whether the loop is stable in a test with a step of the set-point [y].

    A growing oscillation about a straight line counts as unstable, though it may not exceed the limits of judge() yet.
    One that decays is stable whatever its size: close to the margin it decays slowly.
    """
    if result.decays:
        return True
    if result.status != "ok" or result.response is None:
        return False
    response = result.response
    t, error = response["t"].to_numpy(), (response["reference"] - response["output"]).to_numpy()
    return not _grows(t, error, TRACE * abs(step))


def _grows(t: Floats, error: Floats, least: float) -> bool:
    """Return whether the oscillation of an error about a straight line is larger in the last fifth than before."""
    span = t[-1] - t[0]
    sizes = []
    for start, end in ((0.6, 0.8), (0.8, 1.0)):
        part = (t >= t[0] + start * span) & (t <= t[0] + end * span)
        sizes.append(float(np.std(error[part] - np.polyval(np.polyfit(t[part], error[part], 1), t[part]))))
    return sizes[1] > max(sizes[0], least)
