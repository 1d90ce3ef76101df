"""Studies from their file to the result: given values, units, stages, faults with file and line, the page."""

import json
import re
import time
from dataclasses import replace
from functools import cache

import numpy as np
import pandas as pd
import pytest

from mirdrake.core.errors import ConfigError
from mirdrake.identification.channels import channel
from mirdrake.identification.default_study import default_study
from mirdrake.identification.estimators import EstimatorOptions
from mirdrake.identification.fit import Fit, load_fit
from mirdrake.identification.identify import Identification, identify, to_number
from mirdrake.identification.study import EstimatorSpec, StudySpec, load_identification
from mirdrake.report.identification import render_data_check, render_identification, write_identification
from tests.identification_rigs import MASS, NOISE, TRUTH, exact
from tests.test_identification_data import CAR, recorded

STUDY = """\
mirdrake: identification/1
data:
  wheelbase: 2.7 m
  channels:
    vx: {column: vx, unit: m/s}
    yaw_rate: {column: yaw_rate, unit: rad/s}
    road_wheel_angle: {column: road_wheel_angle, unit: rad}
    lateral_acceleration: {column: lateral_acceleration, unit: m/s^2}
  logs: [{file: a.csv}, {file: b.csv, use: validation}]
model: single_track
parameters:
  mass: {fixed: 1500 kg, source: scales}
  front_length: {fixed: 120 cm}
  rear_length: {fixed: 1.5}
  yaw_inertia: {given: 2000, source: data sheet}
  cornering_stiffness_front: {low: 3e4, high: 3e5}
"""


CLOSED = [f"model.{option}=false" for option in ("relaxation", "roll")] + ["model.tyres=linear"]
CLOSED += [f"parameters.{name}.fixed=0" for name in ("steering_lag", "load_transfer")] + ["estimator.loss=linear"]
"""Overrides with which nothing is open to the structure search."""


@cache
def tables():
    """Return two drives as tables, a sample each 20 ms."""
    tables_by_name = {}
    for name, seed, rows in (("a", 1, slice(0, 2000, 2)), ("b", 2, slice(2000, 4001, 2))):
        log = recorded(seed)
        channels = {key: values[rows] for key, values in log.channels.items()}
        tables_by_name[name] = replace(log, time=log.time[rows], channels=channels).to_pandas().reset_index()
    return tables_by_name


def write(folder, text=STUDY, change=None):
    """Return a study with its logs; `change` alters the tables."""
    for name, table in tables().items():
        (change(table.copy()) if change else table).to_csv(folder / f"{name}.csv", index=False)
    (folder / "study.yaml").write_text(text, encoding="utf-8")
    return folder / "study.yaml"


def do(folder, text=STUDY, overrides=(), change=None):
    path = write(folder, text, change)
    return identify(load_identification(path, overrides=overrides), path.parent)


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    known = [f"parameters.{name}.fixed={getattr(CAR, name)}" for name in ("front_drive", "front_brake")]
    known.append("model.relaxation=false")
    return do(tmp_path_factory.mktemp("study"), STUDY + "estimator: {loss: linear}\nabout: A <car>.\n", known)


def test_the_truth_comes_back_and_the_given_value_is_contradicted(result):
    fit = result.fit
    assert fit["cornering_stiffness_front"].value == pytest.approx(CAR.front_stiffness, rel=0.03)
    assert fit["cornering_stiffness_rear"].value == pytest.approx(CAR.rear_stiffness, rel=0.03)
    assert fit["yaw_inertia"].value == pytest.approx(CAR.yaw_inertia, rel=0.03)
    assert fit["yaw_inertia"].verdict == "contradicts the given value"
    assert (fit["mass"].kind, fit["mass"].value, fit["mass"].source) == ("fixed", 1500.0, "scales")
    assert fit["front_length"].value == pytest.approx(1.2)
    assert fit.channel("yaw_rate", part="validation").nrmse_percent > 95.0
    assert fit.data_sha256 == result.check.data.digest


def test_the_result_folder_is_read_back(result, tmp_path):
    result.save(tmp_path)
    again = load_fit(tmp_path)
    assert [parameter.value for parameter in again.parameters] == [
        parameter.value for parameter in result.fit.parameters
    ]
    assert set(again.traces) == {"a.csv", "b.csv"}
    findings = pd.read_csv(tmp_path / "data_check.csv")
    assert len(findings) == len(result.check.findings)


def test_the_page_has_everything_and_needs_nothing(result, tmp_path):
    page = write_identification(result, tmp_path).read_text(encoding="utf-8")
    for text in ("A &lt;car&gt;.", "contradicts the given value", "validation", "Correlation", "a.csv", "scales"):
        assert text in page
    for parameter in result.fit.parameters:
        assert parameter.name in page.replace("<wbr>", "")
    # Each verdict with its parameters in words, above the table; numbers without exponents of Python.
    summary = page.partition("<h2>Verdicts</h2>")[2].partition("<h2>Parameters</h2>")[0]
    for parameter in result.fit.parameters:
        if parameter.kind != "fixed":
            assert parameter.name.replace("_", " ") in summary.partition(parameter.verdict)[2].partition("</tr>")[0]
    assert not re.search(r"<td[^>]*>[−\d.]*\de[+-]\d\d", page.partition("Fit and residuals")[0])
    assert not re.search(r"""(?:src|href)=["'](?!data:|#)|@import|<script""", page)
    assert page.count("<svg") == 4  # two logs, each wide and narrow
    assert page == render_identification(result)


def test_the_page_of_a_data_check_names_every_finding(result):
    data = result.check.data
    page = render_data_check("drives", data, result.check)
    assert result.check.headline in page.replace("&#39;", "'")
    assert all(log.name in page for log in data.logs)
    assert not re.search(r"""(?:src|href)=["'](?!data:|#)|@import|<script""", page)


def test_stages_fit_their_parameters_and_keep_them(tmp_path):
    free = "cornering_stiffness_front, cornering_stiffness_rear"
    text = STUDY + f"stages:\n- {{name: tyres, logs: [a.csv], free: [{free}], keep: true}}\n"
    study_result = do(tmp_path, text, [*CLOSED, "estimator.iterations=6"])
    (stage,) = study_result.stages
    assert [parameter.name for parameter in stage.parameters if parameter.kind != "fixed"] == [
        "cornering_stiffness_front",
        "cornering_stiffness_rear",
    ]
    last = study_result.fit["cornering_stiffness_rear"]
    assert (last.kind, last.source) == ("fixed", "stage tyres")
    assert last.value == stage["cornering_stiffness_rear"].value
    study_result.save(tmp_path / "out")
    assert load_fit(tmp_path / "out" / "stage_1").name == stage.name
    assert "Earlier stages" in render_identification(study_result)


def test_values_of_the_vehicle_are_initial_values_and_references(tmp_path):
    text = STUDY.split("parameters:")[0].replace("  wheelbase: 2.7 m\n", "") + "vehicle: bolt\n"
    study_result = do(tmp_path, text, CLOSED)
    assert study_result.vehicle == "bolt"
    assert study_result.fit["mass"].kind == "fixed"
    assert study_result.fit["mass"].value == pytest.approx(study_result.given["mass"])
    assert study_result.fit["yaw_inertia"].given == pytest.approx(study_result.given["yaw_inertia"])
    wheelbase = study_result.given["front_length"] + study_result.given["rear_length"]
    assert study_result.check.data.wheelbase == pytest.approx(wheelbase)


FAULTS = [
    (("low: 3e4, high: 3e5", "low: 3e5, high: 3e4"), "16: parameters.cornering_stiffness_front: low .* not below high"),
    (("1500 kg", "1500 m"), "12: parameters.mass.fixed: '1500 m': unit 'm' does not fit; allowed: kg"),
    (("given: 2000", "given: 2000 N"), "15: parameters.yaw_inertia.given: '2000 N': kg m\\^2 is expected"),
    (("  yaw_inertia:", "  yaw_inertial:"), "15: parameters.yaw_inertial: .*did you mean 'yaw_inertia'"),
    (("given: 2000", "fixed: 2000, guess: 1"), "15: parameters.yaw_inertia: is fixed, and has guess as well"),
    (("model: single_track", "model: single_trac"), "10: model: unknown model 'single_trac'; did you mean"),
    (("model: single_track", "model: {kind: single_track, tyre: linear}"), "10: model.tyre: unknown field"),
    (("model: single_track", "model: {tyres: linear}"), "10: model: a model needs a kind: kinematic, single_track, "),
    (("model: single_track\n", ""), "a model needs a kind: kinematic, single_track, "),
    (("{file: a.csv}", "{file: a.csv, use: validation}"), "2: data: no log is for training"),
    (("column: vx,", "column: speed,"), "5: data.channels.vx: .*a.csv has no column 'speed'"),
    (("unit: m/s}", "unit: rad}"), "4: data.channels: vx: unit 'rad' does not fit"),
    (("file: a.csv", "file: c.csv"), "9: data.logs.0.file: .*no such file"),
    (("    road_wheel_angle: {column: road_wheel_angle, unit: rad}\n", ""), "model.*: needs the steering"),
    (("low: 3e4", "guess: 1"), "16: parameters.cornering_stiffness_front"),
]  # fmt: skip


@pytest.mark.parametrize(("change", "message"), FAULTS)
def test_a_fault_names_its_line(tmp_path, change, message):
    assert change[0] in STUDY
    path = write(tmp_path, STUDY.replace(change[0], change[1], 1))
    with pytest.raises(ConfigError, match=message) as caught:
        identify(load_identification(path), path.parent)
    assert "study.yaml" in str(caught.value)
    assert "Traceback" not in str(caught.value)


@pytest.mark.parametrize(
    ("stage", "message"),
    [
        ("{name: one, free: [yaw_inertial]}", "18: stages.0.free: unknown parameter 'yaw_inertial'"),
        ("{name: one, logs: [c.csv], free: [yaw_inertia]}", "18: stages.0.logs: no log 'c.csv'; did you mean"),
        ("{name: one, logs: [b.csv], free: [yaw_inertia]}", "18: stages.0.logs: none of these logs is for training"),
    ],
)
def test_a_fault_of_a_stage_names_its_line(tmp_path, stage, message):
    with pytest.raises(ConfigError, match=message):
        do(tmp_path, STUDY + f"stages:\n- {stage}\n")


def _constant(table):
    table[table.columns[1:]] = 1.0
    return table


def _empty_of_numbers(table):
    table["yaw_rate"] = np.nan
    return table


def _backwards(table):
    table["time"] = table["time"].to_numpy()[::-1]
    return table


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (_constant, "a.csv: every channel is constant"),
        (_empty_of_numbers, "channels.yaw_rate: column 'yaw_rate' of .* has no numbers"),
        (_backwards, "a.csv:3: time goes back"),
        (lambda table: table.iloc[:0], "a.csv: has a header and no rows"),
    ],
)
def test_a_log_that_cannot_be_fitted_raises_an_error(tmp_path, change, message):
    with pytest.raises(ConfigError, match=message):
        do(tmp_path, change=change)


def test_numbers_may_carry_the_unit_of_their_parameter():
    assert to_number("1.2e5 N/rad", "N/rad", ()) == 1.2e5
    assert to_number("50 ms", "s", ()) == pytest.approx(0.05)
    assert to_number(3, "kg m^2", ()) == 3.0
    for text in ("much", "5 N", "5 kN/rad"):
        with pytest.raises(ConfigError, match=r"^here: "):
            to_number(text, "N/rad", ("here",))


def test_the_estimator_of_the_file_has_the_options_of_the_estimator():
    assert EstimatorOptions(**EstimatorSpec().model_dump()) == EstimatorOptions()


def test_a_page_of_a_fit_with_odd_numbers_is_written(result):
    """Infinite condition, open intervals, no traces, correlation that is not a number."""
    odd = replace(
        result.fit,
        condition_number=np.inf,
        correlation=np.full_like(result.fit.correlation, np.nan),
        parameters=tuple(
            replace(parameter, low=None, high=None, sigma=None, at_bound="low") for parameter in result.fit.parameters
        ),
        channels=(),
        traces={},
        profiles={"yaw_inertia": pd.DataFrame({"value": [1000.0, 2000.0, 3000.0], "cost": [5.0, 0.0, np.nan]})},
        advice=("do a <step> steer",),
    )
    assert isinstance(odd, Fit)
    page = render_identification(Identification("odd", "", result.check, odd))
    assert "∞" in page
    assert "at its lower bound" in page
    assert "do a &lt;step&gt; steer" in page
    assert "profile of yaw_inertia" in page


def test_the_smallest_study_and_its_defaults():
    spec = StudySpec.model_validate({"mirdrake": "identification/1", "data": "a.yaml", "model": "single_track"})
    assert spec.model == {"kind": "single_track"}
    assert json.loads(spec.model_dump_json())["estimator"]["loss"] == "huber"


@pytest.mark.slow
def test_the_default_identification_of_90_s_at_200_hz_takes_less_than_10_s(tmp_path):
    """Processor time of all threads, without the compilation."""
    time_, clean = exact(90.0, 0.005)
    rng = np.random.default_rng(1)
    table = {"time": time_, "road_wheel_angle": clean["road_wheel_angle"]}
    for name in ("vx", "yaw_rate", "lateral_acceleration"):
        table[name] = clean[name] + rng.normal(0.0, NOISE[name], len(time_))
    channels = "".join(
        f"  {name}: {{column: {name}, unit: {channel(name).unit}}}\n" for name in table if name != "time"
    )
    seconds = []
    for name, rows in (("warm", 4000), ("drive", len(time_))):
        pd.DataFrame(table)[:rows].to_csv(tmp_path / f"{name}.csv", index=False)
        data = tmp_path / f"{name}.yaml"
        data.write_text(f"mirdrake: data/1\nwheelbase: 2.7\nchannels:\n{channels}logs:\n- {{file: {name}.csv}}\n")
        began = time.process_time()
        result = identify(default_study(data), tmp_path)
        seconds.append(time.process_time() - began)
    assert seconds[1] < 10.0
    # The lag was found, and what this log determines. The inertia depends on the assumed centre of mass.
    for name in ("steering_delay", "steering_lag"):
        estimate = result.fit[name]
        assert estimate.verdict == "identified"
        assert estimate.low is not None
        assert estimate.high is not None
        assert estimate.low < TRUTH[name] < estimate.high
    assert result.fit["yaw_inertia"].value == pytest.approx(TRUTH["yaw_inertia"] / MASS, rel=0.02)
