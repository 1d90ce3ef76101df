"""Robustness of the figures of manoeuvres: driver gains, time step, first speed of a search."""

import json
import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from mirdrake.assembly.diagram import assemble
from mirdrake.cli import main
from mirdrake.manoeuvres import MANOEUVRES, Rig, find_facts, read_settings, run_manoeuvre
from mirdrake.manoeuvres.base import Metric, Outcome, scaled
from mirdrake.manoeuvres.courses import Body, Section, clearance, eight, make_line
from mirdrake.manoeuvres.lanes import DoubleLaneChangeSpec, SlalomSpec, _fault
from mirdrake.manoeuvres.search import find_highest, once_per_label, speed_label
from mirdrake.manoeuvres.steady_circle import SteadyStateCircleSpec
from mirdrake.plant.plant import PlantSpec
from mirdrake.runs.simulation import Simulation
from mirdrake.vehicles import load_vehicle

NAME = "bolt@handling"


def _rig(name: str = NAME, **settings) -> Rig:
    vehicle = load_vehicle(name)
    return Rig(name, vehicle, find_facts(vehicle), **settings)


# --- a simulation that ends on a condition ---------------------------------------------------------------------------


def _simulation(world: str = "empty") -> Simulation:
    return Simulation(
        assemble(
            {
                "name": "condition",
                "world": world,
                "vehicles": {"ego": {"model": "bolt", "speed": 5.0}},
                "control": {"ego": {"kind": "constant", "speed": 5.0}},
                "plant": {"contact": "point"},
                "record": {"meshcat": False, "report": False},
                "duration": 1.0,
            }
        )
    )


def test_a_run_ends_with_the_step_on_which_its_condition_is_met():
    simulation = _simulation()
    run = simulation.run(until=lambda context: context.get_time() > 0.4321)
    assert run.summary["stop_reason"] == "condition"
    assert run.summary["simulated_s"] == pytest.approx(0.435)
    assert run.signals.index[-1] == pytest.approx(0.42)  # 50 Hz
    assert not [event for event in run.events if "stop" in event.values()]
    assert simulation.run(until=lambda context: False).summary["stop_reason"] == "duration"


def test_a_condition_may_be_met_before_the_first_sample_of_a_block(monkeypatch):
    monkeypatch.setattr("mirdrake.runs.simulation.LONG_BLOCK", 0.5)
    run = _simulation("test_track").run(until=lambda context: context.get_time() > 0.5)
    assert run.summary["stop_reason"] == "condition"
    assert run.summary["simulated_s"] == pytest.approx(0.505)
    assert run.signals.index[-1] == pytest.approx(0.5)


def test_a_condition_may_be_met_at_the_start():
    run = _simulation().run(until=lambda context: True)
    assert run.summary["stop_reason"] == "condition"
    assert len(run.signals) == 1


# --- searches and lines -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("guess", [1.0, 9.0, 14.0, 40.0])
def test_a_search_finds_the_limit_from_wherever_it_starts(guess):
    tried = []

    def attempt(speed):
        tried.append(speed)
        return speed, "" if speed <= 14.2 else "too fast"

    highest = find_highest(attempt, lowest=5.0, highest=30.0, guess=guess, resolution=0.2)
    assert highest.best == highest.passed <= 14.2 < highest.failed <= highest.passed + 0.2
    assert highest.reason == "too fast"
    assert len(tried) < 20


def test_a_search_that_ends_at_its_borders():
    always = find_highest(lambda speed: (speed, ""), lowest=5.0, highest=30.0, guess=20.0, resolution=0.2)
    assert (always.passed, always.failed) == (30.0, math.inf)
    never = find_highest(lambda speed: (speed, "no"), lowest=5.0, highest=30.0, guess=20.0, resolution=0.2)
    assert never.best is None
    assert (never.failed, never.reason) == (5.0, "no")


@pytest.mark.parametrize("guess", [8.0, 17.5, 18.5, 30.0])
def test_a_search_ends_at_the_first_failure_from_below(guess):
    """The vehicle fails from 14.2 to 14.6 and from 16.1 to 16.6, and passes between them by chance."""
    tried = []

    def attempt(speed):
        tried.append(speed)
        return speed, "a cone" if 14.2 < speed < 14.6 or 16.1 < speed < 16.6 or speed > 18.0 else ""

    limit = find_highest(attempt, lowest=5.0, highest=30.0, guess=guess, resolution=0.1, check=2.0, step=0.25)
    assert limit.best == limit.passed <= 14.2 < limit.failed <= limit.passed + 0.1
    assert len(tried) == len(set(tried)) < 45
    # No grid of speeds shows a failure that is narrower than its step, or farther below the limit than the range.
    narrow = find_highest(
        lambda speed: (speed, "a cone" if 14.26 < speed < 14.45 or speed > 18.0 else ""),
        lowest=5.0, highest=30.0, guess=8.0, resolution=0.1, check=4.0, step=0.25,
    )  # fmt: skip
    assert narrow.passed == pytest.approx(18.0, abs=0.1)


def test_a_search_tries_one_of_two_speeds_with_the_same_name():
    """A check at a multiple of its step, 0.0005 m/s from a speed of the bisection, would write the same folder."""
    tried = []

    @once_per_label
    def attempt(speed):
        tried.append(speed_label(speed))
        return speed, "" if speed <= 14.2 else "too fast"

    limit = find_highest(attempt, lowest=5.0, highest=30.0, guess=14.0005, resolution=0.05, check=2.0, step=0.25)
    assert limit.passed == pytest.approx(14.2, abs=0.05)
    assert len(tried) == len(set(tried))


def test_an_eased_figure_of_eight_joins_two_circles():
    line, shift = eight(radius=9.0, laps=1, ease=4.0), 4.0**2 / 54.0
    for part, centre in ((line.s < 45.0, -9.0 - shift), ((line.s > 65.0) & (line.s < 110.0), 9.0 + shift)):
        assert np.hypot(line.x, line.y - centre)[part] == pytest.approx(9.0, abs=0.03)


def test_a_planned_line_is_straight_where_it_need_not_bend():
    facts, spec = find_facts(load_vehicle("bolt")), DoubleLaneChangeSpec()
    line = make_line(spec._line(facts, 1.0))
    assert np.max(np.abs(line.curvature[line.x < -10.0])) < 0.05 * np.max(np.abs(line.curvature))


@pytest.mark.parametrize(("rate", "fault"), [(0.0, ""), (0.1, "in section 7"), (2.0, "in section 7")])
def test_a_car_that_turns_after_the_last_cone_of_a_slalom_does_not_pass(rate, fault):
    """It keeps to the line until it is 5 m past the last cone, and then turns at a constant rate [rad/m]."""
    facts, spec = find_facts(load_vehicle("bolt")), SlalomSpec()
    line, sections = make_line(spec._line(facts, 0.0)), spec.sections(facts.width)
    body = Body(facts.rear, facts.front, 0.5 * facts.width)
    past = line.s[int(np.argmax(line.x + facts.rear > 5.0 * spec.spacing + 5.0))]
    turned = rate * np.maximum(line.s - past, 0.0)
    room = clearance(line.x, line.y, line.yaw + turned, body, sections)
    assert len(room) == 7
    assert room[:6] == pytest.approx(clearance(line.x, line.y, line.yaw, body, sections)[:6])
    found = _fault(room.tolist(), sections, x=float(line.x[-1]))
    assert found.endswith(fault), found
    assert bool(found) == bool(fault)


def test_a_run_that_ends_in_its_last_section_does_not_pass():
    lane = Section(0.0, 15.0, -1.0, 1.0)
    assert _fault([0.1], [lane], x=14.9) == "it did not leave the course"
    assert _fault([0.1], [lane], x=15.1) == ""


# --- the plant --------------------------------------------------------------------------------------------------------


def test_manoeuvres_have_tyre_contact_by_default():
    assert _rig().contact == _rig("bolt").contact == "tyre"
    assert _rig(plant={"contact": "hydroelastic"}).contact == "hydroelastic"


def test_both_sides_of_a_symmetrical_car_are_alike():
    left = _outcome("step_steer", "bolt@handling", "tyre")
    right = run_manoeuvre("step_steer", _rig(), read_settings(["step_steer.turn=right"]).step_steer)
    values = [[metric.value for metric in outcome.metrics] for outcome in (left, right)]
    assert values[0] == pytest.approx(values[1], rel=1e-6, nan_ok=True)


def test_the_driver_keeps_the_car_on_its_line_on_split_friction():
    outcome = _outcome("split_friction_braking", "bolt@handling", "tyre")
    assert outcome.verdict == "pass", outcome.reason
    assert 0.3 * 9.81 < (outcome.value("mean") or 0.0) < 0.7 * 9.81  # between ice on one side and asphalt on both
    assert (outcome.value("hand_wheel_mean") or 0.0) > 20.0  # to the left, where the road is slippery
    assert (outcome.value("sideways") or 9.0) < 0.6


def test_driver_bandwidth_follows_steering_lag_and_tyres():
    facts = find_facts(load_vehicle("unior@handling"))
    facts = replace(
        facts,
        parameters=replace(
            facts.parameters,
            mass=40.0,
            steering_lag=0.02,
            front_relaxation=0.2,
            front_stiffness=2000.0,
            rear_stiffness=3000.0,
        ),
    )
    # At 5 m/s the tyres take 0.04 s, the servo 0.02, driver and control unit 0.02; tyres of 25 kN/m under 40 kg have a
    # natural frequency of 25 rad/s, and their slip relaxes with 25 1/s.
    assert facts.quickest(5.0) == pytest.approx(0.4 / 0.08)
    assert facts.steadiness(2.5) == pytest.approx(0.5)
    assert facts.steadiness(5.5) == 1.0
    driver = replace(_rig("unior@handling"), facts=facts).line_driver({}, speed=2.5)
    assert driver["frequency"] == pytest.approx(0.4 / 0.12)
    assert driver["course"] == pytest.approx(0.5)


def test_a_robot_has_no_lateral_oscillation_on_its_tyres_in_a_slalom():
    """With a driver who reacts to it, the steering oscillates at its rate limit, 8 times a second."""
    rig = _rig("unior@handling")
    spec = scaled(SlalomSpec(), rig.facts.scale)
    assert isinstance(spec, SlalomSpec)
    record, _ = spec._try(rig, spec.sections(rig.facts.width), 3.0)
    inside = (record.x > 5.0) & (record.x < 25.0)
    turns = np.sum(np.diff(np.sign(np.diff(record.hand_wheel[inside]))) != 0)
    assert turns < 30
    assert float(np.max(np.abs(record.lateral_acceleration[inside]))) < 0.15 * 9.81


@pytest.mark.slow
def test_the_largest_lateral_acceleration_is_not_that_of_the_driver():
    accelerations = []
    for gain in (0.7, 1.0, 1.3):
        spec = SteadyStateCircleSpec(turns="left", driver_gain=gain, first_lateral=5.0, fit_from=5.5, fit_to=6.5)
        accelerations.append(run_manoeuvre("steady_state_circle", _rig(), spec).value("largest"))
    assert accelerations == pytest.approx([accelerations[1]] * 3, rel=0.02)


@cache
def _outcome(
    name: str, vehicle: str, contact: str, time_step: float | None = None, overrides: tuple[str, ...] = ()
) -> Outcome:
    """Return the outcome of a manoeuvre; tests that need the same one share it."""
    spec = getattr(read_settings(overrides), name)
    step = getattr(spec, "time_step", PlantSpec().time_step) if time_step is None else time_step
    if time_step is None:
        return _outcome(name, vehicle, contact, step, overrides)
    return run_manoeuvre(name, _rig(vehicle, plant={"time_step": step, "contact": contact}), spec)


def _check_steps(
    note: Callable[[str, object], None], name: str, vehicle: str, contact: str, overrides: tuple[str, ...] = ()
) -> None:
    """Check that half of a manoeuvre's default step changes each figure by less than 1 %, and no verdict.

    Args:
        note: keeps the figures for the report of the tests.
        name: of the manoeuvre.
        vehicle: of a model with a variant for handling.
        contact: of the plant.
        overrides: of the settings.
    """
    step = getattr(getattr(read_settings(overrides), name), "time_step", PlantSpec().time_step)
    whole, half = (_outcome(name, f"{vehicle}@handling", contact, dt, overrides) for dt in (step, 0.5 * step))
    assert whole.verdict == half.verdict, (whole.reason, half.reason)
    assert whole.metrics or whole.verdict == "not possible"
    assert [metric.key for metric in whole.metrics] == [metric.key for metric in half.metrics]
    changes = {}
    for at_full_step, at_half_step in zip(whole.metrics, half.metrics, strict=True):
        changes[at_full_step.key] = at_full_step.change(at_half_step)
        scale = "" if at_full_step.scale is None else f" of {at_full_step.scale:.4g}"
        note(
            at_full_step.key,
            f"{at_full_step.value} {at_half_step.value} {at_full_step.unit}, "
            f"{100.0 * changes[at_full_step.key]:.3f} %{scale}",
        )
    assert {key: change for key, change in changes.items() if change >= 0.01} == {}


_LEFT = {
    "steady_state_circle": ("steady_state_circle.turns=left",),
    "sine_with_dwell": ("sine_with_dwell.turns=left",),
}
"""One side is enough for a car whose sides are alike."""

_QUICK = [
    ("step_steer", "bolt", "tyre"),
    ("braking", "bolt", "tyre"),
    ("step_steer", "unior", "tyre"),
    ("braking", "unior", "tyre"),
]
_SLOW_ON_PATCHES = ("double_lane_change", "obstacle_avoidance", "slalom")
"""Ten runs and more, each with patches at half the step; they have the driver of the others."""


@pytest.mark.parametrize(("name", "vehicle", "contact"), _QUICK)
def test_transients_and_stops_do_not_depend_on_the_time_step(record_property, name, vehicle, contact):
    _check_steps(record_property, name, vehicle, contact)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("vehicle", "contact"),
    [("bolt", "tyre"), ("mkz", "tyre"), ("catvehicle", "tyre"), ("unior", "tyre"), ("bolt", "hydroelastic")],
)
@pytest.mark.parametrize("name", MANOEUVRES)
def test_figures_do_not_depend_on_the_time_step(record_property, name, vehicle, contact):
    if (name, vehicle, contact) in _QUICK:
        pytest.skip("driven by the quick test above")
    if contact == "hydroelastic" and name in _SLOW_ON_PATCHES:
        pytest.skip("not driven on patches: too long")
    _check_steps(record_property, name, vehicle, contact, _LEFT.get(name, ()))


def test_a_change_is_measured_by_the_value_or_by_the_scale():
    first, second = Metric("a", "", 2.0, "m"), Metric("a", "", 1.99, "m")
    assert first.change(second) == pytest.approx(0.005)
    assert first.change(first) == 0.0
    assert Metric("a", "", 0.02, "m", scale=2.0).change(Metric("a", "", 0.01, "m", scale=2.0)) == pytest.approx(0.005)
    assert Metric("a", "", None, "m").change(Metric("a", "", None, "m")) == 0.0
    assert Metric("a", "", None, "m").change(first) == math.inf


# --- every manoeuvre, every vehicle -----------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("vehicle", ["bolt", "mkz", "catvehicle", "unior"])
@pytest.mark.parametrize("name", MANOEUVRES)
def test_every_manoeuvre_gives_figures_or_a_reason(tmp_path, capsys, name, vehicle):
    """Through the command line with default settings: each figure has a plausible value or a reason for its absence."""
    code = main(["manoeuvre", name, vehicle, "--out", str(tmp_path / "out")])
    results = json.loads((tmp_path / "out" / "results.json").read_text(encoding="utf-8"))
    (outcome,) = results["manoeuvres"]
    verdict, reason = outcome["verdict"], outcome["reason"]
    assert code == (verdict in {"fail", "diverged"})
    assert verdict in {"done", "pass", "fail", "not possible"}, reason
    assert bool(reason) == (verdict in {"fail", "not possible"})
    assert "\n" not in reason
    assert "Traceback" not in capsys.readouterr().err
    if verdict != "not possible":
        assert outcome["metrics"]
    for key, metric in outcome["metrics"].items():
        value, unit = metric["value"], metric["unit"]
        if value is None:
            assert metric.get("note"), f"{key}: no figure, and no word why"
            continue
        assert math.isfinite(value), key
        if unit in {"s", "m", "Hz", "km/h", "kg", "g"} and not key.startswith(("understeer", "displacement")):
            assert value >= 0.0, key
        # Friction limits accelerations, except the vertical one over a bump.
        impact = 100.0 if name == "single_bump" else 15.0
        highest = {"%": 200.0, "g": 1.5, "m/s²": impact, "km/h": 400.0, "s": 400.0, "Hz": 20.0}
        assert abs(value) <= highest.get(unit, math.inf), key
