"""Draw the packages of mirdrake and their imports: docs/architecture.svg, from the source files.

    python tools/architecture.py

Packages of one stage are in one row, an arrow goes from a package to one that uses it. Needs Graphviz.
"""

import ast
import subprocess
import sys
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = ROOT / "mirdrake"


def part_of(file: Path) -> str:
    """Return the package or module directly below mirdrake/ that a file belongs to."""
    return file.relative_to(PACKAGE).parts[0].removesuffix(".py")


def imports() -> dict[str, set[str]]:
    """Return the packages that each package imports."""
    imported: dict[str, set[str]] = defaultdict(set)
    for file in PACKAGE.rglob("*.py"):
        part = part_of(file)
        if part.startswith("__"):
            continue
        imported[part]
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("mirdrake."):
                other = str(node.module).split(".")[1]
                if other != part:
                    imported[part].add(other)
    return imported


def stages(edges: dict[str, set[str]]) -> dict[str, int]:
    """Return the stage of each package: one more than the latest of those that it imports."""
    level: dict[str, int] = {}

    def of(part: str) -> int:
        if part not in level:
            level[part] = 1 + max((of(other) for other in edges[part]), default=-1)
        return level[part]

    for part in edges:
        of(part)
    return level


def reduced(edges: dict[str, set[str]]) -> dict[str, set[str]]:
    """Return the edges without those that follow from others (transitive reduction)."""

    def reach(part: str) -> set[str]:
        return set().union(*({other} | reach(other) for other in edges[part])) if edges[part] else set()

    return {
        part: {other for other in others if not any(other in reach(between) for between in others - {other})}
        for part, others in edges.items()
    }


def main() -> int:
    """Write the picture."""
    edges = imports()
    level = stages(edges)
    lines = [
        "digraph mirdrake {",
        '  rankdir=BT; ranksep=0.35; nodesep=0.25; bgcolor="white";',
        '  node [shape=box, style="rounded,filled", fillcolor="#eef3f8", color="#5b7a99", fontname="Helvetica"];',
        '  edge [color="#8aa0b5", arrowsize=0.6];',
    ]
    for stage in sorted(set(level.values())):
        names = " ".join(f'"{part}";' for part in sorted(level) if level[part] == stage)
        lines.append(f"  {{ rank=same; {names} }}")
    lines += [
        f'  "{other}" -> "{part}";' for part, others in sorted(reduced(edges).items()) for other in sorted(others)
    ]
    text = "\n".join([*lines, "}"])
    done = subprocess.run(["dot", "-Tsvg"], input=text, capture_output=True, text=True, check=True)
    (ROOT / "docs" / "architecture.svg").write_text(done.stdout, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
