"""JSON Schemas: shipped files are valid, files that readers reject are not, every number states its unit."""

import json
import re
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import yaml

from mirdrake.cli import main
from mirdrake.core.errors import ConfigError
from mirdrake.core.yaml_tree import parse_tree
from mirdrake.schemas import KINDS, make_schema

jsonschema = pytest.importorskip("jsonschema")

ROOT = Path(__file__).resolve().parent.parent
GLOBS = {
    "vehicle": "models/*/vehicle.yaml",
    "control": "models/*/control.yaml",
    "sensors": "models/*/sensors.yaml",
    "variant": "models/*/variants/*.yaml",
    "figures": "models/*/published_figures.yaml",
    "presets": "models/sensors/*.yaml",
    "prop": "models/props/*/prop.yaml",
    "world": "worlds/*.yaml",
    "diagram": "diagrams/*.yaml",
}
MARKED = [*sorted(ROOT.glob("studies/**/*.yaml")), *sorted(ROOT.glob("worlds/groups/*.yaml"))]
"""Files that name their kind in the key `mirdrake`, as world/1."""


def kind_of(path: Path) -> str:
    return str(yaml.safe_load(path.read_text("utf-8"))["mirdrake"]).partition("/")[0]


FILES = [(kind, path) for kind, pattern in GLOBS.items() for path in sorted(ROOT.glob(pattern))]
FILES += [(kind_of(path), path) for path in MARKED]


def faults(kind: str, data: Any) -> list[str]:
    validator = jsonschema.Draft202012Validator(make_schema(kind))
    return [f"{list(fault.absolute_path)}: {fault.message[:200]}" for fault in validator.iter_errors(data)]


@pytest.mark.parametrize("kind", KINDS)
def test_a_schema_is_one(kind):
    schema = make_schema(kind)
    jsonschema.Draft202012Validator.check_schema(schema)
    references = set(re.findall(r'"#/\$defs/([^"]+)"', json.dumps(schema)))
    assert references <= set(schema.get("$defs", {})), "a reference leads nowhere"


@pytest.mark.parametrize(
    ("kind", "path"), FILES, ids=[f"{kind}-{path.parent.name}-{path.stem}" for kind, path in FILES]
)
def test_shipped_files_are_valid(kind, path):
    data, _ = parse_tree(path.read_text("utf-8"), path.name)
    assert faults(kind, data) == []


def test_each_kind_of_shipped_file_was_tried():
    assert {kind for kind, _ in FILES} == {*GLOBS, "tuning", "identification", "learning"}
    assert set(GLOBS) <= set(KINDS)
    shipped = {
        path for folder in ("models", "worlds", "diagrams", "studies") for path in (ROOT / folder).rglob("*.yaml")
    }
    assert shipped == {path for _, path in FILES}, "a file that no schema was tried on"


@pytest.mark.parametrize(
    ("kind", "text", "path"),
    [
        ("diagram", "{world: empty, vehicles: {ego: {model: bolt}}, duratoin: 3 s}", "duratoin"),
        ("diagram", "{world: empty, vehicles: {ego: {model: bolt}}, control: {ego: {kind: path_trackin}}}", "ego"),
        ("diagram", "{world: empty, vehicles: {ego: {model: bolt}}, control: {ego: {kind: constant, sped: 3}}}", "ego"),
        ("diagram", "{world: empty, vehicles: {ego: {model: bolt}}, systems: {a: {kind: gain}}}", "a"),
        ("diagram", "{world: empty, vehicles: {ego: {model: bolt}}, plant: {contact: pont}}", "pont"),
        ("world", "{mirdrake: world/1, name: x, ground: {mu: slippery}}", "mu"),
        ("world", "{mirdrake: world/2, name: x}", "world/1"),
        ("sensors", "{mounts: {a: {preset: sick_lms291}}}", "a"),
        ("sensors", "{mounts: {a: {preset: sick_lms291, frame: f, colour: red}}}", "a"),
        ("variant", "{description: x, vehicle: {tires: {}}}", "tires"),
        ("study", "{diagram: x, metrics: [ego.distance_m]}", "parameters"),
        ("data", "{mirdrake: data/1}", "logs"),
    ],
)
def test_files_that_readers_reject_are_not_valid(kind, text, path):
    reported_faults = faults(kind, yaml.safe_load(text))
    assert reported_faults
    assert path in " ".join(reported_faults)


@pytest.mark.parametrize(
    ("kind", "text"),
    [
        ("diagram", "{world: {name: empty, seed: 3}, vehicles: {ego: {model: bolt, speed: 36 km/h}}}"),
        ("diagram", "{world: empty, vehicles: {ego: {model: b}}, control: {ego: {kind: 'm:C', gain: 3}}}"),
        ("diagram", "{world: empty, vehicles: {ego: {model: b}}, systems: {a: {kind: 'm:C', x: 3}}}"),
        ("diagram", "{world: empty, vehicles: {ego: {model: b}}, systems: {a: {kind: low_pass, time_constant: 5 ms}}}"),
        (
            "diagram",
            "{world: w, vehicles: {e: {model: b}}, systems: {a: {kind: filter_bank, vehicle: b, sensors: [vx]}}}",
        ),
        (
            "diagram",
            "{world: w, vehicles: {e: {model: b}}, systems: {a: {kind: filter_bank, vehicle: b, sensors: {vx: 0.1}}}}",
        ),
        ("world", "{mirdrake: world/1, name: x, params: {m: 0.3}, ground: {mu: $m}}"),
        ("sensors", "{mounts: {imu: {kind: imu, frame: f, rate: 9, gyro_noise: {white: 0.1 deg/s}}}}"),
        ("data", "{mirdrake: data/1, channels: {vx: Speed}, logs: [{file: a.csv, end: 3 min}]}"),
        ("world", "{mirdrake: world/1, name: x, tracks: {a: {csv: a.csv, width: 3}}}"),
        ("variant", "{description: x, vehicle: {brakes: {abs: true}, powertrain: {traction: false}}}"),
        ("sensors", "{mounts: {imu: {kind: imu, frame: f, rate: 9, gyro_noise: 0.1 deg/s}}}"),
        ("sensors", "{mounts: {a: {preset: mine_of_my_own, frame: f, rate: 5}}}"),
        ("learning", "{mirdrake: learning/1, diagram: bolt_test_track, rounds: 2}"),
    ],
)
def test_short_forms_and_user_classes_are_valid(kind, text):
    assert faults(kind, yaml.safe_load(text)) == []


_schema = cache(make_schema)
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_the_yaml_of_a_page_has_existing_keys_and_valid_values(page):
    """Each example is a file of some kind or a part of one, so that required keys may be missing."""
    for text in re.findall(r"```yaml\n(.*?)```", page.read_text("utf-8"), re.DOTALL):
        data, _ = parse_tree(text, page.name)
        kinds = [kind for kind in KINDS if set(data) <= set(_schema(kind)["properties"])]
        assert kinds, f"no kind of file has the keys {sorted(data)}"
        assert min((_present_faults(kind, data) for kind in kinds), key=len) == [], text


def _present_faults(kind: str, data: Any) -> list[str]:
    """Return the faults of the keys that are present."""
    validator = jsonschema.Draft202012Validator(_schema(kind))
    return [fault.message[:200] for fault in validator.iter_errors(data) if fault.validator != "required"]


@pytest.mark.parametrize("kind", ["control", "diagram", "study"])
def test_numbers_of_a_format_document_their_unit(kind):
    schema = make_schema(kind)
    bare = [
        f"{name}.{key}"
        for name, part in schema.get("$defs", {}).items()
        for key, value in part.get("properties", {}).items()
        if value.get("type") in {"number", "integer"} and not re.search(r"\[.+\]", value.get("description", ""))
    ]
    assert bare == []


def test_the_verb_lists_prints_and_writes(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["schema"]) == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == list(KINDS)
    assert main(["schema", "diagram"]) == 0
    printed = capsys.readouterr().out
    assert json.loads(printed) == make_schema("diagram")
    assert main(["schema", "--out", str(tmp_path / "schemas")]) == 0
    assert {path.stem for path in (tmp_path / "schemas").glob("*.json")} == set(KINDS)
    assert (tmp_path / "schemas" / "diagram.json").read_text("utf-8") == printed
    *lines, _ = capsys.readouterr().out.splitlines()
    assert [line.partition("# yaml-language-server: $schema=")[2] for line in lines] == [
        f"schemas/{kind}.json" for kind in KINDS
    ]
    assert main(["schema", "diagramm"]) == 2
    assert "unknown file format 'diagramm'; did you mean 'diagram'?" in capsys.readouterr().err


def test_an_unknown_kind_is_reported():
    with pytest.raises(ConfigError, match="did you mean 'world'"):
        make_schema("worlds")
