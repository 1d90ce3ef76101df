"""The command `mirdrake`: run, list, view, check, draw, as typed in a shell."""

import argparse
import contextlib
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from textwrap import dedent

import pytest

from mirdrake.assembly.drawing import layout_command
from mirdrake.cli import main
from mirdrake.cli.common import positive_length, positive_time
from mirdrake.runs.logs import load_run

DRIVE = dedent(
    """\
    # a car in a field
    world: empty
    vehicles:
      ego: {model: bolt}
    control:
      ego: {kind: constant, speed: 2, steering: 0.1}
    plant: {contact: point}
    record: {meshcat: false, report: false}
    duration: 0.5
    """
)


def mirdrake(*arguments: str, folder: Path, code: int = 0) -> tuple[str, str]:
    """Return stdout and stderr of a command in a separate process."""
    command = [sys.executable, "-m", "mirdrake.cli", *arguments]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == code, done.stdout + done.stderr
    return done.stdout, done.stderr


@pytest.fixture
def call_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[..., tuple[int, str, str]]:
    """A function (arguments) -> exit code, stdout, stderr of a command in tmp_path, where drive.yaml lies."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "drive.yaml").write_text(DRIVE, encoding="utf-8")

    def call(*arguments: str) -> tuple[int, str, str]:
        try:
            code = main(arguments)
        except SystemExit as stop:  # argparse
            code = int(stop.code or 0)
        out, err = capsys.readouterr()
        return code, out, err

    return call


@pytest.mark.parametrize(
    ("verb", "words", "message"),
    [
        ("run", "drive.yaml --duratoin 3", "unknown arguments: --duratoin 3; did you mean '--duration'?"),
        (
            "run",
            "drive.yaml --trust",
            "unknown arguments: --trust; it is an option of mirdrake check, mirdrake draw, mirdrake ports, "
            "mirdrake world check only;",
        ),
        (
            "world test",
            "parking_lot --workers 2",
            "unknown arguments: --workers 2; it is an option of mirdrake study, mirdrake tune run only;",
        ),
        ("tune run", "bolt_speed --foo", "unknown arguments: --foo;"),
        ("run", "x --duration long", "--duration: 'long' is not a number in s, or with a unit such as 1 min;"),
        ("export", "runs/x --to cvs", "--to: unknown 'cvs'; did you mean 'csv'? (allowed: csv, mcap, video);"),
        (
            "manoeuvre",
            "braking bolt --model ful",
            "--model: unknown 'ful'; did you mean 'full'? (allowed: full, single_track);",
        ),
        ("study", "x --workers many", "--workers: 'many' is not allowed; expected a whole number from 0 to 100000;"),
        ("replay", "runs/x --port http", "--port: 'http' is not allowed; expected a whole number from 0 to 65535;"),
        ("world search", "yard --seed", "--seed: expected one argument;"),
        ("completion", "fish", "shell: unknown 'fish'; allowed: bash, zsh;"),
        ("run", "", "the following arguments are required: diagram;"),
    ],
)
def test_a_wrong_option_is_reported_in_one_line(call_command, verb, words, message):
    expected = f"error: {message} see mirdrake {verb} --help\n"
    assert call_command(*f"{verb} {words}".split()) == (2, "", expected)


@pytest.mark.parametrize(
    ("words", "hint"),
    [
        ("tune aply runs/tuned", "; did you mean the command 'apply'? see"),
        ("tune bolt_speed runs/tuned", "; see"),
    ],
)
def test_a_misspelt_command_below_another_one_is_suggested(call_command, words, hint):
    error = f"error: unknown arguments: runs/tuned{hint} mirdrake tune run --help\n"
    assert call_command(*words.split()) == (2, "", error)


def test_an_unknown_command_is_reported_in_one_line(tmp_path: Path) -> None:
    _, err = mirdrake("manouvre", "braking", "bolt", folder=tmp_path, code=2)
    assert err.startswith("error: COMMAND: unknown 'manouvre'; did you mean 'manoeuvre'? (allowed: check,")
    assert len(err.splitlines()) == 1


# --- run -------------------------------------------------------------------------------------------------------------


@pytest.mark.essential
def test_times_and_lengths_of_options_take_units() -> None:
    assert [positive_time(text) for text in ("90", "1.5 min", "90000ms")] == pytest.approx([90.0] * 3)
    assert positive_length("250 cm") == pytest.approx(2.5)
    for text, message in {
        "1 km": "unit 'km' does not fit; allowed: s, ms, min, h",
        "long": "'long' is not a number in s, or with a unit such as 1 min",
        "nan": "is not a number",
        "1e999": "'1e999' is not allowed; expected a positive number in s",
        "0 s": "'0 s' is not allowed; expected a positive number in s",
    }.items():
        with pytest.raises(argparse.ArgumentTypeError, match=message):
            positive_time(text)


def test_run_drives_the_test_track_prints_a_summary_and_names_the_folder(tmp_path: Path) -> None:
    out, err = mirdrake(
        "run", "bolt_test_track", "--set", "duration=1", "--set", "plant.contact=point", folder=tmp_path
    )
    assert err == ""
    assert re.match(r"bolt_test_track: 1 s in [0-9.]+ s \([0-9.]+ x real time\)\n", out)
    for words in ("whole duration", "ego: bolt", "m driven", "0.00", "report.html", "recording.html"):
        assert words in out
    (folder,) = (tmp_path / "runs").iterdir()
    assert re.fullmatch(r"bolt_test_track-\d{8}T\d{6}Z", folder.name)
    assert f"runs/{folder.name}/" in out
    assert (folder / "recording.html").stat().st_size > 1e6
    assert load_run(folder).summary["simulated_s"] == 1.0


def test_run_takes_a_path_from_any_folder(call_command: Callable[..., tuple[int, str, str]], tmp_path: Path) -> None:
    (tmp_path / "elsewhere").mkdir()
    shutil.move(tmp_path / "drive.yaml", tmp_path / "elsewhere" / "drive.yaml")
    assert call_command("run", "elsewhere/drive.yaml", "--out", "out", "--quiet") == (0, "", "")
    assert load_run(tmp_path / "out").summary["diagram"] == "drive"


def test_quiet_prints_warnings_and_nothing_else(
    call_command: Callable[..., tuple[int, str, str]], tmp_path: Path
) -> None:
    fast = ("--set", "vehicles.ego.speed=200", "--set", "duration=0.02")
    code, out, err = call_command("run", "drive.yaml", "--out", "out", "--quiet", *fast)
    assert (code, out) == (0, "")
    assert re.fullmatch(r"warning: t = 0\.00 s: ego: starts at 200 m/s; its top speed is [\d.]+ m/s; .*\n", err)


def test_overrides_reach_every_level_and_win_over_the_file(
    call_command: Callable[..., tuple[int, str, str]], tmp_path: Path
) -> None:
    sets = [
        "duration=0.2 s",
        "control.ego.speed=3.6 km/h",
        "plant.time_step=2 ms",
        "vehicles.ego.start=origin",
        "seed=7",
    ]
    code, _, err = call_command(
        "run", "drive.yaml", "--out", "out", *[word for item in sets for word in ("--set", item)]
    )
    assert (code, err) == (0, "")
    spec = load_run(tmp_path / "out").spec
    assert spec["duration"] == 0.2
    assert spec["control"]["ego"]["speed"] == pytest.approx(1.0)
    assert spec["control"]["ego"]["steering"] == 0.1  # from the file
    assert spec["control"]["ego"]["period"] == 0.02  # the default
    assert spec["plant"] == spec["plant"] | {"time_step": 0.002, "contact": "point"}
    assert spec["vehicles"]["ego"]["start"] == "origin"
    assert spec["seed"] == 7


def test_an_option_wins_over_an_override_and_the_last_override_over_the_first(
    call_command: Callable[..., tuple[int, str, str]], tmp_path: Path
) -> None:
    call_command("run", "drive.yaml", "--out", "a", "--set", "duration=0.1", "--set", "duration=0.3")
    call_command("run", "drive.yaml", "--out", "b", "--set", "duration=0.1", "--duration", "0.2")
    assert load_run(tmp_path / "a").summary["simulated_s"] == 0.3
    assert load_run(tmp_path / "b").summary["simulated_s"] == 0.2
    assert load_run(tmp_path / "b").spec["duration"] == 0.2


def test_run_at_real_time_takes_as_long_as_it_simulates(
    call_command: Callable[..., tuple[int, str, str]], tmp_path: Path
) -> None:
    call_command("run", "drive.yaml", "--out", "out", "--realtime")
    assert 0.45 < load_run(tmp_path / "out").summary["wall_s"] < 5.0


def test_a_diagram_of_the_working_directory_hides_ours(
    call_command: Callable[..., tuple[int, str, str]], tmp_path: Path
) -> None:
    (tmp_path / "diagrams").mkdir()
    shutil.move(tmp_path / "drive.yaml", tmp_path / "diagrams" / "bolt_test_track.yaml")
    code, out, _ = call_command("run", "bolt_test_track", "--out", "out")
    assert code == 0
    assert out.startswith("bolt_test_track: 0.5 s")


# --- list, check, draw, view -----------------------------------------------------------------------------------------


def test_list_shows_the_available_names(call_command: Callable[..., tuple[int, str, str]], tmp_path: Path) -> None:
    code, out, err = call_command("list")
    assert (code, err) == (0, "")
    assert re.findall(r"^(\w+):$", out, flags=re.MULTILINE) == ["models", "worlds", "diagrams", "studies"]
    out = call_command("list", "all")[1]
    kinds = ["models", "worlds", "diagrams", "studies", "props", "sensors", "drivers", "blocks"]
    assert re.findall(r"^(\w+):$", out, flags=re.MULTILINE) == kinds
    for name in ("bolt", "test_track", "empty", "bolt_test_track", "cone", "sick_lms291", "hold_lane", "low_pass"):
        assert re.search(rf"^  {name} +\S", out, flags=re.MULTILINE)
    (tmp_path / "worlds").mkdir()
    (tmp_path / "worlds" / "mine.yaml").write_text("mirdrake: world/1\nname: mine\n", encoding="utf-8")
    assert re.search(r"^  mine +worlds/mine\.yaml$", call_command("list", "worlds")[1], flags=re.MULTILINE)


@pytest.mark.parametrize("every", [7, pytest.param(1, marks=pytest.mark.slow)], ids=["each seventh", "all"])
def test_everything_that_ships_is_sound(every: int, call_command: Callable[..., tuple[int, str, str]]) -> None:
    listing = call_command("list")[1]
    names = re.findall(r"^  (\w+) ", listing, flags=re.MULTILINE)[::every]
    code, out, err = call_command("check", *names)
    assert (code, err) == (0, "")
    assert [line for line in out.splitlines() if not line.startswith(" ")] == [f"{name}: sound" for name in names]


def test_check_reports_the_faults_of_all_bad_files_and_continues(
    call_command: Callable[..., tuple[int, str, str]], tmp_path: Path
) -> None:
    (tmp_path / "bad.yaml").write_text(DRIVE.replace("plant", "plnt").replace("speed: 2", "speed: x"), encoding="utf-8")
    code, out, err = call_command("check", "bad.yaml", "empty", "nobody", "drive.yaml")
    assert code == 2
    assert out.splitlines() == ["empty: sound", "drive.yaml: sound"]
    first, second, third = err.splitlines()
    assert [line.split(":")[1:3] for line in (first, second)] == [[" bad.yaml", "6"], [" bad.yaml", "7"]]
    assert third.startswith("error: unknown name 'nobody'; allowed: barrels, bolt, ")


def test_check_names_outputs_that_nothing_reads(
    call_command: Callable[..., tuple[int, str, str]], tmp_path: Path
) -> None:
    with (tmp_path / "drive.yaml").open("a", encoding="utf-8") as file:
        file.write("systems: {half: {kind: constant, value: [0.5]}}\n")
    assert call_command("check", "drive.yaml") == (0, "drive.yaml: sound\n  output 'half.y' is not read\n", "")


def test_check_reports_cameras_that_take_no_pictures(
    call_command: Callable[..., tuple[int, str, str]], tmp_path: Path
) -> None:
    with (tmp_path / "drive.yaml").open("a", encoding="utf-8") as file:
        file.write("sensors: {ego: [front_camera]}\n")
    why = "they are neither recorded (record.cameras: true) nor connected"
    expected = f"drive.yaml: sound\n  camera 'ego.front_camera' takes no pictures: {why}\n"
    assert call_command("check", "drive.yaml") == (0, expected, "")


def test_check_takes_overrides_and_run_folders(call_command: Callable[..., tuple[int, str, str]]) -> None:
    assert call_command("check", "drive.yaml", "--set", "plant.time_step=0")[0] == 2
    call_command("run", "drive.yaml", "--out", "out", "--duration", "0.1")
    assert call_command("check", "out")[:2] == (0, "out: sound\n")


OWN = """
world: empty
vehicles: {ego: {model: bolt}}
control: {ego: {kind: "harmful:Harmful"}}
systems: {own: {kind: "harmful:Harmful"}, half: {kind: gain, gain: 0.5}}
connect: [[own.y, half.u]]
"""


@pytest.mark.parametrize("verb", ["check", "draw"])
def test_user_modules_are_executed_only_with_trust(
    verb: str, call_command: Callable[..., tuple[int, str, str]], tmp_path: Path
) -> None:
    if verb == "draw" and layout_command() is None:
        pytest.skip("needs Graphviz")
    (tmp_path / "own.yaml").write_text(OWN, encoding="utf-8")
    (tmp_path / "harmful.py").write_text("open('executed', 'w').close()\n", encoding="utf-8")
    code, out, _ = call_command(verb, "own.yaml")
    assert (code, (tmp_path / "executed").exists()) == (0, False)
    word = "checked" if verb == "check" else "drawn"
    for part in (
        "systems.own (harmful:Harmful)",
        "control.ego (harmful:Harmful)",
        "systems.half (an input is from own)",
    ):
        assert f"  not {word}: {part}: mirdrake {verb} executes user modules only with --trust" in out
    assert call_command(verb, "own.yaml", "--trust")[0] == 2  # the module has no such class
    assert (tmp_path / "executed").exists()


@pytest.mark.parametrize("verb", ["check", "ports"])
def test_signals_of_user_systems_are_not_checked_without_trust(
    verb: str, call_command: Callable[..., tuple[int, str, str]], tmp_path: Path
) -> None:
    text = DRIVE.replace("record: {", "record: {signals: [slow.limited], ") + "systems: {slow: {kind: 'own:Slow'}}\n"
    (tmp_path / "own.yaml").write_text(text, encoding="utf-8")
    code, out, err = call_command(verb, "own.yaml")
    assert code == 0, err
    assert "record.signals: slow.limited: mirdrake" in out + err
    code, _, err = call_command(verb, "own.yaml", "--set", "record.signals=[slw.limited]")
    assert code == 2
    assert "no signal matches 'slw.limited'" in err


def test_a_study_is_checked_without_its_metrics_functions(
    call_command: Callable[..., tuple[int, str, str]], tmp_path: Path
) -> None:
    (tmp_path / "harmful.py").write_text("open('executed', 'w').close()\ndef figure(run): ...\n", encoding="utf-8")
    study = "mirdrake: study/1\ndiagram: bolt_test_track\nparameters: {ego.speed.kp: {low: 0.5, high: 5, count: 2}}\n"
    (tmp_path / "study.yaml").write_text(f"{study}metrics: ['harmful:figure']\n", encoding="utf-8")
    code, out, err = call_command("check", "study.yaml")
    assert not (tmp_path / "executed").exists(), (code, out, err)


def test_a_tuning_study_of_a_diagram_with_user_modules_is_checked_without_them(
    call_command: Callable[..., tuple[int, str, str]], tmp_path: Path
) -> None:
    (tmp_path / "own.yaml").write_text(OWN, encoding="utf-8")
    (tmp_path / "harmful.py").write_text("open('executed', 'w').close()\n", encoding="utf-8")
    loop = "{diagram: own.yaml, reference: 1, output: half.y, effort: own.y, parameters: [half.gain]}"
    (tmp_path / "tuning.yaml").write_text(f"mirdrake: tuning/1\nloop: {loop}\n", encoding="utf-8")
    code, out, err = call_command("check", "tuning.yaml")
    assert (code, err, (tmp_path / "executed").exists()) == (0, "", False)
    assert "not checked: harmful" in out
    assert call_command("check", "tuning.yaml", "--set", "cost={iea: 1}")[0] == 2
    assert call_command("check", "tuning.yaml", "--trust")[0] == 2  # the module has no such class


def test_draw_writes_the_blocks(call_command: Callable[..., tuple[int, str, str]], tmp_path: Path) -> None:
    assert call_command("draw", "drive.yaml", "--out", "blocks.dot") == (0, "blocks.dot\n", "")
    assert (tmp_path / "blocks.dot").read_text(encoding="utf-8").startswith("digraph {")
    if layout_command():
        assert call_command("draw", "drive.yaml") == (0, "drive.svg\n", "")
        assert (tmp_path / "drive.svg").read_text(encoding="utf-8").startswith("<svg")


def test_without_graphviz_draw_names_what_to_install_and_a_run_continues(
    call_command: Callable[..., tuple[int, str, str]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mirdrake.assembly.drawing.layout_command", lambda: None)
    code, _, err = call_command("draw", "drive.yaml")
    assert code == 2
    assert "mirdrake[drawing]" in err
    assert err.count("\n") == 1
    assert call_command("run", "drive.yaml", "--out", "out")[0] == 0
    assert not (tmp_path / "out" / "diagram.svg").exists()
    assert (tmp_path / "out" / "diagram.dot").is_file()


@pytest.mark.parametrize("name", ["bolt", "empty", "drive.yaml", "out"])
def test_view_writes_a_page_that_needs_no_network(
    name: str, call_command: Callable[..., tuple[int, str, str]], tmp_path: Path
) -> None:
    if name == "out":
        call_command("run", "drive.yaml", "--out", "out")
    assert call_command("view", name, "--out", "page.html") == (0, "page.html\n", "")
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert len(page) > 1e6
    assert not re.search(r"<(script|link|img)[^>]+(src|href)=[\"']?(https?:)?//", page)


# --- help ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("verb", ["run", "list", "view", "check", "draw"])
def test_the_help_of_a_verb_has_an_example(verb: str, call_command: Callable[..., tuple[int, str, str]]) -> None:
    code, out, _ = call_command(verb, "--help")
    assert code == 0
    assert re.search(rf"example[s]?:\n  mirdrake {verb} \w", out)


def test_the_help_of_the_command_leads_to_the_first_run(call_command: Callable[..., tuple[int, str, str]]) -> None:
    code, out, _ = call_command("--help")
    assert code == 0
    assert "mirdrake run bolt_test_track" in out
    assert "Exit codes" in out


def test_no_verb_and_an_unknown_verb_are_bad_input(call_command: Callable[..., tuple[int, str, str]]) -> None:
    code, _, err = call_command()
    assert code == 2
    assert "COMMAND" in err
    assert "mirdrake run bolt_test_track" in err
    code, _, err = call_command("rnu", "bolt_test_track")
    assert code == 2
    assert "'rnu'" in err
    assert "run" in err.splitlines()[-1]


def test_the_version_is_that_of_the_package(call_command: Callable[..., tuple[int, str, str]]) -> None:
    from importlib.metadata import version

    assert call_command("--version")[:2] == (0, f"mirdrake {version('mirdrake')}\n")


def test_the_version_of_sources_without_installation_is_unknown(
    call_command: Callable[..., tuple[int, str, str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    import importlib.metadata

    def missing(name: str) -> str:
        raise importlib.metadata.PackageNotFoundError(name)

    monkeypatch.setattr(importlib.metadata, "version", missing)
    assert call_command("--version")[:2] == (
        0,
        "mirdrake, unknown version: its sources are used without an installation\n",
    )
    assert call_command("list")[0] == 0


def test_a_closed_pipe_is_not_an_error(tmp_path: Path) -> None:
    command = f"set -o pipefail; {sys.executable} -m mirdrake.cli list | true"
    done = subprocess.run(["bash", "-c", command], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_in_a_terminal_a_run_shows_its_progress_and_the_meshcat_address(tmp_path: Path) -> None:
    pty = pytest.importorskip("pty")
    (tmp_path / "drive.yaml").write_text(DRIVE, encoding="utf-8")
    master, slave = pty.openpty()
    termios = pytest.importorskip("termios")
    termios.tcsetwinsize(slave, (30, 100))
    command = [sys.executable, "-m", "mirdrake.cli", "run", "drive.yaml", "--out", "out", "--duration", "3"]
    process = subprocess.Popen(command, cwd=tmp_path, stdin=slave, stdout=slave, stderr=slave)
    os.close(slave)
    text = b""
    with contextlib.suppress(OSError):  # Linux raises it when the other side has closed
        while block := os.read(master, 4096):
            text += block
    os.close(master)
    assert process.wait(timeout=300) == 0
    shown = text.decode()
    assert re.search(r"Meshcat: http://localhost:\d+", shown)
    assert re.search(r"drive: 100% \|\S+ *\| 3/3 s, 00:00 left, [0-9.]+ x real time", shown)
    assert "Traceback" not in shown
