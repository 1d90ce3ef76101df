"""Mutate valid files of every format and run the commands that read them; count unexpected outcomes.

    python -m tests.fuzz_files --cases 10000 --seed 0            all formats, one process at low priority
    python -m tests.fuzz_files --cases 200 --format run_folder   one of them

A case is given by format, seed and number alone. It ends well if the command ends within the time limit with exit code
0, 1 or 2, every line of its error output can be printed, an exit code of 2 comes with lines that begin with
``error: ``, and no file appears outside its folder. Everything else is a fault and printed with the case's number.
With ``--journal FILE`` every case is noted in that file, and cases noted there are not run again.
"""

import argparse
import contextlib
import io
import json
import multiprocessing
import os
import random
import re
import select
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable, Mapping
from multiprocessing.connection import Connection
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import yaml

from mirdrake.cli import main
from mirdrake.core.paths import data_root
from mirdrake.world_checks import first_steps

TIME_LIMIT = 30.0  # [s] of processor time, which does not depend on the load of the machine
WALL_LIMIT = 20.0 * TIME_LIMIT  # [s] of a case that uses no processor time
LONGEST = 1100  # characters of a line

Builder = Callable[[Path], None]


class Format(NamedTuple):
    """Files of one format.

    Attributes:
        build: writes valid files into an empty folder.
        targets: patterns of the files that are mutated.
        commands: command lines that read them, relative to that folder.
    """

    build: Builder
    targets: tuple[str, ...]
    commands: tuple[tuple[str, ...], ...]


# --- valid files -----------------------------------------------------------------------------------------------------

DIAGRAM = """\
world: skidpad
vehicles:
  ego: {model: unior, start: {x: 9.125, y: 0, yaw: 90 deg}, control: {steering: {stiffness: 3000}}, mounts: {}}
control:
  ego: {kind: path_tracking, track: left, speed: 2 m/s}
systems:
  wave: {kind: sine, amplitude: 1, frequency: 0.5}
  filter: {kind: gain, gain: 2}
connect: [[wave.y0, filter.u]]
plant: {contact: point, time_step: 0.005}
record: {meshcat: false, report: false, rate: 50}
duration: 0.05
seed: 3
"""

WORLD = """\
mirdrake: world/1
name: small
seed: 2
params: {mu: 0.8, n: 3}
ground: {surface: grass, mu: $mu}
tracks:
  main: {csv: line.csv, closed: true, width: 6}
  road: {xodr: road.xodr}
  way: {points: [[0, 40], [20, 42], [40, 40], [60, 40]], width: 4, markings: [{line: center, kind: dashed}]}
props:
  - {prop: cone, name: row, line: {from: [60, 60], to: [70, 60], count: $n}}
  - {prop: barrel, scatter: {region: {rect: {center: [80, 80], size: [9, 9]}}, count: 1 .. 3}}
  - {prop: crate, at: [70, 70], yaw: 0 .. 90 deg}
start:
  here: {on_track: {track: main, s: 1}}
goals: {there: {at: [5, 5], radius: 2}}
rules: [{min_gap: 0.2}]
tests:
  - name: one
    start: here
    behaviour: {kind: constant, speed: 2, steering: 0.1}
    duration: 1 s
    variations: {seed: 2}
    expect:
      - never collision
      - after 0.5 s always speed > 0.1 m/s and yaw_rate < 2 rad/s
      - always lateral_error < 5 m or clearance > 0.2 m
"""

PROP = """\
mirdrake: prop/1
name: crate
visual: crate.gltf
solids: [{box: {size: [1, 1, 1]}, at: [0, 0, 0.5]}]
mass: 20
"""

ROAD = """\
<?xml version="1.0"?>
<OpenDRIVE><header revMajor="1" revMinor="4"/>
<road name="r" id="1" length="60" junction="-1"><planView>
<geometry s="0" x="0" y="0" hdg="0" length="30"><line/></geometry>
<geometry s="30" x="30" y="0" hdg="0" length="30"><arc curvature="0.01"/></geometry>
</planView><lanes><laneOffset s="0" a="0" b="0" c="0" d="0"/><laneSection s="0">
<left><lane id="1" type="driving"><width sOffset="0" a="3" b="0" c="0" d="0"/></lane></left>
<center><lane id="0" type="none"/></center>
<right><lane id="-1" type="driving"><width sOffset="0" a="3" b="0" c="0" d="0"/></lane></right>
</laneSection></lanes></road></OpenDRIVE>
"""

DATA = """\
mirdrake: data/1
time: {column: t, unit: s}
channels:
  vx: {column: v, unit: km/h}
  yaw_rate: {column: gyro, unit: deg/s}
logs: [{file: lap.csv, name: lap}]
"""

MAP = ("--map", "vx=v:km/h", "--map", "yaw_rate=gyro:deg/s", "--time", "t:s")


def log_frame() -> pd.DataFrame:
    """Return a short synthetic log."""
    t = np.arange(0.0, 6.0, 0.02)
    return pd.DataFrame({"t": t, "v": 30.0 + np.sin(t), "gyro": 10.0 * np.sin(2.0 * t), "steering": 0.1 * np.sin(t)})


def _yaml_file(name: str, source: str) -> Builder:
    def build(folder: Path) -> None:
        shutil.copy(data_root() / source, folder / name)
        if "identify" in source:
            shutil.copytree(data_root() / "studies/data", folder / "data")

    return build


def _diagram(folder: Path) -> None:
    (folder / "drive.yaml").write_text(DIAGRAM, encoding="utf-8")


def _commands(folder: Path) -> None:
    text = DIAGRAM.replace("kind: path_tracking, track: left, speed: 2 m/s", "kind: schedule, file: commands.csv")
    (folder / "drive.yaml").write_text(text, encoding="utf-8")
    rows = "".join(f"{0.1 * i:g},{i % 7},{i % 5 - 2}\n" for i in range(30))
    (folder / "commands.csv").write_text(f"time [s],speed [km/h],steering [deg]\n{rows}", encoding="utf-8")


def _vehicle(folder: Path) -> None:
    shutil.copytree(data_root() / "models/unior", folder / "models/car", ignore=shutil.ignore_patterns("*.py"))
    main_file = folder / "models/car/main.urdf.xacro"
    main_file.write_text(main_file.read_text(encoding="utf-8").replace('robot name="unior"', 'robot name="car"'))


def _tyres(folder: Path) -> None:
    shutil.copytree(data_root() / "models/bolt", folder / "models/car", ignore=shutil.ignore_patterns("*.py"))
    shutil.copy(data_root() / "models/tyres/215_50R17.tir", folder / "models/car/own.tir")
    variant = folder / "models/car/variants/handling.yaml"
    variant.write_text(variant.read_text(encoding="utf-8").replace("215_50R17.tir", "own.tir"), encoding="utf-8")
    text = "world: empty\nvehicles: {ego: {model: car@handling}}\ncontrol: {ego: {kind: constant, speed: 2}}\n"
    (folder / "drive.yaml").write_text(text, encoding="utf-8")  # `inspect` does not read tyres


def _world(folder: Path) -> None:
    (folder / "small.yaml").write_text(WORLD.replace("prop: crate", "prop: ./crate"), encoding="utf-8")
    shutil.copytree(data_root() / "models/props/cone", folder / "crate", ignore=shutil.ignore_patterns("*.py"))
    (folder / "road.xodr").write_text(ROAD, encoding="utf-8")
    angles = np.linspace(0.0, 2.0 * np.pi, 40, endpoint=False)
    lines = "".join(f"{20 * np.cos(a):.3f},{15 * np.sin(a):.3f},3,3\n" for a in angles)
    (folder / "line.csv").write_text(f"# x_m,y_m,w_tr_right_m,w_tr_left_m\n{lines}", encoding="utf-8")


def _log(suffix: str) -> Builder:
    def build(folder: Path) -> None:
        frame = log_frame()
        (folder / "drives.yaml").write_text(DATA.replace("lap.csv", f"lap{suffix}"), encoding="utf-8")
        if suffix == ".parquet":
            frame.to_parquet(folder / "lap.parquet")
        elif suffix == ".mat":
            from scipy.io import savemat

            savemat(folder / "lap.mat", {name: frame[name].to_numpy() for name in frame})
        elif suffix == ".mcap":
            _write_mcap(folder / "lap.mcap", frame)
        else:
            frame.to_csv(folder / f"lap{suffix}", index=False)

    return build


def _write_mcap(path: Path, frame: pd.DataFrame) -> None:
    from mcap.writer import Writer

    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema(name="state", encoding="jsonschema", data=b'{"type": "object"}')
        channel = writer.register_channel(topic="/car", message_encoding="json", schema_id=schema)
        for row in frame.to_dict("records"):
            stamp = int(1e9 * row["t"])
            writer.add_message(channel, log_time=stamp, data=json.dumps(row).encode(), publish_time=stamp)
        writer.finish()


def _bag(folder: Path) -> None:
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    kind = store.types["std_msgs/msg/Float64"]
    with Writer(folder / "lap", version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        link = writer.add_connection("/v", kind.__msgtype__, typestore=store)
        for row in log_frame().to_dict("records"):
            message = kind(data=row["v"])
            writer.write(link, int(1e9 * row["t"]), store.serialize_cdr(message, kind.__msgtype__))


def _package(folder: Path) -> None:
    from tests import trap_packages

    trap_packages.city_car(folder / "one")
    trap_packages.golf_cart(folder / "two")
    trap_packages.sdf_cart(folder / "three")


def _gazebo(folder: Path) -> None:
    from tests import trap_worlds

    trap_worlds.rich(folder)


def _meshes(folder: Path) -> None:
    import trimesh

    from tests.mesh_rigs import box, write_stl

    shape = trimesh.creation.box((1, 1, 1))
    for kind in ("stl", "obj", "glb", "dae"):
        try:
            shape.export(folder / f"body.{kind}")
        except ValueError:
            write_stl(folder / f"body.{kind}", box((0, 0, 0), (1, 1, 1)))
    model = (
        "<model name='m{0}'><pose>{1} 0 0 0 0 0</pose><static>true</static><link name='l'>"
        "<visual name='v'><geometry><mesh><uri>body.{0}</uri></mesh></geometry></visual>"
        "<collision name='c'><geometry><mesh><uri>body.{0}</uri></mesh></geometry></collision></link></model>"
    )
    for index, kind in enumerate(("stl", "obj", "glb", "dae")):
        text = f"<sdf version='1.6'><world name='w'>{model.format(kind, 4 * index)}</world></sdf>"
        (folder / f"{kind}.sdf").write_text(text, encoding="utf-8")


RUN_SETTINGS = (
    "--set", "duration=0.5", "--set", "sensors={ego: [front_camera, front_lidar, imu]}", "--set", "record.report=false",
    "--set", "record.cameras=true", "--set", "record.arrays=true", "--set", "plant.contact=point",
    "--set", "vehicles.ego.mounts={front_camera: {width: 64, height: 48, rate: 25}}",
)  # fmt: skip


def _run_folder(folder: Path) -> None:
    data = "mirdrake: data/1\nchannels: {vx: {column: ego.vx, unit: m/s}}\nlogs: [{file: run}]\n"
    (folder / "drives.yaml").write_text(data, encoding="utf-8")
    text = DIAGRAM.replace("kind: path_tracking, track: left, speed: 2 m/s", "kind: schedule, file: run")
    (folder / "replayed.yaml").write_text(text, encoding="utf-8")
    main(["run", "bolt_test_track", "--out", str(folder / "run"), "--quiet", *RUN_SETTINGS])


def _tuning_result(folder: Path) -> None:
    from tests.tuning_sample import write_sample

    write_sample(folder / "result")


RUN_COMMANDS = (
    ("export", "run", "--to", "csv"),
    ("export", "run", "--to", "mcap"),
    ("export", "run", "--to", "video"),
    ("replay", "run", "--out", "replay.html"),
    ("view", "run", "--out", "view.html"),
    ("check", "run"),
    ("draw", "run/spec.yaml", "--out", "run.svg"),
    ("identify", "check", "drives.yaml"),
    ("run", "replayed.yaml", "--set", "duration=0.02"),
)

IDENTIFY_BAG = ("identify", "check", "lap", "--map", "vx=/v:data:m/s")

FORMATS: dict[str, Format] = {
    "diagram": Format(
        _diagram,
        ("drive.yaml",),
        (
            ("check", "drive.yaml"),
            ("draw", "drive.yaml", "--out", "drive.svg"),
            ("run", "drive.yaml", "--set", "duration=0.02", "--set", "record={meshcat: false, report: false}"),
        ),
    ),
    "commands": Format(_commands, ("commands.csv",), (("check", "drive.yaml"),)),
    "vehicle": Format(
        _vehicle,
        ("models/car/*.yaml", "models/car/variants/*.yaml"),
        (("inspect", "car"), ("inspect", "car@published"), ("validate", "car", "--list")),
    ),
    "xacro": Format(_vehicle, ("models/car/*.xacro",), (("inspect", "car"), ("inspect", "car@published"))),
    "gltf": Format(_vehicle, ("models/car/meshes/*.gltf", "models/car/meshes/*.bin"), (("inspect", "car"),)),
    "tir": Format(_tyres, ("models/car/*.tir",), (("check", "drive.yaml"),)),
    "presets": Format(
        _yaml_file("presets.yaml", "models/sensors/presets.yaml"), ("*.yaml",), (("check", "presets.yaml"),)
    ),
    "prop": Format(_world, ("crate/prop.yaml",), (("check", "crate/prop.yaml"), ("check", "small.yaml"))),
    "world": Format(
        _world, ("small.yaml",), (("check", "small.yaml"), ("world", "build", "small.yaml", "--out", "built"))
    ),
    "track_csv": Format(_world, ("line.csv",), (("check", "small.yaml"),)),
    "opendrive": Format(_world, ("road.xodr",), (("check", "small.yaml"),)),
    "tuning": Format(_yaml_file("study.yaml", "studies/bolt_speed.yaml"), ("*.yaml",), (("check", "study.yaml"),)),
    "identification": Format(
        _yaml_file("study.yaml", "studies/identify_bmw_m8.yaml"),
        ("*.yaml",),
        (("check", "study.yaml"), ("identify", "check", "study.yaml")),
    ),
    "data": Format(_log(".csv"), ("drives.yaml",), (("check", "drives.yaml"), ("identify", "check", "drives.yaml"))),
    "log_csv": Format(_log(".csv"), ("lap.csv",), (("identify", "check", "lap.csv", *MAP),)),
    "log_parquet": Format(_log(".parquet"), ("lap.parquet",), (("identify", "check", "lap.parquet", *MAP),)),
    "log_mat": Format(_log(".mat"), ("lap.mat",), (("identify", "check", "lap.mat", *MAP),)),
    "log_mcap": Format(_log(".mcap"), ("lap.mcap",), (("identify", "check", "lap.mcap", "--map", "vx=/car:v:km/h"),)),
    "log_bag": Format(_bag, ("lap/*",), (IDENTIFY_BAG,)),
    "package": Format(
        _package,
        ("**/*.urdf", "**/*.xacro", "**/*.sdf"),
        tuple(("import", "vehicle", source, "--dry-run", "--name", "fuzzed") for source in ("{urdf}", "{sdf}")),
    ),
    "gazebo_world": Format(_gazebo, ("**/*.world", "**/*.sdf"), (("world", "import", "{world}"),)),
    "meshes": Format(
        _meshes,
        ("body.stl", "body.obj", "body.glb", "body.dae"),
        (("world", "import", "{mesh}.sdf"),),
    ),
    "run_folder": Format(_run_folder, ("run/*", "run/*/*"), RUN_COMMANDS),
    "tuning_result": Format(
        _tuning_result,
        ("result/*.json", "result/*.jsonl", "result/*.yaml"),
        (("tune", "apply", "result", "--dry-run"),),
    ),
}
"""Formats by name."""


# --- mutations -------------------------------------------------------------------------------------------------------

NUMBERS = (
    "0",
    "-1",
    "-0",
    "1e308",
    "1e400",
    "9" * 400,
    "nan",
    ".nan",
    "inf",
    "-.inf",
    "1e-320",
    "1e9",
    "99999999",
    "-3e7",
)
WORDS = (
    "null", "true", "''", "[]", "{}", "[[1, [2]], {a: b}]", "2026-05-31", "!!binary aGk=", "*x", "&x [*x]", "{<<: 3}",
    "'../../x'", "'\\0'", '"\\ud800"', "ünï\u202ecode", "x" * 3000, "'a\\nb'", "0x1F", "1_000", "~", "'$mu'", "'1/0'",
    "5 furlongs", "'@bolt'", "/dev/zero", "/", "'%s{}'", "$(env HOME)", "${9**9**9}", "<a>", "&amp;", '"', "'",
)  # fmt: skip
WHOLE = (
    b"", b"\0", b"[]", b"3", b"null", b"mirdrake: [1]", b"mirdrake: {a: 1}", b"\xff\xfe\0x", b"- a\n- b\n", b"{",
    b"<a/>", b"\x1f\x8b\x08\0\0", b"PK\x03\x04", b"9" * 5000, b"[" * 5000, b"a: &a [*a]\n", b"\xef\xbb\xbf",
    b"--- 1\n--- 2\n",
)  # fmt: skip


def mutate(path: Path, chance: random.Random) -> str:
    """Change a file; returns what was done."""
    content = path.read_bytes()
    kind = chance.choice(
        ("flip", "cut", "whole", "file", "lines", "number", "word", "node", "node", "keys", "deep", "encoding")
    )
    if kind == "file":
        return _replace_file(path, chance)
    if kind == "node" and path.suffix in {".yaml", ".json"}:
        changed = _change_node(content, path.suffix, chance)
        kind, content = ("node", changed) if changed is not None else ("cut", content[: len(content) // 2])
    elif kind == "flip":
        damaged = bytearray(content)
        for _ in range(chance.choice((1, 3, 20)) if damaged else 0):
            damaged[chance.randrange(len(damaged))] ^= 1 << chance.randrange(8)
        content = bytes(damaged)
    elif kind == "cut":
        a, b = sorted(chance.randrange(len(content) + 1) for _ in range(2))
        content = content[:a] if chance.random() < 0.5 else content[:a] + content[b:]
    elif kind == "whole":
        content = chance.choice(WHOLE)
    elif kind == "encoding":
        text = content.decode("utf-8", errors="replace")
        content = text.encode(chance.choice(("utf-16", "utf-8-sig", "utf-32")), errors="replace")
        if chance.random() < 0.3:
            content = text.replace("\n", "\r").encode(errors="replace")
    elif kind in {"keys", "deep"} and path.suffix in {".yaml", ".json", ".xacro", ".urdf", ".sdf", ".world", ".xodr"}:
        content = _grow(content, path.suffix, kind, chance)
    else:
        content = _change_text(content, kind, chance)
    path.write_bytes(content)
    return kind


def _replace_file(path: Path, chance: random.Random) -> str:
    path.unlink()
    kind = chance.choice(("missing", "folder", "loop", "link", "device"))
    if kind == "folder":
        path.mkdir()
    elif kind == "loop":
        path.symlink_to(path)
    elif kind == "link":
        path.symlink_to("/etc/hostname")
    elif kind == "device":
        path.symlink_to("/dev/null")
    return kind


def _change_text(content: bytes, kind: str, chance: random.Random) -> bytes:
    """Change lines, numbers or words of a text, or bytes of anything else."""
    text = content.decode("latin-1")
    if kind == "lines":
        lines = text.splitlines(keepends=True) or [""]
        a, b = chance.randrange(len(lines)), chance.randrange(len(lines))
        how = chance.randrange(4)
        if how == 0:
            del lines[a]
        elif how == 1:
            lines.insert(b, lines[a])
        elif how == 2:
            lines[a], lines[b] = lines[b], lines[a]
        else:
            lines[a:a] = [lines[a]] * chance.choice((5, 2000))
        return "".join(lines).encode("latin-1")
    pattern = r"-?\d+(\.\d+)?([eE][-+]?\d+)?" if kind == "number" else r"[A-Za-z_]{2,}|\"[^\"\n]*\""
    matches = list(re.finditer(pattern, text))
    if not matches:
        return content + b"\0"
    match = chance.choice(matches)
    new = chance.choice(NUMBERS if kind == "number" else WORDS)
    return content[: match.start()] + new.encode("utf-8", errors="replace") + content[match.end() :]


def _places(node: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Return every path below the root of a tree."""
    items = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
    return [below for key, value in items for below in ((*path, key), *_places(value, (*path, key)))]


VALUES: tuple[Any, ...] = (
    None, True, -1, 0, 1e308, float("nan"), float("-inf"), 10**30, "", "x", "nan", [], {}, [[]], {"kind": "x"},
    ["a", 1], {"a": {"b": [1]}}, "a\nb", "../../x", "/etc/passwd", "x" * 5000, 2**63, "9" * 400, "..", "\u202e",
    3.5, [1e308] * 3, -1e-300,
)  # fmt: skip


def _change_node(content: bytes, suffix: str, chance: random.Random) -> bytes | None:
    """Replace, remove, rename or copy values of a YAML or JSON tree; None without a tree."""
    try:
        tree = json.loads(content) if suffix == ".json" else yaml.safe_load(content)
    except (ValueError, yaml.YAMLError):
        return None
    for _ in range(chance.choice((1, 1, 2, 5))):
        places = _places(tree)
        if not places:
            return None
        path = chance.choice(places)
        parent = tree
        for key in path[:-1]:
            parent = parent[key]
        how = chance.randrange(5)
        if how == 0:
            del parent[path[-1]]
        elif how == 1 and isinstance(parent, dict):
            parent[chance.choice(("x", "", "a.b", "ünï", "kind", "9", f"{path[-1]}x"))] = parent.pop(path[-1])
        elif how == 2 and isinstance(parent, list):
            parent.extend([parent[path[-1]]] * chance.choice((1, 300)))
        else:
            parent[path[-1]] = chance.choice(VALUES)
    text = json.dumps(tree) if suffix == ".json" else yaml.safe_dump(tree, sort_keys=False, allow_unicode=True)
    return text.encode("utf-8", errors="surrogatepass")


def _grow(content: bytes, suffix: str, kind: str, chance: random.Random) -> bytes:
    """Add thousands of unknown keys, or a deep nest, at the top or somewhere within."""
    count = chance.choice((30, 3000))
    if suffix in {".yaml", ".json"}:
        if kind == "keys":
            return content + b"\n" + b"".join(b"unknown%d: 1\n" % i for i in range(count))
        return content + b"\nnest: " + b"[" * count + b"]" * count + b"\n"
    more = (
        b"".join(b"<odd%d a='1'/>" % i for i in range(count))
        if kind == "keys"
        else b"<odd>" * count + b"</odd>" * count
    )
    closings = [match.start() for match in re.finditer(rb"</", content)]
    index = chance.choice(closings) if closings else len(content)
    return content[:index] + more + content[index:]


# --- one case --------------------------------------------------------------------------------------------------------


_built: dict[str, dict[str, bytes]] = {}


def build(name: str, folder: Path) -> None:
    """Write the valid files of a format into an empty folder; made once in a process."""
    if name not in _built:
        with tempfile.TemporaryDirectory() as temporary, contextlib.redirect_stdout(io.StringIO()):
            FORMATS[name].build(Path(temporary))
            files = [path for path in Path(temporary).rglob("*") if path.is_file()]
            _built[name] = {str(path.relative_to(temporary)): path.read_bytes() for path in files}
    for file, content in _built[name].items():
        (folder / file).parent.mkdir(parents=True, exist_ok=True)
        (folder / file).write_bytes(content)


def run_case(name: str, seed: int, number: int, folder: Path) -> tuple[str, str]:
    """Build, mutate and read the files of one case.

    Args:
        name: of the format.
        seed: of the whole run.
        number: of the case.
        folder: an empty one.

    Returns:
        "fine", "rejected" or the kind of the fault, and a text about it.
    """
    form, chance = FORMATS[name], random.Random(f"{name} {seed} {number}")
    work = folder / "a" / "work"
    work.mkdir(parents=True)
    build(name, work)
    (folder / "a" / "beside").write_text("x", encoding="utf-8")
    targets = sorted({path for pattern in form.targets for path in work.glob(pattern) if path.is_file()})
    command = _filled(chance.choice(form.commands), work, chance)
    target = chance.choice(targets)
    if name == "meshes":
        command = tuple(word.replace("{mesh}", target.suffix[1:]) for word in command)
    what = mutate(target, chance)
    outcome, text = run_command(command, work)
    strange = sorted({*os.listdir(folder), *os.listdir(folder / "a")} - {"a", "work", "beside"})
    if strange:
        outcome, text = "outside", f"wrote {strange}"
    return outcome, f"{name} #{number} {target.relative_to(work)} {what}: mirdrake {' '.join(command)}: {text}"


def _filled(command: tuple[str, ...], work: Path, chance: random.Random) -> tuple[str, ...]:
    """Return a command line with its placeholder replaced by a file."""

    def find(kind: str) -> str:
        files = [path for path in work.rglob("*") if path.name.endswith((f".{kind}", f".{kind}.xacro"))]
        return str(chance.choice(sorted(files)).relative_to(work))

    return tuple(find(word[1:-1]) if word in {"{urdf}", "{sdf}", "{world}"} else word for word in command)


def run_command(command: tuple[str, ...], work: Path) -> tuple[str, str]:
    """Run a command line in a folder; return how it ended and a text about it."""
    before, out, err = Path.cwd(), io.StringIO(), io.StringIO()
    began = time.monotonic()
    os.chdir(work)
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            code = main(command)
    except SystemExit as stop:
        return "exception", f"SystemExit {stop.code} {err.getvalue()[-300:]}"
    except BaseException as error:
        places = [
            f"{Path(frame.filename).name}:{frame.lineno}" for frame in traceback.extract_tb(error.__traceback__)[-4:]
        ]
        return "exception", f"{type(error).__name__}: {str(error)[:200]!r} at {' '.join(places)}"
    finally:
        os.chdir(before)
    lines = err.getvalue().splitlines()
    errors = [line for line in lines if line.startswith("error: ")]
    if any(len(line) > LONGEST or not line.isprintable() for line in lines):
        return "message", f"not printable or too long: {err.getvalue()[:300]!r}"
    if any("Traceback" in line for line in lines):
        return "message", f"traceback: {err.getvalue()[-300:]!r}"
    if code not in {0, 1, 2} or (code == 2 and not errors):
        return "message", f"exit code {code}, error output {err.getvalue()[:300]!r}"
    fragments = [line for line in errors if ": " not in line.removeprefix("error: ")]
    if len(errors) > 1 and fragments:
        return "message", f"continued over several lines: {fragments[0]!r}"
    return ("fine" if code != 2 else "rejected"), f"{time.monotonic() - began:.1f} s {errors[:1]}"


# --- many cases ------------------------------------------------------------------------------------------------------


def _work(pipe: Connection, seed: int) -> None:
    """Run the cases that arrive until there are no more; discard the output of compiled code."""
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 1)
    os.dup2(null, 2)
    vars(first_steps)["subprocess"] = SimpleNamespace(run=run_forked, TimeoutExpired=subprocess.TimeoutExpired)
    while True:
        job = pipe.recv()
        if job is None:
            return
        name, number, folder = job
        pipe.send(run_case(name, seed, number, Path(folder)))


def run_forked(command: list[str], *, timeout: float, **_: Any) -> subprocess.CompletedProcess[bytes]:
    """Run the first steps of a world in a copy of this process, which has imported everything they need.

    Raises:
        subprocess.TimeoutExpired: they did not end.
    """
    read, write = os.pipe()
    child = os.fork()
    if child == 0:
        os.dup2(write, 1)
        sys.argv, sys.stdout = ["first_steps", command[-1]], os.fdopen(1, "w", encoding="utf-8")
        with contextlib.suppress(BaseException):
            first_steps.main()
            sys.stdout.flush()
            os._exit(0)
        os._exit(1)
    os.close(write)
    with os.fdopen(read, "rb") as pipe:
        if not select.select([pipe], [], [], timeout)[0]:
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
            raise subprocess.TimeoutExpired(command, timeout)
        out = pipe.read()
    return subprocess.CompletedProcess(command, os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), out, b"")


def processor_time(process: int) -> float:
    """Return the processor time of a process so far [s]; its clock as clock_getcpuclockid(3) makes it."""
    return time.clock_gettime((~process << 3) | 2)


class Worker:
    """A process for cases that is replaced when it crashes or exceeds the time limit."""

    def __init__(self, seed: int) -> None:
        self._seed = seed
        self._process: Any = None
        self._cases = 0

    def run(self, name: str, number: int) -> tuple[str, str, float]:
        """Run a case; returns outcome, text and time [s]."""
        if self._process is None or self._cases >= 2500:  # imports and valid files cost 20 s
            self.close()
            context = multiprocessing.get_context("spawn")
            self._pipe, other = context.Pipe()
            self._process = context.Process(target=_work, args=(other, self._seed), daemon=False)
            self._process.start()
            self._cases = 0
        self._cases += 1
        first = self._cases == 1
        with tempfile.TemporaryDirectory(prefix="mirdrake-fuzz-", ignore_cleanup_errors=True) as folder:
            began = time.monotonic()
            self._pipe.send((name, number, folder))
            outcome, text = "time", f"{name} #{number}: not finished within {TIME_LIMIT:g} s"
            try:
                if self._wait(TIME_LIMIT + 30.0 * first):  # a new process imports first
                    outcome, text = self._pipe.recv()
            except EOFError:
                self._process.join()
                outcome, text = "crash", f"{name} #{number}: the process ended with {self._process.exitcode}"
            if outcome in {"time", "crash"}:
                self._process.kill()
                self._process.join()
                self._process = None
            return outcome, text, time.monotonic() - began

    def _wait(self, limit: float) -> bool:
        """Return whether the case ends before the process has used so much processor time [s]."""
        began, used = time.monotonic(), processor_time(self._process.pid)
        while time.monotonic() - began < WALL_LIMIT:
            if self._pipe.poll(1.0):
                return True
            if processor_time(self._process.pid) - used > limit:
                return False
        return False

    def close(self) -> None:
        """End the process."""
        if self._process is not None:
            self._pipe.send(None)
            self._process.join(10.0)
            self._process.kill()
            self._process = None


def fuzz(
    cases: int, seed: int, names: list[str], first: int = 0, journal: Path | None = None
) -> dict[str, Counter[str]]:
    """Run cases over formats in turn, print faults and return the counts of outcomes by format.

    Args:
        cases: number of cases.
        seed: of the whole run.
        names: of the formats.
        first: number of the first case.
        journal: file with a line for every case that has been run; those in it are only counted.
    """
    counts: dict[str, Counter[str]] = {name: Counter() for name in names}
    done: dict[tuple[str, int], str] = {}
    if journal is not None and journal.exists():
        rows = [line.split("\t") for line in journal.read_text(encoding="utf-8").splitlines()]
        done = {(name, int(number)): outcome for given, name, number, outcome, *_ in rows if int(given) == seed}
    worker = Worker(seed)
    for number in range(first, first + cases):
        name = names[number % len(names)]
        if (name, number) in done:
            counts[name][done[name, number]] += 1
            continue
        outcome, text, seconds = worker.run(name, number)
        counts[name][outcome] += 1
        if outcome not in {"fine", "rejected"}:
            sys.stdout.write(f"{outcome}: {text}\n")
            sys.stdout.flush()
        if journal is not None:
            with journal.open("a", encoding="utf-8") as file:
                file.write(f"{seed}\t{name}\t{number}\t{outcome}\t{seconds:.1f}\n")
    worker.close()
    return counts


def _print(counts: Mapping[str, Counter[str]]) -> None:
    outcomes = ("fine", "rejected", "exception", "message", "time", "crash", "outside")
    lines = [f"{'format':16}" + "".join(f"{outcome:>11}" for outcome in outcomes)]
    for name, counter in [*counts.items(), ("all", sum(counts.values(), Counter()))]:
        lines.append(f"{name:16}" + "".join(f"{counter[outcome]:11}" for outcome in outcomes))
    sys.stdout.write("\n".join(lines) + "\n")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    parser.add_argument("--format", action="append", choices=list(FORMATS), help="only this one; may be given again")
    parser.add_argument("--journal", type=Path, help="note the cases in this file, and leave out those in it")
    given = parser.parse_args()
    os.nice(10)
    table = fuzz(given.cases, given.seed, given.format or list(FORMATS), given.first, given.journal)
    _print(table)
    sys.exit(any(set(counter) - {"fine", "rejected"} for counter in table.values()))
