"""Manoeuvres end to end, through the command line: runs, written files, rejected input."""

import csv
import json
import math
from dataclasses import replace

import numpy as np
import pytest

from mirdrake.cli import main
from mirdrake.manoeuvres import MANOEUVRES, Rig, find_facts, run_manoeuvre
from mirdrake.manoeuvres.base import Outcome
from mirdrake.manoeuvres.skidpad import SkidpadSpec
from mirdrake.manoeuvres.straight import AccelerationSpec, BrakingSpec, brake_run
from mirdrake.runs.logs import load_run
from mirdrake.single_track import understeer_gradient
from mirdrake.vehicles import load_vehicle


def _drive(tmp_path, *arguments):
    """Return the exit code, and results.json if there is one."""
    code = main(["manoeuvre", *arguments, "--out", str(tmp_path / "out")])
    file = tmp_path / "out" / "results.json"
    return code, json.loads(file.read_text(encoding="utf-8")) if file.is_file() else None


def _figures(results, name):
    manoeuvre = next(entry for entry in results["manoeuvres"] if entry["name"] == name)
    return {key: entry["value"] for key, entry in manoeuvre["metrics"].items()}


def test_a_limit_of_the_set_point_is_the_top_speed():
    car = load_vehicle("unior@handling")
    speed = car.control.speed.model_copy(update={"max_speed": 1.5})
    limited = replace(car, control=car.control.model_copy(update={"speed": speed}))
    assert find_facts(limited).top_speed == 1.5
    assert find_facts(car).top_speed > 20.0


def test_the_single_track_model_has_the_understeer_of_its_own_parameters(tmp_path, capsys):
    """Regression on a short circle against the formula of the linear model; brush tyres are softer by a few percent."""
    code, results = _drive(
        tmp_path, "steady_state_circle", "bolt", "--model", "single_track",
        "--set", "steady_state_circle.radius=40", "--set", "steady_state_circle.speed_rate=0.5",
        "--set", "steady_state_circle.limit=3.0", "--set", "steady_state_circle.fit_to=2.0",
        "--set", "steady_state_circle.turns=left",
    )  # fmt: skip
    assert code == 0
    exact = math.degrees(understeer_gradient(find_facts(load_vehicle("bolt@handling")).parameters)) * 9.80665
    assert _figures(results, "steady_state_circle")["understeer"] == pytest.approx(exact, rel=0.15)
    assert results["manoeuvres"][0]["settings"]["radius"] == {
        "value": 40.0,
        "unit": "m",
        "status": "given",
        "given": True,
    }
    assert "Understeer gradient, left" in capsys.readouterr().out


def test_a_step_on_the_reduced_model_writes_run_figures_table_and_page(tmp_path, capsys):
    code, results = _drive(tmp_path, "step_steer", "bolt", "--model", "single_track")
    assert code == 0
    assert results["vehicle"]["name"] == "bolt@handling"  # the Bolt as named has no tyres with slip
    output = capsys.readouterr().out
    assert "--as-is" in output
    figures = _figures(results, "step_steer")
    assert figures["lateral"] == pytest.approx(4.0, rel=0.05)
    assert 0.0 < figures["yaw_response"] < figures["lateral_response"] < 1.0
    assert figures["yaw_gain"] * figures["hand_wheel"] == pytest.approx(
        math.degrees(4.0 / (figures["speed"] / 3.6)), rel=0.06
    )  # the yaw rate of a steady turn is a / v
    out = tmp_path / "out"
    page = (out / "handling.html").read_text(encoding="utf-8")
    assert "Step steer" in page
    assert "magic formula tyres, relaxation" in page  # as of bolt@handling
    assert "its largest one may be too high" in page
    assert "not verified in a source" in page
    assert "http" not in page.replace("http://www.w3.org", "")
    assert (out / "step_steer" / "step_steer.svg").read_text(encoding="utf-8").count("Yaw rate [deg/s]") == 1
    run = load_run(out / "step_steer" / "step_1")
    assert run.units["ego.vx"] == "m/s"
    with (out / "metrics.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert {row["metric"] for row in rows} == set(figures)
    assert "not verified in a source: speed" in output


def test_braking_by_command_keeps_to_the_slope_of_the_speed_control(tmp_path):
    code, results = _drive(
        tmp_path, "braking", "bolt", "--as-is", "--set", "braking.speed=40 km/h", "--set", "plant.contact=point"
    )
    assert code == 0
    figures = _figures(results, "braking")
    slope = load_vehicle("bolt").control.speed.max_deceleration
    assert figures["mfdd"] == pytest.approx(slope, rel=0.05)
    assert figures["distance_40"] == pytest.approx((40.0 / 3.6) ** 2 / (2.0 * slope), rel=0.05)
    assert any("no pedals" in note for note in results["manoeuvres"][0]["notes"])
    run = load_run(tmp_path / "out" / "braking" / "brake")
    assert run.summary["stop_detail"] == "standstill"
    assert run.signals["ego.vx"].iloc[-1] < 0.05


def test_full_braking_ends_at_the_first_standstill(tmp_path):
    """After it, tyres and springs push the car back at up to 0.46 m/s until the stop condition is evaluated."""
    vehicle = load_vehicle("bolt@handling")
    rig = Rig("bolt@handling", vehicle, find_facts(vehicle), plant={"contact": "point"}, folder=tmp_path)
    record = brake_run(rig, Outcome("braking", "", ""), "brake", 8.0, 1.0, lowest=1.0)
    assert record.stop == "standstill"
    assert record.vx[-1] == pytest.approx(0.0, abs=1e-12)
    assert np.all(record.vx[:-1] > 0.0)
    written = load_run(tmp_path / "brake").signals["ego.vx"]
    assert written.min() >= 0.0
    assert len(written) == len(record.vx) - 1  # the record ends between two samples, at the crossing of zero


def test_times_from_pedal_application_include_the_time_until_the_car_moves():
    vehicle = load_vehicle("bolt@handling")
    rig = Rig("bolt@handling", vehicle, find_facts(vehicle), plant={"contact": "point"})
    outcome = run_manoeuvre("acceleration", rig, AccelerationSpec(longest=5.0))
    first = outcome.value("begin") or 0.0
    assert first > 0.05  # the throttle's lag
    assert (outcome.value("pedal_30mph") or 0.0) == pytest.approx((outcome.value("time_30mph") or 9.0) + first)
    assert outcome.value("pedal_100kmh") is None  # not reached


def test_a_held_car_does_not_creep(tmp_path):
    code, results = _drive(
        tmp_path, "park", "bolt", "--set", "park.length=1", "--set", "park.settle=1", "--set", "plant.contact=point"
    )
    assert code == 0
    assert results["manoeuvres"][0]["verdict"] == "pass"


def test_a_criterion_that_is_not_met_is_exit_code_1(tmp_path, capsys):
    code, results = _drive(
        tmp_path, "park", "bolt", "--set", "park.length=1", "--set", "park.settle=0", "--set", "park.allowed=1e-12",
        "--set", "plant.contact=point",
    )  # fmt: skip
    assert code == 1
    assert results["manoeuvres"][0]["verdict"] == "fail"
    assert "it creeps at" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("name", "setting", "reason"),
    [
        ("coast_down", "coast_down.last=5", "coasting needs pedals"),
        ("step_steer", "step_steer.speed=400 km/h", "above the top speed"),
        ("steady_state_circle", "steady_state_circle.radius=3", "the limit of the steering is"),
        ("skidpad", "skidpad.width=1.5", "the lane 1.50 m"),
        ("frequency_response", "frequency_response.last=90", "the limit of the steering is"),
        ("double_lane_change", "double_lane_change.extra=0", "it does not pass at"),
        ("park", "park.grade=0.1", "it creeps"),
    ],
)
def test_a_manoeuvre_beyond_the_vehicle_is_reported_without_an_error(tmp_path, name, setting, reason):
    extra = ["--set", "double_lane_change.offset=30"] if name == "double_lane_change" else []
    code, results = _drive(
        tmp_path, name, "bolt", "--model", "single_track", "--set", setting, *extra, "--quiet", "--as-is"
    )
    assert code == 0
    assert results["manoeuvres"][0]["verdict"] == "not possible"
    assert reason in results["manoeuvres"][0]["reason"]
    assert "\n" not in results["manoeuvres"][0]["reason"]


def test_a_small_robot_is_driven_at_its_own_scale(tmp_path):
    code, results = _drive(tmp_path, "slalom", "unior", "--model", "single_track", "--quiet")
    assert code == 0
    slalom = results["manoeuvres"][0]
    assert slalom["settings"]["spacing"]["value"] == pytest.approx(18.0 * results["vehicle"]["scale"], rel=1e-3)
    assert slalom["verdict"] == "done", slalom["reason"]
    figures = _figures(results, "slalom")
    assert 3.0 < figures["speed"] < 60.0
    assert 0.7 * figures["speed"] < figures["figures_speed"] <= 0.96 * figures["speed"]
    steps = figures["figures_speed"] / (5.0 * results["vehicle"]["scale"] ** 0.5)
    assert steps == pytest.approx(round(steps), abs=1e-3)
    assert any(note.startswith("largest values at the limit") for note in slalom["notes"])


def test_the_skidpad_reaches_the_grip_of_the_car():
    """A car that starts on the circle at its limit would leave the lane at two thirds of it."""
    vehicle = load_vehicle("bolt@handling")
    facts = find_facts(vehicle)
    spec = SkidpadSpec(resolution=1.0 / 3.6)
    outcome = run_manoeuvre("skidpad", Rig("bolt@handling", vehicle, facts, kind="single_track"), spec)
    grip = min(facts.parameters.front_friction, facts.parameters.rear_friction)
    assert 0.7 * grip < (outcome.value("lateral") or 0.0) < grip
    distance = (outcome.value("lap") or 0.0) * (outcome.value("speed") or 0.0) / 3.6
    assert distance == pytest.approx(2.0 * math.pi * spec.path_radius, rel=0.01)


def test_the_same_run_gives_the_same_figures():
    vehicle = load_vehicle("bolt")
    figures = []
    for _ in range(2):
        rig = Rig("bolt", vehicle, find_facts(vehicle), kind="single_track")
        figures.append(run_manoeuvre("braking", rig, BrakingSpec(speed=8.0)).metrics)
    assert figures[0] == figures[1]


def test_the_list_shows_every_manoeuvre_with_its_settings(capsys):
    assert main(["manoeuvre", "--list"]) == 0
    text = capsys.readouterr().out
    assert all(f"{name}: " in text for name in MANOEUVRES)
    assert "0.7 Hz" in text
    assert "recalled, not verified in any source: FMVSS 126" in text


def test_the_list_shows_what_was_set(capsys):
    assert main(["manoeuvre", "braking", "--list", "--set", "braking.brake=0.5"]) == 0
    text = capsys.readouterr().out
    assert "slalom" not in text
    assert "[given]" in text


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["brakin", "bolt"], "error: unknown manoeuvre 'brakin'; did you mean 'braking'?"),
        (["braking"], "error: give a manoeuvre and a vehicle"),
        (["braking", "bolt", "--set", "braking.brak=1"], "braking.brak: unknown field; did you mean 'brake'?"),
        (["braking", "bolt", "--set", "braking.brake=2"], "braking.brake: 2 is not allowed"),
        (["step_steer", "bolt", "--set", "step_steer.speed=3 kg"], "unit 'kg' does not fit"),
        (["braking", "nobody"], "unknown vehicle 'nobody'"),
        (
            ["braking", "bolt", "--model", "single_track", "--set", "single_track.masss=1700"],
            "single_track.masss: no such parameter; did you mean 'mass'?",
        ),
        (
            ["braking", "bolt", "--set", "single_track.mass=1700"],
            "single_track.mass: is a setting of the single-track model; leave it out for the full plant",
        ),
        (
            ["steady_state_circle", "bolt", "--model", "single_track", "--set", "steady_state_circle.fit_to=0.5"],
            "fit_to: must be above fit_from",
        ),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(tmp_path, capsys, arguments, message):
    code, results = _drive(tmp_path, *arguments)
    assert code == 2
    assert results is None
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert error.startswith("error: ")
    assert message in error, error


def test_a_folder_that_is_not_empty_is_rejected(tmp_path, capsys):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "mine.txt").write_text("mine")
    code, _ = _drive(tmp_path, "braking", "bolt")
    assert code == 2
    assert "is not empty" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize("name", ["step_steer", "braking", "steady_state_circle"])
def test_the_single_track_model_has_the_stated_differences_from_the_full_plant(tmp_path, name):
    """Reports and docs/batch.md state these margins to the users of batches, whose cars have the same equations."""
    figures = []
    for model in ("single_track", "full"):
        folder = tmp_path / model
        folder.mkdir()
        code, results = _drive(folder, name, "bolt@handling", "--model", model, "--quiet")
        assert code == 0
        figures.append(_figures(results, name))
        stated = [metric.get("margin") for metric in results["manoeuvres"][0]["metrics"].values()]
        assert any(stated) == (model == "single_track")
    reduced, full = figures
    assert MANOEUVRES[name].margins
    for figure, margin in MANOEUVRES[name].margins.items():
        difference = reduced[figure] / full[figure] - 1.0
        assert difference == pytest.approx(margin.measured, abs=0.005), figure
        assert abs(difference) < margin.limit, figure
