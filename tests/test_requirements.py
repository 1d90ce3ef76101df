"""Requirements: grammar, margins, and the observation of a run."""

import math
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
import shapely
from hypothesis import example, given, settings
from hypothesis import strategies as st
from pydrake.math import RigidTransform

from mirdrake import requirements
from mirdrake.core.errors import ConfigError, RunError
from mirdrake.requirements import Event, Observation, observe, outline, parse_requirement
from mirdrake.requirements.observation import EVENTS, SIGNALS
from mirdrake.runs.logs import Run
from mirdrake.vehicles import load_vehicle
from mirdrake.worlds import PlacedProp, load_world
from mirdrake.worlds.props import make_primitive

TIMES = np.arange(0.0, 5.0, 0.5)


def _seen(**signals) -> Observation:
    """Return an observation of signals that are given sample by sample."""
    units = {"speed": "m/s", "clearance": "m", "heading_error": "rad", "time": "s"}
    arrays = {name.replace("__", "."): np.asarray(values, dtype=float) for name, values in signals.items()}
    size = len(next(iter(arrays.values())))
    speed = arrays.get("speed", np.zeros(size))
    free = arrays.get("clearance", np.ones(size))
    events = {
        "collision": Event(free <= 0.0, -free, "m"),
        "stopped": Event(speed <= 0.05, 0.05 - speed, "m/s"),
        "at exit": Event(speed >= 9.0, speed - 9.0, "m"),
    }
    return Observation(0.5 * np.arange(size, dtype=float), arrays, units, events, goal="exit")


# --- the grammar ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "passed", "margin", "unit", "worst"),
    [
        ("always speed < 12 m/s", True, 2.0, "m/s", 2.0),
        ("always speed < 36 km/h", False, 0.0, "m/s", 2.0),
        ("always speed <= 36 km/h", True, 0.0, "m/s", 2.0),
        ("never speed > 8", False, -2.0, "m/s", 2.0),
        ("eventually speed > 9 m/s", True, 1.0, "m/s", 2.0),
        ("eventually speed > 9 m/s within 1.5 s", False, -1.5, "m/s", 1.5),
        ("after 2.5 s always speed < 9 m/s", True, 1.5, "m/s", 2.5),
        ("after 500 ms eventually speed > 9 within 1.5", True, 1.0, "m/s", 2.0),
        ("at end speed < 1 m/s", True, 1.0, "m/s", 4.0),
        ("eventually at exit", True, 1.0, "m", 2.0),
        ("eventually at goal", True, 1.0, "m", 2.0),
        ("never collision", True, 0.4, "m", 3.0),
        ("always clearance > 50 cm", False, -0.1, "m", 3.0),
        ("always clearance > 0.5 m or speed < 6 m/s", True, 0.3, "m", 2.5),
        ("always not (speed > 9 and clearance < 1)", True, 0.0, "m", 2.0),
        ("speed < 9 m/s until speed > 9", True, 1.0, "m/s", 2.0),
        ("after 0.5 s clearance > 0.5 until stopped", False, -0.1, "m", 3.0),
        ("always abs heading_error < 10 deg", True, math.radians(1.0), "rad", 1.0),
        ("always abs(heading_error) < 10 °", True, math.radians(1.0), "rad", 1.0),
        ("always wheels_on_road == 4", False, -0.5, "", 3.5),
        ("always wheels_on_road >= 3", True, 0.5, "", 3.5),
        ("never wheels_on_road < 3", True, 0.5, "", 3.5),
        ("always radar.range > 2", True, 1.0, "", 0.0),
    ],
)
def test_margins_by_hand(text, passed, margin, unit, worst) -> None:
    observation = _seen(
        speed=[0, 2.5, 5, 7.5, 10, 7.5, 5, 2.5, 0],
        clearance=[4, 3, 2, 1.5, 1, 0.8, 0.4, 0.6, 0.6],
        heading_error=np.radians([0, 3, -9, 4, 0, 0, 0, 0, 0]),
        wheels_on_road=[4, 4, 4, 4, 4, 4, 4, 3, 4],
        radar__range=[3, 4, 5, 6, 7, 8, 9, 10, 11],
    )
    finding = parse_requirement(text).judge(observation)
    assert finding.passed is passed
    assert finding.margin == pytest.approx(margin, abs=1e-12)
    assert (finding.unit, finding.worst_time) == (unit, worst)
    assert finding.times.shape == finding.margins.shape
    assert finding.margins[finding.times == finding.worst_time] == pytest.approx(margin, abs=1e-12)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "is empty"),
        ("speed < 12", "lacks always"),
        ("always", "missing at the end"),
        ("always sped < 12", "did you mean 'speed'"),
        ("always speed", "needs a comparison"),
        ("always speed < ", "a number is missing"),
        ("always speed < 12 m", "allowed: m/s"),
        ("always speed < 12 parsec", "'parsec'"),
        ("always speed < 1e999", "not finite"),
        ("always speed == 3", "not a count"),
        ("always laps < 3 m", "a pure number"),
        ("always curvature < 3 m", "in 1/m"),
        ("always (speed < 3", "')' is expected at the end"),
        ("always speed < 3)", "')' is not expected"),
        ("never collision speed", "'speed' is not expected"),
        ("eventually at", "name of a goal"),
        ("always on", "'road' is expected"),
        ("after -3 s always stopped", "before the start"),
        ("eventually stopped within 3 m", "'m' is not expected"),
        ("always a-b < 3", "not 'a-b'"),
        ("always and", "not 'and'"),
        ("never " + "(" * 500, "too many brackets"),
        ("never " + "not " * 500 + "stopped", "too many brackets"),
    ],
)
def test_an_invalid_requirement_is_reported_in_one_line(text, expected) -> None:
    with pytest.raises(ConfigError) as caught:
        parse_requirement(text, where="lot.yaml:7: tests.0.expect.1")
    message = str(caught.value)
    assert message.startswith("lot.yaml:7: tests.0.expect.1: ")
    assert expected in message
    assert "allowed: always E" in message
    assert len(message.splitlines()) == 1


_PIECES = st.sampled_from(
    [
        word
        for text in (
            "after always never eventually until within at end on road and or not abs ( ) < <= > >= == !=",
            "3 -2.5 1e3 m/s s km/h N m % speed clearance stopped collision rollover goal laps wheels_on_road",
            "radar.range , . - \u2028 é",
        )
        for word in text.split(" ")
    ]
)


@given(st.one_of(st.text(max_size=60), st.lists(_PIECES, max_size=14).map(" ".join)))
@example("always speed < 3\x00")
@example("always \u0663 < 3")
@settings(max_examples=400, deadline=None)
def test_the_parser_raises_nothing_but_config_errors_of_one_line(text) -> None:
    try:
        requirement = parse_requirement(text)
    except ConfigError as error:
        message = str(error)
    else:
        message = "understood"
        assert parse_requirement(str(requirement)) == requirement
    assert len(message.splitlines()) == 1


def test_every_signal_has_a_meaning_and_the_documentation_explains_every_event() -> None:
    assert all(meaning for _, meaning in SIGNALS.values())
    for event in EVENTS:
        assert f"``{event}``" in str(requirements.__doc__)


# --- the sign of the margin ----------------------------------------------------------------------------------------


@dataclass
class _Case:
    """A requirement as text, and an independent implementation of its meaning."""

    text: str
    holds: Any = None  # f(signals, i) -> bool
    parts: list[Any] = field(default_factory=list)


_SIGNS = ("<", "<=", ">", ">=", "==", "!=")
_NUMBERS = st.integers(-3, 3)
_SAMPLES = st.integers(2, 8).flatmap(
    lambda n: st.tuples(*[st.lists(st.integers(-3, 3), min_size=n, max_size=n)] * 3)
)  # speed, clearance, wheels_on_road


def _comparison(name: str, column: int, sign: str, value: int) -> _Case:
    test = {
        "<": lambda a, b: a < b, "<=": lambda a, b: a <= b, ">": lambda a, b: a > b, ">=": lambda a, b: a >= b,
        "==": lambda a, b: a == b, "!=": lambda a, b: a != b,
    }[sign]  # fmt: skip
    return _Case(f"{name} {sign} {value}", lambda data, i: test(data[column][i], value))


_ATOMS = st.one_of(
    st.builds(_comparison, st.just("speed"), st.just(0), st.sampled_from(_SIGNS[:4]), _NUMBERS),
    st.builds(_comparison, st.just("clearance"), st.just(1), st.sampled_from(_SIGNS[:4]), _NUMBERS),
    st.builds(
        _comparison,
        st.just("wheels_on_road"),
        st.just(2),
        st.sampled_from(_SIGNS),
        _NUMBERS,
    ),
    st.just(_Case("collision", lambda data, i: data[1][i] <= 0)),
)


def _joined(word: str, parts: list[_Case]) -> _Case:
    every = {"and": all, "or": any}[word]
    return _Case(
        "(" + f" {word} ".join(part.text for part in parts) + ")",
        lambda data, i: every(part.holds(data, i) for part in parts),
    )


_EXPRESSIONS = st.recursive(
    _ATOMS,
    lambda inner: st.one_of(
        st.builds(_joined, st.sampled_from(("and", "or")), st.lists(inner, min_size=2, max_size=3)),
        inner.map(lambda part: _Case(f"not {part.text}", lambda data, i: not part.holds(data, i))),
    ),
    max_leaves=5,
)


def _brute(kind: str, first, second, data, rows) -> Any:
    if kind == "always":
        return all(first.holds(data, i) for i in rows)
    if kind == "never":
        return not any(first.holds(data, i) for i in rows)
    if kind == "eventually":
        return any(first.holds(data, i) for i in rows)
    if kind == "at end":
        return first.holds(data, rows[-1])
    return any(second.holds(data, i) and all(first.holds(data, j) for j in rows if j < i) for i in rows)


@given(st.sampled_from(("always", "never", "eventually", "at end", "until")), _EXPRESSIONS, _EXPRESSIONS)
@settings(max_examples=200, deadline=None)
def test_the_text_of_a_requirement_means_the_same_requirement(kind, first, second) -> None:
    text = f"{first.text}  until {second.text}" if kind == "until" else f" {kind} {first.text} "
    requirement = parse_requirement(text)
    assert parse_requirement(str(requirement)) == requirement
    assert requirement.kind == kind


@given(
    st.sampled_from(("always", "never", "eventually", "at end", "until")),
    _EXPRESSIONS,
    _EXPRESSIONS,
    _SAMPLES,
    st.integers(0, 1),
)
@settings(max_examples=400, deadline=None)
def test_truth_and_sign_agree_with_a_brute_force_evaluation(kind, first, second, data, after) -> None:
    text = f"{first.text} until {second.text}" if kind == "until" else f"{kind} {first.text}"
    text = f"after {0.5 * after} s {text}" if after else text
    observation = _seen(speed=data[0], clearance=data[1], wheels_on_road=data[2])
    finding = parse_requirement(text).judge(observation)
    rows = [i for i in range(len(data[0])) if i >= after]
    assert finding.passed == _brute(kind, first, second, data, rows)
    assert finding.passed or finding.margin <= 0.0
    assert not finding.passed or finding.margin >= 0.0
    assert math.isfinite(finding.margin)


@given(st.lists(st.floats(-5, 5), min_size=3, max_size=9), st.floats(-4, 4), st.floats(0.0, 2.0))
@settings(max_examples=100, deadline=None)
def test_the_margin_is_the_distance_of_the_signal_to_its_limit(speeds, bound, share) -> None:
    finding = parse_requirement(f"always speed < {bound:.6f}").judge(_seen(speed=speeds))
    moved = parse_requirement(f"always speed < {bound:.6f}").judge(_seen(speed=np.add(speeds, share * finding.margin)))
    assert moved.margin == pytest.approx((1.0 - share) * finding.margin, abs=1e-9)


# --- what a run does not have --------------------------------------------------------------------------------------


def test_a_missing_signal_goal_or_unit_is_reported() -> None:
    observation = _seen(speed=[1.0, 2.0])
    for text, expected in (
        ("always lateral_error < 1 m", "no signal 'lateral_error'"),
        ("always radar.range < 1 m", "no signal 'radar.range'"),
        ("eventually at exot", "did you mean 'exit'"),
    ):
        with pytest.raises(ConfigError, match=expected):
            parse_requirement(text).judge(observation)
    with pytest.raises(ConfigError, match=r"'radar.range' is in pure numbers, not in m"):
        parse_requirement("always radar.range < 1 m").judge(_seen(radar__range=[1.0, 2.0]))
    with pytest.raises(ConfigError, match="has no goal"):
        parse_requirement("eventually at goal").judge(Observation(TIMES, {}))


def test_missing_numbers_and_runs_that_end_early_are_reported() -> None:
    with pytest.raises(RunError, match=r"not a number at t = 0.5 s"):
        parse_requirement("always speed < 1 m/s").judge(_seen(speed=[1.0, math.nan]))
    with pytest.raises(RunError, match=r"ended at 0.5 s"):
        parse_requirement("after 3 s always speed < 1 m/s").judge(_seen(speed=[1.0, 2.0]))


def test_an_infinite_clearance_is_an_infinite_margin() -> None:
    finding = parse_requirement("always clearance > 1 m").judge(_seen(clearance=[math.inf, math.inf]))
    assert finding.passed
    assert finding.margin == math.inf


def test_names_of_signals_and_goals() -> None:
    requirement = parse_requirement("always speed < 1 or at exit and speed > 2 or at goal")
    assert requirement.signals == ("speed",)
    assert requirement.goals == ("exit", "goal")


# --- observing a run -----------------------------------------------------------------------------------------------


def _run(x, y, yaw, speed, **more) -> Run:
    """Return a run of the bolt on a given path, as if it had been simulated."""
    n = len(x)
    zero = np.zeros(n)
    columns = {"x": x, "y": y, "z": zero, "roll": zero, "pitch": zero, "yaw": yaw, "vx": speed, "vy": zero, "vz": zero}
    columns |= dict.fromkeys(("wx", "wy", "wz", "steering_angle.left", "steering_angle.right"), zero)
    columns |= {f"wheel_speed.{a}_{b}": np.asarray(speed) / 0.3 for a in ("front", "rear") for b in ("left", "right")}
    table = pd.DataFrame({f"ego.{name}": np.asarray(values, dtype=float) for name, values in columns.items()})
    table = table.assign(**{name: np.asarray(values, dtype=float) for name, values in more.items()})
    table.index = pd.Index(0.1 * np.arange(n), name="time")
    units = {f"ego.{name}": "m" for name in ("x", "y", "z")} | {f"ego.{name}": "m/s" for name in ("vx", "vy")}
    return Run(None, {"control": {}}, {}, units, [], table)


def _post(x: float, y: float) -> PlacedProp:
    return PlacedProp("post", make_primitive("box", (1.0, 1.0, 1.0)), RigidTransform([x, y, 0.0]))


def test_the_outline_is_the_box_around_the_collision_shapes() -> None:
    bolt = load_vehicle("bolt")
    box = outline(bolt)
    assert box.left == pytest.approx(-box.right)
    assert box.bottom == pytest.approx(0.0, abs=1e-9)
    assert box.front - box.rear == pytest.approx(4.17, abs=0.05)
    assert box.front > bolt.geometry.wheelbase


def test_a_drive_past_a_post_is_seen() -> None:
    bolt, world = load_vehicle("bolt"), load_world("empty")
    box = outline(bolt)
    x = np.linspace(0.0, 10.0, 51)
    run = _run(x, 0 * x, 0 * x, np.full(51, 2.0), other_contacts=np.where(x > 9.5, 1, 0))
    observation = observe(run, _with(world, props=[_post(12.0 + box.front, 0.0)]), "ego", bolt)
    assert observation.signals["clearance"] == pytest.approx(11.5 - x)
    assert observation.events["collision"].truth.sum() == 0  # a contact that is not near the post
    assert parse_requirement("always clearance > 2 m").judge(observation).margin == pytest.approx(-0.5)
    observation = observe(run, _with(world, props=[_post(10.2 + box.front, 0.0)]), "ego", bolt)
    finding = parse_requirement("never collision").judge(observation)
    assert not finding.passed
    assert finding.margin == pytest.approx(-0.3)
    assert finding.worst_time == pytest.approx(5.0)


def test_goals_and_the_road_have_margins_in_metres() -> None:
    bolt, world = load_vehicle("bolt"), load_world("test_track")
    track = world.tracks["main"]
    s = np.linspace(track.length - 10.0, track.length + 20.0, 61)
    x, y, yaw = track.pose(np.mod(s, track.length))
    goals = {
        "disc": SimpleNamespace(area=shapely.Point(x[-1], y[-1]).buffer(2.0, 64), gate=None, laps=None),
        "gate": SimpleNamespace(area=None, gate=("main", 5.0), laps=None),
        "start": SimpleNamespace(area=None, gate=("main", float(np.mod(s[0], track.length))), laps=None),
    }
    observation = observe(_run(x, y, yaw, np.full(61, 5.0)), _with(world, goals=goals), "ego", bolt, goal="disc")
    assert observation.events["at disc"].margin[[0, -1]] == pytest.approx(
        [2.0 - math.hypot(x[-1] - x[0], y[-1] - y[0]), 2.0], abs=0.01
    )
    assert observation.events["at gate"].margin == pytest.approx(s - track.length - 5.0, abs=1e-6)
    assert observation.events["at start"].margin[-1] == pytest.approx(30.0 - track.length, abs=1e-6)
    assert parse_requirement("eventually at goal within 7 s").judge(observation).passed
    half = max(bolt.geometry.front_track, bolt.geometry.rear_track) / 2.0
    assert observation.events["on road"].margin.max() == pytest.approx(track.width / 2.0 - half, abs=1e-3)
    assert not observation.events["rollover"].truth.any()


def test_motion_signals_follow_from_the_velocity() -> None:
    bolt, world = load_vehicle("bolt"), load_world("empty")
    time = 0.1 * np.arange(20)
    run = _run(time**2, 0 * time, 0 * time, 2.0 * time)
    observation = observe(run, world, "ego", bolt)
    assert observation.signals["accel"] == pytest.approx(np.full(20, 2.0))
    assert observation.signals["lateral_accel"] == pytest.approx(np.zeros(20))
    assert observation.signals["time"] == pytest.approx(time)
    radius = bolt.geometry.wheel_radii[0]
    assert observation.signals["slip"][-1] == pytest.approx(abs(radius / 0.3 - 1.0))
    assert observation.events["stopped"].truth[0]
    assert not observation.events["stopped"].truth[1:].any()
    with pytest.raises(RunError, match="no samples"):
        observe(Run(None, {}, {}, table=pd.DataFrame(index=pd.Index([], name="time"))), world, "ego", bolt)


def _with(world, **attributes) -> Any:
    """Return a world with other props or goals."""
    same = {"tracks": world.tracks, "road_areas": world.road_areas, "lights": {}}
    return SimpleNamespace(**(same | {"props": (), "goals": {}, "actors": ()} | attributes))


@pytest.mark.parametrize(
    ("text", "scale"),
    [
        ("always speed < 12 m/s", 12.0),
        ("always clearance > 0.5 m", 0.5),
        ("never collision", 1.0),
        ("always abs heading_error < 0.2", 0.2),
        ("always heading_error > 0", 0.1),
    ],
)
def test_a_finding_has_a_size_by_which_units_compare(text: str, scale: float) -> None:
    observation = _seen(speed=[0.0, 5.0], clearance=[1.0, 0.8], heading_error=[0.1, 0.05])
    assert parse_requirement(text).judge(observation).scale == pytest.approx(scale)
