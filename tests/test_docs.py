"""What the documentation shows works."""

import re
from pathlib import Path

import pytest

from mirdrake.suites import collect_cases
from mirdrake.worlds import load_world

ROOT = Path(__file__).resolve().parent.parent
PAGES = [ROOT / "README.md", ROOT / "CHANGELOG.md", *sorted((ROOT / "docs").glob("*.md"))]
WORLDS = [
    (page.name, number, text)
    for page in PAGES
    for number, text in enumerate(
        re.findall(r"```yaml\n(mirdrake: world/1\n.*?)```", page.read_text("utf-8"), re.DOTALL)
    )
]


@pytest.mark.parametrize(("page", "number", "text"), WORLDS, ids=[f"{page}-{number}" for page, number, _ in WORLDS])
def test_a_world_in_the_documentation_is_sound(tmp_path, page, number, text):
    path = tmp_path / f"{page}{number}.yaml"
    path.write_text(text, encoding="utf-8")
    world = load_world(str(path))
    assert not world.homeless
    assert world.rules is not None
    assert not world.rules.broken(world.props)
    assert len(collect_cases([path])) >= len(world.spec.tests)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page):
    for target in re.findall(r"\]\(([^)#\s]+)[^)]*\)", page.read_text(encoding="utf-8")):
        if "://" not in target:
            assert (page.parent / target).exists(), f"{page.name}: {target}"
