"""What identifies a tuning study when it is resumed, and what its search starts with."""

import shutil
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from mirdrake.core.errors import RunError
from mirdrake.core.paths import data_root
from mirdrake.tuning.loops.registry import make_loop_spec
from mirdrake.tuning.spec import make_tuning
from mirdrake.tuning.tune import STUDY, _search, study_key, tune
from tests.test_tuning_block_loop import DIAGRAM, OWN_LAG, PARAMETERS, PID_LOOP
from tests.tuning_rigs import short_study


@pytest.mark.parametrize(
    ("file", "old", "new"),
    [
        ("car/properties.xacro", 'name="kerb_mass" value="1616"', 'name="kerb_mass" value="1700"'),
        ("flat.yaml", "mu: 0.9", "mu: 0.8"),
    ],
)
def test_a_study_is_not_resumed_after_a_change_of_its_vehicle_or_world(
    tmp_path: Path, file: str, old: str, new: str
) -> None:
    """Evaluations of the old files would be mixed with those of the new."""
    shutil.copytree(data_root() / "models" / "bolt", tmp_path / "car")
    shutil.copy(data_root() / "worlds" / "empty.yaml", tmp_path / "flat.yaml")
    data = short_study(vehicle=str(tmp_path / "car"), world=str(tmp_path / "flat.yaml"))
    spec = make_tuning(data)
    key = study_key(spec, make_loop_spec(spec))
    assert study_key(spec, make_loop_spec(spec)) == key

    # An interrupted study has its key in the folder, and no result.
    out = tmp_path / "out"
    out.mkdir()
    (out / STUDY).write_text(f'{{"key": "{key}"}}\n')
    text = (tmp_path / file).read_text()
    assert old in text
    (tmp_path / file).write_text(text.replace(old, new))
    with pytest.raises(RunError, match="its vehicle or world has changed"):
        tune(data, out=out)


def test_a_study_is_not_resumed_after_a_change_of_a_class_of_the_user(tmp_path: Path) -> None:
    (tmp_path / "own_lag_resumed.py").write_text(OWN_LAG)
    (tmp_path / "loop.yaml").write_text(DIAGRAM.replace("own_pid_block_lag", "own_lag_resumed"))
    loop = {**PID_LOOP, "diagram": str(tmp_path / "loop.yaml"), "parameters": PARAMETERS}
    spec = make_tuning({"loop": loop})
    made = make_loop_spec(spec)
    key = study_key(spec, made)
    assert study_key(spec, made) == key
    (tmp_path / "own_lag_resumed.py").write_text(OWN_LAG.replace(">= 0.5", ">= 0.4"))
    assert study_key(spec, made) != key


class _SearchedError(Exception):
    """Ends a search at its start."""


@pytest.mark.parametrize("rules", [[], [{"kp": 2.0}]])
@pytest.mark.parametrize("present", [[], [{"kp": 90.0}]])
def test_present_gains_start_a_search_and_do_not_widen_its_ranges(
    present: list[dict[str, float]], rules: list[dict[str, float]], monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: dict[str, Any] = {}

    def search(space: Any, fidelity: str, starts: list[dict[str, float]], stage: str, *, scenarios: Any) -> None:
        seen["starts"] = starts
        raise _SearchedError

    def find_space(spec: Any, loop: Any, known: list[dict[str, float]], max_sensitivity: float) -> dict[str, Any]:
        seen["ranges"] = list(known)
        return {}

    monkeypatch.setattr("mirdrake.tuning.tune.search_space", find_space)
    stages: Any = SimpleNamespace(
        identifiable=True, spec=None, loop=SimpleNamespace(present=present[0] if present else {}), constraints={},
        first_fidelity="reduced", search=search,
    )  # fmt: skip
    tested = [SimpleNamespace(design=SimpleNamespace(gains=gains)) for gains in ({"kp": 1.0}, *rules)]
    designs: Any = SimpleNamespace(baseline=tested[0], tested=tested[1:])
    choice: Any = SimpleNamespace(added=[], known=SimpleNamespace(hard=()))
    with pytest.raises(_SearchedError):
        _search(stages, designs, choice)
    assert seen["ranges"] == (rules or present)
    assert seen["starts"] == [*rules, *present]
