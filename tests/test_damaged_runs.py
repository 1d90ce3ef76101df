"""Damaged run folders and hostile files end in one line."""

import random
import time
from pathlib import Path

import pytest

from mirdrake.diagram import make_spec
from mirdrake.errors import ConfigError
from mirdrake.logs import load_run
from mirdrake.simulation import simulate

FILES = ("spec.yaml", "summary.json", "signals.parquet", "events.jsonl")


@pytest.fixture(scope="module")
def contents(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    folder = tmp_path_factory.mktemp("runs") / "run"
    simulate("bolt_test_track", duration=0.1, folder=folder)
    return {name: (folder / name).read_bytes() for name in FILES if (folder / name).is_file()}


def _damage(content: bytes, random_of: random.Random) -> bytes:
    """Return the content with one hostile change."""
    kind = random_of.randrange(5)
    if kind == 0:
        return content[: random_of.randrange(len(content) + 1)]
    if kind == 1:
        return b""
    if kind == 2:
        return random_of.choice([b"[]", b"null", b"3", b"{" * 5000, b"\xff\xfe", b"a: [", b"9" * 5000, b'"x"\n'])
    damaged = bytearray(content)
    for _ in range(random_of.randrange(1, 20)):
        if damaged:
            damaged[random_of.randrange(len(damaged))] ^= 1 << random_of.randrange(8)
    return bytes(damaged)


@pytest.mark.parametrize("seed", range(5))
def test_a_damaged_run_folder_is_read_or_reported_on_one_line(
    contents: dict[str, bytes], tmp_path: Path, seed: int
) -> None:
    random_of = random.Random(seed)
    for case in range(20):
        folder = tmp_path / str(case)
        folder.mkdir()
        for name, content in contents.items():
            (folder / name).write_bytes(content)
        name = random_of.choice(list(contents))
        change = random_of.randrange(6)
        if change < 2:
            (folder / name).unlink()
        if change == 0:
            (folder / name).mkdir()
        elif change == 1:
            (folder / name).symlink_to(folder / name)
        else:
            (folder / name).write_bytes(_damage(contents[name], random_of))
        message = ""
        try:
            load_run(folder).signals  # noqa: B018
        except ConfigError as error:
            message = str(error)
        assert len(message.splitlines()) <= 1
        assert not message or str(folder) in message


def test_thousands_of_unknown_keys_are_reported_in_two_seconds() -> None:
    began = time.process_time()
    with pytest.raises(ConfigError) as caught:
        make_spec(
            {"world": "test_track", "vehicles": {"ego": {"model": "bolt"}}}
            | {f"durations{i}": 1 for i in range(20_000)}
        )
    assert time.process_time() - began < 2.0
    assert "more faults; correct these first" in str(caught.value)


@pytest.mark.parametrize("name", ["../../x", "a/b", "a\\b", "a\nb"])
def test_a_name_stays_inside_the_folder_of_runs(name: str) -> None:
    with pytest.raises(ConfigError, match="part of the name of a run folder"):
        make_spec({"world": "test_track", "vehicles": {"ego": {"model": "bolt"}}, "name": name})
