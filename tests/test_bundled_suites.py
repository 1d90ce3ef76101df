"""The bundled worlds' own tests: a good driver passes each, a bad one fails it."""

from dataclasses import replace
from pathlib import Path

import pytest

from mirdrake.core.paths import data_root, names
from mirdrake.report.suite import render_suite
from mirdrake.suites import Case, Suite, collect_cases
from mirdrake.suites.worker import run_case

FIRST = reversed(collect_cases(names("worlds")))  # so that the first variation of each test is the one that stays
CASES = {f"{case.world}:{case.test}": case for case in FIRST}
BAD = {
    "circle": {"kind": "constant", "speed": 5.0, "steering": 0.1},  # too wide
    "stops_before_the_pedestrian": {"kind": "blind", "speed": 3.0},
    "moving": {"kind": "constant", "speed": 14.0},
    "braking": {"kind": "constant", "speed": 13.9},
    "adult": {"kind": "constant", "speed": 5.56},
    "running_child": {"kind": "constant", "speed": 4.17},
    "child_from_behind_parked_cars": {"kind": "constant", "speed": 4.17},
    "cut_in": {"kind": "constant", "speed": 13.9},
    "cut_out": {"kind": "constant", "speed": 8.33},
    "yields": {"kind": "path_tracking", "track": "main", "speed": 8.0},
    "obeys": {"kind": "traffic", "track": "main", "speed": 12.5, "obeys_lights": False},
}
BLIND = {"kind": "blind", "speed": 8.0}


FAST_GOOD = {"stops_before_the_pedestrian", "circle"}
FAST_BAD = {"circle"}


def marked(fast):
    """Return all cases as parameters; those not named are slow."""
    return [
        pytest.param(key, id=CASES[key].test, marks=[] if CASES[key].test in fast else [pytest.mark.slow])
        for key in sorted(CASES)
    ]


def test_every_bundled_world_has_a_test():
    assert {case.world for case in CASES.values()} == {case.world for case in collect_cases(names("worlds"))}
    assert len({case.world for case in CASES.values()}) == len(names("worlds"))


def test_the_page_and_the_command_name_a_shipped_world(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    cases = tuple(CASES[key] for key in sorted(CASES) if Path(CASES[key].world).stem == "parking_lot")
    assert cases[0].command.startswith("mirdrake world test parking_lot --case ")
    page = render_suite(Suite(cases, ()))
    assert ">parking_lot</p>" in page
    assert str(data_root()) not in page


@pytest.mark.essential
@pytest.mark.parametrize("key", marked(FAST_GOOD))
def test_a_good_driver_passes(key):
    result = run_case(CASES[key])
    assert result.verdict == "pass", result.reason


@pytest.mark.parametrize("key", marked(FAST_BAD))
def test_a_bad_driver_fails(key):
    result = run_case(with_driver(CASES[key], BAD.get(CASES[key].test, BLIND)))
    assert result.verdict == "fail", result.reason
    assert result.margin < 0.0


def with_driver(case: Case, driver: dict[str, object]) -> Case:
    return replace(case, diagram=case.diagram | {"control": {"ego": driver}})
