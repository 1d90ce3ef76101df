"""docs/kinds.md lists every kind of the registries with all its keys."""

import pytest

from mirdrake.controllers.drivers import DRIVERS
from tools.api_page import ROOT
from tools.kinds_page import SECTIONS, keys_of, split_unit, summary, write_page

PAGE = ROOT / "docs" / "kinds.md"


def test_the_page_is_that_of_the_registries():
    assert write_page() == PAGE.read_text(encoding="utf-8"), "python -m tools.kinds_page docs/kinds.md writes it anew"


def test_every_key_has_a_meaning():
    rows = [line for line in PAGE.read_text(encoding="utf-8").splitlines() if line.startswith("| `")]
    assert [row for row in rows if not row.split("|")[-2].strip()] == []
    for section in SECTIONS:
        for model in (*section.classes.values(), *section.described.values()):
            assert summary(model)


def test_every_driver_has_its_section_with_keys_of_its_own_or_of_its_base():
    text = PAGE.read_text(encoding="utf-8").partition("## Blocks")[0]
    for kind, driver in DRIVERS.items():
        part = text.partition(f"### `{kind}`\n")[2].partition("\n### ")[0]
        missing = {key for key in keys_of(driver) if f"| `{key}` |" not in part}
        assert not missing or "All keys of [`" in part, (kind, missing)


@pytest.mark.parametrize(
    ("description", "unit", "meaning"),
    [
        ("largest speed [m/s]", "m/s", "largest speed"),
        ("largest offset [m]; slower where it needs to", "m", "largest offset; slower where it needs to"),
        ("[rad/s], [N m] speed and torque", "rad/s, N m", "speed and torque"),
        ("gap [m] or time [s]", "", "gap [m] or time [s]"),
        ("empty: as front", "", "empty: as front"),
    ],
)
def test_the_unit_of_a_description(description, unit, meaning):
    assert split_unit(description) == (unit, meaning)
