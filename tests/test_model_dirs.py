"""Every vehicle folder has the same layout, explains its numbers, and loads without a warning."""

import re
from pathlib import Path

import pytest

from mirdrake.core.paths import data_root
from mirdrake.vehicles import load_vehicle

MODELS = sorted(path.parent for path in (data_root() / "models").glob("*/vehicle.yaml"))
FILES = {
    "README.md",
    "main.urdf.xacro",
    "properties.xacro",
    "structure.xacro",
    "contact.xacro",
    "sensors.xacro",
    "vehicle.yaml",
    "control.yaml",
    "sensors.yaml",
    "meshes",
}


def test_there_are_models() -> None:
    assert [path.name for path in MODELS]


@pytest.fixture(params=MODELS, ids=lambda path: path.name)
def folder(request: pytest.FixtureRequest) -> Path:
    path: Path = request.param
    return path


def test_a_model_folder_holds_these_files_and_no_others(folder: Path) -> None:
    present = {path.name for path in folder.iterdir() if path.name != "__pycache__"}
    assert present >= FILES
    more = present - FILES - {"variants", "published_figures.yaml"}
    assert all(name.endswith(".xacro") for name in more), more  # what the variants include


def test_the_readme_has_derivation_grade_licence_and_corrections_or_sources(folder: Path) -> None:
    text = (folder / "README.md").read_text(encoding="utf-8")
    spec = load_vehicle(str(folder)).spec
    assert text.startswith("# ")
    assert f"Grade **{spec.grade}**" in text
    assert f"Licence: {spec.licence}" in text
    assert "## Derivation" in text


def test_the_readme_sections_that_files_point_to_exist(folder: Path) -> None:
    sections = set(re.findall(r"^\*\*(\d+) ", (folder / "README.md").read_text(encoding="utf-8"), re.MULTILINE))
    for path in folder.glob("*.*"):
        if path.name != "README.md":
            text = path.read_text(encoding="utf-8")
            pointed = re.findall(r"[Ss]ection (\d+) of README|README (\d+)", text)
            assert {number for pair in pointed for number in pair if number} <= sections, path.name


def test_every_number_in_vehicle_yaml_has_a_source(folder: Path) -> None:
    spec = load_vehicle(str(folder)).spec
    assert spec.numbers_without_source() == []
    assert spec.sources_without_number() == []


def test_a_model_loads_without_a_warning(folder: Path) -> None:
    assert load_vehicle(str(folder)).warnings == ()


def test_models_contain_no_path_of_a_machine(folder: Path) -> None:
    for path in folder.rglob("*"):
        if path.suffix in {".md", ".xacro", ".yaml", ".py", ".gltf"}:
            assert not re.search(r"/(home|root|tmp|work)/", path.read_text(encoding="utf-8")), path
