"""The exception tree and the tail of messages."""

import ast
import inspect
import pickle
import re

import pytest

from mirdrake.core import errors
from mirdrake.core.errors import (
    ConfigError,
    MirdrakeError,
    ModelError,
    Place,
    RunError,
    did_you_mean,
    first_line,
    one_line,
)


def _classes() -> dict[str, type[Exception]]:
    return {name: item for name, item in vars(errors).items() if isinstance(item, type) and issubclass(item, Exception)}


def test_every_error_is_a_mirdrake_error() -> None:
    assert all(issubclass(item, MirdrakeError) for item in _classes().values())


def test_the_drawn_tree_lists_exactly_the_classes() -> None:
    drawn = re.findall(r"^\s+[├└─ │]*(\w+Error)", errors.__doc__ or "", re.MULTILINE)
    assert sorted(drawn) == sorted(_classes())


def test_every_error_class_documents_its_meaning() -> None:
    tree = ast.parse(inspect.getsource(errors))
    assert all(ast.get_docstring(node) for node in tree.body if isinstance(node, ast.ClassDef))


@pytest.mark.parametrize(
    ("given", "allowed", "tail"),
    [
        ("blot", ["unior", "bolt"], "did you mean 'bolt'? (allowed: bolt, unior)"),
        ("tractor", ["unior", "bolt"], "allowed: bolt, unior"),
        ("x", [], "nothing is available here"),
        (3, ["30"], "did you mean '30'? (allowed: 30)"),
        ("a", ["a", "a"], "did you mean 'a'? (allowed: a)"),
    ],
)
def test_the_nearest_word_is_offered_with_all_words(given: object, allowed: list[str], tail: str) -> None:
    assert did_you_mean(given, allowed) == tail


def test_a_long_list_is_cut_after_twelve_words() -> None:
    tail = did_you_mean("w99", [f"w{index:02}" for index in range(20)])
    assert tail.endswith("w10, w11, …)")
    assert "w12" not in tail.split("(")[1]


def test_a_name_with_a_line_break_stays_on_the_line_of_its_message() -> None:
    assert did_you_mean("x", ["a\nb", "c"]) == "allowed: a\\nb, c"


@pytest.mark.parametrize(
    ("error", "first", "whole"),
    [
        (ValueError("a\nb"), "a", "ValueError: a"),
        (ValueError("\n a\n"), "a", "ValueError: a"),
        (ValueError(), "ValueError", "ValueError"),  # Python's own errors may have no message
        (RunError("a\nb"), "a", "a"),
    ],
)
def test_an_error_is_told_in_one_line(error: Exception, first: str, whole: str) -> None:
    assert (first_line(error), one_line(error)) == (first, whole)


@pytest.mark.parametrize("kind", [MirdrakeError, RunError, ConfigError, ModelError])
def test_an_error_carries_its_place_apart_from_its_text(kind: type[MirdrakeError]) -> None:
    """The text may contain a colon and the place a space, so that they could not be separated in the message."""
    error = kind("link 'a': no mass", where="my car.urdf:3")
    for same in (error, pickle.loads(pickle.dumps(error))):
        assert (same.text, same.where) == ("link 'a': no mass", "my car.urdf:3")
        assert str(same) == "my car.urdf:3: link 'a': no mass"
    assert (kind("no mass").where, str(kind("no mass"))) == ("", "no mass")


def test_the_place_of_a_fault_in_a_file_is_file_line_and_path() -> None:
    error = ConfigError("is not a number", file="w.yaml", line=4, path=("props", 0, "at"))
    assert (error.where, error.text) == ("w.yaml:4: props.0.at", "is not a number")
    both = ConfigError(faults=[error, ConfigError("unknown key", file="w.yaml")])
    assert (both.where, both.text) == ("", str(both))


def test_a_place_is_a_text_with_its_parts_apart() -> None:
    place = Place("my car.yaml", 3, ("mounts", 0))
    for same in (place, pickle.loads(pickle.dumps(place)), ModelError("no mass", where=place)):
        assert (same.file, same.line, same.path) == ("my car.yaml", 3, ("mounts", 0))
    assert (place, str(ModelError("no mass", where=place))) == (
        "my car.yaml:3: mounts.0", "my car.yaml:3: mounts.0: no mass",
    )  # fmt: skip
    assert [Place(), Place("a"), Place(path=("b", 1)), Place("a", 2)] == ["", "a", "b.1", "a:2"]


def test_every_fault_of_a_file_is_placed_under_the_entry_that_names_it() -> None:
    inner = ConfigError(faults=[ConfigError("no", file="d.yaml", line=n, code="not_allowed") for n in (1, 2, 2)])
    error = inner.under(Place("s.yaml", 7, ("diagram",)))
    assert str(error) == "s.yaml:7: diagram: d.yaml:1: no\ns.yaml:7: diagram: d.yaml:2: no"
    assert [(fault.line, fault.path, fault.code) for fault in error.faults] == [(7, ("diagram",), "not_allowed")] * 2
