"""JSON that a user has edited or a disk has damaged is read, or rejected with ValueError."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from mirdrake.core.json_io import finite_or_none, finite_or_text, parse_json, plain_data


def test_deep_nesting_is_a_value_error() -> None:
    with pytest.raises(ValueError, match="nested too deeply"):
        parse_json("[" * 100_000 + "]" * 100_000)


def test_a_whole_number_beyond_python_s_limit_is_read_as_a_float() -> None:
    assert parse_json("[" + "9" * 5000 + ", 17]") == [math.inf, 17]


def test_a_damaged_text_is_reported_with_its_line() -> None:
    with pytest.raises(json.JSONDecodeError) as caught:
        parse_json('{\n "a": 1\n "b": 2}')
    assert caught.value.lineno == 3


def test_plain_data_have_only_types_of_json_and_yaml() -> None:
    data = {1: (np.float64(2.5), np.int64(3), np.bool_(True)), "array": np.eye(2), "path": Path("a/b"), "none": None}
    plain = plain_data(data)
    assert plain == {"1": [2.5, 3, True], "array": [[1.0, 0.0], [0.0, 1.0]], "path": "a/b", "none": None}
    assert [type(item) for item in plain["1"]] == [float, int, bool]


def test_infinite_and_missing_numbers_become_none_or_text() -> None:
    numbers = [1.0, math.inf, -math.inf, math.nan]
    assert plain_data(numbers, finite_or_none) == [1.0, None, None, None]
    assert plain_data(numbers, finite_or_text) == [1.0, "inf", "-inf", None]
