"""Damaged run folders and hostile files end in one line."""

import random
import re
import time
from pathlib import Path

import pytest

from mirdrake.assembly.diagram import make_spec
from mirdrake.core.errors import ConfigError, MirdrakeError
from mirdrake.core.paths import data_root
from mirdrake.core.yaml_tree import parse_tree
from mirdrake.runs.logs import load_run
from mirdrake.runs.simulation import simulate
from mirdrake.schemas import check_file
from mirdrake.worlds import load_world
from mirdrake.worlds.csv_tracks import read_csv_track
from tests.timing import is_within

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


@pytest.mark.parametrize("record", ["{start_time: nwll}", "{start_time: [1]}", "{start_time: 3}", "3", "null", "[]"])
def test_a_damaged_start_time_names_the_file(contents: dict[str, bytes], tmp_path: Path, record: str) -> None:
    for name, content in contents.items():
        (tmp_path / name).write_bytes(content)
    (tmp_path / "spec.yaml").write_text(f"record: {record}\n", encoding="utf-8")
    run = load_run(tmp_path)
    with pytest.raises(ConfigError, match="damaged, cannot be read"):
        run.start  # noqa: B018


def test_thousands_of_unknown_keys_are_reported_in_two_seconds() -> None:
    began = time.process_time()
    with pytest.raises(ConfigError) as caught:
        make_spec(
            {"world": "test_track", "vehicles": {"ego": {"model": "bolt"}}}
            | {f"durations{i}": 1 for i in range(20_000)}
        )
    assert is_within(time.process_time() - began, 2.0)
    assert "more faults; correct these first" in str(caught.value)


@pytest.mark.parametrize("name", ["../../x", "a/b", "a\\b", "a\nb"])
def test_a_name_stays_inside_the_folder_of_runs(name: str) -> None:
    with pytest.raises(ConfigError, match="part of the name of a run folder"):
        make_spec({"world": "test_track", "vehicles": {"ego": {"model": "bolt"}}, "name": name})


@pytest.mark.parametrize("digits", [310, 400, 4000, 5000])
@pytest.mark.parametrize("sign", ["", "-", "+"])
def test_a_whole_number_beyond_the_range_of_floats_is_rejected_with_its_line(digits: int, sign: str) -> None:
    with pytest.raises(ConfigError, match="f:2: not a number, or too long"):
        parse_tree(f"a: 1\nb: {sign}{'9' * digits}\n", "f")


@pytest.mark.parametrize("key", ["plant.time_step", "control.ego.period"])
@pytest.mark.parametrize("value", [1e-12, 9e-6, 5e-324])
def test_a_period_too_short_for_a_run_to_end_is_rejected(key: str, value: float) -> None:
    top, *_, last = key.split(".")
    data = {"world": "test_track", "vehicles": {"ego": {"model": "bolt"}}}
    part = {last: value} if top == "plant" else {"ego": {"kind": "constant", "speed": 5, last: value}}
    with pytest.raises(ConfigError, match="s is too short; at least 1e-05 s"):
        make_spec(data | {top: part})


def test_messages_are_printable_and_not_too_long() -> None:
    for code in (0, 7, 0x13, 0x1B, 0x85, 0x2028, 0xFEFF, 0xD800):
        assert all(line.isprintable() for line in str(ConfigError(f"a: '{chr(code)}'\nb")).splitlines())
    assert len(str(ConfigError("9" * 5000))) <= 1000
    assert str(ConfigError("a\nb")) == "a\nb"


_VALUES = (
    "nan",
    ".inf",
    "1e400",
    "9" * 400,
    "-0",
    "null",
    "2026-05-31",
    "!!binary aGk=",
    "*x",
    "{<<: 3}",
    "[[[1]]]",
    "\0",
)


@pytest.mark.parametrize("name", ["worlds/neighbourhood", "diagrams/bolt_test_track", "models/bolt/vehicle", "track"])
def test_a_file_with_mutations_is_read_or_rejected_in_printable_lines(name: str, tmp_path: Path) -> None:
    random_of = random.Random(name)
    track = "x,y\n" + "".join(f"{step},{step * step}\n" for step in range(30))
    text = track if name == "track" else (data_root() / f"{name}.yaml").read_text(encoding="utf-8")
    path = tmp_path / Path(f"{name}.{'csv' if name == 'track' else 'yaml'}").name
    for _ in range(25):
        lines = text.splitlines()
        index, kind = random_of.randrange(len(lines)), random_of.randrange(4)
        if kind == 0:
            del lines[index]
        elif kind == 1:
            lines.insert(index, random_of.choice(lines))
        elif kind == 2:
            cut = random_of.randrange(len(lines[index]) + 1)
            lines[index] = (
                lines[index][:cut] + chr(random_of.choice([0, 0x13, 0x85, 0x2028, 0xFEFF])) + lines[index][cut:]
            )
        else:
            lines[index] = re.sub(r"-?\d+(\.\d+)?", lambda _: random_of.choice(_VALUES), lines[index], count=1)
        path.write_text("\n".join(lines), encoding="utf-8")
        message = ""
        try:
            if name == "track":
                read_csv_track(path)
            elif name.startswith("worlds"):
                load_world(str(path))
            else:
                check_file(path)
        except MirdrakeError as error:
            message = str(error)
        assert all(line.isprintable() and len(line) <= 1000 for line in message.splitlines())
