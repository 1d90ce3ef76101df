"""Tables of recorded files."""

from pathlib import Path

import numpy as np
import pytest

from mirdrake.core.errors import ConfigError
from mirdrake.readers.tables import Table
from mirdrake.worlds.csv_tracks import read_csv_track


def test_an_integer_of_hundreds_of_digits_is_not_a_number_of_a_table() -> None:
    column = np.array([1, 10**400, 2.5], dtype=object)
    table = Table("log.csv", ["speed"], {"speed": column})
    assert np.array_equal(table.numbers("speed", "data.yaml:3"), [1.0, np.nan, 2.5], equal_nan=True)


def test_an_integer_of_hundreds_of_digits_in_a_track_is_an_error_with_its_line(tmp_path: Path) -> None:
    (tmp_path / "line.csv").write_text(f"x,y\n0,0\n10,{10**400}\n20,0\n30,5\n", encoding="utf-8")
    with pytest.raises(ConfigError, match=r"line\.csv:3: y '1000.*' is not a finite number"):
        read_csv_track(tmp_path / "line.csv", x="x", y="y", right=None, left=None)
