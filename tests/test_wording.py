"""Words of messages."""

import re
from pathlib import Path

import pytest

from mirdrake.core.wording import plural
from mirdrake.identification.finding_texts import FINDINGS, render

ROOT = Path(__file__).parents[1]


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
    figures = {"rows": 1, "channel": "vx", "first": 0.0, "then": 2.0, "unit": "m/s"}
    assert (
        render(FINDINGS, "first_rows", figures)
        == "1 row without measurements at the beginning: vx is 0 there, then 2 m/s"
    )


def test_no_module_has_a_plural_of_its_own():
    own = re.compile(r"""["']e?s["'] (\*|if )""")
    found = [str(file) for file in sorted((ROOT / "mirdrake").rglob("*.py")) if own.search(file.read_text("utf-8"))]
    assert [name for name in found if not name.endswith(("wording.py", "recognise.py", "actors_spec.py"))] == []
