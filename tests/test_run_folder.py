"""The run folder: complete, repeatable to the last bit, with units, and readable however the run ends."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from textwrap import dedent
from typing import Any

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
import yaml

import mirdrake as mir
from mirdrake.assembly.diagram import assemble
from mirdrake.cli import main
from mirdrake.core.errors import ConfigError, RunError
from mirdrake.core.paths import names
from mirdrake.core.user_modules import import_user_module
from mirdrake.core.user_systems import make_user_system
from mirdrake.runs.logs import Run, RunWriter, load_run
from mirdrake.runs.simulation import Simulation, default_folder, simulate
from mirdrake.runs.summary import drive_figures, missed_speed
from mirdrake.runs.texts import describe_findings
from mirdrake.runs.wheel_oscillation import find_wheel_oscillation
from mirdrake.workflow import run_diagram

FIGURES = {"simulated_s", "wall_s", "real_time_factor", "stop_reason", "stop_detail", "spec_sha256", "seed", "vehicles"}
VEHICLE_FIGURES = {"laps", "max_abs_lateral_error_m", "mean_speed_error_percent", "off_road_s"}

OWN = dedent(
    """\
    from math import nan

    from pydrake.systems.framework import LeafSystem


    class Faulty(LeafSystem):
        def __init__(self, *, at: float, how: str):
            super().__init__()
            self._at, self._how = at, how
            self._u = self.DeclareVectorInputPort("u", 1)
            self.DeclareVectorOutputPort("y", 1, self._calc)

        def _calc(self, context, output):
            output.SetFromVector(self._u.Eval(context))
            if context.get_time() >= self._at:
                if self._how == "raise":
                    raise ZeroDivisionError("no more ideas")
                if self._how != "nan":
                    raise {"SystemExit": SystemExit, "GeneratorExit": GeneratorExit, "own": Own}[self._how]("enough")
                output.SetFromVector([nan])


    class Own(BaseException):
        pass
    """
)

FAULTY_DRIVE = dedent(
    """\
    world: empty
    vehicles: {ego: {model: bolt}}
    control: {ego: {kind: constant, speed: 2, steering: 0.1}}
    systems:
      faulty: {kind: "own_faulty:Faulty", at: 0.8, how: raise}
    connect:
      - [ego.steering_command, faulty.u]
      - [faulty.y, ego.steering_reference]
    plant: {contact: point}
    record: {meshcat: false, report: false}
    duration: 2
    """
)


def drive(**changes: Any) -> dict[str, Any]:
    """Return a Bolt on the test track for two seconds, as plain data."""
    return {
        "world": "test_track",
        "vehicles": {"ego": {"model": "bolt", "start": "line"}},
        "control": {"ego": {"kind": "path_tracking", "speed": 5.0}},
        "plant": {"contact": "point"},
        "record": {"meshcat": False, "report": False},
        "duration": 2.0,
    } | changes


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Return one second of :func:`drive` in a folder."""
    return simulate(drive(duration=1.0), folder=tmp_path_factory.mktemp("recorded") / "run")


def folder_of(run: Run) -> Path:
    """Return the folder of a run."""
    assert run.folder is not None
    return run.folder


def start_run(folder: Path, *arguments: str) -> subprocess.Popen[str]:
    """`mirdrake run bolt_test_track` as a process of its own, into folder/out."""
    command = [sys.executable, "-m", "mirdrake.cli", "run", "bolt_test_track", "--out", "out", "--no-recording"]
    command += ["--no-report", "--set", "plant.contact=point", *arguments]
    return subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def wait_for_parts(folder: Path, *, count: int) -> None:
    """Until a running simulation has written so many parts of its signals."""
    deadline = time.monotonic() + 300.0
    while len(list(folder.glob("out/signals.parquet/part-*.parquet"))) < count:
        assert time.monotonic() < deadline, "no signals after five minutes"
        time.sleep(0.02)


# --- what is in it ---------------------------------------------------------------------------------------------------


@pytest.mark.essential
def test_a_run_folder_is_complete(tmp_path: Path) -> None:
    run = run_diagram(drive(record={}, duration=1.0), folder=tmp_path / "run")
    files = {path.name for path in (tmp_path / "run").iterdir()}
    expected = {"spec.yaml", "signals.parquet", "summary.json", "recording.html", "report.html", "diagram.dot", "scene"}
    assert expected <= files
    assert files - expected <= {"diagram.svg", "events.jsonl"}
    assert not [name for name in files if name.startswith(".")]

    summary = json.loads((tmp_path / "run" / "summary.json").read_text(encoding="utf-8"))
    assert set(summary) >= FIGURES
    assert set(summary["vehicles"]["ego"]) >= VEHICLE_FIGURES
    assert summary["simulated_s"] == 1.0
    assert summary["stop_reason"] == "duration"
    assert summary == run.summary

    spec = yaml.safe_load((tmp_path / "run" / "spec.yaml").read_text(encoding="utf-8"))
    assert spec["seed"] == 0
    assert spec["plant"]["time_step"] == 0.005
    assert spec["provenance"]["spec_sha256"] == summary["spec_sha256"]
    assert set(spec["provenance"]["versions"]) >= {"mirdrake", "drake", "numpy", "python"}


def test_a_folder_is_the_same_run_when_it_is_read_again(recorded: Run) -> None:
    again = load_run(folder_of(recorded))
    pd.testing.assert_frame_equal(again.signals, recorded.signals, check_exact=True)
    assert again.units == recorded.units
    assert again.summary == recorded.summary
    assert again.spec == recorded.spec
    assert again.events == recorded.events


def test_signals_open_in_pandas_with_units(recorded: Run) -> None:
    file = folder_of(recorded) / "signals.parquet"
    table = pd.read_parquet(file)
    units = table.attrs["units"]
    assert list(units) == list(table.columns)
    expected = {"time": "s", "ego.vx": "m/s", "ego.yaw": "rad", "ego.wheel_torque.rear_left": "N m", "ego.lap": ""}
    assert {name: units[name] for name in expected} == expected
    schema = pq.read_schema(file)
    assert {name: schema.field(name).metadata[b"unit"].decode() for name in expected} == expected
    times = table["time"].to_numpy()
    np.testing.assert_allclose(times, 0.02 * np.arange(51), atol=1e-12)  # 50 Hz, both ends included
    assert table.notna().all().all()


def test_the_figures_of_the_summary_follow_from_the_signals() -> None:
    run = simulate(drive(duration=3.0))
    figures = run.summary["vehicles"]["ego"]
    assert figures["distance_m"] == pytest.approx(run["ego.progress"].iloc[-1], abs=0.15)  # the start is at s = 0
    assert figures["laps"] == pytest.approx(figures["distance_m"] / 965.0, abs=2e-4)
    assert figures["max_abs_lateral_error_m"] == pytest.approx(run["ego.lateral_error"].abs().max(), abs=1e-4)
    assert figures["off_road_s"] == 0.0


def test_a_car_that_leaves_the_road_makes_events_and_seconds_off_the_road() -> None:
    control = {"ego": {"kind": "constant", "speed": 5.0, "steering": 0.3}}
    vehicles = {"ego": {"model": "bolt", "start": "line", "speed": 5.0}}
    run = simulate(drive(control=control, vehicles=vehicles))
    texts = [event["text"] for event in run.events if event["kind"] == "road"]
    assert texts[0] == "ego: 3 of 4 wheels on the road"
    assert run.summary["vehicles"]["ego"]["off_road_s"] > 0.5
    first = next(event["time"] for event in run.events if event["kind"] == "road")
    assert run["ego.wheels_on_road"].loc[: first - 0.01].min() == 4.0


def test_a_run_stops_after_its_laps() -> None:
    run = simulate(drive(laps=0.005, duration=20.0))
    assert run.summary["stop_reason"] == "laps"
    assert 0.005 <= run.summary["vehicles"]["ego"]["laps"] < 0.01  # it looks twice a second


def test_a_default_folder_is_named_after_the_diagram_and_never_taken_twice(tmp_path: Path) -> None:
    first = default_folder("demo", base=tmp_path)
    first.mkdir(parents=True)
    second = default_folder("demo", base=tmp_path)
    assert first.parent == second.parent == tmp_path / "runs"
    assert first.name.startswith("demo-")
    assert first.name.endswith("Z")
    assert not second.exists()
    assert default_folder("Two-track car, $HOME/a", base=tmp_path).name.startswith("Two-track_car_HOME_a-")


def test_an_unknown_signal_is_an_error_with_suggestions() -> None:
    run = simulate(drive(duration=0.1))
    with pytest.raises(ConfigError, match=r"no signal 'ego\.vxx'; did you mean 'ego\.vx'"):
        run["ego.vxx"]


# --- the same bits ---------------------------------------------------------------------------------------------------


def test_a_run_repeated_from_its_own_spec_has_the_same_bytes(tmp_path: Path) -> None:
    simulate(drive(plant={}, duration=1.0), folder=tmp_path / "first")  # the default contact, hydroelastic
    simulate(mir.load_diagram(str(tmp_path / "first" / "spec.yaml")), folder=tmp_path / "second")
    data = (tmp_path / "first" / "signals.parquet").read_bytes()
    assert (tmp_path / "second" / "signals.parquet").read_bytes() == data
    summaries = [load_run(tmp_path / name).summary["spec_sha256"] for name in ("first", "second")]
    assert summaries[0] == summaries[1]


@pytest.mark.parametrize(
    ("file", "old", "new", "reported"),
    [
        (None, "", "", ""),
        ("yard.yaml", "mu: 0.8", "mu: 0.5", "the world"),
        ("car/vehicle.yaml", "drag_area: 0.798", "drag_area: 0.9", "vehicle 'ego'"),
        ("car/properties.xacro", 'name="kerb_mass" value="1616"', 'name="kerb_mass" value="1626"', "vehicle 'ego'"),
        ("car/control.yaml", "dead_man: 200", "dead_man: 300", "vehicle 'ego'"),
        ("box.obj", "v 0 0 1", "v 0 0 2", "box.obj"),
    ],
)
def test_a_run_from_a_spec_reports_files_that_have_changed_since(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], file: str | None, old: str, new: str, reported: str
) -> None:
    shutil.copytree(names("models")["bolt"], tmp_path / "car")
    (tmp_path / "box.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n")
    ground, scenery = "{mu: 0.8, size: [100, 100]}", "[{file: box.obj, at: [9, 9, 0]}]"
    world = f"{{mirdrake: world/1, name: yard, ground: {ground}, scenery: {scenery}}}"
    (tmp_path / "yard.yaml").write_text(world)
    spec = drive(world=str(tmp_path / "yard.yaml"), vehicles={"ego": {"model": str(tmp_path / "car")}}, duration=0.02)
    simulate(spec | {"control": {"ego": {"kind": "constant", "speed": 1.0}}}, folder=tmp_path / "first")
    if file is not None:
        text = (tmp_path / file).read_text(encoding="utf-8")
        assert old in text
        (tmp_path / file).write_text(text.replace(old, new, 1), encoding="utf-8")
    again = str(tmp_path / "first" / "spec.yaml")
    main(["run", again, "--out", str(tmp_path / "second"), "--quiet"])
    lines = [line for line in capsys.readouterr().err.splitlines() if "changed since that run" in line]
    assert len(lines) == (file is not None)
    assert all(reported in line and again in line for line in lines)
    if file == "yard.yaml":  # on purpose
        main(["run", again, "--set", "world.seed=3", "--out", str(tmp_path / "third"), "--quiet"])
        assert "changed since" not in capsys.readouterr().err


def test_another_process_gives_the_same_bytes(recorded: Run, tmp_path: Path) -> None:
    spec = folder_of(recorded) / "spec.yaml"
    command = [sys.executable, "-m", "mirdrake.cli", "run", str(spec), "--out", "second", "--quiet"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    data = (folder_of(recorded) / "signals.parquet").read_bytes()
    assert (tmp_path / "second" / "signals.parquet").read_bytes() == data


def test_two_runs_of_one_built_diagram_are_the_same() -> None:
    simulation = Simulation(assemble(drive(duration=1.0)))
    first, second = simulation.run(), simulation.run()
    pd.testing.assert_frame_equal(first.signals, second.signals, check_exact=True)


def test_the_hash_is_that_of_the_contents(tmp_path: Path) -> None:
    def digest(world: Path) -> str:
        control = {"ego": {"kind": "constant", "speed": 1.0}}
        run = simulate(drive(world=str(world), control=control, vehicles={"ego": {"model": "bolt"}}, duration=0.1))
        return str(run.summary["spec_sha256"])

    world = tmp_path / "field.yaml"
    world.write_text("mirdrake: world/1\nname: field\n", encoding="utf-8")
    first, again = digest(world), digest(world)
    world.write_text("mirdrake: world/1\nname: field\nground: {mu: 0.5}\n", encoding="utf-8")
    assert first == again != digest(world)


def test_a_vehicle_without_a_driver_is_an_error_before_anything_is_written(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"control: 'ego' has no driver .*ego\.speed_reference.*; add control\.ego"):
        simulate(drive(control={}), folder=tmp_path / "run")
    assert not (tmp_path / "run").exists()


# --- what ends a run -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)])
def test_a_stopped_run_keeps_what_was_done(number: signal.Signals, tmp_path: Path) -> None:
    process = start_run(tmp_path, "--duration", "10000", "--set", "laps=null")
    wait_for_parts(tmp_path, count=2)
    process.send_signal(number)
    out, err = process.communicate(timeout=300)
    assert (process.returncode, err) == (0, "")
    assert "interrupted" in out
    run = load_run(tmp_path / "out")
    assert run.summary["stop_reason"] == "interrupted"
    assert run.signals.index[-1] >= 1.5
    assert run.signals.index[-1] == pytest.approx(run.summary["simulated_s"], abs=0.021)
    assert (tmp_path / "out" / "signals.parquet").is_file()
    assert run.events[-1]["text"] == "interrupted"
    table = pd.read_parquet(tmp_path / "out" / "signals.parquet")
    assert len(table) == len(run.signals)


@pytest.mark.essential
def test_a_killed_run_can_be_read_up_to_that_moment(tmp_path: Path) -> None:
    process = start_run(tmp_path, "--duration", "10000", "--set", "laps=null")
    wait_for_parts(tmp_path, count=2)
    process.kill()
    process.communicate(timeout=300)
    run = load_run(tmp_path / "out")
    assert run.summary["stop_reason"] == "killed"
    table = pd.read_parquet(tmp_path / "out" / "signals.parquet")
    for times in (run.signals.index.to_numpy(), table["time"].to_numpy()):
        assert times[-1] >= 1.9
        np.testing.assert_allclose(np.diff(times), 0.02, atol=1e-9)
    assert run.units["ego.vx"] == "m/s"
    again = simulate(mir.load_diagram(str(tmp_path / "out" / "spec.yaml")), duration=1.0)
    np.testing.assert_array_equal(again["ego.vx"], run["ego.vx"].loc[:1.0001])


def test_ctrl_c_while_building_leaves_nothing(tmp_path: Path) -> None:
    code = "import mirdrake.assembly.diagram as d, signal\n"
    code += "def stop(*a, **k): signal.raise_signal(signal.SIGINT)\n"
    code += "d.make_plant = stop\nfrom mirdrake.cli import main\nraise SystemExit(main(['run', 'bolt_test_track']))\n"
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (130, "interrupted\n")
    assert list(tmp_path.iterdir()) == []


@pytest.fixture
def faulty_drive(tmp_path: Path) -> Path:
    """Return a diagram file with a block in the steering line that fails after 0.8 s."""
    (tmp_path / "own_faulty.py").write_text(OWN, encoding="utf-8")
    (tmp_path / "faulty.yaml").write_text(FAULTY_DRIVE, encoding="utf-8")
    return tmp_path / "faulty.yaml"


def test_a_block_that_raises_ends_the_run_with_its_own_file_and_line(
    faulty_drive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["run", faulty_drive.name, "--out", "out"]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert err.startswith("error: out: the run failed at t = 0.8")
    assert "own_faulty.py:17: ZeroDivisionError: no more ideas" in err
    run = load_run(tmp_path / "out")
    assert "ZeroDivisionError" in run.stop.detail
    assert run.signals.index[-1] >= 0.75
    assert run.events[-1]["kind"] == "failure"
    assert main(["run", faulty_drive.name, "--out", "out"]) == 2
    assert capsys.readouterr().err.startswith("error: out: holds a failed run, which can be deleted")


def test_a_number_of_an_own_block_is_not_text(
    faulty_drive: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(faulty_drive.parent)
    faulty_drive.write_text(FAULTY_DRIVE.replace("at: 0.8", "at: 0.8 s"), encoding="utf-8")
    assert main(["check", "--trust", faulty_drive.name]) == 2
    err = capsys.readouterr().err
    assert err == "error: faulty.yaml:5: systems.faulty.at is text '0.8 s'; Faulty takes a number, in SI units\n"


@pytest.mark.parametrize(
    ("argument", "is_number"),
    [
        ("value=1.5", True),
        ("value: float", True),
        ("value: 'float | None' = None", True),
        ("value: float | None = None", True),
        ("value: typing.Optional[int] = 3", True),
        ("value=True", False),
        ("value='fast'", False),
        ("value: float | str = 1.5", False),
        ("value: list[float] = ()", False),
        ("value: typing.Any = 1.5", False),
        ("value", False),
    ],
)
def test_the_annotation_or_else_the_default_makes_a_parameter_a_number(
    argument: str, is_number: bool, tmp_path: Path
) -> None:
    text = f"""\
        import typing
        from pydrake.systems.framework import LeafSystem
        class Block(LeafSystem):
            def __init__(self, {argument}):
                super().__init__()
        """
    (tmp_path / "numeric_block.py").write_text(dedent(text), encoding="utf-8")

    def make() -> object:
        return make_user_system("numeric_block:Block", {"value": "2 m"}, where="a.yaml:1: systems.b", folder=tmp_path)

    if is_number:
        with pytest.raises(ConfigError, match=r"^a.yaml:1: systems.b: value is text '2 m'; Block takes a number"):
            make()
    else:
        make()


@pytest.mark.parametrize("how", ["SystemExit", "GeneratorExit", "own"])
def test_whatever_a_block_raises_is_one_line_even_what_is_no_exception_of_python(
    how: str, faulty_drive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["run", faulty_drive.name, "--out", "out", "--set", f"systems.faulty.how={how}"]) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert err.startswith("error: out: the run failed at t = 0.8")
    assert f"{'Own' if how == 'own' else how}: enough" in err
    assert load_run(tmp_path / "out").events[-1]["kind"] == "failure"


@pytest.mark.parametrize("what", ["SystemExit()", "GeneratorExit()", "type('Own', (BaseException,), {})()"])
def test_whatever_a_module_raises_on_import_names_the_module(what: str, tmp_path: Path) -> None:
    (tmp_path / "leaving_module.py").write_text(f"raise {what}\n", encoding="utf-8")
    with pytest.raises(ConfigError, match="module 'leaving_module' fails on import"):
        import_user_module("leaving_module", folder=tmp_path)


def test_a_misspelt_module_is_reported_with_its_neighbour_and_the_folder(
    faulty_drive: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(faulty_drive.parent.parent)
    with pytest.raises(ConfigError) as caught:
        import_user_module("own_fauty", folder=faulty_drive.parent)
    hint = f"did you mean 'own_faulty'? (searched: {faulty_drive.parent.name}, ., and the import path of Python)"
    assert str(caught.value) == f"module 'own_fauty' cannot be imported: No module named 'own_fauty'; {hint}"


def test_a_nan_in_the_steering_ends_the_run_with_a_reason(
    faulty_drive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["run", faulty_drive.name, "--out", "out", "--set", "systems.faulty.how=nan"]) == 1
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert err.startswith("error: out: the run diverged: faulty.y is nan at t = 0.8 s; ")
    run = load_run(tmp_path / "out")
    assert str(run.stop) == "diverged: faulty.y is nan at t = 0.8 s"
    assert run["ego.vx"].notna().all()  # the dead-man does not take it for a command


def test_a_nan_of_an_own_driver_ends_the_run_with_a_reason(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    driver = """\
        from math import nan

        from pydrake.systems.framework import LeafSystem


        class Mistaken(LeafSystem):
            def __init__(self):
                super().__init__()
                self.DeclareVectorOutputPort("command", 3, self._calc)

            def _calc(self, context, output):
                time = context.get_time()
                output.SetFromVector([2.0, nan if time > 0.2 else 0.1, time])
        """
    (tmp_path / "own_driver.py").write_text(dedent(driver), encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    run = simulate(drive(duration=1.0, control={"ego": {"kind": "own_driver:Mistaken"}}), folder=tmp_path / "out")
    assert run.diverged
    assert run.stop.detail.startswith("ego.steering_command is nan at t = 0.2")


def test_a_solver_that_fails_is_a_divergence_and_the_folder_is_finished(tmp_path: Path) -> None:
    # On the plane, as uneven ground needs no solver.
    simulation = Simulation(assemble(drive(duration=1.0, world="random_track")))
    plant = simulation.assembly.parts.plant

    def too_fast(context: Any) -> None:
        mine = plant.GetMyMutableContextFromRoot(context)
        velocities = np.full(plant.num_velocities(), 1e160)
        first = simulation.assembly.parts.vehicles["ego"].base.floating_velocities_start_in_v()
        velocities[first : first + 6] = 0.0  # the place on the track stays finite
        plant.SetVelocities(mine, velocities)

    run = simulation.run(folder=tmp_path / "out", change=too_fast)
    assert run.diverged
    assert run.stop.detail.startswith("the solver failed: ")
    assert load_run(tmp_path / "out").stop == run.stop


def test_a_failed_run_raises_in_python_too(faulty_drive: Path, tmp_path: Path) -> None:
    with pytest.raises(RunError, match=r"own_faulty\.py:17: ZeroDivisionError"):
        simulate(str(faulty_drive))


def test_the_handlers_of_signals_are_as_before_a_run() -> None:
    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    simulate(drive(duration=0.1))
    assert [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)] == before


def test_a_half_written_event_is_ignored(tmp_path: Path) -> None:
    writer = RunWriter(tmp_path / "run", {"world": "empty"})
    writer.write_event({"time": 1.0, "kind": "stop", "text": "here"})
    with (tmp_path / "run" / "events.jsonl").open("a", encoding="utf-8") as file:
        file.write('{"time": 2.0, "ki')
    assert load_run(tmp_path / "run").events == [{"time": 1.0, "kind": "stop", "text": "here"}]


def test_a_folder_without_a_run_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="not a run folder"):
        load_run(tmp_path)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_full_disk_is_one_line(tmp_path: Path) -> None:
    writer = RunWriter(tmp_path / "run", {"world": "empty"})
    os.symlink("/dev/full", tmp_path / "run" / "events.jsonl")
    with pytest.raises(RunError, match=r"events\.jsonl: cannot be written: No space left"):
        writer.write_event({"time": 1.0, "kind": "stop", "text": "here"})


def test_the_figures_of_a_drive_cover_its_time():
    """10 s at 10 m/s are 100 m, with 101 samples, as both ends have one."""
    times = np.linspace(0.0, 10.0, 101)
    vx, wheels = np.full(101, -10.0), np.full(101, 3.0)
    figures = drive_figures(times, {"vx": vx, "wheels_on_road": wheels})
    assert (figures["distance_m"], figures["off_road_s"], figures["max_speed_mps"]) == (100.0, 10.0, 10.0)
    accelerated = drive_figures(times, {"vx": 2.0 * times, "wheels_on_road": np.where(times < 9.95, 4.0, 3.0)})
    assert (accelerated["distance_m"], accelerated["off_road_s"]) == (100.0, 0.05)


def test_figures_that_are_not_finite_are_none():
    """NaN is no JSON."""
    times = np.linspace(0.0, 1.0, 11)
    vx = np.where(times < 0.5, 1.0, np.nan)
    figures = drive_figures(times, {"vx": vx, "lateral_error": vx, "lap": vx, "speed_command": vx})
    assert set(figures.values()) == {None}


def test_the_samples_of_vehicles_and_actors_are_equally_many_after_a_kill(tmp_path: Path) -> None:
    """The tables are written one after the other; here the kill comes between the two."""
    writer = RunWriter(tmp_path / "run", {"name": "drive"})
    units = {"time": "s", "ego.vx": "m/s", "actors.lead.x": "m"}
    for start in (0.0, 3.0):
        times = start + np.arange(3.0)
        writer.write_signals(times, {"ego.vx": times, "actors.lead.x": 2.0 * times}, units)
        writer._signals.flush()
        if start == 0.0:
            writer._actors.flush()
    run = load_run(tmp_path / "run")
    assert run.signals.index.tolist() == run.actors.index.tolist() == [0.0, 1.0, 2.0]
    assert run.actors["lead.x"].tolist() == [0.0, 2.0, 4.0]
    assert run.summary["simulated_s"] == 2.0


def test_a_wheel_that_slips_to_and_fro_is_a_finding() -> None:
    """A sine of 20 rad/s at 4 Hz about 8 rad/s from 5 to 15 s, while the vehicle drives 1 m/s."""
    times = np.asarray(0.02 * np.arange(1001), dtype=np.float64)
    vx = 1.0 + 0.02 * np.sin(8.0 * np.pi * times)
    swinging = np.where((times >= 5.0) & (times <= 15.0), 20.0 * np.sin(8.0 * np.pi * times), 0.0)
    wheels = {"front left": 8.0 * vx, "rear left": 8.0 + swinging}
    found = find_wheel_oscillation(times, wheels, vx)
    assert found is not None
    assert found["wheel"] == "rear left"
    assert found["from_s"] == pytest.approx(5.0, abs=0.6)
    assert found["duration_s"] == pytest.approx(10.0, abs=1.0)
    assert (found["frequency_hz"], found["amplitude_radps"], found["speed_radps"]) == pytest.approx(
        (4.0, 20.0, 8.0), rel=0.1
    )
    (line,) = describe_findings({"vehicles": {"ego": {"wheel_oscillation": found}}})
    assert line.startswith("ego: the rear left wheel oscillates at 4 Hz, by ")
    # A vehicle that brakes and accelerates with its wheels, a short slide, or a slow change are none.
    assert find_wheel_oscillation(times, {"front left": 8.0 + swinging}, 1.0 + swinging / 8.0) is None
    assert find_wheel_oscillation(times, {"front left": 8.0 + np.where(times < 7.0, swinging, 0.0)}, vx) is None
    assert find_wheel_oscillation(times, {"front left": 8.0 + 6.0 * np.sin(0.5 * times)}, vx) is None


def test_a_speed_that_is_far_from_its_set_point_for_long_is_a_finding() -> None:
    """1.3 m/s below 2 m/s from 4 to 28 s; before, 3 s of the same are too short."""
    times = np.asarray(0.1 * np.arange(301), dtype=np.float64)
    setpoint = np.full(times.shape, 2.0)
    vx = np.where(((times > 0.45) & (times < 3.45)) | ((times > 3.95) & (times < 28.05)), 0.7, 1.9)
    missed = missed_speed(times, setpoint, vx)
    assert missed == pytest.approx({"from_s": 4.0, "duration_s": 24.0, "error_mps": 1.3})
    lines = describe_findings({"vehicles": {"ego": {"speed_missed": missed}}})
    assert lines == ["ego: speed is 1.3 m/s away from its set-point for 24 s, from t = 4 s on"]
    assert missed_speed(times, setpoint, np.full(times.shape, 1.9)) is None
    assert missed_speed(times, setpoint, np.where(times < 4.0, 0.7, 1.9)) is None
