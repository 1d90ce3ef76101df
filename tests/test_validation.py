"""Published figures of the real vehicles: the files, how errors are judged, the page, and the Bolt itself."""

import csv
import json
import shutil

import pytest

from mirdrake.cli import main
from mirdrake.core.errors import ConfigError, ModelError
from mirdrake.core.paths import names
from mirdrake.core.yaml_io import parse_yaml
from mirdrake.manoeuvres.base import Outcome
from mirdrake.manoeuvres.facts import find_facts
from mirdrake.manoeuvres.published import FILE, ROLES, BrakingDistance, PublishedFigures, TimeToSpeed, load_published
from mirdrake.manoeuvres.validation import (
    Comparison,
    ValidationResults,
    ValidationSettings,
    describe_validation,
    driven_name,
    format_published,
    validate_vehicle,
)
from mirdrake.report.validation import render_validation
from mirdrake.single_track import estimate_parameters
from mirdrake.vehicles import load_vehicle

SIXTY = """\
figures:
  - {quantity: time_to_speed, speed: 60 mph, value: 6.9 s, role: calibrated, source: a track test, status: excerpt}
"""


def _sixty(**changes):
    data = {"quantity": "time_to_speed", "speed": 26.8224, "value": "6.9 s", "source": "a test", "status": "excerpt"}
    data["role"] = "predicted"
    return TimeToSpeed(**(data | changes))


# --- the files ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["bolt", "mkz", "catvehicle", "unior"])
def test_every_reference_vehicle_lists_its_published_figures(name):
    published = load_published(load_vehicle(name))
    assert bool(published.figures) != bool(published.none_because)
    texts = [(figure.text, figure.source) for figure in published.figures]
    assert len(set(texts)) == len(texts)
    load_vehicle(driven_name(name, published))


def test_values_keep_the_unit_in_which_they_were_published():
    given = {"value": "116 ft", "role": "predicted", "source": "x", "status": "excerpt"}
    stop = BrakingDistance(quantity="braking_distance", speed=26.8224, **given)
    assert stop.si == pytest.approx(35.3568)
    assert stop.number == pytest.approx(116.0)
    assert (stop.shown_unit, stop.text) == ("ft", "60 mph to standstill")
    assert format_published(stop) == "116 ft"
    assert format_published(_sixty(value=7, bound="at_most")) == "at most 7 s"
    assert format_published(_sixty(value="7.0")) == "7.0 s"


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        (SIXTY.replace("6.9 s", "6.9 m"), "f.yaml:2: figures.0.value: unit 'm' does not fit; allowed: s, ms, min, h"),
        (SIXTY.replace("6.9 s", "fast"), "f.yaml:2: figures.0.value: must be a number in s, not 'fast'"),
        (SIXTY.replace("6.9 s", "-1 s"), "f.yaml:2: figures.0.value: must be above zero"),
        (SIXTY.replace("role: calibrated, ", ""), "f.yaml:2: figures.0.role"),
        (SIXTY.replace("calibrated", "fitted"), "f.yaml:2: figures.0.role"),
        (SIXTY.replace("excerpt", "sure"), "f.yaml:2: figures.0.status"),
        (SIXTY.replace("speed: 60 mph", "sped: 60 mph"), "f.yaml:2: figures.0.sped: unknown field"),
        (SIXTY.replace("time_to_speed", "lap_time"), "f.yaml:2: figures.0"),
        (
            "figures: [{quantity: coast_time, first: 10, last: 20, value: 3, role: input, source: x, status: excerpt}]",
            "f.yaml:1: figures.0: last must be below first",
        ),
    ],
)
def test_faults_of_a_file_have_file_and_line(text, fault):
    with pytest.raises(ConfigError) as error:
        parse_yaml(text, PublishedFigures, name="f.yaml")
    assert fault in str(error.value)


def test_a_payload_sits_where_the_body_has_its_centre():
    empty, loaded = (load_vehicle("bolt", arguments={"payload": text}) for text in ("0", "141.7"))
    before, after = estimate_parameters(empty), estimate_parameters(loaded)
    assert after.mass - before.mass == pytest.approx(141.7)
    assert after.rear_length == pytest.approx(before.rear_length, abs=0.002)
    assert after.com_height == pytest.approx(before.com_height, abs=0.002)


@pytest.mark.parametrize("payload", ["-1", "much"])
def test_an_impossible_payload_is_rejected(payload):
    with pytest.raises(ModelError, match=f"'{payload}'"):
        load_vehicle("mkz", arguments={"payload": payload})


# --- judging -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("simulated", "bound", "verdict", "error"),
    [
        (7.1, "about", "within", 0.029),
        (7.11, "about", "outside", 0.0304),
        (6.69, "about", "outside", -0.0304),
        (6.0, "at_most", "within", -0.1304),
        (7.2, "at_most", "outside", 0.0435),
        (7.2, "at_least", "within", 0.0435),
        (None, "about", "not simulated", None),
    ],
)
def test_errors_are_relative_to_the_published_value(simulated, bound, verdict, error):
    comparison = Comparison(_sixty(bound=bound), simulated, "", 80.0, 0.03)
    assert comparison.verdict == verdict
    assert comparison.error == (None if error is None else pytest.approx(error, abs=1e-4))


def _results(*comparisons, published=None):
    facts = find_facts(load_vehicle("bolt@handling"))
    published = published or PublishedFigures(figures=[comparison.figure for comparison in comparisons], payload=80.0)
    outcome = Outcome("acceleration", "Acceleration", "full throttle")
    plant = {"contact": "point", "time_step": 0.005}
    return ValidationResults(facts, published, comparisons, [outcome], 0.03, plant, 0.85)


def test_figures_that_could_not_be_simulated_fail_and_figures_not_compared_do_not():
    good = Comparison(_sixty(), 6.9, "", 80.0, 0.03)
    left_out = Comparison(_sixty(not_compared="summer tyres"), None, "", 80.0, 0.03)
    missing = Comparison(_sixty(), None, "it has no pedals", 80.0, 0.03)
    assert _results(good, left_out).exit_code == 0
    assert _results(good, left_out).headline == "1 of 1 predicted figures within 3 %"
    assert _results(good, missing).exit_code == 1
    assert "  not simulated: it has no pedals" in describe_validation(_results(good, missing))


def test_the_page_shows_both_values_the_error_the_source_and_what_is_not_compared():
    good = Comparison(_sixty(note="with a <b>driver</b>"), 7.0, "", 80.0, 0.03)
    bad = Comparison(_sixty(value="5.0 s"), 7.0, "", 80.0, 0.03)
    left_out = Comparison(_sixty(not_compared="summer tyres"), None, "", 80.0, 0.03)
    page = render_validation(_results(good, bad, left_out))
    assert "1 of 2 predicted figures within 3 %" in page
    for text in ("6.9 s", "7 s", "+1.4 %", "+40.0 %", "a test", "summer tyres", "outside"):
        assert text in page
    assert "<b>driver" not in page
    assert "http" not in page
    bare = render_validation(_results(published=PublishedFigures(none_because="nobody measured it")))
    assert "nobody measured it" in bare
    assert "<svg" not in bare


@pytest.mark.parametrize(
    ("roles", "headline"),
    [
        ("pc", "1 of 1 predicted figures within 3 % (calibrated 1 of 1)"),
        ("ppPci", "2 of 3 predicted figures within 3 % (calibrated 1 of 1, input 1 of 1)"),
        ("cCi", "no predicted figure to compare; calibrated 1 of 2, input 1 of 1 within 3 %"),
        ("", "no published figures to compare"),
    ],
)
def test_predicted_figures_are_counted_separately(roles, headline):
    names = {"p": "predicted", "c": "calibrated", "i": "input"}
    created = [Comparison(_sixty(role=names[k.lower()]), 6.9 + 3.0 * k.isupper(), "", 80.0, 0.03) for k in roles]
    results = _results(*created)
    assert results.headline == headline
    lines, page = describe_validation(results), render_validation(results)
    for key, role in names.items():
        count = sum(k.lower() == key for k in roles)
        start = next((number for number, line in enumerate(lines) if line.startswith(f"{role}: ")), None)
        assert (start is not None) == (count > 0) == (f"<h2>{role.capitalize()} figures</h2>" in page)
        if start is not None:
            rows = lines[start + 2 : start + 2 + count]
            assert all(row.startswith("  0 to 60 mph") for row in rows)
            assert len(rows) == count
    assert [figure["role"] for figure in results.data()["figures"]] == [names[k.lower()] for k in roles]


@pytest.mark.parametrize("name", ["bolt", "mkz", "catvehicle"])
def test_figures_that_follow_from_a_limit_or_were_fitted_are_not_predictions(name):
    vehicle = load_vehicle(name)
    published = load_published(vehicle)
    driven = load_vehicle(driven_name(name, published))
    governed = getattr(driven.spec.powertrain, "governed_speed", None)
    for entry in published.figures:
        if entry.quantity == "top_speed" and governed is not None and abs(entry.si - governed) < 0.03 * governed:
            assert entry.role == "input"
    if name == "bolt":
        fitted = {figure.text for figure in published.figures if figure.role == "calibrated"}
        times = {f"0 to {speed} mph" for speed in (30, 60, 75)}  # README, section 14
        assert fitted == times | {"60 mph to standstill", "Lateral acceleration on a circle of 200 ft"}


# --- the command line --------------------------------------------------------------------------------------------


def test_the_reason_for_missing_figures_is_reported(tmp_path, capsys):
    assert main(["validate", "unior", "--out", str(tmp_path / "out")]) == 0
    assert "no published figures to compare" in capsys.readouterr().out
    assert "Nothing to compare" in (tmp_path / "out" / "validation.html").read_text(encoding="utf-8")


def test_list_shows_the_figures_without_driving(capsys):
    assert main(["validate", "bolt", "--list", "--only", "top_speed,braking_distance"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "Top speed: 91 mph (input; excerpt; Clean Fleet Report)"
    assert len(lines) == 3


@pytest.mark.parametrize(
    ("arguments", "fault"),
    [
        (["bolt", "--only", "braking"], "did you mean 'braking_distance'?"),
        (["bolt", "--set", "tolerance=-1"], "tolerance"),
        (["bolt", "--set", "tolerances=1"], "did you mean 'tolerance'?"),
        (["bold"], "did you mean 'bolt'?"),
    ],
)
def test_bad_input_is_one_line(arguments, fault, capsys):
    assert main(["validate", *arguments]) == 2
    error = capsys.readouterr().err
    assert fault in error
    assert error.count("\n") == 1


def test_the_error_of_a_vehicle_without_a_file_states_what_to_write(tmp_path, monkeypatch, capsys):
    source = names("models")["unior"]
    folder = tmp_path / "models" / "mine"
    shutil.copytree(source, folder, ignore=shutil.ignore_patterns(FILE))
    assert main(["validate", str(folder)]) == 2
    assert f"has no {FILE}" in capsys.readouterr().err


# --- the Bolt ----------------------------------------------------------------------------------------------------


@pytest.mark.essential
def test_bolt_brakes_and_accelerates_like_the_real_car(tmp_path, capsys):
    only = "time_to_speed,time_to_distance,speed_at_distance,braking_distance"
    out = tmp_path / "out"
    assert main(["validate", "bolt", "--only", only, "--out", str(out)]) == 0
    assert "4 of 4 predicted figures within 3 % (calibrated 4 of 4, input 1 of 1)" in capsys.readouterr().out
    results = json.loads((out / "results.json").read_text(encoding="utf-8"))
    assert results["vehicle"] == "bolt@handling"
    stop = next(figure for figure in results["figures"] if figure["text"] == "60 mph to standstill")
    assert stop["simulated"] == pytest.approx(116.0, rel=0.03)
    assert stop["payload_kg"] == 80.0
    with (out / "figures.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(results["figures"])
    assert {row["verdict"] for row in rows} == {"within"}
    assert (out / "run_1" / "acceleration" / "full_throttle" / "signals.parquet").is_file()


def test_a_smaller_tolerance_fails(tmp_path):
    arguments = ["--only", "braking_distance", "--set", "tolerance=0.1", "--out", str(tmp_path / "out"), "--quiet"]
    assert main(["validate", "bolt", *arguments]) == 1


@pytest.mark.slow
@pytest.mark.parametrize("contact", ["tyre", "hydroelastic"])
def test_every_figure_of_the_bolt_is_within_3_percent(contact):
    vehicle = load_vehicle("bolt")
    published = load_published(vehicle)
    name = driven_name("bolt", published)
    settings = {"plant": {"contact": contact}}
    results = validate_vehicle(name, load_vehicle(name), published, ValidationSettings.model_validate(settings))
    assert sum(results.count(role)[1] for role in ROLES) == 15
    assert results.exit_code == 0, "\n".join(describe_validation(results))
