"""Suites: independence of cases, resuming, ranking, search, reports."""

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from textwrap import dedent

import pytest

from mirdrake.assembly.diagram_spec import DiagramSpec, make_spec
from mirdrake.assembly.inputs import input_digest
from mirdrake.assembly.scene import load_vehicle_of
from mirdrake.core.errors import RunError
from mirdrake.core.paths import find
from mirdrake.runs.logs import load_run
from mirdrake.suites import Case, Result, Suite, load_suite, run_suite, vary, worker
from mirdrake.suites.cases import Judgement
from mirdrake.vehicles import Vehicle
from mirdrake.worlds import load_world

EMPTY = str(find("worlds", "empty").resolve())

BOMBS = dedent(
    """
    import math, os, sys, time
    from pydrake.geometry import SurfaceTriangle, TriangleSurfaceMesh
    from pydrake.systems.framework import LeafSystem

    class Bomb(LeafSystem):
        def __init__(self, what):
            super().__init__()
            self._what = what
            self.DeclareVectorOutputPort("command", 3, self._command)

        def _command(self, context, output):
            speed = 5.0
            if context.get_time() > 0.1:
                if self._what == "abort":
                    os.abort()
                if self._what == "leave":
                    os._exit(3)
                if self._what == "exit":
                    sys.exit("enough")
                if self._what == "geometry":
                    mesh = TriangleSurfaceMesh([SurfaceTriangle(0, 1, 2)], [[0, 0, 0], [1, 0, 0], [0, 1, 0]])
                    mesh.element(7)
                if self._what == "raise":
                    raise ValueError("no way")
                if self._what == "nan":
                    speed = math.nan
                if self._what == "hang":
                    while True:
                        time.sleep(0.01)
            output.SetFromVector([speed, 0.0, context.get_time()])
    """
)


def _case(number: int, *, speed: float = 5.0, expect: tuple[str, ...] = ("always speed < 12 m/s",), **more) -> Case:
    """Return a Bolt that drives straight ahead in an empty world."""
    diagram = {
        "name": "straight",
        "world": EMPTY,
        "vehicles": {"ego": {"model": "bolt", "speed": speed}},
        "control": {"ego": {"kind": "constant", "speed": speed}},
        "plant": {"contact": "point"},
        "record": {"meshcat": False, "report": False},
        "duration": 0.5,
        "seed": 0,
    } | more
    places = tuple((text, f"lot.yaml:9: tests.0.expect.{index}") for index, text in enumerate(expect))
    return Case(f"straight#{number}", "straight", EMPTY, {"seed": number}, diagram, places)


def _bomb(number: int, what: str, folder: Path) -> Case:
    (folder / "bombs.py").write_text(BOMBS)
    return _case(number, control={"ego": {"kind": "bombs:Bomb", "what": what}}, folder=str(folder))


BOMB_REASONS = {
    "abort": "the process was ended by SIGABRT: Fatal Python error: Aborted",
    "exit": "SystemExit: enough",
    "raise": "bombs.py:25: ValueError: no way",
    "hang": "no end after 4 s of wall time; it was in _command of",
    "leave": "the process ended with exit code 3",
    "geometry": ": Failure at ",  # Drake aborts; later versions end the process with SystemExit
    "nan": "the run diverged: ego.speed_command is nan at t = 0.12 s",
}


@pytest.fixture(scope="module")
def damaged(tmp_path_factory: pytest.TempPathFactory) -> Suite:
    """Return the result of a suite with many failing cases."""
    folder = tmp_path_factory.mktemp("suite")
    cases = [
        _case(1),
        _case(3, speed=20.0, expect=("always speed < 12 m/s", "never speed < 1 m/s", "never collision")),
        *(_bomb(20 + number, what, folder) for number, what in enumerate(BOMB_REASONS)),
        _case(7, expect=("always bomb.y < 1",)),
        _case(10, speed=11.0),
    ]
    return run_suite(cases, workers=2, folder=folder / "out", timeout=4.0)


def test_a_failing_case_does_not_affect_the_others(damaged: Suite) -> None:
    assert damaged.complete
    verdicts = [result.verdict for result in damaged.results]
    assert verdicts == ["pass", "fail", *["error"] * len(BOMB_REASONS), "error", "pass"]
    for result, expected in zip(damaged.results[2:], [*BOMB_REASONS.values(), "no signal 'bomb.y'"], strict=False):
        assert expected in result.reason
        assert len(result.reason.splitlines()) == 1
    assert "triangle_surface_mesh.h" in damaged.results[7].reason
    assert damaged.exit_code == 2
    assert damaged.counts == {"pass": 2, "fail": 1, "error": 8, "invalid": 0}


def test_the_worst_comes_first(damaged: Suite) -> None:
    ranked = [(result.verdict, result.margin) for _, result in damaged.ranked()]
    assert [verdict for verdict, _ in ranked] == ["error"] * 8 + ["fail", "pass", "pass"]
    assert ranked[8][1] == pytest.approx(-8.0, abs=0.1)
    assert ranked[9][1] == pytest.approx(1.0, abs=0.1)
    worst = damaged.results[1].worst
    assert worst is not None
    assert worst.text == "always speed < 12 m/s"


def test_cases_that_did_not_pass_leave_a_run_folder(damaged: Suite) -> None:
    assert damaged.folder is not None
    kept = sorted(path.name for path in (damaged.folder / "cases").iterdir())
    assert kept == sorted(case.slug for case, result in damaged.ranked() if result.verdict != "pass")
    for result in damaged.results:
        assert result.folder == (None if result.verdict == "pass" else f"cases/{result.name.replace('#', '-')}")
    assert len(load_run(damaged.folder / "cases" / "straight-3").signals) > 20
    traces = {path.stem for path in (damaged.folder / "traces").iterdir()}
    assert traces >= {"straight-1", "straight-3", "straight-10", "straight-22"}  # also of a behaviour that raised


def test_a_run_that_passed_is_kept_on_request(tmp_path: Path) -> None:
    suite = run_suite([_case(1)], folder=tmp_path / "out", keep_all=True)
    assert suite.results[0].verdict == "pass"
    assert suite.results[0].folder == "cases/straight-1"
    assert len(load_run(tmp_path / "out" / "cases" / "straight-1").signals) > 20


def test_a_killed_suite_is_resumed(damaged: Suite, tmp_path: Path) -> None:
    assert damaged.folder is not None
    lines = (damaged.folder / "results.jsonl").read_text().splitlines(keepends=True)
    assert [json.loads(line)["name"] for line in lines] == [case.name for case in damaged.cases]
    assert load_suite(damaged.folder).results == damaged.results

    whole = [case for case in damaged.cases if case.name in {"straight#1", "straight#3", "straight#10"}]
    kept = [line for line in lines if '"straight#3"' in line]
    folder = tmp_path / "out"
    folder.mkdir()
    (folder / "results.jsonl").write_text(kept[0] + '{"name": "straight#1", "verd')  # cut off by the kill
    reports: list[str] = []
    suite = run_suite(
        whole,
        folder=folder,
        resume=True,
        progress=lambda done, total, result: reports.append(f"{result.name} {done}/{total}"),
    )
    assert reports == ["straight#1 2/3", "straight#10 3/3"]
    for name, result in zip(("straight#1", "straight#3", "straight#10"), suite.results, strict=True):
        before = next(other for other in damaged.results if other.name == name)
        assert replace(result, wall=0.0) == replace(before, wall=0.0)
    with pytest.raises(RunError, match="not empty"):
        run_suite(whole, folder=folder)


def test_a_case_that_changed_is_run_again(damaged: Suite, tmp_path: Path) -> None:
    assert damaged.folder is not None
    case = damaged.cases[0]
    assert case.digest() == _case(1).digest()
    assert vary(case, {"seed": 5}).digest() != case.digest()
    assert vary(case, {"seed": -5}).diagram["seed"] == 0


def test_ctrl_c_leaves_what_is_done(tmp_path: Path) -> None:
    def stop(done: int, total: int, result: Result) -> None:
        raise KeyboardInterrupt

    suite = run_suite([_case(1), _case(2)], folder=tmp_path / "out", progress=stop)
    assert [result.name for result in suite.results] == ["straight#1"]
    assert not suite.complete
    assert load_suite(tmp_path / "out").results == suite.results


def test_a_script_needs_no_guard_and_its_workers_end_with_it(tmp_path: Path) -> None:
    script = tmp_path / "study.py"
    (tmp_path / "bombs.py").write_text(BOMBS)
    case = _bomb(1, "hang", tmp_path)
    script.write_text(
        "from mirdrake.suites import Case, run_suite\n"
        f"case = {case!r}\n"
        "print('begin', flush=True)\n"
        "print(run_suite([case], timeout=1.0).results[0].reason, flush=True)\n"
        "import os\n"
        "from mirdrake.studies import Workers\n"
        "print(Workers(1, limit=60.0).submit(os.getpid).result(), flush=True)\n"
        "os.kill(os.getpid(), 9)\n"
    )
    done = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, timeout=60, check=False)
    lines = done.stdout.splitlines()
    assert lines[0] == "begin"
    assert "no end after 1 s" in lines[1]
    assert len(lines) == 3
    for _ in range(100):
        try:
            os.kill(int(lines[2]), 0)
        except ProcessLookupError:
            break
        time.sleep(0.05)
    else:
        os.kill(int(lines[2]), signal.SIGKILL)
        pytest.fail("the worker outlived its parent")


def test_margins_of_different_units_are_compared_by_their_shares() -> None:
    """A car that has stopped has at most 0.05 m/s of margin; that is not worse than 0.2 m of the 0.5 m asked for."""

    def finding(text: str, margin: float, unit: str, scale: float) -> Judgement:
        return Judgement(text, True, margin, unit, margin / scale, worst_time=1.0, decided_by="vx")

    stopped, near = finding("at end stopped", 0.05, "m/s", 0.05), finding("always clearance > 0.5 m", 0.2, "m", 0.5)
    slow, far = finding("eventually stopped", 0.04, "m/s", 0.05), finding("always clearance > 0.5 m", 3.0, "m", 0.5)
    tight, wide = Result("tight", "pass", findings=(stopped, near)), Result("wide", "pass", findings=(slow, far))
    assert tight.worst == near
    assert wide.worst == slow
    assert sorted((wide, tight), key=lambda result: result.place) == [tight, wide]
    assert tight.margin == 0.2
    assert tight.share == pytest.approx(0.4)


def test_variations_load_their_vehicles_once_and_cannot_change_them(monkeypatch: pytest.MonkeyPatch) -> None:
    loaded: list[str] = []

    def load(spec: DiagramSpec, name: str) -> Vehicle:
        loaded.append(name)
        return load_vehicle_of(spec, name)

    monkeypatch.setattr(worker, "load_vehicle_of", load)
    case = replace(_case(1), content=f"this test {time.time_ns()}")
    spec = make_spec(case.diagram)
    first = worker._vehicles_of(case, spec)["ego"]
    first.control.rate = 1.0
    again = worker._vehicles_of(replace(case, values={"seed": 2}), spec)["ego"]
    assert loaded == ["ego"]
    assert again == load_vehicle_of(spec, "ego")
    # Other files, or files whose state is not known, are read again.
    worker._vehicles_of(replace(case, content="other files"), spec)
    worker._vehicles_of(replace(case, content=""), spec)
    assert loaded == ["ego"] * 3


def test_the_digest_of_the_inputs_changes_with_each_file(tmp_path: Path) -> None:
    files = {
        "world.yaml": "mirdrake: world/1\nground: {size: [200, 200], relief: [{grid: {file: hills.csv, cell: 10 m}}]}\n"
        "tracks: {main: {csv: main.csv}}\n",
        "hills.csv": "0,0\n0,1\n",
        "main.csv": "x_m,y_m,w_tr_right_m,w_tr_left_m\n0,0,2,2\n10,0,2,2\n20,1,2,2\n30,0,2,2\n",
        "cars/one/main.urdf.xacro": "first",
        "cars/two/tyres/front.tir": "second",
        "drivers/own.py": "third",
    }
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)

    def current() -> str:
        world = load_world(str(tmp_path / "world.yaml"))
        cars = [tmp_path / "cars" / "one", tmp_path / "cars" / "two"]
        return input_digest(world, cars, {"ego": {"kind": "drivers.own:Driver"}}, tmp_path)

    first = current()
    assert current() == first
    for name, text in files.items():
        (tmp_path / name).write_text(text.replace("0,1", "0,2").replace("30,0", "31,0") + "\n")
        assert current() != first, name
        (tmp_path / name).write_text(text)
    assert current() == first
