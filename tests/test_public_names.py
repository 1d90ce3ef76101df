"""The public names are those of ``mirdrake.__all__``."""

import ast
from pathlib import Path

import pytest

import mirdrake


def _exported_for_type_checkers() -> dict[str, str]:
    """Name -> module of the imports under ``if TYPE_CHECKING:`` in mirdrake/__init__.py."""
    tree = ast.parse(Path(mirdrake.__file__).read_text(encoding="utf-8"))
    block = next(node for node in tree.body if isinstance(node, ast.If))
    imports = [node for node in block.body if isinstance(node, ast.ImportFrom)]
    return {alias.name: str(node.module) for node in imports for alias in node.names}


def test_the_list_is_sorted_and_has_no_name_twice() -> None:
    assert mirdrake.__all__ == sorted(set(mirdrake.__all__))


def test_people_type_checkers_and_the_loader_see_the_same_names() -> None:
    home = {name: f"mirdrake.{module}" for name, module in mirdrake._HOME.items()}
    assert home == _exported_for_type_checkers()
    assert sorted(home) == mirdrake.__all__


@pytest.mark.parametrize("name", mirdrake.__all__)
def test_a_public_name_is_there_and_documented(name: str) -> None:
    item = getattr(mirdrake, name)
    assert item.__doc__
    assert item.__name__ == name
    assert name in dir(mirdrake)


def test_a_name_that_is_not_public_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="module 'mirdrake' has no attribute 'load_vehicles'"):
        mirdrake.load_vehicles  # noqa: B018
    assert not hasattr(mirdrake, "__wrapped__")
