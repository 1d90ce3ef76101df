"""JSON that a user has edited or a disk has damaged is read, or rejected with ValueError."""

import json
import math

import pytest

from mirdrake.core.json_io import parse_json


def test_deep_nesting_is_a_value_error() -> None:
    with pytest.raises(ValueError, match="nested too deeply"):
        parse_json("[" * 100_000 + "]" * 100_000)


def test_a_whole_number_beyond_python_s_limit_is_read_as_a_float() -> None:
    assert parse_json("[" + "9" * 5000 + ", 17]") == [math.inf, 17]


def test_a_damaged_text_is_reported_with_its_line() -> None:
    with pytest.raises(json.JSONDecodeError) as caught:
        parse_json('{\n "a": 1\n "b": 2}')
    assert caught.value.lineno == 3
