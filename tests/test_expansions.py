"""Expanded models are kept in a process, and made again when anything changes that they depend on."""

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from mirdrake.vehicles.expansions import KEPT, Expansions
from mirdrake.vehicles.xacro_render import render_xacro

HEAD = '<robot name="one" xmlns:xacro="http://www.ros.org/wiki/xacro">'


@pytest.fixture
def model(tmp_path: Path) -> Path:
    """Return the main file of a model with an included file, an argument and a YAML file."""
    main = tmp_path / "main.urdf.xacro"
    main.write_text(
        f'{HEAD}<xacro:arg name="size" default="1"/><xacro:include filename="part.xacro"/>'
        '<xacro:property name="values" value="${xacro.load_yaml(\'values.yaml\')}"/>'
        "<link name=\"l_${values['name']}_$(arg size)\"/></robot>"
    )
    (tmp_path / "part.xacro").write_text(f'{HEAD}<link name="part"/></robot>')
    (tmp_path / "values.yaml").write_text("name: a\n")
    return main


@pytest.mark.parametrize(
    ("file", "before", "after", "name"),
    [
        ("main.urdf.xacro", 'name="l_', 'name="m_', "m_a_1"),
        ("part.xacro", '"part"', '"tail"', "tail"),
        ("values.yaml", ": a", ": b", "l_b_1"),
    ],
)
def test_a_model_is_expanded_again_when_a_file_of_it_changes(
    model: Path, file: str, before: str, after: str, name: str
) -> None:
    first = render_xacro(model)
    assert render_xacro(model) is first
    path = model.parent / file
    status = path.stat()
    path.write_text(path.read_text().replace(before, after))
    os.utime(path, ns=(status.st_atime_ns, status.st_mtime_ns))  # of the same time and length
    second = render_xacro(model)
    assert second is not first
    assert name in [link.get("name") for link in second.root]
    (model.parent / "part.xacro").unlink()
    with pytest.raises(Exception, match=r"part\.xacro: no such file"):
        render_xacro(model)


def test_arguments_and_the_working_directory_are_part_of_it(model: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = render_xacro(model)
    large = render_xacro(model, arguments={"size": "2"})
    assert [link.get("name") for link in large.root] == ["part", "l_a_2"]
    assert render_xacro(model, defaults={"size": "2"}) is not large
    monkeypatch.chdir(model.parent)
    here = render_xacro(model)
    assert here is not first
    assert here.where(here.root[0]).startswith("part.xacro:")  # places are relative to it


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda folder, patch: patch.setenv("ROS_DISTRO", "two"), '<link name="$(optenv ROS_DISTRO one)"/>'),
        (
            lambda folder, patch: (folder / "p_2.xacro").write_text(f'{HEAD}<link name="two"/></robot>'),
            '<xacro:include filename="p_*.xacro"/>',
        ),
    ],
)
def test_a_model_that_depends_on_more_than_its_files_is_not_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, change: Callable[[Path, pytest.MonkeyPatch], object], text: str
) -> None:
    monkeypatch.setenv("ROS_DISTRO", "one")
    (tmp_path / "p_1.xacro").write_text(f'{HEAD}<link name="one"/></robot>')
    main = tmp_path / "main.urdf.xacro"
    main.write_text(f"{HEAD}{text}</robot>")
    assert [link.get("name") for link in render_xacro(main).root] == ["one"]
    change(tmp_path, monkeypatch)
    assert [link.get("name") for link in render_xacro(main).root][-1] == "two"


def test_the_least_recently_used_results_are_dropped() -> None:
    made: list[int] = []
    expansions: Expansions[int] = Expansions()

    def get(number: int) -> int:
        def make() -> tuple[int, dict[Path, bytes]]:
            made.append(number)
            return number, {}

        return expansions.get(number, make)

    for number in range(KEPT):
        get(number)
    get(0)
    get(KEPT)
    made.clear()
    assert [get(0), get(1), get(KEPT)] == [0, 1, KEPT]
    assert made == [1]
