"""Text files of loggers are read by their rows: headers below other lines, no header, dates, and lines of JSON."""

import json

import numpy as np
import pytest

from mirdrake.cli import main
from mirdrake.core.errors import ConfigError
from mirdrake.readers import read_table

ROWS = "".join(f"{0.1 * row:.1f};{10 + row};{0.01 * row:.2f}\n" for row in range(40))


def table(folder, text, name="log.csv", columns=()):
    (folder / name).write_text(text, encoding="utf-8")
    return read_table(folder / name, columns)


HEADS = {
    "first line": ("time;v;r\n", 1),
    "below other lines": ("Logger 3\nDriver;Ann\n\ntime;v;r\n", 4),
    "below lines padded to the width of the table": ("Logger 3;;\nDriver: Ann;;\n\ntime;v;r\n", 4),
    "below lines of more cells": ("Logger;3;;Serial;77\nRange;all;;End;40;s\n\ntime;v;r\n", 4),
    "above units": ("Logger 3\ntime;v;r\ns;m/s;rad/s\n", 2),
    "above units, sources and an empty line": ("Logger 3\n\ntime;v;r\ns;m/s;\n;can 1;gyro\n\n", 3),
}


@pytest.mark.parametrize(("head", "line"), HEADS.values(), ids=HEADS)
def test_the_header_is_found_by_the_rows_without_a_requested_column(tmp_path, head, line):
    found = table(tmp_path, head + ROWS)
    assert found.names == ["time", "v", "r"]
    assert found.lines is not None
    assert len(found.lines) == 40
    assert found.numbers("v", "test") == pytest.approx(10.0 + np.arange(40.0))
    assert line == 1 or f"before the header in line {line} " in " ".join(found.notes)
    assert found.units.get("v", "m/s") == "m/s"
    # A request by name finds the same.
    assert table(tmp_path, head + ROWS, columns=["v"]).numbers("r", "test") == pytest.approx(found.numbers("r", "test"))


def test_columns_without_a_header_are_numbered_from_1(tmp_path, capsys):
    rows = "".join(f"picture {row}.jpg;{line}\n" for row, line in enumerate(ROWS.splitlines()))
    found = table(tmp_path, rows)
    assert found.names == ["1", "2", "3", "4"]
    assert len(found.numbers("3", "test")) == 40
    assert "has no header" in " ".join(found.notes)
    # A number selects a column, not a line with such a cell.
    assert table(tmp_path, rows, columns=["10"]).names == found.names
    assert main(["identify", "new", str(tmp_path / "log.csv")]) == 2
    assert "has no header; map its columns by their numbers from 1" in capsys.readouterr().err
    # Numbers that count up are a header, as of a matrix without names.
    assert table(tmp_path, "0;1;2\n" + ROWS).names == ["0", "1", "2"]


def test_names_and_units_with_bars_between_them(tmp_path):
    found = table(tmp_path, '"time"|"s"|0|10,"v"|"km/h"|0|99,"r"|"deg/s"|-9|9\n' + ROWS.replace(";", ","))
    assert found.names == ["time", "v", "r"]
    assert found.units == {"time": "s", "v": "km/h", "r": "deg/s"}


def test_brackets_that_tell_columns_apart_and_indices_are_parts_of_the_name(tmp_path):
    found = table(tmp_path, "a(x);a(y);b[0]\n" + ROWS)
    assert (found.names, found.units) == (["a(x)", "a(y)", "b[0]"], {})
    found = table(tmp_path, "v [m/s];v [km/h];T [°C]\n" + ROWS)
    assert found.names == ["v [m/s]", "v [km/h]", "T"]
    assert found.units == {"v [m/s]": "m/s", "v [km/h]": "km/h", "T": "°C"}


def test_columns_of_one_name_have_their_place_in_it(tmp_path):
    found = table(tmp_path, "time;v;v\n" + ROWS)
    assert found.names == ["time", "v (column 2)", "v (column 3)"]
    with pytest.raises(
        ConfigError, match=r"has 2 columns 'v'; rename one, or use 'v \(column 2\)' or 'v \(column 3\)'"
    ):
        found.numbers("v", "test")
    found = table(tmp_path, "time;v;v\n" + ROWS, columns=["v (column 3)"])
    assert found.numbers("v (column 3)", "test")[1] == 0.01


DATES = {
    "ISO 8601": "2026-03-01T23:59:{:06.3f}Z",
    "ISO 8601 with a space and a zone": "2026-03-01 23:59:{:06.3f}+01:00",
    "name of the month": "01-Mar-2026 23:59:{:06.3f}",
    "time of day": "23:59:{:06.3f}",
}


@pytest.mark.parametrize("form", DATES.values(), ids=DATES)
def test_dates_and_times_of_day_become_seconds(tmp_path, form):
    rows = "".join(f"{form.format(1.25 * row)};{row}\n" for row in range(40))
    found = table(tmp_path, "stamp;v\n" + rows)
    stamps = found.numbers("stamp", "test")
    assert found.units["stamp"] == "s"
    assert np.diff(stamps) == pytest.approx(1.25 * np.ones(39))
    if form == DATES["ISO 8601"]:
        assert stamps[0] == 1772409540.0


def test_times_of_day_continue_over_midnight_and_other_texts_stay_texts(tmp_path):
    found = table(tmp_path, "clock;who\n" + "23:59:59.5;Ann\n" * 3 + "0:00:00.5;Bob\n" * 3)
    assert np.ptp(found.numbers("clock", "test")) == pytest.approx(1.0)
    with pytest.raises(ConfigError, match="'Ann' is not a number"):
        found.numbers("who", "test")


def test_lines_of_json(tmp_path):
    rows = [{"t": 0.1 * row, "imu": {"gyro": [0.0, 0.0, 0.01 * row]}, "v": 5.0} for row in range(30)]
    rows[3].pop("v")
    for name, text in (("a.jsonl", "\n".join(map(json.dumps, rows))), ("b.json", json.dumps(rows))):
        found = table(tmp_path, text, name)
        assert found.numbers("imu.gyro.2", "test") == pytest.approx(0.01 * np.arange(30.0))
        assert np.isnan(found.numbers("v", "test")).sum() == 1


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{"t": 1}\n{"t": \n', ":2: is not JSON"),
        ("[1, 2]", "is no object"),
        ("", "is empty"),
        ("3\n", ":1: is no object"),
    ],
)
def test_faults_of_lines_of_json_are_one_line_with_their_place(tmp_path, text, message):
    with pytest.raises(ConfigError, match=message) as caught:
        table(tmp_path, text, "log.jsonl")
    assert "\n" not in str(caught.value)
