"""A seeded slice of ``make fuzz``: mutated files of every format are read or rejected, without crash or hang."""

from pathlib import Path

import pytest

from tests.fuzz_files import FORMATS, build, run_case, run_command

FEW = {"gazebo_world": 2, "meshes": 2, "world": 3, "run_folder": 4, "diagram": 6, "presets": 6, "log_mat": 5}
"""Cases of formats that take longer than others; `make fuzz` has more of them."""


@pytest.mark.parametrize("name", sorted(set(FORMATS) - {"tuning_result"}))
def test_mutated_files_are_read_or_rejected(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MPLBACKEND", "Agg")
    faults = []
    for number in range(FEW.get(name, 6)):
        folder = tmp_path / str(number)
        folder.mkdir()
        outcome, text = run_case(name, 20, number, folder)
        if outcome not in {"fine", "rejected"}:
            faults.append(f"{outcome}: {text}")
    assert not faults, faults


def test_a_broken_mat_file_that_crashes_its_reader_is_rejected(tmp_path: Path) -> None:
    assert run_case("log_mat", 1, 712, tmp_path)[0] == "rejected"  # a segmentation fault in SciPy 1.17


@pytest.mark.parametrize("name", ["diagram", "vehicle", "world", "log_csv", "log_parquet", "log_mat", "log_mcap"])
def test_the_files_are_valid_before_they_are_mutated(name: str, tmp_path: Path) -> None:
    build(name, tmp_path)
    outcome, text = run_command(FORMATS[name].commands[0], tmp_path)
    assert outcome == "fine", text
