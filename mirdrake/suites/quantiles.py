"""Margins of different units on one scale: by their quantiles among the margins of the same requirement."""

import math
from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mirdrake.suites.cases import Judgement, Result

Array = NDArray[np.float64]


class Quantiles:
    """Distribution of the margins of each requirement in a sample of results.

    The share of a margin m becomes F(m) - F(0) with the distribution function F of its requirement: the share of the
    sample between the margin and the limit, negative for a failure. It does not depend on units: a requirement whose
    margin is measured in other units, or by any other increasing function with its zero at the limit, has the same
    order of results.

    F rises linearly between the margins of the sample, from (i - 1/2)/n at the i-th of n (A. Hazen 1914; R. J. Hyndman
    and Y. Fan 1996, definition 5), and beyond them with its mean slope, so that results outside of the sample have an
    order, too.

    Args:
        sample: results of one case under variation.
    """

    def __init__(self, sample: Iterable[Result]) -> None:
        margins: dict[int, list[float]] = {}
        usual: dict[int, float] = {}
        for result in sample:
            for number, finding in enumerate(result.findings):
                if finding.margin is not None:
                    margins.setdefault(number, []).append(finding.margin)
                    usual.setdefault(number, _usual_size(finding))
        self._curves = {number: _Distribution(np.array(values), usual[number]) for number, values in margins.items()}

    def rescore(self, result: Result) -> Result:
        """Return a result whose findings have quantiles as shares."""
        findings = [
            finding
            if finding.margin is None or number not in self._curves
            else replace(finding, share=self._curves[number].share(finding.margin))
            for number, finding in enumerate(result.findings)
        ]
        return replace(result, findings=tuple(findings))


class _Distribution:
    """Distribution function of some margins.

    Args:
        margins: the margins (n), at least one.
        usual: size that is usual for them; sets the slope if all are equal.
    """

    def __init__(self, margins: Array, usual: float) -> None:
        self._margins, counts = np.unique(margins, return_counts=True)
        # Of equal margins the mean of their shares.
        self._shares = (np.cumsum(counts) - 0.5 * counts) / margins.size
        spread = float(self._margins[-1] - self._margins[0])
        self._slope = float(self._shares[-1] - self._shares[0]) / spread if spread > 0.0 else 1.0 / usual
        self._at_limit = self._value(0.0)

    def share(self, margin: float) -> float:
        """Return the share of the sample between a margin and the limit; negative below it."""
        return self._value(margin) - self._at_limit

    def _value(self, margin: float) -> float:
        inside = float(np.interp(margin, self._margins, self._shares))
        nearest = min(max(margin, float(self._margins[0])), float(self._margins[-1]))
        return inside + self._slope * (margin - nearest)


def _usual_size(finding: Judgement) -> float:
    """Return the size that is usual for a margin, in its unit."""
    size = finding.margin / finding.share if finding.margin and finding.share else 1.0
    return size if math.isfinite(size) and size > 0.0 else 1.0
