"""The public names are those of ``mirdrake.__all__``."""

import pytest

import mirdrake


def test_the_public_names_are_those_that_type_checkers_see() -> None:
    assert mirdrake.__all__ == sorted(set(mirdrake.__all__))
    assert {"load_vehicle", "simulate", "tune"} <= set(mirdrake.__all__)


def test_a_star_import_gives_all_of_them() -> None:
    names: dict[str, object] = {}
    exec("from mirdrake import *", names)
    assert set(mirdrake.__all__) <= set(names)


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
