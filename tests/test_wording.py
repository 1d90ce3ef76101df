"""Words of messages."""

import pytest

from mirdrake.core.wording import plural
from mirdrake.identification.finding_texts import FINDINGS, render


@pytest.mark.parametrize(
    ("count", "noun", "text"),
    [
        (0, "row", "0 rows"),
        (1, "row", "1 row"),
        (2, "row", "2 rows"),
        (1, "stretch", "1 stretch"),
        (3, "stretch", "3 stretches"),
    ],
)
def test_a_count_agrees_with_its_noun(count, noun, text):
    assert plural(count, noun) == text


def test_a_finding_about_one_row_is_singular():
    figures: dict[str, float | str] = {"rows": 1, "channel": "vx", "first": 0.0, "then": 2.0, "unit": "m/s"}
    assert (
        render(FINDINGS, "first_rows", figures)
        == "1 row without measurements at the beginning: vx is 0 there, then 2 m/s"
    )
