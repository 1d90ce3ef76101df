"""A seeded slice of ``make fuzz``: mutated files of every format are read or rejected, and nothing else happens."""

from pathlib import Path

import pytest

from tests.fuzz_files import FORMATS, run_case

FEW = {"gazebo_world": 2, "meshes": 2, "world": 3, "run_folder": 4, "diagram": 6, "presets": 6}
"""Cases of formats that take longer than others; `make fuzz` has more of them."""


@pytest.mark.parametrize("name", sorted(set(FORMATS) - {"tuning_result"}))
def test_mutated_files_are_read_or_rejected(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MPLBACKEND", "Agg")
    faults = []
    for number in range(FEW.get(name, 12)):
        folder = tmp_path / str(number)
        folder.mkdir()
        outcome, text = run_case(name, 20, number, folder)
        if outcome not in {"fine", "rejected"}:
            faults.append(f"{outcome}: {text}")
    assert not faults, faults
