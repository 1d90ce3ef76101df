"""Imports go only upstream along the stages of the design; data folders are never packages."""

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from pkgutil import resolve_name

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = ROOT / "mirdrake"

STAGES = {
    "core": 0,
    "ground": 1, "readers": 1, "tyres": 1, "vehicles": 1, "worlds": 1,
    "plant": 2,
    "actors": 3, "controllers": 3,
    "networks": 4, "sensors": 4, "single_track": 4,
    "assembly": 5, "batched": 5, "estimation": 5,
    "runs": 6, "schemas": 6,
    "execution": 7, "gym": 7, "manoeuvres": 7, "requirements": 7,
    "identification": 8, "studies": 8, "suites": 8,
    "tuning": 9, "world_checks": 9,
    "builder": 10, "export": 10, "importing": 10, "viewer": 10,
    "editor": 11, "learning": 11, "report": 12,
    "__init__": 13, "__main__": 13, "cli": 13, "workflow": 13, "world_files": 13,
}  # fmt: skip
DATA_FOLDERS = {"models", "worlds", "diagrams", "studies", "notebooks", "benchmarks", "tests", "tools", "runs"}
MODULES = sorted(PACKAGE.rglob("*.py"))


@cache
def _imports(file: Path) -> list[tuple[int, str]]:
    return list(_read_imports(file))


def _read_imports(file: Path) -> Iterator[tuple[int, str]]:
    """Yield (line, dotted name) of everything a file imports, at any depth and also for type checking only."""
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{file}:{node.lineno}: relative import; write it from mirdrake on"
            yield node.lineno, node.module or ""
            if node.module in {"mirdrake", "pydrake"}:
                yield from ((node.lineno, f"{node.module}.{alias.name}") for alias in node.names)


def _part(file: Path) -> str:
    """Return the module or package directly below mirdrake/ that a file belongs to."""
    return file.relative_to(PACKAGE).parts[0].removesuffix(".py")


def _shown(file: Path) -> str:
    return str(file.relative_to(ROOT))


def _imports_the_package_alone(file: Path, line: int) -> bool:
    return all(name == "mirdrake" for number, name in _imports(file) if number == line)


def test_every_module_has_its_stage() -> None:
    parts = {_part(file) for file in MODULES}
    assert parts <= set(STAGES), f"name the stage of {sorted(parts - set(STAGES))} in STAGES, and in the README's table"


@pytest.mark.essential
def test_a_module_imports_only_from_the_same_or_earlier_stages() -> None:
    faults = []
    for file in MODULES:
        own = STAGES[_part(file)]
        for line, name in _imports(file):
            top, _, rest = name.partition(".")
            if top == "mirdrake" and rest:
                stage = STAGES[rest.split(".")[0]]
                if stage > own:
                    faults.append(f"{_shown(file)}:{line}: stage {own} imports {name} of stage {stage}")
            elif name == "mirdrake" and own != STAGES["cli"] and _imports_the_package_alone(file, line):
                faults.append(f"{_shown(file)}:{line}: the public names are for users; import the module")
    assert faults == []


@pytest.mark.essential
def test_classes_of_later_stages_that_are_named_in_texts_implement_a_base_class_of_the_package() -> None:
    # A registry may name a class of a later stage as "module:Class", which is imported when data ask for that kind. The
    # package that holds the registry uses the class through its own base class only. (`schemas` lists file formats.)
    names = {
        (_part(file), str(node.value))
        for file in MODULES
        if _part(file) != "schemas"
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8")))
        if isinstance(node, ast.Constant) and re.fullmatch(r"mirdrake(\.\w+)+:\w+", str(node.value))
    }
    later = {(part, name) for part, name in names if STAGES[name.split(".")[1].split(":")[0]] > STAGES[part]}
    assert {part for part, _ in later} == {"runs", "vehicles", "worlds"}
    for part, name in later:
        bases = {base.__module__.split(".")[1] for base in resolve_name(name).__mro__ if "mirdrake." in base.__module__}
        assert part in bases, f"{name} does not derive from a class of {part}"


def test_the_modules_import_one_another_without_a_circle() -> None:
    edges: dict[str, set[str]] = {}
    for file in MODULES:
        below = edges.setdefault(_part(file), set())
        for _, name in _imports(file):
            parts = name.split(".")
            if parts[0] == "mirdrake" and len(parts) > 1 and parts[1] != _part(file):
                below.add(parts[1])
    edges.pop("__init__", None)
    while edges:
        free = {part for part, below in edges.items() if not below & set(edges)}
        assert free, f"these import one another in a circle: {sorted(edges)}"
        for part in free:
            del edges[part]


def test_data_folders_are_not_imported_and_pydrake_all_is_not_used() -> None:
    faults = []
    for file in MODULES + sorted((ROOT / "tests").glob("*.py")):
        for line, name in _imports(file):
            # Tests share modules, and check tools/ and benchmarks/.
            is_shared = file.parent.name == "tests" and name.split(".")[0] in {"tests", "tools", "benchmarks"}
            if name.split(".")[0] in DATA_FOLDERS and not is_shared:
                faults.append(f"{_shown(file)}:{line}: {name} is a folder of data, not a package")
            if name.startswith("pydrake.all"):
                faults.append(f"{_shown(file)}:{line}: import names from their pydrake modules")
    assert faults == []


def test_data_folders_have_no_init_file() -> None:
    assert [folder for folder in sorted(DATA_FOLDERS) if (ROOT / folder / "__init__.py").exists()] == []


def test_the_checkout_has_no_share_folder() -> None:
    assert not (PACKAGE / "share").exists(), "mirdrake/share belongs into the wheel only; it would hide models/"
