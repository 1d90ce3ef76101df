"""Examples of the documentation run."""

import importlib.util
import json
import re
import shlex
import shutil
from collections import Counter
from itertools import takewhile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from mirdrake.assembly.diagram import assemble, load_diagram
from mirdrake.cli import main
from mirdrake.controllers.behaviours.outline import volume_of
from mirdrake.runs.simulation import Simulation, simulate
from mirdrake.suites import collect_cases
from mirdrake.vehicles import load_vehicle
from mirdrake.vehicles.spec import ControlSpec, VehicleSpec
from mirdrake.worlds import load_world
from mirdrake.worlds.props_spec import PropEntry

ROOT = Path(__file__).resolve().parent.parent
PAGES = [ROOT / "README.md", ROOT / "CHANGELOG.md", *sorted((ROOT / "docs").glob("*.md"))]
WORLDS = [
    (page.name, number, text)
    for page in PAGES
    for number, text in enumerate(
        re.findall(r"```yaml\n(mirdrake: world/1\n.*?)```", page.read_text("utf-8"), re.DOTALL)
    )
]
YAML = [
    (page, number, yaml.safe_load(text))
    for page in ("tyres.md", "powertrain.md", "suspension.md")
    for number, text in enumerate(
        re.findall(r"```yaml\n(.*?)```", (ROOT / "docs" / page).read_text("utf-8"), re.DOTALL)
    )
]
PARTS = [row for row in YAML if set(row[2]) <= set(VehicleSpec.model_fields) | set(ControlSpec.model_fields)]


@pytest.mark.parametrize(("page", "number", "text"), WORLDS, ids=[f"{page}-{number}" for page, number, _ in WORLDS])
def test_a_world_in_the_documentation_is_sound(tmp_path, page, number, text):
    path = tmp_path / f"{page}{number}.yaml"
    path.write_text(text, encoding="utf-8")
    world = load_world(str(path))
    assert not world.unplaced_props
    assert world.rules is not None
    assert not world.rules.broken(world.props)
    assert not world.spec.tests or len(collect_cases([path])) >= len(world.spec.tests)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_have_targets(page):
    for target in re.findall(r"\]\(([^)#\s]+)[^)]*\)", page.read_text(encoding="utf-8")):
        if "://" not in target:
            assert (page.parent / target).exists(), f"{page.name}: {target}"


def test_a_term_has_one_row_in_the_glossary():
    """Keys in code spans are not terms: a key may occur in several files, with different meanings."""
    text = (ROOT / "docs" / "glossary.md").read_text("utf-8")
    cells = [line.split(" | ")[0].removeprefix("| ") for line in text.splitlines() if line.startswith("| ")]
    terms = [part for cell in cells if cell != "term" for part in re.sub(r"\([^)]*\)", "", cell).split(",")]
    counted = Counter(" ".join(term.split()) for term in terms if "`" not in term)
    assert [term for term, count in counted.items() if count > 1] == []
    assert len(counted) > 200


def test_the_container_has_the_system_packages_that_the_pages_name():
    """In .devcontainer, which no test can start: its packages, and the target of the Makefile that it makes."""
    text = (ROOT / ".devcontainer" / "devcontainer.json").read_text("utf-8")
    container = json.loads("\n".join(line for line in text.splitlines() if not line.startswith("//")))
    named = set()
    for page in ("README.md", "docs/commands.md"):
        for packages in re.findall(r"`apt install ([^`]+)`", (ROOT / page).read_text("utf-8")):
            named |= set(packages.split())
    assert {"graphviz", "libegl1", "libgl1-mesa-dri", "chromium"} <= named
    # The image of the container has these.
    assert named - set(container["onCreateCommand"].split()) <= {"git", "make", "python3-venv"}
    target = container["postCreateCommand"].removeprefix("make .venv/")
    assert f"$(VENV)/{target}:" in (ROOT / "Makefile").read_text("utf-8")


def _bolt_with(folder: Path, part: dict[str, object]) -> str:
    """Return a copy of the Bolt's folder with a variant that changes a part of vehicle.yaml or control.yaml."""
    source = ROOT / "models" / "bolt"
    shutil.copytree(source, folder / "bolt")
    variant = yaml.safe_load((source / "variants" / "handling.yaml").read_text("utf-8"))
    variant.pop("arguments", None)
    variant["vehicle"].pop("suspension")
    variant["vehicle"]["joints"].pop("suspension")
    for section in ("powertrain", "tyres"):
        if section in part:
            variant["vehicle"].pop(section)
    variant["vehicle"].pop("sources")
    for key, value in part.items():
        if key in ControlSpec.model_fields and key not in VehicleSpec.model_fields:
            variant["control"][key] = value
        else:
            variant["vehicle"][key] = value
    if "suspension" in part:
        variant["arguments"] = {"suspension": "true"}
    (folder / "bolt" / "variants" / "page.yaml").write_text(yaml.safe_dump(variant, allow_unicode=True), "utf-8")
    return f"{folder / 'bolt'}@page"


@pytest.mark.parametrize(("page", "number", "part"), PARTS, ids=[f"{page}-{number}" for page, number, _ in PARTS])
def test_a_part_of_a_vehicle_in_the_documentation_drives(tmp_path, page, number, part):
    model = _bolt_with(tmp_path, part)
    spec = load_vehicle(model).spec.model_dump()
    for key, value in part.items():
        if key in spec and isinstance(value, dict) and "kind" in value:
            assert spec[key]["kind"] == value["kind"]
    run = Simulation(
        assemble(
            {
                "world": "empty",
                "vehicles": {"ego": {"model": model}},
                "plant": {"contact": "point"},
                "control": {"ego": {"kind": "constant", "speed": 3, "steering": 0.02}},
            }
        )
    ).run(duration=1.0)
    assert run["ego.vx"].iloc[-1] > 1.0


def test_a_user_system_can_replace_the_pedal_controller(tmp_path, monkeypatch):
    """The diagram of docs/powertrain.md, without a speed command."""
    (tmp_path / "my_pedals.py").write_text(
        "from pydrake.systems.framework import LeafSystem\n\n\n"
        "class Driver(LeafSystem):\n"
        "    def __init__(self):\n"
        "        super().__init__()\n"
        "        self.DeclareVectorOutputPort('pedals', 3, lambda context, out: out.SetFromVector([0.3, 0.0, 1.0]))\n",
        encoding="utf-8",
    )
    spec = next(data for page, _, data in YAML if page == "powertrain.md" and "systems" in data)
    monkeypatch.chdir(tmp_path)
    run = Simulation(assemble(spec)).run(duration=1.0)
    assert run["ego.powertrain.throttle"].iloc[-1] == pytest.approx(0.3, abs=0.01)
    assert run["ego.vx"].iloc[-1] > 0.5


@pytest.mark.slow
@pytest.mark.parametrize(
    ("page", "count"), [("python", 5), ("batch", 6), ("diagrams", 3), ("worlds", 1), ("traffic", 1)]
)
def test_the_python_of_a_page_runs_in_order(page, count, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    # Gymnasium sets the first, JAX the others.
    for name, value in (
        ("PYGAME_HIDE_SUPPORT_PROMPT", "hide"),
        ("TF_CPP_MIN_LOG_LEVEL", "1"),
        ("TPU_SKIP_MDS_QUERY", "1"),
    ):
        monkeypatch.setenv(name, value)
    namespace: dict[str, object] = {}
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / f"{page}.md").read_text("utf-8"), re.DOTALL)
    assert len(blocks) == count
    for block in blocks:
        if "import jax" in block and importlib.util.find_spec("jax") is None:
            continue  # optional: mirdrake[jax]
        exec(block, namespace)


@pytest.mark.slow
def test_the_commands_of_the_tutorial_run_in_order(tmp_path, monkeypatch):
    """Your own car: each command exits with 0; its files are written as the page says."""
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"```(sh|yaml|python)\n(.*?)```", (ROOT / "docs" / "own_car.md").read_text("utf-8"), re.DOTALL)
    assert [kind for kind, _ in blocks] == [
        "sh",
        "sh",
        "sh",
        "python",
        "yaml",
        "yaml",
        "sh",
        "python",
        "yaml",
        "sh",
        "sh",
    ]
    control = re.compile(r"wheel_speed:\n(?:  .*\n)+")
    for number, (kind, text) in enumerate(blocks):
        if kind == "sh":
            lines = (line.partition("#")[0] for line in text.replace("\\\n", " ").splitlines())
            words = [shlex.split(line) for line in lines if line.startswith("mirdrake ") and " view " not in line]
            assert [main(command[1:]) for command in words] == [0] * len(words), text
        elif text.startswith("wheel_speed:"):
            path = Path("models/rover/control.yaml")
            path.write_text(control.sub(text, path.read_text("utf-8")), "utf-8")
        elif text.startswith("mirdrake:"):
            Path("rover_speed.yaml").write_text(text, "utf-8")
        elif text.startswith("systems:"):
            with Path("diagrams/rover_skidpad.yaml").open("a", encoding="utf-8") as file:
                file.write(text)
        elif number == 3:
            exec(text, {})
        else:
            Path("diagrams/my_blocks.py").write_text(text, "utf-8")


def test_a_block_with_a_scan_as_its_input_stops_the_car(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    page = (ROOT / "docs" / "sensors.md").read_text("utf-8")
    blocks = re.findall(r"```(?:python|yaml)\n(.*?)```", page[page.index("## Scans") :], re.DOTALL)
    for name, text in zip(("scan_blocks.py", "wall_ahead.yaml", "stop_ahead.yaml"), blocks[:3], strict=True):
        Path(name).write_text(text, encoding="utf-8")
    spec = load_diagram(
        "stop_ahead.yaml", overrides=["plant.contact=point", "record.report=false", "record.meshcat=false"]
    )
    run = simulate(spec, duration=9.0, folder=tmp_path / "RUN")
    found: dict[str, Any] = {}
    exec(blocks[3], found)
    assert run["ego.vx"].iloc[-1] == pytest.approx(0.0, abs=0.01)
    hit = np.isfinite(found["ranges"][-1])
    # Resolution 0.05 m, noise 0.02 m; the wall is 4 m wide.
    assert found["points"][hit, 0].min() == pytest.approx(4.0, abs=0.1)
    assert np.ptp(found["points"][hit, 1]) == pytest.approx(4.0, abs=0.3)


def test_the_world_in_the_readme_is_a_part_of_the_shipped_one():
    blocks = re.findall(r"```yaml\n(.*?)```", (ROOT / "README.md").read_text("utf-8"), re.DOTALL)
    (shown,) = (yaml.safe_load(block) for block in blocks if block.startswith("props:"))
    world = yaml.safe_load((ROOT / "worlds" / "parking_lot.yaml").read_text("utf-8"))
    for key, name in (("props", "prop"), ("tests", "name")):
        for entry in shown[key]:
            (full,) = (other for other in world[key] if other[name] == entry[name])
            assert {given: full.get(given) for given in entry} == entry


def test_the_driver_class_of_the_page_on_worlds_stops_before_a_wall(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    page = (ROOT / "docs" / "worlds.md").read_text("utf-8")
    section = page[page.index("### A driver of your own") :]
    (block,) = re.findall(r"```python\n(.*?)```", section[: section.index("## From Gazebo")], re.DOTALL)
    Path("my_driver.py").write_text(block, encoding="utf-8")
    wall = "mirdrake: world/1\nground: {surface: asphalt}\nstart: {here: {at: [0, 0]}}\n"
    Path("wall.yaml").write_text(f"{wall}props: [{{box: [0.5, 4, 1.5], at: [10, 0]}}]\n", encoding="utf-8")
    spec = {
        "world": str(tmp_path / "wall.yaml"),
        "vehicles": {"ego": {"model": "bolt"}},
        "control": {"ego": {"kind": "my_driver:Careful", "speed": 2.0, "distance": 3.0}},
        "plant": {"contact": "point"},
        "duration": 8.0,
        "folder": str(tmp_path),
    }
    run = Simulation(assemble(spec)).run()
    assert run["ego.vx"].max() > 1.5
    assert run["ego.vx"].iloc[-1] == pytest.approx(0.0, abs=0.01)
    # The nearest beam has 3 m when it brakes; at its 5 m/s² it stops within half a metre.
    front = run["ego.x"].iloc[-1] + volume_of(load_vehicle("bolt")).outline[:, 0].max()
    assert 2.3 < 9.75 - front < 3.0


def test_every_key_of_a_prop_is_in_the_page_on_worlds():
    page = (ROOT / "docs" / "worlds.md").read_text("utf-8")
    section = page[page.index("## Props") : page.index("## Ground and tracks")]
    listed = {
        name for row in re.findall(r"^\| (`.*?) \|", section, re.MULTILINE) for name in re.findall(r"`(\w+)`", row)
    }
    assert listed == {field.alias or name for name, field in PropEntry.model_fields.items()}
    for example in re.findall(
        r"\| `((?:prop|box|cylinder|sphere|group|at|grid|line|ring|along|scatter): .*?)`", section
    ):
        text = example.replace("\\|", "|")
        what, where = (text, "at: [0, 0]") if re.match("prop|box|cylinder|sphere|group", text) else ("prop: cone", text)
        PropEntry.model_validate(yaml.safe_load(f"{{{what}, {where}}}"))


DIAGRAMS = (ROOT / "docs" / "diagrams.md").read_text("utf-8")


def rows_below(head):
    """Return the cells of the table of the page on diagrams with a head, without the head."""
    lines = DIAGRAMS[DIAGRAMS.index(head) :].splitlines()[2:]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in takewhile(str.strip, lines)]


@pytest.fixture(scope="module")
def assemblies():
    """Return the diagrams of the Bolt with wheel torques and of the one with pedals."""
    control = {"ego": {"kind": "path_tracking", "track": "main", "speed": 5.0}}
    specs = [{"world": "test_track", "vehicles": {"ego": {"model": f"bolt{variant}", "start": "line"}}}
             for variant in ("", "@handling")]  # fmt: skip
    return [assemble({**spec, "control": control, "sensors": {"ego": ["imu"]}}, expand=True) for spec in specs]


def test_the_ports_of_a_vehicle_are_those_of_the_table(assemblies):
    rows = rows_below("| port of a vehicle |")
    for side in ("input", "output"):
        listed = {name for cell, row_side, _ in rows if row_side == side for name in re.findall(r"`(\w+)`", cell)}
        listed |= {"command"} if side == "output" else set()  # in the row of its elements
        known = {name for assembly in assemblies for name in getattr(assembly, f"{side}s") if name.count(".") == 1}
        assert listed - {"imu"} == {name.removeprefix("ego.") for name in known} - {"imu"}


def test_the_blocks_of_a_control_unit_are_those_of_the_table(assemblies):
    blocks = {
        block.get_name(): block
        for assembly in assemblies
        for block in assembly.diagram.GetSubsystemByName("ego.control").GetSystems()
    }
    rows = rows_below("| block | class |")
    assert {name for row in rows for name in re.findall(r"`(\w+)`", row[0])} == blocks.keys()
    of_any_size = {"plant_state", "desired_state", "actuation"}  # they depend on the vehicle
    for names, kind, _meaning, inputs, outputs in rows:
        for name in re.findall(r"`(\w+)`", names):
            block = blocks[name]
            assert kind == f"`{type(block).__name__}`"
            for cell, ports in (
                (inputs, [block.get_input_port(index) for index in range(block.num_input_ports())]),
                (outputs, [block.get_output_port(index) for index in range(block.num_output_ports())]),
            ):
                if cell.startswith("all "):
                    continue
                texts = re.split("[;:]", cell)[0].split(", ")
                listed = {text.partition(" ")[0]: int((re.findall(r"\d+", text) or [1])[0]) for text in texts}
                known = {port.get_name(): port.size() for port in ports}
                assert listed == known | dict.fromkeys(of_any_size & known.keys(), 1), name
