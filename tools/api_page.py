"""The lists of docs/api.md, which ``python -m tools.api_page docs/api.md`` writes."""

import ast
import re
import sys
from pathlib import Path

import mirdrake
from tests.test_layers import STAGES

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = ROOT / "mirdrake"

MODULES = (
    "vehicles", "vehicles.inspection", "importing.vehicles", "importing.worlds", "worlds", "plant.plant", "tyres",
    "plant.wheels", "plant.suspension", "plant.aerodynamics", "plant.powertrain", "controllers", "sensors",
    "core.signals", "assembly.diagram", "assembly.blocks", "sensors.perception", "single_track", "runs.simulation",
    "runs.logs", "requirements", "gym.testing", "gym", "manoeuvres", "studies", "tuning", "tuning.tune",
    "identification", "identification.identify", "suites", "world_checks", "viewer", "viewer.inline", "report",
    "export", "workflow", "world_files", "schemas",
)  # fmt: skip
"""Modules whose public names are for users."""


def public_names(module: str) -> list[tuple[str, str]]:
    """(name, first sentence of its docstring) of the public names of a module: ``__all__``, or the names it defines."""
    path = _file(module)
    tree = ast.parse(path.read_text(encoding="utf-8"))
    listed: list[str] | None = None
    for node in tree.body:
        if isinstance(node, ast.Assign) and "__all__" in _targets(node):
            listed = ast.literal_eval(node.value)
    own = {node.name: node for node in tree.body if isinstance(node, ast.ClassDef | ast.FunctionDef)}
    names = listed if listed is not None else [name for name in own if not name.startswith("_")]
    return [(name, _sentence(name, own, tree, module)) for name in sorted(names)]


def summary(module: str) -> str:
    """Return the first sentence of a module's docstring."""
    return _first(ast.get_docstring(ast.parse(_file(module).read_text(encoding="utf-8"))) or "")


def names_of_mirdrake() -> dict[str, str]:
    """Public name of the package -> module it comes from."""
    return {name: module.removeprefix("mirdrake.") for name, module in mirdrake.public_modules().items()}


def write_page(text: str) -> str:
    """Return a page with both lists filled in."""
    rows = ["| name | stage | module | what |", "|---|---|---|---|"]
    for name, module in sorted(names_of_mirdrake().items(), key=lambda item: (_stage(item[1]), item[0])):
        words = dict(public_names(module)).get(name, "")
        rows.append(f"| `{name}` | {_stage(module)} | `mirdrake.{module}` | {words} |")
    text = _fill(text, "public names", rows)
    rows = ["| stage | module | what | names |", "|---|---|---|---|"]
    for module in sorted(MODULES, key=lambda module: (STAGES.get(module.split(".")[0], 9), module)):
        names = ", ".join(f"`{name}`" for name, _ in public_names(module) if name != name.upper())
        rows.append(f"| {STAGES.get(module.split('.')[0], '')} | `mirdrake.{module}` | {summary(module)} | {names} |")
    return _fill(text, "modules", rows)


def _fill(text: str, mark: str, rows: list[str]) -> str:
    pattern = re.compile(rf"(<!-- {mark} -->\n)(?:\|[^\n]*\n)*")
    assert pattern.search(text), f"the page has no mark {mark}"
    return pattern.sub(lambda match: match.group(1) + "\n".join(rows) + "\n", text)


def _stage(module: str) -> int:
    return STAGES[module.split(".")[0]]


def _file(module: str) -> Path:
    base = PACKAGE.joinpath(*module.split("."))
    return base / "__init__.py" if base.is_dir() else base.with_suffix(".py")


def _sentence(name: str, own: dict[str, ast.ClassDef | ast.FunctionDef], tree: ast.Module, module: str) -> str:
    """Return the first sentence of a name, also of one imported from another module of the package."""
    if name in own:
        return _first(ast.get_docstring(own[name]) or "")
    # The names of a package that are loaded when they are first used are imported for type checkers alone.
    later = [node for block in tree.body if isinstance(block, ast.If) for node in block.body]
    for node in [*tree.body, *later]:
        if isinstance(node, ast.ImportFrom) and any((alias.asname or alias.name) == name for alias in node.names):
            source = (node.module or "").removeprefix("mirdrake.")
            if (node.module or "").startswith("mirdrake.") and source != module:
                below = ast.parse(_file(source).read_text(encoding="utf-8"))
                inner = {item.name: item for item in below.body if isinstance(item, ast.ClassDef | ast.FunctionDef)}
                return _sentence(name, inner, below, source)
    return ""


def _first(docstring: str) -> str:
    """Return the first paragraph on one line, its references as code, without the bar that ends a cell of a table."""
    paragraph = " ".join(docstring.split("\n\n")[0].split())
    paragraph = re.sub(r":\w+:`~?([^`]+)`", r"`\1`", paragraph).replace("``", "`").replace("|", "\\|")
    return paragraph.partition(". ")[0].rstrip(".:")


def _targets(node: ast.Assign) -> list[str]:
    return [target.id for target in node.targets if isinstance(target, ast.Name)]


if __name__ == "__main__":
    target = Path(sys.argv[1])
    target.write_text(write_page(target.read_text(encoding="utf-8")), encoding="utf-8")
