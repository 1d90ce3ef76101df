"""Arrays of NumPy, pickles of plain data, and CSV files with names and units in several comment lines."""

import pickle
from contextlib import suppress

import numpy as np
import pandas as pd
import pytest

from mirdrake.core.errors import ConfigError
from mirdrake.readers import read_table

TIME = 0.02 * np.arange(40)
SPEED = 5.0 + TIME


def columns_of(path):
    return {name: np.asarray(values, dtype=float) for name, values in read_table(path).columns.items()}


def test_matrices_structured_arrays_and_archives_of_numpy_are_tables(tmp_path):
    np.save(tmp_path / "matrix.npy", np.column_stack((TIME, SPEED)))
    np.save(tmp_path / "fields.npy", np.array(list(zip(TIME, SPEED, strict=True)), dtype=[("t", "f8"), ("v", "f4")]))
    np.savez(tmp_path / "archive.npz", t=TIME, v=SPEED[:, None], name=np.array("drive"))
    for file, names in (("matrix.npy", ["1", "2"]), ("fields.npy", ["t", "v"]), ("archive.npz", ["t", "v"])):
        columns = columns_of(tmp_path / file)
        assert list(columns) == names
        assert columns[names[0]] == pytest.approx(TIME)
        assert columns[names[1]] == pytest.approx(SPEED, rel=1e-6)


@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
def test_pickles_of_plain_data_are_read(tmp_path, protocol):
    content = {"t": TIME, "ego": {"v": SPEED.tolist(), "name": "car"}, "imu": [{"r": float(t)} for t in TIME]}
    (tmp_path / "drive.pkl").write_bytes(pickle.dumps(content, protocol=protocol))
    columns = columns_of(tmp_path / "drive.pkl")
    assert list(columns) == ["t", "ego.v", "imu.r"]
    assert columns["imu.r"] == pytest.approx(TIME)


class Attack:
    """Object whose unpickling would call a function."""

    def __init__(self, file):
        self.file = file

    def __reduce__(self):
        return (exec, (f"open({str(self.file)!r}, 'w').close()",))


def test_a_pickle_never_executes_code(tmp_path):
    (tmp_path / "bad.pkl").write_bytes(pickle.dumps({"t": TIME, "v": Attack(tmp_path / "executed")}))
    with pytest.raises(ConfigError, match=r"bad\.pkl: has the object builtins\.exec; only arrays"):
        read_table(tmp_path / "bad.pkl")
    np.save(tmp_path / "bad.npy", np.array([Attack(tmp_path / "executed")], dtype=object))
    with pytest.raises(ConfigError, match="has Python objects"):
        read_table(tmp_path / "bad.npy")
    assert not (tmp_path / "executed").exists()


@pytest.mark.parametrize("suffix", [".pkl", ".npy", ".npz"])
def test_damaged_files_raise_no_other_error(tmp_path, suffix):
    path = tmp_path / f"log{suffix}"
    if suffix == ".pkl":
        pd.DataFrame({"v": SPEED}).to_pickle(path)
        with pytest.raises(ConfigError, match=r"has the object pandas\.\S+; only arrays"):
            read_table(path)
        whole = pickle.dumps({"t": TIME, "v": SPEED})
    else:
        (np.save if suffix == ".npy" else np.savez)(path, TIME)
        whole = path.read_bytes()
    random = np.random.default_rng(0)
    for _ in range(200):
        damaged = bytearray(whole[: random.integers(len(whole))])
        for index in random.integers(0, max(len(damaged), 1), 3):
            damaged[index : index + 1] = random.bytes(1)
        path.write_bytes(bytes(damaged))
        with suppress(ConfigError):  # any other error fails the test
            read_table(path)


@pytest.mark.parametrize(
    "header",
    [
        "# Messfahrt 12, trocken\n# Zeit; Geschwindigkeit; Gierrate\n# s; km/h; °/s\n",
        "# Zeit; Geschwindigkeit; Gierrate\n# [s]; [km/h]; [deg/s]\n# Reifen: Sommer\n",
        "Zeit; Geschwindigkeit; Gierrate\n# s; km/h; deg/s\n",
        "# Fahrer: A; B; C\nZeit; Geschwindigkeit; Gierrate\ns; km/h; deg/s\n",
        "# Zeit [s]; Geschwindigkeit [km/h]; Gierrate [deg/s]\n#\n",
    ],
)
def test_names_and_units_in_several_lines_of_a_header(tmp_path, header):
    rows = "".join(f"{t:.2f};{v:.3f};{0.5 * t:.3f}\n".replace(".", ",") for t, v in zip(TIME, SPEED, strict=True))
    (tmp_path / "fahrt.csv").write_text(header + rows, encoding="utf-8")
    table = read_table(tmp_path / "fahrt.csv")
    assert table.names == ["Zeit", "Geschwindigkeit", "Gierrate"]
    assert table.units["Zeit"] == "s"
    assert table.units["Geschwindigkeit"] == "km/h"
    assert table.units["Gierrate"] in {"deg/s", "°/s"}
    assert np.asarray(table.columns["Geschwindigkeit"], dtype=float) == pytest.approx(SPEED, abs=1e-3)
