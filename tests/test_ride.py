"""Figures of ride against the tables of the standard, closed forms and independent integrations."""

import math

import numpy as np
import pytest
import scipy

from mirdrake.ground import Terrain
from mirdrake.ground.roughness import ROUGHNESS, Roughness
from mirdrake.ground.roughness_index import SPEED, quarter_car, roughness_index
from mirdrake.manoeuvres import Rig, find_facts, run_manoeuvre
from mirdrake.manoeuvres.metrics.ride import WD, WK, body_acceleration, comfort, response, third_octaves, weighted
from mirdrake.manoeuvres.record import Record
from mirdrake.manoeuvres.ride import RoughRoadSpec, SingleBumpSpec
from mirdrake.vehicles import load_vehicle

# Third octaves [Hz] and weightings in thousandths, ISO 2631-1:1997, table 3.
CENTRES = [0.5, 0.63, 0.8, 1, 1.25, 1.6, 2, 2.5, 3.15, 4, 5, 6.3, 8, 10, 12.5, 16, 20, 25, 31.5, 40, 50, 63, 80]
TABLE_K = [418, 459, 477, 482, 484, 494, 531, 631, 804, 967, 1039, 1054, 1036, 988, 902, 768, 636, 513, 405, 314, 246,
           186, 132]  # fmt: skip
# The standard prints 212 at 10 Hz; the transfer function of its annex A has 202, as the trend of the table.
TABLE_D = [853, 944, 992, 1011, 1008, 968, 890, 776, 642, 512, 409, 323, 253, None, 161, 125, 100, 80, 63.2, 49.4, 38.8,
           29.5, 21.1]  # fmt: skip


@pytest.mark.parametrize(("weighting", "table"), [(WK, TABLE_K), (WD, TABLE_D)])
def test_weightings_are_those_of_the_tables_of_the_standard(weighting, table):
    gains = np.abs(response(weighting, np.array(CENTRES)))
    for gain, published in zip(gains, table, strict=True):
        assert published is None or gain == pytest.approx(published / 1e3, rel=4e-3)


def test_a_sine_has_the_weighted_figures_in_closed_form():
    step, amplitude = 0.005, 2.0
    time = np.arange(0.0, 30.0, step)
    values = weighted(amplitude * np.sin(2.0 * np.pi * 8.0 * time), step, WK)
    # Without the start, where the high pass settles.
    figures = comfort(values[time >= 10.0], step)
    peak = amplitude * abs(response(WK, np.array([8.0]))[0])
    assert figures.rms == pytest.approx(peak / math.sqrt(2.0), rel=1e-3)
    assert figures.transient == pytest.approx(figures.rms, rel=1e-3)
    # The mean of sin⁴ is 3/8.
    assert figures.dose == pytest.approx(peak * (0.375 * 20.0) ** 0.25, rel=1e-3)
    assert figures.crest == pytest.approx(math.sqrt(2.0), rel=0.01)


def test_third_octaves_have_the_rms_of_the_sines_in_them():
    time = np.arange(0.0, 20.0, 0.005)
    centres, bands = third_octaves(np.sin(2.0 * np.pi * 2.0 * time) + 3.0 * np.sin(2.0 * np.pi * 10.0 * time), 0.005)
    assert bands[np.argmin(np.abs(centres - 2.0))] == pytest.approx(1.0 / math.sqrt(2.0))
    assert bands[np.argmin(np.abs(centres - 10.0))] == pytest.approx(3.0 / math.sqrt(2.0))
    assert np.sum(bands**2) == pytest.approx(5.0)


def test_the_acceleration_of_a_point_of_a_pitching_body():
    time = np.arange(0.0, 2.0, 0.005)
    rate, angle = 2.0 * np.pi, 0.02
    pitch = angle * np.sin(rate * time)
    none = np.zeros_like(time)
    others = {"pitch": pitch, "wx": none, "wy": angle * rate * np.cos(rate * time), "vz": none}
    record = Record("", time, none, none, none, none, none, none, none, none, 1.0, 1.0, others)
    # About the y axis, a point ahead accelerates down where the nose accelerates down, and towards the axis.
    acceleration = body_acceleration(record, (1.5, 0.0, 0.0))
    middle = 0.5 * (time[1:] + time[:-1])
    assert acceleration[:, 2] == pytest.approx(1.5 * angle * rate**2 * np.sin(rate * middle), abs=1e-3)
    assert acceleration[:, 0] == pytest.approx(-1.5 * (angle * rate * np.cos(rate * middle)) ** 2, abs=1e-3)
    assert acceleration[:, 1] == pytest.approx(none[1:])


def test_the_roughness_index_is_that_of_an_independent_integration():
    spacing = 0.1
    x = np.arange(0.0, 120.0, spacing)
    z = Terrain(list(Roughness(ROUGHNESS["B"], 5).grids())).height(x, 0.0 * x)
    # The quarter car over time behind a moving average of three samples; its start is at rest on the first height.
    smooth = np.convolve(z, np.full(3, 1.0 / 3.0), mode="valid")
    times = spacing * np.arange(len(smooth)) / SPEED
    A, B = quarter_car()
    level = smooth[0] * np.array([1.0, 0.0, 1.0, 0.0])

    def slope(t, state):
        return A @ (state - level) + B * (np.interp(t, times, smooth) - smooth[0])

    solution = scipy.integrate.solve_ivp(
        slope, (0.0, times[-1]), level, t_eval=times, max_step=times[1], rtol=1e-8, atol=1e-10
    )
    rectified = np.abs(solution.y[1] - solution.y[3])
    # From 20 m on, where both starts have decayed.
    late = times > 20.0 / SPEED
    expected = 1e3 * np.mean(rectified[late]) / SPEED
    whole, first = len(smooth) - 1, int(np.argmax(late))
    # The index of the later part: that of the whole less that of the first part, each weighted by its length.
    total = roughness_index(z, spacing) * whole - roughness_index(z[: first + 2], spacing) * first
    assert total / (whole - first) == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize("name", ["A", "C"])
def test_the_roughness_index_of_a_class_of_iso_8608(name):
    x = np.arange(0.0, 2000.0, 0.1)
    terrain = Terrain(list(Roughness(ROUGHNESS[name], 3).grids()))
    index = np.mean([roughness_index(terrain.height(x, 0.0 * x + y), 0.1) for y in (0.0, 40.0)])
    # The slope of a profile with the exponent -2 is white noise with the one-sided density (2π n0)² Gd(n0) per cycle/m.
    # The slopes of the masses over the distance are then Gaussian, with the variance of the Lyapunov equation.
    A, B = quarter_car()
    intensity = 0.5 * (2.0 * np.pi * 0.1) ** 2 * ROUGHNESS[name] / SPEED
    P = scipy.linalg.solve_continuous_lyapunov(A, -np.outer(B, B) * intensity)
    deviation = math.sqrt(P[0, 0] + P[2, 2] - 2.0 * P[0, 2])
    assert index == pytest.approx(1e3 * math.sqrt(2.0 / math.pi) * deviation, rel=0.02)


def test_a_profile_too_short_or_too_coarse_has_no_roughness_index():
    with pytest.raises(ValueError, match="needs 11 m"):
        roughness_index(np.zeros(50), 0.1)
    with pytest.raises(ValueError, match=r"at most 0\.3 m"):
        roughness_index(np.zeros(50), 0.5)


@pytest.fixture(scope="module")
def rig():
    vehicle = load_vehicle("bolt@handling")
    return Rig("bolt@handling", vehicle, find_facts(vehicle))


def test_a_rough_road_has_the_figures_of_its_signals(rig):
    spec = RoughRoadSpec(length=40.0, run_up=1.0, time_step=0.005)
    outcome = run_manoeuvre("rough_road", rig, spec)
    record = rig.records[-1]
    shown = record.time >= 1.0
    load = record.others["wheel_load.rear_right"][shown]
    assert outcome.value("load_variation.rear_right") == pytest.approx(100.0 * load.std() / load.mean())
    # The mean load is the weight.
    loads = sum(
        record.others[f"wheel_load.{axle}_{side}"][shown] for axle in ("front", "rear") for side in ("left", "right")
    )
    assert loads.mean() == pytest.approx(9.80665 * rig.facts.mass, rel=0.02)
    total = math.hypot(*(outcome.value(name) or 0.0 for name in ("vertical", "lateral", "longitudinal")))
    assert outcome.value("total") == pytest.approx(total)
    assert 0.3 < (outcome.value("vertical") or 0.0) < 1.5
    assert outcome.value("iri") == pytest.approx(2.22 * math.sqrt(ROUGHNESS["C"] / ROUGHNESS["A"]), rel=0.25)
    assert outcome.value("air") == 0.0


@pytest.mark.slow
def test_the_figures_of_a_rough_road_and_a_bump_do_not_depend_on_the_step(rig):
    for name, spec in (("rough_road", RoughRoadSpec(length=100.0)), ("single_bump", SingleBumpSpec())):
        one, half = (run_manoeuvre(name, rig.with_step(step), spec) for step in (0.0025, 0.00125))
        changes = {a.key: a.change(b) for a, b in zip(one.metrics, half.metrics, strict=True)}
        # The time in the air is a number of samples, of which one may be on either side.
        assert changes.pop("air") * 0.1 <= 1.01 * rig.records[-1].step
        assert max(changes.values()) < 0.03, changes


def test_a_bump_throws_the_wheels_up_in_turn(rig):
    spec = SingleBumpSpec(before=0.3, after=0.7, time_step=0.005)
    outcome = run_manoeuvre("single_bump", rig, spec)
    record = rig.records[-1]
    peaks = [record.time[np.argmax(record.others[f"travel.{axle}_left"])] for axle in ("front", "rear")]
    assert peaks[1] - peaks[0] == pytest.approx(rig.facts.wheelbase / spec.speed, abs=0.02)
    # Both sides alike: no roll, and no lateral motion.
    assert float(np.max(np.abs(record.roll))) < 1e-3
    # Over the bump the wheels rise by less than its height, since the tyre envelops it.
    assert 0.0 < (outcome.value("travel_bump_front") or 0.0) < 75.0


def test_a_model_without_vertical_motion_cannot_ride(rig):
    flat = Rig("bolt@handling", rig.vehicle, rig.facts, kind="single_track")
    for name in ("rough_road", "single_bump"):
        assert run_manoeuvre(name, flat).verdict == "not possible"
