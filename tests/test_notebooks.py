"""The notebooks run from top to bottom, warnings are errors, and no output is stored."""

import json
import os
import shutil
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

nbclient = pytest.importorskip("nbclient")
nbformat = pytest.importorskip("nbformat")
pytest.importorskip("ipykernel")

FOLDER = Path(__file__).resolve().parent.parent / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))

SLOW = {
    "01_first_drive",
    "06_tyres_and_manoeuvres",
    "09_write_your_own_leafsystem",
    "03_make_your_own_vehicle",
    "04_worlds_and_suites",
    "05_sensors_and_recording",
    "07_tuning",
    "08_identification",
    "10_pid_and_ackermann",
    "11_build_a_diagram_in_python",
    "12_teach_a_car_to_drive",
    "13_reinforcement_learning",
    "14_a_crossing",
}
"""Names that take long and whose commands other fast tests run."""

NEEDS = {"12_teach_a_car_to_drive": "torch", "13_reinforcement_learning": "stable_baselines3"}
"""Packages that are not part of the development extras; a notebook is skipped without its own."""

LONGEST_CELL = 15
"""Lines; those of a block, a class in :data:`BLOCKS`, may be more."""

BLOCKS = {"LimitedPi", "Proportional"}
"""Classes that a notebook teaches to write."""

STRICT = """\
import warnings
warnings.simplefilter("error")
warnings.filterwarnings("ignore", category=PendingDeprecationWarning, module="ipykernel")  # when it is shut down
"""


def _marked(path: Path) -> Any:
    marks = [pytest.mark.slow] if path.stem in SLOW else []
    return pytest.param(path, id=path.stem, marks=marks)


def run_notebook(path: Path, folder: Path) -> Any:
    """Return the notebook with its outputs; its kernel works in a folder of its own, beside a copy of files/."""
    shutil.copytree(FOLDER / "files", folder / "files")
    notebook = nbformat.read(path, as_version=4)
    notebook.cells.insert(0, nbformat.v4.new_code_cell(STRICT))
    client = nbclient.NotebookClient(
        notebook, timeout=300, kernel_name="python3", resources={"metadata": {"path": str(folder)}}
    )
    environment = {key: value for key, value in os.environ.items() if key != "MPLBACKEND"}  # pictures in the page
    client.execute(env=environment | {"OPENBLAS_NUM_THREADS": "1", "IPYTHONDIR": str(folder / "ipython")})
    return notebook


@pytest.mark.essential
@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of the notebook client; the kernel's own are errors
@pytest.mark.parametrize("path", [_marked(path) for path in NOTEBOOKS])
def test_a_notebook_runs_from_top_to_bottom(path: Path, tmp_path: Path):
    if (needed := NEEDS.get(path.stem)) and find_spec(needed) is None:
        pytest.skip(f"needs {needed}, which is not part of the development extras")
    notebook = run_notebook(path, tmp_path)
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert all(cell.execution_count for cell in cells if cell.source.strip())
    kinds = {key for cell in cells for output in cell.outputs for key in output.get("data", {})}
    assert kinds & {"image/png", "text/html"}, "it shows no picture, table or view"
    errors = [output.text for cell in cells for output in cell.outputs if output.get("name") == "stderr"]
    assert errors == []


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_stored_without_outputs_and_in_short_cells(path: Path):
    text = path.read_text(encoding="utf-8")
    notebook = json.loads(text)
    nbformat.validate(nbformat.reads(text, as_version=4))
    assert nbformat.writes(nbformat.reads(text, as_version=4)).strip() == text.strip(), "not as JupyterLab writes it"
    assert notebook["metadata"].get("kernelspec", {}).get("name") == "python3"
    for cell in notebook["cells"]:
        lines = "".join(cell["source"]).splitlines()
        block = any(line.startswith(f"class {name}(") for line in lines for name in BLOCKS)
        assert block or len(lines) <= LONGEST_CELL, f"a cell of {len(lines)} lines: {lines[0]}"
        assert not any(line.startswith(("!pip", "%pip")) for line in lines)
        if cell["cell_type"] == "code":
            assert cell["outputs"] == []
            assert cell["execution_count"] is None


def test_jupyterlab_saves_a_tracked_notebook_as_it_is_in_git(tmp_path: Path):
    """The hook of jupyter_server_config.py; another notebook keeps its outputs."""
    config = SimpleNamespace(ContentsManager=SimpleNamespace(pre_save_hook=None))
    file = FOLDER / "jupyter_server_config.py"
    exec(compile(file.read_text("utf-8"), file, "exec"), {"__file__": str(file), "get_config": lambda: config})
    stored = nbformat.read(NOTEBOOKS[0], as_version=4)
    executed = nbformat.from_dict(stored)
    executed.metadata.language_info.version = "3.99"
    cell = next(cell for cell in executed.cells if cell.cell_type == "code")
    cell.execution_count, cell.outputs = 1, [nbformat.v4.new_output("stream", text="noise")]
    for name in ("my_own.ipynb", NOTEBOOKS[0].name):
        model = {"type": "notebook", "content": nbformat.from_dict(executed)}
        manager = SimpleNamespace(root_dir=str(FOLDER))
        config.ContentsManager.pre_save_hook(model=model, path=name, contents_manager=manager)
        assert (model["content"] == stored) == (name != "my_own.ipynb")


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_has_a_goal_an_idea_and_an_exercise_with_a_folded_solution(path: Path):
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    text = "\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "markdown")
    for part in ("**Goal**: ", "**Idea**: ", "## Exercise", "folded cell"):
        assert part in text
    assert any(cell["metadata"].get("tags") == ["hide-input"] for cell in cells)


def test_notebooks_are_numbered_in_their_order_and_lead_to_one_another():
    numbers = [int(path.stem.partition("_")[0]) for path in NOTEBOOKS]
    assert numbers == sorted(set(numbers))
    for path in NOTEBOOKS:
        notebook = json.loads(path.read_text(encoding="utf-8"))
        first = "".join(notebook["cells"][0]["source"])
        assert first.startswith(f"# {int(path.stem[:2])}. "), "the title begins with the number"
        text = "".join(line for cell in notebook["cells"] if cell["cell_type"] == "markdown" for line in cell["source"])
        for target in [part.partition(")")[0] for part in text.split("](")[1:]]:
            if "://" not in target:
                assert (path.parent / target).exists(), f"{path.name}: {target}"


def test_the_robot_of_notebook_11_takes_at_most_forty_lines_of_code():
    (path,) = [path for path in NOTEBOOKS if path.stem.startswith("11_")]
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    # Solutions of exercises, which are folded, are not part of the robot.
    code = [cell for cell in cells if cell["cell_type"] == "code" and not cell["metadata"].get("tags")]
    text = "\n".join("".join(cell["source"]) for cell in code)
    assert sum(bool(line.strip()) for line in text.splitlines()) <= 40
    assert all(
        part in text for part in ('"--wheelbase", "0.6"', '"60"', "lidar,camera", '"eight"', "replace(", "run.plot")
    )
