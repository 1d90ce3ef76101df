"""Vehicle files that somebody has broken: a working vehicle or a one-line error, never a crash, a hang or a traceback.

Every broken folder is loaded and driven for a moment in a process of its own, so that a crash of Drake would be seen.
"""

import multiprocessing
import re
import shutil
import traceback
from collections.abc import Iterator
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mirdrake.errors import MirdrakeError
from mirdrake.paths import data_root

BOLT = data_root() / "models" / "bolt"
FILES = sorted(path.name for path in BOLT.iterdir() if path.suffix in {".xacro", ".yaml"})
LIMIT = 30.0  # [s] to load, and to drive

NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:e-?\d+)?(?![\w.])")
TAG = re.compile(r"<(?!/|\?|!)[\w:]+[^<>]*?/>|<(?P<name>[\w:]+)(?:\s[^<>]*)?>.*?</(?P=name)>", re.DOTALL)
NAME = re.compile(r'(?<=")[a-z_]{4,}(?=")')
NUMBERS = ("nan", "inf", "-inf", "0", "-1", "1e308", "1e-300", "1e9", "-0.0", "", "1,5", "two", "0x10", "1e400", "${x}")


class Worker:
    """A process that tries vehicle folders one after the other; replaced when it dies."""

    def __init__(self) -> None:
        self.process: Any = None
        self.pipe: Connection | None = None

    def try_out(self, folder: Path) -> str:
        """What became of a folder: "drives", "error: ...", or how the process failed."""
        if self.process is None or not self.process.is_alive():
            context = multiprocessing.get_context("spawn")
            self.pipe, far = context.Pipe()
            self.process = context.Process(target=serve, args=(far,), daemon=True)
            self.process.start()
            far.close()
            assert self.pipe.poll(60.0), "the worker does not start"
            self.pipe.recv()
        assert self.pipe is not None
        self.pipe.send(str(folder))
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
    """Load and drive the folders that come in; answer each with one text."""
    from pydrake.systems.analysis import Simulator
    from pydrake.systems.framework import DiagramBuilder

    from mirdrake.plant import PlantSpec, make_plant, set_start
    from mirdrake.vehicles import load_vehicle
    from mirdrake.worlds import load_world

    world = load_world("empty")
    pipe.send("ready")
    while True:
        folder = pipe.recv()
        try:
            vehicle = load_vehicle(folder)
            builder = DiagramBuilder()
            parts = make_plant(builder, world, {"ego": vehicle}, spec=PlantSpec(contact="point"))
            plant, part = parts.plant, parts.vehicles["ego"]
            simulator = Simulator(builder.Build())
            context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
            set_start(plant, context, part, x=0.0, y=0.0, yaw=0.0)
            plant.get_actuation_input_port(part.instance).FixValue(context, [0.0] * 6)
            plant.get_desired_state_input_port(part.instance).FixValue(context, [0.0] * 12)
            simulator.AdvanceTo(0.05)
            answer = "drives"
        except MirdrakeError as error:
            answer = f"error: {error}"
        except BaseException:
            answer = f"raises {traceback.format_exc()}"
        pipe.send(answer)


@pytest.fixture(scope="module")
def worker() -> Iterator[Worker]:
    one = Worker()
    yield one
    one.close()


def corrupt(draw, text):
    """The text with one fault."""
    kind = draw(st.sampled_from(["number", "swap", "tag", "double", "name", "cut", "line", "character"]))
    pattern = {"tag": TAG, "double": TAG, "name": NAME}.get(kind, NUMBER)
    places = [match.span() for match in pattern.finditer(text)]
    if kind == "cut":
        return text[: draw(st.integers(0, len(text)))]
    if kind == "character":
        at = draw(st.integers(0, len(text) - 1))
        return (
            text[:at] + draw(st.sampled_from(["<", ">", '"', "&", ":", "\t", "\x00", "é", "{", "- ", "\n"])) + text[at:]
        )
    lines = text.splitlines(keepends=True)
    if kind == "line" or not places:
        at = draw(st.integers(0, len(lines) - 1))
        return "".join(lines[:at] + lines[at + 1 :])
    begin, end = draw(st.sampled_from(places))
    if kind == "number":
        return text[:begin] + draw(st.sampled_from(NUMBERS)) + text[end:]
    if kind == "swap":
        other = draw(st.sampled_from(places))
        (a, b), (c, d) = sorted([(begin, end), other])
        return text[:a] + text[c:d] + text[b:c] + text[a:b] + text[d:] if b <= c else text
    if kind == "name":
        return (
            text[:begin] + draw(st.sampled_from(["nothing", "base_link", "world", "", "front_left_wheel"])) + text[end:]
        )
    return text[:begin] + text[end:] if kind == "tag" else text[:end] + text[begin:end] + text[end:]


@settings(
    max_examples=200,
    deadline=None,
    derandomize=True,
    database=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
@given(data=st.data())
def test_a_broken_vehicle_folder_works_or_says_in_one_line_what_is_wrong(data, worker, tmp_path_factory):
    name = data.draw(st.sampled_from(FILES))
    text = corrupt(data.draw, (BOLT / name).read_text(encoding="utf-8"))
    folder = tmp_path_factory.mktemp("broken") / "bolt"
    shutil.copytree(BOLT, folder)
    (folder / name).write_text(text, encoding="utf-8")
    result = worker.try_out(folder)
    shutil.rmtree(folder.parent)
    if result != "drives":
        assert result.startswith("error: "), result
        for line in result.removeprefix("error: ").splitlines():  # a file with several faults gets a line for each
            assert re.search(r"(\.yaml|\.xacro|\.gltf|bolt)", line), f"no file named: {line}"
            assert len(line) < 600, line


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
    result = worker.try_out(folder)
    if result != "drives":  # an empty sensors.yaml is no fault
        assert result.startswith("error: "), result
        assert Path(name).name in result or fault == "gone", result
