"""Bad input: a one-line error with value, line, what is allowed and what to do; exit code 2; no partial files."""

import os
import re
import shutil
import stat
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from textwrap import dedent

import pytest

from mirdrake.cli import main
from mirdrake.core import paths

DRIVE = dedent(
    """\
    world: empty
    vehicles:
      ego: {model: bolt}
    control:
      ego: {kind: constant, speed: 2}
    plant: {contact: point}
    record: {meshcat: false, report: false}
    duration: 0.1
    """
)

BLOCKS = dedent(
    """\
    from pydrake.common.value import Value
    from pydrake.systems.framework import BasicVector, LeafSystem

    from mirdrake.core.signals import declare_vector_input, declare_vector_output, signals

    RATE = 3.0


    class Notch(LeafSystem):
        def __init__(self, frequency: float = 1.0):
            super().__init__()
            if frequency <= 0.0:
                raise ValueError(f"frequency {frequency} Hz is not positive")
            self._u = declare_vector_input(self, "u", signals(("angle", "rad")))
            declare_vector_output(self, "y", signals(("angle", "rad")), self._calc)

        def _calc(self, context, output):
            output.SetFromVector(self._u.Eval(context))


    class Message(LeafSystem):
        def __init__(self):
            super().__init__()
            self.DeclareAbstractOutputPort("message", lambda: Value("text"), lambda context, output: None)


    class Plain:
        pass
    """
)


@pytest.fixture
def command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[..., list[str]]:
    """A function (arguments) -> lines on stderr of a command that must exit with 2 and write nothing in its folder."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "blocks.py").write_text(BLOCKS, encoding="utf-8")
    monkeypatch.setattr(sys, "dont_write_bytecode", True)

    def call(*arguments: str) -> list[str]:
        before = sorted(tmp_path.rglob("*"))
        try:
            code = main(arguments)
        except SystemExit as stop:  # argparse
            code = int(stop.code or 0)
        out, err = capsys.readouterr()
        assert code == 2, f"exit code {code}: {out}{err}"
        assert sorted(tmp_path.rglob("*")) == before
        assert "Traceback" not in err
        return err.splitlines()

    return call


def error_of(lines: list[str]) -> str:
    """Return the text of the single line."""
    assert len(lines) == 1, lines
    assert lines[0].startswith("error: ")
    return lines[0].removeprefix("error: ")


# --- the diagram file ----------------------------------------------------------------------------------------------

FAULTS = {
    # what: (old text, new text, line, parts of the message)
    "unknown world": ("world: empty", "world: emty", 1, ["world", "'emty'", "did you mean 'empty'", "barrels"]),
    "unknown vehicle": ("model: bolt", "model: blot", 3, ["vehicles.ego.model", "'blot'", "did you mean 'bolt'"]),
    "unknown key": ("duration: 0.1", "durration: 0.1", 8, ["durration", "did you mean 'duration'"]),
    "unknown key of a vehicle": ("{model: bolt}", "{model: bolt, strat: x}", 3, ["strat", "did you mean 'start'"]),
    "unknown key of the driver": ("speed: 2}", "sped: 2}", 5, ["control.ego", "sped", "did you mean 'speed'"]),
    "unknown driver": ("kind: constant", "kind: constnt", 5, ["control.ego", "constnt", "path_tracking"]),
    "unknown start": ("{model: bolt}", "{model: bolt, start: pits}", 3, ["start", "'pits'"]),
    "no vehicles": ("  ego: {model: bolt}\n", "  {}\n", 2, ["vehicles", "at least 1"]),
    "driver without vehicle": ("control:\n  ego:", "control:\n  egon:", 5, ["control.egon", "did you mean 'ego'"]),
    "unknown track": ("kind: constant, speed: 2", "kind: path_tracking, track: main", 5, ["track", "'main'", "none"]),
    "misspelt xacro argument": ("{model: bolt}", "{model: bolt, arguments: {mas: '3'}}", 3, ["'mas'"]),
    "zero step": ("{contact: point}", "{time_step: 0}", 6, ["plant.time_step", "greater than 0"]),
    "NaN step": ("{contact: point}", "{time_step: .nan}", 6, ["plant.time_step", "finite"]),
    "unknown contact": ("contact: point", "contact: pints", 6, ["plant.contact", "pints", "point", "hydroelastic"]),
    "duration zero": ("duration: 0.1", "duration: 0", 8, ["duration", "greater than 0"]),
    "duration NaN": ("duration: 0.1", "duration: .nan", 8, ["duration", "finite"]),
    "wrong unit": ("speed: 2", "speed: 2 kg", 5, ["speed", "'kg'", "m/s", "km/h"]),
    "text for a number": ("duration: 0.1", "duration: long", 8, ["duration", "'long'", "number"]),
    "broken YAML": ("{model: bolt}", "{model: bolt", 4, [":"]),
    "sampled too fast": ("{meshcat: false,", "{rate: 0, meshcat: false,", 7, ["record.rate", "greater than 0"]),
    "name clash with a vehicle": (
        "duration: 0.1",
        "systems: {ego: {kind: sine, frequency: 1}}",
        8,
        ["systems.ego", "taken", "choose another"],
    ),
    "name clash with a part of Drake's": (
        "duration: 0.1",
        "systems: {plant: {kind: sine, frequency: 1}}",
        8,
        ["systems.plant", "taken", "choose another"],
    ),
    "unknown sensor": ("duration: 0.1", "sensors: {ego: [front_camra]}", 8, ["sensors.ego", "front_camra", "allowed"]),
    "sensors without vehicle": ("duration: 0.1", "sensors: {egg: []}", 8, ["sensors.egg", "did you mean 'ego'"]),
    "unknown kind": ("duration: 0.1", "systems: {a: {kind: gian}}", 8, ["systems.a.kind", "'gian'", "'gain'"]),
    "parameter of our kind": (
        "duration: 0.1",
        "systems: {a: {kind: gain, gain: 1, sise: 2}}",
        8,
        ["systems.a", "sise", "did you mean 'size'"],
    ),
    "NaN gain": ("duration: 0.1", "systems: {a: {kind: gain, gain: .nan}}", 8, ["systems.a.gain", "finite"]),
    "saturation upside down": (
        "duration: 0.1",
        "systems: {a: {kind: saturation, minimum: 1, maximum: 0}}",
        8,
        ["systems.a", "minimum", "maximum"],
    ),
    "missing module": ("duration: 0.1", "systems: {a: {kind: 'nowhere:A'}}", 8, ["systems.a.kind", "'nowhere'"]),
    "missing class": (
        "duration: 0.1",
        "systems: {a: {kind: 'blocks:Noch'}}",
        8,
        ["systems.a.kind", "'Noch'", "did you mean 'Notch'"],
    ),
    "class that is not a system": (
        "duration: 0.1",
        "systems: {a: {kind: 'blocks:Plain'}}",
        8,
        ["systems.a.kind", "'Plain'", "not a Drake system"],
    ),
    "no class at all": ("duration: 0.1", "systems: {a: {kind: 'blocks:RATE'}}", 8, ["systems.a.kind", "'RATE'"]),
    "wrong parameter": (
        "duration: 0.1",
        "systems: {a: {kind: 'blocks:Notch', frequncy: 2}}",
        8,
        ["systems.a", "'frequncy'", "did you mean 'frequency'"],
    ),
    "constructor raises": (
        "duration: 0.1",
        "systems: {a: {kind: 'blocks:Notch', frequency: -2}}",
        8,
        ["systems.a", "ValueError", "frequency -2 Hz is not positive"],
    ),
    "input not connected": (
        "duration: 0.1",
        "systems: {a: {kind: 'blocks:Notch'}}",
        8,
        ["'a.u'", "not connected", "add [<output>, a.u] to connect", "ego.steering_command"],
    ),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_in_the_diagram_file_is_one_line_with_file_and_line(
    fault: str, command: Callable[..., list[str]], tmp_path: Path
) -> None:
    old, new, line, words = FAULTS[fault]
    assert DRIVE.count(old) == 1
    (tmp_path / "drive.yaml").write_text(DRIVE.replace(old, new), encoding="utf-8")
    message = error_of(command("run", "drive.yaml"))
    assert message.startswith(f"drive.yaml:{line}: ")
    for word in words:
        assert word in message


WIRES = {
    # what: (pairs of connect, number of the faulty one, parts of the message)
    "unknown output": (["[ego.steering_comand, a.u]"], 0, ["unknown output", "did you mean 'ego.steering_command'"]),
    "unknown input": (["[ego.steering_command, a.v]"], 0, ["unknown input", "did you mean 'a.u'"]),
    "two outputs": (["[a.y, ego.steering_command]"], 0, ["'ego.steering_command' is an output; write it first"]),
    "two inputs": (["[ego.steering_reference, a.u]"], 0, ["'ego.steering_reference' is an input; write it second"]),
    "fed twice": (["[ego.steering_command, a.u]", "[a.y, a.u]"], 1, ["'a.u'", "already fed by 'ego.steering_command'"]),
    "wrong size": (["[ego.state, a.u]"], 0, ["'ego.state' has 12 elements", "'a.u' takes 1"]),
    "wrong unit": (["[ego.speed_command, a.u]"], 0, ["speed in m/s", "angle in rad"]),
    "wrong type": (["[b.message, a.u]"], 0, ["an abstract value", "a vector"]),
    "no pair": (["[a.y]"], 0, ["[system.output, system.input]"]),
}


@pytest.mark.parametrize("fault", WIRES)
def test_a_fault_in_a_connection_is_one_line_with_its_own_line_number(
    fault: str, command: Callable[..., list[str]], tmp_path: Path
) -> None:
    pairs, bad, words = WIRES[fault]
    text = DRIVE + "systems:\n  a: {kind: 'blocks:Notch'}\n  b: {kind: 'blocks:Message'}\nconnect:\n"
    (tmp_path / "drive.yaml").write_text(text + "".join(f"  - {pair}\n" for pair in pairs), encoding="utf-8")
    message = error_of(command("run", "drive.yaml"))
    assert message.startswith(
        ("drive.yaml:12: " if fault == "no pair" else f"drive.yaml:{13 + bad}: ", "drive.yaml:13: ")
    )
    for word in words:
        assert word in message


def test_a_circle_of_blocks_without_memory_is_rejected(command: Callable[..., list[str]], tmp_path: Path) -> None:
    extra = "systems:\n  a: {kind: gain, gain: 1}\nconnect: [[a.y, a.u]]\n"
    (tmp_path / "drive.yaml").write_text(DRIVE + extra, encoding="utf-8")
    message = error_of(command("run", "drive.yaml"))
    assert message.startswith("drive.yaml:11: connect: algebraic loop a.u0 → a.y0 → a.u0")
    assert "hold" in message


def test_several_faults_are_reported_at_once(command: Callable[..., list[str]], tmp_path: Path) -> None:
    text = DRIVE.replace("duration: 0.1", "duration: -1").replace("contact: point", "contakt: point")
    (tmp_path / "drive.yaml").write_text(text, encoding="utf-8")
    lines = command("run", "drive.yaml")
    assert [line.split()[1] for line in sorted(lines)] == ["drive.yaml:6:", "drive.yaml:8:"]
    assert all(line.startswith("error: ") for line in lines)


OVERRIDES = {
    "plant.time_step=0": ["plant.time_step", "greater than 0"],
    "control.ego.sped=8": ["control.ego", "sped", "did you mean 'speed'"],
    "vehicles.ego.model=blot": ["vehicles.ego.model", "'blot'", "did you mean 'bolt'"],
    "duration": ["expected KEY.PATH=VALUE"],
    "duration=.nan": ["duration", "finite"],
    "world=[": ["YAML"],
}


@pytest.mark.parametrize("override", OVERRIDES)
def test_a_fault_in_an_override_names_the_override(
    override: str, command: Callable[..., list[str]], tmp_path: Path
) -> None:
    (tmp_path / "drive.yaml").write_text(DRIVE, encoding="utf-8")
    message = error_of(command("run", "drive.yaml", "--set", override))
    assert message.startswith(f"--set {override}")
    for word in OVERRIDES[override]:
        assert word in message


@pytest.mark.parametrize("duration", ["0", "-1", "nan", "inf", "long"])
def test_a_duration_that_is_not_positive_is_rejected(duration: str, command: Callable[..., list[str]]) -> None:
    assert "--duration" in command("run", "bolt_test_track", f"--duration={duration}")[-1]


def test_an_unknown_diagram_is_reported_with_the_available_ones(command: Callable[..., list[str]]) -> None:
    assert "did you mean 'bolt_test_track'?" in error_of(command("run", "bolt_test_trak"))
    assert "no/drive.yaml" in error_of(command("run", "no/drive.yaml"))


def test_a_file_that_is_not_text_is_reported(command: Callable[..., list[str]], tmp_path: Path) -> None:
    (tmp_path / "drive.yaml").write_bytes(b"world: \xff\n")
    assert error_of(command("run", "drive.yaml")).startswith("drive.yaml")
    assert error_of(command("check", "drive.yaml")).startswith("drive.yaml")
    assert error_of(command("view", "drive.yaml")).startswith("drive.yaml")


# --- vehicles and worlds -------------------------------------------------------------------------------------------


def run_with_world(command: Callable[..., list[str]], world: Path) -> str:
    (world.parent / "drive.yaml").write_text(DRIVE.replace("world: empty", f"world: {world}"), encoding="utf-8")
    return error_of(command("run", "drive.yaml"))


def test_an_unclosed_track_is_reported_with_the_gap(command: Callable[..., list[str]], tmp_path: Path) -> None:
    segments = (
        "segments: [{line: 20}, {arc: {radius: 10, angle: 180 deg}}, {line: 17}, {arc: {radius: 10, angle: 180 deg}}]"
    )
    text = f"mirdrake: world/1\nname: gap\ntracks:\n  main:\n    closed: true\n    width: 3\n    {segments}\n"
    (tmp_path / "gap.yaml").write_text(text, encoding="utf-8")
    message = run_with_world(command, tmp_path / "gap.yaml")
    assert message.startswith("gap.yaml:4: tracks.main: does not close: gap 3 m")


def test_a_start_outside_the_world_is_reported(
    command: Callable[..., list[str]], corrupted_copy: Callable[[str, str, str], Path]
) -> None:
    world = corrupted_copy("worlds/test_track.yaml", "{on_track: {track: main, s: 0}}", "{at: [5000, 0], yaw: 0}")
    message = run_with_world(command, world)
    assert re.match(r"test_track\.yaml:\d+: start\.line", message)


@pytest.fixture
def vehicle(tmp_path: Path) -> Callable[[str, str, str], Path]:
    """A function (file, old, new) -> a copy of the Bolt's folder with one change."""

    def change(file: str, old: str, new: str) -> Path:
        folder = tmp_path / "car"
        shutil.copytree(paths.data_root() / "models" / "bolt", folder)
        path = folder / file
        text = path.read_text(encoding="utf-8")
        assert old in text
        path.write_text(text.replace(old, new, 1), encoding="utf-8")
        return folder

    return change


def run_with_vehicle(command: Callable[..., list[str]], folder: Path) -> str:
    drive = folder.parent / "drive.yaml"
    drive.write_text(DRIVE.replace("model: bolt", "model: ./car"), encoding="utf-8")
    message = error_of(command("run", "drive.yaml"))
    assert error_of(command("check", "./car")) in message or message  # the check finds it, too
    return message


def test_broken_xml_is_reported_with_its_line(
    command: Callable[..., list[str]], vehicle: Callable[[str, str, str], Path]
) -> None:
    message = run_with_vehicle(command, vehicle("structure.xacro", "</robot>", "</robt>"))
    assert re.search(r"structure\.xacro:\d+", message)


def test_a_negative_mass_is_reported(
    command: Callable[..., list[str]], vehicle: Callable[[str, str, str], Path]
) -> None:
    folder = vehicle("properties.xacro", 'name="wheel_mass" value="', 'name="wheel_mass" value="-')
    message = run_with_vehicle(command, folder)
    assert "mass" in message


def test_a_gain_that_is_not_a_number_is_reported(
    command: Callable[..., list[str]], vehicle: Callable[[str, str, str], Path]
) -> None:
    text = (paths.data_root() / "models/bolt/control.yaml").read_text(encoding="utf-8")
    match = re.search(r"kp: *[-0-9.e]+", text)
    assert match
    message = run_with_vehicle(command, vehicle("control.yaml", match[0], "kp: .nan"))
    assert re.search(r"control\.yaml:\d+: .*kp: .*finite", message)


def test_a_missing_mesh_is_reported(
    command: Callable[..., list[str]], vehicle: Callable[[str, str, str], Path]
) -> None:
    folder = vehicle("structure.xacro", "body.gltf", "boddy.gltf")
    assert "boddy.gltf" in run_with_vehicle(command, folder)


# --- the output folder ---------------------------------------------------------------------------------------------


def test_an_output_folder_that_cannot_be_made_is_reported(command: Callable[..., list[str]], tmp_path: Path) -> None:
    (tmp_path / "drive.yaml").write_text(DRIVE, encoding="utf-8")
    for out in ("drive.yaml/run", "drive.yaml", "/proc/run"):
        message = error_of(command("run", "drive.yaml", "--out", out))
        assert message.startswith(out)
        assert "--out" in message


@pytest.mark.skipif(os.geteuid() == 0, reason="file modes do not bind root")
def test_a_read_only_output_folder_is_reported(command: Callable[..., list[str]], tmp_path: Path) -> None:
    (tmp_path / "drive.yaml").write_text(DRIVE, encoding="utf-8")
    (tmp_path / "shut").mkdir(mode=stat.S_IRUSR | stat.S_IXUSR)
    assert "--out" in error_of(command("run", "drive.yaml", "--out", "shut/run"))


def test_an_output_folder_with_something_in_it_is_left_alone(command: Callable[..., list[str]], tmp_path: Path) -> None:
    (tmp_path / "drive.yaml").write_text(DRIVE, encoding="utf-8")
    (tmp_path / "runs").mkdir()
    (tmp_path / "runs" / "notes.txt").write_text("keep", encoding="utf-8")
    assert "not empty" in error_of(command("run", "drive.yaml", "--out", "runs"))


def test_a_picture_is_rejected_where_it_cannot_be_written(command: Callable[..., list[str]]) -> None:
    assert ".svg or .dot" in error_of(command("draw", "bolt_test_track", "--out", "blocks.gif"))
    assert "nowhere" in error_of(command("draw", "bolt_test_track", "--out", "nowhere/blocks.dot"))
    assert "nowhere" in error_of(command("view", "empty", "--out", "nowhere/world.html"))


def test_the_command_itself_prints_one_line_and_no_traceback(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "mirdrake.cli", "run", "bolt_test_track", "--set", "world=emty"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr.startswith("error: --set world=emty: world: unknown world 'emty'; did you mean 'empty'?")
    assert done.stderr.count("\n") == 1
    assert list(tmp_path.iterdir()) == []
