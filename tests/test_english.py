"""Texts and names use the terms of the field; words of the project's former dialect do not come back."""

import re
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
KINDS = {".py", ".md", ".yaml", ".jinja", ".js", ".html", ".ipynb", ".xacro", ".toml"}
WORDS = [
    r"\b(is|are|was) told\b", r"\btells? (of|that|how|what)\b", r"\bmend(s|ed|ing)?\b", r"\bhomeless\b",
    r"\bshak(e|es|en)\b",
    r"\bis no (number|vector|car|plane|chance)\b", r"\bhow far from the edge\b", r"\bgiven up for what\b",
    r"\bway (driven|to the side)\b", r"\bfeels? the (air|road)\b", r"\bwithout a word\b", r"\bfor ever\b",
    r"\band its like\b",
    r"\bof one's own\b", r"\bDo it\.", r"\bstands? (every|all|in all) runs?\b", r"\bmade (log|car|vehicle)s?\b",
    r"\bgives? way\b", r"\bknobs?\b", r"\blay[ _]over\b", r"\bclos(es|ed) the question\b", r"\bturns in most quickly\b",
    r"\binput is back\b", r"\bmoment against overturning\b", r"\bpatches and points\b",
]  # fmt: skip
"""Patterns that no file contains; the CHANGELOG has some of them in its table of renamed things."""

EXEMPT = {"CHANGELOG.md", "tests/test_english.py"}


def files() -> list[str]:
    """Return the tracked text files; without Git the test is skipped, as build results would be among the files."""
    try:
        out = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout.split(
            "\n"
        )
    except (OSError, subprocess.CalledProcessError):
        pytest.skip("needs a Git checkout")
    return [name for name in out if Path(name).suffix in KINDS and name not in EXEMPT and (ROOT / name).is_file()]


def test_no_text_has_words_of_the_former_dialect() -> None:
    pattern = re.compile("|".join(WORDS), re.IGNORECASE)
    hits = [
        f"{name}:{number}: {match.group()}"
        for name in files()
        for number, line in enumerate((ROOT / name).read_text(encoding="utf-8", errors="replace").splitlines(), 1)
        if (match := pattern.search(line))
    ]
    assert hits == []
