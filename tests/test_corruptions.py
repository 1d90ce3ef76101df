"""Damaged vehicle folders: a working vehicle or a one-line error, never a crash, hang or traceback.

Every broken folder is loaded and driven for a moment in a process of its own, so that a crash of Drake would be seen.
A fault is drawn from a seed; ``python tests/test_corruptions.py 200 2200`` tries as many more as you like.
"""

import multiprocessing
import os
import re
import shutil
import sys
import tempfile
import traceback
from collections import Counter
from collections.abc import Callable, Iterator
from multiprocessing.connection import Connection
from pathlib import Path
from random import Random
from typing import Any

import pytest

from mirdrake.core.paths import data_root

BOLT = data_root() / "models" / "bolt"
FILES = sorted(path.name for path in BOLT.iterdir() if path.suffix in {".xacro", ".yaml"})
CASES = 150
LIMIT = 30.0  # [s] to load, and to drive


# --- a process that tries vehicles out -------------------------------------------------------------------------------


class Worker:
    """A process that tries vehicle folders one after the other; replaced when it dies."""

    def __init__(self) -> None:
        self.process: Any = None
        self.pipe: Connection | None = None

    def try_out(self, name: str) -> str:
        """Return the outcome of a vehicle: "drives", "error: ...", or the failure of the process."""
        if self.process is None or not self.process.is_alive():
            context = multiprocessing.get_context("spawn")
            self.pipe, far = context.Pipe()
            self.process = context.Process(target=serve, args=(far,), daemon=True)
            self.process.start()
            far.close()
            assert self.pipe.poll(60.0), "the worker does not start"
            self.pipe.recv()
        assert self.pipe is not None
        self.pipe.send(name)
        try:
            if not self.pipe.poll(LIMIT):
                self.close()
                return f"hangs for more than {LIMIT:g} s"
            return str(self.pipe.recv())
        except EOFError:
            self.process.join(5.0)
            return f"crashes the process (exit code {self.process.exitcode})"

    def close(self) -> None:
        """End the process."""
        if self.process is not None:
            self.process.kill()
            self.process.join()


def serve(pipe: Connection) -> None:
    """Load and drive the vehicles that come in; answer each with one text."""
    import resource

    from pydrake.systems.analysis import Simulator
    from pydrake.systems.framework import DiagramBuilder

    from mirdrake.core.errors import MirdrakeError
    from mirdrake.plant.plant import PlantSpec, make_plant, set_start
    from mirdrake.vehicles import load_vehicle
    from mirdrake.worlds import load_world

    resource.setrlimit(resource.RLIMIT_AS, (8 << 30, 8 << 30))  # a fault must not eat the machine's memory
    world = load_world("empty")
    pipe.send("ready")
    for number in range(sys.maxsize):
        name = pipe.recv()
        try:
            vehicle = load_vehicle(name)
            builder = DiagramBuilder()
            spec = PlantSpec(contact="hydroelastic" if number % 5 == 0 else "point")
            parts = make_plant(builder, world, {"ego": vehicle}, spec=spec)
            plant, part = parts.plant, parts.vehicles["ego"]
            simulator = Simulator(builder.Build())
            context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
            set_start(plant, context, part, x=0.0, y=0.0, yaw=0.0)
            for port in (
                plant.get_actuation_input_port(part.instance),
                plant.get_desired_state_input_port(part.instance),
            ):
                port.FixValue(context, [0.0] * port.size())
            simulator.AdvanceTo(0.05)
            answer = "drives"
        except MirdrakeError as error:
            answer = f"error: {error}"
        except BaseException:
            answer = f"raises {traceback.format_exc()}"
        pipe.send(answer)


def complaint(result: str, folder: Path) -> str:
    """Return the fault of a worker's result; empty without a fault."""
    if result == "drives":
        return ""
    if not result.startswith("error: "):
        return result
    for line in result.removeprefix("error: ").splitlines():  # a file with several faults gets a line for each
        if not re.search(rf"\.yaml|\.xacro|\.gltf|\b{folder.name}\b", line):
            return f"no file named: {line}"
        if len(line) > 600 or not line.isprintable():
            return f"no line to print: {line}"
    return ""


@pytest.fixture(scope="module")
def worker() -> Iterator[Worker]:
    running = Worker()
    yield running
    running.close()


# --- faults ----------------------------------------------------------------------------------------------------------

NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:e-?\d+)?(?![\w.])")
TAG = re.compile(r"<(?!/|\?|!)[\w:]+[^<>]*?/>|<(?P<name>[\w:]+)(?:\s[^<>]*)?>.*?</(?P=name)>", re.DOTALL)
NAME = re.compile(r'(?<=")[a-z_]{4,}(?=")|(?<=: )[a-z]+_[a-z_]+$', re.MULTILINE)
KEY = re.compile(r"\b[a-z_]{2,}(?=: |:$|=\")", re.MULTILINE)
REFERENCE = re.compile(r'(?:(?<=filename=")|(?<=link=")|(?<=joint=")|(?<=reference="))[^"]+(?=")|(?<=: )\w+_joint\b')
EXPRESSION = re.compile(r"\$\{[^}]*\}")
NUMBERS = (
    *("nan", "inf", "-inf", ".nan", ".inf", "0", "-1", "1e308", "-1e308", "1e-300", "1e9", "-0.0", "", "1,5", "two"),
    *("0x10", "1e400", "${x}", "1 2", "true", "null", "9" * 400, "[1]", "{a: 1}"),
)
CHARACTERS = ("<", ">", '"', "&", ":", "\t", "\x00", "é", "{", "- ", "\n", "\ufeff", "\u2028", "$", "${", "$(")
NAMES = ("nothing", "base_link", "world", "", "front_left_wheel", "a b", "../meshes", "..", "/", "é", "n" * 300)
EXPRESSIONS = (
    *("${1/0}", "${10**400}", "${[]}", "${None}", "${'a' * 50}", "${f(}", "${x.y}", "${__import__('os')}", "$(arg no)"),
    *("$(find no)", "$(env NO)", "$(eval 1)", "${xacro.load_yaml('no.yaml')}", "${lambda: 1}", "${wheelbase}" * 9),
)

Fault = Callable[[Random, str], str]


def replaced(pattern: re.Pattern[str], change: Callable[[Random, str], str]) -> Fault:
    """Return a fault that changes one match of a pattern."""

    def fault(random: Random, text: str) -> str:
        places = [match.span() for match in pattern.finditer(text)]
        if not places:
            return without_line(random, text)
        begin, end = random.choice(places)
        return text[:begin] + change(random, text[begin:end]) + text[end:]

    return fault


def exchanged(pattern: re.Pattern[str], *, copy: bool) -> Fault:
    """Return a fault that exchanges two matches of a pattern, or writes one over the other."""

    def fault(random: Random, text: str) -> str:
        places = [match.span() for match in pattern.finditer(text)]
        if len(places) < 2:
            return without_line(random, text)
        (a, b), (c, d) = sorted(random.sample(places, 2))
        if b > c:
            return text
        first = text[a:b] if copy else text[c:d]
        return text[:a] + first + text[b:c] + text[a:b] + text[d:]

    return fault


def misspelt(random: Random, word: str) -> str:
    """Return a word with two letters exchanged, one missing, or one too many."""
    index = random.randrange(len(word))
    return (
        word[:index]
        + random.choice(["", word[index] * 2, word[index + 1 : index + 2] + word[index]])
        + word[index + 1 :]
    )


def without_line(random: Random, text: str) -> str:
    lines = text.splitlines(keepends=True)
    index = random.randrange(len(lines))
    return "".join(lines[:index] + lines[index + 1 :])


def twice_a_line(random: Random, text: str) -> str:
    lines = text.splitlines(keepends=True)
    index = random.randrange(len(lines))
    return "".join(lines[: index + 1] + lines[index:])


def with_character(random: Random, text: str) -> str:
    index = random.randrange(len(text))
    return text[:index] + random.choice(CHARACTERS) + text[index:]


def cut_off(random: Random, text: str) -> str:
    return text[: random.randrange(len(text))]


def nested(random: Random, text: str) -> str:
    """Nest a value thousands of levels deep, below the present one or instead of it."""
    depth = random.choice([70, 500, 5000, 100_000])
    if "</robot>" in text:
        tag = random.choice(["link", "group", "xacro:if value='1'"])
        return text.replace("</robot>", f"<{tag}>" * depth + f"</{tag.split()[0]}>" * depth + "</robot>")
    if text.lstrip().startswith("{"):
        return random.choice(["[" * depth + "]" * depth, '{"a":' * depth + "1" + "}" * depth])
    deep = "".join(f"{' ' * level}a:\n" for level in range(min(depth, 2000)))
    return random.choice([text + "sources2: " + "[" * depth + "]" * depth + "\n", deep, "- " * depth])


def multiplied(random: Random, text: str) -> str:
    """Return a small text that expands to billions of words."""
    if "<robot" in text:
        lines = ['<!ENTITY a0 "lol">', *(f'<!ENTITY a{n} "{f"&a{n - 1};" * 10}">' for n in range(1, 12))]
        text = re.sub(r"(<robot)", "<!DOCTYPE robot [" + "".join(lines) + r"]>\1", text, count=1)
        return re.sub(r"(</robot>)", r"<link name='&a11;'/>\1", text)
    aliases = "".join(f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]\n" for n in range(1, 12))
    return f"a0: &a0 [lol]\n{aliases}" + text


def circular(random: Random, text: str) -> str:
    """Return a structure that contains itself."""
    macro = "<xacro:macro name='m'><xacro:m/></xacro:macro><xacro:m/>"
    loops = [
        "<xacro:include filename='main.urdf.xacro'/>",
        "<xacro:include filename='structure.xacro'/>",
        "<xacro:include filename='.'/>",
        "<xacro:include filename='*'/>",
        "<xacro:property name='p' value='${q}'/><xacro:property name='q' value='${p}'/><link name='${q}'/>",
        "<link name='${(lambda f: f(f))(lambda f: f(f))}'/>",
        macro,
    ]
    if "</robot>" in text:
        return text.replace("</robot>", random.choice(loops) + "</robot>")
    return random.choice([text + "loop: &loop {a: *loop}\n", text + "<<: &loop {<<: *loop}\n"])


TEXT_FAULTS: dict[str, Fault] = {
    "number": replaced(NUMBER, lambda random, _: random.choice(NUMBERS)),
    "numbers exchanged": exchanged(NUMBER, copy=False),
    "tag gone": replaced(TAG, lambda *_: ""),
    "tag twice": replaced(TAG, lambda _, old: old + old),
    "other name": replaced(NAME, lambda random, _: random.choice(NAMES)),
    "names exchanged": exchanged(NAME, copy=False),
    "name twice": exchanged(NAME, copy=True),
    "reference": replaced(REFERENCE, lambda random, _: random.choice(NAMES)),
    "reference misspelt": replaced(REFERENCE, misspelt),
    "key misspelt": replaced(KEY, misspelt),
    "key exchanged": exchanged(KEY, copy=True),
    "expression": replaced(EXPRESSION, lambda random, _: random.choice(EXPRESSIONS)),
    "cut off": cut_off,
    "line gone": without_line,
    "line twice": twice_a_line,
    "character": with_character,
    "nested": nested,
    "multiplied": multiplied,
    "circular": circular,
}


def rewritten(random: Random, path: Path) -> None:
    """Other bytes in a file: an encoding, bits, or garbage."""
    old = path.read_bytes()
    kind = random.choice(["empty", "space", "garbage", "bits", "utf-16", "utf-16 named", "latin-1", "named", "mark"])
    if kind == "empty":
        new = b""
    elif kind == "space":
        new = b" \n\n"
    elif kind == "garbage":
        new = random.randbytes(random.choice([1, 100, 5000]))
    elif kind == "bits" or path.suffix == ".bin":
        data = bytearray(old)
        for _ in range(random.choice([1, 10])):
            data[random.randrange(len(data))] ^= 1 << random.randrange(8)
        new = bytes(data)
    else:
        text = old.decode()
        declared = re.sub(r"^<\?xml[^>]*\?>", '<?xml version="1.0" encoding="{}"?>', text)
        new = {
            "utf-16": text.encode("utf-16"),
            "utf-16 named": declared.replace("{}", "utf-16", 1).encode("utf-16"),
            "latin-1": text.replace("e", "é", 3).encode("latin-1", errors="replace"),
            "named": declared.replace("{}", random.choice(["latin-1", "utf-16", "cp1252", "klingon", ""]), 1).encode(),
            "mark": text.encode("utf-8-sig"),
        }[kind]
    path.write_bytes(new)


def misplaced(random: Random, path: Path) -> None:
    """Another object in place of a file."""
    path.unlink()
    kind = random.choice(["gone", "loop", "long loop", "folder", "pipe", "zero", "parent"])
    if kind == "loop":
        path.symlink_to(path.name)
    elif kind == "long loop":
        path.symlink_to(f"{path.name}.b")
        path.with_name(f"{path.name}.b").symlink_to(path.name)
    elif kind == "folder":
        path.mkdir()
    elif kind == "pipe":
        os.mkfifo(path)
    elif kind == "zero":
        path.symlink_to("/dev/zero")
    elif kind == "parent":
        path.symlink_to("..")


def corrupt(random: Random, folder: Path) -> str:
    """Put one fault into a vehicle folder; what and where."""
    paths = sorted(path for path in folder.rglob("*") if path.suffix in {".xacro", ".yaml"})
    if random.random() < 0.15:
        paths = sorted(path for path in folder.glob("meshes/*") if path.suffix in {".gltf", ".bin"}) or paths
    path = random.choice(paths)
    what = random.choice([*TEXT_FAULTS, "bytes", "misplaced", "misplaced"])
    if what == "misplaced":
        misplaced(random, path)
    elif what == "bytes" or path.suffix == ".bin":
        rewritten(random, path)
    else:
        text = path.read_text(encoding="utf-8")
        path.write_text(TEXT_FAULTS[what](random, text), encoding="utf-8")
    return f"{path.relative_to(folder)}: {what}"


def collect(scratch: Path) -> list[Path]:
    """Return the folders to break: the reference vehicles, a new one, and an imported one."""
    from mirdrake.importing.vehicles import import_vehicle
    from mirdrake.vehicles.scaffold import new_vehicle
    from tests.trap_packages import golf_cart

    models = data_root() / "models"
    folders = [models / name for name in ("bolt", "catvehicle", "mkz", "unior")]
    folders.append(
        new_vehicle("scaffold", wheelbase=2.6, track=1.5, mass=1400, wheel_radius=0.3, folder=scratch / "new")
    )
    folders.append(import_vehicle(golf_cart(scratch / "source"), folder=scratch / "imported").folder)
    return folders


def try_case(seed: int, folders: list[Path], worker: Worker, scratch: Path) -> tuple[str, str]:
    """Damage a copy of a vehicle; return the damage and the fault of the result."""
    random = Random(seed)
    source = folders[seed % len(folders)]
    folder = scratch / str(seed) / source.name
    shutil.copytree(source, folder)
    what = corrupt(random, folder)
    variants = sorted(path.stem for path in source.glob("variants/*.yaml"))
    variant = random.choice(["", *(f"@{name}" for name in variants)])
    if "variants/" in what:
        variant = f"@{Path(what.partition(':')[0]).stem}"
    result = worker.try_out(f"{folder}{variant}")
    shutil.rmtree(folder.parent)
    return f"seed {seed}: {source.name}{variant}: {what}", complaint(result, folder)


# --- tests -----------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    return collect(tmp_path_factory.mktemp("whole"))


@pytest.mark.parametrize("part", range(10))
def test_a_broken_vehicle_folder_works_or_gives_a_one_line_error(part, folders, worker, tmp_path):
    cases = [try_case(seed, folders, worker, tmp_path) for seed in range(part, CASES, 10)]
    assert [case for case in cases if case[1]] == []


@pytest.mark.parametrize("name", [*FILES, "meshes/body.gltf", "meshes/body.bin"])
@pytest.mark.parametrize("fault", ["gone", "empty", "folder", "bytes"])
def test_a_missing_or_unreadable_file_is_named(name, fault, worker, tmp_path):
    folder = tmp_path / "bolt"
    shutil.copytree(BOLT, folder)
    path = folder / name
    path.unlink()
    if fault == "folder":
        path.mkdir()
    elif fault != "gone":
        path.write_bytes(b"" if fault == "empty" else bytes(range(256)))
    result = worker.try_out(str(folder))
    if result != "drives":  # an empty sensors.yaml is valid
        assert result.startswith("error: "), result
        assert Path(name).name in result or fault == "gone", result


def main(first: int, last: int) -> None:
    """Try many cases, and print those that fail."""
    worker, counter = Worker(), Counter[str]()
    with tempfile.TemporaryDirectory() as scratch:
        folders = collect(Path(scratch))
        for seed in range(first, last):
            what, wrong = try_case(seed, folders, worker, Path(scratch))
            counter["bad" if wrong else "good"] += 1
            if wrong:
                sys.stdout.write(f"{what}\n    {wrong[-700:]}\n")
                sys.stdout.flush()
    worker.close()
    sys.stdout.write(f"{dict(counter)}\n")


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))
