"""A user adds a log format: one function, and one line that registers it."""

import json

import numpy as np
import pytest

from mirdrake.identification import load_data
from mirdrake.readers import FORMATS, Table

DATA = """\
mirdrake: data/1
channels:
  vx: {column: v}
  yaw_rate: {column: r, unit: deg/s}
time: {column: t}
logs: [{file: drive.jsonl}]
"""


def read_json_lines(request):
    """Read one JSON object a line; the first one has the units."""
    lines = request.path.read_text(encoding="utf-8").splitlines()
    units, *rows = map(json.loads, lines)
    columns = {name: np.array([row[name] for row in rows]) for name in units}
    return Table(request.name, list(units), columns, units)


@pytest.fixture(autouse=True)
def registered(monkeypatch):
    monkeypatch.setitem(FORMATS, ".jsonl", read_json_lines)


def test_a_registered_format_enters_a_data_set(tmp_path):
    time = 0.02 * np.arange(50)
    rows = [{"t": "s", "v": "km/h", "r": "deg/s"}, *({"t": t, "v": 36.0 + t, "r": -t} for t in time.tolist())]
    (tmp_path / "drive.jsonl").write_text("\n".join(map(json.dumps, rows)), encoding="utf-8")
    (tmp_path / "drives.yaml").write_text(DATA, encoding="utf-8")
    (log,) = load_data(tmp_path / "drives.yaml").logs
    np.testing.assert_allclose(log.time, time)
    np.testing.assert_allclose(log.channels["vx"], (36.0 + time) / 3.6)
    np.testing.assert_allclose(log.channels["yaw_rate"], np.radians(-time))
