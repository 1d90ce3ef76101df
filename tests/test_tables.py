"""Tables of recorded files."""

import numpy as np

from mirdrake.readers.tables import Table


def test_an_integer_of_hundreds_of_digits_is_not_a_number_of_a_table() -> None:
    column = np.array([1, 10**400, 2.5], dtype=object)
    table = Table("log.csv", ["speed"], {"speed": column})
    assert np.array_equal(table.numbers("speed", "data.yaml:3"), [1.0, np.nan, 2.5], equal_nan=True)
