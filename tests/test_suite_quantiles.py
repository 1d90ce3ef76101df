"""Quantiles of margins in searches, against numbers computed by hand."""

import numpy as np
import pytest

from mirdrake.suites.cases import Judgement, Result
from mirdrake.suites.quantiles import Quantiles


def result(*margins: float | None) -> Result:
    """Return a result with a finding for each margin."""
    findings = tuple(
        Judgement(f"requirement {number}", margin is None or margin >= 0.0, margin, "", margin, 0.0, "")
        for number, margin in enumerate(margins)
    )
    return Result("case", "pass", findings=findings)


def shares(quantiles: Quantiles, *margins: float | None) -> list[float | None]:
    return [finding.share for finding in quantiles.rescore(result(*margins)).findings]


def test_the_share_is_that_of_the_sample_between_margin_and_limit() -> None:
    # Hazen's positions of 4 margins are 1/8, 3/8, 5/8, 7/8; the limit is halfway between the first two: at 1/4.
    quantiles = Quantiles(result(margin) for margin in (-1.0, 1.0, 3.0, 11.0))
    for margin, expected in ((-1.0, -1 / 8), (0.0, 0.0), (1.0, 1 / 8), (2.0, 1 / 4), (7.0, 1 / 2), (11.0, 5 / 8)):
        assert shares(quantiles, margin) == pytest.approx([expected])
    # Beyond the sample with the mean slope, 3/4 over 12.
    assert shares(quantiles, -9.0) == pytest.approx([-1 / 8 - 8 / 16])
    assert shares(quantiles, 15.0) == pytest.approx([5 / 8 + 4 / 16])
    assert shares(quantiles, None) == [None]


def test_the_worst_requirement_does_not_depend_on_the_size_of_its_unit() -> None:
    rng = np.random.default_rng(1)
    metres, seconds = rng.normal(0.5, 2.0, 40), rng.normal(0.3, 1.0, 40)
    for unit in (1e-3, 1.0, 1e3):
        quantiles = Quantiles(result(float(a) * unit, float(b)) for a, b in zip(metres, seconds, strict=True))
        found = [shares(quantiles, float(a) * unit, float(b)) for a, b in zip(metres, seconds, strict=True)]
        if unit == 1e-3:
            first = found
        assert np.array(found) == pytest.approx(np.array(first))
        # By number, the first requirement would decide everywhere in kilometres, and nowhere in millimetres.
        worst = [int(np.argmin(np.array(pair, dtype=float))) for pair in found]
        assert 5 < sum(worst) < 35


def test_failures_are_below_zero_and_equal_margins_have_the_usual_size() -> None:
    quantiles = Quantiles(result(2.0, margin) for margin in (4.0, 5.0, 6.0))
    high, low = shares(quantiles, 3.0, -1.0)
    assert high is not None
    assert low is not None
    assert low < 0.0 < high
    # All first margins are 2: its usual size is margin over share, here 1.
    assert shares(quantiles, 3.0, 5.0)[0] == pytest.approx(3.0)
