"""``mirdrake world test`` and ``mirdrake world search``: exit codes, tables, files, kills, resuming, workers."""

import argparse
import io
import json
import os
import re
import signal
import subprocess
import sys
import time
import xml.etree.ElementTree as ElementTree
from contextlib import redirect_stdout
from pathlib import Path
from textwrap import dedent
from typing import Any

import numpy as np
import pytest

from mirdrake.cli import world_search, world_test
from mirdrake.core.errors import ConfigError, RunError
from mirdrake.runs.logs import load_run
from mirdrake.suites import collect_cases, load_suite

WORLD = dedent(
    """
    mirdrake: world/1
    params: {speed: 4, blocks: 2, what: 0}
    ground: {size: [200, 200]}
    start: {here: {at: [-30, 0], speed: $speed}}
    goals: {exit: {at: [0, 0], radius: 3}}
    props:
      - {box: [1, 1, 1], name: block, scatter: {region: {rect: {center: [40, 0], size: [6, 6]}}, count: $blocks}}
    rules: [{min_gap: 0.3}]
    tests:
      - name: cruise
        behaviour: {kind: constant, speed: $speed}
        goal: exit
        duration: 1 s
        variations: {speed: [2, 6, 4]}
        expect: [always speed < 4.5 m/s, never collision]
        search: {over: {speed: [1, 9]}, budget: 6}
      - name: crowded
        behaviour: {kind: blind, speed: 4}
        duration: 0.5 s
        variations: {blocks: [2, 60]}
        expect: [never collision]
      - name: own
        behaviour: {kind: "drivers:Own", what: $what}
        duration: 0.5 s
        variations: {what: [0, 1, 2]}
        expect: [never collision]
    """
)

DRIVERS = dedent(
    """
    import os
    from pydrake.systems.framework import LeafSystem

    class Own(LeafSystem):
        def __init__(self, what):
            super().__init__()
            self._what = what
            self.DeclareVectorOutputPort("command", 3, self._command)

        def _command(self, context, output):
            if self._what == 1 and context.get_time() > 0.1:
                raise ValueError("no path was found")
            if self._what == 2 and context.get_time() > 0.1:
                os._exit(4)
            output.SetFromVector([4.0, 0.0, context.get_time()])
    """
)

SCRIPT = dedent(
    """
    import sys
    from test_suites_cli import test
    sys.exit(test(*sys.argv[1:]))
    """
)


def _call(module: Any, *arguments: object) -> int:
    parser = argparse.ArgumentParser()
    module.add_arguments(parser)
    return int(module.run(parser.parse_args([str(argument) for argument in arguments])))


def test(*arguments: object) -> int:
    """``mirdrake world test``."""
    return _call(world_test, *arguments)


test.__test__ = False  # type: ignore[attr-defined]


def _begin(*arguments: object) -> subprocess.Popen[str]:
    """``mirdrake world test`` as a process that leads a group of its own."""
    return subprocess.Popen(
        [sys.executable, "-c", SCRIPT, *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        env=os.environ | {"PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *filter(None, sys.path)])},
    )


def _wait_for_results(folder: Path, number: int, process: subprocess.Popen[str]) -> None:
    file = folder / "results.jsonl"
    for _ in range(6000):  # five minutes: the machine may be busy
        if file.is_file() and len(file.read_text().splitlines()) >= number:
            return
        assert process.poll() is None, process.communicate()
        time.sleep(0.05)
    pytest.fail("the suite does not get on")


def _results(folder: Path) -> list[dict[str, Any]]:
    """results.jsonl without the computing times."""
    lines = (folder / "results.jsonl").read_text().splitlines()
    return [{key: value for key, value in json.loads(line).items() if key != "wall"} for line in lines]


def _world(folder: Path, text: str = WORLD) -> Path:
    (folder / "drivers.py").write_text(DRIVERS)
    path = folder / "lot.yaml"
    path.write_text(text)
    return path


@pytest.fixture(scope="module")
def lot(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The world file."""
    return _world(tmp_path_factory.mktemp("lot"))


@pytest.fixture(scope="module")
def printed(lot: Path) -> list[str]:
    """Return the output of an uninterrupted suite."""
    with redirect_stdout(io.StringIO()) as text:
        assert test(lot, "-j", 2, "--out", lot.parent / "done") == 2
    return text.getvalue().splitlines()


@pytest.fixture(scope="module")
def done(lot: Path, printed: list[str]) -> Path:
    """Return the folder of that suite."""
    assert printed
    return lot.parent / "done"


# --- what is printed and written -----------------------------------------------------------------------------------


@pytest.mark.essential
def test_the_verdicts_follow_the_requirements_of_the_file(done: Path) -> None:
    verdicts = {result["name"]: result["verdict"] for result in _results(done)}
    assert verdicts == {
        "cruise#1": "pass", "cruise#2": "fail", "cruise#3": "pass", "crowded#1": "pass", "crowded#2": "invalid",
        "own#1": "pass", "own#2": "error", "own#3": "error",
    }  # fmt: skip
    reasons = {result["name"]: result["reason"] for result in _results(done)}
    assert "no free position for 'block" in reasons["crowded#2"]
    assert reasons["own#2"].startswith("the run failed at t = 0.1")
    assert reasons["own#2"].endswith("ValueError: no path was found")
    assert reasons["own#3"] == "the process ended with exit code 4"
    assert re.fullmatch(r"always speed < 4.5 m/s: margin -1.\d+ m/s at \d.\d\d s", reasons["cruise#2"])


def test_the_report_shows_every_case_and_its_links_lead_somewhere(done: Path) -> None:
    page = (done / "report.html").read_text(encoding="utf-8")
    assert "4 of 8 cases passed; 1 failed, 2 could not be evaluated, 1 invalid" in page
    for name in ("cruise-1", "cruise-2", "crowded-2", "own-3"):
        assert f'id="case-{name}"' in page
    links = re.findall(r'href="([^"#][^"]*)"', page)
    assert {"cases/cruise-2/recording.html", "cases/cruise-2/report.html"} <= set(links)
    for link in links:
        assert link.startswith("data:") or (done / link).exists()
    assert not re.search(r'(src|href)="https?:|url\(', page)
    assert page.count('<svg class="plot map"') == 8
    # A driven line in each but those whose world is invalid, or whose process ended.
    assert page.count('stroke="var(--main)" stroke-width="2.2"') == 6
    assert page.count('aria-label="Margin over time') == 8
    # The speed of each case that was judged.
    assert page.count('aria-label="Speed over time [m/s]."') == 5


def test_the_junit_file_counts_the_same(done: Path) -> None:
    suite = ElementTree.parse(done / "junit.xml").getroot().find("testsuite")
    assert suite is not None
    assert {key: suite.get(key) for key in ("name", "tests", "failures", "errors")} == {
        "name": "lot", "tests": "8", "failures": "1", "errors": "3",
    }  # fmt: skip


def test_only_cases_that_did_not_pass_are_kept_and_recorded(done: Path) -> None:
    assert sorted(path.name for path in (done / "cases").iterdir()) == ["cruise-2", "own-2", "own-3"]
    assert (done / "cases" / "cruise-2" / "recording.html").stat().st_size > 1e6
    assert (done / "cases" / "cruise-2" / "report.html").stat().st_size > 1e4
    assert len(load_run(done / "cases" / "cruise-2").signals) == 51
    times, speeds = (json.loads((done / "traces" / "cruise-2.json").read_text())[key] for key in ("times", "speeds"))
    assert (times[0], times[-1]) == (0.0, 1.0)
    signals = load_run(done / "cases" / "cruise-2").signals
    driven = np.hypot(signals["ego.vx"], signals["ego.vy"])
    assert speeds == pytest.approx(np.interp(times, signals.index, driven), rel=1e-3)


def test_the_table_has_the_worst_first_with_signed_margins(printed: list[str]) -> None:
    rows = [re.split("  +", line, maxsplit=4) for line in printed[:9]]
    assert rows[0] == ["verdict", "case", "values", "margin", "requirement that decides, or reason"]
    assert [row[1] for row in rows[1:4]] == ["own#2", "own#3", "crowded#2"]
    assert rows[2] == ["error", "own#3", "what=2", "-", "the process ended with exit code 4"]
    assert rows[4][:3] == ["fail", "cruise#2", "speed=6"]
    assert re.fullmatch(r"-1\.\d+ m/s", rows[4][3])
    assert re.fullmatch(r"always speed < 4.5 m/s \(at \d\.\d\d s of the run\)", rows[4][4])
    assert rows[5][:4] == ["pass", "cruise#3", "speed=4", "+0.5 m/s"]
    assert printed[9].startswith("8 cases: 4 pass, 1 fail, 2 error, 1 invalid (")
    assert printed[-1].endswith("lot.yaml --case own#2")


def test_one_case_is_replayed_with_other_values_and_a_recording_even_if_it_passes(lot: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert test(lot, "--case", "cruise", "-p", "speed=3.25", "--out", out, "--quiet") == 0
    folder = out / "cases" / "cruise-1"
    assert {"recording.html", "report.html", "signals.parquet", "spec.yaml"} <= {path.name for path in folder.iterdir()}
    (case,) = load_suite(out).cases
    assert case.values == {"speed": 3.25}
    assert case.command.endswith("lot.yaml --case cruise -p speed=3.25")
    assert _results(out)[0]["findings"][0]["margin"] == pytest.approx(4.5 - 3.25, abs=0.1)


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["--case", "cruse"], "unknown case 'cruse'; did you mean 'cruise'"),
        (["--resume"], "--resume: give the folder to continue with --out"),
        (["-p", "sped=3"], "unknown parameter 'sped'"),
        (["-p", "blocks=many"], "lot.yaml:8: props.0.scatter.count: 'many' is not a number"),
    ],
)
def test_wrong_arguments_are_reported_before_anything_runs(lot: Path, arguments, expected) -> None:
    with pytest.raises(ConfigError) as caught:
        test(lot, *arguments)
    assert expected in str(caught.value)


@pytest.mark.parametrize("text", ["speed", "speed=", "=3", "speed=[1, 2]", "seed=1.5", "speed=true", "speed={"])
def test_a_value_is_a_name_and_a_number_or_word(lot: Path, text, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        test(lot, "-p", text)
    assert caught.value.code == 2
    assert "is not allowed" in capsys.readouterr().err


def test_faults_of_a_file_are_reported_with_their_lines(tmp_path: Path) -> None:
    path = _world(tmp_path, WORLD.replace("never collision]\n    search", "never colision]\n    search"))
    with pytest.raises(ConfigError, match=r"lot.yaml:16: tests.0.expect.1: 'never colision' is not a requirement"):
        test(path)


def test_a_folder_of_something_else_is_left_alone(lot: Path, tmp_path: Path) -> None:
    (tmp_path / "thesis.txt").write_text("mine")
    with pytest.raises(RunError, match="is not empty"):
        test(lot, "--out", tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.txt"]


# --- kills and workers ---------------------------------------------------------------------------------------------


def test_four_workers_give_the_same_as_two(lot: Path, done: Path, tmp_path: Path) -> None:
    assert test(lot, "-j", 4, "--out", tmp_path / "out", "--quiet") == 2
    assert _results(tmp_path / "out") == _results(done)


@pytest.mark.slow
def test_one_worker_gives_the_same_even_if_it_is_killed_on_the_way(lot: Path, done: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    with _begin(lot, "-j", 1, "--out", out) as process:
        _wait_for_results(out, 2, process)
        process.kill()
    before = _results(out)
    assert 2 <= len(before) < 8
    assert test(lot, "-j", 1, "--out", out, "--resume", "--quiet") == 2
    assert _results(out) == _results(done)
    assert (out / "report.html").is_file()


def test_ctrl_c_leaves_a_readable_folder_and_no_traceback(lot: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    with _begin(lot, "-j", 2, "--out", out) as process:
        _wait_for_results(out, 1, process)
        os.killpg(process.pid, signal.SIGINT)
        output, errors = process.communicate(timeout=300)
    assert process.returncode == 130
    assert "Traceback" not in errors
    assert re.search(r"interrupted: \d of 8 cases were not run; continue with --out .*out --resume", errors)
    suite = load_suite(out)
    assert 1 <= len(suite.results) < 8
    assert f"{len(suite.results)} case" in output
    assert "The suite was stopped" in (out / "report.html").read_text(encoding="utf-8")
    ElementTree.parse(out / "junit.xml")


# --- search --------------------------------------------------------------------------------------------------------


def test_a_search_finds_the_failure_and_prints_the_command_that_repeats_it(
    lot: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert _call(world_search, lot, "-j", 2, "--budget", 8) == 1
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("cruise over speed 1 .. 9: 8 runs (")
    row = re.fullmatch(r"  fail +speed=(\S+) +(-\d\S*) m/s +always speed < 4.5 m/s .*", lines[2])
    assert row is not None
    assert float(row[1]) > 8.0
    command = lines[-1].removeprefix("  repeat the worst case: mirdrake world test ").split()
    assert test(*command, "--out", tmp_path / "out", "--quiet") == 1
    worst = _results(tmp_path / "out")[0]["findings"][0]["margin"]
    assert worst == pytest.approx(float(row[2]), rel=5e-3)


def test_a_search_without_failures_reports_it(lot: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    path = _world(tmp_path, WORLD.replace("[1, 9]", "[1, 2]"))
    assert _call(world_search, path, "--budget", 2, "-j", 1) == 0
    assert "2 runs (2 pass)" in capsys.readouterr().out
    with pytest.raises(ConfigError, match="'own' has no search; these do: cruise"):
        _call(world_search, lot, "--case", "own")


def test_a_case_changes_with_the_files_it_is_made_of(tmp_path: Path) -> None:
    path = _world(tmp_path)
    before = {case.name: case.digest() for case in collect_cases([path])}
    (tmp_path / "drivers.py").write_text(DRIVERS + "\n")
    after = {case.name: case.digest() for case in collect_cases([path])}
    assert {name for name in before if before[name] != after[name]} == {"own#1", "own#2", "own#3"}


@pytest.mark.parametrize("seeds", ["[1, two]", "[[1]]", "[1.5]", "[true]"])
def test_a_seed_that_is_not_a_whole_number_is_one_line_with_its_place(tmp_path: Path, seeds: str) -> None:
    world = WORLD.replace("variations: {speed: [2, 6, 4]}", f"variations: {{seed: {seeds}}}")
    (tmp_path / "w.yaml").write_text(world)
    with pytest.raises(ConfigError) as caught:
        collect_cases([tmp_path / "w.yaml"])
    assert "w.yaml:" in str(caught.value)
    assert "seed: give whole numbers" in str(caught.value)
