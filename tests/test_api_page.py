"""docs/api.md lists every public name with the first line of its docstring."""

from importlib import import_module

import pytest

import mirdrake
import mirdrake.gym  # here, as Gymnasium sets an environment variable when it is imported
from tools.api_page import MODULES, ROOT, names_of_mirdrake, public_names, summary, write_page

PAGE = ROOT / "docs" / "api.md"


def test_the_page_is_that_of_the_docstrings():
    text = PAGE.read_text(encoding="utf-8")
    assert write_page(text) == text, "python -m tools.api_page docs/api.md writes it anew"


def test_all_public_names_of_the_package_are_there_with_their_meaning():
    assert sorted(names_of_mirdrake()) == mirdrake.__all__
    text = PAGE.read_text(encoding="utf-8")
    for name in mirdrake.__all__:
        (row,) = [line for line in text.splitlines() if line.startswith(f"| `{name}` |")]
        assert row.split("|")[-2].strip(), f"{name} has no words"


@pytest.mark.parametrize("module", MODULES)
def test_names_of_a_module_can_be_used(module):
    assert summary(module)
    loaded = import_module(f"mirdrake.{module}")
    missing = [name for name, _ in public_names(module) if not hasattr(loaded, name)]
    assert missing == []
